//! `triangulate-surface`: turns an organised surface into a triangle mesh that other programs open.

use crate::{frame_change, raster_surface};
use rockface_core::artefact::{Artefact, Kind, Mesh, Raster, Surface, Transform};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `triangulate-surface`.
    pub struct TriangulateSurfaceParams {
        /// Every so many rows and columns of points or cells are taken; 1 takes them all.
        step: u32 = 1; rockface_core::params::Range::AtLeast(1.0),
    }
}

/// Writes the points and triangles of an organised surface, or of a raster of elevations, as a mesh (PLY), for other programs and
/// for stages that take meshes.
pub struct TriangulateSurface;

impl Stage for TriangulateSurface {
    type Params = TriangulateSurfaceParams;
    const NAME: &'static str = "triangulate-surface";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("triangulate_surface.md"));
    const INPUTS: &'static [Port] = &[
        Port::one(
            "surface",
            &[Kind::Surface, Kind::Mesh, Kind::Raster],
            "From `fuse-depth` or `clean-mesh`; a raster of elevations; or a mesh.",
        ),
        Port::optional("transform", &[Kind::Transform], "Applied to every point, such as the way back to the world."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The same points and triangles.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let step = params.step as usize;
        let mut mesh = match inputs.artefact("surface")? {
            Artefact::Mesh(_) if step > 1 => fail!("`step` thins the rows and columns of a surface; a mesh has none"),
            Artefact::Mesh(mesh) => mesh.clone(),
            Artefact::Raster(raster) => triangulate(&of_raster(raster)?, step),
            _ => triangulate(inputs.one("surface")?, step),
        };
        if mesh.triangles.is_empty() {
            fail!("the surface has no triangle, or none is left at a step of {step}");
        }
        let change = frame_change::change(mesh.frame, inputs.optional::<Transform>("transform")?)?;
        if let Some(moved) = change.moved {
            mesh.vertices.iter_mut().for_each(|vertex| *vertex = moved.apply(*vertex));
        }
        mesh.frame = change.frame;
        let (vertices, triangles) = (mesh.vertices.len(), mesh.triangles.len());
        context.headline(format!("{vertices} vertices, {triangles} triangles"));
        Ok(Outputs::of("mesh", mesh))
    }
}

fn triangulate(surface: &Surface, step: usize) -> Mesh {
    let corners = if step == 1 { all(surface) } else { thinned(surface, step) };
    let mut numbers = vec![u32::MAX; surface.points.len()];
    corners.iter().flatten().for_each(|place| numbers[*place] = 0);
    let mut vertices = Vec::new();
    for (place, number) in numbers.iter_mut().enumerate().filter(|(_, number)| **number == 0) {
        *number = vertices.len() as u32;
        let (p, o) = (surface.points[place], surface.origin_m);
        vertices.push(std::array::from_fn(|i| o[i] + f64::from(p[i])));
    }
    let triangles = corners.iter().map(|triangle| triangle.map(|place| numbers[place])).collect();
    Mesh { frame: surface.frame, vertices, triangles, colours: Vec::new() }
}

/// The triangles between the cell centres of elevations.
fn of_raster(raster: &Raster) -> Result<Surface, StageError> {
    if raster.quantity != "elevation" {
        let message = format!("the quantity of the raster is `{}`, and a mesh is made of elevations", raster.quantity);
        return Err(StageError::new(message).hint("`quantity: elevation` of `import-rasters` says what a file holds"));
    }
    raster_surface::between_cells(raster).map_err(|error| error.within("`surface`"))
}

fn all(surface: &Surface) -> Vec<[usize; 3]> {
    let squares = (0..surface.height.saturating_sub(1))
        .flat_map(|row| (0..surface.width.saturating_sub(1)).map(move |column| (row, column)));
    squares.flat_map(|(row, column)| surface.triangles(row, column)).collect()
}

fn thinned(surface: &Surface, step: usize) -> Vec<[usize; 3]> {
    let mut triangles = Vec::new();
    for row in (step..surface.height).step_by(step) {
        for column in (step..surface.width).step_by(step) {
            let at = |row: usize, column: usize| row * surface.width + column;
            let (a, b) = (at(row - step, column - step), at(row - step, column));
            let (c, d) = (at(row, column), at(row, column - step));
            if [a, b, c, d].iter().all(|place| !surface.points[*place][0].is_nan()) {
                triangles.extend([[a, d, c], [a, c, b]]);
            }
        }
    }
    triangles
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Frame, Grid};
    use rockface_core::testing::{TestHost, run_stage};

    /// 3 x 3 points, rows down, with a hole in the last corner.
    fn surface() -> Surface {
        let point = |i: u16| if i == 8 { [f32::NAN; 3] } else { [f32::from(i % 3), -f32::from(i / 3), 0.25] };
        let both = Surface::FIRST | Surface::SECOND;
        Surface {
            frame: Frame::Wall,
            width: 3,
            height: 3,
            origin_m: [1000.0, 2000.0, 3.0],
            points: (0..9).map(point).collect(),
            squares: vec![both, both | Surface::OTHER_DIAGONAL, both, Surface::FIRST | Surface::OTHER_DIAGONAL],
        }
    }

    fn made(with: &serde_json::Value, inputs: &[(&str, Artefact)]) -> Result<Mesh, StageError> {
        let made = run_stage::<TriangulateSurface>(&TestHost::default(), with, inputs)?;
        let Some(Artefact::Mesh(mesh)) = made.into_inner().remove("mesh") else { panic!("no mesh") };
        Ok(mesh)
    }

    #[test]
    fn points_and_triangles_are_those_of_the_surface() {
        let mesh = made(&json!({}), &[("surface", surface().into())]).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.triangles.len(), mesh.frame), (8, 7, Frame::Wall));
        assert!((mesh.vertices[7][0] - 1001.0).abs() < 1e-12 && (mesh.vertices[7][1] - 1998.0).abs() < 1e-12);
        let at = |corner: u32| nalgebra::Vector3::from(mesh.vertices[corner as usize]);
        let twice = |[a, b, c]: &[u32; 3]| (at(*b) - at(*a)).cross(&(at(*c) - at(*a))).z;
        assert!((mesh.triangles.iter().map(twice).sum::<f64>() / 2.0 - 3.5).abs() < 1e-9);
    }

    #[test]
    fn a_step_thins_and_a_transform_moves() {
        let mut whole = surface();
        whole.points[8] = [2.0, -2.0, 0.25];
        let mut out = Transform::identity("wall", "world");
        out.translation = [0.0, 0.0, 10.0];
        let inputs = [("surface", whole.into()), ("transform", out.into())];
        let mesh = made(&json!({"step": 2}), &inputs).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.triangles.len(), mesh.frame), (4, 2, Frame::World));
        assert!((mesh.vertices[0][2] - 13.25).abs() < 1e-12);
        let mut in_wall = Transform::identity("world", "wall");
        in_wall.origin = [1e6, 0.0, 0.0];
        let inputs = [("surface", mesh.clone().into()), ("transform", in_wall.clone().into())];
        let moved = made(&json!({}), &inputs).unwrap();
        assert_eq!((moved.frame, moved.triangles == mesh.triangles), (Frame::Wall, true));
        let back = made(&json!({}), &[("surface", moved.into()), ("transform", in_wall.into())]).unwrap();
        assert_eq!(back, mesh);
        let wrong = [("surface", surface().into()), ("transform", Transform::identity("world", "local").into())];
        assert!(made(&json!({}), &wrong).unwrap_err().message.contains("is in the wall frame"));
        assert!(
            made(&json!({"step": 2}), &[("surface", mesh.into())]).unwrap_err().message.contains("a mesh has none")
        );
        assert!(
            made(&json!({"step": 2}), &[("surface", surface().into())]).unwrap_err().message.contains("no triangle")
        );
    }

    #[test]
    fn a_raster_of_elevations_becomes_a_mesh() {
        let grid = Grid { columns: 3, rows: 3, cell_m: 2.0, left_m: 100.0, top_m: 50.0 };
        let values = vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, f32::NAN];
        let raster = Raster::single(grid, Frame::World, "elevation", "z", values);
        let mesh = made(&json!({}), &[("surface", raster.clone().into())]).unwrap();
        // Three squares of two triangles, and one with a corner less.
        assert_eq!((mesh.vertices.len(), mesh.triangles.len(), mesh.frame), (8, 7, Frame::World));
        let first = mesh.triangles[0].map(|corner| mesh.vertices[corner as usize]);
        assert!(first.contains(&[101.0, 49.0, 1.0]) && first.contains(&[101.0, 47.0, 4.0]), "{first:?}");
        let turned = |[a, b, c]: [u32; 3]| {
            let at = |corner: u32| nalgebra::Vector3::from(mesh.vertices[corner as usize]);
            (at(b) - at(a)).cross(&(at(c) - at(a))).z
        };
        assert!(mesh.triangles.iter().all(|triangle| turned(*triangle) > 0.0));
        let other = Raster { quantity: "difference".into(), ..raster };
        assert!(made(&json!({}), &[("surface", other.into())]).unwrap_err().message.contains("is `difference`"));
    }
}
