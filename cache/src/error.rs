//! What can go wrong with the store, and the way out of it.

use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use nix::unistd::{Gid, Group, Uid, User};
use rustix::process::{getegid, geteuid, getgroups};

use crate::Digest;

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
        "the store {} can only be read ({}: {source}), and a run has to write there what it references: give another one with `--store DIR`; {}",
        dir.display(), path.display(), way_out(path, source)
    )]
    ReadOnly {
        /// The folder of the store.
        dir: PathBuf,
        /// What could not be written.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The folder holds other things.
    #[error(
        "{} is not a store and not empty (it holds `{entry}`): give an empty or a new folder for the store",
        dir.display()
    )]
    NotAStore {
        /// The path of the folder.
        dir: PathBuf,
        /// One of the things in it.
        entry: String,
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
    let owner = || (source.kind() == io::ErrorKind::PermissionDenied).then(|| owner_who_may_open(path)).flatten();
    match source.kind() {
        io::ErrorKind::FileTooLarge => {
            "raise the limit on the size of files (`ulimit -f`), or use another file system".to_owned()
        }
        _ => owner().unwrap_or_else(|| "check that the path exists and that you may use it".to_owned()),
    }
}

/// Whose a path is that this user may not use, or the nearest folder around it that can be looked at, and how its owner opens it.
fn owner_who_may_open(path: &Path) -> Option<String> {
    let (place, meta) = path.ancestors().find_map(|place| Some((place, std::fs::symlink_metadata(place).ok()?)))?;
    let (owner, group) = (meta.uid(), meta.gid());
    let is_member =
        getegid().as_raw() == group || getgroups().is_ok_and(|groups| groups.iter().any(|own| own.as_raw() == group));
    let whom = if owner == geteuid().as_raw() {
        "u"
    } else if is_member {
        "g"
    } else {
        "o"
    };
    let what = if meta.is_dir() { "rwx" } else { "rw" };
    let name = User::from_uid(Uid::from_raw(owner)).ok().flatten();
    let name = name.map_or_else(|| format!("user {owner}"), |user| user.name);
    let (mode, place) = (meta.mode() & 0o7777, place.display());
    if whom == "o" && mode & 0o060 == 0o060 {
        let group =
            Group::from_gid(Gid::from_raw(group)).ok().flatten().map_or_else(|| group.to_string(), |group| group.name);
        return Some(format!(
            "{place} belongs to {name} and the group {group} (mode {mode:04o}): ask to be made a member of it"
        ));
    }
    Some(format!("{place} belongs to {name} (mode {mode:04o}), who opens it with `chmod {whom}+{what} {place}`"))
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

    #[test]
    fn a_file_of_somebody_who_lets_nobody_else_use_it_is_named_with_its_owner() {
        let denied = |path: &Path| StoreError::io("open", path, io::ErrorKind::PermissionDenied.into()).to_string();
        let told = denied(Path::new("/proc/1"));
        assert!(told.contains("/proc/1 belongs to root (mode 0555)") && told.contains("+rwx /proc/1`"), "{told}");
        let place = tempfile::tempdir().unwrap();
        let path = place.path().join("a.seg");
        std::fs::write(&path, "").unwrap();
        std::fs::set_permissions(&path, std::os::unix::fs::PermissionsExt::from_mode(0o600)).unwrap();
        let told = denied(&path);
        assert!(told.contains("(mode 0600)") && told.contains(&format!("chmod u+rw {}`", path.display())), "{told}");
        // Where it cannot be looked at, the folder around it is in the way.
        let told = denied(&path.join("deep/deeper"));
        assert!(told.contains(&format!("{} belongs to", path.display())), "{told}");
    }

    #[test]
    fn another_fault_names_the_action_and_the_path() {
        let path = Path::new("/nowhere/at/all");
        let error = std::fs::read(path).at("read", path).unwrap_err().to_string();
        assert!(error.starts_with("cannot read /nowhere/at/all: "), "{error}");
    }
}
