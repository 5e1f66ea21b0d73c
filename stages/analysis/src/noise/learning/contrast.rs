//! The contrast with which details of draws of a model are as uneven, and as strong in each direction, as those of the rasters.

use nalgebra::{SMatrix, SVector};
use rayon::prelude::*;

use crate::noise::structure;
use rockface_core::artefact::{Contrast, LevelContrast, LevelFigures, UNEVENNESS};

/// Smallest and largest power of details.
const POWERS: [f64; 2] = [-1.0, 1.5];
/// The power that is tried first, of details by themselves, then of those near them and then of those farther around too.
const FIRST_TRIAL: f64 = 0.25;
/// Rounds after the first trials (Broyden 1965).
const ROUNDS: usize = 3;
/// Largest change of a power in one round.
const MOST_STEP: f64 = 0.6;
/// Sweeps over the powers in which their changes are found.
const SWEEPS: usize = 5000;
/// Deviations over rasters by which the unevenness may miss what is wanted to spare a power of 1: smaller ones are chance.
const WORTH: f64 = 1.0;
/// Smallest deviation of a figure over rasters that counts.
const LEAST_DEVIATION: f64 = 0.003;
/// Largest logarithm of a gain.
const MOST_LOG_GAIN: f64 = 0.5;
/// Part of a departure of the strength of details that a round takes off: levels and orientations overlap.
const GAIN_STEP: f64 = 0.8;

type Square = SMatrix<f64, UNEVENNESS, UNEVENNESS>;
type Figure = SVector<f64, UNEVENNESS>;

/// Mean figures of the details of rasters, level by level, and the deviations of the unevenness from raster to raster.
#[derive(Debug, Clone)]
pub struct Figures {
    /// The means; NaN where no raster has details.
    pub mean: Vec<LevelFigures>,
    /// The deviations.
    pub deviation: Vec<[f64; UNEVENNESS]>,
}

impl Figures {
    /// Figures of rasters with NaN in gaps.
    pub fn of(rasters: &[&[f32]], columns: usize) -> Self {
        let count = Contrast::none().levels.len();
        let all: Vec<Vec<LevelFigures>> =
            rasters.par_iter().map(|raster| structure::levels(raster, columns, count)).collect();
        let mean_of = |figure: &dyn Fn(&[LevelFigures]) -> f64| {
            let known: Vec<f64> = all.iter().map(|levels| figure(levels)).filter(|value| value.is_finite()).collect();
            let mean = known.iter().sum::<f64>() / known.len() as f64;
            let squares: f64 = known.iter().map(|value| (value - mean) * (value - mean)).sum();
            (mean, (squares / (known.len() as f64 - 1.0).max(1.0)).sqrt().max(LEAST_DEVIATION))
        };
        let one = |level: usize| {
            let log_rms = std::array::from_fn(|k| mean_of(&|levels| levels[level].log_rms[k]).0);
            let both: [(f64, f64); UNEVENNESS] =
                std::array::from_fn(|k| mean_of(&|levels| levels[level].unevenness[k]));
            (LevelFigures { log_rms, unevenness: both.map(|both| both.0) }, both.map(|both| both.1))
        };
        let (mean, deviation) = (0..count).map(one).unzip();
        Self { mean, deviation }
    }
}

/// Makes up for what a survey loses of the unevenness and of the strength of details, level by level.
pub fn make_up(contrast: &mut Contrast, lost: impl Fn(usize) -> LevelFigures) {
    for (k, level) in contrast.levels.iter_mut().enumerate() {
        let LevelFigures { log_rms, unevenness } = lost(k);
        raise(level, unevenness);
        gain(level, log_rms);
    }
}

/// The contrast, level by level, whose draws came nearest to what is wanted, of some that were tried.
#[derive(Debug, Default)]
pub struct Nearest(Vec<(f64, LevelContrast)>);

impl Nearest {
    /// Takes the levels of a contrast that came nearer than those before, with the figures of its draws.
    pub fn take(&mut self, contrast: &Contrast, wanted: &Figures, found: &[LevelFigures]) {
        for (k, level) in contrast.levels.iter().enumerate() {
            let missed = missed(&found[k], &wanted.mean[k], &wanted.deviation[k]);
            if self.0.len() == k {
                self.0.push((f64::INFINITY, level.clone()));
            }
            if missed < self.0[k].0 {
                self.0[k] = (missed, LevelContrast { drawn: found[k], ..level.clone() });
            }
        }
    }

    /// The contrast of these levels.
    pub fn contrast(self) -> Contrast {
        Contrast { levels: self.0.into_iter().map(|(_, level)| level).collect(), ..Contrast::none() }
    }
}

/// Takes off what draws with a contrast still miss of the figures that are wanted.
pub fn refine(contrast: &mut Contrast, wanted: &Figures, found: &[LevelFigures]) {
    make_up(contrast, |level| lacking(&found[level], &wanted.mean[level]));
}

/// The same power of details by themselves at all levels.
pub fn even(own_power: f64) -> Contrast {
    let mut contrast = Contrast::none();
    contrast.levels.iter_mut().for_each(|level| level.own_power = [own_power; 3]);
    contrast
}

/// Raises the powers of a level so that its unevenness grows by `wanted`, by least squares within the bounds of the powers; not at all where its growth is
/// not known. Several sets of powers give nearly the same unevenness: the smallest is chosen (ridge regression), since what is left open would
/// wander from round to round.
fn raise(level: &mut LevelContrast, wanted: [f64; UNEVENNESS]) {
    if matrix(&level.growth) == Square::zeros() {
        return;
    }
    let per_deviation =
        Square::from_diagonal(&Figure::from(level.deviation.map(|deviation| 1.0 / deviation.max(LEAST_DEVIATION))));
    let growth = per_deviation * matrix(&level.growth);
    let normal = growth.transpose() * growth + Square::identity() * (WORTH * WORTH);
    let now = powers(level);
    let right = growth.transpose() * per_deviation * Figure::from(wanted) - now * (WORTH * WORTH);
    let step = bounded(&normal, &right, |k| {
        [(POWERS[0] - now[k]).clamp(-MOST_STEP, 0.0), (POWERS[1] - now[k]).clamp(0.0, MOST_STEP)]
    });
    if step.iter().all(|change| change.is_finite()) {
        let powers = level.own_power.iter_mut().chain(&mut level.local_power);
        powers.zip(step.iter()).for_each(|(power, change)| *power += change);
    }
}

/// The least value of `x' normal x / 2 - right' x` within bounds, by one coordinate after the other (Gauss and Seidel).
fn bounded(normal: &Square, right: &Figure, bounds: impl Fn(usize) -> [f64; 2]) -> Figure {
    let mut x = Figure::zeros();
    for _ in 0..SWEEPS {
        for k in 0..UNEVENNESS {
            let rest = (normal.row(k) * x)[0] - normal[(k, k)] * x[k];
            let [least, most] = bounds(k);
            x[k] = ((right[k] - rest) / normal[(k, k)]).clamp(least, most);
        }
    }
    x
}

fn matrix(growth: &[[f64; UNEVENNESS]; UNEVENNESS]) -> Square {
    Square::from_fn(|row, column| growth[row][column])
}

fn powers(level: &LevelContrast) -> Figure {
    Figure::from_iterator(level.own_power.into_iter().chain(level.local_power))
}

/// The contrast for which `trial` comes to the figures that are wanted, all levels at once. Differences small beside the deviation from raster to
/// raster change little.
pub fn fitted(wanted: &Figures, mut trial: impl FnMut(&Contrast) -> Vec<LevelFigures>) -> Contrast {
    let none = trial(&Contrast::none());
    let mut now = even(FIRST_TRIAL);
    let gains = now.levels.iter_mut().zip(&none).zip(&wanted.mean);
    gains.for_each(|((level, none), wanted)| gain(level, lacking(none, wanted).log_rms));
    let own = trial(&now);
    now.levels.iter_mut().for_each(|level| level.local_power[0] = FIRST_TRIAL);
    let near = trial(&now);
    now.levels.iter_mut().for_each(|level| level.local_power[1] = FIRST_TRIAL);
    let mut found = trial(&now);
    for (k, level) in now.levels.iter_mut().enumerate() {
        let slope = |from: &[LevelFigures], to: &[LevelFigures], figure: usize| {
            (to[k].unevenness[figure] - from[k].unevenness[figure]) / FIRST_TRIAL
        };
        // Each orientation has its own flatness, and they share the cascades.
        for figure in 0..3 {
            level.growth[figure][figure] = slope(&none, &own, figure);
            (3..UNEVENNESS).for_each(|cascade| level.growth[cascade][figure] = slope(&none, &own, cascade) / 3.0);
        }
        for figure in 0..UNEVENNESS {
            level.growth[figure][3] = slope(&own, &near, figure);
            level.growth[figure][4] = slope(&near, &found, figure);
        }
        level.usual = wanted.mean[k];
        level.deviation = wanted.deviation[k];
    }
    let mut nearest = Nearest::default();
    for _ in 0..ROUNDS {
        let mut next = now.clone();
        refine(&mut next, wanted, &found);
        let came = trial(&next);
        for (k, level) in next.levels.iter_mut().enumerate() {
            let grown = Figure::from_fn(|i, _| came[k].unevenness[i] - found[k].unevenness[i]);
            level.growth = corrected(&level.growth, powers(level) - powers(&now.levels[k]), grown);
        }
        nearest.take(&next, wanted, &came);
        (now, found) = (next, came);
    }
    // Few draws say little: of the rounds the one counts that came nearest, and none of them where details were as uneven before.
    for (k, (level, (least, nearest))) in now.levels.iter_mut().zip(nearest.0).enumerate() {
        let LevelContrast { log_gain, growth, usual, deviation, .. } = nearest;
        let without = missed(&none[k], &wanted.mean[k], &wanted.deviation[k]);
        *level = if without < least {
            LevelContrast { log_gain, growth, usual, drawn: none[k], deviation, ..LevelContrast::default() }
        } else {
            nearest
        };
        // Where nothing is known of the details there is no contrast to fit.
        let known = level.growth.iter().flatten().chain(&level.log_gain).copied();
        if !known.chain(wanted.mean[k].all()).chain(level.drawn.all()).all(f64::is_finite) {
            *level = LevelContrast::default();
        }
    }
    now
}

/// Mean square of what the unevenness misses, in deviations over rasters; the cascades count as much as the three orientations.
fn missed(found: &LevelFigures, wanted: &LevelFigures, deviation: &[f64; UNEVENNESS]) -> f64 {
    let squared = |k: usize| {
        let miss = (found.unevenness[k] - wanted.unevenness[k]) / deviation[k];
        miss * miss
    };
    (squared(0) + squared(1) + squared(2)) / 3.0 + 0.5 * (squared(3) + squared(4))
}

/// What figures lack of those that are wanted.
pub fn lacking(found: &LevelFigures, wanted: &LevelFigures) -> LevelFigures {
    LevelFigures {
        log_rms: std::array::from_fn(|k| wanted.log_rms[k] - found.log_rms[k]),
        unevenness: std::array::from_fn(|k| wanted.unevenness[k] - found.unevenness[k]),
    }
}

/// Changes the gains of a level by what its details are too weak.
fn gain(level: &mut LevelContrast, lacking: [f64; 3]) {
    for (gain, lacking) in level.log_gain.iter_mut().zip(lacking) {
        if lacking.is_finite() {
            *gain = (*gain + GAIN_STEP * lacking).clamp(-MOST_LOG_GAIN, MOST_LOG_GAIN);
        }
    }
}

/// The growth that agrees with what a step made of the unevenness, and is otherwise as it was.
fn corrected(growth: &[[f64; UNEVENNESS]; UNEVENNESS], step: Figure, grown: Figure) -> [[f64; UNEVENNESS]; UNEVENNESS] {
    let length = step.norm_squared();
    if length < 1e-4 {
        return *growth;
    }
    let known = matrix(growth);
    let better = known + (grown - known * step) * step.transpose() / length;
    std::array::from_fn(|row| std::array::from_fn(|column| better[(row, column)]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const DEVIATION: [f64; UNEVENNESS] = [0.16, 0.2, 0.16, 0.012, 0.015];

    /// Unevenness that grows more slowly with more contrast, and strengths that follow their gains.
    fn law(contrast: &Contrast) -> Vec<LevelFigures> {
        let bent = |x: f64| x / (1.0 + 0.2 * x);
        let one = |level: &LevelContrast| {
            let own = level.own_power.map(bent);
            let [near, far] = level.local_power.map(bent);
            let [x, y, diagonal] = own.map(|own| 2.0 * own + 0.8 * near + 0.6 * far + 1.2);
            let log_rms = std::array::from_fn(|k| 0.9 * level.log_gain[k] + [0.05, -0.03, 0.0][k]);
            let own = 0.05 * own.iter().sum::<f64>() - 0.7;
            let cascades = [own + 0.25 * near + 0.05 * far, own + 0.1 * near + 0.3 * far];
            LevelFigures { log_rms, unevenness: [x, y, diagonal, cascades[0], cascades[1]] }
        };
        contrast.levels.iter().map(one).collect()
    }

    fn fitted_to(mean: Vec<LevelFigures>, deviation: [f64; UNEVENNESS]) -> Contrast {
        let deviation = vec![deviation; mean.len()];
        fitted(&Figures { mean, deviation }, law)
    }

    #[test]
    fn powers_are_found_where_the_unevenness_grows_with_them() {
        let mut truth = Contrast::none();
        let powers = [
            ([0.4, 0.2, 0.3], [0.1, 0.3]),
            ([0.0; 3], [0.3, 0.0]),
            ([-0.1, 0.1, 0.0], [0.4, 0.2]),
            ([0.5; 3], [0.5, 0.1]),
        ];
        for (level, (own_power, local_power)) in truth.levels.iter_mut().zip(powers) {
            *level =
                LevelContrast { own_power, local_power, log_gain: [-0.05, 0.03, 0.02], ..LevelContrast::default() };
        }
        let wanted = law(&truth);
        for (found, wanted) in law(&fitted_to(wanted.clone(), DEVIATION)).iter().zip(&wanted) {
            let missed = |k: usize| (found.unevenness[k] - wanted.unevenness[k]) / DEVIATION[k];
            assert!((0..UNEVENNESS).all(|k| missed(k).abs() < 0.5), "{found:?} {wanted:?}");
            assert!((0..3).all(|k| (found.log_rms[k] - wanted.log_rms[k]).abs() < 0.003), "{found:?} {wanted:?}");
        }
        let unknown = LevelFigures { log_rms: [f64::NAN; 3], unevenness: [f64::NAN; UNEVENNESS] };
        assert!(fitted_to(vec![unknown; truth.levels.len()], DEVIATION) == Contrast::none());
        // Noise that is far too even gets the most that the rounds can give.
        let uneven = LevelFigures { log_rms: [0.0; 3], unevenness: [90.0, 90.0, 90.0, 10.0, 10.0] };
        let most = fitted_to(vec![uneven; truth.levels.len()], DEVIATION).levels[0].clone();
        let reached = (FIRST_TRIAL + ROUNDS as f64 * MOST_STEP).min(POWERS[1]) - 1e-9;
        assert!(most.own_power[1] >= reached && most.local_power.iter().all(|power| *power >= reached), "{most:?}");
        // What rasters differ by a hundred times is not made up for.
        let loose = fitted_to(wanted, DEVIATION.map(|deviation| 100.0 * deviation));
        assert!(loose.levels.iter().all(|level| powers_near(level, 0.05)), "{loose:?}");
    }

    fn powers_near(level: &LevelContrast, most: f64) -> bool {
        powers(level).iter().all(|power| power.abs() < most)
    }

    #[test]
    #[allow(clippy::float_cmp)] // to the bit
    fn a_power_at_its_bound_leaves_the_rest_to_the_others() {
        let mut level = LevelContrast { deviation: DEVIATION, ..LevelContrast::default() };
        level.local_power[1] = POWERS[0];
        (level.growth[0][0], level.growth[0][4]) = (2.0, 6.0);
        let mut contrast = Contrast { levels: vec![level], ..Contrast::none() };
        let wanted = LevelFigures { unevenness: [-0.8, 0.0, 0.0, 0.0, 0.0], ..LevelFigures::default() };
        make_up(&mut contrast, |_| wanted);
        let LevelContrast { own_power, local_power, .. } = &contrast.levels[0];
        assert!((own_power[0] + 0.4).abs() < 0.01 && local_power[1] == POWERS[0], "{own_power:?} {local_power:?}");
        // What they can reach together they do: the one that takes more of it for each step more than the other.
        contrast.levels[0].own_power[0] = 0.0;
        contrast.levels[0].local_power[1] = 0.0;
        make_up(&mut contrast, |_| wanted);
        let LevelContrast { own_power, local_power, .. } = &contrast.levels[0];
        assert!((2.0 * own_power[0] + 6.0 * local_power[1] + 0.8).abs() < 0.01 && local_power[1] < own_power[0]);
    }

    #[test]
    fn of_rounds_the_nearest_counts_level_by_level() {
        let wanted = Figures { mean: law(&even(0.3)), deviation: vec![DEVIATION; Contrast::none().levels.len()] };
        let (mut near, mut far) = (even(0.35), even(0.6));
        std::mem::swap(&mut near.levels[2], &mut far.levels[2]);
        let mut nearest = Nearest::default();
        for contrast in [&far, &near, &even(0.9)] {
            nearest.take(contrast, &wanted, &law(contrast));
        }
        let found = nearest.contrast();
        assert!(found.levels.iter().all(|level| powers_near(level, 0.36)), "{found:?}");
        assert_eq!(found.levels[2].drawn, law(&even(0.35))[2]);
    }

    #[test]
    fn what_a_survey_loses_is_made_up_for_where_its_growth_is_known() {
        let mut contrast = fitted_to(law(&even(0.3)), DEVIATION);
        let before = law(&contrast);
        contrast.levels[1].growth = [[0.0; UNEVENNESS]; UNEVENNESS];
        let lost = [0.2, 0.2, 0.2, 0.03, 0.03];
        make_up(&mut contrast, |_| LevelFigures { log_rms: [0.0; 3], unevenness: lost });
        let after = law(&contrast);
        let grown = |k: usize| after[0].unevenness[k] - before[0].unevenness[k];
        assert!(
            (0..UNEVENNESS).all(|k| (grown(k) - lost[k]).abs() < 0.5 * DEVIATION[k]),
            "{:?}",
            [0, 1, 2, 3, 4].map(grown)
        );
        assert!(after[1] == before[1]);
    }
}
