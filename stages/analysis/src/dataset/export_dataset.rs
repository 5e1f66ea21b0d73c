//! `export-dataset`: cuts comparisons into labelled tiles for training, with split, balance, catalogue and card.

use crate::dataset::outlines;
use crate::dataset::split::PARTS;
use rockface_core::artefact::{Cell, Files, Inventory, Kind, Table};
use rockface_core::names::twice;
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, params};

mod choice;
mod files;
mod leaks;
mod sources;
mod truths;

choice! {
    /// What no two parts share.
    pub enum SplitBy {
        /// Events: all draws of noise and all tiles of one are in one part.
        Event = "event",
        /// Places: the face is cut along X into strips; a tile lies within one.
        Place = "place",
    }
}

choice! {
    /// How events are dealt to the parts.
    pub enum Dealing {
        /// Each by a number drawn for its items: in a larger data set it is for the same part; the shares hold on average.
        Stable = "stable",
        /// Shuffled and dealt by the shares, which hold as well as whole numbers can; in a larger data set events change parts.
        Exact = "exact",
    }
}

choice! {
    /// What becomes of a border that is narrower than a stride.
    pub enum Border {
        /// The last tile is pushed back until it fits, and overlaps the one before it.
        Shift = "shift",
        /// It is left out.
        Drop = "drop",
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

/// The first day of the year 0 and the last of 9999, in days after 1970-01-01: those a date in a catalogue can be.
const FIRST_DAY: i64 = -719_528;
const LAST_DAY: i64 = 2_932_896;

params! {
    /// Parameters of `export-dataset`.
    pub struct ExportDatasetParams {
        /// Cells along the side of a tile.
        tile_cells: u32 = 128; Range::Between(4.0, 4096.0),
        /// Cells from one tile to the next; less than a tile: they overlap.
        stride_cells: u32 = 128; Range::Between(1.0, 4096.0),
        /// What becomes of a border that is narrower than a stride.
        border: Border = Border::Shift,
        /// Least share of the cells of a tile that have a difference.
        least_valid_share: f64 = 0.5; Range::Between(0.0, 1.0),
        /// Least cells of true change that have a difference, of a tile with change; tiles with fewer but some change are left out.
        least_changed_cells: u32 = 1; Range::AtLeast(1.0),
        /// What no two parts share.
        split: SplitBy = SplitBy::Event,
        /// Shares of the parts.
        shares: Shares = Shares::default(),
        /// How events are dealt to the parts.
        dealing: Dealing = Dealing::Stable,
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
        /// Text before the names of all files (tiles, events, index, sums, card, catalogue), so that data sets of several seeds go into one
        /// folder: letters, digits, `-`, `_`.
        prefix: String = String::new(),
        /// Title of the data set.
        title: String = "Simulated rockfall change detection".to_owned(),
        /// Its licence, as hubs name it.
        licence: String = "cc-by-4.0".to_owned(),
        /// Day of the first event in the catalogue, in days after 1970-01-01; later ones follow day by day.
        first_day: i64 = 20454; Range::Between(FIRST_DAY as f64, LAST_DAY as f64),
    }
}

/// Cuts comparisons into labelled tiles for training change detection.
pub struct ExportDataset;

impl Stage for ExportDataset {
    type Params = ExportDatasetParams;
    const NAME: &'static str = "export-dataset";
    const VERSION: u32 = 4;
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
        if let Some(format) = twice(params.formats.iter().map(|format| *format == Format::Npz).collect()) {
            faults.push(at("formats", &format!("`{}` is there twice", if format { "npz" } else { "geotiff" })));
        }
        if !params.prefix.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_') || params.prefix.len() > 40
        {
            faults.push(at("prefix", "up to 40 letters, digits, `-` and `_` are expected: it begins names of files"));
        }
        if params.shares.train + params.shares.validation + params.shares.test <= 0.0 {
            faults.push(at("shares", "one of the shares must be more than 0"));
        }
        faults
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let samples = sources::samples(params, inputs)?;
        let events = choice::events(params, &samples, context);
        let last = params.first_day.saturating_add(events.points.len() as i64 - 1);
        if last > LAST_DAY {
            let text =
                format!("{} events from day {} on go beyond the year 9999", events.points.len(), params.first_day);
            return Err(StageError::new(text).hint("lower `first_day`"));
        }
        leaks::check(params, &samples, &events)?;
        let draws = context.stream("tiles", "").field();
        let mut picks = choice::choose(params, &samples, &events, draws)?;
        picks.sort_by_key(|pick| (pick.part, pick.sample, pick.tile.corner));
        let truths = truths::truths(params, &samples, &events)?;
        let chosen = files::Chosen { samples: &samples, events: &events, truths: &truths, picks: &picks };
        let index = files::index(params, &chosen);
        let files = files::files(params, &chosen, &index, context)?;
        warn_of_coarse_truth(&samples, context);
        report(params, &chosen, &index, context);
        Ok(Outputs::of("dataset", Files { files }).and("index", index))
    }
}

/// Warns once where outlines were drawn on larger cells than those of the difference.
fn warn_of_coarse_truth(samples: &[sources::Scored], context: &Context) {
    let mut asked: Vec<&Inventory> = Vec::new();
    let mut worst: Option<(f64, f64)> = None;
    for sample in samples {
        let cell_m = sample.difference.grid.cell_m;
        if asked.iter().any(|known| std::ptr::eq(*known, sample.truth)) {
            continue;
        }
        asked.push(sample.truth);
        let step_m = outlines::step_m(sample.truth).filter(|step_m| *step_m > 1.001 * cell_m);
        worst = step_m.map(|step_m| (step_m, cell_m)).into_iter().chain(worst).max_by(|a, b| a.0.total_cmp(&b.0));
    }
    if let Some((step_m, cell_m)) = worst {
        context.warn(format!(
            "the outlines of the truth are in steps of {step_m:.4} m, cells are {cell_m} m: masks are as coarse as the outlines; give \
             `remove-blocks` `cell_m: {cell_m}`"
        ));
    }
}

fn report(params: &ExportDatasetParams, chosen: &files::Chosen, index: &Table, context: &Context) {
    let [split, changed] = ["split", "changed_valid_cells"].map(|name| index.column(name).unwrap_or_default());
    let count = |part: &str, has_change: bool| {
        let is =
            |row: &&Vec<Cell>| row[split].text() == Some(part) && (row[changed].number() > Some(0.0)) == has_change;
        index.rows.iter().filter(is).count()
    };
    let told: Vec<String> =
        PARTS.iter().map(|part| format!("{part} {} + {}", count(part, true), count(part, false))).collect();
    let shares = choice::shares(params);
    for (number, part) in PARTS.iter().enumerate().filter(|(number, _)| shares[*number] > 0.0) {
        if count(part, true) > 0 {
            continue;
        }
        let narrow = choice::narrow(params, chosen.samples, number);
        context.warn(narrow.unwrap_or_else(|| {
            let more = if params.split == SplitBy::Event { ", or more events" } else { "" };
            format!("no tile with change is for {part}: give it a larger share{more}")
        }));
    }
    context.metric("tiles", index.rows.len() as f64, "1");
    context.headline(format!("{} tiles, with + without change: {}", index.rows.len(), told.join(", ")));
}

#[cfg(test)]
mod tests;
