//! Tests of the PLY reader and writer: bit-exact round trips, files of other programs, damaged files.

use proptest::prelude::*;

use crate::artefact::Frame;

use super::*;

fn sample(coloured: bool) -> Mesh {
    let vertices = vec![[451_234.1, 5_512_345.2, 1.0 / 3.0], [1.0, -0.0, 5e-324], [2.0, 3.0, -1e300], [0.5, 0.25, 4.0]];
    let colours = if coloured { vec![[1, 2, 3], [255, 0, 128], [9, 9, 9], [0, 0, 0]] } else { Vec::new() };
    Mesh { frame: Frame::Wall, vertices, triangles: vec![[0, 1, 2], [2, 1, 3]], colours }
}

fn message(bytes: &[u8]) -> String {
    read_mesh(bytes).unwrap_err().0
}

fn ascii(vertices: &str, faces: &str) -> Vec<u8> {
    let (n, m) = (vertices.lines().count(), faces.lines().count());
    format!(
        "ply\r\nformat ascii 1.0\r\ncomment made by hand\r\nelement vertex {n}\r\nproperty float x\r\nproperty float y\r\n\
         property float z\r\nproperty float quality\r\nelement face {m}\r\nproperty list uchar int vertex_index\r\n\
         end_header\r\n{vertices}{faces}"
    )
    .into_bytes()
}

const SQUARE: &str = "0 0 0 9\n1 0 0 9\n1 1 0.5 9\n0 1 0 9\n";

#[test]
fn comes_back_bit_for_bit() {
    for mesh in [sample(false), sample(true), Mesh { frame: Frame::World, ..sample(true) }] {
        let back = read_mesh(&write_mesh(&mesh)).unwrap();
        let bits = |m: &Mesh| m.vertices.iter().map(|v| v.map(f64::to_bits)).collect::<Vec<_>>();
        assert_eq!(bits(&back), bits(&mesh));
        assert_eq!(back, mesh);
    }
    let empty = Mesh { frame: Frame::Wall, vertices: Vec::new(), triangles: Vec::new(), colours: Vec::new() };
    assert_eq!(read_mesh(&write_mesh(&empty)).unwrap(), empty);
}

#[test]
fn an_ascii_polygon_becomes_a_fan() {
    let mesh = read_mesh(&ascii(SQUARE, "4 0 1 2 3\n")).unwrap();
    assert_eq!(mesh.frame, Frame::World);
    assert_eq!(mesh.vertices[2], [1.0, 1.0, 0.5]);
    assert_eq!(mesh.triangles, [[0, 1, 2], [0, 2, 3]]);
}

#[test]
fn big_endian_with_foreign_elements_and_properties() {
    let mut bytes = b"ply\nformat binary_big_endian 1.0\nobj_info x\nelement scan 2\nproperty list uchar short id\n\
        element vertex 3\nproperty double x\nproperty uchar flag\nproperty float32 y\nproperty int16 z\nelement face 1\n\
        property uchar flags\nproperty list uchar uint32 vertex_indices\nproperty list uchar float texcoord\n\
        end_header\n"
        .to_vec();
    bytes.extend_from_slice(&[2, 0, 1, 0, 2, 0]);
    for i in 0..3i16 {
        bytes.extend_from_slice(&(f64::from(i) + 0.1).to_be_bytes());
        bytes.push(7);
        bytes.extend_from_slice(&(f32::from(i) * 0.5).to_be_bytes());
        bytes.extend_from_slice(&(-i).to_be_bytes());
    }
    bytes.extend_from_slice(&[0, 3, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2, 1, 0, 0, 0, 0]);
    let mesh = read_mesh(&bytes).unwrap();
    assert_eq!(mesh.vertices, [[0.1, 0.0, 0.0], [1.1, 0.5, -1.0], [2.1, 1.0, -2.0]]);
    assert_eq!(mesh.triangles, [[0, 1, 2]]);
    assert!(mesh.colours.is_empty());
}

#[test]
fn errors_name_element_and_number() {
    assert!(message(&ascii(SQUARE, "3 0 1 2\n3 0 1 4\n")).contains("face 1 (counted from 0): corner 4"));
    assert!(message(&ascii(SQUARE, "3 0 1 -1\n")).contains("corner -1"));
    assert!(message(&ascii(SQUARE, "2 0 1\n")).contains("2 corners"));
    assert!(message(&ascii("0 0 0 9\n0 nan 0 9\n", "")).contains("vertex 1"));
    assert!(message(&ascii("0 0 0 9\n0 zero 0 9\n", "")).contains("`zero` is not a number"));
    assert!(
        message(b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\nend_header\n")
            .contains("no property `z`")
    );
    assert!(message(b"solid cube\n").contains("not `ply`"));
    assert!(message(&[ascii(SQUARE, "3 0 1 2\n"), b"7\n".to_vec()].concat()).contains("3 bytes follow"));
    let twice = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nproperty uint x\n";
    assert!(message(format!("{twice}end_header\n1 2 3 4\n").as_bytes()).contains("two properties `x`"));
}

#[test]
fn a_file_that_goes_on_after_its_last_row_is_refused() {
    let mesh = read_mesh(&ascii(SQUARE, "3 0 1 2\n3 0 2 3\n")).unwrap();
    let bytes = write_mesh(&mesh);
    let text = String::from_utf8_lossy(&bytes).into_owned();
    assert!(text.contains("element face 2"));
    let at = text.find("element face 2").unwrap() + "element face ".len();
    let mut fewer = bytes.clone();
    fewer[at] = b'1';
    assert!(message(&fewer).contains("13 bytes follow the rows that the header counts"));
    // A line end or an end mark after the last row is none of this.
    for end in [b"\n".as_slice(), b"\0", b"\r\n\x1a"] {
        assert_eq!(read_mesh(&[bytes.as_slice(), end].concat()).unwrap(), mesh);
    }
}

#[test]
fn huge_counts_in_a_small_file_allocate_nothing() {
    for format in ["ascii", "binary_little_endian"] {
        for count in ["4000000000", "18446744073709551615"] {
            let text = format!(
                "ply\nformat {format} 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n\
                 property float z\nend_header\n1 2 3\n"
            );
            assert!(message(text.as_bytes()).contains("too short"), "{format} {count}");
        }
    }
}

#[test]
fn a_cut_file_is_refused_at_every_length() {
    crate::testing::refuses_every_beginning(&write_mesh(&sample(true)), read_mesh);
}

proptest! {
    #[test]
    fn damaged_files_never_panic(edits in prop::collection::vec((0usize..600, any::<u8>()), 1..8), text in any::<bool>()) {
        let mut bytes = if text { ascii(SQUARE, "4 0 1 2 3\n") } else { write_mesh(&sample(true)) };
        for (place, value) in edits {
            let length = bytes.len();
            bytes[place % length] = value;
        }
        let _ = read_mesh(&bytes);
    }

    #[test]
    fn any_mesh_comes_back(vertices in prop::collection::vec([-1e9f64..1e9, -1e9f64..1e9, -1e9f64..1e9], 1..40),
                           picks in prop::collection::vec([0u32..1000, 0u32..1000, 0u32..1000], 0..40)) {
        let n = vertices.len() as u32;
        let triangles = picks.into_iter().map(|t| t.map(|i| i % n)).collect();
        let mesh = Mesh { frame: Frame::World, vertices, triangles, colours: Vec::new() };
        prop_assert_eq!(read_mesh(&write_mesh(&mesh)).unwrap(), mesh);
    }
}
