//! A made-up simulator whose parameters `propose-parameters` must find, and one that cannot reach the reference.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde_json::{Value, json};

use super::*;
use crate::noise::mahalanobis::fit;
use rockface_core::artefact::Artefact;
use rockface_core::numerics::random::Key;
use rockface_core::params::ParamType;
use rockface_core::testing::TestHost;

const FEATURES: [&str; 3] = ["nugget_m2", "sill_m2", "range95_m"];

/// What a made-up simulator yields: each parameter has its own feature, with a little noise.
fn world(sigma: f64, length: f64, i: i32, seed: u8) -> [f64; 3] {
    let noise = |j: i32| 0.05 * Key([seed; 32]).field().normal(i, j);
    let (sigma, length) = (portable_math::log(sigma), portable_math::log(length));
    [sigma + noise(0), 2.0 * sigma + 0.1 * length + noise(1), length + noise(2)]
}

/// Tables and log of a proposal for references of sigma 0.2 and length 30, with `shift` added to one more feature that no parameter moves.
fn ran(with: &Value, shift: Option<f64>) -> Result<(BTreeMap<String, Table>, TestHost), StageError> {
    let still = |row: [f64; 3], i: i32, seed: u8| -> Vec<f64> {
        row.into_iter().chain(shift.map(|_| Key([seed; 32]).field().normal(i, 9))).collect()
    };
    let names: Vec<String> = FEATURES.iter().copied().chain(shift.map(|_| "skewness")).map(str::to_owned).collect();
    let mut reference: Vec<Vec<f64>> = (0..30).map(|i| still(world(0.2, 30.0, i, 1), i, 1)).collect();
    reference.iter_mut().for_each(|row| row.iter_mut().skip(3).for_each(|x| *x += shift.unwrap_or(0.0)));
    let groups = BTreeMap::from([("all".to_owned(), fit(&names, &reference, 1e-3).unwrap())]);
    let model = Acceptance { references: 30, ridge: 1e-3, labels: vec![String::new(); 30], groups };
    let mut inputs = Inputs::default();
    inputs.push("model", BTreeMap::new(), Arc::new(model.into()));
    for (k, (sigma, length)) in [(0.1, 20.0), (0.4, 20.0), (0.1, 60.0), (0.4, 60.0)].into_iter().enumerate() {
        let point = [("sigma".to_owned(), sigma.to_string()), ("length".to_owned(), length.to_string())].into();
        let mut table = Table::new(std::iter::once("raster".to_owned()).chain(names.clone()));
        for i in 4 * k as i32..4 * k as i32 + 4 {
            let row = still(world(sigma, length, i, 9), i, 9);
            table.push(std::iter::once(Cell::from("x")).chain(row.into_iter().map(Cell::from)).collect());
        }
        inputs.push("features", point, Arc::new(table.into()));
    }
    let params = ProposeParametersParams::decode(with).unwrap();
    let host = TestHost::default();
    let outputs = ProposeParameters::run(&params, &inputs, &Context::new(&host))?.into_inner();
    let table = |(port, artefact): (_, Artefact)| match artefact {
        Artefact::Table(table) => (String::from(port), table),
        other => panic!("a {} comes out", other.kind()),
    };
    Ok((outputs.into_iter().map(table).collect(), host))
}

fn proposed(with: &Value) -> Result<(Table, Table), StageError> {
    let (mut tables, _) = ran(with, None)?;
    Ok((tables.remove("points").unwrap(), tables.remove("sensitivities").unwrap()))
}

fn at(table: &Table, row: usize, column: &str) -> f64 {
    table.rows[row][table.column(column).unwrap()].number().unwrap()
}

#[test]
fn the_parameters_of_the_reference_are_found_in_one_step() {
    let (points, sensitivities) = proposed(&json!({"parameters": ["sigma", "length"]})).unwrap();
    let at = |column: &str| at(&points, 0, column);
    assert!((at("sigma") / 0.2 - 1.0).abs() < 0.05 && (at("length") / 30.0 - 1.0).abs() < 0.15, "{points:?}");
    assert!(at("predicted_d2") < 1.0);
    let change = |row: usize| sensitivities.rows[row][2].number().unwrap();
    // sigma moves nugget and sill and leaves the range alone.
    assert!(change(0) > 5.0 && change(1) > 10.0 && change(2).abs() < 2.0, "{sensitivities:?}");
}

#[test]
fn further_points_lie_around_the_proposal_and_a_larger_count_keeps_them() {
    let points = |count: usize| proposed(&json!({"parameters": ["sigma", "length"], "count": count})).unwrap().0;
    let (few, many) = (points(4), points(9));
    assert_eq!((few.rows.len(), &few.rows[..]), (4, &many.rows[..4]));
    let sigma = |row: usize| many.rows[row][1].number().unwrap();
    // A fifth of the range from 0.1 to 0.4, in logarithms, to either side.
    let reach = portable_math::pow(4.0, 0.2) * (1.0 + 1e-4);
    assert!((1..9).all(|k| sigma(k) <= sigma(0) * reach && sigma(k) >= sigma(0) / reach), "{many:?}");
}

#[test]
fn intervals_hold_the_truth_and_are_narrower_than_the_search() {
    let (tables, host) = ran(&json!({"parameters": ["sigma", "length"]}), None).unwrap();
    let posterior = &tables["posterior"];
    for (row, truth) in [(0, 0.2), (1, 30.0)] {
        let of = |column: &str| at(posterior, row, column);
        assert!(of("low90") < truth && truth < of("high90"), "{posterior:?}");
        assert!(of("high90") / of("low90") < 0.5 * of("searched_to") / of("searched_from"), "{posterior:?}");
    }
    assert!(host.warnings().is_empty(), "{:?}", host.warnings());
    assert_eq!(tables["reach"].rows.len(), 3);
}

#[test]
fn a_site_out_of_reach_is_said_so_with_the_feature_and_what_to_do() {
    let with = json!({"parameters": ["sigma", "length"]});
    let (tables, host) = ran(&with, Some(8.0)).unwrap();
    let warnings = host.warnings();
    let text = warnings.iter().find(|text| text.contains("cannot reach this site")).unwrap();
    assert!(text.contains("the mean of `skewness` lies") && text.contains("below the real one"), "{text}");
    assert!(text.contains("none of sigma, length moves the mean of `skewness`"), "{text}");
    assert!(at(&tables["points"], 0, "predicted_acceptance") < 0.1);
    let (_, host) = ran(&with, Some(0.0)).unwrap();
    assert!(!host.warnings().iter().any(|text| text.contains("cannot reach")), "{:?}", host.warnings());
    let error = ran(&json!({"parameters": ["sigma", "length"], "unreachable": "fail"}), Some(8.0)).err().unwrap();
    assert!(error.message.contains("cannot reach this site"), "{error}");
}

#[test]
fn without_trust_the_search_ends_where_the_simulations_do() {
    let (tables, _) = ran(&json!({"parameters": ["sigma", "length"], "trust": 0.0}), None).unwrap();
    assert!((at(&tables["posterior"], 0, "searched_from") - 0.1).abs() < 1e-9);
    assert!((at(&tables["posterior"], 1, "searched_to") - 60.0).abs() < 1e-9);
}

#[test]
fn what_cannot_be_proposed_is_refused() {
    let error = |with: Value| proposed(&with).unwrap_err().message;
    assert!(error(json!({"parameters": ["sigma"], "group": "spectrum"})).contains("it has all"));
    assert!(error(json!({"parameters": ["focus"]})).contains("`focus` has no number"));
}
