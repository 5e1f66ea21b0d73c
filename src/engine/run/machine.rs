//! The memory of the machine, or of the container or job of a batch system that the process runs in, and that of a process.

use super::cgroup;
use sysinfo::{MemoryRefreshKind, System};

/// How much memory there is and how much of it is left, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MachineMemory {
    /// What all processes together may use.
    pub total: u64,
    /// What is left of it; what the system keeps of files counts as left.
    pub left: u64,
}

impl MachineMemory {
    /// As the system reports it now; `None` if it does not.
    pub fn now() -> Option<Self> {
        let mut system = System::new();
        system.refresh_memory_specifics(MemoryRefreshKind::nothing().with_ram());
        let machine = Self { total: system.total_memory(), left: system.available_memory() };
        if machine.total == 0 {
            return None;
        }
        Some(cgroup::usages().into_iter().fold(machine, |machine, [total, used]| machine.within(total, used)))
    }

    /// What of it is for a container or a job that may use `total` and uses `used`, bytes.
    fn within(self, total: u64, used: u64) -> Self {
        Self { total: self.total.min(total), left: self.left.min(total.saturating_sub(used)) }
    }

    /// Whether so little is left that memory which is only kept for later should be given back: less than an eighth.
    pub fn is_short(&self) -> bool {
        self.left < self.total / 8
    }
}

/// What a line of the system's report on a process says (`self`, or its number), such as `VmRSS` for its resident memory and `VmHWM` for the
/// greatest so far, bytes; `None` where the system does not report it.
pub fn process_bytes(process: &str, line: &str) -> Option<u64> {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).ok()?;
    let found = status.lines().find_map(|text| text.strip_prefix(line)?.strip_prefix(':'))?;
    found.trim().strip_suffix(" kB")?.trim().parse::<u64>().ok().map(|kib| kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_is_some_memory_and_not_more_left_than_that() {
        let memory = MachineMemory::now().unwrap();
        assert!(memory.total > 64 << 20 && memory.left <= memory.total, "{memory:?}");
    }

    #[test]
    fn a_container_has_what_it_may_use() {
        let machine = MachineMemory { total: 64, left: 50 };
        assert_eq!(machine.within(16, 15), MachineMemory { total: 16, left: 1 });
        assert_eq!(machine.within(u64::MAX, 10), machine);
        assert!(machine.within(16, 15).is_short() && !machine.within(16, 14).is_short());
    }
}
