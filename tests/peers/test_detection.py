"""Detection: py4dgeo finds our distances and limits, scikit-image our clusters, SciPy our enclosed voxels, NumPy our tiles."""

import hashlib
import json
import sys
import types

import geopandas
import numpy as np
import pandas
import pyproj
import pytest
import rasterio
import trimesh
from rasterio import features
from scipy import ndimage, optimize

from conftest import HERE, execute
from readers import read_cores


@pytest.fixture(scope="module")
def detection(binary, tmp_path_factory):
    return execute(binary, HERE / "detection.yaml", tmp_path_factory.mktemp("detection"))


def band(path, name=None):
    with rasterio.open(path) as file:
        names = list(file.descriptions)
        return file.read(1 + (names.index(name) if name else 0)).astype(float)


def test_m3c2_agrees_with_py4dgeo(detection):
    py4dgeo = pytest.importorskip("py4dgeo")
    clouds = [
        np.asarray(trimesh.load(detection.output("cloud", "mesh.ply", f"epoch={epoch}"), process=False).vertices)
        for epoch in ("pre", "post")
    ]
    path = detection.output("m3c2", "distances.tif")
    ours = {name: band(path, name) for name in ("distance", "lod95", "spread_reference", "points_comparison")}
    normals = np.stack([band(path, f"normal_{axis}") for axis in "xyz"], axis=-1)
    known = np.isfinite(ours["distance"])
    cores = read_cores(path)[known]
    method = py4dgeo.M3C2(
        epochs=tuple(py4dgeo.Epoch(cloud) for cloud in clouds),
        corepoints=cores,
        cyl_radius=0.08,
        # One radius: of several, py4dgeo takes another than the most planar, (l2 - l3) / l1.
        normal_radii=[0.3],
        max_distance=0.5,
        registration_error=0.004,
    )
    distances, uncertainties = method.run()
    both = np.isfinite(distances)
    assert both.sum() > 300 and both.mean() > 0.99
    np.testing.assert_allclose(method.corepoint_normals[both], normals[known][both], atol=1e-5)
    np.testing.assert_allclose(ours["distance"][known][both], distances[both], atol=1e-6, rtol=0)
    np.testing.assert_allclose(ours["lod95"][known][both], uncertainties["lodetection"][both], atol=1e-6, rtol=0)
    np.testing.assert_array_equal(ours["points_comparison"][known][both], uncertainties["num_samples2"][both])
    np.testing.assert_allclose(ours["spread_reference"][known][both], uncertainties["spread1"][both], atol=1e-6)


def test_clusters_agree_with_scikit_image(detection):
    measure = pytest.importorskip("skimage.measure")
    morphology = pytest.importorskip("skimage.morphology")
    difference = band(detection.output("change", "raster.tif"))
    lost = difference < -np.float32(0.02)
    opened = morphology.opening(lost, np.ones((3, 3), dtype=bool))
    labels = measure.label(opened, connectivity=2)
    regions = [region for region in measure.regionprops(labels) if region.area >= 8]
    found = geopandas.read_file(detection.output("raster", "detections.geojson"))
    assert len(regions) == len(found) > 0
    ours = band(detection.output("raster", "labels.tif"))
    for number, (region, row) in enumerate(zip(regions, found.itertuples()), start=1):
        mask = labels == region.label
        np.testing.assert_array_equal(mask, ours == number)
        np.testing.assert_allclose(row.volume_m3, -difference[mask].sum() * 4e-4, rtol=1e-6)
        np.testing.assert_allclose(row.geometry.area, row.area_m2, rtol=1e-9)


def meets(triangle, centres, half):
    """Which cubes of half edge `half` a triangle meets, by thirteen separating axes."""
    corners = triangle[None, :, :] - centres[:, None, :]
    edges = np.roll(triangle, -1, axis=0) - triangle
    axes = [*np.eye(3), np.cross(edges[0], edges[1])] + [np.cross(unit, edge) for unit in np.eye(3) for edge in edges]
    inside = np.ones(len(centres), dtype=bool)
    for axis in axes:
        along = corners @ axis
        reach = half * np.abs(axis).sum()
        inside &= (along.min(axis=1) <= reach) & (along.max(axis=1) >= -reach)
    return inside


def test_voxels_agree_with_a_direct_count(detection):
    edge = 0.043
    meshes = [
        trimesh.load(detection.output("face", "mesh.ply"), process=False),
        trimesh.load(detection.output("fallen", "mesh.ply"), process=False),
    ]
    used = [mesh.vertices[np.unique(mesh.faces)] for mesh in meshes]
    low = np.floor(np.min([v.min(axis=0) for v in used], axis=0) / edge).astype(int) - 1
    high = np.floor(np.max([v.max(axis=0) for v in used], axis=0) / edge).astype(int) + 2
    grid = np.zeros(high - low, dtype=bool)
    for mesh in meshes:
        for triangle in mesh.triangles:
            first = np.floor(triangle.min(axis=0) / edge).astype(int)
            last = np.floor(triangle.max(axis=0) / edge).astype(int) + 1
            index = np.stack(np.meshgrid(*[np.arange(a, b) for a, b in zip(first, last)], indexing="ij"), axis=-1).reshape(-1, 3)
            hit = index[meets(triangle, (index + 0.5) * edge, 0.5 * edge)] - low
            grid[tuple(hit.T)] = True
    enclosed = ndimage.binary_fill_holes(grid) & ~grid
    labels, count = ndimage.label(enclosed, structure=np.ones((3, 3, 3)))
    volumes = []
    for number in range(1, count + 1):
        inside = labels == number
        shell = ndimage.binary_dilation(inside, structure=np.ones((3, 3, 3))) & ~inside
        volumes.append(edge**3 * (inside.sum() + shell.sum() / 2))
    found = geopandas.read_file(detection.output("voxels", "detections.geojson"))
    assert len(found) > 0
    # Every cluster of ours is one of these; those of no loss are left out.
    for volume in found.volume_m3:
        assert np.min(np.abs(np.array(volumes) - volume)) < 1e-9
    # Pockets between the two surfaces that are no loss are small; every niche is found, those under overhangs too.
    assert sum(volumes) - found.volume_m3.sum() <= 0.02 * sum(volumes)
    assert len(found) == len(geopandas.read_file(detection.output("fallen", "truth.geojson")))


def cells_of(outline, grid):
    """Which cells of a raster have their centre inside an outline."""
    if outline is None or outline.is_empty:
        return np.zeros(grid.shape, dtype=bool)
    return features.rasterize([outline], out_shape=grid.shape, transform=grid.transform).astype(bool)


def test_scores_agree_with_scipy(detection):
    truth = geopandas.read_file(detection.output("score", "truth.geojson"))
    found = geopandas.read_file(detection.output("score", "detections.geojson"))
    summary = pandas.read_csv(detection.output("score", "summary.csv")).iloc[0]
    with rasterio.open(detection.output("change", "raster.tif")) as grid:
        # Compared is where both surveys have a value.
        seen = np.isfinite(grid.read(1))
        true, ours = ([cells_of(outline, grid) & seen for outline in side.geometry] for side in (truth, found))
    iou = np.array([[(a & b).sum() / max((a | b).sum(), 1) for b in ours] for a in true])
    rows, columns = optimize.linear_sum_assignment(-iou)
    pairs = {(truth.id[i], found.id[j]): iou[i, j] for i, j in zip(rows, columns) if iou[i, j] > 0}
    assert len(pairs) == summary.pairs > 0
    told = {(row.id, row.detection): row.iou for row in truth.itertuples() if row.iou > 0}
    assert told == pytest.approx(pairs, rel=1e-9)
    np.testing.assert_allclose(summary.precision, (found.outcome == "true_positive").sum() / len(found))
    assert summary.cells_true_positive == (np.any(true, axis=0) & np.any(ours, axis=0)).sum()


def test_the_data_set_opens_and_its_sums_hold(detection, tmp_path):
    folder = detection.output("tiles", "dataset")
    for line in (folder / "SHA256SUMS").read_text().splitlines():
        digest, name = line.split("  ")
        assert hashlib.sha256((folder / name).read_bytes()).hexdigest() == digest
    index = pandas.read_csv(folder / "index.csv")
    assert len(index) > 0
    row = index.iloc[0]
    tile = np.load(folder / "tiles" / row.split / f"{row.tile}.npz")
    assert tile["difference"].shape == (64, 64) and tile["instances"].dtype == np.uint16
    assert tile["mask"].sum() == row.changed_cells
    assert (tile["mask"].astype(bool) & np.isfinite(tile["difference"])).sum() == row.changed_valid_cells
    for one in index.itertuples():
        losses = json.loads((folder / one.truth).read_text())["features"]
        with np.load(folder / "tiles" / one.split / f"{one.tile}.npz") as arrays:
            assert set(np.unique(arrays["instances"])) - {0} <= {loss["properties"]["id"] for loss in losses}
    stem = folder / "tiles" / row.split / row.tile
    with rasterio.open(f"{stem}_difference.tif") as file:
        np.testing.assert_array_equal(file.read(1), tile["difference"])
        np.testing.assert_allclose([file.transform.c, file.transform.f], tile["transform"][[2, 5]])
    catalogue = json.loads((folder / "stac" / "catalog.json").read_text())
    items = [link for link in catalogue["links"] if link["rel"] == "item"]
    assert len(items) == len(index)
    item = json.loads((folder / "stac" / items[0]["href"]).read_text())
    for asset in item["assets"].values():
        path = (folder / "stac" / "items" / asset["href"]).resolve()
        assert path.stat().st_size == asset["file:size"]
        assert asset["file:checksum"] == "1220" + hashlib.sha256(path.read_bytes()).hexdigest()


def test_the_catalogue_is_valid_stac(detection):
    from pystac.validation import validate_dict

    folder = detection.output("tiles", "dataset") / "stac"
    files = [folder / "catalog.json", *sorted((folder / "items").glob("*.json"))]
    assert len(files) > 1
    for file in files:
        told = json.loads(file.read_text())
        # The core by its own schema; those of extensions are not to be had without a network.
        extensions = told.pop("stac_extensions", [])
        assert validate_dict(told | {"stac_extensions": []})
        if told["type"] == "Feature":
            assert [name.split("/")[3] for name in extensions] == ["projection", "file"]
            system = pyproj.CRS.from_wkt(told["properties"]["proj:wkt2"])
            assert system.is_engineering and {axis.unit_name for axis in system.axis_info} == {"metre"}
            assert told["properties"]["proj:shape"] == [64, 64]


def test_the_data_set_of_the_documentation_loads(detection, monkeypatch):
    text = (HERE / "../../docs/dataset.md").read_text()
    code = text.split("```python\n")[1].split("```")[0]
    if "torch" not in sys.modules:
        try:
            import torch  # noqa: F401
        except ImportError:
            # The class needs of PyTorch its base class and the conversion of arrays.
            torch = types.ModuleType("torch")
            torch.from_numpy = lambda array: array
            utils, data = types.ModuleType("torch.utils"), types.ModuleType("torch.utils.data")
            data.Dataset = object
            for name, module in {"torch": torch, "torch.utils": utils, "torch.utils.data": data}.items():
                monkeypatch.setitem(sys.modules, name, module)
    scope = {}
    exec(code, scope)  # our own documentation
    loaded = scope["Rockfalls"](detection.output("tiles", "dataset"), "train")
    image, mask, row = loaded[0]
    assert image.shape == (4, 64, 64) and mask.shape == (64, 64)
    assert np.isfinite(np.asarray(image)).all() and row["split"] == "train"
