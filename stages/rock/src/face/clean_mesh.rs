//! `clean-mesh`: a surface or mesh without invalid, degenerate, stray, doubled and unwanted triangles.

use serde_json::Value;

use crate::face::mesh_cleaning;
use crate::face::mesh_cleaning::Mended;
use rockface_core::artefact::{Frame, Kind, Mesh, Raster, Surface};
use rockface_core::params::{Fault, Range, deciding};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Ports, Stage, StageError, choice, fail, params};
use rockface_raster::surface_cleaning::{Removed, Rules, clean};
use rockface_raster::window;

choice! {
    /// What is cleaned.
    pub enum Subject {
        /// An organised surface, port `surface`: it keeps its grid.
        Surface = "surface",
        /// A mesh, port `mesh`, such as one that another program fused.
        Mesh = "mesh",
    }
}

params! {
    /// Parameters of `clean-mesh`.
    pub struct CleanMeshParams {
        /// What is cleaned.
        of: Subject = Subject::Surface,
        /// Smallest area of a triangle, square metres.
        min_area_m2: f64 = 1e-12; Range::NonNegative,
        /// Fewest triangles of a connected piece.
        min_component_triangles: u32 = 100,
        /// Rectangle `[x0, x1, y0, y1]` triangles must lie in, metres; null: everywhere.
        window_m: Option<[f64; 4]> = None,
    }
}

/// Removes unusable triangles from a surface or mesh.
pub struct CleanMesh;

const MASK: Port = Port::optional(
    "mask",
    &[Kind::Raster],
    "Where the surface is valid: triangles stay whose corners lie over cells with a value that is not 0 (first band).",
);
const MESH: &[Port] = &[Port::one("mesh", &[Kind::Mesh], "The mesh to clean; with `of: mesh`.").changed(), MASK];
const CLEANED: &[Port] = &[Port::one("mesh", &[Kind::Mesh], "The cleaned mesh; with `of: mesh`.")];

impl Stage for CleanMesh {
    type Params = CleanMeshParams;
    const NAME: &'static str = "clean-mesh";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("clean_mesh.md"));
    const INPUTS: &'static [Port] = &[Port::one("surface", &[Kind::Surface], "The surface to clean.").changed(), MASK];
    const OUTPUTS: &'static [Port] =
        &[Port::one("surface", &[Kind::Surface], "The cleaned surface, on the same grid.")];

    fn ports(with: &Value) -> Result<Ports, Vec<Fault>> {
        let of_mesh = deciding(with, "of")?.and_then(Value::as_str) == Some("mesh");
        let (inputs, outputs) = if of_mesh { (MESH, CLEANED) } else { (Self::INPUTS, Self::OUTPUTS) };
        Ok(Ports { inputs, outputs })
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        window::faults(params.window_m)
    }

    fn memory_bytes(params: &Self::Params, inputs: &InputSizes) -> u64 {
        // A copy to change and what marks its triangles; of a mesh its edges too.
        let copies = match params.of {
            Subject::Surface => {
                inputs.copy_of("surface") + inputs.of("surface") / 10 + inputs.of_file(inputs.of("surface"))
            }
            Subject::Mesh => inputs.copy_of("mesh") + 2 * inputs.of("mesh"),
        };
        inputs.total() + copies
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mask = inputs.optional::<Raster>("mask")?;
        let rules = Rules {
            min_area_m2: params.min_area_m2,
            window_m: params.window_m,
            mask,
            min_component_triangles: params.min_component_triangles as usize,
        };
        match params.of {
            Subject::Surface => {
                let mut surface = inputs.owned::<Surface>("surface")?;
                if surface.width < 2 || surface.height < 2 {
                    fail!("the surface has {} x {} points, at least 2 x 2 are needed", surface.width, surface.height);
                }
                check_mask(mask, surface.frame)?;
                report(context, &clean(&mut surface, &rules))?;
                Ok(Outputs::of("surface", surface))
            }
            Subject::Mesh => {
                let mut mesh = inputs.owned::<Mesh>("mesh")?;
                check_mask(mask, mesh.frame)?;
                let (removed, mended) = mesh_cleaning::clean(&mut mesh, &rules);
                report(context, &removed)?;
                report_mended(context, &mended);
                Ok(Outputs::of("mesh", mesh))
            }
        }
    }
}

fn check_mask(mask: Option<&Raster>, frame: Frame) -> Result<(), StageError> {
    match mask {
        Some(mask) if mask.frame != frame => {
            fail!("`mask` is in the {} frame, what is cleaned in the {frame} frame", mask.frame)
        }
        _ => Ok(()),
    }
}

fn causes(removed: &Removed) -> String {
    let Removed { not_finite, degenerate, outside, masked, small_pieces, .. } = removed;
    format!(
        "{not_finite} triangles not finite, {degenerate} degenerate, {outside} outside, {masked} masked, {small_pieces} in small pieces"
    )
}

/// Tells what went; an error where nothing stayed.
fn report(context: &Context, removed: &Removed) -> Result<(), StageError> {
    let counts = [
        ("triangles", removed.kept),
        ("removed_not_finite", removed.not_finite),
        ("removed_degenerate", removed.degenerate),
        ("removed_outside", removed.outside),
        ("removed_masked", removed.masked),
        ("removed_small_pieces", removed.small_pieces),
        ("removed_points", removed.points),
    ];
    for (name, count) in counts {
        context.metric(name, count as f64, "1");
    }
    if removed.kept == 0 {
        return Err(StageError::new(format!("nothing is left of the surface: {}", causes(removed)))
            .hint("move `window_m`, look at `mask`, or lower `min_component_triangles` or `min_area_m2`"));
    }
    Ok(())
}

fn report_mended(context: &Context, mended: &Mended) {
    let counts = [
        ("merged_vertices", mended.merged_vertices),
        ("removed_duplicates", mended.duplicates),
        ("turned_triangles", mended.turned),
    ];
    for (name, count) in counts {
        context.metric(name, count as f64, "1");
    }
    if mended.one_sided {
        context.warn("a piece of the mesh has one side only (a Moebius strip): its triangles stay as they are");
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Noun};
    use rockface_core::testing::{TestHost, run_stage};
    use serde_json::{Value, json};

    /// 12 x 10 points 1 m apart, every square with both triangles.
    fn sheet() -> Surface {
        let points = (0..120).map(|i| [(i % 12) as f32, -((i / 12) as f32), 0.0]).collect();
        let squares = vec![Surface::FIRST | Surface::SECOND; 11 * 9];
        Surface { frame: Frame::Wall, width: 12, height: 10, origin_m: [100.0, 50.0, 0.0], points, squares }
    }

    fn run(surface: &Surface, with: &Value, host: &TestHost) -> Result<Surface, StageError> {
        let inputs = [("surface", Artefact::Surface(surface.clone()))];
        let outputs = run_stage::<CleanMesh>(host, with, &inputs)?.into_inner();
        Ok(Surface::of(&outputs["surface"]).unwrap().clone())
    }

    #[test]
    fn a_good_surface_stays_to_the_bit() {
        assert_eq!(run(&sheet(), &json!({}), &TestHost::default()).unwrap(), sheet());
    }

    #[test]
    fn each_cause_takes_its_triangles() {
        let mut surface = sheet();
        surface.points[0] = [f32::NAN; 3];
        surface.points[5][1] = f32::INFINITY;
        surface.points[80] = surface.points[81];
        let host = TestHost::default();
        let cleaned =
            run(&surface, &json!({"window_m": [100, 110.5, 0, 50], "min_component_triangles": 2}), &host).unwrap();
        // The corner has two triangles, a point on the edge three, the last column of squares 18; a point moved onto
        // its right neighbour leaves the two triangles that have both without area.
        assert_eq!(host.metric("removed_not_finite"), Some(5.0));
        assert_eq!(host.metric("removed_degenerate"), Some(2.0));
        assert_eq!(host.metric("removed_outside"), Some(18.0));
        assert_eq!(host.metric("triangles"), Some(198.0 - 25.0));
        assert!(cleaned.point(0, 0).is_none() && cleaned.point(0, 5).is_none() && cleaned.point(3, 11).is_none());
        assert_eq!(host.metric("removed_points"), Some(11.0));
    }

    #[test]
    fn small_pieces_go_and_large_ones_stay() {
        let mut surface = sheet();
        // Columns of squares 3 and 8 are gone: pieces of 3, 4 and 2 columns of 9 squares.
        for (i, square) in surface.squares.iter_mut().enumerate() {
            if [3, 8].contains(&(i % 11)) {
                *square = 0;
            }
        }
        let host = TestHost::default();
        let cleaned = run(&surface, &json!({"min_component_triangles": 54}), &host).unwrap();
        assert_eq!(host.metric("removed_small_pieces"), Some(36.0));
        assert_eq!(cleaned.squares[10], 0);
        assert_eq!(cleaned.squares[..3], [3; 3]);
        assert!(cleaned.point(4, 9).is_none() && cleaned.point(4, 8).is_some());
        let error = run(&surface, &json!({"min_component_triangles": 73}), &host).unwrap_err();
        assert!(error.message.contains("162 in small pieces"), "{}", error.message);
    }

    #[test]
    fn a_spiral_is_one_piece() {
        let mut surface = sheet();
        surface.squares.fill(0);
        let path =
            [(0, 0), (0, 1), (0, 2), (1, 2), (2, 2), (2, 1), (2, 0), (3, 0), (4, 0), (4, 1), (4, 2), (4, 3), (0, 3)];
        for (row, column) in path {
            surface.squares[row * 11 + column] = Surface::FIRST | Surface::SECOND;
        }
        let cleaned = run(&surface, &json!({"min_component_triangles": 26}), &TestHost::default()).unwrap();
        assert_eq!(cleaned.squares, surface.squares);
    }

    #[test]
    fn a_mask_takes_what_lies_over_no_valid_cell() {
        let grid = rockface_core::artefact::Grid { columns: 20, rows: 20, cell_m: 1.0, left_m: 99.5, top_m: 50.5 };
        let values = (0..400).map(|cell| if cell % 20 < 3 { f32::NAN } else { 1.0 }).collect();
        let mask = Raster::single(grid, Frame::Wall, "mask", "mask", values);
        let host = TestHost::default();
        let inputs = |mask: Raster| [("surface", Artefact::Surface(sheet())), ("mask", Artefact::Raster(mask))];
        run_stage::<CleanMesh>(&host, &json!({}), &inputs(mask.clone())).unwrap();
        // Points of the first three columns lie over no value: three columns of squares go.
        assert_eq!(host.metric("removed_masked"), Some(2.0 * 3.0 * 9.0));
        let world = Raster { frame: Frame::World, ..mask };
        let error = run_stage::<CleanMesh>(&host, &json!({}), &inputs(world)).unwrap_err();
        assert!(error.message.contains("`mask` is in the world frame"), "{}", error.message);
    }

    #[test]
    fn a_mesh_has_ports_of_its_own() {
        let mesh = rockface_core::testing::height_mesh(12, [0.0, 1.0, 0.0, 1.0], |x, _| x);
        let host = TestHost::default();
        let with = json!({"of": "mesh"});
        let made = run_stage::<CleanMesh>(&host, &with, &[("mesh", mesh.clone().into())]).unwrap();
        assert_eq!(Mesh::of(&made.into_inner()["mesh"]), Some(&mesh));
        let ports = CleanMesh::ports(&with).unwrap();
        assert_eq!((ports.inputs[0].name, ports.outputs[0].name), ("mesh", "mesh"));
    }

    #[test]
    fn an_empty_window_is_a_fault_of_the_pipeline() {
        let stage = rockface_core::Row::<CleanMesh>::new();
        let faults = rockface_core::AnyStage::check(&stage, &json!({"window_m": [1, 0, 0, 1]})).unwrap_err();
        assert_eq!(faults[0].path, ["window_m"]);
    }
}
