//! `include: other.yaml`: pipelines put together from several files, every value with its place in its own file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use rockface_cache::{Digest, Seen};

use super::base::without_detours;
use super::file_text::read_text;
use super::node::{Data, Key, Node};
use super::reader::TOP;
use crate::diagnostic::{Diagnostic, Source, Span};

/// How deep included files may be nested.
const INCLUDES_DEEP: usize = 100;

/// The texts of a pipeline, and what others are read from.
#[derive(Debug, Clone, Default)]
pub struct Texts {
    /// The pipeline file first, then what it includes, then each override, then parts.
    pub sources: Vec<Source>,
    /// Texts that stand for files, by absolute path: those of a past run that is repeated.
    pub given: BTreeMap<PathBuf, String>,
    /// Where the trees of long texts are kept.
    pub trees: Option<PathBuf>,
    /// What was read from included files and parts.
    pub looks: Vec<(PathBuf, Seen)>,
}

impl Texts {
    /// The folder of the file that a place stands in; that of the pipeline for what no file holds.
    pub fn folder(&self, span: Span) -> Arc<Path> {
        let own = self.sources.get(span.source).and_then(Source::folder);
        own.or_else(|| self.sources.first().and_then(Source::folder)).cloned().unwrap_or_else(|| Path::new(".").into())
    }

    /// The text of a file that a pipeline names.
    pub fn read(&mut self, path: &Path) -> Result<String, Diagnostic> {
        // As it is written before its plain form: a `..` may go back over a link.
        let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
        let given = self.given.get(&absolute).or_else(|| self.given.get(&without_detours(&absolute)));
        if let Some(given) = given {
            return Ok(given.clone());
        }
        let text = read_text(path)?;
        self.looks.push((path.to_owned(), Seen::File(Digest::of(text.as_bytes()))));
        Ok(text)
    }
}

/// Puts what a tree includes into it; `trail` are the files that led here, this one last.
///
/// Axes, parameters and steps are put together, a name in two files is a fault. Name, seed and targets of an included
/// file count where the including file has none of its own. A file that is included by two ways is taken once.
pub fn expand(root: &mut Node, trail: &mut Vec<PathBuf>, texts: &mut Texts, faults: &mut Vec<Diagnostic>) {
    let mut seen = trail.clone();
    expand_seen(root, trail, &mut seen, texts, faults);
}

fn expand_seen(
    root: &mut Node,
    trail: &mut Vec<PathBuf>,
    seen: &mut Vec<PathBuf>,
    texts: &mut Texts,
    faults: &mut Vec<Diagnostic>,
) {
    let Some(named) = root.get("include").cloned() else { return };
    let own: Vec<String> = root.entries().unwrap_or_default().iter().map(|(key, _)| key.name.clone()).collect();
    let files = match &named.data {
        Data::List(files) => files.as_slice(),
        Data::Scalar(_) | Data::Map(_) => std::slice::from_ref(&named),
    };
    for file in files {
        let folder = texts.folder(root.span);
        match included(file, &folder, trail, seen, texts) {
            Ok(Some((mut tree, path))) => {
                trail.push(path);
                expand_seen(&mut tree, trail, seen, texts, faults);
                trail.pop();
                merge(root, tree, &own, texts, faults);
            }
            Ok(None) => {}
            Err(fault) => faults.push(fault),
        }
    }
}

/// The tree of an included file and its one true path; `None` for one that is in already.
fn included(
    node: &Node,
    folder: &Path,
    trail: &[PathBuf],
    seen: &mut Vec<PathBuf>,
    texts: &mut Texts,
) -> Result<Option<(Node, PathBuf)>, Diagnostic> {
    let Some(written) = node.text() else {
        return Err(Diagnostic::at(node.span, format!("expected the path of a pipeline, found {}", node.describe())));
    };
    let path = folder.join(written);
    let text = texts.read(&path).map_err(|fault| Diagnostic { span: Some(node.span), ..fault })?;
    let canonical = path.canonicalize().unwrap_or_else(|_| path.clone());
    if trail.contains(&canonical) {
        let message = format!("`{written}` includes this file in turn");
        return Err(Diagnostic::at(node.span, message).hint("put what both need into a third file"));
    }
    if trail.len() > INCLUDES_DEEP {
        let message = format!("`{written}` is included by way of {} files, one in the other", trail.len());
        return Err(Diagnostic::at(node.span, message).hint(format!("at most {INCLUDES_DEEP} files may be nested")));
    }
    if seen.contains(&canonical) {
        return Ok(None);
    }
    seen.push(canonical.clone());
    let source = texts.sources.len();
    texts.sources.push(Source::file(path.display().to_string(), &text, path.parent().unwrap_or(Path::new(""))));
    let tree = super::tree_file::parse(&text, source, texts.trees.as_deref())?;
    check_format(&tree)?;
    Ok(Some((tree, canonical)))
}

/// Whether a file that another names is of this format.
pub fn check_format(tree: &Node) -> Result<(), Diagnostic> {
    let top = |end: usize| Span { source: tree.span.source, start: tree.span.start, end };
    match tree.get("rockface").map(|node| (node.to_value().as_u64(), node.span)) {
        Some((Some(1), _)) => Ok(()),
        Some((_, span)) => Err(Diagnostic::at(span, "the included file is of another pipeline format")
            .hint("this version reads `rockface: 1`")),
        None => Err(Diagnostic::at(top(tree.span.start), "the included file does not say its format version")
            .hint("begin the file with `rockface: 1`")),
    }
}

fn merge(root: &mut Node, tree: Node, own: &[String], texts: &Texts, faults: &mut Vec<Diagnostic>) {
    let (Data::Map(entries), Data::Map(others)) = (&mut root.data, tree.data) else { return };
    for (key, value) in others {
        let known = entries.iter_mut().find(|(known, _)| known.name == key.name);
        match (key.name.as_str(), known) {
            ("rockface" | "include", _) => {}
            (_, None) => entries.push((key, value)),
            ("params" | "axes" | "steps" | "parts", Some((known, section))) => {
                merge_section(&known.name, section, value, texts, faults);
            }
            ("zip", Some((_, groups))) => append_groups(groups, &value),
            (name, Some(_)) if own.iter().any(|own| own == name) && TOP.contains(&name) => {}
            (name, Some((_, former))) if former.to_value() != value.to_value() => {
                let message = format!("two included files give `{name}` differently");
                let hint = "give it in the including file too, which decides";
                faults.push(Diagnostic::at(key.span, message).hint(hint));
            }
            _ => {}
        }
    }
}

fn merge_section(name: &str, section: &mut Node, other: Node, texts: &Texts, faults: &mut Vec<Diagnostic>) {
    let what = name.trim_end_matches('s').replace("axe", "axis").replace("param", "parameter");
    let span = other.span;
    let (Data::Map(entries), Data::Map(others)) = (&mut section.data, other.data) else {
        faults.push(Diagnostic::at(span, format!("`{name}` has to be a map in every file")));
        return;
    };
    let known: BTreeMap<String, Key> = entries.iter().map(|(key, _)| (key.name.clone(), key.clone())).collect();
    for (key, value) in others {
        match known.get(&key.name) {
            Some(known) => faults.push(twice(&what, &key, known, texts)),
            None => entries.push((key, value)),
        }
    }
}

fn twice(what: &str, key: &Key, known: &Key, texts: &Texts) -> Diagnostic {
    let file = texts.sources.get(known.span.source).map_or("another file", |source| source.name.as_str());
    Diagnostic::at(key.span, format!("{what} `{}` is declared in `{file}` too", key.name)).hint("rename one of the two")
}

/// Groups of both files, as a list of lists.
fn append_groups(groups: &mut Node, other: &Node) {
    let lists = |node: &Node| match &node.data {
        Data::List(items) if items.iter().all(|item| matches!(item.data, Data::List(_))) => items.clone(),
        _ => vec![node.clone()],
    };
    let all = lists(groups).into_iter().chain(lists(other)).collect();
    groups.data = Data::List(all);
}
