//! Pipelines: the examples of all stages, those of the repository, and texts with the rest of the language in them.

use std::io;

use rockface_engine::pipeline::{Overrides, Pipeline};

use super::{Seed, seed};
use crate::corpus::home;
use crate::parts::joined;
use crate::targets::long_text;

/// Larger pipelines are left to the tests that plan them.
const LARGEST_BYTES: usize = 6000;

const LANGUAGE: [(&str, &str); 9] = [
    (
        "axes",
        "rockface: 1\nseed: 3\nparams: {cells: [0.25, 0.5], half_m: 2}\naxes:\n  epoch: {items: [pre, post]}\n  trial: {count: 4}\n  \
         sigma_px: {values: [0.4, 0.8]}\n  cell_m: {values: \"${cells}\"}\nsteps:\n  face: {stage: synthesise-face, over: [trial], \
         keep: false, log: brief, with: {width_m: \"${half_m}\", height_m: 6}}\n  dem: {stage: rasterise-dem, stream: both, \
         in: {surface: face.mesh}, with: {cell_m: \"${cell_m}\"}}\n  table: {stage: tabulate, in: {rows: {each: dem.raster, \
         over: [cell_m, trial]}}}\ntargets: [dem]\n",
    ),
    (
        "sample",
        "rockface: 1\nseed: 9\naxes: {p: {sample: latin-hypercube, count: 8, over: {a_m: [1, 2], b_m: {log: [0.1, 1]}}}, \
         q: {sample: sobol, count: 3, over: {c_m: [0.1, 2]}}}\nsteps:\n  face: {stage: synthesise-face, with: {width_m: \
         \"${p.a_m}\", height_m: \"${q.c_m}\", relief_m: \"${p.b_m}\"}}\n",
    ),
    (
        "zip",
        "rockface: 1\naxes: {a: {values: [1, 2]}, b: {values: [3, 4]}}\nzip: [a, b]\nlog: none\nsteps:\n  face: {stage: \
         synthesise-face, with: {width_m: \"${a}\", height_m: \"${b}\"}}\n  one: {stage: rasterise-dem, in: {surface: \
         \"face.mesh[a=2]\"}}\n",
    ),
    (
        "chain",
        "rockface: 1\nseed: 1\naxes: {epoch: {items: [e0, e1, e2]}}\nsteps:\n  face: {stage: synthesise-face}\n  blocks: {stage: \
         generate-blocks}\n  worn: {stage: remove-blocks, over: [epoch], in: {mesh: {from: \"worn.mesh[epoch=prev]\", first: \
         face.mesh}, blocks: blocks.candidates}, with: {count: 2}}\n  dem: {stage: rasterise-dem, in: {surface: {by: epoch, e0: \
         face.mesh, else: worn.mesh}}}\n",
    ),
    (
        "from",
        "rockface: 1\nseed: 1\naxes: {image: {from: plan.cameras, reseeds: false}, row: {from: dems.table}}\nsteps:\n  face: {stage: \
         synthesise-face}\n  plan: {stage: plan-survey, in: {mesh: face.mesh}}\n  depth: {stage: project-depth, with: {image: \
         \"${image}\"}, in: {mesh: face.mesh, cameras: plan.cameras}}\n",
    ),
    (
        "parts",
        "rockface: 1\nseed: 2\nparams: {n: {type: integer, min: 1, max: 9, default: 2, unit: m, doc: d}}\nparts:\n  inner:\n    doc: d\n    params: {c: \
         {type: number, min: 0.1, default: 1, choices: [1, 2]}}\n    in: {face: mesh, more: {kind: [mesh, surface], optional: true}}\n    out: {dem: \
         dem.raster}\n    steps:\n      dem: {stage: rasterise-dem, in: {surface: in.face}, with: {cell_m: \"${c}\"}}\n  outer:\n    params: {t: {type: list, \
         default: [1, 2]}}\n    in: {face: mesh}\n    out: {rows: all.table, dem: \"one.dem[k=1]\"}\n    axes: {k: {values: \"${t}\"}}\n    steps:\n      \
         one: {use: inner, over: [k], in: {face: in.face}, with: {c: \"${k}\"}}\n      all: {stage: tabulate, in: {rows: {each: one.dem, over: [k]}}}\naxes: \
         {r: {count: \"${n}\"}}\nsteps:\n  face: {stage: synthesise-face, over: [r]}\n  u: {use: outer, in: {face: {by: r, \"0\": face.mesh, else: \
         \"face.mesh[r=0]\"}}}\n  v: {use: outer, over: [r], in: {face: \"face.mesh[r=1]\"}, with: {t: [1]}}\ntargets: [u, v]\n",
    ),
    (
        "points",
        "rockface: 1\nseed: 5\nparams: {size: {width_m: 3, height_m: 2, deep: {cell_m: 0.5}}, cell_m: \"${size.deep}\"}\nparts:\n  at:\n    params: {point: {type: \
         map}, n: {type: map, default: {count: 2}}}\n    in: {face: mesh}\n    out: {dem: dem.raster, all: all.table}\n    axes: {k: {count: \"${n.count}\"}}\n    steps:\n      \
         dem: {stage: rasterise-dem, over: [k], in: {surface: in.face}, with: {cell_m: \"${point.c}\"}}\n      all: {stage: tabulate, with: {constants: \"${point}\"}, in: {rows: \
         {each: dem.raster, over: [k]}}}\naxes: {p: {sample: sobol, count: 3, over: {c: [0.2, 0.5], d: [1, 2]}}, q: {from: u.all}}\nsteps:\n  face: {stage: synthesise-face, \
         with: {width_m: \"${size.width_m}\", height_m: \"${size.height_m}\"}}\n  u: {use: at, with: &w {point: {c: 0.5}}, in: &i {face: face.mesh}}\n  v: {use: at, \
         over: [p], with: {<<: *w, point: \"${p}\"}, in: *i}\n  x: {use: at, with: {point: \"${q}\", n: {count: 1}}, in: {<<: *i}}\ntargets: [u, v]\n",
    ),
    (
        "shipped",
        "rockface: 1\nparts: {s: rockface/synthetic-site}\nsteps:\n  site: {use: s}\n  bench: {use: rockface/detection-benchmark, with: {first: left, second: \
         right, window_m: [-5, 5, -4, 4], epochs: 2, thresholds_m: [0.03, 0.05], voxels_m: [0.02, 0.03]}, in: {mesh: site.mesh, cameras: site.cameras}}\n",
    ),
    (
        "anchors",
        "rockface: 1\nparams: &p {a: 1, b: [1, 2, {c: 3}], d: \"x\\ty\"}\nsteps:\n  face:\n    stage: synthesise-face\n",
    ),
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
    seeds.push(seed("overrides", "values", "steps.dem.with={cell_m: 0.25}\n%steps.face.with.relief_m=0.1,0.2\n"));
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
