//! A small likeness of an artefact, for logs and reports: what was left out is said beside it.
//!
//! They are drawn by [`crate::Look::sketches`]. Sketches are made once, when a step has run, and kept with
//! its record, so that what was dropped can still be looked at.

use serde::{Deserialize, Serialize};

use super::{Cameras, Table, Transform};

/// One likeness of an artefact or of a part of it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Sketch {
    /// What part it shows: empty for the artefact itself, otherwise a channel, a band, or a second view such as `cloud`.
    pub part: String,
    /// What was left out, such as `every 4th column and row`; empty where it shows all there is.
    pub reduced: String,
    /// The likeness itself.
    pub shape: Shape,
}

impl Sketch {
    /// A sketch of all there is.
    pub fn whole(part: &str, shape: Shape) -> Self {
        Self { part: part.to_owned(), reduced: String::new(), shape }
    }
}

/// A sketch of the output of a port.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Shown {
    /// The output port whose artefact it shows.
    pub port: String,
    /// A likeness of that artefact or of a part of it.
    pub sketch: Sketch,
}

/// What a sketch consists of. Coordinates are metres in the frame named.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shape {
    /// Pixels: a channel or band in false colours, or a picture made for people.
    Picture(PictureSketch),
    /// Points that no triangles connect.
    Cloud(CloudSketch),
    /// Triangle meshes, one or several.
    Bodies(BodiesSketch),
    /// Values on a grid.
    Grid(GridSketch),
    /// Interior and exterior orientations.
    Cameras(Cameras),
    /// A rigid transform between two frames.
    Transform(Transform),
    /// The first rows of a table, with the names of its columns.
    Table(Table),
    /// Anything else, as JSON.
    Values(serde_json::Value),
}

/// A picture of at most 512 pixels a side; one made for people is as large as it was made.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PictureSketch {
    /// Number of pixel columns.
    pub width: u32,
    /// Number of pixel rows.
    pub height: u32,
    /// What its colours stand for; `None` for a picture made for people, which says so itself.
    pub colours: Option<ColourKey>,
    /// The image of the survey whose pixels these are.
    pub image: Option<String>,
    /// The content of the PNG file, which the JSON leaves out.
    #[serde(skip)]
    pub png: Vec<u8>,
}

/// What the colours of a picture stand for: `low` is the first colour of the palette, `high` the last, grey is no value.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ColourKey {
    /// The quantity, such as `depth`, `noise.local` or `difference`.
    pub quantity: String,
    /// The unit of `low` and `high`.
    pub unit: String,
    /// `viridis`, `red_blue` (red negative, white zero) or `grey`.
    pub palette: String,
    /// Value of the first colour; what lies below has it too.
    pub low: f64,
    /// Value of the last colour; what lies above has it too.
    pub high: f64,
}

/// Points of a cloud, as 32-bit numbers about an origin.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CloudSketch {
    /// Frame of the points.
    pub frame: String,
    /// Added to every point, metres.
    pub origin_m: [f64; 3],
    /// Points relative to the origin, metres.
    #[serde(skip)]
    pub points: Vec<[f32; 3]>,
}

/// Triangle meshes about one origin, in one frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BodiesSketch {
    /// Frame of the vertices.
    pub frame: String,
    /// Added to every vertex, metres.
    pub origin_m: [f64; 3],
    /// The meshes, in the order of the artefact.
    pub bodies: Vec<Body>,
}

/// One of the meshes, with 32-bit vertices.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Body {
    /// Its name; empty for the only one.
    pub name: String,
    /// What sort of thing it is; may be empty.
    pub class: String,
    /// Vertices relative to the origin, metres.
    #[serde(skip)]
    pub vertices: Vec<[f32; 3]>,
    /// Vertex indices of each triangle.
    #[serde(skip)]
    pub triangles: Vec<[u32; 3]>,
}

/// Values on a square grid.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GridSketch {
    /// Frame of X and Y.
    pub frame: String,
    /// What the values are.
    pub quantity: String,
    /// Number of columns of the sketch.
    pub columns: usize,
    /// Number of rows of the sketch.
    pub rows: usize,
    /// Side of a cell of the sketch, metres.
    pub cell_m: f64,
    /// X of the left edge, metres.
    pub left_m: f64,
    /// Y of the top edge, metres.
    pub top_m: f64,
    /// The bands that are shown, all on this grid.
    pub bands: Vec<GridBand>,
}

/// Values of one band.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct GridBand {
    /// The name the band has in the raster.
    pub name: String,
    /// Values by row from the top, NaN where there is none.
    #[serde(skip)]
    pub values: Vec<f32>,
}
