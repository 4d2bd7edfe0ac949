//! Training on any quadruped: robots described by a few numbers, in the style of several makers.

use std::path::Path;

use supple::config::Config;
use supple::robot::{Losses, Robot, joint_name};
use supple::sim::{Conditions, Scene, Sim};

use crate::foreign::{Foreign, LEGS, foreign, standing};
use crate::support::{complaint, refused, run, success, with_small_config};

/// A robot of 40 kg in the style of an ANYmal: legs that are straight at zero angles, no pose of its own, servos.
fn anymal_like() -> Foreign {
    let (sections, ranges) = ("<option integrator='implicitfast'/>\n", ["range='-9 9'"; 3]);
    let foot = "<geom type='sphere' size='0.03' pos='0.08 0 -0.32'/>";
    let actuator = "<position joint='{}' kp='100' forcerange='-80 80'/>";
    Foreign { sections, trunk: "", joint: "armature='0.1'", ranges, foot, actuator, after: "", ..foreign() }
}

/// Returns the text of a robot with joints LF_HAA and so on, and with bodies that have no names.
fn text(robot: &Foreign) -> String {
    let names =
        [("_hip_joint", "_HAA"), ("_thigh_joint", "_HFE"), ("_calf_joint", "_KFE"), ("mass='8'", "mass='34.4'")];
    let legs = [("'FL_", "'LF_"), ("'FR_", "'RF_"), ("'RL_", "'LH_"), ("'RR_", "'RH_")];
    let text = names.iter().chain(&legs).fold(robot.mjcf(), |text, (from, to)| text.replace(from, to));
    let mut parts = text.split("<body name='");
    let first = parts.next().unwrap().to_owned();
    parts.fold(first, |text, part| text + "<body" + part.split_once('\'').unwrap().1)
}

fn write(folder: &Path, text: &str) {
    std::fs::write(folder.join("robot.xml"), text).unwrap();
}

#[test]
fn robot_without_pose_trains_with_bent_knees() {
    let folder = with_small_config();
    write(folder.path(), &text(&anymal_like()));
    let folder = folder.path();
    let told = success(run("policy", folder, &["robot", "robot.xml"]));
    let told = String::from_utf8(told.stdout).unwrap();
    assert!(told.contains("40.000 kg") && told.contains("knees bent to the rear"), "{told}");

    let trained =
        run("train", folder, &["--config", "small.yaml", "--robot", "robot.xml", "--samples", "256", "--out", "r"]);
    assert!(trained.status.success(), "{}", complaint(&trained));
    assert!(complaint(&trained).contains("knees bent to the rear"), "it says what it chose before it trains");
    let config = Config::load(folder.join("r/config.yaml").to_str().unwrap()).unwrap();
    // Three times the Go1's 13.1 kg; both legs reach down less than 0.22 + 0.33 m.
    let robot = config.robot.load().unwrap();
    let pose = config.action.nominal_pose_rad.joints();
    let height = robot.standing_height_m(&pose);
    assert!((0.35..0.55).contains(&height), "{height}");
    // A foot 3 cm in radius is below its thigh joint.
    for (leg, place) in robot.legs.iter().zip([0.2, 0.2, -0.2, -0.2]) {
        let foot = leg.foot_position([pose[0], pose[1], pose[2]]);
        assert!((foot.x - place).abs() < 0.002, "{foot}");
    }
    let ratio = (40.0 / 13.100_448) * height / 0.340_27;
    let gain = config.simulation.kp_n_m_per_rad.largest();
    assert!((gain / (40.0 * ratio) - 1.0).abs() < 0.01, "{gain}");
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
        let sections = "<asset><mesh name='m' file='m.obj'/></asset>\n";
        write(folder.path(), &text(&Foreign { sections, ..anymal_like() }));
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
    let plain = text(&anymal_like());
    let without_thighs = ["LF", "RF", "LH", "RH"].iter().fold(plain.clone(), |text, leg| {
        let joint = format!("<joint name='{leg}_HFE' axis='0 1 0' range='-9 9' armature='0.1'/>");
        text.replace(&joint, "").replace(&format!("<position joint='{leg}_HFE' kp='100' forcerange='-80 80'/>"), "")
    });
    const SIX: [(&str, f64, f64); 6] = [LEGS[0], LEGS[1], LEGS[2], LEGS[3], ("LM", 0.0, 0.06), ("RM", 0.0, -0.06)];
    let legs = |legs| text(&Foreign { legs, ..anymal_like() });
    for (robot, words) in [
        (legs(&LEGS[..3]), "no joint 'RR_hip'"),
        (legs(&SIX), "joints beside those of four legs: LM_HAA"),
        (without_thighs, "no joint 'FR_thigh'"),
        (plain.replace("<freejoint/>", ""), "<freejoint/>"),
        (plain.replace("<worldbody>", "<asset><mesh name='m' file='nowhere.stl'/></asset><worldbody>"), "nowhere.stl"),
        (
            plain.replace(
                "</mujoco>",
                "<keyframe><key qpos='0 0 1 1 0 0 0  0 10 0  0 10 0  0 10 0  0 10 0'/></keyframe></mujoco>",
            ),
            "FR_thigh stands at 10 rad in its nominal pose, but goes from -9 to 9 rad: write nominal_pose_rad",
        ),
    ] {
        write(folder.path(), &robot);
        refused("train", folder.path(), &["--robot", "robot.xml", "--samples", "256", "--out", "r"], words);
        assert!(!folder.path().join("r").exists());
    }
}

#[test]
fn thigh_on_the_ground_is_a_fall_and_shank_is_not() {
    let config = Config::load("fast").unwrap();
    let fallen = |text: String| {
        let folder = tempfile::tempdir().unwrap();
        write(folder.path(), &text);
        let robot = Robot::load(folder.path().join("robot.xml").to_str().unwrap()).unwrap();
        let (mut sim, pose) = standing(robot.clone(), &config.fitted_to(&robot).unwrap(), 0.0);
        sim.step(&pose, &mut ()).unwrap().fall.map(|fall| sim.describe(fall))
    };
    let stands = text(&anymal_like());
    assert_eq!(fallen(stands.clone()), None);
    let low = "<geom type='capsule' size='0.03' fromto='0 0 -0.05 0.08 0 -0.33'/>";
    let foot = "<geom type='sphere'";
    assert_eq!(fallen(stands.replace(foot, &format!("{low}{foot}"))), None);
    let fall = fallen(stands.replace("fromto='0 0 -0.04 0 0 -0.18'", "fromto='0 0 -0.05 0.08 0 -0.75'")).unwrap();
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
