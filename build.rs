//! Provenance: the git revision and the MuJoCo version become part of the program.

use std::process::Command;

fn main() {
    println!("cargo::rerun-if-changed=.git/HEAD");
    println!("cargo::rerun-if-changed=.git/logs/HEAD");
    println!("cargo::rustc-env=SUPPLE_GIT_REVISION={}", git_revision().unwrap_or_else(|| "unknown".into()));
    let mujoco = std::env::var("DEP_MUJOCO_VERSION").unwrap_or_else(|_| "unknown".into());
    println!("cargo::rustc-env=SUPPLE_MUJOCO_VERSION={mujoco}");
}

fn git_revision() -> Option<String> {
    let output = Command::new("git").args(["describe", "--always", "--dirty", "--abbrev=12"]).output().ok()?;
    output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
}
