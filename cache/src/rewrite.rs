//! Writing segments anew: what counts is copied to a new one, made durable, and the old one goes.

use std::collections::BTreeSet;
use std::fs::File;

use crate::Digest;
use crate::error::{At, StoreError};
use crate::frame::{Header, Kind};
use crate::index::{Index, Place};
use crate::journal::Journal;
use crate::segment::{Frame, claim, scan};

impl Journal {
    /// Drops these records and blobs, and all that was superseded, from every segment nobody is writing to; returns how
    /// many are being written to and stay as they are.
    ///
    /// At no moment is anything that stays in no segment at all, on disk too.
    pub(crate) fn rewrite(&self, records: &BTreeSet<Digest>, blobs: &BTreeSet<Digest>) -> Result<u64, StoreError> {
        self.refresh()?;
        // This process may continue a segment; from now on it writes to a new one.
        self.rest()?;
        let (mut busy, mut claimed) = (0, Vec::new());
        for name in self.names()? {
            match claim(&self.path(&name))? {
                Some(file) => claimed.push((name, file)),
                None => busy += 1,
            }
        }
        for (name, file) in &claimed {
            self.copy_live(name, file, records, blobs)?;
        }
        self.sync()?;
        self.rest()?;
        for (name, _) in &claimed {
            let path = self.path(name);
            std::fs::remove_file(&path).at("remove", &path)?;
        }
        self.refresh()?;
        Ok(busy)
    }

    fn copy_live(
        &self,
        name: &str,
        file: &File,
        records: &BTreeSet<Digest>,
        blobs: &BTreeSet<Digest>,
    ) -> Result<(), StoreError> {
        let path = self.path(name);
        let segment = self.edit_index(|index| index.segment(name));
        for frame in scan(file, 0).at("read", &path)?.frames {
            let leaves = match frame.header.kind {
                Kind::Record => records.contains(&frame.header.name),
                Kind::Blob => blobs.contains(&frame.header.name),
                Kind::Mark => true,
                _ => false,
            };
            if !leaves && self.with_index(|index| is_latest(index, segment, &frame)) {
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
