//! How much of the machine a command may use.

use clap::Args;
use rockface_core::limits::raise_memory_limit;
use rockface_engine::run::{MachineMemory, Options};

use super::output::complain;
use super::sizes::bytes_of;
use super::table::bytes;

/// The greatest memory that is accepted, GiB; more is a typing error.
const MEMORY_LIMIT_GIB: f64 = 1_048_576.0;

/// Cores and memory of one process.
#[derive(Debug, Args)]
pub struct CapacityArgs {
    /// Steps that run at once, and threads inside them [default: one for each core].
    #[arg(long, short, value_name = "N", value_parser = jobs, allow_hyphen_values = true)]
    jobs: Option<u16>,
    #[command(flatten)]
    memory: MemoryArgs,
}

/// Memory of one process.
#[derive(Debug, Args)]
pub struct MemoryArgs {
    /// Memory for values passed between steps and for running steps, in GiB or with a unit (500MB); values beyond it are
    /// spilled to disk [default: half of the memory of the machine, or of the container
    /// or batch job].
    #[arg(long, value_name = "GiB", value_parser = memory, allow_hyphen_values = true)]
    memory: Option<Memory>,
}

/// A size as it was given, and its bytes.
#[derive(Debug, Clone)]
struct Memory {
    text: String,
    bytes: usize,
}

impl MemoryArgs {
    /// The option that says the same to another command.
    pub fn told(&self) -> Vec<String> {
        let told = |memory: &Memory| vec!["--memory".to_owned(), memory.text.clone()];
        self.memory.as_ref().map(told).unwrap_or_default()
    }
}

impl CapacityArgs {
    /// Enters what was given.
    pub fn apply(&self, options: &mut Options) {
        options.jobs = self.jobs.map_or(options.jobs, usize::from);
        options.memory_bytes = self.memory.memory.as_ref().map_or(options.memory_bytes, |memory| memory.bytes);
        raise_memory_limit(options.memory_bytes as u64);
        let Some(memory) = &self.memory.memory else { return };
        if let Some(machine) = MachineMemory::now().filter(|machine| memory.bytes as u64 > machine.total) {
            let has = bytes(machine.total);
            complain(&format!(
                "warning: `--memory {}` is more than there is here, {has}; it is in GiB, or with a unit (500MB)",
                memory.text
            ));
        }
    }
}

fn jobs(text: &str) -> Result<u16, String> {
    let count = text.parse().ok().filter(|count| (1..=1024).contains(count));
    count.ok_or_else(|| "give a whole number of jobs from 1 to 1024".to_owned())
}

fn memory(text: &str) -> Result<Memory, String> {
    Ok(Memory { text: text.to_owned(), bytes: memory_bytes(text)? })
}

/// The bytes of a size. Zero is refused: every value would be spilled.
fn memory_bytes(text: &str) -> Result<usize, String> {
    let bytes = bytes_of(text)?;
    if bytes > 0.0 && bytes <= MEMORY_LIMIT_GIB * f64::from(1 << 30) {
        Ok(bytes as usize)
    } else {
        Err(format!("give a number of GiB above 0 and up to {MEMORY_LIMIT_GIB}"))
    }
}
