//! A folder as a remote place, such as one on a disk that several machines mount.

use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use super::backend::{Backend, BackendError, Object};
use crate::plain;
use crate::sharing::{FILE, Sharing};

/// Starts the names of files that are being written.
const HALF_WRITTEN: &str = ".new-";

/// Objects as files below a folder.
#[derive(Debug)]
pub struct Folder {
    root: PathBuf,
    url: String,
}

impl Folder {
    /// The folder `root`, which is made when something is first written.
    pub fn new(root: &Path) -> Self {
        Self { root: root.to_owned(), url: format!("file://{}", root.display()) }
    }

    /// Where an object is. The folders that it is in are no links: whoever may write to the place could have files elsewhere read,
    /// changed or removed.
    fn path(&self, name: &str) -> Result<PathBuf, BackendError> {
        let mut path = self.root.clone();
        let mut parts = name.split('/').filter(|part| !part.is_empty()).peekable();
        while let Some(part) = parts.next() {
            path.push(part);
            if parts.peek().is_some() {
                self.is_folder(&path)?;
            }
        }
        Ok(path)
    }

    /// Whether there is a folder at a path in the place; something else is an error.
    fn is_folder(&self, path: &Path) -> Result<bool, BackendError> {
        match fs::symlink_metadata(path) {
            Ok(meta) if meta.is_dir() => Ok(true),
            Ok(_) => {
                let inside = path.strip_prefix(&self.root).unwrap_or(path).display();
                let text =
                    format!("`{inside}` is a link or a file there, and a store has a folder of its own in that place");
                Err(BackendError::Foreign(text))
            }
            Err(fault) if fault.kind() == ErrorKind::NotFound => Ok(false),
            Err(fault) => Err(told(path, &fault)),
        }
    }

    /// Writes the bytes beside their place, and lets `name_it` give them their name.
    fn write<T>(
        &self,
        name: &str,
        bytes: &[u8],
        name_it: impl FnOnce(tempfile::NamedTempFile, &Path) -> io::Result<T>,
    ) -> Result<T, BackendError> {
        let path = self.path(name)?;
        let folder = path.parent().unwrap_or(&self.root);
        let write = || {
            // Others use it, who may be other users.
            let sharing = self.make(folder)?;
            let mut builder = tempfile::Builder::new();
            builder.prefix(HALF_WRITTEN).permissions(sharing.permissions());
            let mut file = builder.tempfile_in(folder)?;
            sharing.give(file.as_file(), FILE)?;
            file.write_all(bytes)?;
            file.as_file().sync_all()?;
            name_it(file, &path)
        };
        write().map_err(|fault| told(&path, &fault))
    }

    /// Makes the place, and a folder in it with those around it. They are open to whom the place is.
    fn make(&self, folder: &Path) -> io::Result<Sharing> {
        fs::create_dir_all(&self.root)?;
        let sharing = Sharing::of(&self.root);
        let mut path = self.root.clone();
        for part in folder.strip_prefix(&self.root).into_iter().flatten() {
            path.push(part);
            sharing.folder(&path)?;
        }
        Ok(sharing)
    }
}

fn told(path: &Path, fault: &io::Error) -> BackendError {
    match fault.kind() {
        ErrorKind::NotFound => BackendError::Missing,
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => {
            BackendError::Forbidden(format!("{}: {fault}", path.display()))
        }
        _ => BackendError::Unavailable(fault.to_string()),
    }
}

impl Backend for Folder {
    fn url(&self) -> &str {
        &self.url
    }

    fn way_in(&self) -> String {
        let root = self.root.display();
        format!(
            "the owner of that folder has to let you read and write there: {root} and what is in it have the same modes for all who share it (`chmod -R g+rwX {root}`); or add --remote-read-only if you may only read"
        )
    }

    fn get(&self, name: &str, limit: u64) -> Result<Vec<u8>, BackendError> {
        let path = self.path(name)?;
        let told = |fault: io::Error| told(&path, &fault);
        let file = plain::open(&path).map_err(told)?;
        let mut bytes = Vec::new();
        file.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(told)?;
        if bytes.len() as u64 > limit { Err(BackendError::TooLarge { limit }) } else { Ok(bytes) }
    }

    fn put(&self, name: &str, bytes: &[u8]) -> Result<(), BackendError> {
        self.write(name, bytes, |file, path| file.persist(path).map(drop).map_err(|fault| fault.error))
    }

    fn create(&self, name: &str, bytes: &[u8]) -> Result<bool, BackendError> {
        // A second name of a whole file: given to one, refused to all others, on network file systems too.
        self.write(name, bytes, |file, path| match fs::hard_link(file.path(), path) {
            Ok(()) => Ok(true),
            Err(fault) if fault.kind() == ErrorKind::AlreadyExists => Ok(false),
            Err(fault) => Err(fault),
        })
    }

    fn list(&self, prefix: &str) -> Result<Vec<Object>, BackendError> {
        let mut found = Vec::new();
        let mut folders = vec![prefix.trim_end_matches('/').to_owned()];
        while let Some(folder) = folders.pop() {
            let path = self.path(&folder)?;
            if !self.is_folder(&path)? {
                continue;
            }
            let entries = match fs::read_dir(&path) {
                Err(fault) if fault.kind() == ErrorKind::NotFound => continue,
                entries => entries.map_err(|fault| told(&path, &fault))?,
            };
            for entry in entries {
                let entry = entry.map_err(|fault| told(&path, &fault))?;
                let Some(name) = entry.file_name().to_str().map(str::to_owned) else { continue };
                // Removed since it was listed, or no file of ours: a link is not followed.
                let Ok(meta) = entry.metadata() else { continue };
                let name = format!("{folder}/{name}");
                if meta.is_dir() {
                    folders.push(name);
                } else if meta.is_file() && !entry.file_name().to_string_lossy().starts_with(HALF_WRITTEN) {
                    let since = meta.modified().ok().and_then(|at| at.duration_since(UNIX_EPOCH).ok());
                    let modified_unix_s = since.map_or(0, |since| since.as_secs());
                    found.push(Object { name, bytes: meta.len(), modified_unix_s });
                }
            }
        }
        Ok(found)
    }

    fn delete(&self, name: &str) -> Result<(), BackendError> {
        let path = self.path(name)?;
        match fs::remove_file(&path).map_err(|fault| told(&path, &fault)) {
            Err(BackendError::Missing) => Ok(()),
            done => done,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};

    #[test]
    fn objects_and_their_folders_are_open_to_whom_the_place_is() {
        for (root, file, folder) in [(0o700, 0o600, 0o700), (0o2770, 0o660, 0o2770), (0o755, 0o644, 0o755)] {
            let desk = tempfile::tempdir().unwrap();
            fs::set_permissions(desk.path(), fs::Permissions::from_mode(root)).unwrap();
            let place = Folder::new(desk.path());
            place.put("blobs/aa/1", b"blob").unwrap();
            assert!(place.create("claims/1", b"claim").unwrap());
            let mode = |name: &str| fs::metadata(desk.path().join(name)).unwrap().mode() & 0o7777;
            let modes = ["blobs/aa/1", "claims/1", "blobs", "blobs/aa", "claims"].map(mode);
            assert_eq!(modes, [file, file, folder, folder, folder], "{root:o}");
        }
    }

    #[test]
    fn a_place_that_refuses_access_names_the_folder_and_no_credentials() {
        let place = Folder::new(Path::new("/shared/place"));
        let fault = told(Path::new("/shared/place/format"), &ErrorKind::PermissionDenied.into());
        let text = fault.at("write to", &place).to_string();
        assert!(text.contains("/shared/place/format: ") && text.contains("chmod -R g+rwX /shared/place"), "{text}");
        assert!(!text.contains("credentials") && text.contains("--remote-read-only"), "{text}");
    }

    #[test]
    fn nothing_is_read_written_or_removed_through_a_linked_folder() {
        let desk = tempfile::tempdir().unwrap();
        let (home, place) = (desk.path().join("home"), Folder::new(&desk.path().join("place")));
        fs::create_dir_all(home.join("deep")).unwrap();
        fs::write(home.join("thesis"), "mine").unwrap();
        fs::write(home.join("deep/thesis"), "mine").unwrap();
        place.put("blobs/aa/1", b"blob").unwrap();
        symlink(&home, desk.path().join("place/handed")).unwrap();
        symlink(home.join("deep"), desk.path().join("place/blobs/bb")).unwrap();
        let is_foreign = |result: Result<String, BackendError>, name: &str| {
            assert!(matches!(&result, Err(BackendError::Foreign(text)) if text.contains(name)), "{result:?}");
        };
        let told = |objects: Vec<Object>| objects.into_iter().map(|object| object.name).collect::<String>();
        is_foreign(place.list("handed/").map(told), "handed");
        for (folder, at) in [("handed", "handed"), ("handed/deep", "handed"), ("blobs/bb", "blobs/bb")] {
            let name = format!("{folder}/thesis");
            is_foreign(place.get(&name, 100).map(|bytes| format!("{bytes:?}")), at);
            is_foreign(place.put(&name, b"theirs").map(|()| String::new()), at);
            is_foreign(place.put(&format!("{folder}/new/new"), b"theirs").map(|()| String::new()), at);
            is_foreign(place.create(&format!("{folder}/new"), b"theirs").map(|made| made.to_string()), at);
            is_foreign(place.delete(&name).map(|()| String::new()), at);
        }
        // Links within are no objects, and others are found beside them.
        assert_eq!(place.list("blobs/").map(told), Ok("blobs/aa/1".to_owned()));
        assert_eq!(place.get("blobs/aa/1", 100), Ok(b"blob".to_vec()));
        for path in [home.join("thesis"), home.join("deep/thesis")] {
            assert_eq!(fs::read_to_string(path).unwrap(), "mine");
        }
        assert_eq!((fs::read_dir(&home).unwrap().count(), fs::read_dir(home.join("deep")).unwrap().count()), (2, 1));
    }
}
