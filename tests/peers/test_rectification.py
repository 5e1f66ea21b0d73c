"""Rectification: OpenCV, given our rotations, puts points into the same rows and finds them again by its Q."""

import numpy as np
import pytest
import trimesh

from conftest import HERE, execute
from readers import pose, read_depth, unproject

cv2 = pytest.importorskip("cv2", reason="OpenCV cannot be imported", exc_type=ImportError)


@pytest.fixture(scope="module")
def run(binary, tmp_path_factory):
    return execute(binary, HERE / "rectified.yaml", tmp_path_factory.mktemp("rectified"))


@pytest.fixture(scope="module")
def maps(run):
    """Channels and cameras: images left and right, rectified first and second."""
    images = [read_depth(run.output(side, "depth.exr"))[1] for side in ("left", "right")]
    return images, [read_depth(run.output("matched", "depth.exr", f"of={of}")) for of in ("first", "second")]


def matrix(sensor):
    return np.array([[sensor["f"] + sensor["b1"], 0, sensor["cx"]], [0, sensor["f"], sensor["cy"]], [0, 0, 1.0]])


def vector(sensor):
    k1, k2, k3, k4 = sensor["k"]
    assert k4 == 0 and sensor["b2"] == 0
    return np.array([k1, k2, *sensor["p"], k3])


def on_the_face(maps, count=500):
    """Points of the first rectified map that both images see."""
    (channels, camera), _ = maps[1]
    rows, columns = np.nonzero(~np.isnan(channels["Z"]))
    chosen = np.random.default_rng(8).choice(len(rows), count, replace=False)
    rows, columns = rows[chosen], columns[chosen]
    return rows, columns, unproject(camera, columns, rows, channels["Z"][rows, columns])


def test_opencv_puts_points_into_our_rectified_pixels_and_equal_rows(maps):
    images, rectified = maps
    rows, columns, points = on_the_face(maps)
    placed = []
    for image, (_, camera) in zip(images, rectified):
        sensor, (rotation, centre) = image["sensor"], pose(image)
        in_camera = (points - centre) @ rotation.T
        seen, _ = cv2.projectPoints(in_camera, np.zeros(3), np.zeros(3), matrix(sensor), vector(sensor))
        turned = pose(camera)[0] @ rotation.T
        criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-14)
        lens = matrix(sensor), vector(sensor)
        back = cv2.undistortPoints(seen, *lens, R=turned, P=matrix(camera["sensor"]), criteria=criteria)
        placed.append(back.reshape(-1, 2))
        np.testing.assert_allclose(pose(camera)[1], centre, atol=1e-12)
    np.testing.assert_allclose(placed[0], np.stack([columns, rows], axis=1), rtol=0, atol=2e-4)  # depths have 32 bits
    assert np.abs(placed[0][:, 1] - placed[1][:, 1]).max() < 1e-8
    disparity = rectified[0][0]["disparity"][rows, columns]
    np.testing.assert_allclose(placed[0][:, 0] - placed[1][:, 0], disparity, rtol=0, atol=2e-4)


def test_opencvs_q_finds_our_points(maps):
    _, rectified = maps
    (channels, first), (_, second) = rectified
    (rotation, centre), (_, other) = pose(first), pose(second)
    left, right, base = matrix(first["sensor"]), matrix(second["sensor"]), np.linalg.norm(other - centre)
    # As OpenCV makes it of its projection matrices, where Tx is minus the baseline.
    q = np.array([[1, 0, 0, -left[0, 2]], [0, 1, 0, -left[1, 2]], [0, 0, 0, left[0, 0]]])
    q = np.vstack([q, [0, 0, 1 / base, -(left[0, 2] - right[0, 2]) / base]])
    found = cv2.reprojectImageTo3D(channels["disparity"], q.astype(np.float32))
    rows, columns = np.nonzero(~np.isnan(channels["Z"]))
    ours = (unproject(first, columns, rows, channels["Z"][rows, columns]) - centre) @ rotation.T
    np.testing.assert_allclose(found[rows, columns], ours, rtol=0, atol=2e-4)


def test_stereo_rectify_has_our_baseline_and_nearly_our_plane(maps):
    images, rectified = maps
    (first, c1), (second, c2) = pose(images[0]), pose(images[1])
    size = (images[0]["sensor"]["width_px"], images[0]["sensor"]["height_px"])
    relative = second @ first.T
    made = cv2.stereoRectify(
        matrix(images[0]["sensor"]), vector(images[0]["sensor"]), matrix(images[1]["sensor"]),
        vector(images[1]["sensor"]), size, relative, (-second @ (c2 - c1)).reshape(3, 1), flags=0, alpha=0,
    )
    theirs, ours = made[0] @ first, pose(rectified[0][1])[0]
    # X along the baseline, exactly; the plane about it by another rule (half the rotation), so only nearly.
    np.testing.assert_allclose(theirs[0], ours[0], atol=1e-12)
    assert np.degrees(np.arccos(np.clip(theirs[2] @ ours[2], -1, 1))) < 3
    assert abs(np.linalg.det(ours) - 1) < 1e-12


def test_the_paper_grid_lies_on_the_face(run, maps):
    face = trimesh.load_mesh(run.output("face", "mesh.ply"), process=False)
    _, _, points = on_the_face(maps, 1500)
    distance = trimesh.proximity.closest_point(face, points)[1]
    print(f"median {np.median(distance) * 1e3:.3f} mm, 95 % within {np.quantile(distance, 0.95) * 1e3:.3f} mm")
    # Between the pixels of the ideal map the surface is taken as plane: wrong where it bends, by the curvature in half a pixel.
    assert np.quantile(distance, 0.95) < 1e-3 and np.median(distance) < 2e-4  # a pixel is 11 mm
