//! `import-cameras`: reads an image block, and the joint covariance of its orientation, from the files of other programs.

use std::collections::HashMap;
use std::io::Read;

use crate::camera::camera_files::CameraFile;
use crate::camera::camera_files::recognise;
use crate::camera::camera_files::recognise::Part;
use crate::camera::covariance_files;
use crate::camera::covariance_sampling::{JointRoot, block_only};
use rockface_core::artefact::{Cameras, Covariance, Frame, Kind};
use rockface_core::crs::{CrsName, wall_without_system};
use rockface_core::params::{Fault, FileRef, FilesRef, Range};
use rockface_core::{Context, Inputs, Outputs, Page, Port, SourceFile, Stage, StageError, choice, fail, params};

choice! {
    /// The frame a file's coordinates are in.
    pub enum FileFrame {
        /// The coordinate reference system of the input.
        World = "world",
        /// The frame of the face: X along it, Y up, Z towards the viewer.
        Wall = "wall",
    }
}

params! {
    /// Parameters of `import-cameras`.
    pub struct ImportCamerasParams {
        /// A JSON, Metashape XML or Bundler file, or the folder of a COLMAP model (`cameras` and `images`, `.txt` or `.bin`)
        /// or of a Bundler file with its `list.txt`.
        path: FilesRef,
        /// JSON file of the joint covariance; null: the blocks in a Metashape XML, else an output without parameters.
        covariance: Option<FileRef> = None,
        /// The frame of the projection centres; null: what the file says, or world where it says nothing.
        frame: Option<FileFrame> = None,
        /// The coordinate reference system of a file in the world frame that states none: `EPSG:28356`. Cameras of a Metashape chunk that is on the Earth,
        /// whose file has geocentric centres, are brought to it; null: to that of the chunk where it is projected.
        crs: Option<CrsName> = None,
        /// Added to every projection centre in double precision, metres: brings a file with shifted coordinates back.
        offset_m: [f64; 3] = [0.0; 3],
        /// Columns and rows of the images of a Bundler file, which does not say them; null for every other format.
        image_size_px: Option<[u32; 2]> = None; Range::AtLeast(1.0),
    }
}

/// Bytes at the start of a file by which its format is recognised.
const HEAD: u64 = 256;
/// A principal distance below this share of the width (a field of view above 118 degrees) is rarely meant.
const LEAST_USUAL_F_PER_WIDTH: f64 = 0.3;
/// Largest side of an image, pixels.
const LARGEST_PX: u32 = 1_000_000;

/// Reads sensors, oriented images and the joint covariance of their orientation parameters.
pub struct ImportCameras;

impl Stage for ImportCameras {
    type Params = ImportCamerasParams;
    const NAME: &'static str = "import-cameras";
    const VERSION: u32 = 7;
    const PAGE: Page = Page::new(include_str!("import_cameras.md"));
    const INPUTS: &'static [Port] = &[];
    const OUTPUTS: &'static [Port] = &[
        Port::one("cameras", &[Kind::Cameras], "Sensors and oriented images."),
        Port::one("covariance", &[Kind::Covariance], "Joint covariance; without parameters when no file is given."),
    ];

    fn check(params: &Self::Params) -> Vec<Fault> {
        let is_wall = params.frame == Some(FileFrame::Wall);
        params.crs.as_ref().and_then(|_| wall_without_system(is_wall)).into_iter().collect()
    }

    fn run(params: &Self::Params, _inputs: &Inputs, context: &Context) -> Result<Outputs, StageError> {
        let mut file = read_cameras(params, context)?;
        placing::place(&mut file, params, context)?;
        for note in &file.notes {
            context.note(note.as_str());
        }
        for warning in &file.warnings {
            context.warn(warning.as_str());
        }
        check_sizes(&params.path.0, &file.cameras)?;
        warn_of_short_focal_lengths(&file.cameras, context);
        let mut covariance = covariance(params, &file, context)?;
        name_as_items(&mut file.cameras, &mut covariance, context)?;
        let (images, sensors) = (file.cameras.images.len(), file.cameras.sensors.len());
        let (frame, known) = (file.cameras.frame, covariance.parameters.len());
        context.note(format!("{images} images, {sensors} sensors ({frame} frame), covariance of {known} parameters"));
        Ok(Outputs::of("cameras", file.cameras).and("covariance", covariance))
    }
}

/// Refuses sensors that no image is as large as, whose rays would need as much memory.
fn check_sizes(path: &str, cameras: &Cameras) -> Result<(), StageError> {
    match cameras.sensors.iter().find(|sensor| sensor.width_px.max(sensor.height_px) > LARGEST_PX) {
        None => Ok(()),
        Some(sensor) => Err(StageError::new(format!(
            "`{path}`: sensor `{}` has {} x {} pixels, more than {LARGEST_PX} on a side: is it its size in pixels?",
            sensor.name, sensor.width_px, sensor.height_px
        ))),
    }
}

fn warn_of_short_focal_lengths(cameras: &Cameras, context: &Context) {
    for sensor in &cameras.sensors {
        if sensor.f < LEAST_USUAL_F_PER_WIDTH * f64::from(sensor.width_px) {
            context.warn(format!(
                "sensor `{}`: f = {} px for a width of {} px: are these millimetres instead of pixels?",
                sensor.name, sensor.f, sensor.width_px
            ));
        }
    }
}

fn nothing(frame: Frame) -> Covariance {
    Covariance { frame, parameters: Vec::new(), matrix: Vec::new(), sigma0_applied: true, full_joint: true }
}

fn read_cameras(params: &ImportCamerasParams, context: &Context) -> Result<CameraFile, StageError> {
    let frame = params.frame.map(|frame| match frame {
        FileFrame::World => Frame::World,
        FileFrame::Wall => Frame::Wall,
    });
    let path = &params.path.0;
    let file = parts(context.files(&params.path)?)
        .and_then(|parts| recognise::read(&parts, frame.unwrap_or(Frame::World), params.image_size_px))
        .map_err(|e| StageError { message: format!("`{path}`: {}", e.message), ..e })?;
    match frame {
        Some(frame) if file.states_frame && frame != file.cameras.frame => {
            Err(StageError::new(format!("`{path}` is in the {} frame, not the {frame} frame", file.cameras.frame))
                .hint(format!("set `frame: {}`, or leave it out where the pipeline gives none", file.cameras.frame)))
        }
        _ => Ok(file),
    }
}

/// Characters that no item of an axis has.
const NO_ITEM: [char; 6] = ['/', '\\', ',', '=', '[', ']'];

/// Gives images names that can be items of an axis: those of files in folders, as COLMAP has them, cannot.
fn name_as_items(cameras: &mut Cameras, covariance: &mut Covariance, context: &Context) -> Result<(), StageError> {
    let mut names: HashMap<String, usize> = HashMap::new();
    cameras.images.iter().for_each(|image| *names.entry(image.name.clone()).or_default() += 1);
    let mut renamed = Vec::new();
    let mut new_names = HashMap::new();
    for place in 0..cameras.images.len() {
        let name = cameras.images[place].name.replace(NO_ITEM, "_");
        let old = std::mem::replace(&mut cameras.images[place].name, name.clone());
        if old == name {
            continue;
        }
        *names.entry(old.clone()).or_default() -= 1;
        if names.get(&name).is_some_and(|count| *count > 0) {
            return Err(StageError::new(format!("image `{old}` would be called `{name}`, as another one is"))
                .hint("rename one of the two where the cameras come from: names of images have none of / \\ , = [ ]"));
        }
        *names.entry(name.clone()).or_default() += 1;
        renamed.push(format!("`{old}` is called `{name}`"));
        new_names.insert(old, name);
    }
    for sensor in &mut cameras.sensors {
        if let Some(name) = new_names.get(&sensor.name) {
            sensor.name.clone_from(name);
        }
    }
    for parameter in &mut covariance.parameters {
        let parts = parameter.rsplit_once('.');
        if let Some((name, term)) = parts.and_then(|(owner, term)| Some((new_names.get(owner)?, term))) {
            *parameter = format!("{name}.{term}");
        }
    }
    if let [first, others @ ..] = renamed.as_slice() {
        let others = if others.is_empty() { String::new() } else { format!(", and {} more likewise", others.len()) };
        context.warn(format!("names of images have none of / \\ , = [ ]: {first}{others}"));
    }
    Ok(())
}

/// The complete files that may hold an image block; of others (photographs beside a model) only the first bytes are read.
fn parts(files: Vec<SourceFile>) -> Result<Vec<Part>, StageError> {
    let only_one = files.len() == 1;
    let mut parts = Vec::new();
    for mut file in files {
        let failed = |e: std::io::Error| StageError::new(format!("cannot read `{}`: {e}", file.name));
        let mut bytes = Vec::new();
        file.reader.by_ref().take(HEAD).read_to_end(&mut bytes).map_err(failed)?;
        match recognise::role(&file.name, &bytes) {
            Some(role) => {
                file.reader.read_to_end(&mut bytes).map_err(failed)?;
                parts.push(Part { role, name: file.name, bytes });
            }
            None if only_one => return Err(unknown(&bytes)),
            None => {}
        }
    }
    Ok(parts)
}

/// The error for a single file of unknown format, by its first bytes.
fn unknown(head: &[u8]) -> StageError {
    let start = head.trim_ascii_start();
    let content = if start.is_empty() {
        "it is empty".to_owned()
    } else {
        format!("it starts with `{}`", start[..start.len().min(24)].escape_ascii())
    };
    StageError::new(format!("neither JSON, XML, a Bundler file nor a COLMAP model: {content}"))
        .hint("give one of these, or the folder that holds a COLMAP model (cameras and images, .txt or .bin)")
}

/// The covariance of parameter `covariance`, else that of the camera file, else one without parameters.
fn covariance(params: &ImportCamerasParams, file: &CameraFile, context: &Context) -> Result<Covariance, StageError> {
    let covariance = match (&params.covariance, &file.covariance) {
        (Some(path), of_file) => {
            if of_file.is_some() {
                context.note("the covariance blocks of the camera file are not used: `covariance` is given");
            }
            read_covariance(path, &file.cameras, context)?
        }
        (None, Some(of_file)) => {
            JointRoot::new(of_file)?;
            of_file.clone()
        }
        (None, None) => nothing(file.cameras.frame),
    };
    if let Some(warning) = block_only(&covariance) {
        context
            .warn(format!("{warning}: `estimate-covariance` computes it for this block, or give it as `covariance`"));
    }
    Ok(covariance)
}

fn read_covariance(path: &FileRef, cameras: &Cameras, context: &Context) -> Result<Covariance, StageError> {
    let (covariance, notes) = covariance_files::read(&context.read(path)?, cameras)
        .map_err(|e| StageError { message: format!("`{}`: {}", path.0, e.message), ..e })?;
    for note in notes {
        context.note(note);
    }
    if covariance.parameters.is_empty() {
        fail!("`{}`: a covariance without parameters", path.0);
    }
    if !covariance.sigma0_applied {
        context.warn(
            "the covariance was not multiplied by the variance of unit weight: multiply `scale` of perturb-cameras by sigma0",
        );
    }
    Ok(covariance)
}

mod placing;
#[cfg(test)]
mod tests;
