//! Which machine this is, and whether others may use the same store.
//!
//! Between the processes of one machine the kernel's locks decide. Between machines they are not relied on: network file
//! systems may be mounted so that locks stay local. So on a store that other machines may use, each machine has folders,
//! segments and a lock file of its own, and steps are taken by lease files (`leases.rs`).

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use crate::error::StoreError;
use crate::workers::Worker;

/// Names this machine; by default the identity of its kernel since the last start.
const NAME_VARIABLE: &str = "ROCKFACE_MACHINE";
/// `yes` or `no`: whether other machines use the store; by default what its file system suggests.
const SHARED_VARIABLE: &str = "ROCKFACE_SHARED_STORE";
/// Starts the names of the folders of machines.
const OWN: &str = "machine-";
/// File systems that other machines can reach: NFS, SMB, CIFS, FUSE, Lustre, GPFS, Ceph, 9P, AFS, `BeeGFS`, `PanFS`, `OrangeFS`, GFS2,
/// OCFS2, as `statfs` numbers them.
const NETWORK: [u32; 15] = [
    0x6969,
    0x517b,
    0xfe53_4d42,
    0xff53_4d42,
    0x6573_5546,
    0x0bd0_0bd0,
    0x4750_4653,
    0x00c3_6400,
    0x0102_1997,
    0x5346_414f,
    0x1983_0326,
    0xaad7_aaea,
    0x2003_0528,
    0x0116_1970,
    0x7461_636f,
];

/// What the environment says of whether other machines use the store; `None` where it says nothing.
///
/// # Errors
/// It says something else than yes or no: a sentence for the user.
pub fn shared_setting() -> Result<Option<bool>, String> {
    let Some(text) = variable(SHARED_VARIABLE) else { return Ok(None) };
    match text.as_str() {
        "yes" | "1" | "true" => Ok(Some(true)),
        "no" | "0" | "false" => Ok(Some(false)),
        _ => Err(format!(
            "the variable {SHARED_VARIABLE} is `{text}`: `yes` or `no` was expected; unset it to go by the file system"
        )),
    }
}

fn variable(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|text| !text.is_empty())
}

/// This machine, as others on the store see it.
#[derive(Debug)]
pub(crate) struct Machine {
    root: PathBuf,
    name: String,
    /// Whether other machines may use the store.
    pub is_shared: bool,
    /// Whether this process gives signs of life.
    beats: bool,
    /// This process, once it runs something.
    worker: Mutex<Option<Arc<Worker>>>,
}

impl Machine {
    /// This machine on the store at `root`, which need not be there yet.
    pub fn on(root: &Path) -> Self {
        let given = variable(NAME_VARIABLE).or_else(|| fs::read_to_string("/proc/sys/kernel/random/boot_id").ok());
        let kept = |letter: &char| letter.is_ascii_alphanumeric();
        let name: String = given.unwrap_or_default().chars().filter(kept).take(12).collect();
        let is_shared = shared_setting().ok().flatten().unwrap_or_else(|| is_on_network(root));
        Self { root: root.to_owned(), name, is_shared, beats: is_shared, worker: Mutex::default() }
    }

    /// A machine of this name on a store that several use; its processes give no signs of life.
    #[cfg(test)]
    pub fn named(root: &Path, name: &str) -> Self {
        Self { root: root.to_owned(), name: name.to_owned(), is_shared: true, beats: false, worker: Mutex::default() }
    }

    /// Its name: letters and digits.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Where this machine has what others are not to sweep up in a folder of the store.
    pub fn folder(&self, name: &str) -> PathBuf {
        let all = self.root.join(name);
        if self.is_shared { all.join(format!("{OWN}{}", self.name)) } else { all }
    }

    /// The same of all machines: the folder itself, and those of machines in it.
    pub fn folders(&self, name: &str) -> Vec<PathBuf> {
        let all = self.root.join(name);
        let entries = fs::read_dir(&all).into_iter().flatten().flatten();
        let own = entries.filter(|entry| entry.file_name().to_string_lossy().starts_with(OWN));
        let own: Vec<PathBuf> = own.map(|entry| entry.path()).filter(|path| crate::plain::is_folder(path)).collect();
        std::iter::once(all).chain(own).collect()
    }

    /// The machine whose folder this is; none for that of a store which one machine uses.
    pub fn of_folder(path: &Path) -> Option<&str> {
        path.file_name()?.to_str()?.strip_prefix(OWN)
    }

    /// Ends the names of the segments that only this machine appends to.
    pub fn own_segments(&self) -> Option<String> {
        self.is_shared.then(|| format!("-{}.seg", self.name))
    }

    /// Whether another machine may be appending to this segment.
    pub fn may_be_written_elsewhere(&self, segment: &str) -> bool {
        let owner = segment.strip_suffix(".seg").and_then(|name| name.rsplit('-').next());
        let is_own = owner == Some(self.name.as_str());
        self.is_shared && !is_own && owner.is_some_and(|owner| self.is_alive(owner))
    }

    /// Whether a process of this machine has given a sign of life lately.
    pub fn is_alive(&self, machine: &str) -> bool {
        // Where it cannot be seen who is there, nobody is taken for dead.
        let Ok(workers) = crate::workers::list(&self.root) else { return true };
        workers.iter().any(|worker| worker.machine == machine && worker.is_live)
    }

    /// Makes a network file system ask its server for what is in a folder: it keeps a listing for up to a minute unless something
    /// was changed there from this machine.
    pub fn renew_listing(&self, folder: &Path) -> Result<(), StoreError> {
        let Some(worker) = self.worker_if_begun() else { return Ok(()) };
        let look =
            folder.join(format!(".look-{}-{:?}", worker.name(), std::thread::current().id()).replace(['(', ')'], ""));
        match fs::hard_link(worker.path(), &look) {
            Err(fault) if fault.kind() != std::io::ErrorKind::AlreadyExists => {
                return Err(StoreError::io("write into", folder, fault));
            }
            _ => drop(fs::remove_file(&look)),
        }
        Ok(())
    }

    /// This process as a worker, which it is from the first time this is asked.
    pub fn worker(&self) -> Result<Arc<Worker>, StoreError> {
        let mut slot = self.worker.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(worker) = &*slot {
            return Ok(Arc::clone(worker));
        }
        let begun = Arc::new(Worker::begin(&self.root, &self.name, self.beats)?);
        *slot = Some(Arc::clone(&begun));
        Ok(begun)
    }

    /// The same if it is one already.
    pub fn worker_if_begun(&self) -> Option<Arc<Worker>> {
        self.worker.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Whether the file system of the nearest folder that is there is one of a network.
fn is_on_network(root: &Path) -> bool {
    let there = std::path::absolute(root).ok();
    let there = there.as_deref().and_then(|root| root.ancestors().find(|folder| folder.exists()));
    let kind = there.and_then(|folder| rustix::fs::statfs(folder).ok()).map(|stat| stat.f_type as u32);
    kind.is_some_and(|kind| NETWORK.contains(&kind))
}
