//! Power cuts: two runs are recorded call by call, and then the power fails at any of them.
//!
//! Whatever is left, no step is lost that was synced, nothing torn is taken for whole, and the next run succeeds with the
//! same bytes. The folders are those of the record: what a store says of run folders is by absolute path.

use std::collections::BTreeSet;
use std::path::Path;

use rockface_cache::{Digest, Store};

use crate::disk::{Call, Disk, Names, read_log};
use crate::place::{CHANGED, Digests, PIPELINE, Place, RUN, Verdict, is_whole};
use crate::shim::{Watched, shim};
use crate::{Draws, slow};

/// Two runs that were recorded, one after the other, and what they made.
struct Scene {
    place: Place,
    calls: Vec<Call>,
    expected: [Digests; 2],
}

impl Scene {
    fn new(shim: &Path) -> Self {
        let (place, aside) = (Place::new(), tempfile::tempdir().unwrap());
        let log = aside.path().join("log");
        let expected = [&RUN[..], &CHANGED].map(|arguments| {
            let mut command = place.command(arguments);
            Watched::new(&mut command, shim, place.root()).log(&log);
            assert!(command.output().unwrap().status.success());
            place.digests().unwrap()
        });
        Self { calls: read_log(&log), place, expected }
    }

    /// The records that are there and whose blobs are.
    fn hits(&self) -> Verdict<BTreeSet<Digest>> {
        let dir = self.place.path(".rockface/store");
        if !dir.join("format").exists() {
            return Ok(BTreeSet::new());
        }
        let store = Store::open(&dir).map_err(|error| error.to_string())?;
        let is_readable = |key: &Digest| {
            let record = store.is_hit(key)?;
            // Read, so that what merely looks whole does not count.
            record.blobs().all(|(digest, _)| store.get(&digest).is_ok()).then_some(*key)
        };
        Ok(store.keys().iter().filter_map(is_readable).collect())
    }

    /// The records that each sync of a segment made durable, with the number of the call: those that were there when
    /// it began, with the folders their blobs are in.
    fn promises(&self) -> Vec<(usize, BTreeSet<Digest>)> {
        let store = self.place.path(".rockface/store");
        let mut disk = Disk::new(self.place.root(), Names::Journal);
        let (mut promises, mut begun) = (Vec::new(), None);
        for (number, call) in self.calls.iter().enumerate() {
            let is_end = call.syncs_file_in(&store.join("segments"));
            if (is_end || call.syncs_folder_in(&store)) && begun.is_none() {
                disk.write_all();
                begun = Some(self.hits().unwrap());
            }
            disk.play(call);
            if let Some(keys) = begun.take_if(|_| is_end) {
                promises.push((number, keys));
            }
        }
        promises
    }

    /// The power fails after the first `count` calls.
    fn cut(&self, count: usize, names: Names, promised: &BTreeSet<Digest>, draws: &mut Draws) -> Verdict {
        let mut disk = Disk::new(self.place.root(), names);
        self.calls[..count].iter().for_each(|call| disk.play(call));
        disk.write_what_is_left(draws);
        // The pipeline was there before.
        std::fs::write(self.place.path("p.yaml"), PIPELINE).unwrap();
        // Either asks first, so that each meets what the cut left.
        let mut ways = [(&RUN[..], &self.expected[0]), (&CHANGED, &self.expected[1])];
        if draws.chance(5) {
            ways.reverse();
        }
        // The shortest way: a run that trusts what former runs left.
        if draws.chance(5) {
            self.place.succeed(ways[0].0)?;
            self.place.has_run(ways[0].1)?;
        }
        let lost: Vec<String> = promised.difference(&self.hits()?).map(Digest::short).collect();
        if !lost.is_empty() {
            return Err(format!("records that were synced are lost: {}", lost.join(", ")));
        }
        for (arguments, expected) in ways {
            self.place.runs_again(arguments, expected)?;
        }
        // Not before: of a record that was not synced a blob may be lost, until its step is run again.
        is_whole(&self.place.path(".rockface/store"))
    }
}

#[test]
fn whenever_the_power_fails_nothing_torn_is_accepted_and_nothing_synced_is_lost() {
    let Some(shim) = shim() else { return };
    let scene = Scene::new(shim);
    let promises = scene.promises();
    assert!(promises.last().is_some_and(|(_, keys)| keys.len() >= 5), "two runs were recorded: {promises:?}");
    let only = std::env::var("CRASH_CUT").ok().map(|seed| seed.parse().unwrap());
    let seeds = only.map_or(0..if slow() { 2000 } else { 24 }, |seed: u64| seed..seed + 1);
    let (count, mut faults) = (seeds.clone().count(), Vec::new());
    for seed in seeds {
        let mut draws = Draws(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        draws.below(1);
        let calls = 1 + draws.below(scene.calls.len() as u64) as usize;
        let names = if draws.chance(5) { Names::Journal } else { Names::Strict };
        let nothing = BTreeSet::new();
        let promised = promises.iter().rev().find(|(number, _)| *number < calls).map_or(&nothing, |(_, keys)| keys);
        if let Err(why) = scene.cut(calls, names, promised, &mut draws) {
            faults.push(format!("CRASH_CUT={seed}, {names:?}, after {calls} of {} calls: {why}", scene.calls.len()));
        }
    }
    println!("{count} power cuts in {} calls, {} not survived", scene.calls.len(), faults.len());
    assert!(faults.is_empty(), "{}", faults.iter().take(40).map(String::as_str).collect::<Vec<_>>().join("\n"));
}
