//! `export-dataset`: cuts comparisons into labelled tiles for training, with split, balance, catalogue and card.

use serde_json::{Map, Value, json};

use crate::artefact::{Cell, Files, Inventory, Kind, Noun, Raster, Sample, Table};
use crate::kernel::dataset::card::{self, Facts};
use crate::kernel::dataset::npz::{self, Array};
use crate::kernel::dataset::split::{self, PARTS};
use crate::kernel::dataset::tiles::{self, Scene, Tile};
use crate::kernel::dataset::{catalogue, checksums};
use crate::kernel::detection::compared;
use crate::kernel::grid;
use crate::kernel::random::Field;
use crate::params::{Fault, Range};
use crate::{Context, Inputs, Outputs, Page, Point, Port, Stage, StageError, choice, fail, params};

choice! {
    /// What no two parts share.
    pub enum SplitBy {
        /// Events: all draws of noise and all tiles of one are in one part.
        Event = "event",
        /// Places: the face is cut along X; tiles on a cut are left out.
        Place = "place",
    }
}

choice! {
    /// Which tiles without change are taken.
    pub enum Negatives {
        /// Those that pretend to the largest losses.
        Hard = "hard",
        /// Any, drawn.
        Random = "random",
    }
}

choice! {
    /// A format of tiles.
    pub enum Format {
        /// One NumPy archive a tile.
        Npz = "npz",
        /// One file an array.
        Geotiff = "geotiff",
    }
}

params! {
    /// Shares of the parts; they need not sum to 1.
    pub struct Shares {
        /// Training.
        train: f64 = 0.7; Range::NonNegative,
        /// Validation.
        validation: f64 = 0.15; Range::NonNegative,
        /// Test.
        test: f64 = 0.15; Range::NonNegative,
    }
}

params! {
    /// Parameters of `export-dataset`.
    pub struct ExportDatasetParams {
        /// Cells along the side of a tile.
        tile_cells: u32 = 128; Range::Between(4.0, 4096.0),
        /// Cells from one tile to the next; less than a tile: they overlap.
        stride_cells: u32 = 128; Range::Between(1.0, 4096.0),
        /// Least share of the cells of a tile that have a difference.
        least_valid_share: f64 = 0.5; Range::Between(0.0, 1.0),
        /// Least cells of true change of a tile with change; tiles with fewer but some are left out.
        least_changed_cells: u32 = 1; Range::AtLeast(1.0),
        /// What no two parts share.
        split: SplitBy = SplitBy::Event,
        /// Shares of the parts.
        shares: Shares = Shares { train: 0.7, validation: 0.15, test: 0.15 },
        /// Axes whose items make an event; other gathered axes are draws of it.
        event_axes: Vec<String> = vec!["epoch".to_owned()],
        /// Axis along which events follow each other in time; null: they do not.
        sequence_axis: Option<String> = None,
        /// Tiles without change for each tile with one, in each part; null: all there are.
        negatives_per_positive: Option<f64> = Some(1.0); Range::NonNegative,
        /// Which tiles without change are taken.
        negatives: Negatives = Negatives::Hard,
        /// Formats.
        formats: Vec<Format> = vec![Format::Npz, Format::Geotiff],
        /// Title of the data set.
        title: String = "Simulated rockfall change detection".to_owned(),
        /// Its licence, as hubs name it.
        licence: String = "cc-by-4.0".to_owned(),
        /// Day of the first event in the catalogue, in days after 1970-01-01; later ones follow day by day.
        first_day: i64 = 20454,
    }
}

/// The stage.
pub struct ExportDataset;

impl Stage for ExportDataset {
    type Params = ExportDatasetParams;
    const NAME: &'static str = "export-dataset";
    const VERSION: u32 = 1;
    const PAGE: Page = Page {
        what: "Cuts comparisons into tiles for training change detection: difference, elevations before and after, masks of change and of its \
               instances, as NumPy archives and GeoTIFF, split into training, validation and test, with tiles without change, an index, the \
               ground truth, checksums, a STAC catalogue and a data set card.",
        method: "Gather `difference`, `reference` and `comparison` over the same axes, `truth` over those of them it depends on. Events are shuffled \
                 and dealt out by shares, or the face is cut along X, so that no event or no place is in two parts. Tiles without change are those \
                 with the largest mean apparent loss, or drawn, as many as the ratio says of those in each part. A survey of an unchanged face has \
                 an empty truth (`select-features` with `count: 0`). Masks hold the cells whose centres lie in the outlines of the truth.",
        frames: "Metres in the frame of the rasters; row 0 at the top; difference = comparison - reference. docs/dataset.md has a PyTorch data set.",
        fails: "Rasters of one point on different grids, or none for a point; a truth without whole numbers `id`; a tile larger than the rasters; \
                an axis that nothing is gathered over; no tile with change.",
        example: "\
rockface: 1
name: small-dataset
seed: 3
axes: {epoch: {count: 3}}
steps:
  face:    {stage: synthesise-face, with: {width_m: 4, height_m: 3, spacing_m: 0.05}}
  blocks:  {stage: generate-blocks, over: [epoch]}
  fallen:  {stage: remove-blocks, in: {mesh: face.mesh, blocks: blocks.blocks}, with: {count: 3, cell_m: 0.02, min_volume_m3: 0.002}}
  before:  {stage: rasterise-dem, over: [epoch], with: {cell_m: 0.02, method: tin, window_m: [-2, 2, -1.5, 1.5]}, in: {surface: face.mesh}}
  after:   {stage: rasterise-dem, with: {method: tin}, in: {surface: fallen.mesh, grid: before.raster}}
  change:  {stage: difference-dem, in: {reference: before.raster, comparison: after.raster}}
  dataset:
    stage: export-dataset
    with: {tile_cells: 64, stride_cells: 64}
    in:
      difference: {each: change.raster, over: [epoch]}
      reference: {each: before.raster, over: [epoch]}
      comparison: {each: after.raster, over: [epoch]}
      truth: {each: fallen.truth, over: [epoch]}
",
    };
    const INPUTS: &'static [Port] = &[
        Port::many("difference", &[Kind::Raster], "Differences, gathered over events and draws."),
        Port::many("reference", &[Kind::Raster], "Elevations before, gathered over the same or fewer axes."),
        Port::many("comparison", &[Kind::Raster], "Elevations after, gathered over the same or fewer axes."),
        Port::many("truth", &[Kind::Inventory], "What changed, gathered over the same or fewer axes."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("dataset", &[Kind::Files], "The data set: laid out as a folder in the run."),
        Port::one("index", &[Kind::Table], "One row a tile."),
    ];

    fn draws(_params: &Self::Params) -> bool {
        true
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        let at = |name: &str, text: &str| Fault { path: vec![name.to_owned()], ..Fault::new(text) };
        let mut faults = Vec::new();
        if params.formats.is_empty() {
            faults.push(at("formats", "at least one format is needed"));
        }
        if params.shares.train + params.shares.validation + params.shares.test <= 0.0 {
            faults.push(at("shares", "one of the shares must be more than 0"));
        }
        faults
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let samples = samples(params, inputs)?;
        let events = events(params, &samples, context);
        let draws = context.stream("tiles", "").field();
        let mut chosen = choose(params, &samples, &events, draws)?;
        chosen.sort_by_key(|pick| (pick.part, pick.sample, pick.tile.corner));
        let index = index(params, &samples, &events, &chosen);
        let files = files(params, &samples, &events, &chosen, &index, context)?;
        report(&index, context);
        Ok(Outputs::of("dataset", Files { files }).and("index", index))
    }
}

/// One comparison.
struct Scored<'a> {
    point: &'a Point,
    difference: &'a Raster,
    reference: &'a Raster,
    comparison: &'a Raster,
    truth: &'a Inventory,
    instances: Vec<u16>,
}

impl Scored<'_> {
    fn scene(&self) -> Scene<'_> {
        Scene {
            grid: &self.difference.grid,
            difference: &self.difference.bands[0].values,
            reference: &self.reference.bands[0].values,
            comparison: &self.comparison.bands[0].values,
            instances: &self.instances,
        }
    }
}

/// A tile that is taken.
struct Pick {
    sample: usize,
    part: usize,
    tile: Tile,
}

/// The events, in the order they are first met.
struct Events {
    /// Items of the axes that make them.
    points: Vec<Point>,
    /// Event of each sample.
    of_sample: Vec<usize>,
    /// Part of each event, where events are split.
    parts: Vec<usize>,
}

fn samples<'a>(params: &ExportDatasetParams, inputs: &'a Inputs) -> Result<Vec<Scored<'a>>, StageError> {
    let axes = crate::kernel::gathered::axes(inputs.elements("difference").iter().map(|element| &element.point));
    for axis in params.event_axes.iter().chain(&params.sequence_axis) {
        if !axes.contains(axis) {
            let known = if axes.is_empty() { "none".to_owned() } else { axes.join(", ") };
            fail!("nothing is gathered over the axis `{axis}`; there are {known}");
        }
    }
    let differences = inputs.many::<Raster>("difference")?;
    let (references, comparisons) = (inputs.many::<Raster>("reference")?, inputs.many::<Raster>("comparison")?);
    let truths = inputs.many::<Inventory>("truth")?;
    let sample = |(point, difference): &(&'a Point, &'a Raster)| {
        let reference = matching("reference", point, &references)?;
        let comparison = matching("comparison", point, &comparisons)?;
        let truth = matching("truth", point, &truths)?;
        for (port, raster) in [("difference", *difference), ("reference", reference), ("comparison", comparison)] {
            if raster.bands.len() != 1 || !grid::same(&raster.grid, &difference.grid) {
                let (a, b) = (grid::describe(&raster.grid), grid::describe(&difference.grid));
                fail!(
                    "`{port}`{}: {a}, {} bands; one band on the difference's grid is needed: {b}",
                    place(point),
                    raster.bands.len()
                );
            }
        }
        if truth.frame != difference.frame {
            fail!(
                "the truth{} is in the {} frame, the difference in the {} frame",
                place(point),
                truth.frame,
                difference.frame
            );
        }
        let instances =
            instances(truth, difference).map_err(|e| StageError::new(format!("truth{}: {e}", place(point))))?;
        Ok(Scored { point, difference, reference, comparison, truth, instances })
    };
    differences.iter().map(sample).collect()
}

fn place(point: &Point) -> String {
    point.iter().map(|(axis, item)| format!(" {axis}={item}")).collect()
}

/// The element that agrees with a point on every axis it was gathered over.
fn matching<'a, T>(port: &str, point: &Point, elements: &[(&Point, &'a T)]) -> Result<&'a T, StageError> {
    let agrees = |other: &Point| other.iter().all(|(axis, item)| point.get(axis) == Some(item));
    let found: Vec<&'a T> = elements.iter().filter(|(other, _)| agrees(other)).map(|(_, value)| *value).collect();
    match found.as_slice() {
        [one] => Ok(*one),
        other => fail!("{} elements of `{port}` belong to the difference{}, one is needed", other.len(), place(point)),
    }
}

fn instances(truth: &Inventory, difference: &Raster) -> Result<Vec<u16>, String> {
    let grid = &difference.grid;
    let mut instances = vec![0u16; grid.cells()];
    let cells = compared::cells(truth, grid, &vec![true; grid.cells()]);
    for (cells, id) in cells.into_iter().zip(compared::numbers(truth)) {
        if id.fract() != 0.0 || !(1.0..=f64::from(u16::MAX)).contains(&id) {
            return Err(format!("`id` {id} is no whole number from 1 to {}", u16::MAX));
        }
        cells.into_iter().for_each(|cell| instances[cell] = id as u16);
    }
    Ok(instances)
}

fn events(params: &ExportDatasetParams, samples: &[Scored], context: &Context) -> Events {
    let of = |sample: &Scored| -> Point {
        let own = |axis: &&String| sample.point.contains_key(*axis);
        params.event_axes.iter().filter(own).map(|axis| (axis.clone(), sample.point[axis].clone())).collect()
    };
    let mut points: Vec<Point> = Vec::new();
    let mut of_sample = Vec::new();
    for sample in samples {
        let point = of(sample);
        let number = points.iter().position(|known| *known == point).unwrap_or_else(|| {
            points.push(point);
            points.len() - 1
        });
        of_sample.push(number);
    }
    let draws = context.stream("events", "").field();
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_key(|event| draws.words(*event as i32, 0));
    let mut parts = vec![0; points.len()];
    let dealt = split::parts(points.len(), shares(params));
    order.into_iter().zip(dealt).for_each(|(event, part)| parts[event] = part);
    Events { points, of_sample, parts }
}

fn shares(params: &ExportDatasetParams) -> [f64; 3] {
    [params.shares.train, params.shares.validation, params.shares.test]
}

fn choose(
    params: &ExportDatasetParams,
    samples: &[Scored],
    events: &Events,
    draws: Field,
) -> Result<Vec<Pick>, StageError> {
    let side = params.tile_cells as usize;
    let (mut positive, mut negative) = (Vec::new(), Vec::new());
    for (number, sample) in samples.iter().enumerate() {
        let grid = &sample.difference.grid;
        let found = tiles::tiles(&sample.scene(), side, params.stride_cells as usize);
        if found.is_empty() {
            return Err(StageError::new(format!(
                "a tile of {side} cells does not fit into {} x {} cells{}",
                grid.columns,
                grid.rows,
                place(sample.point)
            ))
            .hint("lower `tile_cells`"));
        }
        for tile in found.into_iter().filter(|t| t.valid as f64 >= params.least_valid_share * (side * side) as f64) {
            let part = match params.split {
                SplitBy::Event => Some(events.parts[events.of_sample[number]]),
                SplitBy::Place => split::by_place(tile.corner[1], side, grid.columns, shares(params)),
            };
            let Some(part) = part else { continue };
            let pick = Pick { sample: number, part, tile };
            if pick.tile.changed >= params.least_changed_cells as usize {
                positive.push(pick);
            } else if pick.tile.changed == 0 {
                negative.push(pick);
            }
        }
    }
    if positive.is_empty() {
        return Err(StageError::new("no tile holds a change").hint("look at truth and differences with `draw-picture`"));
    }
    for part in 0..PARTS.len() {
        let wanted = positive.iter().filter(|pick| pick.part == part).count() as f64;
        let most = params.negatives_per_positive.map_or(usize::MAX, |ratio| (ratio * wanted).round() as usize);
        let (own, others): (Vec<Pick>, Vec<Pick>) = negative.into_iter().partition(|pick| pick.part == part);
        negative = others;
        positive.extend(best(own, most, params.negatives, draws));
    }
    Ok(positive)
}

/// So many tiles without change: the hardest, or drawn.
fn best(mut tiles: Vec<Pick>, most: usize, which: Negatives, draws: Field) -> Vec<Pick> {
    match which {
        Negatives::Hard => tiles.sort_by(|a, b| b.tile.apparent_loss_m.total_cmp(&a.tile.apparent_loss_m)),
        Negatives::Random => tiles.sort_by_key(|pick| {
            let [row, column] = pick.tile.corner;
            draws.words(pick.sample as i32, (row as i32).wrapping_mul(65_537).wrapping_add(column as i32))
        }),
    }
    tiles.truncate(most);
    tiles
}

/// The name of a tile: its number, its point, its corner.
fn name(number: usize, sample: &Scored, tile: &Tile) -> String {
    let plain = |text: &str| text.chars().filter(char::is_ascii_alphanumeric).take(12).collect::<String>();
    let point: String =
        sample.point.iter().take(3).map(|(axis, item)| format!("_{}{}", plain(axis), plain(item))).collect();
    format!("{number:06}{point}_r{:05}_c{:05}", tile.corner[0], tile.corner[1])
}

fn event_name(events: &Events, event: usize) -> String {
    let plain = |text: &str| text.chars().filter(char::is_ascii_alphanumeric).take(20).collect::<String>();
    let point: String =
        events.points[event].iter().take(3).map(|(axis, item)| format!("_{}{}", plain(axis), plain(item))).collect();
    format!("{event:05}{point}")
}

fn index(params: &ExportDatasetParams, samples: &[Scored], events: &Events, chosen: &[Pick]) -> Table {
    let axes = crate::kernel::gathered::axes(samples.iter().map(|sample| sample.point));
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
            .map_or(Cell::Empty(()), |axis| crate::kernel::gathered::item_cell(sample.point, axis));
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
        row.extend(axes.iter().map(|axis| crate::kernel::gathered::item_cell(sample.point, axis)));
        table.push(row);
    }
    table
}

type File = (String, Vec<u8>);

fn files(
    params: &ExportDatasetParams,
    samples: &[Scored],
    events: &Events,
    chosen: &[Pick],
    index: &Table,
    context: &Context,
) -> Result<Vec<File>, StageError> {
    let codec = |e: crate::artefact::CodecError| StageError::new(e.to_string());
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

fn arrays(params: &ExportDatasetParams, sample: &Scored, tile: &Tile, stem: &str) -> Result<Vec<Asset>, StageError> {
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
        let bytes = npz::write(&list).map_err(StageError::new)?;
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

fn item(
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

fn card(params: &ExportDatasetParams, samples: &[Scored], index: &Table) -> Vec<u8> {
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

fn report(index: &Table, context: &Context) {
    let count = |part: &str, changed: bool| {
        let is = |row: &&Vec<Cell>| row[1].text() == Some(part) && (row[11].number() > Some(0.0)) == changed;
        index.rows.iter().filter(is).count()
    };
    let told: Vec<String> =
        PARTS.iter().map(|part| format!("{part} {} + {}", count(part, true), count(part, false))).collect();
    for part in PARTS.iter().filter(|part| count(part, true) == 0) {
        context.warn(format!("no tile with change is for {part}: give it a larger share, or more events"));
    }
    context.metric("tiles", index.rows.len() as f64, "1");
    context.headline(format!("{} tiles, with + without change: {}", index.rows.len(), told.join(", ")));
}

#[cfg(test)]
#[path = "export_dataset_tests.rs"]
mod tests;
