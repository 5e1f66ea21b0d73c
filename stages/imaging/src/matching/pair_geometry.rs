//! The geometry of a stereo pair: ideal depth maps, true and noisy cameras, and the rectification of the noisy ones.

use crate::camera::model::{Camera, full_pixel, outline};
use crate::matching::noise::paper::{FieldRecipe, SmoothNoise};
use crate::matching::rectification::Rectification;
use crate::matching::side::Side;
use rockface_core::StageError;
use rockface_core::artefact::Depth;
use rockface_core::numerics::random::Key;

/// Most nodes of the smooth noise of a pair.
const MOST_NODES: f64 = 1e8;

/// Depth maps and cameras of a pair. Arrays hold the first (left) image and the second.
pub struct PairGeometry<'a> {
    /// Ideal depth maps, with the true cameras.
    pub ideal: [&'a Depth; 2],
    /// Cameras of the true orientation, from which the ideal depths are seen.
    pub cameras: [Camera; 2],
    /// Cameras of the orientation that matching assumes.
    pub noisy: [Camera; 2],
    /// Rectification of the noisy cameras, at the level of the depth maps.
    pub rectification: Rectification,
}

impl<'a> PairGeometry<'a> {
    /// The geometry of two depth maps of one downscale. Fails where the noisy cameras cannot be rectified.
    pub fn new(ideal: [&'a Depth; 2], noisy: [Camera; 2]) -> Result<Self, StageError> {
        let rectification = Rectification::new([&noisy[0], &noisy[1]], ideal[0].downscale)?;
        Ok(Self { ideal, cameras: ideal.map(Camera::of_depth), noisy, rectification })
    }

    /// Cosine and sine, by columns and rows, of the direction in which an image has its partner: that of the baseline in the image
    /// plane, and of the epipolar line through the principal point.
    pub fn towards_partner(&self, side: Side) -> [f64; 2] {
        let (here, there) = (&self.noisy[side], &self.noisy[side.other()]);
        let base = here.camera_from_object() * (there.centre() - here.centre());
        let length = (base.x * base.x + base.y * base.y).sqrt();
        if length > 0.0 { [base.x / length, base.y / length] } else { [1.0, 0.0] }
    }

    /// The smooth noise of the pair; its nodes over the rectified first image are drawn once, here.
    pub fn smooth_noise(&self, key: &Key, recipe: FieldRecipe) -> Result<SmoothNoise, StageError> {
        let [low, high] = self.rectified_extent()?;
        let nodes = (high[0] - low[0]) * (high[1] - low[1]) / (recipe.spacing_px * recipe.spacing_px);
        if nodes > MOST_NODES {
            let text =
                format!("the smooth noise has {nodes:.0} nodes over the rectified image, {MOST_NODES:.0} are allowed");
            return Err(StageError::new(text)
                .hint("the views of the pair converge too much, or `spacing_px` is too small for the image"));
        }
        Ok(SmoothNoise::new(key, recipe, low, high))
    }

    /// Lowest and highest rectified position of the outermost pixels of the first image, pixels. Where the lens or the rectified plane has no
    /// place for one of them, those of all pixels that see something and have one.
    fn rectified_extent(&self) -> Result<[[f64; 2]; 2], StageError> {
        let depth = self.ideal[Side::First];
        let outermost = outline(depth.width, depth.height);
        let outermost = outermost.map(|pixel| self.placed(pixel).map_err(|why| (pixel, why)));
        match outermost.collect::<Result<Vec<_>, _>>() {
            Ok(positions) => Ok(extent(positions.into_iter())),
            Err((pixel, why)) => {
                let seeing = (0..depth.z.len()).filter(|at| depth.z[*at].is_finite());
                let mut placed =
                    seeing.filter_map(|at| self.placed((at % depth.width, at / depth.width)).ok()).peekable();
                if placed.peek().is_none() {
                    return Err(not_rectified(pixel, depth).hint(why));
                }
                Ok(extent(placed))
            }
        }
    }

    /// The rectified position of a pixel (column, row) of the first image, pixels; or why it has none.
    fn placed(&self, (column, row): (usize, usize)) -> Result<[f64; 2], &'static str> {
        let (depth, noisy) = (self.ideal[Side::First], &self.noisy[Side::First]);
        let ray = noisy.normalised(full_pixel(column, row, depth.downscale));
        let ray =
            ray.ok_or("its lens distortion cannot be inverted there: check signs and units of the coefficients")?;
        let placed = self.rectification.place(Side::First, ray);
        let placed = placed.ok_or("the axes of the two images diverge too much: pair images that look the same way")?;
        Ok(placed.position_px)
    }
}

/// Lowest and highest of some positions.
fn extent(positions: impl Iterator<Item = [f64; 2]>) -> [[f64; 2]; 2] {
    positions.fold([[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]], |[low, high], p| {
        [[low[0].min(p[0]), low[1].min(p[1])], [high[0].max(p[0]), high[1].max(p[1])]]
    })
}

fn not_rectified((column, row): (usize, usize), depth: &Depth) -> StageError {
    let name = &depth.image.name;
    StageError::new(format!("pixel ({column}, {row}) of image `{name}` has no position in the rectified image"))
}
