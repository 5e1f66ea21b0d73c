//! Where the paths that are written in a pipeline lead: to where they say, or into a copy of the files.

use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

/// A copy of all files below a folder, each in the same place below another folder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Copied {
    /// The absolute path of the folder that was copied.
    pub from: PathBuf,
    /// The absolute path of the copy.
    pub to: PathBuf,
    /// What was copied, where that was a copy too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before: Option<Box<Copied>>,
}

impl Copied {
    /// Where a file, a folder or a pattern leads: into the copy, unless what it names is not there but in its own place.
    #[must_use]
    pub fn place(&self, path: &Path) -> PathBuf {
        let own = without_detours(path);
        let copy = self.moved(&own);
        if is_there(&copy) || !is_there(&own) { copy } else { own }
    }

    /// The place in the copy of a path that has no `..` in it, whether anything is there or not.
    #[must_use]
    pub fn moved(&self, path: &Path) -> PathBuf {
        if path.starts_with(&self.to) {
            return path.to_owned();
        }
        let path = self.before.as_ref().map_or_else(|| path.to_owned(), |before| before.moved(path));
        path.strip_prefix(&self.from).map_or_else(|_| path.clone(), |below| self.to.join(below))
    }

    /// What a place in the copy is a copy of, in the end.
    fn original(&self, path: &Path) -> PathBuf {
        let path = path.strip_prefix(&self.to).map_or_else(|_| path.to_owned(), |below| self.from.join(below));
        self.before.as_ref().map_or_else(|| path.clone(), |before| before.original(&path))
    }
}

/// Whether something is at a path, or fits the pattern in its last part.
fn is_there(path: &Path) -> bool {
    let pattern = path.file_name().map(|name| name.to_string_lossy()).filter(|name| name.contains('*'));
    let Some(pattern) = pattern else { return path.exists() };
    let entries = path.parent().map(std::fs::read_dir).into_iter().flatten().flatten().flatten();
    entries.into_iter().any(|entry| fits_pattern(&pattern, &entry.file_name().to_string_lossy()))
}

/// Whether a name fits a pattern in which `*` stands for any text.
pub fn fits_pattern(pattern: &str, name: &str) -> bool {
    let Some((head, rest)) = pattern.split_once('*') else { return pattern == name };
    let (middle, last) = rest.rsplit_once('*').map_or((None, rest), |(middle, last)| (Some(middle), last));
    let Some(inner) = name.strip_prefix(head).and_then(|tail| tail.strip_suffix(last)) else { return false };
    // Between the first and the last star: each part at the first place it fits leaves the most for those behind it.
    let mut parts = middle.into_iter().flat_map(|middle| middle.split('*'));
    parts.try_fold(inner, |left, part| left.find(part).map(|at| &left[at + part.len()..])).is_some()
}

/// What the paths in a step are relative to.
#[derive(Debug, Clone)]
pub struct Base {
    folder: Arc<Path>,
    copied: Option<Arc<Copied>>,
}

impl Base {
    /// A folder; with `copied`, one of a copy.
    #[must_use]
    pub fn new(folder: Arc<Path>, copied: Option<Arc<Copied>>) -> Self {
        Self { folder, copied }
    }

    /// Where a path leads that is written in the step.
    #[must_use]
    pub fn path(&self, written: &str) -> PathBuf {
        match &self.copied {
            None => self.folder.join(written),
            Some(copied) => copied.place(&copied.original(&self.folder).join(written)),
        }
    }
}

/// A path in which no `..` goes back on the folder before it.
#[must_use]
pub fn without_detours(path: &Path) -> PathBuf {
    let mut straight = PathBuf::new();
    for part in path.components() {
        match part {
            Component::ParentDir => drop(straight.pop()),
            Component::CurDir => {}
            other => straight.push(other),
        }
    }
    straight
}

#[cfg(test)]
mod tests {
    use super::*;

    fn leads(copied: &Copied, folder: &str, written: &str) -> PathBuf {
        Base::new(Path::new(folder).into(), Some(Arc::new(copied.clone()))).path(written)
    }

    #[test]
    fn paths_lead_into_the_copy_however_they_are_written() {
        let copied = Copied { from: "/lab".into(), to: "/new/inputs".into(), before: None };
        for (written, expected) in [
            ("a.ply", "/new/inputs/slope/p/a.ply"),
            ("../../scans/a.ply", "/new/inputs/scans/a.ply"),
            ("/lab/scans/./a.ply", "/new/inputs/scans/a.ply"),
            // The way there leaves the folder that was copied.
            ("../../../lab/d*.tif", "/new/inputs/d*.tif"),
            // Not copied, or in the copy already.
            ("/other/a.ply", "/other/a.ply"),
            ("/new/inputs/b.ply", "/new/inputs/b.ply"),
        ] {
            assert_eq!(leads(&copied, "/new/inputs/slope/p", written), Path::new(expected), "{written}");
        }
        assert_eq!(Base::new(Path::new("p").into(), None).path("../a.ply"), Path::new("p/../a.ply"));
        // A copy of the copy.
        let before = Some(Box::new(copied));
        let third = Copied { from: "/new/inputs/slope".into(), to: "/third/inputs".into(), before };
        for written in ["../scans/a.ply", "/lab/slope/scans/a.ply"] {
            assert_eq!(leads(&third, "/third/inputs/p", written), Path::new("/third/inputs/scans/a.ply"), "{written}");
        }
    }

    #[test]
    fn a_copy_below_what_was_copied_is_not_copied_again_and_new_files_are_found() {
        let lab = tempfile::tempdir().unwrap();
        let (from, to) = (lab.path().to_owned(), lab.path().join("ex/inputs"));
        std::fs::create_dir_all(to.join("data")).unwrap();
        std::fs::create_dir(from.join("data")).unwrap();
        for file in [from.join("data/a.ply"), to.join("data/a.ply"), from.join("data/new.ply")] {
            std::fs::write(file, "ply").unwrap();
        }
        let copied = Copied { from: from.clone(), to: to.clone(), before: None };
        let place = |path: &Path| copied.place(path);
        assert_eq!(place(&from.join("data/a.ply")), to.join("data/a.ply"));
        assert_eq!(place(&to.join("data/a.ply")), to.join("data/a.ply"));
        assert_eq!(place(&from.join("data/new.ply")), from.join("data/new.ply"));
        assert_eq!(place(&from.join("data/a*.ply")), to.join("data/a*.ply"));
        assert_eq!(place(&from.join("data/n*.ply")), from.join("data/n*.ply"));
        assert_eq!(place(&from.join("data/none.ply")), to.join("data/none.ply"));
    }

    #[test]
    fn patterns() {
        assert!(
            fits_pattern("*.tif", "a.tif")
                && fits_pattern("cmp_*_*.tif", "cmp_00_01.tif")
                && fits_pattern("*", "")
                && fits_pattern("**", "a")
        );
        assert!(fits_pattern("a*b*a", "abba") && fits_pattern("*a*b*", "xaxbx") && fits_pattern("a.tif", "a.tif"));
        assert!(!fits_pattern("*.tif", "a.tiff") && !fits_pattern("cmp_*.tif", "x_cmp_1.tif"));
        assert!(
            !fits_pattern("a*a", "a")
                && !fits_pattern("a*b*a", "aba_")
                && !fits_pattern("*a*b*", "bxa")
                && !fits_pattern("a*bb*b", "abb")
        );
    }

    #[test]
    fn a_pattern_of_many_stars_takes_no_longer_than_its_length() {
        assert!(!fits_pattern(&"*a".repeat(60), &format!("{}b", "a".repeat(250))));
    }
}
