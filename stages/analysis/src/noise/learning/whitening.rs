//! Whitens rasters of noise: a map of strength by place, a factor for each class of place in each raster, and what is left.
//!
//! Classes of place are intervals of the strength: acquisitions differ in another way on flat rock than at ledges. The map is the
//! root of the mean square over rasters that are each divided by their own level, so that a strong raster does not rule it.

use rayon::prelude::*;
use rockface_core::artefact::GAP;
use rockface_core::numerics::bands::Bands;
use rockface_core::numerics::gaussian::smoothed;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::quantile::{median, of_sorted};
use rockface_imaging::matching::noise::ensemble::log_strength_at;

/// Shares of the face, from the quietest place on, at which a class of place ends: fifths, and the strongest 3 %.
const CLASS_ENDS: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 0.97];
/// Number of classes of place.
pub const CLASSES: usize = CLASS_ENDS.len() + 1;
/// Number of bands of frequency.
pub const BANDS: usize = 13;
/// Fewest cells along a side of rasters: fewer have no bands of frequency.
pub const LEAST_SIDE_CELLS: usize = 8;
/// Rounds in which map and levels are fitted to each other.
const ROUNDS: usize = 3;
/// Deviations of the Gaussians that fill gaps, cells: the first one that reaches a value.
const FILLING_CELLS: [f64; 2] = [1.5, 6.0];

/// What the strength is expected to be, and how many rasters that is worth.
#[derive(Debug, Clone, Copy)]
pub struct Prior<'a> {
    /// Expected strength of each cell, of any scale.
    pub strength: &'a [f32],
    /// How many rasters the expectation counts as.
    pub rasters: f64,
}

/// Rasters on one grid; NaN in gaps.
#[derive(Debug, Clone, Copy)]
pub struct Stack<'a> {
    /// The values of each raster by row from the top.
    pub rasters: &'a [Vec<f32>],
    /// Columns of the grid.
    pub columns: usize,
    /// Deviation of the Gaussian that smooths the map of strength, cells.
    pub smoothing_cells: f64,
    /// What is known of the map beforehand.
    pub prior: Option<Prior<'a>>,
}

/// Strength by place, and the classes of place.
#[derive(Debug, Clone)]
pub struct Places {
    /// Strength of each cell.
    pub strength: Vec<f32>,
    /// Class of each cell.
    pub class: Vec<u8>,
    /// Logarithm of the strength at the middle of each class.
    pub middles: Vec<f64>,
}

impl Stack<'_> {
    /// Strength by place from the rasters that count.
    pub fn places(&self, counts: &[bool]) -> Places {
        let mut levels = vec![0.0; self.rasters.len()];
        let mut strength = Vec::new();
        for _ in 0..ROUNDS {
            strength = self.strength(counts, &levels);
            levels =
                self.rasters.par_iter().map(|raster| log_rms(raster, &strength, |_| true).unwrap_or(0.0)).collect();
        }
        Places::of(strength)
    }

    /// Root of the smoothed mean square of the rasters that count, each divided by `exp(level)`.
    fn strength(&self, counts: &[bool], levels: &[f64]) -> Vec<f32> {
        let cells = self.rasters[0].len();
        let (mut sums, mut weights) = (vec![0.0f64; cells], vec![0.0f64; cells]);
        for ((raster, level), _) in self.rasters.iter().zip(levels).zip(counts).filter(|(_, counts)| **counts) {
            let factor = portable_math::exp(-2.0 * level);
            for (i, value) in raster.iter().enumerate().filter(|(_, value)| !value.is_nan()) {
                sums[i] += factor * f64::from(*value) * f64::from(*value);
                weights[i] += 1.0;
            }
        }
        let mean = |i: usize| if weights[i] > 0.0 { (sums[i] / weights[i]) as f32 } else { f32::NAN };
        let squares: Vec<f32> = (0..cells).map(mean).collect();
        let mut smooth = if self.smoothing_cells > 0.0 {
            smoothed(&squares, self.columns, self.smoothing_cells)
        } else {
            squares.iter().map(|s| f64::from(*s)).collect()
        };
        if let Some(prior) = self.prior {
            let scale = scale_of(&smooth, prior.strength);
            for (i, square) in smooth.iter_mut().enumerate() {
                let expected = scale * f64::from(prior.strength[i]) * f64::from(prior.strength[i]);
                let known = if square.is_finite() { *square * weights[i] } else { 0.0 };
                *square = (known + expected * prior.rasters) / (weights[i] + prior.rasters);
            }
        }
        // Where no raster has a value the noise was too strong to measure.
        let highest = smooth.iter().copied().filter(|s| s.is_finite()).fold(0.0, f64::max);
        let mut positive: Vec<f64> = smooth.iter().copied().filter(|s| *s > 0.0).collect();
        let least = 1e-6 * median(&mut positive).unwrap_or(1.0);
        smooth.iter().map(|s| (if *s > 0.0 { s.max(least) } else { highest }).sqrt() as f32).collect()
    }
}

/// Ratio of the mean squares of two maps, over the cells where the first has a value.
fn scale_of(squares: &[f64], strength: &[f32]) -> f64 {
    let both = squares.iter().zip(strength).filter(|(square, _)| **square > 0.0);
    let (a, b) = both.fold((0.0, 0.0), |(a, b), (square, s)| (a + square, b + f64::from(*s) * f64::from(*s)));
    if b > 0.0 { a / b } else { 1.0 }
}

/// Logarithm of the rms of a raster divided by the strength, over some cells; `None` without values.
fn log_rms(raster: &[f32], strength: &[f32], takes: impl Fn(usize) -> bool) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0.0);
    for (i, (value, s)) in raster.iter().zip(strength).enumerate() {
        if !value.is_nan() && takes(i) {
            let unit = f64::from(*value) / f64::from(*s);
            (sum, count) = (sum + unit * unit, count + 1.0);
        }
    }
    (sum > 0.0).then(|| 0.5 * portable_math::log(sum / count))
}

impl Places {
    /// Classes of place of a map of strength.
    pub fn of(strength: Vec<f32>) -> Self {
        let unsorted: Vec<f64> = strength.iter().map(|s| portable_math::log(f64::from(*s))).collect();
        let mut logs = unsorted.clone();
        logs.sort_by(f64::total_cmp);
        let ends: Vec<f64> = CLASS_ENDS.iter().filter_map(|share| of_sorted(&logs, *share)).collect();
        let class: Vec<u8> = unsorted.iter().map(|log| ends.partition_point(|end| end < log) as u8).collect();
        let middle = |k: usize| {
            let mut members: Vec<f64> =
                unsorted.iter().zip(&class).filter(|(_, c)| usize::from(**c) == k).map(|(log, _)| *log).collect();
            median(&mut members)
        };
        // A class that no cell falls into (all places alike) has the middle of its neighbour.
        let mut middles: Vec<f64> = Vec::new();
        for k in 0..CLASSES {
            let before = middles.last().copied();
            middles.push(middle(k).or(before).unwrap_or(logs[0]));
        }
        Self { strength, class, middles }
    }

    /// Logarithm of the factor of a raster on the strength, class by class; a class without values has that of the whole raster.
    pub fn log_strength(&self, raster: &[f32]) -> Vec<f64> {
        let whole = log_rms(raster, &self.strength, |_| true).unwrap_or(0.0);
        let of_class = |k: usize| log_rms(raster, &self.strength, |i| usize::from(self.class[i]) == k).unwrap_or(whole);
        (0..self.middles.len()).map(of_class).collect()
    }

    /// Share of each class of place in the power of noise of this strength.
    pub fn power_shares(&self) -> Vec<f64> {
        let mut powers = vec![0.0; self.middles.len()];
        for (class, s) in self.class.iter().zip(&self.strength) {
            powers[usize::from(*class)] += f64::from(*s) * f64::from(*s);
        }
        let whole = powers.iter().sum::<f64>();
        powers.into_iter().map(|power| power / whole).collect()
    }

    /// A raster divided by strength and factors, with gaps.
    fn divided(&self, raster: &[f32], log_strength: &[f64]) -> Vec<f32> {
        let values = raster.iter().zip(&self.strength);
        values.map(|(value, s)| (f64::from(*value) / self.factor(log_strength, *s)) as f32).collect()
    }

    /// Deviation of the noise of a raster with these factors where the map has the strength `s`.
    fn factor(&self, log_strength: &[f64], s: f32) -> f64 {
        let log = portable_math::log(f64::from(s));
        f64::from(s) * portable_math::exp(log_strength_at(&self.middles, log_strength, log))
    }
}

/// A raster divided by its strength: what is left, and how strong it was.
#[derive(Debug, Clone)]
pub struct Whitened {
    /// Logarithm of its factor on the strength, for each class of place.
    pub log_strength: Vec<f64>,
    /// What is left, of unit variance, gaps filled.
    pub field: Vec<f32>,
    /// Weight of each value: 127 inside, falling to 0 in a gap; `GAP` is added where there was no value.
    pub weights: Vec<u8>,
    /// Logarithm of the amplitude of what is left in each band; 0 is that of white noise.
    pub log_amplitude: Vec<f64>,
    /// The same of the raster itself, divided by its rms: there strong places count for more.
    pub raster_log_amplitude: Vec<f64>,
    /// Logarithm of the rms of the raster.
    pub log_rms: f64,
}

impl Whitened {
    /// Logarithms of its strength by class of place, over its rms, and of its amplitude by band, as they are. In rasters with a few coarse waves the rms is chance: strengths, and
    /// amplitudes divided by it, then vary against each other though fine noise is the same in all.
    pub fn apart(&self) -> Vec<f64> {
        let strengths = self.log_strength.iter().map(|log| log - self.log_rms);
        strengths.chain(self.raster_log_amplitude.iter().map(|log| log + self.log_rms)).collect()
    }
}

/// Whitens all rasters of `columns` columns.
pub fn whiten(rasters: &[Vec<f32>], columns: usize, places: &Places) -> Vec<Whitened> {
    let rows = places.strength.len() / columns;
    let bands = Bands::new(columns, rows, BANDS);
    rasters.par_iter().map(|raster| whitened(raster, &bands, columns, places)).collect()
}

/// Whitens one raster: divides it by the strength at each place and fills its gaps.
pub fn whitened(raster: &[f32], bands: &Bands, columns: usize, places: &Places) -> Whitened {
    let log_strength = places.log_strength(raster);
    let (field, weights) = filled(&places.divided(raster, &log_strength), columns);
    let left: Vec<f64> = field.iter().map(|value| f64::from(*value)).collect();
    let values = left.iter().zip(&places.strength).map(|(value, s)| value * places.factor(&log_strength, *s));
    let mut level: Vec<f64> = values.collect();
    let rms = (level.iter().map(|value| value * value).sum::<f64>() / level.len() as f64).sqrt();
    let rms = rms.max(f64::MIN_POSITIVE);
    level.iter_mut().for_each(|value| *value /= rms);
    let raster_log_amplitude = log_amplitude(bands, &level);
    let log_rms = portable_math::log(rms);
    Whitened { log_amplitude: log_amplitude(bands, &left), raster_log_amplitude, log_rms, log_strength, field, weights }
}

/// Logarithm of the amplitude in each band.
fn log_amplitude(bands: &Bands, values: &[f64]) -> Vec<f64> {
    bands.power(values).iter().map(|power| 0.5 * portable_math::log(power.max(1e-12))).collect()
}

/// A field without gaps, and weights that fall smoothly towards them: where one donor ends, the others must take over without a step.
fn filled(values: &[f32], columns: usize) -> (Vec<f32>, Vec<u8>) {
    let [near, far] = FILLING_CELLS.map(|cells| smoothed(values, columns, cells));
    let mask: Vec<f32> = values.iter().map(|value| f32::from(u8::from(!value.is_nan()))).collect();
    let inside = smoothed(&mask, columns, FILLING_CELLS[0]);
    let fill = |i: usize| (if near[i] == 0.0 { far[i] } else { near[i] }) as f32;
    let field = values.iter().enumerate().map(|(i, value)| if value.is_nan() { fill(i) } else { *value }).collect();
    let weight = |(share, value): (&f64, &f32)| {
        let weight = ((2.0 * share - 1.0).clamp(0.0, 1.0) * f64::from(!GAP)).round().max(1.0) as u8;
        if value.is_nan() { weight | GAP } else { weight }
    };
    (field, inside.iter().zip(values).map(weight).collect())
}

/// A gap whose filling is at least this part of the largest error that rasters hold was an outlier.
const OUTLIER_FROM: f64 = 0.3;
/// How large an outlier is, as a part of the largest error that rasters hold: beyond it errors fall off by a factor e in a quarter of it.
const OUTLIER: f64 = 1.25;

/// Gives the gaps of a field that errors of more than `limit_px` (cell by cell) have left in its raster such errors, with the sign of what is around
/// them. Other gaps, where nothing was matched, stay filled as they are.
pub fn restore_outliers(whitened: &mut Whitened, places: &Places, limit_px: impl Fn(usize) -> f64) {
    for (cell, (value, weight)) in whitened.field.iter_mut().zip(&whitened.weights).enumerate() {
        if weight & GAP == 0 {
            continue;
        }
        let limit = limit_px(cell) / places.factor(&whitened.log_strength, places.strength[cell]);
        if limit.is_finite() && f64::from(value.abs()) > OUTLIER_FROM * limit {
            *value = (OUTLIER * limit).copysign(f64::from(*value)) as f32;
        }
    }
}

/// Cells at which the mean correlation of whitened fields has fallen to one twentieth.
pub fn range_cells(fields: &[&Whitened], columns: usize) -> usize {
    let rows = fields[0].field.len() / columns;
    let bands = Bands::new(columns, rows, BANDS);
    let of_field = |whitened: &&Whitened| {
        let values: Vec<f64> = whitened.field.iter().map(|value| f64::from(*value)).collect();
        bands.correlation(&values)
    };
    let all: Vec<Vec<f64>> = fields.par_iter().map(of_field).collect();
    let mean = |lag: usize| all.iter().map(|correlation| correlation[lag]).sum::<f64>() / all.len() as f64;
    (0..all[0].len()).find(|lag| mean(*lag) < 0.05).unwrap_or(all[0].len()).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::random::Key;

    #[test]
    fn strength_by_place_and_levels_of_rasters_come_apart() {
        let (columns, rows) = (60, 50);
        let place = |i: usize| if i % columns < 20 { 3.0 } else { 1.0 };
        let level = |b: usize| portable_math::exp(0.2 * (b as f64 - 6.0));
        let rasters: Vec<Vec<f32>> = (0..13u8)
            .map(|b| {
                let field = Key([b; 32]).field();
                let draw = |i: usize| field.normal((i % columns) as i32, (i / columns) as i32);
                (0..columns * rows).map(|i| (0.01 * place(i) * level(usize::from(b)) * draw(i)) as f32).collect()
            })
            .collect();
        let stack = Stack { rasters: &rasters, columns, smoothing_cells: 2.0, prior: None };
        let places = stack.places(&[true; 13]);
        let ratio = f64::from(places.strength[25 * columns + 5]) / f64::from(places.strength[25 * columns + 45]);
        assert!((ratio - 3.0).abs() < 0.4, "{ratio}");
        let whitened = whiten(&rasters, columns, &places);
        let rise = whitened[12].log_strength[2] - whitened[0].log_strength[2];
        assert!((rise - 2.4).abs() < 0.1, "{rise}");
        let variance = whitened[3].field.iter().map(|v| f64::from(*v) * f64::from(*v)).sum::<f64>() / 3000.0;
        assert!((variance - 1.0).abs() < 0.05, "{variance}");
        assert!(whitened[3].log_amplitude.iter().skip(4).all(|a| a.abs() < 0.2), "{:?}", whitened[3].log_amplitude);
    }

    #[test]
    fn amplitudes_of_the_raster_are_those_of_its_strong_places() {
        let (columns, rows) = (64, 64);
        let field = Key([3; 32]).field();
        let fine: Vec<f32> =
            (0..columns * rows).map(|i| field.normal((i % 64) as i32, (i / 64) as i32) as f32).collect();
        let coarse = smoothed(&fine, columns, 1.5);
        // Noise on the left is ten times as strong as on the right, and coarse.
        let strong = |i: usize| i % columns < columns / 2;
        let raster = (0..columns * rows).map(|i| if strong(i) { 50.0 * coarse[i] as f32 } else { fine[i] });
        let places = Places::of((0..columns * rows).map(|i| if strong(i) { 10.0 } else { 1.0 }).collect());
        let found = whiten(&[raster.collect()], columns, &places).remove(0);
        let finest = |log_amplitude: &[f64]| log_amplitude[BANDS - 1];
        assert!(finest(&found.log_amplitude) > -0.6, "{:?}", found.log_amplitude);
        assert!(finest(&found.raster_log_amplitude) < -1.5, "{:?}", found.raster_log_amplitude);
    }

    #[test]
    fn gaps_beside_large_errors_were_outliers() {
        let columns = 40;
        let noise = Key([1; 32]).field();
        let mut raster: Vec<f32> = (0..1600).map(|i| noise.normal(i % 40, i / 40) as f32 * 0.1).collect();
        for (row, column) in (9..14).flat_map(|row| (9..14).map(move |column| (row, column))) {
            raster[row * columns + column] = if row == 11 && column == 11 { f32::NAN } else { -0.9 };
        }
        raster[25 * columns + 25] = f32::NAN;
        let places = Places::of(vec![1.0; 1600]);
        let mut whitened = whiten(std::slice::from_ref(&raster), columns, &places).remove(0);
        let before = whitened.clone();
        restore_outliers(&mut whitened, &places, |_| 1.0);
        let factor = portable_math::exp(whitened.log_strength[0]);
        assert!((f64::from(whitened.field[11 * columns + 11]) * factor + OUTLIER).abs() < 1e-5);
        let changed =
            whitened.field.iter().zip(&before.field).filter(|(now, then)| now.to_bits() != then.to_bits()).count();
        assert!(changed == 1 && whitened.weights == before.weights);
        // Where rasters were not filtered nothing is known of outliers.
        let mut other = before.clone();
        restore_outliers(&mut other, &places, |_| f64::INFINITY);
        assert!(other.field == before.field);
    }

    #[test]
    fn weights_fall_towards_a_gap() {
        let mut values = vec![1.0f32; 400];
        (8..12).for_each(|row| (8..12).for_each(|column| values[row * 20 + column] = f32::NAN));
        let (field, weights) = filled(&values, 20);
        assert!(field.iter().all(|value| (value - 1.0).abs() < 1e-5));
        assert!(weights[9 * 20 + 9] == 1 | GAP && weights[9 * 20 + 6] > 50 && weights[0] == 127, "{weights:?}");
    }
}
