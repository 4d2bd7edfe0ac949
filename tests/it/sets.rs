//! Sets of seeds and variants: trained together, resumed together, found by one name.

use std::path::Path;

use supple::policy::{Policy, shipped};

use crate::support::{complaint, run, success, with_small_config};

fn train(folder: &Path, arguments: &[&str]) -> String {
    complaint(&success(run("train", folder, arguments)))
}

fn policy(folder: &Path, run: &str) -> Vec<u8> {
    std::fs::read(folder.join(run).join("policy.safetensors")).unwrap()
}

#[test]
fn seeds_trained_together_are_the_runs_that_each_seed_gives() {
    let place = with_small_config();
    let folder = place.path();
    let set = ["--config", "small.yaml", "--seeds", "0,3-4", "--at-once", "2"];
    // Interrupted after one iteration, then gone on with; seed 4 is complete before.
    train(folder, &["--config", "small.yaml", "--seed", "4", "--samples", "768"]);
    train(folder, &[&set[..], &["--samples", "256"]].concat());
    let told = train(folder, &[&set[..], &["--samples", "768"]].concat());
    assert!(told.contains("small-seed4: has its 768 samples already"), "{told}");
    for seed in ["0", "3"] {
        train(folder, &["--config", "small.yaml", "--seed", seed, "--samples", "768", "--out", seed]);
        assert!(policy(folder, &format!("runs/small-seed{seed}")) == policy(folder, seed), "seed {seed}");
    }
    let seeds: Vec<u64> = shipped::seeds_at(&folder.join("runs/small")).into_iter().map(|(seed, _)| seed).collect();
    assert_eq!(seeds, [0, 3, 4]);
    let shown = run("policy", folder, &["show", "runs/small"]);
    assert!(shown.status.success() && String::from_utf8_lossy(&shown.stdout).contains("seed 0"), "{shown:?}");
    // Runs of another configuration are not gone on with.
    let output = run("train", folder, &[&set[..], &["--samples", "768", "--set", "ppo.epochs=1"]].concat());
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && told.contains("3 of 3 runs failed"), "{told}");
    assert!(told.contains("was not begun with small.yaml: ppo.epochs"), "{told}");
}

#[test]
fn every_variant_is_a_set_of_its_own() {
    let place = with_small_config();
    let folder = place.path();
    train(
        folder,
        &["--config", "small.yaml", "--seeds", "0-1", "--vary", "reward.energy=-0.01,-0.02", "--samples", "256"],
    );
    for value in [-0.01, -0.02] {
        let seeds = shipped::seeds_at(&folder.join(format!("runs/small-reward.energy={value}")));
        assert_eq!(seeds.len(), 2);
        for (_, file) in seeds {
            assert_eq!(Policy::load(&file).unwrap().provenance.config.reward.energy, value);
        }
    }
    let output = run("train", folder, &["--config", "small.yaml", "--vary", "reward.warmth=1"]);
    assert!(String::from_utf8_lossy(&output.stderr).contains("unknown field `warmth`"), "{output:?}");
}
