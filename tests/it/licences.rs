/*! What `cargo deny check licenses sources` would say, in a second and without a network.

Building cargo-deny takes minutes and its list of advisories comes from the network, so continuous integration makes do
with this: every package that the program is built from has a licence that `deny.toml` allows, and comes from this
repository or the one registry.
*/

use std::process::Command;

use serde_json::Value;

/// The licences of `deny.toml`.
fn allowed() -> Vec<String> {
    let text = include_str!("../../deny.toml");
    let list = text.split("allow = [").nth(1).unwrap().split(']').next().unwrap();
    list.split('"').skip(1).step_by(2).map(str::to_owned).collect()
}

/// Whether an SPDX expression can be met with what is allowed. `/` is the old way to write OR.
fn permitted(expression: &str, allowed: &[String]) -> bool {
    let spaced = expression.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
    // AND binds closer than OR, so an expression is alternatives of requirements.
    alternatives(&mut spaced.split_whitespace().peekable(), allowed)
}

fn alternatives<'a>(words: &mut std::iter::Peekable<impl Iterator<Item = &'a str>>, allowed: &[String]) -> bool {
    let mut any = requirements(words, allowed);
    while words.next_if_eq(&"OR").is_some() {
        any |= requirements(words, allowed);
    }
    any
}

fn requirements<'a>(words: &mut std::iter::Peekable<impl Iterator<Item = &'a str>>, allowed: &[String]) -> bool {
    let mut all = licence(words, allowed);
    while words.next_if_eq(&"AND").is_some() {
        all &= licence(words, allowed);
    }
    all
}

fn licence<'a>(words: &mut std::iter::Peekable<impl Iterator<Item = &'a str>>, allowed: &[String]) -> bool {
    let mut name = words.next().unwrap_or_default().to_owned();
    if name == "(" {
        let mut depth = 1;
        let inner: Vec<&str> = words
            .by_ref()
            .take_while(|word| {
                depth += i32::from(*word == "(") - i32::from(*word == ")");
                depth > 0
            })
            .collect();
        return permitted(&inner.join(" "), allowed);
    }
    if words.next_if_eq(&"WITH").is_some() {
        name = format!("{name} WITH {}", words.next().unwrap_or_default());
    }
    allowed.contains(&name)
}

#[test]
fn expressions_are_read_as_spdx_says() {
    let allowed = ["MIT".to_owned(), "Zlib".to_owned(), "Apache-2.0 WITH LLVM-exception".to_owned()];
    for (expression, expected) in [
        ("MIT", true),
        ("GPL-3.0", false),
        ("MIT/Apache-2.0", true),
        ("MIT AND GPL-3.0", false),
        ("GPL-3.0 OR MIT AND Zlib", true),
        ("(GPL-3.0 OR MIT) AND Zlib", true),
        ("(GPL-3.0 OR (MIT AND BSD)) AND Zlib", false),
        ("Apache-2.0 WITH LLVM-exception", true),
        ("Apache-2.0", false),
        ("", false),
    ] {
        assert_eq!(permitted(expression, &allowed), expected, "{expression}");
    }
}

#[test]
fn every_dependency_has_an_allowed_licence_and_comes_from_the_registry() {
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let arguments = ["metadata", "--locked", "--format-version", "1", "--all-features"];
    let output = Command::new(cargo)
        .args(arguments)
        .args(["--filter-platform", "x86_64-unknown-linux-gnu"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    // The graph for this platform; the list of packages next to it may hold more.
    let packages = metadata["packages"].as_array().unwrap();
    assert!(packages.len() > 100, "only {} packages", packages.len());
    let allowed = allowed();
    for package in packages {
        let name = &package["name"];
        let expression = package["license"].as_str().unwrap_or_default();
        assert!(permitted(expression, &allowed), "{name} has licence '{expression}', which deny.toml does not allow");
        let from = package["source"].as_str().unwrap_or("path");
        assert!(from == "path" || from.starts_with("registry+"), "{name} comes from {from}");
    }
}
