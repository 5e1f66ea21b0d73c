"""Readers of our formats for numpy, by their documented conventions: depth maps, surfaces, camera models."""

import json

import numpy as np
import OpenEXR
import rasterio
from scipy.spatial.transform import Rotation


def read_depth(path):
    """Channels by name (rows x columns, float32) and the camera of a depth map."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = {name: channel.pixels.copy() for name, channel in file.channels().items()}
        return channels, json.loads(file.header()["rockface.depth"])


def distort(sensor, x, y):
    """Undistorted to distorted normalised coordinates (OpenCV model)."""
    r2 = x * x + y * y
    radial = 1 + sum(k * r2 ** (power + 1) for power, k in enumerate(sensor["k"]))
    p1, p2 = sensor["p"]
    return (
        x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
        y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
    )


def rays(camera, columns, rows):
    """Undistorted normalised coordinates (x, y, 1) of depth-map pixels, n x 3."""
    sensor, scale = camera["sensor"], camera["downscale"]
    u, v = ((np.asarray(pixel) + 0.5) * scale - 0.5 for pixel in (columns, rows))
    y_distorted = (v - sensor["cy"]) / sensor["f"]
    x_distorted = (u - sensor["cx"] - sensor["b2"] * y_distorted) / (sensor["f"] + sensor["b1"])
    x, y = x_distorted, y_distorted
    for _ in range(100):
        xd, yd = distort(sensor, x, y)
        x, y = x + x_distorted - xd, y + y_distorted - yd
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def pose(camera):
    """R (object to camera) and C of a depth map's camera."""
    image = camera["image"]
    rotation = Rotation.from_quat(image["camera_from_object"], scalar_first=True).as_matrix()
    return rotation, np.array(image["centre_m"])


def unproject(camera, columns, rows, z):
    """Object points C + z R^T (x, y, 1) of depth-map pixels, n x 3, metres."""
    rotation, centre = pose(camera)
    return centre + z.astype(float)[:, None] * rays(camera, columns, rows) @ rotation


def read_cloud(path):
    """Points, normals, further numbers by name and the frame of a cloud."""
    header, body = path.read_bytes().split(b"end_header\n", 1)
    lines = header.decode("ascii").splitlines()
    assert lines[1] == "format binary_little_endian 1.0"
    types = {"double": "<f8", "float": "<f4", "uchar": "u1", "uint": "<u4"}
    fields = [(line.split()[2], types[line.split()[1]]) for line in lines if line.startswith("property")]
    count = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    rows = np.frombuffer(body, fields)
    assert len(rows) == count
    stated = next(line for line in lines if line.startswith("comment rockface cloud, frame "))
    cloud = {name: rows[name] for name in rows.dtype.names}
    cloud["frame"] = stated.split()[4].rstrip(",")
    cloud["points"] = np.stack([rows[axis] for axis in "xyz"], axis=1)
    if "nx" in cloud:
        cloud["normals"] = np.stack([rows["n" + axis] for axis in "xyz"], axis=1).astype(float)
    return cloud


def read_surface(path):
    """Points (height x width x 3, metres, NaN = none), squares (bytes) and header of a surface file."""
    magic, header, body = path.read_bytes().split(b"\n", 2)
    assert magic == b"rockface surface 1"
    header = json.loads(header)
    height, width = header["height"], header["width"]
    points = np.frombuffer(body, "<f4", height * width * 3).reshape(height, width, 3)
    squares = np.frombuffer(body, np.uint8, offset=points.nbytes).reshape(height - 1, width - 1)
    return points.astype(float) + header["origin_m"], squares, header


def read_cores(path):
    """The core points of `detect-m3c2`, rows x columns x 3, metres: bands hold their distances from the centres of cells."""
    with rasterio.open(path) as file:
        dx, dy, z = (file.read(1 + file.descriptions.index(name)).astype(float) for name in ("core_dx", "core_dy", "core_z"))
        rows, columns = np.indices(z.shape)
        x, y = file.transform @ (columns + 0.5, rows + 0.5)
    return np.stack([x + dx, y + dy, z], axis=-1)
