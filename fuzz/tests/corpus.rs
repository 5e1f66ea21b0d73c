//! The sound files and every file that once brought a reader down: none may do so again.

use std::process::Command;

#[test]
fn corpus_and_regressions_are_stood() {
    let check = Command::new(env!("CARGO_BIN_EXE_rockface-fuzz")).args(["check", "--seconds", "0"]).output();
    let check = check.expect("the program of this package starts");
    assert!(
        check.status.success(),
        "{}{}",
        String::from_utf8_lossy(&check.stdout),
        String::from_utf8_lossy(&check.stderr)
    );
}
