//! The variables of the environment that the program reads.

use tracing_subscriber::EnvFilter;

use super::CliError;

/// Each with what it says.
pub const VARIABLES: &[(&str, &str)] = &[
    ("ROCKFACE_STORE", "The store, as `--store`."),
    ("ROCKFACE_REMOTE", "The address of a remote store, as `--remote`."),
    ("ROCKFACE_REMOTE_READ_ONLY", "`1` or `true`: nothing is uploaded to it, as `--remote-read-only`."),
    ("ROCKFACE_REMOTE_TIMEOUT", "Longest time of a request to it before data flows, seconds; 20 by default."),
    (
        "ROCKFACE_NO_COMMANDS",
        "`1` or `true`: pipelines with steps that start programs are refused, as `--no-commands`.",
    ),
    (
        "ROCKFACE_SHARED_STORE",
        "`yes` or `no`: whether other machines use the store too; by default what its file system says.",
    ),
    ("ROCKFACE_MACHINE", "The name by which machines on one store tell themselves apart, letters and digits."),
    (
        "ROCKFACE_PYTHON",
        "The Python of `python` steps; by default the `python3` beside the program, else the one on the search path.",
    ),
    ("ROCKFACE_BIN", "Read by the Python package: the program that it starts."),
    (
        "ROCKFACE_LOG",
        "How much of what the engine does is printed: `info`, `debug`, `trace`, or a filter of the crate tracing.",
    ),
    ("NO_COLOR", "Any text but an empty one: no colours."),
    ("TERM", "`dumb`, or not set: `inspect` draws no pictures in the terminal."),
    ("PYTHONPATH", "Where Python finds packages, with `VIRTUAL_ENV` and `CONDA_PREFIX`; for `python` steps."),
    (
        "AWS_…, GOOGLE_…, AZURE_…",
        "Credentials and settings of remote places, under the names that the tools of each provider use.",
    ),
    ("HOME", "The home folder: where the state is, and what `command` and `python` steps are given."),
    ("PATH", "Where programs of `command` and `python` steps are found."),
    ("TMPDIR", "Where temporary files are written, `/tmp` by default."),
    (
        "XDG_STATE_HOME",
        "`rockface/key` in it is a secret of the user that marks what was verified; `~/.local/state` by default.",
    ),
    ("MIMALLOC_PURGE_DELAY", "After how many milliseconds freed memory is given back to the system."),
];

/// As a table in Markdown.
pub fn table() -> String {
    let row = |(name, text): &(&str, &str)| format!("| `{name}` | {text} |\n");
    format!("| variable | what it says |\n|---|---|\n{}", VARIABLES.iter().map(row).collect::<String>())
}

/// As a section of a page for `man`.
pub fn section() -> String {
    let entry = |(name, text): &(&str, &str)| format!(".TP\n\\fB{name}\\fR\n{}\n", text.replace('`', ""));
    format!(".SH ENVIRONMENT\n{}", VARIABLES.iter().map(entry).collect::<String>())
}

/// What `ROCKFACE_LOG` asks for, warnings by default.
///
/// # Errors
/// It, or another variable that is yes or no, has a value without a meaning.
pub fn settings() -> Result<EnvFilter, CliError> {
    rockface_cache::shared_setting().map_err(CliError::Usage)?;
    let wanted = std::env::var("ROCKFACE_LOG").ok().filter(|text| !text.is_empty());
    let text = wanted.as_deref().unwrap_or("warn");
    EnvFilter::try_new(text).map_err(|error| {
        CliError::Usage(format!(
            "the variable ROCKFACE_LOG is `{text}`: {error}; `info`, `debug` or `rockface_engine=debug` can be said"
        ))
    })
}
