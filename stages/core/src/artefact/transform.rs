//! A rigid transform between two frames, exact at UTM magnitudes.

use nalgebra::{Matrix3, Point3, Vector3};

use crate::crs::Crs;

/// A rigid transform: `p_to = rotation (p_from - origin) + translation`.
///
/// Subtracting `origin` first keeps coordinates of UTM magnitude exact to their last digits. The identity is
/// rotation I and zero vectors, which leaves data untouched to the bit.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Transform {
    /// Name of the frame it takes points from, such as `world`.
    pub from: String,
    /// Name of the frame it takes them to, such as `wall`.
    pub to: String,
    /// Rows of the rotation matrix.
    pub rotation: [[f64; 3]; 3],
    /// Subtracted first, metres in the `from` frame.
    pub origin: [f64; 3],
    /// Added last, metres in the `to` frame.
    pub translation: [f64; 3],
    /// The coordinate reference system of the world frame, where one of the two is it and the system is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crs: Option<Crs>,
}

impl Transform {
    /// The identity between two frames.
    pub fn identity(from: &str, to: &str) -> Self {
        Self::new(from, to, &Matrix3::identity(), Vector3::zeros(), Vector3::zeros())
    }

    /// A transform from its parts.
    pub fn new(from: &str, to: &str, rotation: &Matrix3<f64>, origin: Vector3<f64>, translation: Vector3<f64>) -> Self {
        let row = |i: usize| [rotation[(i, 0)], rotation[(i, 1)], rotation[(i, 2)]];
        Self {
            from: from.to_owned(),
            to: to.to_owned(),
            rotation: [row(0), row(1), row(2)],
            origin: origin.into(),
            translation: translation.into(),
            crs: None,
        }
    }

    /// Whether it moves nothing at all.
    pub fn is_identity(&self) -> bool {
        *self == Self { crs: self.crs.clone(), ..Self::identity(&self.from, &self.to) }
    }

    /// The rotation as a matrix.
    pub fn matrix(&self) -> Matrix3<f64> {
        let r = &self.rotation;
        Matrix3::new(r[0][0], r[0][1], r[0][2], r[1][0], r[1][1], r[1][2], r[2][0], r[2][1], r[2][2])
    }

    /// The rotation as a unit quaternion (w, x, y, z).
    pub fn quaternion(&self) -> [f64; 4] {
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(self.matrix());
        let unit = nalgebra::UnitQuaternion::from_rotation_matrix(&rotation);
        [unit.w, unit.i, unit.j, unit.k]
    }

    /// Takes a point from one frame to the other; the identity returns its bits.
    pub fn apply(&self, point: &Point3<f64>) -> Point3<f64> {
        if self.is_identity() {
            return *point;
        }
        let local = point.coords - Vector3::from(self.origin);
        Point3::from(self.matrix() * local + Vector3::from(self.translation))
    }

    /// The transform from the second frame back to the first.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let back = self.matrix().transpose();
        let inverse = Self::new(&self.to, &self.from, &back, self.translation.into(), self.origin.into());
        Self { crs: self.crs.clone(), ..inverse }
    }
}

super::json_noun!(Transform);

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Noun;

    #[test]
    fn there_and_back_at_utm_magnitudes() {
        let rotation = nalgebra::Rotation3::from_euler_angles(0.3, -0.2, 1.1).into_inner();
        let origin = Vector3::new(451_234.5, 5_512_345.25, 231.0);
        let wall_from_world = Transform::new("world", "wall", &rotation, origin, Vector3::zeros());
        let p = Point3::new(451_250.123, 5_512_360.456, 244.5);
        let back = wall_from_world.inverse().apply(&wall_from_world.apply(&p));
        assert!((back - p).norm() < 2e-9);
        assert_eq!(Transform::decode(&wall_from_world.encode().unwrap()).unwrap(), wall_from_world);
    }

    #[test]
    fn what_is_not_finite_is_not_written() {
        let mut transform = Transform::identity("world", "wall");
        transform.translation[1] = f64::NAN;
        assert!(transform.encode().unwrap_err().0.contains("not finite"));
    }

    #[test]
    fn the_identity_keeps_every_bit() {
        let p = Point3::new(0.1 + 0.2, -0.0, 5_512_345.123_456_789);
        let q = Transform::identity("world", "wall").apply(&p);
        assert_eq!(p.coords.map(f64::to_bits), q.coords.map(f64::to_bits));
    }
}
