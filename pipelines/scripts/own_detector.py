"""A detector of one's own: losses beyond three robust deviations, smoothed over 5 x 5 cells, as labels on the same grid."""

import sys

import numpy as np
import rasterio
from scipy import ndimage

difference_path, labels_path, sigmas = sys.argv[1], sys.argv[2], float(sys.argv[3])
with rasterio.open(difference_path) as file:
    difference, profile = file.read(1), file.profile
known = np.isfinite(difference)
weight = ndimage.uniform_filter(known.astype(float), 5)
smooth = ndimage.uniform_filter(np.where(known, difference, 0.0), 5) / np.maximum(weight, 1e-9)
deviation = 1.4826 * np.median(np.abs(smooth[known] - np.median(smooth[known])))
labels, count = ndimage.label(known & (smooth < -sigmas * deviation), structure=np.ones((3, 3)))
profile.update(dtype="uint16", nodata=None, predictor=1)
with rasterio.open(labels_path, "w", **profile) as file:
    file.write(labels.astype(np.uint16), 1)
print(f"{count} losses beyond {sigmas * deviation:.4f} m")
