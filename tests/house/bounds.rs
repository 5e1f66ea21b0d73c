//! Pipelines that are small to write and large to work out: each is refused with its bound, or planned in the time of its size.

use std::fmt::Write;

use rockface_engine::plan::Plan;

use crate::lab::Bench;

/// What is said about a pipeline, which is not planned.
fn said(yaml: &str) -> String {
    said_of(Bench::new().plan(yaml, &[]).map_err(|faults| faults.to_string()))
}

fn said_of(planned: Result<Plan, String>) -> String {
    planned.err().unwrap_or_else(|| panic!("this should not plan"))
}

#[test]
fn thousands_of_similar_faults_are_counted() {
    let mut yaml = "rockface: 1\nsteps:\n".to_owned();
    for step in 0..20_000 {
        writeln!(yaml, "  s{step}: {{stage: add, in: {{terms: t{step}.out}}, with: {{plus: '${{x{step}}}'}}}}")
            .unwrap();
    }
    let said = said(&yaml);
    assert!(
        said.ends_with("40000 errors, of which the first 100 are shown; nothing was run"),
        "{}",
        &said[said.len() - 200..]
    );
    assert!(said.len() < 100_000 && said.contains("unknown step `t0`"), "{}", said.len());
}

#[test]
fn of_many_faults_those_that_are_shown_have_their_suggestions() {
    // Two hundred unknown steps are found before the unknown port above them.
    let mut yaml =
        "rockface: 1\nsteps:\n  b: {stage: emit, with: {value: 1}}\n  a: {stage: add, in: {tems: b.out}}\n".to_owned();
    for step in 0..200 {
        writeln!(yaml, "  s{step}: {{stage: add, in: {{terms: bb.out}}}}").unwrap();
    }
    let said = said(&yaml);
    let count = |text: &str| said.matches(text).count();
    assert!(said.contains("of which the first 100 are shown"), "{said}");
    assert!(count("did you mean `terms`?") == 1 && count("did you mean `b`?") >= 98, "{said}");
}

#[test]
fn a_fault_of_many_instances_is_told_once() {
    let of = |value: &str| {
        said(&format!(
            "rockface: 1\naxes: {{k: {{count: 3000}}, v: {{values: [1, {value}]}}}}\nsteps: {{a: {{stage: list, over: [k], in: {{terms: b.out}}, with: {{rows: '${{v}}'}}}}, b: {{stage: emit, with: {{value: '${{k}}'}}}}}}\n"
        ))
    };
    let said = of("-3");
    assert!(said.contains("(at 3000 instances)") && said.ends_with("\n1 error; nothing was run"), "{said}");
    let missing =
        self::said("rockface: 1\naxes: {k: {count: 3000}}\nsteps: {a: {stage: read, with: {path: 'f${k}.txt'}}}\n");
    assert!(missing.contains("f0.txt") && missing.contains("at 2995 more instances"), "{missing}");
    assert!(missing.ends_with("\n5 errors; nothing was run"), "{missing}");
}

#[test]
fn names_of_names_do_not_grow_without_end() {
    let mut yaml = "rockface: 1\nparams:\n  p0: '0123456789'\n".to_owned();
    for level in 1..14 {
        writeln!(yaml, "  p{level}: '{}'", format!("${{p{}}}", level - 1).repeat(10)).unwrap();
    }
    yaml += "steps: {a: {stage: moody, with: {unless: '${p13}'}}}\n";
    let text = said(&yaml);
    assert!(
        text.contains("`${p5}`") && text.contains("more than 4 MiB") && text.ends_with("1 error; nothing was run"),
        "{text}"
    );
    let mut lists = "rockface: 1\nparams:\n  p0: [1, 2]\n".to_owned();
    for level in 1..14 {
        writeln!(lists, "  p{level}: [{}]", vec![format!("'${{p{}}}'", level - 1); 10].join(", ")).unwrap();
    }
    lists += "steps: {a: {stage: emit, with: {value: '${p13}'}}}\n";
    let text = said(&lists);
    assert!(text.contains("more than 4 MiB"), "{text}");
    let long = "x".repeat(3 << 20);
    let many: String = (0..30).map(|n| format!("  q{n}: '${{p}}'\n")).collect();
    let text = said(&format!("rockface: 1\nparams:\n  p: {long}\n{many}steps: {{a: {{stage: emit}}}}\n"));
    assert!(text.contains("all parameters together take more than 64 MiB"), "{}", &text[..500]);
}

#[test]
fn a_long_chain_of_parameters_is_followed_in_the_time_of_its_length() {
    let mut yaml = "rockface: 1\nparams:\n".to_owned();
    (0..20_000).for_each(|n| writeln!(yaml, "  p{n}: '${{p{}}}'", n + 1).unwrap());
    yaml += "  p20000: 3\nsteps: {a: {stage: emit, with: {value: '${p0}'}}}\n";
    let plan = Bench::new().plan(&yaml, &[]).unwrap_or_else(|faults| panic!("{faults}"));
    assert_eq!(plan.instances[0].params.canonical["value"], 3.0);
}

#[test]
fn axes_and_gathered_inputs_have_bounds() {
    let mut yaml = "rockface: 1\naxes:\n".to_owned();
    (0..20).for_each(|n| writeln!(yaml, "  a{n}: {{count: 1000000}}").unwrap());
    yaml += "steps: {s: {stage: emit}}\n";
    let text = said(&yaml);
    assert!(text.contains("there may be 10000000 in all"), "{}", &text[..800]);
    let over: String = (0..100).map(|n| format!("v{n}: [0, 1], ")).collect();
    let text = said(&format!(
        "rockface: 1\naxes: {{p: {{sample: random, count: 1000000, over: {{{over}}}}}}}\nsteps: {{s: {{stage: emit, with: {{value: '${{p.v0}}'}}}}}}\n"
    ));
    assert!(text.contains("there may be 10000000 in all"), "{text}");
    let text = said(
        "rockface: 1\naxes: {j: {count: 20000}, k: {count: 20000}}\nsteps:\n  a: {stage: emit, over: [j]}\n  b: {stage: add, over: [k], in: {terms: {each: a.out, over: [j]}}}\n",
    );
    assert!(text.contains("20000 instances of step `b`") && text.contains("at most 20000000"), "{text}");
}

#[test]
fn files_that_include_each_other_without_end_are_refused() {
    let bench = Bench::new();
    for n in 0..300 {
        let text = format!("rockface: 1\ninclude: f{}.yaml\nsteps: {{s{n}: {{stage: emit}}}}\n", n + 1);
        std::fs::write(bench.folder.path().join(format!("f{n}.yaml")), text).unwrap();
    }
    let text = said_of(bench.plan("rockface: 1\ninclude: f0.yaml\n", &[]).map_err(|faults| faults.to_string()));
    assert!(text.contains("f100.yaml") && text.contains("at most 100 files may be nested"), "{text}");
}

#[test]
fn choices_and_targets_of_many_names_are_found_in_the_time_of_their_number() {
    let items: Vec<String> = (0..20_000).map(|n| format!("i{n}")).collect();
    let cases: Vec<String> = items.iter().map(|item| format!("{item}: a.out")).collect();
    let yaml = format!(
        "rockface: 1\naxes: {{k: {{items: [{}]}}}}\nsteps:\n  a: {{stage: emit}}\n  b: {{stage: add, in: {{terms: {{by: k, {}}}}}}}\n  c: {{stage: add, in: {{terms: 'b.out[k=i7]'}}}}\ntargets: [c]\n",
        items.join(", "),
        cases.join(", ")
    );
    assert_eq!(Bench::new().plan(&yaml, &[]).unwrap_or_else(|faults| panic!("{faults}")).instances.len(), 3);
}
