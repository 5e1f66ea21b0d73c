//! Takes away the triangles of a mesh that are no surface, merges what lies at one place, and turns the rest outward.

use nalgebra::Vector3;

use crate::face::{orient, repair};
use rockface_core::artefact::{Frame, Mesh};
use rockface_raster::surface_cleaning::{Removed, Rules};

/// What was done to a mesh besides what [`Removed`] counts.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Mended {
    /// Vertices merged with an earlier one at exactly the same place.
    pub merged_vertices: usize,
    /// Triangles with the corners of an earlier one.
    pub duplicates: usize,
    /// Triangles turned over, so that neighbours agree and, in the wall frame, face out of the rock.
    pub turned: usize,
    /// A piece has one side only: it was left as it is.
    pub one_sided: bool,
}

/// Cleans a mesh; the order of what stays is kept.
pub fn clean(mesh: &mut Mesh, rules: &Rules) -> (Removed, Mended) {
    let mut removed = Removed::default();
    let at = |vertices: &[[f64; 3]], triangle: &[u32; 3]| triangle.map(|corner| vertices[corner as usize]);
    removed.not_finite = retain(mesh, |corners| corners.iter().flatten().all(|value| value.is_finite()), at);
    removed.degenerate = retain(mesh, |corners| area_m2(corners) >= rules.min_area_m2, at);
    removed.outside = retain(mesh, |corners| corners.iter().all(|[x, y, _]| rules.in_window([*x, *y])), at);
    removed.masked = retain(mesh, |corners| corners.iter().all(|[x, y, _]| rules.in_mask([*x, *y])), at);
    let repaired = repair::repair(mesh, rules.min_component_triangles);
    removed.degenerate += repaired.degenerate_triangles;
    removed.small_pieces = repaired.small_piece_triangles;
    removed.points = repaired.unreferenced_vertices;
    removed.kept = mesh.triangles.len();
    let (turned, one_sided) = match orient::make_coherent(mesh) {
        Ok(turned) => (turned + face_outward(mesh), false),
        Err(_) => (0, true),
    };
    let (merged_vertices, duplicates) = (repaired.merged_vertices, repaired.duplicate_triangles);
    (removed, Mended { merged_vertices, duplicates, turned, one_sided })
}

type Corners = [[f64; 3]; 3];

fn retain(mesh: &mut Mesh, holds: impl Fn(&Corners) -> bool, at: impl Fn(&[[f64; 3]], &[u32; 3]) -> Corners) -> usize {
    let before = mesh.triangles.len();
    let vertices = std::mem::take(&mut mesh.vertices);
    mesh.triangles.retain(|triangle| holds(&at(&vertices, triangle)));
    mesh.vertices = vertices;
    before - mesh.triangles.len()
}

fn across([a, b, c]: &Corners) -> Vector3<f64> {
    let [a, b, c] = [a, b, c].map(|p| Vector3::from(*p));
    (b - a).cross(&(c - a))
}

fn area_m2(corners: &Corners) -> f64 {
    0.5 * across(corners).norm()
}

/// In the wall frame, where Z is out of the rock, a mesh that faces the other way is turned over; returns the triangles turned.
fn face_outward(mesh: &mut Mesh) -> usize {
    let out: f64 = mesh.triangles.iter().map(|t| across(&t.map(|corner| mesh.vertices[corner as usize])).z).sum();
    if mesh.frame != Frame::Wall || out >= 0.0 {
        return 0;
    }
    mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
    mesh.triangles.len()
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;
    use rockface_core::artefact::{Grid, Raster};
    use rockface_core::testing::height_mesh;

    fn rules() -> Rules<'static> {
        Rules { min_area_m2: 1e-9, window_m: None, mask: None, min_component_triangles: 1 }
    }

    #[test]
    fn a_good_mesh_stays_to_the_bit() {
        let mut mesh = height_mesh(5, [0.0, 5.0, 0.0, 5.0], |x, y| 0.1 * x * y);
        let before = mesh.clone();
        let (removed, mended) = clean(&mut mesh, &rules());
        assert_eq!((&mesh, mended), (&before, Mended::default()));
        assert_eq!(removed, Removed { kept: 50, ..Removed::default() });
    }

    #[test]
    fn doubled_flipped_loose_and_masked_parts_are_mended_or_go() {
        let mut mesh = height_mesh(4, [0.0, 4.0, 0.0, 4.0], |_, _| 0.0);
        mesh.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        mesh.triangles[0].swap(1, 2);
        // A copy of the last square on vertices of its own, and a sliver far away.
        let own = mesh.vertices.len() as u32;
        let [a, b] = [mesh.triangles[30], mesh.triangles[31]];
        for corner in a.into_iter().chain(b) {
            mesh.vertices.push(mesh.vertices[corner as usize]);
        }
        mesh.triangles.extend([[own, own + 1, own + 2], [own + 3, own + 4, own + 5]]);
        mesh.vertices.extend([[8.0, 8.0, 0.0], [8.4, 8.0, 0.0], [8.0, 8.4, 0.0], [f64::NAN; 3]]);
        mesh.triangles.extend([[own + 6, own + 7, own + 8], [0, 1, own + 9]]);
        let grid = Grid { columns: 10, rows: 10, cell_m: 1.0, left_m: -0.5, top_m: 9.5 };
        let mut values = vec![1.0; 100];
        values[95] = 0.0;
        values[90] = f32::NAN;
        let mask = Raster::single(grid, Frame::Wall, "mask", "mask", values);
        let (removed, mended) = clean(&mut mesh, &Rules { mask: Some(&mask), min_component_triangles: 2, ..rules() });
        assert_eq!((removed.not_finite, removed.small_pieces, mended.duplicates, mended.merged_vertices), (1, 1, 2, 6));
        // Only the corner at the origin lies over the cell without a value: its two triangles.
        assert_eq!((removed.masked, removed.kept, mesh.triangles.len()), (2, 30, 30));
        let up = mesh.triangles.iter().all(|t| across(&t.map(|corner| mesh.vertices[corner as usize])).z > 0.0);
        assert!(up && mended.turned > 0 && !mended.one_sided);
    }
}
