"""Detection against the publications: SlopeMonitor's recipe, M3C2 of py4dgeo and VoxFall on the same rasters, cell by cell, and the scores."""

import geopandas
import numpy as np
import pandas
import pytest
import rasterio
import trimesh
from rasterio import features

from conftest import HERE, execute
from published import clusters, scores, slope_monitor, vox_fall
from readers import read_cores


@pytest.fixture(scope="module")
def run(binary, tmp_path_factory):
    return execute(binary, HERE / "paper_detection.yaml", tmp_path_factory.mktemp("published"))


def band(path, name=None):
    with rasterio.open(path) as file:
        return file.read(1 + (list(file.descriptions).index(name) if name else 0)).astype(float)


def surface(path):
    """Triangles between the centres of the cells of an elevation raster; with one corner of four missing, the one that is left."""
    with rasterio.open(path) as file:
        z, transform = file.read(1).astype(float), file.transform
    rows, columns = np.indices(z.shape)
    x, y = (np.array(v).reshape(z.shape) for v in rasterio.transform.xy(transform, rows.ravel(), columns.ravel()))
    points = np.stack([x, y, z], axis=-1)
    a, right, below, across = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    whole = {id(corner): np.isfinite(corner[..., 2]) for corner in (a, right, below, across)}
    made = []
    for trio, gone in (((a, below, across), None), ((a, across, right), None), ((right, below, across), a), ((a, below, right), across)):
        there = np.logical_and.reduce([whole[id(corner)] for corner in trio])
        if gone is not None:
            there &= ~whole[id(gone)]
        made.append(np.stack([corner[there] for corner in trio], axis=1))
    return np.concatenate(made)


def same_groups(ours, theirs):
    """Whether two rasters of labels have the same groups of cells, whatever their numbers."""
    np.testing.assert_array_equal(ours > 0, theirs > 0)
    pairs = {tuple(pair) for pair in np.stack([ours[ours > 0], theirs[ours > 0]], axis=1).astype(int)}
    assert len(pairs) == len({a for a, _ in pairs}) == len({b for _, b in pairs})
    return dict(pairs)


def test_slope_monitor_as_published_finds_the_same_cells_and_volumes(run):
    before, after = (band(run.output("dem", "raster.tif", f"epoch={epoch}")) for epoch in ("pre", "post"))
    labels, volumes = slope_monitor(before, after, 0.02, 0.03, 2, 0.2, 4)
    pairs = same_groups(band(run.output("raster", "labels.tif")), labels)
    found = geopandas.read_file(run.output("raster", "detections.geojson"))
    assert len(pairs) == len(found) >= 5
    for row in found.itertuples():
        np.testing.assert_allclose(row.volume_m3, volumes[pairs[row.id] - 1], rtol=1e-5)


def test_m3c2_of_py4dgeo_finds_the_same_cells(run):
    py4dgeo = pytest.importorskip("py4dgeo")
    clouds = [
        np.asarray(trimesh.load(run.output("points", "mesh.ply", f"epoch={epoch}"), process=False).vertices)
        for epoch in ("pre", "post")
    ]
    path = run.output("m3c2", "distances.tif")
    cores = read_cores(path)
    ours = band(path, "distance")
    known = np.isfinite(ours)
    method = py4dgeo.M3C2(
        epochs=tuple(py4dgeo.Epoch(cloud) for cloud in clouds),
        # Every core is a point of the reference: one that lies exactly at its core py4dgeo counts twice or not at all.
        corepoints=cores[known] + 1e-9,
        cyl_radius=0.05,
        normal_radii=[0.3],
        max_distance=0.5,
        registration_error=0.004,
    )
    distances, uncertainties = method.run()
    np.testing.assert_allclose(distances, ours[known], atol=1e-6)
    changed = np.zeros(known.shape, dtype=bool)
    changed[known] = distances < -uncertainties["lodetection"]
    labels = band(run.output("m3c2", "labels.tif"))
    # A distance at its limit to the last digit may fall to either side.
    edge = np.zeros(known.shape, dtype=bool)
    edge[known] = np.abs(np.abs(distances) - uncertainties["lodetection"]) < 1e-6
    # Cells without a core point or a distance count to the nearest core point that has one, which py4dgeo does not do.
    assert ((labels > 0) != changed)[known & ~edge].sum() == 0 and changed.sum() > 100
    assert ((labels > 0) & ~known).sum() < 0.05 * changed.sum()
    if not edge.any():
        assert len(clusters(changed)) == len(geopandas.read_file(run.output("m3c2", "detections.geojson")))


def test_vox_fall_as_published_finds_the_same_columns_and_volumes(run):
    theirs = vox_fall([surface(run.output("shape", "raster.tif", f"epoch={epoch}")) for epoch in ("pre", "post")], 0.05)
    found = geopandas.read_file(run.output("voxels", "detections.geojson"))
    with rasterio.open(run.output("voxels", "labels.tif")) as file:
        labels, transform = file.read(1), file.transform
    assert len(found) >= 3
    for row in found.itertuples():
        rows, columns = np.nonzero(labels == row.id)
        x, y = rasterio.transform.xy(transform, rows, columns)
        ours = set(zip(np.floor(np.array(x) / 0.05).astype(int), np.floor(np.array(y) / 0.05).astype(int)))
        same = [volume for voxels, volume in theirs if {(a, b) for a, b, _ in voxels} >= ours]
        assert same and np.min(np.abs(np.array(same) - row.volume_m3)) < 1e-9, (row.id, row.volume_m3, same)


def test_scores_follow_from_the_cells(run):
    truth = geopandas.read_file(run.output("score", "truth.geojson"))
    found = geopandas.read_file(run.output("score", "detections.geojson"))
    with rasterio.open(run.output("change", "raster.tif")) as grid:
        compared = np.isfinite(grid.read(1))
        masks = [
            [features.rasterize([outline], out_shape=grid.shape, transform=grid.transform).astype(bool) for outline in side.geometry]
            for side in (truth, found)
        ]
    summary = pandas.read_csv(run.output("score", "summary.csv")).iloc[0]
    precision, recall, f1 = scores(*masks, compared)
    np.testing.assert_allclose([summary.precision, summary.recall, summary.f1], [precision, recall, f1], rtol=1e-12)
