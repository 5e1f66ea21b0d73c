//! Broken pipelines: each fault is told with place, value and way out, all in one go, and nothing panics.

use crate::lab::Bench;

/// Plans a broken pipeline; every expected piece must be in what is said.
fn check(yaml: &str, expected: &[&str]) {
    let said = match Bench::new().plan(yaml, &[]) {
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
        &["has no input `term`", "did you mean `terms`?", "is not given its input `terms` (table)"],
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
