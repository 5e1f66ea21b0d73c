"""GeoTIFF, read with numpy and zlib: classic TIFF in tiles or strips, uncompressed or deflated, with any predictor."""

from __future__ import annotations

import json
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from html import unescape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rockface._errors import FormatError
from rockface.artefacts import Frame, Georeference, Grid, Raster

__all__ = ["read"]

WIDTH, HEIGHT, BITS, COMPRESSION, STRIPS, SAMPLES, ROWS = 256, 257, 258, 259, 273, 277, 278
STRIP_BYTES, PLANAR, PREDICTOR, TILE_WIDTH, TILE_HEIGHT = 279, 284, 317, 322, 323
TILES, TILE_BYTES, FORMAT, SCALE, TIEPOINT, KEYS = 324, 325, 339, 33550, 33922, 34735
METADATA, NODATA = 42112, 42113
MODEL, PROJECTED_MODEL, LENGTH_UNIT, HEIGHT_UNIT, METRE = 1024, 1, 3076, 4099, 9001
KIND, MASK, TEXTS, MOST_DIRECTORIES = 254, 4, 34737, 64
WORLD = "rockface world frame"
"""What our files in the world frame call their system where none is known."""
MOST_EXPANSION = 1400
"""No compression that is read here expands further."""
PIXEL_IS, POINT = 1025, 2
PROJECTED, VERTICAL, USER_DEFINED = 3072, 4096, 32767

TYPES = {1: "B", 2: "s", 3: "H", 4: "I", 5: "II", 6: "b", 8: "h", 9: "i", 11: "f", 12: "d", 13: "I"}
FORMATS = {1: "u", 2: "i", 3: "f"}
OTHER = "open it with rasterio, or rewrite it with `gdal_translate -co COMPRESS=DEFLATE`"
IMPORT = "open it with rasterio, or take what the stage `import-rasters` makes of it"

Array = NDArray[Any]


def read(data: memoryview) -> Raster:
    """Reads a raster; values are float32, or whole numbers as they are in the file.

    Raises:
        FormatError: the file is no TIFF, is cut short, has no georeference, or a compression this reader does not know.
    """
    try:
        directory = _directory(data)
        _check_masks(data, directory)
        bands = _bands(data, _Layout(directory), directory.text(NODATA).strip())
    except (struct.error, zlib.error, KeyError, IndexError, ValueError) as error:
        raise FormatError(f"damaged GeoTIFF: {error!r}") from error
    return _raster(directory, bands)


@dataclass(frozen=True)
class _Directory:
    order: str
    tags: dict[int, tuple[Any, ...]]
    following: int
    """Where the next one begins, or 0."""

    def text(self, tag: int) -> str:
        values = self.tags.get(tag, (b"",))
        return bytes(values[0]).rstrip(b"\0").decode("ascii", "replace")

    def one(self, tag: int, default: int | None = None) -> int:
        if tag in self.tags:
            return int(self.tags[tag][0])
        if default is None:
            raise FormatError(f"the TIFF has no tag {tag}: {OTHER}")
        return default


def _check_masks(data: memoryview, directory: _Directory) -> None:
    """Refuses a file that says by a mask of its own which cells have a value: they would all count."""
    for _ in range(MOST_DIRECTORIES):
        if not directory.following:
            return
        directory = _directory(data, directory.following)
        if directory.one(KIND, 0) & MASK:
            raise FormatError(f"the TIFF has a mask of its own: {IMPORT}")


def _directory(data: memoryview, start: int | None = None) -> _Directory:
    order = {b"II": "<", b"MM": ">"}.get(bytes(data[:2]))
    if order is None:
        raise FormatError("not a TIFF: it does not begin like one")
    magic, first = struct.unpack_from(order + "HI", data, 2)
    if magic != 42:
        raise FormatError(f"a TIFF of another kind (BigTIFF): {OTHER}")
    start = first if start is None else start
    (count,) = struct.unpack_from(order + "H", data, start)
    tags = {}
    for entry in range(count):
        place = start + 2 + 12 * entry
        tag, kind, number = struct.unpack_from(order + "HHI", data, place)
        code = TYPES.get(kind)
        if code is None:
            continue
        if number * struct.calcsize(f"{order}{code}") > len(data):
            raise FormatError(f"damaged GeoTIFF: tag {tag} claims {number} values, more than the file can hold")
        form = f"{order}{number}s" if code == "s" else order + code * number
        size = struct.calcsize(form)
        at = place + 8 if size <= 4 else struct.unpack_from(order + "I", data, place + 8)[0]
        tags[tag] = struct.unpack_from(form, data, at)
    (following,) = struct.unpack_from(order + "I", data, start + 2 + 12 * count)
    return _Directory(order, tags, following)


class _Layout:
    """How the values lie in the file."""

    def __init__(self, directory: _Directory) -> None:
        one, tags = directory.one, directory.tags
        self.columns, self.rows = one(WIDTH), one(HEIGHT)
        self.samples = one(SAMPLES, 1)
        self.planar = one(PLANAR, 1) == 2
        self.predictor = one(PREDICTOR, 1)
        self.compression = one(COMPRESSION, 1)
        kinds = {(int(bits), int(form)) for bits, form in zip(tags[BITS], tags.get(FORMAT, (1,) * 99999), strict=False)}
        if len(kinds) != 1 or self.compression not in (1, 8, 32946):
            raise FormatError(f"a TIFF with compression {self.compression} and values {sorted(kinds)}: {OTHER}")
        ((bits, form),) = kinds
        if bits not in (8, 16, 32, 64) or form not in FORMATS:
            raise FormatError(f"a TIFF with values of {bits} bits and format {form}: {OTHER}")
        self.dtype = np.dtype(f"{directory.order}{FORMATS[form]}{bits // 8}")
        tiled = TILES in tags
        self.width = one(TILE_WIDTH) if tiled else self.columns
        self.height = one(TILE_HEIGHT) if tiled else min(one(ROWS, self.rows), self.rows)
        self.offsets = tags[TILES if tiled else STRIPS]
        self.lengths = tags[TILE_BYTES if tiled else STRIP_BYTES]
        self.tiled = tiled

    @property
    def per_chunk(self) -> int:
        """Samples a cell of a chunk has."""
        return 1 if self.planar else self.samples

    def chunks(self) -> Iterator[tuple[int, int, int, int]]:
        """Number, first band, first row and first column of each chunk."""
        across, down = -(-self.columns // self.width), -(-self.rows // self.height)
        for number in range(across * down * (self.samples if self.planar else 1)):
            band, place = divmod(number, across * down)
            row, column = divmod(place, across)
            yield number, band, row * self.height, column * self.width


def _bands(data: memoryview, layout: _Layout, nodata: str) -> Array:
    size = layout.samples * layout.rows * layout.columns * layout.dtype.itemsize
    if size > MOST_EXPANSION * len(data):
        raise FormatError(f"damaged GeoTIFF: {layout.rows} x {layout.columns} x {layout.samples} values in {len(data)} bytes")
    bands = np.empty((layout.samples, layout.rows, layout.columns), layout.dtype.newbyteorder("="))
    for number, band, top, left in layout.chunks():
        height = layout.height if layout.tiled else min(layout.height, layout.rows - top)
        start, length = layout.offsets[number], layout.lengths[number]
        if length == 0:
            if not nodata:
                raise FormatError(f"the TIFF leaves tiles out and has no no-data value: {OTHER}")
            bands[band : band + layout.per_chunk, top : top + height, left : left + layout.width] = float(nodata)
            continue
        raw = bytes(data[start : start + length])
        if layout.compression != 1:
            raw = zlib.decompress(raw)
        chunk = _decoded(raw, layout, height)
        part = chunk[: layout.rows - top, : layout.columns - left]
        target = bands[band : band + layout.per_chunk, top : top + part.shape[0], left : left + part.shape[1]]
        target[...] = np.moveaxis(part, 2, 0)
    return bands


def _decoded(raw: bytes, layout: _Layout, height: int) -> Array:
    """The values of a chunk: height x width x samples."""
    shape, size = (height, layout.width, layout.per_chunk), layout.dtype.itemsize
    if len(raw) < height * layout.width * layout.per_chunk * size:
        raise FormatError("damaged GeoTIFF: a tile is too short; copy the file again")
    if layout.predictor == 3:
        line = layout.width * layout.per_chunk
        planes = np.frombuffer(raw, np.uint8, height * line * size).reshape(
            height, line * size // layout.per_chunk, layout.per_chunk
        )
        planes = np.cumsum(planes, axis=1, dtype=np.uint8).reshape(height, size, line)
        values = np.ascontiguousarray(np.moveaxis(planes, 1, 2)).view(f">f{size}")
        return values.reshape(shape)
    values = np.frombuffer(raw, layout.dtype, height * layout.width * layout.per_chunk).reshape(shape)
    if layout.predictor == 2:
        # Differences are those of the bits, also of floats.
        own = values.dtype.newbyteorder("=")
        whole = np.dtype(f"u{size}")
        return np.cumsum(values.astype(own).view(whole), axis=1, dtype=whole).view(own)
    return values


def _raster(directory: _Directory, bands: Array) -> Raster:
    tags, metadata = directory.tags, directory.text(METADATA)
    if SCALE not in tags or TIEPOINT not in tags:
        raise FormatError(f"the TIFF has no georeference (ModelPixelScale and ModelTiepoint): {OTHER}")
    scale_x, scale_y, *_ = tags[SCALE]
    column, row, _, x, y, *_ = tags[TIEPOINT]
    if abs(scale_x - scale_y) > 1e-9 * abs(scale_x):
        raise FormatError(f"cells must be square; this file has {scale_x} by {scale_y}: {OTHER}")
    keys = _geo_keys(tags.get(KEYS, ()))
    _check_metres(metadata, keys)
    half = 0.5 * scale_x if keys.get(PIXEL_IS) == POINT else 0.0
    left, top = x - column * scale_x - half, y + row * scale_y + half
    grid = Grid(bands.shape[2], bands.shape[1], scale_x, left, top)
    names = {
        int(number): unescape(name)
        for number, name in re.findall(r'<Item[^>]*sample="(\d+)"[^>]*role="description"[^>]*>([^<]*)</Item>', metadata)
    }
    named = {names.get(number, f"band {number + 1}"): band for number, band in enumerate(_without(bands, directory.text(NODATA)))}
    place = _georeference(metadata, keys)
    is_world = place or keys.get(MODEL) == PROJECTED_MODEL or WORLD in directory.text(TEXTS)
    frame = Frame(_item(metadata, "FRAME") or ("world" if is_world else "wall"))
    return Raster(grid, frame, _item(metadata, "QUANTITY") or "value", named, place)


def _geo_keys(directory: tuple[Any, ...]) -> dict[int, int]:
    """The geographic keys that are numbers, which stand in the directory of keys itself."""
    entries = (directory[at : at + 4] for at in range(4, len(directory) - 3, 4))
    return {key: value for key, place, _, value in entries if place == 0}


def _check_metres(metadata: str, keys: dict[int, int]) -> None:
    """Refuses a file, as other programs write them, whose numbers are not metres as they stand."""
    if keys.get(MODEL, PROJECTED_MODEL) not in (PROJECTED_MODEL, USER_DEFINED, 0):
        raise FormatError(f"its coordinates are degrees, or lie in space, not in a plane: {IMPORT}")
    for what, key in (("coordinates", LENGTH_UNIT), ("heights", HEIGHT_UNIT)):
        if keys.get(key, METRE) != METRE:
            raise FormatError(f"its {what} are not in metres (unit {keys[key]}): {IMPORT}")
    if re.search(r'role="(scale|offset)"', metadata):
        raise FormatError(f"its numbers have a scale or an offset: {IMPORT}")


def _georeference(metadata: str, keys: dict[int, int]) -> Georeference | None:
    """Where the frame lies: as our own files state it, else by the codes of the projected and the vertical system."""
    stated = _item(metadata, "GEOREFERENCE")
    if stated:
        # GDAL writes out what is written out already.
        return Georeference.of(json.loads(stated if stated.startswith("{") and '"' in stated else unescape(stated)))
    known = [str(keys[key]) for key in (PROJECTED, VERTICAL) if keys.get(key, USER_DEFINED) != USER_DEFINED]
    return Georeference("EPSG:" + "+".join(known)) if PROJECTED in keys and known else None


def _without(bands: Array, nodata: str) -> Array:
    """Cells with the value that stands for none become NaN."""
    value = float(nodata) if nodata.strip() else np.nan
    if not np.isfinite(value) or not (bands == value).any():
        return bands
    if bands.dtype.kind != "f":
        bands = bands.astype(np.float32 if bands.dtype.itemsize < 4 else np.float64)
    bands[bands == value] = np.nan
    return bands


def _item(metadata: str, name: str) -> str | None:
    found = re.search(rf'<Item name="{name}">([^<]*)</Item>', metadata)
    return unescape(found[1]) if found else None
