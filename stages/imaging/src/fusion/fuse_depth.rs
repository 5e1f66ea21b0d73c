//! `fuse-depth`: the surface of a single depth map, its grid of pixels joined to triangles.

use crate::fusion::depth_surface::{Joined, Joining, Step, join};
use rockface_core::artefact::{Depth, Kind};
use rockface_core::numerics::portable_math;
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `fuse-depth`.
    pub struct FuseDepthParams {
        /// Largest step in depth between neighbouring pixels, metres; null: by `step_factor`.
        max_step_m: Option<f64> = None; Range::Positive,
        /// Largest step in depth between neighbours, as a multiple of their distance across the view.
        step_factor: f64 = 30.0; Range::Positive,
        /// Largest angle between the normal of a triangle and the view.
        max_incidence_deg: f64 = 88.0; Range::Between(0.0, 90.0),
    }
}

/// Turns a depth map into a surface.
pub struct FuseDepth;

impl Stage for FuseDepth {
    type Params = FuseDepthParams;
    const NAME: &'static str = "fuse-depth";
    const VERSION: u32 = 3;
    const PAGE: Page = Page::new(include_str!("fuse_depth.md"));
    const INPUTS: &'static [Port] = &[Port::one("depth", &[Kind::Depth], "The depth map.")];
    const OUTPUTS: &'static [Port] = &[Port::one("surface", &[Kind::Surface], "The surface.")];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // Points and normals of the surface; measured at 2 and 45 megapixels.
        let surface = inputs.times(3.3, "depth");
        inputs.total() + surface + inputs.of_file(surface)
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let depth = inputs.one::<Depth>("depth")?;
        if depth.width < 2 || depth.height < 2 {
            fail!("the depth map has {} x {} pixels, at least 2 x 2 are needed", depth.width, depth.height);
        }
        let joining = Joining {
            step: params.max_step_m.map_or(Step::Factor(params.step_factor), Step::Metres),
            min_cosine: portable_math::cos(params.max_incidence_deg.to_radians()),
        };
        let (surface, joined) = join(depth, &joining);
        context.metric("triangles", joined.triangles as f64, "1");
        context.metric("cut_at_steps", joined.steps as f64, "1");
        context.metric("cut_at_grazing_views", joined.grazing as f64, "1");
        if joined.triangles == 0 {
            let (steps, grazing) = (joined.steps, joined.grazing);
            return Err(StageError::new(format!("no triangle is left: {steps} step in depth, {grazing} are grazed"))
                .hint(
                    "raise `step_factor`, `max_step_m` or `max_incidence_deg`; or check that the depth map has values",
                ));
        }
        warn_of_holes(context, &joined);
        Ok(Outputs::of("surface", surface))
    }
}

/// Share of triangles cut at steps above which noise rather than relief is the likely cause.
const DOUBTFUL_SHARE: f64 = 0.01;

fn warn_of_holes(context: &Context, joined: &Joined) {
    let share = joined.steps as f64 / (joined.triangles + joined.steps) as f64;
    if share > DOUBTFUL_SHARE {
        context.warn(format!(
            "{:.1} % of the triangles are cut at steps in depth; if that is noise rather than relief (a short baseline \
             makes it large), raise `step_factor`",
            100.0 * share
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::model::{Camera, full_pixel};
    use nalgebra::Vector3;
    use rockface_core::artefact::{Artefact, Frame, Noun, Sensor, Surface};
    use rockface_core::testing::{TestHost, image_at, run_stage, small_sensor};
    use serde_json::{Value, json};

    fn depth(z: impl Fn(usize, usize) -> f32) -> Depth {
        let sensor = Sensor { k: [-0.3, 0.1, 0.0, 0.0], p: [0.003, 0.0], ..small_sensor() };
        let (width, height, downscale) = (30, 20, 2);
        let z = (0..width * height).map(|i| z(i / width, i % width)).collect();
        let image = image_at("left", [1.0, 2.0, 5_000.25], [0.1, -0.2, 0.3]);
        let channels = std::collections::BTreeMap::new();
        Depth { frame: Frame::Wall, sensor, image, downscale, width, height, z, channels }
    }

    fn fuse(depth: &Depth, with: &Value, host: &TestHost) -> Result<Surface, StageError> {
        let outputs = run_stage::<FuseDepth>(host, with, &[("depth", Artefact::Depth(depth.clone()))])?.into_inner();
        Ok(Surface::of(&outputs["surface"]).unwrap().clone())
    }

    fn triangles(surface: &Surface) -> Vec<[usize; 3]> {
        let squares = (0..surface.height - 1).flat_map(|row| (0..surface.width - 1).map(move |column| (row, column)));
        squares.flat_map(|(row, column)| surface.triangles(row, column)).collect()
    }

    #[test]
    fn points_lie_on_their_rays_and_triangles_face_the_camera() {
        let depth = depth(|row, column| 20.0 + 0.01 * (row * column) as f32);
        let surface = fuse(&depth, &json!({}), &TestHost::default()).unwrap();
        let camera = Camera::of_depth(&depth);
        for (i, z) in depth.z.iter().enumerate() {
            let point = Vector3::from(surface.point(i / 30, i % 30).unwrap());
            let ray = camera.normalised(full_pixel(i % 30, i / 30, 2)).unwrap();
            assert!((point - camera.unproject(ray, f64::from(*z))).norm() < 1e-6);
        }
        let found = triangles(&surface);
        assert_eq!(found.len(), 2 * 29 * 19);
        for triangle in found {
            let [a, b, c] = triangle.map(|i| Vector3::from(surface.point(i / 30, i % 30).unwrap()));
            assert!((b - a).cross(&(c - a)).dot(&(camera.centre() - a)) > 0.0);
        }
        assert_eq!(Surface::decode(&surface.encode().unwrap()).unwrap(), surface);
    }

    #[test]
    fn steps_are_cut_and_slopes_are_not() {
        // Neighbours are 20 m / 100 px x 2 = 0.4 m apart across the view.
        let step = |metres: f32| depth(move |_, column| 20.0 + if column < 15 { 0.0 } else { metres });
        let host = TestHost::default();
        let whole = fuse(&step(3.9), &json!({"step_factor": 10}), &host).unwrap();
        assert_eq!(triangles(&whole).len(), 2 * 29 * 19);
        let cut = fuse(&step(4.1), &json!({"step_factor": 10}), &host).unwrap();
        assert_eq!(triangles(&cut).len(), 2 * 28 * 19);
        assert_eq!(host.metric("cut_at_steps"), Some(38.0));
        let cut = fuse(&step(0.5), &json!({"max_step_m": 0.4}), &host).unwrap();
        assert_eq!(triangles(&cut).len(), 2 * 28 * 19);
        // A step of 2 m over 0.4 m is seen at 78 degrees or more.
        let cut = fuse(&step(2.0), &json!({"max_incidence_deg": 70}), &host).unwrap();
        assert_eq!(triangles(&cut).len(), 2 * 28 * 19);
        assert_eq!(host.metric("cut_at_grazing_views"), Some(38.0));
    }

    #[test]
    fn a_square_without_one_corner_keeps_its_other_triangle() {
        for missing in [0, 1, 30, 31] {
            let z = move |row: usize, column: usize| if row * 30 + column == missing { f32::NAN } else { 20.0 };
            let surface = fuse(&depth(z), &json!({}), &TestHost::default()).unwrap();
            let kept: Vec<_> = surface.triangles(0, 0).collect();
            assert_eq!(kept.len(), 1);
            assert!(!kept[0].contains(&missing));
        }
    }

    #[test]
    fn the_shallower_diagonal_cuts_a_square() {
        let surface = fuse(&depth(|row, column| 20.0 + ((row + column) % 2) as f32), &json!({}), &TestHost::default());
        for square in &surface.unwrap().squares {
            assert!(*square == 3 || *square == 7);
        }
        let ridge =
            fuse(&depth(|row, column| if row + column == 1 { 20.3 } else { 20.0 }), &json!({}), &TestHost::default());
        assert_eq!(ridge.unwrap().squares[0], 3);
        let ridge = fuse(
            &depth(|row, column| if row == 0 && column == 0 { 20.3 } else { 20.0 }),
            &json!({}),
            &TestHost::default(),
        );
        assert_eq!(ridge.unwrap().squares[0], 7);
    }

    #[test]
    fn an_empty_map_is_refused_and_threads_change_nothing() {
        let empty = fuse(&depth(|_, _| f32::NAN), &json!({}), &TestHost::default());
        assert!(empty.unwrap_err().message.contains("no triangle"));
        let rough = depth(|row, column| 20.0 + ((row * 7 + column * 13) % 5) as f32 * 0.9);
        let bytes = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| fuse(&rough, &json!({}), &TestHost::default()).unwrap().encode().unwrap())
        };
        assert_eq!(bytes(1), bytes(3));
    }

    #[test]
    fn many_triangles_cut_at_steps_are_warned_of() {
        let warnings = |steps: usize| {
            let host = TestHost::default();
            let joined = Joined { triangles: 1000 - steps, steps, grazing: 0 };
            warn_of_holes(&rockface_core::Context::new(&host), &joined);
            host.warnings()
        };
        assert_eq!(warnings(9), Vec::<String>::new());
        let told = warnings(11);
        assert!(told.len() == 1 && told[0].starts_with("1.1 % of the triangles") && told[0].contains("`step_factor`"));
    }
}
