"""The works of the bench `science` by other programs: `peers.py WORK FOLDER THREADS`.

The bench writes the input into the folder: arrays as bare little-endian numbers, `points.f8` of eight bytes each. A work writes its
result there, for the bench to compare, and prints one line of JSON: what did it, seconds, and further numbers. Only the work is
timed, not what is read and written around it. A package that is not installed is `{"missing": name}`.
"""

import importlib.metadata
import json
import os
import sys
import time
from pathlib import Path
from statistics import median

WORK, FOLDER, THREADS = sys.argv[1], Path(sys.argv[2]), int(sys.argv[3])
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ[name] = str(THREADS)

try:
    import numpy as np
except ModuleNotFoundError:
    sys.exit(print(json.dumps({"missing": "numpy"})))

REPEATS, LONG_S = 3, 10.0


def read(name, columns=None):
    values = np.fromfile(FOLDER / name, dtype="<" + name.rsplit(".", 1)[1])
    return values if columns is None else values.reshape(-1, columns)


def write(name, values):
    np.ascontiguousarray(values, dtype="<" + name.rsplit(".", 1)[1]).tofile(FOLDER / name)


def timed(work):
    """The last result of a work and its seconds, as the bench takes them: the median of three, or one run of ten seconds."""
    walls, cpus = [], []
    while len(walls) < REPEATS and (not walls or walls[0] < LONG_S):
        result = None
        wall, cpu = time.perf_counter(), time.process_time()
        result = work()
        walls.append(time.perf_counter() - wall)
        cpus.append(time.process_time() - cpu)
    return result, {"wall_s": median(walls), "cpu_s": median(cpus)}


def version(package):
    return f"{package} {importlib.metadata.version(package)}"


def depth():
    """Rays through all pixels against the mesh; the scene is built for every map, then once for all."""
    import open3d as o3d

    vertices = o3d.core.Tensor(read("vertices.f8", 3).astype(np.float32))
    triangles = o3d.core.Tensor(read("triangles.u4", 3))
    rays = o3d.core.Tensor(read("rays.f4", 6))

    def scene():
        made = o3d.t.geometry.RaycastingScene(nthreads=THREADS)
        made.add_triangles(vertices, triangles)
        return made

    whole, cost = timed(lambda: scene().cast_rays(rays, nthreads=THREADS)["t_hit"].numpy())
    standing = scene()
    standing.cast_rays(rays[:1], nthreads=THREADS)
    _, casting = timed(lambda: standing.cast_rays(rays, nthreads=THREADS)["t_hit"].numpy())
    write("depth.f4", whole)
    return {"who": version("open3d") + " (Embree)", **cost, "standing_cpu_s": casting["cpu_s"]}


def closed(vertices, triangles, floor):
    """The solid behind a square grid of vertices: walls down from its border to a flat floor."""
    side = round(len(vertices) ** 0.5)
    number = np.arange(side * side).reshape(side, side)
    # Counter-clockwise seen from above.
    border = np.concatenate([number[0, :-1], number[:-1, -1], number[-1, :0:-1], number[:0:-1, 0]])
    below = vertices[border].copy()
    below[:, 2] = floor
    middle = np.append(vertices[:, :2].mean(axis=0), floor)
    low = len(vertices) + np.arange(len(border))
    after, low_after = np.roll(border, -1), np.roll(low, -1)
    centre = np.full(len(border), len(vertices) + len(border))
    walls = [np.stack(corners, axis=1) for corners in ((border, low, low_after), (border, low_after, after), (centre, low_after, low))]
    return np.concatenate([vertices, below, middle[None]]), np.concatenate([triangles.astype(np.int64), *walls])


def removal():
    """The same blocks, where they were placed, subtracted from the closed face: all at once, then some one after the other."""
    import manifold3d as m

    def solid(vertices, triangles):
        made = m.Manifold(m.Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(triangles.astype(np.uint64))))
        assert made.status() == m.Error.NoError, made.status()
        return made

    vertices = read("vertices.f8", 3)
    face = closed(vertices, read("triangles.u4", 3), vertices[:, 2].min() - 2)
    corners, facets, counts = read("block_vertices.f8", 3), read("block_triangles.u4", 3), read("blocks.u4", 2)
    ends = np.cumsum(counts, axis=0)
    blocks = [solid(corners[v - a : v], facets[t - b : t]) for (v, t), (a, b) in zip(ends, counts)]
    rock = solid(*face)
    volume = rock.volume()

    def at_once():
        made = m.Manifold.batch_boolean([solid(*face), *blocks], m.OpType.Subtract)
        made.num_tri()
        return made

    def one_by_one():
        made = rock
        for block in blocks[:5]:
            made = made - block
            made.num_tri()
        return made

    whole, cost = timed(at_once)
    _, some = timed(one_by_one)
    return {"who": version("manifold3d"), **cost, "removed_m3": volume - whole.volume(), "block_cpu_s": some["cpu_s"] / 5}


def variogram():
    """All pairs of cells up to the longest lag, in bins about whole numbers of cells."""
    from skgstat import MetricSpace, Variogram

    columns, longest = read("size.u4")
    values = read("values.f4").astype(float).reshape(-1, columns)
    edges = np.arange(1, longest + 1) + 0.5

    def made(values):
        # Distances beyond the longest lag would fill 29 GB.
        known = MetricSpace(np.argwhere(~np.isnan(values)).astype(float), max_dist=edges[-1])
        return Variogram(known, values[~np.isnan(values)], bin_func=edges, maxlag=edges[-1], fit_method=None).experimental

    made(values[:50, :50])
    found, cost = timed(lambda: made(values))
    write("gamma.f8", found)
    return {"who": version("scikit-gstat"), **cost}


def m3c2():
    import py4dgeo

    py4dgeo.set_num_threads(THREADS)
    clouds = [read(f"{name}.f8", 3) for name in ("reference", "comparison")]
    cores = read("cores.f8", 3)
    normal, cylinder, reach, registration = read("scales.f8")

    def run():
        method = py4dgeo.M3C2(
            epochs=tuple(py4dgeo.Epoch(cloud) for cloud in clouds),
            corepoints=cores,
            cyl_radius=cylinder,
            normal_radii=[normal],
            max_distance=reach,
            registration_error=registration,
        )
        return method.run()[0]

    distances, cost = timed(run)
    write("distances.f8", distances)
    return {"who": version("py4dgeo"), **cost}


def icp():
    """Point to plane, with the default criteria of convergence: normals of 30 neighbours, then the iterations."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    source, target = (read(f"{name}.f8", 3) for name in ("source", "target"))
    (reach,) = read("reach.f8")

    def run():
        clouds = [o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points)) for points in (source, target)]
        clouds[1].estimate_normals(o3d.geometry.KDTreeSearchParamKNN(30))
        estimate = registration.TransformationEstimationPointToPlane()
        return registration.registration_icp(*clouds, reach, np.eye(4), estimate).transformation

    found, cost = timed(run)
    write("transform.f8", found)
    return {"who": version("open3d"), **cost}


DIMENSIONS = [("NormalX", np.float32), ("NormalY", np.float32), ("NormalZ", np.float32), ("id", np.uint32)]


def las_write():
    import laspy

    points, normals, ids = read("points.f8", 3), read("normals.f4", 3), read("ids.u4")

    def run():
        header = laspy.LasHeader(version="1.4", point_format=6)
        header.scales, header.offsets = np.full(3, 1e-4), np.floor(points.min(axis=0))
        header.add_extra_dims([laspy.ExtraBytesParams(name, kind) for name, kind in DIMENSIONS])
        file = laspy.LasData(header)
        file.xyz = points
        for (name, _), values in zip(DIMENSIONS, [*normals.T, ids]):
            file[name] = values
        file.write(FOLDER / "theirs.laz")

    _, cost = timed(run)
    return {"who": version("laspy"), **cost}


def las_read():
    import laspy

    points, cost = timed(lambda: np.array(laspy.read(FOLDER / "ours.laz").xyz))
    write("read.f8", points)
    return {"who": version("laspy"), **cost}


def ply_write():
    from plyfile import PlyData, PlyElement

    points, normals, ids = read("points.f8", 3), read("normals.f4", 3), read("ids.u4")
    kinds = [*((name, "<f8") for name in "xyz"), *((f"n{name}", "<f4") for name in "xyz"), ("id", "<u4")]

    def run():
        rows = np.empty(len(points), dtype=kinds)
        for (name, _), values in zip(kinds, [*points.T, *normals.T, ids]):
            rows[name] = values
        PlyData([PlyElement.describe(rows, "vertex")], byte_order="<").write(FOLDER / "theirs.ply")

    _, cost = timed(run)
    return {"who": version("plyfile"), **cost}


def ply_read():
    from plyfile import PlyData

    def run():
        rows = PlyData.read(FOLDER / "ours.ply")["vertex"]
        return np.stack([rows[name] for name in ("x", "y", "z")], axis=1)

    points, cost = timed(run)
    write("read.f8", points)
    return {"who": version("plyfile"), **cost}


WORKS = {work.__name__: work for work in (depth, removal, variogram, m3c2, icp, las_write, las_read, ply_write, ply_read)}

if __name__ == "__main__":
    try:
        print("\n" + json.dumps(WORKS[WORK]()))
    except ModuleNotFoundError as missing:
        print("\n" + json.dumps({"missing": missing.name or WORK}))
