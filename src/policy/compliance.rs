/*! Compliance control: a policy that tracks a velocity is calibrated once, and then its compliance can be commanded.

The virtual mass of [`crate::task::compliance`] is put around the policy. The calibration has the policy's own compliance, and the measured
compliance for each commanded one that it supports.
*/

use std::ffi::OsStr;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::Agent;
use super::controller::Controller;
use crate::config::Config;
use crate::observation::Command;
use crate::robot::{Joints, RobotState};
use crate::task::VirtualMass;
use crate::util::files::{self, FileError};

/// The measured response of a policy to pulls.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyCalibration {
    /// SHA-256 of the policy's files, which identifies it.
    pub sha256: String,
    /// Mass of the robot that it was measured on \[kg\].
    pub mass_kg: f64,
    /// Own compliance of the policy, `C₀`, forward and left [m/s/N]; negative if it moves against a pull.
    pub own_m_s_per_n: [f64; 2],
    /// Change of the policy's velocity per change of the commanded one, forward and left.
    pub tracking: [f64; 2],
    /// The measured compliance for some commanded ones, increasing; the first and the last bound what can be commanded.
    pub points: Vec<Point>,
}

/// A commanded compliance and the compliance measured with it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Point {
    /// Commanded compliance [m/s/N].
    pub commanded: f64,
    /// Measured compliance, forward and left [m/s/N].
    pub measured: [f64; 2],
}

/// The reason why a commanded compliance is refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ComplianceError {
    /// The commanded compliance is out of the policy's range.
    #[error("compliance {found} m/s/N is out of range: this policy supports {low:.4} to {high:.4} m/s/N")]
    OutOfReach {
        /// The commanded compliance [m/s/N].
        found: f64,
        /// The smallest compliance that the policy supports [m/s/N].
        low: f64,
        /// The largest compliance that the policy supports [m/s/N].
        high: f64,
    },
    /// The policy does not observe the velocity command, which compliance control changes.
    #[error("compliance control needs '{0}', which this policy does not observe")]
    NotSeen(String),
    /// The policy has not been calibrated.
    #[error("its compliance has not been measured: run `policy calibrate` with it first")]
    NotCalibrated,
}

/// The reason why a calibration is refused.
#[derive(Debug, thiserror::Error)]
pub(crate) enum CalibrationFault {
    #[error("{0}: run `policy calibrate` again")]
    Json(#[from] serde_json::Error),
    #[error("it is of another policy: run `policy calibrate` again")]
    OtherPolicy,
    #[error("expected two points or more, rising, and positive numbers: run `policy calibrate` again")]
    Values,
    #[error("its {key} has {found:?}, expected {expected}: run `policy calibrate` again")]
    Range { key: &'static str, found: f64, expected: &'static str },
}

/// Splits `baseline@0.03` into the policy's name and the commanded compliance [m/s/N], if there is one. The path of a file or
/// folder that exists is not split.
pub fn split_compliance(name: &str) -> (&str, Option<f64>) {
    if PathBuf::from(name).exists() {
        return (name, None);
    }
    let split = name.rsplit_once('@').and_then(|(name, number)| Some((name, Some(number.parse().ok()?))));
    split.unwrap_or((name, None))
}

/// Returns the name that people read for a policy: that of its file without folder and extension, and the commanded compliance as
/// it was given.
pub fn policy_label(asked: &str) -> String {
    let (file, _) = split_compliance(asked);
    // Other dots are no extension, as in the run `runs/rate-0.001-seed0`.
    let is_file = [".safetensors", ".yaml", ".yml", ".onnx"].iter().any(|end| file.ends_with(end));
    let stem = if is_file { Path::file_stem } else { Path::file_name }(Path::new(file));
    stem.map_or_else(|| file.into(), OsStr::to_string_lossy).into_owned() + &asked[file.len()..]
}

/// Name of the file type in error messages.
const WHAT: &str = "calibration";

/// Maximum size of a calibration \[bytes\].
const MAX_BYTES: u64 = 64 << 10;

impl PolicyCalibration {
    /// Returns the path of a policy's calibration, `NAME.calibration.json`.
    pub fn path(policy: &Path) -> PathBuf {
        policy.with_extension("calibration.json")
    }

    /// Reads the calibration next to a policy file, if there is one; `None` if it was measured with another version of
    /// the policy.
    pub(crate) fn load_for(policy: &Path, sha256: &str) -> Result<Option<Self>, FileError> {
        let path = Self::path(policy);
        match files::read_bounded(&path, MAX_BYTES) {
            Ok(bytes) => {
                let found = Self::parse(&bytes, &path)?;
                if found.sha256 != sha256 {
                    return Ok(None);
                }
                found.checked(sha256).map(Some).map_err(FileError::of(WHAT, &path))
            }
            Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
            Err(error) => Err(FileError::of(WHAT, &path)(error)),
        }
    }

    /// Parses and checks a calibration.
    pub(crate) fn from_json(path: &Path, text: &str, sha256: &str) -> Result<Self, FileError> {
        let found = Self::parse(text.as_bytes(), path)?;
        found.checked(sha256).map_err(FileError::of(WHAT, path))
    }

    fn parse(bytes: &[u8], path: &Path) -> Result<Self, FileError> {
        serde_json::from_slice(bytes).map_err(CalibrationFault::from).map_err(FileError::of(WHAT, path))
    }

    /// Returns `self` if it belongs to this policy and its values are valid.
    pub(crate) fn checked(self, sha256: &str) -> Result<Self, CalibrationFault> {
        let points = &self.points;
        let numbers = points.iter().flat_map(|point| [point.commanded].into_iter().chain(point.measured));
        ensure!(self.sha256 == sha256, CalibrationFault::OtherPolicy);
        let rising = points.windows(2).all(|pair| pair[1].commanded > pair[0].commanded);
        let positive = numbers.chain([self.mass_kg]).all(|it| it.is_finite() && it > 0.0);
        ensure!(points.len() >= 2 && rising && positive, CalibrationFault::Values);
        for (key, values, limits, expected) in [
            ("own_m_s_per_n", self.own_m_s_per_n, -1.0..=1.0, "-1 to 1 m/s/N"),
            ("tracking", self.tracking, 0.5..=1.5, "0.5 to 1.5"),
        ] {
            if let Some(found) = values.into_iter().find(|value| !limits.contains(value)) {
                return Err(CalibrationFault::Range { key, found, expected });
            }
        }
        Ok(self)
    }

    /// Returns the virtual mass for the rates and commands of the policy's configuration.
    fn virtual_mass(&self, config: &Config) -> VirtualMass {
        let (own_m_s_per_n, limits_m_s) = (self.own_m_s_per_n, [config.command.forward_m_s, config.command.left_m_s]);
        let period_s = config.simulation.policy_period_s();
        VirtualMass { mass_kg: self.mass_kg, own_m_s_per_n, tracking: self.tracking, limits_m_s, period_s }
    }

    /// Returns the smallest and the largest compliance that can be commanded [m/s/N].
    pub fn range(&self) -> [f64; 2] {
        [self.points.first(), self.points.last()].map(|point| point.map_or(0.0, |point| point.commanded))
    }

    /// Checks that a commanded compliance [m/s/N] is in the policy's range.
    ///
    /// # Errors
    /// The compliance is out of the policy's range.
    pub fn check(&self, compliance: f64) -> Result<(), ComplianceError> {
        check_range(self.range(), compliance)
    }
}

/// Checks that a commanded compliance [m/s/N] is in a range.
pub(super) fn check_range([low, high]: [f64; 2], found: f64) -> Result<(), ComplianceError> {
    if (low..=high).contains(&found) { Ok(()) } else { Err(ComplianceError::OutOfReach { found, low, high }) }
}

/// The virtual mass on raw observations, for programs that run the policy themselves: it changes the command in them.
#[derive(Debug)]
pub struct CompliantObservations {
    mass: VirtualMass,
    change: [f64; 2],
    compliance: f64,
    /// The indices of the command, forward and left, in the observation.
    command: [usize; 2],
}

impl CompliantObservations {
    /// Starts for a commanded compliance [m/s/N]; observations arrive at the policy's own rate.
    ///
    /// # Errors
    /// The policy has not been calibrated, does not observe its command, or the compliance is out of its range.
    pub fn new(agent: &Agent, compliance: f64) -> Result<Self, ComplianceError> {
        let calibration = agent.calibration.as_ref().ok_or(ComplianceError::NotCalibrated)?;
        calibration.check(compliance)?;
        let names = agent.inference().layout.names();
        let place = |name: &str| {
            let wanted = names.iter().position(|known| known == name);
            wanted.ok_or_else(|| ComplianceError::NotSeen(name.to_owned()))
        };
        Ok(CompliantObservations {
            mass: calibration.virtual_mass(&agent.config),
            change: [0.0; 2],
            compliance,
            command: [place("commanded forward [m/s]")?, place("commanded left [m/s]")?],
        })
    }

    /// Changes the command in an observation. `force` is what acts on the trunk from outside, forward and left, mean over the
    /// last policy step \[N\].
    pub fn apply(&mut self, observation: &mut [f64], force: [f64; 2]) {
        let [forward, left] = self.command.map(|place| observation[place]);
        let command =
            self.mass.command(force, &Command::velocity(forward, left, 0.0), self.compliance, &mut self.change);
        (observation[self.command[0]], observation[self.command[1]]) = (command.forward, command.left);
    }
}

/// A calibrated policy with the virtual mass that makes it yield as commanded.
pub(crate) struct CompliantController<'a> {
    policy: Box<dyn Controller + 'a>,
    mass: VirtualMass,
    change: [f64; 2],
}

impl<'a> CompliantController<'a> {
    /// Wraps a policy, for the rates and commands that it was trained with.
    pub fn new(policy: Box<dyn Controller + 'a>, calibration: &PolicyCalibration, config: &Config) -> Self {
        CompliantController { policy, mass: calibration.virtual_mass(config), change: [0.0; 2] }
    }
}

impl Controller for CompliantController<'_> {
    fn rest(&self) -> Joints {
        self.policy.rest()
    }

    fn begin(&mut self, state: &RobotState) {
        self.change = [0.0; 2];
        self.policy.begin(state);
    }

    fn joint_targets(&mut self, state: &RobotState, command: &Command) -> Joints {
        let Some(compliance) = command.compliance else {
            self.change = [0.0; 2];
            return self.policy.joint_targets(state, command);
        };
        // Without a trusted force, the change of the command fades.
        let force = state.felt_force.unwrap_or_default();
        let command = self.mass.command(force, command, compliance, &mut self.change);
        self.policy.joint_targets(state, &command)
    }

    fn needs_felt_force(&self) -> bool {
        self.policy.needs_felt_force()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_may_say_behind_an_at_which_compliance_it_is_told() {
        assert_eq!(split_compliance("policies/baseline@0.03"), ("policies/baseline", Some(0.03)));
        assert_eq!(split_compliance("runs@home/mine@-1"), ("runs@home/mine", Some(-1.0)));
        for no_compliance in ["policies/baseline", "runs@home/mine", "mine@"] {
            assert_eq!(split_compliance(no_compliance), (no_compliance, None));
        }
    }

    #[test]
    fn a_label_is_the_file_without_its_folder_and_with_the_compliance() {
        for (asked, label) in [
            ("policies/baseline-seed0.safetensors", "baseline-seed0"),
            ("baseline@0.03", "baseline@0.03"),
            ("policies/mine.yaml@0.03", "mine@0.03"),
            ("runs/fast-reward.energy=-0.01", "fast-reward.energy=-0.01"),
        ] {
            assert_eq!(policy_label(asked), label);
        }
    }

    const TEXT: &str = r#"{"sha256": "it", "mass_kg": 12.5, "own_m_s_per_n": [0.01, 0.02], "tracking": [0.8, 0.9],
        "points": [{"commanded": 0.005, "measured": [0.006, 0.007]}, {"commanded": 0.05, "measured": [0.048, 0.051]}]}"#;

    fn parsed(text: &str) -> Result<PolicyCalibration, FileError> {
        PolicyCalibration::from_json(Path::new("p.calibration.json"), text, "it")
    }

    #[test]
    fn a_policy_may_lean_against_what_it_feels() {
        assert_eq!(parsed(&TEXT.replacen("[0.01,", "[-0.002,", 1)).unwrap().own_m_s_per_n, [-0.002, 0.02]);
    }

    #[test]
    fn compliance_beyond_tried_ones_is_refused() {
        let calibration = parsed(TEXT).unwrap();
        assert!(calibration.check(0.005).is_ok() && calibration.check(0.05).is_ok());
        let beyond = ComplianceError::OutOfReach { found: 0.06, low: 0.005, high: 0.05 };
        assert_eq!(calibration.check(0.06), Err(beyond));
        assert!(calibration.check(0.0).is_err() && calibration.check(f64::NAN).is_err());
    }

    #[test]
    fn observations_get_the_command_of_the_controller() {
        let mut agent = crate::policy::shipped::find("compliant").unwrap();
        agent.calibration = Some(parsed(TEXT).unwrap());
        let mut compliant = CompliantObservations::new(&agent, 0.03).unwrap();
        let mut observation = vec![0.0; agent.inference().layout.length()];
        // As `policy show` has them: commanded left, forward, yaw rate.
        (observation[80], observation[81], observation[82]) = (0.0, 0.5, 0.25);
        compliant.apply(&mut observation, [-10.0, 0.0]);
        // Time constant 12.5 kg · (0.03 − 0.01) m/s/N = 0.25 s, a 60th of a second: 1 − e^(−1/15) of −0.2 m/s / 0.8.
        let forward = 0.5 - 0.25 * (1.0 - (-1.0_f64 / 15.0).exp());
        assert!((observation[81] - forward).abs() < 1e-12, "{}", observation[81]);
        assert_eq!((observation[80], observation[82]), (0.0, 0.25));
        assert!(CompliantObservations::new(&agent, 0.06).is_err());
    }

    #[test]
    fn calibration_of_an_earlier_training_state_does_not_count() {
        let folder = tempfile::tempdir().unwrap();
        let policy = folder.path().join("p.safetensors");
        let load = |sha256| PolicyCalibration::load_for(&policy, sha256).map(|found| found.is_some());
        assert!(!load("it").unwrap());
        std::fs::write(PolicyCalibration::path(&policy), TEXT).unwrap();
        assert!(load("it").unwrap() && !load("its successor").unwrap());
        std::fs::write(PolicyCalibration::path(&policy), TEXT.replace("0.048", "-0.048")).unwrap();
        assert!(load("it").is_err());
    }

    #[test]
    fn invalid_calibration_is_refused_by_name() {
        let other = PolicyCalibration::from_json(Path::new("p.calibration.json"), TEXT, "other");
        assert!(other.unwrap_err().to_string().contains("p.calibration.json"));
        for (from, to) in
            [("0.05,", "0.005,"), ("[0.01,", "[1e999,"), ("12.5", "1e999"), ("[0.006, 0.007]", "0.006"), ("12.5", "0")]
        {
            assert!(TEXT.contains(from), "{from}");
            assert!(parsed(&TEXT.replacen(from, to, 1)).is_err(), "{from} to {to}");
        }
        for (from, to, words) in [
            ("[0.8,", "[1e-300,", "its tracking has 1e-300, expected 0.5 to 1.5"),
            ("0.9]", "1.6]", "its tracking has 1.6, expected 0.5 to 1.5"),
            ("[0.01,", "[1e6,", "its own_m_s_per_n has 1000000.0, expected -1 to 1 m/s/N"),
        ] {
            let error = parsed(&TEXT.replacen(from, to, 1)).unwrap_err().to_string();
            assert!(error.contains(words), "{error}");
        }
        // A calibration of the former velocity loop.
        let old = r#"{"sha256": "it", "own_m_s_per_n": 0.01, "bias": [[0, 0, 0, 0], [0, 0, 0, 0]], "points": []}"#;
        assert!(parsed(old).unwrap_err().to_string().contains("run `policy calibrate` again"));
    }
}
