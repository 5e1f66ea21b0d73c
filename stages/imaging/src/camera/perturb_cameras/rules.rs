//! Which errors of orientation are drawn from which distribution: rules by parameter, image and sensor.

use crate::camera::camera_files::find_name;
use crate::camera::orientation_parameters::{EXTERIOR, INTERIOR, Parameter};
use rockface_core::StageError;
use rockface_core::artefact::Cameras;
use rockface_core::artefact::candidates::Quantity;
use rockface_core::params::Fault;

use super::ErrorOf;

impl ErrorOf {
    /// What its names contradict, without knowing the cameras; `at` is its place in the list.
    pub fn faults(&self, at: usize) -> Vec<Fault> {
        let path = |rest: &[&str]| {
            let at = at.to_string();
            ["errors", &at].iter().chain(rest).map(ToString::to_string).collect()
        };
        let known = |name: &str| EXTERIOR.contains(&name) || INTERIOR.contains(&name);
        let mut faults = Vec::new();
        for (place, name) in self.of.iter().enumerate().filter(|(_, name)| !known(name)) {
            let all = [&EXTERIOR[..], &INTERIOR[..]].concat().join(", ");
            let message = format!("`{name}` is no orientation parameter: {all}");
            faults.push(Fault { path: path(&["of", &place.to_string()]), ..Fault::new(message) });
        }
        let mixed = self.of.iter().any(|name| EXTERIOR.contains(&name.as_str()))
            && self.of.iter().any(|name| INTERIOR.contains(&name.as_str()));
        if mixed && self.at.is_some() {
            let message =
                "parameters of images and of sensors together: `at` can name only one kind; write two entries";
            faults.push(Fault { path: path(&["at"]), ..Fault::new(message) });
        }
        faults
    }
}

/// Rules with the owners they are for found among the cameras.
pub struct Rules<'a> {
    /// A rule, and the images or sensors it is for; `None`: all.
    rules: Vec<(&'a ErrorOf, Option<Vec<usize>>)>,
}

impl<'a> Rules<'a> {
    /// Finds the images and sensors that rules name.
    ///
    /// # Errors
    /// A name that none of them has.
    pub fn of(rules: &'a [ErrorOf], cameras: &Cameras) -> Result<Self, StageError> {
        let images: Vec<&str> = cameras.images.iter().map(|image| image.name.as_str()).collect();
        let sensors: Vec<&str> = cameras.sensors.iter().map(|sensor| sensor.name.as_str()).collect();
        let owners = |rule: &ErrorOf| {
            let is_exterior = rule.of.iter().any(|name| EXTERIOR.contains(&name.as_str()));
            let (kind, known) = if is_exterior { ("image", &images) } else { ("sensor", &sensors) };
            let find = |name: &String| {
                find_name(name, known).ok_or_else(|| {
                    StageError::new(format!("`errors` is for the {kind} `{name}`, which there is not"))
                        .hint(format!("there are {}", known.join(", ")))
                })
            };
            rule.at.as_ref().map(|names| names.iter().map(find).collect::<Result<Vec<_>, _>>()).transpose()
        };
        let rules = rules.iter().map(|rule| Ok((rule, owners(rule)?))).collect::<Result<Vec<_>, StageError>>()?;
        Ok(Self { rules })
    }

    /// The error of a parameter: that of the last rule for it.
    pub fn of_parameter(&self, parameter: Parameter) -> Option<&'a Quantity> {
        let (name, owner) = match parameter {
            Parameter::Exterior(image, place) => (EXTERIOR[place], image),
            Parameter::Interior(sensor, place) => (INTERIOR[place], sensor),
        };
        let is_for = |(rule, owners): &&(&ErrorOf, Option<Vec<usize>>)| {
            rule.of.iter().any(|of| of == name) && owners.as_ref().is_none_or(|owners| owners.contains(&owner))
        };
        self.rules.iter().rev().find(is_for).map(|(rule, _)| &rule.error)
    }
}
