//! A scene with known answers: a spherical cap taken out of a plane.

use rockface_core::artefact::{Frame, Mesh};

use super::{Facets, RemovedPiece};

/// Sides of the polygon that stands for the rim.
pub const SIDES: usize = 240;
/// Rings between the rim and the deepest point.
const RINGS: usize = 40;
/// Half the width of the plane, metres.
const HALF_WIDTH_M: f64 = 2.0;

/// A cap of a sphere under the plane z = 0 about the origin.
#[derive(Debug, Clone, Copy)]
pub struct Cap {
    /// Radius of the rim, metres.
    pub rim_m: f64,
    /// Depth of the deepest point, metres.
    pub depth_m: f64,
    /// Where the middle of the rim lies in X and Y, metres.
    pub centre: [f64; 2],
}

impl Cap {
    fn sphere_m(&self) -> f64 {
        (self.rim_m * self.rim_m + self.depth_m * self.depth_m) / (2.0 * self.depth_m)
    }

    /// Volume of the smooth cap, cubic metres.
    pub fn volume_m3(&self) -> f64 {
        std::f64::consts::PI * self.depth_m * (3.0 * self.rim_m * self.rim_m + self.depth_m * self.depth_m) / 6.0
    }

    /// Area of the smooth sphere under the plane, square metres.
    pub fn sphere_area_m2(&self) -> f64 {
        2.0 * std::f64::consts::PI * self.sphere_m() * self.depth_m
    }

    /// Point at a share of the rim's radius, on the sphere (`true`) or in the plane.
    fn point(&self, share: f64, side: usize, deep: bool) -> [f64; 3] {
        let angle = 2.0 * std::f64::consts::PI * side as f64 / SIDES as f64;
        let (sine, cosine) = rockface_core::numerics::portable_math::sincos(angle);
        let (sphere, radius) = (self.sphere_m(), self.rim_m * share);
        let z = (sphere - self.depth_m) - (sphere * sphere - radius * radius).sqrt();
        let rim = share >= 1.0 || !deep;
        [self.centre[0] + radius * cosine, self.centre[1] + radius * sine, if rim { 0.0 } else { z }]
    }

    /// Rings from the middle to the rim; facing +Z.
    fn disc(&self, deep: bool) -> Facets {
        let mut facets = Facets { vertices: vec![self.point(0.0, 0, deep)], triangles: Vec::new() };
        for ring in 1..=RINGS {
            facets.vertices.extend((0..SIDES).map(|side| self.point(ring as f64 / RINGS as f64, side, deep)));
        }
        let at = |ring: usize, side: usize| if ring == 0 { 0 } else { (1 + (ring - 1) * SIDES + side % SIDES) as u32 };
        for ring in 0..RINGS {
            for side in 0..SIDES {
                facets.triangles.push([at(ring, side), at(ring + 1, side), at(ring + 1, side + 1)]);
                if ring > 0 {
                    facets.triangles.push([at(ring, side), at(ring + 1, side + 1), at(ring, side + 1)]);
                }
            }
        }
        facets
    }

    /// The piece: the cap under the plane.
    pub fn piece(&self, id: u32) -> RemovedPiece {
        let (outer, niche) = (self.disc(false), self.disc(true));
        let mut removed = outer.clone();
        let first = removed.vertices.len() as u32;
        removed.vertices.extend(&niche.vertices);
        removed.triangles.extend(niche.triangles.iter().map(|[a, b, c]| [a + first, c + first, b + first]));
        RemovedPiece {
            id,
            event: id,
            candidate: u64::from(id) + 10,
            class: "cap".into(),
            seed: "00ff".into(),
            block: removed.clone(),
            removed,
            niche,
            outer,
            parameters: vec![("radius_m".into(), self.rim_m)],
            shift_m: 0.0,
            position: [self.centre[0], self.centre[1], 0.0],
            normal: [0.0, 0.0, 1.0],
        }
    }
}

/// The plane before, a square of 4 m, and after the caps were taken out of it: caps replace what a raster sees there.
pub fn faces(caps: &[Cap]) -> (Mesh, Mesh) {
    let plane = |z: f64| -> Vec<[f64; 3]> {
        let w = HALF_WIDTH_M;
        vec![[-w, -w, z], [w, -w, z], [w, w, z], [-w, w, z]]
    };
    let square = vec![[0, 1, 2], [0, 2, 3]];
    let pre = Mesh { frame: Frame::Wall, vertices: plane(0.0), triangles: square, colours: Vec::new() };
    let mut post = Mesh { frame: Frame::Wall, vertices: Vec::new(), triangles: Vec::new(), colours: Vec::new() };
    for cap in caps {
        for facets in [cap.piece(1).niche, around(cap)] {
            let first = post.vertices.len() as u32;
            post.triangles.extend(facets.triangles.iter().map(|t| t.map(|corner| corner + first)));
            post.vertices.extend(facets.vertices);
        }
    }
    (pre, post)
}

/// The plane between the rim of a cap and a far square about the plane's own.
fn around(cap: &Cap) -> Facets {
    let mut facets = Facets::default();
    for side in 0..SIDES {
        let rim = cap.point(1.0, side, false);
        let far = |value: f64, centre: f64| centre + (value - centre) * 10.0 * HALF_WIDTH_M / cap.rim_m;
        facets.vertices.push(rim);
        facets.vertices.push([far(rim[0], cap.centre[0]), far(rim[1], cap.centre[1]), 0.0]);
    }
    let count = facets.vertices.len() as u32;
    for rim in (0..count).step_by(2) {
        let next = (rim + 2) % count;
        facets.triangles.push([rim, rim + 1, next + 1]);
        facets.triangles.push([rim, next + 1, next]);
    }
    facets
}
