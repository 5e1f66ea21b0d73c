//! How a program ended and what it said, in words.

use crate::program::ProgramResult;
use crate::{Context, StageError};

/// How many of the last lines a program said are told.
const LAST_LINES: usize = 12;

/// Signals that end programs: number, name, and what it mostly means.
const SIGNALS: [(i32, &str, &str); 13] = [
    (1, "SIGHUP", "its terminal went away"),
    (2, "SIGINT", "it was interrupted"),
    (3, "SIGQUIT", "it was told to quit"),
    (4, "SIGILL", "it was built for another processor"),
    (6, "SIGABRT", "it gave up by itself"),
    (7, "SIGBUS", "it used memory that is not there"),
    (8, "SIGFPE", "it divided by zero"),
    (9, "SIGKILL", "it was killed from outside, perhaps because memory ran out"),
    (11, "SIGSEGV", "it broke down: a fault of the program"),
    (13, "SIGPIPE", "nobody read what it wrote"),
    (15, "SIGTERM", "it was told to end from outside"),
    (24, "SIGXCPU", "its limit of processor time was reached"),
    (25, "SIGXFSZ", "its limit of file size was reached"),
];

/// Refuses any end but that with code 0.
pub fn well(program: &str, result: &ProgramResult) -> Result<(), StageError> {
    if result.exit_code == Some(0) { Ok(()) } else { Err(ended(program, result)) }
}

/// The error of a program that was not to end, or not like this.
pub fn ended(program: &str, result: &ProgramResult) -> StageError {
    let how = match (result.exit_code, result.signal) {
        (Some(code), _) => format!("ended with code {code}"),
        (None, Some(signal)) => format!("was ended by {}", named(signal)),
        (None, None) => "did not end by itself".to_owned(),
    };
    StageError::new(format!("`{program}` {how}{}", last_words(&result.stderr)))
}

/// Keeps what a program said in the step's log.
pub fn tell(context: &Context, result: &ProgramResult) {
    for (name, text) in [("standard output", &result.stdout), ("standard error", &result.stderr)] {
        if !text.trim().is_empty() {
            context.note(format!("{name}:\n{}", text.trim_end()));
        }
    }
}

fn named(signal: i32) -> String {
    let known = SIGNALS.iter().find(|(number, ..)| *number == signal);
    known.map_or_else(
        || format!("signal {signal}"),
        |(number, name, means)| format!("{name} (signal {number}: {means})"),
    )
}

/// The end of what a program said.
fn last_words(stderr: &str) -> String {
    let lines: Vec<&str> = stderr.trim_end().lines().collect();
    let last = lines[lines.len().saturating_sub(LAST_LINES)..].join("\n  ");
    if last.is_empty() { " and said nothing on standard error".to_owned() } else { format!(", saying\n  {last}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_is_told_with_the_name_of_its_signal() {
        let told = |exit_code, signal| {
            let result = ProgramResult { exit_code, signal, stderr: "one\ntwo\n".into(), ..ProgramResult::default() };
            well("tool", &result).map_err(|error| error.message)
        };
        assert_eq!(told(Some(0), None), Ok(()));
        assert_eq!(told(Some(3), None), Err("`tool` ended with code 3, saying\n  one\n  two".to_owned()));
        assert!(told(None, Some(11)).is_err_and(|text| text.contains("by SIGSEGV (signal 11: it broke down")));
        assert!(told(None, Some(40)).is_err_and(|text| text.contains("by signal 40, saying")));
    }
}
