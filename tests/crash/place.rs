//! A folder with a pipeline, its store and its runs, and what must hold there in the end.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use rockface_cache::{Digest, Store};
use serde_json::Value;

/// A face whose mesh is over 1 MiB, so that its blob has a file of its own and its output is a link, small faces whose
/// values go into segments, and a step whose outputs are not kept.
pub const PIPELINE: &str = "rockface: 1
name: crash
seed: 1
axes: {k: {count: 2}}
steps:
  large: {stage: synthesise-face, with: {width_m: 12, height_m: 5, spacing_m: 0.05}}
  face: {stage: synthesise-face, over: [k], keep: false, with: {width_m: 1, height_m: 1, spacing_m: 0.1}}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: 0.1, method: tin}}
targets: [large, dem]
";
/// Runs the pipeline with a parameter changed: one step is the same.
pub const CHANGED: [&str; 6] = ["run", "p.yaml", "--jobs", "2", "--set", "steps.dem.with.cell_m=0.2"];
/// Runs the pipeline as it is.
pub const RUN: [&str; 4] = ["run", "p.yaml", "--jobs", "2"];

/// What holds, or what does not.
pub type Verdict<T = ()> = Result<T, String>;
/// The digests of a run by instance and port.
pub type Digests = BTreeMap<String, String>;

/// A folder with the pipeline.
pub struct Place {
    root: PathBuf,
    _folder: Option<tempfile::TempDir>,
}

impl Place {
    /// A new folder of its own, with the pipeline in it.
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let place = Self { root: folder.path().canonicalize().unwrap(), _folder: Some(folder) };
        place.write_pipeline();
        place
    }

    /// A folder that is there.
    pub fn at(folder: &Path) -> Self {
        let place = Self { root: folder.canonicalize().unwrap(), _folder: None };
        place.write_pipeline();
        place
    }

    /// A copy with all times, modes and links.
    pub fn copy(&self) -> Self {
        let place = Self::new();
        let mut copy = Command::new("cp");
        copy.arg("-a").arg(self.root.join(".")).arg(&place.root);
        assert!(copy.status().unwrap().success());
        place
    }

    fn write_pipeline(&self) {
        std::fs::write(self.path("p.yaml"), PIPELINE).unwrap();
    }

    /// The folder, without links.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The path of something in the folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.root.join(name)
    }

    /// The program, to be started here.
    pub fn command(&self, arguments: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_rockface"));
        command.current_dir(&self.root).args(arguments).env_remove("ROCKFACE_STORE").env("RUST_BACKTRACE", "0");
        command
    }

    /// Runs the program, which must succeed, and returns the last line it prints.
    pub fn succeed(&self, arguments: &[&str]) -> Verdict<String> {
        let Output { status, stdout, stderr } = self.command(arguments).output().unwrap();
        let (out, err) = (String::from_utf8_lossy(&stdout), String::from_utf8_lossy(&stderr));
        if status.success() {
            return Ok(out.lines().last().unwrap_or_default().to_owned());
        }
        Err(format!("`{}` without a fault ended with {status}: {out}{err}", arguments.join(" ")))
    }

    /// The digests of the newest run.
    pub fn digests(&self) -> Verdict<Digests> {
        let steps = self.steps()?;
        let of_step = |done: &Value| {
            let name = format!("{}{}", done["step"], done["point"]);
            let outputs = done["outputs"].as_object().into_iter().flatten();
            outputs
                .map(move |(port, output)| (format!("{name}.{port}"), output["digest"].to_string()))
                .collect::<Vec<_>>()
        };
        Ok(steps.iter().flat_map(of_step).collect())
    }

    fn steps(&self) -> Verdict<Vec<Value>> {
        let path = self.path(".rockface/runs/latest/run.json");
        let text = std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        let manifest: Value = serde_json::from_slice(&text).map_err(|error| format!("{}: {error}", path.display()))?;
        manifest["steps"].as_array().cloned().ok_or_else(|| "a manifest without steps".to_owned())
    }

    /// The newest run has these digests, and every file of it is what the manifest says.
    pub fn has_run(&self, expected: &Digests) -> Verdict {
        if self.digests()? != *expected {
            return Err("the run has other digests".to_owned());
        }
        let latest = self.path(".rockface/runs/latest");
        for done in self.steps()? {
            for (port, file) in done["paths"].as_object().into_iter().flatten() {
                let path = latest.join(file.as_str().unwrap_or_default());
                let bytes = std::fs::read(&path).map_err(|error| format!("{}: {error}", path.display()))?;
                if done["outputs"][port]["digest"] != Digest::of(&bytes).to_string() {
                    return Err(format!("{} has other bytes than the manifest says", path.display()));
                }
            }
        }
        for (name, end) in [("run.mcap", &b"\x89MCAP0\r\n"[..]), ("report.html", b"</html>")] {
            let bytes = std::fs::read(latest.join(name)).map_err(|error| format!("{name}: {error}"))?;
            if !bytes.trim_ascii_end().ends_with(end.trim_ascii_end()) {
                return Err(format!("{name} is torn"));
            }
        }
        Ok(())
    }

    /// A run without a fault succeeds with these digests, leaves the store whole, and nothing half-written anywhere.
    pub fn goes_on(&self, arguments: &[&str], expected: &Digests) -> Verdict<String> {
        let last = self.runs_again(arguments, expected)?;
        is_whole(&self.path(".rockface/store"))?;
        Ok(last)
    }

    /// A run without a fault succeeds with these digests, and leaves nothing half-written anywhere.
    pub fn runs_again(&self, arguments: &[&str], expected: &Digests) -> Verdict<String> {
        // With `--json` a run looks at everything itself.
        let last = self.succeed(&[arguments, &["--json"]].concat())?;
        self.has_run(expected)?;
        let left = self.litter();
        if !left.is_empty() {
            return Err(format!("left behind: {}", left.join(", ")));
        }
        Ok(last)
    }

    /// What only a process that was killed can have left.
    fn litter(&self) -> Vec<String> {
        let list = |name: &str| {
            let entries = std::fs::read_dir(self.path(name)).into_iter().flatten().flatten();
            entries.map(|entry| entry.path()).collect::<Vec<_>>()
        };
        let store = [".rockface/store/tmp", ".rockface/store/live", ".rockface/store/scratch"].iter();
        let mut left: Vec<PathBuf> = store.flat_map(|name| list(name)).collect();
        let half = |path: &PathBuf| {
            let name = path.file_name().unwrap_or_default().to_string_lossy();
            name != "latest"
                && (name.starts_with('.') || !path.join("run.json").is_file() || path.join(".unfinished").exists())
        };
        left.extend(list(".rockface/runs").into_iter().filter(half));
        let told = |path: &PathBuf| path.strip_prefix(&self.root).unwrap_or(path).display().to_string();
        left.iter().map(told).collect()
    }
}

/// Every blob of a store has its digest, and every record its blobs.
pub fn is_whole(store: &Path) -> Verdict {
    let faults = Store::open(store).and_then(|store| store.verify(false)).map_err(|error| error.to_string())?.faults;
    if faults.is_empty() { Ok(()) } else { Err(format!("the store {} is not whole: {faults:?}", store.display())) }
}

/// How a process ended that something happened to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Ended {
    /// It did its work: exit code 0.
    Done,
    /// A step failed: exit code 1.
    StepFailed,
    /// The disk failed it: exit code 3.
    DiskFailed,
    /// By the signal it was to get.
    Killed,
}

/// How a process ended; in any other way than those it may, or without saying what is wrong and where, is a fault.
pub fn ended(out: &Output, is_killed: bool, names_path: bool) -> Verdict<Ended> {
    use std::os::unix::process::ExitStatusExt;
    let err = String::from_utf8_lossy(&out.stderr);
    let fault = |why: &str| Err(format!("{why}: {}: {err}", out.status));
    if err.contains("panicked") {
        return fault("it panicked");
    }
    match (out.status.code(), out.status.signal()) {
        (Some(0), _) => Ok(Ended::Done),
        (None, Some(9)) if is_killed => Ok(Ended::Killed),
        (Some(code @ (1 | 3)), _) => {
            if err.trim().is_empty() || (names_path && !err.contains('/') && !err.contains(".rockface")) {
                return fault("it does not say what is wrong where");
            }
            Ok(if code == 1 { Ended::StepFailed } else { Ended::DiskFailed })
        }
        _ => fault("it ended as it should not"),
    }
}
