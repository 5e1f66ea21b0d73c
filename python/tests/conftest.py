"""Pipelines small enough for tests, run by the real program into temporary folders."""

import os
from pathlib import Path

import pytest

CLONE = Path(__file__).resolve().parents[2]

SMALL = """
rockface: 1
name: small
seed: 1
axes:
  epoch: {items: [pre, post]}
  sigma_px: {values: [0.4, 0.8]}
steps:
  face: {stage: synthesise-face, with: {width_m: 4, height_m: 3, spacing_m: 0.05}}
  survey:
    stage: plan-survey
    with: {width_px: 450, height_px: 350, focal_px: 1450, distance_m: 20, baseline_m: 7}
    in: {mesh: face.mesh}
  pairs: {stage: select-pairs, in: {cameras: survey.cameras, mesh: face.mesh}}
  errors: {stage: estimate-covariance, in: {cameras: survey.cameras, mesh: face.mesh}}
  left: {stage: project-depth, with: {image: left, channels: true}, in: {mesh: face.mesh, cameras: survey.cameras}}
  right: {stage: project-depth, with: {image: right}, in: {mesh: face.mesh, cameras: survey.cameras}}
  zone: {stage: mask-safe-zone, with: {offset_m: 0.3}, in: {mesh: face.mesh}}
  blocks: {stage: generate-blocks}
  rockfall:
    stage: remove-blocks
    with: {count: 2, min_depth_m: 0.03}
    in: {mesh: face.mesh, blocks: blocks.blocks, zone: zone.zone}
  matched:
    stage: match-pair
    over: [epoch]
    with: {sigma_local_px: "${sigma_px}"}
    in: {first: left.depth, second: right.depth, noisy: survey.cameras, pairs: pairs.pairs}
  surface: {stage: fuse-depth, in: {depth: matched.depth}}
  cloud: {stage: export-cloud, in: {points: "surface.surface[epoch=pre]"}}
  align: {stage: register-icp, in: {source: "surface.surface[epoch=post]", target: "surface.surface[epoch=pre]"}}
  dem: {stage: rasterise-dem, with: {cell_m: 0.05, window_m: [-1.5, 1.5, -1, 1]}, in: {surface: surface.surface}}
  change: {stage: difference-dem, in: {reference: "dem.raster[epoch=pre]", comparison: "dem.raster[epoch=post]"}}
  noise: {stage: describe-noise, with: {scales_cells: [1, 2, 4]}, in: {raster: change.raster}}
  picture: {stage: draw-picture, in: {subject: change.raster}}
  table: {stage: tabulate, in: {rows: {each: noise.features, over: [sigma_px]}}}
"""


def pytest_configure(config):
    """Without another word the tests use the program of this clone."""
    if "ROCKFACE_BIN" not in os.environ:
        built = [CLONE / "target" / profile / "rockface" for profile in ("release", "debug")]
        newest = max((path for path in built if path.is_file()), key=lambda path: path.stat().st_mtime, default=None)
        if newest is None:
            pytest.exit("no program: build it (cargo build), or name it in ROCKFACE_BIN", 2)
        os.environ["ROCKFACE_BIN"] = str(newest)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def small(tmp_path_factory):
    """A run of SMALL with every kept output named."""
    import rockface

    place = tmp_path_factory.mktemp("small")
    (place / "small.yaml").write_text(SMALL)
    return rockface.run(place / "small.yaml", outputs="all", progress=False)
