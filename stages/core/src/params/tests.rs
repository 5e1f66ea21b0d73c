//! Declared parameters are read, checked and written back; faults name their place.

use serde_json::{Value, json};

use super::*;
use crate::{choice, params, union};

choice! {
    /// A shape.
    pub enum Shape {
        /// Round.
        Round = "round",
        /// Not round.
        Square = "square",
    }
}

params! {
    /// A sample.
    pub struct Sample {
        /// Cell size.
        cell_m: f64 = 0.5; Range::Positive,
        /// How many.
        count: u32 = 3,
        /// Its shape.
        shape: Shape = Shape::Round,
        /// A corner.
        corner_m: Option<[f64; 2]> = None,
        /// A file.
        path: FileRef,
    }
}

#[test]
fn default_is_what_an_empty_map_gives() {
    assert_eq!(Disc::default(), Disc::decode(&json!({})).unwrap());
    assert_eq!(Framed::default(), Framed::decode(&json!({})).unwrap());
    assert_eq!(Framed::default().lettering, Lettering { height_mm: 2.5 });
}

#[test]
fn defaults_are_filled_in_and_canonical() {
    let sample = Sample::decode(&json!({"path": "a.ply", "cell_m": 1})).unwrap();
    assert_eq!(
        sample.encode().to_string(),
        r#"{"cell_m":1.0,"corner_m":null,"count":3,"path":"a.ply","shape":"round"}"#
    );
    assert_eq!(Sample::decode(&sample.encode()).unwrap(), sample);
}

#[test]
fn a_number_is_one_however_it_is_written() {
    let free = |value: Value| Value::decode(&value).unwrap().encode().to_string();
    for one in [json!(1), json!(1.0), serde_json::from_str("1e0").unwrap()] {
        assert_eq!((free(one.clone()), f64::decode(&one).unwrap().encode()), ("1".to_owned(), json!(1.0)));
        assert_eq!(u32::decode(&one).unwrap().encode(), json!(1));
    }
    assert_eq!(free(json!({"a": [-0.0, 0.5, 1e300, -7.0], "b": "1.0"})), r#"{"a":[0,0.5,1e+300,-7],"b":"1.0"}"#);
    assert_eq!(free(json!(u64::MAX)), u64::MAX.to_string());
}

#[test]
fn every_fault_is_reported_with_its_place() {
    let faults = Sample::decode(&json!({"cell_m": -1, "shape": "roun", "corner_m": [1, "x"], "cel_m": 1})).unwrap_err();
    let places: Vec<_> = faults.iter().map(|f| f.path.join(".")).collect();
    assert_eq!(places, ["cell_m", "shape", "corner_m.1", "", "cel_m"]);
    assert!(faults[3].message.contains("`path` (file) is missing"));
}

params! {
    /// What all labels have.
    pub struct Lettering {
        /// Height of its letters.
        height_mm: f64 = 2.5; Range::Positive,
    }
}

params! {
    /// A label.
    pub struct Label {
        ..lettering: Lettering,
        /// What it says.
        text: String,
    }
}

params! {
    /// A framed label.
    pub struct Framed {
        ..lettering: Lettering,
        /// Corners of the frame.
        corners: Vec<f64> = vec![0.0, 1.0],
    }
}

#[test]
fn a_part_in_common_has_its_keys_beside_the_others() {
    let label = Label::decode(&json!({"text": "a", "height_mm": 3})).unwrap();
    assert_eq!((label.lettering.height_mm, label.encode()), (3.0, json!({"text": "a", "height_mm": 3.0})));
    assert_eq!(Label::fields().iter().map(|field| field.name).collect::<Vec<_>>(), ["text", "height_mm"]);
    let places = |value| Label::decode(&value).unwrap_err().into_iter().map(|f| f.path.join(".")).collect::<Vec<_>>();
    assert_eq!(places(json!({"text": "a", "height_mm": -1, "lettering": 1})), ["height_mm", "lettering"]);
}

params! {
    /// A disc.
    pub struct Disc {
        /// Its radius.
        radius_m: f64 = 1.0; Range::Positive,
    }
}

params! {
    /// A file.
    pub struct Given {
        /// Its path.
        path: FileRef,
    }
}

union! {
    /// What to draw.
    pub enum Figure {
        /// A disc.
        Disc(Disc) = "disc",
        /// What a file holds.
        Given(Given) = "given",
    }
}

#[test]
fn a_union_is_told_by_its_key_and_a_bare_word_takes_the_defaults() {
    let disc = Figure::decode(&json!({"disc": {"radius_m": 2}})).unwrap();
    assert_eq!(disc, Figure::Disc(Disc { radius_m: 2.0 }));
    assert_eq!(disc.encode(), json!({"disc": {"radius_m": 2.0}}));
    for short in [json!("disc"), json!({"disc": null}), json!({"disc": {}})] {
        assert_eq!(Figure::decode(&short).unwrap(), Figure::Disc(Disc { radius_m: 1.0 }));
    }
}

#[test]
fn faults_of_a_union_name_their_place() {
    let fault = |value: Value| Figure::decode(&value).unwrap_err().remove(0);
    assert_eq!(fault(json!({"disc": {"radius_m": -2}})).path, ["disc", "radius_m"]);
    assert!(fault(json!("given")).message.contains("`path` (file) is missing"));
    let unknown = fault(json!({"disk": {}}));
    assert_eq!((unknown.path.as_slice(), unknown.at_key), (&["disk".to_owned()][..], true));
    assert_eq!(unknown.known, ["disc", "given"]);
    assert!(fault(json!({"disc": {}, "given": {}})).message.contains("exactly one"));
    assert!(fault(json!(3)).message.contains("found the number 3"));
}

#[test]
fn the_catalogue_knows_names_docs_and_defaults() {
    let fields = Sample::fields();
    assert_eq!(fields[0].doc, "Cell size.");
    assert_eq!(fields[1].default, Some(json!(3)));
    assert_eq!(fields[4].default, None);
}
