"""A noise, a detector and a network as steps of a pipeline; `own-stages.yaml` uses the first two."""

from pathlib import Path

import numpy as np

import rockface


@rockface.stage(output="noise")
def fractal(
    dem: rockface.Raster, random: rockface.Random, sigma_m: float = 0.01, exponent: float = 2.0, longest_m: float = 2.0
) -> rockface.Raster:
    """Noise whose power falls with the wave number k as k^-exponent, no waves being longer than `longest_m`."""
    rows, columns = dem.shape
    ky, kx = np.fft.fftfreq(rows, dem.grid.cell_m), np.fft.rfftfreq(columns, dem.grid.cell_m)
    k = np.maximum(np.hypot(ky[:, None], kx[None, :]), 1 / longest_m)
    white = np.fft.rfft2(random.generator("fractal").normal(size=dem.shape))
    noise = np.fft.irfft2(white * k ** (-exponent / 2), s=dem.shape)
    noise *= sigma_m / noise.std()
    rockface.metric("std", noise.std(), "m")
    return dem.like(dem.values + noise, "elevation")


@rockface.stage(output="errors")
def matching_errors(
    depth: rockface.DepthMap, random: rockface.Random, sigma_px: float = 0.3, exponent: float = 2.0, longest_px: float = 200.0
) -> rockface.DepthMap:
    """Errors of disparity for port `errors` of match-pair: fractal, and twice as strong at the edges of what the image sees."""
    rows, columns = depth.shape
    k = np.maximum(np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)[None, :]), 1 / longest_px)
    white = np.fft.rfft2(random.generator("errors").normal(size=depth.shape))
    field = np.fft.irfft2(white * k ** (-exponent / 2), s=depth.shape)
    steps = np.hypot(*np.gradient(np.nan_to_num(depth.z)))
    strength = np.where(steps > 20 * np.median(steps), 2.0, 1.0)
    return depth.with_channels(error_px=sigma_px * strength * field / field.std())


@rockface.stage(output="labels")
def connected_losses(
    difference: rockface.Raster, sigmas: float = 3.0, smooth_cells: float = 1.0, min_cells: int = 12, keep_open: bool = False
) -> rockface.Raster:
    """Losses beyond `sigmas` robust deviations of the smoothed difference, as labelled regions of at least `min_cells`."""
    from skimage import filters, measure, morphology

    values = difference.values.astype(float)
    known = np.isfinite(values)
    smooth = filters.gaussian(np.where(known, values, 0.0), smooth_cells)
    weight = filters.gaussian(known.astype(float), smooth_cells)
    smooth = np.where(known, smooth / np.maximum(weight, 1e-9), 0.0)
    deviation = 1.4826 * np.median(np.abs(smooth[known] - np.median(smooth[known])))
    loss = known & (smooth < -sigmas * deviation)
    if not keep_open:
        loss = morphology.closing(loss, morphology.disk(1))
    labels = measure.label(loss, connectivity=2)
    sizes = np.bincount(labels.ravel())
    large = np.flatnonzero(sizes >= min_cells)
    large = large[large > 0]
    numbers = np.zeros(sizes.size, np.uint16)
    numbers[large] = np.arange(1, large.size + 1)
    rockface.headline(f"{large.size} losses beyond {sigmas * deviation:.4f} m")
    return difference.like(numbers[labels], "label")


@rockface.stage(output="labels", memory_gib=8)
def segment(difference: rockface.Raster, model: Path, threshold: float = 0.5, scale_m: float = 0.05) -> rockface.Raster:
    """A segmentation network (TorchScript, one channel in, one logit out) applied to a difference; needs torch and scipy.

    The content of `model` is part of what the result is known by: `files: {model: network.pt}`.
    """
    import torch
    from scipy import ndimage

    torch.use_deterministic_algorithms(True)
    torch.set_num_threads(1)
    network = torch.jit.load(str(model), map_location="cpu").eval()
    values = np.nan_to_num(difference.values / scale_m)
    with torch.inference_mode():
        share = torch.sigmoid(network(torch.from_numpy(values)[None, None]))[0, 0].numpy()
    labels, count = ndimage.label((share > threshold) & np.isfinite(difference.values))
    rockface.metric("losses", count)
    return difference.like(labels.astype(np.uint16), "label")
