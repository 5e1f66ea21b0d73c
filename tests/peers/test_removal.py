"""The exact cut: manifold3d cuts the same blocks out of the same rock, and trimesh judges what is left of the face."""

import manifold3d
import numpy as np
import pandas
import pytest
import trimesh


def loaded(path):
    return trimesh.load_mesh(path, process=False)


def border(mesh):
    """Edges of one triangle, each by the coordinates of its two ends."""
    edges = np.sort(mesh.edges, axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    assert count.max() == 2, "an edge of three triangles"
    ends = mesh.vertices[edges[count == 1]].reshape(-1, 6)
    swapped = np.hstack([ends[:, 3:], ends[:, :3]])
    return {min(tuple(a), tuple(b)) for a, b in zip(ends.tolist(), swapped.tolist())}


def closed(face, floor_m):
    """The rock behind an open face: its border goes straight down to a floor, which fans out from the middle."""
    directed = face.edges[trimesh.grouping.group_rows(face.edges_sorted, require_count=1)]
    top = np.unique(directed)
    below = {vertex: len(face.vertices) + place for place, vertex in enumerate(top)}
    foot = face.vertices[top] * [1, 1, 0] + [0, 0, floor_m]
    centre = len(face.vertices) + len(top)
    vertices = np.vstack([face.vertices, foot, [foot.mean(axis=0)]])
    walls = [[[b, a, below[a]], [b, below[a], below[b]], [below[b], below[a], centre]] for a, b in directed]
    return trimesh.Trimesh(vertices, np.vstack([face.faces, *walls]), process=False)


def solid(mesh):
    """A mesh as manifold3d takes it, in double precision."""
    made = manifold3d.Manifold(manifold3d.Mesh64(np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.uint64)))
    assert made.status() == manifold3d.Error.NoError, made.status()
    return made


@pytest.fixture(scope="module")
def before(rockfall):
    return loaded(rockfall.output("face", "mesh.ply"))


@pytest.fixture(scope="module")
def after(rockfall):
    return loaded(rockfall.output("removed", "mesh.ply"))


@pytest.fixture(scope="module")
def truth(rockfall):
    return pandas.read_csv(rockfall.output("removed", "truth.csv"))


def test_manifold3d_removes_the_same_volumes(rockfall, before, truth):
    rock = solid(closed(before, before.bounds[0, 2] - 5))
    for event, pieces in truth.groupby("event"):
        block = solid(loaded(rockfall.output("removed", f"blocks/{event}.ply")))
        np.testing.assert_allclose(block.volume(), pieces.block_m3.iloc[0], rtol=1e-9)
        cut = block ^ rock
        np.testing.assert_allclose(cut.volume(), pieces.removed_m3.sum(), rtol=1e-9)
        rock = rock - block


def test_the_volume_between_the_faces_is_what_was_removed(before, after, truth):
    floor_m = before.bounds[0, 2] - 5
    left = closed(before, floor_m).volume - closed(after, floor_m).volume
    np.testing.assert_allclose(left, truth.removed_m3.sum(), rtol=1e-8)


def test_the_face_left_is_sound_and_otherwise_untouched(before, after, truth):
    assert border(after) == border(before)
    rock = closed(after, before.bounds[0, 2] - 5)
    assert rock.is_watertight and rock.is_winding_consistent
    assert len(after.split(only_watertight=False)) == len(before.split(only_watertight=False))
    # Vertices on rock that went stay in the list, without a triangle.
    np.testing.assert_array_equal(after.vertices[: len(before.vertices)], before.vertices)
    gone = np.setdiff1d(before.faces, after.faces)
    assert 0 < len(gone) < len(before.vertices) / 2
    low, high = (truth[[f"box_{end}_{axis}_m" for axis in "xyz"]].to_numpy() for end in ("min", "max"))
    lost = before.vertices[gone, None, :]
    inside = ((lost >= low - 1e-9) & (lost <= high + 1e-9)).all(axis=2)
    assert inside.any(axis=1).all()


def test_requested_and_realised_volumes_add_up(rockfall, truth):
    attempts = pandas.read_csv(rockfall.output("removed", "attempts.csv"))
    classes = pandas.read_csv(rockfall.output("removed", "volumes.csv"))
    assert classes.requested.sum() == len(attempts)
    assert classes.realised.sum() == attempts.accepted.sum() == truth.event.nunique()
    np.testing.assert_allclose(attempts.removed_m3.sum(), truth.removed_m3.sum(), rtol=1e-12)
    known = attempts.dropna(subset=["block_m3"])
    bounds = np.append(classes.from_m3.dropna(), classes.to_m3.dropna().iloc[-1])
    for row in classes.dropna(subset=["from_m3"]).itertuples():
        inside = known[(known.block_m3 >= row.from_m3) & (known.block_m3 < row.to_m3)]
        assert len(inside) == row.requested
        share = (inside.removed_m3 / inside.block_m3)[inside.accepted]
        if len(share):
            np.testing.assert_allclose(row.removed_over_block_median, share.median(), rtol=1e-12)
    assert (np.diff(bounds) > 0).all()
