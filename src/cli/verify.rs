//! `rockface store verify`: what is damaged or missing in a store, and the way out.

use rockface_cache::{FaultKind, HalfWritten, SegmentFault, SegmentFaultKind, Store, Verified};
use serde_json::json;

use super::table::bytes;
use super::{CliError, say};

/// Verifies a store and says what was found; with `repair`, sets aside what is damaged.
pub fn verify(store: &Store, repair: bool, as_json: bool) -> Result<(), CliError> {
    let found = store.verify(repair)?;
    if as_json {
        say(&json!(found).to_string());
    } else {
        for fault in &found.faults {
            let what =
                if fault.outputs.is_empty() { "no record names it".to_owned() } else { fault.outputs.join(", ") };
            let done = if fault.set_aside { "; set aside" } else { "" };
            let kind = format!("{:?}", fault.kind).to_lowercase();
            say(&format!("{kind:8} {}  {what}{done}", fault.digest.short()));
        }
        found.segment_faults.iter().for_each(|fault| say(&place_of(fault)));
        found.half_written.iter().for_each(|tail| say(&tail_of(tail)));
        let (blobs, size, records) = (found.blobs, bytes(found.bytes), found.records);
        say(&format!("read {blobs} blobs ({size}) of {records} records: {}", verdict(&found, repair)));
    }
    let is_whole = found.faults.is_empty() && found.segment_faults.is_empty();
    let is_repaired = repair && found.busy_segments == 0;
    if is_whole || is_repaired { Ok(()) } else { Err(CliError::Damaged) }
}

/// A line about a damaged place in a segment.
fn place_of(fault: &SegmentFault) -> String {
    let SegmentFault { kind, segment, at, bytes, lost } = fault;
    let what = match kind {
        SegmentFaultKind::Damaged => format!("{bytes} bytes are not what was written"),
        SegmentFaultKind::Unreadable => format!("{bytes} bytes are no entry of a store"),
        SegmentFaultKind::Cut => format!("{bytes} bytes that were there are missing"),
    };
    let kind = format!("{kind:?}").to_lowercase();
    format!("{kind:8} segment {segment}, byte {at}: {what}; lost: {lost}")
}

/// A line about the end of a segment that was not written to its end.
fn tail_of(tail: &HalfWritten) -> String {
    let HalfWritten { segment, at, bytes } = tail;
    let what = if *at == 0 && *bytes == 0 {
        "it is empty".to_owned()
    } else {
        format!("an entry was not written to its end; {bytes} bytes were skipped")
    };
    format!(
        "note     segment {segment}, byte {at}: {what}. A process that is killed leaves that, and it is no damage. If none was killed, the segment has been cut here, and the steps whose records are gone run again"
    )
}

/// The result of a verification and the remedy. Only what is damaged has to be set aside before a run recomputes it.
fn verdict(found: &Verified, repair: bool) -> String {
    let damaged = found.faults.iter().filter(|fault| fault.kind == FaultKind::Damaged).count();
    let (missing, places) = (found.faults.len() - damaged, found.segment_faults.len());
    let mut counts = format!("{damaged} damaged, {missing} missing");
    if places > 0 {
        counts += &format!(", {places} damaged places in segments");
    }
    let remedy = match (damaged + places, repair) {
        (0, _) if missing == 0 => return "all whole".to_owned(),
        (_, true) if found.busy_segments > 0 => format!(
            "{} segments are being written to and were left as they are: repeat this when no run is going on",
            found.busy_segments
        ),
        (_, true) if found.rewritten => {
            "the segments were written anew without them, and the next `rockface run` that needs them recomputes them".to_owned()
        }
        (0, _) | (_, true) => "the next `rockface run` that needs them recomputes them".to_owned(),
        (_, false) if places > 0 => {
            "`rockface store verify --repair` sets aside what is damaged and writes the segments anew without it, and the next `rockface run` that needs it recomputes it".to_owned()
        }
        (_, false) => {
            "`rockface store verify --repair` moves damaged blobs to quarantine, and the next `rockface run` that needs them recomputes them".to_owned()
        }
    };
    format!("{counts}; {remedy}")
}
