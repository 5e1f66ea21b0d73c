//! The rules of the house that no compiler checks: who may import whom, and what a file looks like.

use std::path::{Path, PathBuf};

fn sources(folder: &str) -> Vec<(PathBuf, String)> {
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
fn without_tests(sources: Vec<(PathBuf, String)>) -> Vec<(PathBuf, String)> {
    let testing = |path: &Path| {
        path.file_stem().is_some_and(|stem| stem.to_string_lossy().ends_with("tests") || stem == "testing")
    };
    let cut = |text: String| text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default().to_owned();
    sources.into_iter().filter(|(path, _)| !testing(path)).map(|(path, text)| (path, cut(text))).collect()
}

/// Stage files: the modules of `stages/src` that the registry lists.
fn stage_modules() -> Vec<String> {
    rockface_stages::all().iter().map(|stage| stage.name().replace('-', "_")).collect()
}

#[test]
fn every_file_opens_with_a_sentence() {
    for folder in ["src", "stages/src", "cache/src", "tests/house", "tests/crash"] {
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
    absent(&without_tests(sources("stages/src")), &words, "a stage is lent what it needs");
}

#[test]
fn nothing_imports_a_stage_but_the_registry() {
    let modules: Vec<String> = stage_modules().iter().map(|module| format!("crate::{module}")).collect();
    let words: Vec<&str> = modules.iter().map(String::as_str).collect();
    absent(&without_tests(sources("stages/src")), &words, "two stages meet only through artefacts");
}

#[test]
fn the_engine_knows_no_kernel_and_no_rock() {
    absent(&sources("src"), &["rockface_stages::kernel", "stages::kernel"], "the engine knows no rock");
}

#[test]
fn kernels_know_no_stage() {
    let words = ["crate::Stage,", "crate::{Stage,", "crate::Context", "crate::Inputs", "crate::Outputs", "impl Stage"];
    absent(&without_tests(sources("stages/src/kernel")), &words, "a kernel is a pure function");
}

#[test]
fn every_stage_is_a_file_of_its_name() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("stages/src");
    for module in stage_modules() {
        assert!(folder.join(format!("{module}.rs")).is_file(), "stage `{module}` has no file of its own");
    }
    let mut names: Vec<&str> = rockface_stages::all().iter().map(|stage| stage.name()).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), rockface_stages::all().len(), "two stages share a name");
}
