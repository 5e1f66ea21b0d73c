//! Which tiles are for training, validation and test, so that no two of them share an event, or a place.

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

/// The part of a stretch of cells [first, first + side) of a row of `length` cells cut into three by shares from the left;
/// `None` where it lies in two of them.
pub fn by_place(first: usize, side: usize, length: usize, shares: [f64; 3]) -> Option<usize> {
    let total: f64 = shares.iter().sum();
    let mut end = 0.0;
    for (part, share) in shares.iter().enumerate().filter(|(_, share)| **share > 0.0) {
        let begin = end;
        end += share / total * length as f64;
        // Rounded so that neighbours share a whole cell border.
        let (begin, end) = (begin.round() as usize, end.round() as usize);
        if first >= begin && first + side <= end {
            return Some(part);
        }
    }
    None
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
    fn a_tile_on_a_border_is_in_no_part() {
        let shares = [0.5, 0.25, 0.25];
        let found: Vec<Option<usize>> =
            [0, 30, 40, 50, 65, 75, 90].map(|first| by_place(first, 10, 100, shares)).to_vec();
        assert_eq!(found, [Some(0), Some(0), Some(0), Some(1), Some(1), Some(2), Some(2)]);
        assert_eq!(by_place(45, 10, 100, shares), None);
    }
}
