"""Descriptors of noise by numpy and scipy, from their definitions, by plain loops and library filters."""

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import least_squares
from scipy.signal.windows import hann
from scipy.stats import kurtosis, median_abs_deviation


def marginal(values):
    """Mean, standard deviation, skewness, excess kurtosis, NMAD, share of gaps."""
    found = values[~np.isnan(values)]
    centred = found - found.mean()
    deviation = found.std(ddof=1)
    return {
        "mean_m": found.mean(),
        "std_m": deviation,
        "skewness": (centred**3).sum() / (found.size * deviation**3),
        "excess_kurtosis": (kurtosis(found) + 3) * (1 - 1 / found.size) ** 2 - 3,
        "nmad_m": median_abs_deviation(found, scale="normal"),
        "valid_cells": found.size,
        "nan_share": 1 - found.size / values.size,
    }


def variogram(values, longest):
    """Lag (cells), gamma and pairs by bin 1 to `longest`, pair by pair."""
    sums = np.zeros((longest + 1, 3))
    height, width = values.shape
    for down in range(min(longest + 1, height)):
        for across in range(-min(longest, width - 1), min(longest, width - 1) + 1):
            length = np.hypot(down, across)
            nearest = int(np.floor(length + 0.5))
            if (down == 0 and across <= 0) or nearest > longest:
                continue
            first = values[: height - down, max(0, -across) : width - max(0, across)]
            second = values[down:, max(0, across) : width - max(0, -across)]
            squares = (first - second) ** 2
            pairs = np.count_nonzero(~np.isnan(squares))
            sums[nearest] += pairs, pairs * length, np.nansum(squares)
    pairs, lengths, squares = sums[1:].T
    return lengths / pairs, squares / (2 * pairs), pairs


def exponential_model(lags, gamma, pairs):
    """Nugget, sill and range at 95 % of the weighted least-squares fit; the length parameter stays near the lags."""
    weight = np.sqrt(pairs) / lags
    scale = gamma.max()

    def model(p):
        return p[0] + p[1] * (1 - np.exp(-lags / np.exp(p[2])))

    def residual(p):
        return weight * (model(p) - gamma / scale)

    starts = [[0.3, 0.7, np.log(lags[-1] / part)] for part in (0.2, 2, 5, 10, 30)]
    bounds = ([0, 0, np.log(lags[0] / 20)], [np.inf, np.inf, np.log(lags[-1] * 10)])
    tight = {"xtol": 1e-15, "ftol": 1e-15, "gtol": 1e-15, "max_nfev": 5000}
    fits = [least_squares(residual, start, bounds=bounds, **tight) for start in starts]
    nugget, partial, log_range = min(fits, key=lambda fit: fit.cost).x
    range95 = np.exp(log_range) * np.log(20 * partial / (nugget + partial))
    return {"nugget_m2": nugget * scale, "sill_m2": (nugget + partial) * scale, "range95_m": range95}


def roughness(values, scales):
    """Root mean square of what a Gaussian filter takes away, by scale in cells."""
    mask = ~np.isnan(values)
    filled = np.where(mask, values - np.nanmean(values), 0)

    def rest(scale):
        smooth, weight = (
            gaussian_filter(field, scale, mode="constant", truncate=4)[mask] for field in (filled, mask.astype(float))
        )
        return np.sqrt(((filled[mask] - smooth / weight) ** 2).mean())

    return [rest(scale) for scale in scales]


def spectrum(values, cell, direction=None):
    """Frequency, power and samples of the radial bins; of the frequencies within 22.5 degrees of a direction where one is given."""
    height, width = values.shape
    window = np.outer(hann(height), hann(width)) * ~np.isnan(values)
    filled = np.nan_to_num(values)
    windowed = window * (filled - (window * filled).sum() / window.sum())
    power = np.abs(np.fft.fft2(windowed)) ** 2 / (window**2).sum()
    down, across = np.fft.fftfreq(height, cell)[:, None], np.fft.fftfreq(width, cell)[None, :]
    frequency = np.hypot(down, across)
    step = 1 / (min(height, width) * cell)
    nearest = np.floor(frequency / step + 0.5).astype(int)
    longest = min(height, width) // 2
    bins = np.arange(1, longest + 1)
    if direction is not None:
        # Rows go down, angles go up.
        along = np.abs(across * np.cos(np.radians(direction)) - down * np.sin(np.radians(direction)))
        nearest = np.where(along >= np.cos(np.radians(22.5)) * frequency, nearest, 0)
    samples = np.bincount(nearest.ravel(), minlength=longest + 1)[bins]
    sums = np.bincount(nearest.ravel(), power.ravel(), minlength=longest + 1)[bins]
    met = samples > 0
    return (bins * step)[met], sums[met] / samples[met], samples[met]


def entropy(power):
    """Entropy of the radial spectrum, natural logarithm."""
    share = power / power.sum()
    return -(share * np.log(share)).sum()


def spectral_slope(frequency, power, cell):
    """Slope of ln power over ln frequency, by 16 logarithmic bins from 4 df to half the Nyquist frequency."""
    lowest, highest = np.log(4 * frequency[0]), np.log(0.25 / cell)
    logarithm = np.log(frequency)
    place = (logarithm - lowest) / (highest - lowest) * 16
    inside = (place > -1e-9) & (place < 16 + 1e-9)
    bins = np.clip(np.floor(place[inside]).astype(int), 0, 15)
    count = np.bincount(bins, minlength=16)
    used = count > 0
    x = np.bincount(bins, logarithm[inside], 16)[used] / count[used]
    y = np.log(np.bincount(bins, power[inside], 16)[used] / count[used])
    return np.polyfit(x, y, 1)[0]
