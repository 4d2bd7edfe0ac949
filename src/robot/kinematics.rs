/*! Forward kinematics of the feet, from joint angles and rates: any leg of three hinges in closed form.

A leg is read from the model at zero angles, all in the base frame: the hip's position, the vectors from hip to thigh joint, from there to
the knee, from there to the foot, and the axes of the joints. Thigh and calf turn about parallel axes, so that their angles add. `golden.c`
prints MuJoCo's results for the Go1's legs, and a test compares.
*/

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::error::RobotError;
use super::legs::{JOINTS, Joints, LEGS, PARTS, of_leg, sole_name};
use crate::mujoco::{self, Data, Model, Object};
use crate::util::numbers::maximum;

/// Position and motion of a foot relative to the trunk.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Foot {
    /// Centre of the foot's sphere, base frame \[m\].
    pub position: Vector3<f64>,
    /// Rate of change of `position`, base frame [m/s].
    pub velocity: Vector3<f64>,
    /// Angular velocity of the calf, and with it of the sphere, relative to the trunk, base frame [rad/s].
    pub spin: Vector3<f64>,
}

/// The sphere that stands for a foot: the geometry of the foot, or, if that is no sphere, a site where it touches the ground.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FootSphere {
    /// Id of the body that it is fixed to.
    pub body: usize,
    /// Centre in the frame of its body \[m\].
    pub position: [f64; 3],
    /// Radius \[m\].
    pub radius_m: f64,
    /// The geometry, or the site.
    centre: (Object, usize),
}

impl FootSphere {
    /// Reads the foot of leg `leg` of a model with our names.
    ///
    /// # Errors
    /// The model has no such foot; the error lists the names that it has.
    pub fn new(model: &Model, leg: usize) -> mujoco::Result<Self> {
        if let Ok(site) = model.id(Object::Site, &sole_name(leg)) {
            let (body, position) = (model.site_body(site), model.site_position(site));
            let radius_m = model.site_size(site)[0];
            return Ok(FootSphere { body, position, radius_m, centre: (Object::Site, site) });
        }
        let geom = model.id(Object::Geom, &format!("{}_foot", LEGS[leg]))?;
        let foot = model.geom(geom);
        let centre = (Object::Geom, geom);
        Ok(FootSphere { body: foot.body, position: foot.position, radius_m: foot.size[0], centre })
    }

    /// Returns the centre after the last [`Data::step1`], world frame \[m\].
    pub fn centre(&self, data: &Data) -> [f64; 3] {
        let (kind, id) = self.centre;
        let all = if kind == Object::Site { data.site_positions() } else { data.geom_positions() };
        std::array::from_fn(|axis| all[3 * id + axis])
    }

    /// Returns the velocity of the centre, world axes [m/s].
    pub fn velocity(&self, data: &Data) -> [f64; 3] {
        data.velocity(self.centre.0, self.centre.1)
    }
}

/// Geometry of a leg at zero angles, base frame \[m\].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leg {
    /// Joint angles in that pose, as the model counts them \[rad\].
    zero: [f64; 3],
    /// Axes of hip and thigh, unit vectors.
    hip_axis: Vector3<f64>,
    thigh_axis: Vector3<f64>,
    /// 1 if the calf turns about the thigh's axis, −1 if about the opposite one.
    calf_sign: f64,
    /// The vector from the trunk's origin to the hip joint.
    hip: Vector3<f64>,
    /// The vector from the hip joint to the thigh joint.
    thigh: Vector3<f64>,
    /// The vector from the thigh joint to the knee.
    knee: Vector3<f64>,
    /// The vector from the knee to the foot's centre.
    foot: Vector3<f64>,
    /// Radius of the sphere that stands for the foot \[m\].
    pub foot_radius_m: f64,
}

/// Knee bend below which a leg counts as straight \[rad\].
const STRAIGHT: f64 = 0.4;

/// Knee bend of the Go1 in its nominal pose \[rad\].
const BENT: f64 = 1.44;

/// Part of the height with bent knees below which a robot lies rather than stands.
const LYING: f64 = 0.5;

/// Returns a pose with bent knees for a robot whose file gives none, if it does not stand with all joints at zero: its legs are
/// straight, or its trunk is nearly on the ground. The knees are bent as far as the Go1's, or as the joints allow.
pub(super) fn bent_pose(legs: &[Leg; 4], pose: &Joints, limits: &[[f64; 2]; JOINTS]) -> Option<Joints> {
    let straight = (0..LEGS.len()).all(|leg| legs[leg].is_straight(of_leg(pose, leg)));
    let fits = |angles: &[f64], limits: &[[f64; 2]]| {
        angles.iter().zip(limits).all(|(angle, [low, high])| (low..=high).contains(&angle))
    };
    let bent = |part: f64| -> Joints {
        let mut pose = [0.0; JOINTS];
        for (leg, angles) in pose.chunks_exact_mut(PARTS.len()).enumerate() {
            let limits = &limits[PARTS.len() * leg..][..PARTS.len()];
            // Rounded to a milliradian, as people read it.
            let bend = |part: f64| legs[leg].bent(part).map(|angle| (1e3 * angle).round() / 1e3);
            let (back, forward) = (bend(part), bend(-part));
            // Some robots' rear knees point forward.
            let chosen = if !fits(&back, limits) && fits(&forward, limits) { forward } else { back };
            angles.copy_from_slice(&chosen);
        }
        pose
    };
    let part = (10..=20).rev().map(|part| bent(f64::from(part) / 20.0)).find(|pose| fits(pose, limits));
    let best = part.unwrap_or_else(|| bent(1.0));
    let lies = standing_height_m(legs, pose) < LYING * standing_height_m(legs, &best);
    (straight || lies).then_some(best)
}

/// Returns the height of the trunk's origin above the ground when it stands level on its lowest foot \[m\].
pub(super) fn standing_height_m(legs: &[Leg; 4], pose: &Joints) -> f64 {
    let depth = |leg: usize| legs[leg].foot_radius_m - legs[leg].foot_position(of_leg(pose, leg)).z;
    (0..LEGS.len()).map(depth).fold(f64::NEG_INFINITY, maximum)
}

/// Largest angle between axes that count as parallel \[rad\].
const PARALLEL: f64 = 1e-3;

impl Leg {
    /// Reads all legs of a model with our names.
    pub(super) fn all(model: &Model) -> Result<[Self; 4], RobotError> {
        let leg = |leg| Self::of(model, leg);
        Ok([leg(0)?, leg(1)?, leg(2)?, leg(3)?])
    }

    /// Reads leg `leg` of a model with our names.
    pub(super) fn of(model: &Model, leg: usize) -> Result<Self, RobotError> {
        let name = LEGS[leg];
        let trunk = model.id(Object::Body, "trunk")?;
        // Place and orientation of the frame walked so far.
        let (mut place, mut turn) = (Vector3::zeros(), UnitQuaternion::identity());
        let (mut links, mut axes, mut zero) = (Vec::new(), Vec::new(), [0.0; 3]);
        let mut above = trunk;
        for (part, zero) in PARTS.iter().zip(&mut zero) {
            let joint = model.id(Object::Joint, &format!("{name}_{part}_joint"))?;
            walk(model, above, model.joint_body(joint), &mut place, &mut turn);
            above = model.joint_body(joint);
            let anchor = turn * Vector3::from(model.joint_anchor(joint));
            // From the joint before to this one.
            links.push(place + anchor);
            place = -anchor;
            axes.push(turn * Vector3::from(model.joint_axis(joint)));
            *zero = model.rest_positions()[model.joint_position_index(joint)];
        }
        let foot = FootSphere::new(model, leg)?;
        walk(model, above, foot.body, &mut place, &mut turn);
        let along = axes[1].dot(&axes[2]);
        if axes[1].cross(&axes[2]).norm() > PARALLEL {
            return Err(RobotError::Axes(name));
        }
        let (calf_sign, hip, thigh, knee) = (along.signum(), links[0], links[1], links[2]);
        let (foot, foot_radius_m) = (place + turn * Vector3::from(foot.position), foot.radius_m);
        Ok(Leg { zero, hip_axis: axes[0], thigh_axis: axes[1], calf_sign, hip, thigh, knee, foot, foot_radius_m })
    }

    /// Returns the centre of the foot, base frame \[m\], for the leg's hip, thigh and calf angle \[rad\].
    pub fn foot_position(&self, angles: [f64; 3]) -> Vector3<f64> {
        let [hip, ..] = self.turned(angles);
        let (thigh, calf) = self.links(angles);
        self.hip + about(&self.hip_axis, hip, &((thigh + calf) + self.thigh))
    }

    /// Returns the derivative of [`Leg::foot_position`] by the three angles, one column each [m/rad].
    pub fn foot_jacobian(&self, angles: [f64; 3]) -> Matrix3<f64> {
        let [hip, ..] = self.turned(angles);
        let (thigh, calf) = self.links(angles);
        let in_hip = (thigh + calf) + self.thigh;
        // Turning about an axis moves a point by axis × arm; the arms are those from hip, thigh and knee to the foot.
        let columns = [
            self.hip_axis.cross(&in_hip),
            self.thigh_axis.cross(&(thigh + calf)),
            self.thigh_axis.cross(&calf) * self.calf_sign,
        ];
        Matrix3::from_columns(&columns.map(|column| about(&self.hip_axis, hip, &column)))
    }

    /// Returns position and motion of the foot for angles \[rad\] and rates [rad/s] of hip, thigh and calf.
    pub fn foot(&self, angles: [f64; 3], rates: [f64; 3]) -> Foot {
        let spin = self.thigh_axis * (rates[1] + self.calf_sign * rates[2]);
        Foot {
            position: self.foot_position(angles),
            velocity: self.foot_jacobian(angles) * Vector3::from(rates),
            spin: self.hip_axis * rates[0] + about(&self.hip_axis, self.turned(angles)[0], &spin),
        }
    }

    /// Returns true if thigh and calf are nearly in line, seen along the thigh's axis.
    pub(super) fn is_straight(&self, angles: [f64; 3]) -> bool {
        let (thigh, calf) = self.links(angles);
        (self.lean(&thigh) - self.lean(&calf)).abs() < STRAIGHT
    }

    /// Returns the angles \[rad\] of a leg whose knee is bent by `part` of the Go1's bend in its nominal pose: the foot below the
    /// thigh joint, the knee behind both.
    pub(super) fn bent(&self, part: f64) -> [f64; 3] {
        // About an axis that points to the left, what hangs down goes back as its angle grows.
        let bend = self.thigh_axis.y.signum() * BENT * part;
        let calf = self.lean(&self.knee) - self.lean(&self.foot) - bend;
        let to_foot = self.knee + about(&self.thigh_axis, calf, &self.foot);
        [self.zero[0], self.zero[1] - self.lean(&to_foot), self.zero[2] + self.calf_sign * calf]
    }

    /// Returns the angle of a vector about the thigh's axis, counted from straight down \[rad\].
    fn lean(&self, vector: &Vector3<f64>) -> f64 {
        let down = -Vector3::z();
        self.thigh_axis.dot(&down.cross(vector)).atan2(down.dot(vector))
    }

    /// Returns the axes of hip, thigh and calf at zero angles, base frame.
    pub(super) fn axes(&self) -> [Vector3<f64>; 3] {
        [self.hip_axis, self.thigh_axis, self.thigh_axis * self.calf_sign]
    }

    /// Returns the rotation of each joint from the zero pose \[rad\].
    fn turned(&self, angles: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|part| angles[part] - self.zero[part])
    }

    /// Returns the thigh and calf vectors, turned about the thigh's axis \[m\].
    fn links(&self, angles: [f64; 3]) -> (Vector3<f64>, Vector3<f64>) {
        let [_, thigh, calf] = self.turned(angles);
        let turn = |angle, link| about(&self.thigh_axis, angle, link);
        (turn(thigh, &self.knee), turn(thigh + self.calf_sign * calf, &self.foot))
    }
}

/// Returns all feet, in the order of [`LEGS`].
pub fn feet(legs: &[Leg; 4], angles: &Joints, rates: &Joints) -> [Foot; 4] {
    std::array::from_fn(|leg| legs[leg].foot(of_leg(angles, leg), of_leg(rates, leg)))
}

/// Composes the transform from body `from` to body `to` below it, with all joints at zero.
fn walk(model: &Model, from: usize, to: usize, place: &mut Vector3<f64>, turn: &mut UnitQuaternion<f64>) {
    let mut down = Vec::new();
    let mut body = to;
    while body != from && body != 0 {
        down.push(body);
        body = model.body_parent(body);
    }
    for body in down.into_iter().rev() {
        *place += *turn * Vector3::from(model.body_position(body));
        *turn *= model.body_rotation(body);
    }
}

/// Rotates a vector about a unit axis by an angle \[rad\].
fn about(axis: &Vector3<f64>, angle: f64, vector: &Vector3<f64>) -> Vector3<f64> {
    let (sin, cos) = angle.sin_cos();
    let along = axis * axis.dot(vector);
    along + (vector - along) * cos + axis.cross(vector) * sin
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::Robot;

    const ANGLES: Joints = [0.2, 0.7, -1.5, -0.3, 0.9, -1.8, -0.1, 0.5, -1.2, 0.4, 1.1, -2.1];
    const RATES: Joints = [1.5, -2.0, 3.0, -0.5, 4.0, -1.0, 2.0, 0.5, 0.7, -1.0, -3.0, 2.5];

    /// Position, velocity and spin of each foot as printed by `golden.c`.
    const GOLDEN: [[[f64; 3]; 3]; 4] = [
        [
            [0.203678479980, -0.063307593748, -0.320997989489],
            [0.177424242692, 0.566375194087, -0.443553745394],
            [1.500000000000, 0.980066577841, 0.198669330795],
        ],
        [
            [0.188100000000, 0.044921440652, -0.276620304212],
            [-0.926820462692, -0.089003009970, 0.160310865746],
            [-0.500000000000, 2.866009467377, -0.886560619984],
        ],
        [
            [-0.152999272341, -0.161275703447, -0.340102073051],
            [-0.288956205911, 0.668862748407, -0.342087084975],
            [2.000000000000, 1.194004998334, -0.119800099976],
        ],
        [
            [-0.198693847929, 0.202874884730, -0.163835481245],
            [0.347390117166, 0.023032690525, -0.598109674192],
            [-1.000000000000, -0.460530497001, -0.194709171154],
        ],
    ];

    fn legs() -> [Leg; 4] {
        Robot::load("go1").unwrap().legs
    }

    #[test]
    fn a_leg_is_bent_as_the_go1_stands() {
        for leg in Robot::load("go1").unwrap().legs {
            let [hip, thigh, calf] = leg.bent(1.0);
            assert!(hip == 0.0 && (thigh - 0.72).abs() < 1e-12 && (calf + 1.44).abs() < 1e-12, "{thigh} {calf}");
            assert!(leg.is_straight([0.0, 0.5, -0.3]) && !leg.is_straight(leg.bent(1.0)));
        }
    }

    #[test]
    fn feet_are_where_mujoco_has_them() {
        for (foot, golden) in feet(&legs(), &ANGLES, &RATES).iter().zip(GOLDEN) {
            for (ours, theirs) in [foot.position, foot.velocity, foot.spin].iter().zip(golden) {
                assert!((ours - Vector3::from(theirs)).norm() < 1e-11, "{ours} {theirs:?}");
            }
        }
    }

    #[test]
    fn the_jacobian_is_the_derivative_of_the_position() {
        for (index, leg) in legs().iter().enumerate() {
            let angles = of_leg(&ANGLES, index);
            let jacobian = leg.foot_jacobian(angles);
            for joint in 0..3 {
                let moved = |by: f64| {
                    let mut angles = angles;
                    angles[joint] += by;
                    leg.foot_position(angles)
                };
                let difference = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                assert!((difference - jacobian.column(joint)).norm() < 1e-9, "leg {index}, joint {joint}");
            }
        }
    }

    #[test]
    fn a_straight_leg_hangs_down_from_its_thigh_joint() {
        // Left, front: 0.04675 + 0.08 = 0.12675 to the side, 2 · 0.213 = 0.426 below.
        let foot = legs()[1].foot_position([0.0; 3]);
        assert!((foot - Vector3::new(0.1881, 0.12675, -0.426)).norm() < 1e-12);
    }

    #[test]
    fn legs_in_turned_bodies_with_turned_axes_and_other_zeros_are_read_alike() {
        // A leg whose bodies are turned about z by 180° and whose axes point the other way, with a joint angle of 0.3 rad
        // in the pose that the file draws.
        let robot = Robot::load("go1").unwrap();
        let straight = Model::from_xml(&[("robot.xml", robot.mjcf())]).unwrap();
        let turned = robot
            .mjcf()
            .replace(r#""FR_calf" pos="0 0 -0.213">"#, r#""FR_calf" pos="0 0 -0.213" quat="0 0 0 1">"#)
            .replace(
                r#"<joint name="FR_calf_joint" class="go1_calf"/>"#,
                r#"<joint name="FR_calf_joint" class="go1_calf" ref="0.3"/>"#,
            );
        assert_ne!(turned, robot.mjcf());
        let turned = Model::from_xml(&[("robot.xml", &turned)]).unwrap();
        let [straight, turned] = [&straight, &turned].map(|model| Leg::of(model, 0).unwrap());
        // Half a turn about z turns the axis of the calf around.
        let found = turned.foot_position([0.2, 0.7, 0.3 - -1.5]);
        assert!((found - straight.foot_position([0.2, 0.7, -1.5])).norm() < 1e-12, "{found}");
    }
}
