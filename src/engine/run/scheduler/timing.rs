//! How long steps took, and what time is left.

use std::time::Instant;

/// How long steps took so far.
#[derive(Default)]
pub struct Timing {
    /// Count and seconds of executed instances by step.
    pub timed: Vec<(usize, f64)>,
    /// The last estimate of the time left, and when it was made.
    pub estimate: (Option<f64>, Option<Instant>),
}

impl Timing {
    /// No instance of any of these steps has run.
    pub fn new(steps: usize) -> Self {
        Self { timed: vec![(0, 0.0); steps], ..Self::default() }
    }

    /// Time left if every instance that is not done runs as long as its step's executed ones did on average.
    pub fn remaining_s(&self, open: &[usize], jobs: usize) -> Option<f64> {
        let (count, seconds) = self.timed.iter().fold((0, 0.0), |sum, step| (sum.0 + step.0, sum.1 + step.1));
        let overall = (count > 0).then(|| seconds / count as f64)?;
        let each = |(count, seconds): (usize, f64)| if count > 0 { seconds / count as f64 } else { overall };
        let left: f64 = self.timed.iter().zip(open).map(|(timed, open)| each(*timed) * *open as f64).sum();
        Some(left / jobs as f64)
    }
}
