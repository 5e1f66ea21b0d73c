//! What was found against what is true, on the cells of one grid: overlaps, outcomes, counts.

use std::collections::BTreeMap;

use super::assignment;

/// A true or detected change on the grid.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Object {
    /// Its cells that can be compared, ascending.
    pub cells: Vec<usize>,
    /// Its volume, cubic metres, where it is known.
    pub volume_m3: Option<f64>,
    /// Whether it counts at all: a true change that cannot be seen, or a detection beside the cells compared, does not.
    pub counts: bool,
}

/// A true change and a detection that share cells.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Overlap {
    /// Number of the true change, from 0.
    pub truth: usize,
    /// Number of the detection, from 0.
    pub detection: usize,
    /// Shared cells over the cells of either.
    pub iou: f64,
}

/// All pairs that share at least a cell and have at least this intersection over union, by truth, then detection.
pub fn overlaps(truth: &[Object], detections: &[Object], least_iou: f64) -> Vec<Overlap> {
    let mut owners: Vec<(usize, usize)> =
        truth.iter().enumerate().flat_map(|(number, object)| object.cells.iter().map(move |c| (*c, number))).collect();
    owners.sort_unstable();
    let mut shared: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for (detection, object) in detections.iter().enumerate() {
        for cell in &object.cells {
            let first = owners.partition_point(|(owned, _)| owned < cell);
            for (_, truth) in owners[first..].iter().take_while(|(owned, _)| owned == cell) {
                *shared.entry((*truth, detection)).or_default() += 1;
            }
        }
    }
    let overlap = |((t, d), count): ((usize, usize), usize)| {
        let union = truth[t].cells.len() + detections[d].cells.len() - count;
        Overlap { truth: t, detection: d, iou: count as f64 / union as f64 }
    };
    shared.into_iter().map(overlap).filter(|overlap| overlap.iou >= least_iou).collect()
}

/// How a comparison came out.
#[derive(Debug, Clone, PartialEq)]
pub struct Score {
    /// The pairs that count as a match.
    pub overlaps: Vec<Overlap>,
    /// The pairs of a one-to-one matching of the greatest sum of intersections over unions.
    pub pairs: Vec<Overlap>,
}

impl Score {
    /// Compares what was found with what is true.
    pub fn of(truth: &[Object], detections: &[Object], least_iou: f64) -> Self {
        let overlaps = overlaps(truth, detections, least_iou);
        let weights: Vec<_> = overlaps.iter().map(|o| (o.truth, o.detection, o.iou)).collect();
        let partners = assignment::heaviest(truth.len(), &weights);
        let is_pair = |overlap: &&Overlap| partners[overlap.truth] == Some(overlap.detection);
        let pairs = overlaps.iter().filter(is_pair).copied().collect();
        Self { overlaps, pairs }
    }

    /// Detections that a true change matches.
    pub fn of_truth(&self, truth: usize) -> usize {
        self.overlaps.iter().filter(|overlap| overlap.truth == truth).count()
    }

    /// True changes that a detection matches.
    pub fn of_detection(&self, detection: usize) -> usize {
        self.overlaps.iter().filter(|overlap| overlap.detection == detection).count()
    }
}

/// Counts of objects or cells.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Counts {
    /// Detections that are true.
    pub true_positives: usize,
    /// Detections that are not.
    pub false_positives: usize,
    /// True changes that were found; not the true positives where one detection covers several changes, or several one.
    pub found: usize,
    /// True changes that were missed.
    pub missed: usize,
}

impl Counts {
    /// Share of the detections that are true; `None` without detections.
    pub fn precision(&self) -> Option<f64> {
        share(self.true_positives, self.false_positives)
    }

    /// Share of the true changes that were found; `None` without true changes.
    pub fn recall(&self) -> Option<f64> {
        share(self.found, self.missed)
    }

    /// Harmonic mean of precision and recall; 0 where nothing was found but something could have been, or the other way
    /// round, `None` where there was nothing to find and nothing was found.
    pub fn f1(&self) -> Option<f64> {
        f1(self.precision(), self.recall())
    }

    /// Share of all decisions that are right, those included that rightly found nothing; `None` where nothing was decided. Objects have no
    /// true negatives: theirs is the critical success index.
    pub fn accuracy(&self, true_negatives: usize) -> Option<f64> {
        share(self.true_positives + true_negatives, self.false_positives + self.missed)
    }

    /// The counts of both.
    #[must_use]
    pub fn plus(&self, other: &Self) -> Self {
        Self {
            true_positives: self.true_positives + other.true_positives,
            false_positives: self.false_positives + other.false_positives,
            found: self.found + other.found,
            missed: self.missed + other.missed,
        }
    }
}

fn share(part: usize, rest: usize) -> Option<f64> {
    (part + rest > 0).then(|| part as f64 / (part + rest) as f64)
}

/// 2 P R / (P + R), 0 where one of them has no value, `None` where both have none.
pub fn f1(precision: Option<f64>, recall: Option<f64>) -> Option<f64> {
    match (precision, recall) {
        (None, None) => None,
        (Some(p), Some(r)) if p + r > 0.0 => Some(2.0 * p * r / (p + r)),
        _ => Some(0.0),
    }
}

/// Counts where a detection is true when it matches any true change, and a change is found when any detection matches it.
pub fn permissive(score: &Score, truth: &[Object], detections: &[Object]) -> Counts {
    let mut counts = Counts::default();
    for number in (0..detections.len()).filter(|number| detections[*number].counts) {
        *(if score.of_detection(number) > 0 { &mut counts.true_positives } else { &mut counts.false_positives }) += 1;
    }
    for number in (0..truth.len()).filter(|number| truth[*number].counts) {
        *(if score.of_truth(number) > 0 { &mut counts.found } else { &mut counts.missed }) += 1;
    }
    counts
}

/// Counts where each detection stands for one true change at most.
pub fn one_to_one(score: &Score, truth: &[Object], detections: &[Object]) -> Counts {
    let all = |objects: &[Object]| objects.iter().filter(|object| object.counts).count();
    let true_positives = score.pairs.iter().filter(|pair| detections[pair.detection].counts).count();
    let found = score.pairs.iter().filter(|pair| truth[pair.truth].counts).count();
    Counts { true_positives, false_positives: all(detections) - true_positives, found, missed: all(truth) - found }
}

/// Whether each cell is true, found, both or neither: 0 neither, 1 both, 2 found and not true, 3 true and not found.
pub fn confusion(truth: &[Object], detections: &[Object], cells: usize) -> Vec<u8> {
    let mut codes = vec![0u8; cells];
    truth.iter().flat_map(|object| &object.cells).for_each(|cell| codes[*cell] = 3);
    for cell in detections.iter().flat_map(|object| &object.cells) {
        codes[*cell] = if codes[*cell] == 3 || codes[*cell] == 1 { 1 } else { 2 };
    }
    codes
}

#[cfg(test)]
mod tests {
    use super::*;

    fn object(cells: impl IntoIterator<Item = usize>) -> Object {
        Object { cells: cells.into_iter().collect(), volume_m3: None, counts: true }
    }

    #[test]
    fn one_niche_two_merged_one_split_and_a_false_alarm() {
        let truth = [object(0..10), object(20..24), object(26..30), object(40..60), object(70..75)];
        // The first as it is; one over the two next; two in the fourth; a false alarm; the fifth missed.
        let detections = [object(0..10), object(20..30), object(40..48), object(50..56), object(90..92)];
        let score = Score::of(&truth, &detections, 0.0);
        let counts = permissive(&score, &truth, &detections);
        assert_eq!(counts, Counts { true_positives: 4, false_positives: 1, found: 4, missed: 1 });
        let strict = one_to_one(&score, &truth, &detections);
        assert_eq!(strict, Counts { true_positives: 3, false_positives: 2, found: 3, missed: 2 });
        assert_eq!([score.of_truth(3), score.of_detection(1)], [2, 2]);
        let ious: Vec<f64> = score.pairs.iter().map(|pair| pair.iou).collect();
        assert_eq!(ious, [1.0, 0.4, 0.4]);
        // At an IoU of one half only the first is left.
        let half = Score::of(&truth, &detections, 0.5);
        let counts = permissive(&half, &truth, &detections);
        assert_eq!(counts, Counts { true_positives: 1, false_positives: 4, found: 1, missed: 4 });
        let codes = confusion(&truth, &detections, 100);
        let count = |code: u8| codes.iter().map(|c| usize::from(*c == code)).sum::<usize>();
        assert_eq!([count(1), count(2), count(3)], [10 + 8 + 14, 2 + 2, 6 + 5]);
    }

    #[test]
    fn the_paper_counts_come_out() {
        // 77 detachments and 5 at the edges are true of 82 + 43 detections: 65.6 %, and not 77 of 120.
        let real = Counts { true_positives: 82, false_positives: 43, found: 82, missed: 0 };
        assert!((real.precision().unwrap() - 0.656).abs() < 5e-4);
        assert!((77.0f64 / 120.0 - 0.656).abs() > 0.01);
        // F1 of the averages of ten epochs.
        assert!((f1(Some(0.567), Some(0.244)).unwrap() - 0.341).abs() < 5e-4);
    }

    #[test]
    fn rates_without_anything_to_count() {
        let none = Counts::default();
        assert_eq!((none.precision(), none.recall(), none.f1(), none.accuracy(0)), (None, None, None, None));
        let some = Counts { true_positives: 3, false_positives: 1, found: 3, missed: 2 };
        assert_eq!((some.accuracy(0), some.accuracy(4)), (Some(0.5), Some(0.7)));
        let silent = Counts { missed: 3, ..none };
        assert_eq!((silent.precision(), silent.recall(), silent.f1()), (None, Some(0.0), Some(0.0)));
        let alarm = Counts { false_positives: 1, ..none };
        assert_eq!((alarm.precision(), alarm.f1()), (Some(0.0), Some(0.0)));
    }

    #[test]
    fn what_does_not_count_is_in_no_rate() {
        let mut truth = [object(0..4), object(10..14)];
        truth[1].counts = false;
        let detections = [object(10..12), object(20..22)];
        let score = Score::of(&truth, &detections, 0.0);
        let expected = Counts { true_positives: 1, false_positives: 1, found: 0, missed: 1 };
        assert_eq!(permissive(&score, &truth, &detections), expected);
        assert_eq!(one_to_one(&score, &truth, &detections), expected);
    }
}
