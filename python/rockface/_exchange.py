"""Artefacts from and to the files of the exchange with the program."""

from __future__ import annotations

import io
import json
import re
import tarfile
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
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
    unmasked,
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
    arrays = {name: _kept(name, unmasked(values)) for name, values in raster.bands.items()}
    for name, values in arrays.items():
        if values.shape != grid.shape:
            raise WrongOutputError(
                f"band `{name}` has the shape {values.shape}, its grid has {grid.rows} rows x {grid.columns} columns"
            )
    common = max((values.dtype for values in arrays.values()), key=lambda dtype: ("u1", "u2", "f4").index(dtype.str[1:]))
    header = {
        "columns": int(grid.columns),
        "rows": int(grid.rows),
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
        with np.errstate(over="ignore"):
            kept = values.astype("<f4", copy=False)
        if np.isinf(kept).any():
            raise WrongOutputError(
                f"band `{name}` has values that are infinite, or beyond what 32 bits hold; NaN stands for no value"
            )
        return kept
    if kind == "b":
        return values.astype("|u1")
    if kind in "iu":
        low, high = (int(values.min()), int(values.max())) if values.size else (0, 0)
        if low < 0 or high > 65535:
            raise WrongOutputError(f"band `{name}` has whole numbers from {low} to {high}; they are kept from 0 to 65535")
        return values.astype("|u1" if high < 256 and values.dtype.itemsize == 1 else "<u2")
    raise WrongOutputError(f"band `{name}` is an array of {values.dtype}; numbers or flags are kept")


def _whole(name: str, values: Any, low: int, high: int) -> Any:
    """Values that are kept as whole numbers from `low` to `high`, and are such."""
    array = unmasked(values)
    if array.dtype.kind == "b":
        array = array.astype("u1")
    if array.dtype.kind not in "fiu":
        raise WrongOutputError(f"`{name}` is an array of {array.dtype}; whole numbers from {low} to {high} are kept")
    if array.size and (not (array == np.floor(array)).all() or array.min() < low or array.max() > high):
        raise WrongOutputError(
            f"`{name}` has values from {array.min()} to {array.max()}; whole numbers from {low} to {high} are kept"
        )
    return array


def _floats(name: str, values: Any, columns: int, dtype: str) -> Any:
    array = unmasked(values)
    if array.dtype.kind not in "fiu" or array.ndim != 2 or array.shape[1] != columns:
        raise WrongOutputError(
            f"`{name}` is an array of {array.dtype} with the shape {array.shape}; n x {columns} numbers are kept"
        )
    return array.astype(dtype, copy=False)


def _written_mesh(mesh: Mesh) -> bytes:
    vertices = _floats("vertices", mesh.vertices, 3, "<f8")
    triangles = _corners(mesh.triangles, len(vertices))
    colours = _whole("colours", mesh.colours, 0, 255).astype("u1")
    return ply.write_mesh(Mesh(mesh.frame, vertices, triangles, colours, mesh.georeference))


def _corners(triangles: Any, vertices: int) -> Any:
    """Triangles as places in so many vertices."""
    corners = _floats("triangles", triangles, 3, np.asarray(triangles).dtype.str)
    if len(corners) and (corners.min() < 0 or corners.max() >= vertices):
        raise WrongOutputError(f"`triangles` name vertices from {corners.min()} to {corners.max()}; there are {vertices}")
    return _whole("triangles", corners, 0, max(vertices - 1, 0)).astype("<u4")


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
        corners["count"], corners["corners"], corners["part"] = 3, _corners(part.triangles, len(own)) + first, number
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
    lists: dict[str, Any] = {"normals": cloud.normals, "colours": cloud.colours, **cloud.numbers, **cloud.values}
    for name, values in lists.items():
        if name not in ("normals", "colours"):
            _check_number_name(name)
        if len(values) not in ((0, count) if name in ("normals", "colours") else (count,)):
            raise WrongOutputError(f"`{name}` has {len(values)} values for {count} points")
    colours = _whole("colours", cloud.colours, 0, 255).astype("u1")
    numbers = {name: _whole(name, values, 0, 2**32 - 1).astype("<u4") for name, values in cloud.numbers.items()}
    if twice := sorted(numbers.keys() & cloud.values.keys()):
        raise WrongOutputError(f"both a number and a value are called `{twice[0]}`")
    values = {name: np.asarray(values, "<f4") for name, values in cloud.values.items()}
    return ply.write_cloud(Cloud(cloud.frame, points, cloud.normals, colours, numbers, cloud.georeference, values))


def _check_number_name(name: str) -> None:
    if name in ply.RESERVED or not re.fullmatch("[a-z0-9_]+", name):
        taken = ", ".join(ply.RESERVED)
        told = f"`{name}` cannot name a number of a cloud: lower-case letters, digits and `_`, and none of {taken}"
        raise WrongOutputError(f"{told}, which the points have")


def _written_surface(surface: Surface) -> bytes:
    points, squares = unmasked(surface.points), unmasked(surface.squares)
    if points.ndim != 3 or points.shape[2] != 3 or squares.shape != (points.shape[0] - 1, points.shape[1] - 1):
        raise WrongOutputError(f"points of the shape {points.shape} and squares of {squares.shape} make no surface")
    layout = "float32 points by row from origin_m, uint8 squares"
    header = {
        "frame": surface.written_frame(), "width": points.shape[1], "height": points.shape[0],
        "origin_m": list(map(float, surface.origin_m)), "layout": layout,
    }  # fmt: skip
    return SURFACE + json.dumps(header).encode() + b"\n" + points.astype("<f4").tobytes() + squares.astype("u1").tobytes()


def _written_depth(depth: DepthMap) -> bytes:
    channels = {name: unmasked(values) for name, values in depth.channels.items()}
    depth = replace(depth, z=unmasked(depth.z), channels=channels)
    sides = (depth.sensor.height_px // depth.downscale, depth.sensor.width_px // depth.downscale)
    if np.shape(depth.z) != sides:
        raise WrongOutputError(
            f"Z has the shape {np.shape(depth.z)}; the sensor with downscale {depth.downscale} has {sides}: "
            "set pixels that are not wanted to NaN"
        )
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

    twins = sorted({name for name in table.columns if list(table.columns).count(name) > 1})
    if twins:
        raise WrongOutputError(f"two columns of the table are called `{twins[0]}`")

    rows = [
        [_cell(value, f"column `{table.columns[place]}` of the table") for place, value in enumerate(row)] for row in table.rows
    ]
    return _json({"columns": list(table.columns), "rows": rows})


def _cell(value: Any, place: str) -> Any:
    """A number, text or flag as it is kept; nothing where there is no value."""
    value = value.item() if isinstance(value, np.generic) else value
    if value is None or value is np.ma.masked or (isinstance(value, float) and np.isnan(value)):
        return None
    if isinstance(value, float) and np.isinf(value):
        raise WrongOutputError(f"{place} has {value}, which no number of a table is; give NaN or a text")
    is_whole = isinstance(value, int) and not isinstance(value, bool)
    if is_whole and (not -(2**63) < value < 2**63 or int(float(value)) != value):
        raise WrongOutputError(f"{place} has {value}, more digits than a number holds; give it as a text")
    if not isinstance(value, int | float | str | bool):
        raise WrongOutputError(f"{place} has {value!r}; numbers, texts and flags are kept")
    return value


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
    return _json({"frame": cameras.written_frame(), "sensors": sensors, "images": images})


def _written_transform(transform: Transform) -> bytes:
    arrays = {name: np.asarray(getattr(transform, name), float) for name in ("rotation", "origin", "translation")}
    return _json({"from": transform.source, "to": transform.target, **arrays})


def _written_covariance(covariance: Covariance) -> bytes:
    value = {
        "frame": covariance.written_frame(),
        "parameters": covariance.parameters,
        "matrix": np.asarray(covariance.matrix, float),
    }
    return _json({**value, "sigma0_applied": covariance.sigma0_applied, "full_joint": covariance.full_joint})


def _written_inventory(inventory: Inventory) -> bytes:
    """The collection as it is kept: whole columns, MultiPolygons, and the frame of the object."""
    collection = inventory.geojson
    features = collection.get("features") if isinstance(collection, Mapping) else None
    if not isinstance(features, list | tuple):
        raise WrongOutputError("`geojson` is no feature collection: it has no list `features`")
    about = collection.get("rockface") or {}
    if not all(isinstance(feature, Mapping) for feature in features) or not isinstance(about, Mapping):
        raise WrongOutputError("`geojson` is no feature collection: a feature, or `rockface`, is no map")
    properties = [{str(name): value for name, value in (feature.get("properties") or {}).items()} for feature in features]
    listed = [name for name in about.get("columns", []) if not properties or any(name in own for own in properties)]
    columns = list(dict.fromkeys([*listed, *(name for own in properties for name in own)]))
    kept = []
    for number, (feature, own) in enumerate(zip(features, properties, strict=True)):
        told = f"feature {number} (counted from 0)"
        values = {name: _cell(own.get(name), f"`{name}` of {told}") for name in columns}
        kept.append({"type": "Feature", "properties": values, "geometry": _outline(feature.get("geometry"), told)})
    frame = _inventory_frame(inventory)
    return _json({"type": "FeatureCollection", "rockface": {"frame": frame, "columns": columns}, "features": kept})


def _outline(geometry: Any, told: str) -> dict[str, Any] | None:
    """The geometry of a feature as a MultiPolygon in plan; nothing without an outline."""
    if geometry is None:
        return None
    kind = geometry.get("type") if isinstance(geometry, Mapping) else type(geometry).__name__
    if kind not in ("Polygon", "MultiPolygon"):
        raise WrongOutputError(f"the geometry of {told} is a {kind}; outlines are a Polygon, a MultiPolygon or nothing")
    given = geometry.get("coordinates", ())
    polygons = [polygon for polygon in ([given] if kind == "Polygon" else given) if len(polygon)]
    try:
        rings = [[[[float(place[0]), float(place[1])] for place in ring] for ring in polygon] for polygon in polygons]
        if not all(np.isfinite(place).all() for polygon in rings for ring in polygon for place in ring):
            raise ValueError("a coordinate is not finite")
    except (TypeError, ValueError, LookupError) as error:
        raise WrongOutputError(f"the geometry of {told} has no rings of places: {error}") from error
    return {"type": "MultiPolygon", "coordinates": rings} if rings else None


def _inventory_frame(inventory: Inventory) -> str | dict[str, Any]:
    """The frame as it is written: of the object, with the system that the collection names where the object names none."""
    if inventory.georeference is not None:
        return inventory.written_frame()
    stated = (inventory.geojson.get("rockface") or {}).get("frame")
    crs = inventory.geojson.get("crs")
    if isinstance(stated, dict) and stated.get("axes") == str(inventory.frame):
        return stated
    named = str((crs.get("properties") or {}).get("name", "")) if isinstance(crs, Mapping) else ""
    code = re.fullmatch(r"(?:urn:ogc:def:crs:EPSG:[^:]*|EPSG):(\d+)", named)
    if code and inventory.frame is Frame.WORLD:
        return {"axes": str(inventory.frame), "crs": f"EPSG:{code[1]}"}
    return str(inventory.frame)


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
    "inventory": _written_inventory,
    "picture": lambda value: bytes(value.png),
    "figure": lambda value: value.svg.encode(),
    "file": lambda value: bytes(value.data),
    "files": _written_files,
}
