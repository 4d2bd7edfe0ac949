//! XML as a tree of elements that can be looked at, changed and written again, from texts of which nothing is known.

use std::fmt::Write as _;

use roxmltree::{Document, Node, ParsingOptions};

/// Elements, texts and comments of one file.
const MAX_NODES: u32 = 200_000;

/// Attributes of one element; the parser's time grows with their square.
const MAX_ATTRIBUTES: usize = 500;

/// Nesting of elements.
const MAX_DEPTH: usize = 64;

/// An element without comments and text, which mean nothing in MJCF.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Element {
    /// The tag.
    pub name: String,
    /// Names and values, in order.
    pub attributes: Vec<(String, String)>,
    /// The elements in it, in order.
    pub children: Vec<Element>,
}

impl Element {
    /// Value of an attribute.
    pub fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// Sets an attribute.
    pub fn set(&mut self, name: &str, value: impl ToString) {
        self.remove(name);
        self.attributes.push((name.to_owned(), value.to_string()));
    }

    /// Takes an attribute away.
    pub fn remove(&mut self, name: &str) {
        self.attributes.retain(|(known, _)| known != name);
    }

    /// Children of a name.
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

/// The root element of a text.
///
/// # Errors
/// In words: it is no XML, or too large.
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

/// The line in which an element has too many attributes: more than that are assigned between one `<` and the next.
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
