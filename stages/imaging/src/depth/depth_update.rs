//! The depth buffer of a mesh that differs little from one already drawn: only tiles that changed triangles reach are redrawn.
//!
//! A pixel that neither a vanished nor a new triangle reaches is met by the same triangles before and after, so its depth is
//! the same to the bit. Triangles are the same when their corners are, bit by bit and in the same order.

use nalgebra::Vector3;
use rayon::prelude::*;

use crate::camera::model::Camera;
use crate::depth::depth_buffer::{BAND, Band, Drawing, Scene, rounded};
use crate::depth::triangle_reach::{Bend, Reach, reach};
use rockface_core::artefact::Mesh;

/// Columns of a tile; its rows are those of a band.
const TILE: usize = 64;
/// Bands that are drawn whole, to see that the buffer taken over is one of the mesh before.
const PROBES: usize = 8;

/// Depths drawn again in part, and how much of them was drawn.
#[derive(Debug, Clone, PartialEq)]
pub struct Redrawn {
    /// Depths by row from the top, metres, NaN where there is none: the same bits as of the mesh drawn whole.
    pub depths_m: Vec<f32>,
    /// Triangles that only one of the two meshes has.
    pub changed_triangles: usize,
    /// Share of the tiles that was drawn anew.
    pub share: f64,
}

/// How far ahead the next triangle both meshes have is looked for, at first and at most.
const AHEAD: [usize; 2] = [1 << 8, 1 << 14];
/// How many triangles are looked at so in all before it is taken that the order is another.
const PATIENCE: usize = 200_000_000;

/// A triangle by a number made of its corners, and its place in the mesh.
type Marked = (u64, u32);
/// The corners of a triangle, bit by bit.
type Corners = [[u64; 3]; 3];

/// Triangles of either mesh that the other does not have, by index: those of `before`, those of `after`.
pub fn changed_triangles(before: &Mesh, after: &Mesh) -> [Vec<u32>; 2] {
    let (own, theirs) = rayon::join(|| marked(before), || marked(after));
    let [mut own, mut theirs] = unlike([&own, &theirs], [before, after]);
    own.sort_unstable();
    theirs.sort_unstable();
    let [mut gone, mut new] = [Vec::new(), Vec::new()];
    let (mut i, mut j) = (0, 0);
    while i < own.len() || j < theirs.len() {
        let next = own.get(i).into_iter().chain(theirs.get(j)).map(|(mark, _)| *mark).min().unwrap_or_default();
        let (here, there) = (run(&own[i..], next), run(&theirs[j..], next));
        // Other corners with the same mark do not occur; if they did, all would be drawn anew, which is never wrong.
        let mut all =
            here.iter().map(|(_, t)| corners(before, *t)).chain(there.iter().map(|(_, t)| corners(after, *t)));
        let first = all.next();
        if here.is_empty() || there.is_empty() || !all.all(|other| Some(other) == first) {
            gone.extend(here.iter().map(|(_, triangle)| *triangle));
            new.extend(there.iter().map(|(_, triangle)| *triangle));
        }
        (i, j) = (i + here.len(), j + there.len());
    }
    gone.sort_unstable();
    new.sort_unstable();
    [gone, new]
}

fn corners(mesh: &Mesh, triangle: u32) -> Corners {
    mesh.triangles[triangle as usize].map(|i| mesh.vertices[i as usize].map(f64::to_bits))
}

/// What is left when triangles that follow each other alike in both meshes are taken out: next to nothing where the order was
/// kept, everything where it was not.
fn unlike([own, theirs]: [&[Marked]; 2], [before, after]: [&Mesh; 2]) -> [Vec<Marked>; 2] {
    let (mut left, mut patience, mut ahead) = ([Vec::new(), Vec::new()], PATIENCE, AHEAD[0]);
    let (mut i, mut j) = (0, 0);
    while let (Some(one), Some(other), true) = (own.get(i), theirs.get(j), patience > 0) {
        if one.0 == other.0 && corners(before, one.1) == corners(after, other.1) {
            (i, j, ahead) = (i + 1, j + 1, AHEAD[0]);
            continue;
        }
        let gone = (1..ahead).find(|k| own.get(i + k).is_some_and(|next| next.0 == other.0));
        let new = (1..gone.unwrap_or(ahead)).find(|k| theirs.get(j + k).is_some_and(|next| next.0 == one.0));
        patience -= ahead.min(patience);
        ahead = (2 * ahead).min(AHEAD[1]);
        let skip = match (gone, new) {
            (_, Some(new)) => [0, new],
            (Some(gone), None) => [gone, 0],
            (None, None) => [1, 1],
        };
        left[0].extend(&own[i..i + skip[0]]);
        left[1].extend(&theirs[j..j + skip[1]]);
        (i, j) = (i + skip[0], j + skip[1]);
    }
    left[0].extend(&own[i..]);
    left[1].extend(&theirs[j..]);
    left
}

/// The triangles of a mesh with their marks.
fn marked(mesh: &Mesh) -> Vec<Marked> {
    let mark = |triangle: u32| {
        let mix = |sum: u64, bits: &u64| (sum ^ bits).wrapping_mul(0x9E37_79B9_7F4A_7C15).rotate_left(29);
        (corners(mesh, triangle).as_flattened().iter().fold(0, mix), triangle)
    };
    (0..mesh.triangles.len() as u32).into_par_iter().map(mark).collect()
}

/// The first triangles, as long as they have this mark.
fn run(marked: &[Marked], mark: u64) -> &[Marked] {
    let length = marked.iter().take_while(|(own, _)| *own == mark).count();
    &marked[..length]
}

/// Draws `after` from the depths of `before` (NaN where there is none), which the same camera and drawing gave.
///
/// `None` where the depths are seen not to be those of `before` drawn like this.
pub fn redraw([before, after]: [&Mesh; 2], depths_m: &[f32], camera: &Camera, drawing: &Drawing) -> Option<Redrawn> {
    let scene = Scene::of(after, camera, drawing);
    let (width, height) = (scene.width, scene.height);
    if depths_m.len() != width * height || width == 0 {
        return None;
    }
    let changed = changed_triangles(before, after);
    let tiles = width.div_ceil(TILE);
    let mut dirty = vec![false; tiles * height.div_ceil(BAND)];
    for (mesh, triangles) in [before, after].into_iter().zip(&changed) {
        mark(mesh, triangles, camera, drawing, (width, height), &mut dirty);
    }
    let mut redrawn = depths_m.to_vec();
    let marks = |band: usize| &dirty[band * tiles..(band + 1) * tiles];
    let bands = redrawn.par_chunks_mut(BAND * width).enumerate().filter(|(band, _)| marks(*band).contains(&true));
    bands.for_each_init(Band::default, |own, (band, depths_m)| {
        let wanted = |columns: [usize; 2]| marks(band)[columns[0] / TILE..=columns[1] / TILE].contains(&true);
        take_over(depths_m, own.draw(&scene, band, wanted), width, marks(band));
    });
    let share = dirty.iter().filter(|dirty| **dirty).count() as f64 / dirty.len() as f64;
    let same = probe(&scene, &redrawn);
    same.then_some(Redrawn { depths_m: redrawn, changed_triangles: changed[0].len() + changed[1].len(), share })
}

/// Marks the tiles that triangles may cover.
fn mark(mesh: &Mesh, triangles: &[u32], camera: &Camera, drawing: &Drawing, size: (usize, usize), dirty: &mut [bool]) {
    let (bend, tiles) = (Bend::new(camera.sensor()), size.0.div_ceil(TILE));
    for triangle in triangles {
        let corners = mesh.triangles[*triangle as usize].map(|i| mesh.vertices[i as usize]);
        let corners = corners.map(|v| camera.to_camera(&Vector3::from(v)));
        match reach(camera, &bend, &corners, f64::from(drawing.downscale), size) {
            Reach::Nothing => {}
            Reach::Pixels { columns, rows } => {
                for band in rows[0] as usize / BAND..=rows[1] as usize / BAND {
                    dirty[band * tiles + columns[0] as usize / TILE..=band * tiles + columns[1] as usize / TILE]
                        .fill(true);
                }
            }
            Reach::Wide { .. } => dirty.fill(true),
        }
    }
}

/// Takes the pixels of tiles that are marked from a band that was drawn.
fn take_over(depths_m: &mut [f32], drawn: &[f64], width: usize, marks: &[bool]) {
    for (row, drawn) in depths_m.chunks_mut(width).zip(drawn.chunks(width)) {
        let tiles = row.chunks_mut(TILE).zip(drawn.chunks(TILE)).zip(marks);
        for ((tile, drawn), _) in tiles.filter(|(_, dirty)| **dirty) {
            tile.iter_mut().zip(drawn).for_each(|(depth_m, z_m)| *depth_m = rounded(*z_m));
        }
    }
}

/// Whether some bands, drawn whole, are those of the depths.
fn probe(scene: &Scene, depths_m: &[f32]) -> bool {
    let (width, bands) = (scene.width, scene.height.div_ceil(BAND));
    let chosen: Vec<usize> = (0..PROBES.min(bands)).map(|i| (2 * i + 1) * bands / (2 * PROBES.min(bands))).collect();
    let is_same = |own: &mut Band, band: &usize| {
        let drawn = own.draw(scene, *band, |_| true);
        let here = &depths_m[band * BAND * width..][..drawn.len()];
        drawn.iter().zip(here).all(|(z_m, depth_m)| rounded(*z_m).to_bits() == depth_m.to_bits())
    };
    chosen.par_iter().map_init(Band::default, is_same).all(|same| same)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::depth::depth_buffer::draw_rounded;
    use rockface_core::testing::{height_mesh, image_at, small_sensor};
    use std::collections::HashSet;

    fn camera() -> Camera {
        let sensor = rockface_core::artefact::Sensor {
            width_px: 400,
            height_px: 300,
            cx: 199.5,
            cy: 149.5,
            f: 600.0,
            k: [-0.1, 0.02, 0.0, 0.0],
            ..small_sensor()
        };
        Camera::new(&sensor, &image_at("a", [0.3, -0.2, 20.0], [0.02, -0.03, 0.1]))
    }

    /// A face, and the same with a niche of other triangles, its vertices in another order.
    fn meshes() -> [Mesh; 2] {
        let z = |x: f64, y: f64| 0.2 * (3.0 * x).abs() - 0.1 * y * y;
        let before = height_mesh(90, [-9.0, 9.0, -9.0, 9.0], z);
        let mut after = before.clone();
        let inside = |v: [f64; 3]| (v[0] - 1.0).abs() < 1.2 && (v[1] + 0.5).abs() < 0.9;
        after.vertices.iter_mut().filter(|v| inside(**v)).for_each(|v| v[2] -= 0.7);
        let (n, triangles) = (after.vertices.len() as u32, after.triangles.len());
        after.vertices.reverse();
        after.triangles.iter_mut().for_each(|t| *t = t.map(|i| n - 1 - i));
        after.triangles.rotate_left(triangles / 3);
        [before, after]
    }

    fn bits(depths_m: &[f32]) -> Vec<u32> {
        depths_m.iter().map(|z| z.to_bits()).collect()
    }

    #[test]
    fn what_changed_is_found_in_order_too() {
        let [before, _] = meshes();
        let mut after = before.clone();
        let vertex = after.vertices.len() as u32;
        after.vertices.push([0.1, 0.2, -3.0]);
        let fresh = |i: u32| [vertex, i, i + 1];
        after.triangles.splice(100..3200, [fresh(7), fresh(11)]);
        after.triangles.insert(40, fresh(3));
        after.triangles.push(fresh(5));
        let [gone, new] = changed_triangles(&before, &after);
        assert_eq!(gone, (100..3200).collect::<Vec<u32>>());
        assert_eq!(new, [40, 101, 102, after.triangles.len() as u32 - 1]);
    }

    #[test]
    fn what_changed_is_found_whatever_the_order() {
        let [before, after] = meshes();
        let [gone, new] = changed_triangles(&before, &after);
        assert_eq!(gone.len(), new.len());
        assert!((150..400).contains(&new.len()), "{}", new.len());
        assert!(changed_triangles(&before, &before).iter().all(Vec::is_empty));
        let bits = |mesh: &Mesh| (0..mesh.triangles.len() as u32).map(|t| corners(mesh, t)).collect::<HashSet<_>>();
        let (own, theirs) = (bits(&before), bits(&after));
        assert!(gone.iter().all(|t| !theirs.contains(&corners(&before, *t))));
        assert!(new.iter().all(|t| !own.contains(&corners(&after, *t))));
        assert_eq!(gone.len(), own.difference(&theirs).count());
        assert!(gone.is_sorted() && new.is_sorted());
    }

    #[test]
    fn redrawing_a_part_is_drawing_the_whole_bit_for_bit() {
        let [before, after] = meshes();
        for (front_only, safe_border_px, downscale) in [(true, 0.0, 1), (false, 7.0, 1), (true, 0.0, 3)] {
            let window_m = Some([-3.0, 1.4, -4.0, 4.0]);
            let drawing = Drawing { downscale, safe_border_px, front_only, window_m };
            let whole = |mesh: &Mesh| draw_rounded(mesh, &camera(), &drawing);
            let found = redraw([&before, &after], &whole(&before), &camera(), &drawing).unwrap();
            assert_eq!(bits(&found.depths_m), bits(&whole(&after)));
            assert!(found.share < 0.5 && found.share > 0.0, "{}", found.share);
        }
    }

    #[test]
    fn depths_of_something_else_are_found_out() {
        let [before, after] = meshes();
        let drawing = Drawing { downscale: 1, safe_border_px: 0.0, front_only: true, window_m: None };
        let depths = draw_rounded(&before, &camera(), &Drawing { safe_border_px: 3.0, ..drawing });
        assert!(redraw([&before, &after], &depths, &camera(), &drawing).is_none());
        assert!(redraw([&before, &after], &depths[1..], &camera(), &drawing).is_none());
    }
}
