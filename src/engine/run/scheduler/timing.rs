//! How long steps took, and what time is left.

use std::collections::HashMap;
use std::time::Instant;

use crate::plan::GraphStep;

/// How long steps took so far.
#[derive(Default)]
pub struct Timing {
    /// Count and seconds of executed instances by step.
    timed: Vec<(usize, f64)>,
    /// Number of the stage of each step.
    stages: Vec<usize>,
    /// Names of the stages.
    names: Vec<String>,
    /// Mean seconds of steps of each stage in earlier runs, once these were looked up.
    recorded: Option<Vec<Option<f64>>>,
    /// The last estimate of the time left, and when it was made.
    pub estimate: (Option<f64>, Option<Instant>),
}

impl Timing {
    /// No instance of any of these steps has run.
    pub fn new(steps: &[GraphStep]) -> Self {
        Self::of_stages(steps.iter().map(|step| step.stage.name()))
    }

    /// Of steps that have stages with these names.
    fn of_stages<'a>(names: impl Iterator<Item = &'a str>) -> Self {
        let mut numbers = HashMap::new();
        let mut stages = Vec::new();
        let mut known = Vec::new();
        for name in names {
            let next = numbers.len();
            stages.push(*numbers.entry(name).or_insert_with(|| {
                known.push(name.to_owned());
                next
            }));
        }
        Self { timed: vec![(0, 0.0); stages.len()], stages, names: known, ..Self::default() }
    }

    /// Whether earlier runs may tell how long open steps take, and were not asked.
    pub fn wants_records(&self, open: &[usize]) -> bool {
        if self.recorded.is_some() {
            return false;
        }
        let mut is_timed = vec![false; self.names.len()];
        self.stages.iter().zip(&self.timed).for_each(|(stage, timed)| is_timed[*stage] |= timed.0 > 0);
        open.iter().zip(&self.stages).any(|(open, stage)| *open > 0 && !is_timed[*stage])
    }

    /// Takes stages and seconds of steps of earlier runs.
    pub fn take_records(&mut self, records: impl Iterator<Item = (String, f64)>) {
        let mut means: HashMap<String, (usize, f64)> = HashMap::new();
        for (stage, seconds) in records {
            let mean = means.entry(stage).or_default();
            *mean = (mean.0 + 1, mean.1 + seconds);
        }
        let of = |name: &String| means.get(name).map(|(count, seconds)| seconds / *count as f64);
        self.recorded = Some(self.names.iter().map(of).collect());
    }

    /// Takes the time of an instance of a step.
    pub fn add(&mut self, step: usize, seconds: f64) {
        let timed = &mut self.timed[step];
        *timed = (timed.0 + 1, timed.1 + seconds);
    }

    /// Time left if every instance that is not done runs as long as those of its step did on average, or of steps with its stage, or as those of its
    /// stage in earlier runs, or as the median of all stages: one long step says nothing of those of other stages.
    pub fn remaining_s(&self, open: &[usize], jobs: usize) -> Option<f64> {
        let mean = |(count, seconds): (usize, f64)| (count > 0).then(|| seconds / count as f64);
        let mut by_stage = vec![(0, 0.0); self.stages.iter().max()? + 1];
        for (stage, (count, seconds)) in self.stages.iter().zip(&self.timed) {
            by_stage[*stage] = (by_stage[*stage].0 + count, by_stage[*stage].1 + seconds);
        }
        let mut means: Vec<f64> = by_stage.iter().copied().filter_map(mean).collect();
        means.sort_by(f64::total_cmp);
        let usual = *means.get(means.len() / 2)?;
        let recorded = |stage: usize| self.recorded.as_ref().and_then(|means| means[stage]);
        let each = |step: usize| {
            let stage = self.stages[step];
            mean(self.timed[step]).or_else(|| mean(by_stage[stage])).or_else(|| recorded(stage)).unwrap_or(usual)
        };
        let left: f64 = open.iter().enumerate().map(|(step, open)| each(step) * *open as f64).sum();
        Some(left / jobs as f64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[allow(clippy::float_cmp)] // sums that are exact
    fn what_has_not_run_takes_as_long_as_its_stage_or_as_a_usual_one() {
        let mut timing = Timing::of_stages(["read", "learn", "match", "match", "grid"].into_iter());
        let open = [0, 0, 10, 100, 7];
        assert_eq!(timing.remaining_s(&open, 2), None);
        timing.add(0, 1.0);
        timing.add(1, 90.0);
        timing.add(2, 2.0);
        timing.add(2, 4.0);
        // Ten and a hundred of 3 s by stage, seven of 3 s, the median of 1, 90 and 3.
        assert_eq!(timing.remaining_s(&open, 2), Some(117.0 * 3.0 / 2.0));
        // Earlier runs know better.
        assert!(timing.wants_records(&open) && !timing.wants_records(&[0, 0, 10, 100, 0]));
        timing.take_records(
            [("grid", 2.0), ("grid", 6.0), ("match", 70.0)].map(|(stage, s)| (stage.to_owned(), s)).into_iter(),
        );
        assert_eq!(timing.remaining_s(&open, 2), Some(0.5 * (110.0 * 3.0 + 7.0 * 4.0)));
        assert!(!timing.wants_records(&open));
        timing.add(3, 1.0);
        timing.add(4, 0.5);
        assert_eq!(timing.remaining_s(&open, 1), Some(10.0 * 3.0 + 100.0 + 3.5));
    }
}
