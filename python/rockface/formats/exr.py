"""Depth maps in OpenEXR, read without a copy: single-part scan lines of 32-bit floats, uncompressed as rockface writes them."""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rockface._errors import FormatError
from rockface.artefacts import DepthMap, Frame, Georeference, Image, Sensor

__all__ = ["read", "write"]

MAGIC = 20000630
FLOAT = 2
CAMERA = "rockface.depth"
OTHER = "read it with the package OpenEXR"


def read(data: memoryview) -> DepthMap:
    """Reads a depth map; its channels are views of the data.

    Raises:
        FormatError: the file is no OpenEXR, is cut short, is compressed, or has no camera.
    """
    try:
        header, at = _header(data)
        camera = json.loads(bytes(header[CAMERA]))
        channels = _channels(data, header, at)
    except (struct.error, ValueError, IndexError) as error:
        raise FormatError(f"damaged OpenEXR file: {error!r}") from error
    except KeyError as error:
        raise FormatError(f"not a depth map of rockface: the OpenEXR file has no attribute {error}") from error
    if "Z" not in channels:
        raise FormatError("not a depth map: the OpenEXR file has no channel `Z`")
    z = channels.pop("Z")
    sensor, image = Sensor.of(camera["sensor"]), Image.of(camera["image"])
    place = Georeference.of(camera["frame"])
    return DepthMap(Frame.of(camera["frame"]), sensor, image, int(camera["downscale"]), z, channels, place)


def _header(data: memoryview) -> tuple[dict[str, memoryview], int]:
    magic, version = struct.unpack_from("<iI", data)
    if magic != MAGIC:
        raise FormatError("not an OpenEXR file: it does not begin like one")
    if version & 0x1A00:
        raise FormatError(f"an OpenEXR file in tiles, parts or depths: {OTHER}")
    header, at = {}, 8
    while data[at]:
        name, at = _word(data, at)
        _, at = _word(data, at)
        (size,) = struct.unpack_from("<i", data, at)
        header[name] = data[at + 4 : at + 4 + size]
        at += 4 + size
    if header["compression"][0] != 0:
        raise FormatError(f"a compressed OpenEXR file: {OTHER}")
    return header, at + 1


def _word(data: memoryview, at: int) -> tuple[str, int]:
    end = at
    while data[end]:
        end += 1
    return bytes(data[at:end]).decode("latin-1"), end + 1


def _channels(data: memoryview, header: dict[str, memoryview], table: int) -> dict[str, NDArray[np.float32]]:
    left, top, right, bottom = struct.unpack_from("<4i", header["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    names, listed, at = [], header["channels"], 0
    while listed[at]:
        name, at = _word(listed, at)
        kind, _, *sampling = struct.unpack_from("<i4s2i", listed, at)
        if kind != FLOAT or sampling != [1, 1]:
            raise FormatError(f"channel `{name}` is not 32-bit float at full resolution: {OTHER}")
        names.append(name)
        at += 16
    line = 8 + 4 * width * len(names)
    offsets = np.frombuffer(data, "<u8", height, table)
    first = int(offsets[0])
    if not np.array_equal(offsets, first + line * np.arange(height, dtype=np.uint64)) or first + line * height > len(data):
        raise FormatError(f"an OpenEXR file whose scan lines are not in order, or that is cut short: {OTHER}")
    shape, strides = (height, len(names), width), (line, 4 * width, 4)
    values: NDArray[np.float32] = np.ndarray(shape, "<f4", data, first + 8, strides)
    return {name: values[:, number] for number, name in enumerate(names)}


def write(depth: DepthMap) -> bytes:
    """The file of a depth map."""
    channels: dict[str, NDArray[Any]] = {"Z": depth.z, **depth.channels}
    names = sorted(channels)
    height, width = depth.z.shape
    for name in names:
        if channels[name].shape != (height, width):
            raise FormatError(f"channel `{name}` has the shape {channels[name].shape}, Z has {(height, width)}")
    camera = {
        "frame": depth.written_frame(),
        "downscale": depth.downscale,
        "sensor": depth.sensor.as_dict(),
        "image": depth.image.as_dict(),
    }
    listed = b"".join(name.encode("latin-1") + b"\0" + struct.pack("<i4s2i", FLOAT, b"", 1, 1) for name in names)
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = [
        ("channels", "chlist", listed + b"\0"),
        ("compression", "compression", b"\0"),
        ("dataWindow", "box2i", window),
        ("displayWindow", "box2i", window),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1.0)),
        (CAMERA, "string", json.dumps(camera).encode("ascii")),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0.0, 0.0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1.0)),
    ]
    head = struct.pack("<iI", MAGIC, 2)
    for name, kind, value in attributes:
        head += name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    head += b"\0"
    line = 8 + 4 * width * len(names)
    first = len(head) + 8 * height
    offsets = first + line * np.arange(height, dtype="<u8")
    lines = np.zeros(height, np.dtype([("y", "<i4"), ("size", "<i4"), ("values", "<f4", (len(names), width))]))
    lines["y"], lines["size"] = np.arange(height), line - 8
    for number, name in enumerate(names):
        lines["values"][:, number] = channels[name]
    return b"".join([head, offsets.tobytes(), lines.tobytes()])
