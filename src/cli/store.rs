//! `rockface store`: what is in it, whether it is whole, and the removal of what nobody needs.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};
use rockface_cache::remote::{RemoteGcPolicy, RemoteStat, Use};
use rockface_cache::{Collected, Digest, GcPlan, GcPolicy, Store};
use serde_json::json;

use super::places::Places;
use super::remote::{self, is_url};
use super::table::{self, Format, bytes};
use super::transfer::TransferArgs;
use super::verify::verify;
use super::{CliError, complain, say};
use rockface_engine::history::{self, HistoryError, PastRun};

/// Records younger than this, seconds, are never collected: a stopped run may be continued.
const GRACE_S: u64 = 3600;
/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

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

#[derive(Debug, Args)]
struct GcArgs {
    /// A remote place to clear instead, such as `s3://bucket/prefix`. It knows no runs, so records go by when their steps ended.
    #[arg(value_name = "URL", value_parser = url, conflicts_with = "unnamed")]
    remote: Option<PathBuf>,
    #[command(flatten)]
    places: Places,
    /// Also remove records that no existing run folder references.
    #[arg(long)]
    unnamed: bool,
    /// Also remove records that were not used for this many days.
    #[arg(long, value_name = "DAYS", value_parser = non_negative, allow_hyphen_values = true)]
    max_age: Option<f64>,
    /// Also remove the least recently used records until the outputs fit into this many GiB.
    #[arg(long, value_name = "GiB", value_parser = non_negative, allow_hyphen_values = true)]
    max_size: Option<f64>,
    /// List the blobs that would be removed, and remove nothing.
    #[arg(long)]
    dry_run: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

fn url(text: &str) -> Result<PathBuf, String> {
    let way = "give a remote place such as s3://bucket/prefix; a folder is given with --store";
    if is_url(Path::new(text)) { Ok(PathBuf::from(text)) } else { Err(way.to_owned()) }
}

fn non_negative(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "give a number, such as 30 or 0.5".to_owned())?;
    if (0.0..=1e9).contains(&number) { Ok(number) } else { Err("give a number from 0 to 1e9".to_owned()) }
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

impl GcArgs {
    fn run(self) -> Result<(), CliError> {
        if let Some(url) = &self.remote {
            return self.run_remote(url);
        }
        let store = self.places.open_store()?;
        let plan = store.plan_gc(&self.policy(&store)?)?;
        if self.dry_run {
            return self.tell(&plan);
        }
        let done = store.collect(&plan)?;
        if self.json {
            say(&json!(done).to_string());
            return Ok(());
        }
        say(&told(&done));
        Ok(())
    }

    fn run_remote(&self, url: &Path) -> Result<(), CliError> {
        let remote = remote::open(url, None, Use::Contents)?;
        let policy = RemoteGcPolicy {
            max_age_s: self.max_age.map(|days| (days * DAY_S) as u64),
            max_bytes: self.max_size.map(|gib| (gib * f64::from(1 << 30)) as u64),
            dry_run: self.dry_run,
        };
        let done = remote.collect(&policy, now_s())?;
        if self.json {
            say(&json!(done).to_string());
            return Ok(());
        }
        let verb = if self.dry_run { "would remove" } else { "removed" };
        let (before, after) = done.batches;
        say(&format!(
            "{verb} {} records and {} objects ({}), {} records stay; {before} objects with records, {after} afterwards",
            done.records,
            done.objects,
            bytes(done.bytes),
            done.kept_records
        ));
        Ok(())
    }

    fn tell(&self, plan: &GcPlan) -> Result<(), CliError> {
        if self.json {
            say(&json!(plan).to_string());
            return Ok(());
        }
        let row = |item: &rockface_cache::GcItem| {
            vec![item.digest.short(), bytes(item.bytes), item.what.clone(), day(item.used_unix_s), item.why.clone()]
        };
        let rows: Vec<Vec<String>> = plan.blobs.iter().map(row).collect();
        table::print(
            Format::Table,
            &["blob", "size", "what it is", "last used", "why it would go"],
            &rows,
            &json!(null),
        )?;
        let size = bytes(plan.blobs.iter().map(|item| item.bytes).fold(0, u64::saturating_add));
        let (records, kept) = (plan.records.len(), plan.kept_records);
        let kept_size = bytes(plan.kept_bytes);
        say(&format!(
            "{records} records and {} blobs ({size}) would go; {kept} records ({kept_size}) stay",
            plan.blobs.len()
        ));
        Ok(())
    }

    fn policy(&self, store: &Store) -> Result<GcPolicy, CliError> {
        let mut policy = GcPolicy {
            unnamed: self.unnamed,
            max_age_s: self.max_age.map(|days| (days * DAY_S) as u64),
            max_bytes: self.max_size.map(|gib| (gib * f64::from(1 << 30)) as u64),
            grace_s: GRACE_S,
            ..GcPolicy::default()
        };
        let live = store.live()?;
        if let Some(since_s) = live.since_unix_s {
            // What live runs reference stays, and so does everything written since they began.
            policy.pinned.extend(live.keys);
            policy.grace_s = policy.grace_s.max(now_s().saturating_sub(since_s) + 1);
        }
        for folder in run_folders(store, &self.places.runs_of(store))? {
            match PastRun::open(&folder) {
                Ok(run) => count(&mut policy, &run),
                Err(fault @ HistoryError::Manifest { .. }) => count_torn(&mut policy, store, &folder, &fault)?,
                Err(fault) => return Err(fault.into()),
            }
        }
        Ok(policy)
    }
}

/// What was removed, and why some was not.
fn told(done: &Collected) -> String {
    let mut told = format!("removed {} records and {} blobs, {} freed", done.records, done.blobs, bytes(done.bytes));
    if done.busy_segments > 0 {
        told += &format!("; {} segments are being written to and were left as they are", done.busy_segments);
    }
    if done.spared_records > 0 {
        told += &format!("; {} records stay for now, since runs go on or have just ended", done.spared_records);
    }
    told
}

/// All existing run folders: those in `places`, and those elsewhere that the store remembers.
fn run_folders(store: &Store, places: &[PathBuf]) -> Result<BTreeSet<PathBuf>, CliError> {
    let absolute = |folder: PathBuf| std::path::absolute(&folder).unwrap_or(folder);
    let mut folders = BTreeSet::new();
    for runs in places {
        folders.extend(history::folders(runs)?.into_iter().map(absolute));
    }
    for note in store.memory().recalled_runs() {
        let folder = note.get("folder").and_then(serde_json::Value::as_str).map(PathBuf::from);
        folders.extend(folder.filter(|folder| history::may_be_run(folder)));
    }
    Ok(folders)
}

fn count(policy: &mut GcPolicy, run: &PastRun) {
    let finished = humantime::parse_rfc3339(&run.manifest.finished).ok();
    let since = finished.and_then(|at| at.duration_since(std::time::UNIX_EPOCH).ok());
    let used_s = since.map_or(0, |since| since.as_secs());
    let keys: Vec<Digest> = run.manifest.steps.iter().filter_map(|done| done.key).collect();
    use_keys(policy, keys, used_s, run.pinned);
}

/// Marks what a damaged manifest still references as used: its run may still be wanted.
fn count_torn(policy: &mut GcPolicy, store: &Store, folder: &Path, fault: &HistoryError) -> Result<(), CliError> {
    let (digests, written_s) = history::digests_told(folder)?;
    let keys: Vec<Digest> = digests.into_iter().filter(|digest| store.has_record(digest)).collect();
    let (count, pinned) = (keys.len(), history::is_pinned(folder));
    use_keys(policy, keys, written_s, pinned);
    policy.torn_s = policy.torn_s.max(Some(written_s));
    let way = "run its pipeline again to write it anew, or remove the folder";
    let used = format!("the {count} records that can still be read in it count as used by this run");
    let rest = "any other that was made before it may be, so `--unnamed` does not remove it";
    complain(&format!("warning: {fault}; {used}; {rest}: {way}"));
    Ok(())
}

fn use_keys(policy: &mut GcPolicy, keys: Vec<Digest>, used_s: u64, pinned: bool) {
    let latest: &mut BTreeMap<Digest, u64> = &mut policy.used;
    for key in &keys {
        let known = latest.entry(*key).or_default();
        *known = used_s.max(*known);
    }
    if pinned {
        policy.pinned.extend(keys);
    }
}

fn now_s() -> u64 {
    std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

fn day(unix_s: u64) -> String {
    if unix_s == 0 {
        return "never".to_owned();
    }
    rockface_engine::watch::moment(unix_s as f64)[..10].to_owned()
}
