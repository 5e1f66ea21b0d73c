//! The store of rockface: blobs by the digest of their bytes, records by the key of their recipe.
//!
//! The crate knows bytes, digests and recipes. It knows no stage, no pipeline and no engine. [`Store`] keeps blobs, records and the
//! digests of files outside; [`Memory`] is what the engine remembers in the same folder to save time: former runs, notes beside
//! records, answers to former commands, parsed texts. A store without that memory gives the same results.
//! A step whose [`Recipe`] has a [`Record`] in the store need not run.
//!
//! # Invariants
//!
//! - **Nothing is ever edited.** A blob is named by the BLAKE3 of its bytes; segments only grow (and lose a torn tail
//!   when a new writer continues them; a collection writes new ones and then removes the old); a later record of the same key supersedes the earlier one, which stays.
//! - **Blobs before records.** A record is appended after the blobs it names, and made durable no earlier than they are. Should
//!   a power cut break that order on disk, the record names a blob that is not there and simply is not a hit.
//! - **Every read is verified.** What a frame or a blob says is checked against its checksum or digest when it is used, be
//!   it read or linked; a damaged blob is set aside in `quarantine/` and reported.
//! - **No name is believed.** What a record, a manifest or a folder of the store says was written by anybody: it becomes
//!   part of a path only as a [`SafeName`] or [`SafePath`], and links in the store are not followed.
//! - **Nothing to unlock.** All locks are kernel advisory locks, gone with the process that held them; what ends before is
//!   unlocked, not merely closed, since a program that is being started has a copy of every open file.
//! - **No state outside the folder** of the store, and none in it that only the process which wrote it could use.
//!
//! # Layout
//!
//! ```text
//! format          the format version, one line
//! keys.lock       empty; its bytes are locked for the keys being computed now, one of them by collections, and for the
//!                 values that live processes have at hand though they are not kept
//! CACHEDIR.TAG    marks the folder for backup programs to skip
//! blobs/ab/abcd…  blobs of 64 KiB and more, one file each, read-only
//! segments/*.seg  append-only frames: small blobs, records, notes, file digests; one live writer each
//! live/           one file for each process that runs something: the records it references
//! quarantine/     damaged blobs
//! trees/          at most 16: long texts, parsed
//! scratch/        folders in which programs work now, and through which live processes hand values to each other
//! tmp/            blobs being written
//! workers/        one file for each process that runs something: who it is, and what it last reported
//! leases/         on a store that several machines use: further names of these files, one for each step being computed
//! answers/        at most 256: the result of a former command, and the state of all it rests on
//! remotes/        records of remote places, as they were fetched
//! ```

#![cfg_attr(not(test), warn(clippy::print_stdout, clippy::print_stderr, clippy::exit))]

mod blobs;
mod canonical;
mod digest;
mod error;
mod files;
mod frame;
mod index;
mod journal;
mod lease;
mod leases;
mod locks;
mod machine;
mod maintenance;
mod materialise;
mod memory;
mod names;
mod open;
mod outputs;
mod parcel;
mod plain;
mod recipe;
mod record;
pub mod remote;
mod rewrite;
mod scratch;
mod seal;
mod segment;
mod sharing;
mod store;
mod syncer;
mod values;
mod workers;

pub use digest::{Digest, DigestError};
pub use error::StoreError;
pub use files::FileDigest;
pub use lease::Live;
pub use locks::{Announced, KeyLock};
pub use machine::shared_setting;
pub use maintenance::{Collected, Fault, FaultKind, GcItem, GcPlan, GcPolicy, Handed, StageStat, Verified};
pub use maintenance::{HalfWritten, SegmentFault, SegmentFaultKind};
pub use materialise::{Materialised, readable_file};
pub use memory::{Grounds, Memory, RunNote, Seen, State, mark, read_plain, recall, trees};
pub use names::{NameError, SafeName, SafePath};
pub use outputs::Outputs;
pub use parcel::Parcel;
pub use plain::open_with as open_plain;
pub use recipe::{Gathered, Recipe, RecipeInput, SeedMaterial, shared};
pub use record::{Cost, Outcome, OutputRecord, Record};
pub use scratch::Scratch;
pub use seal::Damage;
pub use store::{Store, StoreStat};
pub use values::{Room, Want};
pub use workers::WorkerReport;
