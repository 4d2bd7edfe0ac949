//! Real processes on the loopback interface: what happens when one of them is killed, or when there is one too many.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use supple_robot::dds::{Delivery, Node, Place};
use supple_robot::message::LowCmd;
use supple_robot::motor::holding;
use supple_robot::serve::COMMANDS;

const ROBOT: &str = env!("CARGO_BIN_EXE_robot");

/// Time after which a test gives up; the machine may be busy.
const PATIENCE: Duration = Duration::from_secs(60);

/// A DDS domain for this test alone, whose ports are below the ephemeral ones.
fn domain() -> String {
    static NEXT: AtomicU32 = AtomicU32::new(0);
    (2 + (8 * std::process::id() + NEXT.fetch_add(1, Ordering::Relaxed)) % 96).to_string()
}

/// A process and the lines that it prints on standard error.
struct Program {
    child: Child,
    lines: Receiver<String>,
    seen: Vec<String>,
}

impl Program {
    fn start(arguments: &[&str]) -> Self {
        let mut command = Command::new(ROBOT);
        command.args(arguments).stdin(Stdio::piped()).stdout(Stdio::null()).stderr(Stdio::piped());
        let mut child = command.spawn().unwrap();
        let (sender, lines) = channel();
        let errors = BufReader::new(child.stderr.take().unwrap()).lines().map_while(Result::ok);
        std::thread::spawn(move || errors.for_each(|line| drop(sender.send(line))));
        Program { child, lines, seen: Vec::new() }
    }

    fn serve(domain: &str) -> Self {
        Self::start(&["serve", "--domain", domain, "--released"])
    }

    fn bridge(domain: &str, log: &std::path::Path) -> Self {
        let log = log.to_str().unwrap();
        Self::start(&["run", "go2/compliant", "--domain", domain, "--no-release", "--log", log])
    }

    /// Waits for a line that contains these words.
    fn says(&mut self, words: &str) -> String {
        self.says_within(PATIENCE, words).unwrap_or_else(|| panic!("no line with '{words}' after: {:#?}", self.seen))
    }

    fn says_within(&mut self, patience: Duration, words: &str) -> Option<String> {
        let deadline = Instant::now() + patience;
        loop {
            let line = self.lines.recv_timeout(deadline.saturating_duration_since(Instant::now())).ok()?;
            if line.contains(words) {
                return Some(line);
            }
            self.seen.push(line);
        }
    }

    fn order(&mut self, line: &str) {
        writeln!(self.child.stdin.as_mut().unwrap(), "{line}").unwrap();
    }

    /// Kills the process as `kill -9` does.
    fn kill(&mut self) {
        self.child.kill().unwrap();
        self.child.wait().unwrap();
    }
}

impl Drop for Program {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// A robot and its bridge, which obeys orders and has been heard, in a domain and a folder of their own.
struct Pair {
    domain: String,
    folder: tempfile::TempDir,
    serve: Program,
    bridge: Program,
}

impl Pair {
    fn start() -> Self {
        let (domain, folder) = (domain(), tempfile::tempdir().unwrap());
        let mut serve = Program::serve(&domain);
        let bridge = Program::bridge(&domain, &folder.path().join("log.csv"));
        serve.says("commands come");
        Pair { domain, folder, serve, bridge }
    }

    fn stand(&mut self) {
        self.bridge.order(r#"{"do": "stand"}"#);
        self.bridge.says("stand up");
    }

    /// Waits until the bridge damps for this reason. On a busy machine it may damp for another one before, and has to stand up again.
    fn damps(&mut self, reason: &str, mut provoke: impl FnMut()) {
        for _ in 0..PATIENCE.as_secs() {
            provoke();
            if self.bridge.says_within(Duration::from_secs(1), reason).is_some() {
                return;
            }
            self.bridge.order(r#"{"do": "clear"}"#);
            self.bridge.order(r#"{"do": "stand"}"#);
        }
        panic!("not damped because '{reason}': {:#?}", self.bridge.seen);
    }
}

/// Runs a program to its end; returns its complaint.
fn refusal(arguments: &[&str]) -> String {
    let output = Command::new(ROBOT).args(arguments).stdin(Stdio::null()).output().unwrap();
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{words}");
    words
}

#[test]
fn robot_damps_when_its_bridge_is_killed() {
    let mut pair = Pair::start();
    pair.bridge.kill();
    pair.serve.says("no valid command for");
    pair.bridge = Program::bridge(&pair.domain, &pair.folder.path().join("log.csv"));
    pair.serve.says("commands come");
    pair.stand();
}

#[test]
fn bridge_damps_when_the_robot_is_killed_until_it_is_cleared() {
    let mut pair = Pair::start();
    pair.stand();
    pair.serve.kill();
    pair.damps("DAMPED: no state of the robot for", || ());
    pair.serve = Program::serve(&pair.domain);
    pair.serve.says("commands come");
    pair.bridge.order(r#"{"do": "stand"}"#);
    pair.bridge.says("clear it first");
    pair.bridge.order(r#"{"do": "clear"}"#);
    pair.bridge.says("passive");
}

#[test]
fn second_bridge_is_refused() {
    let pair = Pair::start();
    let log = pair.folder.path().join("second.csv");
    let arguments = ["run", "go2/compliant", "--domain", &pair.domain, "--no-release", "--log", log.to_str().unwrap()];
    let words = refusal(&arguments);
    assert!(words.contains("another program writes rt/lowcmd"), "{words}");
}

#[test]
fn dry_run_sends_nothing_and_shows_what_it_would_send() {
    let (domain, folder) = (domain(), tempfile::tempdir().unwrap());
    let log = folder.path().join("log.csv");
    let mut serve = Command::new(ROBOT);
    serve.args(["serve", "--domain", &domain, "--json", "--seconds", "6"]).stdout(Stdio::piped()).stderr(Stdio::null());
    let serve = serve.spawn().unwrap();
    let mut bridge =
        Program::start(&["run", "go2/compliant", "--domain", &domain, "--dry-run", "--log", log.to_str().unwrap()]);
    bridge.says("dry run, passive: kp 0");
    let told: serde_json::Value = serde_json::from_slice(&serve.wait_with_output().unwrap().stdout).unwrap();
    assert_eq!(told["client"]["accepted"], 0);
    assert_eq!(told["client"]["complaints"], serde_json::json!({}));
}

#[test]
fn second_writer_damps_the_bridge_and_is_told_by_the_robot() {
    let mut pair = Pair::start();
    pair.stand();
    // A standing command at 500 Hz.
    let node = Node::open(&Place::new("lo", pair.domain.parse().unwrap(), Vec::new()).unwrap()).unwrap();
    let commands = node.publish::<LowCmd>(COMMANDS, LowCmd::TYPE, Delivery::BestEffort).unwrap();
    let stance = supple::robot::Robot::load("go2").unwrap().nominal_pose;
    pair.damps("DAMPED: another program writes rt/lowcmd", || {
        for _ in 0..500 {
            commands.send(LowCmd::of_motors(&holding(&stance, &[60.0; 12], &[5.0; 12]))).unwrap();
            std::thread::sleep(Duration::from_millis(2));
        }
    });
    pair.serve.says("2 writers send rt/lowcmd");
}

#[test]
fn bridge_without_a_robot_says_so() {
    let words = refusal(&["run", "go2/compliant", "--domain", &domain()]);
    assert!(words.contains("no rt/lowstate"), "{words}");
}

#[test]
fn page_of_a_served_robot_opens() {
    let mut serve = Program::start(&["serve", "--domain", &domain(), "--released", "--page", "--port", "0"]);
    let line = serve.says("http://");
    let address = line.split("http://").nth(1).and_then(|rest| rest.split('/').next()).unwrap();
    let mut stream = TcpStream::connect(address).unwrap();
    write!(stream, "GET / HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n").unwrap();
    let mut page = String::new();
    stream.read_to_string(&mut page).unwrap();
    assert!(page.starts_with("HTTP/1.1 200") && page.contains("id=\"pad\""), "{page}");
}
