//! Tests of the world.

use super::*;
use crate::config::Config;

/// Creates a world in which the Go1 stands, with these disturbances to come, and the pose that it holds.
fn standing(disturbances: impl IntoIterator<Item = Disturbance>) -> (World, Joints) {
    let config = Config::load("compliant").unwrap();
    let pose = config.action.nominal_pose_rad.joints();
    let scene = Scene::flat(config.robot.load().unwrap(), config.simulation.timestep_s());
    let mut world = World::new(&scene, &config.simulation, 0.2, config.reward).unwrap();
    let conditions = Conditions { gravity: [0.0, 0.0, -9.81], friction: 0.8, encoder_bias: [0.0; JOINTS] };
    world.begin(conditions, &pose, disturbances).unwrap();
    (world, pose)
}

fn step(world: &mut World, pose: &Joints) -> WorldStep {
    world.step(pose, &Command::default(), |_, _, _| ()).unwrap()
}

#[test]
fn true_force_is_the_sum_of_what_acts() {
    let ramp = Pull { profile: Profile::Ramp { rise_s: 0.2 }, ..Pull::constant([0.1, 0.5], [12.0, 0.0]) };
    let constant = Pull::constant([0.2, 0.5], [0.0, 4.0]);
    let (mut world, pose) = standing([Disturbance::Pull(ramp), Disturbance::Pull(constant)]);
    let mut texts = Vec::new();
    for index in 0..36 {
        if index == 24 {
            world.pull_by_hand(Some([0.0, -3.0]));
        }
        let WorldStep { forces, events, mark, .. } = step(&mut world, &pose);
        // Physics steps begin at 0, 1/240, 2/240 and 3/240 s of the policy step.
        let middle_s = f64::from(index) / 60.0 + 1.5 / 240.0;
        let part = |rise_s: f64| ((middle_s - 0.1) / rise_s).clamp(0.0, 1.0);
        let x = if (6..30).contains(&index) { 12.0 * part(0.2) } else { 0.0 };
        let y = if (12..30).contains(&index) { 4.0 } else { 0.0 } - if index >= 24 { 3.0 } else { 0.0 };
        // The heading of the hand's force has hardly changed, and the ramp ends within a policy step.
        assert!((forces.trunk - Vector3::new(x, y, 0.0)).norm() < 0.2, "step {index}: {:?}", forces.trunk);
        assert_eq!(mark.is_some(), index >= 6, "step {index}");
        texts.extend(events.into_iter().map(|event| event.text));
    }
    let [grows, joins, hand, ends] =
        ["pull: +12.0 N", "pull: +0.0 N forward, +4.0", "pull: +0.0 N forward, -3.0", "pull ends"];
    assert_eq!(texts.len(), 5);
    for (text, expected) in texts.iter().zip([grows, joins, hand, ends, ends]) {
        assert!(text.starts_with(expected), "{text}");
    }
    world.pull_by_hand(None);
    let WorldStep { forces, events, .. } = step(&mut world, &pose);
    assert_eq!((forces.trunk, events[0].text.as_str()), (Vector3::zeros(), "pull ends"));
    assert!(world.disturbances.is_empty());
}

#[test]
fn shove_gives_the_momentum_of_its_push() {
    // From the sixth step on, at 60 Hz; its time is rounded to whole steps.
    for (for_s, steps) in [(0.1, 6), (0.01, 1), (0.02, 1)] {
        let shove = Push { at_s: 0.1, linear: [0.3, -0.4], for_s, ..Push::default() };
        let (mut world, pose) = standing([Disturbance::Push(shove)]);
        let forces: Vec<Vector3<f64>> = (0..24).map(|_| step(&mut world, &pose).forces.trunk).collect();
        assert!(forces.iter().enumerate().all(|(index, it)| (it.norm() > 0.0) == (6..6 + steps).contains(&index)));
        let impulse = forces.iter().sum::<Vector3<f64>>() / 60.0;
        let expected = world.sim().robot().mass_kg * Vector3::new(0.3, -0.4, 0.0);
        // Its direction is that of the heading, which the shove turns a little.
        assert!((impulse - expected).norm() < 0.02 * expected.norm(), "{impulse:?}, expected {expected:?}");
    }
}

#[test]
fn reward_input_has_rates_of_targets_and_accelerations_of_joints() {
    let (mut world, pose) = standing([]);
    step(&mut world, &pose);
    let before = world.state().clone();
    let target = pose.map(|angle| angle + 0.1);
    let WorldStep { summary, landings, forces, .. } = step(&mut world, &target);
    let command = Command::default();
    let input = world.reward_input(&before, &command, (&summary, &landings, &forces));
    assert_eq!(*input.targets, [target, pose, pose]);
    // 0.1 rad in 1/60 s.
    assert!(input.target_rates().iter().all(|rate| (rate - 6.0).abs() < 1e-9));
    let expected = (world.state().joint_rates[0] - before.joint_rates[0]) * 60.0;
    assert!((input.joint_accelerations()[0] - expected).abs() < 1e-9);
}
