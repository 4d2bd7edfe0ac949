//! The published package has all files that the library embeds, and nothing else that is large.

use std::collections::BTreeSet;
use std::path::{Component, Path, PathBuf};
use std::process::Command;

use crate::support::repository;

/// The largest package that registries take, compressed [bytes].
const LARGEST: usize = 10_000_000;

/// Returns all files of a folder and of the folders in it.
fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { files_in(&path) } else { vec![path] }).collect()
}

/// Returns a path without `folder/..`.
fn normalised(path: &Path) -> PathBuf {
    path.components().fold(PathBuf::new(), |mut whole, part| {
        if part == Component::ParentDir {
            whole.pop();
        } else {
            whole.push(part);
        }
        whole
    })
}

#[test]
fn package_has_all_embedded_files_and_is_small() {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let root = repository("");
    let output = Command::new(cargo)
        .args(["package", "--package", "supple", "--list", "--allow-dirty", "--offline"])
        .current_dir(&root)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let packed: BTreeSet<PathBuf> = String::from_utf8(output.stdout).unwrap().lines().map(PathBuf::from).collect();

    // A macro embeds the scenarios' defaults by their names.
    let mut embedded: Vec<PathBuf> =
        [files_in(&root.join("policies")), files_in(&root.join("configs/scenarios"))].concat();
    for file in files_in(&root.join("src")) {
        let code = std::fs::read_to_string(&file).unwrap();
        for mark in ["include_str!(\"", "include_bytes!(\""] {
            let paths = code.split(mark).skip(1).map(|rest| rest.split('"').next().unwrap());
            embedded.extend(paths.map(|path| normalised(&file.parent().unwrap().join(path))));
        }
    }
    assert!(embedded.len() > 80, "only {} files", embedded.len());
    for file in embedded {
        let path = file.strip_prefix(&root).unwrap_or_else(|_| panic!("{} is outside the package", file.display()));
        assert!(packed.contains(path), "{} is embedded, but not in the package", path.display());
    }

    // Cargo writes some files only into the package.
    let files = packed.iter().filter(|path| root.join(path).exists());
    let tar = Command::new("tar").arg("-czf-").args(files).current_dir(&root).output().unwrap();
    assert!(tar.status.success() && tar.stdout.len() < LARGEST, "{} bytes", tar.stdout.len());
}
