//! How much of their variance rasters have in common.

/// Mean correlation of all pairs of rasters over the cells where all have a value: 0 where surveys have nothing to do with each
/// other, a little less in a chain, a half where all are differences from one and the same survey. `None` without such cells, or
/// with fewer than three rasters.
pub fn common_share(rasters: &[Vec<f32>]) -> Option<f64> {
    let count = rasters.len() as f64;
    let cells = rasters.first().map_or(0, Vec::len);
    let (mut of_mean, mut of_all) = (0.0, 0.0);
    for cell in 0..cells {
        let values = rasters.iter().map(|raster| f64::from(raster[cell]));
        let [sum, squares] = values.fold([0.0; 2], |[sum, squares], value| [sum + value, squares + value * value]);
        if !sum.is_nan() {
            of_mean += sum * sum / (count * count);
            of_all += squares / count;
        }
    }
    (rasters.len() >= 3 && of_all > 0.0).then(|| (count * of_mean / of_all - 1.0) / (count - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_from_one_survey_have_half_of_their_variance_in_common() {
        let survey = |number: u64| -> Vec<f32> {
            // Uniform numbers of a linear congruence.
            let mut state = number.wrapping_mul(0x9e37_79b9_7f4a_7c15) + 1;
            let mut draw = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                (state >> 40) as f32 / (1u32 << 24) as f32 - 0.5
            };
            (0..4000).map(|cell| if cell == 7 * number { f32::NAN } else { draw() }).collect()
        };
        let surveys: Vec<Vec<f32>> = (0..11).map(survey).collect();
        let less = |one: &[f32], other: &[f32]| one.iter().zip(other).map(|(a, b)| a - b).collect::<Vec<f32>>();
        let star: Vec<Vec<f32>> = surveys[1..].iter().map(|survey| less(survey, &surveys[0])).collect();
        let chain: Vec<Vec<f32>> = surveys.windows(2).map(|pair| less(&pair[1], &pair[0])).collect();
        let [star, chain] = [star, chain].map(|rasters| common_share(&rasters).unwrap());
        assert!((star - 0.5).abs() < 0.05 && (chain + 0.1).abs() < 0.05, "{star} {chain}");
        assert_eq!(common_share(&surveys[..2]), None);
    }
}
