//! Pipelines as people write them: the YAML text, its faults, and the typed document.

mod axis;
mod base;
mod design;
mod document;
mod file_text;
mod first_words;
mod include;
mod input;
mod log_level;
mod node;
mod outline;
mod overrides;
mod parameter;
mod part;
mod reader;
mod reference;
mod sobol;
mod step;
mod substitute;
mod sweep;
mod tree_file;
mod unreadable;
mod values;

/// The keys of the language, place by place.
pub mod keys {
    pub use super::axis::KEYS as AXIS;
    pub use super::parameter::KEYS as PARAMETER;
    pub use super::part::{PART_KEYS as PART, USE_KEYS as USE};
    pub use super::reader::TOP;
    pub use super::step::STEP;
}

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub use axis::{Axis, bad_item};
pub use base::{Base, Copied, fits_pattern, without_detours};
pub use document::{Document, Unread};
pub use file_text::is_stream;
pub use input::Input;
pub use log_level::{IN_FULL, LogLevel};
pub use node::{Data, Key, Node, Word};
pub use parameter::{Declared, ValueKind, as_number, odd_space};
pub use part::{INSIDE, Interface, KindCheck, PartInput, PartText, Used};
pub use reference::{Label, Reference};
pub use step::{Gaps, Step, Stream};
pub use substitute::{escape_hint, filled, mentioned, parted, value_bytes, value_of};
pub use sweep::{is_same_axis, is_set_by, is_swept_by};

use rockface_cache::Seen;

use crate::diagnostic::{Diagnostic, Diagnostics, Origin, Source};
use file_text::read_text;
use include::Texts;

/// A pipeline that was read, with the texts its places point into.
#[derive(Debug, Clone)]
pub struct Pipeline {
    /// The pipeline file first, then what it includes, then each override, then parts, as files and use by use.
    pub sources: Vec<Source>,
    /// The folder of the pipeline file.
    pub folder: PathBuf,
    /// A copy from which input files are read; `None` if they are read where the pipeline says.
    pub copied: Option<std::sync::Arc<Copied>>,
    /// The pipeline as types: axes, steps, parameters and targets, with parts written out.
    pub document: Document,
    /// What was read from included files and parts: the bytes that were parsed.
    pub looks: Vec<(PathBuf, Seen)>,
    /// What is wrong with the shape of the document, where that leaves its names readable; [`crate::plan::resolve`] tells
    /// it together with what else is wrong, and makes no graph.
    pub faults: Vec<Diagnostic>,
}

/// What a pipeline gets from outside: values given on the command line, and the parts that come with the program.
#[derive(Debug, Clone, Default)]
pub struct Overrides {
    /// `PATH=VALUE` texts, applied in order.
    pub set: Vec<String>,
    /// `AXIS=VALUES` texts: axes of swept values that are added, or take the place of those of the pipeline.
    pub sweep: Vec<String>,
    /// Takes the place of the pipeline's seed.
    pub seed: Option<u64>,
    /// Parts that come with the program, which any pipeline may use by name.
    pub parts: &'static [PartText],
}

impl Pipeline {
    /// Reads a pipeline file and applies the overrides. The tree of a long text is kept in the folder of trees, if there is
    /// one, and taken from there as long as the text is the same.
    pub fn load(path: &Path, overrides: &Overrides, trees: Option<&Path>) -> Result<Self, Diagnostics> {
        Self::of_read(&Self::read_file(path)?, path, overrides, trees)
    }

    /// The text of a pipeline file, for [`Pipeline::of_read`].
    pub fn read_file(path: &Path) -> Result<String, Diagnostics> {
        read_text(path).map_err(|fault| Diagnostics { sources: Vec::new(), list: vec![fault] })
    }

    /// [`Pipeline::load`] with the text of the file, which is not read a second time.
    pub fn of_read(text: &str, path: &Path, overrides: &Overrides, trees: Option<&Path>) -> Result<Self, Diagnostics> {
        let texts = Texts { trees: trees.map(Path::to_owned), ..Texts::default() };
        Self::of_texts(text, texts, path, overrides)
    }

    /// Reads a text as if it were the pipeline file at `path`, and applies the overrides; `included` are texts that stand
    /// for files it includes, by their absolute paths.
    pub fn of_text(
        text: &str,
        included: BTreeMap<PathBuf, String>,
        path: &Path,
        overrides: &Overrides,
    ) -> Result<Self, Diagnostics> {
        let plain: Vec<(PathBuf, String)> =
            included.iter().map(|(path, text)| (without_detours(path), text.clone())).collect();
        let mut given = included;
        for (path, text) in plain {
            given.entry(path).or_insert(text);
        }
        Self::of_texts(text, Texts { given, ..Texts::default() }, path, overrides)
    }

    fn of_texts(text: &str, texts: Texts, path: &Path, overrides: &Overrides) -> Result<Self, Diagnostics> {
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new(".")).to_owned();
        let stem = path.file_stem().map_or_else(|| "pipeline".into(), |stem| stem.to_string_lossy().into_owned());
        let source = Source::file(path.display().to_string(), text, folder);
        Self::read(Texts { sources: vec![source], ..texts }, &stem, overrides)
    }

    /// The text of the pipeline file.
    pub fn text(&self) -> &str {
        self.sources.first().map_or("", |source| &*source.text)
    }

    /// The pipeline file, those it includes, and the parts it uses, those that come with the program among them.
    pub fn files(&self) -> impl Iterator<Item = &Source> {
        self.sources.iter().filter(|source| matches!(source.origin, Origin::File(_) | Origin::Shipped))
    }

    /// Reads a pipeline text; `name` is what messages call it, `stem` its name if the text gives none.
    pub fn parse(
        text: &str,
        name: &str,
        stem: &str,
        folder: PathBuf,
        overrides: &Overrides,
    ) -> Result<Self, Diagnostics> {
        let source = Source::file(name.to_owned(), text, folder);
        Self::read(Texts { sources: vec![source], ..Texts::default() }, stem, overrides)
    }

    /// What has to be known to use a part: one that comes with the program, or that of a file.
    pub fn part(name: &str, parts: &'static [PartText]) -> Result<Interface, Diagnostics> {
        let mut texts = Texts { sources: vec![Source::given("the name of the part", name)], ..Texts::default() };
        let mut faults = Vec::new();
        let interface = part::interface(name, &mut texts, parts, &mut faults);
        interface.filter(|_| faults.is_empty()).ok_or(Diagnostics { sources: texts.sources, list: faults })
    }

    fn read(mut texts: Texts, stem: &str, overrides: &Overrides) -> Result<Self, Diagnostics> {
        let main = &texts.sources[0];
        let folder = main.folder().map_or_else(PathBuf::new, |folder| folder.to_path_buf());
        let mut faults = Vec::new();
        let (mut document, mut whole) = (None, false);
        match tree_file::parse(&main.text.clone(), 0, texts.trees.as_deref()) {
            Ok(mut root) => {
                let own = folder.join(Path::new(&texts.sources[0].name).file_name().unwrap_or_default());
                include::expand(&mut root, &mut vec![own.canonicalize().unwrap_or(own)], &mut texts, &mut faults);
                let is_plain = overrides.set.is_empty() && overrides.sweep.is_empty();
                let written = if is_plain { overrides::Written::default() } else { overrides::Written::of(&root) };
                let seed = overrides.seed.map(|seed| format!("seed={seed}"));
                let mut late = Vec::new();
                for set in overrides.set.iter().chain(&seed) {
                    match overrides::apply(&mut root, set, &mut texts.sources) {
                        Ok(later) => late.extend(later),
                        Err(fault) => faults.push(fault),
                    }
                }
                for sweep in &overrides.sweep {
                    match sweep::apply(&mut root, sweep, &mut texts.sources) {
                        Ok(later) => late.extend(later),
                        Err(fault) => faults.push(fault),
                    }
                }
                whole = faults.is_empty();
                document = document::read(
                    &mut root,
                    stem,
                    document::Beside { texts: &mut texts, shipped: overrides.parts, written, late },
                    &mut faults,
                );
            }
            Err(fault) => faults.push(fault),
        }
        match document {
            Some(document) if whole => {
                let Texts { sources, looks, .. } = texts;
                Ok(Self { sources, folder, copied: None, document, looks, faults })
            }
            _ => Err(Diagnostics { sources: texts.sources, list: faults }),
        }
    }
}
