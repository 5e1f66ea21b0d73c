//! Pipelines: the examples of all stages, those of the repository, and texts with the rest of the language in them.

use std::io;

use rockface_engine::pipeline::{Overrides, Pipeline};

use super::{Seed, seed};
use crate::corpus::home;
use crate::parts::joined;
use crate::targets::long_text;

/// Larger pipelines are left to the tests that plan them.
const LARGEST_BYTES: usize = 6000;

/// Texts with the rest of the language in them; each of them plans.
pub const LANGUAGE: [(&str, &str); 10] = [
    ("anchors", include_str!("language/anchors.yaml")),
    ("axes", include_str!("language/axes.yaml")),
    ("chain", include_str!("language/chain.yaml")),
    ("from", include_str!("language/from.yaml")),
    ("part-inputs", include_str!("language/part-inputs.yaml")),
    ("parts", include_str!("language/parts.yaml")),
    ("points", include_str!("language/points.yaml")),
    ("sample", include_str!("language/sample.yaml")),
    ("shipped", include_str!("language/shipped.yaml")),
    ("zip", include_str!("language/zip.yaml")),
];

/// Seeds of pipelines, of what is given on the command line, and of the tree of a pipeline.
pub fn all() -> io::Result<Vec<Seed>> {
    let mut seeds: Vec<Seed> = LANGUAGE.iter().map(|(name, text)| seed("pipeline", name, text)).collect();
    for stage in rockface_stages::registry().stages() {
        seeds.push(seed("pipeline", &format!("example-{}", stage.name()), stage.page().example()));
    }
    let folder = home().with_file_name("pipelines");
    for path in crate::corpus::files(&folder)?.iter().filter(|path| path.extension().is_some_and(|e| e == "yaml")) {
        let (name, text) = (path.file_stem().unwrap_or_default().to_string_lossy(), std::fs::read(path)?);
        if text.len() <= LARGEST_BYTES {
            seeds.push(seed("pipeline", &format!("whole-{name}"), text));
        }
    }
    let main = "rockface: 1\nname: two\ninclude: [part1.yaml, part2.yaml]\ntargets: [dem]\n";
    let parts = [
        "rockface: 1\nparams: {width_m: 3}\nsteps: {face: {stage: synthesise-face, with: {width_m: \"${width_m}\"}}}\n",
        "rockface: 1\ninclude: part1.yaml\nsteps: {dem: {stage: rasterise-dem, in: {surface: face.mesh}}}\n",
    ];
    seeds.push(seed("pipeline", "include", joined(&[main.as_bytes(), parts[0].as_bytes(), parts[1].as_bytes()])));
    let main = "rockface: 1\nsteps:\n  face: {stage: synthesise-face}\n  u: {use: part1.yaml, in: {face: face.mesh}, with: {c: 1}}\n";
    let parts = [
        "rockface: 1\npart: one\nparams: {c: {type: number}}\nin: {face: mesh}\nout: {dem: x.dem}\nsteps: {x: {use: part2.yaml, in: {face: in.face}, with: {c: \"${c}\"}}}\n",
        "rockface: 1\npart: two\nparams: {c: {type: number}}\nin: {face: mesh}\nout: {dem: d.raster}\nsteps: {d: {stage: rasterise-dem, in: {surface: in.face}, with: {cell_m: \"${c}\"}}}\n",
    ];
    seeds.push(seed("pipeline", "files", joined(&[main.as_bytes(), parts[0].as_bytes(), parts[1].as_bytes()])));
    let given = "steps.twice/o.with.cell_m=2\nparams.width_m=5\nsteps.face.with.height_m=4.5\naxes.replicate.count=2\n%steps.face.with.relief_m=0.1..0.4:4\n";
    seeds.push(seed("overrides", "all", given));
    let values = "steps.dem.with={cell_m: \"${cell}\"}\n%steps.face.with.relief_m=0.1,0.2\n";
    seeds.push(seed("overrides", "values", values));
    seeds.push(seed("overrides", "part", "steps.twice.with={c: 3}\naxes.cell.values=[1, 2]\n"));
    seeds.push(seed("overrides", "part-sweep", "%steps.twice.with.c=0.5..2:3\nseed=9\n"));
    seeds.push(seed("tree", "fixed", tree()?));
    Ok(seeds)
}

/// The tree of the long pipeline without its first line, which holds the checksums.
fn tree() -> io::Result<Vec<u8>> {
    let folder = tempfile::tempdir()?;
    let (path, trees) = (folder.path().join("long.yaml"), folder.path().join("trees"));
    std::fs::create_dir(&trees)?;
    std::fs::write(&path, long_text())?;
    Pipeline::load(&path, &Overrides::default(), Some(&trees))
        .map_err(|faults| io::Error::other(faults.render(false)))?;
    let files = crate::corpus::files(&trees)?;
    let file = files.first().ok_or_else(|| io::Error::other("no tree was kept"))?;
    let bytes = std::fs::read(file)?;
    let head = bytes.iter().position(|byte| *byte == b'\n').unwrap_or(0);
    Ok(bytes[head + 1..].to_vec())
}

#[cfg(test)]
mod tests {
    use super::LANGUAGE;
    use crate::{Verdict, find};

    #[test]
    fn texts_of_the_language_plan() {
        let target = find("pipeline").expect("a target");
        for (name, yaml) in LANGUAGE {
            assert_eq!((target.run)(yaml.as_bytes()), Verdict::Accepted, "{name}");
        }
    }
}
