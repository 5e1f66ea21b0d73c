//! The modifiers that turn a base shape into a block, applied in the order they are listed.

use serde_json::Value;

use super::Quantity;
use crate::params::{ParamType, Range};
use crate::{params, union};

params! {
    /// Scales a block about its centre.
    pub struct Scale {
        /// Factor along all axes.
        factor: Quantity = Quantity::Fixed(1.0); Range::Positive,
        /// Further factor along X.
        x: Quantity = Quantity::Fixed(1.0); Range::Positive,
        /// Further factor along Y.
        y: Quantity = Quantity::Fixed(1.0); Range::Positive,
        /// Further factor along Z.
        z: Quantity = Quantity::Fixed(1.0); Range::Positive,
    }
}

params! {
    /// Rotates a block about its centre: first about X, then about Y, then about Z, all fixed axes.
    pub struct Rotate {
        /// About X, degrees.
        x_deg: Quantity = Quantity::Fixed(0.0),
        /// About Y, degrees.
        y_deg: Quantity = Quantity::Fixed(0.0),
        /// About Z, degrees.
        z_deg: Quantity = Quantity::Fixed(0.0),
    }
}

params! {
    /// Turns a block anyhow: every orientation is equally likely.
    pub struct Tumble {}
}

params! {
    /// Moves each vertex along its normal by normal draws of zero mean.
    pub struct Roughness {
        /// Standard deviation of the displacement, metres.
        sigma_m: Quantity; Range::NonNegative,
        /// Distance over which displacements are alike, metres; 0: each vertex on its own.
        correlation_m: f64 = 0.0; Range::NonNegative,
        /// Longest edge before the vertices are moved: the block is cut up to it, metres; null: as it is.
        edge_m: Option<f64> = None; Range::Positive,
    }
}

params! {
    /// Moves each vertex anyhow by three normal draws of zero mean.
    pub struct Noise {
        /// Standard deviation along each axis, metres.
        sigma_m: Quantity; Range::NonNegative,
    }
}

params! {
    /// Shears a block: `x' = x + xy y + xz z` and so on (a 3D affine transform).
    pub struct Skew {
        /// Share of y added to x.
        xy: Quantity = Quantity::Fixed(0.0),
        /// Share of z added to x.
        xz: Quantity = Quantity::Fixed(0.0),
        /// Share of x added to y.
        yx: Quantity = Quantity::Fixed(0.0),
        /// Share of z added to y.
        yz: Quantity = Quantity::Fixed(0.0),
        /// Share of x added to z.
        zx: Quantity = Quantity::Fixed(0.0),
        /// Share of y added to z.
        zy: Quantity = Quantity::Fixed(0.0),
    }
}

params! {
    /// Cuts edges until none is longer.
    pub struct Subdivide {
        /// Longest edge, metres.
        edge_m: f64; Range::Positive,
    }
}

params! {
    /// Makes edges about equally long, where the surface bends little.
    pub struct Remesh {
        /// Length of the edges, metres; they come out between half and four thirds of it, but for those that hold a sharp form.
        edge_m: f64; Range::Positive,
    }
}

params! {
    /// Replaces a block by its convex hull.
    pub struct ConvexHull {}
}

union! {
    /// One modifier.
    pub enum Modifier {
        /// Scales about the centre, along all axes or along each.
        Scale(Scale) = "scale",
        /// Rotates by three angles.
        Rotate(Rotate) = "rotate",
        /// Rotates at random, every orientation equally likely.
        Tumble(Tumble) = "tumble",
        /// Roughens the surface along its normals.
        Roughness(Roughness) = "roughness",
        /// Moves vertices in all directions.
        Noise(Noise) = "noise",
        /// Shears.
        Skew(Skew) = "skew",
        /// Refines the mesh.
        Subdivide(Subdivide) = "subdivide",
        /// Makes edges about equally long.
        Remesh(Remesh) = "remesh",
        /// Makes it convex.
        ConvexHull(ConvexHull) = "convex_hull",
    }
}

impl Modifier {
    /// Whether what it does differs from block to block.
    pub fn draws(&self) -> bool {
        let random = matches!(self, Self::Tumble(_) | Self::Roughness(_) | Self::Noise(_));
        // Of all that a modifier is made of, only distributions are maps.
        let maps = |inner: &Value| inner.as_object().is_some_and(|fields| fields.values().any(Value::is_object));
        random || self.encode().as_object().is_some_and(|map| map.values().any(maps))
    }
}
