/*! The orders of the operator: lines of JSON on standard input or from UDP on this machine, keys, and the robot's own remote. */

use anyhow::anyhow;
use serde::Deserialize;
use supple::task::Command;
use supple::util::terminal::echo;

use super::phase::Wish;
use crate::remote::{Button, FullSticks, Remote};

/// An order.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// A request for another phase.
    Wish(Wish),
    /// A new velocity; without a compliance, the last one stays.
    Command(Command),
    /// A change of the velocity: forward [m/s], left [m/s], yaw rate [rad/s].
    Change([f64; 3]),
    /// The end of the program, after lying down.
    Quit,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Do {
    r#do: Wish,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Velocity {
    forward: f64,
    left: f64,
    yaw: f64,
    compliance: Option<f64>,
}

impl Order {
    /// Reads a line of JSON, which may begin with a byte order mark; `range` is that of the policy's velocities.
    ///
    /// # Errors
    /// The line is neither a wish nor a velocity within the range.
    pub fn from_line(line: &str, range: &FullSticks) -> Result<Self, String> {
        let line = line.trim_start_matches('\u{feff}').trim();
        Self::from_json(line, range).map_err(|reason| {
            format!(
                "'{}' is no order ({}): expected {{\"do\": \"stand\"}} (or policy, lie, damp, clear) or {{\"forward\": 0.5, \
                 \"left\": 0, \"yaw\": 0}}",
                echo(line),
                echo(&reason.to_string())
            )
        })
    }

    fn from_json(line: &str, range: &FullSticks) -> anyhow::Result<Self> {
        let value: serde_json::Value = serde_json::from_str(line)?;
        if value.get("do").is_some() {
            let Do { r#do: wish } = serde_json::from_value(value)?;
            return Ok(Order::Wish(wish));
        }
        let Velocity { forward, left, yaw, compliance } = serde_json::from_value(value)?;
        range.check([forward, left, yaw]).map_err(|error| anyhow!("{error}; the velocity stays as it was"))?;
        Ok(Order::Command(Command { compliance, ..Command::velocity(forward, left, yaw) }))
    }

    /// Returns the order of a key, if it has one.
    pub fn from_key(key: u8) -> Option<Self> {
        Some(match key.to_ascii_lowercase() {
            b' ' => Order::Wish(Wish::Damp),
            b'1' => Order::Wish(Wish::Stand),
            b'2' => Order::Wish(Wish::Policy),
            b'3' => Order::Wish(Wish::Lie),
            b'c' => Order::Wish(Wish::Clear),
            b'w' => Order::Change([0.1, 0.0, 0.0]),
            b's' => Order::Change([-0.1, 0.0, 0.0]),
            b'a' => Order::Change([0.0, 0.1, 0.0]),
            b'd' => Order::Change([0.0, -0.1, 0.0]),
            b'q' => Order::Change([0.0, 0.0, 0.1]),
            b'e' => Order::Change([0.0, 0.0, -0.1]),
            b'0' => Order::Command(Command::default()),
            b'x' => Order::Quit,
            _ => return None,
        })
    }
}

/// The keys, in words.
pub const KEYS: &str = "keys: 1 stand, 2 policy, 3 lie down, space damp at once, c clear; w s forward, a d sideways, q e turn, 0 stop; \
                        x lie down and quit";

/// Deflection below which a stick counts as released; none is exactly at zero.
const DEAD_BAND: f32 = 0.05;

/// Turns the remote's sticks and buttons into orders: START stands, A starts the policy, X lies down, SELECT or L2 with B damps.
#[derive(Debug, Clone, Default)]
pub struct RemoteOrders {
    last: Remote,
}

impl RemoteOrders {
    /// Returns the orders that the remote gives now: of buttons that have just been pressed, and of sticks that have moved.
    pub fn take(&mut self, remote: &Remote, full: &FullSticks) -> Vec<Order> {
        let calm = |stick: [f32; 2]| stick.map(|value| if value.abs() < DEAD_BAND { 0.0 } else { value });
        let remote = &Remote { left: calm(remote.left), right: calm(remote.right), ..*remote };
        let last = std::mem::replace(&mut self.last, *remote);
        let pressed = |button: Button| remote.is_pressed(button) && !last.is_pressed(button);
        let both = |it: &Remote| it.is_pressed(Button::L2) && it.is_pressed(Button::B);
        let wishes = [
            (pressed(Button::Select) || (both(remote) && !both(&last)), Wish::Damp),
            (pressed(Button::Start), Wish::Stand),
            (pressed(Button::A), Wish::Policy),
            (pressed(Button::X), Wish::Lie),
        ];
        let wishes = wishes.into_iter().filter(|(given, _)| *given).map(|(_, wish)| Order::Wish(wish));
        let has_moved = (remote.left, remote.right) != (last.left, last.right);
        wishes.chain(has_moved.then(|| Order::Command(full.command(remote)))).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FULL: FullSticks = FullSticks([1.0, 0.5, 0.5]);

    #[test]
    fn lines_of_json_are_orders_and_others_are_refused() {
        let from_line = |line: &str| Order::from_line(line, &FULL);
        assert_eq!(from_line(r#"{"do": "stand"}"#).unwrap(), Order::Wish(Wish::Stand));
        assert_eq!(from_line("\u{feff}{\"do\": \"damp\"}").unwrap(), Order::Wish(Wish::Damp));
        let command = Command { compliance: Some(0.03), ..Command::velocity(0.5, 0.0, -0.1) };
        let line = r#"{"forward": 0.5, "left": 0, "yaw": -0.1, "compliance": 0.03}"#;
        assert_eq!(from_line(line).unwrap(), Order::Command(command));
        for bad in ["", "stand", "{}", r#"{"do": "fly"}"#, r#"{"forward": 1}"#, r#"{"do": "lie", "now": true}"#, "[1]"]
        {
            assert!(from_line(bad).is_err(), "{bad}");
        }
        // A number beyond the range by rounding only is accepted.
        assert!(from_line(r#"{"forward": 1.0000000001, "left": -0.5, "yaw": 0}"#).is_ok());
        let far = "forward is 1e308 m/s, expected -1 to 1 m/s; the velocity stays";
        for (line, problem) in [
            (r#"{"forward": 1e308, "left": 0, "yaw": 0}"#, far),
            (r#"{"forward": 0, "left": -0.51, "yaw": 0}"#, "left is -0.51 m/s, expected -0.5 to 0.5 m/s"),
            (r#"{"forward": 0, "left": 0, "yaw": 0.6}"#, "yaw is 0.6 rad/s, expected -0.5 to 0.5 rad/s"),
        ] {
            let error = from_line(line).unwrap_err().to_string();
            assert!(error.contains(problem), "{error}");
        }
        for long in ["x".repeat(60_000), format!("{{\"do\": \"{}\"}}", "é".repeat(60_000))] {
            let error = from_line(&long).unwrap_err().to_string();
            assert!(error.chars().count() < 700 && error.contains('…'), "{error}");
        }
    }

    #[test]
    fn button_counts_once_until_it_is_released() {
        let mut orders = RemoteOrders::default();
        let pressed = Remote::default().with(Button::Start);
        assert_eq!(orders.take(&pressed, &FULL), [Order::Wish(Wish::Stand)]);
        assert_eq!(orders.take(&pressed, &FULL), []);
        orders.take(&Remote::default(), &FULL);
        assert_eq!(orders.take(&pressed, &FULL), [Order::Wish(Wish::Stand)]);
        let stop = Remote::default().with(Button::L2).with(Button::B);
        assert_eq!(orders.take(&stop, &FULL), [Order::Wish(Wish::Damp)]);
    }

    #[test]
    fn sticks_at_rest_leave_the_command() {
        let mut orders = RemoteOrders::default();
        assert_eq!(orders.take(&Remote { left: [0.04, -0.03], ..Remote::default() }, &FULL), []);
        let ahead = Remote { left: [0.0, 0.5], ..Remote::default() };
        assert_eq!(orders.take(&ahead, &FULL), [Order::Command(Command::velocity(0.5, 0.0, 0.0))]);
        assert_eq!(orders.take(&ahead, &FULL), []);
    }
}
