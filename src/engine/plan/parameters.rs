//! The parameters of a step at one point: filled in, checked, and with its files found and hashed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rockface_cache::Digest;
use rockface_core::AnyStage;
use rockface_core::limits::{SYSTEM_FILE_BYTES, too_long};
use rockface_core::params::{Fault, Field, Kind};
use serde_json::{Value, json};

use super::graph::{Graph, GraphStep};
use super::missing::Missing;
use super::side_files;
use super::sight::{Sight, one_file};
use crate::diagnostic::{Diagnostic, Span, nearest};
use crate::pipeline::{INSIDE, Node, as_number, filled, mentioned, odd_space, parted, value_of};

/// The column of a table that names its rows; without it they are numbered.
pub const NAME_COLUMN: &str = "item";

/// Parameters that are ready for the recipe and for the stage.
#[derive(Debug, Clone, PartialEq)]
pub struct StepParams {
    /// Canonical, every default filled in, files as written: what the stage gets.
    pub canonical: Arc<Value>,
    /// The same with every file replaced by its name-free or named digests: what the recipe holds.
    pub recipe: Arc<Value>,
    /// Whether the stage draws random numbers with them.
    pub draws: bool,
    /// The files behind each file parameter, as it was written.
    pub files: BTreeMap<String, Vec<InputFile>>,
}

impl StepParams {
    /// Parameters whose files are not looked for yet.
    fn of(canonical: Value, draws: bool) -> Self {
        let canonical = Arc::new(canonical);
        Self { recipe: canonical.clone(), canonical, draws, files: BTreeMap::new() }
    }
}

/// A file named by a parameter.
#[derive(Debug, Clone, PartialEq)]
pub struct InputFile {
    /// Its name without the folder.
    pub name: String,
    /// The path of the file.
    pub path: PathBuf,
    /// Its digest when the plan was made.
    pub digest: Digest,
    /// The run that tells the digest, where the file itself is gone.
    pub gone_since: Option<String>,
}

/// What a `${name}` stands for at the items of some axes.
pub fn lookup(graph: &Graph, items: &BTreeMap<usize, usize>, name: &str) -> Option<Value> {
    value_of(&graph.params, name).or_else(|| {
        let (base, field) = parted(name);
        let axis = graph.axes.iter().position(|axis| axis.name.text == base)?;
        let value = graph.axes[axis].values.get(*items.get(&axis)?)?;
        match field {
            Some(field) => value.get(field).cloned(),
            None => Some(without_name(value)),
        }
    })
}

/// The values of an item; the column that names it is none of them.
fn without_name(value: &Value) -> Value {
    let mut value = value.clone();
    value.as_object_mut().and_then(|columns| columns.remove(NAME_COLUMN));
    value
}

/// Fills in and checks the parameters of a step at the items of the axes its `with` mentions.
pub fn check(graph: &Graph, step: &GraphStep, items: &BTreeMap<usize, usize>) -> Result<StepParams, Vec<Diagnostic>> {
    check_filled(step, &fill(graph, step, items)?)
}

/// The same, and finds and hashes the files that the parameters name; `fields` are those of the stage.
pub fn check_with_files(
    graph: &Graph,
    step: &GraphStep,
    items: &BTreeMap<usize, usize>,
    fields: &[Field],
    sight: &Sight,
) -> Result<StepParams, Vec<Diagnostic>> {
    let with = fill(graph, step, items)?;
    match check_filled(step, &with) {
        Ok(mut params) => {
            let faults = find_files(graph, step, fields, &mut params, sight);
            if faults.is_empty() { Ok(params) } else { Err(faults) }
        }
        Err(mut faults) => {
            let mut as_written = StepParams::of(with, false);
            let missing = find_files(graph, step, fields, &mut as_written, sight);
            let new = missing.into_iter().filter(|fault| faults.iter().all(|known| known.span != fault.span));
            let new: Vec<_> = new.collect();
            faults.extend(new);
            Err(faults)
        }
    }
}

/// What is wrong with those parameters of a step that mention no axis whose items another step has yet to make: unknown keys, and values that
/// are no good whatever the others are. Parameters are not held against each other.
pub fn check_known(graph: &Graph, step: &GraphStep, items: &BTreeMap<usize, usize>) -> Vec<Diagnostic> {
    /// A key that no stage has: with it reading fails, before parameters are held against each other.
    const NO_KEY: &str = "\0";
    let Some(entries) = step.with.as_deref().and_then(Node::entries) else { return Vec::new() };
    let mut given = serde_json::Map::from_iter([(NO_KEY.to_owned(), Value::Null)]);
    let mut pending = vec![NO_KEY];
    for (key, node) in entries {
        match filled(node, &|name| lookup(graph, items, name)) {
            Ok(value) => drop(given.insert(key.name.clone(), value)),
            Err(_) => pending.push(&key.name),
        }
    }
    let with = Value::Object(given);
    let place = Place { step: &step.name, stage: step.stage, with: step.with.as_deref(), span: step.span };
    let faults = step.stage.check(&with).err().unwrap_or_default();
    let is_known = |fault: &&Fault| fault.path.first().is_some_and(|key| !pending.contains(&key.as_str()));
    faults.iter().filter(is_known).map(|fault| told(&place, &with, fault)).collect()
}

pub(super) fn fill(graph: &Graph, step: &GraphStep, items: &BTreeMap<usize, usize>) -> Result<Value, Vec<Diagnostic>> {
    let Some(with) = &step.with else { return Ok(Value::Null) };
    filled(with, &|name| lookup(graph, items, name)).map_err(|mut faults| {
        // What is said of the columns says more than that a name stands for nothing.
        let strange = strange_columns(graph, step, with, items);
        faults.retain(|fault| strange.iter().all(|told| told.span != fault.span));
        faults.extend(strange);
        faults
    })
}

/// Mentions of what the items of an axis turn out not to have.
fn strange_columns(graph: &Graph, step: &GraphStep, with: &Node, items: &BTreeMap<usize, usize>) -> Vec<Diagnostic> {
    let mut names = Vec::new();
    mentioned(with, &mut names);
    let strange = names.into_iter().filter(|(name, _)| lookup(graph, items, name).is_none());
    let told = |(name, span): (String, Span)| {
        let (base, column) = name.split_once('.')?;
        let axis = graph.axes.iter().position(|axis| axis.name.text == base)?;
        let value = graph.axes[axis].values.get(*items.get(&axis)?)?;
        let Some(columns) = value.as_object() else {
            let message = format!("step `{}`: an item of axis `{base}` is a single value", step.name);
            return Some(Diagnostic::at(span, message).hint(format!("write ${{{base}}}")));
        };
        let known: Vec<&str> = columns.keys().map(String::as_str).collect();
        let columns = format!("the table behind it has {}", known.join(", "));
        let message = format!("step `{}`: `${{{name}}}`: axis `{base}` has no column `{column}`; {columns}", step.name);
        let near = nearest(column, &known).map(|near| format!("did you mean `${{{base}.{near}}}`?"));
        Some(near.into_iter().fold(Diagnostic::at(span, message), Diagnostic::hint))
    };
    strange.filter_map(told).collect()
}

fn check_filled(step: &GraphStep, with: &Value) -> Result<StepParams, Vec<Diagnostic>> {
    let place = Place { step: &step.name, stage: step.stage, with: step.with.as_deref(), span: step.span };
    let checked = step
        .stage
        .check(with)
        .map_err(|faults| faults.into_iter().map(|fault| told(&place, with, &fault)).collect::<Vec<_>>())?;
    Ok(StepParams::of(checked.canonical, checked.draws))
}

/// Where the parameters of a step stand.
pub struct Place<'a> {
    /// The name of the step.
    pub step: &'a str,
    /// The stage it uses.
    pub stage: &'a dyn AnyStage,
    /// Its parameters as written.
    pub with: Option<&'a Node>,
    /// Where its name stands.
    pub span: Span,
}

/// What a stage finds wrong with parameters, with its place in the text.
pub fn told(place: &Place, with: &Value, fault: &Fault) -> Diagnostic {
    let at = place.with.map_or(place.span, |node| node.locate(&fault.path, fault.at_key));
    let silent = fault.path.is_empty() || fault.at_key;
    let about = if silent { String::new() } else { format!("`{}`: ", fault.path.join(".")) };
    let message = format!("step `{}` ({}): {about}{}", place.step, place.stage.name(), fault.message);
    let written = fault.path.last().map_or_else(String::new, Clone::clone);
    let given = if fault.at_key { written } else { value_at(with, &fault.path) };
    let is_digits = fault.at_key && !given.is_empty() && given.bytes().all(|byte| byte.is_ascii_digit());
    let wants_number = fault.known.is_empty();
    let hint = if fault.at_key { odd_space(&given) } else { as_number(&given).filter(|_| wants_number) };
    let fault = match hint {
        // `{cell_m: 0,05}` is read as `{cell_m: 0, 05: }`.
        _ if is_digits => {
            Diagnostic::at(at, message).hint("numbers are written with a point: a comma begins the next entry")
        }
        Some(hint) => Diagnostic::at(at, message).hint(hint),
        None => Diagnostic::at(at, message).suggest(&given, fault.known.iter().map(String::as_str)),
    };
    // What a use gives stands beside the use; the step that it does not fit stands in the part.
    let is_given = place.step.contains(INSIDE) && at.source != place.span.source;
    if is_given { fault.also(place.span, format!("step `{}` stands here", place.step)) } else { fault }
}

/// Finds and hashes every file the parameters name, and puts the digests into the recipe's parameters; `fields` are those of
/// the stage.
fn find_files(
    graph: &Graph,
    step: &GraphStep,
    fields: &[Field],
    params: &mut StepParams,
    sight: &Sight,
) -> Vec<Diagnostic> {
    let mut finder = Finder { graph, step, sight, files: BTreeMap::new(), faults: Vec::new(), path: Vec::new() };
    if fields.iter().any(|field| names_files(&field.kind)) {
        params.recipe = Arc::new(finder.fields(fields, &params.canonical));
        params.files = finder.files;
    }
    finder.faults
}

/// Whether a parameter of this shape can name files.
fn names_files(kind: &Kind) -> bool {
    match kind {
        Kind::File | Kind::GeoFile | Kind::Files => true,
        Kind::List(inner, _) | Kind::Optional(inner) | Kind::Entries(inner) | Kind::NumberOr(inner) => {
            names_files(inner)
        }
        Kind::Map(fields) | Kind::Union(fields) => fields.iter().any(|field| names_files(&field.kind)),
        Kind::Number | Kind::Integer | Kind::Boolean | Kind::Text | Kind::Choice(_) | Kind::Any => false,
    }
}

struct Finder<'a> {
    graph: &'a Graph,
    step: &'a GraphStep,
    sight: &'a Sight<'a>,
    files: BTreeMap<String, Vec<InputFile>>,
    faults: Vec<Diagnostic>,
    path: Vec<String>,
}

impl Finder<'_> {
    fn fields(&mut self, fields: &[Field], value: &Value) -> Value {
        let Value::Object(map) = value else { return value.clone() };
        let entries = map.iter().map(|(key, value)| {
            let kind = fields.iter().find(|field| field.name == key).map(|field| &field.kind);
            self.path.push(key.clone());
            let found = kind.map_or_else(|| value.clone(), |kind| self.value(kind, value));
            self.path.pop();
            (key.clone(), found)
        });
        Value::Object(entries.collect())
    }

    fn value(&mut self, kind: &Kind, value: &Value) -> Value {
        match (kind, value) {
            (Kind::Optional(inner), value) if !value.is_null() => self.value(inner, value),
            (Kind::List(inner, _), Value::Array(items)) => items.iter().map(|item| self.value(inner, item)).collect(),
            (Kind::Entries(inner), Value::Object(map)) => {
                let entries = map.iter().map(|(key, value)| {
                    self.path.push(key.clone());
                    let found = self.value(inner, value);
                    self.path.pop();
                    (key.clone(), found)
                });
                Value::Object(entries.collect())
            }
            (Kind::Map(fields) | Kind::Union(fields), value) => self.fields(fields, value),
            (Kind::NumberOr(inner), value) => self.value(inner, value),
            (Kind::File, Value::String(written)) => {
                let files = self.find(written, false);
                files.first().map_or(Value::Null, |file| json!({ "blake3": file.digest }))
            }
            (Kind::GeoFile, Value::String(written)) => {
                let mut files = self.find(written, false);
                if let Some(system) = files.first().and_then(|file| self.beside(&file.path)) {
                    files.push(system);
                    self.files.insert(written.clone(), files.clone());
                }
                match files.as_slice() {
                    [file, system] => json!({ "blake3": file.digest, "prj": system.digest }),
                    files => files.first().map_or(Value::Null, |file| json!({ "blake3": file.digest })),
                }
            }
            (Kind::Files, Value::String(written)) => self
                .find(written, true)
                .iter()
                .map(|file| json!({ "name": file.name, "blake3": file.digest }))
                .collect(),
            _ => value.clone(),
        }
    }

    fn find(&mut self, written: &str, many: bool) -> Vec<InputFile> {
        let path = self.step.base.path(written);
        let listed = match written.trim() {
            "" => Err("a path is needed, and this one is empty".to_owned()),
            _ if many => self.sight.list(&path).map(side_files::left_out),
            _ => one_file(&path).or_else(|why| self.former(&path).map(|_| vec![path.clone()]).ok_or(why)),
        };
        let checked =
            |paths: Vec<PathBuf>| paths.iter().try_for_each(|path| side_files::check(path, self.sight)).map(|()| paths);
        let hashed = listed
            .and_then(checked)
            .and_then(|paths| paths.into_iter().map(|path| self.hashed(path)).collect::<Result<Vec<_>, _>>());
        match hashed {
            Ok(files) => {
                self.files.insert(written.to_owned(), files.clone());
                files
            }
            Err(message) => {
                let span = self.step.with.as_ref().map_or(self.step.span, |with| with.locate(&self.path, false));
                let fault = Missing { graph: self.graph, step: self.step, parameter: &self.path, written, path: &path }
                    .fault(span, &format!("step `{}`: {message}", self.step.name));
                self.faults.push(self.with_parameter(fault, written));
                Vec::new()
            }
        }
    }

    /// Adds to the fault of a path how to give another, where a parameter says how the path begins.
    fn with_parameter(&self, mut fault: Diagnostic, written: &str) -> Diagnostic {
        let begins =
            |value: &Value| value.as_str().is_some_and(|text| Path::new(written).starts_with(text) && !text.is_empty());
        let found = self.graph.params.iter().filter(|(_, value)| begins(value));
        if let Some((name, _)) = found.max_by_key(|(_, value)| value.as_str().map_or(0, str::len)) {
            let given = format!("`--set params.{name}=...` gives another path");
            fault.hint = Some(fault.hint.map_or_else(|| given.clone(), |hint| format!("{hint}; {given}")));
        }
        fault
    }

    /// The `.prj` of the same name beside a file; one that cannot be read, or is too long to be one, is a fault.
    fn beside(&mut self, file: &Path) -> Option<InputFile> {
        let paths = ["prj", "PRJ"].map(|extension| file.with_extension(extension));
        let path = paths.into_iter().find(|path| self.sight.is_file(path) || self.former(path).is_some())?;
        // Before it is hashed: what has the name may be of any size.
        let most = SYSTEM_FILE_BYTES;
        let hashed = match std::fs::metadata(&path) {
            Ok(found) if found.len() > most => Err(too_long(&format!("`{}`, a `.prj`,", path.display()), most)),
            _ => self.hashed(path),
        };
        match hashed {
            Ok(system) => Some(system),
            Err(message) => {
                let span = self.step.with.as_ref().map_or(self.step.span, |with| with.locate(&self.path, false));
                self.faults.push(Diagnostic::at(span, format!("step `{}`: {message}", self.step.name)));
                None
            }
        }
    }

    fn hashed(&self, path: PathBuf) -> Result<InputFile, String> {
        let name = path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        if let Some((digest, run)) = self.former(&path) {
            return Ok(InputFile { name, path, digest, gone_since: Some(run) });
        }
        let digest = self.sight.hash(&path)?;
        Ok(InputFile { name, path, digest, gone_since: None })
    }

    /// What stands for a file that is gone, if it is to.
    fn former(&self, path: &Path) -> Option<(Digest, String)> {
        self.graph.former.as_ref()?.in_place_of(path)
    }
}

pub(super) fn value_at(value: &Value, path: &[String]) -> String {
    let found = path.iter().try_fold(value, |value, key| match value {
        Value::Array(items) => items.get(key.parse::<usize>().ok()?),
        other => other.get(key),
    });
    found.and_then(Value::as_str).unwrap_or_default().to_owned()
}
