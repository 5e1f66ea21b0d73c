"""PLY files as rockface writes them: binary little-endian meshes, named meshes and clouds; vertices are views of the data."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rockface._errors import FormatError
from rockface.artefacts import Cloud, Frame, Georeference, Mesh, Meshes, Part, Placed

__all__ = ["RESERVED", "georeference_lines", "read", "write_cloud", "write_mesh"]

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "<i2", "int16": "<i2", "ushort": "<u2",
    "uint16": "<u2", "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4", "float": "<f4", "float32": "<f4",
    "double": "<f8", "float64": "<f8",
}  # fmt: skip
COLOURS = ("red", "green", "blue")
NORMALS = ("nx", "ny", "nz")
RESERVED = ("x", "y", "z", *NORMALS, *COLOURS)
"""Properties of a vertex that no number of a cloud may be called."""
GEOREFERENCE = "comment rockface georeference "
OTHER = "open it with trimesh, or let `rockface inspect` describe it"

Array = NDArray[Any]


@dataclass
class _Element:
    name: str
    count: int
    fields: list[tuple[str, str] | tuple[str, str, tuple[int]]]


def read(data: memoryview) -> Mesh | Meshes | Cloud:
    """Reads a mesh, named meshes or a cloud, whichever the file holds.

    Raises:
        FormatError: the file is no binary PLY, is cut short, or has faces that are no triangles.
    """
    end = bytes(data[: 1 << 24]).find(b"end_header\n")
    if bytes(data[:4]) != b"ply\n" or end < 0:
        raise FormatError("not a PLY file: it does not begin like one")
    lines = bytes(data[:end]).decode("ascii", "replace").splitlines()
    try:
        elements = _elements(lines)
        rows = _rows(data, end + len(b"end_header\n"), elements)
    except (LookupError, ArithmeticError, ValueError) as error:
        raise FormatError(f"damaged PLY file: {error!r}") from error
    if "vertex" not in rows:
        raise FormatError("a PLY file without vertices")
    if any(line.startswith("comment part ") for line in lines):
        return _meshes(lines, rows)
    vertices, frame = rows["vertex"], _frame(lines)
    is_mesh = any(line.startswith("comment rockface mesh,") for line in lines)
    if "face" in rows and (is_mesh or len(rows["face"])):
        triangles, colours = _triangles(rows["face"]), _columns(vertices, COLOURS)
        return Mesh(frame, _columns(vertices, ("x", "y", "z")), triangles, colours, _georeference(lines))
    further = [name for name in vertices.dtype.names or () if name not in RESERVED]
    numbers = {name: vertices[name] for name in further if vertices.dtype[name] == np.dtype("<u4")}
    is_cloud = any(line.startswith("comment rockface cloud,") for line in lines)
    values = {name: vertices[name] for name in further if is_cloud and vertices.dtype[name] == np.dtype("<f4")}
    points, normals, colours = (_columns(vertices, names) for names in (("x", "y", "z"), NORMALS, COLOURS))
    return Cloud(frame, points, normals, colours, numbers, _georeference(lines), values)


def _elements(lines: list[str]) -> list[_Element]:
    elements: list[_Element] = []
    for line in lines:
        words = line.split()
        if words[:1] == ["format"] and words[1] != "binary_little_endian":
            raise FormatError(f"a PLY file in {words[1]}: {OTHER}")
        if words[:1] == ["element"]:
            elements.append(_Element(words[1], int(words[2]), []))
        elif words[:2] == ["property", "list"]:
            elements[-1].fields += [("count", TYPES[words[2]]), (words[4], TYPES[words[3]], (3,))]
        elif words[:1] == ["property"]:
            elements[-1].fields.append((words[2], TYPES[words[1]]))
    return elements


def _rows(data: memoryview, at: int, elements: list[_Element]) -> dict[str, Array]:
    rows = {}
    for element in elements:
        layout = np.dtype(element.fields)
        rows[element.name] = np.frombuffer(data, layout, element.count, at) if element.count else np.empty(0, layout)
        at += element.count * layout.itemsize
        names = layout.names or ()
        if "count" in names and not np.all(rows[element.name]["count"] == 3):
            raise FormatError(f"a PLY file with faces that are no triangles: {OTHER}")
    return rows


def _frame(lines: list[str]) -> Frame:
    stated = [
        line.split(", frame ")[1].split(",")[0] for line in lines if line.startswith("comment rockface") and ", frame " in line
    ]
    return Frame(stated[0]) if stated else Frame.WORLD


def _georeference(lines: list[str]) -> Georeference | None:
    stated = [line.removeprefix(GEOREFERENCE) for line in lines if line.startswith(GEOREFERENCE)]
    return Georeference.of(json.loads(stated[0])) if stated else None


def georeference_lines(placed: Placed) -> list[str]:
    """The line of a header that says where the frame lies on the Earth."""
    own = placed.georeference
    return [GEOREFERENCE + json.dumps(own.as_dict(), separators=(",", ":"))] if own else []


def _columns(rows: Array, names: tuple[str, ...]) -> Array:
    """Neighbouring columns as an array n x 3 without a copy; 0 x 3 where the file has none."""
    known: Mapping[str, Any] = rows.dtype.fields or {}
    if any(name not in known for name in names):
        return np.empty((0, 3), np.uint8 if names == COLOURS else np.float32)
    kind, start = known[names[0]][:2]
    if [known[name][1] for name in names] != [start + kind.itemsize * place for place in range(3)] or not len(rows):
        return np.stack([rows[name] for name in names], axis=1)
    # A field of three values in place of three fields.
    triples = np.dtype({"names": ["v"], "formats": [(kind, (3,))], "offsets": [start], "itemsize": rows.dtype.itemsize})
    return rows.view(triples)["v"]


def _triangles(faces: Array) -> Array:
    return faces[(faces.dtype.names or ())[1]].astype(np.uint32, copy=False)


def _meshes(lines: list[str], rows: dict[str, Array]) -> Meshes:
    vertices, triangles = _columns(rows["vertex"], ("x", "y", "z")), _triangles(rows["face"])
    parts, first_vertex, first_face = [], 0, 0
    for line in lines:
        if not line.startswith("comment part "):
            continue
        _, _, _, _, v, _, f, words = line.split(" ", 7)
        name, kind = json.loads(words)
        own = triangles[first_face : first_face + int(f)]
        own = (own.astype(np.int64) - first_vertex).astype(np.uint32)
        parts.append(Part(name, kind, vertices[first_vertex : first_vertex + int(v)], own))
        first_vertex, first_face = first_vertex + int(v), first_face + int(f)
    return Meshes(_frame(lines), parts, _georeference(lines))


def write_mesh(mesh: Mesh) -> bytes:
    """The file of a mesh: double vertices, triangles, colours where there are any."""
    fields: list[Any] = [("xyz", "<f8", (3,))]
    header = ["ply", "format binary_little_endian 1.0", f"comment rockface mesh, frame {mesh.frame}, units metres"]
    header += [*georeference_lines(mesh), f"element vertex {len(mesh.vertices)}", *(f"property double {axis}" for axis in "xyz")]
    if len(mesh.colours):
        fields.append(("rgb", "u1", (3,)))
        header += [f"property uchar {colour}" for colour in COLOURS]
    header += [f"element face {len(mesh.triangles)}", "property list uchar uint vertex_indices", "end_header\n"]
    vertices = np.zeros(len(mesh.vertices), np.dtype(fields))
    vertices["xyz"] = mesh.vertices
    if len(mesh.colours):
        vertices["rgb"] = mesh.colours
    faces = np.zeros(len(mesh.triangles), np.dtype([("count", "u1"), ("corners", "<u4", (3,))]))
    faces["count"], faces["corners"] = 3, mesh.triangles
    return "\n".join(header).encode("ascii") + vertices.tobytes() + faces.tobytes()


def write_cloud(cloud: Cloud) -> bytes:
    """The file of a cloud: double points, float normals and colours where there are any, its numbers and its values."""
    fields: list[Any] = [("xyz", "<f8", (3,))]
    header = ["ply", "format binary_little_endian 1.0", f"comment rockface cloud, frame {cloud.frame}, units metres"]
    header += [*georeference_lines(cloud), f"element vertex {len(cloud.points)}", *(f"property double {axis}" for axis in "xyz")]
    if len(cloud.normals):
        fields.append(("normal", "<f4", (3,)))
        header += [f"property float {axis}" for axis in NORMALS]
    if len(cloud.colours):
        fields.append(("rgb", "u1", (3,)))
        header += [f"property uchar {colour}" for colour in COLOURS]
    fields += [(f"number {name}", "<u4") for name in sorted(cloud.numbers)]
    fields += [(f"value {name}", "<f4") for name in sorted(cloud.values)]
    header += [f"property uint {name}" for name in sorted(cloud.numbers)]
    header += [*(f"property float {name}" for name in sorted(cloud.values)), "end_header\n"]
    rows = np.zeros(len(cloud.points), np.dtype(fields))
    rows["xyz"] = cloud.points
    if len(cloud.normals):
        rows["normal"] = cloud.normals
    if len(cloud.colours):
        rows["rgb"] = cloud.colours
    for name, values in cloud.numbers.items():
        rows[f"number {name}"] = values
    for name, measured in cloud.values.items():
        rows[f"value {name}"] = measured
    return "\n".join(header).encode("ascii") + rows.tobytes()
