//! Whole pipelines as processes of the program, on one core and on two: what a second core brings, and what 64 would.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use wait4::Wait4;

use crate::busy::{Busy, QUIET};
use crate::measure::{Cost, median, threads};
use crate::row::{Row, digits};

/// Measures and prints `rockface run quickstart` with an empty store.
pub fn measure_quickstart() {
    measure("quickstart, cold", &["quickstart"]);
}

/// Measures and prints one epoch of Hunter Valley, from the face to the DEM.
pub fn measure_hunter_valley() {
    measure("Hunter Valley, one epoch to its DEM, 2 x 45 Mpx", &["rockface/hunter-valley", "--target", "noise/before"]);
}

fn measure(what: &str, words: &[&str]) {
    let (one, result, others_then) = on_cores(1, words);
    Row { what: &format!("{what}, 1 core"), cost: one, peer: None, check: "" }.print();
    if threads() < 2 {
        return;
    }
    let (two, again, others) = on_cores(2, words);
    let others = others.max(others_then);
    let check = if result != again {
        "DIFFERS from one core".to_owned()
    } else if others > QUIET {
        format!("same files; no scaling, as other programs took {:.0} % of the processors", 100.0 * others)
    } else {
        scaling(one.wall_s / two.wall_s)
    };
    Row { what: &format!("{what}, 2 cores"), cost: two, peer: None, check: &check }.print();
}

/// What the law of Amdahl makes of the gain by a second core.
fn scaling(gain: f64) -> String {
    if gain > 2.0 {
        return format!("same files; x {gain:.2} from 1 core to 2: more than 2, the run on one core was disturbed");
    }
    let serial = 2.0 / gain - 1.0;
    let gain_of_64 = 1.0 / (serial + (1.0 - serial) / 64.0);
    let (percent, many) = (digits(100.0 * serial), digits(gain_of_64));
    format!("same files; x {gain:.2} from 1 core to 2: serial share {percent} %, so x {many} by 64 cores (Amdahl)")
}

/// What a cold run costs on so many cores, a digest of the files it made, and the share of other programs meanwhile.
fn on_cores(cores: usize, words: &[&str]) -> (Cost, blake3::Hash, f64) {
    let (mut result, mut others) = (None, 0.0f64);
    let cost = median(|| {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let busy = Busy::now();
        let cost = run(cores, words, folder.path());
        others = others.max(busy.others(Duration::from_secs_f64(cost.cpu_s)));
        result = Some(digest(&folder.path().join("runs")));
        cost
    });
    (cost, result.expect("it ran"), others)
}

fn run(cores: usize, words: &[&str], folder: &Path) -> Cost {
    let rockface = env!("CARGO_BIN_EXE_rockface");
    let begin = |mut command: Command| {
        command.arg("run").args(words).args(["--quiet", "--jobs", &cores.to_string(), "--store"]);
        command.arg(folder.join("store")).arg("--runs").arg(folder.join("runs")).current_dir(folder);
        command.stdout(Stdio::null()).stderr(Stdio::null()).spawn()
    };
    let mut pinned = Command::new("taskset");
    pinned.args(["-c", if cores == 1 { "0" } else { "0,1" }, rockface]);
    let clock = Instant::now();
    // Without `taskset` the number of jobs limits the number of threads.
    let mut child = begin(pinned).or_else(|_| begin(Command::new(rockface))).expect("the program starts");
    let ended = child.wait4().expect("the program ends");
    let wall_s = clock.elapsed().as_secs_f64();
    assert!(ended.status.success(), "`rockface run` ended with {}", ended.status);
    let cpu_s = (ended.rusage.utime + ended.rusage.stime).as_secs_f64();
    Cost { wall_s, cpu_s, memory_mb: ended.rusage.maxrss as f64 / 1e6 }
}

/// A digest of the files of data in a folder; manifests and logs tell times.
fn digest(folder: &Path) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    let mut folders = vec![folder.to_owned()];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).expect("a folder of the run").flatten() {
            let path = entry.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| ["csv", "geojson", "ply", "tif"].iter().any(|data| e == *data)) {
                files.push(path);
            }
        }
    }
    assert!(!files.is_empty(), "the run made no file of data");
    files.sort_by_key(|path| {
        path.strip_prefix(folder).map(|path| path.iter().skip(1).collect::<std::path::PathBuf>()).ok()
    });
    for file in files {
        hasher.update(&std::fs::read(file).expect("a file of the run"));
    }
    hasher.finalize()
}
