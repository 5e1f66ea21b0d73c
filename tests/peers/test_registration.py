"""Registration: the motion we find is the true one, that of a plain numpy ICP, and Open3D's where it is installed."""

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from conftest import HERE, execute
from readers import read_surface

SHIFT_M = np.array([0.004, -0.003, 0.006])


@pytest.fixture(scope="module")
def run(binary, tmp_path_factory):
    return execute(binary, HERE / "registration.yaml", tmp_path_factory.mktemp("registration"))


def points_and_normals(path):
    """Points of a surface that have neighbours, with the normals of central differences."""
    grid, _, _ = read_surface(path)
    across, down = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
    normals = np.cross(down, across)
    length = np.linalg.norm(normals, axis=2, keepdims=True)
    good = np.isfinite(length[..., 0]) & (length[..., 0] > 0) & np.isfinite(grid[..., 0])
    return grid[good], (normals / length)[good]


def ours(run, step, method):
    told = json.loads(run.output(step, "transform.json", f"method={method}").read_text())
    rotation, origin = np.array(told["rotation"]), np.array(told["origin"])
    return lambda points: (points - origin) @ rotation.T + told["translation"]


def plain(source, target, normals, to_plane, rounds=60):
    """Iterative closest points as the textbooks have it."""
    tree, moved, centre = cKDTree(target), source.copy(), target.mean(axis=0)
    for _ in range(rounds):
        distance, near = tree.query(moved, distance_upper_bound=0.1)
        kept = np.isfinite(distance)
        p, q = moved[kept] - centre, target[near[kept]] - centre
        if to_plane:
            n = normals[near[kept]]
            rows = np.hstack([np.cross(p, n), n])
            step = np.linalg.lstsq(rows, np.einsum("ij,ij->i", q - p, n), rcond=None)[0]
            rotation, translation = Rotation.from_rotvec(step[:3]).as_matrix(), step[3:]
        else:
            rotation = Rotation.align_vectors(q - q.mean(axis=0), p - p.mean(axis=0))[0].as_matrix()
            translation = q.mean(axis=0) - rotation @ p.mean(axis=0)
        moved = (moved - centre) @ rotation.T + translation + centre
    return moved


def apart(first, second):
    """Root mean square distance between two results for the same points, millimetres."""
    return 1e3 * np.sqrt(((first - second) ** 2).sum(axis=1).mean())


def check(source, found, theirs, method):
    """Near theirs, and as near the truth as noise of 5 mm a point allows both.

    To planes the normals differ: ours are regressions over 17 x 17 points, wide enough for noise on both sides, theirs those
    of neighbours, the better ones here, where the target has no noise.
    """
    between, error, their_error = apart(found, theirs), apart(found, source - SHIFT_M), apart(theirs, source - SHIFT_M)
    print(f"{method}: {between:.3f} mm apart; off the truth {error:.3f} mm, theirs {their_error:.3f} mm")
    assert between < (0.5 if method == "point_to_plane" else 0.05) and max(error, their_error) < 1.0


def test_a_known_motion_is_found(run):
    source, _ = points_and_normals(run.output("source", "surface.surface"))
    error = apart(ours(run, "align", "point_to_plane")(source), source - SHIFT_M)
    print(f"exact copy: {error:.4f} mm off")
    assert error < 0.05


@pytest.mark.parametrize("method", ["point_to_plane", "point_to_point"])
def test_a_plain_icp_finds_the_same(run, method):
    source, _ = points_and_normals(run.output("rough", "surface.surface"))
    target, normals = points_and_normals(run.output("target", "surface.surface"))
    check(source, ours(run, "align_rough", method)(source), plain(source, target, normals, method == "point_to_plane"), method)


@pytest.mark.parametrize("method", ["point_to_plane", "point_to_point"])
def test_open3d_finds_the_same(run, method):
    open3d = pytest.importorskip("open3d", reason="open3d cannot be imported", exc_type=ImportError)
    source, _ = points_and_normals(run.output("rough", "surface.surface"))
    target, normals = points_and_normals(run.output("target", "surface.surface"))
    clouds = [open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points)) for points in (source, target)]
    clouds[1].normals = open3d.utility.Vector3dVector(normals)
    registration = open3d.pipelines.registration
    estimate = {
        "point_to_plane": registration.TransformationEstimationPointToPlane(),
        "point_to_point": registration.TransformationEstimationPointToPoint(),
    }[method]
    criteria = registration.ICPConvergenceCriteria(1e-10, 1e-10, 200)
    made = registration.registration_icp(clouds[0], clouds[1], 0.1, np.eye(4), estimate, criteria).transformation
    theirs = source @ made[:3, :3].T + made[:3, 3]
    check(source, ours(run, "align_rough", method)(source), theirs, method)
