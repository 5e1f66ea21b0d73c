//! Synthetic rock relief on a regular grid: a self-affine field and a joint set that breaks the face into stepped blocks.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::precise;
use super::random::Field;

/// Ratio of the wavelengths of neighbouring octaves; irrational, so that their lattices never line up.
const OCTAVE_RATIO: f64 = 1.932_851;
/// Share of the joint spacing by which a joint may lie off its regular place, to either side.
const JITTER: f64 = 0.35;
/// Length of a block along the strike, in joint spacings.
const BLOCK_LENGTH: f64 = 1.7;

/// A regular grid of vertices around the origin; row 0 has the largest Y.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Lattice {
    /// Columns of vertices.
    pub columns: usize,
    /// Rows of vertices.
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
    let mut heights = vec![0.0; lattice.columns * lattice.rows];
    let mut wavelength_m = lattice.columns.max(lattice.rows) as f64 * lattice.spacing_m;
    let mut octave = 0;
    while wavelength_m >= 2.0 * lattice.spacing_m {
        let amplitude = precise::pow(wavelength_m, hurst);
        add_octave(lattice, wavelength_m / lattice.spacing_m, amplitude, octave, noise, &mut heights);
        wavelength_m /= OCTAVE_RATIO;
        octave += 1;
    }
    detrend(lattice, &mut heights);
    let square = heights.iter().fold(0.0, |sum, z| sum + z * z) / heights.len() as f64;
    let scale = if square > 0.0 { rms_m / square.sqrt() } else { 0.0 };
    for z in &mut heights {
        *z *= scale;
    }
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
    let last = columns.last().map_or(0, |c| c.0 + 4);
    heights.par_chunks_mut(lattice.columns).enumerate().for_each(|(row, line)| {
        let (knot, weights) = at(row);
        let knots: Vec<f64> = (0..last)
            .map(|column| (0..4).map(|k| weights[k as usize] * noise.normal(base + column, knot + k)).sum())
            .collect();
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
    for (i, z) in heights.iter_mut().enumerate() {
        let (x, y) = place(i);
        *z -= mean + slope_x * x + slope_y * y;
    }
}

/// A set of parallel joints in the wall frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointSet {
    /// Dip below the horizontal, radians.
    pub dip_rad: f64,
    /// Horizontal direction of dip, radians from straight out of the face (Z) towards X.
    pub direction_rad: f64,
    /// Mean distance of neighbouring joints, metres.
    pub spacing_m: f64,
    /// Blocks stand out by 0 to this much, metres.
    pub step_m: f64,
}

/// Breaks a face along a joint set: each block between two joints stands out of the relief by its own amount.
///
/// The rock is the union of the slabs between joints, each cut off along strike into blocks and raised to its own height;
/// what is returned is its upper envelope seen along Z, so faces of steps lie on the joint planes themselves.
pub fn break_along_joints(lattice: &Lattice, joints: &JointSet, noise: &Field, heights: &mut [f64]) {
    let slabs = Slabs::new(joints, noise);
    heights.par_chunks_mut(lattice.columns).enumerate().for_each(|(row, line)| {
        for (column, z) in line.iter_mut().enumerate() {
            *z = slabs.top(lattice.x(column), lattice.y(row), *z);
        }
    });
}

struct Slabs<'a> {
    /// Normal of the joints with Z not negative, divided by the spacing.
    normal: Vector3<f64>,
    /// Strike, divided by the length of a block.
    strike: Vector3<f64>,
    step_m: f64,
    noise: &'a Field,
}

impl<'a> Slabs<'a> {
    fn new(joints: &JointSet, noise: &'a Field) -> Self {
        let (sin_dip, cos_dip) = precise::sincos(joints.dip_rad);
        let (sin, cos) = precise::sincos(joints.direction_rad);
        let normal = Vector3::new(sin_dip * sin, cos_dip, sin_dip * cos) / joints.spacing_m;
        let strike = Vector3::new(cos, 0.0, -sin) / (BLOCK_LENGTH * joints.spacing_m);
        Self { normal: if normal.z < 0.0 { -normal } else { normal }, strike, step_m: joints.step_m, noise }
    }

    /// A draw from 0 to 1 for a slab and a block of it.
    fn unit(&self, slab: i32, block: i32) -> f64 {
        f64::from(self.noise.words(slab, block)[0]) / f64::from(u32::MAX)
    }

    /// Place of the joint below a slab, in spacings.
    fn joint(&self, slab: i32) -> f64 {
        f64::from(slab) + JITTER * (2.0 * self.unit(slab, i32::MAX) - 1.0)
    }

    /// The slab a place in spacings lies in.
    fn slab_at(&self, place: f64) -> i32 {
        let slab = place.floor() as i32;
        (slab - 1..=slab + 1).rev().find(|slab| self.joint(*slab) <= place).unwrap_or(slab)
    }

    /// Height of a block of a slab over the relief, metres.
    fn step(&self, slab: i32, along: f64) -> f64 {
        self.step_m * self.unit(slab, (along + self.unit(slab, i32::MIN)).floor() as i32)
    }

    fn top(&self, x: f64, y: f64, relief: f64) -> f64 {
        let flat = self.normal.x * x + self.normal.y * y;
        let along = self.strike.dot(&Vector3::new(x, y, relief));
        let mut slab = self.slab_at(flat + self.normal.z * (relief + self.step_m));
        // From the highest slab the envelope can reach down to the one whose upper joint lies under the relief.
        loop {
            let raised = relief + self.step(slab, along);
            if self.normal.z < 1e-9 {
                return raised;
            }
            let z_of = |slab: i32| (self.joint(slab) - flat) / self.normal.z;
            let top = raised.min(z_of(slab + 1));
            if top >= z_of(slab) || top <= relief {
                return top.max(relief);
            }
            slab -= 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::random::Key;

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
            let measured = precise::log(spread(24) / spread(6)) / precise::log(4.0);
            assert!((measured - hurst).abs() < 0.15, "asked {hurst}, measured {measured}");
        }
    }

    #[test]
    fn blocks_stand_out_by_at_most_the_step_and_differ() {
        let joints = JointSet { dip_rad: 0.9, direction_rad: 0.4, spacing_m: 0.8, step_m: 0.1 };
        let mut heights = vec![0.0; LATTICE.columns * LATTICE.rows];
        break_along_joints(&LATTICE, &joints, &Key([1; 32]).field(), &mut heights);
        assert!(heights.iter().all(|z| (0.0..=0.1).contains(z)));
        let mut levels: Vec<i64> = heights.iter().map(|z| (z * 1e6) as i64).collect();
        levels.sort_unstable();
        levels.dedup();
        assert!(levels.len() > 50, "{} different heights", levels.len());
    }

    /// With joints at 45 degrees facing the viewer a step can rise no steeper than its joint plane, 1 in 1.
    #[test]
    fn the_faces_of_steps_lie_on_the_joints() {
        let dip_rad = std::f64::consts::FRAC_PI_4;
        let joints = JointSet { dip_rad, direction_rad: 0.0, spacing_m: 1.0, step_m: 0.4 };
        let column = Lattice { columns: 1, rows: 900, spacing_m: 0.01 };
        let mut heights = vec![0.0; 900];
        break_along_joints(&column, &joints, &Key([8; 32]).field(), &mut heights);
        let rises: Vec<f64> = heights.windows(2).map(|w| (w[1] - w[0]) / 0.01).collect();
        // Down the face the surface may drop off a block at any steepness but rises along the joint below it.
        let on_joint = rises.iter().filter(|r| (**r - 1.0).abs() < 1e-6).count();
        assert!(on_joint > 20, "{on_joint} vertices on joint planes");
        assert!(rises.iter().all(|r| *r <= 1.0 + 1e-6));
    }
}
