//! What a stage is: a pure function of parameters, input artefacts and random streams, with a page of its own.

use std::collections::BTreeMap;
use std::io::Read;
use std::marker::PhantomData;

use serde_json::Value;

use crate::artefact::{Artefact, Kind};
use crate::georeferencing;
use crate::inputs::Inputs;
use crate::needs::InputSizes;
use crate::params::{Fault, Field, FileRef, FilesRef, GeoFileRef, ParamType, Params};
use crate::planner::Planner;
use crate::program::{Job, JobResult, Program, ProgramResult};

/// The item of each axis a step instance or a gathered element stands for.
pub type Point = BTreeMap<String, String>;

/// The page of a stage: Markdown with fixed headings, in a file beside the stage.
///
/// ```
/// use rockface_core::Page;
///
/// let page = Page::new("# add-noise\n\nAdds noise.\n\n## Method and references\n\nWhite noise.\n");
/// assert_eq!(page.what(), "Adds noise.");
/// assert_eq!(page.method(), "White noise.");
/// ```
#[derive(Debug, Clone, Copy)]
pub struct Page(&'static str);

impl Page {
    /// The page with this text.
    pub const fn new(text: &'static str) -> Self {
        Self(text)
    }

    /// What the stage does, in a sentence or two: what stands between the title and the first heading.
    pub fn what(&self) -> &'static str {
        let (_, rest) = self.0.split_once('\n').unwrap_or((self.0, ""));
        rest.split("\n## ").next().unwrap_or_default().trim()
    }

    /// The method and where it comes from (paper section or equation, reference).
    pub fn method(&self) -> &'static str {
        self.section("Method and references")
    }

    /// Units and frames of what goes in and out.
    pub fn frames(&self) -> &'static str {
        self.section("Units and frames")
    }

    /// When it refuses, and what to do then.
    pub fn fails(&self) -> &'static str {
        self.section("Fails when")
    }

    /// A complete pipeline that uses it; it must plan, and it runs in the tests where it needs no file.
    pub fn example(&self) -> &'static str {
        let fenced = self.section("Example");
        fenced.trim_start_matches("```yaml").trim_end_matches("```").trim()
    }

    /// The text under a heading; empty where the page lacks it.
    fn section(&self, heading: &str) -> &'static str {
        let sections = self.0.split("\n## ").skip(1);
        let found = sections.filter_map(|section| section.split_once('\n')).find(|(title, _)| title.trim() == heading);
        found.map_or("", |(_, text)| text.trim())
    }
}

/// How many artefacts a port takes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Arity {
    /// Exactly one artefact.
    One,
    /// One artefact or none.
    Optional,
    /// A gathered list of at least one; a single reference counts as a list of one.
    Many,
}

/// A typed input or output of a stage.
#[derive(Debug, Clone, Copy)]
pub struct Port {
    /// Its name in `in:` or after the dot of a reference.
    pub name: &'static str,
    /// The kinds of artefact it takes; an output has exactly one.
    pub kinds: &'static [Kind],
    /// How many artefacts it takes; an output makes one.
    pub arity: Arity,
    /// What the artefact is and in which frame, for the catalogue.
    pub doc: &'static str,
    /// The extension of its file where that is not the one of its kind, without the dot.
    pub extension: Option<&'static str>,
    /// Whether the stage changes what it gets here in place, which [`Inputs::owned`] hands it.
    pub changed: bool,
}

/// The ports of a step.
#[derive(Debug, Clone, Copy)]
pub struct Ports {
    /// The ports it reads artefacts from.
    pub inputs: &'static [Port],
    /// The ports it makes artefacts at.
    pub outputs: &'static [Port],
}

impl Port {
    /// A port for exactly one artefact of these kinds.
    pub const fn one(name: &'static str, kinds: &'static [Kind], doc: &'static str) -> Self {
        Self { name, kinds, arity: Arity::One, doc, extension: None, changed: false }
    }

    /// An input that may be left out.
    pub const fn optional(name: &'static str, kinds: &'static [Kind], doc: &'static str) -> Self {
        Self { name, kinds, arity: Arity::Optional, doc, extension: None, changed: false }
    }

    /// An input that takes a gathered list.
    pub const fn many(name: &'static str, kinds: &'static [Kind], doc: &'static str) -> Self {
        Self { name, kinds, arity: Arity::Many, doc, extension: None, changed: false }
    }

    /// The same port, of a stage that asks for its artefact by [`Inputs::owned`]: it is moved where no other step needs it any more.
    #[must_use]
    pub const fn changed(self) -> Self {
        Self { changed: true, ..self }
    }
}

/// Why a stage failed: the cause, and the way out where there is one.
///
/// ```
/// use rockface_core::StageError;
///
/// let error = StageError::new("the mesh has 3 holes").hint("set `holes: close`");
/// assert_eq!(error.to_string(), "the mesh has 3 holes");
/// ```
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{message}")]
pub struct StageError {
    /// What is wrong, with place and value.
    pub message: String,
    /// What to do about it.
    pub hint: Option<String>,
    /// Outputs that explain the failure; they are kept with the run, though no other step can use them.
    pub evidence: Option<Box<Outputs>>,
}

impl StageError {
    /// An error without a hint.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), hint: None, evidence: None }
    }

    /// Adds the way out.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }

    /// Says where it happened: the message becomes `place: message`.
    #[must_use]
    pub fn within(mut self, place: impl std::fmt::Display) -> Self {
        self.message = format!("{place}: {}", self.message);
        self
    }

    /// Adds outputs that explain the failure, such as a table of all that was tried.
    #[must_use]
    pub fn evidence(mut self, outputs: Outputs) -> Self {
        self.evidence = Some(Box::new(outputs));
        self
    }
}

impl From<String> for StageError {
    fn from(message: String) -> Self {
        Self::new(message)
    }
}

impl From<&str> for StageError {
    fn from(message: &str) -> Self {
        Self::new(message)
    }
}

/// Returns a [`StageError`] with a formatted message.
#[macro_export]
macro_rules! fail {
    ($($message:tt)*) => { return Err($crate::StageError::new(format!($($message)*))) };
}

/// The artefacts a stage made, by port.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Outputs {
    values: BTreeMap<&'static str, Artefact>,
    unchanged: BTreeMap<&'static str, &'static str>,
}

impl Outputs {
    /// One output at a port; [`Outputs::and`] adds further ones.
    pub fn of(port: &'static str, artefact: impl Into<Artefact>) -> Self {
        Self::default().and(port, artefact)
    }

    /// Adds the output of another port; one of the same port is replaced.
    #[must_use]
    pub fn and(mut self, port: &'static str, artefact: impl Into<Artefact>) -> Self {
        self.values.insert(port, artefact.into());
        self
    }

    /// Says that an output is what the stage was given at an input port of one artefact, to the bit: it need not be hashed again.
    #[must_use]
    pub fn unchanged(mut self, output: &'static str, input: &'static str) -> Self {
        self.unchanged.insert(output, input);
        self
    }

    /// The input port that an output is the value of, unchanged.
    pub fn unchanged_from(&self, output: &str) -> Option<&'static str> {
        self.unchanged.get(output).copied()
    }

    /// The artefacts that were made, in the order of their ports' names.
    pub fn values(&self) -> impl Iterator<Item = &Artefact> {
        self.values.values()
    }

    /// What was made at a port.
    pub fn get(&self, port: &str) -> Option<&Artefact> {
        self.values.get(port)
    }

    /// What was made, by port.
    pub fn by_port(&self) -> impl Iterator<Item = (&'static str, &Artefact)> {
        self.values.iter().map(|(port, value)| (*port, value))
    }

    /// The same, to be changed.
    pub fn values_mut(&mut self) -> impl Iterator<Item = &mut Artefact> {
        self.values.values_mut()
    }

    /// Hands over what was made.
    pub fn into_inner(self) -> BTreeMap<&'static str, Artefact> {
        self.values
    }
}

/// What a stage logs while it works; kept with its outputs, so a cached step has its log too.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case", tag = "type")]
pub enum Entry {
    /// Something worth reading that is neither the result nor a fault.
    Note {
        /// The note, one sentence.
        text: String,
    },
    /// Something that may be wrong.
    Warning {
        /// The warning, one sentence.
        text: String,
    },
    /// The result in one line, shown at the end of a run.
    Headline {
        /// The result, one sentence.
        text: String,
    },
    /// A number with its unit.
    Metric {
        /// Name, in `snake_case`.
        name: String,
        /// Value; in a log NaN and infinities are the strings `NaN`, `inf` and `-inf`.
        #[serde(with = "crate::any_number")]
        value: f64,
        /// Unit (`m`, `px`, `1`, ...).
        unit: String,
    },
}

/// A file named by a parameter, opened.
pub struct SourceFile {
    /// File name without its folder.
    pub name: String,
    /// Its content, to be read from the beginning.
    pub reader: Box<dyn Read + Send>,
}

/// What the engine lends a running stage. A stage touches neither disk nor clock nor hash function itself.
pub trait Host: Sync {
    /// 32 key bytes for one item of one purpose, derived from the step's seed material.
    fn stream_key(&self, purpose: &str, item: &str) -> [u8; 32];
    /// Opens what a file parameter names, as it was written in the pipeline, sorted by name.
    fn open(&self, as_written: &str) -> std::io::Result<Vec<SourceFile>>;
    /// Runs a program; its failure to start is an error, what it says and its exit code are not.
    fn execute(&self, program: &Program) -> Result<ProgramResult, StageError> {
        let _ = program;
        Err(StageError::new("no program can be run here"))
    }
    /// Gives a job to a program that stays alive between jobs; what it answers and how it ends are no errors.
    fn employ(&self, job: &Job) -> Result<JobResult, StageError> {
        let _ = job;
        Err(StageError::new("no program can be run here"))
    }
    /// Keeps an entry of the step's log.
    fn record(&self, entry: Entry);
    /// Whether the run was asked to stop.
    fn cancelled(&self) -> bool;
}

/// The stage's side of [`Host`].
#[derive(Clone, Copy)]
pub struct Context<'a>(&'a dyn Host);

impl<'a> Context<'a> {
    /// Wraps what the engine lends.
    pub fn new(host: &'a dyn Host) -> Self {
        Self(host)
    }

    /// The key of the random stream of one item (a pair, an image, a candidate number) for one purpose.
    pub fn stream(&self, purpose: &str, item: &str) -> crate::numerics::random::Key {
        crate::numerics::random::Key(self.0.stream_key(purpose, item))
    }

    /// A whole number below 2^31 for one purpose, for programs that draw by themselves.
    pub fn seed(&self, purpose: &str) -> u32 {
        let key = self.0.stream_key(purpose, "seed");
        u32::from_le_bytes([key[0], key[1], key[2], key[3]]) >> 1
    }

    /// Runs a program and waits for its end; its failure to start is an error, its exit code is not.
    pub fn execute(&self, program: &Program) -> Result<ProgramResult, StageError> {
        self.0.execute(program)
    }

    /// Gives a job to a program that stays alive between jobs.
    pub fn employ(&self, job: &Job) -> Result<JobResult, StageError> {
        self.0.employ(job)
    }

    /// The 32 bytes of a random stream as hexadecimal digits, for programs that draw by themselves.
    pub fn stream_digits(&self, purpose: &str, item: &str) -> String {
        self.0.stream_key(purpose, item).iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// Keeps an entry of the step's log.
    pub fn record(&self, entry: Entry) {
        self.0.record(entry);
    }

    /// Opens the one file a parameter names.
    pub fn file(&self, file: &FileRef) -> Result<SourceFile, StageError> {
        let mut files = self.files(&FilesRef(file.0.clone()))?;
        match files.len() {
            1 => Ok(files.remove(0)),
            n => Err(StageError::new(format!("`{}` names {n} files, one is needed", file.0))),
        }
    }

    /// Opens every file a parameter names, sorted by name.
    pub fn files(&self, files: &FilesRef) -> Result<Vec<SourceFile>, StageError> {
        self.0.open(&files.0).map_err(|e| StageError::new(format!("cannot read `{}`: {e}", files.0)))
    }

    /// Reads the whole of the one file a parameter names.
    pub fn read(&self, file: &FileRef) -> Result<Vec<u8>, StageError> {
        let read = crate::limits::read_whole(&mut self.file(file)?.reader, &|| self.cancelled());
        read.map_err(|e| StageError::new(format!("cannot read `{}`: {e}", file.0)))
    }

    /// Reads the whole of the one file a parameter names, and of the `.prj` beside it where there is one, which has at most
    /// [`SYSTEM_FILE_BYTES`](crate::limits::SYSTEM_FILE_BYTES).
    pub fn read_georeferenced(&self, file: &GeoFileRef) -> Result<(Vec<u8>, Option<Vec<u8>>), StageError> {
        const MOST: u64 = crate::limits::SYSTEM_FILE_BYTES;
        let mut files = self.files(&FilesRef(file.0.clone()))?.into_iter();
        let mut next = |most: u64| {
            let read = |file: SourceFile| crate::limits::read_whole(&mut file.reader.take(most), &|| self.cancelled());
            let bytes = files.next().map(read).transpose();
            bytes.map_err(|e| StageError::new(format!("cannot read `{}`: {e}", file.0)))
        };
        let bytes = next(u64::MAX)?.ok_or_else(|| StageError::new(format!("`{}` names no file", file.0)))?;
        let system = next(MOST + 1)?;
        if system.as_ref().is_some_and(|system| system.len() as u64 > MOST) {
            let what = format!("the `.prj` beside `{}`", file.0);
            return Err(StageError::new(crate::limits::too_long(&what, MOST)));
        }
        Ok((bytes, system))
    }

    /// Logs something worth reading.
    pub fn note(&self, text: impl Into<String>) {
        self.0.record(Entry::Note { text: text.into() });
    }

    /// Logs something that may be wrong.
    pub fn warn(&self, text: impl Into<String>) {
        self.0.record(Entry::Warning { text: text.into() });
    }

    /// Logs the result in one line; it is shown at the end of a run.
    pub fn headline(&self, text: impl Into<String>) {
        self.0.record(Entry::Headline { text: text.into() });
    }

    /// Logs a number with its unit, which is `1` where it has none.
    pub fn metric(&self, name: &str, value: f64, unit: &str) {
        // The sum of no numbers is -0, which nobody wants to read.
        let value = value + 0.0;
        self.0.record(Entry::Metric { name: name.to_owned(), value, unit: unit.to_owned() });
    }

    /// Fails when the run was asked to stop; call it now and then in long loops.
    pub fn check_cancelled(&self) -> Result<(), StageError> {
        if self.cancelled() { Err(StageError::new("interrupted")) } else { Ok(()) }
    }

    /// Whether the run was asked to stop, or the step's time is over.
    pub fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// A kind of computation: a pure function of parameters, input artefacts and random streams.
///
/// ```
/// use rockface_core::artefact::{Artefact, Kind, Table};
/// use rockface_core::params::Range;
/// use rockface_core::testing::{TestHost, run_stage};
/// use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, params};
/// use serde_json::json;
///
/// params! {
///     /// Parameters of `scale-table`.
///     pub struct ScaleParams {
///         /// Factor of every number.
///         factor: f64 = 2.0; Range::Positive,
///     }
/// }
///
/// struct ScaleTable;
///
/// impl Stage for ScaleTable {
///     type Params = ScaleParams;
///     const NAME: &'static str = "scale-table";
///     const VERSION: u32 = 1;
///     const PAGE: Page = Page::new("# scale-table\n\nMultiplies every number of a table.\n");
///     const INPUTS: &'static [Port] = &[Port::one("table", &[Kind::Table], "Any table.").changed()];
///     const OUTPUTS: &'static [Port] = &[Port::one("table", &[Kind::Table], "The table with scaled numbers.")];
///
///     fn run(params: &ScaleParams, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
///         let mut table = inputs.owned::<Table>("table")?;
///         for cell in table.rows.iter_mut().flatten() {
///             if let Some(number) = cell.number() {
///                 *cell = (params.factor * number).into();
///             }
///         }
///         context.metric("rows", table.rows.len() as f64, "1");
///         Ok(Outputs::of("table", table))
///     }
/// }
///
/// let mut volumes = Table::new(["volume_m3"]);
/// volumes.push(vec![1.5.into()]);
/// let host = TestHost::default();
/// let made = run_stage::<ScaleTable>(&host, &json!({"factor": 4}), &[("table", volumes.into())])?.into_inner();
/// let Artefact::Table(scaled) = &made["table"] else { panic!("port `table` is a table") };
/// assert_eq!(scaled.rows[0][0].number(), Some(6.0));
/// assert_eq!(host.metric("rows"), Some(1.0));
/// # Ok::<(), StageError>(())
/// ```
pub trait Stage: Send + Sync + 'static {
    /// The keys of `with`, declared by [`crate::params!`].
    type Params: Params;
    /// The name in pipelines, `verb-object`.
    const NAME: &'static str;
    /// Raised whenever equal inputs give other bytes: the version is part of every recipe.
    const VERSION: u32;
    /// The documentation that `rockface stages NAME` prints.
    const PAGE: Page;
    /// The artefacts a step reads; [`Stage::ports`] may override them.
    const INPUTS: &'static [Port];
    /// The artefacts a step makes; every run makes each of them.
    const OUTPUTS: &'static [Port];

    /// Whether `run` calls [`Context::execute`]; the engine refuses a program to a stage that does not declare it.
    const STARTS_PROGRAMS: bool = false;

    /// Whether [`Stage::complete`] has something to add.
    const IS_COMPLETED: bool = false;

    /// Variables of the environment that decide what [`Stage::complete`] finds, beside those that every program is given.
    const VARIABLES: &'static [&'static str] = &[];

    /// Keys to be added to a step's `with` before its ports are asked for: what a file says that a parameter names. They take
    /// the place of those that are written, and may not depend on an axis.
    fn complete(_with: &Value, _planner: &dyn Planner) -> Result<serde_json::Map<String, Value>, Vec<Fault>> {
        Ok(serde_json::Map::new())
    }

    /// Whether these parameters make it draw random numbers; only then is the seed part of the recipe.
    fn draws(_params: &Self::Params) -> bool {
        false
    }

    /// The ports of a step with these parameters; they may not depend on an axis.
    fn ports(_with: &Value) -> Result<Ports, Vec<Fault>> {
        Ok(Ports { inputs: Self::INPUTS, outputs: Self::OUTPUTS })
    }

    /// Checks that hold between parameters; each fault names the parameter at its path.
    fn check(_params: &Self::Params) -> Vec<Fault> {
        Vec::new()
    }

    /// An upper estimate of the memory it needs, bytes: inputs, outputs, and what is made while outputs are encoded and
    /// sketched. A run starts no more steps at once than fit into its memory.
    fn memory_bytes(_params: &Self::Params, inputs: &InputSizes) -> u64 {
        inputs.total().saturating_mul(4)
    }

    /// Computes the outputs. It depends on its arguments alone: no disk, clock, thread count or global state.
    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError>;
}

/// Parameters that were read and checked.
#[derive(Debug, Clone, PartialEq)]
pub struct Checked {
    /// Canonical form with every default filled in; file parameters still as written.
    pub canonical: Value,
    /// Whether the stage draws random numbers with them.
    pub draws: bool,
}

/// A [`Stage`] without its type, as the registry lists it; [`Row`] implements it.
pub trait AnyStage: Sync {
    /// [`Stage::NAME`]: the name in pipelines, `verb-object`.
    fn name(&self) -> &'static str;
    /// [`Stage::VERSION`]: part of every recipe.
    fn version(&self) -> u32;
    /// [`Stage::PAGE`]: its documentation.
    fn page(&self) -> &'static Page;
    /// [`Stage::INPUTS`]: the ports it reads from, unless its parameters say otherwise.
    fn inputs(&self) -> &'static [Port];
    /// [`Stage::OUTPUTS`]: the ports it makes artefacts at, unless its parameters say otherwise.
    fn outputs(&self) -> &'static [Port];
    /// Whether it has programs started.
    fn starts_programs(&self) -> bool;
    /// Whether it adds keys to `with` before planning.
    fn is_completed(&self) -> bool;
    /// [`Stage::VARIABLES`]: variables of the environment that decide what it adds.
    fn variables(&self) -> &'static [&'static str];
    /// The keys it adds to `with`, see [`Stage::complete`].
    fn complete(&self, with: &Value, planner: &dyn Planner) -> Result<serde_json::Map<String, Value>, Vec<Fault>>;
    /// The ports of a step whose `with` is written like this.
    fn ports(&self, with: &Value) -> Result<Ports, Vec<Fault>>;
    /// Its parameters with their kinds, defaults and ranges.
    fn fields(&self) -> Vec<Field>;
    /// Reads and checks a step's `with`.
    fn check(&self, with: &Value) -> Result<Checked, Vec<Fault>>;
    /// The memory it will need, bytes; `with` must have passed [`AnyStage::check`].
    fn memory_bytes(&self, with: &Value, inputs: &InputSizes) -> u64;
    /// Does the work; `with` must have passed [`AnyStage::check`].
    fn run(&self, with: &Value, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError>;
}

/// Runs a stage, and gives the place on the Earth that its inputs state to what it makes.
pub(crate) fn run<S: Stage>(params: &S::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
    if georeferencing::only_shows(S::OUTPUTS) {
        inputs.stated().allow_mixed();
    }
    let mut outputs = S::run(params, inputs, context)?;
    inputs.stated().carry(&mut outputs, context);
    Ok(outputs)
}

/// Lists a [`Stage`] in a [`crate::Room`]: `&Row::<ScaleTable>::new()` is an [`AnyStage`].
pub struct Row<S>(PhantomData<fn() -> S>);

impl<S> Row<S> {
    /// The row of a stage.
    pub const fn new() -> Self {
        Self(PhantomData)
    }
}

impl<S> Default for Row<S> {
    fn default() -> Self {
        Self::new()
    }
}

impl<S: Stage> AnyStage for Row<S> {
    fn name(&self) -> &'static str {
        S::NAME
    }
    fn version(&self) -> u32 {
        S::VERSION
    }
    fn page(&self) -> &'static Page {
        &S::PAGE
    }
    fn inputs(&self) -> &'static [Port] {
        S::INPUTS
    }
    fn outputs(&self) -> &'static [Port] {
        S::OUTPUTS
    }
    fn starts_programs(&self) -> bool {
        S::STARTS_PROGRAMS
    }
    fn is_completed(&self) -> bool {
        S::IS_COMPLETED
    }
    fn variables(&self) -> &'static [&'static str] {
        S::VARIABLES
    }
    fn complete(&self, with: &Value, planner: &dyn Planner) -> Result<serde_json::Map<String, Value>, Vec<Fault>> {
        S::complete(with, planner)
    }
    fn ports(&self, with: &Value) -> Result<Ports, Vec<Fault>> {
        S::ports(with)
    }
    fn fields(&self) -> Vec<Field> {
        S::Params::fields()
    }
    fn check(&self, with: &Value) -> Result<Checked, Vec<Fault>> {
        let params = S::Params::decode(with)?;
        let faults = S::check(&params);
        if faults.is_empty() {
            Ok(Checked { canonical: params.encode(), draws: S::draws(&params) })
        } else {
            Err(faults)
        }
    }
    fn memory_bytes(&self, with: &Value, inputs: &InputSizes) -> u64 {
        S::Params::decode(with).map_or(0, |params| S::memory_bytes(&params, inputs))
    }
    fn run(&self, with: &Value, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let params = S::Params::decode(with)
            .map_err(|faults| StageError::new(faults.first().map_or_else(String::new, |f| f.message.clone())))?;
        run::<S>(&params, inputs, context)
    }
}
