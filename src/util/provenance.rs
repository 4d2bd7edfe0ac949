//! The program that runs: stored with every run and policy.

use std::sync::OnceLock;

/// The version of MuJoCo that the library was built against.
pub const MUJOCO_VERSION: &str = env!("SUPPLE_MUJOCO_VERSION");

static GIT_REVISION: OnceLock<&str> = OnceLock::new();

/// Says which git revision the running program was built from; the first call counts.
///
/// A program knows its revision, the library does not: a commit then compiles the programs anew and not the library.
pub fn set_git_revision(revision: &'static str) {
    let _ = GIT_REVISION.set(revision);
}

/// Returns the git revision that the running program was built from, with `-dirty` if it had changes; `unknown` outside a
/// checkout and in programs that never said it.
pub fn git_revision() -> &'static str {
    GIT_REVISION.get().copied().unwrap_or("unknown")
}

#[doc(hidden)]
pub use git_version::git_version;

/// Calls [`set_git_revision`](crate::util::provenance::set_git_revision) with the revision that the calling crate is built
/// from. For the `main` of a program: the crate that calls it is compiled again after every commit.
#[macro_export]
macro_rules! announce_revision {
    () => {
        $crate::util::provenance::set_git_revision($crate::util::provenance::git_version!(
            args = ["--always", "--dirty", "--abbrev=12", "--exclude=*"],
            fallback = "unknown"
        ))
    };
}
