//! Synthetic rock relief on a regular grid: self-affine fields, wear of edges, and the mesh of it.

use rayon::prelude::*;

use rockface_core::artefact::{Frame, Mesh};
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Field;

/// Ratio of the wavelengths of neighbouring octaves; irrational, so that their lattices never line up.
const OCTAVE_RATIO: f64 = 1.932_851;

/// A regular grid of vertices around the origin; row 0 has the largest Y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    /// Number of columns of vertices, along X.
    pub columns: usize,
    /// Number of rows of vertices, from the largest Y down.
    pub rows: usize,
    /// Distance of neighbours, metres.
    pub spacing_m: f64,
}

impl Lattice {
    /// X of a column, metres.
    pub fn x(&self, column: usize) -> f64 {
        (column as f64 - (self.columns as f64 - 1.0) / 2.0) * self.spacing_m
    }

    /// Y of a row, metres.
    pub fn y(&self, row: usize) -> f64 {
        ((self.rows as f64 - 1.0) / 2.0 - row as f64) * self.spacing_m
    }
}

/// A self-affine field without mean and tilt, of exactly this root mean square, metres; by row from the top.
///
/// Octaves of cubic B-spline noise whose amplitude grows with the wavelength to the power of the Hurst exponent, from
/// two vertex spacings to the larger side of the face: height differences at distance d grow as `d^hurst`
/// (Mandelbrot and Van Ness 1968; octave sums after Musgrave 1993).
pub fn fractal(lattice: &Lattice, rms_m: f64, hurst: f64, noise: &Field) -> Vec<f64> {
    fractal_up_to(lattice, f64::INFINITY, rms_m, hurst, noise)
}

/// Like [`fractal`], without wavelengths longer than `longest_m`: texture rather than shape.
pub fn fractal_up_to(lattice: &Lattice, longest_m: f64, rms_m: f64, hurst: f64, noise: &Field) -> Vec<f64> {
    let mut heights = vec![0.0; lattice.columns * lattice.rows];
    let mut wavelength_m = (lattice.columns.max(lattice.rows) as f64 * lattice.spacing_m).min(longest_m);
    let mut octave = 0;
    while wavelength_m >= 2.0 * lattice.spacing_m {
        let amplitude = portable_math::pow(wavelength_m, hurst);
        add_octave(lattice, wavelength_m / lattice.spacing_m, amplitude, octave, noise, &mut heights);
        wavelength_m /= OCTAVE_RATIO;
        octave += 1;
    }
    detrend(lattice, &mut heights);
    let square = heights.iter().fold(0.0, |sum, z| sum + z * z) / heights.len() as f64;
    let scale = if square > 0.0 { rms_m / square.sqrt() } else { 0.0 };
    heights.par_iter_mut().for_each(|z| *z *= scale);
    heights
}

/// Knot before a place of a uniform cubic B-spline, and the weights of that knot and the next three.
fn spline(place: f64) -> (i32, [f64; 4]) {
    let knot = place.floor();
    let t = place - knot;
    let s = 1.0 - t;
    let middle = |t: f64| (4.0 - 6.0 * t * t + 3.0 * t * t * t) / 6.0;
    (knot as i32, [s * s * s / 6.0, middle(t), middle(s), t * t * t / 6.0])
}

fn add_octave(lattice: &Lattice, knots_apart: f64, amplitude: f64, octave: i32, noise: &Field, heights: &mut [f64]) {
    // Octaves draw from columns of cells far apart, and start at unrelated phases.
    let base = octave * 0x0200_0000;
    let phase = 0.37 * f64::from(octave);
    let at = |index: usize| spline(index as f64 / knots_apart + phase);
    let columns: Vec<(i32, [f64; 4])> = (0..lattice.columns).map(at).collect();
    let last = columns.last().map_or(0, |c| c.0 + 4) as usize;
    // Every row of vertices lies between four rows of knots, and many rows between the same ones.
    let (first_knot, last_knot) = (at(0).0, at(lattice.rows - 1).0 + 3);
    let draw = |row: i32| (0..last as i32).map(|column| noise.normal(base + column, row)).collect();
    let draws: Vec<Vec<f64>> = (first_knot..=last_knot).into_par_iter().map(draw).collect();
    heights.par_chunks_mut(lattice.columns).enumerate().for_each(|(row, line)| {
        let (knot, weights) = at(row);
        let rows = &draws[(knot - first_knot) as usize..][..4];
        let knots: Vec<f64> =
            (0..last).map(|column| rows.iter().zip(weights).map(|(row, weight)| weight * row[column]).sum()).collect();
        for (z, (first, w)) in line.iter_mut().zip(&columns) {
            let k = &knots[*first as usize..];
            *z += amplitude * (w[0] * k[0] + w[1] * k[1] + w[2] * k[2] + w[3] * k[3]);
        }
    });
}

/// Takes away the least-squares plane.
fn detrend(lattice: &Lattice, heights: &mut [f64]) {
    let n = heights.len() as f64;
    let mut sums = [0.0; 5];
    let place = |i: usize| (lattice.x(i % lattice.columns), lattice.y(i / lattice.columns));
    for (i, z) in heights.iter().enumerate() {
        let (x, y) = place(i);
        sums = [sums[0] + z, sums[1] + x * z, sums[2] + y * z, sums[3] + x * x, sums[4] + y * y];
    }
    let slope = |product: f64, square: f64| if square > 0.0 { product / square } else { 0.0 };
    let (mean, slope_x, slope_y) = (sums[0] / n, slope(sums[1], sums[3]), slope(sums[2], sums[4]));
    heights.par_iter_mut().enumerate().for_each(|(i, z)| {
        let (x, y) = place(i);
        *z -= mean + slope_x * x + slope_y * y;
    });
}

/// Wears edges off: weighs each height with its neighbours along rows and columns, as often as makes the weights a bell
/// with this standard deviation; the rim stays.
pub fn wear(lattice: &Lattice, sigma_m: f64, heights: &mut Vec<f64>) {
    // Weights of a quarter, a half and a quarter have a variance of half a spacing squared.
    let ratio = sigma_m / lattice.spacing_m;
    let passes = (2.0 * ratio * ratio).round() as usize;
    let (w, n) = (lattice.columns, heights.len());
    for _ in 0..passes {
        for step in [1, w] {
            let is_rim = |i: usize| if step == 1 { i.is_multiple_of(w) || i % w == w - 1 } else { i < w || i + w >= n };
            let bell = |i: usize| 0.5 * heights[i] + 0.25 * (heights[i - step] + heights[i + step]);
            *heights = (0..n).into_par_iter().map(|i| if is_rim(i) { heights[i] } else { bell(i) }).collect();
        }
    }
}

/// Triangles over the grid, each square cut along the diagonal with the smaller height difference; wall frame.
///
/// The heights lie along a direction that goes down by `overhang` (a tangent) a metre out of the wall. A sheet over a plane
/// along any one direction cannot meet itself, whatever the heights.
pub fn to_mesh(lattice: &Lattice, heights: &[f64], overhang: f64) -> Mesh {
    let w = lattice.columns;
    let place = |i: usize| [lattice.x(i % w), lattice.y(i / w) - overhang * heights[i], heights[i]];
    let mut triangles = vec![[0; 3]; 2 * (w - 1) * (lattice.rows - 1)];
    triangles.par_chunks_mut(2 * (w - 1)).enumerate().for_each(|(row, triangles)| {
        for (a, square) in (row * w..).zip(triangles.chunks_mut(2)) {
            let (b, c, d) = (a + 1, a + w + 1, a + w);
            let along_ac = (heights[a] - heights[c]).abs() <= (heights[b] - heights[d]).abs();
            let pair = if along_ac { [[a, d, c], [a, c, b]] } else { [[a, d, b], [b, d, c]] };
            square.copy_from_slice(&pair.map(|t| t.map(|i| i as u32)));
        }
    });
    let vertices = (0..heights.len()).into_par_iter().map(place).collect();
    Mesh { frame: Frame::Wall, vertices, triangles, colours: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    const LATTICE: Lattice = Lattice { columns: 240, rows: 200, spacing_m: 0.05 };

    fn rms(values: &[f64]) -> f64 {
        (values.iter().map(|z| z * z).sum::<f64>() / values.len() as f64).sqrt()
    }

    #[test]
    fn the_field_has_the_asked_roughness_and_no_tilt() {
        let mut heights = fractal(&LATTICE, 0.2, 0.8, &Key([3; 32]).field());
        assert!((rms(&heights) - 0.2).abs() < 1e-12);
        let before = heights.clone();
        detrend(&LATTICE, &mut heights);
        assert!(heights.iter().zip(&before).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    /// Height differences at distance d grow as d^H: the exponent is measured between 2 and 16 vertices.
    #[test]
    fn height_differences_grow_with_the_hurst_exponent() {
        for hurst in [0.4, 0.8] {
            let heights = fractal(&LATTICE, 0.2, hurst, &Key([5; 32]).field());
            let spread = |lag: usize| {
                let line = |row: &[f64]| row.windows(lag + 1).map(|w| w[lag] - w[0]).collect::<Vec<_>>();
                rms(&heights.chunks(LATTICE.columns).flat_map(line).collect::<Vec<_>>())
            };
            let measured = portable_math::log(spread(24) / spread(6)) / portable_math::log(4.0);
            assert!((measured - hurst).abs() < 0.15, "asked {hurst}, measured {measured}");
        }
    }

    #[test]
    fn texture_has_no_long_waves() {
        let heights = fractal_up_to(&LATTICE, 0.4, 0.2, 0.6, &Key([5; 32]).field());
        assert!((rms(&heights) - 0.2).abs() < 1e-12);
        // Means over 1 m squares, longer than the longest wave, lose most of it; those of a whole relief keep it.
        let mean = |heights: &[f64], row: usize, column: usize| {
            let line = |r: usize| heights[r * 240 + column..r * 240 + column + 20].iter().sum::<f64>();
            (row..row + 20).map(line).sum::<f64>() / 400.0
        };
        let squares = || (0..10).flat_map(|row| (0..12).map(move |column| (20 * row, 20 * column)));
        let means = |heights: &[f64]| rms(&squares().map(|(r, c)| mean(heights, r, c)).collect::<Vec<_>>());
        let whole = fractal(&LATTICE, 0.2, 0.6, &Key([5; 32]).field());
        assert!(means(&heights) < 0.11 && means(&whole) > 0.16, "{} and {}", means(&heights), means(&whole));
    }

    #[test]
    fn wear_is_a_bell_of_the_asked_width() {
        let mut heights = vec![0.0; 240 * 200];
        heights[100 * 240 + 120] = 1.0;
        wear(&LATTICE, 0.15, &mut heights);
        let moment = |power: i32| {
            let term = |i: usize| heights[i] * ((i % 240) as f64 - 120.0).abs() * ((i % 240) as f64 - 120.0).abs();
            (0..heights.len()).map(|i| if power == 0 { heights[i] } else { term(i) }).sum::<f64>()
        };
        assert!((moment(0) - 1.0).abs() < 1e-12);
        assert!((moment(2).sqrt() * 0.05 - 0.15).abs() < 1e-6);
    }
}
