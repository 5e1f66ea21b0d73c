//! Coordinate reference systems: read from what files state, carried with every artefact, written again. Nothing is reprojected,
//! but for the degrees of an export ([`Degrees`]) and geocentric cameras, whose places on a map [`Plane`] has.
//!
//! Coordinates inside are metres. A [`Crs`] is therefore projected, with metres along its axes; what files state otherwise is a
//! [`Stated`] system, which [`settle`] makes one of, converting feet and refusing degrees.

mod datums;
mod degrees;
mod earth;
pub mod geo_keys;
mod heights;
mod metric;
mod plane;
mod scale;
mod settle;
mod signature;
mod stated;
mod unit;
pub mod wkt;

pub use datums::known as known_datum;
pub use degrees::{Degrees, is_like_wgs_84};
pub use earth::{DatumShift, Ellipsoid, utm_zone};
pub use plane::Plane;
pub use scale::Scale;
pub use settle::{CrsName, Settled, Tool, settle, wall_without_system};
pub use stated::{Kind, Stated};
pub use unit::Unit;

use heights::{heights_for_depths, is_depths, known_codes, points_down, vertical_definition};
use wkt::{Argument, Node};

/// A projected coordinate reference system in metres, perhaps with a vertical one.
///
/// ```
/// use rockface_core::crs::Crs;
///
/// let mga: Crs = "EPSG:28356".parse().unwrap();
/// assert_eq!((mga.name().as_str(), mga.epsg()), ("GDA94 / MGA zone 56", Some(28356)));
/// assert!(mga.wkt().starts_with("PROJCS[\"GDA94 / MGA zone 56\""));
/// assert!("EPSG:4326".parse::<Crs>().is_err());
/// ```
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct Crs(String);

impl Crs {
    /// The system of a node that is projected and in metres: by its EPSG code where that is known, otherwise by its text. A code that is not known
    /// stays: that of a system which is alike is another statement.
    pub(crate) fn of_node(node: &Node) -> Self {
        let (horizontal, vertical) = parts(node);
        if has_three_axes(horizontal) {
            // No code says that heights are above the ellipsoid.
            return Self(node.to_string());
        }
        let known = horizontal.epsg().filter(|code| definition(*code).is_some_and(|known| is_metric(&known)));
        let code = if horizontal.epsg().is_some() { known } else { signature::find(horizontal) };
        let height =
            vertical.map(|vertical| (vertical.epsg().filter(|code| vertical_definition(*code).is_some()), vertical));
        match (code, height) {
            (Some(code), None) => Self(format!("EPSG:{code}")),
            (Some(code), Some((Some(height), _))) => Self(format!("EPSG:{code}+{height}")),
            (Some(code), Some((None, vertical))) => {
                let horizontal = definition(code).unwrap_or_else(|| horizontal.clone());
                Self(compound(&horizontal, vertical).to_string())
            }
            (None, _) => Self(node.clone().without(&["TOWGS84", "EXTENSION"]).to_string()),
        }
    }

    /// `EPSG:28356`, `EPSG:28356+5711` with heights, or the well-known text of a system without code.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    /// How messages call it: its code, or its name where it has none.
    pub fn label(&self) -> String {
        if self.0.starts_with("EPSG:") { self.0.clone() } else { format!("`{}`", self.name()) }
    }

    fn codes(&self) -> Option<(u32, Option<u32>)> {
        codes(&self.0)
    }

    /// The EPSG code of the horizontal system.
    pub fn epsg(&self) -> Option<u32> {
        self.codes().map(|(code, _)| code).or_else(|| parts(&self.node()).0.epsg())
    }

    /// The EPSG code of the vertical system.
    pub fn vertical_epsg(&self) -> Option<u32> {
        self.codes().map_or_else(|| parts(&self.node()).1.and_then(Node::epsg), |(_, height)| height)
    }

    /// Whether it says what heights are above: a vertical datum, or the ellipsoid.
    pub fn has_heights(&self) -> bool {
        Heights::of(&self.node()) != Heights::Unstated
    }

    /// What [`Crs::agrees_with`] finds different in another system, such as its datum; `None` where they agree.
    pub fn difference(&self, other: &Self) -> Option<String> {
        if self.agrees_with(other) {
            return None;
        }
        let (one, two) = (self.node(), other.node());
        let told = signature::differences(parts(&one).0, parts(&two).0);
        if !told.is_empty() {
            return Some(told.join(", "));
        }
        let (one, two) = (Heights::of(&one).name(), Heights::of(&two).name());
        Some(if one == two { "their codes".to_owned() } else { format!("heights: {one}, {two}") })
    }

    /// The name its definition states, such as that of a UTM zone.
    pub fn name(&self) -> String {
        self.node().name().to_owned()
    }

    /// The well-known text that defines it.
    pub fn wkt(&self) -> String {
        self.node().to_string()
    }

    /// The system without heights.
    #[must_use]
    pub fn horizontal(&self) -> Self {
        match self.codes() {
            Some((code, _)) => Self(format!("EPSG:{code}")),
            None => Self::of_node(&flat(parts(&self.node()).0)),
        }
    }

    fn node(&self) -> Node {
        let of_codes = self.codes().and_then(|(code, height)| {
            let horizontal = definition(code)?;
            Some(match height {
                None => horizontal,
                Some(height) => compound(&horizontal, &vertical_definition(height)?),
            })
        });
        // Its text was read when the value was made.
        of_codes.or_else(|| Node::parse(&self.0).ok()).unwrap_or_else(|| Node::new("LOCAL_CS", Vec::new()))
    }

    /// Whether coordinates of the two mean the same places: the same horizontal system, and no two vertical ones.
    pub fn agrees_with(&self, other: &Self) -> bool {
        if self == other {
            return true;
        }
        let (one, two) = (self.node(), other.node());
        let (plane, other_plane) = (parts(&one).0, parts(&two).0);
        let alike = || signature::of(plane).is_some_and(|own| signature::of(other_plane) == Some(own));
        let same_plane = match (self.epsg(), other.epsg()) {
            // Two codes may be one system with its axes in another order; of a code that is not known here nobody can say.
            (Some(one), Some(two)) => {
                one == two || [one, two].into_iter().all(|code| definition(code).is_some()) && alike()
            }
            _ => alike(),
        };
        let same_height = match (Heights::of(&one), Heights::of(&two)) {
            (Heights::System(height), Heights::System(other)) => match (height.epsg(), other.epsg()) {
                (Some(code), Some(other)) => code == other,
                _ => height.name() == other.name(),
            },
            (Heights::System(_), Heights::Ellipsoid) | (Heights::Ellipsoid, Heights::System(_)) => false,
            _ => true,
        };
        same_plane && same_height
    }
}

impl std::fmt::Display for Crs {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.label())
    }
}

/// Reads the text that [`Crs::as_str`] gives; only projected systems in metres are accepted.
impl std::str::FromStr for Crs {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        let stated = match codes(text) {
            Some((code, height)) => Stated::from_epsg(code, height)?,
            None => Stated::from_wkt(text)?,
        };
        match (stated.kind, stated.node) {
            (Kind::Projected, Some(node)) if is_metric(&node) => Ok(Self::of_node(&node)),
            _ => Err(format!("`{}` is not a projected system in metres", stated.name)),
        }
    }
}

impl serde::Serialize for Crs {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.0)
    }
}

impl<'de> serde::Deserialize<'de> for Crs {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

/// The codes of `EPSG:28356` or `EPSG:28356+5711`, in capitals or not.
fn codes(text: &str) -> Option<(u32, Option<u32>)> {
    let (authority, codes) = text.trim().split_once(':')?;
    if !authority.eq_ignore_ascii_case("EPSG") {
        return None;
    }
    match codes.split_once('+') {
        None => Some((codes.parse().ok()?, None)),
        Some((code, height)) => Some((code.parse().ok()?, Some(height.parse().ok()?))),
    }
}

/// The definition of a code: WKT without the shifts to WGS 84 that belong to no definition.
fn definition(code: u32) -> Option<Node> {
    let text = crs_definitions::from_code(u16::try_from(code).ok()?)?.wkt;
    let node = match code {
        // The table takes the chains of its false easting for metres.
        3167 => Node::parse(&text.replace("\"false_easting\",1988.392164223695", "\"false_easting\",40000")),
        _ => Node::parse(text),
    };
    let node = node.ok()?;
    let source = if node.keyword == "BOUNDCRS" { node.child(&["SOURCECRS"])?.nodes().next()?.clone() } else { node };
    Some(source.without(&["TOWGS84", "EXTENSION"]))
}

/// The horizontal system of a node, and the vertical one where it is compound.
fn parts(node: &Node) -> (&Node, Option<&Node>) {
    if !matches!(node.keyword.as_str(), "COMPD_CS" | "COMPOUNDCRS") {
        return (node, None);
    }
    let mut systems = node.nodes().filter(|part| Kind::of(part).is_some());
    let first = systems.next().unwrap_or(node);
    (first, systems.next())
}

/// What a system says of heights.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Heights<'a> {
    Unstated,
    /// They are above the ellipsoid: the system has a third axis.
    Ellipsoid,
    System(&'a Node),
}

impl<'a> Heights<'a> {
    fn of(node: &'a Node) -> Self {
        match parts(node) {
            (_, Some(vertical)) => Self::System(vertical),
            (plane, None) if has_three_axes(plane) => Self::Ellipsoid,
            _ => Self::Unstated,
        }
    }

    fn name(self) -> String {
        match self {
            Self::Unstated => "not stated".to_owned(),
            Self::Ellipsoid => "above the ellipsoid".to_owned(),
            Self::System(vertical) => vertical.name().to_owned(),
        }
    }
}

/// Whether a system of map coordinates has heights above the ellipsoid as its third axis.
fn has_three_axes(node: &Node) -> bool {
    node.child(&["CS"]).is_some_and(|cs| cs.number(1).is_some_and(|axes| axes > 2.5))
}

/// The system without its third axis.
fn flat(node: &Node) -> Node {
    let mut flat = node.clone();
    if has_three_axes(node) {
        let mut axes = 0;
        flat.arguments.retain(|argument| {
            axes += usize::from(matches!(argument, Argument::Node(node) if node.keyword == "AXIS"));
            axes < 3 || !matches!(argument, Argument::Node(node) if ["AXIS", "ID", "REMARK"].contains(&node.keyword.as_str()))
        });
        let cs = flat.arguments.iter_mut().find_map(|argument| match argument {
            Argument::Node(node) if node.keyword == "CS" => node.arguments.get_mut(1),
            _ => None,
        });
        if let Some(count) = cs {
            *count = Argument::Word("2".to_owned());
        }
    }
    flat
}

fn compound(horizontal: &Node, vertical: &Node) -> Node {
    let name = format!("{} + {}", horizontal.name(), vertical.name());
    let keyword = if horizontal.keyword.ends_with("CRS") { "COMPOUNDCRS" } else { "COMPD_CS" };
    let parts = [Argument::Text(name), Argument::Node(horizontal.clone()), Argument::Node(vertical.clone())];
    Node::new(keyword, parts.to_vec())
}

/// Whether a system is projected and in metres, heights included.
fn is_metric(node: &Node) -> bool {
    let (horizontal, vertical) = parts(node);
    let metres = |node: &Node| stated::linear_unit(node).is_some_and(|unit| unit.is_metre());
    Kind::of(horizontal) == Some(Kind::Projected) && metres(horizontal) && vertical.is_none_or(metres)
}

#[cfg(test)]
mod tests;
