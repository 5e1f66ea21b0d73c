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
    /// The place in the copy of a file or folder; of one that was not copied, its own.
    #[must_use]
    pub fn place(&self, path: &Path) -> PathBuf {
        self.moved(&without_detours(path))
    }

    /// The same for a path that is taken as it is written.
    #[must_use]
    pub fn moved(&self, path: &Path) -> PathBuf {
        let path = self.before.as_ref().map_or_else(|| path.to_owned(), |before| before.moved(path));
        path.strip_prefix(&self.from).map_or_else(|_| path.clone(), |below| self.to.join(below))
    }

    /// What a place in the copy is a copy of, in the end.
    fn original(&self, path: &Path) -> PathBuf {
        let path = path.strip_prefix(&self.to).map_or_else(|_| path.to_owned(), |below| self.from.join(below));
        self.before.as_ref().map_or_else(|| path.clone(), |before| before.original(&path))
    }
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

    #[test]
    fn paths_lead_into_the_copy_however_they_are_written() {
        let copied = Copied { from: "/lab".into(), to: "/new/inputs".into(), before: None };
        let base = Base::new(Path::new("/new/inputs/slope/p").into(), Some(Arc::new(copied)));
        let leads = |written: &str| base.path(written).display().to_string();
        assert_eq!(leads("a.ply"), "/new/inputs/slope/p/a.ply");
        assert_eq!(leads("../../scans/a.ply"), "/new/inputs/scans/a.ply");
        assert_eq!(leads("/lab/scans/./a.ply"), "/new/inputs/scans/a.ply");
        // The way there leaves the folder that was copied.
        assert_eq!(leads("../../../lab/a.ply"), "/new/inputs/a.ply");
        // Not copied, or given anew.
        assert_eq!(leads("/other/a.ply"), "/other/a.ply");
        assert_eq!(leads("/new/inputs/b.ply"), "/new/inputs/b.ply");
        // A copy of the copy.
        let copied = Copied {
            from: "/new/inputs/slope".into(),
            to: "/third/inputs".into(),
            before: Some(Box::new(Copied { from: "/lab".into(), to: "/new/inputs".into(), before: None })),
        };
        let base = Base::new(Path::new("/third/inputs/p").into(), Some(Arc::new(copied)));
        assert_eq!(base.path("../scans/a.ply"), Path::new("/third/inputs/scans/a.ply"));
        assert_eq!(base.path("/lab/slope/scans/a.ply"), Path::new("/third/inputs/scans/a.ply"));
        assert_eq!(Base::new(Path::new("p").into(), None).path("../a.ply"), Path::new("p/../a.ply"));
    }
}
