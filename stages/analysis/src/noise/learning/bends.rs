//! How orientations bend a face, beside the polynomial of a trend.
//!
//! An error of an orientation bends a surface as the geometry of its rays and the relief of the face say, not like a polynomial of the third degree.
//! What is left of a raster without its trend then follows from the factors of this trend, in the same way in all rasters. Linear regression
//! over the rasters finds it around each cell, from wide parts of the face to small ones.

use rayon::prelude::*;

use rockface_core::numerics::gaussian::smoothed;
use rockface_core::numerics::trend::{BENDS, Trend, bends_at, without_trend};

/// Deviations of the Gaussians under which rasters are compared with their trends one after the other, as a share of their shorter side.
const SCALES: [f64; 3] = [0.1, 0.05, 0.025];
/// Deviation of the Gaussian under which what trends explain is compared with chance, in deviations of the scale.
const POOL: f64 = 2.0;
/// Times its chance that a mode must explain to count.
const LEAST_TIMES: f64 = 3.0;
/// Fewest rasters beyond the number of modes.
const LEAST_SPARE: usize = 4;
/// Least part of the power of the strongest mode that one has whose factors are told apart.
const LEAST_POWER: f64 = 1e-4;
/// Factors of a trend that bend it.
const FACTORS: usize = BENDS.end - BENDS.start;

/// The shapes of the bends of some rasters, by the factors of their trends beyond a plane: what comes with a unit of each at each cell, metres for a
/// metre. The rasters are without their trends already (metres, NaN in gaps), and the shapes have none; `trend_weights` are those of cells in trends.
/// Empty where there are too few rasters, or they are not bent.
pub fn shapes(level: &[Vec<f32>], trends: &[Trend], columns: usize, trend_weights: &[f32]) -> Vec<Vec<f32>> {
    let weights: Vec<f64> = level.iter().map(|raster| 1.0 / rms(raster)).collect();
    let modes = modes(trends, &weights);
    if modes.is_empty() || level.len() < modes.len() + LEAST_SPARE {
        return Vec::new();
    }
    let mut left = level.to_vec();
    let cells = left[0].len();
    let side = columns.min(cells / columns) as f64;
    let mut shapes = vec![vec![0.0f32; cells]; FACTORS];
    for scale in SCALES {
        let pool = |values: &[f32]| smoothed(values, columns, POOL * scale * side);
        let parts = Parts::of(&left, &weights, &modes, |raster| smoothed(raster, columns, scale * side));
        let chance = pool(&parts.chance);
        for (mode, part) in modes.iter().zip(parts.by_mode) {
            let power = pool(&part.iter().map(|part| part * part).collect::<Vec<f32>>());
            let certain = |((part, power), chance): ((&f32, &f64), &f64)| {
                if *power > LEAST_TIMES * chance { (f64::from(*part) * (1.0 - chance / power)) as f32 } else { 0.0 }
            };
            let kept: Vec<f32> = part.iter().zip(&power).zip(&chance).map(certain).collect();
            let add = |(values, factor): (&mut Vec<f32>, f64)| {
                values.iter_mut().zip(&kept).for_each(|(value, kept)| *value += (factor * f64::from(*kept)) as f32);
            };
            shapes.par_iter_mut().zip(mode.of_factors).for_each(add);
            let off = mode.of_rasters.par_iter().zip(&weights).map(|(of_raster, weight)| -of_raster / weight);
            left.par_iter_mut().zip(off).for_each(add);
        }
    }
    let level = |shape: &Vec<f32>| without_trend(shape, columns, trend_weights).unwrap_or_else(|| shape.clone());
    shapes.iter().map(level).collect()
}

/// Takes off rasters without their trends what comes with their bends, by shapes that are known.
pub fn take_off(level: &mut [Vec<f32>], trends: &[Trend], shapes: &[Vec<f32>]) {
    level.par_iter_mut().zip(trends).for_each(|(raster, trend)| {
        raster.iter_mut().enumerate().for_each(|(cell, value)| *value -= bends_at(trend, shapes, cell) as f32);
    });
}

fn rms(raster: &[f32]) -> f64 {
    let known = raster.iter().filter(|value| !value.is_nan()).map(|value| f64::from(*value));
    let (sum, count) = known.fold((0.0, 0.0), |(sum, count), value| (sum + value * value, count + 1.0));
    (sum / count).sqrt()
}

/// A way in which the weighted factors of trends differ from raster to raster.
struct Mode {
    /// How much each raster has of it; the squares add up to 1, and products with other modes to 0.
    of_rasters: Vec<f64>,
    /// The sum of factors that it is.
    of_factors: [f64; FACTORS],
}

/// The modes of the factors of trends, the strongest first (Gram and Schmidt, with pivots).
fn modes(trends: &[Trend], weights: &[f64]) -> Vec<Mode> {
    let mut left: Vec<Mode> = BENDS
        .map(|k| Mode {
            of_rasters: trends.iter().zip(weights).map(|(trend, weight)| weight * trend[k]).collect(),
            of_factors: std::array::from_fn(|factor| f64::from(u8::from(BENDS.start + factor == k))),
        })
        .collect();
    let dot = |a: &Mode, b: &Mode| a.of_rasters.iter().zip(&b.of_rasters).map(|(a, b)| a * b).sum::<f64>();
    let add = |mode: &mut Mode, times: f64, other: &Mode| {
        mode.of_rasters.iter_mut().zip(&other.of_rasters).for_each(|(value, other)| *value += times * other);
        mode.of_factors.iter_mut().zip(other.of_factors).for_each(|(value, other)| *value += times * other);
    };
    let mut found: Vec<Mode> = Vec::new();
    let mut strongest = 0.0f64;
    while let Some(pivot) =
        (0..left.len()).max_by(|a, b| dot(&left[*a], &left[*a]).total_cmp(&dot(&left[*b], &left[*b])))
    {
        let mut mode = left.swap_remove(pivot);
        let power = dot(&mode, &mode);
        strongest = strongest.max(power);
        if power <= LEAST_POWER * strongest {
            break;
        }
        let length = power.sqrt();
        mode.of_rasters.iter_mut().chain(&mut mode.of_factors).for_each(|value| *value /= length);
        left.iter_mut().for_each(|other| add(other, -dot(other, &mode), &mode));
        found.push(mode);
    }
    found
}

/// What weighted rasters have of each mode at each cell.
struct Parts {
    by_mode: Vec<Vec<f32>>,
    /// The mean square of what they have of none, which each mode has by chance.
    chance: Vec<f32>,
}

impl Parts {
    fn of(level: &[Vec<f32>], weights: &[f64], modes: &[Mode], smooth: impl Fn(&[f32]) -> Vec<f64> + Sync) -> Self {
        let cells = level[0].len();
        let mut by_mode = vec![vec![0.0f32; cells]; modes.len()];
        let mut squares = vec![0.0f32; cells];
        for ((i, raster), weight) in level.iter().enumerate().zip(weights) {
            let smooth: Vec<f32> = smooth(raster).into_iter().map(|value| (weight * value) as f32).collect();
            squares.iter_mut().zip(&smooth).for_each(|(sum, value)| *sum += value * value);
            by_mode.par_iter_mut().zip(modes).for_each(|(part, mode)| {
                let of_raster = mode.of_rasters[i] as f32;
                part.iter_mut().zip(&smooth).for_each(|(part, value)| *part += of_raster * value);
            });
        }
        let spare = (level.len() - modes.len()) as f32;
        let chance = |(cell, squares): (usize, &f32)| {
            let explained = by_mode.iter().map(|part| part[cell] * part[cell]).sum::<f32>();
            (squares - explained).max(0.0) / spare
        };
        let chance = squares.iter().enumerate().map(chance).collect();
        Self { by_mode, chance }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;
    use rockface_core::numerics::trend::{bent, trend};

    const COLUMNS: usize = 60;
    const ROWS: usize = 40;

    /// A wave that no trend of the third degree follows, metres for a metre.
    fn wave(cell: usize) -> f64 {
        0.5 * rockface_core::numerics::portable_math::sin(0.45 * (cell % COLUMNS) as f64)
    }

    /// Rasters of white noise that are bent by their trend and, with each metre of its first bend, by `wave`.
    fn rasters(count: usize, wave: impl Fn(usize) -> f64) -> Vec<Vec<f32>> {
        let one = |i: usize| {
            let random = Key([i as u8; 32]).field();
            let trend = std::array::from_fn(|k| if k < 6 { 0.01 * random.normal(-1, k as i32) } else { 0.0 });
            let noise = |cell: usize| 0.004 * random.normal((cell % COLUMNS) as i32, (cell / COLUMNS) as i32);
            let value =
                |cell: usize| if cell % 11 == 3 { f32::NAN } else { (noise(cell) + trend[3] * wave(cell)) as f32 };
            bent(&(0..COLUMNS * ROWS).map(value).collect::<Vec<_>>(), COLUMNS, &trend, &[])
        };
        (0..count).map(one).collect()
    }

    fn apart(rasters: &[Vec<f32>]) -> (Vec<Vec<f32>>, Vec<Trend>) {
        let level = rasters.iter().map(|raster| without_trend(raster, COLUMNS, &[]).unwrap()).collect();
        (level, rasters.iter().map(|raster| trend(raster, COLUMNS, &[]).unwrap()).collect())
    }

    fn power(rasters: &[Vec<f32>]) -> f64 {
        rasters.iter().map(|raster| rms(raster) * rms(raster)).sum::<f64>() / rasters.len() as f64
    }

    #[test]
    fn what_comes_with_a_trend_in_all_rasters_is_its_shape_and_comes_off() {
        let (mut level, trends) = apart(&rasters(26, wave));
        let before = power(&level);
        let shapes = shapes(&level, &trends, COLUMNS, &[]);
        take_off(&mut level, &trends, &shapes);
        // A trend takes a little of the wave, and its factor grows by it.
        let wave: Vec<f32> = (0..COLUMNS * ROWS).map(|cell| wave(cell) as f32).collect();
        let (truth, taken) = (without_trend(&wave, COLUMNS, &[]).unwrap(), trend(&wave, COLUMNS, &[]).unwrap()[3]);
        let inside = |cell: &usize| (6..COLUMNS - 6).contains(&(cell % COLUMNS));
        let of = |value: &dyn Fn(usize) -> f64| (0..COLUMNS * ROWS).filter(inside).map(value).sum::<f64>();
        let slope = of(&|i| f64::from(shapes[0][i] * truth[i])) / of(&|i| f64::from(truth[i] * truth[i]));
        let other = of(&|i| f64::from(shapes[1][i] * shapes[1][i])) / of(&|i| f64::from(shapes[0][i] * shapes[0][i]));
        assert!((slope * (1.0 + taken) - 1.0).abs() < 0.1 && other < 0.05, "{slope} {taken} {other}");
        let noise = 0.004 * 0.004;
        assert!(before > 1.3 * noise && power(&level) < 1.08 * noise, "{before} {}", power(&level));
        assert!(level[4][3].is_nan() && shapes.iter().flatten().all(|value| value.is_finite()));
    }

    #[test]
    fn noise_alone_has_next_to_no_shape() {
        let (mut level, trends) = apart(&rasters(26, |_| 0.0));
        let before = power(&level);
        let shapes = shapes(&level, &trends, COLUMNS, &[]);
        take_off(&mut level, &trends, &shapes);
        assert!(power(&level) > 0.99 * before, "{} {before}", power(&level));
    }

    #[test]
    fn few_rasters_and_level_ones_have_none() {
        let (level, trends) = apart(&rasters(6, wave));
        assert!(shapes(&level, &trends, COLUMNS, &[]).is_empty());
        let (level, _) = apart(&rasters(26, wave));
        assert!(shapes(&level, &[Trend::default(); 26], COLUMNS, &[]).is_empty());
    }
}
