"""Python functions as steps of a pipeline.

```python
import numpy as np
import rockface

@rockface.stage(output="labels")
def threshold(difference: rockface.Raster, sigmas: float = 3.0) -> rockface.Raster:
    deviation = np.nanstd(difference.values)
    return difference.like(difference.values < -sigmas * deviation, "loss", quantity="label")
```

```yaml
own: {stage: python, with: {module: my_stages.py, function: threshold, params: {sigmas: 4}}, in: {difference: change.raster}}
```
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, TypeVar, overload

import numpy as np

__all__ = ["Gathered", "Random", "Range", "headline", "metric", "note", "stage", "warn"]

Function = TypeVar("Function", bound=Callable[..., Any])
T = TypeVar("T")

ATTRIBUTE = "__rockface_stage__"
MEMORY_GIB = 4.0
"""Memory a function may take where its stage does not say otherwise."""


@dataclass(frozen=True)
class Declared:
    """What the decorator says of a function."""

    output: str | None
    packages: tuple[str, ...]
    memory_gib: float


@overload
def stage(function: Function, /) -> Function: ...


@overload
def stage(
    *, output: str | None = None, packages: Sequence[str] = (), memory_gib: float = MEMORY_GIB
) -> Callable[[Function], Function]: ...


def stage(
    function: Function | None = None,
    /,
    *,
    output: str | None = None,
    packages: Sequence[str] = (),
    memory_gib: float = MEMORY_GIB,
) -> Function | Callable[[Function], Function]:
    """Makes a function usable as a step, `stage: python`; the function itself stays as it is and can be called.

    Its parameters say by their types what they are: artefacts (`rockface.Raster`, `| None` for an input that may be left
    out, `list[rockface.Raster]` or `rockface.Gathered[rockface.Raster]` for a gathered one), values (`float`, `int`, `bool`,
    `str`, `Literal`, lists of these, `Annotated[float, rockface.Range(0, 1)]`), files (`pathlib.Path`) and random numbers
    (`rockface.Random`). It returns an artefact, or a `NamedTuple` of its module with a field for each output. All this is
    read from the text of the module, so it is written there and not computed.

    Args:
        function: the function.
        output: the name of the output, where it is one; by default its kind, such as `raster`.
        packages: further packages whose versions decide the result; those the module imports are known.
        memory_gib: the most memory it may take; beyond it Python raises `MemoryError`.
    """

    def mark(function: Function) -> Function:
        setattr(function, ATTRIBUTE, Declared(output, tuple(packages), memory_gib))
        return function

    return mark(function) if function is not None else mark


@dataclass(frozen=True)
class Range:
    """The values a number may take, both ends included: `Annotated[float, rockface.Range(0, 1)]`."""

    low: float | None = None
    high: float | None = None


class Gathered(list[T], Generic[T]):
    """A gathered input: a list of artefacts, with the point of each in `points`."""

    def __init__(self, values: Sequence[T] = (), points: Sequence[Mapping[str, str]] = ()) -> None:
        super().__init__(values)
        self.points: list[Mapping[str, str]] = list(points) or [{} for _ in values]


class Random:
    """Random numbers of a step: they follow from the seed of the pipeline, the step and its reseeding axes, and nothing else.

    ```python
    @rockface.stage
    def noisy(dem: rockface.Raster, random: rockface.Random, sigma_m: float = 0.01) -> rockface.Raster:
        return dem.like(dem.values + random.generator().normal(0, sigma_m, dem.shape), "elevation")
    ```
    """

    def __init__(self, key: bytes) -> None:
        self.key = key
        """32 bytes all streams follow from."""

    @staticmethod
    def seeded(seed: int) -> Random:
        """Random numbers for calling a stage outside of a pipeline."""
        return Random(hashlib.blake2b(str(seed).encode(), digest_size=32).digest())

    def generator(self, purpose: str = "", item: object = "") -> np.random.Generator:
        """A numpy generator of its own for one item (a pair, an image, a tile) of one purpose; equal words, equal numbers."""
        words = f"{len(purpose)} {purpose}{item}".encode()
        digest = hashlib.blake2b(words, key=self.key[:32], digest_size=16).digest()
        return np.random.Generator(np.random.Philox(key=int.from_bytes(digest, "little")))


_entries: list[dict[str, Any]] | None = None


def _record(entry: dict[str, Any], shown: str) -> None:
    if _entries is None:
        print(shown, file=sys.stderr)
    else:
        _entries.append(entry)


def metric(name: str, value: float, unit: str = "1") -> None:
    """Logs a number of this step; it appears in the report and in `run.table()`."""
    written: Any = float(value) if np.isfinite(value) else {"inf": "inf", "-inf": "-inf"}.get(str(float(value)), "NaN")
    _record({"type": "metric", "name": name, "value": written, "unit": unit}, f"{name} = {value} {unit}")


def note(text: str) -> None:
    """Logs something worth reading."""
    _record({"type": "note", "text": str(text)}, str(text))


def warn(text: str) -> None:
    """Logs something that may be wrong; it is shown during the run."""
    _record({"type": "warning", "text": str(text)}, f"warning: {text}")


def headline(text: str) -> None:
    """Logs the result in one line, shown at the end of the run."""
    _record({"type": "headline", "text": str(text)}, str(text))
