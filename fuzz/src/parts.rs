//! Cases of several files: one text of bytes, cut at seams.

/// Stands between two files of one case.
pub const SEAM: &[u8] = b"\n%%%%\n";

/// The files of a case.
pub fn cut(bytes: &[u8]) -> Vec<&[u8]> {
    let (mut parts, mut rest) = (Vec::new(), bytes);
    while let Some(at) = rest.windows(SEAM.len()).position(|window| window == SEAM) {
        parts.push(&rest[..at]);
        rest = &rest[at + SEAM.len()..];
    }
    parts.push(rest);
    parts
}

/// The case of some files.
pub fn joined(parts: &[&[u8]]) -> Vec<u8> {
    parts.join(SEAM)
}
