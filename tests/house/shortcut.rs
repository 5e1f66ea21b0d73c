//! The way around a run in which nothing is to be done, held against the full way: whatever is changed beside a pipeline, an
//! answer without planning is the one that planning would give.

use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, SystemTime};

use rockface_cache::{Digest, Store};
use rockface_engine::diagnostic::Diagnostics;
use rockface_engine::pipeline::{Overrides, Pipeline};
use rockface_engine::plan::plan;
use rockface_engine::run::shortcut::{Ended, Told, recall, remember};
use rockface_engine::run::{Finished, LayOut, Options, RunFolder, Summary, execute_and_tell};
use rockface_engine::watch::Events;

use crate::cli::House;
use crate::lab::STAGES;

const TOP: &str = "rockface: 1
include: [parts/inc.yaml, link.yaml]
axes: {k: {items: [a, b]}}
steps:
  folder: {stage: tally, with: {path: data}}
  single: {stage: read, with: {path: via/one.txt}}
  each: {stage: tally, with: {path: 'set_${k}/*.txt'}}
";
const PARTS: &str = "rockface: 1
include: deep/more.yaml
steps: {pattern: {stage: tally, with: {path: 'd*.tif'}}, beside: {stage: read, with: {path: d1.tif}}}
";
const DEEP: &str = "rockface: 1\nsteps: {up: {stage: tally, with: {path: '../../set_b/*'}}}\n";
const LINKED: &str = "rockface: 1\nsteps: {linked: {stage: emit}}\n";

/// Numbers that follow from a seed.
struct Dice(u64);

impl Dice {
    fn roll(&mut self, sides: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % sides
    }

    fn pick<'a, T>(&mut self, list: &'a [T]) -> &'a T {
        &list[self.roll(list.len())]
    }
}

/// A pipeline of several files over files, folders, patterns and links.
struct Site {
    house: House,
    overrides: Overrides,
}

impl Site {
    fn new(set: &[&str]) -> Self {
        let house = House::new(TOP);
        for folder in ["real_parts/deep", "data/sub", "set_a", "set_b", "real_via", "other_via", "aside"] {
            fs::create_dir_all(house.path(folder)).unwrap();
        }
        for (link, to) in [
            ("parts", "real_parts"),
            ("via", "real_via"),
            ("link.yaml", "aside/linked.yaml"),
            ("real_parts/d3.tif", "../aside/x"),
            ("real_parts/d4.tif", "../aside/later"),
            ("data/link", "sub"),
            ("set_a/far.txt", "../other_via/one.txt"),
        ] {
            symlink(to, house.path(link)).unwrap();
        }
        for (file, text) in [
            ("real_parts/inc.yaml", PARTS),
            ("real_parts/deep/more.yaml", DEEP),
            ("aside/linked.yaml", LINKED),
            ("aside/other.yaml", "rockface: 1\nsteps: {linked: {stage: emit, with: {value: 7}}}\n"),
        ] {
            fs::write(house.path(file), text).unwrap();
        }
        let site = Self {
            house,
            overrides: Overrides { set: set.iter().map(ToString::to_string).collect(), ..Overrides::default() },
        };
        let files = [
            "real_parts/d1.tif",
            "real_parts/d2.tif",
            "aside/x",
            "data/a",
            "data/b",
            "data/sub/c",
            "set_a/1.txt",
            "set_b/1.txt",
            "set_b/2.txt",
            "real_via/one.txt",
            "other_via/one.txt",
        ];
        files.iter().enumerate().for_each(|(number, file)| site.write(file, number + 10));
        site
    }

    fn path(&self, name: &str) -> PathBuf {
        self.house.path(name)
    }

    fn write(&self, name: &str, number: usize) {
        fs::write(self.path(name), number.to_string()).unwrap();
    }

    fn question(&self) -> Digest {
        let text = fs::read_to_string(self.path("p.yaml")).unwrap();
        Digest::of(format!("{text}{:?}", self.overrides.set).as_bytes())
    }

    fn recall(&self) -> Option<Told> {
        recall(&self.path("store"), &self.question(), &self.path("runs")).unwrap()
    }

    /// The full way, which files its answer.
    fn run(&self) -> Result<(Summary, Finished), Diagnostics> {
        let store = Arc::new(Store::open(&self.path("store")).unwrap());
        let path = self.path("p.yaml");
        let pipeline = Pipeline::load(&path, &self.overrides, None)?;
        let mut plan = plan(&pipeline, &[], STAGES, &store)?;
        let (runs, overrides, lay_out) = (&self.path("runs"), &self.overrides, LayOut::default());
        let look = rockface_stages::registry().look();
        let about = RunFolder {
            runs,
            pipeline_path: &path,
            pipeline: &pipeline,
            overrides,
            targets: &[],
            jobs: 1,
            lay_out,
            look,
            reporter: &rockface::report::Pages(look),
        };
        let (options, stop) = (Options { jobs: 1, ..Options::default() }, Arc::new(AtomicBool::new(false)));
        let done = execute_and_tell(&mut plan, &store, &options, &stop, &mut Events::default(), &about);
        let (summary, finished) = done.unwrap();
        let told = Told::of(&finished, &plan, &summary);
        let ended = Ended { summary: &summary, told: &told, finished: &finished };
        remember(&store, &self.question(), &plan, &ended, &pipeline.looks).unwrap();
        Ok((summary, finished))
    }

    /// Lets everything look as if it had been left alone for an hour.
    fn age(&self) {
        age(&self.path(""));
        std::thread::sleep(Duration::from_millis(25));
    }
}

/// Every output in a run folder is what its manifest says.
fn check_outputs(folder: &Path) {
    let manifest: serde_json::Value = serde_json::from_slice(&fs::read(folder.join("run.json")).unwrap()).unwrap();
    for step in manifest["steps"].as_array().unwrap() {
        for (port, path) in step["paths"].as_object().unwrap() {
            let bytes = fs::read(folder.join(path.as_str().unwrap())).unwrap();
            assert_eq!(step["outputs"][port]["digest"], Digest::of(&bytes).to_string(), "{path}");
        }
    }
}

fn age(folder: &Path) {
    let past = SystemTime::now() - Duration::from_hours(1);
    for entry in fs::read_dir(folder).unwrap().flatten() {
        let name = entry.file_name();
        if entry.file_type().unwrap().is_dir() && name != "store" && name != "runs" {
            age(&entry.path());
        }
        if entry.file_type().unwrap().is_file() {
            fs::File::open(entry.path()).unwrap().set_modified(past).unwrap();
        }
    }
    fs::File::open(folder).unwrap().set_modified(past).unwrap();
}

const INPUTS: [&str; 9] = [
    "real_parts/d1.tif",
    "real_parts/d2.tif",
    "aside/x",
    "data/a",
    "data/b",
    "set_a/1.txt",
    "set_b/2.txt",
    "real_via/one.txt",
    "other_via/one.txt",
];

/// Changes something, and says what.
fn edit(site: &Site, dice: &mut Dice, round: usize) -> String {
    let input = *dice.pick(&INPUTS);
    let path = site.path(input);
    let relink = |link: &str, targets: [&str; 2]| {
        let now = fs::read_link(site.path(link)).unwrap();
        let to = targets.into_iter().find(|to| Path::new(to) != now).unwrap();
        fs::remove_file(site.path(link)).unwrap();
        symlink(to, site.path(link)).unwrap();
        format!("{link} now leads to {to}")
    };
    match dice.roll(14) {
        0 => String::from("nothing"),
        1 => {
            let name = *dice.pick(&[
                "real_parts/d9.tif",
                "real_parts/e9.tif",
                "data/new",
                "data/.hidden",
                "set_b/x.txt",
                "aside/no",
            ]);
            if fs::remove_file(site.path(name)).is_err() {
                site.write(name, round);
            }
            format!("{name} comes or goes")
        }
        2 | 3 => {
            site.write(input, 100 + round % 900);
            format!("{input} is written to")
        }
        4 | 5 => {
            let before = fs::metadata(&path).map(|meta| meta.modified().unwrap());
            site.write(input, 100 + round % 900);
            if let Ok(before) = before {
                fs::File::options().write(true).open(&path).unwrap().set_modified(before).unwrap();
            }
            format!("{input} is written to, with its former time")
        }
        6 => {
            site.write(input, 100 + round % 900);
            fs::rename(&path, site.path("aside/moved")).unwrap();
            fs::rename(site.path("aside/moved"), &path).unwrap();
            format!("{input} is replaced")
        }
        7 => {
            fs::File::options().append(true).create(true).open(&path).unwrap().set_modified(SystemTime::now()).unwrap();
            format!("{input} is touched")
        }
        8 => relink("parts", ["real_parts", "copy_parts"]),
        9 => relink("via", ["real_via", "other_via"]),
        10 => relink("link.yaml", ["aside/linked.yaml", "aside/other.yaml"]),
        11 => relink("real_parts/d3.tif", ["../aside/x", "../data/a"]),
        12 => {
            let later = site.path("aside/later");
            if fs::remove_file(&later).is_err() {
                site.write("aside/later", round);
            }
            String::from("the target of a dangling link comes or goes")
        }
        _ => {
            let outputs = site.path("runs/latest/outputs");
            let file = outputs.join(dice.pick(&["folder", "pattern", "single", "each/k=b", "linked"])).join("out.csv");
            let file = if file.exists() { file } else { file.with_extension("json") };
            let meta = fs::metadata(&file).unwrap();
            if dice.roll(3) == 0 {
                fs::remove_file(&file).unwrap();
            } else {
                fs::write(&file, "damaged").unwrap();
                fs::File::options().write(true).open(&file).unwrap().set_modified(meta.modified().unwrap()).unwrap();
            }
            format!("{} is damaged or removed", file.display())
        }
    }
}

fn many() -> usize {
    if std::env::var_os("ROCKFACE_SLOW").is_some() { 1500 } else { 40 }
}

#[test]
fn the_way_around_a_run_says_what_the_full_way_says() {
    let site = Site::new(&["name=around"]);
    fs::create_dir_all(site.path("copy_parts/deep")).unwrap();
    for (file, text) in [("inc.yaml", PARTS), ("deep/more.yaml", DEEP), ("d1.tif", "5"), ("d8.tif", "6")] {
        fs::write(site.path("copy_parts").join(file), text).unwrap();
    }
    let mut dice = Dice(20);
    let (mut answered, mut stale) = (0, Vec::new());
    for round in 0..many() {
        site.age();
        site.run().unwrap_or_else(|faults| panic!("{faults}"));
        let before = site.recall();
        answered += usize::from(before.is_some());
        let edited = edit(&site, &mut dice, round);
        let told = site.recall();
        let (summary, finished) = site.run().unwrap_or_else(|faults| panic!("{faults}"));
        check_outputs(&finished.folder);
        let same = summary.executed() == 0 && told.as_ref().is_some_and(|told| told.folder == finished.folder);
        if told.is_some() && !same {
            stale.push(format!("round {round}: {edited}, which ran {} steps", summary.executed()));
        }
        if edited == "nothing" {
            assert_eq!(told, before);
        }
    }
    assert!(stale.is_empty(), "answers that were stale:\n{}", stale.join("\n"));
    assert_eq!(answered, many(), "every run of a site left alone is answered the next time");
}

#[test]
fn a_file_added_beside_an_included_pipeline_is_noticed_by_the_next_run() {
    let house = House::new("rockface: 1\ninclude: parts/inc.yaml\n");
    fs::create_dir_all(house.path("parts")).unwrap();
    let steps = "rockface: 1\nsteps: {d: {stage: import-rasters, with: {path: 'd*.tif'}}}\n";
    fs::write(house.path("parts/inc.yaml"), steps).unwrap();
    fs::write(house.path("small.yaml"), crate::cli::SMALL).unwrap();
    assert_eq!(house.rockface(&["run", "small.yaml"]).0, Some(0));
    let raster = fs::read(house.path(".rockface/runs/latest/outputs/dem/raster.tif")).unwrap();
    fs::write(house.path("parts/d1.tif"), &raster).unwrap();
    let settle = || {
        age(&house.path(""));
        std::thread::sleep(Duration::from_millis(25));
    };
    settle();
    let run = || house.rockface(&["run", "p.yaml"]).1;
    assert!(run().contains("ran 1, cached 0"));
    assert!(run().contains("ran 0, cached 1"));
    fs::write(house.path("parts/d2.tif"), &raster).unwrap();
    assert!(run().contains("ran 1, cached 0"));
}

#[test]
fn the_text_that_was_asked_about_is_the_text_that_is_run() {
    let house = House::new(TOP);
    let (path, overrides) = (house.path("q.yaml"), Overrides::default());
    fs::write(&path, "rockface: 1\nname: before\nsteps: {a: {stage: emit}}\n").unwrap();
    let text = Pipeline::read_file(&path).unwrap();
    fs::write(&path, "rockface: 1\nname: after\nsteps: {a: {stage: emit}}\n").unwrap();
    let pipeline = Pipeline::of_read(&text, &path, &overrides, None).unwrap();
    assert_eq!((pipeline.document.name.as_str(), pipeline.text()), ("before", text.as_str()));
}
