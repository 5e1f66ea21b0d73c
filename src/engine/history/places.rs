//! Where the outputs of a run are in its folder and in an archive: `outputs/<step>/<point>/<port>.<extension>`.

use rockface_cache::{Digest, NameError, OutputRecord, SafeName, SafePath};
use rockface_core::artefact::Kind;

use super::StepDone;
use crate::pipeline::INSIDE;

/// The longest name of a folder; file systems take 255 bytes, and some of the tools that read them fewer.
const NAME_BYTES: usize = 200;

/// The folder of the outputs of a step instance; `point` is empty where the step depends on no axis.
///
/// # Errors
///
/// A name that no file can have.
pub fn output_folder(step: &str, point: &str) -> Result<SafePath, NameError> {
    let mut place = SafePath::new("outputs")?;
    for name in step.split(INSIDE) {
        place = place.with(&SafeName::new(readable_name(name))?);
    }
    if point.is_empty() { Ok(place) } else { Ok(place.with(&SafeName::new(readable_name(point))?)) }
}

/// A name that every file system takes: a long one is cut and ends in a digest of the whole, so that it differs from others.
pub fn readable_name(name: &str) -> String {
    if name.len() <= NAME_BYTES {
        return name.to_owned();
    }
    let digest = Digest::of(name.as_bytes()).to_string();
    let cut = (0..=NAME_BYTES - 17).rev().find(|end| name.is_char_boundary(*end)).unwrap_or(0);
    format!("{}-{}", &name[..cut], &digest[..16])
}

/// Where an output is in the folder of its run, or would be.
pub(super) fn place_of(done: &StepDone, port: &SafeName, output: &OutputRecord) -> Result<SafePath, NameError> {
    if let Some(path) = done.paths.get(port.as_str()) {
        return Ok(path.clone());
    }
    let point: Vec<String> = done.point.iter().map(|(axis, item)| format!("{axis}={item}")).collect();
    let extension = output.kind.parse::<Kind>().map_or("bin", Kind::extension);
    Ok(output_folder(&done.step, &point.join(","))?.with(&SafeName::new(format!("{port}.{extension}"))?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn long_names_are_cut_and_stay_apart() {
        let long = |last: char| format!("{}{last}", "ö".repeat(300));
        assert_eq!(readable_name("epoch=pre"), "epoch=pre");
        let (one, other) = (readable_name(&long('a')), readable_name(&long('b')));
        assert!(one.len() <= NAME_BYTES && one.starts_with("öö") && one != other, "{one}");
    }

    #[test]
    fn a_step_of_a_part_has_a_folder_in_that_of_the_part() {
        let place = |step: &str, point: &str| output_folder(step, point).map(|place| place.to_path_buf());
        assert_eq!(place("dem", "").unwrap(), Path::new("outputs/dem"));
        assert_eq!(place("before/dem", "epoch=pre").unwrap(), Path::new("outputs/before/dem/epoch=pre"));
        assert!(place("../dem", "").is_err() && place("dem", "epoch=a/b").is_err());
    }
}
