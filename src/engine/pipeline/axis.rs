//! Axes as they are declared: listed items, a count, swept values, a drawn sample, or the items of an artefact.

use std::sync::Arc;

use serde_json::{Map, Value};

use super::design::{Design, Scale, Spread, points};
use super::node::{Data, Key, Node, Word};
use super::reader::Reader;
use super::reference::Reference;
use crate::diagnostic::Diagnostic;

/// A named list over which steps fan out.
#[derive(Debug, Clone)]
pub struct Axis {
    /// Its name; that of an axis of a part begins with the name of the use: `before/replicate`.
    pub name: Word,
    /// What it is called in points, tables and seed material: its name in the part that declares it.
    pub label: String,
    /// Item names, unique, in order; empty as long as they are not known.
    pub items: Vec<String>,
    /// What `${axis}` stands for at each item; a map where an item has several values, each `${axis.name}`.
    pub values: Arc<[Value]>,
    /// The names of the values of an item, where it has several and they are declared.
    pub fields: Vec<String>,
    /// Whether its items enter the seed of a random stream.
    pub reseeds: bool,
    /// The output its items are taken from.
    pub from: Option<Reference>,
    /// Whether parameters say its items: choosing by it may name items that it has for other values of theirs.
    pub by_parameters: bool,
}

/// The item that no axis can have: `[axis=prev]` is the item before.
pub const PREV: &str = "prev";

/// The keys of an axis.
pub const KEYS: &[&str] = &["items", "count", "values", "sample", "over", "from", "reseeds"];

/// The most items of a counted or drawn axis.
const ITEMS_LIMIT: u64 = 1_000_000;

/// The most items and values of all counted and drawn axes together: a few lines must not fill the memory.
const DRAWN_LIMIT: u64 = 10_000_000;

/// Why a text cannot be an item.
pub fn bad_item(item: &str) -> Option<String> {
    if item.is_empty() || item.contains(['/', '\\', ',', '=', '[', ']']) || item.contains(char::is_control) {
        let item = item.escape_debug();
        Some(format!(
            "`{item}` cannot be an item: an item is not empty and has none of / \\ , = [ ] and no control characters"
        ))
    } else if item == PREV {
        Some("`prev` cannot be an item: `[axis=prev]` means the item before".to_owned())
    } else {
        None
    }
}

impl Reader<'_> {
    /// Reads the declaration of one axis; `None` where it is at fault, which is reported.
    pub fn axis(&mut self, name: Word, node: &Node) -> Option<Axis> {
        const FORMS: [&str; 5] = ["items", "count", "values", "sample", "from"];
        let what = format!("axis `{}`", name.text);
        let sampled = node.get("sample").is_some();
        let known: &[&str] = if sampled {
            &["sample", "count", "over", "reseeds"]
        } else {
            &["items", "count", "values", "sample", "from", "reseeds"]
        };
        if let Data::List(_) = node.data {
            let message = format!("{what} is a list; a key says what the list is");
            let hint = format!("write `{}: {{items: [...]}}`, or `values:` for numbers to sweep", name.text);
            self.fault(Diagnostic::at(node.span, message).hint(hint));
            return None;
        }
        self.map(node, &what, known)?;
        self.check_keys(node).then_some(())?;
        let given: Vec<_> = FORMS.iter().filter_map(|form| node.get(form).map(|n| (*form, n))).collect();
        let [(form, list)] = given.iter().filter(|(form, _)| !sampled || *form == "sample").collect::<Vec<_>>()[..]
        else {
            let message = format!("{what} needs exactly one of `items`, `count`, `values`, `sample` and `from`");
            self.fault(
                Diagnostic::at(name.span, message).hint(
                    "for example `items: [pre, post]`, `count: 50`, `values: [0.6, 0.8]` or `from: survey.cameras`",
                ),
            );
            return None;
        };
        let reseeds = self.flag(node.get("reseeds"), !matches!(*form, "values" | "sample"));
        let label = name.text.clone();
        let empty = Axis {
            name,
            label,
            items: Vec::new(),
            values: Arc::default(),
            fields: Vec::new(),
            reseeds,
            from: None,
            by_parameters: false,
        };
        match *form {
            "count" => self.count(list).map(|(items, values)| Axis { items, values: values.into(), ..empty }),
            "sample" => self.sample(node, list, empty),
            "from" => Some(Axis { from: Some(self.reference(list)?), ..empty }),
            _ => self.items(list, &empty.name).map(|(items, values)| Axis { items, values: values.into(), ..empty }),
        }
    }

    /// Groups of axes: `[a, b]`, or a list of such lists.
    pub fn zips(&mut self, node: &Node) -> Vec<Vec<Word>> {
        let groups: Vec<Vec<Word>> = match &node.data {
            Data::List(lists) if lists.iter().all(|list| matches!(list.data, Data::List(_))) => {
                lists.iter().map(|list| self.some_words(list, "an axis")).collect()
            }
            _ => vec![self.some_words(node, "an axis")],
        };
        if groups.iter().any(|group| group.len() == 1) {
            let fault = Diagnostic::at(node.span, "one axis alone cannot be zipped");
            self.fault(fault.hint("name the axes that are walked together: `zip: [a, b]`"));
        }
        groups
    }

    fn count(&mut self, node: &Node) -> Option<(Vec<String>, Vec<Value>)> {
        let count = self.whole(node)?;
        self.is_within(node, count).then_some(())?;
        Some(((0..count).map(|i| i.to_string()).collect(), (0..count).map(Value::from).collect()))
    }

    /// Whether so many more items or values are not too many.
    fn is_within(&mut self, node: &Node, more: u64) -> bool {
        self.drawn = self.drawn.saturating_add(more);
        let is_within = self.drawn <= DRAWN_LIMIT;
        if !is_within {
            let message = format!("with this axis there are {} items and values of counted and drawn axes", self.drawn);
            let hint = format!("there may be {DRAWN_LIMIT} in all: lower a count, or divide the pipeline");
            self.fault(Diagnostic::at(node.span, message).hint(hint));
        }
        is_within
    }

    fn whole(&mut self, node: &Node) -> Option<u64> {
        let count = if let Data::Scalar(value) = &node.data { value.as_u64() } else { None };
        let count = count.filter(|count| (1..=ITEMS_LIMIT).contains(count));
        if count.is_none() {
            self.expected(node, &format!("a count from 1 to {ITEMS_LIMIT}"));
        }
        count
    }

    fn items(&mut self, node: &Node, axis: &Word) -> Option<(Vec<String>, Vec<Value>)> {
        let Data::List(list) = &node.data else {
            self.expected(node, "a list");
            return None;
        };
        if list.is_empty() {
            self.fault(Diagnostic::at(node.span, format!("axis `{}` has no items", axis.text)));
            return None;
        }
        let mut items: Vec<String> = Vec::with_capacity(list.len());
        let mut sound: Vec<&Node> = Vec::with_capacity(list.len());
        let mut seen = std::collections::BTreeSet::new();
        for node in list {
            let Some(item) = self.word(node, "a name, a number or true/false") else { continue };
            let item = item.text;
            let twice = || format!("`{item}` occurs twice on axis `{}`", axis.text);
            if let Some(bad) = bad_item(&item).or_else(|| seen.contains(&item).then(twice)) {
                self.fault(Diagnostic::at(node.span, bad));
                continue;
            }
            seen.insert(item.clone());
            items.push(item);
            sound.push(node);
        }
        let values: Vec<Value> = sound.iter().map(|node| node.to_value()).collect();
        self.check_equal_numbers(&sound, &values, axis);
        (items.len() == list.len()).then_some((items, values))
    }

    /// One number written in two ways would be one point with two names.
    fn check_equal_numbers(&mut self, list: &[&Node], values: &[Value], axis: &Word) {
        let mut numbers: Vec<(f64, usize)> =
            values.iter().enumerate().filter_map(|(index, value)| Some((value.as_f64()? + 0.0, index))).collect();
        numbers.sort_by(|one, other| one.0.total_cmp(&other.0).then(one.1.cmp(&other.1)));
        for pair in numbers.windows(2) {
            let ((number, twin), (next, index)) = (pair[0], pair[1]);
            if number.total_cmp(&next).is_eq() {
                let (here, there) = (&list[index].written, &list[twin].written);
                let message = format!("`{here}` is the same number as `{there}` on axis `{}`", axis.text);
                self.fault(Diagnostic::at(list[index].span, message).hint("leave one out, or put both in quotes"));
            }
        }
    }

    fn sample(&mut self, node: &Node, form: &Node, empty: Axis) -> Option<Axis> {
        let word = self.word(form, "grid, random, latin-hypercube or sobol")?;
        let Some(design) = Design::named(&word.text) else {
            let fault = Diagnostic::at(word.span, format!("unknown design `{}`", word.text));
            self.fault(fault.suggest(&word.text, Design::NAMES));
            return None;
        };
        for missing in ["count", "over"].into_iter().filter(|key| node.get(key).is_none()) {
            let fault = Diagnostic::at(empty.name.span, format!("axis `{}` has no `{missing}`", empty.name.text));
            self.fault(fault.hint("for example {sample: sobol, count: 64, over: {a_m: [0.1, 2.0]}}"));
        }
        let over = node.get("over").and_then(|over| self.any_map(over, "`over`"));
        let spreads: Option<Vec<_>> =
            over.map(|over| over.iter().map(|(key, node)| self.spread(key, node)).collect::<Vec<_>>());
        let counts = node.get("count").and_then(|count| self.counts(count));
        let (spreads, counts) = (spreads?.into_iter().collect::<Option<Vec<_>>>()?, counts?);
        let total =
            if counts.len() == 1 { counts[0] } else { counts.iter().fold(1, |all, n| u64::saturating_mul(all, *n)) };
        let values = total.saturating_mul(1 + spreads.len() as u64);
        self.is_within(node.get("count")?, values).then_some(())?;
        match points(design, &counts, &spreads, self.seed, &empty.name.text) {
            Ok(drawn) => {
                let fields: Vec<String> = spreads.iter().map(|spread| spread.name.clone()).collect();
                let value = |point: Vec<Value>| Value::Object(fields.iter().cloned().zip(point).collect::<Map<_, _>>());
                // A point is released as soon as its map is made: there may be millions.
                let (items, values): (Vec<String>, Vec<Value>) =
                    drawn.into_iter().map(|(item, point)| (item, value(point))).unzip();
                Some(Axis { items, values: values.into(), fields, ..empty })
            }
            Err(message) => {
                self.fault(Diagnostic::at(node.get("count")?.span, message));
                None
            }
        }
    }

    fn counts(&mut self, node: &Node) -> Option<Vec<u64>> {
        match &node.data {
            Data::List(list) => {
                let counts: Vec<_> = list.iter().map(|node| self.whole(node)).collect();
                counts.into_iter().collect()
            }
            _ => self.whole(node).map(|count| vec![count]),
        }
    }

    /// `[lo, hi]`, `{log: [lo, hi]}` or `{whole: [lo, hi]}`.
    fn spread(&mut self, key: &Key, node: &Node) -> Option<Spread> {
        let (scale, range) = match node.entries() {
            None => (Scale::Linear, node),
            Some([(key, range)]) if key.name == "log" => (Scale::Log, range),
            Some([(key, range)]) if key.name == "whole" => (Scale::Whole, range),
            Some(_) => {
                self.expected(node, "[lowest, highest], {log: [lowest, highest]} or {whole: [lowest, highest]}");
                return None;
            }
        };
        let numbers: Vec<f64> = match &range.data {
            Data::List(ends) => ends.iter().filter_map(|end| end.to_value().as_f64()).collect(),
            Data::Scalar(_) | Data::Map(_) => Vec::new(),
        };
        let [lo, hi] = numbers[..] else {
            self.expected(range, "[lowest, highest]");
            return None;
        };
        let spread = Spread { name: key.name.clone(), scale, lo, hi };
        if let Some(bad) = spread.fault() {
            self.fault(Diagnostic::at(range.span, format!("`{}`: {bad}", key.name)));
            return None;
        }
        Some(spread)
    }
}
