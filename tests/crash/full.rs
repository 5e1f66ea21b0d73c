//! File systems that fill up at any moment, and that can be read only from some moment on.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use crate::place::{CHANGED, Ended, Place, RUN, ended};
use crate::shim::{Watched, shim};
use crate::slow;

/// Bytes of the file systems that are filled.
const BYTES: u64 = 48 << 20;

/// A file system of its own, gone when dropped.
struct Mounted {
    at: PathBuf,
    _folder: tempfile::TempDir,
}

impl Mounted {
    /// `tmpfs`, or a kind that `mkfs` makes in a file; `None` after a line that says why there is none.
    fn new(kind: &str) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let (at, image) = (folder.path().join("disk"), folder.path().join("image"));
        std::fs::create_dir(&at).unwrap();
        let mounted = Self { at, _folder: folder };
        let mut mount = Command::new("mount");
        if kind == "tmpfs" {
            mount.args(["-t", "tmpfs", "-o", &format!("size={BYTES}"), "tmpfs"]);
        } else {
            std::fs::File::create(&image).unwrap().set_len(BYTES).unwrap();
            // Without blocks that only root may fill.
            if !quietly(Command::new(format!("mkfs.{kind}")).args(["-q", "-m", "0"]).arg(&image)) {
                println!("skipped: there is no mkfs.{kind}");
                return None;
            }
            mount.args(["-o", "loop"]).arg(&image);
        }
        let is_mounted = quietly(mount.arg(&mounted.at));
        if !is_mounted {
            println!("skipped: this user may not mount a {kind}");
        }
        is_mounted.then_some(mounted)
    }

    fn remount(&self, option: &str) {
        assert!(quietly(Command::new("mount").args(["-o", &format!("remount,{option}")]).arg(&self.at)));
    }
}

impl Drop for Mounted {
    fn drop(&mut self) {
        quietly(Command::new("umount").arg(&self.at));
    }
}

/// Whether a program succeeded.
fn quietly(command: &mut Command) -> bool {
    command.stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok_and(|status| status.success())
}

/// Bytes that are free.
fn free(disk: &Path) -> u64 {
    let stat = rustix::fs::statvfs(disk).unwrap();
    stat.f_bavail * stat.f_frsize
}

/// Fills a file system until so many bytes are free.
fn fill(disk: &Path, free: u64) {
    let filler = std::fs::File::create(disk.join("filler")).unwrap();
    let bytes = self::free(disk).saturating_sub(free).max(1);
    // The last blocks go one by one: some are needed for where the others lie.
    let take = |from, bytes| rustix::fs::fallocate(&filler, rustix::fs::FallocateFlags::empty(), from, bytes);
    let mut taken = bytes;
    while taken > 0 && take(0, taken).is_err() {
        taken -= taken.min(4096);
    }
}

#[test]
fn however_little_a_disk_holds_a_run_says_so_and_goes_on_once_there_is_room() {
    let whole = Place::new();
    whole.succeed(&RUN).unwrap();
    let expected = whole.digests().unwrap();
    let rounds = if slow() { 150 } else { 6 };
    for kind in ["tmpfs", "ext4"] {
        let Some(mounted) = Mounted::new(kind) else { continue };
        let mut codes = [0; 2];
        for round in 0..rounds {
            let folder = mounted.at.join("place");
            let _ = std::fs::remove_dir_all(&folder);
            std::fs::create_dir(&folder).unwrap();
            let place = Place::at(&folder);
            // From nothing at all to room enough.
            let free = (6 << 20) * round / rounds;
            fill(&mounted.at, free);
            let context = |why: String| format!("{kind} with {free} bytes free: {why}");
            let out = place.command(&RUN).output().unwrap();
            let ended = ended(&out, false, true).map_err(context).unwrap();
            let err = String::from_utf8_lossy(&out.stderr);
            match ended {
                Ended::Done => place.has_run(&expected).map_err(context).unwrap(),
                Ended::DiskFailed => assert!(err.contains("free some space"), "{}", context(err.into_owned())),
                other => panic!("{}", context(format!("{other:?}: {err}"))),
            }
            codes[usize::from(ended == Ended::DiskFailed)] += 1;
            std::fs::remove_file(mounted.at.join("filler")).unwrap();
            place.goes_on(&RUN, &expected).map_err(context).unwrap();
        }
        println!("{kind}: {} runs succeeded, {} ended with 3 and went on", codes[0], codes[1]);
        assert!(codes[1] > 0, "{kind} was never full");
    }
}

/// Collects what no run names, two hours later; returns what is said of it.
fn collected(place: &Place, shim: &Path, kind: &str) -> String {
    let mut command = place.command(&["store", "gc", "--unnamed"]);
    Watched::new(&mut command, shim, place.root()).later(7200);
    let out = command.output().unwrap();
    assert!(out.status.success(), "{kind}: {}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8_lossy(&out.stdout).into_owned()
}

#[test]
fn a_collection_makes_room_on_a_full_disk() {
    let Some(shim) = shim() else { return };
    for kind in ["tmpfs", "ext4"] {
        let Some(mounted) = Mounted::new(kind) else { continue };
        let place = Place::at(&mounted.at);
        place.succeed(&RUN).unwrap();
        std::fs::remove_dir_all(place.path(".rockface/runs")).unwrap();
        fill(&mounted.at, 0);
        let before = free(&mounted.at);
        let told = collected(&place, shim, kind);
        assert!(free(&mounted.at) > before + (1 << 20), "{kind}: {told}");
    }
}

#[test]
fn a_collection_makes_room_on_a_full_disk_for_the_segments_of_what_stays() {
    const OTHER: [&str; 6] = ["run", "p.yaml", "--jobs", "2", "--seed", "2"];
    let Some(shim) = shim() else { return };
    for kind in ["tmpfs", "ext4"] {
        let Some(mounted) = Mounted::new(kind) else { continue };
        let place = Place::at(&mounted.at);
        place.succeed(&RUN).unwrap();
        std::fs::remove_dir_all(place.path(".rockface/runs")).unwrap();
        place.succeed(&OTHER).unwrap();
        let expected = place.digests().unwrap();
        fill(&mounted.at, 0);
        let segments = || std::fs::read_dir(place.path(".rockface/store/segments")).unwrap().count();
        let (before, count) = (free(&mounted.at), segments());
        let told = collected(&place, shim, kind);
        assert!(free(&mounted.at) > before + (1 << 20) && segments() <= count, "{kind}: {told}");
        std::fs::remove_file(mounted.at.join("filler")).unwrap();
        place.goes_on(&OTHER, &expected).unwrap();
    }
}

#[test]
fn a_command_that_finds_no_room_for_its_files_leaves_none_of_them() {
    let Some(mounted) = Mounted::new("tmpfs") else { return };
    let place = Place::at(&mounted.at);
    fill(&mounted.at, 0);
    for (command, folder) in
        [(["init", "new/one"].as_slice(), "new/one"), (&["manual", "pages", "man/man1"], "man/man1")]
    {
        let out = place.command(command).output().unwrap();
        assert_eq!(ended(&out, false, true), Ok(Ended::DiskFailed));
        let left = std::fs::read_dir(place.path(folder)).map_or(0, Iterator::count);
        assert_eq!(left, 0, "{folder}");
    }
    std::fs::remove_file(mounted.at.join("filler")).unwrap();
    place.succeed(&["init", "new/one"]).unwrap();
}

#[test]
fn a_file_system_that_became_read_only_is_named() {
    for kind in ["tmpfs", "ext4"] {
        let Some(mounted) = Mounted::new(kind) else { continue };
        let place = Place::at(&mounted.at);
        place.succeed(&RUN).unwrap();
        let expected = place.digests().unwrap();
        mounted.remount("ro");
        let out = place.command(&CHANGED).output().unwrap();
        assert_eq!(ended(&out, false, true), Ok(Ended::DiskFailed));
        for looking in [&["plan", "p.yaml"][..], &["store", "verify"], &["store", "stat"], &["runs", "list"]] {
            place.succeed(looking).unwrap();
        }
        place.has_run(&expected).unwrap();
        mounted.remount("rw");
        let changed = place.succeed(&CHANGED).unwrap();
        assert!(changed.starts_with("done"), "{changed}");
        place.goes_on(&RUN, &expected).unwrap();
    }
}

#[test]
fn an_output_that_takes_no_more_changes_no_exit_code() {
    let place = Place::new();
    let Ok(full) = std::fs::OpenOptions::new().write(true).open("/dev/full") else {
        println!("skipped: this system has no /dev/full");
        return;
    };
    let code = |arguments: &[&str]| {
        let mut command = place.command(arguments);
        command.stdout(Stdio::null()).stderr(full.try_clone().unwrap());
        command.status().unwrap().code()
    };
    assert_eq!(code(&["run", "nowhere.yaml"]), Some(2));
    assert_eq!(code(&RUN), Some(0));
}
