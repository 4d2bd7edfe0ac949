//! What several tests need, also those of the other packages.
#![allow(dead_code)] // No test uses all of it.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;
use supple::config::Config;
use supple::network::ActorCritic;
use supple::policy::{Policy, Provenance, external, onnx};
use supple::robot::{JOINTS, Robot};
use supple::train::checkpoint::Checkpoint;
use supple::util::random::{Purpose, stream};
use tempfile::TempDir;

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

/// A folder with the small configuration, `small.yaml`.
pub fn with_small_config() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("small.yaml"), small_config().to_yaml()).unwrap();
    folder
}

/// A folder with a policy that stands, `p.safetensors`.
pub fn with_policy() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    standing_policy().save(&folder.path().join("p.safetensors")).unwrap();
    folder
}

/// A policy whose action is zero: it holds the nominal pose.
pub fn standing_policy() -> Policy {
    zero_policy(Config::load("compliant").unwrap())
}

/// A policy of a configuration whose action is zero.
pub fn zero_policy(config: Config) -> Policy {
    let (layout, mut rng) = (config.layout().unwrap(), stream(0, Purpose::Weights, 0, 0));
    let network = ActorCritic::orthogonal(layout.length(), &[8], JOINTS, -1.0, &mut rng);
    let robot = Robot::load(&config.robot.model).unwrap();
    let (git_revision, mujoco_version, config_name) = ("test".into(), "2.2.2".into(), "compliant".into());
    let samples = config.run.samples;
    let provenance =
        Provenance { config_name, seed: 0, samples, config, git_revision, mujoco_version, mean_of: vec![] };
    Policy::new(&network.zeros_like(), &robot, layout, provenance)
}

/// The file of a program of the package that is tested.
pub fn program(name: &str) -> &'static str {
    let path = match name {
        "evaluate" => option_env!("CARGO_BIN_EXE_evaluate"),
        "train" => option_env!("CARGO_BIN_EXE_train"),
        "policy" => option_env!("CARGO_BIN_EXE_policy"),
        "train_contact" => option_env!("CARGO_BIN_EXE_train_contact"),
        "scenario" => option_env!("CARGO_BIN_EXE_scenario"),
        other => panic!("no program {other}"),
    };
    path.unwrap_or_else(|| panic!("{name} is not of this package"))
}

/// Sends a signal, such as `-INT`, to a process.
pub fn send_signal(name: &str, process: u32) {
    assert!(Command::new("kill").args([name, &process.to_string()]).status().unwrap().success());
}

/// Runs one of the programs in a folder.
pub fn run(name: &str, folder: &Path, arguments: &[&str]) -> Output {
    Command::new(program(name)).args(arguments).current_dir(folder).output().unwrap()
}

/// Runs one of the programs in a folder, with text on its standard input.
pub fn with_input(name: &str, folder: &Path, arguments: &[&str], input: &[u8]) -> Output {
    let mut child = Command::new(program(name))
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    // It may have seen enough before all is written.
    let _ = child.stdin.take().unwrap().write_all(input);
    child.wait_with_output().unwrap()
}

/// A program's output, which has ended well.
pub fn success(output: Output) -> Output {
    assert!(output.status.success(), "{}", complaint(&output));
    output
}

/// Runs a program that fails, with exit code 2, these words and nothing on standard output. Returns its complaint.
pub fn fails(name: &str, folder: &Path, arguments: &[&str], words: &str) -> String {
    let output = run(name, folder, arguments);
    let complaint = complaint(&output);
    assert!(output.status.code() == Some(2) && complaint.contains(words), "{arguments:?}: {complaint}");
    assert!(output.stdout.is_empty(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stdout));
    complaint
}

/// Runs a program that refuses: it fails with one line, and within seconds. Returns the line.
pub fn refused(name: &str, folder: &Path, arguments: &[&str], words: &str) -> String {
    let begun = Instant::now();
    let complaint = fails(name, folder, arguments, words);
    assert_eq!(complaint.lines().count(), 1, "{arguments:?}: {complaint}");
    assert!(begun.elapsed() < Duration::from_secs(60), "{arguments:?} took {:?}", begun.elapsed());
    complaint
}

/// A file of the repository.
pub fn repository(path: &str) -> PathBuf {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = if package.join("models").exists() { package } else { package.parent().unwrap() };
    root.join(path)
}

/// A file of the robot for tests.
pub fn robot(name: &str) -> PathBuf {
    repository("tests/fixtures/robot").join(name)
}

/// An example from `examples/policies` with a network of the right shape from the fixtures.
pub fn example(folder: &Path, name: &str) -> PathBuf {
    let path = folder.join(format!("{name}.yaml"));
    let text = std::fs::read_to_string(repository("examples/policies").join(format!("{name}.yaml"))).unwrap();
    std::fs::write(&path, text.replace("policy.onnx", &format!("{name}.onnx"))).unwrap();
    std::fs::copy(repository("tests/fixtures/onnx").join(format!("{name}.onnx")), folder.join(format!("{name}.onnx")))
        .unwrap();
    path
}

/// An external policy whose network answers every observation with NaN, as after a training that blew up.
pub fn broken_policy(folder: &Path) -> PathBuf {
    let (path, mut policy) = (folder.join("broken.yaml"), standing_policy());
    policy.actor.layers.iter_mut().for_each(|layer| layer.bias.fill(f32::NAN));
    std::fs::write(folder.join("broken.onnx"), onnx::export(&policy)).unwrap();
    std::fs::write(&path, external::describe(&policy, "broken.onnx")).unwrap();
    path
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

/// Two runs of the same bits, whole: metrics, checkpoint and policy.
pub fn assert_same_run(a: &Path, b: &Path) {
    assert_same(&metrics(a), &metrics(b));
    let load = |folder: &Path| {
        let (mut checkpoint, passed_over) = Checkpoint::load(folder).unwrap();
        assert!(passed_over.is_none());
        // The only number that differs between two runs of the same seed.
        checkpoint.run.elapsed_s = 0.0;
        checkpoint
    };
    assert!(load(a) == load(b), "the last checkpoints differ");
    let policy = |folder: &Path| std::fs::read(folder.join("policy.safetensors")).unwrap();
    assert!(policy(a) == policy(b), "the policies differ");
}
