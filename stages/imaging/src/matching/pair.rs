//! The noisy depth map one image of a stereo pair would yield: true projections, noisy rectification, noisy disparity.
//!
//! For each pixel q of the image: the true point on its true ray at the ideal depth; its true projection into the other
//! image; both positions undistorted and rectified with the noisy cameras; disparity x1 - x2 plus noise; and back to a
//! depth on the noisy ray of q, whose own rectified row it keeps (paper 2.1.2, Algorithm 2 lines 10 to 19, Eq. 2 and 3).
//! Rows of the two positions differ by the y-parallax that wrong orientations cause; it is reported, never averaged in.
//! Pixels are those of the depth-map level throughout.

use rayon::prelude::*;

use crate::camera::model::{Camera, full_pixel};
use crate::matching::noise::paper::{FieldRecipe, LocalNoise, SmoothNoise};
use crate::matching::noise::terms::{DisparityError, Lookups, Site, Terms};
use crate::matching::noisy_rays::NoisyRays;
use crate::matching::pixel_row::{Block, OwnRow};
use crate::matching::rectification::{Placed, Rectification};
use crate::matching::rectified_row::{rectified_ray, rectified_row, source_pixel};
use rockface_core::StageError;
use rockface_core::artefact::Depth;
use rockface_core::fail;
use rockface_core::numerics::fast_round::{floor, nearest};
use rockface_core::numerics::random::Key;
use rockface_core::numerics::simd::{LANES, Lanes, Number, Work, both, vectorised};

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
        for block in pixels.blocks() {
            let mut shown = vectorised(Show { matcher: self, side: 1 - own, block: &block });
            let mut seen = [false; LANES];
            for (lane, seen) in seen.iter_mut().enumerate() {
                *seen = self.is_seen(1 - own, [shown.level[0][lane], shown.level[1][lane]], shown.z_m[lane]);
                if !*seen {
                    shown.hide(lane);
                }
            }
            if !seen.contains(&true) {
                continue;
            }
            let sights =
                vectorised(Place { matcher: self, own, row: pixels.row, block: &block, shown: &shown, draws: &draws });
            for (lane, column) in block.columns.iter().enumerate().filter(|(lane, _)| seen[*lane]) {
                let sight = Sight::of(&sights, lane);
                let matched = if self.terms.is_none() {
                    sight.matched()
                } else {
                    let point_m = [block.points_m[0][lane], block.points_m[1][lane]];
                    self.match_pixel(own, pixels.row, *column, point_m, &sight, &mut draws.terms)
                };
                if let Some(matched) = matched {
                    found(*column, &matched);
                }
            }
        }
    }

    /// The draws of a row: the first image's white ones are drawn ahead, the second looks its own up block by block.
    fn row_of_draws(&self, own: usize, pixels: &OwnRow) -> Draws<'_> {
        let noise = self.local.as_ref().map(|(_, noise)| noise);
        let mut draws = Draws {
            ahead: Vec::new(),
            row: pixels.row as i32,
            first: 0,
            terms: self.terms.as_ref().map(Terms::lookups).unwrap_or_default(),
        };
        if let (0, Some(noise), [first, .., last]) = (own, noise, pixels.columns.as_slice()) {
            draws.first = *first as i32;
            draws.ahead.resize(last - first + 1, 0.0);
            noise.fill_row(draws.first, draws.row, &mut draws.ahead);
        }
        draws
    }

    /// Where an image would show the points of some pixels, whatever is before them.
    #[inline(always)]
    fn shown(&self, side: usize, block: &Block) -> Shown {
        let [x, y, z_m] = self.cameras[side].to_camera_lanes(block.points_m);
        let inverse = Lanes::all(1.0) / z_m.where_positive(z_m);
        let ray = [x * inverse, y * inverse];
        let pixel = self.cameras[side].pixel_lanes(ray);
        Shown { z_m, ray, pixel, level: to_level(pixel, 1.0 / f64::from(self.ideal[side].downscale)) }
    }

    /// Where some pixels and their points in the other image are placed in the rectified images.
    #[inline(always)]
    fn sights(&self, own: usize, row: usize, block: &Block, shown: &Shown, draws: &Draws) -> Sight<Lanes> {
        let other = 1 - own;
        let noisy_ray = if self.same_interior[other] {
            shown.ray
        } else {
            self.noisy_rays[other].ray_lanes(&self.noisy[other], shown.pixel, shown.ray)
        };
        let own_place = self.rectification.place_lanes(own, block.noisy_rays);
        let other_place = self.rectification.place_lanes(other, noisy_ray);
        let [first, second] = if own == 0 { [&own_place, &other_place] } else { [&other_place, &own_place] };
        let column = Lanes::of(|lane| block.columns.get(lane).map_or(f64::NAN, |column| *column as f64));
        let level = [column, Lanes::all(row as f64)];
        let (first_px, second_px) = match (self.rectified, own) {
            (true, _) => (first.position_px, second.position_px),
            (false, 0) => (level, shown.level),
            (false, _) => (shown.level, level),
        };
        let rectified_px = first.position_px;
        let ideal_px = rectified_px[0] - second.position_px[0];
        let (white_px, regular_px) = (self.white_px(first_px, draws), self.regular_px(rectified_px));
        let disparity_px = ideal_px + (white_px + regular_px);
        // Z = f B / D across the rectified plane, and dZ = Z^2 / (f B) dD; both along the own ray by its slant.
        let slant = if self.rectified { Lanes::all(1.0) } else { own_place.slant };
        let parallax_px = disparity_px - self.rectification.shift_px();
        let depth_m = Lanes::all(self.fb_px_m()) / (parallax_px * slant);
        let noisy_ray = if self.rectified { rectified_ray(&self.rectification, own, level) } else { block.noisy_rays };
        Sight {
            own_ray: block.noisy_rays,
            noisy_ray,
            first_px,
            second_px,
            rectified_px,
            ideal_px,
            y_parallax_px: rectified_px[1] - second.position_px[1],
            disparity_px_m: Lanes::all(self.fb_px_m()) / own_place.slant,
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
        self.rectification.focal_px * self.rectification.baseline_m
    }

    /// Matches a pixel with the noise of `terms`.
    fn match_pixel(
        &self,
        own: usize,
        row: usize,
        column: usize,
        point_m: [f64; 2],
        sight: &Sight<f64>,
        lookups: &mut Lookups,
    ) -> Option<Match> {
        let Sight { first_px, second_px, rectified_px, ideal_px, noisy_ray, disparity_px_m, .. } = *sight;
        let terms = self.terms.as_ref().filter(|_| !ideal_px.is_nan())?;
        let pixel = if self.rectified {
            source_pixel(self.ideal[own], &self.noisy[own], sight.own_ray)?
        } else {
            row * self.ideal[own].width + column
        };
        let error =
            terms.error(&Site { first_px, second_px, rectified_px, point_m, pixel, disparity_px_m }, lookups)?;
        let matched_px = ideal_px + (error.local_px() + error.regular_px);
        let disparity_px = terms.sub_pixel(matched_px);
        let parallax_px = self.rectification.parallax_px(disparity_px)?;
        let depth_m = self.fb_px_m() / (parallax_px * sight.slant);
        Some(Match {
            depth_m,
            noisy_ray,
            ideal_px,
            error,
            sub_pixel_px: disparity_px - matched_px,
            disparity_px,
            y_parallax_px: sight.y_parallax_px,
            depth_per_px_m: depth_m / parallax_px,
        })
    }

    /// Smooth noise at some positions.
    #[inline(always)]
    fn regular_px(&self, rectified_px: [Lanes; 2]) -> Lanes {
        match &self.smooth {
            Some((sigma_px, noise)) => noise.at_lanes(rectified_px) * *sigma_px,
            None => Lanes::all(0.0),
        }
    }

    /// White noise of some pixels.
    #[inline(always)]
    fn white_px(&self, first_px: [Lanes; 2], draws: &Draws) -> Lanes {
        let Some((sigma_px, noise)) = &self.local else { return Lanes::all(0.0) };
        let (mut columns, mut rows, mut white) = ([0; LANES], [0; LANES], Lanes::all(0.0));
        let mut drawn = true;
        for (lane, (column, row)) in columns.iter_mut().zip(&mut rows).enumerate() {
            (*column, *row) = (nearest(first_px[0][lane]), nearest(first_px[1][lane]));
            match draws.ahead.get(column.wrapping_sub(draws.first) as usize) {
                Some(draw) if *row == draws.row => white.set(lane, f64::from(*draw)),
                _ => drawn = false,
            }
        }
        (if drawn { white } else { noise.at_lanes(columns, rows) }) * *sigma_px
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
#[inline(always)]
fn to_level<T: Number>(pixel: [T; 2], scale: f64) -> [T; 2] {
    both(pixel, |p| (p + 0.5) * scale - 0.5)
}

/// [`Matcher::shown`] of a block.
struct Show<'a> {
    matcher: &'a Matcher<'a>,
    side: usize,
    block: &'a Block<'a>,
}

impl Work for Show<'_> {
    type Output = Shown;

    #[inline(always)]
    fn run(self) -> Shown {
        self.matcher.shown(self.side, self.block)
    }
}

/// [`Matcher::sights`] of a block.
struct Place<'a> {
    matcher: &'a Matcher<'a>,
    own: usize,
    row: usize,
    block: &'a Block<'a>,
    shown: &'a Shown,
    draws: &'a Draws<'a>,
}

impl Work for Place<'_> {
    type Output = Sight<Lanes>;

    #[inline(always)]
    fn run(self) -> Sight<Lanes> {
        self.matcher.sights(self.own, self.row, self.block, self.shown, self.draws)
    }
}

/// Where an image would show points; none where it cannot.
struct Shown {
    /// Depths of the points in the image, metres.
    z_m: Lanes,
    /// Undistorted normalised coordinates of their true rays.
    ray: [Lanes; 2],
    /// Positions in the image, pixels.
    pixel: [Lanes; 2],
    /// The same, pixels of the depth map.
    level: [Lanes; 2],
}

impl Shown {
    /// Takes away what is not seen.
    #[inline]
    fn hide(&mut self, lane: usize) {
        let Self { ray, pixel, level, .. } = self;
        ray.iter_mut().chain(pixel).chain(level).for_each(|lanes| lanes.set(lane, f64::NAN));
    }
}

/// Where a point that both images see is placed, and what matching makes of it with the paper's noise; none where it has no place.
struct Sight<T> {
    /// Noisy ray of the own pixel.
    own_ray: [T; 2],
    /// The ray the depth is on: that, or the one of the rectified image.
    noisy_ray: [T; 2],
    /// Positions in the first and the second image that tell the noise, pixels of the depth map.
    first_px: [T; 2],
    /// See `first_px`.
    second_px: [T; 2],
    /// Position in the rectified first image, pixels.
    rectified_px: [T; 2],
    /// Disparity without noise of the matching, pixels.
    ideal_px: T,
    /// Row of the first rectified position less that of the second, pixels.
    y_parallax_px: T,
    /// Disparity that an inverse depth of 1/m is worth, pixel metres.
    disparity_px_m: T,
    /// Depth across the rectified plane of the point at depth 1 on the ray.
    slant: T,
    /// The paper's white noise, pixels.
    white_px: T,
    /// The paper's smooth noise, pixels.
    regular_px: T,
    /// Disparity with both, pixels.
    disparity_px: T,
    /// Depth it gives, metres.
    depth_m: T,
    /// Depth a pixel of disparity is worth, metres.
    depth_per_px_m: T,
}

impl Sight<f64> {
    #[inline]
    fn of(sights: &Sight<Lanes>, lane: usize) -> Self {
        let pair = |[one, other]: &[Lanes; 2]| [one[lane], other[lane]];
        Self {
            own_ray: pair(&sights.own_ray),
            noisy_ray: pair(&sights.noisy_ray),
            first_px: pair(&sights.first_px),
            second_px: pair(&sights.second_px),
            rectified_px: pair(&sights.rectified_px),
            ideal_px: sights.ideal_px[lane],
            y_parallax_px: sights.y_parallax_px[lane],
            disparity_px_m: sights.disparity_px_m[lane],
            slant: sights.slant[lane],
            white_px: sights.white_px[lane],
            regular_px: sights.regular_px[lane],
            disparity_px: sights.disparity_px[lane],
            depth_m: sights.depth_m[lane],
            depth_per_px_m: sights.depth_per_px_m[lane],
        }
    }

    /// The match with the paper's noise.
    #[inline]
    fn matched(&self) -> Option<Match> {
        let Self { white_px, regular_px, .. } = *self;
        (!self.depth_m.is_nan()).then_some(Match {
            depth_m: self.depth_m,
            noisy_ray: self.noisy_ray,
            ideal_px: self.ideal_px,
            error: DisparityError { white_px, blunder_px: 0.0, regular_px, relief_px: 0.0, strength: 1.0 },
            sub_pixel_px: 0.0,
            disparity_px: self.disparity_px,
            y_parallax_px: self.y_parallax_px,
            depth_per_px_m: self.depth_per_px_m,
        })
    }
}

/// The draws of one row: a stretch of the first image's own row of white noise drawn ahead, and those of further terms.
struct Draws<'a> {
    ahead: Vec<f32>,
    row: i32,
    first: i32,
    terms: Lookups<'a>,
}
