//! `mask-safe-zone`: where on a face a block may stand without touching borders and holes.

use crate::face::safe_zone;
use crate::face::safe_zone::{Rules, Zone};
use rockface_core::artefact::{Band, Frame, Kind, Mesh, Raster, Sample};
use rockface_core::params::Range;
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, Stage, StageError, params};

params! {
    /// Parameters of `mask-safe-zone`.
    pub struct MaskSafeZoneParams {
        /// Side of a cell, metres.
        cell_m: f64 = 0.05; Range::Positive,
        /// Least distance from the outer border and from holes, metres.
        offset_m: f64 = 0.5; Range::NonNegative,
        /// Holes whose longer side is no longer than this do not count, metres.
        hole_m: f64 = 0.0; Range::NonNegative,
    }
}

/// Marks where on a face a block may stand.
pub struct MaskSafeZone;

impl Stage for MaskSafeZone {
    type Params = MaskSafeZoneParams;
    const NAME: &'static str = "mask-safe-zone";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("mask_safe_zone.md"));
    const INPUTS: &'static [Port] = &[Port::one("mesh", &[Kind::Mesh], "The face, wall frame.")];
    const OUTPUTS: &'static [Port] =
        &[Port::one("zone", &[Kind::Raster], "Mask, band `zone`: 1 where a block may stand.")];

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // The neighbours of the triangles on the border.
        inputs.total() + inputs.times(0.65, "mesh")
    }

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mesh: &Mesh = inputs.one("mesh")?;
        if mesh.frame != Frame::Wall {
            return Err(StageError::new(format!(
                "the mesh is in the {} frame, but blocks stand on the wall",
                mesh.frame
            ))
            .hint("take it to the wall frame with `transform-crs`"));
        }
        let rules = Rules { cell_m: params.cell_m, offset_m: params.offset_m, hole_m: params.hole_m };
        let zone = safe_zone::zone(mesh, &rules).map_err(|e| e.hint("choose another `cell_m`"))?;
        report(&zone, context);
        if zone.safe_cells == 0 {
            return Err(nothing_left(&zone, params));
        }
        let values = zone.safe.iter().map(|safe| f32::from(u8::from(*safe))).collect();
        let bands = vec![Band { name: "zone".into(), values }];
        let (grid, quantity) = (zone.grid, "mask".into());
        Ok(Outputs::of("zone", Raster { grid, frame: Frame::Wall, quantity, sample: Sample::Byte, bands }))
    }
}

fn nothing_left(zone: &Zone, params: &MaskSafeZoneParams) -> StageError {
    if zone.footprint_cells == 0 {
        let text = format!("no cell of {} m has a surface at its centre", params.cell_m);
        return StageError::new(text).hint("lower `cell_m`, or look at the mesh: it may be seen edge-on");
    }
    StageError::new(format!(
        "no place is left {} m away from borders and {} holes: no point of the face is farther from them than {:.3} m",
        params.offset_m, zone.holes, zone.inmost_m
    ))
    .hint("lower `offset_m`, or raise `hole_m` so that small holes do not count")
}

fn report(zone: &Zone, context: &Context) {
    let cell_m2 = zone.grid.cell_m * zone.grid.cell_m;
    let (area_m2, face_m2) = (zone.safe_cells as f64 * cell_m2, zone.footprint_cells as f64 * cell_m2);
    context.metric("zone_area", area_m2, "m2");
    context.metric("face_area", face_m2, "m2");
    context.metric("holes", zone.holes as f64, "1");
    context.metric("small_holes", zone.small_holes as f64, "1");
    context.metric("inmost_distance", zone.inmost_m, "m");
    let share = if face_m2 > 0.0 { 100.0 * area_m2 / face_m2 } else { 0.0 };
    context
        .headline(format!("blocks may stand on {area_m2:.2} of {face_m2:.2} m2 ({share:.1} %), {} holes", zone.holes));
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Artefact, Noun};
    use rockface_core::testing::{TestHost, height_mesh, run_stage};
    use serde_json::{Value, json};

    fn run(mesh: Mesh, with: &Value) -> (Result<Raster, StageError>, TestHost) {
        let host = TestHost::default();
        let outputs = run_stage::<MaskSafeZone>(&host, with, &[("mesh", Artefact::Mesh(mesh))]);
        (outputs.map(|outputs| Raster::of(&outputs.into_inner()["zone"]).unwrap().clone()), host)
    }

    #[test]
    fn the_mask_is_one_inside_and_zero_at_the_border() {
        let mesh = height_mesh(20, [-2.0, 2.0, -1.0, 1.0], |x, _| 0.3 * x);
        let (raster, host) = run(mesh, &json!({"cell_m": 0.1, "offset_m": 0.3}));
        let raster = raster.unwrap();
        assert_eq!(
            (raster.sample, raster.quantity.as_str(), raster.bands[0].name.as_str()),
            (Sample::Byte, "mask", "zone")
        );
        let at = |x: f64, y: f64| raster.bands[0].values[raster.grid.cell_of([x, y]).unwrap()];
        let values = [at(0.05, 0.05), at(1.65, 0.05), at(1.75, 0.05), at(2.05, 0.05)];
        assert!(values.map(|value| value > 0.5) == [true, true, false, false], "{values:?}");
        assert!((host.metric("zone_area").unwrap() - 3.4 * 1.4).abs() < 1e-9);
        assert_eq!(raster.encode().and_then(|bytes| Raster::decode(&bytes)).unwrap(), raster);
    }

    #[test]
    fn no_place_left_and_other_frames_say_the_way_out() {
        let mesh = height_mesh(20, [-2.0, 2.0, -1.0, 1.0], |_, _| 0.0);
        let error = run(mesh.clone(), &json!({"cell_m": 0.1, "offset_m": 1.1})).0.unwrap_err();
        assert!(error.message.contains("no place is left 1.1 m away") && error.message.contains("0.9"), "{error}");
        let world = Mesh { frame: Frame::World, ..mesh.clone() };
        assert!(run(world, &json!({})).0.unwrap_err().hint.unwrap().contains("transform-crs"));
        let edge_on = Mesh { vertices: mesh.vertices.iter().map(|[x, y, _]| [0.0, *y, *x]).collect(), ..mesh };
        assert!(run(edge_on, &json!({})).0.unwrap_err().message.contains("has a surface"));
    }
}
