//! Lines, dots, triangles and filled polygons with soft edges.

use std::ops::Range;

use crate::figure::canvas::{Canvas, Colour};
use rockface_core::artefact::Polygon;

/// A place in the picture, units of its canvas from the left and top edges.
pub type Place = [f64; 2];

/// Fills every pixel within `reach` of the box around two places by how much `cover` says it is covered.
///
/// `cover` takes the middle of a pixel in units and gives in pixels how far within the shape it lies. In each row, whose middle is at `y`, only
/// the pixels between the places that `part` names are looked at.
fn blend(
    canvas: &mut Canvas,
    corners: [Place; 2],
    reach: f64,
    colour: Colour,
    part: impl Fn(f64) -> [f64; 2],
    cover: impl Fn(Place) -> f64,
) {
    let [columns, rows] = covered(canvas, corners, reach);
    let unit = canvas.unit_px();
    for y in rows {
        let middle = (y as f64 + 0.5) / unit;
        let [low, high] = part(middle);
        // A pixel more on each side: `part` is rounded.
        let first = ((unit * low).floor() - 1.0).clamp(columns.start as f64, columns.end as f64) as usize;
        let end = ((unit * high).ceil() + 1.0).clamp(columns.start as f64, columns.end as f64) as usize;
        for x in first..end {
            let share = cover([(x as f64 + 0.5) / unit, middle]).clamp(0.0, 1.0);
            if share > 0.0 {
                canvas.blend(x as f32, y as f32, colour, share as f32);
            }
        }
    }
}

/// The columns and rows of pixels within `reach` of the box around two places.
fn covered(canvas: &Canvas, corners: [Place; 2], reach: f64) -> [Range<usize>; 2] {
    let (unit, size) = (canvas.unit_px(), canvas.size_px());
    [0, 1].map(|axis| {
        let (low, high) = (corners[0][axis].min(corners[1][axis]), corners[0][axis].max(corners[1][axis]));
        let end = size[axis] as f64;
        ((unit * (low - reach)).floor().clamp(0.0, end) as usize)
            ..((unit * (high + reach)).ceil() + 1.0).clamp(0.0, end) as usize
    })
}

/// A line of a width in units.
pub fn line(canvas: &mut Canvas, from: Place, to: Place, width: f64, colour: Colour) {
    let along = [to[0] - from[0], to[1] - from[1]];
    let (squared, unit) = (along[0] * along[0] + along[1] * along[1], canvas.unit_px());
    // How far the stroke reaches to either side, and the part of the line that is so near to a row.
    let reach = 0.5 * width + 0.5 / unit;
    let part = |y: f64| {
        let at = |y: f64| ((y - from[1]) / along[1]).clamp(0.0, 1.0);
        let shares = if along[1].abs() > 0.0 { [at(y - reach), at(y + reach)] } else { [0.0, 1.0] };
        let [a, b] = shares.map(|share| from[0] + share * along[0]);
        [a.min(b) - reach, a.max(b) + reach]
    };
    blend(canvas, [from, to], width, colour, part, |[x, y]| {
        let at = [x - from[0], y - from[1]];
        let share = if squared > 0.0 { ((at[0] * along[0] + at[1] * along[1]) / squared).clamp(0.0, 1.0) } else { 0.0 };
        let off = [at[0] - share * along[0], at[1] - share * along[1]];
        unit * (0.5 * width - (off[0] * off[0] + off[1] * off[1]).sqrt()) + 0.5
    });
}

/// A line of dashes of 7 units and gaps of 5.
pub fn dashes(canvas: &mut Canvas, from: Place, to: Place, width: f64, colour: Colour) {
    let along = [to[0] - from[0], to[1] - from[1]];
    let length = (along[0] * along[0] + along[1] * along[1]).sqrt();
    let at = |distance: f64| {
        let share = (distance / length).min(1.0);
        [from[0] + share * along[0], from[1] + share * along[1]]
    };
    for dash in 0..(length / 12.0).ceil() as usize {
        let start = 12.0 * dash as f64;
        line(canvas, at(start), at(start + 7.0), width, colour);
    }
}

/// A dot with a thin rim.
pub fn dot(canvas: &mut Canvas, at: Place, radius: f64, colour: Colour) {
    let distance = |[x, y]: Place| ((x - at[0]) * (x - at[0]) + (y - at[1]) * (y - at[1])).sqrt();
    let (unit, reach) = (canvas.unit_px(), radius + 2.0);
    let all = |_| [at[0] - reach, at[0] + reach];
    let rim = |place| 0.8 * (unit * (radius + 0.8 - distance(place)) + 0.5);
    blend(canvas, [at, at], reach, super::INK, all, rim);
    blend(canvas, [at, at], reach, colour, all, |place| unit * (radius - distance(place)) + 0.5);
}

/// Fills a polygon by the even-odd rule of its rings, given in units, with so much of the colour.
///
/// Each edge is looked at once in each row of pixels that it crosses.
pub fn fill(canvas: &mut Canvas, polygon: &Polygon, colour: Colour, strength: f64) {
    let points = || polygon.exterior.iter();
    let corner = |pick: fn(f64, f64) -> f64, start: f64| -> Place {
        points().fold([start, start], |found, point| [pick(found[0], point[0]), pick(found[1], point[1])])
    };
    if polygon.exterior.is_empty() {
        return;
    }
    let corners = [corner(f64::min, f64::INFINITY), corner(f64::max, f64::NEG_INFINITY)];
    let [columns, rows] = covered(canvas, corners, 0.0);
    let unit = canvas.unit_px();
    let middles = |range: &Range<usize>| range.clone().map(|at| (at as f64 + 0.5) / unit).collect::<Vec<f64>>();
    let (across, down) = (middles(&columns), middles(&rows));
    // Of each row, before how many of its pixels an odd number of edges cross it.
    let width = across.len() + 1;
    let mut turns = vec![false; width * down.len()];
    for (a, b) in std::iter::once(&polygon.exterior).chain(&polygon.holes).flat_map(|ring| edges(ring)) {
        let (low, high) = (a[1].min(b[1]), a[1].max(b[1]));
        let crossed = down.partition_point(|y| *y < low)..down.partition_point(|y| *y < high);
        for row in crossed {
            let x = a[0] + (down[row] - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
            turns[row * width + across.partition_point(|middle| *middle < x)] ^= true;
        }
    }
    for (y, turns) in rows.zip(turns.chunks(width)) {
        let mut within = false;
        for (x, turn) in columns.clone().zip(&turns[1..]).rev() {
            within ^= *turn;
            if within {
                canvas.blend(x as f32, y as f32, colour, strength.clamp(0.0, 1.0) as f32);
            }
        }
    }
}

/// The edges of a ring, the last one back to its first place.
fn edges(ring: &[Place]) -> impl Iterator<Item = (Place, Place)> {
    ring.iter().copied().zip(ring.iter().copied().cycle().skip(1))
}

/// Draws the rings of a polygon given in units.
pub fn outline(canvas: &mut Canvas, polygon: &Polygon, width: f64, colour: Colour) {
    for ring in std::iter::once(&polygon.exterior).chain(&polygon.holes) {
        for (from, to) in edges(ring) {
            line(canvas, from, to, width, colour);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polygon_is_filled_but_for_its_holes() {
        let square = |low: f64, high: f64| vec![[low, low], [high, low], [high, high], [low, high]];
        let polygon = Polygon { exterior: square(2.0, 12.0), holes: vec![square(5.0, 8.0)] };
        let mut canvas = Canvas::new(20, 20);
        fill(&mut canvas, &polygon, [0; 3], 1.0);
        let mut dark = 0;
        for i in 0..400 {
            dark += usize::from(canvas.pixel(i % 20, i / 20).is_some_and(|pixel| pixel[0] == 0));
        }
        assert_eq!(dark, 100 - 9);
    }

    #[test]
    fn lines_and_dots_reach_their_places_and_may_leave_the_picture() {
        let mut canvas = Canvas::new(20, 20);
        line(&mut canvas, [-5.0, 10.5], [30.0, 10.5], 1.0, [0; 3]);
        assert!((0..20).all(|x| canvas.pixel(x, 10).is_some_and(|pixel| pixel[0] == 0)));
        dot(&mut canvas, [5.0, 5.0], 2.0, [9, 9, 9]);
        assert_eq!(canvas.pixel(4, 4), Some(&mut [9, 9, 9]));
        dashes(&mut canvas, [0.0, 0.0], [0.0, 0.0], 1.0, [0; 3]);
    }

    /// Whether a place is within rings, edge by edge: what `fill` did at every pixel before it went by rows.
    fn rings_hold(rings: &[&Vec<Place>], [x, y]: Place) -> bool {
        let crosses =
            |(a, b): &(Place, Place)| (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
        rings.iter().map(|ring| edges(ring).filter(crosses).count()).sum::<usize>() % 2 == 1
    }

    /// Places in and around a picture of 40 by 30 units, some of them in the middle of a pixel.
    fn places(count: usize, state: &mut u32) -> Vec<Place> {
        let mut next = |span: f64| {
            *state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let value = f64::from(*state >> 8) / f64::from(1 << 24) * (span + 20.0) - 10.0;
            if *state & 0x800 == 0 { value.round() + 0.25 } else { value }
        };
        (0..count).map(|_| [next(40.0), next(30.0)]).collect()
    }

    #[test]
    fn rows_of_edges_fill_what_every_pixel_by_itself_is_found_in() {
        let mut state = 7;
        for corners in [3, 4, 7, 30, 200] {
            let polygon = Polygon { exterior: places(corners, &mut state), holes: vec![places(5, &mut state)] };
            let mut canvas = Canvas::in_units(40, 30, 2.0);
            fill(&mut canvas, &polygon, [0; 3], 1.0);
            let rings = [&polygon.exterior, &polygon.holes[0]];
            let axis = |axis: usize| polygon.exterior.iter().map(move |place| place[axis]);
            let [columns, rows] = covered(
                &canvas,
                [
                    [axis(0).fold(f64::INFINITY, f64::min), axis(1).fold(f64::INFINITY, f64::min)],
                    [axis(0).fold(f64::NEG_INFINITY, f64::max), axis(1).fold(f64::NEG_INFINITY, f64::max)],
                ],
                0.0,
            );
            for (x, y) in (0..60).flat_map(|y| (0..80).map(move |x| (x, y))) {
                let middle = [x, y].map(|at: usize| (at as f64 + 0.5) / canvas.unit_px());
                let within = columns.contains(&x) && rows.contains(&y) && rings_hold(&rings, middle);
                assert_eq!(canvas.pixel(x, y), Some(&mut [if within { 0 } else { 255 }; 3]), "{corners} {x} {y}");
            }
        }
    }

    #[test]
    fn a_line_is_looked_for_in_its_rows_only_and_loses_no_pixel() {
        let mut state = 11;
        let ends = places(200, &mut state);
        for ends in ends.chunks(2) {
            let (mut canvas, mut all) = (Canvas::in_units(40, 30, 2.0), Canvas::in_units(40, 30, 2.0));
            line(&mut canvas, ends[0], ends[1], 1.6, [0; 3]);
            let along = [ends[1][0] - ends[0][0], ends[1][1] - ends[0][1]];
            let squared = along[0] * along[0] + along[1] * along[1];
            blend(
                &mut all,
                [ends[0], ends[1]],
                1.6,
                [0; 3],
                |_| [-10.0, 50.0],
                |[x, y]| {
                    let at = [x - ends[0][0], y - ends[0][1]];
                    let share = ((at[0] * along[0] + at[1] * along[1]) / squared).clamp(0.0, 1.0);
                    let off = [at[0] - share * along[0], at[1] - share * along[1]];
                    2.0 * (0.8 - (off[0] * off[0] + off[1] * off[1]).sqrt()) + 0.5
                },
            );
            assert!(canvas == all, "{ends:?}");
        }
    }
}
