//! Provenance (git revision, MuJoCo version) and the shipped policies become part of the program.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What makes the program behave as it does, but for the policies, which are named by their own hashes.
const PROGRAM: &[&str] = &["build.rs", "Cargo.toml", "Cargo.lock", "mujoco-sys", "src", "models", "configs"];

/// What of it makes no difference to what is measured.
const UNMEASURED: &[&str] =
    &["src/bin", "src/record", "src/evaluate/plot", "src/evaluate/report", "models/contact.safetensors"];

fn main() {
    for path in PROGRAM {
        println!("cargo::rerun-if-changed={path}");
    }
    for path in ["HEAD", "logs/HEAD"].iter().filter_map(|name| git(&["rev-parse", "--git-path", name])) {
        println!("cargo::rerun-if-changed={path}");
    }
    println!("cargo::rustc-env=SUPPLE_GIT_REVISION={}", git_revision().unwrap_or_else(|| "unknown".into()));
    println!("cargo::rustc-env=SUPPLE_MEASURES={:016x}", hash_of_measures());
    let mujoco = std::env::var("DEP_MUJOCO_VERSION").unwrap_or_else(|_| "unknown".into());
    println!("cargo::rustc-env=SUPPLE_MUJOCO_VERSION={mujoco}");
    println!("cargo::rerun-if-changed=policies");
    let out = PathBuf::from(std::env::var_os("OUT_DIR").unwrap_or_default()).join("policies.rs");
    if let Err(error) = std::fs::write(&out, embedded_policies(Path::new("policies"))) {
        println!("cargo::error=cannot write {}: {error}", out.display());
    }
}

/// An array expression of (name, bytes), by name: `compliant-seed0`, `hardware/compliant-seed0`.
fn embedded_policies(folder: &Path) -> String {
    let mut files = Vec::new();
    files_in(folder, &mut files);
    files.retain(|file| file.extension().is_some_and(|extension| extension == "safetensors"));
    files.sort_by_key(|file| file.with_extension(""));
    let mut code = String::from("&[\n");
    for file in files {
        let name = file.strip_prefix(folder).unwrap_or(&file).with_extension("").display().to_string();
        let path = file.canonicalize().unwrap_or(file).display().to_string();
        // Writing into a String cannot fail.
        let _ = writeln!(code, "    ({name:?}, include_bytes!({path:?})),");
    }
    code.push(']');
    code
}

/// FNV-1a over paths and contents of what a measurement depends on.
fn hash_of_measures() -> u64 {
    let mut files = Vec::new();
    PROGRAM.iter().for_each(|path| files_in(Path::new(path), &mut files));
    files.retain(|file| !UNMEASURED.iter().any(|unmeasured| file.starts_with(unmeasured)));
    files.sort();
    let mut hash = 0xcbf2_9ce4_8422_2325_u64;
    for file in files {
        let path = file.to_string_lossy().into_owned().into_bytes();
        for byte in path.into_iter().chain(std::fs::read(&file).unwrap_or_default()) {
            hash = (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        }
    }
    hash
}

/// A file, or all of a folder and of the folders in it.
fn files_in(path: &Path, files: &mut Vec<PathBuf>) {
    if !path.is_dir() {
        return files.push(path.to_owned());
    }
    let entries = std::fs::read_dir(path).into_iter().flatten().filter_map(Result::ok);
    entries.for_each(|entry| files_in(&entry.path(), files));
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
