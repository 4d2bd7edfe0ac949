//! The programs as a user runs them.

use serde_json::Value;

use crate::support::{assert_same, complaint, metrics, run, small_config_file, standing_policy};

#[test]
fn metrics_do_not_depend_on_the_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    small_config_file(folder.path());
    for threads in ["1", "2", "3"] {
        let arguments = ["--config", "small.yaml", "--samples", "5120", "--threads", threads, "--out", threads];
        let output = run("train", folder.path(), &arguments);
        assert!(output.status.success(), "{}", complaint(&output));
    }
    let one = metrics(&folder.path().join("1"));
    assert_eq!(one.len(), 20);
    assert!(one.iter().any(|line| line["falls"].as_u64() > Some(0)), "the test should see falls");
    assert!(one.iter().any(|line| line["push_share"].as_f64() > Some(0.0)), "the test should see pushes");
    assert_same(&one, &metrics(&folder.path().join("2")));
    assert_same(&one, &metrics(&folder.path().join("3")));
}

#[test]
fn a_resumed_run_gives_the_bits_of_an_uninterrupted_one() {
    let folder = tempfile::tempdir().unwrap();
    small_config_file(folder.path());
    let train = |arguments: &[&str]| {
        let output = run("train", folder.path(), arguments);
        assert!(output.status.success(), "{}", complaint(&output));
    };
    train(&["--config", "small.yaml", "--samples", "5120", "--out", "whole"]);
    train(&["--config", "small.yaml", "--samples", "2560", "--out", "halves"]);
    train(&["--resume", "halves", "--samples", "5120", "--threads", "1"]);
    let (whole, halves) = (folder.path().join("whole"), folder.path().join("halves"));
    assert_same(&metrics(&whole), &metrics(&halves));
    let policy = |run: &std::path::Path| std::fs::read(run.join("policy.safetensors")).unwrap();
    assert!(policy(&whole) == policy(&halves), "the policies differ");
}

#[test]
fn a_run_and_its_policy_are_of_one_configuration_and_another_one_is_told_by_its_keys() {
    let folder = tempfile::tempdir().unwrap();
    let small = std::fs::read_to_string(small_config_file(folder.path())).unwrap();
    std::fs::write(folder.path().join("other.yaml"), small.replacen("epochs: 2", "epochs: 3", 1)).unwrap();
    let arguments = ["--config", "small.yaml", "--samples", "256", "--out", "run"];
    assert!(run("train", folder.path(), &arguments).status.success());
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
fn a_damaged_checkpoint_falls_back_to_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    small_config_file(folder.path());
    let arguments = ["--config", "small.yaml", "--samples", "1536", "--out", "run"];
    let output = run("train", folder.path(), &arguments);
    assert!(output.status.success());
    // Without a terminal there is a line of progress at each checkpoint.
    assert!(complaint(&output).starts_with("768 of 1536 samples: reward "), "{}", complaint(&output));
    let newest = folder.path().join("run/checkpoint.safetensors");
    let mut bytes = std::fs::read(&newest).unwrap();
    let middle = bytes.len() * 9 / 10;
    bytes[middle] ^= 1;
    std::fs::write(&newest, &bytes).unwrap();

    let output = run("train", folder.path(), &["--resume", "run", "--samples", "1792"]);
    assert!(output.status.success(), "{}", complaint(&output));
    assert!(complaint(&output).contains("going on from the checkpoint before it"), "{}", complaint(&output));
    assert_eq!(metrics(&folder.path().join("run")).len(), 7);

    for file in ["checkpoint.safetensors", "checkpoint.previous.safetensors"] {
        let path = folder.path().join("run").join(file);
        let bytes = std::fs::read(&path).unwrap();
        std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    }
    let output = run("train", folder.path(), &["--resume", "run"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(complaint(&output).contains("was it cut off"), "{}", complaint(&output));
}

#[test]
fn bad_input_is_one_line_that_names_the_thing_and_exits_with_2() {
    let folder = tempfile::tempdir().unwrap();
    let config = small_config_file(folder.path());
    let text = std::fs::read_to_string(&config).unwrap();
    let write = |name: &str, from: &str, to: &str| {
        assert!(text.contains(from), "{from}");
        std::fs::write(folder.path().join(name), text.replacen(from, to, 1)).unwrap();
    };
    write("unknown.yaml", "latency_s:", "latencyy_s:");
    write("negative.yaml", "walking_s: 0.3", "walking_s: -0.3");
    write("rates.yaml", "policy_rate_hz: 60", "policy_rate_hz: 70");
    write("model.yaml", "model: go1", "model: nowhere/robot.xml");
    std::fs::create_dir(folder.path().join("taken")).unwrap();
    let cases: [(&[&str], &str); 8] = [
        (&["--config", "unknown.yaml", "--out", "x"], "latencyy_s"),
        (&["--config", "negative.yaml", "--out", "x"], "episode.walking_s is -0.3, expected at least one policy step"),
        (&["--config", "rates.yaml", "--out", "x"], "a multiple of policy_rate_hz (70 Hz)"),
        (&["--config", "model.yaml", "--out", "x"], "nowhere/robot.xml"),
        (&["--config", "nowhere.yaml", "--out", "x"], "nowhere.yaml"),
        (&["--config", "small.yaml", "--out", "taken"], "taken exists already"),
        (&["--resume", "taken"], "taken is not a run's folder"),
        (&["--resume", "nowhere"], "nowhere is not a run's folder"),
    ];
    for (arguments, expected) in cases {
        let output = run("train", folder.path(), arguments);
        let complaint = complaint(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {complaint}");
        assert!(complaint.contains(expected), "{arguments:?}: {complaint}");
        assert_eq!(complaint.lines().count(), 1, "{complaint}");
        assert!(!folder.path().join("x").exists(), "{arguments:?} left a folder");
    }
}

#[test]
fn ctrl_c_finishes_the_iteration_and_says_how_to_go_on_and_nobody_else_trains_there() {
    let folder = tempfile::tempdir().unwrap();
    small_config_file(folder.path());
    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_train"))
        .args(["--config", "small.yaml", "--samples", "100000000", "--out", "run"])
        .current_dir(folder.path())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    let checkpoint = folder.path().join("run/checkpoint.safetensors");
    while !checkpoint.exists() {
        assert!(child.try_wait().unwrap().is_none(), "train ended by itself");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let second = run("train", folder.path(), &["--resume", "run"]);
    assert_eq!(second.status.code(), Some(2));
    assert!(complaint(&second).contains("another process is training in run"), "{}", complaint(&second));
    let interrupt = std::process::Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(interrupt.success());
    let output = child.wait_with_output().unwrap();
    assert!(output.status.success());
    assert!(complaint(&output).contains("train --resume run"), "{}", complaint(&output));
    assert!(run("train", folder.path(), &["--resume", "run", "--samples", "1"]).status.success());
}

#[test]
fn scenario_prints_one_json_object_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    standing_policy().save(&folder.path().join("standing.safetensors")).unwrap();
    let arguments = ["push", "--policy", "standing.safetensors", "--push-m-s", "0.1", "--json", "--csv", "t.csv"];
    let output = run("scenario", folder.path(), &arguments);
    assert!(output.status.success(), "{}", complaint(&output));
    let object: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(object["scenario"], "push");
    assert_eq!(object["parameters"]["push_m_s"], 0.1);
    assert!(object["runs"][0]["metrics"]["decay_10_s"].is_number(), "{object}");
    assert_eq!(std::fs::read_to_string(folder.path().join("t.csv")).unwrap().lines().count(), 1 + 480);
    assert!(folder.path().join("push.rrd").exists() == cfg!(feature = "record"));
}

#[test]
fn scenario_tells_how_good_the_estimates_of_a_robot_on_sensors_are() {
    let folder = tempfile::tempdir().unwrap();
    standing_policy().save(&folder.path().join("standing.safetensors")).unwrap();
    let walk = ["walk", "--policy", "standing.safetensors", "--duration-s", "1", "--json", "--no-record"];
    let play = |sensing: &str| -> Value {
        let output = run("scenario", folder.path(), &[&walk[..], &["--sensing", sensing]].concat());
        assert!(output.status.success(), "{}", complaint(&output));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let (truth, estimated) = (play("true"), play("estimated"));
    assert_eq!((&truth["sensing"], &estimated["sensing"]), (&"true".into(), &"estimated".into()));
    assert_eq!(truth["runs"][0]["metrics"]["contact_f1"], Value::Null);
    for name in ["estimate_velocity_rmse_m_s", "estimate_height_rmse_m", "estimate_drift_m", "contact_f1"] {
        assert!(estimated["runs"][0]["metrics"][name].is_number(), "{name}: {estimated}");
    }
    // The estimates stand beside the truth in the CSV, which has none without sensors.
    let last_row = |sensing: &str| -> Vec<String> {
        let arguments = [&walk[..], &["--sensing", sensing, "--csv", "t.csv"]].concat();
        assert!(run("scenario", folder.path(), &arguments).status.success());
        let text = std::fs::read_to_string(folder.path().join("t.csv")).unwrap();
        let rows: Vec<&str> = text.lines().collect();
        let row: Vec<String> = rows[rows.len() - 1].split(',').map(ToOwned::to_owned).collect();
        assert_eq!(row.len(), rows[0].split(',').count());
        let column = |name: &str| rows[0].split(',').position(|found| found == name).unwrap();
        ["height_m", "estimated_height_m"].map(|name| row[column(name)].clone()).into()
    };
    let heights: Vec<f64> = last_row("estimated").iter().map(|cell| cell.parse().unwrap()).collect();
    assert!(heights[0] != heights[1] && (heights[0] - heights[1]).abs() < 0.01, "{heights:?}");
    assert_eq!(last_row("true")[1], "");
    // A standing robot knows that it stands.
    assert!(estimated["runs"][0]["metrics"]["estimate_velocity_rmse_m_s"].as_f64().unwrap() < 0.05);
}

#[test]
fn train_contact_is_reproducible_and_refuses_bad_input() {
    let folder = tempfile::tempdir().unwrap();
    standing_policy().save(&folder.path().join("standing.safetensors")).unwrap();
    let train = |out: &str| {
        let arguments = ["--policy", "standing.safetensors", "--episodes", "5", "--seed", "7", "--out", out];
        let output = run("train_contact", folder.path(), &arguments);
        assert!(output.status.success(), "{}", complaint(&output));
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
    assert!(run("policy", folder.path(), &["verify", "p.safetensors"]).status.success());
    let arguments = ["export", "p.safetensors", "--format", "onnx", "--out", "p.onnx"];
    assert!(run("policy", folder.path(), &arguments).status.success());
    let onnx = std::fs::read(folder.path().join("p.onnx")).unwrap();
    for name in ["observation", "joint_target", "Gemm", "Elu"] {
        assert!(onnx.windows(name.len()).any(|window| window == name.as_bytes()), "{name}");
    }
    // Its own description is written again; one made by hand is not, nor is the network written to its place.
    assert!(run("policy", folder.path(), &arguments).status.success());
    std::fs::write(folder.path().join("p.yaml"), "onnx: mine.onnx\n").unwrap();
    for (out, expected) in [("p.onnx", "p.yaml was not written by"), ("q.yaml", "is where the description goes")] {
        let output = run("policy", folder.path(), &["export", "p.safetensors", "--format", "onnx", "--out", out]);
        assert_eq!(output.status.code(), Some(2));
        assert!(complaint(&output).contains(expected), "{}", complaint(&output));
    }
    assert_eq!(std::fs::read_to_string(folder.path().join("p.yaml")).unwrap(), "onnx: mine.onnx\n");
}

#[test]
fn scenario_refuses_bad_input_with_exit_code_2() {
    let folder = tempfile::tempdir().unwrap();
    let policy = standing_policy();
    policy.save(&folder.path().join("standing.safetensors")).unwrap();
    let bytes = policy.to_bytes().unwrap();
    std::fs::write(folder.path().join("cut.safetensors"), &bytes[..bytes.len() / 2]).unwrap();
    std::fs::write(folder.path().join("odd.yaml"), "push_m_ss: 1\n").unwrap();
    std::fs::write(folder.path().join("hard.yaml"), "push_m_s: 30\n").unwrap();
    let mut other = standing_policy();
    other.actor.layers[1].bias.pop();
    let rows = other.actor.layers[1].weight.len() - other.actor.layers[1].inputs();
    other.actor.layers[1].weight.truncate(8 * 11.min(rows));
    std::fs::write(folder.path().join("other.safetensors"), other.to_bytes().unwrap()).unwrap();
    let cases: [(&[&str], &str); 9] = [
        (&["push", "--policy", "nobody"], "there is no policy 'nobody'"),
        (&["push", "--policy", "cut.safetensors"], "was it cut off"),
        (&["push", "--policy", "other.safetensors"], "11 outputs, expected 12"),
        (&["push", "--policy", "standing.safetensors", "--push-m-s", "-1"], "--push-m-s is -1, expected 0 to 20 m/s"),
        (&["box", "--policy", "standing.safetensors", "--mass-kg", "0"], "--mass-kg is 0, expected 0.001"),
        (&["push", "--policy", "standing.safetensors", "--params", "odd.yaml"], "no parameter 'push_m_ss'"),
        (
            &["push", "--policy", "standing.safetensors", "--params", "hard.yaml"],
            "with the parameters of hard.yaml: --push-m-s is 30, expected 0 to 20 m/s",
        ),
        (&["walk", "--policy", "standing.safetensors", "--duration-s", "NaN"], "--duration-s is NaN"),
        (
            &["terrain", "--policy", "standing.safetensors", "--duration-s", "100"],
            "--duration-s is 100, expected a way",
        ),
    ];
    for (arguments, expected) in cases {
        let output = run("scenario", folder.path(), arguments);
        let complaint = complaint(&output);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {complaint}");
        assert!(complaint.contains(expected), "{arguments:?}: {complaint}");
        assert!(output.stdout.is_empty());
    }
}
