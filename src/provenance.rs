//! Versions of the running program, stored with every run and policy.

use std::sync::OnceLock;

use crate::mujoco::library_file;
use crate::util::files;

/// The release of MuJoCo that the library was built against.
pub const MUJOCO_RELEASE: &str = env!("SUPPLE_MUJOCO_VERSION");

/// Returns the release of MuJoCo and, behind a plus sign, the first twelve hexadecimal digits of the SHA-256 of the library's file:
/// `2.2.2+a074ea3d63ec`. The same release from two sources computes slightly different numbers.
pub fn mujoco_version() -> &'static str {
    static VERSION: OnceLock<String> = OnceLock::new();
    VERSION.get_or_init(|| match library_file().and_then(|file| std::fs::read(file).ok()) {
        Some(bytes) => format!("{MUJOCO_RELEASE}+{:.12}", files::sha256(&[&bytes])),
        None => MUJOCO_RELEASE.to_owned(),
    })
}

/// Returns what computes the numbers: `2f1c0d9e8a7b with MuJoCo 2.2.2+a074ea3d63ec`.
pub fn revision_and_mujoco() -> String {
    format!("{} with MuJoCo {}", git_revision(), mujoco_version())
}

/// Returns what `--version` prints behind the program's name: its version and revision, and the MuJoCo that it has loaded.
pub fn version() -> String {
    let file = library_file().map(|file| format!(" from {}", file.display())).unwrap_or_default();
    format!("{} (revision {}{file})", env!("CARGO_PKG_VERSION"), revision_and_mujoco())
}

static GIT_REVISION: OnceLock<&str> = OnceLock::new();

/// Sets the git revision that the running program was built from; later calls are ignored.
///
/// Only programs contain their revision, so that a commit recompiles the programs and not the library.
pub fn set_git_revision(revision: &'static str) {
    let _ = GIT_REVISION.set(revision);
}

/// Returns the git revision that the running program was built from, with `-dirty` if it had changes; `unknown` outside
/// a checkout and in programs that did not set it.
pub fn git_revision() -> &'static str {
    GIT_REVISION.get().copied().unwrap_or("unknown")
}

#[doc(hidden)]
pub use git_version::git_version;

/// Calls [`set_git_revision`](crate::provenance::set_git_revision) with the revision that the calling crate is
/// built from. Call it in `main` of a program: the calling crate is recompiled after every commit.
#[macro_export]
macro_rules! announce_revision {
    () => {
        $crate::provenance::set_git_revision($crate::provenance::git_version!(
            args = ["--always", "--dirty", "--abbrev=12", "--exclude=*"],
            fallback = "unknown"
        ))
    };
}
