/*! The child process in which robot files that do not ship are read.

A robot file can make MuJoCo allocate all memory, loop, crash or throw a C++ exception. So a child process tries it
first, with bounds on memory and time: it reads the file, converts it, compiles the result and steps it. Its answer, the
robot's MJCF, is compiled again by this process.

The child is this program, started again with a first argument that only [`isolate_imports`] passes and recognises. A
program that does not call it reads robots in its own process: with the same limits on sizes, but without this last line
of defence.
*/

use std::ffi::OsStr;
use std::io::{Read, Write};
use std::os::unix::process::ExitStatusExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::Duration;

use rustix::process::{Resource, Rlimit, setrlimit};

use super::{Imported, normalise, source};
use crate::mujoco::{Data, Model};
use crate::robot::error::RobotError;

/// First argument of a child process.
const CHILD: &str = "--import-robot-in-this-process";

/// Limit on the address space of a child \[bytes\].
const MEMORY_BYTES: u64 = 3 << 30;

/// Limit on the processor time of a child \[s\].
const TIME_S: u64 = 30;

/// Longest wait for a child, for busy machines and for children that hang.
const PATIENCE: Duration = Duration::from_secs(180);

/// Maximum size of a child's answer \[bytes\].
const MAX_ANSWER: u64 = 64 << 20;

/// Number of physics steps that a child takes with the robot.
const STEPS: usize = 10;

static ISOLATED: AtomicBool = AtomicBool::new(false);

/// Makes this program read robot files that do not ship in a child process, with bounds on memory and time. Call it
/// first in `main`: the child is this program, started again, and there this call does not return.
pub fn isolate_imports() {
    let mut arguments = std::env::args_os().skip(1);
    if arguments.next().as_deref() != Some(OsStr::new(CHILD)) {
        ISOLATED.store(true, Ordering::Relaxed);
        return;
    }
    let path = PathBuf::from(arguments.next().unwrap_or_default());
    let answer = bound_this_process().and_then(|()| try_out(&path)).map_err(|error| error.to_string());
    // If the answer cannot be written, the parent finds none, as after other failures.
    let mut out = std::io::stdout().lock();
    let told = serde_json::to_writer(&mut out, &answer).is_ok() && out.flush().is_ok();
    std::process::exit(if told { 0 } else { 1 });
}

/// Imports a robot file in a child process; returns `None` if the program did not call [`isolate_imports`].
pub(super) fn import(path: &Path) -> Option<Result<Imported, RobotError>> {
    ISOLATED.load(Ordering::Relaxed).then(|| {
        let cannot =
            |error: std::io::Error| RobotError::Child(format!("cannot start a process to read it in: {error}"));
        let mut command = Command::new("/proc/self/exe");
        command.arg(CHILD).arg(path).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().map_err(cannot)?;
        let answer = answer(&mut child);
        if answer.is_none() {
            // Fails if it has ended in the meantime.
            let _ = child.kill();
        }
        let status = child.wait().map_err(cannot)?;
        let late = || RobotError::Child(format!("MuJoCo has not read it within {} s", PATIENCE.as_secs()));
        let answer: Result<Imported, String> =
            serde_json::from_slice(&answer.ok_or_else(late)?).unwrap_or_else(|_| Err(end(status)));
        answer.map_err(RobotError::Child)
    })
}

/// Reads the child's whole output, if it ends in time.
fn answer(child: &mut Child) -> Option<Vec<u8>> {
    let out = child.stdout.take()?;
    let (sender, receiver) = mpsc::channel();
    std::thread::spawn(move || {
        let mut bytes = Vec::new();
        // An answer that cannot be read counts as missing, like one that comes after the deadline.
        let _ = out.take(MAX_ANSWER).read_to_end(&mut bytes);
        let _ = sender.send(bytes);
    });
    receiver.recv_timeout(PATIENCE).ok()
}

/// Explains the end of a child process without an answer.
fn end(status: ExitStatus) -> String {
    let gibibytes = MEMORY_BYTES >> 30;
    match status.signal() {
        Some(SIGXCPU | SIGKILL) => format!("MuJoCo takes more than {TIME_S} s to read it and step it"),
        Some(signal) => format!(
            "MuJoCo crashed while reading it (signal {signal}): it is malformed, or takes more than {gibibytes} GiB of memory"
        ),
        None => "the process that read it ended without an answer".into(),
    }
}

const SIGKILL: i32 = 9;
const SIGXCPU: i32 = 24;

fn bound_this_process() -> Result<(), RobotError> {
    let bounds = [
        (Resource::As, MEMORY_BYTES, MEMORY_BYTES),
        (Resource::Cpu, TIME_S, TIME_S + 1),
        // A crash leaves no file behind.
        (Resource::Core, 0, 0),
    ];
    for (resource, current, maximum) in bounds {
        let limit = Rlimit { current: Some(current), maximum: Some(maximum) };
        setrlimit(resource, limit)
            .map_err(|error| RobotError::Child(format!("cannot bound the process that reads it: {error}")))?;
    }
    Ok(())
}

/// Imports, compiles and steps a robot, as this program will.
fn try_out(path: &Path) -> Result<Imported, RobotError> {
    let imported = normalise::adapt(&source::Source::read(path)?)?;
    let mut data = Data::new(Model::from_xml(&[("robot.xml", &imported.mjcf)])?)?;
    for _ in 0..STEPS {
        // A physics fault would be that of a robot in the air, not of its file.
        let _ = data.step();
    }
    Ok(imported)
}
