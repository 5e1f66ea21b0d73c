//! Learns how noise without fields differs from place to place: a spectrum for quiet, middling and noisy places, and what a lateral shift of the face
//! makes at its edges.

use rayon::prelude::*;

use crate::noise::learning::departure::Mean;
use crate::noise::learning::relief_law;
use crate::noise::learning::whitening::{BANDS, CLASSES, Places, Whitened};
use rockface_core::artefact::{GAP, LateralShift, Parametric, PlaceSpectrum};
use rockface_core::numerics::bands::Bands;
use rockface_core::numerics::portable_math::log;
use rockface_core::numerics::quantile::median;
use rockface_core::numerics::random::Key;
use rockface_imaging::matching::noise::changed_face::slopes;
use rockface_imaging::matching::noise::parametric::{Edges, Ground, drawn_size, field, level_part, white};

/// Classes of place that have a spectrum in common.
const CLASSES_TOGETHER: usize = 2;
/// Lags at which edges show, cells.
const LAGS: [usize; 4] = [1, 2, 4, 8];
/// Deviations of the shift that are tried, cells.
const DEVIATIONS_CELLS: [f64; 3] = [0.5, 1.0, 2.0];
/// Correlation lengths of the shift along and across edges that are tried, cells.
const LENGTHS_CELLS: [[f64; 2]; 6] = [[2.0, 1.0], [4.0, 1.0], [8.0, 1.0], [4.0, 2.0], [8.0, 2.0], [16.0, 2.0]];
/// Fields of a trial.
const TRIAL_FIELDS: usize = 6;
/// Rounds in which spectra are fitted to those of the rasters.
const ROUNDS: usize = 3;
/// Least part of the misfit of edges, in squared standard errors, that a shift must explain.
const LEAST_GAIN: f64 = 9.0;
/// Fewest cells whose edges run one way that count.
const FEWEST_CELLS: usize = 200;
/// Waves that the mean spectrum of all places is worth in that of a group.
const PRIOR_WAVES: f64 = 20.0;
/// Fall of the filter that looks at one band, a band away, as a logarithm.
const FALL: f64 = 2.0;

/// Learns it from the usual rasters. `stream` gives random numbers for trials.
pub fn learnt(
    usual: &[&Whitened],
    places: &Places,
    elevation: &[f32],
    columns: usize,
    stream: &(impl Fn(&str, &str) -> Key + Sync),
) -> Parametric {
    let face = Face::new(places, elevation, columns);
    let shift = face.shift(usual, stream);
    let trial = |spectra: Vec<PlaceSpectrum>| Parametric { spectra, shift };
    let wanted = face.log_powers_wanted(usual);
    let all = |band: usize| usual.iter().map(|raster| raster.log_amplitude[band]).sum::<f64>() / usual.len() as f64;
    let amplitudes: Vec<f64> = (0..BANDS).map(all).collect();
    let spectrum = |strength: &f64| PlaceSpectrum { log_strength: *strength, log_amplitude: amplitudes.clone() };
    let mut spectra: Vec<PlaceSpectrum> = face.log_strengths.iter().map(spectrum).collect();
    for _ in 0..ROUNDS {
        let found = face.log_powers_drawn(&trial(spectra.clone()), stream);
        for ((spectrum, wanted), found) in spectra.iter_mut().zip(&wanted).zip(found) {
            let missing = wanted.iter().zip(found).map(|(wanted, found)| 0.5 * (wanted - found));
            spectrum.log_amplitude.iter_mut().zip(missing).for_each(|(log, missing)| *log += missing);
        }
    }
    trial(spectra)
}

/// A face on which noise is looked at from place to place.
struct Face<'a> {
    places: &'a Places,
    elevation: &'a [f32],
    columns: usize,
    /// Group of each cell.
    group: Vec<u8>,
    /// Logarithm of the middle strength of each group.
    log_strengths: Vec<f64>,
    /// Whether a cell falls away up or down more than to the sides, so that edges run to the sides.
    level_edge: Vec<bool>,
}

impl<'a> Face<'a> {
    fn new(places: &'a Places, elevation: &'a [f32], columns: usize) -> Self {
        let together = |class: &u8| usize::from(*class) / CLASSES_TOGETHER;
        let middle = |of: usize| {
            let cells = places.strength.iter().zip(&places.class).filter(|(_, class)| together(class) == of);
            median(&mut cells.map(|(strength, _)| log(f64::from(*strength))).collect::<Vec<_>>())
        };
        let middles: Vec<Option<f64>> = (0..CLASSES / CLASSES_TOGETHER).map(middle).collect();
        // Where all places are alike some groups have no cell: they are left out.
        let number = |of: usize| middles[..of].iter().flatten().count() as u8;
        let group = places.class.iter().map(|class| number(together(class))).collect();
        let log_strengths = middles.iter().flatten().copied().collect();
        let level_edge = slopes(elevation, columns).iter().map(|[right, down]| down.abs() > right.abs()).collect();
        Self { places, elevation, columns, group, log_strengths, level_edge }
    }

    fn groups(&self) -> usize {
        self.log_strengths.len()
    }

    fn rows(&self) -> usize {
        self.elevation.len() / self.columns
    }

    /// The shift that explains how much farther noise is correlated along edges than across them; none where too little is explained.
    fn shift(&self, usual: &[&Whitened], stream: &(impl Fn(&str, &str) -> Key + Sync)) -> Option<LateralShift> {
        let real = |raster: &&Whitened| {
            let known = |cell: usize| raster.weights[cell] & GAP == 0;
            self.along_less_across(&|cell| f64::from(raster.field[cell]), &known)
        };
        let real: Vec<Vec<f64>> = usual.par_iter().map(real).collect();
        let real: Vec<Mean> = (0..self.groups() * LAGS.len()).map(|k| Mean::of(&real, k)).collect();
        let tried = DEVIATIONS_CELLS.into_iter().filter_map(|deviation_cells| self.edges(deviation_cells));
        let tried = tried.flat_map(|edges| LENGTHS_CELLS.map(|lengths| self.trial(&real, &edges, lengths, stream)));
        let best = tried.flatten().max_by(|a, b| a.0.total_cmp(&b.0));
        best.filter(|(gain, _)| *gain > LEAST_GAIN).map(|(_, shift)| shift)
    }

    /// What shifts of some deviation make of the face, where all of the noise is theirs; none where its strength does not grow with them.
    fn edges(&self, deviation_cells: f64) -> Option<Edges> {
        let any = LateralShift { deviation_cells, length_cells: 1.0, across_cells: 1.0, share: 1.0, half_m: 1.0 };
        let edges = Edges::new(any, self.elevation, self.columns);
        let law = relief_law::fit(&self.places.strength, &edges.deviations_m().collect::<Vec<_>>(), 1);
        let half_m = law.flat_px / law.gain_px_m;
        (law.gain_px_m > 0.0).then(|| edges.with(LateralShift { half_m, ..any }))
    }

    /// How much of the misfit a shift explains with the share that fits best, squared standard errors.
    fn trial(
        &self,
        real: &[Mean],
        edges: &Edges,
        [length_cells, across_cells]: [f64; 2],
        stream: &(impl Fn(&str, &str) -> Key + Sync),
    ) -> Option<(f64, LateralShift)> {
        let shift = LateralShift { length_cells, across_cells, ..edges.shift };
        let edges = edges.with(shift);
        let one = |number: usize| {
            let keys = |purpose: &str, item: &str| stream(purpose, &format!("edges/{number}/{item}"));
            let field = edges.field([self.columns, self.rows()], &keys);
            self.along_less_across(&|cell| field[cell][0] * field[cell][1].sqrt(), &|_| true)
        };
        let made: Vec<Vec<f64>> = (0..TRIAL_FIELDS).into_par_iter().map(one).collect();
        let made = |k: usize| made.iter().map(|row| row[k]).sum::<f64>() / made.len() as f64;
        let (mut both, mut squares) = (0.0, 0.0);
        for (k, real) in real.iter().enumerate().filter(|(_, real)| real.squared_error > 0.0) {
            both += real.value * made(k) / real.squared_error;
            squares += made(k) * made(k) / real.squared_error;
        }
        let share = (both / squares).min(1.0);
        (share > 0.0).then_some((share * (2.0 * both - share * squares), LateralShift { share, ..shift }))
    }

    /// Mean products of whitened noise along edges less those across them, group by group and lag by lag. Edges to the sides and upright ones count
    /// the same, so that noise which is longer along the lines of a matcher is no edge.
    fn along_less_across(&self, value: &dyn Fn(usize) -> f64, known: &dyn Fn(usize) -> bool) -> Vec<f64> {
        let mut found = vec![0.0; self.groups() * LAGS.len()];
        for (k, lag) in LAGS.into_iter().enumerate() {
            let mut sums = vec![[[0.0f64; 2]; 2]; self.groups()];
            for row in 0..self.rows().saturating_sub(lag) {
                for column in 0..self.columns.saturating_sub(lag) {
                    let cell = row * self.columns + column;
                    let (right, down) = (cell + lag, cell + lag * self.columns);
                    if !(known(cell) && known(right) && known(down)) {
                        continue;
                    }
                    let sum = &mut sums[usize::from(self.group[cell])][usize::from(self.level_edge[cell])];
                    let difference = value(cell) * (value(right) - value(down));
                    sum[0] += if self.level_edge[cell] { difference } else { -difference };
                    sum[1] += 1.0;
                }
            }
            for (group, sums) in sums.iter().enumerate() {
                let ways = sums.iter().filter(|[_, count]| *count >= FEWEST_CELLS as f64);
                let (sum, count) = ways.fold((0.0, 0.0), |(sum, n), [of, count]| (sum + of / count, n + 1.0));
                found[group * LAGS.len() + k] = if count > 0.0 { sum / count } else { 0.0 };
            }
        }
        found
    }

    /// Logarithm of the power of each band in each group over the rasters; where few waves of a band fit into a group, nearly that of all places.
    fn log_powers_wanted(&self, usual: &[&Whitened]) -> Vec<Vec<f64>> {
        let bands = Bands::new(self.columns, self.rows(), BANDS);
        let one = |raster: &&Whitened| {
            let values: Vec<f64> = raster.field.iter().map(|value| f64::from(*value)).collect();
            self.powers(&bands, &values, &|cell| raster.weights[cell] & GAP == 0)
        };
        let powers = self.mean(&usual.par_iter().map(one).collect::<Vec<_>>());
        let shares = bands.shares();
        let cells = |group: usize| self.group.iter().filter(|of| usize::from(**of) == group).count() as f64;
        let counts: Vec<f64> = (0..self.groups()).map(cells).collect();
        let all = |band: usize| {
            let sum = powers.iter().zip(&counts).map(|(power, cells)| power[band] * cells).sum::<f64>();
            log((sum / counts.iter().sum::<f64>()).max(1e-12))
        };
        let wanted = |group: usize, band: usize| {
            let waves = usual.len() as f64 * counts[group] * shares[band];
            let own = log(powers[group][band].max(1e-12)) - all(band);
            all(band) + own * waves / (waves + PRIOR_WAVES)
        };
        (0..self.groups()).map(|group| (0..BANDS).map(|band| wanted(group, band)).collect()).collect()
    }

    /// The same of fields that are drawn.
    fn log_powers_drawn(&self, parametric: &Parametric, stream: &(impl Fn(&str, &str) -> Key + Sync)) -> Vec<Vec<f64>> {
        let own = [self.columns, self.rows()];
        let size = drawn_size(own);
        let bands = Bands::new(own[0], own[1], BANDS);
        let ground = Ground::new(parametric, &self.places.strength, self.elevation, self.columns);
        let one = |number: usize| {
            let keys = |purpose: &str, item: &str| stream(purpose, &format!("spectra/{number}/{item}"));
            let white = white(size, &keys("noise-white", "").field());
            let values = level_part(&field(parametric, &ground, &white, size, own, &keys), own);
            self.powers(&bands, &values, &|_| true)
        };
        let powers = self.mean(&(0..TRIAL_FIELDS).into_par_iter().map(one).collect::<Vec<_>>());
        powers.into_iter().map(|of| of.into_iter().map(|power| log(power.max(1e-12))).collect()).collect()
    }

    /// Mean square of a field in each group, band by band.
    fn powers(&self, bands: &Bands, values: &[f64], known: &dyn Fn(usize) -> bool) -> Vec<Vec<f64>> {
        let mut powers = vec![vec![0.0; BANDS]; self.groups()];
        let spectrum = bands.spectrum(values);
        for band in 0..BANDS {
            let gain: Vec<f64> = (0..BANDS).map(|other| -FALL * (other as f64 - band as f64).abs()).collect();
            let mut sums = vec![[0.0f64; 2]; self.groups()];
            for (cell, value) in spectrum.clone().filtered(&gain).iter().enumerate().filter(|(i, _)| known(*i)) {
                let sum = &mut sums[usize::from(self.group[cell])];
                (sum[0], sum[1]) = (sum[0] + value * value, sum[1] + 1.0);
            }
            for (power, [sum, count]) in powers.iter_mut().zip(sums) {
                power[band] = sum / count.max(1.0);
            }
        }
        powers
    }

    fn mean(&self, all: &[Vec<Vec<f64>>]) -> Vec<Vec<f64>> {
        let of = |group: usize, band: usize| all.iter().map(|of| of[group][band]).sum::<f64>() / all.len() as f64;
        (0..self.groups()).map(|group| (0..BANDS).map(|band| of(group, band)).collect()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::noise::learning::whitening::whiten;

    const COLUMNS: usize = 160;
    const ROWS: usize = 120;

    fn keys(seed: u8) -> impl Fn(&str, &str) -> Key + Sync {
        move |purpose, item| {
            let mut key = [seed; 32];
            key[0] = purpose.len() as u8;
            item.bytes().enumerate().for_each(|(i, byte)| key[1 + i % 31] ^= byte.wrapping_add(i as u8));
            Key(key)
        }
    }

    /// Level and upright edges of half a metre, each drawn out over some cells.
    fn steps() -> Vec<f32> {
        let edge = |at: f64, middle: f64| ((at - middle) / 6.0).clamp(-0.5, 0.5);
        let height = |i: usize| {
            let (column, row) = ((i % COLUMNS) as f64 + 0.5, (i / COLUMNS) as f64 + 0.5);
            let level = [15.0, 40.0, 65.0].map(|middle| edge(row, middle)).iter().sum::<f64>();
            level + [30.0, 80.0, 130.0].map(|middle| edge(column, middle)).iter().sum::<f64>()
        };
        (0..COLUMNS * ROWS).map(|i| height(i) as f32).collect()
    }

    /// Whitened rasters of a parametric model on a face, whose noise is four times as strong at edges.
    fn rasters(truth: &Parametric, elevation: &[f32]) -> (Vec<Whitened>, Places) {
        let edges = Edges::new(truth.shift.unwrap_or(USUAL), elevation, COLUMNS);
        let strength: Vec<f32> = edges
            .deviations_m()
            .map(|m| (0.01 + 16.0 * m * m / (USUAL.half_m * USUAL.half_m) * 0.01).sqrt() as f32)
            .collect();
        let ground = Ground::new(truth, &strength, elevation, COLUMNS);
        let (own, size) = ([COLUMNS, ROWS], drawn_size([COLUMNS, ROWS]));
        let raster = |seed: u8| -> Vec<f32> {
            let white = white(size, &Key([seed; 32]).field());
            let wide = field(truth, &ground, &white, size, own, &keys(seed));
            let part = wide.chunks_exact(size[0]).take(ROWS).flat_map(|row| &row[..COLUMNS]);
            part.zip(&strength).map(|(value, strength)| *value as f32 * strength).collect()
        };
        let rasters: Vec<Vec<f32>> = (1..9).map(raster).collect();
        let places = Places::of(strength.clone());
        (whiten(&rasters, COLUMNS, &places), places)
    }

    const USUAL: LateralShift =
        LateralShift { deviation_cells: 1.0, length_cells: 8.0, across_cells: 2.0, share: 0.8, half_m: 0.03 };

    /// Spectra that fall towards fine noise, more steeply where noise is weak.
    fn spectra() -> Vec<PlaceSpectrum> {
        let one = |(log_strength, fall): (f64, f64)| PlaceSpectrum {
            log_strength,
            log_amplitude: (0..BANDS).map(|band| -fall * band as f64).collect(),
        };
        [(-2.3, 0.25), (-2.0, 0.2), (-0.8, 0.05)].map(one).into()
    }

    #[test]
    fn a_shift_that_rasters_have_is_found_and_none_where_they_have_none() {
        let elevation = steps();
        let learnt_from = |shift: Option<LateralShift>| {
            let (rasters, places) = rasters(&Parametric { spectra: spectra(), shift }, &elevation);
            learnt(&rasters.iter().collect::<Vec<_>>(), &places, &elevation, COLUMNS, &keys(77))
        };
        let found = learnt_from(Some(USUAL)).shift.expect("edges that go along");
        assert!((4.0..=8.0).contains(&found.length_cells) && found.share > 0.3, "{found:?}");
        assert_eq!(learnt_from(None).shift, None);
    }

    #[test]
    fn where_all_places_are_alike_there_is_one_spectrum() {
        let elevation = vec![0.0; COLUMNS * ROWS];
        let truth = Parametric { spectra: spectra()[..1].into(), shift: None };
        let (rasters, places) = rasters(&truth, &elevation);
        let model = learnt(&rasters.iter().collect::<Vec<_>>(), &places, &elevation, COLUMNS, &keys(77));
        assert!(model.shift.is_none() && model.spectra.len() == 1, "{model:?}");
        let log_amplitude = &model.spectra[0].log_amplitude;
        let fall = (log_amplitude[5] - log_amplitude[11]) / 6.0;
        assert!((fall - 0.25).abs() < 0.06, "{log_amplitude:?}");
    }

    #[test]
    fn noise_that_is_drawn_is_as_fine_at_each_place_as_that_of_the_rasters() {
        let elevation = steps();
        let (rasters, places) = rasters(&Parametric { spectra: spectra(), shift: None }, &elevation);
        let usual: Vec<&Whitened> = rasters.iter().collect();
        let model = learnt(&usual, &places, &elevation, COLUMNS, &keys(78));
        let face = Face::new(&places, &elevation, COLUMNS);
        let (wanted, drawn) = (face.log_powers_wanted(&usual), face.log_powers_drawn(&model, &keys(79)));
        for (wanted, drawn) in wanted.iter().zip(&drawn) {
            for band in 4..BANDS {
                assert!((wanted[band] - drawn[band]).abs() < 0.5, "{band}: {wanted:?} {drawn:?}");
            }
        }
        let fine = |group: usize| wanted[group][BANDS - 2] - wanted[group][4];
        assert!(fine(2) > fine(0) + 1.0, "{wanted:?}");
    }
}
