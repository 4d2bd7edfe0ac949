/*! The offline half of `cargo deny check`: licences and sources of every dependency.

`.ci/run` calls cargo-deny where it is installed; this test needs neither it nor a network.
*/

use std::process::Command;

use serde_json::Value;
use spdx::{Expression, ParseMode};

/// Returns the licences that `deny.toml` allows.
fn allowed() -> Vec<&'static str> {
    let list = include_str!("../../deny.toml").split("allow = [").nth(1).unwrap().split(']').next().unwrap();
    list.split('"').skip(1).step_by(2).collect()
}

#[test]
fn every_dependency_has_an_allowed_licence_and_source() {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let output = Command::new(cargo)
        .args(["metadata", "--locked", "--format-version", "1", "--all-features"])
        .args(["--filter-platform", "x86_64-unknown-linux-gnu"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    assert!(packages.len() > 100, "only {} packages", packages.len());
    let allowed = allowed();
    for package in packages {
        let (name, text) = (&package["name"], package["license"].as_str().unwrap_or_default());
        let licence = Expression::parse_mode(text, ParseMode::LAX).unwrap_or_else(|error| panic!("{name}: {error}"));
        let is_allowed = licence.evaluate(|required| allowed.contains(&required.to_string().as_str()));
        assert!(is_allowed, "{name} has the licence '{text}', which deny.toml does not allow");
        let source = package["source"].as_str().unwrap_or("path");
        assert!(source == "path" || source.starts_with("registry+"), "{name} comes from {source}");
    }
}
