//! Compilation of a robot's document: messages of MuJoCo about our text become messages about the user's file.

use super::source::{Files, described};
use crate::mujoco::{self, Model};
use crate::robot::error::RobotError;
use crate::util::xml::Element;

/// Compiles a document. MuJoCo's messages about its lines become messages about the lines of the user's file.
pub(super) fn load(document: &Element, files: &Files) -> Result<Model, RobotError> {
    let mut text = String::new();
    document.write(&mut text);
    Model::from_xml(&[("robot.xml", &text)]).map_err(|error| explained(error, document, files))
}

/// Explains an error of MuJoCo in a document that was written by [`Element::write`].
fn explained(error: mujoco::Error, document: &Element, files: &Files) -> RobotError {
    let mujoco::Error::Load { message, .. } = error else { return RobotError::Engine(error.to_string()) };
    let message = message.trim_start_matches("XML Error:").trim_start().trim_start_matches("Error:").trim();
    // "…, line 18", "… Object name = trunk, id = 2, line = 8, column = -1"
    let number = |text: &str| {
        let text = text.trim_start_matches([' ', '=']);
        text[..text.find(|letter: char| !letter.is_ascii_digit()).unwrap_or(text.len())].parse::<usize>().ok()
    };
    let line = message.match_indices("line").filter_map(|(at, word)| Some((at, number(&message[at + word.len()..])?)));
    let Some((at, line)) = line.last() else { return named(message, document, files) };
    let end = ["Object name", "Element '"].iter().filter_map(|mark| message[..at].find(mark)).min().unwrap_or(at);
    let message = message[..end].trim_end_matches([' ', ',', '(']).to_owned();
    match document.lines().get(line.wrapping_sub(1)) {
        Some(element) => RobotError::MuJoCo { at: files.at(element), element: described(element), message },
        None => RobotError::Engine(message),
    }
}

/// Explains a message of MuJoCo that names an element or its file, but no line.
fn named(message: &str, document: &Element, files: &Files) -> RobotError {
    let (text, rest) = message.split_once("Object name = ").unwrap_or((message, ""));
    let name = rest.split_once(", id").map_or(rest, |(name, _)| name);
    let mut found = None;
    let is_it = |element: &Element| match name {
        "" => element.get("file").is_some_and(|file| !file.is_empty() && message.contains(file)),
        _ => element.get("name") == Some(name),
    };
    document.visit(&mut |element| {
        if found.is_none() && is_it(element) {
            found = Some((files.at(element), described(element)));
        }
    });
    match found {
        Some((at, element)) => RobotError::MuJoCo { at, element, message: text.trim().to_owned() },
        None => RobotError::Engine(text.trim().to_owned()),
    }
}
