//! `synthesise-face`: makes a rock face out of nothing but a seed: fractal relief broken into blocks by a joint set.

use crate::artefact::{Frame, Kind, Mesh};
use crate::kernel::relief::{self, JointSet, Lattice};
use crate::params::{Fault, Range};
use crate::{Context, Inputs, Outputs, Page, Port, Stage, StageError, params};

/// Vertices a face may have.
const MAXIMUM_VERTICES: f64 = 1e8;

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
        /// Hurst exponent of the relief: near 0 rugged, near 1 smooth.
        hurst: f64 = 0.8; Range::Between(0.0, 1.0),
        /// Dip of the joints below the horizontal, degrees.
        joint_dip_deg: f64 = 58.0; Range::Between(0.0, 90.0),
        /// Horizontal direction in which the joints dip, degrees from straight out of the face towards X.
        joint_direction_deg: f64 = 35.0; Range::Between(-180.0, 180.0),
        /// Mean distance of neighbouring joints, metres.
        joint_spacing_m: f64 = 0.9; Range::Positive,
        /// Blocks stand out of the relief by 0 to this much, metres; 0 for a face without joints.
        joint_step_m: f64 = 0.2; Range::NonNegative,
    }
}

/// The stage.
pub struct SynthesiseFace;

impl Stage for SynthesiseFace {
    type Params = SynthesiseFaceParams;
    const NAME: &'static str = "synthesise-face";
    const VERSION: u32 = 1;
    const PAGE: Page = Page {
        what: "Makes a rock face where none was surveyed: self-affine relief, broken by one joint set into blocks that \
               stand out by different amounts. A 2.5D grid mesh with its mean elevation at zero.",
        method: "Sum of octaves of cubic B-spline noise with amplitude ~ wavelength^H (Musgrave 1993), without tilt and \
                 scaled to the asked root mean square. The joints' slabs, irregularly spaced and cut along strike, are \
                 raised by uniform draws; the face is the upper envelope of the slabs, so steps lie on joint planes.",
        frames: "Wall frame, metres: X to the right, Y up, Z out of the rock; triangles counter-clockwise seen from +Z.",
        fails: "The face would have fewer than 2 x 2 or more than 1e8 vertices; blocks stand out further than the joints \
                are apart.",
        example: "rockface: 1\nname: a-face\nseed: 2747\nsteps:\n  face:\n    stage: synthesise-face\n    \
                  with: {width_m: 4, height_m: 3, spacing_m: 0.05, joint_step_m: 0.3}\n",
    };
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The face, wall frame.")];

    fn draws(_params: &Self::Params) -> bool {
        true
    }

    fn check(params: &Self::Params) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut fault = |name: &str, text: String| {
            faults.push(Fault { path: vec![name.to_owned()], ..Fault::new(text) });
        };
        let (columns, rows) = vertices(params);
        if columns < 2.0 || rows < 2.0 || columns * rows > MAXIMUM_VERTICES {
            fault(
                "spacing_m",
                format!("{columns} x {rows} vertices: a face has 2 x 2 to {MAXIMUM_VERTICES:e} of them"),
            );
        }
        if params.joint_step_m > params.joint_spacing_m {
            let (step, spacing) = (params.joint_step_m, params.joint_spacing_m);
            fault(
                "joint_step_m",
                format!("{step} m is more than the joints are apart (`joint_spacing_m`: {spacing} m)"),
            );
        }
        faults
    }

    fn run(params: &Self::Params, _inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (columns, rows) = vertices(params);
        let lattice = Lattice { columns: columns as usize, rows: rows as usize, spacing_m: params.spacing_m };
        let noise = context.stream("relief", "").field();
        let mut heights = relief::fractal(&lattice, params.relief_m, params.hurst, &noise);
        context.check_cancelled()?;
        if params.joint_step_m > 0.0 {
            let noise = context.stream("joints", "").field();
            relief::break_along_joints(&lattice, &joints(params), &noise, &mut heights);
        }
        let mean = heights.iter().sum::<f64>() / heights.len() as f64;
        for z in &mut heights {
            *z -= mean;
        }
        let rms = (heights.iter().fold(0.0, |sum, z| sum + z * z) / heights.len() as f64).sqrt();
        context.metric("vertices", heights.len() as f64, "1");
        context.metric("relief_rms", rms, "m");
        context.headline(format!("{} x {} vertices, relief {rms:.3} m rms", lattice.columns, lattice.rows));
        Ok(Outputs::of("mesh", to_mesh(&lattice, &heights)))
    }
}

/// Columns and rows of vertices.
fn vertices(params: &SynthesiseFaceParams) -> (f64, f64) {
    let count = |length_m: f64| (length_m / params.spacing_m).round() + 1.0;
    (count(params.width_m), count(params.height_m))
}

fn joints(params: &SynthesiseFaceParams) -> JointSet {
    JointSet {
        dip_rad: params.joint_dip_deg.to_radians(),
        direction_rad: params.joint_direction_deg.to_radians(),
        spacing_m: params.joint_spacing_m,
        step_m: params.joint_step_m,
    }
}

/// Triangles over the grid, each square cut along the diagonal with the smaller height difference.
fn to_mesh(lattice: &Lattice, heights: &[f64]) -> Mesh {
    let w = lattice.columns;
    let place = |i: usize| [lattice.x(i % w), lattice.y(i / w), heights[i]];
    let mut triangles = Vec::with_capacity(2 * (w - 1) * (lattice.rows - 1));
    for row in 0..lattice.rows - 1 {
        for a in row * w..row * w + w - 1 {
            let (b, c, d) = (a + 1, a + w + 1, a + w);
            let along_ac = (heights[a] - heights[c]).abs() <= (heights[b] - heights[d]).abs();
            let pair = if along_ac { [[a, d, c], [a, c, b]] } else { [[a, d, b], [b, d, c]] };
            triangles.extend(pair.map(|t| t.map(|i| i as u32)));
        }
    }
    Mesh { frame: Frame::Wall, vertices: (0..heights.len()).map(place).collect(), triangles, colours: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::artefact::Artefact;
    use crate::kernel::mesh_check::{EdgeReport, check_edges};
    use crate::params::ParamType;
    use crate::testing::TestHost;
    use serde_json::json;

    fn face(with: &serde_json::Value) -> Mesh {
        let params = SynthesiseFaceParams::decode(with).unwrap();
        let host = TestHost::default();
        let outputs = SynthesiseFace::run(&params, &Inputs::default(), &Context::new(&host)).unwrap();
        let Some(Artefact::Mesh(mesh)) = outputs.into_inner().remove("mesh") else { panic!("no mesh") };
        mesh
    }

    #[test]
    fn the_mesh_is_a_proper_sheet_facing_the_viewer() {
        let mesh = face(&json!({"width_m": 2, "height_m": 1.5, "spacing_m": 0.05}));
        assert_eq!((mesh.vertices.len(), mesh.triangles.len()), (41 * 31, 2 * 40 * 30));
        assert_eq!(check_edges(&mesh), EdgeReport { boundary: 140, ..EdgeReport::default() });
        let at = |i: u32| nalgebra::Vector3::from(mesh.vertices[i as usize]);
        let up = |t: &[u32; 3]| (at(t[1]) - at(t[0])).cross(&(at(t[2]) - at(t[0]))).z > 0.0;
        assert!(mesh.triangles.iter().all(up));
        let mean = mesh.vertices.iter().map(|v| v[2]).sum::<f64>();
        assert!(mean.abs() < 1e-9);
    }

    #[test]
    fn the_bytes_do_not_depend_on_the_number_of_threads() {
        let with = json!({"width_m": 3, "height_m": 2, "spacing_m": 0.04});
        let at =
            |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(|| face(&with));
        assert_eq!(at(1), at(3));
    }

    #[test]
    fn impossible_faces_are_faults_of_the_parameters() {
        let faults = |with| SynthesiseFace::check(&SynthesiseFaceParams::decode(&with).unwrap());
        assert_eq!(faults(json!({"spacing_m": 1e-4}))[0].path, ["spacing_m"]);
        assert_eq!(faults(json!({"joint_spacing_m": 0.1}))[0].path, ["joint_step_m"]);
        assert!(faults(json!({})).is_empty());
    }
}
