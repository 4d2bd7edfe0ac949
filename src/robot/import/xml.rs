//! An MJCF file as a tree that can be changed and written again, with the files that it includes.

use std::fmt::Write as _;
use std::path::Path;

use roxmltree::{Document, Node, ParsingOptions};

use crate::util::files;

/// Larger files are not robots.
const MAX_BYTES: u64 = 8 << 20;

/// Elements and attributes of one file.
const MAX_NODES: u32 = 200_000;

/// Nesting of elements, and of files that include files.
const MAX_DEPTH: usize = 64;

/// Files in all.
const MAX_FILES: usize = 64;

/// An element without comments and text, which mean nothing in MJCF.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Element {
    pub(super) name: String,
    pub(super) attributes: Vec<(String, String)>,
    pub(super) children: Vec<Element>,
}

impl Element {
    /// Value of an attribute.
    pub(super) fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// Sets an attribute.
    pub(super) fn set(&mut self, name: &str, value: impl ToString) {
        self.remove(name);
        self.attributes.push((name.to_owned(), value.to_string()));
    }

    /// Takes an attribute away.
    pub(super) fn remove(&mut self, name: &str) {
        self.attributes.retain(|(known, _)| known != name);
    }

    /// Children of a name.
    pub(super) fn all<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Element> {
        self.children.iter().filter(move |child| child.name == name)
    }

    /// As XML.
    pub(super) fn write(&self, text: &mut String) {
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

/// Reads a file and what it includes, relative to its folder as MuJoCo has it.
pub(super) fn read(path: &Path) -> Result<Element, String> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let root = read_file(path, folder, 0, &mut 0)?;
    if root.name == "mujoco" {
        Ok(root)
    } else {
        Err(format!("its root element is <{}>, expected <mujoco>", root.name))
    }
}

fn read_file(path: &Path, folder: &Path, depth: usize, files_read: &mut usize) -> Result<Element, String> {
    *files_read += 1;
    if *files_read > MAX_FILES {
        return Err("it includes too many files: does one include itself?".into());
    }
    let bytes =
        files::read_bounded(path, MAX_BYTES).map_err(|error| format!("cannot read {}: {error}", path.display()))?;
    let text = String::from_utf8_lossy(&bytes);
    let options = ParsingOptions { nodes_limit: MAX_NODES, ..ParsingOptions::default() };
    let document = Document::parse_with_options(&text, options)
        .map_err(|error| format!("{} is not XML: {error}", path.display()))?;
    convert(document.root_element(), folder, depth, files_read)
}

fn convert(node: Node<'_, '_>, folder: &Path, depth: usize, files_read: &mut usize) -> Result<Element, String> {
    if depth > MAX_DEPTH {
        return Err(format!("its elements are nested more than {MAX_DEPTH} deep"));
    }
    let attributes = node.attributes().map(|a| (a.name().to_owned(), a.value().to_owned())).collect();
    let mut element = Element { name: node.tag_name().name().to_owned(), attributes, children: Vec::new() };
    for child in node.children().filter(Node::is_element) {
        if child.tag_name().name() == "include" {
            let file = child.attribute("file").ok_or("an <include> names no file")?;
            let included = read_file(&folder.join(file), folder, depth + 1, files_read)?;
            element.children.extend(included.children);
        } else {
            element.children.push(convert(child, folder, depth + 1, files_read)?);
        }
    }
    Ok(element)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;")
}
