//! Training on any quadruped: robots described by a few numbers, in the style of several makers.

use std::fmt::Write as _;
use std::path::Path;

use supple::config::Config;
use supple::robot::{Losses, Robot, joint_name};
use supple::sim::{Conditions, Scene, Sim};

use crate::support::{complaint, refused, run, small_config_file, success};

/// A quadruped in the style of an ANYmal: joints LF_HAA and so on, legs that are straight at zero angles, 40 kg, servos.
#[derive(Clone)]
struct Robots {
    legs: Vec<&'static str>,
    joints: Vec<&'static str>,
    free: &'static str,
    foot: &'static str,
    shank: &'static str,
    thigh: &'static str,
    assets: &'static str,
    keyframe: &'static str,
}

fn anymal_like() -> Robots {
    Robots {
        legs: vec!["LF", "RF", "LH", "RH"],
        joints: vec!["HAA", "HFE", "KFE"],
        free: "<freejoint/>",
        foot: "<geom type='sphere' size='0.03' pos='0.08 0 -0.32'/>",
        shank: "",
        thigh: "",
        assets: "",
        keyframe: "",
    }
}

impl Robots {
    fn mjcf(&self) -> String {
        let (mut bodies, mut servos) = (String::new(), String::new());
        for leg in &self.legs {
            let x = if leg.ends_with('F') { 0.3 } else { -0.3 };
            let y = if leg.starts_with('L') { 0.1 } else { -0.1 };
            let mut ends = String::new();
            for (index, joint) in self.joints.iter().enumerate() {
                let (place, axis) = match index {
                    0 => (format!("{x} {y} 0"), "1 0 0"),
                    1 => (format!("0 {} 0", 0.6 * y), "0 1 0"),
                    _ => (format!("0 {} -0.3", 0.6 * y), "0 1 0"),
                };
                write!(
                    bodies,
                    "<body pos='{place}'><inertial pos='0 0 -0.1' mass='1.5' diaginertia='0.02 0.02 0.005'/>\
                     <joint name='{leg}_{joint}' axis='{axis}' range='-9 9' armature='0.1'/>"
                )
                .unwrap();
                bodies.push_str(["", self.thigh, self.shank].get(index).unwrap_or(&""));
                ends.push_str("</body>");
                write!(servos, "<position joint='{leg}_{joint}' kp='100' forcerange='-80 80'/>").unwrap();
            }
            bodies.push_str(self.foot);
            bodies.push_str(&ends);
        }
        format!(
            "<mujoco><compiler angle='radian'/><option integrator='implicitfast'/><asset>{}</asset><worldbody><body pos='0 0 1'>{}\
             <inertial pos='0 0 0' mass='22' diaginertia='0.4 1 1'/><geom type='box' size='0.3 0.1 0.1'/>{bodies}</body>\
             </worldbody><actuator>{servos}</actuator>{}</mujoco>",
            self.assets, self.free, self.keyframe
        )
    }

    fn write(&self, folder: &Path) {
        std::fs::write(folder.join("robot.xml"), self.mjcf()).unwrap();
    }
}

#[test]
fn robot_without_pose_trains_with_bent_knees() {
    let folder = tempfile::tempdir().unwrap();
    small_config_file(folder.path());
    anymal_like().write(folder.path());
    let folder = folder.path();
    let told = success(run("policy", folder, &["robot", "robot.xml"]));
    let told = String::from_utf8(told.stdout).unwrap();
    assert!(told.contains("40.000 kg") && told.contains("knees bent to the rear"), "{told}");

    let trained =
        run("train", folder, &["--config", "small.yaml", "--robot", "robot.xml", "--samples", "256", "--out", "r"]);
    assert!(trained.status.success(), "{}", complaint(&trained));
    assert!(complaint(&trained).contains("knees bent to the rear"), "it says what it chose before it trains");
    let config = Config::load(folder.join("r/config.yaml").to_str().unwrap()).unwrap();
    // Three times the Go1's 13.1 kg; both legs reach down less than 0.3 + 0.33 m.
    let robot = config.robot.load().unwrap();
    let pose = config.action.nominal_pose_rad.joints();
    let height = robot.standing_height_m(&pose);
    assert!((0.4..0.6).contains(&height), "{height}");
    // A foot 3 cm in radius is below its thigh joint.
    for (leg, place) in robot.legs.iter().zip([0.3, 0.3, -0.3, -0.3]) {
        let foot = leg.foot_position([pose[0], pose[1], pose[2]]);
        assert!((foot.x - place).abs() < 0.002, "{foot}");
    }
    let ratio = (40.0 / 13.100_448) * height / 0.340_27;
    assert!(
        (config.simulation.kp_n_m_per_rad.largest() / (40.0 * ratio) - 1.0).abs() < 0.01,
        "{:?}",
        config.simulation
    );
    assert!((config.reward.base_height_m / (0.31 * height / 0.340_27) - 1.0).abs() < 0.01, "{:?}", config.reward);

    // What the command line says has the last word, and a run goes on with its robot.
    let arguments =
        ["--config", "small.yaml", "--robot", "robot.xml", "--set", "simulation.kp_n_m_per_rad=99", "--samples", "256"];
    success(run("train", folder, &[&arguments[..], &["--out", "own"]].concat()));
    let own = Config::load(folder.join("own/config.yaml").to_str().unwrap()).unwrap();
    assert_eq!(own.simulation.kp_n_m_per_rad, 99.0.into());
    // Its own pose changes no rule, and its own configuration fits it, whatever its file is called.
    let pose = "action.nominal_pose_rad=[0, 0.5, -1]";
    let posed = ["--config", "small.yaml", "--robot", "robot.xml", "--set", pose, "--samples", "256", "--out", "posed"];
    success(run("train", folder, &posed));
    let posed = Config::load(folder.join("posed/config.yaml").to_str().unwrap()).unwrap();
    assert_eq!((&posed.simulation, &posed.reward), (&config.simulation, &config.reward));
    success(run("train", folder, &["--config", "own/config.yaml", "--robot", "./robot.xml", "--out", "again"]));
    assert_eq!(Config::load(folder.join("again/config.yaml").to_str().unwrap()).unwrap(), own);
    success(run("train", folder, &["--resume", "r", "--samples", "512"]));
}

#[test]
fn a_robot_is_known_by_what_its_files_say_and_not_by_where_they_lie() {
    const TETRAHEDRON: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";
    let identity = |mesh: &str, fall_height_m: &str| {
        let folder = tempfile::tempdir().unwrap();
        Robots { assets: "<mesh name='m' file='m.obj'/>", ..anymal_like() }.write(folder.path());
        std::fs::write(folder.path().join("m.obj"), mesh).unwrap();
        let yaml = folder.path().join("robot.yaml");
        std::fs::write(&yaml, format!("mjcf: robot.xml\nmin_height_m: {fall_height_m}\n")).unwrap();
        Robot::load(yaml.to_str().unwrap()).unwrap().sha256().to_owned()
    };
    let first = identity(TETRAHEDRON, "0.2");
    assert_eq!(first, identity(TETRAHEDRON, "0.2"), "in another folder");
    assert_ne!(first, identity(TETRAHEDRON, "0.25"), "another height of a fall");
    assert_ne!(first, identity(&TETRAHEDRON.replace("v 0 0 1", "v 0 0 2"), "0.2"), "another mesh");
}

#[test]
fn non_quadruped_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let robot = anymal_like();
    for (robot, words) in [
        (Robots { legs: vec!["LF", "RF", "LH"], ..robot.clone() }, "no joint 'RR_hip'"),
        (
            Robots { legs: vec!["LF", "RF", "LH", "RH", "LM", "RM"], ..robot.clone() },
            "joints beside those of four legs: LM_HAA",
        ),
        (Robots { joints: vec!["HAA", "KFE"], ..robot.clone() }, "no joint 'FR_thigh'"),
        (Robots { free: "", ..robot.clone() }, "<freejoint/>"),
        (
            Robots { foot: "<geom size='0.01' contype='0' conaffinity='0'/>", ..robot.clone() },
            "nothing on the calf of leg FR collides: put a shape where its foot is",
        ),
        (Robots { assets: "<mesh name='m' file='nowhere.stl'/>", ..robot.clone() }, "nowhere.stl"),
        (
            Robots {
                keyframe: "<keyframe><key qpos='0 0 1 1 0 0 0  0 10 0  0 10 0  0 10 0  0 10 0'/></keyframe>",
                ..robot.clone()
            },
            "FR_thigh stands at 10 rad in its nominal pose, but goes from -9 to 9 rad: write nominal_pose_rad",
        ),
    ] {
        robot.write(folder.path());
        refused("train", folder.path(), &["--robot", "robot.xml", "--samples", "256", "--out", "r"], words);
        assert!(!folder.path().join("r").exists());
    }
}

#[test]
fn thigh_on_the_ground_is_a_fall_and_shank_is_not() {
    let config = Config::load("fast").unwrap();
    let low = "<geom type='capsule' size='0.03' fromto='0 0 -0.05 0.08 0 -0.33'/>";
    let fallen = |robots: Robots| {
        let folder = tempfile::tempdir().unwrap();
        robots.write(folder.path());
        let robot = Robot::load(folder.path().join("robot.xml").to_str().unwrap()).unwrap();
        let config = config.fitted_to(&robot).unwrap();
        let scene = Scene::flat(robot, config.simulation.timestep_s());
        let mut sim = Sim::new(&scene, &config.simulation, 0.0).unwrap();
        let conditions = Conditions { gravity: [0.0, 0.0, -9.81], friction: 0.8, encoder_bias: [0.0; 12] };
        let pose = config.action.nominal_pose_rad.joints();
        sim.reset(conditions, &pose).unwrap();
        sim.step(&pose, &mut ()).unwrap().fall.map(|fall| sim.describe(fall))
    };
    let stands = anymal_like();
    assert_eq!(fallen(stands.clone()), None);
    assert_eq!(fallen(Robots { shank: low, ..stands.clone() }), None);
    let fall = fallen(Robots { thigh: low.replace("-0.33", "-0.75").leak(), ..stands }).unwrap();
    assert!(fall.contains("thigh"), "{fall}");
}

#[test]
fn joints_lose_what_a_configuration_says_and_nothing_by_default() {
    let mut config = Config::load("go2").unwrap();
    let rate = |config: &Config| {
        let scene = Scene::flat(config.robot.load().unwrap(), config.simulation.timestep_s());
        let mut simulation = config.simulation.clone();
        // Nothing drives the joints.
        (simulation.kp_n_m_per_rad, simulation.kd_n_m_s_per_rad) = (0.0.into(), 0.0.into());
        let mut sim = Sim::new(&scene, &simulation, 0.0).unwrap();
        let conditions = Conditions { gravity: [0.0; 3], friction: 0.8, encoder_bias: [0.0; 12] };
        sim.reset(conditions, &config.action.nominal_pose_rad.joints()).unwrap();
        sim.data_mut().positions_mut()[2] = 5.0;
        // A knee swings in the air.
        let knee = sim.data().model().id(supple::mujoco::Object::Joint, &format!("{}_joint", joint_name(2))).unwrap();
        let knee = sim.data().model().joint_velocity_index(knee);
        sim.data_mut().velocities_mut()[knee] = 2.0;
        sim.refresh().unwrap();
        for _ in 0..6 {
            sim.step(&[0.0; 12], &mut ()).unwrap();
        }
        sim.data().velocities()[knee]
    };
    let free = rate(&config);
    assert!(free > 1.5, "{free}");
    config.robot.set_losses(Losses { friction_n_m: 0.0, damping_n_m_s_per_rad: 0.5 });
    let damped = rate(&config);
    config.robot.set_losses(Losses { friction_n_m: 0.2, damping_n_m_s_per_rad: 0.0 });
    let rubbed = rate(&config);
    // 0.016 + 0.006 kg m² that turn at 2 rad/s, for 0.1 s: 0.5 N m s/rad stop them in 45 ms, 0.2 N m in 0.2 s.
    assert!(damped < 0.5 * free && (0.3 * free..0.8 * free).contains(&rubbed), "{free} {damped} {rubbed}");
    assert_eq!(Robot::load("go2").unwrap().losses, Losses::default());
}
