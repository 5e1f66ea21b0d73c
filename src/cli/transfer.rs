//! `rockface store push` and `pull`: copies results from one store to another.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use clap::Args;
use rockface_cache::remote::{Remote, Use};
use rockface_cache::{Digest, Handed, Store};
use rockface_engine::run::RunError;
use serde_json::json;

use super::places::{Places, may_be_store};
use super::remote::{self, is_url};
use super::table::bytes;
use super::{CliError, say, signals};

/// Arguments of `rockface store push` and `pull`.
#[derive(Debug, Args)]
pub struct TransferArgs {
    /// The folder of the other store, such as `/shared/rockface/store`, or a remote place such as `s3://bucket/prefix`.
    other: PathBuf,
    /// Copy only the results of this run: a run folder, its name or a part of it, `latest`, or a pipeline; may be given several times.
    #[arg(long, value_name = "RUN")]
    run: Vec<String>,
    #[command(flatten)]
    places: Places,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

impl TransferArgs {
    /// Copies results to the other store.
    pub fn push(self) -> Result<(), CliError> {
        let own = self.places.open_store()?;
        if is_url(&self.other) {
            let stop = Arc::new(AtomicBool::new(false));
            signals::stop_on_signal(&stop);
            let (remote, keys) = (remote::open(&self.other, Some(own.dir()), Use::Itself)?, self.keys(own.keys())?);
            let handed = own.push_to(remote, &keys, &stop)?;
            let is_stopped = stop.load(Ordering::Relaxed);
            self.told(&handed, &own, &self.other.display().to_string());
            return if is_stopped { Err(RunError::Interrupted.into()) } else { Ok(()) };
        }
        let other = Store::open(&self.other)?;
        let keys = self.keys(own.keys())?;
        self.hand(&own, &other, &keys)
    }

    /// Copies results from the other store.
    pub fn pull(self) -> Result<(), CliError> {
        if is_url(&self.other) {
            let own = self.places.make_store()?;
            let remote = remote::open(&self.other, Some(own.dir()), Use::Contents)?;
            let keys = self.keys(remote.keys())?;
            let handed = own.pull_from(remote, &keys)?;
            self.told(&handed, &own, &own.dir().display().to_string());
            return Ok(());
        }
        if !may_be_store(&self.other) {
            let hint = "give the folder that has the file `format` in it";
            return Err(CliError::Usage(format!("there is no store in {}: {hint}", self.other.display())));
        }
        let (own, other) = (self.places.make_store()?, Store::open(&self.other)?);
        let keys = self.keys(other.keys())?;
        self.hand(&other, &own, &keys)
    }

    /// The keys to copy: those of the given runs, or all.
    fn keys(&self, all: Vec<Digest>) -> Result<Vec<Digest>, CliError> {
        if self.run.is_empty() {
            return Ok(all);
        }
        let mut keys = Vec::new();
        for name in &self.run {
            let run = self.places.find(name)?;
            keys.extend(run.manifest.steps.iter().filter_map(|done| done.key));
        }
        keys.sort_unstable();
        keys.dedup();
        Ok(keys)
    }

    fn hand(&self, from: &Store, to: &Store, keys: &[Digest]) -> Result<(), CliError> {
        if from.dir() == to.dir() {
            return Err(CliError::Usage(format!("{} is both stores", from.dir().display())));
        }
        let handed = from.hand_to(to, keys)?;
        self.told(&handed, to, &to.dir().display().to_string());
        Ok(())
    }

    /// Says what was copied, and what that took where one of the two is a remote place under `store`.
    fn told(&self, handed: &Handed, store: &Store, to: &str) {
        let traffic = store.remote().map(Remote::traffic);
        if self.json {
            let mut told = json!(handed);
            traffic.iter().for_each(|traffic| told["remote"] = json!(traffic));
            return say(&told.to_string());
        }
        say(&told(handed, to));
    }
}

fn told(handed: &Handed, to: &str) -> String {
    let missing = match handed.missing {
        0 => String::new(),
        missing => format!("; {missing} are incomplete in the source"),
    };
    format!(
        "copied {} records with {} outputs ({}) to {}, {} were there{missing}",
        handed.records,
        handed.blobs,
        bytes(handed.bytes),
        to,
        handed.known
    )
}
