//! `draw-picture`: draws a raster, depth map, mesh or surface for people to look at.

use crate::figure::colour_scale::{ColourScale, Palette};
use crate::figure::picture;
use crate::figure::picture::look::Look;
use rockface_core::artefact::{Artefact, Kind, Picture};
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, choice, params};
use rockface_raster::rasterise;
use rockface_raster::shape::Shape;

choice! {
    /// The colours.
    pub enum PictureColours {
        /// Red to blue for differences, a colour for each class of a confusion, viridis for everything else.
        Automatic = "automatic",
        /// Perceptually uniform, dark blue to yellow.
        Viridis = "viridis",
        /// The same for readers with a colour-vision deficiency.
        Cividis = "cividis",
        /// Red for negative, white for zero, blue for positive values.
        RedBlue = "red_blue",
        /// Black to white.
        Grey = "grey",
    }
}

params! {
    /// Parameters of `draw-picture`.
    pub struct DrawPictureParams {
        /// Title; left out, what is drawn.
        title: Option<String> = None,
        /// The colours reach from minus to plus this for differences, this far to either side of the median otherwise,
        /// in metres (or the values' own unit); left out, they hold 98 % of the differences, 99 % of other values.
        range_m: Option<f64> = None; Range::Positive,
        /// The colours.
        palette: PictureColours = PictureColours::Automatic,
        /// Name of the band of a raster or of the channel of a depth map; left out, the first band, the depth.
        band: Option<String> = None,
        /// Whether elevations, meshes and surfaces are shaded by a light from the upper left.
        hillshade: bool = true,
        /// Width of the picture at most, pixels.
        max_width_px: u32 = 1400; Range::Between(520.0, 16_384.0),
    }
}

/// Draws a raster, depth map, mesh or surface in false colours with a colour bar, a scale bar and a title.
pub struct DrawPicture;

impl Stage for DrawPicture {
    type Params = DrawPictureParams;
    const NAME: &'static str = "draw-picture";
    const VERSION: u32 = 5;
    const PAGE: Page = Page::new(include_str!("draw_picture.md"));
    const INPUTS: &'static [Port] = &[Port::one(
        "subject",
        &[Kind::Raster, Kind::Depth, Kind::Mesh, Kind::Surface],
        "What is drawn; meshes and surfaces are seen along Z.",
    )];
    const OUTPUTS: &'static [Port] = &[Port::one("picture", &[Kind::Picture], "PNG.")];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // The picture, and the triangles of a mesh as they are drawn.
        inputs.total() + inputs.total() * 6 / 10 + (4 << 20)
    }

    fn run(params: &Self::Params, inputs: &Inputs, _context: &Context) -> Result<Outputs, StageError> {
        let subject = inputs.artefact("subject")?;
        let band = params.band.as_deref();
        let look = match subject {
            Artefact::Raster(raster) => Look::of_raster(raster, band)?,
            Artefact::Depth(depth) => Look::of_depth(depth, band)?,
            other => of_shape(other, params)?,
        };
        let scale = scale(&look, params)?;
        let title = params.title.clone().unwrap_or_else(|| look.title.clone());
        let subject = look.subject(scale, title, params.hillshade);
        let png = picture::draw(&subject, params.max_width_px as usize);
        let png = png.map_err(|e| StageError::new(e.to_string()))?;
        Ok(Outputs::of("picture", Picture { png }))
    }
}

fn scale(look: &Look, params: &DrawPictureParams) -> Result<ColourScale, StageError> {
    let palette = match params.palette {
        PictureColours::Automatic => None,
        PictureColours::Viridis => Some(Palette::Viridis),
        PictureColours::Cividis => Some(Palette::Cividis),
        PictureColours::RedBlue => Some(Palette::RedBlue),
        PictureColours::Grey => Some(Palette::Grey),
    };
    let scale = look.scale(palette, params.range_m);
    scale.ok_or_else(|| StageError::new(format!("nothing to draw: no cell of the {} has a value", look.quantity)))
}

fn of_shape(artefact: &Artefact, params: &DrawPictureParams) -> Result<Look<'static>, StageError> {
    let shape = Shape::of(artefact).ok_or_else(|| StageError::new(format!("cannot draw a {}", artefact.kind())))?;
    let empty = || StageError::new(format!("nothing to draw: the {} has no points", artefact.kind()));
    let extent = rasterise::extent(shape, None).ok_or_else(empty)?;
    let longest = (extent[1] - extent[0]).max(extent[3] - extent[2]);
    // One cell a pixel; the grid may get one cell more than the extent has.
    let fitting = longest / (picture::full(params.max_width_px as usize).room(params.max_width_px as usize) - 1) as f64;
    let cell_m = if fitting > 0.0 { fitting } else { 1.0 };
    let grid = rasterise::grid_around(extent, cell_m)?;
    let size_m = [extent[1] - extent[0], extent[3] - extent[2]];
    Ok(Look::of_shape(shape, artefact.kind().word(), rasterise::tin(shape, None, &grid), &grid, size_m))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Grid, Raster};
    use rockface_core::params::ParamType;
    use rockface_core::testing::TestHost;
    use serde_json::json;
    use std::sync::Arc;

    fn run(with: &serde_json::Value, subject: impl Into<Artefact>) -> Result<Picture, StageError> {
        let mut inputs = Inputs::default();
        inputs.push("subject", rockface_core::Point::new(), Arc::new(subject.into()));
        let params = DrawPictureParams::decode(with).unwrap();
        let host = TestHost::default();
        let outputs = DrawPicture::run(&params, &inputs, &Context::new(&host))?;
        match outputs.into_inner().remove("picture") {
            Some(Artefact::Picture(picture)) => Ok(picture),
            other => panic!("{other:?}"),
        }
    }

    fn raster(quantity: &str, values: Vec<f32>) -> Raster {
        let grid = Grid { columns: 30, rows: values.len() / 30, cell_m: 0.1, left_m: 0.0, top_m: 3.0 };
        Raster::single(grid, Frame::Wall, quantity, quantity, values)
    }

    fn ramp() -> Vec<f32> {
        (0..900u16).map(|i| if i % 97 == 0 { f32::NAN } else { (f32::from(i) - 450.0) * 1e-4 }).collect()
    }

    #[test]
    fn equal_subjects_give_equal_files() {
        let draw = || run(&json!({}), raster("difference", ramp())).unwrap();
        assert_eq!(draw(), draw());
        assert!(draw().png.starts_with(b"\x89PNG"));
        assert_ne!(draw(), run(&json!({"range_m": 0.1}), raster("difference", ramp())).unwrap());
    }

    #[test]
    fn differences_are_centred_on_zero_and_elevations_are_not() {
        let params = DrawPictureParams::default();
        let scale = |raster: Raster| scale(&Look::of_raster(&raster, None).unwrap(), &params).unwrap();
        let shifted: Vec<f32> = ramp().iter().map(|v| v + 0.01).collect();
        let difference = scale(raster("difference", shifted.clone()));
        assert!((difference.low + difference.high).abs() < 1e-12 && difference.palette == Palette::RedBlue);
        let elevation = scale(raster("elevation", shifted));
        assert!((elevation.low + elevation.high - 0.02).abs() < 1e-3 && elevation.palette == Palette::Viridis);
    }

    #[test]
    fn a_confusion_has_a_colour_for_each_class() {
        let classes = |i: usize| [0.0, 1.0, 2.0, 3.0, 255.0][i % 5];
        let confusion = raster("confusion", (0..900).map(classes).collect());
        let look = Look::of_raster(&confusion, None).unwrap();
        let scale = scale(&look, &DrawPictureParams::default()).unwrap();
        let colours: Vec<_> = look.values[..5].iter().map(|value| scale.colour(f64::from(*value))).collect();
        let distinct: std::collections::BTreeSet<_> = colours.iter().collect();
        assert!(distinct.len() == 5 && look.values[4].is_nan(), "{colours:?}");
        assert!(run(&json!({}), confusion).is_ok());
        assert!(run(&json!({}), raster("confusion", vec![255.0; 900])).is_err());
    }

    #[test]
    fn what_cannot_be_drawn_says_why() {
        let error = run(&json!({"band": "b"}), raster("mask", vec![0.0; 900])).unwrap_err();
        assert_eq!(error.hint.unwrap(), "the bands are: mask");
        let error = run(&json!({}), raster("elevation", vec![f32::NAN; 900])).unwrap_err();
        assert!(error.message.contains("no cell of the elevation has a value"));
        assert!(run(&json!({}), raster("mask", vec![1.0; 900])).is_ok());
    }
}
