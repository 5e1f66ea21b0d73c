//! Shifts, spreads, the control and the choice of columns of `compare-samples` on made-up features.

use serde_json::{Value, json};

use super::*;
use rockface_core::artefact::Artefact;
use rockface_core::numerics::random::Key;
use rockface_core::testing::{TestHost, run_stage};

fn features(n: i32, seed: u8, spread: f64, shift: f64) -> Table {
    let mut table = Table::new(["raster", "std_m", "nugget_m2", "skewness"]);
    let field = Key([seed; 32]).field();
    for i in 0..n {
        let value = |j: i32| Cell::from(spread * field.normal(i, j) + if j == 0 { shift } else { 0.0 });
        table.push(vec![format!("c_{i}_{}", i + 1).into(), value(0), 0.0.into(), value(2)]);
    }
    table
}

fn compared(simulated: Table, with: &Value) -> Result<(Table, TestHost), StageError> {
    compared_with(features(60, 1, 1.0, 0.0), simulated, with)
}

fn compared_with(reference: Table, simulated: Table, with: &Value) -> Result<(Table, TestHost), StageError> {
    let host = TestHost::default();
    let inputs: [(&str, Artefact); 2] = [("reference", reference.into()), ("simulated", simulated.into())];
    let outputs = run_stage::<CompareSamples>(&host, with, &inputs)?.into_inner();
    let Artefact::Table(table) = &outputs["areas"] else { panic!("a table comes out") };
    Ok((table.clone(), host))
}

fn at(table: &Table, seen: &str, column: &str) -> f64 {
    let row = table.rows.iter().find(|row| row[0].text() == Some(seen)).unwrap();
    row[table.column(column).unwrap()].number().unwrap()
}

#[test]
fn shifts_are_seen_linearly_and_spreads_by_squares() {
    let (same, _) = compared(features(60, 2, 1.0, 0.0), &json!({})).unwrap();
    assert!(at(&same, "linear", "low95") < 0.5 && at(&same, "linear", "auc") < 0.65);
    let (shifted, host) = compared(features(60, 2, 1.0, 3.0), &json!({})).unwrap();
    assert!(Classifier::ALL.iter().all(|classifier| at(&shifted, classifier.name(), "auc") > 0.9));
    assert!(at(&shifted, "std_m", "auc") > 0.95 && host.metric("auc").unwrap() > 0.95);
    assert!(
        (at(&shifted, "nugget_m2", "auc") - 0.5).abs() < 1e-12 && at(&shifted, "nugget_m2", "weight").abs() < 1e-12
    );
    let (narrow, _) = compared(features(60, 2, 0.1, 0.0), &json!({})).unwrap();
    assert!(at(&narrow, "linear", "auc") < 0.75 && at(&narrow, "squares", "auc") > 0.8, "{:?}", narrow.rows);
}

#[test]
fn rounding_is_not_told_apart() {
    let with_nugget = |mut table: Table, nugget: f64| {
        table.columns[3] = "sill_m2".to_owned();
        for (i, row) in table.rows.iter_mut().enumerate() {
            row[2] = (nugget * (1.0 + 0.1 * (i % 7) as f64)).into();
            row[3] = (1.0 + 0.1 * row[3].number().unwrap()).into();
        }
        table
    };
    let area = |nugget: f64| {
        let (real, simulated) = (features(60, 1, 1.0, 0.0), features(60, 2, 1.0, 0.0));
        let compared = compared_with(with_nugget(real, 1e-9), with_nugget(simulated, nugget), &json!({}));
        at(&compared.unwrap().0, "stumps", "auc")
    };
    assert!(area(1e-4) < 0.65 && area(0.02) > 0.9, "{} {}", area(1e-4), area(0.02));
}

#[test]
fn rasters_that_are_held_out_are_not_compared() {
    let mut drifting = features(40, 1, 1.0, 0.0);
    drifting.rows.extend(features(20, 4, 1.0, 6.0).rows);
    let like_the_first = |with: Value| compared_with(drifting.clone(), features(40, 2, 1.0, 0.0), &with);
    let (all, _) = like_the_first(json!({})).unwrap();
    let (in_view, _) = like_the_first(json!({"held_out": 0.3333})).unwrap();
    let (first, _) = compared_with(features(40, 1, 1.0, 0.0), features(40, 2, 1.0, 0.0), &json!({})).unwrap();
    let auc = |table: &Table| at(table, "squares", "auc");
    assert!(auc(&all) > auc(&in_view) + 0.1, "{} {}", auc(&all), auc(&in_view));
    assert_eq!(auc(&in_view).to_bits(), auc(&first).to_bits());
    drifting.rows.truncate(30);
    let few = compared_with(drifting, features(40, 2, 1.0, 0.0), &json!({"held_out": 0.9})).err().unwrap();
    assert!(few.to_string().contains("`reference` has 3 rasters to compare, 4 are needed"), "{few}");
}

#[test]
fn the_control_stands_beside_and_what_tells_is_named() {
    let (found, host) = compared(features(60, 2, 1.0, 3.0), &json!({})).unwrap();
    for classifier in Classifier::ALL {
        let of = |column: &str| at(&found, classifier.name(), column);
        assert!(of("control_low") < 0.5 + 0.05 && of("control_high") < 0.85 && of("control_low") < of("control_high"));
        assert!(of("auc") > of("control_high"));
    }
    assert_eq!(host.metric("telling_features"), Some(1.0));
    let (none, _) = compared(features(60, 2, 1.0, 3.0), &json!({"control_splits": 0})).unwrap();
    assert_eq!(none.rows[0][none.column("control_low").unwrap()], Cell::Empty(()));
    assert_eq!(at(&none, "squares", "auc").to_bits(), at(&found, "squares", "auc").to_bits());
}

#[test]
fn columns_are_those_asked_for_or_all_numbers() {
    let (all, _) = compared(features(20, 2, 1.0, 0.0), &json!({})).unwrap();
    assert_eq!(all.rows.len(), 4 + 3);
    let (one, _) = compared(features(20, 2, 1.0, 0.0), &json!({"features": ["skewness"]})).unwrap();
    assert_eq!(one.rows.len(), 4 + 1);
    let mut table = Table::new(std::iter::once("raster").chain(feature_names()).chain(["further"]));
    table.push((0..12).map(|j| if j == 0 { "a".into() } else { Cell::from(f64::from(j)) }).collect());
    let ten = super::features(&CompareSamplesParams::default(), Some(&table));
    assert_eq!(ten, feature_names());
}

#[test]
fn few_rasters_are_compared_in_fewer_folds() {
    let (few, host) = compared(features(4, 2, 1.0, 9.0), &json!({"features": ["std_m"]})).unwrap();
    assert!(at(&few, "linear", "auc") > 0.9, "{:?}", host.warnings());
}

#[test]
fn too_few_rasters_are_refused() {
    let error = compared(features(3, 2, 1.0, 0.0), &json!({"features": ["std_m"]})).err().unwrap();
    assert!(error.message.contains("`simulated` has 3 rasters"), "{error}");
}
