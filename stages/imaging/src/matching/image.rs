//! The depth map of an image fused from all of its pairs, row by row: the map of a single pair never exists as a whole.

use rayon::prelude::*;

use crate::matching::map_fusion::{Fused, Measured, Rule, fuse};
use crate::matching::matched::Tally;
use crate::matching::pair::Matcher;
use crate::matching::pixel_row::PixelRow;

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
            *pair = matcher.match_row(pixels, |column, matched| {
                let count = &mut self.counts[column];
                let sigma_m = fusion.sigma_px * matched.depth_per_px_m;
                self.values[column * n + usize::from(*count)] = Measured::new(matched.depth_m, sigma_m);
                *count += 1;
            });
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
