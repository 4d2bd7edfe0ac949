//! The bridge on a network: receives states and orders, sends a command within a millisecond of a state, writes the log.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use serde::Serialize;
use supple::policy::Agent;
use supple::robot::{JOINTS, Joints, LEGS, of_leg};
use supple::task::Command;
use supple::util::terminal;

use super::core::Bridge;
use super::log::{Log, ROWS};
use super::orders::Order;
use super::outlet::Outlet;
use super::phase::{Phase, Wish};
use super::reading::Reading;
use super::safety::{Fault, SILENCE_S};
use crate::dds::switcher::Client;
use crate::dds::{Arrival, Delivery, Network, Node, Place, Publisher, WriterId};
use crate::message::{LowCmd, LowState, MotorCmd};
use crate::serve::{COMMANDS, STATES};

/// Time in which the first state has to come.
const FIRST_STATE: Duration = Duration::from_secs(5);

/// Time for which other writers are looked for before the first command; they announce themselves every second.
const LOOK: Duration = Duration::from_millis(1200);

/// A command is sent again if no state has come for this long.
const RESEND: Duration = Duration::from_micros(2500);

/// Time that lying down may take at the end.
const LIE: Duration = Duration::from_secs(5);

/// Time for which the motors damp at the end, so that the robot does not drop.
const DAMP: Duration = Duration::from_millis(500);

/// The bridge's settings: the command line of `robot run`.
#[derive(clap::Args, Debug)]
pub struct Settings {
    /// Policy file, run folder, YAML file of an external policy, or name of a shipped policy of the Go2; NAME@C sets the commanded
    /// compliance C (m/s/N)
    #[arg(value_name = "FILE|NAME[@C]", default_value = "go2/real")]
    pub policy: String,
    /// Commanded compliance (m/s/N) [default: the policy's own]
    #[arg(long, value_name = "C")]
    pub compliance: Option<f64>,
    /// Delay of the joint targets (s) [default: that of the policy's training]
    #[arg(long, value_name = "S")]
    pub latency_s: Option<f64>,
    /// Do not release the robot's own controller first, for simulators without motion_switcher
    #[arg(long)]
    pub no_release: bool,
    /// Send nothing, and show what would be sent
    #[arg(long)]
    pub dry_run: bool,
    /// Take orders as JSON lines from UDP on this port of this machine; the velocity becomes 0 half a second after the last
    #[arg(long, value_name = "PORT")]
    pub udp: Option<u16>,
    /// Log of states and commands; its older half is FILE.old, an earlier log FILE.1
    #[arg(long, value_name = "FILE", default_value = "robot-log.csv")]
    pub log: PathBuf,
    /// Print one JSON object on stdout at the end
    #[arg(long)]
    pub json: bool,
    /// The place in the network
    #[command(flatten)]
    pub network: Network,
}

/// The report of a run of the bridge.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct Report {
    /// States that were taken.
    pub states: u64,
    /// States that were ignored because of their checksum or head.
    pub ignored: u64,
    /// Steps of the robot's clock that are missing: lost states of 2 ms.
    pub lost: u64,
    /// Commands that were sent.
    pub commands: u64,
    /// Commands that were sent again because no state came.
    pub resent: u64,
    /// Time from a state's arrival to its command, median \[ms\].
    pub latency_median_ms: f64,
    /// The same, 99th percentile \[ms\].
    pub latency_p99_ms: f64,
    /// Intervals between two commands, fraction of at most 4 ms \[%\].
    pub intervals_within_4_ms_percent: f64,
    /// Faults, in order, with their time \[s\].
    pub faults: Vec<(f64, String)>,
    /// Rows that are missing in the log.
    pub log_lost: u64,
    /// The reason why the log ends early, if it does.
    pub log_error: Option<String>,
}

/// Runs a policy, with this command at first, until an order or `stop` ends it. A `stop` before the first command leaves the robot as it is.
///
/// # Errors
/// The network or the policy fails, the robot is silent at first, or another program commands it.
pub fn drive(
    settings: &Settings,
    agent: &Agent,
    command: Command,
    orders: &Receiver<Order>,
    stop: &AtomicBool,
) -> Result<Report> {
    let place = settings.network.place()?;
    let mut bridge = Bridge::new(agent, settings.latency_s)?;
    bridge.order(&Order::Command(command), 0.0);
    let node = Node::open(&place)?;
    let (sender, states) = sync_channel::<Arrival<LowState>>(64);
    // The queue is full only if this loop hangs; then the outlet damps.
    let take = move |arrival| drop(sender.try_send(arrival));
    let _states = node.listen(STATES, LowState::TYPE, Delivery::BestEffort, take)?;
    let others = Arc::new(Others::default());
    let seen = Arc::clone(&others);
    let see = move |arrival: Arrival<LowCmd>| seen.see(arrival.writer);
    let _commands = node.listen(COMMANDS, LowCmd::TYPE, Delivery::BestEffort, see)?;
    let Ok(first) = states.recv_timeout(FIRST_STATE) else {
        let Place { domain, address, .. } = place;
        bail!(
            "no rt/lowstate for {} s on {address}, DDS domain {domain}: is the robot on, the cable in, and the address of this \
             interface in the robot's network? A Go2 is in domain 0",
            FIRST_STATE.as_secs()
        );
    };
    if Reading::is_unsigned(&first.message) {
        terminal::note("note: the states have no checksum, like those of unitree_mujoco; a real Go2 sends one");
    }
    // Before the robot's own controller lets go.
    let path = &settings.log;
    let log = Log::create(path, ROWS).with_context(|| format!("cannot write the log {}", path.display()))?;
    if !settings.no_release && !settings.dry_run && !stop.load(Ordering::Relaxed) {
        let mode = Client::new(&node)?.release(stop)?;
        if !mode.is_empty() {
            terminal::note(format_args!("released the robot's own controller, '{mode}'"));
        }
    }
    others.any();
    std::thread::sleep(LOOK);
    if others.any() && !settings.dry_run {
        bail!(
            "another program writes rt/lowcmd, and commands of two would alternate: stop it, or release the robot's own \
             controller (without --no-release)"
        );
    }
    if stop.load(Ordering::Relaxed) {
        return Ok(Report::default());
    }
    let limit = Duration::from_secs_f64(SILENCE_S);
    let outlet = if settings.dry_run {
        Outlet::new(limit, |_| ())
    } else {
        let publisher: Publisher<LowCmd> = node.publish(COMMANDS, LowCmd::TYPE, Delivery::BestEffort)?;
        let _ = others.own.set(publisher.id());
        // A failed send appears as silence, which both sides detect.
        Outlet::new(limit, move |motors| drop(publisher.send(LowCmd::of_motors(motors))))
    };
    let mut drive = Drive {
        bridge,
        outlet,
        others,
        log,
        dry_run: settings.dry_run,
        begin: Instant::now(),
        last_sent: None,
        shown: Instant::now(),
        report: Report::default(),
        latencies: Histogram::new(),
        intervals: [0, 0],
        last_tick_ms: None,
    };
    // States that came meanwhile are old.
    while states.try_recv().is_ok() {}
    drive.run(&states, orders, stop);
    Ok(drive.finish())
}

/// Writers of commands other than this one.
#[derive(Default)]
struct Others {
    own: OnceLock<WriterId>,
    seen: AtomicBool,
}

impl Others {
    fn see(&self, writer: WriterId) {
        if self.own.get() != Some(&writer) {
            self.seen.store(true, Ordering::Relaxed);
        }
    }

    /// Returns true if one has been seen since the last call.
    fn any(&self) -> bool {
        self.seen.swap(false, Ordering::Relaxed)
    }
}

struct Drive<'a> {
    bridge: Bridge<'a>,
    outlet: Outlet,
    others: Arc<Others>,
    log: Log,
    dry_run: bool,
    begin: Instant,
    last_sent: Option<Instant>,
    shown: Instant,
    report: Report,
    latencies: Histogram,
    /// Number of intervals between commands: up to 4 ms, and longer.
    intervals: [u64; 2],
    last_tick_ms: Option<u32>,
}

impl Drive<'_> {
    fn now_s(&self) -> f64 {
        self.begin.elapsed().as_secs_f64()
    }

    /// Runs until an order or `stop`, then lies down and damps.
    fn run(&mut self, states: &Receiver<Arrival<LowState>>, orders: &Receiver<Order>, stop: &AtomicBool) {
        // The times of the request to end, and of the start of the damping after it.
        let (mut quits, mut still): (Option<Instant>, Option<Instant>) = (None, None);
        loop {
            let mut wants_to_quit = stop.swap(false, Ordering::Relaxed);
            while let Ok(order) = orders.try_recv() {
                if order == Order::Quit {
                    wants_to_quit = true;
                    continue;
                }
                if order == Order::Wish(Wish::Clear) {
                    self.outlet.reset();
                }
                self.bridge.order(&order, self.now_s());
            }
            if wants_to_quit {
                // A second request damps at once.
                let order = if quits.is_some() { Order::Wish(Wish::Damp) } else { Order::Quit };
                self.bridge.order(&order, self.now_s());
                quits.get_or_insert_with(Instant::now);
            }
            if !self.dry_run && self.others.any() {
                self.bridge.fail(Fault::OtherWriter);
            }
            self.step(states);
            for note in std::mem::take(&mut self.bridge.notes) {
                terminal::note(format_args!("{:8.3} s: {note}", self.now_s()));
                if let Phase::Damped(fault) = &self.bridge.phase
                    && note.starts_with("DAMPED")
                {
                    self.report.faults.push((self.now_s(), fault.to_string()));
                }
            }
            let Some(since) = quits else { continue };
            if self.bridge.phase.is_active() {
                still = None;
                if since.elapsed() > LIE {
                    self.bridge.order(&Order::Wish(Wish::Damp), self.now_s());
                }
            } else if still.get_or_insert_with(Instant::now).elapsed() > DAMP {
                return;
            }
        }
    }

    /// Waits for a state, or until it is time to send again.
    fn step(&mut self, states: &Receiver<Arrival<LowState>>) {
        let wait = RESEND.saturating_sub(self.last_sent.unwrap_or(self.begin).elapsed());
        match states.recv_timeout(wait) {
            Ok(arrival) => {
                let all = std::iter::once(arrival).chain(states.try_iter());
                if let Some(at) = all.filter_map(|arrival| self.take(&arrival)).last() {
                    self.send();
                    self.latencies.add(at.elapsed());
                    self.log();
                }
            }
            Err(RecvTimeoutError::Timeout) => {
                self.bridge.wait(self.now_s());
                self.report.resent += 1;
                self.send();
            }
            Err(RecvTimeoutError::Disconnected) => std::thread::sleep(wait),
        }
        if self.dry_run && self.shown.elapsed() > Duration::from_millis(500) {
            self.shown = Instant::now();
            self.show();
        }
    }

    /// Takes a state; returns the time of its arrival if it counts.
    fn take(&mut self, arrival: &Arrival<LowState>) -> Option<Instant> {
        let ignored = |reason: &String| {
            self.report.ignored += 1;
            if self.report.ignored == 1 {
                terminal::note(format_args!("a state is ignored: {reason}"));
            }
        };
        let reading = Reading::new(&arrival.message).inspect_err(ignored).ok()?;
        self.count_lost(reading.tick_ms);
        self.report.states += 1;
        self.bridge.take(reading, self.begin.elapsed().as_secs_f64());
        Some(arrival.at)
    }

    /// Counts the states that are missing before this one; a state that arrives out of order counts as missing.
    fn count_lost(&mut self, tick_ms: u32) {
        let gap_ms = tick_ms.wrapping_sub(*self.last_tick_ms.get_or_insert(tick_ms));
        if (1..=1000).contains(&gap_ms) {
            self.report.lost += u64::from(gap_ms / 2).saturating_sub(1);
        }
        let is_overtaken = gap_ms.wrapping_neg() <= 1000;
        self.last_tick_ms = self.last_tick_ms.filter(|_| is_overtaken).or(Some(tick_ms));
    }

    fn send(&mut self) {
        if !self.outlet.send(&self.bridge.output.motors) {
            if self.bridge.phase.is_active() {
                self.bridge.fail(Fault::PolicySilence { limit_ms: 1e3 * SILENCE_S });
            } else if self.bridge.phase == Phase::Passive {
                // It damps anyway: nothing to clear.
                self.outlet.reset();
            }
        }
        let now = Instant::now();
        if let Some(last) = self.last_sent.replace(now) {
            self.intervals[usize::from(now - last > Duration::from_millis(4))] += 1;
        }
        self.report.commands += 1;
    }

    fn log(&mut self) {
        let now_s = self.now_s();
        let Some(row) = self.bridge.row(now_s) else { return };
        let had_failed = self.log.has_failed;
        self.log.add(self.bridge.phase.name(), &row);
        if self.log.has_failed && !had_failed {
            let words = "the log cannot be written any more; the robot continues without it";
            terminal::note(format_args!("{now_s:8.3} s: {words}"));
        }
    }

    /// Prints the command that would be sent, and the joint angles.
    fn show(&self) {
        let (output, phase) = (&self.bridge.output, &self.bridge.phase);
        let angles: Joints = self.bridge.reading.as_ref().map_or([0.0; JOINTS], |reading| reading.encoders.angles);
        let legs = |joints: &Joints| -> String {
            let leg = |leg: usize| {
                let [hip, thigh, calf] = of_leg(joints, leg);
                format!(" {} {hip:+.2} {thigh:+.2} {calf:+.2}", LEGS[leg])
            };
            (0..LEGS.len()).map(leg).collect()
        };
        let MotorCmd { kp, kd, .. } = output.motors[0];
        let (now_s, name, joints) = (self.now_s(), phase.name(), legs(&angles));
        let wanted = if phase.is_active() { format!("; targets:{}", legs(&output.targets)) } else { String::new() };
        terminal::note(format_args!("{now_s:8.3} s: dry run, {name}: kp {kp}, kd {kd}; joints (rad):{joints}{wanted}"));
    }

    fn finish(mut self) -> Report {
        self.report.latency_median_ms = self.latencies.quantile_ms(0.5);
        self.report.latency_p99_ms = self.latencies.quantile_ms(0.99);
        let [short, long] = self.intervals.map(|count| count as f64);
        self.report.intervals_within_4_ms_percent = 100.0 * short / (short + long).max(1.0);
        let (lost, written) = self.log.finish();
        self.report.log_lost = lost;
        self.report.log_error = written.err().map(|error| error.to_string());
        self.report
    }
}

/// Counts durations in bins of 10 µs up to 50 ms.
struct Histogram(Vec<u64>);

const BIN_MS: f64 = 0.01;

impl Histogram {
    fn new() -> Self {
        Histogram(vec![0; 5001])
    }

    fn add(&mut self, duration: Duration) {
        let bin = (1e3 * duration.as_secs_f64() / BIN_MS) as usize;
        let last = self.0.len() - 1;
        self.0[bin.min(last)] += 1;
    }

    /// Returns the duration below which this fraction lies \[ms\].
    fn quantile_ms(&self, fraction: f64) -> f64 {
        let wanted = fraction * self.0.iter().sum::<u64>() as f64;
        let mut sum = 0.0;
        let bin = self.0.iter().position(|count| {
            sum += *count as f64;
            sum >= wanted
        });
        BIN_MS * bin.unwrap_or(0) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_what_was_added() {
        let mut histogram = Histogram::new();
        (1..=100).for_each(|tenth| histogram.add(Duration::from_micros(100 * tenth + 5)));
        assert!((histogram.quantile_ms(0.5) - 5.0).abs() < 0.011);
        assert!((histogram.quantile_ms(0.99) - 9.9).abs() < 0.011);
        histogram.add(Duration::from_secs(9));
        assert_eq!(histogram.quantile_ms(1.0), 50.0);
    }

    #[test]
    fn own_commands_are_not_those_of_another_writer() {
        let others = Others::default();
        others.own.set([1; 16]).unwrap();
        others.see([1; 16]);
        assert!(!others.any());
        others.see([2; 16]);
        assert!(others.any() && !others.any());
    }
}
