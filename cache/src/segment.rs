//! Segments: append-only files of frames, read by everyone and grown by the one process that holds their lock.

use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::ops::Deref;
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rustix::fs::SeekFrom;
use rustix::io::Errno;

use crate::error::{At, StoreError};
use crate::frame::{HEADER_BYTES, Header, Kind, MAGIC};
use crate::locks::Locked;
use crate::plain;
use crate::sharing::{FILE, Sharing};

/// A segment that has grown beyond this is not continued.
pub(crate) const FULL_BYTES: u64 = 256 << 20;
/// A payload above this size is not read before it is known to have no hole.
const LARGE_BYTES: u64 = 1 << 20;
/// Bytes read at a time; small, so that the payloads of blobs are mostly skipped.
const WINDOW_BYTES: usize = 32 * 1024;

/// A frame found in a segment.
#[derive(Debug)]
pub(crate) struct Frame {
    /// Kind, length, time, name and checksum of the payload.
    pub header: Header,
    /// Where its payload starts in the segment.
    pub at: u64,
    /// The payload, except that of a blob, which stays on disk.
    pub payload: Payload,
}

/// A payload in memory that it shares with those it was read with: a piece of memory of its own for each of very many takes longer
/// than reading them.
#[derive(Debug, Clone, Default)]
pub(crate) struct Payload {
    shared: Arc<Vec<u8>>,
    start: usize,
    length: u32,
}

impl Deref for Payload {
    type Target = [u8];

    fn deref(&self) -> &[u8] {
        &self.shared[self.start..self.start + self.length as usize]
    }
}

impl From<&[u8]> for Payload {
    fn from(bytes: &[u8]) -> Self {
        Self { shared: Arc::new(bytes.to_vec()), start: 0, length: bytes.len() as u32 }
    }
}

/// What a segment holds from some offset on.
#[derive(Debug)]
pub(crate) struct Scan {
    /// The whole frames, in order.
    pub frames: Vec<Frame>,
    /// Where the last whole frame ends.
    pub end: u64,
    /// Whether a frame before that end has a whole header and a torn payload: a mark after it would vouch for it.
    pub is_torn: bool,
}

/// The growing end of the one segment this process writes.
#[derive(Debug)]
pub(crate) struct Writer {
    /// The file. Whoever syncs it may outlive this; its lock does not.
    pub file: Arc<Locked>,
    /// The path of the segment.
    pub path: PathBuf,
    /// Its number in the index.
    pub segment: u32,
    /// Where the next frame goes.
    pub end: u64,
    /// The end of the last frame that is not a mark.
    pub appended: u64,
    /// Everything before is known to be on disk.
    pub durable: u64,
}

impl Writer {
    /// Appends one frame and returns where its payload starts.
    ///
    /// After an error the end of the file is not known: drop the writer, and whoever claims the segment next cuts the torn tail.
    pub(crate) fn append(&mut self, header: &Header, payload: &[u8]) -> Result<u64, StoreError> {
        self.append_all(&[(*header, payload)]).map(|places| places[0])
    }

    /// [`Writer::append`] of several frames with one write; returns where each payload starts.
    pub(crate) fn append_all(&mut self, frames: &[(Header, &[u8])]) -> Result<Vec<u64>, StoreError> {
        let mut bytes = Vec::with_capacity(frames.iter().map(|(header, _)| header.frame_bytes() as usize).sum());
        frames.iter().for_each(|(header, payload)| header.encode_to(payload, &mut bytes));
        (&**self.file).write_all(&bytes).at("append to", &self.path)?;
        let mut places = Vec::with_capacity(frames.len());
        for (header, _) in frames {
            places.push(self.end + HEADER_BYTES as u64);
            self.end += header.frame_bytes();
            if header.kind != Kind::Mark {
                self.appended = self.end;
            }
        }
        Ok(places)
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        // A sync that goes on in another thread keeps the file open, and is no reason for others to begin a segment.
        let _ = self.file.unlock();
    }
}

/// Opens a segment for appending if no live process writes it. A new one is open to whom the store is.
pub(crate) fn claim(path: &Path, sharing: Sharing) -> Result<Option<Locked>, StoreError> {
    let mut options = OpenOptions::new();
    options.read(true).append(true).create(true).mode(sharing.first(FILE));
    let file = plain::open_with(&mut options, path).at("open", path)?;
    let Some(file) = Locked::try_new(file).at("lock", path)?.filter(|file| is_at(file, path)) else { return Ok(None) };
    let meta = file.metadata().at("look at", path)?;
    if meta.len() == 0 && meta.uid() == rustix::process::geteuid().as_raw() {
        sharing.give(&file, FILE).at("set the mode of", path)?;
    }
    Ok(Some(file))
}

/// Whether `path` still leads to this very file.
pub(crate) fn is_at(file: &File, path: &Path) -> bool {
    let identity = |meta: std::fs::Metadata| (meta.dev(), meta.ino());
    match (file.metadata(), std::fs::metadata(path)) {
        (Ok(held), Ok(named)) => identity(held) == identity(named),
        _ => false,
    }
}

/// Reads the frames from `from` to the end the file has now.
///
/// Frames before the last mark were synced, so their payloads are not verified here but when they are used; later ones
/// are verified now, since a power cut may have torn them. What is damaged is stepped over, at worst to the next header.
pub(crate) fn scan(file: &File, from: u64) -> io::Result<Scan> {
    let mut window = Window { file, size: file.metadata()?.len(), start: 0, bytes: Vec::new() };
    let (mut found, mut payloads) = (Vec::new(), Vec::new());
    let mut durable = from;
    let mut next = window.find_header(from)?;
    while let Some((start, header)) = next {
        let at = start + HEADER_BYTES as u64;
        let length = if header.kind == Kind::Blob { 0 } else { header.length as usize };
        let start = payloads.len();
        payloads.extend_from_slice(window.read(at, length)?);
        if header.kind == Kind::Mark {
            durable = durable.max(header.stamp);
        }
        found.push((header, at, start, (payloads.len() - start) as u32));
        next = window.find_header(at + u64::from(header.length))?;
    }
    payloads.shrink_to_fit();
    let shared = Arc::new(payloads);
    let (mut whole, mut first_torn) = (Vec::with_capacity(found.len()), u64::MAX);
    for (header, at, start, length) in found {
        let frame = Frame { header, at, payload: Payload { shared: Arc::clone(&shared), start, length } };
        if frame.at < durable || window.is_whole(&frame)? {
            whole.push(frame);
        } else {
            first_torn = first_torn.min(frame.at);
        }
    }
    let end = whole.last().map_or(from, |frame: &Frame| frame.at + u64::from(frame.header.length));
    Ok(Scan { frames: whole, end, is_torn: first_torn < end })
}

/// A reader of a file by offset that remembers the stretch it read last.
struct Window<'a> {
    file: &'a File,
    size: u64,
    start: u64,
    bytes: Vec<u8>,
}

impl Window<'_> {
    /// `length` bytes at `at`, fewer where the file ends.
    fn read(&mut self, at: u64, length: usize) -> io::Result<&[u8]> {
        let length = length.min(self.size.saturating_sub(at) as usize);
        let inside = at >= self.start && at + length as u64 <= self.start + self.bytes.len() as u64;
        if !inside {
            self.fill(at, length.max(WINDOW_BYTES))?;
        }
        let offset = (at - self.start) as usize;
        Ok(&self.bytes[offset..(offset + length).min(self.bytes.len())])
    }

    fn fill(&mut self, at: u64, length: usize) -> io::Result<()> {
        self.bytes.resize(length.min(self.size.saturating_sub(at) as usize), 0);
        self.start = at;
        let mut filled = 0;
        while filled < self.bytes.len() {
            match self.file.read_at(&mut self.bytes[filled..], at + filled as u64) {
                Ok(0) => break,
                Ok(count) => filled += count,
                Err(fault) if fault.kind() == io::ErrorKind::Interrupted => {}
                Err(fault) => return Err(fault),
            }
        }
        self.bytes.truncate(filled);
        Ok(())
    }

    /// The first header at or after `at` whose frame is inside the file; past damage, that may be far.
    fn find_header(&mut self, mut at: u64) -> io::Result<Option<(u64, Header)>> {
        while at + HEADER_BYTES as u64 <= self.size {
            let size = self.size;
            let bytes = self.read(at, HEADER_BYTES)?;
            let header = Header::decode(bytes).filter(|header| at + header.frame_bytes() <= size);
            if let Some(header) = header.filter(|header| !self.is_hollow(at, header)) {
                return Ok(Some((at, header)));
            }
            at = self.find_magic(at + 1)?;
        }
        Ok(None)
    }

    /// Whether a large payload has a hole: nobody has written it, and read into memory it takes what it does not take on
    /// disk.
    fn is_hollow(&self, at: u64, header: &Header) -> bool {
        let payload = at + HEADER_BYTES as u64;
        u64::from(header.length) > LARGE_BYTES
            && self.seek(SeekFrom::Hole(payload)) < payload + u64::from(header.length)
    }

    /// Where the next hole or the next data begins, the end of the file where there is none; `at` on file systems that
    /// cannot say.
    fn seek(&self, from: SeekFrom) -> u64 {
        let is_end = |fault: &Errno| *fault == Errno::NXIO;
        match (rustix::fs::seek(self.file, from), from) {
            (Ok(found), _) => found,
            (Err(fault), _) if is_end(&fault) => self.size,
            (Err(_), SeekFrom::Data(at)) => at,
            (Err(_), _) => self.size,
        }
    }

    /// The offset of the next magic at or after `at`, or the end of the file.
    fn find_magic(&mut self, mut at: u64) -> io::Result<u64> {
        while at + MAGIC.len() as u64 <= self.size {
            let bytes = self.read(at, WINDOW_BYTES)?;
            if let Some(offset) = bytes.windows(MAGIC.len()).position(|four| four == MAGIC) {
                return Ok(at + offset as u64);
            }
            at += bytes.len().saturating_sub(MAGIC.len() - 1).max(1) as u64;
            // A hole of terabytes takes no time.
            at = self.seek(SeekFrom::Data(at)).max(at);
        }
        Ok(self.size)
    }

    fn is_whole(&mut self, frame: &Frame) -> io::Result<bool> {
        if frame.header.kind != Kind::Blob {
            return Ok(frame.header.fits(&frame.payload));
        }
        let payload = self.read(frame.at, frame.header.length as usize)?;
        Ok(frame.header.fits(payload))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Digest;

    /// A file with three records and a blob, and the offset at which each frame ends.
    fn sample(marked: bool) -> (tempfile::NamedTempFile, Vec<u64>) {
        let file = tempfile::NamedTempFile::new().unwrap();
        let mut bytes = Vec::new();
        let mut ends = Vec::new();
        for (number, kind) in [Kind::Record, Kind::Blob, Kind::Note, Kind::File].into_iter().enumerate() {
            let payload = vec![number as u8; 10 + 60 * number];
            bytes.extend(Header::of(kind, Digest::of(&payload), number as u64, &payload).encode(&payload));
            ends.push(bytes.len() as u64);
        }
        if marked {
            let header = Header::of(Kind::Mark, Digest::of(b""), bytes.len() as u64, b"");
            bytes.extend(header.encode(b""));
        }
        file.as_file().write_all_at(&bytes, 0).unwrap();
        (file, ends)
    }

    #[test]
    fn a_tail_torn_at_any_byte_keeps_every_earlier_frame() {
        let (file, ends) = sample(false);
        for size in (0..=*ends.last().unwrap()).rev() {
            file.as_file().set_len(size).unwrap();
            let found = scan(file.as_file(), 0).unwrap();
            let expected: Vec<u64> = ends.iter().copied().filter(|end| *end <= size).collect();
            assert_eq!(found.frames.len(), expected.len(), "torn at {size}");
            assert_eq!(found.end, expected.last().copied().unwrap_or(0), "torn at {size}");
        }
    }

    #[test]
    fn damage_anywhere_costs_no_more_than_its_own_frame() {
        let (file, ends) = sample(false);
        let size = *ends.last().unwrap();
        for at in 0..size {
            let mut byte = [0];
            file.as_file().read_exact_at(&mut byte, at).unwrap();
            file.as_file().write_all_at(&[byte[0] ^ 0x55], at).unwrap();
            assert_eq!(scan(file.as_file(), 0).unwrap().frames.len(), ends.len() - 1, "damaged at {at}");
            file.as_file().write_all_at(&byte, at).unwrap();
        }
    }

    #[test]
    fn only_damage_that_a_mark_would_vouch_for_makes_a_segment_torn() {
        let (file, ends) = sample(false);
        let is_torn_at = |at: u64| {
            let mut byte = [0];
            file.as_file().read_exact_at(&mut byte, at).unwrap();
            file.as_file().write_all_at(&[byte[0] ^ 0x55], at).unwrap();
            let found = scan(file.as_file(), 0).unwrap();
            file.as_file().write_all_at(&byte, at).unwrap();
            found.is_torn
        };
        assert!(is_torn_at(ends[1] - 1), "the payload of a frame in the middle");
        assert!(!is_torn_at(ends[1]), "a header: the frame is never found again");
        assert!(!is_torn_at(ends[3] - 1), "the last frame: it is cut off");
    }

    #[test]
    fn before_a_mark_payloads_are_left_for_later() {
        let (file, ends) = sample(true);
        file.as_file().write_all_at(b"!", ends[1] - 1).unwrap();
        assert_eq!(scan(file.as_file(), 0).unwrap().frames.len(), ends.len() + 1);
    }

    #[test]
    fn a_large_payload_with_a_hole_takes_no_memory_and_what_follows_it_is_found() {
        let file = tempfile::NamedTempFile::new().unwrap();
        let (hollow, hole) = (Header { length: 1 << 29, ..header(b"") }, 1 << 40);
        file.as_file().write_all_at(&hollow.encode(b""), 0).unwrap();
        file.as_file().write_all_at(&hollow.encode(b""), hole).unwrap();
        let last = hole + hollow.frame_bytes();
        file.as_file().write_all_at(&header(b"whole").encode(b"whole"), last).unwrap();
        let frames = scan(file.as_file(), 0).unwrap().frames;
        let found: Vec<_> = frames.iter().map(|frame| (frame.at - HEADER_BYTES as u64, frame.payload.len())).collect();
        if rustix::fs::seek(file.as_file(), SeekFrom::Hole(0)).unwrap() > hole {
            println!("skipped: this file system knows no holes");
        } else {
            assert_eq!(found, [(last, 5)]);
        }
    }

    fn header(payload: &[u8]) -> Header {
        Header::of(Kind::Record, Digest::of(b"key"), 1, payload)
    }

    #[test]
    fn a_scan_may_start_where_the_last_one_ended() {
        let (file, ends) = sample(false);
        let rest = scan(file.as_file(), ends[1]).unwrap();
        assert_eq!(rest.frames.len(), 2);
        assert_eq!(scan(file.as_file(), rest.end).unwrap().frames.len(), 0);
    }

    #[test]
    fn a_segment_is_written_by_one_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.seg");
        let claim = |path: &Path| claim(path, Sharing::of(folder.path()));
        let first = claim(&path).unwrap();
        assert!(first.is_some());
        assert!(claim(&path).unwrap().is_none());
        // What a program that is being started has.
        let copy = first.as_ref().unwrap().try_clone().unwrap();
        drop(first);
        assert!(claim(&path).unwrap().is_some());
        drop(copy);
    }

    #[test]
    fn a_full_disk_is_reported_by_the_writer() {
        let path = Path::new("/dev/full");
        let Ok(file) = OpenOptions::new().append(true).open(path) else {
            println!("skipped: this system has no /dev/full");
            return;
        };
        let file = Arc::new(Locked::try_new(file).unwrap().unwrap());
        let mut writer = Writer { file, path: path.into(), segment: 0, end: 0, appended: 0, durable: 0 };
        let fault = writer.append(&Header::of(Kind::Note, Digest::of(b""), 1, b"x"), b"x").unwrap_err();
        assert!(matches!(fault, StoreError::DiskFull { .. }), "{fault}");
        assert_eq!((writer.end, writer.appended), (0, 0));
    }
}
