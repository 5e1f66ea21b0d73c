//! The error of a matched disparity with all terms of a real matcher, each of which may be absent.
//!
//! With u and v the unit local and smooth fields, M the product of all modulations and s the deviation at ledges (from the relief r
//! within the matcher's window, `gain r^power`, and from the map of strength), the error of a pixel is
//! `M (u sqrt(sigma_local^2 + (1 - a) s^2) + s (w sqrt(a) + n) + v sigma_regular)`, where w is a field that is longer along the rows of the
//! image and n one number of the acquisition: what light and blur do to all ledges alike. Blunders are added, and at last
//! what the matcher's sub-pixel step does: locking towards whole disparities, and rounding to its step.

use crate::matching::noise::correlated::CorrelatedNoise;
use crate::matching::noise::model::Scaled;
use crate::matching::noise::modulation::{Blunders, Modulation, Patches};
use crate::matching::noise::paper::{LocalNoise, Lookup, SmoothNoise};
use crate::matching::noise::strength::Strength;
use crate::matching::side::Side;
use rockface_core::numerics::fast_round::nearest;
use rockface_core::numerics::portable_math;

/// A random field of unit variance, of one of the kinds that noise is made of.
#[derive(Debug, Clone)]
pub enum UnitField {
    /// Independent from pixel to pixel.
    White(LocalNoise),
    /// With a short-range correlation.
    Correlated(CorrelatedNoise),
    /// Drawn at nodes and interpolated between them.
    Smooth(SmoothNoise),
}

/// Position at which a field is evaluated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Address {
    /// At the pixel of the first image.
    First,
    /// At the pixel of the second image.
    Second,
    /// At the position in the rectified first image.
    Rectified,
}

impl Address {
    /// The pixel of an image.
    pub fn pixel(side: Side) -> Self {
        match side {
            Side::First => Self::First,
            Side::Second => Self::Second,
        }
    }
}

/// One of the fields that make up a noise, with its weight; squared weights add up to 1.
#[derive(Debug, Clone)]
pub struct Part {
    /// Factor on the field.
    pub weight: f64,
    /// Position at which it is evaluated.
    pub address: Address,
    /// The field of unit variance that is weighted.
    pub field: UnitField,
}

/// Where one pixel is matched: everything on which the terms depend.
#[derive(Debug, Clone, Copy)]
pub struct Site {
    /// Positions in the first image, the second image and the rectified first image, pixels of the depth map.
    pub first_px: [f64; 2],
    /// See `first_px`.
    pub second_px: [f64; 2],
    /// See `first_px`.
    pub rectified_px: [f64; 2],
    /// X and Y of the point in the frame of the cameras, metres.
    pub point_m: [f64; 2],
    /// Index of the pixel in the depth map that is made.
    pub pixel: usize,
    /// Disparity that an inverse depth of 1/m is worth, pixel metres.
    pub disparity_px_m: f64,
}

/// Noise that grows with the relief of the disparity within the matcher's window.
#[derive(Debug, Clone)]
pub struct Relief {
    /// Standard deviation of the noise for a relief of one pixel of disparity, pixels.
    pub gain: f64,
    /// Power of the relief it grows with.
    pub power: f64,
    /// Largest relief that counts, pixels.
    pub limit_px: f64,
    /// Relief of every pixel of the depth map that is made, as a deviation of inverse depth, 1/m.
    pub inverse_depth: Vec<f32>,
}

impl Relief {
    /// Deviation of the noise at a pixel, pixels.
    fn sigma_px(&self, site: &Site) -> f64 {
        let relief_px = f64::from(self.inverse_depth[site.pixel]) * site.disparity_px_m;
        self.gain * portable_math::pow(relief_px.min(self.limit_px), self.power)
    }
}

/// How the noise at ledges differs from all local noise.
#[derive(Debug, Clone)]
pub struct Ledges {
    /// a: share of the variance whose correlation is longer along the rows.
    pub along_share: f64,
    /// w: the field of this share.
    pub along: CorrelatedNoise,
    /// How many times longer along the rows than down the columns.
    pub along_rows: f64,
    /// n: the error common to all ledges of this acquisition, in deviations of their noise.
    pub common: f64,
}

impl Ledges {
    /// The part of the noise that only ledges have, in deviations of their noise: `w sqrt(a) + n`.
    fn unit(&self, site: &Site) -> f64 {
        let along = if self.along_share > 0.0 {
            self.along_share.sqrt() * self.along.at([site.first_px[0] / self.along_rows, site.first_px[1]])
        } else {
            0.0
        };
        along + self.common
    }
}

/// The error of a disparity, term by term.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DisparityError {
    /// Local noise, pixels.
    pub white_px: f64,
    /// Error of a match in the wrong place, pixels.
    pub blunder_px: f64,
    /// Smooth noise, pixels.
    pub regular_px: f64,
    /// Deviation that ledges (relief within the window, map of strength) give the local noise (part of `white_px`), pixels.
    pub relief_px: f64,
    /// Factor of acquisition, texture and conditions on local and smooth noise (part of both).
    pub strength: f64,
}

impl DisparityError {
    /// Local noise and blunder, pixels.
    pub fn local_px(&self) -> f64 {
        self.white_px + self.blunder_px
    }
}

/// All terms of the error of a disparity.
#[derive(Debug, Clone)]
pub struct Terms {
    /// Local noise, with the fields that make it up.
    pub local: Scaled<Vec<Part>>,
    /// Smooth noise, with the fields that make it up.
    pub regular: Scaled<Vec<Part>>,
    /// Factor on all noise of this acquisition.
    pub acquisition: f64,
    /// Strength by place on the face (metres), the same in every acquisition.
    pub texture: Option<Modulation>,
    /// Strength by place in the first image (pixels), new in every acquisition.
    pub conditions: Option<Modulation>,
    /// Growth with the relief within the window.
    pub relief: Option<Relief>,
    /// Strength by place from rasters of the site.
    pub map: Option<Strength>,
    /// How the noise at ledges differs; `None`: it is like all local noise.
    pub ledges: Option<Ledges>,
    /// Factor by which local noise is longer along the rows of the image.
    pub stretch: f64,
    /// Neighbourhoods matched to the wrong place.
    pub blunders: Option<Blunders>,
    /// Neighbourhoods not matched at all.
    pub holes: Option<Patches>,
    /// Largest pull towards the nearest whole disparity, pixels.
    pub locking_px: f64,
    /// Step disparities are rounded to, pixels; 0: none.
    pub step_px: f64,
}

impl Terms {
    /// The white fields of the local noise, for evaluation along a row.
    pub fn lookups(&self) -> Lookups<'_> {
        Lookups(self.local.field.iter().map(Part::lookup).collect())
    }

    /// The error of a disparity before the sub-pixel step; `None` in a hole.
    pub fn error(&self, site: &Site, lookups: &mut Lookups) -> Option<DisparityError> {
        if self.holes.as_ref().is_some_and(|holes| holes.covers(site.first_px)) {
            return None;
        }
        let strength = self.strength(site);
        let blunder_px = self.blunders.as_ref().map_or(0.0, |blunders| blunders.at(site.first_px));
        let [local_px, relief_px] = self.local_px(site, lookups);
        let white_px = strength * local_px;
        let regular_px = strength * self.regular.sigma_px * unit(&self.regular.field, site);
        Some(DisparityError { white_px, blunder_px, regular_px, relief_px, strength })
    }

    /// Local noise with that of ledges, and the deviation of the noise of ledges.
    fn local_px(&self, site: &Site, lookups: &mut Lookups) -> [f64; 2] {
        let [texture, ledge] = self.map.as_ref().map_or([1.0, 0.0], |map| map.parts(site.point_m));
        let relief_px = self.relief.as_ref().map_or(0.0, |relief| relief.sigma_px(site));
        let (sigma_px, excess_px) = (self.local.sigma_px * texture, self.local.sigma_px * ledge);
        let ledge2 = relief_px * relief_px + excess_px * excess_px;
        let (share, ledge_unit) =
            self.ledges.as_ref().map_or((0.0, 0.0), |ledges| (ledges.along_share, ledges.unit(site)));
        let common_px = (sigma_px * sigma_px + (1.0 - share) * ledge2).sqrt();
        [common_px * lookups.unit(&self.local.field, site, self.stretch) + ledge2.sqrt() * ledge_unit, ledge2.sqrt()]
    }

    fn strength(&self, site: &Site) -> f64 {
        let at = |modulation: &Option<Modulation>, place| modulation.as_ref().map_or(1.0, |m| m.at(place));
        self.acquisition * at(&self.texture, site.point_m) * at(&self.conditions, site.first_px)
    }

    /// A disparity after the matcher's sub-pixel step, pixels.
    pub fn sub_pixel(&self, disparity_px: f64) -> f64 {
        let turn = std::f64::consts::TAU * (disparity_px - disparity_px.floor());
        let pull = if self.locking_px > 0.0 { self.locking_px * portable_math::sin(turn) } else { 0.0 };
        let locked = disparity_px - pull;
        if self.step_px > 0.0 { (locked / self.step_px).round() * self.step_px } else { locked }
    }
}

/// The latest draws of each white part of the local noise; `None` for the other parts.
#[derive(Default)]
pub struct Lookups<'a>(Vec<Option<Lookup<'a>>>);

impl Lookups<'_> {
    /// The sum of the parts at a site, as [`unit`]; columns count `stretch` times less.
    fn unit(&mut self, parts: &[Part], site: &Site, stretch: f64) -> f64 {
        let value = |(part, lookup): (&Part, &mut Option<Lookup>)| match lookup {
            Some(lookup) => {
                let [column, row] = part.position(site, stretch).map(nearest);
                part.weight * f64::from(lookup.at(column, row))
            }
            None => part.value(site, stretch),
        };
        parts.iter().zip(&mut self.0).map(value).sum()
    }
}

impl Part {
    fn lookup(&self) -> Option<Lookup<'_>> {
        if let UnitField::White(noise) = &self.field { Some(noise.lookup()) } else { None }
    }

    fn position(&self, site: &Site, stretch: f64) -> [f64; 2] {
        let [column, row] = match self.address {
            Address::First => site.first_px,
            Address::Second => site.second_px,
            Address::Rectified => site.rectified_px,
        };
        [column / stretch, row]
    }

    fn value(&self, site: &Site, stretch: f64) -> f64 {
        let position = self.position(site, stretch);
        self.weight
            * match &self.field {
                UnitField::White(noise) => {
                    let [column, row] = position.map(nearest);
                    f64::from(noise.at(column, row))
                }
                UnitField::Correlated(noise) => noise.at(position),
                UnitField::Smooth(noise) => noise.at(position),
            }
    }
}

/// The sum of the parts at a site.
fn unit(parts: &[Part], site: &Site) -> f64 {
    parts.iter().map(|part| part.value(site, 1.0)).sum()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::matching::noise::modulation::smooth_field;
    use crate::matching::noise::paper::Distribution;
    use rockface_core::artefact::{Frame, Grid, Raster};
    use rockface_core::numerics::random::Key;

    const SITE: Site = Site {
        first_px: [3.0, 4.0],
        second_px: [1.0, 4.0],
        rectified_px: [3.0, 4.0],
        point_m: [0.0, 0.0],
        pixel: 0,
        disparity_px_m: 1000.0,
    };

    /// White local noise of 0.5 px and nothing else.
    fn plain() -> Terms {
        let white = UnitField::White(LocalNoise::new(&Key([1; 32]), Distribution::Gaussian));
        Terms {
            local: Scaled { sigma_px: 0.5, field: vec![Part { weight: 1.0, address: Address::First, field: white }] },
            regular: Scaled { sigma_px: 0.0, field: Vec::new() },
            acquisition: 1.0,
            texture: None,
            conditions: None,
            relief: None,
            map: None,
            ledges: None,
            stretch: 1.0,
            blunders: None,
            holes: None,
            locking_px: 0.0,
            step_px: 0.0,
        }
    }

    fn error(terms: &Terms, site: &Site) -> Option<DisparityError> {
        terms.error(site, &mut terms.lookups())
    }

    #[test]
    fn relief_adds_in_squares_and_the_acquisition_multiplies() {
        let bare = error(&plain(), &SITE).unwrap().local_px();
        let relief = Some(Relief { gain: 2.0, power: 2.0, limit_px: 3.0, inverse_depth: vec![6e-4] });
        let more = error(&Terms { relief, acquisition: 1.5, ..plain() }, &SITE).unwrap().local_px();
        let expected = 1.5 * (0.25f64 + 0.72 * 0.72).sqrt() / 0.5;
        assert!((more / bare - expected).abs() < 1e-6, "{more} {bare}");
    }

    #[test]
    fn ledges_have_a_sign_in_common_and_the_map_parts_them_from_texture() {
        let grid = Grid { columns: 1, rows: 1, cell_m: 1.0, left_m: -0.5, top_m: 0.5 };
        let map = Strength::new(&Raster::single(grid, Frame::Wall, "strength", "", vec![5.0]), 3.0);
        let along = || CorrelatedNoise::new(2.0, 0.5, |_| Key([3; 32]), [0.0; 2], [9.0; 2]);
        let ledges = |common: f64| Some(Ledges { along_share: 0.0, along: along(), along_rows: 1.0, common });
        let with = |common: f64| {
            let terms = Terms { map: Some(map.clone()), ledges: ledges(common), ..plain() };
            error(&terms, &SITE).unwrap().local_px()
        };
        let bare = error(&plain(), &SITE).unwrap().local_px();
        assert!((with(0.0) / bare - 5.0).abs() < 1e-9);
        // Four of the five are the ledge's: sqrt(25 - 9) times 0.5 px.
        assert!((with(0.25) - with(0.0) - 0.25 * 4.0 * 0.5).abs() < 1e-9);
        let all_along = Ledges { along_share: 1.0, along: along(), along_rows: 1.0, common: 0.0 };
        let terms = Terms { map: Some(map.clone()), ledges: Some(all_along), ..plain() };
        let expected = 3.0 * bare + 2.0 * along().at(SITE.first_px);
        assert!((error(&terms, &SITE).unwrap().local_px() - expected).abs() < 1e-9);
    }

    #[test]
    fn a_hole_has_no_disparity_and_a_blunder_moves_it() {
        let field = || smooth_field(&Key([2; 32]), 5.0, [0.0; 2], [9.0; 2]);
        let holes = Some(Patches::new(1.0, field()));
        assert_eq!(error(&Terms { holes, ..plain() }, &SITE), None);
        let blunders = Some(Blunders { patches: Patches::new(1.0, field()), sigma_px: 4.0, error: field() });
        let with = error(&Terms { blunders, ..plain() }, &SITE).unwrap().local_px();
        let without = error(&plain(), &SITE).unwrap().local_px();
        assert!((with - without - 4.0 * field().at(SITE.first_px)).abs() < 1e-12);
    }

    #[test]
    fn locking_pulls_to_whole_disparities_and_steps_round() {
        let terms = Terms { locking_px: 0.05, ..plain() };
        assert!((terms.sub_pixel(7.25) - 7.2).abs() < 1e-12 && (terms.sub_pixel(7.75) - 7.8).abs() < 1e-12);
        assert!((terms.sub_pixel(-3.0) + 3.0).abs() < 1e-12);
        let steps = Terms { step_px: 0.0625, ..plain() };
        assert!((steps.sub_pixel(1.09) - 1.0625).abs() < 1e-12);
    }
}
