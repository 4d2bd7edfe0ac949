//! `robot run`: command line, keys, and orders from other programs.

use std::io::{BufRead, IsTerminal, Read};
use std::net::{Ipv4Addr, UdpSocket};
use std::sync::mpsc::{Sender, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use rustix::termios::{LocalModes, OptionalActions, SpecialCodeIndex, Termios, tcgetattr, tcsetattr};
use supple::policy::shipped;
use supple::task::Command;
use supple::util::terminal;
use supple_robot::FullSticks;
use supple_robot::bridge::{KEYS, Order, Report, Settings, drive};

use crate::stop_flag;

/// Runs until a key or Ctrl-C. When the orders on standard input end, for example because their program has died, the robot stops walking.
pub fn run(settings: &Settings) -> Result<()> {
    let agent = shipped::find(&settings.policy)?;
    let compliance = agent.resolve_compliance(None, settings.compliance).with_context(|| settings.policy.clone())?;
    let range = FullSticks::new(&agent.config.command);
    let command = Command { compliance, ..Command::default() };
    let stop = stop_flag()?;
    let (sender, orders) = channel();
    if let Some(port) = settings.udp {
        let socket =
            UdpSocket::bind((Ipv4Addr::LOCALHOST, port)).with_context(|| format!("cannot open UDP port {port}"))?;
        listen(socket, sender.clone(), range)?;
    }
    let raw = Raw::new();
    match &raw {
        Some(_) => {
            terminal::note(KEYS);
            std::thread::spawn(move || keys(std::io::stdin().lock(), &sender));
        }
        None => drop(std::thread::spawn(move || orders_of_stdin(std::io::stdin().lock(), &sender, &range))),
    }
    let report = drive(settings, &agent, command, &orders, &stop);
    drop(raw);
    let report = report?;
    let log = settings.log.display();
    if settings.json {
        terminal::print(format_args!("{}\n", serde_json::to_string(&report)?))?;
    } else {
        let Report { states, ignored, lost, commands, resent, .. } = report;
        let [median, p99] = [report.latency_median_ms, report.latency_p99_ms];
        terminal::note(format_args!(
            "{states} states, {lost} lost, {ignored} ignored; {commands} commands, {resent} sent again; state to command: median \
             {median:.2} ms, 99 % {p99:.2} ms; {:.2} % of intervals within 4 ms; log: {log}",
            report.intervals_within_4_ms_percent
        ));
    }
    report.log_error.map_or(Ok(()), |error| Err(anyhow::anyhow!("cannot write the log {log}: {error}")))
}

/// Reads lines of JSON to their end; returns true if one of them was an order. A line that is not text is no order.
fn lines(mut input: impl BufRead, sender: &Sender<Order>, range: &FullSticks) -> bool {
    let (mut has_ordered, mut bytes) = (false, Vec::new());
    while (&mut input).take(LONGEST_LINE as u64).read_until(b'\n', &mut bytes).is_ok_and(|length| length > 0) {
        let line = String::from_utf8_lossy(&bytes);
        match Order::from_line(&line, range) {
            _ if line.trim().is_empty() => (),
            // The receiver is gone when the program ends.
            Ok(order) => has_ordered |= sender.send(order).is_ok(),
            Err(error) => terminal::note(error),
        }
        bytes.clear();
    }
    has_ordered
}

/// Reads lines of JSON from a program that commands the robot, and stops the robot at their end.
fn orders_of_stdin(input: impl BufRead, sender: &Sender<Order>, range: &FullSticks) {
    if lines(input, sender, range) {
        terminal::note("standard input has ended, no more orders will come: velocity 0");
        let _ = sender.send(Order::Command(Command::default()));
    }
}

/// Reads datagrams of JSON lines, and stops the robot if [`UDP_SILENCE`] passes after an order.
fn listen(socket: UdpSocket, sender: Sender<Order>, range: FullSticks) -> Result<()> {
    socket.set_read_timeout(Some(UDP_SILENCE / 5))?;
    std::thread::spawn(move || {
        let (mut buffer, mut last_order): ([u8; LONGEST_LINE], Option<Instant>) = ([0; LONGEST_LINE], None);
        loop {
            match socket.recv(&mut buffer) {
                Ok(length) if lines(&buffer[..length], &sender, &range) => last_order = Some(Instant::now()),
                _ if last_order.is_some_and(|at| at.elapsed() > UDP_SILENCE) => {
                    last_order = None;
                    terminal::note(format_args!("no order from UDP for {} s: velocity 0", UDP_SILENCE.as_secs_f64()));
                    let _ = sender.send(Order::Command(Command::default()));
                }
                _ => (),
            }
        }
    });
    Ok(())
}

/// Reads keys. An arrow or function key is no order: it sends ESC, `[` or `O`, and bytes up to a letter or `~`. Space counts even there.
fn keys(input: impl BufRead, sender: &Sender<Order>) {
    let (mut last, mut in_sequence) = (0, false);
    for key in input.bytes().map_while(Result::ok) {
        let begins = matches!((last, key), (ESCAPE, b'[' | b'O')) || (in_sequence && key == b'[');
        if begins || (in_sequence && !matches!(key, b' ' | ESCAPE)) {
            in_sequence = begins || !(b'@'..=b'~').contains(&key);
        } else {
            in_sequence = false;
            let _ = Order::from_key(key).map(|order| sender.send(order));
        }
        last = key;
    }
}

/// First byte of keys that send several.
const ESCAPE: u8 = 0x1B;

/// Longest line of orders \[bytes\].
const LONGEST_LINE: usize = 4096;

/// Time after an order from UDP until the robot stops, if no other comes.
const UDP_SILENCE: Duration = Duration::from_millis(500);

/// Code that disables a key of the terminal (`_POSIX_VDISABLE` of Linux).
const DISABLED: u8 = 0;

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
        // Ctrl-Z and Ctrl-\\ would stop or end the program without damping. Ctrl-C is caught.
        for key in [SpecialCodeIndex::VSUSP, SpecialCodeIndex::VQUIT] {
            raw.special_codes[key] = DISABLED;
        }
        tcsetattr(&input, OptionalActions::Now, &raw).ok()?;
        Some(Raw(before))
    }
}

impl Drop for Raw {
    fn drop(&mut self) {
        let _ = tcsetattr(std::io::stdin(), OptionalActions::Now, &self.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use supple_robot::bridge::Wish;

    const RANGE: FullSticks = FullSticks([1.0, 0.5, 0.5]);

    #[test]
    fn arrows_and_function_keys_are_no_orders() {
        let (sender, orders) = channel();
        // Up, left (in both modes), F5, F1 of the console, Ctrl-up, Insert; then ESC alone, 1, w.
        keys(&b"\x1B[A\x1BOD\x1B[15~\x1B[[A\x1B[1;5A\x1B[2~\x1B1w"[..], &sender);
        assert_eq!(orders.try_iter().collect::<Vec<_>>(), [Order::Wish(Wish::Stand), Order::Change([0.1, 0.0, 0.0])]);
        keys(&b"\x1B[1 "[..], &sender);
        assert_eq!(orders.try_iter().collect::<Vec<_>>(), [Order::Wish(Wish::Damp)]);
    }

    #[test]
    fn what_is_no_text_does_not_silence_the_orders_after_it() {
        let (sender, orders) = channel();
        let text = b"\xFF\xFE\n\n{\"forward\": 0.5, \"left\": 0, \"yaw\": 0}\n{\"forward\": 9, \"left\": 0, \"yaw\": 0}\n\xEF\xBB\xBF{\"do\": \"damp\"}";
        orders_of_stdin(&text[..], &sender, &RANGE);
        let walk = Order::Command(Command::velocity(0.5, 0.0, 0.0));
        let stop = Order::Command(Command::default());
        assert_eq!(orders.try_iter().collect::<Vec<_>>(), [walk, Order::Wish(Wish::Damp), stop]);
        // Nothing was ordered, so nothing ends.
        orders_of_stdin(&b""[..], &sender, &RANGE);
        assert!(orders.try_recv().is_err());
    }

    #[test]
    fn a_program_that_falls_silent_stops_the_robot() {
        let (sender, orders) = channel();
        let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let leader = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        leader.connect(socket.local_addr().unwrap()).unwrap();
        listen(socket, sender, RANGE).unwrap();
        leader.send(b"{\"forward\": 0.5, \"left\": 0, \"yaw\": 0}").unwrap();
        let next = || orders.recv_timeout(Duration::from_secs(60)).unwrap();
        assert_eq!(next(), Order::Command(Command::velocity(0.5, 0.0, 0.0)));
        // A datagram that is no order does not keep the robot going.
        leader.send(b"forward").unwrap();
        leader.send(b"{\"forward\": 1e308, \"left\": 0, \"yaw\": 0}").unwrap();
        assert_eq!(next(), Order::Command(Command::default()));
        leader.send(b"{\"do\": \"damp\"}").unwrap();
        assert_eq!(next(), Order::Wish(Wish::Damp));
    }
}
