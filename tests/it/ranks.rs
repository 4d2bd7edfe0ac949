//! Training on several ranks over MPI, with the real program: `cargo test --features mpi --test it ranks`.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use supple::train::checkpoint::Checkpoint;

use crate::support::{assert_same_run, complaint, metrics, program, run, send_signal, small_config, success};

const START: [&str; 2] = ["--config", "small.yaml"];

/// A folder with a configuration of 8 environments, which 8 shards can share, and of networks whose gradients are halved
/// on their way.
fn folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut config = small_config();
    config.run.checkpoint_every = 1;
    config.ppo.hidden_layers = vec![96, 48];
    std::fs::write(folder.path().join("small.yaml"), config.to_yaml()).unwrap();
    folder
}

/// The command that runs `train` on this many ranks, oversubscribed if need be, also as root.
fn mpirun(ranks: usize, folder: &Path, arguments: &[&str]) -> Command {
    let mut command = Command::new("mpirun");
    command.args(["--oversubscribe", "--allow-run-as-root", "-n", &ranks.to_string(), program("train")]);
    command.args(arguments).current_dir(folder);
    command
}

fn train(ranks: usize, folder: &Path, arguments: &[&str]) -> Output {
    mpirun(ranks, folder, arguments).output().unwrap()
}

#[test]
fn any_number_of_ranks_and_threads_gives_the_same_bits() {
    let folder = folder();
    for (ranks, threads) in [(1, "1"), (2, "1"), (2, "3"), (4, "2"), (8, "1")] {
        let name = format!("{ranks}-{threads}");
        let arguments = ["--samples", "1280", "--threads", threads, "--out", &name];
        success(train(ranks, folder.path(), &[&START[..], &arguments].concat()));
        assert_same_run(&folder.path().join("1-1"), &folder.path().join(name));
    }
    // A single process with the same shards gives the same bits.
    let arguments = ["--samples", "1280", "--set", "ppo.shards=8", "--out", "alone"];
    success(run("train", folder.path(), &[&START[..], &arguments].concat()));
    assert_same_run(&folder.path().join("1-1"), &folder.path().join("alone"));
}

#[test]
fn a_run_goes_on_with_any_other_number_of_ranks() {
    let folder = folder();
    success(train(2, folder.path(), &[&START[..], &["--samples", "1024", "--out", "whole"]].concat()));
    success(train(4, folder.path(), &[&START[..], &["--samples", "256", "--out", "parts"]].concat()));
    success(train(1, folder.path(), &["--resume", "parts", "--samples", "512"]));
    success(run("train", folder.path(), &["--resume", "parts", "--samples", "768"]));
    success(train(2, folder.path(), &["--resume", "parts", "--samples", "1024"]));
    assert_same_run(&folder.path().join("whole"), &folder.path().join("parts"));
}

#[test]
fn ranks_that_do_not_fit_are_told_once_and_leave_nothing_behind() {
    let folder = folder();
    let train_with = |arguments: &[&'static str]| [&START[..], &["--out", "run"], arguments].concat();
    let mut unlike = mpirun(1, folder.path(), &train_with(&[]));
    let other = ["--seed", "1", "--set", "ppo.discount=0.5"];
    unlike.args([":", "-n", "1", program("train")]).args(train_with(&other));
    let cases = [
        (train(3, folder.path(), &train_with(&[])), "there are 3 ranks"),
        (train(2, folder.path(), &train_with(&["--set", "ppo.learner=candle"])), "ppo.shards is 8"),
        (train(16, folder.path(), &train_with(&[])), "ppo.shards is 16"),
        (unlike.output().unwrap(), "ppo.discount is 0.5, not 0.99; seed is 1, not 0"),
    ];
    for (output, expected) in cases {
        let told = complaint(&output);
        assert!(!output.status.success() && told.matches("error: ").count() == 1, "{expected}: {told}");
        assert!(told.contains(expected) && told.contains("rank "), "{told}");
    }
    assert!(!folder.path().join("run").exists());
}

/// A run that has written its first checkpoint, and the ranks' processes.
fn started(ranks: usize, folder: &Path) -> (Child, Vec<u32>) {
    let arguments = [&START[..], &["--samples", "2000000", "--rank-timeout", "3", "--out", "run"]].concat();
    let child = mpirun(ranks, folder, &arguments).stderr(Stdio::piped()).spawn().unwrap();
    let deadline = Instant::now() + Duration::from_secs(60);
    while !std::fs::read_to_string(folder.join("run/metrics.jsonl")).is_ok_and(|text| text.lines().count() > 2) {
        assert!(Instant::now() < deadline, "the run does not start");
        std::thread::sleep(Duration::from_millis(20));
    }
    let children = format!("/proc/{0}/task/{0}/children", child.id());
    let ranks = std::fs::read_to_string(children).unwrap();
    (child, ranks.split_whitespace().map(|id| id.parse().unwrap()).collect())
}

/// Returns true if a process exists and has not ended; a zombie has ended.
fn is_alive(process: u32) -> bool {
    std::fs::read_to_string(format!("/proc/{process}/stat")).is_ok_and(|text| !text.contains(") Z"))
}

#[test]
fn killed_rank_ends_all_and_the_run_can_be_resumed() {
    for (name, expected) in [("-KILL", "rank 3"), ("-STOP", "from rank 3 on ")] {
        let folder = folder();
        let (child, ranks) = started(4, folder.path());
        let from = Instant::now();
        send_signal(name, ranks[3]);
        let output = child.wait_with_output().unwrap();
        let told = complaint(&output);
        assert!(!output.status.success() && told.contains(expected), "{name}: {told}");
        assert!(from.elapsed() < Duration::from_secs(15), "{name}: ended after {:?}", from.elapsed());
        for rank in ranks {
            while is_alive(rank) {
                assert!(from.elapsed() < Duration::from_secs(15), "{name}: a rank lives on");
                std::thread::sleep(Duration::from_millis(20));
            }
        }
        let (checkpoint, passed_over) = Checkpoint::load(&folder.path().join("run")).unwrap();
        assert!(passed_over.is_none(), "{name}: {passed_over:?}");
        let samples = (checkpoint.run.samples + 256).to_string();
        success(train(2, folder.path(), &["--resume", "run", "--samples", &samples]));
    }
}

#[test]
fn a_signal_to_one_rank_stops_all_after_the_same_iteration() {
    let folder = folder();
    let (child, ranks) = started(2, folder.path());
    send_signal("-TERM", ranks[1]);
    success(child.wait_with_output().unwrap());
    let run = folder.path().join("run");
    let last = metrics(&run).pop().unwrap();
    assert_eq!(last["iteration"], Checkpoint::load(&run).unwrap().0.run.iteration);
}
