//! `--set PATH=VALUE`: values given from outside, merged into the tree before anything is read from it.

use std::collections::BTreeSet;

use super::node::{Data, Key, Node};
use super::parameter::{comment_after, is_declared, is_text, text_as_written};
use super::part::INSIDE;
use super::reader::TOP;
use super::substitute::mentioned;
use super::sweep::{keep_reseeding, plain_path};
use crate::diagnostic::{Diagnostic, Source, Span, nearest};

/// The most keys of a path: nothing in a pipeline is nested deeper.
const KEYS_LIMIT: usize = 64;

/// What the files say, of which values of the command line may take the place.
#[derive(Debug, Clone, Default)]
pub struct Written {
    /// Names that parameters, axes and the `with` of steps mention.
    pub mentions: BTreeSet<String>,
    /// Declared parameters for which `null` is no value: it is not their default.
    pub needed: BTreeSet<String>,
}

impl Written {
    /// What a tree says before anything is put into it.
    pub fn of(root: &Node) -> Self {
        let section = |name: &str| root.get(name).and_then(Node::entries).unwrap_or_default();
        let mut names = Vec::new();
        section("params").iter().chain(section("axes")).for_each(|(_, node)| mentioned(node, &mut names));
        section("steps").iter().filter_map(|(_, node)| node.get("with")).for_each(|with| mentioned(with, &mut names));
        let is_null = |node: &Node| node.to_value().is_null() && node.bad_number().is_none();
        let needed = section("params").iter().filter(|(_, node)| is_declared(node));
        let needed = needed.filter(|(_, node)| !node.get("default").is_some_and(is_null));
        Self {
            mentions: names.into_iter().map(|(name, _)| name).collect(),
            needed: needed.map(|(key, _)| key.name.clone()).collect(),
        }
    }
}

/// A value for a step or an axis that a part makes: it is put there once the part has been written out.
#[derive(Debug, Clone)]
pub struct Late {
    /// The path of keys that was given.
    pub keys: Vec<String>,
    /// The value to put there.
    pub value: Node,
    /// Where the path stands.
    pub span: Span,
    /// Whether the value is an axis of swept values, which reseeds where the axis does whose place it takes.
    pub is_swept: bool,
}

impl Late {
    /// The value, if its path leads into a step or axis that a part makes: such names have a `/`.
    fn of(keys: &[&str], value: Node, span: Span) -> Result<Self, Node> {
        match keys {
            ["steps", name, _, ..] | ["axes", name, ..] if name.contains(INSIDE) => {
                Ok(Self { keys: keys.iter().map(ToString::to_string).collect(), value, span, is_swept: false })
            }
            _ => Err(value),
        }
    }

    /// Puts it into a section's entry of a name, if it is meant for that; says whether it is.
    pub fn put_into(&self, section: &str, name: &str, entry: &mut Node) -> Result<bool, Diagnostic> {
        let [own_section, own_name, rest @ ..] = self.keys.as_slice() else { return Ok(false) };
        if own_section != section || own_name != name {
            return Ok(false);
        }
        let rest: Vec<&str> = rest.iter().map(String::as_str).collect();
        let mut value = self.value.clone();
        if self.is_swept {
            keep_reseeding(&mut value, Some(entry), self.span);
        }
        put(entry, &rest, value, self.span).map(|()| true)
    }
}

/// Merges one override into the tree, or hands it back where it is for what a part makes; its text becomes one of the
/// `sources`.
pub fn apply(root: &mut Node, text: &str, sources: &mut Vec<Source>) -> Result<Option<Late>, Diagnostic> {
    let source = sources.len();
    sources.push(Source::given("--set", text));
    let here = |from: usize, to: usize| Span { source, start: from, end: to };
    let Some((path, value)) = text.split_once('=') else {
        return Err(Diagnostic::at(here(0, text.len()), "expected PATH=VALUE").hint("for example --set seed=7"));
    };
    let keys: Vec<&str> = path.split('.').map(str::trim).collect();
    if keys.iter().any(|key| key.is_empty()) {
        return Err(Diagnostic::at(here(0, path.len()), format!("`{path}` is not a path of keys")));
    }
    check_depth(&keys, here(0, path.len()))?;
    if let Some((first, rest)) = keys.split_first()
        && let Some(meant) = meant(root, first, rest)
    {
        let fault = Diagnostic::at(here(0, path.len()), format!("the pipeline has no key `{first}`"));
        return Err(fault.hint(meant));
    }
    check_once(root, &keys, value, &sources[..source], here(0, path.len()))?;
    let declared = match keys[..] {
        ["params", name] | ["params", name, "default"] => root.get("params").and_then(|own| own.get(name)),
        _ => None,
    };
    let declared = declared.filter(|node| is_declared(node));
    let node = if is_text(declared) {
        text_as_written(value, here(path.len() + 1, text.len()))
    } else {
        parsed(value, here(path.len() + 1, text.len()))?
    };
    place(root, &keys, node, here(0, path.len()))
}

/// A value of the command line, with places in the whole text of its option.
fn parsed(value: &str, place: Span) -> Result<Node, Diagnostic> {
    let mut node = Node::parse(value, place.source).map_err(|mut fault| {
        let moved = |span: Span| Span { start: span.start + place.start, end: span.end + place.start, ..span };
        fault.span = Some(fault.span.map_or(place, moved));
        fault
    })?;
    if let Some(comment) = comment_after(&node, value) {
        let fault = Diagnostic::at(place, format!("`{comment}` would be a comment, and be lost"));
        return Err(fault.hint(format!("put the value in quotes if that is part of it: '\"{}\"'", value.trim())));
    }
    shift(&mut node, place.start);
    Ok(node)
}

/// Of a path that is given twice the last value counts, but two seeds are a fault, since `--seed` has no place among `--set`; so is a value
/// that is replaced with all that is around it.
fn check_once(root: &Node, keys: &[&str], value: &str, earlier: &[Source], span: Span) -> Result<(), Diagnostic> {
    let path = keys.join(".");
    let is_typed = match keys {
        ["params", name] => root.get("params").and_then(|own| own.get(name)).is_some_and(is_declared),
        _ => false,
    };
    let mut former =
        earlier.iter().filter(|source| source.name == "--set").filter_map(|source| source.text.split_once('='));
    let contradicts = |(known, first): &(&str, &str)| {
        let known = plain_path(known);
        let is_below = known.strip_prefix(path.as_str()).is_some_and(|rest| rest.starts_with('.'));
        path == "seed" && known == path && first.trim() != value.trim() || is_below && !is_typed
    };
    let Some((known, first)) = former.find(contradicts) else { return Ok(()) };
    let fault =
        Diagnostic::at(span, format!("`{path}` is set twice: `{known}={first}` is given before", known = known.trim()));
    Err(fault.hint(if path == "seed" {
        "leave out one `--set seed=…`, or `--seed`"
    } else {
        "leave out one of the two"
    }))
}

/// Puts a value where it belongs: at its path, as the default of a parameter that is declared with its type, or, as it is
/// handed back, into what a part makes.
pub fn place(root: &mut Node, keys: &[&str], value: Node, span: Span) -> Result<Option<Late>, Diagnostic> {
    let value = match Late::of(keys, value, span) {
        Ok(late) => return Ok(Some(late)),
        Err(value) => value,
    };
    check_exists(root, keys, span)?;
    if let ["params", name] = keys
        && root.get("params").and_then(|params| params.get(name)).is_some_and(is_declared)
    {
        return put(root, &["params", name, "default"], value, span).map(|()| None);
    }
    put(root, keys, value, span).map(|()| None)
}

/// A path with more keys than any value has would only build a tree that is too deep for recursion.
pub fn check_depth(keys: &[&str], span: Span) -> Result<(), Diagnostic> {
    if keys.len() <= KEYS_LIMIT {
        return Ok(());
    }
    Err(Diagnostic::at(span, format!("this path has {} keys, and a path has at most {KEYS_LIMIT}", keys.len())))
}

/// A path into a parameter, step or axis that does not exist is a mistake: nothing would ever read it.
pub fn check_exists(root: &Node, keys: &[&str], span: Span) -> Result<(), Diagnostic> {
    let [section, name, rest @ ..] = keys else { return Ok(()) };
    let what = match (*section, rest.is_empty()) {
        ("params", _) => "parameter",
        ("steps", false) => "step",
        ("axes", false) => "axis",
        _ => return Ok(()),
    };
    let known: Vec<&str> = root
        .get(section)
        .and_then(Node::entries)
        .unwrap_or_default()
        .iter()
        .map(|(key, _)| key.name.as_str())
        .collect();
    if known.contains(name) || root.get(section).is_some_and(|node| node.entries().is_none()) {
        return Ok(());
    }
    let fault = Diagnostic::at(span, format!("the pipeline has no {what} `{name}`"));
    Err(if known.is_empty() {
        fault.hint(format!("it declares nothing under `{section}`"))
    } else {
        fault.suggest(name, known)
    })
}

/// What to write in place of a path that begins with the name of a parameter or of a step.
fn meant(root: &Node, first: &str, rest: &[&str]) -> Option<String> {
    let names = |section: &str| -> Vec<&str> {
        let entries = root.get(section).and_then(Node::entries).unwrap_or_default();
        entries.iter().map(|(key, _)| key.name.as_str()).collect()
    };
    if TOP.contains(&first) || root.get(first).is_some() {
        return None;
    }
    if rest.is_empty() {
        return nearest(first, &names("params")).map(|near| format!("did you mean `params.{near}`?"));
    }
    if !names("steps").contains(&first) {
        return None;
    }
    let below = rest.strip_prefix(&["with"]).unwrap_or(rest);
    let part = root.get("steps").and_then(|steps| steps.get(first)?.get("use")?.text());
    // Steps inside of a part are reached by what it declares only.
    let limit = part.map(|part| format!(" `rockface parts {part}` lists what can stand behind `with`."));
    Some(format!("did you mean `steps.{first}.with.{}`?{}", below.join("."), limit.unwrap_or_default()))
}

/// Puts a value where a path of keys leads, and makes the maps on the way.
pub fn put(node: &mut Node, keys: &[&str], value: Node, span: Span) -> Result<(), Diagnostic> {
    let Some((first, rest)) = keys.split_first() else {
        *node = value;
        return Ok(());
    };
    if let Data::List(items) = &mut node.data {
        let found = first.parse::<usize>().ok().and_then(|index| items.get_mut(index));
        let found = found.ok_or_else(|| Diagnostic::at(span, format!("there is no list element `{first}`")))?;
        return put(found, rest, value, span);
    }
    if matches!(&node.data, Data::Scalar(value) if value.is_null()) {
        node.data = Data::Map(Vec::new());
    }
    let Data::Map(entries) = &mut node.data else {
        return Err(Diagnostic::at(span, format!("`{first}` is below {}, which has no keys", node.describe())));
    };
    let position = entries.iter().position(|(key, _)| key.name == *first).unwrap_or_else(|| {
        let empty = Node::made(span, Data::Map(Vec::new()));
        entries.push((Key { span, name: (*first).to_owned() }, empty));
        entries.len() - 1
    });
    put(&mut entries[position].1, rest, value, span)
}

/// Moves the places of a value parsed from the part after `=` to where it stands in the whole text.
fn shift(node: &mut Node, by: usize) {
    node.span.start += by;
    node.span.end += by;
    match &mut node.data {
        Data::Scalar(_) => {}
        Data::List(items) => items.iter_mut().for_each(|item| shift(item, by)),
        Data::Map(entries) => entries.iter_mut().for_each(|(key, item)| {
            key.span.start += by;
            key.span.end += by;
            shift(item, by);
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn check(yaml: &str, set: &str, expected: &str) {
        let mut sources = vec![Source::given("p", yaml)];
        let mut root = Node::parse(yaml, 0).unwrap();
        apply(&mut root, set, &mut sources).unwrap();
        assert_eq!(root.to_value().to_string(), expected);
    }

    #[test]
    fn replaces_and_adds() {
        check("seed: 1", "seed=7", r#"{"seed":7}"#);
        check("steps: {a: {stage: b}}", "steps.a.with.x=[1, 2]", r#"{"steps":{"a":{"stage":"b","with":{"x":[1,2]}}}}"#);
        check("targets: [a, b]", "targets.1=c", r#"{"targets":["a","c"]}"#);
        check("params: {s: {type: text}}", "params.s=1e3", r#"{"params":{"s":{"default":"1e3","type":"text"}}}"#);
        check("params: {s: {type: text}}", "params.s=true", r#"{"params":{"s":{"default":"true","type":"text"}}}"#);
        check("params: {s: 2}", "params.s=1e3", r#"{"params":{"s":1000.0}}"#);
    }

    #[test]
    fn a_text_is_taken_as_it_is_written() {
        let yaml = "params: {s: {type: text, default: x}, p: {type: path}}";
        let set = |given: &str| {
            let mut root = Node::parse(yaml, 0).unwrap();
            apply(&mut root, given, &mut vec![Source::given("p", yaml)]).unwrap();
            root.get("params").unwrap().get(&given[7..8]).unwrap().get("default").unwrap().to_value()
        };
        for text in ["Face #3", "a: b", "[1]", "@a", "{x", "#1", "\"a", "\"a\" and \"b\"", "a\nb", "017", "- a"] {
            assert_eq!(set(&format!("params.s={text}")), text);
        }
        assert_eq!(set("params.p=scan #1/a: b.ply"), "scan #1/a: b.ply");
        // Quotes around the whole say where it begins and ends.
        assert_eq!(set("params.s= ' a' "), " a");
        assert_eq!(set("params.s.default=\"\""), "");
        assert!(set("params.s=").is_null() && set("params.s=~").is_null());
    }

    fn fault_of(yaml: &str, sets: &[&str]) -> Option<String> {
        let (mut root, mut sources) = (Node::parse(yaml, 0).unwrap(), vec![Source::given("p", yaml)]);
        sets.iter().find_map(|set| apply(&mut root, set, &mut sources).err()).map(|fault| fault.message)
    }

    #[test]
    fn nothing_is_lost_behind_a_number_sign() {
        let told = fault_of("steps: {a: {stage: b}}", &["steps.a.with.title=Face #3"]).unwrap();
        assert_eq!(told, "`#3` would be a comment, and be lost");
        assert!(fault_of("seed: 1", &["name=#3"]).is_some());
        assert_eq!(fault_of("seed: 1", &["name='Face #3'"]), None);
        assert_eq!(fault_of("seed: 1", &["name=Face#3"]), None);
    }

    #[test]
    fn contradicting_values_are_refused() {
        let yaml = "{params: {x: {type: number}, m: {k: 1}}, seed: 1}";
        for sets in [["seed=5", "seed=4"], ["params.m.k=1", "params.m={k: 2}"]] {
            assert!(fault_of(yaml, &sets).is_some_and(|told| told.contains("is set twice")), "{sets:?}");
        }
        for sets in [
            ["seed=5", "seed= 5"],
            ["params.x=1", " params . x =2"],
            ["params.m={k: 2}", "params.m.k=3"],
            ["params.x.max=9", "params.x=2"],
        ] {
            assert_eq!(fault_of(yaml, &sets), None, "{sets:?}");
        }
    }

    #[test]
    fn points_into_its_own_text() {
        let mut sources = Vec::new();
        let mut root = Node::parse("seed: 1", 0).unwrap();
        apply(&mut root, "seed=many", &mut sources).unwrap();
        let span = root.get("seed").unwrap().span;
        assert_eq!((span.source, &sources[0].text[span.start..span.end]), (0, "many"));
        assert!(apply(&mut root, "seed", &mut sources).is_err());
        assert!(apply(&mut root, "seed.x=1", &mut sources).is_err());
        let deep = format!("{}=1", vec!["a"; 100_000].join("."));
        assert!(apply(&mut root, &deep, &mut sources).unwrap_err().message.contains("at most 64"));
    }
}
