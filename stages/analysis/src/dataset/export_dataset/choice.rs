//! Which tiles are taken, and into which part each goes.

use std::ops::Range;

use super::sources::{Scored, place};
use super::{Border, Dealing, ExportDatasetParams, Negatives, SplitBy, files};
use crate::dataset::split;
use crate::dataset::split::PARTS;
use crate::dataset::tiles;
use crate::dataset::tiles::{Cut, Tile};
use rockface_core::numerics::random::Field;
use rockface_core::{Context, Point, StageError};

/// A tile that is taken.
pub(super) struct Pick {
    pub(super) sample: usize,
    pub(super) part: usize,
    pub(super) tile: Tile,
}

/// The events, in the order they are first met.
pub(super) struct Events {
    /// Items of the axes that make them.
    pub(super) points: Vec<Point>,
    /// Event of each sample.
    pub(super) of_sample: Vec<usize>,
    /// Part of each event, where events are split.
    pub(super) parts: Vec<usize>,
    /// Events that are in a part because nothing else would be in it.
    pub(super) lent: Vec<usize>,
}

pub(super) fn events(params: &ExportDatasetParams, samples: &[Scored], context: &Context) -> Events {
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
    let mut events = Events { points, of_sample, parts: Vec::new(), lent: Vec::new() };
    deal(params, &mut events, context);
    events
}

/// Puts each event into a part.
fn deal(params: &ExportDatasetParams, events: &mut Events, context: &Context) {
    let shares = shares(params);
    // Drawn for its items, so that the number of an event is its own whatever others there are.
    let words = |point: &Point| {
        let text: Vec<String> = point.iter().map(|(axis, item)| format!("{axis}={item}")).collect();
        context.stream("event", &text.join("\n")).field().words(0, 0)
    };
    let words: Vec<[u32; 4]> = events.points.iter().map(words).collect();
    if params.dealing == Dealing::Exact {
        let mut order: Vec<usize> = (0..words.len()).collect();
        order.sort_by_key(|event| words[*event]);
        events.parts = vec![0; words.len()];
        order.into_iter().zip(split::parts(words.len(), shares)).for_each(|(event, part)| events.parts[event] = part);
        return;
    }
    let numbers: Vec<f64> = words.iter().map(|words| f64::from(words[0]) / (f64::from(u32::MAX) + 1.0)).collect();
    (events.parts, events.lent) = split::by_numbers(&numbers, shares);
    if !events.lent.is_empty() && params.split == SplitBy::Event {
        let told = |event: &usize| {
            format!("{} for {}", files::event_name(params, events, *event), PARTS[events.parts[*event]])
        };
        context.warn(format!(
            "{} events are few for these shares: {} only because nothing else would be; in a larger data set it may be for another part, all \
             other events stay where they are. `dealing: exact` deals by the shares",
            words.len(),
            events.lent.iter().map(told).collect::<Vec<_>>().join(", ")
        ));
    }
}

pub(super) fn shares(params: &ExportDatasetParams) -> [f64; 3] {
    [params.shares.train, params.shares.validation, params.shares.test]
}

pub(super) fn choose(
    params: &ExportDatasetParams,
    samples: &[Scored],
    events: &Events,
    draws: Field,
) -> Result<Vec<Pick>, StageError> {
    let side = params.tile_cells as usize;
    let cut = Cut { side, stride: params.stride_cells as usize, to_end: params.border == Border::Shift };
    let (mut positive, mut negative) = (Vec::new(), Vec::new());
    for (number, sample) in samples.iter().enumerate() {
        let grid = &sample.difference.grid;
        if grid.columns.min(grid.rows) < side {
            let (columns, rows, at) = (grid.columns, grid.rows, place(sample.point));
            let text = format!("a tile of {side} cells does not fit into {columns} x {rows} cells{at}");
            return Err(StageError::new(text).hint("lower `tile_cells`"));
        }
        let strips: Vec<(usize, Range<usize>)> = match params.split {
            SplitBy::Event => vec![(events.parts[events.of_sample[number]], 0..grid.columns)],
            SplitBy::Place => split::strips(grid.columns, shares(params)).into_iter().enumerate().collect(),
        };
        let found = strips.iter().flat_map(|(part, columns)| {
            tiles::tiles(&sample.scene(), columns, cut).into_iter().map(|tile| Pick {
                sample: number,
                part: *part,
                tile,
            })
        });
        let least_valid = params.least_valid_share * (side * side) as f64;
        for pick in found.filter(|pick| pick.tile.valid as f64 >= least_valid) {
            if pick.tile.changed_valid >= params.least_changed_cells as usize {
                positive.push(pick);
            } else if pick.tile.changed == 0 {
                negative.push(pick);
            }
        }
    }
    if positive.is_empty() {
        let look = StageError::new("no tile holds a change").hint("look at truth and differences with `draw-picture`");
        return Err((0..PARTS.len()).filter_map(|part| narrow(params, samples, part)).fold(look, StageError::hint));
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

/// Of a split by place: that the strip of a part with a share is narrower than a tile wherever tiles are cut, and the way out.
pub(super) fn narrow(params: &ExportDatasetParams, samples: &[Scored], part: usize) -> Option<String> {
    if params.split != SplitBy::Place || shares(params)[part] <= 0.0 {
        return None;
    }
    let widths = samples.iter().map(|sample| split::strips(sample.difference.grid.columns, shares(params))[part].len());
    let widest = widths.max().filter(|widest| *widest < params.tile_cells as usize)?;
    Some(format!(
        "the part {} is {widest} columns wide, a tile is {}: lower `tile_cells`, or give the part a larger share",
        PARTS[part], params.tile_cells
    ))
}

/// So many tiles without change: the hardest, or drawn.
pub(super) fn best(mut tiles: Vec<Pick>, most: usize, which: Negatives, draws: Field) -> Vec<Pick> {
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
