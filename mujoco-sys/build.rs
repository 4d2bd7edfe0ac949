//! Build script: finds MuJoCo (2.2.2, or 3.2 up to 4), generates the bindings, compiles the shim that catches fatal errors.

use std::env;
use std::path::{Path, PathBuf};
use std::process::exit;

const PACKAGE: &str = "Debian 12's package libmujoco-dev (MuJoCo 2.2.2): apt-get install libmujoco-dev";

/// The release that is the default, and the first and last series of the others for whose structs and semantics this crate is written.
const DEFAULT: [u32; 3] = [2, 2, 2];
const OTHERS: [[u32; 2]; 2] = [[3, 2], [4, u32::MAX]];

/// Returns the major, minor and patch number of an `mjVERSION_HEADER`: 222 is 2.2.2, 337 is 3.3.7, 3017000 is 3.17.0.
fn numbers(header: u32) -> [u32; 3] {
    let base = if header < 1000 { 10 } else { 1000 };
    [header / (base * base), header / base % base, header % base]
}

fn main() {
    ["shim.c", "shim.h", "guard.h", "render.c", "render.h"]
        .iter()
        .for_each(|file| println!("cargo::rerun-if-changed=src/{file}"));
    println!("cargo::rerun-if-env-changed=MUJOCO_PREFIX");
    let prefix = find_prefix();
    let include = prefix.join("include");
    let [major, minor, patch] = check_header(&include.join("mujoco/mujoco.h"));
    let library = find_library(&prefix);

    println!("cargo::rustc-link-search=native={}", library.display());
    println!("cargo::rustc-link-lib=dylib=mujoco");
    println!("cargo::metadata=version={major}.{minor}.{patch}");
    // The programs look for the library there, unless it is where the system looks anyway.
    let folder = if prefix == Path::new("/usr") { String::new() } else { library.display().to_string() };
    println!("cargo::metadata=folder={folder}");

    cc::Build::new()
        .files(["src/shim.c", "src/render.c"])
        .include(&include)
        .flag("-std=c11")
        .warnings(true)
        .compile("mujoco_shim");
    // The shim calls into libmujoco: it has to come before it on the linker's line.
    println!("cargo::rustc-link-lib=dylib=mujoco");

    let bindings = bindgen::Builder::default()
        .header("src/shim.h")
        .header("src/render.h")
        .clang_arg(format!("-I{}", include.display()))
        .allowlist_function(
            "supple_.*|mj_(deleteModel|deleteData|deleteVFS|defaultVFS|freeLastXML|name2id|id2name|version)",
        )
        .allowlist_type(
            "Supple.*|mjModel|mjData|mjVFS|mjContact|mjt(Obj|Warning|Geom|Joint|Constraint|Trn|Bias|Cone)_?",
        )
        .allowlist_var("mjVERSION_HEADER|mjNGAIN|mjNIMP|SUPPLE_ERROR_SIZE")
        .default_enum_style(bindgen::EnumVariation::Consts)
        .prepend_enum_name(false)
        .layout_tests(false)
        .generate_comments(false)
        .generate();
    let bindings = match bindings {
        Ok(bindings) => bindings,
        Err(error) => fail(&format!("bindgen failed on {}: {error}; is libclang-dev installed?", include.display())),
    };
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default()).join("bindings.rs");
    if let Err(error) = bindings.write_to_file(&out) {
        fail(&format!("cannot write {}: {error}", out.display()));
    }
}

/// Returns the folder with `include` and `lib` of MuJoCo: that of `MUJOCO_PREFIX`, else the one that `scripts/setup mujoco` has made in
/// this checkout, else the system's.
fn find_prefix() -> PathBuf {
    // Read when it runs, not when it is compiled, as checkouts may share a target folder.
    let checkout = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").unwrap_or_default()).join("..");
    let fetched = checkout.join(".mujoco");
    if fetched.exists() {
        println!("cargo::rerun-if-changed={}", fetched.display());
    }
    let own = fetched.join("2.2.2");
    match env::var_os("MUJOCO_PREFIX") {
        Some(prefix) => checkout.join(&prefix).canonicalize().unwrap_or_else(|_| prefix.into()),
        None if own.exists() => own.canonicalize().unwrap_or(own),
        None => "/usr".into(),
    }
}

fn check_header(header: &Path) -> [u32; 3] {
    let Ok(text) = std::fs::read_to_string(header) else {
        fail(&format!("the header {} is missing; supple needs {PACKAGE}", header.display()));
    };
    let version = text
        .lines()
        .find_map(|line| line.strip_prefix("#define mjVERSION_HEADER"))
        .and_then(|rest| rest.trim().parse::<u32>().ok())
        .map(numbers);
    match version {
        Some(found @ [major, minor, _])
            if found == DEFAULT || (OTHERS[0] <= [major, minor] && [major, minor] <= OTHERS[1]) =>
        {
            found
        }
        found => fail(&format!(
            "{} is of version {}, expected 2.2.2, or 3.2 up to 4; supple needs {PACKAGE}",
            header.display(),
            found.map_or("unknown".into(), |[major, minor, patch]| format!("{major}.{minor}.{patch}")),
        )),
    }
}

/// Finds the folder of `libmujoco.so` below `prefix`, also in Debian's multi-architecture folders.
fn find_library(prefix: &Path) -> PathBuf {
    let lib = prefix.join("lib");
    let arch = env::var("CARGO_CFG_TARGET_ARCH").unwrap_or_default();
    let candidates = [lib.join(format!("{arch}-linux-gnu")), lib.clone()];
    match candidates.iter().find(|folder| folder.join("libmujoco.so").exists()) {
        Some(folder) => folder.clone(),
        None => fail(&format!("libmujoco.so is not under {}; supple needs {PACKAGE}", lib.display())),
    }
}

fn fail(message: &str) -> ! {
    eprintln!("error: {message}");
    exit(1)
}
