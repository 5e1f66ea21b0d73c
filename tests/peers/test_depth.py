"""Depth maps: OpenEXR opens them, and their pixels unprojected by the documented convention lie on the mesh."""

import numpy as np
import OpenEXR
import pytest
import trimesh

from readers import pose, rays, read_depth, read_surface, unproject

MAPS = [("left", 480, 320, 1), ("right", 480, 320, 1), ("lens", 320, 240, 2)]


@pytest.fixture(scope="module")
def face(survey):
    return trimesh.load_mesh(survey.output("face", "mesh.ply"), process=False)


def sample(mask, count):
    """Rows and columns of `count` of the pixels in a mask."""
    rows, columns = np.nonzero(mask)
    chosen = np.random.default_rng(2).choice(len(rows), min(count, len(rows)), replace=False)
    return rows[chosen], columns[chosen]


@pytest.mark.parametrize(("step", "width", "height", "downscale"), MAPS)
def test_channels_and_camera(survey, step, width, height, downscale):
    channels, camera = read_depth(survey.output(step, "depth.exr"))
    assert list(channels) == ["Z"]
    assert channels["Z"].dtype == np.float32 and channels["Z"].shape == (height, width)
    assert set(camera) == {"frame", "downscale", "sensor", "image"}
    assert camera["frame"] == "wall" and camera["downscale"] == downscale
    assert camera["image"]["name"].startswith(step)
    assert (camera["sensor"]["width_px"], camera["sensor"]["height_px"]) == (width * downscale, height * downscale)
    assert abs(np.linalg.norm(camera["image"]["camera_from_object"]) - 1) < 1e-12


def test_the_convention_is_told_in_the_file(survey):
    with OpenEXR.File(str(survey.output("left", "depth.exr"))) as file:
        assert "not distance along the ray" in file.header()["comments"]


@pytest.mark.parametrize("step", [m[0] for m in MAPS])
def test_points_lie_on_the_mesh(survey, face, step):
    channels, camera = read_depth(survey.output(step, "depth.exr"))
    z = channels["Z"]
    rows, columns = sample(~np.isnan(z), 1500)
    points = unproject(camera, columns, rows, z[rows, columns])
    _, distance, _ = trimesh.proximity.closest_point(face, points)
    assert distance.max() < 1e-5
    # Half a pixel aside they do not: the test can tell conventions apart.
    aside = unproject(camera, columns + 0.5, rows + 0.5, z[rows, columns])
    assert trimesh.proximity.closest_point(face, aside[:300])[1].max() > 1e-4


@pytest.mark.parametrize("step", [m[0] for m in MAPS])
def test_depth_is_that_of_the_nearest_surface_and_nan_where_there_is_none(survey, face, step):
    channels, camera = read_depth(survey.output(step, "depth.exr"))
    z = channels["Z"]
    rotation, centre = pose(camera)
    for mask, count in [(~np.isnan(z), 600), (np.isnan(z), 300)]:
        rows, columns = sample(mask, count)
        assert len(rows) == count
        directions = rays(camera, columns, rows) @ rotation
        hits, ray, _ = face.ray.intersects_location(np.tile(centre, (count, 1)), directions)
        nearest = np.full(count, np.inf)
        np.minimum.at(nearest, ray, (hits - centre) @ rotation[2])
        nearest[np.isinf(nearest)] = np.nan
        np.testing.assert_allclose(z[rows, columns], nearest, rtol=0, atol=1e-5)


@pytest.mark.parametrize("epoch", ["pre", "post"])
def test_a_matched_map_keeps_its_channels_and_gaps(survey, epoch):
    channels, camera = read_depth(survey.output("matched", "depth.exr", f"epoch={epoch}"))
    assert set(channels) == {"Z", "range", "valid", "y_parallax", "noise.local", "noise.regular"} | {
        "disparity",
        "disparity.ideal",
    }
    gaps = np.isnan(channels["Z"])
    assert 0 < gaps.mean() < 0.6
    assert np.isfinite(channels["Z"][~gaps]).all()
    assert np.isnan(channels["disparity"][gaps]).all() and np.isfinite(channels["disparity"][~gaps]).all()
    _, true = read_depth(survey.output("left", "depth.exr"))
    assert camera["sensor"] == true["sensor"] and camera["image"] != true["image"]
    noise = channels["noise.local"][~gaps]
    assert abs(noise.std() / 0.7 - 1) < 0.02 and abs(noise.mean()) < 0.02


def test_a_surface_holds_the_points_of_its_depth_map(survey):
    channels, camera = read_depth(survey.output("matched", "depth.exr", "epoch=pre"))
    z = channels["Z"]
    points, _, header = read_surface(survey.output("surface", "surface.surface", "epoch=pre"))
    rows, columns = np.nonzero(~np.isnan(z))
    # The surface covers the rectangle of the map that has values.
    assert points.shape[:2] == (np.ptp(rows) + 1, np.ptp(columns) + 1) and header["frame"] == "wall"
    expected = unproject(camera, columns, rows, z[rows, columns])
    found = points[rows - rows.min(), columns - columns.min()]
    kept = ~np.isnan(found[:, 0])
    assert kept.mean() > 0.95
    np.testing.assert_allclose(found[kept], expected[kept], rtol=0, atol=3e-6)


def test_the_channels_of_a_matched_map_add_up(survey):
    channels, camera = read_depth(survey.output("terms", "depth.exr"))
    further = {"noise.blunder", "noise.sub_pixel", "noise.strength", "noise.relief"}
    assert further <= set(channels)
    seen = ~np.isnan(channels["Z"])
    assert np.array_equal(channels["valid"], seen.astype(np.float32))
    terms = ["disparity.ideal", "noise.local", "noise.regular", "noise.blunder", "noise.sub_pixel"]
    total = sum(channels[name][seen].astype(float) for name in terms)
    np.testing.assert_allclose(total, channels["disparity"][seen], rtol=0, atol=2e-4)
    # Rounded to its step, less the rounding of 32 bits.
    steps = channels["disparity"][seen].astype(float) / 0.0625
    np.testing.assert_allclose(steps, np.round(steps), rtol=0, atol=2e-3)
    rows, columns = np.nonzero(seen)
    slant = np.linalg.norm(rays(camera, columns, rows), axis=1)
    np.testing.assert_allclose(channels["range"][seen], channels["Z"][seen] * slant, rtol=0, atol=1e-5)
    assert (channels["noise.blunder"][seen] != 0).mean() > 0.01


def test_the_triangle_of_a_pixel_is_the_one_its_ray_meets(survey, face):
    channels, camera = read_depth(survey.output("known", "depth.exr"))
    assert set(channels) == {"Z", "range", "triangle", "valid"}
    seen = ~np.isnan(channels["Z"])
    rows, columns = sample(seen, 500)
    points = unproject(camera, columns, rows, channels["Z"][rows, columns])
    triangles = channels["triangle"][rows, columns].astype(int)
    nearest = trimesh.triangles.closest_point(face.triangles[triangles], points)
    assert np.linalg.norm(nearest - points, axis=1).max() < 1e-5
    np.testing.assert_allclose(
        channels["range"][rows, columns], np.linalg.norm(points - pose(camera)[1], axis=1), rtol=0, atol=1e-5
    )
