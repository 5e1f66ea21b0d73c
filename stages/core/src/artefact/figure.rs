//! A chart for people, kept as SVG: sharp at any size, and it follows the colours of the page it stands in.

use super::{Artefact, CodecError, Kind, Noun};

/// A finished SVG file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// The text of the SVG file.
    pub svg: String,
}

/// The namespace of what may be in a figure.
const SVG: &str = "http://www.w3.org/2000/svg";
/// Elements that draw and do nothing else. None of them may hold another one.
const ELEMENTS: [&str; 9] = ["circle", "image", "line", "polygon", "polyline", "rect", "style", "text", "title"];
/// Attributes whose values are words and numbers.
const ATTRIBUTES: [&str; 24] = [
    "cx",
    "cy",
    "dy",
    "fill",
    "font-size",
    "font-style",
    "font-weight",
    "height",
    "opacity",
    "points",
    "preserveAspectRatio",
    "r",
    "role",
    "stroke",
    "stroke-width",
    "text-anchor",
    "viewBox",
    "width",
    "x",
    "x1",
    "x2",
    "y",
    "y1",
    "y2",
];

impl Figure {
    /// The one style sheet that a figure inside a page may have, since it holds for all of the page: the colours of our charts.
    /// Each is a variable that the page may set, with a colour to fall back on.
    pub const STYLE_SHEET: &str = concat!(
        ".rf-p{fill:var(--paper,#ffffff)}.rl-p{stroke:var(--paper,#ffffff);stroke-linejoin:round}",
        ".rf-t{fill:var(--ink,#1f2328)}.rl-t{stroke:var(--ink,#1f2328);stroke-linejoin:round}",
        ".rf-f{fill:var(--ink-faint,#59636e)}.rl-f{stroke:var(--ink-faint,#59636e);stroke-linejoin:round}",
        ".rf-h{fill:var(--ink-hair,#dde2e8)}.rl-h{stroke:var(--ink-hair,#dde2e8);stroke-linejoin:round}",
        ".rf-m{fill:var(--ink-muted,#8b949e)}.rl-m{stroke:var(--ink-muted,#8b949e);stroke-linejoin:round}",
        ".rf-r{fill:var(--ink-faint,#5a646f)}.rl-r{stroke:var(--ink-faint,#5a646f);stroke-linejoin:round;stroke-dasharray:50 40}",
        ".rf-s1{fill:var(--series-1,#0072b2)}.rl-s1{stroke:var(--series-1,#0072b2);stroke-linejoin:round}",
        ".rf-s2{fill:var(--series-2,#d55e00)}.rl-s2{stroke:var(--series-2,#d55e00);stroke-linejoin:round}",
        ".rf-s3{fill:var(--series-3,#009e73)}.rl-s3{stroke:var(--series-3,#009e73);stroke-linejoin:round}",
        ".rf-s4{fill:var(--series-4,#cc79a7)}.rl-s4{stroke:var(--series-4,#cc79a7);stroke-linejoin:round}",
        ".rf-s5{fill:var(--series-5,#56b4e9)}.rl-s5{stroke:var(--series-5,#56b4e9);stroke-linejoin:round}",
        ".rf-s6{fill:var(--series-6,#e69f00)}.rl-s6{stroke:var(--series-6,#e69f00);stroke-linejoin:round}",
    );

    /// The figure as it may stand inside a page, written anew from what it draws: a reader of HTML finds in it what a reader of
    /// XML does. `None` where it holds anything but plain drawing in the way of our charts: what could run, load, style the page,
    /// have a name that clashes with others, or is not known.
    pub fn inside_page(&self) -> Option<String> {
        let document = roxmltree::Document::parse(&self.svg).ok()?;
        let root = document.root_element();
        let is_alone = document.root().children().all(|node| node == root);
        if !is_alone || root.tag_name() != (SVG, "svg").into() {
            return None;
        }
        let mut text = format!("<svg xmlns=\"{SVG}\"");
        write_attributes(&mut text, root)?;
        text.push_str(">\n");
        for node in root.children() {
            if node.is_element() {
                write_element(&mut text, node)?;
            } else if !is_blank(node) {
                return None;
            }
        }
        text.push_str("</svg>\n");
        Some(text)
    }
}

/// Whether it is white space between elements.
fn is_blank(node: roxmltree::Node) -> bool {
    node.is_text() && node.text().is_none_or(|text| text.trim().is_empty())
}

/// Writes an element that holds no other.
fn write_element(to: &mut String, node: roxmltree::Node) -> Option<()> {
    let name = ELEMENTS.iter().find(|name| node.tag_name() == (SVG, **name).into())?;
    if !node.children().all(|child| child.is_text()) {
        return None;
    }
    to.push('<');
    to.push_str(name);
    write_attributes(to, node)?;
    let inside = || node.children().filter_map(|child| child.text());
    match *name {
        "text" | "title" => {
            to.push('>');
            inside().for_each(|text| push_escaped(to, text));
        }
        "style" if inside().eq([Figure::STYLE_SHEET]) => {
            to.push('>');
            to.push_str(Figure::STYLE_SHEET);
        }
        "style" => return None,
        _ if node.children().all(is_blank) => {
            to.push_str("/>\n");
            return Some(());
        }
        _ => return None,
    }
    to.push_str("</");
    to.push_str(name);
    to.push_str(">\n");
    Some(())
}

/// Writes the attributes of an element, all of which have to be known, with values that name nothing outside.
fn write_attributes(to: &mut String, node: roxmltree::Node) -> Option<()> {
    for attribute in node.attributes() {
        let (name, value) = (attribute.name(), attribute.value());
        if attribute.namespace().is_some() || !is_harmless(node.tag_name().name(), name, value) {
            return None;
        }
        to.push(' ');
        to.push_str(name);
        to.push_str("=\"");
        push_escaped(to, value);
        to.push('"');
    }
    Some(())
}

/// Whether an attribute is one of our charts, of the same letters, with a value of the kind they give it.
fn is_harmless(element: &str, name: &str, value: &str) -> bool {
    // Some values are read as style sheets are: neither brackets, quotes nor escapes.
    let is_word = |sign: char| sign.is_ascii_alphanumeric() || " \n.,+-#%".contains(sign);
    match name {
        "class" => {
            let class = value.strip_prefix("rf-").or_else(|| value.strip_prefix("rl-"));
            class.is_some_and(|class| class.chars().all(|sign| sign.is_ascii_alphanumeric()))
        }
        "font-family" => value.chars().all(|sign| is_word(sign) || sign == '\''),
        "href" => {
            let data = value.strip_prefix("data:image/png;base64,");
            let is_data = |data: &str| data.chars().all(|sign| sign.is_ascii_alphanumeric() || "+/=".contains(sign));
            element == "image" && data.is_some_and(is_data)
        }
        "style" => value == "image-rendering:pixelated",
        "transform" => value.chars().all(|sign| is_word(sign) || "()".contains(sign)),
        _ => ATTRIBUTES.contains(&name) && value.chars().all(is_word),
    }
}

/// Adds a text, such that it is one for readers of XML and of HTML.
fn push_escaped(to: &mut String, text: &str) {
    for sign in text.chars() {
        match sign {
            '&' => to.push_str("&amp;"),
            '<' => to.push_str("&lt;"),
            '>' => to.push_str("&gt;"),
            '"' => to.push_str("&quot;"),
            _ => to.push(sign),
        }
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

    fn inside(drawing: &str) -> Option<String> {
        Figure { svg: format!("<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"9\">{drawing}</svg>") }.inside_page()
    }

    #[test]
    fn a_plain_drawing_is_written_anew() {
        let written =
            inside("<text x='1'\n>a &lt;b&gt; <![CDATA[<script>]]> &#34;&amp;lt;</text> <rect\twidth=\"3\"></rect>");
        let expected = "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"9\">\n\
                        <text x=\"1\">a &lt;b&gt; &lt;script&gt; &quot;&amp;lt;</text>\n<rect width=\"3\"/>\n</svg>\n";
        assert_eq!(written.as_deref(), Some(expected));
        assert_eq!(Figure { svg: expected.to_owned() }.inside_page().as_deref(), Some(expected));
        assert!(inside("<image href=\"data:image/png;base64,aa+/==\" style=\"image-rendering:pixelated\"/>").is_some());
        assert!(inside(&format!("<style>{}</style>", Figure::STYLE_SHEET)).is_some());
    }

    #[test]
    fn what_runs_loads_or_is_not_known_does_not_stand_inside_a_page() {
        for drawing in [
            "<script>1</script>",
            "<SCRIPT>1</SCRIPT>",
            "<foreignObject/>",
            "<a href=\"#b\"/>",
            "<rect onclick=\"x()\"/>",
            "<rect ONCLICK=\"x()\"/>",
            "<rect id=\"a\"/>",
            "<rect style=\"fill:red\"/>",
            "<rect class=\"status\"/>",
            "<rect fill=\"url(#a)\"/>",
            "<rect fill=\"URL(http://example.org/a.svg)\"/>",
            "<rect fill=\"u\\72l(a)\"/>",
            "<image href=\"https://example.org/a.png\"/>",
            "<image HREF=\"https://example.org/a.png\"/>",
            "<image href=\"data:image/png;base64,&quot; onerror=&quot;x()\"/>",
            "<rect xmlns:l=\"http://www.w3.org/1999/xlink\" l:href=\"data:image/png;base64,aa\"/>",
            "<style>@import 'a'</style>",
            "<style>@IMPORT 'a'</style>",
            "<style>h1{display:none}</style>",
            "<rect xmlns=\"http://www.w3.org/1999/xhtml\"/>",
            "<html:rect xmlns:html=\"http://www.w3.org/1999/xhtml\"/>",
            "<title><rect/></title>",
            "<rect>a</rect>",
            "a",
            "<!--> <img src=\"a\" onerror=\"x()\"> -->",
            "<text><!--> <img src=\"a\" onerror=\"x()\"> --></text>",
            "<?p ><script>x()</script>?>",
            "<title><g><![CDATA[><script>x()</script>]]></g></title>",
        ] {
            assert_eq!(inside(drawing), None, "{drawing}");
        }
        let whole = |svg: &str| Figure { svg: svg.to_owned() }.inside_page();
        assert_eq!(whole("<?p ><script>x()</script>?><svg xmlns=\"http://www.w3.org/2000/svg\"/>"), None);
        assert_eq!(whole("<!DOCTYPE svg><svg xmlns=\"http://www.w3.org/2000/svg\"/>"), None);
        assert_eq!(whole("<svg xmlns=\"http://www.w3.org/2000/svg\" ONLOAD=\"x()\"/>"), None);
        assert_eq!(whole("<svg/>"), None);
    }
}
