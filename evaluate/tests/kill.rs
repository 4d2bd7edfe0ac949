//! Evaluations that are killed at any moment, also while the disk is full, and restarted give the same summary to the byte.

#[path = "../../tests/it/killing.rs"]
mod killing;
#[path = "../../tests/it/support.rs"]
mod support;

use std::path::{Path, PathBuf};

use killing::{Killer, half_written, kills, undisturbed};
use support::standing_policy;

const PROTOCOL: &str = "
walk: {commands: [[0.5, 0.0, 0.0]]}
decay: {trials: 2}
leash: {directions: 3, trials: 1}
";

#[test]
fn resume_after_kill_gives_same_report() {
    let mut killer = Killer::new();
    let whole = tempfile::tempdir().unwrap();
    for folder in [whole.path(), killer.folder()] {
        std::fs::write(folder.join("small.yaml"), PROTOCOL).unwrap();
        std::fs::create_dir(folder.join("policies")).unwrap();
        for name in ["compliant-seed0", "baseline-seed0"] {
            standing_policy().save(&folder.join(format!("policies/{name}.safetensors"))).unwrap();
        }
    }
    let arguments = ["walk", "decay", "leash", "--protocol", "small.yaml", "--out", "report", "--threads"];
    let length = undisturbed("evaluate", whole.path(), &[&arguments[..], &["1"]].concat());
    let summary = |folder: &Path| std::fs::read(folder.join("report/summary.json")).unwrap();
    for trial in 0..kills().div_ceil(4) {
        let report = killer.folder().join("report");
        let threads = killer.one_of(&["1", "2", "3"]);
        killer.kill("evaluate", &[&arguments[..], &[threads]].concat(), length, &report);
        // As if each kill had interrupted a write.
        for folder in [report.clone(), report.join("results")] {
            std::fs::create_dir_all(&folder).unwrap();
            std::fs::write(folder.join(".supple-killed.tmp"), "half").unwrap();
        }
        let threads = killer.one_of(&["1", "2", "3"]);
        undisturbed("evaluate", killer.folder(), &[&arguments[..], &[threads]].concat());
        assert!(summary(whole.path()) == summary(killer.folder()), "trial {trial}: the summaries differ");
        assert_eq!(half_written(&report), Vec::<PathBuf>::new(), "trial {trial}");
        std::fs::remove_dir_all(report).unwrap();
    }
    killer.report("evaluations");
}
