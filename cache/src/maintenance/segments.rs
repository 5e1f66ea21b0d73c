//! What is wrong inside segments: entries that cannot be read, bytes that are no entry, and segments that were cut.
//!
//! A process that is killed while it appends leaves the beginning of an entry at the end of its segment. That is no damage:
//! the next process that continues the segment cuts it off. A segment that somebody else has cut in the middle of an entry
//! looks the same, unless an answer to a former command says that the segment was longer.

use std::fs::File;
use std::io::{self, ErrorKind};
use std::os::unix::fs::FileExt;

use crate::error::{At, StoreError};
use crate::frame::{HEADER_BYTES, Header, Kind, MAGIC};
use crate::record::Record;
use crate::segment::{Frame, scan};
use crate::{Store, plain};

/// What is wrong with a stretch of a segment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SegmentFaultKind {
    /// An entry whose bytes are not those that were written.
    Damaged,
    /// Bytes that are no entry, nor the beginning of one.
    Unreadable,
    /// The segment ends before a place up to which it was written.
    Cut,
}

/// A stretch of a segment that is not as it should be.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct SegmentFault {
    /// What is wrong.
    pub kind: SegmentFaultKind,
    /// The file name of the segment.
    pub segment: String,
    /// The byte at which the stretch begins.
    pub at: u64,
    /// Its length; for a segment that was cut, how many bytes are missing at least.
    pub bytes: u64,
    /// What cannot be used any more.
    pub lost: String,
}

/// The beginning of an entry at the end of a segment, as a process leaves it that is killed; nothing at all where a process
/// was killed before it wrote.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct HalfWritten {
    /// The file name of the segment.
    pub segment: String,
    /// The byte at which the entry begins.
    pub at: u64,
    /// How many bytes of it there are.
    pub bytes: u64,
}

/// What stands where no whole entry is.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Stretch {
    /// An entry with a whole header and other bytes than its own: those, where they were read.
    Entry(Header, Vec<u8>),
    /// Bytes that are no entry.
    NoEntry,
    /// The beginning of an entry at the end of the segment.
    Beginning,
}

impl Store {
    /// Reads every segment from end to end: what is damaged, and what was not written to its end.
    pub(super) fn verify_segments(&self) -> Result<(Vec<SegmentFault>, Vec<HalfWritten>), StoreError> {
        let (mut faults, mut half_written) = (Vec::new(), Vec::new());
        let told = self.memory().segment_sizes();
        for segment in self.journal().names()? {
            let path = self.journal().path(&segment);
            let file = match plain::settled(|| plain::open(&path)) {
                // A collection has removed it since it was listed.
                Err(fault) if fault.kind() == ErrorKind::NotFound => continue,
                file => file.at("open", &path)?,
            };
            // Taken before the entries are read: what a live process appends meanwhile is not looked at.
            let size = file.metadata().at("look at", &path)?.len();
            // A power cut may have taken the last mark, which is all that is not synced before an answer is filed.
            let missing = told.get(&segment).map_or(0, |told| told.saturating_sub(size));
            let is_cut = missing > HEADER_BYTES as u64;
            if is_cut {
                let lost = "the entries that were there; which, cannot be known".to_owned();
                let kind = SegmentFaultKind::Cut;
                faults.push(SegmentFault { kind, segment: segment.clone(), at: size, bytes: missing, lost });
            }
            for (at, bytes, stretch) in unread(&file, size).at("read", &path)? {
                let (kind, lost) = match stretch {
                    // Part of what is missing.
                    Stretch::Beginning if is_cut => continue,
                    Stretch::Beginning => {
                        half_written.push(HalfWritten { segment: segment.clone(), at, bytes });
                        continue;
                    }
                    Stretch::Entry(header, payload) => match self.lost_with(&header, &payload) {
                        Some(lost) => (SegmentFaultKind::Damaged, lost),
                        None => continue,
                    },
                    Stretch::NoEntry => {
                        (SegmentFaultKind::Unreadable, "whatever was there; it cannot be known".to_owned())
                    }
                };
                faults.push(SegmentFault { kind, segment: segment.clone(), at, bytes, lost });
            }
        }
        Ok((faults, half_written))
    }

    /// What is lost with a damaged entry; `None` where a later one took its place. Blobs are compared with their digests.
    fn lost_with(&self, header: &Header, payload: &[u8]) -> Option<String> {
        let Header { kind, name, stamp, .. } = header;
        let latest = self.journal().with_index(|index| index.stamp(*kind, name));
        if latest.is_some_and(|latest| latest > *stamp) {
            return None;
        }
        match kind {
            Kind::Record => {
                // Where the damage is elsewhere, the name of the stage is still to be read.
                let stage = Record::decode(payload).map(|record| format!(" of {}", record.recipe.stage));
                Some(format!("record {}{}: that step runs again", name.short(), stage.unwrap_or_default()))
            }
            Kind::Note => Some("the note on a former run: the next run writes its folder anew".to_owned()),
            Kind::File => Some("the digest of an input file, or a note on a record: the file is read again".to_owned()),
            Kind::Unknown => Some("an entry of a later version of rockface".to_owned()),
            Kind::Blob | Kind::Mark | Kind::Gone => None,
        }
    }

    /// Writes all segments anew without what is damaged in them, except those that a process is writing to; returns how
    /// many these are. Answers to former commands go: they say how long the old segments were.
    pub(super) fn rewrite_segments(&self) -> Result<u64, StoreError> {
        self.empty(crate::memory::ANSWERS)?;
        let claimed = self.journal().claim_all(|segment| self.machine().may_be_written_elsewhere(segment))?;
        let busy = claimed.busy();
        self.journal().copy_all(&claimed, |_| true)?;
        self.journal().remove(&claimed)?;
        Ok(busy)
    }
}

/// The stretches of a segment before `size` that hold no whole entry: where, how long, and what is there.
fn unread(file: &File, size: u64) -> io::Result<Vec<(u64, u64, Stretch)>> {
    let (mut found, mut next) = (Vec::new(), 0);
    for Frame { header, at, payload } in scan(file, 0)?.frames {
        let start = at - HEADER_BYTES as u64;
        read_between(file, (next, start), false, &mut found)?;
        // A scan believes payloads that are known to have been on disk.
        if header.kind != Kind::Blob && !header.fits(&payload) {
            found.push((start, header.frame_bytes(), Stretch::Entry(header, payload.to_vec())));
        }
        next = start + header.frame_bytes();
    }
    read_between(file, (next, size), true, &mut found)?;
    if size == 0 {
        found.push((0, 0, Stretch::Beginning));
    }
    Ok(found)
}

/// Looks at what is between two whole entries, or behind the last.
fn read_between(
    file: &File,
    (mut from, to): (u64, u64),
    is_end: bool,
    found: &mut Vec<(u64, u64, Stretch)>,
) -> io::Result<()> {
    while from < to {
        let left = to - from;
        let mut head = vec![0; left.min(HEADER_BYTES as u64) as usize];
        file.read_exact_at(&mut head, from)?;
        let header = Header::decode(&head);
        if let Some(header) = header.filter(|header| header.frame_bytes() <= left) {
            // Its payload may be a hole of any size, and is not read.
            found.push((from, header.frame_bytes(), Stretch::Entry(header, Vec::new())));
            from += header.frame_bytes();
            continue;
        }
        let magic = &MAGIC[..head.len().min(MAGIC.len())];
        let is_beginning = is_end && (header.is_some() || head.len() < HEADER_BYTES && head.starts_with(magic));
        let stretch = if is_beginning { Stretch::Beginning } else { Stretch::NoEntry };
        found.push((from, left, stretch));
        return Ok(());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Digest;

    /// Three records and a mark that vouches for them, and where each of the four ends.
    fn sample() -> (Vec<u8>, Vec<u64>) {
        let (mut bytes, mut ends) = (Vec::new(), Vec::new());
        for number in 0..3 {
            let payload = vec![number; 50];
            bytes.extend(Header::of(Kind::Record, Digest::of(&payload), u64::from(number), &payload).encode(&payload));
            ends.push(bytes.len() as u64);
        }
        bytes.extend(Header::of(Kind::Mark, Digest::of(b""), ends[2], b"").encode(b""));
        ends.push(bytes.len() as u64);
        (bytes, ends)
    }

    fn look(bytes: &[u8]) -> Vec<(u64, u64, &'static str)> {
        let file = tempfile::NamedTempFile::new().unwrap();
        file.as_file().write_all_at(bytes, 0).unwrap();
        let word = |stretch: &Stretch| match stretch {
            Stretch::Entry(..) => "entry",
            Stretch::NoEntry => "no entry",
            Stretch::Beginning => "beginning",
        };
        let found = unread(file.as_file(), bytes.len() as u64).unwrap();
        found.iter().map(|(at, bytes, stretch)| (*at, *bytes, word(stretch))).collect()
    }

    #[test]
    fn a_segment_torn_at_any_byte_ends_with_the_beginning_of_an_entry() {
        let (bytes, ends) = sample();
        for size in 1..=bytes.len() as u64 {
            let whole = ends.iter().copied().filter(|end| *end <= size).max().unwrap_or(0);
            let expected = if size == whole { vec![] } else { vec![(whole, size - whole, "beginning")] };
            assert_eq!(look(&bytes[..size as usize]), expected, "torn at {size}");
        }
        assert_eq!(look(b""), [(0, 0, "beginning")]);
    }

    #[test]
    fn a_byte_that_changed_anywhere_is_found_with_the_entry_it_belongs_to() {
        let (bytes, ends) = sample();
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x55;
            let number = ends.iter().position(|end| *end > at as u64).unwrap();
            let start = if number == 0 { 0 } else { ends[number - 1] };
            let word = if at as u64 - start < HEADER_BYTES as u64 { "no entry" } else { "entry" };
            assert_eq!(look(&damaged), [(start, ends[number] - start, word)], "damaged at {at}");
        }
    }

    #[test]
    fn bytes_that_are_no_entry_are_found_in_the_middle_and_at_the_end() {
        let (bytes, ends) = sample();
        let (size, cut) = (ends[3], ends[1] as usize);
        assert_eq!(look(&[&bytes[..], &[7; 1000]].concat()), [(size, 1000, "no entry")]);
        let middle = [&bytes[..cut], &[0; 333], &bytes[cut..]].concat();
        assert_eq!(look(&middle), [(ends[1], 333, "no entry")]);
    }
}
