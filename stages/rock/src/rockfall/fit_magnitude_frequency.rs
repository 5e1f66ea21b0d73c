//! `fit-magnitude-frequency`: fits the power law of rockfall volumes and tabulates their cumulative curve.

use crate::rockfall::goodness;
use crate::rockfall::power_law;
use crate::rockfall::power_law::PowerLaw;
use rockface_core::artefact::{Cell, Kind, Table};
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, params, table_row};
use rockface_raster::columns;

params! {
    /// Parameters of `fit-magnitude-frequency`.
    pub struct FitMagnitudeFrequencyParams {
        /// Column that holds the volumes.
        column: String = "removed_m3".to_owned(),
        /// Smallest volume the law is fitted to, cubic metres; left out, the one at which law and volumes agree best.
        minimum_m3: Option<f64> = None; Range::Positive,
        /// Largest volume there can be, cubic metres, such as that of simulated blocks; left out, the law has no upper end.
        maximum_m3: Option<f64> = None; Range::Positive,
        /// Volumes the law is fitted to at least; of fewer only the curve is told.
        least_count: u32 = 10; Range::AtLeast(2.0),
    }
}

/// Volumes the law is fitted to from which on a choice of `V_min` by the volumes hardly makes its exponent too large.
const MANY: usize = 100;

/// Share of sets drawn from the law below which volumes are said to follow none.
const NO_LAW: f64 = 0.05;

/// Fits a power law N(>= V) = n (V / V_min)^-b to the volumes of an inventory.
pub struct FitMagnitudeFrequency;

impl Stage for FitMagnitudeFrequency {
    type Params = FitMagnitudeFrequencyParams;
    const NAME: &'static str = "fit-magnitude-frequency";
    const VERSION: u32 = 5;
    const PAGE: Page = Page::new(include_str!("fit_magnitude_frequency.md"));
    const INPUTS: &'static [Port] =
        &[Port::one("volumes", &[Kind::Inventory, Kind::Table], "One volume a row, such as a ground truth.")];
    const OUTPUTS: &'static [Port] = &[
        Port::one("fit", &[Kind::Table], "b, its standard error, V_min, the counts and the distance, in one row."),
        Port::one("curve", &[Kind::Table], "Each volume, how many are at least as large, and how many by the law."),
    ];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let given = inputs.artefact("volumes")?;
        let (volumes, without) = columns::magnitudes(given, &params.column)?;
        if let Some((names, rows)) = columns::rows(given)
            && let Ok(at) = columns::place(names, &params.column)
            && let Some(text) = columns::text_among_numbers(&params.column, rows.iter().filter_map(|row| row.get(at)))
        {
            context.warn(text);
        }
        if without > 0 {
            context.note(format!("{without} rows have no positive number in `{}`", params.column));
        }
        if let (Some(maximum), Some(largest)) = (params.maximum_m3, volumes.last())
            && *largest > maximum * (1.0 + 1e-9)
        {
            return Err(StageError::new(format!("a volume of {largest} m3 is larger than `maximum_m3`, {maximum} m3"))
                .hint("leave `maximum_m3` out where nothing bounds the volumes"));
        }
        let Some(law) = power_law::fit(&volumes, params.minimum_m3, params.maximum_m3, params.least_count as usize)
        else {
            let why = why_not(&volumes, params);
            context.warn(&*why);
            context.headline(why);
            return Ok(Outputs::of("fit", no_law(&volumes, params)).and("curve", curve_table(&volumes, None)));
        };
        if params.minimum_m3.is_none() {
            let of_few =
                if law.count < MANY { "; of few tens of volumes more, and b is some 10 % too large" } else { "" };
            context.note(format!(
                "V_min was chosen by the volumes themselves: the standard error is some 20 to 30 % too small for that{of_few}. Give \
                 `minimum_m3` where it is known from which volume on the survey misses none"
            ));
        }
        let p_value = goodness::p_value(&volumes, &law, params.minimum_m3, params.least_count as usize);
        if p_value < NO_LAW {
            context.warn(format!(
                "these volumes follow no power law: the distance {:.3} between them and the law is reached by {:.1} % of sets of as many volumes drawn \
                 from it. b and its error say little; look at the curve, raise `minimum_m3` above the roll-over, give `maximum_m3` where volumes have an \
                 upper end, and see whether volumes are rounded",
                law.distance,
                100.0 * p_value
            ));
        }
        context.metric("exponent", law.exponent, "1");
        context.metric("ks_p_value", p_value, "1");
        context.metric("minimum", law.minimum, "m3");
        context.headline(format!(
            "b = {:.3} +- {:.3} for the {} volumes from {:.3e} m3 up, {} below",
            law.exponent, law.standard_error, law.count, law.minimum, law.below
        ));
        Ok(Outputs::of("fit", fit_table(&law, p_value)).and("curve", curve_table(&volumes, Some(&law))))
    }
}

fn why_not(volumes: &[f64], params: &FitMagnitudeFrequencyParams) -> String {
    let from = params.minimum_m3.unwrap_or(0.0);
    let count = volumes.iter().filter(|volume| **volume >= from).count();
    let range = match volumes {
        [] => "none".to_owned(),
        [first, .., last] => format!("from {first:.3e} to {last:.3e} m3"),
        [only] => format!("{only:.3e} m3"),
    };
    let is_even = count >= params.least_count as usize && volumes.first() != volumes.last();
    if let Some(maximum) = params.maximum_m3.filter(|_| is_even) {
        return format!(
            "no law: up to {maximum} m3 large volumes are as frequent as small ones, by their powers of ten"
        );
    }
    format!(
        "no law: {count} of the {} volumes ({range}) lie from {from} m3 up; {} that are not all equal are needed",
        volumes.len(),
        params.least_count
    )
}

table_row! {
    /// The power law of some volumes; without a law only its counts are known.
    struct Fit {
        exponent: Option<f64>,
        standard_error: Option<f64>,
        minimum_m3: Option<f64>,
        count: usize,
        count_below: usize,
        ks_distance: Option<f64>,
        density_exponent: Option<f64>,
        maximum_m3: Option<f64>,
        ks_p_value: Option<f64>,
    }
}

fn fit_table(law: &PowerLaw, p_value: f64) -> Table {
    let fit = Fit {
        exponent: Some(law.exponent),
        standard_error: Some(law.standard_error),
        minimum_m3: Some(law.minimum),
        count: law.count,
        count_below: law.below,
        ks_distance: Some(law.distance),
        density_exponent: Some(law.exponent + 1.0),
        maximum_m3: law.maximum,
        ks_p_value: Some(p_value),
    };
    std::iter::once(fit).collect()
}

/// The counts that are known without a law.
fn no_law(volumes: &[f64], params: &FitMagnitudeFrequencyParams) -> Table {
    let below = params.minimum_m3.map_or(0, |minimum| volumes.partition_point(|volume| *volume < minimum));
    let fit = Fit {
        exponent: None,
        standard_error: None,
        minimum_m3: params.minimum_m3,
        count: volumes.len() - below,
        count_below: below,
        ks_distance: None,
        density_exponent: None,
        maximum_m3: params.maximum_m3,
        ks_p_value: None,
    };
    std::iter::once(fit).collect()
}

fn curve_table(volumes: &[f64], law: Option<&PowerLaw>) -> Table {
    let mut table = Table::new(["volume_m3", "count_from", "count_by_law"]);
    for (volume, count) in power_law::curve(volumes) {
        let by_law = law.filter(|law| volume >= law.minimum).map_or(f64::NAN, |law| law.number_from(volume));
        table.push([volume, count as f64, by_law].map(Cell::from).to_vec());
    }
    table
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::Artefact;
    use rockface_core::testing::{TestHost, run_stage};

    fn table(volumes: impl IntoIterator<Item = f64>) -> Artefact {
        let mut table = Table::new(["removed_m3"]);
        volumes.into_iter().for_each(|volume| table.push(vec![volume.into()]));
        table.into()
    }

    #[test]
    fn law_and_curve_agree_at_the_smallest_volume() {
        let host = TestHost::default();
        let volumes = (1..=50).map(|i| 2.0 / f64::from(i)).chain([0.0]);
        let with = json!({"minimum_m3": 0.04});
        let made = run_stage::<FitMagnitudeFrequency>(&host, &with, &[("volumes", table(volumes))]).unwrap();
        let mut made = made.into_inner();
        let Some(Artefact::Table(curve)) = made.remove("curve") else { panic!("no curve") };
        let last = curve.rows.last().unwrap();
        assert_eq!((curve.rows.len(), last[1].number()), (50, Some(50.0)));
        assert!((last[2].number().unwrap() - 50.0).abs() < 1e-9);
        // V = 2 / i is a law of exponent 1; the estimate of 50 values lies within its standard error.
        let exponent = host.metric("exponent").unwrap();
        assert!((exponent - 1.0).abs() < exponent / 50f64.sqrt(), "{exponent}");
        assert_eq!(host.entries.lock().unwrap().len(), 5);
    }

    #[test]
    fn what_choosing_the_smallest_volume_does_to_the_error_is_told() {
        let told = |with: &serde_json::Value, count: u32, what: &str| {
            let host = TestHost::default();
            let volumes = [("volumes", table((1..=count).map(|i| 2.0 / f64::from(i))))];
            run_stage::<FitMagnitudeFrequency>(&host, with, &volumes).unwrap();
            let entries = host.entries.lock().unwrap();
            entries.iter().any(|entry| {
                matches!(entry, rockface_core::Entry::Note { text } if text.contains(what) && text.contains("`minimum_m3`"))
            })
        };
        assert!(told(&json!({}), 50, "standard error") && !told(&json!({"minimum_m3": 0.04}), 50, "standard error"));
        let too_large = "b is some 10 % too large";
        assert!(told(&json!({}), 50, too_large) && !told(&json!({}), 3000, too_large));
    }

    #[test]
    fn volumes_of_no_law_are_warned_of() {
        let p_value = |volumes: Vec<f64>| {
            let host = TestHost::default();
            let inputs = [("volumes", table(volumes))];
            let made = run_stage::<FitMagnitudeFrequency>(&host, &json!({"minimum_m3": 0.01}), &inputs).unwrap();
            let Artefact::Table(fit) = &made.into_inner()["fit"] else { panic!("no table") };
            let p = fit.rows[0][fit.column("ks_p_value").unwrap()].number().unwrap();
            (p, host.warnings().iter().any(|text| text.contains("follow no power law")))
        };
        let (p, told) = p_value((0..300).map(|i| if i < 150 { 0.01 } else { 1.0 }).collect());
        assert!(p < 0.01 && told);
        let (p, told) = p_value((1..=100).map(|i| 1.0 / f64::from(i)).collect());
        assert!(p > 0.5 && !told, "{p}");
    }

    #[test]
    fn text_among_the_volumes_is_warned_of() {
        let host = TestHost::default();
        let Artefact::Table(mut volumes) = table((1..=20).map(|i| 1.0 / f64::from(i))) else { panic!("no table") };
        volumes.rows[3][0] = "0,032".into();
        run_stage::<FitMagnitudeFrequency>(&host, &json!({}), &[("volumes", volumes.into())]).unwrap();
        let warnings = host.warnings();
        assert!(
            warnings.len() == 1 && warnings[0].contains("1 of 20 rows hold text in `removed_m3`, such as `0,032`"),
            "{warnings:?}"
        );
    }

    #[test]
    fn of_too_few_volumes_the_curve_is_told_and_why_there_is_no_law() {
        let host = TestHost::default();
        let with = json!({"minimum_m3": 3.0});
        let volumes = [("volumes", table([1.0, 2.0, 4.0]))];
        let mut made = run_stage::<FitMagnitudeFrequency>(&host, &with, &volumes).unwrap().into_inner();
        let (Some(Artefact::Table(fit)), Some(Artefact::Table(curve))) = (made.remove("fit"), made.remove("curve"))
        else {
            panic!("two tables")
        };
        let counts: Vec<Option<f64>> = fit.rows[0].iter().map(Cell::number).collect();
        assert_eq!(counts[2..5], [Some(3.0), Some(1.0), Some(2.0)]);
        assert!(fit.rows[0][0].number().is_none_or(f64::is_nan) && curve.rows.len() == 3);
        let warned = host.entries.lock().unwrap().iter().any(|entry| {
            matches!(entry, rockface_core::Entry::Warning { text } if text.contains("1 of the 3 volumes") && text.contains("10 that are not all equal"))
        });
        assert!(warned);
        let none =
            run_stage::<FitMagnitudeFrequency>(&TestHost::default(), &json!({}), &[("volumes", table([]))]).unwrap();
        assert_eq!(none.into_inner().len(), 2, "no volume at all is no failure either");
    }
}
