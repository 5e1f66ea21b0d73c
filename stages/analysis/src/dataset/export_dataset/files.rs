//! The files of a data set: tiles, index, truth, catalogue, card, checksums.

use serde_json::{Map, Value, json};

use super::choice::{Events, Pick};
use super::sources::Scored;
use super::truths::Truths;
use super::{Border, Dealing, ExportDatasetParams, Format, Negatives, SplitBy};
use crate::dataset::card;
use crate::dataset::card::Facts;
use crate::dataset::npz;
use crate::dataset::npz::Array;
use crate::dataset::split::PARTS;
use crate::dataset::tiles;
use crate::dataset::tiles::Tile;
use crate::dataset::{catalogue, checksums};
use rockface_core::artefact::{Cell, Frame, Noun, Raster, Sample, Table};
use rockface_core::{Context, StageError};

/// The name of a tile: the prefix, its number, its point, its corner.
pub(super) fn name(params: &ExportDatasetParams, number: usize, sample: &Scored, tile: &Tile) -> String {
    let plain = |text: &str| text.chars().filter(char::is_ascii_alphanumeric).take(12).collect::<String>();
    let point: String =
        sample.point.iter().take(3).map(|(axis, item)| format!("_{}{}", plain(axis), plain(item))).collect();
    format!("{}{number:06}{point}_r{:05}_c{:05}", params.prefix, tile.corner[0], tile.corner[1])
}

pub(super) fn event_name(params: &ExportDatasetParams, events: &Events, event: usize) -> String {
    let plain = |text: &str| text.chars().filter(char::is_ascii_alphanumeric).take(20).collect::<String>();
    let point: String =
        events.points[event].iter().take(3).map(|(axis, item)| format!("_{}{}", plain(axis), plain(item))).collect();
    format!("{}{event:05}{point}", params.prefix)
}

/// What tiles, events and truths are told by.
pub(super) struct Chosen<'a> {
    pub(super) samples: &'a [Scored<'a>],
    pub(super) events: &'a Events,
    pub(super) truths: &'a Truths,
    pub(super) picks: &'a [Pick],
}

const FIXED: [&str; 16] = [
    "tile",
    "split",
    "event",
    "truth",
    "sequence",
    "row",
    "column",
    "left_m",
    "top_m",
    "cell_m",
    "side_cells",
    "valid_cells",
    "changed_cells",
    "changed_valid_cells",
    "instances",
    "apparent_loss_m",
];

pub(super) fn index(params: &ExportDatasetParams, chosen: &Chosen) -> Table {
    let axes = rockface_raster::feature_rows::axes(chosen.samples.iter().map(|sample| sample.point));
    let mut table =
        Table::new(FIXED.iter().map(ToString::to_string).chain(axes.iter().map(|axis| format!("axis_{axis}"))));
    for (number, pick) in chosen.picks.iter().enumerate() {
        let (sample, tile) = (&chosen.samples[pick.sample], &pick.tile);
        let own = tile.grid(&sample.difference.grid);
        let order = params
            .sequence_axis
            .as_ref()
            .map_or(Cell::Empty(()), |axis| rockface_raster::feature_rows::item_cell(sample.point, axis));
        let event = event_name(params, chosen.events, chosen.events.of_sample[pick.sample]);
        let truth = chosen.truths.of(pick.sample).0.as_str();
        let mut row: Vec<Cell> = vec![name(params, number, sample, tile).into(), PARTS[pick.part].into()];
        row.extend([event.into(), truth.into(), order]);
        let numbers = [
            tile.corner[0] as f64,
            tile.corner[1] as f64,
            own.left_m,
            own.top_m,
            own.cell_m,
            tile.side as f64,
            tile.valid as f64,
            tile.changed as f64,
            tile.changed_valid as f64,
            tile.instances as f64,
            tile.apparent_loss_m,
        ];
        row.extend(numbers.map(Cell::from));
        row.extend(axes.iter().map(|axis| rockface_raster::feature_rows::item_cell(sample.point, axis)));
        table.push(row);
    }
    table
}

/// Place in the data set and content.
pub(super) type File = (String, Vec<u8>);

pub(super) fn files(
    params: &ExportDatasetParams,
    chosen: &Chosen,
    index: &Table,
    context: &Context,
) -> Result<Vec<File>, StageError> {
    let codec = |e: rockface_core::artefact::CodecError| StageError::new(e.to_string());
    let mut files: Vec<File> = chosen.truths.files.clone();
    let mut items = Vec::new();
    let mut ids = Vec::new();
    for (number, pick) in chosen.picks.iter().enumerate() {
        context.check_cancelled()?;
        let sample = &chosen.samples[pick.sample];
        let name = name(params, number, sample, &pick.tile);
        let stem = format!("tiles/{}/{name}", PARTS[pick.part]);
        let made = arrays(params, sample, &pick.tile, &stem)?;
        items.push((format!("stac/items/{name}.json"), item(params, chosen, pick, &name, &made)));
        files.extend(made.into_iter().map(|(_, _, place, bytes)| (place, bytes)));
        ids.push(name);
    }
    let prefix = &params.prefix;
    files.push((format!("{prefix}index.csv"), index.to_csv().map_err(codec)?));
    let description =
        format!("Tiles of simulated rockfall surveys in {}; see {prefix}README.md.", frames(chosen.samples));
    let id = format!("{prefix}rockface-dataset");
    let root = root(params);
    files.push((format!("stac/{root}"), catalogue::root(&root, &id, &params.title, &description, &ids)));
    files.extend(items);
    files.push((format!("{prefix}README.md"), card(params, chosen, index)));
    files.sort();
    let sums = checksums::list(&files);
    files.push((format!("{prefix}SHA256SUMS"), sums.into_bytes()));
    Ok(files)
}

/// The name of the file of the root of the catalogue.
fn root(params: &ExportDatasetParams) -> String {
    format!("{}catalog.json", params.prefix)
}

/// What coordinates are in, in words.
fn frames(samples: &[Scored]) -> String {
    let told = |frame: Frame| match frame.crs() {
        Some(crs) => crs.to_string(),
        None => format!("the {frame} frame"),
    };
    listed(samples.iter().map(|sample| told(sample.difference.frame)))
}

/// Each of some words once, in the order they are met.
fn listed(words: impl Iterator<Item = String>) -> String {
    let mut known: Vec<String> = Vec::new();
    words.for_each(|word| {
        if !known.contains(&word) {
            known.push(word);
        }
    });
    match known.split_last() {
        Some((last, others)) if !others.is_empty() => format!("{} and {last}", others.join(", ")),
        _ => known.concat(),
    }
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

pub(super) fn item(params: &ExportDatasetParams, chosen: &Chosen, pick: &Pick, id: &str, made: &[Asset]) -> Vec<u8> {
    let sample = &chosen.samples[pick.sample];
    let event = chosen.events.of_sample[pick.sample];
    let (truth, truth_bytes) = chosen.truths.of(pick.sample);
    let mut properties = Map::new();
    let point: Map<String, Value> = sample.point.iter().map(|(axis, item)| (axis.clone(), json!(item))).collect();
    properties.insert("rockface:split".into(), json!(PARTS[pick.part]));
    properties.insert("rockface:event".into(), json!(event_name(params, chosen.events, event)));
    properties.insert("rockface:truth".into(), json!(truth));
    properties.insert("rockface:point".into(), Value::Object(point));
    properties.insert("rockface:changed_cells".into(), json!(pick.tile.changed));
    properties.insert("rockface:changed_valid_cells".into(), json!(pick.tile.changed_valid));
    properties.insert("rockface:instances".into(), json!(pick.tile.instances));
    let mut assets: Vec<(&str, &str, &str, &[u8])> =
        made.iter().map(|(role, media, place, bytes)| (*role, place.as_str(), *media, bytes.as_slice())).collect();
    assets.push(("truth", truth.as_str(), "application/geo+json", truth_bytes.as_slice()));
    catalogue::item(&catalogue::Item {
        id,
        grid: pick.tile.grid(&sample.difference.grid),
        frame: sample.difference.frame,
        root: &root(params),
        datetime: &catalogue::date(params.first_day + event as i64),
        properties,
        assets,
    })
}

pub(super) fn card(params: &ExportDatasetParams, chosen: &Chosen, index: &Table) -> Vec<u8> {
    let split = match params.split {
        SplitBy::Event => {
            let dealt = match params.dealing {
                Dealing::Stable => {
                    let kept = "each is dealt by a number of its own and stays in its part when the data set grows";
                    format!("{kept}{}", lent(params, chosen.events))
                }
                Dealing::Exact => {
                    "they are shuffled and dealt by the shares, and change parts when the data set grows".to_owned()
                }
            };
            let axes = params.event_axes.join(", ");
            format!("by event ({axes}): all draws and tiles of an event are in one part; {dealt}")
        }
        SplitBy::Place => "by place: the face is cut along X into strips, and tiles lie within one".to_owned(),
    };
    let which = match params.negatives {
        Negatives::Hard => "those with the largest mean apparent loss",
        Negatives::Random => "drawn",
    };
    let ratio = params
        .negatives_per_positive
        .map_or("all".to_owned(), |ratio| format!("up to {ratio} for each tile with change"));
    let formats: Vec<&str> = params.formats.iter().map(|f| if *f == Format::Npz { "NPZ" } else { "GeoTIFF" }).collect();
    let overlap = if params.stride_cells < params.tile_cells {
        Some("Neighbouring tiles overlap.")
    } else if params.border == Border::Shift {
        Some(
            "The last tiles of a row or column of tiles overlap those before them, where the width is no multiple of a tile.",
        )
    } else {
        None
    };
    let facts = Facts {
        title: &params.title,
        prefix: &params.prefix,
        licence: &params.licence,
        side: params.tile_cells as usize,
        cells_m: listed(chosen.samples.iter().map(|sample| sample.difference.grid.cell_m.to_string())),
        frame: frames(chosen.samples),
        is_wall: chosen.samples.iter().all(|sample| sample.difference.frame == Frame::Wall),
        distinct: [0, 1, 2].map(|part| distinct(chosen, part)),
        overlap,
        split,
        negatives: format!("{ratio}, {which}"),
        formats: formats.join(", "),
    };
    card::write(&facts, index)
}

/// The events that may change parts all the same, in words.
fn lent(params: &ExportDatasetParams, events: &Events) -> String {
    let told = |event: &usize| {
        let (name, part) = (event_name(params, events, *event), PARTS[events.parts[*event]]);
        format!(", but for {name}, lent to {part} because nothing else would be in it")
    };
    events.lent.iter().map(told).collect()
}

/// Cells in the tiles of a part, those of overlapping tiles once.
fn distinct(chosen: &Chosen, part: usize) -> usize {
    let of = |number: usize, sample: &Scored| {
        let own = chosen.picks.iter().filter(|pick| pick.part == part && pick.sample == number);
        tiles::covered(&sample.difference.grid, own.map(|pick| &pick.tile))
    };
    chosen.samples.iter().enumerate().map(|(number, sample)| of(number, sample)).sum()
}
