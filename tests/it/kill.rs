/*! Kills `train` with SIGKILL at random moments, resumes, and compares with a run that nobody touched.

The run writes a checkpoint in every iteration, so that a good part of the kills lands in a write. `SUPPLE_KILLS` says
how many (3 by default, for CI); `scripts/kill_test` is the way to run many.
*/

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

use rand::RngExt;
use supple::train::checkpoint::Checkpoint;
use supple::util::random::{Purpose, stream};

use crate::support::{assert_same, complaint, metrics, run, small_config};

const START: [&str; 2] = ["--config", "small.yaml"];
const GO: [&str; 4] = ["--samples", "3840", "--threads", "1"];

/// What stood in the folder after a kill.
#[derive(Debug, Default)]
struct Tally {
    kills: usize,
    before_the_folder_was_there: usize,
    within_a_write: usize,
    after_the_end: usize,
}

#[test]
fn a_run_that_is_killed_at_any_moment_and_resumed_gives_the_bits_of_one_that_is_not() {
    let kills = std::env::var("SUPPLE_KILLS").map_or(3, |text| text.parse().expect("SUPPLE_KILLS is a number"));
    let folder = tempfile::tempdir().unwrap();
    let mut config = small_config();
    config.run.checkpoint_every = 1;
    std::fs::write(folder.path().join("small.yaml"), config.to_yaml()).unwrap();
    let started = Instant::now();
    let output = run("train", folder.path(), &[&START[..], &GO, &["--out", "whole"]].concat());
    assert!(output.status.success(), "{}", complaint(&output));
    let length_s = started.elapsed().as_secs_f64();
    let whole = folder.path().join("whole");

    let mut moments = stream(std::process::id().into(), Purpose::Episode, 0, 0);
    let mut tally = Tally::default();
    for trial in 0..kills {
        let delay_s = length_s * moments.random::<f64>();
        let killed = folder.path().join(format!("killed-{trial}"));
        kill_after(Duration::from_secs_f64(delay_s), &killed, &mut tally);
        let name = killed.file_name().unwrap().to_str().unwrap();
        let arguments = if killed.exists() { vec!["--resume", name] } else { [&START[..], &["--out", name]].concat() };
        let output = run("train", folder.path(), &[&arguments[..], &GO].concat());
        assert!(output.status.success(), "trial {trial}, killed after {delay_s} s: {}", complaint(&output));
        assert_same(&metrics(&whole), &metrics(&killed));
        assert_same_weights_and_environments(&whole, &killed);
        std::fs::remove_dir_all(&killed).unwrap();
    }
    println!("{tally:?}: all resumed with the same bits");
    assert_eq!(tally.kills, kills);
}

fn kill_after(delay: Duration, run: &Path, tally: &mut Tally) {
    let parent = run.parent().unwrap();
    let mut child = Command::new(crate::support::program("train"))
        .args(START)
        .args(GO)
        .arg("--out")
        .arg(run)
        .current_dir(parent)
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    std::thread::sleep(delay);
    // Fails if it has ended by itself, which the tally shows.
    let _ = child.kill();
    let status = child.wait().unwrap();
    let is_half_written = |path: &Path| path.extension().is_some_and(|extension| extension == "tmp");
    let within_a_write =
        std::fs::read_dir(run).is_ok_and(|mut files| files.any(|file| is_half_written(&file.unwrap().path())));
    tally.kills += 1;
    tally.after_the_end += usize::from(status.success());
    tally.before_the_folder_was_there += usize::from(!run.exists());
    tally.within_a_write += usize::from(within_a_write);
}

fn assert_same_weights_and_environments(a: &Path, b: &Path) {
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
