"""Cameras: a COLMAP model read by us and by COLMAP itself means the same rays."""

import numpy as np
import pytest
import trimesh

from conftest import HERE
from readers import distort, pose, read_depth, unproject

pycolmap = pytest.importorskip("pycolmap", reason="pycolmap cannot be imported", exc_type=ImportError)


@pytest.fixture(scope="module")
def image():
    reconstruction = pycolmap.Reconstruction(HERE / "lens")
    found = reconstruction.image(1)
    return found, reconstruction.camera(found.camera_id)


@pytest.fixture(scope="module")
def depth(survey):
    channels, camera = read_depth(survey.output("lens", "depth.exr"))
    rows, columns = np.nonzero(~np.isnan(channels["Z"]))
    chosen = np.random.default_rng(3).choice(len(rows), 1500, replace=False)
    rows, columns = rows[chosen], columns[chosen]
    return camera, rows, columns, channels["Z"][rows, columns].astype(float)


def image_position(camera, columns, rows):
    """Image positions as COLMAP counts them: the corner of the first pixel is (0, 0)."""
    return (np.stack([columns, rows], axis=1) + 0.5) * camera["downscale"]


def test_the_pose_is_the_same(image, depth):
    rotation, centre = pose(depth[0])
    np.testing.assert_allclose(rotation, image[0].cam_from_world().rotation.matrix(), atol=1e-11)
    np.testing.assert_allclose(centre, image[0].projection_center(), atol=1e-10)


def test_our_points_project_to_their_pixels_in_colmap(image, depth):
    camera, rows, columns, z = depth
    points = unproject(camera, columns, rows, z)
    in_camera = points @ image[0].cam_from_world().rotation.matrix().T + image[0].cam_from_world().translation
    pixels = image[1].img_from_cam(in_camera)
    np.testing.assert_allclose(pixels, image_position(camera, columns, rows), rtol=0, atol=1e-8)
    undistorted = in_camera[:, :2] / in_camera[:, 2:]
    shift = np.hypot(*(np.array(distort(camera["sensor"], *undistorted.T)) - undistorted.T))
    assert shift.max() * camera["sensor"]["f"] > 2, "the lens must distort in this test"


def test_colmap_unprojects_our_depths_onto_the_mesh(survey, image, depth):
    camera, rows, columns, z = depth
    normalised = image[1].cam_from_img(image_position(camera, columns, rows))
    in_camera = z[:, None] * np.column_stack([normalised, np.ones(len(z))])
    world_from_cam = image[0].cam_from_world().inverse()
    points = in_camera @ world_from_cam.rotation.matrix().T + world_from_cam.translation
    face = trimesh.load_mesh(survey.output("face", "mesh.ply"), process=False)
    assert trimesh.proximity.closest_point(face, points)[1].max() < 1e-5
