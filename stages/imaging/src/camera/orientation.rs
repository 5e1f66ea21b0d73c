//! Rigid transformation of image blocks and their covariance from one frame to another.

use nalgebra::{Matrix3, Point3, Rotation3, UnitQuaternion, Vector3};

use rockface_core::artefact::{Cameras, Covariance, Frame, Image, Transform};
use rockface_core::{StageError, fail};

/// Transforms an image block to another frame: `C' = T(C)`, `R' = R T^T` with T the rotation of `transform`.
///
/// Camera coordinates, and so all pixels, do not change. The identity keeps every bit.
#[must_use]
pub fn cameras_to_frame(cameras: &Cameras, transform: &Transform, to: Frame) -> Cameras {
    let mut moved = Cameras { frame: to, ..cameras.clone() };
    if !transform.is_identity() {
        let back = quaternion(&transform.matrix()).inverse();
        moved.images.iter_mut().for_each(|image| move_image(image, transform, &back));
    }
    moved
}

fn move_image(image: &mut Image, transform: &Transform, back: &UnitQuaternion<f64>) {
    image.centre_m = transform.apply(&Point3::from(image.centre_m)).coords.into();
    image.set_rotation(&(image.rotation() * back));
}

/// The unit quaternion of a rotation matrix.
pub fn quaternion(rotation: &Matrix3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(*rotation))
}

/// Transforms a joint covariance to another frame: `J Sigma J^T` with J the rotation on each image's X, Y, Z.
///
/// Corrections of rotations are in the camera frame, those of interior orientation in the image: neither changes.
/// The identity keeps every bit.
///
/// # Errors
///
/// When the matrix does not fit its parameters, or an image has some of X, Y, Z but not all three.
pub fn covariance_to_frame(
    covariance: &Covariance,
    transform: &Transform,
    to: Frame,
) -> Result<Covariance, StageError> {
    check_size(covariance)?;
    let mut moved = Covariance { frame: to, ..covariance.clone() };
    if transform.is_identity() {
        return Ok(moved);
    }
    let rotation = transform.matrix();
    turn_positions(&mut moved, |_| rotation)?;
    Ok(moved)
}

/// Turns X, Y and Z of each image of a joint covariance, all of whose rows have their columns, by the rotation for its name.
///
/// # Errors
///
/// When an image has some of X, Y, Z but not all three.
pub fn turn_positions(covariance: &mut Covariance, of: impl Fn(&str) -> Matrix3<f64>) -> Result<(), StageError> {
    for block in position_blocks(&covariance.parameters)? {
        let image = covariance.parameters[block[0]].rsplit_once('.').map_or("", |(image, _)| image);
        let rotation = of(image);
        rotate_rows(&mut covariance.matrix, &rotation, block);
        rotate_columns(&mut covariance.matrix, &rotation, block);
    }
    mirror(&mut covariance.matrix);
    Ok(())
}

/// Checks that the matrix of a covariance has a row and a column for each of its parameters.
pub fn check_size(covariance: &Covariance) -> Result<(), StageError> {
    let n = covariance.parameters.len();
    if covariance.matrix.len() != n {
        fail!("covariance: {n} parameters but {} rows", covariance.matrix.len());
    }
    for (row, name) in covariance.matrix.iter().zip(&covariance.parameters) {
        if row.len() != n {
            fail!("covariance: the row of `{name}` has {} values, {n} parameters need {n}", row.len());
        }
    }
    Ok(())
}

/// Positions of X, Y and Z of each image among the parameters.
fn position_blocks(parameters: &[String]) -> Result<Vec<[usize; 3]>, StageError> {
    let mut images: Vec<&str> = Vec::new();
    for name in parameters {
        if let Some((image, "X" | "Y" | "Z")) = name.rsplit_once('.')
            && !images.contains(&image)
        {
            images.push(image);
        }
    }
    let place = |image: &str, axis: &str| parameters.iter().position(|p| *p == format!("{image}.{axis}"));
    let all_three = |image: &&str| Some([place(image, "X")?, place(image, "Y")?, place(image, "Z")?]);
    images.iter().map(|image| all_three(image).ok_or_else(|| incomplete(image))).collect()
}

fn incomplete(image: &str) -> StageError {
    StageError::new(format!("covariance: image `{image}` has only some of its parameters X, Y, Z"))
        .hint("a rotation mixes the three: give all of them (a fixed one has zeros in its row and column)")
}

fn rotate_rows(matrix: &mut [Vec<f64>], rotation: &Matrix3<f64>, block: [usize; 3]) {
    let rows = block.map(|i| matrix[i].clone());
    for (k, i) in block.into_iter().enumerate() {
        let from = |column: usize| {
            rotation.row(k).transpose().dot(&Vector3::new(rows[0][column], rows[1][column], rows[2][column]))
        };
        matrix[i] = (0..rows[k].len()).map(from).collect();
    }
}

fn rotate_columns(matrix: &mut [Vec<f64>], rotation: &Matrix3<f64>, block: [usize; 3]) {
    for row in matrix {
        let turned = rotation * Vector3::from(block.map(|i| row[i]));
        for (k, i) in block.into_iter().enumerate() {
            row[i] = turned[k];
        }
    }
}

/// Copies the upper triangle to the lower, so that rounding does not make the matrix asymmetric.
fn mirror(matrix: &mut [Vec<f64>]) {
    for i in 1..matrix.len() {
        let (above, rest) = matrix.split_at_mut(i);
        for (value, row) in rest[0].iter_mut().zip(above.iter()) {
            *value = row[i];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::model::Camera;
    use rockface_core::artefact::Sensor;

    fn turn() -> Transform {
        let rotation = Rotation3::from_euler_angles(0.4, -1.1, 2.3).into_inner();
        Transform::new("world", "wall", &rotation, Vector3::new(451_234.5, 5_512_345.25, 231.0), Vector3::zeros())
    }

    fn block() -> Cameras {
        let image = |name: &str, w: f64, x: f64, centre_m| Image {
            name: name.into(),
            sensor: 0,
            camera_from_object: {
                let q = UnitQuaternion::from_euler_angles(w, x, 0.1).into_inner();
                [q.w, q.i, q.j, q.k]
            },
            centre_m,
        };
        let sensor = Sensor {
            name: "cam".into(),
            width_px: 1900,
            height_px: 1600,
            f: 4545.3,
            cx: 956.8,
            cy: 795.4,
            b1: 0.0,
            b2: 0.0,
            k: [-0.081, 0.115, 0.0, 0.0],
            p: [0.000_31, -0.000_17],
        };
        let near = [451_240.0, 5_512_350.0, 235.0];
        let images = vec![image("a", 0.3, -0.2, near), image("b", 1.3, 0.7, near.map(|x| x + 4.0))];
        Cameras { frame: Frame::World, sensors: vec![sensor], images }
    }

    #[test]
    fn pixels_stay_where_they_were() {
        let (world, turn) = (block(), turn());
        let wall = cameras_to_frame(&world, &turn, Frame::Wall);
        let back = cameras_to_frame(&wall, &turn.inverse(), Frame::World);
        for (image, (there, again)) in world.images.iter().zip(wall.images.iter().zip(&back.images)) {
            let sensor = &world.sensors[0];
            let camera = Camera::new(sensor, image);
            let point = camera.unproject([0.11, -0.07], 20.0);
            let moved = turn.apply(&Point3::from(point)).coords;
            let pixel = camera.project(&point).unwrap();
            // UTM coordinates resolve 1e-9 m: 2e-7 px here.
            for other in [Camera::new(sensor, there).project(&moved), Camera::new(sensor, again).project(&point)] {
                let [u, v] = other.unwrap();
                assert!((u - pixel[0]).abs() < 1e-6 && (v - pixel[1]).abs() < 1e-6);
            }
        }
    }

    #[test]
    fn there_and_back_keeps_pixels_to_a_billionth() {
        let mut world = block();
        world.images.iter_mut().for_each(|image| image.centre_m = [5.0, -3.0, 4.0]);
        let mut turn = turn();
        turn.origin = [1.0, 2.0, 3.0];
        let back = cameras_to_frame(&cameras_to_frame(&world, &turn, Frame::Wall), &turn.inverse(), Frame::World);
        for (image, again) in world.images.iter().zip(&back.images) {
            let point = Camera::new(&world.sensors[0], image).unproject([0.11, -0.07], 20.0);
            let [u, v] = Camera::new(&world.sensors[0], image).project(&point).unwrap();
            let [w, x] = Camera::new(&world.sensors[0], again).project(&point).unwrap();
            assert!((u - w).abs() < 1e-9 && (v - x).abs() < 1e-9);
        }
    }

    fn correlated() -> Covariance {
        let names = ["a.rx", "a.X", "cam.f", "a.Y", "a.Z"];
        let row = |i: usize| (0..5).map(|j| if i == j { 2.0 + i as f64 } else { 0.1 * (i + j) as f64 }).collect();
        Covariance {
            frame: Frame::World,
            parameters: names.map(str::to_owned).to_vec(),
            matrix: (0..5).map(row).collect(),
            sigma0_applied: true,
            full_joint: true,
        }
    }

    #[test]
    fn only_positions_turn_and_variance_along_a_line_stays() {
        let (before, turn) = (correlated(), turn());
        let after = covariance_to_frame(&before, &turn, Frame::Wall).unwrap();
        assert_eq!(after.matrix[0][0].to_bits(), before.matrix[0][0].to_bits());
        assert_eq!(after.matrix[2][2].to_bits(), before.matrix[2][2].to_bits());
        // g = (rx, X, f, Y, Z) as a functional: the same quantity in both frames has the same variance.
        let line = Vector3::new(0.3, -0.5, 0.8);
        let turned = turn.matrix() * line;
        let variance = |c: &Covariance, v: &Vector3<f64>| {
            let g = [0.7, v.x, -0.4, v.y, v.z];
            (0..5).map(|i| (0..5).map(|j| g[i] * c.matrix[i][j] * g[j]).sum::<f64>()).sum::<f64>()
        };
        assert!((variance(&before, &line) - variance(&after, &turned)).abs() < 1e-12);
        assert!((0..5).all(|i| (0..5).all(|j| after.matrix[i][j].to_bits() == after.matrix[j][i].to_bits())));
    }

    #[test]
    fn the_identity_keeps_every_bit() {
        let identity = Transform::identity("world", "wall");
        assert_eq!(cameras_to_frame(&block(), &identity, Frame::Wall), Cameras { frame: Frame::Wall, ..block() });
        let moved = covariance_to_frame(&correlated(), &identity, Frame::Wall).unwrap();
        assert_eq!(moved, Covariance { frame: Frame::Wall, ..correlated() });
    }

    #[test]
    fn a_missing_axis_is_named() {
        let mut broken = correlated();
        broken.parameters[3] = "a.ry".into();
        let error = covariance_to_frame(&broken, &turn(), Frame::Wall).unwrap_err();
        assert!(error.message.contains("`a`"), "{error}");
        broken.matrix.pop();
        assert!(covariance_to_frame(&broken, &turn(), Frame::Wall).unwrap_err().message.contains("4 rows"));
    }
}
