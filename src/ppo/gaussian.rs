/*! The diagonal Gaussian of the policy: log-density, entropy and Kullback-Leibler divergence.

The standard deviation does not depend on the state, so its terms are computed once for many rows. Sums
run in f64: the KL rule compares numbers near zero, and two equal policies must be at distance zero exactly.
*/

/// The constant `½ ln 2π`.
const HALF_LOG_TWO_PI: f64 = 0.918_938_533_204_672_8;

/// The state-independent part of a diagonal Gaussian policy `N(μ(s), diag σ²)`.
#[derive(Debug, Clone)]
pub struct DiagonalGaussian {
    log_std: Vec<f64>,
    inverse_std: Vec<f64>,
    /// Log-density at the mean.
    log_peak: f64,
}

impl DiagonalGaussian {
    /// Precomputes the constants of `ln σ`, one for each action.
    pub fn new(log_std: &[f32]) -> Self {
        let log_std: Vec<f64> = log_std.iter().map(|&x| f64::from(x)).collect();
        let inverse_std = log_std.iter().map(|x| (-x).exp()).collect();
        let log_peak = -log_std.iter().map(|x| x + HALF_LOG_TWO_PI).sum::<f64>();
        Self { log_std, inverse_std, log_peak }
    }

    /// Returns `1/σ`, one for each action.
    pub fn inverse_std(&self) -> &[f64] {
        &self.inverse_std
    }

    /// Computes `ln p(action)`, summed over actions.
    #[inline(always)]
    pub fn log_prob(&self, mean: &[f32], action: &[f32]) -> f64 {
        self.log_peak - 0.5 * self.squared_distance(action, mean)
    }

    /// Computes `Σ ((a − b) / σ)²` in four parallel sums, which the compiler vectorises.
    #[inline(always)]
    fn squared_distance(&self, a: &[f32], b: &[f32]) -> f64 {
        let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<4>(), b.as_chunks::<4>());
        let (scales, scales_rest) = self.inverse_std.as_chunks::<4>();
        let mut sums = [0.0; 4];
        let add = |sum: &mut f64, a: f32, b: f32, scale: f64| {
            let z = (f64::from(a) - f64::from(b)) * scale;
            *sum += z * z;
        };
        for ((a, b), scales) in a.iter().zip(b).zip(scales) {
            for (i, sum) in sums.iter_mut().enumerate() {
                add(sum, a[i], b[i], scales[i]);
            }
        }
        for (((sum, a), b), scale) in sums.iter_mut().zip(a_rest).zip(b_rest).zip(scales_rest) {
            add(sum, *a, *b, *scale);
        }
        (sums[0] + sums[1]) + (sums[2] + sums[3])
    }

    /// Returns the entropy `Σ (½ + ½ ln 2π + ln σ)`.
    pub fn entropy(&self) -> f64 {
        0.5 * self.log_std.len() as f64 - self.log_peak
    }
}

/// The divergence `KL(old ‖ new)` of two diagonal Gaussians, summed over actions:
/// `Σ ln(σ_new/σ_old) + (σ_old² + (μ_old − μ_new)²) / (2 σ_new²) − ½`.
#[derive(Debug, Clone)]
pub struct KlDivergence<'a> {
    new: &'a DiagonalGaussian,
    of_equal_means: f64,
}

impl<'a> KlDivergence<'a> {
    /// Prepares the divergence of `new` from `old`.
    pub fn new(old: &DiagonalGaussian, new: &'a DiagonalGaussian) -> Self {
        let terms = old.log_std.iter().zip(&new.log_std).map(|(old, new)| {
            let log_ratio = old - new;
            0.5 * (2.0 * log_ratio).exp_m1() - log_ratio
        });
        Self { new, of_equal_means: terms.sum() }
    }

    /// Returns the divergence at a state with these mean actions.
    #[inline(always)]
    pub fn at(&self, old_mean: &[f32], new_mean: &[f32]) -> f64 {
        self.of_equal_means + 0.5 * self.new.squared_distance(old_mean, new_mean)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OLD: [f32; 3] = [-1.0, 0.25, 0.5];
    const NEW: [f32; 3] = [-0.75, 0.0, 0.625];
    const OLD_MEAN: [f32; 3] = [0.5, -1.0, 2.0];
    const NEW_MEAN: [f32; 3] = [0.25, -1.5, 1.75];
    const ACTION: [f32; 3] = [0.75, -0.5, -1.0];

    /* The numbers below:
    import numpy as np
    lo, ln = np.array([-1, .25, .5]), np.array([-.75, 0, .625])
    mo, mn, a = np.array([.5, -1, 2]), np.array([.25, -1.5, 1.75]), np.array([.75, -.5, -1])
    so, sn = np.exp(lo), np.exp(ln)
    print(np.sum(-.5*((a-mn)/sn)**2 - ln - .5*np.log(2*np.pi)))
    print(np.sum(.5 + .5*np.log(2*np.pi) + ln))
    print(np.sum(np.log(sn/so) + (so**2 + (mo-mn)**2)/(2*sn**2) - .5)) */

    fn assert_close(actual: f64, expected: f64) {
        assert!((actual - expected).abs() < 1e-12 * expected.abs(), "{actual} is not {expected}");
    }

    #[test]
    fn sums_over_actions_equal_the_textbook_formulas() {
        // Six actions have twice the sums of three.
        for count in [1, 2] {
            let of = |values: [f32; 3]| values.repeat(count);
            let (old, new) = (DiagonalGaussian::new(&of(OLD)), DiagonalGaussian::new(&of(NEW)));
            let times = count as f64;
            assert_close(new.log_prob(&of(NEW_MEAN), &of(ACTION)), times * -4.77537299653387);
            assert_close(new.entropy(), times * 4.1318155996140185);
            assert_close(KlDivergence::new(&old, &new).at(&of(OLD_MEAN), &of(NEW_MEAN)), times * 0.4160324150920287);
        }
    }
}
