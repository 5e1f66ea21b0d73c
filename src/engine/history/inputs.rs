//! The files that a run read: where they were, and where they are in an extracted archive.

use std::collections::BTreeMap;
use std::path::{Component, Path, PathBuf};
use std::sync::OnceLock;

use rockface_cache::{Digest, NameError, SafePath};

use super::sources::common_folder;
use super::{Manifest, PastRun, runs_of};
use crate::pipeline::{Copied, without_detours};
use crate::plan::FindFormer;

/// The folder of an archive with the input files.
pub const INPUTS: &str = "inputs";

impl Manifest {
    /// The folder the run was started in, which its relative paths start from.
    pub fn started_in(&self) -> &Path {
        let told = &self.pipeline;
        let parts = told.path.parent().into_iter().flat_map(Path::components);
        let steps = parts.filter(|part| *part != Component::CurDir).count();
        told.folder.ancestors().nth(steps).unwrap_or(&told.folder)
    }

    /// The input files, by the paths under which they were read, absolute, with their BLAKE3.
    pub fn input_files(&self) -> BTreeMap<PathBuf, Digest> {
        let here = self.started_in();
        let files = self.steps.iter().flat_map(|done| &done.files).chain(&self.pipeline.asked);
        files.map(|file| (here.join(&file.path), file.blake3)).collect()
    }

    /// The pipeline file and those it includes, absolute paths, with their texts.
    pub(super) fn pipeline_files(&self) -> impl Iterator<Item = (PathBuf, &str)> {
        let told = &self.pipeline;
        let main = told.folder.join(told.path.file_name().unwrap_or_default());
        // A part that comes with the program has a name and no place.
        let included = told.included.iter().filter(|file| file.path.is_absolute());
        std::iter::once((main, told.text.as_str())).chain(included.map(|file| (file.path.clone(), file.text.as_str())))
    }

    /// The deepest folder that holds the pipeline and all input files.
    fn common_folder(&self) -> PathBuf {
        let files = self.pipeline_files().map(|(path, _)| path).chain(self.input_files().into_keys());
        let files: Vec<PathBuf> = files.map(|path| without_detours(&path)).collect();
        common_folder(files.iter().map(PathBuf::as_path))
    }

    /// Where an archive has the files at these absolute paths.
    ///
    /// # Errors
    ///
    /// The first path that no archive can have: with control characters, or in no folder, of a manifest that was made up.
    pub(super) fn places_in_archive<'p>(&self, paths: &[&'p Path]) -> Result<Vec<SafePath>, (&'p Path, NameError)> {
        let top = self.common_folder();
        let place = |path: &&'p Path| {
            let straight = without_detours(path);
            let below = straight.strip_prefix(&top).unwrap_or(&straight);
            SafePath::of(&Path::new(INPUTS).join(below)).map_err(|why| (*path, why))
        };
        paths.iter().map(place).collect()
    }

    /// The copies of the input files: beside the manifest at `path`, where an archive that has them was extracted, or those that
    /// the run itself has read.
    pub fn copied_inputs(&self, path: &Path) -> Option<Copied> {
        let before = self.pipeline.copied.clone();
        let folder = path.with_file_name(INPUTS);
        // What a link leads to is no part of an archive.
        if !std::fs::symlink_metadata(&folder).is_ok_and(|is| is.is_dir()) {
            return before;
        }
        let beside = std::fs::canonicalize(folder).map(|to| Copied {
            from: self.common_folder(),
            to,
            before: before.clone().map(Box::new),
        });
        // Another folder of that name does not have the pipeline in its place.
        let main = self.pipeline_files().next().map(|(main, _)| without_detours(&main));
        let beside = beside.ok().filter(|copied| main.is_some_and(|main| copied.moved(&main).is_file()));
        beside.or(before)
    }
}

/// Runs of a pipeline that are looked through for an input file, the last first.
const LOOKED_AT: usize = 10;

/// Finds the digest that an input file had in the last run of a pipeline that read it, and the name of that run; runs are read when they are
/// needed.
pub fn find_inputs(runs: PathBuf, pipeline: String) -> Box<FindFormer> {
    type Read = Vec<(String, BTreeMap<PathBuf, Digest>)>;
    let read: OnceLock<Read> = OnceLock::new();
    let straight = |path: &Path| std::path::absolute(path).ok().map(|path| without_detours(&path));
    let files = move |run: PastRun| {
        let files = run.manifest.input_files().into_iter();
        (run.name, files.filter_map(|(path, digest)| Some((straight(&path)?, digest))).collect())
    };
    Box::new(move |path| {
        let read = read.get_or_init(|| runs_of(&runs, &pipeline, LOOKED_AT).into_iter().map(files).collect());
        let path = straight(path)?;
        read.iter().find_map(|(run, files)| Some((*files.get(&path)?, run.clone())))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::history::{FileUsed, IncludedText};

    fn run(read: &[&str]) -> Manifest {
        let mut run = Manifest::of_test("p/main.yaml", "/lab/slope/p", Vec::new());
        run.pipeline.included = vec![IncludedText { path: "/lab/slope/p/../parts/a.yaml".into(), text: String::new() }];
        let mut step = crate::history::points::tests::done("face", &[], &[]);
        step.files = read.iter().map(|path| FileUsed { path: path.into(), blake3: Digest::of(b"") }).collect();
        run.steps.push(step);
        run
    }

    #[test]
    fn files_lie_in_the_archive_as_they_lay_to_each_other() {
        let run = run(&["p/../scans/a.ply", "/lab/data/b.las"]);
        assert_eq!(run.started_in(), Path::new("/lab/slope"));
        let files: Vec<PathBuf> = run.input_files().into_keys().collect();
        assert_eq!(files, [PathBuf::from("/lab/data/b.las"), "/lab/slope/p/../scans/a.ply".into()]);
        let paths: Vec<&Path> = files.iter().map(PathBuf::as_path).collect();
        let places = run.places_in_archive(&paths).unwrap();
        let places: Vec<String> = places.iter().map(|place| place.display().to_string()).collect();
        assert_eq!(places, ["inputs/data/b.las", "inputs/slope/scans/a.ply"]);
        let folder = tempfile::tempdir().unwrap();
        let manifest = folder.path().join("run.json");
        assert!(run.copied_inputs(&manifest).is_none());
        // A folder of that name may be another one.
        let to = folder.path().canonicalize().unwrap().join(INPUTS);
        std::fs::create_dir_all(to.join("slope/p")).unwrap();
        assert!(run.copied_inputs(&manifest).is_none());
        std::fs::write(to.join("slope/p/main.yaml"), "").unwrap();
        let copied = run.copied_inputs(&manifest).unwrap();
        assert_eq!(copied, Copied { from: "/lab".into(), to: to.clone(), before: None });
        assert_eq!(copied.place(&files[1]), to.join("slope/scans/a.ply"));
    }
}
