//! `place-blocks`: says how likely a block stands at each place of a face, for all classes of blocks or for each.

use super::removal::zone::zone_band;
use crate::rockfall::block::placement;
use crate::rockfall::block::placement::Weights;
use rockface_core::artefact::{Band, Candidates, Grid, Kind, Raster, Sample};
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

/// The band that stands for every class.
const ALL: &str = "all";

params! {
    /// The weight of a unit of a map, such as a layer of rock.
    pub struct Unit {
        /// The value its cells have in the map.
        label: u32; Range::Between(0.0, 65_535.0),
        /// How likely a block stands on a cell of it, relative to other units.
        weight: f64; Range::NonNegative,
        /// The class of blocks this holds for; null: for each class without a row of its own for this label.
        class: Option<String> = None,
    }
}

params! {
    /// Parameters of `place-blocks`.
    pub struct PlaceBlocksParams {
        /// Where `weights` is a map of labels (stratigraphy, a mask): the weight of each label; labels without a row weigh 0.
        /// Left out: the values of `weights` are the weights themselves.
        units: Vec<Unit> = Vec::new(),
    }
}

/// Makes the density that `remove-blocks` draws positions from.
pub struct PlaceBlocks;

impl Stage for PlaceBlocks {
    type Params = PlaceBlocksParams;
    const NAME: &'static str = "place-blocks";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("place_blocks.md"));
    const INPUTS: &'static [Port] = &[
        Port::one(
            "zone",
            &[Kind::Raster],
            "Where a block may stand: cells of the band `zone` (or the only one) that are not 0.",
        ),
        Port::optional(
            "weights",
            &[Kind::Raster],
            "Relative densities or labels: a band a class, or one band for all.",
        ),
        Port::optional("blocks", &[Kind::Candidates], "The blocks, so that each class is sure to have a density."),
    ];
    const OUTPUTS: &'static [Port] =
        &[Port::one("density", &[Kind::Raster], "Probability density, 1/m2: a band a class, or the band `all`.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let twin = |(i, unit): (usize, &Unit)| {
            let again = params.units[..i].iter().any(|other| (other.label, &other.class) == (unit.label, &unit.class));
            let text = || format!("label {} has a weight for this class already", unit.label);
            again.then(|| Fault::new(text()).below("label").below(&i.to_string()).below("units"))
        };
        params.units.iter().enumerate().filter_map(twin).collect()
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let zone: &Raster = inputs.one("zone")?;
        let mask = &zone_band(zone)?.values;
        let classes = inputs.optional::<Candidates>("blocks")?.map(Candidates::class_names);
        let weights = inputs.optional::<Raster>("weights")?;
        let weights = match weights {
            None if !params.units.is_empty() => {
                fail!("`units` give weights to labels, but no `weights` raster is connected")
            }
            None => vec![Weights { class: ALL.to_owned(), values: vec![1.0; mask.len()] }],
            Some(raster) => on_zone(params, zone, raster, classes.as_deref(), context)?,
        };
        if let Some(classes) = &classes {
            check_classes(&weights, classes)?;
        }
        let mut bands = Vec::with_capacity(weights.len());
        for weights in weights {
            let values =
                placement::density(&weights, mask, zone.grid.cell_m).map_err(|fault| empty(fault, &weights.class))?;
            bands.push(Band { name: weights.class, values });
        }
        report(mask, &zone.grid, &bands, context);
        let (grid, frame, quantity) = (zone.grid, zone.frame, "placement_density".to_owned());
        Ok(Outputs::of("density", Raster { grid, frame, quantity, sample: Sample::Float, bands }))
    }
}

/// The weights by class at the cells of the zone.
fn on_zone(
    params: &PlaceBlocksParams,
    zone: &Raster,
    raster: &Raster,
    classes: Option<&[String]>,
    context: &Context,
) -> Result<Vec<Weights>, StageError> {
    if zone.frame != raster.frame {
        fail!("the zone is in the {} frame, but the weights in the {} frame", zone.frame, raster.frame);
    }
    let (bands, outside) = placement::resampled(raster, &zone.grid);
    if outside == zone.grid.cells() {
        fail!("no cell of the zone lies on the raster of weights");
    }
    if outside > 0 {
        context.note(format!("{outside} cells of the zone lie beside the raster of weights: no block stands there"));
    }
    if params.units.is_empty() {
        let name = |band: &Band| placement::class_of_band(&band.name).to_owned();
        let one = bands.len() == 1 && classes.is_none_or(|classes| !classes.contains(&name(&bands[0])));
        let class = |band: &Band| if one { ALL.to_owned() } else { name(band) };
        return Ok(bands.into_iter().map(|band| Weights { class: class(&band), values: band.values }).collect());
    }
    let [labels] = bands.as_slice() else {
        fail!("`units` give weights to the labels of one band, but the raster of weights has {}", bands.len());
    };
    Ok(by_unit(&params.units, &labels.values, classes))
}

/// Weights from labels: a band for each class that is named or, where none is, one for all.
fn by_unit(units: &[Unit], labels: &[f32], classes: Option<&[String]>) -> Vec<Weights> {
    let named = units.iter().filter_map(|unit| unit.class.clone());
    let mut names: Vec<String> = if units.iter().all(|unit| unit.class.is_none()) {
        vec![ALL.to_owned()]
    } else {
        classes.map(<[String]>::to_vec).unwrap_or_default().into_iter().chain(named).collect()
    };
    let mut seen = std::collections::BTreeSet::new();
    names.retain(|name| seen.insert(name.clone()));
    let weight = |class: &str, label: f32| {
        let holds = |unit: &&Unit, of: Option<&str>| {
            (f64::from(label) - f64::from(unit.label)).abs() < 0.5 && unit.class.as_deref() == of
        };
        let own = units.iter().find(|unit| holds(unit, Some(class)));
        own.or_else(|| units.iter().find(|unit| holds(unit, None))).map_or(0.0, |unit| unit.weight as f32)
    };
    let band = |class: String| Weights { values: labels.iter().map(|label| weight(&class, *label)).collect(), class };
    names.into_iter().map(band).collect()
}

fn check_classes(weights: &[Weights], classes: &[String]) -> Result<(), StageError> {
    if matches!(weights, [only] if only.class == ALL) {
        return Ok(());
    }
    let has = |class: &String| weights.iter().any(|weights| weights.class == *class);
    if let Some(missing) = classes.iter().find(|class| !has(class)) {
        let names: Vec<&str> = weights.iter().map(|weights| weights.class.as_str()).collect();
        return Err(StageError::new(format!(
            "class `{missing}` has no weights; there are some for {}",
            names.join(", ")
        ))
        .hint("name the bands like the classes, or give one band for all"));
    }
    let known = |weights: &&Weights| !classes.contains(&weights.class);
    match weights.iter().find(known) {
        Some(stray) => {
            fail!("there are weights for `{}`, but `blocks` has the classes {}", stray.class, classes.join(", "))
        }
        None => Ok(()),
    }
}

fn empty(fault: placement::Fault, class: &str) -> StageError {
    let error = StageError::new(format!("class `{class}`: {fault}"));
    match fault {
        placement::Fault::Nowhere => {
            error.hint("check the labels of `units`, or the class's band against the safe zone")
        }
        placement::Fault::Unusable(_) => error,
    }
}

fn report(mask: &[f32], grid: &Grid, bands: &[Band], context: &Context) {
    let cell_area_m2 = grid.cell_m * grid.cell_m;
    let zone = mask.iter().filter(|value| placement::allows(**value)).count();
    context.metric("zone_area", zone as f64 * cell_area_m2, "m2");
    for band in bands {
        let used = band.values.iter().filter(|value| **value > 0.0).count();
        context.note(format!("`{}`: blocks may stand on {:.2} m2", band.name, used as f64 * cell_area_m2));
    }
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};

    use super::*;
    use rockface_core::artefact::candidates::{Class, HexKey};
    use rockface_core::artefact::{Artefact, Frame};
    use rockface_core::numerics::random::Key;
    use rockface_core::params::ParamType;
    use rockface_core::testing::{TestHost, run_stage};

    const GRID: Grid = Grid { columns: 3, rows: 2, cell_m: 0.5, left_m: 0.0, top_m: 1.0 };

    fn raster(grid: Grid, bands: &[(&str, &[f32])]) -> Artefact {
        let band = |(name, values): &(&str, &[f32])| Band { name: (*name).to_owned(), values: values.to_vec() };
        let bands = bands.iter().map(band).collect();
        Raster { grid, frame: Frame::Wall, quantity: "mask".into(), sample: Sample::Float, bands }.into()
    }

    fn zone() -> Artefact {
        raster(GRID, &[("zone", &[1.0, 1.0, 0.0, 1.0, 1.0, 0.0])])
    }

    fn blocks(names: &[&str]) -> Artefact {
        let classes: Value = names.iter().map(|name| json!({"name": name, "shape": "prism"})).collect();
        let classes = Vec::<Class>::decode(&classes).unwrap();
        Candidates { classes, wall_from_enu: None, library: Vec::new(), key: HexKey(Key([0; 32])) }.into()
    }

    fn place(with: &Value, inputs: &[(&str, Artefact)]) -> Result<Raster, StageError> {
        let mut all = vec![("zone", zone())];
        all.extend(inputs.iter().cloned());
        let outputs = run_stage::<PlaceBlocks>(&TestHost::default(), with, &all)?;
        match outputs.into_inner().remove("density") {
            Some(Artefact::Raster(raster)) => Ok(raster),
            other => panic!("{other:?}"),
        }
    }

    fn names(raster: &Raster) -> Vec<&str> {
        raster.bands.iter().map(|band| band.name.as_str()).collect()
    }

    #[test]
    fn without_weights_the_zone_is_uniform() {
        let density = place(&json!({}), &[("blocks", blocks(&["a", "b"]))]).unwrap();
        assert_eq!(names(&density), ["all"]);
        assert_eq!(density.bands[0].values, [1.0, 1.0, 0.0, 1.0, 1.0, 0.0]);
        assert_eq!((density.quantity.as_str(), density.sample), ("placement_density", Sample::Float));
    }

    #[test]
    fn weights_by_class_integrate_to_one_each() {
        let weights =
            raster(GRID, &[("a", &[1.0, 3.0, 9.0, f32::NAN, 0.0, 9.0]), ("b", &[0.0, 0.0, 1.0, 0.5, 0.5, 0.0])]);
        let density = place(&json!({}), &[("weights", weights), ("blocks", blocks(&["a", "b"]))]).unwrap();
        assert_eq!(density.bands[0].values, [1.0, 3.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(density.bands[1].values, [0.0, 0.0, 0.0, 2.0, 2.0, 0.0]);
    }

    #[test]
    fn labels_weigh_by_class_and_other_grids_are_sampled_at_centres() {
        // One coarse cell a row: label 1 above, label 2 below.
        let map = Grid { columns: 1, rows: 2, cell_m: 0.5, left_m: 0.5, top_m: 1.0 };
        let strata = || raster(map, &[("units", &[1.0, 2.0])]);
        let units = json!({"units": [{"label": 1, "weight": 1}, {"label": 2, "weight": 3, "class": "b"}, {"label": 2, "weight": 1}]});
        let density = place(&units, &[("weights", strata()), ("blocks", blocks(&["a", "b"]))]).unwrap();
        assert_eq!(names(&density), ["a", "b"]);
        assert_eq!(density.bands[0].values, [0.0, 2.0, 0.0, 0.0, 2.0, 0.0]);
        assert_eq!(density.bands[1].values, [0.0, 1.0, 0.0, 0.0, 3.0, 0.0]);
        let all = place(&json!({"units": [{"label": 1, "weight": 2}]}), &[("weights", strata())]).unwrap();
        assert_eq!((names(&all), all.bands[0].values[1]), (vec!["all"], 4.0));
    }

    #[test]
    fn each_fault_names_its_class() {
        let message = |with: &Value, inputs: &[(&str, Artefact)]| place(with, inputs).unwrap_err().message;
        let nothing = json!({});
        let weights = |values: &[f32]| ("weights", raster(GRID, &[("a", values), ("b", &[1.0; 6])]));
        assert!(message(&nothing, &[weights(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0])]).contains("class `a`"));
        assert!(message(&nothing, &[weights(&[1.0, 0.0, 1.0, -2.0, 0.0, 1.0])]).contains("-2"));
        let good = weights(&[1.0; 6]);
        assert!(
            message(&nothing, &[good.clone(), ("blocks", blocks(&["a", "c"]))]).contains("class `c` has no weights")
        );
        assert!(message(&nothing, &[good.clone(), ("blocks", blocks(&["a"]))]).contains("weights for `b`"));
        assert!(message(&json!({"units": [{"label": 1, "weight": 1}]}), &[]).contains("no `weights` raster"));
        assert!(message(&json!({"units": [{"label": 1, "weight": 1}]}), &[good]).contains("has 2"));
        let far = Grid { left_m: 100.0, ..GRID };
        assert!(message(&nothing, &[("weights", raster(far, &[("x", &[1.0; 6])]))]).contains("no cell of the zone"));
    }

    #[test]
    fn a_label_has_one_weight_a_class() {
        let with = json!({"units": [{"label": 1, "weight": 1}, {"label": 1, "weight": 2}]});
        let faults = PlaceBlocks::check(&PlaceBlocksParams::decode(&with).unwrap());
        assert_eq!(faults[0].path, ["units", "1", "label"]);
    }
}
