//! `export-cloud`: the points of a surface, mesh, elevation raster or cloud for other programs, in any frame, as PLY and LAZ.

use crate::cloud_making::cloud_of;
use crate::shape::{self, Shape};
use crate::{frame_change, raster_surface};
use rockface_core::artefact::{Artefact, Kind, Raster, Transform};
use rockface_core::params::Range;
use rockface_core::{Context, Inputs, Outputs, Page, Port, Stage, StageError, fail, params};

params! {
    /// Parameters of `export-cloud`.
    pub struct ExportCloudParams {
        /// Every so many rows and columns of a surface or raster, vertices of a mesh or points of a cloud are taken; 1 takes all.
        step: u32 = 1; Range::AtLeast(1.0),
    }
}

/// Makes a point cloud of a surface, a mesh or an elevation raster.
pub struct ExportCloud;

impl Stage for ExportCloud {
    type Params = ExportCloudParams;
    const NAME: &'static str = "export-cloud";
    const VERSION: u32 = 3;
    const PAGE: Page = Page::new(include_str!("export_cloud.md"));
    const INPUTS: &'static [Port] = &[
        Port::one(
            "points",
            &[Kind::Surface, Kind::Mesh, Kind::Raster, Kind::Cloud],
            "What has points; a raster holds elevations.",
        ),
        Port::optional(
            "transform",
            &[Kind::Transform],
            "Applied to every point, such as wall_from_world for the way back.",
        ),
        Port::optional(
            "labels",
            &[Kind::Raster],
            "Numbers by place, such as those of the pieces lost, from `remove-blocks`.",
        ),
        Port::optional(
            "values",
            &[Kind::Raster],
            "Measured values by place, such as a difference: each point gets that of its cell.",
        ),
    ];
    const OUTPUTS: &'static [Port] = &[Port::one("cloud", &[Kind::Cloud], "The points, with what is known of each.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let artefact = inputs.artefact("points")?;
        let made = match artefact {
            Artefact::Raster(raster) if raster.quantity == "difference" => {
                let message = "the quantity of the raster is `difference`, and points are made of elevations";
                return Err(StageError::new(message)
                    .hint("hand over the DEM, and the difference as `values`; `quantity: elevation` of `import-rasters` says that a file is one"));
            }
            Artefact::Raster(raster) => Some(raster_surface::between_cells(raster).map_err(|e| e.within("`points`"))?),
            _ => None,
        };
        let shape = made.as_ref().map(Shape::Surface).or_else(|| Shape::of(artefact));
        let shape =
            shape.ok_or_else(|| StageError::new("port `points` needs a surface, a mesh, a raster or a cloud"))?;
        let vertices = shape::surface_vertices(artefact);
        let shape = shape.on_surface(vertices.as_deref());
        let [labels, values] = [inputs.optional::<Raster>("labels")?, inputs.optional::<Raster>("values")?];
        for (port, raster) in [("labels", labels), ("values", values)] {
            let Some(raster) = raster else { continue };
            if raster.frame != shape.frame() {
                fail!("`{port}` are in the {} frame, the points in the {} frame", raster.frame, shape.frame());
            }
            if raster.bands.len() != 1 {
                fail!("`{port}` has {} bands, one is needed", raster.bands.len());
            }
        }
        let is_label = |value: &f32| value.is_nan() || (*value >= 0.0 && value.fract() == 0.0);
        if let Some(value) = labels.and_then(|labels| labels.bands[0].values.iter().find(|value| !is_label(value))) {
            let message = format!("`labels` has the value {value}, and labels are whole numbers from 0 on");
            return Err(StageError::new(message).hint("hand over what was measured as `values`"));
        }
        let change = frame_change::change(shape.frame(), inputs.optional::<Transform>("transform")?)?;
        let cloud = cloud_of(shape, params.step as usize, labels, values, &change);
        if cloud.points.is_empty() {
            fail!("there is no point to export");
        }
        context.metric("points", cloud.points.len() as f64, "1");
        context.headline(format!("{} points in the {} frame", cloud.points.len(), cloud.frame));
        Ok(Outputs::of("cloud", cloud))
    }
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;
    use rockface_core::artefact::{Band, Cloud, Frame, Grid, Mesh};
    use rockface_core::testing::{TestHost, run_stage};
    use serde_json::json;

    fn raster(bands: usize) -> Raster {
        let grid = Grid { columns: 3, rows: 2, cell_m: 0.5, left_m: 10.0, top_m: 20.0 };
        let values = vec![1.0, 1.0, f32::NAN, 1.0, 1.0, 1.0];
        let mut raster = Raster::single(grid, Frame::Wall, "elevation", "elevation", values);
        let band = raster.bands[0].clone();
        raster.bands = vec![band; bands];
        raster
    }

    fn export(inputs: &[(&str, Artefact)]) -> Result<Cloud, StageError> {
        let made = run_stage::<ExportCloud>(&TestHost::default(), &json!({}), inputs)?;
        let Some(Artefact::Cloud(cloud)) = made.into_inner().remove("cloud") else { panic!("no cloud") };
        Ok(cloud)
    }

    #[test]
    fn cells_of_a_dem_become_points() {
        let cloud = export(&[("points", raster(1).into())]).unwrap();
        assert_eq!(cloud.numbers["id"], [0, 1, 3, 4, 5]);
        assert_eq!(cloud.points[2], [10.25, 19.25, 1.0]);
        assert!(cloud.normals.iter().all(|normal| *normal == [0.0, 0.0, 1.0]));
    }

    #[test]
    fn vertices_of_rock_that_fell_are_no_points_but_those_of_a_mesh_without_triangles_are() {
        let vertices = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.3, 0.3, 5.0], [0.0, 1.0, 0.0]];
        let mesh = |triangles| Mesh { frame: Frame::Wall, vertices: vertices.clone(), triangles, colours: Vec::new() };
        assert_eq!(export(&[("points", mesh(vec![[0, 1, 3]]).into())]).unwrap().numbers["id"], [0, 1, 3]);
        assert_eq!(export(&[("points", mesh(Vec::new()).into())]).unwrap().points, vertices);
    }

    #[test]
    fn what_cannot_be_exported_is_refused() {
        let message = |inputs: &[(&str, Artefact)]| export(inputs).unwrap_err().message;
        assert!(message(&[("points", raster(2).into())]).contains("2 bands"));
        let change = Raster { quantity: "difference".into(), ..raster(1) };
        assert!(message(&[("points", change.into())]).contains("is `difference`"));
        let world = Raster { frame: Frame::World, ..raster(1) };
        assert!(message(&[("points", raster(1).into()), ("labels", world.into())]).contains("world frame"));
        let halves = Raster { bands: vec![Band { values: vec![0.5; 6], ..raster(1).bands[0].clone() }], ..raster(1) };
        assert!(message(&[("points", raster(1).into()), ("labels", halves.into())]).contains("has the value 0.5"));
        assert!(message(&[("points", raster(1).into()), ("values", raster(2).into())]).contains("2 bands"));
        let away = Transform::identity("world", "world");
        assert!(message(&[("points", raster(1).into()), ("transform", away.into())]).contains("takes world to world"));
        assert!(message(&[("points", Cloud::new(Frame::Wall, Vec::new()).into())]).contains("no point"));
    }
}
