//! Parts: what their uses come to, and what is said where one is declared or used wrongly.

#![expect(clippy::float_cmp, reason = "these numbers are small sums, exact")]

use rockface_core::PartText;
use rockface_engine::pipeline::{Overrides, Pipeline};
use rockface_engine::plan::plan;

use crate::lab::{Bench, Ran};

fn steps(ran: &Ran) -> Vec<&str> {
    ran.plan.graph.steps.iter().map(|step| step.name.as_str()).collect()
}

fn keys(ran: &Ran) -> Vec<(String, String)> {
    let mut keys: Vec<_> = ran
        .summary
        .instances
        .iter()
        .enumerate()
        .map(|(i, instance)| (ran.plan.point_text(i), instance.key.map(|key| key.to_string()).unwrap_or_default()))
        .collect();
    keys.sort();
    keys
}

fn said(yaml: &str) -> String {
    match Bench::new().plan(yaml, &[]) {
        Ok(_) => panic!("this should not plan:\n{yaml}"),
        Err(faults) => faults.to_string(),
    }
}

const TWICE: &str = "
rockface: 1
parts:
  noisy:
    doc: Adds noise, and then a number.
    params:
      sigma: {type: number, min: 0, default: 2, doc: scale of the noise}
      plus: {type: number}
    in: {start: table}
    out: {sum: sum.out}
    steps:
      drawn: {stage: draw, in: {in: in.start}, with: {sigma: '${sigma}'}}
      sum: {stage: add, in: {terms: drawn.out}, with: {plus: '${plus}'}}
params: {ten: 10}
axes: {k: {count: 3}}
steps:
  zero: {stage: emit, with: {value: 0}}
  one: {use: noisy, in: {start: zero.out}, with: {plus: 1}}
  many: {use: noisy, over: [k], in: {start: zero.out}, with: {sigma: 0, plus: '${ten}'}}
  all: {stage: add, in: {terms: {each: many.sum, over: [k]}}}
  end: {stage: add, in: {terms: one.sum}}
";

#[test]
fn a_use_stands_for_the_steps_of_its_part() {
    let bench = Bench::new();
    let ran = bench.run(TWICE, &[]);
    assert_eq!(steps(&ran).len(), 7);
    assert!(["one/drawn", "one/sum", "many/drawn", "many/sum"].iter().all(|name| steps(&ran).contains(name)));
    assert_eq!(ran.number(&bench.store, "all"), 30.0);
    let drawn = ran.number(&bench.store, "one/drawn");
    assert!(drawn != 0.0 && ran.number(&bench.store, "end") == drawn + 1.0);
    // A value inside can be set, and swept, by the full name.
    let set = bench.run(TWICE, &["steps.many/sum.with.plus=2"]);
    assert_eq!(set.number(&bench.store, "all"), 6.0);
    let unknown = bench.plan(TWICE, &["steps.many/sun.with.plus=2"]).err().unwrap().to_string();
    assert!(unknown.contains("no step `many/sun`") && unknown.contains("`many/sum`"), "{unknown}");
}

#[test]
fn inner_values_are_swept_and_uses_are_targets() {
    let overrides = Overrides { sweep: vec!["steps.one/sum.with.plus=1,2".into()], ..Overrides::default() };
    let bench = Bench::new();
    let pipeline = Pipeline::parse(TWICE, "test.yaml", "test", ".".into(), &overrides).unwrap();
    let planned = plan(&pipeline, &["one".to_owned()], bench.stages, &bench.store).unwrap();
    let labels: Vec<String> = (0..planned.instances.len()).map(|i| planned.label(i)).collect();
    assert_eq!(labels, ["zero", "one/drawn", "one/sum[plus=1]", "one/sum[plus=2]"]);
}

#[test]
fn two_uses_draw_their_own_numbers_and_labels_share_them() {
    let bench = Bench::new();
    let two = TWICE.replace("sigma: 0, plus: '${ten}'", "plus: 1").replace("params: {ten: 10}\n", "");
    let ran = bench.run(&two, &[]);
    let drawn = |name: &str| ran.number(&bench.store, name);
    assert!(drawn("one/drawn") != drawn("many/drawn[k=0]") && drawn("many/drawn[k=0]") != drawn("many/drawn[k=1]"));
    let shared =
        two.replace("with: {sigma: '${sigma}'}", "with: {sigma: '${sigma}'}, stream: {label: noise, axes: []}");
    let ran = bench.run(&shared, &[]);
    assert_eq!(ran.number(&bench.store, "one/drawn"), ran.number(&bench.store, "many/drawn[k=2]"));
}

/// The same graph, once written out and once by a part whose streams are labelled.
const FLAT: &str = "
rockface: 1
seed: 4
axes: {k: {count: 2}, epoch: {items: [pre, post]}}
steps:
  zero: {stage: emit, with: {value: 0}}
  drawn: {stage: draw, over: [k, epoch], stream: {label: a}, in: {in: zero.out}}
  pair: {stage: add, in: {terms: {each: drawn.out, over: [epoch]}}}
  late: {stage: add, in: {terms: 'drawn.out[epoch=post]'}, with: {plus: 5}}
";
const PARTED: &str = "
rockface: 1
seed: 4
parts:
  survey:
    params: {label: {type: text}}
    in: {start: table}
    out: {pair: pair.out, late: late.out}
    axes: {epoch: {items: [pre, post]}}
    steps:
      drawn: {stage: draw, over: [epoch], stream: {label: '${label}'}, in: {in: in.start}}
      pair: {stage: add, in: {terms: {each: drawn.out, over: [epoch]}}}
      late: {stage: add, in: {terms: 'drawn.out[epoch=post]'}, with: {plus: 5}}
axes: {k: {count: 2}}
steps:
  zero: {stage: emit, with: {value: 0}}
  s: {use: survey, over: [k], in: {start: zero.out}, with: {label: a}}
";

#[test]
fn recipes_do_not_know_of_parts() {
    let bench = Bench::new();
    let flat = bench.run(FLAT, &[]);
    assert_eq!(flat.executed().len(), 9);
    let parted = bench.run(PARTED, &[]);
    assert!(parted.executed().is_empty(), "{:?}", parted.executed());
    assert_eq!(keys(&flat), keys(&parted));
}

#[test]
fn parts_use_parts_and_hand_on_choices_and_lists() {
    let bench = Bench::new();
    let yaml = "
rockface: 1
parts:
  inner:
    params: {plus: {type: number}}
    in: {terms: table}
    out: {sum: sum.out}
    steps: {sum: {stage: add, in: {terms: in.terms}, with: {plus: '${plus}'}}}
  outer:
    params: {n: {type: integer, min: 1, default: 2}, plus: {type: number, default: 1}}
    in: {terms: table, extra: {kind: table, optional: true}}
    out: {total: total.sum, rows: each.sum, more: more.out}
    axes: {i: {count: '${n}'}}
    steps:
      each: {use: inner, over: [i], in: {terms: in.terms}, with: {plus: '${plus}'}}
      total: {use: inner, in: {terms: {each: each.sum, over: [i]}}, with: {plus: 0}}
      more: {stage: draw, in: {in: in.extra}, with: {sigma: 0}}
params: {count: 3}
axes: {side: {items: [l, r]}}
steps:
  l: {stage: emit, with: {value: 1}}
  r: {stage: emit, with: {value: 2}}
  o: {use: outer, in: {terms: {by: side, l: l.out, r: r.out}}, with: {n: '${count}'}}
  both: {stage: add, in: {terms: {each: o.total, over: [side]}}}
  picked: {stage: add, in: {terms: 'o.total[side=r]'}}
  third: {stage: add, in: {terms: 'o.rows[side=l,o/i=2]'}}
";
    let lacking = said(yaml);
    assert!(lacking.contains("`o/more` is not given its input `in`") && lacking.contains("used here"), "{lacking}");
    let yaml = &yaml.replace("r: r.out}}, with: {n", "r: r.out}, extra: l.out}, with: {n");
    let ran = bench.run(yaml, &[]);
    assert_eq!(ran.number(&bench.store, "picked"), 9.0);
    assert_eq!(ran.number(&bench.store, "both"), 15.0);
    assert_eq!(ran.number(&bench.store, "third"), 2.0);
    assert!(steps(&ran).contains(&"o/each/sum"), "{:?}", steps(&ran));
    // An axis inside has a full name too.
    assert_eq!(bench.run(yaml, &["axes.o/i.count=4"]).number(&bench.store, "both"), 20.0);
}

/// A part that takes a map and mentions a value of it.
const AT: &str = "
rockface: 1
parts:
  at:
    params: {point: {type: map}}
    out: {o: s.out}
    steps: {s: {stage: emit, with: {value: '${point.a}'}}}
params: {m: {a: 3, n: {x: 4}}, both: '${m.a}'}
axes: {d: {sample: sobol, count: 2, over: {a: [10, 20], b: [0, 1]}}}
steps:
  given: {use: at, with: {point: {a: 2}}}
  named: {use: at, with: {point: '${m}'}}
  drawn: {use: at, over: [d], with: {point: '${d}'}}
  own: {stage: add, in: {terms: given.o}, with: {plus: '${m.a}'}}
  third: {stage: add, in: {terms: given.o}, with: {plus: '${both}'}}
";

#[test]
fn values_inside_maps_are_mentioned() {
    let bench = Bench::new();
    let ran = bench.run(AT, &[]);
    let number = |step: &str| ran.number(&bench.store, step);
    assert_eq!((number("given/s"), number("named/s"), number("own"), number("third")), (2.0, 3.0, 5.0, 5.0));
    assert!((10.0..20.0).contains(&number("drawn/s[d=1]")) && number("drawn/s[d=0]") != number("drawn/s[d=1]"));
    assert_eq!(bench.run(AT, &["params.m.a=7"]).number(&bench.store, "own"), 9.0);
    for (from, to, pieces) in [
        ("${point.a}", "${point.aa}", &["parameter `point` has no value `aa`", "did you mean `a`?", "given here"][..]),
        ("point: {a: 2}", "point: {b: 2}", &["parameter `point` has no value `a`", "test.yaml:7", "test.yaml:11"]),
        ("point: '${d}'", "point: '${d.a}'", &["parameter `point` has no value `a`"]),
        ("plus: '${m.a}'", "plus: '${m.n.x}'", &["`m` has no value `n.x`"]),
        ("plus: '${m.a}'", "plus: '${m.z}'", &["`m` has no value `z`", "test.yaml:14"]),
        ("both: '${m.a}'", "both: '${m.z}'", &["`m` has no value `z`"]),
        ("${point.a}", "${point.b}", &["parameter `point` has no value `b`"]),
    ] {
        let said = said(&AT.replace(from, to));
        assert!(pieces.iter().all(|piece| said.contains(piece)), "{to}\n{said}");
    }
    let drawn = AT.replace("point: {a: 2}", "point: '${d}'").replace("  named: {use: at, with: {point: '${m}'}}\n", "");
    let strange = said(&drawn.replace("${point.a}", "${point.c}"));
    assert!(strange.contains("axis `d` has no value `c`"), "{strange}");
}

#[test]
fn without_targets_a_use_that_nothing_reads_is_made_and_no_more() {
    const PICK: &str = "
rockface: 1
parts:
  two:
    out: {a: a.out, b: b.out}
    steps: {zero: {stage: emit}, a: {stage: add, in: {terms: zero.out}}, b: {stage: add, in: {terms: zero.out}}}
  outer:
    out: {o: own.out}
    steps: {inner: {use: two}, own: {stage: add, in: {terms: inner.a}}}
steps:
  s: {use: two}
  t: {use: two}
  o: {use: outer}
  end: {stage: add, in: {terms: t.a}}
";
    let bench = Bench::new();
    let ran = bench.run(PICK, &[]);
    let mut made: Vec<String> = (0..ran.plan.instances.len()).map(|instance| ran.plan.label(instance)).collect();
    made.sort();
    assert_eq!(made, ["end", "o/inner/a", "o/inner/zero", "o/own", "s/a", "s/b", "s/zero", "t/a", "t/zero"]);
}

#[test]
fn parts_stand_in_files_and_come_with_the_program() {
    const SHIPPED: &[PartText] = &[PartText {
        name: "rockface/plus",
        text: "rockface: 1\npart: plus\nparams: {path: {type: path}}\nin: {start: table}\nout: {sum: sum.out}\nsteps:\n  r: {stage: read, with: {path: '${path}'}}\n  sum: {stage: add, in: {terms: {by: x, a: in.start, b: r.out}}}\n",
    }];
    let bench = Bench::new();
    let write = |name: &str, text: &str| {
        let path = bench.folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    };
    write("four.txt", "4");
    write("parts/five.txt", "5");
    // A path in the part is relative to its file, one that a use gives to the file of the use.
    write(
        "parts/sum.yaml",
        "rockface: 1\npart: sum\nparams: {path: {type: path}}\nout: {sum: sum.sum}\nsteps:\n  sum: {use: both.yaml, with: {path: '${path}'}}\n",
    );
    write(
        "parts/both.yaml",
        "rockface: 1\npart: both\nparams: {path: {type: path}}\nout: {sum: sum.out}\naxes: {x: {items: [a, b]}}\nsteps:\n  own: {stage: read, with: {path: five.txt}}\n  given: {stage: read, with: {path: '${path}'}}\n  one: {stage: add, in: {terms: {by: x, a: own.out, b: given.out}}}\n  sum: {stage: add, in: {terms: {each: one.out, over: [x]}}}\n",
    );
    let yaml = "rockface: 1\nsteps:\n  s: {use: parts/sum.yaml, with: {path: four.txt}}\n";
    let ran = bench.run(yaml, &[]);
    assert_eq!(ran.number(&bench.store, "s/sum/sum"), 9.0);

    let overrides = Overrides { parts: SHIPPED, ..Overrides::default() };
    let planned = |yaml: &str| {
        let folder = bench.folder.path().to_owned();
        let pipeline = Pipeline::parse(yaml, "test.yaml", "test", folder, &overrides).map_err(|f| f.to_string())?;
        plan(&pipeline, &[], bench.stages, &bench.store).map_err(|faults| faults.to_string())
    };
    let yaml = "rockface: 1\nsteps:\n  e: {stage: emit}\n  p: {use: rockface/plus, in: {start: e.out}, with: {path: four.txt}}\n";
    let fault = planned(yaml).err().unwrap();
    assert!(
        fault.contains("rockface/plus:8") && fault.contains("has no axis `x`") && fault.contains("used here"),
        "{fault}"
    );
    let unknown = planned(&yaml.replace("rockface/plus", "rockface/pluss")).err().unwrap();
    assert!(unknown.contains("did you mean `rockface/plus`?"), "{unknown}");
    let absent = planned("rockface: 1\nsteps: {p: {use: parts/non.yaml}}\n").err().unwrap();
    assert!(absent.contains("test.yaml:2") && absent.contains("non.yaml"), "{absent}");
    let no_part = planned("rockface: 1\nsteps: {p: {use: main.yaml}}\n");
    write("main.yaml", "rockface: 1\nsteps: {}\n");
    assert!(
        no_part.is_err()
            && planned("rockface: 1\nsteps: {p: {use: main.yaml}}\n").err().unwrap().contains("holds no part")
    );
}

/// Two lines each: a part with its use, and what is said of it.
#[test]
fn what_is_wrong_with_a_part_or_its_use_names_both_places() {
    let whole = |part: &str, with: &str| {
        format!("rockface: 1\nparts:\n  p: {part}\nsteps:\n  e: {{stage: emit}}\n  u: {{use: p{with}}}\n")
    };
    let fine = "{in: {a: table}, out: {o: s.out}, params: {x: {type: number, max: 3}}, steps: {s: {stage: add, in: {terms: in.a}, with: {plus: '${x}'}}}}";
    let using = ", in: {a: e.out}, with: {x: 1}";
    assert!(Bench::new().plan(&whole(fine, using), &[]).is_ok());
    for (with, pieces) in [
        (", in: {a: e.out}", &["`u` does not say `x`, which part `p` needs", "it is declared here"][..]),
        (", in: {a: e.out}, with: {x: 4}", &["`x` cannot be 4: at most 3", "`x` is declared here"]),
        (", in: {a: e.out}, with: {x: word}", &["parameter `x` is a number, found `\"word\"`"]),
        (", in: {a: e.out}, with: {y: 1, x: 1}", &["part `p` has no parameter `y`", "did you mean `x`?"]),
        (", with: {x: 1}", &["`u` does not feed `a` (table), which part `p` reads"]),
        (", in: {a: e.out, b: e.out}, with: {x: 1}", &["part `p` has no input `b`"]),
        (", in: {a: zz.out}, with: {x: 1}", &["unknown step `zz`"]),
        (", over: [k], in: {a: e.out}, with: {x: 1}", &["unknown axis `k`"]),
        (", stage: emit, in: {a: e.out}, with: {x: 1}", &["both `use` and `stage`"]),
        (", kep: false, in: {a: e.out}, with: {x: 1}", &["unknown key `kep`"]),
        (", in: {a: e.out}, with: {x: '${nobody}'}", &["`${nobody}` names neither a parameter nor an axis"]),
    ] {
        let said = said(&whole(fine, with));
        assert!(pieces.iter().all(|piece| said.contains(piece)), "{with}\n{said}");
        assert!(said.contains("1 error;"), "{with}\n{said}");
    }
    let part = |from: &str, to: &str| whole(&fine.replace(from, to), using);
    for (yaml, pieces) in [
        (part("stage: add", "stage: ad"), &["unknown stage `ad`", "used here", "test.yaml:3", "test.yaml:6"][..]),
        (part("'${x}'", "1"), &["nothing in part `p` mentions its parameter `x`"]),
        (part("terms: in.a", "terms: in.b"), &["no step of part `p` reads its input `a`"]),
        (part("in: {a: table}", "in: {a: tabel}"), &["unknown kind of artefact `tabel`", "did you mean `table`?"]),
        (
            part("in: {a: table}", "in: {a: mesh}"),
            &["takes a mesh as `a`, but `e.out` is a table", "it is declared here"],
        ),
        (part("{o: s.out}", "{o: t.out}"), &["part `p` has no step `t`"]),
        (part("{o: s.out}", "{o: in.a}"), &["only hands on the input `a`"]),
        (part("{o: s.out}", "{}"), &["part `p` has no `out`"]),
        (
            part("steps: {s:", "steps: {idle: {stage: emit}, s:"),
            &["step `idle` of part `p` leads to none of its outputs"],
        ),
        (part("steps: {s:", "steps: {in: {stage: emit}, s:"), &["no step of a part can be called `in`"]),
        (part("{type: number, max: 3}", "3"), &["parameter `x` of a part does not say its type"]),
        (part("{type: number, max: 3}", "{type: nmber}"), &["unknown type `nmber`"]),
        (part("'${x}'", "'${x}${z}'"), &["has neither a parameter nor an axis `z`", "used here"]),
        (part("with: {plus: '${x}'}", "with: {plus: '${x}', mnus: 1}"), &["unknown parameter `mnus`", "used here"]),
        (part("in: {terms: in.a}", "over: [k], in: {terms: in.a}"), &["part `p` has no axis `k`", "used here"]),
        (part("{o: s.out}", "{o: s.outt}"), &["no output `outt`"]),
        (
            part("doc", "doc").replace("  u: {use: p", "  v: {stage: add, in: {terms: u.oo}}\n  u: {use: p"),
            &["no output `oo`", "did you mean `o`?"],
        ),
        (whole(fine, using).replace("use: p,", "use: q,"), &["unknown part `q`", "`parts/name.yaml`"]),
        (
            whole(fine, using).replace("{use: p, in: {a: e.out}, with: {x: 1}}", "{stage: emit}"),
            &["nothing uses part `p`"],
        ),
        (whole("{out: {o: s.o}, steps: {s: {use: p}}}", ""), &["part `p` uses itself"]),
    ] {
        let said = said(&yaml);
        assert!(pieces.iter().all(|piece| said.contains(piece)), "{yaml}\n{said}");
    }
    // What is wrong inside is told once, however many use it.
    let two = part("stage: add", "stage: ad")
        .replace("  u: {use: p", "  v: {use: p, in: {a: e.out}, with: {x: 2}}\n  u: {use: p");
    assert_eq!(said(&two).matches("unknown stage").count(), 1, "{}", said(&two));
    let unread = whole(fine, using)
        .replace("out: {o: s.out}", "out: {o: s.out, r: t.out}")
        .replace("steps: {s:", "steps: {t: {stage: emit}, s:")
        + "  end: {stage: add, in: {terms: u.o}}\ntargets: [end]\n";
    assert!(said(&unread).contains("nothing reads the output `r` of part `p`"), "{}", said(&unread));
}

#[test]
fn parameters_of_a_pipeline_have_types_too() {
    let yaml = "rockface: 1\nparams:\n  v: {type: number, min: 0, max: 5, unit: m, default: 2, doc: how much}\n  n: {type: integer, default: 2}\naxes: {k: {count: '${n}'}}\nsteps: {a: {stage: emit, over: [k], with: {value: '${v}'}}}\n";
    let bench = Bench::new();
    let ran = bench.run(yaml, &[]);
    assert_eq!((ran.plan.instances.len(), ran.number(&bench.store, "a[k=1]")), (2, 2.0));
    assert_eq!(bench.run(yaml, &["params.v=3", "params.n=1"]).number(&bench.store, "a[k=0]"), 3.0);
    let fault = |set: &str| bench.plan(yaml, &[set]).err().unwrap().to_string();
    assert!(fault("params.v=7").contains("parameter `v` cannot be 7: from 0 to 5"), "{}", fault("params.v=7"));
    assert!(fault("params.n=1.5").contains("a whole number"), "{}", fault("params.n=1.5"));
    for (set, said) in [
        ("params.n=null", "parameter `n` is a whole number, found nothing"),
        ("params.v=", "parameter `v` is a number, found nothing"),
    ] {
        assert!(fault(set).contains(said) && fault(set).contains("1 error;"), "{}", fault(set));
    }
    // Where nothing is the default, it stays one: only the step has no use for it.
    let open = yaml.replace("default: 2, doc", "default: null, doc");
    let said_of_open = bench.plan(&open, &["params.v=3", "params.v="]).err().unwrap().to_string();
    assert!(said_of_open.contains("step `a`") && !said_of_open.contains("parameter `v`"), "{said_of_open}");
    let none = said(&yaml.replace(", default: 2, doc", ", doc"));
    assert!(none.contains("parameter `v` has no value") && none.contains("--set params.v=…"), "{none}");
    let axis = said(&yaml.replace("count: '${n}'", "count: '${k}'"));
    assert!(axis.contains("an axis can mention parameters"), "{axis}");
}

#[test]
fn parts_that_multiply_end_in_a_fault() {
    let mut yaml = String::from("rockface: 1\nparts:\n  p0: {out: {o: s.out}, steps: {s: {stage: emit}}}\n");
    for level in 1..30 {
        let below = level - 1;
        yaml += &format!(
            "  p{level}: {{out: {{a: a.o, o: b.o}}, steps: {{a: {{use: p{below}}}, b: {{use: p{below}}}}}}}\n"
        );
    }
    yaml += "steps: {x: {use: p29}}\n";
    let said = said(&yaml);
    assert!(said.contains("make more than 100000 steps"), "{}", &said[..said.len().min(2000)]);
}
