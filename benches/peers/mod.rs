//! The same graphs for ninja and doit, where they are installed: cold, and with nothing to do.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use super::Arrows;

/// What the peers took on this graph, and how many times our milliseconds that is.
pub fn told(arrows: &Arrows, ours_ms: f64) -> String {
    let all = [("ninja", ninja as fn(&Path, &Arrows)), ("doit", doit)];
    let told = all.iter().filter_map(|(program, prepare)| {
        // A shell or more for each step: beyond this a cold run takes minutes.
        let folder = tempfile::tempdir().expect("a folder");
        prepare(folder.path(), arrows);
        let cold = run(program, folder.path())?;
        let none = (0..3).filter_map(|_| run(program, folder.path())).fold(f64::INFINITY, f64::min);
        Some(format!("{program}: cold {cold:.0}, no-op {none:.1} ({:.1} x ours)", none / ours_ms))
    });
    let told: Vec<String> = told.collect();
    if told.is_empty() { "none installed".to_owned() } else { told.join("; ") }
}

/// Milliseconds of one run; `None` where the program is not installed or failed.
fn run(program: &str, folder: &Path) -> Option<f64> {
    let begun = Instant::now();
    let out = Command::new(program).current_dir(folder).output().ok()?;
    out.status.success().then(|| begun.elapsed().as_secs_f64() * 1e3)
}

fn ninja(folder: &Path, arrows: &Arrows) {
    let mut text = String::from("rule make\n  command = cat $in | cksum > $out\n");
    for (step, from) in arrows.iter().enumerate() {
        let from: String = from.iter().map(|from| format!(" s{from}")).collect();
        let from = if from.is_empty() { " source".to_owned() } else { from };
        text += &format!("build s{step}: make{from}\n");
    }
    std::fs::write(folder.join("build.ninja"), text).expect("a file");
    std::fs::write(folder.join("source"), "source").expect("a file");
}

fn doit(folder: &Path, arrows: &Arrows) {
    let text = format!(
        "import hashlib
DOIT_CONFIG = {{'verbosity': 0, 'reporter': 'zero'}}
ARROWS = {arrows:?}
def make(targets, dependencies):
    digest = hashlib.blake2b(b''.join(open(name, 'rb').read() for name in sorted(dependencies)))
    open(targets[0], 'w').write(digest.hexdigest()[:17])
def task_all():
    for step, inputs in enumerate(ARROWS):
        yield {{'name': f's{{step}}', 'actions': [make], 'targets': [f's{{step}}'],
               'file_dep': [f's{{i}}' for i in inputs] or ['source']}}
"
    );
    std::fs::write(folder.join("dodo.py"), text).expect("a file");
    std::fs::write(folder.join("source"), "source").expect("a file");
}
