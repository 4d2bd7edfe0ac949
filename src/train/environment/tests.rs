//! Tests of the training environment.

use super::*;
use crate::config::{Pulls, Terrain};
use crate::observation::{Observed, Quantity};
use crate::robot::RobotState;
use crate::train::episode::tests::pulls_of_50_n;
use crate::world::{Disturbance, Hold, Pull, Push};

/// Gives the present episode, which has just begun, other disturbances.
fn replan<const N: usize>(env: &mut LocomotionEnv, disturbances: [Disturbance; N]) {
    env.progress.plan.disturbances = disturbances.into();
    (env.progress.observer, env.progress.critic_observer) = (Observer::new(), Observer::new());
    env.begin().unwrap();
}

/// Returns an action of a clumsy trot.
fn action(step: usize) -> [f32; 12] {
    std::array::from_fn(|joint| {
        let phase = step as f32 * 0.3 + if matches!(joint / 3, 0 | 3) { 0.0 } else { std::f32::consts::PI };
        0.8 * (phase + (joint % 3) as f32).sin()
    })
}

#[test]
fn an_episode_tells_the_fraction_of_its_time_in_flight() {
    let mut config = Config::load("compliant").unwrap();
    config.episode.walking_s = 0.25;
    // From 0.5 m above the ground, a fall takes 0.32 s: longer than the episode.
    for (lifted_m, expected) in [(0.0, 0.0), (0.5, 1.0)] {
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
        env.reset(Curriculum::new(&config.command)).unwrap();
        env.sim_mut().data_mut().positions_mut()[2] += lifted_m;
        env.sim_mut().refresh().unwrap();
        let report = (0..15).find_map(|_| env.step(&[0.0; 12]).1).unwrap();
        assert_eq!((report.end, report.terms.flight()), (EpisodeEnd::TimeLimit, 15.0 * expected));
    }
}

#[test]
fn a_restarted_environment_has_the_bits_of_a_new_one() {
    let mut config = Config::load("compliant").unwrap();
    config.episode.walking_s = 0.5;
    let curriculum = Curriculum::complete();
    let mut used = LocomotionEnv::new(&config, 1, 2, curriculum).unwrap();
    // Into the second episode, in the middle of a step's latency.
    for step in 0..40 {
        if used.step(&action(step)).0.end.is_some() {
            used.reset(curriculum).unwrap();
        }
    }
    used.restart(7, curriculum).unwrap();
    let mut new = LocomotionEnv::new(&config, 7, 2, curriculum).unwrap();
    for step in 0..150 {
        assert_eq!(used.observation(), new.observation(), "step {step}");
        let outcome = used.step(&action(step));
        assert_eq!(outcome, new.step(&action(step)), "step {step}");
        if outcome.0.end.is_some() {
            used.reset(curriculum).unwrap();
            new.reset(curriculum).unwrap();
        }
    }
}

#[test]
fn without_stagger_the_first_episode_is_as_long_as_any() {
    let config = Config::load("compliant").unwrap();
    let steps = |staggered: bool| {
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::new(&config.command)).unwrap();
        if !staggered {
            env.without_stagger();
        }
        (0..200).find_map(|_| env.step(&[0.0; 12]).1).unwrap().steps
    };
    // 2 s at 60 Hz.
    assert_eq!(steps(false), 120);
    assert!(steps(true) < 120);
}

#[test]
fn a_step_tells_its_stage_and_its_terms() {
    let config = Config::load("compliant").unwrap();
    let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
    let (mut terms, mut stages) = (Terms::default(), Vec::new());
    let report = loop {
        let (step, report) = env.step(&[0.0; 12]);
        terms.add(&step.terms);
        stages.push(step.stage);
        if let Some(report) = report {
            break report;
        }
    };
    assert_eq!((report.terms, report.steps), (terms, stages.len()));
    assert!(stages.iter().enumerate().all(|(step, stage)| *stage == env.stages.at(step)));
}

#[test]
fn a_restored_environment_goes_on_with_the_same_bits_from_every_step() {
    let compliant = Config::load("compliant").unwrap();
    let with_pulls = Config { pulls: Some(pulls()), ..compliant.clone() };
    for (name, mut config) in [("plain", compliant), ("with pulls", with_pulls), ("with all", with_all())] {
        config.episode.walking_s = 0.5;
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
        // Somewhere else in another episode; its terrain and its sensor's noise are those of its index.
        let mut other = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
        other.reset(Curriculum::complete()).unwrap();
        for step in 0..200 {
            let json = serde_json::to_string(&env.save()).unwrap();
            other.restore(&serde_json::from_str(&json).unwrap()).unwrap();
            assert_eq!(env.save(), other.save(), "{name}, step {step}");
            let (outcome, report) = env.step(&action(step));
            assert_eq!((outcome, report), other.step(&action(step)), "{name}, step {step}");
            assert_eq!(env.observation(), other.observation(), "{name}, step {step}");
            if outcome.end.is_some() {
                env.reset(Curriculum::complete()).unwrap();
            }
        }
    }
}

/// Returns a configuration whose critic observes what only the simulator knows.
fn privileged(quantities: &[Quantity]) -> Config {
    let critic_observation = quantities.iter().copied().map(Observed::now).collect();
    let mut config = Config { critic_observation, ..Config::load("compliant").unwrap() };
    (config.episode.walking_s, config.episode.slope) = (0.5, 0.0);
    config
}

/// Returns what the critic observes in addition to the policy, of which a test lists the quantities unscaled.
fn added(env: &LocomotionEnv) -> Vec<f32> {
    let [policy, both] = env.inputs();
    let mut seen = vec![0.0; both];
    env.critic_observation(&mut seen);
    let mut of_policy = vec![0.0; policy];
    env.normalised_observation(&mut of_policy);
    assert_eq!(seen[..policy], of_policy);
    seen.split_off(policy)
}

#[test]
fn critic_sees_the_weight_on_the_feet_of_a_standing_robot() {
    let config = privileged(&[Quantity::FootForces, Quantity::FootHeights]);
    let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::new(&config.command)).unwrap();
    env.without_stagger();
    assert_eq!(added(&env)[..12], [0.0; 12]);
    (0..29).for_each(|_| drop(env.step(&[0.0; 12])));
    let seen = added(&env);
    let up: f32 = seen[..12].iter().skip(2).step_by(3).sum();
    let weight = (9.81 * env.world.sim().robot().mass_kg) as f32;
    assert!((up / weight - 1.0).abs() < 0.02, "{up} of {weight} N");
    assert!(seen[12..].iter().all(|height| height.abs() < 0.005), "{seen:?}");
}

#[test]
fn critic_sees_the_push_when_it_comes_and_the_encoder_bias_always() {
    let mut config = privileged(&[Quantity::Push, Quantity::EncoderBias, Quantity::Friction]);
    config.randomisation.enabled = true;
    let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
    env.without_stagger();
    let plan = env.plan().clone();
    let bias = plan.conditions.encoder_bias;
    for step in 0..32 {
        let (seen, state) = (added(&env), env.world.sim().state());
        let size = seen[0].hypot(seen[1]).hypot(seen[2]);
        let push = env.world.coming().1.copied();
        assert_eq!(push.is_some(), step == 30, "step {step}");
        let expected = push.map_or(0.0, |push| push.linear[0].hypot(push.linear[1]) as f32);
        assert!((size - expected).abs() < 1e-6, "step {step}: {size} instead of {expected}");
        assert_eq!(seen[3..15], bias.map(|bias| bias as f32));
        assert_eq!(seen[15], plan.conditions.friction as f32);
        if let Some(push) = push {
            env.sim_mut().push(push.linear, push.angular).unwrap();
            let change = env.world.sim().state().velocity_in_base - state.velocity_in_base;
            let expected = [change.x as f32, change.y as f32, change.z as f32];
            assert!((0..3).all(|k| (seen[k] - expected[k]).abs() < 1e-6), "{seen:?} {expected:?}");
        }
        env.step(&[0.0; 12]);
    }
}

#[test]
fn critic_sees_the_pull_that_acts() {
    let mut config = privileged(&[Quantity::TrunkForce]);
    config.pulls = Some(pulls());
    let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
    env.without_stagger();
    replan(&mut env, [Disturbance::Pull(Pull::constant([0.09, 0.19], [3.0, 4.0]))]);
    // Steps begin every 1/60 s: 6 to 11 lie in between.
    for step in 0..20 {
        let size = added(&env).iter().map(|force| force * force).sum::<f32>().sqrt();
        let expected = if (6..12).contains(&step) { 5.0 } else { 0.0 };
        assert!((size - expected).abs() < 1e-5, "step {step}: {size}");
        env.step(&[0.0; 12]);
    }
}

/// Returns the configuration for a real robot with every option of ground and hands.
fn with_all() -> Config {
    let mut config = Config::load("real").unwrap();
    config.pulls = Some(pulls());
    config.held_feet.as_mut().unwrap().gap_s = [0.1, 0.3];
    let (rough_m, boxes_m) = ([0.01, 0.06], [0.02, 0.08]);
    config.terrain = Some(Terrain { environments: 1.0, levels: 3, rough_m, boxes_m, sharpness_factor: 0.33 });
    config
}

#[test]
fn a_real_robot_is_heavier_or_later_as_its_plan_says() {
    let mut config = Config::load("real").unwrap();
    config.episode.walking_s = 0.5;
    let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
    let mass = |env: &LocomotionEnv| env.world.sim().data().model().body_mass().iter().sum::<f64>();
    let nominal = LocomotionEnv::new(&Config::load("fast").unwrap(), 1, 0, Curriculum::complete()).unwrap();
    let mut differences = Vec::new();
    for _ in 0..4 {
        let dynamics = env.plan().dynamics.unwrap();
        assert!((mass(&env) - mass(&nominal) - dynamics.trunk_mass_kg).abs() < 1e-9);
        differences.push(dynamics.trunk_mass_kg);
        // The joint stays where it is until its target acts: the latency in steps of 1/240 s.
        let start = env.world.sim().state().joint_rates[2];
        let moved = (0..4).find(|_| {
            env.step(&[3.0; 12]);
            (env.world.sim().state().joint_rates[2] - start).abs() > 1.0
        });
        assert_eq!(moved, Some((dynamics.latency_s * 60.0).floor() as usize), "{dynamics:?}");
        env.reset(Curriculum::complete()).unwrap();
    }
    assert!(differences.windows(2).all(|pair| pair[0] != pair[1]));
}

#[test]
fn policy_sees_inertial_errors_and_critic_does_not() {
    let mut config = privileged(&[Quantity::AngularVelocity]);
    config.randomisation.enabled = true;
    config.randomisation.gyro_bias_sd_rad_s = 0.1;
    let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
    let bias = env.plan().imu.unwrap().gyro_bias_rad_s;
    for step in 0..20 {
        let (seen, true_rate) = (env.observation(), env.world.sim().state().angular_velocity_in_base);
        // Left, up, forward, after height, gravity, joint angles and velocity.
        for (k, axis) in [1, 2, 0].into_iter().enumerate() {
            assert!((seen[46 + 19 + k] - true_rate[axis] - bias[axis]).abs() < 1e-12, "step {step}");
            assert_eq!(added(&env)[axis], true_rate[axis] as f32);
        }
        env.step(&action(step));
    }
}

#[test]
fn a_held_foot_stays_behind_until_it_is_lifted() {
    let mut config = with_all();
    (config.terrain, config.randomisation.enabled, config.episode.slope) = (None, false, 0.0);
    let swung_m = |height_m: f64| {
        let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
        env.without_stagger();
        let (force_n, stiffness_n_per_m) =
            config.held_feet.as_ref().map(|it| (it.force_n, it.stiffness_n_per_m)).unwrap();
        let hold = Hold { leg: 0, from_s: 0.0, until_s: 1.0, height_m, force_n, stiffness_n_per_m };
        replan(&mut env, [Disturbance::Hold(hold)]);
        let place = |env: &LocomotionEnv| env.world.sim().parts().foot_centres(env.world.sim().data())[0];
        let start = place(&env);
        // The front right foot is lifted, then swung forward.
        for step in 0..16 {
            let mut action = [0.0; 12];
            (action[1], action[2]) = if step < 6 { (0.6, -1.2) } else { (-1.6, -1.2) };
            env.step(&action);
        }
        place(&env)[0] - start[0]
    };
    let (free, held) = (swung_m(0.0), swung_m(0.3));
    assert!(free > 0.05 && held < 0.6 * free, "{free} {held}");
}

#[test]
fn every_level_of_the_terrain_starts_on_its_own_tile() {
    let config = with_all();
    let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
    for level in [0, 1, 2] {
        assert_eq!(env.progress.course.unwrap().level, level);
        let position = env.world.sim().state().position;
        assert!((position.x - 8.0 * (level as f64 - 1.0)).abs() < 1e-9 && position.y == 0.0);
        assert!((env.world.sim().state().height - env.world.sim().robot().stand[2]).abs() < 1e-9);
        assert_eq!(env.world.reward().tracking_sharpness, 0.33 * config.reward.tracking_sharpness);
        // As if it had walked where it should.
        let mut course = Course::new(level);
        let state = RobotState { velocity_in_base: Vector3::x(), ..RobotState::default() };
        course.advance(&state, &Command::velocity(1.0, 0.0, 0.0), 1.0, false);
        env.progress.course = Some(course);
        assert_eq!(env.report(EpisodeEnd::TimeLimit, None).terrain_level, Some(level));
        env.reset(Curriculum::complete()).unwrap();
    }
}

fn pulls() -> Pulls {
    pulls_of_50_n([0.5, 2.5], [0.2, 1.5])
}

#[test]
fn pulls_and_pushes_are_felt_in_the_step_in_which_they_act() {
    let observation = [Quantity::FeltForce, Quantity::CommandedYield].map(Observed::now).to_vec();
    let mut config = Config { pulls: Some(pulls()), observation, ..Config::load("fast").unwrap() };
    (config.episode.slope, config.reward.reference_m_s_per_n) = (0.0, Some([0.02; 2]));
    let mut env = LocomotionEnv::new(&config, 1, 0, Curriculum::complete()).unwrap();
    env.without_stagger();
    let push = Push { at_s: config.episode.walking_s, linear: [0.01, 0.2], ..Push::default() };
    let pull = Pull::constant([0.01, 0.1], [3.0, -4.0]);
    replan(&mut env, [Disturbance::Push(push), Disturbance::Pull(pull)]);
    let felt = |env: &mut LocomotionEnv| {
        env.step(&[0.0; 12]);
        let [forward, left, _, yield_forward, yield_left, _] = *env.observation().first_chunk().unwrap();
        assert!((yield_forward - 0.02 * forward).abs() < 1e-6 && (yield_left - 0.02 * left).abs() < 1e-6);
        [forward, left]
    };
    assert_eq!(felt(&mut env), [0.0; 2]);
    // The heading has hardly changed.
    let [forward, left] = felt(&mut env);
    assert!((forward - 3.0).abs() < 0.1 && (left + 4.0).abs() < 0.1, "{forward}, {left}");
    while env.world.steps() < env.stages.recovery_start {
        felt(&mut env);
    }
    // 13.1 kg · 0.01 m/s · 60 /s, and beyond what is observed.
    let [forward, left] = felt(&mut env);
    assert!((forward - 7.86).abs() < 0.5 && left == 100.0, "{forward}, {left}");
}
