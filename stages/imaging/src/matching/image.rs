//! The depth map of an image from all of its pairs, streamed row by row: the maps of single pairs exist for one row at a time.

use rayon::prelude::*;

use crate::camera::model::Camera;
use crate::matching::map_fusion::{Fused, Measured, Rule, fuse};
use crate::matching::pair::{Matcher, Tally};
use crate::matching::pixel_row::OwnRow;
use rockface_core::artefact::Depth;

/// A pair seen from one of its images.
pub struct Side<'a> {
    /// The pair.
    pub matcher: Matcher<'a>,
    /// Which of its images is the one the map is made for: 0 first, 1 second.
    pub own: usize,
}

/// How the maps of the pairs become one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fusion {
    /// How the values of a pixel are put together.
    pub rule: Rule,
    /// Standard deviation of a disparity that gives every depth its expected one, pixels; positive.
    pub sigma_px: f64,
}

/// What happened over the image, added up in the order of rows.
#[derive(Debug, Clone, PartialEq)]
pub struct ImageTally {
    /// Matches of each pair.
    pub pairs: Vec<Tally>,
    /// Pixels with a fused depth.
    pub fused: usize,
    /// Pixels that at least one pair matched.
    pub matched: usize,
    /// Depths the fused pixels stand on.
    pub kept: usize,
    /// Depths pairs gave to the fused pixels.
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
/// `camera` and `noisy` are those of the image of `ideal`. Rows are worked on in parallel. The same bits at any thread count.
pub fn match_image<R: Send>(
    ideal: &Depth,
    [camera, noisy]: [&Camera; 2],
    sides: &[Side],
    fusion: &Fusion,
    rows: &mut [R],
    keep: impl Fn(&mut R, usize, &Fused) + Sync,
) -> ImageTally {
    let work = |scratch: &mut Scratch, (row, out): (usize, &mut R)| {
        let pixels = OwnRow::new(ideal, camera, noisy, row);
        scratch.work_off(&pixels, sides, fusion, |column, fused| keep(out, column, fused))
    };
    let scratch = || Scratch::new(ideal.width, sides.len());
    let tallies: Vec<ImageTally> = rows.par_iter_mut().enumerate().map_init(scratch, work).collect();
    tallies.iter().fold(ImageTally::new(sides.len()), ImageTally::plus)
}

/// What the pairs say about the pixels of one row.
struct Scratch {
    /// `width x pairs`, the first `counts` of each pixel filled.
    values: Vec<Measured>,
    counts: Vec<u8>,
}

impl Scratch {
    fn new(width: usize, pairs: usize) -> Self {
        Self { values: vec![Measured::new(0.0, 1.0); width * pairs], counts: vec![0; width] }
    }

    fn work_off(
        &mut self,
        pixels: &OwnRow,
        sides: &[Side],
        fusion: &Fusion,
        mut keep: impl FnMut(usize, &Fused),
    ) -> ImageTally {
        let (n, mut tally) = (sides.len(), ImageTally::new(sides.len()));
        self.counts.fill(0);
        for (side, pair) in sides.iter().zip(&mut tally.pairs) {
            side.matcher.match_row(side.own, pixels, |column, found| {
                pair.add(found);
                let count = &mut self.counts[column];
                let sigma_m = fusion.sigma_px * found.depth_per_px_m;
                self.values[column * n + usize::from(*count)] = Measured::new(found.depth_m, sigma_m);
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
