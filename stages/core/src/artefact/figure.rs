//! A chart for people, kept as SVG: sharp at any size, and it follows the colours of the page it stands in.

use super::{Artefact, CodecError, Kind, Noun};

/// A finished SVG file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// The text of the SVG file.
    pub svg: String,
}

/// Elements that draw and do nothing else.
const PLAIN: [&str; 17] = [
    "circle", "desc", "ellipse", "g", "image", "line", "path", "polygon", "polyline", "rect", "style", "svg", "text",
    "title", "tspan", "metadata", "marker",
];

impl Figure {
    /// Whether it may stand inside a page: it runs nothing, loads nothing, and has no names that could clash with others'.
    pub fn is_plain(&self) -> bool {
        let Ok(document) = roxmltree::Document::parse(&self.svg) else { return false };
        let inert = |attribute: roxmltree::Attribute| match attribute.name() {
            "id" => false,
            "href" => attribute.value().starts_with("data:image/png;base64,"),
            name => !name.starts_with("on") && !attribute.value().contains("url("),
        };
        let plain = |node: roxmltree::Node| {
            let loads = || node.text().is_some_and(|text| text.contains("@import") || text.contains("url("));
            PLAIN.contains(&node.tag_name().name())
                && node.attributes().all(inert)
                && !(node.has_tag_name("style") && loads())
        };
        document.descendants().filter(roxmltree::Node::is_element).all(plain)
    }
}

impl Noun for Figure {
    const KIND: Kind = Kind::Figure;
    fn of(artefact: &Artefact) -> Option<&Self> {
        if let Artefact::Figure(value) = artefact { Some(value) } else { None }
    }
    fn encode(&self) -> Result<Vec<u8>, CodecError> {
        Ok(self.svg.clone().into_bytes())
    }
    fn decode(bytes: &[u8]) -> Result<Self, CodecError> {
        let svg = std::str::from_utf8(bytes).map_err(|error| CodecError(format!("not an SVG file: {error}")))?;
        let options = roxmltree::ParsingOptions { allow_dtd: true, ..Default::default() };
        let document = roxmltree::Document::parse_with_options(svg, options);
        let document = document.map_err(|error| CodecError(format!("not an SVG file: {error}")))?;
        if !document.root_element().has_tag_name("svg") {
            let found = document.root_element().tag_name().name();
            return Err(CodecError(format!("not an SVG file: its outermost element is `{found}`")));
        }
        Ok(Self { svg: svg.to_owned() })
    }
    fn memory_bytes(&self) -> usize {
        self.svg.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_svg_is_refused() {
        let said = |text: &str| Figure::decode(text.as_bytes()).unwrap_err().0;
        assert!(said("<svg>").starts_with("not an SVG file"));
        assert_eq!(said("<html/>"), "not an SVG file: its outermost element is `html`");
        let figure = Figure { svg: "<svg xmlns=\"http://www.w3.org/2000/svg\"/>".to_owned() };
        assert_eq!(Figure::decode(&figure.encode().unwrap()), Ok(figure));
    }

    #[test]
    fn what_runs_or_loads_something_is_not_plain() {
        let plain = |inside: &str| {
            Figure { svg: format!("<svg xmlns=\"http://www.w3.org/2000/svg\">{inside}</svg>") }.is_plain()
        };
        assert!(plain("<g><rect width=\"3\" height=\"2\"/></g>"));
        for inside in [
            "<script>1</script>",
            "<rect onclick=\"x()\"/>",
            "<image href=\"https://example.org/a.png\"/>",
            "<foreignObject/>",
            "<rect id=\"a\"/>",
            "<style>@import 'a'</style>",
            "<rect fill=\"url(#a)\"/>",
        ] {
            assert!(!plain(inside), "{inside}");
        }
    }
}
