//! What sweeps make of a pipeline, and what they refuse.

use super::*;

#[test]
fn commas_in_quotes_part_nothing() {
    assert_eq!(super::between_commas(r#"1,"a,b","c\",d", e"#), ["1", r#""a,b""#, r#""c\",d""#, " e"]);
}

fn swept(yaml: &str, sweep: &str) -> String {
    let mut root = Node::parse(yaml, 0).unwrap();
    match apply(&mut root, sweep, &mut vec![Source::given("p", yaml)]) {
        Ok(_) => root.to_value().to_string(),
        Err(fault) => fault.message,
    }
}

#[test]
fn an_axis_a_parameter_and_a_value_of_a_step() {
    assert_eq!(swept("seed: 1", "k=0.5,a"), r#"{"axes":{"k":{"values":[0.5,"a"]}},"seed":1}"#);
    assert_eq!(
        swept("{params: {x: 1, y: 2}}", "params.x=1..3:3"),
        r#"{"axes":{"x":{"values":[1,2,3]}},"params":{"y":2}}"#
    );
    assert_eq!(
        swept("seed: 1", "a=0.05..0.2:7"),
        r#"{"axes":{"a":{"values":[0.05,0.075,0.1,0.125,0.15,0.175,0.2]}},"seed":1}"#
    );
    assert!(swept("seed: 1", "a=-1e308..1e308:3").contains("wider"));
    assert!(swept("seed: 1", "a=0,05,0,1").contains("with a point, 0.05"));
    assert_eq!(swept("seed: 1", r#"m=01,02,"03""#).matches("with a point").count(), 0);
    assert_eq!(swept("seed: 1", "a=3..2:3"), r#"{"axes":{"a":{"values":[3,2.5,2]}},"seed":1}"#);
    assert_eq!(
        swept("params: {s: {type: text}}", "s=1.0,1e3,true"),
        r#"{"axes":{"s":{"values":["1.0","1e3","true"]}},"params":{}}"#
    );
    // A bare name is that of a parameter where there is no such axis.
    assert_eq!(swept("{params: {x: 1, y: 2}}", "x=1,3"), r#"{"axes":{"x":{"values":[1,3]}},"params":{"y":2}}"#);
    assert_eq!(
        swept("{params: {y: 2}, axes: {x: {count: 4}}}", "x=1,3"),
        r#"{"axes":{"x":{"reseeds":true,"values":[1,3]}},"params":{"y":2}}"#
    );
    assert_eq!(
        swept("steps: {a: {stage: b}}", "steps.a.with.c=0..1:3"),
        r#"{"axes":{"c":{"values":[0,0.5,1]}},"steps":{"a":{"stage":"b","with":{"c":"${c}"}}}}"#
    );
    // A parameter of that name stays what it is.
    assert_eq!(
        swept("{params: {c: 9}, steps: {a: {stage: b}}}", "steps.a.with.c=1,2"),
        r#"{"axes":{"swept_c":{"values":[1,2]}},"params":{"c":9},"steps":{"a":{"stage":"b","with":{"c":"${swept_c}"}}}}"#
    );
}

#[test]
fn an_axis_that_is_swept_reseeds_as_it_did() {
    let reseeds = |axis: &str| swept(&format!("axes: {{t: {axis}}}"), "t=1,2").contains(r#""reseeds":true"#);
    assert!(reseeds("{count: 3}") && reseeds("{items: [a, b]}") && reseeds("{from: a.list}"));
    assert!(reseeds("{values: [1, 2], reseeds: true}"));
    assert!(!reseeds("{values: [1, 2]}") && !reseeds("{count: 3, reseeds: false}"));
    assert!(!reseeds("{sample: sobol, count: 4, over: {a: [0, 1]}}"));
    // Its points are those of the axis as it is written, so that the keys of its steps stay the same.
    let read = |sweep: &[&str]| {
        let text = "rockface: 1\naxes: {t: {count: 2}}\nsteps: {a: {stage: b, over: [t]}}\n";
        let own = |texts: &[&str]| texts.iter().map(ToString::to_string).collect();
        let overrides = crate::pipeline::Overrides { sweep: own(sweep), ..Default::default() };
        let read = crate::pipeline::Pipeline::parse(text, "p", "p", ".".into(), &overrides).unwrap();
        let axis = read.document.axes.into_iter().next().unwrap();
        (axis.items, axis.values.to_vec(), axis.reseeds)
    };
    assert_eq!(read(&["t=0,1"]), read(&[]));
}

#[test]
fn an_axis_of_a_part_is_swept_where_the_part_is_written_out() {
    let text = "rockface: 1\nparts:\n  p: {out: {o: a.o}, axes: {i: {count: 2}}, steps: {a: {stage: b, over: [i]}}}\n\
                steps: {u: {use: p}, r: {stage: c, in: {x: u.o}}}\n";
    let read = |given: &str| {
        let overrides = crate::pipeline::Overrides { sweep: vec![given.to_owned()], ..Default::default() };
        crate::pipeline::Pipeline::parse(text, "p", "p", ".".into(), &overrides)
    };
    let axis = read("axes.u/i=5,7").unwrap().document.axes.remove(0);
    assert_eq!((axis.items, axis.reseeds), (vec!["5".to_owned(), "7".to_owned()], true));
    assert!(read("axes.u/k=5,7").unwrap().faults[0].message.contains("no axis `u/k`"));
}

fn all_swept(yaml: &str, sweeps: &[&str]) -> String {
    let mut root = Node::parse(yaml, 0).unwrap();
    let mut sources = vec![Source::given("p", yaml)];
    for sweep in sweeps {
        if let Err(fault) = apply(&mut root, sweep, &mut sources) {
            return fault.message;
        }
    }
    root.to_value().to_string()
}

#[test]
fn an_axis_of_the_name_of_a_swept_value_stays_what_it_is() {
    let told = all_swept("{axes: {c: {count: 2}}, steps: {a: {stage: b}}}", &["steps.a.with.c=1,2"]);
    let expected = r#"{"axes":{"c":{"count":2},"swept_c":{"values":[1,2]}},"steps":{"a":{"stage":"b","with":{"c":"${swept_c}"}}}}"#;
    assert_eq!(told, expected);
    let text = "{params: {swept_c: 1}, axes: {c: {count: 2}}, steps: {a: {stage: b}}}";
    assert!(all_swept(text, &["steps.a.with.c=1,2"]).contains("${swept_swept_c}"));
    // Two values that are swept alike share one axis.
    let text = "{axes: {c: {count: 2}}, steps: {a: {stage: b}, d: {stage: b}}}";
    let told = all_swept(text, &["steps.a.with.c=1,2", "steps.d.with.c=1,2"]);
    assert!(told.matches("${swept_c}").count() == 2 && !told.contains("swept_swept"), "{told}");
    // The axis that a sweep has made is not replaced by another.
    let told = all_swept(text, &["steps.a.with.c=1,2", "steps.d.with.swept_c=3,4"]);
    assert!(told.contains("${swept_c}") && told.contains("${swept_swept_c}"), "{told}");
    assert_eq!(all_swept(text, &["steps.a.with.c=1,2", "swept_c=3,4"]), "axis `swept_c` is swept twice");
    assert!(all_swept("{params: {c: 1}, axes: {c: {count: 2}}}", &["params.c=1,2"]).contains("both a parameter"));
}

#[test]
fn texts_are_swept_as_they_are_written() {
    let values = |given: &str| {
        let told = swept("params: {t: {type: text}}", &format!("params.t={given}"));
        told.strip_prefix(r#"{"axes":{"t":{"values":"#)
            .map_or(told.clone(), |rest| rest.replace(r#"}},"params":{}}"#, ""))
    };
    assert_eq!(values("Face #3,Face #4"), r#"["Face #3","Face #4"]"#);
    assert_eq!(values(r#"a: b,[1],@a,"x, y",'q',a"b"#), r#"["a: b","[1]","@a","x, y","q","a\"b"]"#);
    assert_eq!(values("1..3:2"), r#"["1","3"]"#);
    assert_eq!(values("a..b,c"), r#"["a..b","c"]"#);
    assert_eq!(values("a,,b"), "a value between two commas is missing");
    assert!(swept("seed: 1", "k=a #1,b").contains("would be a comment"));
}

#[test]
fn what_is_set_and_swept_is_refused() {
    let fault = |set: &str, sweep: &str| {
        let yaml = "{params: {x: {type: number, default: 1}}, axes: {t: {count: 2}}, steps: {a: {stage: b}}}";
        let mut root = Node::parse(yaml, 0).unwrap();
        let mut sources = vec![Source::given("p", yaml)];
        super::super::overrides::apply(&mut root, set, &mut sources).unwrap();
        apply(&mut root, sweep, &mut sources).err().map(|fault| fault.message)
    };
    for (set, sweep) in [
        ("axes.t.count=5", "t=0,1"),
        ("params.x=3", "x=1,2"),
        ("params.x.default=3", "params.x=1,2"),
        ("steps.a.with.m.k=1", "steps.a.with.m=1,2"),
    ] {
        assert!(fault(set, sweep).is_some_and(|told| told.ends_with("is set and swept")), "{set} {sweep}");
        assert!(is_swept_by(set, sweep));
    }
    assert_eq!(fault("axes.t.reseeds=false", "t=0,1"), None);
    assert!(!is_swept_by("axes.t.reseeds=false", "t=0,1") && !is_swept_by("params.x.max=9", "x=1,2"));
    assert!(is_set_by("params.m.k=1", "params.m=2") && !is_set_by("params.m=1", "params.m.k=2"));
}

#[test]
fn what_cannot_be_swept_is_said() {
    assert!(swept("seed: 1", "k").contains("AXIS=VALUES"));
    assert!(swept("seed: 1", "params.x=1,2").contains("no parameter `x`"));
    assert!(swept("seed: 1", "k=1..3").contains("no range"));
    assert_eq!(swept("seed: 1", "k=0.05..0.05:3"), "from 0.05 to 0.05 there are no 3 different numbers");
    assert!(swept("seed: 1", "k=1,,2").contains("missing"));
}
