//! What a run tells those who watch it: one list of events, several ways to show them.

pub mod events;
mod foxglove;
mod json;
mod mcap_log;
mod plain;
mod reported;
pub mod step_log;
mod terminal;
mod topic;

pub use foxglove::layout;
pub use json::JsonLines;
pub use mcap_log::{Facts, RunLog, StepNote};
pub use plain::{Alike, Plain};
pub use reported::{Report, Reported, Role};
pub use terminal::Terminal;
pub use topic::{Made, Topic};

use serde::Serialize;

/// Something that happened in a run. The order of [`Event::Started`] and [`Event::Finished`] depends on the machine;
/// what is executed and what is cached does not.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "event")]
pub enum Event {
    /// The plan is made and the run begins.
    Planned {
        /// Number of step instances.
        steps: usize,
    },
    /// An instance is known already.
    Cached {
        /// The step instance, as `step[axis=item]`.
        step: String,
    },
    /// A worker took up an instance.
    Started {
        /// The step instance, as `step[axis=item]`.
        step: String,
        /// Why it is not taken from the store.
        reason: Reason,
    },
    /// An instance is done.
    Finished {
        /// The step instance, as `step[axis=item]`.
        step: String,
        /// Wall time in seconds.
        wall_s: f64,
    },
    /// An instance could start and waits until there is memory for it.
    Held {
        /// The step instance, as `step[axis=item]`.
        step: String,
        /// What it is expected to need, bytes.
        need_bytes: u64,
    },
    /// Another process has the instance, or has had it: it is not run here for now. An [`Event::Started`] of it before is taken
    /// back.
    Elsewhere {
        /// The step instance, as `step[axis=item]`.
        step: String,
    },
    /// Another process computes the same; this one waits for it.
    Waiting {
        /// The step instance, as `step[axis=item]`.
        step: String,
    },
    /// Something may be wrong.
    Warning {
        /// The step instance, as `step[axis=item]`.
        step: String,
        /// What is wrong, one sentence.
        text: String,
    },
    /// A stage gave an error, or its output cannot be the items of an axis.
    Failed {
        /// The step instance, as `step[axis=item]`.
        step: String,
        /// The stage it uses.
        stage: String,
        /// What went wrong, without the way out.
        message: String,
        /// What the user can do about it.
        hint: Option<String>,
    },
}

/// Why an instance runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Reason {
    /// Its recipe has no record.
    New,
    /// It is recorded, but its outputs were not kept and are needed.
    Needed,
}

/// How far a run is.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Progress {
    /// Instances that are done, cached ones included.
    pub done: usize,
    /// All step instances that are known.
    pub total: usize,
    /// Estimated seconds to the end, once something has been timed.
    pub remaining_s: Option<f64>,
}

/// Someone who watches a run.
pub trait Observer {
    /// Called for each event of the run, with how far the run is.
    fn event(&mut self, event: &Event, progress: Progress);
    /// Called several times a second while nothing happens.
    fn idle(&mut self, _: Progress) {}
    /// Whether it has no use for [`Event::Cached`], of which there may be very many.
    fn ignores_cached(&self) -> bool {
        false
    }
    /// The run is over; leave the screen in order.
    fn end(&mut self) {}
}

/// Shows nothing, for callers that only want the result.
pub struct Silent;

impl Observer for Silent {
    fn event(&mut self, _: &Event, _: Progress) {}
    fn ignores_cached(&self) -> bool {
        true
    }
}

/// Keeps every event: the oracle of tests.
#[derive(Debug, Default)]
pub struct Events(pub Vec<Event>);

impl Observer for Events {
    fn event(&mut self, event: &Event, _: Progress) {
        self.0.push(event.clone());
    }
}

/// Seconds as people say them: `0.4 s`, `12 s`, `3 min 20 s`, `2 h 05 min`.
pub fn duration(seconds: f64) -> String {
    let whole = seconds.round() as u64;
    match whole {
        0..10 => format!("{seconds:.1} s"),
        10..120 => format!("{whole} s"),
        120..7200 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
    }
}

/// A time as RFC 3339 writes it, to the second. One beyond its years, as damaged files may tell, is the nearest it has.
pub fn moment(since_1970_s: f64) -> String {
    // 9999-12-31T23:59:59Z.
    const LAST_S: f64 = 253_402_300_799.0;
    let since = std::time::Duration::try_from_secs_f64(since_1970_s.clamp(0.0, LAST_S)).unwrap_or_default();
    humantime::format_rfc3339_seconds(std::time::UNIX_EPOCH + since).to_string()
}

#[cfg(test)]
mod tests {
    #[test]
    fn no_time_is_too_late_to_be_written() {
        let written = [1.7e9, -1.0, f64::NAN, u64::MAX as f64, f64::INFINITY].map(super::moment);
        let (first, last) = ("1970-01-01T00:00:00Z", "9999-12-31T23:59:59Z");
        assert_eq!(written, ["2023-11-14T22:13:20Z", first, first, last, last]);
    }

    #[test]
    fn durations_read_well() {
        let said = [0.04, 9.96, 119.0, 200.4, 7500.0].map(super::duration);
        assert_eq!(said, ["0.0 s", "10 s", "119 s", "3 min 20 s", "2 h 05 min"]);
    }
}
