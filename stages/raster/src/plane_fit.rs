//! The best-fit plane of a mesh or cloud, plain or robust, and the axes of the wall frame on it.

use nalgebra::{Matrix3, SymmetricEigen, Vector3};

use rockface_core::artefact::Mesh;
use rockface_core::numerics::marginal::NORMAL_MAD;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::random::Key;

/// Triangles further off the plane than this many robust standard deviations do not shape it.
const TRIM_SIGMAS: f64 = 2.5;
/// Fits after which the trimming has long settled.
const MAXIMUM_FITS: usize = 30;
/// Triangles or points a robust fit judges its candidates by.
const SAMPLE: usize = 1024;
/// Points a fit looks at; of larger clouds it takes every second, third, ...
const MAXIMUM_POINTS: usize = 1 << 20;
/// Candidates of a robust fit: with 40 % of the area off the plane, one of 600 planes through three points has all on it
/// but for a chance of 1e-63.
const CANDIDATES: i32 = 600;
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

/// Azimuth of the horizontal part of a direction (X east, Y north, Z up), degrees clockwise from north, 0 to 360.
pub fn azimuth_deg(direction: &Vector3<f64>) -> f64 {
    let degrees = portable_math::atan2(direction.x, direction.y).to_degrees();
    if degrees < 0.0 { degrees + 360.0 } else { degrees }
}

/// How a face lies, in words, from its unit normal out of the rock (X east, Y north, Z up).
pub fn attitude(outward: &Vector3<f64>) -> String {
    let dip_deg = portable_math::acos(outward.z.abs().min(1.0)).to_degrees();
    let dips = if outward.z < 0.0 {
        format!("overhangs by {:.1} deg", 90.0 - dip_deg)
    } else {
        format!("dips {dip_deg:.1} deg")
    };
    format!("{dips} and looks towards {} deg (clockwise from north)", azimuth_deg(outward).round() % 360.0)
}

/// A triangle or point as the fit sees it.
#[derive(Clone, Copy)]
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
    let start = fit(&facets, |_| true)?;
    trimmed(&facets, start, &shift)
}

/// Like [`fit_plane`], but starts from the plane with the least median distance, so that up to nearly half the area may lie
/// anywhere: vegetation, talus, a plateau (least median of squares, Rousseeuw 1984).
pub fn fit_plane_robust(mesh: &Mesh) -> Option<Plane> {
    let shift = mesh.vertices.first().map(|v| Vector3::from(*v))?;
    let facets: Vec<Facet> = mesh.triangles.iter().map(|t| facet(mesh, &shift, t)).collect();
    trimmed(&facets, least_median(&facets)?, &shift)
}

/// Robust plane of points, all of equal weight (of a million at most, evenly taken); areas are counts of points here, and
/// `mean_normal` is zero.
pub fn fit_points_robust(points: &[[f64; 3]]) -> Option<Plane> {
    let shift = Vector3::from(*points.first()?);
    let facet = |p: &[f64; 3]| Facet { area: 1.0, centroid: Vector3::from(*p) - shift, normal_area: Vector3::zeros() };
    let step = points.len().div_ceil(MAXIMUM_POINTS);
    let facets: Vec<Facet> = points.iter().step_by(step).map(facet).collect();
    trimmed(&facets, least_median(&facets)?, &shift)
}

/// Fits again and again to what lies near the last plane, and shifts the result back.
fn trimmed(facets: &[Facet], start: Plane, shift: &Vector3<f64>) -> Option<Plane> {
    let area = facets.iter().fold(0.0, |sum, f| sum + f.area);
    if area <= 0.0 {
        return None;
    }
    let normal_area = facets.iter().fold(Vector3::zeros(), |sum, f| sum + f.normal_area);
    let mut plane = start;
    for _ in 0..MAXIMUM_FITS {
        let limit = TRIM_SIGMAS * NORMAL_MAD * median_distance(facets, &plane);
        let next = fit(facets, |f| distance(f, &plane) <= limit)?;
        let turned = next.normal.cross(&plane.normal).norm();
        plane = next;
        if turned < 1e-12 {
            break;
        }
    }
    let (centroid, fitted) = (plane.centroid + shift, plane.fitted / area);
    Some(Plane { centroid, fitted, mean_normal: normal_area / area, ..plane })
}

/// Of planes through three facets and the least-squares plane the one with the least median distance of a sample.
fn least_median(facets: &[Facet]) -> Option<Plane> {
    let mut best = fit(facets, |_| true)?;
    let sample = sample(facets);
    let mut least = median_distance(&sample, &best);
    let draws = Key([17; 32]).field();
    let pick = |word: u32| sample[((u64::from(word) * sample.len() as u64) >> 32) as usize].centroid;
    for candidate in 0..CANDIDATES {
        let [a, b, c, _] = draws.words(candidate, 0);
        let (a, b, c) = (pick(a), pick(b), pick(c));
        let Some(normal) = (b - a).cross(&(c - a)).try_normalize(0.0) else { continue };
        let plane = Plane { centroid: a, normal, ..best };
        let median = median_distance(&sample, &plane);
        if median < least {
            (best, least) = (plane, median);
        }
    }
    Some(best)
}

/// Facets at equal steps of the area summed up, so that large ones count as much as many small ones.
fn sample(facets: &[Facet]) -> Vec<Facet> {
    let total = facets.iter().fold(0.0, |sum, f| sum + f.area);
    let step = total / SAMPLE as f64;
    let (mut sum, mut taken) = (0.0, Vec::with_capacity(SAMPLE));
    for facet in facets {
        sum += facet.area;
        while (taken.len() as f64 + 0.5) * step < sum && taken.len() < SAMPLE {
            taken.push(*facet);
        }
    }
    taken
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
    use rockface_core::artefact::Frame;

    #[test]
    fn the_attitude_of_a_face_tells_an_overhang_and_the_side_it_looks_to() {
        let at = |azimuth_deg: f64, up_deg: f64| {
            let ((east, north), (up, flat)) =
                (portable_math::sincos(azimuth_deg.to_radians()), portable_math::sincos(up_deg.to_radians()));
            attitude(&Vector3::new(flat * east, flat * north, up))
        };
        assert_eq!(at(180.0, 12.0), "dips 78.0 deg and looks towards 180 deg (clockwise from north)");
        assert_eq!(at(-0.3, -12.0), "overhangs by 12.0 deg and looks towards 0 deg (clockwise from north)");
    }

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

    /// 55 % of the points on a plane, the rest on a plateau that begins at its top: the plain fit goes between the two.
    #[test]
    fn a_robust_plane_keeps_to_the_larger_part() {
        for tilt in [1.4, 0.02] {
            let rotation = nalgebra::Rotation3::from_euler_angles(tilt, 0.1, 0.5).into_inner();
            let origin = Vector3::new(451_000.0, 5_512_000.0, 300.0);
            let field = Key([2; 32]).field();
            let place = |i: i32| {
                let unit = field.words(i, 0).map(|word| f64::from(word) / f64::from(u32::MAX));
                let (x, y, z) = (20.0 * unit[0], 11.0 * unit[1], 0.02 * (unit[2] - 0.5));
                let on_plateau = i % 20 >= 11;
                let p = if on_plateau { Vector3::new(x, 11.0 + z, -y) } else { Vector3::new(x, y, z) };
                (rotation * p + origin).into()
            };
            let points: Vec<[f64; 3]> = (0..20_000).map(place).collect();
            let plane = fit_points_robust(&points).unwrap();
            let off = plane.normal.cross(&rotation.column(2).into_owned()).norm();
            assert!(off < 1e-3, "{off} rad off");
            assert!((plane.fitted - 0.55).abs() < 0.03 && plane.rms_m < 0.01, "{plane:?}");
            let again = fit_points_robust(&points).unwrap();
            assert_eq!(plane, again);
        }
        assert!(fit_points_robust(&[]).is_none());
    }

    #[test]
    fn a_robust_plane_of_a_mesh_weighs_by_area() {
        let rotation = nalgebra::Rotation3::from_euler_angles(0.9, 0.3, -0.7).into_inner();
        let mesh = sheet(&rotation, Vector3::new(451_000.0, 5_512_000.0, 300.0));
        let plane = fit_plane_robust(&mesh).unwrap();
        assert!(plane.normal.cross(&rotation.row(2).transpose()).norm() < 1e-8);
        assert!((plane.mean_normal - fit_plane(&mesh).unwrap().mean_normal).norm() < 1e-12);
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

    #[test]
    fn up_is_taken_from_20_degrees_off_the_normal_on() {
        let source = |off_deg: f64| {
            let (sine, cosine) = portable_math::sincos(off_deg.to_radians());
            wall_axes(&Vector3::z(), &Vector3::new(sine, 0.0, cosine), &Vector3::y()).unwrap().1
        };
        assert_eq!([19.9, 20.1].map(source), [UpSource::Fallback, UpSource::Up]);
    }
}
