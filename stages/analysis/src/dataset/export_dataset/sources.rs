//! The comparisons tiles are cut from: differences, elevations and truth that belong together.

use super::ExportDatasetParams;
use crate::dataset::tiles::Scene;
use crate::detection::compared;
use rockface_core::artefact::{Inventory, Raster};
use rockface_core::names::twice;
use rockface_core::{Inputs, Point, StageError, fail};
use rockface_raster::grid;

/// The rasters and the truth of one comparison, and at which point of the axes it stands.
pub(super) struct Scored<'a> {
    pub(super) point: &'a Point,
    pub(super) difference: &'a Raster,
    pub(super) reference: &'a Raster,
    pub(super) comparison: &'a Raster,
    pub(super) truth: &'a Inventory,
    pub(super) instances: Vec<u16>,
}

impl Scored<'_> {
    /// What its tiles are cut from.
    pub(super) fn scene(&self) -> Scene<'_> {
        Scene {
            grid: &self.difference.grid,
            difference: &self.difference.bands[0].values,
            reference: &self.reference.bands[0].values,
            comparison: &self.comparison.bands[0].values,
            instances: &self.instances,
        }
    }
}

pub(super) fn samples<'a>(params: &ExportDatasetParams, inputs: &'a Inputs) -> Result<Vec<Scored<'a>>, StageError> {
    let axes = rockface_raster::feature_rows::axes(inputs.elements("difference").iter().map(|element| &element.point));
    for axis in params.event_axes.iter().chain(&params.sequence_axis) {
        if !axes.contains(axis) {
            let known = if axes.is_empty() { "none".to_owned() } else { axes.join(", ") };
            fail!("nothing is gathered over the axis `{axis}`; there are {known}");
        }
    }
    let differences = inputs.many::<Raster>("difference")?;
    let (references, comparisons) = (inputs.many::<Raster>("reference")?, inputs.many::<Raster>("comparison")?);
    let truths = inputs.many::<Inventory>("truth")?;
    let sample = |(point, difference): &(&'a Point, &'a Raster)| {
        let reference = matching("reference", point, &references)?;
        let comparison = matching("comparison", point, &comparisons)?;
        let truth = matching("truth", point, &truths)?;
        for (port, raster) in [("difference", *difference), ("reference", reference), ("comparison", comparison)] {
            if raster.bands.len() != 1 || !grid::same(&raster.grid, &difference.grid) {
                let (a, b) = (grid::describe(&raster.grid), grid::describe(&difference.grid));
                fail!(
                    "`{port}`{}: {a}, {} bands; one band on the difference's grid is needed: {b}",
                    place(point),
                    raster.bands.len()
                );
            }
        }
        if truth.frame != difference.frame {
            fail!(
                "the truth{} is in the {} frame, the difference in the {} frame",
                place(point),
                truth.frame,
                difference.frame
            );
        }
        let instances = instances(truth, difference).map_err(|e| e.within(format!("truth{}", place(point))))?;
        Ok(Scored { point, difference, reference, comparison, truth, instances })
    };
    differences.iter().map(sample).collect()
}

pub(super) fn place(point: &Point) -> String {
    point.iter().map(|(axis, item)| format!(" {axis}={item}")).collect()
}

/// The element that agrees with a point on every axis it was gathered over.
pub(super) fn matching<'a, T>(port: &str, point: &Point, elements: &[(&Point, &'a T)]) -> Result<&'a T, StageError> {
    let agrees = |other: &Point| other.iter().all(|(axis, item)| point.get(axis) == Some(item));
    let found: Vec<&'a T> = elements.iter().filter(|(other, _)| agrees(other)).map(|(_, value)| *value).collect();
    match found.as_slice() {
        [one] => Ok(*one),
        other => fail!("{} elements of `{port}` belong to the difference{}, one is needed", other.len(), place(point)),
    }
}

pub(super) fn instances(truth: &Inventory, difference: &Raster) -> Result<Vec<u16>, StageError> {
    let grid = &difference.grid;
    let mut instances = vec![0u16; grid.cells()];
    if truth.features.is_empty() {
        return Ok(instances);
    }
    let Some(given) = truth.numbers("id") else {
        return Err(StageError::new("it has no column `id`").hint("number the changes from 1 in a property `id`"));
    };
    let mut ids = Vec::new();
    for (place, id) in given.into_iter().enumerate() {
        let Some(id) = id else { fail!("change {} of {} has no `id`", place + 1, truth.features.len()) };
        if id.fract() != 0.0 || !(1.0..=f64::from(u16::MAX)).contains(&id) {
            fail!("`id` {id} is no whole number from 1 to {}", u16::MAX);
        }
        ids.push(id as u16);
    }
    if let Some(id) = twice(ids.clone()) {
        fail!("two changes have the `id` {id}: each needs its own, as masks hold one number a cell");
    }
    let cells = compared::cells(truth, grid, &vec![true; grid.cells()]);
    for (cells, id) in cells.into_iter().zip(ids) {
        cells.into_iter().for_each(|cell| instances[cell] = id);
    }
    Ok(instances)
}
