//! A synthetic trot whose exact state is known, for the estimator's tests.

use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};

use super::sensors::{EncoderReading, ImuReading};
use crate::robot::{GRAVITY_M_S2, JOINTS, Joints, PARTS, Robot, kinematics, of_leg, same_in_every_leg};

pub const DT_S: f64 = 1.0 / 240.0;
/// Time in which the robot stands, and time in which it then reaches its speed \[s\].
const START_S: f64 = 1.0;
const SWING_S: f64 = 0.25;

/// The true state at one tick, and the readings of perfect sensors.
#[derive(Debug, Clone, Copy)]
pub struct Truth {
    pub position: Vector3<f64>,
    pub velocity_in_base: Vector3<f64>,
    pub world_from_base: UnitQuaternion<f64>,
    pub imu: ImuReading,
    pub encoders: EncoderReading,
    pub contacts: [bool; 4],
}

/// A robot that trots straight ahead, its trunk swaying, its feet rolling on the ground.
#[derive(Debug, Clone)]
pub struct Walker {
    robot: Arc<Robot>,
    speed: f64,
    tick: u32,
    feet: [Vector3<f64>; 4],
    feet_velocity: [Vector3<f64>; 4],
    /// Place where each foot left the ground, and true if it is in the air.
    lift: [Vector3<f64>; 4],
    flying: [bool; 4],
    angles: Joints,
    /// A foot that slips, and its velocity, world frame [m/s].
    pub slip: Option<(usize, Vector3<f64>)>,
}

impl Walker {
    /// Creates a robot that walks at `speed` [m/s]; at speed zero it stands perfectly still.
    pub fn new(speed: f64) -> Self {
        let robot = Robot::load("go1").unwrap();
        let feet = std::array::from_fn(|leg| nominal(&robot, leg, 0.0));
        let (angles, feet_velocity) = (same_in_every_leg([0.0, 0.8, -1.6]), [Vector3::zeros(); 4]);
        Walker { robot, speed, tick: 0, feet, feet_velocity, lift: feet, flying: [false; 4], angles, slip: None }
    }

    pub fn time_s(&self) -> f64 {
        f64::from(self.tick) * DT_S
    }

    /// Returns the distance walked \[m\] and the fraction of the full motion.
    fn progress(&self, time: f64) -> (f64, f64) {
        let u = (time - START_S).clamp(0.0, 1.0);
        let beyond = (time - START_S - 1.0).max(0.0);
        (self.speed * (u.powi(3) - 0.5 * u.powi(4) + beyond), if self.speed == 0.0 { 0.0 } else { smooth(u) })
    }

    fn pose(&self, time: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let (forward, fraction) = self.progress(time);
        let wave = |amplitude: f64, hz: f64, shift: f64| {
            fraction * amplitude * (std::f64::consts::TAU * hz * time + shift).sin()
        };
        let position = Vector3::new(forward, wave(0.01, 2.0, 0.3), 0.3 + wave(0.005, 4.0, 0.0));
        (position, UnitQuaternion::from_euler_angles(wave(0.04, 2.0, 0.0), wave(0.03, 4.0, 0.5), wave(0.02, 2.0, 1.0)))
    }

    fn site(&self, time: f64) -> Vector3<f64> {
        let (position, rotation) = self.pose(time);
        position + rotation * self.robot.imu_in_base
    }

    /// Advances by a tick.
    pub fn step(&mut self) -> Truth {
        self.tick += 1;
        let (time, h) = (self.time_s(), 1e-4);
        let (position, rotation) = self.pose(time);
        let velocity = (self.pose(time + h).0 - self.pose(time - h).0) / (2.0 * h);
        let rate = (self.pose(time - h).1.inverse() * self.pose(time + h).1).scaled_axis() / (2.0 * h);
        // A reading of the IMU covers the time since the last one.
        let site_velocity = |time| (self.site(time + h) - self.site(time - h)) / (2.0 * h);
        let acceleration = (site_velocity(time) - site_velocity(time - DT_S)) / DT_S;
        let imu = ImuReading {
            gyro: (self.pose(time - DT_S).1.inverse() * rotation).scaled_axis() / DT_S,
            specific_force: rotation.inverse() * (acceleration + Vector3::z() * GRAVITY_M_S2),
        };
        let mut rates = [0.0; JOINTS];
        let mut contacts = [true; 4];
        for leg in 0..4 {
            let flight = self.flight(leg, time);
            contacts[leg] = flight.is_none();
            match flight {
                Some(u) => self.fly(leg, time, u),
                None => {
                    self.flying[leg] = false;
                    self.feet[leg] += DT_S * self.feet_velocity[leg];
                    self.feet[leg].z = self.robot.legs[leg].foot_radius_m;
                }
            }
            self.reach(leg, rotation.inverse() * (self.feet[leg] - position));
            let (of_robot, angles) = (self.robot.legs[leg], of_leg(&self.angles, leg));
            let inverse = of_robot.foot_jacobian(angles).try_inverse().unwrap();
            // A foot that rolls moves with its own spin, which follows from its motion: a few rounds settle it.
            for _ in 0..6 {
                let relative = rotation.inverse() * (self.feet_velocity[leg] - velocity);
                let of_leg = inverse * (relative - rate.cross(&of_robot.foot_position(angles)));
                rates[PARTS.len() * leg..][..PARTS.len()].copy_from_slice(of_leg.as_slice());
                if flight.is_none() {
                    let spin = rotation * (kinematics::feet(&self.robot.legs, &self.angles, &rates)[leg].spin + rate);
                    let slip = self.slip.filter(|(slipping, _)| *slipping == leg).map_or(Vector3::zeros(), |(_, v)| v);
                    self.feet_velocity[leg] = spin.cross(&(Vector3::z() * of_robot.foot_radius_m)) + slip;
                }
            }
        }
        let velocity_in_base = rotation.inverse() * velocity;
        let encoders = EncoderReading { angles: self.angles, rates };
        Truth { position, velocity_in_base, world_from_base: rotation, imu, encoders, contacts }
    }

    /// Returns the completed fraction of a foot's flight; `None` on the ground. FR and RL alternate with FL and RR.
    fn flight(&self, leg: usize, time: f64) -> Option<f64> {
        let steps = (time - START_S) / SWING_S;
        let turn = usize::from(leg == 1 || leg == 2);
        (self.speed != 0.0 && steps >= 0.0 && steps as usize % 2 == turn).then(|| steps.fract())
    }

    fn fly(&mut self, leg: usize, time: f64, u: f64) {
        if !self.flying[leg] {
            (self.flying[leg], self.lift[leg]) = (true, self.feet[leg]);
        }
        let landing = time + (1.0 - u) * SWING_S;
        let ahead = self.progress(landing + 0.5 * SWING_S).0;
        let (from, to) = (self.lift[leg], nominal(&self.robot, leg, ahead));
        let height = (std::f64::consts::PI * u).sin().powi(2) * 0.08;
        self.feet[leg] = from + (to - from) * smooth(u) + Vector3::z() * height;
        let rise = (std::f64::consts::TAU * u).sin() * std::f64::consts::PI * 0.08;
        self.feet_velocity[leg] = ((to - from) * (6.0 * u * (1.0 - u)) + Vector3::z() * rise) / SWING_S;
    }

    /// Sets the joint angles that place the foot at `target`, by Newton's method from those of the last tick.
    fn reach(&mut self, leg: usize, target: Vector3<f64>) {
        let of_robot = self.robot.legs[leg];
        let mut angles = Vector3::from(of_leg(&self.angles, leg));
        for _ in 0..20 {
            let error = target - of_robot.foot_position(angles.into());
            angles += of_robot.foot_jacobian(angles.into()).lu().solve(&error).unwrap();
        }
        assert!((of_robot.foot_position(angles.into()) - target).norm() < 1e-9, "leg {leg} cannot reach {target}");
        self.angles[PARTS.len() * leg..][..PARTS.len()].copy_from_slice(angles.as_slice());
    }
}

/// Returns the point under a leg's thigh joint when the trunk is `forward` \[m\] from the start.
fn nominal(robot: &Robot, leg: usize, forward: f64) -> Vector3<f64> {
    let below = robot.legs[leg].foot_position([0.0; 3]);
    Vector3::new(forward + below.x, below.y, robot.legs[leg].foot_radius_m)
}

fn smooth(u: f64) -> f64 {
    u * u * (3.0 - 2.0 * u)
}
