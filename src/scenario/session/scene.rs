//! Scenes of interactive sessions: those of the catalog, with ground in every direction.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::config::{Config, ConfigError};
use crate::scenario::catalog::{
    BallPit, FreeBox, Outdoor, Rubble, Scenario, ScriptError, Task, UnevenGround, Walk, defaults,
};
use crate::scenario::{Goal, Script};
use crate::task::Command;

/// Time for which a fallen robot lies before it is set on its feet \[s\].
const LIES_S: f64 = 2.0;

/// Command and duration from which the size of the ground is computed.
const WAY: ([f64; 3], f64) = ([0.5, 0.0, 0.5], 18.0);

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
    pub fn name(self) -> &'static str {
        match self {
            SceneKind::Flat => "flat",
            SceneKind::BallPit => "ball-pit",
            SceneKind::Terrain => "terrain",
            SceneKind::Blocks => "blocks",
            SceneKind::Box => "box",
            SceneKind::Hills => "hills",
        }
    }

    fn scenario(self) -> Result<Scenario, ConfigError> {
        let roaming = |task: Task| {
            let ([forward_m_s, left_m_s, yaw_rad_s], duration_s) = WAY;
            Task { forward_m_s, left_m_s, yaw_rad_s, duration_s, ..task }
        };
        Ok(match self {
            SceneKind::Flat => Scenario::Walk(defaults::<Walk>("walk")?),
            SceneKind::BallPit => Scenario::BallPit(defaults::<BallPit>("ball-pit")?),
            SceneKind::Terrain => {
                let terrain: UnevenGround = defaults("terrain")?;
                Scenario::Terrain(UnevenGround { task: roaming(terrain.task), ..terrain })
            }
            SceneKind::Blocks => Scenario::Rubble(defaults::<Rubble>("rubble")?),
            SceneKind::Box => Scenario::Box(defaults::<FreeBox>("box")?),
            SceneKind::Hills => {
                let hills: Outdoor = defaults("outdoor")?;
                Scenario::Outdoor(Outdoor { task: roaming(hills.task), ..hills })
            }
        })
    }

    /// Returns the endless script of a robot that stands in this scene.
    ///
    /// # Errors
    /// The scene's parameters are invalid, or the robot cannot be loaded.
    pub fn script(self, seed: u64, config: &Config) -> Result<Script, SceneError> {
        let script = self.scenario()?.script(seed, config)?;
        let goal = script.goal.map(|goal| Goal { is_end: false, ..goal });
        Ok(Script { goal, command: Command::default(), duration_s: f64::INFINITY, after_fall_s: LIES_S, ..script })
    }
}

/// Error while building a scene.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// The scene's parameters are invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The script or the robot is invalid.
    #[error(transparent)]
    Script(#[from] ScriptError),
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
