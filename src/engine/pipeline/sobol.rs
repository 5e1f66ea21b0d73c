//! Sobol's low-discrepancy sequence with the direction numbers of Joe and Kuo (2008), and a random digital shift.

/// Bits of a point.
const BITS: usize = 32;

/// For each dimension after the first: the coefficients of its primitive polynomial, and the initial direction
/// numbers, as many as the degree. From the table `new-joe-kuo-6.21201`.
const TABLE: [(u32, &[u32]); 20] = [
    (0, &[1]),
    (1, &[1, 3]),
    (1, &[1, 3, 1]),
    (2, &[1, 1, 1]),
    (1, &[1, 1, 3, 3]),
    (4, &[1, 3, 5, 13]),
    (2, &[1, 1, 5, 5, 17]),
    (4, &[1, 1, 5, 5, 5]),
    (7, &[1, 1, 7, 11, 19]),
    (11, &[1, 1, 5, 1, 1]),
    (13, &[1, 1, 1, 3, 11]),
    (14, &[1, 3, 5, 5, 31]),
    (1, &[1, 3, 3, 9, 7, 49]),
    (13, &[1, 1, 1, 15, 21, 21]),
    (16, &[1, 3, 1, 13, 27, 49]),
    (19, &[1, 1, 1, 15, 7, 5]),
    (22, &[1, 3, 1, 15, 13, 25]),
    (25, &[1, 1, 5, 5, 19, 61]),
    (1, &[1, 3, 7, 11, 23, 15, 103]),
    (4, &[1, 3, 7, 13, 13, 15, 69]),
];

/// One dimension of the first `count` points, 0 to 1, shifted digit by digit.
pub fn column(dimension: usize, count: usize, shift: u32) -> Result<Vec<f64>, String> {
    let directions = directions(dimension)
        .ok_or_else(|| format!("a Sobol design has at most {} values; use latin-hypercube", TABLE.len() + 1))?;
    let mut state = 0_u32;
    let point = |index: usize| {
        if index > 0 {
            // Points in the order of the Gray code differ in one direction from the one before.
            state ^= directions[(index - 1).trailing_ones() as usize];
        }
        // The middle of the cell, so that no point is on a border.
        (f64::from(state ^ shift) + 0.5) / (1_u64 << BITS) as f64
    };
    Ok((0..count).map(point).collect())
}

fn directions(dimension: usize) -> Option<[u32; BITS]> {
    let mut numbers = [0_u32; BITS];
    if dimension == 0 {
        (0..BITS).for_each(|bit| numbers[bit] = 1 << (BITS - 1 - bit));
        return Some(numbers);
    }
    let (polynomial, first) = TABLE.get(dimension - 1)?;
    let degree = first.len();
    for bit in 0..BITS {
        numbers[bit] = if bit < degree {
            first[bit] << (BITS - 1 - bit)
        } else {
            let mut number = numbers[bit - degree] ^ (numbers[bit - degree] >> degree);
            for k in 1..degree {
                if (polynomial >> (degree - 1 - k)) & 1 == 1 {
                    number ^= numbers[bit - k];
                }
            }
            number
        };
    }
    Some(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_points_are_those_of_the_literature() {
        // Joe and Kuo's own program prints these eight points of three dimensions.
        let expected = [
            [0.0, 0.0, 0.0],
            [0.5, 0.5, 0.5],
            [0.75, 0.25, 0.25],
            [0.25, 0.75, 0.75],
            [0.375, 0.375, 0.625],
            [0.875, 0.875, 0.125],
            [0.625, 0.125, 0.875],
            [0.125, 0.625, 0.375],
        ];
        for dimension in 0..3 {
            let column = column(dimension, 8, 0).unwrap();
            for (found, point) in column.iter().zip(&expected) {
                assert!((found - point[dimension]).abs() < 1e-9, "{dimension}: {column:?}");
            }
        }
    }

    #[test]
    fn every_dimension_has_one_point_a_stratum() {
        for dimension in 0..=TABLE.len() {
            let mut strata: Vec<usize> =
                column(dimension, 256, 0x1234_5678).unwrap().iter().map(|x| (x * 256.0) as usize).collect();
            strata.sort_unstable();
            assert_eq!(strata, (0..256).collect::<Vec<_>>(), "dimension {dimension}");
        }
        assert!(column(TABLE.len() + 1, 1, 0).is_err());
    }

    #[test]
    fn a_later_point_of_all_dimensions_is_that_of_scipy() {
        // scipy.stats.qmc.Sobol(21, scramble=False).random(778)[777], in units of 1/1024.
        let expected =
            [709, 959, 167, 281, 651, 365, 195, 781, 357, 331, 763, 713, 393, 485, 583, 527, 413, 885, 379, 771, 243];
        for (dimension, wanted) in expected.iter().enumerate() {
            let found = column(dimension, 778, 0).unwrap()[777] * 1024.0;
            assert!((found - f64::from(*wanted)).abs() < 1e-5, "dimension {dimension}: {found} for {wanted}");
        }
    }
}
