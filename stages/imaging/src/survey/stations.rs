//! Stations before a face: a stereo pair, or strips flown once for every viewing direction, and errors of repeated stations.

use nalgebra::{Matrix3, Vector3};

use super::face::Face;
use crate::camera::model::exponential;
use crate::camera::orientation::quaternion;
use rockface_core::artefact::Image;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Field;

/// An image with horizontal x axis that looks from a centre to a target; all use the first sensor.
pub fn looking(name: &str, centre: Vector3<f64>, target: Vector3<f64>) -> Image {
    let z = (target - centre).normalize();
    let x = z.cross(&Vector3::y()).normalize();
    let rotation = Matrix3::from_rows(&[x.transpose(), z.cross(&x).transpose(), z.transpose()]);
    let mut image =
        Image { name: name.to_owned(), sensor: 0, camera_from_object: [1.0, 0.0, 0.0, 0.0], centre_m: centre.into() };
    image.set_rotation(&quaternion(&rotation));
    image
}

/// Strips of images before a face.
#[derive(Debug, Clone)]
pub struct Strips {
    /// Distance of a station from the face across its plane, metres.
    pub distance_m: f64,
    /// Distance of neighbouring images along a strip, and of neighbouring strips, metres.
    pub step_m: [f64; 2],
    /// Images of a strip, and strips.
    pub counts: [usize; 2],
    /// Yaw (to +X) and pitch (up) of the optical axis from straight at the face, degrees: the strips are flown for each.
    pub directions_deg: Vec<[f64; 2]>,
    /// Whether stations keep their distance from the nearby rock instead of the mean plane.
    pub follow: bool,
}

/// Step and count that cover a length: the outermost positions are at its ends or beyond.
pub fn count_to_cover(length_m: f64, step_m: f64) -> usize {
    (length_m / step_m - 1e-9).ceil().max(0.0) as usize + 1
}

impl Strips {
    /// The images, by direction, strip from the top, and place from the left; `footprint_m` is that of one image.
    ///
    /// The optical axes meet the face in a grid of targets around its centre. The distance of a station from the plane is
    /// `distance_m`, whatever the angle of its view.
    pub fn images(&self, face: &Face, footprint_m: [f64; 2]) -> Vec<Image> {
        let mut images = Vec::new();
        for (at, direction) in self.directions_deg.iter().enumerate() {
            let prefix = if self.directions_deg.len() > 1 { format!("d{}", at + 1) } else { String::new() };
            for row in 0..self.counts[1] {
                for column in 0..self.counts[0] {
                    let name = format!("{prefix}r{:02}c{:02}", row + 1, column + 1);
                    let target = self.target(face, [column, row], footprint_m);
                    images.push(looking(&name, self.station(&target, *direction), target));
                }
            }
        }
        images
    }

    fn target(&self, face: &Face, at: [usize; 2], footprint_m: [f64; 2]) -> Vector3<f64> {
        let offset = |axis: usize| (at[axis] as f64 - 0.5 * (self.counts[axis] as f64 - 1.0)) * self.step_m[axis];
        let (x, y) = (face.centre.x + offset(0), face.centre.y - offset(1));
        let z = if self.follow { face.local_z([x, y], footprint_m.map(|side| 0.25 * side)) } else { face.centre.z };
        Vector3::new(x, y, z)
    }

    fn station(&self, target: &Vector3<f64>, [yaw_deg, pitch_deg]: [f64; 2]) -> Vector3<f64> {
        let (yaw, pitch) = (yaw_deg.to_radians(), pitch_deg.to_radians());
        let across = portable_math::cos(yaw) * portable_math::cos(pitch);
        let axis =
            Vector3::new(portable_math::sin(yaw) * portable_math::cos(pitch), portable_math::sin(pitch), -across);
        target - axis * (self.distance_m / across)
    }
}

/// Moves an image from its planned station to the actual one: six draws for position (m) and pointing (degrees).
pub fn scatter(image: &mut Image, position_sigma_m: [f64; 3], pointing_sigma_deg: [f64; 3], field: &Field) {
    let draw = |k: usize| field.normal(k as i32, 0);
    let turn = Vector3::from_fn(|k, _| pointing_sigma_deg[k].to_radians() * draw(k));
    if turn != Vector3::zeros() {
        let rotation = quaternion(&exponential(&turn)) * image.rotation();
        image.set_rotation(&rotation);
    }
    for (k, centre) in image.centre_m.iter_mut().enumerate() {
        if position_sigma_m[k] > 0.0 {
            *centre += position_sigma_m[k] * draw(3 + k);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;
    use rockface_core::testing::height_mesh;

    fn strips() -> Strips {
        Strips {
            distance_m: 10.0,
            step_m: [2.0, 1.5],
            counts: [4, 3],
            directions_deg: vec![[0.0, 0.0], [20.0, -30.0]],
            follow: false,
        }
    }

    #[test]
    fn every_axis_meets_its_target_at_the_distance_of_the_plane() {
        let face = Face::of(&height_mesh(20, [-4.0, 4.0, 1.0, 7.0], |_, _| 0.25), 1000).unwrap();
        let images = strips().images(&face, [4.0, 3.0]);
        assert_eq!(images.len(), 24);
        assert_eq!((images[0].name.as_str(), images[23].name.as_str()), ("d1r01c01", "d2r03c04"));
        for (at, image) in images.iter().enumerate() {
            let (column, row) = (at % 4, at / 4 % 3);
            let centre = image.centre();
            assert!((centre.z - 10.25).abs() < 1e-12);
            let met = centre - image.axis() * ((centre.z - 0.25) / image.axis().z);
            assert!((met.x - 2.0 * (column as f64 - 1.5)).abs() < 1e-12, "{met}");
            assert!((met.y - (4.0 - 1.5 * (row as f64 - 1.0))).abs() < 1e-12, "{met}");
            assert!(image.matrix()[(0, 1)].abs() < 1e-12, "x is horizontal");
        }
        // 30 degrees down: the axis falls, the station stands above its target.
        assert!((images[12].axis().y + 0.5).abs() < 1e-12 && images[12].centre_m[1] > 5.5);
    }

    #[test]
    fn terrain_is_followed_where_it_is() {
        let face =
            Face::of(&height_mesh(40, [-4.0, 4.0, 1.0, 7.0], |x, _| if x > 0.0 { 2.0 } else { 0.0 }), 10_000).unwrap();
        let images = Strips { follow: true, directions_deg: vec![[0.0, 0.0]], ..strips() }.images(&face, [4.0, 3.0]);
        let z: Vec<f64> = images[..4].iter().map(|image| image.centre_m[2]).collect();
        assert!((z[0] - 10.0).abs() < 1e-12 && (z[3] - 12.0).abs() < 1e-12 && z[1] < z[2], "{z:?}");
        assert!(face.check_before(&Vector3::new(2.0, 4.0, 1.9), [1.0, 1.0], 1.9).is_err());
        assert!(face.check_before(&Vector3::new(-2.0, 4.0, 1.9), [1.0, 1.0], 1.9).is_ok());
        // Outside of the face: the nearest rock.
        assert!((face.local_z([9.0, 4.0], [1.0, 1.0]) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn lengths_are_covered() {
        assert_eq!([count_to_cover(40.0, 6.0), count_to_cover(12.0, 6.0), count_to_cover(0.0, 6.0)], [8, 3, 1]);
    }

    #[test]
    fn viewpoints_scatter_as_told() {
        let nominal = looking("a", Vector3::new(0.0, 0.0, 10.0), Vector3::zeros());
        let (mut squares, n) = ([0.0; 6], 2000u16);
        for trial in 0..n {
            let mut key = [0; 32];
            key[..2].copy_from_slice(&trial.to_le_bytes());
            let mut image = nominal.clone();
            scatter(&mut image, [0.5, 0.2, 0.1], [1.0, 2.0, 0.0], &Key(key).field());
            let turn = (image.rotation() * nominal.rotation().inverse()).scaled_axis();
            for k in 0..3 {
                squares[k] += turn[k] * turn[k];
                squares[3 + k] += {
                    let d = image.centre_m[k] - nominal.centre_m[k];
                    d * d
                };
            }
        }
        let expected = [1.0f64.to_radians(), 2.0f64.to_radians(), 0.0, 0.5, 0.2, 0.1];
        for (square, sigma) in squares.iter().zip(expected) {
            // Six standard errors of a sampled standard deviation.
            assert!(((square / f64::from(n)).sqrt() - sigma).abs() <= 6.0 * sigma / (2.0 * f64::from(n)).sqrt() + 1e-9);
        }
    }
}
