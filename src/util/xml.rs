//! XML as a tree of elements that can be read, changed and written; safe for untrusted texts. Every element knows where
//! it was read, so that errors about a changed text can name the line that a person wrote.

use std::fmt::Write as _;

use roxmltree::{Document, Node, ParsingOptions};

/// Maximum number of elements, texts and comments in a file.
const MAX_NODES: u32 = 200_000;

/// Maximum number of attributes of an element; the parser's time grows with their square.
const MAX_ATTRIBUTES: usize = 500;

/// Maximum depth of nested elements.
const MAX_DEPTH: usize = 64;

/// The reason why a text was refused.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum XmlError {
    #[error("it is not XML: {0}")]
    Syntax(String),
    #[error("line {line}: an element has more than {MAX_ATTRIBUTES} attributes")]
    Crowded { line: u32 },
    #[error("line {line}: its elements are nested more than {MAX_DEPTH} deep")]
    Deep { line: u32 },
}

/// The place where an element was read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Place {
    /// Number of the file, as the reader counts them.
    pub file: u32,
    /// Line of the element's beginning, from 1; 0 if the element was not read but made.
    pub line: u32,
}

/// An element without its comments and text, which have no meaning in MJCF.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Element {
    /// The place where it was read.
    pub place: Place,
    /// Name of the tag.
    pub name: String,
    /// Names and values of the attributes, in order.
    pub attributes: Vec<(String, String)>,
    /// Child elements, in order.
    pub children: Vec<Element>,
}

impl Element {
    /// Makes an element without attributes and children.
    pub fn new(name: &str) -> Self {
        Element { name: name.to_owned(), ..Element::default() }
    }

    /// Adds an attribute to a new element.
    pub fn with(mut self, name: &str, value: impl ToString) -> Self {
        self.set(name, value);
        self
    }

    /// Returns the value of an attribute.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// Sets an attribute.
    pub fn set(&mut self, name: &str, value: impl ToString) {
        self.remove(name);
        self.attributes.push((name.to_owned(), value.to_string()));
    }

    /// Removes an attribute.
    pub fn remove(&mut self, name: &str) {
        self.attributes.retain(|(known, _)| known != name);
    }

    /// Iterates over the children with a name.
    pub fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Element> {
        self.children.iter().filter(move |child| child.name == name)
    }

    /// Calls a function for the element and everything below it.
    pub fn visit(&self, work: &mut impl FnMut(&Element)) {
        work(self);
        self.children.iter().for_each(|child| child.visit(work));
    }

    /// Returns the elements of the lines that [`Element::write`] writes, in order.
    pub fn lines(&self) -> Vec<&Element> {
        let mut lines = vec![self];
        if !self.children.is_empty() {
            lines.extend(self.children.iter().flat_map(Element::lines));
            lines.push(self);
        }
        lines
    }

    /// Writes the element as XML: its beginning on a line, then its children, then its end on a line.
    pub fn write(&self, text: &mut String) {
        // Writing into a String cannot fail.
        let _ = write!(text, "<{}", self.name);
        for (name, value) in &self.attributes {
            let _ = write!(text, " {name}=\"{}\"", escaped(value));
        }
        if self.children.is_empty() {
            text.push_str("/>\n");
            return;
        }
        text.push_str(">\n");
        self.children.iter().for_each(|child| child.write(text));
        let _ = writeln!(text, "</{}>", self.name);
    }
}

/// Parses a text and returns its root element.
pub fn parse(text: &str) -> Result<Element, XmlError> {
    if let Some(line) = crowded(text) {
        return Err(XmlError::Crowded { line });
    }
    let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options).map_err(|error| XmlError::Syntax(error.to_string()))?;
    let ends: Vec<usize> = text.bytes().enumerate().filter(|(_, byte)| *byte == b'\n').map(|(at, _)| at).collect();
    convert(document.root_element(), 0, &ends)
}

/// Converts an element; `ends` are the places of all line ends in the text.
fn convert(node: Node<'_, '_>, depth: usize, ends: &[usize]) -> Result<Element, XmlError> {
    let line = u32::try_from(1 + ends.partition_point(|end| *end < node.range().start)).unwrap_or(u32::MAX);
    ensure!(depth <= MAX_DEPTH, XmlError::Deep { line });
    let attributes = node.attributes().map(|a| (a.name().to_owned(), a.value().to_owned())).collect();
    let children = node.children().filter(Node::is_element).map(|child| convert(child, depth + 1, ends));
    let children = children.collect::<Result<_, _>>()?;
    Ok(Element { place: Place { file: 0, line }, name: node.tag_name().name().to_owned(), attributes, children })
}

/// Returns the line of an element with too many attributes: with more of them between one `<` and the next than
/// allowed.
fn crowded(text: &str) -> Option<u32> {
    let mut line = 1;
    for part in text.split('<') {
        let values = part.split('=').skip(1).filter(|value| value.trim_start().starts_with(['"', '\'']));
        if values.count() > MAX_ATTRIBUTES {
            return Some(line);
        }
        line += u32::try_from(part.matches('\n').count()).unwrap_or(u32::MAX);
    }
    None
}

fn escaped(text: &str) -> String {
    let text = text.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;");
    // A line end within a value would move all lines after it.
    text.replace('\n', "&#10;").replace('\r', "&#13;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_element_with_too_many_attributes_is_refused_before_it_is_read() {
        let element = |count: usize| {
            let attributes: String = (0..count).map(|k| format!(" a{k} =\n'1'")).collect();
            format!("<r>\n<!-- {} --><e{attributes}/>it's = text\n</r>", "=".repeat(2 * MAX_ATTRIBUTES))
        };
        assert_eq!(parse(&element(MAX_ATTRIBUTES)).unwrap().children[0].attributes.len(), MAX_ATTRIBUTES);
        assert_eq!(parse(&element(MAX_ATTRIBUTES + 1)).unwrap_err(), XmlError::Crowded { line: 2 });
    }

    #[test]
    fn elements_know_the_lines_they_were_read_from_and_are_written_on() {
        let text = "<a>\n <!-- x\n -->\n <b n='1\n2'/> <c\n v='&#10;'><d/>\n</c>\n</a>\n";
        let root = parse(text).unwrap();
        let read: Vec<(&str, u32)> = root.lines().iter().map(|line| (line.name.as_str(), line.place.line)).collect();
        assert_eq!(read, [("a", 1), ("b", 4), ("c", 5), ("d", 6), ("c", 5), ("a", 1)]);
        let mut written = String::new();
        root.write(&mut written);
        assert_eq!(written.lines().count(), read.len(), "{written}");
        for (line, (name, _)) in written.lines().zip(read) {
            assert!(line.trim_start_matches(['<', '/']).starts_with(name), "{written}");
        }
    }

    #[test]
    fn depth_is_limited() {
        let nested = |count: usize| format!("{}{}", "<a>".repeat(count), "</a>".repeat(count));
        assert!(parse(&nested(MAX_DEPTH)).is_ok());
        assert!(parse(&nested(MAX_DEPTH + 2)).is_err());
    }
}
