//! Axes and parameters that nothing uses.

use std::collections::BTreeSet;

use super::resolve::Resolver;
use crate::diagnostic::{Diagnostic, nearest};
use crate::pipeline::{Axis, Key, Node, mentioned, parted};

impl Resolver<'_> {
    /// Axes that no step depends on.
    pub fn unused_axes(&self) -> Vec<Diagnostic> {
        // An input that is missing would bring axes with it.
        if self.faults.iter().any(|fault| fault.message.contains("is not given its input")) {
            return Vec::new();
        }
        let used: BTreeSet<usize> = self.reach.iter().flatten().copied().collect();
        let unused = self.document().axes.iter().enumerate().filter(|(index, _)| !used.contains(index));
        let told = |(_, axis): (usize, &Axis)| {
            let name = &axis.name.text;
            // Who declares an axis does not mean a parameter.
            let is_swept = self.sources.get(axis.name.span.source).is_some_and(|source| source.name == "--sweep");
            let fault = Diagnostic::at(axis.name.span, format!("no step depends on axis `{name}`"));
            let fault = fault.hint(way_out(axis, is_swept));
            let near = is_swept.then(|| self.parameter_like(name)).flatten();
            let near = near.map(|path| format!("did you mean `{path}`?"));
            near.into_iter().fold(fault, Diagnostic::hint)
        };
        unused.map(told).collect()
    }

    /// The path of a value that an axis of this name may be meant to sweep.
    fn parameter_like(&self, name: &str) -> Option<String> {
        let document = self.document();
        let own = document.params.iter().map(|(key, _)| (key.name.clone(), format!("params.{}", key.name)));
        let steps = document.steps.iter().zip(&self.stages).filter_map(|(step, stage)| Some((step, (*stage)?)));
        let fields = steps.flat_map(|(step, stage)| {
            let path = move |field: &str| format!("steps.{}.with.{field}", step.name.text);
            stage.fields().into_iter().map(move |field| (field.name.to_owned(), path(field.name)))
        });
        let known: Vec<(String, String)> = own.chain(fields).collect();
        let names: Vec<&str> = known.iter().map(|(name, _)| name.as_str()).collect();
        let begins = names.iter().find(|known| known.starts_with(&format!("{name}_"))).copied();
        let near = begins.or_else(|| nearest(name, &names))?;
        known.iter().find(|(name, _)| name == near).map(|(_, path)| path.clone())
    }

    /// Whether `--set` gives a value to a parameter.
    fn is_set(&self, name: &str) -> bool {
        let paths = self.sources.iter().filter(|source| source.name == "--set");
        let mut keys = paths.map(|source| source.text.split(['.', '=']).map(str::trim));
        keys.any(|mut keys| keys.next() == Some("params") && keys.next() == Some(name))
    }

    /// Parameters that nothing mentions. Where values of the command line took the place of what mentions one, that is a fault
    /// only if it is given there too: its value would be ignored.
    pub fn unused_params(&self) -> Vec<Diagnostic> {
        let document = self.document();
        if document.params.is_empty() {
            return Vec::new();
        }
        let mut used = Vec::new();
        document.steps.iter().filter_map(|step| step.with.as_ref()).for_each(|with| mentioned(with, &mut used));
        document.params.iter().for_each(|(_, node)| mentioned(node, &mut used));
        let used = used.iter().map(|(name, _)| name.as_str());
        let used: BTreeSet<&str> = used.chain(document.mentions.iter().map(String::as_str)).collect();
        let bases: BTreeSet<&str> = used.iter().map(|name| parted(name).0).collect();
        let unused = document.params.iter().filter(|(key, _)| !bases.contains(key.name.as_str()));
        let told = |(key, _): &(Key, Node)| {
            let name = &key.name;
            let fault = Diagnostic::at(key.span, format!("nothing mentions parameter `{name}`"));
            if !document.written_mentions.iter().any(|written| parted(written).0 == name) {
                return Some(fault.hint(format!("write ${{{name}}} in a `with`, or remove it")));
            }
            let hint = "another option took the place of what mentions it: leave out one of the two";
            self.is_set(name).then(|| fault.hint(hint))
        };
        let entries = document.params.iter().filter(|(key, _)| bases.contains(key.name.as_str()));
        let entries = entries.flat_map(|(key, node)| self.unused_entries(&key.name, node, &used));
        unused.filter_map(told).chain(entries).collect()
    }

    /// Of a map that is mentioned by single entries only: those that nothing mentions, not even what values of the command line took the place
    /// of. Such an entry is most often a misspelt one.
    fn unused_entries(&self, name: &str, node: &Node, used: &BTreeSet<&str>) -> Vec<Diagnostic> {
        if used.contains(name) {
            return Vec::new();
        }
        let Some(entries) = node.entries() else { return Vec::new() };
        let read: Vec<&str> =
            used.iter().map(|used| parted(used)).filter(|used| used.0 == name).filter_map(|used| used.1).collect();
        if read.iter().any(|field| node.get(field).is_none()) {
            // That is a fault of its own, and this one may follow from it.
            return Vec::new();
        }
        let written = &self.document().written_mentions;
        let is_unused = |key: &str| !read.contains(&key) && !written.contains(&format!("{name}.{key}"));
        let unused = entries.iter().filter(|(key, _)| is_unused(&key.name));
        let told = |(key, _): &(Key, Node)| {
            let fault =
                Diagnostic::at(key.span, format!("nothing mentions the entry `{}` of parameter `{name}`", key.name));
            // All that is mentioned is in the map, so an entry of the file stands beside the one it is like. One of the command line was
            // added to the map, and may be meant to take the place of another.
            let is_set = self.sources.get(key.span.source).is_some_and(|source| source.name == "--set");
            let near = is_set.then(|| nearest(&key.name, &read)).flatten();
            let near = near.map_or_else(String::new, |near| format!("did you mean `{near}`? else "));
            fault.hint(format!("{near}write ${{{name}.{}}} in a `with`, or remove it", key.name))
        };
        unused.map(told).collect()
    }
}

/// What to do with an axis that no step depends on. Where it does not reseed, `over:` alone would repeat a step with the same random numbers.
fn way_out(axis: &Axis, is_swept: bool) -> String {
    let name = &axis.name.text;
    if axis.reseeds {
        return format!(
            "say `over: [{name}]` on the step where it begins, mention ${{{name}}} in a `with`, or remove it"
        );
    }
    let draws = format!(
        "swept values change no random numbers, so `over: [{name}]` alone would make the same again; for other random numbers"
    );
    if is_swept && axis.label == "seed" {
        return format!(
            "{draws}, `axes: {{replicate: {{count: 3}}}}` and `over: [replicate]` on the steps that draw; or a run for each seed: `--seed 1`, `--seed 2`"
        );
    }
    format!(
        "mention ${{{name}}} in a `with`, or remove it; {draws}, declare it as `{{count: 3}}` or with `reseeds: true`, and say `over: [{name}]` on the step \
         where it begins"
    )
}
