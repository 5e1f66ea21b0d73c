//! The draws of one candidate: addressed by what they are for, so no draw depends on another having been made.

use super::quantile;
use crate::artefact::candidates::Quantity;
use crate::numerics::normal::normal_quantile;
use crate::numerics::random::{Key, philox4x32};

/// The draws of one candidate.
#[derive(Debug, Clone)]
pub struct Draws {
    key: Key,
    number: u64,
}

impl Draws {
    /// The draws of candidate `number` under a key.
    pub fn new(key: Key, number: u64) -> Self {
        Self { key, number }
    }

    /// A uniform draw between 0 and 1, both excluded, for a purpose; the same whenever it is asked for.
    pub fn uniform(&self, purpose: &str) -> f64 {
        let [a, b, _, _] = self.words(purpose);
        let whole = (u64::from(a) << 20) ^ (u64::from(b) >> 12);
        (whole as f64 + 0.5) / 4_503_599_627_370_496.0
    }

    /// A standard normal draw for a purpose.
    pub fn normal(&self, purpose: &str) -> f64 {
        normal_quantile(self.uniform(purpose))
    }

    /// The value of a quantity for a purpose; `None` while its distribution is in an unread file.
    pub fn value(&self, purpose: &str, quantity: &Quantity) -> Option<f64> {
        quantile(quantity, self.uniform(purpose))
    }

    /// A key for many draws of one purpose, such as those of the vertices of a block.
    pub fn key(&self, purpose: &str) -> Key {
        let parts = [0, 1].map(|part| self.words(&format!("{purpose}/{part}")));
        let mut bytes = [0; 32];
        for (chunk, word) in bytes.chunks_exact_mut(4).zip(parts.iter().flatten()) {
            chunk.copy_from_slice(&word.to_le_bytes());
        }
        Key(bytes)
    }

    /// Four random words: the counter holds the candidate's number and the purpose's fingerprint.
    fn words(&self, purpose: &str) -> [u32; 4] {
        let word = |i: usize| u32::from_le_bytes([0, 1, 2, 3].map(|byte| self.key.0[4 * i + byte]));
        let mark = fingerprint(purpose);
        let counter = [self.number as u32, (self.number >> 32) as u32, mark as u32, (mark >> 32) as u32];
        let first = philox4x32(counter, [word(0), word(1)]);
        // The rest of the key is folded in by a second pass.
        philox4x32([first[0] ^ word(4), first[1] ^ word(5), first[2] ^ word(6), first[3] ^ word(7)], [word(2), word(3)])
    }
}

/// The FNV-1a fingerprint of a text, 64 bits.
fn fingerprint(text: &str) -> u64 {
    text.bytes().fold(0xcbf2_9ce4_8422_2325, |mark, byte| (mark ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn draws_depend_on_number_purpose_and_key_alone() {
        let draws = Draws::new(Key([9; 32]), 5);
        assert_eq!(draws.uniform("a").to_bits(), draws.clone().uniform("a").to_bits());
        let others = [
            Draws::new(Key([9; 32]), 6).uniform("a"),
            Draws::new(Key([9; 32]), 5 + (1 << 32)).uniform("a"),
            Draws::new(Key([8; 32]), 5).uniform("a"),
            draws.uniform("b"),
        ];
        assert!(others.iter().all(|other| other.to_bits() != draws.uniform("a").to_bits()));
        assert_ne!(draws.key("a"), draws.key("b"));
    }

    #[test]
    fn draws_fill_the_unit_interval_evenly() {
        let n = 20_000;
        let all: Vec<f64> = (0..n).map(|number| Draws::new(Key([3; 32]), number).uniform("x")).collect();
        let mean = all.iter().sum::<f64>() / n as f64;
        let square = all.iter().map(|u| u * u).sum::<f64>() / n as f64;
        let lag = all.windows(2).map(|w| (w[0] - 0.5) * (w[1] - 0.5)).sum::<f64>() / n as f64;
        assert!((mean - 0.5).abs() < 0.008 && (square - 1.0 / 3.0).abs() < 0.008 && lag.abs() < 0.002);
        assert!(all.iter().all(|u| *u > 0.0 && *u < 1.0));
    }
}
