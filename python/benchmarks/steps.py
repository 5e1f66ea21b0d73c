"""What a step costs besides its work: a trivial function as `stage: python`, as `command`, under joblib.Memory, and with DVC.

Usage: python benchmarks/steps.py [STEPS]; ROCKFACE_BIN names the program. Prints milliseconds a step, cold and cached. What is not
installed (joblib; dvc, as a package of this Python or a program named by DVC) is left out, and said so.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import rockface

MODULE = """
import rockface


@rockface.stage
def own(seed: rockface.Table, n: int) -> rockface.Table:
    return rockface.Table.of([{"n": n}])
"""

PIPELINE = """
rockface: 1
name: steps
axes: {{n: {{values: [{values}]}}}}
steps:
  seed: {{stage: command, with: {{program: sh, args: ["-c", "printf 'a\\n1\\n' > {{out.table}}"], outputs: {{table: {{kind: table, extension: csv}}}}, version: "1"}}}}
  own: {step}
"""  # noqa: E501

STEPS = {
    "stage: python": '{stage: python, with: {module: own.py, function: own, params: {n: "${n}"}}, in: {seed: seed.table}}',
    "command, python3 with numpy": (
        '{stage: command, in: {seed: seed.table}, with: {program: "PYTHON", args: ["-c", "import numpy, sys; '
        'open(sys.argv[1], \'w\').write(\'n\\\\n\' + sys.argv[2] + \'\\\\n\')", "{out.table}", "{param.n}"], params: {n: "${n}"}, '
        'inputs: {seed: table}, outputs: {table: {kind: table, extension: csv}}, version: "1"}}'
    ),
}


def seconds(words: list[str], cwd: Path) -> float:
    """Elapsed seconds of a run with one job."""
    begun = time.perf_counter()
    done = subprocess.run(words, cwd=cwd, env={"ROCKFACE_PYTHON": sys.executable, **os.environ}, capture_output=True, text=True)
    if done.returncode:
        sys.exit(done.stderr)
    return time.perf_counter() - begun


def measure(name: str, step: str, count: int) -> None:
    """Prints what a step costs: the difference of many and few, so that starting is not counted."""
    times = {}
    for steps in (1, count):
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            (place / "own.py").write_text(MODULE)
            values = ", ".join(map(str, range(steps)))
            text = PIPELINE.format(values=values, step=step.replace("PYTHON", sys.executable))
            (place / "p.yaml").write_text(text)
            program = os.environ.get("ROCKFACE_BIN", "rockface")
            words = [program, "run", "p.yaml", "--quiet", "--jobs", "1", "--outputs", "targets"]
            cold = seconds(words, place)
            (place / "p.yaml").write_text(text + "# again\n")
            times[steps] = (cold, seconds(words, place))
    cold, cached = ((times[count][place] - times[1][place]) / (count - 1) * 1e3 for place in (0, 1))
    print(f"{name:32} {count:6} steps  {cold:8.3f} ms a step cold  {cached:8.3f} ms cached; first step {times[1][0] * 1e3:.0f} ms")


def joblib_memory(count: int) -> None:
    """The same under joblib.Memory."""
    try:
        import joblib
    except ImportError:
        print("joblib is not installed")
        return

    with tempfile.TemporaryDirectory() as folder:
        memory = joblib.Memory(folder, verbose=0)
        cached = memory.cache(lambda n: rockface.Table.of([{"n": n}]))
        for word in ("cold", "cached"):
            begun = time.perf_counter()
            for n in range(count):
                cached(n)
            print(f"{'joblib.Memory ' + word:32} {count:6} calls  {(time.perf_counter() - begun) / count * 1e3:8.3f} ms a call")


def dvc(count: int) -> None:
    """Stages of DVC that write a line with a shell: no Python starts for their work."""
    program = os.environ.get("DVC") or str(Path(sys.executable).with_name("dvc"))
    if not Path(program).is_file():
        print("dvc is not installed")
        return
    times = {}
    for steps in (1, count):
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder)
            seconds([program, "init", "--no-scm", "--quiet"], place)
            (place / "seed.csv").write_text("a\n1\n")
            stages = "".join(
                f"  own{n}:\n    cmd: printf 'n\\n{n}\\n' > own{n}.csv\n    deps: [seed.csv]\n    outs: [own{n}.csv]\n"
                for n in range(steps)
            )
            (place / "dvc.yaml").write_text("stages:\n" + stages)
            cold = seconds([program, "repro", "--quiet"], place)
            times[steps] = (cold, seconds([program, "repro", "--quiet"], place))
    cold, cached = ((times[count][place] - times[1][place]) / (count - 1) * 1e3 for place in (0, 1))
    first = times[1][0] * 1e3
    print(
        f"{'dvc repro, printf':32} {count:6} steps  {cold:8.3f} ms a step cold  {cached:8.3f} ms cached; first step {first:.0f} ms"
    )


def main() -> None:
    """Measures all."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    measure("stage: python", STEPS["stage: python"], count)
    measure("command, python3 with numpy", STEPS["command, python3 with numpy"], max(count // 20, 2))
    joblib_memory(count)
    dvc(max(count // 20, 2))


if __name__ == "__main__":
    main()
