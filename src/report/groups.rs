//! The steps of a page by the uses of parts they come from: a section that folds for each.

use std::collections::BTreeMap;

use rockface_engine::history::PartUsed;
use rockface_engine::pipeline::INSIDE;
use rockface_engine::plan::Graph;
use rockface_engine::watch::duration;
use serde::Serialize;

use super::steps::StepView;

/// Steps that belong together: those of one use of a part, or one step by itself.
#[derive(Debug, Clone, Serialize)]
pub struct Group {
    /// The use; empty for a step by itself.
    name: String,
    /// The part that it uses.
    part: String,
    /// What the part is about.
    doc: String,
    /// Whether one of its steps is what was asked for.
    target: bool,
    /// How many instances ran, all steps together.
    executed: usize,
    /// How many were cached.
    cached: usize,
    /// How many failed or were not reached.
    missing: usize,
    /// What all of it took when it was computed.
    wall: String,
    /// The steps of the use in the order of the run; of a step by itself, only that one.
    steps: Vec<StepView>,
}

/// A part that steps of the run come from, for the section on provenance.
#[derive(Debug, Clone, Serialize)]
pub struct PartView {
    /// The name of the part, or the path of its file.
    name: String,
    /// The BLAKE3 of its text, where it has one of its own.
    blake3: String,
    /// The uses of it.
    uses: usize,
}

/// The steps in their order, those of one use of a part together where the first of them stands.
pub fn of(steps: Vec<StepView>, parts: &[PartUsed], graph: Option<&Graph>) -> Vec<Group> {
    let mut places: BTreeMap<String, usize> = BTreeMap::new();
    let mut groups: Vec<Group> = Vec::new();
    for step in steps {
        let used = step.name.split_once(INSIDE).map(|(used, _)| used.to_owned());
        let place = used.as_ref().and_then(|used| places.get(used)).copied();
        let place = place.unwrap_or_else(|| {
            groups.push(Group::new(used.as_deref().unwrap_or_default(), parts, graph));
            used.into_iter().for_each(|used| _ = places.insert(used, groups.len() - 1));
            groups.len() - 1
        });
        groups[place].steps.push(step);
    }
    groups.iter_mut().for_each(Group::add_up);
    groups
}

impl Group {
    fn new(name: &str, parts: &[PartUsed], graph: Option<&Graph>) -> Self {
        let part = parts.iter().find(|used| used.name == name).map(|used| used.part.clone());
        let written = graph.and_then(|graph| graph.uses.iter().find(|used| used.name == name));
        Self {
            name: name.to_owned(),
            part: part.or_else(|| written.map(|used| used.part.clone())).unwrap_or_default(),
            doc: written.map(|used| used.doc.clone()).unwrap_or_default(),
            target: false,
            executed: 0,
            cached: 0,
            missing: 0,
            wall: String::new(),
            steps: Vec::new(),
        }
    }

    fn add_up(&mut self) {
        let sum = |count: fn(&StepView) -> usize| self.steps.iter().map(count).sum();
        let (executed, cached, missing) =
            (sum(|step| step.executed), sum(|step| step.cached), sum(|step| step.missing));
        self.target = self.steps.iter().any(|step| step.target);
        self.wall = duration(self.steps.iter().map(|step| step.wall_s).sum());
        (self.executed, self.cached, self.missing) = (executed, cached, missing);
    }
}

/// Each part once, in the order of the run.
pub fn parts(used: &[PartUsed]) -> Vec<PartView> {
    let mut views: Vec<PartView> = Vec::new();
    for one in used {
        let blake3 = one.blake3.map(|digest| digest.to_string()).unwrap_or_default();
        match views.iter_mut().find(|view| view.name == one.part && view.blake3 == blake3) {
            Some(view) => view.uses += 1,
            None => views.push(PartView { name: one.part.clone(), blake3, uses: 1 }),
        }
    }
    views
}
