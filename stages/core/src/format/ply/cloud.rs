//! Point clouds as PLY files: our own binary layout, written and read to the bit, and those of other programs.

use std::collections::{BTreeMap, BTreeSet};

use bytemuck::cast;

use crate::artefact::{Cloud, CodecError};
use crate::format::ply::header::{
    CLOUD_COMMENT, Element, Encoding, Header, Property, Type, UNITS_COMMENT, georeference_line,
};
use crate::format::ply::{Ascii, Binary, ROWS_AT_A_TIME, Source, at, check_held, check_none_left, fault, finite, skip};
use crate::limits;

/// Properties with a meaning of their own: no number may have such a name.
const KNOWN: [&str; 9] = ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue"];

/// Writes a cloud: binary little-endian, double `x y z`, float `nx ny nz` where normals are known, uchar `red green blue`
/// where colours are, a uint for each of the numbers and a float for each of the values. A comment line states frame and units.
///
/// # Errors
/// A list that is not as long as the points, a coordinate that is not finite, a name that no property can have.
pub fn write(cloud: &Cloud) -> Result<Vec<u8>, CodecError> {
    check(cloud)?;
    let layout = Layout {
        normals: !cloud.normals.is_empty(),
        colours: !cloud.colours.is_empty(),
        numbers: cloud.numbers.keys().map(String::as_str).collect(),
        values: cloud.values.keys().map(String::as_str).collect(),
    };
    let header = header(cloud, &layout);
    let stride = layout.stride();
    let mut bytes = vec![0; header.len() + stride * cloud.points.len()];
    let (head, rows) = bytes.split_at_mut(header.len());
    head.copy_from_slice(header.as_bytes());
    for (block, rows) in rows.chunks_mut(stride * ROWS_AT_A_TIME).enumerate() {
        layout.write(cloud, block * ROWS_AT_A_TIME, rows);
    }
    Ok(bytes)
}

fn header(cloud: &Cloud, layout: &Layout) -> String {
    let mut text = format!(
        "ply\nformat binary_little_endian 1.0\ncomment {CLOUD_COMMENT}{}{UNITS_COMMENT}\n{}element vertex {}\n",
        cloud.frame,
        georeference_line(cloud.frame),
        cloud.points.len()
    );
    layout.properties().for_each(|(kind, name)| text += &format!("property {} {name}\n", kind.word()));
    text + "end_header\n"
}

/// The rows of our own files: which fields they have beside the point. Fields are read and written as they are, in blocks of rows
/// that stay in the cache of the processor.
struct Layout<'a> {
    normals: bool,
    colours: bool,
    numbers: Vec<&'a str>,
    values: Vec<&'a str>,
}

impl<'a> Layout<'a> {
    /// That of an element which has the properties of our own files in their order.
    fn of(element: &'a Element) -> Option<Self> {
        let further = element.properties.iter().filter(|property| !KNOWN.contains(&property.name.as_str()));
        let (numbers, values): (Vec<_>, Vec<_>) = further.partition(|property| property.kind != Type::F32);
        let names = |of: Vec<&'a Property>| of.into_iter().map(|property| property.name.as_str()).collect::<Vec<_>>();
        let (numbers, values) = (names(numbers), names(values));
        let distinct = numbers.iter().chain(&values).collect::<BTreeSet<_>>().len() == numbers.len() + values.len();
        let has = |name: &str| element.scalar(name).is_some();
        let layout = Self { normals: has(KNOWN[3]), colours: has(KNOWN[6]), numbers, values };
        let own = layout.properties().map(|(kind, name)| Property { name: name.to_owned(), count: None, kind });
        let is_own = own.eq(element.properties.iter().cloned());
        (is_own && distinct).then_some(layout)
    }

    fn properties(&self) -> impl Iterator<Item = (Type, &str)> {
        let known = [
            (Type::F64, &KNOWN[..3], true),
            (Type::F32, &KNOWN[3..6], self.normals),
            (Type::U8, &KNOWN[6..], self.colours),
        ];
        let known = known.into_iter().filter(|(_, _, has)| *has);
        let known = known.flat_map(|(kind, names, _)| names.iter().map(move |name| (kind, *name)));
        let numbers = self.numbers.iter().map(|name| (Type::U32, *name));
        known.chain(numbers).chain(self.values.iter().map(|name| (Type::F32, *name)))
    }

    /// Bytes of a row.
    fn stride(&self) -> usize {
        self.properties().map(|(kind, _)| kind.bytes()).sum()
    }

    /// Where normals, colours, the first of the numbers and the first of the values begin in a row.
    fn starts(&self) -> [usize; 4] {
        let normals = 3 * Type::F64.bytes();
        let colours = normals + 3 * Type::F32.bytes() * usize::from(self.normals);
        let numbers = colours + 3 * usize::from(self.colours);
        [normals, colours, numbers, numbers + Type::U32.bytes() * self.numbers.len()]
    }

    /// Writes the rows from a point on.
    fn write(&self, cloud: &Cloud, first: usize, rows: &mut [u8]) {
        let (stride, [normals, colours, numbers, measured]) = (self.stride(), self.starts());
        let points = first..first + rows.len() / stride;
        put(rows, stride, 0, &cloud.points[points.clone()], |point: [f64; 3]| {
            cast::<_, [u8; 24]>(point.map(f64::to_le_bytes))
        });
        if self.normals {
            let bytes = |normal: [f32; 3]| cast::<_, [u8; 12]>(normal.map(f32::to_le_bytes));
            put(rows, stride, normals, &cloud.normals[points.clone()], bytes);
        }
        if self.colours {
            put(rows, stride, colours, &cloud.colours[points.clone()], |colour: [u8; 3]| colour);
        }
        for (place, values) in cloud.numbers.values().enumerate() {
            put(rows, stride, numbers + Type::U32.bytes() * place, &values[points.clone()], u32::to_le_bytes);
        }
        for (place, values) in cloud.values.values().enumerate() {
            put(rows, stride, measured + Type::F32.bytes() * place, &values[points.clone()], f32::to_le_bytes);
        }
    }

    /// Reads all rows of an element.
    fn read(&self, element: &Element, rows: &[u8], cloud: &mut Cloud) -> Result<(), CodecError> {
        let (stride, [normals, colours, numbers, measured]) = (self.stride(), self.starts());
        let room = |has: bool| if has { element.count } else { 0 };
        cloud.points = limits::list("points", element.count)?;
        cloud.normals = limits::list("normals", room(self.normals))?;
        cloud.colours = limits::list("colours", room(self.colours))?;
        let lists = self.numbers.iter().map(|_| limits::list("numbers", element.count));
        let mut values: Vec<Vec<u32>> = lists.collect::<Result<_, _>>()?;
        let lists = self.values.iter().map(|_| limits::list("values", element.count));
        let mut floats: Vec<Vec<f32>> = lists.collect::<Result<_, _>>()?;
        for rows in rows.chunks(stride * ROWS_AT_A_TIME) {
            let first = cloud.points.len();
            let point = |bytes: [u8; 24]| cast::<_, [[u8; 8]; 3]>(bytes).map(f64::from_le_bytes);
            cloud.points.extend(get(rows, stride, 0).map(point));
            if let Some(row) = first_not_finite(&cloud.points[first..]) {
                finite(cloud.points[first + row]).map_err(|e| at(element, first + row, &e))?;
            }
            if self.normals {
                let zero_for_none = |value: f32| if value.is_finite() { value } else { 0.0 };
                let normal =
                    |bytes: [u8; 12]| cast::<_, [[u8; 4]; 3]>(bytes).map(f32::from_le_bytes).map(zero_for_none);
                cloud.normals.extend(get(rows, stride, normals).map(normal));
            }
            if self.colours {
                cloud.colours.extend(get::<3>(rows, stride, colours));
            }
            for (place, values) in values.iter_mut().enumerate() {
                values.extend(get(rows, stride, numbers + Type::U32.bytes() * place).map(u32::from_le_bytes));
            }
            for (place, values) in floats.iter_mut().enumerate() {
                values.extend(get(rows, stride, measured + Type::F32.bytes() * place).map(f32::from_le_bytes));
            }
        }
        cloud.values = self.values.iter().map(|name| (*name).to_owned()).zip(floats).collect();
        cloud.numbers = self.numbers.iter().map(|name| (*name).to_owned()).zip(values).collect();
        Ok(())
    }
}

/// Writes a field of some rows.
fn put<T: Copy, const N: usize>(
    rows: &mut [u8],
    stride: usize,
    start: usize,
    values: &[T],
    bytes: impl Fn(T) -> [u8; N],
) {
    for (row, value) in rows.chunks_exact_mut(stride).zip(values) {
        row[start..start + N].copy_from_slice(&bytes(*value));
    }
}

/// The bytes of a field of some rows.
fn get<const N: usize>(rows: &[u8], stride: usize, start: usize) -> impl Iterator<Item = [u8; N]> {
    rows.chunks_exact(stride).map(move |row| std::array::from_fn(|byte| row[start + byte]))
}

/// The place of the first point or normal that is not finite.
fn first_not_finite<T: Copy + Into<f64>>(list: &[[T; 3]]) -> Option<usize> {
    let finite = |value: &T| (*value).into().is_finite();
    // Without a branch for each value several are looked at together.
    let all_finite = |block: &[[T; 3]]| block.as_flattened().iter().fold(true, |all, value| all & finite(value));
    let block = list.chunks(ROWS_AT_A_TIME).position(|block| !all_finite(block))?;
    let first = block * ROWS_AT_A_TIME;
    list[first..].iter().position(|values| !values.iter().all(finite)).map(|at| first + at)
}

fn check(cloud: &Cloud) -> Result<(), CodecError> {
    let count = cloud.points.len();
    let lists = [("normals", cloud.normals.len()), ("colours", cloud.colours.len())];
    if let Some((name, length)) = lists.into_iter().find(|(_, length)| *length != 0 && *length != count) {
        return Err(fault(&format!("{count} points, but {length} {name}")));
    }
    if let Some(name) = cloud.values.keys().find(|name| cloud.numbers.contains_key(*name)) {
        return Err(fault(&format!("both a number and a value are called `{name}`")));
    }
    let numbers = cloud.numbers.iter().map(|(name, values)| (name, values.len()));
    for (name, length) in numbers.chain(cloud.values.iter().map(|(name, values)| (name, values.len()))) {
        let plain = !name.is_empty() && name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'_');
        if !plain || KNOWN.contains(&name.as_str()) {
            return Err(fault(&format!("`{name}` cannot name a number: lower-case letters, digits and `_`")));
        }
        if length != count {
            return Err(fault(&format!("{count} points, but {length} numbers `{name}`")));
        }
    }
    if let Some(at) = first_not_finite(&cloud.points) {
        return Err(fault(&format!("point {at} (counted from 0) is {:?}, which is not finite", cloud.points[at])));
    }
    if let Some(at) = first_not_finite(&cloud.normals) {
        return Err(fault(&format!("normal {at} (counted from 0) is {:?}, which is not finite", cloud.normals[at])));
    }
    Ok(())
}

/// Reads a cloud from any common PLY without faces: ascii or binary of either byte order, any number types.
///
/// The frame is the one our own comment states, otherwise world. Colours are read where they are one byte each; of the
/// other properties those of 32-bit whole numbers are kept, and in our own files those of 32-bit floats; the rest is left out.
///
/// # Errors
/// The row at fault: a header that is no PLY, faces, counts the file is too short for, coordinates that are not finite.
pub fn read(bytes: &[u8]) -> Result<Cloud, CodecError> {
    let (header, body) = Header::parse(bytes)?;
    if header.element("face").is_some_and(|faces| faces.count > 0) {
        return Err(fault("it has faces: it is a mesh"));
    }
    match header.encoding {
        Encoding::Ascii => read_body(&header, Ascii { rest: body }),
        Encoding::LittleEndian => read_body(&header, Binary::<true> { rest: body }),
        Encoding::BigEndian => read_body(&header, Binary::<false> { rest: body }),
    }
}

fn read_body<S: Source>(header: &Header, mut source: S) -> Result<Cloud, CodecError> {
    let mut cloud = Cloud::new(header.frame, Vec::new());
    header.element("vertex").ok_or_else(|| fault("the header declares no element `vertex`"))?;
    for element in &header.elements {
        check_held(&source, element)?;
        if element.name == "vertex" {
            read_points(element, header.states_frame, &mut source, &mut cloud)?;
        } else {
            skip(element, &mut source)?;
        }
    }
    check_none_left(&source)?;
    Ok(cloud)
}

/// Where a property goes.
enum Role {
    /// A property every cloud may have, by its place in [`KNOWN`].
    Known(usize),
    /// A further whole number of each point, by its place among these.
    Number(usize),
    /// It is read and dropped.
    Other,
}

fn roles(element: &Element, names: &mut Vec<String>) -> Result<Vec<Role>, CodecError> {
    if let Some(name) = KNOWN[..3].iter().find(|name| element.scalar(name).is_none()) {
        return Err(fault(&format!("element `vertex` has no property `{name}`")));
    }
    let role = |property: &Property| {
        if property.count.is_some() {
            return Role::Other;
        }
        if let Some(known) = KNOWN.iter().position(|name| *name == property.name) {
            return Role::Known(known);
        }
        if property.kind != Type::U32 || names.contains(&property.name) {
            return Role::Other;
        }
        names.push(property.name.clone());
        Role::Number(names.len() - 1)
    };
    Ok(element.properties.iter().map(role).collect())
}

fn read_points<S: Source>(
    element: &Element,
    is_own: bool,
    source: &mut S,
    cloud: &mut Cloud,
) -> Result<(), CodecError> {
    if let Some(layout) = Layout::of(element).filter(|layout| is_own || layout.values.is_empty())
        && let Some(rows) = source.rows(element)
    {
        return layout.read(element, rows, cloud);
    }
    let mut names = Vec::new();
    let roles = roles(element, &mut names)?;
    let has = |names: &[&str], kind: Option<Type>| {
        names.iter().all(|name| element.scalar(name).is_some_and(|own| kind.is_none_or(|kind| own == kind)))
    };
    let (normals, colours) = (has(&KNOWN[3..6], None), has(&KNOWN[6..], Some(Type::U8)));
    let lists = names.iter().map(|_| limits::list("numbers", element.count));
    let mut numbers: Vec<Vec<u32>> = lists.collect::<Result<_, _>>()?;
    cloud.points = limits::list("points", element.count)?;
    let mut columns = vec![Vec::new(); element.properties.len()];
    while cloud.points.len() < element.count {
        let first = cloud.points.len();
        let rows = source.columns(element, ROWS_AT_A_TIME.min(element.count - first), &mut columns);
        let rows = rows.map_err(|e| at(element, first, &e))?;
        let mut known: [&[f64]; 9] = [&[]; 9];
        for (column, role) in columns.iter().zip(&roles) {
            match role {
                Role::Known(place) => known[*place] = column,
                Role::Number(place) => numbers[*place].extend(column.iter().map(|value| *value as u32)),
                Role::Other => {}
            }
        }
        let [x, y, z, nx, ny, nz, red, green, blue] = known;
        for row in 0..rows {
            cloud.points.push(finite([x[row], y[row], z[row]]).map_err(|e| at(element, first + row, &e))?);
        }
        if normals {
            let zero_for_none = |value: f64| if value.is_finite() { value as f32 } else { 0.0 };
            cloud.normals.extend((0..rows).map(|row| [nx[row], ny[row], nz[row]].map(zero_for_none)));
        }
        if colours {
            cloud.colours.extend((0..rows).map(|row| [red[row], green[row], blue[row]].map(|value| value as u8)));
        }
    }
    cloud.numbers = names.into_iter().zip(numbers).collect::<BTreeMap<_, _>>();
    Ok(())
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;
    use crate::artefact::{Frame, Mesh};

    fn cloud() -> Cloud {
        let mut cloud = Cloud::new(Frame::Wall, vec![[0.1, -0.0, 451_000.123_456_789], [1.0, 2.0, 3.0]]);
        cloud.normals = vec![[0.0, 0.6, 0.8], [0.0; 3]];
        cloud.colours = vec![[1, 2, 255], [0, 0, 0]];
        cloud.numbers.insert("id".to_owned(), vec![u32::MAX, 7]);
        cloud.numbers.insert("views".to_owned(), vec![2, 3]);
        cloud.values.insert("change".to_owned(), vec![-0.25, 1e-30]);
        cloud
    }

    #[test]
    fn what_is_written_comes_back_to_the_bit() {
        let bytes = write(&cloud()).unwrap();
        let again = read(&bytes).unwrap();
        assert_eq!(again, cloud());
        assert_eq!(write(&again).unwrap(), bytes);
        let bare = Cloud::new(Frame::World, Vec::new());
        assert_eq!(read(&write(&bare).unwrap()).unwrap(), bare);
    }

    #[test]
    fn a_text_file_of_another_program_is_read() {
        let text = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n\
                    property float quality\nproperty uint views\nproperty uchar red\nend_header\n1 2 3 0.5 4 9\n";
        let cloud = read(text.as_bytes()).unwrap();
        assert_eq!((cloud.points.as_slice(), cloud.frame), (&[[1.0, 2.0, 3.0]][..], Frame::World));
        assert_eq!((cloud.numbers["views"].as_slice(), cloud.colours.len()), (&[4][..], 0));
    }

    #[test]
    fn what_is_wrong_is_named() {
        let mut short = cloud();
        short.colours.pop();
        assert!(write(&short).unwrap_err().0.contains("2 points, but 1 colours"));
        let mut named = cloud();
        named.numbers.insert("nx".to_owned(), vec![0, 0]);
        assert!(write(&named).unwrap_err().0.contains("`nx` cannot name"));
        let mut twice = cloud();
        twice.values.insert("id".to_owned(), vec![0.0, 0.0]);
        assert!(write(&twice).unwrap_err().0.contains("both a number and a value"));
        let mut endless = cloud();
        endless.points[1][2] = f64::NAN;
        assert!(write(&endless).unwrap_err().0.contains("point 1"));
        let (vertices, triangles) = (vec![[0.0; 3]; 3], vec![[0, 1, 2]]);
        let mesh = Mesh { frame: Frame::Wall, vertices, triangles, colours: Vec::new() };
        assert!(read(&crate::format::ply::write_mesh(&mesh)).unwrap_err().0.contains("it is a mesh"));
        let bytes = write(&cloud()).unwrap();
        assert!(read(&bytes[..bytes.len() - 1]).unwrap_err().0.contains("too short"));
    }
}
