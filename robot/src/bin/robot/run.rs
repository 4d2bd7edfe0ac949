//! `robot run`: command line, keys, and orders from other programs.

use std::io::{BufRead, IsTerminal, Read};
use std::net::{Ipv4Addr, UdpSocket};
use std::path::PathBuf;
use std::sync::mpsc::{Sender, channel};

use anyhow::Context;
use clap::Args;
use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcsetattr};
use supple::policy::shipped;
use supple::task::Command;
use supple::util::terminal;
use supple_robot::bridge::log::ROWS;
use supple_robot::bridge::orders::{KEYS, Order};
use supple_robot::bridge::safety::Limits;
use supple_robot::bridge::{Settings, drive};

use crate::{Network, stop_flag};

/// The command line.
#[derive(Args, Debug)]
pub struct Run {
    /// Policy file, run folder, YAML file of an external policy, or name of a shipped policy of the Go2; with @C behind it, it has the
    /// commanded compliance C (m/s/N)
    #[arg(value_name = "FILE|NAME[@C]")]
    policy: String,
    /// Commanded compliance (m/s/N) [default: the policy's own]
    #[arg(long, value_name = "C")]
    compliance: Option<f64>,
    /// Commanded velocity at first: forward (m/s), left (m/s), turning (rad/s)
    #[arg(long, value_name = "V,V,W", value_delimiter = ',', default_values_t = [0.0, 0.0, 0.0],
          allow_hyphen_values = true)]
    velocity: Vec<f64>,
    /// Delay of the joint targets (s) [default: that of the policy's training]
    #[arg(long, value_name = "S")]
    latency_s: Option<f64>,
    /// Do not release the robot's own controller first, for simulators without motion_switcher
    #[arg(long)]
    no_release: bool,
    /// Send nothing, and show what would be sent
    #[arg(long)]
    dry_run: bool,
    /// Take orders as JSON lines from UDP on this port of this machine
    #[arg(long, value_name = "PORT")]
    udp: Option<u16>,
    /// Log of states and commands; its older half is FILE.old
    #[arg(long, value_name = "FILE", default_value = "robot-log.csv")]
    log: PathBuf,
    /// Print one JSON object on stdout at the end
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    network: Network,
}

/// Runs until a key, Ctrl-C, or the end of the orders.
pub fn run(args: &Run) -> anyhow::Result<()> {
    let agent = shipped::find(&args.policy)?;
    let compliance = agent.resolve_compliance(None, args.compliance).with_context(|| args.policy.clone())?;
    let [forward, left, yaw] = args.velocity[..] else { anyhow::bail!("--velocity: expected three numbers") };
    anyhow::ensure!([forward, left, yaw].iter().all(|it| it.is_finite()), "--velocity: expected finite numbers");
    let settings = Settings {
        place: args.network.place()?,
        limits: Limits::default(),
        latency_s: args.latency_s,
        command: Command { compliance, ..Command::velocity(forward, left, yaw) },
        dry_run: args.dry_run,
        release: !args.no_release,
        log: (args.log.clone(), ROWS),
    };
    let stop = stop_flag()?;
    let (sender, orders) = channel();
    if let Some(port) = args.udp {
        listen(port, sender.clone())?;
    }
    let raw = Raw::new();
    match &raw {
        Some(_) => {
            terminal::note(KEYS);
            std::thread::spawn(move || keys(&sender));
        }
        None => drop(std::thread::spawn(move || lines(std::io::stdin().lock(), &sender))),
    }
    let report = drive(&settings, &agent, &orders, &stop);
    drop(raw);
    let report = report?;
    if args.json {
        terminal::print(format_args!("{}\n", serde_json::to_string(&report)?))?;
    } else {
        terminal::note(format_args!(
            "{} states, {} lost, {} ignored; {} commands, {} sent again; state to command: median {:.2} ms, 99 % {:.2} ms; \
             {:.2} % of intervals within 4 ms; log: {}",
            report.states,
            report.lost,
            report.ignored,
            report.commands,
            report.resent,
            report.latency_median_ms,
            report.latency_p99_ms,
            report.intervals_within_4_ms_percent,
            args.log.display()
        ));
    }
    Ok(())
}

/// Reads lines of JSON.
fn lines(input: impl BufRead, sender: &Sender<Order>) {
    for line in input.lines().map_while(Result::ok).filter(|line| !line.trim().is_empty()) {
        match Order::from_line(&line) {
            // The receiver is gone when the program ends.
            Ok(order) => drop(sender.send(order)),
            Err(error) => terminal::note(error),
        }
    }
}

/// Reads datagrams of JSON lines.
fn listen(port: u16, sender: Sender<Order>) -> anyhow::Result<()> {
    let socket =
        UdpSocket::bind((Ipv4Addr::LOCALHOST, port)).with_context(|| format!("cannot open UDP port {port}"))?;
    std::thread::spawn(move || {
        let mut buffer = [0; 4096];
        while let Ok(length) = socket.recv(&mut buffer) {
            lines(&buffer[..length], &sender);
        }
    });
    Ok(())
}

fn keys(sender: &Sender<Order>) {
    for key in std::io::stdin().lock().bytes().map_while(Result::ok) {
        if let Some(order) = Order::from_key(key) {
            let _ = sender.send(order);
        }
    }
}

/// A terminal that gives single keys, until it is dropped.
struct Raw(Termios);

impl Raw {
    /// `None` if standard input is no terminal.
    fn new() -> Option<Self> {
        let input = std::io::stdin();
        if !input.is_terminal() {
            return None;
        }
        let before = tcgetattr(&input).ok()?;
        let mut raw = before.clone();
        raw.local_modes.remove(LocalModes::ICANON | LocalModes::ECHO);
        tcsetattr(&input, OptionalActions::Now, &raw).ok()?;
        Some(Raw(before))
    }
}

impl Drop for Raw {
    fn drop(&mut self) {
        let _ = tcsetattr(std::io::stdin(), OptionalActions::Now, &self.0);
    }
}
