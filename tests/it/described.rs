//! `policy describe`: external policies by what their frameworks wrote.

use std::path::Path;

use serde_json::Value;

use crate::support::{complaint, example, repository, run, success, with_input};

/// The policy of examples/policies/rsl_rl.yaml, trained on a Go1, as a `deploy.yaml` has it.
const DEPLOY: &str = "\
joint_ids_map: [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8]
step_dt: 0.02
stiffness: [20, 20, 20, 20, 20, 20, 20, 20, 20, 20, 20, 20]
damping: [0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]
default_joint_pos: &pose [0.1, 0.8, -1.5, -0.1, 0.8, -1.5, 0.1, 1.0, -1.5, -0.1, 1.0, -1.5]
actions:
  JointPositionAction:
    clip: null
    scale: [0.25, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25]
    offset: *pose
observations:
  base_lin_vel: {params: {}, clip: null, scale: [2.0, 2.0, 2.0]}
  base_ang_vel: {params: {}, clip: null, scale: [0.25, 0.25, 0.25]}
  projected_gravity: {params: {}, clip: null, scale: null}
  velocity_commands: {params: {}, clip: null, scale: [2.0, 2.0, 0.25]}
  joint_pos_rel: {params: {}, clip: null, scale: null}
  joint_vel_rel: {params: {}, clip: null, scale: [&v 0.05, *v, *v, *v, *v, *v, *v, *v, *v, *v, *v, *v]}
  last_action: {params: {}, clip: null, scale: null}
";

/// Returns the names of the numbers that a policy observes, and its joint targets for an observation.
fn behaviour(folder: &Path, policy: &str) -> (Value, String) {
    let shown = run("policy", folder, &["show", policy, "--json"]);
    let shown: Value = serde_json::from_slice(&shown.stdout).unwrap_or_else(|_| panic!("{}", complaint(&shown)));
    let observation: Vec<f64> = (0..48).map(|k| 0.02 * f64::from(k)).collect();
    let output = with_input("policy", folder, &["run", policy], format!("{observation:?}\n").as_bytes());
    (shown["observation_elements"].clone(), String::from_utf8(output.stdout).unwrap())
}

#[test]
fn a_deploy_yaml_becomes_the_description_written_by_hand() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    example(folder, "rsl_rl");
    let deploy = |file: &str| {
        std::fs::write(folder.join("deploy.yaml"), file).unwrap();
        let arguments = ["--onnx", "rsl_rl.onnx", "--robot", "go1", "--out", "mine.yaml"];
        run("policy", folder, &[&["describe", "deploy.yaml"], &arguments[..]].concat())
    };
    let output = success(deploy(DEPLOY));
    assert!(String::from_utf8_lossy(&output.stdout).contains("it fits rsl_rl.onnx"));
    let hand = behaviour(folder, "rsl_rl.yaml");
    assert_eq!(hand.0.as_array().unwrap().len(), 48);
    assert_eq!(behaviour(folder, "mine.yaml"), hand);
    // A description that was edited is not lost.
    let again = deploy(DEPLOY);
    assert!(complaint(&again).contains("mine.yaml exists already"), "{}", complaint(&again));
    // Right legs for left ones, and the sign of a hip, are another policy.
    for (from, to) in [("[3, 4, 5, 0, 1, 2,", "[0, 1, 2, 3, 4, 5,"), ("pose [0.1,", "pose [-0.1,")] {
        std::fs::remove_file(folder.join("mine.yaml")).unwrap();
        assert!(deploy(&DEPLOY.replace(from, to)).status.success());
        assert_ne!(behaviour(folder, "mine.yaml"), hand, "{to}");
    }
    // A network that takes other observations is refused before anything is written.
    std::fs::remove_file(folder.join("mine.yaml")).unwrap();
    let output = deploy(&DEPLOY.replace("  projected_gravity: {params: {}, clip: null, scale: null}\n", ""));
    assert!(complaint(&output).contains("has 45 numbers"), "{}", complaint(&output));
    assert!(!folder.join("mine.yaml").exists());
}

#[test]
fn an_onnx_file_is_described_by_its_metadata_or_refused_with_a_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let bare = std::fs::read(repository("tests/fixtures/onnx/rsl_rl.onnx")).unwrap();
    std::fs::write(folder.join("bare.onnx"), &bare).unwrap();
    let describe = |name: &str| run("policy", folder, &["describe", name, "--robot", "go1", "--out", "mine.yaml"]);
    let output = describe("bare.onnx");
    let expected = "bare.onnx: it has no joint_names among its metadata";
    assert!(complaint(&output).contains(expected), "{}", complaint(&output));
    let twelve = |value: &str| [value; 12].join(",");
    let legs = ["FL", "FR", "RL", "RR"];
    let joints = ["hip", "thigh", "calf"].map(|part| legs.map(|leg| format!("{leg}_{part}_joint")).join(",")).join(",");
    let pose = "0.1,-0.1,0.1,-0.1,0.8,0.8,1.0,1.0,-1.5,-1.5,-1.5,-1.5";
    let names = "base_lin_vel,base_ang_vel,projected_gravity,command,joint_pos,joint_vel,actions";
    let metadata = [
        ("joint_names", joints.as_str()),
        ("joint_stiffness", &twelve("20.000")),
        ("joint_damping", &twelve("0.500")),
        ("default_joint_pos", pose),
        ("action_scale", "0.25"),
        ("observation_names", names),
    ];
    // Field 14 of a model, as often as there are entries; a length of more than 127 takes two bytes.
    let field = |key: u8, content: &[u8]| {
        let length = content.len();
        [&[key, 0x80 | (length & 0x7f) as u8, (length >> 7) as u8], content].concat()
    };
    let entry = |(key, value): &(&str, &str)| {
        field(14 << 3 | 2, &[field(1 << 3 | 2, key.as_bytes()), field(2 << 3 | 2, value.as_bytes())].concat())
    };
    let with = [bare, metadata.iter().flat_map(entry).collect()].concat();
    std::fs::write(folder.join("with.onnx"), with).unwrap();
    success(describe("with.onnx"));
    let (observation, targets) = behaviour(folder, "mine.yaml");
    assert!(observation[12].to_string().contains("FL_hip") && observation[13].to_string().contains("FR_hip"));
    let targets: Vec<f64> = serde_json::from_str(&targets).unwrap();
    assert_eq!(targets.len(), 12);
    let text = std::fs::read_to_string(folder.join("mine.yaml")).unwrap();
    assert!(text.contains("policy_rate_hz: 50   # check this") && !text.contains("names no robot"), "{text}");
}
