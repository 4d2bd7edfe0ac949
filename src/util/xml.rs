//! XML as a tree of elements that can be read, changed and written; safe for untrusted texts.

use std::fmt::Write as _;

use roxmltree::{Document, Node, ParsingOptions};

/// Maximum number of elements, texts and comments in a file.
const MAX_NODES: u32 = 200_000;

/// Maximum number of attributes of an element; the parser's time grows with their square.
const MAX_ATTRIBUTES: usize = 500;

/// Maximum depth of nested elements.
const MAX_DEPTH: usize = 64;

/// An element without its comments and text, which have no meaning in MJCF.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Element {
    /// Name of the tag.
    pub name: String,
    /// Names and values of the attributes, in order.
    pub attributes: Vec<(String, String)>,
    /// Child elements, in order.
    pub children: Vec<Element>,
}

impl Element {
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

    /// Writes the element as XML.
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
///
/// # Errors
/// The text is not XML, or too large.
pub fn parse(text: &str) -> Result<Element, String> {
    if let Some(line) = crowded(text) {
        return Err(format!("line {line}: an element has more than {MAX_ATTRIBUTES} attributes"));
    }
    let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(text, options).map_err(|error| format!("it is not XML: {error}"))?;
    convert(document.root_element(), 0)
}

fn convert(node: Node<'_, '_>, depth: usize) -> Result<Element, String> {
    if depth > MAX_DEPTH {
        return Err(format!("its elements are nested more than {MAX_DEPTH} deep"));
    }
    let attributes = node.attributes().map(|a| (a.name().to_owned(), a.value().to_owned())).collect();
    let children = node.children().filter(Node::is_element).map(|child| convert(child, depth + 1));
    Ok(Element { name: node.tag_name().name().to_owned(), attributes, children: children.collect::<Result<_, _>>()? })
}

/// Returns the line of an element with too many attributes: with more of them between one `<` and the next than
/// allowed.
fn crowded(text: &str) -> Option<usize> {
    let mut line = 1;
    for part in text.split('<') {
        let values = part.split('=').skip(1).filter(|value| value.trim_start().starts_with(['"', '\'']));
        if values.count() > MAX_ATTRIBUTES {
            return Some(line);
        }
        line += part.matches('\n').count();
    }
    None
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;")
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
        let error = parse(&element(MAX_ATTRIBUTES + 1)).unwrap_err();
        assert!(error.starts_with("line 2: "), "{error}");
    }

    #[test]
    fn depth_is_limited() {
        let nested = |count: usize| format!("{}{}", "<a>".repeat(count), "</a>".repeat(count));
        assert!(parse(&nested(MAX_DEPTH)).is_ok());
        assert!(parse(&nested(MAX_DEPTH + 2)).is_err());
    }
}
