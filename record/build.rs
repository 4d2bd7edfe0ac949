//! Lets the programs of this package, and of those that share this script, find the MuJoCo that the library was built with.

fn main() {
    println!("cargo::rerun-if-env-changed=DEP_SUPPLE_MUJOCO_FOLDER");
    let mujoco = std::env::var("DEP_SUPPLE_MUJOCO_FOLDER").unwrap_or_default();
    if !mujoco.is_empty() {
        println!("cargo::rustc-link-arg=-Wl,-rpath,{mujoco}");
    }
}
