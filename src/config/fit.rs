/*! Adapts a configuration to another robot, by dynamic similarity.

Of two robots of one shape, let the second be λ times as tall and μ times as heavy. Heights scale with λ, torques with μ
λ, times with √λ. To move alike and to get the same reward for the same velocities, keys scale like this:

| key | factor |
|---|---|
| `reward.base_height_m`, `reward.foot_height_m`, `episode.min_height_m` | λ |
| `simulation.kp_n_m_per_rad` | μ λ |
| `simulation.kd_n_m_s_per_rad` | μ λ √λ |
| `reward.energy`, of a power | 1 / μ |
| `reward.torque`, of a squared torque | 1 / (μ λ)² |
| `reward.height_sharpness`, `reward.foot_clearance`, of squared heights | 1 / λ² |
| `randomisation.trunk_mass_kg`, `trunk_offset_m` | μ, λ |
| `randomisation.joint_friction_n_m`, `joint_damping_n_m_s_per_rad` | μ λ, μ λ √λ |
| `terrain.rough_m`, `terrain.boxes_m`, `held_feet.height_m` | λ |
| `pulls.force_n`, `held_feet.force_n`, `randomisation.felt_force_error_sd_n` | μ |
| `held_feet.stiffness_n_per_m` | μ / λ |
| `reward.reference_m_s_per_n` | 1 / μ |

Physics may have to be faster for a light robot, whose joints have too little inertia for their gains: a joint of inertia I under a PD law
is stable in MuJoCo's steps of length h if 2 K_d h + K_p h² < 4 I. The rate is doubled until it is, with a reserve.

The pose is the robot's own. A policy explores at least as widely as with `ppo.initial_log_std` −0.5, since a robot that
these numbers fit less well would otherwise learn to stand still before it learns to walk. Commands, pushes, slopes,
latency and the policy's rate stay.
*/

use std::path::Path;

use super::check::MAX_PHYSICS_RATE_HZ;
use super::merge::robot_in;
use super::{Config, PerJoint, Simulation};
use crate::robot::{JOINTS, Joints, Robot, joint_name, least_inertia};
use crate::util::files::FileError;
use crate::util::numbers::maximum;

impl Config {
    /// Returns this configuration, adapted to another robot.
    ///
    /// # Errors
    /// The robot of this configuration cannot be read, or the other robot cannot stand in its nominal pose.
    pub fn fitted_to(&self, robot: &Robot) -> Result<Config, FileError> {
        let model = robot_in(Path::new(""), &robot.name);
        if model == self.robot.model {
            return Ok(self.clone());
        }
        let own = self.robot.load()?;
        let path = Path::new(&robot.name);
        let fail = FileError::of("robot", path);
        let pose = symmetric(robot);
        if let Some(joint) = beyond_limits(robot, &pose) {
            let ([low, high], angle) = (robot.joint_limits[joint], pose[joint]);
            return Err(fail(format!(
                "its joint {} stands at {angle} rad in its nominal pose, but goes from {low} to {high} rad: write nominal_pose_rad \
                 into a YAML file, as examples/robots/quadruped.yaml does",
                joint_name(joint)
            )));
        }
        let height = robot.standing_height_m(&pose) / own.standing_height_m(&self.action.nominal_pose_rad.joints());
        let mass = robot.mass_kg / own.mass_kg;
        if !(height > 0.0 && height.is_finite()) {
            return Err(fail(format!(
                "its feet are not below its trunk in its nominal pose {}: write nominal_pose_rad into a YAML file, as \
                 examples/robots/quadruped.yaml does",
                PerJoint::from(pose)
            )));
        }
        let mut config = self.clone();
        config.robot.model = model;
        config.action.nominal_pose_rad = pose.into();
        let scale = |value: &mut f64, factor: f64| *value = rounded(*value * factor);
        scale(&mut config.reward.base_height_m, height);
        scale(&mut config.reward.foot_height_m, height);
        scale(&mut config.episode.min_height_m, height);
        let simulation = &mut config.simulation;
        simulation.kp_n_m_per_rad = simulation.kp_n_m_per_rad.map(|gain| rounded(gain * (mass * height)));
        simulation.kd_n_m_s_per_rad =
            simulation.kd_n_m_s_per_rad.map(|gain| rounded(gain * (mass * height * height.sqrt())));
        scale(&mut config.reward.energy, 1.0 / mass);
        config.reward.reference_m_s_per_n.iter_mut().flatten().for_each(|value| scale(value, 1.0 / mass));
        scale(&mut config.reward.torque, (mass * height).powi(-2));
        scale(&mut config.reward.height_sharpness, height.powi(-2));
        scale(&mut config.reward.foot_clearance, height.powi(-2));
        scale(&mut config.randomisation.trunk_mass_kg, mass);
        scale(&mut config.randomisation.trunk_offset_m, height);
        scale(&mut config.randomisation.joint_friction_n_m, mass * height);
        scale(&mut config.randomisation.joint_damping_n_m_s_per_rad, mass * height * height.sqrt());
        scale(&mut config.randomisation.felt_force_error_sd_n, mass);
        if let Some(pulls) = &mut config.pulls {
            scale(&mut pulls.force_n, mass);
        }
        if let Some(terrain) = &mut config.terrain {
            terrain.rough_m.iter_mut().chain(&mut terrain.boxes_m).for_each(|value| scale(value, height));
        }
        if let Some(held_feet) = &mut config.held_feet {
            held_feet.height_m.iter_mut().for_each(|value| scale(value, height));
            scale(&mut held_feet.force_n, mass);
            scale(&mut held_feet.stiffness_n_per_m, mass / height);
        }
        let inertia = least_inertia(robot, &pose).map_err(FileError::of("robot", path))?;
        config.simulation.hold_gains(inertia).map_err(fail)?;
        config.ppo.initial_log_std = maximum(config.ppo.initial_log_std, -0.5);
        if let Some(fallen) = robot.fall_height_m {
            config.episode.min_height_m = fallen;
        }
        Ok(config)
    }
}

/// Largest part of the bound of stability that a physics step may take. Near the bound, a standing robot of 11 kg takes 3 % more power than
/// with steps a quarter as long; beyond it, one of 1.7 kg takes 80 times as much. The margin is for other poses.
const LARGEST_PART: f64 = 0.75;

impl Simulation {
    /// Doubles the physics rate until the gains are stable for joints of an inertia [kg·m²].
    fn hold_gains(&mut self, inertia: f64) -> Result<(), String> {
        let part = |simulation: &Simulation| {
            let (kp, kd) = (simulation.kp_n_m_per_rad.largest(), simulation.kd_n_m_s_per_rad.largest());
            let h = simulation.timestep_s();
            (2.0 * kd * h + kp * h * h) / (4.0 * inertia)
        };
        while part(self).is_nan() || part(self) > LARGEST_PART {
            if self.physics_rate_hz > MAX_PHYSICS_RATE_HZ / 2 {
                return Err(format!(
                    "the least inertia at its joints is {inertia:.1e} kg m², too little for K_p {} N m/rad and K_d {} \
                     N m s/rad at {MAX_PHYSICS_RATE_HZ} Hz: give its joints their rotors' armature",
                    self.kp_n_m_per_rad, self.kd_n_m_s_per_rad
                ));
            }
            self.physics_rate_hz *= 2;
        }
        Ok(())
    }
}

impl Config {
    /// Lists the keys whose values differ in another configuration, with its values, one on a line; empty if there are
    /// none.
    pub fn changes(&self, other: &Config) -> String {
        let lines =
            self.differences(other).into_iter().map(|(key, [own, other])| format!("{key}: {other} (was {own})\n"));
        lines.collect()
    }
}

/// Returns the robot's nominal pose made symmetric: the mean of each angle and its mirror image \[rad\].
fn symmetric(robot: &Robot) -> Joints {
    std::array::from_fn(|joint| {
        let (image, sign) = robot.mirrored(joint);
        // Adding zero turns −0 into 0.
        (robot.nominal_pose[joint] + sign * robot.nominal_pose[image]) / 2.0 + 0.0
    })
}

/// Returns the first joint whose angle is beyond its limits.
fn beyond_limits(robot: &Robot, pose: &Joints) -> Option<usize> {
    (0..JOINTS).find(|joint| {
        let [low, high] = robot.joint_limits[*joint];
        !(low..=high).contains(&pose[*joint])
    })
}

/// Rounds to three digits, the accuracy of the scaling rules.
fn rounded(value: f64) -> f64 {
    format!("{value:.2e}").parse().unwrap_or(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::PerJoint;
    use crate::robot::{Robot, same_in_every_leg};

    #[test]
    fn fitted_config_scales_heights_gains_and_weights() {
        // Ten times as heavy, standing on a deeper knee: twice 0.213 m of leg and 0.02 m of foot,
        // (0.426 cos 1 + 0.02) / (0.426 cos 0.72 + 0.02) = 0.7352 times as high.
        let mut robot = Robot::clone(&Robot::load("go1").unwrap());
        (robot.name, robot.mass_kg) = ("heavy".to_owned(), 10.0 * robot.mass_kg);
        robot.nominal_pose = same_in_every_leg([0.0, 1.0, -2.0]);
        let own = Config::load("fast").unwrap();
        let config = own.fitted_to(&robot).unwrap();
        assert!(config.robot.model.ends_with("/heavy"));
        assert_eq!(config.action.nominal_pose_rad, PerJoint::Alike([0.0, 1.0, -2.0]));
        assert_eq!((config.reward.base_height_m, config.reward.foot_height_m), (0.228, 0.0588));
        assert_eq!(config.episode.min_height_m, 0.147);
        // 40 · 7.352, 7.352 · √0.7352
        let gains = (config.simulation.kp_n_m_per_rad, config.simulation.kd_n_m_s_per_rad);
        assert_eq!(gains, (PerJoint::Same(294.0), PerJoint::Same(6.3)));
        // 0.015 / 10, 0.0015 / 7.352², 10 / 0.7352², 0.1 / 0.7352²
        assert_eq!((config.reward.energy, config.reward.torque), (-0.0015, -2.78e-5));
        assert_eq!((config.reward.height_sharpness, config.reward.foot_clearance), (18.5, -0.185));
        let printed = Config::load("compliant").unwrap();
        let fitted = printed.fitted_to(&robot).unwrap();
        assert_eq!((printed.ppo.initial_log_std, fitted.ppo.initial_log_std), (-1.0, -0.5));
        assert_eq!((config.command, config.randomisation), (own.command, own.randomisation));
        // 1 · 10, 0.03 · 0.7352, 0.3 · 7.352, 0.1 · 6.304; 85 · 10, 60 · 10, 600 · 10 / 0.7352
        let real = Config::load("real").unwrap().fitted_to(&robot).unwrap();
        let drawn = real.randomisation;
        assert_eq!((drawn.trunk_mass_kg, drawn.trunk_offset_m), (10.0, 0.0221));
        assert_eq!((drawn.joint_friction_n_m, drawn.joint_damping_n_m_s_per_rad), (2.21, 0.63));
        let (pulls, held) = (real.pulls.unwrap(), real.held_feet.unwrap());
        assert_eq!((pulls.force_n, drawn.felt_force_error_sd_n), (850.0, 10.0));
        assert_eq!((held.force_n, held.stiffness_n_per_m, held.height_m), (600.0, 8160.0, [0.0147, 0.0368]));
    }

    #[test]
    fn the_presets_of_the_go2_are_what_the_rule_says() {
        let numbers = |config: &Config| {
            let (simulation, reward, drawn) = (&config.simulation, &config.reward, &config.randomisation);
            let held_feet = config.held_feet.as_ref();
            vec![
                config.pulls.as_ref().map_or(1.0, |pulls| pulls.force_n),
                held_feet.map_or(1.0, |held| held.force_n),
                held_feet.map_or(1.0, |held| held.stiffness_n_per_m),
                1.0 + drawn.felt_force_error_sd_n,
                1.0 + drawn.trunk_mass_kg,
                1.0 + drawn.joint_friction_n_m,
                1.0 + drawn.joint_damping_n_m_s_per_rad,
                simulation.kp_n_m_per_rad.largest(),
                simulation.kd_n_m_s_per_rad.largest(),
                reward.energy,
                reward.torque,
                reward.foot_clearance,
                reward.base_height_m,
                reward.foot_height_m,
                config.episode.min_height_m,
                config.ppo.initial_log_std,
            ]
        };
        for (preset, own) in [("go2", "fast"), ("go2-real", "real")] {
            let rule = Config::load(own).unwrap().fitted_to(&Robot::load("go2").unwrap()).unwrap();
            let stated = Config::load(preset).unwrap();
            for (stated, found) in numbers(&stated).into_iter().zip(numbers(&rule)) {
                assert!((stated / found - 1.0).abs() < 0.03, "{preset}: {stated} {found}");
            }
            assert_eq!(stated.action.nominal_pose_rad, rule.action.nominal_pose_rad);
        }
    }

    #[test]
    fn a_pose_beyond_the_limits_is_refused_by_name() {
        let mut robot = Robot::clone(&Robot::load("go2").unwrap());
        (robot.nominal_pose[2], robot.nominal_pose[5]) = (-3.0, -3.0);
        let error = Config::load("fast").unwrap().fitted_to(&robot).unwrap_err().to_string();
        assert!(error.contains("FR_calf") && error.contains("-3") && error.contains("-2.7227"), "{error}");
    }
}
