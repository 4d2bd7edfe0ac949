//! The programs as a user runs them.

use std::path::Path;
use std::process::Command;

use serde_json::Value;
use supple::config::{Config, LearnerKind};
use supple::policy::{Agent, Policy, shipped};
use supple::robot::Robot;
use supple::train::checkpoint::Checkpoint;

use crate::support::{
    assert_same, complaint, metrics, program, refused, repository, robot, run, small_config_file, standing_policy,
    success,
};

/// Writes a configuration for each learner into a folder, with layers wide enough for candle to hand their products out to
/// threads if it may.
fn learners(folder: &Path) -> [&'static str; 2] {
    small_config_file(folder);
    ["fused", "candle"].map(|learner| {
        let wide = "hidden_layers: [128, 16], minibatch_size: 128";
        let text = format!("base: small.yaml\nppo: {{learner: {learner}, {wide}}}\n");
        std::fs::write(folder.join(format!("{learner}.yaml")), text).unwrap();
        learner
    })
}

fn train(folder: &Path, arguments: &[&str]) {
    success(run("train", folder, arguments));
}

#[test]
fn metrics_do_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    for learner in learners(folder.path()) {
        let [one, two, three] = ["1", "2", "3"].map(|threads| {
            let (config, out) = (format!("{learner}.yaml"), format!("{learner}-{threads}"));
            let arguments = ["--config", &config, "--samples", "5120", "--threads", threads, "--out", &out];
            // Of candle's own doing are as many parts of a product as this says.
            let mut train = Command::new(program("train"));
            let train = train.args(arguments).current_dir(folder.path()).env("RAYON_NUM_THREADS", threads);
            let output = train.output().unwrap();
            assert!(output.status.success(), "{}", complaint(&output));
            metrics(&folder.path().join(out))
        });
        assert_eq!(one.len(), 20);
        assert!(one.iter().any(|line| line["falls"].as_u64() > Some(0)), "the test should see falls");
        assert!(one.iter().any(|line| line["push_fraction"].as_f64() > Some(0.0)), "the test should see pushes");
        assert_same(&one, &two);
        assert_same(&one, &three);
    }
}

#[test]
fn a_resumed_run_gives_the_bits_of_an_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    for learner in learners(folder.path()) {
        let (config, halves) = (format!("{learner}.yaml"), format!("{learner}-halves"));
        train(folder.path(), &["--config", &config, "--samples", "5120", "--out", learner]);
        train(folder.path(), &["--config", &config, "--samples", "2560", "--out", &halves]);
        train(folder.path(), &["--resume", &halves, "--samples", "5120", "--threads", "1"]);
        let (whole, halves) = (folder.path().join(learner), folder.path().join(halves));
        assert_same(&metrics(&whole), &metrics(&halves));
        let policy = |run: &Path| std::fs::read(run.join("policy.safetensors")).unwrap();
        assert!(policy(&whole) == policy(&halves), "the policies differ");
    }
}

#[test]
fn policies_along_the_way_are_those_of_shorter_runs() {
    let folder = tempfile::tempdir().unwrap();
    small_config_file(folder.path());
    let start = ["--config", "small.yaml", "--set", "run.keep_policy_every=700", "--samples"];
    train(folder.path(), &[&start[..], &["1536", "--out", "long"]].concat());
    let kept = |samples: u64| Policy::load(&folder.path().join(format!("long/policy-{samples}.safetensors"))).unwrap();
    for (samples, passed) in [("768", 700), ("1536", 1400)] {
        train(folder.path(), &[&start[..], &[samples, "--out", samples]].concat());
        let newest = Policy::load(&folder.path().join(samples).join("policy.safetensors")).unwrap();
        assert_eq!(kept(passed).provenance.samples, newest.provenance.samples);
        assert!(kept(passed).actor == newest.actor, "the policies after {samples} samples differ");
    }
    assert!(!folder.path().join("768/policy-1400.safetensors").exists());
}

#[test]
fn both_learners_make_the_same_of_the_first_batch() {
    let folder = tempfile::tempdir().unwrap();
    let [(fused, rollout), (candle, same_rollout)] = learners(folder.path()).map(|learner| {
        train(folder.path(), &["--config", &format!("{learner}.yaml"), "--samples", "256", "--out", learner]);
        let mut metrics = metrics(&folder.path().join(learner));
        (metrics[0].as_object_mut().unwrap().remove("learner").unwrap(), metrics)
    });
    assert_same(&rollout, &same_rollout);
    for (key, fused) in fused.as_object().unwrap() {
        let (fused, candle) = (fused.as_f64().unwrap(), candle[key].as_f64().unwrap());
        assert!((fused - candle).abs() <= 1e-3 * fused.abs(), "{key}: {fused} and {candle}");
    }
    let config =
        |learner: &str| Config::load(folder.path().join(learner).join("config.yaml").to_str().unwrap()).unwrap();
    assert_eq!(["candle", "fused"].map(|name| config(name).ppo.learner), [LearnerKind::Candle, LearnerKind::Fused]);
}

#[test]
fn resuming_with_another_configuration_names_the_keys() {
    let folder = tempfile::tempdir().unwrap();
    let small = std::fs::read_to_string(small_config_file(folder.path())).unwrap();
    std::fs::write(folder.path().join("other.yaml"), small.replacen("epochs: 2", "epochs: 3", 1)).unwrap();
    let arguments = ["--config", "small.yaml", "--samples", "256", "--out", "run"];
    success(run("train", folder.path(), &arguments));
    let cases: [(&str, &[&str], Option<&str>); 5] = [
        (
            "train",
            &["--resume", "run", "--config", "other.yaml"],
            Some("run was not begun with other.yaml: ppo.epochs: 2 and 3"),
        ),
        ("train", &["--resume", "run", "--config", "small.yaml", "--samples", "512"], None),
        (
            "policy",
            &["verify", "run", "--config", "other.yaml"],
            Some("run does not come from other.yaml: ppo.epochs: 2 and 3"),
        ),
        (
            "policy",
            &["verify", "run", "--samples", "513"],
            Some("run has learnt from 512 samples, expected 513 or more"),
        ),
        ("policy", &["verify", "run", "--config", "small.yaml", "--samples", "512"], None),
    ];
    for (program, arguments, expected) in cases {
        let output = run(program, folder.path(), arguments);
        assert_eq!(output.status.success(), expected.is_none(), "{arguments:?}: {}", complaint(&output));
        assert!(complaint(&output).contains(expected.unwrap_or("")), "{arguments:?}: {}", complaint(&output));
    }
    // What a resumption changes stands in the run's own configuration, too.
    assert!(std::fs::read_to_string(folder.path().join("run/config.yaml")).unwrap().contains("samples: 512"));
}

#[test]
fn run_of_another_robot_needs_that_robot() {
    let folder = tempfile::tempdir().unwrap();
    let small = std::fs::read_to_string(small_config_file(folder.path())).unwrap();
    let xml = robot("quadruped.xml");
    let own = small.replacen("model: go1", &format!("model: {}", xml.display()), 1);
    std::fs::write(folder.path().join("own.yaml"), own).unwrap();
    train(folder.path(), &["--config", "own.yaml", "--samples", "256", "--out", "run"]);
    for arguments in [&["verify", "run", "--config", "own.yaml"][..], &["card", "run"]] {
        let output = run("policy", folder.path(), arguments);
        assert!(output.status.success(), "{arguments:?}: {}", complaint(&output));
    }
    let far = folder.path().join("far");
    std::fs::create_dir(&far).unwrap();
    std::fs::copy(folder.path().join("run/policy.safetensors"), far.join("p.safetensors")).unwrap();
    let model = Agent::load(&far.join("p.safetensors")).unwrap().config.robot.model;
    assert_eq!(model, far.join("quadruped.xml").to_str().unwrap());
    let error = Robot::load(&model).unwrap_err().to_string();
    assert!(error.contains("there is no such file: put it there, or name another robot"), "{error}");
    success(run("policy", folder.path(), &["verify", "far/p.safetensors"]));

    // Its file lies elsewhere, as on another machine.
    std::os::unix::fs::symlink(xml.parent().unwrap(), folder.path().join("moved")).unwrap();
    let (place, moved) = (folder.path().join("run"), folder.path().join("moved/quadruped.xml"));
    let config = std::fs::read_to_string(place.join("config.yaml")).unwrap();
    let config = config.replacen(xml.to_str().unwrap(), moved.to_str().unwrap(), 1);
    std::fs::write(place.join("config.yaml"), config).unwrap();
    let output = run("train", folder.path(), &["--resume", "run", "--samples", "512"]);
    let words = complaint(&output);
    assert!(output.status.success() && words.contains("robot.model is"), "{words}");
    // The robot has changed, and so has the program, which may only read it differently.
    let mut checkpoint = Checkpoint::load(&place).unwrap().0;
    (checkpoint.run.git_revision, checkpoint.run.robot_sha256) = ("another".to_owned(), "0".repeat(64));
    checkpoint.save(&place).unwrap();
    let output = run("train", folder.path(), &["--resume", "run", "--samples", "768"]);
    let words = complaint(&output);
    assert!(output.status.success() && words.contains("moved/quadruped.xml has changed since"), "{words}");
}

#[test]
fn a_damaged_checkpoint_falls_back_to_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    small_config_file(folder.path());
    let arguments = ["--config", "small.yaml", "--samples", "1536", "--out", "run"];
    let output = run("train", folder.path(), &arguments);
    assert!(output.status.success());
    // Without a terminal there is a line of progress at each checkpoint.
    let words = complaint(&output);
    let first = words.lines().next().unwrap_or_default();
    assert!(first.starts_with("768 of 1536 samples: reward "), "{words}");
    assert!(first.contains(" samples/s, ") && first.ends_with(" left"), "{words}");
    let newest = folder.path().join("run/checkpoint.safetensors");
    let mut bytes = std::fs::read(&newest).unwrap();
    let middle = bytes.len() * 9 / 10;
    bytes[middle] ^= 1;
    std::fs::write(&newest, &bytes).unwrap();

    let output = success(run("train", folder.path(), &["--resume", "run", "--samples", "1792"]));
    assert!(complaint(&output).contains("continuing from the checkpoint before it"), "{}", complaint(&output));
    assert_eq!(metrics(&folder.path().join("run")).len(), 7);
    let text = |name: &str| std::fs::read(folder.path().join("run").join(name)).unwrap();
    assert_eq!(text("checkpoint.damaged.safetensors"), bytes);
    assert_ne!(text("checkpoint.previous.safetensors"), bytes);
    std::fs::write(&newest, "damaged").unwrap();
    success(run("train", folder.path(), &["--resume", "run", "--samples", "1792"]));
    assert_eq!(text("checkpoint.damaged.safetensors"), b"damaged");
    assert_ne!(text("checkpoint.previous.safetensors"), b"damaged");

    for file in ["checkpoint.safetensors", "checkpoint.previous.safetensors"] {
        let path = folder.path().join("run").join(file);
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    }
    refused("train", folder.path(), &["--resume", "run"], "was it cut off");
}

#[test]
fn train_contact_is_reproducible_and_refuses_bad_input() {
    let folder = tempfile::tempdir().unwrap();
    standing_policy().save(&folder.path().join("standing.safetensors")).unwrap();
    let train = |out: &str| {
        let arguments = ["--policy", "standing.safetensors", "--episodes", "5", "--seed", "7", "--out", out];
        let output = success(run("train_contact", folder.path(), &arguments));
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(text.contains("held out: 1 episodes") && text.contains("\nFR "), "{text}");
        std::fs::read(folder.path().join(out)).unwrap()
    };
    assert!(train("one.safetensors") == train("two.safetensors"), "the networks differ");
    let cases: [(&[&str], &str); 3] = [
        (&["--policy", "nobody"], "there is no policy 'nobody'"),
        (&["--episodes", "4"], "4 is not in 5..=1000"),
        (&["--policy", "standing.safetensors", "--out", "nowhere/c.safetensors"], "there is no folder nowhere"),
    ];
    for (arguments, expected) in cases {
        let output = run("train_contact", folder.path(), arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(complaint(&output).contains(expected), "{}", complaint(&output));
    }
}

#[test]
fn policy_program_shows_verifies_and_exports() {
    let folder = tempfile::tempdir().unwrap();
    standing_policy().save(&folder.path().join("p.safetensors")).unwrap();
    let shown = run("policy", folder.path(), &["show", "p.safetensors"]);
    assert!(String::from_utf8_lossy(&shown.stdout).contains("RL_calf     -1.4400"));
    let json: Value =
        serde_json::from_slice(&run("policy", folder.path(), &["show", "p.safetensors", "--json"]).stdout).unwrap();
    assert_eq!(json["observation"].as_array().unwrap().len(), 14);
    success(run("policy", folder.path(), &["verify", "p.safetensors"]));
    let arguments = ["export", "p.safetensors", "--format", "onnx", "--out", "p.onnx"];
    success(run("policy", folder.path(), &arguments));
    let onnx = std::fs::read(folder.path().join("p.onnx")).unwrap();
    for name in ["observation", "joint_target", "Gemm", "Elu"] {
        assert!(onnx.windows(name.len()).any(|window| window == name.as_bytes()), "{name}");
    }
    // Its own description is written again; one made by hand is not, nor is the network written to its place.
    success(run("policy", folder.path(), &arguments));
    std::fs::write(folder.path().join("p.yaml"), "onnx: mine.onnx\n").unwrap();
    for (out, expected) in [("p.onnx", "p.yaml was not written by"), ("q.yaml", "is where the description goes")] {
        refused("policy", folder.path(), &["export", "p.safetensors", "--format", "onnx", "--out", out], expected);
    }
    assert_eq!(std::fs::read_to_string(folder.path().join("p.yaml")).unwrap(), "onnx: mine.onnx\n");
}

#[test]
fn compliance_of_an_exported_network_can_be_commanded() {
    let folder = tempfile::tempdir().unwrap();
    success(run("policy", folder.path(), &["export", "baseline", "--format", "onnx", "--out", "b.onnx"]));
    let agent = shipped::find(&format!("{}@0.03", folder.path().join("b.yaml").display())).unwrap();
    assert_eq!(agent.resolve_compliance(None, None), Ok(Some(0.03)));
    assert_eq!(agent.calibration.unwrap().points, shipped::find("baseline").unwrap().calibration.unwrap().points);
}

#[test]
fn policy_calibrate_reproduces_the_shipped_calibration() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::copy(repository("policies/baseline-seed0.safetensors"), folder.path().join("b.safetensors")).unwrap();
    success(run("policy", folder.path(), &["calibrate", "b.safetensors"]));
    let read = |path: &Path| -> Value { serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap() };
    let found = read(&folder.path().join("b.calibration.json"));
    let ships = read(&repository("policies/baseline-seed0.calibration.json"));
    assert_eq!(found["sha256"], ships["sha256"]);
    // Another machine's libm may round otherwise, and a fall ends the list.
    let near = |a: &Value, b: &Value| (a.as_f64().unwrap() / b.as_f64().unwrap() - 1.0).abs() < 0.1;
    for axis in 0..2 {
        assert!(near(&found["own_m_s_per_n"][axis], &ships["own_m_s_per_n"][axis]), "{found:#}");
        let points = |calibration: &Value| calibration["points"].as_array().unwrap().clone();
        for (a, b) in points(&found).iter().zip(&points(&ships)) {
            assert!(near(&a["measured"][axis], &b["measured"][axis]), "{found:#}");
        }
        assert!(points(&found).len() > 5, "{found:#}");
    }

    standing_policy().save(&folder.path().join("p.safetensors")).unwrap();
    refused("policy", folder.path(), &["calibrate", "p.safetensors"], "error: p.safetensors: it ");
    assert!(!folder.path().join("p.calibration.json").exists());
}
