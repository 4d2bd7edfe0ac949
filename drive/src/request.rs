//! The JSON messages of a page to the server, and what they may do.

use serde::Deserialize;
use supple::scenario::session::{Act, PushUnit, SceneKind};
use supple::task::Command;
use supple::util::terminal::echo;

/// Number that identifies a page's connection.
pub type PageId = u64;

/// Largest push [m/s].
const MOST_PUSH_M_S: f64 = 3.0;
/// Largest push [N·s]; about 3 m/s for the paper's robot of 12 kg.
const MOST_PUSH_N_S: f64 = 40.0;
/// Largest pull \[N\].
pub const MOST_PULL_N: f64 = 100.0;
/// The three limits, as `hello` sends them to pages.
pub const MOST: [f64; 3] = [MOST_PUSH_M_S, MOST_PUSH_N_S, MOST_PULL_N];

/// A request of a page; all but `Drive` are obeyed only from the driving page.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// Request control.
    Drive,
    /// Choose a seed; `None` takes the next one.
    Seed(Option<u64>),
    /// Choose a scene; the robots start anew in it.
    Scene(SceneKind),
    /// Choose the policy and the model of a robot; no policy removes the robot.
    Robot {
        /// Index of the robot: 0 or 1.
        index: usize,
        /// Name, file or run folder of the policy.
        policy: Option<String>,
        /// Name or file of the robot; `None` takes the policy's own.
        robot: Option<String>,
    },
    /// Pause (true) or resume (false).
    Pause(bool),
    /// Set the ratio of simulated to real time.
    Speed(f64),
    /// Save the session.
    Keep(Kept),
    /// Do something to the robots. A command is repeated to show that the page is alive.
    #[serde(untagged)]
    Act(Act),
}

/// The part of a session to save.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kept {
    /// The last minute of the session.
    Minute,
    /// Everything since the start.
    All,
}

impl Request {
    /// Parses a message.
    ///
    /// # Errors
    /// The message is invalid; the text gives the reason.
    pub fn parse(text: &str) -> Result<Self, String> {
        let request = serde_json::from_str(text)
            .map_err(|error| format!("it is no request of a page: {}", echo(&error.to_string())))?;
        // JSON has no infinity, but 1e999 is read as one.
        match request {
            Request::Act(act) if !act.is_finite() => Err("a number is out of range".to_owned()),
            Request::Speed(x) if !(0.05..=1.0).contains(&x) => Err(format!("the speed is {x}, expected 0.05 to 1")),
            _ => Ok(request),
        }
    }
}

/// Limits what a person may do to the robots; `range` is the largest command.
pub fn bounded(act: Act, range: &Command) -> Act {
    match act {
        Act::Command(Command { forward, left, yaw, .. }) => {
            let within = |(value, most): (f64, f64)| value.clamp(-most, most);
            let [forward, left, yaw] = [(forward, range.forward), (left, range.left), (yaw, range.yaw)].map(within);
            Act::Command(Command::velocity(forward, left, yaw))
        }
        Act::Push { size, unit } => {
            let most = match unit {
                PushUnit::Velocity => MOST_PUSH_M_S,
                PushUnit::Momentum => MOST_PUSH_N_S,
            };
            Act::Push { size: limited(size, most), unit }
        }
        Act::Hand(force) => Act::Hand(force.map(|force| limited(force, MOST_PULL_N))),
        Act::Comply { .. } | Act::Reset => act,
    }
}

/// Shortens a finite vector to at most `most`, keeping its direction.
pub fn limited(vector: [f64; 2], most: f64) -> [f64; 2] {
    // Scaled, so that neither the length nor a product overflows.
    let largest = vector[0].abs().max(vector[1].abs());
    if largest > 1e100 {
        return limited(vector.map(|part| part / largest * 1e100), most);
    }
    let length = vector[0].hypot(vector[1]);
    if length > most { vector.map(|part| part * most / length) } else { vector }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_parse_and_invalid_ones_fail() {
        for (text, act) in [
            (r#"{"command":[0.5,0,-1]}"#, Act::Command(Command::velocity(0.5, 0.0, -1.0))),
            (r#"{"push":{"size":[0,1.5],"unit":"m/s"}}"#, Act::Push { size: [0.0, 1.5], unit: PushUnit::Velocity }),
            (r#"{"pull":null}"#, Act::Hand(None)),
            (r#"{"comply":{"robot":1,"compliance":null}}"#, Act::Comply { robot: 1, compliance: None }),
            (r#""reset""#, Act::Reset),
        ] {
            assert_eq!(Request::parse(text), Ok(Request::Act(act)));
        }
        assert_eq!(Request::parse(r#""drive""#), Ok(Request::Drive));
        assert_eq!(Request::parse(r#"{"seed":null}"#), Ok(Request::Seed(None)));
        for hostile in [
            "",
            "{}",
            "[]",
            "null",
            r#"{"command":[1]}"#,
            r#"{"command":[1e999,0,0]}"#,
            r#"{"speed":0}"#,
            r#"{"reset":1,"drive":2}"#,
            r#"{"scene":"moon"}"#,
            r#"{"setup":{"scene":"flat","seed":0,"robots":[]}}"#,
            r#"{"renew":{"robot":0,"sha256":"0"}}"#,
            &"[".repeat(4000),
        ] {
            assert!(Request::parse(hostile).is_err(), "{hostile}");
        }
    }

    #[test]
    fn limited_vector_keeps_direction() {
        // 3-4-5, cut to half.
        assert_eq!(limited([3.0, -4.0], 2.5), [1.5, -2.0]);
        assert_eq!(limited([0.3, 0.4], 2.5), [0.3, 0.4]);
        for huge in [[1e308, 1e308], [-f64::MAX, f64::MAX], [f64::MAX, 1.0], [1e300, f64::MIN_POSITIVE]] {
            let [forward, left] = limited(huge, 100.0);
            assert!((forward.hypot(left) - 100.0).abs() < 1e-12, "{huge:?}: {forward} {left}");
            assert!(forward.signum() == huge[0].signum() && left.signum() == huge[1].signum());
        }
    }
}
