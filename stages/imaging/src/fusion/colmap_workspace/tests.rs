//! What COLMAP's readers would find in a workspace, and what is refused of what comes back.

use std::collections::BTreeMap;

use super::*;
use rockface_core::artefact::Image;
use rockface_core::testing::{image_at, small_sensor};

/// The depth map of the wall z = 0, from 20 m before it at x.
fn wall(name: &str, x: f64, offset_m: f64) -> Depth {
    let image = image_at(name, [offset_m + x, 0.0, 20.0], [0.0; 3]);
    let (width, height) = (60, 40);
    let z = (0..width * height).map(|at| if at == 0 { f32::NAN } else { 20.0 }).collect();
    let sensor = small_sensor();
    Depth { frame: Frame::Wall, sensor, image, downscale: 1, width, height, z, channels: BTreeMap::new() }
}

fn file<'a>(workspace: &'a Workspace, name: &str) -> &'a [u8] {
    &workspace.files.iter().find(|(own, _)| own == name).unwrap_or_else(|| panic!("no file {name}")).1
}

fn text(workspace: &Workspace, name: &str) -> String {
    String::from_utf8(file(workspace, name).to_vec()).unwrap()
}

#[test]
fn the_folder_has_what_the_dense_code_reads() {
    let (first, second) = (wall("a b/c", -2.0, 451_010.0), wall("d", 2.0, 451_010.0));
    let made = lay_out(&[&first, &second], 2).unwrap();
    assert_eq!(made.origin_m, [451_000.0, 0.0, 0.0]);
    assert_eq!(text(&made, "stereo/fusion.cfg"), "000000.png\n000001.png\n");
    // Principal points as they are counted here: the dense code's own way.
    assert_eq!(text(&made, "sparse/cameras.txt").lines().next(), Some("1 PINHOLE 60 40 100 100 29.5 19.5"));
    let images = text(&made, "sparse/images.txt");
    let pose: Vec<f64> = images.lines().next().unwrap().split(' ').take(8).map(|word| word.parse().unwrap()).collect();
    assert_eq!(pose, [1.0, 0.0, 1.0, 0.0, 0.0, -8.0, 0.0, 20.0]);
    let depths = file(&made, "stereo/depth_maps/000000.png.geometric.bin");
    assert!(depths.starts_with(b"60&40&1&"));
    let values: Vec<f32> = depths[8..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    assert_eq!((values.len(), values[0], values[1]), (2400, 0.0, 20.0));
    let normals = file(&made, "stereo/normal_maps/000000.png.geometric.bin");
    assert!(normals.starts_with(b"60&40&3&"));
    let values: Vec<f32> = normals[8..].chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    // Planes: all x, all y, all z; towards the camera is against its axis.
    assert_eq!(values.len(), 7200);
    assert!(values[2401..4800].iter().all(|y| y.abs() < 1e-6) && values[4801..].iter().all(|z| (z + 1.0).abs() < 1e-6));
    assert_eq!(values[4800], 0.0);
    assert!(file(&made, "images/000001.png").starts_with(b"\x89PNG"));
}

#[test]
fn every_pair_that_overlaps_has_points_of_both() {
    let maps = [wall("a", -3.0, 0.0), wall("b", 0.0, 0.0), wall("c", 3.0, 0.0)];
    let made = lay_out(&maps.each_ref(), 2).unwrap();
    let points = text(&made, "sparse/points3D.txt");
    assert_eq!(points.lines().count(), made.tie_points);
    let tracks: Vec<Vec<usize>> = points
        .lines()
        .map(|line| line.split(' ').skip(8).step_by(2).map(|word| word.parse().unwrap()).collect())
        .collect();
    for pair in [[1, 2], [2, 3], [1, 3]] {
        let shared = tracks.iter().filter(|track| pair.iter().all(|image| track.contains(image))).count();
        assert!(shared > 100, "{pair:?}: {shared}");
    }
    // Positions count from the corner, and point back to their points.
    let images = text(&made, "sparse/images.txt");
    let seen: Vec<f64> = images.lines().nth(1).unwrap().split(' ').map(|word| word.parse().unwrap()).collect();
    assert_eq!(seen.len() % 3, 0);
    assert!((seen[0] - 0.5).fract() == 0.0 && tracks[seen[2] as usize - 1].contains(&1));
}

#[test]
fn maps_that_share_nothing_are_refused() {
    let apart = [wall("a", -50.0, 0.0), wall("b", 50.0, 0.0)];
    let refused = lay_out(&apart.each_ref(), 2).err().unwrap();
    assert!(refused.message.contains("no two of 2 depth maps"), "{}", refused.message);
    assert!(frame_of(&[&apart[0]]).unwrap_err().message.contains("1 depth maps"));
    let world =
        Depth { frame: Frame::World, image: Image { name: "w".into(), ..apart[1].image.clone() }, ..apart[1].clone() };
    assert!(frame_of(&[&apart[0], &world]).unwrap_err().message.contains("image `w` is in the world frame"));
}

/// A cloud as COLMAP writes it.
fn ply(points: &[[f32; 3]]) -> Vec<u8> {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\nproperty uchar red\nproperty uchar green\n\
         property uchar blue\nend_header\n",
        points.len()
    )
    .into_bytes();
    for point in points {
        point.iter().chain(&[0.0, 0.0, 1.0]).for_each(|value| bytes.extend_from_slice(&value.to_le_bytes()));
        bytes.extend_from_slice(&[128; 3]);
    }
    bytes
}

fn vis(counts: &[u32]) -> Vec<u8> {
    let point = |count: &u32| std::iter::once(*count).chain(0..*count).flat_map(u32::to_le_bytes).collect::<Vec<_>>();
    (counts.len() as u64).to_le_bytes().into_iter().chain(counts.iter().flat_map(point)).collect()
}

#[test]
fn what_comes_back_is_moved_and_checked() {
    let maps = [wall("a", -2.0, 451_010.0), wall("b", 2.0, 451_010.0)];
    let made = lay_out(&maps.each_ref(), 2).unwrap();
    let points = [[10.0, 1.0, 0.01], [11.0, -2.0, 0.0]];
    let cloud = read(&ply(&points), &vis(&[2, 3]), Frame::Wall, made.origin_m, &made.bounds).unwrap();
    assert_eq!((cloud.points[1], cloud.normals[0]), ([451_011.0, -2.0, 0.0], [0.0, 0.0, 1.0]));
    assert_eq!((cloud.numbers["views"].as_slice(), cloud.colours.len()), (&[2, 3][..], 0));
    let refused = |points: &[[f32; 3]], counts: &[u32]| {
        read(&ply(points), &vis(counts), Frame::Wall, made.origin_m, &made.bounds).unwrap_err().message
    };
    assert!(refused(&[], &[]).contains("fused no point"));
    assert!(refused(&[[900.0, 0.0, 0.0]], &[2]).contains("1 of 1 points of the cloud lie outside"));
    assert!(refused(&points, &[2]).contains("has 1 points, its cloud 2"));
    let mut short = vis(&[2, 3]);
    short.pop();
    assert!(
        read(&ply(&points), &short, Frame::Wall, made.origin_m, &made.bounds)
            .unwrap_err()
            .message
            .contains("cut short")
    );
    let empty = read_mesh(&ply(&points), Frame::Wall, made.origin_m, &made.bounds).unwrap_err();
    assert!(empty.message.contains("as dense as `trim` asks"), "{}", empty.message);
}
