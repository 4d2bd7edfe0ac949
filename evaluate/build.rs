//! Hashes the sources that decide what a measurement of this package comes out as.

mod measured;

fn main() {
    let root = measured::root();
    for path in ["src", "models", "configs", "mujoco-sys", "Cargo.lock", "evaluate"] {
        println!("cargo::rerun-if-changed={}", root.join(path).display());
    }
    println!("cargo::rustc-env=SUPPLE_MEASUREMENT_SOURCES={:016x}", measured::hash_of(&measured::measured_files()));
}
