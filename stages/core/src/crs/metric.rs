//! A system whose axes are in feet, made the same system in metres.

use super::heights::metric_of;
use super::wkt::{Argument, Node};
use super::{compound, has_three_axes, parts};

/// Parameters of a projection that are lengths in the unit of the system, in WKT 1.
const LENGTHS: [&str; 4] = ["false_easting", "false_northing", "satellite_height", "height"];

/// The same system in metres; `horizontal` and `vertical` are the metres of its units. A system that is in metres stays what it is.
pub fn in_metres(node: &Node, horizontal: f64, vertical: f64) -> Node {
    let (plane, height) = parts(node);
    let is_metre = |metres: f64| (metres - 1.0).abs() < f64::EPSILON;
    let is_kept = is_metre(horizontal) && (is_metre(vertical) || !has_three_axes(plane));
    let plane = if is_kept { plane.clone() } else { converted(plane, horizontal) };
    let in_metres = |height: &Node| {
        if is_metre(vertical) {
            return height.clone();
        }
        metric_of(height).unwrap_or_else(|| converted(height, vertical))
    };
    match height {
        None => plane,
        Some(height) => compound(&plane, &in_metres(height)),
    }
}

fn converted(node: &Node, metres: f64) -> Node {
    // Neither its code nor what it is used for is that of the system in metres.
    let mut changed = node.clone().renamed(&format!("{}, in metres", node.name()));
    changed.arguments.retain(|argument| {
        !matches!(argument, Argument::Node(n) if ["AUTHORITY", "ID", "USAGE", "REMARK", "TOWGS84"].contains(&n.keyword.as_str()))
    });
    let is_first_version = !node.keyword.ends_with("CRS");
    for argument in &mut changed.arguments {
        let Argument::Node(child) = argument else { continue };
        match child.keyword.as_str() {
            "UNIT" | "LENGTHUNIT" => *child = metre(&child.keyword),
            "AXIS" => {
                for part in &mut child.arguments {
                    if let Argument::Node(unit) = part
                        && matches!(unit.keyword.as_str(), "UNIT" | "LENGTHUNIT")
                    {
                        *unit = metre(&unit.keyword);
                    }
                }
            }
            // In WKT 2 every parameter has a unit of its own, which stays.
            "PARAMETER" if is_first_version && LENGTHS.contains(&child.name().to_ascii_lowercase().as_str()) => {
                if let Some(length) = child.number(1) {
                    child.arguments[1] = Argument::Word((length * metres).to_string());
                }
            }
            _ => {}
        }
    }
    changed
}

fn metre(keyword: &str) -> Node {
    let (authority, code) = match keyword {
        "UNIT" => ("AUTHORITY", Argument::Text("9001".to_owned())),
        _ => ("ID", Argument::Word("9001".to_owned())),
    };
    let code = Node::new(authority, vec![Argument::Text("EPSG".to_owned()), code]);
    let unit = [Argument::Text("metre".to_owned()), Argument::Word("1".to_owned()), Argument::Node(code)];
    Node::new(keyword, unit.to_vec())
}
