//! `--sweep AXIS=VALUES`: an axis of swept values from outside, for an axis, a parameter or one value of a step.

use serde_json::Value;

use super::design::tidy;
use super::node::{Data, Key, Node};
use super::overrides::{Late, check_depth, check_exists, place, put};
use super::parameter::{as_given, comment_after, is_declared, is_text, text_as_written};
use super::part::INSIDE;
use super::reader::Reader;
use crate::diagnostic::{Diagnostic, Source, Span};

/// The key of an axis that says whether it reseeds.
const RESEEDS: &str = "reseeds";
/// How sweeps are written.
const HINT: &str = "for example --sweep sigma_px=0.6,0.7,0.8 or --sweep params.cell_m=0.01..0.05:5";
/// The most values of a range.
const VALUES_LIMIT: usize = 1_000_000;

/// Adds or replaces one axis. `sigma=0.6,0.7` is an axis; `params.cell_m=0.01,0.02` makes an axis of the parameter's name
/// out of it; `steps.dem.with.cell_m=…` lets that one value follow an axis called like its last key, or `swept_cell_m` where a
/// parameter or an axis has that name already. Values are listed with commas, or `lowest..highest:count`. An axis that
/// takes the place of another reseeds where that one does.
pub fn apply(root: &mut Node, text: &str, sources: &mut Vec<Source>) -> Result<Option<Late>, Diagnostic> {
    let source = sources.len();
    sources.push(Source::given("--sweep", text));
    let here = |from: usize, to: usize| Span { source, start: from, end: to };
    let Some((path, values)) = text.split_once('=') else {
        return Err(Diagnostic::at(here(0, text.len()), "expected AXIS=VALUES").hint(HINT));
    };
    let path_span = here(0, path.len());
    let values_span = here(path.len() + 1, text.len());
    check_once(path, values, &sources[..source], path_span)?;
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
    let declared =
        if let ["params", name] = keys[..] { root.get("params").and_then(|all| all.get(name)) } else { None };
    let listed = if is_text(declared) { texts(values, values_span) } else { listed(values, values_span) };
    let values = listed.map_err(|message| Diagnostic::at(values_span, message).hint(HINT))?;
    let values: Vec<Node> = values.into_iter().map(|value| as_given(declared, value, text)).collect();
    check_not_set(&keys, &sources[..source], path_span)?;
    if !matches!(keys[..], ["steps", name, ..] if name.contains(INSIDE)) {
        check_exists(root, &keys, path_span)?;
    }
    let key = |name: &str| Key { span: path_span, name: name.to_owned() };
    let swept = |values: Vec<Node>| {
        let list = Node::made(values_span, Data::List(values));
        Node::made(path_span, Data::Map(vec![(key("values"), list)]))
    };
    match keys[..] {
        [name] | ["axes", name] if name.contains(INSIDE) => {
            let keys = vec!["axes".to_owned(), name.to_owned()];
            Ok(Some(Late { keys, value: swept(values), span: path_span, is_swept: true }))
        }
        [name] | ["axes", name] => {
            if let Some(path) = maker(root, name, sources).filter(|path| axis_of(path) != name) {
                let fault = Diagnostic::at(path_span, format!("axis `{name}` is swept twice"));
                return Err(fault.hint(format!("`{path}` makes it already: give this axis another name")));
            }
            let mut axis = swept(values);
            keep_reseeding(&mut axis, root.get("axes").and_then(|axes| axes.get(name)), path_span);
            put(root, &["axes", name], axis, path_span).map(|()| None)
        }
        ["params", name] => {
            check_declared(root, name, &values)?;
            if has("axes", name) && maker(root, name, sources).is_none() {
                let fault = Diagnostic::at(path_span, format!("`{name}` is both a parameter and an axis"));
                return Err(fault.hint("rename one: ${name} would be ambiguous"));
            }
            remove(root, "params", name);
            put(root, &["axes", name], swept(values), path_span).map(|()| None)
        }
        ["steps", _, "with", .., name] => {
            // Another value that follows an axis of that name, by a sweep of the same values, shares the axis.
            let is_own = |axis: &str| maker(root, axis, sources).is_some_and(|path| axis_of(path) == name);
            let mut axis = name.to_owned();
            while has("params", &axis) || has("axes", &axis) && !is_own(&axis) {
                axis = format!("swept_{axis}");
            }
            let reference = Node::made(path_span, Data::Scalar(Value::from(format!("${{{axis}}}"))));
            let late = place(root, &keys, reference, path_span)?;
            put(root, &["axes", &axis], swept(values), path_span).map(|()| late)
        }
        _ => {
            let message = format!("`{path}` is neither an axis nor a parameter nor a value of a step's `with`");
            Err(Diagnostic::at(path_span, message).hint(HINT))
        }
    }
}

/// Lets an axis reseed where the one whose place it takes does, as that says or as its form implies.
pub fn keep_reseeding(axis: &mut Node, former: Option<&Node>, span: Span) {
    let Some(former) = former else { return };
    let implied = || {
        // A drawn design has a count too.
        let reseeds = ["items", "count", "from"].iter().any(|form| former.get(form).is_some());
        (reseeds && former.get("sample").is_none()).then(|| Node::made(span, Data::Scalar(Value::Bool(true))))
    };
    let Some(reseeds) = former.get(RESEEDS).cloned().or_else(implied) else { return };
    if let Data::Map(entries) = &mut axis.data {
        entries.push((Key { span, name: RESEEDS.to_owned() }, reseeds));
    }
}

/// The path of the sweep that an axis was added by; `None` for one that the pipeline or `--set` declares.
fn maker<'s>(root: &Node, axis: &str, sources: &'s [Source]) -> Option<&'s str> {
    let (key, _) = root.get("axes")?.entries()?.iter().find(|(key, _)| key.name == axis)?;
    let source = sources.get(key.span.source).filter(|source| source.name == "--sweep")?;
    parts(&source.text).map(|(path, _)| path)
}

/// The path and the values of a sweep.
fn parts(text: &str) -> Option<(&str, &str)> {
    text.split_once('=').map(|(path, values)| (path.trim(), values.trim()))
}

/// A path without the space around its keys.
pub fn plain_path(path: &str) -> String {
    path.split('.').map(str::trim).collect::<Vec<_>>().join(".")
}

/// The axis that a path makes.
fn axis_of(path: &str) -> &str {
    path.rsplit('.').next().unwrap_or(path).trim()
}

/// Whether one text sets what another sets, or all that is around it.
pub fn is_set_by(former: &str, given: &str) -> bool {
    let (Some((former, _)), Some((given, _))) = (parts(former), parts(given)) else { return false };
    let (former, given) = (plain_path(former), plain_path(given));
    former.strip_prefix(given.as_str()).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
}

/// Whether a sweep leaves nothing of what another text sets.
pub fn is_swept_by(set: &str, sweep: &str) -> bool {
    let (Some((set, _)), Some((sweep, _))) = (parts(set), parts(sweep)) else { return false };
    let (set, sweep) = (plain_path(set), plain_path(sweep));
    let is_bare = !sweep.contains('.');
    is_lost(&set, &sweep) || is_bare && ["axes", "params"].iter().any(|own| is_lost(&set, &format!("{own}.{sweep}")))
}

/// Whether a sweep of a path leaves nothing of what is set at another; whether an axis reseeds is kept.
fn is_lost(set: &str, swept: &str) -> bool {
    match set.strip_prefix(swept).and_then(|rest| rest.strip_prefix('.')) {
        Some(below) if swept.starts_with("params.") => below == "default",
        Some(below) if swept.starts_with("axes.") => below != RESEEDS,
        Some(_) => true,
        None => set == swept,
    }
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
fn check_not_set(keys: &[&str], earlier: &[Source], span: Span) -> Result<(), Diagnostic> {
    let path = if let [axis] = keys { format!("axes.{axis}") } else { keys.join(".") };
    let mut set = earlier.iter().filter(|source| source.name == "--set").filter_map(|source| parts(&source.text));
    if let Some((known, _)) = set.find(|(known, _)| is_lost(&plain_path(known), &path)) {
        return Err(Diagnostic::at(span, format!("`{known}` is set and swept")).hint("leave out --set or --sweep"));
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

/// The values of a parameter that is declared as text: a range, or texts between commas as they are written.
fn texts(values: &str, span: Span) -> Result<Vec<Node>, String> {
    if let Some((lo, rest)) = values.split_once("..")
        && let Ok(nodes) = range(lo, rest, span)
    {
        return Ok(nodes);
    }
    let parts = parted_by_commas(values)?;
    let mut at = span.start;
    let mut nodes = Vec::with_capacity(parts.len());
    for value in parts {
        let place = Span { start: at, end: at + value.len(), ..span };
        at = place.end + 1;
        if value.trim().is_empty() {
            return Err("a value between two commas is missing".to_owned());
        }
        nodes.push(Node { span: place, ..text_as_written(value, place) });
    }
    Ok(nodes)
}

fn listed(values: &str, span: Span) -> Result<Vec<Node>, String> {
    // Paths and quoted texts may have two dots too.
    if let Some((lo, rest)) = values.split_once("..").filter(|_| !values.contains(['"', '/'])) {
        return range(lo, rest, span);
    }
    let mut at = span.start;
    let mut nodes = Vec::new();
    for value in parted_by_commas(values)? {
        let place = Span { start: at, end: at + value.len(), ..span };
        at = place.end + 1;
        let node = Node::parse(value.trim(), span.source).map_err(|_| format!("`{value}` is no value"))?;
        if let Some(comment) = comment_after(&node, value.trim()) {
            return Err(format!("`{comment}` would be a comment; put the value in quotes: \"{}\"", value.trim()));
        }
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

/// The parts of a list with commas, unless two of them may be meant to be one number.
fn parted_by_commas(values: &str) -> Result<Vec<&str>, String> {
    let parts = between_commas(values);
    match parts.windows(2).find_map(|pair| with_decimal_comma(pair[0], pair[1])) {
        None => Ok(parts),
        Some(number) => Err(format!(
            "commas part the values here: numbers are written with a point, {number}, and texts of digits in quotes, \"{}\"",
            number.rsplit('.').next().unwrap_or_default()
        )),
    }
}

/// The parts of a list with commas, but for those in double quotes.
fn between_commas(values: &str) -> Vec<&str> {
    let (mut quoted, mut escaped, mut begins) = (false, false, true);
    values
        .split(|letter: char| {
            let is_end = letter == ',' && !quoted;
            // A quote inside a value opens nothing.
            quoted ^= letter == '"' && !escaped && (quoted || begins);
            escaped = letter == '\\' && !escaped;
            begins = is_end || begins && letter == ' ';
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
mod tests;
