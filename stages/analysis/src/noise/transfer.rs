//! A noise model on the grid of another face, or of another part of the face it was learnt on.
//!
//! Where the face is the one the model knows, strength and fields stay. Elsewhere the strength is that of the relief, and fields go on
//! mirrored beyond the edges of the model.

use rayon::prelude::*;

use crate::noise::learning::whitening::Places;
use rockface_core::artefact::{Contrast, Grid, LateralShift, Member, Noise, Parametric, Raster, ReliefLaw};
use rockface_core::numerics::bands::{Bands, at_other_bands, log_rms};
use rockface_imaging::matching::noise::changed_face::{Window, is_known, law, relief_m};
use rockface_imaging::matching::noise::ensemble::log_strength_at;
use rockface_imaging::matching::noise::spline::{Spline, mirrored};

/// How a model lies on another face.
#[derive(Debug, Clone, Copy)]
pub struct Setting {
    /// Whether its grid has the coordinates of the other face, so that places can be the same.
    pub same_site: bool,
    /// Cells of the new grid that a cell of its fields is worth.
    pub field_scale: f64,
}

/// A model on another grid.
#[derive(Debug, Clone)]
pub struct Transferred {
    /// The model.
    pub noise: Noise,
    /// Whether the face of each cell is the one the model knows.
    pub known: Vec<bool>,
}

/// A model on the grid of a DEM, which has at least 4 cells on each side.
pub fn transferred(noise: &Noise, dem: &Raster, setting: Setting) -> Transferred {
    let elevation = &dem.bands[0].values;
    let known = |cell: usize| setting.same_site.then(|| known_cell(noise, dem, cell)).flatten();
    let cells: Vec<Option<usize>> = (0..elevation.len()).into_par_iter().map(known).collect();
    let relief = wider(noise.relief, setting.field_scale);
    let window = Window { columns: dem.grid.columns, rows: dem.grid.rows, half: relief.window_cells };
    let strength = |(i, cell): (usize, &Option<usize>)| match cell {
        Some(cell) => noise.strength[*cell],
        None => law(&relief, relief_m(elevation, &window, i)) as f32,
    };
    let lie = Lie::new(noise.grid, dem.grid, setting);
    let mut moved = Noise {
        frame: dem.frame,
        grid: dem.grid,
        length_cells: setting.field_scale * noise.length_cells,
        contrast: wider_contrast(&noise.contrast, setting.field_scale),
        relief,
        class_log_strength: noise.class_log_strength.clone(),
        log_gain: noise.log_gain.clone(),
        bend_shapes: noise.bend_shapes.iter().map(|shape| stretched(shape, noise.grid, dem.grid)).collect(),
        trend_weights: stretched(&noise.trend_weights, noise.grid, dem.grid),
        parametric: noise.parametric.as_ref().map(|parametric| Box::new(wider_shift(parametric, setting.field_scale))),
        members: noise.members.clone(),
        orders: noise.orders.clone(),
        strength: cells.par_iter().enumerate().map(strength).collect(),
        elevation: cells.iter().zip(elevation).map(|(cell, z)| cell.map_or(*z, |cell| noise.elevation[cell])).collect(),
        fields: noise.fields.par_iter().map(|field| lie.field(field)).collect(),
        weights: noise.weights.par_iter().map(|weights| lie.nearest(weights)).collect(),
        ..*noise
    };
    place_classes(&mut moved, &noise.strength);
    place_bands(&mut moved, noise.grid, setting.field_scale);
    Transferred { noise: moved, known: cells.iter().map(Option::is_some).collect() }
}

/// What comes with bends, or the weights of trends, on another grid: like the trends, they keep their place between the edges.
fn stretched(values: &[f32], old: Grid, grid: Grid) -> Vec<f32> {
    let under = |index: usize, new: usize, old: usize| ((index as f64 + 0.5) * old as f64 / new as f64) as usize;
    let cell = |cell: usize| {
        let (row, column) = (cell / grid.columns, cell % grid.columns);
        under(row, grid.rows, old.rows) * old.columns + under(column, grid.columns, old.columns)
    };
    (0..grid.cells()).map(|i| values[cell(i)]).collect()
}

/// The cell of a model where the face at a cell of a DEM is the one it knows: at the same place and elevation, or unknown in both.
fn known_cell(noise: &Noise, dem: &Raster, cell: usize) -> Option<usize> {
    let (x, y) = dem.grid.centre(cell / dem.grid.columns, cell % dem.grid.columns);
    let own = noise.grid.cell_of([x, y])?;
    let z = f64::from(dem.bands[0].values[cell]);
    let same = if z.is_nan() { noise.elevation[own].is_nan() } else { is_known(noise, own, z) == Some(true) };
    same.then_some(own)
}

/// The law of relief with its window in new cells.
fn wider(relief: ReliefLaw, scale: f64) -> ReliefLaw {
    ReliefLaw { window_cells: ((relief.window_cells as f64 * scale).round() as usize).max(1), ..relief }
}

/// Contrast with its lengths in new cells.
fn wider_contrast(contrast: &Contrast, scale: f64) -> Contrast {
    Contrast { finest_cells: scale * contrast.finest_cells, ..contrast.clone() }
}

/// Noise without fields with the lengths of its shift in new cells.
fn wider_shift(parametric: &Parametric, scale: f64) -> Parametric {
    let wider = |shift: LateralShift| LateralShift {
        deviation_cells: scale * shift.deviation_cells,
        length_cells: scale * shift.length_cells,
        across_cells: scale * shift.across_cells,
        ..shift
    };
    Parametric { shift: parametric.shift.map(wider), ..parametric.clone() }
}

/// Change of the scale of a field that is none.
const SAME_SCALE: f64 = 1e-9;

/// Where the fields of a model lie under the cells of another grid.
struct Lie {
    /// Columns of the model.
    columns: usize,
    /// Whether fields have other cells than the new grid.
    resampled: bool,
    /// Position of the middle of each new column, and of each new row, in cells of the model, whose middles are at halves.
    at: [Vec<f64>; 2],
    /// Columns and rows of the model under them, mirrored at its edges.
    under: [Vec<usize>; 2],
}

impl Lie {
    fn new(model: Grid, new: Grid, setting: Setting) -> Self {
        let resampled = (setting.field_scale - 1.0).abs() > SAME_SCALE;
        let begins = |metres: f64| if setting.same_site { metres / new.cell_m } else { 0.0 };
        let side = |begins: f64, size: usize| -> Vec<f64> {
            // Field for field, cells lie on each other.
            let begins = if resampled { begins } else { begins.round() };
            (0..size).map(|i| (begins + i as f64 + 0.5) / setting.field_scale).collect()
        };
        let at =
            [side(begins(new.left_m - model.left_m), new.columns), side(begins(model.top_m - new.top_m), new.rows)];
        let sizes = [model.columns, model.rows];
        let under = [0, 1].map(|k| at[k].iter().map(|at| mirrored(*at, sizes[k])).collect());
        Self { columns: model.columns, resampled, at, under }
    }

    /// The values of the cells that lie under the middles of the new ones.
    fn nearest<T: Copy>(&self, values: &[T]) -> Vec<T> {
        let [columns, rows] = &self.under;
        rows.iter().flat_map(|row| columns.iter().map(move |column| values[row * self.columns + column])).collect()
    }

    /// A whitened field on the new cells; a resampled one has unit variance again.
    fn field(&self, values: &[f32]) -> Vec<f32> {
        if !self.resampled {
            return self.nearest(values);
        }
        let spline = Spline::new(values.to_vec(), self.columns);
        let [columns, rows] = &self.at;
        let field: Vec<f64> =
            rows.iter().flat_map(|y| columns.iter().map(|x| spline.at([*x, *y])).collect::<Vec<_>>()).collect();
        let rms = (field.iter().map(|value| value * value).sum::<f64>() / field.len() as f64).sqrt();
        field.iter().map(|value| (value / rms.max(1e-12)) as f32).collect()
    }
}

/// Classes of place are shares of the face: on another one they end at other strengths, where members have the factors they had there.
fn place_classes(noise: &mut Noise, old_strength: &[f32]) {
    let same = noise.strength.iter().map(|s| s.to_bits()).eq(old_strength.iter().map(|s| s.to_bits()));
    if same {
        return;
    }
    let middles = Places::of(noise.strength.clone()).middles;
    let old = &noise.class_log_strength;
    let moved = |values: &[f64]| middles.iter().map(|middle| log_strength_at(old, values, *middle)).collect();
    noise.members.iter_mut().for_each(|member| member.log_strength = moved(&member.log_strength));
    noise.class_log_strength = middles;
}

/// Bands of frequency are shares of what a grid can hold: on another one members have at each frequency the amplitudes they had there.
fn place_bands(noise: &mut Noise, model: Grid, scale: f64) {
    let [from, to] = [model, noise.grid].map(|grid| grid.columns.min(grid.rows));
    if from == to && (scale - 1.0).abs() <= SAME_SCALE {
        return;
    }
    let shares = |grid: Grid, count: usize| Bands::new(grid.columns, grid.rows, count).shares();
    let [old, new] = [model, noise.grid].map(|grid| shares(grid, noise.log_gain.len()));
    let moved = |values: &[f64]| {
        let other = at_other_bands(values, from, to, scale);
        let level = log_rms(values, &old) - log_rms(&other, &new);
        other.iter().map(|value| value + level).collect::<Vec<f64>>()
    };
    for Member { log_amplitude, field_log_amplitude, .. } in &mut noise.members {
        *log_amplitude = moved(log_amplitude);
        *field_log_amplitude = moved(field_log_amplitude);
    }
    if let Some(parametric) = &mut noise.parametric {
        parametric.spectra.iter_mut().for_each(|spectrum| spectrum.log_amplitude = moved(&spectrum.log_amplitude));
    }
    noise.log_gain = at_other_bands(&noise.log_gain, from, to, scale);
}
