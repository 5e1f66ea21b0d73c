"""The other way round: files that rasterio and trimesh write are read by us without loss."""

import shutil

import numpy as np
import pytest
import rasterio
import trimesh

from conftest import HERE, execute
from foreign import GRID, write_rasters


@pytest.fixture(scope="module")
def box():
    return trimesh.creation.icosphere(subdivisions=3)


@pytest.fixture(scope="module")
def read_by_us(binary, box, tmp_path_factory):
    folder = tmp_path_factory.mktemp("foreign")
    written = write_rasters(folder / "real")
    (folder / "face.ply").write_bytes(trimesh.exchange.ply.export_ply(box, encoding="ascii"))
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
