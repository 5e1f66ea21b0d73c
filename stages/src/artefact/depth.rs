//! The depth map of one image, with its camera, kept as OpenEXR.

use std::collections::BTreeMap;

use super::{Artefact, Cameras, CodecError, Frame, Image, Kind, Noun, Sensor};

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
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Depth along the optical axis in metres, by row from the top, NaN where there is none.
    pub z: Vec<f32>,
    /// Further channels of the same size by name (`disparity`, `noise.local`, ...).
    pub channels: BTreeMap<String, Vec<f32>>,
}

/// What one pixel of a depth map stands for, in the frame of its camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DepthPixel {
    /// Position of its centre in the full image, pixels from the centre of the first.
    pub full_px: [f64; 2],
    /// Undistorted normalised coordinates of its ray.
    pub ray: [f64; 2],
    /// Depth along the optical axis, metres.
    pub z_m: f64,
    /// Distance along the ray, metres.
    pub range_m: f64,
    /// The point, metres.
    pub point_m: [f64; 3],
}

impl Depth {
    /// The pixel at a column and row; `None` outside the map, or where it has no depth.
    pub fn pixel(&self, column: usize, row: usize) -> Option<DepthPixel> {
        let inside = column < self.width && row < self.height;
        let z_m = f64::from(*self.z.get(row * self.width + column).filter(|z| inside && z.is_finite())?);
        let camera = crate::kernel::camera::Camera::of_depth(self);
        let full_px = crate::kernel::camera::full_pixel(column, row, self.downscale);
        let ray = camera.normalised(full_px)?;
        let range_m = z_m * (ray[0] * ray[0] + ray[1] * ray[1] + 1.0).sqrt();
        Some(DepthPixel { full_px, ray, z_m, range_m, point_m: camera.unproject(ray, z_m).into() })
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

impl Noun for Depth {
    const KIND: Kind = Kind::Depth;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Depth(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        crate::kernel::depth_exr::write(self)
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        crate::kernel::depth_exr::read(bytes)
    }
    fn sketches(&self) -> Vec<super::Sketch> {
        let mut sketches = crate::kernel::sketch::of_depth_channels(self);
        let image = Image { sensor: 0, ..self.image.clone() };
        let cameras = Cameras { frame: self.frame, sensors: vec![self.sensor.clone()], images: vec![image] };
        sketches.push(crate::kernel::sketch::of_cameras("camera", cameras));
        sketches.push(crate::kernel::sketch::of_depth_points(self));
        sketches
    }
    fn memory_bytes(&self) -> usize {
        (1 + self.channels.len()) * self.z.len() * 4
    }
}
