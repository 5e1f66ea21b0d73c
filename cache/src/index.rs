//! The index: what the segments hold, in memory, rebuilt from them whenever a store is opened.

use std::collections::HashMap;
use std::hash::{BuildHasherDefault, Hasher};
use std::sync::OnceLock;
use std::time::{SystemTime, UNIX_EPOCH};

use crate::Digest;
use crate::blobs::is_recent;
use crate::frame::{Header, Kind, STAMP_LIMIT, payload_check};
use crate::segment::{Frame, Payload};

/// A map by digest; digests are as good as random, so that some of their bytes do for a hash.
type ByDigest<T> = HashMap<Digest, T, BuildHasherDefault<DigestHasher>>;

/// Takes the first eight bytes of the one digest it is given.
#[derive(Debug, Default)]
struct DigestHasher(u64);

impl Hasher for DigestHasher {
    fn write(&mut self, bytes: &[u8]) {
        if let Some(start) = bytes.first_chunk() {
            self.0 = u64::from_le_bytes(*start);
        }
    }

    /// The length of the array, the same for every digest.
    fn write_usize(&mut self, _: usize) {}

    fn finish(&self) -> u64 {
        self.0
    }
}

/// The place of a small blob.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Place {
    /// The number of the segment.
    pub segment: u32,
    /// Where its bytes start there.
    pub at: u64,
    /// How many they are.
    pub length: u32,
    /// When they were written.
    pub stamp: u64,
}

impl Place {
    /// When it was written, seconds since 1970.
    pub(crate) fn put_s(self) -> u64 {
        self.stamp / 1_000_000_000
    }

    /// Whether it was written so lately that it need not be written again.
    pub(crate) fn is_recent(self) -> bool {
        is_recent(self.put_s())
    }
}

/// How far a segment has been read.
#[derive(Debug, Clone)]
pub(crate) struct Seen {
    /// The name of the file.
    pub name: String,
    /// Everything before is in the index.
    pub end: u64,
    /// Whether there is a torn frame before: see [`crate::segment::Scan::is_torn`].
    pub is_torn: bool,
}

/// The latest payload filed under a key, as it was read.
#[derive(Debug)]
struct Entry {
    stamp: u64,
    check: [u8; 16],
    payload: Payload,
    /// Whether the payload is what was written, once somebody has asked.
    is_whole: OnceLock<bool>,
}

/// Everything the segments hold.
#[derive(Debug, Default)]
pub(crate) struct Index {
    segments: Vec<Seen>,
    blobs: ByDigest<Place>,
    /// Blobs that were found damaged, and when.
    gone: ByDigest<u64>,
    records: ByDigest<Entry>,
    notes: ByDigest<Entry>,
    files: ByDigest<Entry>,
    clock: u64,
}

impl Index {
    /// The number of the segment of this name, new ones being entered as unread.
    pub(crate) fn segment(&mut self, name: &str) -> u32 {
        self.known_segment(name).unwrap_or_else(|| {
            self.segments.push(Seen { name: name.to_owned(), end: 0, is_torn: false });
            self.segments.len() as u32 - 1
        })
    }

    /// The number of the segment of this name, if it has been entered.
    pub(crate) fn known_segment(&self, name: &str) -> Option<u32> {
        self.segments.iter().position(|seen| seen.name == name).map(|number| number as u32)
    }

    /// How far segment `number` has been read.
    pub(crate) fn seen(&self, number: u32) -> Seen {
        self.segments[number as usize].clone()
    }

    /// Whether these are all the segments there are, each read to its end. One that a process began and never wrote to
    /// has nothing to be read.
    pub(crate) fn is_read<'a>(&self, segments: impl Iterator<Item = (&'a str, u64)>) -> bool {
        let mut count = 0;
        let mut is_read = |(name, end): (&str, u64)| {
            count += 1;
            self.segments.iter().any(|seen| seen.name == name && seen.end == end)
        };
        segments.into_iter().filter(|(_, end)| *end > 0).all(&mut is_read)
            && count == self.segments.iter().filter(|seen| seen.end > 0).count()
    }

    /// The names of the segments of which something was read.
    pub(crate) fn read_names(&self) -> Vec<String> {
        self.segments.iter().filter(|seen| seen.end > 0).map(|seen| seen.name.clone()).collect()
    }

    /// Forgets everything but the numbers and names of segments, as if none had been read.
    pub(crate) fn clear(&mut self) {
        self.segments.iter_mut().for_each(|seen| (seen.end, seen.is_torn) = (0, false));
        let segments = std::mem::take(&mut self.segments);
        *self = Self { segments, clock: self.clock, ..Self::default() };
    }

    /// Enters the frames of a segment, which has now been read up to `end`.
    pub(crate) fn enter(&mut self, segment: u32, frames: Vec<Frame>, end: u64) {
        let count = |kind: Kind| frames.iter().filter(|frame| frame.header.kind == kind).count();
        self.blobs.reserve(count(Kind::Blob));
        self.records.reserve(count(Kind::Record));
        for Frame { header, at, payload } in frames {
            self.enter_one(segment, &header, at, payload);
        }
        let seen = &mut self.segments[segment as usize].end;
        *seen = end.max(*seen);
    }

    fn enter_one(&mut self, segment: u32, header: &Header, at: u64, payload: Payload) {
        let map = match header.kind {
            Kind::Record => &mut self.records,
            Kind::Note => &mut self.notes,
            Kind::File => &mut self.files,
            Kind::Blob => return self.enter_blob(segment, header, at),
            Kind::Gone => return self.enter_gone(header),
            Kind::Mark | Kind::Unknown => return,
        };
        self.clock = self.clock.max(header.stamp);
        let entry = Entry { stamp: header.stamp, check: header.check, payload, is_whole: OnceLock::new() };
        match map.get_mut(&header.name) {
            Some(older) if older.stamp > entry.stamp => {}
            Some(older) => *older = entry,
            None => drop(map.insert(header.name, entry)),
        }
    }

    fn enter_blob(&mut self, segment: u32, header: &Header, at: u64) {
        self.clock = self.clock.max(header.stamp);
        if self.gone.get(&header.name).is_some_and(|gone| *gone >= header.stamp) {
            return;
        }
        let place = Place { segment, at, length: header.length, stamp: header.stamp };
        let latest = self.blobs.entry(header.name).or_insert(place);
        if latest.stamp < place.stamp {
            *latest = place;
        }
    }

    fn enter_gone(&mut self, header: &Header) {
        self.clock = self.clock.max(header.stamp);
        let gone = self.gone.entry(header.name).or_default();
        *gone = header.stamp.max(*gone);
        if self.blobs.get(&header.name).is_some_and(|place| place.stamp <= *gone) {
            self.blobs.remove(&header.name);
        }
    }

    /// Notes that the part of a segment that was read has a torn frame.
    pub(crate) fn note_torn(&mut self, segment: u32) {
        self.segments[segment as usize].is_torn = true;
    }

    /// A stamp later than every one that was read from the store; `None` where there is none.
    pub(crate) fn tick(&mut self) -> Option<u64> {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
        self.clock = Some(now.max(self.clock + 1)).filter(|stamp| *stamp < STAMP_LIMIT)?;
        Some(self.clock)
    }

    /// The place of a small blob.
    pub(crate) fn blob(&self, digest: &Digest) -> Option<Place> {
        self.blobs.get(digest).copied()
    }

    /// The latest payload of this kind under `key`, if it is whole.
    pub(crate) fn payload(&self, kind: Kind, key: &Digest) -> Option<&[u8]> {
        let entry = self.entry(kind, key)?;
        let is_whole = entry.is_whole.get_or_init(|| payload_check(&entry.payload) == entry.check);
        is_whole.then_some(&*entry.payload)
    }

    /// When the latest payload of this kind under `key` was written.
    pub(crate) fn stamp(&self, kind: Kind, key: &Digest) -> Option<u64> {
        self.entry(kind, key).map(|entry| entry.stamp)
    }

    fn entry(&self, kind: Kind, key: &Digest) -> Option<&Entry> {
        match kind {
            Kind::Record => self.records.get(key),
            Kind::Note => self.notes.get(key),
            Kind::File => self.files.get(key),
            Kind::Blob | Kind::Mark | Kind::Gone | Kind::Unknown => None,
        }
    }

    /// The names of all that is held of this kind, sorted.
    pub(crate) fn names(&self, kind: Kind) -> Vec<Digest> {
        let mut names: Vec<Digest> = match kind {
            Kind::Blob => self.blobs.keys().copied().collect(),
            Kind::Record => self.records.keys().copied().collect(),
            Kind::Note => self.notes.keys().copied().collect(),
            Kind::File => self.files.keys().copied().collect(),
            Kind::Mark | Kind::Gone | Kind::Unknown => Vec::new(),
        };
        names.sort_unstable();
        names
    }

    /// Number of small blobs, their bytes, number of records, number of notes.
    pub(crate) fn counts(&self) -> (u64, u64, u64, u64) {
        let bytes = self.blobs.values().map(|place| u64::from(place.length)).sum();
        (self.blobs.len() as u64, bytes, self.records.len() as u64, self.notes.len() as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(kind: Kind, name: &[u8], stamp: u64, payload: &[u8]) -> Frame {
        Frame { header: Header::of(kind, Digest::of(name), stamp, payload), at: stamp, payload: payload.into() }
    }

    #[test]
    fn the_latest_stamp_counts_in_whatever_order_segments_are_read() {
        let frames = || vec![frame(Kind::Record, b"k", 2, b"new"), frame(Kind::Blob, b"b", 9, b"")];
        let older = || vec![frame(Kind::Record, b"k", 1, b"old"), frame(Kind::Blob, b"b", 8, b"")];
        for newest_first in [true, false] {
            let mut index = Index::default();
            let (a, b) = (index.segment("a"), index.segment("b"));
            let (first, second) = if newest_first { (frames(), older()) } else { (older(), frames()) };
            index.enter(a, first, 10);
            index.enter(b, second, 10);
            assert_eq!(index.payload(Kind::Record, &Digest::of(b"k")), Some(b"new".as_slice()));
            assert_eq!(index.blob(&Digest::of(b"b")).unwrap().stamp, 9);
        }
    }

    #[test]
    fn a_blob_that_is_gone_counts_again_once_it_is_stored_anew() {
        let frames =
            [frame(Kind::Blob, b"b", 3, b""), frame(Kind::Gone, b"b", 5, b""), frame(Kind::Blob, b"b", 7, b"")];
        for order in [[0, 1, 2], [1, 0, 2], [2, 1, 0], [0, 2, 1]] {
            let mut index = Index::default();
            let segment = index.segment("a");
            let header = |i: usize| frames[i].header;
            for (read, i) in order.into_iter().enumerate() {
                index.enter_one(segment, &header(i), 0, Payload::default());
                let newest = order[..=read].contains(&2);
                let only_old = order[..=read] == [0];
                assert_eq!(index.blob(&Digest::of(b"b")).is_some(), newest || only_old, "{order:?}");
            }
        }
    }

    #[test]
    fn stamps_grow_even_past_a_clock_that_is_ahead() {
        let mut index = Index::default();
        let ahead = STAMP_LIMIT - 3;
        let segment = index.segment("a");
        index.enter(segment, vec![frame(Kind::Note, b"n", ahead, b"")], 1);
        assert_eq!(index.tick(), Some(ahead + 1));
        assert_eq!(index.tick(), Some(ahead + 2));
        assert_eq!(index.tick(), None, "none follows the last one");
    }
}
