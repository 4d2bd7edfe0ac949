//! Provenance (git revision, MuJoCo version, what measurements depend on) and the shipped policies become part of the program.

#[path = "build/measured.rs"]
mod measured;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use measured::{files_in, hash_of, measured_files};

/// What makes the programs behave as they do, but for the policies, which are named by their own hashes.
const PROGRAM: &[&str] =
    &["build.rs", "build", "Cargo.toml", "Cargo.lock", "mujoco-sys", "src", "evaluate", "record", "models", "configs"];

fn main() {
    println!("cargo::rustc-check-cfg=cfg(tiles)");
    let target = |key: &str| std::env::var(format!("CARGO_CFG_TARGET_{key}")).unwrap_or_default();
    if (target("ARCH"), target("OS")) == ("x86_64".into(), "linux".into()) {
        println!("cargo::rustc-cfg=tiles");
    }
    for path in PROGRAM.iter().chain(&["policies"]) {
        println!("cargo::rerun-if-changed={path}");
    }
    for path in ["HEAD", "logs/HEAD"].iter().filter_map(|name| git(&["rev-parse", "--git-path", name])) {
        println!("cargo::rerun-if-changed={path}");
    }
    println!("cargo::rustc-env=SUPPLE_GIT_REVISION={}", git_revision().unwrap_or_else(|| "unknown".into()));
    println!("cargo::rustc-env=SUPPLE_MEASURES={:016x}", hash_of(&measured_files()));
    let mujoco = std::env::var("DEP_MUJOCO_VERSION").unwrap_or_else(|_| "unknown".into());
    println!("cargo::rustc-env=SUPPLE_MUJOCO_VERSION={mujoco}");
    let out = PathBuf::from(std::env::var_os("OUT_DIR").unwrap_or_default());
    for (file, suffix, include) in
        [("policies.rs", ".safetensors", "include_bytes"), ("calibrations.rs", ".calibration.json", "include_str")]
    {
        let out = out.join(file);
        if let Err(error) = std::fs::write(&out, embedded(Path::new("policies"), suffix, include)) {
            println!("cargo::error=cannot write {}: {error}", out.display());
        }
    }
}

/// An array expression of (name, content) of the files with a suffix, by name: `compliant-seed0`, `hardware/compliant-seed0`.
fn embedded(folder: &Path, suffix: &str, include: &str) -> String {
    let name = |file: &PathBuf| {
        let relative = file.strip_prefix(folder).unwrap_or(file).to_string_lossy();
        relative.strip_suffix(suffix).map(str::to_owned)
    };
    let mut files: Vec<(String, PathBuf)> =
        files_in(folder).into_iter().filter_map(|file| Some((name(&file)?, file))).collect();
    files.sort();
    let mut code = String::from("&[\n");
    for (name, file) in files {
        let path = file.canonicalize().unwrap_or(file).display().to_string();
        // Writing into a String cannot fail.
        let _ = writeln!(code, "    ({name:?}, {include}!({path:?})),");
    }
    code.push(']');
    code
}

/// The commit, with `-dirty` if the program's files differ from it.
fn git_revision() -> Option<String> {
    let commit = git(&["rev-parse", "--short=12", "HEAD"])?;
    let changed = git(&[&["status", "--porcelain", "--"], PROGRAM].concat())?;
    Some(if changed.is_empty() { commit } else { format!("{commit}-dirty") })
}

fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
