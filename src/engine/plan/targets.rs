//! What a run is to make: the targets of the pipeline or of the command line, and what parts give.

use std::collections::{HashMap, HashSet};

use super::graph::{Dynamic, GraphStep};
use super::resolve::Resolver;
use crate::diagnostic::Diagnostic;
use crate::pipeline::{INSIDE, Label, Used, Word};

impl<'d> Resolver<'d> {
    /// The numbers of the steps to make.
    pub fn targets(&mut self, steps: &[GraphStep], dynamic: &[Option<Dynamic>], given: &[String]) -> Vec<usize> {
        let declared = self.document().targets.as_deref();
        for word in declared.unwrap_or_default() {
            self.check_target(&word.text, Some(word));
        }
        given.iter().for_each(|name| self.check_target(name, None));
        let names: Vec<&str> = match declared {
            _ if !given.is_empty() => given.iter().map(String::as_str).collect(),
            Some(words) => words.iter().map(|word| word.text.as_str()).collect(),
            None => self.unread(steps, dynamic),
        };
        let names: Vec<&str> = names.into_iter().flat_map(|name| self.steps_of_target(name)).collect();
        let numbers: HashMap<&str, usize> =
            steps.iter().enumerate().map(|(number, step)| (step.name.as_str(), number)).collect();
        names.iter().filter_map(|name| numbers.get(name).copied()).collect()
    }

    /// Steps and uses of parts that nothing else reads, but for what goes back along an axis, and that tell the items of no
    /// axis of another.
    fn unread<'n>(&self, steps: &'n [GraphStep], dynamic: &[Option<Dynamic>]) -> Vec<&'n str> {
        if steps.len() < self.document().steps.len() {
            // A wrong step is left out, and the numbers of sources count it; its fault ends the planning.
            return Vec::new();
        }
        let feeds = steps.iter().flat_map(|step| {
            let sources = step.inputs.iter().flat_map(|(_, feed)| feed.forward_sources());
            sources.map(|source| (Some(whole(&step.name)), source.step))
        });
        let lists = self.document().axes.iter().zip(dynamic).filter_map(|(axis, dynamic)| {
            let used = axis.name.text.split_once(INSIDE).map(|(used, _)| used);
            Some((used, dynamic.as_ref()?.source.step))
        });
        let links = feeds.chain(lists).map(|(reader, source)| (reader, whole(&steps[source].name)));
        let read: HashSet<&str> =
            links.filter(|(reader, source)| *reader != Some(*source)).map(|(_, source)| source).collect();
        let mut seen = HashSet::new();
        let names = steps.iter().map(|step| whole(&step.name));
        names.filter(|name| !read.contains(name) && seen.insert(*name)).collect()
    }

    fn used(&self, name: &str) -> Option<&'d Used> {
        self.document().uses.iter().find(|used| used.name == name)
    }

    /// The step that a target names; of a part that is used, the steps that make its outputs.
    fn steps_of_target<'n>(&self, name: &'n str) -> Vec<&'n str>
    where
        'd: 'n,
    {
        let makers = self.used(name).map(|used| used.outputs.values().map(|to| to.step.as_str()).collect());
        makers.unwrap_or_else(|| vec![name])
    }

    /// Outputs of parts that no step reads are looked at too.
    pub fn check_part_outputs(&mut self) {
        let document = self.document();
        if document.uses.is_empty() {
            return;
        }
        let inputs =
            document.steps.iter().flat_map(|step| step.inputs.iter().flat_map(|(_, input)| input.references()));
        let read: HashSet<(&str, &str)> = inputs.map(|to| (to.step.as_str(), to.port.as_str())).collect();
        for to in document.uses.iter().flat_map(|used| used.outputs.values()) {
            let is_there = self.names.steps.contains_key(to.step.as_str());
            if is_there && !read.contains(&(to.step.as_str(), to.port.as_str())) {
                self.source(to);
            }
        }
    }

    fn check_target(&mut self, name: &str, place: Option<&Word>) {
        if self.used(name).is_none()
            && !self.names.steps.contains_key(name)
            && !self.document().unread.steps.contains(name)
        {
            let message = format!("unknown target step `{name}`");
            let fault = place.map_or_else(
                || Diagnostic::general(message.clone()),
                |word| Diagnostic::at(word.span, message.clone()),
            );
            let step = Label::parse(name).map(|label| label.step).filter(|step| self.names.steps.contains_key(step));
            let uses = self.document().uses.iter().map(|used| used.name.as_str());
            self.faults.push(match step {
                Some(step) => fault.hint(format!("a target is a whole step: write `{step}`")),
                None => self.suggest(fault, name, || self.step_names().into_iter().chain(uses)),
            });
        }
    }
}

/// The outermost use of a part that a step belongs to, or the step itself.
fn whole(name: &str) -> &str {
    name.split_once(INSIDE).map_or(name, |(used, _)| used)
}
