//! `export-dataset`: cuts comparisons into labelled tiles for training, with split, balance, catalogue and card.

use crate::dataset::split::PARTS;
use rockface_core::artefact::{Cell, Files, Kind, Table};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, params};

mod choice;
mod files;
mod sources;

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
        shares: Shares = Shares::default(),
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

/// Cuts comparisons into labelled tiles for training change detection.
pub struct ExportDataset;

impl Stage for ExportDataset {
    type Params = ExportDatasetParams;
    const NAME: &'static str = "export-dataset";
    const VERSION: u32 = 2;
    const PAGE: Page = Page::new(include_str!("export_dataset.md"));
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
        let samples = sources::samples(params, inputs)?;
        let events = choice::events(params, &samples, context);
        let draws = context.stream("tiles", "").field();
        let mut chosen = choice::choose(params, &samples, &events, draws)?;
        chosen.sort_by_key(|pick| (pick.part, pick.sample, pick.tile.corner));
        let index = files::index(params, &samples, &events, &chosen);
        let files = files::files(params, &samples, &events, &chosen, &index, context)?;
        report(&index, context);
        Ok(Outputs::of("dataset", Files { files }).and("index", index))
    }
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
mod tests;
