/*! Training that is killed at any moment, in any arithmetic, on any number of threads, also while the disk is full: resumed, it
gives the bits of a run that nobody touched. The run writes a checkpoint in every iteration, so that a good part of the kills
lands in a write.
*/

use std::path::Path;

use supple::ppo::fused::tiles_available;

use crate::killing::{Killer, half_written, kills, undisturbed};
use crate::support::{assert_same_run, complaint, run, small_config, standing_policy};

#[test]
fn resume_after_kill_gives_same_bits() {
    let precisions: &[&str] = if tiles_available() { &["f32", "mixed"] } else { &["f32"] };
    let whole = tempfile::tempdir().unwrap();
    let mut config = small_config();
    config.run.checkpoint_every = 1;
    let mut killer = Killer::new();
    for folder in [whole.path(), killer.folder()] {
        std::fs::write(folder.join("small.yaml"), config.to_yaml()).unwrap();
    }
    let set = |precision: &str| format!("ppo.precision={precision}");
    let start = ["--config", "small.yaml", "--samples", "3840", "--out"];
    let lengths: Vec<_> = precisions
        .iter()
        .map(|precision| {
            let set = set(precision);
            let arguments = [&start[..], &[precision, "--threads", "1", "--set", &set]].concat();
            undisturbed("train", whole.path(), &arguments)
        })
        .collect();
    for trial in 0..kills().max(precisions.len()) {
        let index = trial % precisions.len();
        let precision = precisions[index];
        let set = set(precision);
        let anew = [&start[..], &["run", "--set", &set, "--threads"]].concat();
        let killed = killer.folder().join("run");
        let threads = killer.one_of(&["1", "2", "3"]);
        killer.kill("train", &[&anew[..], &[threads]].concat(), lengths[index], &killed);
        let on = if killed.exists() { vec!["--resume", "run", "--threads"] } else { anew };
        let threads = killer.one_of(&["1", "2", "3"]);
        let output = run("train", killer.folder(), &[&on[..], &[threads]].concat());
        assert!(output.status.success(), "trial {trial}, {precision}: {}", complaint(&output));
        assert_same_run(&whole.path().join(precision), &killed);
        another_arithmetic_is_refused(killer.folder(), precisions, precision);
        assert_eq!(half_written(&killed), Vec::<std::path::PathBuf>::new());
        std::fs::remove_dir_all(&killed).unwrap();
    }
    killer.report("runs");
}

/// A run goes on in the arithmetic in which it was begun.
fn another_arithmetic_is_refused(folder: &Path, precisions: &[&str], own: &str) {
    let Some(other) = precisions.iter().find(|other| **other != own) else { return };
    let written = folder.join("other.yaml");
    std::fs::write(&written, format!("base: ./small.yaml\nppo: {{precision: {other}}}\n")).unwrap();
    let output = run("train", folder, &["--resume", "run", "--config", "other.yaml"]);
    assert_eq!(output.status.code(), Some(2), "{}", complaint(&output));
    assert!(complaint(&output).contains("ppo.precision"), "{}", complaint(&output));
}

#[test]
fn contact_network_is_whole_or_absent_after_kill() {
    let mut killer = Killer::new();
    let whole = tempfile::tempdir().unwrap();
    for folder in [whole.path(), killer.folder()] {
        standing_policy().save(&folder.join("policy.safetensors")).unwrap();
    }
    let arguments = ["--policy", "policy.safetensors", "--episodes", "5", "--out", "contact.safetensors"];
    let length = undisturbed("train_contact", whole.path(), &arguments);
    let network = |folder: &Path| std::fs::read(folder.join("contact.safetensors")).ok();
    let expected = network(whole.path());
    for trial in 0..kills().div_ceil(10) {
        let folder = killer.folder().to_owned();
        killer.kill("train_contact", &arguments, length, &folder);
        assert!([None, expected.clone()].contains(&network(&folder)), "trial {trial}: a part of a network");
        undisturbed("train_contact", &folder, &arguments);
        assert!(network(&folder) == expected, "trial {trial}: another network");
        std::fs::remove_file(folder.join("contact.safetensors")).unwrap();
    }
    killer.report("contact networks");
}
