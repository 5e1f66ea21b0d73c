//! Random numbers addressed by item: the same numbers for any thread count, tile size or order of work.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::numerics::portable_math;
use crate::numerics::simd::{LANES, Lanes, Number, Work, vectorised};

/// The key of one random stream, derived by the engine from the pipeline seed, the step, its point, a purpose and an item.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Key(pub [u8; 32]);

impl Key {
    /// A generator for a few scalar draws in a fixed order.
    pub fn generator(&self) -> ChaCha8Rng {
        ChaCha8Rng::from_seed(self.0)
    }

    /// Random access to per-pixel draws.
    pub fn field(&self) -> Field {
        let word = |i: usize| u32::from_le_bytes([self.0[i], self.0[i + 1], self.0[i + 2], self.0[i + 3]]);
        Field { key: [word(0), word(4)], high: [word(8), word(12)] }
    }
}

/// Random access to independent draws by two integer coordinates (Philox4x32-10, Salmon et al. 2011).
#[derive(Debug, Clone, Copy)]
pub struct Field {
    key: [u32; 2],
    high: [u32; 2],
}

impl Field {
    /// Two independent standard normal draws of cell (x, y), by the Box-Muller transform.
    #[inline]
    pub fn normals(&self, x: i32, y: i32) -> [f64; 2] {
        let [a, b, c, d] = self.words(x, y);
        // 53-bit uniforms, the first in (0, 1] so that its logarithm is finite.
        let unit = |hi: u32, lo: u32| ((u64::from(hi) << 21) ^ (u64::from(lo) >> 11)) as f64 / 9_007_199_254_740_992.0;
        let radius = (-2.0 * portable_math::log(1.0 - unit(a, b))).sqrt();
        let (sin, cos) = portable_math::sincos(std::f64::consts::TAU * unit(c, d));
        [radius * cos, radius * sin]
    }

    /// As [`Field::normals`] of several cells: the same bits.
    #[inline(always)]
    pub fn normals_lanes<const N: usize>(&self, x: [i32; N], y: [i32; N]) -> [Lanes<N>; 2] {
        let [a, b, c, d] = self.words_lanes(x, y);
        let unit = |high: &[u64; N], low: &[u64; N]| {
            let upper = Lanes::<N>::of_whole(|i| high[i]) * 2_097_152.0;
            (upper + Lanes::of_whole(|i| low[i] >> 11)) / 9_007_199_254_740_992.0
        };
        let radius = (portable_math::log_lanes(-unit(&a, &b) + 1.0) * -2.0).sqrt();
        let [sin, cos] = portable_math::sincos_lanes(unit(&c, &d) * std::f64::consts::TAU);
        [radius * cos, radius * sin]
    }

    /// One standard normal draw of cell (x, y).
    ///
    /// Neighbours along x share one transform: even x takes its first draw, odd x its second.
    pub fn normal(&self, x: i32, y: i32) -> f64 {
        self.normals(x >> 1, y)[(x & 1) as usize]
    }

    /// Fills a row with standard normal draws of cells (first, y), (first + 1, y), ...; equal to calling [`Field::normal`].
    pub fn fill_row(&self, first: i32, y: i32, row: &mut [f32]) {
        let (lead, rest) = row.split_at_mut(((first & 1) as usize).min(row.len()));
        lead.iter_mut().for_each(|cell| *cell = self.normal(first, y) as f32);
        vectorised(FillPairs { field: self, first: (first + 1) >> 1, y, cells: rest });
    }

    /// Four random words of cell (x, y).
    #[inline(always)]
    pub fn words(&self, x: i32, y: i32) -> [u32; 4] {
        philox4x32([x as u32, y as u32, self.high[0], self.high[1]], self.key)
    }

    /// The same of several cells: first words, second ones, and so on.
    #[inline(always)]
    fn words_lanes<const N: usize>(&self, x: [i32; N], y: [i32; N]) -> [[u64; N]; 4] {
        let mut counter = [[0; N], [0; N], [u64::from(self.high[0]); N], [u64::from(self.high[1]); N]];
        for lane in 0..N {
            (counter[0][lane], counter[1][lane]) = (u64::from(x[lane] as u32), u64::from(y[lane] as u32));
        }
        philox_lanes(counter, self.key)
    }
}

/// Fills cells with the draws of pairs of neighbours from the pair `first` on.
struct FillPairs<'a> {
    field: &'a Field,
    first: i32,
    y: i32,
    cells: &'a mut [f32],
}

impl Work for FillPairs<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        for (block, cells) in self.cells.chunks_mut(2 * LANES).enumerate() {
            let pair = self.first + (block * LANES) as i32;
            let mut x = [pair; LANES];
            for (lane, x) in x.iter_mut().enumerate() {
                *x += lane as i32;
            }
            let [even, odd] = self.field.normals_lanes(x, [self.y; LANES]);
            let (even, odd) = (even.narrowed(), odd.narrowed());
            let mut draws = [0.0; 2 * LANES];
            for lane in 0..LANES {
                (draws[2 * lane], draws[2 * lane + 1]) = (even[lane], odd[lane]);
            }
            cells.copy_from_slice(&draws[..cells.len()]);
        }
    }
}

/// Rounds of Philox.
const ROUNDS: usize = 10;
const MULTIPLIERS: [u32; 2] = [0xD251_1F53, 0xCD9E_8D57];
const LOW_WORD: u64 = 0xFFFF_FFFF;

/// The Philox4x32-10 block function (Salmon, Moraes, Dror, Shaw 2011, SC'11).
#[inline(always)]
pub fn philox4x32(counter: [u32; 4], key: [u32; 2]) -> [u32; 4] {
    philox_lanes(counter.map(|word| [u64::from(word)]), key).map(|[word]| word as u32)
}

/// The same of several counters: first words, second ones, and so on.
#[inline(always)]
fn philox_lanes<const N: usize>(mut counter: [[u64; N]; 4], mut key: [u32; 2]) -> [[u64; N]; 4] {
    for round in 0..ROUNDS {
        if round > 0 {
            key = [key[0].wrapping_add(0x9E37_79B9), key[1].wrapping_add(0xBB67_AE85)];
        }
        let [mut c0, mut c1, mut c2, mut c3] = counter;
        for lane in 0..N {
            let (a, b) = (c0[lane] * u64::from(MULTIPLIERS[0]), c2[lane] * u64::from(MULTIPLIERS[1]));
            (c0[lane], c1[lane]) = ((b >> 32) ^ c1[lane] ^ u64::from(key[0]), b & LOW_WORD);
            (c2[lane], c3[lane]) = ((a >> 32) ^ c3[lane] ^ u64::from(key[1]), a & LOW_WORD);
        }
        counter = [c0, c1, c2, c3];
    }
    counter
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn philox_answers_the_published_known_values() {
        assert_eq!(philox4x32([0; 4], [0; 2]), [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]);
        assert_eq!(philox4x32([!0; 4], [!0; 2]), [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]);
    }

    #[test]
    fn rows_equal_single_cells() {
        let field = Key([7; 32]).field();
        for first in [0, 4, 5, -3] {
            let mut row = [0.0f32; 39];
            field.fill_row(first, -3, &mut row);
            for (x, value) in row.iter().enumerate() {
                assert_eq!(value.to_bits(), (field.normal(first + x as i32, -3) as f32).to_bits());
            }
        }
    }

    #[test]
    fn draws_are_standard_normal_and_white() {
        let field = Key([42; 32]).field();
        let draws: Vec<f64> = (0..200).flat_map(|y| (0..200).map(move |x| field.normal(x, y))).collect();
        let n = draws.len() as f64;
        let mean = draws.iter().sum::<f64>() / n;
        let variance = draws.iter().map(|z| (z - mean) * (z - mean)).sum::<f64>() / n;
        let lag = draws.windows(2).map(|w| w[0] * w[1]).sum::<f64>() / n;
        assert!(mean.abs() < 0.015, "mean {mean}");
        assert!((variance - 1.0).abs() < 0.025, "variance {variance}");
        assert!(lag.abs() < 0.02, "covariance of neighbours {lag}");
    }
}
