//! Files of other programs, read as the importers read them.

use rockface_core::artefact::{Artefact, CodecError, Frame, Mesh, Raster};
use rockface_core::crs::{Kind, Stated};
use rockface_core::format::geotiff;
use rockface_rock::face::cloud::{self, Cloud};
use rockface_rock::face::mesh_file;
use serde_json::Value;

use super::facts::{of_artefact, range};
use super::{Facts, Found};

/// What a mesh or a cloud holds that an importer reads, and which one; why it cannot be read; `None` for files of another sort.
pub fn of(bytes: &[u8], extension: &str) -> Option<Result<Found, CodecError>> {
    match extension {
        _ if bytes.starts_with(b"LASF") => Some(cloud::read(bytes.to_vec(), None, &|| false).map(of_cloud)),
        "ply" | "obj" | "stl" => Some(mesh_file::read(bytes, &|| false).map(of_mesh)),
        _ => None,
    }
}

fn of_cloud(cloud: Cloud) -> Found {
    let mut facts: Facts = vec![
        ("kind".into(), "point cloud of another program: `stage: import-cloud` reads it".into()),
        ("points".into(), cloud.points.len().into()),
        ("normals".into(), cloud.normals.iter().any(|sum| sum.abs() > 0.0).into()),
        ("coloured".into(), (!cloud.colours.is_empty()).into()),
    ];
    let axes = ["x", "y", "z"].into_iter().enumerate();
    facts.extend(axes.map(|(axis, name)| (name.to_owned(), range(cloud.points.iter().map(|point| point[axis])))));
    if cloud.withheld > 0 {
        facts.push(("withheld".into(), cloud.withheld.into()));
    }
    let classes: Vec<String> = cloud.classes.iter().map(|(class, count)| format!("{class}: {count}")).collect();
    if !classes.is_empty() {
        facts.push(("points by class".into(), classes.join(", ").into()));
    }
    facts.extend(cloud.stated.iter().map(|stated| ("system".to_owned(), stated.name.clone().into())));
    facts.extend(cloud.warnings.into_iter().map(|text| ("warning".to_owned(), text.into())));
    facts.into()
}

fn of_mesh(mesh: Mesh) -> Found {
    let artefact = Artefact::Mesh(mesh);
    let mut facts: Facts = vec![("read by".into(), "`stage: import-mesh`".into())];
    facts.extend(of_artefact(&artefact));
    Found { facts, artefact: Some(artefact) }
}

/// The system that a raster of another program states, and the frame that `import-rasters` takes it to be in.
pub fn of_system(raster: &Raster, bytes: &[u8], facts: &mut Facts) {
    let Ok(system) = geotiff::read_system(bytes) else { return };
    let (None, Some(stated)) = (system.frame, system.stated) else { return };
    if is_on_a_map(&stated) && raster.frame == Frame::Wall {
        facts.iter_mut().filter(|(name, _)| name == "frame").for_each(|(_, value)| *value = Value::from("world"));
    }
    facts.push(("system".into(), stated.name.into()));
}

fn is_on_a_map(stated: &Stated) -> bool {
    stated.kind != Kind::Local
}
