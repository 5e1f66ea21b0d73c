"""The folder for Metashape: its files mean what its README says, and its script makes the calls of the documented interface.

Metashape itself is not run: it is commercial.
"""

import json
import py_compile
import shutil
import subprocess
import sys
from xml.etree import ElementTree

import numpy as np
import pytest
import rasterio
import trimesh

from conftest import HERE, execute
from readers import read_depth

PIPELINE = HERE / "metashape.yaml"


@pytest.fixture(scope="module")
def run(binary, tmp_path_factory):
    return execute(binary, PIPELINE, tmp_path_factory.mktemp("metashape"))


@pytest.fixture
def folder(run, tmp_path):
    """The folder, somewhere else: the script must not need where it was made."""
    return shutil.copytree(run.output("folder", "files"), tmp_path / "project")


def cameras(folder):
    """Label to (f, cx, cy, width, height, 4 x 4 camera to object) by Metashape's own conventions."""
    root = ElementTree.parse(folder / "cameras.xml").getroot()
    sensors = {}
    for sensor in root.iter("sensor"):
        calibration = sensor.find("calibration")
        value = {child.tag: float(child.text) for child in calibration if child.text and child.text.strip()}
        assert all(value[name] == 0 for name in ["b2", "k1", "k2", "k3", "k4", "p1", "p2"])
        size = calibration.find("resolution")
        sensors[sensor.get("id")] = value, int(size.get("width")), int(size.get("height"))
    matrix = lambda camera: np.array(camera.find("transform").text.split(), float).reshape(4, 4)
    return {camera.get("label"): (*sensors[camera.get("sensor_id")], matrix(camera)) for camera in root.iter("camera")}


def test_depth_images_are_floats_of_one_channel_and_lie_on_the_face(run, folder):
    face = trimesh.load_mesh(run.output("face", "mesh.ply"), process=False)
    listed = json.loads((folder / "images.json").read_text())
    known = cameras(folder)
    assert listed["frame"] == "wall" and listed["offset_m"] == [0, 0, 0] and len(listed["images"]) == 4
    for image in listed["images"]:
        sensor, width, height, to_object = known[image["label"]]
        with rasterio.open(folder / image["depth"]) as file:
            assert (file.count, file.dtypes[0], file.width, file.height) == (1, "float32", width, height)
            z = file.read(1)
        with rasterio.open(folder / image["picture"]) as file:
            assert (file.count, file.width, file.height) == (3, width, height)
        rows, columns = np.nonzero(z)
        assert np.isfinite(z).all() and len(rows) > 0.5 * z.size
        chosen = np.random.default_rng(1).choice(len(rows), 800, replace=False)
        rows, columns = rows[chosen], columns[chosen]
        # Metashape: u = w / 2 + cx + (f + b1) x, the centre of the first pixel at 0.5.
        x = (columns + 0.5 - width / 2 - sensor["cx"]) / (sensor["f"] + sensor["b1"])
        y = (rows + 0.5 - height / 2 - sensor["cy"]) / sensor["f"]
        rays = np.stack([x, y, np.ones_like(x)], axis=1) * z[rows, columns, None]
        points = rays @ to_object[:3, :3].T + to_object[:3, 3]
        distance = trimesh.proximity.closest_point(face, points)[1]
        # Carried to another grid: plane within a pixel, so off where the face bends.
        assert np.median(distance) < 1e-4 and np.quantile(distance, 0.95) < 2e-3


def test_a_map_without_distortion_keeps_its_depths(run, folder):
    with rasterio.open(folder / "depth/0000_r01c01.tif") as file:
        z = file.read(1)
    channels, camera = read_depth(run.output("plain", "depth.exr"))
    assert camera["image"]["name"] == "r01c01"
    shutil.copytree(run.output("bare", "files"), folder / "bare")
    with rasterio.open(folder / "bare/depth/0000_r01c01.tif") as file:
        np.testing.assert_array_equal(file.read(1), np.nan_to_num(channels["Z"], nan=0))
    assert z.shape == channels["Z"].shape


def test_the_script_compiles_and_makes_the_documented_calls(folder):
    py_compile.compile(str(folder / "import_depth.py"), doraise=True)
    done = subprocess.run(
        [sys.executable, HERE / "metashape_stub.py", folder / "import_depth.py", folder / "mesh.ply"],
        capture_output=True, text=True, check=False, timeout=60, cwd=folder.parent,
    )
    assert done.returncode == 0, done.stderr
    calls = json.loads(done.stdout.splitlines()[-1])
    names = [name for name, _ in calls]
    assert names == ["save", "importDepthImages", "importCameras", "buildModel", "save", "exportModel"]
    told = dict(calls)
    handed = told["importDepthImages"]
    assert len(handed["filenames"]) == 4 and all((folder / name).is_file() for name in handed["filenames"] + handed["color_filenames"])
    assert told["buildModel"]["source_data"] == "DepthMapsData" and told["exportModel"]["path"] == str(folder / "mesh.ply")


@pytest.mark.parametrize("fault", ["label", "calibration"])
def test_the_script_stops_where_metashape_took_something_otherwise(folder, fault):
    xml = folder / "cameras.xml"
    text = xml.read_text()
    xml.write_text(text.replace('label="0001_', 'label="other_') if fault == "label" else text.replace("<f>", "<f>9"))
    done = subprocess.run(
        [sys.executable, HERE / "metashape_stub.py", folder / "import_depth.py"],
        capture_output=True, text=True, check=False, timeout=60,
    )
    assert done.returncode != 0
    assert ("has no orientation" if fault == "label" else "cameras.xml says") in done.stderr


def test_a_mesh_fused_elsewhere_comes_back(binary, run, folder, tmp_path):
    """What the README says of taking the mesh back, with our own mesh in the place of Metashape's, in single precision."""
    mesh = trimesh.load_mesh(run.output("volume", "mesh.ply"), process=False)
    mesh.export(folder / "fused.ply")  # trimesh writes floats, as Metashape does
    line = next(line for line in (folder / "README.txt").read_text().splitlines() if "import-mesh" in line)
    pipeline = folder / "back.yaml"
    pipeline.write_text(
        f"rockface: 1\nname: back\nsteps:\n  {line.strip()}\n"
        "  clean: {stage: clean-mesh, in: {mesh: fused.mesh}, with: {of: mesh}}\n"
        "  dem: {stage: rasterise-dem, in: {surface: clean.mesh}, with: {cell_m: 0.05, method: tin}}\n"
    )
    back = execute(binary, pipeline, tmp_path)
    again = trimesh.load_mesh(back.output("clean", "mesh.ply"), process=False)
    assert len(again.faces) > 0.9 * len(mesh.faces)
    assert trimesh.proximity.closest_point(mesh, again.vertices[:500])[1].max() < 1e-5
