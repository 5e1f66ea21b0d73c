//! Named files in one: the POSIX archive format (ustar) that every system unpacks, without times, owners or modes of its own.

use std::collections::BTreeSet;
use std::io::Cursor;

use tar::{Archive, Builder, EntryType, Header};

use crate::artefact::CodecError;

const BLOCK: usize = 512;
/// Longest name of a file in it, bytes, and longest part of one: what file systems hold.
const LONGEST_NAME: usize = 4095;
const LONGEST_PART: usize = 255;
/// Fields of a header that differ between files: name, length, checksum, and the start of a long name.
const VARYING: [std::ops::Range<usize>; 4] = [0..100, 124..136, 148..156, 345..500];

/// Name and content of each file.
type Named = Vec<(String, Vec<u8>)>;

/// Writes an archive; equal files give equal bytes. A name that has no room in a header comes before it, as GNU tar does it.
///
/// # Errors
///
/// A name that is empty, longer than file systems hold, absolute, or leads out of its folder; two files of one name.
pub fn write(files: &[(String, Vec<u8>)]) -> Result<Vec<u8>, CodecError> {
    check_names(files.iter().map(|(name, _)| name.as_str()))?;
    let mut archive = Builder::new(Vec::new());
    for (name, bytes) in files {
        append(&mut archive, name, bytes)
            .map_err(|e| CodecError(format!("`{name}` cannot be written to an archive: {e}")))?;
    }
    archive.into_inner().map_err(|e| CodecError(format!("an archive cannot be written: {e}")))
}

fn append(archive: &mut Builder<Vec<u8>>, name: &str, bytes: &[u8]) -> std::io::Result<()> {
    if bytes.len() >= 1 << 33 {
        return Err(std::io::Error::other(format!("it has {} bytes, an archive holds files below 8 GiB", bytes.len())));
    }
    let mut named = header(bytes.len());
    if named.set_path(name).is_err() {
        return archive.append_data(&mut header(bytes.len()), name, bytes);
    }
    seal(&mut named);
    archive.append(&named, bytes)
}

/// A header without name and checksum.
fn header(length: usize) -> Header {
    let mut header = Header::new_ustar();
    header.set_entry_type(EntryType::Regular);
    header.set_mode(0o644);
    header.set_uid(0);
    header.set_gid(0);
    header.set_mtime(0);
    header.set_size(length as u64);
    header
}

/// Puts the checksum in: six digits, zero, blank, as the standard has it.
fn seal(header: &mut Header) {
    header.as_old_mut().cksum = *b"        ";
    let sum: u32 = header.as_bytes().iter().map(|byte| u32::from(*byte)).sum();
    header.as_old_mut().cksum.copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
}

fn check_names<'a>(names: impl Iterator<Item = &'a str>) -> Result<(), CodecError> {
    let mut known = BTreeSet::new();
    for name in names {
        check_name(name)?;
        if !known.insert(name) {
            return Err(CodecError(format!("two files of an archive are called `{name}`")));
        }
    }
    let above = |name: &&str| name.match_indices('/').any(|(at, _)| known.contains(&name[..at]));
    known.iter().copied().find(above).map_or(Ok(()), |name| {
        Err(CodecError(format!("`{name}` cannot be in an archive: a file of it has the name of its folder")))
    })
}

fn check_name(name: &str) -> Result<(), CodecError> {
    let climbs = |part: &str| part.is_empty() || part == "." || part == ".." || part.len() > LONGEST_PART;
    let is_odd = |letter: char| letter.is_control() || letter == '\\';
    if name.split('/').any(climbs) || name.len() > LONGEST_NAME || name.contains(is_odd) {
        let shown: String = name.chars().take(200).collect();
        return Err(CodecError::new(format!("`{}` cannot name a file in an archive", shown.escape_debug())));
    }
    Ok(())
}

/// Reads an archive: one of ours with its files in their order, one of another program (ustar, pax, GNU) with its files in
/// alphabetical order, so that equal files make equal values. Folders, times, owners and modes are left out.
///
/// # Errors
///
/// What is cut short or damaged; a name that leads out of the folder or is there twice; links, devices, sparse files.
pub fn read(archive: &[u8]) -> Result<Named, CodecError> {
    let damaged = |why: &dyn std::fmt::Display| CodecError(format!("a damaged archive, or none (tar): {why}"));
    let mut reader = Archive::new(Cursor::new(archive));
    let (mut files, mut is_ours, mut end) = (Named::new(), true, 0);
    let ours = header(0);
    for entry in reader.entries_with_seek().map_err(|e| damaged(&e))? {
        let entry = entry.map_err(|e| damaged(&e))?;
        let name = String::from_utf8(entry.path_bytes().into_owned()).map_err(|_| damaged(&"a name is not UTF-8"))?;
        let file = file_name(entry.header().entry_type(), &name)?;
        let data = usize::try_from(entry.raw_file_position()).ok().and_then(|start| archive.get(start..));
        let size = usize::try_from(entry.size()).ok();
        let held = data.zip(size).filter(|(data, size)| data.len() >= size.next_multiple_of(BLOCK));
        let (data, size) = held.ok_or_else(|| damaged(&format!("it ends within `{name}`")))?;
        end = archive.len() - data.len() + size.next_multiple_of(BLOCK);
        is_ours &= same_form(entry.header(), &ours);
        if let Some(name) = file {
            files.push((name, data[..size].to_vec()));
        }
    }
    let rest = &archive[end.min(archive.len())..];
    if rest.len() < 2 * BLOCK || rest.iter().any(|byte| *byte != 0) {
        return Err(damaged(&"two empty blocks do not end it"));
    }
    check_names(files.iter().map(|(name, _)| name.as_str()))?;
    if !is_ours {
        files.sort_unstable_by(|a, b| a.0.cmp(&b.0));
    }
    Ok(files)
}

/// Whether a header is as [`header`] makes it, but for what differs between files.
fn same_form(found: &Header, ours: &Header) -> bool {
    let varies = |at: usize| VARYING.iter().any(|field| field.contains(&at));
    found.as_bytes().iter().zip(ours.as_bytes()).enumerate().all(|(at, (a, b))| a == b || varies(at))
}

/// The name of a file without `./` before it; `None` for folders and for what describes the whole archive.
fn file_name(kind: EntryType, name: &str) -> Result<Option<String>, CodecError> {
    let parts: Vec<&str> = name.split('/').filter(|part| !part.is_empty() && *part != ".").collect();
    let is_folder = kind.is_dir() || name.ends_with('/');
    if kind.is_pax_global_extensions() {
        return Ok(None);
    }
    if name.starts_with('/') || parts.contains(&"..") {
        return Err(unsafe_entry(name, "leads out of the folder"));
    }
    match kind {
        _ if is_folder => Ok(None),
        EntryType::Regular | EntryType::Continuous => Ok(Some(parts.join("/"))),
        EntryType::Link | EntryType::Symlink => {
            Err(unsafe_entry(name, "is a link; pack what it leads to (`tar --dereference --hard-dereference`)"))
        }
        EntryType::GNUSparse => Err(unsafe_entry(name, "is stored as a sparse file; pack it without `--sparse`")),
        _ => Err(unsafe_entry(name, "is neither a file nor a folder")),
    }
}

fn unsafe_entry(name: &str, why: &str) -> CodecError {
    let shown: String = name.chars().take(200).collect();
    CodecError(format!("the archive holds `{}`, which {why}", shown.escape_debug()))
}

#[cfg(test)]
mod tests;
