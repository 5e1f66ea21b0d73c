//! The depth map of an image fused from all of its pairs, row by row: the map of a single pair never exists as a whole.

use rayon::prelude::*;

use crate::matching::map_fusion::{Averaging, Fused, FusedTogether, MOST_TOGETHER, Measured, Rule, Together, fuse};
use crate::matching::matched::Tally;
use crate::matching::pair::Matcher;
use crate::matching::pixel_row::PixelRow;
use rockface_core::numerics::simd::{LANES, Lanes, Work, vectorised};

/// How the depths of the pairs are fused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fusion {
    /// How the depths of a pixel are averaged and rejected.
    pub rule: Rule,
    /// Standard deviation of a disparity, from which the expected deviation of every depth follows, pixels; positive.
    pub sigma_px: f64,
}

/// Counts and sums over the image, added in the order of rows.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageTally {
    /// Matches of each pair.
    pub pairs: Vec<Tally>,
    /// Pixels with a fused depth.
    pub fused: usize,
    /// Pixels that at least one pair matched.
    pub matched: usize,
    /// Depths that were averaged in the fused pixels.
    pub kept: usize,
    /// Depths of the fused pixels before rejection.
    pub given: usize,
    /// Sum of the expected deviations of the fused depths, metres.
    pub sigma_m: f64,
}

impl ImageTally {
    fn new(pairs: usize) -> Self {
        Self { pairs: vec![Tally::default(); pairs], fused: 0, matched: 0, kept: 0, given: 0, sigma_m: 0.0 }
    }

    fn plus(mut self, other: &Self) -> Self {
        self.pairs.iter_mut().zip(&other.pairs).for_each(|(a, b)| *a = a.plus(*b));
        self.fused += other.fused;
        self.matched += other.matched;
        self.kept += other.kept;
        self.given += other.given;
        self.sigma_m += other.sigma_m;
        self
    }
}

/// Matches an image with all of its partners; `keep` writes a fused pixel to its row.
///
/// All of `matchers` make the map of one image, whose columns are `width`, sampled at its own pixels. Rows are processed in
/// parallel. The bits do not depend on the number of threads.
pub fn match_image<R: Send>(
    matchers: &[Matcher],
    width: usize,
    fusion: &Fusion,
    rows: &mut [R],
    keep: impl Fn(&mut R, usize, &Fused) + Sync,
) -> ImageTally {
    let empty = ImageTally::new(matchers.len());
    let Some(any) = matchers.first() else { return empty };
    let match_row = |scratch: &mut Scratch, (row, out): (usize, &mut R)| {
        let pixels = any.pixel_row(row);
        scratch.fuse_row(&pixels, matchers, fusion, |column, fused| keep(out, column, fused))
    };
    let scratch = || Scratch::new(width, matchers.len());
    let tallies: Vec<ImageTally> = rows.par_iter_mut().enumerate().map_init(scratch, match_row).collect();
    tallies.iter().fold(empty, ImageTally::plus)
}

/// The depths that the pairs give the pixels of one row.
struct Scratch {
    width: usize,
    /// Depths of each pair, metres, and their changes for one pixel of disparity; NaN where a pair has none.
    pairs: Vec<[Vec<f64>; 2]>,
    /// The depths of one pixel.
    values: Vec<Measured>,
}

impl Scratch {
    fn new(width: usize, pairs: usize) -> Self {
        // To whole blocks of pixels, without a value behind the last.
        let empty = || vec![f64::NAN; width.next_multiple_of(LANES)];
        let pairs = (0..pairs).map(|_| [empty(), empty()]).collect();
        Self { width, pairs, values: Vec::new() }
    }

    fn fuse_row(
        &mut self,
        pixels: &PixelRow,
        matchers: &[Matcher],
        fusion: &Fusion,
        mut keep: impl FnMut(usize, &Fused),
    ) -> ImageTally {
        let mut tally = ImageTally::new(matchers.len());
        for ((matcher, [depths_m, steps_m]), pair) in matchers.iter().zip(&mut self.pairs).zip(&mut tally.pairs) {
            depths_m[..self.width].fill(f64::NAN);
            *pair = matcher.match_row(pixels, |column, matched| {
                (depths_m[column], steps_m[column]) = (matched.depth_m, matched.depth_per_px_m);
            });
        }
        let [Some(first), Some(last)] = [pixels.columns.first(), pixels.columns.last()] else { return tally };
        for start in (first / LANES * LANES..=*last).step_by(LANES) {
            let together = self.is_fused_together(start, fusion);
            let fused = together.then(|| vectorised(FuseBlock { scratch: self, start, fusion }));
            for lane in 0..LANES {
                let (given, fused) = match &fused {
                    Some(fused) => (fused.given[lane] as usize, of_lane(fused, lane)),
                    None => self.fuse_one(start + lane, fusion),
                };
                tally.matched += usize::from(given > 0);
                if let Some(fused) = fused {
                    tally.fused += 1;
                    tally.kept += fused.count;
                    tally.given += given;
                    tally.sigma_m += fused.value.sigma_m;
                    keep(start + lane, &fused);
                }
            }
        }
        tally
    }

    /// Whether pixels from a column on can be fused together: they are averaged, and none of their depths is infinite.
    fn is_fused_together(&self, start: usize, fusion: &Fusion) -> bool {
        let is_infinite = |depths_m: &[f64]| depths_m.iter().any(|depth_m| depth_m.is_infinite());
        fusion.rule.averaging == Averaging::Mean
            && self.pairs.len() <= MOST_TOGETHER
            && !self.pairs.iter().any(|[depths_m, _]| is_infinite(&depths_m[start..start + LANES]))
    }

    /// How many depths a pixel has, and what they are fused to.
    fn fuse_one(&mut self, column: usize, fusion: &Fusion) -> (usize, Option<Fused>) {
        self.values.clear();
        for [depths_m, steps_m] in self.pairs.iter().filter(|[depths_m, _]| !depths_m[column].is_nan()) {
            self.values.push(Measured::new(depths_m[column], fusion.sigma_px * steps_m[column]));
        }
        (self.values.len(), fuse(&mut self.values, &fusion.rule))
    }
}

fn of_lane(fused: &FusedTogether, lane: usize) -> Option<Fused> {
    let (value_m, sigma_m) = (fused.values_m[lane], fused.sigmas_m[lane]);
    let fused = || Fused { value: Measured::new(value_m, sigma_m), count: fused.counts[lane] as usize };
    (!value_m.is_nan()).then(fused)
}

/// Fuses the depths of neighbouring pixels in wide registers.
struct FuseBlock<'a> {
    scratch: &'a Scratch,
    start: usize,
    fusion: &'a Fusion,
}

impl Work for FuseBlock<'_> {
    type Output = FusedTogether;

    #[inline(always)]
    fn run(self) -> FusedTogether {
        let mut together = Together::default();
        for [depths_m, steps_m] in &self.scratch.pairs {
            let depths_m = Lanes::first_of(&depths_m[self.start..]);
            together.push(depths_m, Lanes::first_of(&steps_m[self.start..]) * self.fusion.sigma_px);
        }
        together.fuse(&self.fusion.rule)
    }
}
