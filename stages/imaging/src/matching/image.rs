//! The depth map of an image fused from all of its pairs, row by row: the map of a single pair never exists as a whole.

use rayon::prelude::*;

use crate::matching::matched::{Match, TakeMatches, Tally};
use crate::matching::pair::Matcher;
use crate::matching::pixel_row::PixelRow;
use crate::matching::row_fusion::{PairRow, RowFusion};
use rockface_core::numerics::simd::Lanes;
use rockface_raster::robust_mean::{Fused, Rule};

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
        scratch.fuse_row(&pixels, matchers, fusion.sigma_px, |column, fused| keep(out, column, fused))
    };
    let scratch = || Scratch::new(width, matchers.len(), fusion.rule);
    let tallies: Vec<ImageTally> = rows.par_iter_mut().enumerate().map_init(scratch, match_row).collect();
    tallies.iter().fold(empty, ImageTally::plus)
}

/// The depths that the pairs give the pixels of one row, and what fuses them.
struct Scratch {
    pairs: Vec<PairRow>,
    fusion: RowFusion,
}

impl Scratch {
    fn new(width: usize, pairs: usize, rule: Rule) -> Self {
        Self { pairs: vec![PairRow::new(width); pairs], fusion: RowFusion::new(rule, pairs) }
    }

    fn fuse_row(
        &mut self,
        pixels: &PixelRow,
        matchers: &[Matcher],
        sigma_px: f64,
        mut keep: impl FnMut(usize, &Fused),
    ) -> ImageTally {
        let mut tally = ImageTally::new(matchers.len());
        for ((matcher, pair), row) in matchers.iter().zip(&mut tally.pairs).zip(&mut self.pairs) {
            row.clear();
            *pair = matcher.match_row(pixels, &mut Gathered { row, sigma_px });
        }
        self.fusion.fuse_row(&self.pairs, |column, given, fused| {
            tally.matched += 1;
            if let Some(fused) = fused {
                tally.fused += 1;
                tally.kept += fused.count;
                tally.given += given;
                tally.sigma_m += fused.value.sigma_m;
                keep(column, &fused);
            }
        });
        tally
    }
}

/// Takes the depths that one pair gives the pixels of a row.
struct Gathered<'a> {
    row: &'a mut PairRow,
    sigma_px: f64,
}

impl TakeMatches for Gathered<'_> {
    fn take(&mut self, column: usize, matched: &Match) {
        self.row.set(column, matched.depth_m, self.sigma_px * matched.depth_per_px_m);
    }

    #[inline(always)]
    fn take_depths(&mut self, first: usize, depth_m: Lanes, depth_per_px_m: Lanes) -> bool {
        // A product has the bits of its factors in any order.
        self.row.set_lanes(first, depth_m, depth_per_px_m * self.sigma_px);
        true
    }
}
