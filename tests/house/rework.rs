//! What is made again and what is not: transient outputs, twins, damage, and stages that break their promises.

#![expect(clippy::float_cmp, reason = "these numbers are small sums, exact or the same bits")]

use std::time::Duration;

use rockface_cache::Record;
use rockface_engine::run::Options;

use crate::lab::Bench;

/// Runs `work` on a thread of its own and fails if it does not come to its end.
fn ends<T: Send + 'static>(work: impl FnOnce() -> T + Send + 'static) -> T {
    let (sender, receiver) = std::sync::mpsc::channel();
    std::thread::spawn(move || sender.send(work()));
    receiver.recv_timeout(Duration::from_mins(1)).expect("the run does not end")
}

#[test]
fn equal_transient_steps_are_remade_once_and_nobody_waits_for_ever() {
    let yaml = "
rockface: 1
steps:
  a: {stage: toil, keep: false}
  x: {stage: toil, with: {value: 1}}
  b: {stage: toil, keep: false}
  ca: {stage: add, in: {terms: a.out}, with: {plus: 10}}
  cb: {stage: add, in: {terms: b.out}, with: {plus: 20}}
";
    for round in 0..5 {
        ends(move || {
            let bench = Bench::new();
            let first = bench.run(yaml, &[]);
            assert_eq!(first.executed().len(), 4, "{:?}", first.executed());
            let (plus, value) = (format!("steps.ca.with.plus={}", 11 + round), format!("steps.x.with.value={round}.5"));
            let second = bench.run(yaml, &[&plus, "steps.cb.with.plus=30", &value]);
            assert!(!second.summary.failed);
            assert_eq!(second.remade().len(), 1, "{:?}", second.remade());
            assert_eq!(second.number(&bench.store, "cb"), 30.0);
        });
    }
}

#[test]
fn a_step_that_is_kept_now_is_made_though_its_record_is_there() {
    let bench = Bench::new();
    let yaml = "rockface: 1\nsteps: {a: {stage: emit, keep: false}}\n";
    assert_eq!(bench.run(yaml, &[]).executed(), ["a"]);
    let kept = bench.run(yaml, &["steps.a.keep=true"]);
    assert_eq!((kept.executed().len(), kept.remade()), (0, vec!["a".to_owned()]));
    assert_eq!(kept.number(&bench.store, "a"), 1.0);
    assert_eq!(bench.run(yaml, &["steps.a.keep=true"]).summary.executed(), 0);
    assert_eq!(bench.run(yaml, &[]).summary.executed(), 0, "a kept output is good enough for a step that keeps none");
}

#[test]
fn of_twins_one_of_which_is_kept_the_values_are_stored() {
    // The kept one is due first, last, and (behind a step of its own) only once the other is done.
    for (a, b, c) in [("true", "false", "false"), ("false", "true", "false"), ("false", "false", "true")] {
        let yaml = format!(
            "
rockface: 1
steps:
  one: {{stage: emit}}
  late: {{stage: toil, with: {{value: 1}}}}
  a: {{stage: add, in: {{terms: one.out}}, with: {{plus: 5}}, keep: {a}}}
  b: {{stage: add, in: {{terms: one.out}}, with: {{plus: 5}}, keep: {b}}}
  c: {{stage: add, in: {{terms: late.out}}, with: {{plus: 5}}, keep: {c}}}
"
        );
        let bench = Bench::new();
        let ran = bench.run(&yaml, &[]);
        for label in ["a", "b", "c"] {
            assert_eq!(ran.number(&bench.store, label), 6.0);
        }
        assert_eq!(bench.run(&yaml, &[]).summary.executed(), 0);
    }
}

#[test]
fn long_chains_need_no_deep_stack() {
    let mut yaml = "rockface: 1\nsteps:\n  s0: {stage: emit, keep: false}\n".to_owned();
    for i in 1..1500 {
        yaml.push_str(&format!(
            "  s{i}: {{stage: add, in: {{terms: s{}.out}}, with: {{plus: 1}}, keep: false}}\n",
            i - 1
        ));
    }
    let (sender, receiver) = std::sync::mpsc::channel();
    let run = move || {
        let bench = Bench::new();
        let counts = [&[][..], &[], &["steps.s1499.with.plus=2"]].map(|set| {
            let ran = bench.run(&yaml, set);
            (ran.executed().len(), ran.remade().len())
        });
        sender.send(counts)
    };
    // Every call on the way of a chain would need more than the hundred bytes there are for each of its steps.
    let small = std::thread::Builder::new().stack_size(256 * 1024).spawn(run).unwrap();
    small.join().unwrap().unwrap();
    assert_eq!(receiver.recv().unwrap(), [(1500, 0), (0, 0), (1, 1499)]);
}

const MOODY: &str = "
rockface: 1
axes: {k: {count: 2}}
steps:
  t: {stage: moody, with: {value: '${k}', unless: UNLESS}, keep: false}
  u: {stage: add, in: {terms: {each: t.out, over: [k]}}}
  w: {stage: add, in: {terms: u.out}, with: {plus: 1}}
  v: {stage: add, in: {terms: {each: t.out, over: [k]}}, with: {plus: 100}}
  y: {stage: add, in: {terms: v.out}, with: {plus: 7}}
";

fn moody(bench: &Bench) -> (String, std::path::PathBuf) {
    let file = bench.folder.path().join("mood");
    (MOODY.replace("UNLESS", &file.display().to_string()), file)
}

#[test]
fn what_comes_out_otherwise_is_told_and_used_once() {
    for jobs in [1, 3] {
        let bench = Bench::new();
        let (yaml, _) = moody(&bench);
        let first = bench.run(&yaml, &[]);
        let second = bench.run_with(&yaml, &["steps.v.with.plus=200"], &Options { jobs, ..Options::default() });
        assert!(!second.summary.failed);
        assert_eq!((second.executed(), second.remade().len()), (vec!["v".to_owned(), "y".to_owned()], 2));
        let warnings = second.warnings();
        assert!(warnings.len() == 2 && warnings.iter().all(|w| w.contains("not deterministic")), "{warnings:?}");
        // What was done keeps the former output, what ran has the new one.
        assert_eq!(second.number(&bench.store, "u"), first.number(&bench.store, "u"));
        assert!(second.number(&bench.store, "v") - 200.0 > first.number(&bench.store, "v") - 100.0);
    }
}

#[test]
fn a_failed_remake_leaves_alone_what_is_done() {
    let bench = Bench::new();
    let (yaml, file) = moody(&bench);
    bench.run(&yaml, &[]);
    std::fs::write(&file, "bad").unwrap();
    let options = Options { jobs: 2, keep_going: true, ..Options::default() };
    let second = bench.run_with(&yaml, &["steps.v.with.plus=200"], &options);
    assert!(second.summary.failed);
    let known = ["u", "w", "v", "y"].map(|label| second.is_known(label));
    assert_eq!(known, [true, true, false, false]);
}

#[test]
fn what_another_process_finished_meanwhile_is_not_done_again() {
    let yaml = "rockface: 1\nsteps: {a: {stage: emit}, b: {stage: add, in: {terms: a.out}}}\n";
    let bench = Bench::new();
    let other = Bench {
        store: std::sync::Arc::new(rockface_cache::Store::open(&bench.folder.path().join("store")).unwrap()),
        folder: tempfile::tempdir().unwrap(),
        stages: bench.stages,
    };
    assert_eq!(bench.run(yaml, &[]).summary.executed(), 2);
    // This handle was opened before and has not looked since.
    let late = other.run(yaml, &[]);
    assert_eq!((late.summary.executed(), late.summary.cached()), (0, 2));
}

#[test]
fn a_blob_that_no_reader_takes_fails_the_step_that_needs_it() {
    let yaml = "rockface: 1\nsteps: {a: {stage: emit}, b: {stage: add, in: {terms: a.out}}}\n".to_owned();
    let ran = ends(move || {
        let bench = Bench::new();
        let first = bench.run(&yaml, &[]);
        let result = &first.summary.instances[0];
        let mut outcome = result.outcome.clone().unwrap();
        let output = outcome.outputs.get_mut("out").unwrap();
        (output.digest, output.bytes) = (bench.store.put(b"no table").unwrap(), 8);
        let (recipe, outputs) = (result.recipe(&bench.store).unwrap(), outcome.outputs);
        bench
            .store
            .commit(&Record { recipe, outputs, log: outcome.log, sketches: outcome.sketches, cost: outcome.cost })
            .unwrap();
        bench.run(&yaml, &[])
    });
    assert!(ran.summary.failed);
    let said: Vec<String> = ran.events.iter().map(|event| format!("{event:?}")).collect();
    assert!(
        said.iter().any(|event| event.contains("input `terms`") && event.contains("cannot be read back")),
        "{said:?}"
    );
}
