//! `draw-registration`: what registration leaves in a difference, drawn from a learnt model.

use rand::RngExt;

use crate::noise::detrend::asymmetry;
use crate::noise::learning::departure::of_another;
use rockface_core::artefact::{Grid, Kind, Noise, Raster};
use rockface_core::numerics::trend::{Trend, bends_at, trend, trend_at, with_trend};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, params};

params! {
    /// Parameters of `draw-registration`.
    pub struct DrawRegistrationParams {
        /// Number among the replicates of a difference that is simulated many times, from 0 on: they take the trends of the rasters in turn, so that a few
        /// replicates differ from each other as much as many, and each that of the raster whose spectrum its first survey has: a raster that is
        /// bent more has more coarse noise. Left out: that of a raster at random.
        replicate: Option<u32> = None,
    }
}

/// Gives a difference the offset, tilt and bend that registration and orientation left in a raster the model was learnt from, in place of its own.
pub struct DrawRegistration;

impl Stage for DrawRegistration {
    type Params = DrawRegistrationParams;
    const NAME: &'static str = "draw-registration";
    const VERSION: u32 = 9;
    const PAGE: Page = Page::new(include_str!("draw_registration.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("raster", &[Kind::Raster], "Difference of two registered surveys, metres."),
        Port::one("noise", &[Kind::Noise], "The model."),
    ];
    const OUTPUTS: &'static [Port] =
        &[Port::one("raster", &[Kind::Raster], "The difference with another offset, tilt and bend, metres.")];

    fn draws(_: &Self::Params) -> bool {
        true
    }

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        inputs.of("noise") + 4 * inputs.of("raster")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (raster, noise) = (inputs.one::<Raster>("raster")?, inputs.one::<Noise>("noise")?);
        if noise.frame != raster.frame {
            let text = format!("the model is in the {} frame, `raster` in the {} frame", noise.frame, raster.frame);
            return Err(StageError::new(text).hint("learn the model from rasters in the frame of the difference"));
        }
        // Trends were learnt with these weights; on another grid places keep theirs.
        let weight = |cell: usize| {
            let [x, y] = place(cell, raster.grid, noise.grid);
            noise.trend_weights[nearest(x, y, noise.grid)]
        };
        let weights: Vec<f32> = (0..raster.grid.cells()).map(weight).collect();
        let mut changed = raster.clone();
        for band in &mut changed.bands {
            let columns = raster.grid.columns;
            let none = || {
                let text = format!("the values of band `{}` lie on a line, or there are none", band.name);
                StageError::new(text).hint("a trend needs an area: check window and gaps of the difference")
            };
            let own_m = trend(&band.values, columns, &weights).ok_or_else(none)?;
            let wanted_m = drawn(noise, params.replicate, context, &band.name);
            let bent = |(cell, z): (usize, &f32)| {
                let [x, y] = place(cell, raster.grid, noise.grid);
                let [own_x, own_y] = place(cell, raster.grid, raster.grid);
                let wanted =
                    trend_at(&wanted_m, x, y) + bends_at(&wanted_m, &noise.bend_shapes, nearest(x, y, noise.grid));
                (f64::from(*z) + wanted - trend_at(&own_m, own_x, own_y)) as f32
            };
            let bent: Vec<f32> = band.values.iter().enumerate().map(bent).collect();
            // Registration aligned the bent surface, so its asymmetry includes the bend.
            let of_bent = trend(&bent, columns, &weights).ok_or_else(none)?;
            let asymmetry_m = asymmetry(&bent, columns, &of_bent).ok_or_else(none)?;
            let mut left_m = Trend::default();
            left_m.iter_mut().zip(noise.asymmetry_gain).zip(asymmetry_m).for_each(|((left, gain), m)| *left = gain * m);
            band.values = with_trend(&bent, columns, &left_m);
        }
        Ok(Outputs::of("raster", changed))
    }
}

/// The place of a cell of a grid on the grid `of` in its frame, whose edges are -1 and 1, to the right and down.
fn place(cell: usize, grid: Grid, of: Grid) -> [f64; 2] {
    let [right_m, down_m] = [cell % grid.columns, cell / grid.columns].map(|index| index as f64 * grid.cell_m);
    let [half_x_m, half_y_m] = [of.columns, of.rows].map(|count| 0.5 * count as f64 * of.cell_m);
    let x = (grid.left_m + right_m - of.left_m) / half_x_m - 1.0;
    let y = (of.top_m - grid.top_m + down_m) / half_y_m - 1.0;
    [x, y]
}

/// The cell of a grid that is nearest to a place on it.
fn nearest(x: f64, y: f64, grid: Grid) -> usize {
    let index = |at: f64, size: usize| ((0.5 * (at + 1.0) * size as f64).round().max(0.0) as usize).min(size - 1);
    index(y, grid.rows) * grid.columns + index(x, grid.columns)
}

/// The trend of a member with jitter, which keeps the mean of the members' trends (smoothed bootstrap, Silverman 1986, 6.4) and has the covariance of one more of them.
fn drawn(noise: &Noise, replicate: Option<u32>, context: &Context, band: &str) -> Trend {
    let members: Vec<usize> = (0..noise.members.len()).collect();
    let count = members.len();
    let chosen = match replicate {
        Some(replicate) => in_turn(noise, replicate as usize),
        None => context.stream("registration", band).generator().random_range(0..count),
    };
    let chosen = &noise.members[chosen];
    let jitter =
        noise.departure(&members, &context.stream("registration-jitter", band).field(), |member| &member.trend_m);
    let width = (of_another(count) / (1.0 + noise.jitter * noise.jitter)).sqrt();
    std::array::from_fn(|k| {
        let mean = noise.members.iter().map(|member| member.trend_m[k]).sum::<f64>() / count as f64;
        mean + width * (chosen.trend_m[k] - mean + jitter[k])
    })
}

/// The member whose trend a replicate takes: after all usual ones in the order of the strengths of first surveys the bad ones have their turn.
fn in_turn(noise: &Noise, replicate: usize) -> usize {
    let ([usual, _], (bad, _)) = (&noise.orders, noise.by_class());
    let turn = (replicate % noise.members.len()).checked_sub(usual.len());
    turn.map_or_else(|| usual[replicate % usual.len()], |turn| bad[turn])
}

#[cfg(test)]
mod tests;
