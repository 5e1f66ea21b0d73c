//! Candidates from specifications: exact sizes, closed meshes, the same block whenever it is asked for.

use serde_json::{Value, json};

use super::*;
use rockface_core::artefact::Part;
use rockface_core::artefact::candidates::HexKey;
use rockface_core::numerics::random::Key;
use rockface_core::params::ParamType;

fn candidates(classes: &Value) -> Candidates {
    Candidates {
        classes: Vec::<Class>::decode(classes).unwrap(),
        wall_from_enu: Some(joints::wall_from_enu(80.0, 180.0)),
        library: Vec::new(),
        key: HexKey(Key([17; 32])),
    }
}

fn solid(block: &Block) -> Solid {
    Solid { vertices: block.vertices.clone(), triangles: block.triangles.clone() }
}

fn one(class: &Value, number: u64) -> Block {
    candidate(&candidates(&json!([class])), number).unwrap()
}

fn noted(block: &Block, name: &str) -> f64 {
    block.parameters.iter().find(|(key, _)| key == name).unwrap_or_else(|| panic!("{name}")).1
}

#[test]
#[allow(clippy::disallowed_methods)]
fn shapes_have_their_textbook_volumes() {
    let check = |shape: Value, expected: f64, tolerance: f64| {
        let block = one(&json!({"shape": shape, "size": {"axes": {"length_m": 2, "height_m": 3, "depth_m": 4}}}), 0);
        let (volume, centroid) = solid(&block).volume_and_centroid();
        assert!(
            (volume / (24.0 * expected) - 1.0).abs() < tolerance,
            "{shape}: {volume}, expected {}",
            24.0 * expected
        );
        assert!(centroid.iter().all(|x| x.abs() < 1e-12), "{shape}: {centroid:?}");
        assert_eq!(solid(&block).check(), Ok(()), "{shape}");
        assert!((noted(&block, "block_volume_m3") - volume).abs() < 1e-12);
    };
    check(json!("prism"), 1.0, 1e-14);
    // A hexagon in its box fills three quarters of it.
    check(json!({"prism": {"sides": 6}}), 0.75, 1e-13);
    check(json!({"pyramid": {}}), 1.0 / 3.0, 1e-13);
    check(json!({"wedge": {"edge": 0.2}}), 0.5, 1e-13);
    // A frustum: (A1 + 4 Am + A2) / 6 of areas 1, 0.8 x 0.65, 0.6 x 0.3.
    check(json!({"trapezoid": {"taper_x": 0.6, "taper_y": 0.3}}), (1.0 + 4.0 * 0.8 * 0.65 + 0.18) / 6.0, 1e-13);
    check(json!({"ellipsoid": {"subdivisions": 5}}), std::f64::consts::PI / 6.0, 2e-3);
}

#[test]
fn a_target_volume_is_hit_exactly_after_the_modifiers() {
    let rough = json!([{"skew": {"xy": 0.3}}, {"rotate": {"x_deg": 20, "y_deg": {"uniform": {"min": 0, "max": 90}}}}, {"roughness": {"sigma_m": 0.01, "edge_m": 0.1}}, {"scale": {"x": 2}}]);
    for shape in ["prism", "ellipsoid", "trapezoid", "pyramid", "wedge", "polyhedron"] {
        let size = json!({"volume": {"volume_m3": {"power_law": {"exponent": 0.6, "min": 0.05, "max": 2}}, "depth_ratio": 0.5}});
        let class = json!({"shape": shape, "size": size, "modifiers": rough});
        for number in 0..5 {
            match candidate(&candidates(&json!([class])), number) {
                Ok(block) => {
                    let wanted = noted(&block, "size.volume_m3");
                    assert!((solid(&block).volume() / wanted - 1.0).abs() < 1e-12, "{shape}");
                }
                Err(error) => assert_eq!(error.reason(), Some("block_self_intersects"), "{shape}: {error}"),
            }
        }
    }
}

#[test]
fn the_classes_of_sneed_and_folk_are_realised() {
    let fields = [
        ("C", 0.7, 1.0, 0.0, 1.0),
        ("CP", 0.5, 0.7, 0.0, 0.33),
        ("CB", 0.5, 0.7, 0.33, 0.67),
        ("CE", 0.5, 0.7, 0.67, 1.0),
        ("P", 0.3, 0.5, 0.0, 0.33),
        ("B", 0.3, 0.5, 0.33, 0.67),
        ("E", 0.3, 0.5, 0.67, 1.0),
        ("VP", 0.0, 0.3, 0.0, 0.33),
        ("VB", 0.0, 0.3, 0.33, 0.67),
        ("VE", 0.0, 0.3, 0.67, 1.0),
    ];
    for (class, low, high, left, right) in fields {
        for number in 0..40 {
            let size = json!({"sneed_folk": {"class": class, "volume_m3": 0.2, "order": "random"}});
            let block = one(&json!({"shape": "ellipsoid", "size": size}), number);
            let mut sides = solid(&block).extent();
            sides.sort_by(f64::total_cmp);
            let [s, i, l] = sides;
            let (flatness, elongation) = (s / l, (l - i) / (l - s));
            let inside = |x: f64, low: f64, high: f64| (low - 1e-9..=high + 1e-9).contains(&x);
            assert!(inside(flatness, low, high) && inside(elongation, left, right), "{class}: {flatness} {elongation}");
            assert!((solid(&block).volume() - 0.2).abs() < 1e-13);
        }
    }
}

#[test]
fn a_block_depends_on_its_number_alone_and_classes_occur_as_often_as_said() {
    let all = candidates(&json!([
        {"name": "rare", "shape": "pyramid", "probability": 1},
        {"name": "common", "shape": "polyhedron", "probability": 3, "modifiers": ["tumble"]},
    ]));
    let forwards: Vec<Block> = (0..400).map(|n| candidate(&all, n).unwrap()).collect();
    let backwards: Vec<Block> = (0..400).rev().map(|n| candidate(&all, n).unwrap()).collect();
    assert!(forwards.iter().eq(backwards.iter().rev()));
    let rare = forwards.iter().filter(|block| block.class == "rare").count();
    assert!((70..=130).contains(&rare), "{rare} of 400, expected 100");
    assert_ne!(forwards[0].parameters, forwards[1].parameters);
}

#[test]
fn roughness_has_the_deviation_and_the_correlation_asked_for() {
    let rough = |correlation_m: f64| {
        let smooth = json!({"shape": "prism", "size": {"axes": {"length_m": 1}}, "edge_m": 0.05});
        let mut rough = smooth.clone();
        rough["modifiers"] = json!([{"roughness": {"sigma_m": 0.002, "correlation_m": correlation_m}}]);
        let (a, b) = (one(&smooth, 0), one(&rough, 0));
        // Inside the +X side every vertex moves along X alone, up to the shift of the centroid.
        let inner = |v: &[f64; 3]| v[0] > 0.4999 && v[1].abs() < 0.45 && v[2].abs() < 0.45;
        let moved = a.vertices.iter().zip(&b.vertices).filter(|(a, _)| inner(a)).map(|(a, b)| b[0] - a[0]);
        let moved: Vec<f64> = moved.collect();
        let mean = moved.iter().sum::<f64>() / moved.len() as f64;
        (moved.iter().map(|d| (d - mean) * (d - mean)).sum::<f64>() / moved.len() as f64).sqrt()
    };
    let white = rough(0.0);
    assert!((white / 0.002 - 1.0).abs() < 0.15, "{white}");
    // Displacements alike over the whole side hardly vary on it.
    let stiff = rough(10.0);
    assert!(stiff < 2e-4, "{stiff}");
}

#[test]
fn what_is_no_solid_is_rejected_with_a_reason() {
    let rough = json!([{"shape": "prism", "edge_m": 0.1, "modifiers": [{"noise": {"sigma_m": 0.2}}]}]);
    let error = candidate(&candidates(&rough), 0).unwrap_err();
    assert_eq!(error.reason(), Some("block_self_intersects"));
    let inverted = json!([{"shape": "prism", "modifiers": [{"skew": {"xy": 2, "yx": 2}}]}]);
    assert_eq!(candidate(&candidates(&inverted), 0).unwrap_err().reason(), Some("block_inverted"));
    let hull = json!([{"shape": "prism", "edge_m": 0.1, "modifiers": [{"noise": {"sigma_m": 0.2}}, "convex_hull"]}]);
    let block = candidate(&candidates(&hull), 0).unwrap();
    assert_eq!(solid(&block).check(), Ok(()));
    let nothing = candidate(&candidates(&json!([{"shape": "library"}])), 0).unwrap_err();
    assert!(nothing.reason().is_none() && nothing.to_string().contains("library"));
    assert!(candidate(&candidates(&json!([{"shape": "prism", "probability": 0}])), 0).is_err());
}

#[test]
fn scanned_blocks_serve_as_a_class() {
    let prism = one(&json!({"shape": "prism", "size": {"axes": {"length_m": 2}}}), 0);
    let mut all =
        candidates(&json!([{"shape": {"library": {"class": "scan"}}, "size": {"volume": {"volume_m3": 0.5}}}]));
    let part = |class: &str| Part {
        name: "a".into(),
        class: class.into(),
        vertices: prism.vertices.iter().map(|v| v.map(|x| x + 7.0)).collect(),
        triangles: prism.triangles.clone(),
    };
    all.library = vec![part("other"), part("scan")];
    let block = candidate(&all, 3).unwrap();
    assert!((noted(&block, "shape.part") - 1.0).abs() < 1e-15);
    assert!((solid(&block).volume() - 0.5).abs() < 1e-14);
    assert!(block.vertices.iter().all(|v| v.iter().all(|x| x.abs() < 0.5)));
}

/// A class of rough, sheared blocks of any size, by shape.
fn rough(shape: usize) -> Value {
    let set = |dip: f64, direction: f64| {
        let spacing = json!({"exponential": {"mean": 0.5, "min": 0.1, "max": 3}});
        json!({"dip_deg": dip, "dip_direction_deg": direction, "fisher_k": 40, "spacing_m": spacing})
    };
    let sets = [set(70.0, 170.0), set(80.0, 260.0), set(30.0, 10.0)];
    let shapes = [
        json!({"prism": {"sides": 5}}),
        json!("ellipsoid"),
        json!("trapezoid"),
        json!("pyramid"),
        json!("wedge"),
        json!({"polyhedron": {"points": 9, "radius": {"uniform": {"min": 0.5, "max": 1}}}}),
        json!({"joint_block": {"sets": sets}}),
        json!({"joint_wedge": {"sets": [set(60.0, 140.0), set(60.0, 220.0)]}}),
        json!("prism"),
    ];
    let angle = json!({"uniform": {"min": 0, "max": 360}});
    json!({"shape": shapes[shape], "modifiers": [
        {"scale": {"factor": {"log_normal": {"median": 1, "sigma": 0.5}}, "z": {"beta": {"a": 2, "b": 2, "min": 0.5, "max": 1.5}}}},
        {"rotate": {"x_deg": angle, "y_deg": angle, "z_deg": angle}},
        {"skew": {"xy": {"normal": {"mean": 0, "sd": 0.2}}, "zx": 0.1}},
        {"roughness": {"sigma_m": 0.01, "edge_m": 0.3}},
    ]})
}

#[test]
fn a_wedge_of_nearly_parallel_joints_is_rejected_and_ends_no_run() {
    let error = candidate(&candidates(&json!([rough(7)])), 59507).unwrap_err();
    assert_eq!(error.reason(), Some("block_too_fine"));
}

proptest::proptest! {
    #[test]
    fn every_candidate_is_closed_and_outward_or_says_why(number in 0u64..1_000_000, shape in 0usize..9) {
        match candidate(&candidates(&json!([rough(shape)])), number) {
            Ok(block) => proptest::prop_assert_eq!(solid(&block).check(), Ok(())),
            Err(error) => proptest::prop_assert!(error.reason().is_some(), "{}", error),
        }
    }
}
