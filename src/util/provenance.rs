//! Versions of the running program, stored with every run and policy.

use std::sync::OnceLock;

/// The version of MuJoCo that the library was built against.
pub const MUJOCO_VERSION: &str = env!("SUPPLE_MUJOCO_VERSION");

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

/// Calls [`set_git_revision`](crate::util::provenance::set_git_revision) with the revision that the calling crate is
/// built from. Call it in `main` of a program: the calling crate is recompiled after every commit.
#[macro_export]
macro_rules! announce_revision {
    () => {
        $crate::util::provenance::set_git_revision($crate::util::provenance::git_version!(
            args = ["--always", "--dirty", "--abbrev=12", "--exclude=*"],
            fallback = "unknown"
        ))
    };
}
