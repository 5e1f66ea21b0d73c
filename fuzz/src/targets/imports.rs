//! Files of other programs, through the stages that read them.

use rockface_core::artefact::Frame;
use rockface_imaging::fusion::colmap_workspace::{self, Bounds};
use serde_json::{Value, json};

use super::Verdict;
use super::host::{Files, run};
use crate::parts::cut;

/// Runs a stage on one file.
fn of_one(stage: &str, with: &Value, name: &str, bytes: &[u8]) -> Verdict {
    run(stage, with, &Files(&[("file", vec![(name, bytes)])]), &[])
}

/// Meshes, both as they are by default and kept with all their defects.
pub fn mesh(bytes: &[u8]) -> Verdict {
    let all = json!({"path": "file", "frame": "wall", "repair": "none", "defects": "keep", "outward": [0, 0, 1]});
    let strict = of_one("import-mesh", &json!({"path": "file"}), "face.ply", bytes);
    let lenient = of_one("import-mesh", &all, "face.ply", bytes);
    if strict == Verdict::Accepted { strict } else { lenient }
}

/// A library of blocks: a file for each part of the case.
pub fn blocks(bytes: &[u8]) -> Verdict {
    let parts = cut(bytes);
    let names: Vec<String> = (0..parts.len()).map(|number| format!("block{number}.obj")).collect();
    let files = names.iter().map(String::as_str).zip(parts).collect();
    let with = json!({"path": "files", "split": true, "recentre": true, "self_intersections": "smooth",
                      "modifiers": ["convex_hull"]});
    run("import-blocks", &with, &Files(&[("files", files)]), &[])
}

/// Clouds: the columns of a text file as they come, and named.
pub fn cloud(bytes: &[u8]) -> Verdict {
    let with = json!({"path": "file", "frame": "wall", "min_piece_triangles": 1});
    let named = json!({"path": "file", "min_piece_triangles": 1, "cell_m": 0.5, "max_edge_m": 100,
                       "columns": ["x", "y", "z", "intensity", "red", "green", "blue"], "outward": [0, 1, 1]});
    let plain = of_one("import-cloud", &with, "cloud.xyz", bytes);
    let other = of_one("import-cloud", &named, "cloud.xyz", bytes);
    if plain == Verdict::Accepted { plain } else { other }
}

/// Rasters of other programs.
pub fn rasters(bytes: &[u8]) -> Verdict {
    let parts = cut(bytes);
    let names: Vec<String> = (0..parts.len()).map(|number| format!("raster{number}.tif")).collect();
    let files = names.iter().map(String::as_str).zip(parts).collect();
    run("import-rasters", &json!({"path": "files"}), &Files(&[("files", files)]), &[])
}

/// A table of other programs.
pub fn table(bytes: &[u8]) -> Verdict {
    of_one("import-table", &json!({"path": "file"}), "table.csv", bytes)
}

/// An inventory of other programs.
pub fn inventory(bytes: &[u8]) -> Verdict {
    of_one("import-inventory", &json!({"path": "file"}), "falls.geojson", bytes)
}

/// A distribution in a file.
pub fn samples(bytes: &[u8]) -> Verdict {
    let length = json!({"file": {"path": "file", "column": "length_m", "smooth": true}});
    let classes = json!([{"shape": "prism", "size": {"axes": {"length_m": length}}}]);
    of_one("generate-blocks", &json!({"classes": classes}), "samples.csv", bytes)
}

/// Shapes, sizes and modifiers of blocks as a pipeline gives them.
pub fn shapes(bytes: &[u8]) -> Verdict {
    let Ok(with) = serde_json::from_slice::<Value>(bytes) else { return Verdict::Refused };
    if rockface_stages::registry().find("generate-blocks").is_none_or(|stage| stage.check(&with).is_err()) {
        return Verdict::Refused;
    }
    of_one("generate-blocks", &with, "samples.csv", b"length_m\n1\n2\n")
}

/// The cloud that COLMAP fused (its first part) and who sees the points (its second).
pub fn fused(bytes: &[u8]) -> Verdict {
    let parts = cut(bytes);
    let [ply, vis, ..] = parts.as_slice() else { return Verdict::Refused };
    let mut bounds = Bounds::default();
    for corner in [-1e3, 1e3] {
        bounds.include(&[corner; 3].into(), 1e3);
    }
    let _ = colmap_workspace::read_mesh(ply, Frame::Wall, [1.0, 2.0, 3.0], &bounds);
    Verdict::of(colmap_workspace::read(ply, vis, Frame::Wall, [1.0, 2.0, 3.0], &bounds).is_ok())
}
