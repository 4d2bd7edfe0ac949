//! What a kept measurement of `evaluate` depends on: code that decides its numbers, and nothing else.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// A measurement of `evaluate` is a trial of an experiment. What else it depends on is what these import of `supple`.
const MEASUREMENT: [&str; 3] = ["evaluate/src/lib.rs", "evaluate/src/trial.rs", "evaluate/src/experiments"];

/// What no import shows: the physics, and the versions of libraries.
const BELOW: [&str; 2] = ["mujoco-sys", "Cargo.lock"];

/// Returns the folder of the workspace, in which the paths here are.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The files that a measurement depends on: its own, the modules that they import, those that these import, and so on,
/// with the texts that any of them includes. What is included as bytes (policies, the contact network) goes by hashes of
/// its own.
pub fn measured_files() -> BTreeSet<PathBuf> {
    let mut files: BTreeSet<PathBuf> = BELOW.iter().flat_map(|path| files_in(Path::new(path))).collect();
    let mut ahead: Vec<PathBuf> = MEASUREMENT.iter().flat_map(|path| files_in(Path::new(path))).collect();
    while let Some(file) = ahead.pop() {
        if !files.insert(file.clone()) {
            continue;
        }
        let code = code_of(&file);
        // What `evaluate` imports from itself only shows.
        let library = if file.starts_with("evaluate") { "supple::" } else { "crate::" };
        for module in words_after(&code, library) {
            ahead.extend(files_in(&Path::new("src").join(module)));
        }
        for included in words_after(&code, "include_str!(\"").map(PathBuf::from) {
            files.insert(file.parent().unwrap_or(Path::new("")).join(included));
        }
    }
    files
}

/// What follows each mark, up to a character that is in no path.
fn words_after<'a>(code: &'a str, mark: &'a str) -> impl Iterator<Item = &'a str> {
    let is_path = |character: char| character.is_alphanumeric() || "_-./".contains(character);
    code.split(mark).skip(1).map(move |rest| &rest[..rest.find(|c| !is_path(c)).unwrap_or(rest.len())])
}

/// FNV-1a over paths and code.
pub fn hash_of(files: &BTreeSet<PathBuf>) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for file in files {
        for byte in file.to_string_lossy().bytes().chain(code_of(file).bytes()) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    hash
}

/// A file's text; of Rust, without comments, blank lines and the unit tests at its end.
fn code_of(file: &Path) -> String {
    let text =
        std::fs::read(root().join(file)).map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).unwrap_or_default();
    if file.extension().is_none_or(|extension| extension != "rs") {
        return text;
    }
    let tests = text.match_indices("\n#[cfg(test)]\n").map(|(start, mark)| (start, &text[start + mark.len()..]));
    let tests = tests.filter(|(_, item)| item.lines().next().is_some_and(|line| line.contains("mod tests {")));
    let text = &text[..tests.map(|(start, _)| start).next().unwrap_or(text.len())];
    let (mut code, mut in_header) = (String::new(), false);
    for line in text.lines().map(str::trim_start) {
        // A comment in the house's style has lines of its own, or is a header.
        in_header |= line.starts_with("/*");
        if !in_header && !line.is_empty() && !line.starts_with("//") {
            code.push_str(line);
            code.push('\n');
        }
        in_header &= !line.ends_with("*/");
    }
    code
}

/// A file, or all of a folder and of the folders in it.
pub fn files_in(path: &Path) -> Vec<PathBuf> {
    let folder = root().join(path);
    if !folder.is_dir() {
        return vec![path.to_owned()];
    }
    let entries = std::fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    entries.flat_map(|entry| files_in(&path.join(entry.file_name()))).collect()
}
