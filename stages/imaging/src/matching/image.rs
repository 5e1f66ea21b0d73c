//! The depth map of an image fused from all of its pairs, row by row: the map of a single pair never exists as a whole.

use rayon::prelude::*;

use crate::matching::map_fusion::{Fused, Measured, Rule, fuse};
use crate::matching::matched::{Match, TakeMatches, Tally};
use crate::matching::pair::Matcher;
use crate::matching::pixel_row::PixelRow;
use rockface_core::numerics::simd::{LANES, Lanes};

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
    /// `width x pairs`, of which the first `counts` of each pixel are valid.
    values: Vec<Measured>,
    counts: Vec<u8>,
}

impl Scratch {
    fn new(width: usize, pairs: usize) -> Self {
        Self { values: vec![Measured::new(0.0, 1.0); width * pairs], counts: vec![0; width] }
    }

    fn fuse_row(
        &mut self,
        pixels: &PixelRow,
        matchers: &[Matcher],
        fusion: &Fusion,
        mut keep: impl FnMut(usize, &Fused),
    ) -> ImageTally {
        let (n, mut tally) = (matchers.len(), ImageTally::new(matchers.len()));
        self.counts.fill(0);
        for (matcher, pair) in matchers.iter().zip(&mut tally.pairs) {
            let (values, counts) = (&mut self.values[..], &mut self.counts[..]);
            let mut out = Gathered { values, counts, pairs: n, sigma_px: fusion.sigma_px };
            *pair = matcher.match_row(pixels, &mut out);
        }
        for column in &pixels.columns {
            let count = usize::from(self.counts[*column]);
            let start = column * n;
            tally.matched += usize::from(count > 0);
            if let Some(fused) = fuse(&mut self.values[start..start + count], &fusion.rule) {
                tally.fused += 1;
                tally.kept += fused.count;
                tally.given += count;
                tally.sigma_m += fused.value.sigma_m;
                keep(*column, &fused);
            }
        }
        tally
    }
}

/// Takes the depths that one more pair gives the pixels of a row.
struct Gathered<'a> {
    values: &'a mut [Measured],
    counts: &'a mut [u8],
    pairs: usize,
    sigma_px: f64,
}

impl Gathered<'_> {
    #[inline(always)]
    fn add(&mut self, column: usize, depth_m: f64, depth_per_px_m: f64) {
        let count = &mut self.counts[column];
        let sigma_m = self.sigma_px * depth_per_px_m;
        self.values[column * self.pairs + usize::from(*count)] = Measured::new(depth_m, sigma_m);
        *count += 1;
    }
}

impl TakeMatches for Gathered<'_> {
    fn take(&mut self, column: usize, matched: &Match) {
        self.add(column, matched.depth_m, matched.depth_per_px_m);
    }

    #[inline(always)]
    fn take_depths(&mut self, first: usize, depth_m: Lanes, depth_per_px_m: Lanes) -> bool {
        for lane in 0..LANES {
            self.add(first + lane, depth_m[lane], depth_per_px_m[lane]);
        }
        true
    }
}
