//! What a projected system is, whatever it is called: programs write one system in several dialects of WKT, often without its code.

use std::collections::BTreeMap;

use super::wkt::{Argument, Node};
use super::{Kind, Unit, datums};

/// Names of parameters of WKT 2, and those of WKT 1 for the same.
const PARAMETERS: &[(&str, &str)] = &[
    ("latitudeofnaturalorigin", "latitudeoforigin"),
    ("latitudeoffalseorigin", "latitudeoforigin"),
    ("latitudeofcenter", "latitudeoforigin"),
    ("longitudeofnaturalorigin", "centralmeridian"),
    ("longitudeoffalseorigin", "centralmeridian"),
    ("longitudeofcenter", "centralmeridian"),
    ("longitudeoforigin", "centralmeridian"),
    ("latitudeofprojectioncentre", "latitudeoforigin"),
    ("longitudeofprojectioncentre", "centralmeridian"),
    ("azimuthatprojectioncentre", "azimuth"),
    ("azimuthofinitialline", "azimuth"),
    ("anglefromrectifiedtoskewgrid", "rectifiedgridangle"),
    ("scalefactoratprojectioncentre", "scalefactor"),
    ("scalefactoroninitialline", "scalefactor"),
    ("eastingatprojectioncentre", "falseeasting"),
    ("northingatprojectioncentre", "falsenorthing"),
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
    ("albers", "albersconicequalarea"),
    ("albersequalarea", "albersconicequalarea"),
    ("cassini", "cassinisoldner"),
    ("doublestereographic", "obliquestereographic"),
    ("hotineobliquemercatorazimuthnaturalorigin", "hotineobliquemercator"),
    ("hotineobliquemercatorvarianta", "hotineobliquemercator"),
    ("hotineobliquemercatorvariantb", "hotineobliquemercatorazimuthcenter"),
    ("stereographicnorthpole", "polarstereographic"),
    ("stereographicsouthpole", "polarstereographic"),
    ("polarstereographicvarianta", "polarstereographic"),
    ("polarstereographicvariantb", "polarstereographic"),
    ("krovaknorthorientated", "krovak"),
];

/// Projection with its parameters, unit, ellipsoid, prime meridian and datum; `None` for what is not projected.
pub fn of(node: &Node) -> Option<String> {
    if Kind::of(node) != Some(Kind::Projected) {
        return None;
    }
    let base = node.child(&["GEOGCS", "BASEGEOGCRS", "BASEGEODCRS"])?;
    let datum = base.child(&["DATUM", "ENSEMBLE", "GEODETICDATUM", "TRF"])?;
    let ellipsoid = datum.child(&["SPHEROID", "ELLIPSOID"])?;
    let meridian = base.child(&["PRIMEM"]).or_else(|| node.child(&["PRIMEM"])).and_then(|node| node.number(1));
    let mut parameters = parameters(node);
    let mut projection = projection(node)?;
    // Of Krovak's without axes nothing says whether they count to the south and west, as they were made to, or to the east and north.
    if projection == "krovak" && !parameters.contains_key("xscale") && node.child(&["AXIS"]).is_none() {
        return None;
    }
    one_dialect(&mut projection, &mut parameters);
    let values: Vec<String> = parameters.iter().filter_map(|(name, value)| written(name, *value)).collect();
    let unit = super::stated::linear_unit(node)?.metres;
    Some(format!(
        "{projection} {} {:.9} {:.3} {:.7} {:.6} {}",
        values.join(" "),
        unit,
        ellipsoid.number(1)?,
        ellipsoid.number(2)?,
        meridian.unwrap_or(0.0),
        datums::known(datum.name())
    ))
}

/// What is different in two systems of map coordinates, one text each: their projections, parameters, units, ellipsoids, datums.
pub fn differences(one: &Node, other: &Node) -> Vec<String> {
    let base = |node: &Node| node.child(&["GEOGCS", "BASEGEOGCRS", "BASEGEODCRS"]).cloned();
    let datum = |node: &Node| Some(base(node)?.child(&["DATUM", "ENSEMBLE", "GEODETICDATUM", "TRF"])?.clone());
    let ellipsoid = |node: &Node| datum(node)?.child(&["SPHEROID", "ELLIPSOID"]).map(|node| node.name().to_owned());
    let meridian = |node: &Node| Some(base(node)?.child(&["PRIMEM"])?.name().to_owned());
    let unit = |node: &Node| super::stated::linear_unit(node).map(|unit| unit.name);
    let told = |what: &str, [one, other]: [Option<String>; 2]| {
        let name = |name: Option<String>| name.unwrap_or_else(|| "not stated".to_owned());
        (one != other).then(|| format!("{what}: {}, {}", name(one), name(other)))
    };
    let mut all = Vec::new();
    all.extend(told("projection", [one, other].map(projection)));
    let [mut own, mut others] = [one, other].map(parameters);
    let [mut first, mut second] = [one, other].map(|node| projection(node).unwrap_or_default());
    one_dialect(&mut first, &mut own);
    one_dialect(&mut second, &mut others);
    let names: std::collections::BTreeSet<&String> = own.keys().chain(others.keys()).collect();
    for name in names {
        let [one, other] = [&own, &others].map(|all| all.get(name).and_then(|value| written(name, *value)));
        if one != other {
            all.extend(told(name, [&own, &others].map(|all| all.get(name).map(ToString::to_string))));
        }
    }
    all.extend(told("unit", [one, other].map(unit)));
    let datums = [one, other].map(|node| datum(node).map(|datum| datum.name().to_owned()));
    if datums.iter().flatten().map(|name| datums::known(name)).collect::<std::collections::BTreeSet<_>>().len() > 1 {
        all.extend(told("datum", datums));
        all.extend(told("ellipsoid", [one, other].map(ellipsoid)));
    }
    all.extend(told("prime meridian", [one, other].map(meridian)));
    all
}

/// The projection of a system of map coordinates.
pub fn method(node: &Node) -> Option<&Node> {
    let conversion = node.child(&["CONVERSION"]);
    conversion.and_then(|c| c.child(&["METHOD"])).or_else(|| node.child(&["PROJECTION"]))
}

/// Whether an axis counts to the west or south, so that the map is mirrored or turned. On polar maps all axes may point south. ESRI says it by the
/// projection, and for that of Krovak by the sign of a scale.
pub fn points_west(node: &Node) -> bool {
    let points = |axis: &Node, to: &str| matches!(axis.arguments.get(1), Some(Argument::Word(way)) if way.eq_ignore_ascii_case(to));
    let any = |to: &str| node.nodes().any(|child| child.keyword == "AXIS" && points(child, to));
    let projection = projection(node).unwrap_or_default();
    any("west")
        || any("south") && any("east")
        || projection.contains("southorientated")
        || projection == "krovak" && parameters(node).get("xscale").is_some_and(|scale| *scale > 0.0)
}

/// What is added to the eastings and northings of a system, metres.
pub fn false_origin(node: &Node) -> [f64; 2] {
    let values = parameters(node);
    LENGTHS.map(|name| values.get(name).copied().unwrap_or(0.0))
}

/// The projection of a system by the name all dialects are compared by.
pub fn projection(node: &Node) -> Option<String> {
    method(node).map(|method| known(PROJECTIONS, &plain(method.name())).to_owned())
}

/// Parameters that are lengths.
const LENGTHS: [&str; 2] = ["falseeasting", "falsenorthing"];

/// The parameters of a projection by the names all dialects are compared by; lengths in metres, which are in the unit of the system where they have none
/// of their own.
fn parameters(node: &Node) -> BTreeMap<String, f64> {
    let of_system = super::stated::linear_unit(node).map_or(1.0, |unit| unit.metres);
    let one = |(name, child): (String, &Node)| {
        let value = child.number(1)?;
        let own = child.child(&["LENGTHUNIT", "UNIT"]).and_then(Unit::of).map(|unit| unit.metres);
        let metres = if LENGTHS.contains(&name.as_str()) { own.unwrap_or(of_system) } else { 1.0 };
        Some((name, value * metres))
    };
    parameter_nodes(node).filter_map(one).collect()
}

/// The parameters of a projection as they stand, with the names all dialects are compared by.
pub fn parameter_nodes(node: &Node) -> impl Iterator<Item = (String, &Node)> {
    let all = node.child(&["CONVERSION"]).unwrap_or(node).nodes().filter(|child| child.keyword == "PARAMETER");
    all.map(|child| (known(PARAMETERS, &plain(child.name())).to_owned(), child))
}

/// A parameter that is not at the value it has when it is left out.
fn written(name: &str, value: f64) -> Option<String> {
    match name {
        "scalefactor" if (value - 1.0).abs() < 1e-12 => None,
        // Files round it.
        "azimuth" => Some(format!("{name}={value:.6e}")),
        _ if value.abs() < 1e-12 => None,
        // A system made of one in feet has that of the system in metres to a tenth of a millimetre.
        _ if LENGTHS.contains(&name) => Some(format!("{name}={value:.3}")),
        _ => Some(format!("{name}={value:.8e}")),
    }
}

/// Writes what ESRI says in other parameters like the others.
fn one_dialect(projection: &mut String, parameters: &mut BTreeMap<String, f64>) {
    let same = |a: Option<&f64>, b: Option<&f64>| a.zip(b).is_some_and(|(a, b)| (a - b).abs() < 1e-9);
    let polar = parameters.get("latitudeoforigin").is_some_and(|latitude| (latitude.abs() - 90.0).abs() < 1e-9);
    if projection == "stereographic" && polar {
        "polarstereographic".clone_into(projection);
    }
    match projection.as_str() {
        // The one parallel of the tangent cone is that of the origin.
        "lambertconformalconic"
            if !parameters.contains_key("standardparallel2")
                && same(parameters.get("standardparallel1"), parameters.get("latitudeoforigin")) =>
        {
            parameters.remove("standardparallel1");
        }
        "polarstereographic" => {
            if let Some(parallel) =
                parameters.remove("standardparallel1").or_else(|| parameters.remove("latitudeofstandardparallel"))
            {
                parameters.insert("latitudeoforigin".to_owned(), parallel);
            }
        }
        "krovak" => {
            parameters.retain(|name, _| !["xscale", "yscale", "xyplanerotation"].contains(&name.as_str()));
        }
        _ => {}
    }
    for name in ["azimuth", "rectifiedgridangle"] {
        parameters.entry(name.to_owned()).and_modify(|degrees| *degrees = degrees.rem_euclid(360.0));
    }
    if same(parameters.get("rectifiedgridangle"), parameters.get("azimuth")) {
        parameters.remove("rectifiedgridangle");
    }
}

fn known<'a>(list: &'a [(&'a str, &'a str)], name: &'a str) -> &'a str {
    list.iter().find(|(other, _)| *other == name).map_or(name, |(_, common)| common)
}

/// Letters and digits alone, in lower case: names are spelt in many ways.
pub fn plain(name: &str) -> String {
    name.chars().filter(char::is_ascii_alphanumeric).map(|c| c.to_ascii_lowercase()).collect()
}

/// Gauss-Kruger zones of Germany under codes that EPSG has withdrawn.
const WITHDRAWN: std::ops::RangeInclusive<u16> = 31461..=31465;
/// Ends of the names of systems that differ from another one in the order of their axes.
const ORDERS: [&str; 5] = ["(N-E)", "(E-N)", "(N,E)", "(E,N)", "(N-zE)"];

/// The code of the one system in metres that is the same; `None` where there is none or several. A system that differs in the order of its axes
/// only does not count beside another: EPSG:3044 beside EPSG:25832, EPSG:5677 beside EPSG:31467.
pub fn find(node: &Node) -> Option<u32> {
    let wanted = of(node)?;
    let known = (2000..=u16::MAX).filter(|code| !WITHDRAWN.contains(code)).filter_map(|code| {
        let known = crs_definitions::from_code(code).filter(|known| known.wkt.starts_with("PROJCS"))?;
        let known = Node::parse(known.wkt).ok().filter(|known| of(known).as_ref() == Some(&wanted))?;
        Some((u32::from(code), ORDERS.iter().any(|order| known.name().ends_with(order))))
    });
    let same: Vec<(u32, bool)> = known.collect();
    let usual = same.iter().filter(|(_, is_reordered)| same.len() == 1 || !is_reordered);
    let codes: Vec<u32> = usual.map(|(code, _)| *code).collect();
    if let [only] = codes.as_slice() { Some(*only) } else { None }
}
