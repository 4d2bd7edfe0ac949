//! External policies and imported robots, and policies of ours that travel.

use std::path::Path;
use std::sync::Arc;

use supple::config::Config;
use supple::mujoco::{Object, VERSION};
use supple::policy::external::describe;
use supple::policy::{Agent, InferenceBuffers};
use supple::policy::{onnx, shipped};
use supple::robot::Robot;
use supple::scenario::Playback;
use supple::scenario::catalog::{Scenario, Task, Walk, defaults};
use supple::scenario::trace::Trace;
use supple::sim::Scene;

use crate::scenarios;
use crate::support::{broken_policy, example, refused, repository, robot, run, standing_policy, success, with_input};

fn walk(agent: &Agent, duration_s: f64) -> Trace {
    let task = Task { duration_s, ..defaults::<Walk>("walk").unwrap().task };
    let script = Scenario::Walk(Walk { task }).script(0, &agent.config).unwrap();
    Playback::new(&script, &agent.config, agent.controller()).unwrap().trace()
}

fn load(robot: &Path) -> Arc<Robot> {
    Robot::load(robot.to_str().unwrap()).unwrap()
}

/// The standing policy on a robot.
fn standing_on(robot: &Path) -> Agent {
    let mut agent: Agent = standing_policy().into();
    agent.run_on(&load(robot));
    agent
}

/// Writes the robot for tests with a change, and with the meshes of its own folder.
fn changed(path: &Path, before: &str, after: &str) {
    let xml = std::fs::read_to_string(robot("quadruped.xml")).unwrap();
    let xml = xml.replace("meshdir=\"assets\"", &format!("meshdir=\"{}\"", robot("assets").display()));
    std::fs::write(path, xml.replacen(before, after, 1)).unwrap();
}

#[test]
fn our_policy_as_onnx_with_its_description_walks_as_the_policy_file_does() {
    let folder = tempfile::tempdir().unwrap();
    let policy = shipped::find_ours("compliant").unwrap();
    std::fs::write(folder.path().join("p.onnx"), onnx::export(&policy)).unwrap();
    std::fs::write(folder.path().join("p.yaml"), describe(&policy, "p.onnx")).unwrap();
    let travelled = walk(&Agent::load(&folder.path().join("p.yaml")).unwrap(), 2.0);
    let native = walk(&policy.into(), 2.0);
    assert_eq!(native.frames.len(), 120);
    for (index, (a, b)) in native.frames.iter().zip(&travelled.frames).enumerate() {
        // Sums in another order: single precision's error, which contacts amplify with time.
        let tolerance = if index < 30 { 1e-4 } else { 0.1 };
        for (a, b) in a.joint_targets.iter().zip(b.joint_targets) {
            assert!((a - b).abs() < tolerance, "frame {index}: {a} {b}");
        }
    }
    let end = |trace: &Trace| trace.frames.last().unwrap().position;
    assert!((end(&native)[0] - end(&travelled)[0]).abs() < 0.02, "{:?} {:?}", end(&native), end(&travelled));
}

#[test]
fn a_description_names_its_robot_which_lies_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let policy = shipped::find_ours("compliant").unwrap();
    std::fs::write(folder.path().join("p.onnx"), onnx::export(&policy)).unwrap();
    std::fs::copy(repository("models/go2.xml"), folder.path().join("mine.xml")).unwrap();
    let mass = |model: &str| {
        let text = describe(&policy, "p.onnx").replace(r#""model":"go1""#, &format!(r#""model":"{model}""#));
        std::fs::write(folder.path().join("p.yaml"), text).unwrap();
        let agent = Agent::load(&folder.path().join("p.yaml")).unwrap();
        Scenario::named("walk", "{}").unwrap().script(0, &agent.config).unwrap().scene.robot.mass_kg
    };
    let go2 = Robot::load("go2").unwrap().mass_kg;
    assert!(mass("go1") < go2);
    assert_eq!((mass("go2"), mass("mine.xml")), (go2, go2));
}

#[test]
fn our_own_model_imported_walks_bit_for_bit_as_before() {
    let imported = standing_on(&repository("models/go1.xml"));
    assert_eq!(walk(&imported, 1.0), walk(&standing_policy().into(), 1.0));
}

#[test]
fn import_report_lists_what_was_left_out() {
    let found = load(&robot("scene.xml"));
    let report = found.report.join("\n");
    for expected in [
        "mass: 12.800 kg",
        "joint damping: 1 to 2 N m s/rad, set to 0",
        "joint friction: 0.2 N m, set to 0",
        "actuators: 12 (12 of them servos) replaced by torque motors",
        "limits 23.7 N m (hip, thigh) and 35.5 N m (calf)",
        "condim 6, priority 1, friction 0.8 0.02 0.01",
        "cone elliptic, impratio 100 replaced by ours",
        "geom 'floor' left out",
        "keyframe, base at 0.287 m",
    ] {
        assert!(report.contains(expected), "{expected}\n{report}");
    }
    let scene = Scene::flat(found, 1.0 / 240.0);
    for model in [scene.compile().unwrap(), scene.compile_visual().unwrap()] {
        assert!((model.body_mass().iter().sum::<f64>() - 12.8).abs() < 1e-9);
        assert!(model.damping().iter().chain(model.friction_loss()).all(|value| *value == 0.0));
        assert!(model.armature()[6..].iter().all(|value| *value == 0.01));
        assert_eq!(model.count(Object::Actuator), 12);
        assert_eq!(model.control_range(2), [-35.5, 35.5]);
        let foot = model.geom_contact(model.id(Object::Geom, "RL_foot").unwrap());
        // MuJoCo 3 has masks of zero where only listed pairs touch.
        assert_eq!((foot.contype, foot.conaffinity, foot.priority), if VERSION < 300 { (1, 2, 0) } else { (0, 0, 0) });
    }
}

#[test]
fn defaults_of_a_robots_file_do_not_reach_the_rest_of_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("robot.xml");
    changed(&path, "<default>", "<default><geom group=\"5\" solref=\"0.5 1\"/>");
    let model = Scene::flat(load(&path), 1.0 / 240.0).compile().unwrap();
    assert_eq!(model.geom(model.id(Object::Geom, "ground").unwrap()).group, 0);
    assert_eq!(model.geom(model.id(Object::Geom, "FR_foot").unwrap()).group, 3);
}

#[test]
fn another_robot_stands_and_its_names_do_not_matter() {
    let standing = |name: &str| {
        let agent = standing_on(&robot(name));
        (walk(&agent, 1.0), Robot::load(&agent.config.robot.model).unwrap())
    };
    let (usual, found) = standing("quadruped.xml");
    assert_eq!(found.fall_height_m, None);
    assert!(usual.fall().is_none() && usual.frames.len() == 60, "{:?}", usual.events);
    let (renamed, found) = standing("renamed.yaml");
    assert_eq!(found.fall_height_m, Some(0.15));
    assert!(renamed.fall().is_none(), "{:?}", renamed.events);
    // One starts folded as its keyframe, the other upright as its description says; both come to the same stand.
    let height = |trace: &Trace| trace.frames.last().unwrap().height_m;
    assert!((height(&usual) - height(&renamed)).abs() < 0.005, "{} {}", height(&usual), height(&renamed));
}

#[test]
fn every_scenario_plays_on_another_robot() {
    let agent = standing_on(&robot("quadruped.xml"));
    for scenario in scenarios::all() {
        let script = scenario.script(0, &agent.config).unwrap();
        let trace = Playback::new(&script, &agent.config, agent.controller()).unwrap().trace();
        assert!(trace.fault().is_none() && trace.frames.len() > 30, "{}: {:?}", scenario.name(), trace.events);
    }
}

#[test]
fn the_angles_of_a_robots_file_turn_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let mats = ["radian", "degree"].map(|unit| {
        let path = folder.path().join(format!("{unit}.xml"));
        changed(&path, "angle=\"radian\"", &format!("angle=\"{unit}\""));
        let mut config = Config::load("compliant").unwrap();
        config.robot.model = path.to_str().unwrap().to_owned();
        let model = scenarios::scenario("rubble", &[]).script(0, &config).unwrap().scene.compile().unwrap();
        let first = model.joint_position_index(model.id(Object::Joint, "mat_0").unwrap());
        model.rest_positions()[first + 3..first + 7].to_vec()
    });
    assert!(mats[0] == mats[1] && mats[0][3].abs() > 0.1, "{mats:?}");
}

#[test]
fn examples_describe_what_they_say() {
    let folder = tempfile::tempdir().unwrap();
    let policy = Agent::load(&example(folder.path(), "rsl_rl")).unwrap();
    // Ours are FR, FL, RR, RL: Isaac Gym's left legs come first.
    let pose = policy.inference().action.nominal_pose;
    assert_eq!(pose, [-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5]);
    assert_eq!((policy.config.simulation.physics_rate_hz, policy.config.simulation.policy_rate_hz), (200, 50));
    let error = Robot::load(repository("examples/robots/quadruped.yaml").to_str().unwrap()).unwrap_err();
    assert!(error.problem.contains("robot.xml"));
}

#[test]
fn external_policy_is_shown_verified_and_run() {
    let folder = tempfile::tempdir().unwrap();
    example(folder.path(), "rsl_rl");
    let program = |arguments: &[&str]| {
        let output = success(run("policy", folder.path(), arguments));
        String::from_utf8(output.stdout).unwrap()
    };
    let shown = program(&["show", "rsl_rl.yaml"]);
    // The yaw rate of the body, times 0.25; the first output moves the hip that `joints` names first, by a quarter.
    let line =
        |words: &str| shown.lines().find(|line| line.contains(words)).unwrap_or_else(|| panic!("{words}: {shown}"));
    assert!(line("commanded yaw").contains("0.25"), "{shown}");
    assert!(line(" 0  FL_hip").contains("+0.1000") && line(" 0  FL_hip").contains("-0.863 to +0.863"), "{shown}");
    let json: serde_json::Value = serde_json::from_str(&program(&["show", "rsl_rl.yaml", "--json"])).unwrap();
    assert_eq!(json["observation_elements"].as_array().unwrap().len(), 48);
    assert_eq!((&json["joints"][0], &json["action"]["scale_rad"][0]), (&"FL_hip".into(), &0.25.into()));
    assert!(program(&["verify", "rsl_rl.yaml"]).contains(json["sha256"].as_str().unwrap()));

    // As the policy acts in a program.
    let agent = Agent::load(&folder.path().join("rsl_rl.yaml")).unwrap();
    let expected = agent.inference().joint_targets(&[0.5; 48], &mut InferenceBuffers::default());
    let observation = format!("{:?}\n", [0.5; 48]).repeat(2);
    let output = with_input("policy", folder.path(), &["run", "rsl_rl.yaml"], observation.as_bytes());
    let answers = String::from_utf8(output.stdout).unwrap();
    let answers: Vec<[f64; 12]> = answers.lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(answers, [expected; 2]);
    refused("policy", folder.path(), &["verify", "rsl_rl.yaml", "--samples", "5"], "--samples");
}

#[test]
fn nan_from_a_network_is_a_fault() {
    let folder = tempfile::tempdir().unwrap();
    let path = broken_policy(folder.path());
    let trace = walk(&Agent::load(&path).unwrap(), 1.0);
    assert!(trace.frames.is_empty() && trace.fall().is_none());
    let fault = trace.fault().unwrap();
    assert!(fault.time_s == 0.0 && fault.text.contains("FR_hip is NaN"), "{fault:?}");
    for command in ["verify", "calibrate"] {
        refused("policy", folder.path(), &[command, "broken.yaml"], "NaN");
    }
}
