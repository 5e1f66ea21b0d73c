//! What a projected system is, whatever it is called: programs write one system in several dialects of WKT, often without its code.

use super::Kind;
use super::wkt::Node;

/// Names of parameters of WKT 2, and those of WKT 1 for the same.
const PARAMETERS: &[(&str, &str)] = &[
    ("latitudeofnaturalorigin", "latitudeoforigin"),
    ("latitudeoffalseorigin", "latitudeoforigin"),
    ("latitudeofcenter", "latitudeoforigin"),
    ("longitudeofnaturalorigin", "centralmeridian"),
    ("longitudeoffalseorigin", "centralmeridian"),
    ("longitudeofcenter", "centralmeridian"),
    ("scalefactoratnaturalorigin", "scalefactor"),
    ("eastingatfalseorigin", "falseeasting"),
    ("northingatfalseorigin", "falsenorthing"),
    ("latitudeof1ststandardparallel", "standardparallel1"),
    ("latitudeof2ndstandardparallel", "standardparallel2"),
];

/// Names of projections, and the one they are compared by.
const PROJECTIONS: &[(&str, &str)] = &[
    ("gausskruger", "transversemercator"),
    ("lambertconformalconic1sp", "lambertconformalconic"),
    ("lambertconformalconic2sp", "lambertconformalconic"),
    ("lambertconicconformal1sp", "lambertconformalconic"),
    ("lambertconicconformal2sp", "lambertconformalconic"),
];

/// Projection with its parameters, unit, ellipsoid, prime meridian and years of the datum; `None` for what is not projected.
pub fn of(node: &Node) -> Option<String> {
    if Kind::of(node) != Some(Kind::Projected) {
        return None;
    }
    let base = node.child(&["GEOGCS", "BASEGEOGCRS", "BASEGEODCRS"])?;
    let datum = base.child(&["DATUM", "ENSEMBLE", "GEODETICDATUM", "TRF"])?;
    let ellipsoid = datum.child(&["SPHEROID", "ELLIPSOID"])?;
    let (conversion, method) = (node.child(&["CONVERSION"]), method(node)?);
    let meridian = base.child(&["PRIMEM"]).or_else(|| node.child(&["PRIMEM"])).and_then(|node| node.number(1));
    let parameters = conversion.unwrap_or(node).nodes().filter(|child| child.keyword == "PARAMETER");
    let mut values: Vec<String> = parameters.filter_map(parameter).collect();
    values.sort_unstable();
    let unit = super::stated::linear_unit(node)?.metres;
    Some(format!(
        "{} {} {:.9} {:.3} {:.7} {:.6} {}",
        known(PROJECTIONS, &plain(method.name())),
        values.join(" "),
        unit,
        ellipsoid.number(1)?,
        ellipsoid.number(2)?,
        meridian.unwrap_or(0.0),
        years(datum.name())
    ))
}

/// The projection of a system of map coordinates.
pub fn method(node: &Node) -> Option<&Node> {
    let conversion = node.child(&["CONVERSION"]);
    conversion.and_then(|c| c.child(&["METHOD"])).or_else(|| node.child(&["PROJECTION"]))
}

/// A parameter that is not at the value it has when it is left out.
fn parameter(node: &Node) -> Option<String> {
    let (name, value) = (plain(node.name()), node.number(1)?);
    let name = known(PARAMETERS, &name).to_owned();
    let is_default = if name == "scalefactor" { (value - 1.0).abs() < 1e-12 } else { value.abs() < 1e-12 };
    (!is_default).then(|| format!("{name}={value:.8e}"))
}

fn known<'a>(list: &'a [(&'a str, &'a str)], name: &'a str) -> &'a str {
    list.iter().find(|(other, _)| *other == name).map_or(name, |(_, common)| common)
}

/// Letters and digits alone, in lower case: names are spelt in many ways.
pub fn plain(name: &str) -> String {
    name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
}

/// The years in the name of a datum by their last two digits: `GDA_1994` and `GDA94` are one, `GDA2020` is another.
fn years(name: &str) -> String {
    let numbers = name.split(|c: char| !c.is_ascii_digit()).filter(|digits| digits.len() == 2 || digits.len() == 4);
    let mut years: Vec<&str> = numbers.map(|digits| &digits[digits.len() - 2..]).collect();
    years.sort_unstable();
    years.join("-")
}

/// The code of the one system in metres that is the same; `None` where there is none or several.
pub fn find(node: &Node) -> Option<u32> {
    let wanted = of(node)?;
    let mut found = None;
    for code in 2000..=u16::MAX {
        let Some(known) = crs_definitions::from_code(code).filter(|known| known.wkt.starts_with("PROJCS")) else {
            continue;
        };
        if Node::parse(known.wkt).ok().and_then(|node| of(&node)).as_ref() == Some(&wanted) {
            if found.is_some() {
                return None;
            }
            found = Some(u32::from(code));
        }
    }
    found
}
