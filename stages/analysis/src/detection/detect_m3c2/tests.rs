//! Tests of `detect-m3c2` on niches, bumps and clouds whose volumes are known.

use serde_json::json;

use super::*;
use rockface_core::artefact::Inventory;
use rockface_core::testing::{TestHost, height_mesh, run_stage};

#[test]
fn a_box_shaped_niche_is_found_with_its_volume() {
    let plane = height_mesh(100, [-1.0, 1.0, -1.0, 1.0], |_, _| 0.0);
    let inside = |x: f64, y: f64| x.abs() < 0.3 && y.abs() < 0.2;
    let niche = height_mesh(100, [-1.0, 1.0, -1.0, 1.0], |x, y| if inside(x, y) { -0.1 } else { 0.0 });
    let with = json!({"projection_radius_m": 0.03, "normal_radii_m": [0.1], "core_spacing_m": 0.04});
    let inputs = [("reference", plane.clone().into()), ("comparison", niche.clone().into())];
    let made = run_stage::<DetectM3c2>(&TestHost::default(), &with, &inputs).unwrap().into_inner();
    let Artefact::Inventory(found) = &made["detections"] else { panic!("no inventory") };
    let number = |found: &Inventory, name: &str| found.numbers(name).unwrap()[0].unwrap();
    assert_eq!(found.features.len(), 1);
    assert!((number(found, "volume_m3") / 0.024 - 1.0).abs() < 0.1, "{}", number(found, "volume_m3"));
    assert!((number(found, "depth_max_m") - 0.1).abs() < 1e-9 && number(found, "score") > 9.0);
    let gain = json!({"change": "gain", "projection_radius_m": 0.03, "normal_radii_m": [0.1], "core_spacing_m": 0.04});
    let inputs = [("reference", plane.into()), ("comparison", niche.into())];
    let made = run_stage::<DetectM3c2>(&TestHost::default(), &gain, &inputs).unwrap().into_inner();
    let Artefact::Inventory(found) = &made["detections"] else { panic!("no inventory") };
    assert!(found.features.is_empty());
}

#[test]
fn a_bump_on_a_slab_and_a_slanted_step_have_their_volumes() {
    // A paraboloid of half axes 0.4 and 0.3 m falls off, down to the slab.
    let bump = |height_m: f64, tilt: f64| {
        height_mesh(160, [-0.8, 0.8, -0.8, 0.8], move |x, y| {
            let beyond = (x / 0.4) * (x / 0.4) + (y / 0.3) * (y / 0.3);
            tilt * x + height_m * (1.0 - beyond).max(0.0)
        })
    };
    let volume = |before: rockface_core::artefact::Mesh, after: rockface_core::artefact::Mesh, change: &str| {
        let with = json!({"projection_radius_m": 0.02, "normal_radii_m": [0.04], "core_spacing_m": 0.02, "registration_m": 0, "min_lod_m": 0.003,
            "change": change});
        let inputs = [("reference", before.into()), ("comparison", after.into())];
        let made = run_stage::<DetectM3c2>(&TestHost::default(), &with, &inputs).unwrap().into_inner();
        let Artefact::Inventory(found) = &made["detections"] else { panic!("no inventory") };
        found.numbers("volume_m3").unwrap().into_iter().flatten().sum::<f64>()
    };
    for (height_m, tilt) in [(0.15, 0.0), (0.3, 0.0), (0.15, 0.5)] {
        let truth = 0.5 * std::f64::consts::PI * 0.4 * 0.3 * height_m;
        let lost = volume(bump(height_m, tilt), bump(0.0, tilt), "loss");
        assert!((lost / truth - 1.0).abs() < 0.1, "{height_m} {tilt}: {lost} of {truth}");
        let gained = volume(bump(0.0, tilt), bump(height_m, tilt), "gain");
        assert!((gained / truth - 1.0).abs() < 0.1, "{height_m} {tilt}: gain of {gained} of {truth}");
    }
}

#[test]
fn a_niche_that_is_deeper_than_the_cylinders_is_warned_of() {
    let inside = |x: f64, y: f64| x.abs() < 0.3 && y.abs() < 0.3;
    let plane = height_mesh(80, [-1.0, 1.0, -1.0, 1.0], |_, _| 0.0);
    let niche = height_mesh(80, [-1.0, 1.0, -1.0, 1.0], |x, y| if inside(x, y) { -0.8 } else { 0.0 });
    let warnings = |depth_m: f64| {
        let host = TestHost::default();
        let with =
            json!({"projection_radius_m": 0.05, "normal_radii_m": [0.1], "core_spacing_m": 0.05, "depth_m": depth_m});
        run_stage::<DetectM3c2>(
            &host,
            &with,
            &[("reference", plane.clone().into()), ("comparison", niche.clone().into())],
        )
        .unwrap();
        host.warnings()
    };
    assert_eq!(warnings(1.0), Vec::<String>::new());
    let told = warnings(0.4);
    assert!(told.len() == 1 && told[0].contains("no point of the comparison within `depth_m`, 0.4 m"), "{told:?}");
}

#[test]
fn clouds_that_hardly_meet_are_warned_of() {
    let whole = height_mesh(40, [-1.0, 1.0, -1.0, 1.0], |_, _| 0.0);
    let warnings = |left: f64, right: f64| {
        let part = height_mesh(40, [left, right, -1.0, 1.0], |_, _| 0.0);
        let host = TestHost::default();
        let with = json!({"projection_radius_m": 0.15, "normal_radii_m": [0.2], "core_spacing_m": 0.1});
        let inputs = [("reference", whole.clone().into()), ("comparison", part.into())];
        run_stage::<DetectM3c2>(&host, &with, &inputs).unwrap();
        host.warnings()
    };
    assert_eq!(warnings(-1.0, 1.0), Vec::<String>::new());
    let few = warnings(-1.0, -0.6);
    assert!(few.len() == 1 && few[0].contains("core points have 5 points of both clouds"), "{few:?}");
}

#[test]
fn clouds_that_do_not_meet_are_refused_with_a_way_out() {
    let low = height_mesh(20, [-1.0, 1.0, -1.0, 1.0], |_, _| 0.0);
    let far = height_mesh(20, [8.0, 9.0, -1.0, 1.0], |_, _| 0.0);
    let inputs = [("reference", low.into()), ("comparison", far.into())];
    let error = run_stage::<DetectM3c2>(&TestHost::default(), &json!({}), &inputs).unwrap_err();
    assert!(error.message.contains("core points") && error.hint.unwrap().contains("overlap"));
}

/// Points of a slab with a square niche of half this side, as one grid of points of about some distance, each a little aside of its place.
fn thinned(spacing_m: f64, depth_m: f64, half_m: f64) -> rockface_core::artefact::Cloud {
    let count = (4.0 / spacing_m) as u32;
    let aside = |i: u32| f64::from(i.wrapping_mul(2_654_435_761) >> 8) / f64::from(1u32 << 24) - 0.5;
    let point = |i: u32| {
        let [x, y] = [i % count, i / count].map(|place| (f64::from(place) + 0.5) * spacing_m - 2.0);
        let (x, y) = (x + 0.8 * spacing_m * aside(2 * i), y + 0.8 * spacing_m * aside(2 * i + 1));
        [x, y, if x.abs() < half_m && y.abs() < half_m { -depth_m } else { 0.0 }]
    };
    rockface_core::artefact::Cloud::new(Frame::Wall, (0..count * count).map(point).collect())
}

#[test]
fn core_cells_finer_than_the_points_neither_lose_volume_nor_break_changes_apart() {
    for spacing_m in [0.02, 0.03, 0.05, 0.1] {
        let host = TestHost::default();
        let with =
            json!({"core_spacing_m": spacing_m, "projection_radius_m": 0.12, "normal_radii_m": [0.3], "depth_m": 1});
        let inputs = [("reference", thinned(0.06, 0.0, 0.3).into()), ("comparison", thinned(0.06, 0.3, 0.3).into())];
        let made = run_stage::<DetectM3c2>(&host, &with, &inputs).unwrap().into_inner();
        let Artefact::Inventory(found) = &made["detections"] else { panic!("no inventory") };
        let volume = found.numbers("volume_m3").unwrap().into_iter().flatten().sum::<f64>();
        assert!((volume / 0.108 - 1.0).abs() < 0.25 && found.features.len() == 1, "{spacing_m}: {volume}");
        assert!(host.warnings().is_empty(), "{:?}", host.warnings());
    }
}

#[test]
fn many_cells_that_no_core_point_reaches_are_warned_of_with_a_spacing() {
    let host = TestHost::default();
    let with = json!({"core_spacing_m": 0.05, "projection_radius_m": 0.09, "normal_radii_m": [0.6], "least_points": 2});
    let inputs = [("reference", thinned(0.2, 0.0, 0.3).into()), ("comparison", thinned(0.06, 0.3, 0.3).into())];
    let _ = run_stage::<DetectM3c2>(&host, &with, &inputs);
    let told = host.warnings().join("\n");
    assert!(
        told.contains("of the cells of `core_spacing_m`") && told.contains("enlarge `core_spacing_m` to about"),
        "{told}"
    );
}

/// A core point in the middle of a cell of 1 m, 2 m of loss along a normal.
fn one_core(normal: [f64; 3]) -> Distance {
    Distance { core: [0.5, 0.5, 10.0], normal, distance_m: -2.0, limit_m: 0.5, spreads_m: [0.0; 2], points: [9.0; 2] }
}

#[test]
fn cells_of_faces_along_the_view_count_as_no_steeper_than_five_times_their_plan() {
    let grid = Grid { columns: 1, rows: 1, cell_m: 1.0, left_m: 0.0, top_m: 1.0 };
    let volume = |found: Distance| {
        let cells = CoreCells::new(&[Some(found.core)], &grid, 0.5);
        cluster(&grid, &[0], &[Some(found)], &cells, |found| found.limit_m).volume_m3
    };
    // 3 m along X, at a normal of (0.6, 0, 0.8) the plane falls by 3 x 0.6 / 0.8 m.
    let z_beside = |normal: [f64; 3]| beside(&one_core(normal), (3.5, 0.5))[2];
    for (normal, volume_m3, z_m) in
        [([0.6, 0.0, 0.8], 2.0 / 0.8, 7.75), ([0.96, 0.0, 0.28], 2.0 / 0.28, 10.0 - 2.88 / 0.28)]
    {
        assert!((volume(one_core(normal)) - volume_m3).abs() < 1e-9 && (z_beside(normal) - z_m).abs() < 1e-9);
    }
    let steep = [0.995, 0.0, 0.1];
    assert!((volume(one_core(steep)) - 10.0).abs() < 1e-9, "{}", volume(one_core(steep)));
    assert!((z_beside(steep) - (10.0 - 3.0 * 0.995 / 0.2)).abs() < 1e-9, "{}", z_beside(steep));
}

/// What is found where the comparison has no points within a radius of four places of a niche of 1 m, and the warnings.
fn with_holes(radius_m: f64) -> (f64, f64, Vec<String>) {
    let mut after = thinned(0.06, 0.3, 0.5);
    let is_hole = |[x, y, _]: &[f64; 3]| {
        let (x, y) = (x.abs() - 0.15, y.abs() - 0.15);
        x * x + y * y < radius_m * radius_m
    };
    after.points.retain(|point| !is_hole(point));
    let host = TestHost::default();
    let with = json!({"core_spacing_m": 0.1, "projection_radius_m": 0.12, "normal_radii_m": [0.3], "depth_m": 1});
    let inputs = [("reference", thinned(0.06, 0.0, 0.5).into()), ("comparison", after.into())];
    let made = run_stage::<DetectM3c2>(&host, &with, &inputs).unwrap().into_inner();
    let Artefact::Inventory(found) = &made["detections"] else { panic!("no inventory") };
    let Artefact::Table(summary) = &made["summary"] else { panic!("no summary") };
    let share = summary.rows[0][summary.column("tested_share").unwrap()].number().unwrap();
    (found.numbers("volume_m3").unwrap().into_iter().flatten().sum(), share, host.warnings())
}

#[test]
fn cells_of_core_points_without_a_distance_count_to_the_next_that_has_one() {
    let (whole, share, told) = with_holes(0.0);
    assert!(told.is_empty() && share > 0.99, "{share} {told:?}");
    let (holed, share, told) = with_holes(0.14);
    assert!(
        told.is_empty() && share > 0.99 && (holed / whole - 1.0).abs() < 0.03,
        "{holed} of {whole}, {share} {told:?}"
    );
}

#[test]
fn wide_gaps_of_distances_beside_a_change_are_warned_of() {
    let (_, share, told) = with_holes(0.24);
    assert!(share < 0.99 && told.iter().any(|text| text.contains("without a distance touch the")), "{share} {told:?}");
}
