//! Rasters that a model does not see, so that they can judge it: a share of a series, the last ones.

/// How many of a series are in view when a share of it, from 0 to 1, is held out.
pub fn in_view(count: usize, held_out: f64) -> usize {
    count - (count as f64 * held_out).round() as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_share_is_rounded_to_whole_rasters() {
        assert_eq!([0.0, 0.3333, 0.9, 1.0].map(|share| in_view(39, share)), [39, 26, 4, 0]);
        assert_eq!(in_view(0, 0.5), 0);
    }
}
