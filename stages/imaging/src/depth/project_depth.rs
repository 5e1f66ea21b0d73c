//! `project-depth`: the ideal depth map of one image, exact at every pixel centre.

use rayon::prelude::*;

use crate::camera::back_side::shows_back;
use crate::camera::model::Camera;
use crate::camera::ray_row::RayRow;
use crate::depth::depth_buffer::{DepthBuffer, Drawing, NO_TRIANGLE, draw, draw_rounded, rounded, triangles};
use crate::depth::depth_update::redraw;
use rockface_core::artefact::{Cameras, Depth, Image, Kind, Mesh, Raster};
use rockface_core::numerics::quantile::upper_median;
use rockface_core::params::{Fault, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};
use rockface_raster::window;

params! {
    /// Parameters of `project-depth`.
    pub struct ProjectDepthParams {
        /// Name of the image.
        image: String,
        /// Image pixels a depth-map pixel, along each side.
        downscale: u32 = 1; Range::AtLeast(1.0),
        /// Pixels of the full image left empty along its edges.
        safe_border_px: f64 = 0.0; Range::NonNegative,
        /// Whether what faces away from the camera is no surface; if not, the nearest surface counts whichever way it faces.
        visibility: bool = true,
        /// Keeps only what lies in this part of the frame: left, right, bottom, top, metres; null: everything.
        window_m: Option<[f64; 4]> = None,
        /// Keeps so many cells of `grid` beyond its edges, for what noise moves across them.
        margin_cells: f64 = 0.0; Range::NonNegative,
        /// Whether the distance along the ray, the triangle seen and the mask of valid pixels are kept as further channels.
        channels: bool = false,
    }
}

/// Pixels a depth map may have; 45 megapixels are 4.5e7.
const MAXIMUM_PIXELS: f64 = 3e8;

/// Whole numbers a 32-bit float holds without a gap.
const MAXIMUM_TRIANGLES: usize = 1 << 24;

/// Projects a mesh into one image and keeps, at every pixel centre, the depth of the nearest triangle.
pub struct ProjectDepth;

impl Stage for ProjectDepth {
    type Params = ProjectDepthParams;
    const NAME: &'static str = "project-depth";
    const VERSION: u32 = 3;
    const PAGE: Page = Page::new(include_str!("project_depth.md"));
    const INPUTS: &'static [Port] = &[
        Port::one("mesh", &[Kind::Mesh], "The surface, counter-clockwise seen from outside the rock."),
        Port::one("cameras", &[Kind::Cameras], "The true cameras."),
        Port::optional(
            "before",
            &[Kind::Depth],
            "The depth map of `before_mesh` by this step's cameras and parameters: only what changed is drawn.",
        ),
        Port::optional("before_mesh", &[Kind::Mesh], "The mesh of `before`."),
        Port::optional(
            "grid",
            &[Kind::Raster],
            "A raster whose extent, with `margin_cells` around it, is the window; an image that sees nothing there keeps everything.",
        ),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("depth", &[Kind::Depth], "The depth map, with its true camera.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        window::faults(params.window_m)
    }

    fn memory_bytes(params: &Self::Params, inputs: &InputSizes) -> u64 {
        // The map as it is drawn from triangles by bands (with channels in double precision, with the numbers of the triangles),
        // or with its file; with `before` the triangles that changed.
        let pixels = inputs.small("cameras", |cameras: &Cameras| {
            let sensor = cameras.image(&params.image).map(|image| cameras.sensor(image));
            let side = |pixels: u32| u64::from(pixels / params.downscale.max(1));
            sensor.map_or(0, |sensor| side(sensor.width_px) * side(sensor.height_px))
        });
        let pixels = pixels.unwrap_or(0).min(1 << 50);
        let (drawn, written) = if params.channels { (20, 33) } else { (5, 9) };
        let drawing = drawn * pixels + inputs.times(2.1, "mesh");
        inputs.total() + drawing.max(written * pixels) + inputs.times(2.2, "before_mesh")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let (mesh, cameras) = (inputs.one::<Mesh>("mesh")?, inputs.one::<Cameras>("cameras")?);
        let image = checked_image(params, mesh, cameras)?;
        let camera = Camera::new(cameras.sensor(image), image);
        check_lens(&camera, image, context)?;
        let former = former(inputs, params, cameras, image)?;
        let drawing = Drawing {
            downscale: params.downscale,
            safe_border_px: params.safe_border_px,
            front_only: params.visibility,
            window_m: params.window_m.or(extent(inputs, params, cameras, former.is_some())?),
        };
        // Numbers of triangles are told by exact depths: with channels everything is drawn.
        let mut map = match former.filter(|_| !params.channels) {
            Some((depth, before)) => {
                depth_map(redrawn([before, mesh], depth, (&camera, &drawing), context)?, params, cameras, image)
            }
            None => drawn(mesh, &camera, &drawing, params, (cameras, image)),
        };
        if params.window_m.is_none() && drawing.window_m.is_some() && sees_nothing(&map) {
            map = drawn(mesh, &camera, &Drawing { window_m: None, ..drawing }, params, (cameras, image));
        }
        let Some((median_m, seen)) = upper_median(&map.z) else {
            return Err(nothing_visible(mesh, &camera, &drawing, image));
        };
        if params.visibility && shows_back(&camera, mesh) {
            let name = &image.name;
            context.warn(format!(
                "image `{name}` shows hardly anything but the back of the mesh: check frames and orientation, or turn its triangles"
            ));
        }
        context.metric("valid_share", seen as f64 / map.z.len() as f64, "1");
        context.metric("median_depth", median_m, "m");
        context.metric("pixel_footprint", median_m / camera.sensor().f * f64::from(params.downscale), "m");
        Ok(Outputs::of("depth", map))
    }
}

/// The window (left, right, bottom, top, metres) that the port `grid` says.
fn extent(
    inputs: &Inputs,
    params: &ProjectDepthParams,
    cameras: &Cameras,
    has_before: bool,
) -> Result<Option<[f64; 4]>, StageError> {
    let Some(raster) = inputs.optional::<Raster>("grid")? else { return Ok(None) };
    if params.window_m.is_some() || has_before {
        return Err(StageError::new("`grid` goes neither with `window_m` nor with `before`")
            .hint("with `before` give the extent of the grid as `window_m`, to both steps"));
    }
    if raster.frame != cameras.frame {
        let text = format!("`grid` is in the {} frame, the cameras in the {} frame", raster.frame, cameras.frame);
        return Err(StageError::new(text).hint("import rasters, mesh and cameras with the same `frame`"));
    }
    let (grid, margin_m) = (raster.grid, params.margin_cells * raster.grid.cell_m);
    let [left, right, bottom, top] = grid.extent_m();
    Ok(Some([left - margin_m, right + margin_m, bottom - margin_m, top + margin_m]))
}

/// Refuses a lens without an inverse in the middle of the image, and warns of one that folds back towards its corners.
fn check_lens(camera: &Camera, image: &Image, context: &Context) -> Result<(), StageError> {
    let (right, bottom) = (f64::from(camera.sensor().width_px) - 1.0, f64::from(camera.sensor().height_px) - 1.0);
    let advice =
        "check the signs and units of its coefficients (they are those of normalised coordinates, OpenCV's model)";
    if camera.normalised([0.5 * right, 0.5 * bottom]).is_none() {
        let error =
            StageError::new(format!("image `{}`: the lens distortion has no inverse in its middle", image.name));
        return Err(error.hint(advice));
    }
    let lost = [[0.0, 0.0], [right, 0.0], [0.0, bottom], [right, bottom]]
        .into_iter()
        .filter(|corner| camera.normalised(*corner).is_none())
        .count();
    if lost > 0 {
        let name = &image.name;
        context.warn(format!(
            "image `{name}`: the lens distortion folds back before {lost} of its 4 corners, which see nothing; {advice}"
        ));
    }
    Ok(())
}

/// The depth map and mesh to start from, where they are given.
fn former<'a>(
    inputs: &'a Inputs,
    params: &ProjectDepthParams,
    cameras: &Cameras,
    image: &Image,
) -> Result<Option<(&'a Depth, &'a Mesh)>, StageError> {
    let (depth, mesh) = (inputs.optional::<Depth>("before")?, inputs.optional::<Mesh>("before_mesh")?);
    let (depth, mesh) = match (depth, mesh) {
        (None, None) => return Ok(None),
        (Some(depth), Some(mesh)) => (depth, mesh),
        _ => fail!("`before` and `before_mesh` go together: the depth map to start from, and the mesh it shows"),
    };
    let expected = Image { sensor: 0, ..image.clone() };
    if (&depth.sensor, &depth.image) != (cameras.sensor(image), &expected) || depth.frame != cameras.frame {
        let error = StageError::new(format!("`before` is by another camera than image `{}` of `cameras`", image.name));
        return Err(error.hint("where stations are not fixed nothing can be taken over: leave `before` out"));
    }
    if depth.downscale != params.downscale {
        fail!("`before` has downscale {}, this step {}", depth.downscale, params.downscale);
    }
    Ok(Some((depth, mesh)))
}

fn redrawn(
    meshes: [&Mesh; 2],
    depth: &Depth,
    (camera, drawing): (&Camera, &Drawing),
    context: &Context,
) -> Result<Vec<f32>, StageError> {
    let Some(redrawn) = redraw(meshes, &depth.z, camera, drawing) else {
        let error = StageError::new("`before` is not what `before_mesh` looks like with the parameters of this step");
        return Err(error.hint("make both by `project-depth` with equal parameters, or leave `before` out"));
    };
    context.metric("changed_triangles", redrawn.changed_triangles as f64, "1");
    context.metric("redrawn_share", redrawn.share, "1");
    Ok(redrawn.depths_m)
}

fn checked_image<'a>(params: &ProjectDepthParams, mesh: &Mesh, cameras: &'a Cameras) -> Result<&'a Image, StageError> {
    if mesh.frame != cameras.frame {
        return Err(StageError::new(format!(
            "the mesh is in the {} frame, the cameras are in the {} frame",
            mesh.frame, cameras.frame
        ))
        .hint("bring both into one frame with `transform-crs`"));
    }
    if mesh.triangles.is_empty() {
        fail!("the mesh has {} vertices and no triangles: there is no surface to project", mesh.vertices.len());
    }
    let image = cameras.image(&params.image).ok_or_else(|| {
        let names: Vec<_> = cameras.images.iter().map(|image| image.name.as_str()).collect();
        StageError::new(format!("`cameras` has no image `{}`", params.image))
            .hint(format!("its images are: {}", names.join(", ")))
    })?;
    if params.channels && mesh.triangles.len() > MAXIMUM_TRIANGLES {
        let error = StageError::new(format!(
            "the mesh has {} triangles; a 32-bit channel tells {MAXIMUM_TRIANGLES} apart",
            mesh.triangles.len()
        ));
        return Err(error.hint("set `channels: false`, or thin the mesh"));
    }
    let sensor = cameras.sensor(image);
    if sensor.width_px.min(sensor.height_px) < params.downscale {
        let (w, h, scale) = (sensor.width_px, sensor.height_px, params.downscale);
        fail!("downscale {scale} leaves no pixel of an image of {w} x {h} pixels");
    }
    let pixels = f64::from(sensor.width_px / params.downscale) * f64::from(sensor.height_px / params.downscale);
    if pixels > MAXIMUM_PIXELS {
        let (w, h) = (sensor.width_px, sensor.height_px);
        let error = StageError::new(format!("an image of {w} x {h} pixels gives a depth map of {pixels:.1e} pixels"));
        return Err(error.hint(format!(
            "raise `downscale` (at most {MAXIMUM_PIXELS:.0e} pixels); is the sensor's size in pixels?"
        )));
    }
    Ok(image)
}

fn sees_nothing(map: &Depth) -> bool {
    !map.z.iter().any(|z| z.is_finite())
}

fn nothing_visible(mesh: &Mesh, camera: &Camera, drawing: &Drawing, image: &Image) -> StageError {
    let sees = |drawing: &Drawing| draw(mesh, camera, drawing).z_m.iter().any(|z| z.is_finite());
    let whole = Drawing { window_m: None, ..*drawing };
    if drawing.window_m.is_some() && sees(&whole) {
        let error = StageError::new(format!("image `{}` sees nothing inside `window_m`", image.name));
        return error.hint("it sees other parts of the mesh: the window is left, right, bottom, top, metres");
    }
    let error = StageError::new(format!("image `{}` sees nothing of the mesh", image.name));
    let in_front = mesh.vertices.iter().filter(|v| camera.to_camera(&(**v).into()).z > 0.0).count();
    if in_front == 0 {
        return error.hint("every vertex lies behind the camera: check its rotation and the frames");
    }
    if sees(&Drawing { front_only: false, ..whole }) {
        return error.hint("the mesh shows the camera only its back: turn its triangles, or set `visibility: false`");
    }
    error.hint(format!(
        "the mesh lies beside the image ({in_front} vertices in front of the camera), or in its safe border"
    ))
}

/// The map of a mesh that is drawn whole.
fn drawn(
    mesh: &Mesh,
    camera: &Camera,
    drawing: &Drawing,
    params: &ProjectDepthParams,
    (cameras, image): (&Cameras, &Image),
) -> Depth {
    if !params.channels {
        return depth_map(draw_rounded(mesh, camera, drawing), params, cameras, image);
    }
    let buffer = draw(mesh, camera, drawing);
    let depths_m = buffer.z_m.par_iter().map(|z_m| rounded(*z_m)).collect();
    Depth { channels: channels(&buffer, mesh, camera, drawing), ..depth_map(depths_m, params, cameras, image) }
}

fn depth_map(depths_m: Vec<f32>, params: &ProjectDepthParams, cameras: &Cameras, image: &Image) -> Depth {
    let sensor = cameras.sensor(image);
    Depth {
        frame: cameras.frame,
        sensor: sensor.clone(),
        image: Image { sensor: 0, ..image.clone() },
        downscale: params.downscale,
        width: (sensor.width_px / params.downscale) as usize,
        height: (sensor.height_px / params.downscale) as usize,
        z: depths_m,
        channels: std::collections::BTreeMap::new(),
    }
}

/// What else is known of every pixel.
fn channels(
    buffer: &DepthBuffer,
    mesh: &Mesh,
    camera: &Camera,
    drawing: &Drawing,
) -> std::collections::BTreeMap<String, Vec<f32>> {
    let seen = triangles(mesh, camera, drawing, buffer);
    let mut range = vec![f32::NAN; buffer.z_m.len()];
    for (row, (range, z_m)) in range.chunks_mut(buffer.width).zip(buffer.z_m.chunks(buffer.width)).enumerate() {
        let mut rays = RayRow::new(camera, row, drawing.downscale);
        for (column, z_m) in z_m.iter().enumerate().filter(|(_, z)| z.is_finite()) {
            let ray = rays.ray(column);
            range[column] = ray.map_or(f32::NAN, |[x, y]| (z_m * (x * x + y * y + 1.0).sqrt()) as f32);
        }
    }
    // What the window emptied has no triangle either, as the depth there is infinite.
    let number = |triangle: &u32| if *triangle == NO_TRIANGLE { f32::NAN } else { *triangle as f32 };
    let valid = buffer.z_m.iter().map(|z| f32::from(u8::from(z.is_finite()))).collect();
    let named = [("range", range), ("triangle", seen.iter().map(number).collect()), ("valid", valid)];
    named.map(|(name, values)| (name.to_owned(), values)).into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Artefact, Frame, Grid, Noun};
    use rockface_core::testing::{TestHost, height_mesh, image_at, run_stage, small_sensor};
    use serde_json::json;

    const CENTRE: [f64; 3] = [1.0, 2.0, 30.0];

    fn cameras() -> Cameras {
        let images = vec![image_at("left", CENTRE, [0.02, -0.05, 0.3]), image_at("away", CENTRE, [3.1, 0.0, 0.0])];
        Cameras { frame: Frame::Wall, sensors: vec![small_sensor()], images }
    }

    fn project(mesh: &Mesh, with: &serde_json::Value) -> Result<Depth, StageError> {
        let inputs = [("mesh", Artefact::Mesh(mesh.clone())), ("cameras", Artefact::Cameras(cameras()))];
        let outputs = run_stage::<ProjectDepth>(&TestHost::default(), with, &inputs)?.into_inner();
        Ok(Depth::of(&outputs["depth"]).unwrap().clone())
    }

    fn plane() -> Mesh {
        height_mesh(3, [-50.0, 50.0, -50.0, 50.0], |_, _| 0.0)
    }

    /// An icosahedron-like fine sphere would be a mesh again; a height field of a cap keeps the oracle simple.
    #[test]
    fn a_grid_with_its_margin_is_a_window_and_one_beside_the_image_is_none() {
        let mesh = height_mesh(20, [-50.0, 50.0, -50.0, 50.0], |x, y| 0.2 * x - 0.1 * y);
        let within = |left_m: f64, frame: Frame| {
            let grid = Grid { columns: 8, rows: 12, cell_m: 0.5, left_m, top_m: 3.0 };
            let raster = Raster::single(grid, frame, "difference", "noise", vec![0.0; 96]);
            let inputs = [
                ("mesh", Artefact::Mesh(mesh.clone())),
                ("cameras", Artefact::Cameras(cameras())),
                ("grid", Artefact::Raster(raster)),
            ];
            let with = json!({"image": "left", "margin_cells": 2});
            let outputs = run_stage::<ProjectDepth>(&TestHost::default(), &with, &inputs)?.into_inner();
            Ok::<_, StageError>(Depth::of(&outputs["depth"]).unwrap().z.clone())
        };
        let bits = |z: Vec<f32>| z.into_iter().map(f32::to_bits).collect::<Vec<_>>();
        let with = |with: serde_json::Value| bits(project(&mesh, &with).unwrap().z);
        let window = with(json!({"image": "left", "window_m": [-3.0, 3.0, -4.0, 4.0]}));
        assert_eq!(bits(within(-2.0, Frame::Wall).unwrap()), window);
        let all = with(json!({"image": "left"}));
        assert!(all != window);
        assert_eq!(bits(within(40.0, Frame::Wall).unwrap()), all);
        assert!(within(-2.0, Frame::World).unwrap_err().message.contains("`grid` is in the world frame"));
    }

    #[test]
    fn a_sphere_is_met_within_the_sagitta_of_its_facets() {
        let (radius, n, side) = (20.0f64, 400, 16.0);
        let mesh = height_mesh(n, [-side, side, -side, side], |x, y| (radius * radius - 0.5 * (x * x + y * y)).sqrt());
        // The ellipsoid z^2 + (x^2 + y^2) / 2 = r^2 is met by the ray o + t d where a t^2 + 2 b t + c = 0.
        let depth = project(&mesh, &json!({"image": "left"})).unwrap();
        let camera = Camera::of_depth(&depth);
        let spacing = 2.0 * side / f64::from(n);
        for (i, z) in depth.z.iter().enumerate() {
            let d = camera.direction(camera.normalised([(i % 60) as f64, (i / 60) as f64]).unwrap());
            let o = camera.centre();
            let a = d.z * d.z + 0.5 * (d.x * d.x + d.y * d.y);
            let b = o.z * d.z + 0.5 * (o.x * d.x + o.y * d.y);
            let c = o.z * o.z + 0.5 * (o.x * o.x + o.y * o.y) - radius * radius;
            let exact = (-b - (b * b - a * c).sqrt()) / a;
            let behind = f64::from(*z) - exact;
            assert!((-1e-6..spacing * spacing / 8.0).contains(&behind), "pixel {i}: {behind}");
        }
    }

    #[test]
    fn depths_are_the_nearest_floats_and_carry_the_camera() {
        let depth = project(&plane(), &json!({"image": "left", "downscale": 2})).unwrap();
        assert_eq!((depth.width, depth.height, depth.downscale), (30, 20, 2));
        let camera = Camera::of_depth(&depth);
        for (i, z) in depth.z.iter().enumerate() {
            let pixel = crate::camera::model::full_pixel(i % 30, i / 30, 2);
            let exact = 30.0 / -camera.direction(camera.normalised(pixel).unwrap()).z;
            assert!((f64::from(*z) - exact).abs() <= f64::from(f32::EPSILON) * 16.0, "pixel {i}");
        }
        assert_eq!(Depth::decode(&depth.encode().unwrap()).unwrap(), depth);
    }

    #[test]
    fn starting_from_the_map_before_gives_the_same_bytes() {
        let whole = |mesh: &Mesh| project(mesh, &json!({"image": "left"})).unwrap();
        let mut niche = height_mesh(80, [-50.0, 50.0, -50.0, 50.0], |_, _| 0.0);
        let flat = niche.clone();
        niche.vertices.iter_mut().filter(|v| (v[0] - 2.0).abs() < 2.0 && v[1].abs() < 2.0).for_each(|v| v[2] = -1.0);
        let start = |before: Depth, with: serde_json::Value| {
            let inputs = [
                ("mesh", Artefact::Mesh(niche.clone())),
                ("cameras", Artefact::Cameras(cameras())),
                ("before", Artefact::Depth(before)),
                ("before_mesh", Artefact::Mesh(flat.clone())),
            ];
            let outputs = run_stage::<ProjectDepth>(&TestHost::default(), &with, &inputs)?.into_inner();
            Ok::<_, StageError>(Depth::of(&outputs["depth"]).unwrap().clone())
        };
        let with = || json!({"image": "left"});
        assert_eq!(start(whole(&flat), with()).unwrap(), whole(&niche));
        assert_ne!(whole(&flat), whole(&niche));
        let mut moved = whole(&flat);
        moved.image.centre_m[0] += 1.0;
        assert!(start(moved, with()).unwrap_err().message.contains("another camera"));
        let error = start(whole(&flat), json!({"image": "left", "safe_border_px": 2})).unwrap_err();
        assert!(error.message.contains("not what `before_mesh` looks like"), "{error}");
        assert!(
            start(whole(&flat), json!({"image": "left", "downscale": 2})).unwrap_err().message.contains("downscale")
        );
    }

    #[test]
    fn a_lens_that_folds_is_told() {
        let run = |k1: f64| {
            let mut folding = cameras();
            folding.sensors[0].k[0] = k1;
            let inputs = [("mesh", Artefact::Mesh(plane())), ("cameras", Artefact::Cameras(folding))];
            let host = TestHost::default();
            run_stage::<ProjectDepth>(&host, &json!({"image": "left"}), &inputs).unwrap();
            host.warnings()
        };
        // Corners lie at a radius of 0.354: 1 + 3 k1 r^2 vanishes before that, distorted, at k1 = -4.
        assert!(run(-0.5).is_empty());
        assert!(run(-4.0)[0].contains("folds back before 4 of its 4 corners"));
    }

    #[test]
    fn channels_agree_with_the_depth_and_the_mesh() {
        let mesh = height_mesh(20, [-50.0, 50.0, -50.0, 50.0], |x, y| 0.2 * x - 0.1 * y);
        let depth =
            project(&mesh, &json!({"image": "left", "channels": true, "window_m": [-3.0, 3.0, -4.0, 4.0]})).unwrap();
        let plain = project(&mesh, &json!({"image": "left", "window_m": [-3.0, 3.0, -4.0, 4.0]})).unwrap();
        assert_eq!((plain.z == depth.z || plain.z.len() == depth.z.len(), plain.channels.len()), (true, 0));
        let camera = Camera::of_depth(&depth);
        let mut seen = 0;
        for (i, z) in depth.z.iter().enumerate() {
            let [range, triangle, valid] = ["range", "triangle", "valid"].map(|name| depth.channels[name][i]);
            assert_eq!((z.is_nan(), range.is_nan(), triangle.is_nan()), (valid == 0.0, valid == 0.0, valid == 0.0));
            if valid == 0.0 {
                continue;
            }
            let pixel = crate::camera::model::full_pixel(i % depth.width, i / depth.width, 1);
            let point = camera.unproject(camera.normalised(pixel).unwrap(), f64::from(*z));
            assert!((f64::from(range) - (point - camera.centre()).norm()).abs() < 1e-5);
            let corners = mesh.triangles[triangle as usize].map(|v| mesh.vertices[v as usize]);
            let near = |axis: usize| corners.iter().any(|corner| (corner[axis] - point[axis]).abs() <= 5.0 + 1e-5);
            assert!(near(0) && near(1), "triangle {triangle} is not where pixel {i} looks");
            seen += 1;
        }
        assert!(seen > 100);
    }

    #[test]
    fn it_says_why_it_sees_nothing() {
        let error = |mesh: &Mesh, with| project(mesh, &with).unwrap_err();
        let unknown = error(&plane(), json!({"image": "middle"}));
        assert!(unknown.message.contains("`middle`") && unknown.hint.unwrap().contains("left, away"));
        assert!(error(&plane(), json!({"image": "away"})).hint.unwrap().contains("behind the camera"));
        let mut back = plane();
        back.triangles.iter_mut().for_each(|t| t.swap(0, 1));
        assert!(error(&back, json!({"image": "left"})).hint.unwrap().contains("its back"));
        assert!(project(&back, &json!({"image": "left", "visibility": false})).is_ok());
        let aside = height_mesh(1, [100.0, 150.0, 0.0, 9.0], |_, _| 0.0);
        assert!(error(&aside, json!({"image": "left"})).hint.unwrap().contains("beside"));
        let mut other = plane();
        other.frame = Frame::World;
        assert!(error(&other, json!({"image": "left"})).message.contains("world frame"));
        other = plane();
        other.triangles.clear();
        assert!(error(&other, json!({"image": "left"})).message.contains("no triangles"));
    }
}
