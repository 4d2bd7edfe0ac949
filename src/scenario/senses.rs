/*! Sensing: the controller acts on the true state or on one estimated from sensors (section IV-D).

With [`Sensing::Estimated`], noisy IMU and encoders are read after every physics step; the contact network estimates the
contacts, and the filters of [`crate::estimate`] the state. The controller gets only that state. A
sensor whose reading is not finite counts as silent in that tick: the other one bridges it, for as long as the filters
allow. The motors' own loop keeps acting on the true joints, with the encoder bias of the simulation.

Pushes change the trunk's velocity instantly. The IMU measures them nevertheless: it reads the change of velocity since its last reading,
which without a push is the simulator's acceleration to the last bit or so. Its range (±24 g) is not modelled, since only such a push
exceeds it.
*/

use std::sync::Arc;

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use crate::estimate::contact::{ContactEstimator, ContactNetwork, RATE_HZ};
use crate::estimate::external_force::ForceReading;
use crate::estimate::sensors::TrunkMotion;
use crate::estimate::{
    EncoderReading, Estimate, Estimator, EstimatorConfig, ImuReading, SensorFault, SensorNoise, Sensors,
};
use crate::mujoco::Data;
use crate::robot::{Joints, Robot, RobotState};
use crate::scenario::trace::Sensed;
use crate::sim::{Conditions, Parts, Sim};
use crate::util::files::FileError;
use crate::util::random::{Purpose, stream};

/// The state that a controller acts on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Sensing {
    /// The true state of the simulator.
    #[default]
    True,
    /// The state estimated from a noisy IMU, noisy encoders and the contact network.
    Estimated,
}

/// Error while starting the sensors.
#[derive(Debug, thiserror::Error)]
pub enum SensingError {
    /// The contact network cannot be loaded.
    #[error(transparent)]
    Contact(#[from] FileError),
    /// The contact network was trained for another physics rate.
    #[error("the physics run at {0} Hz, the contact network at {RATE_HZ} Hz: sense the true state instead")]
    Rate(f64),
    /// The first reading is invalid.
    #[error("the sensors do not start: {0}")]
    Start(#[from] SensorFault),
}

/// Error-free sensors, except for the encoder bias, which the motors have too.
#[derive(Debug, Clone)]
pub struct ExactSensors {
    imu_in_base: Vector3<f64>,
    /// Encoder bias \[rad\].
    offsets: Joints,
    /// Trunk's velocity at the last reading: linear, world frame [m/s], and angular, base frame [rad/s].
    last_velocity: (Vector3<f64>, Vector3<f64>),
}

impl ExactSensors {
    /// Creates the sensors in the present state of the robot.
    pub fn new(sim: &Sim, conditions: &Conditions) -> Self {
        let last_velocity = sim.parts().trunk_velocity(sim.data());
        ExactSensors { imu_in_base: sim.robot().imu_in_base, offsets: conditions.encoder_bias, last_velocity }
    }

    /// Reads the sensors; to be called once after each physics step.
    pub fn read(&mut self, data: &Data, parts: &Parts) -> (ImuReading, EncoderReading) {
        let dt_s = data.model().timestep_s();
        let velocity = parts.trunk_velocity(data);
        let (world_from_base, acceleration) = (parts.world_from_base(data), (velocity.0 - self.last_velocity.0) / dt_s);
        let angular_acceleration = (velocity.1 - self.last_velocity.1) / dt_s;
        let motion = TrunkMotion { world_from_base, acceleration, angular_velocity: velocity.1, angular_acceleration };
        self.last_velocity = velocity;
        let encoders = EncoderReading::exact(&parts.joint_angles(data), parts.joint_rates(data), &self.offsets);
        (ImuReading::exact(&motion, self.imu_in_base, Vector3::from(data.model().gravity())), encoders)
    }
}

/// The sensors of a robot and its state estimator.
#[derive(Debug)]
pub(crate) struct Senses {
    robot: Arc<Robot>,
    sensors: Sensors,
    rng: ChaCha8Rng,
    contacts: ContactEstimator,
    estimator: Estimator,
    exact: ExactSensors,
    /// Position of the robot at its start, world frame \[m\].
    origin: Vector3<f64>,
    /// Joint targets given last \[rad\].
    target: Joints,
    /// The last valid reading of the encoders.
    reading: EncoderReading,
    /// The last readings of the sensors, valid or not.
    felt: Option<(ImuReading, EncoderReading)>,
    touching: [bool; 4],
    /// True if a sensor failed in the last tick.
    failing: bool,
    /// First new fault since the last call of [`Senses::fault`].
    news: Option<SensorFault>,
    /// The fault that ended the estimate.
    end: Option<SensorFault>,
}

impl Senses {
    /// Switches on the sensors of a robot that stands at rest and holds `target` \[rad\]. Noise is drawn from the seed's
    /// stream for sensors.
    pub fn new(
        network: ContactNetwork,
        noise: SensorNoise,
        seed: u64,
        sim: &Sim,
        conditions: &Conditions,
        target: &Joints,
    ) -> Result<Self, SensingError> {
        let timestep_s = sim.data().model().timestep_s();
        ensure!((timestep_s * RATE_HZ - 1.0).abs() <= 1e-6, SensingError::Rate(1.0 / timestep_s));
        let mut rng = stream(seed, Purpose::Sensor, 0, 0);
        let state = sim.state();
        let robot = Arc::clone(sim.robot());
        let mut senses = Senses {
            sensors: Sensors::new(noise, &mut rng),
            rng,
            contacts: ContactEstimator::new(network),
            estimator: Estimator::new(Arc::clone(&robot), EstimatorConfig::default()),
            robot,
            exact: ExactSensors::new(sim, conditions),
            origin: Vector3::new(state.position.x, state.position.y, 0.0),
            target: *target,
            reading: EncoderReading { angles: state.joint_angles, rates: state.joint_rates },
            felt: None,
            touching: [false; 4],
            failing: false,
            news: None,
            end: None,
        };
        senses.read(sim.data(), sim.parts());
        match senses.news.take() {
            Some(fault) => Err(fault.into()),
            None => Ok(senses),
        }
    }

    /// Stores the joint targets \[rad\] that act from now on.
    pub fn act(&mut self, target: &Joints) {
        self.target = *target;
    }

    /// Reads all sensors after a physics step.
    pub fn read(&mut self, data: &Data, parts: &Parts) {
        let dt_s = data.model().timestep_s();
        let (imu, encoders) = self.exact.read(data, parts);
        let imu = self.sensors.imu(&imu, dt_s, &mut self.rng);
        let encoders = self.sensors.encoders(&encoders, dt_s, &mut self.rng);
        self.felt = Some((imu, encoders));
        self.take(imu, encoders, dt_s);
    }

    /// Returns the last readings, valid or not, and the estimated orientation, for a
    /// [`ForceObserver`](crate::estimate::external_force::ForceObserver). `torques` are those of the last physics step [N·m].
    pub(crate) fn force_reading(&self, torques: &Joints) -> ForceReading {
        let (imu, encoders) = self.felt.unwrap_or_else(|| unreachable!("senses start with a reading"));
        ForceReading { imu, encoders, torques: *torques, world_from_base: self.estimate().world_from_base }
    }

    /// Updates the estimate with the readings of a tick.
    fn take(&mut self, imu: ImuReading, encoders: EncoderReading, dt_s: f64) {
        let (imu_is_good, encoders_are_good) = (imu.check(), encoders.check());
        if encoders_are_good.is_ok() {
            self.reading = encoders;
        }
        self.touching = self.contacts.update(&self.reading, &self.target);
        let imu = imu_is_good.is_ok().then_some(&imu);
        let encoders = encoders_are_good.is_ok().then_some(&encoders);
        if let Err(fault) = self.estimator.update(imu, encoders, self.touching, dt_s) {
            self.end.get_or_insert(fault);
        }
        let fault = imu_is_good.and(encoders_are_good).err();
        let was_failing = std::mem::replace(&mut self.failing, fault.is_some());
        if let (Some(fault), false) = (fault, was_failing) {
            self.news.get_or_insert(fault);
        }
    }

    /// Returns a sensor fault that began since the last call, once until all readings are valid again.
    pub fn fault(&mut self) -> Result<Option<SensorFault>, SensorFault> {
        match &self.end {
            Some(end) => Err(end.clone()),
            None => Ok(self.news.take()),
        }
    }

    /// Returns the estimated state.
    pub fn state(&self) -> RobotState {
        let state = self.estimate().state(&self.robot, &self.reading, self.touching);
        RobotState { position: state.position + self.origin, ..state }
    }

    /// Returns the estimate as stored in a frame, beside the feet that do stand.
    pub fn sensed(&self, truth: &RobotState) -> Sensed {
        let estimate = self.estimate();
        let (velocity, position) = (estimate.velocity_in_base.into(), (estimate.position + self.origin).into());
        let true_contacts = truth.feet.map(|foot| foot.stands());
        Sensed { velocity, height_m: estimate.height_m, position, contacts: self.touching, true_contacts }
    }

    fn estimate(&self) -> &Estimate {
        // `new` fails without a first estimate, and the estimator keeps the last one for good.
        self.estimator.estimate().unwrap_or_else(|| unreachable!("senses start with an estimate"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::policy::{Controller, shipped};
    use crate::scenario::catalog::{Scenario, Walk, defaults};
    use crate::scenario::estimation::Estimation;
    use crate::scenario::trace::{EventKind, Trace};
    use crate::scenario::{Playback, Script};
    use crate::task::Command;

    fn walk(duration_s: f64) -> (Script, Config) {
        let config = Config::load("compliant").unwrap();
        let mut walk: Walk = defaults("walk").unwrap();
        walk.task.duration_s = duration_s;
        (Scenario::Walk(walk).script(0, &config).unwrap(), config)
    }

    /// A controller that holds the nominal pose and records what it is given.
    #[derive(Default)]
    struct Witness {
        seen: Vec<RobotState>,
    }

    impl Controller for &mut Witness {
        fn rest(&self) -> Joints {
            crate::robot::same_in_every_leg([0.0, 0.72, -1.44])
        }

        fn begin(&mut self, state: &RobotState) {
            self.seen.push(state.clone());
        }

        fn joint_targets(&mut self, state: &RobotState, _: &Command) -> Joints {
            self.seen.push(state.clone());
            self.rest()
        }
    }

    fn play(script: &Script, config: &Config, seed: u64) -> (Vec<RobotState>, Trace) {
        let mut witness = Witness::default();
        let rollout = Playback::new(script, config, Box::new(&mut witness)).unwrap();
        let trace = rollout.with_sensing(Sensing::Estimated, seed).unwrap().trace();
        (witness.seen, trace)
    }

    #[test]
    fn controller_sees_estimates_and_never_the_truth() {
        let (script, config) = walk(0.5);
        let (seen, trace) = play(&script, &config, 1);
        assert_eq!(seen.len(), trace.frames.len() + 1);
        // The first state is shown twice: to begin with, and for the first action. The last is not acted on.
        for (state, frame) in seen[2..].iter().zip(&trace.frames) {
            let sensed = frame.sensed.unwrap();
            assert_eq!((<[f64; 3]>::from(state.velocity_in_base), state.height), (sensed.velocity, sensed.height_m));
            assert_eq!(state.feet.map(|foot| foot.contact), sensed.contacts);
            let truths = [
                (state.height, frame.height_m),
                (state.velocity_in_base.x, frame.velocity[0]),
                (state.position.x, frame.position[0]),
                (state.joint_angles[4], frame.joint_angles[4]),
                (state.angular_velocity_in_base.z, frame.yaw_rate),
            ];
            for (known, truth) in truths {
                assert!(known != truth && (known - truth).abs() < 0.2, "{known} {truth}");
            }
        }
    }

    #[test]
    fn noise_is_that_of_the_seed() {
        let (script, config) = walk(0.3);
        assert_eq!(play(&script, &config, 1), play(&script, &config, 1));
        assert_ne!(play(&script, &config, 1).0[0], play(&script, &config, 2).0[0]);
    }

    #[test]
    fn the_shipped_policies_walk_on_their_sensors_and_know_how_fast() {
        let (script, _) = walk(3.0);
        for (name, seed) in [("compliant", 0), ("compliant", 1), ("baseline", 0), ("baseline", 1)] {
            let agent = shipped::find(name).unwrap();
            let rollout = Playback::new(&script, &agent.config, agent.controller()).unwrap();
            let trace = rollout.with_sensing(Sensing::Estimated, seed).unwrap().trace();
            assert!(trace.fall().is_none() && trace.frames[179].position[0] > 0.7, "{:?}", trace.events);
            let found = Estimation::of(&trace).unwrap();
            assert!(found.velocity_rmse_m_s < 0.05, "{found:?}");
            assert!(found.height_rmse_m < 0.01, "{found:?}");
            assert!(found.contact_f1.unwrap() > 0.95, "{found:?}");
        }
    }

    #[test]
    fn a_push_is_felt_by_the_imu() {
        let (mut script, config) = walk(1.0);
        let push = crate::world::Push { at_s: 0.5, linear: [0.0, 0.6], ..Default::default() };
        script.disturbances = vec![crate::world::Disturbance::Push(push)];
        let (_, trace) = play(&script, &config, 3);
        // At the end of the step that begins with the push.
        let frame = &trace.frames[30];
        assert!(frame.velocity[1] > 0.2, "{:?}", frame.velocity);
        let error = frame.sensed.unwrap().velocity[1] - frame.velocity[1];
        assert!(error.abs() < 0.15, "{error} of {}", frame.velocity[1]);
    }

    fn broken() -> SensorNoise {
        SensorNoise { accelerometer_density_m_s2_sqrt_hz: f64::NAN, ..SensorNoise::default() }
    }

    fn broken_sensors() -> Sensors {
        Sensors::new(broken(), &mut stream(0, Purpose::Sensor, 0, 0))
    }

    fn senses(sim: &Sim, script: &Script, noise: SensorNoise) -> Result<Senses, SensingError> {
        let network = ContactNetwork::shipped().unwrap();
        Senses::new(network, noise, 0, sim, &script.conditions, &[0.0; 12])
    }

    fn standing() -> (Sim, Script) {
        let (script, config) = walk(1.0);
        let mut sim = Sim::new(&script.scene, &config.simulation, 0.2).unwrap();
        sim.reset(script.conditions, &[0.0; 12]).unwrap();
        (sim, script)
    }

    #[test]
    fn sensors_that_never_read_a_number_are_refused_at_the_start() {
        let (sim, script) = standing();
        let refusal = senses(&sim, &script, broken()).unwrap_err().to_string();
        assert!(refusal.contains("do not start: accelerometer x reads NaN"), "{refusal}");
    }

    #[test]
    fn a_sensor_that_reads_no_number_is_told_once_and_bridged_in_a_walk() {
        let agent = shipped::find("compliant").unwrap();
        let (script, _) = walk(3.0);
        let rollout = Playback::new(&script, &agent.config, agent.controller()).unwrap();
        let mut rollout = rollout.with_sensing(Sensing::Estimated, 0).unwrap();
        let (mut errors, mut events, mut spare) = (Vec::new(), Vec::new(), broken_sensors());
        for step in 0..180 {
            // For five steps: 83 ms.
            if step == 90 || step == 95 {
                std::mem::swap(&mut rollout.senses.as_mut().unwrap().sensors, &mut spare);
            }
            let played = rollout.next().unwrap();
            let frame = played.frame.unwrap();
            errors.push((Vector3::from(frame.sensed.unwrap().velocity) - Vector3::from(frame.velocity)).norm());
            events.extend(played.events);
        }
        let [told] = &events[..] else { panic!("{events:?}") };
        let words = "sensors: accelerometer x reads NaN, expected a finite number; bridged by the other sensor";
        assert_eq!(told.text, words);
        let worst = |steps: std::ops::Range<usize>| errors[steps].iter().copied().fold(0.0, f64::max);
        assert!(worst(90..105) < 0.3 && worst(150..180) < 0.1, "{} {}", worst(90..105), worst(150..180));
    }

    #[test]
    fn encoders_that_are_off_are_off_once() {
        let (mut sim, mut script) = standing();
        script.conditions.encoder_bias[4] = 0.05;
        sim.reset(script.conditions, &[0.0; 12]).unwrap();
        let known = senses(&sim, &script, SensorNoise::default()).unwrap().state();
        let errors: Vec<f64> =
            known.joint_angles.iter().zip(sim.parts().joint_angles(sim.data())).map(|(a, b)| a - b).collect();
        for (joint, error) in errors.iter().enumerate() {
            let offset = if joint == 4 { 0.05 } else { 0.0 };
            // Five standard deviations of the encoders' noise.
            assert!((error - offset).abs() < 0.007, "{errors:?}");
        }
    }

    #[test]
    fn bad_readings_leave_the_last_good_ones_and_a_finite_state() {
        let (sim, script) = standing();
        let mut senses = senses(&sim, &script, SensorNoise::default()).unwrap();
        (0..10).for_each(|_| senses.read(sim.data(), sim.parts()));
        assert_eq!(senses.fault(), Ok(None));
        let good = senses.reading;
        let noise = SensorNoise { rate_rad_s: f64::NAN, ..SensorNoise::default() };
        senses.sensors = Sensors::new(noise, &mut stream(0, Purpose::Sensor, 0, 0));
        for tick in 0..24 {
            senses.read(sim.data(), sim.parts());
            assert_eq!(senses.fault().unwrap().is_some(), tick == 0, "tick {tick}");
            assert_eq!((senses.state().joint_angles, senses.state().joint_rates), (good.angles, good.rates));
            assert!(senses.state().velocity_in_base.norm() < 0.1, "{}", senses.state().velocity_in_base);
        }
        senses.read(sim.data(), sim.parts());
        assert!(matches!(senses.fault(), Err(SensorFault::Silent { sensor: "encoders", .. })));
    }

    #[test]
    fn too_long_a_silence_is_the_end_even_if_it_is_over_before_somebody_asks() {
        let (sim, script) = standing();
        let mut senses = senses(&sim, &script, SensorNoise::default()).unwrap();
        let mut spare = broken_sensors();
        std::mem::swap(&mut senses.sensors, &mut spare);
        (0..24).for_each(|_| senses.read(sim.data(), sim.parts()));
        std::mem::swap(&mut senses.sensors, &mut spare);
        // 25 / 240 Hz = 0.104 s from one reading to the next.
        senses.read(sim.data(), sim.parts());
        assert!(matches!(senses.fault(), Err(SensorFault::Silent { sensor: "IMU", .. })));
    }

    #[test]
    fn broken_sensors_end_a_rollout_with_an_event_that_names_them() {
        let (script, config) = walk(2.0);
        let mut witness = Witness::default();
        let rollout = Playback::new(&script, &config, Box::new(&mut witness)).unwrap();
        let mut rollout = rollout.with_sensing(Sensing::Estimated, 0).unwrap();
        rollout.senses.as_mut().unwrap().sensors = broken_sensors();
        let trace = rollout.trace();
        let [told, end] = &trace.events[..] else { panic!("{:?}", trace.events) };
        assert_eq!((told.kind, end.kind), (EventKind::Disturbance, EventKind::Fault));
        assert!(told.text.contains("accelerometer x reads NaN"), "{}", told.text);
        assert!(end.text.contains("the sensors failed: no reading of the IMU for 0.104 s"), "{}", end.text);
        // Six steps of 1/60 s are bridged, the seventh is not.
        assert_eq!(trace.frames.len(), 6);
    }

    #[test]
    fn physics_of_another_rate_than_the_networks_are_refused() {
        let (mut script, _) = walk(1.0);
        script.scene.timestep_s = 1.0 / 480.0;
        let mut config = Config::load("compliant").unwrap();
        config.simulation.physics_rate_hz = 480;
        let mut witness = Witness::default();
        let rollout = Playback::new(&script, &config, Box::new(&mut witness)).unwrap();
        let refusal = rollout.with_sensing(Sensing::Estimated, 0).err().unwrap().to_string();
        assert!(refusal.contains("the physics run at 480 Hz"), "{refusal}");
    }
}
