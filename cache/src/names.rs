//! Names that come from outside the program and become parts of paths: checked where they come in, and nowhere else.
//!
//! What a record, a manifest or an archive says was written by anybody. A text becomes part of a path only as one of these
//! two types, whose constructors refuse whatever would lead out of its folder.

use std::fmt;
use std::ops::Deref;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

/// The longest name every file system takes, bytes.
const NAME_BYTES: usize = 255;

/// Why a text cannot be a name, or a path of names.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{}` cannot name a file: {why}", text.escape_debug())]
pub struct NameError {
    /// The text as given.
    pub text: String,
    /// What is wrong with it.
    pub why: &'static str,
}

/// The name of one file or folder: it stays in the folder it is joined to.
///
/// ```
/// use rockface_cache::SafeName;
///
/// assert!(SafeName::new("mesh").is_ok());
/// assert!(SafeName::new("../mesh").is_err());
/// ```
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub struct SafeName(String);

/// A relative path of [`SafeName`]s, `/` between them: it stays below the folder it is joined to.
///
/// ```
/// use rockface_cache::{SafeName, SafePath};
///
/// let tile = SafePath::new("tiles/train")?.with(&SafeName::new("0001.npz")?);
/// assert_eq!(std::path::Path::new("set").join(&tile), std::path::Path::new("set/tiles/train/0001.npz"));
/// assert_eq!(SafePath::new("tiles/../..").unwrap_err().why, "it leads to another folder");
/// # Ok::<(), rockface_cache::NameError>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String")]
pub struct SafePath(PathBuf);

impl SafeName {
    /// Takes a text for a name, if it can be one.
    pub fn new(text: impl Into<String>) -> Result<Self, NameError> {
        let text = text.into();
        match fault(&text) {
            None => Ok(Self(text)),
            Some(why) => Err(NameError { text, why }),
        }
    }

    /// The name as text, without any `/`.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

/// Why a text is not the name of a file.
fn fault(text: &str) -> Option<&'static str> {
    match text {
        "" => Some("it is empty"),
        "." | ".." => Some("it leads to another folder"),
        _ if text.contains(['/', '\\']) => Some("it is a path and not a name"),
        _ if text.contains(char::is_control) => Some("it has control characters"),
        _ if text.len() > NAME_BYTES => Some("it is longer than 255 bytes"),
        _ => None,
    }
}

impl SafePath {
    /// Takes a text for a relative path, if each part of it can be a name.
    pub fn new(text: &str) -> Result<Self, NameError> {
        let found = if text.starts_with('/') {
            Some("it is an absolute path where one relative to its folder is needed")
        } else if text.ends_with('/') || text.contains("//") {
            Some("a part of it between two `/`, or after the last, is empty")
        } else {
            text.split('/').find_map(fault)
        };
        match found {
            None => Ok(Self(PathBuf::from(text))),
            Some(why) => Err(NameError { text: text.to_owned(), why }),
        }
    }

    /// The same for a path.
    pub fn of(path: &Path) -> Result<Self, NameError> {
        match path.to_str() {
            Some(text) => Self::new(text),
            None => Err(NameError { text: path.to_string_lossy().into_owned(), why: "it is not UTF-8" }),
        }
    }

    /// Something in the folder that this is.
    #[must_use]
    pub fn with(&self, name: &SafeName) -> Self {
        Self(self.0.join(&name.0))
    }

    /// A path below this one.
    #[must_use]
    pub fn below(&self, path: &Self) -> Self {
        Self(self.0.join(&path.0))
    }
}

impl From<SafeName> for SafePath {
    fn from(name: SafeName) -> Self {
        Self(PathBuf::from(name.0))
    }
}

impl TryFrom<String> for SafeName {
    type Error = NameError;
    fn try_from(text: String) -> Result<Self, NameError> {
        Self::new(text)
    }
}

impl TryFrom<String> for SafePath {
    type Error = NameError;
    fn try_from(text: String) -> Result<Self, NameError> {
        Self::new(&text)
    }
}

impl From<NameError> for std::io::Error {
    fn from(error: NameError) -> Self {
        Self::new(std::io::ErrorKind::InvalidInput, error)
    }
}

impl Deref for SafeName {
    type Target = str;
    fn deref(&self) -> &str {
        &self.0
    }
}

impl Deref for SafePath {
    type Target = Path;
    fn deref(&self) -> &Path {
        &self.0
    }
}

impl AsRef<Path> for SafeName {
    fn as_ref(&self) -> &Path {
        self.0.as_ref()
    }
}

impl AsRef<Path> for SafePath {
    fn as_ref(&self) -> &Path {
        &self.0
    }
}

impl fmt::Display for SafeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_name_leads_nowhere_else() {
        for text in ["", ".", "..", "a/b", "/a", "a\\b", "a\0b", "a\nb", "\u{1b}[2J", &"x".repeat(256)] {
            let fault = SafeName::new(text).unwrap_err().to_string();
            assert!(fault.contains("cannot name a file") && !fault.contains('\u{1b}'), "{fault}");
            assert!(serde_json::from_value::<SafeName>(text.into()).is_err());
        }
        for text in ["mesh", "..mesh", "ä b,c=d[e]", ".mesh", &"x".repeat(255)] {
            assert_eq!(SafeName::new(text).unwrap().as_str(), text);
        }
    }

    #[test]
    fn a_path_stays_below_its_folder() {
        for text in ["", "/a", "a/", "a//b", "../a", "a/../b", "a/./b", "./a", "a/b\0"] {
            assert!(SafePath::new(text).is_err(), "{text:?}");
            assert!(serde_json::from_value::<SafePath>(text.into()).is_err());
        }
        let why = |text: &str| SafePath::new(text).unwrap_err().why;
        assert!(
            why("/a/b").contains("absolute") && why("a//b").contains("between two `/`") && why("").contains("empty")
        );
        let path = SafePath::new("outputs/dem").unwrap().with(&SafeName::new("raster.tif").unwrap());
        assert_eq!(&*path, Path::new("outputs/dem/raster.tif"));
        assert_eq!(serde_json::to_value(&path).unwrap(), "outputs/dem/raster.tif");
    }

    proptest! {
        #[test]
        fn whatever_is_taken_has_only_plain_parts(text in "[a./\\\\\u{0}-\u{3}]{0,8}") {
            if let Ok(path) = SafePath::new(&text) {
                prop_assert!(path.components().all(|part| matches!(part, std::path::Component::Normal(_))));
                prop_assert!(path.is_relative() && path.components().count() == text.split('/').count());
            }
        }
    }
}
