//! `register-icp`: estimates the rigid motion that registers one measured surface on another.

use std::borrow::Cow;

use nalgebra::Vector3;

use crate::fusion::icp;
use crate::fusion::icp::{Registration, Settings};
use rockface_core::artefact::{Artefact, Frame, Kind, Surface, Transform};
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};
use rockface_raster::raster_surface;

choice! {
    /// What is minimised.
    pub enum IcpMethod {
        /// Distances to the tangent planes of the target.
        PointToPlane = "point_to_plane",
        /// Distances to the nearest points of the target; locks to the sampling of regular grids.
        PointToPoint = "point_to_point",
        /// Nothing: the surfaces are left as they are.
        None = "none",
    }
}

choice! {
    /// Which point of the target is the partner of a point of the source.
    pub enum IcpPairing {
        /// The nearest in X and Y: noise along Z does not choose it. For surfaces in the wall frame.
        Plan = "plan",
        /// The nearest in space: for surfaces with overhangs; slow to converge where noise exceeds the point spacing.
        Space = "space",
    }
}

params! {
    /// Parameters of `register-icp`.
    pub struct RegisterIcpParams {
        /// What is minimised.
        method: IcpMethod = IcpMethod::PointToPlane,
        /// Which points are pairs; left out, in plan for `point_to_plane` in the wall frame, in space otherwise.
        pairing: Option<IcpPairing> = None,
        /// Share of the pairs kept, the closest first.
        trim: f64 = 0.9; Range::Between(0.05, 1.0),
        /// Points further apart are no pair, metres; left out, 20 point spacings of the target.
        max_distance_m: Option<f64> = None; Range::Positive,
        /// Points of the source that are used, about (every n-th row and column).
        points: u32 = 40_000; Range::AtLeast(100.0),
        /// Iterations at most, of each of the two or three passes.
        max_iterations: u32 = 50; Range::Between(1.0, 10_000.0),
        /// Directions with a smaller eigenvalue of the normal equations, as a share of the largest, are left alone. The
        /// default stands for slopes of 10 %: matching noise tilts a plane by some 4 %, and must not hold it in place.
        weak_eigenvalue: f64 = 0.01; Range::Between(0.0, 1.0),
        /// Holds points against the surface between the points of the target, along Z, rather than against its nearest points: on a face
        /// with ledges these hold the source where it is. Left out, wherever heights can be compared: `point_to_plane`, paired in plan.
        between_points: Option<bool> = None,
    }
}

/// Finds the rigid motion that lays the source on the target.
pub struct RegisterIcp;

impl Stage for RegisterIcp {
    type Params = RegisterIcpParams;
    const NAME: &'static str = "register-icp";
    const VERSION: u32 = 6;
    const PAGE: Page = Page::new(include_str!("register_icp.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("source", &[Kind::Surface, Kind::Raster], "The surface that moves; a raster holds elevations."),
        Port::one("target", &[Kind::Surface, Kind::Raster], "The surface that stays, in the same frame."),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("transform", &[Kind::Transform], "target_from_source.")];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // Normals of two passes and the search tree of one surface; only samples of the other are matched.
        inputs.total() + inputs.total() * 3 / 4
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (source, target) = (surface(inputs, "source")?, surface(inputs, "target")?);
        if source.frame != target.frame {
            fail!("the source is in the {} frame, but the target in the {} frame", source.frame, target.frame);
        }
        let Some(settings) = settings(params, source.frame) else {
            context.headline("not registered, as asked");
            return Ok(Outputs::of("transform", Transform::identity("source", "target")));
        };
        if settings.between_points && !has_heights(settings.method, settings.pairing) {
            return Err(StageError::new(
                "`between_points` compares heights, so it needs the method `point_to_plane` and pairs in plan",
            )
            .hint("bring both surfaces into the wall frame, or leave `between_points` out"));
        }
        let registration = icp::register(&source, &target, &settings)?;
        report(&registration, context);
        Ok(Outputs::of("transform", registration.transform))
    }
}

/// A surface, or the surface of the cell centres of an elevation raster: clouds and meshes of other programs come as rasters.
fn surface<'a>(inputs: &'a Inputs, port: &str) -> Result<Cow<'a, Surface>, StageError> {
    match inputs.artefact(port)? {
        Artefact::Raster(raster) => {
            raster_surface::between_cells(raster).map(Cow::Owned).map_err(|e| e.within(format!("`{port}`")))
        }
        _ => inputs.one(port).map(Cow::Borrowed),
    }
}

/// Whether pairs have differences of height that a registration can minimise.
fn has_heights(method: icp::Method, pairing: icp::Pairing) -> bool {
    method == icp::Method::PointToPlane && pairing == icp::Pairing::InPlan
}

fn settings(params: &RegisterIcpParams, frame: Frame) -> Option<Settings> {
    let method = match params.method {
        IcpMethod::PointToPlane => icp::Method::PointToPlane,
        IcpMethod::PointToPoint => icp::Method::PointToPoint,
        IcpMethod::None => return None,
    };
    let by_plan = params.pairing.unwrap_or(match method {
        icp::Method::PointToPlane if frame == Frame::Wall => IcpPairing::Plan,
        _ => IcpPairing::Space,
    });
    let pairing = if by_plan == IcpPairing::Plan { icp::Pairing::InPlan } else { icp::Pairing::InSpace };
    Some(Settings {
        method,
        pairing,
        trim: params.trim,
        max_distance_m: params.max_distance_m,
        points: params.points as usize,
        max_iterations: params.max_iterations as usize,
        weak_eigenvalue: params.weak_eigenvalue,
        between_points: params.between_points.unwrap_or_else(|| has_heights(method, pairing)),
    })
}

/// Whether less than a hundredth of a parameter lies in directions the surface does not determine.
fn is_determined(registration: &Registration, parameter: usize) -> bool {
    registration.unobservable.iter().map(|direction| direction[parameter] * direction[parameter]).sum::<f64>() < 0.01
}

fn report(registration: &Registration, context: &Context) {
    let shift = Vector3::from(registration.transform.translation) - Vector3::from(registration.transform.origin);
    let axis_angle = nalgebra::Rotation3::from_matrix_unchecked(registration.transform.matrix()).scaled_axis();
    context.metric("rms", registration.rms_m, "m");
    context.metric("pairs", registration.pairs as f64, "1");
    context.metric("iterations", registration.iterations as f64, "1");
    for (k, axis) in ["x", "y", "z"].iter().enumerate() {
        context.metric(&format!("shift_{axis}"), shift[k], "m");
        context.metric(&format!("rotation_{axis}"), axis_angle[k].to_degrees(), "deg");
        // What the surface does not determine has no standard deviation.
        if is_determined(registration, 3 + k) {
            context.metric(&format!("shift_{axis}_sd"), registration.sd[3 + k], "m");
        }
        if is_determined(registration, k) {
            context.metric(&format!("rotation_{axis}_sd"), registration.sd[k].to_degrees(), "deg");
        }
    }
    context.metric("moved", registration.moved_m, "m");
    let spacings = registration.moved_m / registration.spacing_m;
    if spacings > icp::AUTOMATIC_SPACINGS {
        context.warn(format!(
            "the source moved by {:.3} m, {spacings:.0} point spacings of the target: errors of two surveys in one datum are smaller; check their coordinates",
            registration.moved_m
        ));
    }
    if !registration.converged {
        let n = registration.iterations;
        context.warn(format!("still moving after {n} iterations; the last step is kept (raise `max_iterations`)"));
    }
    for ([rx, ry, rz, x, y, z], [full_m, cost_m]) in registration.unobservable.iter().zip(&registration.left_alone_m) {
        let (full_mm, cost_mm) = (1e3 * full_m, 1e3 * cost_m);
        context.warn(format!(
            "the surface does not determine the direction shift ({x:.2}, {y:.2}, {z:.2}) with rotation about \
             ({rx:.2}, {ry:.2}, {rz:.2}): nothing is moved along it. Least squares would move {full_mm:.1} mm; leaving that out \
             adds {cost_mm:.2} mm rms to the differences (lower `weak_eigenvalue` to move)"
        ));
    }
    let cost = |left: &[[f64; 2]]| left.iter().map(|[_, cost]| cost * cost).sum::<f64>().sqrt();
    context.metric(
        "left_alone",
        registration.left_alone_m.iter().map(|[full, _]| full * full).sum::<f64>().sqrt(),
        "m",
    );
    context.metric("left_alone_in_difference_rms", cost(&registration.left_alone_m), "m");
    context.headline(format!(
        "moved {:.1} mm and {:.4} deg, {:.2} mm rms over {} pairs",
        1e3 * shift.norm(),
        axis_angle.norm().to_degrees(),
        1e3 * registration.rms_m,
        registration.pairs
    ));
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Artefact, Frame};
    use rockface_core::params::ParamType;
    use rockface_core::testing::TestHost;
    use serde_json::json;
    use std::sync::Arc;

    /// A flat grid at a height.
    fn flat(z: f32) -> Surface {
        let points = (0..900u16).map(|i| [f32::from(i % 30), 30.0 - f32::from(i / 30), z]).collect();
        let squares = vec![Surface::FIRST | Surface::SECOND; 29 * 29];
        Surface { frame: Frame::Wall, width: 30, height: 30, origin_m: [0.0; 3], points, squares }
    }

    fn run(with: &serde_json::Value) -> (Transform, TestHost) {
        let host = TestHost::default();
        let mut inputs = Inputs::default();
        for (port, z) in [("source", 0.25), ("target", 0.0)] {
            inputs.push(port, rockface_core::Point::new(), Arc::new(flat(z).into()));
        }
        let params = RegisterIcpParams::decode(with).unwrap();
        let outputs = RegisterIcp::run(&params, &inputs, &Context::new(&host)).unwrap();
        let Some(Artefact::Transform(transform)) = outputs.into_inner().remove("transform") else { panic!("none") };
        (transform, host)
    }

    #[test]
    fn the_motion_and_the_free_directions_are_told() {
        let (transform, host) = run(&json!({}));
        assert!((transform.translation[2] - (transform.origin[2] - 0.25)).abs() < 1e-9);
        assert!((host.metric("shift_z").unwrap() + 0.25).abs() < 1e-9);
        assert_eq!(host.warnings().iter().filter(|text| text.contains("does not determine")).count(), 3);
    }

    #[test]
    fn elevation_rasters_are_registered_like_surfaces() {
        let grid = rockface_core::artefact::Grid { columns: 80, rows: 60, cell_m: 0.05, left_m: 10.0, top_m: 20.0 };
        let relief = |shift_m: f64| {
            let z = |cell: usize| {
                let (x, y) = grid.centre(cell / 80, cell % 80);
                let bump = rockface_core::numerics::portable_math::sin(3.0 * x)
                    * rockface_core::numerics::portable_math::cos(2.0 * y);
                (0.3 * bump + shift_m) as f32
            };
            rockface_core::artefact::Raster::single(
                grid,
                Frame::Wall,
                "elevation",
                "z",
                (0..grid.cells()).map(z).collect(),
            )
        };
        let host = TestHost::default();
        let inputs = [("source", Artefact::from(relief(0.02))), ("target", Artefact::from(relief(0.0)))];
        let made = rockface_core::testing::run_stage::<RegisterIcp>(&host, &json!({}), &inputs).unwrap().into_inner();
        let Artefact::Transform(transform) = &made["transform"] else { panic!("none") };
        let moved = transform.apply(&nalgebra::Point3::new(12.0, 18.5, 0.0));
        assert!((moved - nalgebra::Point3::new(12.0, 18.5, -0.02)).norm() < 2e-3, "{moved}");
    }

    #[test]
    fn heights_are_compared_in_plan_only() {
        let run = |extra: serde_json::Value| {
            let mut params = json!({"between_points": true});
            params.as_object_mut().unwrap().extend(extra.as_object().unwrap().clone());
            let inputs = [("source", Artefact::from(flat(1.0))), ("target", Artefact::from(flat(0.0)))];
            rockface_core::testing::run_stage::<RegisterIcp>(&TestHost::default(), &params, &inputs).map(drop)
        };
        assert!(run(json!({})).is_ok());
        for extra in [json!({"pairing": "space"}), json!({"method": "point_to_point"})] {
            assert!(run(extra).unwrap_err().message.contains("needs the method `point_to_plane`"));
        }
    }

    #[test]
    fn heights_are_compared_wherever_they_can_be_unless_told_otherwise() {
        let between = |params: serde_json::Value, frame: Frame| {
            settings(&RegisterIcpParams::decode(&params).unwrap(), frame).unwrap().between_points
        };
        assert!(between(json!({}), Frame::Wall));
        assert!(between(json!({"pairing": "plan"}), Frame::World));
        assert!(!between(json!({"between_points": false}), Frame::Wall));
        assert!(!between(json!({}), Frame::World));
        assert!(!between(json!({"pairing": "space"}), Frame::Wall));
        assert!(!between(json!({"method": "point_to_point", "pairing": "plan"}), Frame::Wall));
    }

    #[test]
    fn a_motion_that_no_error_in_one_datum_explains_is_warned_of() {
        let warnings = |height: f32| {
            let host = TestHost::default();
            let inputs = [("source", Artefact::from(flat(height))), ("target", Artefact::from(flat(0.0)))];
            let params = json!({"max_distance_m": 40});
            rockface_core::testing::run_stage::<RegisterIcp>(&host, &params, &inputs).unwrap();
            host.warnings().into_iter().filter(|text| text.contains("errors of two surveys")).count()
        };
        assert_eq!([19.0, 25.0].map(warnings), [0, 1]);
    }

    #[test]
    fn none_is_the_identity() {
        assert!(run(&json!({"method": "none"})).0.is_identity());
    }
}
