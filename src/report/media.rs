//! Pictures and figures inside the page, within a budget of bytes.

use std::collections::BTreeMap;

use base64::Engine;
use rockface_cache::OutputRecord;
use rockface_core::artefact::{Artefact, Figure, Kind, Noun};
use serde::Serialize;

use super::number::Shown;
use super::source::Source;
use super::steps::Linker;
use rockface_engine::history::StepDone;

/// Bytes of images in a page at most; what does not fit is linked.
const PAGE_BYTES: usize = 7_000_000;
/// A picture larger than this is shown small and linked.
const PICTURE_BYTES: usize = 2_500_000;
/// Pictures of one output that are shown; a depth map may have a dozen channels.
const CHANNELS: usize = 3;

/// A picture or figure.
#[derive(Debug, Clone, Serialize)]
pub struct Medium {
    /// The quantity that is shown, and what was left out; empty for a picture that a step made to be looked at.
    pub caption: String,
    /// The instance and output it comes from.
    pub from: String,
    /// The instance it comes from.
    pub instance: String,
    /// How many instances are not shown before this one.
    pub gap: String,
    /// The stage that made it, and the beginning of the digest of the output it shows.
    pub made: String,
    /// A figure as it may stand in the page ([`Figure::inside_page`]).
    pub svg: Option<String>,
    /// The address of an image, which holds the image itself.
    pub image: Option<String>,
    /// The whole file in the run folder.
    pub link: Option<String>,
    /// Whether it deserves the whole width.
    pub wide: bool,
    /// Whether a step made it to be looked at; otherwise it is a look at what a step made.
    pub finished: bool,
    /// Whether a picture of another step shows the same.
    pub shown_elsewhere: bool,
    /// What its colours stand for, where it does not say so itself.
    pub colours: Option<Colours>,
}

/// What the two ends of a colour bar stand for.
#[derive(Debug, Clone, Serialize)]
pub struct Colours {
    /// `viridis`, `red_blue`, `grey` or `confusion`.
    pub palette: String,
    /// Values at its ends.
    pub low: Shown,
    /// Values at its ends.
    pub high: Shown,
    /// The unit of both values.
    pub unit: String,
}

/// Pixels from which on a picture or figure gets the whole width.
const WIDE_PX: u32 = 1500;
const WIDE_FIGURE_PX: u32 = 760;

/// The width of a PNG file, pixels.
fn width_px(png: &[u8]) -> u32 {
    png.get(16..20).and_then(|bytes| bytes.try_into().ok()).map_or(0, u32::from_be_bytes)
}

/// The width an SVG states for itself, pixels.
fn figure_width_px(svg: &str) -> u32 {
    let head = svg.split('>').next().unwrap_or_default();
    let width = head.split(" width=\"").nth(1).and_then(|rest| rest.split(['"', '.', 'p']).next());
    width.and_then(|width| width.parse().ok()).unwrap_or(0)
}

/// Hands out the bytes there are for images.
#[derive(Debug)]
pub struct Budget {
    left: usize,
    /// How many images did not fit.
    pub refused: usize,
}

impl Budget {
    /// The budget of a page.
    pub fn new() -> Self {
        Self { left: PAGE_BYTES, refused: 0 }
    }

    fn take(&mut self, bytes: usize) -> bool {
        let fits = bytes <= self.left;
        if fits {
            self.left -= bytes;
        } else {
            self.refused += 1;
        }
        fits
    }
}

/// The pictures of one instance: those it made, then those its log keeps of its other outputs.
pub fn of(source: &Source, done: &StepDone, linker: &Linker, budget: &mut Budget) -> Vec<Medium> {
    let mut found = finished_of(source, done, linker, budget);
    let mut shown: BTreeMap<String, usize> = BTreeMap::new();
    for preview in source.previews(done) {
        let from = format!("{}.{}", done.label(), preview.port);
        let count = shown.entry(from.clone()).or_default();
        let is_finished = found.iter().any(|medium| medium.from == from && medium.caption.is_empty());
        if is_finished || *count >= CHANNELS || !budget.take(preview.png.len()) {
            continue;
        }
        *count += 1;
        let output = done.outputs.iter().flatten().find(|(port, _)| port.as_str() == preview.port);
        found.push(Medium {
            caption: preview.caption,
            made: made(done, output),
            from,
            instance: done.label(),
            gap: String::new(),
            svg: None,
            image: Some(data("image/png", &preview.png)),
            link: linker.output(done, &preview.port),
            wide: false,
            finished: false,
            shown_elsewhere: output.is_some_and(|(_, output)| linker.drawn.contains(&output.digest)),
            colours: preview.colours.map(|key| Colours {
                palette: key.palette,
                low: Shown::of_json(&key.low.into()),
                high: Shown::of_json(&key.high.into()),
                unit: key.unit,
            }),
        });
    }
    found
}

/// What leads from a picture to its making: `rockface inspect` takes the digest.
fn made<T>(done: &StepDone, output: Option<(T, &OutputRecord)>) -> String {
    let digest = output.map_or_else(String::new, |(_, output)| format!(" · {}", output.digest.short()));
    format!("{} {}{digest}", done.stage, done.version)
}

/// The pictures and figures that one instance made.
pub fn finished_of(source: &Source, done: &StepDone, linker: &Linker, budget: &mut Budget) -> Vec<Medium> {
    let outputs = done.outputs.iter().flatten();
    outputs.filter_map(|(port, output)| finished(source, done, port, output, linker, budget)).collect()
}

/// A picture or figure that a step made.
fn finished(
    source: &Source,
    done: &StepDone,
    port: &str,
    output: &OutputRecord,
    linker: &Linker,
    budget: &mut Budget,
) -> Option<Medium> {
    let kind: Kind = output.kind.parse().ok()?;
    if !matches!(kind, Kind::Picture | Kind::Figure) || !output.kept {
        return None;
    }
    let bytes = source.output(done, port, output)?;
    let mut medium = Medium {
        caption: String::new(),
        from: format!("{}.{port}", done.label()),
        instance: done.label(),
        gap: String::new(),
        made: made(done, Some((port, output))),
        svg: None,
        image: None,
        link: linker.output(done, port),
        wide: true,
        finished: true,
        shown_elsewhere: false,
        colours: None,
    };
    if kind == Kind::Figure {
        let figure = Figure::decode(&bytes).ok()?;
        let inside = figure.inside_page();
        if !budget.take(inside.as_ref().map_or(bytes.len(), String::len)) {
            return None;
        }
        if let Some(svg) = inside {
            medium.wide = figure_width_px(&svg) > WIDE_FIGURE_PX;
            medium.svg = Some(svg);
        } else {
            medium.image = Some(data("image/svg+xml", &bytes));
        }
        return Some(medium);
    }
    medium.wide = width_px(&bytes) >= WIDE_PX;
    let small = || source.look.preview(&Artefact::decode(kind, &bytes).ok()?, &[])?.to_png().ok();
    let shown = if bytes.len() > PICTURE_BYTES { small()? } else { bytes };
    if !budget.take(shown.len()) {
        return None;
    }
    medium.image = Some(data("image/png", &shown));
    Some(medium)
}

fn data(kind: &str, bytes: &[u8]) -> String {
    format!("data:{kind};base64,{}", base64::engine::general_purpose::STANDARD.encode(bytes))
}
