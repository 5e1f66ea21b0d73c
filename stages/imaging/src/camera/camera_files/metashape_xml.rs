//! The content of a Metashape camera XML as plain values: sensors, cameras, components, without interpretation.

use std::collections::HashMap;

use nalgebra::{Matrix3, Vector3};
use roxmltree::{Document, Node};

use rockface_core::names::twice;
use rockface_core::{StageError, fail};

/// One chunk of a file.
#[derive(Debug, Default)]
pub struct Chunk {
    /// Its sensors, in the order of the file.
    pub sensors: Vec<SensorEntry>,
    /// Its cameras, in the order of the file.
    pub cameras: Vec<CameraEntry>,
    /// Similarity of each component (a part of the block aligned by itself), by its id.
    pub components: HashMap<String, Similarity>,
    /// Similarity of the chunk, in older files.
    pub transform: Option<Similarity>,
    /// Its coordinate reference system as WKT.
    pub reference: Option<String>,
}

/// A sensor as the file has it, before it becomes an interior orientation.
#[derive(Debug)]
pub struct SensorEntry {
    /// The number cameras refer to it by, as text.
    pub id: String,
    /// The model of its lens: `frame`, `fisheye` and others.
    pub kind: String,
    /// Elements of its calibration by name, image size among them as `width` and `height`; the adjusted one where there are two.
    pub calibration: Option<Vec<(String, f64)>>,
    /// Names and row-major elements of the covariance of its calibration.
    pub covariance: Option<(Vec<String>, Vec<f64>)>,
    /// Whether the movement during exposures of it was adjusted.
    pub rolling_shutter: bool,
}

/// A camera: an image.
#[derive(Debug)]
pub struct CameraEntry {
    /// Its label, which is the name of the image.
    pub label: String,
    /// Id of its sensor.
    pub sensor: String,
    /// Id of its component.
    pub component: Option<String>,
    /// Whether its orientation is that of another camera of its rig.
    pub follows: bool,
    /// Its own id, as text.
    pub id: Option<String>,
    /// Label of the group it stands in.
    pub group: Option<String>,
    /// Whether it takes part.
    pub enabled: bool,
    /// Whether the movement during its exposure was adjusted.
    pub rolling_shutter: bool,
    /// Rotation and centre of `X_chunk = R X_camera + C`.
    pub transform: Option<(Matrix3<f64>, Vector3<f64>)>,
    /// Of a turn about the camera's own axes, rad^2.
    pub rotation_covariance: Option<Matrix3<f64>>,
    /// Of the centre, in chunk units squared.
    pub location_covariance: Option<Matrix3<f64>>,
}

/// `X_world = scale rotation X_chunk + translation`.
#[derive(Debug, Clone, Copy)]
pub struct Similarity {
    /// The rotation from the chunk to the world.
    pub rotation: Matrix3<f64>,
    /// The translation in the world, in its unit.
    pub translation: Vector3<f64>,
    /// Scale, greater than zero.
    pub scale: f64,
}

impl Similarity {
    /// What a chunk without transform has.
    pub fn identity() -> Self {
        Self { rotation: Matrix3::identity(), translation: Vector3::zeros(), scale: 1.0 }
    }
}

/// Reads the one chunk of a file.
///
/// # Errors
///
/// Broken XML, no chunk or several, lists of numbers that are too short.
pub fn read(text: &str) -> Result<Chunk, StageError> {
    check_markup(text)?;
    let document = Document::parse(text).map_err(|e| StageError::new(format!("not valid XML: {e}")))?;
    let chunks: Vec<Node> = document.descendants().filter(|node| node.has_tag_name("chunk")).collect();
    let [chunk] = chunks[..] else {
        let labels: Vec<&str> = chunks.iter().map(|chunk| chunk.attribute("label").unwrap_or("?")).collect();
        return Err(StageError::new(format!("{} chunks ({}), one is needed", chunks.len(), labels.join(", ")))
            .hint("in Metashape: File > Export > Export Cameras, for one chunk, as Agisoft XML"));
    };
    let components = below(chunk, "components", "component").filter_map(component);
    let components = components.collect::<Result<Vec<(String, Similarity)>, _>>()?;
    check_once("component", components.iter().map(|(id, _)| id.as_str()))?;
    let chunk = Chunk {
        sensors: below(chunk, "sensors", "sensor").map(sensor).collect::<Result<_, _>>()?,
        cameras: below(chunk, "cameras", "camera").map(camera).collect::<Result<_, _>>()?,
        components: components.into_iter().collect(),
        transform: child(chunk, "transform").map(similarity).transpose()?,
        reference: child(chunk, "reference").and_then(|node| node.text()).map(|text| text.trim().to_owned()),
    };
    check_once("sensor", chunk.sensors.iter().map(|sensor| sensor.id.as_str()))?;
    Ok(chunk)
}

/// Most attributes of an element, each of which is compared with all others, and most namespaces of a file.
const MOST_ATTRIBUTES: usize = 1024;

/// Refuses what a reader of XML would take long for: elements of very many attributes, and very many namespaces.
fn check_markup(text: &str) -> Result<(), StageError> {
    if text.matches("xmlns").nth(MOST_ATTRIBUTES).is_some() {
        fail!("not the XML of a camera file: it names more than {MOST_ATTRIBUTES} namespaces");
    }
    let mut rest = text;
    while let Some(at) = rest.find('<') {
        rest = &rest[at..];
        let within = [("<!--", "-->"), ("<![CDATA[", "]]>"), ("<?", "?>")];
        if let Some((_, end)) = within.into_iter().find(|(start, _)| rest.starts_with(start)) {
            rest = rest.find(end).map_or("", |at| &rest[at..]);
            continue;
        }
        let (mut attributes, mut quote) = (0, None);
        let end = rest.bytes().position(|byte| {
            match (byte, quote) {
                (b'"' | b'\'', None) => quote = Some(byte),
                (b'=', None) => attributes += 1,
                _ if quote == Some(byte) => quote = None,
                _ => {}
            }
            (quote.is_none() && byte == b'>') || attributes > MOST_ATTRIBUTES
        });
        if attributes > MOST_ATTRIBUTES {
            let line = text[..text.len() - rest.len()].matches('\n').count() + 1;
            fail!("not the XML of a camera file: line {line}: an element of more than {MOST_ATTRIBUTES} attributes");
        }
        // A quote or a bracket is ASCII: what follows begins a character.
        rest = end.map_or("", |end| &rest[end..]);
    }
    Ok(())
}

fn check_once<'a>(what: &str, ids: impl Iterator<Item = &'a str>) -> Result<(), StageError> {
    twice(ids.collect()).map_or(Ok(()), |id| Err(StageError::new(format!("two {what}s have the id {id}"))))
}

fn child<'a, 'i>(node: Node<'a, 'i>, name: &'static str) -> Option<Node<'a, 'i>> {
    node.children().find(|node| node.has_tag_name(name))
}

/// The `item` elements anywhere below the `list` elements of a chunk: cameras may stand in groups.
fn below<'a, 'i>(chunk: Node<'a, 'i>, list: &'static str, item: &'static str) -> impl Iterator<Item = Node<'a, 'i>> {
    let lists = chunk.children().filter(move |node| node.has_tag_name(list));
    lists.flat_map(move |node| node.descendants().filter(move |node| node.has_tag_name(item)))
}

/// Where an element stands, for messages.
fn place(node: Node) -> String {
    let line = node.document().text_pos_at(node.range().start).row;
    format!("line {line}, <{}>", node.tag_name().name())
}

fn number(node: Node, text: &str) -> Result<f64, StageError> {
    text.trim().parse().map_err(|_| StageError::new(format!("{}: `{text}` is not a number", place(node))))
}

fn numbers(node: Node) -> Result<Vec<f64>, StageError> {
    node.text().unwrap_or("").split_whitespace().map(|word| number(node, word)).collect()
}

fn exactly<const N: usize>(node: Node) -> Result<[f64; N], StageError> {
    let values = numbers(node)?;
    let count = values.len();
    values.try_into().map_err(|_| StageError::new(format!("{}: {count} numbers, {N} are needed", place(node))))
}

fn matrix(node: Node) -> Result<Matrix3<f64>, StageError> {
    exactly::<9>(node).map(|rows| Matrix3::from_row_slice(&rows))
}

fn required(node: Node, attribute: &str) -> Result<String, StageError> {
    let value = node.attribute(attribute).map(str::to_owned);
    value.ok_or_else(|| StageError::new(format!("{} has no attribute `{attribute}`", place(node))))
}

fn sensor(node: Node) -> Result<SensorEntry, StageError> {
    let calibrations: Vec<Node> = node.children().filter(|node| node.has_tag_name("calibration")).collect();
    let adjusted = calibrations.iter().find(|node| node.attribute("class") == Some("adjusted"));
    let chosen = adjusted.or(calibrations.first()).copied();
    // Sensor and calibration should agree; of two that do not, the one that is not simply read counts.
    let kinds = [node.attribute("type"), chosen.and_then(|node| node.attribute("type"))];
    let kind = kinds.into_iter().flatten().find(|kind| *kind != "frame").unwrap_or("frame");
    let covariance = node.descendants().find(|node| node.has_tag_name("covariance"));
    Ok(SensorEntry {
        id: required(node, "id")?,
        kind: kind.to_owned(),
        calibration: chosen.map(|chosen| calibration(node, chosen)).transpose()?,
        covariance: covariance.map(interior_covariance).transpose()?,
        rolling_shutter: has_rolling_shutter(node),
    })
}

/// The numbers of a calibration; its resolution, else that of its sensor.
fn calibration(sensor: Node, node: Node) -> Result<Vec<(String, f64)>, StageError> {
    let mut values = Vec::new();
    let [own, of_sensor] = [node, sensor].map(|node| child(node, "resolution"));
    if let (Some(own), Some(of_sensor)) = (own, of_sensor) {
        let size = |node: Node| [node.attribute("width"), node.attribute("height")].map(|side| side.map(str::to_owned));
        if size(own) != size(of_sensor) {
            fail!("{}: its <resolution> is another than that of its <sensor>", place(node));
        }
    }
    let resolution = own.or(of_sensor);
    for side in ["width", "height"] {
        let Some(text) = resolution.and_then(|node| node.attribute(side)) else {
            fail!("{}: no <resolution> says its {side}", place(node))
        };
        values.push((side.to_owned(), number(node, text)?));
    }
    for node in node.children().filter(Node::is_element) {
        let name = node.tag_name().name();
        if !["resolution", "covariance", "date"].contains(&name) {
            values.push((name.to_owned(), number(node, node.text().unwrap_or(""))?));
        }
    }
    Ok(values)
}

fn interior_covariance(node: Node) -> Result<(Vec<String>, Vec<f64>), StageError> {
    let (Some(names), Some(elements)) = (child(node, "params"), child(node, "coeffs")) else {
        fail!("{}: <params> and <coeffs> are needed", place(node))
    };
    let names: Vec<String> = names.text().unwrap_or("").split_whitespace().map(str::to_owned).collect();
    let elements = numbers(elements)?;
    if elements.len() != names.len() * names.len() {
        fail!("{}: {} parameters need a square of numbers, found {}", place(node), names.len(), elements.len());
    }
    Ok((names, elements))
}

fn camera(node: Node) -> Result<CameraEntry, StageError> {
    let pose = |node: Node| {
        let m = exactly::<16>(node)?;
        let rotation = Matrix3::from_rows(&[0, 4, 8].map(|row| nalgebra::RowVector3::from_row_slice(&m[row..row + 3])));
        Ok::<_, StageError>((rotation, Vector3::new(m[3], m[7], m[11])))
    };
    Ok(CameraEntry {
        label: required(node, "label")?,
        sensor: required(node, "sensor_id")?,
        component: node.attribute("component_id").map(str::to_owned),
        follows: node.attribute("master_id").is_some_and(|master| Some(master) != node.attribute("id")),
        id: node.attribute("id").map(str::to_owned),
        group: node
            .parent()
            .filter(|node| node.has_tag_name("group"))
            .and_then(|node| node.attribute("label"))
            .map(str::to_owned),
        enabled: !matches!(node.attribute("enabled"), Some("false" | "0")),
        rolling_shutter: has_rolling_shutter(node),
        transform: child(node, "transform").map(pose).transpose()?,
        rotation_covariance: child(node, "rotation_covariance").map(matrix).transpose()?,
        location_covariance: child(node, "location_covariance").map(matrix).transpose()?,
    })
}

/// What files call the adjustment of the movement during an exposure: an element, an attribute, or the name of a property.
const ROLLING_SHUTTER: &str = "rolling_shutter";

/// Whether a rolling shutter stands anywhere in an element and is not plainly off.
fn has_rolling_shutter(node: Node) -> bool {
    let is_named = |name: &str| name.to_ascii_lowercase().contains(ROLLING_SHUTTER);
    node.descendants().filter(Node::is_element).any(|node| {
        let of_attribute = node.attributes().any(|own| is_named(own.name()) && !is_off(own.value()));
        let is_property = node.attribute("name").is_some_and(is_named);
        if !is_named(node.tag_name().name()) && !is_property {
            return of_attribute;
        }
        let own = node.attributes().filter(|own| own.name() != "name").map(|own| own.value());
        let below = node.descendants().filter_map(|node| node.is_text().then(|| node.text()).flatten());
        let mut said = own.chain(below).map(str::trim).filter(|text| !text.is_empty()).peekable();
        of_attribute || said.peek().is_none() || said.any(|text| !is_off(text))
    })
}

/// A word for no, zeros, or the matrix that moves nothing.
fn is_off(text: &str) -> bool {
    let words: Vec<&str> = text.split_whitespace().collect();
    let numbers: Option<Vec<f64>> = words.iter().map(|word| word.parse().ok()).collect();
    match numbers {
        Some(numbers) if numbers.len() == 16 => {
            (0..16).all(|place| (numbers[place] - f64::from(u8::from(place % 5 == 0))).abs() < f64::EPSILON)
        }
        Some(numbers) => numbers.iter().all(|number| number.abs() < f64::EPSILON),
        None => ["false", "off", "no", "none", "disabled"].contains(&text.trim().to_ascii_lowercase().as_str()),
    }
}

fn component(node: Node) -> Option<Result<(String, Similarity), StageError>> {
    let transform = child(node, "transform")?;
    Some(required(node, "id").and_then(|id| Ok((id, similarity(transform)?))))
}

fn similarity(node: Node) -> Result<Similarity, StageError> {
    let rotation = child(node, "rotation").map(matrix).transpose()?.unwrap_or_else(Matrix3::identity);
    let translation = child(node, "translation").map(exactly::<3>).transpose()?.unwrap_or_default();
    let [scale] = child(node, "scale").map(exactly::<1>).transpose()?.unwrap_or([1.0]);
    if !(scale > 0.0 && scale.is_finite()) {
        fail!("{}: a scale of {scale}", place(node));
    }
    Ok(Similarity { rotation, translation: translation.into(), scale })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn very_many_attributes_and_namespaces_are_refused_before_they_are_compared() {
        let element = |name: &str, count: usize| {
            let attributes: String = (0..count).map(|i| format!(" {name}{i}='>\u{e9} = <'")).collect();
            format!("<?xml version='1.0'?>\n<!-- ' --><a>\n<b{attributes}/><![CDATA[ \" ]]></a>")
        };
        assert_eq!(check_markup(&element("x", 1024)), Ok(()));
        let message = check_markup(&element("x", 1025)).unwrap_err().message;
        assert!(message.contains("line 3: an element of more than 1024 attributes"), "{message}");
        let message = check_markup(&element("xmlns:x", 1025)).unwrap_err().message;
        assert!(message.contains("more than 1024 namespaces"), "{message}");
        assert_eq!(check_markup("<a 'never ends <b>"), Ok(()));
    }
}
