//! The numbers drawn for one candidate, each noted under its name.

use super::BlockError;
use rockface_core::artefact::candidates::Quantity;
use rockface_core::distribution::Draws;
use rockface_core::numerics::random::Key;

/// Draws for one candidate of one class; what is drawn is kept as a list of names and values.
#[derive(Debug, Clone)]
pub struct Drawing {
    draws: Draws,
    class: usize,
    noted: Vec<(String, f64)>,
}

impl Drawing {
    /// Draws for a candidate of this class; nothing is noted yet.
    pub fn new(draws: Draws, class: usize) -> Self {
        Self { draws, class, noted: Vec::new() }
    }

    /// Draws a quantity and notes it.
    pub fn value(&mut self, name: &str, quantity: &Quantity) -> Result<f64, BlockError> {
        let value = self.unnoted(name, quantity)?;
        self.note(name, value);
        Ok(value)
    }

    /// Draws a quantity without noting it: one of many alike.
    pub fn unnoted(&self, name: &str, quantity: &Quantity) -> Result<f64, BlockError> {
        let drawn = self.draws.value(&self.purpose(name), quantity);
        drawn.ok_or_else(|| {
            BlockError::Specification(format!("the distribution of `{name}` has not been read from its file"))
        })
    }

    /// A uniform draw between 0 and 1, not noted.
    pub fn uniform(&self, name: &str) -> f64 {
        self.draws.uniform(&self.purpose(name))
    }

    /// A standard normal draw, not noted.
    pub fn normal(&self, name: &str) -> f64 {
        self.draws.normal(&self.purpose(name))
    }

    /// The key of many draws.
    pub fn key(&self, name: &str) -> Key {
        self.draws.key(&self.purpose(name))
    }

    /// Notes a number that was not drawn here.
    pub fn note(&mut self, name: &str, value: f64) {
        self.noted.push((name.to_owned(), value));
    }

    /// What was noted, in order.
    pub fn into_noted(self) -> Vec<(String, f64)> {
        self.noted
    }

    fn purpose(&self, name: &str) -> String {
        format!("{}/{name}", self.class)
    }
}
