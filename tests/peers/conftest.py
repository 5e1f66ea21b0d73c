"""Runs our pipelines once into temporary stores and hands their run folders to the tests."""

import json
import os
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent


class Run:
    """The folder of a finished run: its manifest, its log, its outputs."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.manifest = json.loads((folder / "run.json").read_text())

    def output(self, step: str, file: str, point: str = "") -> Path:
        """The file of a step, `point` as in `epoch=pre`."""
        return self.folder / "outputs" / step / point / file


def execute(binary: Path, pipeline: Path, work: Path, *more: str) -> Run:
    """Runs a pipeline into a store of its own; fails with what the program said."""
    command = [binary, "run", pipeline, "--quiet", "--store", work / "store", "--runs", work / "runs", *more]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, f"{pipeline.name}: exit code {done.returncode}\n{done.stdout}{done.stderr}"
    return Run((work / "runs" / "latest").resolve())


@pytest.fixture(scope="session")
def binary() -> Path:
    path = Path(os.environ.get("ROCKFACE_BIN", HERE / "../../target/release/rockface")).resolve()
    assert path.is_file(), f"no program at {path}: build it, or name it in ROCKFACE_BIN"
    return path


@pytest.fixture(scope="session")
def survey(binary, tmp_path_factory) -> Run:
    """The run of peers.yaml."""
    return execute(binary, HERE / "peers.yaml", tmp_path_factory.mktemp("survey"))


@pytest.fixture(scope="session")
def quickstart(binary, tmp_path_factory) -> Run:
    """The run of the first pipeline of the README."""
    return execute(binary, HERE / "../../pipelines/quickstart.yaml", tmp_path_factory.mktemp("quickstart"))


@pytest.fixture(scope="session")
def rockfall(binary, tmp_path_factory) -> Run:
    """The run of rockfall.yaml."""
    return execute(binary, HERE / "rockfall.yaml", tmp_path_factory.mktemp("rockfall"))
