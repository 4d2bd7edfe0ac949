//! The optimiser Adam, applied to one block of parameters at a time.

use pulp::{Simd, WithSimd};

use crate::config::Ppo;
use crate::network::kernels::AlignedBuffer;
use crate::ppo::update::{ADAM_BETAS, OptimizerStep};

/// Parameters with their gradient and Adam's moments, all of one length.
#[derive(Debug)]
pub struct AdamParameters {
    pub values: AlignedBuffer,
    pub gradient: AlignedBuffer,
    pub first_moment: AlignedBuffer,
    pub second_moment: AlignedBuffer,
}

impl AdamParameters {
    /// Combines values, first and second moments; the gradient starts at zero.
    pub fn new([values, first_moment, second_moment]: [AlignedBuffer; 3]) -> Self {
        let gradient = AlignedBuffer::zeros(values.len());
        Self { values, gradient, first_moment, second_moment }
    }
}

/// A step of Adam for one block (Kingma & Ba, 2015, algorithm 1, arranged as in PyTorch).
pub struct Adam<'a> {
    pub parameters: &'a mut AdamParameters,
    pub step: &'a AdamStep,
}

impl WithSimd for Adam<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let step = *self.step;
        let AdamParameters { values, gradient, first_moment, second_moment } = self.parameters;
        let moments = first_moment.iter_mut().zip(second_moment.iter_mut());
        for ((value, gradient), (m, v)) in values.iter_mut().zip(gradient.iter()).zip(moments) {
            let gradient = gradient * step.gradient_scale;
            *m += step.gain1 * (gradient - *m);
            *v = step.beta2 * *v + step.gain2 * gradient * gradient;
            *value -= step.step_size * *m / (v.sqrt() * step.second_moment_scale + step.epsilon);
        }
    }
}

/// The scalars of a step, common to all parameters.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AdamStep {
    /// Factor that clips the joint gradient norm.
    pub gradient_scale: f32,
    /// The gain `1 − β₁` of the first moment.
    pub gain1: f32,
    pub beta2: f32,
    /// The gain `1 − β₂` of the second moment, which differs from 1 − `beta2` by rounding.
    pub gain2: f32,
    /// Learning rate divided by the bias correction of the first moment.
    pub step_size: f32,
    /// Bias correction of the second moment's square root.
    pub second_moment_scale: f32,
    pub epsilon: f32,
}

impl AdamStep {
    /// Rounds the scalars of a step to single precision.
    pub fn new(settings: &Ppo, step: &OptimizerStep) -> Self {
        let count = step.count as f64;
        let [beta1, beta2] = ADAM_BETAS;
        let (gradient_scale, gain1, gain2) = (step.gradient_scale as f32, (1.0 - beta1) as f32, (1.0 - beta2) as f32);
        let step_size = (step.learning_rate / (1.0 - beta1.powf(count))) as f32;
        let second_moment_scale = (1.0 / (1.0 - beta2.powf(count)).sqrt()) as f32;
        let epsilon = settings.adam_epsilon as f32;
        Self { gradient_scale, gain1, beta2: beta2 as f32, gain2, step_size, second_moment_scale, epsilon }
    }
}

#[cfg(test)]
mod tests {
    use pulp::Arch;

    use super::*;
    use crate::ppo::loss::tests::settings;

    /* The expected numbers:
    import numpy as np
    b1, b2, eps, lr, clip = .9, .999, 1e-5, 1e-3, .5
    p, m, v = np.array([1., -2.]), np.zeros(2), np.zeros(2)
    for t, g in ((1, np.array([.3, -.4])), (2, np.array([3., 4.]))):
        g = g*min(1, clip/(np.linalg.norm(g) + 1e-6))
        m, v = b1*m + (1 - b1)*g, b2*v + (1 - b2)*g*g
        p = p - lr*(m/(1 - b1**t))/(np.sqrt(v/(1 - b2**t)) + eps)
    print(p, m, v) */
    #[test]
    fn two_steps_equal_those_of_numpy() {
        let buffer = |values: &[f32]| AlignedBuffer::from(values);
        let mut parameters = AdamParameters::new([buffer(&[1.0, -2.0]), buffer(&[0.0; 2]), buffer(&[0.0; 2])]);
        let settings = &settings();
        for (count, gradient, norm) in [(1, [0.3, -0.4], 0.5), (2, [3.0, 4.0], 5.0)] {
            parameters.gradient.copy_from_slice(&gradient);
            let step = &AdamStep::new(settings, &OptimizerStep::new(settings, count, 1e-3, norm));
            Arch::new().dispatch(Adam { parameters: &mut parameters, step });
        }
        for (actual, expected) in [
            (&parameters.values, [0.9980001, -1.9990527]),
            (&parameters.first_moment, [0.056_999_94, 0.004_000_064]),
            (&parameters.second_moment, [1.799_096e-4, 3.198_393e-4]),
        ] {
            for (actual, expected) in actual.iter().zip(expected) {
                assert!((actual - expected).abs() < 2e-6 * expected.abs(), "{actual} is not {expected}");
            }
        }
    }
}
