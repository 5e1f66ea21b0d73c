//! The exact Boolean of a rock patch and a block: what is taken and what is left, each triangle with where it comes from.

use std::panic::{AssertUnwindSafe, catch_unwind};

use manifold_rust::manifold::Manifold;
use manifold_rust::types::{BooleanEngine, Error, MeshGLP, OpType};

/// Where a triangle of a result comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Origin {
    /// A triangle of the rock face, by number.
    Rock(u32),
    /// What closes the patch to a solid.
    Closing,
    /// A triangle of the block, by number.
    Block(u32),
}

const ROCK: u32 = 1;
const CLOSING: u32 = 2;
const BLOCK: u32 = 3;

/// The surface of a closed result.
#[derive(Debug, Clone, Default)]
pub struct Shell {
    /// Vertices, metres.
    pub places: Vec<[f64; 3]>,
    /// Triangles, outward.
    pub triangles: Vec<[u32; 3]>,
    /// Where each triangle comes from.
    pub origins: Vec<Origin>,
}

/// A closed mesh ready for Booleans.
pub struct Solid(Manifold);

/// Why there is no result.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum BooleanError {
    /// An operand is not a closed, oriented manifold.
    #[error("not a closed, consistently oriented mesh ({0})")]
    NotSolid(String),
    /// The library gave up.
    #[error("the Boolean gave up ({0})")]
    GaveUp(String),
}

impl Solid {
    /// Rock: the triangles of a patch and those that close it.
    pub fn rock(places: &[[f64; 3]], patch: &[[u32; 3]], closing: &[[u32; 3]]) -> Result<Self, BooleanError> {
        let runs = (vec![0, 3 * patch.len() as u32, 3 * (patch.len() + closing.len()) as u32], vec![ROCK, CLOSING]);
        import(places, &[patch, closing].concat(), runs)
    }

    /// A block, whose triangles results name by their place in this list.
    pub fn block(places: &[[f64; 3]], triangles: &[[u32; 3]]) -> Result<Self, BooleanError> {
        import(places, triangles, (vec![0, 3 * triangles.len() as u32], vec![BLOCK]))
    }

    /// Whether triangles of its surface cross or overlap each other.
    pub fn crosses_itself(&self) -> Result<bool, BooleanError> {
        guarded(|| Ok(self.0.has_self_intersections()))
    }

    /// What the two have in common.
    pub fn intersection(&self, other: &Self) -> Result<Self, BooleanError> {
        self.combine(other, OpType::Intersect)
    }

    /// What is left of this without the other.
    pub fn difference(&self, other: &Self) -> Result<Self, BooleanError> {
        self.combine(other, OpType::Subtract)
    }

    /// Edges and faces are intersected in floating point with symbolic perturbation (Smith 2009), so that coincident faces
    /// of rock and block cancel.
    fn combine(&self, other: &Self, operation: OpType) -> Result<Self, BooleanError> {
        guarded(|| {
            let result = self.0.boolean_with_engine(&other.0, operation, BooleanEngine::Exact);
            match result.status() {
                Error::NoError => Ok(Self(result)),
                status => Err(BooleanError::GaveUp(format!("{status:?}"))),
            }
        })
    }

    /// Its surface, each triangle with where it comes from.
    pub fn shell(&self) -> Shell {
        let mesh: MeshGLP<f64, u32> = self.0.get_mesh_glp(-1);
        let width = mesh.num_prop as usize;
        let mut origins = vec![Origin::Closing; mesh.num_tri()];
        for (run, origin) in mesh.run_original_id.iter().enumerate() {
            let triangles = mesh.run_index[run] as usize / 3..mesh.run_index[run + 1] as usize / 3;
            for (place, face) in origins[triangles.clone()].iter_mut().zip(&mesh.face_id[triangles]) {
                *place = match *origin {
                    ROCK => Origin::Rock(*face),
                    BLOCK => Origin::Block(*face),
                    _ => Origin::Closing,
                };
            }
        }
        Shell {
            places: mesh.vert_properties.chunks_exact(width).map(|p| [p[0], p[1], p[2]]).collect(),
            triangles: mesh.tri_verts.as_chunks().0.to_vec(),
            origins,
        }
    }
}

fn import(
    places: &[[f64; 3]],
    triangles: &[[u32; 3]],
    (run_index, run_original_id): (Vec<u32>, Vec<u32>),
) -> Result<Solid, BooleanError> {
    let mesh = MeshGLP::<f64, u32> {
        num_prop: 3,
        vert_properties: places.iter().flatten().copied().collect(),
        tri_verts: triangles.iter().flatten().copied().collect(),
        run_index,
        run_original_id,
        // Numbers of their own keep neighbours in one plane apart, so that no vertex of the face is simplified away.
        face_id: (0..triangles.len() as u32).collect(),
        ..Default::default()
    };
    guarded(|| {
        let solid = Manifold::from_mesh_glp(&mesh);
        match solid.status() {
            Error::NoError if !solid.is_empty() => Ok(Solid(solid)),
            status => Err(BooleanError::NotSolid(format!("{status:?}"))),
        }
    })
}

/// A panic of the library is a failure of this one Boolean.
fn guarded<T>(work: impl FnOnce() -> Result<T, BooleanError>) -> Result<T, BooleanError> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|panic| {
        let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
        let text = text.or_else(|| panic.downcast_ref::<String>().cloned());
        Err(BooleanError::GaveUp(text.unwrap_or_else(|| "it panicked".to_owned())))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const CUBE: [[u32; 3]; 12] = [
        [0, 2, 1],
        [0, 3, 2],
        [4, 5, 6],
        [4, 6, 7],
        [0, 1, 5],
        [0, 5, 4],
        [1, 2, 6],
        [1, 6, 5],
        [2, 3, 7],
        [2, 7, 6],
        [3, 0, 4],
        [3, 4, 7],
    ];

    fn cube(low: f64, high: f64) -> Vec<[f64; 3]> {
        let square = [[low, low], [high, low], [high, high], [low, high]];
        [low, high].iter().flat_map(|z| square.map(|[x, y]| [x, y, *z])).collect()
    }

    #[test]
    fn results_know_where_their_triangles_come_from() {
        let rock = Solid::rock(&cube(0.0, 2.0), &CUBE[..4], &CUBE[4..]).unwrap();
        let block = Solid::block(&cube(1.0, 3.0), &CUBE).unwrap();
        let taken = rock.intersection(&block).unwrap().shell();
        // The upper corner: half a face from the patch, the rest from what closes it and from the block.
        let count = |wanted: fn(&Origin) -> bool| taken.origins.iter().filter(|o| wanted(o)).count();
        assert!(count(|o| matches!(o, Origin::Rock(2 | 3))) >= 2, "{:?}", taken.origins);
        assert!(count(|o| *o == Origin::Closing) >= 4 && count(|o| matches!(o, Origin::Block(_))) >= 6);
        assert!(!rock.intersection(&block).unwrap().crosses_itself().unwrap());
    }

    #[test]
    fn an_open_or_inverted_mesh_is_no_solid() {
        assert!(matches!(Solid::block(&cube(0.0, 1.0), &CUBE[1..]), Err(BooleanError::NotSolid(_))));
        let nan = [[f64::NAN; 3]].repeat(8);
        assert!(matches!(Solid::block(&nan, &CUBE), Err(BooleanError::NotSolid(_))));
    }
}
