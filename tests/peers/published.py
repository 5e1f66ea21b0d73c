"""Detectors written from their publications alone, in plain NumPy: nothing of ours and no image library is used."""

import numpy as np


def neighbours(cell, shape):
    """The cells that touch a cell along edges or at corners."""
    row, column = cell
    for r in range(max(row - 1, 0), min(row + 2, shape[0])):
        for c in range(max(column - 1, 0), min(column + 2, shape[1])):
            if (r, c) != cell:
                yield r, c


def clusters(mask):
    """Groups of touching cells, by first cell: flood fill."""
    left = mask.copy()
    found = []
    for start in map(tuple, np.argwhere(mask)):
        if not left[start]:
            continue
        left[start] = False
        group, front = [], [start]
        while front:
            cell = front.pop()
            group.append(cell)
            for near in neighbours(cell, mask.shape):
                if left[near]:
                    left[near] = False
                    front.append(near)
        found.append(np.array(sorted(group)))
    return found


def slope_monitor(reference, comparison, cell_m, lod_m, width_cells, least_ratio, least_cells):
    """SlopeMonitor as section 2.3 of the paper describes it: raster of labels, and the volume of each cluster.

    Differences of elevation; only losses; those within the limit of detection are disregarded; a morphological filter of least
    width (what no square of that width inside the change covers goes) and of shape (width over length by principal axes); least
    number of pixels; volume as the sum of pixel area times difference.
    """
    difference = comparison - reference
    changed = np.nan_to_num(difference, nan=0.0) < -lod_m
    rows, columns = changed.shape
    wide = np.zeros_like(changed)
    for row in range(rows - width_cells + 1):
        for column in range(columns - width_cells + 1):
            if changed[row : row + width_cells, column : column + width_cells].all():
                wide[row : row + width_cells, column : column + width_cells] = True
    labels, volumes = np.zeros(changed.shape, dtype=int), []
    for group in clusters(wide):
        moments = np.cov(group.T, bias=True) + np.eye(2) / 12 if len(group) > 1 else np.eye(2) / 12
        short, long = np.sqrt(np.linalg.eigvalsh(moments))
        if short / long < least_ratio or len(group) < least_cells:
            continue
        volumes.append(-difference[tuple(group.T)].sum() * cell_m**2)
        labels[tuple(group.T)] = len(volumes)
    return labels, np.array(volumes)


def crosses(triangle, centres, half):
    """Which cubes a triangle meets: thirteen separating axes."""
    corners = triangle[None] - centres[:, None]
    edges = np.roll(triangle, -1, axis=0) - triangle
    axes = np.vstack([np.eye(3), np.cross(edges[0], edges[1])[None], *[np.cross(np.eye(3), edge) for edge in edges]])
    along = corners @ axes.T
    reach = half * np.abs(axes).sum(axis=1)
    return ((along.min(axis=1) <= reach) & (along.max(axis=1) >= -reach)).all(axis=1)


def vox_fall(triangles, edge_m):
    """VoxFall (Farmakis et al. 2025): enclosed voxels of two surfaces in clusters of 26 neighbours.

    The voxels that a triangle of either surface meets are occupied; empty ones that the outside does not reach over faces are
    enclosed. Returns for each cluster its voxels (indices of the lattice through the origin) and v^3 (N_in + N_out / 2).
    """
    everything = np.concatenate(triangles).reshape(-1, 3)
    low = np.floor(everything.min(axis=0) / edge_m).astype(int) - 1
    high = np.floor(everything.max(axis=0) / edge_m).astype(int) + 2
    grid = np.zeros(high - low, dtype=bool)
    for triangle in np.concatenate(triangles):
        first = np.floor(triangle.min(axis=0) / edge_m).astype(int)
        last = np.floor(triangle.max(axis=0) / edge_m).astype(int) + 1
        index = np.stack(np.meshgrid(*map(np.arange, first, last), indexing="ij"), axis=-1).reshape(-1, 3)
        hit = index[crosses(triangle, (index + 0.5) * edge_m, 0.5 * edge_m)] - low
        grid[tuple(hit.T)] = True
    outside = np.zeros_like(grid)
    outside[0] = outside[-1] = outside[:, 0] = outside[:, -1] = outside[:, :, 0] = outside[:, :, -1] = True
    while True:
        grown = outside.copy()
        for axis in range(3):
            for step in (1, -1):
                moved = np.roll(outside, step, axis=axis)
                grown |= moved & ~grid
        if (grown == outside).all():
            break
        outside = grown
    enclosed = ~grid & ~outside
    left = set(map(tuple, np.argwhere(enclosed)))
    around = [np.array(d) - 1 for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)]
    found = []
    while left:
        front, group = [left.pop()], []
        while front:
            voxel = front.pop()
            group.append(voxel)
            for step in around:
                near = tuple(np.array(voxel) + step)
                if near in left:
                    left.remove(near)
                    front.append(near)
        inside = set(group)
        shell = {tuple(np.array(v) + step) for v in group for step in around} - inside
        found.append((np.array(group) + low, edge_m**3 * (len(group) + len(shell) / 2)))
    return found


def scores(truth, found, compared):
    """Section 3.2: a detection is true where it meets a true change, a true change is found where a detection meets it."""
    true = [set(map(tuple, np.argwhere(mask & compared))) for mask in truth]
    ours = [set(map(tuple, np.argwhere(mask & compared))) for mask in found]
    hits = np.array([[len(a & b) for b in ours] for a in true]).reshape(len(true), len(ours))
    positives, hit = (hits > 0).any(axis=0).sum(), (hits > 0).any(axis=1).sum()
    precision, recall = positives / len(ours), hit / len(true)
    return precision, recall, 2 * precision * recall / (precision + recall)
