//! Adam, with moments that a checkpoint can store; candle's own Adam keeps them private.

use candle_core::backprop::GradStore;
use candle_core::{Result, Tensor, Var};
use candle_nn::Optimizer;

use crate::config::Ppo;
use crate::ppo::update::ADAM_BETAS;

/// The optimiser Adam: Kingma & Ba, "Adam: A method for stochastic optimization", 2015, algorithm 1.
pub struct CandleAdam {
    variables: Vec<Var>,
    learning_rate: f64,
    epsilon: f64,
    /// First moments `m`, one tensor for each variable.
    pub first_moment: Vec<Tensor>,
    /// Second moments `v`, one tensor for each variable.
    pub second_moment: Vec<Tensor>,
    /// Number of steps `t`.
    pub steps: u64,
}

impl Optimizer for CandleAdam {
    type Config = Ppo;

    fn new(variables: Vec<Var>, settings: Ppo) -> Result<Self> {
        let zeros = || variables.iter().map(|variable| variable.zeros_like()).collect::<Result<Vec<_>>>();
        let (first_moment, second_moment) = (zeros()?, zeros()?);
        let (learning_rate, epsilon) = (settings.initial_learning_rate, settings.adam_epsilon);
        Ok(Self { variables, learning_rate, epsilon, first_moment, second_moment, steps: 0 })
    }

    fn step(&mut self, gradients: &GradStore) -> Result<()> {
        self.steps += 1;
        let t = self.steps as f64;
        let [beta1, beta2] = ADAM_BETAS;
        let moments = self.first_moment.iter_mut().zip(&mut self.second_moment);
        for (variable, (m, v)) in self.variables.iter().zip(moments) {
            let Some(g) = gradients.get(variable) else { continue };
            *m = ((&*m * beta1)? + (g * (1.0 - beta1))?)?;
            *v = ((&*v * beta2)? + (g.sqr()? * (1.0 - beta2))?)?;
            let unbiased_m = (&*m / (1.0 - beta1.powf(t)))?;
            let unbiased_v = (&*v / (1.0 - beta2.powf(t)))?;
            let way = ((unbiased_m * self.learning_rate)? / (unbiased_v.sqrt()? + self.epsilon)?)?;
            variable.set(&(variable.detach() - way)?)?;
        }
        Ok(())
    }

    fn learning_rate(&self) -> f64 {
        self.learning_rate
    }

    fn set_learning_rate(&mut self, learning_rate: f64) {
        self.learning_rate = learning_rate;
    }
}
