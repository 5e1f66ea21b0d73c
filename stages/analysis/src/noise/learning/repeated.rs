//! Rasters that are there more than once: copies, and copies with the other sign.

use rayon::prelude::*;

/// Cells at least that pairs are compared on, where rasters have as many.
const CELLS: usize = 4000;
/// Correlation, of either sign, from which on two rasters count as one. Differences that share an epoch have up to 0.9.
const REPEATED: f64 = 0.95;
/// Cells that two rasters must have in common.
const LEAST_COMMON: usize = 30;

/// Pairs of rasters that are the same but for noise of a few per cent, their sign and their scale, with their correlation on some of the cells.
pub fn pairs(rasters: &[Vec<f32>]) -> Vec<(usize, usize, f64)> {
    let cells = rasters.first().map_or(0, Vec::len);
    let step = (cells / CELLS).max(1);
    // One of each `step` cells, now here, now there: every n-th would be in few columns where n divides their number.
    let places = || (0..cells / step).map(|k| k * step + k * 7919 % step);
    let some: Vec<Vec<f64>> = rasters.iter().map(|raster| places().map(|at| f64::from(raster[at])).collect()).collect();
    let of_one = |i: usize| {
        (i + 1..some.len()).filter_map(|j| Some((i, j, correlation(&some[i], &some[j])?))).collect::<Vec<_>>()
    };
    let all: Vec<Vec<(usize, usize, f64)>> = (0..some.len()).into_par_iter().map(of_one).collect();
    all.into_iter().flatten().filter(|(_, _, correlation)| correlation.abs() > REPEATED).collect()
}

/// The correlation over the cells where both have a value; `None` of too few or equal values.
fn correlation(a: &[f64], b: &[f64]) -> Option<f64> {
    let both = || a.iter().zip(b).filter(|(a, b)| !(a.is_nan() || b.is_nan()));
    let count = both().count();
    if count < LEAST_COMMON {
        return None;
    }
    let [sum_a, sum_b] = both().fold([0.0; 2], |[x, y], (a, b)| [x + a, y + b]);
    let (mean_a, mean_b) = (sum_a / count as f64, sum_b / count as f64);
    let [aa, bb, ab] = both().fold([0.0; 3], |[aa, bb, ab], (a, b)| {
        let (a, b) = (a - mean_a, b - mean_b);
        [aa + a * a, bb + b * b, ab + a * b]
    });
    (aa > 0.0 && bb > 0.0).then(|| ab / (aa * bb).sqrt())
}

/// Pairs that are named.
const NAMED: usize = 3;

/// A sentence where rasters are there more than once; `None` where none is.
pub fn warning(rasters: &[Vec<f32>], names: &[&str]) -> Option<String> {
    let pairs = pairs(rasters);
    let mut concerned: Vec<usize> = pairs.iter().flat_map(|(i, j, _)| [*i, *j]).collect();
    concerned.sort_unstable();
    concerned.dedup();
    let named =
        |(i, j, correlation): &(usize, usize, f64)| format!("`{}` and `{}` ({correlation:.2})", names[*i], names[*j]);
    let named: Vec<String> = pairs.iter().take(NAMED).map(named).collect();
    let more = if pairs.len() > NAMED { format!(", and {} more pairs", pairs.len() - NAMED) } else { String::new() };
    (!pairs.is_empty()).then(|| {
        format!(
            "{} of {} rasters correlate with another by more than {REPEATED} in absolute value: {}{more}; are files copied, or differences taken both \
             ways round? Draws vary less than surveys do; leave the second ones out",
            concerned.len(),
            rasters.len(),
            named.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    #[test]
    fn copies_and_negatives_are_named_and_shared_epochs_are_not() {
        let field = Key([5; 32]).field();
        let epoch = |number: i32| -> Vec<f32> { (0..9000).map(|cell| field.normal(cell, number) as f32).collect() };
        let between = |a: i32, b: i32| -> Vec<f32> { epoch(a).iter().zip(epoch(b)).map(|(a, b)| b - a).collect() };
        let mut rasters = vec![between(0, 1), between(1, 2), between(2, 3)];
        rasters[0][4..40].fill(f32::NAN);
        assert_eq!(warning(&rasters, &["a", "b", "c"]), None);
        rasters.push(rasters[1].clone());
        rasters.push(rasters[0].iter().map(|value| -value).collect());
        let told = warning(&rasters, &["a", "b", "c", "d", "e"]).unwrap();
        assert!(told.starts_with("4 of 5 rasters"), "{told}");
        assert!(told.contains("`a` and `e` (-1.00), `b` and `d` (1.00);"), "{told}");
    }
}
