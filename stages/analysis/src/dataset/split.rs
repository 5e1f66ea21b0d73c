//! Which tiles are for training, validation and test, so that no two of them share an event, or a place.

use std::ops::Range;

/// The three parts of a data set.
pub const PARTS: [&str; 3] = ["train", "validation", "test"];

/// Number of the part of each of `count` things in a row, by shares that need not sum to 1: whole numbers nearest to the
/// shares, and at least one for each part with a share where there are enough.
pub fn parts(count: usize, shares: [f64; 3]) -> Vec<usize> {
    let total: f64 = shares.iter().sum();
    let wanted = shares.map(|share| share / total * count as f64);
    let mut sizes = wanted.map(|size| size.floor() as usize);
    while sizes.iter().sum::<usize>() < count {
        let lack = |part: &usize| wanted[*part] - sizes[*part] as f64;
        let next = (0..3).max_by(|a, b| lack(a).total_cmp(&lack(b)).then(b.cmp(a))).unwrap_or(0);
        sizes[next] += 1;
    }
    for part in (0..3).filter(|part| shares[*part] > 0.0) {
        let largest = (0..3).max_by_key(|other| (sizes[*other], 3 - other)).unwrap_or(0);
        if sizes[part] == 0 && sizes[largest] > 1 {
            sizes[part] += 1;
            sizes[largest] -= 1;
        }
    }
    sizes.iter().enumerate().flat_map(|(part, size)| vec![part; *size]).collect()
}

/// The part of each thing by a number from 0 to 1 of its own, and which were lent: the shares are stretches of 0 to 1, so a
/// thing stays where it is whatever others there are. A part with a share that would have none is lent the nearest thing of
/// a part with several.
pub fn by_numbers(numbers: &[f64], shares: [f64; 3]) -> (Vec<usize>, Vec<usize>) {
    let stretches = stretches(shares);
    let within = |number: f64| {
        let found = (0..3).find(|part| shares[*part] > 0.0 && number < stretches[*part][1]);
        found.or_else(|| (0..3).rev().find(|part| shares[*part] > 0.0)).unwrap_or(0)
    };
    let mut parts: Vec<usize> = numbers.iter().map(|number| within(*number)).collect();
    let mut lent = Vec::new();
    for part in (0..3).filter(|part| shares[*part] > 0.0) {
        if parts.contains(&part) {
            continue;
        }
        let [begin, end] = stretches[part];
        let far = |thing: usize| (begin - numbers[thing]).max(numbers[thing] - end);
        let several = |thing: usize| parts.iter().filter(|other| **other == parts[thing]).count() > 1;
        let nearest = (0..parts.len()).filter(|thing| several(*thing)).min_by(|a, b| far(*a).total_cmp(&far(*b)));
        if let Some(thing) = nearest {
            parts[thing] = part;
            lent.push(thing);
        }
    }
    (parts, lent)
}

/// Begin and end of each share in 0 to 1.
fn stretches(shares: [f64; 3]) -> [[f64; 2]; 3] {
    let total: f64 = shares.iter().sum();
    let mut end = 0.0;
    shares.map(|share| {
        let begin = end;
        end += share / total;
        [begin, end]
    })
}

/// The columns of each part where `length` columns are cut into strips by shares from the left; none without a share.
pub fn strips(length: usize, shares: [f64; 3]) -> [Range<usize>; 3] {
    // Rounded so that neighbours share a whole cell border.
    stretches(shares).map(|ends| {
        let [begin, end] = ends.map(|end| (end * length as f64).round() as usize);
        begin..end.min(length)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_become_whole_numbers() {
        let sizes = |count, shares| {
            let found = parts(count, shares);
            [0, 1, 2].map(|part| found.iter().filter(|p| **p == part).count())
        };
        assert_eq!(sizes(10, [0.7, 0.15, 0.15]), [7, 2, 1]);
        assert_eq!(sizes(3, [0.9, 0.05, 0.05]), [1, 1, 1]);
        assert_eq!(sizes(2, [0.8, 0.1, 0.1]).iter().sum::<usize>(), 2);
        assert_eq!(sizes(5, [1.0, 0.0, 0.0]), [5, 0, 0]);
        assert_eq!(sizes(0, [0.7, 0.15, 0.15]), [0, 0, 0]);
    }

    #[test]
    fn a_thing_stays_in_its_part_whatever_others_there_are() {
        let shares = [0.7, 0.15, 0.15];
        let numbers: Vec<f64> = (0..200).map(|k| (f64::from(k) * 0.618_033_988_75).fract()).collect();
        let (all, lent) = by_numbers(&numbers, shares);
        assert!(lent.is_empty());
        let (few, _) = by_numbers(&numbers[..40], shares);
        assert_eq!(few, all[..40]);
        assert_eq!([0, 1, 2].map(|part| all.iter().filter(|p| **p == part).count()), [139, 30, 31]);
        assert_eq!(by_numbers(&[0.2, 0.999], [1.0, 0.0, 0.0]), (vec![0, 0], Vec::new()));
    }

    #[test]
    fn a_part_that_would_be_empty_is_lent_the_nearest() {
        assert_eq!(by_numbers(&[0.1, 0.65, 0.3, 0.9], [0.7, 0.15, 0.15]), (vec![0, 1, 0, 2], vec![1]));
        // None is taken from a part that has no other.
        assert_eq!(by_numbers(&[0.1, 0.9], [0.7, 0.15, 0.15]), (vec![0, 2], Vec::new()));
    }

    #[test]
    fn strips_are_whole_columns_and_cover_all() {
        assert_eq!(strips(100, [0.5, 0.25, 0.25]), [0..50, 50..75, 75..100]);
        assert_eq!(strips(360, [0.7, 0.15, 0.15]), [0..252, 252..306, 306..360]);
        assert_eq!(strips(9, [1.0, 0.0, 1.0]), [0..5, 5..5, 5..9]);
    }
}
