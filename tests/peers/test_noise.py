"""Noise descriptors: numpy and scipy find the numbers of our tables from the rasters."""

import csv
import json
import shutil

import numpy as np
import pytest
import rasterio

import describe
from conftest import HERE, execute
from foreign import CELL_M, write_rasters

SCALES = [1, 2, 4, 8]
CHANGE = "change"


@pytest.fixture(scope="module")
def described(binary, survey, tmp_path_factory):
    """Bands by name, features by name, curves by name and kind as (x, y, n)."""
    folder = tmp_path_factory.mktemp("noise")
    write_rasters(folder / "real")
    shutil.copy(survey.output("change", "raster.tif"), folder / "real" / f"{CHANGE}.tif")
    shutil.copy(HERE / "noise.yaml", folder)
    run = execute(binary, folder / "noise.yaml", folder)
    with rasterio.open(run.output("real", "raster.tif")) as file:
        bands = {name: file.read(i).astype(float) for i, name in enumerate(file.descriptions, start=1)}
    features = {row.pop("raster"): row for row in rows(run.output("noise", "features.csv"))}
    curves = {}
    for row in rows(run.output("noise", "curves.csv")):
        triple = [float(row[name]) for name in "xyn"]
        curves.setdefault((row["raster"], row["curve"]), []).append(triple)
    curves = {key: np.array(triples).T for key, triples in curves.items()}
    return run, bands, features, curves


@pytest.fixture(params=[CHANGE, "a_plain", "c_bigtiff", "d_doubles"])
def band(request, described):
    """Values, features and curves of one band."""
    _, bands, features, curves = described
    own = {kind: triple for (raster, kind), triple in curves.items() if raster == request.param}
    return bands[request.param], {k: float(v) for k, v in features[request.param].items()}, own


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def same(found, expected, relative=1e-6):
    np.testing.assert_allclose(found, expected, rtol=relative, atol=0)


def test_csv_and_json_hold_the_same_table(described):
    run, bands, features, _ = described
    table = json.loads(run.output("noise", "features.json").read_text())
    assert table["columns"][0] == "raster" and table["columns"][1:] == list(next(iter(features.values())))
    assert {row[0]: [float(v) for v in row[1:]] for row in table["rows"]} == {
        name: [float(v) for v in row.values()] for name, row in features.items()
    }
    assert list(features) == list(bands)


def test_marginal_statistics(band):
    values, features, _ = band
    for name, expected in describe.marginal(values).items():
        same(features[name], expected)


def test_the_variogram_counts_every_pair(band):
    values, features, curves = band
    lags, gamma, pairs = describe.variogram(values, 30)
    x, y, n = curves["variogram"]
    np.testing.assert_array_equal(n, pairs)
    same(x, lags * CELL_M)
    same(y, gamma)
    same(features["gamma1_m2"], gamma[0])


def test_the_variogram_model_is_the_best_one(band):
    _, features, curves = band
    for name, expected in describe.exponential_model(*curves["variogram"]).items():
        np.testing.assert_allclose(features[name], expected, rtol=1e-4, atol=1e-12, err_msg=name)


def test_roughness_over_scales(band):
    values, features, curves = band
    sigma, rms, n = curves["roughness"]
    same(sigma, np.array(SCALES) * CELL_M)
    same(rms, describe.roughness(values, SCALES))
    assert (n == np.count_nonzero(~np.isnan(values))).all()
    slope, intercept = np.polyfit(np.log(sigma), np.log(rms), 1)
    same([features["roughness_a"], features["roughness_b"]], [intercept, slope])


def test_the_radial_spectrum(band):
    values, features, curves = band
    frequency, power, samples = describe.spectrum(values, CELL_M)
    x, y, n = curves["spectrum"]
    np.testing.assert_array_equal(n, samples)
    same(x, frequency)
    same(y, power)
    same(features["spectral_entropy"], describe.entropy(power))
    same(features["spectral_slope"], describe.spectral_slope(frequency, power, CELL_M))
