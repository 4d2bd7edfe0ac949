/*!
What trains: two learners behind one trait.
*/

use std::fmt::Debug;

use super::fused::Panels;
use super::{Batch, CandleLearner, FusedLearner, Hyperparameters, UpdateFault, UpdateStatistics};
use crate::config::{LearnerKind, Ppo};
use crate::network::ActorCritic;

/// Trains an [`ActorCritic`] by PPO.
pub trait Learner: Debug + Send {
    /// One PPO update: for each of `permutations` one epoch over the batch in that order, a gradient step for each
    /// `minibatch_size` samples (and one for what remains).
    ///
    /// # Errors
    /// When the batch or a permutation does not fit, or the loss or its gradient is not finite. Steps before the fault
    /// stay taken.
    fn update(&mut self, batch: &Batch<'_>, permutations: &[Vec<u32>]) -> Result<UpdateStatistics, UpdateFault>;

    /// A copy of everything needed to continue with the same bits.
    fn state(&self) -> LearnerState;

    /// A copy of the networks.
    fn parameters(&self) -> ActorCritic;
}

/// The learner that a configuration asks for, continuing from `state`. The number of threads changes the speed only.
///
/// # Panics
/// When the minibatch size is zero, or the moments do not have the shapes of the parameters.
pub fn learner(ppo: &Ppo, state: LearnerState, threads: usize) -> Box<dyn Learner> {
    let settings = Hyperparameters::from(ppo);
    match ppo.learner {
        LearnerKind::Fused => Box::new(FusedLearner::<Panels>::new(&state, settings, threads)),
        LearnerKind::Candle => Box::new(CandleLearner::new(state, settings)),
    }
}

/// Everything that an update depends on besides its batch; what a checkpoint has to keep.
#[derive(Debug, Clone, PartialEq)]
pub struct LearnerState {
    /// Policy and value function.
    pub parameters: ActorCritic,
    /// Adam's first moments, one for each parameter.
    pub first_moment: ActorCritic,
    /// Adam's second moments, one for each parameter.
    pub second_moment: ActorCritic,
    /// Gradient steps taken.
    pub steps: u64,
    /// Learning rate of the last step.
    pub learning_rate: f64,
}

impl LearnerState {
    /// Before the first update.
    pub fn new(parameters: ActorCritic, settings: &Hyperparameters) -> Self {
        let (first_moment, second_moment) = (parameters.zeros_like(), parameters.zeros_like());
        Self { parameters, first_moment, second_moment, steps: 0, learning_rate: settings.learning_rate }
    }
}
