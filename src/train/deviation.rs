/*! Random differences of a real robot and its surroundings from the simulation: dynamics, errors of the inertial sensor, held feet.

They are drawn with an episode, symmetric about zero or about the nominal value where both signs occur, so that the mirror
image of an episode is as likely as the episode.
*/

use nalgebra::{UnitQuaternion, Vector3};
use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

use crate::config::{HeldFeet, Randomisation, Simulation};
use crate::robot::{LEGS, RobotState};
use crate::sim::Dynamics;
use crate::world::Hold;

/// Draws the dynamics of an episode; `None` if nothing but friction and encoder bias is randomised.
pub(super) fn dynamics(range: &Randomisation, simulation: &Simulation, rng: &mut impl Rng) -> Option<Dynamics> {
    let ranges = [
        range.trunk_mass_kg,
        range.trunk_offset_m,
        range.gain_error,
        range.joint_friction_n_m,
        range.joint_damping_n_m_s_per_rad,
    ];
    if !range.enabled || (ranges == [0.0; 5] && range.latency_s.is_none()) {
        return None;
    }
    let mut within = |low: f64, high: f64| rng.random_range(low..=high);
    let latency_s = range.latency_s.unwrap_or([simulation.latency_s; 2]);
    Some(Dynamics {
        trunk_mass_kg: within(-range.trunk_mass_kg, range.trunk_mass_kg),
        trunk_offset_m: std::array::from_fn(|_| within(-range.trunk_offset_m, range.trunk_offset_m)),
        gains: std::array::from_fn(|_| within(1.0 - range.gain_error, 1.0 + range.gain_error)),
        latency_s: within(latency_s[0], latency_s[1]),
        joint_friction_n_m: within(0.0, range.joint_friction_n_m),
        joint_damping_n_m_s_per_rad: within(0.0, range.joint_damping_n_m_s_per_rad),
    })
}

/// The errors of an inertial sensor in an episode.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct ImuErrors {
    /// Constant error of the angular velocity, base frame [rad/s].
    pub gyro_bias_rad_s: [f64; 3],
    /// Standard deviation of the angular velocity about each axis in a policy step [rad/s].
    pub gyro_noise_sd_rad_s: f64,
    /// Constant errors of roll and pitch in the direction of gravity \[rad\].
    pub tilt_rad: [f64; 2],
    /// Constant error of the felt force, forward and left in the heading frame \[N\]: that of the accelerometer, times the mass.
    pub felt_force_n: [f64; 2],
}

impl ImuErrors {
    /// Draws the constant errors of an episode; `None` if the sensor has none.
    pub(super) fn draw(range: &Randomisation, rng: &mut impl Rng) -> Option<Self> {
        let (bias, noise, tilt) = (range.gyro_bias_sd_rad_s, range.gyro_noise_sd_rad_s, range.tilt_error_sd_rad);
        let felt_force = range.felt_force_error_sd_n;
        if !range.enabled || [bias, noise, tilt, felt_force] == [0.0; 4] {
            return None;
        }
        let mut normal = |sd: f64| sd * rng.sample::<f64, _>(StandardNormal);
        Some(ImuErrors {
            gyro_bias_rad_s: std::array::from_fn(|_| normal(bias)),
            gyro_noise_sd_rad_s: noise,
            tilt_rad: std::array::from_fn(|_| normal(tilt)),
            felt_force_n: std::array::from_fn(|_| normal(felt_force)),
        })
    }

    /// Returns the state that the policy observes through the sensor; the noise of this policy step comes from `rng`.
    pub fn seen(&self, state: &RobotState, rng: &mut impl Rng) -> RobotState {
        let bias = Vector3::from(self.gyro_bias_rad_s);
        let noise = Vector3::from_fn(|_, _| self.gyro_noise_sd_rad_s * rng.sample::<f64, _>(StandardNormal));
        let [roll, pitch] = self.tilt_rad;
        RobotState {
            gravity_in_base: UnitQuaternion::from_euler_angles(roll, pitch, 0.0) * state.gravity_in_base,
            angular_velocity_in_base: state.angular_velocity_in_base + bias + noise,
            felt_force: state.felt_force.map(|force| [0, 1].map(|axis| force[axis] + self.felt_force_n[axis])),
            ..state.clone()
        }
    }
}

/// Draws the times at which the feet are held, up to the end of an episode.
pub(super) fn holds(range: &HeldFeet, length_s: f64, rng: &mut impl Rng) -> Vec<Hold> {
    let mut within = |[low, high]: [f64; 2]| rng.random_range(low..=high);
    let HeldFeet { force_n, stiffness_n_per_m, .. } = *range;
    let mut holds = Vec::new();
    for leg in 0..LEGS.len() {
        // The first time is drawn from zero to the longest gap, so that the start of an episode is no special time.
        let mut time_s = within([0.0, range.gap_s[1]]);
        while time_s < length_s {
            let until_s = time_s + within(range.duration_s);
            let height_m = within(range.height_m);
            holds.push(Hold { leg, from_s: time_s, until_s, height_m, force_n, stiffness_n_per_m });
            time_s = until_s + within(range.gap_s);
        }
    }
    holds
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::util::random::{Purpose, stream};

    fn range() -> Randomisation {
        Randomisation {
            enabled: true,
            trunk_mass_kg: 1.0,
            trunk_offset_m: 0.02,
            gain_error: 0.1,
            latency_s: Some([0.02, 0.04]),
            joint_friction_n_m: 0.4,
            joint_damping_n_m_s_per_rad: 0.2,
            ..Config::load("compliant").unwrap().randomisation
        }
    }

    #[test]
    fn drawn_dynamics_fill_their_ranges_from_end_to_end() {
        let (simulation, range) = (Config::load("compliant").unwrap().simulation, range());
        let drawn: Vec<Dynamics> =
            (0..2000).map(|k| dynamics(&range, &simulation, &mut stream(1, Purpose::Episode, 0, k)).unwrap()).collect();
        let fills = |of: fn(&Dynamics) -> f64, [low, high]: [f64; 2]| {
            let found = drawn.iter().map(of).fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)]);
            let margin = 0.01 * (high - low);
            assert!((low..low + margin).contains(&found[0]) && (high - margin..=high).contains(&found[1]), "{found:?}");
        };
        fills(|it| it.trunk_mass_kg, [-1.0, 1.0]);
        fills(|it| it.trunk_offset_m[1], [-0.02, 0.02]);
        fills(|it| it.gains[0], [0.9, 1.1]);
        fills(|it| it.gains[1], [0.9, 1.1]);
        fills(|it| it.latency_s, [0.02, 0.04]);
        fills(|it| it.joint_friction_n_m, [0.0, 0.4]);
        fills(|it| it.joint_damping_n_m_s_per_rad, [0.0, 0.2]);
    }

    #[test]
    fn without_ranges_there_are_no_deviations() {
        let Config { simulation, randomisation, .. } = Config::load("compliant").unwrap();
        let mut rng = stream(1, Purpose::Episode, 0, 0);
        let of_paper = Randomisation { enabled: true, ..randomisation };
        assert_eq!(dynamics(&of_paper, &simulation, &mut rng), None);
        assert_eq!(dynamics(&Randomisation { enabled: false, ..range() }, &simulation, &mut rng), None);
        assert_eq!(ImuErrors::draw(&of_paper, &mut rng), None);
        // A latency that is not randomised stays the configuration's.
        let of_mass = Randomisation { latency_s: None, ..range() };
        assert_eq!(dynamics(&of_mass, &simulation, &mut rng).unwrap().latency_s, 0.03);
    }

    #[test]
    fn inertial_sensor_turns_gravity_and_offsets_the_rate() {
        let (gravity_in_base, angular_velocity_in_base) = (Vector3::new(0.0, 0.0, -10.0), Vector3::new(1.0, 2.0, 3.0));
        let felt_force = Some([10.0, 20.0]);
        let state = RobotState { gravity_in_base, angular_velocity_in_base, felt_force, ..RobotState::default() };
        let (gyro_bias_rad_s, felt_force_n) = ([0.1, 0.2, 0.3], [1.0, -2.0]);
        let errors = ImuErrors { gyro_bias_rad_s, gyro_noise_sd_rad_s: 0.0, tilt_rad: [0.1, 0.0], felt_force_n };
        let mut rng = stream(1, Purpose::Imu, 0, 0);
        let seen = errors.seen(&state, &mut rng);
        assert_eq!(seen.felt_force, Some([11.0, 18.0]));
        assert!((seen.angular_velocity_in_base - Vector3::new(1.1, 2.2, 3.3)).norm() < 1e-12);
        // Turned about the forward axis: (0, 10 sin 0.1, −10 cos 0.1).
        assert!((seen.gravity_in_base - Vector3::new(0.0, 0.998_334, -9.950_042)).norm() < 1e-6);
        let noisy = ImuErrors { gyro_noise_sd_rad_s: 0.2, ..errors };
        let rates: Vec<f64> =
            (0..4000).map(|_| noisy.seen(&state, &mut rng).angular_velocity_in_base.x - 1.1).collect();
        let sd = (rates.iter().map(|rate| rate * rate).sum::<f64>() / 4000.0).sqrt();
        assert!((sd / 0.2 - 1.0).abs() < 0.05, "{sd}");
    }

    #[test]
    fn every_foot_is_held_about_as_often_as_its_gaps_say() {
        let (height_m, duration_s, gap_s) = ([0.02, 0.05], [0.05, 0.15], [0.5, 1.4]);
        let range = HeldFeet { force_n: 60.0, stiffness_n_per_m: 600.0, height_m, duration_s, gap_s };
        let mut counts = [0; 4];
        for k in 0..500 {
            for hold in holds(&range, 4.0, &mut stream(1, Purpose::Episode, 0, k)) {
                counts[hold.leg] += 1;
                assert!((0.05..=0.150001).contains(&(hold.until_s - hold.from_s)) && hold.from_s < 4.0);
                assert!((0.02..=0.05).contains(&hold.height_m));
            }
        }
        // Every 0.95 + 0.1 s on average after 0.7 s: 3.3 / 1.05 + 1/2 or so in 4 s.
        assert!(counts.iter().all(|count| (1650..1950).contains(count)), "{counts:?}");
    }
}
