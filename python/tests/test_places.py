"""Outputs of parts by their names, and where artefacts lie on the Earth."""

import subprocess
from pathlib import Path

import numpy as np
import pytest

import rockface
from rockface import _program

PARTED = """
rockface: 1
name: parted
seed: 1
parts:
  gridded:
    params: {cell_m: {type: number, default: 0.2}}
    in: {face: mesh}
    out: {dem: dem.raster, coarse: "both.raster[k=1]", all: both.raster}
    axes: {k: {values: [1, 2]}}
    steps:
      dem: {stage: rasterise-dem, in: {surface: in.face}, with: {cell_m: "${cell_m}", method: tin}}
      both: {stage: rasterise-dem, over: [k], in: {surface: in.face}, with: {cell_m: 0.4, method: tin}}
axes: {epoch: {items: [pre, post]}}
steps:
  face: {stage: synthesise-face, over: [epoch], with: {width_m: 4, height_m: 3, spacing_m: 0.1}}
  one: {use: gridded, in: {face: face.mesh}}
"""


@pytest.fixture
def parted(folder):
    (folder / "p.yaml").write_text(PARTED)
    return rockface.run("p.yaml", progress=False)


def test_outputs_of_a_part_have_the_names_of_the_pipeline(parted):
    assert len(parted["one.dem"]) == 2
    one = parted["one.dem[epoch=pre]"]
    np.testing.assert_array_equal(one.values, parted["one/dem.raster[epoch=pre]"].values)
    assert parted["one.coarse[epoch=post]"].shape == parted["one/both.raster[epoch=post,k=1]"].shape
    assert len(parted["one.all[epoch=post,one/k=2]"].bands) == 1
    assert "one.dem" in parted
    assert "one.dem" in parted.part_outputs()
    assert "one.dem" not in parted.outputs()
    assert parted.path("one.dem[epoch=pre]") == parted.path("one/dem.raster[epoch=pre]")
    with pytest.raises(KeyError, match=r"part gridded, whose outputs are one\.all, one\.coarse, one\.dem"):
        parted["one.gone"]


def test_the_command_line_takes_them_too(parted, folder):
    def said(*words):
        done = subprocess.run([_program.find(), *words], cwd=folder, capture_output=True, text=True, check=True)
        return done.stdout

    said("export", "latest", "one.dem[epoch=pre]", "dem.tif")
    np.testing.assert_array_equal(rockface.read("dem.tif").values, parted["one.dem[epoch=pre]"].values)
    assert "one/dem[epoch=pre].raster" in said("inspect", "latest", "one.dem[epoch=pre]", "--picture", "never")
    assert "one/dem[epoch=pre]" in said("explain", "p.yaml", "one.dem[epoch=pre]")
    part = next(used for used in parted.manifest["parts"] if used["name"] == "one")
    assert part["outputs"]["coarse"] == "one/both.raster[k=1]"
    assert "blake3" not in part


WORLD = """
rockface: 1
name: world
steps:
  face: {stage: import-mesh, with: {path: face.ply, frame: world, crs: "EPSG:28356"}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: 0.2, method: tin}}
  wall: {stage: transform-crs, in: {mesh: face.mesh}}
  flat: {stage: rasterise-dem, in: {surface: wall.mesh}, with: {cell_m: 0.2, method: tin}}
  cloud: {stage: export-cloud, in: {points: face.mesh}}
  own: {stage: python, with: {module: own.py, function: doubled}, in: {dem: dem.raster, mesh: face.mesh, cloud: cloud.cloud}}
"""

OWN = """
from typing import NamedTuple

import rockface


class Out(NamedTuple):
    dem: rockface.Raster
    mesh: rockface.Mesh
    cloud: rockface.Cloud


@rockface.stage
def doubled(dem: rockface.Raster, mesh: rockface.Mesh, cloud: rockface.Cloud) -> Out:
    assert dem.crs == mesh.crs == cloud.crs == "EPSG:28356"
    return Out(dem.like(dem.values * 2), mesh, cloud)
"""


def write_shifted(mesh, shift, path):
    """Writes a mesh as a PLY file of another program, its vertices shifted."""
    rows = "".join("{:.3f} {:.3f} {:.3f}\n".format(*row) for row in np.add(mesh.vertices, shift))
    faces = "".join("3 {} {} {}\n".format(*row) for row in mesh.triangles)
    header = f"element vertex {len(mesh.vertices)}\n" + "".join(f"property double {axis}\n" for axis in "xyz")
    header += f"element face {len(mesh.triangles)}\nproperty list uchar int vertex_indices\nend_header\n"
    Path(path).write_text("ply\nformat ascii 1.0\n" + header + rows + faces)


def test_coordinate_reference_systems_are_read_shown_and_carried(folder, parted):
    mesh = parted["face.mesh[epoch=pre]"]
    assert mesh.crs is None
    assert mesh.georeference is None
    write_shifted(mesh, [300000, 6000000, 100], "face.ply")
    Path("world.yaml").write_text(WORLD)
    Path("own.py").write_text(OWN)
    run = rockface.run("world.yaml", progress=False)
    for output in ("face.mesh", "dem.raster", "cloud.cloud", "own.dem", "own.mesh", "own.cloud"):
        assert run[output].crs == "EPSG:28356", output
        assert "EPSG:28356" in repr(run[output])
    flat = run["flat.raster"]
    assert flat.crs is None
    assert flat.georeference.crs == "EPSG:28356"
    assert "of EPSG:28356" in repr(flat)
    assert set(flat.georeference.wall_from_world) >= {"rotation", "origin", "translation"}
    assert run["wall.mesh"].georeference == flat.georeference
    # GDAL escapes the metadata of a copy once more.
    shutil = pytest.importorskip("rasterio.shutil")
    for output in ("flat.raster", "dem.raster"):
        shutil.copy(run.path(output), "copied.tif", driver="GTiff")
        copied = rockface.read("copied.tif")
        assert (copied.frame, copied.georeference) == (run[output].frame, run[output].georeference)
    read = "{rockface: 1, name: read, steps: {copied: {stage: import-rasters, with: {path: copied.tif, quantity: elevation}}}}"
    Path("read.yaml").write_text(read)
    assert rockface.run("read.yaml", progress=False)["copied"].crs == "EPSG:28356"
    xarray = pytest.importorskip("xarray")
    assert isinstance(run["dem.raster"].to_xarray(), xarray.DataArray)
    assert run["dem.raster"].to_xarray().attrs["crs"] == "EPSG:28356"


SITE = """
rockface: 1
name: site
steps:
  face: {stage: import-mesh, with: {path: site.ply, frame: world}}
  wall: {stage: transform-crs, in: {mesh: face.mesh}}
  flat: {stage: rasterise-dem, in: {surface: wall.mesh}, with: {cell_m: 0.2, method: tin}}
  own: {stage: python, with: {module: same.py, function: same}, in: {dem: flat.raster, mesh: wall.mesh}}
"""

SAME = """
from typing import NamedTuple

import rockface


class Out(NamedTuple):
    dem: rockface.Raster
    mesh: rockface.Mesh


@rockface.stage
def same(dem: rockface.Raster, mesh: rockface.Mesh) -> Out:
    return Out(dem.like(dem.values), mesh)
"""


def test_a_wall_frame_without_a_system_has_its_way_to_the_world(folder, parted):
    mesh = parted["face.mesh[epoch=pre]"]
    write_shifted(mesh, [30, 60, 10], "site.ply")
    Path("site.yaml").write_text(SITE)
    Path("same.py").write_text(SAME)
    run = rockface.run("site.yaml", progress=False)
    assert run["face.mesh"].georeference is None
    place = run["flat.raster"].georeference
    assert place.crs is None
    assert set(place.wall_from_world) >= {"rotation", "origin", "translation"}
    assert repr(run["flat.raster"]).count("wall frame") == 1
    for output in ("wall.mesh", "own.dem", "own.mesh"):
        assert run[output].georeference == place, output
