//! Names and numbers that must each be there once.

/// The least of the names or numbers that are there more than once.
pub fn twice<T: Ord + Copy>(mut names: Vec<T>) -> Option<T> {
    names.sort_unstable();
    names.windows(2).find(|pair| pair[0] == pair[1]).map(|pair| pair[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_least_double_one_is_found() {
        assert_eq!(twice(vec!["b", "c", "a", "c", "b"]), Some("b"));
        assert_eq!(twice(vec![3, 1, 2]), None);
        assert_eq!(twice::<u8>(Vec::new()), None);
    }
}
