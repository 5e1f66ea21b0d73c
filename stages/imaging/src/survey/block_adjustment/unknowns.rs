//! The estimated orientation parameters of a block and their order: images first, then sensors.

use super::partials::Partials;
use crate::camera::orientation_parameters::{EXTERIOR, Parameter};
use rockface_core::artefact::Cameras;

/// A parameter of the interior orientation that is estimated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FreeInterior {
    /// Its index among the parameters of a sensor.
    pub place: usize,
    /// Its a priori standard deviation (px, or 1 for distortion); `None`: free.
    pub sigma: Option<f64>,
}

/// The estimated parameters of a block in canonical order: six an image, then the free ones of each sensor.
#[derive(Debug, Clone)]
pub struct Unknowns {
    images: usize,
    sensors: usize,
    /// The free parameters of every sensor, in canonical order.
    pub free: Vec<FreeInterior>,
}

impl Unknowns {
    /// The unknowns of a block whose sensors all have the same free parameters.
    pub fn new(cameras: &Cameras, mut free: Vec<FreeInterior>) -> Self {
        free.sort_by_key(|free| free.place);
        Self { images: cameras.images.len(), sensors: cameras.sensors.len(), free }
    }

    /// Number of all unknowns, which is the size of the normal matrix.
    pub fn count(&self) -> usize {
        EXTERIOR.len() * self.images + self.free.len() * self.sensors
    }

    /// Images of the block.
    pub fn images(&self) -> usize {
        self.images
    }

    /// Position of the first parameter of an image.
    pub fn of_image(&self, image: usize) -> usize {
        EXTERIOR.len() * image
    }

    /// Position of the first parameter of a sensor.
    pub fn of_sensor(&self, sensor: usize) -> usize {
        EXTERIOR.len() * self.images + self.free.len() * sensor
    }

    /// All parameters, in order.
    pub fn parameters(&self) -> Vec<Parameter> {
        let exterior =
            (0..self.images).flat_map(|i| (0..EXTERIOR.len()).map(move |place| Parameter::Exterior(i, place)));
        let of_sensor = |s: usize| self.free.iter().map(move |free| Parameter::Interior(s, free.place));
        exterior.chain((0..self.sensors).flat_map(of_sensor)).collect()
    }

    /// Position and derivatives (of u and v) of each unknown that moves the pixel of a point in an image.
    pub fn columns(&self, image: usize, sensor: usize, partials: &Partials) -> Vec<(usize, [f64; 2])> {
        let (first, offset) = (self.of_image(image), self.of_sensor(sensor));
        let exterior = (0..EXTERIOR.len()).map(|k| (first + k, [partials.exterior[0][k], partials.exterior[1][k]]));
        let interior = self
            .free
            .iter()
            .enumerate()
            .map(|(k, free)| (offset + k, [partials.interior[0][free.place], partials.interior[1][free.place]]));
        exterior.chain(interior).collect()
    }
}
