//! Answers: the result of a former command, used only while everything it rests on is untouched.
//!
//! A run that has nothing to do need not open the store to find that out. Its result is filed under the digest of the
//! whole question, with the state of every file, folder, segment and large blob it rests on. One look at
//! each (`stat`, no reading) shows whether it still holds; any doubt, and there is no answer, only a full look.
//!
//! There are at most 256 answers: a file each in `answers/`, replaced in one step; a lost one costs a full look.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::looks::{Repeatable, Seen, State, are_same, is_same};
use super::{ANSWERS, Memory, mark, read_plain};
use crate::Digest;
use crate::error::{At, StoreError};
use crate::files::Fingerprint;
use crate::open::{self, BLOBS, SEGMENTS};
use crate::seal::seal_ns;

/// Opens every answer; what was written by another version is no answer.
const FORMAT: &str = "rockface answer 3";
/// Tells marks on answers from those on anything else.
const MARKED: &[u8] = b"answer";

/// What an answer rests on outside and inside the store.
#[derive(Debug, Clone, Default)]
pub struct Grounds {
    /// What was seen where in the file system: input files, listed folders, places where no file was.
    pub looks: Vec<(PathBuf, Seen)>,
    /// The folder of what was made, and the state in which each file was left there.
    pub made: Made,
    /// Blobs that have to be there, with their sizes where they are known.
    pub blobs: Vec<(Digest, Option<u64>)>,
}

/// A folder and the states of files in it, by their paths relative to it.
pub type Made = (PathBuf, Vec<(PathBuf, State)>);

/// An answer as it is kept.
#[derive(Debug, Serialize, Deserialize)]
struct Kept {
    question: Digest,
    looks: Vec<Repeatable>,
    made: Made,
    segments: Vec<(String, Fingerprint)>,
    /// Large blobs and their sizes; small ones are in the segments.
    blobs: Vec<(Digest, u64)>,
    answer: Value,
}

/// The last result of `question`, if nothing that the answer rests on has changed since.
///
/// `dir` is the folder of a store, which is not opened. Reads one small file and looks once at each thing relied on. Only
/// what bears the mark of this user is an answer: others could file another.
pub fn recall(dir: &Path, question: &Digest) -> Option<Value> {
    open::is_current(dir).then_some(())?;
    let text = read_plain(&slot(dir, question))?;
    let kept = decode(&text).filter(|kept| kept.question == *question)?;
    let (folder, made) = &kept.made;
    let holds = kept.looks.iter().all(is_same)
        && are_same(folder, made)
        && segments(dir).is_some_and(|now| now == kept.segments)
        && kept.blobs.iter().all(|(digest, bytes)| is_sealed(dir, digest, *bytes));
    holds.then_some(kept.answer)
}

impl Memory<'_> {
    /// Keeps the result of `question`, if later changes of all it depends on can be recognised; returns whether it was kept.
    ///
    /// It is not where an input was modified too recently for its time to be trusted, or where another process has
    /// written to the store since this one looked.
    pub fn remember_answer(&self, question: &Digest, answer: &Value, grounds: &Grounds) -> Result<bool, StoreError> {
        let Some(kept) = self.kept_answer(question, answer, grounds) else { return Ok(false) };
        let body =
            serde_json::to_vec(&kept).map_err(std::io::Error::from).at("remember the run in", self.store.dir())?;
        let Some(mark) = mark(&[MARKED, &body]) else { return Ok(false) };
        let path = slot(self.store.dir(), question);
        let folder = self.store.dir().join(ANSWERS);
        fs::create_dir_all(&folder).at("make the folder", &folder)?;
        // Locked, so that nobody who opens the store meanwhile sweeps it up.
        let mut file = self.store.blobs().temporary()?;
        let head = format!("{FORMAT} {mark}\n");
        file.write_all(head.as_bytes()).and_then(|()| file.write_all(&body)).at("write", &path)?;
        file.persist(&path).map_err(|fault| fault.error).at("write", &path)?;
        Ok(true)
    }

    /// How long segments were when answers were filed, the longest size of each. A segment only grows, and what is cut off it
    /// was never part of an answer.
    pub(crate) fn segment_sizes(self) -> BTreeMap<String, u64> {
        let mut sizes: BTreeMap<String, u64> = BTreeMap::new();
        let answers = fs::read_dir(self.store.dir().join(ANSWERS)).into_iter().flatten().flatten();
        let kept = answers.filter_map(|answer| decode(&read_plain(&answer.path())?));
        for (name, state) in kept.flat_map(|kept| kept.segments) {
            let size = sizes.entry(name).or_default();
            *size = state.bytes.max(*size);
        }
        sizes
    }

    fn kept_answer(self, question: &Digest, answer: &Value, grounds: &Grounds) -> Option<Kept> {
        // Taken before anything is compared: what changes from now on will show.
        let segments = segments(self.store.dir())?;
        let looks = grounds.looks.iter().map(|(path, seen)| self.store.repeatable(path, seen));
        let mut looks = looks.collect::<Option<Vec<_>>>()?;
        looks.sort_unstable();
        looks.dedup();
        self.store
            .journal()
            .has_read(segments.iter().map(|(name, state)| (name.as_str(), state.bytes)))
            .then_some(())?;
        let large = grounds.blobs.iter().filter(|(digest, _)| !self.store.is_small(digest));
        let sized = large.map(|(digest, bytes)| Some((*digest, bytes.or_else(|| self.store.size(digest))?)));
        let mut blobs = sized.collect::<Option<Vec<_>>>()?;
        blobs.sort_unstable();
        blobs.dedup();
        let (made, answer) = (grounds.made.clone(), answer.clone());
        Some(Kept { question: *question, looks, made, segments, blobs, answer })
    }
}

/// The file in which the answer to this question would be.
fn slot(dir: &Path, question: &Digest) -> PathBuf {
    question.hex(|text| dir.join(ANSWERS).join(&text[..2]))
}

fn decode(text: &[u8]) -> Option<Kept> {
    let end = text.iter().position(|byte| *byte == b'\n')?;
    let (head, body) = (std::str::from_utf8(&text[..end]).ok()?, &text[end + 1..]);
    let told: Digest = head.strip_prefix(FORMAT)?.trim().parse().ok()?;
    if mark(&[MARKED, body])? == told { serde_json::from_slice(body).ok() } else { None }
}

/// The names and states of all segments, sorted.
fn segments(dir: &Path) -> Option<Vec<(String, Fingerprint)>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(dir.join(SEGMENTS)).ok()? {
        let entry = entry.ok()?;
        found.push((entry.file_name().into_string().ok()?, Fingerprint::of(&entry.metadata().ok()?)));
    }
    found.sort_by(|one, other| one.0.cmp(&other.0));
    Some(found)
}

fn is_sealed(dir: &Path, digest: &Digest, bytes: u64) -> bool {
    let path = digest.hex(|text| dir.join(BLOBS).join(&text[..2]).join(text));
    let meta = fs::metadata(path);
    meta.is_ok_and(|meta| meta.len() == bytes && meta.mtime_nsec() == i64::from(seal_ns(digest)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Store;
    use serde_json::json;
    use std::time::{Duration, SystemTime};

    struct Desk {
        folder: tempfile::TempDir,
        question: Digest,
        large: Digest,
    }

    impl Desk {
        fn path(&self, name: &str) -> PathBuf {
            self.folder.path().join(name)
        }

        fn recall(&self) -> Option<Value> {
            recall(&self.path("store"), &self.question)
        }

        fn grounds(&self) -> Grounds {
            let file = (self.path("face.ply"), Seen::File(Digest::of(b"ply")));
            let listed = (self.path("list"), Seen::folder(&self.path("list")));
            let blobs = vec![(self.large, None), (Digest::of(b"small"), Some(5))];
            let made = vec![("run.json".into(), State::of(&self.path("run/run.json")).unwrap())];
            let looks = vec![file, listed, (self.path("list/lost"), Seen::NoFile)];
            Grounds { looks, made: (self.path("run"), made), blobs }
        }

        fn ask(&self) -> bool {
            let store = Store::open(&self.path("store")).unwrap();
            store.hash_file(&self.path("face.ply")).unwrap();
            store.put(&vec![1; 100_000]).unwrap();
            store.put(b"small").unwrap();
            store.sync().unwrap();
            store.memory().remember_answer(&self.question, &json!("done"), &self.grounds()).unwrap()
        }
    }

    #[test]
    fn a_segment_that_was_begun_and_never_written_to_is_no_hindrance() {
        let desk = desk();
        fs::write(desk.path("store/segments/ffffffffffffffff-1.seg"), b"").unwrap();
        assert_eq!(desk.recall(), None, "who knows what comes");
        assert!(desk.ask());
        assert_eq!(desk.recall(), Some(json!("done")));
    }

    #[test]
    fn a_segment_that_is_shorter_than_an_answer_says_was_cut() {
        let desk = desk();
        let segment = fs::read_dir(desk.path("store/segments")).unwrap().next().unwrap().unwrap().path();
        let size = fs::metadata(&segment).unwrap().len();
        let verify = |repair| Store::open(&desk.path("store")).unwrap().verify(repair).unwrap();
        assert_eq!((verify(false).segment_faults, verify(false).half_written), (vec![], vec![]));
        fs::File::options().write(true).open(&segment).unwrap().set_len(0).unwrap();
        let told: Vec<_> = verify(false).segment_faults.iter().map(|one| (one.kind, one.at, one.bytes)).collect();
        assert_eq!(told, [(crate::SegmentFaultKind::Cut, 0, size)]);
        assert!(verify(true).rewritten);
        assert_eq!((verify(false).segment_faults, verify(false).half_written), (vec![], vec![]));
    }

    #[test]
    fn an_answer_being_filed_is_not_swept_up() {
        let desk = desk();
        let store = Store::open(&desk.path("store")).unwrap();
        std::thread::scope(|scope| {
            let sweeping = scope.spawn(|| {
                (0..300).for_each(|_| {
                    open::prepare(&desk.path("store"), &crate::machine::Machine::on(&desk.path("store"))).unwrap();
                });
            });
            while !sweeping.is_finished() {
                store.memory().remember_answer(&desk.question, &json!("done"), &desk.grounds()).unwrap();
            }
        });
    }

    fn age(path: &Path, age_s: u64) {
        fs::File::open(path).unwrap().set_modified(SystemTime::now() - Duration::from_secs(age_s)).unwrap();
        std::thread::sleep(Duration::from_millis(25));
    }

    fn desk() -> Desk {
        let folder = tempfile::tempdir().unwrap();
        let desk = Desk { folder, question: Digest::of(b"question"), large: Digest::of(&vec![1; 100_000]) };
        fs::create_dir(desk.path("list")).unwrap();
        fs::create_dir(desk.path("run")).unwrap();
        fs::write(desk.path("run/run.json"), "{}").unwrap();
        std::os::unix::fs::symlink(desk.path("target"), desk.path("list/lost")).unwrap();
        fs::write(desk.path("face.ply"), b"ply").unwrap();
        age(&desk.path("face.ply"), 60);
        age(&desk.path("list"), 60);
        assert!(desk.ask());
        assert_eq!(desk.recall(), Some(json!("done")));
        desk
    }

    /// An answer must not outlive `change`, and must be there again after another full look.
    fn check(change: impl FnOnce(&Desk)) {
        let desk = desk();
        change(&desk);
        assert_eq!(desk.recall(), None);
        let _ = fs::remove_file(desk.path("target"));
        age(&desk.path("list"), 50);
        assert!(desk.ask());
        assert_eq!(desk.recall(), Some(json!("done")));
    }

    #[test]
    fn an_answer_ends_with_anything_it_rests_on() {
        check(|desk| age(&desk.path("face.ply"), 30));
        check(|desk| {
            fs::rename(desk.path("face.ply"), desk.path("old.ply")).unwrap();
            fs::write(desk.path("face.ply"), b"ply").unwrap();
            age(&desk.path("face.ply"), 60);
        });
        check(|desk| fs::write(desk.path("list/new.tif"), b"").unwrap());
        check(|desk| fs::write(desk.path("target"), b"what a dangling link leads to").unwrap());
        check(|desk| {
            let path = desk.path("run/run.json");
            let before = fs::metadata(&path).unwrap().modified().unwrap();
            std::thread::sleep(Duration::from_millis(25));
            fs::write(&path, "[]").unwrap();
            fs::File::options().write(true).open(&path).unwrap().set_modified(before).unwrap();
        });
        check(|desk| {
            let hex = desk.large.to_string();
            fs::remove_file(desk.path("store/blobs").join(&hex[..2]).join(hex)).unwrap();
        });
        check(|desk| {
            let hex = desk.large.to_string();
            age(&desk.path("store/blobs").join(&hex[..2]).join(hex), 7);
        });
        check(|desk| _ = Store::open(&desk.path("store")).unwrap().put(b"another").unwrap());
        check(|desk| fs::write(slot(&desk.path("store"), &desk.question), "rockface answer 3 x\n{}").unwrap());
    }

    #[test]
    fn another_question_or_format_has_no_answer() {
        let desk = desk();
        assert_eq!(recall(&desk.path("store"), &Digest::of(b"another")), None);
        assert_eq!(recall(&desk.path("nowhere"), &desk.question), None);
        fs::write(desk.path("store/format"), "rockface store 99\n").unwrap();
        assert_eq!(desk.recall(), None);
    }

    #[test]
    fn an_answer_that_somebody_else_may_have_filed_is_none() {
        let desk = desk();
        let (filed, aside) = (slot(&desk.path("store"), &desk.question), desk.path("aside"));
        fs::rename(&filed, &aside).unwrap();
        std::os::unix::fs::symlink(&aside, &filed).unwrap();
        assert_eq!(desk.recall(), None, "a link leads to what anybody wrote");
        fs::rename(&aside, &filed).unwrap();
        assert_eq!(desk.recall(), Some(json!("done")));
        // As somebody would who has no key of this user: the digest of the body in place of the mark.
        let text = fs::read(&filed).unwrap();
        let body = &text[text.iter().position(|byte| *byte == b'\n').unwrap() + 1..];
        fs::write(&filed, [format!("{FORMAT} {}\n", Digest::of(body)).as_bytes(), body].concat()).unwrap();
        assert_eq!(desk.recall(), None);
        fs::write(&filed, &text).unwrap();
        assert_eq!(desk.recall(), Some(json!("done")));
    }

    #[test]
    fn what_cannot_be_vouched_for_is_not_filed() {
        let desk = desk();
        fs::write(desk.path("face.ply"), b"ply").unwrap();
        assert!(!desk.ask(), "a file just modified may be modified again unseen");
        age(&desk.path("face.ply"), 60);
        let store = Store::open(&desk.path("store")).unwrap();
        store.hash_file(&desk.path("face.ply")).unwrap();
        store.sync().unwrap();
        let other = Store::open(&desk.path("store")).unwrap();
        other.put(b"written by another process").unwrap();
        other.sync().unwrap();
        assert!(!store.memory().remember_answer(&desk.question, &json!(1), &desk.grounds()).unwrap());
        store.refresh().unwrap();
        assert!(store.memory().remember_answer(&desk.question, &json!(1), &desk.grounds()).unwrap());
    }
}
