//! The pipelines that ship with the program: `rockface run quickstart` needs no file, `rockface init --from` copies one.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use clap::ValueEnum;

use super::init::Template;
use super::{CliError, PipelineArgs};
use rockface_engine::diagnostic::{Diagnostics, nearest};
use rockface_engine::pipeline::{Overrides, Pipeline};

/// Files of the folder `pipelines` by their path in it.
macro_rules! files {
    ($($path:literal),* $(,)?) => {
        [$(($path, include_str!(concat!("../../pipelines/", $path)))),*]
    };
}

/// Every file of the folder `pipelines`; a test compares the list with the folder.
const FILES: [(&str, &str); 58] = files![
    "benchmark-outcrop.yaml",
    "benchmark.yaml",
    "calibrate-levels.yaml",
    "calibrate-outcrop.yaml",
    "calibrate-paper.yaml",
    "calibrate-site.yaml",
    "calibrate.yaml",
    "dataset.yaml",
    "example-site.yaml",
    "external-fusion.yaml",
    "hunter-valley-blocks.csv",
    "hunter-valley-blocks.yaml",
    "hunter-valley.yaml",
    "nobbys-head.yaml",
    "outcrop.yaml",
    "own-detector.yaml",
    "paper/README.md",
    "paper/hunter-valley.yaml",
    "paper/nobbys-head.yaml",
    "paper/replicate.yaml",
    "paper/small-volumes.yaml",
    "paper/ten-epochs.yaml",
    "parts/adjusted-noise.yaml",
    "parts/adjusting-round.yaml",
    "parts/calibrated-replicate.yaml",
    "parts/calibrated-site.yaml",
    "parts/detection-benchmark.yaml",
    "parts/event-replica.yaml",
    "parts/filtered-no-change.yaml",
    "parts/hunter-valley-site.yaml",
    "parts/judged-model.yaml",
    "parts/judged-noise.yaml",
    "parts/matcher-search.yaml",
    "parts/multi-image-no-change.yaml",
    "parts/multi-image-survey.yaml",
    "parts/no-change-site.yaml",
    "parts/no-change.yaml",
    "parts/noise-verdict.yaml",
    "parts/outcrop-noise.yaml",
    "parts/paper-replicate.yaml",
    "parts/paper-search.yaml",
    "parts/planned-pair.yaml",
    "parts/references.yaml",
    "parts/registered-difference.yaml",
    "parts/stereo-site.yaml",
    "parts/stereo-survey.yaml",
    "parts/surveyed-rockfall.yaml",
    "parts/synthetic-site.yaml",
    "parts/verdict.yaml",
    "python-script.yaml",
    "quickstart.yaml",
    "replicate-event.yaml",
    "scripts/example_site.sh",
    "scripts/own_detector.py",
    "scripts/vertex_bands.py",
    "shell-tool.yaml",
    "site-rockfall.yaml",
    "trier-cliff.yaml",
];

/// What a shipped pipeline may be called by in any folder, whatever files are in it.
const PREFIX: &str = "rockface/";
/// The folder of the paper's experiments.
const PAPER: &str = "paper/";

/// A pipeline that ships with the program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shipped {
    /// Its name, such as `quickstart`.
    name: &'static str,
    /// Its path below the folder of pipelines, such as `quickstart.yaml`.
    file: &'static str,
    /// The YAML text, which is part of the program.
    text: &'static str,
}

impl Shipped {
    /// The names of all shipped pipelines, without `rockface/` before them.
    pub fn names() -> impl Iterator<Item = &'static str> {
        Self::all().map(|shipped| shipped.name)
    }

    /// Its document, as if its file stood in the working folder.
    pub fn pipeline(self, overrides: &Overrides) -> Result<Pipeline, Diagnostics> {
        let folder = std::path::absolute(".").unwrap_or_default();
        Pipeline::of_text(self.text, self.included(&folder), Path::new(self.file), overrides)
    }

    /// All of them, by name.
    fn all() -> impl Iterator<Item = Self> {
        FILES.iter().filter_map(|(file, text)| {
            let name = file.strip_suffix(".yaml").filter(|name| is_name(name))?;
            Some(Self { name, file, text })
        })
    }

    /// The one of this name, with or without `rockface/`.
    ///
    /// # Errors
    /// There is none: the message lists those there are.
    pub fn find(name: &str) -> Result<Self, CliError> {
        let plain = name.strip_prefix(PREFIX).unwrap_or(name);
        Self::all().find(|shipped| shipped.name == plain).ok_or_else(|| unknown(name, plain))
    }

    /// The files it reads besides its own: included pipelines, scripts and tables, with their texts; and perhaps those
    /// that only comments name, such as a script that makes what it reads.
    fn others(self, commented: bool) -> Vec<(&'static str, &'static str)> {
        let mut found = vec![(self.file, self.text)];
        let mut at = 0;
        while at < found.len() {
            let lines = found[at].1.lines().filter(|line| commented || !line.trim_start().starts_with('#'));
            let text = lines.collect::<Vec<_>>().join("\n");
            let named = FILES.iter().filter(|(path, _)| {
                let is_other = path.strip_suffix(".yaml").is_some_and(is_name);
                !is_other && text.contains(path) && !found.iter().any(|(known, _)| known == path)
            });
            let named: Vec<_> = named.copied().collect();
            found.extend(named);
            at += 1;
        }
        found.split_off(1)
    }

    /// What is to be written to a folder to run it from there: paths and texts, its own file first.
    pub fn files(self) -> Vec<(&'static str, &'static str)> {
        std::iter::once((self.file, self.text)).chain(self.others(true)).collect()
    }

    /// The texts of the pipelines it may include, as if they stood in this folder.
    fn included(self, folder: &Path) -> BTreeMap<PathBuf, String> {
        let pipelines = self.others(false).into_iter().filter(|(path, _)| is_pipeline(path));
        pipelines.map(|(path, text)| (folder.join(path), text.to_owned())).collect()
    }

    /// Refuses a pipeline whose scripts or tables are not in the folder it would run in.
    fn check(self, folder: &Path) -> Result<(), CliError> {
        let mut missing =
            self.others(false).into_iter().filter(|(path, _)| !is_pipeline(path) && !folder.join(path).is_file());
        let Some((path, _)) = missing.next() else { return Ok(()) };
        let name = self.name;
        Err(CliError::Usage(format!(
            "the shipped pipeline `{name}` reads `{path}`, which is not in this folder: `rockface init DIR --from {name}` \
             writes the pipeline with its files"
        )))
    }
}

fn unknown(name: &str, plain: &str) -> CliError {
    let names: Vec<&str> = Shipped::all().map(|shipped| shipped.name).collect();
    let template = Template::from_str(plain, true).ok();
    let near = match template {
        Some(_) => Some(format!("`rockface init DIR --template {plain}` begins the template of that name; ")),
        None => nearest(plain, &names).map(|near| format!("did you mean `{near}`? ")),
    };
    let (near, listed) = (near.unwrap_or_default(), names.join(", "));
    CliError::Usage(format!(
        "`{name}` is no file, and no pipeline of that name ships with rockface: {near}give a YAML file or one of {listed}"
    ))
}

impl PipelineArgs {
    /// Takes a shipped pipeline where the argument is a bare name and no file: it runs as if it stood in the working folder.
    ///
    /// # Errors
    /// No pipeline ships under that name, a file of the working folder may be meant as well, or scripts it needs are not there.
    pub fn take_shipped(&mut self) -> Result<(), CliError> {
        let Some(name) = self.pipeline.to_str().filter(|name| is_name(name)) else {
            return if self.text.is_none() { not_in_a_clone(&self.pipeline) } else { Ok(()) };
        };
        if self.text.is_some() || std::fs::symlink_metadata(&self.pipeline).is_ok() {
            return Ok(());
        }
        let shipped = Shipped::find(name)?;
        let file = Path::new(shipped.file);
        if !name.starts_with(PREFIX) && file.exists() {
            let (file, name) = (file.display(), shipped.name);
            return Err(CliError::Usage(format!(
                "`{name}` ships with rockface, and there is a `{file}` in this folder: write `{file}` for the file or \
                 `{PREFIX}{name}` for the shipped one"
            )));
        }
        let here = std::path::absolute(".").map_err(|error| {
            CliError::Usage(format!("cannot find the working folder: {error}; go to a folder that is there"))
        })?;
        shipped.check(&here)?;
        file.clone_into(&mut self.pipeline);
        self.text = Some(shipped.text.to_owned());
        self.included = shipped.included(&here);
        self.shipped = true;
        Ok(())
    }
}

/// Refuses a path that leads to a shipped pipeline in a clone of the sources, where there is no such file.
fn not_in_a_clone(path: &Path) -> Result<(), CliError> {
    let written = path.with_extension("");
    let written = written.strip_prefix(".").unwrap_or(&written);
    let name = written.strip_prefix("pipelines").unwrap_or(written).to_str().unwrap_or_default();
    let is_named = is_pipeline(&path.to_string_lossy()) || path.extension().is_none();
    if !is_named || !is_name(name) || std::fs::symlink_metadata(path).is_ok() {
        return Ok(());
    }
    match Shipped::find(name) {
        Ok(_) => Err(CliError::Usage(format!(
            "there is no file `{}`; a pipeline of that name ships with rockface: give its name, `{name}`",
            path.display()
        ))),
        Err(_) => Ok(()),
    }
}

/// Whether a file is a pipeline or a part of one.
fn is_pipeline(path: &str) -> bool {
    Path::new(path).extension().is_some_and(|extension| extension == "yaml")
}

/// Whether an argument can name a shipped pipeline: one word of letters, digits and `-`, perhaps in the folder of the paper's experiments.
fn is_name(text: &str) -> bool {
    let plain = text.strip_prefix(PREFIX).unwrap_or(text);
    let plain = plain.strip_prefix(PAPER).unwrap_or(plain);
    !plain.is_empty() && plain.chars().all(|letter| letter.is_ascii_alphanumeric() || letter == '-')
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Paths of the files below a folder, relative to it.
    fn below(folder: &Path, prefix: &str) -> Vec<String> {
        let mut found = Vec::new();
        for entry in std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap()) {
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            if name.contains("/.") || name.starts_with('.') || name.contains("__pycache__") {
                continue;
            }
            match entry.path() {
                path if path.is_dir() => found.extend(below(&path, &format!("{name}/"))),
                _ => found.push(name),
            }
        }
        found
    }

    #[test]
    fn every_file_of_the_folder_is_shipped() {
        let mut there = below(&Path::new(env!("CARGO_MANIFEST_DIR")).join("pipelines"), "");
        there.sort();
        let mut shipped: Vec<&str> = FILES.iter().map(|(path, _)| *path).collect();
        shipped.sort_unstable();
        assert_eq!(shipped, there);
    }

    #[test]
    fn a_pipeline_comes_with_what_it_reads() {
        let files = |name: &str| {
            let files = Shipped::find(name).unwrap_or_else(|error| panic!("{error}")).files();
            files.into_iter().map(|(path, _)| path).collect::<Vec<_>>()
        };
        assert_eq!(files("quickstart"), ["quickstart.yaml"]);
        assert_eq!(files("rockface/hunter-valley-blocks"), ["hunter-valley-blocks.yaml", "hunter-valley-blocks.csv"]);
        assert_eq!(files("python-script"), ["python-script.yaml", "scripts/vertex_bands.py"]);
        assert_eq!(files("calibrate"), ["calibrate.yaml"]);
        assert_eq!(files("outcrop"), ["outcrop.yaml", "parts/outcrop-noise.yaml", "scripts/example_site.sh"]);
        assert_eq!(files("paper/ten-epochs"), ["paper/ten-epochs.yaml", "hunter-valley-blocks.csv"]);
    }

    #[test]
    fn paths_of_a_clone_get_the_name() {
        let told = |path: &str| not_in_a_clone(Path::new(path)).map_err(|error| error.to_string());
        assert!(
            ["pipelines/nowhere.yaml", "/a/quickstart.yaml", "pipelines/quickstart.yaml"]
                .into_iter()
                .all(|path| told(path).is_ok())
        );
        for (path, name) in [
            ("quickstart.yaml", "quickstart"),
            ("paper/ten-epochs.yaml", "paper/ten-epochs"),
            ("./dataset.yaml", "dataset"),
        ] {
            assert!(told(path).unwrap_err().ends_with(&format!("give its name, `{name}`")), "{path}");
        }
    }

    #[test]
    fn other_names_get_the_list() {
        let told = Shipped::find("quickstrat").unwrap_err().to_string();
        assert!(told.contains("did you mean `quickstart`?") && told.contains("benchmark, "), "{told}");
        assert!(is_name("nobbys-head") && is_name("rockface/quickstart") && is_name("rockface/paper/ten-epochs"));
        assert!(!["a.yaml", "./quickstart", "a/b", "", "rockface/"].into_iter().any(is_name));
    }
}
