//! Figures of the fine structure of a raster, about a hundred, that the ten descriptors of noise leave out.
//!
//! * Increments z(x + h) - z(x) in four directions and at several lags: their rms, and their flatness mean(d^4) / mean(d^2)^2, which is 3
//!   where they are normal and grows where strong and weak places alternate (intermittency: Frisch 1995, chapter 8).
//! * The Haar pyramid (Mallat 1989), three orientations a level: rms and flatness of the details.
//! * A cascade: how much the modulus of the details of one level varies at coarser levels, as the second order of a scattering
//!   transform (Bruna and Mallat 2013).
//! * Tails of the marginal distribution, and the rms in blocks over the raster: where on the face the noise is strong.
//!
//! All are natural logarithms, and all but the last of the marginal figures are relative to the rms of the raster. NaN cells take no part.

use rockface_core::StageError;
use rockface_core::artefact::LevelFigures;
use rockface_core::numerics::portable_math;
use rockface_core::numerics::quantile::nearest_rank;

/// How fine the description is: lags, levels and blocks.
#[derive(Debug, Clone)]
pub struct Settings {
    /// Lags of the increments, cells along each axis.
    pub lags_cells: Vec<usize>,
    /// Levels of the pyramid.
    pub levels: usize,
    /// Columns and rows of blocks.
    pub blocks: [usize; 2],
}

/// One field of numbers by rows; NaN where there is none.
#[derive(Debug, Clone)]
struct Field {
    columns: usize,
    rows: usize,
    values: Vec<f64>,
}

/// Steps by name: columns to the right, rows down.
const DIRECTIONS: [(&str, isize, isize); 4] = [("x", 1, 0), ("y", 0, 1), ("down", 1, 1), ("up", 1, -1)];
/// Orientations of the details.
const ORIENTATIONS: [&str; 3] = ["x", "y", "diagonal"];
/// Shares of the sizes that are compared with their median.
const TAILS: [(&str, f64); 2] = [("tail_99", 0.99), ("tail_999", 0.999)];

/// Names of the figures, in the order of [`structure`].
pub fn names(settings: &Settings) -> Vec<String> {
    let mut names = Vec::new();
    for lag in &settings.lags_cells {
        for (direction, _, _) in DIRECTIONS {
            names.extend(["rms", "flatness"].map(|what| format!("increment_{direction}_{lag}_{what}")));
        }
    }
    for level in 1..=settings.levels {
        for orientation in ORIENTATIONS {
            names.extend(["rms", "flatness"].map(|what| format!("haar_{orientation}_{level}_{what}")));
        }
    }
    for fine in 1..=settings.levels {
        names.extend((fine + 1..=settings.levels).map(|coarse| format!("cascade_{fine}_{coarse}")));
    }
    names.extend(TAILS.map(|(name, _)| name.to_owned()));
    names.extend(["flatness", "rms"].map(str::to_owned));
    let [columns, rows] = settings.blocks;
    names.extend((0..rows).flat_map(|row| (0..columns).map(move |column| format!("block_{row}_{column}"))));
    names
}

/// The figures of one band; `Err` says what has none.
///
/// # Errors
/// Cells without any difference between them, or too few of them, at some lag or level.
pub fn structure(values: &[f32], columns: usize, settings: &Settings) -> Result<Vec<f64>, StageError> {
    let field = Field::centred(values, columns);
    let total = Moments::of(field.values.iter().copied());
    let log_rms = total.log_rms("its departures from the mean")?;
    let mut found = Vec::new();
    for lag in &settings.lags_cells {
        for (direction, right, down) in DIRECTIONS {
            let moments = field.increments(right * *lag as isize, down * *lag as isize);
            let name = format!("the increments `{direction}` over {lag} cells");
            found.extend([moments.log_rms(&name)? - log_rms, moments.log_flatness()]);
        }
    }
    let mut moduli = Vec::new();
    let mut smooth = field.clone();
    for level in 1..=settings.levels {
        let (details, next) = smooth.haar();
        for (orientation, detail) in ORIENTATIONS.iter().zip(&details) {
            let moments = Moments::of(detail.values.iter().copied());
            let name = format!("the details `{orientation}` of level {level}");
            found.extend([moments.log_rms(&name)? - log_rms, moments.log_flatness()]);
        }
        moduli.push(modulus(&details));
        smooth = next;
    }
    for (fine, modulus) in moduli.into_iter().enumerate() {
        found.extend(cascade(modulus, settings.levels - fine - 1, fine + 1)?);
    }
    let size = |q: f64| nearest_rank(field.values.iter().map(|z| z.abs() as f32), q).unwrap_or(f64::NAN);
    let middle = size(0.5);
    if middle <= 0.0 {
        return Err(StageError::new("more than half of its cells have the same value"));
    }
    found.extend(TAILS.map(|(_, q)| portable_math::log(size(q) / middle)));
    found.extend([total.log_flatness(), log_rms]);
    found.extend(field.blocks(settings.blocks).into_iter().map(|block| block.map_or(0.0, |log| log - log_rms)));
    Ok(found)
}

/// Figures of the details of each level of the Haar pyramid, the finest first; NaN where a level has no values.
pub fn levels(values: &[f32], columns: usize, count: usize) -> Vec<LevelFigures> {
    let mut smooth = Field::centred(values, columns);
    let whole = Moments::of(smooth.values.iter().copied()).log_rms("").unwrap_or(f64::NAN);
    let one = |level: usize| {
        let (details, next) = smooth.haar();
        smooth = next;
        let moments = details.each_ref().map(|detail| Moments::of(detail.values.iter().copied()));
        let [x, y, diagonal] = moments.each_ref().map(Moments::log_flatness);
        let modulus = modulus(&details);
        let near = cascade(modulus.clone(), 1, level).map_or(f64::NAN, |found| found[0]);
        let far = cascade(modulus, 2, level).map_or(if near.is_nan() { near } else { 0.0 }, |found| found[1]);
        let log_rms = moments.map(|moments| moments.log_rms("").map_or(f64::NAN, |log| log - whole));
        LevelFigures { log_rms, unevenness: [x, y, diagonal, near, far] }
    };
    (1..=count).map(one).collect()
}

/// Sums of squares and fourth powers.
#[derive(Debug, Clone, Copy, Default)]
struct Moments {
    count: f64,
    second: f64,
    fourth: f64,
}

impl Moments {
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut moments = Self::default();
        values.for_each(|z| moments.add(z));
        moments
    }

    fn add(&mut self, z: f64) {
        if z.is_finite() {
            let square = z * z;
            self.count += 1.0;
            self.second += square;
            self.fourth += square * square;
        }
    }

    /// Half the logarithm of the mean square.
    fn log_rms(&self, what: &str) -> Result<f64, StageError> {
        if self.second > 0.0 {
            Ok(0.5 * portable_math::log(self.second / self.count))
        } else {
            Err(StageError::new(format!("{what} are all 0 or missing")))
        }
    }

    fn log_flatness(&self) -> f64 {
        portable_math::log(self.fourth * self.count / (self.second * self.second))
    }
}

impl Field {
    fn centred(values: &[f32], columns: usize) -> Self {
        let finite = || values.iter().filter(|z| z.is_finite()).map(|z| f64::from(*z));
        let mean = finite().sum::<f64>() / finite().count().max(1) as f64;
        let values: Vec<f64> = values.iter().map(|z| f64::from(*z) - mean).collect();
        Self { columns, rows: values.len() / columns, values }
    }

    /// Moments of the differences between cells a step apart, `right` of 0 or more.
    fn increments(&self, right: isize, down: isize) -> Moments {
        let mut moments = Moments::default();
        let lag = right.unsigned_abs();
        for row in 0..self.rows {
            let Some(other) = row.checked_add_signed(down).filter(|other| *other < self.rows) else { continue };
            let (from, to) = (self.row(row), self.row(other));
            from.iter().zip(to.iter().skip(lag)).for_each(|(a, b)| moments.add(b - a));
        }
        moments
    }

    fn row(&self, row: usize) -> &[f64] {
        &self.values[row * self.columns..(row + 1) * self.columns]
    }

    /// Details along x, along y and diagonal, each of half the size, and the means of the blocks of 2 x 2 cells. A mean takes two
    /// values at least; a detail three, with their mean for the fourth.
    fn haar(&self) -> ([Self; 3], Self) {
        let (columns, rows) = (self.columns / 2, self.rows / 2);
        let empty = || Self { columns, rows, values: Vec::with_capacity(columns * rows) };
        let mut details = [empty(), empty(), empty()];
        let mut means = empty();
        for row in 0..rows {
            let (upper, lower) = (self.row(2 * row), self.row(2 * row + 1));
            for (u, l) in upper.chunks_exact(2).zip(lower.chunks_exact(2)) {
                let block = [u[0], u[1], l[0], l[1]];
                let [a, b, c, d] = with_one_gap_filled(block);
                details[0].values.push(0.5 * (a - b + c - d));
                details[1].values.push(0.5 * (a + b - c - d));
                details[2].values.push(0.5 * (a - b - c + d));
                means.values.push(mean_of_two_or_more(block));
            }
        }
        (details, means)
    }

    /// The logarithm of the rms of each block, by rows; `None` where it has no value but 0.
    fn blocks(&self, [columns, rows]: [usize; 2]) -> Vec<Option<f64>> {
        let block = |row: usize, column: usize| {
            let mut moments = Moments::default();
            for r in self.rows * row / rows..self.rows * (row + 1) / rows {
                let cells = self.columns * column / columns..self.columns * (column + 1) / columns;
                self.row(r)[cells].iter().for_each(|z| moments.add(*z));
            }
            moments.log_rms("").ok()
        };
        (0..rows).flat_map(|row| (0..columns).map(move |column| (row, column))).map(|(r, c)| block(r, c)).collect()
    }
}

fn mean_of_two_or_more(cells: [f64; 4]) -> f64 {
    let (count, sum) = cells.iter().filter(|z| z.is_finite()).fold((0.0, 0.0), |(n, sum), z| (n + 1.0, sum + z));
    if count >= 2.0 { sum / count } else { f64::NAN }
}

/// One missing value becomes the mean of the others.
fn with_one_gap_filled(cells: [f64; 4]) -> [f64; 4] {
    let missing = cells.iter().filter(|z| !z.is_finite()).count();
    if missing != 1 {
        return cells;
    }
    let mean = mean_of_two_or_more(cells);
    cells.map(|z| if z.is_finite() { z } else { mean })
}

fn modulus(details: &[Field; 3]) -> Field {
    let [x, y, diagonal] = details.each_ref().map(|field| &field.values);
    let length = |i: usize| (x[i] * x[i] + y[i] * y[i] + diagonal[i] * diagonal[i]).sqrt();
    Field { values: (0..x.len()).map(length).collect(), ..details[0] }
}

/// The rms of the details of a modulus at each coarser level, relative to the rms of the modulus.
fn cascade(modulus: Field, levels: usize, fine: usize) -> Result<Vec<f64>, StageError> {
    let whole = Moments::of(modulus.values.iter().copied()).log_rms(&format!("the details of level {fine}"))?;
    let mut found = Vec::new();
    let mut smooth = modulus;
    for level in 1..=levels {
        let (details, next) = smooth.haar();
        let moments = Moments::of(details.iter().flat_map(|detail| detail.values.iter().copied()));
        found.push(
            moments.log_rms(&format!("the details of the modulus of level {fine} at level {}", fine + level))? - whole,
        );
        smooth = next;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::numerics::portable_math::log;
    use rockface_core::numerics::random::Key;

    fn settings() -> Settings {
        Settings { lags_cells: vec![1, 2], levels: 4, blocks: [3, 2] }
    }

    fn found(value: impl Fn(i32, i32) -> f64) -> impl Fn(&str) -> f64 {
        let values: Vec<f32> =
            (0..128).flat_map(|y| (0..160).map(move |x| (x, y))).map(|(x, y)| value(x, y) as f32).collect();
        let figures = structure(&values, 160, &settings()).unwrap();
        let names = names(&settings());
        assert_eq!(names.len(), figures.len());
        move |name| figures[names.iter().position(|n| n == name).unwrap()]
    }

    #[test]
    fn white_noise_is_flat_even_and_without_direction() {
        let field = Key([1; 32]).field();
        let of = found(|x, y| field.normal(x, y));
        for direction in ["x", "y", "down", "up"] {
            assert!((of(&format!("increment_{direction}_2_rms")) - 0.5 * log(2.0)).abs() < 0.02);
            assert!((of(&format!("increment_{direction}_1_flatness")) - log(3.0)).abs() < 0.05);
        }
        // Details of blocks of 2^l cells a side have half their deviation a level more.
        assert!((of("haar_x_3_rms") - log(0.25)).abs() < 0.1 && of("rms").abs() < 0.02);
        assert!(of("block_1_2").abs() < 0.05 && (of("flatness") - log(3.0)).abs() < 0.05);
        assert!((of("tail_99") - log(2.5758 / 0.6745)).abs() < 0.03);
    }

    #[test]
    fn stripes_have_a_direction_and_a_strong_corner_its_block() {
        let field = Key([2; 32]).field();
        let of = found(|x, y| field.normal(x, 0) + 0.01 * field.normal(x, y + 1));
        assert!(of("increment_x_1_rms") > of("increment_y_1_rms") + 3.0);
        assert!(of("haar_x_2_rms") > of("haar_y_2_rms") + 3.0);
        let of = found(|x, y| field.normal(x, y) * if x > 107 && y < 64 { 5.0 } else { 1.0 });
        assert!(of("block_0_2") > 0.7 && of("block_1_0") < -0.5);
        // Strength that varies from place to place shows in flat tails and in the modulus at coarse levels.
        let even = found(|x, y| field.normal(x, y));
        assert!(of("increment_x_1_flatness") > even("increment_x_1_flatness") + 0.3);
        let of = found(|x, y| field.normal(x, y) * if (x / 8 + y / 8) % 2 == 0 { 4.0 } else { 1.0 });
        assert!(of("cascade_1_4") > even("cascade_1_4") + 0.5);
    }

    #[test]
    fn details_are_uneven_where_strong_and_weak_places_alternate_and_gaps_have_no_say() {
        let random = Key([7; 32]).field();
        let field = |of: &dyn Fn(usize, usize) -> f64| -> Vec<f32> {
            let value = |(x, y): (usize, usize)| of(x, y) * random.normal(x as i32, y as i32);
            (0..96 * 160).map(|i| value((i % 160, i / 160)) as f32).collect()
        };
        let of = |field: &[f32]| levels(field, 160, 3);
        let even = field(&|_, _| 1.0);
        let bursts = field(&|x, y| if (x / 2 + y / 2).is_multiple_of(2) { 4.0 } else { 1.0 });
        let gappy: Vec<f32> = even.iter().enumerate().map(|(i, z)| if i % 160 < 40 { f32::NAN } else { *z }).collect();
        let (even, bursts, gappy) = (of(&even), of(&bursts), of(&gappy));
        let raised = |k: usize| bursts[0].unevenness[k] - even[0].unevenness[k];
        assert!(raised(0) > 0.5 && raised(2) > 0.5 && raised(3) > 0.1, "{even:?} {bursts:?}");
        let all = |level: &LevelFigures| level.log_rms.into_iter().chain(level.unevenness).collect::<Vec<f64>>();
        for (even, gappy) in even.iter().zip(&gappy) {
            assert!(all(even).iter().zip(all(gappy)).all(|(a, b)| (a - b).abs() < 0.25), "{even:?} {gappy:?}");
        }
        // The modulus of three equal normal details has the mean square 3 and the variance 3 - 8 / pi, of which its details have three quarters.
        let normal = 0.5 * log(1.0 - 8.0 / (3.0 * std::f64::consts::PI));
        let [x, _, _, cascade, _] = even[0].unevenness;
        assert!((cascade - normal).abs() < 0.05 && (x - log(3.0)).abs() < 0.1, "{even:?} {normal}");
        assert!(even[0].log_rms.iter().all(|log_rms| log_rms.abs() < 0.03));
        assert!(of(&vec![f32::NAN; 96 * 160]).iter().flat_map(all).all(f64::is_nan));
        // A raster that is too small for a level has no figure there.
        assert!(all(&levels(&[1.0, 2.0, 3.0, 5.0].repeat(16), 8, 4)[3]).iter().all(|figure| figure.is_nan()));
    }

    #[test]
    fn missing_cells_take_no_part_and_a_constant_raster_is_refused() {
        let field = Key([3; 32]).field();
        let of = found(|x, y| if (7 * x + 3 * y) % 31 == 0 { f64::NAN } else { field.normal(x, y) });
        assert!(of("increment_down_1_rms").is_finite() && of("haar_y_1_rms").abs() < 0.05);
        let error = structure(&[0.5; 64 * 64], 64, &settings()).unwrap_err().message;
        assert!(error.contains("are all 0 or missing"), "{error}");
    }
}
