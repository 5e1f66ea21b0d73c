//! Triangles far away from the face: a piece at the origin of the coordinates, or a corner that belongs elsewhere.

use rockface_core::artefact::Mesh;

/// Share of the area that tells the extent of the face, ...
const SHARE: f64 = 0.99;
/// ... or less where a mesh has so few triangles that one of them is more than the rest: so many are left out then, ...
const LEFT_OUT: f64 = 2.5;
/// ... but no more than this leaves.
const LEAST_SHARE: f64 = 0.75;
/// Beyond so many extents a triangle is far away.
const FAR: f64 = 10.0;
/// The most triangles that the extent is computed from.
const SAMPLE: usize = 100_000;
/// A triangle counts for no more than so many of median area, so a few long ones to a corner far away do not decide.
const MOST_MEDIANS: f64 = 10.0;

/// Triangles far away from the rest.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Stray {
    /// How many there are.
    pub triangles: usize,
    /// The corner that is farthest away.
    pub place: [f64; 3],
    /// Its distance from the middle of the face, metres.
    pub distance_m: f64,
    /// Within this distance of the middle lies the share of the face, metres.
    pub extent_m: f64,
    /// The share of the area that tells the extent: 0.99, less for meshes of fewer than 250 triangles.
    pub share: f64,
}

/// Triangles with a corner ten times as far from the middle of the face as 99 % of its area are (less of a mesh of few triangles); `None` where there are none.
///
/// The middle is the median of the centroids by area, coordinate by coordinate. Of large meshes both are those of a sample.
pub fn stray(mesh: &Mesh) -> Option<Stray> {
    let corners = |triangle: &[u32; 3]| triangle.map(|corner| mesh.vertices[corner as usize]);
    let step = mesh.triangles.len().div_ceil(SAMPLE).max(1);
    let sample: Vec<[[f64; 3]; 3]> = mesh.triangles.iter().step_by(step).map(corners).collect();
    let mut areas: Vec<f64> = sample.iter().map(area).collect();
    let most = MOST_MEDIANS * quantile(areas.iter().map(|area| (*area, 1.0)), 0.5)?;
    areas.iter_mut().for_each(|area| *area = area.min(most));
    let mut middle = [0.0; 3];
    for (axis, middle) in middle.iter_mut().enumerate() {
        let centroids = sample.iter().map(|corners| corners.iter().map(|corner| corner[axis]).sum::<f64>() / 3.0);
        *middle = quantile(centroids.zip(areas.iter().copied()), 0.5)?;
    }
    let farthest = |corners: [[f64; 3]; 3]| {
        let all = corners.map(|corner| (distance(corner, middle), corner));
        all.into_iter().fold((0.0, middle), |far, next| if next.0 > far.0 { next } else { far })
    };
    let share = SHARE.min(1.0 - LEFT_OUT / sample.len() as f64).max(LEAST_SHARE);
    let extent_m = quantile(sample.iter().map(|corners| farthest(*corners).0).zip(areas.iter().copied()), share)?;
    let all = mesh.triangles.iter().map(|triangle| farthest(corners(triangle)));
    all.filter(|(distance_m, _)| *distance_m > FAR * extent_m).fold(None, |stray, (distance_m, place)| {
        let before = stray.unwrap_or(Stray { triangles: 0, place, distance_m, extent_m, share });
        let triangles = before.triangles + 1;
        let farther = if distance_m > before.distance_m { Stray { place, distance_m, ..before } } else { before };
        Some(Stray { triangles, ..farther })
    })
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|axis| (a[axis] - b[axis]) * (a[axis] - b[axis])).sum::<f64>().sqrt()
}

fn area([a, b, c]: &[[f64; 3]; 3]) -> f64 {
    let [u, v] = [b, c].map(|corner| nalgebra::Vector3::from(*corner) - nalgebra::Vector3::from(*a));
    0.5 * u.cross(&v).norm()
}

/// The value up to which a share of all weight lies; `None` without weight.
fn quantile(weighted: impl Iterator<Item = (f64, f64)>, share: f64) -> Option<f64> {
    let mut sorted: Vec<(f64, f64)> = weighted.collect();
    sorted.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let wanted = share * sorted.iter().map(|(_, weight)| weight).sum::<f64>();
    let mut sum = 0.0;
    let reached = sorted.iter().find(|(_, weight)| {
        sum += weight;
        sum >= wanted && sum > 0.0
    });
    reached.map(|(value, _)| *value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::testing::height_mesh;

    #[test]
    fn pieces_and_corners_far_away_are_found_and_large_faces_are_not() {
        let face = || {
            let mut mesh = height_mesh(40, [0.0, 20.0, 0.0, 10.0], |x, y| 0.1 * x * y);
            mesh.vertices.iter_mut().for_each(|vertex| vertex[0] += 451_000.0);
            mesh
        };
        assert_eq!(stray(&face()), None);
        let mut piece = face();
        let first = piece.vertices.len() as u32;
        piece.vertices.extend([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        piece.triangles.push([first, first + 1, first + 2]);
        let found = stray(&piece).unwrap();
        assert!(
            found.triangles == 1 && found.place[0] < 0.5 && (found.distance_m - 451_010.0).abs() < 5.0,
            "{found:?}"
        );
        assert!((8.0..20.0).contains(&found.extent_m), "{found:?}");
        let mut few = height_mesh(5, [0.0, 5.0, 0.0, 5.0], |x, y| 0.1 * x * y);
        few.vertices.iter_mut().for_each(|vertex| vertex[0] += 451_000.0);
        assert_eq!(stray(&few), None);
        few.vertices.extend([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        let first = few.vertices.len() as u32 - 3;
        few.triangles.push([first, first + 1, first + 2]);
        let found = stray(&few).unwrap();
        assert!(
            found.triangles == 1 && found.extent_m < 5.0 && found.share < 0.97,
            "{found:?}, {}",
            few.triangles.len()
        );
        let mut spike = face();
        spike.vertices[0] = [0.0; 3];
        assert!(stray(&spike).is_some_and(|found| (1..=6).contains(&found.triangles)));
        // A part of the face that lies apart is no stray piece.
        let mut parts = face();
        let first = parts.vertices.len() as u32;
        let moved: Vec<[f64; 3]> = parts.vertices.iter().map(|[x, y, z]| [x + 90.0, *y, *z]).collect();
        parts.vertices.extend(moved);
        let triangles: Vec<[u32; 3]> = parts.triangles.iter().map(|corners| corners.map(|i| i + first)).collect();
        parts.triangles.extend(triangles);
        assert_eq!(stray(&parts), None);
        assert_eq!(stray(&Mesh { triangles: vec![[0, 1, 41]], ..face() }), None, "one triangle");
        assert_eq!(stray(&Mesh { triangles: Vec::new(), ..face() }), None);
    }

    #[test]
    fn a_piece_is_far_away_beyond_ten_extents() {
        let with_piece_at = |beyond_m: f64| {
            let mut mesh = height_mesh(40, [-10.0, 10.0, -5.0, 5.0], |_, _| 0.0);
            let first = mesh.vertices.len() as u32;
            mesh.vertices.extend([[beyond_m, 0.0, 0.0], [beyond_m, 0.1, 0.0], [beyond_m, 0.0, 0.1]]);
            mesh.triangles.push([first, first + 1, first + 2]);
            stray(&mesh)
        };
        let extent_m = with_piece_at(1000.0).unwrap().extent_m;
        assert!((10.0..11.2).contains(&extent_m), "nearly half the diagonal of 20 x 10 m: {extent_m}");
        assert_eq!(with_piece_at(9.8 * extent_m), None);
        assert_eq!(with_piece_at(10.2 * extent_m).unwrap().triangles, 1);
    }
}
