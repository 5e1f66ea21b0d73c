//! Tests of the registration: known motions, planes that leave directions free, surfaces that do not meet.

use nalgebra::Point3;

use super::*;
use rockface_core::artefact::Frame;
use rockface_core::numerics::portable_math::sincos;
use rockface_core::numerics::random::Key;

const SETTINGS: Settings = Settings {
    method: Method::PointToPlane,
    pairing: Pairing::InPlan,
    trim: 0.9,
    max_distance_m: None,
    points: 5000,
    max_iterations: 50,
    weak_eigenvalue: 1e-4,
    between_points: true,
};

/// A grid of 200 x 150 points 5 cm apart at UTM coordinates, moved by a transform.
fn surface(height: impl Fn(f64, f64) -> f64, motion: &Transform) -> Surface {
    let (width, rows) = (200, 150);
    let origin = Vector3::new(451_000.0, 5_512_000.0, 300.0);
    let place = |i: usize| {
        let (x, y) = ((i % width) as f64 * 0.05, 7.5 - (i / width) as f64 * 0.05);
        let moved = motion.apply(&Point3::from(origin + Vector3::new(x, y, height(x, y))));
        (moved.coords - origin).map(|v| v as f32).into()
    };
    Surface {
        frame: Frame::Wall,
        width,
        height: rows,
        origin_m: origin.into(),
        points: (0..width * rows).map(place).collect(),
        squares: vec![Surface::FIRST | Surface::SECOND; (width - 1) * (rows - 1)],
    }
}

fn rough(x: f64, y: f64) -> f64 {
    0.2 * sincos(1.3 * x + 0.4 * y).0 + 0.15 * sincos(2.9 * y - 0.7 * x).1 + 0.03 * sincos(7.0 * x * y).0
}

fn motion() -> Transform {
    let rotation = Rotation3::from_euler_angles(0.004, -0.003, 0.005).into_inner();
    let origin = Vector3::new(451_005.0, 5_512_003.0, 300.0);
    Transform::new("target", "source", &rotation, origin, origin + Vector3::new(0.03, -0.02, 0.04))
}

fn still() -> Transform {
    Transform::identity("a", "b")
}

#[test]
fn a_small_motion_is_undone_to_a_hundredth_of_a_millimetre() {
    let (source, target) = (surface(rough, &motion()), surface(rough, &still()));
    let ways = [
        (Method::PointToPlane, Pairing::InPlan, true),
        (Method::PointToPlane, Pairing::InPlan, false),
        (Method::PointToPlane, Pairing::InSpace, false),
        (Method::PointToPoint, Pairing::InSpace, false),
    ];
    for (method, pairing, between_points) in ways {
        let settings = Settings { method, pairing, max_iterations: 200, between_points, ..SETTINGS };
        let found = register(&source, &target, &settings).unwrap();
        for corner in [[0.0, 0.0], [9.0, 7.0], [9.0, 0.0]] {
            let p = Point3::new(451_000.0 + corner[0], 5_512_000.0 + corner[1], 300.0);
            let off = (found.transform.apply(&motion().apply(&p)) - p).norm();
            assert!(off < 1e-5, "{method:?}: {off} m off after {} iterations", found.iterations);
        }
        assert!(found.converged && found.unobservable.is_empty() && found.rms_m < 1e-5);
    }
}

/// Rms error of the shift in some registrations of noisy surfaces along X, Y, Z, in point spacings of 4 cm.
fn shift_errors(face: impl Fn(f64, f64) -> f64, noise_m: f64, pairing: Pairing, trials: i32) -> [f64; 3] {
    let (wide, high, spacing_m) = (150, 110, 0.04);
    let mut squares = [0.0; 3];
    for trial in 0..trials {
        let drawn = |item: i32| Key([7; 32]).field().normal(trial, item);
        let turn = Vector3::new(0.002 * drawn(0), 0.002 * drawn(1), 0.004 * drawn(2));
        let centre = Vector3::new(3.0, 2.2, 0.0);
        let shift = Vector3::new(drawn(3), drawn(4), drawn(5)) * 0.03;
        let there = Transform::new("target", "source", &Rotation3::new(turn).into_inner(), centre, centre + shift);
        let sampled = |key: u8, motion: &Transform| {
            let field = Key([key; 32]).field();
            let point = |i: usize| {
                let (column, row) = (i % wide, i / wide);
                // Points of the source are somewhere between those of the target.
                let at = Point3::new(column as f64 * spacing_m, (high - row) as f64 * spacing_m, 0.0);
                let (x, y) = (motion.apply(&at).x, motion.apply(&at).y);
                let z = face(x, y) + noise_m * field.normal(column as i32 + 1000 * trial, row as i32);
                motion.apply(&Point3::new(x, y, z)).coords.map(|v| v as f32).into()
            };
            Surface {
                frame: Frame::Wall,
                width: wide,
                height: high,
                origin_m: [0.0; 3],
                points: (0..wide * high).map(point).collect(),
                squares: vec![Surface::FIRST | Surface::SECOND; (wide - 1) * (high - 1)],
            }
        };
        let settings = Settings { pairing, points: 40_000, between_points: pairing == Pairing::InPlan, ..SETTINGS };
        let found = register(&sampled(8, &there), &sampled(9, &still()), &settings).unwrap();
        let off = (found.transform.apply(&there.apply(&Point3::from(centre))).coords - centre) / spacing_m;
        squares = [0, 1, 2].map(|k| squares[k] + off[k] * off[k] / f64::from(trials));
    }
    squares.map(f64::sqrt)
}

/// Relief of 0.12 m with waves of 1.2 m: 30 point spacings of [`shift_errors`].
fn ledges(x: f64, y: f64) -> f64 {
    let waves = 0.5 * sincos(1.1 * x + 0.3).0 * sincos(0.8 * y).1 + 0.2 * sincos(3.1 * x - 1.7 * y).0;
    waves + 0.12 * sincos(5.0 * y + 2.0 * x).1 + 0.1 * x
}

#[test]
fn relief_of_thirty_spacings_is_not_smoothed_away() {
    // With normals from 17 x 17 points alone they were 0.03 and 0.05.
    for pairing in [Pairing::InPlan, Pairing::InSpace] {
        let off = shift_errors(ledges, 0.0, pairing, 4);
        assert!(off.iter().all(|off| *off < 0.015), "{pairing:?}: {off:?} spacings");
    }
    let off = shift_errors(ledges, 0.01, Pairing::InPlan, 4);
    assert!(off.iter().all(|off| *off < 0.012), "{off:?} spacings with noise of a quarter of a spacing");
}

#[test]
fn a_plane_leaves_two_shifts_and_a_rotation_alone() {
    let plane = |x: f64, y: f64| 0.3 * x - 0.1 * y;
    let mut lift = still();
    lift.translation = [0.0, 0.0, 0.05];
    let found = register(&surface(plane, &lift), &surface(plane, &still()), &SETTINGS).unwrap();
    assert_eq!(found.unobservable.len(), 3);
    // It moves along the normal only: 5 cm up is 5 cm x cos(slope) off the plane.
    let moved = Vector3::from(found.transform.translation) - Vector3::from(found.transform.origin);
    let normal = Vector3::new(-0.3, 0.1, 1.0).normalize();
    assert!((moved + normal * (0.05 * normal.z)).norm() < 1e-5, "{moved}");
}

#[test]
fn what_is_left_alone_says_what_it_costs_in_the_difference() {
    // Slopes of 4 %: along X and Y, noise would hold such a surface in place.
    let gentle = |x: f64, y: f64| {
        0.04 * rockface_core::numerics::portable_math::sin(1.5 * x)
            + 0.03 * rockface_core::numerics::portable_math::cos(1.3 * y)
    };
    let mut shifted = still();
    shifted.translation[0] += 0.05;
    let settings = Settings { trim: 1.0, weak_eigenvalue: 0.01, ..SETTINGS };
    let found = register(&surface(gentle, &shifted), &surface(gentle, &still()), &settings).unwrap();
    assert!(found.unobservable.len() >= 2 && found.unobservable.len() == found.left_alone_m.len());
    let whole = |k: usize| found.left_alone_m.iter().map(|left| left[k] * left[k]).sum::<f64>().sqrt();
    assert!((whole(0) - 0.05).abs() < 0.005, "{:?}", found.left_alone_m);
    // All that is left of the difference is that.
    assert!((whole(1) / found.rms_m - 1.0).abs() < 0.05 && (0.001..0.003).contains(&found.rms_m), "{found:?}");
    let free = Settings { weak_eigenvalue: 1e-6, ..settings };
    let found = register(&surface(gentle, &shifted), &surface(gentle, &still()), &free).unwrap();
    assert!(found.unobservable.is_empty() && found.rms_m < 1e-4, "{found:?}");
}

#[test]
fn a_change_is_trimmed_away() {
    let fallen = |x: f64, y: f64| {
        let niche = (4.0..6.0).contains(&x) && (3.0..5.0).contains(&y);
        rough(x, y) - if niche { 0.5 } else { 0.0 }
    };
    let found = register(&surface(fallen, &motion()), &surface(rough, &still()), &SETTINGS).unwrap();
    let p = Point3::new(451_002.0, 5_512_002.0, 300.0);
    assert!((found.transform.apply(&motion().apply(&p)) - p).norm() < 1e-3);
}

#[test]
fn what_cannot_be_registered_is_refused() {
    let mut far = still();
    far.translation = [0.0, 0.0, 30.0];
    let error = register(&surface(rough, &far), &surface(rough, &still()), &SETTINGS).unwrap_err();
    assert!(error.message.contains("do not overlap"), "{error}");
    let mut few = surface(rough, &still());
    few.points[40..].fill([f32::NAN; 3]);
    assert!(register(&few, &surface(rough, &still()), &SETTINGS).unwrap_err().message.contains("points to use"));
    few.points.fill([f32::NAN; 3]);
    assert!(register(&surface(rough, &still()), &few, &SETTINGS).unwrap_err().message.contains("no points"));
}

#[test]
fn the_bits_do_not_depend_on_the_number_of_threads() {
    let (source, target) = (surface(rough, &motion()), surface(rough, &still()));
    let at = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| register(&source, &target, &SETTINGS).unwrap())
    };
    assert_eq!(at(1), at(3));
}

#[test]
fn a_tenth_of_the_points_must_meet_the_target() {
    let left_part = |columns: usize| {
        let mut target = surface(rough, &still());
        target.points.iter_mut().enumerate().filter(|(i, _)| i % 200 >= columns).for_each(|(_, p)| *p = [f32::NAN; 3]);
        register(&surface(rough, &still()), &target, &Settings { max_distance_m: Some(0.2), ..SETTINGS })
    };
    // Of 200 columns.
    assert!(left_part(12).unwrap_err().message.contains("do not overlap"));
    assert!(left_part(40).is_ok());
}

/// A face of blocks with steps of up to 0.3 m every metre, with fine relief, and noise of 3 mm that the key chooses.
fn blocks(key: u8) -> impl Fn(f64, f64) -> f64 {
    let (steps, fine, noise) = (Key([7; 32]).field(), Key([8; 32]).field(), Key([key; 32]).field());
    move |x, y| {
        let block = 0.1 * steps.normal(x.floor() as i32, y.floor() as i32).clamp(-1.5, 1.5);
        // Squares of 0.2 m with bilinear relief between their corners.
        let (u, v) = (x / 0.2, y / 0.2);
        let (i, j, du, dv) = (u.floor() as i32, v.floor() as i32, u - u.floor(), v - v.floor());
        let corner = |di: i32, dj: i32| 0.04 * fine.normal(i + di, j + dj);
        let relief = (1.0 - dv) * ((1.0 - du) * corner(0, 0) + du * corner(1, 0))
            + dv * ((1.0 - du) * corner(0, 1) + du * corner(1, 1));
        block + relief + 0.003 * noise.normal((x * 1e4) as i32, (y * 1e4) as i32)
    }
}

#[test]
fn ledges_hold_points_where_they_are_and_the_surface_between_does_not() {
    // Both are sampled at the same places in plan, as rasters and fused surfaces are: the source is another 6 mm along X, -15 mm along Y.
    let (first, second) = (blocks(1), blocks(2));
    let (source, target) = (surface(|x, y| first(x - 0.006, y + 0.015), &still()), surface(second, &still()));
    let off_m = |between_points: bool, trim: f64| {
        let settings = Settings { points: 20_000, weak_eigenvalue: 0.01, trim, between_points, ..SETTINGS };
        let found = register(&source, &target, &settings).unwrap().transform;
        let middle = Point3::new(451_005.0, 5_512_003.75, 300.0);
        (found.apply(&middle) - middle - Vector3::new(-0.006, 0.015, 0.0)).xy().norm()
    };
    assert!(off_m(false, 0.9) > 0.004, "points: {}", off_m(false, 0.9));
    assert!(off_m(true, 0.9) < 0.0015, "between: {}", off_m(true, 0.9));
}

/// A face of ridges, all of straight pieces.
fn ridges(x: f64, y: f64) -> f64 {
    let tooth = |t: f64| 1.0 - 2.0 * ((t - t.floor()) - 0.5).abs();
    0.5 * tooth(0.31 * x + 0.2 * y) + 0.15 * tooth(1.3 * y - 0.7 * x) + 0.02 * tooth(7.1 * x + 5.3 * y)
}

/// 240 x 240 points of the face near the corners of a grid, each up to a third of the spacing beside.
fn scattered_points(key: u8, spacing_m: f64) -> impl Iterator<Item = Point3<f64>> {
    let (side, field) = (240, Key([key; 32]).field());
    let at = move |line: i32, word: u32| {
        let beside = (f64::from(word) / f64::from(u32::MAX) - 0.5) * 2.0 / 3.0;
        spacing_m * (f64::from(line) + beside)
    };
    (0..side * side).map(move |i| {
        let (column, row) = (i % side, i / side);
        let words = field.words(column, row);
        let (x, y) = (at(column, words[2]), at(side - row, words[3]));
        Point3::new(x, y, ridges(x, y))
    })
}

#[test]
fn edges_between_scattered_points_are_not_pulled_to_one_side() {
    let spacing_m = 0.02;
    let surface = |points: &mut dyn Iterator<Item = Point3<f64>>| Surface {
        frame: Frame::Wall,
        width: 240,
        height: 240,
        origin_m: [0.0; 3],
        points: points.map(|point| point.coords.map(|v| v as f32).into()).collect(),
        squares: vec![Surface::FIRST | Surface::SECOND; 239 * 239],
    };
    let mut worst = Vector3::<f64>::zeros();
    for key in [10, 12, 14] {
        let turn = Rotation3::new(Vector3::new(0.001, -0.0015, 0.002));
        let shift = Vector3::new(0.01, -0.008, 0.015);
        let mut moved = scattered_points(key + 1, spacing_m).map(|point| turn.inverse() * (point - shift));
        let settings = Settings { trim: 1.0, points: 240 * 240, between_points: true, ..SETTINGS };
        let target = surface(&mut scattered_points(key, spacing_m));
        let found = register(&surface(&mut moved), &target, &settings).unwrap();
        let centre = Point3::new(2.4, 2.4, 0.3);
        let off = found.transform.apply(&(turn.inverse() * (centre - shift))) - centre;
        worst = worst.sup(&(off / spacing_m).abs());
    }
    // With one normal for 2 x 2 points, computed about one of them, they were 0.0045 and 0.005, and all to one side.
    assert!(worst.x < 1e-3 && worst.y < 1e-3 && worst.z < 5e-4, "{worst:?} of the spacing");
}
