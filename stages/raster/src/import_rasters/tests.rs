//! Tests of `import-rasters`: bands, frames, values that stand for none, and faults by name.

use serde_json::json;

use super::*;
use rockface_core::artefact::{Artefact, Georeference, Grid, Transform};
use rockface_core::testing::{TestHost, run_stage};

fn file(name: &str, left_m: f64, values: Vec<f32>) -> (String, Vec<u8>) {
    let grid = Grid { columns: 2, rows: 2, cell_m: 0.5, left_m, top_m: 1.0 };
    let raster = Raster::single(grid, Frame::World, "elevation", "z", values);
    (name.to_owned(), raster.encode().unwrap())
}

fn import(files: Vec<(String, Vec<u8>)>) -> Result<Raster, StageError> {
    import_on(&mut TestHost::default(), files)
}

fn import_on(host: &mut TestHost, files: Vec<(String, Vec<u8>)>) -> Result<Raster, StageError> {
    import_with(&json!({"path": "real"}), host, files)
}

fn import_with(
    with: &serde_json::Value,
    host: &mut TestHost,
    files: Vec<(String, Vec<u8>)>,
) -> Result<Raster, StageError> {
    host.files.insert("real".into(), files);
    let outputs = run_stage::<ImportRasters>(host, with, &[])?;
    match &outputs.into_inner()["raster"] {
        Artefact::Raster(raster) => Ok(raster.clone()),
        other => panic!("{}", other.kind()),
    }
}

#[test]
fn files_become_bands_in_their_order() {
    let raster = import(vec![file("a.tif", 0.0, vec![1.0; 4]), file("b.x.tif", 1e-8, vec![2.0; 4])]).unwrap();
    assert_eq!(raster.items().unwrap(), ["a", "b.x"]);
    assert_eq!((raster.frame, raster.quantity.as_str()), (Frame::World, "difference"));
    assert_eq!(raster.bands[1].values, [2.0; 4]);
}

#[test]
fn undeclared_no_data_and_millimetres_are_warned_of() {
    let mut host = TestHost::default();
    let files = vec![
        file("good.tif", 0.0, vec![0.1, -0.2, 0.0, f32::NAN]),
        file("holes.tif", 0.0, vec![0.1, -9999.0, -9999.0, 0.0]),
        file("mm.tif", 0.0, vec![12.0, -7.0, 3.0, -1.0]),
    ];
    import_on(&mut host, files).unwrap();
    let warnings = host.warnings();
    assert_eq!(warnings.len(), 2, "{warnings:?}");
    assert!(warnings[0].contains("`holes`: 2 cells") && warnings[0].contains("-a_nodata -9999 FILE"));
    assert!(warnings[1].contains("`mm` by") && warnings[1].contains("millimetres"));
}

#[test]
fn undeclared_no_data_of_elevations_is_warned_of_and_declared() {
    let (mut host, with) = (TestHost::default(), |extra: serde_json::Value| {
        let mut with = json!({"path": "real", "quantity": "elevation"});
        with.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
        with
    });
    let files = || {
        vec![
            file("a.tif", 0.0, vec![612.0, -9999.0, -9999.0, 613.0]),
            file("b.tif", 0.0, vec![612.0, 0.0, 612.5, 613.0]),
            file("c.tif", 0.0, vec![612.0, 3.4e38, 612.5, 613.0]),
        ]
    };
    import_with(&with(json!({})), &mut host, files()).unwrap();
    let warnings = host.warnings();
    assert_eq!(warnings.len(), 3, "{warnings:?}");
    assert!(warnings[0].starts_with("`a.tif`: 2 cells hold -9999, ") && warnings[0].contains("`nodata: [-9999]`"));
    assert!(warnings[1].contains("1 cells hold 0, ") && warnings[2].contains("`nodata: [3.4e38]`"));
    let mut host = TestHost::default();
    let raster = import_with(&with(json!({"nodata": [-9999, 0, 3.4e38]})), &mut host, files()).unwrap();
    assert_eq!(raster.bands.iter().flat_map(|band| &band.values).filter(|value| value.is_nan()).count(), 4);
    assert!(host.warnings().is_empty(), "{:?}", host.warnings());
}

#[test]
fn values_beyond_the_limit_are_left_out_with_a_warning() {
    let files =
        || vec![file("a.tif", 0.0, vec![0.04, -0.05, 0.0, f32::NAN]), file("b.tif", 0.0, vec![0.1, -0.051, 0.0, 0.02])];
    let with = json!({"path": "real", "max_abs": 0.05});
    let mut host = TestHost::default();
    let raster = import_with(&with, &mut host, files()).unwrap();
    assert_eq!(raster.bands[0].values[..3], [0.04, -0.05, 0.0]);
    assert!(
        raster.bands[1].values[..2].iter().all(|value| value.is_nan()) && raster.bands[1].values[2..] == [0.0, 0.02]
    );
    let warnings = host.warnings();
    assert!(
        warnings.len() == 1 && warnings[0].contains("2 cells (28.57 %)") && warnings[0].contains("2 of `b`"),
        "{warnings:?}"
    );
    let all = vec![file("mm.tif", 0.0, vec![12.0, -7.0, 3.0, -1.0])];
    let error = import_with(&with, &mut TestHost::default(), all).unwrap_err();
    assert!(error.message.contains("every value of band `mm`"), "{error}");
}

#[test]
fn a_damaged_file_is_to_be_copied_again() {
    let (name, mut bytes) = file("a.tif", 0.0, vec![1.0; 4]);
    bytes.truncate(bytes.len() - 3);
    let error = import(vec![(name, bytes)]).unwrap_err();
    assert!(error.message.contains("copy it again") && error.hint.is_none(), "{error}");
    assert!(import(vec![("x.txt".into(), b"hello".to_vec())]).unwrap_err().hint.is_some());
}

#[test]
fn each_fault_names_its_file() {
    let message = |files| import(files).unwrap_err().message;
    assert!(message(Vec::new()).contains("`real` names no file"));
    assert!(message(vec![("x.txt".into(), b"hello".to_vec())]).contains("`x.txt`"));
    assert!(message(vec![file("n.tif", 0.0, vec![f32::NAN; 4])]).contains("`n.tif`"));
    let shifted = message(vec![file("a.tif", 0.0, vec![1.0; 4]), file("b.tif", 0.1, vec![1.0; 4])]);
    assert!(shifted.contains("`a.tif`") && shifted.contains("`b.tif`"), "{shifted}");
    let twins = message(vec![file("a.tif", 0.0, vec![1.0; 4]), file("a.tiff", 0.0, vec![1.0; 4])]);
    assert!(twins.contains("`a`"), "{twins}");
}

/// A raster in a frame as GDAL would write it: without what our own files say beside the keys.
fn foreign(name: &str, frame: Frame) -> (String, Vec<u8>) {
    let grid = Grid { columns: 2, rows: 2, cell_m: 0.5, left_m: 691_000.0, top_m: 5_334_000.0 };
    let mut bytes = Raster::single(grid, frame, "elevation", "z", vec![300.0; 4]).encode().unwrap();
    for item in [&b"\"FRAME\""[..], b"\"GEOREFERENCE\""] {
        if let Some(at) = bytes.windows(item.len()).position(|window| window == item) {
            bytes[at + 1] = b'X';
        }
    }
    (name.to_owned(), bytes)
}

#[test]
fn a_code_that_is_not_known_is_no_wall_frame() {
    let text = Frame::World.at(Some(Georeference::world("EPSG:2154".parse().unwrap()))).crs().unwrap().wkt();
    let newer: crs::Crs = text.replace("\"2154\"", "\"9794\"").parse().unwrap();
    let world = Frame::World.at(Some(Georeference::world(newer)));
    let error = import(vec![foreign("new.tif", world)]).unwrap_err();
    assert!(error.message.contains("EPSG:9794") && error.hint.unwrap().contains("well-known text"));
    let with = json!({"path": "real", "crs": text, "quantity": "elevation"});
    let raster = import_with(&with, &mut TestHost::default(), vec![foreign("new.tif", world)]).unwrap();
    assert_eq!(raster.frame.crs().unwrap().epsg(), Some(2154));
    // Our own files have the definition beside the code.
    let own = Raster::single(raster.grid, world, "elevation", "z", vec![300.0; 4]).encode().unwrap();
    let again = import(vec![("own.tif".into(), own)]).unwrap();
    assert_eq!(again.frame.crs(), world.crs());
}

#[test]
fn rasters_of_two_wall_frames_are_not_put_together() {
    let wall = |shift_m: f64| {
        let wall_from_world = Some(Transform { origin: [shift_m, 0.0, 0.0], ..Transform::identity("world", "wall") });
        Frame::Wall.at(Some(Georeference { crs: None, wall_from_world }))
    };
    let file = |name: &str, frame: Frame| {
        let grid = Grid { columns: 2, rows: 2, cell_m: 0.5, left_m: 0.0, top_m: 1.0 };
        let raster = Raster::single(grid, frame, "elevation", "z", vec![1.0; 4]);
        (name.to_owned(), raster.encode().unwrap())
    };
    let two = |second: Frame| import(vec![file("a.tif", wall(0.0)), file("b.tif", second)]);
    assert!(two(wall(3.0)).unwrap_err().message.contains("two wall frames"));
    let one = two(wall(0.0)).unwrap();
    assert_eq!(one.frame.georeference(), wall(0.0).georeference());
    assert!(two(Frame::Wall).is_ok());
}
