//! The tree of a long YAML text in a compact file, so that the text is not taken apart anew as long as it is the same.
//!
//! At most 16 files in a folder, each replaced in one step and believed only if it bears the mark of this user, made of the text and the
//! tree: in a shared store, or one that was given away, somebody else could put another pipeline in the place of a text.
//! A node is a byte that tells what it is, where it stands (start and length, as many bytes as they need), and its content.

use std::path::{Path, PathBuf};

use rockface_cache::Digest;
use serde_json::Value;

use super::node::{Data, Key, Node};
use crate::diagnostic::{Diagnostic, Span};

/// Shorter texts are read as quickly as their trees.
const LONG_BYTES: usize = 64 << 10;
/// Opens every file; trees of another version are none.
const FORMAT: &str = "rockface tree 2";
/// Tells marks on trees from those on anything else.
const MARKED: &[u8] = b"tree";
/// Trees that are nested deeper are not believed: the text says itself whether it is nested too deep.
const DEPTH: usize = 200;
/// Room that is made for a list before its elements are seen.
const LIST: usize = 1024;

/// The tree of a text, from the folder if it is there; a new one is put there, if the folder is.
///
/// # Errors
///
/// What is wrong with the text.
pub fn parse(text: &str, source: usize, folder: Option<&Path>) -> Result<Node, Diagnostic> {
    // A link in its place, which somebody else may have put into a store, may lead anywhere.
    let is_own = |folder: &&Path| folder.symlink_metadata().is_ok_and(|meta| meta.is_dir());
    let Some(folder) = folder.filter(is_own).filter(|_| text.len() >= LONG_BYTES) else {
        return Node::parse(text, source);
    };
    let digest = Digest::of(text.as_bytes());
    let file = slot(folder, &digest);
    if let Some(tree) = rockface_cache::read_plain(&file).and_then(|bytes| read(&bytes, &digest, text, source)) {
        return Ok(tree);
    }
    let tree = Node::parse(text, source)?;
    // A tree that cannot be kept costs time, nothing else.
    let _ = write(&tree, &digest, &file);
    Ok(tree)
}

fn slot(folder: &Path, digest: &Digest) -> PathBuf {
    folder.join(&digest.to_string()[..1])
}

fn write(tree: &Node, text: &Digest, file: &Path) -> std::io::Result<()> {
    let mut body = Vec::new();
    put_node(&mut body, tree);
    let Some(mark) = mark(text, &body) else { return Ok(()) };
    let head = format!("{FORMAT} {text} {mark}\n");
    let mut temporary = tempfile::NamedTempFile::new_in(file.parent().unwrap_or(Path::new(".")))?;
    std::io::Write::write_all(&mut temporary, head.as_bytes())?;
    std::io::Write::write_all(&mut temporary, &body)?;
    temporary.persist(file).map(drop).map_err(|error| error.error)
}

fn mark(text: &Digest, body: &[u8]) -> Option<Digest> {
    rockface_cache::mark(&[MARKED, text.as_bytes(), body])
}

fn read(bytes: &[u8], digest: &Digest, text: &str, source: usize) -> Option<Node> {
    let end = bytes.iter().position(|byte| *byte == b'\n')?;
    let (head, body) = (std::str::from_utf8(&bytes[..end]).ok()?, &bytes[end + 1..]);
    let told = head.strip_prefix(FORMAT)?.trim().split_once(' ')?;
    if told != (digest.to_string().as_str(), mark(digest, body)?.to_string().as_str()) {
        return None;
    }
    let mut reader = Reader { body, text, source, depth: 0 };
    let tree = reader.node()?;
    reader.body.is_empty().then_some(tree)
}

fn put_number(out: &mut Vec<u8>, mut number: u64) {
    while number >= 0x80 {
        out.push(number as u8 | 0x80);
        number >>= 7;
    }
    out.push(number as u8);
}

fn put_text(out: &mut Vec<u8>, text: &str) {
    put_number(out, text.len() as u64);
    out.extend(text.as_bytes());
}

fn put_span(out: &mut Vec<u8>, span: Span) {
    put_number(out, span.start as u64);
    put_number(out, (span.end - span.start) as u64);
}

fn put_node(out: &mut Vec<u8>, node: &Node) {
    let kind = match &node.data {
        Data::Scalar(Value::String(_)) => b's',
        // Null, truth values and numbers; a whole number stays one.
        Data::Scalar(_) => b'j',
        Data::List(_) => b'l',
        Data::Map(_) => b'm',
    };
    out.push(kind);
    put_span(out, node.span);
    match &node.data {
        Data::Scalar(Value::String(text)) => put_text(out, text),
        Data::Scalar(value) => {
            put_text(out, &value.to_string());
            put_text(out, &node.written);
        }
        Data::List(items) => {
            put_number(out, items.len() as u64);
            items.iter().for_each(|item| put_node(out, item));
        }
        Data::Map(entries) => {
            put_number(out, entries.len() as u64);
            for (key, node) in entries {
                put_span(out, key.span);
                put_text(out, &key.name);
                put_node(out, node);
            }
        }
    }
}

struct Reader<'a> {
    body: &'a [u8],
    text: &'a str,
    source: usize,
    /// Lists and maps around what is read now.
    depth: usize,
}

impl<'a> Reader<'a> {
    fn byte(&mut self) -> Option<u8> {
        let (first, rest) = self.body.split_first()?;
        self.body = rest;
        Some(*first)
    }

    fn number(&mut self) -> Option<usize> {
        let mut number = 0;
        for shift in (0..63).step_by(7) {
            let byte = self.byte()?;
            number |= u64::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return usize::try_from(number).ok();
            }
        }
        None
    }

    fn text(&mut self) -> Option<&'a str> {
        let length = self.number()?;
        let (text, rest) = self.body.split_at_checked(length)?;
        self.body = rest;
        std::str::from_utf8(text).ok()
    }

    fn span(&mut self) -> Option<Span> {
        let (start, length) = (self.number()?, self.number()?);
        // A span may reach one byte beyond its text.
        let end = start.checked_add(length).filter(|end| *end <= self.text.len() + 1)?;
        Some(Span { source: self.source, start, end })
    }

    fn node(&mut self) -> Option<Node> {
        let kind = self.byte()?;
        let span = self.span()?;
        let mut written = String::new();
        let data = match kind {
            b's' => Data::Scalar(Value::String(self.text()?.to_owned())),
            b'j' => {
                let text = self.text()?;
                let whole = text.parse::<u64>().ok().map(Value::from);
                let value = whole.or_else(|| serde_json::from_str(text).ok())?;
                self.text()?.clone_into(&mut written);
                Data::Scalar(value)
            }
            b'l' => Data::List(self.many(Self::node)?),
            b'm' => Data::Map(self.many(Self::entry)?),
            _ => return None,
        };
        Some(Node { span, data, written })
    }

    /// A number of things and the things, in no more room than they need: most lists and maps are short.
    fn many<T>(&mut self, one: fn(&mut Self) -> Option<T>) -> Option<Vec<T>> {
        // Each takes a byte at least; a larger number is damage.
        let count = self.number().filter(|count| *count <= self.body.len())?;
        let mut many = Vec::with_capacity(count.min(LIST));
        self.depth += 1;
        if self.depth > DEPTH {
            return None;
        }
        for _ in 0..count {
            many.push(one(self)?);
        }
        self.depth -= 1;
        Some(many)
    }

    fn entry(&mut self) -> Option<(Key, Node)> {
        let (span, name) = (self.span()?, self.text()?.to_owned());
        Some((Key { span, name }, self.node()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str =
        "a: [1, 2.50, -3, 1e300, 18446744073709551615, true, null, ~, 'ü', \"x\\ny\"]\nb: {c: {}, d: []}\n";

    /// Whether this user can have a key; a line says where not.
    fn has_key() -> bool {
        let has_key = rockface_cache::mark(&[]).is_some();
        if !has_key {
            println!("skipped: there is no folder for a key");
        }
        has_key
    }

    #[test]
    fn a_tree_comes_back_as_it_was_and_nothing_else_is_believed() {
        if !has_key() {
            return;
        }
        let tree = Node::parse(TEXT, 3).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let (digest, file) = (Digest::of(TEXT.as_bytes()), folder.path().join("0"));
        write(&tree, &digest, &file).unwrap();
        let bytes = std::fs::read(&file).unwrap();
        assert_eq!(read(&bytes, &digest, TEXT, 3).as_ref(), Some(&tree));
        assert_eq!(read(&bytes, &Digest::of(b"another"), TEXT, 3), None);
        for at in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[at] ^= 1;
            assert_eq!(read(&damaged, &digest, TEXT, 3), None, "{at}");
            assert_eq!(read(&bytes[..at], &digest, TEXT, 3), None, "{at}");
        }
    }

    #[test]
    fn a_tree_without_end_is_not_believed() {
        if !has_key() {
            return;
        }
        // Lists of one list each, all at the start of the text; written by nobody, but with the right mark.
        let body = [b'l', 0, 0, 1].repeat(100_000);
        let digest = Digest::of(TEXT.as_bytes());
        let file = |mark: Digest, body: &[u8]| [format!("{FORMAT} {digest} {mark}\n").as_bytes(), body].concat();
        assert_eq!(read(&file(mark(&digest, &body).unwrap(), &body), &digest, TEXT, 0), None);
        // A whole tree with no mark but its digest is that of somebody else.
        let mut whole = Vec::new();
        put_node(&mut whole, &Node::parse(TEXT, 0).unwrap());
        assert!(read(&file(mark(&digest, &whole).unwrap(), &whole), &digest, TEXT, 0).is_some());
        assert_eq!(read(&file(Digest::of(&whole), &whole), &digest, TEXT, 0), None);
    }

    #[test]
    fn long_texts_are_taken_from_the_folder_the_second_time() {
        if !has_key() {
            return;
        }
        let text: String = (0..8000).map(|n| format!("key{n}: {{v: {n}}}\n")).collect();
        let folder = tempfile::tempdir().unwrap();
        let first = parse(&text, 0, Some(folder.path())).unwrap();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
        assert_eq!(parse(&text, 0, Some(folder.path())).unwrap(), first);
        assert_eq!(parse(&text, 0, Some(&folder.path().join("nowhere"))).unwrap(), first);
        let (home, link) = (tempfile::tempdir().unwrap(), folder.path().join("link"));
        std::os::unix::fs::symlink(home.path(), &link).unwrap();
        assert_eq!(parse(&text, 0, Some(&link)).unwrap(), first);
        assert_eq!(std::fs::read_dir(home.path()).unwrap().count(), 0);
        assert!(parse(&format!("{text}x"), 0, Some(folder.path())).is_err());
    }
}
