//! Rockfalls as KML 2.2, as Google Earth and QGIS open it: a placemark each.

use quick_xml::Writer;
use quick_xml::events::{BytesDecl, BytesText, Event};

/// A rockfall with its place in degrees.
pub struct Placemark<'a> {
    /// Its name.
    pub name: String,
    /// Names and values of its properties.
    pub data: Vec<(&'a str, String)>,
    /// Longitude and latitude in degrees of WGS 84, and the height in metres, NaN where there is none.
    pub point: [f64; 3],
    /// Its outline: of each polygon the outer ring and the holes, closed, longitude and latitude in degrees.
    pub outline: Vec<Vec<Vec<[f64; 2]>>>,
}

type Written = std::io::Result<()>;

/// The file; heights are above the sea with `absolute`, else placemarks lie on the ground.
pub fn write(title: &str, about: &str, placemarks: &[Placemark], absolute: bool) -> std::io::Result<Vec<u8>> {
    let mut xml = Writer::new_with_indent(Vec::new(), b' ', 1);
    xml.write_event(Event::Decl(BytesDecl::new("1.0", Some("UTF-8"), None)))?;
    let root = xml.create_element("kml").with_attribute(("xmlns", "http://www.opengis.net/kml/2.2"));
    root.write_inner_content(|xml| {
        inside(xml, "Document", |xml| {
            text(xml, "name", title)?;
            text(xml, "description", about)?;
            placemarks.iter().try_for_each(|placemark| inside(xml, "Placemark", |xml| body(xml, placemark, absolute)))
        })
    })?;
    let mut bytes = xml.into_inner();
    bytes.push(b'\n');
    Ok(bytes)
}

fn inside(xml: &mut Writer<Vec<u8>>, name: &str, content: impl FnOnce(&mut Writer<Vec<u8>>) -> Written) -> Written {
    xml.create_element(name).write_inner_content(content).map(|_| ())
}

fn text(xml: &mut Writer<Vec<u8>>, name: &str, text: &str) -> Written {
    xml.create_element(name).write_text_content(BytesText::new(&allowed(text))).map(|_| ())
}

/// XML has no control characters, not even escaped, but for three.
fn allowed(text: &str) -> String {
    let is_allowed = |c: char| matches!(c, '\t' | '\n' | '\r') || c >= ' ' && !matches!(c, '\u{fffe}' | '\u{ffff}');
    text.chars().map(|c| if is_allowed(c) { c } else { char::REPLACEMENT_CHARACTER }).collect()
}

fn body(xml: &mut Writer<Vec<u8>>, placemark: &Placemark, absolute: bool) -> Written {
    text(xml, "name", &placemark.name)?;
    inside(xml, "ExtendedData", |xml| {
        placemark.data.iter().try_for_each(|(name, value)| {
            let name = allowed(name);
            let data = xml.create_element("Data").with_attribute(("name", name.as_str()));
            data.write_inner_content(|xml| text(xml, "value", value)).map(|_| ())
        })
    })?;
    if placemark.outline.is_empty() {
        return point(xml, placemark.point, absolute);
    }
    inside(xml, "MultiGeometry", |xml| {
        point(xml, placemark.point, absolute)?;
        placemark.outline.iter().try_for_each(|rings| polygon(xml, rings))
    })
}

fn point(xml: &mut Writer<Vec<u8>>, [longitude, latitude, height_m]: [f64; 3], absolute: bool) -> Written {
    let absolute = absolute && height_m.is_finite();
    inside(xml, "Point", |xml| {
        text(xml, "altitudeMode", if absolute { "absolute" } else { "clampToGround" })?;
        let height = if absolute { format!(",{height_m:.3}") } else { String::new() };
        text(xml, "coordinates", &format!("{longitude:.9},{latitude:.9}{height}"))
    })
}

/// An outline, which has no heights, on the ground.
fn polygon(xml: &mut Writer<Vec<u8>>, rings: &[Vec<[f64; 2]>]) -> Written {
    inside(xml, "Polygon", |xml| {
        text(xml, "altitudeMode", "clampToGround")?;
        rings.iter().enumerate().try_for_each(|(number, ring)| {
            let places: Vec<String> =
                ring.iter().map(|[longitude, latitude]| format!("{longitude:.9},{latitude:.9}")).collect();
            inside(xml, if number == 0 { "outerBoundaryIs" } else { "innerBoundaryIs" }, |xml| {
                inside(xml, "LinearRing", |xml| text(xml, "coordinates", &places.join(" ")))
            })
        })
    })
}
