//! Files like those of other people's programs (`tests/foreign`): each is read, or refused with the sentence that helps.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use crate::cli::House;

/// What becomes of a file.
enum Outcome {
    /// It is read: `inspect` of the output says all of these, and the run all of those.
    Read(&'static [&'static str], &'static [&'static str]),
    /// It is refused, with all of these in the message.
    Refused(&'static [&'static str]),
}
use Outcome::{Read, Refused};

const SHEET: &[&str] = &["vertices 63", "triangles 96"];
const CLOUD: &str = ", min_piece_triangles: 1";
const SIZE: &str = ", image_size_px: [600, 400]";

/// The file, the stage and output, further parameters, and what becomes of it.
const CASES: [(&str, &str, &str, Outcome); 27] = [
    ("obj-meshlab.obj", "import-mesh.mesh", "", Read(SHEET, &[])),
    ("obj-rhino.obj", "import-mesh.mesh", "", Read(SHEET, &[])),
    (
        "obj-non-manifold.obj",
        "import-mesh.mesh",
        "",
        Refused(&["has 1 edges of three or more triangles", "`defects: repair` cuts it open"]),
    ),
    (
        "obj-non-manifold.obj",
        "import-mesh.mesh",
        ", defects: repair",
        Read(&["vertices 66", "triangles 97"], &["cut open along 1 edges of three or more triangles"]),
    ),
    ("obj-non-manifold.obj", "import-mesh.mesh", ", defects: keep", Read(&["vertices 64", "triangles 97"], &[])),
    ("ply-cloudcompare.ply", "import-mesh.mesh", "", Read(SHEET, &[])),
    ("ply-metashape.ply", "import-mesh.mesh", "", Read(SHEET, &[])),
    ("ply-windows.ply", "import-mesh.mesh", "", Read(SHEET, &[])),
    ("stl-solid-binary.stl", "import-mesh.mesh", "", Read(SHEET, &[])),
    ("las-utm.las", "import-cloud.mesh", CLOUD, Read(SHEET, &["63 points"])),
    ("las-utm.laz", "import-cloud.mesh", CLOUD, Read(SHEET, &["63 points"])),
    (
        "las-vlr-count.las",
        "import-cloud.mesh",
        CLOUD,
        Read(SHEET, &["its header counts 4 records, but only 1 fit before its points"]),
    ),
    (
        "las-us-feet.las",
        "import-cloud.mesh",
        CLOUD,
        Read(SHEET, &["is in US survey feet", "converted to metres", "median edge 0.076 m"]),
    ),
    ("las-degrees.las", "import-cloud.mesh", CLOUD, Refused(&["longitudes and latitudes in degrees", "EPSG:32756"])),
    (
        "xyz-cloudcompare.txt",
        "import-cloud.mesh",
        ", min_piece_triangles: 1, crs: 'EPSG:28356'",
        Read(SHEET, &["63 points"]),
    ),
    (
        "tif-pixel-is-point.tif",
        "import-rasters.raster",
        "",
        Read(&["frame world", "size 9 x 7", "left, top (m) [355999.875,6387100.125]"], &[]),
    ),
    (
        "tif-doubles.tif",
        "import-rasters.raster",
        "",
        Read(&["frame world", "size 9 x 7", "left, top (m) [356000.0,6387100.0]"], &[]),
    ),
    ("tif-degrees.tif", "import-rasters.raster", "", Refused(&["longitudes and latitudes in degrees", "gdalwarp"])),
    ("tif-no-crs.tif", "import-rasters.raster", "", Read(&["frame wall", "size 9 x 7"], &[])),
    ("tif-mask.tif", "import-rasters.raster", "", Refused(&["a mask of its own", "gdalwarp -dstnodata nan"])),
    (
        "metashape-unaligned.xml",
        "import-cameras.cameras",
        "",
        Refused(&["none of the 3 images of the chunk is aligned", "Align Photos"]),
    ),
    (
        "metashape-one-unaligned.xml",
        "import-cameras.cameras",
        "",
        Read(&["items 2"], &["1 of 3 images are not aligned or not enabled and are left out"]),
    ),
    ("metashape-geographic.xml", "import-cameras.cameras", "", Read(&["items 3"], &["its centres are geocentric"])),
    (
        "bundler-unregistered",
        "import-cameras.cameras",
        SIZE,
        Read(&["items 2"], &["1 of 3 images have no orientation (f = 0) and are left out: b.jpg"]),
    ),
    (
        "bundler-none-registered",
        "import-cameras.cameras",
        SIZE,
        Refused(&["none of the 2 images is oriented", "the reconstruction has registered no image"]),
    ),
    ("colmap-text", "import-cameras.cameras", "", Read(&["items 2"], &[])),
    ("colmap-fisheye", "import-cameras.cameras", "", Refused(&["`OPENCV_FISHEYE` cannot be held", "models: "])),
];

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/foreign")
}

/// What is wrong with a case, if anything is.
fn wrong((file, port, more, outcome): &(&str, &str, &str, Outcome)) -> Option<String> {
    let (stage, port) = port.split_once('.')?;
    let quantity = if stage == "import-rasters" { ", quantity: elevation" } else { "" };
    let path = folder().join(file);
    let with = format!("{{path: '{}'{quantity}{more}}}", path.display());
    let house = House::new(&format!("rockface: 1\nname: foreign\nsteps:\n  read: {{stage: {stage}, with: {with}}}\n"));
    let (code, out, err) = house.rockface(&["run", "p.yaml"]);
    let said = format!("{out}{err}");
    let (expected, told) = match outcome {
        Read(_, told) => (Some(0), *told),
        Refused(told) => (Some(1), *told),
    };
    let mut lacking: Vec<&str> = told.iter().copied().filter(|text| !said.contains(text)).collect();
    let mut shown = said.clone();
    if let Read(facts, _) = outcome {
        let (_, inspected, _) = house.rockface(&["inspect", "latest", &format!("read.{port}")]);
        let words = inspected.split_whitespace().collect::<Vec<_>>().join(" ");
        lacking.extend(facts.iter().copied().filter(|fact| !words.contains(fact)));
        shown += &inspected;
    }
    let is_right = code == expected && lacking.is_empty();
    (!is_right).then(|| format!("{file}{more}: {code:?}, lacking {lacking:?}\n{shown}"))
}

#[test]
fn files_of_other_programs_are_read_or_refused_with_the_way_out() {
    let wrong: Vec<String> = CASES.iter().filter_map(wrong).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn every_file_has_a_case_and_a_line_of_the_readme() {
    let readme = std::fs::read_to_string(folder().join("README.md")).unwrap();
    let known: BTreeSet<&str> = CASES.iter().map(|(file, ..)| *file).collect();
    for entry in std::fs::read_dir(folder()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        if !matches!(name.as_str(), "README.md" | "make.py" | "__pycache__") {
            assert!(known.contains(name.as_str()), "tests/house/foreign.rs has no case of {name}");
            assert!(readme.contains(&format!("`{name}`")), "tests/foreign/README.md has no line of {name}");
        }
    }
}
