"""The other way round: files that rasterio and trimesh write are read by us without loss."""

import json
import shutil
import warnings

import numpy as np
import pytest
import rasterio
import trimesh

from conftest import HERE, execute
from foreign import GRID, write_rasters

OFFSET_M = np.array([356000.0, 6387000.0, 120.0])


@pytest.fixture(scope="module")
def box():
    return trimesh.creation.icosphere(subdivisions=3)


@pytest.fixture(scope="module")
def site():
    """A tilted, bumpy face that looks south-east, near the origin; the rock is north-west of it."""
    across, up = np.meshgrid(np.linspace(-5, 5, 51), np.linspace(-3, 3, 31))
    bumps = 0.1 * np.sin(1.7 * across) * np.cos(2.3 * up)
    flat = np.stack([across, up, bumps], axis=-1).reshape(-1, 3)
    corner = (np.arange(30)[:, None] * 51 + np.arange(50)).ravel()
    faces = np.concatenate([corner[:, None] + [0, 1, 52], corner[:, None] + [0, 52, 51]])
    face = trimesh.Trimesh(flat, faces, process=False)
    out, horizontal = np.array([0.6, -0.7, 0.3]), np.array([0.7, 0.6, 0.0])
    out, horizontal = out / np.linalg.norm(out), horizontal / np.linalg.norm(horizontal)
    face.vertices = flat @ np.stack([horizontal, np.cross(out, horizontal), out])
    return face


@pytest.fixture(scope="module")
def read_by_us(binary, box, site, tmp_path_factory):
    folder = tmp_path_factory.mktemp("foreign")
    written = write_rasters(folder / "real")
    (folder / "face.ply").write_bytes(trimesh.exchange.ply.export_ply(box, encoding="ascii"))
    (folder / "site.ply").write_bytes(trimesh.exchange.ply.export_ply(site))
    shutil.copy(HERE / "foreign.yaml", folder)
    return execute(binary, folder / "foreign.yaml", folder), written


def test_rasters_of_every_encoding_come_back(read_by_us):
    run, written = read_by_us
    with rasterio.open(run.output("rasters", "raster.tif")) as file:
        assert file.descriptions == tuple(written)
        assert file.transform == GRID and file.tags()["QUANTITY"] == "difference"
        for band, values in enumerate(written.values(), start=1):
            np.testing.assert_array_equal(file.read(band), values)


def test_a_mesh_of_trimesh_comes_back(read_by_us, box):
    run, _ = read_by_us
    mesh = trimesh.load_mesh(run.output("mesh", "mesh.ply"), process=False)
    np.testing.assert_array_equal(mesh.faces, box.faces)
    np.testing.assert_allclose(mesh.vertices, box.vertices, rtol=0, atol=1e-7)
    assert mesh.is_watertight and mesh.volume > 0


def test_a_site_in_map_coordinates_goes_to_the_wall_and_back(read_by_us, site):
    run, _ = read_by_us
    in_world = trimesh.load_mesh(run.output("site", "mesh.ply"), process=False)
    np.testing.assert_allclose(in_world.vertices - OFFSET_M, site.vertices, rtol=0, atol=1e-6)
    in_wall = trimesh.load_mesh(run.output("wall", "mesh.ply"), process=False)
    transform = json.loads(run.output("wall", "transform.json").read_text())
    assert (transform["from"], transform["to"]) == ("world", "wall")
    rotation = np.array(transform["rotation"])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(rotation) > 0
    moved = (in_world.vertices - transform["origin"]) @ rotation.T + transform["translation"]
    np.testing.assert_allclose(in_wall.vertices, moved, rtol=0, atol=1e-8)
    np.testing.assert_array_equal(in_wall.faces, site.faces)
    # X is horizontal, Y points up the face, Z out of the rock: along the normal numpy finds.
    normal = (site.face_normals * site.area_faces[:, None]).sum(axis=0)
    normal /= np.linalg.norm(normal)
    assert np.degrees(np.arccos(rotation[2] @ normal)) < 0.5
    assert abs(rotation[0, 2]) < 1e-12 and rotation[1, 2] > 0
    assert abs(in_wall.vertices[:, 2].mean()) < 0.01


def test_a_picture_opens(read_by_us):
    run, _ = read_by_us
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(run.output("picture", "picture.png")) as file:
            assert file.driver == "PNG" and file.width <= 900 and file.count in (3, 4)
            pixels = file.read()
    assert len(np.unique(pixels.reshape(len(pixels), -1), axis=1).T) > 100
