//! Whether the triangles of a mesh pass through each other, by exact orientation tests.

use robust::{Coord, Coord3D, orient2d, orient3d};

use super::Solid;
use super::V;

/// Positive where a point lies beyond a triangle seen counter-clockwise, negative before it, zero in its plane: the sign is
/// exact (Shewchuk 1997), the size is six times the volume between them to rounding.
pub fn above([a, b, c]: [V; 3], point: V) -> f64 {
    let at = |[x, y, z]: V| Coord3D { x, y, z };
    -orient3d(at(a), at(b), at(c), at(point))
}

/// Whether three corners lie on one line, exactly.
pub fn degenerate([a, b, c]: [V; 3]) -> bool {
    (0..3).all(|axis| side(axis, a, b, c) == 0.0)
}

/// On which side of the line from a to b point c lies, seen along an axis.
fn side(axis: usize, a: V, b: V, c: V) -> f64 {
    let at = |v: V| Coord { x: v[(axis + 1) % 3], y: v[(axis + 2) % 3] };
    orient2d(at(a), at(b), at(c))
}

/// The first two triangles found that meet anywhere but at corners and edges they share; triangles must have areas
/// ([`degenerate`]).
pub fn first(solid: &Solid) -> Option<(usize, usize)> {
    sweep(solid, 1).pop()
}

/// All pairs of triangles that meet anywhere but at corners and edges they share.
pub fn all(solid: &Solid) -> Vec<(usize, usize)> {
    sweep(solid, usize::MAX)
}

/// Boxes are swept along the longest axis of the mesh, until so many pairs are found.
fn sweep(solid: &Solid, most: usize) -> Vec<(usize, usize)> {
    let extent = solid.extent();
    let axis = (1..3).fold(0, |best, axis| if extent[axis] > extent[best] { axis } else { best });
    let boxes: Vec<[V; 2]> = (0..solid.triangles.len()).map(|t| bounds(solid.corners(t))).collect();
    let mut order: Vec<usize> = (0..boxes.len()).collect();
    order.sort_by(|a, b| boxes[*a][0][axis].total_cmp(&boxes[*b][0][axis]).then(a.cmp(b)));
    let mut found = Vec::new();
    for (rank, &one) in order.iter().enumerate() {
        let reach = boxes[one][1][axis];
        for &other in order[rank + 1..].iter().take_while(|other| boxes[**other][0][axis] <= reach) {
            if overlap(&boxes[one], &boxes[other]) && cross(solid, one, other) {
                found.push((one.min(other), one.max(other)));
                if found.len() >= most {
                    return found;
                }
            }
        }
    }
    found
}

fn bounds(corners: [V; 3]) -> [V; 2] {
    let along = |pick: fn(f64, f64) -> f64| {
        std::array::from_fn(|axis| pick(pick(corners[0][axis], corners[1][axis]), corners[2][axis]))
    };
    [along(f64::min), along(f64::max)]
}

fn overlap(a: &[V; 2], b: &[V; 2]) -> bool {
    (0..3).all(|axis| a[0][axis] <= b[1][axis] && b[0][axis] <= a[1][axis])
}

fn cross(solid: &Solid, one: usize, other: usize) -> bool {
    let (a, b) = (solid.triangles[one], solid.triangles[other]);
    let shared = |corner: &u32| b.contains(corner);
    let (p, q) = (solid.corners(one), solid.corners(other));
    match a.iter().filter(|corner| shared(corner)).count() {
        0 => edges(p).iter().any(|e| pierces(*e, q)) || edges(q).iter().any(|e| pierces(*e, p)),
        1 => {
            let opposite = |t: [u32; 3], corners: [V; 3], others: [u32; 3]| {
                let at = (0..3).find(|i| others.contains(&t[*i])).unwrap_or(0);
                [corners[(at + 1) % 3], corners[(at + 2) % 3]]
            };
            pierces(opposite(a, p, b), q) || pierces(opposite(b, q, a), p)
        }
        2 => {
            let apex = |t: [u32; 3], corners: [V; 3], others: [u32; 3]| {
                let at = (0..3).find(|i| !others.contains(&t[*i])).unwrap_or(0);
                (corners[at], [corners[(at + 1) % 3], corners[(at + 2) % 3]])
            };
            let ((tip, edge), (far, _)) = (apex(a, p, b), apex(b, q, a));
            above(p, far) == 0.0 && folded(edge, tip, far)
        }
        // The same corners twice.
        _ => true,
    }
}

fn edges([a, b, c]: [V; 3]) -> [[V; 2]; 3] {
    [[a, b], [b, c], [c, a]]
}

/// Whether two triangles of one plane that share an edge lie on the same side of it.
fn folded([a, b]: [V; 2], tip: V, far: V) -> bool {
    (0..3).any(|axis| side(axis, a, b, tip) * side(axis, a, b, far) > 0.0)
}

/// Whether a segment meets a triangle, its rim included.
fn pierces([p, q]: [V; 2], t: [V; 3]) -> bool {
    let (from, to) = (above(t, p), above(t, q));
    if (from > 0.0 && to > 0.0) || (from < 0.0 && to < 0.0) {
        return false;
    }
    if from == 0.0 && to == 0.0 {
        return meets_in_plane([p, q], t);
    }
    // The line passes all three edges on the same side, or touches one.
    let turns = edges(t).map(|[a, b]| above([p, q, a], b));
    turns.iter().all(|turn| *turn >= 0.0) || turns.iter().all(|turn| *turn <= 0.0)
}

/// A segment and a triangle of one plane, seen along the axis the triangle is widest in.
fn meets_in_plane([p, q]: [V; 2], t: [V; 3]) -> bool {
    let area = |axis: usize| side(axis, t[0], t[1], t[2]).abs();
    let axis = (1..3).fold(0, |best, axis| if area(axis) > area(best) { axis } else { best });
    let around = |point: V| edges(t).map(|[a, b]| side(axis, a, b, point));
    let inside = |point: V| around(point).iter().all(|s| *s >= 0.0) || around(point).iter().all(|s| *s <= 0.0);
    inside(p) || inside(q) || edges(t).iter().any(|[a, b]| segments_meet(axis, [p, q], [*a, *b]))
}

fn segments_meet(axis: usize, [p, q]: [V; 2], [a, b]: [V; 2]) -> bool {
    let apart = |x: f64, y: f64| (x > 0.0 && y > 0.0) || (x < 0.0 && y < 0.0);
    let (sides, others) = ((side(axis, p, q, a), side(axis, p, q, b)), (side(axis, a, b, p), side(axis, a, b, q)));
    let collinear = sides == (0.0, 0.0) && others == (0.0, 0.0);
    // Collinear segments that overlap have an end inside the triangle, which was looked at before.
    !collinear && !apart(sides.0, sides.1) && !apart(others.0, others.1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(vertices: &[V], triangles: [[u32; 3]; 2]) -> bool {
        first(&Solid { vertices: vertices.to_vec(), triangles: triangles.to_vec() }).is_some()
    }

    const FLAT: [V; 3] = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]];

    fn with(corners: [V; 3]) -> bool {
        pair(&[FLAT, corners].concat(), [[0, 1, 2], [3, 4, 5]])
    }

    #[test]
    fn strangers_may_not_meet() {
        assert!(with([[1.0, 1.0, -1.0], [1.0, 1.0, 1.0], [9.0, 9.0, 0.0]]));
        assert!(!with([[5.0, 5.0, -1.0], [5.0, 5.0, 1.0], [9.0, 9.0, 0.0]]));
        // Touching from above with a corner, in the middle and on an edge.
        assert!(with([[1.0, 1.0, 0.0], [1.0, 1.0, 1.0], [2.0, 1.0, 1.0]]));
        assert!(with([[2.0, 0.0, 0.0], [2.0, 0.0, 1.0], [2.0, -1.0, 1.0]]));
        assert!(!with([[1.0, 1.0, 1e-300], [1.0, 1.0, 1.0], [2.0, 1.0, 1.0]]));
        // In the same plane: apart, overlapping, one inside the other.
        assert!(!with([[5.0, 0.0, 0.0], [9.0, 0.0, 0.0], [5.0, 4.0, 0.0]]));
        assert!(!with([[3.0, 3.0, 0.0], [4.0, 3.0, 0.0], [3.0, 4.0, 0.0]]));
        assert!(with([[3.0, 0.5, 0.0], [9.0, 0.0, 0.0], [5.0, 4.0, 0.0]]));
        assert!(with([[1.0, 1.0, 0.0], [1.5, 1.0, 0.0], [1.0, 1.5, 0.0]]));
        assert!(with([[-9.0, -9.0, 0.0], [30.0, -9.0, 0.0], [-9.0, 30.0, 0.0]]));
    }

    #[test]
    fn neighbours_may_share_what_they_share_and_no_more() {
        let vertices = |extra: [V; 2]| [FLAT.as_slice(), &extra].concat();
        let corner = |extra: [V; 2]| pair(&vertices(extra), [[0, 1, 2], [0, 3, 4]]);
        assert!(!corner([[1.0, 1.0, 1.0], [2.0, 1.0, 1.0]]));
        assert!(!corner([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]));
        assert!(corner([[1.0, 1.0, -1.0], [1.0, 1.0, 1.0]]));
        assert!(corner([[1.0, 1.0, 0.0], [1.0, 2.0, 0.0]]));
        let edge = |far: V| pair(&vertices([far, [0.0; 3]]), [[0, 1, 2], [1, 0, 3]]);
        assert!(!edge([1.0, 1.0, 1.0]) && !edge([1.0, -1.0, 0.0]));
        assert!(edge([1.0, 1.0, 0.0]), "folded onto itself");
    }
}
