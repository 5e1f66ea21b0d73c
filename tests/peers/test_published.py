"""Detection against its publication: SlopeMonitor's recipe on the same rasters, cell by cell."""

import geopandas
import numpy as np
import pytest
import rasterio

from conftest import HERE, execute
from published import slope_monitor


@pytest.fixture(scope="module")
def run(binary, tmp_path_factory):
    return execute(binary, HERE / "paper_detection.yaml", tmp_path_factory.mktemp("published"))


def band(path, name=None):
    with rasterio.open(path) as file:
        return file.read(1 + (list(file.descriptions).index(name) if name else 0)).astype(float)


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
