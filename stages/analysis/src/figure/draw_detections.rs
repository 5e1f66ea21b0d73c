//! `draw-detections`: maps what was found, what was missed and what is false over the face.

use crate::figure::canvas::Colour;
use crate::figure::rockfall_figure::outcomes;
use crate::figure::rockfall_figure::outcomes::{Map, Mark, Outcome};
use rockface_core::artefact::{Inventory, Kind, Picture, Polygon, Raster};
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `draw-detections`.
    pub struct DrawDetectionsParams {
        /// Title.
        title: String = "Detections".to_owned(),
        /// Width of the picture, pixels; text and lines grow with it from 1000 on.
        width_px: u32 = 1000; Range::Between(600.0, 8000.0),
    }
}

/// Maps detections over the face.
pub struct DrawDetections;

impl Stage for DrawDetections {
    type Params = DrawDetectionsParams;
    const NAME: &'static str = "draw-detections";
    const VERSION: u32 = 5;
    const PAGE: Page = Page::new(include_str!("draw_detections.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("face", &[Kind::Raster], "Elevations of the face."),
        Port::one("detections", &[Kind::Inventory], "What was found, scored where there is a truth."),
        Port::optional("truth", &[Kind::Inventory], "The truth, scored."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("picture", &[Kind::Picture], "PNG.")];

    fn run(params: &Self::Params, inputs: &Inputs, _context: &Context) -> Result<Outputs, StageError> {
        let face = inputs.one::<Raster>("face")?;
        let [band] = face.bands.as_slice() else { fail!("the face has {} bands, one is needed", face.bands.len()) };
        if band.values.iter().all(|z| z.is_nan()) {
            fail!("no cell of the face has a value");
        }
        let detections = inputs.one::<Inventory>("detections")?;
        let truth = inputs.optional::<Inventory>("truth")?;
        for (name, inventory) in [("detections", Some(detections)), ("truth", truth)] {
            if let Some(inventory) = inventory.filter(|inventory| inventory.frame != face.frame) {
                fail!("the {name} are in the {} frame, the face in the {} frame", inventory.frame, face.frame);
            }
        }
        let mut outcomes = Vec::new();
        if detections.column("outcome").is_some() {
            outcomes.push(outcome("true positive", detections, "true_positive", TRUE, Mark::None)?);
            outcomes.push(outcome("false positive", detections, "false_positive", FALSE, Mark::Ring)?);
        } else {
            let all = detections.features.iter().map(|feature| feature.outline.as_slice()).collect();
            let detected =
                Outcome { name: "detected".into(), colour: TRUE, filled: true, mark: Mark::None, outlines: all };
            outcomes.push(detected);
        }
        if let Some(truth) = truth {
            outcomes.push(Outcome { filled: false, ..outcome("found", truth, "found", FOUND, Mark::None)? });
            outcomes.push(outcome("missed", truth, "missed", MISSED, Mark::Cross)?);
            outcomes.push(Outcome { filled: false, ..outcome("hidden", truth, "hidden", HIDDEN, Mark::None)? });
        }
        let subtitle = format!("{} detections", detections.features.len());
        let map = Map { title: params.title.clone(), subtitle, face: &band.values, grid: face.grid, outcomes };
        let png = outcomes::draw(&map, params.width_px as usize).map_err(|e| StageError::new(e.to_string()))?;
        Ok(Outputs::of("picture", Picture { png }))
    }
}

/// Of the colours of Okabe and Ito (2008), which readers with any colour vision tell apart; what is wrong has a mark too.
const TRUE: Colour = [0, 114, 178];
const FALSE: Colour = [230, 159, 0];
const MISSED: Colour = [204, 60, 120];
const FOUND: Colour = [0, 30, 70];
const HIDDEN: Colour = [110, 110, 110];

fn outcome<'a>(
    name: &str,
    inventory: &'a Inventory,
    word: &str,
    colour: Colour,
    mark: Mark,
) -> Result<Outcome<'a>, StageError> {
    let Some(at) = inventory.column("outcome") else {
        return Err(
            StageError::new("the truth has no column `outcome`").hint("connect the port `truth` of `score-detections`")
        );
    };
    let is = |feature: &&rockface_core::artefact::Feature| feature.values[at].text() == Some(word);
    let outlines: Vec<&[Polygon]> = inventory.features.iter().filter(is).map(|f| f.outline.as_slice()).collect();
    Ok(Outcome { name: name.to_owned(), colour, filled: true, mark, outlines })
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;
    use rockface_core::artefact::{Feature, Frame, Grid};
    use rockface_core::testing::{TestHost, run_stage};

    fn inventory(outcome: &str) -> Inventory {
        let exterior = vec![[0.2, 0.2], [0.6, 0.2], [0.6, 0.5], [0.2, 0.5]];
        let outline = vec![Polygon { exterior, holes: Vec::new() }];
        let features = vec![Feature { outline, values: vec![outcome.into()] }];
        Inventory { frame: Frame::Wall, columns: vec!["outcome".into()], features }
    }

    #[test]
    fn a_map_is_drawn_with_and_without_a_truth() {
        let grid = Grid { columns: 20, rows: 10, cell_m: 0.1, left_m: 0.0, top_m: 1.0 };
        let face = Raster::single(grid, Frame::Wall, "elevation", "z", vec![0.0; 200]);
        let host = TestHost::default();
        let mut inputs = vec![("face", face.into()), ("detections", inventory("true_positive").into())];
        assert!(run_stage::<DrawDetections>(&host, &json!({}), &inputs).is_ok());
        inputs.push(("truth", inventory("missed").into()));
        assert!(run_stage::<DrawDetections>(&host, &json!({}), &inputs).is_ok());
        let bare = Inventory { columns: Vec::new(), features: Vec::new(), frame: Frame::Wall };
        inputs[2].1 = bare.into();
        assert!(
            run_stage::<DrawDetections>(&host, &json!({}), &inputs)
                .unwrap_err()
                .message
                .contains("no column `outcome`")
        );
    }
}
