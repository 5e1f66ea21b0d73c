//! Whose errors the fields of a pair are: its own, or those of its two images, which all pairs of an image share.

use crate::matching::noise::matcher::PairScene;
use crate::matching::noise::terms::Part;
use crate::matching::side::Side;

/// Parts that weigh less are left out: they are what rounding leaves of a direction at a right angle to the baseline.
const LEAST_WEIGHT: f64 = 1e-9;

/// Whose error a field is.
#[derive(Debug, Clone, Copy)]
pub enum Owner {
    /// The pair's own.
    Pair,
    /// Of positions in an image, to the right ...
    Right(Side),
    /// ... and down.
    Down(Side),
}

impl Owner {
    /// The image; `None` for the pair.
    pub fn side(self) -> Option<Side> {
        match self {
            Self::Pair => None,
            Self::Right(side) | Self::Down(side) => Some(side),
        }
    }

    /// The item of the random stream of the field: the pair, or an image.
    pub fn item<'a>(self, scene: &'a PairScene) -> &'a str {
        self.side().map_or(scene.name, |side| scene.geometry.ideal[side].image.name.as_str())
    }

    /// The purpose of the random stream of the field, for a kind of noise.
    pub fn purpose(self, noise: &str) -> String {
        if matches!(self, Self::Down(_)) { format!("{noise}-down") } else { noise.to_owned() }
    }
}

/// The fields of a pair and of its images, weighted by the square roots of their shares of the variance.
///
/// An image has two, the errors of its positions to the right and down; a pair has the part of them along its baseline: with phi
/// the direction of the partner in the image, `cos(phi) right + sin(phi) down`. It counts positive for both images, as the position
/// of the second is subtracted in a disparity. So the errors of an image are opposite in pairs with partners on opposite sides,
/// independent in pairs at a right angle, and do not depend on which image of a pair is the first.
pub fn shared<E>(
    image_share: f64,
    scene: &PairScene,
    mut field: impl FnMut(Owner) -> Result<Part, E>,
) -> Result<Vec<Part>, E> {
    let mut owners = vec![(Owner::Pair, (1.0 - image_share).sqrt())];
    for side in Side::BOTH {
        let [right, down] = scene.geometry.towards_partner(side).map(|part| part * (0.5 * image_share).sqrt());
        owners.extend([(Owner::Right(side), right), (Owner::Down(side), down)]);
    }
    let parts = owners.into_iter().filter(|(_, weight)| weight.abs() > LEAST_WEIGHT);
    parts.map(|(owner, weight)| Ok(Part { weight, ..field(owner)? })).collect()
}
