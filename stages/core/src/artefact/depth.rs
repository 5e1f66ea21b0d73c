//! The depth map of one image, with its camera, kept as OpenEXR.

use std::collections::BTreeMap;

use super::{Frame, Image, Sensor};

/// A depth map: z along the optical axis at the pixel centres of an image reduced by `downscale`.
///
/// Depth-map pixel (u, v) is image position `((u + 0.5) downscale - 0.5, (v + 0.5) downscale - 0.5)`; the point is
/// `C + z R^T (x, y, 1)` with (x, y) the undistorted normalised coordinates of that position.
#[derive(Debug, Clone)]
pub struct Depth {
    /// The frame of the camera.
    pub frame: Frame,
    /// Interior orientation the rays are made with.
    pub sensor: Sensor,
    /// Exterior orientation the rays are made with; its name is the image's. `sensor` in it is 0.
    pub image: Image,
    /// Image pixels a depth-map pixel, along each side.
    pub downscale: u32,
    /// Number of columns of the map, not of the image.
    pub width: usize,
    /// Number of rows of the map, not of the image.
    pub height: usize,
    /// Depth along the optical axis in metres, by row from the top, NaN where there is none.
    pub z: Vec<f32>,
    /// Further channels of the same size by name (`disparity`, `noise.local`, ...).
    pub channels: BTreeMap<String, Vec<f32>>,
}

impl Depth {
    /// Whether a pixel with this depth sees something: what is not finite, or behind the camera, is no depth.
    #[inline(always)]
    pub fn is_seen(depth_m: f32) -> bool {
        depth_m.is_finite() && depth_m > 0.0
    }
}

/// Equal cameras and bits: NaN equals NaN.
impl PartialEq for Depth {
    fn eq(&self, other: &Self) -> bool {
        let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
        let channels =
            |depth: &Self| depth.channels.iter().map(|(name, v)| (name.clone(), bits(v))).collect::<Vec<_>>();
        (self.frame, &self.sensor, &self.image, self.downscale)
            == (other.frame, &other.sensor, &other.image, other.downscale)
            && (self.width, self.height) == (other.width, other.height)
            && bits(&self.z) == bits(&other.z)
            && channels(self) == channels(other)
    }
}
