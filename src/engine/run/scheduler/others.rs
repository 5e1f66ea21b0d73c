//! What this process waits for from others.

use std::collections::HashSet;
use std::time::{Duration, Instant};

use rockface_cache::{Room, Store, StoreError};

/// The first and the longest pause while this process can only wait for others.
pub const PAUSES: (Duration, Duration) = (Duration::from_millis(1), Duration::from_millis(16));

/// What this process waits for from others, and what it has asked them for.
#[derive(Default)]
pub struct Exchange {
    /// Instances whose keys other processes have locked.
    pub elsewhere: Vec<usize>,
    /// Instances whose values are being fetched from other processes.
    pub fetching: Vec<usize>,
    /// Instances whose values were requested from other processes at some time: files may arrive for them.
    pub requested: HashSet<usize>,
    /// Instances whose wait for another process has been reported.
    pub reported: HashSet<usize>,
    /// The folder that receives values and spilled values, once there are any.
    pub room: Option<Room>,
    /// Whether other processes have such folders too.
    pub are_others: bool,
    /// When requests of other processes were last looked for.
    pub polled: Option<Instant>,
    /// How long to wait before the next look; doubled, up to the longest of [`PAUSES`], while nothing happens.
    pub pause: Duration,
}

impl Exchange {
    /// The folder that receives values for this process; made when it is first asked for.
    pub fn room(&mut self, store: &Store) -> Result<&Room, StoreError> {
        match &mut self.room {
            Some(room) => Ok(room),
            none => Ok(none.insert(store.room()?)),
        }
    }

    /// Nothing happened: the next pause is longer.
    pub fn lengthen_pause(&mut self) {
        self.pause = (self.pause * 2).clamp(PAUSES.0, PAUSES.1);
    }

    /// Something happened: the next pause is the shortest.
    pub fn reset_pause(&mut self) {
        self.pause = PAUSES.0;
    }

    /// Whether it waits for another process.
    pub fn waits(&self) -> bool {
        !self.elsewhere.is_empty() || !self.fetching.is_empty()
    }
}
