//! `import-mesh`: reads a triangle mesh of a rock face from a file, repairs what is safe and names the rest.

use nalgebra::Vector3;

use crate::face::file_frame;
use crate::face::file_frame::{FileFrame, Given};
use crate::face::inspection::{Found, Inspection};
use crate::face::repair;
use crate::face::repair::Repaired;
use crate::face::{mesh_file, orient, placing, rounding, stray};
use rockface_core::artefact::{Frame, Kind, Mesh};
use rockface_core::crs::{CrsName, Stated, Tool, settle, wall_without_system};
use rockface_core::format::ply;
use rockface_core::params::{Fault, GeoFileRef, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, params};
use rockface_raster::mesh_check;

/// A mean normal whose cosine with the way out is smaller does not tell inside from outside.
const LEAST_COSINE: f64 = 0.02;

/// Beyond this cosine a mean normal that points down is strange for a face (30 degrees below the horizontal).
const DOWNWARDS: f64 = 0.5;

choice! {
    /// What to repair.
    pub enum Repair {
        /// What changes no surface: merges vertices at exactly one place, drops what covers nothing, turns triangles over.
        Safe = "safe",
        /// Nothing: every vertex and triangle stays as it is.
        Nothing = "none",
    }
}

choice! {
    /// What to do with a mesh that is not an oriented manifold after repair.
    pub enum Defects {
        /// Refuse it.
        Refuse = "refuse",
        /// Keep it as it is, with a warning: enough for survey and rasters, not for removing blocks near the defects.
        Keep = "keep",
        /// Cut the surface open along edges of three or more triangles, with a warning: the sides lie beside each other there and are not joined.
        Repair = "repair",
    }
}

params! {
    /// Parameters of `import-mesh`.
    pub struct ImportMeshParams {
        /// The file; its format is told by its content: PLY, OBJ or STL, text or binary.
        path: GeoFileRef,
        /// The frame of the file's coordinates.
        frame: FileFrame = FileFrame::Automatic,
        /// The coordinate reference system of a file that states none, itself or in a `.prj` beside it: `EPSG:28356`.
        crs: Option<CrsName> = None,
        /// Metres of a unit of the file's coordinates: 0.001 for millimetres. A file that states a coordinate reference system states its unit;
        /// with `crs`, coordinates times `unit_m` plus `offset_m` are metres in that system.
        unit_m: f64 = 1.0; Range::Positive,
        /// Added to every vertex in double precision, metres: brings a file with shifted coordinates back.
        offset_m: [f64; 3] = [0.0; 3],
        /// What to repair.
        repair: Repair = Repair::Safe,
        /// Pieces of fewer triangles are dropped.
        min_piece_triangles: u32 = 1; Range::AtLeast(1.0),
        /// A direction out of the rock in the frame of the file: a mesh that faces the other way is inside out. Not needed
        /// in the wall frame (Z) and for closed meshes.
        outward: Option<[f64; 3]> = None,
        /// What to do with edges of three or more triangles, triangles oriented against each other, and a face inside out.
        defects: Defects = Defects::Refuse,
    }
}

/// Reads a triangle mesh of a rock face and makes safe repairs.
pub struct ImportMesh;

impl Stage for ImportMesh {
    type Params = ImportMeshParams;
    const NAME: &'static str = "import-mesh";
    const VERSION: u32 = 8;
    const PAGE: Page = Page::new(include_str!("import_mesh.md"));
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The mesh, in the frame of the file.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let on_wall = params.crs.as_ref().and_then(|_| wall_without_system(params.frame == FileFrame::Wall));
        let two_units = placing::unit_beside_system(params.unit_m, params.crs.as_ref());
        let mut faults: Vec<Fault> = on_wall.into_iter().chain(two_units).collect();
        if params.outward.is_some_and(|outward| Vector3::from(outward).norm() == 0.0) {
            faults.push(Fault { path: vec!["outward".into()], ..Fault::new("a direction cannot be zero") });
        }
        if params.repair == Repair::Nothing && params.min_piece_triangles > 1 {
            let text = "dropping pieces is a repair, and `repair` is `none`";
            faults.push(Fault { path: vec!["min_piece_triangles".into()], ..Fault::new(text) });
        }
        if params.repair == Repair::Nothing && params.defects == Defects::Repair {
            let text = "`defects: repair` is a repair, and `repair` is `none`";
            faults.push(Fault { path: vec!["defects".into()], ..Fault::new(text) });
        }
        faults
    }

    fn run(params: &Self::Params, _inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let path = &params.path.0;
        let (bytes, system) = context.read_georeferenced(&params.path)?;
        let mut mesh = mesh_file::read(&bytes, &|| context.cancelled())
            .map_err(|e| StageError::new(format!("cannot read `{path}`: {e}")))?;
        if mesh.triangles.is_empty() {
            return Err(StageError::new(format!("`{path}` has {} vertices but no triangles", mesh.vertices.len()))
                .hint("a point cloud is meshed by `import-cloud`"));
        }
        placing::scale(&mut mesh.vertices, params.unit_m);
        rounding::warning(&mesh.vertices).into_iter().for_each(|text| context.warn(text));
        let given = Given {
            path,
            frame: params.frame,
            has_crs: params.crs.is_some(),
            has_prj: system.is_some(),
            unit_m: params.unit_m,
            offset_m: params.offset_m,
        };
        let (wall, warning) = file_frame::wall(ply::stated_frame(&bytes), &given)?;
        warning.into_iter().for_each(|text| context.warn(text));
        mesh.frame = match wall {
            Some(wall) => wall,
            None => framed(&mut mesh, params, system.as_deref(), context)?,
        };
        placing::shift(&mut mesh.vertices, params.offset_m);
        context.check_cancelled()?;
        tidy(&mut mesh, params, context)?;
        Ok(Outputs::of("mesh", mesh))
    }
}

/// The world frame of the mesh, and its vertices in metres.
fn framed(
    mesh: &mut Mesh,
    params: &ImportMeshParams,
    prj: Option<&[u8]>,
    context: &Context,
) -> Result<Frame, StageError> {
    let own = mesh.frame.world_crs().map(Stated::of_crs);
    let stated = [own, prj.map(Stated::of_prj)];
    placing::check_unit(&params.path.0, params.unit_m, &stated)?;
    // Vertices that no triangle uses are no part of the face.
    let corners = mesh.triangles.iter().map(|corners| mesh.vertices[corners[0] as usize]);
    let middle = placing::middle(corners, params.offset_m);
    let settled = settle(&params.path.0, stated, params.crs.as_ref(), (Tool::Other, middle), context)?;
    placing::height_warning(middle.map(|middle| settled.point(middle))).into_iter().for_each(|text| context.warn(text));
    placing::warning(&settled, &mesh.vertices).into_iter().for_each(|text| context.warn(text));
    if !settled.keeps_coordinates() {
        mesh.vertices.iter_mut().for_each(|vertex| *vertex = settled.point(*vertex));
    }
    Ok(settled.frame())
}

/// Repairs, inspects, reports, and refuses what is still wrong.
fn tidy(mesh: &mut Mesh, params: &ImportMeshParams, context: &Context) -> Result<(), StageError> {
    let path = &params.path.0;
    let before = mesh.triangles.len();
    let mut faults = Vec::new();
    let mut repaired = Repaired::default();
    let mut turned = 0;
    if params.repair == Repair::Safe {
        repaired = repair::repair(mesh, params.min_piece_triangles as usize);
        if mesh.triangles.is_empty() {
            let text = format!("none of the {before} triangles of `{path}` is left: {}", describe(&repaired));
            return Err(StageError::new(text).hint("a mesh needs triangles with an area; lower `min_piece_triangles`"));
        }
        let lost = repaired.degenerate_triangles;
        if lost >= 10 && lost > before / 20 {
            context.warn(format!(
                "{lost} of {before} triangles had no area and are dropped: were the coordinates rounded?"
            ));
        }
        if params.defects == Defects::Repair {
            let cut = repair::cut_open(mesh);
            context.metric("cut_edges", cut as f64, "1");
            if cut > 0 {
                context.warn(format!(
                    "cut open along {cut} edges of three or more triangles; no block can be removed across them"
                ));
            }
        }
        match orient::make_coherent(mesh) {
            Ok(count) => turned = count,
            Err(one_sided) => {
                faults.push(format!("a surface with one side only, seen near {}", place(one_sided.place)));
            }
        }
    } else {
        count_in(&mut faults, mesh_check::degenerate_triangles(mesh), "triangles without area");
        count_in(&mut faults, repair::duplicate_triangles(mesh).len(), "repeated triangles");
    }
    let found = Inspection::of(mesh);
    find_in(&mut faults, &found.crowded_edges, "edges of three or more triangles");
    find_in(&mut faults, &found.opposed_edges, "edges whose triangles are oriented against each other");
    turned += face_outward(mesh, params, &found, context, &mut faults);
    report(mesh, (&repaired, turned), &found, context);
    if faults.is_empty() {
        return Ok(());
    }
    let message = format!("`{path}` has {}", faults.join(" and "));
    if params.defects == Defects::Keep {
        context.warn(message);
        return Ok(());
    }
    Err(StageError::new(message).hint(
        "`defects: repair` cuts it open at such edges; or repair it in MeshLab (`Repair Non Manifold Edges`, then `Re-Orient All \
         Faces Coherently`); or keep it as it is with `defects: keep`, which is enough where no blocks are removed",
    ))
}

fn count_in(faults: &mut Vec<String>, count: usize, what: &str) {
    if count > 0 {
        faults.push(format!("{count} {what}"));
    }
}

fn find_in(faults: &mut Vec<String>, found: &Found, what: &str) {
    if let Some(first) = found.place {
        faults.push(format!("{} {what}, the first near {}", found.count, place(first)));
    }
}

fn place([x, y, z]: [f64; 3]) -> String {
    format!("({x}, {y}, {z})")
}

/// Turns what is inside out where that can be told and may be repaired; returns how many triangles were turned.
fn face_outward(
    mesh: &mut Mesh,
    params: &ImportMeshParams,
    found: &Inspection,
    context: &Context,
    faults: &mut Vec<String>,
) -> usize {
    if !faults.is_empty() {
        return 0;
    }
    let wall = (mesh.frame == Frame::Wall).then(Vector3::z);
    let outward = params.outward.map(|outward| Vector3::from(outward).normalize()).or(wall);
    let cosine = found.open_area().and_then(|(area, normal)| outward.map(|outward| normal.dot(&outward) / area));
    if outward.is_none() && found.open_area().is_some_and(|(area, normal)| normal.z < -DOWNWARDS * area) {
        context.warn("on the whole the triangles face downwards: if the mesh is inside out, give `outward`");
    }
    if cosine.is_some_and(|cosine| cosine.abs() < LEAST_COSINE) {
        context
            .warn("the triangles face outward and inward in equal parts: nothing tells whether the mesh is inside out");
    }
    let mut turned = 0;
    let open = (false, cosine.is_some_and(|cosine| cosine <= -LEAST_COSINE), "its triangles face into the rock");
    let negative = found.closed_volume_m3().is_some_and(|volume_m3| volume_m3 < 0.0);
    let closed = (true, negative, "its closed pieces enclose a negative volume");
    for (is_closed, inside_out, why) in [open, closed] {
        if inside_out && params.repair == Repair::Safe {
            orient::turn_over(mesh, is_closed);
            let pieces = found.pieces.iter().filter(|piece| (piece.open_edges == 0) == is_closed);
            turned += pieces.map(|piece| piece.triangles).sum::<usize>();
            context.warn(format!("the mesh was inside out and has been turned: {why}"));
        } else if inside_out {
            faults.push(format!("an outside that is inside: {why} (`repair: safe` turns it)"));
        }
    }
    turned
}

fn describe(repaired: &Repaired) -> String {
    let Repaired {
        merged_vertices,
        degenerate_triangles,
        duplicate_triangles,
        small_piece_triangles,
        unreferenced_vertices,
    } = repaired;
    format!(
        "merged {merged_vertices} vertices with others at the same place, dropped {degenerate_triangles} triangles without \
         area, {duplicate_triangles} repeated ones, {small_piece_triangles} of small pieces and {unreferenced_vertices} \
         vertices without triangle"
    )
}

fn report(mesh: &Mesh, (repaired, turned): (&Repaired, usize), found: &Inspection, context: &Context) {
    let closed = found.pieces.iter().filter(|piece| piece.open_edges == 0).count();
    let counts = [
        ("vertices", mesh.vertices.len()),
        ("triangles", mesh.triangles.len()),
        ("boundary_edges", found.border_edges),
        ("merged_vertices", repaired.merged_vertices),
        ("dropped_degenerate_triangles", repaired.degenerate_triangles),
        ("dropped_duplicate_triangles", repaired.duplicate_triangles),
        ("dropped_small_piece_triangles", repaired.small_piece_triangles),
        ("dropped_unreferenced_vertices", repaired.unreferenced_vertices),
        ("turned_triangles", turned),
        ("duplicate_vertices", mesh_check::duplicate_vertices(mesh)),
        ("non_manifold_edges", found.crowded_edges.count),
        ("inconsistent_edges", found.opposed_edges.count),
        ("non_manifold_vertices", found.pinched_vertices.count),
        ("pieces", found.pieces.len()),
        ("closed_pieces", closed),
        ("holes", found.holes.len()),
    ];
    for (name, count) in counts {
        context.metric(name, count as f64, "1");
    }
    if *repaired != Repaired::default() {
        context.note(describe(repaired));
    }
    if turned > 0 {
        context.note(format!("turned {turned} triangles over"));
    }
    if let Some(far) = stray::stray(mesh) {
        context.warn(format!(
            "{} triangles lie far from all others, the farthest corner at {}, {:.0} m from the middle of the face, of which {:.0} % lie within {:.1} m: \
             they bend the plane that `transform-crs` fits and stretch grids; `min_piece_triangles` drops small pieces, and `plane: robust` of \
             `transform-crs` fits the plane without them",
            far.triangles,
            place(far.place),
            far.distance_m,
            100.0 * far.share,
            far.extent_m
        ));
    }
    warn_of_what_stays(found, context);
}

/// Metres in words, tiny ones with their digits.
fn length(length_m: f64) -> String {
    if length_m < 0.01 { format!("{length_m:.1e} m") } else { format!("{length_m:.3} m") }
}

fn warn_of_what_stays(found: &Inspection, context: &Context) {
    let largest = found.pieces.iter().map(|piece| piece.triangles).max().unwrap_or(0);
    if found.pieces.len() > 1 {
        context.note(format!(
            "{} pieces, the largest of {largest} triangles; `min_piece_triangles` drops small ones",
            found.pieces.len()
        ));
    }
    if let Some(first) = found.pinched_vertices.place {
        context.warn(format!(
            "at {} vertices surfaces meet in a point only, the first at {}: no block can be removed there",
            found.pinched_vertices.count,
            place(first)
        ));
    }
    if let Some(hole) = found.holes.iter().max_by(|a, b| a.length_m.total_cmp(&b.length_m)) {
        context.metric("largest_hole_perimeter", hole.length_m, "m");
        context.warn(format!(
            "{} holes, the largest of {} around, at {}: blocks keep away from them with `mask-safe-zone`",
            found.holes.len(),
            length(hole.length_m),
            place(hole.place)
        ));
    }
}

#[cfg(test)]
mod tests;
