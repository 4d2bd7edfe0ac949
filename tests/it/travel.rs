//! Policies and robots that come from elsewhere, and ours that go there.

use std::path::{Path, PathBuf};

use serde_json::Value;
use supple::agent::Agent;
use supple::config::Config;
use supple::foreign::{ForeignPolicy, describe};
use supple::mujoco::Kind;
use supple::robot::Robot;
use supple::scenario::Rollout;
use supple::scenario::catalog::{Scenario, Task, Walk, defaults};
use supple::scene::{RobotFile, Scene};
use supple::trace::Trace;
use supple::{onnx, policies};

use crate::scenarios;
use crate::support::{complaint, run, standing_policy};

fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn robot(name: &str) -> PathBuf {
    repository("tests/fixtures/robot").join(name)
}

fn walk(agent: &Agent, duration_s: f64) -> Trace {
    let task = Task { duration_s, ..defaults::<Walk>("walk").unwrap().task };
    let script = Scenario::Walk(Walk { task }).script(0, &agent.config).unwrap();
    Rollout::new(&script, &agent.config, agent.controller()).unwrap().trace()
}

/// An example from `examples/policies` with a network of the right shape from the fixtures.
fn example(folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(format!("{name}.yaml"));
    let text = std::fs::read_to_string(repository("examples/policies").join(format!("{name}.yaml"))).unwrap();
    std::fs::write(&path, text.replace("policy.onnx", &format!("{name}.onnx"))).unwrap();
    std::fs::copy(repository("tests/fixtures/onnx").join(format!("{name}.onnx")), folder.join(format!("{name}.onnx")))
        .unwrap();
    path
}

#[test]
fn our_policy_as_onnx_with_its_description_walks_as_the_policy_file_does() {
    let folder = tempfile::tempdir().unwrap();
    let policy = policies::find_ours("compliant").unwrap();
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
fn policies_in_the_styles_of_rsl_rl_and_playground_are_played_from_their_examples() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["rsl_rl", "playground"] {
        example(folder.path(), name);
        let arguments = ["push", "--policy", &format!("{name}.yaml"), "--duration-s", "1", "--json", "--no-record"];
        let output = run("scenario", folder.path(), &arguments);
        assert!(output.status.success(), "{}", complaint(&output));
        let object: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(object["runs"][0]["policy"], name);
        assert_eq!(object["runs"][0]["sha256"].as_str().unwrap().len(), 64);
    }
}

#[test]
fn evaluate_compares_a_policy_from_elsewhere_with_ours() {
    let folder = tempfile::tempdir().unwrap();
    example(folder.path(), "rsl_rl");
    standing_policy().save(&folder.path().join("b.safetensors")).unwrap();
    std::fs::write(folder.path().join("tiny.yaml"), "walk: {commands: [[0.0, 0.0, 0.0]]}\n").unwrap();
    let arguments = ["walk", "--protocol", "tiny.yaml", "--a", "rsl_rl.yaml", "--b", "b.safetensors"];
    let output = run("evaluate", folder.path(), &arguments);
    assert!(output.status.success(), "{}", complaint(&output));
    let summary: Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("report/summary.json")).unwrap()).unwrap();
    assert_eq!(summary["policies"][0]["config"], "from elsewhere", "{summary}");
    assert_eq!(summary["policies"][0]["samples"], Value::Null);
}

#[test]
fn policies_and_robots_that_do_not_fit_are_refused_in_one_line_with_exit_code_2() {
    let folder = tempfile::tempdir().unwrap();
    let text = std::fs::read_to_string(example(folder.path(), "rsl_rl")).unwrap();
    let write = |name: &str, from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        std::fs::write(folder.path().join(name), text.replacen(from, to, 1)).unwrap();
    };
    write("short.yaml", "  - {quantity: last_action}\n", "");
    write("joint.yaml", "FL_hip,", "tail,");
    write("twice.yaml", "FL_hip,", "FL_thigh,");
    write("key.yaml", "observation_clip:", "observation_klip:");
    write("fast.yaml", "physics_rate_hz: 200", "physics_rate_hz: 4000000000");
    write("axis.yaml", "{quantity: projected_gravity}", "{quantity: projected_gravity, elements: [up, yaw]}");
    write("scale.yaml", "scale: [2.0, 2.0, 0.25]", "scale: [2.0, 2.0]");
    write("old.yaml", "{quantity: projected_gravity}", "{quantity: projected_gravity, steps_ago: 4000000000}");
    write("gone.yaml", "rsl_rl.onnx", "gone.onnx");
    write("cut.yaml", "rsl_rl.onnx", "cut.onnx");
    let network = std::fs::read(folder.path().join("rsl_rl.onnx")).unwrap();
    std::fs::write(folder.path().join("cut.onnx"), &network[..network.len() / 2]).unwrap();
    let bomb: String = (1..40).map(|k| format!("a{k}: &a{k} [*a{j}, *a{j}, *a{j}]\n", j = k - 1)).collect();
    std::fs::write(folder.path().join("bomb.yaml"), format!("a0: &a0 [1, 1, 1]\n{bomb}")).unwrap();
    // Its keyframe would no longer have the right length.
    let xml = std::fs::read_to_string(robot("quadruped.xml")).unwrap();
    let (before, after) = (xml.find("<keyframe>").unwrap(), xml.find("</keyframe>").unwrap() + "</keyframe>".len());
    let xml = format!("{}{}", &xml[..before], &xml[after..]);
    let assets = robot("assets").display().to_string();
    let model = |name: &str, from: &str, to: &str| {
        assert!(xml.contains(from), "{from}");
        let changed = xml.replace("meshdir=\"assets\"", &format!("meshdir=\"{assets}\"")).replace(from, to);
        std::fs::write(folder.path().join(name), changed).unwrap();
    };
    model("fixed.xml", "<freejoint/>", "");
    model(
        "tail.xml",
        "<site name=\"imu\"",
        "<body><joint name=\"tail\"/><geom size=\"0.01\"/></body><site name=\"imu\"",
    );
    model("nameless.xml", "RL_calf_joint", "left_rear_bottom");
    model("loop.xml", "<mujoco model=\"quadruped\">", "<mujoco><include file=\"loop.xml\"/>");
    model("broken.xml", "</default>", "");
    standing_policy().save(&folder.path().join("ours.safetensors")).unwrap();

    let cases: [(&[&str], &str); 19] = [
        (&["--policy", "rsl_rl.onnx"], "describe it in a YAML file"),
        (&["--policy", "short.yaml"], "its observation has 36 numbers (BaseVelocity 3,"),
        (&["--policy", "short.yaml"], "but the input 'obs' of rsl_rl.onnx takes 48"),
        (&["--policy", "joint.yaml"], "`joints` has 'tail', which is no joint of the robot"),
        (&["--policy", "twice.yaml"], "must name each of these once"),
        (&["--policy", "key.yaml"], "unknown field `observation_klip`"),
        (&["--policy", "fast.yaml"], "up to 20000"),
        (&["--policy", "axis.yaml"], "entry 3 (ProjectedGravity): `elements` has 'yaw'"),
        (&["--policy", "scale.yaml"], "`scale` has 2 numbers, expected one, or 3"),
        (&["--policy", "old.yaml"], "ages from 0 to 200 policy steps"),
        (&["--policy", "gone.yaml"], "gone.onnx: No such file"),
        (&["--policy", "cut.yaml"], "cut.onnx: it is cut off or not ONNX"),
        (&["--policy", "bomb.yaml"], "repetition limit exceeded"),
        (&["--policy", "ours.safetensors", "--model", "fixed.xml"], "its trunk is fixed to the world"),
        (&["--policy", "ours.safetensors", "--model", "tail.xml"], "joints beside those of four legs: tail"),
        (&["--policy", "ours.safetensors", "--model", "nameless.xml"], "no joint 'RL_calf'; its joints are: "),
        (&["--policy", "ours.safetensors", "--model", "loop.xml"], "does one include itself?"),
        (&["--policy", "ours.safetensors", "--model", "broken.xml"], "is not XML"),
        (&["--policy", "ours.safetensors", "--model", "none.xml"], "cannot read none.xml"),
    ];
    for (arguments, expected) in cases {
        let output = run("scenario", folder.path(), &[&["walk", "--no-record"], arguments].concat());
        let complaint = complaint(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {complaint}");
        assert!(complaint.contains(expected), "{arguments:?}: {complaint}");
        let lines = complaint.lines().filter(|line| !line.ends_with(".xml:")).count();
        assert_eq!(lines, 1, "{complaint}");
    }
}

#[test]
fn our_own_model_read_as_one_from_elsewhere_walks_bit_for_bit_as_before() {
    let path = repository("models/go1.xml");
    let found = Robot::load(&path).unwrap();
    let mut agent: Agent = standing_policy().into();
    let before = walk(&agent, 1.0);
    agent.run_on(path.to_str().unwrap(), &found);
    assert_eq!(walk(&agent, 1.0), before);
}

#[test]
fn a_public_style_quadruped_loses_servos_damping_and_soft_feet_and_the_report_says_so() {
    let path = robot("scene.xml");
    let report = Robot::load(&path).unwrap().report.join("\n");
    for expected in [
        "mass: 12.800 kg",
        "joint damping: 1 to 2 N m s/rad, set to 0",
        "joint friction: 0.2 N m, set to 0",
        "actuators: 12 (12 of them servos) replaced by torque motors",
        "limits 23.7 N m (hip, thigh) and 35.5 N m (calf), from the file",
        "condim 6, priority 1, friction 0.8 0.02 0.01",
        "cone elliptic, impratio 100 give way",
        "geom 'floor' left out",
        "keyframe, base at 0.287 m",
    ] {
        assert!(report.contains(expected), "{expected}\n{report}");
    }
    let scene = Scene::flat(RobotFile::Path(path), 1.0 / 240.0);
    for model in [scene.compile().unwrap(), scene.compile_visual().unwrap()] {
        assert!((model.body_mass().iter().sum::<f64>() - 12.8).abs() < 1e-9);
        assert!(model.damping().iter().chain(model.friction_loss()).all(|value| *value == 0.0));
        assert!(model.armature()[6..].iter().all(|value| *value == 0.01));
        assert_eq!(model.count(Kind::Actuator), 12);
        assert_eq!(model.control_range(2), [-35.5, 35.5]);
        let foot = model.geom_contact(model.id(Kind::Geom, "RL_foot").unwrap());
        assert_eq!((foot.contype, foot.conaffinity, foot.priority), (1, 2, 0));
    }
}

#[test]
fn defaults_of_a_robots_file_do_not_reach_the_rest_of_the_scene() {
    let folder = tempfile::tempdir().unwrap();
    let xml = std::fs::read_to_string(robot("quadruped.xml")).unwrap();
    let xml = xml.replace("meshdir=\"assets\"", &format!("meshdir=\"{}\"", robot("assets").display()));
    let path = folder.path().join("robot.xml");
    std::fs::write(&path, xml.replacen("<default>", "<default><geom group=\"5\" solref=\"0.5 1\"/>", 1)).unwrap();
    let model = Scene::flat(RobotFile::Path(path), 1.0 / 240.0).compile().unwrap();
    assert_eq!(model.geom(model.id(Kind::Geom, "ground").unwrap()).group, 0);
    assert_eq!(model.geom(model.id(Kind::Geom, "FR_foot").unwrap()).group, 3);
}

#[test]
fn another_robot_stands_and_its_names_do_not_matter() {
    let standing = |name: &str| {
        let path = robot(name);
        let mut agent: Agent = standing_policy().into();
        agent.run_on(path.to_str().unwrap(), &Robot::load(&path).unwrap());
        (walk(&agent, 1.0), agent.config)
    };
    let (usual, config) = standing("quadruped.xml");
    assert_eq!(config.episode.min_height_m, Config::load("compliant").unwrap().episode.min_height_m);
    assert!(usual.fall().is_none() && usual.frames.len() == 60, "{:?}", usual.events);
    let (renamed, config) = standing("renamed.yaml");
    assert_eq!(config.episode.min_height_m, 0.15);
    assert!(renamed.fall().is_none(), "{:?}", renamed.events);
    // One starts folded as its keyframe, the other upright as its description says; both come to the same stand.
    let height = |trace: &Trace| trace.frames.last().unwrap().height_m;
    assert!((height(&usual) - height(&renamed)).abs() < 0.005, "{} {}", height(&usual), height(&renamed));
}

#[test]
fn every_scenario_plays_on_another_robot() {
    let path = robot("quadruped.xml");
    let mut agent: Agent = standing_policy().into();
    agent.run_on(path.to_str().unwrap(), &Robot::load(&path).unwrap());
    for scenario in scenarios::all() {
        let script = scenario.script(0, &agent.config).unwrap();
        let trace = Rollout::new(&script, &agent.config, agent.controller()).unwrap().trace();
        assert!(trace.fault().is_none() && trace.frames.len() > 30, "{}: {:?}", scenario.name(), trace.events);
    }
}

#[test]
fn the_angles_of_a_robots_file_turn_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let xml = std::fs::read_to_string(robot("quadruped.xml")).unwrap();
    let xml = xml.replace("meshdir=\"assets\"", &format!("meshdir=\"{}\"", robot("assets").display()));
    let mats = ["radian", "degree"].map(|unit| {
        let path = folder.path().join(format!("{unit}.xml"));
        std::fs::write(&path, xml.replacen("angle=\"radian\"", &format!("angle=\"{unit}\""), 1)).unwrap();
        let mut config = Config::load("compliant").unwrap();
        config.robot.model = path.to_str().unwrap().to_owned();
        let model = scenarios::scenario("rubble", &[]).script(0, &config).unwrap().scene.compile().unwrap();
        let first = model.joint_position_index(model.id(Kind::Joint, "mat_0").unwrap());
        model.rest_positions()[first + 3..first + 7].to_vec()
    });
    assert!(mats[0] == mats[1] && mats[0][3].abs() > 0.1, "{mats:?}");
}

#[test]
fn policy_run_answers_each_line_with_joint_targets() {
    let folder = tempfile::tempdir().unwrap();
    standing_policy().save(&folder.path().join("p.safetensors")).unwrap();
    let ask = |text: &str| {
        use std::io::Write;
        let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_policy"))
            .args(["run", "p.safetensors"])
            .current_dir(folder.path())
            .stdin(std::process::Stdio::piped())
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap();
        child.stdin.take().unwrap().write_all(text.as_bytes()).unwrap();
        child.wait_with_output().unwrap()
    };
    let line = serde_json::to_string(&vec![0.1; 83]).unwrap();
    let output = ask(&format!("{line}\n{line}\n"));
    let answers: Vec<Vec<f64>> =
        String::from_utf8(output.stdout).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect();
    assert_eq!(answers, vec![[0.0, 0.72, -1.44].repeat(4); 2]);
    let short = ask("[1, 2]\n");
    assert_eq!(short.status.code(), Some(2));
    assert!(complaint(&short).contains("line 1: 2 numbers, expected 83"), "{}", complaint(&short));
}

#[test]
fn examples_describe_what_they_say() {
    let folder = tempfile::tempdir().unwrap();
    let policy = ForeignPolicy::load(&example(folder.path(), "rsl_rl")).unwrap();
    // Ours are FR, FL, RR, RL: Isaac Gym's left legs come first.
    assert_eq!(policy.nominal_pose(), [-0.1, 0.8, -1.5, 0.1, 0.8, -1.5, -0.1, 1.0, -1.5, 0.1, 1.0, -1.5]);
    assert_eq!((policy.config().simulation.physics_rate_hz, policy.config().simulation.policy_rate_hz), (200, 50));
    assert!(Robot::load(&repository("examples/robots/quadruped.yaml")).unwrap_err().problem.contains("robot.xml"));
}
