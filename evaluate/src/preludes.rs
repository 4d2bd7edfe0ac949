//! What trials of one policy share: all that happens before their disturbances.

use std::sync::{Arc, Mutex, PoisonError};

use supple::mujoco;
use supple::policy::Agent;
use supple::scenario::{Prelude, Script};

/// Preludes of one policy on the true state, made for scripts that are the same but for their disturbances from the second one
/// on: whatever is played once has nobody to share with.
#[derive(Debug, Default)]
pub struct Preludes {
    known: Mutex<Vec<Known>>,
}

#[derive(Debug)]
struct Known {
    calm: Script,
    /// None while one script alone has asked, or if there is nothing to share.
    prelude: Option<Arc<Prelude>>,
    asked: bool,
}

impl Preludes {
    /// For a script, if there is one.
    ///
    /// # Errors
    /// A fault of MuJoCo, such as a scene that does not compile.
    pub fn of(&self, script: &Script, agent: &Agent) -> mujoco::Result<Option<Arc<Prelude>>> {
        let Some(calm) = script.calm() else { return Ok(None) };
        // Held while one is played: others wait for it.
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(known) = known.iter_mut().find(|known| known.calm == calm) else {
            known.push(Known { calm, prelude: None, asked: false });
            return Ok(None);
        };
        if !std::mem::replace(&mut known.asked, true) {
            known.prelude = Prelude::new(script, &agent.config, agent.controller())?.map(Arc::new);
        }
        Ok(known.prelude.clone())
    }
}
