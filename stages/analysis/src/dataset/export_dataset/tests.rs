//! `export-dataset` on scenes of a few cells.

use std::sync::Arc;

use serde_json::json;

use super::*;
use rockface_core::Point;
use rockface_core::artefact::{Artefact, Feature, Frame, Grid, Inventory, Noun, Polygon, Raster};
use rockface_core::params::ParamType;
use rockface_core::testing::TestHost;

const GRID: Grid = Grid { columns: 16, rows: 8, cell_m: 0.1, left_m: 0.0, top_m: 0.8 };

fn raster(quantity: &str, value: f32) -> Raster {
    Raster::single(GRID, Frame::Wall, quantity, quantity, vec![value; GRID.cells()])
}

/// A change over columns 1 to 3 of rows 1 and 2.
fn truth(changed: bool) -> Inventory {
    let exterior = vec![[0.1, 0.5], [0.4, 0.5], [0.4, 0.7], [0.1, 0.7]];
    let feature = Feature { outline: vec![Polygon { exterior, holes: Vec::new() }], values: vec![7.0.into()] };
    let features = if changed { vec![feature] } else { Vec::new() };
    Inventory { frame: Frame::Wall, columns: vec!["id".into()], features }
}

fn inputs(events: usize, quiet: usize) -> Inputs<'static> {
    let mut inputs = Inputs::default();
    for event in 0..events + quiet {
        let epoch: Point = [("epoch".to_owned(), event.to_string())].into_iter().collect();
        for draw in 0..2 {
            let mut point = epoch.clone();
            point.insert("draw".into(), draw.to_string());
            let mut difference = raster("difference", 0.0);
            // The right half of the second draw looks most like a loss.
            difference.bands[0].values[12] = -0.01 * (draw + 1) as f32;
            inputs.push("difference", point.clone(), Arc::new(difference.into()));
            inputs.push("comparison", point, Arc::new(raster("elevation", 1.5).into()));
        }
        inputs.push("reference", epoch.clone(), Arc::new(raster("elevation", 2.0).into()));
        inputs.push("truth", epoch, Arc::new(truth(event < events).into()));
    }
    inputs
}

/// Path in the data set and content of a file.
type File = (String, Vec<u8>);

fn run(with: &serde_json::Value, inputs: &Inputs) -> Result<(Vec<File>, Table), StageError> {
    let params = ExportDatasetParams::decode(with).unwrap();
    let mut made = ExportDataset::run(&params, inputs, &Context::new(&TestHost::default()))?.into_inner();
    match (made.remove("dataset"), made.remove("index")) {
        (Some(Artefact::Files(files)), Some(Artefact::Table(index))) => Ok((files.files, index)),
        _ => panic!("outputs are missing"),
    }
}

fn column(index: &Table, name: &str) -> Vec<String> {
    let at = index.column(name).unwrap();
    index.rows.iter().map(|row| row[at].to_string()).collect()
}

#[test]
fn draws_of_an_event_stay_together_and_negatives_are_the_hardest() {
    let with = json!({"tile_cells": 8, "stride_cells": 8, "shares": {"train": 0.5, "validation": 0.25, "test": 0.25}});
    let (files, index) = run(&with, &inputs(4, 0)).unwrap();
    // Four events of two draws, each with a tile that changed and one that did not.
    assert_eq!(index.rows.len(), 16);
    let (events, parts) = (column(&index, "event"), column(&index, "split"));
    for (event, part) in events.iter().zip(&parts) {
        assert!(events.iter().zip(&parts).all(|(e, p)| e != event || p == part));
    }
    let count = |part: &str| parts.iter().filter(|p| *p == part).count();
    assert_eq!([count("train"), count("validation"), count("test")], [8, 4, 4]);
    let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    assert!(
        names.contains(&"README.md")
            && names.contains(&"stac/catalog.json")
            && names.contains(&"events/00000_epoch0.geojson")
    );
    assert_eq!(names.iter().filter(|name| name.contains(".npz")).count(), 16);
    assert_eq!(names.iter().filter(|name| name.ends_with("_mask.tif")).count(), 16);
    let sums = String::from_utf8(files.iter().find(|(name, _)| name == "SHA256SUMS").unwrap().1.clone()).unwrap();
    assert_eq!(sums.lines().count(), files.len() - 1);
    let (_, mask) = files.iter().find(|(name, _)| name.ends_with("c00000_mask.tif")).unwrap();
    let mask = Raster::decode(mask).unwrap();
    assert_eq!(mask.bands[0].values.iter().filter(|value| **value > 0.5).count(), 6);
    assert!(Files { files }.encode().is_ok());
}

#[test]
fn quiet_epochs_give_hard_negatives_and_the_ratio_holds() {
    let with = json!({"tile_cells": 8, "stride_cells": 8, "negatives_per_positive": 0.5, "formats": ["npz"],
        "shares": {"train": 1, "validation": 0, "test": 0}});
    let (_, index) = run(&with, &inputs(2, 2)).unwrap();
    let changed = column(&index, "changed_cells");
    assert_eq!((changed.iter().filter(|c| *c == "6").count(), changed.iter().filter(|c| *c == "0").count()), (4, 2));
    let losses = index.column("apparent_loss_m").unwrap();
    let hardest =
        index.rows.iter().filter(|row| row[11].number() == Some(0.0)).all(|row| row[losses].number() > Some(2e-4));
    assert!(hardest, "{:?}", index.rows);
}

#[test]
fn a_split_by_place_leaves_out_what_lies_on_a_cut() {
    let with = json!({"tile_cells": 4, "stride_cells": 4, "split": "place", "negatives_per_positive": null, "formats": ["npz"],
        "shares": {"train": 0.5, "validation": 0.25, "test": 0.25}});
    let (_, index) = run(&with, &inputs(1, 0)).unwrap();
    let (columns, parts) = (column(&index, "column"), column(&index, "split"));
    for (column, part) in columns.iter().zip(&parts) {
        let expected = match column.as_str() {
            "0" | "4" => "train",
            "8" => "validation",
            _ => "test",
        };
        assert_eq!(part, expected);
    }
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let refused = |with: serde_json::Value, inputs: &Inputs| run(&with, inputs).unwrap_err().message;
    assert!(refused(json!({"tile_cells": 20}), &inputs(1, 0)).contains("a tile of 20 cells does not fit into 16 x 8"));
    assert!(refused(json!({"event_axes": ["event"]}), &inputs(1, 0)).contains("there are draw, epoch"));
    assert!(refused(json!({"tile_cells": 8}), &inputs(0, 1)).contains("no tile holds a change"));
    let mut lacking = inputs(1, 0);
    let point: Point =
        [("epoch".to_owned(), "9".to_owned()), ("draw".to_owned(), "0".to_owned())].into_iter().collect();
    lacking.push("difference", point, Arc::new(raster("difference", 0.0).into()));
    assert!(
        refused(json!({"tile_cells": 8}), &lacking)
            .contains("0 elements of `reference` belong to the difference draw=0 epoch=9")
    );
}
