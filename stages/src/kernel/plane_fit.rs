//! The best-fit plane of a mesh and the axes of the wall frame on it.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use crate::artefact::Mesh;
use crate::kernel::marginal::NORMAL_MAD;

/// Triangles further off the plane than this many robust standard deviations do not shape it.
const TRIM_SIGMAS: f64 = 2.5;
/// Fits after which the trimming has long settled.
const MAXIMUM_FITS: usize = 30;
/// Smallest angle between the plane's normal and `up` at which `up` still says where up is on the face, as a sine (20 degrees).
const LEAST_SINE: f64 = 0.342_020_143_325_668_7;

/// A plane through the area of a mesh.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// Area-weighted centroid of the triangles it was fitted to, metres.
    pub centroid: Vector3<f64>,
    /// Unit normal; its sign means nothing yet.
    pub normal: Vector3<f64>,
    /// Area-weighted mean of the unit normals of all triangles; its length is 1 for a flat mesh, 0 for a closed one.
    pub mean_normal: Vector3<f64>,
    /// Root mean square distance of the fitted triangles from it, metres.
    pub rms_m: f64,
    /// Share of the area the plane was fitted to.
    pub fitted: f64,
}

/// A triangle as the fit sees it.
struct Facet {
    area: f64,
    centroid: Vector3<f64>,
    normal_area: Vector3<f64>,
}

/// Fits a plane to the triangles by total least squares, weighted by area, leaving out what lies far off (iterated).
///
/// Eigenvector of the smallest eigenvalue of the covariance of triangle centroids. `None` without any area.
pub fn fit_plane(mesh: &Mesh) -> Option<Plane> {
    let shift = mesh.vertices.first().map(|v| Vector3::from(*v))?;
    let facets: Vec<Facet> = mesh.triangles.iter().map(|t| facet(mesh, &shift, t)).collect();
    let area = facets.iter().fold(0.0, |sum, f| sum + f.area);
    if area <= 0.0 {
        return None;
    }
    let normal_area = facets.iter().fold(Vector3::zeros(), |sum, f| sum + f.normal_area);
    let mut plane = fit(&facets, |_| true)?;
    for _ in 0..MAXIMUM_FITS {
        let limit = TRIM_SIGMAS * NORMAL_MAD * median_distance(&facets, &plane);
        let next = fit(&facets, |f| distance(f, &plane) <= limit)?;
        let turned = next.normal.cross(&plane.normal).norm();
        plane = next;
        if turned < 1e-12 {
            break;
        }
    }
    let (centroid, fitted) = (plane.centroid + shift, plane.fitted / area);
    Some(Plane { centroid, fitted, mean_normal: normal_area / area, ..plane })
}

fn facet(mesh: &Mesh, shift: &Vector3<f64>, triangle: &[u32; 3]) -> Facet {
    let [a, b, c] = triangle.map(|i| Vector3::from(mesh.vertices[i as usize]) - shift);
    let normal_area = (b - a).cross(&(c - a)) / 2.0;
    Facet { area: normal_area.norm(), centroid: (a + b + c) / 3.0, normal_area }
}

fn distance(facet: &Facet, plane: &Plane) -> f64 {
    plane.normal.dot(&(facet.centroid - plane.centroid)).abs()
}

fn median_distance(facets: &[Facet], plane: &Plane) -> f64 {
    let mut distances: Vec<f64> = facets.iter().map(|f| distance(f, plane)).collect();
    let middle = distances.len() / 2;
    *distances.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// Fits to the facets that are kept; `fitted` is their area here.
fn fit(facets: &[Facet], keep: impl Fn(&Facet) -> bool) -> Option<Plane> {
    let kept = || facets.iter().filter(|f| keep(f));
    let area = kept().fold(0.0, |sum, f| sum + f.area);
    if area <= 0.0 {
        return None;
    }
    let centroid = kept().fold(Vector3::zeros(), |sum, f| sum + f.area * f.centroid) / area;
    let spread = |f: &Facet| (f.centroid - centroid) * (f.centroid - centroid).transpose() * f.area;
    let covariance = kept().fold(Matrix3::zeros(), |sum, f| sum + spread(f)) / area;
    let eigen = SymmetricEigen::new(covariance);
    let least = eigen.eigenvalues.imin();
    let normal = eigen.eigenvectors.column(least).normalize();
    let rms_m = eigen.eigenvalues[least].max(0.0).sqrt();
    Some(Plane { centroid, normal, mean_normal: Vector3::zeros(), rms_m, fitted: area })
}

/// How Y of the wall frame was found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum UpSource {
    /// From the up direction.
    Up,
    /// From the fallback, the face being nearly horizontal.
    Fallback,
}

/// Rotation to the wall frame (rows X, Y, Z) of a plane with this outward unit normal.
///
/// Z is the normal, Y the projection of `up` on the plane, or of `fallback_up` where the normal is within 20 degrees of
/// `up`; X = Y x Z. `None` where neither direction says where up is.
pub fn wall_axes(
    outward: &Vector3<f64>,
    up: &Vector3<f64>,
    fallback_up: &Vector3<f64>,
) -> Option<(Matrix3<f64>, UpSource)> {
    let on_plane = |direction: &Vector3<f64>| {
        let unit = direction.try_normalize(1e-12)?;
        let along = unit - outward * outward.dot(&unit);
        (along.norm() >= LEAST_SINE).then(|| along.normalize())
    };
    let (y, source) =
        on_plane(up).map(|y| (y, UpSource::Up)).or_else(|| on_plane(fallback_up).map(|y| (y, UpSource::Fallback)))?;
    let x = y.cross(outward).normalize();
    Some((Matrix3::from_rows(&[x.transpose(), y.transpose(), outward.transpose()]), source))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Frame;

    /// A sheet of 40 x 40 squares tilted by a rotation, with a boulder far off the plane.
    fn sheet(rotation: &Matrix3<f64>, origin: Vector3<f64>) -> Mesh {
        let place = |i: u32| {
            let (x, y) = (f64::from(i % 41) * 0.5, f64::from(i / 41) * 0.5);
            let boulder = if (8.0..11.0).contains(&x) && (3.0..6.0).contains(&y) { 4.0 } else { 0.0 };
            (rotation.transpose() * Vector3::new(x, y, boulder) + origin).into()
        };
        let corner = |k: u32| k / 40 * 41 + k % 40;
        let cut = |a: u32| [[a, a + 1, a + 42], [a, a + 42, a + 41]];
        let triangles = (0..1600).map(corner).flat_map(cut).collect();
        Mesh { frame: Frame::World, vertices: (0..41 * 41).map(place).collect(), triangles, colours: Vec::new() }
    }

    #[test]
    fn the_plane_is_found_in_spite_of_a_boulder_at_utm_coordinates() {
        let rotation = nalgebra::Rotation3::from_euler_angles(1.2, 0.3, -0.7).into_inner();
        let plane = fit_plane(&sheet(&rotation, Vector3::new(451_000.0, 5_512_000.0, 300.0))).unwrap();
        let expected = rotation.row(2).transpose();
        assert!(plane.normal.cross(&expected).norm() < 1e-8, "{}", plane.normal.cross(&expected).norm());
        assert!(plane.mean_normal.dot(&expected) > 0.5);
        assert!(plane.rms_m < 1e-6 && plane.fitted < 1.0, "{plane:?}");
    }

    #[test]
    fn axes_are_right_handed_with_y_up_the_face() {
        let z = Vector3::new(0.3, -0.8, 0.4).normalize();
        let (axes, source) = wall_axes(&z, &Vector3::z(), &Vector3::y()).unwrap();
        assert_eq!(source, UpSource::Up);
        assert!((axes.determinant() - 1.0).abs() < 1e-12);
        assert!((axes * axes.transpose() - Matrix3::identity()).norm() < 1e-12);
        assert!(axes[(0, 2)].abs() < 1e-12 && axes[(1, 2)] > 0.0);
    }

    #[test]
    fn a_horizontal_face_takes_the_fallback_and_no_direction_is_an_error() {
        let (axes, source) = wall_axes(&Vector3::z(), &Vector3::z(), &Vector3::y()).unwrap();
        assert_eq!((source, axes), (UpSource::Fallback, Matrix3::identity()));
        assert!(wall_axes(&Vector3::z(), &Vector3::z(), &Vector3::z()).is_none());
    }
}
