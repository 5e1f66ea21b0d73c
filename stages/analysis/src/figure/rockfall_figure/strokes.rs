//! Lines, dots, triangles and filled polygons with soft edges.

use crate::figure::canvas::{Canvas, Colour};
use rockface_core::artefact::Polygon;

/// A place in the picture, units of its canvas from the left and top edges.
pub type Place = [f64; 2];

/// Fills every pixel within `reach` of the box around two places by how much `cover` says it is covered.
///
/// `cover` takes the middle of a pixel in units and gives in pixels how far within the shape it lies.
fn blend(canvas: &mut Canvas, corners: [Place; 2], reach: f64, colour: Colour, cover: impl Fn(Place) -> f64) {
    let (unit, size) = (canvas.unit_px(), canvas.size_px());
    let range = |axis: usize| {
        let (low, high) = (corners[0][axis].min(corners[1][axis]), corners[0][axis].max(corners[1][axis]));
        let end = size[axis] as f64;
        ((unit * (low - reach)).floor().clamp(0.0, end) as usize)
            ..((unit * (high + reach)).ceil() + 1.0).clamp(0.0, end) as usize
    };
    for y in range(1) {
        for x in range(0) {
            let share = cover([(x as f64 + 0.5) / unit, (y as f64 + 0.5) / unit]).clamp(0.0, 1.0);
            if share > 0.0 {
                canvas.blend(x as f32, y as f32, colour, share as f32);
            }
        }
    }
}

/// A line of a width in units.
pub fn line(canvas: &mut Canvas, from: Place, to: Place, width: f64, colour: Colour) {
    let along = [to[0] - from[0], to[1] - from[1]];
    let (squared, unit) = (along[0] * along[0] + along[1] * along[1], canvas.unit_px());
    blend(canvas, [from, to], width, colour, |[x, y]| {
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
    let unit = canvas.unit_px();
    blend(canvas, [at, at], radius + 2.0, super::INK, |place| 0.8 * (unit * (radius + 0.8 - distance(place)) + 0.5));
    blend(canvas, [at, at], radius + 2.0, colour, |place| unit * (radius - distance(place)) + 0.5);
}

/// Fills a polygon by the even-odd rule of its rings, given in units, with so much of the colour.
pub fn fill(canvas: &mut Canvas, polygon: &Polygon, colour: Colour, strength: f64) {
    let rings: Vec<&Vec<Place>> = std::iter::once(&polygon.exterior).chain(&polygon.holes).collect();
    let points = || polygon.exterior.iter();
    let corner = |pick: fn(f64, f64) -> f64, start: f64| -> Place {
        points().fold([start, start], |found, point| [pick(found[0], point[0]), pick(found[1], point[1])])
    };
    if polygon.exterior.is_empty() {
        return;
    }
    let corners = [corner(f64::min, f64::INFINITY), corner(f64::max, f64::NEG_INFINITY)];
    blend(canvas, corners, 0.0, colour, |place| if rings_hold(&rings, place) { strength } else { 0.0 });
}

fn rings_hold(rings: &[&Vec<Place>], [x, y]: Place) -> bool {
    let crosses =
        |(a, b): (&Place, &Place)| (a[1] > y) != (b[1] > y) && x < a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]);
    let count = |ring: &&Vec<Place>| ring.iter().zip(ring.iter().cycle().skip(1)).filter(|edge| crosses(*edge)).count();
    rings.iter().map(count).sum::<usize>() % 2 == 1
}

/// Draws the rings of a polygon given in units.
pub fn outline(canvas: &mut Canvas, polygon: &Polygon, width: f64, colour: Colour) {
    for ring in std::iter::once(&polygon.exterior).chain(&polygon.holes) {
        for (from, to) in ring.iter().zip(ring.iter().cycle().skip(1)) {
            line(canvas, *from, *to, width, colour);
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
}
