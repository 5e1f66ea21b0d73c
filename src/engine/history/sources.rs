//! Relative layout of a pipeline's files: what an archive keeps of a pipeline that includes others.

use std::path::{Component, Path, PathBuf};

use rockface_cache::{NameError, SafePath};

use super::PipelineText;

/// The pipeline file and those it includes with their texts, by paths relative to the deepest folder that holds them all.
/// Nothing where nothing is included.
///
/// # Errors
///
/// The folder for files of a manifest that are in none of those folders.
pub fn source_files(pipeline: &PipelineText) -> Result<Vec<(SafePath, &str)>, NameError> {
    // A part that comes with the program has a name and no place.
    let included = || pipeline.included.iter().filter(|file| file.path.is_absolute());
    if included().next().is_none() {
        return Ok(Vec::new());
    }
    let main = pipeline.folder.join(pipeline.path.file_name().unwrap_or_default());
    let own = std::iter::once((without_detours(&main), pipeline.text.as_str()));
    let included = included().map(|file| (without_detours(&file.path), file.text.as_str()));
    let files: Vec<(PathBuf, &str)> = own.chain(included).collect();
    let top = common_folder(files.iter().map(|(path, _)| path.as_path()));
    let below = |path: &Path| SafePath::of(path.strip_prefix(&top).unwrap_or(path));
    files.iter().map(|(path, text)| below(path).map(|path| (path, *text))).collect()
}

/// A path in which no `..` goes back on the folder before it.
fn without_detours(path: &Path) -> PathBuf {
    let mut straight = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => drop(straight.pop()),
            Component::CurDir => {}
            other => straight.push(other),
        }
    }
    straight
}

fn common_folder<'a>(paths: impl Iterator<Item = &'a Path>) -> PathBuf {
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
        let included = |path: &str| IncludedText { path: path.into(), text: String::new() };
        let pipeline = |included| PipelineText {
            name: "p".into(),
            path: "pipelines/main.yaml".into(),
            folder: "/slope/pipelines".into(),
            text: "include: …".into(),
            included,
        };
        assert!(source_files(&pipeline(Vec::new())).unwrap().is_empty());
        let beside = pipeline(vec![included("/slope/pipelines/./parts/a.yaml")]);
        let paths = |pipeline: &PipelineText| -> Vec<String> {
            source_files(pipeline).unwrap().iter().map(|(path, _)| path.display().to_string()).collect()
        };
        assert_eq!(paths(&beside), ["main.yaml", "parts/a.yaml"]);
        let elsewhere =
            pipeline(vec![included("/slope/pipelines/../shared/a.yaml"), included("/slope/pipelines/b.yaml")]);
        assert_eq!(paths(&elsewhere), ["pipelines/main.yaml", "shared/a.yaml", "pipelines/b.yaml"]);
        // A manifest that was made up: this one would have an absolute path put into the archive.
        assert!(source_files(&PipelineText { folder: "".into(), ..pipeline(vec![included("/etc/a.yaml")]) }).is_err());
    }
}
