"""Every kind of artefact is read as what it is; values are compared with what the program itself reports."""

import json
import os
import subprocess

import numpy as np
import pytest

import rockface
from rockface.files import decode
from rockface.formats import exr, ply


def inspected(path):
    """What the program says of a file."""
    told = subprocess.run([os.environ["ROCKFACE_BIN"], "inspect", path, "--json"], capture_output=True, text=True, check=True)
    return json.loads(told.stdout)


def metric(run, label, name):
    return next(step.metrics[name] for step in run.steps if step.label == label)


def test_every_output_is_read_as_its_kind(small):
    kinds = {
        "raster": rockface.Raster, "depth": rockface.DepthMap, "mesh": rockface.Mesh, "meshes": rockface.Meshes,
        "cloud": rockface.Cloud, "surface": rockface.Surface, "cameras": rockface.Cameras, "pairs": rockface.Pairs,
        "transform": rockface.Transform, "covariance": rockface.Covariance, "table": rockface.Table,
        "inventory": rockface.Inventory, "picture": rockface.Picture, "candidates": rockface.Record,
    }  # fmt: skip
    seen = set()
    for step in small.steps:
        for port, kind in step.outputs.items():
            assert isinstance(small.artefact(step, port), kinds[kind]), f"{step.label}.{port}"
            seen.add(kind)
    assert seen == set(kinds)


def test_a_raster_has_the_values_the_program_counted(small):
    for sigma in ("0.4", "0.8"):
        raster = small[f"change.raster[sigma_px={sigma}]"]
        label = f"change[sigma_px={sigma}]"
        known = raster.values[np.isfinite(raster.values)].astype(float)
        assert known.mean() == pytest.approx(metric(small, label, "mean_m"), rel=1e-6)
        assert known.size / raster.values.size == pytest.approx(metric(small, label, "valid_share"))
        assert (raster.shape, raster.frame, raster.values.dtype) == ((40, 60), "wall", np.float32)
        assert raster.grid.extent == pytest.approx((-1.5, 1.5, -1, 1))
        assert (raster.grid.x_m[0], raster.grid.y_m[0]) == pytest.approx((-1.475, 0.975))


def test_rasters_agree_with_rasterio(small):
    rasterio = pytest.importorskip("rasterio")
    for output in ("change.raster[sigma_px=0.4]", "zone.zone", "rockfall.labels"):
        with rasterio.open(small.path(output)) as file:
            expected = file.read()
        for band, values in zip(small[output].bands.values(), expected, strict=True):
            np.testing.assert_array_equal(band, values)


def test_depth_maps_agree_with_openexr_and_lie_on_the_face(small):
    depth = small["left.depth"]
    assert {"range", "triangle", "valid"} <= set(depth.channels)
    points = depth.points()[np.isfinite(depth.z)]
    vertices = small["face.mesh"].vertices
    low, high = vertices.min(0) - 1e-6, vertices.max(0) + 1e-6
    assert ((points >= low) & (points <= high)).all()
    ranges = np.linalg.norm(points - depth.image.centre_m, axis=1)
    np.testing.assert_allclose(ranges, depth["range"][np.isfinite(depth.z)], rtol=1e-6)
    openexr = pytest.importorskip("OpenEXR")
    with openexr.File(str(small.path("left.depth")), separate_channels=True) as file:
        for name, channel in file.channels().items():
            np.testing.assert_array_equal(depth[name], channel.pixels)


def test_arrays_of_large_kinds_are_views_of_the_file(small):
    for array in (small["left.depth"].z, small["face.mesh"].vertices, small["surface.surface"][0].points, small["cloud"][0].points):
        assert not array.flags.owndata
        assert not array.flags.writeable


def test_meshes_are_closed_and_named(small):
    pieces = small["rockfall.pieces"]
    truth = small["rockfall.truth"].table()
    assert len(pieces) == len(truth) == 2
    for part, volume in zip(pieces, truth["removed_m3"], strict=True):
        a, b, c = (part.vertices[part.triangles[:, corner]] for corner in range(3))
        assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6 == pytest.approx(volume, rel=1e-6)
        assert len(pieces[part.name].vertices) == len(part.vertices)


def test_a_surface_becomes_a_mesh(small):
    surface = small["surface.surface"].at(epoch="pre", sigma_px=0.4)
    mesh = surface.to_mesh()
    assert np.isfinite(mesh.vertices).all()
    assert len(mesh.triangles) == np.bitwise_count(surface.squares & 3).sum()


def test_cameras_and_transforms(small):
    cameras = small["survey.cameras"]
    assert [image.name for image in cameras] == ["left", "right"]
    assert np.linalg.norm(np.subtract(cameras["left"].centre_m, cameras["right"].centre_m)) == pytest.approx(7, rel=0.01)
    assert cameras.sensor("left").f == 1450
    np.testing.assert_allclose(cameras["left"].rotation @ cameras["left"].rotation.T, np.eye(3), atol=1e-12)
    transform = small["align.transform"][0]
    points = np.random.default_rng(1).normal(size=(5, 3))
    homogeneous = np.c_[points, np.ones(5)] @ transform.matrix.T
    np.testing.assert_allclose(transform.apply(points), homogeneous[:, :3], atol=1e-12)
    covariance = small["errors.covariance"]
    assert covariance.matrix.shape == (len(covariance.parameters),) * 2


def test_tables_are_arrays_and_data_frames(small):
    table = small["table.table"]
    assert list(table["sigma_px"]) == [0.4, 0.8]
    assert table[0]["sigma_px"] == 0.4
    assert table.to_csv().splitlines()[0].startswith("sigma_px,")
    assert "<table>" in table._repr_html_()
    pandas = pytest.importorskip("pandas")
    assert isinstance(table.to_pandas(), pandas.DataFrame)


def test_what_is_written_is_read_back_by_the_program(small, tmp_path):
    depth = small["left.depth"]
    (tmp_path / "depth.exr").write_bytes(exr.write(depth))
    again = rockface.read(tmp_path / "depth.exr")
    np.testing.assert_array_equal(again["range"], depth["range"])
    assert again.sensor == depth.sensor
    assert inspected(tmp_path / "depth.exr")["kind"] == "depth"
    (tmp_path / "mesh.ply").write_bytes(ply.write_mesh(small["face.mesh"]))
    assert (tmp_path / "mesh.ply").read_bytes() == small.path("face.mesh").read_bytes()
    cloud = small["cloud"][0]
    (tmp_path / "cloud.ply").write_bytes(ply.write_cloud(cloud))
    np.testing.assert_array_equal(rockface.read(tmp_path / "cloud.ply").points, cloud.points)
    change = np.linspace(-1, 1, len(cloud.points), dtype=np.float32)
    valued = rockface.Cloud(cloud.frame, cloud.points, cloud.normals, numbers=cloud.numbers, values={"change": change})
    (tmp_path / "valued.ply").write_bytes(ply.write_cloud(valued))
    np.testing.assert_array_equal(rockface.read(tmp_path / "valued.ply").values["change"], change)
    assert "change" in json.dumps(inspected(tmp_path / "valued.ply"))


@pytest.mark.parametrize("output", ["change.raster[sigma_px=0.4]", "left.depth", "face.mesh", "rockfall.pieces"])
def test_a_damaged_file_is_refused_and_never_crashes(small, output):
    whole = small.path(output).read_bytes()
    kind = next(kind for step in small.steps for port, kind in step.outputs.items() if output.startswith(f"{step.step}.{port}"))
    for length in range(0, len(whole), max(1, len(whole) // 200)):
        with pytest.raises(rockface.FormatError):
            decode(kind, memoryview(whole[:length]))


def foreign(path, values, **more):
    rasterio = pytest.importorskip("rasterio")
    transform = rasterio.transform.from_origin(500_000, 6_000_000, 0.5, 0.5)
    options = {"crs": "EPSG:28356", "transform": transform, **more}
    with rasterio.open(path, "w", "GTiff", values.shape[1], values.shape[0], 1, dtype=values.dtype, **options) as file:
        file.write(values, 1)
        if "scales" in more:
            file.scales = more["scales"]
    return path


def test_a_foreign_raster_is_metres_or_refused(tmp_path):
    numbers = np.array([[-9999, 5], [7, 8]], np.int16)
    raster = rockface.read(foreign(tmp_path / "i.tif", numbers, nodata=-9999))
    assert np.isnan(raster.values[0, 0])
    assert (raster.values[1, 1], raster.crs, raster.grid.transform) == (8, "EPSG:28356", (0.5, 0, 500_000, 0, -0.5, 6_000_000))
    whole = np.full((64, 64), np.nan, np.float32)
    whole[:16, :16] = 2.5
    tiled = {"tiled": True, "blockxsize": 16, "blockysize": 16, "SPARSE_OK": "TRUE", "nodata": np.nan}
    sparse = rockface.read(foreign(tmp_path / "sparse.tif", whole, **tiled))
    assert np.array_equal(sparse.values, whole, equal_nan=True)
    numbers32 = np.linspace(-3, 5, 200, dtype=np.float32).reshape(10, 20)
    for predictor in (1, 2, 3):
        path = foreign(tmp_path / f"{predictor}.tif", numbers32, compress="DEFLATE", predictor=predictor)
        assert np.array_equal(rockface.read(path).values, numbers32)
    for name, more, told in [
        ("degrees", {"crs": "EPSG:4326"}, "degrees"),
        ("feet", {"crs": "EPSG:2229"}, "not in metres"),
        ("scale", {"scales": (0.001,)}, "scale"),
    ]:
        with pytest.raises(rockface.FormatError, match=told):
            rockface.read(foreign(tmp_path / f"{name}.tif", numbers, **more))


def test_a_count_that_no_file_can_hold_costs_nothing(tmp_path, small):
    data = bytearray(small.path("change.raster[sigma_px=0.4]").read_bytes())
    start = int.from_bytes(data[4:8], "little")
    count = int.from_bytes(data[start : start + 2], "little")
    for entry in range(count):
        place = start + 2 + 12 * entry
        changed = data.copy()
        changed[place + 4 : place + 8] = b"\xff\xff\xff\xff"
        (tmp_path / "big.tif").write_bytes(changed)
        with pytest.raises(rockface.FormatError):
            rockface.read(tmp_path / "big.tif")
    for name in ("t.csv", "c.laz"):
        (tmp_path / name).write_bytes(b"")
        with pytest.raises(rockface.FormatError, match="is read with"):
            rockface.read(tmp_path / name)


def test_what_lies_in_the_world_says_where(small):
    frame = {"axes": "world", "crs": "EPSG:28356+5711"}
    from rockface._exchange import decode, write

    place = rockface.Georeference("EPSG:28356+5711")
    import dataclasses

    for output in ("survey.cameras", "rockfall.truth", "left.depth", "errors.covariance"):
        moved = dataclasses.replace(small[output], frame=rockface.Frame.WORLD, georeference=place)
        kind = next(step.outputs[output.split(".")[1]] for step in small.steps if step.step == output.split(".")[0])
        back = decode(kind, memoryview(write(kind, moved)))
        assert back.written_frame() == frame
        assert back.crs == "EPSG:28356+5711"


def test_what_is_not_there_is_told_with_what_is(small):
    for look, told in [
        (lambda: small["change.raster[sigma_px=0.4]"]["height"], "no band `height`; there are difference"),
        (lambda: small["left.depth"]["rang"], "no channel `rang`; there are range"),
        (lambda: small["survey.cameras"]["top"], "no image `top`; there are left, right"),
        (lambda: small["rockfall.pieces"]["zz"], "no mesh `zz`; there are "),
        (lambda: rockface.Files({"a.csv": b""})["b.tif"], r"no file `b\.tif`; there are a\.csv"),
        (lambda: rockface.Files({})["a"], "there are none"),
        (lambda: rockface.Record("candidates", {"seed": 1})["x"], "no key `x`; there are seed"),
    ]:
        with pytest.raises(KeyError, match=told):
            look()
    files = rockface.Files({"a": b"1"})
    assert (files.get("a"), files.get("b"), files.get("b", b"2"), files.get("b", 3)) == (b"1", None, b"2", 3)
    assert "a" in files
    assert "b" not in files
    assert 1 not in files


def test_many_files_have_a_short_text():
    files = rockface.Files({f"tiles/{number}.npz": b"12" for number in range(2000)})
    assert repr(files).startswith("Files(tiles/0.npz: 2 bytes, tiles/1.npz: 2 bytes")
    assert repr(files).endswith("… and 1995 more, 4000 bytes in all)")


def test_a_miss_among_many_names_is_not_searched_for_near_ones(monkeypatch):
    def never(*_):
        raise AssertionError("a search")

    monkeypatch.setattr("rockface.artefacts.get_close_matches", never)
    many = rockface.Files({f"tiles/{number}.npz": b"12" for number in range(2000)})
    assert "tiles/x.npz" not in many
    assert many.get("tiles/x.npz") is None
    with pytest.raises(KeyError, match=r"no file `tiles/x\.npz`; there are tiles/0\.npz, .*, …"):
        many["tiles/x.npz"]
    few = rockface.Files({"a": b"1"})
    assert "b" not in few
    assert few.get("b") is None


def test_a_raster_has_the_shape_of_its_grid(small):
    raster = small["change.raster[sigma_px=0.4]"]
    with pytest.raises(ValueError, match=r"has the shape \(3, 3\), the grid 40 rows x 60 columns"):
        raster.like(np.zeros((3, 3)))
    with pytest.raises(ValueError, match="has the shape"):
        rockface.Raster.single(raster.grid, np.zeros(2400))
