"""Difference rasters as other programs write them: one grid, several encodings."""

import numpy as np
import rasterio
from rasterio.transform import from_origin
from scipy.ndimage import gaussian_filter

SHAPE, CELL_M = (104, 150), 0.02
GRID = from_origin(-1.5, 1.04, CELL_M, CELL_M)

# Names sort in this order; the last two hold other numbers than 32-bit floats.
ENCODINGS = {
    "a_plain": {},
    "b_tiles": {"compress": "deflate", "predictor": 3, "tiled": True, "blockxsize": 64, "blockysize": 64},
    "c_bigtiff": {"BIGTIFF": "YES", "ENDIANNESS": "BIG", "compress": "deflate", "predictor": 2, "nodata": None},
    "d_doubles": {"dtype": "float64", "nodata": -9999.0},
    "e_integers": {"dtype": "int16", "nodata": -32768, "compress": "packbits"},
}


def field(number):
    """Smooth plus white noise with a gap, in metres (whole numbers for the raster of integers)."""
    random = np.random.default_rng([7, number])
    smooth = gaussian_filter(random.normal(size=SHAPE), 3)
    values = 0.004 * smooth / smooth.std() + 0.003 * random.normal(size=SHAPE) + 0.002 * number
    values[random.random(SHAPE) < 0.03] = np.nan
    values[20:35, 40 + 5 * number : 70] = np.nan
    return values


def write_rasters(folder):
    """Writes one raster an encoding; returns the values to be found, by band name."""
    folder.mkdir()
    written = {}
    for number, (name, encoding) in enumerate(ENCODINGS.items()):
        options = {"dtype": "float32", "nodata": np.nan, "count": 1, "transform": GRID} | encoding
        values = np.round(field(number) * 1000) if options["dtype"] == "int16" else field(number)
        written[name] = values.astype(np.float32)
        gap = np.nan if options["nodata"] is None else options["nodata"]
        stored = np.where(np.isnan(values), gap, values).astype(options["dtype"])
        path = folder / f"{name}.tif"
        with rasterio.open(path, "w", driver="GTiff", height=SHAPE[0], width=SHAPE[1], **options) as file:
            file.write(stored, 1)
    return written


def write_noise(folder, count, factor):
    """Writes `count` plain rasters of noise, each somewhat stronger or weaker, `factor` times as strong in all."""
    folder.mkdir()
    random = np.random.default_rng([count, int(factor * 1000)])
    for number in range(count):
        smooth = gaussian_filter(random.normal(size=SHAPE), random.uniform(3, 6))
        strength = factor * random.uniform(0.8, 1.2)
        values = (
            strength * (0.004 * smooth / smooth.std() + 0.002 * random.normal(size=SHAPE)) + 0.001 * random.normal()
        )
        options = {"dtype": "float32", "nodata": np.nan, "count": 1, "transform": GRID}
        path = folder / f"{number:02}.tif"
        with rasterio.open(path, "w", driver="GTiff", height=SHAPE[0], width=SHAPE[1], **options) as file:
            file.write(values.astype(np.float32), 1)
