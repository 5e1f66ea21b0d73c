//! `transform-crs`: takes a face, its cameras and their covariance to the wall frame.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::camera::far_cameras::far_from;
use crate::camera::orientation::{cameras_to_frame, covariance_to_frame};
use rockface_core::artefact::{Cameras, Covariance, Frame, Kind, Mesh, Transform};
use rockface_core::numerics::portable_math;
use rockface_core::params::Fault;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, choice, fail, params};
use rockface_raster::plane_fit;
use rockface_raster::plane_fit::{Plane, UpSource};
use rockface_raster::shape::Moved;

/// How far a given rotation may be off orthonormal.
const ROTATION_TOLERANCE: f64 = 1e-9;
/// A direction whose cosine with the plane's normal is smaller cannot tell the two sides of the face apart.
const LEAST_COSINE: f64 = 0.02;

choice! {
    /// Where the wall frame comes from.
    pub enum FrameSource {
        /// From the best-fit plane of the mesh.
        Fit = "fit",
        /// The data is in the wall frame already, or the transform is given.
        Given = "given",
    }
}

choice! {
    /// How the best-fit plane is found.
    pub enum PlaneFit {
        /// From the least-squares plane of everything, leaving out what lies far off.
        Trimmed = "trimmed",
        /// From the plane with the least median distance: up to nearly half the area may be talus, plateau or vegetation.
        Robust = "robust",
    }
}

params! {
    /// A transform stated by the user: `p_wall = rotation (p_world - origin_m) + translation_m`.
    pub struct GivenTransform {
        /// Rows of the rotation matrix.
        rotation: [[f64; 3]; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        /// Subtracted first, metres.
        origin_m: [f64; 3] = [0.0; 3],
        /// Added last, metres.
        translation_m: [f64; 3] = [0.0; 3],
    }
}

params! {
    /// Parameters of `transform-crs`.
    pub struct TransformCrsParams {
        /// Where the wall frame comes from.
        frame: FrameSource = FrameSource::Fit,
        /// How the best-fit plane is found.
        plane: PlaneFit = PlaneFit::Trimmed,
        /// The transform for `frame: given`; left out, the data stays as it is, to the bit.
        given: Option<GivenTransform> = None,
        /// A direction out of the rock, for a mesh whose triangles or cameras do not tell.
        outward: Option<[f64; 3]> = None,
        /// The direction up.
        up: [f64; 3] = [0.0, 0.0, 1.0],
        /// Taken instead of `up` where the face is within 20 degrees of horizontal.
        fallback_up: [f64; 3] = [0.0, 1.0, 0.0],
    }
}

/// Moves a face into the wall frame, with its cameras and their covariance, and gives the transform for the way
/// back.
pub struct TransformCrs;

/// The transform of another epoch, where it fits the mesh.
fn taken(params: &TransformCrsParams, frame: Frame, earlier: &Transform) -> Result<Transform, StageError> {
    if params.given.is_some() {
        fail!("both an input `transform` and a parameter `given` are there: which one is meant?");
    }
    if earlier.from != frame.to_string() || earlier.to != Frame::Wall.to_string() {
        let (from, to) = (&earlier.from, &earlier.to);
        fail!("the transform takes {from} to {to}, but the mesh is in the {frame} frame and goes to the wall");
    }
    Ok(earlier.clone())
}

impl Stage for TransformCrs {
    type Params = TransformCrsParams;
    const NAME: &'static str = "transform-crs";
    const VERSION: u32 = 4;
    const PAGE: Page = Page::new(include_str!("transform_crs.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("mesh", &[Kind::Mesh], "The face, triangles counter-clockwise seen from outside the rock."),
        Port::optional("cameras", &[Kind::Cameras], "Cameras in the frame of the mesh."),
        Port::optional("covariance", &[Kind::Covariance], "Their covariance, in the same frame."),
        Port::optional("transform", &[Kind::Transform], "wall_from_world of another epoch: taken instead of a fit."),
    ];
    const OUTPUTS: &'static [Port] = &[
        Port::one("mesh", &[Kind::Mesh], "The face in the wall frame."),
        Port::one("transform", &[Kind::Transform], "wall_from_world."),
        Port::optional("cameras", &[Kind::Cameras], "The cameras in the wall frame."),
        Port::optional("covariance", &[Kind::Covariance], "Their covariance in the wall frame."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let mut faults = Vec::new();
        let mut fault = |path: &[&str], text: &str| {
            faults.push(Fault { path: path.iter().map(ToString::to_string).collect(), ..Fault::new(text) });
        };
        if params.given.is_some() && params.frame == FrameSource::Fit {
            fault(&["given"], "a given transform needs `frame: given`");
        }
        if params.given.as_ref().is_some_and(|given| !is_rotation(&rotation(given))) {
            fault(
                &["given", "rotation"],
                "not a rotation: rows must be orthonormal to 1e-9 (all digits) and right-handed",
            );
        }
        let directions =
            [("up", Some(params.up)), ("fallback_up", Some(params.fallback_up)), ("outward", params.outward)];
        for (name, direction) in directions {
            if direction.is_some_and(|d| Vector3::from(d).norm() == 0.0) {
                fault(&[name], "a direction cannot be zero");
            }
        }
        faults
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mesh: &Mesh = inputs.one("mesh")?;
        let cameras = inputs.optional::<Cameras>("cameras")?;
        let covariance = inputs.optional::<Covariance>("covariance")?;
        same_frame("cameras", mesh.frame, cameras.map(|c| c.frame))?;
        same_frame("covariance", mesh.frame, covariance.map(|c| c.frame))?;
        cameras.and_then(|cameras| far_from(mesh, cameras)).map_or(Ok(()), Err)?;
        let plane = match params.plane {
            PlaneFit::Trimmed => plane_fit::fit_plane(mesh),
            PlaneFit::Robust => plane_fit::fit_plane_robust(mesh),
        };
        let plane = plane.ok_or_else(|| StageError::new("the mesh has no triangle with an area"))?;
        let earlier = inputs.optional::<Transform>("transform")?;
        let wall_from_world = match (earlier, params.frame) {
            (Some(earlier), _) => taken(params, mesh.frame, earlier)?,
            (None, FrameSource::Fit) if mesh.frame == Frame::World => fitted(params, &plane, cameras, context)?,
            (None, FrameSource::Fit) => {
                let known =
                    if way_of_mesh(mesh).is_some() { "; `transform` is the one that the mesh states" } else { "" };
                context.warn(format!(
                    "the mesh is in the wall frame already: nothing was fitted, every bit is kept{known}"
                ));
                Transform::identity("world", "wall")
            }
            (None, FrameSource::Given) if mesh.frame == Frame::World && params.given.is_none() => {
                return Err(StageError::new("the mesh says it is in the world frame, and no transform is given").hint(
                    "set `frame: wall` at `import-mesh` if the data is in a wall frame; else `frame: fit`, or `given`",
                ));
            }
            (None, FrameSource::Given) if mesh.frame == Frame::Wall && params.given.is_some() => {
                return Err(StageError::new("the mesh is in the wall frame already, so there is nothing to transform")
                    .hint("leave `given` out"));
            }
            (None, FrameSource::Given) => given(params),
        };
        faces_outward(&wall_from_world, &plane)?;
        report(params, &wall_from_world, &plane, context);
        let mut outputs = Outputs::of("mesh", move_mesh(mesh, &wall_from_world));
        if let Some(cameras) = cameras {
            outputs = outputs.and("cameras", cameras_to_frame(cameras, &wall_from_world, Frame::Wall));
        }
        if let Some(covariance) = covariance {
            outputs = outputs.and("covariance", covariance_to_frame(covariance, &wall_from_world, Frame::Wall)?);
        }
        let stated = way_of_mesh(mesh).filter(|_| earlier.is_none());
        Ok(outputs.and("transform", stated.unwrap_or(wall_from_world)))
    }
}

/// How the wall frame that a mesh is in already lies in the world, where the mesh says it.
fn way_of_mesh(mesh: &Mesh) -> Option<Transform> {
    mesh.frame.wall_from_world().filter(|_| mesh.frame == Frame::Wall).cloned()
}

fn same_frame(port: &str, mesh: Frame, other: Option<Frame>) -> Result<(), StageError> {
    match other {
        Some(frame) if frame != mesh => {
            fail!("port `{port}` is in the {frame} frame, but the mesh in the {mesh} frame")
        }
        _ => Ok(()),
    }
}

fn rotation(given: &GivenTransform) -> Matrix3<f64> {
    Matrix3::from_rows(&given.rotation.map(|row| Vector3::from(row).transpose()))
}

fn is_rotation(rotation: &Matrix3<f64>) -> bool {
    let off = rotation * rotation.transpose() - Matrix3::identity();
    off.amax() <= ROTATION_TOLERANCE && rotation.determinant() > 0.0
}

fn given(params: &TransformCrsParams) -> Transform {
    params.given.as_ref().map_or_else(
        || Transform::identity("world", "wall"),
        |g| Transform::new("world", "wall", &rotation(g), g.origin_m.into(), g.translation_m.into()),
    )
}

fn fitted(
    params: &TransformCrsParams,
    plane: &Plane,
    cameras: Option<&Cameras>,
    context: &Context,
) -> Result<Transform, StageError> {
    let outward = outward_normal(params, plane, cameras)?;
    let (axes, source) =
        plane_fit::wall_axes(&outward, &params.up.into(), &params.fallback_up.into()).ok_or_else(|| {
            StageError::new("the face is nearly perpendicular to both `up` and `fallback_up`, so Y has no direction")
                .hint("set `fallback_up` to a direction within the face")
        })?;
    if source == UpSource::Fallback {
        context.note("the face is within 20 degrees of horizontal: Y is the projection of `fallback_up`");
    }
    Ok(Transform::new("world", "wall", &axes, plane.centroid, Vector3::zeros()))
}

/// The plane's normal with the sign that triangles, cameras and the user agree on.
fn outward_normal(
    params: &TransformCrsParams,
    plane: &Plane,
    cameras: Option<&Cameras>,
) -> Result<Vector3<f64>, StageError> {
    let mut witnesses = vec![("the triangles' orientation", plane.mean_normal)];
    if let Some(cameras) = cameras.filter(|c| !c.images.is_empty()) {
        let sum = cameras.images.iter().fold(Vector3::zeros(), |sum, image| sum + image.centre());
        let towards = sum / cameras.images.len() as f64 - plane.centroid;
        witnesses.push(("the direction to the cameras", towards.try_normalize(0.0).unwrap_or(towards)));
    }
    if let Some(outward) = params.outward {
        witnesses.push(("`outward`", Vector3::from(outward).normalize()));
    }
    let cosines: Vec<_> = witnesses.iter().map(|(name, d)| (*name, d.dot(&plane.normal))).collect();
    let clear: Vec<_> = cosines.iter().filter(|(_, cosine)| cosine.abs() >= LEAST_COSINE).collect();
    let Some((first, cosine)) = clear.first() else {
        return Err(StageError::new("neither triangles nor cameras tell which side of the face is outside")
            .hint("give `outward`, a direction out of the rock; a closed body is no face"));
    };
    if let Some((other, _)) = clear.iter().find(|(_, c)| c.signum() != cosine.signum()) {
        return Err(StageError::new(format!("{first} and {other} disagree about which side of the face is outside"))
            .hint("flip the triangles (CloudCompare: Edit > Normals > Invert), or correct cameras or `outward`"));
    }
    Ok(plane.normal * cosine.signum())
}

fn faces_outward(wall_from_world: &Transform, plane: &Plane) -> Result<(), StageError> {
    let z = (wall_from_world.matrix() * plane.mean_normal).z;
    if z > 0.0 {
        return Ok(());
    }
    if z > -LEAST_COSINE {
        return Err(StageError::new("the triangles face all sides alike: this is a closed body, and no face")
            .hint("keep the side of it that the cameras see, or turn all triangles of the face outward"));
    }
    let message = format!("in the wall frame the triangles' mean normal has Z = {z:.3}: they face into the rock");
    Err(StageError::new(message).hint("flip the triangles, or correct the given transform: Z points out of the rock"))
}

fn report(params: &TransformCrsParams, wall_from_world: &Transform, plane: &Plane, context: &Context) {
    let (outward, up) = (wall_from_world.matrix().row(2).transpose(), Vector3::from(params.up).normalize());
    let dip_deg = portable_math::acos(outward.dot(&up).abs().min(1.0)).to_degrees();
    if !wall_from_world.is_identity() {
        context.metric("dip", dip_deg, "deg");
    }
    context.metric("plane_rms", plane.rms_m, "m");
    context.metric("fitted_area_share", plane.fitted, "1");
    context.headline(if wall_from_world.is_identity() {
        "the data stays in its frame, to the bit".to_owned()
    } else {
        let attitude =
            if up == Vector3::z() { plane_fit::attitude(&outward) } else { format!("dips {dip_deg:.1} deg") };
        format!("face {attitude}, relief {:.3} m rms about its plane", plane.rms_m)
    });
}

fn move_mesh(mesh: &Mesh, wall_from_world: &Transform) -> Mesh {
    let mut moved = Mesh { frame: Frame::Wall, ..mesh.clone() };
    if let Some(by) = Moved::by(wall_from_world) {
        moved.vertices.par_iter_mut().for_each(|vertex| *vertex = by.apply(*vertex));
    }
    moved
}

#[cfg(test)]
mod tests;
