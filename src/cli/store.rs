//! `rockface store`: what is in it, whether it is whole, and the removal of what nobody needs.

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use rockface_cache::Store;
use rockface_cache::remote::{RemoteStat, Use};
use serde_json::json;

use super::gc::GcArgs;
use super::places::Places;
use super::remote::{self, is_url};
use super::table::{self, Format, bytes};
use super::transfer::TransferArgs;
use super::verify::verify;
use super::{CliError, say};

/// Arguments of `rockface store`.
#[derive(Debug, Args)]
pub struct StoreArgs {
    #[command(subcommand)]
    command: StoreCommand,
}

#[derive(Debug, Subcommand)]
enum StoreCommand {
    /// Show what the store contains, by stage.
    Stat {
        /// A remote place to look at instead, such as `s3://bucket/prefix`.
        #[arg(value_name = "URL", value_parser = url)]
        remote: Option<PathBuf>,
        #[command(flatten)]
        places: Places,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Read every blob and every segment and compare them with their digests; exit code 3 if anything is damaged or missing.
    Verify {
        #[command(flatten)]
        places: Places,
        /// Move damaged outputs to quarantine and write damaged segments anew without what is damaged in them, so that the next
        /// run that needs it recomputes it.
        #[arg(long)]
        repair: bool,
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Remove what is not needed. Superseded and damaged entries are always removed; records only if an option below selects
    /// them. Records of pinned runs, records younger than an hour and records that live runs reference are never removed. Safe
    /// while a pipeline runs.
    Gc(GcArgs),
    /// Copy results to another store, such as one on a shared disk. The store is created if it does not exist.
    Push(TransferArgs),
    /// Copy results from another store.
    Pull(TransferArgs),
}

pub(super) fn url(text: &str) -> Result<PathBuf, String> {
    let way = "give a remote place such as s3://bucket/prefix; a folder is given with --store";
    if is_url(Path::new(text)) { Ok(PathBuf::from(text)) } else { Err(way.to_owned()) }
}

impl StoreArgs {
    /// Reports on the store, checks it, cleans it, or copies from and to another, as the subcommand says.
    pub fn run(self) -> Result<(), CliError> {
        match self.command {
            StoreCommand::Stat { remote: Some(url), json, .. } => stat_remote(&url, json),
            StoreCommand::Stat { places, json, .. } => stat(&places.open_store()?, json),
            StoreCommand::Verify { places, repair, json } => verify(&places.open_store()?, repair, json),
            StoreCommand::Gc(args) => args.run(),
            StoreCommand::Push(args) => args.push(),
            StoreCommand::Pull(args) => args.pull(),
        }
    }
}

fn stat_remote(url: &Path, as_json: bool) -> Result<(), CliError> {
    let remote = remote::open(url, None, Use::Contents)?;
    let stat = remote.stat()?;
    if as_json {
        say(&json!({"url": remote.url(), "remote": stat}).to_string());
        return Ok(());
    }
    let RemoteStat { records, batches, batch_bytes, packs, pack_bytes, large_blobs, large_blob_bytes, incomplete } =
        stat;
    say(&format!("{records} records in {batches} objects ({})", bytes(batch_bytes)));
    say(&format!("{packs} packs of small outputs ({})", bytes(pack_bytes)));
    say(&format!("{large_blobs} large outputs ({})", bytes(large_blob_bytes)));
    if incomplete > 0 {
        say(&format!("{incomplete} records name outputs that are not there: their steps run again"));
    }
    say(&format!("in {}", remote.url()));
    Ok(())
}

fn stat(store: &Store, as_json: bool) -> Result<(), CliError> {
    let (whole, stages) = (store.stat()?, store.stat_by_stage());
    if as_json {
        say(&json!({"folder": store.dir(), "store": whole, "stages": stages}).to_string());
        return Ok(());
    }
    let row = |stage: &rockface_cache::StageStat| {
        vec![
            stage.stage.clone(),
            stage.records.to_string(),
            stage.blobs.to_string(),
            bytes(stage.bytes),
            rockface_engine::watch::duration(stage.wall_s),
        ]
    };
    let rows: Vec<Vec<String>> = stages.iter().map(row).collect();
    table::print(Format::Table, &["stage", "records", "outputs", "size", "time to make"], &rows, &json!(null))?;
    let blobs = whole.small_blobs + whole.large_blobs;
    let size = bytes(whole.segment_bytes + whole.large_blob_bytes);
    let aside =
        if whole.quarantined > 0 { format!(", {} damaged set aside", whole.quarantined) } else { String::new() };
    say(&format!(
        "{} records, {blobs} blobs, {} segments, {size}{aside} in {}",
        whole.records,
        whole.segments,
        store.dir().display()
    ));
    Ok(())
}
