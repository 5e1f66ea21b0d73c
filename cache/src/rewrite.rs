//! Writing segments anew: what counts is copied to a new one, made durable, and the old one goes.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::ErrorKind;

use crate::error::{At, StoreError};
use crate::frame::{Header, Kind};
use crate::index::{Index, Place};
use crate::journal::Journal;
use crate::locks::Locked;
use crate::segment::{Frame, claim, scan};
use crate::{Digest, plain};

/// Records, small blobs and notes on run folders that leave, each with the stamp it had when that was decided: one written since stays.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Leaving {
    /// The stamps of records by key.
    pub records: BTreeMap<Digest, u64>,
    /// The stamps of small blobs by digest.
    pub blobs: BTreeMap<Digest, u64>,
    /// The stamps of notes by the names they are kept under.
    pub notes: BTreeMap<Digest, u64>,
}

impl Leaving {
    /// Whether the frame of this header leaves.
    pub(crate) fn has(&self, header: &Header) -> bool {
        let stamps = match header.kind {
            Kind::Record => &self.records,
            Kind::Blob => &self.blobs,
            Kind::Note => &self.notes,
            _ => return false,
        };
        stamps.get(&header.name) == Some(&header.stamp)
    }
}

/// The segments there are: those nobody writes to are held, so that nobody begins to.
#[derive(Debug)]
pub(crate) struct Claimed {
    free: Vec<(String, Locked)>,
    busy: Vec<String>,
}

impl Claimed {
    /// How many are being written to, or may not be, and stay as they are.
    pub(crate) fn busy(&self) -> u64 {
        self.busy.len() as u64
    }
}

impl Journal {
    /// Takes hold of every segment nobody is writing to, nor may be where the locks of this machine do not tell (`is_busy`), and reads all of them to their ends.
    pub(crate) fn claim_all(&self, is_busy: impl Fn(&str) -> bool) -> Result<Claimed, StoreError> {
        // This process may continue a segment; from now on it writes to a new one.
        self.rest()?;
        let mut claimed = Claimed { free: Vec::new(), busy: Vec::new() };
        for name in self.names()? {
            let found = match claim(&self.path(&name), self.sharing()) {
                // Another user's, who lets others only read it.
                Err(StoreError::Io { source, .. }) if plain::is_refused(&source) => None,
                found => found?,
            };
            match found {
                Some(file) if !is_busy(&name) => claimed.free.push((name, file)),
                _ => claimed.busy.push(name),
            }
        }
        // Not before: what was written to one of them until it was claimed counts too.
        self.refresh()?;
        Ok(claimed)
    }

    /// The names of all records and notes, superseded ones too, in the segments that stay as they are: such a one would count again if what
    /// superseded it left.
    pub(crate) fn busy_names(&self, claimed: &Claimed) -> Result<BTreeSet<Digest>, StoreError> {
        let mut keys = BTreeSet::new();
        for name in &claimed.busy {
            let path = self.path(name);
            let file = match plain::settled(|| plain::open(&path)) {
                Err(fault) if fault.kind() == ErrorKind::NotFound => continue,
                file => file.at("open", &path)?,
            };
            let frames = scan(&file, 0).at("read", &path)?.frames;
            let named = frames.iter().filter(|one| matches!(one.header.kind, Kind::Record | Kind::Note));
            keys.extend(named.map(|one| one.header.name));
        }
        Ok(keys)
    }

    /// Copies what counts and `stays` from the claimed segments, and makes it durable. At no moment is anything that
    /// stays in no segment at all, on disk too.
    pub(crate) fn copy_all(&self, claimed: &Claimed, stays: impl Fn(&Header) -> bool) -> Result<(), StoreError> {
        let before = self.names()?;
        let copied = claimed.free.iter().try_for_each(|(name, file)| self.copy_live(name, file, &stays));
        copied.and_then(|()| self.rest()).inspect_err(|_| self.forget_copies(&before))
    }

    /// Removes the segments that a copy which failed has begun: they hold nothing that is not in those it was copied from.
    fn forget_copies(&self, before: &[String]) {
        self.release();
        let own = format!("-{:x}{}", std::process::id(), self.own_suffix());
        let begun = self.names().unwrap_or_default().into_iter().filter(|name| name.ends_with(&own));
        for name in begun.filter(|name| !before.contains(name)) {
            // In another container a process may have the same number, and holds its own.
            if let Ok(Some(_held)) = claim(&self.path(&name), self.sharing()) {
                let _ = std::fs::remove_file(self.path(&name));
            }
        }
    }

    /// Removes the claimed segments, which are held until they are gone.
    pub(crate) fn remove(&self, claimed: &Claimed) -> Result<(), StoreError> {
        for (name, _held) in &claimed.free {
            let path = self.path(name);
            std::fs::remove_file(&path).at("remove", &path)?;
        }
        self.refresh()
    }

    fn copy_live(&self, name: &str, file: &File, stays: &impl Fn(&Header) -> bool) -> Result<(), StoreError> {
        let path = self.path(name);
        let segment = self.edit_index(|index| index.segment(name));
        for frame in scan(file, 0).at("read", &path)?.frames {
            if stays(&frame.header) && self.with_index(|index| is_latest(index, segment, &frame)) {
                self.copy(segment, &frame)?;
            }
        }
        Ok(())
    }

    fn copy(&self, segment: u32, frame: &Frame) -> Result<(), StoreError> {
        let header = frame.header;
        let payload = match header.kind {
            Kind::Blob => self.read(Place { segment, at: frame.at, length: header.length, stamp: header.stamp })?,
            _ => frame.payload.to_vec(),
        };
        if header.fits(&payload) {
            return self.append_again(&header, &payload);
        }
        // What is damaged is not carried over: it could not have been read either.
        Ok(())
    }
}

/// Whether what a frame says still counts.
fn is_latest(index: &Index, segment: u32, frame: &Frame) -> bool {
    let Header { kind, name, stamp, .. } = frame.header;
    match kind {
        Kind::Blob => index.blob(&name).is_some_and(|place| (place.segment, place.at) == (segment, frame.at)),
        Kind::Record | Kind::Note | Kind::File => index.stamp(kind, &name) == Some(stamp),
        Kind::Gone | Kind::Unknown => true,
        Kind::Mark => false,
    }
}
