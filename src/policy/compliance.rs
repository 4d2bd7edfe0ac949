/*! Compliance control: a policy that tracks a velocity is calibrated once, and then its compliance can be commanded.

The outer loop of [`crate::task::compliance`] is put around the policy. The calibration maps its setting to the measured
compliance, and is inverted to find the setting that gives the commanded one.
*/

use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::Policy;
use super::controller::Controller;
use crate::config::Config;
use crate::observation::Command;
use crate::robot::{Joints, RobotState};
use crate::task::OuterLoop;
use crate::util::files::{self, FileError};
use crate::util::paths;

/// The measured response of a policy to pulls.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyCalibration {
    /// SHA-256 of the policy's files, which identifies it.
    pub sha256: String,
    /// Own compliance of the policy, `C₀` [m/s/N].
    pub own_m_s_per_n: f64,
    /// The velocity error of the undisturbed policy, forward and left [m/s], as a constant and the factors of the commanded
    /// forward [m/s], left [m/s] and yaw rate [rad/s].
    pub bias: [[f64; 4]; 2],
    /// The measured compliance for each setting of the outer loop; both columns increase.
    pub points: Vec<Point>,
}

/// A setting of the outer loop and the compliance measured with it.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Point {
    /// Setting `c` of the outer loop [m/s/N].
    pub setting: f64,
    /// Measured compliance, mean over directions of the pull [m/s/N].
    pub measured: f64,
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
    /// The policy does not observe a quantity that the outer loop needs.
    #[error(
        "compliance control needs '{name}', which this policy does not observe; run the outer loop in your own controller"
    )]
    NotSeen {
        /// Name of the quantity.
        name: String,
    },
    /// The policy has not been calibrated.
    #[error("how far it yields has not been measured: run `policy calibrate` with it first")]
    NotCalibrated,
}

/// Splits `baseline@0.03` into the policy's name and the commanded compliance [m/s/N], if there is one. The path of a file or
/// folder that exists is not split.
pub fn split_compliance(name: &str) -> (&str, Option<f64>) {
    if paths::as_path(name).exists() {
        return (name, None);
    }
    let split = name.rsplit_once('@').and_then(|(name, number)| Some((name, Some(number.parse().ok()?))));
    split.unwrap_or((name, None))
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
    ///
    /// # Errors
    /// The file cannot be read, or is not a valid calibration.
    pub fn load_for(policy: &Path, sha256: &str) -> Result<Option<Self>, FileError> {
        let path = Self::path(policy);
        match files::read_bounded(&path, MAX_BYTES) {
            Ok(bytes) => {
                let found: PolicyCalibration = serde_json::from_slice(&bytes).map_err(FileError::of(WHAT, &path))?;
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
    ///
    /// # Errors
    /// The text is not a calibration, its values are invalid, or it belongs to another policy.
    pub fn from_json(path: &Path, text: &str, sha256: &str) -> Result<Self, FileError> {
        let found: PolicyCalibration = serde_json::from_str(text).map_err(FileError::of(WHAT, path))?;
        found.checked(sha256).map_err(FileError::of(WHAT, path))
    }

    /// Returns `self` if it belongs to this policy and its values are valid.
    ///
    /// # Errors
    /// The calibration belongs to another policy, or its values are invalid; the text says what to do.
    pub fn checked(self, sha256: &str) -> Result<Self, &'static str> {
        let points = &self.points;
        let numbers = points.iter().flat_map(|point| [point.setting, point.measured]).chain([self.own_m_s_per_n]);
        if self.sha256 != sha256 {
            return Err("it is of another policy: run `policy calibrate` again");
        }
        let rising =
            points.windows(2).all(|pair| pair[1].measured > pair[0].measured && pair[1].setting > pair[0].setting);
        let finite = numbers.chain(self.bias.into_iter().flatten()).all(f64::is_finite);
        if points.len() < 2 || !rising || !finite || self.own_m_s_per_n < 0.0 {
            return Err("expected two points or more, rising, and finite numbers: run `policy calibrate` again");
        }
        Ok(self)
    }

    /// Identity calibration, used while measuring: assumes setting = compliance.
    pub fn unmeasured(sha256: &str) -> Self {
        let points = [0.0, 1.0].map(|setting| Point { setting, measured: setting }).to_vec();
        PolicyCalibration { sha256: sha256.to_owned(), own_m_s_per_n: 0.0, bias: [[0.0; 4]; 2], points }
    }

    /// Returns the smallest and the largest compliance that the policy supports [m/s/N].
    pub fn range(&self) -> [f64; 2] {
        let measured = |point: Option<&Point>| point.map_or(0.0, |point| point.measured);
        [measured(self.points.first()), measured(self.points.last())]
    }

    /// Checks that a commanded compliance [m/s/N] is in the policy's range.
    ///
    /// # Errors
    /// The compliance is out of the policy's range.
    pub fn check(&self, compliance: f64) -> Result<(), ComplianceError> {
        let [low, high] = self.range();
        let within = (low..=high).contains(&compliance);
        if within { Ok(()) } else { Err(ComplianceError::OutOfReach { found: compliance, low, high }) }
    }

    /// Returns the setting whose compliance is nearest to the commanded one [m/s/N].
    fn nearest_setting(&self, compliance: f64) -> f64 {
        let [low, high] = self.range();
        let wanted = compliance.clamp(low, high);
        let between = |pair: &[Point]| {
            let part = (wanted - pair[0].measured) / (pair[1].measured - pair[0].measured);
            (0.0..=1.0).contains(&part).then_some(pair[0].setting + part * (pair[1].setting - pair[0].setting))
        };
        self.points.windows(2).find_map(between).unwrap_or(compliance)
    }

    /// Returns the velocity error of the undisturbed policy, forward and left [m/s].
    fn bias(&self, command: &Command) -> [f64; 2] {
        let of = |[constant, forward, left, yaw]: [f64; 4]| {
            constant + forward * command.forward + left * command.left + yaw * command.yaw
        };
        self.bias.map(of)
    }
}

/// The outer loop of a calibrated policy, with its state.
#[derive(Debug)]
struct CalibratedLoop {
    calibration: PolicyCalibration,
    outer_loop: OuterLoop,
    /// State of the loop's low-pass, forward and left, base frame [m/s].
    low_pass: [f64; 2],
}

impl CalibratedLoop {
    /// Creates the loop for the rates and commands that the policy was trained with.
    fn new(calibration: PolicyCalibration, config: &Config) -> Self {
        let outer_loop = OuterLoop::new(config, calibration.own_m_s_per_n);
        CalibratedLoop { calibration, outer_loop, low_pass: [0.0; 2] }
    }

    /// Returns the command that gives a policy, walking at `velocity` (forward and left [m/s]), this compliance [m/s/N].
    fn command(&mut self, velocity: [f64; 2], command: &Command, compliance: f64) -> Command {
        let setting = self.calibration.nearest_setting(compliance);
        self.outer_loop.command(velocity, command, setting, self.calibration.bias(command), &mut self.low_pass)
    }
}

/// The outer loop on raw observations, for programs that run the policy themselves: it replaces
/// the command in an observation.
#[derive(Debug)]
pub struct ObservationOuterLoop {
    outer_loop: CalibratedLoop,
    compliance: f64,
    /// The indices of velocity (forward, left) and command (forward, left, yaw) in the observation.
    velocity: [usize; 2],
    command: [usize; 3],
}

impl ObservationOuterLoop {
    /// Creates the loop for a commanded compliance [m/s/N]; observations arrive at the policy's own rate.
    ///
    /// # Errors
    /// The policy does not observe velocity and command, or the compliance is out of its range.
    pub fn new(policy: &Policy, calibration: PolicyCalibration, compliance: f64) -> Result<Self, ComplianceError> {
        calibration.check(compliance)?;
        let names = policy.layout().names();
        let place = |name: &str| {
            let wanted = names.iter().position(|known| known == name);
            wanted.ok_or_else(|| ComplianceError::NotSeen { name: name.to_owned() })
        };
        Ok(ObservationOuterLoop {
            outer_loop: CalibratedLoop::new(calibration, &policy.provenance.config),
            compliance,
            velocity: [place("velocity forward [m/s]")?, place("velocity left [m/s]")?],
            command: [
                place("commanded forward [m/s]")?,
                place("commanded left [m/s]")?,
                place("commanded yaw rate [rad/s]")?,
            ],
        })
    }

    /// Replaces the command in an observation with the next one of the outer loop.
    pub fn apply(&mut self, observation: &mut [f64]) {
        let [forward, left, yaw] = self.command.map(|place| observation[place]);
        let command = Command::velocity(forward, left, yaw);
        let velocity = self.velocity.map(|place| observation[place]);
        let command = self.outer_loop.command(velocity, &command, self.compliance);
        (observation[self.command[0]], observation[self.command[1]]) = (command.forward, command.left);
    }
}

/// A calibrated policy with the outer loop that makes it yield as commanded.
pub struct CompliantController<'a> {
    policy: Box<dyn Controller + 'a>,
    outer_loop: CalibratedLoop,
}

impl<'a> CompliantController<'a> {
    /// Wraps a policy in an outer loop, for the rates and commands that it was trained with.
    pub fn new(policy: Box<dyn Controller + 'a>, calibration: PolicyCalibration, config: &Config) -> Self {
        CompliantController { policy, outer_loop: CalibratedLoop::new(calibration, config) }
    }
}

impl Controller for CompliantController<'_> {
    fn rest(&self) -> Joints {
        self.policy.rest()
    }

    fn begin(&mut self, state: &RobotState) {
        self.outer_loop.low_pass = [0.0; 2];
        self.policy.begin(state);
    }

    fn joint_targets(&mut self, state: &RobotState, command: &Command) -> Joints {
        let Some(compliance) = command.compliance else {
            return self.policy.joint_targets(state, command);
        };
        let velocity = [state.velocity_in_base.x, state.velocity_in_base.y];
        let command = self.outer_loop.command(velocity, command, compliance);
        self.policy.joint_targets(state, &command)
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

    const TEXT: &str = r#"{"sha256": "it", "own_m_s_per_n": 0.01, "bias": [[0.1, 0.5, 0, 0], [0, 0, 0, 2]],
        "points": [{"setting": 0.005, "measured": 0.006}, {"setting": 0.02, "measured": 0.018}]}"#;

    fn parsed(text: &str) -> Result<PolicyCalibration, FileError> {
        PolicyCalibration::from_json(Path::new("p.calibration.json"), text, "it")
    }

    #[test]
    fn a_setting_is_found_between_those_that_were_measured() {
        let calibration = parsed(TEXT).unwrap();
        // A quarter of the way from 0.006 to 0.018.
        assert!((calibration.nearest_setting(0.009) - 0.00875).abs() < 1e-12);
        assert_eq!(calibration.nearest_setting(1.0), 0.02);
        assert!(calibration.check(0.018).is_ok() && calibration.check(0.0).is_err());
        let beyond = ComplianceError::OutOfReach { found: 0.019, low: 0.006, high: 0.018 };
        assert_eq!(calibration.check(0.019), Err(beyond));
        let bias = calibration.bias(&Command::velocity(0.4, 0.0, 0.25));
        assert!((bias[0] - 0.3).abs() < 1e-12 && (bias[1] - 0.5).abs() < 1e-12);
    }

    #[test]
    fn who_runs_a_policy_on_observations_leads_it_as_the_controller_does() {
        let policy = crate::policy::shipped::find_ours("compliant").unwrap();
        // C₀ is half of what is commanded; off by 0.1 m/s forward as always, and −0.2 m/s to the left by a hand.
        let calibration = PolicyCalibration { bias: [[0.1, 0.0, 0.0, 0.0], [0.0; 4]], ..parsed(TEXT).unwrap() };
        let point = |c| Point { setting: c, measured: c };
        let calibration = PolicyCalibration { points: vec![point(0.005), point(0.03)], ..calibration };
        let mut outer_loop = ObservationOuterLoop::new(&policy, calibration.clone(), 0.02).unwrap();
        let mut observation = vec![0.0; policy.layout().length()];
        // As `policy show` has them: velocity left, up, forward; commanded left, forward, yaw rate.
        (observation[62], observation[64]) = (-0.2, 0.6);
        (observation[80], observation[81], observation[82]) = (0.0, 0.5, 0.25);
        let before = observation.clone();
        outer_loop.apply(&mut observation);
        // A 60th of a second of a low-pass of 0.1 s: 1 − e^(−1/6).
        let asked = -0.5 * (1.0 - (-1.0_f64 / 6.0).exp()) * 0.2;
        assert!(
            (observation[80] - asked).abs() < 1e-12 && (observation[81] - 0.5).abs() < 1e-12,
            "{}",
            observation[80]
        );
        observation[80..82].copy_from_slice(&before[80..82]);
        assert_eq!(observation, before);
        assert!(ObservationOuterLoop::new(&policy, calibration, 0.04).is_err());
    }

    #[test]
    fn what_lies_beside_a_policy_that_was_trained_on_does_not_count() {
        let folder = tempfile::tempdir().unwrap();
        let policy = folder.path().join("p.safetensors");
        let beside = |sha256| PolicyCalibration::load_for(&policy, sha256).map(|found| found.is_some());
        assert!(!beside("it").unwrap());
        std::fs::write(PolicyCalibration::path(&policy), TEXT).unwrap();
        assert!(beside("it").unwrap() && !beside("its successor").unwrap());
        std::fs::write(PolicyCalibration::path(&policy), TEXT.replace("0.018", "0.006")).unwrap();
        assert!(beside("it").is_err());
    }

    #[test]
    fn a_calibration_of_another_policy_or_without_sense_is_refused() {
        let other = PolicyCalibration::from_json(Path::new("p.calibration.json"), TEXT, "other");
        assert!(other.unwrap_err().to_string().contains("p.calibration.json"));
        for (from, to) in
            [("0.018", "0.006"), ("0.02,", "0.005,"), ("0.01,", "-0.01,"), ("0.01,", "1e999,"), ("0.1,", "{},")]
        {
            assert!(TEXT.contains(from), "{from}");
            assert!(parsed(&TEXT.replacen(from, to, 1)).is_err(), "{from} to {to}");
        }
    }
}
