"""Functions as steps: what they get, what reruns them, and what becomes of functions that misbehave."""

import os
import subprocess
import textwrap
from pathlib import Path

import numpy as np
import pytest

import rockface
from rockface import _exchange, _program

PIPELINE = """
rockface: 1
name: own
seed: 1
axes:
  trial: {{count: {trials}}}
steps:
  face: {{stage: synthesise-face, with: {{width_m: 4, height_m: 3, spacing_m: 0.1}}}}
  dem: {{stage: rasterise-dem, in: {{surface: face.mesh}}, with: {{cell_m: 0.1, method: tin}}}}
  own:
    stage: python
    over: [trial]
    timeout: 60s
    with: {{module: own.py, function: own{more}}}
    in: {{dem: dem.raster}}
  after: {{stage: difference-dem, in: {{reference: dem.raster, comparison: own.raster}}}}
"""
HEADER = """
import numpy as np
import rockface

"""


class Bench:
    """A folder with a pipeline and its module."""

    def __init__(self, folder):
        self.folder = folder
        self.pipeline()

    def pipeline(self, more="", trials=1, text=PIPELINE):
        (self.folder / "own.yaml").write_text(text.format(more=more, trials=trials))

    def module(self, text, name="own.py", header=HEADER):
        (self.folder / name).write_text(header + textwrap.dedent(text))

    def run(self, **more):
        return rockface.run("own.yaml", progress=False, **more)

    def executed(self, **more):
        """Names of the steps that run."""
        return sorted({step.step for step in rockface.plan("own.yaml", **more) if step.answer != "hit"})

    def fails(self, **more):
        """The failure of `own`, with every other step finished."""
        with pytest.raises(rockface.StepError) as caught:
            self.run(keep_going=True, **more)
        failures = {failure.step.split("[")[0]: failure for failure in caught.value.failures}
        assert set(failures) == {"own"}
        assert {step.step for step in caught.value.run.steps if step.status in ("executed", "cached")} >= {"face", "dem"}
        failure = failures["own"]
        return f"{failure.message}\n{failure.hint}"


@pytest.fixture
def bench(folder):
    return Bench(folder)


RAISE = """
    @rockface.stage
    def own(dem: rockface.Raster, lift_m: float = 1.0) -> rockface.Raster:
        return dem.like(dem.values + lift_m, "elevation")
"""


def test_a_function_gets_arrays_and_makes_an_artefact(bench):
    bench.module("""
    from typing import NamedTuple

    class Made(NamedTuple):
        raster: rockface.Raster
        table: rockface.Table

    @rockface.stage
    def own(dem: rockface.Raster, lift_m: float = 1.0) -> Made:
        assert not dem.values.flags.owndata, "mapped, not copied"
        assert dem.values.dtype == np.float32
        rockface.metric("lift", lift_m, "m")
        rockface.headline(f"lifted by {lift_m} m")
        print("said")
        return Made(dem.like(dem.values + lift_m, "elevation"), rockface.Table.of([{"lift_m": lift_m, "word": "a"}]))
    """)
    bench.pipeline(more=", params: {lift_m: 2}")
    run = bench.run(targets=["own"])
    np.testing.assert_allclose(run["own.raster"].values, run["dem.raster"].values + 2, rtol=1e-6)
    assert run["own.raster"].grid == run["dem.raster"].grid
    assert run["own.table"][0] == {"lift_m": 2.0, "word": "a"}
    step = next(step for step in run.steps if step.step == "own")
    assert (step.metrics["lift"], step.units["lift"]) == (2.0, "m")
    assert run.headlines == ["own[trial=0]: lifted by 2.0 m"]
    assert bench.run(targets=["own"]).computed == 0


def test_every_kind_goes_through_a_function_and_comes_back(bench, small):
    kinds = {
        "raster": "change.raster[sigma_px=0.4]", "depth": "left.depth", "mesh": "face.mesh", "meshes": "rockfall.pieces",
        "cloud": "cloud.points", "surface": "surface.surface[epoch=pre,sigma_px=0.4]", "cameras": "survey.cameras",
        "pairs": "pairs.pairs", "transform": "align.transform", "covariance": "errors.covariance", "table": "table.table",
        "inventory": "rockfall.truth", "picture": "picture.picture",
    }  # fmt: skip
    from rockface._exchange import KINDS, read, write

    for kind, output in kinds.items():
        known = {f"{step.step}.{port}": kind for step in small.steps for port, kind in step.outputs.items()}
        match = next((name for name, own in known.items() if own == kind), None)
        value = small[output] if output.split("[")[0] in known else small[match]
        value = value[0] if isinstance(value, rockface.Outputs) else value
        again = read(kind, memoryview(write(kind, value)))
        assert type(again) is KINDS[kind]
        assert write(kind, again) == write(kind, value)


def test_parameters_are_checked_before_anything_runs(bench):
    bench.module("""
    from typing import Annotated, Literal

    @rockface.stage
    def own(
        dem: rockface.Raster, share: Annotated[float, rockface.Range(0, 1)], how: Literal["a", "b"] = "a", count: int = 3
    ) -> rockface.Raster:
        return dem
    """)
    for more, expected in [
        (", params: {share: 2}", "2 is out of range: 0 to 1"),
        (", params: {share: 0.5, how: c}", 'expected one of "a", "b", found "c"'),
        (", params: {share: 0.5, count: 1.5}", "expected a whole number, found 1.5"),
        (", params: {share: 0.5, cuont: 2}", "did you mean `count`"),
        ("", "`share` (number) of the function is missing"),
        (", params: {share: 0.5}, outputs: {labels: raster}", "the function has {raster: raster}"),
    ]:
        bench.pipeline(more=more)
        with pytest.raises(rockface.PipelineError) as caught:
            bench.run()
        assert expected in str(caught.value), str(caught.value)
        assert "own.yaml:" in str(caught.value)


def test_signatures_that_say_too_little_are_refused(bench):
    for text, expected in [
        ("def own(dem: rockface.Raster) -> rockface.Raster: return dem", "`own` is no stage"),
        ("@rockface.stage\ndef other(dem: rockface.Raster) -> rockface.Raster: return dem", "its stages are other"),
        ("@rockface.stage\ndef own(dem) -> rockface.Raster: return dem", "`dem` of `own` has no type"),
        ("@rockface.stage\ndef own(dem: rockface.Raster): return dem", "does not say what it returns"),
        ("@rockface.stage\ndef own(dem: dict) -> rockface.Raster: return dem", "has the type `dict`"),
        ("@rockface.stage\ndef own(dem: rockface.Raster) -> int: return dem", "returns `int`"),
        ("@rockface.stage\ndef own(*dem: rockface.Raster) -> rockface.Raster: return dem", "`*`"),
        ("def own(:", "line 5"),
        ("import nothing_of_that_name\n" + textwrap.dedent(RAISE), "`nothing_of_that_name`, which is not installed"),
    ]:
        bench.module(text)
        with pytest.raises(rockface.PipelineError) as caught:
            bench.run()
        assert expected in str(caught.value), str(caught.value)


def test_planning_executes_nothing(bench):
    bench.module("(__import__('pathlib').Path('/dev/shm/rockface-executed')).touch()\n" + textwrap.dedent(RAISE))
    Path("/dev/shm/rockface-executed").unlink(missing_ok=True)
    assert "own" in bench.executed()
    assert not Path("/dev/shm/rockface-executed").exists()


def test_random_numbers_follow_from_seed_and_point(bench):
    bench.module("""
    @rockface.stage
    def own(dem: rockface.Raster, random: rockface.Random) -> rockface.Raster:
        return dem.like(random.generator("noise").normal(size=dem.shape), "noise")
    """)
    bench.pipeline(trials=3)
    first = [raster.values for raster in bench.run()["own.raster"]]
    assert not np.array_equal(first[0], first[1])
    again = [raster.values for raster in bench.run(store="other", runs="others", jobs=1)["own.raster"]]
    assert all(np.array_equal(one, other) for one, other in zip(first, again, strict=True))
    other = bench.run(seed=2)["own.raster"][0].values
    assert not np.array_equal(first[0], other)


class TestEdits:
    """What runs again after what; never a stale result."""

    def test_the_table(self, bench):
        bench.module("def lifted(values, by):\n    return values + by\n", "helper.py", "")
        text = "import helper\n" + textwrap.dedent(RAISE).replace("dem.values + lift_m", "helper.lifted(dem.values, lift_m)")
        bench.module(text)
        first = bench.run()["own.raster"].values
        assert bench.executed() == []
        # A comment in the module: the step runs, its output is equal, nothing after it runs.
        bench.module(text + "# a comment\n")
        assert bench.executed() == ["after", "own"]
        run = bench.run()
        assert {step.step for step in run.steps if step.status == "executed"} == {"own"}
        # A helper module that it imports.
        bench.module("def lifted(values, by):\n    return values + 2 * by\n", "helper.py", "")
        assert bench.executed() == ["after", "own"]
        assert np.nanmean(bench.run()["own.raster"].values - first) == pytest.approx(1, abs=1e-6)
        # A file beside it that nobody imports.
        bench.module("", "other.py", "")
        assert bench.executed() == []
        # A parameter as its default, and as another value.
        bench.pipeline(more=", params: {lift_m: 1}")
        assert bench.executed() == []
        bench.pipeline(more=", params: {lift_m: 3}")
        assert bench.executed() == ["after", "own"]

    def test_an_upgrade_of_a_package_runs_the_step_again(self, bench, monkeypatch):
        packages = bench.folder / "lib" / "site-packages"

        def install(version):
            for old in packages.glob("tinylift-*"):
                (old / "METADATA").unlink()
                old.rmdir()
            metadata = packages / f"tinylift-{version}.dist-info"
            metadata.mkdir(parents=True)
            (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: tinylift\nVersion: {version}\n")
            (packages / "tinylift.py").write_text(f"BY = {version}\n")

        install("1.0")
        monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(packages), os.environ.get("PYTHONPATH", "")]))
        text = "import tinylift\n" + textwrap.dedent(RAISE).replace("+ lift_m", "+ tinylift.BY")
        bench.module(text)
        first = bench.run()["own.raster"].values
        assert bench.executed() == []
        install("2.0")
        assert bench.executed() == ["after", "own"]
        run = bench.run()
        assert np.nanmean(run["own.raster"].values - first) == pytest.approx(1, abs=1e-6)
        recipe = run.explain("own[trial=0]").recipe
        assert recipe["params"]["packages"]["tinylift"] == "2.0"

    def test_a_same_size_edit_within_a_second_is_seen(self, bench):
        bench.module(RAISE)
        before = bench.run()["own.raster"].values
        state = (bench.folder / "own.py").stat()
        bench.module(RAISE.replace("+ lift_m", "- lift_m"))
        os.utime(bench.folder / "own.py", ns=(state.st_atime_ns, state.st_mtime_ns))
        assert np.nanmean(before - bench.run()["own.raster"].values) == pytest.approx(2, abs=1e-6)

    def test_a_module_that_planning_does_not_see_is_refused(self, bench):
        bench.module("BY = 1\n", "hidden.py", "")
        bench.module("import importlib\n" + textwrap.dedent(RAISE).replace("+ lift_m", "+ importlib.import_module('hidden').BY"))
        told = bench.fails()
        assert "it imported `hidden`" in told
        assert "`import` statement" in told


HOSTILE = {
    "exception": ("raise ValueError('no such thing')", ["ValueError: no such thing", "own.py, line 8, in own: raise ValueError"]),
    "exit": ("raise SystemExit(3)", ["it called sys.exit(3)"]),
    "hard exit": ("import os; os._exit(7)", ["ended in the middle", "ended with code 7"]),
    "segfault": ("import ctypes; ctypes.string_at(0)", ["SIGSEGV", "own.py"]),
    "kill": ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", ["SIGKILL"]),
    "memory": ("np.ones(10 << 27)", ["more than the 4 GiB", "memory_gib"]),
    "infinite recursion": ("own(dem)", ["RecursionError"]),
    "shape": ("return dem.like(dem.values[1:], 'x')", ["has the shape (30, 41)", "31 rows x 41 columns"]),
    "dtype": ("return dem.like(dem.values.astype(complex), 'x')", ["complex"]),
    "objects": ("return dem.like(np.full(dem.shape, None), 'x')", ["object"]),
    "labels": ("return dem.like(np.full(dem.shape, -1), 'x')", ["from -1 to -1"]),
    "kind": ("return dem.values", ["an array of float32", "not a rockface.Raster"]),
    "nothing": ("pass", ["NoneType, not a rockface.Raster"]),
    "grid": ("return rockface.Raster.single(rockface.Grid(41, 31, float('nan'), 0, 0), dem.values)", ["cells of"]),
    "threads": (
        "import threading, time; threading.Thread(target=time.sleep, args=(60,)).start(); return dem",
        ["1 threads running"],
    ),
    "processes": ("import subprocess; subprocess.Popen(['sleep', '60']); return dem", ["1 processes running"]),
    "fork": ("import os, time; os.fork() or time.sleep(60); return dem", ["1 processes running"]),
    "closed output": ("import sys; sys.stdout.close(); sys.stderr.close(); raise KeyError('a')", ["KeyError: 'a'"]),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_function_is_a_clear_error_of_its_step(bench, name):
    body, expected = HOSTILE[name]
    bench.module(f"""
    @rockface.stage
    def own(dem: rockface.Raster) -> rockface.Raster:
        {body}
    """)
    told = bench.fails()
    for words in expected:
        assert words in told, told
    # The next function gets a process that works.
    bench.module(RAISE)
    assert bench.run()["own.raster"].shape == (31, 41)


def test_an_endless_function_ends_at_its_timeout(bench):
    bench.pipeline(text=PIPELINE.replace("60s", "1s"))
    bench.module("""
    @rockface.stage
    def own(dem: rockface.Raster) -> rockface.Raster:
        while True:
            pass
    """)
    assert "longer than its timeout of 1s" in bench.fails()
    assert processes("own.py", bench.folder) == []


def test_a_hundred_megabytes_of_prints_are_cut(bench):
    bench.module("""
    @rockface.stage
    def own(dem: rockface.Raster) -> rockface.Raster:
        for number in range(1000):
            print("x" * 100_000)
        print("the end")
        return dem
    """)
    assert bench.run()["own.raster"].shape == (31, 41)


def test_a_forked_child_that_comes_back_gives_no_second_answer(bench):
    bench.module("""
    import os

    @rockface.stage
    def own(dem: rockface.Raster) -> rockface.Raster:
        if child := os.fork():
            os.waitpid(child, 0)
        return dem
    """)
    bench.pipeline(trials=3)
    assert len(bench.run(jobs=1)["own.raster"]) == 3


def test_one_failure_of_many_leaves_the_others(bench):
    bench.module("""
    import os

    @rockface.stage
    def own(dem: rockface.Raster, random: rockface.Random, trial: int) -> rockface.Raster:
        if trial % 3 == 1:
            os.abort()
        return dem
    """)
    bench.pipeline(more=', params: {{trial: "${{trial}}"}}'.format(), trials=9)
    with pytest.raises(rockface.StepError) as caught:
        bench.run(keep_going=True, jobs=2)
    assert len(caught.value.failures) == 3
    assert all("SIGABRT" in failure.message for failure in caught.value.failures)
    assert len([step for step in caught.value.run.steps if step.step == "own" and step.status == "executed"]) == 6


def test_one_process_works_for_a_whole_sweep(bench):
    bench.module("""
    import os

    @rockface.stage
    def own(dem: rockface.Raster, random: rockface.Random) -> rockface.Raster:
        rockface.metric("process", os.getpid())
        return dem.like(random.generator().normal(size=dem.shape), "noise")
    """)
    bench.pipeline(trials=20)
    table = bench.run(jobs=1).table("trial")
    assert len(set(table["own.process"])) == 1
    assert processes("own.py", bench.folder) == []


def test_unseeded_random_numbers_are_found(bench):
    bench.module("""
    @rockface.stage
    def own(dem: rockface.Raster) -> rockface.Raster:
        return dem.like(np.random.default_rng().normal(size=dem.shape), "noise")
    """)
    assert "it is not deterministic: output `raster` differs" in bench.fails(check_determinism=True)
    bench.module(RAISE)
    assert bench.run(check_determinism=True)["own.raster"].shape == (31, 41)


def test_files_and_gathered_inputs(bench):
    (bench.folder / "own.yaml").write_text("""
rockface: 1
name: gathered
seed: 1
axes: {cell_m: {values: [0.1, 0.2]}}
steps:
  face: {stage: synthesise-face, with: {width_m: 4, height_m: 3, spacing_m: 0.1}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: "${cell_m}", method: tin}}
  own:
    stage: python
    with: {module: own.py, function: own, files: {words: words.txt}}
    in: {dems: {each: dem.raster, over: [cell_m]}}
""")
    (bench.folder / "words.txt").write_text("hello")
    bench.module("""
    from pathlib import Path

    @rockface.stage(output="sizes")
    def own(
        dems: rockface.Gathered[rockface.Raster], words: Path, extra: rockface.Mesh | None = None, note: Path | None = None
    ) -> rockface.Table:
        assert extra is None and note is None
        rows = [{"cell_m": point["cell_m"], "rows": dem.grid.rows} for dem, point in zip(dems, dems.points)]
        return rockface.Table.of([{**row, "words": words.read_text()} for row in rows])
    """)
    sizes = bench.run()["own.sizes"]
    assert [row["rows"] for row in sizes] == [31, 16]
    assert sizes[0]["words"] == "hello"
    (bench.folder / "words.txt").write_text("world")
    assert bench.executed() == ["own"]


def test_an_archive_has_the_modules_of_all_functions(bench):
    bench.module(RAISE)
    _program.call("run", "own.yaml", "--target", "face")
    _program.call("archive", "latest", "--inputs", "-o", "run.tar")
    elsewhere = bench.folder / "elsewhere"
    elsewhere.mkdir()
    subprocess.run(["tar", "-xf", bench.folder / "run.tar"], cwd=elsewhere, check=True)
    assert "outputs are the same" in _program.call("run", "run.json", cwd=elsewhere)


def test_without_commands_no_function_is_called_or_described(bench):
    bench.module(RAISE)
    done = subprocess.run(
        [os.environ["ROCKFACE_BIN"], "run", "own.yaml", "--no-commands"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 2
    assert "starts a program (stage `python`)" in done.stderr


def processes(word, folder):
    """Processes that still work on a file of a folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            command = path.read_bytes().decode(errors="replace")
        except OSError:
            continue
        if word in command and str(folder) in command:
            found.append(command)
    return found


def test_a_stage_can_be_called_as_a_function():
    @rockface.stage(output="labels")
    def threshold(difference: rockface.Raster, random: rockface.Random, limit_m: float = 0.1) -> rockface.Raster:
        noise = random.generator().normal(0, 1e-9, difference.shape)
        return difference.like((difference.values + noise) < -limit_m, "loss")

    grid = rockface.Grid(3, 2, 0.5, 0, 0)
    raster = rockface.Raster.single(grid, np.array([[0, -1, 0], [0, 0, -2.0]]))
    assert threshold(raster, rockface.Random.seeded(1)).values.sum() == 2


def test_lists_of_floats_hold_floats(bench):
    bench.pipeline(", params: {weights: [1, 2, 3.5]}")
    bench.module("""
        @rockface.stage(output="raster")
        def own(dem: rockface.Raster, weights: list[float] = [1.0], deep: list[list[float]] = [[1.0]]) -> rockface.Raster:
            assert [type(one) for one in [*weights, *deep[0]]] == [float] * 4
            return dem
    """)
    bench.run()


def test_masked_cells_have_no_value(bench):
    bench.module("""
        @rockface.stage(output="raster")
        def own(dem: rockface.Raster) -> rockface.Raster:
            return dem.like(np.ma.masked_where(np.indices(dem.shape)[0] < 3, np.full(dem.shape, 5.0)), "elevation")
    """)
    values = bench.run()["own.raster"].values
    assert np.isnan(values[:3]).all()
    assert (values[3:] == 5).all()


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("dem.like(np.full(dem.shape, 1e39))", "infinite, or beyond what 32 bits hold"),
        ("dem.like(np.ma.masked_equal(np.zeros(dem.shape, np.uint8), 0))", "are masked"),
        ("rockface.Table.of([{'a': np.inf}])", "column `a` of the table has inf"),
        ("rockface.Table.of([{'t': 1700000000123456789}])", "more digits than a number holds"),
        ("rockface.Table(['a', 'a'], [[1, 2]])", "two columns of the table are called `a`"),
        ("rockface.Mesh(dem.frame, np.eye(3), np.array([[0, 1.7, 2]]))", "`triangles` has values from 0.0 to 2.0"),
        (
            "rockface.Mesh(dem.frame, np.eye(3), np.array([[0, 1, 2]]), np.full((3, 3), 0.9))",
            "`colours` has values from 0.9 to 0.9",
        ),
        ("rockface.Cloud(dem.frame, np.eye(3), numbers={'n': np.array([1, -1, 2])})", "`n` has values from -1 to 2"),
        ("rockface.Cloud(dem.frame, np.eye(3), numbers={'n': np.array([1, np.nan, 2])})", "`n` has values"),
    ],
)
def test_values_that_would_be_changed_are_refused(bench, value, told):
    kind = value.split("(")[0].removeprefix("rockface.").split(".")[0].replace("dem", "Raster")
    text = PIPELINE[: PIPELINE.index("  after:")]
    bench.pipeline(text=text)
    bench.module(f"""
        @rockface.stage(output="out")
        def own(dem: rockface.Raster) -> rockface.{kind}:
            return {value}
    """)
    assert told in bench.fails()


def test_a_function_that_asks_for_input_finds_its_end(bench):
    bench.module("""
        @rockface.stage(output="raster")
        def own(dem: rockface.Raster) -> rockface.Raster:
            input("go on? ")
            return dem
    """)
    assert "EOFError" in bench.fails()


def test_a_target_and_a_swept_value_may_stand_alone(bench):
    bench.module("""
        @rockface.stage(output="raster")
        def own(dem: rockface.Raster) -> rockface.Raster:
            return dem
    """)
    run = bench.run(targets="dem", sweep={"steps.dem.with.cell_m": 0.2})
    assert rockface.open("own").folder == run.folder


RING = [[0.2, 0.2], [0.6, 0.2], [0.6, 0.5], [0.2, 0.2]]


def inventory_of(bench, body):
    """The inventory that a function without inputs makes."""
    text = """
rockface: 1
name: made
steps:
  own: {{stage: python, with: {{module: own.py, function: own}}}}
"""
    bench.pipeline(text=text)
    bench.module(f"""
        RING = {RING}

        @rockface.stage(output="found")
        def own() -> rockface.Inventory:
            {body}
    """)
    return bench.run()["own"]


def test_an_inventory_is_kept_as_people_make_it(bench):
    polygon = '{"type": "Feature", "properties": PROPERTIES, "geometry": {"type": "Polygon", "coordinates": [RING]}}'
    features = ", ".join(polygon.replace("PROPERTIES", own) for own in ("{}", repr({"volume_m3": 0.5, "is_big": True})))
    crs = '"crs": {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::28356"}}'
    made = inventory_of(bench, f'return rockface.Inventory(rockface.Frame.WORLD, {{{crs}, "features": [{features}]}})')
    assert (made.frame, made.crs) == (rockface.Frame.WORLD, "EPSG:28356")
    assert made.table().columns == ["volume_m3", "is_big"]
    assert made.table().rows == [[None, None], [0.5, True]]
    assert made.geojson["features"][0]["geometry"] == {"type": "MultiPolygon", "coordinates": [[RING]]}
    # The frame is that of the object, not that of the collection it was made from.
    both = '"rockface": {"frame": {"axes": "world", "crs": "EPSG:28356"}, "columns": []}'
    made = inventory_of(bench, f'return rockface.Inventory(rockface.Frame.WALL, {{{both}, "features": []}})')
    assert (made.frame, made.crs) == (rockface.Frame.WALL, None)


def test_an_inventory_goes_through_geopandas(bench):
    geopandas = pytest.importorskip("geopandas")
    shape = pytest.importorskip("shapely.geometry").Polygon(RING)
    data = geopandas.GeoDataFrame({"volume_m3": [0.5], "geometry": [shape]}, crs="EPSG:28356")
    made = rockface.Inventory.from_geopandas(data, rockface.Frame.WORLD)
    assert made.crs == "EPSG:28356"
    back = _exchange.decode("inventory", memoryview(_exchange.write("inventory", made))).to_geopandas()
    assert back.crs.to_epsg() == 28356
    assert (back.volume_m3[0], back.geometry[0].area) == (0.5, shape.area)
    assert rockface.Inventory.from_geopandas(data[data.volume_m3 > 9]).table().columns == ["volume_m3"]
    with pytest.raises(rockface.RockfaceError, match="not in metres"):
        rockface.Inventory.from_geopandas(data.to_crs("EPSG:4326"), rockface.Frame.WORLD)


@pytest.mark.parametrize(
    ("value", "told"),
    [
        ("rockface.Cloud(WALL, np.zeros((2, 3)), numbers={'x': np.arange(2)})", "`x` cannot name a number"),
        ("rockface.Cloud(WALL, np.zeros((2, 3)), numbers={'my label': np.arange(2)})", "`my label` cannot name a number"),
        ("dataclasses.replace(depth, z=depth.z[8:], channels={})", "the sensor with downscale 1 has (350, 450)"),
        ("dataclasses.replace(depth, z=depth.z[::2, ::2], channels={})", "set pixels that are not wanted to NaN"),
        ("rockface.Inventory(WALL, {'features': [{'properties': {'a': [1]}, 'geometry': None}]})", "`a` of feature 0"),
        ("rockface.Inventory(WALL, {'features': [{'geometry': {'type': 'Point'}}]})", "the geometry of feature 0"),
        ("rockface.Inventory(WALL, {'type': 'Feature'})", "no feature collection"),
    ],
)
def test_values_that_lie_about_their_place_are_refused(small, value, told):
    import dataclasses

    names = {"np": np, "rockface": rockface, "WALL": rockface.Frame.WALL, "dataclasses": dataclasses, "depth": small["left.depth"]}
    made = eval(value, names)
    kind = next(kind for kind, own in _exchange.KINDS.items() if own is type(made))
    with pytest.raises(_exchange.WrongOutputError) as caught:
        _exchange.write(kind, made)
    assert told in str(caught.value)


def test_a_mesh_without_triangles_stays_one():
    from rockface._exchange import decode, write

    empty = rockface.Mesh(rockface.Frame.WALL, np.zeros((2, 3)), np.zeros((0, 3), np.uint32))
    assert len(decode("mesh", memoryview(write("mesh", empty))).triangles) == 0
