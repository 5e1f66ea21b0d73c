//! `rockface submit`: starts workers through the cluster's own queue.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use clap::Args;
use rockface_core::Registry;

use super::capacity::MemoryArgs;
use super::programs::ProgramArgs;
use super::{CliError, PipelineArgs, say};

/// Arguments of `rockface submit`.
#[derive(Debug, Args)]
#[command(group = clap::ArgGroup::new("queue").required(true).args(["slurm", "hyperqueue"]))]
pub struct SubmitArgs {
    #[command(flatten)]
    pipeline: PipelineArgs,
    #[command(flatten)]
    programs: ProgramArgs,
    /// Submit to Slurm with these options, such as `--array=0-7 --cpus-per-task=4 --time=2:00:00`: one worker for each task.
    #[arg(long, value_name = "OPTIONS", allow_hyphen_values = true)]
    slurm: Option<String>,
    /// Submit to HyperQueue with these options, such as `--array=0-7 --cpus=4`: one worker for each task.
    #[arg(long, value_name = "OPTIONS", allow_hyphen_values = true)]
    hyperqueue: Option<String>,
    #[command(flatten)]
    memory: MemoryArgs,
    /// The folder that contains the run folders [default: `.rockface/runs` beside the pipeline].
    #[arg(long, value_name = "DIR")]
    runs: Option<PathBuf>,
    /// After a failed step, continue with steps that do not depend on it.
    #[arg(long)]
    keep_going: bool,
    /// Print what would be submitted, and submit nothing.
    #[arg(long)]
    dry_run: bool,
}

impl SubmitArgs {
    /// Submits an array of workers, the first of which writes the run folder.
    pub fn run(mut self, registry: &Registry) -> Result<(), CliError> {
        let name = self.pipeline.pipeline.clone();
        self.pipeline.take()?;
        self.pipeline.no_programs = self.programs.are_refused();
        // Faults show now, and not when the queue comes to it.
        let pipeline = self.pipeline.load(registry)?;
        self.programs.check(registry, &pipeline, &self.pipeline.target)?;
        drop(self.pipeline.look(registry, &pipeline, &self.pipeline.target)?);
        let arguments = self.arguments(&name)?;
        match (&self.slurm, &self.hyperqueue) {
            (Some(options), _) => self.slurm(options, &pipeline.document.name, &arguments),
            (_, Some(options)) => self.hyperqueue(options, &pipeline.document.name, &arguments),
            _ => Ok(()),
        }
    }

    /// What every worker is told, behind its verb.
    fn arguments(&self, pipeline: &Path) -> Result<Vec<String>, CliError> {
        let mut told = vec![if pipeline.is_file() { absolute(pipeline)? } else { pipeline.display().to_string() }];
        told.extend(["--store".to_owned(), absolute(&self.pipeline.store_dir())?]);
        let given = &self.pipeline;
        for (option, values) in [("--target", &given.target), ("--set", &given.set), ("--sweep", &given.sweep)] {
            told.extend(values.iter().flat_map(|value| [option.to_owned(), value.clone()]));
        }
        told.extend(given.recorded_inputs.then(|| "--recorded-inputs".to_owned()));
        told.extend(given.seed.iter().flat_map(|seed| ["--seed".to_owned(), seed.to_string()]));
        told.extend(given.remote.told());
        told.extend(self.memory.told());
        told.extend(self.keep_going.then(|| "--keep-going".to_owned()));
        told.extend(self.programs.are_refused().then(|| "--no-commands".to_owned()));
        Ok(told)
    }

    /// The options for the one worker that writes the run folder.
    fn of_run(&self) -> Result<Vec<String>, CliError> {
        let runs = self.runs.as_deref().map(absolute).transpose()?;
        Ok(runs.into_iter().flat_map(|runs| ["--runs".to_owned(), runs]).collect())
    }

    fn slurm(&self, options: &str, name: &str, arguments: &[String]) -> Result<(), CliError> {
        if options.contains(['\n', '\r']) {
            return Err(CliError::Usage("--slurm: give the options in one line".to_owned()));
        }
        let name: String = name.chars().map(|letter| if letter.is_alphanumeric() { letter } else { '-' }).collect();
        let roles =
            roles("[ \"${SLURM_ARRAY_TASK_ID:-0}\" = \"${SLURM_ARRAY_TASK_MIN:-0}\" ]", &self.of_run()?, arguments)?;
        let script = format!(
            "#!/bin/sh\n#SBATCH --job-name=rockface-{name}\n#SBATCH --output=rockface-%A_%a.log\n#SBATCH {options}\n\
             jobs=${{SLURM_CPUS_PER_TASK:-1}}\n{roles}"
        );
        if self.dry_run {
            say(script.trim_end());
            return Ok(());
        }
        let mut sbatch = started(Command::new("sbatch").stdin(Stdio::piped()), "sbatch")?;
        if let Some(mut stdin) = sbatch.stdin.take() {
            // If it ends without reading, its exit tells why.
            drop(stdin.write_all(script.as_bytes()));
        }
        ended(sbatch, "sbatch")
    }

    fn hyperqueue(&self, options: &str, name: &str, arguments: &[String]) -> Result<(), CliError> {
        let options = words(options)?;
        let first = least_task(&options)?;
        let roles = roles(&format!("[ \"${{HQ_TASK_ID:-{first}}}\" = {first} ]"), &self.of_run()?, arguments)?;
        let script = format!("jobs=$(echo \"${{HQ_CPUS:-1}}\" | tr ',' ' ' | wc -w)\n{roles}");
        let mut command = vec!["submit".to_owned(), "--name".to_owned(), format!("rockface-{name}")];
        command.extend(options);
        command.extend(["--", "/bin/sh", "-c"].map(str::to_owned));
        command.push(script);
        if self.dry_run {
            let words: Vec<String> = command.iter().map(|word| quoted(word)).collect();
            say(&format!("hq {}", words.join(" ")));
            return Ok(());
        }
        ended(started(Command::new("hq").args(&command), "hq")?, "hq")
    }
}

/// An absolute path as a script can have it.
fn absolute(path: &Path) -> Result<String, CliError> {
    let found = std::path::absolute(path).map_err(|error| CliError::Usage(format!("{}: {error}", path.display())))?;
    let text = found.to_str().map(str::to_owned);
    text.ok_or_else(|| CliError::Usage(format!("{} is not UTF-8, and a script has to be", path.display())))
}

/// The words of options as a shell takes them apart.
fn words(options: &str) -> Result<Vec<String>, CliError> {
    shlex::split(options).ok_or_else(|| {
        let message = format!("--hyperqueue: `{options}` is not what a shell reads");
        CliError::Usage(format!("{message}: close every quote, and put something behind the last backslash"))
    })
}

/// The least number of a task of HyperQueue: 0, or what `--array` says, such as `1-4` or `3,8-20:2`.
fn least_task(words: &[String]) -> Result<u64, CliError> {
    let given = words.iter().enumerate().find_map(|(place, word)| match word.strip_prefix("--array")? {
        "" => words.get(place + 1).map(String::as_str),
        value => value.strip_prefix('='),
    });
    let Some(array) = given else { return Ok(0) };
    let first = |range: &str| range.split(['-', ':']).next()?.replace('_', "").parse::<u64>().ok();
    let firsts: Option<Vec<u64>> = array.split(',').map(first).collect();
    firsts.and_then(|firsts| firsts.into_iter().min()).ok_or_else(|| {
        let message = format!("--hyperqueue: `--array {array}` does not tell the numbers of the tasks");
        CliError::Usage(format!("{message}; write them such as --array=0-7"))
    })
}

/// One task runs and tells of the run, the others work.
fn roles(is_first: &str, of_run: &[String], arguments: &[String]) -> Result<String, CliError> {
    let program = std::env::current_exe().ok().and_then(|path| path.to_str().map(str::to_owned));
    let program = program.ok_or_else(|| CliError::Usage("the path of this program is not known".to_owned()))?;
    let line = |words: &[String]| words.iter().map(|word| quoted(word) + " ").collect::<String>();
    let (program, words, of_run) = (quoted(&program), line(arguments), line(of_run));
    Ok(format!(
        "if {is_first}; then\n  exec {program} run {words}{of_run}--jobs \"$jobs\" --quiet\nelse\n  exec {program} work {words}--jobs \"$jobs\"\nfi\n"
    ))
}

/// A word as a shell reads it back.
pub(super) fn quoted(word: &str) -> String {
    let is_plain = |letter: char| letter.is_ascii_alphanumeric() || "-_./=:,+%@".contains(letter);
    if !word.is_empty() && word.chars().all(is_plain) {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

fn started(command: &mut Command, name: &str) -> Result<std::process::Child, CliError> {
    let way = "is it installed and on the PATH? `--dry-run` prints what would be submitted";
    command.spawn().map_err(|error| CliError::Usage(format!("cannot start `{name}`: {error}; {way}")))
}

fn ended(mut child: std::process::Child, name: &str) -> Result<(), CliError> {
    let status = child.wait().map_err(|error| CliError::Usage(format!("cannot wait for `{name}`: {error}")))?;
    if status.success() { Ok(()) } else { Err(CliError::Usage(format!("`{name}` refused it ({status}); see above"))) }
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_least_task_of_an_array_is_known() {
        for (options, least) in [
            ("--cpus=4", 0),
            ("--array=1-4", 1),
            ("--cpus=4 --array 7,3-9:2 --name x", 3),
            ("--array=1_000-2_000", 1000),
        ] {
            assert_eq!(super::least_task(&super::words(options).unwrap()).unwrap(), least, "{options}");
        }
        for bad in ["--array=a-b", "--array=1,,2"] {
            assert!(super::least_task(&[bad.to_owned()]).unwrap_err().to_string().contains("--array=0-7"), "{bad}");
        }
    }

    #[test]
    fn options_are_taken_apart_as_a_shell_does() {
        let told = super::words("--array=0-1 --cpus=\"2 compact\" --name 'a b'").unwrap();
        assert_eq!(told, ["--array=0-1", "--cpus=2 compact", "--name", "a b"]);
        let fault = super::words("--cpus='2").unwrap_err().to_string();
        assert!(fault.contains("close every quote"), "{fault}");
    }

    #[test]
    fn a_shell_reads_back_what_was_quoted() {
        for word in ["plain", "", "a b", "it's", "$HOME `x` \"y\"", "params.x=1..2:5"] {
            let out =
                std::process::Command::new("sh").args(["-c", &format!("printf %s {}", super::quoted(word))]).output();
            assert_eq!(String::from_utf8(out.unwrap().stdout).unwrap(), word);
        }
    }
}
