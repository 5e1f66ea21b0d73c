//! The whole program around a command: logging, messages, exit codes. A program of your own calls it with its registry.

use std::io::IsTerminal;

use clap::Parser;
use rockface_core::Registry;
use tracing_subscriber::EnvFilter;

use crate::cli::{Cli, output};

/// Runs the command line of this process with these stages; returns the exit code.
///
/// ```no_run
/// let registry = rockface_stages::registry();
/// std::process::exit(rockface::program::run(registry));
/// ```
pub fn run(registry: &Registry) -> i32 {
    let filter = EnvFilter::try_from_env("ROCKFACE_LOG").unwrap_or_else(|_| EnvFilter::new("warn"));
    // Where standard error cannot be written to, saying so there would be a panic.
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).log_internal_errors(false).init();
    std::panic::set_hook(Box::new(tell_panic));
    match Cli::try_parse() {
        Ok(cli) => run_command(cli, registry),
        Err(answer) => print(&answer),
    }
}

/// Runs a command and prints why it failed, if it did; returns the exit code.
fn run_command(cli: Cli, registry: &Registry) -> i32 {
    let Err(error) = cli.run(registry) else { return 0 };
    // See <https://no-color.org>: any text but an empty one.
    let is_plain = std::env::var_os("NO_COLOR").is_some_and(|value| !value.is_empty());
    let message = error.render(std::io::stderr().is_terminal() && !is_plain);
    if !message.is_empty() {
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
