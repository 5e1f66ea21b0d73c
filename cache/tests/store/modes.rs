//! Who may use what a store holds: whom its root folder lets in, whatever the umask of whoever writes.

use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use rockface_cache::{Digest, GcPolicy, Store};

use crate::finish;

/// All files and folders below a folder.
fn below(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(below(&path));
        }
        found.push(path);
    }
    found
}

#[test]
fn everything_is_open_to_whom_the_root_is_and_to_nobody_else() {
    for root in [0o700, 0o750, 0o755, 0o2770, 0o2775, 0o777] {
        let place = tempfile::tempdir().unwrap();
        let dir = place.path().join("store");
        fs::create_dir(&dir).unwrap();
        fs::set_permissions(&dir, Permissions::from_mode(root)).unwrap();
        let store = Store::open(&dir).unwrap();
        let key = finish(&store, 1, b"small");
        finish(&store, 2, &vec![7; 100_000]);
        store.count_on(&[key]).unwrap();
        store.report("busy").unwrap();
        let scratch = store.scratch().unwrap();
        let _lock = store.lock(&Digest::of(b"key"), || ()).unwrap();
        let other = Store::open(&dir).unwrap();
        finish(&other, 3, b"in another segment");
        let check = |when: &str| {
            for path in below(&dir) {
                let (meta, at) = (fs::symlink_metadata(&path).unwrap(), path.strip_prefix(&dir).unwrap().display());
                let (mode, told) = (meta.mode() & 0o7777, format!("{at} in a store of mode {root:o}, {when}"));
                if meta.is_dir() {
                    assert_eq!(mode, root, "{told}");
                    continue;
                }
                assert_eq!(mode & 0o044, root & 0o044, "read: {told}");
                assert_eq!(mode & 0o022 & !root, 0, "written: {told}");
                let appended = at.to_string().starts_with("segments") || at.to_string() == "keys.lock";
                assert!(!appended || mode & 0o022 == root & 0o022, "appended to: {told}");
            }
        };
        check("in use");
        drop((scratch, other));
        let plan = store.plan_gc(&GcPolicy { unnamed: true, ..GcPolicy::default() }).unwrap();
        store.collect(&plan).unwrap();
        check("after a collection");
    }
}
