//! Evening out the edges of a closed mesh: long ones are cut, short ones collapse where the surface bends little.

use std::collections::BTreeSet;

use nalgebra::Vector3;

use super::subdivide;
use super::{Solid, V, squared_distance};

/// Cosine by which a triangle may turn when an edge collapses: 45 degrees.
const LEAST_COSINE: f64 = 0.707;
/// Cosine of the angle of 30 degrees between triangles around a vertex above which it belongs to a sharp form.
const SHARP_COSINE: f64 = 0.866;
/// How far off the surface a vertex may end, as a share of the edges: on a sharp form (along a straight edge of it) and
/// elsewhere.
const OFF: [f64; 2] = [1e-9, 0.1];
/// Rounds after which edges are left as they are.
const ROUNDS: usize = 12;

/// Cuts edges longer than four thirds of `edge_m` and collapses those shorter than four fifths of it, after the limits of
/// Botsch and Kobbelt (2004), until nothing changes. An edge collapses onto one of its ends, so vertices stay on the
/// surface; vertices of sharp forms only move along straight edges of these. `false` where this would need more than a million triangles.
pub fn to_edge(solid: &mut Solid, edge_m: f64) -> bool {
    for _ in 0..ROUNDS {
        if !subdivide::to_edge(solid, edge_m * 4.0 / 3.0) {
            return false;
        }
        if collapse(solid, edge_m) == 0 {
            break;
        }
    }
    true
}

struct Net<'a> {
    vertices: &'a [V],
    triangles: Vec<[u32; 3]>,
    alive: Vec<bool>,
    /// Triangles around each vertex; dead ones are taken out.
    around: Vec<Vec<u32>>,
}

/// Collapses short edges; returns how many.
fn collapse(solid: &mut Solid, edge_m: f64) -> usize {
    let mut around: Vec<Vec<u32>> = vec![Vec::new(); solid.vertices.len()];
    for (number, triangle) in solid.triangles.iter().enumerate() {
        triangle.iter().for_each(|v| around[*v as usize].push(number as u32));
    }
    let alive = vec![true; solid.triangles.len()];
    let mut net = Net { vertices: &solid.vertices, triangles: solid.triangles.clone(), alive, around };
    let (short, long) = (edge_m * 0.8, edge_m * 4.0 / 3.0);
    let collapsed = (0..solid.vertices.len() as u32).filter(|vertex| net.collapse_one(*vertex, short, long)).count();
    let kept = net.triangles.iter().zip(&net.alive).filter(|(_, alive)| **alive).map(|(t, _)| *t).collect();
    solid.triangles = kept;
    drop_unused(solid);
    collapsed
}

impl Net<'_> {
    fn at(&self, vertex: u32) -> V {
        self.vertices[vertex as usize]
    }

    fn neighbours(&self, vertex: u32) -> BTreeSet<u32> {
        let corners = self.around[vertex as usize].iter().flat_map(|t| self.triangles[*t as usize]);
        corners.filter(|v| *v != vertex).collect()
    }

    /// Moves a vertex onto its nearest neighbour where that is near and harms nothing; whether it did.
    fn collapse_one(&mut self, vertex: u32, short: f64, long: f64) -> bool {
        let neighbours = self.neighbours(vertex);
        let apart = |other: &u32| squared_distance(self.at(vertex), self.at(*other));
        let mut near: Vec<u32> = neighbours.iter().copied().filter(|other| apart(other) < short * short).collect();
        near.sort_by(|a, b| apart(a).total_cmp(&apart(b)).then(a.cmp(b)));
        let Some(onto) = near.into_iter().find(|onto| self.may_move(vertex, *onto, &neighbours, long)) else {
            return false;
        };
        for triangle in std::mem::take(&mut self.around[vertex as usize]) {
            let corners = self.triangles[triangle as usize];
            if corners.contains(&onto) {
                self.alive[triangle as usize] = false;
                corners.iter().for_each(|v| self.around[*v as usize].retain(|t| *t != triangle));
            } else {
                self.triangles[triangle as usize] = corners.map(|v| if v == vertex { onto } else { v });
                self.around[onto as usize].push(triangle);
            }
        }
        true
    }

    /// The mesh stays a manifold (the link condition), no triangle turns far or becomes long.
    fn may_move(&self, vertex: u32, onto: u32, neighbours: &BTreeSet<u32>, long: f64) -> bool {
        let common = self.neighbours(onto).intersection(neighbours).count();
        let far = |other: &&u32| squared_distance(self.at(onto), self.at(**other)) > long * long;
        // A tetrahedron has nothing to lose.
        if common != 2 || neighbours.len() < 4 || neighbours.iter().any(|other| far(&other)) {
            return false;
        }
        if !self.stays_near(vertex, onto, 0.75 * long) {
            return false;
        }
        let staying = self.around[vertex as usize].iter().map(|t| self.triangles[*t as usize]);
        staying.filter(|corners| !corners.contains(&onto)).all(|corners| {
            let before = self.normal(corners);
            let after = self.normal(corners.map(|v| if v == vertex { onto } else { v }));
            let lengths = (before.norm_squared() * after.norm_squared()).sqrt();
            lengths > 0.0 && before.dot(&after) > LEAST_COSINE * lengths
        })
    }

    /// Whether the place of another vertex is close to the planes of all triangles around this one.
    fn stays_near(&self, vertex: u32, onto: u32, edge_m: f64) -> bool {
        let unit = |t: &u32| {
            let normal = self.normal(self.triangles[*t as usize]);
            normal * (1.0 / normal.norm())
        };
        let normals: Vec<Vector3<f64>> = self.around[vertex as usize].iter().map(unit).collect();
        let sharp = normals.iter().enumerate().any(|(i, a)| normals[..i].iter().any(|b| a.dot(b) < SHARP_COSINE));
        let step = Vector3::from(self.at(onto)) - Vector3::from(self.at(vertex));
        normals.iter().all(|normal| normal.dot(&step).abs() <= OFF[usize::from(!sharp)] * edge_m)
    }

    fn normal(&self, corners: [u32; 3]) -> Vector3<f64> {
        let [a, b, c] = corners.map(|v| Vector3::from(self.at(v)));
        (b - a).cross(&(c - a))
    }
}

fn drop_unused(solid: &mut Solid) {
    let mut mesh = solid.mesh();
    rockface_raster::mesh_check::drop_unreferenced(&mut mesh);
    (solid.vertices, solid.triangles) = (mesh.vertices, mesh.triangles);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rockfall::block::hull::hull;

    fn lengths(solid: &Solid) -> Vec<f64> {
        let edges = |t: usize| {
            let [a, b, c] = solid.corners(t);
            [(a, b), (b, c), (c, a)].map(|(p, q)| squared_distance(p, q).sqrt())
        };
        (0..solid.triangles.len()).flat_map(edges).collect()
    }

    #[test]
    fn a_fine_cube_becomes_coarse_and_keeps_its_form() {
        let cube: Vec<V> = (0..8).map(|i| [i & 1, i >> 1 & 1, i >> 2].map(f64::from)).collect();
        let mut solid = hull(&cube).unwrap();
        subdivide::to_edge(&mut solid, 0.06);
        let before = solid.triangles.len();
        assert!(to_edge(&mut solid, 0.3));
        assert_eq!(solid.check(), Ok(()));
        assert!((solid.volume() - 1.0).abs() < 1e-12, "{}", solid.volume());
        assert!(solid.triangles.len() * 8 < before, "{} of {before}", solid.triangles.len());
        assert!(lengths(&solid).iter().all(|length| *length <= 0.4 + 1e-12));
    }

    #[test]
    fn a_sphere_of_uneven_triangles_is_evened_out() {
        let points: Vec<V> = (0..1500)
            .map(|i| {
                // Points crowd at one pole.
                let z = 1.0 - 2.0 * (f64::from(i) / 1500.0) * (f64::from(i) / 1500.0);
                let (sin, cos) = rockface_core::numerics::portable_math::sincos(f64::from(i) * 2.4);
                let across = (1.0 - z * z).max(0.0).sqrt();
                [across * cos, across * sin, z]
            })
            .collect();
        let mut solid = hull(&points).unwrap();
        let volume = solid.volume();
        assert!(to_edge(&mut solid, 0.2));
        assert_eq!(solid.check(), Ok(()));
        assert!((solid.volume() / volume - 1.0).abs() < 0.03, "{} of {volume}", solid.volume());
        let lengths = lengths(&solid);
        let short = lengths.iter().filter(|length| **length < 0.1).count();
        assert!(short * 25 < lengths.len(), "{short} of {}", lengths.len());
    }
}
