//! Well-known text of coordinate reference systems (WKT 1 of OGC 01-009 and WKT 2 of ISO 19162): read into a tree, changed, written.

use std::fmt::Write as _;

/// The longest text that is read, bytes.
const LONGEST: usize = 1 << 16;
/// How deep nodes may stand in each other.
const DEEPEST: usize = 32;

/// A node of the tree, written `KEYWORD[arguments]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Node {
    /// The word before the bracket, in capitals.
    pub keyword: String,
    /// What stands between the brackets, in the order of the text.
    pub arguments: Vec<Argument>,
}

/// One argument of a node.
#[derive(Debug, Clone, PartialEq)]
pub enum Argument {
    /// Text in quotes, here without them.
    Text(String),
    /// A number or a bare word such as `NORTH`, as it was written.
    Word(String),
    /// A node inside this one.
    Node(Node),
}

impl Node {
    /// A node of its own.
    pub fn new(keyword: &str, arguments: Vec<Argument>) -> Self {
        Self { keyword: keyword.to_owned(), arguments }
    }

    /// Reads a text that is one node.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        if text.len() > LONGEST {
            return Err(format!("a text of {} bytes is too long for a coordinate reference system", text.len()));
        }
        let mut reader = Reader { rest: text.trim_end_matches('\0').trim() };
        let node = reader.node(0)?;
        if reader.rest.trim().is_empty() { Ok(node) } else { Err("text follows the last bracket".to_owned()) }
    }

    /// Its first text: the name.
    pub fn name(&self) -> &str {
        self.arguments.first().map_or("", |first| if let Argument::Text(text) = first { text } else { "" })
    }

    /// The nodes among its arguments.
    pub fn nodes(&self) -> impl Iterator<Item = &Self> {
        self.arguments.iter().filter_map(|argument| if let Argument::Node(node) = argument { Some(node) } else { None })
    }

    /// The first node among its arguments that has one of these keywords.
    pub fn child(&self, keywords: &[&str]) -> Option<&Self> {
        self.nodes().find(|node| keywords.contains(&node.keyword.as_str()))
    }

    /// The number at a place in its arguments.
    pub fn number(&self, place: usize) -> Option<f64> {
        match self.arguments.get(place)? {
            Argument::Word(word) => word.parse().ok().filter(|number: &f64| number.is_finite()),
            _ => None,
        }
    }

    /// The EPSG code that its own `AUTHORITY` or `ID` states.
    pub fn epsg(&self) -> Option<u32> {
        let stated = self.child(&["AUTHORITY", "ID"])?;
        let code = match stated.arguments.get(1)? {
            Argument::Text(code) | Argument::Word(code) => code.parse().ok()?,
            Argument::Node(_) => return None,
        };
        stated.name().eq_ignore_ascii_case("EPSG").then_some(code)
    }

    /// Leaves out the nodes of these keywords, at any depth.
    #[must_use]
    pub fn without(mut self, keywords: &[&str]) -> Self {
        self.arguments.retain(|a| !matches!(a, Argument::Node(node) if keywords.contains(&node.keyword.as_str())));
        for argument in &mut self.arguments {
            if let Argument::Node(node) = argument {
                *node = std::mem::replace(node, Self::new("", Vec::new())).without(keywords);
            }
        }
        self
    }

    /// The same with another name.
    #[must_use]
    pub fn renamed(mut self, name: &str) -> Self {
        if let Some(first) = self.arguments.first_mut() {
            *first = Argument::Text(name.to_owned());
        }
        self
    }
}

impl std::fmt::Display for Node {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}[", self.keyword)?;
        for (place, argument) in self.arguments.iter().enumerate() {
            if place > 0 {
                f.write_char(',')?;
            }
            match argument {
                Argument::Text(text) => write!(f, "\"{}\"", text.replace('"', "\"\""))?,
                Argument::Word(word) => f.write_str(word)?,
                Argument::Node(node) => write!(f, "{node}")?,
            }
        }
        f.write_char(']')
    }
}

struct Reader<'a> {
    rest: &'a str,
}

impl Reader<'_> {
    fn node(&mut self, depth: usize) -> Result<Node, String> {
        let keyword = self.word()?;
        if depth > DEEPEST || !self.skip(&['[', '(']) {
            // The word itself is not told: the text may be that of a file which a link beside the data leads to.
            return Err("it is not well-known text: a word is not followed by a bracket".to_owned());
        }
        let mut arguments = Vec::new();
        loop {
            arguments.push(self.argument(depth)?);
            if self.skip(&[']', ')']) {
                return Ok(Node { keyword: keyword.to_ascii_uppercase(), arguments });
            }
            if !self.skip(&[',']) {
                return Err("it is not well-known text: a comma or a bracket is missing".to_owned());
            }
        }
    }

    fn argument(&mut self, depth: usize) -> Result<Argument, String> {
        self.rest = self.rest.trim_start();
        if self.rest.starts_with('"') {
            return self.text().map(Argument::Text);
        }
        let end = self.rest.find(['[', '(', ']', ')', ',']).ok_or("it ends within a bracket")?;
        if self.rest[end..].starts_with(['[', '(']) {
            return self.node(depth + 1).map(Argument::Node);
        }
        self.word().map(Argument::Word)
    }

    /// What stands before the next bracket or comma.
    fn word(&mut self) -> Result<String, String> {
        let end = self.rest.find(['[', '(', ']', ')', ',', '"']).unwrap_or(self.rest.len());
        let (word, rest) = self.rest.split_at(end);
        self.rest = rest;
        let word = word.trim();
        let plain = !word.is_empty() && word.chars().all(|c| c.is_ascii_alphanumeric() || "_+-.: ".contains(c));
        if plain { Ok(word.to_owned()) } else { Err("it is not well-known text".to_owned()) }
    }

    /// A text in quotes; a quote within it is doubled.
    fn text(&mut self) -> Result<String, String> {
        let mut text = String::new();
        let mut letters = self.rest.char_indices().skip(1).peekable();
        while let Some((at, letter)) = letters.next() {
            if letter != '"' {
                text.push(letter);
            } else if letters.next_if(|(_, next)| *next == '"').is_some() {
                text.push('"');
            } else {
                self.rest = &self.rest[at + 1..];
                return Ok(text);
            }
        }
        Err("it ends within quotes".to_owned())
    }

    fn skip(&mut self, any: &[char]) -> bool {
        let rest = self.rest.trim_start();
        let found = rest.starts_with(any);
        self.rest = if found { &rest[1..] } else { rest };
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_text_comes_back() {
        let text = "PROJCS[\"a \"\"b\"\"\",UNIT[\"metre\",1,AUTHORITY[\"EPSG\",\"9001\"]],AXIS[\"X\",EAST],AUTHORITY[\"EPSG\",\"7\"]]";
        let node = Node::parse(text).unwrap();
        assert_eq!((node.name(), node.epsg(), node.to_string().as_str()), ("a \"b\"", Some(7), text));
        assert_eq!(node.child(&["UNIT"]).unwrap().number(1), Some(1.0));
        let spaced = Node::parse(" Projcs ( \"a\" , Axis ( \"X\" , EAST ) )\n").unwrap();
        assert_eq!(spaced.to_string(), "PROJCS[\"a\",AXIS[\"X\",EAST]]");
        assert!(!node.without(&["AUTHORITY"]).to_string().contains("AUTHORITY"));
    }

    #[test]
    fn what_is_none_is_refused() {
        for text in ["", "EPSG:4326", "A[", "A[]", "A[\"x", "A[\"x\"", "A[\"x\"] B", "A[\"x\" 1]", "+proj=utm"] {
            assert!(Node::parse(text).is_err(), "{text}");
        }
        assert!(Node::parse(&"A[".repeat(1000)).is_err());
    }
}
