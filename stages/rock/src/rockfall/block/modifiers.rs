//! The modifiers: scaling, rotation, roughness, noise, skew, subdivision, convex hull.

use super::draw::Drawing;
use super::hull::hull;
use super::{BlockError, Solid, V, remesh, squared_distance, subdivide};
use nalgebra::{Matrix3, Vector3};
use rockface_core::artefact::candidates::{Modifier, Noise, Rotate, Roughness, Scale, Skew};
use rockface_core::numerics::portable_math;

/// Applies one modifier; `name` tells its draws from those of its neighbours in the list.
pub fn apply(solid: &mut Solid, modifier: &Modifier, name: &str, drawing: &mut Drawing) -> Result<(), BlockError> {
    match modifier {
        Modifier::Scale(scale) => scale_by(solid, scale, name, drawing),
        Modifier::Rotate(rotate) => rotate_by(solid, rotate, name, drawing),
        Modifier::Tumble(_) => {
            let turn = any_rotation(name, drawing);
            solid.map(|v| (turn * Vector3::from(v)).into());
            Ok(())
        }
        Modifier::Roughness(roughness) => roughen(solid, roughness, name, drawing),
        Modifier::Noise(noise) => shake(solid, noise, name, drawing),
        Modifier::Skew(skew) => shear(solid, skew, name, drawing),
        Modifier::Subdivide(subdivide) => refine(solid, subdivide.edge_m),
        Modifier::Remesh(remesh) => {
            if remesh::to_edge(solid, remesh.edge_m) {
                Ok(())
            } else {
                Err(BlockError::TooFine { edge_m: remesh.edge_m })
            }
        }
        Modifier::ConvexHull(_) => {
            *solid = hull(&solid.vertices).ok_or(BlockError::Flat)?;
            Ok(())
        }
    }
}

/// Cuts a block up to an edge.
pub fn refine(solid: &mut Solid, edge_m: f64) -> Result<(), BlockError> {
    if subdivide::to_edge(solid, edge_m) { Ok(()) } else { Err(BlockError::TooFine { edge_m }) }
}

fn scale_by(solid: &mut Solid, scale: &Scale, name: &str, drawing: &mut Drawing) -> Result<(), BlockError> {
    let factor = drawing.value(&format!("{name}.factor"), &scale.factor)?;
    let x = drawing.value(&format!("{name}.x"), &scale.x)?;
    let y = drawing.value(&format!("{name}.y"), &scale.y)?;
    let z = drawing.value(&format!("{name}.z"), &scale.z)?;
    solid.map(|v| [v[0] * factor * x, v[1] * factor * y, v[2] * factor * z]);
    Ok(())
}

fn rotate_by(solid: &mut Solid, rotate: &Rotate, name: &str, drawing: &mut Drawing) -> Result<(), BlockError> {
    let x = drawing.value(&format!("{name}.x_deg"), &rotate.x_deg)?;
    let y = drawing.value(&format!("{name}.y_deg"), &rotate.y_deg)?;
    let z = drawing.value(&format!("{name}.z_deg"), &rotate.z_deg)?;
    let turns = [(0, x), (1, y), (2, z)].map(|(axis, degrees)| about(axis, degrees));
    solid.map(|v| turns.iter().fold(Vector3::from(v), |v, turn| turn * v).into());
    Ok(())
}

/// The rotation about one axis.
fn about(axis: usize, angle_deg: f64) -> Matrix3<f64> {
    let (sin, cos) = portable_math::sincos(angle_deg.to_radians());
    let (j, k) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut turn = Matrix3::identity();
    (turn[(j, j)], turn[(j, k)], turn[(k, j)], turn[(k, k)]) = (cos, -sin, sin, cos);
    turn
}

/// A rotation of uniformly distributed orientation: a unit quaternion of four normal draws.
fn any_rotation(name: &str, drawing: &mut Drawing) -> Matrix3<f64> {
    let four = [0, 1, 2, 3].map(|i| drawing.normal(&format!("{name}.{i}")));
    let length = four.iter().map(|q| q * q).sum::<f64>().sqrt();
    let [w, x, y, z] = four.map(|q| q / length);
    for (part, value) in ["w", "x", "y", "z"].iter().zip([w, x, y, z]) {
        drawing.note(&format!("{name}.{part}"), value);
    }
    #[rustfmt::skip]
    let turn = Matrix3::new(
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w),
        2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w),
        2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y),
    );
    turn
}

fn roughen(solid: &mut Solid, rough: &Roughness, name: &str, drawing: &mut Drawing) -> Result<(), BlockError> {
    if let Some(edge_m) = rough.edge_m {
        refine(solid, edge_m)?;
    }
    let sigma_m = drawing.value(&format!("{name}.sigma_m"), &rough.sigma_m)?;
    let field = drawing.key(name).field();
    let white: Vec<f64> = (0..solid.vertices.len()).map(|i| field.normal(i as i32, 0)).collect();
    let moves =
        if rough.correlation_m > 0.0 { correlated(&solid.vertices, &white, rough.correlation_m) } else { white };
    let normals = solid.vertex_normals();
    for ((vertex, normal), z) in solid.vertices.iter_mut().zip(normals).zip(moves) {
        *vertex = (Vector3::from(*vertex) + normal * (sigma_m * z)).into();
    }
    Ok(())
}

/// Standard normal draws whose correlation falls to 1 / e over `length_m`: a moving average with Gaussian weights of half
/// that width, scaled to unit variance at every vertex.
fn correlated(vertices: &[V], white: &[f64], length_m: f64) -> Vec<f64> {
    let width = 0.5 * length_m;
    let reach = 16.0 * width * width;
    let average = |at: &V| {
        let (mut sum, mut squares) = (0.0, 0.0);
        for (other, z) in vertices.iter().zip(white) {
            let apart = squared_distance(*at, *other);
            if apart < reach {
                let weight = portable_math::exp(-0.5 * apart / (width * width));
                (sum, squares) = (sum + weight * z, squares + weight * weight);
            }
        }
        sum / squares.sqrt()
    };
    vertices.iter().map(average).collect()
}

fn shake(solid: &mut Solid, noise: &Noise, name: &str, drawing: &mut Drawing) -> Result<(), BlockError> {
    let sigma_m = drawing.value(&format!("{name}.sigma_m"), &noise.sigma_m)?;
    let field = drawing.key(name).field();
    for (i, vertex) in solid.vertices.iter_mut().enumerate() {
        *vertex = std::array::from_fn(|axis| vertex[axis] + sigma_m * field.normal(i as i32, axis as i32));
    }
    Ok(())
}

fn shear(solid: &mut Solid, skew: &Skew, name: &str, drawing: &mut Drawing) -> Result<(), BlockError> {
    let mut share = |part: &str, quantity| drawing.value(&format!("{name}.{part}"), quantity);
    #[rustfmt::skip]
    let shear = Matrix3::new(
        1.0, share("xy", &skew.xy)?, share("xz", &skew.xz)?,
        share("yx", &skew.yx)?, 1.0, share("yz", &skew.yz)?,
        share("zx", &skew.zx)?, share("zy", &skew.zy)?, 1.0,
    );
    // A shear that turns the block inside out is none.
    if shear.determinant() <= 0.0 {
        return Err(BlockError::Inverted);
    }
    solid.map(|v| (shear * Vector3::from(v)).into());
    Ok(())
}
