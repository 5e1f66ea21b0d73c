//! The noisy depth map that one image of a stereo pair yields: true projections, noisy rectification, noisy disparity.
//!
//! For each pixel q of the image: the true point on the true ray of q at the ideal depth; its true projection into the
//! partner image; both positions undistorted and rectified with the noisy cameras; disparity x1 - x2 plus noise; and back
//! to a depth on the noisy ray of q, whose rectified row is kept (paper 2.1.2, Algorithm 2 lines 10 to 19, Eq. 2 and 3).
//! Wrong orientations make the rows of the two positions differ; this y-parallax is reported and does not change the depth.
//! Pixels are those of the depth map throughout.

use rayon::prelude::*;

use crate::matching::correspondence::{Correspondence, Projected};
use crate::matching::matched::{Match, TakeMatches, Tally};
use crate::matching::noise::model::NoiseModel;
use crate::matching::noise::terms::{Lookups, Site, Terms};
use crate::matching::noisy_rays::NoisyRays;
use crate::matching::pair_geometry::PairGeometry;
use crate::matching::pixel_row::{Block, PixelRow};
use crate::matching::rectified_row::{rectified_ray, rectified_row, source_pixel};
use crate::matching::side::Side;
use rockface_core::artefact::Depth;
use rockface_core::choice;
use rockface_core::numerics::fast_round::{floor, nearest, whole};
use rockface_core::numerics::simd::{LANES, Lanes, Number, Work, both, vectorised};

choice! {
    /// Where disparities are sampled.
    pub enum Sampling {
        /// At the pixels of the image whose depth map is made.
        Image = "image",
        /// At the pixels of its rectified image, as the paper has it: the depth map is that of the rectified camera.
        Rectified = "rectified",
    }
}

/// A pair ready to be matched for the depth map of one of its images.
pub struct Matcher<'a> {
    geometry: PairGeometry<'a>,
    /// The image whose depth map is made; the other one is its partner.
    side: Side,
    sampling: Sampling,
    noise: NoiseModel,
    /// Relative depth by which a point may lie behind the surface that the partner sees; `None`: nothing hides a point.
    occlusion_tolerance: Option<f64>,
    /// Rays of the partner's noisy camera from those of the true one; `None` where both have one interior orientation.
    partner_rays: Option<NoisyRays>,
    /// Errors of the user's own by pixel of the depth map, pixels.
    errors: Option<&'a [f32]>,
}

impl<'a> Matcher<'a> {
    /// The matcher of a pair for the depth map of image `side`.
    pub fn new(
        geometry: PairGeometry<'a>,
        side: Side,
        sampling: Sampling,
        noise: NoiseModel,
        occlusion_tolerance: Option<f64>,
    ) -> Self {
        let (camera, noisy) = (&geometry.cameras[side.other()], &geometry.noisy[side.other()]);
        let partner_rays = (!noisy.has_interior_of(camera)).then(|| NoisyRays::new(camera, noisy));
        Self { geometry, side, sampling, noise, occlusion_tolerance, partner_rays, errors: None }
    }

    /// The same with errors of the user's own, one for each pixel of the depth map, added to the disparities.
    #[must_use]
    pub fn with_errors(self, errors: Option<&'a [f32]>) -> Self {
        Self { errors, ..self }
    }

    /// The user's own error at a pixel of the depth map; 0 where there are none.
    #[inline]
    fn own_error_px(&self, row: usize, column: usize) -> f64 {
        let width = self.geometry.ideal[self.side].width;
        self.errors.map_or(0.0, |errors| f64::from(errors[row * width + column]))
    }

    /// Depth maps, cameras and rectification of the pair.
    pub fn geometry(&self) -> &PairGeometry<'a> {
        &self.geometry
    }

    /// Matches every pixel of the depth map; each of `rows` takes the matches of one of its rows.
    ///
    /// Rows are processed in parallel. The bits do not depend on the number of threads.
    pub fn match_image<R: TakeMatches + Send>(&self, rows: &mut [R]) -> Tally {
        let match_row = |(row, out): (usize, &mut R)| self.match_row(&self.pixel_row(row), out);
        let tallies: Vec<Tally> = rows.par_iter_mut().enumerate().map(match_row).collect();
        tallies.into_iter().fold(Tally::default(), Tally::plus)
    }

    /// The pixels with a depth in a row of the image, or of the rectified image where disparities are sampled there.
    pub fn pixel_row(&self, row: usize) -> PixelRow {
        let PairGeometry { ideal, cameras, noisy, .. } = &self.geometry;
        match self.sampling {
            Sampling::Image => PixelRow::new(ideal[self.side], &cameras[self.side], &noisy[self.side], row),
            Sampling::Rectified => rectified_row(&self.geometry, self.side, row),
        }
    }

    /// Matches the pixels of a row, from left to right.
    pub fn match_row(&self, pixels: &PixelRow, out: &mut impl TakeMatches) -> Tally {
        vectorised(MatchRow { matcher: self, pixels, out })
    }

    /// The draws of a row. White noise is addressed by pixels of the first image: for a row of that image it is drawn
    /// in one go; for the second image it is looked up block by block.
    fn row_draws(&self, pixels: &PixelRow) -> RowDraws<'_> {
        let mut draws = RowDraws { row: pixels.row as i32, ..RowDraws::default() };
        match (&self.noise, self.side, pixels.columns.as_slice()) {
            (NoiseModel::Terms(terms), _, _) => draws.terms = terms.lookups(),
            (NoiseModel::Paper { local: Some(local), .. }, Side::First, [first, .., last]) => {
                draws.first_column = *first as i32;
                draws.in_row = self.sampling == Sampling::Image;
                draws.white.resize(last - first + 1, 0.0);
                local.field.fill_row(draws.first_column, draws.row, &mut draws.white);
            }
            _ => {}
        }
        draws
    }

    /// Projections of the points of a block into the partner image; what may hide them is not regarded.
    #[inline(always)]
    fn project(&self, block: &Block) -> Projected {
        let partner = self.side.other();
        let camera = &self.geometry.cameras[partner];
        let [x, y, z_m] = camera.to_camera_lanes(block.points_m);
        let inverse = Lanes::all(1.0) / z_m.where_positive(z_m);
        let ray = [x * inverse, y * inverse];
        let pixel = camera.pixel_lanes(ray);
        let level = to_level(pixel, 1.0 / f64::from(self.geometry.ideal[partner].downscale));
        Projected { z_m, ray, pixel, level }
    }

    /// Rectifies the pixels of a block and their projections, and adds the paper's noise, or the learnt one, to the disparities.
    #[inline(always)]
    fn correspond(&self, row: usize, block: &Block, projected: &Projected, draws: &RowDraws) -> Correspondence<Lanes> {
        let (side, partner) = (self.side, self.side.other());
        let rectification = &self.geometry.rectification;
        let partner_ray = match &self.partner_rays {
            Some(rays) => rays.ray_lanes(&self.geometry.noisy[partner], projected.pixel, projected.ray),
            None => projected.ray,
        };
        let placed = rectification.place_lanes(side, block.noisy_rays);
        let partner_placed = rectification.place_lanes(partner, partner_ray);
        let [first, second] = side.array(&placed, &partner_placed);
        let column = Lanes::of(|lane| block.columns.get(lane).map_or(f64::NAN, |column| *column as f64));
        let level = [column, Lanes::all(row as f64)];
        // Z = f B / D across the rectified plane, and dZ = Z^2 / (f B) dD; the slant gives both along the ray.
        let (noise_px, slant, depth_ray) = match self.sampling {
            Sampling::Image => (side.array(level, projected.level), placed.slant, block.noisy_rays),
            Sampling::Rectified => {
                let positions = [first.position_px, second.position_px];
                (positions, Lanes::all(1.0), rectified_ray(rectification, side, level))
            }
        };
        let rectified_px = first.position_px;
        let ideal_px = rectified_px[0] - second.position_px[0];
        let ideal_parallax_px = ideal_px - rectification.shift_px();
        let white_px = self.local_px(block, noise_px[0], ideal_parallax_px, draws);
        let regular_px = self.regular_px(rectified_px);
        let mut disparity_px = ideal_px + (white_px + regular_px);
        if self.errors.is_some() {
            let own = |lane| block.columns.get(lane).map_or(f64::NAN, |column| self.own_error_px(row, *column));
            disparity_px = disparity_px + Lanes::of(own);
        }
        let parallax_px = disparity_px - rectification.shift_px();
        let depth_m = Lanes::all(self.fb_px_m()) / (parallax_px * slant);
        Correspondence {
            image_ray: block.noisy_rays,
            depth_ray,
            noise_px,
            rectified_px,
            ideal_px,
            y_parallax_px: rectified_px[1] - second.position_px[1],
            image_slant: placed.slant,
            slant,
            white_px,
            regular_px,
            disparity_px,
            depth_m: depth_m.where_positive(parallax_px),
            depth_per_px_m: depth_m / parallax_px,
        }
    }

    /// Principal distance times baseline, pixel metres.
    #[inline]
    fn fb_px_m(&self) -> f64 {
        self.geometry.rectification.focal_px * self.geometry.rectification.baseline_m
    }

    /// Matches a pixel with all terms of the noise; `None` in a hole, or where the disparity gives no depth.
    fn match_with_terms(
        &self,
        terms: &Terms,
        lookups: &mut Lookups,
        [column, row]: [usize; 2],
        point_m: [f64; 2],
        correspondence: &Correspondence<f64>,
    ) -> Option<Match> {
        let Correspondence { noise_px, rectified_px, ideal_px, image_slant, .. } = *correspondence;
        if ideal_px.is_nan() {
            return None;
        }
        let depth = self.geometry.ideal[self.side];
        let pixel = match self.sampling {
            Sampling::Image => row * depth.width + column,
            Sampling::Rectified => source_pixel(depth, &self.geometry.noisy[self.side], correspondence.image_ray)?,
        };
        let [first_px, second_px] = noise_px;
        let disparity_px_m = self.fb_px_m() / image_slant;
        let error =
            terms.error(&Site { first_px, second_px, rectified_px, point_m, pixel, disparity_px_m }, lookups)?;
        let mut matched_px = ideal_px + (error.local_px() + error.regular_px);
        if self.errors.is_some() {
            matched_px += self.own_error_px(row, column);
        }
        let disparity_px = terms.sub_pixel(matched_px);
        let parallax_px = self.geometry.rectification.parallax_px(disparity_px)?;
        let depth_m = self.fb_px_m() / (parallax_px * correspondence.slant);
        Some(Match {
            depth_m,
            noisy_ray: correspondence.depth_ray,
            ideal_px,
            error,
            sub_pixel_px: disparity_px - matched_px,
            disparity_px,
            y_parallax_px: correspondence.y_parallax_px,
            depth_per_px_m: depth_m / parallax_px,
        })
    }

    /// The paper's smooth noise at some positions.
    #[inline(always)]
    fn regular_px(&self, rectified_px: [Lanes; 2]) -> Lanes {
        match &self.noise {
            NoiseModel::Paper { smooth: Some(smooth), .. } => smooth.field.at_lanes(rectified_px) * smooth.sigma_px,
            _ => Lanes::all(0.0),
        }
    }

    /// The learnt noise of some pixels, or the paper's white noise.
    #[inline(always)]
    fn local_px(&self, block: &Block, first_px: [Lanes; 2], parallax_px: Lanes, draws: &RowDraws) -> Lanes {
        match &self.noise {
            NoiseModel::Learnt(noise) => {
                let centre = self.geometry.cameras[self.side].centre();
                noise.landing_lanes(block.points_m, [centre.x, centre.y, centre.z], parallax_px)
            }
            _ => self.white_px(block, first_px, draws),
        }
    }

    /// The paper's white noise of some pixels.
    #[inline(always)]
    fn white_px(&self, block: &Block, first_px: [Lanes; 2], draws: &RowDraws) -> Lanes {
        let NoiseModel::Paper { local: Some(local), .. } = &self.noise else { return Lanes::all(0.0) };
        if draws.in_row {
            let at = |column: &usize| f64::from(draws.white[column - draws.first_column as usize]);
            return Lanes::of(|lane| block.columns.get(lane).map_or(0.0, at)) * local.sigma_px;
        }
        let (mut columns, mut rows, mut white) = ([0; LANES], [0; LANES], Lanes::all(0.0));
        let mut drawn = true;
        for (lane, (column, row)) in columns.iter_mut().zip(&mut rows).enumerate() {
            (*column, *row) = (nearest(first_px[0][lane]), nearest(first_px[1][lane]));
            match draws.white.get(column.wrapping_sub(draws.first_column) as usize) {
                Some(draw) if *row == draws.row => white.set(lane, f64::from(*draw)),
                _ => drawn = false,
            }
        }
        (if drawn { white } else { local.field.at_lanes(columns, rows) }) * local.sigma_px
    }

    /// [`Matcher::partner_sees`] for each of several points.
    #[inline(always)]
    #[allow(clippy::needless_bitwise_bool)] // branches would keep the lanes apart
    fn partner_sees_lanes(&self, Projected { z_m, level: [u, v], .. }: &Projected) -> [bool; LANES] {
        let depth = self.geometry.ideal[self.side.other()];
        let Some(last) = depth.z.len().checked_sub(1) else { return [false; LANES] };
        // Most points are not behind what is seen at the pixel above left of them, which is looked up for all of them together;
        // for what is outside, any pixel will do.
        let pixel = |position: Lanes| position.map(f64::floor).at_least(Lanes::all(0.0));
        let at = pixel(*v) * depth.width as f64 + pixel(*u);
        let mut surface_m = [0.0; LANES];
        for (lane, surface_m) in surface_m.iter_mut().enumerate() {
            *surface_m = depth.z[whole(at[lane]).min(last)];
        }
        let surface_m: Lanes = Lanes::of(|lane| f64::from(surface_m[lane]));
        let bound_m = self.occlusion_tolerance.map_or(Lanes::NONE, |tolerance| surface_m * (1.0 + tolerance));
        let mut seen = [false; LANES];
        for (lane, seen) in seen.iter_mut().enumerate() {
            *seen = is_inside(depth, [u[lane], v[lane]]) & (z_m[lane] <= bound_m[lane]);
        }
        if !all_of(seen) {
            for (lane, seen) in seen.iter_mut().enumerate().filter(|(_, seen)| !**seen) {
                *seen = self.partner_sees([u[lane], v[lane]], z_m[lane]);
            }
        }
        seen
    }

    /// Whether the partner sees a point at depth `z_m` that projects to `level`: the position is inside the image, and
    /// at one of the four nearest pixels the point is not behind the surface.
    #[inline]
    fn partner_sees(&self, [u, v]: [f64; 2], z_m: f64) -> bool {
        let depth = self.geometry.ideal[self.side.other()];
        if !is_inside(depth, [u, v]) {
            return false;
        }
        let Some(tolerance) = self.occlusion_tolerance else { return true };
        let near = |x: f64, size: usize| {
            let below = floor(x);
            [below.max(0) as usize, ((below + 1) as usize).min(size - 1)]
        };
        let ([left, right], [top, bottom]) = (near(u, depth.width), near(v, depth.height));
        // A comparison with NaN is false: the point is not seen at a pixel without depth.
        let passes = |row: usize, column: usize| {
            let surface_m = depth.z.get(row * depth.width + column).copied().unwrap_or(f32::NAN);
            z_m <= f64::from(surface_m) * (1.0 + tolerance)
        };
        passes(top, left) || passes(top, right) || passes(bottom, left) || passes(bottom, right)
    }
}

/// Whether all are true, without a branch for each.
#[inline(always)]
fn all_of(answers: [bool; LANES]) -> bool {
    answers.into_iter().fold(true, |all, answer| all & answer)
}

/// Whether a position, in pixels of a depth map, lies on one of its pixels.
#[inline(always)]
#[allow(clippy::needless_bitwise_bool)] // branches would keep the lanes apart
fn is_inside(depth: &Depth, [u, v]: [f64; 2]) -> bool {
    let (right, bottom) = (depth.width as f64 - 0.5, depth.height as f64 - 0.5);
    (u >= -0.5) & (v >= -0.5) & (u <= right) & (v <= bottom)
}

/// Full-image position in pixels of the depth map, which are `1 / scale` image pixels wide.
#[inline(always)]
fn to_level<T: Number>(pixel: [T; 2], scale: f64) -> [T; 2] {
    both(pixel, |p| (p + 0.5) * scale - 0.5)
}

/// Matches the pixels of a row, in wide registers.
struct MatchRow<'a, T> {
    matcher: &'a Matcher<'a>,
    pixels: &'a PixelRow,
    out: &'a mut T,
}

impl<T: TakeMatches> Work for MatchRow<'_, T> {
    type Output = Tally;

    #[inline(always)]
    fn run(self) -> Tally {
        let Self { matcher, pixels, out } = self;
        let (mut draws, mut tally) = (matcher.row_draws(pixels), Tally::default());
        let has_terms = matches!(matcher.noise, NoiseModel::Terms(_));
        for start in pixels.starts() {
            let block = pixels.block(start);
            let mut projected = matcher.project(&block);
            let seen = matcher.partner_sees_lanes(&projected);
            let all_seen = all_of(seen);
            if !all_seen {
                if !seen.contains(&true) {
                    continue;
                }
                projected.keep(seen);
            }
            let correspondences = matcher.correspond(pixels.row, &block, &projected, &draws);
            let Correspondence { y_parallax_px, depth_m, depth_per_px_m, .. } = correspondences;
            // Most blocks: all of its pixels are neighbours with a depth.
            if !has_terms
                && all_seen
                && let Some(first) = block.first_of_neighbours()
                && depth_m.every(|depth_m| !depth_m.is_nan())
                && out.take_depths(first, depth_m, depth_per_px_m)
            {
                tally.add_lanes(y_parallax_px, depth_per_px_m);
                continue;
            }
            for (lane, column) in block.columns.iter().enumerate().filter(|(lane, _)| seen[*lane]) {
                let correspondence = Correspondence::of(&correspondences, lane);
                let mut take = |matched: Match| {
                    tally.add(&matched);
                    out.take(*column, &matched);
                };
                // Each kind of noise hands on its match by itself: one that both put somewhere first would have to be read back from there.
                match &matcher.noise {
                    NoiseModel::Paper { .. } | NoiseModel::Learnt(_) if correspondence.depth_m.is_nan() => {}
                    NoiseModel::Paper { .. } | NoiseModel::Learnt(_) => take(correspondence.matched()),
                    NoiseModel::Terms(terms) => {
                        let point_m = [block.points_m[0][lane], block.points_m[1][lane]];
                        let pixel = [*column, pixels.row];
                        let matched =
                            matcher.match_with_terms(terms, &mut draws.terms, pixel, point_m, &correspondence);
                        if let Some(matched) = matched {
                            take(matched);
                        }
                    }
                }
            }
        }
        tally
    }
}

/// Random draws of one row.
#[derive(Default)]
struct RowDraws<'a> {
    row: i32,
    /// White noise of the first image in this row, from `first_column` on; empty where it is looked up instead.
    white: Vec<f32>,
    first_column: i32,
    /// Whether the pixels of the row lie in the row of the first image that `white` is for.
    in_row: bool,
    /// White fields of further terms.
    terms: Lookups<'a>,
}
