//! Puts the version of MuJoCo and the shipped policies into the library, and lets programs find that MuJoCo.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};
fn main() {
    println!("cargo::rustc-check-cfg=cfg(tiles)");
    let target = |key: &str| std::env::var(format!("CARGO_CFG_TARGET_{key}")).unwrap_or_default();
    if (target("ARCH"), target("OS")) == ("x86_64".into(), "linux".into()) {
        println!("cargo::rustc-cfg=tiles");
    }
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rerun-if-changed=policies");
    let mujoco = std::env::var("DEP_MUJOCO_VERSION").unwrap_or_else(|_| "unknown".into());
    println!("cargo::rustc-env=SUPPLE_MUJOCO_VERSION={mujoco}");
    // Each package with programs does the same with the metadata.
    let folder = std::env::var("DEP_MUJOCO_FOLDER").unwrap_or_default();
    println!("cargo::metadata=mujoco_folder={folder}");
    if !folder.is_empty() {
        println!("cargo::rustc-link-arg=-Wl,-rpath,{folder}");
    }
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

/// An array expression of (name, content) of the files with a suffix, by name: `compliant-seed0`, `go2/compliant-seed0`.
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

/// Returns all files of a folder and of the folders in it.
fn files_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().filter_map(Result::ok);
    entries.flat_map(|entry| if entry.path().is_dir() { files_in(&entry.path()) } else { vec![entry.path()] }).collect()
}
