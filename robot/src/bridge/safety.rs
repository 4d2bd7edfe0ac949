/*! Faults that end in damping: limits on the robot's readings and on the policy's joint targets. A fault is latched until a person clears
it. */

use supple::robot::{JOINTS, Joints, joint_name};

use super::reading::Reading;

/// A reason for damping.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Fault {
    #[error("no state of the robot for {silent_ms:.0} ms, at most {limit_ms:.0} ms is allowed")]
    Silence { silent_ms: f64, limit_ms: f64 },
    #[error("the policy gave no command for {limit_ms:.0} ms: it hangs, or this computer is too slow")]
    PolicySilence { limit_ms: f64 },
    #[error("{what} is not a finite number")]
    NotFinite { what: String },
    #[error("the state cannot be estimated: {reason}")]
    Estimate { reason: String },
    #[error("the trunk is tilted by {found_deg:.0}°, at most {limit_deg:.0}° is allowed")]
    Tilt { found_deg: f64, limit_deg: f64 },
    #[error("{joint} turns at {found:+.1} rad/s, at most {limit:.1} rad/s is allowed")]
    JointRate { joint: String, found: f64, limit: f64 },
    #[error("{joint} is at {found:.2} rad, its range is {low:.2} to {high:.2} rad: its encoder is wrong")]
    JointRange { joint: String, found: f64, low: f64, high: f64 },
    #[error("{joint} has given {found:+.1} N m, close to its limit, for {for_s:.1} s")]
    Torque { joint: String, found: f64, for_s: f64 },
    #[error("the motor of {joint} is at {found} °C, at most {limit} °C is allowed: let it cool")]
    Temperature { joint: String, found: u8, limit: u8 },
    #[error("the battery is at {found} %, at least {limit} % is needed: charge it")]
    Battery { found: u8, limit: u8 },
    #[error("the policy's target of {joint} is {found:.2} rad, its range is {low:.2} to {high:.2} rad")]
    TargetRange { joint: String, found: f64, low: f64, high: f64 },
    #[error("the policy moves the target of {joint} by {found:+.2} rad in one step, at most {limit:.2} rad is allowed")]
    TargetStep { joint: String, found: f64, limit: f64 },
    #[error("the robot's clock went from {from_ms} ms to {to_ms} ms: it has restarted, or there are two robots")]
    Clock { from_ms: u32, to_ms: u32 },
    #[error("another program writes rt/lowcmd: stop it, or release the robot's own controller")]
    OtherWriter,
    #[error("the operator asked for it")]
    Asked,
}

/// Longest silence of the robot or of the policy \[s\].
pub const SILENCE_S: f64 = 0.1;
/// Largest tilt of the trunk \[rad\].
const TILT_RAD: f64 = 1.0;
/// Largest joint rate [rad/s]; a Go2's motors reach 30.
const JOINT_RATE_RAD_S: f64 = 35.0;
/// A joint angle farther than this out of its range cannot be true \[rad\].
const ANGLE_BEYOND_RAD: f64 = 0.5;
/// Fraction of the torque limit above which a motor works too hard, and the longest time above it \[s\].
const TORQUE_FRACTION: f64 = 0.95;
const TORQUE_S: f64 = 0.5;
/// Highest temperature of a motor \[°C\].
const TEMPERATURE_C: u8 = 85;
/// Least state of charge \[%\].
const CHARGE_PERCENT: u8 = 10;
/// A target out of the joint's range is limited to the range; farther out than this, it is a fault \[rad\].
const TARGET_BEYOND_RAD: f64 = 1.5;
/// Largest change of a joint target in a policy step \[rad\].
const TARGET_STEP_RAD: f64 = 2.5;

/// Watches one robot and one policy.
#[derive(Debug, Clone)]
pub struct Guard {
    /// False in replays of a log, where only numbers that are not finite are faults.
    pub is_strict: bool,
    joint_limits: [[f64; 2]; JOINTS],
    torque_limits: Joints,
    /// Time for which each motor has been close to its limit \[s\].
    straining_s: Joints,
}

impl Guard {
    /// Creates a guard for a robot with these joint ranges \[rad\] and torque limits [N·m].
    pub fn new(joint_limits: [[f64; 2]; JOINTS], torque_limits: Joints) -> Self {
        Guard { is_strict: true, joint_limits, torque_limits, straining_s: [0.0; JOINTS] }
    }

    /// Checks a reading, `dt_s` \[s\] after the last one; the fault is the first limit that is exceeded.
    pub fn check(&mut self, reading: &Reading, dt_s: f64) -> Result<(), Fault> {
        check_finite(reading)?;
        if !self.is_strict {
            return Ok(());
        }
        let tilt_rad = reading.tilt_rad();
        if tilt_rad > TILT_RAD {
            return Err(Fault::Tilt { found_deg: tilt_rad.to_degrees(), limit_deg: TILT_RAD.to_degrees() });
        }
        for joint in 0..JOINTS {
            let (name, rate, torque) = (joint_name(joint), reading.encoders.rates[joint], reading.torques[joint]);
            if rate.abs() > JOINT_RATE_RAD_S {
                return Err(Fault::JointRate { joint: name, found: rate, limit: JOINT_RATE_RAD_S });
            }
            let (found, [low, high]) = (reading.encoders.angles[joint], self.joint_limits[joint]);
            if !(low - ANGLE_BEYOND_RAD..=high + ANGLE_BEYOND_RAD).contains(&found) {
                return Err(Fault::JointRange { joint: name, found, low, high });
            }
            let strains = torque.abs() > TORQUE_FRACTION * self.torque_limits[joint];
            let straining_s = &mut self.straining_s[joint];
            *straining_s = if strains { *straining_s + dt_s } else { 0.0 };
            if *straining_s > TORQUE_S {
                return Err(Fault::Torque { joint: name, found: torque, for_s: *straining_s });
            }
        }
        let (found, joint) = reading.hottest;
        if found > TEMPERATURE_C {
            return Err(Fault::Temperature { joint: joint_name(joint), found, limit: TEMPERATURE_C });
        }
        if let Some(found) = reading.charge_percent.filter(|charge| *charge < CHARGE_PERCENT) {
            return Err(Fault::Battery { found, limit: CHARGE_PERCENT });
        }
        Ok(())
    }

    /// Checks the policy's joint targets \[rad\] against the last ones, and returns them within the joints' ranges.
    pub fn limit(&self, targets: &Joints, last: &Joints) -> Result<Joints, Fault> {
        let mut limited = *targets;
        for joint in 0..JOINTS {
            let (name, found, [low, high]) = (joint_name(joint), targets[joint], self.joint_limits[joint]);
            if !found.is_finite() {
                return Err(Fault::NotFinite { what: format!("the policy's target of {name}") });
            }
            if self.is_strict && !(low - TARGET_BEYOND_RAD..=high + TARGET_BEYOND_RAD).contains(&found) {
                return Err(Fault::TargetRange { joint: name, found, low, high });
            }
            let change = found - last[joint];
            if self.is_strict && change.abs() > TARGET_STEP_RAD {
                return Err(Fault::TargetStep { joint: name, found: change, limit: TARGET_STEP_RAD });
            }
            limited[joint] = found.clamp(low, high);
        }
        Ok(limited)
    }

    /// Checks a silence of the robot of this length \[s\].
    pub fn silence(&self, silent_s: f64) -> Result<(), Fault> {
        let is_fault = self.is_strict && silent_s > SILENCE_S;
        let fault = Fault::Silence { silent_ms: 1e3 * silent_s, limit_ms: 1e3 * SILENCE_S };
        if is_fault { Err(fault) } else { Ok(()) }
    }
}

/// Checks that all numbers of a reading are finite; the fault names the first that is not.
fn check_finite(reading: &Reading) -> Result<(), Fault> {
    let fault = |what: String| Err(Fault::NotFinite { what });
    reading.imu.check().and_then(|()| reading.encoders.check()).or_else(|error| fault(error.to_string()))?;
    if let Some(joint) = reading.torques.iter().position(|torque| !torque.is_finite()) {
        return fault(format!("torque of {}", joint_name(joint)));
    }
    if !reading.world_from_base.coords.iter().all(|value| value.is_finite()) {
        return fault("quaternion of the IMU".to_owned());
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use supple::robot::Robot;

    use super::*;
    use crate::bridge::reading::tests::state_at;
    use crate::message::LowState;

    fn guard() -> Guard {
        let robot = Robot::load("go2").unwrap();
        Guard::new(robot.joint_limits, robot.torque_limits)
    }

    fn pose() -> Joints {
        Robot::load("go2").unwrap().nominal_pose
    }

    fn checked(change: impl Fn(&mut LowState)) -> Result<(), Fault> {
        let mut state = state_at(&pose(), 2);
        change(&mut state);
        guard().check(&Reading::new(&state.sealed()).unwrap(), 0.002)
    }

    #[test]
    fn each_limit_is_a_fault_of_its_own() {
        assert_eq!(checked(|_| ()), Ok(()));
        // Rolled by 70°: cos and sin of half of it.
        let rolled = checked(|it| it.imu_state.quaternion = [0.819, 0.574, 0.0, 0.0]);
        assert!(matches!(rolled, Err(Fault::Tilt { .. })), "{rolled:?}");
        let fast = Fault::JointRate { joint: "FL_thigh".to_owned(), found: -36.0, limit: JOINT_RATE_RAD_S };
        assert_eq!(checked(|it| it.motor_state[4].dq = -36.0), Err(fast));
        // A calf's encoder that is off by a turn.
        let far = checked(|it| it.motor_state[2].q = 3.5);
        assert!(matches!(far, Err(Fault::JointRange { .. })), "{far:?}");
        let hot = Fault::Temperature { joint: "FL_thigh".to_owned(), found: 90, limit: TEMPERATURE_C };
        assert_eq!(checked(|it| it.motor_state[4].temperature = 90), Err(hot));
        assert_eq!(checked(|it| it.bms_state.soc = 5), Err(Fault::Battery { found: 5, limit: CHARGE_PERCENT }));
        let broken = checked(|it| it.imu_state.gyroscope[1] = f32::NAN);
        assert!(matches!(broken, Err(Fault::NotFinite { .. })), "{broken:?}");
        let named = checked(|it| it.motor_state[7].dq = f32::NAN).unwrap_err();
        assert!(named.to_string().contains("RR_thigh"), "{named}");
        // Simulators have no battery.
        assert_eq!(checked(|it| (it.bms_state.soc, it.bms_state.cell_vol[0]) = (0, 0)), Ok(()));
    }

    #[test]
    fn motor_may_strain_for_half_a_second() {
        let (mut guard, mut state) = (guard(), state_at(&pose(), 2));
        state.motor_state[1].tau_est = 23.5;
        let reading = Reading::new(&state.clone().sealed()).unwrap();
        let mut strain = |seconds: f64| (0..(seconds * 500.0) as usize).try_for_each(|_| guard.check(&reading, 0.002));
        assert_eq!(strain(0.49), Ok(()));
        assert!(matches!(strain(0.05), Err(Fault::Torque { .. })));
    }

    #[test]
    fn targets_are_limited_to_the_range_and_refused_far_beyond() {
        let (guard, last) = (guard(), pose());
        let with = |joint: usize, target: f64| {
            let mut targets = last;
            targets[joint] = target;
            guard.limit(&targets, &last)
        };
        // The calf's range is −2.7227 to −0.83776 rad.
        assert_eq!(with(2, -0.5).map(|it| it[2]), Ok(-0.83776));
        assert!(matches!(with(2, 1.0), Err(Fault::TargetRange { .. })));
        assert!(matches!(with(1, -1.9), Err(Fault::TargetStep { .. })));
        assert!(matches!(with(5, f64::NAN), Err(Fault::NotFinite { .. })));
    }
}
