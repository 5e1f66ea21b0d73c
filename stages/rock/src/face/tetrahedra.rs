//! Volume by the divergence theorem: the tetrahedra between a point and the triangles of a mesh.

use nalgebra::Vector3;

/// For each triangle its corners relative to a point, metres, and six times the signed volume of the tetrahedron between
/// them and the point, cubic metres.
///
/// Added up over a closed mesh and divided by six this is the volume inside, negative where the triangles face inwards. The
/// point should lie near the mesh, or digits are lost.
pub fn tetrahedra(
    vertices: &[[f64; 3]],
    triangles: &[[u32; 3]],
    about: [f64; 3],
) -> impl Iterator<Item = ([Vector3<f64>; 3], f64)> {
    let about = Vector3::from(about);
    triangles.iter().map(move |triangle| {
        let [a, b, c] = triangle.map(|v| Vector3::from(vertices[v as usize]) - about);
        ([a, b, c], a.dot(&b.cross(&c)))
    })
}

/// The volume inside a closed mesh, cubic metres.
pub fn volume_m3(vertices: &[[f64; 3]], triangles: &[[u32; 3]], about: [f64; 3]) -> f64 {
    tetrahedra(vertices, triangles, about).fold(0.0, |sum, (_, six)| sum + six) / 6.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corner_of_a_cube_has_a_sixth_of_its_volume_about_any_point() {
        let vertices = [[10.0, 20.0, 30.0], [11.0, 20.0, 30.0], [10.0, 21.0, 30.0], [10.0, 20.0, 31.0]];
        let triangles = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        for about in [vertices[0], [0.0; 3], [12.0, 19.0, 30.5]] {
            assert!((volume_m3(&vertices, &triangles, about) - 1.0 / 6.0).abs() < 1e-11);
        }
        let inwards = triangles.map(|[a, b, c]| [a, c, b]);
        assert!((volume_m3(&vertices, &inwards, vertices[0]) + 1.0 / 6.0).abs() < 1e-15);
    }
}
