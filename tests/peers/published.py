"""A detector written from its publication alone, in plain NumPy: nothing of ours and no image library is used."""

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
