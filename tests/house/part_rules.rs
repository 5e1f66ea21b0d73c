//! The rules of parts and typed parameters: for each a case that keeps it, and one that breaks it with all that is reported.
//!
//! A case is two lines, one under `parts:` and one under `steps:`; `e` is a step that makes a table. Faults are held whole: message, places, hint and
//! notes, as `message @line:column; = hint; note @line:column`. A difference prints what is planned and reported today.

mod given;

use rockface_engine::pipeline::{Overrides, Pipeline};
use rockface_engine::plan::plan;

use crate::lab::Bench;

/// What a pipeline says under `parts`, and what under `steps`.
type Case = (&'static str, &'static str);

/// A rule of the language.
struct Rule {
    text: &'static str,
    keeps: Case,
    /// The instances that the case plans besides `e`, sorted.
    plans: &'static str,
    breaks: Case,
    says: &'static [&'static str],
}

const ONE: &str = "p: {in: {a: table}, out: {o: s.out}, params: {x: {type: number, max: 3}}, steps: {s: {stage: add, in: {terms: in.a}, with: {plus: '${x}'}}}}";
const PLAIN: &str = "p: {out: {o: s.out}, steps: {s: {stage: emit}}}";
const FED: &str = "p: {in: {a: table}, out: {o: s.out}, steps: {s: {stage: add, in: {terms: in.a}}}}";
const OVER: &str = "p: {out: {o: s.out}, axes: {i: {count: 2}}, steps: {s: {stage: emit, over: [i]}}}";
const USED: &str = "u: {use: p, in: {a: e.out}, with: {x: 1}}";

/// Names: what a use is called, and what is read of it.
const NAMES: &[Rule] = &[
    Rule {
        text: "a use stands for the steps of its part, under its own name and theirs",
        keeps: (PLAIN, "u: {use: p}"),
        plans: "u/s",
        breaks: (PLAIN, "u: {use: q}"),
        says: &[
            "unknown part `q` @5:36; = did you mean `p`?; a file is named by its path, `parts/name.yaml`; a stage is named by `stage`, not by `use`",
        ],
    },
    Rule {
        text: "a step is a use or has a stage",
        keeps: (PLAIN, "u: {use: p}"),
        plans: "u/s",
        breaks: (PLAIN, "u: {use: p, stage: emit}"),
        says: &["step `u` says both `use` and `stage` @5:27; = it is a use of a part, or a step of its own"],
    },
    Rule {
        text: "a use has the keys use, with, in, over, title and doc",
        keeps: (PLAIN, "u: {use: p, title: Once, doc: One use.}"),
        plans: "u/s",
        breaks: (PLAIN, "u: {use: p, keep: false}"),
        says: &["unknown key `keep` in step `u` @5:39; = known here: use, with, in, over, title, doc"],
    },
    Rule {
        text: "a part has the keys doc, params, in, out, axes, zip and steps",
        keeps: ("p: {doc: About it., out: {o: s.out}, steps: {s: {stage: emit}}}", "u: {use: p}"),
        plans: "u/s",
        breaks: ("p: {dok: About it., out: {o: s.out}, steps: {s: {stage: emit}}}", "u: {use: p}"),
        says: &["unknown key `dok` in part `p` @4:13; = did you mean `doc`?"],
    },
    Rule {
        text: "a part has steps",
        keeps: (PLAIN, "u: {use: p}"),
        plans: "u/s",
        breaks: ("p: {out: {o: s.out}}", "u: {use: p}"),
        says: &["part `p` has no `steps` @4:9"],
    },
    Rule {
        text: "a part has outputs",
        keeps: (PLAIN, "u: {use: p}"),
        plans: "u/s",
        breaks: ("p: {steps: {s: {stage: emit}}}", "u: {use: p}"),
        says: &["part `p` has no `out` @4:9; = name what others may read of it: `out: {dem: dem.raster}`"],
    },
    Rule {
        text: "an output is what a step of the part makes",
        keeps: (FED, "u: {use: p, in: {a: e.out}}"),
        plans: "u/s",
        breaks: (
            "p: {in: {a: table}, out: {o: in.a}, steps: {s: {stage: add, in: {terms: in.a}}}}",
            "u: {use: p, in: {a: e.out}}",
        ),
        says: &["output `o` only hands on the input `a` @4:38; = an output is what a step of the part makes"],
    },
    Rule {
        text: "an output names a step of the part",
        keeps: (PLAIN, "u: {use: p}"),
        plans: "u/s",
        breaks: ("p: {out: {o: z.out}, steps: {s: {stage: emit}}}", "u: {use: p}"),
        says: &["part `p` has no step `z` @4:22; = did you mean `s`?"],
    },
    Rule {
        text: "an output names a port of that step",
        keeps: (PLAIN, "u: {use: p}"),
        plans: "u/s",
        breaks: ("p: {out: {o: s.uot}, steps: {s: {stage: emit}}}", "u: {use: p}"),
        says: &["step `u/s` (emit) has no output `uot` @4:22; = did you mean `out`?"],
    },
    Rule {
        text: "an output of a use is read like one of a step",
        keeps: (PLAIN, "u: {use: p}, v: {stage: add, in: {terms: u.o}}"),
        plans: "u/s v",
        breaks: (PLAIN, "u: {use: p}, v: {stage: add, in: {terms: u.oo}}"),
        says: &[
            "step `u` uses part `p`, which has no output `oo` @5:68; = did you mean `o`?; a step inside is read by its full name, such as `u/name.port`",
        ],
    },
    Rule {
        text: "a step inside is read by its full name",
        keeps: (PLAIN, "u: {use: p}, v: {stage: add, in: {terms: u/s.out}}"),
        plans: "u/s v",
        breaks: (PLAIN, "u: {use: p}, v: {stage: add, in: {terms: u/t.out}}"),
        says: &["unknown step `u/t` @5:68; = did you mean `u/s`?"],
    },
    Rule {
        text: "a part sees no step of the pipeline",
        keeps: (FED, "u: {use: p, in: {a: e.out}}"),
        plans: "u/s",
        breaks: ("p: {out: {o: s.out}, steps: {s: {stage: add, in: {terms: e.out}}}}", "u: {use: p}"),
        says: &["unknown step `u/e` @4:66; = did you mean `u/s`?; used here @5:27"],
    },
    Rule {
        text: "a part sees no parameter of the pipeline",
        keeps: (ONE, USED),
        plans: "u/s",
        breaks: ("p: {out: {o: s.out}, steps: {s: {stage: emit, with: {value: '${ten}'}}}}", "u: {use: p}"),
        says: &[
            "part `p` has neither a parameter nor an axis `ten` @4:69; = write $${ten} for the text itself; used here @5:27",
        ],
    },
    Rule {
        text: "no step of a part is called in",
        keeps: (PLAIN, "u: {use: p}"),
        plans: "u/s",
        breaks: ("p: {out: {o: in.out}, steps: {in: {stage: emit}}}", "u: {use: p}"),
        says: &["no step of a part can be called `in` @4:39; = `in.name` is an input of the part"],
    },
    Rule {
        text: "an axis and a parameter of a part have different names",
        keeps: (
            "p: {params: {n: {type: integer}}, out: {o: s.out}, axes: {i: {count: '${n}'}}, steps: {s: {stage: emit, over: [i]}}}",
            "u: {use: p, with: {n: 1}}",
        ),
        plans: "u/s[i=0]",
        breaks: (
            "p: {params: {i: {type: integer}}, out: {o: s.out}, axes: {i: {count: '${i}'}}, steps: {s: {stage: emit, over: [i]}}}",
            "u: {use: p, with: {i: 1}}",
        ),
        says: &["`i` is both a parameter and an axis @4:67; = rename one: ${name} would be ambiguous"],
    },
];

/// Parts in parts, faults in them, and what nothing needs.
const WHOLE: &[Rule] = &[
    Rule {
        text: "parts use parts, in no circle",
        keeps: (
            "{p: {out: {o: s.o}, steps: {s: {use: q}}}, q: {out: {o: t.out}, steps: {t: {stage: emit}}}}",
            "u: {use: p}",
        ),
        plans: "u/s/t",
        breaks: ("{p: {out: {o: s.o}, steps: {s: {use: q}}}, q: {out: {o: t.o}, steps: {t: {use: p}}}}", "u: {use: p}"),
        says: &[
            "part `p` uses itself, by way of q @4:87; = let it use a part that does not use it in turn; used here @4:36; used here @5:27",
        ],
    },
    Rule {
        text: "a fault inside a part names the line there and the line that uses it",
        keeps: (PLAIN, "u: {use: p}"),
        plans: "u/s",
        breaks: ("p: {out: {o: s.out}, steps: {s: {stage: emti}}}", "u: {use: p}"),
        says: &["unknown stage `emti` @4:49; = did you mean `emit`?; used here @5:27"],
    },
    Rule {
        text: "a fault inside two parts names the outer use too",
        keeps: (
            "{p: {out: {o: s.o}, steps: {s: {use: q}}}, q: {out: {o: t.out}, steps: {t: {stage: emit}}}}",
            "u: {use: p}",
        ),
        plans: "u/s/t",
        breaks: (
            "{p: {out: {o: s.o}, steps: {s: {use: q}}}, q: {out: {o: t.out}, steps: {t: {stage: emit, with: {valeu: 1}}}}}",
            "u: {use: p}",
        ),
        says: &[
            "step `u/s/t` (emit): unknown parameter `valeu` @4:104; = did you mean `value`?; used here @4:36; used here @5:27",
        ],
    },
    Rule {
        text: "a fault inside is reported once, however many use the part",
        keeps: (PLAIN, "u: {use: p}, v: {use: p}"),
        plans: "u/s v/s",
        breaks: ("p: {out: {o: s.out}, steps: {s: {stage: emti}}}", "u: {use: p}, v: {use: p}"),
        says: &["unknown stage `emti` @4:49; = did you mean `emit`?; used here @5:27"],
    },
    Rule {
        text: "a value inside that fits at no use names both places",
        keeps: (ONE, USED),
        plans: "u/s",
        breaks: (
            "p: {params: {x: {type: any}}, out: {o: s.out}, steps: {s: {stage: emit, with: {value: '${x}'}}}}",
            "u: {use: p, with: {x: word}}",
        ),
        says: &[
            "step `u/s` (emit): `value`: expected a number, found the text \"word\" @5:49; step `u/s` stands here @4:64",
        ],
    },
    Rule {
        text: "a step of a part mentions its parameters",
        keeps: (ONE, USED),
        plans: "u/s",
        breaks: (
            "p: {params: {x: {type: number}}, out: {o: s.out}, steps: {s: {stage: emit}}}",
            "u: {use: p, with: {x: 1}}",
        ),
        says: &["nothing in part `p` mentions its parameter `x` @4:22; = write ${x}, or remove it"],
    },
    Rule {
        text: "a step of a part reads its inputs",
        keeps: (FED, "u: {use: p, in: {a: e.out}}"),
        plans: "u/s",
        breaks: ("p: {in: {a: table}, out: {o: s.out}, steps: {s: {stage: emit}}}", "u: {use: p, in: {a: e.out}}"),
        says: &["no step of part `p` reads its input `a` @4:18; = read `in.a`, or remove it"],
    },
    Rule {
        text: "a step of a part leads to an output",
        keeps: ("p: {out: {o: s.out, r: t.out}, steps: {s: {stage: emit}, t: {stage: emit}}}", "u: {use: p}"),
        plans: "u/s u/t",
        breaks: ("p: {out: {o: s.out}, steps: {s: {stage: emit}, t: {stage: emit}}}", "u: {use: p}"),
        says: &["step `t` of part `p` leads to none of its outputs @4:56; = name it under `out`, or remove it"],
    },
    Rule {
        text: "a step of a part depends on its axes",
        keeps: (OVER, "u: {use: p}"),
        plans: "u/s[i=0] u/s[i=1]",
        breaks: ("p: {out: {o: s.out}, axes: {i: {count: 2}}, steps: {s: {stage: emit}}}", "u: {use: p}"),
        says: &[
            "no step depends on axis `u/i` @4:37; = say `over: [u/i]` on the step where it begins, mention ${u/i} in a `with`, or remove it; used here @5:27",
        ],
    },
    Rule {
        text: "an output of a part is read, or made for a target",
        keeps: (
            "p: {out: {o: s.out, r: t.out}, steps: {t: {stage: emit}, s: {stage: add, in: {terms: t.out}}}}",
            "u: {use: p}, v: {stage: add, in: {terms: u.o}}, w: {stage: add, in: {terms: u.r}}",
        ),
        plans: "u/s u/t v w",
        breaks: (
            "p: {out: {o: s.out, r: t.out}, steps: {t: {stage: emit}, s: {stage: add, in: {terms: t.out}}}}",
            "u: {use: p}, v: {stage: add, in: {terms: u.o}}",
        ),
        says: &[
            "nothing reads the output `r` of part `p` @4:29; = read it, name the use under `targets`, or remove it",
        ],
    },
    Rule {
        text: "a part under parts is used",
        keeps: (PLAIN, "u: {use: p}"),
        plans: "u/s",
        breaks: (PLAIN, "u: {stage: emit}"),
        says: &["nothing uses part `p` @4:9; = write `use: p` on a step, or remove it"],
    },
];

fn pipeline((part, steps): Case) -> String {
    let part = if part.starts_with('{') { part.to_owned() } else { format!("{{{part}}}") };
    let (axes, params) = (steps.contains("k]") || steps.contains("${k}"), steps.contains("${two}"));
    let axes = if axes { "axes: {k: {count: 2}}" } else { "name: test" };
    let params = if params { "params: {two: 2}" } else { "seed: 1" };
    format!("rockface: 1\n{params}\n{axes}\nparts: {part}\nsteps: {{e: {{stage: emit}}, {steps}}}\n")
}

/// Labels of what is planned besides `e`, sorted.
fn planned(case: Case) -> String {
    let bench = Bench::new();
    let plan = bench.plan(&pipeline(case), &[]).unwrap_or_else(|faults| panic!("{case:?}\n{faults}"));
    let labels: Vec<String> = (0..plan.instances.len()).map(|instance| plan.label(instance)).collect();
    let mut labels: Vec<String> = labels.into_iter().filter(|label| label != "e").collect();
    labels.sort();
    labels.join(" ")
}

/// All that is reported, a line a fault: `message @line:column; = hint; note @line:column`.
fn reported(yaml: &str) -> Vec<String> {
    let faults = match Bench::new().plan(yaml, &[]) {
        Ok(_) => panic!("this should not plan:\n{yaml}"),
        Err(faults) => faults.to_string(),
    };
    let mut lines: Vec<String> = Vec::new();
    for line in faults.lines().map(str::trim) {
        if let Some(message) = line.strip_prefix("error: ") {
            lines.push(message.to_owned());
        } else if let Some(last) = lines.last_mut() {
            if let Some(place) = line.strip_prefix("--> test.yaml:") {
                last.push_str(&format!(" @{place}"));
            } else if let Some(note) = line.strip_prefix("note: ") {
                last.push_str(&format!("; {note}"));
            } else if let Some(hint) = line.strip_prefix("= help: ") {
                last.push_str(&format!("; = {hint}"));
            }
        }
    }
    lines
}

fn hold(rules: &[Rule]) {
    let mut wrong = Vec::new();
    for Rule { text: rule, keeps, plans, breaks, says } in rules {
        let (planned, reported) = (planned(*keeps), reported(&pipeline(*breaks)));
        if planned != *plans || reported != *says {
            wrong.push(format!("{rule}\n  plans {planned}\n  says {}", reported.join("\n  ")));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn names_of_uses() {
    hold(NAMES);
}

#[test]
fn what_goes_into_a_use() {
    hold(given::GIVEN);
}

#[test]
fn parts_as_a_whole() {
    hold(WHOLE);
}

/// Typed parameters of a pipeline: rule, declaration, a `--set` that keeps the rule, one that breaks it, and what is reported then.
const TYPED: &[[&str; 5]] = &[
    [
        "what is given is of the type",
        "v: {type: number}",
        "params.v=1.5",
        "params.v=word",
        "parameter `v` is a number, found `\"word\"`",
    ],
    [
        "a whole number has no fraction",
        "v: {type: integer, default: 1}",
        "params.v=2",
        "params.v=1.5",
        "parameter `v` is a whole number, found `1.5`",
    ],
    [
        "a number is in the range",
        "v: {type: number, min: 0, max: 5, unit: m, default: 2}",
        "params.v=5",
        "params.v=7",
        "parameter `v` cannot be 7: from 0 to 5",
    ],
    [
        "a number is at least the minimum",
        "v: {type: number, min: 0, default: 2}",
        "params.v=0",
        "params.v=-1",
        "parameter `v` cannot be -1: at least 0",
    ],
    [
        "a value is one of the choices",
        "v: {type: number, choices: [1, 2], default: 2}",
        "params.v=1",
        "params.v=3",
        "parameter `v` cannot be `3`; = help: one of: 1, 2",
    ],
    [
        "the name is one of the parameters",
        "v: {type: number, default: 2}",
        "params.v=1",
        "params.w=3",
        "the pipeline has no parameter `w`; = help: did you mean `v`?",
    ],
    [
        "a parameter without default is given",
        "v: {type: number, doc: how much}",
        "params.v=1",
        "seed=3",
        "parameter `v` has no value; = help: give one by `--set params.v=…`, or a `default`",
    ],
    [
        "a parameter without type takes any value",
        "v: 3",
        "params.v=1",
        "params.v=word",
        "step `a` (emit): `value`: expected a number, found the text \"word\"",
    ],
];

#[test]
fn typed_parameters_of_a_pipeline() {
    for [rule, declaration, good, bad, says] in TYPED {
        let yaml = format!(
            "rockface: 1\nparams: {{{declaration}}}\nsteps: {{a: {{stage: emit, with: {{value: '${{v}}'}}}}}}\n"
        );
        let bench = Bench::new();
        let with = |set: &str| {
            let overrides = Overrides { set: vec![set.to_owned()], ..Overrides::default() };
            let pipeline = Pipeline::parse(&yaml, "test.yaml", "test", ".".into(), &overrides)?;
            plan(&pipeline, &[], bench.stages, &bench.store)
        };
        assert!(with(good).is_ok(), "{rule}: {good}");
        let faults = with(bad).err().unwrap_or_else(|| panic!("{rule}: {bad} should be refused")).to_string();
        let lines: Vec<&str> =
            faults.lines().filter(|line| line.starts_with("error") || line.contains("= help")).collect();
        let reported = lines.iter().map(|line| line.trim()).collect::<Vec<_>>().join("; ");
        assert_eq!(reported.trim_start_matches("error: "), *says, "{rule}");
    }
}

const GRIDDED: &str = "rockface: 1
params: {cell_m: {type: number, min: 0.01, max: 1, unit: m, default: 0.1, doc: Cell of the DEM.}}
parts:
  gridded:
    doc: A face on a raster.
    params: {cell_m: {type: number}}
    in: {face: mesh}
    out: {dem: dem.raster}
    steps: {dem: {stage: rasterise-dem, in: {surface: in.face}, with: {cell_m: \"${cell_m}\"}}}
steps:
  face: {stage: synthesise-face, with: {width_m: 2, height_m: 2}}
  u: {use: gridded, in: {face: face.mesh}, with: {cell_m: \"${cell_m}\"}}
";

/// Commands that know of parts: what is done, what is printed, and then the same with a slip and what is reported of it.
const COMMANDS: &[[&str; 4]] = &[
    [
        "params p.yaml",
        "- `cell_m` = 0.1 (number, m, from 0.01 to 1): Cell of the DEM.",
        "params q.yaml",
        "did you mean `p.yaml`?",
    ],
    [
        "plan p.yaml",
        "u (gridded)\nu/dem",
        "plan p.yaml --set params.cell_m=7",
        "parameter `cell_m` cannot be 7: from 0.01 to 1",
    ],
    ["plan p.yaml --target u", "u/dem", "plan p.yaml --target v", "= help: did you mean `u`?"],
    ["plan p.yaml --target u/dem", "u/dem", "plan p.yaml --target u/den", "= help: did you mean `u/dem`?"],
    [
        "plan p.yaml --set steps.u/dem.with.cell_m=1",
        "u/dem",
        "plan p.yaml --set steps.u/den.with.cell_m=1",
        "the pipeline has no step `u/den`",
    ],
    [
        "plan p.yaml --sweep params.cell_m=0.1,0.2",
        "u/dem          2",
        "plan p.yaml --sweep params.cell_m=0.1,7",
        "parameter `cell_m` cannot be 7",
    ],
    [
        "explain p.yaml u/dem",
        "u/dem (rasterise-dem): depends, waits for face",
        "explain p.yaml u",
        "`u` uses part `gridded`: name one of its outputs (u.dem), or a step inside",
    ],
    [
        "graph p.yaml",
        "subgraph cluster_0 { label=\"u (gridded)\"",
        "graph p.yaml --target w",
        "unknown target step `w`",
    ],
    [
        "graph p.yaml --fold",
        "label = \"u\\lgridded\\l\"",
        "graph p.yaml --format svgg",
        "[possible values: dot, mermaid, svg, json",
    ],
    [
        "graph p.yaml --format mermaid",
        "subgraph u0[\"u (gridded)\"]",
        "graph p.yaml --format mermaid --set seed=x",
        "the seed to be a whole number",
    ],
    [
        "graph p.yaml --format svg",
        ">u (gridded)<",
        "graph p.yaml --format svg --set axes.u/k.count=2",
        "the pipeline has no axis `u/k`",
    ],
    [
        "parts rockface/stereo-survey",
        "rockface/stereo-survey",
        "parts rockface/stereo-survy",
        "did you mean `rockface/stereo-survey`?",
    ],
];

#[test]
fn commands_know_parts() {
    let house = crate::cli::House::new(GRIDDED);
    let ask = |line: &str| house.rockface(&line.split(' ').collect::<Vec<_>>());
    let mut wrong = Vec::new();
    for [good, prints, bad, says] in COMMANDS {
        let (code, out, err) = ask(good);
        if code != Some(0) || !out.contains(prints) {
            wrong.push(format!("{good}: {code:?}\n{out}{err}"));
        }
        let (code, out, err) = ask(bad);
        if code != Some(2) || !err.contains(says) {
            wrong.push(format!("{bad}: {code:?}\n{out}{err}"));
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
