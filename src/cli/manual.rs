//! `rockface manual`: what the program knows about itself, as pages for `man` and as the chapters of the reference.

use std::path::{Path, PathBuf};

use clap::{Args, CommandFactory, Subcommand};
use rockface_core::Registry;
use rockface_engine::watch::events;

use super::own_file::{check_place, failed, folder_of, write_own};
use super::{Cli, CliError, EXIT_CODES, environment, parts, say, stages};
use rockface_engine::pipeline::Pipeline;

/// The first line of every chapter, for those who want to edit one.
const WRITTEN: &str = "<!-- Written by `rockface manual reference`; a test holds it against the program. -->\n\n";

/// Arguments of `rockface manual`.
#[derive(Debug, Args)]
pub struct ManualArgs {
    #[command(subcommand)]
    what: What,
}

#[derive(Debug, Subcommand)]
enum What {
    /// Write pages for `man`, one a command, into a folder such as `~/.local/share/man/man1`.
    Pages {
        /// The folder, created if it does not exist.
        dir: PathBuf,
    },
    /// Write the chapters on commands, stages, parts and events as Markdown into a folder.
    Reference {
        /// The folder, created if it does not exist.
        dir: PathBuf,
    },
    /// Print the JSON Schema of the lines of `rockface run --json`.
    Events,
}

impl ManualArgs {
    /// Writes what is asked for.
    pub fn run(self, registry: &Registry) -> Result<(), CliError> {
        match self.what {
            What::Pages { dir } => write(&dir, &man_pages()?),
            What::Reference { dir } => write(&dir, &reference(registry)?),
            What::Events => {
                say(&schema_text());
                Ok(())
            }
        }
    }
}

fn schema_text() -> String {
    serde_json::to_string_pretty(&events::schema()).unwrap_or_default()
}

/// Writes files into a folder and says how many.
fn write(dir: &Path, files: &[(String, Vec<u8>)]) -> Result<(), CliError> {
    for (name, bytes) in files {
        let path = dir.join(name);
        check_place(&path)?;
        let written = std::fs::create_dir_all(folder_of(&path)).and_then(|()| write_own(&path, bytes));
        written.map_err(failed("write", &path))?;
    }
    say(&format!("{}: {} files", dir.display(), files.len()));
    Ok(())
}

/// The commands, each under the names that lead to it, in the order of `--help`.
fn commands() -> Vec<clap::Command> {
    fn collect(command: &clap::Command, prefix: &str, found: &mut Vec<clap::Command>) {
        let name =
            if prefix.is_empty() { command.get_name().to_owned() } else { format!("{prefix} {}", command.get_name()) };
        found.push(command.clone().bin_name(name.clone()).display_name(name.clone()));
        let inner = command.get_subcommands().filter(|inner| inner.get_name() != "help");
        inner.for_each(|inner| collect(inner, &name, found));
    }
    let mut root = Cli::command().name("rockface");
    root.build();
    let mut found = Vec::new();
    collect(&root, "", &mut found);
    found
}

/// A page of troff for each command.
fn man_pages() -> Result<Vec<(String, Vec<u8>)>, CliError> {
    let page = |command: clap::Command| {
        let name = command.get_bin_name().unwrap_or_default().replace(' ', "-");
        let mut bytes = Vec::new();
        let page = clap_mangen::Man::new(command.display_name(name.clone()));
        page.render(&mut bytes).map_err(CliError::Output)?;
        Ok((format!("{name}.1"), finished_page(&name, &String::from_utf8_lossy(&bytes)).into_bytes()))
    };
    commands().into_iter().map(page).collect()
}

/// A page with its heading, without references to `help`, which has no page, and with what holds for all commands at its end.
fn finished_page(name: &str, page: &str) -> String {
    let version = env!("CARGO_PKG_VERSION");
    let title = format!(".TH {} 1 \"\" \"rockface {version}\" \"User Commands\"", name.to_uppercase());
    let heading = |line: &str| match line {
        line if line.starts_with(".TH ") => title.clone(),
        ".SH EXTRA" if name == "rockface" => ".SH \"EXIT STATUS\"".to_owned(),
        line => line.to_owned(),
    };
    let mut entries: Vec<String> = page.lines().map(heading).collect();
    // An entry of a command is three lines: the macro, its name, what it does.
    let help = format!("{}\\-help(1)", name.replace('-', "\\-"));
    if let Some(at) = entries.iter().position(|line| *line == help) {
        entries.drain(at - 1..=at + 1);
    }
    let see = format!(
        ".SH \"EXIT STATUS\"\n{EXIT_CODES}\n.SH \"SEE ALSO\"\nrockface(1), which lists the variables of the environment\n"
    );
    let last = if name == "rockface" { environment::section() } else { see };
    format!("{}\n{last}", entries.join("\n"))
}

/// The chapters that the program writes, by their paths in the folder `docs/reference`.
fn reference(registry: &Registry) -> Result<Vec<(String, Vec<u8>)>, CliError> {
    let mut files = vec![
        ("commands.md".to_owned(), commands_chapter()),
        ("stages.md".to_owned(), stages_chapter(registry)),
        ("parts.md".to_owned(), parts_chapter(registry)?),
        (
            "environment.md".to_owned(),
            format!(
                "{WRITTEN}# Variables of the environment\n\nOptions have precedence over them.\n\n{}",
                environment::table()
            ),
        ),
        ("events.md".to_owned(), format!("{WRITTEN}{}", events::chapter())),
        ("events.schema.json".to_owned(), schema_text() + "\n"),
    ];
    for room in registry.rooms() {
        let mut text = format!("{WRITTEN}# {}\n\n{}\n", room.name, room.doc);
        for stage in room.stages {
            text += &format!("\n{}\n", deeper(&stages::page(*stage)));
        }
        files.push((format!("stages/{}.md", room.name), text));
    }
    Ok(files.into_iter().map(|(name, text)| (name, text.into_bytes())).collect())
}

/// Headings one level down; those inside code stay.
fn deeper(page: &str) -> String {
    let mut is_code = false;
    let line = |line: &str| {
        is_code ^= line.starts_with("```");
        if line.starts_with('#') && !is_code { format!("#{line}") } else { line.to_owned() }
    };
    page.lines().map(line).collect::<Vec<_>>().join("\n")
}

fn stages_chapter(registry: &Registry) -> String {
    let mut text =
        format!("{WRITTEN}# Stages\n\n`rockface stages NAME` shows the same page of a stage, `--json` for programs.\n");
    for room in registry.rooms() {
        text +=
            &format!("\n## [{0}](stages/{0}.md)\n\n{1}\n\n| stage | what it does |\n|---|---|\n", room.name, room.doc);
        for stage in room.stages {
            let name = stage.name();
            let anchor = format!("{name}-version-{}", stage.version());
            text += &format!("| [`{name}`](stages/{}.md#{anchor}) | {} |\n", room.name, stages::first_sentence(*stage));
        }
    }
    text
}

fn parts_chapter(registry: &Registry) -> Result<String, CliError> {
    let mut text = format!(
        "{WRITTEN}# Parts\n\nChains of steps that come with the program. `rockface parts NAME --text` prints one, to begin one of your own from.\n"
    );
    for part in registry.parts() {
        let interface = Pipeline::part(part.name, registry.parts()).map_err(CliError::Pipeline)?;
        text += &format!("\n{}\n", deeper(&parts::page(part.name, &interface)).replace("```yaml", "```text"));
    }
    Ok(text)
}

fn commands_chapter() -> String {
    let mut text = format!("{WRITTEN}# Commands\n\n`rockface COMMAND --help` shows the same in the terminal.\n");
    for mut command in commands() {
        let name = command.get_bin_name().unwrap_or_default().to_owned();
        text += &format!("\n## {name}\n\n{}\n", described(command.get_long_about().or_else(|| command.get_about())));
        let usage = command.render_usage().to_string();
        text += &format!("\n```text\n{}\n```\n", usage.trim_start_matches("Usage: ").trim());
        let inner: Vec<String> =
            command.get_subcommands().filter(|inner| inner.get_name() != "help").map(link(&name)).collect();
        if !inner.is_empty() {
            text += &format!("\n{}\n", inner.join("\n"));
        }
        let arguments: Vec<String> = command.get_arguments().filter(|arg| !arg.is_hide_set()).map(argument).collect();
        if !arguments.is_empty() {
            text += &format!("\n{}\n", arguments.join("\n"));
        }
        if let Some(after) = command.get_after_help() {
            text += &format!("\n{after}\n");
        }
    }
    text
}

/// A line that leads to a command inside another.
fn link(outer: &str) -> impl Fn(&clap::Command) -> String {
    move |inner| {
        let name = inner.get_name();
        let anchor = format!("{outer} {name}").replace(' ', "-");
        format!("- [`{name}`](#{anchor}): {}", described(inner.get_about()))
    }
}

/// Help as a sentence that ends.
fn described(help: Option<&clap::builder::StyledStr>) -> String {
    let text = help.map(ToString::to_string).unwrap_or_default();
    let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
    if text.is_empty() || text.ends_with(['.', ':', '`']) { text } else { format!("{text}.") }
}

/// An argument or option with what it takes, its default, its variable and its values.
fn argument(arg: &clap::Arg) -> String {
    let values = arg.get_value_names().unwrap_or_default().iter().map(ToString::to_string).collect::<Vec<_>>();
    let takes = arg.get_num_args().is_none_or(|count| count.takes_values())
        && !matches!(
            arg.get_action(),
            clap::ArgAction::SetTrue
                | clap::ArgAction::Help
                | clap::ArgAction::HelpShort
                | clap::ArgAction::HelpLong
                | clap::ArgAction::Version
        );
    let value = if takes { format!("<{}>", values.join("> <")) } else { String::new() };
    let flag = match (arg.get_short(), arg.get_long()) {
        (Some(short), Some(long)) => format!("-{short}, --{long}"),
        (Some(short), None) => format!("-{short}"),
        (None, Some(long)) => format!("--{long}"),
        (None, None) => String::new(),
    };
    let name = format!("{flag} {value}");
    let name = name.trim();
    let mut text = format!("- `{name}`: {}", described(arg.get_long_help().or_else(|| arg.get_help())));
    let defaults: Vec<_> = arg.get_default_values().iter().map(|value| value.to_string_lossy().into_owned()).collect();
    if takes && !defaults.is_empty() {
        text += &format!(" Default: `{}`.", defaults.join(" "));
    }
    if let Some(variable) = arg.get_env() {
        text += &format!(" Variable: `{}`.", variable.to_string_lossy());
    }
    let possible = if takes { arg.get_possible_values() } else { Vec::new() };
    for value in possible.iter().filter(|value| !value.is_hide_set()) {
        let help = described(value.get_help());
        let help = if help.is_empty() { help } else { format!(": {help}") };
        text += &format!("\n  - `{}`{help}", value.get_name());
    }
    text
}
