//! Tests of `plan-survey`: the stations of the paper, repeated flights, and plans that cannot be.

use super::*;
use crate::camera::model::Camera;
use nalgebra::Matrix3;
use rockface_core::artefact::Artefact;
use rockface_core::params::ParamType;
use rockface_core::testing::TestHost;
use serde_json::{Value, json};
use std::sync::Arc;

fn face(frame: Frame) -> Mesh {
    let vertices =
        (0..21).flat_map(|i| (0..21).map(move |j| [f64::from(i), f64::from(j), 0.5 * f64::from((i + j) % 2)]));
    let vertices: Vec<_> = vertices.collect();
    let squares = (0..20u32).flat_map(|i| (0..20).map(move |j| 21 * i + j));
    let triangles = squares.flat_map(|v| [[v, v + 21, v + 1], [v + 1, v + 21, v + 22]]).collect();
    Mesh { frame, vertices, triangles, colours: Vec::new() }
}

fn plan(host: &TestHost, mesh: Mesh, with: &Value) -> Result<Cameras, StageError> {
    let mut inputs = Inputs::default();
    inputs.push("mesh", rockface_core::Point::new(), Arc::new(mesh.into()));
    let made = PlanSurvey::run(&PlanSurveyParams::decode(with).unwrap(), &inputs, &Context::new(host))?;
    match made.into_inner().remove("cameras") {
        Some(Artefact::Cameras(cameras)) => Ok(cameras),
        other => panic!("{other:?}"),
    }
}

#[test]
fn the_default_station_has_the_figures_of_the_paper() {
    let host = TestHost::default();
    let cameras = plan(&host, face(Frame::Wall), &json!({})).unwrap();
    assert!((host.metric("gsd").unwrap() - 0.00445).abs() < 1e-5);
    assert!((host.metric("depth_per_pixel").unwrap() - 0.01188).abs() < 1e-5);
    // Both axes meet at the centre: 2 atan(16.3 / 87).
    let expected = 2.0 * rockface_core::numerics::portable_math::atan(16.3 / 87.0).to_degrees();
    assert!((host.metric("convergence").unwrap() - expected).abs() < 1e-9);
    assert_eq!(host.metric("share_of_face_in_both"), Some(1.0));
    let mean_z = 0.5 * 220.0 / 441.0;
    for image in &cameras.images {
        let [u, v] = Camera::new(&cameras.sensors[0], image).project(&Vector3::new(10.0, 10.0, mean_z)).unwrap();
        assert!((u - 4127.5).abs() < 1e-6 && (v - 2751.5).abs() < 1e-6, "{u} {v}");
        assert!(image.matrix()[(0, 1)].abs() < 1e-12, "x is horizontal");
    }
    assert_eq!(cameras.images[0].name, "left");
    assert!((cameras.images[1].centre() - cameras.images[0].centre() - Vector3::new(32.6, 0.0, 0.0)).norm() < 1e-12);
}

#[test]
fn parallel_axes_look_straight_with_x_right_and_y_down() {
    let with = json!({"aim": "parallel", "height_offset_m": 2.0, "distance_m": 40, "baseline_m": 4});
    let cameras = plan(&TestHost::default(), face(Frame::Wall), &with).unwrap();
    let expected = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    assert!(cameras.images.iter().all(|image| (image.matrix() - expected).norm() < 1e-15));
    assert!((cameras.images[0].centre_m[1] - 12.0).abs() < 1e-12);
}

#[test]
fn impossible_stations_are_refused() {
    let near = plan(&TestHost::default(), face(Frame::Wall), &json!({"distance_m": 0.1})).unwrap_err();
    assert!(near.message.contains("inside or behind"), "{near}");
    let world = plan(&TestHost::default(), face(Frame::World), &json!({})).unwrap_err();
    assert!(world.message.contains("world frame") && world.hint.unwrap().contains("transform-crs"));
    let both = PlanSurveyParams::decode(&json!({"focal_px": 4545, "pixel_um": 4})).unwrap();
    assert_eq!(PlanSurvey::check(&both)[0].path, ["focal_px"]);
}

#[test]
fn a_station_has_two_bodies_and_a_flight_one() {
    let sensors = |mesh: Mesh, with: &Value| {
        let cameras = plan(&TestHost::default(), mesh, with).unwrap();
        let names: Vec<String> = cameras.sensors.iter().map(|sensor| sensor.name.clone()).collect();
        assert!(cameras.images.iter().all(|image| image.sensor < names.len()));
        (names, cameras.images[1].sensor)
    };
    let face = || face(Frame::Wall);
    assert_eq!(sensors(face(), &json!({})), (vec!["left".to_owned(), "right".to_owned()], 1));
    assert_eq!(sensors(face(), &json!({"bodies": "one"})), (vec!["camera".to_owned()], 0));
    assert_eq!(sensors(headland(), &nobbys(&json!({}))), (vec!["camera".to_owned()], 0));
    assert_eq!(sensors(headland(), &nobbys(&json!({"bodies": "each"}))).0.len(), 80);
}

fn nobbys(more: &Value) -> Value {
    let mut with = json!({"block": "strips", "width_px": 5472, "height_px": 3648, "focal_mm": 8.8, "pixel_um": 2.41,
        "gsd_m": 0.005, "columns": 10, "rows": 8, "directions_deg": [[0, -15]]});
    with.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
    with
}

/// A face of 40 x 22 m.
fn headland() -> Mesh {
    rockface_core::testing::height_mesh(80, [-20.0, 20.0, -11.0, 11.0], |x, _| {
        0.3 * rockface_core::numerics::portable_math::sin(x)
    })
}

#[test]
fn the_uav_block_of_the_paper_has_its_figures() {
    let host = TestHost::default();
    let cameras = plan(&host, headland(), &nobbys(&json!({}))).unwrap();
    assert_eq!(cameras.images.len(), 80);
    assert!((host.metric("gsd").unwrap() - 0.005).abs() < 1e-12);
    // 20 % of 27.36 m at f = 3651 px from 18.26 m.
    assert!((cameras.images[1].centre_m[0] - cameras.images[0].centre_m[0] - 0.2 * 5472.0 * 0.005).abs() < 1e-9);
    assert!(host.metric("share_of_face_in_two").unwrap() > 0.999);
    let views = host.metric("images_of_a_point").unwrap();
    assert!((15.0..30.0).contains(&views), "{views}");
    let covering = nobbys(&json!({"columns": null, "rows": null, "directions_deg": [[0, 0]]}));
    // 40 m / 5.472 m and 22 m / 3.648 m, both ends stood on.
    assert_eq!(plan(&host, headland(), &covering).unwrap().images.len(), 9 * 8);
}

#[test]
fn a_flight_is_never_repeated_and_a_station_is() {
    let with =
        nobbys(&json!({"position_sigma_m": [0.3, 0.3, 0.3], "pointing_sigma_deg": [1, 1, 1], "follow": "terrain"}));
    let fly = |seed| plan(&TestHost::seeded(seed), headland(), &with).unwrap();
    let (pre, post) = (fly(1), fly(2));
    assert_eq!(pre, fly(1));
    let rms = |axis: usize| {
        let squares = pre.images.iter().zip(&post.images).map(|(a, b)| {
            let d = a.centre_m[axis] - b.centre_m[axis];
            d * d
        });
        (squares.sum::<f64>() / 80.0).sqrt()
    };
    // Two draws of 0.3 m: 0.42 m apart, known to 8 % from 80 images.
    assert!((0..3).all(|axis| (rms(axis) / 0.424 - 1.0).abs() < 0.3));
    assert!(PlanSurvey::draws(&PlanSurveyParams::decode(&with).unwrap()));
    assert!(!PlanSurvey::draws(&PlanSurveyParams::default()));
    assert_eq!(
        plan(&TestHost::seeded(1), face(Frame::Wall), &json!({})).unwrap(),
        plan(&TestHost::seeded(2), face(Frame::Wall), &json!({})).unwrap()
    );
}

#[test]
fn overlap_gives_the_baseline_of_a_pair() {
    let host = TestHost::default();
    let with = json!({"aim": "parallel", "overlap": 0.6, "gsd_m": 0.002, "width_px": 5000, "height_px": 4000, "focal_px": 10_000});
    let cameras = plan(&host, face(Frame::Wall), &with).unwrap();
    assert!((cameras.images[1].centre_m[0] - cameras.images[0].centre_m[0] - 0.4 * 10.0).abs() < 1e-12);
    assert!((host.metric("base_to_distance").unwrap() - 0.2).abs() < 1e-12);
}

#[test]
fn parameters_that_say_nothing_here_are_faults() {
    let path = |with: Value| PlanSurvey::check(&PlanSurveyParams::decode(&with).unwrap())[0].path.join(".");
    assert_eq!(path(json!({"distance_m": 20, "gsd_m": 0.005})), "gsd_m");
    assert_eq!(path(json!({"baseline_m": 7, "overlap": 0.6})), "overlap");
    assert_eq!(path(json!({"sidelap": 0.6})), "sidelap");
    assert_eq!(path(json!({"block": "strips", "aim": "parallel"})), "aim");
    assert_eq!(path(json!({"block": "strips", "directions_deg": []})), "directions_deg");
    let many = plan(&TestHost::default(), headland(), &json!({"block": "strips", "gsd_m": 1e-5})).unwrap_err();
    assert!(many.message.contains("more than 10000"), "{many}");
}
