//! Gaussian filters of grids with gaps: what has no value has no weight (normalised convolution).

use rayon::prelude::*;

use crate::numerics::portable_math;

/// Where the filter is cut off, in standard deviations.
const TRUNCATION: f64 = 4.0;

/// A value and its weight: those of a cell that has a value, or zeros, or sums of these.
pub type Weighted = [f64; 2];

/// Cells filtered together, so that their sums stay in registers.
pub const BLOCK: usize = 8;
/// Numbers in a block.
const LANES: usize = 2 * BLOCK;

/// The values under a Gaussian of `scale` cells, gaps without weight; 0 where nothing is in reach.
pub fn smoothed(values: &[f32], columns: usize, scale: f64) -> Vec<f64> {
    let kernel = half_kernel(scale);
    let mut along = vec![[0.0; 2]; values.len()];
    filter_rows(values, columns, 0.0, &kernel, &mut along);
    let mean = |[sum, weight]: Weighted| if weight > 0.0 { sum / weight } else { 0.0 };
    let of_block = |strip: &mut Vec<Weighted>, block: usize| {
        let mut means = Vec::with_capacity(values.len() / columns * BLOCK);
        filter_columns(&along, columns, &kernel, block, strip, |_, sums| means.extend(sums.map(mean)));
        means
    };
    let blocks: Vec<Vec<f64>> = (0..columns.div_ceil(BLOCK)).into_par_iter().map_init(Vec::new, of_block).collect();
    let mut smooth = vec![0.0; values.len()];
    smooth.par_chunks_mut(columns).enumerate().for_each(|(row, line)| {
        for (out, means) in line.chunks_mut(BLOCK).zip(&blocks) {
            out.copy_from_slice(&means[row * BLOCK..][..out.len()]);
        }
    });
    smooth
}

/// Weights of a Gaussian of `scale` cells at distances 0, 1, 2, ... cells; both sides together add up to 1.
pub fn half_kernel(scale: f64) -> Vec<f64> {
    let radius = (TRUNCATION * scale + 0.5).floor() as usize;
    let weight = |k: usize| portable_math::exp(-0.5 * (k as f64 / scale) * (k as f64 / scale));
    let kernel: Vec<f64> = (0..=radius).map(weight).collect();
    let total = kernel[0] + 2.0 * kernel[1..].iter().sum::<f64>();
    kernel.iter().map(|w| w / total).collect()
}

/// Filters each row, with nothing beyond its ends.
pub fn filter_rows(values: &[f32], columns: usize, mean: f64, kernel: &[f64], along: &mut [Weighted]) {
    let radius = kernel.len() - 1;
    along.par_chunks_mut(columns).zip(values.par_chunks(columns)).for_each(|(out, line)| {
        let mut padded = vec![[0.0; 2]; columns + 2 * radius + BLOCK];
        for (cell, value) in padded[radius..].iter_mut().zip(line).filter(|(_, value)| !value.is_nan()) {
            *cell = [f64::from(*value) - mean, 1.0];
        }
        for (block, out) in out.chunks_mut(BLOCK).enumerate() {
            out.copy_from_slice(&convolve(&padded[block * BLOCK..], 1, kernel)[..out.len()]);
        }
    });
}

/// Filters a block of columns, with nothing beyond their ends, and hands over its cells row by row; `strip` is room for it.
pub fn filter_columns(
    along: &[Weighted],
    columns: usize,
    kernel: &[f64],
    block: usize,
    strip: &mut Vec<Weighted>,
    mut take: impl FnMut(usize, [Weighted; BLOCK]),
) {
    let (rows, radius) = (along.len() / columns, kernel.len() - 1);
    let wide = BLOCK.min(columns - block * BLOCK);
    strip.clear();
    strip.resize((rows + 2 * radius) * BLOCK, [0.0; 2]);
    for (cells, line) in strip[radius * BLOCK..].chunks_exact_mut(BLOCK).zip(along.chunks_exact(columns)) {
        cells[..wide].copy_from_slice(&line[block * BLOCK..][..wide]);
    }
    for row in 0..rows {
        take(row, convolve(&strip[row * BLOCK..], BLOCK, kernel));
    }
}

/// A block of neighbours under the kernel, whose steps are `stride` cells of the input apart; the first one's centre is
/// `input[(kernel.len() - 1) * stride]`.
fn convolve(input: &[Weighted], stride: usize, kernel: &[f64]) -> [Weighted; BLOCK] {
    let (input, centre) = (input.as_flattened(), 2 * (kernel.len() - 1) * stride);
    let mut sums = [0.0; LANES];
    for (sum, x) in sums.iter_mut().zip(&input[centre..][..LANES]) {
        *sum = kernel[0] * x;
    }
    for (k, weight) in kernel.iter().enumerate().skip(1) {
        let step = 2 * k * stride;
        let (before, after) = (&input[centre - step..][..LANES], &input[centre + step..][..LANES]);
        for lane in 0..LANES {
            sums[lane] += weight * (before[lane] + after[lane]);
        }
    }
    std::array::from_fn(|cell| [sums[2 * cell], sums[2 * cell + 1]])
}
