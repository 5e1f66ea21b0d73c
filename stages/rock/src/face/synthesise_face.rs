//! `synthesise-face`: makes a rock face out of nothing but a seed: relief broken into blocks by joints and beds.

use crate::face::block_relief::{BlockRelief, Fallen, JointSet, StepLaw};
use crate::face::relief;
use crate::face::relief::Lattice;
use rockface_core::artefact::{Kind, Mesh};
use rockface_core::numerics::random::Field;
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, choice, params};

/// Vertices a face may have.
const MAXIMUM_VERTICES: f64 = 1e8;
/// Joints of a set there may be across a face.
const MAXIMUM_JOINTS: f64 = 1e6;
/// Length of a block along the strike where none is given, in joint spacings.
const BLOCK_LENGTH: f64 = 1.7;
/// Side of the patches in which a joint is there or not, in joint spacings.
const TRACE_LENGTH: f64 = 2.6;

choice! {
    /// How the steps of blocks are distributed.
    pub enum Steps {
        /// Everything from 0 to `step_m` is equally likely.
        Uniform = "uniform",
        /// Most blocks stand out little, few far: exponential, cut off at `step_m`.
        Exponential = "exponential",
    }
}

params! {
    /// A set of parallel joints.
    pub struct JointSetParams {
        /// Dip below the horizontal, degrees.
        dip_deg: f64 = 58.0; Range::Between(0.0, 90.0),
        /// Horizontal direction of dip, degrees from straight out of the face towards X: 0 dips towards the viewer, 180 into
        /// the rock.
        direction_deg: f64 = 35.0; Range::Between(-180.0, 180.0),
        /// Mean distance of neighbouring joints, metres.
        spacing_m: f64 = 0.9; Range::Positive,
        /// Share of the spacing by which a joint may lie off its regular place, to either side.
        spread: f64 = 0.35; Range::Between(0.0, 0.49),
        /// Blocks between two joints stand out of the relief by 0 to this much, metres.
        step_m: f64 = 0.2; Range::NonNegative,
        /// How that is distributed.
        steps: Steps = Steps::Uniform,
        /// Length along strike after which blocks end, metres; left out, 1.7 spacings.
        block_length_m: Option<f64> = None; Range::Positive,
        /// Share of its area on which a joint is open; elsewhere the blocks on both sides are one.
        persistence: f64 = 1.0; Range::Between(0.05, 1.0),
    }
}

params! {
    /// Beds: layers that run through the whole face, each standing out by its own amount.
    pub struct BeddingParams {
        /// Dip below the horizontal, degrees.
        dip_deg: f64 = 8.0; Range::Between(0.0, 90.0),
        /// Horizontal direction of dip, degrees from straight out of the face towards X.
        direction_deg: f64 = 90.0; Range::Between(-180.0, 180.0),
        /// Mean thickness of a bed, metres.
        thickness_m: f64 = 0.6; Range::Positive,
        /// Share of the thickness by which a bed's base may lie off its regular place, to either side.
        spread: f64 = 0.45; Range::Between(0.0, 0.49),
        /// Beds stand out by 0 to this much, metres.
        step_m: f64 = 0.15; Range::NonNegative,
        /// How that is distributed.
        steps: Steps = Steps::Uniform,
    }
}

params! {
    /// Parameters of `synthesise-face`.
    pub struct SynthesiseFaceParams {
        /// Width of the face (X), metres.
        width_m: f64 = 12.0; Range::Positive,
        /// Height of the face (Y), metres.
        height_m: f64 = 9.0; Range::Positive,
        /// Distance of neighbouring vertices, metres.
        spacing_m: f64 = 0.02; Range::Positive,
        /// Root mean square of the fractal relief before it is broken into blocks, metres.
        relief_m: f64 = 0.12; Range::NonNegative,
        /// Hurst exponent of relief and roughness: near 0 rugged, near 1 smooth.
        hurst: f64 = 0.8; Range::Between(0.0, 1.0),
        /// Joint sets, each with its own keys; `[]` for a face without joints.
        joints: Vec<JointSetParams> = vec![JointSetParams::default()],
        /// Beds; left out, none.
        bedding: Option<BeddingParams> = None,
        /// Share of the blocks that have fallen out, down to the joints behind them.
        fallen_share: f64 = 0.0; Range::Between(0.0, 0.6),
        /// How far behind the relief niches of fallen blocks end at most, metres.
        fallen_depth_m: f64 = 0.5; Range::NonNegative,
        /// Undersides of blocks overhang by up to this angle from the way out of the face, degrees; 0 for a face that hides
        /// nothing from the front.
        overhang_deg: f64 = 0.0; Range::Between(0.0, 60.0),
        /// Edges are worn over this distance (standard deviation of a bell), metres.
        wear_m: f64 = 0.0; Range::NonNegative,
        /// Root mean square of the texture on blocks and joints, metres.
        roughness_m: f64 = 0.0; Range::NonNegative,
        /// Longest wavelength of the texture, metres.
        roughness_wavelength_m: f64 = 0.4; Range::Positive,
    }
}

/// Makes a synthetic rock face.
pub struct SynthesiseFace;

impl Stage for SynthesiseFace {
    type Params = SynthesiseFaceParams;
    const NAME: &'static str = "synthesise-face";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("synthesise_face.md"));
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The face, wall frame.")];

    fn draws(_params: &Self::Params) -> bool {
        true
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut fault = |path: &[&str], text: String| {
            faults.push(Fault { path: path.iter().map(ToString::to_string).collect(), ..Fault::new(text) });
        };
        let (columns, rows) = vertices(params);
        if columns < 2.0 || rows < 2.0 || columns * rows > MAXIMUM_VERTICES {
            let text = format!("{columns} x {rows} vertices: a face has 2 x 2 to {MAXIMUM_VERTICES:e} of them");
            fault(&["spacing_m"], text);
        }
        if params.fallen_share > 0.0 && params.fallen_depth_m == 0.0 {
            fault(&["fallen_depth_m"], "fallen blocks leave niches of some depth".into());
        }
        for (number, set) in params.joints.iter().enumerate() {
            if let Some((name, text)) = impossible(params, ("spacing_m", set.spacing_m), set.step_m) {
                fault(&["joints", &number.to_string(), name], text);
            }
        }
        let beds = params.bedding.as_ref();
        if let Some((name, text)) = beds.and_then(|b| impossible(params, ("thickness_m", b.thickness_m), b.step_m)) {
            fault(&["bedding", name], text);
        }
        faults
    }

    fn memory_bytes(params: &Self::Params, _inputs: &InputSizes) -> u64 {
        // Two triangles a vertex, as they are made and as they are written.
        let vertices = params.width_m / params.spacing_m * params.height_m / params.spacing_m;
        (110.0 * vertices) as u64
    }

    fn run(params: &Self::Params, _inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (columns, rows) = vertices(params);
        let lattice = Lattice { columns: columns as usize, rows: rows as usize, spacing_m: params.spacing_m };
        let noise = context.stream("relief", "").field();
        let mut heights = relief::fractal(&lattice, params.relief_m, params.hurst, &noise);
        context.check_cancelled()?;
        let noise = context.stream("fallen", "").field();
        let fallen = Fallen { share: params.fallen_share, depth_m: params.fallen_depth_m, noise };
        let fallen = (params.fallen_share > 0.0).then_some(fallen);
        let overhang_rad = params.overhang_deg.to_radians();
        BlockRelief::new(&joint_sets(params, context), overhang_rad, fallen).raise(&lattice, &mut heights);
        relief::wear(&lattice, params.wear_m, &mut heights);
        context.check_cancelled()?;
        if params.roughness_m > 0.0 {
            roughen(params, &lattice, &context.stream("roughness", "").field(), &mut heights);
        }
        let mean = heights.iter().sum::<f64>() / heights.len() as f64;
        for z in &mut heights {
            *z -= mean;
        }
        let mesh = relief::to_mesh(&lattice, &heights, rockface_core::numerics::portable_math::tan(overhang_rad));
        report(&mesh, &lattice, context);
        Ok(Outputs::of("mesh", mesh))
    }
}

/// Columns and rows of vertices.
fn vertices(params: &SynthesiseFaceParams) -> (f64, f64) {
    let count = |length_m: f64| (length_m / params.spacing_m).round() + 1.0;
    (count(params.width_m), count(params.height_m))
}

/// What is wrong with a set whose joints are so far apart and whose blocks stand out so much.
fn impossible(
    params: &SynthesiseFaceParams,
    (name, apart_m): (&'static str, f64),
    step_m: f64,
) -> Option<(&'static str, String)> {
    let across = (params.width_m + params.height_m) / apart_m;
    if across > MAXIMUM_JOINTS {
        return Some((name, format!("{across:.1e} joints across the face are more than {MAXIMUM_JOINTS:e}")));
    }
    (step_m > apart_m)
        .then(|| ("step_m", format!("{step_m} m is more than the joints are apart (`{name}`: {apart_m} m)")))
}

/// Joint sets, the beds last, each with its draws.
fn joint_sets(params: &SynthesiseFaceParams, context: &Context) -> Vec<(JointSet, Field)> {
    // The first set has the stream's plain name.
    let stream = |number: usize| if number == 0 { String::new() } else { number.to_string() };
    let joints = params.joints.iter().enumerate().filter(|(_, set)| set.step_m > 0.0 || params.fallen_share > 0.0);
    let joints = joints.map(|(number, set)| (joint_set(set), context.stream("joints", &stream(number)).field()));
    let beds = params.bedding.iter().map(|bedding| (beds(bedding), context.stream("bedding", "").field()));
    joints.chain(beds).collect()
}

fn joint_set(set: &JointSetParams) -> JointSet {
    JointSet {
        dip_rad: set.dip_deg.to_radians(),
        direction_rad: set.direction_deg.to_radians(),
        spacing_m: set.spacing_m,
        spread: set.spread,
        block_length_m: set.block_length_m.unwrap_or(BLOCK_LENGTH * set.spacing_m),
        persistence: set.persistence,
        trace_length_m: TRACE_LENGTH * set.spacing_m,
        step_m: set.step_m,
        law: law(set.steps),
    }
}

fn beds(bedding: &BeddingParams) -> JointSet {
    JointSet {
        dip_rad: bedding.dip_deg.to_radians(),
        direction_rad: bedding.direction_deg.to_radians(),
        spacing_m: bedding.thickness_m,
        spread: bedding.spread,
        block_length_m: f64::INFINITY,
        persistence: 1.0,
        trace_length_m: TRACE_LENGTH * bedding.thickness_m,
        step_m: bedding.step_m,
        law: law(bedding.steps),
    }
}

fn law(steps: Steps) -> StepLaw {
    match steps {
        Steps::Uniform => StepLaw::Uniform,
        Steps::Exponential => StepLaw::Exponential,
    }
}

fn roughen(params: &SynthesiseFaceParams, lattice: &Lattice, noise: &Field, heights: &mut [f64]) {
    let longest_m = params.roughness_wavelength_m;
    let texture = relief::fractal_up_to(lattice, longest_m, params.roughness_m, params.hurst, noise);
    for (z, rough) in heights.iter_mut().zip(texture) {
        *z += rough;
    }
}

fn report(mesh: &Mesh, lattice: &Lattice, context: &Context) {
    let vertices = mesh.vertices.len() as f64;
    let rms = (mesh.vertices.iter().fold(0.0, |sum, v| sum + v[2] * v[2]) / vertices).sqrt();
    let back = |t: &&[u32; 3]| {
        let [a, b, c] = t.map(|i| mesh.vertices[i as usize]);
        (b[0] - a[0]) * (c[1] - a[1]) < (b[1] - a[1]) * (c[0] - a[0])
    };
    let overhanging = mesh.triangles.iter().filter(back).count();
    context.metric("vertices", vertices, "1");
    context.metric("triangles", mesh.triangles.len() as f64, "1");
    context.metric("overhanging_triangles", overhanging as f64, "1");
    context.metric("relief_rms", rms, "m");
    context.headline(format!("{} x {} vertices, relief {rms:.3} m rms", lattice.columns, lattice.rows));
}

#[cfg(test)]
mod tests;
