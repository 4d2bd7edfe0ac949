//! The policies that ship inside the program, and finding one by name or path.

use std::path::Path;

use crate::policy::{Policy, PolicyError};

/// Name and file of every policy in `policies/` at build time, by name.
pub const EMBEDDED: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/policies.rs"));

/// Why no policy was found.
#[derive(Debug, thiserror::Error)]
pub enum FindError {
    /// Neither a file nor a shipped policy.
    #[error("there is no policy '{name}': give a policy file, a run's folder, or one of: {known}")]
    Unknown {
        /// What was asked for.
        name: String,
        /// The shipped ones.
        known: String,
    },
    /// The file is no good.
    #[error(transparent)]
    Policy(#[from] PolicyError),
}

/// A policy by path of its file, path of a run's folder, or name of a shipped one; `compliant` stands for
/// `compliant-seed0`.
///
/// # Errors
/// [`FindError`], with the names that there are.
pub fn find(name: &str) -> Result<Policy, FindError> {
    let path = Path::new(name);
    if path.is_dir() {
        return Ok(Policy::load(&path.join("policy.safetensors"))?);
    }
    if path.is_file() {
        return Ok(Policy::load(path)?);
    }
    let first_seed = format!("{name}-seed0");
    let shipped = EMBEDDED.iter().find(|(known, _)| *known == name || *known == first_seed);
    let (known, bytes) = shipped.ok_or_else(|| FindError::Unknown { name: name.to_owned(), known: known() })?;
    Ok(Policy::from_bytes(bytes, Path::new(known))?)
}

fn known() -> String {
    if EMBEDDED.is_empty() {
        return "(none ships with this build: train one with `cargo run --release --bin train`)".to_owned();
    }
    EMBEDDED.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ")
}
