/*! Robots as data: all that depends on which quadruped it is, read from its MJCF.

Start with [`Robot`], then [`Joints`] (the order of joints) and [`RobotState`]; [`kinematics`] computes foot positions.
A robot is a free-floating trunk with four legs of three hinges. The Go1 and the Go2 ship (`models/`); any other one is
an MJCF or URDF file, or a YAML description of one, converted by `import`. Scenes include [`Robot::mjcf`], which has Supple's
names for trunk, joints, feet and motors, whatever the file called them.
*/

mod describe;
mod error;
mod extent;
mod import;
mod inertia;
pub mod kinematics;
mod legs;
mod state;

use std::path::{Path, PathBuf};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use std::time::SystemTime;

use nalgebra::Vector3;

pub use describe::joint_table;
use error::RobotError;
pub use extent::Extent;
use import::Imported;
pub use import::isolate_imports;
pub(crate) use import::recognise;
pub use inertia::least_inertia;
use kinematics::bent_pose;
pub use kinematics::{Foot, FootSphere, Leg};
use legs::sole_name;
pub use legs::{
    JOINTS, Joints, LEGS, PARTS, joint_name, joint_names, joint_target, of_leg, opposite, same_in_every_leg,
};
pub use state::{FootState, Foothold, GRAVITY_M_S2, RobotState};

use crate::mujoco::{Model, Object};
use crate::util::files::{self, FileError};

/// Name and MJCF of the robots inside the program.
const SHIPPED: &[(&str, &str)] =
    &[("go1", include_str!("../../models/go1.xml")), ("go2", include_str!("../../models/go2.xml"))];

/// Name of the site at the trunk's centre of mass, to which ropes are tied.
pub const HARNESS: &str = "harness";

/// Name of the file type in error messages.
const ROBOT: &str = "robot";

/// The losses of every joint, in addition to the controller's `K_d`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Losses {
    /// Dry friction of a joint [N·m].
    pub friction_n_m: f64,
    /// Viscous damping [N·m·s/rad].
    pub damping_n_m_s_per_rad: f64,
}

/// Joint losses that replace those of a policy's configuration, to test all policies alike.
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

/// A quadruped: masses, joint limits, leg geometry and the MJCF document that scenes include.
///
/// ```
/// use supple::robot::{Robot, joint_name};
///
/// let robot = Robot::load("go1")?; // "go1", "go2", or the path of an MJCF or YAML file
/// assert_eq!(joint_name(2), "FR_calf"); // legs FR, FL, RR, RL; joints hip, thigh, calf
/// let [low, high] = robot.joint_limits[2]; // [rad]
/// assert!(low < robot.nominal_pose[2] && robot.nominal_pose[2] < high);
/// let height_m = robot.standing_height_m(&robot.nominal_pose);
/// assert!((0.2..0.4).contains(&height_m));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, PartialEq)]
pub struct Robot {
    /// The name it was loaded by: `go1`, or the path of its file.
    pub name: String,
    mjcf: String,
    sha256: String,
    /// The changes made to the file and the parts left out, one on a line.
    pub report: Vec<String>,
    /// Ranges of the joints (low, high) \[rad\]; infinite for a joint without limits.
    pub joint_limits: [[f64; 2]; JOINTS],
    /// Largest torques of the motors [N·m].
    pub torque_limits: Joints,
    /// Losses in the joints; zero unless a configuration sets them.
    pub losses: Losses,
    /// Starting configuration: the trunk's position \[m\] and quaternion, then the joint angles \[rad\], in the model's
    /// order.
    pub stand: Vec<f64>,
    /// Joint angles of the nominal stance, the targets at action zero \[rad\].
    pub nominal_pose: Joints,
    /// Geometry of the legs, in the order of [`LEGS`].
    pub legs: [Leg; 4],
    /// Position of the IMU, base frame \[m\]: the site `imu`, or the trunk's origin.
    pub imu_in_base: Vector3<f64>,
    /// Mass of all parts \[kg\].
    pub mass_kg: f64,
    /// Mass of the trunk alone \[kg\].
    pub trunk_mass_kg: f64,
    /// Distances from the trunk's origin to its ends \[m\].
    pub trunk: Extent,
    /// Base height below which the robot counts as fallen, if its description states one \[m\].
    pub fall_height_m: Option<f64>,
    /// True if a shank on the ground is no fall: the case for imported robots, whose shank may reach down into the
    /// foot, as the A1's does.
    pub shanks_may_touch: bool,
    /// Names of the geometries that can touch the ground.
    pub colliding: Vec<String>,
    /// Names that its file gives the joints, in Supple's order.
    pub joints_in_file: [String; JOINTS],
}

/// Returns the range of a joint; infinite if it has no limits.
fn limits(model: &Model, joint: usize) -> [f64; 2] {
    if model.joint_is_limited(joint) { model.joint_range(joint) } else { [f64::NEG_INFINITY, f64::INFINITY] }
}

static SHIPPED_ROBOTS: LazyLock<Vec<Result<Arc<Robot>, FileError>>> = LazyLock::new(|| {
    let robot = |(name, mjcf): &(&str, &str)| {
        let sha256 = files::sha256(&[mjcf.as_bytes()]);
        let (mjcf, report) = ((*mjcf).to_owned(), Vec::new());
        let joints = joint_names().map(|name| format!("{name}_joint"));
        let assets = Vec::new();
        let ours = Imported { mjcf, report, has_pose: true, fall_height_m: None, sha256, joints, assets };
        Robot::new(name, ours).map(Arc::new)
    };
    SHIPPED.iter().map(robot).collect()
});

/// A robot that this process has imported.
struct Known {
    /// Name and text of its files.
    key: [String; 2],
    /// Meshes and textures of this robot, with their versions when it was imported.
    assets: Vec<(Version, PathBuf)>,
    robot: Arc<Robot>,
}

/// Time of the last change of a file, and its length \[bytes\]; `None` if it is unknown. A hash of its content would slow down every trial,
/// as each loads its robot.
type Version = Option<(SystemTime, u64)>;

fn version(path: &Path) -> Version {
    let metadata = path.metadata().ok()?;
    Some((metadata.modified().ok()?, metadata.len()))
}

static IMPORTED_ROBOTS: Mutex<Vec<Known>> = Mutex::new(Vec::new());

impl Robot {
    /// Loads a shipped robot by name, or a robot from an MJCF or URDF file or a YAML description of one.
    ///
    /// # Errors
    /// The file is missing or unreadable, or its robot is not a quadruped of this kind; the error says what does not
    /// fit.
    pub fn load(name: &str) -> Result<Arc<Self>, FileError> {
        if let Some(index) = SHIPPED.iter().position(|(shipped, _)| *shipped == name) {
            return SHIPPED_ROBOTS[index].clone();
        }
        let path = Path::new(name);
        let fail = FileError::of(ROBOT, path);
        if !path.exists() {
            let missing = FileError::of(ROBOT, path);
            return Err(missing("there is no such file: put it there, or name another robot"));
        }
        let source = import::Source::read(path).map_err(fail)?;
        let key = [name.to_owned(), source.text()];
        // Held during an import, so that another thread that needs the same robot waits for it.
        let mut known = IMPORTED_ROBOTS.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(at) = known.iter().position(|known| known.key == key) {
            let Known { assets, robot, .. } = &known[at];
            // Meshes and textures are not in the text, and may have changed since.
            if assets.iter().all(|(seen, path)| version(path) == *seen) {
                return Ok(Arc::clone(robot));
            }
            known.swap_remove(at);
        }
        let mut imported = import::import(&source, path).map_err(fail)?;
        let assets = std::mem::take(&mut imported.assets);
        let versioned = |path: PathBuf| (version(&path), path);
        let assets = assets.into_iter().map(versioned).collect();
        let robot = Arc::new(Self::new(name, imported)?);
        known.push(Known { key, assets, robot: Arc::clone(&robot) });
        Ok(robot)
    }

    /// Bends the knees of a robot whose file gives no pose and that does not stand without one. `places` are the indices of the
    /// joint angles in `stand`.
    fn bend_knees(&mut self, places: &[usize; JOINTS]) {
        let Some(bent) = bent_pose(&self.legs, &self.nominal_pose, &self.joint_limits) else { return };
        self.nominal_pose = bent;
        self.stand[2] = self.standing_height_m(&self.nominal_pose);
        for (place, angle) in places.iter().zip(self.nominal_pose) {
            self.stand[*place] = angle;
        }
        self.report.push(format!(
            "pose: its file states none, and its legs are straight or folded; knees bent to the rear, base at {:.3} m \
             (nominal_pose_rad in a YAML file chooses another)",
            self.stand[2]
        ));
    }

    /// Returns the same robot with other joint losses.
    pub fn with_losses(self: Arc<Self>, losses: Losses) -> Arc<Self> {
        if self.losses == losses { self } else { Arc::new(Robot { losses, ..Robot::clone(&self) }) }
    }

    /// Returns true if a robot of this name ships.
    pub fn ships(name: &str) -> bool {
        SHIPPED.iter().any(|(shipped, _)| *shipped == name)
    }

    /// Reads all properties from an MJCF document with Supple's names.
    fn new(name: &str, imported: Imported) -> Result<Self, FileError> {
        let Imported { mjcf, report, has_pose, fall_height_m, sha256, joints, .. } = imported;
        let path = Path::new(name);
        let (fail, words) = (FileError::of(ROBOT, path), FileError::of(ROBOT, path));
        let model = Model::from_xml(&[("robot.xml", &mjcf)]).map_err(words)?;
        let trunk = model.id(Object::Body, "trunk").map_err(words)?;
        let ids: [usize; JOINTS] = model.ids(Object::Joint, |k| format!("{}_joint", joint_name(k))).map_err(words)?;
        let (joint_limits, places) = (ids.map(|id| limits(&model, id)), ids.map(|id| model.joint_position_index(id)));
        let motors: [usize; JOINTS] = model.ids(Object::Actuator, joint_name).map_err(words)?;
        let torque_limits = motors.map(|motor| model.control_range(motor)[1]);
        let stand = model.numeric("stand_qpos").map_err(words)?.to_vec();
        if stand.len() != model.nq() {
            return Err(fail(RobotError::Count { what: "stand_qpos", found: stand.len(), expected: model.nq() }));
        }
        let nominal_pose = match model.numeric("nominal_pose") {
            Ok(pose) => Joints::try_from(pose).map_err(|_| fail(RobotError::joints("nominal_pose", pose.len())))?,
            Err(_) => places.map(|place| stand[place]),
        };
        let legs = Leg::all(&model).map_err(fail)?;
        let imu = model.id(Object::Site, "imu").ok().filter(|site| model.site_body(*site) == trunk);
        let collides = |geom: &usize| model.geom_contact(*geom).collides();
        let colliding = (0..model.count(Object::Geom)).filter(collides);
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
            trunk_mass_kg: model.body_mass()[trunk],
            trunk: Extent::of(&model, trunk),
            fall_height_m,
            shanks_may_touch: model.numeric("shanks_may_touch").is_ok_and(|numbers| numbers == [1.0]),
            colliding: colliding.map(|geom| model.name(Object::Geom, geom).to_owned()).collect(),
            joints_in_file: joints,
            mjcf,
            sha256,
        };
        if !has_pose {
            robot.bend_knees(&places);
        }
        Ok(robot)
    }

    methods! {
        /// Returns the MJCF document that scenes include.
        fn mjcf(&self) -> &str = &self.mjcf;
        /// Returns the SHA-256 of the robot's files, meshes and description included, which identifies it.
        fn sha256(&self) -> &str = &self.sha256;
        /// Returns the height of the trunk's origin above the ground when it stands level on its lowest foot \[m\].
        fn standing_height_m(&self, pose: &Joints) -> f64 = kinematics::standing_height_m(&self.legs, pose);
    }

    /// Describes the values read from the robot's file and the changes made to it.
    pub fn description(&self) -> String {
        let height = self.standing_height_m(&self.nominal_pose);
        let mut text = format!("{}: {:.3} kg, trunk {height:.3} m above the ground\n", self.name, self.mass_kg);
        for line in &self.report {
            text.push_str(&format!("  {line}\n"));
        }
        text.push('\n');
        text.push_str(&joint_table(&self.nominal_pose, &self.joint_limits, &self.torque_limits));
        text
    }

    /// Mirrors a joint between left and right: returns the joint that takes over its angle, and the sign. The legs of
    /// both sides are assumed to be built alike.
    pub fn mirrored(&self, joint: usize) -> (usize, f64) {
        let axis = |joint: usize| self.legs[joint / PARTS.len()].axes()[joint % PARTS.len()];
        // A reflection keeps the part of a turn about its normal, which points to the left, and reverses the others.
        let image = Vector3::new(-axis(joint).x, axis(joint).y, -axis(joint).z);
        let other = opposite(joint);
        (other, image.dot(&axis(other)).signum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_is_read_again_once_a_mesh_has_changed() {
        let folder = tempfile::tempdir().unwrap();
        let fixtures = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/robot");
        std::fs::create_dir(folder.path().join("assets")).unwrap();
        for file in ["quadruped.xml", "assets/trunk.stl", "assets/small.stl"] {
            std::fs::copy(fixtures.join(file), folder.path().join(file)).unwrap();
        }
        let path = folder.path().join("quadruped.xml");
        let load = || Robot::load(path.to_str().unwrap()).unwrap();
        let first = load();
        assert!(Arc::ptr_eq(&first, &load()));
        // Another mesh of the same size.
        std::fs::copy(fixtures.join("assets/trunk.stl"), folder.path().join("assets/small.stl")).unwrap();
        let second = load();
        assert_ne!(first.sha256(), second.sha256());
        assert!(Arc::ptr_eq(&second, &load()));
    }
}
