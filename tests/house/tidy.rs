//! The rules of the house that no compiler checks: who may import whom, and what a file looks like.

use std::path::{Path, PathBuf};

pub fn sources(folder: &str) -> Vec<(PathBuf, String)> {
    let mut found = Vec::new();
    let mut folders = vec![Path::new(env!("CARGO_MANIFEST_DIR")).join(folder)];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).unwrap().flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push((path.clone(), std::fs::read_to_string(&path).unwrap()));
            }
        }
    }
    assert!(!found.is_empty());
    found.sort();
    found
}

/// No line of the sources may contain any of these.
fn absent(sources: &[(PathBuf, String)], words: &[&str], rule: &str) {
    for (path, text) in sources {
        for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim_start().starts_with("//")) {
            if let Some(word) = words.iter().find(|word| line.contains(*word)) {
                panic!("{}:{}: `{word}`: {rule} (see ARCHITECTURE.md)", path.display(), number + 1);
            }
        }
    }
}

/// The code of a file without its tests.
pub fn without_tests(sources: Vec<(PathBuf, String)>) -> Vec<(PathBuf, String)> {
    let testing = |path: &Path| {
        path.file_stem().is_some_and(|stem| stem.to_string_lossy().ends_with("tests") || stem == "testing")
    };
    let cut = |text: String| text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default().to_owned();
    sources.into_iter().filter(|(path, _)| !testing(path)).map(|(path, text)| (path, cut(text))).collect()
}

/// Stage files: the modules of `stages/src` that the registry lists.
fn stage_modules() -> Vec<String> {
    rockface_stages::registry().stages().iter().map(|stage| stage.name().replace('-', "_")).collect()
}

/// The sources of the science, without the registry.
fn science() -> Vec<(PathBuf, String)> {
    ["core", "raster", "rock", "imaging", "analysis"]
        .iter()
        .flat_map(|name| sources(&format!("stages/{name}/src")))
        .collect()
}

/// The stage whose file this is, or in whose folder it lies; a room may be called as one of its stages.
fn stage_of(path: &Path) -> Option<String> {
    let modules = stage_modules();
    let mut parts = path.iter().filter_map(|part| part.to_str()).map(|part| part.trim_end_matches(".rs").to_owned());
    parts.rfind(|part| modules.contains(part))
}

#[test]
fn every_file_opens_with_a_sentence() {
    for folder in ["src", "stages", "cache/src", "tests/house", "tests/crash"] {
        for (path, text) in sources(folder) {
            assert!(
                text.starts_with("//! "),
                "{}: begin with one `//!` sentence that a stranger understands",
                path.display()
            );
        }
    }
}

#[test]
fn stages_touch_no_disk_clock_thread_or_hash() {
    let words = [
        "std::fs",
        "std::time",
        "std::thread",
        "std::process",
        "std::env",
        "blake3::",
        "rockface_cache",
        "thread_rng",
        "ThreadPool",
    ];
    absent(&without_tests(science()), &words, "a stage is lent what it needs");
}

#[test]
fn nothing_imports_a_stage_but_the_registry() {
    let modules = stage_modules();
    for (path, text) in without_tests(science()) {
        let own = stage_of(&path);
        let others = modules.iter().filter(|module| own.as_deref() != Some(module.as_str()));
        let words: Vec<String> = others.map(|module| format!("::{module}::")).collect();
        let words: Vec<&str> = words.iter().map(String::as_str).collect();
        absent(&[(path, text)], &words, "two stages meet only through artefacts");
    }
}

#[test]
fn kernels_know_no_stage() {
    let words = ["Context,", "Context}", "::Context;", "Inputs,", "::Inputs;", "Outputs,"];
    let is_kernel = |path: &Path| stage_of(path).is_none() && !path.to_string_lossy().contains("/stages/core/");
    let kernels = without_tests(science()).into_iter().filter(|(path, _)| is_kernel(path));
    let rule = "a kernel is a pure function";
    for (path, text) in kernels {
        let imports: String =
            text.lines().filter(|line| line.contains("use rockface_core::")).map(|line| format!("{line}\n")).collect();
        absent(&[(path.clone(), imports)], &words, rule);
        absent(&[(path, text)], &["impl Stage for"], rule);
    }
}

#[test]
fn every_stage_is_a_file_of_its_name() {
    let files = science();
    for module in stage_modules() {
        let name = format!("{module}.rs");
        let count = files.iter().filter(|(path, _)| path.ends_with(&name)).count();
        assert_eq!(count, 1, "stage `{module}` has one file of its own");
    }
}

/// Phrases that a reader has to guess, and what to say instead.
const RIDDLES: [(&str, &str); 17] = [
    ("told of", "reported"),
    ("tells of", "reports"),
    ("counts on", "references"),
    ("count on", "reference"),
    ("came out", "the output"),
    ("comes out", "the output"),
    ("come out", "the output"),
    ("came to", "the result"),
    ("as far as", "the condition"),
    ("slip of the pen", "a mistake"),
    ("one go", "one attempt"),
    ("most like", "closest"),
    ("lets go", "releases"),
    ("let go", "release"),
    ("be had", "be available"),
    ("made again", "recomputed"),
    ("lies", "is in, is at"),
];

#[test]
fn comments_of_engine_and_store_say_it_plainly() {
    let files = ["cache/src", "cache/remote/src", "src/engine"].iter().flat_map(|folder| sources(folder));
    for (path, text) in files {
        for (number, line) in text.lines().enumerate().filter(|(_, line)| line.trim_start().starts_with("//")) {
            let words = format!(" {} ", line.trim().replace(|c: char| !c.is_alphanumeric(), " "));
            if let Some((riddle, plain)) = RIDDLES.iter().find(|(riddle, _)| words.contains(&format!(" {riddle} "))) {
                panic!("{}:{}: `{riddle}`: say {plain} (see CONTRIBUTING.md)", path.display(), number + 1);
            }
        }
    }
}

/// The first lines of our own file formats that a text defines: name and version.
fn formats(text: &str) -> Vec<(String, String)> {
    let line = |rest: &str| {
        let mut words = rest.split("\\n\"").next()?.split(' ');
        let (name, version) = (words.next()?, words.next()?);
        let is_version = !version.is_empty() && version.bytes().all(|byte| byte.is_ascii_digit());
        (is_version && words.next().is_none()).then(|| (name.to_owned(), version.to_owned()))
    };
    text.split("\"rockface ").skip(1).filter_map(line).collect()
}

#[test]
fn python_reads_the_versions_of_files_that_are_written() {
    let written: Vec<(String, String)> = without_tests(science()).iter().flat_map(|(_, text)| formats(text)).collect();
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("python/rockface/files.py");
    let read = formats(&std::fs::read_to_string(path).unwrap());
    assert!(read.len() >= 3, "{read:?}");
    for format in read {
        assert!(written.contains(&format), "python/rockface/files.py reads {format:?}, written are {written:?}");
    }
}
