"""Ground truth: what trimesh, geopandas and rasterio find in our pieces, inventory and labels agrees to the last digits."""

import json

import geopandas
import numpy as np
import pandas
import pytest
import rasterio
import trimesh


@pytest.fixture(scope="module")
def inventory(rockfall):
    return geopandas.read_file(rockfall.output("removed", "truth.geojson"))


def piece(rockfall, port, number):
    return trimesh.load_mesh(rockfall.output("removed", f"{port}/{number}.ply"), process=False)


def test_pieces_are_watertight_and_have_their_volumes(rockfall, inventory):
    assert len(inventory) > 0
    for row in inventory.itertuples():
        mesh = piece(rockfall, "pieces", row.id)
        assert mesh.is_watertight and mesh.is_winding_consistent
        np.testing.assert_allclose(mesh.volume, row.removed_m3, rtol=1e-9)
        np.testing.assert_allclose(mesh.bounds.ravel()[[0, 5]], [row.box_min_x_m, row.box_max_z_m], atol=1e-12)
        centroid = [row.centroid_x_m, row.centroid_y_m, row.centroid_z_m]
        np.testing.assert_allclose(mesh.center_mass, centroid, atol=1e-7)


def test_blocks_and_niches_have_their_measures(rockfall, inventory):
    for row in inventory.itertuples():
        np.testing.assert_allclose(piece(rockfall, "blocks", row.event).volume, row.block_m3, rtol=1e-9)
        niche = piece(rockfall, "niches", row.id)
        assert not niche.is_watertight
        np.testing.assert_allclose(niche.area, row.niche_area_m2, rtol=1e-9)


def test_the_oriented_box_is_no_larger_than_that_of_trimesh(rockfall, inventory):
    for row in inventory.itertuples():
        _, sides = trimesh.bounds.oriented_bounds(piece(rockfall, "pieces", row.id))
        ours = row.long_m * row.intermediate_m * row.short_m
        assert row.long_m >= row.intermediate_m >= row.short_m
        assert ours <= np.prod(sides) * 1.02


def test_one_file_tells_its_parts_apart(rockfall, inventory):
    mesh = trimesh.load_mesh(rockfall.output("removed", "pieces.ply"), process=False)
    raw = mesh.metadata["_ply_raw"]
    part = np.asarray(raw["face"]["data"]["part"]).ravel()
    np.testing.assert_array_equal(np.unique(part), np.arange(len(inventory)))
    np.testing.assert_array_equal(np.asarray(raw["vertex"]["data"]["part"]).ravel()[mesh.faces[:, 0]], part)
    for number, row in enumerate(inventory.itertuples()):
        faces = mesh.faces[part == number]
        alone = trimesh.Trimesh(mesh.vertices, faces, process=False)
        np.testing.assert_allclose(alone.volume, row.removed_m3, rtol=1e-9)


def test_the_inventory_has_a_local_system_in_metres_and_valid_outlines(rockfall, inventory):
    assert inventory.crs.is_engineering and inventory.crs.name == "rockface wall frame"
    assert [axis.unit_name for axis in inventory.crs.axis_info] == ["metre", "metre"]
    assert json.loads(rockfall.output("removed", "truth.geojson").read_text())["rockface"]["frame"] == "wall"
    assert pandas.api.types.is_integer_dtype(inventory["id"])
    with rasterio.open(rockfall.output("removed", "labels.tif")) as file:
        cell = file.transform.a**2
    seen = inventory[inventory.cells > 0]
    assert seen.geometry.is_valid.all()
    np.testing.assert_allclose(seen.geometry.area, seen.cells * cell, rtol=1e-9)


def test_the_table_is_the_inventory_without_outlines(rockfall, inventory):
    table = pandas.read_csv(rockfall.output("removed", "truth.csv"), float_precision="round_trip")
    assert list(table.columns) == [name for name in inventory.columns if name != "geometry"]
    np.testing.assert_array_equal(table.removed_m3, inventory.removed_m3)


def test_labels_and_depths_agree_with_the_inventory(rockfall, inventory):
    with rasterio.open(rockfall.output("removed", "labels.tif")) as file:
        labels, cell = file.read(1), file.transform.a
        assert file.dtypes == ("uint16",) and file.tags()["QUANTITY"] == "label"
    with rasterio.open(rockfall.output("removed", "depth.tif")) as file:
        depth = file.read(1).astype(float)
    for row in inventory.itertuples():
        mine = labels == row.id
        assert mine.sum() == row.cells
        np.testing.assert_allclose(depth[mine].sum() * cell**2, row.raster_m3, rtol=1e-5, atol=1e-9)
    assert (depth[labels > 0] > 0).all()
    assert np.nanmax(np.abs(depth[labels == 0])) == 0
