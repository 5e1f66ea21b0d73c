//! Exact nearest points of an organised surface, found through square columns over X and Y.

use nalgebra::Vector3;
use rayon::prelude::*;

use rockface_core::artefact::{Extent, Surface};
use rockface_core::numerics::fast_round::whole;
use rockface_core::numerics::simd::{Work, vectorised};

/// Average number of points of a column: few enough to test all, enough to find one in the first ring.
const POINTS_PER_COLUMN: f64 = 2.0;

/// What rounding may take from a distance, as a share of the side of a column.
const ROUNDING: f64 = 1e-6;

/// Points whose columns a thread finds at a time.
const AT_ONCE: usize = 1 << 13;

/// The place that is nearest to a point, and how far the point may move before another could be.
#[derive(Debug, Clone, Copy, Default)]
pub struct Partner {
    place: Option<usize>,
    /// Where the point was when it was looked for.
    asked: Vector3<f64>,
    /// As long as the point is nearer to there than this, metres, the place stays the nearest.
    free_m: f64,
}

impl Partner {
    /// The place.
    pub fn place(&self) -> Option<usize> {
        self.place
    }
}

/// The points of a surface, sorted into columns.
pub struct Columns<'a> {
    surface: &'a Surface,
    /// Weight of differences in Z: 1 in space, 0 in plan.
    z_weight: f64,
    left: f64,
    bottom: f64,
    side: f64,
    wide: usize,
    high: usize,
    /// Start of each column in `places`, and the end of the last one.
    starts: Vec<u32>,
    /// Places of points in the surface, column by column.
    places: Vec<u32>,
}

impl<'a> Columns<'a> {
    /// Sorts the points; `None` for a surface without points. With `in_plan`, distances are in X and Y only.
    pub fn new(surface: &'a Surface, in_plan: bool) -> Option<Self> {
        let Extent { low, high, count } = surface.extent();
        if count == 0 {
            return None;
        }
        let size = [0, 1].map(|k| f64::from(high[k]) - f64::from(low[k]));
        let side = column_side(size, f64::from(count));
        let [wide, high] = size.map(|s| (s / side) as usize + 1);
        let (left, bottom) = (f64::from(low[0]), f64::from(low[1]));
        let mut columns = Self {
            surface,
            z_weight: if in_plan { 0.0 } else { 1.0 },
            left,
            bottom,
            side,
            wide,
            high,
            starts: vec![0; wide * high + 1],
            places: Vec::new(),
        };
        columns.sort(count as usize);
        Some(columns)
    }

    /// Counting sort, in the order of the surface.
    fn sort(&mut self, count: usize) {
        let mut column = vec![0; self.surface.points.len()];
        let find =
            |(found, points): (&mut [u32], &[[f32; 3]])| vectorised(FindColumns { columns: self, points, found });
        column.par_chunks_mut(AT_ONCE).zip(self.surface.points.par_chunks(AT_ONCE)).for_each(find);
        let filled = || column.iter().enumerate().filter(|(_, c)| **c != u32::MAX);
        let mut next = vec![0u32; self.starts.len()];
        filled().for_each(|(_, c)| next[*c as usize + 1] += 1);
        for i in 1..next.len() {
            next[i] += next[i - 1];
        }
        self.starts.copy_from_slice(&next);
        self.places = vec![0; count];
        for (place, c) in filled() {
            let slot = &mut next[*c as usize];
            self.places[*slot as usize] = place as u32;
            *slot += 1;
        }
    }

    /// Mean distance of neighbouring points if they were spread evenly over X and Y, metres.
    pub fn spacing_m(&self) -> f64 {
        self.side / POINTS_PER_COLUMN.sqrt()
    }

    /// Place of the nearest point within a radius of a point relative to the surface's origin, metres.
    ///
    /// Rings of columns are searched outward until no nearer point can follow: the answer is exact.
    pub fn nearest(&self, point: &Vector3<f64>, radius_m: f64) -> Option<usize> {
        let x = ((point.x - self.left) / self.side).floor();
        let y = ((point.y - self.bottom) / self.side).floor();
        let rings = (radius_m / self.side).ceil();
        // Rings before the first and after the last that meet the columns hold nothing.
        let (right, top) = (self.wide as f64 - 1.0, self.high as f64 - 1.0);
        let first = (-x).max(x - right).max(-y).max(y - top).max(0.0);
        let last = x.abs().max((x - right).abs()).max(y.abs()).max((y - top).abs()).min(rings);
        if !(x.is_finite() && y.is_finite() && first <= last) {
            return None;
        }
        let mut best = (radius_m * radius_m, None);
        for ring in first as i64..=last as i64 {
            self.search_ring([x as i64, y as i64], ring, point, &mut best);
            let reached = ring as f64 * self.side;
            if best.0 <= reached * reached {
                break;
            }
        }
        best.1
    }

    /// [`Columns::nearest`] of a point that moves little by little, from what was found where it was before. A place that was within
    /// the radius may be found although it no longer is.
    pub fn follow(&self, point: &Vector3<f64>, radius_m: f64, partner: &mut Partner) -> Option<usize> {
        if self.square_between(point, &partner.asked) < partner.free_m * partner.free_m {
            return partner.place;
        }
        let within = |bound: &f64| *bound <= radius_m * radius_m;
        let bound = partner.place.map(|place| self.square(point, place)).filter(within);
        let found = bound.and_then(|bound| self.only_within(point, bound));
        *partner = found.unwrap_or_else(|| Partner { place: self.nearest(point, radius_m), ..Partner::default() });
        partner.place
    }

    /// The nearest place, if it is the only one at its distance and no further than a bound, square metres, that a point is known
    /// to keep.
    fn only_within(&self, point: &Vector3<f64>, bound: f64) -> Option<Partner> {
        /// Columns along each side of what is searched; where there are more, rings are faster.
        const WIDEST: usize = 4;
        // A little more, as columns are found by a division.
        let reach = bound.sqrt() + self.side * ROUNDING;
        let span = |at: f64, start: f64, count: usize| {
            let index = |x: f64| (((x - start) / self.side).max(0.0) as usize).min(count - 1);
            (index(at - reach), index(at + reach))
        };
        let (left, right) = span(point.x, self.left, self.wide);
        let (low, high) = span(point.y, self.bottom, self.high);
        if right - left >= WIDEST || high - low >= WIDEST {
            return None;
        }
        let (mut best, mut second, mut found) = (f64::INFINITY, f64::INFINITY, None);
        for row in low..=high {
            let first = row * self.wide;
            let places = self.starts[first + left] as usize..self.starts[first + right + 1] as usize;
            for place in &self.places[places] {
                let square = self.square(point, *place as usize);
                if square < best {
                    (second, best, found) = (best, square, Some(*place as usize));
                } else {
                    second = second.min(square);
                }
            }
        }
        // Which of two at one distance it is depends on the order of the rings.
        let place = found.filter(|_| best < second);
        // Beyond the columns that were searched there may be others.
        let beyond = |at: f64, start: f64, [first, last]: [usize; 2], count: usize| {
            let edge = |column: usize| start + column as f64 * self.side;
            let before = if first == 0 { f64::INFINITY } else { at - edge(first) };
            let after = if last + 1 == count { f64::INFINITY } else { edge(last + 1) - at };
            before.min(after)
        };
        let [across, up] = [
            beyond(point.x, self.left, [left, right], self.wide),
            beyond(point.y, self.bottom, [low, high], self.high),
        ];
        let free_m = 0.5 * (second.sqrt().min(across).min(up) - best.sqrt()) - self.side * ROUNDING;
        place.map(|place| Partner { place: Some(place), asked: *point, free_m: free_m.max(0.0) })
    }

    fn search_ring(&self, [x, y]: [i64; 2], ring: i64, point: &Vector3<f64>, best: &mut (f64, Option<usize>)) {
        let (wide, high) = (self.wide as i64, self.high as i64);
        for row in (y - ring).max(0)..=(y + ring).min(high - 1) {
            if row == y - ring || row == y + ring {
                for column in (x - ring).max(0)..=(x + ring).min(wide - 1) {
                    self.search((row * wide + column) as usize, point, best);
                }
            } else {
                for column in [x - ring, x + ring].into_iter().filter(|column| (0..wide).contains(column)) {
                    self.search((row * wide + column) as usize, point, best);
                }
            }
        }
    }

    /// Square of the distance of a point from a place, square metres.
    #[inline]
    fn square(&self, point: &Vector3<f64>, place: usize) -> f64 {
        self.square_between(&local(self.surface, place), point)
    }

    #[inline]
    fn square_between(&self, one: &Vector3<f64>, other: &Vector3<f64>) -> f64 {
        let d = one - other;
        d.x * d.x + d.y * d.y + self.z_weight * d.z * d.z
    }

    #[inline]
    fn search(&self, column: usize, point: &Vector3<f64>, best: &mut (f64, Option<usize>)) {
        for place in &self.places[self.starts[column] as usize..self.starts[column + 1] as usize] {
            let square = self.square(point, *place as usize);
            if square < best.0 {
                *best = (square, Some(*place as usize));
            }
        }
    }
}

/// Side of a column for so many points over a box; a box without width or height still gets one.
fn column_side([width, height]: [f64; 2], count: f64) -> f64 {
    let by_area = (width * height * POINTS_PER_COLUMN / count).sqrt();
    let by_length = width.max(height) * POINTS_PER_COLUMN / count;
    let side = by_area.max(by_length);
    if side > 0.0 { side } else { 1.0 }
}

/// A point relative to its surface's origin, metres.
#[inline]
pub fn local(surface: &Surface, place: usize) -> Vector3<f64> {
    Vector3::from(surface.points[place].map(f64::from))
}

/// Finds the column of each of some points; of places without a point `u32::MAX`.
struct FindColumns<'a> {
    columns: &'a Columns<'a>,
    points: &'a [[f32; 3]],
    found: &'a mut [u32],
}

impl Work for FindColumns<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let Columns { left, bottom, side, wide, high, .. } = *self.columns;
        let (last, top) = ((wide - 1) as f64, (high - 1) as f64);
        for (found, [x, y, _]) in self.found.iter_mut().zip(self.points) {
            let across = ((f64::from(*x) - left) / side).floor().max(0.0).min(last);
            let up = ((f64::from(*y) - bottom) / side).floor().max(0.0).min(top);
            *found = if x.is_nan() { u32::MAX } else { whole(up * wide as f64 + across) as u32 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::Frame;
    use rockface_core::numerics::random::Key;

    #[test]
    fn the_answer_is_that_of_looking_at_every_point() {
        let noise = Key([9; 32]).field();
        let point = |i: i32| [0, 1, 2].map(|k| (noise.normal(i, k) * [2.0, 1.0, 0.3][k as usize]) as f32);
        let mut points: Vec<[f32; 3]> = (0..900).map(point).collect();
        points[17] = [f32::NAN; 3];
        let surface = Surface {
            frame: Frame::Wall,
            width: 30,
            height: 30,
            origin_m: [0.0; 3],
            points,
            squares: vec![0; 29 * 29],
        };
        let columns = Columns::new(&surface, false).unwrap();
        for i in 0..300 {
            let query = Vector3::new(noise.normal(i, 7), noise.normal(i, 8), noise.normal(i, 9)) * 2.0;
            let distance = |place: usize| (local(&surface, place) - query).norm();
            let everywhere = (0..900).filter(|p| *p != 17).min_by(|a, b| distance(*a).total_cmp(&distance(*b)));
            let within = everywhere.filter(|place| distance(*place) < 1.5);
            assert_eq!(columns.nearest(&query, 1.5), within, "query {i}");
            assert_eq!(columns.nearest(&query, 1e6), everywhere, "query {i}, far");
            let near = Some((i as usize * 3 + 1) % 900).filter(|place| *place != 17);
            for place in [near, everywhere] {
                let mut partner = Partner { place, ..Partner::default() };
                assert_eq!(columns.follow(&query, 1e6, &mut partner), everywhere, "query {i}, from {place:?}");
            }
        }
    }

    #[test]
    fn a_point_that_moves_is_followed() {
        let noise = Key([4; 32]).field();
        let points: Vec<[f32; 3]> =
            (0..900).map(|i| [0, 1, 2].map(|k| (noise.normal(i, k) * [2.0, 1.0, 0.3][k as usize]) as f32)).collect();
        let (frame, squares) = (Frame::Wall, vec![0; 29 * 29]);
        let surface = Surface { frame, width: 30, height: 30, origin_m: [0.0; 3], points, squares };
        for in_plan in [false, true] {
            let columns = Columns::new(&surface, in_plan).unwrap();
            for i in 0..60 {
                let start = Vector3::new(noise.normal(i, 7), noise.normal(i, 8), noise.normal(i, 9));
                let (mut partner, mut kept) = (Partner::default(), 0);
                for step in 0..40 {
                    let point = start + Vector3::new(0.004, -0.003, 0.002) * f64::from(step);
                    let asked = partner.asked;
                    assert_eq!(columns.follow(&point, 3.0, &mut partner), columns.nearest(&point, 3.0), "{i}, {step}");
                    kept += i32::from(step > 0 && partner.asked == asked);
                }
                assert!(kept > 0, "point {i} was looked for in every step");
            }
        }
    }
}
