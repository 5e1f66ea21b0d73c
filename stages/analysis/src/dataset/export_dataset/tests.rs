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
            // Each survey has noise of its own.
            difference.bands[0].values[0] = 0.001 * (event * 2 + draw + 1) as f32;
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
    run_on(&TestHost::default(), with, inputs)
}

fn run_on(host: &TestHost, with: &serde_json::Value, inputs: &Inputs) -> Result<(Vec<File>, Table), StageError> {
    let params = ExportDatasetParams::decode(with).unwrap();
    let mut made = ExportDataset::run(&params, inputs, &Context::new(host))?.into_inner();
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
    let with = json!({"tile_cells": 8, "stride_cells": 8, "dealing": "exact",
        "shares": {"train": 0.5, "validation": 0.25, "test": 0.25}});
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
        index.rows.iter().filter(|row| row[12].number() == Some(0.0)).all(|row| row[losses].number() > Some(2e-4));
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

fn events_and_parts(index: &Table) -> std::collections::BTreeMap<String, String> {
    column(index, "event").into_iter().zip(column(index, "split")).collect()
}

#[test]
fn events_stay_in_their_part_when_the_data_set_grows() {
    let with = json!({"tile_cells": 8, "stride_cells": 8, "formats": ["npz"]});
    let (_, small) = run(&with, &inputs(30, 0)).unwrap();
    let (_, large) = run(&with, &inputs(60, 0)).unwrap();
    let (small, large) = (events_and_parts(&small), events_and_parts(&large));
    assert_eq!((small.len(), large.len()), (30, 60));
    assert!(small.iter().all(|(event, part)| large[event] == *part), "{small:?}\n{large:?}");
    let train = large.values().filter(|part| *part == "train").count();
    assert!((30..=54).contains(&train), "{train}");
}

#[test]
fn few_events_fill_every_part_and_what_was_lent_is_told() {
    let with = json!({"tile_cells": 8, "stride_cells": 8, "formats": ["npz"]});
    let mut lent = 0;
    for seed in 0..8 {
        let host = TestHost::seeded(seed);
        let (files, index) = run_on(&host, &with, &inputs(5, 0)).unwrap();
        let parts: std::collections::BTreeSet<String> = column(&index, "split").into_iter().collect();
        assert_eq!(parts.len(), 3, "{seed}");
        let card = String::from_utf8(files.into_iter().find(|(name, _)| name == "README.md").unwrap().1).unwrap();
        let is_lent = host.warnings().iter().any(|text| text.contains("only because nothing else would be"));
        assert_eq!(card.contains(", lent to "), is_lent, "{card}");
        lent += host.warnings().iter().filter(|text| text.contains("5 events are few for these shares")).count();
    }
    assert!(lent > 0);
}

/// Two sites whose truths have other numbers, and an unchanged survey first.
fn sites() -> Inputs<'static> {
    let mut inputs = Inputs::default();
    for (site, id) in [("0", None), ("1", Some(7.0)), ("2", Some(8.0)), ("3", Some(7.0))] {
        let point: Point =
            [("epoch".to_owned(), "0".to_owned()), ("site".to_owned(), site.to_owned())].into_iter().collect();
        let mut truth = truth(id.is_some());
        truth.features.iter_mut().for_each(|feature| feature.values = vec![id.unwrap_or_default().into()]);
        inputs.push("difference", point.clone(), Arc::new(raster("difference", 0.0).into()));
        inputs.push("comparison", point.clone(), Arc::new(raster("elevation", 1.5).into()));
        inputs.push("reference", point.clone(), Arc::new(raster("elevation", 2.0).into()));
        inputs.push("truth", point, Arc::new(truth.into()));
    }
    inputs
}

#[test]
fn a_tile_names_the_file_that_has_the_numbers_of_its_mask() {
    let with = json!({"tile_cells": 8, "stride_cells": 8, "negatives_per_positive": null, "prefix": "s1_",
        "shares": {"train": 1, "validation": 0, "test": 0}});
    let (files, index) = run(&with, &sites()).unwrap();
    let found: std::collections::BTreeMap<String, String> =
        column(&index, "axis_site").into_iter().zip(column(&index, "truth")).collect();
    let expected = ["_unchanged", "", "_2", ""].map(|end| format!("events/s1_00000_epoch0{end}.geojson"));
    assert_eq!(found.into_values().collect::<Vec<_>>(), expected);
    let file = |name: &str| &files.iter().find(|(place, _)| place == name).unwrap().1;
    let id = |name: &str| Inventory::decode(file(name)).unwrap().numbers("id").unwrap();
    assert_eq!(id(&expected[0]), []);
    assert_eq!((id(&expected[1]), id(&expected[2])), (vec![Some(7.0)], vec![Some(8.0)]));
    assert_eq!(files.iter().filter(|(place, _)| place.starts_with("events/")).count(), 3);
    let item = String::from_utf8(file(&format!("stac/items/{}.json", column(&index, "tile")[0])).clone()).unwrap();
    assert_eq!(item.matches("\"../s1_catalog.json\"").count(), 2, "{item}");
    assert!(item.contains(&format!("\"rockface:truth\": \"{}\"", column(&index, "truth")[0])), "{item}");
}

#[test]
fn data_sets_with_other_prefixes_have_no_file_in_common() {
    let names = |prefix: &str| {
        let with = json!({"tile_cells": 8, "stride_cells": 8, "prefix": prefix,
            "shares": {"train": 1, "validation": 0, "test": 0}});
        let (files, _) = run(&with, &inputs(1, 0)).unwrap();
        let sums = String::from_utf8(files.iter().find(|(name, _)| name.ends_with("SHA256SUMS")).unwrap().1.clone());
        assert!(sums.unwrap().lines().all(|line| files.iter().any(|(name, _)| line.ends_with(&format!("  {name}")))));
        let root = &files.iter().find(|(name, _)| name.ends_with("catalog.json")).unwrap().1;
        let root: serde_json::Value = serde_json::from_slice(root).unwrap();
        for link in root["links"].as_array().unwrap() {
            let place = link["href"].as_str().unwrap().replacen('.', "stac", 1);
            assert!(files.iter().any(|(name, _)| *name == place), "{place}");
        }
        files.into_iter().map(|(name, _)| name).collect::<std::collections::BTreeSet<String>>()
    };
    let (plain, one, two) = (names(""), names("s1_"), names("s2_"));
    assert!(one.is_disjoint(&two) && one.len() == plain.len(), "{one:?}");
    for name in ["index.csv", "SHA256SUMS", "README.md", "stac/catalog.json"] {
        assert!(plain.contains(name), "{name}");
    }
    for name in ["s1_index.csv", "s1_SHA256SUMS", "s1_README.md", "stac/s1_catalog.json"] {
        assert!(one.contains(name), "{name}");
    }
}

#[test]
fn the_same_survey_in_two_parts_is_refused() {
    let mut twins = inputs(3, 0);
    let twin: Point = [("epoch".to_owned(), "9".to_owned()), ("draw".to_owned(), "0".to_owned())].into_iter().collect();
    let (first, epoch) = (inputs(1, 0), Point::from([("epoch".to_owned(), "9".to_owned())]));
    let difference = first.many::<Raster>("difference").unwrap()[0].1.clone();
    twins.push("difference", twin.clone(), Arc::new(difference.into()));
    twins.push("comparison", twin, Arc::new(raster("elevation", 1.5).into()));
    twins.push("reference", epoch.clone(), Arc::new(raster("elevation", 2.0).into()));
    twins.push("truth", epoch, Arc::new(truth(true).into()));
    let with = |train: f64| {
        json!({"tile_cells": 8, "stride_cells": 8, "dealing": "exact", "formats": ["npz"],
            "shares": {"train": train, "validation": 1, "test": 1}})
    };
    let apart = (0..8).find_map(|seed| run_on(&TestHost::seeded(seed), &with(1.0), &twins).err()).unwrap();
    assert!(apart.message.contains("00000_epoch0 and 00003_epoch9 have the same difference"), "{}", apart.message);
    // In one part they do no harm.
    let one = json!({"tile_cells": 8, "stride_cells": 8, "shares": {"train": 1, "validation": 0, "test": 0}});
    assert!(run(&one, &twins).is_ok());
}

#[test]
fn a_strip_that_is_narrower_than_a_tile_is_told() {
    let with = |side: usize| {
        json!({"tile_cells": side, "stride_cells": side, "split": "place", "negatives_per_positive": null, "formats": ["npz"],
            "shares": {"train": 0.6, "validation": 0.2, "test": 0.2}})
    };
    let host = TestHost::default();
    let (_, index) = run_on(&host, &with(5), &inputs(1, 0)).unwrap();
    assert_eq!(column(&index, "column").into_iter().collect::<std::collections::BTreeSet<_>>().len(), 2);
    let told = host.warnings();
    assert!(
        told.contains(
            &"the part validation is 3 columns wide, a tile is 5: lower `tile_cells`, or give the part a larger share"
                .to_owned()
        ),
        "{told:?}"
    );
    // Strips have tiles of their own: 0 to 5, 5 to 10, 10 to 16.
    let with = json!({"tile_cells": 4, "stride_cells": 4, "split": "place", "negatives_per_positive": null, "formats": ["npz"],
        "shares": {"train": 5, "validation": 5, "test": 6}});
    let (_, index) = run(&with, &inputs(1, 0)).unwrap();
    let columns: std::collections::BTreeSet<String> = column(&index, "column").into_iter().collect();
    assert_eq!(columns.into_iter().collect::<Vec<_>>(), ["0", "1", "10", "12", "5", "6"]);
}

#[test]
fn change_that_no_survey_saw_makes_no_tile_with_change() {
    let mut unseen = Inputs::default();
    for (epoch, seen) in [("0", 2), ("1", 0)] {
        let point: Point = [("epoch".to_owned(), epoch.to_owned())].into_iter().collect();
        let mut difference = raster("difference", -0.5);
        // The change is in columns 1 to 3 of rows 1 and 2.
        for cell in [17, 18, 19, 33, 34, 35].into_iter().skip(seen) {
            difference.bands[0].values[cell] = f32::NAN;
        }
        unseen.push("difference", point.clone(), Arc::new(difference.into()));
        unseen.push("comparison", point.clone(), Arc::new(raster("elevation", 1.5).into()));
        unseen.push("reference", point.clone(), Arc::new(raster("elevation", 2.0).into()));
        unseen.push("truth", point, Arc::new(truth(true).into()));
    }
    let with = json!({"tile_cells": 8, "stride_cells": 8, "negatives_per_positive": null, "formats": ["npz"],
        "shares": {"train": 1, "validation": 0, "test": 0}});
    let (_, index) = run(&with, &unseen).unwrap();
    let counted: Vec<(String, String)> =
        column(&index, "changed_cells").into_iter().zip(column(&index, "changed_valid_cells")).collect();
    let pair = |a: &str, b: &str| (a.to_owned(), b.to_owned());
    assert_eq!(counted, [pair("6", "2"), pair("0", "0"), pair("0", "0")]);
}

#[test]
fn parameters_that_mean_nothing_are_refused() {
    let faults = |with: serde_json::Value| {
        let faults = ExportDatasetParams::decode(&with).map_or_else(|faults| faults, |p| ExportDataset::check(&p));
        faults.into_iter().map(|fault| fault.message).collect::<String>()
    };
    assert!(faults(json!({"formats": ["npz", "npz"]})).contains("`npz` is there twice"));
    assert!(faults(json!({"prefix": "../a"})).contains("letters, digits"));
    assert!(faults(json!({"first_day": 3_000_000})).contains("out of range"));
    assert_eq!(faults(json!({"prefix": "seed-1_", "first_day": -719_528})), "");
    let late = json!({"tile_cells": 8, "first_day": 2_932_896, "shares": {"train": 1, "validation": 0, "test": 0}});
    assert!(run(&late, &inputs(2, 0)).unwrap_err().message.contains("beyond the year 9999"));
    assert!(run(&late, &inputs(1, 0)).is_ok());
}

#[test]
fn truths_need_a_number_of_its_own_for_each_change() {
    let with = |columns: Vec<String>, values: Vec<Vec<Cell>>| {
        let one = truth(true).features.remove(0);
        let features = values.into_iter().map(|values| Feature { values, ..one.clone() }).collect();
        let truth = Inventory { frame: Frame::Wall, columns, features };
        sources::instances(&truth, &raster("difference", 0.0)).map_err(|e| e.message)
    };
    assert!(with(vec!["volume".into()], vec![vec![1.0.into()]]).unwrap_err().contains("no column `id`"));
    let id = || vec!["id".to_owned()];
    assert!(with(id(), vec![vec![3.0.into()], vec![3.0.into()]]).unwrap_err().contains("two changes have the `id` 3"));
    assert!(
        with(id(), vec![vec![3.0.into()], vec![Cell::Empty(())]]).unwrap_err().contains("change 2 of 2 has no `id`")
    );
    assert!(with(id(), vec![vec![1.5.into()]]).unwrap_err().contains("no whole number"));
    assert!(with(Vec::new(), Vec::new()).is_ok());
}

#[test]
fn cell_sizes_overlap_and_coarse_outlines_are_told() {
    let mut mixed = inputs(1, 0);
    let point: Point =
        [("epoch".to_owned(), "1".to_owned()), ("draw".to_owned(), "0".to_owned())].into_iter().collect();
    let grid = Grid { cell_m: 0.025, left_m: 0.05, top_m: 0.7, ..GRID };
    let fine = |value: f32| Raster::single(grid, Frame::Wall, "q", "q", vec![value; grid.cells()]);
    // An L of steps of 0.1 m.
    let exterior = vec![[0.1, 0.5], [0.3, 0.5], [0.3, 0.6], [0.2, 0.6], [0.2, 0.7], [0.1, 0.7]];
    let mut stairs = truth(true);
    stairs.features[0].outline = vec![Polygon { exterior, holes: Vec::new() }];
    mixed.push("difference", point.clone(), Arc::new(fine(-0.5).into()));
    mixed.push("comparison", point, Arc::new(fine(1.5).into()));
    let epoch = Point::from([("epoch".to_owned(), "1".to_owned())]);
    mixed.push("reference", epoch.clone(), Arc::new(fine(2.0).into()));
    mixed.push("truth", epoch, Arc::new(stairs.into()));
    let host = TestHost::default();
    let with = |border: &str| {
        json!({"tile_cells": 6, "stride_cells": 6, "border": border, "negatives_per_positive": null, "formats": ["npz"],
            "shares": {"train": 1, "validation": 0, "test": 0}})
    };
    let (files, index) = run_on(&host, &with("shift"), &mixed).unwrap();
    let card = String::from_utf8(files.iter().find(|(name, _)| name == "README.md").unwrap().1.clone()).unwrap();
    assert!(card.contains("cells of 0.1 and 0.025 m"), "{card}");
    // Three rasters of 16 x 8 cells have 6 tiles each, which cover them.
    assert_eq!(index.rows.len(), 18);
    assert!(card.contains("| train | 18 |") && card.contains("| 648 | 384 |"), "{card}");
    assert!(host.warnings().iter().any(|text| text.contains("steps of 0.1000 m, cells are 0.025 m")));
    let (_, index) = run(&with("drop"), &mixed).unwrap();
    assert_eq!(index.rows.len(), 6);
}
