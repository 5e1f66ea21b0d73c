//! The mark of a user: what bears it was written by a process of this user, and by nobody else.
//!
//! Who owns a file does not tell that: a store that is unpacked from an archive, copied or fetched belongs to whoever did so. A mark is a
//! BLAKE3 keyed with 32 random bytes that stay in the folder of this user's state, outside of every store.

use std::fs;
use std::io::{Read, Write};
use std::os::unix::fs::{DirBuilderExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use crate::{Digest, plain};

/// The mark of this user on some pieces, told apart by their lengths; `None` where there is nowhere to keep a key.
pub fn mark(pieces: &[&[u8]]) -> Option<Digest> {
    static KEY: OnceLock<Option<[u8; 32]>> = OnceLock::new();
    let key = KEY.get_or_init(|| key_in(&state_folder()?));
    Some(Digest::keyed(key.as_ref()?, pieces))
}

/// `rockface` in the folder in which programs keep their state; see the XDG base directory specification.
fn state_folder() -> Option<PathBuf> {
    let variable = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let state = variable("XDG_STATE_HOME")
        .or_else(|| Some(variable("HOME").filter(|home| home.is_dir())?.join(".local/state")))?;
    Some(state.join("rockface"))
}

/// The key in a folder, made if there is none.
fn key_in(folder: &Path) -> Option<[u8; 32]> {
    let path = folder.join("key");
    if let Some(key) = read(&path) {
        return Some(key);
    }
    fs::DirBuilder::new().recursive(true).mode(0o700).create(folder).ok()?;
    let mut key = [0; 32];
    fs::File::open("/dev/urandom").and_then(|mut source| source.read_exact(&mut key)).ok()?;
    // For this user only; whoever was first has made it for all.
    let mut file = tempfile::NamedTempFile::new_in(folder).ok()?;
    file.write_all(&key).and_then(|()| file.as_file().sync_all()).ok()?;
    let _ = file.persist_noclobber(&path);
    read(&path)
}

/// The key that is there: a plain file of this user, which no other can read.
fn read(path: &Path) -> Option<[u8; 32]> {
    let mut file = plain::open(path).ok()?;
    let meta = file.metadata().ok()?;
    // The lower six bits of the mode are what the group and all others may do.
    let is_own =
        meta.uid() == rustix::process::geteuid().as_raw() && meta.mode().trailing_zeros() >= 6 && meta.len() == 32;
    let mut key = [0; 32];
    (is_own && file.read_exact(&mut key).is_ok()).then_some(key)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::PermissionsExt;

    #[test]
    fn a_key_is_made_once_and_only_a_secret_one_is_taken() {
        let place = tempfile::tempdir().unwrap();
        let folder = place.path().join("state/rockface");
        let key = key_in(&folder).unwrap();
        assert_eq!(key_in(&folder), Some(key));
        assert_ne!(key_in(&place.path().join("another")).unwrap(), key);
        let path = folder.join("key");
        fs::set_permissions(&path, fs::Permissions::from_mode(0o644)).unwrap();
        assert_eq!(key_in(&folder), None, "others have read it");
        fs::remove_file(&path).unwrap();
        std::os::unix::fs::symlink("/dev/zero", &path).unwrap();
        assert_eq!(key_in(&folder), None);
        assert_eq!(key_in(Path::new("/proc/nowhere")), None);
    }

    #[test]
    fn a_mark_is_of_one_key_and_of_these_pieces() {
        let key = [7; 32];
        let mark = Digest::keyed(&key, &[b"ab", b"c"]);
        assert_eq!(mark, Digest::keyed(&key, &[b"ab", b"c"]));
        assert_ne!(mark, Digest::keyed(&key, &[b"a", b"bc"]));
        assert_ne!(mark, Digest::keyed(&[8; 32], &[b"ab", b"c"]));
    }
}
