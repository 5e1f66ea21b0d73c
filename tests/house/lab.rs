//! A small laboratory: stages that know no rock, and a bench to run pipelines on.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use rayon::prelude::*;
use rockface_cache::Store;
use rockface_core::artefact::{Cell, Kind, Noun, Pair, Pairs, Table};
use rockface_core::params::{FileRef, FilesRef};
use rockface_core::{AnyStage, Context, Inputs, Outputs, Page, Port, Row, Stage, StageError, params};
use rockface_engine::diagnostic::Diagnostics;
use rockface_engine::pipeline::{Overrides, Pipeline};
use rockface_engine::plan::{Plan, plan};
use rockface_engine::run::{Options, Summary, execute};
use rockface_engine::watch::{Event, Events, Reason};

const PAGE: Page = Page::new("# test\n\nA test.\n");
const TABLE: &[Kind] = &[Kind::Table];

fn cell(value: f64) -> Table {
    let mut table = Table::new(["value"]);
    table.push(vec![value.into()]);
    table
}

fn total(inputs: &Inputs, port: &str) -> Result<f64, StageError> {
    let tables = inputs.many::<Table>(port)?;
    Ok(tables.iter().flat_map(|(_, table)| table.rows.iter()).filter_map(|row| row[0].number()).sum())
}

params! {
    /// Parameters of `emit`.
    pub struct EmitParams {
        /// A number.
        value: f64 = 1.0,
        /// Rounds the number down to whole ones.
        whole: bool = false,
    }
}

/// Makes the number that its parameters name.
pub struct Emit;
impl Stage for Emit {
    type Params = EmitParams;
    const NAME: &'static str = "emit";
    const VERSION: u32 = 1;
    const PAGE: Page = PAGE;
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("out", TABLE, "The number.")];
    fn run(params: &EmitParams, _: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let value = if params.whole { params.value.floor() } else { params.value };
        context.headline(format!("value {value}"));
        Ok(Outputs::of("out", cell(value)))
    }
}

params! {
    /// Parameters of `add`.
    pub struct AddParams {
        /// Added to the sum.
        plus: f64 = 0.0,
        /// Gives up instead.
        fail: bool = false,
        /// Breaks down instead.
        panic: bool = false,
    }
}

/// Sums its inputs, or fails where its parameters ask for it.
pub struct Add;
impl Stage for Add {
    type Params = AddParams;
    const NAME: &'static str = "add";
    const VERSION: u32 = 1;
    const PAGE: Page = PAGE;
    const INPUTS: &'static [Port] = &[Port::many("terms", TABLE, "What is summed.")];
    const OUTPUTS: &'static [Port] = &[Port::one("out", TABLE, "The sum.")];
    fn run(params: &AddParams, inputs: &Inputs, _: &Context) -> Result<Outputs, StageError> {
        assert!(!params.panic, "told to");
        if params.fail {
            return Err(StageError::new("told to give up").hint("do not tell it to"));
        }
        Ok(Outputs::of("out", cell(total(inputs, "terms")? + params.plus)))
    }
}

params! {
    /// Parameters of `draw`.
    pub struct DrawParams {
        /// Scale of the draw; 0 draws nothing.
        sigma: f64 = 1.0,
    }
}

/// Adds a random number.
pub struct Draw;
impl Stage for Draw {
    type Params = DrawParams;
    const NAME: &'static str = "draw";
    const VERSION: u32 = 1;
    const PAGE: Page = PAGE;
    const INPUTS: &'static [Port] = &[
        Port::one("in", TABLE, "What it is added to."),
        Port::optional("after", TABLE, "What has to be done before."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("out", TABLE, "The sum.")];
    fn draws(params: &DrawParams) -> bool {
        params.sigma > 0.0
    }
    fn run(params: &DrawParams, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let noise = if params.sigma > 0.0 { context.stream("noise", "only").field().normal(0, 0) } else { 0.0 };
        Ok(Outputs::of("out", cell(total(inputs, "in")? + params.sigma * noise)))
    }
}

params! {
    /// Parameters of `read`.
    pub struct ReadParams {
        /// A file with a number in it.
        path: FileRef,
    }
}

/// Reads a number from a file.
pub struct Read;
impl Stage for Read {
    type Params = ReadParams;
    const NAME: &'static str = "read";
    const VERSION: u32 = 1;
    const PAGE: Page = PAGE;
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("out", TABLE, "The number.")];
    fn run(params: &ReadParams, _: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let text = String::from_utf8_lossy(&context.read(&params.path)?).into_owned();
        let value = text.trim().parse().map_err(|_| StageError::new(format!("`{text}` is no number")))?;
        Ok(Outputs::of("out", cell(value)))
    }
}

params! {
    /// Parameters of `tally`.
    pub struct TallyParams {
        /// Files with a number in each.
        path: FilesRef,
    }
}

/// Sums the numbers of files.
pub struct Tally;
impl Stage for Tally {
    type Params = TallyParams;
    const NAME: &'static str = "tally";
    const VERSION: u32 = 1;
    const PAGE: Page = PAGE;
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("out", TABLE, "The sum.")];
    fn run(params: &TallyParams, _: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mut sum = 0.0;
        for mut file in context.files(&params.path)? {
            let mut text = String::new();
            let read = std::io::Read::read_to_string(&mut file.reader, &mut text);
            read.map_err(|error| StageError::new(error.to_string()))?;
            sum += text.trim().parse().unwrap_or(0.0);
        }
        Ok(Outputs::of("out", cell(sum)))
    }
}

params! {
    /// Parameters of `toil`.
    pub struct ToilParams {
        /// Tells one piece of toil from another.
        value: f64 = 0.0,
    }
}

/// Takes its time on all threads.
pub struct Toil;
impl Stage for Toil {
    type Params = ToilParams;
    const NAME: &'static str = "toil";
    const VERSION: u32 = 1;
    const PAGE: Page = PAGE;
    const INPUTS: &'static [Port] = &[Port::optional("after", TABLE, "What comes before.")];
    const OUTPUTS: &'static [Port] = &[Port::one("out", TABLE, "The number.")];
    fn run(params: &ToilParams, _: &Inputs, _: &Context) -> Result<Outputs, StageError> {
        (0..8).into_par_iter().for_each(|_| std::thread::sleep(std::time::Duration::from_millis(10)));
        Ok(Outputs::of("out", cell(params.value)))
    }
}

/// How often `moody` has run in this process.
static MOODS: AtomicU64 = AtomicU64::new(0);

params! {
    /// Parameters of `moody`.
    pub struct MoodyParams {
        /// Tells one from another.
        value: f64 = 0.0,
        /// Gives up while this file is there; looked at behind the engine's back, as no true stage may.
        unless: String = String::new(),
    }
}

/// Breaks every promise of a stage: makes another number each time, and gives up when it likes.
pub struct Moody;
impl Stage for Moody {
    type Params = MoodyParams;
    const NAME: &'static str = "moody";
    const VERSION: u32 = 1;
    const PAGE: Page = PAGE;
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("out", TABLE, "The number.")];
    fn run(params: &MoodyParams, _: &Inputs, _: &Context) -> Result<Outputs, StageError> {
        if std::path::Path::new(&params.unless).is_file() {
            return Err(StageError::new("not in the mood"));
        }
        let mood = MOODS.fetch_add(1, Ordering::Relaxed);
        Ok(Outputs::of("out", cell(params.value + mood as f64)))
    }
}

params! {
    /// Parameters of `list`.
    pub struct ListParams {
        /// How many rows.
        rows: usize = 3,
    }
}

/// Makes rows of values that count on from the sum of what it is given.
pub struct List;
impl Stage for List {
    type Params = ListParams;
    const NAME: &'static str = "list";
    const VERSION: u32 = 1;
    const PAGE: Page = PAGE;
    const INPUTS: &'static [Port] = &[Port::many("terms", TABLE, "What the first value is the sum of.")];
    const OUTPUTS: &'static [Port] = &[Port::one("out", TABLE, "The rows.")];
    fn run(params: &ListParams, inputs: &Inputs, _: &Context) -> Result<Outputs, StageError> {
        let first = total(inputs, "terms")?;
        let mut table = Table::new(["value"]);
        (0..params.rows).for_each(|row| table.push(vec![(first + row as f64).into()]));
        Ok(Outputs::of("out", table))
    }
}

params! {
    /// Parameters of `raise`.
    pub struct RaiseParams {
        /// What is added.
        plus: f64 = 1.0,
    }
}

/// Adds to the number it is given, in place, and counts in a second column how often it did so without a copy: its tables have room for many
/// more rows, their copies have none.
pub struct Raise;
impl Stage for Raise {
    type Params = RaiseParams;
    const NAME: &'static str = "raise";
    const VERSION: u32 = 1;
    const PAGE: Page = PAGE;
    const INPUTS: &'static [Port] = &[Port::one("in", TABLE, "What is raised.").changed()];
    const OUTPUTS: &'static [Port] = &[Port::one("out", TABLE, "The same, raised.")];
    fn run(params: &RaiseParams, inputs: &Inputs, _: &Context) -> Result<Outputs, StageError> {
        const ROOM: usize = 1000;
        let mut table = inputs.owned::<Table>("in")?;
        let moved = if table.rows.capacity() < ROOM { 0.0 } else { 1.0 };
        let [value, before] = [0, 1].map(|column| table.rows[0].get(column).and_then(Cell::number).unwrap_or(0.0));
        table.columns = Table::new(["value", "moved"]).columns;
        table.rows[0] = vec![(value + params.plus).into(), (before + moved).into()];
        table.rows.reserve(ROOM);
        Ok(Outputs::of("out", table))
    }
}

params! {
    /// Parameters of `hand-on`.
    pub struct HandOnParams {
        /// What is added, against what it says.
        plus: f64 = 0.0,
    }
}

/// Says that it gives on what it was given; does not where it adds to it.
pub struct HandOn;
impl Stage for HandOn {
    type Params = HandOnParams;
    const NAME: &'static str = "hand-on";
    const VERSION: u32 = 1;
    const PAGE: Page = PAGE;
    const INPUTS: &'static [Port] = &[Port::one("in", TABLE, "What is given on.")];
    const OUTPUTS: &'static [Port] = &[Port::one("out", TABLE, "The same.")];
    fn run(params: &HandOnParams, inputs: &Inputs, _: &Context) -> Result<Outputs, StageError> {
        Ok(Outputs::of("out", cell(total(inputs, "in")? + params.plus)).unchanged("out", "in"))
    }
}

params! {
    /// Parameters of `couple`.
    pub struct CoupleParams {
        /// The pairs, each `first+second`.
        pairs: Vec<String>,
    }
}

/// Makes the list of pairs that its parameters name.
pub struct Couple;
impl Stage for Couple {
    type Params = CoupleParams;
    const NAME: &'static str = "couple";
    const VERSION: u32 = 1;
    const PAGE: Page = PAGE;
    const INPUTS: &'static [Port] = &[Port::optional("after", TABLE, "What has to be done before.")];
    const OUTPUTS: &'static [Port] = &[Port::one("pairs", &[Kind::Pairs], "The pairs.")];
    fn run(params: &CoupleParams, _: &Inputs, _: &Context) -> Result<Outputs, StageError> {
        let pair = |name: &String| {
            let Some((first, second)) = name.split_once('+') else {
                return Err(StageError::new(format!("`{name}` is no pair")));
            };
            let (first, second) = (first.to_owned(), second.to_owned());
            let [baseline_m, distance_m, convergence_rad, overlap] = [1.0, 10.0, 0.1, 0.8];
            Ok(Pair { name: name.clone(), first, second, baseline_m, distance_m, convergence_rad, overlap })
        };
        let pairs = params.pairs.iter().map(pair).collect::<Result<_, _>>()?;
        Ok(Outputs::of("pairs", Pairs { pairs }))
    }
}

/// The stages of the laboratory.
pub const STAGES: &[&dyn AnyStage] = &[
    &Row::<Emit>::new(),
    &Row::<Add>::new(),
    &Row::<Draw>::new(),
    &Row::<Read>::new(),
    &Row::<Tally>::new(),
    &Row::<Toil>::new(),
    &Row::<Moody>::new(),
    &Row::<List>::new(),
    &Row::<Raise>::new(),
    &Row::<HandOn>::new(),
    &Row::<Couple>::new(),
];

/// What a run did.
pub struct Ran {
    pub plan: Plan,
    pub summary: Summary,
    pub events: Vec<Event>,
}

impl Ran {
    /// Labels of the instances that ran because their recipe was new, sorted.
    pub fn executed(&self) -> Vec<String> {
        let new = |event: &Event| match event {
            Event::Started { step, reason: Reason::New } => Some(step.clone()),
            _ => None,
        };
        self.sorted(new)
    }

    /// Labels of the instances that ran only because their values were needed, sorted.
    pub fn remade(&self) -> Vec<String> {
        let needed = |event: &Event| match event {
            Event::Started { step, reason: Reason::Needed } => Some(step.clone()),
            _ => None,
        };
        self.sorted(needed)
    }

    /// Every warning, with the instance it is about, sorted.
    pub fn warnings(&self) -> Vec<String> {
        let warned = |event: &Event| match event {
            Event::Warning { step, text } => Some(format!("{step}: {text}")),
            _ => None,
        };
        self.sorted(warned)
    }

    /// Whether the outcome of an instance is known.
    pub fn is_known(&self, label: &str) -> bool {
        let instance = (0..self.plan.instances.len()).find(|i| self.plan.label(*i) == label).expect(label);
        self.summary.instances[instance].outcome.is_some()
    }

    fn sorted(&self, pick: impl Fn(&Event) -> Option<String>) -> Vec<String> {
        let mut labels: Vec<String> = self.events.iter().filter_map(pick).collect();
        labels.sort();
        labels
    }

    /// The number an instance made.
    pub fn number(&self, store: &Store, label: &str) -> f64 {
        self.value::<Table>(store, label, "out").rows[0][0].number().unwrap()
    }

    /// What an instance made at a port.
    pub fn value<T: Noun>(&self, store: &Store, label: &str, port: &str) -> T {
        let instance = (0..self.plan.instances.len()).find(|i| self.plan.label(*i) == label).expect(label);
        let outcome = self.summary.instances[instance].outcome.as_ref().expect(label);
        T::decode(&store.get(&outcome.outputs[port].digest).unwrap()).unwrap()
    }

    /// The digest of every output of every instance, by label and port.
    pub fn digests(&self) -> Vec<String> {
        let outputs = self.summary.instances.iter().enumerate().flat_map(|(i, result)| {
            let outputs = result.outcome.iter().flat_map(|outcome| &outcome.outputs);
            outputs
                .map(move |(port, output)| format!("{}.{port} {}", self.plan.label(i), output.digest))
                .collect::<Vec<_>>()
        });
        outputs.collect()
    }
}

/// A folder with a store in it.
pub struct Bench {
    pub folder: tempfile::TempDir,
    pub store: Arc<Store>,
    pub stages: &'static [&'static dyn AnyStage],
}

impl Bench {
    /// A bench for the stages of the laboratory.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = Arc::new(Store::open(&folder.path().join("store")).unwrap());
        Self { folder, store, stages: STAGES }
    }

    /// A bench for the real stages.
    pub fn rocks() -> Self {
        Self { stages: rockface_stages::registry().stages(), ..Self::new() }
    }

    /// Runs a pipeline text of laboratory stages with some overrides.
    pub fn run(&self, yaml: &str, set: &[&str]) -> Ran {
        self.run_with(yaml, set, &Options { jobs: 2, ..Options::default() })
    }

    pub fn run_with(&self, yaml: &str, set: &[&str], options: &Options) -> Ran {
        let mut plan = self.plan(yaml, set).unwrap_or_else(|faults| panic!("{faults}"));
        let mut events = Events::default();
        let stop = Arc::new(AtomicBool::new(false));
        let summary = execute(&mut plan, &self.store, options, &stop, &mut events).unwrap();
        Ran { plan, summary, events: events.0 }
    }

    /// Plans a pipeline text, or says what is wrong with it.
    pub fn plan(&self, yaml: &str, set: &[&str]) -> Result<Plan, Diagnostics> {
        let overrides = Overrides { set: set.iter().map(ToString::to_string).collect(), ..Overrides::default() };
        let pipeline = Pipeline::parse(yaml, "test.yaml", "test", self.folder.path().to_owned(), &overrides)?;
        plan(&pipeline, &[], self.stages, &self.store)
    }
}
