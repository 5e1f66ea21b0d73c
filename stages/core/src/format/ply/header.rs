//! The header of a PLY file: encoding, elements and their properties, and the frame our own files state.

use crate::artefact::{CodecError, Frame, Georeference};

/// Elements and properties a header may declare: a file with more is damaged.
const MOST_DECLARATIONS: usize = 4096;

/// Start of the comment that states the frame of our own files; the frame and [`UNITS_COMMENT`] follow.
pub const FRAME_COMMENT: &str = "rockface mesh, frame ";
/// The same for a point cloud.
pub const CLOUD_COMMENT: &str = "rockface cloud, frame ";
/// Start of the comment that states where the frame lies on the Earth, on a line of its own.
pub const GEOREFERENCE_COMMENT: &str = "comment rockface georeference ";
/// End of these comments.
pub const UNITS_COMMENT: &str = ", units metres";

/// How numbers are written.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Encoding {
    /// Decimal numbers in lines of text.
    Ascii,
    /// Binary, least significant byte first.
    LittleEndian,
    /// Binary, most significant byte first.
    BigEndian,
}

/// Type of a number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Type {
    fn parse(word: &str) -> Result<Self, CodecError> {
        Ok(match word {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return Err(bad(&format!("unknown number type `{}`", shorten(word)))),
        })
    }

    /// The word for it in a header.
    pub fn word(self) -> &'static str {
        match self {
            Self::I8 => "char",
            Self::U8 => "uchar",
            Self::I16 => "short",
            Self::U16 => "ushort",
            Self::I32 => "int",
            Self::U32 => "uint",
            Self::F32 => "float",
            Self::F64 => "double",
        }
    }

    /// How many bytes it takes in a binary file.
    pub fn bytes(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// A property of an element: a number, or a list where `count` is given.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Property {
    /// Its name, such as `x` or `vertex_indices`.
    pub name: String,
    /// Type of the list's length.
    pub count: Option<Type>,
    /// Type of the number, or of the list's items.
    pub kind: Type,
}

impl Property {
    /// The fewest bytes it takes in a binary file.
    fn least_bytes(&self) -> usize {
        self.count.unwrap_or(self.kind).bytes()
    }

    fn is_corners(&self) -> bool {
        self.count.is_some() && matches!(self.name.as_str(), "vertex_indices" | "vertex_index")
    }
}

/// An element: so many rows of the same properties.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Element {
    /// Its name, such as `vertex` or `face`.
    pub name: String,
    /// How many rows the file has of it.
    pub count: usize,
    /// Properties in the order of the file.
    pub properties: Vec<Property>,
}

impl Element {
    /// Type of the property of this name that is a single number.
    pub fn scalar(&self, name: &str) -> Option<Type> {
        self.properties.iter().find(|p| p.name == name && p.count.is_none()).map(|p| p.kind)
    }

    /// Position of the list of a face's corners.
    pub fn corners(&self) -> Option<usize> {
        self.properties.iter().position(Property::is_corners)
    }

    /// The fewest numbers a row has, and the fewest bytes it takes in a binary file.
    pub fn least_row(&self) -> (usize, usize) {
        (self.properties.len(), self.properties.iter().map(Property::least_bytes).sum())
    }

    /// The same for a row that is a face: it has at least three corners.
    pub fn least_face(&self) -> (usize, usize) {
        let (numbers, bytes) = self.least_row();
        let corner = self.corners().map_or(0, |place| self.properties[place].kind.bytes());
        (numbers + 3, bytes + 3 * corner)
    }
}

/// What a PLY file says before its rows.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Header {
    /// How numbers are written.
    pub encoding: Encoding,
    /// Elements in the order of the file.
    pub elements: Vec<Element>,
    /// The frame our own comment states, otherwise world.
    pub frame: Frame,
    /// Whether a comment states it.
    pub states_frame: bool,
}

impl Header {
    /// Reads the header; returns it and the bytes after it.
    pub fn parse(bytes: &[u8]) -> Result<(Self, &[u8]), CodecError> {
        let (magic, mut rest) = line(bytes);
        if magic != Some("ply") {
            return Err(bad("the first line is not `ply`"));
        }
        let (mut encoding, mut elements, mut stated) = (None, Vec::new(), None);
        let mut georeference = None;
        let mut declared = 0;
        loop {
            if rest.is_empty() {
                return Err(bad("the header has no `end_header`; the file is cut short"));
            }
            let (text, after) = line(rest);
            rest = after;
            let text = text.ok_or_else(|| bad("a header line is not text"))?;
            let words: Vec<&str> = text.split_whitespace().collect();
            match words.as_slice() {
                ["end_header"] => break,
                ["format", word, _version] => encoding = Some(parse_encoding(word)?),
                ["comment", ..] => {
                    stated = stated_frame(text).or(stated);
                    if let Some(text) = text.strip_prefix(GEOREFERENCE_COMMENT) {
                        georeference = Some(Georeference::from_text(text)?);
                    }
                }
                ["obj_info", ..] | [] => {}
                ["element" | "property", ..] if declared == MOST_DECLARATIONS => {
                    return Err(bad(&format!(
                        "the header declares more than {MOST_DECLARATIONS} elements and properties"
                    )));
                }
                ["element", name, count] => {
                    declared += 1;
                    add_element(&mut elements, name, count)?;
                }
                ["property", property @ ..] => {
                    declared += 1;
                    add_property(&mut elements, property)?;
                }
                _ => return Err(bad(&format!("cannot read the header line `{}`", shorten(text)))),
            }
        }
        let encoding = encoding.ok_or_else(|| bad("the header states no `format`"))?;
        let frame = stated.unwrap_or(Frame::World).at(georeference);
        Ok((Self { encoding, elements, frame, states_frame: stated.is_some() }, rest))
    }

    /// An element by name.
    pub fn element(&self, name: &str) -> Option<&Element> {
        self.elements.iter().find(|element| element.name == name)
    }
}

/// The first line (`None` where it is not text) and what follows it.
fn line(bytes: &[u8]) -> (Option<&str>, &[u8]) {
    let end = bytes.iter().position(|b| *b == b'\n');
    let (text, rest) = end.map_or((bytes, &bytes[bytes.len()..]), |end| (&bytes[..end], &bytes[end + 1..]));
    (std::str::from_utf8(text).ok().map(str::trim_end), rest)
}

fn parse_encoding(word: &str) -> Result<Encoding, CodecError> {
    match word {
        "ascii" => Ok(Encoding::Ascii),
        "binary_little_endian" => Ok(Encoding::LittleEndian),
        "binary_big_endian" => Ok(Encoding::BigEndian),
        _ => Err(bad(&format!("unknown format `{}`", shorten(word)))),
    }
}

fn stated_frame(comment: &str) -> Option<Frame> {
    let comment = comment.strip_prefix("comment ")?;
    let stated = comment.strip_prefix(FRAME_COMMENT).or_else(|| comment.strip_prefix(CLOUD_COMMENT))?;
    let stated = stated.strip_suffix(UNITS_COMMENT)?;
    Frame::named(stated)
}

/// The line that states where a frame lies on the Earth; empty where that is not known.
pub fn georeference_line(frame: Frame) -> String {
    let line = |georeference: &Georeference| format!("{GEOREFERENCE_COMMENT}{}\n", georeference.to_text());
    frame.georeference().map_or_else(String::new, line)
}

fn add_element(elements: &mut Vec<Element>, name: &str, count: &str) -> Result<(), CodecError> {
    let count = count.parse().map_err(|_| bad(&format!("`{}` is not a number of `{name}`", shorten(count))))?;
    if elements.iter().any(|element| element.name == name) {
        return Err(bad(&format!("element `{}` is declared twice", shorten(name))));
    }
    elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
    Ok(())
}

fn add_property(elements: &mut [Element], words: &[&str]) -> Result<(), CodecError> {
    let element = elements.last_mut().ok_or_else(|| bad("a property comes before any element"))?;
    let property = match words {
        ["list", count, kind, name] => {
            Property { name: (*name).to_owned(), count: Some(Type::parse(count)?), kind: Type::parse(kind)? }
        }
        [kind, name] => Property { name: (*name).to_owned(), count: None, kind: Type::parse(kind)? },
        _ => return Err(bad(&format!("cannot read the property `{}`", shorten(&words.join(" "))))),
    };
    // Two of them would be read as one, be it the first or the last.
    let is_place = element.name == "vertex" && ["x", "y", "z"].contains(&property.name.as_str());
    if is_place && element.scalar(&property.name).is_some() {
        return Err(bad(&format!("`{}` has two properties `{}`", shorten(&element.name), property.name)));
    }
    element.properties.push(property);
    Ok(())
}

fn shorten(text: &str) -> String {
    text.chars().take(60).collect()
}

fn bad(message: &str) -> CodecError {
    CodecError(format!("PLY file: {message}"))
}
