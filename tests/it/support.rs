//! What several tests need.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use serde_json::Value;
use supple::config::Config;
use supple::go1::JOINT_COUNT;
use supple::policy::{Policy, Provenance};
use supple::ppo::ActorCritic;
use supple::random::{Purpose, stream};
use supple::task::observation::LENGTH;

/// A configuration small enough for tests: the paper's task, a tiny learner.
pub fn small_config() -> Config {
    let mut config = Config::load("compliant").unwrap();
    config.ppo.batch_size = 256;
    config.ppo.minibatch_size = 64;
    config.ppo.environments = 8;
    config.ppo.epochs = 2;
    config.ppo.hidden_layers = vec![32, 16];
    // Episodes short enough that every stage and end occurs.
    config.episode.walking_s = 0.3;
    config.episode.recovery_s = 0.2;
    config.episode.post_recovery_s = 0.2;
    config.episode.push_gate = 0.3;
    config.run.checkpoint_every = 3;
    config
}

/// Writes the small configuration into a folder.
pub fn small_config_file(folder: &Path) -> PathBuf {
    let path = folder.join("small.yaml");
    std::fs::write(&path, small_config().to_yaml()).unwrap();
    path
}

/// A policy whose action is zero: it holds the nominal pose.
pub fn standing_policy() -> Policy {
    let network = ActorCritic::orthogonal(LENGTH, &[8], JOINT_COUNT, -1.0, &mut stream(0, Purpose::Weights, 0, 0));
    let provenance = Provenance {
        config_name: "compliant".into(),
        config: Config::load("compliant").unwrap(),
        seed: 0,
        samples: 0,
        git_revision: "test".into(),
        mujoco_version: "2.2.2".into(),
    };
    Policy::new(&network.zeros_like(), provenance)
}

/// Runs one of the programs in a folder.
pub fn run(program: &str, folder: &Path, arguments: &[&str]) -> Output {
    let path = match program {
        "evaluate" => env!("CARGO_BIN_EXE_evaluate"),
        "train" => env!("CARGO_BIN_EXE_train"),
        "policy" => env!("CARGO_BIN_EXE_policy"),
        "train_contact" => env!("CARGO_BIN_EXE_train_contact"),
        "scenario" => env!("CARGO_BIN_EXE_scenario"),
        other => panic!("no program {other}"),
    };
    Command::new(path).args(arguments).current_dir(folder).output().unwrap()
}

/// Standard error as text.
pub fn complaint(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).trim().to_owned()
}

/// Metrics without the wall-clock times.
pub fn metrics(folder: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(folder.join("metrics.jsonl")).unwrap();
    text.lines()
        .map(|line| {
            let mut object: Value = serde_json::from_str(line).unwrap();
            object.as_object_mut().unwrap().remove("time").unwrap();
            object
        })
        .collect()
}

/// Names the first iteration and number that differ.
pub fn assert_same(a: &[Value], b: &[Value]) {
    assert_eq!(a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        for (key, value) in a.as_object().unwrap() {
            assert_eq!(value, &b[key], "{key} of iteration {}", a["iteration"]);
        }
    }
}
