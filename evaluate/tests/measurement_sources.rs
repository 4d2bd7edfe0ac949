//! The sources that a kept measurement of `evaluate` depends on.

#[path = "../measurement_sources.rs"]
mod measurement_sources;

use std::collections::BTreeSet;
use std::path::PathBuf;

use measurement_sources::{files_in, hash_of, measured_files};

#[test]
fn measurement_depends_on_imports_only() {
    let files = measured_files();
    let has = |file: &str| files.contains(&PathBuf::from(file));
    let of_samples = ["evaluate/src/trial.rs", "evaluate/src/runner.rs", "evaluate/src/statistics.rs"];
    for file in [&of_samples[..], &["src/sim/mod.rs", "src/task/reward.rs", "src/estimate/kalman.rs"]].concat() {
        assert!(has(file), "{file}");
    }
    for file in ["src/estimate/kalman_tests.rs", "src/estimate/tests.rs", "src/scenario/session/tests.rs"] {
        assert!(measurement_sources::root().join(file).exists() && !has(file), "{file} has unit tests alone");
    }
    assert!(has("src/robot/kinematics.rs"), "imported by an import");
    assert!(files.iter().any(|file| file.ends_with("models/go1.xml")), "texts that code includes");
    let within = |folder: &str| files.iter().any(|file| file.starts_with(folder));
    for folder in ["src/train", "src/ppo", "src/bin", "evaluate/src/report", "evaluate/src/plot", "record", "docs"] {
        assert!(!within(folder), "{folder}");
    }
}

#[test]
fn hash_ignores_comments_and_unit_tests() {
    let folder = tempfile::tempdir().unwrap();
    let hash = |text: &str| {
        std::fs::write(folder.path().join("file.rs"), text).unwrap();
        hash_of(&BTreeSet::from_iter(files_in(folder.path())))
    };
    let bare = hash("fn f() -> &'static str {\n    \"// no comment\"\n}\n");
    let dressed =
        "/*! Header\nover lines. */\n\n// Words.\nfn f() -> &'static str {\n\n    // More.\n    \"// no comment\"\n}\n";
    for visibility in ["", "pub(crate) "] {
        let tests = format!("\n#[cfg(test)]\n{visibility}mod tests {{\n    fn g() {{}}\n}}\n");
        assert_eq!(hash(&[dressed, &tests].concat()), bare);
    }
    assert_ne!(hash("fn f() -> &'static str {\n    \"// a comment\"\n}\n"), bare);
}
