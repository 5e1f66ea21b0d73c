//! `rockface-fuzz`: gives the readers of rockface damaged files. `README.md` says what for and how.

use std::io;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use clap::{Parser, Subcommand};
use rockface_fuzz::driver::{self, Finding, Tried, named};
use rockface_fuzz::{ALL, Target, corpus, seeds, shrink};

/// Gives the readers of rockface damaged files.
#[derive(Debug, Parser)]
#[command(name = "rockface-fuzz", about)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Name the targets.
    List,
    /// Try the corpus and the regressions, then damaged files for so long in all.
    Check {
        /// The targets; all if none is named.
        targets: Vec<String>,
        /// Time for damaged files, of all targets together, seconds.
        #[arg(long, default_value_t = 120)]
        seconds: u64,
        /// What the damage follows from; by default another every time.
        #[arg(long)]
        seed: Option<u64>,
    },
    /// Try files of a target.
    Try {
        /// The target.
        target: String,
        /// The files.
        #[arg(required = true)]
        files: Vec<PathBuf>,
    },
    /// Leave out of a file what its fault does not need; written beside it as FILE.small.
    Shrink {
        /// The target.
        target: String,
        /// The file.
        file: PathBuf,
    },
    /// Write the corpus anew from the writers of rockface.
    Seeds,
    /// The work of a child: damaged files from a number on.
    #[command(hide = true)]
    Work { target: String, seed: u64, first: u64 },
    /// The work of a child: files.
    #[command(hide = true)]
    TryHere { target: String, files: Vec<PathBuf> },
}

fn main() -> ExitCode {
    match run(Arguments::parse().command) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(2)
        }
    }
}

/// Whether all went well.
fn run(command: Command) -> io::Result<bool> {
    let one = |name: &str| named(name).map_err(io::Error::other);
    match command {
        Command::List => ALL.iter().for_each(|target| println!("{:24} {}", target.name, target.about)),
        Command::Check { targets, seconds, seed } => {
            let named: Vec<&Target> = targets.iter().map(|name| one(name)).collect::<io::Result<_>>()?;
            let targets = if named.is_empty() { ALL.iter().collect() } else { named };
            return check(&targets, Duration::from_secs(seconds), seed.unwrap_or_else(by_the_clock));
        }
        Command::Try { target, files } => {
            let target = one(&target)?;
            let tried = driver::replay(target, &files, scratch()?.path())?;
            println!("{} files, {} accepted", tried.cases, tried.accepted);
            return told(target, &tried, None);
        }
        Command::Shrink { target, file } => return small(one(&target)?, &file),
        Command::Seeds => println!("{} files", seeds::write()?),
        Command::Work { target, seed, first } => driver::work(one(&target)?, seed, first)?,
        Command::TryHere { target, files } => driver::work_on(one(&target)?, &files)?,
    }
    Ok(true)
}

/// Where cases put their files: in memory where the system has a folder for that, as stores wait for their disk.
fn scratch() -> io::Result<tempfile::TempDir> {
    let memory = Path::new("/dev/shm");
    if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() }
}

fn by_the_clock() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

fn check(targets: &[&Target], time: Duration, seed: u64) -> io::Result<bool> {
    let scratch = scratch()?;
    println!("seed {seed}: `check --seed {seed}` makes the same cases again");
    let mut all_well = true;
    for target in targets {
        let tried = driver::replay(target, &corpus::known(target)?, scratch.path())?;
        if tried.accepted == 0 {
            println!("{}: no file of its corpus is accepted; write it anew with `rockface-fuzz seeds`", target.name);
            all_well = false;
        }
        all_well &= told(target, &tried, None)?;
    }
    for target in targets {
        let tried = driver::mutations(target, seed, time / targets.len().max(1) as u32, scratch.path())?;
        println!("{:24} {:>8} cases, {:>3}% accepted", target.name, tried.cases, share(&tried));
        all_well &= told(target, &tried, Some(&corpus::folder("findings", target)))?;
    }
    Ok(all_well)
}

fn share(tried: &Tried) -> u64 {
    100 * tried.accepted / tried.cases.max(1)
}

/// Tells of findings and keeps them in a folder; whether there are none.
fn told(target: &Target, tried: &Tried, folder: Option<&Path>) -> io::Result<bool> {
    for (what, (finding, times)) in &tried.findings {
        println!("{}: {what} ({times} times)", target.name);
        for line in finding.said.lines().filter(|line| !line.trim().is_empty()).take(6) {
            println!("    {line}");
        }
        if let Some(folder) = folder {
            println!("    kept as {}", keep(finding, folder)?.display());
        }
    }
    Ok(tried.findings.is_empty())
}

fn keep(finding: &Finding, folder: &Path) -> io::Result<PathBuf> {
    std::fs::create_dir_all(folder)?;
    let name = blake3::hash(&finding.bytes).to_hex();
    let path = folder.join(&name[..16]);
    std::fs::write(&path, &finding.bytes)?;
    Ok(path)
}

fn small(target: &Target, file: &Path) -> io::Result<bool> {
    let bytes = std::fs::read(file)?;
    match shrink::shrunk(target, &bytes, scratch()?.path())? {
        Some((small, what)) => {
            let mut to = file.as_os_str().to_owned();
            to.push(".small");
            std::fs::write(&to, &small)?;
            println!("{what}: {} bytes of {}", small.len(), bytes.len());
        }
        None => println!("nothing happens with this file"),
    }
    Ok(true)
}
