//! The files of a robot with all includes, read and checked before MuJoCo sees them.

use std::path::{Path, PathBuf};

use super::names::Description;
use super::words::LEFT_OUT_SECTIONS;
use crate::mujoco::check_sizes;
use crate::robot::error::RobotError;
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

/// The names of a robot's files, by number.
#[derive(Debug, Clone, Default)]
pub(in crate::robot) struct Files(Vec<String>);

impl Files {
    /// Returns the place of an element for a message: its line, and its file unless that is the main file.
    pub(super) fn at(&self, element: &Element) -> String {
        let place = element.place;
        let file = self.0.get(place.file as usize).filter(|name| !name.is_empty());
        match (place.line, file) {
            (0, _) => String::new(),
            (line, None) => format!("line {line}"),
            (line, Some(file)) => format!("{file}, line {line}"),
        }
    }
}

/// Returns an element for a message, such as `<joint 'FL_hip'>`.
pub(super) fn described(element: &Element) -> String {
    element.get("name").map_or_else(|| format!("<{}>", element.name), |name| format!("<{} '{name}'>", element.name))
}

/// A robot's description and MJCF or URDF as read from its files.
#[derive(Debug)]
pub(in crate::robot) struct Source {
    /// The robot's YAML description, if there is one.
    pub(super) description: Description,
    /// Names of the joints to weld.
    pub(super) weld: Vec<String>,
    /// The tree of the main file with its includes resolved.
    pub(super) tree: Element,
    /// The files that the tree was read from.
    pub(super) files: Files,
}

impl Source {
    /// Reads an MJCF or URDF file, or a YAML description that names one.
    pub(in crate::robot) fn read(path: &Path) -> Result<Self, RobotError> {
        let (description, weld) = Description::read(path)?;
        let folder = description.mjcf.parent().unwrap_or(Path::new(""));
        let mut reader = Reader { given: path, folder, files: Files::default(), elements: 0 };
        let tree = reader.read(&description.mjcf)?;
        let files = reader.files;
        ensure!(matches!(tree.name.as_str(), "mujoco" | "robot"), RobotError::Root(tree.name));
        let mut taken = tree.clone();
        taken.children.retain(|child| !LEFT_OUT_SECTIONS.contains(&child.name.as_str()));
        check_sizes(&taken)?;
        check_finite(&taken, &files)?;
        Ok(Source { description, weld, tree, files })
    }

    /// Returns true if the main file is a URDF.
    pub(super) fn is_urdf(&self) -> bool {
        self.tree.name == "robot"
    }

    /// Returns the whole text and the folder of its files: two sources with the same text differ at most in the content of their assets.
    pub(in crate::robot) fn text(&self) -> String {
        self.text_with(&self.description)
    }

    fn text_with(&self, description: &Description) -> String {
        let mut text = format!("{description:?}");
        if !self.weld.is_empty() {
            text.push_str(&format!("{:?}", self.weld));
        }
        self.tree.write(&mut text);
        text
    }

    /// Returns the SHA-256 of the whole text and the content of its assets, independent of their paths.
    pub(super) fn sha256(&self, assets: &[PathBuf]) -> Result<String, RobotError> {
        let mjcf = self.description.mjcf.file_name().unwrap_or_default().into();
        let text = self.text_with(&Description { mjcf, ..self.description.clone() });
        let mut hashes = files::sha256(&[text.as_bytes()]);
        for asset in assets {
            let bytes = files::read_bounded(asset, MAX_ASSET_BYTES)
                .map_err(|error| RobotError::Asset { file: asset.clone(), error })?;
            hashes.push_str(&files::sha256(&[&bytes]));
        }
        Ok(files::sha256(&[hashes.as_bytes()]))
    }
}

/// Refuses numbers that are not finite, because MuJoCo accepts them and fails later for no visible reason.
fn check_finite(element: &Element, files: &Files) -> Result<(), RobotError> {
    for (name, value) in element.attributes.iter().filter(|(name, _)| name != "name") {
        let numbers: Result<Vec<f64>, _> = value.split_whitespace().map(str::parse).collect();
        if numbers.is_ok_and(|numbers| !numbers.iter().all(|number| number.is_finite())) {
            let (attribute, element_name, found) = (name.clone(), element.name.clone(), value.clone());
            return Err(RobotError::NotFinite { at: files.at(element), attribute, element: element_name, found });
        }
    }
    element.children.iter().try_for_each(|child| check_finite(child, files))
}

struct Reader<'a> {
    /// The path that errors name.
    given: &'a Path,
    /// Folder in which included files are looked up; as in MuJoCo, that of the main file.
    folder: &'a Path,
    files: Files,
    elements: usize,
}

impl Reader<'_> {
    fn read(&mut self, path: &Path) -> Result<Element, RobotError> {
        let number = self.files.0.len();
        ensure!(number < MAX_FILES, RobotError::TooMany { what: "files", most: MAX_FILES });
        let given = path == self.given;
        self.files.0.push(if given { String::new() } else { path.display().to_string() });
        let fail = |error: RobotError| {
            if given { error } else { RobotError::In { file: path.to_owned(), error: Box::new(error) } }
        };
        let bytes = files::read_bounded(path, MAX_BYTES).map_err(|error| fail(error.into()))?;
        let mut root = xml::parse(&String::from_utf8_lossy(&bytes)).map_err(|error| fail(error.into()))?;
        number_elements(&mut root, u32::try_from(number).unwrap_or(u32::MAX));
        if root.name == "robot" {
            // A URDF includes other files by xacro only.
            root.visit(&mut |_| self.elements += 1);
        } else {
            self.include(&mut root)?;
        }
        ensure!(self.elements <= MAX_ELEMENTS, RobotError::TooMany { what: "elements", most: MAX_ELEMENTS });
        Ok(root)
    }

    /// Replaces each `include` element by the content of its file.
    fn include(&mut self, element: &mut Element) -> Result<(), RobotError> {
        self.elements += 1;
        ensure!(self.elements <= MAX_ELEMENTS, RobotError::TooMany { what: "elements", most: MAX_ELEMENTS });
        let mut children = Vec::with_capacity(element.children.len());
        for mut child in std::mem::take(&mut element.children) {
            if child.name == "include" {
                let Some(file) = child.get("file") else {
                    return Err(RobotError::NamelessInclude { at: self.files.at(&child) });
                };
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

/// Sets the number of the file that elements were read from.
fn number_elements(element: &mut Element, file: u32) {
    element.place.file = file;
    element.children.iter_mut().for_each(|child| number_elements(child, file));
}
