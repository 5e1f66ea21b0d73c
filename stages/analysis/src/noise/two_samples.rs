//! Can a classifier tell two samples apart? Four kinds of classifier, cross-validated, and the same by splitting one sample
//! (classifier two-sample test, Lopez-Paz and Oquab 2017).
//!
//! Comparisons of a chain share epochs. A classifier that has seen a raster knows something of those beside it, so what
//! shares an epoch with a row that is held out takes no part in the training. Halves of one sample are made of runs of
//! neighbouring rows for the same reason.

use rayon::prelude::*;
use rockface_core::numerics::random::Key;

use super::classifier::{Logistic, Standard, area};
use super::stumps::Stumps;

/// Kinds of classifier, each of which sees other differences.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Classifier {
    /// Logistic regression: sees shifts.
    Linear,
    /// Logistic regression on the features and their squares: sees spreads too.
    Squares,
    /// Mean distance to the nearest rows of either class: sees whatever changes density.
    Neighbours,
    /// Boosted stumps: see thresholds and bands of single features.
    Stumps,
}

impl Classifier {
    /// All of them, in the order they are reported.
    pub const ALL: [Self; 4] = [Self::Linear, Self::Squares, Self::Neighbours, Self::Stumps];

    /// The name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Linear => "linear",
            Self::Squares => "squares",
            Self::Neighbours => "neighbours",
            Self::Stumps => "stumps",
        }
    }

    /// Scores of rows by a classifier of the training rows; positive ones speak for the second class.
    fn scores(self, training: [&[&[f64]]; 2], rows: &[&[f64]], ridge: f64) -> Vec<f64> {
        match self {
            Self::Linear => {
                let model = Logistic::fit(training, ridge);
                rows.iter().map(|row| model.score(row)).collect()
            }
            Self::Squares => {
                let standard = standard(training);
                let extended =
                    |rows: &[&[f64]]| rows.iter().map(|row| with_squares(&standard, row)).collect::<Vec<_>>();
                let training = training.map(extended);
                let slices = training.each_ref().map(|class| class.iter().map(Vec::as_slice).collect::<Vec<_>>());
                let model = Logistic::fit([&slices[0], &slices[1]], ridge);
                extended(rows).iter().map(|row| model.score(row)).collect()
            }
            Self::Neighbours => {
                let standard = standard(training);
                let training = training.map(|rows| rows.iter().map(|row| standard.scores(row)).collect::<Vec<_>>());
                let score = |row: &&[f64]| {
                    let row = standard.scores(row);
                    nearness(&training[0], &row) - nearness(&training[1], &row)
                };
                rows.iter().map(score).collect()
            }
            Self::Stumps => {
                let model = Stumps::fit(training);
                rows.iter().map(|row| model.score(row)).collect()
            }
        }
    }
}

fn standard(training: [&[&[f64]]; 2]) -> Standard {
    Standard::of(&training.iter().flat_map(|class| class.iter().copied()).collect::<Vec<_>>())
}

fn with_squares(standard: &Standard, row: &[f64]) -> Vec<f64> {
    let z = standard.scores(row);
    z.iter().copied().chain(z.iter().map(|z| z * z)).collect()
}

/// Mean distance to the nearest eighth of the rows of a class.
fn nearness(class: &[Vec<f64>], row: &[f64]) -> f64 {
    let distance = |other: &Vec<f64>| other.iter().zip(row).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
    let mut distances: Vec<f64> = class.iter().map(distance).collect();
    distances.sort_by(f64::total_cmp);
    let count = (class.len().div_ceil(8)).min(distances.len());
    distances[..count].iter().sum::<f64>() / count as f64
}

/// A row of a sample.
#[derive(Debug, Clone, Copy)]
pub struct Row<'a> {
    /// The values of its features, in one order for all rows.
    pub values: &'a [f64],
    /// Its number in the list of links.
    pub number: usize,
}

/// Two samples, and which rows share an epoch, by number.
#[derive(Debug, Clone)]
pub struct TwoSamples<'a> {
    /// Rows of the first and the second class.
    pub classes: [Vec<Row<'a>>; 2],
    /// For each number, the numbers of rows that share an epoch with it.
    pub links: &'a [Vec<usize>],
}

impl TwoSamples<'_> {
    /// Scores of every row by classifiers that saw neither it nor what shares an epoch with it. Fold k of a class is its k-th
    /// run of rows.
    pub fn cross_validated(&self, classifier: Classifier, folds: usize, ridge: f64) -> [Vec<f64>; 2] {
        let fold = |class: usize, row: usize| row * folds / self.classes[class].len();
        let mut scores = self.classes.each_ref().map(|class| vec![0.0; class.len()]);
        for held_out in 0..folds {
            let of_fold = |class: usize, inside: bool| {
                let rows = self.classes[class].iter().enumerate();
                rows.filter(move |(row, _)| (fold(class, *row) == held_out) == inside)
            };
            let linked: Vec<usize> = (0..2)
                .flat_map(|class| of_fold(class, true))
                .flat_map(|(_, row)| self.links[row.number].clone())
                .collect();
            let training = [0, 1].map(|class| {
                let all: Vec<Row> = of_fold(class, false).map(|(_, row)| *row).collect();
                unlinked(&all, &linked)
            });
            let test: Vec<(usize, usize)> =
                (0..2).flat_map(|class| of_fold(class, true).map(move |(row, _)| (class, row))).collect();
            let rows: Vec<&[f64]> = test.iter().map(|(class, row)| self.classes[*class][*row].values).collect();
            let found = classifier.scores([&training[0], &training[1]], &rows, ridge);
            for ((class, row), score) in test.into_iter().zip(found) {
                scores[class][row] = score;
            }
        }
        scores
    }
}

/// The rows without those linked to what is held out; where less than half would be left, as where all share one epoch, all rows.
fn unlinked<'a>(rows: &[Row<'a>], linked: &[usize]) -> Vec<&'a [f64]> {
    let free: Vec<&[f64]> = rows.iter().filter(|row| !linked.contains(&row.number)).map(|row| row.values).collect();
    if 2 * free.len() >= rows.len() { free } else { rows.iter().map(|row| row.values).collect() }
}

/// Rows that stay together when a sample is split.
const RUN: usize = 3;
const KEY: Key = Key(*b"halves of one sample of rasters.");

/// One split of a sample: areas of the classifiers, and of each feature by itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Control {
    /// Area of each classifier, in the order of [`Classifier::ALL`].
    pub classifiers: Vec<f64>,
    /// Area of each feature.
    pub features: Vec<f64>,
}

/// The areas of halves of one sample, which a perfect simulator would have too: what chance and the number of rows make.
pub fn control(rows: &[Vec<f64>], links: &[Vec<usize>], splits: usize, folds: usize, ridge: f64) -> Vec<Control> {
    (0..splits)
        .into_par_iter()
        .map(|split| {
            let samples = TwoSamples { classes: halves(rows, split), links };
            let areas = Classifier::ALL.map(|classifier| {
                let [first, second] = samples.cross_validated(classifier, folds, ridge);
                area(&first, &second).auc
            });
            let column =
                |class: usize, j: usize| samples.classes[class].iter().map(|row| row.values[j]).collect::<Vec<_>>();
            let features = (0..rows[0].len()).map(|j| area(&column(0, j), &column(1, j)).auc).collect();
            Control { classifiers: areas.to_vec(), features }
        })
        .collect()
}

/// Two halves made of runs of rows, drawn at random; their sizes differ by a run at most.
fn halves(rows: &[Vec<f64>], split: usize) -> [Vec<Row<'_>>; 2] {
    let field = KEY.field();
    let shift = field.words(-1, split as i32)[0] as usize % RUN;
    let run = |row: usize| (row + shift) / RUN;
    let runs = rows.len().checked_sub(1).map_or(0, |last| run(last) + 1);
    let mut order: Vec<usize> = (0..runs).collect();
    order.sort_by_key(|run| (field.words(*run as i32, split as i32)[0], *run));
    let mut second = vec![false; runs];
    order.iter().take(runs / 2).for_each(|run| second[*run] = true);
    let half = |class: bool| {
        let rows = rows.iter().enumerate().filter(|(row, _)| second[run(*row)] == class);
        rows.map(|(number, values)| Row { values, number }).collect()
    };
    [half(false), half(true)]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(n: i32, seed: u8, change: impl Fn(f64, i32) -> f64) -> Vec<Vec<f64>> {
        let field = Key([seed; 32]).field();
        (0..n).map(|i| (0..4).map(|j| change(field.normal(i, j), j)).collect()).collect()
    }

    fn rows(rows: &[Vec<f64>], first: usize) -> Vec<Row<'_>> {
        rows.iter().enumerate().map(|(i, values)| Row { values, number: first + i }).collect()
    }

    fn auc(a: &[Vec<f64>], b: &[Vec<f64>], classifier: Classifier) -> f64 {
        let links = vec![Vec::new(); a.len() + b.len()];
        let samples = TwoSamples { classes: [rows(a, 0), rows(b, a.len())], links: &links };
        let [first, second] = samples.cross_validated(classifier, 5, 1.0);
        area(&first, &second).auc
    }

    #[test]
    fn equal_samples_cannot_be_told_apart_and_shifted_ones_can() {
        let (a, same) = (sample(200, 1, |x, _| x), sample(200, 2, |x, _| x));
        let shifted = sample(200, 2, |x, j| if j == 0 { x + 1.0 } else { x });
        for classifier in Classifier::ALL {
            let found = auc(&a, &same, classifier);
            assert!((0.4..0.6).contains(&found), "{classifier:?} {found}");
            // A shift of d deviations has area Phi(d / sqrt 2): 0.7602 at 1.
            let found = auc(&a, &shifted, classifier);
            assert!(found > 0.66 && found < 0.82, "{classifier:?} {found}");
        }
    }

    #[test]
    fn a_narrow_sample_is_seen_by_all_but_the_linear_one() {
        let (a, narrow) = (sample(100, 1, |x, _| x), sample(100, 2, |x, _| 0.4 * x));
        let found = Classifier::ALL.map(|classifier| auc(&a, &narrow, classifier));
        assert!(found[0] < 0.65 && found[1..].iter().all(|auc| *auc > 0.8), "{found:?}");
    }

    #[test]
    fn halves_of_one_sample_lie_about_one_half_even_in_a_chain() {
        // Neighbours are nearly equal; whoever has seen one knows the next.
        let field = Key([5; 32]).field();
        let smooth = |i: i32, j: i32| (0..2).map(|k| field.normal(i + k, j)).sum::<f64>();
        let rows: Vec<Vec<f64>> = (0..60).map(|i| (0..20).map(|j| smooth(i, j)).collect()).collect();
        let links: Vec<Vec<usize>> = (0..60usize)
            .map(|i| [i.checked_sub(1), Some(i + 1).filter(|j| *j < 60)].into_iter().flatten().collect())
            .collect();
        let found = control(&rows, &links, 12, 5, 1.0);
        for (k, classifier) in Classifier::ALL.iter().enumerate() {
            let mean = found.iter().map(|control| control.classifiers[k]).sum::<f64>() / 12.0;
            assert!((0.38..0.62).contains(&mean), "{classifier:?} {mean}");
        }
        assert_eq!(found[0].features.len(), 20);
    }

    #[test]
    fn what_shares_an_epoch_with_a_held_out_row_is_not_trained_with() {
        let values = [0.0];
        let rows: Vec<Row> = (0..6).map(|number| Row { values: &values, number }).collect();
        assert_eq!(unlinked(&rows, &[2, 9]).len(), 5);
        assert_eq!(unlinked(&rows, &[0, 1, 2, 3]).len(), 6);
    }

    #[test]
    fn constant_features_and_separable_classes_are_no_trouble() {
        let constant = |x: f64| -> Vec<Vec<f64>> { (0..10).map(|i| vec![7.0, x + 0.01 * f64::from(i)]).collect() };
        for classifier in Classifier::ALL {
            assert!((auc(&constant(0.0), &constant(5.0), classifier) - 1.0).abs() < 1e-12, "{classifier:?}");
        }
    }
}
