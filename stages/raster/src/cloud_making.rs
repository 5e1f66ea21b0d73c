//! Point clouds out of meshes, surfaces and clouds: their points with normals, where each came from, and labels of a raster.

use nalgebra::Vector3;

use crate::frame_change::FrameChange;
use crate::shape::Shape;
use rockface_core::artefact::{Cloud, Raster};

/// The points of a shape at every so many places, moved to another frame.
///
/// `id` is the place of a point: the number of a vertex, `row x width + column` in a surface, the position in a cloud; a
/// cloud's own `id` stays. With `labels` `label` is the value of its cell under the point, before it is moved, 0 beside the
/// raster or where it has none; with `measured` the value of its cell goes by the raster's quantity, NaN where there is none. Normals are the sums of the triangles' about a point by area; those of a cloud are its own.
pub fn cloud_of(
    shape: Shape,
    step: usize,
    labels: Option<&Raster>,
    measured: Option<&Raster>,
    change: &FrameChange,
) -> Cloud {
    let places: Vec<usize> =
        taken(shape, step).into_iter().filter(|at| shape.point(*at, None)[0].is_finite()).collect();
    let turned =
        |normal: [f32; 3]| change.moved.map_or(normal, |moved| moved.turn(normal.map(f64::from)).map(|x| x as f32));
    let normals = normals(shape);
    let mut cloud = Cloud::new(change.frame, Vec::new());
    cloud.points = places.iter().map(|at| shape.point(*at, change.moved.as_ref())).collect();
    if !normals.is_empty() {
        cloud.normals = places.iter().map(|at| turned(normals[*at])).collect();
    }
    let colours = colours(shape);
    if !colours.is_empty() {
        cloud.colours = places.iter().map(|at| colours[*at]).collect();
    }
    cloud.numbers.insert("id".to_owned(), places.iter().map(|at| *at as u32).collect());
    if let Shape::Cloud(own) = shape {
        for (name, values) in &own.numbers {
            cloud.numbers.insert(name.clone(), places.iter().map(|at| values[*at]).collect());
        }
        for (name, values) in &own.values {
            cloud.values.insert(name.clone(), places.iter().map(|at| values[*at]).collect());
        }
    }
    let under = |raster: &Raster, at: &usize| value_under(raster, shape.point(*at, None));
    if let Some(raster) = labels {
        let label = |at: &usize| under(raster, at).filter(|value| *value > 0.0).map_or(0, |value| value as u32);
        cloud.numbers.insert("label".to_owned(), places.iter().map(label).collect());
    }
    if let Some(raster) = measured {
        let values = places.iter().map(|at| under(raster, at).unwrap_or(f32::NAN)).collect();
        cloud.values.insert(name_of(raster), values);
    }
    cloud
}

/// Every so many rows and columns of a surface, every so many vertices or points.
fn taken(shape: Shape, step: usize) -> Vec<usize> {
    match shape {
        Shape::Surface(surface) => {
            let row = |row: usize| (0..surface.width).step_by(step).map(move |column| row * surface.width + column);
            (0..surface.height).step_by(step).flat_map(row).collect()
        }
        _ => (0..shape.places()).step_by(step).collect(),
    }
}

fn colours(shape: Shape<'_>) -> &[[u8; 3]] {
    match shape {
        Shape::Mesh(mesh) | Shape::Part(mesh, _) => &mesh.colours,
        Shape::Cloud(cloud) => &cloud.colours,
        Shape::Surface(_) => &[],
    }
}

/// Unit normal at each place, zero where no triangle meets it; none where there are no triangles at all.
fn normals(shape: Shape) -> Vec<[f32; 3]> {
    if let Shape::Cloud(cloud) = shape {
        return cloud.normals.clone();
    }
    let mut sums = vec![[0.0f32; 3]; shape.places()];
    let mut any = false;
    for strip in 0..shape.strips() {
        shape.for_each_triangle(strip, |corners| {
            any = true;
            let [a, b, c] = corners.map(|at| Vector3::from(shape.point(at, None)));
            let across = (b - a).cross(&(c - a));
            for at in corners {
                (0..3).for_each(|axis| sums[at][axis] += across[axis] as f32);
            }
        });
    }
    if !any {
        return Vec::new();
    }
    let unit = |sum: &mut [f32; 3]| {
        let length = Vector3::from(*sum).map(f64::from).norm();
        *sum = if length > 0.0 { sum.map(|x| (f64::from(x) / length) as f32) } else { [0.0; 3] };
    };
    sums.iter_mut().for_each(unit);
    sums
}

/// The quantity of a raster as the name of a property: lower-case letters, digits and `_`, and none of its own meaning.
fn name_of(raster: &Raster) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '_' };
    let name: String = raster.quantity.chars().map(plain).collect();
    let is_taken =
        ["x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "id", "label", ""].contains(&name.as_str());
    if is_taken { format!("{name}_value") } else { name }
}

/// The value of the cell that a point is in; `None` beside the raster and where it has none.
fn value_under(raster: &Raster, [x, y, _]: [f64; 3]) -> Option<f32> {
    raster.grid.cell_of([x, y]).map(|cell| raster.bands[0].values[cell]).filter(|value| value.is_finite())
}

#[cfg(test)]
#[allow(clippy::float_cmp)] // to the bit
mod tests {
    use super::*;
    use crate::frame_change;
    use rockface_core::artefact::{Frame, Grid, Transform};
    use rockface_core::testing::height_mesh;

    #[test]
    fn points_come_with_normals_ids_and_labels() {
        let mesh = height_mesh(4, [0.0, 4.0, 0.0, 4.0], |x, _| x);
        let grid = Grid { columns: 2, rows: 4, cell_m: 1.0, left_m: 2.5, top_m: 4.0 };
        let labels = Raster::single(grid, Frame::Wall, "labels", "labels", vec![7.0; 8]);
        let change = Raster { quantity: "difference".into(), ..labels.clone() };
        let quarter = nalgebra::Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        let (origin, none) = (Vector3::new(1e6, 0.0, 0.0), Vector3::zeros());
        let wall_from_world = Transform::new("world", "wall", &quarter, origin, none);
        let back = frame_change::change(Frame::Wall, Some(&wall_from_world)).unwrap();
        let cloud = cloud_of(Shape::Mesh(&mesh), 3, Some(&labels), Some(&change), &back);
        assert_eq!((cloud.frame, cloud.points.len()), (Frame::World, 9));
        assert_eq!(cloud.numbers["id"], [0, 3, 6, 9, 12, 15, 18, 21, 24]);
        // Vertex 3 is (3, 0, 3) on the wall: (y, -x, z) there is (x - 1e6, y, z) of the world.
        assert_eq!(cloud.points[1], [1e6, -3.0, 3.0]);
        assert_eq!(cloud.numbers["label"], [0, 0, 0, 7, 0, 0, 7, 0, 7]);
        let values = cloud.values["difference"].iter().map(|value| if value.is_nan() { 0.0 } else { *value });
        assert_eq!(values.collect::<Vec<_>>(), [0.0, 0.0, 0.0, 7.0, 0.0, 0.0, 7.0, 0.0, 7.0]);
        assert!(cloud.values["difference"][0].is_nan());
        let slope = 0.5f32.sqrt();
        for normal in &cloud.normals {
            assert!(
                (normal[0] - 0.0).abs() < 1e-6 && (normal[1] - slope).abs() < 1e-6 && (normal[2] - slope).abs() < 1e-6
            );
        }
        let again = cloud_of(Shape::Cloud(&cloud), 2, None, None, &frame_change::change(Frame::World, None).unwrap());
        assert_eq!((again.numbers["id"].as_slice(), again.normals.len()), (&[0, 6, 12, 18, 24][..], 5));
    }
}
