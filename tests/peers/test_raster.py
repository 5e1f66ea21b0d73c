"""Rasters: what rasterio finds in our GeoTIFF, and whether independent gridding gives the same values."""

import json

import numpy as np
import pytest
import rasterio
import trimesh
from mcap.reader import make_reader
from rasterio.enums import Interleaving
from rasterio.transform import from_origin

import describe
from readers import read_surface

WINDOW = (-1.5, 1.5, -1.04, 1.04)


METRICS = ["mean_m", "std_m", "nmad_m"]


def entries(survey, step):
    """What a step of one instance said in the log of the run."""
    with (survey.folder / "run.mcap").open("rb") as file:
        [(_, _, message)] = make_reader(file).iter_messages(topics=[f"/{step}/step"])
    return json.loads(message.data)["entries"]


def read(path):
    with rasterio.open(path) as file:
        return file.read(1), file.transform


@pytest.fixture(scope="module")
def face(survey):
    return trimesh.load_mesh(survey.output("face", "mesh.ply"), process=False)


@pytest.mark.parametrize(
    ("step", "point", "quantity"), [("dem", "epoch=pre", "elevation"), ("change", "", "difference")]
)
def test_the_file_says_what_it_holds(survey, step, point, quantity):
    with rasterio.open(survey.output(step, "raster.tif", point)) as file:
        assert file.transform.almost_equals(from_origin(WINDOW[0], WINDOW[3], 0.02, 0.02), 1e-12)
        assert (file.width, file.height, file.count) == (150, 104, 1)
        assert file.dtypes == ("float32",) and np.isnan(file.nodata)
        assert file.descriptions == (quantity,)
        assert file.tags()["FRAME"] == "wall" and file.tags()["QUANTITY"] == quantity
        assert file.tags()["AREA_OR_POINT"] == "Area"
        assert not file.crs.is_geographic and 'UNIT["metre",1' in file.crs.to_wkt()
        assert file.interleaving == Interleaving.band
        assert np.array_equal(file.read_masks(1) == 0, np.isnan(file.read(1)))


@pytest.mark.parametrize("epoch", ["pre", "post"])
def test_a_cell_is_the_mean_of_its_points(survey, epoch):
    values, transform = read(survey.output("dem", "raster.tif", f"epoch={epoch}"))
    points, _, _ = read_surface(survey.output("surface", "surface.surface", f"epoch={epoch}"))
    x, y, z = points[~np.isnan(points[..., 2])].T
    column, row = (np.floor(c).astype(int) for c in ~transform @ (x, y))
    inside = (row >= 0) & (row < values.shape[0]) & (column >= 0) & (column < values.shape[1])
    cell = np.ravel_multi_index((row[inside], column[inside]), values.shape)
    count = np.bincount(cell, minlength=values.size)
    total = np.bincount(cell, weights=z[inside], minlength=values.size)
    expected = np.full(values.size, np.nan)
    expected[count >= 2] = total[count >= 2] / count[count >= 2]
    assert 100 < (count < 2).sum() < values.size / 2, "the minimum count must matter in this test"
    np.testing.assert_allclose(values.ravel(), expected, rtol=0, atol=1e-7)


def test_the_interpolated_raster_is_the_mesh(survey, face):
    values, transform = read(survey.output("tin", "raster.tif"))
    row, column = (rng.ravel() for rng in np.indices(values.shape))
    chosen = np.random.default_rng(1).choice(values.size, 3000, replace=False)
    row, column = row[chosen], column[chosen]
    x, y = transform @ (column + 0.5, row + 0.5)
    origins = np.stack([x, y, np.full_like(x, 10.0)], axis=1)
    hits, ray, _ = face.ray.intersects_location(origins, np.tile([0.0, 0.0, -1.0], (len(x), 1)))
    expected = np.full(len(x), -np.inf)
    np.maximum.at(expected, ray, hits[:, 2])
    expected[np.isinf(expected)] = np.nan
    assert np.isnan(expected).any(), "some cells must lie beside the face in this test"
    np.testing.assert_allclose(values[row, column], expected, rtol=0, atol=1e-6)


def test_a_difference_is_comparison_minus_reference(survey):
    (pre, _), (post, _) = (read(survey.output("dem", "raster.tif", f"epoch={epoch}")) for epoch in ("pre", "post"))
    change, _ = read(survey.output("change", "raster.tif"))
    expected = (post.astype(float) - pre.astype(float)).astype(np.float32)
    np.testing.assert_array_equal(change, expected)
    said = {entry["name"]: entry["value"] for entry in entries(survey, "change") if entry["type"] == "metric"}
    found = describe.marginal(change.astype(float))
    np.testing.assert_allclose([said[name] for name in METRICS], [found[name] for name in METRICS], rtol=1e-9)
