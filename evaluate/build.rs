//! Hashes the sources that a measurement of this package depends on, and lets the program find MuJoCo.

mod measurement_sources;

fn main() {
    let mujoco = std::env::var("DEP_SUPPLE_MUJOCO_FOLDER").unwrap_or_default();
    if !mujoco.is_empty() {
        println!("cargo::rustc-link-arg=-Wl,-rpath,{mujoco}");
    }
    let root = measurement_sources::root();
    for path in ["src", "models", "configs", "mujoco-sys", "Cargo.lock", "evaluate"] {
        println!("cargo::rerun-if-changed={}", root.join(path).display());
    }
    println!(
        "cargo::rustc-env=SUPPLE_MEASUREMENT_SOURCES={:016x}",
        measurement_sources::hash_of(&measurement_sources::measured_files())
    );
}
