//! Policy and value function as candle's variables, and conversion back to plain numbers.

use candle_core::{DType, Device, Error, Result, Tensor, Var};
use candle_nn::Linear;

use crate::network::{ActorCritic, Mlp, forward};

/// A differentiable copy of an [`ActorCritic`].
pub struct CandleNetworks {
    policy: Vec<Linear>,
    value: Vec<Linear>,
    pub(super) log_std: Var,
    /// All trained variables, in the order of [`ActorCritic::tensors`].
    pub variables: Vec<Var>,
}

impl CandleNetworks {
    /// Copies the weights as variables of type `dtype`.
    pub fn new(network: &ActorCritic, dtype: DType) -> Result<Self> {
        let variable = |tensor: Tensor| Var::from_tensor(&tensor.to_dtype(dtype)?);
        let variables: Vec<Var> = tensors(network)?.into_iter().map(variable).collect::<Result<_>>()?;
        let mut in_order = variables.iter().map(|variable| variable.as_tensor().clone());
        let mut mlp = |mlp: &Mlp| -> Vec<Linear> {
            let pairs = mlp.layers.iter().filter_map(|_| in_order.next().zip(in_order.next()));
            pairs.map(|(weight, bias)| Linear::new(weight, Some(bias))).collect()
        };
        let (policy, value) = (mlp(&network.policy), mlp(&network.value));
        let log_std = variables.last().cloned().ok_or_else(|| Error::msg("no log_std"))?;
        Ok(Self { policy, value, log_std, variables })
    }

    /// Returns the mean actions, shape (rows, actions), their `ln σ`, shape (actions), and the values, shape (rows),
    /// all in f64.
    pub fn forward(&self, observations: &Tensor, of_critic: &Tensor) -> Result<(Tensor, Tensor, Tensor)> {
        let dtype = self.log_std.dtype();
        let means = forward(&self.policy, &observations.to_dtype(dtype)?)?.to_dtype(DType::F64)?;
        let values = forward(&self.value, &of_critic.to_dtype(dtype)?)?.squeeze(1)?.to_dtype(DType::F64)?;
        Ok((means, self.log_std.to_dtype(DType::F64)?, values))
    }
}

/// Converts plain numbers to tensors, in the order of [`ActorCritic::tensors`].
pub fn tensors(numbers: &ActorCritic) -> Result<Vec<Tensor>> {
    numbers.tensors().into_iter().map(|(_, shape, values)| Tensor::from_slice(values, shape, &Device::Cpu)).collect()
}

/// Converts tensors back to plain numbers, with the shapes of `like`; the inverse of [`tensors`].
pub fn numbers<'a>(like: &ActorCritic, tensors: impl IntoIterator<Item = &'a Tensor>) -> Result<ActorCritic> {
    let named = like.tensors().into_iter().zip(tensors);
    let named = named.map(|((name, shape, _), tensor)| Ok((name, shape, tensor.flatten_all()?.to_vec1()?)));
    ActorCritic::from_tensors(named.collect::<Result<Vec<_>>>()?).map_err(Error::wrap)
}
