//! A command line with one more stage: `cargo run --example own_stage -- run examples/own-stage.yaml`.
//!
//! A stage is a type with parameters, ports, a page and `run`. A room lists it, and the registry that ships with rockface is
//! cloned and gets that room. Caching, sweeps, logs and reports work as for every other stage.

use rockface_core::artefact::{Kind, Raster};
use rockface_core::params::Range;
use rockface_core::{AnyStage, Context, Inputs, Outputs, Page, Port, Room, Row, Stage, StageError, params};

params! {
    /// Parameters of `tilt-raster`.
    pub struct TiltParams {
        /// Rise along the columns, degrees.
        tilt_deg: f64 = 1.0; Range::Between(-45.0, 45.0),
    }
}

/// Adds a plane to a raster, as a wrong datum would.
struct TiltRaster;

impl Stage for TiltRaster {
    type Params = TiltParams;
    const NAME: &'static str = "tilt-raster";
    const VERSION: u32 = 1;
    const PAGE: Page = Page::new(include_str!("tilt_raster.md"));
    const INPUTS: &'static [Port] = &[Port::one("raster", &[Kind::Raster], "Any raster.")];
    const OUTPUTS: &'static [Port] = &[Port::one("raster", &[Kind::Raster], "The same with a plane added.")];

    fn run(params: &Self::Params, inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mut raster: Raster = inputs.one::<Raster>("raster")?.clone();
        let grid = raster.grid;
        for band in &mut raster.bands {
            for (place, value) in band.values.iter_mut().enumerate() {
                let x_m = (place % grid.columns) as f64 * grid.cell_m;
                *value += (x_m * params.tilt_deg.to_radians()) as f32;
            }
        }
        context.headline(format!("tilted by {} degrees", params.tilt_deg));
        Ok(Outputs::of("raster", raster))
    }
}

static OWN: &[&dyn AnyStage] = &[&Row::<TiltRaster>::new()];

fn main() {
    let registry = rockface_stages::registry().clone();
    let registry = registry.with(Room { name: "own", doc: "Stages of this program alone.", stages: OWN });
    std::process::exit(rockface::program::run(&registry));
}
