"""Fusion: COLMAP itself fuses our depth maps, and what comes out is our fusion's surface within what noise allows."""

import shutil
import subprocess
import sys

import numpy as np
import pytest
import trimesh

from conftest import HERE, execute
from readers import read_cloud

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap cannot be imported", exc_type=ImportError)

GSD_M = 6.0 / 900
OUTCROP = HERE / "../../../shared/data/outcrop-survey/face.ply"


def tool():
    """The Python these tests run in has pycolmap."""
    return ["--set", f"params.python={sys.executable}", "--set", f"params.version={pycolmap.__version__}"]


@pytest.fixture(scope="module")
def fusion(binary, tmp_path_factory):
    return execute(binary, HERE / "fusion.yaml", tmp_path_factory.mktemp("fusion"), *tool())


def inside(points, half_width, half_height):
    return (np.abs(points[:, 0]) < half_width) & (np.abs(points[:, 1]) < half_height)


def distances(mesh, points, count=4000):
    """Distances of some of the points to a mesh, with the sign of its normals."""
    chosen = np.random.default_rng(4).choice(len(points), min(count, len(points)), replace=False)
    near, distance, triangle = trimesh.proximity.closest_point(mesh, points[chosen])
    side = np.einsum("ij,ij->i", points[chosen] - near, mesh.face_normals[triangle])
    return np.copysign(distance, side)


def told(name, values):
    print(f"{name}: median {np.median(values) * 1e3:+.2f} mm, 95 % within {np.quantile(np.abs(values), 0.95) * 1e3:.2f} mm")


def test_exact_maps_come_back_as_the_face(fusion):
    face = trimesh.load_mesh(fusion.output("face", "mesh.ply"), process=False)
    cloud = read_cloud(fusion.output("exact", "cloud.ply"))
    assert cloud["frame"] == "wall" and len(cloud["points"]) > 50_000
    found = distances(face, cloud["points"][inside(cloud["points"], 1.6, 1.1)])
    told("exact maps to the face", found)
    assert abs(np.median(found)) < 0.02 * GSD_M
    assert np.quantile(np.abs(found), 0.95) < 0.15 * GSD_M


def test_normals_are_those_of_the_face(fusion):
    face = trimesh.load_mesh(fusion.output("face", "mesh.ply"), process=False)
    cloud = read_cloud(fusion.output("exact", "cloud.ply"))
    chosen = np.random.default_rng(4).choice(len(cloud["points"]), 3000, replace=False)
    _, _, triangle = trimesh.proximity.closest_point(face, cloud["points"][chosen])
    cosine = np.einsum("ij,ij->i", cloud["normals"][chosen], face.face_normals[triangle])
    assert np.degrees(np.arccos(np.clip(np.median(cosine), -1, 1))) < 8
    assert np.quantile(cosine, 0.02) > 0.5


def agree(run):
    """COLMAP's cloud and our mesh of a run agree; gives back the cloud."""
    face = trimesh.load_mesh(run.output("face", "mesh.ply"), process=False)
    ours = trimesh.load_mesh(run.output("volume", "mesh.ply"), process=False)
    cloud = read_cloud(run.output("fused", "cloud.ply"))
    points = cloud["points"][inside(cloud["points"], 1.5, 1.0)]
    apart, theirs, own = distances(ours, points), distances(face, points), distances(face, ours.vertices)
    for name, values in [("COLMAP to ours", apart), ("COLMAP to the face", theirs), ("ours to the face", own)]:
        told(name, values)
    # No shift between the two, and no farther from each other than both are from the truth.
    assert abs(np.median(apart)) < 0.1 * GSD_M
    noise = np.hypot(np.quantile(np.abs(theirs), 0.95), np.quantile(np.abs(own), 0.95))
    assert np.quantile(np.abs(apart), 0.95) < 1.1 * noise
    return cloud


def test_colmap_and_our_fusion_agree(fusion):
    cloud = agree(fusion)
    assert cloud["views"].min() >= 2 and cloud["views"].mean() > 2.5


def test_the_poisson_mesh_lies_on_the_cloud(fusion):
    mesh = trimesh.load_mesh(fusion.output("fused", "mesh.ply"), process=False)
    face = trimesh.load_mesh(fusion.output("face", "mesh.ply"), process=False)
    found = distances(face, mesh.vertices[inside(mesh.vertices, 1.5, 1.0)])
    told("Poisson mesh to the face", found)
    assert abs(np.median(found)) < 0.3 * GSD_M and np.quantile(np.abs(found), 0.95) < 2 * GSD_M


def test_the_same_maps_give_the_same_bytes(binary, fusion, tmp_path):
    again = execute(binary, HERE / "fusion.yaml", tmp_path, *tool(), "--target", "fused", "--jobs", "1")
    for file in ["cloud.ply", "mesh.ply"]:
        assert again.output("fused", file).read_bytes() == fusion.output("fused", file).read_bytes()


@pytest.mark.skipif(shutil.which("colmap") is None, reason="the program colmap is not there")
def test_the_command_line_program_makes_the_same_cloud(binary, fusion, tmp_path):
    help_text = subprocess.run(["colmap", "help"], capture_output=True, text=True, check=True, timeout=60).stdout
    program = ["engine=colmap", "program=colmap", f'version="{help_text.split()[1]}"']
    sets = [word for change in program for word in ("--set", f"steps.exact.with.{change}")]
    run = execute(binary, HERE / "fusion.yaml", tmp_path, *tool(), *sets, "--target", "exact")
    theirs, ours = (read_cloud(folder.output("exact", "cloud.ply")) for folder in (run, fusion))
    assert len(theirs["points"]) == len(ours["points"])
    np.testing.assert_allclose(theirs["points"], ours["points"], rtol=0, atol=1e-5)
    np.testing.assert_array_equal(theirs["views"], ours["views"])


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        (["params.python=/nowhere/bin/python"], ["cannot run `/nowhere/bin/python`", "pip install pycolmap"]),
        (["params.version=3.8"], ["`version` says 3.8", f'write `version: "{pycolmap.__version__}"`']),
        (["params.poisson.trim=9.6"], ["the Poisson mesh is empty", "lower `trim`"]),
    ],
)
def test_what_is_wrong_is_said_with_a_way_out(binary, tmp_path, changes, told):
    sets = [word for change in changes for word in ("--set", change)]
    command = [binary, "run", HERE / "fusion.yaml", "--target", "fused", "--quiet", *tool(), *sets]
    places = ["--store", tmp_path / "store", "--runs", tmp_path / "runs"]
    done = subprocess.run([*command, *places], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 1
    assert all(text in done.stderr + done.stdout for text in told), done.stderr + done.stdout


@pytest.mark.skipif(not OUTCROP.is_file(), reason="the outcrop is not there")
def test_on_the_outcrop(binary, tmp_path):
    """The same block before a real rock face."""
    real = ["--set", "steps.face={stage: import-mesh, with: {path: " + str(OUTCROP.resolve()) + ", frame: wall}}"]
    agree(execute(binary, HERE / "fusion.yaml", tmp_path, *tool(), *real, "--target", "fused", "--target", "volume"))
