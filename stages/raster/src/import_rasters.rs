//! `import-rasters`: reads a folder of GeoTIFF files on one grid into one raster with a band a file.

use std::io::Read;

use crate::grid;
use crate::strange_values::{impossible_differences, is_same, undeclared_elevations, written};
use rockface_core::artefact::{CodecError, Frame, Kind, Noun, Raster, Sample};
use rockface_core::crs::{self, CrsName, Settled, Tool, settle, wall_without_system};
use rockface_core::format::geotiff::{self, DAMAGED, System};
use rockface_core::names::twice;
use rockface_core::numerics::marginal;
use rockface_core::params::{Fault, FilesRef, Range};
use rockface_core::{Context, InputSizes, Inputs, Outputs, Page, Port, SourceFile, Stage, StageError, choice, params};

choice! {
    /// The frame of imported grids.
    pub enum GridFrame {
        /// The one the files state: world where they have a coordinate reference system, otherwise wall.
        Automatic = "automatic",
        /// X along the face, Y up the face.
        Wall = "wall",
        /// The coordinate reference system of the files.
        World = "world",
    }
}

params! {
    /// Parameters of `import-rasters`.
    pub struct ImportRastersParams {
        /// A folder, a file, or a pattern such as `real/*.tif`.
        path: FilesRef,
        /// What the values are: `difference`, `elevation`, `mask`, ...; lengths in metres.
        quantity: String = "difference".to_owned(),
        /// The frame X and Y of the files are in.
        frame: GridFrame = GridFrame::Automatic,
        /// The coordinate reference system of files that state none: `EPSG:28356`.
        crs: Option<CrsName> = None,
        /// Values of the files that stand for no value, besides the one that a file declares: `[-9999]`. Compared after scale and
        /// offset of the file, and before feet are converted.
        nodata: Vec<f64> = Vec::new(),
        /// Larger values are outliers and left out; left out: none are.
        max_abs: Option<f64> = None; Range::Positive,
    }
}

/// Differences of one survey rarely scatter by more than this, metres.
const LARGEST_USUAL_DEVIATION_M: f64 = 1.0;

/// Reads GeoTIFF files, such as the difference rasters of real surveys without rockfall, into one raster.
pub struct ImportRasters;

impl Stage for ImportRasters {
    type Params = ImportRastersParams;
    const NAME: &'static str = "import-rasters";
    const VERSION: u32 = 7;
    const PAGE: Page = Page::new(include_str!("import_rasters.md"));
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] =
        &[Port::one("raster", &[Kind::Raster], "All files on their common grid, one band a file.")];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let is_wall = params.frame == GridFrame::Wall;
        params.crs.as_ref().and_then(|_| wall_without_system(is_wall)).into_iter().collect()
    }

    fn memory_bytes(_: &Self::Params, inputs: &InputSizes) -> u64 {
        // The bands, as they are read, as they are kept, and their file.
        inputs.total() * 26 / 10
    }

    fn run(params: &Self::Params, _inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mut all: Option<(String, Raster)> = None;
        let mut systems = Vec::new();
        for mut file in context.files(&params.path)? {
            context.check_cancelled()?;
            let raster = read(&mut file, params, context, &mut systems)?;
            match &mut all {
                None => all = Some((file.name, raster)),
                Some((first, together)) => append(first, together, &file.name, raster)?,
            }
        }
        let Some((_, mut raster)) = all else {
            return Err(StageError::new(format!("`{}` names no file", params.path.0))
                .hint("give a folder that holds GeoTIFFs, or a pattern such as `real/*.tif`"));
        };
        refuse_twins(&raster)?;
        if let [first, others @ ..] = systems.as_slice() {
            let others =
                if others.is_empty() { String::new() } else { format!(", and so do {} more files", others.len()) };
            context.warn(format!("{first}{others}; but `frame: wall` is given: their system is left out"));
        }
        raster.quantity.clone_from(&params.quantity);
        if params.quantity == "difference" {
            warn_of_strange_differences(&raster, context);
        }
        if let Some(limit) = params.max_abs {
            leave_outliers_out(&mut raster, limit, context)?;
        }
        context.note(format!("{} bands on {}", raster.bands.len(), grid::describe(&raster.grid)));
        Ok(Outputs::of("raster", raster))
    }
}

/// The fault of the bytes of a file.
fn unreadable(name: &str, error: &CodecError) -> StageError {
    let fault = StageError::new(format!("`{name}`: {error}"));
    // These name their own way out.
    if error.0.starts_with(DAMAGED) || error.0.contains("north up") {
        fault
    } else {
        fault.hint("a pattern such as `folder/a*.tif` leaves other files out")
    }
}

/// The frame of a file, and what makes metres of its numbers; `left_out` gets a system that the file states for nothing.
fn settled(
    name: &str,
    system: System,
    params: &ImportRastersParams,
    context: &Context,
    left_out: &mut Vec<String>,
) -> Result<(Frame, Settled), StageError> {
    let is_local = |stated: &crs::Stated| stated.kind == crs::Kind::Local;
    let has_system = params.crs.is_some() || system.stated.as_ref().is_some_and(|stated| !is_local(stated));
    let own = system.frame.unwrap_or(if has_system { Frame::World } else { Frame::Wall });
    let is_wall = match params.frame {
        GridFrame::Automatic => own == Frame::Wall && params.crs.is_none(),
        GridFrame::Wall => true,
        GridFrame::World => false,
    };
    if !is_wall {
        let about = (Tool::Gdal, system.corner);
        let settled = settle(name, [system.stated, None], params.crs.as_ref(), about, context)?;
        return Ok((settled.frame(), settled));
    }
    let frame = system.frame.filter(|frame| *frame == Frame::Wall).unwrap_or(Frame::Wall);
    let Some(stated) = system.stated else { return Ok((frame, Settled::metres())) };
    if is_local(&stated) {
        return Ok((frame, settle(name, [Some(stated), None], None, (Tool::Gdal, system.corner), context)?));
    }
    left_out.push(format!("`{name}` states {}", stated.name));
    Ok((frame, Settled::metres()))
}

/// One file in metres, its bands named after it.
fn read(
    file: &mut SourceFile,
    params: &ImportRastersParams,
    context: &Context,
    systems: &mut Vec<String>,
) -> Result<Raster, StageError> {
    let name = file.name.clone();
    let mut bytes = Vec::new();
    file.reader.read_to_end(&mut bytes).map_err(|e| StageError::new(format!("cannot read `{name}`: {e}")))?;
    let system = geotiff::read_system(&bytes).map_err(|e| unreadable(&name, &e))?;
    let (frame, settled) = settled(&name, system, params, context, systems)?;
    let mut raster = Raster::decode(&bytes).map_err(|e| unreadable(&name, &e))?;
    raster.frame = frame;
    leave_no_data_out(&mut raster, &params.nodata);
    if params.quantity == "elevation" {
        warn_of_undeclared(&name, &raster, context);
    }
    to_metres(&mut raster, &settled, &params.quantity);
    let stem = name.rsplit_once('.').map_or(name.as_str(), |(stem, _)| stem);
    let single = raster.bands.len() == 1;
    for band in &mut raster.bands {
        if band.values.iter().all(|v| v.is_nan()) {
            return Err(StageError::new(format!("`{name}`: band `{}` has no value in any of its cells", band.name))
                .hint("leave the file out (a pattern such as `folder/a*.tif` does), or export it again"));
        }
        band.name = if single { stem.to_owned() } else { format!("{stem}.{}", band.name) };
    }
    Ok(raster)
}

/// Takes the values away that stand for none.
fn leave_no_data_out(raster: &mut Raster, nodata: &[f64]) {
    let is_none = |value: f32| nodata.iter().any(|none| is_same(*none as f32, value));
    for value in raster.bands.iter_mut().flat_map(|band| &mut band.values).filter(|value| is_none(**value)) {
        *value = f32::NAN;
        raster.sample = Sample::Float;
    }
}

/// Warns of values of elevations that look like no-data values which the file does not declare.
fn warn_of_undeclared(name: &str, raster: &Raster, context: &Context) {
    for band in &raster.bands {
        let of_band = if raster.bands.len() == 1 { String::new() } else { format!(", band `{}`", band.name) };
        for found in undeclared_elevations(&band.values) {
            let value = written(found.value);
            context.warn(format!(
                "`{name}`{of_band}: {} cells hold {value}, which looks like a no-data value that the file does not declare, and would be a \
                 change of the face: `nodata: [{value}]` declares it",
                found.cells
            ));
        }
    }
}

/// Quantities whose values are lengths along Z.
const LENGTHS: [&str; 2] = ["elevation", "difference"];

fn to_metres(raster: &mut Raster, settled: &Settled, quantity: &str) {
    if settled.keeps_coordinates() {
        return;
    }
    let grid = &mut raster.grid;
    for length in [&mut grid.cell_m, &mut grid.left_m, &mut grid.top_m] {
        *length *= settled.horizontal;
    }
    if LENGTHS.contains(&quantity) {
        let values = raster.bands.iter_mut().flat_map(|band| &mut band.values);
        values.for_each(|value| *value = (f64::from(*value) * settled.vertical) as f32);
        raster.sample = Sample::Float;
    }
}

/// Warns of what differences of a rock face in metres cannot be, or rarely are.
fn warn_of_strange_differences(raster: &Raster, context: &Context) {
    let mut scattered = Vec::new();
    for band in &raster.bands {
        if let Some(found) = impossible_differences(band) {
            let largest = written(found.value);
            context.warn(format!(
                "band `{}`: {} cells hold 100 m or more, up to {largest}: this looks like a no-data value the file does \
                 not declare; declare it with `nodata: [{largest}]`, or with `gdal_edit.py -a_nodata {largest} FILE`",
                band.name, found.cells
            ));
        } else if let Some(found) = marginal::marginal(&band.values)
            && found.deviation > LARGEST_USUAL_DEVIATION_M
        {
            scattered.push(format!("`{}` by {:.3} m", band.name, found.deviation));
        }
    }
    if let [first, others @ ..] = scattered.as_slice() {
        let others = if others.is_empty() { String::new() } else { format!(" and {} more bands", others.len()) };
        context.warn(format!(
            "differences scatter by more than 1 m: {first} (standard deviation){others}; are they millimetres? Lengths \
             are in metres"
        ));
    }
}

/// Bands with outliers that a message names.
const NAMED: usize = 3;

/// Takes values beyond a limit away, with a warning that names their bands.
fn leave_outliers_out(raster: &mut Raster, limit: f64, context: &Context) -> Result<(), StageError> {
    let (mut found, mut cells, mut known) = (Vec::new(), 0, 0);
    for band in &mut raster.bands {
        let values = band.values.iter().filter(|value| !value.is_nan()).count();
        // A value at the limit is none, as it is rounded in the file.
        let is_outlier = |value: &f32| value.abs() > limit as f32;
        let outliers = band.values.iter().filter(|value| is_outlier(value)).count();
        if outliers == values {
            let name = &band.name;
            return Err(StageError::new(format!(
                "every value of band `{name}` is beyond the limit for outliers, {limit}"
            ))
            .hint("raise the limit, or give the values its unit: lengths are in metres"));
        }
        (cells, known) = (cells + outliers, known + values);
        if outliers > 0 {
            band.values.iter_mut().filter(|value| is_outlier(value)).for_each(|value| *value = f32::NAN);
            raster.sample = Sample::Float;
            found.push(format!("{outliers} of `{}`", band.name));
        }
    }
    if cells > 0 {
        let more = found.len().saturating_sub(NAMED);
        let more = if more == 0 { String::new() } else { format!(" and of {more} more bands") };
        found.truncate(NAMED);
        context.warn(format!(
            "{cells} cells ({:.2} %) are beyond the limit for outliers, {limit}, and left out: {}{more}; where many are, the limit is not the one that \
             the files were filtered with",
            100.0 * cells as f64 / known as f64,
            found.join(", ")
        ));
    }
    context.metric("outliers", cells as f64, "1");
    Ok(())
}

fn append(first: &str, together: &mut Raster, name: &str, raster: Raster) -> Result<(), StageError> {
    let system = |raster: &Raster| raster.frame.crs().cloned();
    if raster.frame != together.frame {
        let (a, b) = (together.frame, raster.frame);
        return Err(StageError::new(format!("`{first}` is in the {a} frame, but `{name}` in the {b} frame"))
            .hint("say which with `frame`, or give the files that state none their `crs` in a step of their own"));
    }
    if let (Some(one), Some(other)) = (system(together), system(&raster))
        && !one.agrees_with(&other)
    {
        let text =
            format!("`{first}` is in {one}, but `{name}` in {other}: two coordinate reference systems in one step");
        return Err(StageError::new(text)
            .hint("bring the files into one system first: `gdalwarp -t_srs EPSG:... in.tif out.tif`"));
    }
    if let (Some(one), Some(other)) = (together.frame.wall_from_world(), raster.frame.wall_from_world())
        && one != other
    {
        return Err(StageError::new(format!(
            "`{first}` and `{name}` are in two wall frames: the same place has other coordinates in each"
        ))
        .hint("make both with one `transform`, or import them in separate steps"));
    }
    if together.frame.georeference().is_none() {
        together.frame = raster.frame;
    }
    if !grid::same(&together.grid, &raster.grid) {
        let (a, b) = (grid::describe(&together.grid), grid::describe(&raster.grid));
        return Err(StageError::new(format!("`{first}` has {a}, but `{name}` has {b}"))
            .hint("resample the files to one grid, or import them in separate steps"));
    }
    together.sample = together.sample.common(raster.sample);
    together.bands.extend(raster.bands);
    Ok(())
}

fn refuse_twins(raster: &Raster) -> Result<(), StageError> {
    match twice(raster.bands.iter().map(|band| band.name.as_str()).collect()) {
        Some(name) => Err(StageError::new(format!("two bands would be called `{name}`"))
            .hint("files must differ in more than their extension; rename one")),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests;
