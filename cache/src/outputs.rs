//! The outputs of a step, by port: a short sorted list, since a tree map takes ten times the memory for one or two.

use std::fmt;

use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

use crate::names::NameError;
use crate::{OutputRecord, SafeName};

type Entry = (SafeName, OutputRecord);

/// The output at each port, sorted by port. A port may become part of a path, so it is a safe name.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Outputs(Vec<Entry>);

impl Outputs {
    /// The output at a port.
    pub fn get(&self, port: &str) -> Option<&OutputRecord> {
        self.place(port).ok().map(|at| &self.0[at].1)
    }

    /// The same, to be changed.
    pub fn get_mut(&mut self, port: &str) -> Option<&mut OutputRecord> {
        self.place(port).ok().map(|at| &mut self.0[at].1)
    }

    /// Sets the output at a port.
    pub fn insert(&mut self, port: SafeName, output: OutputRecord) {
        match self.place(&port) {
            Ok(at) => self.0[at].1 = output,
            Err(at) => self.0.insert(at, (port, output)),
        }
    }

    fn place(&self, port: &str) -> Result<usize, usize> {
        self.0.binary_search_by(|(own, _)| own.as_str().cmp(port))
    }

    /// Ports and their outputs.
    pub fn iter(&self) -> Iter<'_> {
        self.0.iter().map(|(port, output)| (port, output))
    }

    /// The names of the ports, sorted.
    pub fn keys(&self) -> impl Iterator<Item = &SafeName> {
        self.0.iter().map(|(port, _)| port)
    }

    /// The outputs, by port.
    pub fn values(&self) -> impl Iterator<Item = &OutputRecord> {
        self.0.iter().map(|(_, output)| output)
    }

    /// Ports and their outputs, which may be changed in place.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = (&SafeName, &mut OutputRecord)> {
        self.0.iter_mut().map(|(port, output)| (&*port, output))
    }
}

/// The iterator of [`Outputs::iter`]: a port and its output at a time, sorted by port.
pub type Iter<'a> = std::iter::Map<std::slice::Iter<'a, Entry>, fn(&'a Entry) -> (&'a SafeName, &'a OutputRecord)>;

impl<'a> IntoIterator for &'a Outputs {
    type Item = (&'a SafeName, &'a OutputRecord);
    type IntoIter = Iter<'a>;
    fn into_iter(self) -> Iter<'a> {
        self.iter()
    }
}

impl FromIterator<Entry> for Outputs {
    fn from_iter<I: IntoIterator<Item = Entry>>(entries: I) -> Self {
        let mut entries: Vec<Entry> = entries.into_iter().collect();
        // Of two with one port the later counts: sorting keeps their order, and duplicates are taken from the end.
        entries.sort_by(|(one, _), (other, _)| one.cmp(other));
        entries.reverse();
        entries.dedup_by(|(later, _), (kept, _)| later == kept);
        entries.reverse();
        entries.shrink_to_fit();
        Self(entries)
    }
}

impl<const N: usize> TryFrom<[(&str, OutputRecord); N]> for Outputs {
    type Error = NameError;
    fn try_from(entries: [(&str, OutputRecord); N]) -> Result<Self, NameError> {
        entries.into_iter().map(|(port, output)| Ok((SafeName::new(port)?, output))).collect()
    }
}

impl std::ops::Index<&str> for Outputs {
    type Output = OutputRecord;
    /// The output at a port that exists.
    fn index(&self, port: &str) -> &OutputRecord {
        self.get(port).expect("an output of this port")
    }
}

impl Serialize for Outputs {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(self)
    }
}

impl<'de> Deserialize<'de> for Outputs {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl<'de> Visitor<'de> for Reader {
            type Value = Outputs;
            fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
                f.write_str("a map of ports to their outputs")
            }
            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Outputs, A::Error> {
                let mut entries = Vec::with_capacity(1);
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(entries.into_iter().collect())
            }
        }
        deserializer.deserialize_map(Reader)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Digest;

    fn output(bytes: u64) -> OutputRecord {
        let digest = Digest::of(b"");
        OutputRecord { kind: "mesh".into(), digest, bytes, memory_bytes: None, kept: true, items: None }
    }

    #[test]
    fn ports_are_sorted_found_and_written_as_a_map() {
        let mut outputs: Outputs = [("mesh", output(1)), ("depth", output(2))].try_into().unwrap();
        outputs.insert(SafeName::new("mesh").unwrap(), output(3));
        assert_eq!(outputs.keys().map(SafeName::as_str).collect::<Vec<_>>(), ["depth", "mesh"]);
        assert_eq!((outputs["mesh"].bytes, outputs.get("dem")), (3, None));
        let text = serde_json::to_string(&outputs).unwrap();
        assert!(text.starts_with(r#"{"depth":{"#), "{text}");
        assert_eq!(serde_json::from_str::<Outputs>(&text).unwrap(), outputs);
    }

    #[test]
    fn a_port_that_leads_elsewhere_is_not_read() {
        let written = serde_json::to_string(&output(1)).unwrap();
        for port in ["../mesh", "/mesh", "a/b", "..", ""] {
            assert!(serde_json::from_str::<Outputs>(&format!("{{{port:?}: {written}}}")).is_err(), "{port}");
        }
    }
}
