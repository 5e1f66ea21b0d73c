//! Meshes as PLY files: our own binary layout, written and read to the bit, and any common file of other programs.

pub mod cloud;
mod header;
pub mod parts;

use crate::artefact::{CodecError, Frame, Mesh};
use crate::limits;

use crate::format::ply::header::{Element, Encoding, Header, Property, Type};

/// Writes a mesh: binary little-endian, double `x y z`, optional uchar `red green blue`, `list uchar uint vertex_indices`.
///
/// A comment line states frame and units, so that [`read_mesh`] gives the frame back.
pub fn write_mesh(mesh: &Mesh) -> Vec<u8> {
    let coloured = !mesh.colours.is_empty();
    let colours = if coloured { "property uchar red\nproperty uchar green\nproperty uchar blue\n" } else { "" };
    let header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment {}{}{}\n{}element vertex {}\nproperty double x\n\
         property double y\nproperty double z\n{colours}element face {}\nproperty list uchar uint vertex_indices\n\
         end_header\n",
        crate::format::ply::header::FRAME_COMMENT,
        mesh.frame,
        crate::format::ply::header::UNITS_COMMENT,
        crate::format::ply::header::georeference_line(mesh.frame),
        mesh.vertices.len(),
        mesh.triangles.len()
    );
    let stride = if coloured { 27 } else { 24 };
    let mut bytes = Vec::with_capacity(header.len() + mesh.vertices.len() * stride + mesh.triangles.len() * 13);
    bytes.extend_from_slice(header.as_bytes());
    for (index, vertex) in mesh.vertices.iter().enumerate() {
        for value in vertex {
            bytes.extend_from_slice(&value.to_le_bytes());
        }
        if coloured {
            bytes.extend_from_slice(&mesh.colours[index]);
        }
    }
    for triangle in &mesh.triangles {
        let mut row = [3u8; 13];
        for (corner, index) in triangle.iter().enumerate() {
            row[1 + 4 * corner..5 + 4 * corner].copy_from_slice(&index.to_le_bytes());
        }
        bytes.extend_from_slice(&row);
    }
    bytes
}

/// Reads a mesh from any common PLY: ascii or binary of either byte order, any number types, further elements and
/// properties skipped, polygons cut into fans.
///
/// The frame is the one our own comment states, otherwise world. Colours are read where they are one byte each.
/// A file without faces gives a mesh without triangles.
///
/// # Errors
/// The element and number at fault: a header that is no PLY, counts the file is too short for, coordinates that are no
/// numbers, corners that do not exist, a missing `x`, `y` or `z`.
pub fn read_mesh(bytes: &[u8]) -> Result<Mesh, CodecError> {
    let (header, body) = Header::parse(bytes)?;
    match header.encoding {
        Encoding::Ascii => read_body(&header, Ascii { rest: body }),
        Encoding::LittleEndian => read_body(&header, Binary::<true> { rest: body }),
        Encoding::BigEndian => read_body(&header, Binary::<false> { rest: body }),
    }
}

/// The frame that our own comment in the header of a mesh or cloud states, with its georeference; none where there is no such comment, and
/// of a file that is no PLY.
pub fn stated_frame(bytes: &[u8]) -> Option<Frame> {
    let (header, _) = Header::parse(bytes).ok()?;
    header.states_frame.then_some(header.frame)
}

/// Numbers one after the other; every PLY number type is exact in f64.
pub(super) trait Source {
    /// The next number, of this type.
    fn number(&mut self, kind: Type) -> Result<f64, String>;
    /// How many rows of at least so many numbers, or bytes in a binary file, the rest may hold, so that no header alone
    /// makes us allocate.
    fn held(&self, least_row: (usize, usize)) -> usize;
    /// How many bytes follow; none where they are blank.
    fn left(&self) -> usize;
    /// Reads the next rows of an element, at least one and at most so many, into one column for each property; returns how many.
    /// A list leaves a zero.
    fn columns(&mut self, element: &Element, most: usize, columns: &mut [Vec<f64>]) -> Result<usize, String>;
    /// All rows of an element as they lie in the file, where they are little-endian and of one length; otherwise nothing is read.
    fn rows(&mut self, _element: &Element) -> Option<&[u8]> {
        None
    }
    /// The next polygon, where it is a triangle of existing vertices that is read in one go; otherwise nothing is read.
    fn triangle(&mut self, _count: Type, _kind: Type, _vertices: usize) -> Option<[u32; 3]> {
        None
    }
}

/// Rows that are read at a time where all are of one length: their columns stay in the cache of the processor.
pub(super) const ROWS_AT_A_TIME: usize = 512;

/// Reads one row, whatever it holds.
fn read_row<S: Source>(source: &mut S, element: &Element, columns: &mut [Vec<f64>]) -> Result<usize, String> {
    for (property, column) in element.properties.iter().zip(columns) {
        let mut value = 0.0;
        read_property(property, source, &mut value)?;
        column.clear();
        column.push(value);
    }
    Ok(1)
}

/// The numbers of a text file.
pub(super) struct Ascii<'a> {
    /// What is not read yet.
    pub rest: &'a [u8],
}

impl Source for Ascii<'_> {
    fn number(&mut self, _kind: Type) -> Result<f64, String> {
        let start = self.rest.iter().position(|b| !b.is_ascii_whitespace()).ok_or("the file ends here")?;
        let rest = &self.rest[start..];
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        self.rest = &rest[end..];
        let text = String::from_utf8_lossy(&rest[..end]);
        text.parse().map_err(|_| format!("`{}` is not a number", text.chars().take(40).collect::<String>()))
    }
    fn held(&self, (numbers, _): (usize, usize)) -> usize {
        // A number and the space after it take two bytes; the last may lack the space.
        (self.rest.len() + 1).checked_div(2 * numbers).unwrap_or(usize::MAX)
    }
    fn left(&self) -> usize {
        not_blank(self.rest)
    }
    fn columns(&mut self, element: &Element, _most: usize, columns: &mut [Vec<f64>]) -> Result<usize, String> {
        read_row(self, element, columns)
    }
}

/// The numbers of a binary file.
pub(super) struct Binary<'a, const LITTLE: bool> {
    /// What is not read yet.
    pub rest: &'a [u8],
}

impl<const LITTLE: bool> Binary<'_, LITTLE> {
    fn take<const N: usize>(&mut self) -> Result<[u8; N], String> {
        let (head, rest) = self.rest.split_first_chunk::<N>().ok_or("the file ends here")?;
        self.rest = rest;
        Ok(Self::little_endian(*head))
    }

    fn little_endian<const N: usize>(mut value: [u8; N]) -> [u8; N] {
        if !LITTLE {
            value.reverse();
        }
        value
    }
}

impl<const LITTLE: bool> Source for Binary<'_, LITTLE> {
    #[inline]
    fn number(&mut self, kind: Type) -> Result<f64, String> {
        Ok(match kind {
            Type::I8 => f64::from(i8::from_le_bytes(self.take()?)),
            Type::U8 => f64::from(u8::from_le_bytes(self.take()?)),
            Type::I16 => f64::from(i16::from_le_bytes(self.take()?)),
            Type::U16 => f64::from(u16::from_le_bytes(self.take()?)),
            Type::I32 => f64::from(i32::from_le_bytes(self.take()?)),
            Type::U32 => f64::from(u32::from_le_bytes(self.take()?)),
            Type::F32 => f64::from(f32::from_le_bytes(self.take()?)),
            Type::F64 => f64::from_le_bytes(self.take()?),
        })
    }
    fn held(&self, (_, bytes): (usize, usize)) -> usize {
        self.rest.len().checked_div(bytes).unwrap_or(usize::MAX)
    }
    fn left(&self) -> usize {
        not_blank(self.rest)
    }
    fn columns(&mut self, element: &Element, most: usize, columns: &mut [Vec<f64>]) -> Result<usize, String> {
        let (_, stride) = element.least_row();
        if element.properties.iter().any(|property| property.count.is_some()) || stride == 0 {
            return read_row(self, element, columns);
        }
        let (rows, rest) = self.rest.split_at_checked(most * stride).ok_or("the file ends here")?;
        self.rest = rest;
        let mut start = 0;
        for (property, column) in element.properties.iter().zip(columns) {
            column.clear();
            let cells = Cells::<LITTLE> { rows, stride, start };
            match property.kind {
                Type::I8 => cells.append(column, |bytes| i8::from_le_bytes(bytes).into()),
                Type::U8 => cells.append(column, |bytes| u8::from_le_bytes(bytes).into()),
                Type::I16 => cells.append(column, |bytes| i16::from_le_bytes(bytes).into()),
                Type::U16 => cells.append(column, |bytes| u16::from_le_bytes(bytes).into()),
                Type::I32 => cells.append(column, |bytes| i32::from_le_bytes(bytes).into()),
                Type::U32 => cells.append(column, |bytes| u32::from_le_bytes(bytes).into()),
                Type::F32 => cells.append(column, |bytes| f32::from_le_bytes(bytes).into()),
                Type::F64 => cells.append(column, f64::from_le_bytes),
            }
            start += property.kind.bytes();
        }
        Ok(most)
    }
    fn rows(&mut self, element: &Element) -> Option<&[u8]> {
        if !LITTLE || element.properties.iter().any(|property| property.count.is_some()) {
            return None;
        }
        let (rows, rest) = self.rest.split_at_checked(element.count.checked_mul(element.least_row().1)?)?;
        self.rest = rest;
        Some(rows)
    }
    #[inline]
    fn triangle(&mut self, count: Type, kind: Type, vertices: usize) -> Option<[u32; 3]> {
        const BYTES: usize = 13;
        let row = self.rest.first_chunk::<BYTES>().filter(|row| row[0] == 3)?;
        if count != Type::U8 || !matches!(kind, Type::U32 | Type::I32) {
            return None;
        }
        let corner = |at| Some(u32::from_le_bytes(Self::little_endian(*row[at..].first_chunk()?)));
        let corners = [corner(1)?, corner(5)?, corner(9)?];
        // A negative number of 32 bits is taken for one above all of these.
        let least = vertices.min(i32::MAX as usize);
        let existing = corners.iter().all(|corner| (*corner as usize) < least);
        self.rest = if existing { &self.rest[BYTES..] } else { self.rest };
        existing.then_some(corners)
    }
}

/// The bytes of one property in rows of one length.
struct Cells<'a, const LITTLE: bool> {
    rows: &'a [u8],
    stride: usize,
    start: usize,
}

impl<const LITTLE: bool> Cells<'_, LITTLE> {
    fn append<const N: usize>(&self, column: &mut Vec<f64>, value: impl Fn([u8; N]) -> f64) {
        let cells = self.rows.chunks_exact(self.stride).filter_map(|row| row[self.start..].first_chunk());
        column.extend(cells.map(|cell| value(Binary::<LITTLE>::little_endian(*cell))));
    }
}

fn read_body<S: Source>(header: &Header, mut source: S) -> Result<Mesh, CodecError> {
    let mut mesh = Mesh { frame: header.frame, vertices: Vec::new(), triangles: Vec::new(), colours: Vec::new() };
    let vertices = header.element("vertex").ok_or_else(|| fault("the header declares no element `vertex`"))?.count;
    for element in &header.elements {
        check_held(&source, element)?;
        match element.name.as_str() {
            "vertex" => read_vertices(element, &mut source, &mut mesh)?,
            "face" => read_faces(element, &mut source, vertices, &mut mesh)?,
            _ => skip(element, &mut source)?,
        }
    }
    check_none_left(&source)?;
    Ok(mesh)
}

/// How many bytes there are, or none where all of them are white space, zeros or end marks of a text (Ctrl-Z).
fn not_blank(rest: &[u8]) -> usize {
    let is_blank = |byte: &u8| byte.is_ascii_whitespace() || matches!(byte, 0 | 0x1a);
    if rest.iter().all(is_blank) { 0 } else { rest.len() }
}

/// Refuses a file that goes on after the rows its header counts: what those leave out would be missing without a word.
pub(super) fn check_none_left<S: Source>(source: &S) -> Result<(), CodecError> {
    match source.left() {
        0 => Ok(()),
        left => Err(fault(&format!(
            "{left} bytes follow the rows that the header counts: its counts are too low, or something was appended; write it anew"
        ))),
    }
}

/// Refuses an element whose rows the rest of the file cannot hold.
pub(super) fn check_held<S: Source>(source: &S, element: &Element) -> Result<(), CodecError> {
    if element.count <= source.held(element.least_row()) {
        return Ok(());
    }
    let (name, count) = (&element.name, element.count);
    Err(fault(&format!("the header promises {count} x `{name}`, but the file is too short for them")))
}

fn read_vertices<S: Source>(element: &Element, source: &mut S, mesh: &mut Mesh) -> Result<(), CodecError> {
    for name in ["x", "y", "z"] {
        if element.scalar(name).is_none() {
            return Err(fault(&format!("element `vertex` has no property `{name}`")));
        }
    }
    let coloured = ["red", "green", "blue"].iter().all(|name| element.scalar(name) == Some(Type::U8));
    let named = |property: &Property, name: &str| property.name == name && property.count.is_none();
    let column = |name: &str| element.properties.iter().rposition(|p| named(p, name)).unwrap_or_default();
    let [xyz, rgb] = [["x", "y", "z"], ["red", "green", "blue"]].map(|names| names.map(column));
    mesh.vertices = limits::list("vertices", element.count)?;
    mesh.colours = limits::list("colours", if coloured { element.count } else { 0 })?;
    let mut columns = vec![Vec::new(); element.properties.len()];
    while mesh.vertices.len() < element.count {
        let first = mesh.vertices.len();
        let rows = source.columns(element, ROWS_AT_A_TIME.min(element.count - first), &mut columns);
        let rows = rows.map_err(|e| at(element, first, &e))?;
        let [x, y, z] = xyz.map(|k| &columns[k][..rows]);
        for (row, ((x, y), z)) in x.iter().zip(y).zip(z).enumerate() {
            mesh.vertices.push(finite([*x, *y, *z]).map_err(|e| at(element, first + row, &e))?);
        }
        if coloured {
            let [red, green, blue] = rgb.map(|k| &columns[k][..rows]);
            let colours = red.iter().zip(green).zip(blue);
            mesh.colours.extend(colours.map(|((red, green), blue)| [*red, *green, *blue].map(|value| value as u8)));
        }
    }
    Ok(())
}

/// The coordinates of a point, if they are finite.
#[inline]
pub(super) fn finite(point: [f64; 3]) -> Result<[f64; 3], String> {
    let [x, y, z] = point;
    if point.iter().all(|value| value.is_finite()) {
        Ok(point)
    } else {
        Err(format!("the coordinates ({x}, {y}, {z}) are not finite"))
    }
}

/// Reads a number, or steps over a list.
#[inline]
pub(super) fn read_property<S: Source>(property: &Property, source: &mut S, value: &mut f64) -> Result<(), String> {
    match property.count {
        None => *value = source.number(property.kind)?,
        Some(count) => {
            for _ in 0..list_length(source, count)? {
                source.number(property.kind)?;
            }
        }
    }
    Ok(())
}

fn read_faces<S: Source>(
    element: &Element,
    source: &mut S,
    vertices: usize,
    mesh: &mut Mesh,
) -> Result<(), CodecError> {
    let corners_at =
        element.corners().ok_or_else(|| fault("element `face` has no list `vertex_indices` or `vertex_index`"))?;
    mesh.triangles = limits::list("triangles", element.count.min(source.held(element.least_face())))?;
    for number in 0..element.count {
        for (place, property) in element.properties.iter().enumerate() {
            let read = match property.count {
                Some(count) if place == corners_at => read_polygon(source, count, property.kind, vertices, mesh),
                _ => read_property(property, source, &mut 0.0),
            };
            read.map_err(|e| at(element, number, &e))?;
        }
    }
    Ok(())
}

#[inline]
fn read_polygon<S: Source>(
    source: &mut S,
    count: Type,
    kind: Type,
    vertices: usize,
    mesh: &mut Mesh,
) -> Result<(), String> {
    if let Some(triangle) = source.triangle(count, kind, vertices) {
        mesh.triangles.push(triangle);
        return Ok(());
    }
    let corners = list_length(source, count)?;
    if corners < 3 {
        return Err(format!("{corners} corners are too few for a polygon"));
    }
    let first = corner(source, kind, vertices)?;
    let mut last = corner(source, kind, vertices)?;
    for _ in 2..corners {
        let next = corner(source, kind, vertices)?;
        mesh.triangles.push([first, last, next]);
        last = next;
    }
    Ok(())
}

#[inline]
fn corner<S: Source>(source: &mut S, kind: Type, vertices: usize) -> Result<u32, String> {
    let index = source.number(kind)?;
    if index >= 0.0 && index < vertices as f64 && index <= f64::from(u32::MAX) && index.fract() == 0.0 {
        Ok(index as u32)
    } else {
        Err(format!("corner {index} is not one of the {vertices} vertices (counted from 0)"))
    }
}

#[inline]
fn list_length<S: Source>(source: &mut S, count: Type) -> Result<u64, String> {
    let length = source.number(count)?;
    if length >= 0.0 && length.fract() == 0.0 && length <= f64::from(u32::MAX) {
        Ok(length as u64)
    } else {
        Err(format!("{length} is not the length of a list"))
    }
}

/// Steps over all rows of an element.
pub(super) fn skip<S: Source>(element: &Element, source: &mut S) -> Result<(), CodecError> {
    let rows = if element.properties.is_empty() { 0 } else { element.count };
    for number in 0..rows {
        for property in &element.properties {
            read_property(property, source, &mut 0.0).map_err(|e| at(element, number, &e))?;
        }
    }
    Ok(())
}

/// A fault of a row.
pub(super) fn at(element: &Element, number: usize, message: &str) -> CodecError {
    fault(&format!("{} {number} (counted from 0): {message}", element.name))
}

/// A fault of the file.
pub(super) fn fault(message: &str) -> CodecError {
    CodecError(format!("PLY file: {message}"))
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests;
