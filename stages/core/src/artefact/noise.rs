//! A model of the matching noise of a site, learnt from rasters without change: what `match-pair` draws acquisitions from.

use super::{CodecError, Frame, Grid};
use crate::numerics::random::Field;
use crate::numerics::trend::{BENDS, Trend};

/// One acquisition the model knows: how strong and how coarse its noise is, and where its whitened field comes from.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Member {
    /// Name of the raster it is taken from.
    pub name: String,
    /// Whether it is a bad acquisition (motion blur, haze), which is drawn by a class of its own.
    pub bad: bool,
    /// The trend of its raster, which is what registration left and how orientations bend, without what follows from the asymmetry of its noise, metres.
    pub trend_m: Trend,
    /// Logarithm of the factor on the map of strength, for each class of place.
    pub log_strength: Vec<f64>,
    /// Logarithm of the amplitude of the whitened noise in each band of frequency; 0 is the amplitude of white noise.
    pub log_amplitude: Vec<f64>,
    /// The same of its whitened field as it is kept; 0 where the model has no fields.
    pub field_log_amplitude: Vec<f64>,
    /// Skewness of the difference.
    pub skewness: f64,
}

impl Member {
    /// Its strengths by class of place, then its amplitudes by band.
    pub fn figures(&self) -> impl Iterator<Item = f64> {
        self.log_strength.iter().chain(&self.log_amplitude).copied()
    }
}

/// How the strength of the noise depends on the relief of the face, for places whose geometry has changed:
/// `strength = sqrt(flat^2 + (gain relief)^2)`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReliefLaw {
    /// Strength where the face is flat, pixels of disparity in the full image.
    pub flat_px: f64,
    /// Growth of the strength with the relief, pixels for a metre.
    pub gain_px_m: f64,
    /// Half width of the window in which the deviation of the elevations is the relief, cells.
    pub window_cells: usize,
}

/// Contrast that the details of a mixture get back, since mixing evens them out. A pyramid of Gaussians takes the mixture apart into levels of details.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Contrast {
    /// Deviation of the Gaussian that takes the finest details away, cells; it doubles from level to level.
    pub finest_cells: f64,
    /// The levels, the finest first.
    pub levels: Vec<LevelContrast>,
}

/// Powers of details, and figures of their unevenness, of one level: those of the three orientations, and two for what is around.
pub const UNEVENNESS: usize = 5;

/// Contrast of the details of one level, along x, along y and diagonal: they are multiplied by powers of their own size and of the root mean square of
/// the details near them and within a farther distance.
#[derive(Debug, Clone, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LevelContrast {
    /// Power of their own size for each orientation: makes tails.
    pub own_power: [f64; 3],
    /// Powers of the strength of the details near and farther around, of all orientations: make small and larger strong and weak places.
    pub local_power: [f64; 2],
    /// Logarithm of a gain for each orientation, after the bands of frequency, which know no direction.
    pub log_gain: [f64; 3],
    /// How the flatness of the three orientations and the cascade to the next two levels (rows) grow with the three own powers and the two local ones
    /// (columns); 0: not known.
    pub growth: [[f64; UNEVENNESS]; UNEVENNESS],
    /// Mean figures of the rasters.
    pub usual: LevelFigures,
    /// Mean figures of draws of the model as it was learnt.
    pub drawn: LevelFigures,
    /// Deviation of the unevenness from raster to raster.
    pub deviation: [f64; UNEVENNESS],
}

/// Figures of the details of one level of a raster.
#[derive(Debug, Clone, Copy, Default, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LevelFigures {
    /// Logarithm of their rms along x, along y and diagonal, relative to that of the raster.
    pub log_rms: [f64; 3],
    /// Logarithm of their flatness in these orientations, and the figures of the cascade from this level to the next one and to the one after it, which is
    /// 0 where the raster is too small for it.
    pub unevenness: [f64; UNEVENNESS],
}

impl LevelFigures {
    /// All figures: the unevenness, then the logarithms of the rms.
    pub fn all(&self) -> impl Iterator<Item = f64> {
        self.unevenness.into_iter().chain(self.log_rms)
    }
}

impl Contrast {
    /// No contrast, at four levels with the lengths of those of a Haar pyramid.
    pub fn none() -> Self {
        Self { finest_cells: 0.7, levels: vec![LevelContrast::default(); 4] }
    }
}

/// How noise without fields differs from place to place.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Parametric {
    /// Spectra of places of some strengths, the quietest first: noise of rough or poorly textured rock is correlated otherwise than that of flat rock.
    pub spectra: Vec<PlaceSpectrum>,
    /// Noise at edges; none: like that elsewhere.
    pub shift: Option<LateralShift>,
}

/// Spectrum of the noise of places of one strength.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlaceSpectrum {
    /// Logarithm of the strength of these places, pixels of the full image.
    pub log_strength: f64,
    /// Logarithm of the amplitude in each band.
    pub log_amplitude: Vec<f64>,
}

/// A lateral shift of the face that makes the noise of its edges: `z(x + d) - z(x)`.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LateralShift {
    /// Deviation of d along each axis, cells.
    pub deviation_cells: f64,
    /// Deviation of the Gaussian that is the correlation of d along edges, cells: along Y of a shift in X, and the other way round.
    pub length_cells: f64,
    /// The same across them.
    pub across_cells: f64,
    /// Part of the variance of the noise that is owed to it where the shift changes elevations much.
    pub share: f64,
    /// Deviation of the elevation under the shift at which half of that part is, metres.
    pub half_m: f64,
}

/// The bit of a weight that says that the raster had no value there.
pub const GAP: u8 = 0x80;

/// A noise model: errors of disparity on the cells of a grid over the face, in pixels of the full image.
///
/// An acquisition is `whitened field x strength x exp(log_strength)`. The whitened field is mixed from those of some members with smooth
/// random weights, or drawn from white noise where the model has no fields; bands of frequency give it the amplitudes of one member.
#[derive(Debug, Clone)]
pub struct Noise {
    /// The frame X and Y of the grid are in.
    pub frame: Frame,
    /// The cells over the face at which strength, elevation and fields have a value.
    pub grid: Grid,
    /// Whitened fields mixed in one acquisition.
    pub donors: usize,
    /// Power the weights of the mixture are raised to: with more of it each place has the structure of fewer members.
    pub sharpness: u32,
    /// Contrast of the details of the mixture.
    pub contrast: Contrast,
    /// Correlation length of the weights of the mixture, cells.
    pub length_cells: f64,
    /// Share of the variance of a weight that is constant over the face.
    pub common_share: f64,
    /// Probability that an acquisition is a bad one.
    pub bad_share: f64,
    /// Logarithm of the strength at the middle of each class of place, ascending.
    pub class_log_strength: Vec<f64>,
    /// Deviation of the jitter of `log_strength` and `log_amplitude` as a share of that of the members, drawn with their covariance.
    pub jitter: f64,
    /// Logarithm of the gain that makes up for what a survey loses, band by band: interpolation smooths the finest noise.
    pub log_gain: Vec<f64>,
    /// How strength follows from relief where the geometry has changed.
    pub relief: ReliefLaw,
    /// How many times its asymmetry (least-squares plane less plane of least absolute deviations) registration leaves in a difference, for the three
    /// numbers of a plane: it aligns what most cells agree on.
    pub asymmetry_gain: [f64; 3],
    /// Factor on the probability that an acquisition has a gap where a member has one: outliers that are filtered out leave gaps too, and surveys
    /// widen them.
    pub gap_gain: f64,
    /// Power that the share of gaps of a member, relative to the mean one, is raised to for the acquisitions that take its strengths: where noise is
    /// strong matching fails more often, and a difference of two acquisitions varies less than each of them.
    pub gap_variety: f64,
    /// Skewness of the whitened field of an acquisition as a multiple of that of the raster whose strengths it takes; the sign is random. A difference of
    /// two acquisitions is less skewed than each of them, and gridding evens noise out, so it is above 1.
    pub skewness_gain: f64,
    /// What comes with a unit of each factor of a trend beyond a plane, beside the trend itself, metres for a metre: an orientation does not bend
    /// a face like a polynomial. Empty: not known.
    pub bend_shapes: Vec<Vec<f32>>,
    /// Weights of cells in the least squares of a trend, `rows x columns` from the top: the inverse of the variance of the noise around, 1 where it is
    /// the usual one.
    pub trend_weights: Vec<f32>,
    /// How the noise of a model without fields differs from place to place; none: white noise with the bands of a member.
    pub parametric: Option<Box<Parametric>>,
    /// What is known of each acquisition the model was learnt from.
    pub members: Vec<Member>,
    /// Members that are not bad, by place, in the order in which replicates take their strengths: the first surveys of comparisons and the second ones.
    pub orders: [Vec<usize>; 2],
    /// Strength of the noise by place, pixels of disparity in the full image, `rows x columns` from the top.
    pub strength: Vec<f32>,
    /// Elevation of the face the rasters were taken from, metres; NaN where unknown.
    pub elevation: Vec<f32>,
    /// Whitened field of each member, of unit variance over the face, gaps filled; empty: the model has none.
    pub fields: Vec<Vec<f32>>,
    /// Weight of each value of a field: 127 inside, falling to 0 in a gap; [`GAP`] is added where the raster had no value. Without fields only the gaps
    /// count; empty: the model has no gaps.
    pub weights: Vec<Vec<u8>>,
}

/// Highest power of weights.
const MOST_SHARPNESS: u32 = 16;
/// Largest length of the finest details, cells.
const MOST_FINEST_CELLS: f64 = 100.0;
/// Most levels of details.
const MOST_LEVELS: usize = 12;
/// Largest power of details.
const MOST_POWER: f64 = 4.0;
/// Largest logarithm of a gain.
const MOST_LOG_GAIN: f64 = 5.0;
/// Largest factor on the probability of gaps.
pub const MOST_GAP_GAIN: f64 = 4.0;
/// Largest power of a share of gaps.
pub const MOST_GAP_VARIETY: f64 = 4.0;
/// Largest gain of the skewness.
pub const MOST_SKEWNESS_GAIN: f64 = 20.0;
/// Largest deviation and length of lateral shifts, cells.
const MOST_SHIFT_CELLS: f64 = 1e3;
/// Largest gain of asymmetry.
const MOST_ASYMMETRY_GAIN: f64 = 20.0;

impl Noise {
    /// Number of bands of frequency.
    pub fn bands(&self) -> usize {
        self.log_gain.len()
    }

    /// Whether an acquisition mixes the fields of members; otherwise it is drawn from white noise.
    pub fn has_fields(&self) -> bool {
        !self.fields.is_empty()
    }

    /// Whether an acquisition has gaps where members had them.
    pub fn has_gaps(&self) -> bool {
        !self.weights.is_empty()
    }

    /// The bad members and the usual ones, by their places.
    pub fn by_class(&self) -> (Vec<usize>, Vec<usize>) {
        (0..self.members.len()).partition(|i| self.members[*i].bad)
    }

    /// What a draw adds to values that every member has: a random sum of the departures of some members from their mean, which has
    /// their covariance times the square of [`Noise::jitter`]. The same field of random numbers goes with the same sum whatever the values.
    pub fn departure<'a>(
        &'a self,
        members: &[usize],
        random: &Field,
        values: impl Fn(&'a Member) -> &'a [f64],
    ) -> Vec<f64> {
        let count = members.len() as f64;
        let scale = self.jitter / (count - 1.0).max(1.0).sqrt();
        let weights: Vec<f64> = (0..members.len()).map(|i| scale * random.normal(i as i32, 0)).collect();
        let rows: Vec<&[f64]> = members.iter().map(|i| values(&self.members[*i])).collect();
        let sum = |k: usize| {
            let mean = rows.iter().map(|row| row[k]).sum::<f64>() / count;
            rows.iter().zip(&weights).map(|(row, weight)| weight * (row[k] - mean)).sum::<f64>()
        };
        (0..rows.first().map_or(0, |row| row.len())).map(sum).collect()
    }

    /// Checks that the parts fit each other.
    ///
    /// # Errors
    /// The part that does not fit, and what it should be.
    pub fn check(&self) -> Result<(), CodecError> {
        let refuse = |text: String| Err(CodecError(format!("noise model: {text}")));
        let (classes, bands) = (self.class_log_strength.len(), self.bands());
        if classes == 0 || bands < 2 || !self.members.iter().any(|member| !member.bad) {
            return refuse(
                "it needs a class of place, two bands of frequency and an acquisition that is not bad".into(),
            );
        }
        for member in &self.members {
            let lengths = [&member.log_strength, &member.log_amplitude, &member.field_log_amplitude].map(Vec::len);
            if lengths != [classes, bands, bands] {
                return refuse(format!(
                    "`{}` has {lengths:?} values for {classes} classes and {bands} bands",
                    member.name
                ));
            }
        }
        let (_, good) = self.by_class();
        let complete = |order: &Vec<usize>| {
            let mut sorted = order.clone();
            sorted.sort_unstable();
            sorted == good
        };
        if !self.orders.iter().all(complete) {
            return refuse("an order of replicates does not have each acquisition that is not bad once".into());
        }
        let cells = self.grid.cells();
        let (members, fields, weights) = (self.members.len(), self.fields.len(), self.weights.len());
        if ![[0, 0], [0, members], [members, members]].contains(&[fields, weights]) {
            return refuse(format!("{fields} fields and {weights} weights for {members} acquisitions"));
        }
        let shapes = self.bend_shapes.len();
        if ![0, BENDS.len()].contains(&shapes) {
            return refuse(format!("{shapes} shapes of bends for {} factors", BENDS.len()));
        }
        let single = [&self.strength, &self.elevation, &self.trend_weights].into_iter();
        let rasters = single.chain(&self.bend_shapes).chain(&self.fields);
        let lengths = rasters.map(Vec::len);
        if let Some(length) = lengths.chain(self.weights.iter().map(Vec::len)).find(|length| *length != cells) {
            return refuse(format!("a raster has {length} cells, the grid {cells}"));
        }
        let positive = |value: f64| value.is_finite() && value > 0.0;
        let share = |value: f64| (0.0..=1.0).contains(&value);
        if self.donors == 0 || !positive(self.length_cells) || !share(self.common_share) || !share(self.bad_share) {
            return refuse("donors and their length must be positive, shares between 0 and 1".into());
        }
        if !((1..=MOST_SHARPNESS).contains(&self.sharpness) && self.jitter.is_finite() && self.jitter >= 0.0) {
            return refuse(format!("sharpness must be from 1 to {MOST_SHARPNESS}, jitter not negative"));
        }
        let Contrast { finest_cells, levels } = &self.contrast;
        let sound = |level: &LevelContrast| {
            let LevelContrast { growth, usual, drawn, deviation, .. } = level;
            let mut figures = growth.iter().flatten().chain(deviation).copied().chain(usual.all()).chain(drawn.all());
            level.own_power.iter().chain(&level.local_power).all(|power| power.abs() <= MOST_POWER)
                && level.log_gain.iter().all(|gain| gain.abs() <= MOST_LOG_GAIN)
                && figures.all(f64::is_finite)
        };
        let usable = positive(*finest_cells)
            && *finest_cells <= MOST_FINEST_CELLS
            && levels.len() <= MOST_LEVELS
            && levels.iter().all(sound);
        if !usable || !self.log_gain.iter().all(|gain| gain.abs() <= MOST_LOG_GAIN) {
            return refuse("contrast or a gain is out of range".into());
        }
        if !self.asymmetry_gain.iter().all(|gain| gain.abs() <= MOST_ASYMMETRY_GAIN) {
            return refuse(format!("a gain of asymmetry is beyond {MOST_ASYMMETRY_GAIN}"));
        }
        if !(0.0..=MOST_GAP_GAIN).contains(&self.gap_gain) {
            return refuse(format!("the gain of gaps must be from 0 to {MOST_GAP_GAIN}"));
        }
        if !(0.0..=MOST_GAP_VARIETY).contains(&self.gap_variety) {
            return refuse(format!("the power of shares of gaps must be from 0 to {MOST_GAP_VARIETY}"));
        }
        let skewed = self.members.iter().all(|member| member.skewness.is_finite());
        if !skewed || !(0.0..=MOST_SKEWNESS_GAIN).contains(&self.skewness_gain) {
            return refuse(format!("skewness must be finite, its gain from 0 to {MOST_SKEWNESS_GAIN}"));
        }
        if let Some(parametric) = &self.parametric {
            parametric.check(bands, fields > 0)?;
        }
        let sound = self.strength.iter().all(|value| value.is_finite() && *value >= 0.0);
        if !self.trend_weights.iter().all(|weight| weight.is_finite() && *weight > 0.0) {
            return refuse("a weight of a trend is not positive".into());
        }
        if !sound || !self.fields.iter().chain(&self.bend_shapes).flatten().all(|value| value.is_finite()) {
            return refuse("a strength, a bend or a whitened value is not finite".into());
        }
        Ok(())
    }
}

impl Parametric {
    fn check(&self, bands: usize, has_fields: bool) -> Result<(), CodecError> {
        let refuse = |text: &str| Err(CodecError(format!("noise model: {text}")));
        if has_fields {
            return refuse("it has fields, and spectra of noise without fields");
        }
        let complete = |spectrum: &PlaceSpectrum| {
            spectrum.log_amplitude.len() == bands
                && spectrum.log_amplitude.iter().chain([&spectrum.log_strength]).all(|value| value.is_finite())
        };
        let ascending = self.spectra.is_sorted_by(|a, b| a.log_strength <= b.log_strength);
        if self.spectra.is_empty() || !ascending || !self.spectra.iter().all(complete) {
            return refuse("spectra by place need finite values in each band, and ascending strengths");
        }
        let within = |value: f64, most: f64| value > 0.0 && value <= most;
        let sound = |shift: &LateralShift| {
            [shift.deviation_cells, shift.length_cells, shift.across_cells]
                .into_iter()
                .all(|cells| within(cells, MOST_SHIFT_CELLS))
                && within(shift.share, 1.0)
                && within(shift.half_m, f64::MAX)
        };
        if !self.shift.as_ref().is_none_or(sound) {
            return refuse("a lateral shift needs positive lengths and a share of at most 1");
        }
        Ok(())
    }
}

/// Equal parts and bits: NaN equals NaN.
impl PartialEq for Noise {
    fn eq(&self, other: &Self) -> bool {
        let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        let all =
            |noise: &Self| noise.bend_shapes.iter().chain(&noise.fields).map(|raster| bits(raster)).collect::<Vec<_>>();
        (self.frame, self.grid, self.donors) == (other.frame, other.grid, other.donors)
            && (self.length_cells, self.common_share, self.bad_share)
                == (other.length_cells, other.common_share, other.bad_share)
            && (&self.class_log_strength, self.jitter, self.relief)
                == (&other.class_log_strength, other.jitter, other.relief)
            && (self.asymmetry_gain, self.gap_gain, self.gap_variety, self.skewness_gain)
                == (other.asymmetry_gain, other.gap_gain, other.gap_variety, other.skewness_gain)
            && (self.sharpness, &self.contrast, &self.log_gain) == (other.sharpness, &other.contrast, &other.log_gain)
            && self.parametric == other.parametric
            && (&self.members, &self.orders) == (&other.members, &other.orders)
            && bits(&self.strength) == bits(&other.strength)
            && bits(&self.trend_weights) == bits(&other.trend_weights)
            && bits(&self.elevation) == bits(&other.elevation)
            && all(self) == all(other)
            && self.weights == other.weights
    }
}
