/*! Programs killed with SIGKILL at random moments, on a disk that fills up if there is one that may.

`SUPPLE_KILLS` says how many (3 by default, for CI), `SUPPLE_SMALL_DISK` names a mounted file system of a few MiB;
`scripts/kill_test` makes one and runs many.
*/

use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use supple::util::random::{Purpose, stream};

use crate::support::{program, run, success};

const SIGKILL: i32 = 9;

/// How many are asked for.
pub fn kills() -> usize {
    std::env::var("SUPPLE_KILLS").map_or(3, |text| text.parse().expect("SUPPLE_KILLS is a number"))
}

/// The states found after the kills.
#[derive(Debug, Default)]
struct Tally {
    killed: usize,
    of_them_within_a_write: usize,
    stopped_by_a_full_disk: usize,
    ended_before: usize,
}

/// Kills a program in a folder of its own, again and again.
pub struct Killer {
    rng: ChaCha8Rng,
    folder: tempfile::TempDir,
    small_disk: bool,
    tally: Tally,
}

impl Killer {
    pub fn new() -> Self {
        let disk = std::env::var_os("SUPPLE_SMALL_DISK").map(PathBuf::from);
        let folder = disk.as_ref().map_or_else(tempfile::tempdir, tempfile::tempdir_in).unwrap();
        let seed = std::process::id();
        println!("moments of seed {seed}");
        let rng = stream(seed.into(), Purpose::Episode, 0, 0);
        Killer { rng, folder, small_disk: disk.is_some(), tally: Tally::default() }
    }

    /// Where the program runs.
    pub fn folder(&self) -> &Path {
        self.folder.path()
    }

    /// One of several, at random.
    pub fn one_of<T: Copy>(&mut self, choices: &[T]) -> T {
        choices[self.rng.random_range(0..choices.len())]
    }

    /// Starts the program, and kills it at a moment drawn from that long; `out` is where it writes. On a small disk, every
    /// other one finds that full, or almost so, from some moment on.
    pub fn kill(&mut self, name: &str, arguments: &[&str], within: Duration, out: &Path) {
        let delay = within.mul_f64(self.rng.random());
        let filled_after = (self.small_disk && self.rng.random()).then(|| delay.mul_f64(self.rng.random()));
        println!("{name} {}: killed after {delay:?}, the disk full after {filled_after:?}", arguments.join(" "));
        for left in half_written(out) {
            std::fs::remove_file(left).unwrap();
        }
        let mut child = Command::new(program(name))
            .args(arguments)
            .current_dir(self.folder())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        std::thread::sleep(filled_after.unwrap_or(delay));
        let filler = self.folder().join("filler");
        if let Some(after) = filled_after {
            self.fill(&filler);
            std::thread::sleep(delay - after);
        }
        self.count(&mut child, out);
        let _ = std::fs::remove_file(filler);
    }

    /// Fills the disk up to what some writes still fit into.
    fn fill(&mut self, filler: &Path) {
        let mut file = std::fs::File::create(filler).unwrap();
        let _ = std::io::copy(&mut std::io::repeat(0), &mut file);
        let full = file.metadata().unwrap().len();
        file.set_len(full - self.rng.random_range(0..=full.min(1 << 18))).unwrap();
    }

    fn count(&mut self, child: &mut Child, out: &Path) {
        // Fails if it has ended by itself.
        let _ = child.kill();
        let status = child.wait().unwrap();
        if status.success() {
            self.tally.ended_before += 1;
        } else if status.code().is_some() {
            let said = std::io::read_to_string(child.stderr.take().unwrap()).unwrap();
            assert!(said.contains("No space left on device"), "{said}");
            self.tally.stopped_by_a_full_disk += 1;
        } else {
            assert_eq!(status.signal(), Some(SIGKILL), "{status}");
            self.tally.killed += 1;
            self.tally.of_them_within_a_write += usize::from(!half_written(out).is_empty());
        }
    }

    /// Says what was done.
    pub fn report(&self, what: &str) {
        println!("{what}: {:?}; all have the same bits as without kills", self.tally);
    }
}

/// Runs a program to its end, and says how long that took.
pub fn undisturbed(name: &str, folder: &Path, arguments: &[&str]) -> Duration {
    let started = Instant::now();
    success(run(name, folder, arguments));
    started.elapsed()
}

/// Temporary files in a folder or below it.
pub fn half_written(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let of = |path: PathBuf| match path.is_dir() {
        true => half_written(&path),
        false => Vec::from_iter(path.extension().is_some_and(|extension| extension == "tmp").then_some(path)),
    };
    entries.flat_map(of).collect()
}
