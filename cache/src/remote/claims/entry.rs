//! What workers write: entries, and the object of each with what it holds.

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use crate::Digest;

/// No entry and no object of a worker is longer, bytes.
pub(super) const LIMIT: u64 = 64 << 20;

/// Whether this can be the name of a worker: it becomes part of the name of an object.
pub(super) fn is_name(text: &str) -> bool {
    const LENGTH: usize = 128;
    let is_plain = text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'-');
    (1..=LENGTH).contains(&text.len()) && is_plain
}

/// What one worker says with one entry.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Entry {
    /// Its name.
    pub worker: String,
    /// Tells the entries of a worker apart.
    pub turn: u64,
    /// Whether it takes all steps from now on.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub all: Option<bool>,
    /// Whether it has nothing to do but to wait for others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub waits: Option<bool>,
    /// Steps that it takes, all of them free before this entry.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub takes: Vec<Digest>,
    /// Steps that are free again.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub ends: Vec<Digest>,
    /// Batches of records that it has written.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub batches: Vec<Digest>,
    /// Values that it has from now on.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub has: Vec<Digest>,
    /// Values that it has no more.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lacks: Vec<Digest>,
    /// Values that it wants.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub wants: Vec<Digest>,
    /// Values that it wants no more.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub unwants: Vec<Digest>,
    /// Values that it gave: what was wanted, and the digest of the value.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub given: Vec<(Digest, Digest)>,
    /// Workers that are dead.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub dead: Vec<String>,
    /// It ends.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub leaves: bool,
}

/// What a worker holds.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Holdings {
    /// All steps.
    pub all: bool,
    /// Nothing to do: it waits for others.
    pub waits: bool,
    /// These steps.
    pub steps: BTreeSet<Digest>,
    /// Values that are not kept.
    pub has: BTreeSet<Digest>,
    /// Values that it wants.
    pub wants: BTreeSet<Digest>,
}

/// The object of a worker: what it holds by all entries up to a number.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct Member {
    /// The number of the last entry that it has read.
    pub read: u64,
    /// What it holds.
    pub holds: Holdings,
}

impl Entry {
    /// Whether it says nothing.
    pub fn is_empty(&self) -> bool {
        *self == Self { worker: self.worker.clone(), turn: self.turn, ..Self::default() }
    }

    /// The bytes of its object.
    pub fn encode(&self) -> Vec<u8> {
        serde_json::json!(self).to_string().into_bytes()
    }

    /// What an object says; nothing if it is no entry, which anybody may have put there.
    pub fn decode(bytes: &[u8]) -> Self {
        let decoded: Option<Self> = serde_json::from_slice(bytes).ok();
        decoded.filter(|entry| is_name(&entry.worker)).unwrap_or_default()
    }
}

impl Member {
    /// The bytes of its object.
    pub fn encode(&self) -> Vec<u8> {
        serde_json::json!(self).to_string().into_bytes()
    }

    /// What an object says.
    pub fn decode(bytes: &[u8]) -> Option<Self> {
        serde_json::from_slice(bytes).ok()
    }
}
