//! `apply-mask`: keeps the cells of a raster that a mask allows.

use serde_json::Value;

use crate::grid;
use rockface_core::artefact::{Band, Kind, Raster, Sample};
use rockface_core::params::{Fault, ParamType, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, params};

choice! {
    /// Which cells of the mask keep the raster's value.
    pub enum Keep {
        /// Those with a value.
        Finite = "finite",
        /// Those with a value that is not 0.
        Nonzero = "nonzero",
        /// Those with the value 0.
        Zero = "zero",
    }
}

/// A band by name, or by a number that wraps around.
#[derive(Debug, Clone, PartialEq)]
pub struct BandChoice(pub String);

impl ParamType for BandChoice {
    fn kind() -> params::Kind {
        params::Kind::Text
    }
    fn decode(value: &Value) -> Result<Self, Vec<Fault>> {
        match value {
            Value::Number(number) if number.as_u64().is_some() => Ok(Self(number.to_string())),
            Value::String(name) if !name.is_empty() => Ok(Self(name.clone())),
            other => Err(vec![Fault::new(format!("expected the name of a band or a number from 0, found {other}"))]),
        }
    }
    fn encode(&self) -> Value {
        Value::from(self.0.clone())
    }
}

params! {
    /// Parameters of `apply-mask`.
    pub struct ApplyMaskParams {
        /// Which cells of the mask keep the raster's value.
        keep: Keep = Keep::Finite,
        /// The band of the mask: its name, or a number k that stands for band k mod n (from 0), so replicates rotate
        /// through n masks. Left out: a cell is kept where every band of the mask keeps it.
        band: Option<BandChoice> = None,
        /// The labels that count as not 0 in a label raster, such as the events of an inventory; left out: every one.
        labels: Option<Vec<u32>> = None,
        /// By how many cells, in every direction, what is masked out grows.
        grow_cells: u32 = 0; Range::Between(0.0, 10000.0),
        /// Share of the values that a mask should leave: where it leaves fewer, a warning says so.
        expected_share: f64 = 0.0; Range::Between(0.0, 1.0),
    }
}

/// Sets cells to NaN where a mask excludes them, in every band of the raster.
pub struct ApplyMask;

impl Stage for ApplyMask {
    type Params = ApplyMaskParams;
    const NAME: &'static str = "apply-mask";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("apply_mask.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("raster", &[Kind::Raster], "What is masked, any number of bands.").changed(),
        Port::one("mask", &[Kind::Raster], "What decides, any number of bands."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("raster", &[Kind::Raster], "The raster where the mask keeps it.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mut raster = inputs.owned::<Raster>("raster")?;
        let mask = inputs.one::<Raster>("mask")?;
        check_grids(&raster, mask)?;
        let bands = match &params.band {
            Some(choice) => vec![chosen(mask, choice)?],
            None => mask.bands.iter().collect(),
        };
        let mut kept = kept(&bands, params, raster.grid.cells());
        grow(&mut kept, raster.grid.columns, params.grow_cells as usize);
        let known = |raster: &Raster| raster.bands.iter().flat_map(|b| &b.values).filter(|v| !v.is_nan()).count();
        let before = known(&raster);
        for band in &mut raster.bands {
            band.values.iter_mut().zip(&kept).filter(|(_, kept)| !**kept).for_each(|(value, _)| *value = f32::NAN);
            if band.values.iter().all(|v| v.is_nan()) {
                return Err(StageError::new(format!("the mask leaves no value of band `{}`", band.name))
                    .hint("look at mask and raster with `draw-picture`; see the parameter `keep`"));
            }
        }
        let sample = raster.sample;
        // A byte has no way to say that there is no value.
        if kept.iter().any(|kept| !kept) {
            raster.sample = Sample::Float;
        }
        if let [band] = bands.as_slice() {
            context.note(format!("mask: band `{}`", band.name));
        }
        let share = kept.iter().filter(|kept| **kept).count() as f64 / kept.len() as f64;
        context.metric("kept_share", share, "1");
        let after = known(&raster);
        let left = after as f64 / before as f64;
        if left < params.expected_share {
            let (left, expected) = (100.0 * left, 100.0 * params.expected_share);
            context.warn(format!("the mask leaves {left:.1} % of the values, of which {expected} % are expected"));
        }
        let is_unchanged = after == before && raster.sample == sample;
        let outputs = Outputs::of("raster", raster);
        Ok(if is_unchanged { outputs.unchanged("raster", "raster") } else { outputs })
    }
}

fn check_grids(raster: &Raster, mask: &Raster) -> Result<(), StageError> {
    if grid::same(&raster.grid, &mask.grid) && raster.frame == mask.frame {
        return Ok(());
    }
    let (a, b) = (grid::describe(&raster.grid), grid::describe(&mask.grid));
    let text = format!("the raster has {a} ({} frame), the mask {b} ({} frame)", raster.frame, mask.frame);
    Err(StageError::new(text).hint("rasterise both on one grid: port `grid` of `rasterise-dem`"))
}

/// The band a name or number stands for; a number that is also the name of another band is refused.
fn chosen<'a>(mask: &'a Raster, choice: &BandChoice) -> Result<&'a Band, StageError> {
    let named = mask.bands.iter().find(|band| band.name == choice.0);
    let numbered = choice.0.parse::<usize>().ok().and_then(|k| mask.bands.get(k % mask.bands.len().max(1)));
    if let (Some(named), Some(numbered)) = (named, numbered)
        && named.name != numbered.name
    {
        return Err(StageError::new(format!(
            "band `{}` of the mask may mean the band of that name or the one of that number, `{}`",
            named.name, numbered.name
        ))
        .hint("rename the files the mask was read from, so that their names are no numbers"));
    }
    named.or(numbered).ok_or_else(|| {
        let names: Vec<&str> = mask.bands.iter().take(8).map(|band| band.name.as_str()).collect();
        let more = if mask.bands.len() > names.len() { ", ..." } else { "" };
        StageError::new(format!("the mask has no band `{}`", choice.0))
            .hint(format!("its bands are {}{more}; a number counts from 0", names.join(", ")))
    })
}

fn kept(bands: &[&Band], params: &ApplyMaskParams, cells: usize) -> Vec<bool> {
    let counts = |value: f32| {
        let listed =
            |labels: &Vec<u32>| labels.iter().any(|label| f64::from(*label).to_bits() == f64::from(value).to_bits());
        value.is_finite() && value != 0.0 && params.labels.as_ref().is_none_or(listed)
    };
    let keeps = |value: f32| match params.keep {
        Keep::Finite => value.is_finite(),
        Keep::Nonzero => counts(value),
        Keep::Zero => value.is_finite() && !counts(value),
    };
    (0..cells).map(|cell| bands.iter().all(|band| keeps(band.values[cell]))).collect()
}

/// Grows what is not kept by squares of `2 reach + 1` cells: along the rows, then along the columns.
fn grow(kept: &mut [bool], columns: usize, reach: usize) {
    if reach == 0 {
        return;
    }
    let rows = kept.len() / columns;
    let mut spread = |lines: usize, length: usize, at: &dyn Fn(usize, usize) -> usize| {
        for line in 0..lines {
            let masked: Vec<usize> = (0..length).filter(|i| !kept[at(line, *i)]).collect();
            for i in masked {
                (i.saturating_sub(reach)..(i + reach + 1).min(length)).for_each(|j| kept[at(line, j)] = false);
            }
        }
    };
    spread(rows, columns, &|row, column| row * columns + column);
    spread(columns, rows, &|column, row| row * columns + column);
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Grid};
    use rockface_core::testing::{TestHost, run_stage};

    const GRID: Grid = Grid { columns: 4, rows: 1, cell_m: 1.0, left_m: 0.0, top_m: 0.0 };

    fn stack(bands: &[(&str, [f32; 4])]) -> Raster {
        let mut raster = Raster::single(GRID, Frame::Wall, "mask", "", Vec::new());
        raster.bands = bands.iter().map(|(name, v)| Band { name: (*name).to_owned(), values: v.to_vec() }).collect();
        raster
    }

    fn kept_cells(with: &Value, mask: &Raster) -> Result<Vec<usize>, StageError> {
        let raster = Raster::single(GRID, Frame::Wall, "difference", "d", vec![1.0; 4]);
        let inputs: [(&str, Artefact); 2] = [("raster", raster.into()), ("mask", mask.clone().into())];
        let outputs = run_stage::<ApplyMask>(&TestHost::default(), with, &inputs)?.into_inner();
        let Artefact::Raster(masked) = &outputs["raster"] else { panic!("a raster comes out") };
        Ok((0..4).filter(|i| !masked.bands[0].values[*i].is_nan()).collect())
    }

    #[test]
    fn the_words_of_keep() {
        let mask = stack(&[("m", [f32::NAN, 0.0, 2.0, f32::INFINITY])]);
        for (word, expected) in [("finite", vec![1, 2]), ("nonzero", vec![2]), ("zero", vec![1])] {
            assert_eq!(kept_cells(&json!({"keep": word}), &mask).unwrap(), expected, "{word}");
        }
    }

    #[test]
    fn a_mask_that_takes_nothing_gives_on_the_raster() {
        let unchanged = |mask: [f32; 4]| {
            let raster = Raster::single(GRID, Frame::Wall, "difference", "d", vec![f32::NAN, 1.0, 1.0, 1.0]);
            let inputs: [(&str, Artefact); 2] = [("raster", raster.into()), ("mask", stack(&[("m", mask)]).into())];
            let outputs = run_stage::<ApplyMask>(&TestHost::default(), &json!({}), &inputs).unwrap();
            outputs.unchanged_from("raster")
        };
        assert_eq!(unchanged([1.0; 4]), Some("raster"));
        assert_eq!(unchanged([f32::NAN, 1.0, 1.0, 1.0]), Some("raster"), "what it takes has no value");
        assert_eq!(unchanged([1.0, f32::NAN, 1.0, 1.0]), None);
    }

    #[test]
    fn a_mask_that_takes_more_than_is_expected_is_warned_of() {
        let raster = Raster::single(GRID, Frame::Wall, "difference", "d", vec![f32::NAN, 1.0, 1.0, 1.0]);
        let mask = stack(&[("m", [f32::NAN, 0.0, 2.0, f32::NAN])]);
        let warnings = |share: f64| {
            let host = TestHost::default();
            let inputs: [(&str, Artefact); 2] = [("raster", raster.clone().into()), ("mask", mask.clone().into())];
            run_stage::<ApplyMask>(&host, &json!({"expected_share": share}), &inputs).unwrap();
            host.warnings()
        };
        assert!(warnings(0.6).is_empty());
        assert!(warnings(0.7)[0].contains("66.7 % of the values, of which 70 %"), "{:?}", warnings(0.7));
    }

    #[test]
    fn labels_are_chosen_and_grow() {
        let mask = stack(&[("m", [3.0, 0.0, 0.0, 5.0])]);
        assert_eq!(kept_cells(&json!({"keep": "zero", "labels": [3]}), &mask).unwrap(), [1, 2, 3]);
        assert_eq!(kept_cells(&json!({"keep": "zero", "labels": [3], "grow_cells": 1}), &mask).unwrap(), [2, 3]);
        assert_eq!(kept_cells(&json!({"keep": "nonzero", "labels": [5]}), &mask).unwrap(), [3]);
        let mut square = vec![true; 25];
        square[12] = false;
        grow(&mut square, 5, 1);
        let gone: Vec<usize> = (0..25).filter(|i| !square[*i]).collect();
        assert_eq!(gone, [6, 7, 8, 11, 12, 13, 16, 17, 18]);
    }

    #[test]
    fn bands_by_name_by_number_in_rotation_and_all_together() {
        let nan = f32::NAN;
        let mask = stack(&[("a", [1.0, nan, 1.0, nan]), ("7", [nan, nan, 1.0, 1.0])]);
        assert_eq!(kept_cells(&json!({"band": "a"}), &mask).unwrap(), [0, 2]);
        assert_eq!(kept_cells(&json!({"band": 4}), &mask).unwrap(), [0, 2]);
        assert_eq!(kept_cells(&json!({"band": "5"}), &mask).unwrap(), [2, 3]);
        assert_eq!(kept_cells(&json!({"band": 7}), &mask).unwrap(), [2, 3]);
        assert_eq!(kept_cells(&json!({}), &mask).unwrap(), [2]);
        assert!(kept_cells(&json!({"band": "b"}), &mask).unwrap_err().message.contains("`b`"));
    }

    #[test]
    fn another_grid_or_nothing_left_is_refused() {
        let mut mask = stack(&[("m", [0.0; 4])]);
        assert!(kept_cells(&json!({"keep": "nonzero"}), &mask).unwrap_err().message.contains("`d`"));
        mask.grid.left_m = 0.5;
        assert!(kept_cells(&json!({}), &mask).unwrap_err().message.contains("left 0.5 m"));
    }

    /// A byte or a word has no way to say that there is no value.
    #[test]
    fn a_raster_of_bytes_or_words_that_gets_gaps_becomes_one_of_floats() {
        let sample_under = |sample: Sample, mask: [f32; 4]| {
            let raster = Raster { sample, ..Raster::single(GRID, Frame::Wall, "mask", "m", vec![1.0; 4]) };
            let inputs: [(&str, Artefact); 2] = [("raster", raster.into()), ("mask", stack(&[("m", mask)]).into())];
            let outputs = run_stage::<ApplyMask>(&TestHost::default(), &json!({}), &inputs).unwrap().into_inner();
            let Artefact::Raster(masked) = &outputs["raster"] else { panic!("a raster comes out") };
            masked.sample
        };
        for sample in [Sample::Byte, Sample::Word] {
            assert_eq!(sample_under(sample, [1.0, f32::NAN, 1.0, 1.0]), Sample::Float);
            assert_eq!(sample_under(sample, [1.0; 4]), sample, "without a gap it stays");
        }
    }
}
