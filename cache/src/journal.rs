//! The journal: all segments of a store as one growing set of small blobs, records and notes.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock};
use std::time::{SystemTime, UNIX_EPOCH};

use crate::error::{At, StoreError};
use crate::frame::{Header, Kind, PAYLOAD_LIMIT};
use crate::index::{Index, Place};
use crate::locks::Locked;
use crate::segment::{FULL_BYTES, Frame, Payload, Writer, claim, scan};
use crate::sharing::Sharing;
use crate::{Digest, plain};

/// Ends the name of every segment.
const SUFFIX: &str = ".seg";

/// What a file system may be behind the clock with its times.
const COARSEST_TICK_NS: i128 = 100_000_000;

/// When a folder last changed, nanoseconds since 1970, and which folder it is.
type Stamp = (i128, u64);

/// Every segment of a store, and the one this process appends to once it has something to say.
#[derive(Debug)]
pub(crate) struct Journal {
    dir: PathBuf,
    /// Ends the names of the segments that this machine may append to; `None` for all.
    own: Option<String>,
    index: RwLock<Index>,
    writer: Mutex<Option<Writer>>,
    /// Segments that were read from, opened once; one that is removed meanwhile can still be read.
    readers: Mutex<BTreeMap<u32, Arc<File>>>,
    /// The names of the segments when the folder was last listed, and its stamp then, where a change since would show.
    listed: Mutex<Option<(Stamp, Vec<String>)>>,
    /// Folders whose new entries must be on disk before the records that reference them.
    owed: Mutex<BTreeSet<PathBuf>>,
}

impl Journal {
    /// Reads every segment in `dir`.
    pub(crate) fn open(dir: &Path, own: Option<String>) -> Result<Self, StoreError> {
        let journal = Self {
            dir: dir.to_owned(),
            own,
            index: RwLock::default(),
            writer: Mutex::default(),
            readers: Mutex::default(),
            listed: Mutex::default(),
            owed: Mutex::default(),
        };
        journal.refresh()?;
        Ok(journal)
    }

    /// Calls `look` with the index, which others may read meanwhile.
    pub(crate) fn with_index<T>(&self, look: impl FnOnce(&Index) -> T) -> T {
        look(&self.index.read().unwrap_or_else(PoisonError::into_inner))
    }

    /// Every entry into the index is complete in itself, so a panic elsewhere leaves it sound.
    pub(crate) fn edit_index<T>(&self, edit: impl FnOnce(&mut Index) -> T) -> T {
        edit(&mut self.index.write().unwrap_or_else(PoisonError::into_inner))
    }

    /// Reads what the segments have gained since they were last read; all of them anew where one has been removed, since
    /// what it held may be elsewhere now.
    pub(crate) fn refresh(&self) -> Result<(), StoreError> {
        // Taken before the folder is listed: a segment that is begun and read meanwhile is not among those removed.
        let read = self.with_index(Index::read_names);
        let names = self.listing()?;
        if read.iter().any(|name| !names.contains(name)) {
            // Nothing may be appended between the clearing and the reading: it would be entered twice or lost.
            let _writer = self.writer();
            self.edit_index(Index::clear);
            return self.read_all(self.names()?, None);
        }
        let own = self.writer().as_ref().map(|writer| writer.segment);
        self.read_all(names, own)
    }

    /// Reads what these segments have gained; not the one that only this process may append to.
    fn read_all(&self, names: Vec<String>, own: Option<u32>) -> Result<(), StoreError> {
        for name in names {
            let known = self.with_index(|index| index.known_segment(&name));
            let number = known.unwrap_or_else(|| self.edit_index(|index| index.segment(&name)));
            if own == Some(number) {
                continue;
            }
            let path = self.dir.join(&name);
            let seen = self.with_index(|index| index.seen(number)).end;
            match plain::settled(|| plain::open(&path)) {
                Ok(file) if file.metadata().at("look at", &path)?.len() > seen => {
                    self.read_on(&file, &path, number)?;
                }
                Ok(_) => {}
                // Listed a moment ago and removed since: what it held is gone with it.
                Err(fault) if fault.kind() == std::io::ErrorKind::NotFound => {}
                Err(fault) => return Err(StoreError::io("open", &path, fault)),
            }
        }
        Ok(())
    }

    /// Enters what `file` has gained since it was last read; returns the end of its last whole frame.
    fn read_on(&self, file: &File, path: &Path, number: u32) -> Result<u64, StoreError> {
        let seen = self.with_index(|index| index.seen(number)).end;
        let found = scan(file, seen).at("read", path)?;
        self.edit_index(|index| {
            index.enter(number, found.frames, found.end);
            if found.is_torn {
                index.note_torn(number);
            }
        });
        Ok(found.end)
    }

    /// Whether these are all the segments this handle knows of, each read to its very end.
    pub(crate) fn has_read<'a>(&self, segments: impl Iterator<Item = (&'a str, u64)>) -> bool {
        self.with_index(|index| index.is_read(segments))
    }

    /// The names of the segments, from the last time they were listed if the folder has not changed since.
    fn listing(&self) -> Result<Vec<String>, StoreError> {
        // The times of a network file system are another machine's, and may be old.
        if self.own.is_some() {
            return self.names();
        }
        let folder = std::fs::metadata(&self.dir).at("look at", &self.dir)?;
        let stamp = (i128::from(folder.ctime()) * 1_000_000_000 + i128::from(folder.ctime_nsec()), folder.ino());
        let mut listed = self.listed.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, names)) = listed.as_ref().filter(|(then, _)| *then == stamp) {
            return Ok(names.clone());
        }
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as i128);
        let names = self.names()?;
        *listed = (stamp.0 + COARSEST_TICK_NS < now).then(|| (stamp, names.clone()));
        Ok(names)
    }

    /// The names of the segments, sorted.
    pub(crate) fn names(&self) -> Result<Vec<String>, StoreError> {
        let mut names = Vec::new();
        for entry in std::fs::read_dir(&self.dir).at("list", &self.dir)? {
            let name = entry.at("list", &self.dir)?.file_name();
            names.extend(name.into_string().ok().filter(|name| name.ends_with(SUFFIX)));
        }
        names.sort_unstable();
        Ok(names)
    }

    /// Appends payloads under their names to the segment of this process, in this order and with one write.
    pub(crate) fn append_all(&self, entries: &[(Kind, Digest, &[u8])]) -> Result<(), StoreError> {
        let mut slot = self.writer();
        // Another thread may have stored the same blob while this one waited. A segment that is written to stays.
        let own = slot.as_ref().map(|writer| writer.segment);
        let is_safe = |place: Place| place.is_recent() || own == Some(place.segment);
        let is_new = |(kind, name, _): &&(Kind, Digest, &[u8])| {
            *kind != Kind::Blob || !self.with_index(|index| index.blob(name)).is_some_and(is_safe)
        };
        let new: Vec<_> = entries.iter().filter(is_new).collect();
        if new.is_empty() { Ok(()) } else { self.append_to(&mut slot, &new) }
    }

    fn append_to(&self, slot: &mut Option<Writer>, entries: &[&(Kind, Digest, &[u8])]) -> Result<(), StoreError> {
        if let Some((_, _, payload)) = entries.iter().find(|(_, _, payload)| payload.len() as u64 > PAYLOAD_LIMIT) {
            let bytes = payload.len() as u64;
            return Err(StoreError::TooLarge { what: "an entry", bytes, limit: PAYLOAD_LIMIT });
        }
        if slot.as_ref().is_some_and(|writer| writer.end > FULL_BYTES) {
            let full = slot.take();
            full.map_or(Ok(()), |full| full.file.sync_data().at("sync", &full.path))?;
        }
        let writer = match slot {
            Some(writer) => writer,
            None => slot.insert(self.claim_segment()?),
        };
        let framed =
            entries.iter().map(|(kind, name, payload)| Ok((Header::of(*kind, *name, self.tick()?, payload), *payload)));
        let framed = framed.collect::<Result<Vec<_>, StoreError>>()?;
        let places = writer.append_all(&framed);
        let (segment, end) = (writer.segment, writer.end);
        let places = places.inspect_err(|_| drop(slot.take()))?;
        let frame = |((header, payload), at): ((Header, &[u8]), u64)| {
            let payload = if header.kind == Kind::Blob { Payload::default() } else { payload.into() };
            Frame { header, at, payload }
        };
        let frames = framed.into_iter().zip(places).map(frame).collect();
        self.edit_index(|index| index.enter(segment, frames, end));
        Ok(())
    }

    fn tick(&self) -> Result<u64, StoreError> {
        self.edit_index(Index::tick).ok_or_else(|| StoreError::Clock { dir: self.dir.clone() })
    }

    fn writer(&self) -> MutexGuard<'_, Option<Writer>> {
        self.writer.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Continues the first segment that has room and no live writer, or starts a new one.
    fn claim_segment(&self) -> Result<Writer, StoreError> {
        let names = self.names()?.into_iter();
        for name in names.filter(|name| self.own.as_ref().is_none_or(|own| name.ends_with(own.as_str()))) {
            match self.claim_named(&name) {
                Ok(Some(writer)) => return Ok(writer),
                // Another user's, who lets others only read it.
                Err(StoreError::Io { source, .. }) if plain::is_refused(&source) => {}
                claimed => drop(claimed?),
            }
        }
        self.begin_segment()
    }

    /// Starts a new segment of this process, named after the stamp and the process so that names ascend in time.
    fn begin_segment(&self) -> Result<Writer, StoreError> {
        loop {
            let stamp = self.tick()?;
            let name = format!("{stamp:016x}-{:x}{}", std::process::id(), self.own_suffix());
            if let Some(writer) = self.claim_named(&name)? {
                self.owe(&self.dir);
                return Ok(writer);
            }
        }
    }

    /// Who may use the segments: whom the folder around theirs lets in.
    pub(crate) fn sharing(&self) -> Sharing {
        Sharing::of(self.dir.parent().unwrap_or(&self.dir))
    }

    /// The path of a segment.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.dir.join(name)
    }

    /// Makes the segment of this process durable and releases it; the next entry goes to whichever segment has room.
    pub(crate) fn rest(&self) -> Result<(), StoreError> {
        self.sync()?;
        drop(self.writer().take());
        Ok(())
    }

    /// Lets go of the segment of this process as it is.
    pub(crate) fn release(&self) {
        drop(self.writer().take());
    }

    /// How the names of segments of this machine end.
    pub(crate) fn own_suffix(&self) -> &str {
        self.own.as_deref().unwrap_or(SUFFIX)
    }

    /// Appends a frame that is in another segment, with the stamp it had. It goes to a segment that was begun for this.
    pub(crate) fn append_again(&self, header: &Header, payload: &[u8]) -> Result<(), StoreError> {
        let mut slot = self.writer();
        if slot.as_ref().is_some_and(|writer| writer.end > FULL_BYTES) {
            let full = slot.take();
            full.map_or(Ok(()), |full| full.file.sync_data().at("sync", &full.path))?;
        }
        let writer = match &mut *slot {
            Some(writer) => writer,
            None => slot.insert(self.begin_segment()?),
        };
        writer.append(header, payload).inspect_err(|_| drop(slot.take()))?;
        Ok(())
    }

    /// Claims one segment, reads it to its end and cuts off what a dead writer left torn there.
    fn claim_named(&self, name: &str) -> Result<Option<Writer>, StoreError> {
        let path = self.dir.join(name);
        let Some(file) = claim(&path, self.sharing())? else {
            return Ok(None);
        };
        let size = file.metadata().at("look at", &path)?.len();
        if size > FULL_BYTES {
            return Ok(None);
        }
        let segment = self.edit_index(|index| index.segment(name));
        let end = self.read_on(&file, &path, segment)?;
        // Continued, it would be marked as synced, and what a power cut tore would count as whole. It is read as it is
        // until a collection writes it anew.
        if self.with_index(|index| index.seen(segment).is_torn) {
            return Ok(None);
        }
        if size > end {
            file.set_len(end).at("cut the torn tail of", &path)?;
        }
        Ok(Some(Writer { file: Arc::new(file), path, segment, end, appended: end, durable: 0 }))
    }

    /// Makes the new entries of `folder` part of the next sync.
    pub(crate) fn owe(&self, folder: &Path) {
        self.owed().insert(folder.to_owned());
    }

    fn owed(&self) -> MutexGuard<'_, BTreeSet<PathBuf>> {
        self.owed.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Makes everything appended so far durable: first the folders owed, then the segment. Appending goes on meanwhile.
    pub(crate) fn sync(&self) -> Result<(), StoreError> {
        // The end is read before the folders: the folders that earlier records reference are listed already.
        let pending = self.pending();
        self.sync_folders()?;
        pending.map_or(Ok(()), |pending| self.settle(&pending))
    }

    /// What has been appended and is not known to be on disk.
    fn pending(&self) -> Option<Pending> {
        self.writer().as_ref().filter(|writer| writer.appended > writer.durable).map(Pending::of)
    }

    /// Makes it durable and marks it so, unless another thread has done that meanwhile.
    fn settle(&self, pending: &Pending) -> Result<(), StoreError> {
        pending.file.sync_data().at("sync", &pending.path)?;
        let mut slot = self.writer();
        let is_open = |writer: &&mut Writer| writer.segment == pending.segment && writer.durable < pending.end;
        match slot.as_mut().filter(is_open) {
            Some(writer) => self.mark(writer, pending.end).inspect_err(|_| drop(slot.take())),
            None => Ok(()),
        }
    }

    fn sync_folders(&self) -> Result<(), StoreError> {
        let folders = std::mem::take(&mut *self.owed());
        for folder in &folders {
            let synced = File::open(folder).and_then(|folder| folder.sync_all());
            synced.at("sync", folder).inspect_err(|_| self.owed().extend(folders.iter().cloned()))?;
        }
        Ok(())
    }

    /// Notes in the segment that everything before `end` is on disk.
    fn mark(&self, writer: &mut Writer, end: u64) -> Result<(), StoreError> {
        writer.append(&Header::of(Kind::Mark, Digest::of(b""), end, b""), b"")?;
        writer.durable = end;
        self.edit_index(|index| index.enter(writer.segment, Vec::new(), writer.end));
        Ok(())
    }

    /// The bytes at `place`, unverified; none where the segment has been removed.
    pub(crate) fn read(&self, place: Place) -> Result<Vec<u8>, StoreError> {
        self.read_if_there(place).map(Option::unwrap_or_default)
    }

    /// The bytes at `place`, unverified: fewer where the segment has been cut, `None` where it has been removed.
    pub(crate) fn read_if_there(&self, place: Place) -> Result<Option<Vec<u8>>, StoreError> {
        let Some(file) = self.reader(place.segment)? else { return Ok(None) };
        let mut bytes = vec![0; place.length as usize];
        let mut filled = 0;
        while filled < bytes.len() {
            match file.read_at(&mut bytes[filled..], place.at + filled as u64) {
                Ok(0) => break,
                Ok(count) => filled += count,
                Err(fault) if fault.kind() == std::io::ErrorKind::Interrupted => {}
                Err(fault) => return Err(StoreError::io("read", &self.segment_path(place.segment), fault)),
            }
        }
        bytes.truncate(filled);
        Ok(Some(bytes))
    }

    /// A segment to read from; none where it has been removed before it was first read.
    fn reader(&self, segment: u32) -> Result<Option<Arc<File>>, StoreError> {
        let mut readers = self.readers.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(file) = readers.get(&segment) {
            return Ok(Some(Arc::clone(file)));
        }
        let path = self.segment_path(segment);
        match plain::settled(|| plain::open(&path)) {
            Ok(file) => Ok(Some(Arc::clone(readers.entry(segment).or_insert(Arc::new(file))))),
            Err(fault) if fault.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(fault) => Err(StoreError::io("open", &path, fault)),
        }
    }

    fn segment_path(&self, segment: u32) -> PathBuf {
        self.path(&self.with_index(|index| index.seen(segment)).name)
    }
}

/// What a sync needs to know of the writer once its lock is released.
struct Pending {
    file: Arc<Locked>,
    path: PathBuf,
    segment: u32,
    /// Where the last frame ends.
    end: u64,
}

impl Pending {
    fn of(writer: &Writer) -> Self {
        let Writer { file, path, segment, end, .. } = writer;
        Self { file: Arc::clone(file), path: path.clone(), segment: *segment, end: *end }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_syncs_at_once_leave_one_mark() {
        let folder = tempfile::tempdir().unwrap();
        let journal = Journal::open(folder.path(), None).unwrap();
        journal.append_all(&[(Kind::Note, Digest::of(b"name"), b"note")]).unwrap();
        let (one, other) = (journal.pending().unwrap(), journal.pending().unwrap());
        journal.settle(&one).unwrap();
        let size = || std::fs::metadata(&one.path).unwrap().len();
        let marked = size();
        assert!(marked > one.end);
        journal.settle(&other).unwrap();
        assert_eq!(size(), marked);
    }

    #[test]
    fn a_segment_that_may_not_be_written_to_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let note = |text: &'static [u8]| [(Kind::Note, Digest::of(text), text)];
        let (one, other) = (Journal::open(folder.path(), None).unwrap(), Journal::open(folder.path(), None).unwrap());
        one.append_all(&note(b"one")).unwrap();
        drop(one);
        let path = other.path(&other.names().unwrap()[0]);
        std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o444)).unwrap();
        if std::fs::File::options().append(true).open(&path).is_ok() {
            println!("skipped: root may write to everything");
            return;
        }
        other.append_all(&note(b"other")).unwrap();
        assert_eq!(other.names().unwrap().len(), 2);
        assert_eq!(other.claim_all(|_| false).unwrap().busy(), 1);
    }

    #[test]
    fn a_segment_that_another_process_begins_is_seen_at_once_and_later() {
        let folder = tempfile::tempdir().unwrap();
        let (one, other) = (Journal::open(folder.path(), None).unwrap(), Journal::open(folder.path(), None).unwrap());
        let has = |note: &[u8]| one.with_index(|index| index.payload(Kind::Note, &Digest::of(note)).is_some());
        for (note, pause_ms) in [(b"first", 0), (b"later", 0), (b"again", 150)] {
            std::thread::sleep(std::time::Duration::from_millis(pause_ms));
            one.refresh().unwrap();
            assert!(pause_ms == 0 || one.listed.lock().unwrap().is_some());
            other.append_all(&[(Kind::Note, Digest::of(note), note)]).unwrap();
            // The next one goes to a segment of its own.
            let taken = other.writer().take();
            std::mem::forget(taken);
            one.refresh().unwrap();
            assert!(has(note), "{}", String::from_utf8_lossy(note));
        }
        assert_eq!(one.names().unwrap().len(), 3);
    }
}
