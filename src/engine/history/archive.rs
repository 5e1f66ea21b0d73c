//! The archive of a run: one file with all that is needed to check it, whoever has it and wherever the store went.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{BufWriter, Read, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};

use rockface_cache::{Digest, SafePath, Store, StoreError};
use rockface_core::artefact::Kind;

use super::file_names::{CRATE_FILE, PIPELINE_FILE, RUN_FILES, SUMS_FILE};
use super::places::place_of;
use super::provenance::crate_of_archive;
use super::sources::source_files;
use super::{HistoryError, Manifest, PastRun};

/// Explains the archive to whoever opens it.
const README: &str = "This archive holds one run of rockface.

run.json                 the manifest: pipeline, overrides, seed, program, and every step with its key and digests
pipeline.yaml            the pipeline as it was run
pipeline/                the same with the files it includes, in their relative layout; only where it includes any
run.mcap                 the log
ro-crate-metadata.json   the same for programs that know nothing of rockface (Workflow Run RO-Crate)
records/KEY.recipe.json  the recipe of every step: the BLAKE3 of these very bytes is KEY
logs/DIGEST.json         what steps said; the BLAKE3 of these very bytes is DIGEST
outputs/                 the outputs, where the archive was made with --outputs; those that the run folder lacks are from the store
inputs/                  the pipeline and all files it read, as they lay, where the archive was made with --inputs
B3SUMS                   the BLAKE3 of every file: `b3sum --check B3SUMS` checks them all

To repeat the run, extract the archive and `rockface run run.json`: it says whether every output is the same. It reads the
files in inputs/ and writes into a `.rockface` folder beside the pipeline there. Without inputs/ it reads the files where
run.json names them (with their BLAKE3): put them there, and give `--store STORE --runs RUNS` for where it writes.
";

/// What every archive has, and at which byte: the beginning of its first file, behind the header of that.
pub const ARCHIVE_MARK: (u64, &[u8]) = (512, b"This archive holds one run of rockface.\n");

/// What went into an archive.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Archived {
    /// Number of files in the archive.
    pub files: usize,
    /// Records and logs the run names and the store does not have any more.
    pub missing: usize,
    /// Outputs that were asked for and that neither the run folder nor the store has, as `step.port`.
    pub left_out: Vec<String>,
    /// Entries of the run folder that are none of the files of a run, and are not in the archive.
    pub strange: usize,
}

/// What an archive has besides what is needed to check the run.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Contents {
    /// The pipeline and the files it read, so that the run can be repeated elsewhere.
    pub inputs: bool,
    /// The outputs, those that the run folder lacks from the store.
    pub outputs: bool,
}

/// Writes the archive (tar) of a run. Equal runs give equal bytes. The folder of the archive is made if there is none.
///
/// # Errors
///
/// When a file cannot be read or written, an input file is not what the run read, or `stop` asks to stop: what was there then
/// stays as it was.
pub fn archive(
    run: &PastRun,
    store: &Store,
    contents: Contents,
    to: &Path,
    stop: &AtomicBool,
) -> Result<Archived, HistoryError> {
    let folder = to.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(HistoryError::io("make the folder", folder))?;
    let file = rockface_cache::readable_file(folder).map_err(HistoryError::io("write into", folder))?;
    let mut packing = Packing { tar: tar::Builder::new(BufWriter::new(file)), sums: BTreeMap::new(), to, stop };
    packing.add(Path::new("README"), README.as_bytes())?;
    let made = made(&run.manifest);
    let (files, strange) = files_of(run, &made, contents.outputs)?;
    packing.add(Path::new(PIPELINE_FILE), run.manifest.pipeline.text.as_bytes())?;
    // The description of the run folder names outputs that are not in the archive.
    let written_here = [PIPELINE_FILE, CRATE_FILE].map(Path::new);
    for path in files.iter().filter(|path| !written_here.contains(&&***path)) {
        packing.add_own(path, made.get(&**path).copied(), run, store)?;
    }
    let left_out = if contents.outputs { packing.stored_outputs(run, store)? } else { Vec::new() };
    if contents.inputs {
        packing.inputs(run)?;
    }
    let sources = source_files(&run.manifest);
    for (path, text) in sources.map_err(|error| HistoryError::io("archive", &run.folder)(error.into()))? {
        packing.add(&Path::new("pipeline").join(path), text.as_bytes())?;
    }
    let missing = packing.records(run, store)?;
    let described = crate_of_archive(&run.manifest, &packing.sums);
    packing.add(Path::new(CRATE_FILE), described.as_bytes())?;
    let files = packing.sums.len() + 1;
    let file = packing.finish()?;
    file.persist(to).map_err(|fault| HistoryError::io("write", to)(fault.error))?;
    Ok(Archived { files, missing, left_out, strange })
}

/// What each output file of a run was made as.
fn made(manifest: &Manifest) -> BTreeMap<&Path, Digest> {
    let mut made = BTreeMap::new();
    for done in &manifest.steps {
        for (port, output) in done.outputs.iter().flatten() {
            made.extend(done.paths.get(port.as_str()).map(|path| (&**path, output.digest)));
        }
    }
    made
}

/// A blob of the store; `None` if the store does not have it or finds it damaged. A store that cannot be read is an error: what it has is not missing.
fn in_store(store: &Store, digest: &Digest) -> Result<Option<Vec<u8>>, StoreError> {
    match store.get(digest) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(StoreError::Missing { .. } | StoreError::Damaged { .. }) => Ok(None),
        Err(fault) => Err(fault),
    }
}

/// The files of a run folder that a run writes, relative to it, sorted: its own, and below `outputs` those of the outputs that its
/// manifest names, with their further files (tables, parts), which lie in the folder of an output. Also how many entries are others: whoever
/// has sent the folder may have put files there under any name.
fn files_of(
    run: &PastRun,
    made: &BTreeMap<&Path, Digest>,
    outputs: bool,
) -> Result<(Vec<SafePath>, usize), HistoryError> {
    let is_of_run = |path: &SafePath| match path.parent() {
        None => false,
        Some(top) if top.as_os_str().is_empty() => RUN_FILES.iter().any(|name| **path == *Path::new(name)),
        Some(_) => path.starts_with("outputs") && is_of_output(path, made),
    };
    let (mut found, mut strange, mut folders) = (Vec::new(), 0, vec![PathBuf::new()]);
    while let Some(folder) = folders.pop() {
        let path = run.folder.join(&folder);
        for entry in std::fs::read_dir(&path).map_err(HistoryError::io("list", &path))? {
            let entry = entry.map_err(HistoryError::io("list", &path))?;
            let relative = folder.join(entry.file_name());
            let kind = entry.file_type().map_err(HistoryError::io("look at", &entry.path()))?;
            let safe = SafePath::of(&relative).ok();
            if kind.is_dir() && safe.is_some() && relative.starts_with("outputs") {
                folders.extend(outputs.then_some(relative));
            } else if let Some(file) = safe.filter(|file| kind.is_file() && is_of_run(file)) {
                found.push(file);
            } else if relative != Path::new(super::PIN) {
                strange += 1;
            }
        }
    }
    found.sort();
    Ok((found, strange))
}

/// Whether a file is an output, or one of the further files that are called as it is: a table, a cloud, or a part in a folder of its name.
fn is_of_output(path: &Path, made: &BTreeMap<&Path, Digest>) -> bool {
    const FURTHER: [&str; 3] = ["csv", "laz", "parquet"];
    let ends_as = |path: &Path, known: &[&str]| path.extension().is_some_and(|end| known.iter().any(|one| end == *one));
    let of = |stem: &Path, kinds: &[Kind]| {
        kinds.iter().any(|kind| made.contains_key(&*stem.with_added_extension(kind.extension())))
    };
    let folder = path.parent().unwrap_or(path);
    made.contains_key(path)
        || ends_as(path, &FURTHER) && of(&path.with_extension(""), &[Kind::Cloud, Kind::Table, Kind::Inventory])
        || ends_as(path, &["ply"]) && of(folder, &[Kind::Meshes])
        || of(folder, &[Kind::Files])
}

/// What stands before a file of so many bytes, which may be a program.
fn header(size: u64, is_program: bool) -> tar::Header {
    let mut header = tar::Header::new_gnu();
    header.set_size(size);
    header.set_mode(if is_program { 0o755 } else { 0o644 });
    header.set_mtime(0);
    header
}

/// A file that is hashed while it is read, until it is asked to stop.
struct Hashed<'a> {
    file: std::io::Take<File>,
    piece: &'a mut dyn FnMut(&[u8]),
    stop: &'a AtomicBool,
}

impl Read for Hashed<'_> {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        if self.stop.load(Ordering::Relaxed) {
            return Err(std::io::Error::other("asked to stop"));
        }
        let count = self.file.read(buffer)?;
        (self.piece)(&buffer[..count]);
        Ok(count)
    }
}

struct Packing<'a> {
    tar: tar::Builder<BufWriter<tempfile::NamedTempFile>>,
    sums: BTreeMap<PathBuf, Digest>,
    to: &'a Path,
    stop: &'a AtomicBool,
}

impl Packing<'_> {
    /// Adds a file; one that is there already stays, and must be the same.
    fn add(&mut self, path: &Path, bytes: &[u8]) -> Result<(), HistoryError> {
        if !self.is_free(path, path, Digest::of(bytes))? {
            return Ok(());
        }
        let added = self.tar.append_data(&mut header(bytes.len() as u64, false), path, bytes);
        added.map_err(HistoryError::io("write", self.to))?;
        self.sums.insert(path.to_owned(), Digest::of(bytes));
        Ok(())
    }

    /// Adds a file of the run folder. An output is added as it was made: the file in the folder, unless it was written to or has decayed since; then
    /// that in the store.
    fn add_own(
        &mut self,
        place: &SafePath,
        made: Option<Digest>,
        run: &PastRun,
        store: &Store,
    ) -> Result<(), HistoryError> {
        let file = run.folder.join(place);
        let opened = File::open(&file).map_err(HistoryError::io("read", &file))?;
        let (found, size) = Digest::of_reader(opened).map_err(HistoryError::io("read", &file))?;
        let changed = |digest| {
            let manifest = run.folder.join(super::MANIFEST_FILE);
            HistoryError::Changed { path: file.clone(), digest, manifest }
        };
        if let Some(digest) = made.filter(|digest| *digest != found) {
            let bytes = in_store(store, &digest)?.ok_or_else(|| changed(digest))?;
            return self.add(place, &bytes);
        }
        if self.stream(place, &file, size, false)? != found {
            return Err(made.map_or_else(
                || HistoryError::io("read", &file)(std::io::Error::other("it changes while it is read")),
                changed,
            ));
        }
        Ok(())
    }

    /// Adds so many bytes of a file, which are not held in memory; returns their digest.
    fn stream(&mut self, place: &Path, path: &Path, size: u64, is_program: bool) -> Result<Digest, HistoryError> {
        let file = File::open(path).map_err(HistoryError::io("read", path))?;
        let (found, _, added) = Digest::of_pieces(|piece| {
            let file = Hashed { file: file.take(size), piece, stop: self.stop };
            self.tar.append_data(&mut header(size, is_program), place, file)
        });
        self.go_on()?;
        added.map_err(HistoryError::io("copy into the archive", path))?;
        self.sums.insert(place.to_owned(), found);
        Ok(found)
    }

    /// Adds the pipeline and the files it read, each where it lay beside the others.
    fn inputs(&mut self, run: &PastRun) -> Result<(), HistoryError> {
        let (texts, files) = (run.manifest.pipeline_files().collect::<Vec<_>>(), run.manifest.input_files());
        let paths: Vec<&Path> =
            texts.iter().map(|(path, _)| path.as_path()).chain(files.keys().map(PathBuf::as_path)).collect();
        let places = run.manifest.places_in_archive(&paths);
        let places =
            places.map_err(|(path, why)| HistoryError::Unpackable { path: path.to_owned(), why: why.to_string() })?;
        let (of_texts, of_files) = places.split_at(texts.len());
        for (place, (path, text)) in of_texts.iter().zip(&texts) {
            if self.is_free(place, path, Digest::of(text.as_bytes()))? {
                self.add(place, text.as_bytes())?;
            }
        }
        for (place, (path, digest)) in of_files.iter().zip(&files) {
            if self.is_free(place, path, *digest)? {
                self.add_file(place, path, *digest)?;
            }
        }
        Ok(())
    }

    fn go_on(&self) -> Result<(), HistoryError> {
        if self.stop.load(Ordering::Relaxed) { Err(HistoryError::Interrupted) } else { Ok(()) }
    }

    /// Whether nothing is in a place yet. The same file may be; another one is an error.
    fn is_free(&self, place: &Path, path: &Path, digest: Digest) -> Result<bool, HistoryError> {
        self.go_on()?;
        match self.sums.get(place) {
            None => Ok(true),
            Some(packed) if *packed == digest => Ok(false),
            Some(_) => {
                let why = format!(
                    "another file has its place, {}: a `..` in its path goes back over a link",
                    place.display()
                );
                Err(HistoryError::Unpackable { path: path.to_owned(), why })
            }
        }
    }

    /// Adds a file of any size, which must have this digest.
    fn add_file(&mut self, place: &Path, path: &Path, digest: Digest) -> Result<(), HistoryError> {
        let is = std::fs::metadata(path).map_err(HistoryError::io("look at", path))?;
        // A pipe that a made-up manifest names would be waited for.
        if !is.is_file() {
            return Err(HistoryError::InputChanged { path: path.to_owned(), digest });
        }
        let is_program = is.permissions().mode() & 0o111 != 0;
        // Before anything of it is written: a made-up manifest may name a file of any size.
        let opened = File::open(path).map_err(HistoryError::io("read", path))?;
        let (found, size) = Digest::of_reader(opened).map_err(HistoryError::io("read", path))?;
        if found != digest || self.stream(place, path, size, is_program)? != digest {
            return Err(HistoryError::InputChanged { path: path.to_owned(), digest });
        }
        Ok(())
    }

    /// Adds the outputs that are not packed yet; returns those the store does not have, as `step.port`.
    fn stored_outputs(&mut self, run: &PastRun, store: &Store) -> Result<Vec<String>, HistoryError> {
        let mut left_out = Vec::new();
        for done in &run.manifest.steps {
            for (port, output) in done.outputs.iter().flatten() {
                let place = place_of(done, port, output);
                let place = place.map_err(|error| HistoryError::io("archive", &run.folder)(error.into()))?;
                if self.sums.contains_key(&*place) {
                    continue;
                }
                match in_store(store, &output.digest)? {
                    Some(bytes) => self.add(&place, &bytes)?,
                    None => left_out.push(format!("{}.{port}", done.label())),
                }
            }
        }
        Ok(left_out)
    }

    /// Adds the records and logs of the run; returns how many the store does not have. A step that failed or was not reached
    /// has no record.
    fn records(&mut self, run: &PastRun, store: &Store) -> Result<usize, HistoryError> {
        let recorded = run.manifest.steps.iter().filter(|done| done.outputs.is_some());
        let keys: BTreeSet<Digest> = recorded.filter_map(|done| done.key).collect();
        let logs: BTreeSet<(Digest, &str)> = run
            .manifest
            .steps
            .iter()
            .flat_map(|done| [(done.log, "json"), (done.sketches, "sketches")])
            .filter_map(|(log, extension)| Some((log?, extension)))
            .collect();
        let mut missing = 0;
        for key in keys {
            match store.record(&key) {
                Some(record) => {
                    self.add(&PathBuf::from(format!("records/{key}.recipe.json")), record.recipe.text().as_bytes())?;
                }
                None => missing += 1,
            }
        }
        for (log, extension) in logs {
            match in_store(store, &log)? {
                Some(bytes) => self.add(&PathBuf::from(format!("logs/{log}.{extension}")), &bytes)?,
                None => missing += 1,
            }
        }
        Ok(missing)
    }

    fn finish(mut self) -> Result<tempfile::NamedTempFile, HistoryError> {
        let sums = std::mem::take(&mut self.sums);
        let text: String = sums.iter().map(|(path, digest)| format!("{digest}  {}\n", path.display())).collect();
        self.add(Path::new(SUMS_FILE), text.as_bytes())?;
        let to = self.to;
        let mut out = self.tar.into_inner().map_err(HistoryError::io("write", to))?;
        out.flush().map_err(HistoryError::io("write", to))?;
        let file = out.into_inner().map_err(|error| HistoryError::io("write", to)(error.into_error()))?;
        File::sync_all(file.as_file()).map_err(HistoryError::io("sync", to))?;
        Ok(file)
    }
}
