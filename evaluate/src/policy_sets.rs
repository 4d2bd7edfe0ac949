/*! The sets of policies that are compared, read from folders.

The path of a set is a folder (all policies in it), the folder of a run, a policy's file, or a folder and the common name of
files or runs `NAME-seedN`: `policies/baseline` stands for `policies/baseline-seed0.safetensors` and so on, and `runs/fast` for
the runs `runs/fast-seed0` and so on. `policies/baseline@0.03` also sets the commanded compliance \[m/s/N\] of these policies.
*/

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use serde::Serialize;
use supple::config::Config;
use supple::estimate::contact::RATE_HZ;
use supple::policy::compliance::{ComplianceError, split_compliance};
use supple::policy::{Agent, AgentError, Provenance, shipped};
use supple::robot::Losses;
use supple::util::files::{self, FileError};
use supple::util::numbers::short;

/// The configuration keys, or their beginnings, that affect the trials of a policy.
const TRIAL_KEYS: [&str; 4] = ["simulation.", "robot.", "episode.min_height_m", "randomisation.default_friction"];

/// The reason why sets of policies cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum PolicySetError {
    /// The folder cannot be read.
    #[error("cannot read the {0}")]
    Read(#[from] FileError),
    /// The folder has no policy of a set, whose files have names of this form.
    #[error("{0} has no policy {1}; train one with `cargo run --release --bin train`")]
    Missing(PathBuf, String),
    /// Two files have the same seed of one set.
    #[error("{0} and {1} are both seed {2} of {3}, expected one policy per seed")]
    Twice(PathBuf, PathBuf, u64, String),
    /// A path stands for several policies, a number and the first of them, where one is examined.
    #[error("{0} stands for {1} policies, expected one, such as {2}")]
    Several(PathBuf, usize, PathBuf),
    /// A policy file is invalid.
    #[error(transparent)]
    Agent(#[from] AgentError),
    /// The policy of a file does not support the commanded compliance.
    #[error("{0}: {1}")]
    Compliance(PathBuf, #[source] ComplianceError),
}

/// A policy of a set.
#[derive(Debug)]
pub struct SetMember {
    /// The seed of its training, which pairs it with policies of other sets and seeds its trials.
    pub seed: u64,
    /// The file it was read from.
    pub file: PathBuf,
    /// The policy.
    pub agent: Agent,
}

/// A named set of policies.
#[derive(Debug)]
pub struct PolicySet {
    /// The name in tables and legends.
    pub name: String,
    /// The policies in the order of their seeds.
    pub members: Vec<SetMember>,
}

/// The training of a set, which the report shows before its numbers. Policy files do not record how long it took.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Training {
    /// The name of the set.
    pub set: String,
    /// The seeds of its policies.
    pub seeds: Vec<u64>,
    /// The names of the configurations.
    pub configurations: BTreeSet<String>,
    /// The numbers of samples, which are steps of an environment; none for external policies.
    pub samples: BTreeSet<u64>,
}

impl Training {
    fn new(set: &PolicySet) -> Self {
        Training {
            set: set.name.clone(),
            seeds: set.members.iter().map(|member| member.seed).collect(),
            configurations: set.members.iter().map(|member| member.config_name().to_owned()).collect(),
            samples: set.members.iter().filter_map(SetMember::samples).collect(),
        }
    }

    /// Returns the number of samples in millions, from the least to the largest; none if it is unknown.
    pub fn millions(&self) -> Option<String> {
        let [least, largest] = [self.samples.first()?, self.samples.last()?].map(|samples| millions(*samples));
        Some(if least == largest { least } else { format!("{least} to {largest}") })
    }
}

/// Returns a number of samples in millions.
pub fn millions(samples: u64) -> String {
    let steps_of = if samples < 1_000_000 { 1e3 } else { 1e5 };
    short((samples as f64 / steps_of).round() * steps_of / 1e6)
}

/// All sets of policies, with notes for the reader of the report.
#[derive(Debug)]
pub struct PolicySets {
    /// The sets: the first (compliant) is compared with the second (baseline); further sets are shown beside them.
    pub sets: Vec<PolicySet>,
    /// Notes about policies, such as files left out and seeds without a partner.
    pub notes: Vec<String>,
}

impl PolicySets {
    /// Reads policies `NAME-seedN.safetensors` and external ones `NAME-seedN.yaml` of several names from one folder, or the shipped ones
    /// without a folder, and further sets by name and path.
    ///
    /// # Errors
    /// A folder or policy cannot be read, a set has no policy or two of one seed, or a policy does not support the commanded
    /// compliance.
    pub fn from_folder(
        folder: Option<&Path>,
        names: &[String],
        also: &[(String, PathBuf)],
    ) -> Result<Self, PolicySetError> {
        let shipped = shipped::EMBEDDED.iter().filter(|(name, _)| !name.contains('/')).map(|(name, _)| name.into());
        let all = folder.map_or_else(|| Ok(shipped.collect()), policy_files)?;
        let folder = folder.unwrap_or(Path::new("the policies inside this program"));
        let (mut files, mut left_out) = (vec![Vec::new(); names.len()], Vec::new());
        for file in all {
            match names.iter().enumerate().find_map(|(set, name)| Some((set, seed_of(name, &file)?))) {
                Some((set, seed)) => files[set].push((Some(seed), file)),
                None => left_out.push(file),
            }
        }
        let set = |(name, files): (&String, _)| {
            PolicySet::load(name, folder, files, None, &format!("{name}-seedN.safetensors (or .yaml), N a number"))
        };
        let further = also.iter().map(|(name, path)| PolicySet::from_path(name, path));
        let sets = names.iter().zip(files).map(set).chain(further).collect::<Result<Vec<_>, _>>()?;
        let is_read = |file: &PathBuf| sets.iter().flat_map(|set| &set.members).any(|member| member.file == *file);
        left_out.retain(|file| !is_read(file));
        let note = |file: &PathBuf| {
            let name = file.file_name().unwrap_or_default().display();
            format!("{name} was left out: its name belongs to neither set")
        };
        Ok(Self::new(sets, left_out.iter().map(note).collect()))
    }

    /// Reads sets by name and path.
    ///
    /// # Errors
    /// The same as those of [`PolicySets::from_folder`].
    pub fn from_paths(sets: &[(String, PathBuf)]) -> Result<Self, PolicySetError> {
        let sets = sets.iter().map(|(name, path)| PolicySet::from_path(name, path));
        let mut sets = sets.collect::<Result<Vec<_>, _>>()?;
        let notes = pair_single_policies(&mut sets);
        Ok(Self::new(sets, notes))
    }

    fn new(sets: Vec<PolicySet>, mut notes: Vec<String>) -> Self {
        for (set, other) in [(0, 1), (1, 0)] {
            let (Some(own), Some(partner)) = (sets.get(set), sets.get(other)) else { continue };
            let lacks = |member: &&SetMember| partner.members.iter().all(|other| other.seed != member.seed);
            let alone: Vec<String> = own.members.iter().filter(lacks).map(|member| member.seed.to_string()).collect();
            if !alone.is_empty() {
                let (partner, alone, own) = (&partner.name, alone.join(", "), &own.name);
                let means = "means are over all seeds of a set, differences over the seeds of both";
                notes.push(format!("{partner} has no policy of seed {alone}, unlike {own}: {means}"));
            }
        }
        for PolicySet { name, members } in &sets {
            if let Some(compliance) = members.iter().find_map(|it| it.agent.resolve_compliance(None, None).ok()?) {
                let words = "m/s/N in trials that command none";
                notes.push(format!("{name} has a commanded compliance of {compliance} {words}"));
            }
            for (index, member) in members.iter().enumerate() {
                let seed = member.seed;
                if let Some(twin) = members[..index].iter().find(|it| it.agent.sha256 == member.agent.sha256) {
                    let words = "are one policy: the two samples are not independent";
                    notes.push(format!("{name}, seeds {} and {seed}, {words}", twin.seed));
                }
                if let Some(unfinished) = member.provenance().and_then(Provenance::unfinished) {
                    notes.push(format!("{name}, seed {seed}, {unfinished}"));
                }
                if let Some(provenance) = member.provenance().filter(|it| it.seed != seed) {
                    notes.push(format!("{name}, seed {seed}, was trained with seed {}", provenance.seed));
                }
            }
        }
        // This note comes first, as it may explain most of a difference.
        notes.splice(0..0, unequal_samples(&sets));
        let policies = PolicySets { sets, notes: Vec::new() };
        let keys: Vec<String> = policies.differing_keys().into_iter().collect();
        if !keys.is_empty() {
            let keys = keys.join(", ");
            notes.push(format!("the policies were not trained alike: their configurations differ in {keys}"));
        }
        // Trials of a policy, also of an external one, use its own values of these keys.
        let mut tried: Vec<String> = differing(policies.members().map(|(_, member)| &member.agent.config)).collect();
        tried.retain(|key| TRIAL_KEYS.iter().any(|known| key.starts_with(known)));
        if !tried.is_empty() {
            notes.push(format!("each policy is evaluated with its own {}", tried.join(", ")));
        }
        PolicySets { notes, ..policies }
    }

    /// Returns the training of each set.
    pub fn training(&self) -> Vec<Training> {
        self.sets.iter().map(Training::new).collect()
    }

    /// Returns the keys in which the configurations of Supple's policies differ: except the recovery stage, which is compared, and the
    /// learner's arithmetic, which changes only rounding (`docs/training.md`).
    pub fn differing_keys(&self) -> BTreeSet<String> {
        let configs = self.members().filter_map(|(_, member)| Some(&member.provenance()?.config));
        differing(configs).filter(|key| !["episode.recovery_stage", "ppo.precision"].contains(&key.as_str())).collect()
    }

    /// Sets the joint losses of all robots.
    pub fn set_losses(&mut self, losses: Losses) {
        for member in self.sets.iter_mut().flat_map(|set| &mut set.members) {
            member.agent.config.robot.set_losses(losses);
        }
        self.notes.push(format!(
            "all robots have joints with {} N m of friction and {} N m s/rad of damping",
            losses.friction_n_m, losses.damping_n_m_s_per_rad
        ));
    }

    /// Returns all policies with their sets.
    pub fn members(&self) -> impl Iterator<Item = (&PolicySet, &SetMember)> {
        self.sets.iter().flat_map(PolicySet::with_members)
    }

    /// Returns the names of all sets.
    pub fn names(&self) -> Vec<String> {
        self.sets.iter().map(|set| set.name.clone()).collect()
    }
}

impl SetMember {
    /// Returns the provenance of the policy; none for an external policy.
    fn provenance(&self) -> Option<&Provenance> {
        self.agent.policy().map(|policy| &policy.provenance)
    }

    /// Returns the name of the configuration; `external` for an external policy.
    pub fn config_name(&self) -> &str {
        self.provenance().map_or("external", |provenance| &provenance.config_name)
    }

    /// Returns the number of training samples; none for an external policy.
    pub fn samples(&self) -> Option<u64> {
        self.provenance().map(|provenance| provenance.samples)
    }

    /// Returns the revision of the program that trained the policy; a dash for an external policy.
    pub fn revision(&self) -> &str {
        self.provenance().map_or("–", |provenance| &provenance.git_revision)
    }
}

impl PolicySet {
    /// Returns the policies with the set.
    pub fn with_members(&self) -> impl Iterator<Item = (&PolicySet, &SetMember)> {
        self.members.iter().map(move |member| (self, member))
    }

    /// Returns the name of a policy: that of its set and, if this has several, its seed.
    pub fn member_name(&self, member: &SetMember) -> String {
        if self.members.len() == 1 { self.name.clone() } else { format!("{}-seed{}", self.name, member.seed) }
    }

    /// Returns why a robot cannot act on its sensors: its physics do not have the rate of the contact network; none if all can.
    pub fn cannot_sense(sets: &[PolicySet]) -> Option<String> {
        let rate_hz = |member: &SetMember| f64::from(member.agent.config.simulation.physics_rate_hz);
        let mut members = sets.iter().flat_map(PolicySet::with_members);
        let (PolicySet { name, .. }, member) = members.find(|(_, member)| rate_hz(member) != RATE_HZ)?;
        Some(format!("the physics of {name} run at {} Hz, the contact network at {RATE_HZ} Hz", rate_hz(member)))
    }

    /// Reads all policies of a path.
    fn from_path(name: &str, path: &Path) -> Result<Self, PolicySetError> {
        let text = path.display().to_string();
        let (text, compliance) = split_compliance(&text);
        let path = &PathBuf::from(text);
        let files = if path.is_file() {
            vec![path.to_owned()]
        } else if path.join("run.json").exists() {
            // The folder of a run also holds a checkpoint, which is not a policy.
            vec![path.join("policy.safetensors")]
        } else if path.is_dir() {
            policy_files(path)?
        } else {
            match shipped::seeds_at(path) {
                // The name of a policy inside the program.
                seeds if seeds.is_empty() => vec![path.to_owned()],
                seeds => seeds.into_iter().map(|(_, file)| file).collect(),
            }
        };
        let files = files.into_iter().map(|file| (seed_in_name(&file), file)).collect();
        PolicySet::load(name, path, files, compliance, "*.safetensors or *.yaml")
    }

    fn load(
        name: &str,
        folder: &Path,
        files: Vec<(Option<u64>, PathBuf)>,
        compliance: Option<f64>,
        wanted: &str,
    ) -> Result<Self, PolicySetError> {
        if files.is_empty() {
            return Err(PolicySetError::Missing(folder.to_owned(), wanted.to_owned()));
        }
        let mut members: Vec<SetMember> = Vec::new();
        for (seed, file) in files {
            let mut agent = shipped::find(&file.display().to_string())?;
            agent.commanded_compliance = compliance;
            if let Err(source) = agent.resolve_compliance(None, None) {
                return Err(PolicySetError::Compliance(file, source));
            }
            let seed = seed.or_else(|| Some(agent.policy()?.provenance.seed)).unwrap_or(0);
            if let Some(first) = members.iter().find(|member| member.seed == seed) {
                return Err(PolicySetError::Twice(first.file.clone(), file, seed, name.to_owned()));
            }
            members.push(SetMember { seed, file, agent });
        }
        members.sort_by_key(|member| member.seed);
        Ok(PolicySet { name: name.to_owned(), members })
    }
}

/// Returns the keys in which configurations differ, in their order.
fn differing<'a>(mut configs: impl Iterator<Item = &'a Config>) -> impl Iterator<Item = String> {
    let first = configs.next();
    let of = |config| first.into_iter().flat_map(move |first: &Config| first.differences(config));
    configs.flat_map(of).map(|(key, _)| key).collect::<BTreeSet<String>>().into_iter()
}

/// Pairs sets of a single policy: gives their policies the seed of the first set's single policy. Returns notes about it.
fn pair_single_policies(sets: &mut [PolicySet]) -> Vec<String> {
    let is_pair = sets.len() == 2;
    let Some((first, others)) = sets.split_first_mut() else { return Vec::new() };
    let [a] = &first.members[..] else { return Vec::new() };
    let mut notes = Vec::new();
    for set in others {
        if let [b] = &mut set.members[..]
            && a.seed != b.seed
        {
            let which =
                if is_pair { "two policies".into() } else { format!("policies of {} and {}", first.name, set.name) };
            notes.push(format!("the {which} are compared as a pair, though their seeds are {} and {}", a.seed, b.seed));
            b.seed = a.seed;
        }
    }
    notes
}

/// Returns a note about numbers of samples; none if they differ by no more than an iteration or so.
fn unequal_samples(sets: &[PolicySet]) -> Option<String> {
    let trained: Vec<Training> = sets.iter().map(Training::new).filter(|set| !set.samples.is_empty()).collect();
    let all = || trained.iter().flat_map(|set| set.samples.iter().copied());
    let [least, largest] = [all().min()?, all().max()?];
    let [first, others @ ..] = &trained[..] else { return None };
    let of_other = |set: &Training| Some(format!(", {} {} million", set.set, set.millions()?));
    let others: String = others.iter().filter_map(of_other).collect();
    let (name, own) = (&first.set, first.millions()?);
    let is_unequal = largest as f64 > 1.05 * least as f64;
    is_unequal.then(|| format!("{name} has {own} million samples{others}: differences may come from that"))
}

/// Returns the seed N of a file `NAME-seedN` of a given name; none for another file.
fn seed_of(name: &str, file: &Path) -> Option<u64> {
    file.file_stem()?.to_string_lossy().strip_prefix(name)?.strip_prefix("-seed")?.parse().ok()
}

/// Returns the number after the last `-seed` of a file's name.
fn seed_in_name(file: &Path) -> Option<u64> {
    file.file_stem()?.to_str()?.rsplit_once("-seed")?.1.parse().ok()
}

/// Returns all policy files of a folder, sorted by name.
fn policy_files(folder: &Path) -> Result<Vec<PathBuf>, PolicySetError> {
    let fail = FileError::of("policies in", folder);
    let entries = std::fs::read_dir(folder).map_err(fail)?.map(|entry| entry.map(|entry| entry.path()));
    let mut files = entries.collect::<Result<Vec<_>, _>>().map_err(fail)?;
    files.retain(|file| files::is_yaml(file) || file.extension().is_some_and(|extension| extension == "safetensors"));
    files.sort();
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seed_follows_the_whole_name() {
        let of = |name, file: &str| seed_of(name, Path::new(file));
        assert_eq!(of("soft", "policies/soft-seed12.safetensors"), Some(12));
        assert_eq!(of("soft", "policies/soft-seed3.yaml"), Some(3));
        assert_eq!(of("soft", "policies/softer-seed3.yaml"), None);
        assert_eq!(of("soft", "policies/soft.safetensors"), None);
    }
}
