//! What is known of the inputs of a step before it runs: what an estimate of the memory it will need goes by.

use std::fmt;
use std::sync::Arc;

use crate::artefact::{Artefact, Noun};

/// More than any machine has: what a record says beyond it counts as this much, so that an estimate may multiply it, bytes.
const MOST_BYTES: u64 = 1 << 50;

/// The size of one input of a step instance, or of one file that its parameters name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InputSize {
    /// The input port; empty for a file.
    pub port: &'static str,
    /// Bytes as it is stored.
    pub stored_bytes: u64,
    /// Bytes of the value in memory, where they are on record.
    pub memory_bytes: Option<u64>,
}

impl InputSize {
    /// Bytes in memory; twice those of the file where nothing better is known.
    fn in_memory(&self) -> u64 {
        self.memory_bytes.map_or(self.stored_bytes.saturating_mul(2), |bytes| bytes.max(self.stored_bytes / 4))
    }
}

/// Gives the value of an input, if it is at hand or so small that reading it costs next to nothing.
pub type SmallInput<'a> = dyn Fn(&str) -> Option<Arc<Artefact>> + 'a;

/// The inputs of a step instance that is about to run.
pub struct InputSizes<'a> {
    sizes: Vec<InputSize>,
    small: &'a SmallInput<'a>,
    kept: bool,
    threads: u64,
    /// Ports whose input is handed over, to be changed in place.
    moved: Vec<&'static str>,
}

impl<'a> InputSizes<'a> {
    /// Inputs of these sizes.
    pub fn new(sizes: Vec<InputSize>, small: &'a SmallInput<'a>) -> Self {
        Self { sizes, small, kept: false, threads: 1, moved: Vec::new() }
    }

    /// The same for a step whose outputs are kept or not.
    #[must_use]
    pub fn kept(self, kept: bool) -> Self {
        Self { kept, ..self }
    }

    /// The same for a step that is handed the inputs of these ports to change them in place.
    #[must_use]
    pub fn moved(self, moved: Vec<&'static str>) -> Self {
        Self { moved, ..self }
    }

    /// The same for a step that has so many threads.
    #[must_use]
    pub fn on_threads(self, threads: usize) -> Self {
        Self { threads: threads.max(1) as u64, ..self }
    }

    /// How many of so many parts are worked on at a time.
    pub fn at_once(&self, parts: u64) -> u64 {
        self.threads.min(parts)
    }

    /// So many bytes if the outputs are kept, else 0: those of the file of an output, which is made whole before it is written.
    pub fn of_file(&self, bytes: u64) -> u64 {
        if self.kept { bytes } else { 0 }
    }

    /// Bytes of all inputs in memory.
    pub fn total(&self) -> u64 {
        self.sizes.iter().map(InputSize::in_memory).fold(0, u64::saturating_add).min(MOST_BYTES)
    }

    /// Bytes of the inputs at one port in memory.
    pub fn of(&self, port: &str) -> u64 {
        self.at(port).map(InputSize::in_memory).fold(0, u64::saturating_add).min(MOST_BYTES)
    }

    /// Bytes of the copy that a stage needs which changes the input of a port: none where it is handed over.
    pub fn copy_of(&self, port: &str) -> u64 {
        if self.moved.contains(&port) { 0 } else { self.of(port) }
    }

    /// Bytes of the largest input at one port in memory: what a stage needs that takes them one by one.
    pub fn largest(&self, port: &str) -> u64 {
        self.at(port).map(InputSize::in_memory).max().unwrap_or(0).min(MOST_BYTES)
    }

    /// So many times the bytes of all inputs at one port in memory.
    pub fn times(&self, factor: f64, port: &str) -> u64 {
        (factor * self.of(port) as f64) as u64
    }

    /// How many inputs there are at a port.
    pub fn count(&self, port: &str) -> u64 {
        self.at(port).count() as u64
    }

    fn at(&self, port: &str) -> impl Iterator<Item = &InputSize> {
        self.sizes.iter().filter(move |size| size.port == port)
    }

    /// The only input at a port; `None` where it is large and not at hand.
    pub fn value(&self, port: &str) -> Option<Arc<Artefact>> {
        (self.small)(port)
    }

    /// Does something with the only input at a port, such as cameras; `None` where it is large and not at hand.
    pub fn small<T: Noun, R>(&self, port: &str, look: impl FnOnce(&T) -> R) -> Option<R> {
        let value = self.value(port)?;
        T::of(&value).map(look)
    }
}

impl fmt::Debug for InputSizes<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("InputSizes").field(&self.sizes).finish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Table;

    #[test]
    fn a_record_that_says_too_much_can_still_be_multiplied() {
        let sizes =
            [u64::MAX, 7].map(|bytes| InputSize { port: "mesh", stored_bytes: bytes, memory_bytes: Some(bytes) });
        let inputs = InputSizes::new(sizes.to_vec(), &|_| None);
        assert_eq!([inputs.total(), inputs.of("mesh"), inputs.largest("mesh")], [MOST_BYTES; 3]);
        assert!(inputs.total().checked_mul(4096).is_some());
    }

    #[test]
    fn sizes_go_by_what_is_on_record() {
        let small = |port: &str| (port == "table").then(|| Arc::new(Table::new(["a"]).into()));
        let sizes = [("depth", 10, Some(100)), ("depth", 20, None), ("", 7, None)];
        let sizes =
            sizes.map(|(port, stored_bytes, memory_bytes)| InputSize { port, stored_bytes, memory_bytes }).to_vec();
        let inputs = InputSizes::new(sizes, &small);
        assert_eq!(
            (inputs.total(), inputs.of("depth"), inputs.largest("depth"), inputs.count("depth")),
            (154, 140, 100, 2)
        );
        assert_eq!(inputs.times(1.5, "depth"), 210);
        assert!(inputs.value("table").is_some() && inputs.value("depth").is_none());
        assert_eq!(inputs.small("table", |table: &Table| table.columns.len()), Some(1));
        assert_eq!(inputs.small("depth", |table: &Table| table.columns.len()), None);
        assert_eq!((inputs.of_file(9), inputs.at_once(7)), (0, 1));
        assert_eq!((inputs.copy_of("depth"), inputs.copy_of("mesh")), (140, 0));
        let inputs = inputs.kept(true).on_threads(4).moved(vec!["depth"]);
        assert_eq!((inputs.copy_of("depth"), inputs.of("depth")), (0, 140));
        assert_eq!((inputs.of_file(9), inputs.at_once(7), inputs.at_once(3)), (9, 4, 3));
    }
}
