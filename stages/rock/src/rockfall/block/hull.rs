//! Convex hulls by exact predicates: closed, outward and convex whatever the points, to the last bit.

use std::collections::BTreeMap;

use nalgebra::Vector3;

use super::crossing::above;
use super::{Solid, V, squared_distance};

/// The convex hull of points, metres; `None` where all lie in one plane.
///
/// Quickhull (Barber, Dobkin and Huhdanpaa 1996) with the adaptive exact orientation test of Shewchuk (1997), so rounding
/// cannot open it or turn a triangle. Points inside or on its faces are left out; order follows the points.
pub fn hull(points: &[V]) -> Option<Solid> {
    let mut hull = Quickhull { points, facets: simplex(points)? };
    let all: Vec<u32> = (0..points.len() as u32).collect();
    hull.share_out(&all, 0);
    let mut at = 0;
    while at < hull.facets.len() {
        if hull.facets[at].alive && !hull.facets[at].outside.is_empty() {
            hull.grow(at);
        }
        at += 1;
    }
    Some(hull.solid())
}

struct Facet {
    corners: [u32; 3],
    /// The facet across the edge from corner i to corner i + 1.
    across: [usize; 3],
    /// Points beyond this facet; each point is kept at one facet only.
    outside: Vec<u32>,
    alive: bool,
}

struct Quickhull<'a> {
    points: &'a [V],
    facets: Vec<Facet>,
}

/// A tetrahedron of four points far apart, as facets.
fn simplex(points: &[V]) -> Option<Vec<Facet>> {
    // The first of the points that measure most.
    let farthest = |measure: &dyn Fn(V) -> f64| {
        let larger = |best: (usize, f64), (index, point): (usize, &V)| {
            let value = measure(*point);
            if value > best.1 { (index, value) } else { best }
        };
        let (index, value) = points.iter().enumerate().fold((0, 0.0), larger);
        (value > 0.0).then_some(index)
    };
    let a = *points.first()?;
    let second = farthest(&|p| squared_distance(p, a))?;
    let b = points[second];
    let from_a = |p: V| Vector3::from(p) - Vector3::from(a);
    let third = farthest(&|p| from_a(b).cross(&from_a(p)).norm_squared())?;
    let c = points[third];
    let fourth = farthest(&|p| above([a, b, c], p).abs())?;
    let (mut corners, top) = ([0, second as u32, third as u32], fourth as u32);
    if above([a, b, c], points[fourth]) > 0.0 {
        corners.swap(1, 2);
    }
    let [a, b, c] = corners;
    let facet = |corners, across| Facet { corners, across, outside: Vec::new(), alive: true };
    Some(vec![
        facet([a, b, c], [1, 2, 3]),
        facet([b, a, top], [0, 3, 2]),
        facet([c, b, top], [0, 1, 3]),
        facet([a, c, top], [0, 2, 1]),
    ])
}

impl Quickhull<'_> {
    fn height(&self, facet: usize, point: u32) -> f64 {
        above(self.facets[facet].corners.map(|corner| self.points[corner as usize]), self.points[point as usize])
    }

    /// Gives each point to the first facet from `first` on that it lies beyond; those beyond none are inside.
    fn share_out(&mut self, points: &[u32], first: usize) {
        for point in points {
            if let Some(facet) = (first..self.facets.len()).find(|facet| self.height(*facet, *point) > 0.0) {
                self.facets[facet].outside.push(*point);
            }
        }
    }

    /// Takes the point farthest beyond a facet into the hull.
    fn grow(&mut self, facet: usize) {
        let outside = &self.facets[facet].outside;
        let farther = |best: (u32, f64), point: &u32| {
            let height = self.height(facet, *point);
            if height > best.1 { (*point, height) } else { best }
        };
        let (tip, _) = outside.iter().fold((outside[0], 0.0), farther);
        let (seen, horizon) = self.visible(facet, tip);
        let first = self.facets.len();
        self.close(&horizon, tip);
        let mut loose = Vec::new();
        for facet in seen {
            self.facets[facet].alive = false;
            loose.append(&mut self.facets[facet].outside);
        }
        loose.retain(|point| *point != tip);
        self.share_out(&loose, first);
    }

    /// The facets a point lies beyond, and the edges around them: (from, to, facet on the far side).
    fn visible(&self, start: usize, tip: u32) -> (Vec<usize>, Vec<(u32, u32, usize)>) {
        let mut seen = vec![start];
        let mut horizon = Vec::new();
        let mut at = 0;
        while at < seen.len() {
            let facet = &self.facets[seen[at]];
            for i in 0..3 {
                let beyond = facet.across[i];
                if seen.contains(&beyond) {
                    continue;
                }
                if self.height(beyond, tip) > 0.0 {
                    seen.push(beyond);
                } else {
                    horizon.push((facet.corners[i], facet.corners[(i + 1) % 3], beyond));
                }
            }
            at += 1;
        }
        (seen, horizon)
    }

    /// Spans a cone from the horizon to the new point.
    fn close(&mut self, horizon: &[(u32, u32, usize)], tip: u32) {
        let first = self.facets.len();
        let starting: BTreeMap<u32, usize> = horizon.iter().enumerate().map(|(i, edge)| (edge.0, first + i)).collect();
        let ending: BTreeMap<u32, usize> = horizon.iter().enumerate().map(|(i, edge)| (edge.1, first + i)).collect();
        for (i, (from, to, beyond)) in horizon.iter().enumerate() {
            let across = [*beyond, starting[to], ending[from]];
            self.facets.push(Facet { corners: [*from, *to, tip], across, outside: Vec::new(), alive: true });
            let far = &mut self.facets[*beyond];
            let side = (0..3).find(|side| far.corners[*side] == *to && far.corners[(*side + 1) % 3] == *from);
            if let Some(side) = side {
                far.across[side] = first + i;
            }
        }
    }

    fn solid(&self) -> Solid {
        let alive = || self.facets.iter().filter(|facet| facet.alive);
        let mut number: BTreeMap<u32, u32> =
            alive().flat_map(|facet| facet.corners).map(|corner| (corner, 0)).collect();
        number.values_mut().zip(0..).for_each(|(own, next)| *own = next);
        Solid {
            vertices: number.keys().map(|corner| self.points[*corner as usize]).collect(),
            triangles: alive().map(|facet| facet.corners.map(|corner| number[&corner])).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Convex and around all points, by the exact test.
    fn encloses(hull: &Solid, points: &[V]) -> bool {
        (0..hull.triangles.len()).all(|t| points.iter().all(|p| above(hull.corners(t), *p) <= 0.0))
    }

    #[test]
    fn a_grid_of_points_has_a_cube_as_hull() {
        let points: Vec<V> = (0..125).map(|i| [i % 5, i / 5 % 5, i / 25].map(f64::from)).collect();
        let cube = hull(&points).unwrap();
        assert!((cube.volume() - 64.0).abs() < 1e-12);
        assert_eq!(cube.check(), Ok(()));
        assert!(encloses(&cube, &points));
    }

    #[test]
    fn points_in_a_plane_have_none() {
        assert!(hull(&[]).is_none());
        assert!(hull(&[[1.0; 3]; 5]).is_none());
        assert!(hull(&[[0.0; 3], [1.0; 3], [2.0; 3], [3.0; 3]]).is_none());
        let plane: Vec<V> = (0..20).map(|i| [f64::from(i % 5), f64::from(i / 5), 2.0]).collect();
        assert!(hull(&plane).is_none());
    }

    proptest! {
        #[test]
        fn a_hull_is_closed_convex_and_holds_every_point(
            points in prop::collection::vec(prop::array::uniform3(-1.0f64..1.0), 4..60),
            snap in prop::bool::ANY,
        ) {
            // Snapped to a coarse grid, many points are coplanar, collinear or the same.
            let points: Vec<V> = points.iter().map(|p| p.map(|x| if snap { (x * 3.0).round() } else { x })).collect();
            if let Some(hull) = hull(&points) {
                prop_assert!(encloses(&hull, &points));
                prop_assert_eq!(hull.check(), Ok(()));
                prop_assert_eq!(hull.triangles.len() + 4, 2 * hull.vertices.len());
            }
        }
    }
}
