//! Axes: from values to places, with round ticks, linear, logarithmic or named.

use std::ops::Range;

use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};

use crate::figure::colour_scale::{ColourScale, Palette, decade_label, labels};
use rockface_core::numerics::portable_math;

/// An axis of a chart.
#[derive(Debug, Clone, PartialEq)]
pub struct Axis {
    /// What it shows, with its unit: `lag, m`.
    pub label: String,
    /// How values are laid out.
    pub kind: AxisKind,
    /// First and last value; `None` for what the layers need.
    pub range: Option<[f64; 2]>,
}

/// How values are laid out on an axis.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum AxisKind {
    /// In proportion to their differences.
    Linear,
    /// By their logarithm; values that are not positive are not drawn.
    Log,
    /// The places 0, 1, 2, ... have these names; on the vertical axis the first is at the top.
    Named(Vec<String>),
}

impl Axis {
    /// A linear axis whose range is what the layers need.
    pub fn linear(label: impl Into<String>) -> Self {
        Self { label: label.into(), kind: AxisKind::Linear, range: None }
    }

    /// A logarithmic axis whose range is what the layers need.
    pub fn log(label: impl Into<String>) -> Self {
        Self { label: label.into(), kind: AxisKind::Log, range: None }
    }

    /// An axis of names.
    pub fn named<S: Into<String>>(label: impl Into<String>, names: impl IntoIterator<Item = S>) -> Self {
        let names = names.into_iter().map(Into::into).collect();
        Self { label: label.into(), kind: AxisKind::Named(names), range: None }
    }

    /// Sets the first and last value.
    #[must_use]
    pub fn between(self, low: f64, high: f64) -> Self {
        Self { range: Some([low, high]), ..self }
    }
}

/// An axis with its range and ticks.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Scale {
    log: bool,
    low: f64,
    high: f64,
    ticks: Vec<(f64, String)>,
    minor: Vec<f64>,
}

/// Share of the range that is added at an end that is not zero.
const PADDING: f64 = 0.03;

impl Scale {
    /// The scale of an axis whose layers reach over `extent`, with about `count` ticks; `exact` without room at the ends.
    pub(super) fn of(axis: &Axis, extent: Option<[f64; 2]>, count: f64, exact: bool) -> Self {
        match &axis.kind {
            AxisKind::Named(names) => Self::named(names),
            AxisKind::Linear => Self::linear(range_of(axis, extent, exact), count),
            AxisKind::Log => {
                let wanted = axis.range.or(extent).filter(|[low, high]| *low > 0.0 && *high > 0.0 && high.is_finite());
                let logs = wanted.map(|ends| ends.map(portable_math::log10));
                let given = Axis { range: axis.range.and(logs), ..axis.clone() };
                Self::log(range_of(&given, logs, exact), count)
            }
        }
    }

    /// Turns the axis round, so that the first name is at the top.
    pub(super) fn downwards(mut self) -> Self {
        std::mem::swap(&mut self.low, &mut self.high);
        self
    }

    fn named(names: &[String]) -> Self {
        let ticks = names.iter().enumerate().map(|(place, name)| (place as f64, name.clone())).collect();
        Self { log: false, low: -0.5, high: names.len() as f64 - 0.5, ticks, minor: Vec::new() }
    }

    fn linear([low, high]: [f64; 2], count: f64) -> Self {
        let values = ColourScale { palette: Palette::Viridis, low, high }.ticks(count);
        let ticks = values.iter().copied().zip(labels(&values, 1.0)).collect();
        Self { log: false, low, high, ticks, minor: Vec::new() }
    }

    /// From the logarithms of the ends.
    fn log([low, high]: [f64; 2], count: f64) -> Self {
        let (first, last) = ((low - 1e-9).ceil() as i32, (high + 1e-9).floor() as i32);
        let step = ((f64::from(last - first) + 1.0) / count.max(2.0)).ceil().max(1.0) as i32;
        let decade = |power: i32| portable_math::pow(10.0, f64::from(power));
        let mut ticks: Vec<(f64, String)> =
            (first..=last).filter(|power| power.rem_euclid(step) == 0).map(|p| (decade(p), decade_label(p))).collect();
        let inside = |value: &f64| (low - 1e-9..=high + 1e-9).contains(&portable_math::log10(*value));
        let between = |digits: &'static [i32]| {
            (first - 1..=last)
                .flat_map(move |power| digits.iter().map(move |digit| f64::from(*digit) * decade(power)))
                .filter(inside)
        };
        if ticks.len() < 2 {
            ticks.extend(between(&[2, 5]).map(|value| (value, short(value))));
            ticks.sort_by(|one, other| one.0.total_cmp(&other.0));
        }
        if ticks.len() < 2 {
            return Self { log: true, ..Self::linear([decimal(low), decimal(high)], count) };
        }
        let minor = if step == 1 { between(&[2, 3, 4, 5, 6, 7, 8, 9]).collect() } else { Vec::new() };
        Self { log: true, low: decimal(low), high: decimal(high), ticks, minor }
    }

    /// Where a value lies, 0 at the first and 1 at the last; `None` where it cannot be drawn.
    pub(super) fn share(&self, value: f64) -> Option<f64> {
        let along = |value: f64| if self.log { portable_math::log10(value) } else { value };
        let share = (along(value) - along(self.low)) / (along(self.high) - along(self.low));
        share.is_finite().then_some(share)
    }

    /// The value nearest to this one that the axis shows.
    pub(super) fn clamped(&self, value: f64) -> f64 {
        value.clamp(self.low.min(self.high), self.low.max(self.high))
    }

    /// Whether the axis shows a value.
    pub(super) fn shows(&self, value: f64) -> bool {
        self.share(value).is_some_and(|share| (-1e-9..=1.0 + 1e-9).contains(&share))
    }

    /// First and last value.
    pub(super) fn ends(&self) -> [f64; 2] {
        [self.low, self.high]
    }

    /// Texts at the ticks.
    pub(super) fn labels(&self) -> impl Iterator<Item = &str> {
        self.ticks.iter().map(|(_, label)| label.as_str())
    }
}

fn decimal(power: f64) -> f64 {
    portable_math::pow(10.0, power)
}

/// The range asked for, or the extent with a little room; never empty.
fn range_of(axis: &Axis, extent: Option<[f64; 2]>, exact: bool) -> [f64; 2] {
    let proper = |[low, high]: &[f64; 2]| low.is_finite() && high.is_finite() && low < high;
    if let Some(range) = axis.range.filter(proper) {
        return range;
    }
    let [low, high] = extent.filter(|ends| ends.iter().all(|end| end.is_finite())).unwrap_or([0.0, 1.0]);
    if low >= high {
        let room = if low == 0.0 { 1.0 } else { 0.5 * low.abs() };
        return [low - room, low + room];
    }
    let room = |end: f64| if exact || end == 0.0 { 0.0 } else { PADDING * (high - low) };
    [low - room(low), high + room(high)]
}

/// A value with one digit other than zero.
fn short(value: f64) -> String {
    if (1e-4..1e5).contains(&value) {
        return crate::figure::colour_scale::rounded(value, value);
    }
    let power = (portable_math::log10(value) + 1e-9).floor() as i32;
    format!("{:.0}\u{b7}{}", value / decimal(f64::from(power)), decade_label(power))
}

impl Ranged for Scale {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, value: &f64, (first, last): (i32, i32)) -> i32 {
        let share = self.share(*value).unwrap_or(0.0).clamp(-10.0, 10.0);
        first + (share * f64::from(last - first)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() { self.minor.clone() } else { self.ticks.iter().map(|t| t.0).collect() }
    }

    fn range(&self) -> Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for Scale {
    fn format_ext(&self, value: &f64) -> String {
        let exact = |tick: &&(f64, String)| tick.0.to_bits() == value.to_bits();
        self.ticks.iter().find(exact).map_or_else(String::new, |tick| tick.1.clone())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ticks(axis: &Axis, extent: [f64; 2]) -> Vec<String> {
        Scale::of(axis, Some(extent), 5.0, false).labels().map(str::to_owned).collect()
    }

    #[test]
    fn ticks_are_round() {
        assert_eq!(ticks(&Axis::linear("x, m"), [0.0, 0.8]), ["0.0", "0.2", "0.4", "0.6", "0.8"]);
        assert_eq!(ticks(&Axis::log("x, m"), [0.002, 3.0]), ["0.01", "0.1", "1"]);
        assert_eq!(ticks(&Axis::log("x, m"), [1.5, 7.0]), ["2", "5"]);
        assert_eq!(ticks(&Axis::log("x, m"), [0.13, 0.17]), ["0.13", "0.14", "0.15", "0.16", "0.17"]);
        assert_eq!(ticks(&Axis::named("class", ["a", "b"]), [0.0, 0.0]), ["a", "b"]);
    }

    #[test]
    fn values_have_their_places_on_either_kind() {
        let scale = Scale::of(&Axis::log("x").between(0.01, 100.0), None, 5.0, true);
        assert!((scale.share(1.0).unwrap() - 0.5).abs() < 1e-12 && scale.share(-1.0).is_none());
        let scale = Scale::of(&Axis::linear("x").between(-1.0, 3.0), None, 5.0, true);
        assert_eq!((scale.share(1.0), scale.map(&1.0, (100, 0))), (Some(0.5), 50));
        assert!(scale.shows(3.0) && !scale.shows(3.1) && !scale.shows(f64::NAN));
    }

    #[test]
    fn no_values_and_equal_values_still_have_an_axis() {
        for extent in [None, Some([0.0, 0.0]), Some([5.0, 5.0]), Some([f64::NAN, 1.0])] {
            for axis in [Axis::linear("x"), Axis::log("x"), Axis::linear("x").between(3.0, 3.0)] {
                let [low, high] = Scale::of(&axis, extent, 5.0, false).ends();
                assert!(low < high, "{axis:?} over {extent:?}: {low} to {high}");
            }
        }
    }
}
