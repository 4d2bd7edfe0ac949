//! The force observer of a playback: updated after every physics step with the true state, or with the sensors' readings.

use crate::estimate::external_force::{ExternalForces, ForceFault, ForceObserver, ForceReading, Memory};
use crate::mujoco::{self, Data};
use crate::robot::Joints;
use crate::scenario::senses::{ExactSensors, Senses};
use crate::sim::{Conditions, Parts, Sim, StepObserver};

/// The memory of a [`ForceSense`] between physics steps.
pub(super) type ForceMemory = (Memory, ExactSensors);

/// A [`ForceObserver`] with error-free sensors, which it reads unless it gets [`Senses`]. As a [`StepObserver`] it takes the true state.
#[derive(Debug)]
pub(crate) struct ForceSense {
    observer: ForceObserver,
    exact: ExactSensors,
}

impl ForceSense {
    /// Starts in the present state.
    pub fn new(sim: &Sim, conditions: &Conditions) -> mujoco::Result<Self> {
        Ok(ForceSense { observer: ForceObserver::new(sim.robot())?, exact: ExactSensors::new(sim, conditions) })
    }

    /// Updates the forces with a physics step; to be called from [`StepObserver::forces`], once for each step. `torques` are
    /// those of the motors in the step [N·m]. With `senses`, their last readings count, so call [`Senses::read`] first;
    /// without, the true state.
    pub fn read(
        &mut self,
        data: &Data,
        parts: &Parts,
        torques: &Joints,
        senses: Option<&Senses>,
    ) -> Result<&ExternalForces, ForceFault> {
        let reading = match senses {
            Some(senses) => senses.force_reading(torques),
            None => {
                let (imu, encoders) = self.exact.read(data, parts);
                ForceReading { imu, encoders, torques: *torques, world_from_base: parts.world_from_base(data) }
            }
        };
        self.observer.update(&reading, data.model().timestep_s())
    }

    /// Returns the mean of the forces since the last call, as [`ForceObserver::take_mean`].
    pub fn take_mean(&mut self) -> ExternalForces {
        self.observer.take_mean()
    }

    /// Returns the memory between physics steps.
    pub(super) fn save(&mut self) -> ForceMemory {
        (self.observer.memory().clone(), self.exact.clone())
    }

    /// Continues from the memory of another observer of the same robot.
    pub(super) fn restore(&mut self, (memory, exact): &ForceMemory) {
        self.observer.memory().clone_from(memory);
        self.exact.clone_from(exact);
    }

    /// Starts again in the present state; to be called after the robot has been moved to another place.
    pub fn reset(&mut self, sim: &Sim, conditions: &Conditions) {
        self.exact = ExactSensors::new(sim, conditions);
        self.observer.reset();
    }
}

impl StepObserver for ForceSense {
    fn forces(&mut self, data: &Data, parts: &Parts, torques: &Joints) {
        // A fault is kept as a doubt beside the forces.
        let _ = self.read(data, parts, torques, None);
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{UnitQuaternion, Vector3};
    use rand::{Rng, RngExt};

    use super::*;
    use crate::estimate::SensorNoise;
    use crate::estimate::contact::ContactNetwork;
    use crate::estimate::external_force::Doubt;
    use crate::policy::{Agent, shipped};
    use crate::robot::{JOINTS, JointLosses, Losses, PARTS, Robot};
    use crate::sim::Scene;
    use crate::task::Command;
    use crate::util::random::{Purpose, stream};

    const CONDITIONS: Conditions =
        Conditions { gravity: [0.0, 0.0, -9.81], friction: 0.8, encoder_bias: [0.0; JOINTS] };

    fn random(rng: &mut impl Rng, size: f64) -> Vector3<f64> {
        Vector3::from_fn(|_, _| rng.random_range(-size..size))
    }

    /// Sets a force on body `body` that acts at `point`, world frame.
    fn apply(data: &mut Data, body: usize, point: Vector3<f64>, force: Vector3<f64>) {
        let pose = data.body_pose(body);
        let centre = pose.translation.vector + pose.rotation * Vector3::from(data.model().body_centre_of_mass(body));
        let applied = &mut data.applied_forces_mut()[6 * body..][..6];
        applied[..3].copy_from_slice(force.as_slice());
        applied[3..].copy_from_slice((point - centre).cross(&force).as_slice());
    }

    #[test]
    fn known_forces_on_a_tumbling_robot_are_found() {
        let agent = shipped::find("baseline").unwrap();
        let mut rng = stream(1, Purpose::Episode, 0, 0);
        for trial in 0..60 {
            let robot = Robot::load(["go1", "go2", "tests/fixtures/robot/quadruped.xml"][trial % 3]).unwrap();
            let damping = if trial < 30 { 0.0 } else { 0.5 };
            let robot = robot.with_losses(Losses { friction_n_m: 0.0, damping_n_m_s_per_rad: damping });
            let mut sim = Sim::new(&Scene::flat(robot, 1.0 / 240.0), &agent.config.simulation, 0.2).unwrap();
            sim.reset(CONDITIONS, &[0.0; JOINTS]).unwrap();
            let turn = UnitQuaternion::from_scaled_axis(random(&mut rng, 1.5));
            let positions = sim.data_mut().positions_mut();
            positions[2] = 5.0;
            positions[3..7].copy_from_slice(&[turn.w, turn.i, turn.j, turn.k]);
            positions[7..].iter_mut().for_each(|angle| *angle += rng.random_range(-0.3..0.3));
            sim.data_mut().velocities_mut().iter_mut().for_each(|rate| *rate = rng.random_range(-4.0..4.0));
            sim.refresh().unwrap();
            let (parts, heading) = (sim.parts().clone(), sim.state().heading());
            let (pull, moment, mut feet) = (random(&mut rng, 50.0), random(&mut rng, 10.0), [Vector3::zeros(); 4]);
            for (leg, force) in feet.iter_mut().enumerate() {
                let foot = parts.feet()[leg];
                let radius = sim.robot().legs[leg].foot_radius_m;
                let centre = Vector3::from_column_slice(&sim.data().geom_positions()[3 * foot..][..3]);
                let calf = sim.data().model().joint_body(parts.joints()[PARTS.len() * leg + 2]);
                *force = random(&mut rng, 80.0);
                apply(sim.data_mut(), calf, centre - radius * Vector3::z(), *force);
            }
            let trunk = &mut sim.data_mut().applied_forces_mut()[6 * parts.trunk()..][..6];
            trunk[..3].copy_from_slice(pull.as_slice());
            trunk[3..].copy_from_slice(moment.as_slice());
            let torques = std::array::from_fn(|_| rng.random_range(-15.0..15.0));
            parts.set_torques(sim.data_mut(), &torques);

            let mut sense = ForceSense::new(&sim, &CONDITIONS).unwrap();
            sense.read(sim.data(), &parts, &torques, None).unwrap();
            sim.data_mut().step2().unwrap();
            let found = *sense.read(sim.data(), &parts, &torques, None).unwrap();
            let close = |found: Vector3<f64>, truth: Vector3<f64>| (heading * found - truth).norm() < 1e-7;
            assert!(close(found.force, pull) && close(found.moment, moment), "{trial}: {found:?}");
            assert!((0..4).all(|leg| close(found.feet[leg], feet[leg])), "{trial}: {found:?}");
        }
    }

    /// Passes the forces of physics steps, grouped by policy step, through the low-pass.
    fn low_passed(mut felt: Vec<Vec<ExternalForces>>) -> Vec<Vec<ExternalForces>> {
        let mut low = ExternalForces::default();
        for felt in felt.iter_mut().flatten() {
            low.follow(felt, 1.0 / 240.0);
            *felt = low;
        }
        felt
    }

    /// A robot that walks at 0.5 m/s, and its felt forces.
    struct WalkingRobot {
        agent: Agent,
        sim: Sim,
        tap: ForceTap,
    }

    struct ForceTap {
        sense: ForceSense,
        senses: Option<Senses>,
        felt: Vec<ExternalForces>,
    }

    impl StepObserver for ForceTap {
        fn forces(&mut self, data: &Data, parts: &Parts, torques: &Joints) {
            self.senses.iter_mut().for_each(|senses| senses.read(data, parts));
            self.felt.push(*self.sense.read(data, parts, torques, self.senses.as_ref()).unwrap());
        }
    }

    impl WalkingRobot {
        /// Noise of this seed, or the true state; the joints are as the policy's configuration has them, or lossy.
        fn new(policy: &str, losses: JointLosses, noise: Option<u64>) -> Self {
            let agent = shipped::find(policy).unwrap();
            let robot = agent.config.robot.load().unwrap().with_losses(losses.into());
            let scene = Scene::flat(robot, agent.config.simulation.timestep_s());
            let mut sim = Sim::new(&scene, &agent.config.simulation, 0.2).unwrap();
            let rest = agent.controller().rest();
            sim.reset(CONDITIONS, &rest).unwrap();
            let senses = |seed| {
                let network = ContactNetwork::shipped().unwrap();
                Senses::new(network, SensorNoise::default(), seed, &sim, &CONDITIONS, &rest).unwrap()
            };
            let senses = noise.map(senses);
            let sense = ForceSense::new(&sim, &CONDITIONS).unwrap();
            WalkingRobot { agent, sim, tap: ForceTap { sense, senses, felt: Vec::new() } }
        }

        /// Plays from a standstill. `act` is called before each policy step. Returns the felt forces of each step.
        fn play(&mut self, seconds: f64, mut act: impl FnMut(&mut Sim, usize)) -> Vec<Vec<ExternalForces>> {
            let mut controller = self.agent.controller();
            let steps = self.agent.config.simulation.policy_steps(seconds);
            let step = |step: usize| {
                act(&mut self.sim, step);
                let state = self.tap.senses.as_ref().map_or_else(|| self.sim.state(), Senses::state);
                if step == 0 {
                    controller.begin(&state);
                }
                let target = controller.joint_targets(&state, &Command::velocity(0.5, 0.0, 0.0));
                self.tap.senses.iter_mut().for_each(|senses| senses.act(&target));
                self.sim.step(&target, &mut self.tap).unwrap();
                std::mem::take(&mut self.tap.felt)
            };
            (0..steps).map(step).collect()
        }

        /// Root mean square of the horizontal error under a steady pull in the world, and its mean and standard deviation
        /// along and across, from the third second on \[N\].
        fn errors(mut self, pull: [f64; 2]) -> (f64, [[f64; 2]; 2]) {
            let pull = Vector3::new(pull[0], pull[1], 0.0);
            let mut headings = Vec::new();
            let felt = self.play(6.0, |sim, step| {
                headings.push(sim.state().heading());
                if step == 90 {
                    sim.set_trunk_force(pull);
                }
            });
            let felt = low_passed(felt);
            let late = felt
                .iter()
                .zip(&headings)
                .skip(180)
                .flat_map(|(felt, heading)| felt.iter().map(move |it| (it, heading)));
            let errors: Vec<_> = late
                .map(|(felt, heading)| {
                    assert_eq!(felt.doubt, None);
                    felt.force - heading.inverse() * pull
                })
                .collect();
            let mean = |of: &dyn Fn(&Vector3<f64>) -> f64| errors.iter().map(of).sum::<f64>() / errors.len() as f64;
            let statistics = [0, 1].map(|axis| {
                let average = mean(&|error| error[axis]);
                [average, mean(&|error| (error[axis] - average).powi(2)).sqrt()]
            });
            (mean(&|error| error.xy().norm_squared()).sqrt(), statistics)
        }
    }

    #[test]
    fn steady_pulls_on_walking_robots_are_felt() {
        for policy in ["baseline", "go2/baseline"] {
            // Ideal joints, joints with dry friction, and sensors, whose accelerometer is off by 0.05 m/s² on each axis.
            let cases = [(JointLosses::Ideal, None), (JointLosses::Realistic, None), (JointLosses::Ideal, Some(1))];
            for ((losses, noise), (limit, calm)) in cases.into_iter().zip([(0.5, 0.1), (0.5, 0.3), (1.5, 1.0)]) {
                for pull in [[0.0, 0.0], [20.0, 0.0], [-14.0, 14.0], [0.0, -20.0]] {
                    let (rms, statistics) = WalkingRobot::new(policy, losses, noise).errors(pull);
                    let limit = if pull == [0.0; 2] { calm } else { limit };
                    assert!(rms < limit, "{policy}, {losses:?}, {noise:?}, {pull:?}: {rms:.3} {statistics:.3?}");
                }
            }
        }
    }

    #[test]
    fn unfiltered_force_of_a_push_integrates_to_its_impulse() {
        for linear in [[0.0, 0.5], [0.5, 0.0], [-0.5, 0.0], [0.0, -0.5]] {
            let mut walk = WalkingRobot::new("baseline", JointLosses::Ideal, None);
            let felt = walk.play(2.1, |sim, step| {
                if step == 120 {
                    sim.push(linear, [0.0; 3]).unwrap()
                }
            });
            assert!(felt[100..].iter().flatten().all(|felt| felt.doubt.is_none()), "{linear:?}");
            let along = |felt: &ExternalForces| 2.0 * (felt.force.x * linear[0] + felt.force.y * linear[1]);
            let impulse: f64 = felt[120].iter().map(|felt| along(felt) / 240.0).sum();
            // A push changes the velocity of all parts: the part of the legs is felt at the feet.
            let momentum = 0.5 * walk.sim.robot().mass_kg;
            assert!((0.8..1.05).contains(&(impulse / momentum)), "{linear:?}: {impulse} {momentum}");
        }
    }

    #[test]
    fn fallen_robot_is_doubted_and_a_fresh_start_is_not() {
        let mut walk = WalkingRobot::new("baseline", JointLosses::Ideal, None);
        let pull =
            |sim: &mut Sim, step| sim.set_trunk_force(if step < 60 { Vector3::y() * 150.0 } else { Vector3::zeros() });
        let felt = walk.play(4.0, pull);
        assert!(felt[200..].iter().flatten().all(|felt| felt.doubt.is_some()), "{:?}", felt[239]);
        walk.sim.reset(CONDITIONS, &walk.agent.controller().rest()).unwrap();
        walk.tap.sense.reset(&walk.sim, &CONDITIONS);
        let felt = low_passed(walk.play(1.0, |_, _| ()));
        assert_eq!(felt[0][0].doubt, Some(Doubt::Starting));
        assert!(felt.iter().flatten().skip(1).all(|felt| felt.doubt.is_none() && felt.force.norm() < 1.0));
    }
}
