"""Artefacts as Python values: arrays with their grid, frame, camera or names. Lengths are metres, angles radians."""

from __future__ import annotations

import html
import io
import itertools
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from difflib import get_close_matches
from enum import Enum
from typing import Any, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from rockface._errors import RockfaceError

__all__ = [
    "Cameras",
    "Cloud",
    "Covariance",
    "DepthMap",
    "Figure",
    "File",
    "Files",
    "Frame",
    "Georeference",
    "Grid",
    "Image",
    "Inventory",
    "Mesh",
    "Meshes",
    "Pair",
    "Pairs",
    "Part",
    "Picture",
    "Raster",
    "Record",
    "Sensor",
    "Surface",
    "Table",
    "Transform",
]

Array = NDArray[Any]
Cell = float | str | bool | None

T = TypeVar("T")

SHOWN_FILES = 5
"""Files that the text of several names."""
SEARCHED_NAMES = 1000
"""Names among which an error looks for those that are spelt nearly so, at most: of 20 000 that takes more than a second."""


class Frame(str, Enum):
    """The frame coordinates are in."""

    WORLD = "world"
    """The reference system of the input."""
    WALL = "wall"
    """X along the face, Y up the face, Z out of the rock towards the viewer; metres."""

    def __str__(self) -> str:
        return self.value

    @staticmethod
    def of(written: Any) -> Frame:
        """The frame of its JSON: a name, or a map that also says where it lies on the Earth."""
        return Frame(written["axes"] if isinstance(written, dict) else written)


@dataclass(frozen=True)
class Georeference:
    """Where a frame lies on the Earth, or on its site where that is in no known place on it."""

    crs: str | None
    """The coordinate reference system of the world frame, such as `EPSG:28356`, or its well-known text, if one is stated."""
    wall_from_world: Mapping[str, Any] | None = None
    """How the wall frame lies in the world frame: `rotation`, `origin` and `translation`; nothing for the world frame itself."""

    @staticmethod
    def of(written: Any) -> Georeference | None:
        """What the JSON of a frame, or of a georeference, says; a name alone says nothing."""
        return Georeference(written.get("crs"), written.get("wall_from_world")) if isinstance(written, dict) else None

    def as_dict(self) -> dict[str, Any]:
        """Its JSON."""
        way = {} if self.wall_from_world is None else {"wall_from_world": dict(self.wall_from_world)}
        return {**({} if self.crs is None else {"crs": self.crs}), **way}


class Placed:
    """Something in a frame that may say where it lies on the Earth."""

    frame: Frame
    georeference: Georeference | None

    @property
    def crs(self) -> str | None:
        """The coordinate reference system of its coordinates; nothing in the wall frame, and where none is known."""
        return self.georeference.crs if self.georeference and self.frame is Frame.WORLD else None

    def written_frame(self) -> str | dict[str, Any]:
        """Its frame as JSON."""
        return {"axes": str(self.frame), **self.georeference.as_dict()} if self.georeference else str(self.frame)

    def _where(self) -> str:
        """The frame, and what it lies in, for people."""
        crs = self.georeference.crs if self.georeference else None
        if crs is None:
            return f"{self.frame} frame"
        shown = crs if len(crs) <= 40 else crs[:40] + "…"
        return f"{self.frame} frame, {shown}" if self.frame is Frame.WORLD else f"{self.frame} frame of {shown}"


def _needed(package: str, purpose: str) -> Any:
    """A package that is not required, or an error that names it."""
    import importlib

    try:
        return importlib.import_module(package)
    except ImportError as error:
        name = package.partition(".")[0]
        raise RockfaceError(f"{purpose} needs the package {name}: `pip install {name}`") from error


def unmasked(values: Any) -> Array:
    """Values as a plain array: NaN where floats are masked; for masked whole numbers and flags there is no such value."""
    if isinstance(values, np.ma.MaskedArray) and np.ma.is_masked(values):
        if values.dtype.kind != "f":
            raise ValueError(
                f"{int(np.ma.getmaskarray(values).sum())} cells of an array of {values.dtype} are masked: fill them, or give floats"
            )
        return np.asarray(values.filled(np.nan))
    return np.asarray(values)


def _lacking(what: str, name: object, known: Iterable[str]) -> KeyError:
    """That there is no such thing, and what there is."""
    names = list(known)
    near = get_close_matches(str(name), names, 3, 0.6) if len(names) <= SEARCHED_NAMES else []
    listed = ", ".join(near or names[:8]) + (", …" if not near and len(names) > 8 else "")
    return KeyError(f"no {what} `{name}`; there are {listed}" if names else f"no {what} `{name}`; there are none")


@dataclass(frozen=True)
class Grid:
    """Square cells of a raster; rows go down (Y decreases), columns to the right (X increases)."""

    columns: int
    rows: int
    cell_m: float
    """Side of a cell, metres."""
    left_m: float
    """X of the left edge of the first column, metres."""
    top_m: float
    """Y of the upper edge of the first row, metres."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns, the shape of a band."""
        return self.rows, self.columns

    @property
    def x_m(self) -> NDArray[np.float64]:
        """X of the centres of the columns, metres."""
        return np.asarray(self.left_m + (np.arange(self.columns) + 0.5) * self.cell_m, np.float64)

    @property
    def y_m(self) -> NDArray[np.float64]:
        """Y of the centres of the rows, metres."""
        return np.asarray(self.top_m - (np.arange(self.rows) + 0.5) * self.cell_m, np.float64)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top, metres: `extent` of `matplotlib.pyplot.imshow`."""
        bottom = self.top_m - self.rows * self.cell_m
        return self.left_m, self.left_m + self.columns * self.cell_m, bottom, self.top_m

    @property
    def transform(self) -> tuple[float, float, float, float, float, float]:
        """From column and row to x and y, of upper left corners: `rasterio.Affine(*grid.transform)`."""
        return self.cell_m, 0.0, self.left_m, 0.0, -self.cell_m, self.top_m


def _on(grid: Grid, values: Any) -> Array:
    """Values as a band of this grid."""
    band = unmasked(values)
    if band.shape != grid.shape:
        raise ValueError(f"the array has the shape {band.shape}, the grid {grid.rows} rows x {grid.columns} columns")
    return band


@dataclass(frozen=True, eq=False)
class Raster(Placed):
    """One or more bands on a grid. NaN stands for no value in bands of floats."""

    grid: Grid
    frame: Frame
    quantity: str
    """What the values are, such as `difference_m`."""
    bands: dict[str, Array]
    """Bands by name, rows x columns each: float32, uint8 or uint16."""
    georeference: Georeference | None = None
    """Where its frame lies on the Earth, as far as it is known."""

    @staticmethod
    def single(grid: Grid, values: Array, name: str = "value", *, quantity: str = "value", frame: Frame = Frame.WALL) -> Raster:
        """A raster of one band."""
        return Raster(grid, frame, quantity, {name: _on(grid, values)})

    def like(self, values: Array, name: str = "value", *, quantity: str | None = None) -> Raster:
        """A raster of one band on the same grid and in the same frame."""
        return Raster(self.grid, self.frame, quantity or name, {name: _on(self.grid, values)}, self.georeference)

    @property
    def values(self) -> Array:
        """The first band, rows x columns."""
        return next(iter(self.bands.values()))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.grid.shape

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.values, dtype=dtype) if copy else np.asarray(self.values, dtype=dtype)

    def __getitem__(self, band: str) -> Array:
        if band not in self.bands:
            raise _lacking("band", band, self.bands)
        return self.bands[band]

    def to_xarray(self) -> Any:
        """A `DataArray` (one band) or `Dataset` (several) with the coordinates x and y, metres. Needs xarray."""
        xarray = _needed("xarray", "Raster.to_xarray")
        coords = {"y": self.grid.y_m, "x": self.grid.x_m}
        attributes = {"frame": str(self.frame), "quantity": self.quantity, "cell_m": self.grid.cell_m}
        attributes |= {"crs": self.crs} if self.crs else {}
        arrays = {
            name: xarray.DataArray(band, coords, ("y", "x"), name=name, attrs=attributes) for name, band in self.bands.items()
        }
        return next(iter(arrays.values())) if len(arrays) == 1 else xarray.Dataset(arrays, attrs=attributes)

    def plot(self, band: str | None = None, *, ax: Any = None, limit: float | None = None, cmap: str | None = None) -> Any:
        """Draws a band over metres; values of both signs symmetric about zero. Needs matplotlib; returns the axes.

        Args:
            band: the band, by default the first.
            ax: the axes to draw into, by default new ones.
            limit: the value the colours end at; by default the 99 % quantile of the absolute values.
            cmap: the colours.
        """
        pyplot = _needed("matplotlib.pyplot", "Raster.plot")
        values = np.asarray(self.bands[band] if band else self.values, float)
        known = values[np.isfinite(values)]
        signed = bool(known.size) and known.min() < 0 < known.max()
        top = limit or (float(np.quantile(np.abs(known), 0.99)) if known.size else 1.0) or 1.0
        low, high = (-top, top) if signed else (None, limit)
        axes = ax or pyplot.subplots(layout="constrained")[1]
        colours = cmap or ("RdBu" if signed else "viridis")
        image = axes.imshow(values, extent=self.grid.extent, cmap=colours, vmin=low, vmax=high, interpolation="nearest")
        axes.figure.colorbar(image, ax=axes, label=self.quantity, shrink=0.8)
        axes.set(xlabel="x / m", ylabel="y / m", title=band or next(iter(self.bands)))
        return axes

    def __repr__(self) -> str:
        rows, columns = self.shape
        names = ", ".join(self.bands)
        return f"Raster({self.quantity}: {names}; {rows} x {columns} cells of {self.grid.cell_m:g} m, {self._where()})"


@dataclass(frozen=True)
class Sensor:
    """Interior orientation: the OpenCV model, pixels with the centre of the first pixel at (0, 0)."""

    name: str
    width_px: int
    height_px: int
    f: float
    """Focal length, pixels."""
    cx: float
    cy: float
    b1: float = 0.0
    """Affinity, pixels."""
    b2: float = 0.0
    """Skew, pixels."""
    k: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)
    """Radial distortion k1 to k4."""
    p: tuple[float, ...] = (0.0, 0.0)
    """Tangential distortion p1 and p2."""

    @staticmethod
    def of(record: Mapping[str, Any]) -> Sensor:
        """The sensor of its JSON."""
        return Sensor(**{**record, "k": tuple(record["k"]), "p": tuple(record["p"])})

    def as_dict(self) -> dict[str, Any]:
        """Its JSON."""
        return {**asdict(self), "k": list(self.k), "p": list(self.p)}

    def distorted(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Distorted normalised coordinates of undistorted ones."""
        r2 = x * x + y * y
        radial = 1 + sum(k * r2 ** (power + 1) for power, k in enumerate(self.k))
        p1, p2 = self.p
        return (
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x),
            y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y,
        )

    def undistorted(self, u_px: Array, v_px: Array) -> tuple[Array, Array]:
        """Undistorted normalised coordinates of image positions, pixels."""
        yd = (np.asarray(v_px, float) - self.cy) / self.f
        xd = (np.asarray(u_px, float) - self.cx - self.b2 * yd) / (self.f + self.b1)
        x, y = xd, yd
        for _ in range(100):
            x_now, y_now = self.distorted(x, y)
            step = max(float(np.max(np.abs(xd - x_now), initial=0.0)), float(np.max(np.abs(yd - y_now), initial=0.0)))
            if step < 1e-14:
                break
            x, y = x + xd - x_now, y + yd - y_now
        return x, y


@dataclass(frozen=True)
class Image:
    """Exterior orientation of one image."""

    name: str
    sensor: int
    """Its place in the list of sensors."""
    camera_from_object: tuple[float, float, float, float]
    """Rotation as a quaternion (w, x, y, z)."""
    centre_m: tuple[float, float, float]
    """The projection centre, metres."""

    @staticmethod
    def of(record: Mapping[str, Any]) -> Image:
        """The image of its JSON."""
        w, x, y, z = record["camera_from_object"]
        a, b, c = record["centre_m"]
        return Image(record["name"], record["sensor"], (w, x, y, z), (a, b, c))

    def as_dict(self) -> dict[str, Any]:
        """Its JSON."""
        return {**asdict(self), "camera_from_object": list(self.camera_from_object), "centre_m": list(self.centre_m)}

    @property
    def rotation(self) -> NDArray[np.float64]:
        """The rotation matrix, 3 x 3: camera = R (object - centre); camera frames are x right, y down, z forward."""
        w, x, y, z = np.array(self.camera_from_object) / np.linalg.norm(self.camera_from_object)
        return np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )


@dataclass(frozen=True, eq=False)
class DepthMap(Placed):
    """The depth map of one image: depth along the optical axis, metres, NaN where there is none."""

    frame: Frame
    sensor: Sensor
    image: Image
    downscale: int
    """Image pixels a pixel of the map stands for, along each side."""
    z: NDArray[np.float32]
    """Depth, rows x columns, metres."""
    channels: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """Further channels by name, such as `disparity` or `noise.local`; rows x columns."""
    georeference: Georeference | None = None
    """Where its frame lies on the Earth, as far as it is known."""

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.z.shape[0], self.z.shape[1]

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.z, dtype=dtype) if copy else np.asarray(self.z, dtype=dtype)

    def __getitem__(self, channel: str) -> NDArray[np.float32]:
        if channel != "Z" and channel not in self.channels:
            raise _lacking("channel", channel, ["Z", *self.channels])
        return self.z if channel == "Z" else self.channels[channel]

    def with_channels(self, **channels: Array) -> DepthMap:
        """The same map with further channels, each rows x columns: `depth.with_channels(error_px=errors)`."""
        for name, values in channels.items():
            if np.shape(values) != self.shape:
                raise ValueError(f"channel `{name}` has the shape {np.shape(values)}, the depth map {self.shape}")
        added = {name: np.asarray(unmasked(values), np.float32) for name, values in channels.items()}
        return replace(self, channels={**self.channels, **added})

    def points(self) -> NDArray[np.float64]:
        """The point of each pixel in the map's frame, rows x columns x 3, metres; NaN where there is no depth."""
        rows, columns = np.indices(self.shape)
        u, v = ((pixel + 0.5) * self.downscale - 0.5 for pixel in (columns, rows))
        x, y = self.sensor.undistorted(u, v)
        rays = np.stack([x, y, np.ones_like(x)], axis=-1)
        points: NDArray[np.float64] = np.array(self.image.centre_m) + self.z[..., None].astype(float) * (rays @ self.image.rotation)
        return points

    def __repr__(self) -> str:
        rows, columns = self.shape
        return f"DepthMap({self.image.name}: {rows} x {columns} pixels; {', '.join(['Z', *self.channels])}; {self._where()})"


@dataclass(frozen=True, eq=False)
class Mesh(Placed):
    """A triangle mesh."""

    frame: Frame
    vertices: NDArray[np.float64]
    """n x 3, metres."""
    triangles: NDArray[np.uint32]
    """m x 3 places in `vertices`, counter-clockwise seen from outside."""
    colours: NDArray[np.uint8] = field(default_factory=lambda: np.empty((0, 3), np.uint8))
    """n x 3, or 0 x 3 where the mesh has none."""
    georeference: Georeference | None = None
    """Where its frame lies on the Earth, as far as it is known."""

    def to_trimesh(self) -> Any:
        """A `trimesh.Trimesh` with the same vertices. Needs trimesh."""
        trimesh = _needed("trimesh", "Mesh.to_trimesh")
        colours = self.colours if len(self.colours) else None
        return trimesh.Trimesh(self.vertices, self.triangles, vertex_colors=colours, process=False)

    def __repr__(self) -> str:
        return f"Mesh({len(self.vertices)} vertices, {len(self.triangles)} triangles, {self._where()})"


@dataclass(frozen=True, eq=False)
class Part:
    """One of several named meshes."""

    name: str
    kind: str
    """Its class, such as `slab`."""
    vertices: NDArray[np.float64]
    triangles: NDArray[np.uint32]


@dataclass(frozen=True, eq=False)
class Meshes(Placed):
    """Named meshes: blocks, removed pieces, niches."""

    frame: Frame
    parts: list[Part]
    georeference: Georeference | None = None
    """Where its frame lies on the Earth, as far as it is known."""

    def __len__(self) -> int:
        return len(self.parts)

    def __iter__(self) -> Iterator[Part]:
        return iter(self.parts)

    def __getitem__(self, name: str) -> Mesh:
        for part in self.parts:
            if part.name == name:
                return Mesh(self.frame, part.vertices, part.triangles, georeference=self.georeference)
        raise _lacking("mesh", name, (part.name for part in self.parts))

    def __repr__(self) -> str:
        return f"Meshes({len(self.parts)} meshes, {self._where()})"


@dataclass(frozen=True, eq=False)
class Cloud(Placed):
    """Points with normals, colours, whole numbers and measured values."""

    frame: Frame
    points: NDArray[np.float64]
    """n x 3, metres."""
    normals: NDArray[np.float32] = field(default_factory=lambda: np.empty((0, 3), np.float32))
    """n x 3, or 0 x 3 where there are none."""
    colours: NDArray[np.uint8] = field(default_factory=lambda: np.empty((0, 3), np.uint8))
    """n x 3, or 0 x 3 where there are none."""
    numbers: dict[str, NDArray[np.uint32]] = field(default_factory=dict)
    """Whole numbers of each point by name, such as `label`."""
    georeference: Georeference | None = None
    """Where its frame lies on the Earth, as far as it is known."""
    values: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """Measured values of each point by name, such as `difference`; NaN where there is none."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.points, dtype=dtype) if copy else np.asarray(self.points, dtype=dtype)

    def __repr__(self) -> str:
        return f"Cloud({len(self.points)} points, {self._where()})"


@dataclass(frozen=True, eq=False)
class Surface(Placed):
    """An organised grid of points whose triangles are implicit."""

    frame: Frame
    origin_m: tuple[float, float, float]
    """Added to every point, metres."""
    points: NDArray[np.float32]
    """Points relative to the origin, rows x columns x 3, metres; NaN where there is none."""
    squares: NDArray[np.uint8]
    """Bits of the triangles of each square, (rows - 1) x (columns - 1): 1 first, 2 second, 4 the other diagonal."""
    georeference: Georeference | None = None
    """Where its frame lies on the Earth, as far as it is known."""

    def xyz(self) -> NDArray[np.float64]:
        """The points in their frame, rows x columns x 3, metres."""
        points: NDArray[np.float64] = self.points.astype(float) + np.array(self.origin_m)
        return points

    def to_mesh(self) -> Mesh:
        """The mesh of its triangles; points without a value are left out."""
        rows, columns = self.points.shape[:2]
        number = np.arange(rows * columns).reshape(rows, columns)
        a, b, c, d = number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]
        other = (self.squares & 4) != 0
        first = np.where(other[..., None], np.stack([a, d, b], -1), np.stack([a, d, c], -1))[(self.squares & 1) != 0]
        second = np.where(other[..., None], np.stack([b, d, c], -1), np.stack([a, c, b], -1))[(self.squares & 2) != 0]
        used, triangles = np.unique(np.concatenate([first, second]), return_inverse=True)
        vertices, own = self.xyz().reshape(-1, 3)[used], triangles.reshape(-1, 3).astype(np.uint32)
        return Mesh(self.frame, vertices, own, georeference=self.georeference)

    def __repr__(self) -> str:
        rows, columns = self.points.shape[:2]
        return f"Surface({rows} x {columns} points, {self._where()})"


@dataclass(frozen=True)
class Cameras(Placed):
    """Sensors and oriented images."""

    frame: Frame
    sensors: list[Sensor]
    images: list[Image]
    georeference: Georeference | None = None
    """Where their frame lies on the Earth, as far as it is known."""

    def __len__(self) -> int:
        return len(self.images)

    def __iter__(self) -> Iterator[Image]:
        return iter(self.images)

    def __getitem__(self, name: str) -> Image:
        for image in self.images:
            if image.name == name:
                return image
        raise _lacking("image", name, (image.name for image in self.images))

    def sensor(self, image: Image | str) -> Sensor:
        """The sensor of an image."""
        return self.sensors[(self[image] if isinstance(image, str) else image).sensor]


@dataclass(frozen=True)
class Pair:
    """A stereo pair; image x grows from the first to the second."""

    name: str
    first: str
    second: str
    baseline_m: float
    distance_m: float
    convergence_rad: float
    overlap: float


@dataclass(frozen=True)
class Pairs:
    """Stereo pairs in a fixed order."""

    pairs: list[Pair]

    def __len__(self) -> int:
        return len(self.pairs)

    def __iter__(self) -> Iterator[Pair]:
        return iter(self.pairs)


@dataclass(frozen=True, eq=False)
class Transform:
    """A rigid transform between two frames: to = rotation (from - origin) + translation."""

    source: str
    """The frame it takes points from."""
    target: str
    """The frame it takes them to."""
    rotation: NDArray[np.float64]
    """3 x 3."""
    origin: NDArray[np.float64]
    """Subtracted first, metres."""
    translation: NDArray[np.float64]
    """Added last, metres."""

    def apply(self, points: Array) -> NDArray[np.float64]:
        """Points (... x 3, metres) in the target frame."""
        moved: NDArray[np.float64] = (np.asarray(points, float) - self.origin) @ self.rotation.T + self.translation
        return moved

    @property
    def matrix(self) -> NDArray[np.float64]:
        """The transform as a matrix of homogeneous coordinates, 4 x 4."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.rotation
        matrix[:3, 3] = self.translation - self.rotation @ self.origin
        return matrix


@dataclass(frozen=True, eq=False)
class Covariance(Placed):
    """Joint covariance of orientation parameters."""

    frame: Frame
    parameters: list[str]
    matrix: NDArray[np.float64]
    """Square, in the order of the parameters; metres and radians."""
    sigma0_applied: bool = True
    """Whether the a-posteriori variance factor is in it."""
    full_joint: bool = True
    """Whether it has the correlations between images."""
    georeference: Georeference | None = None
    """Where its frame lies on the Earth, as far as it is known."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Array:
        return np.array(self.matrix, dtype=dtype) if copy else np.asarray(self.matrix, dtype=dtype)


@dataclass(frozen=True)
class Table(Sequence[Mapping[str, Cell]]):
    """Rows and columns of numbers, words and flags; None is an empty cell. `table["name"]` is a column as an array."""

    columns: list[str]
    rows: list[list[Cell]]
    units: dict[str, str] = field(default_factory=dict)
    """Units of columns, where they are known: those of metrics. The file of a table has none; name the column `volume_m3`."""

    @staticmethod
    def of(records: Sequence[Mapping[Any, Any]]) -> Table:
        """The table of a list of rows; columns in the order they are met."""
        columns = list(dict.fromkeys(name for record in records for name in record))
        return Table(list(map(str, columns)), [[record.get(name) for name in columns] for record in records])

    @staticmethod
    def from_pandas(data: Any) -> Table:
        """The table of a `pandas.DataFrame`, without its index; what is missing is an empty cell."""
        columns = [str(name) for name in data.columns]
        known = data.notna().to_numpy()
        cells = [data.iloc[:, place].tolist() for place in range(len(columns))]
        rows = [[cells[place][row] if known[row, place] else None for place in range(len(columns))] for row in range(len(data))]
        return Table(columns, rows)

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, key: Any) -> Any:
        if isinstance(key, str):
            return self.column(key)
        if isinstance(key, slice):
            return Table(self.columns, self.rows[key], self.units)
        return dict(zip(self.columns, self.rows[key], strict=True))

    def column(self, name: str) -> Array:
        """A column: float64 with NaN for empty cells where all are numbers, else objects."""
        if name not in self.columns:
            raise KeyError(f"no column `{name}`; there are {', '.join(self.columns)}")
        place = self.columns.index(name)
        cells = [row[place] for row in self.rows]
        if all(cell is None or (isinstance(cell, int | float) and not isinstance(cell, bool)) for cell in cells):
            return np.array([np.nan if cell is None else cell for cell in cells], float)
        if all(isinstance(cell, bool) for cell in cells):
            return np.array(cells, bool)
        return np.array(cells, object)

    def to_pandas(self) -> Any:
        """A `pandas.DataFrame`; units are in `attrs["units"]`. Needs pandas."""
        pandas = _needed("pandas", "Table.to_pandas")
        frame = pandas.DataFrame({name: self.column(name) for name in self.columns}, columns=self.columns)
        frame.attrs["units"] = dict(self.units)
        return frame

    def to_csv(self) -> str:
        """The table as CSV with a header line."""
        import csv

        text = io.StringIO()
        writer = csv.writer(text, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows([["" if cell is None else cell for cell in row] for row in self.rows])
        return text.getvalue()

    def _repr_html_(self) -> str:
        shown = self.rows[:20]
        line = "".join(f"<th>{html.escape(name)}</th>" for name in self.columns)
        body = "".join("<tr>" + "".join(f"<td>{html.escape(_short(cell))}</td>" for cell in row) + "</tr>" for row in shown)
        more = f"<p>… and {len(self.rows) - len(shown)} more rows</p>" if len(self.rows) > len(shown) else ""
        return f"<table><thead><tr>{line}</tr></thead><tbody>{body}</tbody></table>{more}"

    def __repr__(self) -> str:
        return f"Table({len(self.rows)} rows; {', '.join(self.columns)})"


def _short(cell: Cell) -> str:
    if cell is None:
        return ""
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell)


@dataclass(frozen=True, eq=False)
class Inventory(Placed):
    """Rockfalls: outline and properties of each."""

    frame: Frame
    geojson: dict[str, Any]
    """The whole GeoJSON feature collection; coordinates in metres of the frame."""
    georeference: Georeference | None = None
    """Where its frame lies on the Earth, as far as it is known."""

    @staticmethod
    def from_geopandas(data: Any, frame: Frame = Frame.WALL, georeference: Georeference | None = None) -> Inventory:
        """The rockfalls of a `geopandas.GeoDataFrame`: polygons with every further column as a property.

        Args:
            data: coordinates are metres of the frame; of the wall frame it says nothing more.
            frame: the frame of the coordinates.
            georeference: where the frame lies on the Earth; of the world frame, by default the system of the data.
        """
        if frame is Frame.WORLD and data.crs is not None:
            units = {axis.unit_name for axis in data.crs.axis_info[:2]}
            if units != {"metre"}:
                told = f"the coordinates are in {', '.join(sorted(units))}, not in metres"
                raise RockfaceError(f"{told}: `data.to_crs(...)` brings them into a projected system")
        if georeference is None and frame is Frame.WORLD and data.crs is not None:
            code = data.crs.to_epsg()
            georeference = Georeference(f"EPSG:{code}" if code else data.crs.to_wkt())
        columns = [str(name) for name in data.columns if name != data.geometry.name]
        return Inventory(frame, {**data.__geo_interface__, "rockface": {"columns": columns}}, georeference)

    def table(self) -> Table:
        """The properties, a row a rockfall."""
        columns = list(self.geojson.get("rockface", {}).get("columns", []))
        rows = [[feature["properties"].get(name) for name in columns] for feature in self.geojson["features"]]
        return Table(columns, rows) if columns else Table.of([f["properties"] for f in self.geojson["features"]])

    def to_geopandas(self) -> Any:
        """A `geopandas.GeoDataFrame` with the coordinate reference system, where one is known. Needs geopandas."""
        geopandas = _needed("geopandas", "Inventory.to_geopandas")
        columns = ["geometry", *self.table().columns]
        return geopandas.GeoDataFrame.from_features(self.geojson["features"], crs=self.crs, columns=columns)

    def __len__(self) -> int:
        return len(self.geojson["features"])

    def __repr__(self) -> str:
        return f"Inventory({len(self)} rockfalls, {self._where()})"


@dataclass(frozen=True)
class Picture:
    """A picture for people, PNG."""

    png: bytes

    def _repr_png_(self) -> bytes:
        return self.png

    def __repr__(self) -> str:
        return f"Picture({len(self.png)} bytes of PNG)"


@dataclass(frozen=True)
class Figure:
    """A chart for people, SVG."""

    svg: str

    def _repr_svg_(self) -> str:
        return self.svg

    def __repr__(self) -> str:
        return f"Figure({len(self.svg)} characters of SVG)"


@dataclass(frozen=True)
class File:
    """A file that only the programs of a pipeline look into."""

    data: bytes

    def __repr__(self) -> str:
        return f"File({len(self.data)} bytes)"


@dataclass(frozen=True)
class Files(Mapping[str, bytes]):
    """Files in another program's own format, by name."""

    files: dict[str, bytes]

    def __getitem__(self, name: str) -> bytes:
        if name not in self.files:
            raise _lacking("file", name, self.files)
        return self.files[name]

    # Those of `Mapping` make an error with near names of each miss.
    def __contains__(self, name: object) -> bool:
        return name in self.files

    @overload
    def get(self, name: str, /) -> bytes | None: ...
    @overload
    def get(self, name: str, /, default: bytes) -> bytes: ...
    @overload
    def get(self, name: str, /, default: T) -> bytes | T: ...
    def get(self, name: str, /, default: Any = None) -> Any:
        """The bytes of a file; the default where there is none of this name."""
        return self.files.get(name, default)

    def __repr__(self) -> str:
        first = [f"{name}: {len(data)} bytes" for name, data in itertools.islice(self.files.items(), SHOWN_FILES)]
        more = len(self.files) - len(first)
        rest = [f"… and {more} more, {sum(map(len, self.files.values()))} bytes in all"] if more else []
        return f"Files({', '.join(first + rest)})"

    def __iter__(self) -> Iterator[str]:
        return iter(self.files)

    def __len__(self) -> int:
        return len(self.files)


@dataclass(frozen=True)
class Record:
    """An artefact kept as JSON that has no class of its own here: an acceptance model, a sequence of candidates."""

    kind: str
    data: dict[str, Any]

    def __getitem__(self, key: str) -> Any:
        if key not in self.data:
            raise _lacking("key", key, self.data)
        return self.data[key]

    def __repr__(self) -> str:
        return f"Record({self.kind}: {json.dumps(self.data)[:80]})"
