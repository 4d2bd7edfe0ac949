//! What goes wrong around the programs, and what a user sees then.

use std::io::Read;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use tempfile::TempDir;

use crate::support::{
    assert_same, complaint, metrics, refused, repository, run, send_signal, small_config, success, with_small_config,
};

/// Starts a long training run in a folder of its own and waits for its first metrics.
fn training() -> (TempDir, Child) {
    let folder = with_small_config();
    let mut child = Command::new(crate::support::program("train"))
        .args(["--config", "small.yaml", "--samples", "100000000", "--threads", "1", "--out", "run"])
        .current_dir(folder.path())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    while !folder.path().join("run/metrics.jsonl").exists() {
        assert!(child.try_wait().unwrap().is_none(), "train ended by itself");
        std::thread::sleep(Duration::from_millis(20));
    }
    (folder, child)
}

#[test]
fn unwritable_checkpoint_leaves_the_one_before() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = small_config();
    config.run.checkpoint_every = 1;
    std::fs::write(folder.path().join("small.yaml"), config.to_yaml()).unwrap();
    let size = |name: &str| std::fs::metadata(folder.path().join(name)).unwrap().len();
    success(run("train", folder.path(), &["--config", "small.yaml", "--samples", "256", "--out", "probe"]));
    // Room for the first checkpoint, in which environments are at rest and their numbers short, and for no later one.
    let kibibytes = size("probe/checkpoint.safetensors").max(size("probe/policy.safetensors")) / 1024;
    let train = crate::support::program("train");
    let limited = format!(
        "trap '' XFSZ; ulimit -f {}; exec {train} --config small.yaml --samples 5120 --threads 1 --out run",
        kibibytes * 95 / 100
    );
    let output = Command::new("bash").args(["-c", &limited]).current_dir(folder.path()).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", complaint(&output));
    let words = complaint(&output);
    assert!(words.contains("File too large") && words.lines().count() == 1, "{words}");
    if folder.path().join("run").exists() {
        assert!(words.contains("train --resume run"), "{words}");
        success(run("train", folder.path(), &["--resume", "run", "--samples", "5120"]));
    } else {
        success(run("train", folder.path(), &["--config", "small.yaml", "--samples", "5120", "--out", "run"]));
    }
    success(run("train", folder.path(), &["--config", "small.yaml", "--samples", "5120", "--out", "ref"]));
    assert_same(&metrics(&folder.path().join("ref")), &metrics(&folder.path().join("run")));
}

#[test]
fn a_folder_that_is_removed_under_a_run_ends_it_with_one_line() {
    let (folder, child) = training();
    // More than once: the run may be writing into it.
    while std::fs::remove_dir_all(folder.path().join("run")).is_err() {}
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(complaint(&output).contains("run was removed while training"), "{}", complaint(&output));
}

#[test]
fn ctrl_c_and_sigterm_finish_the_iteration_and_say_how_to_resume() {
    for signal in ["-INT", "-TERM"] {
        let (folder, child) = training();
        refused("train", folder.path(), &["--resume", "run"], "another process is training in run");
        send_signal(signal, child.id());
        let output = child.wait_with_output().unwrap();
        assert!(output.status.success());
        assert!(complaint(&output).contains("train --resume run"), "{}", complaint(&output));
        success(run("train", folder.path(), &["--resume", "run", "--samples", "1"]));
    }
}

#[test]
fn training_goes_on_when_nobody_reads_its_words() {
    let (_folder, mut child) = training();
    let mut words = child.stderr.take().unwrap();
    send_signal("-INT", child.id());
    // The first words, then the pipe is closed.
    words.read_exact(&mut [0]).unwrap();
    drop(words);
    assert!(child.wait().unwrap().success());
}

#[test]
fn a_start_that_was_cut_off_is_cleared_away_by_the_next() {
    let folder = with_small_config();
    let left = folder.path().join(".run.starting-abc");
    std::fs::create_dir(&left).unwrap();
    // Another owner's folder under such a name.
    let theirs = folder.path().join("theirs");
    std::fs::create_dir(&theirs).unwrap();
    std::fs::write(theirs.join("lock"), "").unwrap();
    std::os::unix::fs::symlink("theirs", folder.path().join(".run.starting-xyz")).unwrap();
    std::fs::write(left.join("checkpoint.safetensors"), "half").unwrap();
    std::fs::write(left.join("lock"), "").unwrap();
    success(run("train", folder.path(), &["--config", "small.yaml", "--samples", "256", "--out", "run"]));
    assert!(!left.exists() && theirs.join("lock").exists());
    assert!(!folder.path().join("run/checkpoint.damaged.safetensors").exists());
}

#[test]
fn a_physics_fault_is_shown_kept_and_does_not_end_the_run() {
    let folder = tempfile::tempdir().unwrap();
    // Calves so light that the motors turn them faster than MuJoCo computes.
    let mut light = std::fs::read_to_string(repository("models/go1.xml")).unwrap();
    for (from, to) in [
        ("armature=\"0.01008311831\"", "armature=\"1e-9\""),
        ("pos=\"0.004298622571 0.0009766759045 -0.1461968942\" mass=\"0.195862\"", "pos=\"0 0 0\" mass=\"1e-6\""),
        (
            "0.001484483955 0.001497635448 3.606826942e-05 -6.188266348e-07 -1.77209168e-05 -3.566262379e-06",
            "1e-9 1e-9 1e-9 0 0 0",
        ),
    ] {
        assert!(light.contains(from), "{from}");
        light = light.replace(from, to);
    }
    std::fs::write(folder.path().join("light.xml"), light).unwrap();
    let mut config = small_config();
    config.robot.model = folder.path().join("light.xml").to_str().unwrap().to_owned();
    std::fs::write(folder.path().join("wild.yaml"), config.to_yaml()).unwrap();
    let output = success(run("train", folder.path(), &["--config", "wild.yaml", "--samples", "5120", "--out", "run"]));
    let words = complaint(&output);
    assert!(words.contains("physics fault in environment") && words.contains("its last second is in run/faults/"));
    let faults: u64 = metrics(&folder.path().join("run")).iter().map(|line| line["faults"].as_u64().unwrap()).sum();
    let kept: Vec<_> =
        std::fs::read_dir(folder.path().join("run/faults")).unwrap().map(|e| e.unwrap().path()).collect();
    assert!(faults > 0 && kept.len() as u64 == faults.min(20), "{faults} faults, {} kept", kept.len());
    let text = std::fs::read_to_string(&kept[0]).unwrap();
    let mut lines = text.lines();
    assert!(lines.next().unwrap().starts_with("# "));
    assert!(lines.next().unwrap().starts_with("steps_before_fault,position_0"));
    assert!(text.lines().last().unwrap().starts_with("0,"));
}

#[test]
fn nonfinite_gradient_stops_the_run_with_a_whole_checkpoint() {
    let folder = tempfile::tempdir().unwrap();
    // Finite in double precision, infinite in the single precision of the networks.
    let large = "observation.append=[{quantity: clock_sin, frequency_hz: 1.0, scale: 1e9}]";
    let mut config = small_config().with(&[large.to_owned()]).unwrap();
    config.ppo.value_coefficient = 1e6;
    std::fs::write(folder.path().join("wild.yaml"), config.to_yaml()).unwrap();
    let output = run("train", folder.path(), &["--config", "wild.yaml", "--samples", "5120", "--out", "run"]);
    assert_eq!(output.status.code(), Some(2));
    let words = complaint(&output);
    assert!(words.contains("training failed; the diagnosis is in run/fault.json"), "{words}");
    // Resuming would do the same again.
    assert!(words.contains("start a new run with another --seed") && !words.contains("--resume run"), "{words}");
    assert_eq!(words.lines().count(), 1);
    let read = |name: &str| std::fs::read_to_string(folder.path().join("run").join(name)).unwrap();
    let told: serde_json::Value = serde_json::from_str(&read("fault.json")).unwrap();
    assert!(told["minibatch"]["gradient_norm"].is_null() && told["rollout"]["returns"]["low"].is_number());
    assert_eq!(read("fault-minibatch.csv").lines().count(), 1 + 64);
    assert!(supple::train::checkpoint::Checkpoint::load(&folder.path().join("run")).unwrap().1.is_none());
}
