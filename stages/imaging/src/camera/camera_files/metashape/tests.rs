//! Tests of Metashape's XML: its formulas written out, chunk units, blocks, and what is refused by name.

use super::*;
use crate::camera::model::{Camera, exponential};
use nalgebra::{Rotation3, Vector3};
use rockface_core::artefact::Covariance;

/// A chunk with a similarity, a sensor with covariance, one without calibration, and three images, one of them aligned.
fn document() -> String {
    let r = Rotation3::from_euler_angles(0.3, -0.2, 1.1).into_inner();
    let s = Rotation3::from_euler_angles(-0.7, 0.4, 0.2).into_inner();
    let rows = |m: &Matrix3<f64>| m.transpose().iter().map(f64::to_string).collect::<Vec<_>>();
    let m = rows(&r);
    let transform = [&m[..3], &["0.5".into()], &m[3..6], &["-0.25".into()], &m[6..], &["2".into()]].concat().join(" ");
    format!(
        "<?xml version=\"1.0\"?><document version=\"1.5.0\"><chunk label=\"Chunk 1\" enabled=\"true\"><sensors next_id=\"2\">
        <sensor id=\"4\" label=\"FC6310\" type=\"frame\"><resolution width=\"60\" height=\"40\"/>
        <calibration type=\"frame\" class=\"initial\"><resolution width=\"60\" height=\"40\"/><f>90</f></calibration>
        <calibration type=\"frame\" class=\"adjusted\"><resolution width=\"60\" height=\"40\"/><f>100</f><cx>1.5</cx><cy>-0.5</cy>
        <b1>0.3</b1><b2>-0.2</b2><k1>-0.1</k1><k2>0.02</k2><k3>0.003</k3><k4>-0.001</k4><p1>0.004</p1><p2>-0.002</p2></calibration>
        <covariance><params>f p1 p2</params><coeffs>4 1 2 1 9 3 2 3 16</coeffs></covariance></sensor>
        <sensor id=\"5\" type=\"frame\"/></sensors>
        <components><component id=\"0\"><transform><rotation>{}</rotation><translation>10 20 30</translation><scale>2.5</scale></transform></component></components>
        <cameras><group id=\"0\"><camera id=\"0\" sensor_id=\"4\" component_id=\"0\" label=\"DJI &amp; 1\"><transform>{transform} 0 0 0 1</transform>
        <rotation_covariance>1 0.1 0.2 0.1 2 0.3 0.2 0.3 3</rotation_covariance><location_covariance>4 0 0 0 1 0 0 0 1</location_covariance></camera></group>
        <camera id=\"1\" sensor_id=\"4\" label=\"b\"/><camera id=\"2\" sensor_id=\"5\" label=\"c\"/></cameras>
        <reference>LOCAL_CS[\"Local\"]</reference></chunk></document>",
        rows(&s).join(" ")
    )
}

#[test]
fn a_point_falls_where_metashapes_formula_puts_it() {
    let file = read(&document(), Frame::World).unwrap();
    assert_eq!(file.warnings, ["2 of 3 images are not aligned or not enabled and are left out: b, c"]);
    let block = &file.cameras;
    assert_eq!((block.images.len(), block.sensors.len(), block.images[0].name.as_str()), (1, 1, "DJI & 1"));
    let local = Vector3::new(0.11, -0.07, 1.3);
    let r = Rotation3::from_euler_angles(0.3, -0.2, 1.1) * local + Vector3::new(0.5, -0.25, 2.0);
    let world = Rotation3::from_euler_angles(-0.7, 0.4, 0.2) * r * 2.5 + Vector3::new(10.0, 20.0, 30.0);
    let (x, y) = (local.x / local.z, local.y / local.z);
    let r2: f64 = x * x + y * y;
    let radial = 1.0 - 0.1 * r2 + 0.02 * r2 * r2 + 0.003 * r2 * r2 * r2 - 0.001 * r2 * r2 * r2 * r2;
    let xd = x * radial + 0.004 * (r2 + 2.0 * x * x) + 2.0 * -0.002 * x * y;
    let yd = y * radial - 0.002 * (r2 + 2.0 * y * y) + 2.0 * 0.004 * x * y;
    let (u, v) = (30.0 + 1.5 + 100.0 * xd + 0.3 * xd - 0.2 * yd, 20.0 - 0.5 + 100.0 * yd);
    let [a, b] = Camera::new(&block.sensors[0], &block.images[0]).project(&world).unwrap();
    assert!((a + 0.5 - u).abs() < 1e-12 && (b + 0.5 - v).abs() < 1e-12, "{a} {b} for {u} {v}");
}

fn block(covariance: &Covariance, names: &[&str]) -> Vec<Vec<f64>> {
    let at = |name: &&str| covariance.parameters.iter().position(|p| p == name).unwrap();
    names.iter().map(|i| names.iter().map(|j| covariance.matrix[at(i)][at(j)]).collect()).collect()
}

#[test]
fn blocks_turn_into_world_units_and_our_names() {
    let covariance = read(&document(), Frame::World).unwrap().covariance.unwrap();
    let own = |name: &str| format!("DJI & 1.{name}");
    let expected = ["rx", "ry", "rz", "X", "Y", "Z", "f", "p1", "p2"].map(own);
    assert_eq!(covariance.parameters, expected);
    assert!(!covariance.full_joint);
    let names = expected.each_ref().map(String::as_str);
    assert_eq!(block(&covariance, &names[..3])[1], [0.1, 2.0, 0.3]);
    // Our p1 is its p2.
    assert_eq!(block(&covariance, &names[6..]), [[4.0, 2.0, 1.0], [2.0, 16.0, 3.0], [1.0, 3.0, 9.0]]);
    let turn = Rotation3::from_euler_angles(-0.7, 0.4, 0.2).into_inner() * 2.5;
    let found = block(&covariance, &names[3..6]);
    let world = turn * Matrix3::from_diagonal(&Vector3::new(4.0, 1.0, 1.0)) * turn.transpose();
    assert!((0..3).all(|i| (0..3).all(|j| (found[i][j] - world[(i, j)]).abs() < 1e-12)));
    assert!(covariance.matrix[0][3].to_bits() == 0);
}

#[test]
fn a_covariance_of_nothing_that_can_be_held_is_no_block() {
    let edited = document().replace("f p1 p2", "k5").replace("4 1 2 1 9 3 2 3 16", "0");
    let covariance = read(&edited, Frame::World).unwrap().covariance.unwrap();
    assert_eq!(covariance.parameters.len(), 6, "those of the image");
}

#[test]
fn a_turn_about_its_own_axes_is_ours_with_the_sign_turned() {
    let r = Rotation3::from_euler_angles(0.3, -0.2, 1.1).into_inner();
    let turn = Vector3::new(1e-3, -2e-3, 5e-4);
    let theirs = (r * exponential(&turn)).transpose();
    let ours = exponential(&-turn) * r.transpose();
    assert!((theirs - ours).norm() < 1e-15);
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let says = |from: &str, to: &str, text: &str| {
        let edited = document().replacen(from, to, 1);
        assert_ne!(edited, document(), "{from}");
        let message = read(&edited, Frame::World).unwrap_err().message;
        assert!(message.contains(text), "{message}");
    };
    says("<k4>-0.001</k4>", "<p3>0.1</p3>", "sensor 4: p3 = 0.1: a term that Brown-Conrady");
    says("type=\"frame\" class=\"adjusted\"", "type=\"fisheye\" class=\"adjusted\"", "sensor 4 is of type `fisheye`");
    says("sensor_id=\"4\" component_id", "sensor_id=\"5\" component_id", "sensor 5 has no <calibration>, yet");
    says("sensor_id=\"4\" component_id", "sensor_id=\"9\" component_id", "names sensor 9");
    says("<f>100</f>", "<fx>100</fx>", "an old PhotoScan");
    says("<f>100</f>", "<f>wide</f>", "`wide` is not a number");
    says(" 0 0 0 1</transform>", "</transform>", "12 numbers, 16 are needed");
    says("<scale>2.5", "<scale>0", "a scale of 0");
    says("4 1 2 1 9 3 2 3 16", "4 1 2 1", "3 parameters need a square");
    says("<params>f p1 p2", "<params>f p4 p2", "the parameter `p4`");
    says("<sensor id=\"5\"", "<sensor id=\"4\"", "two sensors have the id 4");
    says("60\" height=\"40\"/>\n", "50\" height=\"40\"/>\n", "is another than that of its <sensor>");
    says("</chunk>", "</chunk><chunk label=\"Chunk 2\"/>", "2 chunks (Chunk 1, Chunk 2)");
    says("</document>", "", "not valid XML");
}

#[test]
fn images_that_follow_another_of_their_rig_are_named_as_such() {
    let rig = document().replace("<camera id=\"1\"", "<camera id=\"1\" master_id=\"0\"");
    let warnings = read(&rig, Frame::World).unwrap().warnings;
    assert!(warnings[1].contains("1 of these are images of a rig"), "{warnings:?}");
}

#[test]
fn unknown_scale_is_warned_of_and_geocentric_centres_are_told() {
    let without = document().replace(" component_id=\"0\"", "");
    let file = read(&without, Frame::World).unwrap();
    assert!(file.warnings.len() == 2 && file.warnings[1].contains("of unknown scale"), "{:?}", file.warnings);
    let geographic = document().replace("LOCAL_CS[\"Local\"", "GEOGCS[\"WGS 84\"");
    let file = read(&geographic, Frame::World).unwrap();
    assert!(
        file.warnings.len() == 2 && file.warnings[1].contains("from the surface of the Earth"),
        "{:?}",
        file.warnings
    );
    assert_eq!((file.stated, file.geocentric), (None, None));
    let file = read(&geographic.replace("10 20 30", "4397854 602431 4565873"), Frame::World).unwrap();
    assert_eq!((file.warnings.len(), file.stated), (1, None));
    assert_eq!(file.geocentric.unwrap().kind, Kind::Geographic);
}

#[test]
fn a_rolling_shutter_is_warned_of_unless_it_is_off() {
    let with = |within: &str, element: &str| document().replacen(within, &format!("{element}{within}"), 1);
    let of = |text: &str| {
        let warnings = read(text, Frame::World).unwrap().warnings;
        warnings.into_iter().find(|warning| warning.contains("rolling shutter"))
    };
    assert_eq!(of(&document()), None);
    let identity = "<rolling_shutter>1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1</rolling_shutter>";
    for on in [
        "<rolling_shutter>full</rolling_shutter>",
        "<rolling_shutter/>",
        "<property name=\"rolling_shutter\" value=\"true\"/>",
        "<shutter rolling_shutter_model=\"regularized\"/>",
    ] {
        assert!(of(&with("<calibration", on)).unwrap().contains("of sensor 4"), "{on}");
    }
    let moved = identity.replace("0 0 0 1<", "0 0.02 0 1<");
    assert!(of(&with("<rotation_covariance", &moved)).unwrap().contains("of 1 images"));
    assert_eq!(of(&with("<rotation_covariance", identity)), None);
    for off in [
        "<rolling_shutter>0</rolling_shutter>",
        "<rolling_shutter enabled=\"false\"/>",
        "<property name=\"rolling_shutter\" value=\"false\"/>",
        "<property name=\"rolling_shutter_model\" value=\"Disabled\"/>",
    ] {
        assert_eq!(of(&with("<calibration", off)), None, "{off}");
    }
}

#[test]
fn images_of_one_label_are_named_apart_and_come_back_from_a_file_of_ours() {
    let camera = |group: &str, id: usize, label: &str| {
        let transform = format!("<transform>1 0 0 {id} 0 1 0 0 0 0 1 0 0 0 0 1</transform>");
        let camera =
            format!("<camera id=\"{id}\" sensor_id=\"4\" component_id=\"0\" label=\"{label}\">{transform}</camera>");
        if group.is_empty() { camera } else { format!("<group id=\"{id}\" label=\"{group}\">{camera}</group>") }
    };
    let names = |cameras: &[String]| {
        let (head, rest) = document().split_once("<cameras>").map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
        let tail = rest.split_once("</cameras>").unwrap().1;
        let file = read(&format!("{head}<cameras>{}</cameras>{tail}", cameras.concat()), Frame::World).unwrap();
        let again = read(std::str::from_utf8(&write(&file.cameras, None).unwrap()).unwrap(), Frame::World).unwrap();
        assert!(again.warnings.is_empty());
        let names = |file: &CameraFile| file.cameras.images.iter().map(|image| image.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&again), names(&file));
        (names(&file), file.warnings)
    };
    let (found, warnings) = names(&[camera("one", 0, "DJI_1"), camera("two", 1, "DJI_1"), camera("two", 2, "DJI_2")]);
    assert_eq!(found, ["one_DJI_1", "two_DJI_1", "DJI_2"]);
    assert!(warnings.len() == 1 && warnings[0].contains("`DJI_1` (one_DJI_1, two_DJI_1)"), "{warnings:?}");
    let (found, _) = names(&[camera("", 0, "DJI_1"), camera("two", 1, "DJI_1")]);
    assert_eq!(found, ["DJI_1", "two_DJI_1"]);
    let (found, warnings) = names(&[camera("two", 7, "DJI_1"), camera("two", 17, "DJI_1"), camera("", 3, "b")]);
    assert_eq!(found, ["DJI_1#7", "DJI_1#17", "b"]);
    assert!(warnings[0].contains("rename the photos in Metashape"), "{warnings:?}");
    // The name with the group is that of another image already.
    let (found, _) = names(&[camera("two", 0, "a"), camera("", 1, "a"), camera("", 2, "two_a")]);
    assert_eq!(found, ["a#0", "a#1", "two_a"]);
    let (found, _) = names(&[camera("", 0, "a"), camera("", 1, "a"), camera("", 2, "a#0")]);
    assert_eq!(found, ["a#0#", "a#1", "a#0"]);
    assert_eq!(names(&[camera("x", 0, "a"), camera("y", 1, "b")]), (vec!["a".to_owned(), "b".to_owned()], Vec::new()));
}
