"""Reads the file of any artefact by its kind."""

from __future__ import annotations

import io
import json
import mmap
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from rockface._errors import FormatError
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
    Image,
    Inventory,
    Mesh,
    Meshes,
    Pair,
    Pairs,
    Picture,
    Raster,
    Record,
    Sensor,
    Surface,
    Table,
    Transform,
)
from rockface.formats import exr, geotiff, ply

__all__ = ["Artefact", "decode", "read"]

Artefact = (
    Raster | DepthMap | Mesh | Meshes | Cloud | Surface | Cameras | Pairs | Transform | Covariance | Table | Inventory
    | Picture | Figure | File | Files | Record
)  # fmt: skip
"""Anything a step makes."""

KINDS = {
    ".tif": "raster", ".tiff": "raster", ".exr": "depth", ".ply": "ply", ".surface": "surface", ".png": "picture",
    ".noise": "noise",
    ".svg": "figure", ".geojson": "inventory", ".tar": "files", ".json": "json",
}  # fmt: skip
OTHERS = {".csv": "pandas.read_csv", ".parquet": "pandas.read_parquet", ".laz": "laspy.read", ".las": "laspy.read"}
"""What reads further files, which steps write for other programs."""
BESIDE = {".csv": "JSON or GeoJSON", ".parquet": "JSON or GeoJSON", ".laz": "PLY", ".las": "PLY"}
SURFACE = b"rockface surface 1\n"
NOISE = b"rockface noise 18\n"
RASTER = b"rockface raster 1\n"


def read(path: str | Path) -> Artefact:
    """Reads a file that rockface wrote, by its extension: arrays are views of the mapped file where the format allows.

    ```python
    difference = rockface.read("outputs/change/raster.tif")
    ```

    Raises:
        FormatError: the file is damaged, or of a kind that is not read here.
    """
    path = Path(path)
    ending = path.suffix.lower()
    if ending in OTHERS:
        raise FormatError(f"{path.name} is read with {OTHERS[ending]}; in a run folder the same is beside it as {BESIDE[ending]}")
    return decode(KINDS.get(ending, "file"), mapped(path))


def mapped(path: Path) -> memoryview:
    """The bytes of a file, mapped into memory and not copied."""
    with path.open("rb") as file:
        if path.stat().st_size == 0:
            return memoryview(b"")
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def decode(kind: str, data: memoryview) -> Artefact:
    """The artefact of this kind in these bytes."""
    reader = READERS.get(kind)
    if reader is None:
        raise FormatError(f"unknown kind of artefact `{kind}`")
    try:
        return reader(data)
    except (
        LookupError,
        ArithmeticError,
        AttributeError,
        TypeError,
        ValueError,
        MemoryError,
        RecursionError,
        tarfile.TarError,
    ) as error:
        raise FormatError(f"the bytes are no {kind}: {error!r}") from error


def _json(data: memoryview) -> dict[str, Any]:
    value = json.loads(bytes(data))
    if not isinstance(value, dict):
        raise FormatError("not the JSON of an artefact")
    return value


def _any_json(data: memoryview) -> Artefact:
    """JSON whose kind follows from its keys."""
    value = _json(data)
    marks = {"images": "cameras", "pairs": "pairs", "rotation": "transform", "matrix": "covariance", "rows": "table"}
    kind = next((kind for key, kind in marks.items() if key in value), None)
    return READERS[kind](data) if kind else Record("json", value)


def _cameras(data: memoryview) -> Cameras:
    value = _json(data)
    sensors, images = map(Sensor.of, value["sensors"]), map(Image.of, value["images"])
    return Cameras(Frame.of(value["frame"]), list(sensors), list(images), Georeference.of(value["frame"]))


def _transform(data: memoryview) -> Transform:
    value = _json(data)
    arrays = (np.array(value[key], float) for key in ("rotation", "origin", "translation"))
    return Transform(value["from"], value["to"], *arrays)


def _covariance(data: memoryview) -> Covariance:
    value = _json(data)
    matrix = np.array(value["matrix"], float)
    told = (value["sigma0_applied"], value["full_joint"], Georeference.of(value["frame"]))
    return Covariance(Frame.of(value["frame"]), value["parameters"], matrix, *told)


def _table(data: memoryview) -> Table:
    value = _json(data)
    return Table(value["columns"], value["rows"])


def _inventory(data: memoryview) -> Inventory:
    value = _json(data)
    frame = value.get("rockface", {}).get("frame", "wall")
    return Inventory(Frame.of(frame), value, Georeference.of(frame))


def _files(data: memoryview) -> Files:
    with tarfile.open(fileobj=io.BytesIO(data)) as tar:
        members = ((member.name, tar.extractfile(member)) for member in tar if member.isfile())
        return Files({name: file.read() for name, file in members if file})


def _surface(data: memoryview) -> Surface:
    if bytes(data[: len(SURFACE)]) != SURFACE:
        raise FormatError("not a surface of rockface (version 1)")
    header, at = _header(data, len(SURFACE))
    height, width = header["height"], header["width"]
    points = np.frombuffer(data, "<f4", height * width * 3, at).reshape(height, width, 3)
    squares = np.frombuffer(data, np.uint8, offset=at + points.nbytes).reshape(height - 1, width - 1)
    x, y, z = header["origin_m"]
    return Surface(Frame.of(header["frame"]), (x, y, z), points, squares, Georeference.of(header["frame"]))


def _noise(data: memoryview) -> Record:
    """What the header of a noise model says; its rasters stay in the file."""
    if bytes(data[: len(NOISE)]) != NOISE:
        raise FormatError(f"not a noise model in the layout of this package (`{NOISE.decode().strip()}`)")
    return Record("noise", _header(data, len(NOISE))[0])


def _header(data: memoryview, at: int) -> tuple[dict[str, Any], int]:
    """The line of JSON from here on, and where the next line begins."""
    end = bytes(data[at : at + (1 << 20)]).find(b"\n")
    if end < 0:
        raise FormatError("damaged file: its header has no end")
    header: dict[str, Any] = json.loads(bytes(data[at : at + end]))
    return header, at + end + 1


def _mesh_like(kind: type) -> Callable[[memoryview], Artefact]:
    def reader(data: memoryview) -> Artefact:
        value = ply.read(data)
        if not isinstance(value, kind):
            raise FormatError(f"the PLY file holds a {type(value).__name__}, not a {kind.__name__}")
        return value

    return reader


READERS: dict[str, Callable[[memoryview], Artefact]] = {
    "raster": geotiff.read,
    "depth": exr.read,
    "ply": ply.read,
    "mesh": _mesh_like(Mesh),
    "meshes": _mesh_like(Meshes),
    "cloud": _mesh_like(Cloud),
    "surface": _surface,
    "cameras": _cameras,
    "pairs": lambda data: Pairs([Pair(**pair) for pair in _json(data)["pairs"]]),
    "transform": _transform,
    "covariance": _covariance,
    "table": _table,
    "inventory": _inventory,
    "picture": lambda data: Picture(bytes(data)),
    "figure": lambda data: Figure(bytes(data).decode()),
    "file": lambda data: File(bytes(data)),
    "files": _files,
    "acceptance": lambda data: Record("acceptance", _json(data)),
    "candidates": lambda data: Record("candidates", _json(data)),
    "noise": _noise,
    "json": _any_json,
}
