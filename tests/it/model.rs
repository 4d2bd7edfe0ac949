//! `models/go1.xml` against the manufacturer's figures.

use std::collections::HashSet;

use rand::RngExt;
use supple::config::Config;
use supple::mujoco::{Data, Model, Object};
use supple::robot::{JOINTS, Joints, PARTS, Robot, joint_name, same_in_every_leg};
use supple::sim::{Conditions, Parts, Scene, Sim, StepObserver};
use supple::util::random::{Purpose, stream};

use crate::foreign::standing;

fn scene() -> Scene {
    Scene::flat(Robot::load("go1").unwrap(), 1.0 / 240.0)
}

fn model() -> Model {
    scene().compile().unwrap()
}

#[test]
fn masses_are_the_manufacturers_with_rotors() {
    let model = model();
    let mass = |name: &str| model.body_mass()[model.id(Object::Body, name).unwrap()];
    assert!((model.body_mass().iter().sum::<f64>() - 13.100_448).abs() < 1e-9);
    assert_eq!(mass("trunk"), 5.561);
    for leg in ["FR", "FL", "RR", "RL"] {
        let of = |link: &str| mass(&format!("{leg}_{link}"));
        assert_eq!([of("hip"), of("thigh"), of("calf")], [0.68, 1.009, 0.195_862]);
    }
}

#[test]
fn joints_come_in_unitrees_order_with_its_limits_and_no_damping() {
    let (model, robot) = (model(), Robot::load("go1").unwrap());
    let names: Vec<String> = (1..=JOINTS).map(|joint| model.name(Object::Joint, joint).to_owned()).collect();
    let expected: Vec<String> = (0..JOINTS).map(|joint| format!("{}_joint", joint_name(joint))).collect();
    assert_eq!(names, expected);
    for joint in 0..JOINTS {
        let (range, torque, armature) = match joint % PARTS.len() {
            0 => ([-0.863, 0.863], 23.7, 0.004_481_385_914),
            1 => ([-0.686, 4.501], 23.7, 0.004_481_385_914),
            _ => ([-2.818, -0.888], 35.55, 0.010_083_118_31),
        };
        assert_eq!((robot.joint_limits[joint], robot.torque_limits[joint]), (range, torque));
        assert_eq!(model.joint_range(joint + 1), range);
        assert_eq!(model.control_range(joint), [-torque, torque]);
        assert_eq!(model.armature()[6 + joint], armature);
    }
    assert!(model.damping().iter().all(|damping| *damping == 0.0));
}

#[test]
fn the_robot_stands_where_the_model_says_under_kp_40_and_kd_1() {
    let config = Config::load("compliant").unwrap();
    let (mut sim, target) = standing(Robot::load("go1").unwrap(), &config, 0.2);
    assert_eq!(target, same_in_every_leg([0.0, 0.72, -1.44]));
    let start = sim.state();
    for _ in 0..120 {
        assert_eq!(sim.step(&target, &mut ()).unwrap().fall, None);
    }
    let end = sim.state();
    assert!((start.height - 0.3076).abs() < 1e-4 && (end.height - 0.3076).abs() < 5e-4, "{}", end.height);
    for (before, after) in start.joint_angles.iter().zip(end.joint_angles) {
        assert!((before - after).abs() < 0.003, "{before} {after}");
    }
    assert!(end.feet.iter().all(|foot| foot.contact && foot.height.abs() < 0.003));
}

/// Torques of the first physics step \[N·m\].
#[derive(Default)]
struct First(Option<Joints>);

impl StepObserver for First {
    fn forces(&mut self, _: &Data, _: &Parts, torques: &Joints) {
        self.0.get_or_insert(*torques);
    }
}

#[test]
fn encoder_bias_shifts_state_and_motors_alike() {
    let config = Config::load("compliant").unwrap();
    let target = same_in_every_leg([0.0, 0.72, -1.44]);
    let [exact, off] = [0.0, 0.01].map(|offset| {
        let mut sim = Sim::new(&scene(), &config.simulation, 0.2).unwrap();
        let mut encoder_bias = [0.0; 12];
        encoder_bias[4] = offset;
        sim.reset(Conditions { gravity: [0.0, 0.0, -9.81], friction: 0.8, encoder_bias }, &target).unwrap();
        let (read, real) = (sim.state().joint_angles, sim.parts().joint_angles(sim.data()));
        let mut first = First::default();
        sim.step(&target, &mut first).unwrap();
        (read, real, first.0.unwrap())
    });
    assert_eq!((exact.0, exact.1), (off.1, off.1));
    for joint in 0..JOINTS {
        let offset = if joint == 4 { 0.01 } else { 0.0 };
        assert!((off.0[joint] - off.1[joint] - offset).abs() < 1e-15);
        // 40 N·m/rad · 0.01 rad
        assert!((off.2[joint] - exact.2[joint] + 40.0 * offset).abs() < 1e-12, "{} {}", off.2[joint], exact.2[joint]);
    }
}

#[test]
fn visual_geometries_do_not_change_the_physics() {
    let (stepped, seen) = (scene().compile().unwrap(), scene().compile_visual().unwrap());
    assert_eq!(stepped.body_mass(), seen.body_mass());
    assert_eq!((stepped.nq(), stepped.nv(), stepped.nu()), (seen.nq(), seen.nv(), seen.nu()));
    assert!(seen.count(Object::Geom) > stepped.count(Object::Geom));
}

/// Robots thrown about in any pose, on ground of another friction than the model's: what the scene lists as pairs must be
/// all that MuJoCo finds when it has to look itself, as it does among obstacles.
#[test]
fn the_pairs_of_the_flat_scene_are_all_contacts_there_are() {
    let config = Config::load("compliant").unwrap();
    let searching = Scene { obstacles: "<!-- none -->".into(), ..scene() };
    let listed = |scene: &Scene| scene.xml(true).contains("<pair ");
    assert!(listed(&scene()) && !listed(&searching));
    let mut sims = [scene(), searching].map(|scene| Sim::new(&scene, &config.simulation, 0.2).unwrap());
    let target = same_in_every_leg([0.0, 0.72, -1.44]);
    let conditions = Conditions { gravity: [0.0, 0.0, -9.81], friction: 0.3, encoder_bias: [0.0; 12] };
    let mut rng = stream(0, Purpose::Scenario, 0, 0);
    let mut touched = HashSet::new();
    for _ in 0..300 {
        let pose: [f64; 19] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let [found, expected] = sims.each_mut().map(|sim| {
            sim.reset(conditions, &target).unwrap();
            let positions = sim.data_mut().positions_mut();
            positions[2] = 0.1 + 0.1 * pose[2];
            positions[3..7].copy_from_slice(&pose[3..7]);
            positions[7..].iter_mut().zip(&pose[7..]).for_each(|(angle, change)| *angle += change);
            sim.refresh().unwrap();
            let mut contacts: Vec<_> = sim.data().contacts().map(|contact| contact.geoms).collect();
            contacts.sort_unstable();
            // Deep in the ground, MuJoCo may give up; both ways, then.
            let end = sim.step(&target, &mut ()).map(|_| sim.data().velocities().to_vec());
            (contacts, end.ok())
        });
        assert_eq!(found.0, expected.0);
        touched.extend(found.0);
        match (found.1, expected.1) {
            (Some(found), Some(expected)) => {
                // Contacts come in another order, and so do roundings.
                let off = found.iter().zip(&expected).map(|(a, b)| (a - b).abs() / (1.0 + b.abs()));
                assert!(off.fold(0.0, f64::max) < 1e-9, "{found:?} {expected:?}");
            }
            (found, expected) => assert_eq!(found.is_some(), expected.is_some()),
        }
    }
    // Trunk, head, and hip, thigh, both parts of the calf and the foot of each leg.
    assert_eq!(touched.len(), 22, "{touched:?}");
}

#[test]
fn a_broken_model_is_refused_with_mujocos_words() {
    let error = Model::from_xml(&[("broken.xml", "<mujoco><worldbody><geom size='0'/></worldbody></mujoco>")]);
    let error = error.unwrap_err().to_string();
    assert!(error.contains("broken.xml") && error.contains("size"), "{error}");
    // What MuJoCo itself would end the process for.
    let long = "x".repeat(2000);
    for (files, expected) in [
        (vec![("empty.xml", "")], "empty.xml"),
        (vec![("", "<mujoco/>")], "''"),
        (vec![("folder/", "<mujoco/>")], "folder/"),
        (vec![(long.as_str(), "<mujoco/>")], "xxx"),
        (vec![("a.xml", "<mujoco/>"), ("a.xml", "<mujoco/>")], "'a.xml' is there twice"),
    ] {
        let error = Model::from_xml(&files).map(drop).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error}");
    }
}

#[test]
fn a_missing_name_lists_the_names_there_are() {
    let error = model().id(Object::Joint, "tail_joint").unwrap_err().to_string();
    assert!(error.contains("no joint named 'tail_joint'") && error.contains("FR_hip_joint"), "{error}");
}
