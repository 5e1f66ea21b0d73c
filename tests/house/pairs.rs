//! Inputs gathered by pairs: each item is read with its partners, which a list tells.

#![expect(clippy::float_cmp, reason = "these numbers are small sums, exact")]

use rockface_engine::run::Options;
use rockface_engine::watch::Event;

use crate::cli::House;
use crate::lab::{Bench, Ran};

/// Five numbers; each is summed with its neighbours.
const ROW: &str = "
rockface: 1
axes: {k: {values: [1, 2, 3, 4, 5]}}
steps:
  begun: {stage: emit, with: {value: 9}}
  pairs: {stage: couple, in: {after: begun.out}, with: {pairs: ['1+2', '2+3', '3+4', '4+5']}}
  made: {stage: emit, keep: false, with: {value: '${k}'}}
  near: {stage: add, over: [k], in: {terms: {each: made.out, over: [k], paired: pairs.pairs}}}
  all: {stage: add, in: {terms: {each: near.out, over: [k]}}}
targets: [all]
";

fn plan_of(bench: &Bench, yaml: &str) -> rockface_engine::plan::Plan {
    bench.plan(yaml, &[]).unwrap_or_else(|faults| panic!("{faults}"))
}

fn numbers(ran: &Ran, bench: &Bench) -> Vec<f64> {
    (1..=5).map(|k| ran.number(&bench.store, &format!("near[k={k}]"))).collect()
}

#[test]
fn each_item_is_read_with_its_partners() {
    for jobs in [1, 3] {
        let bench = Bench::new();
        let plan = plan_of(&bench, ROW);
        let waits: Vec<usize> = plan.waits.iter().flatten().map(|wait| wait.count).collect();
        assert_eq!(
            (plan.instances.len(), waits),
            (2, vec![5, 5, 1]),
            "nothing is known but the list and what it comes from"
        );
        let ran = bench.run_with(ROW, &[], &Options { jobs, ..Options::default() });
        assert!(!ran.summary.failed, "{:?}", ran.events);
        assert_eq!(numbers(&ran, &bench), [3.0, 6.0, 9.0, 12.0, 9.0]);
        assert_eq!(ran.number(&bench.store, "all"), 39.0);
        assert_eq!(ran.executed().len(), 2 + 5 + 5 + 1, "every value is made once");
        let again = bench.run(ROW, &[]);
        assert!(again.executed().is_empty() && again.digests() == ran.digests());
        assert_eq!(plan_of(&bench, ROW).instances.len(), 13);
    }
}

#[test]
fn a_change_runs_what_reads_it_and_no_more() {
    let bench = Bench::new();
    bench.run(ROW, &[]);
    let other = bench.run(&ROW.replace("[1, 2, 3, 4, 5]", "[1, 2, 3, 4, 7]").replace("4+5", "4+7"), &[]);
    // The partners of 4 are 3 and 7 now; that of 5 is not there.
    assert_eq!(other.executed(), ["all", "made[k=7]", "near[k=4]", "near[k=7]", "pairs"]);
    let more = bench.run(&ROW.replace("'1+2', ", ""), &[]);
    assert_eq!(more.executed(), ["all", "near[k=1]", "near[k=2]", "pairs"]);
    assert_eq!(more.number(&bench.store, "near[k=1]"), 1.0, "an item without a partner is read alone");
}

/// A list for each item of another axis; one of them is chosen by it.
const LISTS: &str = "
rockface: 1
axes: {k: {values: [1, 2, 3]}, reach: {values: [1, 2]}}
steps:
  pairs: {stage: couple, with: {pairs: ['1+2', '${reach}+3']}}
  chosen: {stage: couple, with: {pairs: ['1+3']}}
  made: {stage: emit, with: {value: '${k}'}}
  near: {stage: add, over: [k], in: {terms: {each: made.out, over: [k], paired: {by: reach, 1: chosen.pairs, 2: pairs.pairs}}}}
  all: {stage: add, in: {terms: {each: near.out, over: [k]}}}
";

#[test]
fn there_may_be_a_list_for_each_item_of_another_axis() {
    let bench = Bench::new();
    let ran = bench.run(&format!("{LISTS}targets: [all]\n"), &[]);
    assert!(!ran.summary.failed, "{:?}", ran.events);
    let sums = |label: &str| ran.number(&bench.store, label);
    assert_eq!([sums("all[reach=1]"), sums("all[reach=2]")], [4.0 + 2.0 + 4.0, 3.0 + 6.0 + 5.0]);
    // Of two lists the one that a picked item needs.
    let bench = Bench::new();
    let one = "  one: {stage: add, in: {terms: 'all.out[reach=1]'}}\ntargets: [one]\n";
    let ran = bench.run(&format!("{LISTS}{one}"), &[]);
    assert_eq!(
        ran.executed().iter().filter(|label| label.starts_with("pairs") || label.starts_with("chosen")).count(),
        1
    );
    assert_eq!(ran.number(&bench.store, "one"), 10.0);
}

#[test]
fn a_list_is_needed_before_what_waits_for_it_and_its_failure_ends_there() {
    let bench = Bench::new();
    let ran = bench.run(ROW, &["steps.pairs.with.pairs=[\"1\"]"]);
    let failed: Vec<String> = ran
        .events
        .iter()
        .filter_map(|event| match event {
            Event::Failed { step, message, .. } => Some(format!("{step}: {message}")),
            _ => None,
        })
        .collect();
    assert!(ran.summary.failed && failed.len() == 1 && failed[0].contains("`1` is no pair"), "{failed:?}");
}

#[test]
fn what_all_consumers_wait_for_is_made_before_the_values_that_they_use_up() {
    let yaml = "
rockface: 1
axes: {k: {values: [1, 2, 3]}}
steps:
  begun: {stage: emit, with: {value: 9}}
  made: {stage: emit, keep: false, with: {value: '${k}'}}
  shared: {stage: add, in: {terms: begun.out}}
  used: {stage: draw, in: {in: made.out, after: shared.out}}
targets: [used]
";
    let ran = Bench::new().run_with(yaml, &[], &Options { jobs: 1, ..Options::default() });
    let mut begun = ran.events.iter().filter_map(|event| match event {
        Event::Started { step, .. } => Some(step.as_str()),
        _ => None,
    });
    assert_eq!([begun.next(), begun.next()], [Some("begun"), Some("shared")]);
}

/// The pairs are made long before the items that they are of.
const LATE: &str = "
rockface: 1
axes: {k: {from: rows.out, reseeds: false}}
steps:
  pairs: {stage: couple, with: {pairs: ['0+1', '2+0']}}
  slow: {stage: toil, with: {value: 4}}
  rows: {stage: list, in: {terms: slow.out}, with: {rows: 3}}
  made: {stage: emit, keep: false, with: {value: '${k.value}'}}
  near: {stage: add, over: [k], in: {terms: {each: made.out, over: [k], paired: pairs.pairs}}}
  all: {stage: add, in: {terms: {each: near.out, over: [k]}}}
targets: [all, pairs]
";

#[test]
fn a_list_that_was_made_long_ago_tells_what_is_expanded_later() {
    let bench = Bench::new();
    let ran = bench.run(LATE, &[]);
    assert!(!ran.summary.failed, "{:?}", ran.events);
    // 4, 5 and 6: all three, the first two, the first and the last.
    assert_eq!(ran.number(&bench.store, "all"), 15.0 + 9.0 + 10.0);
    assert!(bench.run(LATE, &[]).executed().is_empty());
    // The list on record, the items not yet.
    let other = bench.run(LATE, &["steps.slow.with.value=5"]);
    assert_eq!(other.number(&bench.store, "all"), 18.0 + 11.0 + 12.0);
}

#[test]
fn steps_that_wait_for_each_other_by_pairs_are_a_failure() {
    // Once 1 and 2 are known to be a pair, the first item needs the second, which goes back to the first.
    let back = "
rockface: 1
axes: {k: {values: [1, 2, 3]}}
steps:
  begun: {stage: emit}
  pairs: {stage: couple, with: {pairs: ['1+2']}}
  x: {stage: add, over: [k], in: {terms: {from: 'near.out[k=prev]', first: begun.out}}}
  near: {stage: add, over: [k], in: {terms: {each: x.out, over: [k], paired: pairs.pairs}}}
targets: [near]
";
    // The pairs follow from what they tell.
    let ring = "
rockface: 1
axes: {k: {values: [1, 2, 3]}}
steps:
  begun: {stage: emit}
  x: {stage: add, over: [k], in: {terms: {from: 'near.out[k=prev]', first: begun.out}}}
  sum: {stage: add, in: {terms: {each: x.out, over: [k]}}}
  pairs: {stage: couple, in: {after: sum.out}, with: {pairs: ['1+2']}}
  made: {stage: emit, with: {value: '${k}'}}
  near: {stage: add, over: [k], in: {terms: {each: made.out, over: [k], paired: pairs.pairs}}}
targets: [near]
";
    for yaml in [back, ring] {
        let ran = Bench::new().run(yaml, &[]);
        let told = ran.events.iter().any(
            |event| matches!(event, Event::Failed { message, .. } if message.contains("waits for steps that wait for it")),
        );
        assert!(ran.summary.failed && told, "{:?}", ran.events);
    }
}

#[test]
fn the_axis_that_chooses_the_list_is_one_of_the_step() {
    let yaml = LISTS.replace("'${reach}+3'", "'2+3'") + "targets: [all]\n";
    let bench = Bench::new();
    let ran = bench.run(&yaml, &[]);
    let sums = |label: &str| ran.number(&bench.store, label);
    assert_eq!([sums("all[reach=1]"), sums("all[reach=2]")], [4.0 + 2.0 + 4.0, 3.0 + 6.0 + 5.0]);
}

#[test]
fn what_leads_to_the_pairs_comes_first_so_that_values_are_made_once() {
    let yaml = APART.replace("  all:", "  other: {stage: add, in: {terms: made.out}, with: {plus: 1}}\n  all:")
        + "targets: [all, other]\n";
    let bench = Bench::new();
    let ran = bench.run_with(&yaml, &[], &Options { jobs: 1, ..Options::default() });
    let made =
        ran.events.iter().filter(|event| matches!(event, Event::Started { step, .. } if step.starts_with("made")));
    assert_eq!((made.count(), ran.number(&bench.store, "all")), (6, 42.0));
}

/// Six values that take their time, of which two each are summed.
const APART: &str = "
rockface: 1
axes: {k: {values: [1, 2, 3, 4, 5, 6]}}
steps:
  pairs: {stage: couple, with: {pairs: ['1+4', '2+5', '3+6']}}
  made: {stage: toil, keep: false, with: {value: '${k}'}}
  near: {stage: add, over: [k], in: {terms: {each: made.out, over: [k], paired: pairs.pairs}}}
  all: {stage: add, in: {terms: {each: near.out, over: [k]}}}
";

#[test]
fn what_a_consumer_needs_is_made_together_so_that_few_values_are_held() {
    let bench = Bench::new();
    let ran = bench.run_with(APART, &[], &Options { jobs: 1, ..Options::default() });
    assert_eq!(ran.number(&bench.store, "all"), 42.0);
    let begun = ran.events.iter().filter_map(|event| match event {
        Event::Started { step, .. } => step.strip_prefix("made[k=").map(|item| item.trim_end_matches(']').to_owned()),
        _ => None,
    });
    assert_eq!(begun.collect::<Vec<_>>(), ["1", "4", "2", "5", "3", "6"]);
}

#[test]
fn what_is_no_list_of_pairs_is_told() {
    let said = |from: &str, to: &str| Bench::new().plan(&ROW.replace(from, to), &[]).err().expect(to).to_string();
    let told = said("paired: pairs.pairs", "paired: begun.out");
    assert!(told.contains("`begun.out` is a table, not a list of pairs"), "{told}");
    let told = said("pairs: {stage: couple,", "pairs: {stage: couple, keep: false,");
    assert!(told.contains("`pairs` is not kept") && told.contains("remove `keep: false`"), "{told}");
    let told = said("near: {stage: add, over: [k],", "near: {stage: add,");
    assert!(told.contains("step `near` has no item of axis `k` that pairs could be of"), "{told}");
    let told = said("paired: pairs.pairs", "paired: {each: pairs.pairs, over: [k]}");
    assert!(told.contains("`paired` is one list of pairs"), "{told}");
    let told = said("paired: pairs.pairs", "paired: pears.pairs");
    assert!(told.contains("unknown step `pears`") && told.contains("did you mean `pairs`?"), "{told}");
    let told = said("{each: made.out, over: [k], paired", "{each: made.out, over: [k, k], paired");
    assert!(told.contains("a list of pairs tells the items of one axis") || told.contains("twice"), "{told}");
}

/// A block of three images, each matched with its neighbours; the pairs come from outside the part.
const BLOCK: &str = "rockface: 1
seed: 5
parts: {matching: part.yaml}
axes: {reach: {values: [1, 2]}}
steps:
  face:   {stage: synthesise-face, with: {width_m: 8, height_m: 5, spacing_m: 0.1}}
  survey: {stage: plan-survey, in: {mesh: face.mesh}, with: {block: strips, width_px: 160, height_px: 120, focal_px: 130, distance_m: 8, columns: 4, rows: 1}}
  near:   {stage: select-pairs, in: {cameras: survey.cameras, mesh: face.mesh}, with: {neighbours: 1}}
  far:    {stage: select-pairs, in: {cameras: survey.cameras, mesh: face.mesh}, with: {neighbours: 3}}
  matched: {use: matching, in: {mesh: face.mesh, cameras: survey.cameras, pairs: PAIRS}}
targets: [matched]
";

/// The part: without a list, an image is given all others.
const PART: &str = "rockface: 1
part: matching
in:
  mesh: {kind: mesh}
  cameras: {kind: cameras}
  pairs: {kind: pairs}
out: {surface: surface.surface}
axes: {image: {from: in.cameras, reseeds: false}}
steps:
  seen:    {stage: project-depth, keep: false, with: {image: '${image}'}, in: {mesh: in.mesh, cameras: in.cameras}}
  matched: {stage: match-image, keep: false, with: {image: '${image}', spacing_px: 12}, in: {depths: {each: seen.depth, over: [image], paired: in.pairs}, noisy: in.cameras, pairs: in.pairs}}
  cells:   {stage: grid-depth, keep: false, with: {cell_m: 0.1}, in: {depth: matched.depth}}
  surface: {stage: fuse-grids, in: {grids: {each: cells.grid, over: [image]}}}
";

#[test]
fn a_part_matches_a_block_by_the_pairs_it_is_given_and_its_plan_says_what_is_not_known() {
    let house = House::new(&BLOCK.replace("PAIRS", "{by: reach, 1: near.pairs, 2: far.pairs}"));
    std::fs::write(house.path("part.yaml"), PART).unwrap();
    let run = |arguments: &[&str]| {
        let (code, out, err) = house.rockface(arguments);
        assert_eq!(code, Some(0), "{out}{err}");
        out
    };
    run(&["run", "p.yaml", "--target", "survey"]);
    let out = run(&["plan", "p.yaml"]);
    for step in ["matched/seen", "matched/matched", "matched/cells", "matched/surface"] {
        let line = out.lines().find(|line| line.starts_with(step)).unwrap_or_else(|| panic!("{out}"));
        assert!(line.contains("waits for the pairs of `near`, which has not run"), "{out}");
    }
    assert!(out.contains("8 of match-image"), "{out}");
    let (code, _, err) = house.rockface(&["explain", "p.yaml", "matched/surface"]);
    assert!(code == Some(2) && err.contains("the pairs that tell what is gathered are made by step `near`"), "{err}");
    let drawn = run(&["graph", "p.yaml"]);
    assert!(drawn.contains("unknown instances over"), "{drawn}");
    run(&["run", "p.yaml"]);
    assert!(run(&["plan", "p.yaml"]).contains("0 run, 0 depend on what runs"));
    let drawn = run(&["graph", "p.yaml"]);
    assert!(drawn.contains("8 instances over") && drawn.contains("pairs of"), "{drawn}");
}

/// A part whose list of pairs may be left out.
const PARTED: &str = "
rockface: 1
parts:
  p:
    in: {pairs: {kind: pairs, optional: true}}
    out: {o: all.out}
    axes: {k: {values: [1, 2, 3]}}
    steps:
      made: {stage: emit, with: {value: '${k}'}}
      near: {stage: add, over: [k], in: {terms: {each: made.out, over: [k], paired: in.pairs}}}
      all: {stage: add, in: {terms: {each: near.out, over: [k]}}}
steps:
  pairs: {stage: couple, with: {pairs: ['1+2']}}
  some: {use: p, in: {pairs: pairs.pairs}}
  every: {use: p}
  both: {stage: add, in: {terms: some.o}, with: {plus: 0.5}}
  all: {stage: add, in: {terms: every.o}, with: {plus: 0.5}}
";

#[test]
fn a_part_without_its_list_gathers_all_and_a_choice_from_it_is_told() {
    let bench = Bench::new();
    let ran = bench.run(PARTED, &[]);
    assert_eq!([ran.number(&bench.store, "both"), ran.number(&bench.store, "all")], [9.5, 18.5]);
    let choice = PARTED.replace("paired: in.pairs", "paired: {by: k, else: in.pairs}");
    let told = bench.plan(&choice, &[]).err().expect("a fault").to_string();
    assert!(told.contains("part `p` chooses pairs from `in.pairs`, which is left out here"), "{told}");
}
