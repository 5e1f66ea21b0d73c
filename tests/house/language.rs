//! What pipelines can say: axes walked together, items before, included files, drawn designs, sweeps from outside.

#![expect(clippy::float_cmp, reason = "these numbers are small sums, exact")]

use rockface_engine::pipeline::{Overrides, Pipeline};
use rockface_engine::watch::Event;

use crate::lab::{Bench, Ran};

fn labels(ran: &Ran, step: &str) -> Vec<String> {
    let own = (0..ran.plan.instances.len()).filter(|i| ran.plan.step(*i).name == step);
    own.map(|i| ran.plan.point_text(i)).collect()
}

/// What is said about a pipeline that does not plan.
fn said(yaml: &str) -> String {
    match Bench::new().plan(yaml, &[]) {
        Ok(_) => panic!("this should not plan:\n{yaml}"),
        Err(faults) => faults.to_string(),
    }
}

const ZIPPED: &str = "
rockface: 1
axes: {a: {values: [1, 2, 3]}, b: {values: [10, 20, 30]}, c: {count: 2}}
zip: [a, b]
steps:
  x: {stage: emit, with: {value: '${a}'}}
  y: {stage: add, over: [c], in: {terms: x.out}, with: {plus: '${b}'}}
  one: {stage: add, in: {terms: 'y.out[a=2,c=0]'}}
  all: {stage: add, in: {terms: {each: y.out, over: [a, c]}}}
";

#[test]
fn zipped_axes_are_walked_together() {
    let bench = Bench::new();
    let ran = bench.run(ZIPPED, &[]);
    assert_eq!(labels(&ran, "x"), ["a=1", "a=2", "a=3"]);
    assert_eq!(labels(&ran, "y").len(), 6);
    assert_eq!(ran.number(&bench.store, "y[a=2,b=20,c=1]"), 22.0);
    assert_eq!(ran.number(&bench.store, "one"), 22.0);
    assert_eq!(ran.number(&bench.store, "all"), 132.0);
    let uneven = said(&ZIPPED.replace("[10, 20, 30]", "[10, 20]"));
    assert!(uneven.contains("axis `b` has 2 items, `a` has 3") && uneven.contains("test.yaml:4"), "{uneven}");
}

const CHAINED: &str = "
rockface: 1
seed: 3
axes: {epoch: {items: [e0, e1, e2, e3]}}
steps:
  start: {stage: emit, with: {value: 100}}
  worn: {stage: draw, in: {in: {from: 'rested.out[epoch=prev]', first: start.out}}}
  rested: {stage: add, in: {terms: worn.out}, with: {plus: 1}}
";

#[test]
fn an_item_reads_from_the_one_before() {
    let bench = Bench::new();
    let ran = bench.run(CHAINED, &[]);
    let (first, last) = (ran.number(&bench.store, "rested[epoch=e0]"), ran.number(&bench.store, "rested[epoch=e3]"));
    assert!(first != 101.0 && (first - 101.0).abs() < 6.0 && (last - 104.0).abs() < 12.0, "{first} {last}");
    assert!(bench.run(CHAINED, &[]).executed().is_empty());
    // One more epoch runs its own steps only.
    let more = bench.run(CHAINED, &["axes.epoch.items=[e0, e1, e2, e3, e4]"]);
    assert_eq!(more.executed(), ["rested[epoch=e4]", "worn[epoch=e4]"]);
}

#[test]
fn what_goes_back_says_where_it_begins() {
    let plain =
        said(&CHAINED.replace("{from: 'rested.out[epoch=prev]', first: start.out}", "'rested.out[epoch=prev]'"));
    assert!(plain.contains("no item before the first"), "{plain}");
    let no_first = said(&CHAINED.replace(", first: start.out", ""));
    assert!(no_first.contains("it is not said what the first item gets"), "{no_first}");
    let nothing = said(&CHAINED.replace("first: start.out", "first: null"));
    assert!(nothing.contains("cannot be left out at the first item"), "{nothing}");
    let circle = said(&CHAINED.replace("in: {terms: worn.out}", "over: [epoch], in: {terms: 'worn.out[epoch=e3]'}"));
    assert!(circle.contains("waits for itself"), "{circle}");
}

const SAMPLED: &str = "
rockface: 1
seed: 9
axes: {p: {sample: latin-hypercube, count: 8, over: {a: [0, 1], b: {log: [0.1, 10]}}}}
steps:
  x: {stage: emit, with: {value: '${p.a}'}}
  y: {stage: draw, in: {in: x.out}, with: {sigma: '${p.b}'}}
  all: {stage: add, in: {terms: {each: y.out, over: [p]}}}
";

#[test]
fn a_drawn_design_is_extended_without_running_what_was_drawn() {
    let bench = Bench::new();
    let ran = bench.run(SAMPLED, &[]);
    assert_eq!(labels(&ran, "y"), (0..8).map(|i| format!("p={i}")).collect::<Vec<_>>());
    let more = bench.run(SAMPLED, &["axes.p.count=16"]);
    assert_eq!(more.executed().len(), 17, "{:?}", more.executed());
    let sobol = &["axes.p.sample=sobol"];
    bench.run(SAMPLED, sobol);
    let more = bench.run(SAMPLED, &["axes.p.sample=sobol", "axes.p.count=9"]);
    assert_eq!(more.executed(), ["all", "x[p=8]", "y[p=8]"]);
    let stranger = said(&SAMPLED.replace("${p.a}", "${p.c}"));
    assert!(stranger.contains("axis `p` has no value `c`") && stranger.contains("${p.a}"), "{stranger}");
    // The values of an item together are a map.
    let whole = said(&SAMPLED.replace("${p.a}", "${p}"));
    assert!(whole.contains("expected a number") && whole.contains("`value`"), "{whole}");
    let text = said(&SAMPLED.replace("'${p.a}'", "'x${p}'"));
    assert!(text.contains("is a list or map and cannot stand inside a text"), "{text}");
}

#[test]
fn a_sweep_from_outside_makes_an_axis_of_a_parameter() {
    let yaml = "rockface: 1\nparams: {v: 1}\nsteps: {a: {stage: emit, with: {value: '${v}'}}}\n";
    let count = |sweep: &str| {
        let overrides = Overrides { sweep: vec![sweep.to_owned()], ..Overrides::default() };
        let pipeline = Pipeline::parse(yaml, "test.yaml", "test", ".".into(), &overrides).unwrap();
        (pipeline.document.axes[0].items.clone(), pipeline.document.axes[0].reseeds)
    };
    assert_eq!(count("params.v=0..2:3"), (vec!["0".to_owned(), "1".to_owned(), "2".to_owned()], false));
    assert_eq!(count("steps.a.with.value=0.5,7").0, ["0.5", "7"]);
}

#[test]
fn pipelines_are_put_together_from_files() {
    let bench = Bench::new();
    let write = |name: &str, text: &str| {
        let path = bench.folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    };
    write("parts/number.txt", "4");
    write(
        "parts/base.yaml",
        "rockface: 1\nseed: 5\ninclude: deeper.yaml\nsteps:\n  r: {stage: read, with: {path: number.txt}}\n",
    );
    write(
        "parts/deeper.yaml",
        "rockface: 1\nparams: {plus: 2}\naxes: {k: {count: 2}}\nsteps:\n  d: {stage: draw, over: [k], in: {in: r.out}}\n",
    );
    let yaml = "rockface: 1\ninclude: [parts/base.yaml]\nsteps:\n  s: {stage: add, in: {terms: r.out}, with: {plus: '${plus}'}}\n  t: {stage: add, in: {terms: {each: d.out, over: [k]}}}\n";
    let ran = bench.run(yaml, &[]);
    assert_eq!((ran.number(&bench.store, "s"), ran.plan.graph.seed), (6.0, 5));
    assert_eq!(bench.run(yaml, &["params.plus=3"]).executed(), ["s"]);

    let clash = bench.plan(&yaml.replace("  t:", "  d:"), &[]).err().unwrap().to_string();
    assert!(clash.contains("deeper.yaml:5:3") && clash.contains("step `d` is declared in"), "{clash}");
    write("parts/deeper.yaml", "rockface: 1\nsteps:\n  d: {stage: drow, in: {in: r.out}}\n");
    let fault = bench.plan("rockface: 1\ninclude: parts/base.yaml\n", &[]).err().unwrap().to_string();
    assert!(fault.contains("deeper.yaml:3:14") && fault.contains("did you mean `draw`?"), "{fault}");
    let absent = bench.plan("rockface: 1\ninclude: parts/bose.yaml\n", &[]).err().unwrap().to_string();
    assert!(absent.contains("test.yaml:2:10") && absent.contains("base.yaml"), "{absent}");
}

/// Everything that is said, as often as it is said.
fn faults_of(yaml: &str) -> (String, usize) {
    let said = said(yaml);
    let count = said.lines().filter(|line| line.starts_with("error")).count();
    (said, count)
}

#[test]
fn faults_of_every_kind_are_told_in_one_go_and_once() {
    let cases: &[(&str, &[&str])] = &[
        (
            "rockface: 1\nsteps:\n  a: {stage: ad, in: {terms: b.out}, kep: true}\n  b: {stage: add, in: {terms: zz.out}}\n",
            &["unknown key `kep`", "unknown stage `ad`", "unknown step `zz`"],
        ),
        (
            "rockface: 1\nsteps:\n  a: {stage: add, in: {terms: a.out}}\n  b: {stage: add, in: {terms: zz.out}, with: {bogus: 1}}\n",
            &["in a circle: a", "unknown step `zz`", "unknown parameter `bogus`"],
        ),
        (
            "rockface: 1\nsteps:\n  i: {stage: read, with: {path: nofile.txt, bogus: 1}}\n  b: {stage: add, in: {terms: i.outt}}\n",
            &["no output `outt`", "nofile.txt", "unknown parameter `bogus`"],
        ),
        (
            "rockface: 1\naxes: {k: {items: ['a,b', 'c]d', 'e=f', e, e]}}\nsteps: {a: {stage: emit, over: [k], wiht: {value: 2}}}\n",
            &["`a,b`", "`c]d`", "`e=f`", "`e` occurs twice", "unknown key `wiht`"],
        ),
        (
            "rockface: 1\nseed: .nan\nsteps:\n  a: {stage: emit, with: {value: -.inf, vale: 1}}\n  b: {stage: emitt, with: {value: 9e999}}\n",
            &["`.nan` is not a finite", "`-.inf` is not", "unknown stage `emitt`", "`9e999` is not"],
        ),
        (
            "rockface: 1\nparams: {p: '${q}', r: 1}\naxes: {k: {count: 2}}\nsteps:\n  a: {stage: emit, over: [j], with: {value: '${p}'}}\n  b: {stage: add, in: {terms: 'a.out[j=1]'}, with: {plus: '${rr}'}}\n  c: {stage: draw, over: [k], with: {sigma: '${k}', x: '${r}'}}\n  d: {stage: add, in: {terms: {each: b.out, over: [k]}}}\n",
            &[
                "`${q}` names no parameter",
                "unknown axis `j`",
                "unknown axis `j`",
                "`${rr}` names",
                "`in` (table)",
                "parameter `x`",
            ],
        ),
        (
            "rockface: 1\naxes: {k: {count: 2}, l: {count: 0}, m: {sample: grid, over: {a: [2, 1], b: [3, 2]}}}\nsteps:\n  a: {stage: emit, over: [k, l], with: {value: '${m.a}'}}\n  b: {stage: add, in: {terms: 'a.out[k=0,l=5]'}}\n  c: {stage: add, in: {terms: {by: l, x: a.out, y: a.outt}}, with: {plus: word}}\n",
            &[
                "a count from 1",
                "has no `count`",
                "`a`: the range",
                "`b`: the range",
                "no output `outt`",
                "`plus`: expected a number",
            ],
        ),
        (
            "rockface: 1\nnmae: x\nparams: {u: 1}\naxes: {k: {count: 2}}\nsteps: {a: {stage: emit, with: {value: many}}}\n",
            &[
                "unknown key `nmae`",
                "no step depends on axis `k`",
                "nothing mentions parameter `u`",
                "expected a number",
            ],
        ),
        (
            "rockface: 1\nparams: {l: [1], m: {k: {z: 5}}}\nsteps:\n  a: {stage: moody, with: {unless: 'v${l} ${m.q}'}}\n  b: {stage: read, with: {path: 'x${m} ${'}}\n  c: {stage: emit, with: {value: '${m.k.z}'}}\n",
            &["`${l}` is a list or map", "`m` has no value `q`", "`${m}` is a list or map", "without `}`", "one level"],
        ),
        (
            "rockface: 1\nparams: {m: {k: 1}}\nsteps:\n  a: {stage: emit, with: {value: '${m.q}'}}\n  b: {stage: emit, with: {value: '${mm.k}'}}\n",
            &["`m` has no value `q`", "`${mm.k}` names neither"],
        ),
    ];
    for (yaml, expected) in cases {
        let (said, count) = faults_of(yaml);
        for piece in *expected {
            assert!(said.contains(piece), "missing `{piece}` in:\n{said}");
        }
        assert_eq!(count, expected.len(), "{said}");
    }
}

#[test]
fn an_entry_of_a_map_that_nothing_mentions_is_a_fault() {
    let yaml = "rockface: 1\nparams: {m: {length: 1, lenght: 2}, whole: {a: 1}, none: {}}\nsteps:\n  a: {stage: emit, with: {value: '${m.length}'}}\n";
    let (said, count) = faults_of(yaml);
    assert!(said.contains("nothing mentions the entry `lenght` of parameter `m`"), "{said}");
    assert!(said.contains("write ${m.lenght} in a `with`, or remove it") && !said.contains("did you mean"), "{said}");
    // `whole` and `none` are mentioned by nothing at all.
    assert_eq!(count, 3, "{said}");
    // An entry that the command line adds may be meant to be another.
    let yaml = "rockface: 1\nparams: {m: {length: 1}}\nsteps: {a: {stage: emit, with: {value: '${m.length}'}}}\n";
    let said =
        Bench::new().plan(yaml, &["params.m.lenght=2"]).err().map(|faults| faults.to_string()).unwrap_or_default();
    assert!(said.contains("did you mean `length`? else write ${m.lenght} in a `with`"), "{said}");
}

#[test]
fn what_follows_from_a_told_fault_is_not_told_again() {
    for (yaml, only) in [
        // Sections behind a wrong key, of another format, or no maps.
        ("rockface: 1\naxis: {k: {count: 2}}\nsteps: {a: {stage: emit, over: [k]}}\n", "unknown key `axis`"),
        ("rockface: 1\naxes: [k]\nsteps: {a: {stage: emit, over: [k]}}\n", "expected `axes` to be a map"),
        ("rockface: 2\nsteps: {a: {stage: emitt}}\n", "pipeline format 2"),
        // Steps and axes that could not be read.
        ("rockface: 1\nsteps: {a: {stag: emit}, b: {stage: add, in: {terms: a.out}}}\ntargets: [a, b]\n", "`stag`"),
        ("rockface: 1\nsteps: {a: {stage: draw, inn: {in: b.out}}, b: {stage: emit}}\n", "unknown key `inn`"),
        ("rockface: 1\nsteps: {a: {stage: read, wiht: {path: x}}}\n", "unknown key `wiht`"),
        (
            "rockface: 1\naxes: {k: {items: [prev]}}\nsteps:\n  a: {stage: emit, with: {value: '${k}'}}\n  b: {stage: add, in: {terms: {each: a.out, over: [k]}}}\n",
            "`prev` cannot be an item",
        ),
        (
            "rockface: 1\naxes: {k: {count: 2}}\nsteps:\n  a: {stage: emit, ovr: [k]}\n  b: {stage: add, in: {terms: {each: a.out, over: [k]}}}\n",
            "unknown key `ovr`",
        ),
        // Wrong values at points that nobody needs.
        (
            "rockface: 1\naxes: {k: {items: [x, 1]}, l: {count: 2}}\nsteps:\n  a: {stage: emit, with: {value: '${k}'}}\n  b: {stage: add, in: {terms: 'a.out[k=1]'}}\n",
            "no step depends on axis `l`",
        ),
        (
            "rockface: 1\naxes: {l: {count: 2}}\nsteps: {a: {stage: read, with: {path: none.txt}}, b: {stage: emit}}\ntargets: [b]\n",
            "no step depends on axis `l`",
        ),
    ] {
        let (said, count) = faults_of(yaml);
        assert!(said.contains(only), "{said}");
        let asked = if only == "`stag`" { 2 } else { 1 }; // An unknown key, and none that is needed.
        assert_eq!(count, asked, "{said}");
    }
}

#[test]
fn a_text_that_looks_like_a_mention_is_told_from_one() {
    let yaml = "rockface: 1\nparams: {name: x}\nsteps: {a: {stage: moody, with: {unless: '$${name}/${name}'}}}\n";
    let plan = Bench::new().plan(yaml, &[]).unwrap_or_else(|faults| panic!("{faults}"));
    assert_eq!(plan.instances[0].params.canonical["unless"], "${name}/x");
    let unknown = said(&yaml.replace("/${name}", "/${nane}"));
    let help = "did you mean `name`?; write $${nane} for the text itself";
    assert!(unknown.contains("`${nane}` names neither a parameter nor an axis") && unknown.contains(help), "{unknown}");
}

#[test]
fn a_column_that_a_list_lacks_is_told_with_those_it_has() {
    let yaml = "rockface: 1\naxes: {row: {from: rows.out}}\nsteps:\n  one: {stage: emit}\n  rows: {stage: list, in: {terms: one.out}}\n  x: {stage: emit, with: {value: '${row.valu}'}}\n";
    let ran = Bench::new().run(yaml, &[]);
    let told = ran.events.iter().find_map(|event| match event {
        Event::Failed { message, hint, .. } => Some((message.clone(), hint.clone())),
        _ => None,
    });
    let (message, hint) = told.unwrap();
    let expected = "step `x`: `${row.valu}`: axis `row` has no column `valu`; the table behind it has value";
    assert!(message.contains(expected), "{message}");
    assert_eq!(hint.as_deref(), Some("did you mean `${row.value}`?"));
}

#[test]
fn sweeping_one_axis_twice_is_a_fault() {
    let yaml = "rockface: 1\nparams: {v: 1}\nsteps: {a: {stage: emit, with: {value: '${v}'}}, b: {stage: emit}}\n";
    let swept = |sweep: &[&str]| {
        let overrides = Overrides { sweep: sweep.iter().map(ToString::to_string).collect(), ..Overrides::default() };
        Pipeline::parse(yaml, "test.yaml", "test", ".".into(), &overrides).map_err(|faults| faults.to_string())
    };
    let twice = swept(&["params.v=1", "params.v=2"]).unwrap_err();
    assert!(twice.contains("`v` is swept twice") && twice.contains("--sweep params.v=1,2"), "{twice}");
    let two = swept(&["params.v=1", "steps.b.with.v=2"]).unwrap_err();
    assert!(two.contains("`v` is swept twice"), "{two}");
    let one = swept(&["steps.a.with.value=1,2", "steps.b.with.value=1,2", "params.v=1..2:2"]).unwrap();
    assert_eq!(one.document.axes.len(), 2);
}
