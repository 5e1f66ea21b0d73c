//! Tests of `estimate-covariance`: the station of the paper, big blocks in seconds, and blocks that nothing fixes.

use super::*;
use crate::camera::covariance_sampling::{JointRoot, block_only};
use crate::camera::orientation::quaternion;
use nalgebra::Matrix3;
use rockface_core::artefact::{Artefact, Georeference, Image, Sensor, Transform};
use rockface_core::params::ParamType;
use rockface_core::testing::{TestHost, height_mesh, image_at, run_stage, small_sensor};
use serde_json::{Value, json};

fn looking(name: &str, centre: Vector3<f64>, target: Vector3<f64>) -> Image {
    let z = (target - centre).normalize();
    let x = z.cross(&Vector3::y()).normalize();
    let rotation = Matrix3::from_rows(&[x.transpose(), z.cross(&x).transpose(), z.transpose()]);
    let mut image =
        Image { name: name.into(), sensor: 0, camera_from_object: [1.0, 0.0, 0.0, 0.0], centre_m: centre.into() };
    image.set_rotation(&quaternion(&rotation));
    image
}

/// The paper's Hunter Valley station: two images of 45.4 MP, 87 m from a face of 35.6 x 24 m, 32.6 m apart.
fn station() -> (Cameras, Mesh) {
    let sensor = Sensor { width_px: 8256, height_px: 5504, f: 19_540.0, cx: 4127.5, cy: 2751.5, ..small_sensor() };
    let image = |name: &str, x: f64| looking(name, Vector3::new(x, 0.0, 87.0), Vector3::zeros());
    let images = vec![image("left", -16.3), image("right", 16.3)];
    let relief = |x: f64, y: f64| {
        0.8 * rockface_core::numerics::portable_math::sin(0.7 * x)
            * rockface_core::numerics::portable_math::cos(0.9 * y)
    };
    (Cameras { frame: Frame::Wall, sensors: vec![sensor], images }, height_mesh(60, [-17.8, 17.8, -12.0, 12.0], relief))
}

fn estimate(host: &TestHost, cameras: &Cameras, mesh: &Mesh, with: &Value) -> Result<Covariance, StageError> {
    let inputs = [("cameras", Artefact::Cameras(cameras.clone())), ("mesh", Artefact::Mesh(mesh.clone()))];
    match run_stage::<EstimateCovariance>(host, with, &inputs)?.into_inner().remove("covariance") {
        Some(Artefact::Covariance(covariance)) => Ok(covariance),
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_station_of_the_paper_has_the_figures_known_of_it() {
    let (cameras, mesh) = station();
    let host = TestHost::default();
    let covariance = estimate(&host, &cameras, &mesh, &json!({"control_sigma_px": 0.5})).unwrap();
    assert_eq!(covariance.parameters.len(), 12);
    JointRoot::new(&covariance).unwrap();
    assert_eq!(block_only(&covariance), None);
    let figure = |name: &str| host.metric(name).unwrap();
    let (depth, off_plane, parallax) =
        (figure("expected_depth_error"), figure("expected_depth_error_off_plane"), figure("expected_y_parallax"));
    println!("depth {depth:.5} m, off plane {off_plane:.5} m, y-parallax {parallax:.4} px");
    // An independent program has 5.5 mm, 0.59 mm and 0.065 px for 400 tie points of 0.5 px and 8 control points of 5 mm.
    assert!((0.002..0.009).contains(&depth), "{depth}");
    assert!((0.000_3..0.001).contains(&off_plane), "{off_plane}");
    assert!((0.045..0.085).contains(&parallax), "{parallax}");
}

#[test]
fn an_estimated_lens_and_gnss_positions_work_too() {
    let (cameras, mesh) = station();
    let host = TestHost::default();
    let lens =
        json!({"free_interior": ["k1", "f", "cx", "cy"], "interior_sigma": {"focal_px": 5, "principal_point_px": 5}});
    let covariance = estimate(&host, &cameras, &mesh, &lens).unwrap();
    assert_eq!(covariance.parameters[12..], ["small.f", "small.cx", "small.cy", "small.k1"]);
    assert!(covariance.matrix[12][12].sqrt() < 5.0, "the prior is an upper bound");
    let gnss = json!({"control_points": 0, "position_sigma_m": [0.02, 0.02, 0.03]});
    // Two centres leave the turn about their line to nothing.
    let error = estimate(&host, &cameras, &mesh, &gnss).unwrap_err();
    assert!(error.message.contains("1 free directions: 1 of the block as a whole"), "{error}");
    // Positions were given: more of them does not help.
    let hint = error.hint.clone().unwrap();
    assert!(hint.contains("two images") && hint.contains("`control_points`") && !hint.contains("GNSS"), "{hint}");
    let error = estimate(&host, &cameras, &mesh, &json!({"control_points": 0})).unwrap_err();
    assert!(error.message.contains("7 free directions: 7 of the block as a whole"), "{error}");
    assert!(error.hint.unwrap().contains("control_points"));
}

#[test]
fn positions_are_measured_along_the_axes_of_the_world() {
    let (mut cameras, mut mesh) = station();
    // X, Y, Z of the wall are Y, Z, X of the world.
    let rotation = nalgebra::Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0);
    let way = Transform::new("world", "wall", &rotation, Vector3::zeros(), Vector3::zeros());
    let stands = Frame::Wall.at(Some(Georeference { crs: None, wall_from_world: Some(way) }));
    let run = |cameras: &Cameras, mesh: &Mesh, sigma: [f64; 3], axes: Value| {
        let with = json!({"control_sigma_m": 0.5, "position_sigma_m": sigma, "position_axes": axes});
        let host = TestHost::default();
        (estimate(&host, cameras, mesh, &with), host.warnings().len())
    };
    let error = run(&cameras, &mesh, [0.01, 0.02, 0.05], json!("world")).0.unwrap_err();
    assert!(error.message.contains("how the wall stands"), "{error}");
    (cameras.frame, mesh.frame) = (stands, stands);
    let (along_wall, warnings) = run(&cameras, &mesh, [0.02, 0.05, 0.01], Value::Null);
    assert_eq!(warnings, 1);
    let (along_world, warnings) = run(&cameras, &mesh, [0.01, 0.02, 0.05], json!("world"));
    assert_eq!((along_wall.unwrap().matrix, warnings), (along_world.unwrap().matrix, 0));
}

#[test]
fn inner_constraints_leave_no_motion_of_the_whole() {
    let (cameras, mesh) = station();
    let host = TestHost::default();
    let free = estimate(&host, &cameras, &mesh, &json!({"control_points": 0, "datum": "inner"})).unwrap();
    JointRoot::new(&free).unwrap();
    let parallax = host.metric("expected_y_parallax").unwrap();
    estimate(&host, &cameras, &mesh, &json!({"control_sigma_m": 0.5})).unwrap();
    // The datum moves no ray against another: y-parallax is that of the block with hardly any control.
    assert!((parallax / host.metric("expected_y_parallax").unwrap() - 1.0).abs() < 0.05);
    let sum: f64 = ["left.X", "right.X"]
        .iter()
        .map(|name| {
            let at = free.parameters.iter().position(|p| p == name).unwrap();
            free.matrix[at]
                .iter()
                .enumerate()
                .filter(|(j, _)| ["left.X", "right.X"].contains(&free.parameters[*j].as_str()))
                .map(|(_, x)| x)
                .sum::<f64>()
        })
        .sum();
    assert!(sum.abs() < 1e-9, "the mean centre does not move: {sum}");
}

#[test]
fn eighty_images_are_adjusted_in_seconds() {
    let sensor = Sensor { width_px: 5472, height_px: 3648, f: 3651.0, cx: 2735.5, cy: 1823.5, ..small_sensor() };
    let image = |at: usize| {
        let (column, row) = (at % 10, at / 10);
        let centre = [6.0 * (column as f64 - 4.5), 4.0 * (row as f64 - 3.5), 20.0];
        image_at(&format!("r{row}c{column}"), centre, [0.02 * (at % 3) as f64, 0.0, 0.0])
    };
    let cameras = Cameras { frame: Frame::Wall, sensors: vec![sensor], images: (0..80).map(image).collect() };
    let mesh = height_mesh(80, [-20.0, 20.0, -11.0, 11.0], |x, y| {
        0.5 * rockface_core::numerics::portable_math::sin(x + 0.6 * y)
    });
    let with = json!({"tie_points": 1500, "control_points": 0, "position_sigma_m": [0.02, 0.02, 0.03],
        "free_interior": ["f", "cx", "cy", "k1", "k2", "p1", "p2"], "image_sigma_px": 0.7});
    let host = TestHost::default();
    let start = std::time::Instant::now();
    let covariance = estimate(&host, &cameras, &mesh, &with).unwrap();
    println!("{} parameters in {:.2} s", covariance.parameters.len(), start.elapsed().as_secs_f64());
    assert_eq!(covariance.parameters.len(), 487);
    println!("{:?} {:?}", host.metric("expected_depth_error"), host.metric("expected_y_parallax"));
    assert!(host.metric("position_sigma_rms").unwrap() < 0.025);
}

/// The covariance with control points that are given.
fn with_control(
    host: &TestHost,
    (cameras, mesh): &(Cameras, Mesh),
    control: Table,
    transform: Option<Transform>,
) -> Result<Covariance, StageError> {
    let mut inputs =
        vec![("cameras", cameras.clone().into()), ("mesh", mesh.clone().into()), ("control", control.into())];
    inputs.extend(transform.map(|transform| ("transform", Artefact::from(transform))));
    match run_stage::<EstimateCovariance>(host, &json!({}), &inputs)?.into_inner().remove("covariance") {
        Some(Artefact::Covariance(covariance)) => Ok(covariance),
        other => panic!("{other:?}"),
    }
}

fn corners(sigma_m: f64, shift: [f64; 3], more: &[[f64; 3]]) -> Table {
    let mut table = Table::new(["name", "x_m", "y_m", "z_m", "sigma_m"]);
    let on_face = [[-10.0, -8.0, 0.0], [10.0, -8.0, 0.0], [-10.0, 8.0, 0.0], [10.0, 8.0, 0.0]];
    for (number, place) in on_face.iter().chain(more).enumerate() {
        let [x, y, z] = std::array::from_fn(|i| place[i] + shift[i]);
        table.push(vec![format!("GCP{number}").into(), x.into(), y.into(), z.into(), sigma_m.into()]);
    }
    table
}

#[test]
fn control_points_of_a_survey_take_the_place_of_those_spread_over_the_face() {
    let station = station();
    let depth_of = |sigma_m: f64| {
        let host = TestHost::default();
        with_control(&host, &station, corners(sigma_m, [0.0; 3], &[]), None).unwrap();
        assert!(host.warnings().is_empty(), "{:?}", host.warnings());
        host.metric("expected_depth_error").unwrap()
    };
    assert!(depth_of(0.05) > 3.0 * depth_of(0.002));
    // One out of sight is left out, and named; the others count as before.
    let host = TestHost::default();
    let seen = with_control(&host, &station, corners(0.01, [0.0; 3], &[[300.0, 0.0, 0.0]]), None).unwrap();
    assert!(host.warnings()[0].contains("left out of `control`") && host.warnings()[0].contains("GCP4"));
    // One on the ground in front of the face counts, and is named: it may be a wrong digit.
    let host = TestHost::default();
    with_control(&host, &station, corners(0.01, [0.0; 3], &[[0.0, 0.0, 3.0], [5.0, 0.0, 0.2]]), None).unwrap();
    assert_eq!(host.warnings().len(), 1, "{:?}", host.warnings());
    assert!(
        host.warnings()[0].contains("in front of the mesh: GCP4 (2.") && !host.warnings()[0].contains("GCP5"),
        "{:?}",
        host.warnings()
    );
    let alone = with_control(&TestHost::default(), &station, corners(0.01, [0.0; 3], &[]), None).unwrap();
    assert_eq!(seen.matrix, alone.matrix);
    // Map coordinates need the transform.
    let shift = [450_000.0, 5_000_000.0, 800.0];
    let on_map = || corners(0.01, shift, &[]);
    let error = with_control(&TestHost::default(), &station, on_map(), None).unwrap_err();
    assert!(error.message.contains("of 4 in it") && error.hint.unwrap().contains("`transform`"));
    let way = Transform { origin: shift, ..Transform::identity("world", "wall") };
    let moved = with_control(&TestHost::default(), &station, on_map(), Some(way)).unwrap();
    let mut pairs = moved.matrix.iter().flatten().zip(alone.matrix.iter().flatten());
    assert!(pairs.all(|(a, b)| (a - b).abs() < 1e-9));
}

#[test]
fn faults_name_their_parameter() {
    let check = |with: Value| EstimateCovariance::check(&EstimateCovarianceParams::decode(&with).unwrap());
    assert_eq!(check(json!({"free_interior": ["f", "k5"]}))[0].path, ["free_interior", "1"]);
    assert_eq!(check(json!({"free_interior": ["f", "f"]}))[0].path, ["free_interior", "1"]);
    assert_eq!(check(json!({"datum": "inner"}))[0].path, ["control_points"]);
    assert_eq!(check(json!({"interior_sigma": {"p": 1e-4}}))[0].path, ["interior_sigma"]);
    assert!(check(json!({"free_interior": ["p2"], "interior_sigma": {"p": 1e-4}})).is_empty());
    let (mut cameras, mesh) = station();
    cameras.frame = Frame::World;
    let error = estimate(&TestHost::default(), &cameras, &mesh, &json!({})).unwrap_err();
    assert!(error.message.contains("world frame"));
    let (cameras, _) = station();
    let away = height_mesh(4, [200.0, 210.0, 0.0, 5.0], |_, _| 0.0);
    let error = estimate(&TestHost::default(), &cameras, &away, &json!({})).unwrap_err();
    assert!(error.message.contains("no tie points"), "{error}");
}
