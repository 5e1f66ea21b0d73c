//! Axes whose items another step makes: expanded while a run goes on, or from records when it is planned.

#![expect(clippy::float_cmp, reason = "these numbers are small sums, exact")]

use rockface_engine::run::Options;
use rockface_engine::watch::Event;

use crate::lab::{Bench, Ran};

/// A coarse search, the rows around its result, a fine search over these rows.
const SEARCH: &str = "
rockface: 1
seed: 5
axes:
  coarse: {values: [1, 2, 4]}
  fine: {from: refined.out, reseeds: false}
steps:
  tried: {stage: emit, with: {value: '${coarse}'}}
  refined: {stage: list, in: {terms: {each: tried.out, over: [coarse]}}, with: {rows: 3}}
  again: {stage: draw, in: {in: tried.out}}
  close: {stage: emit, with: {value: '${fine.value}'}}
  best: {stage: add, in: {terms: {each: close.out, over: [fine]}}}
targets: [best]
";

fn unknown(ran: &Ran) -> usize {
    ran.plan.graph.deferred().iter().flatten().count()
}

#[test]
fn a_search_in_two_stages_grows_its_plan() {
    let bench = Bench::new();
    let plan = bench.plan(SEARCH, &[]).unwrap_or_else(|faults| panic!("{faults}"));
    assert_eq!((plan.instances.len(), plan.graph.deferred().iter().flatten().count()), (4, 2));
    let ran = bench.run(SEARCH, &[]);
    assert_eq!((unknown(&ran), ran.summary.failed), (0, false));
    // 1 + 2 + 4 = 7, and then 7 + 8 + 9.
    assert_eq!(ran.number(&bench.store, "best"), 24.0);
    assert_eq!(ran.executed().len(), 8);
    let again = bench.run(SEARCH, &[]);
    assert!(again.executed().is_empty());
    // Numbered as if all had been known from the start.
    assert_eq!(again.digests(), ran.digests());
    assert_eq!(bench.plan(SEARCH, &[]).unwrap_or_else(|faults| panic!("{faults}")).instances.len(), 8);
}

#[test]
fn what_no_item_can_change_is_checked_before_the_items_are_known() {
    let bench = Bench::new();
    let wrong = "{value: '${fine.value}', whole: perhaps, wohle: true}";
    let faults = bench.plan(&SEARCH.replace("{value: '${fine.value}'}", wrong), &[]).err().unwrap().to_string();
    for piece in ["`whole`: expected", "unknown parameter `wohle`", "did you mean `whole`?", "close"] {
        assert!(faults.contains(piece), "missing `{piece}` in:\n{faults}");
    }
    assert!(!faults.contains("`value`"), "{faults}");
}

#[test]
fn more_rows_run_alone() {
    let bench = Bench::new();
    bench.run(SEARCH, &[]);
    let more = bench.run(SEARCH, &["steps.refined.with.rows=4"]);
    assert_eq!(more.executed(), ["best", "close[fine=3]", "refined"]);
    assert_eq!(more.number(&bench.store, "best"), 34.0);
}

#[test]
fn a_search_that_was_stopped_goes_on_to_the_same_table() {
    let whole = Bench::new();
    let wanted = whole.run(SEARCH, &[]).digests();
    let bench = Bench::new();
    // The first stage alone, as after a kill; then a failure in the second; then all.
    bench.run(&SEARCH.replace("targets: [best]", "targets: [refined]"), &[]);
    let broken = bench.run(SEARCH, &["steps.best.with.fail=true"]);
    assert!(broken.summary.failed);
    let resumed = bench.run(SEARCH, &[]);
    assert_eq!(resumed.executed(), ["best"]);
    assert_eq!(resumed.digests(), wanted);
}

#[test]
fn one_list_may_follow_from_another() {
    let yaml = "
rockface: 1
axes: {a: {from: l.out}, b: {from: m.out}}
steps:
  e: {stage: emit}
  l: {stage: list, in: {terms: e.out}, with: {rows: 2}}
  x: {stage: draw, in: {in: e.out}, with: {sigma: '${a.value}'}}
  g: {stage: add, in: {terms: {each: x.out, over: [a]}}}
  m: {stage: list, in: {terms: e.out}, with: {rows: 3}}
  y: {stage: add, in: {terms: x.out}, with: {plus: '${b.value}'}}
  z: {stage: add, in: {terms: {each: y.out, over: [a, b]}}}
  w: {stage: add, keep: false, in: {terms: {from: 'w.out[b=prev]', first: e.out}}, with: {plus: '${b.value}'}}
";
    for jobs in [1, 3] {
        let bench = Bench::new();
        let options = Options { jobs, ..Options::default() };
        let ran = bench.run_with(yaml, &[], &options);
        let labels: Vec<String> = (0..ran.plan.instances.len()).map(|i| ran.plan.label(i)).collect();
        assert_eq!(ran.summary.instances.len(), 1 + 1 + 2 + 1 + 1 + 6 + 1 + 3, "{labels:?}");
        assert!(!ran.summary.failed && bench.run(yaml, &[]).executed().is_empty());
        assert_eq!(bench.run(yaml, &[]).digests(), ran.digests());
    }
}

#[test]
fn lists_that_cannot_be_an_axis_are_told() {
    let bench = Bench::new();
    let empty = bench.run(SEARCH, &["steps.refined.with.rows=0"]);
    let message = empty.events.iter().find_map(|event| match event {
        Event::Failed { step, message, .. } => Some(format!("{step}: {message}")),
        _ => None,
    });
    let message = message.expect("an empty list is a failure");
    assert!(empty.summary.failed && message.contains("refined") && message.contains("list is empty"), "{message}");
    let column = bench.run(&SEARCH.replace("${fine.value}", "${fine.worth}"), &[]);
    assert!(column.summary.failed);
    let said = |yaml: &str| bench.plan(yaml, &[]).err().unwrap().to_string();
    let circle = said(&SEARCH.replace("rows: 3", "rows: '${fine.value}'"));
    assert!(circle.contains("in a circle"), "{circle}");
    let transient = said(&SEARCH.replace("refined: {stage: list,", "refined: {stage: list, keep: false,"));
    assert!(transient.contains("not kept"), "{transient}");
}

/// The search, and steps that name items of the axis that is not known beforehand.
const NAMED: &str = "
  one: {stage: add, in: {terms: 'close.out[fine=1]'}}
  chosen: {stage: add, in: {terms: {by: fine, 2: tried_once.out, else: close.out}}}
  tried_once: {stage: emit, with: {value: 100}}
  all: {stage: add, in: {terms: {each: chosen.out, over: [fine]}}}
targets: [one, all]
";

#[test]
fn items_of_a_list_are_picked_and_chosen_by_name() {
    let yaml = SEARCH.replace("targets: [best]\n", &NAMED[1..]);
    for jobs in [1, 3] {
        let bench = Bench::new();
        let ran = bench.run_with(&yaml, &[], &Options { jobs, ..Options::default() });
        assert!(!ran.summary.failed, "{:?}", ran.events);
        // 7, 8 and 9; the third is taken from elsewhere.
        assert_eq!(ran.number(&bench.store, "one"), 8.0);
        assert_eq!(ran.number(&bench.store, "all"), 7.0 + 8.0 + 100.0);
        assert!(bench.run(&yaml, &[]).executed().is_empty());
        // Planned again with all items on record.
        assert_eq!(
            bench.plan(&yaml, &[]).unwrap_or_else(|faults| panic!("{faults}")).instances.len(),
            ran.plan.instances.len()
        );
    }
    let failure = |yaml: &str| {
        let ran = Bench::new().run(yaml, &[]);
        let told = ran.events.iter().find_map(|event| match event {
            Event::Failed { message, .. } => Some(message.clone()),
            _ => None,
        });
        told.expect("a failure")
    };
    let stranger = failure(&yaml.replace("[fine=1]", "[fine=7]"));
    assert!(stranger.contains("axis `fine` has no item `7`"), "{stranger}");
    let gap = failure(&yaml.replace(", else: close.out", ""));
    assert!(gap.contains("choosing by `fine` leaves out 0"), "{gap}");
}

#[test]
fn lists_that_become_known_are_walked_together() {
    let yaml = "
rockface: 1
axes: {a: {from: l.out}, b: {from: m.out}, c: {values: [10, 20, 30]}}
zip: [a, b, c]
steps:
  e: {stage: emit}
  l: {stage: list, in: {terms: e.out}, with: {rows: 3}}
  m: {stage: list, in: {terms: l.out}, with: {rows: 3}}
  x: {stage: emit, with: {value: '${a.value}'}}
  y: {stage: add, in: {terms: x.out}, with: {plus: '${b.value}'}}
  z: {stage: add, in: {terms: y.out}, with: {plus: '${c}'}}
  all: {stage: add, in: {terms: {each: z.out, over: [a]}}}
";
    let bench = Bench::new();
    let ran = bench.run(yaml, &[]);
    assert!(!ran.summary.failed, "{:?}", ran.events);
    // 1 2 3, 6 7 8 and 10 20 30.
    assert_eq!(ran.number(&bench.store, "all"), 6.0 + 21.0 + 60.0);
    assert_eq!(ran.summary.instances.len(), 3 + 3 * 3 + 1);
    let unequal = bench.run(&yaml.replace("terms: l.out}, with: {rows: 3}", "terms: l.out}, with: {rows: 2}"), &[]);
    let told = unequal.events.iter().any(|event| matches!(event, Event::Failed { message, .. } if message.contains("has 2 items, `a` has 3") || message.contains("has 2 items, `c` has 3")));
    assert!(unequal.summary.failed && told, "{:?}", unequal.events);
}

#[test]
fn a_list_that_only_an_axis_reads_is_no_target() {
    let bench = Bench::new();
    let plan = bench.plan(&SEARCH.replace("targets: [best]\n", ""), &[]).unwrap_or_else(|faults| panic!("{faults}"));
    let targets: Vec<&str> = plan.graph.targets.iter().map(|step| plan.graph.steps[*step].name.as_str()).collect();
    assert_eq!(targets, ["again", "best"]);
}

/// A list for each of two distances, which are equal but for their values.
const LISTS: &str = "
rockface: 1
axes:
  distance: {values: [10, 20]}
  image: {from: plan.out}
steps:
  flown: {stage: emit, with: {value: '${distance}'}}
  plan: {stage: list, in: {terms: flown.out}, with: {rows: 3}}
  seen: {stage: add, over: [image], in: {terms: plan.out}}
  noisy: {stage: draw, over: [image], in: {in: flown.out}, with: {sigma: 0}}
  once: {stage: emit, over: [image], with: {value: 5}}
  all: {stage: add, in: {terms: {each: seen.out, over: [image]}}}
  sum: {stage: add, in: {terms: {each: all.out, over: [distance]}}}
  rest: {stage: add, in: {terms: {each: once.out, over: [image]}}}
targets: [sum, rest]
";

#[test]
fn equal_lists_of_several_instances_are_one_axis() {
    for jobs in [1, 3] {
        let bench = Bench::new();
        let plan = bench.plan(LISTS, &[]).unwrap_or_else(|faults| panic!("{faults}"));
        // Both lists are made, whoever reads them, and what does not depend on the items.
        assert_eq!(plan.instances.len(), 4);
        let ran = bench.run_with(LISTS, &[], &Options { jobs, ..Options::default() });
        assert!(!ran.summary.failed, "{:?}", ran.events);
        // Each reads the list of its own distance: 3 (10 + 11 + 12) and 3 (20 + 21 + 22).
        assert_eq!(ran.number(&bench.store, "sum"), 288.0);
        assert_eq!(ran.number(&bench.store, "rest"), 15.0);
        let again = bench.run(LISTS, &[]);
        assert!(again.executed().is_empty() && again.digests() == ran.digests());
        // One list more on record than before: the other distances are as they were.
        let more = bench.run(LISTS, &["axes.distance.values=[10,20,30]"]);
        let new = more.executed();
        assert!(
            !new.contains(&"once[image=0]".into()) && !new.contains(&"seen[distance=10,image=0]".into()),
            "{new:?}"
        );
        assert_eq!(more.number(&bench.store, "sum"), 288.0 + 279.0);
    }
}

#[test]
fn lists_that_differ_are_told_with_their_places() {
    let told = |yaml: &str| {
        let bench = Bench::new();
        let ran = bench.run(yaml, &[]);
        let told = ran.events.iter().find_map(|event| match event {
            Event::Failed { message, hint, .. } => Some(format!("{message} {}", hint.clone().unwrap_or_default())),
            _ => None,
        });
        assert!(ran.summary.failed);
        // With both lists on record it is a fault of the plan.
        let planned = bench.plan(yaml, &[]).err().unwrap().to_string();
        assert!(planned.contains("takes its items from `plan.out`, and the lists differ"), "{planned}");
        told.expect("a failure")
    };
    let longer = told(&LISTS.replace("rows: 3", "rows: '${distance}'"));
    assert!(longer.contains("at [distance=10] has 10 items, at [distance=20] has 20 items"), "{longer}");
    assert!(longer.contains("or pick one: `plan.out[distance=10]`"), "{longer}");
    // Values that parameters take have to be equal too.
    let values = told(&LISTS.replace("{value: 5}", "{value: '${image.value}'}"));
    assert!(values.contains("`0` is {\"value\":10}") && values.contains("`0` is {\"value\":20}"), "{values}");
    let picked = LISTS
        .replace("from: plan.out", "from: 'plan.out[distance=20]'")
        .replace("{value: 5}", "{value: '${image.value}'}");
    let bench = Bench::new();
    assert_eq!(bench.run(&picked, &[]).number(&bench.store, "rest"), 63.0);
}

#[test]
fn lists_that_no_target_needs_are_not_compared() {
    let bench = Bench::new();
    let yaml = LISTS.replace("rows: 3", "rows: '${distance}'").replace("[sum, rest]", "[plan]");
    for _ in 0..2 {
        assert!(!bench.run(&yaml, &[]).summary.failed);
    }
}
