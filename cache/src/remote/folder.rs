//! A folder as a remote place, such as one on a disk that several machines mount.

use std::fs;
use std::io::{self, ErrorKind, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

use super::backend::{Backend, BackendError, Object};
use crate::plain;

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

    fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// Writes the bytes beside their place, and lets `name_it` give them their name.
    fn write<T>(
        &self,
        name: &str,
        bytes: &[u8],
        name_it: impl FnOnce(tempfile::NamedTempFile, &Path) -> io::Result<T>,
    ) -> Result<T, BackendError> {
        let path = self.path(name);
        let folder = path.parent().unwrap_or(&self.root);
        let write = || {
            fs::create_dir_all(folder)?;
            let mut builder = tempfile::Builder::new();
            // Others read it, who may be other users.
            builder.prefix(HALF_WRITTEN).permissions(fs::Permissions::from_mode(0o666));
            let mut file = builder.tempfile_in(folder)?;
            file.write_all(bytes)?;
            file.as_file().sync_all()?;
            name_it(file, &path)
        };
        write().map_err(|fault| told(&fault))
    }
}

fn told(fault: &io::Error) -> BackendError {
    match fault.kind() {
        ErrorKind::NotFound => BackendError::Missing,
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => BackendError::Forbidden(fault.to_string()),
        _ => BackendError::Unavailable(fault.to_string()),
    }
}

impl Backend for Folder {
    fn url(&self) -> &str {
        &self.url
    }

    fn get(&self, name: &str, limit: u64) -> Result<Vec<u8>, BackendError> {
        let file = plain::open(&self.path(name)).map_err(|fault| told(&fault))?;
        let mut bytes = Vec::new();
        file.take(limit.saturating_add(1)).read_to_end(&mut bytes).map_err(|fault| told(&fault))?;
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
            let entries = match fs::read_dir(self.path(&folder)) {
                Err(fault) if fault.kind() == ErrorKind::NotFound => continue,
                entries => entries.map_err(|fault| told(&fault))?,
            };
            for entry in entries {
                let entry = entry.map_err(|fault| told(&fault))?;
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
        match fs::remove_file(self.path(name)).map_err(|fault| told(&fault)) {
            Err(BackendError::Missing) => Ok(()),
            done => done,
        }
    }
}
