//! The noisy depth map one image of a stereo pair would yield: true projections, noisy rectification, noisy disparity.
//!
//! For each pixel q of the image: the true point on its true ray at the ideal depth; its true projection into the other
//! image; both positions undistorted and rectified with the noisy cameras; disparity x1 - x2 plus noise; and back to a
//! depth on the noisy ray of q, whose own rectified row it keeps (paper 2.1.2, Algorithm 2 lines 10 to 19, Eq. 2 and 3).
//! Rows of the two positions differ by the y-parallax that wrong orientations cause; it is reported, never averaged in.
//! Pixels are those of the depth-map level throughout.

use rayon::prelude::*;

use crate::StageError;
use crate::artefact::Depth;
use crate::fail;
use crate::kernel::camera::{Camera, full_pixel};
use crate::kernel::matching_noise::{FieldRecipe, LocalNoise, Lookup, SmoothNoise};
use crate::kernel::noise::terms::{DisparityError, Lookups, Site, Terms};
use crate::kernel::noisy_rays::NoisyRays;
use crate::kernel::own_row::{OwnPixel, OwnRow};
use crate::kernel::random::Key;
use crate::kernel::rectification::{Placed, Rectification};
use crate::kernel::rectified_row::{rectified_ray, rectified_row, source_pixel};
use crate::kernel::whole::{floor, nearest};

/// The white part of the noise: its deviation in pixels, and its draws.
pub type Local = (f64, LocalNoise);
/// The smooth part of the noise: its deviation in pixels, and its field.
pub type Smooth = (f64, SmoothNoise);

/// A pair ready to be matched. Arrays hold the first (left) image and the second.
pub struct Matcher<'a> {
    /// Ideal depth maps, with the true cameras.
    pub ideal: [&'a Depth; 2],
    /// True cameras.
    pub cameras: [Camera; 2],
    /// Noisy cameras.
    pub noisy: [Camera; 2],
    /// Whether the noisy camera has the interior orientation of the true one.
    pub same_interior: [bool; 2],
    /// Rays of the noisy cameras from those of the true ones.
    pub noisy_rays: [NoisyRays; 2],
    /// Rectification of the noisy cameras.
    pub rectification: Rectification,
    /// White noise; `None` without any.
    pub local: Option<Local>,
    /// Smooth noise; `None` without any.
    pub smooth: Option<Smooth>,
    /// A noise with further terms, which takes the place of `local` and `smooth`; `None`: the paper's noise.
    pub terms: Option<Terms>,
    /// Relative depth by which a point may lie behind what the other image sees there; `None` lets it see through.
    pub occlusion_tolerance: Option<f64>,
    /// Whether disparities are sampled at the pixels of the rectified image, whose depth map is then made.
    pub rectified: bool,
}

/// One matched pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Depth on the noisy ray, metres; in the rectified image where that is sampled.
    pub depth_m: f64,
    /// Normalised coordinates of the noisy ray, or of that of the rectified image.
    pub noisy_ray: [f64; 2],
    /// Disparity without noise of the matching, pixels: that of the true projections, rectified by the noisy cameras.
    pub ideal_px: f64,
    /// Noise of the matching, term by term.
    pub error: DisparityError,
    /// What the sub-pixel step adds, pixels.
    pub sub_pixel_px: f64,
    /// Noisy disparity, pixels: the sum of the ideal one and all terms.
    pub disparity_px: f64,
    /// Row of the first rectified position less that of the second, pixels.
    pub y_parallax_px: f64,
    /// Depth a pixel of disparity is worth, metres.
    pub depth_per_px_m: f64,
}

impl Match {
    /// Distance along the noisy ray, metres.
    pub fn range_m(&self) -> f64 {
        let [x, y] = self.noisy_ray;
        self.depth_m * (x * x + y * y + 1.0).sqrt()
    }
}

/// Sums over the matched pixels of an image, added up in the order of its rows.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Tally {
    /// Matched pixels.
    pub count: usize,
    /// Sum of squared y-parallaxes, square pixels.
    pub y_parallax2_px2: f64,
    /// Sum of the depths a pixel of disparity is worth, metres.
    pub depth_per_px_m: f64,
}

impl Tally {
    /// Counts a match.
    pub fn add(&mut self, m: &Match) {
        self.count += 1;
        self.y_parallax2_px2 += m.y_parallax_px * m.y_parallax_px;
        self.depth_per_px_m += m.depth_per_px_m;
    }

    /// The sums of both.
    #[must_use]
    pub fn plus(self, other: Self) -> Self {
        Self {
            count: self.count + other.count,
            y_parallax2_px2: self.y_parallax2_px2 + other.y_parallax2_px2,
            depth_per_px_m: self.depth_per_px_m + other.depth_per_px_m,
        }
    }
}

/// The smooth field of a pair, its nodes drawn ahead over the rectified first image.
pub fn smooth_noise(
    key: &Key,
    recipe: FieldRecipe,
    first: &Depth,
    noisy: &Camera,
    rectification: &Rectification,
) -> Result<SmoothNoise, StageError> {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for (column, row) in outline(first.width, first.height) {
        let Some(ray) = noisy.normalised(full_pixel(column, row, first.downscale)) else {
            return Err(no_place(column, row, first)
                .hint("its lens distortion cannot be inverted there: check signs and units of the coefficients"));
        };
        let Some(Placed { position_px: p, .. }) = rectification.place(0, ray) else {
            return Err(no_place(column, row, first)
                .hint("the axes of the two images diverge too much: pair images that look the same way"));
        };
        (low, high) = ([low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])]);
    }
    let nodes = (high[0] - low[0]) * (high[1] - low[1]) / (recipe.spacing_px * recipe.spacing_px);
    if nodes > 1e8 {
        fail!("the rectified image would have {nodes:.0} nodes: the pair converges too strongly to be matched");
    }
    Ok(SmoothNoise::new(key, recipe, low, high))
}

fn no_place(column: usize, row: usize, depth: &Depth) -> StageError {
    StageError::new(format!(
        "pixel ({column}, {row}) of image `{}` has no place in the rectified image",
        depth.image.name
    ))
}

fn outline(width: usize, height: usize) -> impl Iterator<Item = (usize, usize)> {
    let rows = (0..height).flat_map(move |row| [(0, row), (width - 1, row)]);
    (0..width).flat_map(move |column| [(column, 0), (column, height - 1)]).chain(rows)
}

impl Matcher<'_> {
    /// Matches every pixel of image `own` (0 first, 1 second); `keep` writes a match, or its absence, to its row.
    ///
    /// Rows are worked on in parallel; every one is handed to `keep` in its own slice of `rows`. Same bits at any
    /// thread count.
    pub fn match_image<R: Send>(
        &self,
        own: usize,
        rows: &mut [R],
        keep: impl Fn(&mut R, usize, &Match) + Sync,
    ) -> Tally {
        let tallies: Vec<Tally> = rows
            .par_iter_mut()
            .enumerate()
            .map(|(row, out)| {
                let mut tally = Tally::default();
                let pixels = self.own_row(own, row);
                self.match_row(own, &pixels, |column, found| {
                    tally.add(found);
                    keep(out, column, found);
                });
                tally
            })
            .collect();
        tallies.into_iter().fold(Tally::default(), Tally::plus)
    }

    /// The pixels of a row that show something, of image `own` or of its rectified image.
    fn own_row(&self, own: usize, row: usize) -> OwnRow {
        let (ideal, cameras) = (self.ideal[own], [&self.cameras[own], &self.noisy[own]]);
        if self.rectified {
            rectified_row(ideal, cameras, &self.rectification, own, row)
        } else {
            OwnRow::new(ideal, cameras[0], cameras[1], row)
        }
    }

    /// Matches the pixels of a row of image `own`, from left to right.
    pub fn match_row(&self, own: usize, pixels: &OwnRow, mut found: impl FnMut(usize, &Match)) {
        let mut draws = self.row_of_draws(own, pixels);
        for pixel in &pixels.pixels {
            if let Some(m) = self.match_pixel(own, pixels.row, pixel, &mut draws) {
                found(pixel.column, &m);
            }
        }
    }

    /// The white draws of a row: the first image's are drawn ahead, the second looks its own up one by one.
    fn row_of_draws(&self, own: usize, pixels: &OwnRow) -> Draws<'_> {
        let noise = self.local.as_ref().map(|(_, noise)| noise);
        let mut draws = Draws {
            ahead: Vec::new(),
            row: pixels.row as i32,
            first: 0,
            noise: noise.map(LocalNoise::lookup),
            terms: self.terms.as_ref().map(Terms::lookups).unwrap_or_default(),
        };
        if let (0, Some(noise), [first, .., last]) = (own, noise, pixels.pixels.as_slice()) {
            draws.first = first.column as i32;
            draws.ahead.resize(last.column - first.column + 1, 0.0);
            noise.fill_row(draws.first, draws.row, &mut draws.ahead);
        }
        draws
    }

    #[inline]
    fn match_pixel(&self, own: usize, row: usize, pixel: &OwnPixel, draws: &mut Draws) -> Option<Match> {
        let other = 1 - own;
        let seen = self.cameras[other].to_camera(&pixel.point_m);
        if seen.z <= 0.0 {
            return None;
        }
        let inverse = 1.0 / seen.z;
        let seen_ray = [seen.x * inverse, seen.y * inverse];
        let seen_pixel = self.cameras[other].pixel(seen_ray)?;
        let seen_level = to_level(seen_pixel, 1.0 / f64::from(self.ideal[other].downscale));
        if !self.is_seen(other, seen_level, seen.z) {
            return None;
        }
        let seen_noisy_ray = if self.same_interior[other] {
            seen_ray
        } else {
            self.noisy_rays[other].ray(&self.noisy[other], seen_pixel, seen_ray)?
        };
        let own_place = self.rectification.place(own, pixel.noisy_ray)?;
        let other_place = self.rectification.place(other, seen_noisy_ray)?;
        let (first, second) = if own == 0 { (&own_place, &other_place) } else { (&other_place, &own_place) };
        let fb_px_m = self.rectification.focal_px * self.rectification.baseline_m;
        let ideal_px = first.position_px[0] - second.position_px[0];
        let level = [pixel.column as f64, row as f64];
        let (first_px, second_px) = match (self.rectified, own) {
            (true, _) => (first.position_px, second.position_px),
            (false, 0) => (level, seen_level),
            (false, _) => (seen_level, level),
        };
        let error = if let Some(terms) = &self.terms {
            let pixel_index = if self.rectified {
                source_pixel(self.ideal[own], &self.noisy[own], pixel.noisy_ray)?
            } else {
                row * self.ideal[own].width + pixel.column
            };
            let point_m = [pixel.point_m.x, pixel.point_m.y];
            let disparity_px_m = fb_px_m / own_place.slant;
            let rectified_px = first.position_px;
            let site = Site { first_px, second_px, rectified_px, point_m, pixel: pixel_index, disparity_px_m };
            terms.error(&site, &mut draws.terms)?
        } else {
            self.paper_noise(first_px, first.position_px, draws)
        };
        let matched_px = ideal_px + (error.local_px() + error.regular_px);
        let disparity_px = self.terms.as_ref().map_or(matched_px, |terms| terms.sub_pixel(matched_px));
        // Z = f B / D across the rectified plane, and dZ = Z^2 / (f B) dD; both along the own ray by its slant.
        let parallax_px = self.rectification.parallax_px(disparity_px)?;
        let (slant, noisy_ray) = if self.rectified {
            (1.0, rectified_ray(&self.rectification, own, level))
        } else {
            (own_place.slant, pixel.noisy_ray)
        };
        let depth_m = fb_px_m / (parallax_px * slant);
        Some(Match {
            depth_m,
            noisy_ray,
            ideal_px,
            error,
            sub_pixel_px: disparity_px - matched_px,
            disparity_px,
            y_parallax_px: first.position_px[1] - second.position_px[1],
            depth_per_px_m: depth_m / parallax_px,
        })
    }

    /// White and smooth noise of a pixel.
    #[inline]
    fn paper_noise(&self, first_px: [f64; 2], rectified_px: [f64; 2], draws: &mut Draws) -> DisparityError {
        let white_px = self.local.as_ref().map_or(0.0, |(sigma, _)| {
            let [column, row] = first_px.map(nearest);
            sigma * f64::from(draws.at(column, row))
        });
        let regular_px = self.smooth.as_ref().map_or(0.0, |(sigma, noise)| sigma * noise.at(rectified_px));
        DisparityError { white_px, blunder_px: 0.0, regular_px, relief_px: 0.0, strength: 1.0 }
    }

    /// Whether an image sees a point at depth `z_m` that projects to `level`: it is inside, and not behind all that the
    /// four nearest pixels show.
    #[inline]
    fn is_seen(&self, side: usize, [u, v]: [f64; 2], z_m: f64) -> bool {
        let depth = self.ideal[side];
        let (width, height) = (depth.width as f64, depth.height as f64);
        if !(u >= -0.5 && v >= -0.5 && u <= width - 0.5 && v <= height - 0.5) {
            return false;
        }
        let Some(tolerance) = self.occlusion_tolerance else { return true };
        let near = |x: f64, size: usize| {
            let below = floor(x);
            [below.max(0) as usize, ((below + 1) as usize).min(size - 1)]
        };
        let ([left, right], [top, bottom]) = (near(u, depth.width), near(v, depth.height));
        // The comparison with NaN is false: where nothing is shown nothing is seen.
        let passes = |row: usize, column: usize| {
            let shown = depth.z.get(row * depth.width + column).copied().unwrap_or(f32::NAN);
            z_m <= f64::from(shown) * (1.0 + tolerance)
        };
        passes(top, left) || passes(top, right) || passes(bottom, left) || passes(bottom, right)
    }
}

/// Full-image position in pixels of the depth-map level, whose pixels are `1 / scale` image pixels.
#[inline]
fn to_level(pixel: [f64; 2], scale: f64) -> [f64; 2] {
    pixel.map(|p| (p + 0.5) * scale - 0.5)
}

/// The white draws of one row: a stretch of the first image's own row drawn ahead, any other pixel looked up.
struct Draws<'a> {
    ahead: Vec<f32>,
    row: i32,
    first: i32,
    noise: Option<Lookup<'a>>,
    terms: Lookups<'a>,
}

impl Draws<'_> {
    fn at(&mut self, column: i32, row: i32) -> f32 {
        if row == self.row
            && let Some(draw) = self.ahead.get((column - self.first) as usize)
        {
            return *draw;
        }
        self.noise.as_mut().map_or(0.0, |noise| noise.at(column, row))
    }
}
