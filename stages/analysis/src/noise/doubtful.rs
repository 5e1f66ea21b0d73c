//! Rasters whose descriptors say little of noise: with few values, with equal ones, or with one that outweighs all others.

/// Cells with a value below which descriptors are uncertain: of noise that is correlated over three cells some hundred are independent, and its deviation
/// is uncertain by 7 %.
const FEW_CELLS: usize = 1000;
/// Share of cells with a value below which few pairs of neighbours have both, so that variogram and spectrum are mostly those of the gaps.
const FEW_SHARE: f64 = 0.1;
/// Share of cells with one and the same value from which on that value is no measurement, but rounding or a filling.
const EQUAL: f64 = 0.5;
/// Share of the variance that one cell makes from which on it is an outlier that decides all.
const ONE_CELL: f64 = 0.5;
/// Rasters that are named.
const NAMED: usize = 3;

/// What is doubtful about rasters, by name and values, in sentences.
pub fn doubts(rasters: &[(&str, &[f32])]) -> Vec<String> {
    let told = |what: &dyn Fn(&[f32]) -> Option<String>, why: &str| {
        let found: Vec<String> =
            rasters.iter().filter_map(|(name, values)| Some(format!("`{name}` ({})", what(values)?))).collect();
        let more = if found.len() > NAMED { format!(" and {} more", found.len() - NAMED) } else { String::new() };
        (!found.is_empty()).then(|| format!("{}{more}: {why}", found[..found.len().min(NAMED)].join(", ")))
    };
    let few = told(
        &few,
        "so few cells with a value say little of noise, and where most cells have none, variogram and spectrum are mostly those of the gaps",
    );
    let equal = told(
        &equal,
        "this value is no measurement but rounding or a filling of gaps; cells without a measurement must have no value (NaN)",
    );
    let one =
        told(&one, "that is an outlier, and not the noise, that is described; take it off with `filter-outliers`");
    [few, equal, one].into_iter().flatten().collect()
}

fn known(values: &[f32]) -> Vec<f32> {
    values.iter().copied().filter(|value| !value.is_nan()).collect()
}

fn few(values: &[f32]) -> Option<String> {
    let count = known(values).len();
    let is_few = count < FEW_CELLS || (count as f64) < FEW_SHARE * values.len() as f64;
    is_few.then(|| format!("{count} of {} cells have a value", values.len()))
}

fn equal(values: &[f32]) -> Option<String> {
    let mut sorted = known(values);
    sorted.sort_by(f32::total_cmp);
    let runs = sorted.chunk_by(|a, b| a.to_bits() == b.to_bits());
    let longest = runs.max_by_key(|run| run.len())?;
    let share = longest.len() as f64 / sorted.len() as f64;
    (share >= EQUAL).then(|| format!("{:.0} % of its values are {}", 100.0 * share, longest[0]))
}

fn one(values: &[f32]) -> Option<String> {
    let known = known(values);
    let mean = known.iter().map(|value| f64::from(*value)).sum::<f64>() / known.len() as f64;
    let squares = known.iter().map(|value| (f64::from(*value) - mean) * (f64::from(*value) - mean));
    let (sum, most, value) = known.iter().zip(squares).fold((0.0, 0.0, 0.0f32), |(sum, most, at), (value, square)| {
        if square > most { (sum + square, square, *value) } else { (sum + square, most, at) }
    });
    (sum > 0.0 && most > ONE_CELL * sum)
        .then(|| format!("{:.0} % of its variance is one cell of {value} m", 100.0 * most / sum))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    #[test]
    fn doubtful_rasters_are_named_with_what_they_have() {
        let field = Key([3; 32]).field();
        let noise: Vec<f32> = (0..4800).map(|i| 0.004 * field.normal(i, 0) as f32).collect();
        let told = |change: &dyn Fn(&mut Vec<f32>)| {
            let mut values = noise.clone();
            change(&mut values);
            doubts(&[("good", &noise), ("r", &values)])
        };
        assert!(doubts(&[("good", &noise)]).is_empty());
        let sparse = told(&|values| values[123..].fill(f32::NAN));
        assert!(sparse.len() == 1 && sparse[0].starts_with("`r` (123 of 4800 cells have a value):"), "{sparse:?}");
        let half = told(&|values| values[..2400].fill(0.002));
        assert!(half.len() == 1 && half[0].starts_with("`r` (50 % of its values are 0.002):"), "{half:?}");
        let spike = told(&|values| values[7] = 5.0);
        assert!(spike.len() == 1 && spike[0].contains("of its variance is one cell of 5 m"), "{spike:?}");
        let lone = told(&|values| {
            values.fill(0.0);
            values[7] = 0.01;
        });
        assert_eq!(lone.len(), 2, "{lone:?}");
        let many = vec![0.0f32; 5000];
        assert!(doubts(&[("a", many.as_slice()); 5])[0].contains(" and 2 more: "));
    }
}
