//! The robot's state as the bridge understands it.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use supple::estimate::{EncoderReading, ImuReading};
use supple::robot::{JOINTS, Joints};

use crate::message::{HEAD, LowState, MotorState, crc};
use crate::remote::Remote;

/// A state of the robot.
#[derive(Debug, Clone, PartialEq)]
pub struct Reading {
    pub tick_ms: u32, // clock of the robot [ms]
    pub imu: ImuReading,
    pub world_from_base: UnitQuaternion<f64>, // the IMU's own orientation, world from base
    pub encoders: EncoderReading,
    pub torques: Joints,            // torques of the motors [N·m]
    pub hottest: (u8, usize),       // temperature of the hottest motor [°C], and the motor
    pub charge_percent: Option<u8>, // state of charge [%]; `None` if the battery reports nothing, as in simulators
    pub remote: Remote,
}

impl Reading {
    /// Reads a state, or returns the reason to ignore it. A checksum of zero counts as none: `unitree_mujoco` sets none.
    pub fn new(state: &LowState) -> Result<Self, String> {
        let expected = crc(state);
        if state.crc != expected && !Self::is_unsigned(state) {
            return Err(format!("its checksum is {:08x}, expected {expected:08x}", state.crc));
        }
        if state.head != HEAD && !Self::is_unsigned(state) {
            return Err(format!("its head is {:02X?}, expected [FE, EF]", state.head));
        }
        let of_motors = |value: fn(&MotorState) -> f32| state.of_motors(value);
        let imu = &state.imu_state;
        let [gyro, specific_force] = [imu.gyroscope, imu.accelerometer].map(|it| Vector3::from(it.map(f64::from)));
        let [w, x, y, z] = imu.quaternion.map(f64::from);
        let hottest = state.motor_state[..JOINTS].iter().enumerate().max_by_key(|(_, motor)| motor.temperature);
        let has_battery = state.bms_state.cell_vol.iter().any(|voltage| *voltage > 0);
        Ok(Reading {
            tick_ms: state.tick,
            imu: ImuReading { gyro, specific_force },
            world_from_base: UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)),
            encoders: EncoderReading { angles: of_motors(|motor| motor.q), rates: of_motors(|motor| motor.dq) },
            torques: of_motors(|motor| motor.tau_est),
            hottest: hottest.map_or((0, 0), |(joint, motor)| (motor.temperature, joint)),
            charge_percent: has_battery.then_some(state.bms_state.soc),
            remote: Remote::from_bytes(&state.wireless_remote),
        })
    }

    pub fn is_unsigned(state: &LowState) -> bool {
        state.crc == 0
    }

    /// Returns the angle between the trunk's up and the world's \[rad\].
    pub fn tilt_rad(&self) -> f64 {
        (self.world_from_base * Vector3::z()).z.clamp(-1.0, 1.0).acos()
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::message::{Field, SERVO};

    /// A Go2 at rest in this pose \[rad\].
    pub fn state_at(angles: &Joints, tick_ms: u32) -> LowState {
        let mut state = LowState { head: HEAD, tick: tick_ms, ..LowState::zero() };
        state.imu_state.quaternion = [1.0, 0.0, 0.0, 0.0];
        state.imu_state.accelerometer = [0.0, 0.0, 9.81];
        for (motor, angle) in state.motor_state.iter_mut().zip(angles) {
            (motor.mode, motor.q, motor.temperature) = (SERVO, *angle as f32, 40);
        }
        state.bms_state.soc = 80;
        state.bms_state.cell_vol[0] = 3700;
        state.sealed()
    }

    #[test]
    fn state_with_a_flipped_bit_is_ignored_and_one_without_checksum_is_not() {
        let state = state_at(&[0.1; JOINTS], 2);
        let reading = Reading::new(&state).unwrap();
        assert_eq!((reading.tick_ms, reading.charge_percent, reading.hottest.0), (2, Some(80), 40));
        assert!(reading.tilt_rad() < 1e-6);
        let mut flipped = state.clone();
        flipped.motor_state[3].q = f32::from_bits(flipped.motor_state[3].q.to_bits() ^ 1);
        assert!(Reading::new(&flipped).unwrap_err().contains("checksum"));
        assert!(Reading::new(&LowState { crc: 0, ..flipped }).is_ok());
    }
}
