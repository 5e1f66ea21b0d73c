"""Exports for other programs: laspy reads our LAZ with its extra dimensions, and everything is back where it came from."""

import json

import numpy as np
import pytest
import rasterio
import trimesh

from conftest import HERE, execute
from readers import read_cloud, read_surface

laspy = pytest.importorskip("laspy", reason="laspy cannot be imported", exc_type=ImportError)

CORNER = np.array([451_234.0, 5_512_345.0, 231.0])


@pytest.fixture(scope="module")
def run(binary, tmp_path_factory):
    """A cliff of 6 x 4 m that faces south-west, at UTM coordinates."""
    work = tmp_path_factory.mktemp("cloud")
    along, up = np.meshgrid(np.linspace(0, 6, 121), np.linspace(0, 4, 81))
    relief = 0.1 * np.sin(2 * along) * np.cos(3 * up) + 0.02 * np.sin(11 * along + 7 * up)
    direction = np.array([np.cos(0.7), np.sin(0.7), 0.0])
    outward = np.array([np.sin(0.7), -np.cos(0.7), 0.0])
    vertices = CORNER + along[..., None] * direction + up[..., None] * [0, 0, 1] + relief[..., None] * outward
    a = (np.arange(80)[:, None] * 121 + np.arange(120)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + 122], 1), np.stack([a, a + 122, a + 121], 1)])
    face = work / "face.ply"
    # Text keeps all digits of doubles; trimesh would write single precision.
    lines = ["ply", "format ascii 1.0", f"element vertex {vertices.size // 3}"]
    lines += [f"property double {axis}" for axis in "xyz"]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(repr, row)) for row in vertices.reshape(-1, 3).tolist()]
    lines += ["3 " + " ".join(map(str, row)) for row in faces.tolist()]
    face.write_text("\n".join(lines) + "\n")
    return execute(binary, HERE / "cloud.yaml", work, "--set", f"params.face={face}")


@pytest.fixture(scope="module")
def to_world(run):
    told = json.loads(run.output("wall", "transform.json").read_text())
    rotation, origin = np.array(told["rotation"]), np.array(told["origin"])
    assert told["from"] == "world" and told["to"] == "wall"
    return lambda points: (points - told["translation"]) @ rotation + origin


def test_laspy_reads_points_normals_and_numbers(run, to_world):
    las = laspy.read(run.output("points", "cloud.laz"))
    assert str(las.header.version) == "1.4" and las.header.point_format.id == 6
    assert las.header.creation_date is None and str(las.header.generating_software).strip("\0") == "rockface"
    assert list(las.point_format.extra_dimension_names) == ["NormalX", "NormalY", "NormalZ", "id", "label"]
    grid, _, _ = read_surface(run.output("surface", "surface.surface"))
    ids = np.asarray(las["id"])
    rows, columns = np.divmod(ids, grid.shape[1])
    assert (rows % 2 == 0).all() and (columns % 2 == 0).all() and (np.diff(ids.astype(int)) > 0).all()
    assert len(ids) == np.isfinite(grid[::2, ::2, 0]).sum()
    expected = to_world(grid[rows, columns])
    found = np.asarray(las.xyz)
    assert np.abs(found - expected).max() < 0.6e-4  # scale 0.1 mm
    assert (found.min(axis=0) > CORNER - 3).all() and (found.max(axis=0) < CORNER + 8).all()
    normals = np.stack([las[name] for name in ("NormalX", "NormalY", "NormalZ")], axis=1)
    length = np.linalg.norm(normals, axis=1)
    assert np.abs(length[length > 0] - 1).max() < 1e-6 and (length > 0).mean() > 0.99
    # Out of the rock: towards the south-west of this cliff.
    assert np.median(normals @ [np.sin(0.7), -np.cos(0.7), 0]) > 0.9


def test_labels_are_those_of_the_raster_under_the_points(run):
    las = laspy.read(run.output("points", "cloud.laz"))
    grid, _, _ = read_surface(run.output("surface", "surface.surface"))
    rows, columns = np.divmod(np.asarray(las["id"]), grid.shape[1])
    points = grid[rows, columns]
    with rasterio.open(run.output("fallen", "labels.tif")) as raster:
        band, across = raster.read(1), raster.transform
        inverse = ~across
        column, row = inverse @ (points[:, 0], points[:, 1])
        inside = (column >= 0) & (row >= 0) & (column < raster.width) & (row < raster.height)
        expected = np.zeros(len(points), int)
        expected[inside] = band[row[inside].astype(int), column[inside].astype(int)]
    labels = np.asarray(las["label"])
    assert (labels == expected).mean() > 0.9999 and len(set(labels[labels > 0])) >= 2


def test_ply_and_laz_are_the_same_cloud(run):
    cloud, las = read_cloud(run.output("corners", "cloud.ply")), laspy.read(run.output("corners", "cloud.laz"))
    assert cloud["frame"] == "world"
    assert np.abs(cloud["points"] - np.asarray(las.xyz)).max() < 0.6e-4
    np.testing.assert_array_equal(cloud["id"], las["id"])
    np.testing.assert_array_equal(cloud["nx"], las["NormalX"])


def test_vertices_and_mesh_are_back_where_they_came_from(run):
    scan = trimesh.load_mesh(run.output("scan", "mesh.ply"), process=False)
    whole = trimesh.load_mesh(run.output("whole", "mesh.ply"), process=False)
    corners = read_cloud(run.output("corners", "cloud.ply"))["points"]
    # Vertices that no triangle uses, as rock that has fallen leaves them, are no points.
    np.testing.assert_allclose(corners, whole.vertices[np.unique(whole.faces)], rtol=0, atol=2e-9)
    # Where nothing fell the vertices are those of the scan.
    local = [np.round(points - CORNER, 7) + 0.0 for points in (scan.vertices, corners)]
    known = set(map(tuple, local[0]))
    assert np.mean([tuple(point) in known for point in local[1]]) > 0.5
    wall = trimesh.load_mesh(run.output("fallen", "mesh.ply"), process=False)
    np.testing.assert_array_equal(wall.faces, whole.faces)
    assert whole.vertices.dtype == np.float64


def test_cells_of_the_dem_are_points_on_the_cliff(run, to_world):
    cloud = read_cloud(run.output("cells", "cloud.ply"))
    with rasterio.open(run.output("dem", "raster.tif")) as raster:
        z = raster.read(1).ravel()
        rows, columns = np.divmod(cloud["id"], raster.width)
        x, y = raster.transform @ (columns + 0.5, rows + 0.5)
    assert len(cloud["points"]) == np.isfinite(z).sum()
    np.testing.assert_allclose(cloud["points"], to_world(np.stack([x, y, z[cloud["id"]]], axis=1)), rtol=0, atol=1e-6)


def test_a_dem_of_the_world_has_its_coordinates(run):
    with rasterio.open(run.output("map", "raster.tif")) as raster:
        left, bottom, right, top = raster.bounds
        assert CORNER[0] - 2 < left < right < CORNER[0] + 8 and CORNER[1] - 2 < bottom < top < CORNER[1] + 8
        z = raster.read(1)
        assert np.nanmin(z) > CORNER[2] - 1 and np.nanmax(z) < CORNER[2] + 5


def test_cloudcompare_names_of_normals(run):
    # CloudCompare and PDAL know normals by these names of extra dimensions, in 32-bit floats.
    header = laspy.read(run.output("corners", "cloud.laz")).header
    dimensions = {dimension.name: dimension for dimension in header.point_format.extra_dimensions}
    assert [dimensions["Normal" + axis].num_bits for axis in "XYZ"] == [32] * 3
