//! Items that were named before they were known: numbers for picks and choices once an axis has its items.

use super::graph::{Feed, Graph, Source};
use crate::diagnostic::Diagnostic;
use crate::pipeline::{Axis, Word};

impl Graph {
    /// Gives picks and choices along an axis whose items are known now their numbers; says which name none of them.
    pub fn settle(&mut self, axis: usize) -> Vec<Diagnostic> {
        let own = self.axes[axis].clone();
        let mut faults = Vec::new();
        let told = self.dynamic.iter_mut().flatten().map(|dynamic| &mut dynamic.source);
        told.for_each(|source| settle_source(source, axis, &own, &mut faults));
        for feed in self.steps.iter_mut().flat_map(|step| step.inputs.iter_mut().map(|(_, feed)| feed)) {
            settle_feed(feed, axis, &own, &mut faults);
        }
        faults.extend(self.unequal(axis));
        faults
    }

    /// Axes that are walked with this one and turn out to have another number of items.
    fn unequal(&self, axis: usize) -> Vec<Diagnostic> {
        let own = &self.axes[axis];
        let differs = |mate: &usize| !self.is_pending(*mate) && self.axes[*mate].items.len() != own.items.len();
        let told = |mate: usize| {
            let mate = &self.axes[mate];
            let (count, other) = (own.items.len(), mate.items.len());
            let message = format!("axis `{}` has {count} items, `{}` has {other}", own.name.text, mate.name.text);
            let hint = "axes that are walked together have as many items as each other";
            Diagnostic::at(own.name.span, message).hint(hint)
        };
        self.mates(axis).filter(differs).map(told).collect()
    }
}

fn settle_feed(feed: &mut Feed, axis: usize, own: &Axis, faults: &mut Vec<Diagnostic>) {
    match feed {
        Feed::Plain(source) => settle_source(source, axis, own, faults),
        Feed::Each { source, paired, .. } => {
            settle_source(source, axis, own, faults);
            paired.iter_mut().for_each(|list| settle_feed(list, axis, own, faults));
        }
        Feed::Chain { source, first, .. } => {
            std::iter::once(source)
                .chain(first.as_deref_mut())
                .for_each(|source| settle_source(source, axis, own, faults));
        }
        Feed::By { axis: by, cases, named, other } => {
            let written = named.iter_mut().map(|(_, source)| source).chain(other.as_deref_mut());
            written.chain(&mut *cases).for_each(|source| settle_source(source, axis, own, faults));
            if *by == axis && cases.is_empty() {
                *cases = chosen(named, other.as_deref(), own, faults);
            }
        }
    }
}

/// The source of every item.
fn chosen(named: &[(Word, Source)], other: Option<&Source>, axis: &Axis, faults: &mut Vec<Diagnostic>) -> Vec<Source> {
    named.iter().for_each(|(word, _)| faults.extend(number(word, axis).err()));
    let case = |item: &str| named.iter().find(|(word, _)| word.text == item).map(|(_, source)| source);
    let found: Result<Vec<Source>, &String> =
        axis.items.iter().map(|item| case(item).or(other).cloned().ok_or(item)).collect();
    found.unwrap_or_else(|item| {
        let message = format!("choosing by `{}` leaves out {item}", axis.name.text);
        faults.push(Diagnostic::at(axis.name.span, message).hint("add `else: step.port` for all items not named"));
        Vec::new()
    })
}

fn settle_source(source: &mut Source, axis: usize, own: &Axis, faults: &mut Vec<Diagnostic>) {
    let (now, later): (Vec<_>, Vec<_>) = std::mem::take(&mut source.later).into_iter().partition(|l| l.axis == axis);
    source.later = later;
    for pick in now {
        match number(&pick.item, own) {
            Ok(item) => source.picks.extend(std::iter::once(axis).chain(pick.mates).map(|axis| (axis, item))),
            Err(fault) => faults.push(fault),
        }
    }
}

fn number(word: &Word, axis: &Axis) -> Result<usize, Diagnostic> {
    let found = axis.items.iter().position(|item| *item == word.text);
    found.ok_or_else(|| {
        let fault = Diagnostic::at(word.span, format!("axis `{}` has no item `{}`", axis.name.text, word.text));
        fault.suggest(&word.text, axis.items.iter().map(String::as_str))
    })
}
