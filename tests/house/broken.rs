//! Broken pipelines: each fault is told with place, value and way out, all in one go, and nothing panics.

use rockface_engine::pipeline::{Overrides, Pipeline};

use crate::lab::Bench;

/// Plans a broken pipeline; every expected piece must be in what is said.
fn check(yaml: &str, expected: &[&str]) {
    check_set(yaml, &[], expected);
}

/// The same with values given from outside.
fn check_set(yaml: &str, set: &[&str], expected: &[&str]) {
    let said = match Bench::new().plan(yaml, set) {
        Ok(_) => panic!("this should not plan:\n{yaml}"),
        Err(faults) => faults.to_string(),
    };
    for piece in expected {
        assert!(said.contains(piece), "missing `{piece}` in:\n{said}");
    }
}

#[test]
fn an_unknown_key_of_a_step() {
    check(
        "rockface: 1\nsteps:\n  a: {stage: emit, wiht: {value: 1}}\n",
        &["test.yaml:3:20", "unknown key `wiht` in step `a`", "^^^^", "did you mean `with`?"],
    );
}

#[test]
fn an_unknown_parameter() {
    check(
        "rockface: 1\nsteps:\n  a: {stage: emit, with: {valeu: 1}}\n",
        &["test.yaml:3:27", "unknown parameter `valeu`", "did you mean `value`?"],
    );
}

#[test]
fn a_wrong_type() {
    check(
        "rockface: 1\nsteps:\n  a: {stage: emit, with: {value: many}}\n",
        &["test.yaml:3:34", "expected a number, found the text \"many\"", "^^^^"],
    );
}

#[test]
fn an_unknown_stage() {
    check(
        "rockface: 1\nsteps: {a: {stage: emitt}}\n",
        &["test.yaml:2:20", "unknown stage `emitt`", "did you mean `emit`?"],
    );
    check(
        "rockface: 1\nsteps: {a: {stage: rockface/stereo-site}}\n",
        &["test.yaml:2:20", "unknown stage `rockface/stereo-site`", "a part is named by `use`, not by `stage`"],
    );
}

#[test]
fn a_cycle() {
    check(
        "rockface: 1\nsteps:\n  a: {stage: add, in: {terms: b.out}}\n  b: {stage: add, in: {terms: a.out}}\n",
        &["test.yaml:3:31", "wait for each other in a circle: a, b"],
    );
}

#[test]
fn a_port_that_does_not_exist() {
    check(
        "rockface: 1\nsteps:\n  a: {stage: emit}\n  b: {stage: add, in: {terms: a.outt}}\n",
        &["test.yaml:4:31", "has no output `outt`", "did you mean `out`?"],
    );
    check(
        "rockface: 1\nsteps:\n  a: {stage: emit}\n  b: {stage: add, in: {term: a.out}}\n",
        &["has no input `term`", "did you mean `terms`?", "1 error;"],
    );
}

#[test]
fn a_missing_file() {
    check(
        "rockface: 1\nsteps: {a: {stage: read, with: {path: nowhere.txt}}}\n",
        &["test.yaml:2:39", "cannot read", "nowhere.txt", "relative to the folder of the pipeline"],
    );
}

#[test]
fn a_list_where_one_is_needed_and_an_axis_that_is_not_there() {
    let head = "rockface: 1\naxes: {k: {count: 2}}\nsteps:\n  a: {stage: emit, with: {value: '${k}'}}\n";
    check(
        &format!("{head}  b: {{stage: draw, in: {{in: {{each: a.out, over: [k]}}}}}}\n"),
        &["takes one table, not a gathered list"],
    );
    check(
        &format!("{head}  b: {{stage: add, in: {{terms: {{each: a.out, over: [j]}}}}}}\n"),
        &["unknown axis `j`", "did you mean `k`?"],
    );
    check(
        &format!("{head}  b: {{stage: emit}}\n  c: {{stage: add, in: {{terms: {{each: b.out, over: [k]}}}}}}\n"),
        &["cannot be gathered over `k`"],
    );
    check(&format!("{head}  b: {{stage: add, in: {{terms: 'a.out[k=5]'}}}}\n"), &["`5` is no item of axis `k`"]);
}

#[test]
fn all_faults_come_in_one_go() {
    let yaml =
        "rockface: 2\nseed: -1\nsteps:\n  a: {stage: emitt}\n  b: {stage: add, in: {terms: zz.out}, kepe: true}\n";
    check(yaml, &["pipeline format 2", "the seed", "unknown key `kepe`", "3 errors"]);
    let yaml = "rockface: 1\nsteps:\n  a: {stage: emitt}\n  b: {stage: add, in: {terms: zz.out}}\n  c: {stage: draw}\n";
    check(yaml, &["unknown stage `emitt`", "unknown step `zz`", "is not given its input `in`", "3 errors"]);
}

#[test]
fn text_that_is_no_pipeline() {
    for yaml in [
        "",
        "- 1\n",
        "a: [",
        "rockface: 1\nsteps: 3\n",
        "rockface: 1\nsteps: {a: 1}\n",
        "\u{0}",
        "rockface: 1\nrockface: 1\n",
    ] {
        assert!(Bench::new().plan(yaml, &[]).is_err(), "{yaml:?}");
    }
}

#[test]
fn mutated_pipelines_never_panic() {
    let yaml = "rockface: 1\naxes: {k: {count: 2}, s: {values: [1, 2.5]}}\nsteps:\n  a: {stage: emit, with: {value: '${s}'}}\n  b: {stage: add, over: [k], in: {terms: {each: a.out, over: [s]}}}\n";
    let bench = Bench::new();
    assert!(bench.plan(yaml, &[]).is_ok());
    for position in 0..yaml.len() {
        for replacement in ["", "{", "]", ":", "\n", "\u{fe}", "9e999", "&x"] {
            let mut text = yaml.to_owned();
            text.replace_range(position..=position, replacement);
            if let Err(faults) = bench.plan(&text, &[]) {
                assert!(!faults.to_string().is_empty());
            }
        }
    }
}

#[test]
fn a_name_said_twice_and_a_list_that_is_empty() {
    let head = "rockface: 1\naxes: {r: {count: 2}}\nsteps:\n  a: {stage: emit, with: {value: '${r}'}}\n";
    check(
        &format!("{head}  b: {{stage: add, in: {{terms: {{each: a.out, over: [r, r]}}}}}}\n"),
        &["test.yaml:5:55", "named twice"],
    );
    check(
        &format!("{head}  b: {{stage: add, in: {{terms: {{each: a.out, over: []}}}}}}\n"),
        &["test.yaml:5:51", "list is empty"],
    );
    check(
        &format!("{head}  b: {{stage: add, in: {{terms: 'a.out[r=0,r=1]'}}}}\n"),
        &["picks an item of axis `r` twice"],
    );
    check("rockface: 1\nsteps: {a: {stage: emit}}\ntargets: []\n", &["test.yaml:3:10", "list is empty"]);
    check("rockface: 1\nsteps: {}\n", &["test.yaml:2:8", "has no `steps`"]);
}

#[test]
fn parameters_that_nothing_reads() {
    let yaml = "rockface: 1\nparams: {cell: 2}\nsteps: {a: {stage: emit, with: {value: '${cell}'}}}\n";
    assert!(Bench::new().plan(yaml, &["params.cell=3"]).is_ok());
    check_set(yaml, &["params.cel=3"], &["--set:1:1", "has no parameter `cel`", "did you mean `cell`?"]);
    check_set(yaml, &["steps.aa.with.value=3"], &["--set:1:1", "has no step `aa`", "did you mean `a`?"]);
    check_set(
        "rockface: 1\nsteps: {a: {stage: emit}}\n",
        &["params.x=3"],
        &["has no parameter `x`", "declares nothing"],
    );
    check(
        "rockface: 1\nparams: {x: 2}\nsteps: {a: {stage: emit}}\n",
        &["test.yaml:2:10", "nothing mentions parameter `x`"],
    );
}

#[test]
fn values_from_outside_may_take_the_place_of_all_that_mentions_a_parameter() {
    let yaml = "rockface: 1\nparams: {n: 2, v: 1}\naxes: {k: {count: '${n}'}}\nsteps: {a: {stage: emit, over: [k], with: {value: '${v}'}}}\n";
    for set in ["axes.k.count=3", "steps.a.with.value=5"] {
        let plan = Bench::new().plan(yaml, &[set]);
        assert!(plan.is_ok(), "{set}: {}", plan.err().unwrap());
    }
    let overrides = Overrides { sweep: vec!["k=0,1".to_owned()], ..Overrides::default() };
    let swept = Pipeline::parse(yaml, "test.yaml", "test", ".".into(), &overrides).unwrap();
    assert!(rockface_engine::plan::resolve(&swept, &[], crate::lab::STAGES).is_ok());
    check_set(
        yaml,
        &["params.n=3", "axes.k.count=4"],
        &["nothing mentions parameter `n`", "leave out one of the two", "1 error;"],
    );
}

#[test]
fn names_and_keys_that_cannot_be() {
    check(
        "rockface: 1\nparams: {'a b': 2, x.y: 3, '': 4}\naxes: {k: {count: 2}}\nsteps: {a: {stage: emit, over: [k], with: {value: '${x.y}'}}, b: {stage: emit, with: {'v${k}': 1}}}\n",
        &[
            "test.yaml:2:10",
            "`a b` cannot be a name: use letters, digits, `-` and `_`",
            "`x.y` cannot be a name",
            "`` cannot be a name: it is empty",
            "`v${k}` is a key, and nothing is filled into keys",
            "4 errors;",
        ],
    );
    check(
        "rockface: 1\nparams: {m: {'k${v}': 1}}\nsteps: {a: {stage: emit, with: {value: '${m.k2}'}}}\n",
        &["test.yaml:2:14", "`k${v}` is a key", "1 error;"],
    );
}

#[test]
fn a_part_is_no_pipeline() {
    check(
        "rockface: 1\npart: gridded\nout: {dem: a.out}\nsteps: {a: {stage: emit}}\n",
        &["test.yaml:2:1", "holds the part `gridded`, and no pipeline", "{use: test.yaml}", "1 error;"],
    );
}

#[test]
fn parameters_that_refer_to_each_other() {
    let yaml = "rockface: 1\nparams: {a: '${b}', b: 2.5, c: ['${a}']}\nsteps: {s: {stage: emit, with: {value: '${a}'}}, t: {stage: emit, with: {value: '${c}'}}}\n";
    check(yaml, &["expected a number, found a list"]);
    let bench = Bench::new();
    let plan = bench.plan(&yaml.replace("['${a}']", "'${a}'"), &[]).unwrap_or_else(|faults| panic!("{faults}"));
    assert!(plan.instances.iter().all(|instance| instance.params.canonical["value"] == 2.5));
    let of = |params: &str| {
        format!(
            "rockface: 1\naxes: {{k: {{count: 2}}}}\nparams: {params}\nsteps: {{s: {{stage: emit, over: [k], with: {{value: '${{a}}'}}}}}}\n"
        )
    };
    check(&of("{a: '${b}', b: '${c}', c: '${b}'}"), &["wait for each other in a circle: a, b, c"]);
    check(&of("{a: '${bb}', b: 1}"), &["test.yaml:3:13", "`${bb}` names no parameter", "did you mean `b`?"]);
    check(&of("{a: '${k}'}"), &["cannot depend on axis `k`"]);
}

#[test]
fn items_are_named_as_they_are_written() {
    let yaml = "rockface: 1\naxes: {s: {values: [0.60, 1e-3, 2]}}\nsteps:\n  a: {stage: emit, with: {value: '${s}'}}\n  b: {stage: add, in: {terms: 'a.out[s=0.60]'}}\n  c: {stage: add, in: {terms: 'a.out[s=1e-3]'}, with: {plus: 1}}\n";
    let bench = Bench::new();
    let ran = bench.run(yaml, &[]);
    assert_eq!((ran.number(&bench.store, "b"), ran.number(&bench.store, "c")), (0.6, 1.001));
    for (bad, place) in [("items: [01, 02]", "3:21"), ("count: 05", "3:20")] {
        let yaml = format!("rockface: 1\nseed: 7\naxes: {{k: {{ {bad}}}}}\nsteps: {{a: {{stage: emit, over: [k]}}}}\n");
        check(&yaml, &[place, "has a zero before its first digit", "in quotes"]);
    }
    check("rockface: 1\nseed: 007\nsteps: {a: {stage: emit}}\n", &["test.yaml:2:7", "`007` has a zero", "1 error;"]);
    check(&yaml.replace("2]", "0.6]"), &["`0.6` is the same number as `0.60`"]);
}

#[test]
fn more_points_than_anyone_can_wait_for() {
    let yaml = "rockface: 1\naxes: {a: {count: 9999}, b: {count: 9999}, c: {count: 9999}}\nsteps:\n  s: {stage: emit, over: [a, b, c]}\n";
    check(yaml, &["test.yaml:4:3", "999700029999 instances", "9999 a x 9999 b x 9999 c", "at most 10000000"]);
}

#[test]
fn unknown_targets_are_told_of_even_when_others_are_asked_for() {
    let yaml = "rockface: 1\nsteps: {a: {stage: emit}}\ntargets: [b]\n";
    let pipeline = Pipeline::parse(yaml, "test.yaml", "test", ".".into(), &Overrides::default()).unwrap();
    let said =
        rockface_engine::plan::resolve(&pipeline, &["a".to_owned()], crate::lab::STAGES).err().unwrap().to_string();
    assert!(said.contains("test.yaml:3:11") && said.contains("unknown target step `b`"), "{said}");
}

#[test]
fn paths_that_are_empty_or_name_a_folder() {
    check("rockface: 1\nsteps: {a: {stage: read, with: {path: ''}}}\n", &["a path is needed, and this one is empty"]);
    let bench = Bench::new();
    std::fs::create_dir(bench.folder.path().join("data")).unwrap();
    let faults =
        bench.plan("rockface: 1\nsteps: {a: {stage: read, with: {path: data}}}\n", &[]).err().unwrap().to_string();
    assert!(faults.contains("is a folder, a file is needed") && !faults.contains("did you mean"), "{faults}");
    std::fs::write(bench.folder.path().join("face.txt"), "1").unwrap();
    let said = |path: &str| {
        let yaml = format!("rockface: 1\nsteps: {{a: {{stage: read, with: {{path: {path}}}}}}}\n");
        bench.plan(&yaml, &[]).err().unwrap().to_string()
    };
    assert!(said("FACE.TXT").contains("there is a `face.txt` in that folder"), "{}", said("FACE.TXT"));
    let escaped = said(r#""data\new.txt""#);
    assert!(escaped.contains("put single quotes around the path"), "{escaped}");
}

#[test]
fn a_wrong_choice_is_pointed_at_whatever_the_order() {
    let yaml = "rockface: 1
axes: {e: {items: [pre, post]}}
steps:
  face: {stage: synthesise-face}
  dem: {stage: rasterise-dem, in: {surface: face.mesh}, with: {cell_m: 0.1}}
  t: {stage: describe-noise, in: {raster: {by: e, post: face.mesh, pre: dem.raster}}}
";
    let said = Bench::rocks().plan(yaml, &[]).err().unwrap().to_string();
    assert!(said.contains("test.yaml:6:57"), "{said}");
}

#[test]
fn broken_yaml_in_an_override_is_pointed_at() {
    let yaml = "rockface: 1\nsteps: {a: {stage: emit}}\n";
    check_set(yaml, &["steps.a.with={value: [1}"], &["--set:1:2", "not YAML that can be read"]);
    check_set(yaml, &["steps.a.with.value=.nan"], &["--set:1:20", "`.nan` is not a finite number"]);
    for (text, expected) in
        [("rockface: 1\n---\nsteps: {}\n", "one document"), ("rockface: 1\nseed: .inf\n", "`.inf` is not a finite")]
    {
        let said = Bench::new().plan(text, &[]).err().unwrap().to_string();
        assert!(said.contains(expected) && !said.contains("from_str") && !said.contains("policy"), "{said}");
    }
}
