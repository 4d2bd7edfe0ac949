//! Children that run the inputs, and the parent that watches them.

use std::fs::{self, File};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::process::{Command, ExitCode, Stdio};
use std::time::{Duration, Instant};

use supple::util::random::{Purpose, stream};

use crate::mutate::mutate;
use crate::targets::{TARGETS, Target};

/// Executions of a process before the next one takes over, so that leaks inside MuJoCo do not add up.
const CHUNK: u64 = 20_000;
/// The time that a quick run spends on each target.
const QUICK: Duration = Duration::from_secs(2);
/// Longer with one input is a hang, also on a busy machine.
const PATIENCE: Duration = Duration::from_secs(60);
/// Address space of a child \[KiB\]: 1 GiB, and the program with its libraries.
const ADDRESS_SPACE_KIB: u64 = (1 << 20) + (256 << 10);
/// A target with that many failures is given up.
const MAX_FAILURES: usize = 20;

/// The outcomes of a target's runs.
#[derive(Default)]
struct Tally {
    executions: u64,
    accepted: u64,
    peak_kib: u64,
    slowest_ms: u64,
    failures: Vec<(u64, String)>,
}

/// Runs the targets that the command line names, or all.
pub fn run_all() -> ExitCode {
    let filters: Vec<String> = std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect();
    let number = |name: &str| std::env::var(name).ok().map(|text| text.parse::<u64>().expect("a number"));
    let (only, executions) = (number("SUPPLE_FUZZ_ONLY"), number("SUPPLE_FUZZ"));
    let mut failed = false;
    for target in TARGETS.iter().filter(|target| filters.is_empty() || filters.iter().any(|f| target.name.contains(f)))
    {
        if let Some(index) = only {
            println!("{:?}", String::from_utf8_lossy(&input(target, index)));
        }
        let (first, last) = only.map_or((0, executions.unwrap_or(u64::MAX)), |index| (index, index + 1));
        let started = Instant::now();
        let quick = only.is_none() && executions.is_none();
        let tally = run(target, first, last, quick.then_some(QUICK));
        println!(
            "fuzz {:10} {} executions in {:.1} s, {} accepted, at most {} MiB and {} ms for one, {} failures",
            target.name,
            tally.executions,
            started.elapsed().as_secs_f64(),
            tally.accepted,
            tally.peak_kib >> 10,
            tally.slowest_ms,
            tally.failures.len(),
        );
        for (index, how) in &tally.failures {
            println!("  input {index}: {how}");
        }
        failed |= !tally.failures.is_empty() || tally.executions == 0;
    }
    ExitCode::from(u8::from(failed))
}

/// The input of a number.
fn input(target: &Target, index: u64) -> Vec<u8> {
    let seeds = target.seeds();
    let mut rng = stream(index, Purpose::Scenario, target.name.len() as u64, 1);
    if target.framed {
        target.mutated(&seeds[index as usize % seeds.len()], !index.is_multiple_of(4), &mut rng)
    } else {
        mutate(seeds, target.words, &mut rng)
    }
}

fn run(target: &Target, first: u64, last: u64, limit: Option<Duration>) -> Tally {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut tally = Tally::default();
    let (mut next, started) = (first, Instant::now());
    while next < last && tally.failures.len() < MAX_FAILURES && limit.is_none_or(|limit| started.elapsed() < limit) {
        let end = last.min(next + CHUNK);
        let until = limit.map_or(0, |limit| limit.saturating_sub(started.elapsed()).as_millis().max(1));
        let order = format!("{} {next} {end} {until} {}", target.name, folder.path().display());
        next = watch(&order, folder.path(), next, &mut tally);
    }
    tally
}

/// Runs one child; returns the input to go on with.
fn watch(order: &str, folder: &Path, first: u64, tally: &mut Tally) -> u64 {
    let program = std::env::current_exe().expect("the program's path");
    let words = File::create(folder.join("stderr")).expect("a file");
    fs::write(folder.join("at"), [first, 0, 0, 0].map(u64::to_le_bytes).concat()).expect("a file");
    let mut child = Command::new("sh")
        .args(["-c", &format!("ulimit -v {ADDRESS_SPACE_KIB}; ulimit -c 0; exec \"$0\"")])
        .arg(program)
        .env("SUPPLE_FUZZ_CHILD", order)
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(words)
        .spawn()
        .expect("a child");
    let (mut seen, mut since) = (first, Instant::now());
    let status = loop {
        if let Some(status) = child.try_wait().expect("a child's status") {
            break Some(status);
        }
        std::thread::sleep(Duration::from_millis(50));
        let [at, ..] = progress(folder);
        if at != seen {
            (seen, since) = (at, Instant::now());
        } else if since.elapsed() > PATIENCE {
            let _ = child.kill();
            let _ = child.wait();
            break None;
        }
    };
    let [at, accepted, slowest_ms, peak_kib] = progress(folder);
    tally.executions += at - first;
    tally.accepted += accepted;
    tally.slowest_ms = tally.slowest_ms.max(slowest_ms);
    tally.peak_kib = tally.peak_kib.max(peak_kib);
    if status.is_some_and(|status| status.success()) {
        return at;
    }
    let words = fs::read(folder.join("stderr")).unwrap_or_default();
    let words = String::from_utf8_lossy(&words);
    let words: String = words.lines().filter(|line| !line.is_empty()).take(3).collect::<Vec<_>>().join(" ");
    let how = status.map_or("hangs".to_owned(), |status| status.to_string());
    tally.failures.push((at, format!("{how}: {words}")));
    tally.executions += 1;
    at + 1
}

/// The input that the child is at, inputs that were accepted, slowest \[ms\], peak memory \[KiB\].
fn progress(folder: &Path) -> [u64; 4] {
    let bytes = fs::read(folder.join("at")).unwrap_or_default();
    std::array::from_fn(|k| {
        bytes.get(8 * k..8 * k + 8).map_or(0, |b| u64::from_le_bytes(b.try_into().expect("8 bytes")))
    })
}

/// The child's side: runs the inputs and keeps a note of where it is.
pub fn child(order: &str) -> ExitCode {
    let words: Vec<&str> = order.splitn(5, ' ').collect();
    let number = |index: usize| words[index].parse::<u64>().expect("a number");
    let target = TARGETS.iter().find(|target| target.name == words[0]).expect("a target");
    let (first, last, limit_ms) = (number(1), number(2), number(3));
    let note = File::options().write(true).open(Path::new(words[4]).join("at")).expect("the note");
    let started = Instant::now();
    let (mut accepted, mut slowest) = (0_u64, 0_u64);
    let put = |at: u64, accepted: u64, slowest: u64, peak: u64| {
        note.write_all_at(&[at, accepted, slowest, peak].map(u64::to_le_bytes).concat(), 0).expect("the note");
    };
    let mut at = first;
    while at < last && (limit_ms == 0 || (started.elapsed().as_millis() as u64) < limit_ms) {
        put(at, accepted, slowest, 0);
        let input = input(target, at);
        let begun = Instant::now();
        accepted += u64::from((target.run)(&input));
        slowest = slowest.max(begun.elapsed().as_millis() as u64);
        at += 1;
    }
    put(at, accepted, slowest, peak_kib());
    ExitCode::SUCCESS
}

fn peak_kib() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or_default();
    line.split_whitespace().nth(1).and_then(|number| number.parse().ok()).unwrap_or(0)
}
