//! Comparisons that share an epoch, told by their names: they are not independent of each other.

/// The two epochs in a name such as `cmp_07_08`: its last two parts; `None` where there are no two different ones.
fn epochs(label: &str) -> Option<(&str, &str)> {
    let mut parts = label.rsplit(['_', '-', '+', ' ']).filter(|part| !part.is_empty());
    let (second, first) = (parts.next()?, parts.next()?);
    let numbered = |part: &str| part.chars().any(|c| c.is_ascii_digit());
    (first != second && numbered(first) && numbered(second)).then_some((first, second))
}

/// The other comparisons each one shares an epoch with, by index.
pub fn neighbours(labels: &[String]) -> Vec<Vec<usize>> {
    let epochs: Vec<_> = labels.iter().map(|label| epochs(label)).collect();
    let shares = |i: usize, j: usize| match (epochs[i], epochs[j]) {
        (Some((a, b)), Some((c, d))) => i != j && (a == c || a == d || b == c || b == d),
        _ => false,
    };
    (0..labels.len()).map(|i| (0..labels.len()).filter(|j| shares(i, *j)).collect()).collect()
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

/// A sentence about comparisons that share epochs; `None` where none do.
pub fn warning(labels: &[String]) -> Option<String> {
    let chained = neighbours(labels).iter().filter(|others| !others.is_empty()).count();
    (chained > 0).then(|| {
        format!(
            "{chained} of {} reference rasters share an epoch with another by their names: they are not independent; the band \
             of a perfect simulator allows for it, leave-one-out shares do not",
            labels.len()
        )
    })
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
    fn a_chain_is_seen_in_the_names() {
        let labels = ["cmp_00_01", "cmp_01_02", "cmp_05_06", "lonely", "a 3"].map(str::to_owned);
        assert_eq!(neighbours(&labels), [vec![1], vec![0], vec![], vec![], vec![]]);
        assert!(warning(&labels).unwrap().contains("2 of 5"));
        assert_eq!(warning(&labels[2..]), None);
    }
}
