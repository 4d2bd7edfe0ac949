//! Scenes of interactive sessions: those of the catalog, with ground in every direction.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::config::Config;
use crate::scenario::catalog::{Scenario, ScriptError};
use crate::scenario::{Goal, Script};
use crate::task::Command;

/// Time for which a fallen robot lies before it is set on its feet \[s\].
const LIES_S: f64 = 2.0;

/// Command and duration from which the size of the ground is computed.
const WAY: &str = "{forward_m_s: 0.5, left_m_s: 0.0, yaw_rad_s: 0.5, duration_s: 18.0}";

/// The scene of a session.
#[derive(ValueEnum, Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SceneKind {
    /// A plane
    Flat,
    /// A field of loose balls
    BallPit,
    /// Perlin terrain
    Terrain,
    /// Wooden blocks and soft mats
    Blocks,
    /// A free box
    Box,
    /// Hills of varied friction
    Hills,
}

impl SceneKind {
    /// Returns the scene's name in files.
    pub fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// Returns the endless script of a robot that stands in this scene.
    ///
    /// # Errors
    /// The scene's parameters are invalid, or the robot cannot be loaded.
    pub fn script(self, seed: u64, config: &Config) -> Result<Script, ScriptError> {
        let (scenario, parameters) = match self {
            SceneKind::Flat => ("walk", "{}"),
            SceneKind::BallPit => ("ball-pit", "{}"),
            SceneKind::Terrain => ("terrain", WAY),
            SceneKind::Blocks => ("rubble", "{}"),
            SceneKind::Box => ("box", "{}"),
            SceneKind::Hills => ("outdoor", WAY),
        };
        let script = Scenario::named(scenario, parameters)?.script(seed, config)?;
        let goal = script.goal.map(|goal| Goal { is_end: false, ..goal });
        Ok(Script { goal, command: Command::default(), duration_s: f64::INFINITY, after_fall_s: LIES_S, ..script })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interactive_scenes_never_end() {
        let config = Config::load("compliant").unwrap();
        for scene in SceneKind::value_variants() {
            let script = scene.script(0, &config).unwrap();
            assert_eq!(script.duration_s, f64::INFINITY, "{scene:?}");
            assert!(!script.goal.is_some_and(|goal| goal.is_end), "{scene:?}");
        }
    }
}
