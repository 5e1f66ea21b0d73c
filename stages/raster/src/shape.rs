//! One view of a mesh, an organised surface and a point cloud: points by number, triangles by strip.

use nalgebra::Point3;

use rockface_core::artefact::{Artefact, Cloud, Frame, Mesh, Surface, Transform};

/// Triangles of a mesh that make one strip.
const STRIP_TRIANGLES: usize = 1024;

/// Anything made of points, and triangles where it has some.
#[derive(Debug, Clone, Copy)]
pub enum Shape<'a> {
    /// A mesh, whose triangles are listed.
    Mesh(&'a Mesh),
    /// A mesh of which some vertices are no part of the surface: their places are empty. [`surface_vertices`] says which are part of it.
    Part(&'a Mesh, &'a [bool]),
    /// An organised grid of points.
    Surface(&'a Surface),
    /// Points without triangles.
    Cloud(&'a Cloud),
}

impl<'a> Shape<'a> {
    /// The shape of an artefact, where it has one.
    pub fn of(artefact: &'a Artefact) -> Option<Self> {
        match artefact {
            Artefact::Mesh(mesh) => Some(Self::Mesh(mesh)),
            Artefact::Surface(surface) => Some(Self::Surface(surface)),
            Artefact::Cloud(cloud) => Some(Self::Cloud(cloud)),
            _ => None,
        }
    }

    /// The same with the places of those vertices empty that [`surface_vertices`] does not count, for those who take vertices as points.
    #[must_use]
    pub fn on_surface(self, vertices: Option<&'a [bool]>) -> Self {
        match (self, vertices) {
            (Self::Mesh(mesh), Some(vertices)) => Self::Part(mesh, vertices),
            _ => self,
        }
    }

    /// The frame of its points.
    pub fn frame(self) -> Frame {
        match self {
            Self::Mesh(mesh) | Self::Part(mesh, _) => mesh.frame,
            Self::Surface(surface) => surface.frame,
            Self::Cloud(cloud) => cloud.frame,
        }
    }

    /// Number of places for points; a place of a surface or of a part of a mesh may be empty.
    pub fn places(self) -> usize {
        match self {
            Self::Mesh(mesh) | Self::Part(mesh, _) => mesh.vertices.len(),
            Self::Surface(surface) => surface.points.len(),
            Self::Cloud(cloud) => cloud.points.len(),
        }
    }

    /// The point at a place, metres, moved by `transform`; NaN where the place is empty.
    #[inline]
    pub fn point(self, place: usize, transform: Option<&Moved>) -> [f64; 3] {
        let point = match self {
            Self::Mesh(mesh) => mesh.vertices[place],
            Self::Part(mesh, used) => {
                if !used[place] {
                    return [f64::NAN; 3];
                }
                mesh.vertices[place]
            }
            Self::Cloud(cloud) => cloud.points[place],
            Self::Surface(surface) => {
                let (p, o) = (surface.points[place], surface.origin_m);
                [o[0] + f64::from(p[0]), o[1] + f64::from(p[1]), o[2] + f64::from(p[2])]
            }
        };
        transform.map_or(point, |moved| moved.apply(point))
    }

    /// Number of strips the triangles come in.
    pub fn strips(self) -> usize {
        match self {
            Self::Mesh(mesh) | Self::Part(mesh, _) => mesh.triangles.len().div_ceil(STRIP_TRIANGLES),
            Self::Surface(surface) => surface.height.saturating_sub(1),
            Self::Cloud(_) => 0,
        }
    }

    /// Hands over each triangle of a strip as the places of its corners.
    #[inline]
    pub fn for_each_triangle(self, strip: usize, mut visit: impl FnMut([usize; 3])) {
        match self {
            Self::Mesh(mesh) | Self::Part(mesh, _) => {
                let end = mesh.triangles.len().min((strip + 1) * STRIP_TRIANGLES);
                for triangle in &mesh.triangles[strip * STRIP_TRIANGLES..end] {
                    visit(triangle.map(|index| index as usize));
                }
            }
            Self::Surface(surface) => {
                for column in 0..surface.width.saturating_sub(1) {
                    surface.triangles(strip, column).for_each(&mut visit);
                }
            }
            Self::Cloud(_) => {}
        }
    }
}

/// Which vertices of an artefact are part of its surface; `None` where all are, and where it is no mesh. Hand it to [`Shape::on_surface`].
pub fn surface_vertices(artefact: &Artefact) -> Option<Vec<bool>> {
    if let Artefact::Mesh(mesh) = artefact { mesh.surface_vertices() } else { None }
}

/// A transform made ready for millions of points.
#[derive(Debug, Clone, Copy)]
pub struct Moved {
    rotation: nalgebra::Matrix3<f64>,
    origin: nalgebra::Vector3<f64>,
    translation: nalgebra::Vector3<f64>,
}

impl Moved {
    /// `None` for the identity, which must not touch a bit.
    pub fn by(transform: &Transform) -> Option<Self> {
        let (origin, translation) = (transform.origin.into(), transform.translation.into());
        (!transform.is_identity()).then(|| Self { rotation: transform.matrix(), origin, translation })
    }

    /// The moved point; the same arithmetic as [`Transform::apply`].
    #[inline]
    pub fn apply(&self, point: [f64; 3]) -> [f64; 3] {
        let local = Point3::from(point).coords - self.origin;
        (self.rotation * local + self.translation).into()
    }

    /// A direction, turned as the points are.
    pub fn turn(&self, direction: [f64; 3]) -> [f64; 3] {
        (self.rotation * nalgebra::Vector3::from(direction)).into()
    }
}
