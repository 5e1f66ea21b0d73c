//! Sizes of memory and of disks as people type them.

use bytesize::ByteSize;

/// The bytes of a number of GiB, or of a number with its unit, such as `500MB` or `12GiB`.
pub fn bytes_of(text: &str) -> Result<f64, String> {
    let of_gib = text.parse().ok().map(|gib: f64| gib * f64::from(1 << 30));
    let size = of_gib.or_else(|| text.parse().ok().map(|size: ByteSize| size.as_u64() as f64));
    size.filter(|size| size.is_finite())
        .ok_or_else(|| "give a number of GiB, such as 4 or 0.5, or one with its unit, such as 500MB".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_counts_gib_unless_it_has_a_unit() {
        let whole = |text: &str| bytes_of(text).map(|size| size as u64);
        assert_eq!(whole("0.5"), Ok(1 << 29));
        assert_eq!(whole("12GiB"), Ok(12 << 30));
        assert_eq!(whole("12G"), Ok(12_000_000_000));
        assert_eq!(whole("500 MB"), Ok(500_000_000));
        for text in ["", "much", "nan", "inf", "4 furlongs"] {
            assert!(whole(text).unwrap_err().contains("500MB"), "{text}");
        }
    }
}
