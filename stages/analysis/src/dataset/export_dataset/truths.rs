//! The truth of each sample as a file: one for each distinct truth of an event, so that the numbers in a mask are those of its file.

use super::choice::Events;
use super::sources::Scored;
use super::{ExportDatasetParams, files};
use rockface_core::artefact::Noun;
use rockface_core::{StageError, artefact};

/// The files, and which of them each sample has.
pub(super) struct Truths {
    /// Place in the data set and content.
    pub(super) files: Vec<files::File>,
    of_sample: Vec<usize>,
}

impl Truths {
    /// The file of a sample.
    pub(super) fn of(&self, sample: usize) -> &files::File {
        &self.files[self.of_sample[sample]]
    }
}

/// A truth that differs from all others of its event.
struct Distinct<'a> {
    event: usize,
    truth: &'a artefact::Inventory,
    bytes: Vec<u8>,
}

/// The first truth with changes has the name of the event, further ones a number after it; that of surveys in which nothing
/// changed is called `EVENT_unchanged` where the event has others.
pub(super) fn truths(params: &ExportDatasetParams, samples: &[Scored], events: &Events) -> Result<Truths, StageError> {
    let mut known: Vec<Distinct> = Vec::new();
    let mut of_sample = Vec::new();
    for (sample, event) in samples.iter().zip(&events.of_sample) {
        let own = |one: &Distinct| one.event == *event;
        let mut found = known.iter().position(|one| own(one) && std::ptr::eq(one.truth, sample.truth));
        if found.is_none() {
            let bytes = sample.truth.encode().map_err(|e| StageError::new(e.to_string()))?;
            found = known.iter().position(|one| own(one) && one.bytes == bytes);
            if found.is_none() {
                known.push(Distinct { event: *event, truth: sample.truth, bytes });
            }
        }
        of_sample.push(found.unwrap_or(known.len() - 1));
    }
    let names: Vec<String> = (0..known.len()).map(|at| name(params, events, &known, at)).collect();
    let files = names.into_iter().zip(known).map(|(name, one)| (format!("events/{name}.geojson"), one.bytes)).collect();
    Ok(Truths { files, of_sample })
}

fn name(params: &ExportDatasetParams, events: &Events, known: &[Distinct], at: usize) -> String {
    let is_empty = |one: &Distinct| one.truth.features.is_empty();
    let alike = |one: &&Distinct| one.event == known[at].event && is_empty(one) == is_empty(&known[at]);
    let has_changes = known.iter().any(|one| one.event == known[at].event && !is_empty(one));
    let event = files::event_name(params, events, known[at].event);
    let word = if is_empty(&known[at]) && has_changes { "_unchanged" } else { "" };
    match known[..at].iter().filter(alike).count() {
        0 => format!("{event}{word}"),
        before => format!("{event}{word}_{}", before + 1),
    }
}
