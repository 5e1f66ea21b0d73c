//! Faults of many instances: a fault that several share is reported once, with how many it concerns.

use std::collections::HashMap;

use crate::diagnostic::{Diagnostic, Span};

/// Differing values at one place whose faults are reported one by one.
const EACH: usize = 5;

/// One place in the text and what is said about it.
type Said = (Option<Span>, String);

/// Faults in the order in which they were found.
#[derive(Default)]
pub struct Faults {
    list: Vec<Told>,
    /// The number of each fault by place and message.
    known: HashMap<Said, usize>,
    /// Of what is said alike at one place: the number of the first, and how many there are.
    alike: HashMap<Said, (usize, usize)>,
}

/// A fault and what it stands for.
struct Told {
    fault: Diagnostic,
    /// Instances that have this very fault.
    instances: usize,
    /// Further instances with a similar fault, which is not reported.
    alike: usize,
}

impl Faults {
    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.list.is_empty()
    }

    /// Enters the faults of some parameters; returns their numbers, for [`Faults::count`].
    pub fn enter(&mut self, faults: Vec<Diagnostic>) -> Vec<Counted> {
        faults.into_iter().map(|fault| self.enter_one(fault)).collect()
    }

    fn enter_one(&mut self, fault: Diagnostic) -> Counted {
        let said = (fault.span, fault.message.clone());
        if let Some(known) = self.known.get(&said) {
            return Counted::Told(*known);
        }
        let number = self.list.len();
        let (first, count) = self.alike.entry((fault.span, without_values(&fault.message))).or_insert((number, 0));
        if *count == EACH {
            return Counted::Alike(*first);
        }
        *count += 1;
        self.known.insert(said, number);
        self.list.push(Told { fault, instances: 0, alike: 0 });
        Counted::Told(number)
    }

    /// Counts an instance that has these faults.
    pub fn count(&mut self, faults: &[Counted]) {
        for fault in faults {
            match fault {
                Counted::Told(number) => self.list[*number].instances += 1,
                Counted::Alike(number) => self.list[*number].alike += 1,
            }
        }
    }

    /// Each with the number of instances it concerns, if those are several.
    pub fn into_list(self) -> Vec<Diagnostic> {
        let told = |Told { mut fault, instances, alike }| {
            if instances > 1 {
                fault.message += &format!(" (at {instances} instances)");
            }
            if alike > 0 {
                fault.message += &format!(" (and of this kind, with other values, at {alike} more instances)");
            }
            fault
        };
        self.list.into_iter().map(told).collect()
    }
}

/// A fault by its number, or the first of those that are like it.
#[derive(Clone, Copy)]
pub enum Counted {
    /// It is reported under this number.
    Told(usize),
    /// Another fault is reported in its place.
    Alike(usize),
}

/// A message without its numbers and what it quotes.
fn without_values(message: &str) -> String {
    let plain: String = message.split(['`', '"']).step_by(2).collect();
    plain.chars().filter(|c| !c.is_ascii_digit() && !matches!(c, '.' | '-' | '+')).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_fault_of_many_instances_is_told_once() {
        let mut faults = Faults::default();
        let at = |start| Span { source: 0, start, end: start + 1 };
        for instance in 0..1000 {
            let same = Diagnostic::at(at(3), "step `x`: `value`: -1 is out of range: must be > 0");
            let other = Diagnostic::at(at(9), format!("step `x`: cannot read `{instance}.tif`: no such file"));
            let entered = faults.enter(vec![same, other]);
            faults.count(&entered);
        }
        let told: Vec<String> = faults.into_list().into_iter().map(|fault| fault.message).collect();
        assert_eq!(told.len(), 1 + EACH, "{told:#?}");
        assert_eq!(told[0], "step `x`: `value`: -1 is out of range: must be > 0 (at 1000 instances)");
        assert!(
            told[1].ends_with("with other values, at 995 more instances)") && told[1].contains("`0.tif`"),
            "{}",
            told[1]
        );
        assert_eq!(told[2], "step `x`: cannot read `1.tif`: no such file");
    }
}
