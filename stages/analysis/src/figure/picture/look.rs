//! How a raster, depth map, mesh or surface is looked at: which values, in which colours, over which range, in which unit.

use std::borrow::Cow;

use crate::figure::colour_scale::{ColourScale, Palette, class, is_confusion, length};
use rockface_core::StageError;
use rockface_core::artefact::{Depth, Grid, Raster};
use rockface_core::numerics::quantile::nearest_rank;
use rockface_raster::shape::Shape;

use super::Subject;

/// Shares of the values below and above the colours of elevations and depths.
const TAILS: f64 = 0.005;
/// Share of the absolute differences within the colours.
const DIFFERENCES: f64 = 0.98;

/// A grid of values and what they are.
#[derive(Debug, Clone, PartialEq)]
pub struct Look<'a> {
    /// Number of columns of `values`.
    pub columns: usize,
    /// Values by row from the top, NaN where there is none.
    pub values: Cow<'a, [f32]>,
    /// Side of a cell, metres.
    pub cell_m: Option<f64>,
    /// `elevation`, `difference`, `depth`, ...
    pub quantity: String,
    /// What is seen, as a title: the quantity with the band or image.
    pub title: String,
    /// The size of what is seen.
    pub grid: String,
}

fn no_band(wanted: &str, names: &[&str]) -> StageError {
    StageError::new(format!("there is no band `{wanted}`")).hint(format!("the bands are: {}", names.join(", ")))
}

impl<'a> Look<'a> {
    /// A band of a raster by name, or its first.
    pub fn of_raster(raster: &'a Raster, band: Option<&str>) -> Result<Self, StageError> {
        let found = match band {
            None => raster.bands.first(),
            Some(name) => raster.bands.iter().find(|band| band.name == name),
        };
        let names = || raster.bands.iter().map(|b| b.name.as_str()).collect::<Vec<_>>();
        let band = found.ok_or_else(|| no_band(band.unwrap_or("(first)"), &names()))?;
        let values = if is_confusion(&raster.quantity) {
            band.values.iter().map(|value| class(*value)).collect()
        } else {
            Cow::from(&band.values)
        };
        let suffix = if raster.bands.len() > 1 { format!(": {}", band.name) } else { String::new() };
        Ok(Self {
            columns: raster.grid.columns,
            values,
            cell_m: Some(raster.grid.cell_m),
            quantity: raster.quantity.clone(),
            title: format!("{}{suffix}", capitalised(&raster.quantity)),
            grid: format!("{} x {} cells of {}", raster.grid.columns, raster.grid.rows, length(raster.grid.cell_m)),
        })
    }

    /// A channel of a depth map by name, or the depth.
    pub fn of_depth(depth: &'a Depth, channel: Option<&str>) -> Result<Self, StageError> {
        let channel = channel.unwrap_or("depth");
        let values = if channel == "depth" { Some(&depth.z) } else { depth.channels.get(channel) };
        let names = || std::iter::once("depth").chain(depth.channels.keys().map(String::as_str)).collect::<Vec<_>>();
        let values = values.ok_or_else(|| no_band(channel, &names()))?;
        let scale =
            if depth.downscale > 1 { format!(", 1 pixel for {0} x {0}", depth.downscale) } else { String::new() };
        Ok(Self {
            columns: depth.width,
            values: values.into(),
            cell_m: None,
            quantity: channel.to_owned(),
            title: format!("{} of image {}", capitalised(channel), depth.image.name),
            grid: format!("{} x {} pixels{scale}", depth.width, depth.height),
        })
    }

    /// Elevations of a mesh, surface or cloud of this kind over a grid; `size_m` is its width and height.
    pub fn of_shape(shape: Shape, kind: &str, values: Vec<f32>, grid: &Grid, size_m: [f64; 2]) -> Look<'static> {
        let places = match shape {
            Shape::Mesh(mesh) | Shape::Part(mesh, _) => format!("{} triangles", mesh.triangles.len()),
            Shape::Surface(surface) => format!("{} x {} points", surface.width, surface.height),
            Shape::Cloud(cloud) => format!("{} points", cloud.points.len()),
        };
        Look {
            columns: grid.columns,
            values: values.into(),
            cell_m: Some(grid.cell_m),
            quantity: "elevation".to_owned(),
            title: format!("{} in the {} frame", capitalised(kind), shape.frame()),
            grid: format!("{places}, {:.2} x {:.2} m", size_m[0], size_m[1]),
        }
    }

    /// What is drawn with this scale.
    pub fn subject(&self, scale: ColourScale, title: String, shaded: bool) -> Subject<'_> {
        let missing = self.values.iter().filter(|v| v.is_nan()).count() as f64 / self.values.len() as f64;
        let missing = if missing > 0.0 { format!(", {:.1} % without value", 100.0 * missing) } else { String::new() };
        Subject {
            columns: self.columns,
            values: &self.values,
            cell_m: self.cell_m,
            shaded: shaded && self.quantity == "elevation",
            unit: unit(&self.quantity, &scale),
            scale,
            title,
            subtitle: format!("{}{missing}", self.grid),
            up: None,
        }
    }

    /// Colours that suit the values: diverging from zero for differences, in this palette or the one that suits; to
    /// `range_m` from zero or from the median, or so far that they hold 98 % of the differences, 99 % of elevations and
    /// depths, all of everything else; one for each class of a confusion. `None` where nothing has a value.
    pub fn scale(&self, palette: Option<Palette>, range_m: Option<f64>) -> Option<ColourScale> {
        if is_confusion(&self.quantity) && palette.is_none() {
            let some = self.values.iter().any(|value| !value.is_nan());
            return some.then_some(ColourScale::CLASSES);
        }
        let diverging = self.quantity == "difference";
        let suiting = if diverging { Palette::RedBlue } else { Palette::Viridis };
        let (low, high) = if diverging { self.symmetric(range_m)? } else { self.around_the_median(range_m)? };
        // A constant grid still gets a scale.
        let (low, high) = if high > low { (low, high) } else { (low - 0.5, low + 0.5) };
        Some(ColourScale { palette: palette.unwrap_or(suiting), low, high })
    }

    fn symmetric(&self, range_m: Option<f64>) -> Option<(f64, f64)> {
        let most = nearest_rank(self.values.iter().map(|v| v.abs()), DIFFERENCES)?;
        let reach = range_m.unwrap_or(most);
        Some((-reach, reach))
    }

    fn around_the_median(&self, range_m: Option<f64>) -> Option<(f64, f64)> {
        let at = |share| nearest_rank(self.values.iter().copied(), share);
        match range_m {
            Some(reach) => at(0.5).map(|median| (median - reach, median + reach)),
            None if is_length(&self.quantity) => Some((at(TAILS)?, at(1.0 - TAILS)?)),
            None => Some((at(0.0)?, at(1.0)?)),
        }
    }
}

fn is_length(quantity: &str) -> bool {
    matches!(quantity, "elevation" | "difference" | "depth")
}

/// The unit that values of a quantity are shown in, and how many of it make one of their own.
pub fn unit(quantity: &str, scale: &ColourScale) -> (&'static str, f64) {
    match (is_length(quantity), scale.high - scale.low < 0.5) {
        (true, true) => ("mm", 1e3),
        (true, false) => ("m", 1.0),
        (false, _) => ("", 1.0),
    }
}

/// A word with a capital.
pub fn capitalised(word: &str) -> String {
    let mut letters = word.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}
