//! What is executed and what is not: the engine's event log is the oracle.

#![expect(clippy::float_cmp, reason = "these numbers are small sums, exact or the same bits")]

use rockface_engine::run::Options;
use rockface_engine::watch::Event;

use crate::lab::{Bench, Ran};

const CHAIN: &str = "
rockface: 1
seed: 5
steps:
  a: {stage: emit, with: {value: 1.5, whole: true}}
  b: {stage: add, in: {terms: a.out}, with: {plus: 1}}
  c: {stage: draw, in: {in: b.out}}
  d: {stage: add, in: {terms: c.out}}
";

const SWEEP: &str = "
rockface: 1
seed: 5
axes:
  epoch: {items: [pre, post]}
  k: {count: 3}
  sigma: {values: [0.5, 1.0]}
steps:
  face: {stage: emit}
  other: {stage: emit, with: {value: 10}}
  noisy: {stage: draw, over: [epoch, k], in: {in: {by: epoch, pre: face.out, post: other.out}}, with: {sigma: '${sigma}'}}
  diff: {stage: add, in: {terms: 'noisy.out[epoch=post]'}}
  sum: {stage: add, in: {terms: {each: diff.out, over: [k]}}}
";

fn ran(bench: &Bench, set: &[&str], expected: &[&str]) -> Ran {
    let ran = bench.run(CHAIN, set);
    assert_eq!(ran.executed(), expected, "with {set:?}");
    ran
}

#[test]
fn a_second_run_executes_nothing() {
    let bench = Bench::new();
    ran(&bench, &[], &["a", "b", "c", "d"]);
    let second = ran(&bench, &[], &[]);
    assert_eq!((second.summary.executed(), second.summary.cached()), (0, 4));
}

#[test]
fn a_changed_parameter_reruns_what_follows_and_nothing_before() {
    let bench = Bench::new();
    ran(&bench, &[], &["a", "b", "c", "d"]);
    ran(&bench, &["steps.c.with.sigma=2"], &["c", "d"]);
    ran(&bench, &[], &[]);
}

#[test]
fn an_equal_output_stops_the_wave() {
    let bench = Bench::new();
    ran(&bench, &[], &["a", "b", "c", "d"]);
    // 1.7 rounded down is 1 again: only the changed step runs.
    ran(&bench, &["steps.a.with.value=1.7"], &["a"]);
    ran(&bench, &["steps.a.with.value=2.7"], &["a", "b", "c", "d"]);
}

#[test]
fn a_default_written_out_is_the_same_recipe() {
    let bench = Bench::new();
    ran(&bench, &[], &["a", "b", "c", "d"]);
    ran(&bench, &["steps.c.with.sigma=1", "steps.d.with={plus: 0.0, fail: false}"], &[]);
}

#[test]
fn another_seed_reruns_only_what_draws() {
    let bench = Bench::new();
    let first = ran(&bench, &[], &["a", "b", "c", "d"]);
    let other = ran(&bench, &["seed=6"], &["c", "d"]);
    assert_ne!(first.number(&bench.store, "c"), other.number(&bench.store, "c"));
    ran(&bench, &["seed=6", "steps.c.with.sigma=0"], &["c", "d"]);
    // A stage that draws nothing keeps its key under another seed.
    ran(&bench, &["seed=7", "steps.c.with.sigma=0"], &[]);
}

#[test]
fn the_name_of_a_step_matters_only_where_it_draws() {
    let bench = Bench::new();
    ran(&bench, &[], &["a", "b", "c", "d"]);
    let renamed = CHAIN
        .replace("c: {stage", "cc: {stage")
        .replace("c.out", "cc.out")
        .replace("a: {stage", "aa: {stage")
        .replace("a.out", "aa.out");
    assert_eq!(bench.run(&renamed, &[]).executed(), ["cc", "d"]);
    let labelled = renamed.replace("stage: draw,", "stage: draw, stream: {label: c},");
    assert_eq!(bench.run(&labelled, &[]).executed(), Vec::<String>::new());
}

#[test]
fn steps_expand_over_the_axes_they_depend_on() {
    let bench = Bench::new();
    let ran = bench.run(SWEEP, &[]);
    let count =
        |step: &str| ran.plan.instances.iter().enumerate().filter(|(i, _)| ran.plan.step(*i).name == step).count();
    // `face` feeds only the pre epoch, which nobody asks for.
    assert_eq!([count("face"), count("other"), count("noisy"), count("diff"), count("sum")], [0, 1, 6, 6, 2]);
    assert!(!ran.summary.failed);
}

#[test]
fn a_swept_value_keeps_the_random_numbers() {
    let bench = Bench::new();
    let ran = bench.run(SWEEP, &[]);
    let number =
        |k: usize, sigma: &str| ran.number(&bench.store, &format!("noisy[epoch=post,k={k},sigma={sigma}]")) - 10.0;
    for k in 0..3 {
        assert!((2.0 * number(k, "0.5") - number(k, "1.0")).abs() < 1e-12);
    }
    assert_ne!(number(0, "1.0"), number(1, "1.0"));
}

#[test]
fn one_more_point_runs_its_own_steps_only() {
    let bench = Bench::new();
    bench.run(SWEEP, &[]);
    let more = bench.run(SWEEP, &["axes.sigma.values=[0.5, 1.0, 2.0]"]);
    let own = |label: &String| label.contains("sigma=2.0");
    assert!(more.executed().iter().all(own), "{:?}", more.executed());
    assert_eq!(more.executed().len(), 3 + 3 + 1);
    assert_eq!(bench.run(SWEEP, &[]).executed(), Vec::<String>::new());
}

#[test]
fn narrowed_streams_draw_the_same_numbers() {
    let shared = SWEEP.replace("over: [epoch, k],", "over: [epoch, k], stream: {label: x, axes: [epoch]},");
    let bench = Bench::new();
    let ran = bench.run(&shared, &[]);
    let number = |k: usize| ran.number(&bench.store, &format!("noisy[epoch=post,k={k},sigma=1.0]"));
    assert_eq!(number(0), number(2));
    // Equal recipes run once.
    assert_eq!(ran.executed().iter().filter(|label| label.starts_with("noisy")).count(), 2);
}

#[test]
fn same_bytes_at_any_number_of_jobs() {
    let digests = [1, 2, 5].map(|jobs| {
        let bench = Bench::new();
        bench.run_with(SWEEP, &[], &Options { jobs, ..Options::default() }).digests()
    });
    assert_eq!(digests[0], digests[1]);
    assert_eq!(digests[0], digests[2]);
    assert_ne!(digests[0], Bench::new().run(SWEEP, &["seed=6"]).digests());
}

#[test]
fn transient_outputs_are_remade_only_for_a_consumer_that_runs() {
    let transient = CHAIN
        .replace("stage: draw,", "stage: draw, keep: false,")
        .replace("stage: add, in: {terms: a", "stage: add, keep: false, in: {terms: a")
        .replace("{terms: c.out}", "{terms: c.out}, with: {plus: 1}");
    let bench = Bench::new();
    assert_eq!(bench.run(&transient, &[]).executed(), ["a", "b", "c", "d"]);
    let second = bench.run(&transient, &[]);
    assert_eq!((second.executed().len(), second.remade().len()), (0, 0));
    let third = bench.run(&transient, &["steps.d.with.plus=3"]);
    assert_eq!((third.executed(), third.remade()), (vec!["d".to_owned()], vec!["b".to_owned(), "c".to_owned()]));
}

#[test]
fn memory_that_runs_short_changes_nothing() {
    let transient = SWEEP.replace("noisy: {stage: draw,", "noisy: {stage: draw, keep: false,");
    let small = Options { jobs: 2, memory_bytes: 1, ..Options::default() };
    let (roomy, tight) = (Bench::new(), Bench::new());
    let ran = tight.run_with(&transient, &[], &small);
    assert_eq!(roomy.run(&transient, &[]).digests(), ran.digests());
    for result in &ran.summary.instances {
        for output in result.outcome.as_ref().unwrap().outputs.values() {
            let there = |bench: &Bench| bench.store.contains(&output.digest);
            assert_eq!(there(&tight), there(&roomy), "what is not kept is dropped after use");
        }
    }
    assert_eq!(std::fs::read_dir(tight.store.dir().join("scratch")).unwrap().count(), 0);
}

#[test]
fn what_a_stage_gives_on_unchanged_has_the_digest_of_what_it_was_given() {
    let yaml = "
rockface: 1
steps:
  a: {stage: emit, keep: false}
  same: {stage: hand-on, in: {in: a.out}, keep: false}
  last: {stage: add, in: {terms: same.out}, with: {plus: 2}}
";
    let bench = Bench::new();
    let digests = bench.run(yaml, &[]).digests();
    let of = |port: &str| digests.iter().find_map(|line| line.strip_prefix(port).map(str::to_owned)).unwrap();
    assert_eq!(of("a.out"), of("same.out"));
    assert_ne!(of("a.out"), of("last.out"));
    // A stage that says so of another value is found out.
    let ran = bench.run(yaml, &["steps.same.with.plus=1"]);
    let told = ran.events.iter().find_map(|event| match event {
        Event::Failed { message, .. } => Some(message.clone()),
        _ => None,
    });
    assert_eq!(told.as_deref(), Some("output `out` is said to be input `in` unchanged, and differs from it"));
}

#[test]
fn a_failed_step_fails_its_dependents_only() {
    let yaml = "
rockface: 1
steps:
  a: {stage: emit}
  bad: {stage: add, in: {terms: a.out}, with: {plus: 10, fail: true}}
  after: {stage: add, in: {terms: bad.out}, with: {plus: 20}}
  broken: {stage: add, in: {terms: a.out}, with: {plus: 30, panic: true}}
  good: {stage: add, in: {terms: a.out}, with: {plus: 2}}
";
    let bench = Bench::new();
    let ran = bench.run_with(yaml, &[], &Options { jobs: 1, keep_going: true, ..Options::default() });
    assert!(ran.summary.failed);
    assert_eq!(ran.number(&bench.store, "good"), 3.0);
    let failures: Vec<String> = ran
        .events
        .iter()
        .filter_map(|event| match event {
            Event::Failed { step, message, .. } => Some(format!("{step}: {message}")),
            _ => None,
        })
        .collect();
    assert_eq!(failures.len(), 2, "{failures:?}");
    assert!(failures.iter().any(|f| f == "bad: told to give up"));
    assert!(failures.iter().any(|f| f.starts_with("broken: the stage panicked: told to")));
    assert!(!ran.executed().contains(&"after".to_owned()));
    // What failed is not remembered; what was finished is.
    assert_eq!(
        bench.run(yaml, &["steps.bad.with.fail=false", "steps.broken.with.panic=false"]).executed(),
        ["after", "bad", "broken"]
    );
}

#[test]
fn files_count_by_content() {
    let bench = Bench::new();
    let path = bench.folder.path().join("n.txt");
    let yaml = "rockface: 1\nsteps: {a: {stage: read, with: {path: n.txt}}, b: {stage: add, in: {terms: a.out}}}\n";
    std::fs::write(&path, "4").unwrap();
    assert_eq!(bench.run(yaml, &[]).executed(), ["a", "b"]);
    std::fs::write(&path, "4").unwrap();
    assert_eq!(bench.run(yaml, &[]).executed(), Vec::<String>::new());
    std::fs::write(&path, "4\n").unwrap();
    assert_eq!(bench.run(yaml, &[]).executed(), ["a"]);
    std::fs::rename(&path, bench.folder.path().join("m.txt")).unwrap();
    assert_eq!(bench.run(yaml, &["steps.a.with.path=m.txt"]).executed(), Vec::<String>::new());
}

#[test]
fn a_damaged_blob_is_set_aside_and_remade() {
    let bench = Bench::new();
    let first = bench.run(CHAIN, &[]);
    let folder = bench.folder.path().join("store/segments");
    let Bench { folder: home, store, stages } = bench;
    drop(store);
    // Flip one byte of the value inside every small blob that holds the sum.
    for entry in std::fs::read_dir(&folder).unwrap().flatten() {
        let mut bytes = std::fs::read(entry.path()).unwrap();
        let places: Vec<usize> = (0..bytes.len() - 7).filter(|i| &bytes[*i..*i + 7] == b"columns").collect();
        places.into_iter().for_each(|i| bytes[i] = b'C');
        std::fs::write(entry.path(), bytes).unwrap();
    }
    let store = std::sync::Arc::new(rockface_cache::Store::open(&home.path().join("store")).unwrap());
    let bench = Bench { folder: home, store, stages };
    let again = bench.run(CHAIN, &["steps.d.with.plus=1"]);
    assert!(!again.summary.failed);
    assert_eq!(again.number(&bench.store, "d"), first.number(&bench.store, "c") + 1.0);
}

/// Whether an instance started while another was running.
fn overlaps(events: &[Event]) -> bool {
    let mut running = 0;
    events.iter().any(|event| {
        match event {
            Event::Started { .. } => running += 1,
            Event::Finished { .. } => running -= 1,
            _ => {}
        }
        running > 1
    })
}

#[test]
fn steps_that_do_not_fit_into_memory_together_wait_for_each_other() {
    let yaml = "
rockface: 1
axes: {k: {count: 6}}
steps:
  base: {stage: emit}
  work: {stage: toil, with: {value: '${k}'}, in: {after: base.out}}
";
    let run = |memory_bytes: usize| {
        let options = Options { jobs: 3, memory_bytes, ..Options::default() };
        Bench::new().run_with(yaml, &[], &options)
    };
    let (roomy, narrow) = (run(1 << 30), run(1));
    assert!(overlaps(&roomy.events), "{:?}", roomy.events);
    assert!(!overlaps(&narrow.events), "{:?}", narrow.events);
    let held = |ran: &Ran| ran.events.iter().filter(|event| matches!(event, Event::Held { .. })).count();
    assert!(held(&roomy) == 0 && held(&narrow) > 0);
    assert_eq!(roomy.digests(), narrow.digests());
}
