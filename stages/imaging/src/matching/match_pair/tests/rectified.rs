//! The paper's own grid: disparities at the pixels of the rectified images.

use super::*;

fn rectified(of: &str, sigma_px: f64) -> Value {
    json!({"of": of, "sampling": "rectified", "sigma_local_px": sigma_px, "sigma_regular_px": 0, "channels": true})
}

#[test]
fn points_lie_on_the_surface_and_the_camera_has_no_distortion() {
    let plane = |x: f64, y: f64| 0.2 * x - 0.1 * y;
    let mesh = height_mesh(1, [-15.0, 15.0, -15.0, 15.0], plane);
    for downscale in [1, 2] {
        let scene = scene(convergent(sensor()), &mesh, downscale);
        for of in ["first", "second"] {
            let host = TestHost::default();
            let map = run(&scene, &host, &rectified(of, 0.0)).unwrap();
            assert!(map.sensor.k.iter().chain(&map.sensor.p).all(|c| *c == 0.0) && map.sensor.b2 == 0.0);
            let points: Vec<[f64; 3]> = (0..map.z.len())
                .filter_map(|at| crate::camera::depth_pixel::pixel(&map, at % map.width, at / map.width))
                .map(|pixel| pixel.point_m)
                .collect();
            assert!(points.len() * 2 > map.z.len(), "{} of {}", points.len(), map.z.len());
            for [x, y, z] in points {
                // With 100 pixels to the principal distance the lens bends by as much within a pixel; less than 1e-6 with real ones.
                assert!((z - plane(x, y)).abs() < 2e-3, "({x}, {y}, {z})");
            }
            assert!(host.metric("y_parallax_rms").unwrap() < 1e-6);
        }
    }
}

#[test]
fn both_rectified_maps_carry_the_same_error_in_the_same_row() {
    let scene = scene(convergent(sensor()), &wavy(), 1);
    let (first, second) = (matched(&scene, &rectified("first", 0.3)), matched(&scene, &rectified("second", 0.3)));
    let mut compared = 0;
    for (at, ideal) in second.channels["disparity.ideal"].iter().enumerate().filter(|(_, d)| !d.is_nan()) {
        let column = (at % second.width) as f64 + f64::from(*ideal);
        let near = at / second.width * second.width + column.round().max(0.0) as usize;
        let inside = column.round() >= 0.0 && column.round() < second.width as f64 && !first.z[near].is_nan();
        // Beside the middle between two pixels, where rounding chooses.
        if inside && (column.fract().abs() - 0.5).abs() > 1e-3 {
            let noise = |map: &Depth, at: usize| map.channels["noise.local"][at].to_bits();
            assert_eq!(noise(&second, at), noise(&first, near));
            compared += 1;
        }
    }
    assert!(compared > 500, "{compared}");
}

#[test]
fn the_noise_is_as_strong_as_at_image_pixels() {
    let with = |sampling: &str| {
        json!({"sigma_local_px": 0.5, "sigma_regular_px": 0, "sampling": sampling,
               "matcher": {"relief": {}, "texture": {"log_sd": 0.1}}})
    };
    let rms = |sampling: &str| {
        let (errors, _) = plane_errors(&with(sampling), 200);
        (errors.iter().flatten().map(|e| e * e).sum::<f64>() / errors.iter().flatten().count() as f64).sqrt()
    };
    let (image, rectified) = (rms("image"), rms("rectified"));
    assert!((rectified / image - 1.0).abs() < 0.05, "{rectified} instead of {image}");
}
