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

/// A sentence about comparisons that share epochs; `None` where none do.
pub fn warning(labels: &[String]) -> Option<String> {
    let chained = neighbours(labels).iter().filter(|others| !others.is_empty()).count();
    (chained > 0).then(|| {
        format!(
            "{chained} of {} reference rasters share an epoch with another by their names: they are not independent, so \
             intervals and leave-one-out figures are somewhat too good",
            labels.len()
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chain_is_seen_in_the_names() {
        let labels = ["cmp_00_01", "cmp_01_02", "cmp_05_06", "lonely", "a 3"].map(str::to_owned);
        assert_eq!(neighbours(&labels), [vec![1], vec![0], vec![], vec![], vec![]]);
        assert!(warning(&labels).unwrap().contains("2 of 5"));
        assert_eq!(warning(&labels[2..]), None);
    }
}
