//! `--sweep AXIS=VALUES`: an axis of swept values from outside, for an axis, a parameter or one value of a step.

use serde_json::Value;

use super::design::tidy;
use super::node::{Data, Key, Node};
use super::overrides::{Late, check_depth, check_exists, place, put};
use super::parameter::{as_given, is_declared};
use super::reader::Reader;
use crate::diagnostic::{Diagnostic, Source, Span};

/// The most values of a range.
const VALUES_LIMIT: usize = 1_000_000;

/// Adds or replaces one axis. `sigma=0.6,0.7` is an axis; `params.cell_m=0.01,0.02` makes an axis of the parameter's name
/// out of it; `steps.dem.with.cell_m=…` lets that one value follow an axis called like its last key, or `swept_cell_m` where a
/// parameter has that name already. Values are listed with commas, or `lowest..highest:count`.
pub fn apply(root: &mut Node, text: &str, sources: &mut Vec<Source>) -> Result<Option<Late>, Diagnostic> {
    let source = sources.len();
    sources.push(Source::given("--sweep", text));
    let here = |from: usize, to: usize| Span { source, start: from, end: to };
    let hint = "for example --sweep sigma_px=0.6,0.7,0.8 or --sweep params.cell_m=0.01..0.05:5";
    let Some((path, values)) = text.split_once('=') else {
        return Err(Diagnostic::at(here(0, text.len()), "expected AXIS=VALUES").hint(hint));
    };
    let path_span = here(0, path.len());
    let values_span = here(path.len() + 1, text.len());
    check_once(path, values, &sources[..source], path_span)?;
    let mut values = listed(values, values_span).map_err(|message| Diagnostic::at(values_span, message).hint(hint))?;
    let mut keys: Vec<&str> = path.split('.').map(str::trim).collect();
    check_depth(&keys, path_span)?;
    // A bare name is an axis; where there is none, the parameter of that name.
    let has = |section: &str, name: &str| root.get(section).is_some_and(|section| section.get(name).is_some());
    if let [name] = keys[..]
        && !has("axes", name)
        && has("params", name)
    {
        keys.insert(0, "params");
    }
    check_not_set(&keys.join("."), &sources[..source], path_span)?;
    let mut late = None;
    if !matches!(keys[..], ["steps", name, ..] if name.contains('/')) {
        check_exists(root, &keys, path_span)?;
    }
    let name = match keys[..] {
        [name] | ["axes", name] => name.to_owned(),
        ["params", name] => {
            let declared = root.get("params").and_then(|own| own.get(name));
            values = values.into_iter().map(|value| as_given(declared, value, text)).collect();
            check_declared(root, name, &values)?;
            remove(root, "params", name);
            name.to_owned()
        }
        ["steps", _, "with", .., name] => {
            let taken = root.get("params").is_some_and(|params| params.get(name).is_some());
            let axis = if taken { format!("swept_{name}") } else { name.to_owned() };
            let reference = Node::made(path_span, Data::Scalar(Value::from(format!("${{{axis}}}"))));
            late = place(root, &keys, reference, path_span)?;
            axis
        }
        _ => {
            let message = format!("`{path}` is neither an axis nor a parameter nor a value of a step's `with`");
            return Err(Diagnostic::at(path_span, message).hint(hint));
        }
    };
    let key = |name: &str| Key { span: path_span, name: name.to_owned() };
    let list = Node::made(values_span, Data::List(values));
    let axis = Node::made(path_span, Data::Map(vec![(key("values"), list)]));
    put(root, &["axes", &name], axis, path_span)?;
    Ok(late)
}

/// The path and the values of a sweep.
fn parts(text: &str) -> Option<(&str, &str)> {
    text.split_once('=').map(|(path, values)| (path.trim(), values.trim()))
}

/// The axis that a path makes.
fn axis_of(path: &str) -> &str {
    path.rsplit('.').next().unwrap_or(path).trim()
}

/// Whether two texts are of one path, such as one that sets a value and one that sweeps it.
pub fn is_same_path(one: &str, other: &str) -> bool {
    parts(one).map(|(path, _)| path) == parts(other).map(|(path, _)| path)
}

/// Whether two texts sweep one axis.
pub fn is_same_axis(one: &str, other: &str) -> bool {
    parts(one).map(|(path, _)| axis_of(path)) == parts(other).map(|(path, _)| axis_of(path))
}

/// A second sweep of an axis would silently take the place of the first; two values may follow one axis.
fn check_once(path: &str, values: &str, earlier: &[Source], span: Span) -> Result<(), Diagnostic> {
    let (path, values) = (path.trim(), values.trim());
    let name = axis_of(path);
    let former = earlier.iter().filter(|source| source.name == "--sweep").filter_map(|source| parts(&source.text));
    let Some((known, first)) =
        former.into_iter().find(|(known, first)| axis_of(known) == name && (*known == path || *first != values))
    else {
        return Ok(());
    };
    let fault = Diagnostic::at(span, format!("axis `{name}` is swept twice"));
    Err(if known != path {
        fault.hint(format!("`{known}` makes it already: give both the same values, or declare an axis of another name"))
    } else if first.contains("..") || values.contains("..") {
        fault.hint(format!("give all its values at once, as a list or a range: --sweep {path}=0.1,0.2,0.5"))
    } else {
        fault.hint(format!("give all its values at once: --sweep {path}={first},{values}"))
    })
}

/// A value that is set and swept would silently be swept only.
fn check_not_set(path: &str, earlier: &[Source], span: Span) -> Result<(), Diagnostic> {
    let mut set = earlier.iter().filter(|source| source.name == "--set").filter_map(|source| parts(&source.text));
    if set.any(|(known, _)| known == path) {
        return Err(Diagnostic::at(span, format!("`{path}` is set and swept")).hint("leave out --set or --sweep"));
    }
    Ok(())
}

/// What is swept of a typed parameter is held against its type, range and choices.
fn check_declared(root: &Node, name: &str, values: &[Node]) -> Result<(), Diagnostic> {
    let entries = root.get("params").and_then(Node::entries).unwrap_or_default();
    let Some((key, node)) = entries.iter().find(|(key, node)| key.name == name && is_declared(node)) else {
        return Ok(());
    };
    let mut faults = Vec::new();
    if let Some(declared) = Reader::new(&mut faults).declared(key, node) {
        faults.extend(values.iter().filter_map(|value| declared.fault(value)));
    }
    faults.into_iter().next().map_or(Ok(()), Err)
}

fn remove(root: &mut Node, section: &str, name: &str) {
    let Data::Map(sections) = &mut root.data else { return };
    let section = sections.iter_mut().find(|(key, _)| key.name == section);
    if let Some((_, Node { data: Data::Map(entries), .. })) = section {
        entries.retain(|(key, _)| key.name != name);
    }
}

fn listed(values: &str, span: Span) -> Result<Vec<Node>, String> {
    // Paths and quoted texts may have two dots too.
    if let Some((lo, rest)) = values.split_once("..").filter(|_| !values.contains(['"', '/'])) {
        return range(lo, rest, span);
    }
    let mut at = span.start;
    let mut nodes = Vec::new();
    let parts = between_commas(values);
    if let Some(number) = parts.windows(2).find_map(|pair| with_decimal_comma(pair[0], pair[1])) {
        return Err(format!(
            "commas part the values here: numbers are written with a point, {number}, and texts of digits in quotes, \"{}\"",
            number.rsplit('.').next().unwrap_or_default()
        ));
    }
    for value in parts {
        let place = Span { start: at, end: at + value.len(), ..span };
        at = place.end + 1;
        let node = Node::parse(value.trim(), span.source).map_err(|_| format!("`{value}` is no value"))?;
        match node.data {
            Data::Scalar(Value::Null) if node.written.is_empty() => {
                return Err("a value between two commas is missing".to_owned());
            }
            Data::Scalar(_) => nodes.push(Node { span: place, ..node }),
            Data::List(_) | Data::Map(_) => return Err(format!("`{value}` is not a single value")),
        }
    }
    Ok(nodes)
}

/// The number that two parts of a list may be meant to be: `0` and `05`, since nobody writes 5 as `05`.
fn with_decimal_comma(whole: &str, fraction: &str) -> Option<String> {
    let (whole, fraction) = (whole.trim(), fraction.trim());
    let is_digits = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let is_fraction = fraction.starts_with('0') && fraction.len() > 1 && is_digits(fraction);
    // Where the first part has a zero in front too, these are labels, such as months.
    let digits = whole.trim_start_matches(['+', '-']);
    let is_whole = is_digits(digits) && (digits == "0" || !digits.starts_with('0'));
    (is_whole && is_fraction).then(|| format!("{whole}.{fraction}"))
}

/// The parts of a list with commas, but for those in double quotes.
fn between_commas(values: &str) -> Vec<&str> {
    let (mut quoted, mut escaped) = (false, false);
    values
        .split(|letter: char| {
            let is_end = letter == ',' && !quoted;
            quoted ^= letter == '"' && !escaped;
            escaped = letter == '\\' && !escaped;
            is_end
        })
        .collect()
}

/// `lo..hi:n`, both ends included.
fn range(lo: &str, rest: &str, span: Span) -> Result<Vec<Node>, String> {
    let wrong = || format!("`{lo}..{rest}` is no range lowest..highest:count");
    let (hi, count) = rest.split_once(':').ok_or_else(wrong)?;
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|x| x.is_finite()).ok_or_else(wrong);
    let (lo, hi) = (number(lo)?, number(hi)?);
    let count: usize = count.trim().parse().map_err(|_| wrong())?;
    if !(hi - lo).is_finite() {
        return Err(format!("the range from {lo:e} to {hi:e} is wider than any number"));
    }
    if !(2..=VALUES_LIMIT).contains(&count) {
        return Err(format!("a range has from 2 to {VALUES_LIMIT} values, not {count}"));
    }
    let whole = lo.fract() == 0.0 && hi.fract() == 0.0 && (hi - lo) % (count - 1) as f64 == 0.0;
    let (apart, size) = ((hi - lo).abs() / (count - 1) as f64, lo.abs().max(hi.abs()));
    let node = |index: usize| {
        let value = match lo + (hi - lo) * (index as f64 / (count - 1) as f64) {
            _ if index == 0 => lo,
            _ if index + 1 == count => hi,
            value => tidy(value, (lo, hi), apart, size),
        };
        // A whole number is written as people write it in a list, also where others of the range have a fraction.
        let whole = (whole || value.fract() == 0.0) && value.abs() < 9e15;
        let value = if whole { Value::from(value.round() as i64) } else { Value::from(value) };
        Node { span, written: value.to_string(), data: Data::Scalar(value) }
    };
    let nodes: Vec<Node> = (0..count).map(node).collect();
    if nodes.windows(2).any(|pair| pair[0].data == pair[1].data) {
        return Err(format!("from {lo} to {hi} there are no {count} different numbers"));
    }
    Ok(nodes)
}

#[cfg(test)]
mod tests {
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
            r#"{"axes":{"x":{"values":[1,3]}},"params":{"y":2}}"#
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
    fn what_cannot_be_swept_is_said() {
        assert!(swept("seed: 1", "k").contains("AXIS=VALUES"));
        assert!(swept("seed: 1", "params.x=1,2").contains("no parameter `x`"));
        assert!(swept("seed: 1", "k=1..3").contains("no range"));
        assert_eq!(swept("seed: 1", "k=0.05..0.05:3"), "from 0.05 to 0.05 there are no 3 different numbers");
        assert!(swept("seed: 1", "k=1,,2").contains("missing"));
    }
}
