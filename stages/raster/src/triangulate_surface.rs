//! `triangulate-surface`: turns an organised surface into a triangle mesh that other programs open.

use crate::{frame_change, raster_surface};
use rockface_core::artefact::{Artefact, Frame, Kind, Mesh, Meshes, Raster, Surface, Transform};
use rockface_core::params::{Fault, deciding};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Ports, Stage, StageError, choice, fail, params};
use serde_json::Value;

choice! {
    /// What becomes of a set of bodies.
    pub enum Bodies {
        /// One mesh of all of them, at the port `mesh`.
        Joined = "joined",
        /// A set of the same bodies with their names, at the port `meshes`.
        Named = "named",
    }
}

params! {
    /// Parameters of `triangulate-surface`.
    pub struct TriangulateSurfaceParams {
        /// Every so many rows and columns of points or cells are taken; 1 takes them all.
        step: u32 = 1; rockface_core::params::Range::AtLeast(1.0),
        /// Whether a set of bodies, such as the pieces of `remove-blocks`, becomes one mesh or stays a set with their names.
        bodies: Bodies = Bodies::Joined,
    }
}

const TRANSFORM: Port =
    Port::optional("transform", &[Kind::Transform], "Applied to every point, such as the way back to the world.");
const OF_BODIES: &[Port] =
    &[Port::one("surface", &[Kind::Meshes], "A set of bodies; with `bodies: named`."), TRANSFORM];
const NAMED: &[Port] = &[Port::one("meshes", &[Kind::Meshes], "The same bodies; with `bodies: named`.")];

/// Writes the points and triangles of an organised surface, of a raster of elevations, or of a set of bodies as a mesh (PLY), for
/// other programs and for stages that take meshes.
pub struct TriangulateSurface;

impl Stage for TriangulateSurface {
    type Params = TriangulateSurfaceParams;
    const NAME: &'static str = "triangulate-surface";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("triangulate_surface.md"));
    const INPUTS: &'static [Port] = &[
        Port::one(
            "surface",
            &[Kind::Surface, Kind::Mesh, Kind::Raster, Kind::Meshes],
            "From `fuse-depth` or `clean-mesh`; a raster of elevations; a mesh; or a set of bodies.",
        ),
        TRANSFORM,
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The same points and triangles.")];

    fn ports(with: &Value) -> Result<Ports, Vec<Fault>> {
        let named = deciding(with, "bodies")?.and_then(Value::as_str) == Some("named");
        let (inputs, outputs) = if named { (OF_BODIES, NAMED) } else { (Self::INPUTS, Self::OUTPUTS) };
        Ok(Ports { inputs, outputs })
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        let thins = params.bodies == Bodies::Named && params.step > 1;
        let fault = || Fault::new("it thins the rows and columns of a surface; bodies have none").below("step");
        thins.then(fault).into_iter().collect()
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        if params.bodies == Bodies::Named {
            return named(inputs, context);
        }
        let step = params.step as usize;
        let mut mesh = match inputs.artefact("surface")? {
            Artefact::Mesh(_) | Artefact::Meshes(_) if step > 1 => {
                fail!("`step` thins the rows and columns of a surface; a mesh has none")
            }
            Artefact::Mesh(mesh) => mesh.clone(),
            Artefact::Meshes(meshes) => joined(meshes)?,
            Artefact::Raster(raster) => triangulate(&of_raster(raster)?, step),
            _ => triangulate(inputs.one("surface")?, step),
        };
        if mesh.triangles.is_empty() {
            fail!("the surface has no triangle, or none is left at a step of {step}");
        }
        mesh.frame = move_points(mesh.frame, [&mut mesh.vertices], inputs)?;
        let (vertices, triangles) = (mesh.vertices.len(), mesh.triangles.len());
        context.headline(format!("{vertices} vertices, {triangles} triangles"));
        Ok(Outputs::of("mesh", mesh))
    }
}

/// Bodies that keep their names: one without triangles too, and a set of none, as where no rock fell.
fn named(inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
    let mut meshes = inputs.one::<Meshes>("surface")?.clone();
    let vertices = meshes.parts.iter_mut().map(|part| &mut part.vertices);
    meshes.frame = move_points(meshes.frame, vertices, inputs)?;
    let triangles: usize = meshes.parts.iter().map(|part| part.triangles.len()).sum();
    context.headline(format!("{} bodies, {triangles} triangles", meshes.parts.len()));
    Ok(Outputs::of("meshes", meshes))
}

/// Moves points by the transform where one is given; the frame they are in afterwards.
fn move_points<'a>(
    frame: Frame,
    lists: impl IntoIterator<Item = &'a mut Vec<[f64; 3]>>,
    inputs: &Inputs,
) -> Result<Frame, StageError> {
    let change = frame_change::change(frame, inputs.optional::<Transform>("transform")?)?;
    if let Some(moved) = change.moved {
        lists.into_iter().flatten().for_each(|point| *point = moved.apply(*point));
    }
    Ok(change.frame)
}

/// All bodies as one mesh, in their order.
fn joined(meshes: &Meshes) -> Result<Mesh, StageError> {
    if meshes.parts.is_empty() {
        let hint = "`bodies: named` takes a set without bodies too, as where no rock fell";
        return Err(StageError::new("`surface` is a set of bodies without a body").hint(hint));
    }
    let vertices: Vec<[f64; 3]> = meshes.parts.iter().flat_map(|part| part.vertices.iter().copied()).collect();
    if u32::try_from(vertices.len()).is_err() {
        fail!("the bodies have {} vertices, too many for one mesh", vertices.len());
    }
    let mut triangles = Vec::new();
    let mut first = 0;
    for part in &meshes.parts {
        triangles.extend(part.triangles.iter().map(|triangle| triangle.map(|corner| first + corner)));
        first += part.vertices.len() as u32;
    }
    Ok(Mesh { frame: meshes.frame, vertices, triangles, colours: Vec::new() })
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
    use rockface_core::artefact::{Frame, Grid, Part};
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

    /// Two tetrahedra in the wall frame.
    fn bodies() -> Meshes {
        let part = |name: &str, x: f64| Part {
            name: name.into(),
            class: "wedge".into(),
            vertices: vec![[x, 0.0, 0.0], [x + 1.0, 0.0, 0.0], [x, 1.0, 0.0], [x, 0.0, 1.0]],
            triangles: vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]],
        };
        Meshes { frame: Frame::Wall, parts: vec![part("1", 0.0), part("2", 5.0)] }
    }

    fn wall_from_world() -> Transform {
        Transform { origin: [1e6, 5e6, 0.0], ..Transform::identity("world", "wall") }
    }

    #[test]
    fn bodies_become_one_mesh_in_the_world() {
        let inputs = [("surface", bodies().into()), ("transform", wall_from_world().into())];
        let mesh = made(&json!({}), &inputs).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.triangles.len(), mesh.frame), (8, 8, Frame::World));
        assert_eq!(mesh.triangles[7], [5, 6, 7]);
        assert!((mesh.vertices[5][0] - 1_000_006.0).abs() < 1e-9 && (mesh.vertices[5][1] - 5e6).abs() < 1e-9);
        let none = Meshes { parts: Vec::new(), ..bodies() };
        assert!(made(&json!({}), &[("surface", none.into())]).unwrap_err().message.contains("without a body"));
        let thinned = made(&json!({"step": 2}), &[("surface", bodies().into())]);
        assert!(thinned.unwrap_err().message.contains("a mesh has none"));
    }

    #[test]
    fn bodies_may_keep_their_names() {
        let run = |meshes: Meshes| {
            let inputs = [("surface", meshes.into()), ("transform", wall_from_world().into())];
            run_stage::<TriangulateSurface>(&TestHost::default(), &json!({"bodies": "named"}), &inputs)
        };
        let Some(Artefact::Meshes(moved)) = run(bodies()).unwrap().into_inner().remove("meshes") else {
            panic!("no meshes")
        };
        assert_eq!(moved.frame, Frame::World);
        let told = |part: &Part| (part.name.clone(), part.class.clone(), part.triangles.clone());
        assert!(moved.parts.iter().map(told).eq(bodies().parts.iter().map(told)));
        assert!((moved.parts[1].vertices[1][0] - 1_000_006.0).abs() < 1e-9);
        assert!(run(Meshes { parts: Vec::new(), ..bodies() }).is_ok());
        let ports = TriangulateSurface::ports(&json!({"bodies": "named"})).unwrap();
        assert_eq!((ports.inputs[0].kinds, ports.outputs[0].name), (&[Kind::Meshes][..], "meshes"));
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
