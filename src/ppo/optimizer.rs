/*!
Adam, one stretch of parameters at a time.
*/

use pulp::{Simd, WithSimd};

use super::Hyperparameters;
use super::kernels::Buffer;

/// Parameters with their gradient and Adam's moments, all of one length.
#[derive(Debug)]
pub struct Parameters {
    pub values: Buffer,
    pub gradient: Buffer,
    pub first_moment: Buffer,
    pub second_moment: Buffer,
}

impl Parameters {
    /// `len` zeros.
    pub fn zeros(len: usize) -> Self {
        let zeros = || Buffer::zeros(len);
        Self {
            values: zeros(),
            gradient: zeros(),
            first_moment: zeros(),
            second_moment: zeros(),
        }
    }
}

/// One step of Adam (Kingma & Ba, 2015, algorithm 1, arranged as in PyTorch).
pub struct Adam<'a> {
    pub parameters: &'a mut Parameters,
    pub step: &'a AdamStep,
}

impl WithSimd for Adam<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let AdamStep {
            gradient_scale,
            beta1,
            beta2,
            step_size,
            second_moment_scale,
            epsilon,
        } = *self.step;
        let Parameters {
            values,
            gradient,
            first_moment,
            second_moment,
        } = self.parameters;
        let moments = first_moment.iter_mut().zip(second_moment.iter_mut());
        for ((value, gradient), (m, v)) in values.iter_mut().zip(gradient.iter()).zip(moments) {
            let gradient = gradient * gradient_scale;
            *m += (1.0 - beta1) * (gradient - *m);
            *v = beta2 * *v + (1.0 - beta2) * gradient * gradient;
            *value -= step_size * *m / (v.sqrt() * second_moment_scale + epsilon);
        }
    }
}

/// The scalars of one step, common to all parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamStep {
    /// Clips the joint gradient norm.
    pub gradient_scale: f32,
    pub beta1: f32,
    pub beta2: f32,
    /// Learning rate over the bias correction of the first moment.
    pub step_size: f32,
    /// Bias correction of the second moment's root.
    pub second_moment_scale: f32,
    pub epsilon: f32,
}

impl AdamStep {
    /// The `count`-th step, counted from one, for a joint gradient of `gradient_norm`.
    pub fn new(settings: &Hyperparameters, count: u64, learning_rate: f64, gradient_norm: f64) -> Self {
        let count = count as f64;
        Self {
            gradient_scale: (settings.max_gradient_norm / (gradient_norm + 1e-6)).min(1.0) as f32,
            beta1: settings.adam_beta1 as f32,
            beta2: settings.adam_beta2 as f32,
            step_size: (learning_rate / (1.0 - settings.adam_beta1.powf(count))) as f32,
            second_moment_scale: (1.0 / (1.0 - settings.adam_beta2.powf(count)).sqrt()) as f32,
            epsilon: settings.adam_epsilon as f32,
        }
    }
}
