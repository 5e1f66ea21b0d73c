//! The files of a data set: tiles, index, truth, catalogue, card, checksums.

use serde_json::{Map, Value, json};

use super::choice::{Events, Pick};
use super::sources::Scored;
use super::{ExportDatasetParams, Format, Negatives, SplitBy};
use crate::dataset::card;
use crate::dataset::card::Facts;
use crate::dataset::npz;
use crate::dataset::npz::Array;
use crate::dataset::split::PARTS;
use crate::dataset::tiles::Tile;
use crate::dataset::{catalogue, checksums};
use rockface_core::artefact::{Cell, Noun, Raster, Sample, Table};
use rockface_core::{Context, StageError};

/// The name of a tile: its number, its point, its corner.
pub(super) fn name(number: usize, sample: &Scored, tile: &Tile) -> String {
    let plain = |text: &str| text.chars().filter(char::is_ascii_alphanumeric).take(12).collect::<String>();
    let point: String =
        sample.point.iter().take(3).map(|(axis, item)| format!("_{}{}", plain(axis), plain(item))).collect();
    format!("{number:06}{point}_r{:05}_c{:05}", tile.corner[0], tile.corner[1])
}

pub(super) fn event_name(events: &Events, event: usize) -> String {
    let plain = |text: &str| text.chars().filter(char::is_ascii_alphanumeric).take(20).collect::<String>();
    let point: String =
        events.points[event].iter().take(3).map(|(axis, item)| format!("_{}{}", plain(axis), plain(item))).collect();
    format!("{event:05}{point}")
}

pub(super) fn index(params: &ExportDatasetParams, samples: &[Scored], events: &Events, chosen: &[Pick]) -> Table {
    let axes = rockface_raster::feature_rows::axes(samples.iter().map(|sample| sample.point));
    let fixed = [
        "tile",
        "split",
        "event",
        "sequence",
        "row",
        "column",
        "left_m",
        "top_m",
        "cell_m",
        "side_cells",
        "valid_cells",
        "changed_cells",
        "instances",
        "apparent_loss_m",
    ];
    let mut table =
        Table::new(fixed.iter().map(ToString::to_string).chain(axes.iter().map(|axis| format!("axis_{axis}"))));
    for (number, pick) in chosen.iter().enumerate() {
        let (sample, tile) = (&samples[pick.sample], &pick.tile);
        let own = tile.grid(&sample.difference.grid);
        let order = params
            .sequence_axis
            .as_ref()
            .map_or(Cell::Empty(()), |axis| rockface_raster::feature_rows::item_cell(sample.point, axis));
        let mut row: Vec<Cell> = vec![name(number, sample, tile).into(), PARTS[pick.part].into()];
        row.extend([event_name(events, events.of_sample[pick.sample]).into(), order]);
        let numbers = [
            tile.corner[0] as f64,
            tile.corner[1] as f64,
            own.left_m,
            own.top_m,
            own.cell_m,
            tile.side as f64,
            tile.valid as f64,
            tile.changed as f64,
            tile.instances as f64,
            tile.apparent_loss_m,
        ];
        row.extend(numbers.map(Cell::from));
        row.extend(axes.iter().map(|axis| rockface_raster::feature_rows::item_cell(sample.point, axis)));
        table.push(row);
    }
    table
}

type File = (String, Vec<u8>);

pub(super) fn files(
    params: &ExportDatasetParams,
    samples: &[Scored],
    events: &Events,
    chosen: &[Pick],
    index: &Table,
    context: &Context,
) -> Result<Vec<File>, StageError> {
    let codec = |e: rockface_core::artefact::CodecError| StageError::new(e.to_string());
    let mut files: Vec<File> = Vec::new();
    let mut items = Vec::new();
    let mut ids = Vec::new();
    for (number, pick) in chosen.iter().enumerate() {
        context.check_cancelled()?;
        let sample = &samples[pick.sample];
        let name = name(number, sample, &pick.tile);
        let stem = format!("tiles/{}/{name}", PARTS[pick.part]);
        let made = arrays(params, sample, &pick.tile, &stem)?;
        items.push((format!("stac/items/{name}.json"), item(params, events, pick, sample, &name, &made)));
        files.extend(made.into_iter().map(|(_, _, place, bytes)| (place, bytes)));
        ids.push(name);
    }
    let mut told = std::collections::BTreeSet::new();
    for (sample, event) in samples.iter().zip(&events.of_sample).filter(|(_, event)| told.insert(**event)) {
        files.push((format!("events/{}.geojson", event_name(events, *event)), sample.truth.encode().map_err(codec)?));
    }
    files.push(("index.csv".to_owned(), index.to_csv().map_err(codec)?));
    let description = "Tiles of simulated rockfall surveys in a wall frame; see README.md.";
    files.push(("stac/catalog.json".to_owned(), catalogue::root(&params.title, description, &ids)));
    files.extend(items);
    files.push(("README.md".to_owned(), card(params, samples, index)));
    files.sort();
    let sums = checksums::list(&files);
    files.push(("SHA256SUMS".to_owned(), sums.into_bytes()));
    Ok(files)
}

/// Role, media type, place and content of the files of a tile.
type Asset = (&'static str, &'static str, String, Vec<u8>);

pub(super) fn arrays(
    params: &ExportDatasetParams,
    sample: &Scored,
    tile: &Tile,
    stem: &str,
) -> Result<Vec<Asset>, StageError> {
    let whole = sample.difference;
    let scene = sample.scene();
    let own = tile.grid(&whole.grid);
    let instances = tile.cut(&whole.grid, &sample.instances);
    let mask: Vec<u8> = instances.iter().map(|id| u8::from(*id > 0)).collect();
    let floats = [("difference", scene.difference), ("reference", scene.reference), ("comparison", scene.comparison)];
    let mut made = Vec::new();
    if params.formats.contains(&Format::Npz) {
        let shape = [tile.side, tile.side];
        let transform = vec![own.cell_m, 0.0, own.left_m, 0.0, -own.cell_m, own.top_m];
        let mut list: Vec<(&str, &[usize], Array)> = floats
            .iter()
            .map(|(name, values)| (*name, &shape[..], Array::Floats(tile.cut(&whole.grid, values))))
            .collect();
        list.push(("mask", &shape, Array::Bytes(mask.clone())));
        list.push(("instances", &shape, Array::Words(instances.clone())));
        list.push(("transform", &[6], Array::Doubles(transform)));
        let bytes = npz::write(&list)?;
        made.push(("npz", "application/x-npz", format!("{stem}.npz"), bytes));
    }
    if params.formats.contains(&Format::Geotiff) {
        let labels = |name: &str, sample: Sample, values: Vec<f32>| {
            let mut raster = Raster::single(own, whole.frame, "label", name, values);
            raster.sample = sample;
            raster
        };
        let mut rasters: Vec<(&'static str, Raster)> =
            floats.iter().map(|(name, values)| (*name, tile.raster(whole, name, values))).collect();
        rasters.push(("mask", labels("mask", Sample::Byte, mask.iter().map(|m| f32::from(*m)).collect())));
        rasters
            .push(("instances", labels("instances", Sample::Word, instances.iter().map(|i| f32::from(*i)).collect())));
        for (name, raster) in rasters {
            let bytes = raster.encode().map_err(|e| StageError::new(e.to_string()))?;
            made.push((name, "image/tiff; application=geotiff", format!("{stem}_{name}.tif"), bytes));
        }
    }
    Ok(made)
}

pub(super) fn item(
    params: &ExportDatasetParams,
    events: &Events,
    pick: &Pick,
    sample: &Scored,
    id: &str,
    made: &[Asset],
) -> Vec<u8> {
    let event = events.of_sample[pick.sample];
    let mut properties = Map::new();
    let point: Map<String, Value> = sample.point.iter().map(|(axis, item)| (axis.clone(), json!(item))).collect();
    properties.insert("rockface:split".into(), json!(PARTS[pick.part]));
    properties.insert("rockface:event".into(), json!(event_name(events, event)));
    properties.insert("rockface:point".into(), Value::Object(point));
    properties.insert("rockface:changed_cells".into(), json!(pick.tile.changed));
    properties.insert("rockface:instances".into(), json!(pick.tile.instances));
    let assets =
        made.iter().map(|(role, media, place, bytes)| (*role, place.as_str(), *media, bytes.as_slice())).collect();
    catalogue::item(&catalogue::Item {
        id,
        grid: pick.tile.grid(&sample.difference.grid),
        frame: sample.difference.frame,
        datetime: &catalogue::date(params.first_day + event as i64),
        properties,
        assets,
    })
}

pub(super) fn card(params: &ExportDatasetParams, samples: &[Scored], index: &Table) -> Vec<u8> {
    let split = match params.split {
        SplitBy::Event => {
            format!("by event ({}): all draws and tiles of an event are in one part", params.event_axes.join(", "))
        }
        SplitBy::Place => "by place: the face is cut along X, tiles on a cut are left out".to_owned(),
    };
    let which = match params.negatives {
        Negatives::Hard => "those with the largest mean apparent loss",
        Negatives::Random => "drawn",
    };
    let ratio = params
        .negatives_per_positive
        .map_or("all".to_owned(), |ratio| format!("up to {ratio} for each tile with change"));
    let formats: Vec<&str> = params.formats.iter().map(|f| if *f == Format::Npz { "NPZ" } else { "GeoTIFF" }).collect();
    let facts = Facts {
        title: &params.title,
        licence: &params.licence,
        side: params.tile_cells as usize,
        cell_m: samples.first().map_or(f64::NAN, |sample| sample.difference.grid.cell_m),
        split,
        negatives: format!("{ratio}, {which}"),
        formats: formats.join(", "),
    };
    card::write(&facts, index)
}
