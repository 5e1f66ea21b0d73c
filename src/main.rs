//! The program `rockface`.

use std::io::IsTerminal;

use clap::Parser;
use tracing_subscriber::EnvFilter;

fn main() {
    let filter = EnvFilter::try_from_env("ROCKFACE_LOG").unwrap_or_else(|_| EnvFilter::new("warn"));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    std::panic::set_hook(Box::new(tell_panic));
    let result = rockface::cli::Cli::parse().run(rockface_stages::registry());
    if let Err(error) = result {
        let message = error.render(std::io::stderr().is_terminal());
        if !message.is_empty() {
            rockface::cli::complain(&message);
        }
        std::process::exit(error.exit_code());
    }
}

/// A worker that breaks down is reported as the failure of its step, with what it said; not twice. Nobody else tells of
/// the main thread.
fn tell_panic(panic: &std::panic::PanicHookInfo) {
    if std::thread::current().name() == Some("main") {
        rockface::cli::complain(&format!("error: rockface broke down: {panic}\nplease report it with the pipeline"));
    } else {
        tracing::debug!("{panic}");
    }
}
