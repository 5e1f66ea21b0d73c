//! The wall that works are measured on, where they need no synthesised face, and how its points are numbered.

use rockface_core::artefact::{Frame, Surface};
use rockface_core::numerics::random::Key;

/// Height of a wall of ridges, ledges and bumps, all of straight pieces, metres.
pub fn height(x: f64, y: f64) -> f64 {
    let tooth = |t: f64| 1.0 - 2.0 * ((t - t.floor()) - 0.5).abs();
    0.5 * tooth(0.31 * x + 0.2 * y) + 0.15 * tooth(1.3 * y - 0.7 * x) + 0.02 * tooth(7.1 * x + 5.3 * y)
}

/// Points of the wall near the corners of a square grid of `side` x `side`, each up to a third of the spacing beside, with
/// noise along Z; row by row.
pub fn scattered(side: usize, spacing_m: f64, noise_m: f64, seed: u8) -> Vec<[f64; 3]> {
    let field = Key([seed; 32]).field();
    let point = |row: usize, column: usize| {
        let words = field.words(column as i32, row as i32);
        let beside = |word: u32| (f64::from(word) / f64::from(u32::MAX) - 0.5) * 2.0 / 3.0;
        let (x, y) = (spacing_m * (column as f64 + beside(words[2])), spacing_m * (row as f64 + beside(words[3])));
        [x, y, height(x, y) + noise_m * field.normal(column as i32, row as i32)]
    };
    (0..side).flat_map(|row| (0..side).map(move |column| (row, column))).map(|(r, c)| point(r, c)).collect()
}

/// The surface of a square grid of points, row by row from below; a surface has its rows from above.
pub fn surface(points: &[[f64; 3]], side: usize, origin_m: [f64; 3]) -> Surface {
    let from_above: Vec<[f64; 3]> = points.chunks(side).rev().flatten().copied().collect();
    Surface {
        frame: Frame::Wall,
        width: side,
        height: side,
        origin_m,
        points: from_above.into_iter().map(|point| point.map(|value| value as f32)).collect(),
        squares: vec![Surface::FIRST | Surface::SECOND; (side - 1) * (side - 1)],
    }
}
