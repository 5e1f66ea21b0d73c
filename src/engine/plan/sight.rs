//! What planning sees of the file system. Every look goes through here and is noted, so that a later run can tell whether
//! planning would see the same.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::fs::FileType;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

use rockface_cache::{Digest, Seen};

use crate::pipeline::fits_pattern;

/// What was seen where; links are followed.
pub type Looks = BTreeSet<(PathBuf, Seen)>;

/// Hashes a file, or says why it cannot.
pub type HashFile<'a> = dyn Fn(&Path) -> Result<Digest, String> + 'a;

/// Looks at files and folders, and notes what it sees.
pub struct Sight<'a> {
    hash: &'a HashFile<'a>,
    looks: RefCell<Looks>,
}

impl<'a> Sight<'a> {
    /// Nothing seen yet; files are hashed by `hash`.
    pub fn new(hash: &'a HashFile<'a>) -> Self {
        Self { hash, looks: RefCell::default() }
    }

    /// All that was seen.
    pub fn looks(self) -> Looks {
        self.looks.into_inner()
    }

    fn note(&self, path: &Path, seen: Seen) {
        self.looks.borrow_mut().insert((path.to_owned(), seen));
    }

    /// The digest of a file.
    ///
    /// # Errors
    /// A file of the kernel, such as `/proc/kmsg`, which looks like any other and whose reading may wait for ever; those of `hash`.
    pub fn hash(&self, path: &Path) -> Result<Digest, String> {
        // A pipe behind `/proc/self/fd/3` has no path of its own, and a file there has that of the file.
        let real = path.canonicalize().unwrap_or_default();
        if ["/proc", "/sys"].iter().any(|of_kernel| real.starts_with(of_kernel)) {
            let what = "a file of the kernel, whose reading may never end";
            return Err(format!("`{}` is {what}: copy what is needed of it into a file", path.display()));
        }
        let digest = (self.hash)(path)?;
        self.note(path, Seen::File(digest));
        Ok(digest)
    }

    /// The files of a folder, the files matching `*` in the last part of a path, or one file; sorted by name.
    pub fn list(&self, path: &Path) -> Result<Vec<PathBuf>, String> {
        let pattern =
            path.file_name().map(|name| name.to_string_lossy().into_owned()).filter(|name| name.contains('*'));
        let folder = match &pattern {
            Some(_) => path.parent().unwrap_or(Path::new(".")),
            None if path.is_dir() => path,
            None => return one_file(path),
        };
        let matches = |file: &Path| {
            let name = file.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
            pattern.as_ref().map_or(!name.starts_with('.'), |pattern| fits_pattern(pattern, &name))
        };
        let named = self.entries(folder).map_err(|error| format!("cannot read `{}`: {error}", folder.display()))?;
        let (named, others): (Vec<PathBuf>, Vec<PathBuf>) = named.into_iter().partition(|file| matches(file));
        let mut files: Vec<PathBuf> = named.into_iter().filter(|file| self.is_file(file)).collect();
        files.sort();
        if files.is_empty() {
            let shown = path.display();
            let other = others.iter().filter(|_| pattern.is_some()).min().and_then(|other| other.file_name());
            return Err(match other {
                Some(other) => format!("`{shown}` names no file; `{}` is there", other.display()),
                None if pattern.is_some() => format!("`{shown}` names no file"),
                None => match below(path, DEPTH) {
                    Some(below) => {
                        format!("`{shown}` is a folder without files of its own; `{}` has some", below.display())
                    }
                    None => format!("`{shown}` is a folder without files"),
                },
            });
        }
        Ok(files)
    }

    fn entries(&self, folder: &Path) -> std::io::Result<Vec<PathBuf>> {
        // Before it is listed: an entry that comes meanwhile is then missed by both or shows in the state.
        self.note(folder, Seen::folder(folder));
        std::fs::read_dir(folder)?.map(|entry| entry.map(|entry| entry.path())).collect()
    }

    /// Whether a name leads to a file; one that does not may begin to without a change of its folder, as links do.
    pub fn is_file(&self, path: &Path) -> bool {
        let is_file = path.is_file();
        if !is_file {
            self.note(path, Seen::NoFile);
        }
        is_file
    }
}

/// How far below a folder without files others are looked for: that of a project of COLMAP has its model in `sparse/0`.
const DEPTH: usize = 3;

/// The first folder below one that has files of its own.
fn below(folder: &Path, depth: usize) -> Option<PathBuf> {
    let shown = |entry: &std::fs::DirEntry| !entry.file_name().to_string_lossy().starts_with('.');
    let entries = std::fs::read_dir(folder).ok()?.flatten().filter(shown);
    let mut entries: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    entries.sort();
    entries.iter().any(|entry| entry.is_file()).then(|| folder.to_owned()).or_else(|| {
        let depth = depth.checked_sub(1)?;
        entries.iter().filter(|entry| entry.is_dir()).find_map(|entry| below(entry, depth))
    })
}

/// The file at a path.
pub fn one_file(path: &Path) -> Result<Vec<PathBuf>, String> {
    let shown = path.display();
    match std::fs::metadata(path) {
        Ok(metadata) if metadata.is_file() => Ok(vec![path.to_owned()]),
        Ok(metadata) => Err(format!("`{shown}` is {}, a file is needed", kind_of(metadata.file_type()))),
        Err(error) => Err(format!("cannot read `{shown}`: {error}")),
    }
}

/// What is somewhere in place of a regular file.
pub fn kind_of(entry: FileType) -> &'static str {
    if entry.is_dir() {
        "a folder"
    } else if entry.is_fifo() {
        "a pipe"
    } else if entry.is_socket() {
        "a socket"
    } else if entry.is_symlink() {
        "a link"
    } else {
        "a device"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_without_files_is_told_with_the_one_below_that_has_some() {
        let place = tempfile::tempdir().unwrap();
        let project = place.path().join("project");
        std::fs::create_dir_all(project.join("sparse/0")).unwrap();
        std::fs::write(project.join(".hidden"), "").unwrap();
        let sight = Sight::new(&|_| Ok(Digest::of(b"")));
        let told = sight.list(&project).unwrap_err();
        assert!(told.ends_with("project` is a folder without files"), "{told}");
        std::fs::write(project.join("sparse/0/cameras.bin"), "").unwrap();
        let told = sight.list(&project).unwrap_err();
        assert!(told.ends_with("project/sparse/0` has some"), "{told}");
        let told = sight.list(&project.join("*.bin")).unwrap_err();
        assert!(told.ends_with("*.bin` names no file; `.hidden` is there"), "{told}");
    }

    #[test]
    fn what_is_no_file_is_called_what_it_is() {
        assert!(one_file(Path::new("/dev/null")).unwrap_err().contains("`/dev/null` is a device"));
        assert!(one_file(Path::new("/dev")).unwrap_err().contains("is a folder"));
    }

    #[test]
    fn all_that_decides_a_list_is_noted() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        for name in ["d1.tif", "d2.tif", "other"] {
            std::fs::write(place(name), name).unwrap();
        }
        std::os::unix::fs::symlink(place("nowhere"), place("d3.tif")).unwrap();
        let hash = |path: &Path| std::fs::read(path).map(|bytes| Digest::of(&bytes)).map_err(|error| error.to_string());
        let sight = Sight::new(&hash);
        let listed = sight.list(&place("d*.tif")).unwrap();
        assert_eq!(listed, [place("d1.tif"), place("d2.tif")]);
        sight.hash(&listed[0]).unwrap();
        let looks = sight.looks();
        assert!(looks.contains(&(place("d3.tif"), Seen::NoFile)));
        assert!(looks.contains(&(place("d1.tif"), Seen::File(Digest::of(b"d1.tif")))));
        assert!(looks.iter().any(|(path, seen)| path == folder.path() && matches!(seen, Seen::Folder(_))));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_file_of_the_kernel_is_not_read_by_whatever_name() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("m.prj");
        std::os::unix::fs::symlink("/proc/kmsg", &link).unwrap();
        let hash = |_: &Path| -> Result<Digest, String> { panic!("it is read") };
        let sight = Sight::new(&hash);
        for path in [Path::new("/proc/self/status"), &link] {
            assert!(sight.hash(path).unwrap_err().contains("is a file of the kernel"), "{}", path.display());
        }
        let file = std::fs::File::create(folder.path().join("a.csv")).unwrap();
        let open = PathBuf::from(format!("/proc/self/fd/{}", std::os::fd::AsRawFd::as_raw_fd(&file)));
        let digest = Digest::of(b"");
        let hash = |_: &Path| Ok(digest);
        assert_eq!(Sight::new(&hash).hash(&open), Ok(digest));
    }
}
