//! The parameters, ports and answers of `python`, without a Python.

use super::*;
use rockface_core::artefact::Kind;
use rockface_core::params::ParamType;

use std::path::{Path, PathBuf};

fn params(types: &Value, given: &Value) -> PythonParams {
    let with = json!({
        "module": "a.py", "function": "f", "params": given, "types": types, "outputs": {"raster": "raster"},
    });
    PythonParams::decode(&with).unwrap()
}

#[test]
fn parameters_are_checked_against_the_types_of_the_function() {
    let types = json!({
        "count": {"type": "integer", "min": 1.0, "max": 9.0}, "word": {"type": "any", "choices": ["a", "b"]},
        "list": {"type": "list", "of": {"type": "number"}}, "perhaps": {"type": "number", "optional": true},
        "model": {"type": "file"}, "extra": {"type": "file", "default": null}, "needed": {"type": "text"},
    });
    let given = json!({"count": 12, "word": "c", "list": [1, "x"], "perhaps": null, "cout": 1, "model": "m.pt"});
    let faults = Python::check(&params(&types, &given));
    let told: Vec<_> = faults.iter().map(|fault| format!("{}: {}", fault.path.join("."), fault.message)).collect();
    for expected in [
        "params.count: 12 is out of range: 1 to 9",
        "params.cout: the function `f` has no such parameter `cout`",
        "params.list: item 1: expected a number, found \"x\"",
        "params.model: it is a file: name it under `files`",
        "params.word: expected one of \"a\", \"b\", found \"c\"",
        ": `model` (file) of the function is missing under `files`",
        ": `needed` (text) of the function is missing under `params`",
    ] {
        assert!(told.iter().any(|told| told == expected), "{expected} in {told:#?}");
    }
    assert_eq!(told.len(), 7, "{told:#?}");
}

/// Answers as Python would.
struct Answering(&'static str);

impl Planner for Answering {
    fn ask(&self, _: Found, _: &[&str], _: &str) -> Result<String, String> {
        if self.0.starts_with('{') { Ok(self.0.to_owned()) } else { Err(self.0.to_owned()) }
    }
    fn path(&self, _: &str) -> PathBuf {
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("Cargo.toml")
    }
    fn rests_on(&self, _: &Path) {}
}

const DESCRIBED: &str = r#"{"inputs": {"dem": {"kind": "raster"}}, "outputs": {"raster": {"kind": "raster"}},
    "types": {"sigma_m": {"type": "number", "default": 0.5}}, "sources": {"helper": "/h.py"},
    "packages": {"python": "3.11.7"}, "draws": true, "rests_on": []}"#;

#[test]
fn what_follows_from_the_function_is_filled_in() {
    let with = json!({"module": "a.py", "function": "f", "inputs": {"dem": "raster"}});
    let added = Python::complete(&with, &Answering(DESCRIBED)).unwrap();
    assert_eq!(added["params"], json!({"sigma_m": 0.5}));
    let whole: Map<String, Value> = with.as_object().unwrap().clone().into_iter().chain(added).collect();
    let params = PythonParams::decode(&Value::Object(whole.clone())).unwrap();
    assert_eq!((params.sources["helper"].0.as_str(), params.draws), ("/h.py", true));
    assert!(Python::check(&params).is_empty());
    let ports = Python::ports(&Value::Object(whole)).unwrap();
    assert_eq!((ports.inputs[0].kinds, ports.outputs[0].name), (&[Kind::Raster][..], "raster"));
}

#[test]
fn faults_of_the_description_name_their_parameter() {
    let fault = |with: Value, answer| Python::complete(&with, &Answering(answer)).unwrap_err().remove(0);
    let with = json!({"module": "a.py", "function": "f"});
    let refused = r#"{"fault": {"path": ["function"], "message": "no function `f`", "known": ["g"]}}"#;
    let told = fault(with.clone(), refused);
    assert_eq!((told.path.as_slice(), told.known.as_slice()), (&["function".to_owned()][..], &["g".to_owned()][..]));
    assert!(fault(with, "No module named rockface").message.contains("pip install ."));
    let other = json!({"module": "a.py", "function": "f", "outputs": {"labels": "raster"}});
    assert!(fault(other, DESCRIBED).message.contains("the function has {raster: raster}, not {labels: raster}"));
    assert!(fault(json!({"module": "a.py"}), "").message.contains("`function` (text) is missing"));
}

#[test]
fn an_answer_is_an_error_with_its_traceback_or_done() {
    let host = rockface_core::testing::TestHost::default();
    let answered = |answer: Value| {
        let done = JobResult { answer: Some(answer), ..JobResult::default() };
        answered(&params(&json!({}), &json!({})), &done, &Context::new(&host))
    };
    let log = json!([{"type": "metric", "name": "a", "value": 2.0, "unit": "m"}]);
    assert_eq!(answered(json!({ "log": log })), Ok(()));
    assert_eq!(host.metric("a"), Some(2.0));
    let error = json!({"message": "ValueError: no", "traceback": ["a.py, line 3, in f"], "hint": "do"});
    let told = answered(json!({ "error": error })).unwrap_err();
    assert_eq!(
        (told.message.as_str(), told.hint.as_deref()),
        ("`f`: ValueError: no\n  a.py, line 3, in f", Some("do"))
    );
    assert!(answered(json!({"error": 3})).unwrap_err().message.contains("no proper answer"));
}
