/*! Position and velocity of the trunk: the linear Kalman filter of Bledt et al. (2018, "MIT Cheetah 3").

State (18): position `p` and velocity `v` of the IMU's site, centres `p_1 … p_4` of the feet, all in the gravity-aligned
world. Input: the site's acceleration `a = R f + g`. Measurements (28), with `Δ_i` the foot seen from the site:

| rows | measured | reads |
|---|---|---|
| 12 | `p − p_i` | `−Δ_i` |
| 12 | `v` | `v_i`, the site's velocity if foot i rolls without slipping |
| 4 | `p_i,z` | foot radius: the ground is at height zero |

The main differences from the MIT code, whose noises are not these either:

- The state is the IMU's site and not the trunk's origin, since the accelerometer measures there. The lever arm then
  enters exactly and needs no angular acceleration.
- A foot is a sphere that rolls: its centre moves by `Ω × r e_z`, 3 cm/s in a walk at 0.5 m/s. MIT's point foot stands
  still, and the velocity comes out too low by that.
- Contact is a yes or no, not the phase of a gait that MIT turns into a trust. A foot without contact has no velocity and
  height rows, and its position is free, so that at touchdown the joint angles determine it.
- A foot in contact whose `v_i` fits neither the prediction nor another foot slips, or its flag is wrong: its trust
  falls below one as the misfit grows, divides the standard deviations of its rows, and weights the variances of a
  standing and of a swinging foot. The latter is so large that a trust of 0.99 already frees the foot's position.
- Position is predicted with the acceleration's `½ a dt²` too; nothing corrects horizontal drift.

No row and no noise couples x, y and z. The 18-state filter thus is three of six states, and uncorrelated rows can be
taken one by one: a test compares with the whole filter.
*/

use nalgebra::{SMatrix, SVector, Vector3};
use serde::Serialize;

use crate::util::numbers::maximum;

/// Index of the first foot in the state of an axis, after position and velocity.
const FEET: usize = 2;

/// Noise that the filter assumes, as standard deviations. A random walk of density σ spreads by σ √t in time t.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FilterNoise {
    /// Random walk of the position in addition to the integrated velocity [m/√s].
    pub position_walk_m_sqrt_s: f64,
    /// Random walk of the velocity, from errors of accelerometer and tilt [m/s/√s].
    pub velocity_walk_m_s_sqrt_s: f64,
    /// Random walk of the velocity while the last reading of a silent IMU is held [m/s/√s].
    pub held_velocity_walk_m_s_sqrt_s: f64,
    /// Random walk of a foot in contact [m/√s].
    pub stance_walk_m_sqrt_s: f64,
    /// Random walk of a foot in the air [m/√s]; so large that the joints alone determine its position.
    pub swing_walk_m_sqrt_s: f64,
    /// Position of a foot from the joints, per axis \[m\].
    pub foot_position_m: f64,
    /// Horizontal velocity of the IMU's site from a foot in contact, per axis [m/s].
    pub foot_velocity_m_s: f64,
    /// Vertical velocity of the IMU's site from a foot in contact [m/s]; larger than the horizontal one, because rubber
    /// and ground give way at touchdown and recover during the stance.
    pub foot_sinking_m_s: f64,
    /// Height of the ground under a foot in contact \[m\].
    pub foot_height_m: f64,
    /// Misfit of a foot's velocity above which its trust falls, in standard deviations.
    pub misfit_limit: f64,
}

impl Default for FilterNoise {
    fn default() -> Self {
        FilterNoise {
            position_walk_m_sqrt_s: 0.005,
            velocity_walk_m_s_sqrt_s: 0.2,
            held_velocity_walk_m_s_sqrt_s: 0.5,
            stance_walk_m_sqrt_s: 0.01,
            swing_walk_m_sqrt_s: 10.0,
            foot_position_m: 0.02,
            foot_velocity_m_s: 0.1,
            foot_sinking_m_s: 0.3,
            foot_height_m: 0.02,
            misfit_limit: 2.0,
        }
    }
}

impl FilterNoise {
    /// Returns the standard deviation of a foot's velocity along x, y or z [m/s].
    fn velocity_sd(&self, axis: usize) -> f64 {
        if axis == 2 { self.foot_sinking_m_s } else { self.foot_velocity_m_s }
    }
}

/// Position and velocity of a foot from joints and gyro, world axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FootMeasurement {
    /// Position of the foot's centre relative to the IMU's site, `Δ_i` \[m\].
    pub offset: Vector3<f64>,
    /// Velocity of the foot's centre relative to the IMU's site, `dΔ_i/dt` [m/s].
    pub velocity: Vector3<f64>,
    /// Angular velocity of the foot, `Ω` [rad/s].
    pub spin: Vector3<f64>,
    /// Radius of the foot's sphere \[m\].
    pub radius_m: f64,
}

impl FootMeasurement {
    /// Returns the velocity of the centre of a foot that rolls on level ground [m/s].
    fn roll(&self) -> Vector3<f64> {
        self.spin.cross(&Vector3::new(0.0, 0.0, self.radius_m))
    }

    /// Returns `v_i`, the velocity of the IMU's site if the foot rolls without slipping [m/s].
    fn site_velocity(&self) -> Vector3<f64> {
        self.roll() - self.velocity
    }
}

/// Agreement of a step's measurements with the prediction.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fit {
    /// Normalised innovation squared `νᵀ S⁻¹ ν`, summed over all rows.
    pub squared: f64,
    /// Number of rows, the expected value of `squared`.
    pub rows: usize,
    /// Trust in each foot's contact, from 0 to 1.
    pub trust: [f64; 4],
}

/// The Kalman filter for position and velocity of the trunk and positions of the feet.
#[derive(Debug, Clone, PartialEq)]
pub struct KalmanFilter {
    noise: FilterNoise,
    /// The independent filters along x, y and z.
    axes: [Axis; 3],
}

impl KalmanFilter {
    /// Starts at rest with the trunk's origin above the world's, and the feet in contact (or else the lowest foot) on
    /// the ground. `arm` points from the trunk's origin to the IMU's site, world axes \[m\].
    pub fn new(noise: FilterNoise, arm: &Vector3<f64>, feet: &[FootMeasurement; 4], contacts: [bool; 4]) -> Self {
        let depths = feet.iter().zip(contacts).filter(|(_, contact)| *contact).map(|(foot, _)| -foot.offset.z);
        let (count, sum) = depths.fold((0.0, 0.0), |(count, sum), depth| (count + 1.0, sum + depth));
        let depth = if count > 0.0 { sum / count } else { feet.iter().map(|foot| -foot.offset.z).fold(0.0, maximum) };
        let radius = feet.iter().map(|foot| foot.radius_m).fold(0.0, maximum);
        let site = Vector3::new(arm.x, arm.y, depth + radius);
        let axes = std::array::from_fn(|axis| {
            let mut state = State::zeros();
            state[0] = site[axis];
            // The horizontal origin is a choice and has no error. The speed may be off by 0.5 m/s, as the robot may walk.
            let position_sd = if axis == 2 { noise.foot_height_m } else { 0.0 };
            let mut deviations = State::from_element(noise.swing_walk_m_sqrt_s);
            (deviations[0], deviations[1]) = (position_sd, 0.5);
            for (foot, measurement) in feet.iter().enumerate() {
                state[FEET + foot] = site[axis] + measurement.offset[axis];
            }
            Axis { state, covariance: Covariance::from_diagonal(&deviations.map(|sd| sd * sd)) }
        });
        KalmanFilter { noise, axes }
    }

    methods! {
        /// Returns the position of the IMU's site, world frame \[m\].
        fn position(&self) -> Vector3<f64> = self.across(0);
        /// Returns the velocity of the IMU's site, world frame [m/s].
        fn velocity(&self) -> Vector3<f64> = self.across(1);
        /// Returns the centre of a foot, world frame \[m\].
        fn foot(&self, leg: usize) -> Vector3<f64> = self.across(FEET + leg);
    }

    fn across(&self, index: usize) -> Vector3<f64> {
        Vector3::from_fn(|axis, _| self.axes[axis].state[index])
    }

    /// Advances by a tick of `dt_s` \[s\] that ends now. `ground` is the height under each foot \[m\]. `acceleration` is that of the
    /// IMU's site, world frame [m/s²]; `held` is true if it is an old reading; `feet` is `None` if the encoders were silent.
    pub fn step(
        &mut self,
        ground: &[f64; 4],
        acceleration: &Vector3<f64>,
        held: bool,
        feet: Option<&[FootMeasurement; 4]>,
        contacts: [bool; 4],
        dt_s: f64,
    ) -> Fit {
        let noise = self.noise;
        let walk = if held { noise.held_velocity_walk_m_s_sqrt_s } else { noise.velocity_walk_m_s_sqrt_s };
        for (axis, filter) in self.axes.iter_mut().enumerate() {
            filter.predict(acceleration[axis], dt_s);
            filter.covariance[(0, 0)] += noise.position_walk_m_sqrt_s.powi(2) * dt_s;
            filter.covariance[(1, 1)] += walk.powi(2) * dt_s;
        }
        let flags = contacts.map(|contact| if contact { 1.0 } else { 0.0 });
        let trust = feet.map_or(flags, |feet| self.trust(feet, contacts));
        for leg in 0..4 {
            let (stance, swing) = (noise.stance_walk_m_sqrt_s.powi(2), noise.swing_walk_m_sqrt_s.powi(2));
            let walk = trust[leg] * stance + (1.0 - trust[leg]) * swing;
            let roll = feet.map_or(Vector3::zeros(), |feet| trust[leg] * feet[leg].roll());
            for (axis, filter) in self.axes.iter_mut().enumerate() {
                filter.covariance[(FEET + leg, FEET + leg)] += walk * dt_s;
                filter.state[FEET + leg] += roll[axis] * dt_s;
            }
        }
        let mut fit = Fit { trust, ..Fit::default() };
        if let Some(feet) = feet {
            self.correct(ground, feet, &mut fit);
        }
        fit
    }

    fn correct(&mut self, ground: &[f64; 4], feet: &[FootMeasurement; 4], fit: &mut Fit) {
        let noise = &self.noise;
        for (axis, filter) in self.axes.iter_mut().enumerate() {
            for (leg, foot) in feet.iter().enumerate() {
                let mut row = |from, minus, value, sd: f64| {
                    fit.squared += filter.correct(from, minus, value, sd * sd);
                    fit.rows += 1;
                };
                row(0, Some(FEET + leg), -foot.offset[axis], noise.foot_position_m);
                let trust = fit.trust[leg];
                if trust > 0.0 {
                    row(1, None, foot.site_velocity()[axis], noise.velocity_sd(axis) / trust);
                    if axis == 2 {
                        row(FEET + leg, None, ground[leg] + foot.radius_m, noise.foot_height_m / trust);
                    }
                }
            }
        }
    }

    /// Returns the trust in each foot's contact: one if its velocity fits the prediction or that of another foot.
    fn trust(&self, feet: &[FootMeasurement; 4], contacts: [bool; 4]) -> [f64; 4] {
        let variances = [0, 1, 2].map(|axis| self.noise.velocity_sd(axis).powi(2));
        let velocities = feet.map(|foot| foot.site_velocity());
        let predicted = self.velocity();
        std::array::from_fn(|leg| {
            if !contacts[leg] {
                return 0.0;
            }
            let misfit = |velocity: &Vector3<f64>, uncertainty: &dyn Fn(usize) -> f64| -> f64 {
                let difference = velocities[leg] - velocity;
                (0..3).map(|axis| difference[axis] * difference[axis] / (variances[axis] + uncertainty(axis))).sum()
            };
            let to_prediction = misfit(&predicted, &|axis| self.axes[axis].covariance[(1, 1)]);
            let to_another = (0..4)
                .filter(|other| *other != leg && contacts[*other])
                .map(|other| misfit(&velocities[other], &|axis| variances[axis]));
            let least = to_another.fold(to_prediction, f64::min).sqrt();
            (self.noise.misfit_limit / least).min(1.0)
        })
    }
}

type State = SVector<f64, 6>;
type Covariance = SMatrix<f64, 6, 6>;

/// The filter along one axis: position, velocity, four feet.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Axis {
    state: State,
    covariance: Covariance,
}

impl Axis {
    /// Predicts: `x ← A x + B a`, `P ← A P Aᵀ`, where A is the identity except `p ← p + dt v`.
    fn predict(&mut self, acceleration: f64, dt_s: f64) {
        self.state[0] += dt_s * (self.state[1] + 0.5 * dt_s * acceleration);
        self.state[1] += dt_s * acceleration;
        for column in 0..6 {
            self.covariance[(0, column)] += dt_s * self.covariance[(1, column)];
        }
        for row in 0..6 {
            self.covariance[(row, 0)] += dt_s * self.covariance[(row, 1)];
        }
    }

    /// Corrects with one measurement of `x[plus] − x[minus]` and returns `ν² / s`. The covariance stays exactly
    /// symmetric.
    fn correct(&mut self, plus: usize, minus: Option<usize>, value: f64, variance: f64) -> f64 {
        let mut cross: State = self.covariance.column(plus).into();
        let (mut expected, mut own) = (self.state[plus], cross[plus]);
        if let Some(minus) = minus {
            cross -= self.covariance.column(minus);
            expected -= self.state[minus];
            own = cross[plus] - cross[minus];
        }
        let (innovation, total) = (value - expected, own + variance);
        self.state += cross * (innovation / total);
        for column in 0..6 {
            let scaled = cross[column] / total;
            for row in 0..=column {
                let value = self.covariance[(row, column)] - cross[row] * scaled;
                self.covariance[(row, column)] = value;
                self.covariance[(column, row)] = value;
            }
        }
        innovation * innovation / total
    }
}

#[cfg(test)]
#[path = "kalman_tests.rs"]
mod tests;
