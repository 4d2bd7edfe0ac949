/*! Robots from elsewhere in a process of their own.

What a file makes MuJoCo do is known when MuJoCo has done it: allocate all memory, loop, crash, throw an exception of C++. So
a child process does it first, with a bound on memory and time: it reads the file, makes a robot of it, compiles that and
steps it. What it answers, the robot's MJCF, is what this process compiles again.

The child is this program, started again with a first argument that nobody gives by hand, which [`isolate_imports`] looks for.
A program that does not call it reads robots in its own process: behind the same limits on what a file may ask for, but
without this last line of defence.
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

use super::{Imported, normalise, resolve};
use crate::mujoco::{Data, Model};

/// First argument of a child.
const CHILD: &str = "--import-robot-in-this-process";

/// Address space of a child \[bytes\].
const MEMORY_BYTES: u64 = 3 << 30;

/// Processor time of a child \[s\].
const TIME_S: u64 = 30;

/// Time until a child is given up, as on a busy machine, or when it waits for something that never comes.
const PATIENCE: Duration = Duration::from_secs(180);

/// Longest answer of a child \[bytes\].
const MAX_ANSWER: u64 = 64 << 20;

/// Steps that a child takes with the robot.
const STEPS: usize = 10;

static ISOLATED: AtomicBool = AtomicBool::new(false);

/// Has robots that do not ship read in a process of their own, with bounds on memory and time, from now on. To be called first
/// in `main`: that process is this program again, and in it this call does not return.
pub fn isolate_imports() {
    let mut arguments = std::env::args_os().skip(1);
    if arguments.next().as_deref() != Some(OsStr::new(CHILD)) {
        ISOLATED.store(true, Ordering::Relaxed);
        return;
    }
    let path = PathBuf::from(arguments.next().unwrap_or_default());
    let answer = bound_this_process().and_then(|()| try_out(&path));
    // An answer that cannot be given is a failure like others: the parent sees that there is none.
    let mut out = std::io::stdout().lock();
    let told = serde_json::to_writer(&mut out, &answer).is_ok() && out.flush().is_ok();
    std::process::exit(if told { 0 } else { 1 });
}

/// Makes a robot of a file in a child process, or nothing if this program has none.
pub(super) fn import(path: &Path) -> Option<Result<Imported, String>> {
    ISOLATED.load(Ordering::Relaxed).then(|| {
        let cannot = |error: std::io::Error| format!("cannot start a process to read it in: {error}");
        let mut command = Command::new("/proc/self/exe");
        command.arg(CHILD).arg(path).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().map_err(cannot)?;
        let answer = answer(&mut child);
        if answer.is_none() {
            // Fails if it has ended in the meantime.
            let _ = child.kill();
        }
        let status = child.wait().map_err(cannot)?;
        let answer = answer.ok_or_else(|| format!("MuJoCo has not read it within {} s", PATIENCE.as_secs()))?;
        serde_json::from_slice(&answer).unwrap_or_else(|_| Err(end(status)))
    })
}

/// All that a child writes, if it comes to an end in time.
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
            "MuJoCo broke down on it (signal {signal}): it is malformed, or takes more than {gibibytes} GiB of memory"
        ),
        None => "the process that read it ended without an answer".into(),
    }
}

const SIGKILL: i32 = 9;
const SIGXCPU: i32 = 24;

fn bound_this_process() -> Result<(), String> {
    let bounds = [
        (Resource::As, MEMORY_BYTES, MEMORY_BYTES),
        (Resource::Cpu, TIME_S, TIME_S + 1),
        // A crash leaves no file behind.
        (Resource::Core, 0, 0),
    ];
    for (resource, current, maximum) in bounds {
        let limit = Rlimit { current: Some(current), maximum: Some(maximum) };
        setrlimit(resource, limit).map_err(|error| format!("cannot bound the process that reads it: {error}"))?;
    }
    Ok(())
}

/// Does with a robot what this program will do.
fn try_out(path: &Path) -> Result<Imported, String> {
    let imported = normalise::adapt(&resolve::Source::read(path)?)?;
    let words = |error: crate::mujoco::Error| error.to_string();
    let mut data = Data::new(Model::from_xml(&[("robot.xml", &imported.mjcf)]).map_err(words)?).map_err(words)?;
    for _ in 0..STEPS {
        // Faults are those of a robot in the air, not of its file.
        let _ = data.step();
    }
    Ok(imported)
}
