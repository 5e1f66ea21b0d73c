//! What the engine itself costs: cold, warm and one-leaf runs over cheap steps, by number of steps.
//!
//! `cargo bench --bench engine`; figures are printed as a table, milliseconds for the whole and microseconds a step.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use rockface::pipeline::{Overrides, Pipeline};
use rockface::plan::plan;
use rockface::run::{Options, execute};
use rockface::watch::Silent;
use rockface_cache::Store;
use rockface_stages::artefact::{Kind, Table};
use rockface_stages::{AnyStage, Context, Inputs, Outputs, Page, Port, Row, Stage, StageError, params};

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
    const PAGE: Page = Page { what: "", method: "", frames: "", fails: "", example: "" };
    const INPUTS: &'static [Port] = &[Port::many("terms", &[Kind::Table], "What came before.")];
    const OUTPUTS: &'static [Port] = &[Port::one("out", &[Kind::Table], "A number.")];
    fn run(params: &CheapParams, inputs: &Inputs, _: &Context) -> Result<Outputs, StageError> {
        let terms = inputs.many::<Table>("terms")?;
        let sum: f64 = terms.iter().filter_map(|(_, table)| table.rows[0][0].number()).sum();
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
    const PAGE: Page = Page { what: "", method: "", frames: "", fails: "", example: "" };
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("out", &[Kind::Table], "A number.")];
    fn run(params: &CheapParams, _: &Inputs, _: &Context) -> Result<Outputs, StageError> {
        let mut table = Table::new(["value"]);
        table.push(vec![params.value.into()]);
        Ok(Outputs::of("out", table))
    }
}

const STAGES: &[&dyn AnyStage] = &[&Row::<Cheap>::new(), &Row::<Root>::new()];

/// A layered graph: every step has up to three inputs from the steps just before it.
fn layered(steps: usize) -> String {
    let mut yaml = String::from("rockface: 1\nsteps:\n  s0: {stage: root}\n");
    for i in 1..steps {
        let from = i.saturating_sub(17);
        yaml += &format!("  s{i}: {{stage: cheap, with: {{value: {i}}}, in: {{terms: s{from}.out}}}}\n");
    }
    yaml
}

fn run(folder: &Path, yaml: &str, set: &[String]) -> (f64, usize) {
    let begun = Instant::now();
    let overrides = Overrides { set: set.to_vec(), ..Overrides::default() };
    let pipeline = Pipeline::parse(yaml, "bench", "bench", folder.to_owned(), &overrides).expect("a right pipeline");
    let store = Store::open(&folder.join("store")).expect("a store");
    let mut plan = plan(&pipeline, &[], STAGES, &store).expect("a plan");
    let stop = Arc::new(AtomicBool::new(false));
    let summary = execute(&mut plan, &store, &Options::default(), &stop, &mut Silent).expect("a run");
    drop(store);
    (begun.elapsed().as_secs_f64() * 1e3, summary.executed())
}

fn main() {
    println!(
        "{:>8} {:>12} {:>14} {:>12} {:>14} {:>12}",
        "steps", "cold ms", "us a step", "no-op ms", "us a step", "leaf ms"
    );
    for steps in [10, 100, 1_000, 10_000] {
        let folder = tempfile::tempdir().expect("a folder");
        let yaml = layered(steps);
        let (cold, executed) = run(folder.path(), &yaml, &[]);
        assert_eq!(executed, steps);
        let warm = (0..5).map(|_| run(folder.path(), &yaml, &[])).inspect(|(_, executed)| assert_eq!(*executed, 0));
        let warm = warm.map(|(ms, _)| ms).fold(f64::INFINITY, f64::min);
        let leaf = [format!("steps.s{}.with.value=-1", steps - 1)];
        let (leaf, executed) = run(folder.path(), &yaml, &leaf);
        assert_eq!(executed, 1);
        let each = |ms: f64| ms * 1e3 / steps as f64;
        println!("{steps:>8} {cold:>12.1} {:>14.1} {warm:>12.1} {:>14.1} {leaf:>12.1}", each(cold), each(warm));
    }
}
