"""Camera models: what we unproject, COLMAP and OpenCV project back to the same pixel to 1e-9, for every model that is read."""

import json
import os
import shutil
import subprocess

import numpy as np
import pytest

from conftest import execute
from readers import pose, read_depth

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap cannot be imported", exc_type=ImportError)
cv2 = pytest.importorskip("cv2", reason="OpenCV cannot be imported", exc_type=ImportError)

MODELS = {
    "SIMPLE_PINHOLE": [812.25, 321.5, 238.75],
    "PINHOLE": [812.25, 805.5, 321.5, 238.75],
    "SIMPLE_RADIAL": [812.25, 321.5, 238.75, -0.21],
    "RADIAL": [812.25, 321.5, 238.75, -0.21, 0.13],
    "OPENCV": [812.25, 805.5, 321.5, 238.75, -0.21, 0.13, 0.0021, -0.0017],
    "FULL_OPENCV": [812.25, 805.5, 321.5, 238.75, -0.21, 0.13, 0.0021, -0.0017, -0.04, 0, 0, 0],
}
# Half a turn about x looks at the wall from 12 m before it; the rest is roll and tilt.
POSE = "0.03 0.9985 0.045 -0.02"
PIPELINE = """
rockface: 1
name: models
axes:
  image: {items: [%s]}
steps:
  face:  {stage: import-mesh, with: {path: face.ply, frame: wall}}
  rig:   {stage: import-cameras, with: {path: model, frame: wall}}
  depth: {stage: project-depth, in: {mesh: face.mesh, cameras: rig.cameras}, with: {image: "${image}"}}
"""
FACE = """ply
format ascii 1.0
element vertex 4
property double x
property double y
property double z
element face 2
property list uchar int vertex_indices
end_header
-20 -20 0.5
20 -20 -0.5
20 20 1.5
-20 20 0
3 0 1 2
3 0 2 3
"""


@pytest.fixture(scope="module")
def block(binary, tmp_path_factory):
    """A COLMAP model with an image of every camera model, and our depth maps of them."""
    work = tmp_path_factory.mktemp("models")
    model = work / "model"
    model.mkdir()
    names = {name: f"{name.lower()}.jpg" for name in MODELS}
    words = enumerate(MODELS.items(), 1)
    model.joinpath("cameras.txt").write_text(
        "".join(f"{i} {name} 640 480 {' '.join(map(repr, values))}\n" for i, (name, values) in words)
    )
    quaternion = np.array(POSE.split(), float)
    quaternion /= np.linalg.norm(quaternion)
    posed = " ".join(map(repr, quaternion.tolist()))
    model.joinpath("images.txt").write_text(
        "".join(f"{i} {posed} 0.2 -0.1 12.0 {i} {names[name]}\n\n" for i, name in enumerate(MODELS, 1))
    )
    model.joinpath("points3D.txt").write_text("")
    work.joinpath("face.ply").write_text(FACE)
    pipeline = work / "models.yaml"
    pipeline.write_text(PIPELINE % ", ".join(names.values()))
    return execute(binary, pipeline, work), pycolmap.Reconstruction(model), names


def followed(binary, depth, pixel, tmp_path):
    """Position in the image and point of a pixel, in double precision, as `inspect` tells them of a file without a store."""
    command = [binary, "inspect", depth, "--pixel", f"{pixel[0]},{pixel[1]}", "--json"]
    environment = os.environ | {"ROCKFACE_STORE": str(tmp_path / "empty")}
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60, env=environment)
    facts = json.loads(done.stdout)["chain"][0]["facts"]
    return facts["position in the full image (px)"], facts["point in the wall frame (m)"]


@pytest.mark.parametrize("name", MODELS)
def test_points_project_to_their_pixels_in_colmap_and_opencv(binary, block, tmp_path, name):
    run, reconstruction, names = block
    depth = tmp_path / "depth.exr"
    shutil.copy(run.output("depth", "depth.exr", f"image={names[name]}"), depth)
    image = next(image for image in reconstruction.images.values() if image.name == names[name])
    camera = reconstruction.camera(image.camera_id)
    assert camera.model.name == name
    pixels = [(0, 0), (639, 0), (0, 479), (639, 479), (320, 240), (17, 333), (600, 41), (251, 466)]
    told = [followed(binary, depth, pixel, tmp_path) for pixel in pixels]
    positions, points = np.array([t[0] for t in told]), np.array([t[1] for t in told])
    np.testing.assert_array_equal(positions, pixels)
    # COLMAP counts from the corner of the first pixel, OpenCV from its centre as we do.
    in_camera = points @ image.cam_from_world().rotation.matrix().T + image.cam_from_world().translation
    assert np.abs(camera.img_from_cam(in_camera) - 0.5 - positions).max() < 1e-9
    _, header = read_depth(depth)
    sensor, (rotation, centre) = header["sensor"], pose(header)
    matrix = np.array([[sensor["f"] + sensor["b1"], 0, sensor["cx"]], [0, sensor["f"], sensor["cy"]], [0, 0, 1]])
    k1, k2, k3, k4 = sensor["k"]
    assert k4 == 0 and sensor["b2"] == 0
    vector = np.array([k1, k2, *sensor["p"], k3])
    seen, _ = cv2.projectPoints(points, cv2.Rodrigues(rotation)[0], -rotation @ centre, matrix, vector)
    # A rotation vector and back costs OpenCV some digits.
    assert np.abs(seen[:, 0] - positions).max() < 1e-8
    exact, _ = cv2.projectPoints((points - centre) @ rotation.T, np.zeros(3), np.zeros(3), matrix, vector)
    assert np.abs(exact[:, 0] - positions).max() < 1e-9
