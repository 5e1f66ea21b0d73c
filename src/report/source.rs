//! Where a report takes its contents from: the manifest, the run folder, and the store.

use std::ops::Deref;
use std::path::{Component, Path, PathBuf};

use rockface_cache::{Digest, OutputRecord};
use rockface_core::artefact::Shown;
use rockface_core::artefact::sketch::{ColourKey, Shape};
use rockface_core::{Entry, Look};

use rockface_engine::history::{RunContents, StepDone};

/// A run and what draws its pictures.
pub struct Source<'a> {
    /// What is known of the run: its folder, manifest, store, graph and logs.
    pub run: RunContents<'a>,
    /// What makes large pictures small.
    pub look: &'static dyn Look,
}

impl<'a> Deref for Source<'a> {
    type Target = RunContents<'a>;

    fn deref(&self) -> &RunContents<'a> {
        &self.run
    }
}

/// A picture of an output that was made when the step ran.
pub struct Preview {
    /// The name of the output port.
    pub port: String,
    /// The part of it that is shown, and what was left out.
    pub caption: String,
    /// What its colours stand for, where it does not say so itself.
    pub colours: Option<ColourKey>,
    /// The bytes of the PNG file.
    pub png: Vec<u8>,
}

impl Source<'_> {
    /// The bytes of an output: from the run folder, else from the store; `None` where neither has it.
    pub(super) fn output(&self, done: &StepDone, port: &str, output: &OutputRecord) -> Option<Vec<u8>> {
        let linked = done.paths.get(port).and_then(|path| std::fs::read(self.file(path)?).ok());
        // A folder may come from anybody: what is shown is what the run made, and no other file that a link leads to.
        let linked = linked.filter(|bytes| Digest::of(bytes) == output.digest);
        linked.or_else(|| self.blob(&output.digest))
    }

    fn blob(&self, digest: &Digest) -> Option<Vec<u8>> {
        self.store?.get(digest).ok()
    }

    /// What the step instance at this place of the manifest said.
    pub(super) fn entries(&self, place: usize) -> Vec<Entry> {
        if let Some(entries) = self.logs.and_then(|logs| logs.get(place)) {
            return entries.clone();
        }
        let log = self.manifest.steps[place].log.and_then(|digest| self.blob(&digest));
        log.and_then(|bytes| serde_json::from_slice(&bytes).ok()).unwrap_or_default()
    }

    /// The pictures of the outputs of a step instance that its log keeps.
    pub(super) fn previews(&self, done: &StepDone) -> Vec<Preview> {
        let kept = done.sketches.and_then(|digest| self.blob(&digest));
        let shown = kept.and_then(|bytes| Shown::read_all(&bytes).ok()).unwrap_or_default();
        shown.into_iter().filter_map(preview).collect()
    }

    /// The path of a file of the run folder that is there. A manifest made elsewhere may name files outside of it, or
    /// devices: they are none of the run's.
    pub(super) fn file(&self, path: &Path) -> Option<PathBuf> {
        let inside = path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
        let full = self.folder.join(path);
        (inside && full.is_file()).then_some(full)
    }
}

fn preview(shown: Shown) -> Option<Preview> {
    let Shape::Picture(picture) = shown.sketch.shape else { return None };
    let quantity = picture.colours.as_ref().map_or("", |colours| &colours.quantity);
    let named = [quantity, &shown.sketch.reduced].into_iter().filter(|text| !text.is_empty());
    let caption = named.collect::<Vec<_>>().join(", ");
    Some(Preview { port: shown.port, caption, colours: picture.colours, png: picture.png })
}
