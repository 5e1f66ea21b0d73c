"""Running, planning and explaining from Python; errors are those of the program."""

import os
import shutil
import signal
import threading
import time

import numpy as np
import pytest

import rockface
from conftest import SMALL


@pytest.fixture
def pipeline(folder):
    """A quick pipeline of two steps over a swept axis."""
    text = """
rockface: 1
name: quick
seed: 1
params: {relief_m: 0.1}
axes: {cell_m: {values: [0.1, 0.2]}}
steps:
  face: {stage: synthesise-face, with: {width_m: 8, height_m: 6, spacing_m: 0.1, relief_m: "${relief_m}"}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: "${cell_m}", method: tin}}
  noise: {stage: describe-noise, with: {scales_cells: [1, 2]}, in: {raster: dem.raster}}
"""
    (folder / "quick.yaml").write_text(text)
    return "quick.yaml"


def test_a_run_is_cached_and_opened(pipeline):
    events = []
    run = rockface.run(pipeline, progress=events.append)
    assert {event["event"] for event in events} >= {"planned", "started", "finished", "ended"}
    assert [step.status for step in run.steps] == ["executed"] * 5
    again = rockface.run(pipeline, progress=False)
    assert (run.computed, again.computed, again.cached) == (5, 0, 5)
    assert rockface.open("latest").folder == again.folder
    assert rockface.open(again.folder).name == "quick"
    assert rockface.open("quick").folder == rockface.open("quick~0").folder == again.folder
    other = rockface.run(pipeline, seed=8, progress=False)
    assert rockface.open("quick").folder == other.folder
    assert rockface.open("quick~1").folder == rockface.open("latest~1").folder == again.folder
    with pytest.raises(rockface.RockfaceError, match="none is 2 before"):
        rockface.open("quick~2")
    assert run.outputs()[:2] == ["face.mesh", "dem.raster"]
    assert "dem.raster" in run


def test_the_table_of_a_sweep_is_tidy(pipeline):
    run = rockface.run(pipeline, sweep={"cell_m": np.array([0.1, 0.15, 0.2])}, set={"params.relief_m": 0.2}, progress=False)
    table = run.table()
    assert list(table["cell_m"]) == [0.1, 0.15, 0.2]
    metrics = {step.label: step.metrics for step in run.steps}
    for row in table:
        assert row["face.relief_rms"] == metrics["face"]["relief_rms"]
        assert row["dem.columns"] == metrics[f"dem[cell_m={row['cell_m']:g}]"]["columns"]
    assert table.units["face.relief_rms"] == "m"
    assert len(set(table["dem.columns"])) == 3


def test_the_table_of_a_design_has_its_values(tmp_path):
    path = tmp_path / "design.yaml"
    path.write_text("""
rockface: 1
seed: 1
axes: {p: {sample: grid, count: 2, over: {cell_m: [0.1, 0.2]}}}
steps:
  face: {stage: synthesise-face, with: {width_m: 2, height_m: 2, spacing_m: 0.1}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: '${p.cell_m}', method: tin}}
""")
    table = rockface.run(path, progress=False).table("p")
    assert table.columns[:2] == ["p", "p.cell_m"]
    assert list(table["p.cell_m"]) == [0.1, 0.2]
    assert len(set(table["dem.columns"])) == 2


def test_texts_arrive_as_they_are(tmp_path):
    path = tmp_path / "texts.yaml"
    path.write_text(
        "rockface: 1\nparams: {t: {type: text, default: x}}\nsteps:\n"
        "  read: {stage: import-table, with: {path: t.csv}}\n"
        '  made: {stage: tabulate, in: {rows: read.table}, with: {constants: {t: "${t}"}}}\n'
    )
    (tmp_path / "t.csv").write_text("a\n1\n")
    rockface.run(path, progress=False)
    for text in ["a #b", "", "1.0", " lead", "007", "null", 'a "b"', "ü"]:
        told = rockface.explain(path, "made", set={"params.t": text})
        assert told.recipe["params"]["constants"]["t"] == text
    points = rockface.plan(path, sweep={"params.t": ["a", "b c", "1.0"]})
    assert [step.point["t"] for step in points if step.step == "made"] == ["a", "b c", "1.0"]
    with pytest.raises(rockface.PipelineError, match="cannot be an item"):
        rockface.plan(path, sweep={"params.t": ["a", "b,c"]})


def test_outputs_at_several_points(pipeline):
    run = rockface.run(pipeline, progress=False)
    dems = run["dem"]
    assert [point["cell_m"] for point in dems.points] == ["0.1", "0.2"]
    assert dems.at(cell_m=0.1).grid.cell_m == run["dem[cell_m=0.1].raster"].grid.cell_m == 0.1
    joined = run["noise.features"].table()
    assert list(joined["cell_m"]) == [0.1, 0.2]
    with pytest.raises(KeyError, match="there are dem"):
        run["dem.raster[cell_m=7]"]
    with pytest.raises(KeyError, match="has the outputs raster"):
        run["dem.rastr"]
    with pytest.raises(KeyError, match=r"dem\.raster"):
        run["dam.raster"]


def test_plan_and_explain(pipeline):
    assert {step.answer for step in rockface.plan(pipeline)} == {"runs", "depends"}
    run = rockface.run(pipeline, progress=False)
    assert {step.answer for step in run.plan()} == {"hit"}
    told = rockface.explain(pipeline, "dem[cell_m=0.1]", set={"params.relief_m": 0.3})
    assert "params.relief_m" in str(told)
    assert "0.3" in str(told)
    assert run.explain("face").answer == "hit"


def test_a_shipped_pipeline_needs_no_file(folder):
    assert "verdict" in {step.step for step in rockface.plan("rockface/quickstart")}
    with pytest.raises(rockface.PipelineError, match="did you mean `quickstart`"):
        rockface.plan("quickstrat")


def test_a_wrong_pipeline_names_the_place(folder):
    (folder / "bad.yaml").write_text("rockface: 1\nsteps:\n  a: {stage: synthesise-fase}\n")
    with pytest.raises(rockface.PipelineError, match=r"(?s)bad\.yaml:3:.*synthesise-face"):
        rockface.run("bad.yaml", progress=False)


def test_a_failed_step_is_named_and_the_rest_is_there(folder):
    text = """
rockface: 1
name: failing
steps:
  face: {stage: synthesise-face, with: {width_m: 4, height_m: 3, spacing_m: 0.1}}
  tool: {stage: command, with: {program: sh, args: ["-c", "echo cannot >&2; exit 3"], outputs: {a: file}, version: "1"}}
"""
    (folder / "failing.yaml").write_text(text)
    with pytest.raises(rockface.StepError, match="ended with code 3") as caught:
        rockface.run("failing.yaml", keep_going=True, progress=False)
    assert [failure.step for failure in caught.value.failures] == ["tool"]
    assert len(caught.value.run["face.mesh"].vertices) > 100
    assert "ended with code 3" in caught.value.run._repr_html_()


def test_an_interrupt_stops_the_run_and_keeps_what_is_finished(folder):
    text = """
rockface: 1
name: long
steps:
  face: {stage: synthesise-face, with: {width_m: 4, height_m: 3, spacing_m: 0.1}}
  wait:
    stage: command
    with: {program: sleep, args: ["600"], inputs: {mesh: mesh}, outputs: {a: file}, version: "1"}
    in: {mesh: face.mesh}
"""
    (folder / "long.yaml").write_text(text)

    def interrupt(event):
        if event.get("event") == "started" and event["step"] == "wait":
            threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT)).start()

    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        rockface.run("long.yaml", progress=interrupt)
    assert time.monotonic() - begun < 300
    assert next(step.answer for step in rockface.plan("long.yaml") if step.step == "face") == "hit"


def test_the_head_of_a_run_is_html(small):
    shown = small._repr_html_()
    assert "small" in shown
    assert "report.html" in shown
    assert "data:image/png" in shown


def test_an_output_without_a_name_comes_from_the_store(folder):
    (folder / "small.yaml").write_text(SMALL)
    run = rockface.run("small.yaml", targets=["table"], outputs="targets", progress=False)
    assert not any(step.paths for step in run.steps if step.step == "left")
    assert run["left.depth"].shape == (350, 450)


def test_axes_have_to_be_named_where_several_are_possible(small):
    with pytest.raises(rockface.RockfaceError, match="no step depends on"):
        small.table("epok")
    assert list(small.table("sigma_px")["sigma_px"]) == [0.4, 0.8]
    assert len(small.table("epoch", "sigma_px")) == 4


def test_items_are_numbers_only_where_all_of_their_axis_are(folder):
    text = """
rockface: 1
name: items
axes:
  day: {items: ["2024_05", "007", "nan", "Nobbys Head", "1e3"]}
  trial: {count: 2}
  cell_m: {values: [0.1, 0.25]}
steps:
  face: {stage: synthesise-face, over: [day, trial], with: {width_m: 2, height_m: 2, spacing_m: 0.2}}
  dem: {stage: rasterise-dem, with: {cell_m: "${cell_m}", method: tin}, in: {surface: face.mesh}}
"""
    (folder / "items.yaml").write_text(text)
    run = rockface.run("items.yaml", progress=False)
    table = run.table("day", "trial", "cell_m")
    assert set(table["day"]) == {"2024_05", "007", "nan", "Nobbys Head", "1e3"}
    row = table[3]
    assert (row["trial"], row["cell_m"]) == (1, 0.25)
    for row in table:
        picked = run[f"dem.raster[day={row['day']}, trial={row['trial']}, cell_m={row['cell_m']}]"]
        assert picked.grid.cell_m == row["cell_m"]
    # As a column of floats gives them.
    assert run["dem.raster[day=007,trial=1.0,cell_m=0.250]"].grid.cell_m == 0.25
    assert run["face.mesh[day=Nobbys Head,trial=0]"].frame == rockface.Frame.WALL
    with pytest.raises(KeyError, match="name one"):
        run.path("face.mesh[day=007]")


def test_numbers_are_items_however_they_are_written(folder):
    text = """
rockface: 1
name: numbers
axes: {cell_m: {values: [.05, 1., 1E-1, +0.2]}}
steps:
  face: {stage: synthesise-face, with: {width_m: 2, height_m: 2, spacing_m: 0.2}}
  dem: {stage: rasterise-dem, with: {cell_m: "${cell_m}", method: tin}, in: {surface: face.mesh}}
"""
    (folder / "numbers.yaml").write_text(text)
    run = rockface.run("numbers.yaml", progress=False)
    assert list(run.table("cell_m")["cell_m"]) == [0.05, 1, 0.1, 0.2]
    assert run["dem.raster"].at(cell_m=0.05).grid.cell_m == 0.05
    empty = run["dem.raster"][4:]
    assert len(empty) == 0
    assert "no point" in repr(empty)
    with pytest.raises(KeyError, match="there are no points"):
        empty.at(cell_m=1)


def test_the_axes_of_a_swept_value_of_a_step_are_known(folder, pipeline):
    run = rockface.run(pipeline, sweep={"steps.face.with.relief_m": [0.1, 0.2]}, progress=False)
    assert run.table().columns[0] == "swept_relief_m"
    assert len(run.table()) == 2


def test_warnings_are_in_the_run_and_shown(folder, capsys):
    text = """
rockface: 1
name: warned
steps:
  face: {stage: synthesise-face, with: {width_m: 4, height_m: 3, spacing_m: 0.1}}
  dem: {stage: rasterise-dem, with: {cell_m: 0.02}, in: {surface: face.mesh}}
"""
    (folder / "warned.yaml").write_text(text)
    run = rockface.run("warned.yaml")
    assert len(run.warnings) == 1
    assert run.warnings[0].startswith("dem: ")
    assert "warning: dem: " in capsys.readouterr().err
    assert "warning: dem: " in run._repr_html_()
    assert rockface.open("latest").warnings == run.warnings


def test_runs_beside_pipelines_in_folders_are_found(folder, monkeypatch):
    (folder / "sub").mkdir()
    for place in ("mein Lauf.yaml", "sub/mein Lauf.yaml"):
        (folder / place).write_text("{rockface: 1, name: b, steps: {face: {stage: synthesise-face, with: {spacing_m: 0.5}}}}")
    first = rockface.run("mein Lauf.yaml", progress=False)
    time.sleep(0.05)
    second = rockface.run("sub/mein Lauf.yaml", seed=3, store="st", progress=False)
    assert rockface.open("latest").folder == rockface.open("b").folder == second.folder
    assert rockface.open("sub/mein Lauf.yaml").folder == second.folder
    assert rockface.open("mein Lauf.yaml").folder == first.folder
    assert rockface.open("latest~1").folder == first.folder
    assert rockface.open("latest-b").folder == second.folder
    assert rockface.open("latest-b~0").folder == second.folder
    third = rockface.run("sub/mein Lauf.yaml", seed=5, store="st", progress=False)
    assert rockface.open("sub/mein Lauf.yaml~1").folder == rockface.open("b~1").folder == second.folder
    with pytest.raises(rockface.RockfaceError, match="has 2 runs here"):
        rockface.open("sub/mein Lauf.yaml~2")
    # What was asked for again is the last one.
    time.sleep(0.05)
    assert rockface.run("sub/mein Lauf.yaml", seed=3, store="st", progress=False).folder == second.folder
    assert rockface.open("sub/mein Lauf.yaml").folder == second.folder != third.folder
    none = rockface.run("mein Lauf.yaml", outputs="none", store="st", runs="ru", seed=4, progress=False)
    monkeypatch.chdir(folder / "sub")
    assert len(none["face.mesh"].vertices) > 0


def test_an_output_that_was_not_kept_is_an_error_of_the_store(folder):
    text = "{rockface: 1, name: lost, steps: {face: {stage: synthesise-face, keep: false, with: {spacing_m: 0.5}}, "
    text += "dem: {stage: rasterise-dem, with: {cell_m: 0.5}, in: {surface: face.mesh}}}}"
    (folder / "lost.yaml").write_text(text)
    run = rockface.run("lost.yaml", progress=False)
    with pytest.raises(rockface.StoreError, match="not kept"):
        run["face.mesh"]


def test_a_file_that_is_not_the_output_gives_way_to_the_store(folder):
    text = "{rockface: 1, name: changed, steps: {face: {stage: synthesise-face, with: {spacing_m: 0.5}}, "
    text += "dem: {stage: rasterise-dem, with: {cell_m: 0.5}, in: {surface: face.mesh}}}}"
    (folder / "changed.yaml").write_text(text)
    run = rockface.run("changed.yaml", progress=False)
    true = run["dem.raster"].values
    file = run.path("dem.raster")
    other = bytearray(file.read_bytes())
    other[len(other) // 2] ^= 1
    file.unlink()
    file.write_bytes(other)
    np.testing.assert_array_equal(rockface.open(run.folder)["dem.raster"].values, true)
    with pytest.raises(rockface.StoreError, match=r"raster.tif is not the output dem.raster.*takes it from the store"):
        run.path("dem.raster")
    shutil.rmtree(folder / ".rockface" / "store")
    with pytest.raises(rockface.StoreError, match="is not the output"):
        run["dem.raster"]


def test_inventories_of_all_points_are_one_table(folder):
    text = """
rockface: 1
name: falls
axes: {epoch: {count: 2}, kind: {items: [event, quiet]}}
steps:
  face: {stage: synthesise-face, with: {width_m: 4, height_m: 3, spacing_m: 0.1}}
  blocks: {stage: generate-blocks, over: [epoch]}
  fallen: {stage: remove-blocks, with: {count: 2, min_volume_m3: 0.002}, in: {mesh: face.mesh, blocks: blocks.blocks}}
  nothing: {stage: select-features, with: {count: 0}, in: {inventory: fallen.truth}}
  truth: {stage: select-features, in: {inventory: {by: kind, event: fallen.truth, quiet: nothing.inventory}}}
"""
    (folder / "falls.yaml").write_text(text)
    run = rockface.run("falls.yaml", progress=False)
    table = run["truth.inventory"].table()
    assert table.columns[:2] == ["epoch", "kind"]
    assert set(table["kind"]) == {"event"}
    assert set(table["epoch"]) == {0, 1}
    assert (table["removed_m3"] >= 0.002).all()
    empty = run["nothing.inventory"].table()
    assert len(empty) == 0
    assert "removed_m3" in empty.columns
    with pytest.raises(rockface.RockfaceError, match="neither a table nor an inventory"):
        run["fallen.mesh"].table()


def test_a_damaged_manifest_hides_no_other_run(pipeline):
    run = rockface.run(pipeline, progress=False)
    for number, text in enumerate(["[]", '{"format": 1}', '{"format": 1, "finished": "x"}', "{"]):
        folder = run.folder.parent / f"2026-01-01T00000{number}Z-bad-0000000{number}"
        folder.mkdir()
        (folder / "run.json").write_text(text)
        with pytest.raises(rockface.RockfaceError):
            rockface.open(folder.name)
    for name in ("latest", "quick", "quick.yaml", run.folder.name, run.folder.name[-8:]):
        assert rockface.open(name).folder == run.folder


def test_warnings_are_no_commands_to_a_terminal():
    from rockface.running import printable

    assert printable("ü\ta\x1b[2Jb\u202ec\x9b") == "ü\ta\\u001b[2Jb\\u202ec\\u009b"


def test_an_error_comes_out_of_a_pool_as_it_was():
    import pickle

    failures = [rockface.StepFailure("own", "python", "it broke", "mend it")]
    back = pickle.loads(pickle.dumps(rockface.StepError(failures)))
    assert (str(back), back.failures) == (str(rockface.StepError(failures)), failures)


def test_a_manifest_of_a_stranger_shows_no_file_of_mine(folder, small):
    import json

    run = folder / "runs" / "got"
    shutil.copytree(small.folder, run)
    (folder / "secret").write_text("key")
    manifest = json.loads((run / "run.json").read_text())
    step = next(step for step in manifest["steps"] if step["step"] == "picture")
    (run / "link.png").symlink_to(folder / "secret")
    for path in (str(folder / "secret"), "../../secret", "link.png"):
        step["paths"] = {"picture": path}
        (run / "run.json").write_text(json.dumps(manifest))
        with pytest.raises(rockface.RockfaceError, match="leads out of the run folder"):
            rockface.Run(run)[f"picture.picture[sigma_px={step['point']['sigma_px']}]"]


def test_a_sweep_of_an_axis_that_no_step_depends_on_alone_gives_the_whole_table(tmp_path):
    path = tmp_path / "p.yaml"
    face = "{stage: synthesise-face, over: [trial], with: {width_m: 8, height_m: 6, spacing_m: 0.1}}"
    dem = "{stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: 0.1, method: tin}}"
    noise = "{stage: describe-noise, with: {scales_cells: [1, 2]}, in: {raster: dem.raster}}"
    path.write_text(
        f"rockface: 1\nseed: 1\naxes: {{trial: {{count: 2}}}}\nsteps:\n  face: {face}\n  dem: {dem}\n  noise: {noise}\n"
    )
    run = rockface.run(path, sweep={"steps.dem.with.cell_m": [0.1, 0.2]}, progress=False)
    assert run.table().columns[:2] == ["trial", "cell_m"] or run.table().columns[:2] == ["cell_m", "trial"]
    assert len(run.table()) == 4
