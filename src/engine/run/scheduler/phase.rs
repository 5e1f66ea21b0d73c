//! The phases an instance goes through, each with what is known only in it.

use rockface_cache::{KeyLock, Outcome};

use crate::run::StepFailure;

/// How far an instance is, with what is known only then.
pub enum Phase {
    /// So many producers are not done.
    Waiting {
        /// The number of these producers.
        unmet: usize,
    },
    /// All producers are done. The instance waits for a worker, for values that are being recomputed, or for its twin.
    Due(Due),
    /// A worker has it.
    Running(Purpose),
    /// Its outcome is known.
    Done {
        /// What its record says.
        outcome: Outcome,
        /// Whether its consumers have been notified.
        delivered: bool,
    },
    /// Its stage failed, for this reason; without a reason, something it needs failed.
    Failed(Option<Box<StepFailure>>),
}

/// Why a worker has to run an instance.
pub enum Purpose {
    /// The outcome is not known.
    Compute {
        /// A record has its recipe, but the store lacks outputs that are needed.
        recorded: bool,
    },
    /// The outcome is known, but a consumer needs values that are neither in memory nor in the store.
    Recompute {
        /// The outcome that is known.
        former: Outcome,
    },
}

/// What is known of an instance that is due.
pub struct Due {
    /// Why it has to run.
    pub purpose: Purpose,
    /// The number of producers whose values are being recomputed for it.
    pub missing: usize,
    /// The lock of its key: held from the moment it is certain that its values must be recomputed here until a worker takes over.
    pub lease: Option<KeyLock>,
    /// A recomputed producer gave a different output, so the recipe must be determined again.
    pub is_stale: bool,
    /// It has a place in the queue for workers.
    pub is_queued: bool,
    /// How many producers that consumer of it lacks which lacks the fewest, once that was looked at.
    pub lacking: Option<usize>,
}

impl Phase {
    /// Due for this purpose, with nothing missing.
    pub fn due(purpose: Purpose) -> Self {
        Self::Due(Due { purpose, missing: 0, lease: None, is_stale: false, is_queued: false, lacking: None })
    }

    /// What the record says: the former outcome while the values are recomputed.
    pub fn outcome(&self) -> Option<&Outcome> {
        match self {
            Self::Done { outcome, .. }
            | Self::Due(Due { purpose: Purpose::Recompute { former: outcome }, .. })
            | Self::Running(Purpose::Recompute { former: outcome }) => Some(outcome),
            _ => None,
        }
    }

    /// The outcome that was known before the values were recomputed; `None` for the first computation.
    pub fn into_former(self) -> Option<Outcome> {
        match self {
            Self::Due(Due { purpose: Purpose::Recompute { former }, .. })
            | Self::Running(Purpose::Recompute { former }) => Some(former),
            _ => None,
        }
    }

    /// The outcome if the instance is done, and why its stage failed if it did.
    pub fn into_result(self) -> (Option<Outcome>, Option<StepFailure>) {
        match self {
            Self::Done { outcome, .. } => (Some(outcome), None),
            Self::Failed(cause) => (None, cause.map(|cause| *cause)),
            _ => (None, None),
        }
    }

    /// Whether it is done or failed.
    pub fn is_closed(&self) -> bool {
        matches!(self, Self::Done { .. } | Self::Failed(_))
    }
}

impl Due {
    /// Whether its outcome is known and only its values are needed.
    pub fn is_recompute(&self) -> bool {
        matches!(self.purpose, Purpose::Recompute { .. })
    }
}
