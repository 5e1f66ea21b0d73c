//! What is shown of many instances of a step where not all fit: what is new first, and both ends of an axis.

use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::{HashMap, HashSet};

/// One of those that are shown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Chosen {
    /// Its number among all.
    pub number: usize,
    /// How many between it and the one shown before it are left out.
    pub left_out: usize,
}

/// Those of `count` that are shown where there is room for `room`, in their order: the last in any case, then those of the lower `rank`, and of
/// equal ones the first and on from the end.
pub fn chosen<R: Ord>(count: usize, room: usize, rank: impl Fn(usize) -> R) -> Vec<Chosen> {
    let mut numbers: Vec<usize> = (0..count).collect();
    if count > room {
        numbers.sort_by_cached_key(|number| (number + 1 != count, rank(*number), *number != 0, Reverse(*number)));
        numbers.truncate(room);
        numbers.sort_unstable();
    }
    let mut before = None;
    let mut gap_to = |number: usize| {
        let next = before.map_or(0, |before: usize| before + 1);
        before = Some(number);
        number - next
    };
    numbers.into_iter().map(|number| Chosen { number, left_out: gap_to(number) }).collect()
}

/// Headlines of a step above which the rest is counted only.
const OF_A_STEP: usize = 4;

/// The step, the label and the text of a headline, `step[axis=item]: text`.
fn parts(line: &str) -> (&str, &str, &str) {
    let (label, text) = line.split_once(": ").unwrap_or(("", line));
    (label.split(['[', ' ']).next().unwrap_or_default(), label, text)
}

/// The instances that were computed in a run, by their labels.
#[derive(Debug, Default)]
pub struct Ran(HashSet<String>);

impl FromIterator<String> for Ran {
    fn from_iter<I: IntoIterator<Item = String>>(labels: I) -> Self {
        Self(labels.into_iter().map(|label| sorted(&label).into_owned()).collect())
    }
}

impl Ran {
    fn has(&self, label: &str) -> bool {
        self.0.contains(&*sorted(label))
    }

    fn has_step(&self, step: &str) -> bool {
        self.0.iter().any(|label| label.split('[').next() == Some(step))
    }
}

/// A label with its items in one order: plans have that of the axes, manifests that of their names.
fn sorted(label: &str) -> Cow<'_, str> {
    let Some((step, point)) = label.split_once('[').filter(|(_, point)| point.contains(',')) else {
        return Cow::Borrowed(label);
    };
    let mut items: Vec<&str> = point.trim_end_matches(']').split(',').collect();
    items.sort_unstable();
    Cow::Owned(format!("{step}[{}]", items.join(",")))
}

/// How headlines of one step are ranked, for [`chosen`]: what ran in this run before what was cached, what few say before what many say.
pub fn ranks<'a>(lines: &[&'a str], ran: &Ran) -> Vec<(bool, usize)> {
    let mut alike: HashMap<&'a str, usize> = HashMap::new();
    lines.iter().for_each(|line| *alike.entry(parts(line).2).or_default() += 1);
    lines.iter().map(|line| (!ran.has(parts(line).1), alike[parts(line).2])).collect()
}

/// The headlines, those of a step of many instances cut short; `ran` are the labels of the instances that were computed in this run.
pub fn folded(headlines: &[String], ran: &Ran) -> Vec<String> {
    let mut lines = Vec::new();
    for group in headlines.chunk_by(|one, other| parts(one).0 == parts(other).0) {
        if group.len() <= OF_A_STEP {
            lines.extend_from_slice(group);
            continue;
        }
        let texts: Vec<&str> = group.iter().map(String::as_str).collect();
        let ranks = ranks(&texts, ran);
        let step = parts(&group[0]).0;
        for Chosen { number, left_out } in chosen(group.len(), OF_A_STEP - 1, |number| ranks[number]) {
            match left_out {
                0 => {}
                // Saying that one is left out takes as much room as that one.
                1 => lines.push(group[number - 1].clone()),
                _ => {
                    let first = number == left_out;
                    let place = if first { "before" } else { "between" };
                    lines.push(format!("{step}: … {left_out} more results {place}, in report.html"));
                }
            }
            lines.push(group[number].clone());
        }
    }
    lines
}

/// The headline that stands for a run: of the first step with one that was computed in this run the last, which is the newest item of an axis;
/// where all were cached, the last of the first step.
pub fn headline<'a>(headlines: &'a [String], ran: &Ran) -> Option<&'a str> {
    // What all instances say alike is one line, `step[axis=item] and 3 more: text`.
    let is_new = |line: &&String| {
        let (step, label, _) = parts(line);
        ran.has(label) || (label.ends_with(" more") && ran.has_step(step))
    };
    let first = headlines.iter().find(is_new);
    let step = parts(first.or(headlines.first())?).0;
    let of_step = || headlines.iter().rev().filter(|line| parts(line).0 == step);
    of_step().find(is_new).or_else(|| of_step().next()).map(String::as_str)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn numbers(count: usize, room: usize, ran: &[usize]) -> Vec<(usize, usize)> {
        let chosen = chosen(count, room, |number| !ran.contains(&number));
        chosen.into_iter().map(|one| (one.number, one.left_out)).collect()
    }

    fn labels(ran: &[&str]) -> Ran {
        ran.iter().map(|label| (*label).to_owned()).collect()
    }

    #[test]
    fn both_ends_and_what_is_new_are_shown() {
        assert_eq!(numbers(3, 4, &[]), [(0, 0), (1, 0), (2, 0)]);
        assert_eq!(numbers(9, 4, &[]), [(0, 0), (6, 5), (7, 0), (8, 0)]);
        assert_eq!(numbers(9, 4, &[8]), [(0, 0), (6, 5), (7, 0), (8, 0)]);
        assert_eq!(numbers(9, 4, &[3, 4]), [(0, 0), (3, 2), (4, 0), (8, 3)]);
        assert_eq!(numbers(9, 4, &[4, 5, 6, 7, 8]), [(5, 5), (6, 0), (7, 0), (8, 0)]);
        assert_eq!(numbers(9, 1, &[3]), [(8, 8)]);
        assert_eq!(numbers(0, 4, &[]), []);
        assert_eq!(numbers(2, 0, &[]), []);
    }

    #[test]
    fn many_results_of_a_step_are_cut_short() {
        let line = |item: usize| format!("verdict[trial={item}]: value {item}");
        let mut lines: Vec<String> = (0..16).map(line).collect();
        lines.push("rockfall: 12 pieces".to_owned());
        let gap = "verdict: … 13 more results between, in report.html".to_owned();
        assert_eq!(folded(&lines, &Ran::default()), [line(0), gap, line(14), line(15), lines[16].clone()]);
        assert_eq!(folded(&lines[..4], &Ran::default()), lines[..4]);
        // One line stands for itself.
        assert_eq!(
            folded(&lines[..5], &Ran::default()),
            [line(0), "verdict: … 2 more results between, in report.html".into(), line(3), line(4)]
        );
        let shown = folded(&lines[..6], &labels(&["verdict[trial=1]", "verdict[trial=3]"]));
        assert_eq!(shown[..5], [line(0), line(1), line(2), line(3), line(4)]);
    }

    #[test]
    fn items_have_no_order() {
        let lines = ["a[e=1,b=2]: 1", "a[e=2,b=2]: 2"].map(str::to_owned);
        assert_eq!(headline(&lines, &labels(&["a[b=2,e=1]"])), Some("a[e=1,b=2]: 1"));
    }

    #[test]
    fn what_one_alone_says_goes_before_what_all_say() {
        let line = |item: usize| format!("found[epoch=e{item}]: {} pieces", usize::from(item == 4));
        let lines: Vec<String> = (0..9).map(line).collect();
        let shown = folded(&lines, &Ran::default());
        assert!(shown.contains(&line(4)) && shown.contains(&line(0)) && shown.contains(&line(8)), "{shown:?}");
    }

    #[test]
    fn the_newest_result_stands_for_a_run() {
        let lines = ["a[e=1]: 1", "a[e=2]: 2", "b[e=1]: 3", "b[e=2]: 4", "c[e=1] and 1 more: 5"].map(str::to_owned);
        let told = |ran: &[&str]| headline(&lines, &labels(ran)).map(str::to_owned);
        assert_eq!(told(&[]).as_deref(), Some("a[e=2]: 2"));
        assert_eq!(told(&["a[e=1]", "x"]).as_deref(), Some("a[e=1]: 1"));
        assert_eq!(told(&["b[e=1]", "b[e=2]"]).as_deref(), Some("b[e=2]: 4"));
        assert_eq!(told(&["c[e=2]"]).as_deref(), Some("c[e=1] and 1 more: 5"));
        assert_eq!(headline(&[], &labels(&["a"])), None);
    }
}
