//! Training data for the contact network: encoder readings, and which feet stand, while a policy walks on different ground and is pushed.

use rand::RngExt;
use supple::estimate::contact::ContactHistory;
use supple::estimate::contact::learn::ContactSamples;
use supple::estimate::{EncoderReading, SensorNoise, Sensors};
use supple::mujoco::Data;
use supple::policy::Agent;
use supple::robot::{FootState, Foothold, Joints};
use supple::scenario::catalog::Scenario;
use supple::sim::{Parts, Scene, Sim, StepObserver};
use supple::task::Command;
use supple::train::{Curriculum, EpisodePlan};
use supple::util::random::{Purpose, stream};

/// Length of an episode without a fall \[s\].
const EPISODE_S: f64 = 6.0;

/// Range of the push's time \[s\].
const PUSH_S: std::ops::Range<f64> = 2.0..3.5;

/// One in this number of episodes commands the robot to stand, which random commands never do: from the start on a plane, after
/// [`STANDS_S`] on other ground. It has no factor in common with the number of grounds, so that all of them get their share.
const STANDING: u64 = 7;

/// Time after which a robot stands that has to reach its ground first \[s\].
const STANDS_S: f64 = 4.0;

/// Scenarios and parameters whose ground the episodes have in turn; `None` is a plane.
const GROUNDS: [Option<(&str, &str)>; 6] = [
    None,
    Some(("ball-pit", "{balls: 150}")),
    None,
    Some(("rubble", "{}")),
    None,
    Some(("terrain", "{kind: slope, incline: 0.2}")),
];

/// Least forward velocity \[m/s\] where the ground is not a plane: obstacles begin in front of the robot.
const LEAST_FORWARD_M_S: f64 = 0.3;

/// Plays episode `which[0]` of policy `which[1]`: command, slope, friction, encoder bias and push as in training with
/// dynamics randomisation, on one of the [`GROUNDS`]. The episode ends at a fall, because the contacts of a fallen robot are not
/// those of walking.
///
/// # Errors
/// The observation does not fit the robot, or MuJoCo fails.
pub fn episode(agent: &Agent, noise: SensorNoise, seed: u64, which: [u64; 2]) -> anyhow::Result<ContactSamples> {
    let mut config = agent.config.clone();
    config.randomisation.enabled = true;
    let mut rng = stream(seed, Purpose::Episode, which[0], which[1]);
    let mut plan = EpisodePlan::draw(&config, Curriculum::complete(), &mut rng);
    let ground = GROUNDS[which[0] as usize % GROUNDS.len()];
    if ground.is_some() {
        plan.command.forward = plan.command.forward.abs().max(LEAST_FORWARD_M_S);
    }
    let push_step = config.simulation.policy_steps(rng.random_range(PUSH_S));
    let stand_step = match (which[0] % STANDING == STANDING - 1, ground) {
        (false, _) => usize::MAX,
        (true, None) => 0,
        (true, Some(_)) => config.simulation.policy_steps(STANDS_S),
    };

    let simulation = &config.simulation;
    let scene = match ground {
        None => Scene::flat(config.robot.load()?, simulation.timestep_s()),
        Some((scenario, parameters)) => Scenario::named(scenario, parameters)?.script(rng.random(), &config)?.scene,
    };
    let mut sim = Sim::new(&scene, simulation, config.episode.min_height_m)?;
    let mut controller = agent.controller();
    sim.reset(plan.conditions, &controller.rest())?;
    controller.begin(&sim.state());
    let mut sensor_rng = stream(seed, Purpose::Sensor, which[0], which[1]);
    let (sensors, offsets) = (Sensors::new(noise, &mut sensor_rng), plan.conditions.encoder_bias);
    let (target, history, velocities) = (controller.rest(), ContactHistory::default(), [[0.0; 3]; 4]);
    let samples = ContactSamples::default();
    let mut recorder = SampleRecorder { sensors, rng: sensor_rng, offsets, target, history, velocities, samples };
    let mut felt_force = [0.0; 2];
    for step in 0..simulation.policy_steps(EPISODE_S) {
        if step == stand_step {
            plan.command = Command::default();
        }
        let mut state = sim.state();
        state.felt_force = Some(std::mem::take(&mut felt_force));
        recorder.target = controller.joint_targets(&state, &plan.command);
        if let (true, Some(push)) = (step == push_step, plan.push()) {
            // As in training: a force for one step, which the policy observes after it.
            felt_force = push.linear.map(|speed| speed * sim.robot().mass_kg / simulation.policy_period_s());
            sim.push(push.linear, push.angular)?;
        }
        if sim.step(&recorder.target.clone(), &mut recorder)?.fall.is_some() {
            break;
        }
    }
    Ok(recorder.samples)
}

/// An observer that reads encoders, and which feet stand, in every physics step.
struct SampleRecorder<R> {
    sensors: Sensors,
    rng: R,
    offsets: Joints,
    target: Joints,
    history: ContactHistory,
    /// Velocity of each foot, world frame [m/s].
    velocities: [[f64; 3]; 4],
    samples: ContactSamples,
}

impl<R: rand::Rng> StepObserver for SampleRecorder<R> {
    fn forces(&mut self, data: &Data, parts: &Parts, _: &Joints) {
        let exact = EncoderReading::exact(&parts.joint_angles(data), parts.joint_rates(data), &self.offsets);
        let reading = self.sensors.encoders(&exact, data.model().timestep_s(), &mut self.rng);
        self.history.push(&reading, &self.target);
        // Velocities at the beginning of the step: within a physics step, they hardly change.
        self.velocities = parts.foot_velocities(data);
    }

    fn feet(&mut self, feet: &[Foothold; 4]) {
        self.samples.inputs.extend(self.history.inputs());
        for (Foothold { height, contact }, velocity) in feet.iter().zip(self.velocities) {
            let foot = FootState { height: *height, contact: *contact, velocity };
            self.samples.labels.push(f32::from(u8::from(foot.stands())));
        }
    }
}
