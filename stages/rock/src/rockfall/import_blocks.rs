//! `import-blocks`: reads blocks of rock from mesh files, each at its own position, and makes sure that they are solids.

use std::io::Read;

use crate::face::half_edges::HalfEdges;
use crate::face::{mesh_file, orient, repair};
use crate::rockfall::block;
use crate::rockfall::block::{Flaw, Solid, smoothing};
use rockface_core::artefact::candidates::Modifier;
use rockface_core::artefact::{Frame, Georeference, Kind, Mesh, Meshes, Part, Transform};
use rockface_core::crs::{CrsName, Stated, Tool, settle, wall_without_system};
use rockface_core::format::distribution_file;
use rockface_core::names::twice;
use rockface_core::numerics::random::Key;
use rockface_core::params::{Fault, FileRef, FilesRef, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, SourceFile, Stage, StageError, choice, fail, params};
use rockface_raster::shape::Moved;

choice! {
    /// The frame of the files' coordinates.
    pub enum BlockFrame {
        /// The input's coordinate reference system.
        World = "world",
        /// X along the face, Y up the face, Z out of the rock.
        Wall = "wall",
    }
}

choice! {
    /// What to do where the surface of a block passes through itself.
    pub enum SelfIntersections {
        /// Refuse the block.
        Refuse = "refuse",
        /// Draw the vertices there towards their neighbours until it does not, and tell how far.
        Smooth = "smooth",
    }
}

params! {
    /// Parameters of `import-blocks`.
    pub struct ImportBlocksParams {
        /// A file, a folder or a pattern such as `blocks/*.ply`: PLY, OBJ or STL, told by their content.
        path: FilesRef,
        /// The frame of the files' coordinates.
        frame: BlockFrame = BlockFrame::Wall,
        /// The coordinate reference system of files in the world frame that state none: `EPSG:28356`.
        crs: Option<CrsName> = None,
        /// Added to every vertex in double precision, metres, before anything else.
        offset_m: [f64; 3] = [0.0; 3],
        /// The class of all blocks; null: each is of the class called like its file.
        class: Option<String> = None,
        /// Each connected piece of a file is a block of its own.
        split: bool = false,
        /// Pieces of fewer triangles are dropped.
        min_piece_triangles: u32 = 1; Range::AtLeast(1.0),
        /// What to do where the surface of a finished block passes through itself, as scans of boulders often do.
        self_intersections: SelfIntersections = SelfIntersections::Refuse,
        /// Moves each block to the origin by its volume centroid: for a library of scanned blocks, whose places mean nothing.
        recentre: bool = false,
        /// Applied to each block about the centre of its box, in this order: a list that ends with `convex_hull` enforces convexity.
        modifiers: Vec<Modifier> = Vec::new(),
    }
}

/// Reads blocks from mesh files, such as those of a kinematic analysis, a removed volume or a scanned boulder.
pub struct ImportBlocks;

impl Stage for ImportBlocks {
    type Params = ImportBlocksParams;
    const NAME: &'static str = "import-blocks";
    const VERSION: u32 = 4;
    const PAGE: Page = Page::new(include_str!("import_blocks.md"));
    const INPUTS: &'static [Port] =
        &[Port::optional("transform", &[Kind::Transform], "wall_from_world, for blocks in the world frame.")];
    const OUTPUTS: &'static [Port] =
        &[Port::one("blocks", &[Kind::Meshes], "The blocks, in the order of their files.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let is_wall = params.frame == BlockFrame::Wall;
        params.crs.as_ref().and_then(|_| wall_without_system(is_wall)).into_iter().collect()
    }

    fn draws(params: &Self::Params) -> bool {
        params.modifiers.iter().any(Modifier::draws)
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let transform = inputs.optional::<Transform>("transform")?;
        let mut frame = frame(params.frame, transform)?;
        let moved = transform.and_then(Moved::by);
        let read = |path: &str| context.read(&FileRef(path.to_owned()));
        let modifiers =
            distribution_file::with_files_read(&params.modifiers, &read).map_err(|e| e.within("`modifiers`"))?;
        let mut parts = Vec::new();
        for mut file in context.files(&params.path)? {
            context.check_cancelled()?;
            let stem = file.name.rsplit_once('.').map_or(file.name.as_str(), |(stem, _)| stem).to_owned();
            let mut mesh = read_mesh(&mut file, context)?;
            if params.frame == BlockFrame::World {
                frame = to_metres(&mut mesh, &file.name, params, transform, context)?.unwrap_or(frame);
            }
            let mesh = tidied(mesh, &file.name, params, moved.as_ref(), context)?;
            let pieces = if params.split { split(&mesh) } else { vec![mesh] };
            let several = pieces.len() > 1;
            for (number, piece) in pieces.into_iter().enumerate() {
                context.check_cancelled()?;
                let name = if several { format!("{stem}-{}", number + 1) } else { stem.clone() };
                let class = params.class.clone().unwrap_or_else(|| stem.clone());
                let solid = finished(piece, &name, params, &modifiers, context)?;
                parts.push(Part { name, class, vertices: solid.vertices, triangles: solid.triangles });
            }
        }
        refuse_twins(&parts)?;
        report(&parts, &params.path.0, context)?;
        Ok(Outputs::of("blocks", Meshes { frame, parts }))
    }
}

/// The frame of what comes out.
fn frame(of_files: BlockFrame, transform: Option<&Transform>) -> Result<Frame, StageError> {
    match (of_files, transform) {
        (BlockFrame::Wall, None) => Ok(Frame::Wall),
        (BlockFrame::World, None) => Ok(Frame::World),
        (BlockFrame::World, Some(by)) if by.from == Frame::World.to_string() && by.to == Frame::Wall.to_string() => {
            Ok(Frame::Wall)
        }
        (BlockFrame::World, Some(by)) => {
            fail!("the transform takes {} to {}, but blocks go from world to wall", by.from, by.to)
        }
        (BlockFrame::Wall, Some(_)) => {
            Err(StageError::new("a `transform` is connected, but the blocks are said to be in the wall frame")
                .hint("say `frame: world` if the files are in world coordinates, or disconnect the transform"))
        }
    }
}

/// Brings a file in the world frame to metres; returns the frame of the blocks where the system is stated.
fn to_metres(
    mesh: &mut Mesh,
    file: &str,
    params: &ImportBlocksParams,
    transform: Option<&Transform>,
    context: &Context,
) -> Result<Option<Frame>, StageError> {
    let own = mesh.frame.world_crs().map(Stated::of_crs);
    if own.is_none() && params.crs.is_none() {
        return Ok(None);
    }
    let about = (Tool::Other, mesh.vertices.first().copied());
    let settled = settle(file, [own, None], params.crs.as_ref(), about, context)?;
    mesh.vertices.iter_mut().for_each(|vertex| *vertex = settled.point(*vertex));
    if let (Some(crs), Some(of_transform)) = (&settled.crs, transform.and_then(|by| by.crs.as_ref()))
        && !crs.agrees_with(of_transform)
    {
        fail!("`{file}` is in {crs}, but `transform` in {of_transform}: two coordinate reference systems in one step");
    }
    let georeference = settled.crs.map(|crs| Georeference { crs: Some(crs), wall_from_world: transform.cloned() });
    let axes = if transform.is_some() { Frame::Wall } else { Frame::World };
    Ok(georeference.map(|georeference| axes.at(Some(georeference))))
}

fn read_mesh(file: &mut SourceFile, context: &Context) -> Result<Mesh, StageError> {
    let name = file.name.clone();
    let mut bytes = Vec::new();
    file.reader.read_to_end(&mut bytes).map_err(|e| StageError::new(format!("cannot read `{name}`: {e}")))?;
    mesh_file::read(&bytes, &|| context.cancelled()).map_err(|e| StageError::new(format!("cannot read `{name}`: {e}")))
}

/// A file's mesh, repaired where that moves nothing, facing outwards, in the frame that is asked for.
fn tidied(
    mut mesh: Mesh,
    file: &str,
    params: &ImportBlocksParams,
    moved: Option<&Moved>,
    context: &Context,
) -> Result<Mesh, StageError> {
    let repaired = repair::repair(&mut mesh, params.min_piece_triangles as usize);
    if mesh.triangles.is_empty() {
        fail!("`{file}` has no triangle that covers anything");
    }
    if repaired != repair::Repaired::default() {
        context.note(format!(
            "`{file}`: merged {} vertices; dropped {} triangles without area, {} repeated ones, {} in small pieces",
            repaired.merged_vertices,
            repaired.degenerate_triangles,
            repaired.duplicate_triangles,
            repaired.small_piece_triangles
        ));
    }
    let turned = orient::make_coherent(&mut mesh)
        .map_err(|fault| StageError::new(format!("`{file}` has only one side, near {:?}", fault.place)))?;
    if turned > 0 {
        context.note(format!("`{file}`: turned {turned} triangles to agree with their neighbours"));
    }
    let by = params.offset_m;
    if by.iter().any(|shift| *shift != 0.0) {
        mesh.vertices.iter_mut().for_each(|v| *v = [v[0] + by[0], v[1] + by[1], v[2] + by[2]]);
    }
    if let Some(moved) = moved {
        mesh.vertices.iter_mut().for_each(|vertex| *vertex = moved.apply(*vertex));
    }
    Ok(mesh)
}

/// The connected pieces of a mesh, each with its own vertices.
fn split(mesh: &Mesh) -> Vec<Mesh> {
    let (piece_of, count) = HalfEdges::new(mesh).pieces();
    let mut pieces: Vec<Vec<[u32; 3]>> = vec![Vec::new(); count];
    for (triangle, piece) in mesh.triangles.iter().zip(&piece_of) {
        pieces[*piece as usize].push(*triangle);
    }
    pieces.into_iter().map(|triangles| part(mesh, triangles)).collect()
}

/// Some triangles of a mesh with their vertices in the order of the mesh.
fn part(mesh: &Mesh, mut triangles: Vec<[u32; 3]>) -> Mesh {
    let mut used = triangles.as_flattened().to_vec();
    used.sort_unstable();
    used.dedup();
    let number = |vertex: u32| used.binary_search(&vertex).unwrap_or_default() as u32;
    triangles.iter_mut().for_each(|triangle| *triangle = triangle.map(number));
    let vertices = used.iter().map(|vertex| mesh.vertices[*vertex as usize]).collect();
    let colours = used.iter().filter_map(|vertex| mesh.colours.get(*vertex as usize).copied()).collect();
    Mesh { frame: mesh.frame, vertices, triangles, colours }
}

/// One block: outward, modified, and a solid, or the reason why not.
fn finished(
    mesh: Mesh,
    name: &str,
    params: &ImportBlocksParams,
    modifiers: &[Modifier],
    context: &Context,
) -> Result<Solid, StageError> {
    let mut solid = Solid { vertices: mesh.vertices, triangles: mesh.triangles };
    if solid.volume() < 0.0 {
        solid.flip();
        context.note(format!("block `{name}` was inside out: every triangle is turned"));
    }
    if !modifiers.is_empty() {
        solid = modified(solid, name, modifiers, context)?;
    }
    if params.self_intersections == SelfIntersections::Smooth {
        untangle(&mut solid, name, context)?;
    }
    solid.check().map_err(|flaw| refusal(name, &flaw))?;
    if params.recentre {
        let (_, at) = solid.volume_and_centroid();
        solid.map(|v| [v[0] - at[0], v[1] - at[1], v[2] - at[2]]);
    }
    Ok(solid)
}

fn refusal(name: &str, flaw: &Flaw) -> StageError {
    let way_out = match flaw {
        Flaw::Crossing(..) => "take `self_intersections: smooth`",
        Flaw::Pieces(_) => "take its pieces apart with `split: true`, drop crumbs with `min_piece_triangles`",
        _ => "close it in MeshLab (Filters > Remeshing > Close Holes)",
    };
    let hint = format!("{way_out}, or end `modifiers` with `convex_hull` if a convex block will do");
    StageError::new(format!("block `{name}`: {flaw}")).hint(hint)
}

fn untangle(solid: &mut Solid, name: &str, context: &Context) -> Result<(), StageError> {
    solid.check_closed().map_err(|flaw| refusal(name, &flaw))?;
    let done = smoothing::untangle(solid);
    if done.left > 0 {
        fail!("block `{name}`: {} pairs of triangles pass through each other even after smoothing", done.left);
    }
    if done.vertices > 0 {
        let (count, farthest_m) = (done.vertices, done.farthest_m);
        context.warn(format!(
            "block `{name}`: {count} vertices moved by up to {farthest_m:.2e} m where it passed through itself"
        ));
    }
    Ok(())
}

fn modified(mut solid: Solid, name: &str, modifiers: &[Modifier], context: &Context) -> Result<Solid, StageError> {
    let [low, high] = solid.bounds();
    let centre: [f64; 3] = std::array::from_fn(|i| 0.5 * (low[i] + high[i]));
    solid.map(|v| std::array::from_fn(|i| v[i] - centre[i]));
    let draws = modifiers.iter().any(Modifier::draws);
    let key = if draws { context.stream("modifiers", name) } else { Key([0; 32]) };
    let (mut solid, drawn) =
        block::modified(solid, modifiers, key).map_err(|e| StageError::new(format!("block `{name}`: {e}")))?;
    solid.map(|v| std::array::from_fn(|i| v[i] + centre[i]));
    if draws {
        let listed: Vec<String> = drawn.iter().map(|(name, value)| format!("{name} = {value:.6}")).collect();
        context.note(format!("block `{name}`: {}", listed.join(", ")));
    }
    Ok(solid)
}

/// Truth names blocks by their names, so each needs its own.
fn refuse_twins(parts: &[Part]) -> Result<(), StageError> {
    match twice(parts.iter().map(|part| part.name.as_str()).collect()) {
        Some(name) => Err(StageError::new(format!("two blocks would be called `{name}`"))
            .hint("files must differ in more than their extension; rename one")),
        None => Ok(()),
    }
}

fn report(parts: &[Part], path: &str, context: &Context) -> Result<(), StageError> {
    if parts.is_empty() {
        return Err(StageError::new(format!("`{path}` names no file"))
            .hint("give a file, a folder that holds meshes, or a pattern such as `blocks/*.ply`"));
    }
    let volume = |part: &Part| Solid { vertices: part.vertices.clone(), triangles: part.triangles.clone() }.volume();
    let total: f64 = parts.iter().map(volume).sum();
    context.metric("blocks", parts.len() as f64, "1");
    context.metric("volume", total, "m3");
    context.headline(format!("{} blocks, {total:.4} m3 together", parts.len()));
    Ok(())
}

#[cfg(test)]
mod tests;
