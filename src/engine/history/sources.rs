//! Relative layout of a pipeline's files: what an archive keeps of a pipeline that includes others.

use std::path::{Path, PathBuf};

use rockface_cache::{NameError, SafePath};

use super::Manifest;
use crate::pipeline::without_detours;

/// The pipeline file and those it includes with their texts, by paths relative to the deepest folder that holds them all.
/// Nothing where nothing is included.
///
/// # Errors
///
/// The folder for files of a manifest that are in none of those folders.
pub fn source_files(manifest: &Manifest) -> Result<Vec<(SafePath, &str)>, NameError> {
    let files: Vec<(PathBuf, &str)> =
        manifest.pipeline_files().map(|(path, text)| (without_detours(&path), text)).collect();
    if files.len() < 2 {
        return Ok(Vec::new());
    }
    let top = common_folder(files.iter().map(|(path, _)| path.as_path()));
    let below = |path: &Path| SafePath::of(path.strip_prefix(&top).unwrap_or(path));
    files.iter().map(|(path, text)| below(path).map(|path| (path, *text))).collect()
}

/// The deepest folder that holds all of these files.
pub fn common_folder<'a>(paths: impl Iterator<Item = &'a Path>) -> PathBuf {
    let mut folders = paths.map(|path| path.parent().unwrap_or(Path::new("")));
    let first = folders.next().unwrap_or(Path::new(""));
    folders.fold(first.to_owned(), |common, folder| {
        common
            .components()
            .zip(folder.components())
            .take_while(|(one, other)| one == other)
            .map(|(one, _)| one)
            .collect()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::IncludedText;

    #[test]
    fn files_keep_their_places_to_each_other() {
        let run = |folder: &str, included: &[&str]| {
            let mut run = Manifest::of_test("pipelines/main.yaml", folder, Vec::new());
            let included = included.iter().map(|path| IncludedText { path: path.into(), text: String::new() });
            run.pipeline.included = included.collect();
            run
        };
        let paths = |included: &[&str]| -> Vec<String> {
            let run = run("/slope/pipelines", included);
            source_files(&run).unwrap().iter().map(|(path, _)| path.display().to_string()).collect()
        };
        assert!(paths(&[]).is_empty() && paths(&["rockface/stereo-survey"]).is_empty());
        assert_eq!(paths(&["/slope/pipelines/./parts/a.yaml"]), ["main.yaml", "parts/a.yaml"]);
        assert_eq!(
            paths(&["/slope/pipelines/../shared/a.yaml", "/slope/pipelines/b.yaml"]),
            ["pipelines/main.yaml", "shared/a.yaml", "pipelines/b.yaml"]
        );
        // A manifest that was made up: this one would have an absolute path put into the archive.
        assert!(source_files(&run("", &["/etc/a.yaml"])).is_err());
    }
}
