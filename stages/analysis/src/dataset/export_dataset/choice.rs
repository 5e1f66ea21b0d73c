//! Which tiles are taken, and into which part each goes.

use super::sources::{Scored, place};
use super::{ExportDatasetParams, Negatives, SplitBy};
use crate::dataset::split;
use crate::dataset::split::PARTS;
use crate::dataset::tiles;
use crate::dataset::tiles::Tile;
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
    let draws = context.stream("events", "").field();
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by_key(|event| draws.words(*event as i32, 0));
    let mut parts = vec![0; points.len()];
    let dealt = split::parts(points.len(), shares(params));
    order.into_iter().zip(dealt).for_each(|(event, part)| parts[event] = part);
    Events { points, of_sample, parts }
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
