//! What trials of one policy share: all that happens before their disturbances.

use std::sync::{Arc, Mutex, PoisonError};

use supple::mujoco;
use supple::policy::Agent;
use supple::scenario::{Prelude, Script};

/// Preludes of one policy on the true state, made for scripts that differ only in their disturbances, from the second one on:
/// whatever is played once has nobody to share with.
#[derive(Debug, Default)]
pub struct Preludes {
    /// By the scripts without disturbances.
    known: Mutex<Vec<(Script, Known)>>,
}

#[derive(Debug)]
enum Known {
    AskedForOnce,
    /// None if there is nothing to share.
    Played(Option<Arc<Prelude>>),
}

impl Preludes {
    /// For a script, if there is one.
    ///
    /// # Errors
    /// A fault of MuJoCo, such as a scene that does not compile.
    pub fn of(&self, script: &Script, agent: &Agent) -> mujoco::Result<Option<Arc<Prelude>>> {
        let Some(calm) = script.calm() else { return Ok(None) };
        // Held while one is played: who asks for the same one waits for it.
        let mut known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let Some((_, found)) = known.iter_mut().find(|(known, _)| *known == calm) else {
            known.push((calm, Known::AskedForOnce));
            return Ok(None);
        };
        if let Known::AskedForOnce = found {
            let prelude = Prelude::new(script, &agent.config, agent.controller())?;
            *found = Known::Played(prelude.map(Arc::new));
        }
        Ok(match found {
            Known::Played(prelude) => prelude.clone(),
            Known::AskedForOnce => None,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Experiment;
    use crate::protocol::Protocol;
    use crate::trial;
    use supple::scenario::Sensing;

    #[test]
    fn the_second_who_asks_has_it_played_and_the_third_gets_the_same() {
        let agent = supple::policy::shipped::find("compliant").unwrap();
        let conditions = Protocol::quick().unwrap().decay.conditions().unwrap();
        let preludes = Preludes::default();
        let ask = |seed| {
            let script = trial::vary(&conditions[0].scenario, seed).script(seed, &agent.config).unwrap();
            preludes.of(&script, &agent).unwrap()
        };
        assert!(ask(1).is_none());
        let (second, third) = (ask(2).unwrap(), ask(3).unwrap());
        assert!(Arc::ptr_eq(&second, &third));
    }

    #[test]
    fn trials_that_share_a_prelude_have_the_numbers_of_those_that_do_not() {
        let agent = supple::policy::shipped::find("compliant").unwrap();
        let protocol = Protocol::quick().unwrap();
        let preludes = Preludes::default();
        for experiment in [&protocol.decay as &dyn Experiment, &protocol.leash] {
            let condition = &experiment.conditions().unwrap()[0];
            for seed in 1..4 {
                let play =
                    |preludes| trial::play(experiment, condition, seed, &agent, Sensing::True, preludes).unwrap();
                assert_eq!(play(None), play(Some(&preludes)));
            }
        }
    }
}
