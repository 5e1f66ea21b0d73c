"""Past runs: their outputs as arrays, their numbers as one tidy table."""

from __future__ import annotations

import base64
import html
import itertools
import json
import re
import tempfile
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from rockface import _program
from rockface._errors import PipelineError, RockfaceError, StoreError
from rockface.artefacts import Inventory, Picture, Table
from rockface.files import Artefact, decode, mapped
from rockface.plans import Explanation, PlannedStep, explain, plan

__all__ = ["Outputs", "Run", "Step", "find"]

SHOWN = 10
"""Runs that a message names."""

LABEL = re.compile(r"^(?P<step>[^.\[]+)(?P<one>\[[^\]]*\])?(\.(?P<port>[^.\[]+))?(?P<two>\[[^\]]*\])?$")
NUMBER = re.compile(r"[+-]?((0|[1-9]\d*)\.?\d*|\.\d+)([eE][+-]?\d+)?")
"""A number as an item has it; `007` and `2024_05` are texts."""
PICTURES = 3
"""Pictures that the head of a run shows."""
PICTURE_BYTES = 600_000


@dataclass(frozen=True)
class Step:
    """One step instance of a run."""

    step: str
    """The step."""
    point: Mapping[str, str]
    """The item of each axis it stands for."""
    stage: str
    """Its stage."""
    status: str
    """`executed`, `cached`, `failed` or `not reached`."""
    failure: str | None
    """Why it failed."""
    metrics: Mapping[str, float | None]
    """The numbers it reported, by name."""
    units: Mapping[str, str]
    """Their units."""
    parameters: Mapping[str, Any]
    """Its parameters with every default; files are replaced by their digests."""
    outputs: Mapping[str, str]
    """Kinds of its outputs by port."""
    seconds: float | None
    """What it took when it was computed."""
    paths: Mapping[str, str]
    """Files of its outputs by port, relative to the run folder, where they have names there."""
    warnings: Sequence[str] = ()
    """What it warned of."""
    digests: Mapping[str, str] = field(default_factory=dict)
    """BLAKE3 of its outputs by port."""

    @property
    def label(self) -> str:
        """`step[axis=item,...]`."""
        items = ",".join(f"{axis}={item}" for axis, item in self.point.items())
        return f"{self.step}[{items}]" if items else self.step

    @staticmethod
    def of(record: Mapping[str, Any]) -> Step:
        """The step of its line in the manifest."""
        metrics = record.get("metrics", [])
        return Step(
            record["step"],
            record["point"],
            record["stage"],
            record["status"],
            record.get("failure"),
            {metric["name"]: metric["value"] for metric in metrics},
            {metric["name"]: metric["unit"] for metric in metrics},
            record.get("parameters") or {},
            {port: output["kind"] for port, output in (record.get("outputs") or {}).items()},
            (record.get("cost") or {}).get("wall_s"),
            record.get("paths", {}),
            record.get("warnings", []),
            {port: output.get("digest", "") for port, output in (record.get("outputs") or {}).items()},
        )


class Outputs(Sequence[Any]):
    """One output at all its points; each is read when it is asked for.

    ```python
    for point, raster in run["dem.raster"].items():
        print(point["epoch"], raster.values.mean())
    ```
    """

    def __init__(self, run: Run, port: str, steps: list[Step]) -> None:
        self._run, self._port, self._steps = run, port, steps

    @property
    def points(self) -> list[Mapping[str, str]]:
        """The points, in the order of the run."""
        return [step.point for step in self._steps]

    def __len__(self) -> int:
        return len(self._steps)

    def __getitem__(self, place: Any) -> Any:
        if isinstance(place, slice):
            return Outputs(self._run, self._port, self._steps[place])
        return self._run.artefact(self._steps[place], self._port)

    def items(self) -> Iterator[tuple[Mapping[str, str], Artefact]]:
        """Each point with its artefact."""
        for step in self._steps:
            yield step.point, self._run.artefact(step, self._port)

    def at(self, **items: object) -> Any:
        """The artefact at these items of the axes, or those that are left: `run["dem.raster"].at(epoch="pre")`."""
        wanted = {axis: str(item) for axis, item in items.items()}
        steps = _fitting(self._steps, wanted)
        if not steps:
            first = f"the first point is {dict(self._steps[0].point)}" if self._steps else "there are no points"
            raise KeyError(f"no {self._port} at {wanted}; {first}")
        rest = Outputs(self._run, self._port, steps)
        return rest[0] if len(steps) == 1 else rest

    def table(self) -> Table:
        """Tables of all points as one, or the properties of inventories; the items of the axes are the first columns."""
        records: list[dict[str, Any]] = []
        columns: dict[str, None] = {}
        typed = _typed(self.points)
        for point, value in self.items():
            if not isinstance(value, Table | Inventory):
                raise RockfaceError(f"`{self._port}` is a {type(value).__name__}, neither a table nor an inventory")
            items = {axis: typed[axis][item] for axis, item in point.items()}
            rows = value.table() if isinstance(value, Inventory) else value
            columns.update(dict.fromkeys([*items, *rows.columns]))
            records += [{**items, **row} for row in rows]
        # Columns are told by what has no row too.
        return Table(list(columns), [[record.get(name) for name in columns] for record in records])

    def __repr__(self) -> str:
        if not self._steps:
            return f"Outputs({self._port} at no point)"
        step = self._steps[0]
        return f"Outputs({step.step}.{self._port}: {step.outputs[self._port]} at {len(self)} points of {', '.join(step.point)})"


class Run:
    """A past run: `run["step.port"]` is an output, `run.table()` its numbers."""

    def __init__(self, folder: str | Path, store: str | Path | None = None) -> None:
        """Opens a run folder; `store` is where outputs are that have no name in the folder."""
        self.folder = Path(folder).resolve()
        """The folder with manifest, report, log and outputs."""
        self.computed: int | None = None
        """Steps that the call of `rockface.run` computed; a run in which nothing is new is the former one."""
        self.cached: int | None = None
        """Steps that were cached when `rockface.run` was called."""
        file = self.folder / "run.json"
        try:
            self.manifest: dict[str, Any] = json.loads(file.read_text())
        except (OSError, ValueError) as error:
            raise RockfaceError(f"{self.folder} is no run folder: {error}") from error
        if not isinstance(self.manifest, dict):
            raise RockfaceError(f"{file} is no manifest of a run")
        if self.manifest.get("format") != 1:
            raise RockfaceError(f"{file} has format {self.manifest.get('format')}; this version reads 1")
        lacking = [key for key in ("pipeline", "finished", "status", "steps", "overrides") if key not in self.manifest]
        if lacking:
            raise RockfaceError(f"{file} is no manifest of a run: it has no `{lacking[0]}`")
        beside = self.folder.parent.parent / "store"
        named = Path(self.manifest.get("store") or beside)
        self.store = Path(store).resolve() if store else named if named.is_absolute() and _is_store(named) else beside
        """The store of results."""

    @cached_property
    def steps(self) -> list[Step]:
        """All step instances."""
        return [Step.of(record) for record in self.manifest["steps"]]

    @property
    def name(self) -> str:
        """The name of the pipeline."""
        return str(self.manifest["pipeline"]["name"])

    @property
    def status(self) -> str:
        """`done` or `failed`."""
        return str(self.manifest["status"])

    @property
    def headlines(self) -> list[str]:
        """The results, a line each."""
        return list(self.manifest["headlines"])

    @property
    def warnings(self) -> list[str]:
        """What steps warned of, a line each, with the step."""
        return [f"{step.label}: {text}" for step in self.steps for text in step.warnings]

    @property
    def report(self) -> Path:
        """The report, one HTML file."""
        return self.folder / "report.html"

    def outputs(self) -> list[str]:
        """Every `step.port` of the run."""
        return list(dict.fromkeys(f"{step.step}.{port}" for step in self.steps for port in step.outputs))

    def part_outputs(self) -> list[str]:
        """Every `use.output` of the parts that the pipeline uses."""
        return [f"{used['name']}.{port}" for used in self.manifest.get("parts", []) for port in used["outputs"]]

    def __iter__(self) -> Iterator[str]:
        return iter(self.outputs())

    def __contains__(self, output: object) -> bool:
        return output in self.outputs() or output in self.part_outputs()

    def __getitem__(self, output: str) -> Any:
        """An output: `run["dem.raster"]`, `run["dem.raster[epoch=pre]"]`, or `run["dem"]` where the step has one output.

        What a part makes is named as in the pipeline, `run["before.dem"]`, or by the step inside, `run["before/dem.raster"]`.

        A step at several points gives `Outputs`, a sequence that reads each when asked for.
        """
        port, fitting = self._select(output)
        return Outputs(self, port, fitting) if len(fitting) > 1 else self.artefact(fitting[0], port)

    def _select(self, output: str) -> tuple[str, list[Step]]:
        """The port that a label names, and the step at all points that it fits."""
        match = LABEL.match(output.strip())
        if match is None:
            raise KeyError(f"`{output}` is no output: write step.port or step.port[axis=item]")
        name, named, picks = self._behind(match)
        steps = [step for step in self.steps if step.step == name and step.outputs]
        ports = list(dict.fromkeys(port for step in steps for port in step.outputs))
        port = named or (ports[0] if len(ports) == 1 else "")
        if port not in ports:
            raise KeyError(self._unknown(output, name, ports))
        fitting = _fitting(steps, picks)
        if not fitting:
            raise KeyError(f"`{output}`: no such point; there are {_listed(steps)}")
        return port, fitting

    def _behind(self, match: re.Match[str]) -> tuple[str, str | None, dict[str, str]]:
        """The step, port and items that a label names; of an output of a part that is used, those inside it."""
        picks = _picks((match["one"] or "") + (match["two"] or ""))
        used = next((used for used in self.manifest.get("parts", []) if used["name"] == match["step"]), None)
        if used is None:
            return match["step"], match["port"], picks
        outputs = used["outputs"]
        port = match["port"] or (next(iter(outputs)) if len(outputs) == 1 else None)
        inner = LABEL.match(outputs.get(port, ""))
        if inner is None:
            names = ", ".join(f"{match['step']}.{name}" for name in outputs)
            raise KeyError(f"`{match[0]}`: `{match['step']}` uses part {used['part']}, whose outputs are {names}")
        return inner["step"], inner["port"], {**_picks((inner["one"] or "") + (inner["two"] or "")), **picks}

    def _unknown(self, output: str, step: str, ports: list[str]) -> str:
        from difflib import get_close_matches

        if ports:
            return f"`{output}`: step `{step}` has the outputs {', '.join(ports)}"
        near = get_close_matches(output, self.outputs(), 3, 0.4) or self.outputs()[:8]
        return f"the run has no output `{output}`; there are {', '.join(near)}"

    def path(self, output: str) -> Path:
        """The file of an output at one point, in the run folder.

        Raises:
            StoreError: the file there is not the output: it was changed, or has decayed.
        """
        port, fitting = self._select(output)
        if len(fitting) > 1:
            raise KeyError(f"`{output}` is at {len(fitting)} points, {_listed(fitting)}: name one, step.port[axis=item]")
        file = self._file(fitting[0], port)
        if file is None:
            raise KeyError(f"`{output}` has no name in the run folder: `rockface export`, or run with outputs='all'")
        if not _is_output(file, fitting[0].digests[port]):
            raise StoreError(_changed(fitting[0], port, file) + f"; `run[{output!r}]` takes it from the store")
        return file

    def _file(self, step: Step, port: str) -> Path | None:
        """The file of an output in the run folder. A manifest may be from anybody: what leads out of the folder is none."""
        if port not in step.paths:
            return None
        file = self.folder / step.paths[port]
        try:
            is_inside = not file.is_symlink() and file.resolve(strict=True).is_relative_to(self.folder)
        except OSError:
            return None
        if not is_inside:
            raise RockfaceError(f"{step.label}.{port} leads out of the run folder: {step.paths[port]}")
        return file if file.is_file() else None

    def artefact(self, step: Step, port: str) -> Artefact:
        """An output of a step instance, from the run folder or else from the store.

        A file of the run folder that is not the output, by its BLAKE3, gives way to the store.

        Raises:
            StoreError: neither has it: it was not kept, or was collected.
        """
        kind = step.outputs[port]
        file = self._file(step, port)
        changed = ""
        if file is not None:
            if _is_output(file, step.digests[port]):
                return decode(kind, mapped(file))
            changed = _changed(step, port, file) + "; "
        label = f"{step.step}.{port}" + step.label.removeprefix(step.step)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "output"
            try:
                _program.call("export", str(self.folder), label, str(file), "--plain", "--store", str(self.store))
            except PipelineError as error:
                # The run itself names the output: what is wrong is that the store has it no longer, or never had it.
                raise StoreError(changed + str(error)) from error
            return decode(kind, memoryview(file.read_bytes()))

    def table(self, *axes: str) -> Table:
        """The tidy table of a sweep: a row a point of these axes, the items and every metric as columns.

        Where items have several values, such as the points of a design, these follow as `axis.name`. Metrics are called
        `step.metric`; a step that does not depend on all axes has its numbers in every row they hold
        for, and a step that depends on further axes is left out.

        Args:
            axes: the axes; by default those of `--sweep` if steps with numbers depend on no others,
                else those of the one step that depends on most.

        Raises:
            RockfaceError: no axes are named, and it does not follow from the run which are meant.
        """
        wanted = axes or self._axes()
        steps = [step for step in self.steps if step.metrics and set(step.point) <= set(wanted)]
        points: dict[tuple[str, ...], None] = {}
        for step in self.steps:
            if set(wanted) <= set(step.point):
                points[tuple(step.point[axis] for axis in wanted)] = None
        if not points:
            raise RockfaceError(f"no step depends on {', '.join(wanted)}; the axes of the run are {', '.join(self.axes())}")
        # Metrics by the axes they depend on and the items of these.
        numbers: dict[tuple[str, ...], dict[tuple[str, ...], dict[str, float | None]]] = {}
        units: dict[str, str] = {}
        for step in steps:
            own = tuple(axis for axis in wanted if axis in step.point)
            row = numbers.setdefault(own, {}).setdefault(tuple(step.point[axis] for axis in own), {})
            row.update({f"{step.step}.{name}": value for name, value in step.metrics.items()})
            units.update({f"{step.step}.{name}": unit for name, unit in step.units.items()})
        if not units and any(step.metrics for step in self.steps):
            sets = dict.fromkeys(tuple(step.point) for step in self.steps if step.metrics)
            ways = "; ".join(", ".join(map(repr, axes)) for axes in sets)
            raise RockfaceError(f"no step with numbers depends on {', '.join(wanted)} alone; those of this run depend on {ways}")
        # A value gives way to a metric whose column has its name.
        values = self.manifest.get("values", {})
        names = {
            axis: [name for name in dict.fromkeys(itertools.chain(*values.get(axis, {}).values())) if f"{axis}.{name}" not in units]
            for axis in wanted
        }
        rows: list[list[Any]] = []
        kinds = _typed([dict(zip(wanted, point, strict=True)) for point in points])
        for point in points:
            items = dict(zip(wanted, point, strict=True))
            known: dict[str, float | None] = {}
            for own, by_items in numbers.items():
                known.update(by_items.get(tuple(items[axis] for axis in own), {}))
            cells = [
                [kinds[axis][items[axis]], *(values.get(axis, {}).get(items[axis], {}).get(name) for name in names[axis])]
                for axis in wanted
            ]
            rows.append([*itertools.chain(*cells), *(known.get(name) for name in units)])
        columns = [[axis, *(f"{axis}.{name}" for name in names[axis])] for axis in wanted]
        return Table([*itertools.chain(*columns), *units], rows, units)

    def axes(self) -> list[str]:
        """The axes of the run."""
        return list(dict.fromkeys(axis for step in self.steps for axis in step.point))

    def _axes(self) -> tuple[str, ...]:
        known = set(self.axes())
        # The last key of what was swept, or `swept_` before it where a parameter has that name.
        last = [text.split("=")[0].strip().rpartition(".")[2] for text in self.manifest["overrides"].get("sweep", [])]
        swept = tuple(dict.fromkeys(f"swept_{name}" if f"swept_{name}" in known else name for name in last))
        if swept and set(swept) <= known and any(step.metrics and set(step.point) <= set(swept) for step in self.steps):
            return swept
        sets = list(dict.fromkeys(tuple(step.point) for step in self.steps if step.metrics))
        largest = [one for one in sets if not any(set(one) < set(other) for other in sets)]
        if len(largest) == 1:
            return largest[0]
        if not largest:
            raise RockfaceError("no step of this run has numbers: `run.outputs()` lists what there is")
        ways = "; ".join(", ".join(map(repr, axes)) for axes in largest)
        raise RockfaceError(
            f"name the axes of the table, such as `run.table({largest[0][0]!r})`: the steps of this run have {ways}"
        )

    def plan(self) -> list[PlannedStep]:
        """What running the pipeline again, as it is now, would do."""
        return plan(self._pipeline(), **self._changes())

    def explain(self, step: str) -> Explanation:
        """The recipe of a step instance as it would be now, and what changed since it was last computed."""
        return explain(self._pipeline(), step, **self._changes())

    def _pipeline(self) -> str:
        text = self.manifest["pipeline"]
        file = Path(text["folder"]) / Path(text["path"]).name
        return str(file) if file.is_file() else f"rockface/{file.stem}"

    def _changes(self) -> dict[str, Any]:
        given = self.manifest["overrides"]
        return {"set": given.get("set", []), "sweep": given.get("sweep", []), "seed": given.get("seed"), "store": self.store}

    def __repr__(self) -> str:
        return f"Run({self.name}: {self.status}, {len(self.steps)} steps, {self.folder})"

    def _repr_html_(self) -> str:
        count = {status: sum(step.status == status for step in self.steps) for status in ("executed", "cached", "failed")}
        if self.computed is not None and self.cached is not None:
            count |= {"executed": self.computed, "cached": self.cached}
        told = ", ".join(f"{number} {status}" for status, number in count.items() if number)
        colour = "#2e7d32" if self.status == "done" else "#c62828"
        lines = "".join(f"<li>{html.escape(line)}</li>" for line in self.headlines)
        warned = self.warnings
        lines += "".join(f"<li>warning: {html.escape(text)}</li>" for text in warned[:SHOWN])
        lines += f"<li>… and {len(warned) - SHOWN} more: <code>run.warnings</code></li>" if len(warned) > SHOWN else ""
        failed = "".join(f"<li><b>{html.escape(s.label)}</b>: {html.escape(s.failure)}</li>" for s in self.steps if s.failure)
        return (
            f'<div style="border-left:4px solid {colour};padding-left:1em">'
            f"<b>{html.escape(self.name)}</b>: {html.escape(self.status)}, {told}, {self.manifest['wall_s']:.1f} s"
            f"<ul>{lines}{failed}</ul><div>{self._pictures()}</div>"
            f'<a href="{html.escape(self.report.as_uri())}">report</a> · <code>{html.escape(str(self.folder))}</code></div>'
        )

    def _pictures(self) -> str:
        pictures: list[str] = []
        for step in self.steps:
            for port, kind in step.outputs.items():
                if kind != "picture" or port not in step.paths or len(pictures) == PICTURES:
                    continue
                value = self.artefact(step, port)
                if isinstance(value, Picture) and len(value.png) < PICTURE_BYTES:
                    data, name = base64.b64encode(value.png).decode(), html.escape(step.label)
                    pictures.append(f'<img src="data:image/png;base64,{data}" title="{name}" style="max-width:32%;margin:2px">')
        return "".join(pictures)


def _picks(text: str) -> dict[str, str]:
    pairs = [pick.split("=", 1) for pick in re.findall(r"[^\[\],]+", text)]
    # Points call an axis of a part by its short name.
    return {pair[0].rpartition("/")[2].strip(): pair[-1].strip() for pair in pairs}


def _fitting(steps: Sequence[Step], picks: Mapping[str, str]) -> list[Step]:
    """The steps at points with these items: as they are written, or else of the same number, as 0.10 is 0.1."""
    fitting = [step for step in steps if picks.items() <= dict(step.point).items()]
    if fitting:
        return fitting

    def is_same(item: str | None, pick: str) -> bool:
        number = _number(pick)
        return item == pick or (item is not None and number is not None and _number(item) == number)

    return [step for step in steps if all(is_same(step.point.get(axis), pick) for axis, pick in picks.items())]


def _listed(steps: Sequence[Step]) -> str:
    return ", ".join(step.label for step in steps[:5]) + (", …" if len(steps) > 5 else "")


def _number(text: str) -> float | None:
    return float(text) if NUMBER.fullmatch(text) else None


def _typed(points: Iterable[Mapping[str, str]]) -> dict[str, dict[str, float | int | str]]:
    """The items of axes by their text: numbers where all items of an axis are, whole ones where all are; else texts."""
    axes: dict[str, dict[str, None]] = {}
    for point in points:
        for axis, item in point.items():
            axes.setdefault(axis, {})[item] = None

    def kind(items: Iterable[str]) -> Callable[[str], float | int | str]:
        if not all(NUMBER.fullmatch(item) for item in items):
            return str
        return int if all(item.lstrip("+-").isdecimal() for item in items) else float

    return {axis: {item: kind(items)(item) for item in items} for axis, items in axes.items()}


def _is_output(file: Path, digest: str) -> bool:
    """Whether a file holds the output of this BLAKE3."""
    try:
        from blake3 import blake3
    except ImportError:
        # Once, as Python tells a warning of one place.
        warnings.warn("outputs are not compared with their BLAKE3: `pip install blake3`", RuntimeWarning, stacklevel=2)
        return True
    return bool(blake3(mapped(file)).hexdigest() == digest)


def _changed(step: Step, port: str, file: Path) -> str:
    return f"{file} is not the output {step.label}.{port} of the run any more (its BLAKE3 is another)"


def _is_store(folder: Path) -> bool:
    try:
        return (folder / "format").is_file()
    except OSError:
        return False


def _readable(folder: Path, store: str | Path | None) -> Run | None:
    try:
        return Run(folder, store)
    except RockfaceError:
        return None


def _runs_folders(runs: str | Path | None) -> list[Path]:
    """The folders of runs: the one given, else that of the working folder and those of the folders in it."""
    if runs:
        return [Path(runs)]
    here = Path()
    own = [here / ".rockface", *sorted(folder / ".rockface" for folder in _listed_in(here))]
    return [folder / "runs" for folder in own if _is_folder(folder / "runs")] or [here / ".rockface/runs"]


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:
        return False


def _is_run(folder: Path) -> bool:
    try:
        return (folder / "run.json").is_file()
    except OSError:
        return False


def _listed_in(folder: Path) -> list[Path]:
    """What is in a folder; nothing where that cannot be read."""
    try:
        return list(folder.iterdir())
    except OSError:
        return []


def _asked_for(run: Run) -> float:
    """When a run was last asked for: when it finished, or when a link was pointed at it; seconds since 1970."""
    finished = datetime.fromisoformat(str(run.manifest["finished"]).replace("Z", "+00:00")).timestamp()
    links = [path for path in _listed_in(run.folder.parent) if path.name.startswith("latest") and path.is_symlink()]
    pointed = [link.lstat().st_mtime for link in links if link.readlink() == Path(run.folder.name)]
    return max([finished, *pointed])


def find(run: str | Path = "latest", *, runs: str | Path | None = None, store: str | Path | None = None) -> Run:
    """Opens a past run: the one that `rockface runs show` means by the same name.

    Args:
        run: a run folder, its name, a part of it that fits no other; a pipeline, by its file or its name, for its last run; or
            `latest`, or `latest-NAME` as the link in the folder of runs; `~1` after the last three means the one before.
        runs: the folder of runs, by default `.rockface/runs` of the working folder, and of the folders in it.
        store: the store of results, by default the one that the run names, or that is beside the folder of runs.

    Raises:
        RockfaceError: there is no such run, or several.
    """
    path = Path(run)
    if path.is_file() and path.name != "run.json":
        folders = _runs_folders(runs) if runs else [path.parent / ".rockface/runs"]
        fitting = [one for one in _all(folders, store) if Path(one.manifest["pipeline"]["path"]).name == path.name]
        if not fitting:
            raise RockfaceError(f"{path} has no run in {folders[0]}")
        return max(fitting, key=_asked_for)
    for folder in (path, *([path.parent] if path.name == "run.json" else [])):
        if _is_run(folder):
            return Run(folder, store)
    folders = _runs_folders(runs)
    of, _, back = str(run).rpartition("~")
    if of and back.isdecimal():
        return _before(of, int(back), folders, runs, store)
    name = str(run)
    linked = [name] if name == "latest" else [f"latest-{name}", *([name] if name.startswith("latest-") else [])]
    links = [link for link in (folder / link for link in linked for folder in folders) if _is_run(link)]
    if links:
        return Run(max(links, key=lambda link: link.lstat().st_mtime), store)
    names = sorted({(path.name, path.resolve()) for path in _entries(folders)})
    meant = [pair for pair in names if pair[0] == str(run)] or [pair for pair in names if str(run) in pair[0]]
    if len(meant) == 1:
        return Run(meant[0][1], store)

    def listed(names: list[str]) -> str:
        return ", ".join(names[-SHOWN:]) + (f" and {len(names) - SHOWN} earlier ones" if len(names) > SHOWN else "")

    told = (
        f"fits {listed([name for name, _ in meant])}"
        if meant
        else f"is no run in {folders[0]}; there are {listed([name for name, _ in names]) or 'none'}"
    )
    raise RockfaceError(f"`{run}` {told}")


def _entries(folders: Sequence[Path]) -> list[Path]:
    """The run folders in some folders."""
    # The links `latest` and `latest-NAME` are further names of runs.
    return [path for folder in folders for path in _listed_in(folder) if not path.is_symlink() and _is_run(path)]


def _all(folders: Sequence[Path], store: str | Path | None) -> list[Run]:
    """All runs of some folders, oldest first; what cannot be read is left out."""
    known = [one for one in (_readable(path, store) for path in _entries(folders)) if one]
    return sorted(known, key=lambda one: (str(one.manifest["finished"]), one.folder.name))


def _before(of: str, back: int, folders: Sequence[Path], runs: str | Path | None, store: str | Path | None) -> Run:
    """The run so many before the last one of a pipeline, or of all."""
    last = find(of, runs=runs, store=store)
    # A pipeline has its runs in one folder.
    around = folders if of == "latest" else [last.folder.parent]
    before = [one for one in _all(around, store) if one.folder != last.folder and (of == "latest" or one.name == last.name)]
    if back > len(before):
        raise RockfaceError(f"`{of}` has {len(before) + 1} runs here: none is {back} before the last")
    return [*before, last][-1 - back]
