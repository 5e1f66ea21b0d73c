//! Named files in one: the POSIX archive format (ustar) that every system unpacks, without times, owners or modes of its own.

use crate::artefact::CodecError;

const BLOCK: usize = 512;
/// Longest name of a file in it, bytes.
pub const LONGEST_NAME: usize = 100;

/// Writes an archive; equal files give equal bytes.
///
/// # Errors
///
/// A name that is empty, longer than 100 bytes, absolute, or leads out of its folder.
pub fn write(files: &[(String, Vec<u8>)]) -> Result<Vec<u8>, CodecError> {
    let mut archive = Vec::new();
    for (name, bytes) in files {
        check_name(name)?;
        archive.extend(header(name, bytes.len())?);
        archive.extend(bytes);
        archive.resize(archive.len().next_multiple_of(BLOCK), 0);
    }
    archive.resize(archive.len() + 2 * BLOCK, 0);
    Ok(archive)
}

fn check_name(name: &str) -> Result<(), CodecError> {
    let climbs = name.split('/').any(|part| part.is_empty() || part == "." || part == "..");
    if climbs || name.len() > LONGEST_NAME || name.contains(['\0', '\\']) {
        return Err(CodecError::new(format!("`{}` cannot name a file in an archive", name.escape_debug())));
    }
    Ok(())
}

fn header(name: &str, length: usize) -> Result<[u8; BLOCK], CodecError> {
    if length >= 1 << 33 {
        return Err(CodecError::new(format!("`{name}` has {length} bytes: an archive holds files below 8 GiB")));
    }
    let mut header = [0; BLOCK];
    let mut put = |at: usize, text: &str| header[at..at + text.len()].copy_from_slice(text.as_bytes());
    put(0, name);
    put(100, "0000644");
    put(108, "0000000");
    put(116, "0000000");
    put(124, &format!("{length:011o}"));
    put(136, "00000000000");
    put(148, "        ");
    put(156, "0");
    put(257, "ustar\x0000");
    let sum = checksum(&header);
    header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
    Ok(header)
}

/// Sum of the bytes, those of the sum itself counted as blanks.
fn checksum(header: &[u8; BLOCK]) -> u32 {
    let count = |(at, byte): (usize, &u8)| if (148..156).contains(&at) { 32 } else { u32::from(*byte) };
    header.iter().enumerate().map(count).sum()
}

/// Reads what [`write()`] wrote.
pub fn read(archive: &[u8]) -> Result<Vec<(String, Vec<u8>)>, CodecError> {
    let damaged = |what: &str| CodecError::new(format!("not an archive as written here: {what}"));
    let (mut files, mut rest) = (Vec::new(), archive);
    loop {
        let Some((header, after)) = rest.split_first_chunk::<BLOCK>() else { return Err(damaged("it ends early")) };
        if header.iter().all(|byte| *byte == 0) {
            let ended = after.len() == BLOCK && after.iter().all(|byte| *byte == 0);
            return if ended { Ok(files) } else { Err(damaged("no end of two empty blocks")) };
        }
        let name = header[..LONGEST_NAME].split(|byte| *byte == 0).next().unwrap_or_default();
        let name = String::from_utf8(name.to_vec()).map_err(|_| damaged("a name is not UTF-8"))?;
        let length = std::str::from_utf8(&header[124..135]).ok().and_then(|text| usize::from_str_radix(text, 8).ok());
        let length = length.ok_or_else(|| damaged("a length is no octal number"))?;
        check_name(&name)?;
        if header != &self::header(&name, length)? {
            return Err(damaged("a header is not as written here"));
        }
        let padded = length.next_multiple_of(BLOCK);
        if after.len() < padded || after[length..padded].iter().any(|byte| *byte != 0) {
            return Err(damaged("a file ends early"));
        }
        files.push((name, after[..length].to_vec()));
        rest = &after[padded..];
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn files_come_back(files in proptest::collection::vec(("[a-z]{1,9}(/[a-zA-Z0-9._-]{2,20}x)?", proptest::collection::vec(any::<u8>(), 0..1200)), 0..4)) {
            let archive = write(&files).unwrap();
            prop_assert_eq!(archive.len() % BLOCK, 0);
            prop_assert_eq!(read(&archive).unwrap(), files);
            for end in (0..archive.len()).step_by(97) {
                prop_assert!(read(&archive[..end]).is_err());
            }
        }
    }

    #[test]
    fn names_stay_in_their_folder() {
        for name in ["", "/a", "a//b", "../a", "a/..", "a\0b", &"x".repeat(101)] {
            assert!(write(&[(name.to_owned(), Vec::new())]).is_err(), "{name}");
        }
    }

    #[test]
    fn the_checksum_is_that_of_the_standard() {
        let archive = write(&[("a".to_owned(), b"hello".to_vec())]).unwrap();
        // a + modes + ids + length + time + type + magic + version, the sum's own field as eight blanks.
        let digits = |text: &str| text.bytes().map(u32::from).sum::<u32>();
        let fields =
            ["a", "0000644", "0000000", "0000000", "00000000005", "00000000000", "        ", "0", "ustar", "00"];
        let sum: u32 = fields.into_iter().map(digits).sum();
        assert_eq!(&archive[148..156], format!("{sum:06o}\0 ").as_bytes());
        assert_eq!(&archive[512..517], b"hello");
    }
}
