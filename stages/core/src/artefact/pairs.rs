//! Stereo pairs, each with an order of its two images that never changes.

/// A stereo pair. The order of its images is settled once, from the nominal cameras: image x grows towards the second.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pair {
    /// `<first>+<second>`: the item name of the pair.
    pub name: String,
    /// Name of the first (left) image.
    pub first: String,
    /// Name of the second (right) image.
    pub second: String,
    /// Distance of the projection centres, metres.
    pub baseline_m: f64,
    /// Mean distance to the face along the optical axes, metres.
    pub distance_m: f64,
    /// Angle between the optical axes, radians.
    pub convergence_rad: f64,
    /// Share of the face that one image sees which the other sees too, the smaller of both, 0 to 1.
    pub overlap: f64,
}

/// The stereo pairs to match.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pairs {
    /// The pairs, in a fixed order.
    pub pairs: Vec<Pair>,
}

super::json_noun!(
    Pairs,
    fn items(&self) -> Option<Vec<String>> {
        Some(self.pairs.iter().map(|pair| pair.name.clone()).collect())
    }
);
