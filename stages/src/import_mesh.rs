//! `import-mesh`: reads a triangle mesh of a rock face from a file and checks it.

use crate::artefact::{CodecError, Frame, Kind, Mesh};
use crate::kernel::{mesh_check, ply};
use crate::params::FileRef;
use crate::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};

choice! {
    /// The frame of the file's coordinates.
    pub enum FileFrame {
        /// The input's coordinate reference system.
        World = "world",
        /// X along the face, Y up the face, Z out of the rock.
        Wall = "wall",
    }
}

choice! {
    /// What to do with a mesh that is not an oriented manifold.
    pub enum Defects {
        /// Refuse it.
        Refuse = "refuse",
        /// Keep it as it is, with a warning: enough for survey and rasters, not for removing blocks near the defects.
        Keep = "keep",
    }
}

params! {
    /// Parameters of `import-mesh`.
    pub struct ImportMeshParams {
        /// The file; its format is told by its content (PLY, ascii or binary).
        path: FileRef,
        /// The frame of the file's coordinates.
        frame: FileFrame = FileFrame::World,
        /// Added to every vertex in double precision, metres: brings a file with shifted coordinates back.
        offset_m: [f64; 3] = [0.0; 3],
        /// What to do with edges of three or more triangles or of triangles oriented against each other.
        defects: Defects = Defects::Refuse,
    }
}

/// The stage.
pub struct ImportMesh;

impl Stage for ImportMesh {
    type Params = ImportMeshParams;
    const NAME: &'static str = "import-mesh";
    const VERSION: u32 = 1;
    const PAGE: Page = Page {
        what: "Reads a triangle mesh of a rock face. Triangles without area and vertices without triangle are dropped; \
               everything dropped is counted in the log, and so are vertices at the same place and boundary edges.",
        method: "PLY 1.0 (Turk 1994), ascii or binary of either byte order, float or double; polygons are cut into fans.",
        frames: "Metres. Coordinates are taken to be in `frame`; single-precision files cannot hold centimetres at UTM \
                 magnitudes, so keep them shifted and give the shift as `offset_m`.",
        fails: "The file is no PLY or is damaged; it has no triangles; an edge belongs to three or more triangles; \
                neighbouring triangles are oriented against each other (repair the mesh in MeshLab, or accept it with \
                `defects: keep`).",
        example: "rockface: 1\nname: import-a-face\nsteps:\n  face: {stage: import-mesh, with: {path: face.ply}}\n",
    };
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The mesh, in the frame of the file.")];

    fn run(params: &Self::Params, _inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let path = &params.path.0;
        let bytes = context.read(&params.path)?;
        let mut mesh = read(&bytes).map_err(|e| StageError::new(format!("cannot read `{path}`: {e}")))?;
        if mesh.triangles.is_empty() {
            return Err(StageError::new(format!("`{path}` has {} vertices but no triangles", mesh.vertices.len()))
                .hint("a point cloud must be meshed first, for example with Delaunay 2.5D in CloudCompare"));
        }
        mesh.frame = match params.frame {
            FileFrame::World => Frame::World,
            FileFrame::Wall => Frame::Wall,
        };
        shift(&mut mesh, params.offset_m);
        check(&mut mesh, params, context)?;
        Ok(Outputs::of("mesh", mesh))
    }
}

fn read(bytes: &[u8]) -> Result<Mesh, CodecError> {
    if bytes.starts_with(b"ply") {
        ply::read_mesh(bytes)
    } else {
        Err(CodecError::new("its content is not PLY, the only format read here; convert it to PLY first"))
    }
}

fn shift(mesh: &mut Mesh, offset_m: [f64; 3]) {
    if offset_m.iter().any(|shift| *shift != 0.0) {
        let moved = |v: &[f64; 3]| [v[0] + offset_m[0], v[1] + offset_m[1], v[2] + offset_m[2]];
        mesh.vertices.iter_mut().for_each(|v| *v = moved(v));
    }
}

fn check(mesh: &mut Mesh, params: &ImportMeshParams, context: &Context) -> Result<(), StageError> {
    let path = &params.path.0;
    let tidied = mesh_check::tidy(mesh);
    if mesh.triangles.is_empty() {
        fail!("none of the {} triangles of `{path}` has an area", tidied.degenerate_triangles);
    }
    let edges = mesh_check::check_edges(mesh);
    if let Some([a, b]) = edges.first_fault {
        let place = mesh.vertices[a as usize];
        let message = format!(
            "`{path}` has {} edges of three or more triangles and {} edges whose triangles are oriented against each \
             other; the first runs between vertices {a} and {b} near ({}, {}, {})",
            edges.non_manifold, edges.inconsistent, place[0], place[1], place[2]
        );
        if params.defects == Defects::Keep {
            context.warn(message);
        } else {
            return Err(StageError::new(message).hint(
            "repair the mesh first: in MeshLab `Repair Non Manifold Edges`, then `Re-Orient All Faces Coherently`; or keep \
             it as it is with `defects: keep`, which is enough where no blocks are removed",
        ));
        }
    }
    report(mesh, tidied, edges, context);
    Ok(())
}

/// Single precision at UTM magnitudes holds half a metre.
fn warn_of_single_precision(mesh: &Mesh, context: &Context) {
    let largest = mesh.vertices.iter().flatten().fold(0.0f64, |largest, x| largest.max(x.abs()));
    let step_m = largest * f64::from(f32::EPSILON);
    let is_single = |x: &f64| f64::from(*x as f32).to_bits() == x.to_bits();
    if step_m > 1e-3 && mesh.vertices.iter().flatten().all(is_single) {
        context.warn(format!(
            "coordinates of {largest:.0} m were written in single precision, which holds only {step_m:.2} m there: export in double \
             precision, or shifted, and add the shift with `offset_m`"
        ));
    }
}

fn report(mesh: &Mesh, tidied: mesh_check::Tidied, edges: mesh_check::EdgeReport, context: &Context) {
    let duplicates = mesh_check::duplicate_vertices(mesh);
    warn_of_single_precision(mesh, context);
    let counts = [
        ("vertices", mesh.vertices.len()),
        ("triangles", mesh.triangles.len()),
        ("boundary_edges", edges.boundary),
        ("dropped_degenerate_triangles", tidied.degenerate_triangles),
        ("dropped_unreferenced_vertices", tidied.unreferenced_vertices),
        ("duplicate_vertices", duplicates),
    ];
    for (name, count) in counts {
        context.metric(name, count as f64, "1");
    }
    if tidied != mesh_check::Tidied::default() {
        context.note(format!(
            "dropped {} triangles without area and {} vertices without triangle",
            tidied.degenerate_triangles, tidied.unreferenced_vertices
        ));
    }
    if duplicates > 0 {
        context.warn(format!("{duplicates} vertices lie exactly on an earlier one: the mesh may be torn there"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Artefact;
    use crate::testing::TestHost;

    fn run(bytes: &[u8], offset_m: [f64; 3], defects: Defects) -> (Result<Mesh, StageError>, TestHost) {
        let host = TestHost::default().with("face.ply", &[("face.ply", bytes)]);
        let params = ImportMeshParams { path: FileRef("face.ply".into()), frame: FileFrame::World, offset_m, defects };
        let outputs = ImportMesh::run(&params, &Inputs::default(), &Context::new(&host));
        let mesh = outputs.map(|outputs| match outputs.into_inner().remove("mesh") {
            Some(Artefact::Mesh(mesh)) => mesh,
            other => panic!("no mesh but {other:?}"),
        });
        (mesh, host)
    }

    fn square(triangles: &[[u32; 3]]) -> Vec<u8> {
        let vertices = vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0], [7.0, 7.0, 7.0]];
        let colours = Vec::new();
        ply::write_mesh(&Mesh { frame: Frame::Wall, vertices, triangles: triangles.to_vec(), colours })
    }

    #[test]
    #[allow(clippy::float_cmp)] // to the bit
    fn a_mesh_is_tidied_shifted_and_counted() {
        let (mesh, host) = run(&square(&[[0, 1, 2], [0, 2, 3], [1, 1, 2]]), [451_000.125, 0.0, 0.0], Defects::Refuse);
        let mesh = mesh.unwrap();
        assert_eq!((mesh.frame, mesh.vertices.len(), mesh.triangles.len()), (Frame::World, 4, 2));
        assert_eq!(mesh.vertices[1], [451_001.125, 0.0, 0.0]);
        assert_eq!(host.metric("dropped_degenerate_triangles"), Some(1.0));
        assert_eq!(host.metric("dropped_unreferenced_vertices"), Some(1.0));
        assert_eq!(host.metric("boundary_edges"), Some(4.0));
    }

    #[test]
    fn what_cannot_be_repaired_safely_is_refused() {
        let refused = |bytes: Vec<u8>| run(&bytes, [0.0; 3], Defects::Refuse).0.unwrap_err();
        assert!(refused(square(&[[0, 1, 2], [0, 3, 2]])).message.contains("1 edges whose triangles are oriented"));
        assert!(refused(square(&[[0, 1, 2], [0, 2, 3], [2, 0, 4]])).message.contains("1 edges of three or more"));
        assert!(refused(square(&[])).hint.unwrap().contains("meshed first"));
        assert!(refused(b"v 1 2 3\n".to_vec()).message.contains("not PLY"));
    }

    #[test]
    fn real_faces_of_other_programs_are_read() {
        let shared = std::path::Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/data"));
        let Ok(folder) = std::fs::read_dir(shared.join("faces")) else {
            println!("skipped: the folder of real faces is absent");
            return;
        };
        let mut paths: Vec<_> = folder.filter_map(|entry| entry.ok().map(|e| e.path())).collect();
        paths.retain(|path| path.extension().is_some_and(|e| e == "ply"));
        paths.push(shared.join("outcrop-survey/face.ply"));
        paths.sort();
        let mut refused = Vec::new();
        for path in paths {
            let bytes = std::fs::read(&path).unwrap();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if run(&bytes, [0.0; 3], Defects::Refuse).0.is_err() {
                refused.push(name.clone());
            }
            let (mesh, host) = run(&bytes, [0.0; 3], Defects::Keep);
            assert!(mesh.unwrap().triangles.len() > 1000, "{name}");
            assert_eq!(host.warnings().join("\n").contains("three or more"), refused.contains(&name), "{name}");
        }
        // The two whole scenes have two edges of three triangles each.
        assert_eq!(refused, ["cliff_trier_post.ply", "cliff_trier_pre.ply"]);
    }
}
