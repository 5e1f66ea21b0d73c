//! Where blocks stand: relative weights made into probability densities over a safe zone.

use rockface_core::artefact::{Band, Grid, Raster};

/// The class a band of weights or of probabilities is for: its name, less `prob.`, which probabilities of other programs begin with.
pub fn class_of_band(name: &str) -> &str {
    name.strip_prefix("prob.").unwrap_or(name)
}

/// The weights of a class of blocks at the cells of a zone; NaN where there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Weights {
    /// The name of the class.
    pub class: String,
    /// One weight a cell, by row from the top.
    pub values: Vec<f32>,
}

/// Why weights make no density.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
pub enum Fault {
    /// No cell of the zone has a weight above zero.
    #[error("no cell of the safe zone has a weight above zero")]
    Nowhere,
    /// A weight is negative or not finite.
    #[error("a weight is {0}; weights are finite and not negative")]
    Unusable(f32),
}

/// Whether a cell of a mask allows a block.
pub fn allows(mask: f32) -> bool {
    mask != 0.0 && !mask.is_nan()
}

/// The density of a class in 1/m2: zero outside the zone and where there is no weight, with an integral of 1.
pub fn density(weights: &Weights, mask: &[f32], cell_m: f64) -> Result<Vec<f32>, Fault> {
    let wrong = |weight: &&f32| **weight < 0.0 || weight.is_infinite();
    if let Some(weight) = weights.values.iter().find(wrong) {
        return Err(Fault::Unusable(*weight));
    }
    let inside =
        |(weight, mask): (&f32, &f32)| if allows(*mask) && !weight.is_nan() { f64::from(*weight) } else { 0.0 };
    let kept: Vec<f64> = weights.values.iter().zip(mask).map(inside).collect();
    let integral = kept.iter().sum::<f64>() * cell_m * cell_m;
    if integral > 0.0 {
        Ok(kept.into_iter().map(|weight| (weight / integral) as f32).collect())
    } else {
        Err(Fault::Nowhere)
    }
}

/// The bands of a raster at the centres of the cells of a grid, NaN beside it; and how many cells are.
pub fn resampled(raster: &Raster, grid: &Grid) -> (Vec<Band>, usize) {
    let cell = |at: usize| {
        let (x, y) = grid.centre(at / grid.columns, at % grid.columns);
        raster.grid.cell_of([x, y])
    };
    let cells: Vec<Option<usize>> = (0..grid.cells()).map(cell).collect();
    let sampled = |band: &Band| Band {
        name: band.name.clone(),
        values: cells.iter().map(|cell| cell.map_or(f32::NAN, |cell| band.values[cell])).collect(),
    };
    (raster.bands.iter().map(sampled).collect(), cells.iter().filter(|cell| cell.is_none()).count())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_density_integrates_to_one_and_keeps_ratios(values in prop::collection::vec(0.01f32..5.0, 12), cell_m in 0.01f64..2.0) {
            let mask: Vec<f32> = (0..12u8).map(|i| f32::from(i % 3)).collect();
            let weights = Weights { class: "a".into(), values };
            let density = density(&weights, &mask, cell_m).unwrap();
            let integral = density.iter().map(|d| f64::from(*d)).sum::<f64>() * cell_m * cell_m;
            prop_assert!((integral - 1.0).abs() < 1e-6);
            prop_assert!(density.iter().step_by(3).all(|d| *d == 0.0));
            prop_assert!((density[1] / density[2] - weights.values[1] / weights.values[2]).abs() < 1e-3 * density[1] / density[2]);
        }
    }
}
