//! The shipped policies inside the program, and the look-up of a policy by name or path.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use crate::policy::compliance::{PolicyCalibration, split_compliance};
use crate::policy::{Agent, AgentError, Policy};
use crate::util::files::is_yaml;

/// Name and file of every policy in `policies/` at build time, sorted by name, such as `go2/compliant-seed0`.
pub const EMBEDDED: &[(&str, &[u8])] = include!(concat!(env!("OUT_DIR"), "/policies.rs"));

/// Name and calibration of the shipped policies that have one.
const CALIBRATIONS: &[(&str, &str)] = include!(concat!(env!("OUT_DIR"), "/calibrations.rs"));

/// Finds a policy: the path of a policy file, of a run's folder or of an external policy's YAML file, or the name of a
/// shipped policy. `compliant` is short for the one with the smallest seed, `compliant-seed0`, and so is `runs/fast`.
///
/// # Errors
/// There is no such policy (the error lists the shipped ones), or its file is invalid.
pub fn find(name: &str) -> Result<Agent, AgentError> {
    let (name, compliance) = split_compliance(name);
    let mut agent = match file_of(name) {
        Some(file) if !is_onnx(&file) => Agent::load(&file)?,
        _ => find_uncalibrated(name)?,
    };
    if let Some((name, text)) =
        embedded(name).and_then(|at| CALIBRATIONS.iter().find(|(known, _)| *known == EMBEDDED[at].0))
    {
        agent.calibration = Some(PolicyCalibration::from_json(Path::new(name), text, &agent.sha256)?);
    }
    agent.commanded_compliance = compliance;
    Ok(agent)
}

/// Like [`find`], but leaves the policy's calibration unread, to make a new one. The name is without `@` and a compliance.
///
/// # Errors
/// There is no such policy (the error lists the shipped ones), or its file is invalid.
pub fn find_uncalibrated(name: &str) -> Result<Agent, AgentError> {
    if let Some(file) = file_of(name) {
        ensure!(!is_onnx(&file), AgentError::Undescribed(name.to_owned()));
        return Agent::load_uncalibrated(&file);
    }
    let shipped = embedded(name).ok_or_else(|| AgentError::Unknown { name: name.to_owned(), known: known() })?;
    let (known, bytes) = EMBEDDED[shipped];
    Ok(Agent::from(Policy::from_bytes(bytes, Path::new(known))?))
}

fn is_onnx(file: &Path) -> bool {
    file.extension().is_some_and(|extension| extension == "onnx")
}

/// Returns the index of a shipped policy; `None` if a file has the name.
fn embedded(name: &str) -> Option<usize> {
    let names: Vec<&str> = EMBEDDED.iter().map(|(known, _)| *known).collect();
    position(&names, name).filter(|_| file_of(name).is_none())
}

/// Returns the file that [`find`] would read; `None` for a policy inside the program.
pub fn file_of(name: &str) -> Option<PathBuf> {
    let path = PathBuf::from(name);
    if path.is_dir() {
        return Some(path.join("policy.safetensors"));
    }
    if path.exists() { Some(path) } else { seeds_at(&path).into_iter().next().map(|(_, file)| file) }
}

/// Returns the seeds and files of the set of policies at a path that does not exist itself, such as `runs/fast`: files
/// `fast-seedN.safetensors` and `.yaml`, and folders `fast-seedN` of runs.
pub fn seeds_at(path: &Path) -> Vec<(u64, PathBuf)> {
    let (Some(folder), Some(name)) = (path.parent(), path.file_name().and_then(OsStr::to_str)) else {
        return Vec::new();
    };
    let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let member = |path: PathBuf| {
        let is_run = path.join("run.json").is_file();
        let is_file = path.extension().is_some_and(|extension| extension == "safetensors") || is_yaml(&path);
        let own = if is_run { path.file_name()? } else { path.file_stem().filter(|_| is_file)? };
        let seed = own.to_str()?.strip_prefix(name)?.strip_prefix("-seed")?.parse().ok()?;
        Some((seed, if is_run { path.join("policy.safetensors") } else { path }))
    };
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<(u64, PathBuf)> = entries.filter_map(|entry| member(entry.path())).collect();
    found.sort();
    found
}

/// Returns the index of the meant name: the name itself, or the one with the smallest seed.
fn position(names: &[&str], name: &str) -> Option<usize> {
    let seed = |known: &str| known.strip_prefix(name)?.strip_prefix("-seed")?.parse::<u64>().ok();
    let of_seeds = names.iter().enumerate().filter_map(|(index, known)| Some((seed(known)?, index)));
    names.iter().position(|known| *known == name).or_else(|| of_seeds.min().map(|(_, index)| index))
}

/// Like [`find`], for functions that need a policy file of Supple.
///
/// # Errors
/// There is no such policy, its file is invalid, or it is external.
pub fn find_ours(name: &str) -> Result<Policy, AgentError> {
    let agent = find(name)?;
    ensure!(agent.commanded_compliance.is_none(), AgentError::Commanded(name.to_owned()));
    agent.into_policy().ok_or_else(|| AgentError::External(name.to_owned()))
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
    fn set_has_the_files_and_the_runs_of_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let place = |name: &str| folder.path().join(name);
        for run in ["fast-seed10", "fast-seed2", "faster-seed3", "fast-reward.energy=-0.01-seed0"] {
            std::fs::create_dir(place(run)).unwrap();
            std::fs::write(place(run).join("run.json"), "{}").unwrap();
        }
        for file in ["fast-seed4.safetensors", "fast-seed5.yaml", "fast-seed6.md", "fast.safetensors"] {
            std::fs::write(place(file), "").unwrap();
        }
        std::fs::create_dir(place("fast-seed7")).unwrap();
        let seeds: Vec<u64> = seeds_at(&place("fast")).into_iter().map(|(seed, _)| seed).collect();
        assert_eq!(seeds, [2, 4, 5, 10]);
        assert_eq!(file_of(place("fast").to_str().unwrap()), Some(place("fast-seed2/policy.safetensors")));
        let variant = place("fast-reward.energy=-0.01");
        assert_eq!(seeds_at(&variant), [(0, place("fast-reward.energy=-0.01-seed0/policy.safetensors"))]);
    }

    #[test]
    fn a_name_without_a_seed_means_the_least_seed_that_ships() {
        let names = ["baseline-seed3", "compliant-seed10", "compliant-seed3", "go2/compliant-seed5"];
        assert_eq!(position(&names, "compliant"), Some(2));
        assert_eq!(position(&names, "compliant-seed10"), Some(1));
        assert_eq!(position(&names, "go2/compliant"), Some(3));
        assert_eq!(position(&names, "compl"), None);
    }
}
