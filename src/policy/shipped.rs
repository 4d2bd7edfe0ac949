//! The policies that ship inside the program, and finding one by name or path.

use std::path::Path;

use crate::policy::{Agent, AgentError, Policy};
use crate::util::files;

/// Name and file of every policy in `policies/` at build time, by name; one in a folder is `hardware/compliant-seed0`.
pub const EMBEDDED: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/policies.rs"));

/// Why no policy was found.
#[derive(Debug, thiserror::Error)]
pub enum FindError {
    /// Neither a file nor a shipped policy.
    #[error(
        "there is no policy '{name}': give a policy file, a run's folder, the YAML file of an external policy, or \
         one of: {known}"
    )]
    Unknown {
        /// What was asked for.
        name: String,
        /// The shipped ones.
        known: String,
    },
    /// The file is no good.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// An ONNX file alone.
    #[error(
        "{name} does not say what it sees and what its outputs mean: describe it in a YAML file that names it, as \
         examples/policies/rsl_rl.yaml does, and give that"
    )]
    Undescribed {
        /// The file.
        name: String,
    },
    /// It is not ours.
    #[error("{name} is an external policy: this works with policy files of Supple")]
    External {
        /// What was asked for.
        name: String,
    },
}

/// A policy by path of its file, path of a run's folder, path of the YAML file of an external one, or name of a
/// shipped one; `compliant` stands for the least seed's that ships, `compliant-seed0`.
///
/// # Errors
/// [`FindError`], with the names that there are.
pub fn find(name: &str) -> Result<Agent, FindError> {
    let path = files::as_path(name);
    if path.is_dir() {
        return Ok(Agent::load(&path.join("policy.safetensors"))?);
    }
    if path.exists() {
        if path.extension().is_some_and(|extension| extension == "onnx") {
            return Err(FindError::Undescribed { name: name.to_owned() });
        }
        return Ok(Agent::load(&path)?);
    }
    let names: Vec<&str> = EMBEDDED.iter().map(|(known, _)| *known).collect();
    let shipped = position(&names, name).ok_or_else(|| FindError::Unknown { name: name.to_owned(), known: known() })?;
    let (known, bytes) = EMBEDDED[shipped];
    Ok(Policy::from_bytes(bytes, Path::new(known)).map_err(AgentError::from)?.into())
}

/// Which of the names is meant: itself, or the least seed's.
fn position(names: &[&str], name: &str) -> Option<usize> {
    let seed = |known: &str| known.strip_prefix(name)?.strip_prefix("-seed")?.parse::<u64>().ok();
    let of_seeds = names.iter().enumerate().filter_map(|(index, known)| Some((seed(known)?, index)));
    names.iter().position(|known| *known == name).or_else(|| of_seeds.min().map(|(_, index)| index))
}

/// As [`find`], for what only works with a policy file of ours.
///
/// # Errors
/// As [`find`], and if the policy is external.
pub fn find_ours(name: &str) -> Result<Policy, FindError> {
    find(name)?.into_policy().ok_or_else(|| FindError::External { name: name.to_owned() })
}

fn known() -> String {
    if EMBEDDED.is_empty() {
        return "(none ships with this build: train one with `cargo run --release --bin train`)".to_owned();
    }
    EMBEDDED.iter().map(|(name, _)| *name).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_policy_has_its_card() {
        for (name, _) in EMBEDDED {
            let sha256 = find(name).unwrap().sha256;
            let card = Path::new(env!("CARGO_MANIFEST_DIR")).join("policies").join(format!("{name}.md"));
            let card = std::fs::read_to_string(&card).unwrap_or_else(|error| panic!("{}: {error}", card.display()));
            assert!(card.contains(&sha256), "{name} is {sha256}, its card says otherwise");
        }
    }

    #[test]
    fn a_name_without_a_seed_means_the_least_seed_that_ships() {
        let names = ["baseline-seed3", "compliant-seed10", "compliant-seed3", "hardware/compliant-seed5"];
        assert_eq!(position(&names, "compliant"), Some(2));
        assert_eq!(position(&names, "compliant-seed10"), Some(1));
        assert_eq!(position(&names, "hardware/compliant"), Some(3));
        assert_eq!(position(&names, "compl"), None);
    }
}
