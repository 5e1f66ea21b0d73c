//! Whether two parts hold the same survey.

use std::cmp::Ordering;

use super::choice::Events;
use super::sources::Scored;
use super::{ExportDatasetParams, SplitBy, files};
use crate::dataset::split::PARTS;
use rockface_core::StageError;

/// Refuses events in different parts that have the same difference in every bit, unless it says nothing: all 0, or no value.
pub(super) fn check(params: &ExportDatasetParams, samples: &[Scored], events: &Events) -> Result<(), StageError> {
    if params.split == SplitBy::Place {
        // No place is in two parts, whatever is there.
        return Ok(());
    }
    let values = |sample: usize| &samples[sample].difference.bands[0].values;
    let order = |a: usize, b: usize| -> Ordering {
        let bits = |sample: usize| values(sample).iter().map(|value| value.to_bits());
        values(a).len().cmp(&values(b).len()).then_with(|| bits(a).cmp(bits(b)))
    };
    let mut sorted: Vec<usize> =
        (0..samples.len()).filter(|sample| values(*sample).iter().any(|v| v.abs() > 0.0)).collect();
    sorted.sort_by(|a, b| order(*a, *b).then(a.cmp(b)));
    let part = |sample: usize| events.parts[events.of_sample[sample]];
    let same = |pair: &&[usize]| part(pair[0]) != part(pair[1]) && order(pair[0], pair[1]) == Ordering::Equal;
    let Some(pair) = sorted.windows(2).find(same) else { return Ok(()) };
    let name = |sample: usize| files::event_name(params, events, events.of_sample[sample]);
    Err(StageError::new(format!(
        "the events {} and {} have the same difference, bit for bit, and are for {} and {}: what is learnt from one is asked of the other",
        name(pair[0]),
        name(pair[1]),
        PARTS[part(pair[0])],
        PARTS[part(pair[1])]
    ))
    .hint(
        "an axis of `values` changes no random numbers: give it `reseeds: true`, or use `{count: N}`; take an axis that makes no \
         event out of `event_axes`",
    ))
}
