//! What `fuse-colmap` asks of a program, and what it says where that is not as it should be; COLMAP itself runs in `tests/peers`.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use serde_json::json;

use super::*;
use crate::depth::depth_buffer::{Drawing, draw, rounded};
use rockface_core::artefact::Artefact;
use rockface_core::params::ParamType;
use rockface_core::testing::{height_mesh, image_at, small_sensor};
use rockface_core::{Entry, Host, Program, SourceFile};

/// A host whose program says a version, and makes what it is told to make.
struct Pretender {
    version: &'static str,
    makes: BTreeMap<String, Vec<u8>>,
    asked: Mutex<Vec<Program>>,
}

impl Host for Pretender {
    fn stream_key(&self, _purpose: &str, _item: &str) -> [u8; 32] {
        panic!("nothing is drawn")
    }
    fn open(&self, _as_written: &str) -> std::io::Result<Vec<SourceFile>> {
        Err(std::io::ErrorKind::NotFound.into())
    }
    fn execute(&self, program: &Program) -> Result<ProgramResult, StageError> {
        let first = self.asked.lock().unwrap().is_empty();
        self.asked.lock().unwrap().push(program.clone());
        if self.version.is_empty() {
            let stderr = "ModuleNotFoundError: No module named 'pycolmap'".to_owned();
            return Ok(ProgramResult { exit_code: Some(1), stderr, ..ProgramResult::default() });
        }
        let stdout = if first { self.version.to_owned() } else { String::new() };
        let outputs = if first { BTreeMap::new() } else { self.makes.clone() };
        Ok(ProgramResult { exit_code: Some(0), stdout, outputs, ..ProgramResult::default() })
    }
    fn record(&self, _entry: Entry) {}
    fn cancelled(&self) -> bool {
        false
    }
}

fn depth(name: &str, x: f64) -> Depth {
    let mesh = height_mesh(20, [-12.0, 12.0, -12.0, 12.0], |x, _| 0.1 * x);
    let (sensor, image) = (small_sensor(), image_at(name, [x, 0.0, 20.0], [0.0; 3]));
    let drawing = Drawing { downscale: 1, safe_border_px: 0.0, front_only: true, window_m: None };
    let buffer = draw(&mesh, &crate::camera::model::Camera::new(&sensor, &image), &drawing);
    let z = buffer.z_m.iter().map(|z| rounded(*z)).collect();
    let (width, height, channels) = (buffer.width, buffer.height, BTreeMap::new());
    Depth { frame: mesh.frame, sensor, image, downscale: 1, width, height, z, channels }
}

fn run(version: &'static str, makes: &[(&str, &[u8])], with: &Value) -> (Result<Outputs, StageError>, Vec<Program>) {
    let makes = makes.iter().map(|(name, bytes)| ((*name).to_owned(), bytes.to_vec())).collect();
    let host = Pretender { version, makes, asked: Mutex::new(Vec::new()) };
    let params = FuseColmapParams::decode(with).unwrap();
    let mut inputs = Inputs::default();
    for (name, x) in [("left", -2.0), ("right", 2.0)] {
        inputs.push("depths", rockface_core::Point::new(), Arc::new(Artefact::Depth(depth(name, x))));
    }
    let result = FuseColmap::run(&params, &inputs, &Context::new(&host));
    (result, host.asked.into_inner().unwrap())
}

/// One point of COLMAP's, and who saw it.
fn fused() -> [(&'static str, Vec<u8>); 2] {
    let mut ply = b"ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty float x\nproperty float y\n\
                    property float z\nproperty float nx\nproperty float ny\nproperty float nz\nend_header\n"
        .to_vec();
    [0.0f32, 0.0, 0.0, 0.0, 0.0, 1.0].iter().for_each(|value| ply.extend_from_slice(&value.to_le_bytes()));
    let vis = [1u64.to_le_bytes().to_vec(), [2u32, 0, 1].iter().flat_map(|n| n.to_le_bytes()).collect()].concat();
    [(engine::FUSED, ply), (engine::VISIBILITY, vis)]
}

#[test]
fn pycolmap_is_given_a_workspace_and_its_cloud_is_taken() {
    let [ply, vis] = fused();
    let makes = [(ply.0, ply.1.as_slice()), (vis.0, vis.1.as_slice())];
    let (result, asked) = run("4.2.1\n", &makes, &json!({"version": "4.2.1", "program": "/venv/bin/python"}));
    let Some(Artefact::Cloud(cloud)) = result.unwrap().into_inner().remove("cloud") else { panic!("no cloud") };
    assert_eq!((cloud.points.as_slice(), cloud.numbers["views"].as_slice()), (&[[0.0; 3]][..], &[2][..]));
    let names: Vec<&str> = asked[1].inputs.iter().map(|(name, _)| name.as_str()).collect();
    assert!(names.contains(&"work/sparse/points3D.txt") && names.contains(&"fuse.py"), "{names:?}");
    assert_eq!(asked[1].program, [rockface_core::Piece::Text("/venv/bin/python".to_owned())]);
}

#[test]
fn the_command_line_program_runs_once_for_each_thing() {
    let [ply, vis] = fused();
    let makes = [(ply.0, ply.1.as_slice()), (vis.0, vis.1.as_slice())];
    let with = json!({"version": "3.8", "engine": "colmap", "poisson": {}});
    let (result, asked) = run("COLMAP 3.8 -- Structure-from-Motion", &makes, &with);
    let first = |program: &Program| match &program.args[0][0] {
        rockface_core::Piece::Text(text) => text.clone(),
        rockface_core::Piece::File(_) | rockface_core::Piece::Found(_) => panic!("a file"),
    };
    assert_eq!(asked.iter().map(first).collect::<Vec<_>>(), ["help", "stereo_fusion", "poisson_mesher"]);
    assert!(result.unwrap_err().message.contains("without making `out/meshed.ply`"));
}

#[test]
fn what_is_missing_or_other_than_stated_is_told_with_a_way_out() {
    let error = run("4.2.1", &[], &json!({"version": "3.8"})).0.unwrap_err();
    assert!(error.message.contains("has COLMAP 4.2.1, but `version` says 3.8"), "{}", error.message);
    let error = run("", &[], &json!({"version": "3.8"})).0.unwrap_err();
    assert!(error.hint.unwrap().contains("pip install pycolmap"));
    let error = run("4.2.1", &[], &json!({"version": "4.2.1"})).0.unwrap_err();
    assert!(error.message.contains("without making `out/fused.ply`"), "{}", error.message);
}

#[test]
fn faults_of_the_parameters_are_found_before_anything_runs() {
    let stage = rockface_core::Row::<FuseColmap>::new();
    let path = |with: Value| rockface_core::AnyStage::check(&stage, &with).unwrap_err()[0].path.clone();
    assert_eq!(path(json!({"version": "1", "program": "venv/bin/python"})), ["program"]);
    assert_eq!(path(json!({"version": " "})), ["version"]);
    assert_eq!(path(json!({"version": "1", "poisson": {"depth": 9, "trim": 10}})), ["poisson", "trim"]);
    assert_eq!(FuseColmap::ports(&json!({"version": "1"})).unwrap().outputs.len(), 1);
    assert_eq!(FuseColmap::ports(&json!({"poisson": {}})).unwrap().outputs.len(), 2);
}
