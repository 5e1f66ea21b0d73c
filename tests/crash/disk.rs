//! A disk that forgets: the recorded calls of a run, played up to any moment, less some of what was not synced by then.
//!
//! Two kinds of file system bound what real ones do. A **journal** (ext4, xfs) makes names durable in the order in which
//! they were given, all of them with any sync. A **strict** one promises what POSIX does: a name is durable once its folder
//! was synced, and what happens in one folder says nothing of others. Bytes not synced are lost by sectors in both.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, UNIX_EPOCH};

use crate::Draws;

/// Storage loses or keeps whole sectors of this size.
const SECTOR_BYTES: usize = 512;

/// A system call of the recorded run that changed a file or folder.
pub struct Call {
    name: String,
    inode: u64,
    numbers: [i64; 2],
    time_ns: u64,
    bytes: Vec<u8>,
    path: PathBuf,
    to: PathBuf,
}

impl Call {
    /// Whether it made the content of a file in this folder durable.
    pub fn syncs_file_in(&self, folder: &Path) -> bool {
        self.name == "sync" && self.path.starts_with(folder)
    }

    /// Whether it made the names in a folder inside this one durable.
    pub fn syncs_folder_in(&self, folder: &Path) -> bool {
        self.name == "syncdir" && self.path.starts_with(folder) && self.path != folder
    }
}

/// Reads what the library recorded.
pub fn read_log(file: &Path) -> Vec<Call> {
    let log = fs::read(file).unwrap();
    let (mut calls, mut rest) = (Vec::new(), &log[..]);
    while let Some(end) = rest.iter().position(|byte| *byte == b'\n') {
        let line = std::str::from_utf8(&rest[..end]).unwrap();
        let fields: Vec<&str> = line.split('\t').collect();
        let number = |field: usize| fields[field].parse::<i64>().unwrap();
        let length = number(5) as usize;
        calls.push(Call {
            name: fields[0].to_owned(),
            inode: number(1) as u64,
            numbers: [number(2), number(3)],
            time_ns: number(4) as u64,
            bytes: rest[end + 1..end + 1 + length].to_vec(),
            // Components leave out what says nothing, such as `.`.
            path: Path::new(fields[6]).components().collect(),
            to: Path::new(fields[7]).components().collect(),
        });
        rest = &rest[end + 1 + length..];
    }
    assert!(rest.is_empty(), "the log ends in half a line");
    calls
}

/// What a power cut keeps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Names {
    /// In the order of the calls.
    Journal,
    /// In the order of the calls within each folder, whatever becomes of the names in other folders.
    Strict,
}

#[derive(Default)]
struct File {
    now: Vec<u8>,
    durable: Vec<u8>,
    /// Sectors written since the last sync.
    dirty: BTreeSet<usize>,
    mode: u32,
    time_ns: u64,
}

#[derive(Clone)]
enum Node {
    Folder,
    File(usize),
    Link(PathBuf),
}

type Tree = BTreeMap<PathBuf, Node>;

/// A change of names.
struct Change {
    /// What is there from then on.
    put: Option<(PathBuf, Option<Node>)>,
    /// What is not there any more.
    gone: Option<PathBuf>,
    folder: PathBuf,
    is_durable: bool,
}

/// The disk as the process saw it, and what of it is durable.
pub struct Disk {
    root: PathBuf,
    names: Names,
    files: Vec<File>,
    by_inode: HashMap<u64, usize>,
    tree: Tree,
    changes: Vec<Change>,
}

impl Disk {
    /// A disk that holds an empty folder at `root`.
    pub fn new(root: &Path, names: Names) -> Self {
        let tree = Tree::from([(root.to_owned(), Node::Folder)]);
        Self { root: root.to_owned(), names, files: Vec::new(), by_inode: HashMap::new(), tree, changes: Vec::new() }
    }

    /// Does on this disk what one call did.
    pub fn play(&mut self, call: &Call) {
        match call.name.as_str() {
            "create" => {
                self.by_inode.insert(call.inode, self.files.len());
                let node = Node::File(self.files.len());
                self.files.push(File { mode: call.numbers[0] as u32, time_ns: call.time_ns, ..File::default() });
                self.change(Some((call.path.clone(), Some(node))), None);
            }
            "mkdir" => self.change(Some((call.path.clone(), Some(Node::Folder))), None),
            "symlink" => self.change(Some((call.path.clone(), Some(Node::Link(call.to.clone())))), None),
            "link" => {
                let node = self.tree.get(&call.path).cloned();
                self.change(Some((call.to.clone(), node)), None);
            }
            "rename" => {
                let node = self.tree.get(&call.path).cloned();
                self.change(Some((call.to.clone(), node)), Some(call.path.clone()));
            }
            "unlink" | "rmdir" => self.change(None, Some(call.path.clone())),
            "syncdir" => self.sync_names(&call.path),
            _ => self.play_on_file(call),
        }
    }

    /// Files without a name are nobody's after a power cut.
    fn play_on_file(&mut self, call: &Call) {
        let Some(file) = self.by_inode.get(&call.inode).map(|number| &mut self.files[*number]) else { return };
        match call.name.as_str() {
            "write" => {
                file.write(call.numbers[0] as usize, &call.bytes);
                file.time_ns = call.time_ns;
            }
            "truncate" => file.now.resize(call.numbers[0] as usize, 0),
            "chmod" => file.mode = call.numbers[0] as u32,
            "utimes" => file.time_ns = (call.numbers[0] * 1_000_000_000 + call.numbers[1]) as u64,
            "sync" => {
                file.durable.clone_from(&file.now);
                file.dirty.clear();
                if self.names == Names::Journal {
                    self.sync_names(&self.root.clone());
                }
            }
            other => panic!("nobody plays `{other}`"),
        }
    }

    fn sync_names(&mut self, folder: &Path) {
        let all = self.names == Names::Journal;
        self.changes
            .iter_mut()
            .filter(|change| all || change.folder == folder)
            .for_each(|change| change.is_durable = true);
    }

    fn change(&mut self, put: Option<(PathBuf, Option<Node>)>, gone: Option<PathBuf>) {
        let path = put.as_ref().map(|(path, _)| path).or(gone.as_ref()).expect("a change of something");
        let folder = path.parent().unwrap_or(&self.root).to_owned();
        let change = Change { put, gone, folder, is_durable: false };
        apply(&mut self.tree, &change);
        self.changes.push(change);
    }

    /// Writes what the process saw into the root, which is emptied first.
    pub fn write_all(&self) {
        write(&self.root, &self.tree, |number| self.files[number].now.clone(), &self.files);
    }

    /// Writes what a power cut now could leave.
    pub fn write_what_is_left(&self, draws: &mut Draws) {
        let tree = self.names_left(draws);
        // Of all that is not durable: nothing, all, or some.
        let tenths = [0, 10, 5, 8][draws.below(4) as usize];
        let contents: Vec<Vec<u8>> = self.files.iter().map(|file| file.left(draws, tenths)).collect();
        write(&self.root, &tree, |number| contents[number].clone(), &self.files);
    }

    /// The names a power cut leaves: those that are durable, and the first few of the others.
    fn names_left(&self, draws: &mut Draws) -> Tree {
        let mut pending: BTreeMap<&Path, u64> = BTreeMap::new();
        let group = |change: &Change| match self.names {
            Names::Journal => PathBuf::new(),
            Names::Strict => change.folder.clone(),
        };
        let groups: Vec<PathBuf> = self.changes.iter().map(group).collect();
        for (_, group) in self.changes.iter().zip(&groups).filter(|(change, _)| !change.is_durable) {
            *pending.entry(group).or_default() += 1;
        }
        pending.values_mut().for_each(|count| *count = draws.below(*count + 1));
        let mut tree = Tree::from([(self.root.clone(), Node::Folder)]);
        for (change, group) in self.changes.iter().zip(&groups) {
            let left = pending.get_mut(group.as_path()).filter(|_| !change.is_durable);
            match left {
                Some(0) => continue,
                Some(left) => *left -= 1,
                None => {}
            }
            apply(&mut tree, change);
        }
        tree
    }
}

/// Changes names, unless the folder is not there.
fn apply(tree: &mut Tree, change: &Change) {
    let moved: Tree = match &change.gone {
        Some(gone) => tree.extract_if(gone.clone().., |path, _| path.starts_with(gone)).collect(),
        None => Tree::new(),
    };
    let Some((to, Some(node))) = &change.put else { return };
    if !to.parent().is_some_and(|folder| matches!(tree.get(folder), Some(Node::Folder))) {
        return;
    }
    tree.insert(to.clone(), node.clone());
    let gone = change.gone.as_deref().unwrap_or(to);
    let below = moved.into_iter().filter_map(|(path, node)| Some((to.join(path.strip_prefix(gone).ok()?), node)));
    tree.extend(below.filter(|(path, _)| path != to));
}

impl File {
    fn write(&mut self, at: usize, bytes: &[u8]) {
        let end = at + bytes.len();
        self.now.resize(self.now.len().max(end), 0);
        self.now[at..end].copy_from_slice(bytes);
        self.dirty.extend(at / SECTOR_BYTES..end.div_ceil(SECTOR_BYTES));
    }

    /// What is left of its bytes: the size from before or now, and of each sector written since what is there or what was.
    fn left(&self, draws: &mut Draws, tenths: u64) -> Vec<u8> {
        let size = if draws.chance(tenths.max(3)) { self.now.len() } else { self.durable.len() };
        let mut left = self.durable.clone();
        left.resize(size, 0);
        for start in self.dirty.iter().map(|sector| sector * SECTOR_BYTES).filter(|start| *start < size) {
            let end = (start + SECTOR_BYTES).min(size).min(self.now.len());
            if start < end && draws.chance(tenths) {
                left[start..end].copy_from_slice(&self.now[start..end]);
            }
        }
        left
    }
}

fn write(root: &Path, tree: &Tree, content: impl Fn(usize) -> Vec<u8>, files: &[File]) {
    for entry in fs::read_dir(root).unwrap().flatten() {
        let path = entry.path();
        let is_folder = entry.file_type().unwrap().is_dir();
        if is_folder { fs::remove_dir_all(path) } else { fs::remove_file(path) }.unwrap();
    }
    let mut written: HashMap<usize, &Path> = HashMap::new();
    for (path, node) in tree.iter().filter(|(path, _)| *path != root) {
        match node {
            Node::Folder => fs::create_dir(path).unwrap(),
            Node::Link(to) => std::os::unix::fs::symlink(to, path).unwrap(),
            Node::File(number) if written.contains_key(number) => fs::hard_link(written[number], path).unwrap(),
            Node::File(number) => {
                written.insert(*number, path);
                fs::write(path, content(*number)).unwrap();
                let (file, meta) = (fs::File::open(path).unwrap(), &files[*number]);
                file.set_modified(UNIX_EPOCH + Duration::from_nanos(meta.time_ns)).unwrap();
                file.set_permissions(fs::Permissions::from_mode(meta.mode)).unwrap();
            }
        }
    }
}
