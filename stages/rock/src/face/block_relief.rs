//! Rock broken into blocks by joint sets and beds: how far the blocks stand out of a relief, seen along one direction.
//!
//! The face is a sheet over a plane along a direction that may point upwards out of the wall: what blocks hide from that
//! direction are overhangs for a viewer in front, and no triangle of the sheet can meet another.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::face::relief::Lattice;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Field;

/// Joints followed until one is found that goes through; with more missing in a row the next one goes through.
const MISSING_IN_A_ROW: i32 = 12;
/// Decay of the exponential law of steps over the whole step.
const DECAY: f64 = 4.0;

/// How far blocks stand out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StepLaw {
    /// Everything from 0 to the step is equally likely.
    Uniform,
    /// Most blocks stand out little: exponential, cut off at the step.
    Exponential,
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
    /// Share of the spacing by which a joint may lie off its regular place, to either side; below 0.5.
    pub spread: f64,
    /// Length along strike after which a slab is cut, metres; infinite for beds.
    pub block_length_m: f64,
    /// Share of the places at which a joint is there.
    pub persistence: f64,
    /// Side of the patches in which a joint is there or not, metres.
    pub trace_length_m: f64,
    /// Blocks stand out by 0 to this much, metres.
    pub step_m: f64,
    /// How that is distributed.
    pub law: StepLaw,
}

/// Blocks that have fallen out of the face down to the joints behind them.
#[derive(Debug, Clone, Copy)]
pub struct Fallen {
    /// Share of the blocks.
    pub share: f64,
    /// How far behind the relief the rock ends at most, metres.
    pub depth_m: f64,
    /// Decides which blocks have fallen.
    pub noise: Field,
}

/// A face broken by joint sets.
pub struct BlockRelief {
    sets: Vec<Slabs>,
    fallen: Option<Fallen>,
    /// Tangent of the angle by which the direction of view points down.
    overhang: f64,
    /// The farthest a block may stand out, metres.
    reach_m: f64,
}

impl BlockRelief {
    /// Joint sets with the draws of each; `overhang_rad` tilts the direction of view, from the front to from below.
    pub fn new(sets: &[(JointSet, Field)], overhang_rad: f64, fallen: Option<Fallen>) -> Self {
        let overhang = portable_math::tan(overhang_rad);
        let reach_m = sets.iter().fold(0.0, |sum, (set, _)| sum + set.step_m);
        Self {
            sets: sets.iter().map(|(set, noise)| Slabs::new(*set, *noise, overhang)).collect(),
            fallen,
            overhang,
            reach_m,
        }
    }

    /// Raises the relief to the blocks.
    ///
    /// The rock is what lies below each block's own height over the relief; along each line of view the outermost rock
    /// counts, so risers facing the view lie on the joint planes themselves.
    pub fn raise(&self, lattice: &Lattice, heights: &mut [f64]) {
        let start = || (Vec::with_capacity(self.sets.len()), vec![Draws::default(); self.sets.len()]);
        heights.par_chunks_mut(lattice.columns).enumerate().for_each_init(start, |(rays, draws), (row, line)| {
            for (column, z) in line.iter_mut().enumerate() {
                *z = self.top(lattice.x(column), lattice.y(row), *z, rays, draws);
            }
        });
    }

    fn top(&self, x: f64, y: f64, relief: f64, rays: &mut Vec<Ray>, draws: &mut [Draws]) -> f64 {
        let sets = self.sets.iter().zip(&mut *draws);
        rays.clear();
        rays.extend(sets.map(|(set, draws)| set.ray(x, y, relief, self.overhang, self.reach_m, draws)));
        let floor = self.fallen.map_or(relief, |fallen| relief - fallen.depth_m);
        let mut upper = f64::INFINITY;
        loop {
            let raised = rays.iter().fold(relief, |z, ray| z + ray.step);
            let nearest = (0..rays.len()).reduce(|a, b| if rays[b].lower > rays[a].lower { b } else { a });
            let lower = nearest.map_or(f64::NEG_INFINITY, |k| rays[k].lower);
            let top = raised.min(upper);
            if top >= lower && !self.is_fallen(rays) {
                return top;
            }
            let Some(nearest) = nearest.filter(|_| lower > floor) else { return floor };
            upper = lower;
            self.sets[nearest].go_on(&mut rays[nearest], &mut draws[nearest]);
        }
    }

    fn is_fallen(&self, rays: &[Ray]) -> bool {
        let Some(fallen) = &self.fallen else { return false };
        let mix = |number: i32, ray: &Ray| fallen.noise.words(number.wrapping_add(ray.slab), ray.block)[0] as i32;
        let word = rays.iter().fold(0, mix) as u32;
        f64::from(word) < fallen.share * f64::from(u32::MAX)
    }
}

/// A joint set along one line of view.
struct Ray {
    /// Place of the line on the relief along the joints' normal, in spacings, and its change for a metre of Z.
    flat: f64,
    rate: f64,
    /// Place along strike, in lengths of blocks.
    along: f64,
    /// The patch of the joints.
    patch: i32,
    /// The slab now looked at, its block, how far that stands out (metres), and Z of the joint below it (metres).
    slab: i32,
    block: i32,
    step: f64,
    lower: f64,
}

/// Draws by a pair of numbers that were asked for lately, in places that follow from the numbers: neighbouring lines of view ask for
/// the same ones.
#[derive(Debug, Clone)]
struct Recent<T>(Vec<Option<([i32; 2], T)>>);

/// Places for draws; a power of two.
const PLACES: u32 = 64;

impl<T: Copy> Default for Recent<T> {
    fn default() -> Self {
        Self(vec![None; PLACES as usize])
    }
}

impl<T: Copy> Recent<T> {
    /// The draw of a key, which `draw` makes where it is not at hand.
    #[inline]
    fn of(&mut self, key: [i32; 2], draw: impl FnOnce() -> T) -> T {
        let mixed = (key[0] as u32).wrapping_mul(0x9E37_79B9) ^ (key[1] as u32).wrapping_mul(0x85EB_CA6B);
        let place = &mut self.0[(mixed >> (32 - PLACES.ilog2())) as usize];
        match place {
            Some((own, drawn)) if *own == key => *drawn,
            _ => place.insert((key, draw())).1,
        }
    }
}

/// The draws of a joint set that were made lately: joints, offsets of the blocks along strike and whether a joint is there by slab
/// (and patch), steps by slab and block, patches by their place.
#[derive(Debug, Clone, Default)]
struct Draws {
    joints: Recent<f64>,
    offsets: Recent<f64>,
    through: Recent<bool>,
    steps: Recent<f64>,
    patches: Recent<i32>,
}

struct Slabs {
    set: JointSet,
    /// Normal of the joints, not against the view, divided by the spacing.
    normal: Vector3<f64>,
    /// Strike, divided by the length of a block.
    strike: Vector3<f64>,
    /// Directions in the joints, divided by the side of a patch.
    in_plane: [Vector3<f64>; 2],
    /// Change along the normal for a metre of Z, in spacings.
    rate: f64,
    noise: Field,
}

impl Slabs {
    fn new(set: JointSet, noise: Field, overhang: f64) -> Self {
        let (sin_dip, cos_dip) = portable_math::sincos(set.dip_rad);
        let (sin, cos) = portable_math::sincos(set.direction_rad);
        let normal = Vector3::new(sin_dip * sin, cos_dip, sin_dip * cos) / set.spacing_m;
        let along = Vector3::new(cos, 0.0, -sin);
        let down = Vector3::new(cos_dip * sin, -sin_dip, cos_dip * cos);
        let rate = normal.z - overhang * normal.y;
        let sign = if rate < 0.0 { -1.0 } else { 1.0 };
        Self {
            set,
            normal: normal * sign,
            strike: along / set.block_length_m,
            in_plane: [along / set.trace_length_m, down / set.trace_length_m],
            rate: rate * sign,
            noise,
        }
    }

    /// Begins on the outermost slab the line of view can meet.
    fn ray(&self, x: f64, y: f64, relief: f64, overhang: f64, reach_m: f64, draws: &mut Draws) -> Ray {
        let place = Vector3::new(x, y - overhang * relief, relief);
        let flat = self.normal.x * x + self.normal.y * y;
        let patch = if self.set.persistence < 1.0 { self.patch(&place, draws) } else { 0 };
        let along = self.strike.dot(&place);
        let mut ray = Ray { flat, rate: self.rate, along, patch, slab: 0, block: 0, step: 0.0, lower: 0.0 };
        let slab = self.slab_at(flat + self.rate * (relief + reach_m), draws);
        self.enter(&mut ray, slab, draws);
        ray
    }

    /// A number for the patch of the joints a place lies in.
    fn patch(&self, place: &Vector3<f64>, draws: &mut Draws) -> i32 {
        let at = self.in_plane.map(|direction| direction.dot(place).floor() as i32);
        draws.patches.of(at, || self.noise.words(at[0], at[1])[2] as i32)
    }

    fn go_on(&self, ray: &mut Ray, draws: &mut Draws) {
        self.enter(ray, ray.slab - 1, draws);
    }

    /// Enters a slab, or the one below where the joint between them is missing.
    fn enter(&self, ray: &mut Ray, mut slab: i32, draws: &mut Draws) {
        for _ in 0..MISSING_IN_A_ROW {
            if draws.through.of([slab, ray.patch], || self.goes_through(slab, ray.patch)) {
                break;
            }
            slab -= 1;
        }
        ray.slab = slab;
        let offset = draws.offsets.of([slab, 0], || self.unit(slab, i32::MIN));
        ray.block = (ray.along + offset).floor() as i32;
        ray.step = draws.steps.of([slab, ray.block], || self.step(slab, ray.block));
        let below = |draws: &mut Draws| (self.joint(slab, draws) - ray.flat) / ray.rate;
        ray.lower = if ray.rate < 1e-9 { f64::NEG_INFINITY } else { below(draws) };
    }

    /// A draw from 0 to 1 for a slab and a block of it.
    fn unit(&self, slab: i32, block: i32) -> f64 {
        f64::from(self.noise.words(slab, block)[0]) / f64::from(u32::MAX)
    }

    fn goes_through(&self, slab: i32, patch: i32) -> bool {
        self.set.persistence >= 1.0
            || f64::from(self.noise.words(slab, patch)[1]) < self.set.persistence * f64::from(u32::MAX)
    }

    /// Place of the joint below a slab, in spacings.
    fn joint(&self, slab: i32, draws: &mut Draws) -> f64 {
        draws.joints.of([slab, 0], || f64::from(slab) + self.set.spread * (2.0 * self.unit(slab, i32::MAX) - 1.0))
    }

    /// The slab a place in spacings lies in.
    fn slab_at(&self, place: f64, draws: &mut Draws) -> i32 {
        let slab = place.floor() as i32;
        (slab - 1..=slab + 1).rev().find(|slab| self.joint(*slab, draws) <= place).unwrap_or(slab)
    }

    /// Height of a block over the relief, metres.
    fn step(&self, slab: i32, block: i32) -> f64 {
        let unit = self.unit(slab, block);
        self.set.step_m
            * match self.set.law {
                StepLaw::Uniform => unit,
                StepLaw::Exponential => -portable_math::log(1.0 - unit * (1.0 - portable_math::exp(-DECAY))) / DECAY,
            }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    const LATTICE: Lattice = Lattice { columns: 240, rows: 200, spacing_m: 0.05 };

    fn set(dip_rad: f64, direction_rad: f64, spacing_m: f64, step_m: f64) -> JointSet {
        let block_length_m = 1.7 * spacing_m;
        let (spread, law) = (0.35, StepLaw::Uniform);
        let (persistence, trace_length_m) = (1.0, 3.0);
        JointSet { dip_rad, direction_rad, spacing_m, spread, block_length_m, persistence, trace_length_m, step_m, law }
    }

    fn raised(lattice: &Lattice, sets: &[JointSet], overhang_rad: f64, fallen: Option<Fallen>) -> Vec<f64> {
        let drawn = |(k, set): (usize, &JointSet)| (*set, Key([k as u8 + 8; 32]).field());
        let sets: Vec<_> = sets.iter().enumerate().map(drawn).collect();
        let mut heights = vec![0.0; lattice.columns * lattice.rows];
        BlockRelief::new(&sets, overhang_rad, fallen).raise(lattice, &mut heights);
        heights
    }

    fn levels(heights: &[f64]) -> usize {
        let mut levels: Vec<i64> = heights.iter().map(|z| (z * 1e6) as i64).collect();
        levels.sort_unstable();
        levels.dedup();
        levels.len()
    }

    #[test]
    fn blocks_stand_out_by_at_most_the_steps_and_differ() {
        let sets = [set(0.9, 0.4, 0.8, 0.1), set(1.4, -1.2, 1.1, 0.2)];
        let heights = raised(&LATTICE, &sets, 0.3, None);
        assert!(heights.iter().all(|z| (0.0..=0.3).contains(z)));
        assert!(levels(&heights) > 50, "{} different heights", levels(&heights));
    }

    /// With joints at 45 degrees facing the viewer a step can rise no steeper than its joint plane, 1 in 1.
    #[test]
    fn the_faces_of_steps_lie_on_the_joints() {
        let column = Lattice { columns: 1, rows: 900, spacing_m: 0.01 };
        let heights = raised(&column, &[set(std::f64::consts::FRAC_PI_4, 0.0, 1.0, 0.4)], 0.0, None);
        let rises: Vec<f64> = heights.windows(2).map(|w| (w[1] - w[0]) / 0.01).collect();
        // Down the face the surface may drop off a block at any steepness but rises along the joint below it.
        let on_joint = rises.iter().filter(|r| (**r - 1.0).abs() < 1e-6).count();
        assert!(on_joint > 20, "{on_joint} vertices on joint planes");
        assert!(rises.iter().all(|r| *r <= 1.0 + 1e-6));
    }

    /// Joints that dip 45 degrees towards the viewer have the block above hang over them: seen from 60 degrees below,
    /// its underside is there, on the joint, where Z falls while Y grows, 1 in 1.
    #[test]
    fn undersides_lie_on_the_joints_and_overhang() {
        let column = Lattice { columns: 1, rows: 900, spacing_m: 0.01 };
        let (dip, overhang) = (std::f64::consts::FRAC_PI_4, std::f64::consts::FRAC_PI_3);
        let heights = raised(&column, &[set(dip, 0.0, 1.0, 0.4)], overhang, None);
        let y = |row: usize| column.y(row) - portable_math::tan(overhang) * heights[row];
        let slope = |row: usize| (heights[row + 1] - heights[row]) / (y(row + 1) - y(row));
        // Rows of the sheet go down; on an underside they come forth and up again.
        let roofs = (0..899).filter(|row| y(row + 1) > y(*row) && (slope(*row) + 1.0).abs() < 1e-6).count();
        assert!(roofs > 10, "{roofs} vertices on undersides");
    }

    #[test]
    fn joints_that_are_missing_leave_larger_blocks() {
        let whole = set(0.9, 0.4, 0.3, 0.2);
        let few = JointSet { persistence: 0.3, ..whole };
        let beds = JointSet { block_length_m: f64::INFINITY, ..whole };
        let count = |set: JointSet| {
            let flats = raised(&LATTICE, &[set], 0.0, None).windows(2).filter(|w| (w[0] - w[1]).abs() > 0.0).count();
            flats as f64
        };
        assert!(count(few) < 0.8 * count(whole), "{} of {}", count(few), count(whole));
        assert!(count(beds) < count(whole));
    }

    #[test]
    fn most_steps_of_the_exponential_law_are_small() {
        let slabs =
            Slabs::new(JointSet { law: StepLaw::Exponential, ..set(0.9, 0.4, 0.3, 1.0) }, Key([1; 32]).field(), 0.0);
        let steps: Vec<f64> = (0..4000).map(|slab| slabs.step(slab, 0)).collect();
        let mean = steps.iter().sum::<f64>() / 4000.0;
        // Mean of the exponential law with decay 4 cut off at 1: 1/4 - e^-4 / (1 - e^-4).
        assert!((mean - 0.2313).abs() < 0.01, "{mean}");
        assert!(steps.iter().all(|step| (0.0..=1.0).contains(step)));
    }

    #[test]
    fn fallen_blocks_leave_niches_no_deeper_than_asked() {
        let sets = [set(0.9, 0.4, 0.8, 0.1), set(1.2, -1.2, 0.9, 0.1), set(0.2, 3.0, 0.7, 0.0)];
        let fallen = Fallen { share: 0.15, depth_m: 0.4, noise: Key([2; 32]).field() };
        let heights = raised(&LATTICE, &sets, 0.0, Some(fallen));
        assert!(heights.iter().all(|z| (-0.4..=0.2).contains(z)));
        let behind = heights.iter().filter(|z| **z < -0.01).count() as f64 / heights.len() as f64;
        assert!((0.02..0.3).contains(&behind), "{behind} of the face lies in niches");
    }
}
