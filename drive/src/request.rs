//! What pages ask for, and what they are told: one JSON object for each message.

use serde::{Deserialize, Serialize};
use supple::scenario::session::{PushUnit, Reading, SceneKind};

/// Identity of a connection.
pub type PageId = u64;

/// Largest push [m/s].
pub const MOST_PUSH_M_S: f64 = 3.0;
/// Largest push [N·s]: of the paper's robot, 12 kg, about as much.
pub const MOST_PUSH_N_S: f64 = 40.0;
/// Largest force of a hand \[N\]: twice the weight that the paper's leash pulls with.
pub const MOST_PULL_N: f64 = 100.0;

/// What a page asks for.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum Request {
    /// To be the one that drives.
    Drive,
    /// Forward [m/s], left [m/s], yaw rate [rad/s]; again and again, as a sign of life.
    Command([f64; 3]),
    /// A push: forward and left, heading frame.
    Push {
        /// Size along each.
        size: [f64; 2],
        /// Of what.
        unit: PushUnit,
    },
    /// The force of a hand, forward and left in the heading frame \[N\], or to let go.
    Pull(Option<[f64; 2]>),
    /// How far a robot is to yield [m/s/N]; zero leaves it to its policy.
    Comply {
        /// Which: 0 or 1.
        robot: usize,
        /// See above.
        compliance: f64,
    },
    /// Everything back to the start.
    Reset,
    /// Another seed, or the next one.
    Seed(Option<u64>),
    /// Another scene.
    Scene(SceneKind),
    /// Another policy for a robot, and another robot for it; a policy that is none takes the robot away.
    Robot {
        /// Which: 0 or 1.
        index: usize,
        /// Name, file or run's folder.
        policy: Option<String>,
        /// Name or file; without, the policy's own.
        robot: Option<String>,
    },
    /// To stop time, or let it go on.
    Pause(bool),
    /// Simulated time over real time.
    Speed(f64),
    /// To keep what happened.
    Keep(Kept),
}

/// What of a session is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kept {
    /// The last minute.
    Minute,
    /// Everything since the start.
    All,
}

impl Request {
    /// Reads a message.
    ///
    /// # Errors
    /// In words: what is wrong with it.
    pub fn parse(text: &str) -> Result<Self, String> {
        let request: Request = serde_json::from_str(text).map_err(|error| error.to_string())?;
        // JSON has no infinities, but numbers that become one.
        let finite = match &request {
            Request::Command(numbers) => numbers.iter().all(|number| number.is_finite()),
            Request::Push { size: numbers, .. } | Request::Pull(Some(numbers)) => {
                numbers.iter().all(|number| number.is_finite())
            }
            Request::Comply { compliance, .. } => compliance.is_finite(),
            Request::Speed(speed) => (0.05..=1.0).contains(speed),
            _ => true,
        };
        if finite { Ok(request) } else { Err("a number is out of range".to_owned()) }
    }
}

/// A vector, no longer than `most`.
pub fn limited(vector: [f64; 2], most: f64) -> [f64; 2] {
    let length = vector[0].hypot(vector[1]);
    if length > most { vector.map(|part| part * most / length) } else { vector }
}

/// What a page is told when it comes.
#[derive(Debug, Clone, Serialize)]
pub struct Hello {
    /// Policies that ship.
    pub policies: Vec<String>,
    /// Scenes to choose from.
    pub scenes: Vec<SceneKind>,
    /// Largest push [m/s] and [N·s], and largest force of a hand \[N\].
    pub most: [f64; 3],
    /// Whether rerun's viewer is beside the page, or runs on its own.
    pub viewer: bool,
}

/// What all pages are told in every step.
#[derive(Debug, Clone, Serialize)]
pub struct State {
    /// The tick at which the next step begins.
    pub tick: u64,
    /// Messages of the driver that have taken effect.
    pub heard: u64,
    /// Simulated time over real time: measured, and asked for.
    pub rate: Option<f64>,
    /// See `rate`.
    pub speed: f64,
    /// Whether the machine is too slow.
    pub behind: bool,
    /// Whether time stands still.
    pub paused: bool,
    /// Who drives.
    pub driver: Option<PageId>,
    /// Where.
    pub scene: SceneKind,
    /// Of the scene.
    pub seed: u64,
    /// Largest commands: forward [m/s], left [m/s], yaw rate [rad/s].
    pub range: [f64; 3],
    /// The robots.
    pub robots: Vec<RobotStatus>,
    /// Number of the newest notice, and the last few.
    pub notices: (u64, Vec<String>),
}

/// What there is to say of a robot.
#[derive(Debug, Clone, Serialize)]
pub struct RobotStatus {
    /// Its name in the viewer.
    pub name: String,
    /// Policy and robot as they were asked for.
    pub policy: String,
    /// See `policy`.
    pub robot: String,
    /// Time on its clock \[s\].
    pub time_s: f64,
    /// World frame \[m\].
    pub position: [f64; 3],
    /// Velocity of now: forward [m/s], left [m/s], heading frame; yaw rate [rad/s].
    pub velocity: [f64; 3],
    /// Compliance that it is told [m/s/N]; zero leaves it to the policy.
    pub compliance: f64,
    /// Least and largest compliance that it can be told, and what it has by itself [m/s/N]; none if its policy is not
    /// calibrated.
    pub reach: Option<([f64; 2], f64)>,
    /// How often it has fallen.
    pub falls: u32,
    /// Numbers.
    pub reading: Option<Reading>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_are_read_and_what_is_none_is_refused() {
        assert_eq!(Request::parse(r#"{"command":[0.5,0,-1]}"#), Ok(Request::Command([0.5, 0.0, -1.0])));
        assert_eq!(
            Request::parse(r#"{"push":{"size":[0,1.5],"unit":"m/s"}}"#),
            Ok(Request::Push { size: [0.0, 1.5], unit: PushUnit::Velocity })
        );
        assert_eq!(Request::parse(r#"{"pull":null}"#), Ok(Request::Pull(None)));
        assert_eq!(Request::parse(r#""reset""#), Ok(Request::Reset));
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
            &"[".repeat(4000),
        ] {
            assert!(Request::parse(hostile).is_err(), "{hostile}");
        }
    }

    #[test]
    fn a_vector_that_is_too_long_keeps_its_direction() {
        // 3-4-5, cut to half.
        assert_eq!(limited([3.0, -4.0], 2.5), [1.5, -2.0]);
        assert_eq!(limited([0.3, 0.4], 2.5), [0.3, 0.4]);
    }
}
