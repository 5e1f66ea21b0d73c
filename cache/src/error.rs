//! What can go wrong with the store, and the way out of it.

use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use nix::unistd::{Uid, User};
use rustix::process::{getegid, geteuid, getgroups};

use crate::Digest;
use crate::open::FORMAT;

/// A fault of the store or of the disk under it.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The file system or the quota is exhausted.
    #[error(
        "no space left to write {}: free some space or give a store on another disk; what is finished is kept and the next run continues",
        path.display()
    )]
    DiskFull {
        /// What was being written.
        path: PathBuf,
    },
    /// The file system or the quota is exhausted where something of the store was to be written for people to read.
    #[error(
        "no space left to write {}: free some space on that disk or write to another one; what is finished is kept in the store",
        path.display()
    )]
    TargetFull {
        /// What was being written.
        path: PathBuf,
    },
    /// The store was made by another version of this program.
    #[error(
        "the store {} has format `{found}` and this version reads `{expected}`: use the version that made it, or give another folder for the store",
        dir.display()
    )]
    Format {
        /// The folder of the store.
        dir: PathBuf,
        /// What its format file says.
        found: String,
        /// What this version writes.
        expected: String,
    },
    /// A run may not write to the store.
    #[error(
        "the store {} can only be read ({}: {source}), and a run has to write there what it references: give another one with `--store DIR`{}",
        dir.display(), path.display(), way_to_write(path, source)
    )]
    ReadOnly {
        /// The folder of the store.
        dir: PathBuf,
        /// What could not be written.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The folder holds other things, or has lost what says that it is a store.
    #[error(
        "{} is not a store and not empty (it holds `{entry}`): {}",
        dir.display(),
        if *was_store {
            format!("it has the folders of a store, but its file `format` is gone: write `{FORMAT}` into a file of that name, or give another folder")
        } else {
            "give an empty or a new folder for the store".to_owned()
        }
    )]
    NotAStore {
        /// The path of the folder.
        dir: PathBuf,
        /// One of the things in it.
        entry: String,
        /// Whether it has the folders of a store, which then has lost the file that says so.
        was_store: bool,
    },
    /// Something stands in the store where a folder or a file of it should be.
    #[error(
        "{} is a link or no plain file or folder, and a store has one of its own there: whoever put it there could have files elsewhere changed or removed; take it away if you trust the store, or give another store",
        path.display()
    )]
    Foreign {
        /// The path of what stands there.
        path: PathBuf,
    },
    /// No blob has this digest.
    #[error("blob {digest} is not in the store: run the step that recomputes it")]
    Missing {
        /// The digest asked for.
        digest: Digest,
    },
    /// The bytes of a blob no longer have its digest.
    #[error(
        "blob {} was damaged on disk and has been set aside as {}: run again to remake it, and check the disk",
        digest.short(), moved_to.display()
    )]
    Damaged {
        /// The digest asked for.
        digest: Digest,
        /// Where the damaged bytes are now.
        moved_to: PathBuf,
    },
    /// A file kept changing while it was read.
    #[error("{} changed while it was being read: let whatever writes it finish, then run again", path.display())]
    Changing {
        /// The path of the file.
        path: PathBuf,
    },
    /// A record cannot be written as it is.
    #[error("the record of stage `{stage}` cannot be stored: {reason}")]
    BadRecord {
        /// The stage of its recipe.
        stage: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A value does not fit into a segment.
    #[error(
        "{what} of {bytes} bytes is too large for a segment (at most {limit} bytes): divide the step into smaller ones"
    )]
    TooLarge {
        /// What was to be written.
        what: &'static str,
        /// Its size in bytes.
        bytes: u64,
        /// The greatest size that fits, in bytes.
        limit: u64,
    },
    /// An entry is stamped so late that none can follow it.
    #[error(
        "an entry in {} is stamped with the last moment that entries can have, in the year 2116, so that nothing can be written there any more: `rockface store push NEW` copies what is whole to a new store",
        dir.display()
    )]
    Clock {
        /// The folder of the segments.
        dir: PathBuf,
    },
    /// A remote place for results cannot be used.
    #[error("cannot {action} the remote {url}: {why}")]
    Remote {
        /// What was tried, a verb phrase.
        action: &'static str,
        /// Where the place is.
        url: String,
        /// Why not, and the way out.
        why: String,
    },
    /// Anything else the operating system refused.
    #[error("cannot {action} {}: {source}; {}", path.display(), way_out(path, source))]
    Io {
        /// What was tried, a verb phrase.
        action: &'static str,
        /// The path that it was tried on.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
}

/// What may help where the system refused something.
fn way_out(path: &Path, source: &io::Error) -> String {
    match source.kind() {
        io::ErrorKind::FileTooLarge => {
            "raise the limit on the size of files (`ulimit -f`), or use another file system".to_owned()
        }
        _ => way_in(path, source).unwrap_or_else(|| "check that the path exists and that you may use it".to_owned()),
    }
}

/// What may help besides another store where one can only be read: nothing where its disk is mounted so.
fn way_to_write(path: &Path, source: &io::Error) -> String {
    way_in(path, source).map_or_else(String::new, |way| format!("; {way}"))
}

/// Who lets this user use a path, where it is refused.
fn way_in(path: &Path, source: &io::Error) -> Option<String> {
    (source.kind() == io::ErrorKind::PermissionDenied).then(|| owner_who_may_open(path)).flatten()
}

/// Whose a path in a store is that this user may not use, or the nearest folder around it that can be looked at, and what its owner can do;
/// `None` where that is not in a store.
fn owner_who_may_open(path: &Path) -> Option<String> {
    let (place, meta) = path.ancestors().find_map(|place| Some((place, std::fs::symlink_metadata(place).ok()?)))?;
    let root = store_around(place, path)?;
    let (owner, group, mode) = (meta.uid(), meta.gid(), meta.mode() & 0o7777);
    let name = User::from_uid(Uid::from_raw(owner)).ok().flatten();
    let name = name.map_or_else(|| format!("user {owner}"), |user| user.name);
    let whose = format!("{} belongs to {name} (mode {mode:04o})", place.display());
    let is_member =
        getegid().as_raw() == group || getgroups().is_ok_and(|groups| groups.iter().any(|own| own.as_raw() == group));
    // What the owner of a store lets its group do at its root may be let it in all of it.
    let root_mode = std::fs::metadata(root).map_or(0, |meta| meta.mode());
    let is_own = owner == geteuid().as_raw();
    let (letter, shift) = if is_own { ('u', 6) } else { ('g', 3) };
    let is_for_group = is_member && place != root && root_mode & 0o070 != 0;
    let is_appended_to = place.extension().is_some_and(|end| end == "seg" || end == "lock");
    let (bits, what) = match (meta.is_dir(), is_appended_to) {
        (true, _) => (7, "rwx"),
        (false, true) => (6, "rw"),
        (false, false) => (4, "r"),
    };
    let lacks = (mode >> shift) & bits != bits;
    if lacks && (is_own || is_for_group) {
        let way = format!("`chmod {letter}+{what} {}`", place.display());
        return Some(format!("{whose}, who opens it with {way}: see \"A store of several users\" in docs/cluster.md"));
    }
    (!is_own).then(|| format!("{whose}: ask them, or give another place"))
}

/// The root of the store that a place is in or is, if it is one; one that may not be looked into is known by what was looked for in it at `path`.
fn store_around<'p>(place: &'p Path, path: &Path) -> Option<&'p Path> {
    let around = place.ancestors().find(|folder| folder.join("format").is_file());
    let within = path.strip_prefix(place).ok().and_then(|rest| rest.components().next());
    let is_shut = || {
        let looked = std::fs::metadata(place.join("format"));
        looked.is_err_and(|fault| fault.kind() == io::ErrorKind::PermissionDenied)
    };
    // A folder that is named itself and may not be entered is the one that was given.
    let is_root = within.map_or_else(is_shut, |first| crate::open::is_own(first.as_os_str()));
    around.or_else(|| is_root.then_some(place))
}

impl StoreError {
    /// Wraps what the operating system said, telling a full disk from everything else.
    pub fn io(action: &'static str, path: &Path, source: io::Error) -> Self {
        use io::ErrorKind::{QuotaExceeded, StorageFull};
        let path = path.to_owned();
        match source.kind() {
            StorageFull | QuotaExceeded => Self::DiskFull { path },
            _ => Self::Io { action, path, source },
        }
    }

    /// Says that what had no room is no part of the store.
    pub(crate) fn outside_store(self) -> Self {
        match self {
            Self::DiskFull { path } => Self::TargetFull { path },
            other => other,
        }
    }

    /// What happened to a blob, as a run reports it that recomputes the blob itself.
    pub fn of_recomputed(&self) -> String {
        match self {
            Self::Damaged { digest, moved_to } => {
                let (digest, moved_to) = (digest.short(), moved_to.display());
                format!("blob {digest} was damaged on disk and has been set aside as {moved_to}; check the disk")
            }
            Self::Missing { digest } => {
                format!("blob {} is not in the store, and no remote place gave it", digest.short())
            }
            other => other.to_string(),
        }
    }

    /// Says that the store at `dir` can only be read, where that is why something could not be written.
    pub(crate) fn or_read_only(self, dir: &Path) -> Self {
        use io::ErrorKind::{PermissionDenied, ReadOnlyFilesystem};
        match self {
            Self::Io { path, source, .. } if matches!(source.kind(), PermissionDenied | ReadOnlyFilesystem) => {
                Self::ReadOnly { dir: dir.to_owned(), path, source }
            }
            other => other,
        }
    }
}

/// Names the action and the path of a failed system call.
pub(crate) trait At<T> {
    /// Turns the error into one that says what was tried on which path.
    fn at(self, action: &'static str, path: &Path) -> Result<T, StoreError>;
}

impl<T> At<T> for io::Result<T> {
    fn at(self, action: &'static str, path: &Path) -> Result<T, StoreError> {
        self.map_err(|source| StoreError::io(action, path, source))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write;

    #[test]
    fn a_full_disk_is_told_from_other_faults_and_says_what_to_do() {
        let path = Path::new("/dev/full");
        let Ok(mut full) = std::fs::OpenOptions::new().write(true).open(path) else {
            println!("skipped: this system has no /dev/full");
            return;
        };
        let error = full.write_all(b"x").at("write", path).unwrap_err();
        assert!(matches!(&error, StoreError::DiskFull { path: named } if named == path), "{error:?}");
        assert!(error.to_string().contains("/dev/full") && error.to_string().contains("free some space"));
    }

    #[test]
    fn a_full_disk_outside_of_the_store_is_no_reason_for_another_store() {
        let told = |fault: StoreError| fault.outside_store().to_string();
        let full = told(StoreError::io("write", Path::new("/out/x.ply"), io::ErrorKind::StorageFull.into()));
        assert!(full.contains("/out/x.ply: free some space on that disk") && !full.contains("a store on"), "{full}");
        let other = told(StoreError::io("write", Path::new("/out/x.ply"), io::ErrorKind::NotFound.into()));
        assert!(other.starts_with("cannot write /out/x.ply"), "{other}");
    }

    #[test]
    fn a_run_that_recomputes_a_blob_does_not_advise_to_run_again() {
        let digest = Digest::of(b"blob");
        let damaged = StoreError::Damaged { digest, moved_to: "/s/quarantine/x".into() };
        for fault in [damaged, StoreError::Missing { digest }] {
            let (told, alone) = (fault.of_recomputed(), fault.to_string());
            assert!(told.contains(&digest.short()) && !told.contains("run "), "{told}");
            assert!(alone.contains("run "), "{alone}");
        }
    }

    #[test]
    fn a_store_that_can_only_be_read_says_how_to_give_another() {
        let fault = |kind: io::ErrorKind| StoreError::io("write into", Path::new("/s/live"), kind.into());
        for kind in [io::ErrorKind::PermissionDenied, io::ErrorKind::ReadOnlyFilesystem] {
            let told = fault(kind).or_read_only(Path::new("/s")).to_string();
            assert!(told.starts_with("the store /s can only be read") && told.contains("--store"), "{told}");
        }
        let other = fault(io::ErrorKind::NotFound).or_read_only(Path::new("/s"));
        assert!(matches!(other, StoreError::Io { .. }));
    }

    fn denied(path: &Path) -> String {
        StoreError::io("open", path, io::ErrorKind::PermissionDenied.into()).to_string()
    }

    #[test]
    fn a_file_that_may_not_be_used_is_named_with_its_owner_and_what_the_owner_can_do() {
        let place = tempfile::tempdir().unwrap();
        let store = place.path();
        std::fs::create_dir_all(store.join("segments")).unwrap();
        std::fs::write(store.join("format"), "").unwrap();
        for (name, mode, way) in
            [("segments/a.seg", 0o200, "u+rw"), ("keys.lock", 0o400, "u+rw"), ("blob", 0o200, "u+r")]
        {
            let path = store.join(name);
            std::fs::write(&path, "").unwrap();
            std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(mode)).unwrap();
            let (told, shown) = (denied(&path), path.display());
            assert!(told.contains(&format!("(mode {mode:04o}), who opens it with `chmod {way} {shown}`")), "{told}");
            assert!(told.contains("A store of several users"), "{told}");
            // Where it cannot be looked at, what is around it is in the way.
            let told = denied(&path.join("deep/deeper"));
            assert!(told.contains(&format!("{shown} belongs to")), "{told}");
        }
        // Its mode is not why.
        let told = denied(&store.join("segments"));
        assert!(!told.contains("chmod") && !told.contains("ask them"), "{told}");
    }

    #[test]
    fn a_file_of_another_user_is_opened_to_the_group_of_a_store_that_has_one() {
        if !geteuid().is_root() {
            println!("skipped: only root can give files to others");
            return;
        }
        let place = tempfile::tempdir().unwrap();
        let (store, group) = (place.path(), getegid().as_raw());
        std::fs::write(store.join("format"), "").unwrap();
        let give = |path: &Path, group: u32, mode: u32| {
            std::os::unix::fs::chown(path, Some(1), Some(group)).unwrap();
            std::fs::set_permissions(path, std::os::unix::fs::PermissionsExt::from_mode(mode)).unwrap();
        };
        let ask = "(mode 0600): ask them, or give another place";
        for (name, what) in [("a.seg", "g+rw"), ("blob", "g+r")] {
            let path = store.join(name);
            std::fs::write(&path, "").unwrap();
            for (root, group, expected) in [
                (0o770, group, &*format!("`chmod {what} {}`", path.display())),
                (0o700, group, ask),
                (0o777, group + 1, ask),
            ] {
                give(store, group, root);
                give(&path, group, 0o600);
                let told = denied(&path);
                assert!(told.contains(expected) && told.contains(" belongs to "), "{told}");
            }
        }
        give(store, group, 0o700);
        let told = denied(&store.join("live/x"));
        assert!(told.contains("(mode 0700): ask them, or give another place"), "{told}");
    }

    #[test]
    fn nobody_is_advised_to_open_what_is_in_no_store() {
        let outside = denied(Path::new("/nowhere/at/all"));
        assert!(!outside.contains("belongs to") && outside.contains("check that"), "{outside}");
        for kind in [io::ErrorKind::PermissionDenied, io::ErrorKind::ReadOnlyFilesystem] {
            let fault = StoreError::io("write into", Path::new("/nowhere/s/live"), kind.into());
            let told = fault.or_read_only(Path::new("/nowhere/s")).to_string();
            assert!(told.ends_with("give another one with `--store DIR`"), "{told}");
        }
    }

    #[test]
    fn another_fault_names_the_action_and_the_path() {
        let path = Path::new("/nowhere/at/all");
        let error = std::fs::read(path).at("read", path).unwrap_err().to_string();
        assert!(error.starts_with("cannot read /nowhere/at/all: "), "{error}");
    }
}
