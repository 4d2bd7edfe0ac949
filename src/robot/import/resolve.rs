//! The file of a robot with all that it includes, read and checked before MuJoCo sees any of it.

use std::path::{Path, PathBuf};

use super::names::Description;
use crate::mujoco::check_sizes;
use crate::util::files;
use crate::util::xml::{self, Element};

/// Larger files are not robots.
const MAX_BYTES: u64 = 8 << 20;

/// Larger meshes and textures are not a robot's.
const MAX_ASSET_BYTES: u64 = 256 << 20;

/// Elements of all files. A robot has some hundred; MuJoCo's time grows with their square.
const MAX_ELEMENTS: usize = 5_000;

/// Files in all.
const MAX_FILES: usize = 64;

/// Sections that are not taken over: a scene has its own, or nothing here reads them.
const NOT_TAKEN: [&str; 6] = ["option", "size", "sensor", "contact", "statistic", "visual"];

/// A robot as its files have it.
#[derive(Debug)]
pub(in crate::robot) struct Source {
    /// The robot's YAML description, if there is one.
    pub(super) description: Description,
    /// The MJCF file with what it includes.
    pub(super) tree: Element,
}

impl Source {
    /// Reads an MJCF file, or a YAML file that names one and says what its parts are called.
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
        check_sizes(&taken)?;
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

    /// All that it says, and where its files lie.
    pub(in crate::robot) fn text(&self) -> String {
        let mut text = format!("{:?}", self.description);
        self.tree.write(&mut text);
        text
    }

    /// Hash of all that it says and of the files of its assets, wherever they lie.
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

/// Refuses numbers that are not finite: MuJoCo takes them, and whatever comes of them later is charged to it.
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
    /// The file that errors name.
    given: &'a Path,
    /// Where included files lie, as MuJoCo has it: that of the first file.
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

    /// Puts the content of files in the place of what includes them.
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
