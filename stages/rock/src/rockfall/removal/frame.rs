//! The direction a block is moved along where it stands, and the turn from the axes of the wall to it.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use super::face::{Face, Rect};

/// Triangles a plane is fitted to; below, their mean normal is the better guess.
const LEAST_TRIANGLES: usize = 6;

/// The outward unit normal of the face around a place: of the plane through the triangles whose centroids lie within a
/// radius (principal components, weighted by area), or their mean normal where they are few. Z where there is none.
pub fn local_normal(face: &Face, place: [f64; 3], radius_m: f64) -> Vector3<f64> {
    let place = Vector3::from(place);
    let rect = Rect::around(&[place.into()]).grown(radius_m);
    let facets: Vec<Facet> = face.query(&rect).into_iter().map(|t| facet(face, t, &place)).collect();
    let near: Vec<&Facet> = facets.iter().filter(|f| f.centroid.norm() <= radius_m).collect();
    let used = if near.is_empty() { facets.iter().collect() } else { near };
    let mean = used.iter().fold(Vector3::zeros(), |sum, f| sum + f.normal_area);
    let plane = if used.len() < LEAST_TRIANGLES { None } else { plane_normal(&used) };
    let normal = plane.unwrap_or(mean);
    let outward = if normal.dot(&mean) < 0.0 { -normal } else { normal };
    outward.try_normalize(0.0).unwrap_or_else(Vector3::z)
}

struct Facet {
    centroid: Vector3<f64>,
    normal_area: Vector3<f64>,
}

fn facet(face: &Face, triangle: u32, place: &Vector3<f64>) -> Facet {
    let [a, b, c] = face.triangle(triangle).map(|v| Vector3::from(face.vertex(v)) - place);
    Facet { centroid: (a + b + c) / 3.0, normal_area: (b - a).cross(&(c - a)) / 2.0 }
}

fn plane_normal(facets: &[&Facet]) -> Option<Vector3<f64>> {
    let area = facets.iter().fold(0.0, |sum, f| sum + f.normal_area.norm());
    if area <= 0.0 {
        return None;
    }
    let weighted = |f: &&Facet| f.centroid * f.normal_area.norm();
    let mean = facets.iter().map(weighted).fold(Vector3::zeros(), |sum, m| sum + m) / area;
    let spread = |f: &&Facet| {
        let d = f.centroid - mean;
        d * d.transpose() * f.normal_area.norm()
    };
    let eigen = SymmetricEigen::new(facets.iter().map(spread).fold(Matrix3::zeros(), |sum, s| sum + s));
    Some(eigen.eigenvectors.column(eigen.eigenvalues.imin()).into_owned())
}

/// The rotation that takes Z to a unit vector by the shortest way: its third column is the vector, the first two lie along
/// the tangents nearest to X and Y.
pub fn turn_to(normal: &Vector3<f64>) -> Matrix3<f64> {
    let axis = Vector3::z().cross(normal);
    let along = 1.0 + normal.z;
    if along < 1e-9 {
        // Straight into the rock: half a turn about X.
        return Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    }
    let cross = axis.cross_matrix();
    Matrix3::identity() + cross + cross * cross / along
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::testing::height_mesh;

    #[test]
    fn the_normal_of_a_rough_slope_is_that_of_the_slope() {
        let mesh = height_mesh(60, [0.0, 6.0, 0.0, 6.0], |x, y| 0.5 * x + 0.02 * ((x * 37.0 + y * 53.0) % 1.0));
        let face = Face::new(mesh.vertices, mesh.triangles);
        let wanted = Vector3::new(-0.5, 0.0, 1.0).normalize();
        let found = local_normal(&face, [3.0, 3.0, 1.51], 1.0);
        assert!(found.angle(&wanted) < 0.01, "{found}");
        // Two triangles of 0.1 m are left within a radius this small.
        let few = local_normal(&face, [3.0, 3.0, 1.51], 0.06);
        assert!(few.z > 0.5 && (few.norm() - 1.0).abs() < 1e-12);
        assert_eq!(local_normal(&face, [99.0, 3.0, 0.0], 1.0), Vector3::z());
    }

    #[test]
    fn the_turn_is_a_rotation_that_takes_z_to_the_normal() {
        for normal in [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.48, 0.6, -0.64], [0.0, 0.0, -1.0]] {
            let normal = Vector3::from(normal);
            let turn = turn_to(&normal);
            assert!((turn * Vector3::z() - normal).norm() < 1e-12);
            assert!((turn.transpose() * turn - Matrix3::identity()).norm() < 1e-12);
            assert!((turn.determinant() - 1.0).abs() < 1e-12);
        }
    }
}
