//! Sweeps as curves: a number of a step against a swept axis, median and spread over everything else.

use std::collections::{HashMap, HashSet};
use std::fmt::Write as _;

use rockface_core::numerics::quantile;
use rockface_engine::history::{Manifest, StepDone};
use rockface_engine::plan::Graph;
use serde::Serialize;

use super::number::short;
use crate::drawing::escaped;

/// Curves of a page at most.
const CURVES: usize = 24;
/// Size of a drawing, and the room around it for its labels, pixels.
const SIZE: [f64; 2] = [300.0, 190.0];
/// Room of a letter of a label on the left, and what lies between label, axis and margin.
const LETTER: f64 = 7.5;
const GAP: f64 = 5.0;
const RIGHT: f64 = 10.0;
const TOP: f64 = 10.0;
const BOTTOM: f64 = 36.0;

/// A metric drawn against a swept axis.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Curve {
    /// The number, its unit and the axis.
    pub caption: String,
    /// The drawing: the text of an SVG element that stands in the page as it is.
    pub svg: String,
}

/// The values of a number at one item of the axis.
struct At {
    x: f64,
    values: Vec<f64>,
}

/// The curves of the target steps over axes of numbers that are swept, and how many more there are. Targets that only gather, such as a table
/// of all points, have none: then those of all other steps are drawn, the last first.
///
/// Axes whose items reseed random streams are replicates: their spread is the band.
pub fn of(manifest: &Manifest, graph: &Graph, targets: &[String]) -> (Vec<Curve>, usize) {
    let mut seen: HashSet<&str> = HashSet::new();
    let axes = graph.axes.iter().filter(|axis| !axis.reseeds && seen.insert(&axis.label));
    let swept: Vec<Abscissa> = axes.flat_map(|axis| Abscissa::of(&axis.label, manifest)).collect();
    if swept.is_empty() {
        return (Vec::new(), 0);
    }
    let mut instances: HashMap<&str, Vec<&StepDone>> = HashMap::new();
    for done in &manifest.steps {
        instances.entry(&done.step).or_default().push(done);
    }
    let of_targets = of_steps(manifest, &instances, targets.iter().map(String::as_str), &swept);
    if !of_targets.0.is_empty() {
        return of_targets;
    }
    let mut seen: HashSet<&str> = HashSet::new();
    let others = manifest.steps.iter().rev().map(|done| done.step.as_str()).filter(|step| seen.insert(step));
    of_steps(manifest, &instances, others, &swept)
}

/// What numbers are drawn over: the items of an axis, or one of the values that they have.
struct Abscissa<'a> {
    axis: &'a str,
    value: Option<&'a str>,
}

impl<'a> Abscissa<'a> {
    /// Where items have values, their names are only numbers of rows: they are not drawn over.
    fn of(axis: &'a str, manifest: &'a Manifest) -> Vec<Self> {
        let names = manifest.value_names(axis);
        if names.is_empty() {
            return vec![Self { axis, value: None }];
        }
        names.into_iter().map(|name| Self { axis, value: Some(name) }).collect()
    }

    fn name(&self) -> String {
        self.value.map_or_else(|| self.axis.to_owned(), |value| format!("{}.{value}", self.axis))
    }

    /// Where an instance stands.
    fn at(&self, done: &StepDone, manifest: &Manifest) -> Option<f64> {
        let item = done.point.get(self.axis)?;
        match self.value {
            None => item.parse().ok(),
            Some(name) => manifest.value(self.axis, item, name)?.as_f64(),
        }
    }
}

fn of_steps<'a>(
    manifest: &Manifest,
    instances: &HashMap<&str, Vec<&StepDone>>,
    steps: impl Iterator<Item = &'a str>,
    swept: &[Abscissa],
) -> (Vec<Curve>, usize) {
    let (mut curves, mut more) = (Vec::new(), 0);
    for target in steps {
        let Some(instances) = instances.get(target) else { continue };
        let mut names: Vec<(&str, &str)> = Vec::new();
        for metric in instances.iter().flat_map(|done| &done.metrics) {
            if !names.iter().any(|(name, _)| *name == metric.name) {
                names.push((&metric.name, &metric.unit));
            }
        }
        for axis in swept {
            for (name, unit) in &names {
                let told = instances.iter().filter_map(|done| {
                    let x = axis.at(done, manifest)?;
                    let metric = done.metrics.iter().find(|metric| metric.name == *name)?;
                    Some((x, metric.value.filter(|value| value.is_finite())?))
                });
                let Some(curve) = gathered(told.collect()) else { continue };
                if curves.len() == CURVES {
                    more += 1;
                    continue;
                }
                let unit = if *unit == "1" { String::new() } else { format!(" [{unit}]") };
                let over = axis.name();
                let caption = format!("{target}.{name}{unit} over {over}");
                curves.push(Curve { svg: drawn(&curve, &caption, &over, axis.value.is_none()), caption });
            }
        }
    }
    (curves, more)
}

/// Values by place on the axis, ascending; `None` for fewer than two places, or one value everywhere.
fn gathered(mut told: Vec<(f64, f64)>) -> Option<Vec<At>> {
    told.retain(|(x, _)| x.is_finite());
    told.sort_by(|one, other| one.0.total_cmp(&other.0).then(one.1.total_cmp(&other.1)));
    let mut curve: Vec<At> = Vec::new();
    for (x, value) in told {
        match curve.last_mut() {
            Some(last) if last.x.to_bits() == x.to_bits() => last.values.push(value),
            _ => curve.push(At { x, values: vec![value] }),
        }
    }
    let first = curve.first()?.values[0].to_bits();
    let varies = curve.iter().flat_map(|at| &at.values).any(|value| value.to_bits() != first);
    (curve.len() > 1 && varies).then_some(curve)
}

fn median(sorted: &[f64]) -> f64 {
    quantile::of_sorted(sorted, 0.5).unwrap_or(f64::NAN)
}

/// Medians as points; `joined` by a line, with the spread as a band. Points of a design differ in other values too, and are not.
fn drawn(curve: &[At], caption: &str, axis: &str, joined: bool) -> String {
    let low = |values: &[f64]| values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = |values: &[f64]| values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let (x0, x1) = (curve[0].x, curve[curve.len() - 1].x);
    let y0 = curve.iter().map(|at| low(&at.values)).fold(f64::INFINITY, f64::min);
    let y1 = curve.iter().map(|at| high(&at.values)).fold(f64::NEG_INFINITY, f64::max);
    let [width, height] = SIZE;
    let letters = [y0, y1].map(|value| short(value).chars().count()).into_iter().max().unwrap_or_default();
    let left = 2.0 * GAP + LETTER * letters as f64;
    let across = |x: f64| left + (x - x0) / (x1 - x0) * (width - left - RIGHT);
    let down = |y: f64| height - BOTTOM - (y - y0) / (y1 - y0) * (height - TOP - BOTTOM);
    let point = |x: f64, y: f64| format!("{:.1},{:.1}", across(x), down(y));
    let line: Vec<String> = curve.iter().map(|at| point(at.x, median(&at.values))).collect();
    let upper = curve.iter().map(|at| point(at.x, high(&at.values)));
    let lower = curve.iter().rev().map(|at| point(at.x, low(&at.values)));
    let band: Vec<String> = upper.chain(lower).collect();
    let mut svg = format!(
        "<svg viewBox=\"0 0 {width} {height}\" width=\"{width}\" height=\"{height}\" role=\"img\" aria-label=\"{}\" \
         font-size=\"12\" fill=\"currentColor\">",
        escaped(caption)
    );
    if joined {
        let _ = write!(svg, "<polygon points=\"{}\" fill=\"#4477aa\" fill-opacity=\"0.25\"/>", band.join(" "));
        let line = line.join(" ");
        let _ = write!(svg, "<polyline points=\"{line}\" fill=\"none\" stroke=\"#4477aa\" stroke-width=\"2\"/>");
    }
    for at in curve {
        let (x, y) = (across(at.x), down(median(&at.values)));
        let _ = write!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"3\" fill=\"#4477aa\"/>");
    }
    let (bottom, right) = (height - BOTTOM, width - RIGHT);
    let _ = write!(svg, "<path d=\"M{left} {TOP}V{bottom}H{right}\" fill=\"none\" stroke=\"currentColor\"/>");
    for (y, value) in [(bottom, y0), (TOP + 8.0, y1)] {
        let _ = write!(svg, "<text x=\"{}\" y=\"{y:.0}\" text-anchor=\"end\">{}</text>", left - GAP, short(value));
    }
    for (x, anchor, value) in [(left, "start", x0), (right, "end", x1)] {
        let _ = write!(svg, "<text x=\"{x}\" y=\"{}\" text-anchor=\"{anchor}\">{}</text>", bottom + 15.0, short(value));
    }
    let middle = 0.5 * (left + right);
    let _ = write!(
        svg,
        "<text x=\"{middle}\" y=\"{}\" text-anchor=\"middle\">{}</text></svg>",
        height - 6.0,
        escaped(axis)
    );
    svg
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_has_the_medians_and_the_spread() {
        let told = vec![(0.5, 3.0), (0.5, 1.0), (0.5, 2.0), (1.0, 4.0), (1.0, 6.0)];
        let curve = gathered(told).unwrap();
        assert_eq!(curve.iter().map(|at| (at.x, median(&at.values))).collect::<Vec<_>>(), [(0.5, 2.0), (1.0, 5.0)]);
        let svg = drawn(&curve, "a \"<b>\"", "sigma", true);
        assert!(svg.contains("&quot;&lt;b&gt;") && svg.contains(">6</text>") && !svg.contains("NaN"), "{svg}");
        assert!(gathered(vec![(1.0, 1.0), (2.0, 1.0)]).is_none() && gathered(vec![(1.0, 1.0), (1.0, 2.0)]).is_none());
    }

    #[test]
    fn points_of_a_design_are_not_joined() {
        let curve = gathered(vec![(0.1, 3.0), (2.5, 1.0)]).unwrap();
        let [joined, alone] = [true, false].map(|joined| drawn(&curve, "a", "at.a_m", joined));
        assert!(joined.contains("<polyline") && !alone.contains("<polyline") && !alone.contains("<polygon"));
        assert_eq!(alone.matches("<circle").count(), 2);
    }
}
