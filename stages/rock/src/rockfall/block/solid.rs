//! A closed triangle mesh as a solid: its extent, volume and centroid, and whether it is one.

use nalgebra::Vector3;

use super::crossing;
use super::{V, squared_distance};
use crate::face::inspection::Inspection;
use crate::face::tetrahedra::tetrahedra;
use rockface_core::artefact::{Frame, Mesh};

/// A closed triangle mesh; metres, triangles counter-clockwise seen from outside.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Solid {
    /// Vertices, metres.
    pub vertices: Vec<V>,
    /// Vertex indices of each triangle.
    pub triangles: Vec<[u32; 3]>,
}

/// Why a mesh is no solid.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Flaw {
    /// It has no triangle.
    #[error("it has no triangle")]
    Empty,
    /// A triangle without area.
    #[error("triangle {0} has no area")]
    Degenerate(usize),
    /// Edges that belong to one triangle only.
    #[error("it is open along {0} edges")]
    Open(usize),
    /// Edges of more than two triangles.
    #[error("{0} edges belong to more than two triangles")]
    NonManifoldEdges(usize),
    /// Neighbouring triangles that are oriented against each other.
    #[error("{0} edges have triangles oriented against each other")]
    Inconsistent(usize),
    /// Vertices where the surface touches itself.
    #[error("the surface touches itself at {0} vertices")]
    NonManifoldVertices(usize),
    /// Pieces that do not hang together.
    #[error("it has {0} pieces that do not hang together")]
    Pieces(usize),
    /// Its triangles face inwards, or it encloses nothing.
    #[error("its triangles face inwards")]
    InsideOut,
    /// Two triangles pass through each other.
    #[error("triangles {0} and {1} pass through each other")]
    Crossing(usize, usize),
}

impl Solid {
    /// The same as a mesh in the wall frame.
    pub fn mesh(&self) -> Mesh {
        let (vertices, triangles) = (self.vertices.clone(), self.triangles.clone());
        Mesh { frame: Frame::Wall, vertices, triangles, colours: Vec::new() }
    }

    /// A corner of a triangle.
    pub fn corner(&self, triangle: usize, corner: usize) -> V {
        self.vertices[self.triangles[triangle][corner] as usize]
    }

    /// The three corners of a triangle.
    pub fn corners(&self, triangle: usize) -> [V; 3] {
        [0, 1, 2].map(|corner| self.corner(triangle, corner))
    }

    /// The square of the distance of two vertices, square metres.
    pub fn squared_distance(&self, a: u32, b: u32) -> f64 {
        squared_distance(self.vertices[a as usize], self.vertices[b as usize])
    }

    /// Least and greatest coordinates, metres.
    pub fn bounds(&self) -> [V; 2] {
        let start = [[f64::INFINITY; 3], [f64::NEG_INFINITY; 3]];
        self.vertices.iter().fold(start, |[low, high], v| {
            [std::array::from_fn(|i| low[i].min(v[i])), std::array::from_fn(|i| high[i].max(v[i]))]
        })
    }

    /// Sides of the axis-aligned box, metres.
    pub fn extent(&self) -> V {
        let [low, high] = self.bounds();
        [0, 1, 2].map(|axis| high[axis] - low[axis])
    }

    /// Enclosed volume in cubic metres and its centroid, by the divergence theorem about the centre of the box.
    pub fn volume_and_centroid(&self) -> (f64, V) {
        let [low, high] = self.bounds();
        let origin = (Vector3::from(low) + Vector3::from(high)) * 0.5;
        let (mut six, mut moment) = (0.0, Vector3::zeros());
        for ([a, b, c], part) in tetrahedra(&self.vertices, &self.triangles, origin.into()) {
            six += part;
            moment += (a + (b + c)) * part;
        }
        (six / 6.0, (origin + moment * (0.25 / six)).into())
    }

    /// Enclosed volume, cubic metres; negative where the triangles face inwards.
    pub fn volume(&self) -> f64 {
        self.volume_and_centroid().0
    }

    /// Moves every vertex to the place that `to` gives for it.
    pub fn map(&mut self, to: impl Fn(V) -> V) {
        self.vertices.iter_mut().for_each(|vertex| *vertex = to(*vertex));
    }

    /// Turns every triangle around.
    pub fn flip(&mut self) {
        self.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    }

    /// Unit normals of the vertices, weighted by the area of their triangles; zero where these cancel.
    pub fn vertex_normals(&self) -> Vec<Vector3<f64>> {
        let mut normals = vec![Vector3::zeros(); self.vertices.len()];
        for (index, triangle) in self.triangles.iter().enumerate() {
            let [a, b, c] = self.corners(index).map(Vector3::from);
            let normal = (b - a).cross(&(c - a));
            triangle.iter().for_each(|&v| normals[v as usize] += normal);
        }
        let unit = |normal: Vector3<f64>| {
            let length = normal.norm();
            if length > 0.0 { normal * (1.0 / length) } else { normal }
        };
        normals.into_iter().map(unit).collect()
    }

    /// Whether it is a solid: closed, manifold, outward, and nowhere through itself; or the first flaw.
    pub fn check(&self) -> Result<(), Flaw> {
        self.check_closed()?;
        match crossing::first(self) {
            Some((a, b)) => Err(Flaw::Crossing(a, b)),
            None => Ok(()),
        }
    }

    /// Everything of [`Solid::check`] but whether it passes through itself.
    pub fn check_closed(&self) -> Result<(), Flaw> {
        if self.triangles.is_empty() {
            return Err(Flaw::Empty);
        }
        if let Some(index) = (0..self.triangles.len()).find(|index| crossing::degenerate(self.corners(*index))) {
            return Err(Flaw::Degenerate(index));
        }
        let found = Inspection::of(&self.mesh());
        match (found.crowded_edges.count, found.border_edges, found.opposed_edges.count, found.pinched_vertices.count) {
            (0, 0, 0, 0) => {}
            (0, 0, 0, pinched) => return Err(Flaw::NonManifoldVertices(pinched)),
            (0, 0, opposed, _) => return Err(Flaw::Inconsistent(opposed)),
            (0, open, _, _) => return Err(Flaw::Open(open)),
            (crowded, _, _, _) => return Err(Flaw::NonManifoldEdges(crowded)),
        }
        if found.pieces.len() > 1 {
            return Err(Flaw::Pieces(found.pieces.len()));
        }
        let volume = self.volume();
        if volume > 0.0 { Ok(()) } else { Err(Flaw::InsideOut) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rockfall::block::hull::hull;

    fn cube(at: f64) -> Solid {
        let corner = |i: usize| [0, 1, 2].map(|axis| at + f64::from(u8::from(i >> axis & 1 == 1)));
        hull(&(0..8).map(corner).collect::<Vec<_>>()).unwrap()
    }

    fn joined(a: &Solid, b: &Solid) -> Solid {
        let offset = a.vertices.len() as u32;
        let moved = b.triangles.iter().map(|t| t.map(|v| v + offset));
        Solid {
            vertices: [a.vertices.as_slice(), &b.vertices].concat(),
            triangles: a.triangles.iter().copied().chain(moved).collect(),
        }
    }

    #[test]
    fn a_cube_is_a_solid_of_known_volume_and_centroid() {
        let (volume, centroid) = cube(3.0).volume_and_centroid();
        assert!((volume - 1.0).abs() < 1e-14 && centroid.iter().all(|x| (x - 3.5).abs() < 1e-14));
        assert_eq!(cube(0.0).check(), Ok(()));
    }

    #[test]
    fn each_flaw_is_found() {
        assert_eq!(Solid::default().check(), Err(Flaw::Empty));
        let mut open = cube(0.0);
        open.triangles.pop();
        assert_eq!(open.check(), Err(Flaw::Open(3)));
        let mut turned = cube(0.0);
        turned.triangles[0].swap(0, 1);
        assert_eq!(turned.check(), Err(Flaw::Inconsistent(3)));
        let mut inside = cube(0.0);
        inside.flip();
        assert_eq!(inside.check(), Err(Flaw::InsideOut));
        let mut flat = cube(0.0);
        flat.triangles[0] = [0, 0, 1];
        assert_eq!(flat.check(), Err(Flaw::Degenerate(0)));
        let overlapping = joined(&cube(0.0), &cube(0.5));
        assert_eq!(overlapping.check(), Err(Flaw::Pieces(2)));
        assert!(crossing::first(&overlapping).is_some());
        // Two cubes that share one corner vertex.
        let mut touching = joined(&cube(0.0), &cube(1.0));
        let corner = |v: &V| v.iter().all(|x| (x - 1.0).abs() < 1e-12);
        let shared = touching.vertices.iter().position(corner).unwrap() as u32;
        let twin = touching.vertices.iter().rposition(corner).unwrap() as u32;
        touching.triangles.iter_mut().flatten().filter(|v| **v == twin).for_each(|v| *v = shared);
        assert_eq!(touching.check(), Err(Flaw::NonManifoldVertices(1)));
    }
}
