//! Comparisons that share an epoch, told by their names: they are not independent of each other.

use std::collections::BTreeMap;

/// What parts a name.
const SEPARATORS: [char; 4] = ['_', '-', '+', ' '];

/// A part of a name: what it says, and its form, by which parts of one kind are known.
#[derive(Debug, Clone, PartialEq)]
struct Part<'a> {
    text: &'a str,
    is_date: bool,
}

impl<'a> Part<'a> {
    /// The parts of a name; a date such as `2021-01-07`, with or without a time, is one.
    fn all(label: &'a str) -> Vec<Self> {
        // A single date with underscores may be a year and two epochs.
        let underscored = starts(label).filter(|at| date(&label[*at..], '_').is_some()).count() > 1;
        let mut parts = Vec::new();
        let mut rest = label;
        while !rest.is_empty() {
            let dated = date(rest, '-').or_else(|| date(rest, '_').filter(|_| underscored));
            let length = dated.unwrap_or_else(|| rest.find(SEPARATORS).unwrap_or(rest.len()));
            if length > 0 {
                parts.push(Self { text: &rest[..length], is_date: dated.is_some() });
            }
            rest = rest[length..].trim_start_matches(SEPARATORS);
        }
        parts
    }

    /// Whether both are dates, or texts that differ in their numbers only. Numbers have as many digits, or up to three without zeros in front.
    fn is_like(&self, other: &Self) -> bool {
        if self.is_date || other.is_date {
            return self.is_date && other.is_date;
        }
        let numbers = |text: &str| -> Vec<String> {
            text.split(|c: char| !c.is_ascii_digit()).filter(|run| !run.is_empty()).map(str::to_owned).collect()
        };
        let around = |text: &'a str| -> Vec<&'a str> {
            text.split(|c: char| c.is_ascii_digit()).filter(|run| !run.is_empty()).collect()
        };
        let counted = |run: &String| run.len() <= 3 && (run.len() == 1 || !run.starts_with('0'));
        let (ours, theirs) = (numbers(self.text), numbers(other.text));
        let both = |(a, b): (&String, &String)| a.len() == b.len() || (counted(a) && counted(b));
        !ours.is_empty()
            && ours.len() == theirs.len()
            && around(self.text) == around(other.text)
            && ours.iter().zip(&theirs).all(both)
    }
}

/// Where parts of a name may begin.
fn starts(label: &str) -> impl Iterator<Item = usize> {
    let after = label.match_indices(SEPARATORS).map(|(at, separator)| at + separator.len());
    std::iter::once(0).chain(after)
}

/// The number that a text of digits begins with, where it is at most `most`, and what follows.
fn digits(text: &str, count: usize, most: u32) -> Option<(u32, &str)> {
    let (first, rest) = text.split_at_checked(count)?;
    let number = first.bytes().all(|byte| byte.is_ascii_digit()).then(|| first.parse::<u32>().ok())??;
    (number <= most).then_some((number, rest))
}

/// How long the date is that a text begins with, and the time behind it; `None` without one.
fn date(text: &str, separator: char) -> Option<usize> {
    let (_, rest) = digits(text, 4, 9999)?;
    let (month, rest) = digits(rest.strip_prefix(separator)?, 2, 12)?;
    let (day, rest) = digits(rest.strip_prefix(separator)?, 2, 31)?;
    if month == 0 || day == 0 || rest.starts_with(|c: char| c.is_ascii_digit()) {
        return None;
    }
    let behind = |rest: &str| text.len() - rest.len();
    let timed = rest.strip_prefix(['T', 't', '_', ' ']).filter(|timed| date(timed, separator).is_none());
    let needs_minutes = rest.starts_with(['_', ' ']);
    Some(behind(timed.and_then(|timed| time(timed, needs_minutes)).unwrap_or(rest)))
}

/// What follows the time that a text begins with, such as `10:30`, `10-30-00` or `103000`; `None` without one.
fn time(text: &str, needs_minutes: bool) -> Option<&str> {
    let (_, hours) = digits(text, 2, 23)?;
    let with = |separator: &str| -> Option<&str> {
        let (_, minutes) = digits(hours.strip_prefix(separator)?, 2, 59)?;
        let seconds = minutes.strip_prefix(separator).and_then(|rest| digits(rest, 2, 60)).map(|(_, rest)| rest);
        seconds.filter(|rest| ends(rest)).or_else(|| Some(minutes).filter(|rest| ends(rest)))
    };
    let found = [":", "-", ""].into_iter().find_map(with);
    let found = found.or_else(|| Some(hours).filter(|rest| !needs_minutes && ends(rest)))?;
    Some(found.strip_prefix(['Z', 'z']).unwrap_or(found))
}

/// Whether no number goes on here.
fn ends(rest: &str) -> bool {
    !rest.starts_with(|c: char| c.is_ascii_digit())
}

/// The two epochs in a name such as `cmp_07_08` or `2021-01-07_2021-02-14`: its last two parts; `None` where these are not two different ones of
/// one form, with numbers.
fn epochs(label: &str) -> Option<[&str; 2]> {
    let parts = Part::all(label);
    let [.., first, second] = parts.as_slice() else { return None };
    (first.text != second.text && first.is_like(second)).then_some([first.text, second.text])
}

/// The epochs of each name. One that more than half of all names have is none, but a number of the site or year, or the survey that all were
/// compared with; of names that share an epoch in turn each is in two.
struct Epochs<'a> {
    of: Vec<Vec<&'a str>>,
    /// What most names have, and how many.
    common: Option<(&'a str, usize)>,
}

impl<'a> Epochs<'a> {
    fn all(labels: &'a [String]) -> Self {
        let pairs: Vec<_> = labels.iter().map(|label| epochs(label)).collect();
        let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
        pairs.iter().flatten().flatten().for_each(|epoch| *counts.entry(epoch).or_default() += 1);
        let is_common = |epoch: &&str| counts[epoch] > 2 && 2 * counts[epoch] > labels.len();
        let kept = |pair: &Option<[&'a str; 2]>| pair.iter().flatten().copied().filter(|e| !is_common(e)).collect();
        let common = counts.keys().copied().find(is_common);
        Self { of: pairs.iter().map(kept).collect(), common: common.map(|epoch| (epoch, counts[epoch])) }
    }

    fn neighbours(&self) -> Vec<Vec<usize>> {
        let shares = |i: usize, j: usize| i != j && self.of[i].iter().any(|epoch| self.of[j].contains(epoch));
        (0..self.of.len()).map(|i| (0..self.of.len()).filter(|j| shares(i, *j)).collect()).collect()
    }
}

/// The other comparisons each one shares an epoch with, by index.
pub fn neighbours(labels: &[String]) -> Vec<Vec<usize>> {
    Epochs::all(labels).neighbours()
}

/// The correlation of each feature between comparisons that share an epoch; empty where none do.
///
/// `rows` has the features of each comparison, none of them constant. Products of neighbours over the variance, plus 1 / n for the
/// mean that was subtracted.
pub fn correlations(labels: &[String], rows: &[Vec<f64>]) -> Vec<f64> {
    let neighbours = neighbours(labels);
    let pairs: Vec<(usize, usize)> = neighbours
        .iter()
        .enumerate()
        .flat_map(|(i, others)| others.iter().filter(move |j| **j > i).map(move |j| (i, *j)))
        .collect();
    let Some(first) = rows.first().filter(|_| !pairs.is_empty()) else { return Vec::new() };
    let n = rows.len() as f64;
    let correlation = |j: usize| {
        let mean = rows.iter().map(|row| row[j]).sum::<f64>() / n;
        let variance = rows.iter().map(|row| (row[j] - mean) * (row[j] - mean)).sum::<f64>() / n;
        let products = pairs.iter().map(|(a, b)| (rows[*a][j] - mean) * (rows[*b][j] - mean)).sum::<f64>();
        products / (pairs.len() as f64 * variance) + 1.0 / n
    };
    (0..first.len()).map(correlation).collect()
}

/// A sentence about comparisons that share epochs, or may all do; `None` where none do.
pub fn warning(labels: &[String]) -> Option<String> {
    let (epochs, all) = (Epochs::all(labels), labels.len());
    let chained = epochs.neighbours().iter().filter(|others| !others.is_empty()).count();
    let common = epochs.common.map(|(epoch, count)| {
        format!(
            "{count} of {all} reference rasters have `{epoch}` in their names, which is taken for no epoch; if all of them are differences from \
             that survey, they are not independent, and the band of a perfect simulator does not allow for it: subtract from each survey the \
             one before it"
        )
    });
    let chained = (chained > 0).then(|| {
        format!(
            "{chained} of {all} reference rasters share an epoch with another by their names: they are not independent; the band \
             of a perfect simulator allows for it, leave-one-out shares do not"
        )
    });
    chained.or(common)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shared_epochs_correlate_features() {
        use rockface_core::numerics::random::Key;
        let field = Key([1; 32]).field();
        let labels: Vec<String> = (0..400).map(|i| format!("c_{i}_{}", i + 1)).collect();
        let row = |i: i32| {
            vec![
                field.normal(i, 0) + field.normal(i + 1, 0),
                field.normal(i, 1) - field.normal(i + 1, 1),
                field.normal(i, 2),
            ]
        };
        let found = correlations(&labels, &(0..400).map(row).collect::<Vec<_>>());
        for (found, expected) in found.iter().zip([0.5, -0.5, 0.0]) {
            assert!((found - expected).abs() < 0.12, "{found} {expected}");
        }
        assert_eq!(correlations(&["a".to_owned(), "b".to_owned()], &[vec![1.0], vec![2.0]]), [0.0; 0]);
    }

    #[test]
    fn dates_are_parts_and_epochs_have_one_form() {
        let of = |label: &'static str| epochs(label);
        assert_eq!(of("2021-01-07_2021-02-14"), Some(["2021-01-07", "2021-02-14"]));
        assert_eq!(of("2021-01-07-2021-02-14"), Some(["2021-01-07", "2021-02-14"]));
        assert_eq!(of("2021_01_07_2021_02_14"), Some(["2021_01_07", "2021_02_14"]));
        assert_eq!(of("a 2021-01-07T10:30 2021-02-14T09-15-00Z"), Some(["2021-01-07T10:30", "2021-02-14T09-15-00Z"]));
        assert_eq!(of("2021-01-07_1030_2021-02-14_091500"), Some(["2021-01-07_1030", "2021-02-14_091500"]));
        assert_eq!(of("20210107_20210214"), Some(["20210107", "20210214"]));
        assert_eq!(of("e01-e02"), Some(["e01", "e02"]));
        assert_eq!(of("c_9_10"), Some(["9", "10"]));
        let none =
            ["quiet_2021-01-07", "quiet_2021-01-07T10", "site1_00", "pre_post", "2021_07", "07", "", "é_2021-01-07"];
        assert!(none.iter().all(|label| epochs(label).is_none()), "{:?}", none.map(epochs));
        // A day that does not exist is no date.
        assert_eq!(of("2021-13-07"), Some(["13", "07"]));
    }

    #[test]
    fn surveys_with_dates_are_a_chain_and_months_are_none() {
        let named = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        let dates = ["2021-01-07", "2021-02-14", "2021-03-07", "2021-04-14", "2021-05-07"];
        let pairs: Vec<String> = dates.windows(2).map(|pair| pair.join("_")).collect();
        assert_eq!(neighbours(&pairs), [vec![1], vec![0, 2], vec![1, 3], vec![2]]);
        let single: Vec<String> = dates.map(|date| format!("quiet_{date}")).to_vec();
        assert_eq!((neighbours(&single), warning(&single)), (vec![vec![]; 5], None));
        let star = named(&["d_00_01", "d_00_02", "d_00_03", "d_00_04"]);
        assert_eq!(neighbours(&star), vec![Vec::<usize>::new(); 4]);
        assert!(warning(&star).unwrap().contains("4 of 4 reference rasters have `00`"));
        let short = named(&["d_00_01", "d_01_02", "d_02_03"]);
        assert_eq!(neighbours(&short), [vec![1], vec![0, 2], vec![1]]);
    }

    #[test]
    fn a_chain_is_seen_in_the_names() {
        let labels = ["cmp_00_01", "cmp_01_02", "cmp_05_06", "lonely", "a 3"].map(str::to_owned);
        assert_eq!(neighbours(&labels), [vec![1], vec![0], vec![], vec![], vec![]]);
        assert!(warning(&labels).unwrap().contains("2 of 5"));
        assert_eq!(warning(&labels[2..]), None);
    }
}
