/*! The log: states and commands as CSV, written by a separate thread, of bounded size.

The log is two files, `NAME` and `NAME.old`: when the first is full, it replaces the second. `robot check` reads them.
*/

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;

use supple::robot::Joints;

/// Rows in a file: four minutes at 500 Hz, some 80 MB.
pub const ROWS: u64 = 120_000;

/// Rows that wait for the disk: two seconds of them.
const WAITING: usize = 1000;

/// A command with the reading that it answers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Row {
    pub time_s: f64,             // time since the start [s]
    pub tick_s: f64,             // clock of the robot [s]
    pub q: Joints,               // joint angles [rad]
    pub dq: Joints,              // joint rates [rad/s]
    pub tau: Joints,             // torques [N·m]
    pub quaternion: [f64; 4],    // orientation of the IMU, world from base (w, x, y, z)
    pub gyro: [f64; 3],          // angular velocity, base frame [rad/s]
    pub accelerometer: [f64; 3], // specific force, base frame [m/s²]
    pub command: [f64; 3],       // commanded velocity: forward [m/s], left [m/s], yaw rate [rad/s]
    pub compliance: f64,         // commanded compliance [m/s/N]; 0 for the policy's own
    pub target: Joints,          // joint targets that were sent [rad]
    pub gains: [f64; 2],         // gains that were sent [N·m/rad], [N·m·s/rad]
}

/// The column of the commanded compliance, which logs of other programs need not have.
pub const COMPLIANCE: &str = "command_compliance";

/// Names of the columns in order; the phase is the first.
pub fn columns() -> Vec<String> {
    let joints = |what: &str| (0..12).map(|joint| format!("{what}_{joint}")).collect();
    let parts = |what: &str, parts: &[&str]| parts.iter().map(|part| format!("{what}{part}")).collect();
    let all: [Vec<String>; 10] = [
        parts("", &["phase", "time_s", "tick_s"]),
        joints("q"),
        joints("dq"),
        joints("tau"),
        parts("quaternion", &["_w", "_x", "_y", "_z"]),
        parts("gyro", &["_x", "_y", "_z"]),
        parts("accelerometer", &["_x", "_y", "_z"]),
        parts("command", &["_forward", "_left", "_yaw", "_compliance"]),
        joints("target"),
        parts("", &["kp", "kd"]),
    ];
    all.concat()
}

impl Row {
    /// Returns the numbers in the order of [`columns`], without the phase.
    pub fn numbers(&self) -> Vec<f64> {
        let Row { time_s, tick_s, q, dq, tau, quaternion, gyro, accelerometer, command, compliance, target, gains } =
            self;
        let parts: [&[f64]; 11] =
            [&[*time_s, *tick_s], q, dq, tau, quaternion, gyro, accelerometer, command, &[*compliance], target, gains];
        parts.concat()
    }

    /// Returns the row of numbers in the order of [`columns`], without the phase; `None` if there are too few.
    pub fn from_numbers(numbers: &[f64]) -> Option<Self> {
        let mut rest = numbers;
        fn take<const N: usize>(rest: &mut &[f64]) -> Option<[f64; N]> {
            let first;
            (first, *rest) = rest.split_first_chunk()?;
            Some(*first)
        }
        let [time_s, tick_s] = take(&mut rest)?;
        let (q, dq, tau, quaternion) = (take(&mut rest)?, take(&mut rest)?, take(&mut rest)?, take(&mut rest)?);
        let (gyro, accelerometer, command) = (take(&mut rest)?, take(&mut rest)?, take(&mut rest)?);
        let (compliance, target, gains) = (take::<1>(&mut rest)?[0], take(&mut rest)?, take(&mut rest)?);
        Some(Row { time_s, tick_s, q, dq, tau, quaternion, gyro, accelerometer, command, compliance, target, gains })
    }
}

pub struct Log {
    sender: SyncSender<(&'static str, Row)>,
    thread: JoinHandle<io::Result<()>>,
    lost: u64,
    /// True once nothing can be written any more, as on a full disk.
    pub has_failed: bool,
}

/// Returns the path of the older half of a log.
pub fn older(path: &Path) -> PathBuf {
    path.with_added_extension("old")
}

impl Log {
    /// Opens a log whose two files have at most `rows` rows each. An earlier log of this name stays as `NAME.1`, `NAME.2` and so on.
    pub fn create(path: &Path, rows: u64) -> io::Result<Self> {
        let numbered = |number: u32| path.with_added_extension(number.to_string());
        let is_free = |path: &PathBuf| !path.exists() && !older(path).exists();
        let kept = (1..).map(numbered).find(is_free).expect("there is no end of numbers");
        for (from, to) in [(path.to_owned(), kept.clone()), (older(path), older(&kept))] {
            if from.is_file() {
                std::fs::rename(from, to)?;
            }
        }
        let file = open(path)?;
        let (sender, receiver) = sync_channel(WAITING);
        let path = path.to_owned();
        let thread = std::thread::spawn(move || write(&path, file, rows, &receiver));
        Ok(Log { sender, thread, lost: 0, has_failed: false })
    }

    /// Adds a row without waiting. Rows that a slow disk cannot take are lost and counted.
    pub fn add(&mut self, phase: &'static str, row: &Row) {
        let sent = self.sender.try_send((phase, *row));
        self.lost += u64::from(sent.is_err());
        self.has_failed |= matches!(sent, Err(TrySendError::Disconnected(_)));
    }

    /// Writes what is left; returns the number of lost rows, and an error if the disk is full.
    pub fn finish(self) -> (u64, io::Result<()>) {
        drop(self.sender);
        let written = self.thread.join().unwrap_or_else(|_| Err(io::Error::other("the log's thread panicked")));
        (self.lost, written)
    }
}

fn open(path: &Path) -> io::Result<BufWriter<File>> {
    let mut file = BufWriter::new(File::create(path)?);
    writeln!(file, "{}", columns().join(","))?;
    Ok(file)
}

fn write(path: &Path, mut file: BufWriter<File>, rows: u64, sent: &Receiver<(&'static str, Row)>) -> io::Result<()> {
    let mut written = 0;
    for (phase, row) in sent {
        // A pipe or a device stays.
        if written == rows && path.is_file() {
            file.flush()?;
            std::fs::rename(path, older(path))?;
            (file, written) = (open(path)?, 0);
        }
        // Clocks need more digits than an f32 has: 0.1 ms, after days too.
        write!(file, "{phase},{:.4},{:.4}", row.time_s, row.tick_s)?;
        for number in &row.numbers()[2..] {
            // Six digits are those of an f32.
            write!(file, ",{}", *number as f32)?;
        }
        writeln!(file)?;
        written += 1;
    }
    file.flush()
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A row of distinct numbers.
    pub fn row(number: f64) -> Row {
        let count = columns().len() - 1;
        let numbers: Vec<f64> = (0..count).map(|index| number + index as f64 / 1024.0).collect();
        Row::from_numbers(&numbers).unwrap()
    }

    #[test]
    fn numbers_of_a_row_are_those_of_its_columns() {
        let row = row(3.0);
        assert_eq!(Row::from_numbers(&row.numbers()), Some(row));
        assert_eq!(row.numbers().len() + 1, columns().len());
        assert_eq!(Row::from_numbers(&row.numbers()[1..]), None);
        let at = |name: &str| columns().iter().position(|known| known == name).unwrap() - 1;
        assert_eq!(row.numbers()[at("dq_3")], row.dq[3]);
        assert_eq!(row.numbers()[at("kd")], row.gains[1]);
    }

    #[test]
    fn log_is_bounded_and_keeps_the_latest() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.csv");
        let mut log = Log::create(&path, 10).unwrap();
        for number in 0..35 {
            log.add("policy", &row(f64::from(number)));
        }
        let (lost, written) = log.finish();
        assert!(lost == 0 && written.is_ok());
        let lines = |path: &Path| std::fs::read_to_string(path).unwrap().lines().count() - 1;
        assert_eq!((lines(&path), lines(&older(&path))), (5, 10));
        assert!(std::fs::read_to_string(&path).unwrap().lines().last().unwrap().starts_with("policy,34"));
        // A new log keeps both files of the last one. Clocks keep their milliseconds for days.
        let mut log = Log::create(&path, 10).unwrap();
        log.add("policy", &Row { time_s: 400_000.002, tick_s: 4_000_000.001, ..row(0.0) });
        log.finish().1.unwrap();
        assert!(lines(&path) == 1 && !older(&path).exists());
        let kept = folder.path().join("log.csv.1");
        assert_eq!((lines(&kept), lines(&older(&kept))), (5, 10));
        let text = std::fs::read_to_string(&path).unwrap();
        assert!(text.lines().last().unwrap().starts_with("policy,400000.0020,4000000.0010,"), "{text}");
    }
}
