//! Bands, layout, held-out rasters and leverage of `summarise-acceptance` on made-up features.

use serde_json::{Value, json};

use super::*;
use rockface_core::artefact::Artefact;
use rockface_core::numerics::random::Key;
use rockface_core::testing::{TestHost, run_stage};

/// Features of made-up comparisons in a chain.
fn features(n: i32, seed: u8, spread: f64) -> Table {
    let mut table = Table::new(std::iter::once("raster").chain(feature_names()));
    let field = Key([seed; 32]).field();
    for i in 0..n {
        let values = (0..10).map(|j| Cell::from(2.0 + spread * field.normal(i, j)));
        table.push(std::iter::once(Cell::from(format!("c_{i}_{}", i + 1))).chain(values).collect());
    }
    table
}

fn tables(with: &Value, real: Table, simulated: Table) -> Result<(Vec<Table>, TestHost), StageError> {
    let host = TestHost::default();
    let inputs: [(&str, Artefact); 2] = [("reference", real.into()), ("simulated", simulated.into())];
    let outputs = run_stage::<SummariseAcceptance>(&host, with, &inputs)?.into_inner();
    let table = |port: &str| match &outputs[port] {
        Artefact::Table(table) => table.clone(),
        other => panic!("`{port}` is a {}", other.kind()),
    };
    Ok((["rates", "table_a1", "leverage"].map(table).to_vec(), host))
}

fn number(table: &Table, row: usize, column: &str) -> f64 {
    table.rows[row][table.column(column).unwrap()].number().unwrap()
}

#[test]
fn a_perfect_simulator_lies_in_the_band_and_a_narrow_one_above() {
    let (found, host) = tables(&json!({}), features(39, 1, 1.0), features(50, 2, 1.0)).unwrap();
    let rates = &found[0];
    assert_eq!(rates.rows.len(), 15);
    let at = |column: &str| number(rates, 5, column);
    assert!(at("expected_low") <= at("simulated_accepted") && at("simulated_accepted") <= at("expected_high"));
    assert!(at("exact_low") <= at("wilson_low") + 0.02 && at("expected") < 0.9);
    assert!(host.warnings().iter().any(|text| text.contains("share an epoch")));
    let (narrow, _) = tables(&json!({}), features(39, 1, 1.0), features(50, 2, 0.2)).unwrap();
    assert_eq!(narrow[0].rows[5][narrow[0].column("in_band").unwrap()], Cell::from(false));
    assert_eq!((number(&narrow[0], 5, "simulated_accepted") as usize, narrow[1].rows.len()), (50, 3));
}

#[test]
fn the_layout_is_that_of_table_a1() {
    let (found, _) = tables(&json!({}), features(39, 1, 1.0), features(50, 2, 0.0)).unwrap();
    let first = &found[1].rows[0];
    assert_eq!((&first[0], &first[2], &first[3]), (&"90%".into(), &"89.7% (35/39)".into(), &"100% (50/50)".into()));
    assert_eq!(found[1].columns[5], "variogram (simulation)");
}

#[test]
fn held_out_rasters_are_judged_and_take_no_part() {
    let (found, _) = tables(&json!({"held_out": 0.3333}), features(39, 1, 1.0), features(20, 2, 1.0)).unwrap();
    assert_eq!((number(&found[0], 0, "real_n"), number(&found[0], 0, "held_out_n")), (26.0, 13.0));
    let error = tables(&json!({"held_out": 0.8}), features(39, 1, 1.0), features(20, 2, 1.0)).err().unwrap();
    assert!(error.message.contains("at least 12") && error.hint.unwrap().contains("hold fewer"));
    let (found, host) =
        tables(&json!({"held_out": 0.8, "fewer": true}), features(39, 1, 1.0), features(20, 2, 1.0)).unwrap();
    assert_eq!((number(&found[0], 0, "p"), number(&found[0], 0, "held_out_n")), (3.0, 31.0));
    assert!(host.warnings().iter().any(|text| text.contains("only std_m, skewness, roughness_b")));
}

#[test]
fn a_lone_raster_shows_in_the_leverage() {
    let mut real = features(30, 1, 1.0);
    let column = real.column("std_m").unwrap();
    real.rows[7][column] = 60.0.into();
    let (found, _) = tables(&json!({}), real, features(20, 2, 1.0)).unwrap();
    assert!(number(&found[2], 7, "share_of_bound") > 0.9);
    assert!(number(&found[2], 7, "threshold_without") < number(&found[2], 3, "threshold_without"));
    assert_eq!(found[2].rows[3][6], "c_2_3 c_4_5".into());
}

#[test]
fn a_feature_without_variance_neither_fails_nor_decides() {
    let mut real = features(30, 1, 1.0);
    let column = real.column("nugget_m2").unwrap();
    for row in &mut real.rows {
        row[column] = 0.0.into();
    }
    let (found, host) = tables(&json!({}), real, features(20, 2, 1.0)).unwrap();
    assert!((number(&found[0], 0, "p") - 9.0).abs() < 1e-12);
    assert!(host.warnings().iter().any(|text| text.contains("nugget_m2")));
}

/// Features of the real rasters of a site, by an independent implementation; `None`, with the reason printed, where they are not there.
fn real_site(site: &str) -> Option<Table> {
    let path = format!("{}/../../../shared/data/{site}/features.csv", env!("CARGO_MANIFEST_DIR"));
    let Ok(csv) = std::fs::read(&path) else {
        eprintln!("skipped: {path} is not there");
        return None;
    };
    let mut reader = csv::Reader::from_reader(csv.as_slice());
    let mut table = Table::new(std::iter::once("raster").chain(feature_names()));
    for record in reader.records().map(Result::unwrap) {
        let numbers = record.iter().skip(1).take(10).map(|text| Cell::from(text.parse::<f64>().unwrap()));
        table.push(std::iter::once(Cell::from(&record[0])).chain(numbers).collect());
    }
    Some(table)
}

#[test]
fn two_settings_of_a_matcher_on_one_face_are_rejected_by_each_other() {
    let sites = ["outcrop-survey", "outcrop-half"].map(real_site);
    let [Some(full), Some(half)] = sites else { return };
    for (real, simulated) in [(full.clone(), half.clone()), (half, full)] {
        let (found, _) = tables(&json!({}), real, simulated).unwrap();
        // The joint test at the middle quantile.
        let accepted = number(&found[0], 5, "simulated_accepted");
        assert!(accepted <= 5.0, "{accepted}");
        assert_eq!(found[0].rows[5][found[0].column("in_band").unwrap()], Cell::from(false));
    }
}
