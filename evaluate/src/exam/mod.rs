/*! The examination of one policy: the percentage of trials that it passes in each discipline, and [what it measures](measures),
beside the shipped references.

Each [`Discipline`] is made of experiments of the protocol `configs/evaluation/exam.yaml` and states what a trial must show to be passed.
The trials are those of the experiments, with the same seeds for the policy and the references, and are kept in the same
[store](crate::measurement_store). An interval is Wilson's (1927), at 95 %, over the trials of one policy. They are independent: nothing
is random in an undisturbed walk on the true state, so that there is one for each command.
*/

pub mod film;
pub mod measures;
pub mod page;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;

use crate::measurement_store::MeasurementStore;
use crate::policy_sets::{PolicySet, PolicySetError, PolicySets, Training};
use crate::protocol::Protocol;
use crate::results::{PolicyResult, Results};
use crate::runner::{self, ON_SENSORS, RunError};
use crate::trial::{Sample, TrialEnd};
use crate::{Condition, Experiment};
use measures::{MEASURES, Measured};
use supple::estimate::contact::ContactNetwork;
use supple::robot::JointLosses;
use supple::scenario::Sensing;
use supple::scenario::catalog::Scenario;

/// The largest relative difference between the measured and the commanded compliance in a passed trial.
const COMPLIANCE_TOLERANCE: f64 = 0.25;

/// The largest velocity error in a passed trial of walking \[m/s\].
const ERROR_BOUND_M_S: f64 = 0.1;

/// The state that the policy acts on, and the losses in the joints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Way {
    /// On the true state.
    Nominal,
    /// On the estimate from its sensors.
    Sensors,
    /// On the true state, with friction and damping in its joints.
    Losses,
}

/// The rule by which a trial is passed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Pass {
    /// The quantity of this name is 1, as for success.
    Is(&'static str),
    /// The robot stays on its feet, and its velocity error is at most [`ERROR_BOUND_M_S`].
    Tracks,
    /// The measured compliance is within [`COMPLIANCE_TOLERANCE`] of the commanded one. Trials without a pull do not count.
    Yields,
}

use Pass::{Is, Tracks, Yields};
use Way::{Losses, Nominal, Sensors};

impl Pass {
    /// Returns whether a trial is passed; none if it does not count. A trial that failed, or whose compliance the policy does not
    /// support, is not passed.
    fn judge(self, results: &Results, condition: &Condition, sample: &Sample) -> Option<bool> {
        let value = |name| sample.values[results.index(name)];
        let passed = match self {
            Is(quantity) => value(quantity) == Some(1.0),
            Tracks => value("velocity_error_m_s").is_some_and(|error| error <= ERROR_BOUND_M_S),
            Yields => {
                let Scenario::Leash(_) = condition.scenario else { return None };
                let commanded = condition.scenario.task().compliance?;
                let near = |measured: f64| (measured / commanded - 1.0).abs() <= COMPLIANCE_TOLERANCE;
                value("compliance_m_s_per_n").is_some_and(near)
            }
        };
        Some(passed && matches!(sample.end, TrialEnd::Upright))
    }
}

/// A discipline of the examination.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Discipline {
    /// The name, for people and as a key.
    pub name: &'static str,
    /// A description of the trials and of a passed one.
    pub description: &'static str,
    /// The experiments by name, with their [`Way`] and the rule by which a trial is passed.
    parts: &'static [(&'static str, Way, Pass)],
}

/// The robot is across the obstacles.
const CROSSED: Pass = Is("crossed");

/// The robot does not fall.
const SUCCESS: Pass = Is("success");

/// All disciplines in the order of the page.
pub const DISCIPLINES: &[Discipline] = &[
    Discipline {
        name: "tracking",
        description: "16 commands, and 0.5 m/s with 5 kg on the trunk: velocity error of at most 0.1 m/s, no fall; turning is not judged",
        parts: &[("walk", Nominal, Tracks)],
    },
    Discipline {
        name: "pushes",
        description: "velocity offsets up to ± 1.5 m/s forward and sideways: no fall",
        parts: &[("push-grid", Nominal, SUCCESS)],
    },
    Discipline {
        name: "pulls",
        description: "20, 40 and 60 N for 5 s from 12 sides: no fall",
        parts: &[("pull", Nominal, Is("survived"))],
    },
    Discipline {
        name: "obstacles",
        description: "ball pit, loose blocks and mats: gets across",
        parts: &[("ball-pit", Nominal, CROSSED), ("rubble", Nominal, CROSSED)],
    },
    Discipline {
        name: "ground",
        description: "uneven ground of 5 and 10 cm, hills of 20 %: no fall",
        parts: &[("terrain", Nominal, SUCCESS), ("outdoor", Nominal, SUCCESS)],
    },
    Discipline {
        name: "sensors",
        description: "tracking and obstacles with the state estimated from noisy sensors",
        parts: &[("walk", Sensors, Tracks), ("ball-pit", Sensors, CROSSED), ("rubble", Sensors, CROSSED)],
    },
    Discipline {
        name: "joint losses",
        description: "tracking, many more pushes and loose blocks with realistic friction and damping in the joints",
        parts: &[("walk", Losses, Tracks), ("push-grid", Losses, SUCCESS), ("rubble", Losses, CROSSED)],
    },
    Discipline {
        name: "compliance",
        description: "0.01, 0.03 and 0.05 m/s/N commanded: measured within 25 %, walking and standing",
        parts: &[("calibration", Nominal, Yields)],
    },
];

/// The number of passed trials of one policy in one discipline.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Score {
    /// The number of trials that count.
    pub trials: usize,
    /// The number of passed trials.
    pub passed: usize,
    /// The number of falls.
    pub falls: usize,
    /// The number of trials in which the policy, the physics or the sensors failed.
    pub faults: usize,
    /// The number of trials that were not played, because the policy does not support their commanded compliance.
    pub out_of_reach: usize,
}

impl Score {
    /// Adds the trials of a set in one experiment.
    fn add(&mut self, results: &Results, set: usize, pass: Pass) {
        let of_policy = |policy| results.conditions.iter().zip::<&PolicyResult>(policy);
        for (condition, samples) in results.sets[set].values().flat_map(of_policy) {
            for sample in samples {
                let Some(passed) = pass.judge(results, condition, sample) else { continue };
                self.trials += 1;
                self.passed += usize::from(passed);
                self.falls += usize::from(sample.end == TrialEnd::Fell);
                self.faults += usize::from(sample.end == TrialEnd::Fault);
                self.out_of_reach += usize::from(sample.end == TrialEnd::OutOfReach);
            }
        }
    }

    /// Returns the fraction of passed trials; none if there are none, or the policy supports none of them.
    pub fn fraction(self) -> Option<f64> {
        (self.out_of_reach < self.trials).then(|| self.passed as f64 / self.trials as f64)
    }

    /// Returns the lower and the upper end of Wilson's 95 % interval of the fraction.
    pub fn interval(self) -> [f64; 2] {
        let (n, z) = (self.trials.max(1) as f64, 1.96);
        let p = self.passed as f64 / n;
        let (middle, half) = (p + z * z / (2.0 * n), z * (p * (1.0 - p) / n + z * z / (4.0 * n * n)).sqrt());
        [middle - half, middle + half].map(|end| (end / (1.0 + z * z / n)).clamp(0.0, 1.0))
    }
}

/// The scores of all policies in one discipline.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Grade {
    /// The discipline's name.
    pub discipline: &'static str,
    /// The scores by policy: the examined one first.
    pub scores: Vec<Score>,
}

/// The result of an examination.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Examination {
    /// The names of the policies: the examined one first.
    pub names: Vec<String>,
    /// The command line that repeats the examination.
    pub command: String,
    /// The robot of the examined policy.
    pub robot: String,
    /// How the policies were trained.
    pub training: Vec<Training>,
    /// The grades in the order of the disciplines.
    pub grades: Vec<Grade>,
    /// The numbers in the order of the measures.
    pub measures: Vec<Measured>,
    /// Notes about the policies, and about disciplines that were not played.
    pub notes: Vec<String>,
    /// The faults in the trials, which count as not passed.
    pub faults: Vec<String>,
}

/// An experiment of the examination, with the policies that play it and the state that they act on.
pub struct Part<'a> {
    /// The experiment.
    pub experiment: &'a dyn Experiment,
    /// The policies, the examined one first.
    pub policies: &'a [PolicySet],
    /// The state that the policies act on.
    pub sensing: Sensing,
    /// How the robots are played, for the names of jobs; empty on the true state.
    pub way: &'static str,
}

impl Part<'_> {
    /// Returns the results; none if some are not measured yet.
    fn results(&self, store: &MeasurementStore) -> Result<Option<Results>, RunError> {
        Ok(runner::finished(self.experiment, self.policies, store, self.sensing)?.map(|found| found.results))
    }
}

/// An examination: the policies and the protocol.
#[derive(Debug)]
pub struct Exam {
    /// Notes about the policies, and about disciplines that are not played.
    pub notes: Vec<String>,
    protocol: Protocol,
    /// The same protocol for robots that act on the true state, with one undisturbed walk at each command.
    of_true_state: Protocol,
    nominal: PolicySets,
    /// The same policies on robots whose joints have losses.
    with_losses: PolicySets,
    /// True if the physics of all policies have the rate of the contact network, so that the robots can act on their sensors.
    can_sense: bool,
}

impl Exam {
    /// Reads the examined policy, whose path has the form of a set's, and the shipped references for its robot.
    ///
    /// # Errors
    /// The policy cannot be read, commands a compliance that it does not support, or the path stands for several policies.
    pub fn new(name: &str, policy: &Path, protocol: Protocol) -> Result<Self, PolicySetError> {
        let own = (name.to_owned(), policy.to_owned());
        let alone = PolicySets::from_paths(std::slice::from_ref(&own))?;
        let members = &alone.sets[0].members;
        let [member] = &members[..] else {
            return Err(PolicySetError::Several(policy.to_owned(), members.len(), members[0].file.clone()));
        };
        let model = member.agent.config.robot.model.as_str();
        let folder = if model == "go2" { "go2/" } else { "" };
        let foreign =
            (!["go1", "go2"].contains(&model)).then(|| format!("{name} is for {model}, the others for a Go1"));
        let reference = |kind: &str| (format!("{folder}{kind}"), PathBuf::from(format!("{folder}{kind}-seed0")));
        let sets = [own, reference("compliant"), reference("baseline")];
        let mut with_losses = PolicySets::from_paths(&sets)?;
        with_losses.set_losses(JointLosses::Realistic.into());
        let nominal = PolicySets::from_paths(&sets)?;
        let cannot_sense =
            PolicySet::cannot_sense(&nominal.sets).map(|rates| format!("no policy is graded on sensors: {rates}"));
        let can_sense = cannot_sense.is_none();
        let of_gaits = || {
            // Without a network the trials on sensors fail, with the reason.
            let members = nominal.members().map(|(set, member)| (set.name.clone(), member.agent.sha256.as_str()));
            ContactNetwork::shipped().ok()?.unfamiliar(members)
        };
        let notes = nominal.notes.iter().cloned().chain(foreign).chain(cannot_sense.or_else(of_gaits)).collect();
        let mut of_true_state = protocol.clone();
        of_true_state.walk.trials = 1;
        Ok(Exam { notes, protocol, of_true_state, nominal, with_losses, can_sense })
    }

    /// Returns the parts of a discipline that can be played.
    fn playable(&self, discipline: &Discipline) -> impl Iterator<Item = &'static (&'static str, Way, Pass)> + use<> {
        let can_sense = self.can_sense;
        discipline.parts.iter().filter(move |(_, way, _)| can_sense || *way != Sensors)
    }

    /// Returns all experiments to play, each once, with their policies and the state that these act on.
    pub fn parts(&self) -> Vec<Part<'_>> {
        let parts =
            DISCIPLINES.iter().flat_map(|discipline| self.playable(discipline)).map(|(name, way, _)| (*name, *way));
        let parts = parts.chain(MEASURES.iter().map(|measure| (measure.experiment, Nominal)));
        let each: BTreeMap<_, _> = parts.map(|(name, way)| ((name, way), self.part(name, way))).collect();
        each.into_values().collect()
    }

    fn part(&self, name: &str, way: Way) -> Part<'_> {
        let protocol = if way == Sensors { &self.protocol } else { &self.of_true_state };
        let experiment = protocol.experiments().into_iter().find(|experiment| experiment.info().name == name);
        // A test grades every discipline.
        let experiment = experiment.unwrap_or_else(|| panic!("no experiment {name}"));
        let policies = if way == Losses { &self.with_losses.sets } else { &self.nominal.sets };
        let (sensing, way) = match way {
            Nominal => (Sensing::True, ""),
            Sensors => (Sensing::Estimated, ON_SENSORS),
            Losses => (Sensing::True, " with joint losses"),
        };
        Part { experiment, policies, sensing, way }
    }

    /// Grades all policies from the kept measurements; a discipline that was not measured has no trials. `command` is the command
    /// line that repeats the examination.
    ///
    /// # Errors
    /// A scenario file inside the program is invalid, which a test rules out.
    pub fn grade(&self, store: &MeasurementStore, command: String) -> Result<Examination, RunError> {
        let names = self.nominal.names();
        let mut grades = Vec::new();
        for discipline in DISCIPLINES {
            let mut scores = vec![Score::default(); names.len()];
            for (name, way, pass) in self.playable(discipline) {
                let Some(results) = self.part(name, *way).results(store)? else { continue };
                for (set, score) in scores.iter_mut().enumerate() {
                    score.add(&results, set, *pass);
                }
            }
            grades.push(Grade { discipline: discipline.name, scores });
        }
        let mut measures = Vec::new();
        for measure in MEASURES {
            let found = self.part(measure.experiment, Nominal).results(store)?;
            measures.extend(found.map(|results| measure.means(&results)));
        }
        let mut faults = Vec::new();
        for part in self.parts() {
            let Some(results) = part.results(store)? else { continue };
            let of_set = |set| Some(format!("{}{}: {}", part.experiment.info().name, part.way, results.faults(set)?));
            faults.extend((0..names.len()).filter_map(of_set));
        }
        let (training, notes) = (self.nominal.training(), self.notes.clone());
        let robot = self.nominal.sets[0].members[0].agent.config.robot.model.clone();
        Ok(Examination { names, command, robot, training, grades, measures, notes, faults })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_wilsons() {
        // p = 0.9, n = 10, z = 1.96: centre (0.9 + 3.8416/20) / 1.38416, half width 1.96 √(0.009 + 3.8416/400) / 1.38416.
        let [low, high] = Score { trials: 10, passed: 9, ..Score::default() }.interval();
        assert!((low - 0.59586).abs() < 1e-4 && (high - 0.98213).abs() < 1e-4, "{low} {high}");
        let [low, high] = Score { trials: 20, passed: 20, ..Score::default() }.interval();
        assert!((low - 0.83888).abs() < 1e-4 && (high - 1.0).abs() < 1e-12, "{low} {high}");
    }

    /// Returns the results of an experiment of the protocol with one sample in one condition.
    fn judged(
        (name, condition): (&str, usize),
        pass: Pass,
        end: TrialEnd,
        (quantity, value): (&str, Option<f64>),
    ) -> Option<bool> {
        let protocol = Protocol::exam(None).unwrap();
        let experiment = protocol.experiments().into_iter().find(|experiment| experiment.info().name == name).unwrap();
        let (conditions, quantities) = (experiment.conditions().unwrap(), experiment.info().quantities);
        let results = Results { names: vec![], conditions, quantities, sets: vec![] };
        let mut values = vec![None; quantities.len()];
        values[results.index(quantity)] = value;
        let sample = Sample::new(end, values);
        pass.judge(&results, &results.conditions[condition], &sample)
    }

    #[test]
    fn trials_are_passed_by_their_own_rule() {
        let walk = |error| judged(("walk", 0), Tracks, TrialEnd::Upright, ("velocity_error_m_s", error));
        assert_eq!([walk(Some(0.1)), walk(Some(0.11)), walk(None)], [Some(true), Some(false), Some(false)]);
        let pit = |end| judged(("ball-pit", 0), CROSSED, end, ("crossed", Some(1.0)));
        let ends = [TrialEnd::Upright, TrialEnd::Fell, TrialEnd::Fault];
        assert_eq!(ends.map(pit), [Some(true), Some(false), Some(false)]);
        // The first condition commands 0.01 m/s/N and pulls; the last one pushes.
        let yields = |condition, end, measured| {
            judged(("calibration", condition), Yields, end, ("compliance_m_s_per_n", Some(measured)))
        };
        assert_eq!(yields(0, TrialEnd::Upright, 0.0124), Some(true));
        assert_eq!(yields(0, TrialEnd::Upright, 0.0126), Some(false));
        assert_eq!(yields(0, TrialEnd::OutOfReach, 0.01), Some(false));
        let last = Protocol::exam(None).unwrap().calibration.conditions().unwrap().len() - 1;
        assert_eq!(yields(last, TrialEnd::Upright, 0.05), None);
    }

    #[test]
    fn unsupported_compliance_has_no_score() {
        let score = Score { trials: 4, out_of_reach: 4, ..Score::default() };
        assert_eq!((score.fraction(), page::score_text(score)), (None, "–".to_owned()));
        assert_eq!(page::score_text(Score { trials: 10, passed: 9, ..Score::default() }), "90 % [60, 98]");
    }

    #[test]
    fn references_are_of_the_same_robot_and_seed() {
        let exam = Exam::new("mine", Path::new("go2/baseline-seed1"), Protocol::exam(None).unwrap()).unwrap();
        assert_eq!(exam.nominal.names(), ["mine", "go2/compliant", "go2/baseline"]);
        let seeds: Vec<u64> = exam.nominal.members().map(|(_, member)| member.seed).collect();
        assert_eq!(seeds, [1, 1, 1]);
        // Eight and five more for the numbers on the true state, three on sensors, three with losses.
        let parts = exam.parts();
        let (sensors, all) = (parts.iter().filter(|part| part.sensing == Sensing::Estimated).count(), parts.len());
        assert_eq!((sensors, all), (3, 19));
        // Nothing is random in a walk on the true state, without or with losses; on sensors there is noise.
        let walks = parts.iter().filter(|part| part.experiment.info().name == "walk");
        let trials: Vec<_> = walks.map(|part| (part.sensing, part.experiment.info().trials)).collect();
        assert_eq!(trials, [(Sensing::True, 1), (Sensing::Estimated, 4), (Sensing::True, 1)]);
    }

    #[test]
    fn policy_of_another_rate_is_graded_in_all_but_sensors() {
        let folder = tempfile::tempdir().unwrap();
        let [policy, network] = ["mine.yaml", "policy.onnx"].map(|name| folder.path().join(name));
        let repository = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        std::fs::copy(repository.join("examples/policies/rsl_rl.yaml"), &policy).unwrap();
        std::fs::copy(repository.join("tests/fixtures/onnx/rsl_rl.onnx"), network).unwrap();
        let exam = Exam::new("mine", &policy, Protocol::exam(None).unwrap()).unwrap();
        let parts = exam.parts();
        assert!(parts.len() == 16 && parts.iter().all(|part| part.sensing == Sensing::True));
        let examination = exam.grade(&MeasurementStore::new(folder.path()), String::new()).unwrap();
        let words = "no policy is graded on sensors: the physics of mine run at 200 Hz, the contact network at 240 Hz";
        assert!(examination.notes.iter().any(|note| note == words), "{:?}", examination.notes);
        assert_eq!((page::score_text(examination.grades[5].scores[0]), examination.faults), ("–".to_owned(), vec![]));
    }

    #[test]
    fn several_policies_are_no_candidate() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../policies/baseline");
        let error = Exam::new("mine", &path, Protocol::exam(None).unwrap()).unwrap_err().to_string();
        assert!(error.contains("policies/baseline stands for 5 policies, expected one, such as "), "{error}");
        assert!(error.ends_with("policies/baseline-seed0.safetensors"), "{error}");
    }
}
