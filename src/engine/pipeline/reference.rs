//! References: `step.port`, or `step.port[axis=item, …]` for one point.

use std::collections::BTreeMap;

use super::node::Word;
use crate::diagnostic::Span;

/// Between the name of a use and the name of a step inside.
pub const INSIDE: char = '/';

/// Names one output of a step, perhaps at one item of some axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// Its place in the text.
    pub span: Span,
    /// The name of the step.
    pub step: String,
    /// The output port that is read.
    pub port: String,
    /// The items picked, by axis.
    pub picks: Vec<(Word, String)>,
}

/// A step, perhaps one of its outputs, perhaps one point of it, as messages write it and as pipelines do:
/// `step[axis=item,…].port` and `step.port[axis=item,…]`, the axes in any order.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Label<'t> {
    /// The name of the step.
    pub step: &'t str,
    /// The output port that is read.
    pub port: Option<&'t str>,
    /// The items picked, by axis.
    pub picks: Vec<(&'t str, &'t str)>,
}

impl<'t> Label<'t> {
    /// Takes a text apart; `None` where it is no label.
    pub fn parse(text: &'t str) -> Option<Self> {
        let (head, picks, tail) = match text.split_once('[') {
            None => (text, Vec::new(), ""),
            Some((head, rest)) => {
                let (inside, tail) = rest.split_once(']')?;
                let pick = |pick: &'t str| pick.split_once('=').map(|(axis, item)| (axis.trim(), item.trim()));
                (head, inside.split(',').map(pick).collect::<Option<_>>()?, tail.trim())
            }
        };
        let (step, port) = match (head.trim().split_once('.'), tail) {
            (Some((step, port)), "") => (step, Some(port)),
            (None, "") => (head.trim(), None),
            (None, tail) => (head.trim(), Some(tail.strip_prefix('.')?)),
            (Some(_), _) => return None,
        };
        let is_name = |name: &str| !name.is_empty() && !name.contains(['.', '[', ']']);
        (is_name(step) && port.is_none_or(is_name)).then_some(Self { step, port, picks })
    }

    /// Whether a point has every item that is picked. An axis of a part is called as in points, or by its full name.
    pub fn fits(&self, point: &BTreeMap<String, String>) -> bool {
        let short = |axis: &'t str| axis.rsplit(INSIDE).next().unwrap_or_default();
        let own = |axis: &'t str| point.get(axis).or_else(|| point.get(short(axis)));
        self.picks.iter().all(|(axis, item)| own(axis).is_some_and(|own| own == item))
    }

    /// The same points of what stands behind an output of a use.
    pub fn of_inner(&self, inner: &'t str) -> Option<Self> {
        let inner = Self::parse(inner)?;
        Some(Self { picks: inner.picks.into_iter().chain(self.picks.iter().copied()).collect(), ..inner })
    }
}

/// Parses a reference, or says what is wrong with it.
pub fn parse_reference(text: &str, span: Span) -> Result<Reference, String> {
    let label = Label::parse(text).and_then(|label| Some((label.port?, label)));
    let (port, Label { step, picks, .. }) = label.ok_or_else(|| format!("`{text}` is not a reference to an output"))?;
    for (index, (axis, _)) in picks.iter().enumerate() {
        if picks[..index].iter().any(|(earlier, _)| earlier == axis) {
            return Err(format!("`{text}` picks an item of axis `{axis}` twice"));
        }
    }
    let pick = |(axis, item): (&str, &str)| (Word { span, text: axis.to_owned() }, item.to_owned());
    let picks = picks.into_iter().map(pick).collect();
    Ok(Reference { span, step: step.to_owned(), port: port.to_owned(), picks })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn plain_and_picked() {
        let plain = parse_reference("dem.raster", Span::default()).unwrap();
        assert_eq!((plain.step.as_str(), plain.port.as_str(), plain.picks.len()), ("dem", "raster", 0));
        let picked = parse_reference("dem.raster[epoch=pre, k=0.5]", Span::default()).unwrap();
        let picks: Vec<_> = picked.picks.iter().map(|(a, i)| (a.text.as_str(), i.as_str())).collect();
        assert_eq!(picks, [("epoch", "pre"), ("k", "0.5")]);
    }

    #[test]
    fn a_label_reads_as_the_reference_it_stands_for() {
        let point = BTreeMap::from([("epoch".to_owned(), "pre".to_owned()), ("k".to_owned(), "0.5".to_owned())]);
        for text in ["dem.raster[epoch=pre,k=0.5]", "dem[k=0.5,epoch=pre].raster", "dem[ k=0.5 ].raster", "dem.raster"]
        {
            let label = Label::parse(text).unwrap();
            assert_eq!((label.step, label.port), ("dem", Some("raster")), "{text}");
            assert!(label.fits(&point), "{text}");
            assert_eq!(parse_reference(text, Span::default()).unwrap().picks.len(), label.picks.len());
        }
        assert!(!Label::parse("dem[k=0.6]").unwrap().fits(&point));
        assert!(!Label::parse("dem[other=0.5]").unwrap().fits(&point));
    }

    #[test]
    fn anything_else_is_refused() {
        for text in
            ["dem", "dem.", ".x", "a.b.c", "a.b[c]", "a.b[c=1", "a.b[c=1,c=2]", "", "a[c=1]", "a.b[c=1].d", "a.b[]"]
        {
            assert!(parse_reference(text, Span::default()).is_err(), "{text}");
        }
    }
}
