//! `rockface store push` and `pull`: copies results from one store to another.

use std::path::PathBuf;

use clap::Args;
use rockface_cache::{Digest, Handed, Store};
use serde_json::json;

use super::places::{Places, may_be_store};
use super::table::bytes;
use super::{CliError, say};

/// Arguments of `rockface store push` and `pull`.
#[derive(Debug, Args)]
pub struct TransferArgs {
    /// The folder of the other store, such as `/shared/rockface/store`.
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
        let other = Store::open(&self.other)?;
        let keys = self.keys(&own)?;
        self.hand((&own, &other), &keys)
    }

    /// Copies results from the other store.
    pub fn pull(self) -> Result<(), CliError> {
        if !may_be_store(&self.other) {
            let hint = "give the folder that has the file `format` in it";
            return Err(CliError::Usage(format!("there is no store in {}: {hint}", self.other.display())));
        }
        let (own, other) = (self.places.make_store()?, Store::open(&self.other)?);
        let keys = self.keys(&other)?;
        self.hand((&other, &own), &keys)
    }

    /// The keys to copy: those of the given runs, or all.
    fn keys(&self, from: &Store) -> Result<Vec<Digest>, CliError> {
        if self.run.is_empty() {
            return Ok(from.keys());
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

    fn hand(&self, (from, to): (&Store, &Store), keys: &[Digest]) -> Result<(), CliError> {
        if from.dir() == to.dir() {
            return Err(CliError::Usage(format!("{} is both stores", from.dir().display())));
        }
        let handed = from.hand_to(to, keys)?;
        if self.json {
            say(&json!(handed).to_string());
        } else {
            say(&told(&handed, to));
        }
        Ok(())
    }
}

fn told(handed: &Handed, to: &Store) -> String {
    let missing = match handed.missing {
        0 => String::new(),
        missing => format!("; {missing} are incomplete in the source"),
    };
    format!(
        "copied {} records with {} outputs ({}) to {}, {} were there{missing}",
        handed.records,
        handed.blobs,
        bytes(handed.bytes),
        to.dir().display(),
        handed.known
    )
}
