//! Damaged files of every format: no reader panics, aborts or takes more memory than the file accounts for.
//!
//! Each small valid file is cut, and its bytes and counts are set to extremes. More rounds of random damage, such as
//! `ROCKFACE_DAMAGE=20000 cargo test -p rockface-stages --lib damaged`, are best run under `ulimit -v 4000000`.

use std::io::Cursor;
use std::panic::{AssertUnwindSafe, catch_unwind};

use exr::prelude::{Encoding, ReadChannels, ReadLayers, WritableImage};

use rockface_core::artefact::{
    Artefact, Band, Cloud, Frame, Grid, Inventory, Kind, Mesh, Meshes, Noun, Part, Raster, Table,
};
use rockface_core::format::table_file;
use rockface_core::numerics::random;
use rockface_core::testing::{height_mesh, image_at, small_sensor};
use rockface_rock::face::{cloud, mesh_file};
use rockface_rock::rockfall::inventory_foreign;

/// Reads a file; what it holds does not matter.
type Reader = fn(&[u8]) -> bool;

/// Rounds of random damage of each file.
fn rounds() -> i32 {
    std::env::var("ROCKFACE_DAMAGE").ok().and_then(|text| text.parse().ok()).unwrap_or(60)
}

/// A file, cut and with bytes and counts set to extremes.
fn damaged(file: &[u8], rounds: i32) -> impl Iterator<Item = Vec<u8>> + '_ {
    let key = random::Key([5; 32]).field();
    let cuts = (0..file.len()).step_by((file.len() / 40).max(1)).map(|end| file[..end].to_vec());
    let edges = (0..file.len()).filter(|at| *at < 400 || at + 60 > file.len());
    let extremes: [&[u8]; 5] = [&[0xff; 4], &[0xff, 0xff, 0xff, 0x7f], &[0; 4], &[0xff; 8], &[0, 0, 0, 0, 1, 0, 0, 0]];
    let counts = edges.step_by(3).flat_map(move |at| extremes.map(|extreme| put(file, at, extreme)));
    let words: [&[u8]; 4] = [b"99999999999999999999", b"4294967295", b"-1", b"1e999"];
    let numbers = file.windows(2).enumerate().filter(|(_, pair)| !pair[0].is_ascii_digit() && pair[1].is_ascii_digit());
    let words = numbers.take(60).flat_map(move |(at, _)| words.map(|word| replaced(file, at + 1, word)));
    let random = (0..rounds).map(move |round| {
        let mut bytes = file.to_vec();
        for hit in 0..=(round % 5) {
            let [at, value, near, bit] = key.words(round, hit);
            let reach = if near % 2 == 0 { file.len().min(400) } else { file.len() };
            let byte = &mut bytes[at as usize % reach];
            *byte = if bit % 2 == 0 { value as u8 } else { *byte ^ (1 << (value % 8)) };
        }
        bytes
    });
    cuts.chain(counts).chain(words).chain(random)
}

fn put(file: &[u8], at: usize, value: &[u8]) -> Vec<u8> {
    let mut bytes = file.to_vec();
    let end = (at + value.len()).min(bytes.len());
    bytes[at..end].copy_from_slice(&value[..end - at]);
    bytes
}

/// The number at a place replaced by another.
fn replaced(file: &[u8], at: usize, word: &[u8]) -> Vec<u8> {
    let digits = file[at..].iter().take_while(|byte| byte.is_ascii_digit()).count();
    [&file[..at], word, &file[at + digits..]].concat()
}

/// Reads a file whole, and damaged.
fn check(name: &str, file: &[u8], read: Reader) {
    assert!(read(file), "{name}: the undamaged file is refused");
    for (number, bytes) in damaged(file, rounds()).enumerate() {
        let caught = catch_unwind(AssertUnwindSafe(|| read(&bytes)));
        assert!(
            caught.is_ok(),
            "{name}: panic at damage {number} of {} bytes: {:02x?}",
            bytes.len(),
            &bytes[..bytes.len().min(500)]
        );
    }
}

fn decoded(kind: Kind, bytes: &[u8]) -> bool {
    Artefact::decode(kind, bytes).is_ok()
}

fn read_cloud(bytes: &[u8]) -> bool {
    cloud::read(bytes.to_vec(), None, &|| false).is_ok()
}

fn read_mesh(bytes: &[u8]) -> bool {
    mesh_file::read(bytes, &|| false).is_ok()
}

fn mesh() -> Mesh {
    let mut mesh = height_mesh(2, [0.0, 8.0, 0.0, 8.0], |x, y| x * 0.5 + y * 0.25);
    mesh.colours = vec![[1, 2, 3]; mesh.vertices.len()];
    mesh
}

#[test]
fn damaged_meshes() {
    check("PLY", &mesh().encode().unwrap(), read_mesh);
    let header = "element vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
                  property list uchar int vertex_indices\nelement rest 2\nproperty list int double weights\n";
    let text = format!("ply\nformat ascii 1.0\n{header}end_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n2 0.5 1\n0\n");
    check("PLY as text", text.as_bytes(), read_mesh);
    let mut big = format!("ply\nformat binary_big_endian 1.0\n{header}end_header\n").into_bytes();
    [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0].iter().for_each(|x| big.extend(x.to_be_bytes()));
    big.push(3);
    [0i32, 1, 2, 0, 0].iter().for_each(|x| big.extend(x.to_be_bytes()));
    check("PLY, big-endian", &big, read_mesh);
    let part = Part { name: "a".into(), class: "b".into(), vertices: mesh().vertices, triangles: mesh().triangles };
    let parts = Meshes { frame: Frame::Wall, parts: vec![part.clone(), part] };
    check("PLY of parts", &parts.encode().unwrap(), |bytes| decoded(Kind::Meshes, bytes));
    check("OBJ", b"v 0 0 0\nv 1 0 0\nv 0 1 0 1 0 0\nf 1//1 2/2 -1\nf 1 2 \\\n 3\n", read_mesh);
    let facet = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
    check("STL as text", format!("solid a\n{facet}{facet}endsolid a\n").as_bytes(), read_mesh);
    let mut stl = [vec![0; 80], 2u32.to_le_bytes().to_vec()].concat();
    stl.extend((0..100).map(|i| i as u8));
    check("STL", &stl, read_mesh);
    check("surface", &surface().encode().unwrap(), |bytes| decoded(Kind::Surface, bytes));
}

fn surface() -> rockface_core::artefact::Surface {
    let points = vec![[0.0, 1.0, 2.0]; 6];
    rockface_core::artefact::Surface {
        frame: Frame::Wall,
        width: 3,
        height: 2,
        origin_m: [0.5; 3],
        points,
        squares: vec![3; 2],
    }
}

#[test]
fn damaged_clouds() {
    let mut cloud = Cloud::new(Frame::World, vec![[1.0, 2.0, 3.0]; 5]);
    cloud.normals = vec![[0.0, 0.0, 1.0]; 5];
    cloud.numbers.insert("id".into(), vec![7; 5]);
    check("cloud PLY", &cloud.encode().unwrap(), |bytes| decoded(Kind::Cloud, bytes));
    check("XYZ", b"//X Y Z R G B\n1 2 3 4 5 6\n2 3 4 5 6 7\n", read_cloud);
    check("PTS", b"2\n1 2 3 4 5 6\n2 3 4 5 6 7\n", read_cloud);
}

/// A LAS or LAZ file of a point format, with extra bytes.
fn las(format: u8, compressed: bool, extra_bytes: u16) -> Vec<u8> {
    let mut builder = las::Builder::from((1, 4));
    builder.point_format = las::point::Format::new(format).unwrap();
    builder.point_format.is_compressed = compressed;
    builder.point_format.extra_bytes = extra_bytes;
    let axis = las::Transform { scale: 0.001, offset: 0.0 };
    builder.transforms = las::Vector { x: axis, y: axis, z: axis };
    let mut writer = las::Writer::new(Cursor::new(Vec::new()), builder.into_header().unwrap()).unwrap();
    for i in 0..300u16 {
        let mut point = las::Point { x: f64::from(i) * 0.01, y: f64::from(i % 17), z: 1.0, ..las::Point::default() };
        point.gps_time = writer.header().point_format().has_gps_time.then_some(f64::from(i));
        point.color = writer.header().point_format().has_color.then(|| las::Color::new(i, 2 * i, 7));
        point.nir = writer.header().point_format().has_nir.then_some(i);
        point.extra_bytes = vec![i as u8; usize::from(extra_bytes)];
        writer.write_point(point).unwrap();
    }
    writer.close().unwrap();
    writer.into_inner().unwrap().into_inner()
}

#[test]
fn damaged_laser_scans() {
    for (format, extra) in [(0, 0), (3, 4), (6, 0), (7, 3), (8, 0)] {
        for compressed in [false, true] {
            check(&format!("LAS format {format}, {compressed}"), &las(format, compressed, extra), read_cloud);
        }
    }
}

#[test]
fn what_a_laz_file_claims_is_checked_before_memory_is_reserved() {
    let message = |bytes: &[u8]| cloud::read(bytes.to_vec(), None, &|| false).unwrap_err().0;
    for format in [3, 7] {
        let bytes = las(format, true, 0);
        let start = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
        let table = u64::from_le_bytes(bytes[start..start + 8].try_into().unwrap()) as usize;
        // Four thousand million chunks are 64 GiB of entries.
        let chunks = message(&put(&bytes, table + 4, &[0xff; 4]));
        assert!(chunks.contains("its chunk table claims 4294967295 chunks, but the file has room for"), "{chunks}");
    }
    let bytes = las(7, true, 0);
    let start = u32::from_le_bytes(bytes[96..100].try_into().unwrap()) as usize;
    // Behind the offset of the table, a point of 36 bytes and the count: the sizes of the layers.
    let layers = message(&put(&bytes, start + 8 + 36 + 4, &[0xff; 4]));
    assert!(layers.contains("chunk 0 (counted from 0) at byte") && layers.contains("claims more bytes"), "{layers}");
    let points = message(&put(&las(3, false, 0), 107, &[0xff; 4]));
    assert!(points.contains("promises 4294967295 points"), "{points}");
}

/// A file of another program: interleaved or tiled, compressed.
fn foreign_tiff<C: tiff::encoder::colortype::ColorType<Inner = u16>>(
    compression: tiff::encoder::Compression,
) -> Vec<u8> {
    let mut file = Cursor::new(Vec::new());
    let mut encoder = tiff::encoder::TiffEncoder::new(&mut file).unwrap().with_compression(compression);
    let mut image = encoder.new_image::<C>(9, 7).unwrap();
    image.encoder().write_tag(tiff::tags::Tag::ModelPixelScaleTag, [1.0, 1.0, 0.0].as_slice()).unwrap();
    image.encoder().write_tag(tiff::tags::Tag::ModelTiepointTag, [0.0; 6].as_slice()).unwrap();
    let samples = 9 * 7 * C::BITS_PER_SAMPLE.len() as u16;
    image.write_data(&(0..samples).collect::<Vec<_>>()).unwrap();
    file.into_inner()
}

#[test]
fn damaged_rasters() {
    use tiff::encoder::Compression;
    use tiff::encoder::colortype::{Gray16, RGB16};
    let grid = Grid { columns: 9, rows: 7, cell_m: 0.5, left_m: 0.0, top_m: 3.0 };
    let mut raster = Raster::single(grid, Frame::Wall, "difference", "a", (0..63u8).map(f32::from).collect());
    raster.bands.push(Band { name: "b".into(), values: vec![f32::NAN; 63] });
    let read: Reader = |bytes| decoded(Kind::Raster, bytes);
    check("GeoTIFF", &raster.encode().unwrap(), read);
    check("GeoTIFF, plain", &foreign_tiff::<Gray16>(Compression::Uncompressed), read);
    check("GeoTIFF, LZW", &foreign_tiff::<RGB16>(Compression::Lzw), read);
    check("GeoTIFF, packed", &foreign_tiff::<Gray16>(Compression::Packbits), read);
}

fn depth() -> rockface_core::artefact::Depth {
    let image = image_at("left", [0.0; 3], [0.0; 3]);
    let sensor = rockface_core::artefact::Sensor { width_px: 60, height_px: 45, ..small_sensor() };
    let z = (0..12u8).map(f32::from).collect();
    let channels = [("disparity".to_owned(), vec![1.5; 12])].into();
    rockface_core::artefact::Depth {
        frame: Frame::Wall,
        sensor,
        image,
        downscale: 15,
        width: 4,
        height: 3,
        z,
        channels,
    }
}

/// A depth map as another program may pack it.
fn repacked(encoding: Encoding) -> Vec<u8> {
    let plain = depth().encode().unwrap();
    let reader = exr::prelude::read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
    let mut image = reader.all_attributes().non_parallel().from_buffered(Cursor::new(plain)).unwrap();
    image.layer_data.encoding = encoding;
    let mut bytes = Cursor::new(Vec::new());
    image.write().non_parallel().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

#[test]
fn damaged_depth_maps() {
    use exr::prelude::{Blocks, Compression, LineOrder, Vec2};
    let read: Reader = |bytes| decoded(Kind::Depth, bytes);
    check("OpenEXR", &depth().encode().unwrap(), read);
    for compression in [Compression::RLE, Compression::ZIP16, Compression::PIZ] {
        for blocks in [Blocks::ScanLines, Blocks::Tiles(Vec2(2, 2))] {
            let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
            check(&format!("OpenEXR {compression:?} {blocks:?}"), &repacked(encoding), read);
        }
    }
}

#[test]
fn damaged_tables_and_inventories() {
    check("CSV", b"a_m;b;\"c\"\n1;2;x\n3;;\"y;\"\n", |bytes| table_file::read(bytes, &|| false).is_ok());
    let mut table = Table::new(["a", "b"]);
    table.push(vec![1.0.into(), "x".into()]);
    check("table", &table.encode().unwrap(), |bytes| decoded(Kind::Table, bytes));
    let ring = vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
    let polygon = rockface_core::artefact::Polygon { exterior: ring, holes: Vec::new() };
    let feature = rockface_core::artefact::Feature { outline: vec![polygon], values: vec![1.0.into()] };
    let inventory = Inventory { frame: Frame::Wall, columns: vec!["id".into()], features: vec![feature] };
    check("inventory", &inventory.encode().unwrap(), |bytes| {
        inventory_foreign::read(bytes).is_ok() | decoded(Kind::Inventory, bytes)
    });
}

#[test]
fn damaged_pictures_and_sketches() {
    let png = rockface_core::format::png::write(3, 2, &[9; 18]).unwrap();
    check("PNG", &png, |bytes| rockface_core::format::png::read(bytes).is_ok());
    let figure = br#"<svg xmlns="http://www.w3.org/2000/svg"><g><rect width="3"/></g></svg>"#;
    check("SVG", figure, |bytes| decoded(Kind::Figure, bytes));
    let sketches = rockface_stages::registry().look().sketches(&Artefact::from(mesh())).into_iter();
    let shown: Vec<_> = sketches.map(|sketch| rockface_core::artefact::Shown { port: "a".into(), sketch }).collect();
    let bytes = rockface_core::artefact::Shown::write_all(&shown).unwrap();
    check("sketches", &bytes, |bytes| rockface_core::artefact::Shown::read_all(bytes).is_ok());
}

#[test]
fn nesting_without_end_is_an_error() {
    let deep = |open: &str, times: usize| open.repeat(times).into_bytes();
    let json = deep("[", 100_000);
    assert!(
        !decoded(Kind::Table, &json) && !decoded(Kind::Inventory, &json) && inventory_foreign::read(&json).is_err()
    );
    assert!(!decoded(Kind::Figure, &deep("<g>", 200_000)));
    let closed = format!("<svg xmlns=\"s\">{}{}</svg>", "<g>".repeat(100_000), "</g>".repeat(100_000));
    let _ = decoded(Kind::Figure, closed.as_bytes());
    // Each entity is ten of the one before: a thousand million letters.
    let entity = |n: usize| format!("<!ENTITY e{} \"{}\">", n + 1, format!("&e{n};").repeat(10));
    let entities: String = (0..9).map(entity).collect();
    let bomb = format!("<!DOCTYPE svg [<!ENTITY e0 \"a\">{entities}]><svg>&e9;</svg>");
    assert!(!decoded(Kind::Figure, bomb.as_bytes()));
}

#[test]
fn a_header_of_endless_declarations_is_an_error() {
    let many: String = (0..300_000).map(|i| format!("property uint p{i}\n")).collect();
    let text = format!("ply\nformat ascii 1.0\nelement vertex 1\n{many}end_header\n");
    assert!(cloud::read(text.into_bytes(), None, &|| false).unwrap_err().0.contains("more than 4096 elements"));
    let elements: String = (0..300_000).map(|i| format!("element e{i} 0\n")).collect();
    let text = format!("ply\nformat ascii 1.0\n{elements}end_header\n");
    assert!(mesh_file::read(text.as_bytes(), &|| false).unwrap_err().0.contains("more than 4096 elements"));
}
