"""The notebooks run from the first cell to the last."""

from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, folder):
    nbclient = pytest.importorskip("nbclient")
    nbformat = pytest.importorskip("nbformat")
    pytest.importorskip("matplotlib")
    pytest.importorskip("pandas")
    notebook = nbformat.read(path, as_version=4)
    assert not any(cell.get("outputs") for cell in notebook.cells), "commit notebooks without outputs"
    nbclient.NotebookClient(notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": str(folder)}}).execute()
    shown = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert any("image/png" in output.get("data", {}) for output in shown)
    assert any(
        "data:image/png" in str(output.get("data", {}).get("text/html", "")) or "report.html" in str(output) for output in shown
    )


def test_the_examples_run(folder):
    pytest.importorskip("skimage")
    import rockface

    example = Path(__file__).resolve().parents[1] / "examples" / "own-stages.yaml"
    for name in ("own-stages.yaml", "own_stages.py"):
        (folder / name).write_text((example.parent / name).read_text())
    run = rockface.run("own-stages.yaml", progress=False)
    rates = run["rates.rates"]
    own = [row for row in rates if row["detector"] == "own"]
    assert len(own) == 3
    assert all(row["pooled_precision"] > 0.9 and row["found"] == row["truths"] for row in own)
    noise = run.table("sigma_m", "epoch", "time")
    assert list(noise["noisy.std"]) == pytest.approx(list(noise["sigma_m"]), rel=0.01)


def test_a_noise_of_ones_own_goes_into_the_survey(folder):
    import rockface

    example = Path(__file__).resolve().parents[1] / "examples" / "own-noise.yaml"
    for name in ("own-noise.yaml", "own_stages.py"):
        (folder / name).write_text((example.parent / name).read_text())
    run = rockface.run("own-noise.yaml", progress=False)
    table = run.table("sigma_px")
    none, some, more = table["change/change.std_m"]
    # Without errors of its own the difference has the white noise and the orientation alone.
    assert list(table["sigma_px"]) == [0, 0.3, 0.6]
    assert none * 1.5 < some
    assert some * 1.5 < more
    errors = run["errors.errors[epoch=pre,sigma_px=0.3]"]
    assert "error_px" in errors.channels
    assert errors["error_px"].std() > 0.29
