//! The sign of a change.

rockface_core::choice! {
    /// Which changes are looked for.
    pub enum Change {
        /// Material that went away.
        Loss = "loss",
        /// Material that came.
        Gain = "gain",
    }
}

impl Change {
    /// The word that parameters and tables have for it.
    pub const fn word(self) -> &'static str {
        match self {
            Self::Loss => "loss",
            Self::Gain => "gain",
        }
    }

    /// The sign of comparison minus reference where there is such a change.
    pub fn sign(self) -> f64 {
        if self == Self::Loss { -1.0 } else { 1.0 }
    }
}
