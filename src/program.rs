//! The whole program around a command: logging, messages, exit codes. A program of your own calls it with its registry.

use std::io::IsTerminal;

use clap::Parser;
use rockface_core::Registry;
use tracing_subscriber::EnvFilter;
use tracing_subscriber::filter::filter_fn;
use tracing_subscriber::prelude::*;

use crate::cli::{Cli, CliError, check_own, environment, output};
use crate::trace::{self, Trace, is_phase};

/// Runs the command line of this process with these stages; returns the exit code.
///
/// ```no_run
/// let registry = rockface_stages::registry();
/// std::process::exit(rockface::program::run(registry));
/// ```
pub fn run(registry: &Registry) -> i32 {
    std::panic::set_hook(Box::new(tell_panic));
    if crate::cli::answer(registry) {
        return 0;
    }
    match Cli::try_parse() {
        Ok(cli) => run_command(cli, registry),
        Err(answer) => print(&answer),
    }
}

/// Says on standard error what is worth a warning, or what `ROCKFACE_LOG` asks for; records spans where they are wanted.
fn listen(filter: EnvFilter, trace: Option<Trace>) {
    // Where standard error cannot be written to, saying so there would be a panic.
    let said = tracing_subscriber::fmt::layer().with_writer(std::io::stderr).log_internal_errors(false);
    let said = said.with_ansi(is_coloured());
    let recorded = trace.map(|trace| trace.with_filter(filter_fn(is_phase)));
    tracing_subscriber::registry().with(said.with_filter(filter)).with(recorded).init();
}

/// Whether what is said on standard error has colours.
fn is_coloured() -> bool {
    std::io::stderr().is_terminal() && !output::is_plain()
}

/// Runs a command and prints why it failed, if it did; returns the exit code.
fn run_command(cli: Cli, registry: &Registry) -> i32 {
    let filter = match environment::settings() {
        Ok(filter) => filter,
        Err(error) => return failed(&error),
    };
    let checked = cli.trace_file().map_or(Ok(()), |file| check_own(file, 0, trace::BEGINS, "trace"));
    let file = cli.trace_file().filter(|_| checked.is_ok());
    let trace = file.map(|file| (Trace::begin(), file.to_owned()));
    listen(filter, trace.as_ref().map(|(trace, _)| trace.clone()));
    let result = checked.and_then(|()| cli.run(registry));
    let written =
        trace.map_or(Ok(()), |(trace, path)| trace.write(&path).map_err(|source| CliError::Trace { path, source }));
    let result = result.and(written);
    result.map_or_else(|error| failed(&error), |()| 0)
}

/// Prints why a command failed; returns the exit code.
fn failed(error: &CliError) -> i32 {
    let message = error.render(is_coloured());
    if !message.is_empty() && is_coloured() {
        output::complain_in_colour(&message);
    } else if !message.is_empty() {
        output::complain(&message);
    }
    error.exit_code()
}

/// Prints what clap has to say: what is wrong with the command, or help and version, which are results.
fn print(answer: &clap::Error) -> i32 {
    let written = answer.print();
    if answer.use_stderr() {
        return answer.exit_code();
    }
    output::note(written);
    output::fault().map_or(0, |fault| {
        output::complain(&format!("error: cannot write to standard output: {fault}"));
        3
    })
}

/// Reports a panic of the main thread. A panic of a worker is reported as the failure of its step.
fn tell_panic(panic: &std::panic::PanicHookInfo) {
    if std::thread::current().name() == Some("main") {
        output::complain(&format!("error: rockface panicked: {panic}\nplease report it with the pipeline"));
    } else {
        tracing::debug!("{panic}");
    }
}
