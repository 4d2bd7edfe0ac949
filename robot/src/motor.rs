//! The loop inside each motor: torque from a command and the joint's state.

use supple::robot::{JOINTS, Joints};

use crate::message::{Field, MotorCmd, POS_STOP, SERVO, VEL_STOP};

/// Derivative gain of damping, with which the robot sinks to the ground [N·m·s/rad].
const DAMPING_KD: f32 = 3.0;

/// Values from this one on stand for [`POS_STOP`]; in single precision 2.146e9 is not exact.
const NO_POSITION: f32 = 1e9;

/// Returns the command that only resists motion.
pub fn damping() -> [MotorCmd; JOINTS] {
    std::array::from_fn(|_| MotorCmd { mode: SERVO, q: POS_STOP, kd: DAMPING_KD, ..MotorCmd::zero() })
}

/// Returns the command that holds joint targets \[rad\] with these gains of each joint.
pub fn holding(targets: &Joints, kp: &Joints, kd: &Joints) -> [MotorCmd; JOINTS] {
    std::array::from_fn(|joint| {
        let [q, kp, kd] = [targets, kp, kd].map(|values| values[joint] as f32);
        MotorCmd { mode: SERVO, q, kp, kd, ..MotorCmd::zero() }
    })
}

/// Returns true if the command has a joint target.
pub fn has_target(command: &MotorCmd) -> bool {
    command.q.abs() < NO_POSITION && command.kp != 0.0
}

/// Computes the torque of a motor within ± `limit` [N·m], from the joint's angle \[rad\] and rate [rad/s].
pub fn torque(command: &MotorCmd, angle: f64, rate: f64, limit: f64) -> f64 {
    if command.mode != SERVO {
        return 0.0;
    }
    let position = if has_target(command) { f64::from(command.kp) * (f64::from(command.q) - angle) } else { 0.0 };
    let velocity = if command.dq == VEL_STOP { 0.0 } else { f64::from(command.kd) * (f64::from(command.dq) - rate) };
    (f64::from(command.tau) + position + velocity).clamp(-limit, limit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn torque_is_the_sum_of_three_terms_within_limits() {
        let command = MotorCmd { mode: SERVO, q: 0.5, dq: 1.0, tau: 2.0, kp: 40.0, kd: 1.5, ..MotorCmd::zero() };
        // 2 + 40 · (0.5 − 0.2) + 1.5 · (1 − 3) = 11
        assert!((torque(&command, 0.2, 3.0, 23.7) - 11.0).abs() < 1e-6);
        assert_eq!(torque(&command, -2.0, 0.0, 23.7), 23.7);
        assert_eq!(torque(&MotorCmd { mode: 0, ..command.clone() }, 0.2, 3.0, 23.7), 0.0);
        // Stop values switch their terms off.
        assert_eq!(torque(&MotorCmd { q: POS_STOP, dq: VEL_STOP, ..command }, 0.2, 3.0, 23.7), 2.0);
        assert!((torque(&damping()[0], 0.2, 2.0, 23.7) + 6.0).abs() < 1e-6);
    }
}
