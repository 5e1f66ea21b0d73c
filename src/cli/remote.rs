//! Remote places for results: how commands name and open them.

use std::path::Path;

use clap::Args;
use rockface_cache::Store;
use rockface_cache::remote::{Backend, Folder, Remote, Use};
use rockface_engine::run::MachineMemory;

use super::{CliError, complain};

/// The remote place under the store of a command.
#[derive(Debug, Args)]
pub struct RemoteArgs {
    /// A remote place shared with others, such as `s3://bucket/prefix` or `file:///folder`: what the store lacks is fetched
    /// from there, and what is computed is uploaded. Credentials come from the environment (`AWS_ACCESS_KEY_ID`, ...).
    #[arg(long, value_name = "URL", env = "ROCKFACE_REMOTE", hide_env_values = true)]
    remote: Option<String>,
    /// Only fetch from the remote place.
    #[arg(long, env = "ROCKFACE_REMOTE_READ_ONLY")]
    remote_read_only: bool,
}

impl RemoteArgs {
    /// The URL; an empty variable of the environment counts as unset.
    pub fn url(&self) -> Option<&str> {
        self.remote.as_deref().filter(|url| !url.is_empty())
    }

    /// The options that say the same to another command.
    pub fn told(&self) -> Vec<String> {
        let url = self.url().map(|url| ["--remote".to_owned(), url.to_owned()]);
        let read_only = self.remote_read_only.then(|| "--remote-read-only".to_owned());
        url.into_iter().flatten().chain(read_only).collect()
    }

    /// Puts a store over the remote place that was named, if one was.
    pub fn attach(&self, store: &Store, only_look: bool) -> Result<(), CliError> {
        let Some(url) = self.url().filter(|_| store.remote().is_none()) else { return Ok(()) };
        let what_for = if only_look || self.remote_read_only { Use::ReadOnlyLayer } else { Use::Layer };
        // There is none yet.
        drop(store.attach(open(Path::new(url), Some(store.dir()), what_for)?));
        Ok(())
    }
}

/// Whether a text names a remote place and not a folder.
pub fn is_url(text: &Path) -> bool {
    text.to_str().is_some_and(|text| text.contains("://"))
}

/// Opens a remote place for a command on itself, or on its contents.
pub fn open(url: &Path, store: Option<&Path>, what_for: Use) -> Result<Remote, CliError> {
    let url = url.to_str().unwrap_or_default();
    let remote = Remote::open(backend(url)?, store, what_for, Box::new(warn))?;
    if let Some(memory) = MachineMemory::now() {
        remote.limit_blobs(memory.left);
    }
    Ok(remote)
}

fn warn(text: &str) {
    complain(&format!("warning: {text}"));
}

/// What a URL stands for.
fn backend(url: &str) -> Result<Box<dyn Backend>, CliError> {
    if let Some(path) = url.strip_prefix("file://") {
        let folder = Path::new(path);
        let hint = "a folder as a remote place is given as file:///PATH, with three slashes";
        let is_whole = folder.is_absolute();
        return if is_whole {
            Ok(Box::new(Folder::new(folder)))
        } else {
            Err(CliError::Usage(format!("{url}: {hint}")))
        };
    }
    objects(url)
}

#[cfg(feature = "remote")]
fn objects(url: &str) -> Result<Box<dyn Backend>, CliError> {
    rockface_remote::open(url).map_err(CliError::Usage)
}

#[cfg(not(feature = "remote"))]
fn objects(url: &str) -> Result<Box<dyn Backend>, CliError> {
    let way = "build it with `--features remote`, or give a folder as file:///PATH";
    // The rest of it may hold a password.
    let scheme = url.split_once("://").map_or("", |(scheme, _)| scheme);
    Err(CliError::Usage(format!("{scheme}://: this build of rockface knows no object stores: {way}")))
}
