//! `rockface store gc`: the removal of what nobody needs.

use std::path::{Path, PathBuf};

use clap::Args;
use rockface_cache::remote::{RemoteGcPolicy, Use};
use rockface_cache::{Collected, GcPlan, GcPolicy, Store, StoreError};
use serde_json::json;

use super::kept::Kept;
use super::places::Places;
use super::remote;
use super::sizes::bytes_of;
use super::store::url;
use super::table::{self, Format, bytes};
use super::{CliError, say};

/// Records younger than this, seconds, are never collected: a stopped run may be continued.
const GRACE_S: u64 = 3600;
/// Seconds of a day.
const DAY_S: f64 = 86_400.0;

/// Arguments of `rockface store gc`.
#[derive(Debug, Args)]
pub struct GcArgs {
    /// A remote place to clear instead, such as `s3://bucket/prefix`. It does not know runs, so it judges a record by the time its step ended.
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
    /// Also remove the least recently used records until the outputs fit into this many GiB, or a size with its unit (500GB).
    #[arg(long, value_name = "GiB", value_parser = size, allow_hyphen_values = true)]
    max_size: Option<u64>,
    /// List the blobs that would be removed, and remove nothing.
    #[arg(long)]
    dry_run: bool,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

fn non_negative(text: &str) -> Result<f64, String> {
    let number: f64 = text.parse().map_err(|_| "give a number, such as 30 or 0.5".to_owned())?;
    if (0.0..=1e9).contains(&number) { Ok(number) } else { Err("give a number from 0 to 1e9".to_owned()) }
}

/// The bytes of a size that is not negative.
fn size(text: &str) -> Result<u64, String> {
    let bytes = bytes_of(text)?;
    if bytes >= 0.0 { Ok(bytes as u64) } else { Err("give a size from 0 on".to_owned()) }
}

impl GcArgs {
    /// Removes what the options say from the store, or from a remote place.
    pub fn run(self) -> Result<(), CliError> {
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
            max_bytes: self.max_size,
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

    /// Whether any option selects records: what runs name decides nothing otherwise.
    fn removes_records(&self) -> bool {
        self.unnamed || self.max_age.is_some() || self.max_size.is_some()
    }

    fn policy(&self, store: &Store) -> Result<GcPolicy, CliError> {
        let mut policy = GcPolicy {
            unnamed: self.unnamed,
            max_age_s: self.max_age.map(|days| (days * DAY_S) as u64),
            max_bytes: self.max_size,
            grace_s: GRACE_S,
            ..GcPolicy::default()
        };
        let live = store.live()?;
        if let Some(path) = live.unreadable.filter(|_| self.removes_records()) {
            // What its process relies on is not known.
            return Err(StoreError::io("open", &path, std::io::ErrorKind::PermissionDenied.into()).into());
        }
        if let Some(since_s) = live.since_unix_s {
            // What live runs reference stays, and so does everything written since they began.
            policy.pinned.extend(live.keys);
            policy.grace_s = policy.grace_s.max(now_s().saturating_sub(since_s) + 1);
        }
        let (must_know, is_dry) = (self.removes_records(), self.dry_run);
        let mut kept = Kept { policy, store, must_know, is_dry, notes: store.memory().noted_folders() };
        kept.count_all(&self.places.runs_of(store))?;
        kept.forget(now_s());
        Ok(kept.policy)
    }
}

/// What was removed, and why some was not.
fn told(done: &Collected) -> String {
    let mut told = format!("removed {} records and {} blobs, {} freed", done.records, done.blobs, bytes(done.bytes));
    if done.busy_segments > 0 {
        told += &format!(
            "; {} segments were left as they are: another process writes to them, or you may not",
            done.busy_segments
        );
    }
    if done.spared_records > 0 {
        told += &format!("; {} records stay for now, since runs go on or have just ended", done.spared_records);
    }
    told
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
