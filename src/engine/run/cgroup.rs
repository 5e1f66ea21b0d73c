//! The memory that the control groups of Linux leave this process: those of a container, and those that Slurm or systemd put it in.

use std::fs::read_to_string;
use std::path::{Path, PathBuf};

/// Where both versions are mounted.
const ROOT: &str = "/sys/fs/cgroup";

/// The groups at the root of what is mounted, which may be known without `/proc`.
const ROOT_GROUPS: &str = "0::/\n1:memory:/\n";

/// What the processes of a group together may use and use without what the system keeps of files, bytes.
pub type Usage = [u64; 2];

/// The usage of every group that this process is in and that has a limit, from its own to the outermost.
pub fn usages() -> Vec<Usage> {
    let own = read_to_string("/proc/self/cgroup").ok().filter(|own| !own.is_empty());
    let own = own.as_deref().unwrap_or(ROOT_GROUPS);
    folders(own, Path::new(ROOT)).iter().filter_map(|folder| usage(folder)).collect()
}

/// The folders of the groups for memory that `/proc/self/cgroup` names, and of all groups around them. In a container the names may be
/// those of the machine, which are not there; its own group is then the root.
fn folders(own: &str, root: &Path) -> Vec<PathBuf> {
    let of_line = |line: &str| {
        let mut fields = line.splitn(3, ':').skip(1);
        let (controllers, path) = (fields.next()?, fields.next()?);
        let mounted = if controllers.split(',').any(|name| name == "memory") {
            root.join("memory")
        } else if controllers.is_empty() {
            root.to_owned()
        } else {
            return None;
        };
        let around = Path::new(path).ancestors().filter_map(|path| path.strip_prefix("/").ok());
        Some(around.map(|path| mounted.join(path)).collect::<Vec<_>>())
    };
    own.lines().filter_map(of_line).flatten().collect()
}

/// What a group may use and uses; `None` if it has no limit.
fn usage(folder: &Path) -> Option<Usage> {
    let number = |name: &str| read_to_string(folder.join(name)).ok()?.trim().parse::<u64>().ok();
    let (limit, used, of_files, shared) = match number("memory.max") {
        Some(limit) => (limit, number("memory.current")?, "file", "shmem"),
        None => (number("memory.limit_in_bytes")?, number("memory.usage_in_bytes")?, "total_cache", "total_shmem"),
    };
    let counts = read_to_string(folder.join("memory.stat")).unwrap_or_default();
    let count = |name: &str| {
        let found = counts.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(' '));
        found.and_then(|count| count.parse::<u64>().ok()).unwrap_or(0)
    };
    // Files in memory alone cannot be given back.
    Some([limit, used.saturating_sub(count(of_files).saturating_sub(count(shared)))])
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::{create_dir_all, write};

    #[test]
    fn the_groups_around_that_of_the_process_count_in_both_versions() {
        let place = tempfile::tempdir().unwrap();
        let folder = |path: &str| {
            create_dir_all(place.path().join(path)).unwrap();
            place.path().join(path)
        };
        let job = folder("memory/slurm/job_7");
        write(job.join("memory.limit_in_bytes"), "1300\n").unwrap();
        write(job.join("memory.usage_in_bytes"), "900\n").unwrap();
        write(job.join("memory.stat"), "cache 1\ntotal_cache 500\ntotal_shmem 100\n").unwrap();
        folder("memory/slurm/job_7/step_0");
        let found = |own: &str| -> Vec<Usage> { folders(own, place.path()).iter().filter_map(|f| usage(f)).collect() };
        assert_eq!(found("4:cpu,memory:/slurm/job_7/step_0\n3:pids:/slurm\n"), [[1300, 500]]);
        let slice = folder("user.slice/run");
        write(slice.join("memory.max"), "2000\n").unwrap();
        write(slice.join("memory.current"), "700\n").unwrap();
        write(folder("user.slice").join("memory.max"), "max\n").unwrap();
        assert_eq!(found("0::/user.slice/run\n"), [[2000, 700]]);
        assert_eq!(found("0::/user.slice\n"), Vec::<Usage>::new());
    }

    #[test]
    fn names_of_the_machine_lead_to_the_group_at_the_root_of_a_container() {
        let place = tempfile::tempdir().unwrap();
        write(place.path().join("memory.max"), "64\n").unwrap();
        write(place.path().join("memory.current"), "16\n").unwrap();
        let folders = folders("0::/docker/0123\n", place.path());
        assert_eq!(folders.iter().filter_map(|folder| usage(folder)).collect::<Vec<_>>(), [[64, 16]]);
    }
}
