//! The noisy depth map one image of a stereo pair would yield: true projections, noisy rectification, noisy disparity.
//!
//! For each pixel q of the image: the true point on its true ray at the ideal depth; its true projection into the other
//! image; both positions undistorted and rectified with the noisy cameras; disparity x1 - x2 plus noise; and back to a
//! depth on the noisy ray of q, whose own rectified row it keeps (paper 2.1.2, Algorithm 2 lines 10 to 19, Eq. 2 and 3).
//! Rows of the two positions differ by the y-parallax that wrong orientations cause; it is reported, never averaged in.
//! Pixels are those of the depth-map level throughout.

use std::ops::RangeInclusive;

use rayon::prelude::*;

use crate::StageError;
use crate::artefact::Depth;
use crate::fail;
use crate::kernel::camera::{Camera, full_pixel};
use crate::kernel::matching_noise::{FieldRecipe, LocalNoise, SmoothNoise};
use crate::kernel::noise::terms::{DisparityError, Site, Terms};
use crate::kernel::random::Key;
use crate::kernel::ray_row::RayRow;
use crate::kernel::rectification::{Placed, Rectification};

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
}

/// One matched pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Match {
    /// Depth on the noisy ray, metres.
    pub depth_m: f64,
    /// Distance along the noisy ray, metres.
    pub range_m: f64,
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
    fn add(&mut self, m: &Match) {
        self.count += 1;
        self.y_parallax2_px2 += m.y_parallax_px * m.y_parallax_px;
        self.depth_per_px_m += m.depth_per_px_m;
    }

    fn plus(self, other: Self) -> Self {
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
                self.match_row(own, row, |column, found| {
                    tally.add(found);
                    keep(out, column, found);
                });
                tally
            })
            .collect();
        tallies.into_iter().fold(Tally::default(), Tally::plus)
    }

    fn match_row(&self, own: usize, row: usize, mut found: impl FnMut(usize, &Match)) {
        let depth = self.ideal[own];
        let values = &depth.z[row * depth.width..(row + 1) * depth.width];
        let valid = |z: &f32| z.is_finite();
        let (Some(from), Some(to)) = (values.iter().position(valid), values.iter().rposition(valid)) else { return };
        let draws = self.row_of_draws(own, row, from..=to);
        let mut rays = RayRow::new(&self.cameras[own], row, depth.downscale);
        for (column, z) in (from..=to).zip(&values[from..=to]).filter(|(_, z)| valid(z)) {
            let Some(ray) = rays.ray(column) else { continue };
            let pixel = full_pixel(column, row, depth.downscale);
            let draw = draws.get(column - from).copied();
            if let Some(m) = self.match_pixel(own, pixel, ray, f64::from(*z), draw) {
                found(column, &m);
            }
        }
    }

    /// The white draws of a stretch of a row of the first image; the second looks its own up one by one.
    fn row_of_draws(&self, own: usize, row: usize, columns: RangeInclusive<usize>) -> Vec<f32> {
        let mut draws = Vec::new();
        if let (0, Some((_, noise))) = (own, &self.local) {
            draws.resize(columns.end() - columns.start() + 1, 0.0);
            noise.fill_row(*columns.start() as i32, row as i32, &mut draws);
        }
        draws
    }

    /// `ray`: undistorted normalised coordinates of full-image position `pixel` in the true camera.
    fn match_pixel(&self, own: usize, pixel: [f64; 2], ray: [f64; 2], z_m: f64, draw: Option<f32>) -> Option<Match> {
        let other = 1 - own;
        let point = self.cameras[own].unproject(ray, z_m);
        let seen = self.cameras[other].to_camera(&point);
        let seen_pixel = self.cameras[other].project_from_camera(&seen)?;
        let seen_level = to_level(seen_pixel, self.ideal[other].downscale);
        if !self.is_seen(other, seen_level, seen.z) {
            return None;
        }
        let seen_ray = [seen.x / seen.z, seen.y / seen.z];
        let place = |side, ray| self.rectification.place(side, ray);
        let own_ray = self.noisy_ray(own, pixel, ray)?;
        let own_place = place(own, own_ray)?;
        let other_place = place(other, self.noisy_ray(other, seen_pixel, seen_ray)?)?;
        let (first, second) = if own == 0 { (&own_place, &other_place) } else { (&other_place, &own_place) };
        let fb_px_m = self.rectification.focal_px * self.rectification.baseline_m;
        let ideal_px = first.position_px[0] - second.position_px[0];
        let level = to_level(pixel, self.ideal[own].downscale);
        let (first_px, second_px) = if own == 0 { (level, seen_level) } else { (seen_level, level) };
        let error = if let Some(terms) = &self.terms {
            let pixel = level[1].round() as usize * self.ideal[own].width + level[0].round() as usize;
            let point_m = [point.x, point.y];
            let disparity_px_m = fb_px_m / own_place.slant;
            let rectified_px = first.position_px;
            terms.error(&Site { first_px, second_px, rectified_px, point_m, pixel, disparity_px_m })?
        } else {
            self.paper_noise(first_px, first.position_px, draw)
        };
        let matched_px = ideal_px + (error.local_px() + error.regular_px);
        let disparity_px = self.terms.as_ref().map_or(matched_px, |terms| terms.sub_pixel(matched_px));
        let distance_m = self.rectification.distance_m(disparity_px)?;
        Some(Match {
            depth_m: distance_m / own_place.slant,
            range_m: distance_m / own_place.slant * (own_ray[0] * own_ray[0] + own_ray[1] * own_ray[1] + 1.0).sqrt(),
            ideal_px,
            error,
            sub_pixel_px: disparity_px - matched_px,
            disparity_px,
            y_parallax_px: first.position_px[1] - second.position_px[1],
            depth_per_px_m: distance_m * distance_m / (fb_px_m * own_place.slant),
        })
    }

    /// White and smooth noise of a pixel; the white draw of the pixel may be at hand already.
    fn paper_noise(&self, first_px: [f64; 2], rectified_px: [f64; 2], draw: Option<f32>) -> DisparityError {
        let white_px = self.local.as_ref().map_or(0.0, |(sigma, noise)| {
            let [column, row] = first_px.map(|p| p.round() as i32);
            sigma * f64::from(draw.unwrap_or_else(|| noise.at(column, row)))
        });
        let regular_px = self.smooth.as_ref().map_or(0.0, |(sigma, noise)| sigma * noise.at(rectified_px));
        DisparityError { white_px, blunder_px: 0.0, regular_px, relief_px: 0.0, strength: 1.0 }
    }

    /// Undistorts a position with the noisy interior orientation, near where the true one puts it.
    fn noisy_ray(&self, side: usize, pixel: [f64; 2], true_ray: [f64; 2]) -> Option<[f64; 2]> {
        let noisy = &self.noisy[side];
        if noisy.sensor() == self.cameras[side].sensor() {
            return Some(true_ray);
        }
        noisy.normalised_near(pixel, true_ray).or_else(|| noisy.normalised(pixel))
    }

    /// Whether an image sees a point at depth `z_m` that projects to `level`: it is inside, and not behind all that the
    /// four nearest pixels show.
    fn is_seen(&self, side: usize, [u, v]: [f64; 2], z_m: f64) -> bool {
        let depth = self.ideal[side];
        let (width, height) = (depth.width as f64, depth.height as f64);
        if !(u >= -0.5 && v >= -0.5 && u <= width - 0.5 && v <= height - 0.5) {
            return false;
        }
        let Some(tolerance) = self.occlusion_tolerance else { return true };
        let near = |x: f64, size: f64| [x.floor().max(0.0) as usize, (x.floor() + 1.0).min(size - 1.0) as usize];
        let columns = near(u, width);
        let shown =
            near(v, height).into_iter().flat_map(|row| columns.map(|column| depth.z[row * depth.width + column]));
        // The comparison with NaN is false: where nothing is shown nothing is seen.
        shown.into_iter().any(|shown| z_m <= f64::from(shown) * (1.0 + tolerance))
    }
}

/// Full-image position in pixels of the depth-map level.
fn to_level(pixel: [f64; 2], downscale: u32) -> [f64; 2] {
    pixel.map(|p| (p + 0.5) / f64::from(downscale) - 0.5)
}
