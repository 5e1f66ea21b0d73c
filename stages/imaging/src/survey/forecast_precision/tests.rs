//! Tests of `forecast-precision`: textbook figures, the two sites of the paper, and a simulated difference beside the forecast.

use super::*;
use crate::survey::stations::looking;
use rockface_core::artefact::{Artefact, Grid, Sensor};
use rockface_core::numerics::random::Key;
use rockface_core::testing::{TestHost, height_mesh, image_at, run_stage, small_sensor};
use serde_json::{Value, json};

fn normal_pair() -> (Cameras, Mesh) {
    let sensor = Sensor { f: 1000.0, width_px: 1001, height_px: 801, cx: 500.0, cy: 400.0, ..small_sensor() };
    let image = |name: &str, x: f64| image_at(name, [x, 0.0, 20.0], [0.0; 3]);
    let images = vec![image("a", -2.0), image("b", 2.0)];
    (Cameras { frame: Frame::Wall, sensors: vec![sensor], images }, height_mesh(40, [-6.0, 6.0, -4.0, 4.0], |_, _| 0.0))
}

fn forecast(
    host: &TestHost,
    with: &Value,
    (cameras, mesh): (Cameras, Mesh),
    more: &[(&str, Artefact)],
) -> Result<(Table, Raster), StageError> {
    let mut inputs = vec![("cameras", Artefact::Cameras(cameras)), ("mesh", Artefact::Mesh(mesh))];
    inputs.extend(more.iter().cloned());
    let mut made = run_stage::<ForecastPrecision>(host, with, &inputs)?.into_inner();
    match (made.remove("table"), made.remove("raster")) {
        (Some(Artefact::Table(table)), Some(Artefact::Raster(raster))) => Ok((table, raster)),
        other => panic!("{other:?}"),
    }
}

fn cell(table: &Table, row: usize, column: &str) -> Option<f64> {
    table.rows[row][table.column(column).unwrap()].number()
}

#[test]
fn a_normal_pair_has_the_textbook_figures() {
    let with =
        json!({"sigma_local_px": 0.6, "sigma_regular_px": 0.8, "variance": "mean", "cell_m": 0.02, "map_cell_m": 0.5});
    let host = TestHost::default();
    let (table, raster) = forecast(&host, &with, normal_pair(), &[]).unwrap();
    assert_eq!(table.rows.len(), 2);
    assert_eq!(table.rows[0][0].text(), Some("a+b"));
    let figure = |column: &str| cell(&table, 0, column).unwrap();
    assert!((figure("gsd_m") - 0.02).abs() < 1e-12 && (figure("base_to_distance") - 0.2).abs() < 1e-12);
    // Z^2 / (B f) = 0.1 m a pixel; 1 px of disparity noise. Off the middle rays are oblique: a little more.
    assert!((figure("sigma_z_m") / 0.1 - 1.0).abs() < 0.02, "{}", figure("sigma_z_m"));
    assert!((figure("lod95_m") - 1.96 * 2f64.sqrt() * figure("sigma_z_m")).abs() < 1e-12);
    assert_eq!(cell(&table, 1, "simulated_std_m"), None);
    assert_eq!(
        raster.bands.iter().map(|band| band.name.as_str()).collect::<Vec<_>>(),
        ["images", "gsd_m", "sigma_z_m", "lod95_m"]
    );
    let middle = 8 * raster.grid.columns + 12;
    assert!((raster.bands[0].values[middle] - 2.0).abs() < 1e-6 && (raster.bands[2].values[middle] - 0.1).abs() < 1e-3);
}

#[test]
fn the_sites_of_the_paper_are_forecast_as_it_reports_them() {
    // Hunter Valley: LoD95 of 3 cm and differences of 15.6 mm from 2 cm cells; sigmas of Table 1.
    let sensor = Sensor { width_px: 8256, height_px: 5504, f: 19_540.0, cx: 4127.5, cy: 2751.5, ..small_sensor() };
    let image = |name: &str, x: f64| looking(name, Vector3::new(x, 0.0, 87.0), Vector3::zeros());
    let images = vec![image("left", -16.3), image("right", 16.3)];
    let station = Cameras { frame: Frame::Wall, sensors: vec![sensor], images };
    let mesh = height_mesh(40, [-17.0, 17.0, -11.0, 11.0], |_, _| 0.0);
    let host = TestHost::default();
    let with = json!({"sigma_local_px": 0.7, "sigma_regular_px": 0.7, "cell_m": 0.02, "map_cell_m": 2});
    forecast(&host, &with, (station.clone(), mesh.clone()), &[]).unwrap();
    assert!((host.metric("gsd").unwrap() - 0.0045).abs() < 1e-4);
    let cells = host.metric("sigma_z").unwrap() * 2f64.sqrt();
    forecast(
        &host,
        &json!({"sigma_local_px": 0.7, "sigma_regular_px": 0.7, "cell_m": 1e-4, "map_cell_m": 2}),
        (station, mesh),
        &[],
    )
    .unwrap();
    let pixels = host.metric("sigma_z").unwrap() * 2f64.sqrt();
    println!("differences of {:.2} mm by cell, {:.2} mm by pixel", 1000.0 * cells, 1000.0 * pixels);
    // The simulation gives 10.9 mm for means of 2 cm cells and 15.2 mm a pixel.
    assert!((cells - 0.0109).abs() < 0.0012, "{cells}");
    assert!((pixels - 0.0152).abs() < 0.0012, "{pixels}");
}

#[test]
fn orientation_errors_add_and_a_difference_is_compared() {
    let names = ["a.rx", "a.ry", "a.rz", "b.rx", "b.ry", "b.rz"];
    let element = |i: usize, j: usize| if i == j { 1e-8 } else { 0.0 };
    let covariance = Covariance {
        frame: Frame::Wall,
        parameters: names.map(str::to_owned).to_vec(),
        matrix: (0..6).map(|i| (0..6).map(|j| element(i, j)).collect()).collect(),
        sigma0_applied: true,
        full_joint: true,
    };
    let grid = Grid { columns: 100, rows: 100, cell_m: 0.02, left_m: -1.0, top_m: 1.0 };
    let field = Key([9; 32]).field();
    let noise = (0..10_000).map(|i| 0.05 * field.normal(i % 100, i / 100) as f32).collect();
    let difference = Raster::single(grid, Frame::Wall, "difference", "difference", noise);
    let more = [("covariance", Artefact::Covariance(covariance)), ("difference", Artefact::Raster(difference))];
    let with = json!({"sigma_local_px": 0.0, "sigma_regular_px": 0.1, "variance": "mean"});
    let host = TestHost::default();
    let (table, _) = forecast(&host, &with, normal_pair(), &more).unwrap();
    let (matching, orientation) =
        (cell(&table, 1, "sigma_matching_m").unwrap(), cell(&table, 1, "sigma_orientation_m").unwrap());
    assert!(orientation > 1e-4 && orientation < matching, "{orientation} {matching}");
    let total = (matching * matching + orientation * orientation).sqrt();
    assert!((cell(&table, 1, "sigma_z_m").unwrap() - total).abs() < 1e-12);
    assert_eq!(cell(&table, 1, "simulated_std_m"), None);
    assert_eq!(table.rows[2][0].text(), Some("all images, where the difference has values"));
    let simulated = cell(&table, 2, "simulated_std_m").unwrap();
    assert!((simulated - 0.05).abs() < 0.002);
    let there = cell(&table, 2, "sigma_z_m").unwrap();
    assert!(there <= total, "the middle of the face is no worse: {there} {total}");
    let ratio = host.metric("simulated_to_forecast").unwrap();
    assert!((ratio - simulated / (2f64.sqrt() * there)).abs() < 1e-9, "{ratio}");
}

/// Three images in a row: the middle of the face is in all of them, its ends in two, of which the left pair has a third of the baseline.
#[test]
fn a_difference_of_a_part_is_held_against_the_forecast_of_that_part() {
    let sensor = Sensor { f: 1000.0, width_px: 601, height_px: 801, cx: 300.0, cy: 400.0, ..small_sensor() };
    let image = |name: &str, x: f64| image_at(name, [x, 0.0, 20.0], [0.0; 3]);
    let images = vec![image("a", -4.0), image("b", -3.0), image("c", 3.0), image("d", 6.0)];
    let face = height_mesh(60, [-9.0, 9.0, -2.0, 2.0], |_, _| 0.0);
    let block =
        || (Cameras { frame: Frame::Wall, sensors: vec![sensor.clone()], images: images.clone() }, face.clone());
    let grid = Grid { columns: 20, rows: 20, cell_m: 0.1, left_m: 4.0, top_m: 1.0 };
    let values = (0..400).map(|i| if i % 20 < 10 { 0.01 * (i % 3) as f32 } else { f32::NAN }).collect();
    let difference = Raster::single(grid, Frame::Wall, "difference", "difference", values);
    let host = TestHost::default();
    let more = [("difference", Artefact::Raster(difference.clone()))];
    let (table, _) = forecast(&host, &json!({"sigma_regular_px": 0.0}), block(), &more).unwrap();
    let (all, there) = (table.rows.len() - 2, table.rows.len() - 1);
    let sigma = |row: usize| cell(&table, row, "sigma_z_m").unwrap();
    assert!(sigma(all) > 1.5 * sigma(there), "{} {}", sigma(all), sigma(there));
    assert!(cell(&table, all, "median_lod95_m").unwrap() < cell(&table, all, "lod95_m").unwrap());
    // The same by the window, whose raster ends where it does.
    let window = json!({"sigma_regular_px": 0.0, "map_cell_m": 0.25, "window_m": [4, 5, -1, 1]});
    let (cut, raster) = forecast(&host, &window, block(), &[]).unwrap();
    assert!((cell(&cut, cut.rows.len() - 1, "sigma_z_m").unwrap() / sigma(there) - 1.0).abs() < 0.05);
    assert!(raster.grid.columns <= 5 && raster.grid.rows <= 9, "{:?}", raster.grid);
    // Between the vertices of a coarse mesh too.
    let coarse = height_mesh(2, [-9.0, 9.0, -2.0, 2.0], |_, _| 0.0);
    let (cut, _) = forecast(&host, &window, (block().0, coarse), &[]).unwrap();
    assert!((cell(&cut, cut.rows.len() - 1, "sigma_z_m").unwrap() / sigma(there) - 1.0).abs() < 0.05);
    let error = forecast(&host, &json!({"window_m": [40, 50, -1, 1]}), block(), &[]).unwrap_err();
    assert!(error.message.contains("window_m"), "{error}");
    let elsewhere = Raster { grid: Grid { left_m: 40.0, ..grid }, ..difference };
    let error = forecast(&host, &json!({}), block(), &[("difference", Artefact::Raster(elsewhere))]).unwrap_err();
    assert!(error.message.contains("where the difference has values"), "{error}");
}

#[test]
fn what_cannot_be_forecast_says_why() {
    let (mut cameras, mesh) = normal_pair();
    let away = height_mesh(4, [100.0, 104.0, 0.0, 2.0], |_, _| 0.0);
    let host = TestHost::default();
    let error = forecast(&host, &json!({}), (cameras.clone(), away), &[]).unwrap_err();
    assert!(error.message.contains("in two images"), "{error}");
    let pairs = Pairs {
        pairs: vec![rockface_core::artefact::Pair {
            name: "a+c".into(),
            first: "a".into(),
            second: "c".into(),
            baseline_m: 4.0,
            distance_m: 20.0,
            convergence_rad: 0.0,
            overlap: 0.5,
        }],
    };
    let error =
        forecast(&host, &json!({}), (cameras.clone(), mesh.clone()), &[("pairs", Artefact::Pairs(pairs))]).unwrap_err();
    assert!(error.message.contains("no image `c`"), "{error}");
    cameras.frame = Frame::World;
    assert!(forecast(&host, &json!({}), (cameras, mesh), &[]).unwrap_err().message.contains("world frame"));
}
