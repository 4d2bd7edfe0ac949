/*! The simulated Go2 behind the interface: motors that obey commands, and the state that its sensors report.

The motors' own loop runs at the physics rate. It runs as the playback's controller: with a proportional gain of one and no derivative gain,
the joint target `angle + torque` makes the simulation apply exactly that torque.
*/

use std::sync::{Arc, Mutex, PoisonError};

use nalgebra::{UnitQuaternion, Vector3};
use rand_chacha::ChaCha8Rng;
use supple::config::{Config, Simulation};
use supple::estimate::{EncoderReading, ImuReading, SensorNoise, Sensors};
use supple::mujoco;
use supple::policy::Controller;
use supple::robot::{JOINTS, Joints, Robot, RobotState};
use supple::scenario::senses::ExactSensors;
use supple::scenario::trace::{Event, Frame};
use supple::scenario::{Playback, Script};
use supple::task::Command;
use supple::util::random::{Purpose, stream};

use super::operator::Sight;
use crate::message::{Field, HEAD, ImuState, LOW_LEVEL, LowState, MOTORS, MotorCmd, MotorState, SERVO};
use crate::motor;
use crate::remote::Remote;

/// Rate of the states \[Hz\].
pub const STATE_HZ: u32 = 500;

/// Physics rate \[Hz\], a multiple of [`STATE_HZ`].
const PHYSICS_HZ: u32 = 1000;

/// Rate of the frames for metrics and recordings \[Hz\].
const FRAME_HZ: u32 = 50;

/// Temperatures: of the surroundings and of a motor at first \[°C\], rise per squared torque, and time constant \[s\]. Assumed: a constant
/// 10 N·m ends at 85 °C.
const AMBIENT_C: f64 = 25.0;
const START_C: f64 = 35.0;
const RISE_C_PER_N2_M2: f64 = 0.6;
const COOLING_S: f64 = 300.0;

/// Battery: energy \[J\], voltage \[V\], power of the computers \[W\], charge at first.
const BATTERY_J: f64 = 432.0 * 3600.0;
const VOLTAGE: f64 = 29.0;
const COMPUTERS_W: f64 = 20.0;
const CHARGE: f64 = 0.9;

/// The motors' loop as a controller of the simulation.
struct Motors {
    commands: Arc<Mutex<[MotorCmd; JOINTS]>>,
    limits: Joints,
    rest: Joints,
}

impl Controller for Motors {
    fn rest(&self) -> Joints {
        self.rest
    }

    fn begin(&mut self, _: &RobotState) {}

    fn joint_targets(&mut self, state: &RobotState, _: &Command) -> Joints {
        let commands = self.commands.lock().unwrap_or_else(PoisonError::into_inner);
        std::array::from_fn(|joint| {
            let (angle, rate) = (state.joint_angles[joint], state.joint_rates[joint]);
            angle + motor::torque(&commands[joint], angle, rate, self.limits[joint])
        })
    }
}

/// Returns the configuration in which the simulation's joint target is a torque, at [`PHYSICS_HZ`].
pub fn configuration(config: Config) -> Config {
    let (physics_rate_hz, policy_rate_hz) = (PHYSICS_HZ, PHYSICS_HZ);
    let (kp_n_m_per_rad, kd_n_m_s_per_rad) = (1.0.into(), 0.0.into());
    let simulation = Simulation { physics_rate_hz, policy_rate_hz, kp_n_m_per_rad, kd_n_m_s_per_rad, latency_s: 0.0 };
    Config { simulation, ..config }
}

/// The events of a tick of [`STATE_HZ`].
#[derive(Debug, Default)]
pub struct Tick {
    pub frame: Option<Frame>, // the frame that was completed, if any
    pub events: Vec<Event>,
    pub is_over: bool,
    pub saturated: Option<(usize, f64, f64)>, // motors at their torque limit: joint, commanded torque, limit [N·m]
}

/// The simulated robot.
pub struct Body {
    pub playback: Playback<'static>,
    commands: Arc<Mutex<[MotorCmd; JOINTS]>>,
    robot: Arc<Robot>,
    exact: ExactSensors,
    sensors: Option<Sensors>,
    rng: ChaCha8Rng,
    imu: ImuReading,
    encoders: EncoderReading,
    last_rates: Joints,
    torques: Joints,
    foot_forces: [f64; 4],
    temperatures: Joints,
    energy_j: f64,
    ticks: u64,
    substeps: u32,
    averaged: Average,
}

impl Body {
    /// Builds the scene of a script; the robot starts standing, and sinks unless it is commanded. `config` is that of
    /// [`configuration`]; without `noise` the sensors are exact.
    pub fn new(script: Script, config: Config, noise: Option<SensorNoise>, seed: u64) -> mujoco::Result<Self> {
        let robot = Arc::clone(&script.scene.robot);
        let conditions = script.conditions;
        let substeps = config.simulation.physics_rate_hz / STATE_HZ;
        let commands = Arc::new(Mutex::new(motor::damping()));
        let motors = Motors { commands: Arc::clone(&commands), limits: robot.torque_limits, rest: robot.nominal_pose };
        let mut playback = Playback::new(&script, &config, Box::new(motors))?.with_bodies();
        playback.hold_clock(true);
        let mut rng = stream(seed, Purpose::Sensor, 0, 0);
        let sensors = noise.map(|noise| Sensors::new(noise, &mut rng));
        let mut exact = ExactSensors::new(playback.sim(), &conditions);
        let (imu, encoders) = exact.read(playback.sim().data(), playback.sim().parts());
        Ok(Body {
            playback,
            commands,
            robot,
            exact,
            sensors,
            rng,
            imu,
            last_rates: encoders.rates,
            encoders,
            torques: [0.0; JOINTS],
            foot_forces: [0.0; 4],
            temperatures: [START_C; JOINTS],
            energy_j: CHARGE * BATTERY_J,
            ticks: 0,
            substeps,
            averaged: Average::default(),
        })
    }

    /// Starts the script's clock.
    pub fn begin(&mut self) {
        self.playback.hold_clock(false);
        self.averaged = Average::default();
    }

    /// Sets the commands to the motors.
    pub fn command(&mut self, motors: &[MotorCmd; JOINTS]) {
        self.commands.lock().unwrap_or_else(PoisonError::into_inner).clone_from(motors);
    }

    /// Plays one tick of [`STATE_HZ`].
    pub fn tick(&mut self) -> Tick {
        let mut tick = Tick::default();
        self.last_rates = self.encoders.rates;
        let mut force = Vector3::zeros();
        for _ in 0..self.substeps {
            let played = self.playback.next();
            let (events, frame) = played.map_or((Vec::new(), None), |played| (played.events, played.frame));
            tick.events.extend(events);
            let Some(frame) = frame else {
                tick.is_over = true;
                break;
            };
            self.sense();
            force += self.imu.specific_force / f64::from(self.substeps);
            self.torques = frame.torques;
            self.foot_forces = frame.foot_forces.map(|force| force[2]);
            tick.frame = tick.frame.or(self.average(frame));
        }
        self.imu.specific_force = force;
        self.ticks += 1;
        self.wear();
        tick.saturated = self.saturated();
        tick
    }

    /// Reads the sensors after a physics step.
    fn sense(&mut self) {
        let data = self.playback.sim().data();
        let (imu, encoders) = self.exact.read(data, self.playback.sim().parts());
        (self.imu, self.encoders) = (imu, encoders);
        if let Some(sensors) = &mut self.sensors {
            let dt_s = data.model().timestep_s();
            self.imu = sensors.imu(&imu, dt_s, &mut self.rng);
            self.encoders = sensors.encoders(&encoders, dt_s, &mut self.rng);
        }
    }

    /// Returns the mean frame once enough have come, with the client's joint targets.
    fn average(&mut self, mut frame: Frame) -> Option<Frame> {
        let commands = self.commands.lock().unwrap_or_else(PoisonError::into_inner);
        frame.joint_targets = std::array::from_fn(|joint| match &commands[joint] {
            command if motor::has_target(command) => f64::from(command.q),
            _ => frame.joint_angles[joint],
        });
        self.averaged.add(frame, self.substeps * STATE_HZ / FRAME_HZ)
    }

    /// Warms the motors and drains the battery.
    fn wear(&mut self) {
        let dt_s = 1.0 / f64::from(STATE_HZ);
        let mut power_w = COMPUTERS_W;
        for (joint, temperature) in self.temperatures.iter_mut().enumerate() {
            let goal = AMBIENT_C + RISE_C_PER_N2_M2 * self.torques[joint].powi(2);
            *temperature += dt_s / COOLING_S * (goal - *temperature);
            power_w += (self.torques[joint] * self.encoders.rates[joint]).abs();
        }
        self.energy_j = (self.energy_j - dt_s * power_w).max(0.0);
    }

    /// Returns the motor whose command is most beyond its limit.
    fn saturated(&self) -> Option<(usize, f64, f64)> {
        let commands = self.commands.lock().unwrap_or_else(PoisonError::into_inner);
        let beyond = |joint: usize| {
            let limit = self.robot.torque_limits[joint];
            let (angle, rate) = (self.encoders.angles[joint], self.encoders.rates[joint]);
            (joint, motor::torque(&commands[joint], angle, rate, f64::INFINITY), limit)
        };
        let worst = (0..JOINTS).map(beyond).max_by(|a, b| (a.1.abs() / a.2).total_cmp(&(b.1.abs() / b.2)))?;
        (worst.1.abs() > worst.2).then_some(worst)
    }

    /// Returns the state that the robot reports.
    pub fn state(&self, remote: Remote) -> LowState {
        let dt_s = 1.0 / f64::from(STATE_HZ);
        let motor = |joint: usize| {
            let (q, dq) = (self.encoders.angles[joint] as f32, self.encoders.rates[joint] as f32);
            let ddq = ((self.encoders.rates[joint] - self.last_rates[joint]) / dt_s) as f32;
            let (mode, tau_est, ddq_raw) = (SERVO, self.torques[joint] as f32, ddq);
            let temperature = self.temperatures[joint].clamp(0.0, 127.0) as u8;
            MotorState { mode, q, dq, ddq, tau_est, q_raw: q, dq_raw: dq, ddq_raw, temperature, ..MotorState::zero() }
        };
        let motor_state: [MotorState; MOTORS] =
            std::array::from_fn(|index| if index < JOINTS { motor(index) } else { MotorState::zero() });
        let upright = self.world_from_base();
        let (roll, pitch, yaw) = upright.euler_angles();
        let foot_force = self.foot_forces.map(|force| force.clamp(0.0, 32_000.0) as i16);
        let mut state = LowState {
            head: HEAD,
            level_flag: LOW_LEVEL,
            imu_state: ImuState {
                quaternion: [upright.w, upright.i, upright.j, upright.k].map(|value| value as f32),
                gyroscope: self.imu.gyro.map(|value| value as f32).into(),
                accelerometer: self.imu.specific_force.map(|value| value as f32).into(),
                rpy: [roll, pitch, yaw].map(|angle| angle as f32),
                temperature: 45,
            },
            motor_state,
            foot_force,
            foot_force_est: foot_force,
            tick: (self.ticks * 1000 / u64::from(STATE_HZ)) as u32,
            wireless_remote: remote.to_bytes(),
            temperature_ntc1: 40,
            temperature_ntc2: 40,
            power_v: VOLTAGE as f32,
            power_a: (COMPUTERS_W / VOLTAGE) as f32,
            ..LowState::zero()
        };
        state.bms_state.soc = (100.0 * self.energy_j / BATTERY_J) as u8;
        state.bms_state.cell_vol[..8].fill((1000.0 * VOLTAGE / 8.0) as u16);
        state.sealed()
    }

    /// Returns the rotation from the base frame to a world whose z axis is opposite to gravity, which a script may tilt.
    fn world_from_base(&self) -> UnitQuaternion<f64> {
        let sim = self.playback.sim();
        let up = -Vector3::from(sim.data().model().gravity());
        let level = UnitQuaternion::rotation_between(&up, &Vector3::z()).unwrap_or_default();
        level * sim.parts().world_from_base(sim.data())
    }

    /// Returns the state that the operator sees.
    pub fn sight(&self, now_s: f64, is_commanded: bool) -> Sight {
        let up = self.world_from_base() * Vector3::z();
        let height_m = self.playback.sim().state().height;
        Sight { now_s, height_m, tilt_rad: up.z.clamp(-1.0, 1.0).acos(), is_commanded }
    }
}

/// The mean of the last frames.
#[derive(Default)]
struct Average {
    frames: u32,
    mean: Frame,
}

impl Average {
    /// Adds a frame; returns the mean of `count` of them. Values that are not averaged are those of the last frame.
    fn add(&mut self, mut frame: Frame, count: u32) -> Option<Frame> {
        let before = std::mem::take(&mut self.mean);
        if self.frames > 0 {
            frame.power_w += before.power_w;
            frame.torque_n_m += before.torque_n_m;
            frame.reward += before.reward;
            frame.obstacle_impulse_n_s += before.obstacle_impulse_n_s;
            frame.obstacle_contact_s += before.obstacle_contact_s;
            frame.peak_foot_force_n = frame.peak_foot_force_n.max(before.peak_foot_force_n);
            frame.peak_obstacle_force_n = frame.peak_obstacle_force_n.max(before.peak_obstacle_force_n);
            for (sum, earlier) in frame.foot_forces.iter_mut().flatten().zip(before.foot_forces.iter().flatten()) {
                *sum += earlier;
            }
        }
        self.frames += 1;
        if self.frames < count {
            self.mean = frame;
            return None;
        }
        let count = f64::from(std::mem::take(&mut self.frames));
        frame.power_w /= count;
        frame.torque_n_m /= count;
        frame.reward /= count;
        frame.foot_forces.iter_mut().flatten().for_each(|force| *force /= count);
        Some(frame)
    }
}

/// Time between two frames \[s\].
pub const FRAME_S: f64 = 1.0 / FRAME_HZ as f64;

#[cfg(test)]
mod tests {
    use supple::scenario::catalog::Scenario;

    use super::*;
    use crate::message::crc;

    fn body() -> Body {
        let config = configuration(Config::load("go2").unwrap());
        let mut script = Scenario::named("walk", "{duration_s: 3600.0}").unwrap().script(0, &config).unwrap();
        script.after_fall_s = 3600.0;
        Body::new(script, config, None, 0).unwrap()
    }

    #[test]
    fn robot_without_commands_sinks_and_stays_at_rest() {
        let mut body = body();
        assert!((0..3 * STATE_HZ).all(|_| !body.tick().is_over));
        let (sight, state) = (body.sight(0.0, false), body.state(Remote::default()));
        assert!(sight.height_m < 0.2 && sight.tilt_rad < 0.3, "{sight:?}");
        assert!(state.motor_state.iter().all(|motor| motor.dq.abs() < 0.2));
    }

    #[test]
    fn held_robot_reports_what_it_is() {
        let mut body = body();
        let pose = body.robot.nominal_pose;
        body.command(&motor::holding(&pose, &[60.0; JOINTS], &[5.0; JOINTS]));
        (0..2 * STATE_HZ).for_each(|_| drop(body.tick()));
        let state = body.state(Remote::default());
        assert_eq!(crc(&state), state.crc);
        assert_eq!(state.tick, 2000);
        for (joint, angle) in pose.iter().enumerate() {
            let motor = &state.motor_state[joint];
            assert!((f64::from(motor.q) - angle).abs() < 0.15, "{joint}: {motor:?}");
        }
        // A knee holds 7 N m with a gain of 60 N m/rad. At rest the accelerometer reads gravity, the feet carry the weight, and the quaternion is upright.
        let [x, y, z] = state.imu_state.accelerometer;
        assert!(x.abs() < 1.0 && y.abs() < 0.5 && (z - 9.81).abs() < 0.2, "{x} {y} {z}");
        let weight_n = body.robot.mass_kg * 9.81;
        let carried: f64 = state.foot_force.iter().map(|force| f64::from(*force)).sum();
        assert!((carried - weight_n).abs() < 0.05 * weight_n, "{carried} {weight_n}");
        assert!(state.imu_state.quaternion[0] > 0.99);
        assert!((30..60).contains(&state.motor_state[0].temperature) && state.bms_state.soc > 80);
    }

    #[test]
    fn commanded_torque_is_what_the_motor_gives() {
        let mut body = body();
        let mut motors = motor::damping();
        motors[4].kd = 0.0;
        for (commanded, given, close, saturated) in [(-3.5, -3.5, 1e-6, None), (-300.0, -23.7, 1e-4, Some(4))] {
            motors[4].tau = commanded;
            body.command(&motors);
            assert_eq!(body.tick().saturated.map(|(joint, ..)| joint), saturated);
            assert!((body.state(Remote::default()).motor_state[4].tau_est - given).abs() < close);
        }
    }

    #[test]
    fn frames_are_means_over_a_fiftieth_of_a_second() {
        let mut average = Average::default();
        let frame =
            |power_w, peak| Frame { power_w, peak_foot_force_n: peak, obstacle_impulse_n_s: 1.0, ..Frame::default() };
        assert_eq!(average.add(frame(1.0, 9.0), 3), None);
        assert_eq!(average.add(frame(2.0, 5.0), 3), None);
        let mean = average.add(frame(6.0, 7.0), 3).unwrap();
        assert_eq!((mean.power_w, mean.peak_foot_force_n, mean.obstacle_impulse_n_s), (3.0, 9.0, 3.0));
        assert_eq!(average.add(frame(1.0, 1.0), 1).unwrap().power_w, 1.0);
    }
}
