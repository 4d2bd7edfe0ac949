//! The files of a robot with all includes, read and checked before MuJoCo sees them.

use std::path::{Path, PathBuf};

use super::names::Description;
use crate::mujoco::check_sizes;
use crate::util::files;
use crate::util::xml::{self, Element};

/// Maximum size of a robot's MJCF \[bytes\].
const MAX_BYTES: u64 = 8 << 20;

/// Maximum size of a mesh or texture \[bytes\].
const MAX_ASSET_BYTES: u64 = 256 << 20;

/// Maximum number of elements in all files. A robot has some hundred; MuJoCo's time grows with their square.
const MAX_ELEMENTS: usize = 5_000;

/// Maximum number of files.
const MAX_FILES: usize = 64;

/// Sections that are left out, because a scene has its own or nothing reads them.
const NOT_TAKEN: [&str; 6] = ["option", "size", "sensor", "contact", "statistic", "visual"];

/// A robot's description and MJCF as read from its files.
#[derive(Debug)]
pub(in crate::robot) struct Source {
    /// The robot's YAML description, if there is one.
    pub(super) description: Description,
    /// The MJCF tree with its includes resolved.
    pub(super) tree: Element,
}

impl Source {
    /// Reads an MJCF file, or a YAML description that names one.
    pub(in crate::robot) fn read(path: &Path) -> Result<Self, String> {
        let description = Description::read(path)?;
        let folder = description.mjcf.parent().unwrap_or(Path::new(""));
        let mut reader = Reader { given: path, folder, files: 0, elements: 0 };
        let tree = reader.read(&description.mjcf)?;
        if tree.name != "mujoco" {
            return Err(format!("its root element is <{}>, expected <mujoco>", tree.name));
        }
        let source = Source { description, tree };
        let taken = source.taken();
        check_sizes(&taken).map_err(|error| error.to_string())?;
        check_finite(&taken)?;
        Ok(source)
    }

    /// Returns the elements that are passed to MuJoCo.
    pub(super) fn taken(&self) -> Element {
        let mut taken = self.tree.clone();
        taken.children.retain(|child| !NOT_TAKEN.contains(&child.name.as_str()));
        // The only part of the settings is one that has MuJoCo simulate while it compiles.
        for compiler in taken.children.iter_mut().filter(|child| child.name == "compiler") {
            compiler.children.clear();
        }
        taken
    }

    /// Returns the whole text and the folder of its files, which together identify the source.
    pub(in crate::robot) fn text(&self) -> String {
        let mut text = format!("{:?}", self.description);
        self.tree.write(&mut text);
        text
    }

    /// Returns the SHA-256 of the whole text and the content of its assets, independent of their paths.
    pub(super) fn sha256(&self, assets: &[PathBuf]) -> Result<String, String> {
        let mjcf = self.description.mjcf.file_name().unwrap_or_default().into();
        let mut text = format!("{:?}", Description { mjcf, ..self.description.clone() });
        self.tree.write(&mut text);
        let mut hashes = files::sha256(&[text.as_bytes()]);
        for asset in assets {
            let bytes =
                files::read_bounded(asset, MAX_ASSET_BYTES).map_err(|error| format!("{}: {error}", asset.display()))?;
            hashes.push_str(&files::sha256(&[&bytes]));
        }
        Ok(files::sha256(&[hashes.as_bytes()]))
    }
}

/// Refuses numbers that are not finite, because MuJoCo accepts them and fails later for no visible reason.
fn check_finite(element: &Element) -> Result<(), String> {
    for (name, value) in element.attributes.iter().filter(|(name, _)| name != "name") {
        let numbers: Result<Vec<f64>, _> = value.split_whitespace().map(str::parse).collect();
        if numbers.is_ok_and(|numbers| !numbers.iter().all(|number| number.is_finite())) {
            return Err(format!("{name} of <{}> is '{value}', expected finite numbers", element.name));
        }
    }
    element.children.iter().try_for_each(check_finite)
}

struct Reader<'a> {
    /// The path that errors name.
    given: &'a Path,
    /// Folder in which included files are looked up; as in MuJoCo, that of the main file.
    folder: &'a Path,
    files: usize,
    elements: usize,
}

impl Reader<'_> {
    fn read(&mut self, path: &Path) -> Result<Element, String> {
        self.files += 1;
        if self.files > MAX_FILES {
            return Err("it includes too many files: does one include itself?".into());
        }
        let given = path == self.given;
        let fail = |problem: String| if given { problem } else { format!("{}: {problem}", path.display()) };
        let bytes = files::read_bounded(path, MAX_BYTES).map_err(|error| fail(error.to_string()))?;
        let mut root = xml::parse(&String::from_utf8_lossy(&bytes)).map_err(fail)?;
        self.include(&mut root)?;
        Ok(root)
    }

    /// Replaces each `include` element by the content of its file.
    fn include(&mut self, element: &mut Element) -> Result<(), String> {
        self.elements += 1;
        if self.elements > MAX_ELEMENTS {
            return Err(format!("it has more than {MAX_ELEMENTS} elements"));
        }
        let mut children = Vec::with_capacity(element.children.len());
        for mut child in std::mem::take(&mut element.children) {
            if child.name == "include" {
                let file = child.get("file").ok_or("an <include> names no file")?;
                children.extend(self.read(&self.folder.join(file))?.children);
            } else {
                self.include(&mut child)?;
                children.push(child);
            }
        }
        element.children = children;
        Ok(())
    }
}
