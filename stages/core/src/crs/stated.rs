//! What a file, a `.prj` beside it or a parameter states about its coordinates, before anything is converted or refused.

use super::signature;
use super::unit::Unit;
use super::wkt::Node;
use super::{compound, definition, known_codes, parts, vertical_definition};

/// The sorts of systems.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Easting and northing on a map.
    Projected,
    /// Easting and northing on a Mercator map of the whole world, whose lengths are those on the ground at the equator only.
    WorldMap,
    /// Distances on a map that are counted to the west or south.
    WestSouth,
    /// Longitude and latitude in degrees.
    Geographic,
    /// X, Y and Z from the centre of the Earth.
    Geocentric,
    /// Heights alone.
    Vertical,
    /// A system of a site, in no known place on the Earth.
    Local,
    /// A system that is stated in a way that cannot be read; the name says why.
    Unknown,
}

impl Kind {
    /// The sort of a horizontal system, or of one of heights; `None` for a node that is no system.
    pub fn of(node: &Node) -> Option<Self> {
        Some(match node.keyword.as_str() {
            "PROJCS" | "PROJCRS" | "PROJECTEDCRS" | "DERIVEDPROJCRS" if is_world_map(node) => Self::WorldMap,
            "PROJCS" | "PROJCRS" | "PROJECTEDCRS" | "DERIVEDPROJCRS" if signature::points_west(node) => Self::WestSouth,
            "PROJCS" | "PROJCRS" | "PROJECTEDCRS" | "DERIVEDPROJCRS" => Self::Projected,
            "GEOCCS" => Self::Geocentric,
            "GEODCRS" | "GEODETICCRS" if is_cartesian(node) => Self::Geocentric,
            "GEOGCS" | "GEOGCRS" | "GEOGRAPHICCRS" | "GEODCRS" | "GEODETICCRS" => Self::Geographic,
            "VERT_CS" | "VERTCS" | "VERTCRS" | "VERTICALCRS" => Self::Vertical,
            "LOCAL_CS" | "ENGCRS" | "ENGINEERINGCRS" => Self::Local,
            _ => return None,
        })
    }

    /// Whether coordinates of this sort must be reprojected before lengths and directions mean anything.
    pub fn needs_reprojection(self) -> bool {
        matches!(self, Self::Geographic | Self::Geocentric | Self::WorldMap | Self::WestSouth)
    }
}

/// By what EPSG, Esri and others call it.
fn is_world_map(node: &Node) -> bool {
    const NAMES: [&str; 5] =
        ["pseudomercator", "webmercator", "worldmercator", "popularvisualisation", "mercatorauxiliarysphere"];
    let method = signature::method(node).map_or("", Node::name);
    [node.name(), method].map(signature::plain).iter().any(|name| NAMES.iter().any(|known| name.contains(known)))
}

/// Whether a system of map coordinates has heights above the ellipsoid.
fn has_three_axes(node: &Node) -> bool {
    node.child(&["CS"]).is_some_and(|cs| cs.number(1).is_some_and(|axes| axes > 2.5))
}

fn is_cartesian(node: &Node) -> bool {
    node.child(&["CS"]).is_some_and(|cs| cs.to_string().to_ascii_lowercase().starts_with("cs[cartesian"))
}

/// A coordinate reference system as it is stated.
#[derive(Debug, Clone, PartialEq)]
pub struct Stated {
    /// Its name, with its EPSG code where it has one.
    pub name: String,
    /// What its coordinates are, which decides whether it can be carried on.
    pub kind: Kind,
    /// The unit of its horizontal coordinates, where that is stated and a length.
    pub unit: Option<Unit>,
    /// The unit of heights, where it is stated.
    pub vertical_unit: Option<Unit>,
    /// Its definition; `None` where what is stated does not define it.
    pub node: Option<Node>,
    /// The system of heights that is stated but not known, and therefore left out.
    pub unknown_heights: Option<String>,
}

impl Stated {
    /// The system of a WKT.
    ///
    /// # Errors
    /// What is wrong with the text; a system of heights alone, or of a sort that is not known.
    pub fn from_wkt(text: &str) -> Result<Self, String> {
        let node = Node::parse(text)?;
        let node = match node.keyword.as_str() {
            "BOUNDCRS" => node.child(&["SOURCECRS"]).and_then(|source| source.nodes().next()).cloned(),
            _ => Some(node),
        };
        node.map_or_else(|| Err("a BOUNDCRS without its source".to_owned()), Self::from_node)
    }

    /// The system of a definition.
    ///
    /// # Errors
    /// A system of heights alone, or of a sort that is not known.
    pub fn from_node(node: Node) -> Result<Self, String> {
        let (horizontal, vertical) = parts(&node);
        let kind = match Kind::of(horizontal) {
            Some(Kind::Vertical) => return Err(format!("`{}` is a system of heights alone", node.name())),
            Some(kind) => kind,
            None => return Err(format!("`{}` is no coordinate reference system that is known here", node.keyword)),
        };
        let name = match horizontal.epsg() {
            Some(code) if vertical.is_none() => format!("{}, EPSG:{code}", node.name()),
            _ => node.name().to_owned(),
        };
        let unit = if kind == Kind::Geographic { None } else { linear_unit(horizontal) };
        let vertical_unit = vertical.and_then(linear_unit);
        Ok(Self { name, kind, unit, vertical_unit, node: Some(node), unknown_heights: None })
    }

    /// The system of an EPSG code, and of one for heights.
    ///
    /// # Errors
    /// A code that is not known.
    pub fn from_epsg(code: u32, vertical: Option<u32>) -> Result<Self, String> {
        let unknown = |code: u32| format!("EPSG:{code} is not among the systems that rockface knows");
        let horizontal = definition(code).ok_or_else(|| unknown(code))?;
        let node = match vertical {
            None => horizontal,
            Some(height) => compound(&horizontal, &vertical_definition(height).ok_or_else(|| unknown_heights(height))?),
        };
        Self::from_node(node)
    }

    /// What a file states in a way that cannot be read.
    pub fn unknown(why: String) -> Self {
        Self { name: why, kind: Kind::Unknown, ..Self::local("", None) }
    }

    /// The system that the text of a `.prj` states: a code, one system, or after it that of heights, as ESRI writes it.
    pub fn of_prj(bytes: &[u8]) -> Self {
        let text = text_of(bytes);
        let text = text.trim_start_matches('\u{feff}').trim_end_matches('\0').trim();
        let of_two = || {
            let (horizontal, vertical) = text.split_at(text.find("VERTCS[")?);
            let horizontal = Node::parse(horizontal.trim_end().trim_end_matches(',')).ok()?;
            Self::from_node(compound(&horizontal, &Node::parse(vertical).ok()?)).ok()
        };
        if let Some((code, height)) = super::codes(text) {
            return Self::from_epsg(code, height).unwrap_or_else(Self::unknown);
        }
        Self::from_wkt(text).or_else(|why| of_two().ok_or(why)).unwrap_or_else(Self::unknown)
    }

    /// The system that one of our own files states.
    pub fn of_crs(crs: &super::Crs) -> Self {
        Self::from_node(crs.node()).unwrap_or_else(Self::unknown)
    }

    /// A system of the site: units alone.
    pub fn local(name: &str, unit: Option<Unit>) -> Self {
        let name = name.to_owned();
        Self { name, kind: Kind::Local, unit, vertical_unit: None, node: None, unknown_heights: None }
    }

    /// Whether coordinates of the two mean the same places, on the map and in height. Heights that one of them does not state are no difference.
    pub fn agrees_with(&self, other: &Self) -> bool {
        self.is_same_plane(other) && self.are_heights_alike(other)
    }

    fn are_heights_alike(&self, other: &Self) -> bool {
        let (Some(one), Some(two)) = (&self.node, &other.node) else { return true };
        let ((plane, height), (other_plane, other_height)) = (parts(one), parts(two));
        match (height, other_height) {
            (Some(height), Some(other_height)) => {
                let codes = height.epsg().zip(other_height.epsg());
                let units = self.vertical_unit.as_ref().zip(other.vertical_unit.as_ref());
                codes.is_none_or(|(a, b)| a == b) && units.is_none_or(|(a, b)| a == b)
            }
            // Heights above the ellipsoid are part of a system of three axes.
            (Some(_), None) => !has_three_axes(other_plane),
            (None, Some(_)) => !has_three_axes(plane),
            (None, None) => true,
        }
    }

    fn is_same_plane(&self, other: &Self) -> bool {
        let code = |stated: &Self| stated.node.as_ref().and_then(|node| parts(node).0.epsg());
        let signature = |stated: &Self| stated.node.as_ref().and_then(|node| super::signature::of(parts(node).0));
        match (code(self), code(other)) {
            (Some(code), Some(other)) => code == other,
            _ => self.kind == other.kind && signature(self).is_some() && signature(self) == signature(other),
        }
    }
}

/// Text in UTF-8, or in UTF-16 with its mark.
fn text_of(bytes: &[u8]) -> String {
    let units = |of: fn([u8; 2]) -> u16| bytes.as_chunks().0.iter().map(|pair| of(*pair)).collect::<Vec<u16>>();
    match bytes {
        [0xff, 0xfe, ..] => String::from_utf16_lossy(&units(u16::from_le_bytes)),
        [0xfe, 0xff, ..] => String::from_utf16_lossy(&units(u16::from_be_bytes)),
        _ => String::from_utf8_lossy(bytes).into_owned(),
    }
}

/// What is wrong with a code that is none of a known system of heights.
fn unknown_heights(code: u32) -> String {
    let known: Vec<String> = known_codes().iter().map(ToString::to_string).collect();
    format!("EPSG:{code} is not among the systems of heights that rockface knows: {}", known.join(", "))
}

/// The unit of lengths of a system: that of its `UNIT`, `LENGTHUNIT`, or of its axes.
pub fn linear_unit(node: &Node) -> Option<Unit> {
    let keywords = ["UNIT", "LENGTHUNIT"];
    let own = node.nodes().filter(|child| keywords.contains(&child.keyword.as_str())).last();
    let of_axes = || node.nodes().filter(|child| child.keyword == "AXIS").find_map(|axis| axis.child(&keywords));
    own.or_else(of_axes).and_then(Unit::of)
}
