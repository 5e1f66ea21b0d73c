//! Meshes, clouds, rasters and tables as other programs write them.

use std::io;

use rockface_core::artefact::Noun;

use super::artefacts::{hills, whole_cloud};
use super::{Seed, seed};
use crate::parts::joined;

const OBJ: &str = "# a pyramid\nmtllib a.mtl\no block\nv 0 0 0\nv 1 0 0 0.5 0.5 0.5\nv 0 1 0\nv 0 0 1\nvn 0 0 1\nvt 0 0\n\
    usemtl grey\nf 1 3 2\nf 1/1/1 2/1/1 4/1/1\nf 2//1 3//1 4//1\nf -2 -4 -1\n";
const STL: &str = "solid pyramid\n facet normal 0 0 -1\n  outer loop\n   vertex 0 0 0\n   vertex 0 1 0\n   vertex 1 0 0\n  \
    endloop\n endfacet\n facet normal 0 -1 0\n  outer loop\n   vertex 0 0 0\n   vertex 1 0 0\n   vertex 0 0 1\n  endloop\n \
    endfacet\nendsolid pyramid\n";
const PLY: &str = "ply\nformat ascii 1.0\ncomment by hand\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
    property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 2\nproperty list uchar int vertex_indices\n\
    end_header\n0 0 0 1 2 3\n1 0 0 1 2 3\n1 1 0 1 2 3\n0 1 0 1 2 3\n3 0 1 2\n4 0 1 2 3\n";
const XYZ: &str = "# x y z intensity red green blue\n0 0 0.5 7 1 2 3\n1 0 0.25 7 1 2 3\n0 1 0.5 7 1 2 3\n1 1 1 7 1 2 3\n2 1 0 7 1 2 3\n";
const CSV: &str = "name,x_m,volume_m3\na,1.5,0.25\n\"b, or c\",-2,\nd,1e-3,7\n";
const GEOJSON: &str = r#"{"type": "FeatureCollection", "name": "falls", "crs": {"type": "name", "properties": {"name": "EPSG:32756"}},
 "features": [{"type": "Feature", "properties": {"id": 1, "when": "2019-04-02", "sure": true}, "geometry": {"type": "Polygon",
 "coordinates": [[[0, 0], [2, 0], [2, 1], [0, 0]], [[0.5, 0.1], [1, 0.2], [1, 0.1], [0.5, 0.1]]]}},
 {"type": "Feature", "properties": {"id": null}, "geometry": {"type": "MultiPolygon", "coordinates": [[[[5, 5, 1], [6, 5, 1],
 [6, 6, 1], [5, 5, 1]]]]}}, {"type": "Feature", "properties": {}, "geometry": null}]}"#;
const SHAPES: [&str; 3] = [
    r#"{"classes": [{"shape": {"trapezoid": {}}, "probability": 2, "edge_m": 0.2}, {"shape": {"joint_block": {"sets": [{"dip_deg": 80,
 "dip_direction_deg": 10, "spacing_m": 0.5}, {"dip_deg": 5, "dip_direction_deg": 100, "spacing_m": 0.4}, {"dip_deg": 85,
 "dip_direction_deg": 280, "spacing_m": 0.6}]}}}], "face": {"dip_deg": 80, "dip_direction_deg": 100}}"#,
    r#"{"classes": [{"shape": {"polyhedron": {"points": 12}}, "size": {"volume": {"volume_m3": {"power_law": {"exponent": 1.5,
 "min": 0.01, "max": 10}}}}}], "modifiers": ["tumble", "convex_hull", {"roughness": {"sigma_m": 0.02}}]}"#,
    r#"{"classes": [{"shape": "prism", "size": {"axes": {"length_m": {"file": {"path": "file", "column": "length_m"}}}}}]}"#,
];

/// Seeds of the formats of other programs.
pub fn all() -> io::Result<Vec<Seed>> {
    let ply = hills().encode().map_err(io::Error::other)?;
    let cloud = whole_cloud();
    let exports = cloud.exports("cloud").map_err(io::Error::other)?;
    let laz = exports.into_iter().next().ok_or_else(|| io::Error::other("a cloud has no LAZ file"))?.bytes;
    let mut seeds = vec![
        seed("mesh", "ours.ply", &ply),
        seed("mesh", "text.ply", PLY),
        seed("mesh", "big-endian.ply", big_endian_ply()),
        seed("mesh", "text.obj", OBJ),
        seed("mesh", "text.stl", STL),
        seed("mesh", "binary.stl", binary_stl()),
        seed("blocks", "two", joined(&[OBJ.as_bytes(), OBJ.replace("1 0 0", "2 0 0").as_bytes()])),
        seed("cloud", "columns.xyz", XYZ),
        seed("cloud", "commas.csv", XYZ.replace("# ", "").replace(' ', ",")),
        seed("cloud", "ours.ply", cloud.encode().map_err(io::Error::other)?),
        seed("cloud", "cloud.laz", laz),
        seed("cloud", "cloud.las", las()),
        seed("table", "commas", CSV),
        seed("table", "semicolons", CSV.replace(',', ";")),
        seed("samples", "lengths", "length_m\n0.5\n1\n0.75\n"),
        seed("inventory", "qgis", GEOJSON),
        seed("colmap-fused", "four", fused()),
    ];
    seeds.extend(SHAPES.iter().enumerate().map(|(number, text)| seed("shapes", &number.to_string(), text)));
    for (kind, target) in [("artefact-raster", "rasters"), ("artefact-inventory", "inventory")] {
        let own = super::artefacts::all()?.into_iter().filter(|(of, ..)| *of == kind);
        seeds.extend(own.map(|(_, name, bytes)| (target, format!("own-{name}"), bytes)));
    }
    Ok(seeds)
}

fn big_endian_ply() -> Vec<u8> {
    let head = "ply\nformat binary_big_endian 1.0\nelement vertex 3\nproperty double x\nproperty double y\nproperty double z\n\
        element face 1\nproperty list uchar uint vertex_index\nend_header\n";
    let mut bytes = head.as_bytes().to_vec();
    let places: [f64; 9] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.5];
    bytes.extend(places.iter().flat_map(|x| x.to_be_bytes()));
    bytes.push(3);
    bytes.extend([0u32, 1, 2].iter().flat_map(|i| i.to_be_bytes()));
    bytes
}

fn binary_stl() -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend(2u32.to_le_bytes());
    let facets: [[f32; 12]; 2] = [
        [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 1.0, 0.0],
    ];
    for facet in facets {
        bytes.extend(facet.iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend([0, 0]);
    }
    bytes
}

/// LAS 1.2 of five points of format 2, which have colours.
fn las() -> Vec<u8> {
    const POINTS: u32 = 5;
    let mut bytes = vec![0; 227];
    let mut put = |at: usize, field: &[u8]| bytes[at..at + field.len()].copy_from_slice(field);
    put(0, b"LASF");
    put(24, &[1, 2]);
    put(94, &227u16.to_le_bytes());
    put(96, &227u32.to_le_bytes());
    put(104, &[2]);
    put(105, &26u16.to_le_bytes());
    put(107, &POINTS.to_le_bytes());
    put(111, &POINTS.to_le_bytes());
    for (number, value) in [0.01, 0.01, 0.01, 100.0, 200.0, 0.0, 4.0, 0.0, 4.0, 0.0, 1.0, 0.0].iter().enumerate() {
        put(131 + 8 * number, &f64::to_le_bytes(*value));
    }
    for number in 0..POINTS as i32 {
        let place = [number % 3 * 100, number / 3 * 100, number * 10];
        bytes.extend(place.iter().flat_map(|x| x.to_le_bytes()));
        bytes.extend([7, 0, 9, 2, 0, 0, 0, 0]);
        bytes.extend([1u16, 2, 3].iter().flat_map(|x| x.to_le_bytes()));
    }
    bytes
}

/// What COLMAP's `stereo_fusion` leaves: points with normals and colours, and the images of each.
fn fused() -> Vec<u8> {
    let mut ply = b"ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
        property float nx\nproperty float ny\nproperty float nz\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n\
        end_header\n"
        .to_vec();
    let mut seen = 4u64.to_le_bytes().to_vec();
    for number in 0..4u8 {
        let values = [f32::from(number), 1.0, 2.0, 0.0, 0.0, 1.0];
        ply.extend(values.iter().flat_map(|x| x.to_le_bytes()));
        ply.extend([1, 2, 3]);
        seen.extend([2u32, 0, 1].iter().flat_map(|x| x.to_le_bytes()));
    }
    joined(&[&ply, &seen])
}
