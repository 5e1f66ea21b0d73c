//! Values of the command line for what parts make, such as `steps.before/noisy.with.x=1`.

use super::super::node::Node;
use super::super::overrides::Late;
use super::super::reader::Reader;
use super::INSIDE;
use crate::diagnostic::Diagnostic;

/// Values, and whether each fits a step or axis.
pub struct LateValues(Vec<(Late, bool)>);

impl LateValues {
    /// None has been put into a step or axis yet.
    pub fn new(values: Vec<Late>) -> Self {
        Self(values.into_iter().map(|value| (value, false)).collect())
    }

    /// Puts the values that were given for a step or axis on the command line into it.
    pub fn put_into(&mut self, section: &str, name: &str, node: &mut Node, reader: &mut Reader) {
        for (late, found) in &mut self.0 {
            match late.put_into(section, name, node) {
                Ok(fits) => *found |= fits,
                Err(fault) => {
                    *found = true;
                    reader.fault(fault);
                }
            }
        }
    }

    /// Reports values for steps and axes that no part makes.
    pub fn check(&self, steps: &[&str], axes: &[&str], reader: &mut Reader) {
        for (late, _) in self.0.iter().filter(|(_, found)| !found) {
            let (section, name) = (late.keys[0].as_str(), late.keys[1].as_str());
            let what = if section == "steps" { "step" } else { "axis" };
            let known = if section == "steps" { steps } else { axes };
            let fault = Diagnostic::at(late.span, format!("the pipeline has no {what} `{name}`"));
            reader.fault(fault.suggest(name, known.iter().copied().filter(|known| known.contains(INSIDE))));
        }
    }
}
