//! The base shapes of blocks, and how their size is stated.

use super::Quantity;
use crate::params::Range;
use crate::{choice, params, union};

params! {
    /// A straight prism along Z.
    pub struct Prism {
        /// Sides of its base: 4 is a cuboid, 6 a basalt column.
        sides: u32 = 4; Range::Between(3.0, 64.0),
    }
}

params! {
    /// An ellipsoid.
    pub struct Ellipsoid {
        /// How often each triangle of an icosahedron is cut into four: 20 x 4^n triangles.
        subdivisions: u32 = 3; Range::Between(0.0, 6.0),
    }
}

params! {
    /// A frustum with a rectangular base: the outer side is whole, the side in the rock is smaller.
    pub struct Trapezoid {
        /// Width (X) of the inner side relative to the outer.
        taper_x: Quantity = Quantity::Fixed(0.6); Range::Between(0.01, 1.0),
        /// Height (Y) of the inner side relative to the outer.
        taper_y: Quantity = Quantity::Fixed(0.6); Range::Between(0.01, 1.0),
    }
}

params! {
    /// A pyramid whose tip points into the rock.
    pub struct Pyramid {
        /// Sides of its base: 4 is a square pyramid, 3 a tetrahedron.
        sides: u32 = 4; Range::Between(3.0, 64.0),
    }
}

params! {
    /// A triangular prism: a rectangle outside, an edge along X inside.
    pub struct Wedge {
        /// Where the inner edge lies from the lower (-0.5) to the upper (0.5) side.
        edge: Quantity = Quantity::Fixed(0.0); Range::Between(-0.5, 0.5),
    }
}

params! {
    /// The convex hull of random points.
    pub struct Polyhedron {
        /// How many points.
        points: u32 = 16; Range::Between(4.0, 10_000.0),
        /// Distance of each from the centre before the hull is stretched to its size.
        radius: Quantity = Quantity::Fixed(1.0); Range::Positive,
    }
}

params! {
    /// The parts of the input `library`.
    pub struct Library {
        /// Only parts of this class; null: all.
        class: Option<String> = None,
    }
}

params! {
    /// A set of discontinuities.
    pub struct JointSet {
        /// Mean dip below the horizontal, degrees.
        dip_deg: f64; Range::Between(0.0, 90.0),
        /// Mean direction of dip clockwise from north, degrees.
        dip_direction_deg: f64; Range::Between(0.0, 360.0),
        /// Fisher's concentration about the mean pole; null: no dispersion.
        fisher_k: Option<f64> = None; Range::Positive,
        /// Distance of neighbouring planes, metres.
        spacing_m: Quantity = Quantity::Fixed(1.0); Range::Positive,
    }
}

choice! {
    /// Which blocks of joint sets are let through.
    pub enum Kinematics {
        /// All; whether they can slide is noted in their parameters.
        Noted = "noted",
        /// Those that can slide on a plane or along a line of intersection; the rest are rejected.
        Sliding = "sliding",
    }
}

params! {
    /// A parallelepiped (or richer polyhedron) between pairs of planes of three or more joint sets.
    pub struct JointBlock {
        /// The sets, three or more; each bounds the block by two planes a spacing apart.
        sets: Vec<JointSet>,
        /// Angle of friction on the planes, degrees.
        friction_deg: Quantity = Quantity::Fixed(30.0); Range::Between(0.0, 89.0),
        /// A plane slides where its dip direction is within this of the face's, degrees.
        lateral_deg: f64 = 20.0; Range::Between(0.0, 90.0),
        /// Which blocks are let through.
        kinematics: Kinematics = Kinematics::Noted,
    }
}

params! {
    /// A tetrahedral wedge between two joint sets, the face, and an upper plane.
    pub struct JointWedge {
        /// The two sets; spacing plays no part.
        sets: [JointSet; 2],
        /// Height of the upper plane above the lowest point of the wedge, along its normal, metres.
        height_m: Quantity = Quantity::Fixed(1.0); Range::Positive,
        /// Dip of the upper plane, degrees.
        upper_dip_deg: f64 = 0.0; Range::Between(0.0, 90.0),
        /// Direction of dip of the upper plane clockwise from north, degrees.
        upper_dip_direction_deg: f64 = 0.0; Range::Between(0.0, 360.0),
        /// Angle of friction on the planes, degrees.
        friction_deg: Quantity = Quantity::Fixed(30.0); Range::Between(0.0, 89.0),
        /// A plane slides where its dip direction is within this of the face's, degrees.
        lateral_deg: f64 = 20.0; Range::Between(0.0, 90.0),
        /// Which blocks are let through.
        kinematics: Kinematics = Kinematics::Noted,
    }
}

union! {
    /// The base shape of a block.
    pub enum Shape {
        /// A cuboid, or a prism with another number of sides, along Z.
        Prism(Prism) = "prism",
        /// An ellipsoid; with equal axes a sphere.
        Ellipsoid(Ellipsoid) = "ellipsoid",
        /// A frustum, narrower in the rock than outside.
        Trapezoid(Trapezoid) = "trapezoid",
        /// A pyramid with its tip in the rock.
        Pyramid(Pyramid) = "pyramid",
        /// A triangular prism with an edge in the rock.
        Wedge(Wedge) = "wedge",
        /// An irregular convex polyhedron.
        Polyhedron(Polyhedron) = "polyhedron",
        /// A block between planes of three or more joint sets; its own spacings give its size.
        JointBlock(JointBlock) = "joint_block",
        /// A wedge of two joint sets; its height gives its size.
        JointWedge(JointWedge) = "joint_wedge",
        /// A scanned block of the input `library`.
        Library(Library) = "library",
    }
}

params! {
    /// The sides of the shape's box.
    pub struct Axes {
        /// Along X (along the face), metres.
        length_m: Quantity; Range::Positive,
        /// Along Y (up the face), metres; null: like `length_m`.
        height_m: Option<Quantity> = None; Range::Positive,
        /// Along Z (out of the rock), metres; null: like `length_m`.
        depth_m: Option<Quantity> = None; Range::Positive,
    }
}

choice! {
    /// When a volume is made exact.
    pub enum Exact {
        /// After the modifiers: the finished block has the volume, and what modifiers did is scaled with it.
        Finished = "finished",
        /// Before the modifiers: they change the volume, and their lengths are as stated.
        Base = "base",
    }
}

choice! {
    /// Which axis of the shape the long, the intermediate and the short side lie along.
    pub enum AxisOrder {
        /// Long along X, intermediate along Y, short along Z.
        Xyz = "xyz",
        /// Long along X, intermediate along Z, short along Y.
        Xzy = "xzy",
        /// Long along Y, intermediate along X, short along Z.
        Yxz = "yxz",
        /// Long along Y, intermediate along Z, short along X.
        Yzx = "yzx",
        /// Long along Z, intermediate along X, short along Y.
        Zxy = "zxy",
        /// Long along Z, intermediate along Y, short along X.
        Zyx = "zyx",
        /// Another order for each block, all six equally likely.
        Random = "random",
    }
}

params! {
    /// A target volume.
    pub struct Volume {
        /// Volume of the block, cubic metres.
        volume_m3: Quantity; Range::Positive,
        /// Side along Y of the box relative to X; null: as the shape has it.
        height_ratio: Option<Quantity> = None; Range::Positive,
        /// Side along Z of the box relative to X; null: as the shape has it.
        depth_ratio: Option<Quantity> = None; Range::Positive,
        /// When the volume is made exact.
        exact: Exact = Exact::Finished,
    }
}

choice! {
    /// The classes of form of Sneed and Folk (1958).
    pub enum SneedFolkClass {
        /// Compact.
        C = "C",
        /// Compact-platy.
        Cp = "CP",
        /// Compact-bladed.
        Cb = "CB",
        /// Compact-elongate.
        Ce = "CE",
        /// Platy.
        P = "P",
        /// Bladed.
        B = "B",
        /// Elongate.
        E = "E",
        /// Very platy.
        Vp = "VP",
        /// Very bladed.
        Vb = "VB",
        /// Very elongate.
        Ve = "VE",
    }
}

params! {
    /// The form of Sneed and Folk: long, intermediate and short side of the box, L >= I >= S.
    pub struct SneedFolk {
        /// A class: both ratios are drawn uniformly from its field of the ternary diagram.
        class: Option<SneedFolkClass> = None,
        /// S / L, where no class is given.
        s_over_l: Option<Quantity> = None; Range::Between(0.01, 1.0),
        /// (L - I) / (L - S), where no class is given: 0 platy, 1 elongate.
        elongation: Option<Quantity> = None; Range::Between(0.0, 1.0),
        /// Volume, cubic metres: it or `long_m`.
        volume_m3: Option<Quantity> = None; Range::Positive,
        /// L, metres: it or `volume_m3`.
        long_m: Option<Quantity> = None; Range::Positive,
        /// Which axis the sides lie along.
        order: AxisOrder = AxisOrder::Xyz,
        /// When a volume is made exact.
        exact: Exact = Exact::Finished,
    }
}

union! {
    /// How the size of a block is stated. The box is that of the base shape, before the modifiers.
    pub enum Size {
        /// The three sides of its box.
        Axes(Axes) = "axes",
        /// Its volume.
        Volume(Volume) = "volume",
        /// Its form after Sneed and Folk, with a volume or a length.
        SneedFolk(SneedFolk) = "sneed_folk",
    }
}
