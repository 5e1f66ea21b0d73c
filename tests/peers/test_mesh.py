"""Meshes: what trimesh and Open3D find in our PLY is what we say is in it."""

import numpy as np
import pytest
import trimesh


@pytest.fixture(scope="module")
def path(survey):
    return survey.output("face", "mesh.ply")


@pytest.fixture(scope="module")
def header(path):
    return path.read_bytes().split(b"end_header\n")[0].decode().splitlines()


@pytest.fixture(scope="module")
def mesh(path):
    return trimesh.load_mesh(path, process=False)


def declared(header, element):
    return int(next(line.split()[2] for line in header if line.startswith(f"element {element} ")))


def test_counts_are_those_of_the_header(mesh, header):
    assert len(mesh.vertices) == declared(header, "vertex") == 201 * 151
    assert len(mesh.faces) == declared(header, "face") == 2 * 200 * 150


def test_the_file_holds_nothing_after_its_elements(path, header):
    body = path.read_bytes().split(b"end_header\n", 1)[1]
    assert len(body) == declared(header, "vertex") * 24 + declared(header, "face") * 13


def test_coordinates_are_doubles(mesh, header):
    assert [line.split()[1] for line in header if line.startswith("property") and "list" not in line] == ["double"] * 3
    assert mesh.vertices.dtype == np.float64 and np.isfinite(mesh.vertices).all()
    assert not np.array_equal(mesh.vertices, mesh.vertices.astype(np.float32))


def test_extent_and_relief_are_those_asked_for(mesh):
    np.testing.assert_allclose(mesh.bounds[:, :2], [[-2, -1.5], [2, 1.5]], atol=1e-12)
    assert abs(mesh.vertices[:, 2].mean()) < 1e-9
    assert 0.05 < mesh.vertices[:, 2].std() < 0.5


def test_it_faces_out_of_the_rock(mesh):
    assert (mesh.face_normals[:, 2] > 0).all()
    mean = (mesh.face_normals * mesh.area_faces[:, None]).sum(axis=0) / mesh.area_faces.sum()
    assert mean[2] > 0.5 and np.abs(mean[:2]).max() < 0.1
    np.testing.assert_allclose((mesh.face_normals[:, 2] * mesh.area_faces).sum(), 4 * 3, rtol=1e-9)


def test_it_is_one_consistently_oriented_sheet(mesh):
    assert mesh.is_winding_consistent and mesh.body_count == 1 and mesh.euler_number == 1
    assert not mesh.is_watertight


def test_open3d_finds_the_same(path, mesh):
    open3d = pytest.importorskip("open3d", reason="open3d cannot be imported", exc_type=ImportError)
    read = open3d.io.read_triangle_mesh(str(path))
    np.testing.assert_array_equal(np.asarray(read.triangles), mesh.faces)
    np.testing.assert_array_equal(np.asarray(read.vertices), mesh.vertices)
