//! COLMAP run by the host: as pycolmap of a Python the user names, or as the command-line program.

use serde_json::{Map, Value, json};

use super::{Engine, FuseColmapParams};
use rockface_core::program::{Piece, Program, ProgramResult, ended};
use rockface_core::{Context, StageError};

/// Prints the version of pycolmap.
const VERSION: &str = "import pycolmap; print(pycolmap.__version__)";
/// The Python program that fuses a workspace through pycolmap.
const SCRIPT: &str = include_str!("fuse.py");

/// Folder of the workspace in the working directory of the program.
pub const WORKSPACE: &str = "work";
/// Where the program puts the fused cloud.
pub const FUSED: &str = "out/fused.ply";
/// The images from which each point was fused.
pub const VISIBILITY: &str = "out/fused.ply.vis";
/// Where the program puts the mesh of the Poisson reconstruction.
pub const MESHED: &str = "out/meshed.ply";

type Files = Vec<(String, Vec<u8>)>;

/// The program of these parameters.
pub fn program(params: &FuseColmapParams) -> &str {
    let default = match params.engine {
        Engine::Pycolmap => "python3",
        Engine::Colmap => "colmap",
    };
    params.program.as_deref().unwrap_or(default)
}

/// Fails where the program does not exist, or has another version than the parameters name.
pub fn check_version(params: &FuseColmapParams, context: &Context) -> Result<(), StageError> {
    let args = match params.engine {
        Engine::Pycolmap => ["-c", VERSION].as_slice(),
        Engine::Colmap => &["help"],
    };
    let result = run(params, context, args, Vec::new(), &[])?;
    let version = match params.engine {
        Engine::Pycolmap => result.stdout.trim(),
        Engine::Colmap => version_of_help(&result.stdout),
    };
    if version == params.version.trim() {
        return Ok(());
    }
    let (program, stated) = (program(params), &params.version);
    let error = StageError::new(format!("`{program}` has COLMAP {version}, but `version` says {stated}"));
    Err(error.hint(format!("write `version: \"{version}\"`: a result is known by the version that made it")))
}

/// The word after the name: `COLMAP 3.8 -- Structure-from-Motion ...`.
fn version_of_help(text: &str) -> &str {
    let mut words = text.split_whitespace().skip_while(|word| *word != "COLMAP");
    words.nth(1).unwrap_or("of an unknown version")
}

/// Fuses a workspace; the files of [`FUSED`], [`VISIBILITY`] and, if asked, [`MESHED`].
pub fn fuse(params: &FuseColmapParams, workspace: Files, context: &Context) -> Result<ProgramResult, StageError> {
    let mut files: Files = workspace.into_iter().map(|(name, bytes)| (format!("{WORKSPACE}/{name}"), bytes)).collect();
    match params.engine {
        Engine::Pycolmap => {
            let options = json!({ "fusion": fusion(params), "poisson": poisson(params) });
            files.push(("fuse.py".to_owned(), SCRIPT.as_bytes().to_vec()));
            files.push(("options.json".to_owned(), options.to_string().into_bytes()));
            run(params, context, &["fuse.py", "options.json"], files, &[FUSED, VISIBILITY, MESHED])
        }
        Engine::Colmap => with_program(params, files, context),
    }
}

/// The command-line program runs once for each task.
fn with_program(params: &FuseColmapParams, files: Files, context: &Context) -> Result<ProgramResult, StageError> {
    let mut args = words(&["stereo_fusion", "--workspace_path", WORKSPACE, "--workspace_format", "COLMAP"]);
    args.extend(words(&["--input_type", "geometric", "--output_path", FUSED]));
    args.extend(switches("StereoFusion", &fusion(params)));
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let mut fused = run(params, context, &args, files, &[FUSED, VISIBILITY])?;
    let Some(poisson) = poisson(params) else { return Ok(fused) };
    let Some(cloud) = fused.outputs.get(FUSED) else { return Ok(fused) };
    let mut args = words(&["poisson_mesher", "--input_path", "in/fused.ply", "--output_path", MESHED]);
    args.extend(switches("PoissonMeshing", &poisson));
    let args: Vec<&str> = args.iter().map(String::as_str).collect();
    let meshed = run(params, context, &args, vec![("in/fused.ply".to_owned(), cloud.clone())], &[MESHED])?;
    fused.outputs.extend(meshed.outputs);
    Ok(fused)
}

fn words(words: &[&str]) -> Vec<String> {
    words.iter().map(|word| (*word).to_owned()).collect()
}

/// `--Group.name value` of each option.
fn switches(group: &str, options: &Map<String, Value>) -> Vec<String> {
    let plain = |value: &Value| match value {
        Value::Bool(flag) => u8::from(*flag).to_string(),
        other => other.to_string(),
    };
    options.iter().flat_map(|(name, value)| [format!("--{group}.{name}"), plain(value)]).collect()
}

/// Options of the fusion by the names both engines have for them. One thread: more would change the result from run to run.
fn fusion(params: &FuseColmapParams) -> Map<String, Value> {
    let options = json!({
        "num_threads": 1,
        "min_num_pixels": params.min_num_pixels,
        "max_reproj_error": params.max_reproj_error_px,
        "max_depth_error": params.max_depth_error,
        "max_normal_error": params.max_normal_error_deg,
        "max_traversal_depth": params.max_traversal_depth,
        "check_num_images": params.check_num_images,
        "use_cache": params.cache_gb.is_some(),
        "cache_size": params.cache_gb.unwrap_or(32.0),
    });
    entries(options)
}

fn poisson(params: &FuseColmapParams) -> Option<Map<String, Value>> {
    let poisson = params.poisson.as_ref()?;
    let (depth, trim, weight) = (poisson.depth, poisson.trim, poisson.point_weight);
    Some(entries(json!({ "num_threads": 1, "depth": depth, "trim": trim, "point_weight": weight })))
}

fn entries(value: Value) -> Map<String, Value> {
    match value {
        Value::Object(map) => map,
        _ => Map::new(),
    }
}

fn run(
    params: &FuseColmapParams,
    context: &Context,
    args: &[&str],
    inputs: Files,
    outputs: &[&str],
) -> Result<ProgramResult, StageError> {
    let text = |text: &str| vec![Piece::Text(text.to_owned())];
    let program = Program {
        program: text(program(params)),
        args: args.iter().map(|arg| text(arg)).collect(),
        // Other commands of the program open windows; this one must not need a display.
        environment: [("QT_QPA_PLATFORM".to_owned(), "offscreen".to_owned())].into(),
        inherit: Vec::new(),
        inputs,
        outputs: words(outputs),
    };
    let result = context.execute(&program).map_err(|error| missing(params, error))?;
    ended::tell(context, &result);
    ended::well(self::program(params), &result).map_err(|error| explained(params, error, &result))?;
    Ok(result)
}

/// Adds how to install the program to an error; the error of a cancelled run does not change.
fn missing(params: &FuseColmapParams, error: StageError) -> StageError {
    if error.hint.is_some() { error.hint(way_out(params)) } else { error }
}

fn explained(params: &FuseColmapParams, error: StageError, result: &ProgramResult) -> StageError {
    let lacks = result.stderr.contains("No module named 'pycolmap'");
    if lacks { error.hint(way_out(params)) } else { error }
}

fn way_out(params: &FuseColmapParams) -> &'static str {
    match params.engine {
        Engine::Pycolmap => {
            "`pip install pycolmap`, and name that Python by its absolute path in `program`; or take `engine: colmap`; \
             or fuse without COLMAP, by `fuse-volume` or `fuse-grids`"
        }
        Engine::Colmap => {
            "install COLMAP (Debian: `apt install colmap`) or name it by its absolute path in `program`; or take \
             `engine: pycolmap`; or fuse without COLMAP, by `fuse-volume` or `fuse-grids`"
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::params::ParamType;

    #[test]
    fn both_engines_are_told_the_same() {
        let params = FuseColmapParams::decode(&json!({"version": "1", "min_num_pixels": 3, "cache_gb": 4})).unwrap();
        let told = switches("StereoFusion", &fusion(&params));
        let pair = |name: &str| told.iter().position(|word| word == name).map(|at| told[at + 1].as_str());
        assert_eq!(pair("--StereoFusion.num_threads"), Some("1"));
        assert_eq!(pair("--StereoFusion.use_cache"), Some("1"));
        assert_eq!(pair("--StereoFusion.cache_size"), Some("4.0"));
        assert_eq!(pair("--StereoFusion.min_num_pixels"), Some("3"));
        assert!(poisson(&params).is_none());
    }

    #[test]
    fn the_version_is_the_word_after_the_name() {
        let help =
            "COLMAP 3.8 -- Structure-from-Motion and Multi-View Stereo\n(Commit Unknown on Unknown without CUDA)\n";
        assert_eq!(version_of_help(help), "3.8");
        assert_eq!(version_of_help("usage"), "of an unknown version");
    }
}
