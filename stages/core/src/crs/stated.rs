//! What a file, a `.prj` beside it or a parameter states about its coordinates, before anything is converted or refused.

use super::signature;
use super::unit::Unit;
use super::wkt::Node;
use super::{
    Heights, compound, definition, has_three_axes, heights_for_depths, is_depths, known_codes, parts, points_down,
    vertical_definition,
};

/// The sorts of systems.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// Easting and northing on a map.
    Projected,
    /// Easting and northing on a map of the whole world, whose lengths are those on the ground in few places only.
    WorldMap,
    /// Distances on a map that are counted to the west or south.
    WestSouth,
    /// Distances on a map with depths, which count downwards.
    Depths,
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
        matches!(self, Self::Geographic | Self::Geocentric | Self::WorldMap | Self::WestSouth | Self::Depths)
    }
}

/// Projections that are made for maps of the whole world, or of half of it.
const OF_THE_WORLD: [&str; 22] = [
    "aitoff",
    "compactmiller",
    "craster",
    "eckert",
    "equalearth",
    "flatpolarquartic",
    "gall",
    "goode",
    "hammer",
    "loximuthal",
    "millercylindrical",
    "mollweide",
    "naturalearth",
    "patterson",
    "putnins",
    "quarticauthalic",
    "robinson",
    "sinusoidal",
    "times",
    "vandergrinten",
    "wagner",
    "winkel",
];

/// By what EPSG, Esri and others call it. Other maps are told by their scale at the site.
fn is_world_map(node: &Node) -> bool {
    const NAMES: [&str; 5] =
        ["pseudomercator", "webmercator", "worldmercator", "popularvisualisation", "mercatorauxiliarysphere"];
    let method = signature::method(node).map_or("", Node::name);
    let [name, method] = [node.name(), method].map(signature::plain);
    NAMES.iter().any(|known| name.contains(known) || method.contains(known))
        || OF_THE_WORLD
            .iter()
            .any(|known| method.starts_with(known) || method == format!("interrupted{known}homolosine"))
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
    /// The shift of the datum to WGS 84 that is stated (`TOWGS84`, `BOUNDCRS`), which no definition has.
    pub shift: Option<String>,
}

impl Stated {
    /// The system of a WKT.
    ///
    /// # Errors
    /// What is wrong with the text; a system of heights alone, or of a sort that is not known.
    pub fn from_wkt(text: &str) -> Result<Self, String> {
        let node = Node::parse(text)?;
        let shift = shift(&node);
        let node = match node.keyword.as_str() {
            "BOUNDCRS" => node.child(&["SOURCECRS"]).and_then(|source| source.nodes().next()).cloned(),
            _ => Some(node),
        };
        let stated = node.map_or_else(|| Err("a BOUNDCRS without its source".to_owned()), Self::from_node)?;
        Ok(Self { shift, ..stated })
    }

    /// The system of a definition.
    ///
    /// # Errors
    /// A system of heights alone, or of a sort that is not known.
    pub fn from_node(node: Node) -> Result<Self, String> {
        let (horizontal, vertical) = parts(&node);
        let kind = match Kind::of(horizontal) {
            Some(Kind::Vertical) => return Err(format!("`{}` is a system of heights alone", node.name())),
            Some(Kind::Projected) if vertical.is_some_and(points_down) => Kind::Depths,
            Some(kind) => kind,
            None => return Err(format!("`{}` is no coordinate reference system that is known here", node.keyword)),
        };
        let name = match horizontal.epsg() {
            Some(code) if vertical.is_none() => format!("{}, EPSG:{code}", node.name()),
            _ => node.name().to_owned(),
        };
        let unit = if kind == Kind::Geographic { None } else { linear_unit(horizontal) };
        let vertical_unit = match vertical {
            Some(vertical) => linear_unit(vertical),
            None if has_three_axes(horizontal) => unit_of_heights(horizontal),
            None => None,
        };
        Ok(Self { name, kind, unit, vertical_unit, node: Some(node), unknown_heights: None, shift: None })
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
        Self { name, kind: Kind::Local, unit, vertical_unit: None, node: None, unknown_heights: None, shift: None }
    }

    /// Whether coordinates of the two mean the same places, on the map and in height. Heights that one of them does not state are no difference.
    pub fn agrees_with(&self, other: &Self) -> bool {
        self.is_same_plane(other) && self.are_heights_alike(other)
    }

    fn are_heights_alike(&self, other: &Self) -> bool {
        let (Some(one), Some(two)) = (&self.node, &other.node) else { return true };
        match (Heights::of(one), Heights::of(two)) {
            (Heights::System(height), Heights::System(other_height)) => {
                let codes = height.epsg().zip(other_height.epsg());
                let units = self.vertical_unit.as_ref().zip(other.vertical_unit.as_ref());
                codes.is_none_or(|(a, b)| a == b) && units.is_none_or(|(a, b)| a == b)
            }
            (Heights::System(_), Heights::Ellipsoid) | (Heights::Ellipsoid, Heights::System(_)) => false,
            _ => true,
        }
    }

    /// Whether it says what heights are above: a vertical datum, or the ellipsoid.
    pub fn states_heights(&self) -> bool {
        self.node.as_ref().is_some_and(|node| Heights::of(node) != Heights::Unstated)
    }

    fn is_same_plane(&self, other: &Self) -> bool {
        let code = |stated: &Self| stated.node.as_ref().and_then(|node| parts(node).0.epsg());
        let signature = |stated: &Self| stated.node.as_ref().and_then(|node| super::signature::of(parts(node).0));
        if let (Some(code), Some(other)) = (code(self), code(other)) {
            return code == other;
        }
        let shifts = self.shift.as_ref().zip(other.shift.as_ref());
        self.kind == other.kind
            && signature(self).is_some()
            && signature(self) == signature(other)
            && shifts.is_none_or(|(one, two)| one == two)
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
    if is_depths(code) {
        let way = heights_for_depths(code)
            .map_or_else(String::new, |heights| format!(": bring the file to the heights EPSG:{heights}"));
        return format!("EPSG:{code} is a system of depths, which count downwards; heights are needed{way}");
    }
    let known: Vec<String> = known_codes().iter().map(ToString::to_string).collect();
    format!("EPSG:{code} is not among the systems of heights that rockface knows: {}", known.join(", "))
}

/// The shift to WGS 84 that a text states of its datum, if it is one of more than nothing.
fn shift(node: &Node) -> Option<String> {
    if node.keyword == "BOUNDCRS" {
        let transformation = node.child(&["ABRIDGEDTRANSFORMATION"])?;
        let values: Vec<String> = transformation
            .nodes()
            .filter(|child| child.keyword == "PARAMETER")
            .filter_map(|child| child.number(1))
            .map(|value| value.to_string())
            .collect();
        return (!values.is_empty()).then(|| values.join(", "));
    }
    if node.keyword == "TOWGS84" {
        let values: Vec<f64> = (0..node.arguments.len()).filter_map(|place| node.number(place)).collect();
        let texts: Vec<String> = values.iter().map(ToString::to_string).collect();
        return values.iter().any(|value| value.abs() > 0.0).then(|| texts.join(", "));
    }
    node.nodes().find_map(shift)
}

/// The unit of the third axis of a system.
fn unit_of_heights(node: &Node) -> Option<Unit> {
    let axis = node.nodes().filter(|child| child.keyword == "AXIS").nth(2);
    let own = axis.and_then(|axis| axis.child(&["LENGTHUNIT", "UNIT"])).and_then(Unit::of);
    own.or_else(|| linear_unit(node))
}

/// The unit of lengths of a system: that of its `UNIT`, `LENGTHUNIT`, or of its axes.
pub fn linear_unit(node: &Node) -> Option<Unit> {
    let keywords = ["UNIT", "LENGTHUNIT"];
    let own = node.nodes().filter(|child| keywords.contains(&child.keyword.as_str())).last();
    let of_axes = || node.nodes().filter(|child| child.keyword == "AXIS").find_map(|axis| axis.child(&keywords));
    own.or_else(of_axes).and_then(Unit::of)
}
