//! Two runs at once on one store, of which either or both are killed.

use std::process::{Output, Stdio};

use crate::place::{CHANGED, Place, RUN, ended};
use crate::shim::{Fault, Watched, shim};
use crate::{Draws, slow};

const KILL: Fault = Fault { what: "kill", lasts: false };

#[test]
fn of_two_runs_at_once_either_may_be_killed_at_any_call() {
    let Some(shim) = shim() else { return };
    let (whole, changed) = (Place::new(), Place::new());
    whole.succeed(&RUN).unwrap();
    changed.succeed(&CHANGED).unwrap();
    let (first, second) = (whole.digests().unwrap(), changed.digests().unwrap());
    let mut draws = Draws(5);
    let mut killed = [0; 2];
    let rounds = if slow() { 400 } else { 10 };
    for round in 0..rounds {
        let place = Place::new();
        // Both do the same, or each its own; either is killed, or both.
        let commands = [&RUN[..], if draws.chance(5) { &RUN } else { &CHANGED }];
        let victims = [[true, false], [false, true], [true, true]][draws.below(3) as usize];
        let children = [0, 1].map(|one| {
            let mut command = place.command(commands[one]);
            let at = if victims[one] { 1 + draws.below(150) } else { 0 };
            Watched::new(&mut command, shim, place.root()).fault(&KILL, at, &place.path(&format!("report-{one}")));
            command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap()
        });
        let outs: [Output; 2] = children.map(|child| child.wait_with_output().unwrap());
        for (one, out) in outs.iter().enumerate() {
            let ended = ended(out, victims[one], true).unwrap_or_else(|why| panic!("round {round}: {why}"));
            assert!(
                out.status.success() || victims[one],
                "round {round}: {ended:?} {}",
                String::from_utf8_lossy(&out.stderr)
            );
            killed[one] += usize::from(!out.status.success());
        }
        for (command, expected) in [(&RUN[..], &first), (&CHANGED, &second)] {
            place.goes_on(command, expected).unwrap_or_else(|why| panic!("round {round}: {why}"));
        }
    }
    println!("{rounds} rounds, {} and {} runs killed beside another", killed[0], killed[1]);
}
