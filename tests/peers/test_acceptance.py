"""The acceptance test: numpy finds the distances, thresholds and verdicts of our tables from the features alone."""

import csv
import json
import shutil

import numpy as np
import pytest
from scipy import stats

from conftest import HERE, execute
from foreign import write_noise

QUANTILES = [0.9, 0.95, 0.99]


@pytest.fixture(scope="module")
def run(binary, tmp_path_factory):
    folder = tmp_path_factory.mktemp("acceptance")
    write_noise(folder / "real", 20, 1.0)
    write_noise(folder / "simulated", 8, 1.1)
    shutil.copy(HERE / "acceptance.yaml", folder)
    return execute(binary, folder / "acceptance.yaml", folder)


@pytest.fixture(scope="module")
def model(run):
    return json.loads(run.output("model", "model.json").read_text())


def rows(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def numbers(table, columns):
    return np.array([[float(row[column]) for column in columns] for row in table])


def fit(reference, ridge):
    """Mean, deviation and inverse covariance of the standardised features."""
    mean, deviation = reference.mean(axis=0), reference.std(axis=0, ddof=1)
    covariance = np.cov((reference - mean) / deviation, rowvar=False)
    return mean, deviation, np.linalg.inv(covariance + ridge * np.eye(len(mean)))


def distances(fitted, features):
    """Squared distance of each row, and what each feature adds to it."""
    mean, deviation, inverse = fitted
    z = (features - mean) / deviation
    contributions = z * (z @ inverse)
    return contributions.sum(axis=1), contributions


@pytest.mark.parametrize("group", ["all", "marginal", "variogram", "spectrum", "roughness"])
def test_the_model_of_a_group(run, model, group):
    found = model["groups"][group]
    reference = numbers(rows(run.output("known", "features.csv")), found["features"])
    mean, deviation, inverse = fitted = fit(reference, model["ridge"])
    assert model["references"] == len(reference) == 20 and found["constant"] == []
    np.testing.assert_allclose(found["mean"], mean, rtol=1e-9)
    np.testing.assert_allclose(found["deviation"], deviation, rtol=1e-9)
    np.testing.assert_allclose(found["inverse"], inverse, rtol=1e-6, atol=1e-9 * np.abs(inverse).max())
    np.testing.assert_allclose(found["reference_d2"], distances(fitted, reference)[0], rtol=1e-7)
    correlation = np.corrcoef(reference, rowvar=False)
    np.testing.assert_allclose(found["eigenvalues"], np.linalg.eigvalsh(correlation)[::-1], atol=1e-10)
    alone = [
        distances(fit(np.delete(reference, i, axis=0), model["ridge"]), reference[i : i + 1])[0][0] for i in range(20)
    ]
    np.testing.assert_allclose(found["leave_one_out_d2"], alone, rtol=1e-6)


def test_verdicts(run, model):
    verdicts = rows(run.output("verdict", "verdicts.csv"))
    simulated = rows(run.output("found", "features.csv"))
    assert [row["raster"] for row in verdicts] == [row["raster"] for row in simulated]
    for group, found in model["groups"].items():
        names, reference_d2 = found["features"], np.array(found["reference_d2"])
        fitted = fit(numbers(rows(run.output("known", "features.csv")), names), model["ridge"])
        d2, contributions = distances(fitted, numbers(simulated, names))
        suffix = "" if group == "all" else f"_{group}"
        np.testing.assert_allclose(numbers(verdicts, [f"d2{suffix}"])[:, 0], d2, rtol=1e-7)
        threshold = np.quantile(reference_d2, 0.95)
        assert [row[f"accepted{suffix}"] == "true" for row in verdicts] == list(d2 <= threshold)
        score = 1 - (reference_d2[None, :] <= d2[:, None]).mean(axis=1)
        np.testing.assert_allclose(numbers(verdicts, [f"score{suffix}"])[:, 0], score, atol=1e-12)
        if group == "all":
            np.testing.assert_allclose(numbers(verdicts, ["threshold"])[:, 0], threshold, rtol=1e-7)
            said = numbers(verdicts, [f"contribution_{name}" for name in names])
            np.testing.assert_allclose(said, contributions, rtol=1e-6, atol=1e-7 * np.abs(contributions).max())
            assert [row["top_feature"] for row in verdicts] == [names[i] for i in contributions.argmax(axis=1)]


def test_the_summary_counts_what_the_verdicts_say(run, model):
    summary = rows(run.output("verdict", "summary.csv"))
    d2 = numbers(rows(run.output("verdict", "verdicts.csv")), ["d2"])[:, 0]
    reference_d2 = np.array(model["groups"]["all"]["reference_d2"])
    thresholds = np.quantile(reference_d2, QUANTILES)
    found = numbers(summary, ["quantile", "threshold", "simulated_accepted", "simulated_n", "real_accepted"])
    np.testing.assert_allclose(found[:, 1], thresholds, rtol=1e-7)
    counts = [[(d2 <= t).sum(), len(d2), (reference_d2 <= t).sum()] for t in thresholds]
    expected = np.column_stack([QUANTILES, thresholds, counts])
    np.testing.assert_allclose(found, expected, rtol=1e-7)
    # The Wilson interval, by its definition: the shares whose standard score is 1.96.
    share, n = found[:, 2] / found[:, 3], found[:, 3]
    for bound in numbers(summary, ["simulated_low95", "simulated_high95"]).T:
        inner = (bound > 0) & (bound < 1)
        score = np.abs(share - bound)[inner] / np.sqrt(bound * (1 - bound) / n)[inner]
        np.testing.assert_allclose(score, 1.959964, rtol=1e-5)


def test_what_a_perfect_simulator_is_expected_to_reach(run, model):
    n, joint = model["references"], model["groups"]["all"]
    p, alone = len(joint["features"]), np.array(joint["leave_one_out_d2"])
    for row in rows(run.output("verdict", "summary.csv")):
        quantile, threshold = float(row["quantile"]), float(row["threshold"])
        in_sample = (n - 1) ** 2 / n * stats.beta.ppf(quantile, p / 2, (n - p - 1) / 2)
        expected = stats.f.cdf(in_sample * n * (n - p) / (p * (n**2 - 1)), p, n - p)
        np.testing.assert_allclose(float(row["perfect_acceptance_normal"]), expected, atol=1e-8)
        assert float(row["perfect_acceptance_leave_one_out"]) == (alone <= threshold).mean()
        np.testing.assert_allclose(float(row["leave_one_out_threshold"]), np.quantile(alone, quantile), rtol=1e-6)
