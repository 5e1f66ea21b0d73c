//! A face in the wall frame as planning needs it: its extent, and how far the rock protrudes at a position.

use nalgebra::Vector3;

use crate::survey::overlap::sample_vertices;
use rockface_core::artefact::{Frame, Mesh};
use rockface_core::{StageError, fail};

/// The extent of a face in the wall frame, metres.
#[derive(Debug, Clone)]
pub struct Face {
    /// Centre of the bounding box in X and Y, mean of the vertices in Z.
    pub centre: Vector3<f64>,
    /// Extent of the vertices along X, metres.
    pub width_m: f64,
    /// Extent of the vertices along Y, metres.
    pub height_m: f64,
    /// Largest Z of the vertices, metres: the rock nearest to the viewer.
    pub nearest_z: f64,
    /// Vertices evenly spaced in the vertex list.
    pub samples: Vec<Vector3<f64>>,
}

impl Face {
    /// Measures the surface of a mesh, and keeps at most `samples` of its vertices.
    ///
    /// # Errors
    ///
    /// When the mesh is not in the wall frame, or empty.
    pub fn of(mesh: &Mesh, samples: usize) -> Result<Self, StageError> {
        if mesh.frame != Frame::Wall {
            let error = StageError::new(format!(
                "the mesh is in the {} frame, a survey is planned in the wall frame",
                mesh.frame
            ));
            return Err(error.hint("send the mesh through transform-crs first"));
        }
        if mesh.vertices.is_empty() {
            fail!("the mesh has no vertices");
        }
        let (mut low, mut high) = (Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY));
        let (mut count, mut sum_z) = (0.0, 0.0);
        for vertex in mesh.surface_points().map(Vector3::from) {
            low = low.inf(&vertex);
            high = high.sup(&vertex);
            count += 1.0;
            sum_z += vertex.z;
        }
        let mean_z = sum_z / count;
        let centre = Vector3::new(0.5 * (low.x + high.x), 0.5 * (low.y + high.y), mean_z);
        let samples = sample_vertices(mesh, samples);
        Ok(Self { centre, width_m: high.x - low.x, height_m: high.y - low.y, nearest_z: high.z, samples })
    }

    /// Mean Z of the samples within `reach_m` of (x, y) along both axes; that of the nearest one where there is none.
    pub fn local_z(&self, [x, y]: [f64; 2], reach_m: [f64; 2]) -> f64 {
        let near = |p: &&Vector3<f64>| (p.x - x).abs() <= reach_m[0] && (p.y - y).abs() <= reach_m[1];
        let (count, sum) = self.samples.iter().filter(near).fold((0.0, 0.0), |(n, sum), p| (n + 1.0, sum + p.z));
        if count > 0.0 {
            return sum / count;
        }
        let distance = |p: &Vector3<f64>| (p.x - x) * (p.x - x) + (p.y - y) * (p.y - y);
        self.samples.iter().min_by(|a, b| distance(a).total_cmp(&distance(b))).map_or(self.centre.z, |p| p.z)
    }

    /// Refuses a station that stands inside or behind rock within `reach_m` of it.
    pub fn check_before(&self, station: &Vector3<f64>, reach_m: [f64; 2], distance_m: f64) -> Result<(), StageError> {
        let near = |p: &&Vector3<f64>| {
            (p.x - station.x).abs() <= reach_m[0] && (p.y - station.y).abs() <= reach_m[1] && p.z >= station.z
        };
        let Some(rock) = self.samples.iter().find(near) else { return Ok(()) };
        let relief = self.nearest_z - self.centre.z;
        Err(StageError::new(format!(
            "the cameras would stand inside or behind the face: {distance_m} m from its mean plane, while rock stands out \
             {relief:.3} m (at X {:.3}, Y {:.3}, Z {:.3} before a station at Z {:.3})",
            rock.x, rock.y, rock.z, station.z
        ))
        .hint(format!("distance_m must be well above {relief:.3}; or the face looks away: its Z must point to the viewer")))
    }
}
