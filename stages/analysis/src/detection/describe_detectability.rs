//! `describe-detectability`: which changes are found, by volume, depth, shape, position or any other property.

use std::collections::BTreeMap;

use crate::detection::detectability;
use crate::detection::detectability::Class;
use rockface_core::artefact::{Cell, Kind, Table};
use rockface_core::numerics::proportion::wilson_interval;
use rockface_core::numerics::quantile::median;
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params, table_row};
use rockface_raster::columns;

params! {
    /// Parameters of `describe-detectability`.
    pub struct DescribeDetectabilityParams {
        /// Properties: columns of numbers, or of words, each of which is a class.
        properties: Vec<String> = ["removed_m3", "depth_max_m", "plan_area_m2", "shape_class", "flatness", "elongation",
            "centroid_x_m", "centroid_y_m", "visible_fraction"].map(str::to_owned).to_vec(),
        /// Classes of a property of numbers.
        classes: u32 = 8; Range::Between(1.0, 1000.0),
        /// Probability at which a change is called detectable.
        probability: f64 = 0.9; Range::Between(0.01, 0.99),
    }
}

/// Computes which true changes are found.
pub struct DescribeDetectability;

impl Stage for DescribeDetectability {
    type Params = DescribeDetectabilityParams;
    const NAME: &'static str = "describe-detectability";
    const VERSION: u32 = 6;
    const PAGE: Page = Page::new(include_str!("describe_detectability.md"));
    const INPUTS: &'static [Port] =
        &[Port::one("truth", &[Kind::Inventory, Kind::Table], "The `truth` of `score-detections`, or many joined.")];
    const OUTPUTS: &'static [Port] = &[
        Port::one("classes", &[Kind::Table], "One row a class of a property: counts, share found, volume error."),
        Port::one("limits", &[Kind::Table], "One row a property with a curve: where half are found, and more."),
    ];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let truth = inputs.artefact("truth")?;
        let Some((columns, rows)) = columns::rows(truth) else { fail!("a {} has no columns", truth.kind()) };
        let place = |name: &str| columns.iter().position(|column| column == name);
        let hinted = |missing: StageError| missing.hint("connect the port `truth` of `score-detections`");
        let outcome = columns::place(columns, "outcome").map_err(hinted)?;
        let counted = |row: &&&[Cell]| ["found", "missed"].contains(&row[outcome].text().unwrap_or_default());
        let rows: Vec<&[Cell]> = rows.iter().filter(counted).copied().collect();
        if rows.is_empty() {
            fail!("no change is `found` or `missed`: nothing counts");
        }
        let found: Vec<bool> = rows.iter().map(|row| row[outcome].text() == Some("found")).collect();
        let error = place("volume_error");
        let errors = rows.iter().map(|row| error.and_then(|at| row[at].number())).collect();
        let scene = Scene { rows, found, errors };
        let known: Vec<(&String, usize)> =
            params.properties.iter().filter_map(|name| Some((name, place(name)?))).collect();
        if known.is_empty() {
            fail!("none of the properties is a column; there are {}", columns.join(", "));
        }
        let of = |(name, at): &(&String, usize)| scene.classes(name, *at, params.classes as usize);
        let classes: Table = known.iter().flat_map(of).collect();
        let limit = |(name, at): &(&String, usize)| scene.limit(name, *at, params.probability);
        let limits: Table = known.iter().filter_map(limit).collect();
        report(&limits, &scene, params, context);
        Ok(Outputs::of("classes", classes).and("limits", limits))
    }
}

table_row! {
    /// The true changes of one class of a property.
    struct ClassRow {
        property: String,
        class: String,
        from: f64,
        to: f64,
        count: usize,
        found: usize,
        share_found: f64,
        share_low: f64,
        share_high: f64,
        volume_error_median: Option<f64>,
    }
}

table_row! {
    /// From which value of a property on changes are found.
    struct LimitRow {
        property: String,
        count: usize,
        at_50: Option<f64>,
        at_probability: Option<f64>,
        probability: f64,
        slope: f64,
        slope_se: f64,
        ceiling: f64,
        at_50_low: Option<f64>,
        at_50_high: Option<f64>,
        at_probability_low: Option<f64>,
        at_probability_high: Option<f64>,
    }
}

/// The true changes that count.
struct Scene<'a> {
    rows: Vec<&'a [Cell]>,
    found: Vec<bool>,
    errors: Vec<Option<f64>>,
}

impl Scene<'_> {
    fn classes(&self, name: &str, at: usize, count: usize) -> Vec<ClassRow> {
        let mut words: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
        for (row, cells) in self.rows.iter().enumerate() {
            if let Some(word) = cells[at].text() {
                words.entry(word).or_default().push(row);
            }
        }
        let word = |(word, rows): (&str, Vec<usize>)| (word.to_owned(), Class { from: f64::NAN, to: f64::NAN, rows });
        let numbers: Vec<Option<f64>> = self.rows.iter().map(|cells| cells[at].number()).collect();
        let number = |(place, class): (usize, Class)| ((place + 1).to_string(), class);
        let numbered = detectability::classes(&numbers, count).into_iter().enumerate().map(number);
        words.into_iter().map(word).chain(numbered).map(|(label, class)| self.class(name, label, &class)).collect()
    }

    fn class(&self, property: &str, label: String, class: &Class) -> ClassRow {
        let count = class.rows.len();
        let found = class.rows.iter().filter(|row| self.found[**row]).count();
        let (low, high) = if count > 0 { wilson_interval(found, count) } else { (f64::NAN, f64::NAN) };
        let mut errors: Vec<f64> = class.rows.iter().filter_map(|row| self.errors[*row]).collect();
        ClassRow {
            property: property.to_owned(),
            class: label,
            from: class.from,
            to: class.to,
            count,
            found,
            share_found: found as f64 / count as f64,
            share_low: low,
            share_high: high,
            volume_error_median: median(&mut errors),
        }
    }

    fn limit(&self, property: &str, at: usize, probability: f64) -> Option<LimitRow> {
        let known = self.rows.iter().zip(&self.found).filter_map(|(cells, found)| Some((cells[at].number()?, *found)));
        let (values, found): (Vec<f64>, Vec<bool>) = known.filter(|(value, _)| *value > 0.0).unzip();
        // A property that may be negative or zero, such as a position, has no logarithm.
        if values.len() < self.rows.len() {
            return None;
        }
        let curve = detectability::curve(&values, &found)?;
        let [least, largest] =
            values.iter().fold([f64::INFINITY, 0.0f64], |[least, most], x| [least.min(*x), most.max(*x)]);
        // Beyond the changes there are, a curve tells nothing, and a flat one nowhere.
        let seen = |size: &f64| curve.is_certain() && (least..=largest).contains(size);
        let limit = |probability: f64| {
            let at = curve.at(probability).filter(seen);
            let [low, high] = at.map_or([None; 2], |_| curve.interval(probability));
            [at, low, high]
        };
        let [at_50, at_50_low, at_50_high] = limit(0.5);
        let [at_probability, at_probability_low, at_probability_high] = limit(probability);
        Some(LimitRow {
            property: property.to_owned(),
            count: values.len(),
            at_50,
            at_probability,
            probability,
            slope: curve.slope,
            slope_se: curve.slope_se,
            ceiling: curve.ceiling,
            at_50_low,
            at_50_high,
            at_probability_low,
            at_probability_high,
        })
    }
}

fn report(limits: &Table, scene: &Scene, params: &DescribeDetectabilityParams, context: &Context) {
    let found = scene.found.iter().filter(|found| **found).count();
    let total = scene.found.len();
    let first = limits.rows.iter().find(|row| row[0].text() == params.properties.first().map(String::as_str));
    let Some(row) = first else {
        context.headline(format!("{found} of {total} found; no curve of {}", params.properties.join(", ")));
        return;
    };
    let [half, most, slope, slope_se] = [2, 3, 5, 6].map(|column| row[column].number());
    let ceiling = row[7].number().unwrap_or(1.0);
    if let Some(half) = half {
        context.metric("at_50", half, "1");
    }
    let name = row[0].to_string();
    let share = format!("{:.0} %", 100.0 * params.probability);
    let interval = |low: usize| match [low, low + 1].map(|column| row[column].number()) {
        [Some(low), Some(high)] => format!(" ({low:.1e} to {high:.1e})"),
        [Some(low), None] => format!(" ({low:.1e} or more, without an upper end)"),
        [None, Some(high)] => format!(" ({high:.1e} or less, without a lower end)"),
        [None, None] => String::new(),
    };
    let most_is = |most: f64| format!("{share} of those with {most:.2e}{}", interval(10));
    let half_is = |half: f64| format!("half of those with {name} {half:.2e}{}", interval(8));
    let limits = match (half, most) {
        (Some(half), Some(most)) => format!("{}, {}", half_is(half), most_is(most)),
        (Some(half), None) if ceiling <= params.probability => {
            let ceiling = 100.0 * ceiling;
            format!("{}, {share} at no size, as {ceiling:.0} % of the largest are found", half_is(half))
        }
        (Some(half), None) => format!("{}; the limit for {share} is outside their range", half_is(half)),
        (None, Some(most)) => {
            format!("{share} of those with {name} {most:.2e}; the limit for half is outside their range")
        }
        (None, None) => format!(
            "no limit of {name} among them (slope {:.2}, standard error {:.2})",
            slope.unwrap_or(f64::NAN),
            slope_se.unwrap_or(f64::NAN)
        ),
    };
    context.headline(format!("{found} of {total} found; {limits}"));
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::Artefact;
    use rockface_core::testing::{TestHost, run_stage};

    #[test]
    fn shares_by_class_and_the_curve() {
        let mut truth = Table::new(["removed_m3", "shape_class", "outcome", "volume_error", "centroid_x_m"]);
        for i in 0..40u32 {
            let volume = 0.001 * f64::from(i + 1);
            // Larger than 15 dm3 is found, but for one, and one smaller.
            let found = (i >= 15) != (i == 20 || i == 10);
            let outcome = if i == 0 {
                "hidden"
            } else if found {
                "found"
            } else {
                "missed"
            };
            let error = if found { -0.2 } else { f64::NAN };
            let shape = if i % 2 == 0 { "C" } else { "VB" };
            truth.push(vec![volume.into(), shape.into(), outcome.into(), error.into(), (f64::from(i) - 20.0).into()]);
        }
        let with = json!({"properties": ["removed_m3", "shape_class", "centroid_x_m"], "classes": 2});
        let made = run_stage::<DescribeDetectability>(&TestHost::default(), &with, &[("truth", truth.into())]);
        let made = made.unwrap().into_inner();
        let (Artefact::Table(classes), Artefact::Table(limits)) = (&made["classes"], &made["limits"]) else {
            panic!("no tables")
        };
        assert_eq!(classes.rows.len(), 2 + 2 + 2);
        let counts: Vec<f64> = classes.rows.iter().filter_map(|row| row[4].number()).collect();
        assert!((counts.iter().sum::<f64>() - 3.0 * 39.0).abs() < 1e-12);
        let compact = classes.rows.iter().find(|row| row[1].text() == Some("C")).unwrap();
        assert_eq!((compact[4].number(), compact[5].number()), (Some(19.0), Some(12.0)));
        assert_eq!(compact[9].number(), Some(-0.2));
        assert_eq!(limits.rows.len(), 1);
        let half = limits.rows[0][2].number().unwrap();
        assert!((0.01..0.02).contains(&half), "{half}");
    }

    #[test]
    fn a_curve_gives_no_limit_beyond_the_changes_there_are() {
        let limits = |found: fn(u32) -> bool| {
            let mut truth = Table::new(["removed_m3", "outcome"]);
            for i in 0..48u32 {
                let outcome = if found(i) { "found" } else { "missed" };
                truth.push(vec![(0.001 * f64::from(i + 1)).into(), outcome.into()]);
            }
            let host = TestHost::default();
            let with = json!({"properties": ["removed_m3"]});
            let made =
                run_stage::<DescribeDetectability>(&host, &with, &[("truth", truth.into())]).unwrap().into_inner();
            let Artefact::Table(limits) = &made["limits"] else { panic!("no table") };
            let row = &limits.rows[0];
            assert!(row[5].number().is_some() && row[6].number().is_some());
            ([row[2].number(), row[3].number()].map(|limit| limit.is_some()), host.metric("at_50").is_some())
        };
        // Found more often when large, but not nine times of ten; and whatever the size.
        assert_eq!(limits(|i| i % 3 == 0 && i > 8 || i > 26 && i % 4 != 0), ([true, false], true));
        assert_eq!(limits(|i| i % 12 == 5), ([false, false], false));
    }

    #[test]
    fn an_inventory_that_was_not_scored_is_refused() {
        let table = Table::new(["removed_m3"]);
        let error = run_stage::<DescribeDetectability>(&TestHost::default(), &json!({}), &[("truth", table.into())]);
        assert!(error.unwrap_err().hint.unwrap().contains("score-detections"));
    }
}
