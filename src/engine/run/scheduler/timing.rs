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
        let number = |name| {
            let next = numbers.len();
            *numbers.entry(name).or_insert(next)
        };
        let stages: Vec<usize> = names.map(number).collect();
        Self { timed: vec![(0, 0.0); stages.len()], stages, estimate: (None, None) }
    }

    /// Takes the time of an instance of a step.
    pub fn add(&mut self, step: usize, seconds: f64) {
        let timed = &mut self.timed[step];
        *timed = (timed.0 + 1, timed.1 + seconds);
    }

    /// Time left if every instance that is not done runs as long as those of its step did on average, or of steps with its stage, or as the median of
    /// all stages: one long step says nothing of those of other stages.
    pub fn remaining_s(&self, open: &[usize], jobs: usize) -> Option<f64> {
        let mean = |(count, seconds): (usize, f64)| (count > 0).then(|| seconds / count as f64);
        let mut by_stage = vec![(0, 0.0); self.stages.iter().max()? + 1];
        for (stage, (count, seconds)) in self.stages.iter().zip(&self.timed) {
            by_stage[*stage] = (by_stage[*stage].0 + count, by_stage[*stage].1 + seconds);
        }
        let mut means: Vec<f64> = by_stage.iter().copied().filter_map(mean).collect();
        means.sort_by(f64::total_cmp);
        let usual = *means.get(means.len() / 2)?;
        let each = |step: usize| mean(self.timed[step]).or_else(|| mean(by_stage[self.stages[step]])).unwrap_or(usual);
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
        timing.add(3, 1.0);
        timing.add(4, 0.5);
        assert_eq!(timing.remaining_s(&open, 1), Some(10.0 * 3.0 + 100.0 + 3.5));
    }
}
