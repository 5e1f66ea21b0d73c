//! The memory that stages take, beside what they say they need: what a run starts its steps by.
//!
//! `cargo bench --bench memory [-- PIPELINE]` runs shipped pipelines one step at a time and prints a row for every stage that takes or says
//! more than some ten megabytes: that of its most demanding step. `ROCKFACE_BENCH_SITE` names the folder of a site for `calibrate-site`,
//! which is left out without it. Linux alone tells the memory of a process as it is needed here.

mod resident;

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex, PoisonError};

use rockface_cache::Store;
use rockface_engine::PHASE;
use rockface_engine::pipeline::{Overrides, Pipeline};
use rockface_engine::plan::plan;
use rockface_engine::run::{Options, execute};
use rockface_engine::watch::Silent;
use tracing::field::{Field, Visit};
use tracing::span::{Attributes, Id};
use tracing_subscriber::Layer;
use tracing_subscriber::layer::Context;
use tracing_subscriber::prelude::*;
use tracing_subscriber::registry::LookupSpan;

/// Set in the process that runs a pipeline: its name.
const PIPELINE: &str = "ROCKFACE_BENCH_PIPELINE";
/// What the bench needs.
const LINUX: &str = "Linux, which tells the memory of a process";
/// Less is not worth a row, MB.
const LITTLE_MB: f64 = 30.0;

/// The variable with the folder of a site's data.
const SITE: &str = "ROCKFACE_BENCH_SITE";
/// The pipeline that needs it.
const OF_SITE: &str = "calibrate-site";

/// Pipelines, what they are to make, and what is set in them.
const RUNS: [(&str, &[&str], &[&str]); 6] = [
    ("quickstart", &[], &[]),
    ("calibrate", &["references"], &["axes.reference.count=2"]),
    ("hunter-valley", &[], &[]),
    ("nobbys-head", &[], &["params.downscale=2"]),
    ("benchmark", &[], &["params.count=20"]),
    (OF_SITE, &[], &["params.replicates=8"]),
];

fn main() {
    if let Ok(name) = std::env::var(PIPELINE) {
        return run_and_print(&name);
    }
    let wanted = std::env::args().skip(1).find(|word| !word.starts_with('-')).unwrap_or_default();
    println!("| pipeline | stage | step | says it needs, MB | takes, MB | takes / says |");
    println!("|---|---|---|---|---|---|");
    let able = |name: &str| name != OF_SITE || std::env::var_os(SITE).is_some();
    for (name, ..) in RUNS.iter().filter(|(name, ..)| name.contains(&wanted) && able(name)) {
        let program = std::env::current_exe().expect("this program");
        // What is freed goes back to the system at once, so that the next step is seen to take it again.
        let tunables = "glibc.malloc.mmap_threshold=65536:glibc.malloc.trim_threshold=65536";
        let status = Command::new(program).env(PIPELINE, name).env("GLIBC_TUNABLES", tunables).status();
        assert!(status.expect("a process").success(), "`{name}` failed");
    }
}

/// Runs a pipeline one step at a time and prints its rows.
fn run_and_print(name: &str) {
    let (_, targets, set) = RUNS.iter().find(|(known, ..)| *known == name).expect("a pipeline of the list");
    let steps = Steps::default();
    tracing_subscriber::registry().with(steps.clone()).init();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let registry = rockface_stages::registry();
    let strings = |words: &[&str]| words.iter().map(|word| (*word).to_owned()).collect::<Vec<_>>();
    let mut set = strings(set);
    if name == OF_SITE {
        set.push(format!("params.data={}", std::env::var(SITE).expect("the folder of a site")));
    }
    let overrides = Overrides { set, parts: registry.parts(), ..Overrides::default() };
    let pipeline = Pipeline::load(&file(name), &overrides, None).expect("a right pipeline");
    let store = Arc::new(Store::open(&folder.path().join("store")).expect("a store"));
    let mut plan = plan(&pipeline, &strings(targets), registry.stages(), &store).expect("a plan");
    let options = Options { jobs: 1, look: registry.look(), ..Options::default() };
    let summary = execute(&mut plan, &store, &options, &Arc::new(AtomicBool::new(false)), &mut Silent);
    assert!(summary.expect("a run").executed() > 0, "nothing ran");
    steps.print(name);
}

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines").join(format!("{name}.yaml"))
}

/// What steps said and took, in the order in which they ended.
#[derive(Clone, Default)]
struct Steps(Arc<Mutex<Vec<Step>>>);

#[derive(Clone, Default)]
struct Step {
    label: String,
    stage: String,
    need_bytes: u64,
    begun_bytes: u64,
    took_bytes: u64,
}

impl Steps {
    fn print(&self, pipeline: &str) {
        let mut steps = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        steps.sort_by(|a, b| a.stage.cmp(&b.stage).then(b.took_bytes.cmp(&a.took_bytes)));
        steps.dedup_by(|next, kept| next.stage == kept.stage);
        steps.sort_by_key(|step| std::cmp::Reverse(step.took_bytes));
        for Step { label, stage, need_bytes, took_bytes, .. } in steps {
            let (need, took) = (need_bytes as f64 / 1e6, took_bytes as f64 / 1e6);
            if need.max(took) >= LITTLE_MB {
                println!("| {pipeline} | {stage} | {label} | {need:.0} | {took:.0} | {:.2} |", took / need);
            }
        }
    }
}

impl Visit for Step {
    fn record_debug(&mut self, field: &Field, value: &dyn std::fmt::Debug) {
        self.record_str(field, &format!("{value:?}"));
    }

    fn record_str(&mut self, field: &Field, value: &str) {
        match field.name() {
            "step" => value.clone_into(&mut self.label),
            "stage" => value.clone_into(&mut self.stage),
            _ => {}
        }
    }

    fn record_u64(&mut self, field: &Field, value: u64) {
        if field.name() == "need_bytes" {
            self.need_bytes = value;
        }
    }
}

impl<S: tracing::Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Steps {
    fn on_new_span(&self, attributes: &Attributes<'_>, id: &Id, context: Context<'_, S>) {
        if attributes.metadata().target() == PHASE && attributes.metadata().name() == "step" {
            let mut step = Step::default();
            attributes.record(&mut step);
            context.span(id).expect("a new span").extensions_mut().insert(step);
        }
    }

    fn on_enter(&self, id: &Id, context: Context<'_, S>) {
        if let Some(step) = context.span(id).expect("a span").extensions_mut().get_mut::<Step>() {
            resident::forget_peak().expect(LINUX);
            step.begun_bytes = resident::bytes("VmRSS").expect(LINUX);
        }
    }

    fn on_exit(&self, id: &Id, context: Context<'_, S>) {
        if let Some(mut step) = context.span(id).expect("a span").extensions_mut().remove::<Step>() {
            step.took_bytes = resident::bytes("VmHWM").expect(LINUX).saturating_sub(step.begun_bytes);
            self.0.lock().unwrap_or_else(PoisonError::into_inner).push(step);
        }
    }
}
