//! Scenes to walk about in: those of the catalog, with ground in every direction.

use clap::ValueEnum;
use serde::{Deserialize, Serialize};

use crate::config::{Config, ConfigError};
use crate::scenario::catalog::{
    BallPit, FreeBox, Outdoor, Rubble, Scenario, ScriptError, Task, Terrain, Walk, defaults,
};
use crate::scenario::{Goal, Script};
use crate::task::Command;

/// How long a robot lies before it is set on its feet \[s\].
const LIES_S: f64 = 2.0;

/// A command, and how long it is followed: for scenes whose ground is as large as the way.
const WAY: ([f64; 3], f64) = ([0.5, 0.0, 0.5], 18.0);

/// Where robots are driven.
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
    /// Its name in files.
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
                let terrain: Terrain = defaults("terrain")?;
                Scenario::Terrain(Terrain { task: roaming(terrain.task), ..terrain })
            }
            SceneKind::Blocks => Scenario::Rubble(defaults::<Rubble>("rubble")?),
            SceneKind::Box => Scenario::Box(defaults::<FreeBox>("box")?),
            SceneKind::Hills => {
                let hills: Outdoor = defaults("outdoor")?;
                Scenario::Outdoor(Outdoor { task: roaming(hills.task), ..hills })
            }
        })
    }

    /// The script of a robot that stands in this scene and waits: it has no end, wherever the robot goes.
    ///
    /// # Errors
    /// [`ScriptError`], as for a robot whose file does not fit.
    pub fn script(self, seed: u64, config: &Config) -> Result<Script, SceneError> {
        let script = self.scenario()?.script(seed, config)?;
        let goal = script.goal.map(|goal| Goal { is_end: false, ..goal });
        Ok(Script { goal, command: Command::default(), duration_s: f64::INFINITY, after_fall_s: LIES_S, ..script })
    }
}

/// Why there is no scene.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// Its parameters.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// What it makes of them, or its robot.
    #[error(transparent)]
    Script(#[from] ScriptError),
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_scene_has_an_end_for_those_who_walk_about_in_it() {
        let config = Config::load("compliant").unwrap();
        for scene in SceneKind::value_variants() {
            let script = scene.script(0, &config).unwrap();
            assert_eq!(script.duration_s, f64::INFINITY, "{scene:?}");
            assert!(!script.goal.is_some_and(|goal| goal.is_end), "{scene:?}");
        }
    }
}
