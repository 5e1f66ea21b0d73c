//! `generate-blocks`: states an unbounded sequence of candidate blocks, from which blocks are drawn by number.

use serde_json::{Value, json};

use crate::rockfall::block::joints;
use crate::rockfall::block::{self, BlockError};
use rockface_core::artefact::candidates::{Class, HexKey, Modifier, Shape, Size};
use rockface_core::artefact::{Candidates, Kind, Meshes, Transform};
use rockface_core::format::distribution_file;
use rockface_core::params::{Fault, FileRef, ParamType, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

/// Candidates looked at before any is asked for.
const TRIALS: u64 = 40;
/// After so many rejected candidates and no block, one that is too fine ends the trial.
const TOO_FINE: usize = 2;

params! {
    /// The orientation of a face in the world.
    pub struct FaceOrientation {
        /// Dip of the face, degrees; 90 is vertical, more is overhanging.
        dip_deg: f64 = 90.0; Range::Between(0.0, 180.0),
        /// Direction the face looks in, clockwise from north, degrees.
        dip_direction_deg: f64; Range::Between(0.0, 360.0),
    }
}

params! {
    /// Parameters of `generate-blocks`.
    pub struct GenerateBlocksParams {
        /// The classes of blocks.
        classes: Vec<Class> = default_classes(),
        /// Applied to every block after the modifiers of its class, in this order.
        modifiers: Vec<Modifier> = Vec::new(),
        /// The orientation of the face, which joint sets are related to; null: from the input `transform`.
        face: Option<FaceOrientation> = None,
    }
}

/// The shapes of the paper in equal shares, 0.2 to 1 m, turned anyhow.
fn default_classes() -> Vec<Class> {
    let side = json!({"uniform": {"min": 0.2, "max": 1.0}});
    let class = |shape: &str| {
        json!({
            "shape": shape,
            "size": {"axes": {"length_m": side, "height_m": side, "depth_m": side}},
            "modifiers": ["tumble"],
        })
    };
    let classes: Value = ["prism", "ellipsoid", "trapezoid", "pyramid"].into_iter().map(class).collect();
    Vec::<Class>::decode(&classes).unwrap_or_default()
}

/// Defines an unbounded sequence of candidate blocks for `remove-blocks`.
pub struct GenerateBlocks;

impl Stage for GenerateBlocks {
    type Params = GenerateBlocksParams;
    const NAME: &'static str = "generate-blocks";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("generate_blocks.md"));
    const INPUTS: &'static [Port] = &[
        Port::optional("library", &[Kind::Meshes], "Blocks for classes of the shape `library`."),
        Port::optional(
            "transform",
            &[Kind::Transform],
            "wall_from_world, which joint sets are related to the wall by.",
        ),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("blocks", &[Kind::Candidates], "The sequence.")];

    fn draws(_params: &Self::Params) -> bool {
        true
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        if params.classes.iter().all(|class| class.probability == 0.0) {
            return vec![Fault::new("no class has a probability above zero").below("classes")];
        }
        let in_class = |(i, class): (usize, &Class)| {
            class_faults(class).into_iter().map(move |fault| fault.below(&i.to_string()).below("classes"))
        };
        params.classes.iter().enumerate().flat_map(in_class).collect()
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mut classes = with_files_read(&params.classes, "classes", context)?;
        let modifiers = with_files_read(&params.modifiers, "modifiers", context)?;
        classes.iter_mut().for_each(|class| class.modifiers.extend(modifiers.iter().cloned()));
        let candidates = Candidates {
            wall_from_enu: orientation(params, &classes, inputs.optional::<Transform>("transform")?)?,
            library: inputs.optional::<Meshes>("library")?.map_or_else(Vec::new, |meshes| meshes.parts.clone()),
            key: HexKey(context.stream("candidates", "")),
            classes,
        };
        check_library(&candidates)?;
        try_out(&candidates, context)?;
        Ok(Outputs::of("blocks", candidates))
    }
}

/// What the parameters of a class contradict.
fn class_faults(class: &Class) -> Vec<Fault> {
    let mut faults = Vec::new();
    let mut fault = |path: &[&str], text: String| {
        faults.push(Fault { path: path.iter().map(ToString::to_string).collect(), ..Fault::new(text) });
    };
    if let Shape::JointBlock(joints) = &class.shape
        && joints.sets.len() < 3
    {
        let message = format!("a block between joints needs three sets or more, found {}", joints.sets.len());
        fault(&["shape", "joint_block", "sets"], message);
    }
    if let Some(Size::SneedFolk(form)) = &class.size {
        let by_ratio = form.s_over_l.is_some() && form.elongation.is_some();
        let any_ratio = form.s_over_l.is_some() || form.elongation.is_some();
        if (form.class.is_none() && !by_ratio) || (form.class.is_some() && any_ratio) {
            fault(&["size", "sneed_folk"], "give either `class`, or `s_over_l` and `elongation`".into());
        }
        if form.volume_m3.is_some() == form.long_m.is_some() {
            fault(&["size", "sneed_folk"], "give either `volume_m3` or `long_m`".into());
        }
    }
    faults
}

/// The same parameters with every distribution of a file replaced by its values, and checked again with them.
fn with_files_read<T: ParamType>(params: &T, name: &str, context: &Context) -> Result<T, StageError> {
    let read = |path: &str| context.read(&FileRef(path.to_owned()));
    distribution_file::with_files_read(params, &read).map_err(|e| e.within(format!("`{name}`")))
}

/// The axes of the wall in east, north, up, where any class needs them.
fn orientation(
    params: &GenerateBlocksParams,
    classes: &[Class],
    transform: Option<&Transform>,
) -> Result<Option<[[f64; 3]; 3]>, StageError> {
    let needed = classes.iter().any(|class| matches!(class.shape, Shape::JointBlock(_) | Shape::JointWedge(_)));
    match (&params.face, transform) {
        (Some(_), Some(_)) => fail!("both an input `transform` and a parameter `face` are there: which one is meant?"),
        (Some(_), _) | (_, Some(_)) if !needed => {
            fail!("the orientation of the face is given, but no class is of the shape `joint_block` or `joint_wedge`")
        }
        (Some(face), None) => Ok(Some(joints::wall_from_enu(face.dip_deg, face.dip_direction_deg))),
        (None, Some(transform)) => Ok(Some(transform.rotation)),
        (None, None) if needed => {
            Err(StageError::new("joint sets are given in the world, but how the face lies in it is not")
                .hint("connect `transform` of `transform-crs`, or give `face: {dip_deg: 80, dip_direction_deg: 180}`"))
        }
        (None, None) => Ok(None),
    }
}

fn check_library(candidates: &Candidates) -> Result<(), StageError> {
    let uses = candidates.classes.iter().any(|class| matches!(class.shape, Shape::Library(_)));
    if !uses && !candidates.library.is_empty() {
        return Err(StageError::new("an input `library` is there, but no class is of the shape `library`")
            .hint("add a class such as `{shape: library}`, or disconnect the input"));
    }
    if uses && candidates.library.is_empty() {
        return Err(StageError::new("a class is of the shape `library`, but no `library` with blocks is connected")
            .hint("connect `import-blocks`: `in: {library: scans.blocks}`"));
    }
    Ok(())
}

/// Makes the first candidates, to tell early what would never come out.
fn try_out(candidates: &Candidates, context: &Context) -> Result<(), StageError> {
    let (mut volumes, mut triangles, mut rejected) = (Vec::new(), 0, Vec::new());
    for number in 0..TRIALS {
        context.check_cancelled()?;
        match block::candidate(candidates, number) {
            Ok(block) => {
                let volume = block.parameters.iter().rev().find(|(name, _)| name == "block_volume_m3");
                volumes.extend(volume.map(|(_, volume)| *volume));
                triangles += block.triangles.len();
            }
            Err(error) if error.reason().is_none() => fail!("candidate {number}: {error}"),
            // Each takes long to find out; where the first are all too fine, so is the specification.
            Err(error @ BlockError::TooFine { .. }) if volumes.is_empty() && rejected.len() >= TOO_FINE => {
                fail!("candidates 0 to {number}: {error}")
            }
            Err(error) => rejected.push(error.to_string()),
        }
    }
    context.metric("tried_candidates_rejected", rejected.len() as f64, "1");
    if let (Some(first), true) = (rejected.first(), volumes.is_empty()) {
        return Err(StageError::new(format!("none of the first {TRIALS} candidates is a block; the first: {first}"))
            .hint("raise `edge_m`, lower roughness or skew against the edges of the blocks, or end the modifiers with `convex_hull`"));
    }
    if let Some(first) = rejected.first() {
        context.warn(format!("{} of the first {TRIALS} candidates are rejected; the first: {first}", rejected.len()));
    }
    summarise(&mut volumes, triangles, context);
    Ok(())
}

fn summarise(volumes: &mut [f64], triangles: usize, context: &Context) {
    volumes.sort_by(f64::total_cmp);
    let middle = volumes[volumes.len() / 2];
    context.metric("median_volume", middle, "m3");
    context.metric("mean_triangles", triangles as f64 / volumes.len() as f64, "1");
    let (low, high) = (volumes[0], volumes[volumes.len() - 1]);
    context.headline(format!("blocks of {low:.2e} to {high:.2e} m3, median {middle:.2e} m3, among the first {TRIALS}"));
}

#[cfg(test)]
mod tests;
