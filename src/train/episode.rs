/*! The plan of an episode: conditions, disturbances and the two curricula (sections III-C and III-D).

An episode's conditions are drawn together when it starts, from its own random stream, and are plain data from then on.
*/

use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use super::deviation::{self, ImuErrors};
use crate::config::{CommandRange, Config, Pulls};
use crate::observation::Command;
use crate::robot::{GRAVITY_M_S2, JOINTS};
use crate::sim::{Conditions, Dynamics};
use crate::task::Stages;
use crate::world::{Disturbance, Pull, Push};

/// Everything random about an episode except the policy's noise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct EpisodePlan {
    /// The command of the episode.
    pub command: Command,
    /// Slope, friction and encoder bias.
    pub conditions: Conditions,
    /// True if the robot is pushed at the start of the recovery stage; without a push the episode ends there.
    pub is_pushed: bool,
    /// The push, the sustained pulls in order of time (world frame), and the times at
    /// which feet may be held. They move into the world when the episode begins.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub disturbances: Vec<Disturbance>,
    /// The dynamics of the robot; `None` if they are those of its description.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dynamics: Option<Dynamics>,
    /// The constant errors of the inertial sensor; `None` if it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub imu: Option<ImuErrors>,
}

impl EpisodePlan {
    /// Draws the random part of an episode from its stream.
    pub fn draw(config: &Config, curriculum: Curriculum, rng: &mut impl Rng) -> Self {
        let mut within = |range: f64| range * rng.random_range(-1.0..=1.0);
        let open = curriculum.command_fraction;
        let mut command = Command::velocity(
            within(config.command.forward_m_s * open),
            within(config.command.left_m_s * open),
            within(config.command.yaw_rad_s * open),
        );
        let episode = &config.episode;
        let push = Push {
            at_s: Stages::new(episode, &config.simulation).recovery_start as f64 * config.simulation.policy_period_s(),
            linear: std::array::from_fn(|_| within(episode.push_speed_m_s)),
            angular: std::array::from_fn(|_| within(episode.push_rate_rad_s)),
            for_s: 0.0,
        };
        let slope = episode.slope * rng.random_range(0.0..=1.0);
        let uphill = rng.random_range(-std::f64::consts::PI..=std::f64::consts::PI);
        let randomisation = &config.randomisation;
        let [low, high] = randomisation.friction;
        // Drawn in any case, so that switching on the paper's randomisation changes nothing else.
        let friction = rng.random_range(low..=high);
        let encoder_bias: [f64; JOINTS] =
            std::array::from_fn(|_| randomisation.encoder_bias_sd_rad * rng.sample::<f64, _>(StandardNormal));
        let conditions = Conditions {
            gravity: tilted_gravity(slope, uphill),
            friction: if randomisation.enabled { friction } else { randomisation.default_friction },
            encoder_bias: if randomisation.enabled { encoder_bias } else { [0.0; JOINTS] },
        };
        let length_s = episode.walking_s + episode.recovery_s + episode.post_recovery_s;
        let drawn = |pulls| drawn_pulls(pulls, curriculum.force_fraction, length_s, rng);
        let pulls = config.pulls.as_ref().map_or_else(Vec::new, drawn);
        let dynamics = deviation::dynamics(randomisation, &config.simulation, rng);
        let imu = ImuErrors::draw(randomisation, rng);
        let drawn = |held| deviation::holds(held, length_s, rng);
        let holds = config.held_feet.as_ref().filter(|_| curriculum.pushes).map_or_else(Vec::new, drawn);
        // The push was drawn in any case, too.
        let is_pushed = curriculum.pushes;
        let push = is_pushed.then_some(Disturbance::Push(push));
        let pulls = pulls.into_iter().map(Disturbance::Pull);
        let disturbances = push.into_iter().chain(pulls).chain(holds.into_iter().map(Disturbance::Hold)).collect();
        if let Some([low, high]) = config.reward.reference_m_s_per_n {
            command.compliance = Some(rng.random_range(low..=high));
        }
        EpisodePlan { command, conditions, is_pushed, disturbances, dynamics, imu }
    }

    /// Returns the push, if there is one.
    pub fn push(&self) -> Option<&Push> {
        self.disturbances.iter().find_map(|it| if let Disturbance::Push(push) = it { Some(push) } else { None })
    }
}

/// Draws pulls from any side, with pauses, until the end of the episode; `open` is the open fraction of the largest
/// force.
fn drawn_pulls(range: &Pulls, open: f64, length_s: f64, rng: &mut impl Rng) -> Vec<Pull> {
    let mut pulls = Vec::new();
    let [weakest, strongest] = match &range.buckets[..] {
        [] => [0.0, 1.0],
        ends => {
            let bucket = rng.random_range(0..ends.len());
            [if bucket == 0 { 0.0 } else { ends[bucket - 1] }, ends[bucket]]
        }
    };
    let full_n = range.force_n * open;
    let mut within = |[low, high]: [f64; 2]| rng.random_range(low..=high);
    let mut time_s = within(range.gap_s);
    while time_s < length_s {
        let until_s = time_s + within(range.duration_s);
        let (size, angle) = (within([weakest * full_n, strongest * full_n]), within([0.0, std::f64::consts::TAU]));
        pulls.push(Pull::constant([time_s, until_s], [size * angle.cos(), size * angle.sin()]));
        time_s = until_s + within(range.gap_s);
    }
    pulls
}

/// Returns gravity in the frame of a slope (rise over run) that rises towards `uphill` [rad from forward] [m/s²].
pub fn tilted_gravity(slope: f64, uphill: f64) -> [f64; 3] {
    let tilt = slope.atan();
    [-GRAVITY_M_S2 * tilt.sin() * uphill.cos(), -GRAVITY_M_S2 * tilt.sin() * uphill.sin(), -GRAVITY_M_S2 * tilt.cos()]
}

/// The curriculum: episodes get harder as walking gets better (section III-D).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Curriculum {
    /// Open fraction of the command range, 0 to 1.
    pub command_fraction: f64,
    /// True if episodes include the push and recovery. Never becomes false again.
    pub pushes: bool,
    /// The open fraction of the pulls' largest force, 0 to 1. It grows once there are pushes.
    pub force_fraction: f64,
}

impl Curriculum {
    /// Returns the initial curriculum: a part of the command range, and no pushes.
    pub fn new(range: &CommandRange) -> Self {
        Curriculum { command_fraction: range.initial_fraction, pushes: false, force_fraction: 0.0 }
    }

    /// Returns the final curriculum: all commands, pushes and pulls of the configuration.
    pub fn complete() -> Self {
        Curriculum { command_fraction: 1.0, pushes: true, force_fraction: 1.0 }
    }

    /// Advances the curriculum with the mean `r_lin` of the walking stages of an iteration that began after so many samples.
    pub fn update(&mut self, mean_linear_reward: f64, samples: u64, config: &Config) {
        if mean_linear_reward > config.command.fraction_gate {
            self.command_fraction = (self.command_fraction + config.command.fraction_step).min(1.0);
        }
        let episode = &config.episode;
        self.pushes |= samples >= episode.push_from_samples && mean_linear_reward > episode.push_gate;
        let walks = |pulls: &&Pulls| self.pushes && mean_linear_reward > pulls.fraction_gate;
        if let Some(pulls) = config.pulls.as_ref().filter(walks) {
            self.force_fraction = (self.force_fraction + pulls.fraction_step).min(1.0);
        }
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use crate::util::random::{Purpose, stream};

    fn config() -> Config {
        Config::load("compliant").unwrap()
    }

    fn pulls(plan: &EpisodePlan) -> impl Iterator<Item = &Pull> {
        plan.disturbances.iter().filter_map(|it| if let Disturbance::Pull(pull) = it { Some(pull) } else { None })
    }

    /// Returns pulls of up to 50 N.
    pub(crate) fn pulls_of_50_n(duration_s: [f64; 2], gap_s: [f64; 2]) -> Pulls {
        let (force_n, fraction_step, fraction_gate) = (50.0, 0.001, 0.8);
        Pulls { force_n, duration_s, gap_s, fraction_step, fraction_gate, buckets: Vec::new() }
    }

    #[test]
    fn ten_percent_slope_tilts_gravity_by_5_71_degrees_and_keeps_its_size() {
        let [x, y, z] = tilted_gravity(0.1, 0.0);
        // sin(atan 0.1) = 0.0995037
        assert!((x + 9.81 * 0.099_503_719).abs() < 1e-6 && y.abs() < 1e-12);
        assert!(((x * x + y * y + z * z).sqrt() - GRAVITY_M_S2).abs() < 1e-12);
    }

    #[test]
    fn drawn_episodes_stay_within_their_ranges_and_fill_them() {
        let config = config();
        let half = Curriculum { command_fraction: 0.5, ..Curriculum::complete() };
        let plans: Vec<EpisodePlan> =
            (0..2000).map(|k| EpisodePlan::draw(&config, half, &mut stream(3, Purpose::Episode, 0, k))).collect();
        let largest = |of: fn(&EpisodePlan) -> f64| plans.iter().map(|plan| of(plan).abs()).fold(0.0, f64::max);
        let near = |value: f64, limit: f64| value <= limit && value > 0.98 * limit;
        assert!(near(largest(|plan| plan.command.forward), 0.5));
        assert!(near(largest(|plan| plan.command.left), 0.25));
        assert!(near(largest(|plan| plan.command.yaw), 0.25));
        assert!(near(largest(|plan| plan.push().unwrap().linear[1]), 1.0));
        assert!(near(largest(|plan| plan.push().unwrap().angular[2]), 1.0));
        assert!(near(largest(|plan| plan.conditions.gravity[0]), 0.977));
        assert!(plans.iter().all(|plan| plan.conditions.friction == 0.8));
    }

    #[test]
    fn randomisation_changes_friction_and_offsets_only() {
        let (off, mut on) = (config(), config());
        on.randomisation.enabled = true;
        let draw = |config| EpisodePlan::draw(config, Curriculum::complete(), &mut stream(1, Purpose::Episode, 2, 3));
        let (off, on) = (draw(&off), draw(&on));
        assert_eq!((off.command, off.push(), off.conditions.gravity), (on.command, on.push(), on.conditions.gravity));
        assert_ne!((on.conditions.friction, on.conditions.encoder_bias), (0.8, [0.0; JOINTS]));
    }

    #[test]
    fn randomised_friction_and_encoder_bias_have_their_ranges() {
        let mut config = config();
        config.randomisation.enabled = true;
        let drawn: Vec<Conditions> = (0..2000)
            .map(|k| {
                EpisodePlan::draw(&config, Curriculum::complete(), &mut stream(1, Purpose::Episode, 0, k)).conditions
            })
            .collect();
        let frictions = || drawn.iter().map(|conditions| conditions.friction);
        let [least, most] = [frictions().fold(f64::INFINITY, f64::min), frictions().fold(0.0, f64::max)];
        assert!((0.5..0.51).contains(&least) && (1.19..=1.2).contains(&most), "{least} {most}");
        let squares: f64 = drawn.iter().flat_map(|c| c.encoder_bias).map(|offset| offset * offset).sum();
        let sd = (squares / (2000.0 * JOINTS as f64)).sqrt();
        assert!((sd / 0.01 - 1.0).abs() < 0.02, "{sd}");
    }

    #[test]
    fn command_range_opens_only_above_its_gate_and_stops_at_one() {
        let config = config();
        let mut curriculum = Curriculum::new(&config.command);
        curriculum.update(0.69, 0, &config);
        assert_eq!(curriculum.command_fraction, 0.5);
        for _ in 0..100 {
            curriculum.update(0.71, 0, &config);
        }
        assert_eq!(curriculum.command_fraction, 1.0);
    }

    #[test]
    fn pushes_begin_above_their_gate_and_stay_on_below_it() {
        let mut config = config();
        config.episode.push_from_samples = 100;
        let mut curriculum = Curriculum::new(&config.command);
        let push =
            |curriculum| EpisodePlan::draw(&config, curriculum, &mut stream(1, Purpose::Episode, 0, 0)).push().copied();
        curriculum.update(0.84, 100, &config);
        assert_eq!(push(curriculum), None);
        curriculum.update(0.86, 99, &config);
        assert_eq!(push(curriculum), None);
        curriculum.update(0.86, 100, &config);
        let first = push(curriculum);
        assert!(first.is_some());
        curriculum.update(0.5, 108, &config);
        assert_eq!(push(curriculum), first);
    }

    #[test]
    fn pulls_of_an_episode_come_from_one_bucket() {
        let mut config = Config::load("fast").unwrap();
        let buckets = vec![0.0, 0.2, 0.5, 1.0];
        config.pulls = Some(Pulls { buckets, ..pulls_of_50_n([0.2, 0.4], [0.1, 0.2]) });
        let mut counts = [0; 4];
        for k in 0..1000 {
            let plan = EpisodePlan::draw(&config, Curriculum::complete(), &mut stream(1, Purpose::Episode, k, 0));
            let forces: Vec<f64> = pulls(&plan).map(|pull| pull.force[0].hypot(pull.force[1])).collect();
            // Up to rounding of the sine and the cosine.
            let within = |[low, high]: [f64; 2]| forces.iter().all(|force| (low - 1e-9..=high + 1e-9).contains(force));
            let bucket = [[0.0, 0.0], [0.0, 10.0], [10.0, 25.0], [25.0, 50.0]].into_iter().position(within);
            counts[bucket.unwrap_or_else(|| panic!("{forces:?} are of no bucket"))] += 1;
        }
        assert!(counts.iter().all(|count| (200..300).contains(count)), "{counts:?}");
    }

    #[test]
    fn pulls_grow_with_the_curriculum() {
        let range = pulls_of_50_n([0.5, 2.5], [0.2, 1.5]);
        let without = Config::load("fast").unwrap();
        let config = Config { pulls: Some(range), ..without.clone() };
        let plans = |force_fraction: f64| -> Vec<EpisodePlan> {
            let curriculum = Curriculum { force_fraction, ..Curriculum::complete() };
            (0..500).map(|k| EpisodePlan::draw(&config, curriculum, &mut stream(1, Purpose::Episode, k, 0))).collect()
        };
        let strongest = |plans: &[EpisodePlan]| {
            let forces = plans.iter().flat_map(pulls).map(|pull| pull.force[0].hypot(pull.force[1]));
            forces.fold(0.0, f64::max)
        };
        assert_eq!(strongest(&plans(0.0)), 0.0);
        assert!((0.45..=0.5).contains(&(strongest(&plans(0.5)) / 50.0)));
        let open = plans(1.0);
        assert!((0.9..=1.0).contains(&(strongest(&open) / 50.0)));
        // One after the other, with pauses, to the end of the episode.
        let episode = &config.episode;
        let length_s = episode.walking_s + episode.recovery_s + episode.post_recovery_s;
        for pulls in open.iter().map(|plan| pulls(plan).collect::<Vec<_>>()) {
            assert!(pulls.windows(2).all(|pair| pair[1].from_s - pair[0].until_s >= 0.2));
            assert!(pulls.last().is_some_and(|last| last.until_s + 1.5 >= length_s));
        }
        // Everything else is drawn as without pulls.
        let plan = EpisodePlan::draw(&without, Curriculum::complete(), &mut stream(1, Purpose::Episode, 0, 0));
        let others = open[0].disturbances.iter().filter(|it| !matches!(it, Disturbance::Pull(_))).cloned().collect();
        assert_eq!(plan, EpisodePlan { disturbances: others, ..open[0].clone() });
        // The fraction grows only once there are pushes and the robot walks well.
        let mut curriculum = Curriculum::new(&config.command);
        curriculum.update(0.79, 0, &config);
        assert_eq!(curriculum.force_fraction, 0.0);
        curriculum.update(0.95, 0, &config);
        assert_eq!(curriculum.force_fraction, 0.001);
    }
}
