//! References: `step.port`, or `step.port[axis=item, …]` for one point.

use super::node::Word;
use crate::diagnostic::Span;

/// Names one output of a step, perhaps at one item of some axes.
#[derive(Debug, Clone, PartialEq)]
pub struct Reference {
    /// Where it stands.
    pub span: Span,
    /// The step.
    pub step: String,
    /// Its output port.
    pub port: String,
    /// The items picked, by axis.
    pub picks: Vec<(Word, String)>,
}

/// Parses a reference, or says what is wrong with it.
pub fn parse_reference(text: &str, span: Span) -> Result<Reference, String> {
    let wrong = || format!("`{text}` is not a reference to an output");
    let (head, picks) = match text.split_once('[') {
        Some((head, rest)) => (head, Some(rest.strip_suffix(']').ok_or_else(wrong)?)),
        None => (text, None),
    };
    let (step, port) = head.trim().split_once('.').ok_or_else(wrong)?;
    if step.is_empty() || port.is_empty() || port.contains('.') {
        return Err(wrong());
    }
    let pick = |pick: &str| {
        let (axis, item) = pick.split_once('=').ok_or_else(wrong)?;
        Ok((Word { span, text: axis.trim().to_owned() }, item.trim().to_owned()))
    };
    let picks =
        picks.map_or_else(|| Ok(Vec::new()), |picks| picks.split(',').map(pick).collect::<Result<_, String>>())?;
    let picks: Vec<(Word, String)> = picks;
    for (index, (axis, _)) in picks.iter().enumerate() {
        if picks[..index].iter().any(|(earlier, _)| earlier.text == axis.text) {
            return Err(format!("`{text}` picks an item of axis `{}` twice", axis.text));
        }
    }
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
    fn anything_else_is_refused() {
        for text in ["dem", "dem.", ".x", "a.b.c", "a.b[c]", "a.b[c=1", "a.b[c=1,c=2]", ""] {
            assert!(parse_reference(text, Span::default()).is_err(), "{text}");
        }
    }
}
