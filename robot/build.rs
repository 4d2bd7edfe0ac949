//! Lets the program find the MuJoCo that the library was built with, where the library tells.

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    let mujoco = std::env::var("DEP_SUPPLE_MUJOCO_FOLDER").unwrap_or_default();
    if !mujoco.is_empty() {
        println!("cargo::rustc-link-arg=-Wl,-rpath,{mujoco}");
    }
}
