/*! A quadruped as data: everything that depends on which robot it is, read from its MJCF.

A robot is a trunk that floats freely and four legs of three hinges. The Go1 ships (`models/go1.xml`); any other one is an
MJCF file, or a YAML file that names one and says what its parts are called, made to fit by `import`. Scenes include
[`Robot::mjcf`], which has our names for trunk, joints, feet and motors, whatever the file called them.
*/

mod describe;
mod extent;
mod import;
pub mod kinematics;
mod legs;
mod state;

use std::sync::{Arc, LazyLock, Mutex, PoisonError};

use nalgebra::Vector3;

pub use describe::joint_table;
pub use extent::Extent;
use import::Imported;
pub use import::isolate_imports;
pub use kinematics::{Foot, Leg};
pub use legs::{
    JOINTS, Joints, LEGS, PARTS, joint_name, joint_names, joint_target, of_leg, opposite, same_in_every_leg,
};
pub use state::{FootState, Foothold, GRAVITY_M_S2, RobotState};

use crate::mujoco::{Kind, Model};
use crate::util::files::{self, FileError};
use crate::util::numbers::maximum;
use crate::util::paths;

/// The robots inside the program: name and MJCF.
const SHIPPED: &[(&str, &str)] =
    &[("go1", include_str!("../../models/go1.xml")), ("go2", include_str!("../../models/go2.xml"))];

/// Name of the site at the trunk's centre of mass, to which ropes are tied.
pub const HARNESS: &str = "harness";

/// The name of the file's kind in errors.
const ROBOT: &str = "robot";

/// The losses of every joint, in addition to the controller's `K_d`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Losses {
    /// Dry friction [N·m].
    pub friction_n_m: f64,
    /// Viscous damping [N·m·s/rad].
    pub damping_n_m_s_per_rad: f64,
}

/// Joints to try all policies with, whatever they were trained with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum JointLosses {
    /// No losses
    Ideal,
    /// Dry friction of 0.2 N m and damping of 0.5 N m s/rad, as public models of such robots have them
    Realistic,
}

impl From<JointLosses> for Losses {
    fn from(joints: JointLosses) -> Self {
        match joints {
            JointLosses::Ideal => Losses::default(),
            JointLosses::Realistic => Losses { friction_n_m: 0.2, damping_n_m_s_per_rad: 0.5 },
        }
    }
}

/// A quadruped.
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// As it was asked for: `go1`, or the path of its file.
    pub name: String,
    mjcf: String,
    sha256: String,
    /// The changes made to the file and the parts left out, one on a line.
    pub report: Vec<String>,
    /// Ranges of the joints \[rad\].
    pub joint_limits: [[f64; 2]; JOINTS],
    /// Largest torques of the motors [N·m].
    pub torque_limits: Joints,
    /// Losses in the joints: none, unless a configuration says so.
    pub losses: Losses,
    /// What the robot starts from: the trunk's position and quaternion, then the joint angles in the model's order.
    pub stand: Vec<f64>,
    /// Joint angles that the robot stands on, the middle of what a policy does \[rad\].
    pub nominal_pose: Joints,
    /// Geometry of the legs, in the order of [`LEGS`].
    pub legs: [Leg; 4],
    /// Where the IMU is, base frame \[m\]: the site `imu`, or the trunk's origin.
    pub imu_in_base: Vector3<f64>,
    /// Mass of all parts \[kg\].
    pub mass_kg: f64,
    /// How far the trunk reaches from its origin \[m\].
    pub trunk: Extent,
    /// Base height below which it counts as fallen, if its description says so \[m\].
    pub fall_height_m: Option<f64>,
    /// Whether it is no fall that a shank touches the ground: so of robots from elsewhere, where its shape may reach down into
    /// the foot, as the A1's does.
    pub shanks_may_touch: bool,
    /// Names of the geometries that can touch the ground.
    pub colliding: Vec<String>,
}

static SHIPPED_ROBOTS: LazyLock<Vec<Result<Arc<Robot>, FileError>>> = LazyLock::new(|| {
    let robot = |(name, mjcf): &(&str, &str)| {
        let sha256 = files::sha256(&[mjcf.as_bytes()]);
        let (mjcf, report) = ((*mjcf).to_owned(), Vec::new());
        let ours = Imported { mjcf, report, has_pose: true, fall_height_m: None, sha256 };
        Robot::new(name, ours).map(Arc::new)
    };
    SHIPPED.iter().map(robot).collect()
});

/// Robots from elsewhere that this process has read: name, what their files say.
static IMPORTED_ROBOTS: Mutex<Vec<([String; 2], Arc<Robot>)>> = Mutex::new(Vec::new());

impl Robot {
    /// A robot that ships, by name, or that of an MJCF file, or of a YAML file about one.
    ///
    /// # Errors
    /// [`FileError`] that says what does not fit.
    pub fn load(name: &str) -> Result<Arc<Self>, FileError> {
        if let Some(index) = SHIPPED.iter().position(|(shipped, _)| *shipped == name) {
            return SHIPPED_ROBOTS[index].clone();
        }
        let path = &paths::as_path(name);
        let fail = FileError::of(ROBOT, path);
        if !path.exists() {
            return Err(fail("there is no such file: put it there, or name another robot".to_owned()));
        }
        let source = import::Source::read(path).map_err(fail)?;
        let key = [name.to_owned(), source.text()];
        // Held while one is imported: who asks for the same one at the same time waits for it.
        let mut known = IMPORTED_ROBOTS.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, robot)) = known.iter().find(|(known, _)| *known == key) {
            return Ok(Arc::clone(robot));
        }
        let robot = Arc::new(Self::new(name, import::import(&source, path).map_err(fail)?)?);
        known.push((key, Arc::clone(&robot)));
        Ok(robot)
    }

    /// Bends knees that the file leaves straight. `places` are the indices of the joint angles in `stand`.
    fn bend_knees(&mut self, places: &[usize; JOINTS]) {
        let straight = |leg: usize| self.legs[leg].is_straight(of_leg(&self.nominal_pose, leg));
        if !(0..LEGS.len()).all(straight) {
            return;
        }
        // To a milliradian: it will be read.
        let bent = |joint: usize| self.legs[joint / PARTS.len()].bent()[joint % PARTS.len()];
        self.nominal_pose = std::array::from_fn(|joint| (1e3 * bent(joint)).round() / 1e3);
        self.stand[2] = self.standing_height_m(&self.nominal_pose);
        for (place, angle) in places.iter().zip(self.nominal_pose) {
            self.stand[*place] = angle;
        }
        self.report.push(format!(
            "pose: its file says none, and its legs are straight; knees bent to the rear, base at {:.3} m (nominal_pose_rad in a \
             YAML file chooses another)",
            self.stand[2]
        ));
    }

    /// The same robot with other losses in its joints.
    pub fn with_losses(self: Arc<Self>, losses: Losses) -> Arc<Self> {
        if self.losses == losses { self } else { Arc::new(Robot { losses, ..Robot::clone(&self) }) }
    }

    /// Returns true if a robot of this name ships.
    pub fn ships(name: &str) -> bool {
        SHIPPED.iter().any(|(shipped, _)| *shipped == name)
    }

    /// Reads everything from an MJCF document that has our names.
    fn new(name: &str, imported: Imported) -> Result<Self, FileError> {
        let Imported { mjcf, report, has_pose, fall_height_m, sha256 } = imported;
        let path = &paths::as_path(name);
        let (fail, words) = (FileError::of(ROBOT, path), FileError::of(ROBOT, path));
        let model = Model::from_xml(&[("robot.xml", &mjcf)]).map_err(words)?;
        let trunk = model.id(Kind::Body, "trunk").map_err(words)?;
        let (mut joint_limits, mut torque_limits, mut places) = ([[0.0; 2]; JOINTS], [0.0; JOINTS], [0; JOINTS]);
        for joint in 0..JOINTS {
            let id = model.id(Kind::Joint, &format!("{}_joint", joint_name(joint))).map_err(words)?;
            (joint_limits[joint], places[joint]) = (model.joint_range(id), model.joint_position_index(id));
            let motor = model.id(Kind::Actuator, &joint_name(joint)).map_err(words)?;
            torque_limits[joint] = model.control_range(motor)[1];
        }
        let stand = model.numeric("stand_qpos").map_err(words)?.to_vec();
        if stand.len() != model.nq() {
            return Err(fail(format!("its stand_qpos has {} numbers, expected {}", stand.len(), model.nq())));
        }
        let nominal_pose = match model.numeric("nominal_pose") {
            Ok(pose) => {
                Joints::try_from(pose).map_err(|_| fail("its nominal_pose has not twelve angles".to_owned()))?
            }
            Err(_) => places.map(|place| stand[place]),
        };
        let legs = (0..LEGS.len()).map(|leg| Leg::of(&model, leg)).collect::<Result<Vec<_>, _>>().map_err(fail)?;
        let legs = <[Leg; 4]>::try_from(legs).map_err(|_| fail("it has not four legs".to_owned()))?;
        let imu = model.id(Kind::Site, "imu").ok().filter(|site| model.site_body(*site) == trunk);
        let collides = |geom: &usize| model.geom_contact(*geom).collides();
        let colliding = (0..model.count(Kind::Geom)).filter(collides);
        let mut robot = Robot {
            name: name.to_owned(),
            report,
            joint_limits,
            torque_limits,
            losses: Losses::default(),
            stand,
            nominal_pose,
            legs,
            imu_in_base: imu.map_or_else(Vector3::zeros, |site| model.site_position(site).into()),
            mass_kg: model.body_mass().iter().sum(),
            trunk: Extent::of(&model, trunk),
            fall_height_m,
            shanks_may_touch: model.numeric("shanks_may_touch").is_ok_and(|numbers| numbers == [1.0]),
            colliding: colliding.map(|geom| model.name(Kind::Geom, geom).to_owned()).collect(),
            mjcf,
            sha256,
        };
        if !has_pose {
            robot.bend_knees(&places);
        }
        Ok(robot)
    }

    /// The MJCF document that scenes include.
    pub fn mjcf(&self) -> &str {
        &self.mjcf
    }

    /// Identity of the robot: SHA-256 of its files, meshes and description included, wherever they lie.
    pub fn sha256(&self) -> &str {
        &self.sha256
    }

    /// How far the trunk's origin is above the ground on the lowest foot, the trunk level \[m\].
    pub fn standing_height_m(&self, pose: &Joints) -> f64 {
        let depth = |leg: usize| self.legs[leg].foot_radius_m - self.legs[leg].foot_position(of_leg(pose, leg)).z;
        (0..LEGS.len()).map(depth).fold(f64::NEG_INFINITY, maximum)
    }

    /// What becomes of a joint's angle in a mirror between the left and the right legs: the joint that takes it over, and
    /// the sign. Legs of one side are taken to be built like those of the other.
    pub fn mirrored(&self, joint: usize) -> (usize, f64) {
        let axis = |joint: usize| self.legs[joint / PARTS.len()].axes()[joint % PARTS.len()];
        // A reflection keeps the part of a turn about its normal, which points to the left, and reverses the others.
        let image = Vector3::new(-axis(joint).x, axis(joint).y, -axis(joint).z);
        let other = opposite(joint);
        (other, image.dot(&axis(other)).signum())
    }
}
