"""Runs pipelines with the program, shows how far they are, and opens what they made."""

from __future__ import annotations

import importlib
import json
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from rockface import _program
from rockface._errors import ProgramError, StepError, StepFailure
from rockface.plans import Values, _axes, arguments
from rockface.runs import Run

__all__ = ["Progress", "run"]

WARNINGS = 10
"""Warnings that are shown; a run has them all."""
STOP_S = 30.0
"""Seconds a run is given to stop by itself after an interruption."""


Progress = Callable[[Mapping[str, Any]], None]
"""Receives every event of a run: `{"event": "finished", "step": "dem", "done": 3, "total": 9, ...}`."""


def run(
    pipeline: str | Path,
    *,
    set: Values | None = None,
    sweep: Mapping[str, object] | Sequence[str] | None = None,
    seed: int | None = None,
    targets: Sequence[str] = (),
    jobs: int | None = None,
    memory_gib: float | None = None,
    keep_going: bool = False,
    outputs: str = "auto",
    check_determinism: bool = False,
    store: str | Path | None = None,
    runs: str | Path | None = None,
    progress: bool | Progress = True,
) -> Run:
    """Runs a pipeline; what is cached is not computed again.

    ```python
    run = rockface.run("quickstart", set={"params.cell_m": 0.05})
    run = rockface.run("cells.yaml", sweep={"cell_m": [0.05, 0.1, 0.2]})
    ```

    Args:
        pipeline: a YAML file, or the name of a pipeline that ships with rockface.
        set: values to override by their path, such as `{"steps.dem.with.method": "tin"}`.
        sweep: axes to sweep: a list of values, or a text such as `"0.6..0.8:5"`.
        seed: takes the place of the pipeline's seed.
        targets: run only these steps and those they need.
        jobs: steps at once, and threads inside them.
        memory_gib: memory for values passed between steps and for running steps.
        keep_going: after a failed step, go on with steps that do not depend on it.
        outputs: which outputs get names in the run folder: `auto`, `targets`, `all` or `none`; others are read from the store.
        check_determinism: run every step that runs twice, and fail where two goes differ.
        store: the store of results, by default `.rockface/store` beside the pipeline.
        runs: the folder of runs, by default `.rockface/runs` beside the pipeline.
        progress: whether to show progress, or what is to be told of every event.

    Raises:
        PipelineError: the pipeline is wrong; the message has every fault with its place.
        StepError: steps failed; its `run` has what was finished.
        StoreError: the store or the disk failed.
        KeyboardInterrupt: the run was interrupted; it has stopped, and what was finished is kept.
    """
    words = ["run", "--json", *arguments(pipeline, set, _axes(sweep), seed, targets, store), f"--outputs={outputs}"]
    words += [f"--runs={runs}"] if runs is not None else []
    words += [f"--jobs={jobs}"] if jobs is not None else []
    words += [f"--memory={memory_gib}"] if memory_gib is not None else []
    words += ["--keep-going"] if keep_going else []
    words += ["--check-determinism"] if check_determinism else []
    show = progress if callable(progress) else (_shown() if progress else _silent)
    ended, failures, stderr, code = _watch(words, show)
    folder = ended.get("folder")
    opened = Run(folder, store) if folder else None
    if opened is not None:
        opened.computed, opened.cached = ended["executed"], ended["cached"]
    if code == 1:
        raise StepError(failures, opened)
    if code != 0:
        _program.refuse(code, stderr)
    if opened is None:
        raise ProgramError("rockface ended without naming a run folder")
    return opened


def _watch(words: list[str], show: Progress) -> tuple[dict[str, Any], list[StepFailure], str, int]:
    """Runs the program: its last event, the failures, its messages and its exit code."""
    command = [str(_program.find()), *words]
    # A group of its own: Ctrl-C reaches it once, by way of this process; a second one would end it at once.
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=_program.environment(), text=True, start_new_session=True
    )
    if process.stdout is None or process.stderr is None:
        raise ProgramError("rockface was started without its output")
    messages: list[str] = []
    reader = threading.Thread(target=_drain, args=(process.stderr, messages), daemon=True)
    reader.start()
    ended: dict[str, Any] = {}
    failures: list[StepFailure] = []
    try:
        for line in process.stdout:
            event = json.loads(line)
            if event.get("event") == "failed":
                failures.append(StepFailure(event["step"], event["stage"], event["message"], event.get("hint")))
            if event.get("event") == "ended":
                ended = event
            show(event)
        code = process.wait()
    except BaseException:
        _stop(process)
        raise
    finally:
        show({"event": "closed"})
    reader.join()
    return ended, failures, "".join(messages), code


def _drain(stream: IO[str], into: list[str]) -> None:
    into.extend(stream)


def _stop(process: subprocess.Popen[str]) -> None:
    """Asks the program to stop, and waits until it has."""
    if process.poll() is None:
        process.send_signal(signal.SIGINT)
    if process.stdout:
        # What it still says must not block it.
        threading.Thread(target=_drain, args=(process.stdout, []), daemon=True).start()
    try:
        process.wait(STOP_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _silent(event: Mapping[str, Any]) -> None:
    """Shows nothing."""


def _shown() -> Progress:
    """How progress is shown here: in the cell of a notebook, on a terminal; elsewhere only what steps warn of."""
    notebook = _notebook()
    if notebook is not None:
        return notebook
    return _Line(sys.stderr) if sys.stderr.isatty() else _Warnings(sys.stderr)


def printable(text: str) -> str:
    """A text for a terminal: what that takes for a command, or what turns the direction of letters, is written out."""
    return re.sub(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]", lambda found: f"\\u{ord(found[0]):04x}", text)


class _Warnings:
    """Lines of what steps warn of."""

    def __init__(self, stream: Any) -> None:
        self.stream, self.count = stream, 0

    def __call__(self, event: Mapping[str, Any]) -> None:
        if event.get("event") == "warning":
            self.count += 1
            if self.count <= WARNINGS:
                self.stream.write(printable(f"warning: {event['step']}: {event['text']}") + "\n")
        elif event.get("event") == "closed" and self.count > WARNINGS:
            self.stream.write(f"warning: {self.count - WARNINGS} more, in the `warnings` of the run\n")


def _sentence(event: Mapping[str, Any], begun: float) -> str:
    done, total = event.get("done", 0), event.get("total", 0)
    return f"rockface: {done} of {total} steps, {time.monotonic() - begun:.0f} s; {event.get('step', '')}"


class _Line:
    """One line of a terminal, written again and again."""

    def __init__(self, stream: Any) -> None:
        self.stream, self.begun, self.written, self.count = stream, time.monotonic(), 0.0, 0

    def __call__(self, event: Mapping[str, Any]) -> None:
        kind, now = event.get("event"), time.monotonic()
        if kind == "warning":
            self.count += 1
            if self.count > WARNINGS:
                return
            self.stream.write("\r\x1b[K" + printable(f"warning: {event['step']}: {event['text']}") + "\n")
        elif kind == "closed":
            more = self.count - WARNINGS
            self.stream.write("\r\x1b[K" + (f"warning: {more} more, in the `warnings` of the run\n" if more > 0 else ""))
        elif "total" in event and now - self.written > 0.1:
            self.written = now
            self.stream.write("\r\x1b[K" + _sentence(event, self.begun)[:100])
        self.stream.flush()


def _notebook() -> Progress | None:
    """Shows progress in the cell of a Jupyter notebook; `None` where this is none."""
    if "ipykernel" not in sys.modules:
        return None
    # Also a package that a program imports may bring it along.
    if importlib.import_module("IPython").get_ipython() is None:
        return None
    shown: Any = importlib.import_module("IPython.display")
    begun, state = time.monotonic(), {"written": 0.0}
    warned: list[str] = []
    handle = shown.display(shown.HTML(""), display_id=True)

    def show(event: Mapping[str, Any]) -> None:
        now = time.monotonic()
        if event.get("event") == "ended":
            warned.extend(event.get("warnings", []))
        elif event.get("event") == "closed":
            # The head of the run, which a cell may end with, has their texts.
            told = f"<div>{len(warned)} warnings: <code>run.warnings</code></div>" if warned else ""
            handle.update(shown.HTML(told))
        elif "total" in event and now - state["written"] > 0.2:
            state["written"] = now
            share = f'<progress value="{event["done"]}" max="{max(event["total"], 1)}"></progress> '
            handle.update(shown.HTML(share + _sentence(event, begun)))

    return show
