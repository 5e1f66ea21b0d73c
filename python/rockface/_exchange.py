"""Artefacts from and to the files of the exchange with the program."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

import numpy as np

from rockface.artefacts import (
    Cameras,
    Cloud,
    Covariance,
    DepthMap,
    Figure,
    File,
    Files,
    Frame,
    Georeference,
    Grid,
    Inventory,
    Mesh,
    Meshes,
    Pairs,
    Part,
    Picture,
    Raster,
    Surface,
    Table,
    Transform,
)
from rockface.files import RASTER, SURFACE, Artefact, _header, decode
from rockface.formats import exr, ply

__all__ = ["KINDS", "WrongOutputError", "read", "write"]

KINDS: dict[str, type[Any]] = {
    "raster": Raster, "depth": DepthMap, "mesh": Mesh, "meshes": Meshes, "cloud": Cloud, "surface": Surface,
    "cameras": Cameras, "pairs": Pairs, "transform": Transform, "covariance": Covariance, "table": Table,
    "inventory": Inventory, "picture": Picture, "figure": Figure, "file": File, "files": Files,
}  # fmt: skip


class WrongOutputError(Exception):
    """What a function returned cannot be kept."""


def read(kind: str, data: memoryview) -> Artefact:
    """The artefact of an input; arrays are views of the data."""
    return _raster(data) if kind == "raster" else decode(kind, data)


def _raster(data: memoryview) -> Raster:
    header, at = _header(data, len(RASTER))
    shape = (len(header["bands"]), header["rows"], header["columns"])
    values = np.frombuffer(data, header["dtype"], offset=at).reshape(shape)
    grid = Grid(header["columns"], header["rows"], header["cell_m"], header["left_m"], header["top_m"])
    bands = dict(zip(header["bands"], values, strict=True))
    return Raster(grid, Frame.of(header["frame"]), header["quantity"], bands, Georeference.of(header["frame"]))


def write(kind: str, value: Any) -> bytes:
    """The file of an output.

    Raises:
        WrongOutputError: the value is of another type, or its arrays do not fit.
    """
    wanted = KINDS[kind]
    if not isinstance(value, wanted):
        told = f"an array of {value.dtype}, {value.shape}" if isinstance(value, np.ndarray) else type(value).__name__
        way = "; `input.like(values, name)` makes a raster on the grid of another" if kind == "raster" else ""
        raise WrongOutputError(f"it returned {told}, not a rockface.{wanted.__name__}{way}")
    return WRITERS[kind](value)


def _written_raster(raster: Raster) -> bytes:
    grid = raster.grid
    if not (np.isfinite([grid.cell_m, grid.left_m, grid.top_m]).all() and grid.cell_m > 0):
        raise WrongOutputError(f"its grid has cells of {grid.cell_m} m from ({grid.left_m}, {grid.top_m}) on")
    if not raster.bands:
        raise WrongOutputError("the raster has no band")
    arrays = {name: _kept(name, np.asarray(values)) for name, values in raster.bands.items()}
    for name, values in arrays.items():
        if values.shape != grid.shape:
            raise WrongOutputError(
                f"band `{name}` has the shape {values.shape}, its grid has {grid.rows} rows x {grid.columns} columns"
            )
    common = max((values.dtype for values in arrays.values()), key=lambda dtype: ("u1", "u2", "f4").index(dtype.str[1:]))
    header = {
        "columns": grid.columns,
        "rows": grid.rows,
        "cell_m": float(grid.cell_m),
        "left_m": float(grid.left_m),
        "top_m": float(grid.top_m),
        "frame": raster.written_frame(),
        "quantity": raster.quantity,
        "dtype": common.str,
        "bands": list(arrays),
    }
    body = np.stack([values.astype(common, copy=False) for values in arrays.values()])
    return RASTER + json.dumps(header).encode() + b"\n" + body.tobytes()


def _kept(name: str, values: Any) -> Any:
    """The values of a band in a type that rasters are kept in."""
    kind = values.dtype.kind
    if kind == "f":
        return values.astype("<f4", copy=False)
    if kind == "b":
        return values.astype("|u1")
    if kind in "iu":
        low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
        if low < 0 or high > 65535:
            raise WrongOutputError(f"band `{name}` has whole numbers from {low} to {high}; they are kept from 0 to 65535")
        return values.astype("|u1" if high < 256 and values.dtype.itemsize == 1 else "<u2")
    raise WrongOutputError(f"band `{name}` is an array of {values.dtype}; numbers or flags are kept")


def _floats(name: str, values: Any, columns: int, dtype: str) -> Any:
    array = np.asarray(values)
    if array.dtype.kind not in "fiu" or array.ndim != 2 or array.shape[1] != columns:
        raise WrongOutputError(
            f"`{name}` is an array of {array.dtype} with the shape {array.shape}; n x {columns} numbers are kept"
        )
    return array.astype(dtype, copy=False)


def _written_mesh(mesh: Mesh) -> bytes:
    vertices = _floats("vertices", mesh.vertices, 3, "<f8")
    triangles = _floats("triangles", mesh.triangles, 3, "<i8")
    if len(triangles) and (triangles.min() < 0 or triangles.max() >= len(vertices)):
        raise WrongOutputError(f"`triangles` name vertices from {triangles.min()} to {triangles.max()}; there are {len(vertices)}")
    return ply.write_mesh(Mesh(mesh.frame, vertices, triangles.astype("<u4"), mesh.colours, mesh.georeference))


def _written_meshes(meshes: Meshes) -> bytes:
    lines = ["ply", "format binary_little_endian 1.0", f"comment rockface meshes, frame {meshes.frame}, units metres"]
    lines += ply.georeference_lines(meshes)
    vertices, faces, first = [], [], 0
    vertex = np.dtype([("xyz", "<f8", (3,)), ("part", "<i4")])
    face = np.dtype([("count", "u1"), ("corners", "<u4", (3,)), ("part", "<i4")])
    for number, part in enumerate(meshes.parts):
        if not isinstance(part, Part):
            raise WrongOutputError(f"part {number} is {type(part).__name__}, not rockface.Part")
        own = np.zeros(len(part.vertices), vertex)
        own["xyz"], own["part"] = _floats("vertices", part.vertices, 3, "<f8"), number
        corners = np.zeros(len(part.triangles), face)
        corners["count"], corners["corners"], corners["part"] = 3, np.asarray(part.triangles) + first, number
        lines.append(f"comment part {number} vertices {len(own)} faces {len(corners)} {json.dumps([part.name, part.kind])}")
        vertices.append(own)
        faces.append(corners)
        first += len(own)
    lines += [f"element vertex {first}", *(f"property double {axis}" for axis in "xyz"), "property int part"]
    lines += [
        f"element face {sum(map(len, faces))}",
        "property list uchar uint vertex_indices",
        "property int part",
        "end_header\n",
    ]
    return "\n".join(lines).encode("ascii") + b"".join(part.tobytes() for part in [*vertices, *faces])


def _written_cloud(cloud: Cloud) -> bytes:
    points = _floats("points", cloud.points, 3, "<f8")
    count = len(points)
    lists: dict[str, Any] = {"normals": cloud.normals, "colours": cloud.colours, **cloud.numbers}
    for name, values in lists.items():
        if len(values) not in ((0, count) if name in ("normals", "colours") else (count,)):
            raise WrongOutputError(f"`{name}` has {len(values)} values for {count} points")
    return ply.write_cloud(Cloud(cloud.frame, points, cloud.normals, cloud.colours, cloud.numbers, cloud.georeference))


def _written_surface(surface: Surface) -> bytes:
    points, squares = np.asarray(surface.points), np.asarray(surface.squares)
    if points.ndim != 3 or points.shape[2] != 3 or squares.shape != (points.shape[0] - 1, points.shape[1] - 1):
        raise WrongOutputError(f"points of the shape {points.shape} and squares of {squares.shape} make no surface")
    layout = "float32 points by row from origin_m, uint8 squares"
    header = {
        "frame": surface.written_frame(), "width": points.shape[1], "height": points.shape[0],
        "origin_m": list(map(float, surface.origin_m)), "layout": layout,
    }  # fmt: skip
    return SURFACE + json.dumps(header).encode() + b"\n" + points.astype("<f4").tobytes() + squares.astype("u1").tobytes()


def _written_depth(depth: DepthMap) -> bytes:
    for name, values in {"Z": depth.z, **depth.channels}.items():
        array = np.asarray(values)
        if array.dtype.kind not in "fiu" or array.shape != np.shape(depth.z) or array.ndim != 2:
            raise WrongOutputError(
                f"channel `{name}` is an array of {array.dtype} with the shape {array.shape}; Z has {np.shape(depth.z)}"
            )
    return exr.write(depth)


def _json(value: Any) -> bytes:
    try:
        return json.dumps(value, allow_nan=False, default=_plain).encode()
    except (ValueError, TypeError) as error:
        raise WrongOutputError(f"a value cannot be kept: {error}") from error


def _plain(value: Any) -> Any:
    """Numbers and arrays of numpy as plain ones."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no number, text or list of such")


def _written_table(table: Table) -> bytes:
    for number, row in enumerate(table.rows):
        if len(row) != len(table.columns):
            raise WrongOutputError(f"row {number} of the table has {len(row)} cells for {len(table.columns)} columns")

    def cell(value: Any) -> Any:
        value = value.item() if isinstance(value, np.generic) else value
        return None if isinstance(value, float) and not np.isfinite(value) else value

    return _json({"columns": list(table.columns), "rows": [[cell(value) for value in row] for row in table.rows]})


def _written_files(files: Files) -> bytes:
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as tar:
        for name, data in sorted(files.files.items()):
            member = tarfile.TarInfo(name)
            member.size = len(data)
            tar.addfile(member, io.BytesIO(data))
    return stream.getvalue()


def _written_cameras(cameras: Cameras) -> bytes:
    sensors, images = [s.as_dict() for s in cameras.sensors], [i.as_dict() for i in cameras.images]
    return _json({"frame": str(cameras.frame), "sensors": sensors, "images": images})


def _written_transform(transform: Transform) -> bytes:
    arrays = {name: np.asarray(getattr(transform, name), float) for name in ("rotation", "origin", "translation")}
    return _json({"from": transform.source, "to": transform.target, **arrays})


def _written_covariance(covariance: Covariance) -> bytes:
    value = {"frame": str(covariance.frame), "parameters": covariance.parameters, "matrix": np.asarray(covariance.matrix, float)}
    return _json({**value, "sigma0_applied": covariance.sigma0_applied, "full_joint": covariance.full_joint})


WRITERS: dict[str, Callable[[Any], bytes]] = {
    "raster": _written_raster,
    "depth": _written_depth,
    "mesh": _written_mesh,
    "meshes": _written_meshes,
    "cloud": _written_cloud,
    "surface": _written_surface,
    "cameras": _written_cameras,
    "pairs": lambda value: _json({"pairs": [asdict(pair) for pair in value.pairs]}),
    "transform": _written_transform,
    "covariance": _written_covariance,
    "table": _written_table,
    "inventory": lambda value: _json(value.geojson),
    "picture": lambda value: bytes(value.png),
    "figure": lambda value: value.svg.encode(),
    "file": lambda value: bytes(value.data),
    "files": _written_files,
}
