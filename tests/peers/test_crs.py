"""Coordinate reference systems: what goes in with one comes out with it, and everything else has its sentence."""

import json
import subprocess

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

from conftest import HERE, execute

laspy = pytest.importorskip("laspy", reason="laspy cannot be imported", exc_type=ImportError)
pyproj = pytest.importorskip("pyproj", reason="pyproj cannot be imported", exc_type=ImportError)
geopandas = pytest.importorskip("geopandas", reason="geopandas cannot be imported", exc_type=ImportError)

UTM = (451_234.0, 5_512_345.0, 231.0)


def cliff(corner, metres=1.0):
    """Points of a cliff of 6 x 4 m that faces south-east, in units of so many metres."""
    along, up = (axis.ravel() for axis in np.meshgrid(np.linspace(0, 6, 121), np.linspace(0, 4, 81)))
    relief = 0.1 * np.sin(2 * along) * np.cos(3 * up) + 0.02 * np.sin(11 * along + 7 * up)
    plane = along[:, None] * [0.8, 0.6, 0] + up[:, None] * [0, 0, 1] + relief[:, None] * [0.6, -0.8, 0]
    return np.array(corner) + plane / metres


def write_las(path, points, crs=None, version="1.4", keys=None):
    header = laspy.LasHeader(version=version, point_format=6 if version == "1.4" else 1)
    header.offsets, header.scales = np.floor(points.min(axis=0)), [1e-5] * 3
    if np.abs(points).max() < 360:
        header.scales = [1e-9, 1e-9, 1e-4]
    if crs is not None:
        header.add_crs(pyproj.CRS.from_user_input(crs))
    if keys is not None:
        words = np.array([1, 1, 0, len(keys), *np.array(keys).ravel()], "<u2")
        header.vlrs.append(laspy.VLR("LASF_Projection", 34735, record_data=words.tobytes()))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    las.write(path)
    return path


def write_raster(path, crs, corner=UTM, cell=0.5, values=None):
    values = np.arange(12, dtype="float32").reshape(3, 4) + 200 if values is None else values
    profile = {"driver": "GTiff", "width": 4, "height": 3, "count": 1, "dtype": "float32", "crs": crs}
    with rasterio.open(path, "w", transform=from_origin(corner[0], corner[1], cell, cell), **profile) as file:
        file.write(values, 1)
    return path


def write_outlines(path, crs, corner=UTM):
    x, y, _ = corner
    frame = geopandas.GeoDataFrame({"v": [1.5]}, geometry=geopandas.GeoSeries.from_wkt([f"POLYGON(({x} {y},{x + 2} {y},{x} {y + 1},{x} {y}))"]))
    frame.set_crs(crs).to_file(path, driver="GeoJSON")
    return path


def given(work, **files):
    return [word for name, path in files.items() for word in ("--set", f"params.{name}={path}")]


@pytest.fixture(scope="module")
def run(binary, tmp_path_factory):
    work = tmp_path_factory.mktemp("crs")
    files = {
        "scan": write_las(work / "scan.laz", cliff(UTM), "EPSG:32633"),
        "real": write_raster(work / "real.tif", "EPSG:32633"),
        "found": write_outlines(work / "found.geojson", "EPSG:32633"),
    }
    return execute(binary, HERE / "crs.yaml", work, *given(work, **files))


def to_world(run):
    told = json.loads(run.output("wall", "transform.json").read_text())
    rotation, origin = np.array(told["rotation"]), np.array(told["origin"])
    return lambda points: (points - told["translation"]) @ rotation + origin


def test_clouds_rasters_and_outlines_have_the_system(run):
    las = laspy.read(run.output("cells", "cloud.laz"))
    assert las.header.global_encoding.wkt and las.header.parse_crs().to_epsg() == 32633
    for step in ["map", "real"]:
        with rasterio.open(run.output(step, "raster.tif")) as file:
            assert file.crs.to_epsg() == 32633, step
    assert geopandas.read_file(run.output("found", "inventory.geojson")).crs.to_epsg() == 32633
    told = json.loads(run.output("wall", "transform.json").read_text())
    assert told["crs"] == "EPSG:32633"
    header = run.output("mesh", "mesh.ply").read_bytes()[:600].decode("ascii", "replace")
    assert 'comment rockface georeference {"crs":"EPSG:32633"}' in header


def test_inspect_says_what_files_of_others_state(run, binary):
    def told(name):
        file = run.folder / "../.." / name
        done = subprocess.run([binary, "inspect", file, "--json"], capture_output=True, text=True, check=True)
        return json.loads(done.stdout)

    raster, scan = told("real.tif"), told("scan.laz")
    assert (raster["frame"], raster["system"]) == ("world", "WGS 84 / UTM zone 33N, EPSG:32633")
    assert scan["system"].startswith("WGS 84 / UTM zone 33N") and "import-cloud" in scan["kind"]
    x = np.asarray(laspy.read(run.folder / "../../scan.laz").x)
    np.testing.assert_allclose([scan["x"]["min"], scan["x"]["max"]], [x.min(), x.max()], atol=1e-3)


def test_coordinates_are_those_of_the_input_to_a_millimetre(run):
    with rasterio.open(run.output("real", "raster.tif")) as ours, rasterio.open(run.folder / "../../real.tif") as theirs:
        assert ours.transform.almost_equals(theirs.transform, 1e-6)
        np.testing.assert_allclose(ours.read(1), theirs.read(1), atol=1e-3)
    bounds = geopandas.read_file(run.output("found", "inventory.geojson")).total_bounds
    np.testing.assert_allclose(bounds, [UTM[0], UTM[1], UTM[0] + 2, UTM[1] + 1], atol=1e-3)
    # The mesh of the scan has points of the scan.
    las = np.round(np.asarray(laspy.read(run.folder / "../../scan.laz").xyz) - UTM, 3)
    body = run.output("scan", "mesh.ply").read_bytes()
    header, body = body.split(b"end_header\n", 1)
    count = int(header.split(b"element vertex ")[1].split()[0])
    mesh = np.frombuffer(body[: 24 * count], "<f8").reshape(-1, 3)
    known = set(map(tuple, las + 0.0))
    assert np.mean([tuple(point) in known for point in np.round(mesh - UTM, 3) + 0.0]) == 1


def test_a_wall_raster_leads_back_to_the_map_by_its_own_tag(run):
    """The documented step, by GDAL alone: the item GEOREFERENCE of the file takes its cells to the map."""
    with rasterio.open(run.output("dem", "raster.tif")) as file:
        assert not file.crs.is_projected and not file.crs.is_geographic
        georeference = json.loads(file.tags()["GEOREFERENCE"])
        z = file.read(1)
        rows, columns = np.nonzero(np.isfinite(z))
        x, y = file.transform @ (columns + 0.5, rows + 0.5)
    assert pyproj.CRS(georeference["crs"]).to_epsg() == 32633
    way = georeference["wall_from_world"]
    wall = np.stack([x, y, z[rows, columns]], axis=1)
    world = (wall - way["translation"]) @ np.array(way["rotation"]) + way["origin"]
    np.testing.assert_allclose(world, to_world(run)(wall), atol=1e-9)
    cells = np.asarray(laspy.read(run.output("cells", "cloud.laz")).xyz)
    np.testing.assert_allclose(world, cells, atol=1e-3)
    # They lie on the cliff that was scanned, blocks of some centimetres aside.
    depth = (world - UTM) @ [0.6, -0.8, 0]
    assert np.quantile(np.abs(depth), 0.95) < 0.2


def test_inspect_says_the_way_to_the_map_as_proj_reads_it(binary, run):
    command = [binary, "inspect", run.output("dem", "raster.tif"), "--json"]
    facts = json.loads(subprocess.run(command, capture_output=True, text=True, check=True, timeout=120).stdout)
    assert (facts["frame"], facts["crs of the world"]) == ("wall", "EPSG:32633")
    way = pyproj.Transformer.from_pipeline(facts["to the map (PROJ)"])
    wall = np.random.default_rng(3).uniform(-4, 4, (50, 3))
    np.testing.assert_allclose(np.stack(way.transform(*wall.T), axis=1), to_world(run)(wall), atol=1e-6)


def test_rockfalls_have_their_places_on_the_map(run):
    table = geopandas.read_file(run.output("fallen", "truth.csv"))
    names = [f"centroid{frame}_{axis}_m" for frame in ("_world", "") for axis in "xyz"]
    places = table[names].astype(float).to_numpy()
    np.testing.assert_allclose(places[:, :3], to_world(run)(places[:, 3:]), atol=1e-3)
    depth = (places[:, :3] - UTM) @ [0.6, -0.8, 0]
    assert len(places) == 3 and np.abs(depth).max() < 0.8


def test_an_exported_raster_is_cloud_optimised_and_keeps_its_place(binary, run, tmp_path):
    cogeo = pytest.importorskip("rio_cogeo", reason="rio_cogeo cannot be imported")
    for step, is_on_map in [("map", True), ("dem", False)]:
        file = tmp_path / f"{step}.tif"
        command = [binary, "export", run.folder, f"{step}.raster", file]
        subprocess.run(command, capture_output=True, check=True, timeout=120)
        is_valid, errors, _ = cogeo.cog_validate(file, strict=True, quiet=True)
        assert is_valid, errors
        with rasterio.open(file) as ours, rasterio.open(run.output(step, "raster.tif")) as kept:
            assert ours.transform == kept.transform and (ours.crs.to_epsg() == 32633) == is_on_map
            np.testing.assert_array_equal(ours.read(), kept.read())


def told(binary, work, text, code=1):
    pipeline = work / "one.yaml"
    pipeline.write_text(f"rockface: 1\nname: one\nseed: 1\nsteps:\n{text}\n")
    command = [binary, "run", pipeline, "--store", work / "store", "--runs", work / "runs"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == code or (code and done.returncode), done.stdout + done.stderr
    return " ".join((done.stdout + done.stderr).split())


def test_feet_become_metres_at_the_same_place_on_the_earth(binary, tmp_path):
    foot = 1200 / 3937
    points = cliff((1_200_000.0, 650_000.0, 800.0), foot)
    write_las(tmp_path / "feet.las", points, "EPSG:2927")
    said = told(
        binary,
        tmp_path,
        "  scan: {stage: import-cloud, with: {path: feet.las, outward: [0.6, -0.8, 0]}}\n"
        "  cloud: {stage: export-cloud, in: {points: scan.mesh}}\n"
        "  dem: {stage: rasterise-dem, in: {surface: scan.mesh}, with: {cell_m: 0.1, method: tin}}",
        code=0,
    )
    assert "is in US survey feet (0.3048006096012192 m)" in said and "converted to metres" in said
    outputs = tmp_path / "runs/latest/outputs"
    las = laspy.read(outputs / "cloud/cloud.laz")
    crs = las.header.parse_crs()
    assert crs.to_epsg() is None or crs.to_epsg() != 2927
    assert {axis.unit_name for axis in crs.axis_info} == {"metre"}
    for system in (crs, rasterio.open(outputs / "dem/raster.tif").crs):
        back = pyproj.Transformer.from_crs(pyproj.CRS.from_user_input(system.to_wkt()), "EPSG:2927", always_xy=True)
        x, y = back.transform(las.x, las.y)
        found = np.stack([x, y, np.asarray(las.z) / foot], axis=1) * foot
        order = np.lexsort(np.round(found, 3).T)
        expected = points * foot
        expected = expected[np.lexsort(np.round(expected, 3).T)]
        if len(found) == len(expected):
            np.testing.assert_allclose(found[order], expected, atol=1e-3)
        np.testing.assert_allclose(found.mean(axis=0), expected.mean(axis=0), atol=2e-2)


@pytest.mark.parametrize(("keys", "name"), [([[1024, 0, 1, 1], [3072, 0, 1, 32633], [3076, 0, 1, 9002]], "international feet")])
def test_keys_of_older_files_are_read(binary, tmp_path, keys, name):
    write_las(tmp_path / "old.las", cliff(UTM), version="1.2", keys=keys)
    said = told(binary, tmp_path, "  scan: {stage: import-cloud, with: {path: old.las, outward: [0.6, -0.8, 0]}}", code=0)
    assert f"EPSG:32633 in {name} states: converted to metres" in said


def test_degrees_and_geocentric_coordinates_are_refused_with_the_way_out(binary, tmp_path):
    write_raster(tmp_path / "degrees.tif", "EPSG:4326", corner=(14.3, 49.8, 0), cell=1e-5)
    said = told(binary, tmp_path, "  real: {stage: import-rasters, with: {path: degrees.tif}}")
    assert "longitudes and latitudes in degrees" in said and "gdalwarp -t_srs EPSG:32633 degrees.tif out.tif" in said
    write_las(tmp_path / "degrees.las", cliff((14.3, 49.8, 231.0), 1e5), "EPSG:4326")
    said = told(binary, tmp_path, "  scan: {stage: import-cloud, with: {path: degrees.las}}")
    assert "filters.reprojection.out_srs=EPSG:32633" in said
    write_las(tmp_path / "ecef.las", cliff((3_970_000.0, 1_020_000.0, 4_870_000.0)), "EPSG:4978")
    said = told(binary, tmp_path, "  scan: {stage: import-cloud, with: {path: ecef.las}}")
    assert "from the centre of the Earth" in said and "EPSG:32633" in said
    write_outlines(tmp_path / "plain.geojson", None if False else "EPSG:4326", corner=(14.3, 49.8, 0))
    said = told(binary, tmp_path, "  found: {stage: import-inventory, with: {path: plain.geojson}}")
    assert "degrees" in said and "ogr2ogr" in said


def test_two_systems_in_one_step_are_a_fault(binary, tmp_path):
    write_raster(tmp_path / "a.tif", "EPSG:32633")
    write_raster(tmp_path / "b.tif", "EPSG:25833")
    said = told(binary, tmp_path, "  real: {stage: import-rasters, with: {path: '*.tif', quantity: elevation}}")
    assert "two coordinate reference systems in one step" in said and "gdalwarp" in said
    said = told(
        binary,
        tmp_path,
        "  a: {stage: import-rasters, with: {path: a.tif, quantity: elevation}}\n"
        "  b: {stage: import-rasters, with: {path: b.tif, quantity: elevation}}\n"
        "  d: {stage: difference-dem, in: {reference: a.raster, comparison: b.raster}}",
    )
    assert "`reference` is in EPSG:32633, but `comparison` in EPSG:25833" in said
    said = told(binary, tmp_path, "  a: {stage: import-rasters, with: {path: a.tif, crs: EPSG:28356}}")
    assert "two coordinate reference systems for `a.tif`" in said


def test_a_missing_system_is_stated_by_a_prj_or_a_parameter(binary, tmp_path):
    points = cliff(UTM)
    np.savetxt(tmp_path / "scan.xyz", points, fmt="%.4f")
    step = "  scan: {stage: import-cloud, with: {path: scan.xyz, outward: [0.6, -0.8, 0]%s}}\n  c: {stage: export-cloud, in: {points: scan.mesh}}"
    system = lambda: laspy.read(tmp_path / "runs/latest/outputs/c/cloud.laz").header.parse_crs()
    told(binary, tmp_path, step % "", code=0)
    assert system() is None
    said = told(binary, tmp_path, step % ", crs: EPSG:28356", code=0)
    assert system().to_epsg() == 28356, said
    # What ESRI writes has no code; adding the file beside the scan is noticed.
    (tmp_path / "scan.prj").write_text(pyproj.CRS("EPSG:32633").to_wkt("WKT1_ESRI"))
    told(binary, tmp_path, step % "", code=0)
    assert system().to_epsg() == 32633
    said = told(binary, tmp_path, step % ", crs: EPSG:28356")
    assert "the `.prj` beside `scan.xyz` states" in said
    said = told(binary, tmp_path, step % ", crs: EPSG:4326")
    assert "a system in metres is needed" in said
