//! Artefacts: typed immutable values that steps hand to each other, each kept as a file other programs open.
//!
//! `decode(encode(x)) = x` exactly, and equal values have equal bytes: the digest of an artefact is the digest of its file.

mod acceptance;
mod cameras;
pub mod candidates;
mod cloud;
mod covariance;
mod depth;
mod figure;
mod file;
mod files;
mod frame;
mod inventory;
mod mesh;
mod meshes;
mod noise;
mod pairs;
mod picture;
mod preview;
mod raster;
pub mod sketch;
mod surface;
mod table;
mod transform;

pub use acceptance::{Acceptance, GroupModel};
pub use cameras::{Cameras, Image, Sensor};
pub use candidates::Candidates;
pub use cloud::Cloud;
pub use covariance::Covariance;
pub use depth::Depth;
pub use figure::Figure;
pub use file::File;
pub use files::Files;
pub use frame::{Frame, Georeference};
pub use inventory::{Feature, Inventory, Polygon};
pub use mesh::Mesh;
pub use meshes::{Meshes, Part, file_names as part_file_names};
pub use noise::{
    Contrast, GAP, LateralShift, LevelContrast, LevelFigures, MOST_GAP_GAIN, MOST_GAP_VARIETY, MOST_SKEWNESS_GAIN,
    Member, Noise, Parametric, PlaceSpectrum, ReliefLaw, UNEVENNESS,
};
pub use pairs::{Pair, Pairs};
pub use picture::Picture;
pub use preview::Preview;
pub use raster::{Band, Grid, Raster, Sample};
pub use sketch::{Shown, Sketch};
pub use surface::{Extent, Surface};
pub use table::{Cell, Table, TableRow};
pub use transform::Transform;

/// A file that could not be read as an artefact, or an artefact that could not be written.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct CodecError(pub String);

impl CodecError {
    /// An error with this message.
    pub fn new(message: impl Into<String>) -> Self {
        Self(message.into())
    }
}

/// A second file made from an artefact, for programs that do not open the first.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Export {
    /// Where it goes, relative to the file of the artefact, with `/` between folders.
    pub path: String,
    /// The content of the file.
    pub bytes: Vec<u8>,
}

/// A type of artefact: its kind, its file, and what can be known without its type.
///
/// ```
/// use rockface_core::artefact::{Artefact, Kind, Noun, Table};
///
/// let table = Table::new(["name", "x_m"]);
/// assert_eq!(Table::decode(&table.encode()?)?, table);
///
/// let artefact = Artefact::from(table);
/// assert_eq!((artefact.kind(), Kind::Table.extension()), (Kind::Table, "json"));
/// assert_eq!(Table::of(&artefact).map(|table| table.columns.len()), Some(2));
/// # Ok::<(), rockface_core::artefact::CodecError>(())
/// ```
pub trait Noun: Sized {
    /// The kind that artefacts of this type have.
    const KIND: Kind;
    /// The value inside an artefact of this kind.
    fn of(artefact: &Artefact) -> Option<&Self>;
    /// The file that is kept and hashed.
    fn encode(&self) -> Result<Vec<u8>, CodecError>;
    /// Hands over the same file piece by piece, to those who need not hold it whole.
    ///
    /// # Errors
    /// As [`Noun::encode`].
    fn stream(&self, take: &mut dyn FnMut(&[u8])) -> Result<(), CodecError> {
        take(&self.encode()?);
        Ok(())
    }
    /// Reads the file that [`Noun::encode`] wrote.
    fn decode(bytes: &[u8]) -> Result<Self, CodecError>;
    /// Bytes it takes in memory, roughly.
    fn memory_bytes(&self) -> usize;
    /// The names of its elements where it is a list an axis could take its items from.
    fn items(&self) -> Option<Vec<String>> {
        None
    }
    /// Whether values of this kind have further files, so that those of other kinds need not be read to find none.
    fn has_exports() -> bool {
        false
    }
    /// Further files for people to read, beside a file called `stem` or in a folder of that name.
    ///
    /// # Errors
    /// What keeps a file from being written.
    fn exports(&self, stem: &str) -> Result<Vec<Export>, CodecError> {
        let _ = stem;
        Ok(Vec::new())
    }
}

macro_rules! artefacts {
    ($( $Name:ident = $word:literal . $extension:literal : $doc:literal ),* $(,)?) => {
        /// The kinds of artefact.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub enum Kind { $( #[doc = $doc] $Name ),* }

        impl Kind {
            /// All kinds, in the order of their declaration.
            pub const ALL: &'static [Kind] = &[$(Kind::$Name),*];

            /// Its name in records and messages.
            pub const fn word(self) -> &'static str {
                match self { $( Self::$Name => $word ),* }
            }

            /// The extension of its file, without the dot.
            pub const fn extension(self) -> &'static str {
                match self { $( Self::$Name => $extension ),* }
            }

            /// Whether its values have further files for people to read.
            pub fn has_exports(self) -> bool {
                match self { $( Self::$Name => $Name::has_exports() ),* }
            }
        }

        /// A typed immutable value: what a step hands to another. Each kind is a [`Noun`].
        #[derive(Debug, Clone, PartialEq)]
        #[allow(missing_docs)]
        pub enum Artefact { $( $Name($Name) ),* }

        impl Artefact {
            /// The kind of the value inside.
            pub fn kind(&self) -> Kind {
                match self { $( Self::$Name(_) => Kind::$Name ),* }
            }
            /// The file that is kept and hashed.
            pub fn encode(&self) -> Result<Vec<u8>, CodecError> {
                match self { $( Self::$Name(value) => value.encode() ),* }
            }
            /// Hands over the same file piece by piece; see [`Noun::stream`].
            pub fn stream(&self, take: &mut dyn FnMut(&[u8])) -> Result<(), CodecError> {
                match self { $( Self::$Name(value) => value.stream(take) ),* }
            }
            /// Reads a file of this kind.
            pub fn decode(kind: Kind, bytes: &[u8]) -> Result<Self, CodecError> {
                match kind { $( Kind::$Name => $Name::decode(bytes).map(Self::$Name) ),* }
            }
            /// Bytes it takes in memory, roughly.
            pub fn memory_bytes(&self) -> usize {
                match self { $( Self::$Name(value) => value.memory_bytes() ),* }
            }
            /// The names of its elements where it is a list.
            pub fn items(&self) -> Option<Vec<String>> {
                match self { $( Self::$Name(value) => value.items() ),* }
            }
            /// Further files for people to read, beside a file called `stem`; see [`Noun::exports`].
            pub fn exports(&self, stem: &str) -> Result<Vec<Export>, CodecError> {
                match self { $( Self::$Name(value) => value.exports(stem) ),* }
            }
        }

        $( impl From<$Name> for Artefact {
            fn from(value: $Name) -> Self { Self::$Name(value) }
        }

        impl TryFrom<Artefact> for $Name {
            /// What it is instead.
            type Error = Kind;
            fn try_from(artefact: Artefact) -> Result<Self, Kind> {
                if let Artefact::$Name(value) = artefact { Ok(value) } else { Err(artefact.kind()) }
            }
        } )*
    };
}

artefacts! {
    // Before the other kinds of PLY file: it alone refuses files with faces.
    Cloud = "cloud" . "ply": "Points with normals, colours and numbers.",
    Mesh = "mesh" . "ply": "Triangle mesh, f64 vertices.",
    Surface = "surface" . "surface": "Organised grid of points with implicit triangles.",
    Raster = "raster" . "tif": "One or more bands on a square grid: elevation, difference, mask.",
    Depth = "depth" . "exr": "Depth map of one image, with its camera.",
    Cameras = "cameras" . "json": "Sensors and oriented images.",
    Covariance = "covariance" . "json": "Joint covariance of orientation parameters.",
    Pairs = "pairs" . "json": "Stereo pairs.",
    Transform = "transform" . "json": "Rigid transform between two frames.",
    Table = "table" . "json": "Rows and columns.",
    Acceptance = "acceptance" . "json": "Reference model of noise descriptors.",
    Noise = "noise" . "noise": "Model of the matching noise of a site, learnt from rasters without change.",
    Picture = "picture" . "png": "A picture for people.",
    Figure = "figure" . "svg": "A chart for people.",
    Meshes = "meshes" . "ply": "Named meshes in one file: blocks, removed pieces, niches.",
    File = "file" . "bin": "A file that only the programs of a pipeline look into.",
    Files = "files" . "tar": "Files in another program's own format.",
    Inventory = "inventory" . "geojson": "Rockfalls: outline and properties of each.",
    Candidates = "candidates" . "json": "An unbounded sequence of candidate blocks.",
}

impl Artefact {
    /// The frame of its coordinates; `None` where it has none, or several as a transform.
    pub fn frame(&self) -> Option<Frame> {
        match self {
            Self::Cloud(value) => Some(value.frame),
            Self::Mesh(value) => Some(value.frame),
            Self::Surface(value) => Some(value.frame),
            Self::Raster(value) => Some(value.frame),
            Self::Depth(value) => Some(value.frame),
            Self::Cameras(value) => Some(value.frame),
            Self::Covariance(value) => Some(value.frame),
            Self::Meshes(value) => Some(value.frame),
            Self::Inventory(value) => Some(value.frame),
            Self::Noise(value) => Some(value.frame),
            _ => None,
        }
    }

    /// The same, to be changed.
    pub fn frame_mut(&mut self) -> Option<&mut Frame> {
        match self {
            Self::Cloud(value) => Some(&mut value.frame),
            Self::Mesh(value) => Some(&mut value.frame),
            Self::Surface(value) => Some(&mut value.frame),
            Self::Raster(value) => Some(&mut value.frame),
            Self::Depth(value) => Some(&mut value.frame),
            Self::Cameras(value) => Some(&mut value.frame),
            Self::Covariance(value) => Some(&mut value.frame),
            Self::Meshes(value) => Some(&mut value.frame),
            Self::Inventory(value) => Some(&mut value.frame),
            Self::Noise(value) => Some(&mut value.frame),
            _ => None,
        }
    }
}

impl Kind {
    /// Whether its values are lists that an axis could take its items from.
    pub const fn has_items(self) -> bool {
        matches!(self, Self::Cameras | Self::Pairs | Self::Raster | Self::Meshes | Self::Table)
    }
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.word())
    }
}

impl std::str::FromStr for Kind {
    type Err = CodecError;
    fn from_str(word: &str) -> Result<Self, CodecError> {
        let found = Self::ALL.iter().find(|kind| kind.word() == word);
        found.copied().ok_or_else(|| CodecError(format!("unknown kind of artefact `{word}`")))
    }
}

/// Implements [`Noun`] for a type that is kept as JSON; `check` says what its parts have to fit each other in.
macro_rules! json_noun {
    ($Name:ident $(checked by $check:path)? $(, $extra:item)*) => {
        impl super::Noun for $Name {
            const KIND: super::Kind = super::Kind::$Name;
            fn of(artefact: &super::Artefact) -> Option<&Self> {
                if let super::Artefact::$Name(value) = artefact { Some(value) } else { None }
            }
            fn encode(&self) -> Result<Vec<u8>, super::CodecError> {
                super::to_json(self)
            }
            fn decode(bytes: &[u8]) -> Result<Self, super::CodecError> {
                let value: Self = super::from_json(bytes)?;
                $( $check(&value)?; )?
                Ok(value)
            }
            fn memory_bytes(&self) -> usize {
                std::mem::size_of::<Self>()
            }
            $($extra)*
        }
    };
}
use json_noun;

/// Writes JSON that is sure to be read back: a number that is not finite would become `null`.
fn to_json<T: serde::Serialize + serde::de::DeserializeOwned>(value: &T) -> Result<Vec<u8>, CodecError> {
    let mut bytes = serde_json::to_vec_pretty(value).map_err(|e| CodecError(e.to_string()))?;
    bytes.push(b'\n');
    let read_back = from_json::<T>(&bytes).map_err(|e| CodecError(format!("a value in it is not finite: {}", e.0)));
    read_back.map(|_| bytes)
}

fn from_json<T: serde::de::DeserializeOwned>(bytes: &[u8]) -> Result<T, CodecError> {
    serde_json::from_slice(bytes).map_err(|e| CodecError(format!("not the JSON expected here: {e}")))
}
