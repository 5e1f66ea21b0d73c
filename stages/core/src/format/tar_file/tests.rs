//! Archives: our own to the bit, those of GNU tar, bsdtar and Python, and refusals of what does not stay in its folder.

use super::*;
use proptest::prelude::*;

proptest! {
    #[test]
    fn files_come_back(files in proptest::collection::btree_map("(file[a-z]{0,9}|[a-d]/[a-zA-Z0-9._-]{2,20}x)", proptest::collection::vec(any::<u8>(), 0..1200), 0..4)) {
        let files: Named = files.into_iter().rev().collect();
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
    for name in ["", "/a", "a//b", "../a", "a/..", "a\0b", "a\nb", "a\u{9b}b", &"x".repeat(256)] {
        assert!(write(&[(name.to_owned(), Vec::new())]).is_err(), "{name}");
    }
    let twice = write(&[("a".to_owned(), Vec::new()), ("a".to_owned(), Vec::new())]);
    assert!(twice.unwrap_err().0.contains("two files of an archive are called `a`"));
    let below = write(&[("a/b".to_owned(), Vec::new()), ("a".to_owned(), Vec::new())]);
    assert!(below.unwrap_err().0.contains("`a/b`"));
}

#[test]
fn long_names_come_back_in_their_order() {
    let split = format!("{}/{}", "folder".repeat(20), "z".repeat(90));
    let before = format!("{}/{}", "y".repeat(200), "x".repeat(200));
    let files = vec![(split, b"1".to_vec()), (before, b"2".to_vec()), ("a".to_owned(), b"3".to_vec())];
    assert_eq!(read(&write(&files).unwrap()).unwrap(), files);
}

#[test]
fn the_header_is_that_of_the_standard() {
    let archive = write(&[("a".to_owned(), b"hello".to_vec())]).unwrap();
    // a + modes + ids + length + time + type + magic + version, the sum's own field as eight blanks.
    let digits = |text: &str| text.bytes().map(u32::from).sum::<u32>();
    let fields = ["a", "0000644", "0000000", "0000000", "00000000005", "00000000000", "        ", "0", "ustar", "00"];
    let sum: u32 = fields.into_iter().map(digits).sum();
    let mut header = [0; BLOCK];
    let mut put = |at: usize, text: &str| header[at..at + text.len()].copy_from_slice(text.as_bytes());
    [0, 100, 108, 116, 124, 136].into_iter().zip(fields).for_each(|(at, text)| put(at, text));
    put(148, &format!("{sum:06o}\0 "));
    put(156, "0");
    put(257, "ustar\x0000");
    assert_eq!(archive[..BLOCK], header);
    assert_eq!(&archive[BLOCK..BLOCK + 5], b"hello");
    assert_eq!(archive.len(), 4 * BLOCK);
}

/// An archive as another program writes it: with times and owners, a folder, padded to ten blocks.
fn foreign(header: fn() -> Header, entries: &[(&str, EntryType, &[u8])]) -> Vec<u8> {
    let mut archive = Builder::new(Vec::new());
    for (name, kind, bytes) in entries {
        let mut header = header();
        header.set_entry_type(*kind);
        header.set_mode(0o755);
        header.set_mtime(1_700_000_000);
        header.set_uid(1000);
        header.set_size(bytes.len() as u64);
        let field = &mut header.as_old_mut().name;
        let length = name.len().min(100);
        field[..length].copy_from_slice(&name.as_bytes()[..length]);
        header.set_cksum();
        archive.append(&header, *bytes).unwrap();
    }
    let mut bytes = archive.into_inner().unwrap();
    bytes.resize(bytes.len().next_multiple_of(10 * BLOCK), 0);
    bytes
}

#[test]
fn archives_of_other_programs_become_files_in_alphabetical_order() {
    let long = format!("{}/c", "b".repeat(150));
    let pax = format!("{} path={long}\n", 3 + 7 + long.len());
    let entries: [(&str, EntryType, &[u8]); 7] = [
        ("pax_global_header", EntryType::XGlobalHeader, b"19 comment=1234567\n"),
        ("./", EntryType::Directory, b""),
        ("./z/", EntryType::Directory, b""),
        ("./z/one", EntryType::Regular, b"1"),
        ("PaxHeader", EntryType::XHeader, pax.as_bytes()),
        ("short", EntryType::Regular, b"2"),
        ("a", EntryType::Continuous, b"3"),
    ];
    let expected = [("a", "3"), (long.as_str(), "2"), ("z/one", "1")];
    let expected: Named = expected.iter().map(|(name, text)| ((*name).to_owned(), text.as_bytes().to_vec())).collect();
    for header in [Header::new_ustar, Header::new_gnu] {
        let files = read(&foreign(header, &entries)).unwrap();
        assert_eq!(files, expected);
        assert_eq!(read(&write(&files).unwrap()).unwrap(), files);
    }
    let gnu: [(&str, EntryType, &[u8]); 2] =
        [("././@LongLink", EntryType::GNULongName, long.as_bytes()), ("b", EntryType::Regular, b"2")];
    assert_eq!(read(&foreign(Header::new_gnu, &gnu)).unwrap(), expected[1..2]);
}

#[test]
fn entries_that_are_no_files_or_leave_the_folder_are_refused_by_name() {
    let message = |name: &str, kind| read(&foreign(Header::new_ustar, &[(name, kind, b"")])).unwrap_err().0;
    for name in ["/etc/passwd", "../a", "a/../../b"] {
        assert!(message(name, EntryType::Regular).contains(&format!("`{name}`, which leads out")), "{name}");
    }
    for kind in [EntryType::Link, EntryType::Symlink, EntryType::Char, EntryType::Block, EntryType::Fifo] {
        assert!(message("a/b", kind).contains("`a/b`, which is"), "{kind:?}");
    }
    let twice: [(&str, EntryType, &[u8]); 2] = [("a", EntryType::Regular, b""), ("./a", EntryType::Regular, b"")];
    assert!(read(&foreign(Header::new_ustar, &twice)).unwrap_err().0.contains("called `a`"));
    let below: [(&str, EntryType, &[u8]); 2] = [("a/b", EntryType::Regular, b""), ("a", EntryType::Regular, b"")];
    assert!(
        read(&foreign(Header::new_ustar, &below)).unwrap_err().0.contains("a file of it has the name of its folder")
    );
    let named = message("a\u{7}", EntryType::Regular);
    assert!(named.contains("`a\\u{7}` cannot name a file"), "{named}");
}

#[test]
fn damaged_archives_are_errors_and_never_panic() {
    let entries: [(&str, EntryType, &[u8]); 2] =
        [("a", EntryType::Regular, b"hello"), ("b/c", EntryType::Regular, &[7; 700])];
    let bytes = foreign(Header::new_gnu, &entries);
    for at in 0..2 * BLOCK {
        for value in [0, b'7', 0x80, 0xff] {
            let mut damaged = bytes.clone();
            damaged[at] = value;
            let header = &mut damaged[..BLOCK];
            header[148..156].fill(b' ');
            let sum: u32 = header.iter().map(|byte| u32::from(*byte)).sum();
            header[148..156].copy_from_slice(format!("{sum:06o}\0 ").as_bytes());
            let _ = read(&damaged);
        }
    }
    assert!(read(b"once upon a time").is_err());
    assert!(read(&[0; 2 * BLOCK]).unwrap().is_empty());
}
