//! Meshes thinned by joining the vertices of each cube of a regular grid in their mean.

use super::left_out;
use rockface_core::artefact::sketch::{BodiesSketch, Body, Shape, Sketch};
use rockface_core::artefact::{Mesh, Meshes};

/// Triangles of an artefact that are shown at most.
const TRIANGLES: usize = 20_000;
/// Parts of an artefact that are shown at most.
const PARTS: usize = 400;
/// Cubes of the grid at most: beyond it cubes are enlarged.
const CUBES: f64 = 4e6;

/// A sketch of one mesh, thinned where it has too many triangles.
pub fn of_mesh(mesh: &Mesh) -> Sketch {
    let origin_m = origin(mesh.vertices.iter());
    let (body, joined) = body("", "", &mesh.vertices, &mesh.triangles, TRIANGLES, origin_m);
    let shown = body.triangles.len();
    let bodies = BodiesSketch { frame: mesh.frame.to_string(), origin_m, bodies: vec![body] };
    let reduced =
        if joined { format!("thinned to {shown} of {} triangles", mesh.triangles.len()) } else { String::new() };
    Sketch { part: String::new(), reduced, shape: Shape::Bodies(bodies) }
}

/// Named meshes; each has an equal share of the budget.
pub fn of_meshes(meshes: &Meshes) -> Sketch {
    let shown = &meshes.parts[..meshes.parts.len().min(PARTS)];
    let origin_m = origin(shown.iter().flat_map(|part| &part.vertices));
    let share = TRIANGLES / shown.len().max(1);
    let made: Vec<(Body, bool)> = shown
        .iter()
        .map(|part| body(&part.name, &part.class, &part.vertices, &part.triangles, share, origin_m))
        .collect();
    let thinned = made.iter().filter(|(_, joined)| *joined).count();
    let mut reduced = left_out("parts", meshes.parts.len(), shown.len());
    if thinned > 0 {
        let and = if reduced.is_empty() { "" } else { "; " };
        reduced.push_str(&format!("{and}{thinned} parts thinned to {share} triangles or fewer"));
    }
    let bodies = made.into_iter().map(|(body, _)| body).collect();
    let shape = Shape::Bodies(BodiesSketch { frame: meshes.frame.to_string(), origin_m, bodies });
    Sketch { part: String::new(), reduced, shape }
}

/// A whole metre near the middle, so that 32-bit coordinates stay exact to micrometres.
fn origin<'a>(vertices: impl Iterator<Item = &'a [f64; 3]>) -> [f64; 3] {
    let Some((low, high)) = extent(vertices) else { return [0.0; 3] };
    [0, 1, 2].map(|axis| (0.5 * (low[axis] + high[axis])).round())
}

type Extent = ([f64; 3], [f64; 3]);

fn extent<'a>(mut vertices: impl Iterator<Item = &'a [f64; 3]>) -> Option<Extent> {
    let first = *vertices.next()?;
    Some(vertices.fold((first, first), |(low, high), v| {
        ([0, 1, 2].map(|i| low[i].min(v[i])), [0, 1, 2].map(|i| high[i].max(v[i])))
    }))
}

/// A mesh with at most `limit` triangles, and whether it had to be thinned for that.
fn body(
    name: &str,
    class: &str,
    vertices: &[[f64; 3]],
    triangles: &[[u32; 3]],
    limit: usize,
    origin_m: [f64; 3],
) -> (Body, bool) {
    let relative = |v: &[f64; 3]| [0, 1, 2].map(|i| (v[i] - origin_m[i]) as f32);
    let (name, class) = (name.to_owned(), class.to_owned());
    if triangles.len() <= limit {
        let body =
            Body { name, class, vertices: vertices.iter().map(relative).collect(), triangles: triangles.to_vec() };
        return (body, false);
    }
    let Some((low, high)) = extent(vertices.iter()) else {
        return (Body { name, class, vertices: Vec::new(), triangles: Vec::new() }, true);
    };
    // A cube is crossed by about its own face of surface, which two triangles cover.
    let mut side_m = (2.0 * area_m2(vertices, triangles) / limit as f64).sqrt();
    loop {
        let cubes = Cubes::new(low, high, side_m);
        let (joined, kept) = join(vertices, triangles, &cubes);
        if kept.len() <= limit {
            let vertices = joined.iter().map(relative).collect();
            return (Body { name, class, vertices, triangles: kept }, true);
        }
        side_m = cubes.side_m * 1.2;
    }
}

/// Sum of the areas of all triangles, square metres.
fn area_m2(vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> f64 {
    let area = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|i| nalgebra::Vector3::from(vertices[i as usize]));
        0.5 * (b - a).cross(&(c - a)).norm()
    };
    triangles.iter().map(area).sum()
}

/// A regular grid of cubes over a box.
struct Cubes {
    low: [f64; 3],
    side_m: f64,
    counts: [usize; 3],
}

impl Cubes {
    fn new(low: [f64; 3], high: [f64; 3], side_m: f64) -> Self {
        let longest = [0, 1, 2].map(|i| high[i] - low[i]).into_iter().fold(0.0, f64::max);
        // No length at all, or not a number: one cube for everything.
        let mut side_m = if side_m > longest * 1e-6 { side_m } else { longest.max(1e-9) };
        let counts = |side_m: f64| [0, 1, 2].map(|i| ((high[i] - low[i]) / side_m).floor() + 1.0);
        while counts(side_m).iter().product::<f64>() > CUBES {
            side_m *= 1.2;
        }
        Self { low, side_m, counts: counts(side_m).map(|count| count as usize) }
    }

    fn at(&self, vertex: &[f64; 3]) -> usize {
        let [x, y, z] = [0, 1, 2].map(|i| (((vertex[i] - self.low[i]) / self.side_m) as usize).min(self.counts[i] - 1));
        (z * self.counts[1] + y) * self.counts[0] + x
    }
}

/// The mean vertex of each cube that has one, and the triangles between different cubes, each once.
fn join(vertices: &[[f64; 3]], triangles: &[[u32; 3]], cubes: &Cubes) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let mut number = vec![u32::MAX; cubes.counts.iter().product()];
    let (mut sums, mut counts) = (Vec::<[f64; 3]>::new(), Vec::<f64>::new());
    let own: Vec<u32> = vertices
        .iter()
        .map(|vertex| {
            let slot = &mut number[cubes.at(vertex)];
            if *slot == u32::MAX {
                *slot = sums.len() as u32;
                sums.push([0.0; 3]);
                counts.push(0.0);
            }
            let (sum, offset) = (&mut sums[*slot as usize], cubes.low);
            (0..3).for_each(|i| sum[i] += vertex[i] - offset[i]);
            counts[*slot as usize] += 1.0;
            *slot
        })
        .collect();
    let mean = |(sum, count): (&[f64; 3], &f64)| [0, 1, 2].map(|i| cubes.low[i] + sum[i] / count);
    let means = sums.iter().zip(&counts).map(mean).collect();
    let mut kept: Vec<[u32; 3]> = triangles
        .iter()
        .map(|triangle| triangle.map(|i| own[i as usize]))
        .filter(|[a, b, c]| a != b && b != c && c != a)
        .map(first_smallest)
        .collect();
    kept.sort_unstable();
    kept.dedup();
    (means, kept)
}

/// The same triangle, turned so that its smallest index comes first.
fn first_smallest([a, b, c]: [u32; 3]) -> [u32; 3] {
    if a <= b && a <= c {
        [a, b, c]
    } else if b <= c {
        [b, c, a]
    } else {
        [c, a, b]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rockface_core::artefact::{Frame, Part};
    use rockface_core::testing::height_mesh;

    fn bodies(sketch: &Sketch) -> &BodiesSketch {
        let Shape::Bodies(bodies) = &sketch.shape else { panic!("bodies") };
        bodies
    }

    #[test]
    fn a_large_mesh_is_thinned_to_its_budget_and_stays_on_the_surface() {
        let mut mesh = height_mesh(200, [-5.0, 5.0, -5.0, 5.0], |x, y| 0.3 * x - 0.2 * y);
        mesh.vertices.iter_mut().for_each(|v| v[0] += 451_000.0);
        let sketch = of_mesh(&mesh);
        assert!(sketch.reduced.ends_with("of 80000 triangles"), "{}", sketch.reduced);
        let shown = bodies(&sketch);
        let body = &shown.bodies[0];
        assert!((5_000..=TRIANGLES).contains(&body.triangles.len()), "{}", body.triangles.len());
        for v in &body.vertices {
            let x = f64::from(v[0]) + shown.origin_m[0] - 451_000.0;
            let (y, z) = (f64::from(v[1]) + shown.origin_m[1], f64::from(v[2]) + shown.origin_m[2]);
            assert!((z - 0.3 * x + 0.2 * y).abs() < 1e-5);
        }
        let normal_z = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|i| nalgebra::Vector3::from(body.vertices[i as usize]));
            (b - a).cross(&(c - a)).z
        };
        assert!(body.triangles.iter().all(|t| normal_z(t) > -1e-6), "triangles keep their outside");
    }

    #[test]
    fn small_meshes_and_empty_ones_are_shown_as_they_are() {
        let mesh = height_mesh(2, [0.0, 1.0, 0.0, 1.0], |_, _| 0.0);
        let sketch = of_mesh(&mesh);
        assert_eq!((sketch.reduced.as_str(), bodies(&sketch).bodies[0].triangles.len()), ("", 8));
        let nothing = Mesh { frame: Frame::Wall, vertices: vec![], triangles: vec![], colours: vec![] };
        assert!(bodies(&of_mesh(&nothing)).bodies[0].vertices.is_empty());
    }

    #[test]
    fn many_parts_share_the_budget() {
        let part = |i: usize| {
            let mesh = height_mesh(10, [0.0, 1.0, 0.0, 1.0], |x, _| x);
            Part { name: i.to_string(), class: String::new(), vertices: mesh.vertices, triangles: mesh.triangles }
        };
        let sketch = of_meshes(&Meshes { frame: Frame::Wall, parts: (0..500).map(part).collect() });
        let total: usize = bodies(&sketch).bodies.iter().map(|body| body.triangles.len()).sum();
        assert!(total <= TRIANGLES && total > TRIANGLES / 8, "{total}");
        assert!(sketch.reduced.starts_with("the first 400 of 500 parts; 400 parts thinned"), "{}", sketch.reduced);
    }
}
