//! `import-cloud`: reads a point cloud of a rock face and meshes it over its best-fit plane.

use nalgebra::Vector3;

use crate::face::cloud;
use crate::face::cloud::Cloud;
use crate::face::file_frame;
use crate::face::file_frame::{FileFrame, Given};
use crate::face::sheet;
use crate::face::sheet::{Made, Rules, SheetPlane};
use crate::face::{placing, point_classes, rounding};
use rockface_core::artefact::{Frame, Kind};
use rockface_core::crs::{CrsName, Stated, Tool, settle, wall_without_system};
use rockface_core::format::ply;
use rockface_core::params::{Fault, GeoFileRef, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::plane_fit;
use rockface_raster::plane_fit::Plane;

/// A normal whose cosine with a direction is smaller does not tell on which side the rock is (6 degrees).
const LEAST_COSINE: f64 = 0.1;
/// Normals of the points, of which less than this share points out of the plane on the whole, do not tell it either.
const LEAST_NORMAL_SHARE: f64 = 0.3;
/// Faces within this cosine of the vertical may well overhang (30 degrees).
const STEEP: f64 = 0.5;

params! {
    /// Parameters of `import-cloud`.
    pub struct ImportCloudParams {
        /// The file; its format is told by its content: LAS, LAZ, PLY, or columns of numbers (XYZ, TXT, CSV, PTS).
        path: GeoFileRef,
        /// The frame of the file's coordinates.
        frame: FileFrame = FileFrame::Automatic,
        /// The coordinate reference system of a file that states none, itself or in a `.prj` beside it: `EPSG:28356`.
        crs: Option<CrsName> = None,
        /// Metres of a unit of the file's coordinates: 0.001 for millimetres. A file that states a coordinate reference system states its unit;
        /// with `crs`, coordinates times `unit_m` plus `offset_m` are metres in that system.
        unit_m: f64 = 1.0; Range::Positive,
        /// Added to every point in double precision, metres: brings a file with shifted coordinates back.
        offset_m: [f64; 3] = [0.0; 3],
        /// Names of the columns of a text file, such as `[x, y, z, intensity, red, green, blue]`, which hold instead of those in
        /// its header; left out, those of the header, or x, y and z come first.
        columns: Option<Vec<String>> = None,
        /// Classes of points to keep, by their ASPRS numbers: `[2]` for ground alone. LAS and LAZ files only; left out or `[]`, all but noise (7 and 18).
        classes: Option<Vec<u32>> = None,
        /// A direction out of the rock in the frame of the file; left out, Z in the wall frame, and in the world where the normals of the points show,
        /// or else up.
        outward: Option<[f64; 3]> = None,
        /// Thins to one point of the file a cell of this side in the plane, metres; left out, every point is used.
        cell_m: Option<f64> = None; Range::Positive,
        /// Triangles with a longer edge in the plane are dropped, metres; left out, `max_edge_medians` decides.
        max_edge_m: Option<f64> = None; Range::Positive,
        /// Triangles with an edge in the plane longer than so many median edges are dropped.
        max_edge_medians: f64 = 6.0; Range::AtLeast(1.0),
        /// Pieces of fewer triangles are dropped.
        min_piece_triangles: u32 = 100; Range::AtLeast(1.0),
    }
}

/// Reads a point cloud of a rock face and makes a 2.5D mesh of it.
pub struct ImportCloud;

impl Stage for ImportCloud {
    type Params = ImportCloudParams;
    const NAME: &'static str = "import-cloud";
    const VERSION: u32 = 9;
    const PAGE: Page = Page::new(include_str!("import_cloud.md"));
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The mesh, in the frame of the file.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let zero = params.outward.is_some_and(|outward| Vector3::from(outward).norm() == 0.0);
        let fault = || Fault { path: vec!["outward".into()], ..Fault::new("a direction cannot be zero") };
        let on_wall = params.crs.as_ref().and_then(|_| wall_without_system(params.frame == FileFrame::Wall));
        let two_units = placing::unit_beside_system(params.unit_m, params.crs.as_ref());
        let classes = point_classes::fault(params.classes.as_deref()).map(|text| Fault::new(text).below("classes"));
        zero.then(fault).into_iter().chain(on_wall).chain(two_units).chain(classes).collect()
    }

    fn run(params: &Self::Params, _inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let path = &params.path.0;
        let (bytes, system) = context.read_georeferenced(&params.path)?;
        let own_frame = ply::stated_frame(&bytes);
        let tool = if bytes.starts_with(b"LASF") { Tool::Pdal } else { Tool::Other };
        let listed = listed_classes(params);
        let wanted = |class: u8| point_classes::is_kept(listed, class);
        let cloud = cloud::read_classes(bytes, params.columns.as_deref(), &wanted, &|| context.cancelled());
        let mut cloud = cloud.map_err(|e| StageError::new(format!("cannot read `{path}`: {e}")))?;
        check_classes(&cloud, params, context)?;
        if cloud.points.len() < 3 {
            fail!("`{path}` has {} points, a mesh needs at least three", cloud.points.len());
        }
        if u32::try_from(cloud.points.len()).is_err() {
            fail!("`{path}` has {} points, more than a mesh can number; thin it first", cloud.points.len());
        }
        for warning in &cloud.warnings {
            context.warn(format!("`{path}`: {warning}"));
        }
        placing::scale(&mut cloud.points, params.unit_m);
        rounding::warning(&cloud.points).into_iter().for_each(|text| context.warn(text));
        let given = Given {
            path,
            frame: params.frame,
            has_crs: params.crs.is_some(),
            has_prj: system.is_some(),
            unit_m: params.unit_m,
            offset_m: params.offset_m,
        };
        let (wall, warning) = file_frame::wall(own_frame, &given)?;
        warning.into_iter().for_each(|text| context.warn(text));
        let frame = match wall {
            Some(wall) => wall,
            None => framed(&mut cloud, params, (tool, system.as_deref()), context)?,
        };
        placing::shift(&mut cloud.points, params.offset_m);
        context.check_cancelled()?;
        let plane = plane_fit::fit_points_robust(&cloud.points)
            .ok_or_else(|| StageError::new(format!("the points of `{path}` do not span a plane")))?;
        let sheet =
            SheetPlane { origin: plane.centroid, axes: axes(outward(params, &cloud, (&plane, frame), context)?) };
        let rules = Rules {
            cell_m: params.cell_m,
            max_edge_m: params.max_edge_m,
            max_edge_medians: params.max_edge_medians,
            min_piece_triangles: params.min_piece_triangles as usize,
        };
        let meshed = sheet::mesh(&cloud, &sheet, &rules, frame);
        let (mesh, made) = meshed.map_err(|e| {
            StageError::new(format!("`{path}` cannot be meshed: {e}"))
                .hint("look at `max_edge_m`, `max_edge_medians`, `cell_m` and `min_piece_triangles`")
        })?;
        report(&cloud, (mesh.vertices.len(), mesh.triangles.len()), &plane, &made, context);
        Ok(Outputs::of("mesh", mesh))
    }
}

/// The classes to keep; `None` for all but noise.
fn listed_classes(params: &ImportCloudParams) -> Option<&[u32]> {
    params.classes.as_deref().filter(|listed| !listed.is_empty())
}

/// Says which points were left out for what the file marks them as.
///
/// # Errors
/// Classes are listed and the file has none, or no point is of them.
fn check_classes(cloud: &Cloud, params: &ImportCloudParams, context: &Context) -> Result<(), StageError> {
    let (path, listed) = (&params.path.0, listed_classes(params));
    if listed.is_some() && cloud.classes.is_empty() {
        fail!(
            "`classes` chooses points of LAS and LAZ files, and `{path}` is of another format, without classes; leave it out"
        );
    }
    let left_out = point_classes::left_out(&cloud.classes, listed);
    context.metric("dropped_withheld_points", cloud.withheld as f64, "1");
    context.metric("dropped_class_points", left_out as f64, "1");
    if cloud.withheld > 0 {
        context.note(format!("{} points are flagged as withheld and left out", cloud.withheld));
    }
    let described = point_classes::described(&cloud.classes, listed);
    if cloud.points.is_empty() && left_out > 0 {
        let text = format!("no point of `{path}` is of a class that is kept: {}", described.unwrap_or_default());
        return Err(StageError::new(text).hint("list the classes to keep, such as `classes: [1, 2]`"));
    }
    described.into_iter().for_each(|text| context.note(text));
    point_classes::vegetation(&cloud.classes, listed).into_iter().for_each(|text| context.warn(text));
    Ok(())
}

/// The world frame of the cloud, and its points in metres.
fn framed(
    cloud: &mut Cloud,
    params: &ImportCloudParams,
    (tool, prj): (Tool, Option<&[u8]>),
    context: &Context,
) -> Result<Frame, StageError> {
    let stated = [cloud.stated.take(), prj.map(Stated::of_prj)];
    placing::check_unit(&params.path.0, params.unit_m, &stated)?;
    let middle = placing::middle(cloud.points.iter().copied(), params.offset_m);
    let settled = settle(&params.path.0, stated, params.crs.as_ref(), (tool, middle), context)?;
    placing::height_warning(middle.map(|middle| settled.point(middle))).into_iter().for_each(|text| context.warn(text));
    placing::warning(&settled, &cloud.points).into_iter().for_each(|text| context.warn(text));
    if !settled.keeps_coordinates() {
        cloud.points.iter_mut().for_each(|point| *point = settled.point(*point));
    }
    Ok(settled.frame())
}

/// The plane's normal, pointing out of the rock as `outward` does, or the normals of the points, or Z.
fn outward(
    params: &ImportCloudParams,
    cloud: &Cloud,
    (plane, frame): (&Plane, Frame),
    context: &Context,
) -> Result<Vector3<f64>, StageError> {
    let in_world = frame == Frame::World;
    let normals = Vector3::from(cloud.normals) / cloud.points.len() as f64;
    let by_normals = || {
        let agree = in_world && plane.normal.dot(&normals).abs() >= LEAST_NORMAL_SHARE;
        agree.then_some(("the normals of the points", normals, LEAST_NORMAL_SHARE))
    };
    let given = params.outward.map(|outward| ("`outward`", Vector3::from(outward).normalize(), LEAST_COSINE));
    let known = given.or_else(by_normals);
    let (teller, direction, least) = known.unwrap_or(("Z", Vector3::z(), LEAST_COSINE));
    let cosine = plane.normal.dot(&direction);
    if cosine.abs() < least {
        let [x, y, z] = plane.normal.into();
        let message = format!(
            "{teller} lies within 6 degrees of the best-fit plane (normal {x:.3}, {y:.3}, {z:.3}) and does not tell on which side the \
             rock is"
        );
        return Err(StageError::new(message)
            .hint("give `outward`, a direction from the rock towards the viewer, such as the normal or its opposite"));
    }
    let outward = plane.normal * cosine.signum();
    if in_world {
        context.note(format!("out of the rock by {teller}: the face {}", plane_fit::attitude(&outward)));
    }
    if in_world && known.is_none() && outward.z < STEEP {
        let [x, y, z] = (-outward).into();
        context.warn(format!(
            "nothing in the file tells on which side of this steep face the rock is; it is taken that the face does not overhang ({}): \
             if it does, give `outward: [{x:.3}, {y:.3}, {z:.3}]`",
            plane_fit::attitude(&outward)
        ));
    }
    Ok(outward)
}

/// Right-handed axes with the normal last; any two directions in the plane will do.
fn axes(normal: Vector3<f64>) -> nalgebra::Matrix3<f64> {
    let least = normal.iamin();
    let mut across = Vector3::zeros();
    across[least] = 1.0;
    let x = (across - normal * normal[least]).normalize();
    nalgebra::Matrix3::from_rows(&[x.transpose(), normal.cross(&x).transpose(), normal.transpose()])
}

fn report(cloud: &Cloud, (vertices, triangles): (usize, usize), plane: &Plane, made: &Made, context: &Context) {
    let counts = [
        ("points", cloud.points.len()),
        ("vertices", vertices),
        ("triangles", triangles),
        ("thinned_points", made.thinned_points),
        ("covered_points", made.covered_points),
        ("unused_points", made.unused_points),
        ("dropped_long_triangles", made.long_triangles),
        ("dropped_flat_triangles", made.flat_triangles),
        ("dropped_loose_triangles", made.loose_triangles),
    ];
    for (name, count) in counts {
        context.metric(name, count as f64, "1");
    }
    context.metric("plane_rms", plane.rms_m, "m");
    context.metric("plane_share", plane.fitted, "1");
    context.metric("median_edge", made.median_edge_m, "m");
    context.metric("max_edge", made.max_edge_m, "m");
    context.headline(format!(
        "{} points, {vertices} vertices, {triangles} triangles, median edge {:.3} m, edges over {:.3} m left out",
        cloud.points.len(),
        made.median_edge_m,
        made.max_edge_m
    ));
}

#[cfg(test)]
mod tests;
