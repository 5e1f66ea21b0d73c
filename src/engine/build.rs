//! Tells the program which compiler built it, for the manifests of its runs.

use std::process::Command;

/// What a release is built from; where it changes, so may the answer whether it is that of a commit.
const SOURCES: [&str; 6] = ["Cargo.lock", "Cargo.toml", "cache", "pipelines", "src", "stages"];

/// ` (commit 1a2b3c4d5e6f)` of a release build in a checkout; development builds are made between commits. Packagers say it
/// by `ROCKFACE_COMMIT`; empty, there is none. The repository of somebody else that the sources were unpacked in does not count.
fn commit() -> String {
    println!("cargo::rerun-if-env-changed=ROCKFACE_COMMIT");
    let root = std::path::absolute("../..").ok().and_then(|root| root.canonicalize().ok());
    let git = |arguments: &[&str]| {
        let output = Command::new("git").args(arguments).output().ok().filter(|output| output.status.success())?;
        Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
    };
    let given = std::env::var("ROCKFACE_COMMIT").ok();
    let is_release = std::env::var("PROFILE").is_ok_and(|profile| profile == "release");
    let found = given.or_else(|| {
        let head = git(&["rev-parse", "--git-path", "logs/HEAD"]).filter(|_| is_release)?;
        let top = git(&["rev-parse", "--show-toplevel"]).and_then(|top| std::fs::canonicalize(top).ok());
        if top != root {
            return None;
        }
        println!("cargo::rerun-if-changed={head}");
        SOURCES.iter().for_each(|path| println!("cargo::rerun-if-changed=../../{path}"));
        let changed = git(&["status", "--porcelain", "--untracked-files=no"]).is_some_and(|text| !text.is_empty());
        Some(format!("{}{}", git(&["rev-parse", "--short=12", "HEAD"])?, if changed { ", changed" } else { "" }))
    });
    found.filter(|commit| !commit.is_empty()).map_or_else(String::new, |commit| format!(" (commit {commit})"))
}

fn main() {
    let compiler = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    let version = Command::new(compiler).arg("--version").output().ok();
    let version = version.and_then(|output| String::from_utf8(output.stdout).ok()).unwrap_or_default();
    println!("cargo::rustc-env=ROCKFACE_COMPILER={}", version.trim());
    let target = std::env::var("TARGET").unwrap_or_default();
    println!("cargo::rustc-env=ROCKFACE_TARGET={target}");
    println!(
        "cargo::rustc-env=ROCKFACE_VERSION={}{}",
        std::env::var("CARGO_PKG_VERSION").unwrap_or_default(),
        commit()
    );
    println!("cargo::rerun-if-changed=build.rs");
}
