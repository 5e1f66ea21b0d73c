//! Volume, area, centroid and moments of triangles, exact for flat facets and free of cancellation far from the origin.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use crate::face::tetrahedra::tetrahedra;

/// Vertices and the triangles between them, open or closed; closed ones are counter-clockwise seen from outside.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Facets {
    /// Vertices, metres.
    pub vertices: Vec<[f64; 3]>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// What a closed body weighs, for a density of one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Body {
    /// Volume, cubic metres.
    pub volume_m3: f64,
    /// Centre of mass, metres.
    pub centroid: Vector3<f64>,
    /// Second moments about the centroid divided by the volume, square metres.
    pub covariance: Matrix3<f64>,
}

impl Facets {
    /// A box with its edges along the axes and one corner at the origin; metres.
    pub fn cuboid(x: f64, y: f64, z: f64) -> Self {
        let corner = |i: u32| [x * f64::from(i & 1), y * f64::from(i >> 1 & 1), z * f64::from(i >> 2 & 1)];
        let squares = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
        let triangles = squares.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
        Self { vertices: (0..8).map(corner).collect(), triangles }
    }

    /// Smallest box along the axes as (lower corner, upper corner), metres; `None` without vertices.
    pub fn bounds(&self) -> Option<[[f64; 3]; 2]> {
        let first = *self.vertices.first()?;
        let grow = |[low, high]: [[f64; 3]; 2], v: &[f64; 3]| {
            [std::array::from_fn(|i| low[i].min(v[i])), std::array::from_fn(|i| high[i].max(v[i]))]
        };
        Some(self.vertices.iter().fold([first, first], grow))
    }

    /// The corners of each triangle relative to the first vertex, metres, and six times the volume they span with it.
    fn local(&self) -> impl Iterator<Item = ([Vector3<f64>; 3], f64)> + '_ {
        tetrahedra(&self.vertices, &self.triangles, self.vertices.first().copied().unwrap_or_default())
    }

    /// Sum of the areas of the triangles, square metres.
    pub fn area_m2(&self) -> f64 {
        self.local().fold(0.0, |sum, ([a, b, c], _)| sum + 0.5 * (b - a).cross(&(c - a)).norm())
    }

    /// Sum of the areas of the triangles as vectors along their normals, square metres: the component along a direction
    /// is the area the rim encloses seen from there; zero for a closed body.
    pub fn vector_area_m2(&self) -> Vector3<f64> {
        self.local().fold(Vector3::zeros(), |sum, ([a, b, c], _)| sum + 0.5 * (b - a).cross(&(c - a)))
    }

    /// Volume enclosed, cubic metres, by the divergence theorem about the first vertex; negative when inside out.
    pub fn volume_m3(&self) -> f64 {
        self.local().fold(0.0, |sum, (_, six)| sum + six / 6.0)
    }

    /// Volume, centroid and covariance of a closed body; `None` without a positive volume.
    ///
    /// Tetrahedra from the first vertex to each triangle, with the second moments of a tetrahedron.
    pub fn body(&self) -> Option<Body> {
        let (mut volume, mut first, mut second) = (0.0, Vector3::zeros(), Matrix3::zeros());
        for ([a, b, c], six) in self.local() {
            let part = six / 6.0;
            let sum = a + b + c;
            let squares = sum * sum.transpose() + a * a.transpose() + b * b.transpose() + c * c.transpose();
            volume += part;
            first += sum * (part / 4.0);
            second += squares * (part / 20.0);
        }
        if !(volume > 0.0 && volume.is_finite()) {
            return None;
        }
        let centre = first / volume;
        let covariance = second / volume - centre * centre.transpose();
        let origin = Vector3::from(*self.vertices.first()?);
        Some(Body { volume_m3: volume, centroid: origin + centre, covariance })
    }

    /// The triangles in other coordinates.
    #[must_use]
    pub fn moved(&self, by: impl Fn(Vector3<f64>) -> Vector3<f64>) -> Self {
        let vertices = self.vertices.iter().map(|v| by(Vector3::from(*v)).into()).collect();
        Self { vertices, triangles: self.triangles.clone() }
    }
}

impl Body {
    /// Unit vectors along which the mass spreads most, less and least; the largest component of each is positive.
    pub fn principal_axes(&self) -> [Vector3<f64>; 3] {
        let eigen = SymmetricEigen::new(self.covariance);
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        order.map(|column| with_a_sign(eigen.eigenvectors.column(column).into_owned()))
    }
}

/// An axis has no sign: the one that makes its largest component positive.
pub fn with_a_sign(axis: Vector3<f64>) -> Vector3<f64> {
    if axis[axis.iamax()] < 0.0 { -axis } else { axis }
}

#[cfg(test)]
mod tests {
    use nalgebra::Rotation3;

    use super::*;

    #[test]
    fn a_box_at_utm_magnitudes_has_its_volume_and_moments() {
        let turn = Rotation3::from_euler_angles(0.4, -0.7, 1.2);
        let far = Vector3::new(451_234.5, 5_512_345.25, 231.0);
        let body = Facets::cuboid(3.0, 2.0, 0.5).moved(|p| turn * p + far);
        let found = body.body().unwrap();
        assert!((found.volume_m3 - 3.0).abs() < 1e-8 && (body.volume_m3() - 3.0).abs() < 1e-8);
        assert!((found.centroid - far - turn * Vector3::new(1.5, 1.0, 0.25)).norm() < 1e-8);
        let spread = turn.inverse() * found.covariance * turn;
        for (axis, side) in [3.0, 2.0, 0.5].into_iter().enumerate() {
            assert!((spread[(axis, axis)] - side * side / 12.0).abs() < 1e-8);
        }
        let axes = found.principal_axes();
        assert!(axes[0].cross(&(turn * Vector3::x())).norm() < 1e-7);
        assert!(axes[2].cross(&(turn * Vector3::z())).norm() < 1e-7);
        assert!(body.vector_area_m2().norm() < 1e-8);
        assert!((body.area_m2() - 2.0 * (6.0 + 1.5 + 1.0)).abs() < 1e-8);
    }

    #[test]
    fn inside_out_or_flat_is_no_body() {
        let mut inside_out = Facets::cuboid(1.0, 1.0, 1.0);
        inside_out.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert!((inside_out.volume_m3() + 1.0).abs() < 1e-12);
        assert!(inside_out.body().is_none() && Facets::cuboid(1.0, 1.0, 0.0).body().is_none());
        assert!(Facets::default().body().is_none() && Facets::default().bounds().is_none());
    }
}
