/*! The felt forces: estimates of the external force on the trunk and of the force on each foot, by the balance of momentum.

A trunk with four legs of three hinges has 18 equations of motion. Four foot forces `f` (12 unknowns) and a wrench `w` on
the trunk (6 unknowns) are all that comes from outside, so that the equations determine them:

```text
leg i:  J_iᵀ f_i = r_i                  r = M(q) a + h(q, v) + d(v) − Sᵀ τ
trunk:  w = r_base − Σ J_base,iᵀ f_i
```

`M a + h` is MuJoCo's recursive Newton-Euler algorithm on a model of the robot alone; armature and joint losses `d` (damping times rate; dry
friction, smoothed below 0.05 rad/s) are added. `J_i` is that of the point where the sphere of the foot would touch the ground: the plane
along the lines between feet that carried weight together, over the last half second. All of it is written in the trunk's frame at the
origin, at rest except for its rotation: the equations are the same in every frame that moves uniformly, and gravity is an acceleration of
the frame. The accelerometer's specific force, brought from the IMU to the trunk's origin, thus stands for base acceleration and gravity
together. Neither velocity nor height of the base is needed, and a wrong orientation turns the result but is not taken for a force. What
touches a thigh or shin counts in part as a force on the foot, in part as one on the trunk.

Time stamps. What the simulation does between two readings, k and k+1, is `M(q_k) (v_k+1 − v_k)/Δt + h(q_k, v_k) + D v_k+1 = Sᵀ τ_k + …`
(semi-implicit Euler, damping implicit). So configuration and `h` are those of the earlier reading, and torques those between the two. The
specific force is that of the later one, turned back by ω Δt, and damping acts on the later rates.

Differences and the momentum observer. `w` is linear in the accelerations of joints and trunk: `w_k = A_k (v_k+1 − v_k)/Δt + …`
with `A = (1, −J_baseᵀ J⁻ᵀ) M`. A first-order low-pass LP of time constant T turns this into

```text
LP(A v̇) = (A v − LP(A v)) / T − LP(Ȧ v)
```

by integration by parts: the residual of De Luca and Mattone's momentum observer, with K = 1/T and A v for the momentum. Summation by parts
says the same of differences, exactly, with the differences of A for Ȧ. So [`ForceObserver`] multiplies differences by `A`, and the caller
filters the product ([`ExternalForces::follow`], or the mean over a policy step). This is the momentum observer, but needs no Ȧ: every term
passes the same filter, and `A` is always that of its own instant. Noise of rates is amplified by 1/T and not by 1/Δt. Filtering `r` first
and using the present `J` would not be enough: in a walk, the error of the force would be 7 N instead of 0.02 N.

- A. De Luca and R. Mattone, "Sensorless robot collision detection and hybrid force/motion control", ICRA 2005.
- S. Haddadin, A. De Luca and A. Albu-Schäffer, "Robot collisions: a survey on detection, isolation, and identification",
  IEEE Transactions on Robotics 33(6), 2017.
- V. Morlando, A. Teimoorzadeh and F. Ruggiero, "Whole-body control with disturbance rejection through a momentum-based
  observer for quadruped robots", Mechanism and Machine Theory 164, 2021.
*/

use nalgebra::{Matrix3, SymmetricEigen, UnitQuaternion, Vector3};

use super::SensorFault;
use super::sensors::{EncoderReading, ImuReading, finite};
use crate::mujoco::{self, Data, Model, Object};
use crate::robot::{FootSphere, GRAVITY_M_S2, JOINTS, Joints, PARTS, Robot, joint_name};

/// Time constant of the low-pass \[s\].
pub const TIME_CONSTANT_S: f64 = 0.1;

/// Limit of each force, in weights of the robot: that of a push of 1.2 m/s within 1/240 s.
pub const LIMIT_WEIGHTS: f64 = 30.0;

/// The limit of the moment on the trunk is that force at this arm \[m\].
const LIMIT_ARM_M: f64 = 0.5;

/// Dry friction grows with the rate up to this one [rad/s].
const STICKING_RAD_S: f64 = 0.05;

/// A leg is nearly singular if some joint motion moves its foot by less than this fraction of thigh and shank.
const SINGULAR: f64 = 0.06;

/// A joint counts as at its limit when it is this close to it \[rad\].
const AT_LIMIT_RAD: f64 = 0.005;

/// A knee lower than this above the lowest foot may lie on the ground \[m\].
const LOW_KNEE_M: f64 = 0.05;

/// Time constant of the ground's plane \[s\].
const GROUND_TIME_S: f64 = 0.5;

/// Weight of level ground in that plane, against the squared distances of feet [m²].
const LEVEL_M2: f64 = 1e-4;

/// A foot that carries at least this fraction of the robot's weight stands on the ground.
const CARRIES: f64 = 0.125;

/// The ground is taken for level if it seems steeper than this \[rad\].
const STEEPEST_RAD: f64 = 0.5;

/// A trunk lifted by more than this fraction of the robot's weight may lie on something.
const LIFTED: f64 = 1.0 / 3.0;

/// The readings of one physics step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForceReading {
    /// Gyro and accelerometer at the end of the step.
    pub imu: ImuReading,
    /// Joint angles and rates at the end of the step.
    pub encoders: EncoderReading,
    /// Torques of the motors during the step, commanded where they are not measured [N·m].
    pub torques: Joints,
    /// Rotation from the trunk's frame to a world with z up, at the end of the step.
    pub world_from_base: UnitQuaternion<f64>,
}

/// A reason not to trust the forces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Doubt {
    /// There is no reading before the last one. The forces are as they were.
    Starting,
    /// The last reading was refused. The forces are as they were.
    Refused,
    /// The leg of this index is nearly singular. The forces are as they were.
    Singular(usize),
    /// The readings are so large that the forces are not finite. The forces are as they were.
    Overflow,
    /// The joint of this index is at its limit, which carries a torque that is not known. The forces are as they were.
    JointLimit(usize),
    /// Trunk or shins may lie on the ground: low knees, a trunk on its side, or one that is lifted.
    Lying,
}

/// Forces from outside in the trunk's heading frame (x forward, y left, z up).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ExternalForces {
    /// Force on the trunk \[N\].
    pub force: Vector3<f64>,
    /// Moment on the trunk about its centre of mass [N·m].
    pub moment: Vector3<f64>,
    /// Force on each foot, in the order of [`LEGS`](crate::robot::LEGS) \[N\].
    pub feet: [Vector3<f64>; 4],
    /// The reason not to trust them; `None` if they can be trusted.
    pub doubt: Option<Doubt>,
}

impl ExternalForces {
    /// Adds other forces; the first doubt stays.
    fn add(&mut self, other: &ExternalForces) {
        self.force += other.force;
        self.moment += other.moment;
        self.feet.iter_mut().zip(other.feet).for_each(|(sum, foot)| *sum += foot);
        self.doubt = self.doubt.or(other.doubt);
    }

    fn divided(self, by: f64) -> Self {
        let feet = self.feet.map(|foot| foot / by);
        ExternalForces { force: self.force / by, moment: self.moment / by, feet, ..self }
    }

    /// Follows other forces for `dt_s` \[s\] through a first-order low-pass of [`TIME_CONSTANT_S`]; takes their doubt.
    pub fn follow(&mut self, now: &ExternalForces, dt_s: f64) {
        let step = 1.0 - (-dt_s / TIME_CONSTANT_S).exp();
        self.force += step * (now.force - self.force);
        self.moment += step * (now.moment - self.moment);
        self.feet.iter_mut().zip(now.feet).for_each(|(foot, now)| *foot += step * (now - *foot));
        self.doubt = now.doubt;
    }
}

/// Error of the observer.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ForceFault {
    /// A reading is not finite, or the time step is not positive.
    #[error(transparent)]
    Reading(#[from] SensorFault),
    /// MuJoCo cannot evaluate the robot alone.
    #[error(transparent)]
    Physics(#[from] mujoco::Error),
}

/// Finds the external forces from one reading for each physics step.
#[derive(Debug)]
pub struct ForceObserver {
    /// The robot alone, without gravity.
    data: Data,
    limit_n: f64,
    weight_n: f64,
    imu_in_base: Vector3<f64>,
    /// Centre of mass of the trunk, trunk frame \[m\].
    centre: Vector3<f64>,
    /// Index of the root's first position and velocity.
    root: [usize; 2],
    joints: [JointPlace; JOINTS],
    /// Ranges of the joints \[rad\].
    limits: [[f64; 2]; JOINTS],
    /// Geometry and radius \[m\] of each foot.
    feet: [FootSphere; 4],
    memory: Memory,
}

/// The memory of a [`ForceObserver`] between two readings.
#[derive(Debug, Clone)]
pub(crate) struct Memory {
    before: Option<ForceReading>,
    forces: ExternalForces,
    /// Sum of the forces since the last call of [`ForceObserver::take_mean`], and their number.
    sum: ExternalForces,
    count: u32,
    /// Low-passed sum of v vᵀ over the lines v between feet that carry weight, world frame [m²].
    lines: Matrix3<f64>,
    /// Upward force on the trunk, low-passed over [`TIME_CONSTANT_S`]: a push is no lift \[N\].
    lift_n: f64,
}

impl Default for Memory {
    fn default() -> Self {
        let forces = ExternalForces { doubt: Some(Doubt::Starting), ..ExternalForces::default() };
        Memory { before: None, forces, sum: ExternalForces::default(), count: 0, lines: Matrix3::zeros(), lift_n: 0.0 }
    }
}

/// Id of a joint in the model and the indices of its angle and rate.
#[derive(Debug, Clone, Copy)]
struct JointPlace {
    joint: usize,
    position: usize,
    velocity: usize,
}

impl ForceObserver {
    /// Creates the observer of a robot; forces start at zero.
    ///
    /// # Errors
    /// MuJoCo cannot compile the robot alone.
    pub fn new(robot: &Robot) -> mujoco::Result<Self> {
        let alone = r#"<mujoco><include file="robot.xml"/><compiler discardvisual="true"/></mujoco>"#;
        let mut model = Model::from_xml(&[("alone.xml", alone), ("robot.xml", robot.mjcf())])?;
        model.set_gravity([0.0; 3]);
        let joints: [usize; JOINTS] = model.ids(Object::Joint, |k| format!("{}_joint", joint_name(k)))?;
        let joints = joints.map(|joint| {
            model.set_losses(joint, robot.losses.friction_n_m, robot.losses.damping_n_m_s_per_rad);
            let (position, velocity) = (model.joint_position_index(joint), model.joint_velocity_index(joint));
            JointPlace { joint, position, velocity }
        });
        let foot = |leg| FootSphere::new(&model, leg);
        let feet = [foot(0)?, foot(1)?, foot(2)?, foot(3)?];
        let root = model.id(Object::Joint, "root")?;
        let weight_n = robot.mass_kg * GRAVITY_M_S2;
        let (limit_n, imu_in_base) = (LIMIT_WEIGHTS * weight_n, robot.imu_in_base);
        let centre = model.body_centre_of_mass(model.id(Object::Body, "trunk")?).into();
        let (root, limits) = ([model.joint_position_index(root), model.joint_velocity_index(root)], robot.joint_limits);
        let (memory, data) = (Memory::default(), Data::new(model)?);
        Ok(ForceObserver { limit_n, weight_n, imu_in_base, centre, root, joints, limits, feet, memory, data })
    }

    /// Clears all readings and forces; to be called after the robot has been moved to another place.
    pub fn reset(&mut self) {
        self.memory = Memory::default();
    }

    /// Returns the memory, from which an observer of the same robot can continue.
    pub(crate) fn memory(&mut self) -> &mut Memory {
        &mut self.memory
    }

    /// Takes the reading of a physics step, `dt_s` \[s\] after the last one.
    ///
    /// # Errors
    /// A reading that is not finite, by name, a time step that is not positive, or a fault of MuJoCo. The forces are then
    /// as before and in [`Doubt::Refused`], and the next reading is a first one.
    pub fn update(&mut self, reading: &ForceReading, dt_s: f64) -> Result<&ExternalForces, ForceFault> {
        let doubt = self.judge(reading, dt_s);
        self.memory.forces.doubt = doubt.as_ref().map_or(Some(Doubt::Refused), |doubt| *doubt);
        self.memory.sum.add(&self.memory.forces);
        self.memory.count += 1;
        doubt?;
        self.memory.before = Some(*reading);
        Ok(&self.memory.forces)
    }

    /// Returns the mean of the forces after each reading since the last call, with the first doubt; zero without a reading.
    pub fn take_mean(&mut self) -> ExternalForces {
        std::mem::take(&mut self.memory.sum).divided(f64::from(std::mem::take(&mut self.memory.count).max(1)))
    }

    fn judge(&mut self, reading: &ForceReading, dt_s: f64) -> Result<Option<Doubt>, ForceFault> {
        let before = self.memory.before.take();
        check(reading, dt_s)?;
        before.map_or(Ok(Some(Doubt::Starting)), |before| Ok(self.balance(&before, reading, dt_s)?))
    }

    /// Solves the equations of the step between two readings.
    fn balance(&mut self, before: &ForceReading, now: &ForceReading, dt_s: f64) -> mujoco::Result<Option<Doubt>> {
        let at_limit = |joint: &usize| {
            let ([low, high], angle) = (self.limits[*joint], now.encoders.angles[*joint]);
            angle < low + AT_LIMIT_RAD || angle > high - AT_LIMIT_RAD
        };
        if let Some(joint) = (0..JOINTS).find(at_limit) {
            return Ok(Some(Doubt::JointLimit(joint)));
        }
        self.place(before, now, dt_s);
        self.data.inverse_dynamics()?;
        let up = before.world_from_base.inverse() * Vector3::z();
        let (mut force, mut moment) = (self.base_rows(0), self.base_rows(3));
        let centres = self.feet.map(|foot| Vector3::from(foot.centre(&self.data)));
        let normal = before.world_from_base.inverse() * ground_normal(&self.memory.lines);
        let (mut feet, mut lowest, mut knee) = ([Vector3::zeros(); 4], f64::INFINITY, f64::INFINITY);
        for (leg, foot) in feet.iter_mut().enumerate() {
            let contact = centres[leg] - self.feet[leg].radius_m * normal;
            let places = &self.joints[PARTS.len() * leg..][..PARTS.len()];
            let anchor = |part: usize| vector(self.data.joint_anchors(), places[part].joint);
            let column =
                |part: usize| vector(self.data.joint_axes(), places[part].joint).cross(&(contact - anchor(part)));
            let jacobian = Matrix3::from_columns(&[column(0), column(1), column(2)]);
            let rows = Vector3::from_fn(|part, _| self.joint_row(PARTS.len() * leg + part, before, now, dt_s));
            let length = (anchor(2) - anchor(1)).norm() + (contact - anchor(2)).norm();
            // The inverse's norm is at least one over the smallest singular value.
            let inverse = jacobian.try_inverse().filter(|inverse| inverse.norm() * SINGULAR * length < 1.0);
            let Some(inverse) = inverse else { return Ok(Some(Doubt::Singular(leg))) };
            *foot = inverse.tr_mul(&rows);
            force -= *foot;
            moment -= contact.cross(foot);
            (lowest, knee) = (lowest.min(contact.dot(&up)), knee.min(anchor(2).dot(&up)));
        }
        moment -= self.centre.cross(&force);
        if !force.iter().chain(&moment).all(|value| value.is_finite()) {
            return Ok(Some(Doubt::Overflow));
        }
        let carries = feet.map(|foot| foot.dot(&up) > CARRIES * self.weight_n);
        let pairs = (0..4).flat_map(|leg| (0..leg).map(move |other| (leg, other)));
        let standing = pairs.filter(|&(leg, other)| carries[leg] && carries[other]);
        let lines = standing.map(|(leg, other)| before.world_from_base * (centres[leg] - centres[other]));
        let sum: Matrix3<f64> = lines.map(|line| line * line.transpose()).sum();
        self.memory.lines += (1.0 - (-dt_s / GROUND_TIME_S).exp()) * (sum - self.memory.lines);
        self.note(before, force, moment, feet);
        self.memory.lift_n +=
            (1.0 - (-dt_s / TIME_CONSTANT_S).exp()) * (self.memory.forces.force.z - self.memory.lift_n);
        let lying = knee < lowest + LOW_KNEE_M || up.z < 0.5 || self.memory.lift_n > LIFTED * self.weight_n;
        Ok(lying.then_some(Doubt::Lying))
    }

    /// Writes state and accelerations of the step into MuJoCo's data, trunk frame.
    fn place(&mut self, before: &ForceReading, now: &ForceReading, dt_s: f64) {
        let (rate, arm) = (now.imu.gyro, self.imu_in_base);
        let turning = (rate - before.imu.gyro) / dt_s;
        let of_arm = turning.cross(&arm) + rate.cross(&rate.cross(&arm));
        let linear = UnitQuaternion::from_scaled_axis(rate * dt_s) * (now.imu.specific_force - of_arm);
        let [position, velocity] = self.root;
        self.data.positions_mut()[position..][..7].copy_from_slice(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]);
        self.data.velocities_mut()[velocity..][..3].fill(0.0);
        self.data.velocities_mut()[velocity + 3..][..3].copy_from_slice(before.imu.gyro.as_slice());
        self.data.accelerations_mut()[velocity..][..3].copy_from_slice(linear.as_slice());
        self.data.accelerations_mut()[velocity + 3..][..3].copy_from_slice(turning.as_slice());
        for (index, place) in self.joints.iter().enumerate() {
            let [earlier, later] = [before, now].map(|reading| reading.encoders.rates[index]);
            self.data.positions_mut()[place.position] = before.encoders.angles[index];
            self.data.velocities_mut()[place.velocity] = earlier;
            self.data.accelerations_mut()[place.velocity] = (later - earlier) / dt_s;
        }
    }

    /// Three of the base's rows of `r`.
    fn base_rows(&self, from: usize) -> Vector3<f64> {
        Vector3::from_column_slice(&self.data.inverse_forces()[self.root[1] + from..][..3])
    }

    /// A joint's row of `r`.
    fn joint_row(&self, joint: usize, before: &ForceReading, now: &ForceReading, dt_s: f64) -> f64 {
        let (model, dof) = (self.data.model(), self.joints[joint].velocity);
        let rate = now.encoders.rates[joint];
        let acceleration = (rate - before.encoders.rates[joint]) / dt_s;
        let friction = model.friction_loss()[dof] * (rate / STICKING_RAD_S).clamp(-1.0, 1.0);
        let lost = model.damping()[dof] * rate + friction;
        self.data.inverse_forces()[dof] + model.armature()[dof] * acceleration + lost - now.torques[joint]
    }

    /// Notes bounded forces, given in the trunk frame, in the heading frame.
    fn note(&mut self, before: &ForceReading, force: Vector3<f64>, moment: Vector3<f64>, feet: [Vector3<f64>; 4]) {
        let (_, _, yaw) = before.world_from_base.euler_angles();
        let heading_from_base = UnitQuaternion::from_euler_angles(0.0, 0.0, -yaw) * before.world_from_base;
        let bounded = |found: Vector3<f64>, limit: f64| heading_from_base * (found * (limit / found.norm().max(limit)));
        self.memory.forces.force = bounded(force, self.limit_n);
        self.memory.forces.moment = bounded(moment, self.limit_n * LIMIT_ARM_M);
        self.memory.forces.feet = feet.map(|foot| bounded(foot, self.limit_n));
    }
}

/// Refuses readings that are not finite.
fn check(reading: &ForceReading, dt_s: f64) -> Result<(), SensorFault> {
    super::check(Some(&reading.imu), Some(&reading.encoders), dt_s)?;
    finite(&reading.torques, |joint| format!("torque of {}", joint_name(joint)))?;
    finite(reading.world_from_base.coords.as_slice(), |index| format!("orientation {}", ["x", "y", "z", "w"][index]))
}

/// Returns the upward unit normal of the plane that fits lines of this sum of v vᵀ best; straight up if that plane is steep.
fn ground_normal(lines: &Matrix3<f64>) -> Vector3<f64> {
    let level = Matrix3::from_diagonal(&Vector3::new(LEVEL_M2, LEVEL_M2, 0.0));
    let eigen = SymmetricEigen::new(lines + level);
    let normal = eigen.eigenvectors.column(eigen.eigenvalues.imin());
    let upward = normal * normal.z.signum();
    if upward.z > STEEPEST_RAD.cos() { upward } else { Vector3::z() }
}

fn vector(rows: &[f64], index: usize) -> Vector3<f64> {
    Vector3::from_column_slice(&rows[3 * index..][..3])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::kinematics;

    const DT_S: f64 = 1.0 / 240.0;

    fn still(robot: &Robot) -> ForceReading {
        ForceReading {
            imu: ImuReading { gyro: Vector3::zeros(), specific_force: Vector3::new(0.0, 0.0, GRAVITY_M_S2) },
            encoders: EncoderReading { angles: robot.nominal_pose, rates: [0.0; JOINTS] },
            torques: [0.0; JOINTS],
            world_from_base: UnitQuaternion::from_euler_angles(0.0, 0.0, 2.0),
        }
    }

    /// The forces of a steady state.
    fn steady(robot: &Robot, reading: &ForceReading) -> ExternalForces {
        let mut observer = ForceObserver::new(robot).unwrap();
        assert_eq!(observer.update(reading, DT_S).unwrap().doubt, Some(Doubt::Starting));
        *observer.update(reading, DT_S).unwrap()
    }

    #[test]
    fn normal_of_the_ground_follows_lines_between_feet() {
        let sum =
            |lines: &[[f64; 3]]| lines.iter().map(|&line| Vector3::from(line)).map(|it| it * it.transpose()).sum();
        assert_eq!(ground_normal(&Matrix3::zeros()), Vector3::z());
        // Both diagonals of a stance of 0.4 m by 0.3 m on ground that rises by a tenth along x.
        let normal = ground_normal(&sum(&[[0.4, 0.3, 0.04], [0.4, -0.3, 0.04]]));
        assert!((normal - Vector3::new(-0.1, 0.0, 1.0).normalize()).norm() < 1e-3, "{normal}");
        // One diagonal does not determine the slope across it: level there.
        let normal = ground_normal(&sum(&[[0.4, 0.0, 0.04]]));
        assert!((normal - Vector3::new(-0.1, 0.0, 1.0).normalize()).norm() < 1e-3, "{normal}");
        // A wall.
        assert_eq!(ground_normal(&sum(&[[0.0, 0.3, 0.0], [0.1, 0.0, 0.4]])), Vector3::z());
    }

    #[test]
    fn free_fall_feels_no_force() {
        for robot in ["go1", "go2"].map(|name| Robot::load(name).unwrap()) {
            let mut reading = still(&robot);
            reading.imu.specific_force.z = 0.0;
            let forces = steady(&robot, &reading);
            let all = forces.feet.iter().chain([&forces.force, &forces.moment]);
            assert!(all.into_iter().all(|force| force.norm() < 1e-9) && forces.doubt.is_none(), "{forces:?}");
        }
    }

    #[test]
    fn pull_is_what_feet_and_weight_leave() {
        let robot = Robot::load("go1").unwrap();
        let mut reading = still(&robot);
        let total = |forces: &ExternalForces| forces.force + forces.feet.iter().sum::<Vector3<f64>>();
        let hanging = steady(&robot, &reading);
        // A robot at rest is held by its weight, 13.100448 kg · 9.81 m/s², whatever its motors do.
        assert!((total(&hanging) - Vector3::z() * 128.515_395).norm() < 1e-4, "{}", total(&hanging));
        reading.torques[5] = 6.0;
        let pressing = steady(&robot, &reading);
        let change = pressing.feet[1] - hanging.feet[1];
        assert!((total(&pressing) - total(&hanging)).norm() < 1e-9);
        assert!((pressing.force - hanging.force + change).norm() < 1e-9 && pressing.feet[3] == hanging.feet[3]);
        // Virtual work: only turning the knee against the 6 N m moves the foot's lowest point along the force.
        for (part, work) in [0.0, 0.0, -6.0].into_iter().enumerate() {
            let mut rates = [0.0; JOINTS];
            rates[3 + part] = 1.0;
            let foot = kinematics::feet(&robot.legs, &robot.nominal_pose, &rates)[1];
            let moves = foot.velocity + foot.spin.cross(&(-robot.legs[1].foot_radius_m * Vector3::z()));
            assert!((moves.dot(&change) - work).abs() < 1e-9, "{part}: {}", moves.dot(&change));
        }
    }

    #[test]
    fn a_step_of_force_arrives_with_the_time_constant() {
        let robot = Robot::load("go1").unwrap();
        let (mut observer, mut low) = (ForceObserver::new(&robot).unwrap(), ExternalForces::default());
        let mut reading = still(&robot);
        reading.imu.specific_force = Vector3::x();
        (0..25).for_each(|_| low.follow(observer.update(&reading, DT_S).unwrap(), DT_S));
        // 24 steps are 0.1 s. Forward as the trunk heads, not as the world.
        let expected = robot.mass_kg * (1.0 - (-1.0_f64).exp());
        let total = low.force + low.feet.iter().sum::<Vector3<f64>>();
        assert!((total - expected * Vector3::x()).norm() < 1e-9, "{total}");
        reading.imu.specific_force.x = 1e6;
        let force = observer.update(&reading, DT_S).unwrap().force;
        let limit = LIMIT_WEIGHTS * robot.mass_kg * GRAVITY_M_S2;
        assert!(force.norm() <= 1.000_001 * limit && force.x > 0.99 * limit, "{force}");
    }

    #[test]
    fn bad_reading_is_named_and_leaves_forces() {
        let robot = Robot::load("go1").unwrap();
        let (mut observer, good) = (ForceObserver::new(&robot).unwrap(), still(&robot));
        (0..9).for_each(|_| drop(observer.update(&good, DT_S)));
        let before = observer.memory.forces;
        let (mut torque, mut turn) = (good, good);
        torque.torques[4] = f64::NAN;
        turn.world_from_base.as_mut_unchecked().coords.x = f64::INFINITY;
        for (bad, words) in [(torque, "torque of FL_thigh reads NaN"), (turn, "orientation x reads inf")] {
            let fault = observer.update(&bad, DT_S).unwrap_err().to_string();
            assert!(fault.contains(words), "{fault}");
            assert_eq!(observer.memory.forces, ExternalForces { doubt: Some(Doubt::Refused), ..before });
            assert_eq!(observer.update(&good, DT_S).unwrap().doubt, Some(Doubt::Starting));
        }
        assert_eq!(observer.update(&good, DT_S).unwrap().doubt, before.doubt);
        assert!(observer.update(&good, 0.0).is_err());
    }

    #[test]
    fn legs_that_cannot_be_solved_leave_forces() {
        let robot = Robot::load("go1").unwrap();
        let mut reading = still(&robot);
        reading.encoders.angles[5] = robot.joint_limits[5][1];
        let doubted = |doubt| ExternalForces { doubt: Some(doubt), ..Default::default() };
        assert_eq!(steady(&robot, &reading), doubted(Doubt::JointLimit(5)));
        reading.encoders = EncoderReading { angles: robot.nominal_pose, rates: [1e200; JOINTS] };
        assert_eq!(steady(&robot, &reading), doubted(Doubt::Overflow));
        reading.encoders.rates = [0.0; JOINTS];
        // A straight knee.
        let mut robot = Robot::clone(&robot);
        robot.joint_limits = [[-9.0, 9.0]; JOINTS];
        reading.encoders.angles[5] = -0.01;
        assert_eq!(steady(&robot, &reading), doubted(Doubt::Singular(1)));
    }
}
