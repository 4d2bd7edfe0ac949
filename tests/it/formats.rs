/*! Files of earlier formats, kept for good: what was written once can be read, played and resumed.

`tests/fixtures/format1` is a run as revision 0fe69d7 left it, the last that wrote format 1: scales instead of a list of
observed quantities, `share` instead of `fraction`. `later.jsonl` is what that program went on to measure.
*/

use std::path::Path;

use serde_json::Value;
use supple::config::Config;
use supple::policy::{Agent, Policy};
use supple::scenario::Playback;
use supple::scenario::catalog::{Scenario, Task, Walk, defaults};
use supple::train::checkpoint::Checkpoint;
use supple::util::files;

use crate::support::{complaint, metrics, repository, run};

fn copy_of_run(folder: &Path) {
    std::fs::create_dir(folder.join("run")).unwrap();
    for entry in std::fs::read_dir(repository("tests/fixtures/format1/run")).unwrap() {
        let file = entry.unwrap().path();
        std::fs::copy(&file, folder.join("run").join(file.file_name().unwrap())).unwrap();
    }
}

#[test]
fn a_policy_of_format_1_keeps_its_identity_its_targets_and_walks() {
    let path = repository("tests/fixtures/format1/run/policy.safetensors");
    // Reading reproduces its golden joint targets.
    let policy = Policy::load(&path).unwrap();
    assert_eq!(policy.sha256(), files::sha256(&[&std::fs::read(&path).unwrap()]));
    assert_eq!(policy.provenance.config.observation, Config::load("compliant").unwrap().observation);
    assert_eq!(policy.usage.observation_elements, policy.layout().names());

    let agent = Agent::load(&path).unwrap();
    let task = Task { duration_s: 0.5, ..defaults::<Walk>("walk").unwrap().task };
    let script = Scenario::Walk(Walk { task }).script(0, &agent.config).unwrap();
    let trace = Playback::new(&script, &agent.config, agent.controller()).unwrap().trace();
    assert_eq!(trace.frames.len(), 30);

    // Written anew it is of today's format, and the same policy.
    let folder = tempfile::tempdir().unwrap();
    policy.save(&folder.path().join("new.safetensors")).unwrap();
    let again = Policy::load(&folder.path().join("new.safetensors")).unwrap();
    assert!(again.actor == policy.actor && again.layout() == policy.layout() && again.provenance == policy.provenance);
    assert_ne!(again.sha256(), policy.sha256());
}

#[test]
fn a_run_of_format_1_is_resumed_and_goes_on_as_it_would_have() {
    let folder = tempfile::tempdir().unwrap();
    copy_of_run(folder.path());
    let before = metrics_of(&folder.path().join("run/metrics.jsonl"));
    let output = run("train", folder.path(), &["--resume", "run", "--samples", "1024"]);
    assert!(output.status.success(), "{}", complaint(&output));
    assert!(complaint(&output).contains("was written by revision 0fe69d7"), "{}", complaint(&output));
    let found = metrics(&folder.path().join("run"));
    assert_eq!(found.len(), 16);
    // Lines that were there stay as they are.
    assert_eq!(found[..8], before);
    let later = metrics_of(&repository("tests/fixtures/format1/later.jsonl"));
    // The same bits on the machine that wrote them; another processor rounds otherwise, which contacts amplify with time.
    for (found, expected) in found[8..].iter().zip(&later).take(1) {
        for key in ["iteration", "samples", "episodes", "falls"] {
            assert_eq!(found[key], expected[key], "{key}");
        }
        let [found, expected] = [found, expected].map(|line| line["step_reward"].as_f64().unwrap());
        assert!((found - expected).abs() < 1e-4 * expected.abs(), "{found} instead of {expected}");
    }
    // A card reads old and new lines alike.
    let output = run("policy", folder.path(), &["card", "run"]);
    assert!(output.status.success(), "{}", complaint(&output));
}

#[test]
fn what_a_newer_program_has_written_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let mut bytes = std::fs::read(repository("tests/fixtures/format1/run/checkpoint.safetensors")).unwrap();
    for (from, to) in [(r#"\"format\":1"#, r#"\"format\":9"#), (r#"\"optimiser_steps\":"#, r#"\"optimizer_steps\":"#)] {
        let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    }
    let error = Checkpoint::from_bytes(&bytes).unwrap_err();
    assert!(error.contains("its format is 9, this program reads 1 to 2: it is of a newer one"), "{error}");

    let bytes = std::fs::read(repository("tests/fixtures/format1/run/policy.safetensors")).unwrap();
    let changed = |from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = bytes.windows(from.len()).position(|window| window == from.as_bytes()).unwrap();
        let path = folder.path().join("new.safetensors");
        std::fs::write(&path, [&bytes[..at], to.as_bytes(), &bytes[at + from.len()..]].concat()).unwrap();
        Policy::load(&path).unwrap_err().to_string()
    };
    let error = changed(r#"\"format\":1"#, r#"\"format\":9"#);
    assert!(error.contains("its format is 9, this program reads 1 to 2: it is of a newer one"), "{error}");
    let error = changed(r#"\"epochs\":"#, r#"\"eponyms\""#);
    assert!(error.contains("its metadata do not parse"), "{error}");
    let error = changed(r#"\"adam_epsilon\":"#, r#"\"adam_etatron\":"#);
    assert!(error.contains("unknown field `adam_etatron`"), "{error}");
}

fn metrics_of(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap();
    let without_time = |line: &str| {
        let mut object: Value = serde_json::from_str(line).unwrap();
        object.as_object_mut().unwrap().remove("time").unwrap();
        object
    };
    text.lines().map(without_time).collect()
}
