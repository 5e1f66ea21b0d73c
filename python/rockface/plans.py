"""What a run would do and why, asked of the program."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rockface import _program

__all__ = ["Cause", "Change", "Explanation", "PlannedStep", "arguments", "explain", "plan"]

Values = Mapping[str, object] | Sequence[str]
"""Values by name, of which a `str` is a text as it stands, or texts `NAME=VALUE` as on the command line."""


@dataclass(frozen=True)
class PlannedStep:
    """What a run would do about one step instance."""

    step: str
    point: Mapping[str, str]
    answer: str
    """`hit`: cached; `runs`; `depends`: on an input that is computed anew; `unknown`: its axis has no items yet."""
    why: str | None
    """Why it would run."""
    estimate_s: float | None
    """Expected seconds, from records of similar steps."""


@dataclass(frozen=True)
class Change:
    """A component of a recipe that differs from the closest one on record."""

    path: str
    old: Any
    new: Any


@dataclass(frozen=True)
class Cause:
    """An instance on the way to the root cause, with what changed in its recipe."""

    step: str
    point: Mapping[str, str]
    changes: list[Change]
    former_run: str | None
    """The run the former recipe is known from."""


@dataclass(frozen=True)
class Explanation:
    """The recipe of a step instance, and what changed in it."""

    step: str
    point: Mapping[str, str]
    answer: str
    """`hit`, `runs` or `depends`."""
    why: str | None
    key: str
    """The digest of the recipe."""
    recipe: Mapping[str, Any]
    """Everything that decides the outputs."""
    causes: list[Cause]
    """The instance and those before it that changed, the root cause last."""

    def __str__(self) -> str:
        items = ",".join(f"{axis}={item}" for axis, item in self.point.items())
        lines = [f"{self.step}{f'[{items}]' if items else ''}: {self.answer}{f', {self.why}' if self.why else ''}"]
        for cause in self.causes:
            lines += [f"  {cause.step}: {change.path}: {change.old} -> {change.new}" for change in cause.changes]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(str(self))}</pre>"


def arguments(
    pipeline: str | Path,
    set: Values | None = None,
    sweep: Mapping[str, object] | Sequence[str] | None = None,
    seed: int | None = None,
    targets: Sequence[str] = (),
    store: str | Path | None = None,
) -> list[str]:
    """The arguments of the command line that all commands on a pipeline share."""
    words = [str(pipeline)]
    for name, value in _pairs(set):
        words.append(f"--set={name}={value}")
    for name, value in _pairs(sweep):
        words.append(f"--sweep={name}={value}")
    words += [f"--target={target}" for target in ([targets] if isinstance(targets, str) else targets)]
    words += [f"--seed={seed}"] if seed is not None else []
    words += [f"--store={store}"] if store is not None else []
    return words


def _pairs(values: Values | Mapping[str, object] | None) -> list[tuple[str, str]]:
    if values is None:
        return []
    if isinstance(values, Mapping):
        return [(name, _written(value)) for name, value in values.items()]
    return [(text.split("=", 1)[0], text.split("=", 1)[-1]) for text in values]


def _written(value: object) -> str:
    """A value as the command line takes it: YAML, in which a text has quotes, so that `1.0` or `a #b` stays what it is."""
    if isinstance(value, Path):
        value = str(value)
    if isinstance(value, range) or hasattr(value, "tolist"):
        value = list(value) if isinstance(value, range) else value.tolist()
    return json.dumps(value, ensure_ascii=False)


def plan(
    pipeline: str | Path,
    *,
    set: Values | None = None,
    sweep: Mapping[str, object] | Sequence[str] | None = None,
    seed: int | None = None,
    targets: Sequence[str] = (),
    store: str | Path | None = None,
) -> list[PlannedStep]:
    """What a run would do and why, without doing it; the arguments are those of `rockface.run`."""
    given = arguments(pipeline, set, _axes(sweep), seed, targets, store)
    listed = json.loads(_program.call("plan", "--json", *given))
    return [
        PlannedStep(entry["step"], entry.get("point", {}), entry["answer"], entry.get("why"), entry.get("estimate_s"))
        for entry in listed
    ]


def explain(
    pipeline: str | Path,
    step: str,
    *,
    set: Values | None = None,
    sweep: Mapping[str, object] | Sequence[str] | None = None,
    seed: int | None = None,
    store: str | Path | None = None,
) -> Explanation:
    """The recipe of a step instance, such as `dem[epoch=pre]`, and what changed since it was last computed."""
    pipeline_words = arguments(pipeline, set, _axes(sweep), seed, (), store)
    told = json.loads(_program.call("explain", "--json", *pipeline_words, step))
    about = told["explained"]
    causes = [
        Cause(
            cause["step"],
            cause["point"],
            [Change(change["path"], change["old"], change["new"]) for change in cause["changes"]],
            cause["former_run"],
        )
        for cause in told["causes"]
    ]
    return Explanation(about["step"], about["point"], about["answer"], about["why"], told["key"], told["recipe"], causes)


def _axes(sweep: Mapping[str, object] | Sequence[str] | None) -> Sequence[str] | None:
    """Values of swept axes in the words of the command line: `axis=1,2,3`."""
    if sweep is None or not isinstance(sweep, Mapping):
        return sweep

    def words(values: object) -> str:
        if isinstance(values, str):
            return values
        if isinstance(values, int | float):
            values = [values]
        listed = values.tolist() if hasattr(values, "tolist") else list(values)  # type: ignore[call-overload]
        return ",".join(_written(value) for value in listed)

    return [f"{axis}={words(values)}" for axis, values in sweep.items()]
