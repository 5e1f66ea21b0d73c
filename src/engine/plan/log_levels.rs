//! How much the log of a run shows of each step instance: what the pipeline says, or by its place in its step.

use super::Plan;
use crate::pipeline::LogLevel;

impl Plan {
    /// The level of every instance. It depends on the plan alone, not on what is computed or in which order.
    pub fn log_levels(&self) -> Vec<LogLevel> {
        let mut of_step: Vec<Vec<usize>> = vec![Vec::new(); self.graph.steps.len()];
        self.instances.iter().enumerate().for_each(|(number, instance)| of_step[instance.step].push(number));
        let mut levels = vec![LogLevel::Brief; self.instances.len()];
        for (step, mut numbers) in self.graph.steps.iter().zip(of_step) {
            numbers.sort_by_key(|number| &self.instances[*number].items);
            let count = numbers.len();
            for (before, number) in numbers.into_iter().enumerate() {
                levels[number] = step.log.unwrap_or_else(|| LogLevel::by_place(before, count));
            }
        }
        levels
    }
}
