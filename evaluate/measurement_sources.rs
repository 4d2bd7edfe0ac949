//! The sources that a kept measurement of `evaluate` depends on, and their hash.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The sources of this package that a measurement depends on: the trials of an experiment, their order, and means in their
/// numbers. The other sources are those that these import from `supple`.
const MEASUREMENT: [&str; 5] = [
    "evaluate/src/lib.rs",
    "evaluate/src/trial.rs",
    "evaluate/src/runner.rs",
    "evaluate/src/statistics.rs",
    "evaluate/src/experiments",
];

/// The dependencies that no import shows: the physics, and the versions of libraries.
const BELOW: [&str; 2] = ["mujoco-sys", "Cargo.lock"];

/// Returns the folder of the workspace, to which all paths here are relative.
pub fn root() -> PathBuf {
    // Of the run, not of the compilation: checkouts may share a target folder.
    let package = std::env::var_os("CARGO_MANIFEST_DIR").unwrap_or_else(|| env!("CARGO_MANIFEST_DIR").into());
    PathBuf::from(package).join("..")
}

/// Returns the files that a measurement depends on: the sources of its trials, the modules that they import, directly or not, and
/// the texts that these include, but no files of unit tests. Policies and the contact network, which are included as bytes, have
/// hashes of their own.
pub fn measured_files() -> BTreeSet<PathBuf> {
    let mut files: BTreeSet<PathBuf> = BELOW.iter().flat_map(|path| files_in(Path::new(path))).collect();
    let mut ahead: Vec<PathBuf> = MEASUREMENT.iter().flat_map(|path| files_in(Path::new(path))).collect();
    while let Some(file) = ahead.pop() {
        if is_test(&file) || !files.insert(file.clone()) {
            continue;
        }
        let code = code_of(&file);
        // What else `evaluate` imports from itself affects the protocol, which measurements have a hash of, or the report only.
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

/// Returns true for a file of unit tests alone, by its name.
fn is_test(file: &Path) -> bool {
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    stem == "tests" || stem.ends_with("_tests")
}

/// Returns the path or module name after each occurrence of `mark`.
fn words_after<'a>(code: &'a str, mark: &'a str) -> impl Iterator<Item = &'a str> {
    let is_path = |character: char| character.is_alphanumeric() || "_-./".contains(character);
    code.split(mark).skip(1).map(move |rest| &rest[..rest.find(|c| !is_path(c)).unwrap_or(rest.len())])
}

/// Returns the FNV-1a hash over paths and code.
pub fn hash_of(files: &BTreeSet<PathBuf>) -> u64 {
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for file in files {
        for byte in file.to_string_lossy().bytes().chain(code_of(file).bytes()) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    hash
}

/// Returns the text of a file; of Rust, without comments, blank lines and the unit tests at its end.
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
        // Comments are whole lines or a header.
        in_header |= line.starts_with("/*");
        if !in_header && !line.is_empty() && !line.starts_with("//") {
            code.push_str(line);
            code.push('\n');
        }
        in_header &= !line.ends_with("*/");
    }
    code
}

/// Returns a file, or all files of a folder and of its subfolders.
pub fn files_in(path: &Path) -> Vec<PathBuf> {
    let folder = root().join(path);
    if !folder.is_dir() {
        return vec![path.to_owned()];
    }
    let entries = std::fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    entries.flat_map(|entry| files_in(&path.join(entry.file_name()))).collect()
}
