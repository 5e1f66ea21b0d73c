//! SHA-256 sums of files, as `sha256sum --check` reads them.

use sha2::{Digest, Sha256};

/// The sum of a file, hexadecimal.
pub fn sum(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// One line a file, in their order.
pub fn list(files: &[(String, Vec<u8>)]) -> String {
    files.iter().map(|(name, bytes)| format!("{}  {name}\n", sum(bytes))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_published_sum_of_abc() {
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sum(b"abc"), expected);
        assert_eq!(list(&[("a/b".to_owned(), b"abc".to_vec())]), format!("{expected}  a/b\n"));
    }
}
