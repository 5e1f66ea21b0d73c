//! What the engine itself costs, by shape and number of steps: cold, nothing to do, one leaf, a root whose output stays the
//! same; beside ninja and doit on the same graphs, where they are installed.
//!
//! `cargo bench --bench engine [-- SHAPE]`; a table of milliseconds for the whole run. A run with nothing to do is timed as a
//! process of its own, start and end included, as those of the others are; the others do next to nothing in each step too:
//! ninja starts a shell for each, doit calls a function, so that only their columns for nothing to do are alike in kind.

mod peers;

use std::path::Path;
use std::process::Command;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use rockface_cache::{Digest, Store};
use rockface_core::artefact::{Kind, Table};
use rockface_core::{AnyStage, Context, Inputs, Outputs, Page, Port, Row, Stage, StageError, params};
use rockface_engine::pipeline::{Overrides, Pipeline};
use rockface_engine::plan::plan;
use rockface_engine::run::shortcut::{self, Ended, Told};
use rockface_engine::run::{Finished, Options, execute, process_bytes};
use rockface_engine::watch::Silent;

params! {
    /// Parameters of `cheap`.
    pub struct CheapParams {
        /// Makes one instance differ from another.
        value: f64 = 0.0,
    }
}

/// A stage that does next to nothing.
struct Cheap;

impl Stage for Cheap {
    type Params = CheapParams;
    const NAME: &'static str = "cheap";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new("");
    const INPUTS: &'static [Port] = &[
        Port::many("terms", &[Kind::Table], "What came before."),
        Port::optional("also", &[Kind::Table], "More of it."),
        Port::optional("too", &[Kind::Table], "Still more."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("out", &[Kind::Table], "A number.")];
    fn run(params: &CheapParams, inputs: &Inputs, _: &Context) -> Result<Outputs, StageError> {
        let terms = inputs.many::<Table>("terms")?;
        let mut sum: f64 = terms.iter().filter_map(|(_, table)| table.rows[0][0].number()).sum();
        for port in ["also", "too"] {
            let more = inputs.optional::<Table>(port)?;
            sum += more.and_then(|table| table.rows[0][0].number()).unwrap_or(0.0);
        }
        let mut table = Table::new(["value"]);
        table.push(vec![(params.value + 0.5 * sum).into()]);
        Ok(Outputs::of("out", table))
    }
}

/// Makes a number from nothing.
struct Root;

impl Stage for Root {
    type Params = CheapParams;
    const NAME: &'static str = "root";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new("");
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("out", &[Kind::Table], "A number.")];
    fn run(params: &CheapParams, _: &Inputs, _: &Context) -> Result<Outputs, StageError> {
        let mut table = Table::new(["value"]);
        // Whole numbers: another value below the next one gives the same output.
        table.push(vec![params.value.floor().into()]);
        Ok(Outputs::of("out", table))
    }
}

const STAGES: &[&dyn AnyStage] = &[&Row::<Cheap>::new(), &Row::<Root>::new()];

/// The allocator of the program.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Set in the process that is timed when there is nothing to do: the folder of the benchmark.
const NOTHING_TO_DO: &str = "ROCKFACE_BENCH_FOLDER";

/// The steps that each step of a graph depends on; the first of the graph has none.
pub type Arrows = Vec<Vec<usize>>;

/// Makes a graph of so many steps.
type Shape = fn(usize) -> Arrows;

/// Each step depends on the one before.
fn chain(steps: usize) -> Arrows {
    (0..steps).map(|step| step.checked_sub(1).into_iter().collect()).collect()
}

/// Layers of the square root of the number of steps; each step depends on three of the layer before.
fn layered(steps: usize) -> Arrows {
    let width = (steps as f64).sqrt().ceil() as usize;
    let inputs = |step: usize| {
        if step == 0 {
            return Vec::new();
        }
        if step <= width {
            return vec![0];
        }
        let (layer, place) = ((step - 1) / width, (step - 1) % width);
        let mut from: Vec<usize> = (0..3).map(|next| 1 + (layer - 1) * width + (place + next) % width).collect();
        from.sort_unstable();
        from.dedup();
        from
    };
    (0..steps).map(inputs).collect()
}

/// Two shared steps, then three of its own for each point.
fn sweep(steps: usize) -> Arrows {
    let inputs = |step: usize| match step {
        0 => Vec::new(),
        1 => vec![0],
        step if (step - 2) % 3 == 0 => vec![1],
        step => vec![step - 1],
    };
    (0..steps).map(inputs).collect()
}

fn yaml(arrows: &Arrows) -> String {
    let mut yaml = String::from("rockface: 1\nsteps:\n");
    for (step, from) in arrows.iter().enumerate() {
        yaml += &match from.as_slice() {
            [] => format!("  s{step}: {{stage: root}}\n"),
            [one] => format!("  s{step}: {{stage: cheap, with: {{value: {step}}}, in: {{terms: s{one}.out}}}}\n"),
            [one, two] => format!(
                "  s{step}: {{stage: cheap, with: {{value: {step}}}, in: {{terms: s{one}.out, also: s{two}.out}}}}\n"
            ),
            [one, two, three, ..] => format!(
                "  s{step}: {{stage: cheap, with: {{value: {step}}}, in: {{terms: s{one}.out, also: s{two}.out, too: s{three}.out}}}}\n"
            ),
        };
    }
    yaml
}

/// A whole run without its folder; returns milliseconds and the number of steps that ran.
fn run(folder: &Path, set: &[String]) -> (f64, usize) {
    let begun = Instant::now();
    let path = folder.join("p.yaml");
    let text = Pipeline::read_file(&path).expect("the pipeline");
    let overrides = Overrides { set: set.to_vec(), ..Overrides::default() };
    // As the program reads it: the tree of a long text is taken from the store.
    let trees = rockface_cache::trees(&folder.join("store"));
    let pipeline = Pipeline::of_read(&text, &path, &overrides, Some(&trees)).expect("a right pipeline");
    let store = Arc::new(Store::open(&folder.join("store")).expect("a store"));
    let mut plan = plan(&pipeline, &[], STAGES, &store).expect("a plan");
    let stop = Arc::new(AtomicBool::new(false));
    let summary = execute(&mut plan, &store, &Options::default(), &stop, &mut Silent).expect("a run");
    let (headlines, files, made) = (Vec::new(), Vec::new(), Vec::new());
    let finished = Finished { folder: told_in(folder), headlines, warnings: Vec::new(), files, unnamed: 0, made };
    let told = Told::of(&finished, &plan, &summary);
    let question = Digest::of(text.as_bytes());
    if set.is_empty() {
        shortcut::remember(
            &store,
            &question,
            &plan,
            &Ended { summary: &summary, told: &told, finished: &finished },
            &[],
        )
        .expect("an answer");
    }
    drop(store);
    (begun.elapsed().as_secs_f64() * 1e3, summary.executed())
}

fn told_in(folder: &Path) -> std::path::PathBuf {
    folder.join("runs").join("told")
}

/// The process that finds nothing to do; prints its greatest memory, KiB.
fn find_nothing_to_do(folder: &Path) {
    let text = std::fs::read(folder.join("p.yaml")).expect("the pipeline");
    let found = shortcut::recall(&folder.join("store"), &Digest::of(&text), &folder.join("runs")).expect("a store");
    assert!(found.is_some(), "there was something to do");
    println!("{}", process_bytes("self", "VmHWM").unwrap_or(0) / 1024);
}

/// Milliseconds and MiB of a process that finds nothing to do.
fn nothing_to_do(folder: &Path) -> (f64, f64) {
    let program = std::env::current_exe().expect("this program");
    let once = || {
        let begun = Instant::now();
        let out = Command::new(&program).env(NOTHING_TO_DO, folder).output().expect("a process");
        let ms = begun.elapsed().as_secs_f64() * 1e3;
        assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
        let kib: f64 = String::from_utf8_lossy(&out.stdout).trim().parse().unwrap_or(f64::NAN);
        (ms, kib / 1024.0)
    };
    (0..7).map(|_| once()).fold((f64::INFINITY, 0.0), |best, next| (best.0.min(next.0), next.1.max(best.1)))
}

fn main() {
    rockface::memory::keep_freed();
    if let Some(folder) = std::env::var_os(NOTHING_TO_DO) {
        return find_nothing_to_do(Path::new(&folder));
    }
    let wanted = std::env::args().nth(1).filter(|word| !word.starts_with('-'));
    println!("milliseconds; `full` is a run of hits that opens the store, `no-op` what a user waits for");
    print!("{:>8} {:>6} {:>9} {:>8} {:>7}", "shape", "steps", "cold", "us/step", "full");
    println!(" {:>7} {:>5} {:>7} {:>9}  peers", "no-op", "MiB", "leaf", "root cut");
    let shapes: [(&str, Shape); 3] = [("chain", chain), ("layered", layered), ("sweep", sweep)];
    for (shape, arrows) in shapes.iter().filter(|(shape, _)| wanted.as_ref().is_none_or(|wanted| wanted == shape)) {
        for steps in [10, 100, 1_000, 10_000] {
            measure(shape, steps, &arrows(steps));
        }
    }
}

fn measure(shape: &str, steps: usize, arrows: &Arrows) {
    let folder = tempfile::tempdir().expect("a folder");
    let place = folder.path();
    std::fs::create_dir_all(told_in(place)).expect("a folder");
    for file in ["run.mcap", "report.html", "run.json"] {
        std::fs::write(told_in(place).join(file), "{}").expect("a file");
    }
    std::fs::write(place.join("p.yaml"), yaml(arrows)).expect("a file");
    let (cold, executed) = run(place, &[]);
    assert_eq!(executed, steps);
    let best = |set: &[String], expected: usize| {
        let (ms, executed) = run(place, set);
        assert_eq!(executed, expected);
        ms
    };
    let full = (0..3).map(|_| best(&[], 0)).fold(f64::INFINITY, f64::min);
    let (no_op, mib) = nothing_to_do(place);
    let leaf = best(&[format!("steps.s{}.with.value=-1", steps - 1)], 1);
    // The output of the root stays the same, so nothing follows.
    let cut = best(&["steps.s0.with={value: 0.5}".to_owned()], 1);
    print!("{shape:>8} {steps:>6} {cold:>9.1} {:>8.0} {full:>7.1}", cold * 1e3 / steps as f64);
    println!(" {no_op:>7.1} {mib:>5.1} {leaf:>7.1} {cut:>9.1}  {}", peers::told(arrows, no_op));
}
