//! Whether the model can reach the reference: what is predicted at the proposal, feature by feature, and what to widen.

use rockface_core::artefact::{GroupModel, Table};
use rockface_core::numerics::quantile::quantile;
use rockface_core::table_row;

use super::{LEVEL, Posterior};
use crate::noise::acceptance_rate::share_below;
use crate::noise::mahalanobis::varying_distance;
use crate::noise::match_moments::Predicted;
use crate::noise::perfect_simulator::{Expectation, Setting};
use crate::noise::surrogate::Surrogate;

/// The prediction at the proposal beside what a perfect simulator would have.
pub struct Reach {
    pub predicted: Predicted,
    /// Share of simulations predicted to be accepted.
    pub share: f64,
    band: Expectation,
    references: usize,
    /// Features that are the same in all references, and the share of simulations that depart from one.
    constant: Vec<String>,
    departing: f64,
    features: Vec<Feature>,
}

/// One feature: how far each parameter moves it over the range searched.
struct Feature {
    name: String,
    /// Change of the mean, deviations of the reference, over the whole range of each parameter.
    moved: Vec<f64>,
    /// Change of the logarithm of its deviation.
    spread: Vec<f64>,
}

/// Factor of the deviation from which on the spread of a feature is not that of the reference.
const WRONG_SPREAD: f64 = 2.0;
/// Features named of each kind.
const NAMED: usize = 4;
/// Share of D2 that the features named for their mean make together.
const MOST_OF_D2: f64 = 0.8;
/// Share of simulations that depart from a constant feature from which on it is named.
const DEPARTING: f64 = 0.1;

/// The share of predicted rasters that the test accepts.
pub fn accepted_share(group: &GroupModel, standardised: &[Vec<f64>]) -> f64 {
    let threshold = quantile(&group.reference_d2, LEVEL).unwrap_or(f64::NAN);
    let values = |z: &Vec<f64>| -> Vec<f64> {
        z.iter()
            .zip(group.mean.iter().zip(&group.deviation))
            .map(|(z, (mean, deviation))| mean + z * deviation)
            .collect()
    };
    let d2: Vec<f64> = standardised.iter().map(|z| varying_distance(group, &values(z)).d2).collect();
    if d2.is_empty() { 0.0 } else { share_below(&d2, threshold) }
}

impl Reach {
    pub fn of(
        group: &GroupModel,
        setting: &Setting,
        surrogate: &Surrogate,
        at: &[f64],
        predicted: Predicted,
        departing: f64,
    ) -> Self {
        let threshold = quantile(&group.reference_d2, LEVEL).unwrap_or(f64::NAN);
        let leave_one_out = share_below(&group.leave_one_out_d2, threshold);
        let feature = |(j, name): (usize, &String)| Feature {
            name: name.clone(),
            moved: (0..at.len()).map(|a| 2.0 * surrogate.slope(at, a, j).0).collect(),
            spread: (0..at.len()).map(|a| 2.0 * surrogate.spread_slope(a, j)).collect(),
        };
        Self {
            share: (1.0 - departing) * accepted_share(group, &predicted.rasters),
            band: setting.simulate(&[LEVEL]).expectation(0, leave_one_out, &group.reference_d2),
            references: setting.references,
            constant: group.constant.clone(),
            departing,
            features: group.features.iter().enumerate().map(feature).collect(),
            predicted,
        }
    }

    /// Rasters predicted to pass, of as many as there are references.
    fn accepted(&self) -> usize {
        (self.share * self.references as f64).round() as usize
    }

    /// Whether as many are predicted to pass as of a perfect simulator.
    pub fn is_reached(&self) -> bool {
        self.accepted() >= self.band.low
    }

    pub fn summary(&self) -> String {
        format!(
            "mean features at D2 {:.1}, log-determinant ratio {:.1}; {} of {} predicted to pass, a perfect simulator would have {} to {}",
            self.predicted.d2,
            self.predicted.log_determinant_ratio,
            self.accepted(),
            self.references,
            self.band.low,
            self.band.high
        )
    }

    /// Features whose mean makes most of D2, the largest first.
    fn off(&self) -> Vec<usize> {
        let contributions = &self.predicted.contributions;
        let mut order: Vec<usize> = (0..contributions.len()).filter(|j| contributions[*j] > 1.0).collect();
        order.sort_by(|a, b| contributions[*b].total_cmp(&contributions[*a]));
        let most = MOST_OF_D2 * order.iter().map(|j| contributions[*j]).sum::<f64>();
        let mut sum = 0.0;
        order
            .into_iter()
            .take(NAMED)
            .take_while(|j| {
                let more = sum < most;
                sum += contributions[*j];
                more
            })
            .collect()
    }

    /// Features whose spread is not that of the reference, the farthest first.
    fn spread_off(&self) -> Vec<usize> {
        let size = |j: &usize| {
            let (ratio, _) = self.predicted.spread[*j];
            ratio.max(1.0 / ratio.max(f64::MIN_POSITIVE))
        };
        let mut order: Vec<usize> = (0..self.features.len()).filter(|j| size(j) > WRONG_SPREAD).collect();
        order.sort_by(|a, b| size(b).total_cmp(&size(a)));
        order.truncate(NAMED);
        order
    }

    /// What cannot be reached, which features say so, and what to do.
    pub fn words(&self, simulations: usize, parameters: &[String], posterior: &Posterior) -> String {
        let mut says: Vec<String> = Vec::new();
        for j in self.off() {
            let (name, offset) = (&self.features[j].name, self.predicted.offset[j]);
            let side = if offset > 0.0 { "above" } else { "below" };
            says.push(format!(
                "the mean of `{name}` lies {:.1} deviations {side} the real one and adds {:.0} to D2",
                offset.abs(),
                self.predicted.contributions[j]
            ));
        }
        for j in self.spread_off() {
            let (ratio, _) = self.predicted.spread[j];
            says.push(format!("the spread of `{}` is {ratio:.2} times the real one", self.features[j].name));
        }
        if self.departing > DEPARTING {
            says.push(format!(
                "{:.0} % of the simulations depart from the value that {} has in all references",
                100.0 * self.departing,
                self.constant.join(", ")
            ));
        }
        let mut remedies = posterior.widen();
        let unmoved = self.unmoved();
        if !unmoved.is_empty() {
            remedies.push(format!(
                "none of {} moves {} far enough: search another parameter, or add a term of the noise that does",
                parameters.join(", "),
                unmoved.join(", ")
            ));
        }
        // Few simulations over a wide range make means uncertain and spreads look wider than they are.
        remedies.push("simulate at points around the proposal and propose again, before a term is added".to_owned());
        format!(
            "as far as {simulations} simulations tell, the model cannot reach this site within the ranges searched: {} of {} are predicted to \
             pass, a perfect simulator would have {} to {}. What says so: {}. What to do: {}",
            self.accepted(),
            self.references,
            self.band.low,
            self.band.high,
            if says.is_empty() { "the features together, none by itself".to_owned() } else { says.join("; ") },
            remedies.join("; ")
        )
    }

    /// Features that are off and that no parameter moves, over its whole range, as far as they are off.
    fn unmoved(&self) -> Vec<String> {
        let largest = |changes: &[f64]| changes.iter().map(|x| x.abs()).fold(0.0, f64::max);
        let mean = |j: &usize| largest(&self.features[*j].moved) < self.predicted.offset[*j].abs();
        let needed = |j: usize| {
            rockface_core::numerics::portable_math::log(self.predicted.spread[j].0.max(f64::MIN_POSITIVE)).abs()
        };
        let spread = |j: &usize| largest(&self.features[*j].spread) < needed(*j);
        let means = self.off().into_iter().filter(mean).map(|j| format!("the mean of `{}`", self.features[j].name));
        let spreads =
            self.spread_off().into_iter().filter(spread).map(|j| format!("the spread of `{}`", self.features[j].name));
        means.chain(spreads).collect()
    }

    pub fn table(&self, parameters: &[String]) -> Table {
        let by = |changes: &[f64]| {
            let mut largest = 0;
            (0..changes.len()).for_each(|a| {
                if changes[a].abs() > changes[largest].abs() {
                    largest = a;
                }
            });
            (parameters[largest].clone(), changes[largest])
        };
        let row = |(j, feature): (usize, &Feature)| {
            let ((ratio, error), (mean, spread)) =
                (self.predicted.spread[j], (by(&feature.moved), by(&feature.spread)));
            FeatureReach {
                feature: feature.name.clone(),
                offset: self.predicted.offset[j],
                contribution: self.predicted.contributions[j],
                spread_ratio: ratio,
                spread_log_error: error,
                moved_by: mean.0,
                moved_over_range: mean.1,
                spread_by: spread.0,
                log_spread_over_range: spread.1,
            }
        };
        self.features.iter().enumerate().map(row).collect()
    }
}

table_row! {
    /// What is predicted of one feature at the proposal.
    struct FeatureReach {
        feature: String,
        offset: f64,
        contribution: f64,
        spread_ratio: f64,
        spread_log_error: f64,
        moved_by: String,
        moved_over_range: f64,
        spread_by: String,
        log_spread_over_range: f64,
    }
}
