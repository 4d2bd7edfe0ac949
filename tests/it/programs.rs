//! The programs as a user runs them.

use std::path::Path;
use std::process::Command;

use serde_json::Value;
use supple::policy::{Agent, Policy, shipped};
use supple::robot::Robot;
use supple::train::checkpoint::Checkpoint;

use crate::support::{
    assert_same_run, complaint, fails, metrics, program, refused, repository, robot, run, small_config,
    standing_policy, success, with_policy, with_small_config,
};

fn train(folder: &Path, arguments: &[&str]) {
    success(run("train", folder, arguments));
}

#[test]
fn any_number_of_threads_and_a_resumption_give_the_same_bits() {
    let folder = with_small_config();
    for learner in ["fused", "candle"] {
        // Layers wide enough for candle to hand their products out to threads if it may.
        let config = format!("{learner}.yaml");
        let text =
            format!("base: small.yaml\nppo: {{learner: {learner}, hidden_layers: [128, 16], minibatch_size: 128}}\n");
        std::fs::write(folder.path().join(&config), text).unwrap();
        let [one, two, three] = ["1", "2", "3"].map(|threads| {
            let out = format!("{learner}-{threads}");
            let arguments = ["--config", &config, "--samples", "5120", "--threads", threads, "--out", &out];
            // Of candle's own doing are as many parts of a product as this says.
            let mut train = Command::new(program("train"));
            let train = train.args(arguments).current_dir(folder.path()).env("RAYON_NUM_THREADS", threads);
            success(train.output().unwrap());
            folder.path().join(out)
        });
        let seen = metrics(&one);
        assert_eq!(seen.len(), 20);
        assert!(seen.iter().any(|line| line["falls"].as_u64() > Some(0)), "the test should see falls");
        assert!(seen.iter().any(|line| line["push_fraction"].as_f64() > Some(0.0)), "the test should see pushes");
        train(folder.path(), &["--config", &config, "--samples", "2560", "--out", "halves"]);
        train(folder.path(), &["--resume", "halves", "--samples", "5120", "--threads", "1"]);
        let halves = folder.path().join("halves");
        [&two, &three, &halves].iter().for_each(|other| assert_same_run(&one, other));
        std::fs::remove_dir_all(halves).unwrap();
    }
}

#[test]
fn policies_along_the_way_are_those_of_shorter_runs() {
    let folder = with_small_config();
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
    let mean = ["mean", "long/policy-700.safetensors", "long/policy-1400.safetensors", "--out", "mean.safetensors"];
    success(run("policy", folder.path(), &mean));
    let mean = Policy::load(&folder.path().join("mean.safetensors")).unwrap();
    let weight = |policy: &Policy| f64::from(policy.actor.layers[0].weight[5]);
    assert!((weight(&mean) - (weight(&kept(700)) + weight(&kept(1400))) / 2.0).abs() < 1e-7);
    let stranger = ["mean", "long/policy-700.safetensors", "other/policy-700.safetensors", "--out", "mean.safetensors"];
    train(folder.path(), &[&start[..], &["768", "--seed", "9", "--out", "other"]].concat());
    assert!(complaint(&run("policy", folder.path(), &stranger)).contains("do not come from one run"));
}

#[test]
fn resuming_with_another_configuration_names_the_keys() {
    let folder = with_small_config();
    std::fs::write(folder.path().join("other.yaml"), small_config().to_yaml().replacen("epochs: 2", "epochs: 3", 1))
        .unwrap();
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
    let xml = robot("quadruped.xml");
    let own = small_config().to_yaml().replacen("model: go1", &format!("model: {}", xml.display()), 1);
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
    let folder = with_small_config();
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
    let folder = with_policy();
    let train = |out: &str| {
        let arguments = ["--policy", "p.safetensors", "--episodes", "5", "--seed", "7", "--out", out];
        let output = success(run("train_contact", folder.path(), &arguments));
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(text.contains("held out: 1 episodes") && text.contains("\nFR "), "{text}");
        std::fs::read(folder.path().join(out)).unwrap()
    };
    assert!(train("one.safetensors") == train("two.safetensors"), "the networks differ");
    let cases: [(&[&str], &str); 3] = [
        (&["--policy", "nobody"], "there is no policy 'nobody'"),
        (&["--episodes", "4"], "4 is not in 5..=1000"),
        (&["--policy", "p.safetensors", "--out", "nowhere/c.safetensors"], "there is no folder nowhere"),
    ];
    for (arguments, expected) in cases {
        fails("train_contact", folder.path(), arguments, expected);
    }
}

#[test]
fn policy_program_shows_verifies_and_exports() {
    let folder = with_policy();
    let shown = run("policy", folder.path(), &["show", "p.safetensors"]);
    assert!(String::from_utf8_lossy(&shown.stdout).contains("RL_calf     -1.4400"));
    let json: Value =
        serde_json::from_slice(&run("policy", folder.path(), &["show", "p.safetensors", "--json"]).stdout).unwrap();
    assert_eq!(json["observation"].as_array().unwrap().len(), 14);
    success(run("policy", folder.path(), &["verify", "p.safetensors"]));
    let arguments = ["export", "p.safetensors", "--format", "onnx", "--out", "p.onnx"];
    success(run("policy", folder.path(), &arguments));
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
