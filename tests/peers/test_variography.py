"""Descriptors: fields of gstools with known parameters come back; numpy, scipy, scikit-gstat and xDEM find our values."""

import csv
import subprocess

import numpy as np
import pytest
import rasterio
from rasterio.transform import from_origin

import describe as definitions
from conftest import HERE, Run

CELL_M = 0.01


def describe(binary, work, values, lag=60):
    """Writes named arrays as rasters and returns (features by name, curves by name and kind)."""
    folder = work / "rasters"
    folder.mkdir()
    for name, band in values.items():
        height, width = band.shape
        options = {"dtype": "float32", "nodata": np.nan, "count": 1, "transform": from_origin(0, 0, CELL_M, CELL_M)}
        with rasterio.open(folder / f"{name}.tif", "w", driver="GTiff", height=height, width=width, **options) as file:
            file.write(band.astype(np.float32), 1)
    command = [binary, "run", HERE / "variography.yaml", "--quiet", "--store", work / "store", "--runs", work / "runs"]
    command += ["--set", f"params.rasters={folder}", "--set", f"params.lag={lag}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    run = Run((work / "runs" / "latest").resolve())
    with run.output("noise", "features.csv").open(newline="") as file:
        features = {row.pop("raster"): {k: float(v) for k, v in row.items()} for row in csv.DictReader(file)}
    curves = {}
    with run.output("noise", "curves.csv").open(newline="") as file:
        for row in csv.DictReader(file):
            curves.setdefault((row["raster"], row["curve"]), []).append([float(row[c]) for c in "xyn"])
    return features, {key: np.array(rows).T for key, rows in curves.items()}


def gaps(values, share, random):
    """The array with a share of its cells missing, half of them in one block."""
    values = values.copy()
    side = int(np.sqrt(0.5 * share * values.size))
    values[5 : 5 + side, 7 : 7 + side] = np.nan
    values[random.random(values.shape) < 0.5 * share] = np.nan
    return values


@pytest.fixture(scope="module")
def known(binary, tmp_path_factory):
    """Ten fields of gstools, 300 x 300 cells, every second with 10 % of its cells missing."""
    gstools = pytest.importorskip("gstools")
    random = np.random.default_rng(3)
    truth = {"nugget_m2": 1e-6, "sill_m2": 5e-6, "length_m": 0.05}
    fields = {}
    axis = CELL_M * np.arange(300)
    model = gstools.Exponential(dim=2, var=truth["sill_m2"] - truth["nugget_m2"], len_scale=truth["length_m"], nugget=0)
    for seed in range(10):
        field = gstools.SRF(model, seed=seed, mode_no=1000).structured([axis, axis])
        field = field + np.sqrt(truth["nugget_m2"]) * random.normal(size=field.shape)
        fields[f"f{seed}"] = gaps(field, 0.1, random) if seed % 2 else field
    features, _ = describe(binary, tmp_path_factory.mktemp("known"), fields, lag=120)
    return truth, features


def test_known_parameters_are_recovered(known):
    """Means over ten fields: nugget within 10 %, sill within 5 %, range within 10 %; each field within 25 %."""
    truth, features = known
    range95_m = -truth["length_m"] * np.log(0.05 * truth["sill_m2"] / (truth["sill_m2"] - truth["nugget_m2"]))
    expected = {"nugget_m2": truth["nugget_m2"], "sill_m2": truth["sill_m2"], "range95_m": range95_m}
    for (name, value), within in zip(expected.items(), (0.10, 0.05, 0.10)):
        found = np.array([row[name] for row in features.values()])
        assert abs(found.mean() / value - 1) < within, (name, found / value)
        assert np.abs(found / value - 1).max() < 0.25, (name, found / value)


@pytest.fixture(scope="module")
def small(binary, tmp_path_factory):
    """Ten rasters of 40 x 40 cells, small enough for every pair of cells; half of them with gaps."""
    from scipy.ndimage import gaussian_filter

    random = np.random.default_rng(5)
    fields = {}
    for number in range(10):
        smooth = gaussian_filter(random.normal(size=(40, 40)), 1.5 + 0.2 * number)
        field = 0.004 * smooth / smooth.std() + 0.002 * random.normal(size=(40, 40))
        fields[f"s{number}"] = gaps(field, 0.1, random) if number % 2 else field
    return fields, *describe(binary, tmp_path_factory.mktemp("small"), fields, lag=15)


@pytest.fixture(params=[f"s{number}" for number in range(10)])
def one(request, small):
    """Values, features and curves of one of the ten."""
    fields, features, curves = small
    own = {kind: triple for (name, kind), triple in curves.items() if name == request.param}
    return fields[request.param].astype(np.float32).astype(float), features[request.param], own


def test_all_ten_features_follow_from_their_definitions(one):
    values, features, curves = one
    for name, expected in definitions.marginal(values).items():
        np.testing.assert_allclose(features[name], expected, rtol=1e-6, atol=1e-12, err_msg=name)
    lags, gamma, pairs = definitions.variogram(values, 15)
    np.testing.assert_allclose(curves["variogram"], [lags * CELL_M, gamma, pairs], rtol=1e-6)
    for name, expected in definitions.exponential_model(*curves["variogram"]).items():
        np.testing.assert_allclose(features[name], expected, rtol=1e-4, atol=1e-12, err_msg=name)
    sigma, rms, _ = curves["roughness"]
    np.testing.assert_allclose(rms, definitions.roughness(values, [1, 2, 4, 8]), rtol=1e-6)
    slope, intercept = np.polyfit(np.log(sigma), np.log(rms), 1)
    np.testing.assert_allclose([features["roughness_a"], features["roughness_b"]], [intercept, slope], rtol=1e-6)
    spectrum = definitions.spectrum(values, CELL_M)
    np.testing.assert_allclose(curves["spectrum"], spectrum, rtol=1e-6)
    np.testing.assert_allclose(features["spectral_entropy"], definitions.entropy(spectrum[1]), rtol=1e-6)
    slope = definitions.spectral_slope(*spectrum[:2], CELL_M)
    np.testing.assert_allclose(features["spectral_slope"], slope, rtol=1e-6)


def test_directional_spectra_follow_from_their_definition(one):
    values, _, curves = one
    for direction in (0, 90):
        np.testing.assert_allclose(
            curves[f"spectrum_{direction}"], definitions.spectrum(values, CELL_M, direction), rtol=1e-6
        )


def test_scikit_gstat_finds_the_same_gamma(small):
    skgstat = pytest.importorskip("skgstat")
    fields, _, curves = small
    rows, columns = np.mgrid[:40, :40]
    for name, field in fields.items():
        valid = ~np.isnan(field)
        places = np.c_[columns[valid], rows[valid]].astype(float)
        edges = [0.5 + k for k in range(16)]
        found = skgstat.Variogram(places, field[valid].astype(np.float32).astype(float), bin_func=edges, maxlag=15.5, fit_method=None)
        lag, gamma, _ = curves[name, "variogram"]
        np.testing.assert_allclose(gamma, found.experimental[1:16] if len(found.experimental) > 15 else found.experimental, rtol=0.02)
        assert len(lag) == 15


def test_directions_are_those_of_the_axes(binary, tmp_path):
    """A field longer along X than along Y has the smaller variogram along X, and its power along Y."""
    from scipy.ndimage import gaussian_filter

    field = gaussian_filter(np.random.default_rng(1).normal(size=(200, 200)), (2, 6))
    _, curves = describe(binary, tmp_path, {"a": 0.01 * field / field.std()}, lag=30)
    along, across = curves["a", "variogram_0"][1], curves["a", "variogram_90"][1]
    assert (along[1:8] < 0.6 * across[1:8]).all()
    along, across = curves["a", "spectrum_0"], curves["a", "spectrum_90"]
    middle = slice(20, 35)
    assert (along[1][-80:][middle] < 0.2 * across[1][-80:][middle]).all()


def test_xdem_agrees_on_a_square(binary, tmp_path):
    """xDEM samples pairs: within 12 % of the exact values (and only on squares, where its grid is not transposed)."""
    xdem = pytest.importorskip("xdem")
    from scipy.ndimage import gaussian_filter

    random = np.random.default_rng(2)
    smooth = gaussian_filter(random.normal(size=(180, 180)), 6)
    field = 0.006 * smooth / smooth.std() + 0.003 * random.normal(size=(180, 180))
    _, curves = describe(binary, tmp_path, {"a": field}, lag=60)
    lag, gamma, _ = curves["a", "variogram"]
    sampled = xdem.spatialstats.sample_empirical_variogram(values=field, gsd=CELL_M, subsample=2000, random_state=4)
    for row in sampled.itertuples():
        if 0.03 < row.lags < 0.5 and np.isfinite(row.exp):
            exact = np.interp(row.lags, lag, gamma)
            assert abs(row.exp / exact - 1) < 0.25, (row.lags, row.exp, exact)
