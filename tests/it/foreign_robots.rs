//! Robots as other programs write them: newer MuJoCo, URDF, feet of any shape, settings of their own.

use std::f64::consts::PI;
use std::path::Path;
use std::sync::Arc;

use supple::config::Config;
use supple::mujoco::{Object, VERSION};
use supple::robot::{JOINTS, Robot, joint_name};
use supple::sim::{Ground, Scene};

use crate::foreign::{Foreign, HEIGHT, LEGS, described, foreign, height, load, read, standing};
use crate::support::{run, success, with_small_config};

/// Height of the foot's centre, 0.44 cos 0.6 \[m\].
const TO_FOOT: f64 = 0.363_147_7;

fn assert_usual(robot: &Robot, torque: f64) {
    assert!((robot.mass_kg - 13.6).abs() < 1e-9, "{}", robot.mass_kg);
    assert!((height(robot) - HEIGHT).abs() < 1e-6, "{}", height(robot));
    assert_eq!(robot.torque_limits, [torque; JOINTS]);
    assert_eq!(robot.joint_limits[..3], [[-0.7, 0.7], [-1.0, 3.0], [-2.6, -0.5]]);
}

#[test]
fn words_that_nothing_reads_are_left_out() {
    let newer = Foreign {
        compiler: "angle='radian' alignfree='true' saveinertial='true' conflict='merge' savecompiled='false'",
        sections: "<option ls_iterations='9' ccd_iterations='5'><flag nativeccd='enable' eulerdamp='disable'/></option>\n\
                   <size memory='1M'/><extension/><statistic center='0 0 0' extent='1'/>\n\
                   <visual><global ellipsoidinertia='true'/></visual>\n\
                   <default><position kp='50' kv='2' inheritrange='1' dampratio='1'/><light bulbradius='1'/>\n\
                   <default class='m'><mesh maxhullvert='20' inertia='legacy'/><material metallic='1'/></default></default>\n\
                   <asset><material name='a' roughness='0.5'><layer texture='t' role='rgb'/></material>\n\
                   <mesh name='m' content_type='model/obj' inertia='exact' vertex='0 0 0 1 0 0 0 1 0 0 0 1'/>\n\
                   <texture name='t' type='2d' builtin='flat' width='2' height='2' colorspace='sRGB' nchannel='3'/></asset>\n",
        trunk: "name='base' sleep='never' gravcomp='0' simple='auto'",
        parts: "<camera name='c' resolution='64 64' focal='1 1' sensorsize='1 1' output='depth'/><light type='spot'/>",
        joint: "actuatorgravcomp='false' springyield='3' damping='0.5 0.1 0.01' stiffness='0 0 0'",
        actuator: "<position joint='{}' kp='50' kv='2' inheritrange='1' timeconst='0.1' forcerange='-25 25'/>",
        after: "<sensor><jointactuatorfrc joint='FL_hip_joint' nsample='3'/></sensor><contact><pair geom1='x' adhesion='1'/></contact>\n\
                <keyframe><key name='home' mpos='1 2 3' ctrl='1 2' \
                qpos='0 0 1 1 0 0 0  0 .6 -1.2  0 .6 -1.2  0 .6 -1.2  0 .6 -1.2'/></keyframe>",
        ..foreign()
    };
    let robot = newer.robot();
    assert_usual(&robot, 25.0);
    let report = robot.report.join("\n");
    assert!(
        report.contains("of newer MuJoCos") && report.contains("inheritrange") && report.contains("kv"),
        "{report}"
    );
    assert!(report.contains("joint damping: 0.5 N m s/rad"), "{report}");
    assert!(report.contains("flag nativeccd enable"), "{report}");
}

#[test]
fn what_acts_on_a_robot_is_left_out_with_a_word() {
    let report = Foreign { trunk: "gravcomp='0.5'", ..foreign() }.robot().report.join("\n");
    assert!(report.contains("line 4: gravcomp 0.5 of <body> left out"), "{report}");
    let report = Foreign { joint: "stiffness='7'", ..foreign() }.robot().report.join("\n");
    assert!(report.contains("joint springs: 7 N m/rad, set to 0"), "{report}");
    let sections = "<default><joint springdamper='0.2 1'/><geom condim='6' solref='0.1 1'/></default>\n";
    let robot = Foreign { sections, ..foreign() }.robot();
    let count = |text: &str| robot.mjcf().matches(text).count();
    assert!(count("springdamper=\"0 0\"") >= JOINTS && count("condim=\"3\"") >= LEGS.len());
}

#[test]
fn a_joints_force_range_limits_its_torque() {
    let own = Foreign { joint: "actuatorfrcrange='-18 18'", ..foreign() };
    assert_usual(&own.robot(), 18.0);
    let of_class = "<default><joint actuatorfrcrange='-9 9'/></default>\n";
    assert_usual(&Foreign { sections: of_class, ..foreign() }.robot(), 9.0);
    let servo = "<position joint='{}' kp='50' kv='1'/>";
    assert_usual(&Foreign { sections: of_class, actuator: servo, ..foreign() }.robot(), 9.0);
    let off = "actuatorfrcrange='-18 18' actuatorfrclimited='false'";
    assert_usual(&Foreign { joint: off, ..foreign() }.robot(), 25.0);
}

#[test]
fn frames_are_poses_of_what_they_hold() {
    let plain = foreign().robot();
    let framed = |foot: &'static str, sections: &'static str, compiler: &'static str| {
        let robot = Foreign { foot, sections, compiler, ..foreign() }.robot();
        for (leg, own) in robot.legs.iter().zip(&plain.legs) {
            let [found, expected] = [leg, own].map(|leg| leg.foot_position([0.1, 0.6, -1.2]));
            assert!((found - expected).norm() < 1e-12 && leg.foot_radius_m == own.foot_radius_m, "{found} {expected}");
        }
        robot
    };
    framed("<frame pos='0 0 -0.22'><geom size='0.02'/></frame>", "", "angle='radian'");
    // A quarter turn about y takes x to −z.
    framed("<frame euler='0 1.5707963267948966 0'><geom size='0.02' pos='0.22 0 0'/></frame>", "", "angle='radian'");
    let ranges = ["range='-40.107 40.107'", "range='-57.2958 171.887'", "range='-148.969 -28.6479'"];
    let foot = "<frame euler='0 90 0'><frame pos='0.1 0 0'><geom size='0.02' pos='0.12 0 0'/></frame></frame>";
    let degrees = Foreign { compiler: "", ranges, foot, ..foreign() };
    assert!((height(&degrees.robot()) - HEIGHT).abs() < 1e-6);
    // The class of a frame, and numbers that only the class has.
    let classes =
        "<default><geom friction='1'/><default class='f'><geom size='0.02 0.5' pos='0 0 -0.2'/></default></default>\n";
    framed("<frame childclass='f' pos='0 0 -0.02'><geom/></frame>", classes, "angle='radian'");
    framed("<frame childclass='f'><geom pos='0 0 -0.22'/></frame>", classes, "angle='radian'");
    // A frame around the whole robot, and one around a leg's part.
    let text = foreign().mjcf();
    let text = text
        .replace("<worldbody>", "<worldbody><frame name='f' pos='1 2 3' zaxis='0 1 0'>")
        .replace("</worldbody>", "</frame></worldbody>");
    assert_usual(&read(&text).unwrap(), 25.0);
    let text = foreign().mjcf().replacen(
        "<body name='FL_calf' pos='0 0 -0.22'>",
        "<frame pos='0 0 -0.22'><body name='FL_calf'>",
        1,
    );
    let text = text.replacen("</body></body></body>", "</body></frame></body></body>", 1);
    assert_usual(&read(&text).unwrap(), 25.0);
}

#[test]
fn legs_may_be_fixed_to_the_trunk_by_bodies_of_their_own() {
    let text = foreign().mjcf().replacen(
        "<body name='FL_hip' pos='0.2 0.06 0'>",
        "<body name='mount' pos='0.1 0 0'><inertial pos='0 0 0' mass='0.1' diaginertia='1e-4 1e-4 1e-4'/><body name='FL_hip' pos='0.1 0.06 0'>",
        1,
    );
    let robot = read(&text.replacen("</body></body></body>", "</body></body></body></body>", 1)).unwrap();
    assert!((height(&robot) - HEIGHT).abs() < 1e-6 && (robot.mass_kg - 13.7).abs() < 1e-9);
    let plain = foreign().robot();
    let foot = |robot: &Robot| robot.legs[1].foot_position([0.0, 0.6, -1.2]);
    assert!((foot(&robot) - foot(&plain)).norm() < 1e-12);
}

#[test]
fn words_that_cannot_be_translated_are_refused_with_line_and_version() {
    for (robot, words) in [
        (
            Foreign { parts: "<replicate count='2'><geom size='1'/></replicate>", ..foreign() },
            "line 6: <replicate> needs MuJoCo 3.1.5, and robots are read as MJCF of 2.2.2; save the robot from that MuJoCo",
        ),
        (Foreign { parts: "\n<attach model='m' prefix='p'/>", ..foreign() }, "line 7: <attach> needs MuJoCo 3.2"),
        (Foreign { parts: "<geom type='sdf'/>", ..foreign() }, "sdf of <geom> needs MuJoCo 3.0"),
        (
            Foreign { sections: "<asset><mesh name='m' builtin='sphere' params='1'/></asset>", ..foreign() },
            "line 3: builtin of <mesh 'm'>",
        ),
        (Foreign { parts: "<frame scale='2'/>", ..foreign() }, "scale of <frame> needs MuJoCo 3.16"),
        (Foreign { actuator: "<motor joint='{}' armature='1' ctrlrange='-1 1'/>", ..foreign() }, "armature of <motor>"),
        (
            Foreign { joint: "rnage='1 2'", ..foreign() },
            "line 9: the attribute 'rnage' of <joint 'FL_hip_joint'> is unknown to MuJoCo 2.2.2",
        ),
        (Foreign { sections: "<worldbdy/>", ..foreign() }, "<worldbdy> is unknown"),
        (
            Foreign { compiler: "coordinate='global'", ..foreign() },
            "line 2: its compiler setting coordinate is 'global'",
        ),
        (Foreign { after: "<tendon><fixed name='t'/></tendon>", ..foreign() }, "a section <tendon>"),
    ] {
        let found = robot.complaint();
        assert!(found.contains(words) && found.lines().count() == 1, "{words}: {found}");
    }
}

#[test]
fn complaints_of_mujoco_name_the_lines_of_the_file() {
    for (robot, words) in [
        (Foreign { parts: "\n<geom type='capsule' size='-1'/>", ..foreign() }, "line 7, <geom>: MuJoCo refuses it: "),
        (Foreign { joint: "pos='1 2'", ..foreign() }, "line 9, <joint 'FL_hip_joint'>: MuJoCo refuses it: "),
        (Foreign { joint: "class='none'", ..foreign() }, "line 9, <joint 'FL_hip_joint'>: "),
        (Foreign { parts: "<body name='base'/>", ..foreign() }, "<body 'base'>: MuJoCo refuses it: repeated name"),
    ] {
        let found = robot.complaint();
        assert!(found.contains(words) && !found.contains("robot.xml, line"), "{words}: {found}");
    }
    // In a file that another includes, by its own line.
    let more = "<mujoco>\n\n<asset>\n<mesh name='m' file='gone.stl'/></asset></mujoco>";
    let main = foreign().mjcf().replace("<worldbody>", "<include file='more.xml'/>\n<worldbody>");
    let error = load(&[("more.xml", more), ("robot.xml", &main)]).unwrap_err();
    assert!(error.contains("more.xml, line 4, <mesh 'm'>: ") && error.contains("gone.stl"), "{error}");
}

#[test]
fn joints_without_limits_stay_without() {
    let free = Foreign { ranges: [""; 3], ..foreign() }.robot();
    assert_eq!(free.joint_limits, [[f64::NEG_INFINITY, f64::INFINITY]; JOINTS]);
    assert!((height(&free) - HEIGHT).abs() < 1e-6);
    assert!(free.description().contains("none") && free.report.iter().any(|it| it.starts_with("joint limits: none")));
    let off = Foreign { joint: "limited='false'", ..foreign() }.robot();
    assert_eq!(off.joint_limits, free.joint_limits);
    let by_setting = Foreign { compiler: "angle='radian' autolimits='false'", joint: "limited='true'", ..foreign() };
    let by_setting = Foreign { actuator: "<motor joint='{}' ctrllimited='true' ctrlrange='-25 25'/>", ..by_setting };
    assert_usual(&by_setting.robot(), 25.0);
    let hips = Foreign { ranges: ["", "range='-1 3'", "range='-2.6 -0.5'"], ..foreign() }.robot();
    assert_eq!(hips.joint_limits[..2], [[f64::NEG_INFINITY, f64::INFINITY], [-1.0, 3.0]]);
    let config = Config::load("fast").unwrap();
    let fitted = config.fitted_to(&free).unwrap();
    // Knees that go all around.
    let scene = Scene::flat(Arc::clone(&free), fitted.simulation.timestep_s());
    let model = scene.compile().unwrap();
    let knee = model.id(Object::Joint, "FR_calf_joint").unwrap();
    assert!(!model.joint_is_limited(knee));
}

#[test]
fn the_tightest_bound_of_a_torque_holds() {
    for (actuator, expected) in [
        ("<motor joint='{}' ctrlrange='-20 20' forcerange='-100 100'/>", 20.0),
        ("<motor joint='{}' ctrlrange='-20 20' forcerange='-6 6' gear='2'/>", 12.0),
        ("<motor joint='{}' ctrlrange='-2 2' gear='-9'/>", 18.0),
        ("<general joint='{}' ctrlrange='-1 1' gainprm='15'/>", 15.0),
        ("<position joint='{}' ctrlrange='-3 3' kp='100' forcerange='-15 15'/>", 15.0),
        ("<motor joint='{}' ctrlrange='-5 5'/><motor joint='{}' ctrlrange='-7 7'/>", 12.0),
        ("<motor joint='{}' ctrlrange='-20 30'/>", 20.0),
        (
            "<general joint='{}' dyntype='filterexact' dynprm='0.1' gaintype='so3' biastype='so3' forcerange='-13 13'/>",
            13.0,
        ),
        ("<intvelocity joint='{}' kp='9' inheritrange='1' forcerange='-11 11'/>", 11.0),
        ("<pid joint='{}' kp='9' input='pos vel' forcerange='-14 14'/>", 14.0),
    ] {
        assert_usual(&Foreign { actuator, ..foreign() }.robot(), expected);
    }
    let report = |actuator| Foreign { actuator, ..foreign() }.robot().report.join("\n");
    let two = report("<motor joint='{}' ctrlrange='-5 5'/><motor joint='{}' ctrlrange='-7 7'/>");
    assert!(two.contains("torque of FR_hip: 12 N m, of 2 actuators together"), "{two}");
    assert!(report("<motor joint='{}' ctrlrange='-20 30'/>").contains("-20 to 30 N m, taken as ±20"));
    for (actuator, words) in [
        (
            "<motor joint='{}' ctrlrange='-5 5'/><velocity joint='{}' kv='3'/>",
            "'FR_hip_joint' has no actuator with a limited torque",
        ),
        ("<motor joint='{}' ctrlrange='0 5'/>", "takes torques from 0 to 5 N m, expected both directions"),
        ("", "torque_limits_n_m"),
    ] {
        let found = Foreign { actuator, ..foreign() }.complaint();
        assert!(found.contains(words), "{words}: {found}");
    }
    let open = Foreign { actuator: "", ..foreign() };
    assert_usual(&described(&open, "torque_limits_n_m: [25, 25, 25]").unwrap(), 25.0);
}

/// Feet of all shapes and the height of the trunk on them; the calf leans by 0.6 rad.
fn feet() -> Vec<(&'static str, f64)> {
    let (sin, cos) = 0.6_f64.sin_cos();
    vec![
        ("<geom name='{}_foot' type='capsule' size='0.02' fromto='0 0 -0.05 0 0 -0.22'/>", TO_FOOT + 0.02),
        ("<geom name='{}_foot' type='cylinder' size='0.02 0.015' pos='0 0 -0.22' quat='1 1 0 0'/>", TO_FOOT + 0.02),
        // The rim of an upright cylinder, and the corner of a box.
        ("<geom name='{}_foot' type='cylinder' size='0.02 0.01' pos='0 0 -0.22'/>", TO_FOOT + 0.01 * cos + 0.02 * sin),
        ("<geom name='{}_foot' type='box' size='0.02 0.015 0.01' pos='0 0 -0.22'/>", TO_FOOT + 0.01 * cos + 0.02 * sin),
        (
            "<geom name='{}_foot' type='ellipsoid' size='0.03 0.02 0.01' pos='0 0 -0.22'/>",
            TO_FOOT + ((0.03 * sin).powi(2) + (0.01 * cos).powi(2)).sqrt(),
        ),
        ("<geom name='{}_foot' type='mesh' mesh='tip' pos='0 0 -0.22'/>", TO_FOOT + 0.02 * cos),
        ("<body pos='0 0 -0.22' quat='0 1 0 0'><geom name='{}_foot' size='0.02'/></body>", TO_FOOT + 0.02),
    ]
}

const TIP: &str = "<asset><mesh name='tip' vertex='.02 0 0 -.02 0 0 0 .02 0 0 -.02 0 0 0 .02 0 0 -.02'/></asset>\n";

#[test]
fn feet_of_any_shape_stand_on_their_lowest_point() {
    for (foot, expected) in feet() {
        let robot = Foreign { foot, sections: TIP, ..foreign() };
        let found = robot.robot();
        let own = height(&found);
        assert!((own - expected).abs() < 1e-6 && (found.stand[2] - expected).abs() < 1e-6, "{foot}: {own} {expected}");
        let named = described(&robot, "feet: {FR: FR_foot, FL: FL_foot, RR: RR_foot, RL: RL_foot}").unwrap();
        assert_eq!(height(&named), height(&found), "{foot}");

        let config = Config::load("fast").unwrap().fitted_to(&found).unwrap();
        let (mut sim, pose) = standing(Arc::clone(&found), &config, 0.2);
        for _ in 0..60 {
            assert_eq!(sim.step(&pose, &mut ()).unwrap().fall, None, "{foot}");
        }
        let state = sim.state();
        assert!(state.feet.iter().all(|foot| foot.contact && foot.height.abs() < 0.004), "{foot}: {:?}", state.feet);
        assert!((state.height - expected).abs() < 0.03, "{foot}: {} {expected}", state.height);
        // The legs in closed form, as estimates use them, are where the simulation has them.
        let centres = sim.parts().foot_centres(sim.data());
        for (leg, centre) in centres.iter().enumerate() {
            let angles = std::array::from_fn(|part| state.joint_angles[3 * leg + part]);
            let found = state.position + state.world_from_base * found.legs[leg].foot_position(angles);
            assert!((found - nalgebra::Vector3::from(*centre)).norm() < 1e-9, "{foot}");
        }
    }
}

#[test]
fn the_foot_is_the_lowest_in_the_world_whatever_the_calfs_axes() {
    // The calf's body is turned about x, so that its foot is up in its frame, and a knee cap is down.
    let ranges = ["range='-0.7 0.7'", "range='-1 3'", "range='0.5 2.6'"];
    let foot = "<geom size='0.02' pos='0 0 0.22'/><geom size='0.03' pos='0 0 -0.01'/>";
    let after = "<keyframe><key qpos='0 0 1 1 0 0 0  0 .6 1.2  0 .6 1.2  0 .6 1.2  0 .6 1.2'/></keyframe>";
    let turned = Foreign { calf: "pos='0 0 -0.22' quat='0 1 0 0'", ranges, foot, after, ..foreign() };
    assert!((height(&turned.robot()) - HEIGHT).abs() < 1e-6);
}

#[test]
fn feet_that_cannot_be_are_refused_by_name() {
    for (feet, words) in [
        (
            "{FR: FL_foot, FL: FR_foot, RR: RR_foot, RL: RL_foot}",
            "foot 'FL_foot' of leg FR is not below the calf of that leg, but on FL_calf",
        ),
        ("{FR: FR_foot, FL: FR_foot, RR: RR_foot, RL: RL_foot}", "foot 'FR_foot'"),
        // It lies below one of the calves, and is not called foreign.
        ("{FR: FR_foot, FL: FL_foot, RR: RR_foot, RL: RR_foot}", "foot 'RR_foot'"),
        ("{FR: FR_foot, FL: FL_foot, RR: RR_foot, RL: RR_foot}", "named twice, for the legs RR and RL"),
        (
            "{FR: FR_feet, FL: FL_foot, RR: RR_foot, RL: RL_foot}",
            "no geometry 'FR_feet' for the foot of leg FR; its geometries with names are: FL_foot",
        ),
    ] {
        let found = described(&foreign(), &format!("feet: {feet}")).unwrap_err();
        assert!(found.contains(words), "{words}: {found}");
    }
    let bare = Foreign { foot: "<geom name='{}_foot' size='0.02' contype='0' conaffinity='0'/>", ..foreign() };
    assert!(bare.complaint().contains("nothing on the calf of leg FR collides: put a shape"), "{}", bare.complaint());
    let found = described(&bare, "feet: {FR: FR_foot, FL: FL_foot, RR: RR_foot, RL: RL_foot}").unwrap_err();
    assert!(found.contains("'FR_foot' of leg FR does not collide"), "{found}");
    let names = |first: &str| {
        let leg = |leg: &str| format!("[{leg}_hip_joint, {leg}_thigh_joint, {leg}_calf_joint]");
        format!(
            "joints: {{FR: [{first}, FR_thigh_joint, FR_calf_joint], FL: {}, RR: {}, RL: {}}}",
            leg("FL"),
            leg("RR"),
            leg("RL")
        )
    };
    let twice = described(&foreign(), &names("FL_hip_joint")).unwrap_err();
    assert!(twice.contains("joint 'FL_hip_joint' is named twice, as FR_hip and FL_hip"), "{twice}");
    let slide = Foreign { joint: "type='slide'", ..foreign() }.complaint();
    assert!(slide.contains("'FR_hip_joint', FR_hip, is no hinge"), "{slide}");
}

#[test]
fn names_and_settings_of_a_robot_stay_its_own() {
    let own = Foreign {
        compiler: "angle='radian' boundmass='0.35' boundinertia='0.003' balanceinertia='true' eulerseq='XYZ' inertiagrouprange='0 1'",
        trunk: "name='box'",
        parts: "<body name='trunk'><inertial pos='0 0 0' mass='0.1' diaginertia='1e-5 1e-5 1e-5'/><site name='ball_0'/></body>\
                <body name='ground'><geom name='ball_0' group='3' size='0.01' euler='1 2 3'/></body><site name='harness'/>",
        ..foreign()
    };
    let robot = own.robot();
    // Calves of 0.3 kg and the two parts weigh 0.35 kg each.
    assert!((robot.mass_kg - (13.6 + 4.0 * 0.05 + 2.0 * 0.35)).abs() < 1e-9, "{}", robot.mass_kg);
    assert_eq!(robot.report.iter().filter(|line| line.contains("compiler settings")).count(), 1);
    let obstacles = "<body name='box' pos='3 0 1'><freejoint name='box'/><geom name='box' size='0.02' density='1000' euler='1 0 0'/></body>\
                     <body name='ball_0' pos='4 0 1'><freejoint name='ball_0'/><geom name='ball_0' group='4' size='0.02' mass='0.02'/></body>\n";
    let ground = Ground::Flat;
    let scene = Scene { obstacles: obstacles.into(), ground, ..Scene::flat(robot, 1.0 / 240.0) };
    let model = scene.compile().unwrap();
    let mass = |name: &str| model.body_mass()[model.id(Object::Body, name).unwrap()];
    let [ball, carton] = ["ball_0", "box"].map(&mass);
    assert!((ball - 0.02).abs() < 1e-12 && (carton - 0.0335).abs() < 1e-4, "{ball} {carton}");
    assert_eq!(mass("FR_calf"), 0.35);
    assert!(model.id(Object::Body, "robot/trunk").is_ok() && model.id(Object::Body, "robot/ground").is_ok());
    let total = Foreign { compiler: "angle='radian' settotalmass='20' coordinate='local'", ..foreign() }.robot();
    assert!((total.mass_kg - 20.0).abs() < 1e-9, "{}", total.mass_kg);
}

#[test]
fn degrees_are_radians_in_other_words() {
    let ranges = ["range='-40 40'", "range='-50 170'", "range='-150 -30'"];
    let parts = "<body pos='1 0 0'><geom size='.1' axisangle='0 0 1 90'/></body>";
    let degrees = Foreign { compiler: "", ranges, parts, ..foreign() };
    let robot = degrees.robot();
    let expected = [[-40.0_f64, 40.0], [-50.0, 170.0], [-150.0, -30.0]].map(|range| range.map(f64::to_radians));
    for (found, expected) in robot.joint_limits.iter().zip(expected) {
        assert!((0..2).all(|end| (found[end] - expected[end]).abs() < 1e-15), "{found:?} {expected:?}");
    }
    let mjcf = robot.mjcf();
    assert!(mjcf.contains("angle=\"radian\"") && mjcf.contains("1.5707963267948966"), "{mjcf}");
}

#[test]
fn physics_is_fast_enough_for_light_joints() {
    let config = Config::load("fast").unwrap();
    let rate = |text: &str| config.fitted_to(&read(text).unwrap()).map(|config| config.simulation.physics_rate_hz);
    assert_eq!(rate(&Foreign { joint: "armature='0.01'", ..foreign() }.mjcf()).unwrap(), 240);
    // A fifth as large: lengths by 0.2, masses by 0.008, inertias by 0.00032.
    let light = foreign().mjcf();
    let scaled = |text: &str, name: &str, by: f64| {
        let mark = format!(" {name}='");
        let mut parts = text.split(&mark);
        let mut out = parts.next().unwrap().to_owned();
        for part in parts {
            let (numbers, rest) = part.split_once('\'').unwrap();
            let numbers: Vec<String> =
                numbers.split_whitespace().map(|word| (word.parse::<f64>().unwrap() * by).to_string()).collect();
            out.push_str(&format!(" {name}='{}'{rest}", numbers.join(" ")));
        }
        out
    };
    let light = [("pos", 0.2), ("size", 0.2), ("fromto", 0.2), ("mass", 0.008), ("diaginertia", 0.000_32)]
        .iter()
        .fold(light, |text, (name, by)| scaled(&text, name, *by));
    let fitted = config.fitted_to(&read(&light).unwrap()).unwrap();
    assert!(fitted.simulation.physics_rate_hz > 240, "{:?}", fitted.simulation);
    // It stands still rather than shaking.
    let (mut sim, pose) = standing(read(&light).unwrap(), &fitted, 0.02);
    let mut power = 0.0;
    for step in 0..120 {
        let summary = sim.step(&pose, &mut ()).unwrap();
        assert_eq!(summary.fall, None);
        power = if step < 60 { 0.0 } else { power + summary.power_w / 60.0 };
    }
    assert!(power < 0.01, "{power}");
    let weightless = foreign().mjcf().replace("diaginertia='0.002 0.002 0.0001'", "diaginertia='1e-9 1e-9 1e-9'");
    let weightless = weightless.replace("pos='0 0 -0.1' mass='0.3'", "pos='0 0 0' mass='1e-6'");
    let error = rate(&weightless).unwrap_err().to_string();
    assert!(error.contains("give its joints their rotors' armature"), "{error}");
}

/// The same robot as a URDF.
fn urdf(foot: &str) -> String {
    let inertial = |z: f64, mass: f64, [x, y, i]: [f64; 3]| {
        format!(
            "<inertial><origin xyz='0 0 {z}'/><mass value='{mass}'/><inertia ixx='{x}' iyy='{y}' izz='{i}' ixy='0' ixz='0' iyz='0'/></inertial>"
        )
    };
    let mut text = format!(
        "<?xml version='1.0'?>\n<robot name='r'>\n<material name='m'/>\n\
         <link name='base'/><joint name='floating_base' type='fixed'><parent link='base'/><child link='trunk'/></joint>\n\
         <link name='trunk'>{}<visual><geometry><mesh filename='package://r/trunk.dae'/></geometry></visual>\
         <collision><geometry><box size='0.44 0.14 0.1'/></geometry></collision></link>\n",
        inertial(0.0, 8.0, [0.04, 0.1, 0.12])
    );
    for (leg, x, y) in LEGS {
        let joint = |name: &str, parent: &str, xyz: String, axis: &str, low: f64, high: f64| {
            format!(
                "<joint name='{leg}_{name}_joint' type='revolute'><origin xyz='{xyz}' rpy='0 0 0'/><parent link='{parent}'/>\
                 <child link='{leg}_{name}'/><axis xyz='{axis}'/><dynamics damping='0.1' friction='0'/>\
                 <limit lower='{low}' upper='{high}' effort='25' velocity='20'/></joint>\n"
            )
        };
        text += &format!("<link name='{leg}_hip'>{}</link>\n", inertial(0.0, 0.4, [0.0006; 3]));
        text += &joint("hip", "trunk", format!("{x} {y} 0"), "1 0 0", -0.7, 0.7);
        text += &format!("<link name='{leg}_thigh'>{}</link>\n", inertial(-0.1, 0.7, [0.004, 0.004, 0.0005]));
        text += &joint("thigh", &format!("{leg}_hip"), format!("0 {} 0", 1.4 * y), "0 1 0", -1.0, 3.0);
        text += &format!("<link name='{leg}_calf'>{}</link>\n", inertial(-0.1, 0.3, [0.002, 0.002, 0.0001]));
        text += &joint("calf", &format!("{leg}_thigh"), "0 0 -0.22".into(), "0 1 0", -2.6, -0.5);
        text += &format!(
            "<link name='{leg}_foot'><collision><geometry>{foot}</geometry></collision></link>\n<joint name='{leg}_foot_fixed' \
             type='fixed'><origin xyz='0 0 -0.22'/><parent link='{leg}_calf'/><child link='{leg}_foot'/></joint>\n"
        );
    }
    text + "<gazebo reference='trunk'/><transmission name='t'/></robot>\n"
}

#[test]
fn a_urdf_is_the_robot_that_it_describes() {
    let text = urdf("<sphere radius='0.02'/>");
    let of_urdf = |text: &str| load(&[("robot.urdf", text)]).unwrap();
    let pose = ("robot.yaml", "mjcf: robot.urdf\nnominal_pose_rad: [0, 0.6, -1.2]\n");
    let robot = load(&[("robot.urdf", &text), pose]).unwrap();
    assert_usual(&robot, 25.0);
    let report = robot.report.join("\n");
    assert!(report.contains("a URDF, read by MuJoCo") && report.contains("1 left out"), "{report}");
    // The same numbers as the MJCF, part by part.
    let [own, other] = [robot, foreign().robot()].map(|robot| Scene::flat(robot, 1.0 / 240.0).compile().unwrap());
    for joint in 0..JOINTS {
        let body = |model: &supple::mujoco::Model| {
            model.joint_body(model.id(Object::Joint, &format!("{}_joint", joint_name(joint))).unwrap())
        };
        let (a, b) = (body(&own), body(&other));
        assert!((own.body_mass()[a] - other.body_mass()[b]).abs() < 1e-12);
        let mut inertias = [own.body_inertia(a), other.body_inertia(b)];
        inertias.iter_mut().for_each(|inertia| inertia.sort_by(f64::total_cmp));
        assert!((0..3).all(|k| (inertias[0][k] - inertias[1][k]).abs() < 1e-12), "{inertias:?}");
        let far = |model: &supple::mujoco::Model, body| model.body_centre_of_mass(body);
        assert!((0..3).all(|k| (far(&own, a)[k] - far(&other, b)[k]).abs() < 1e-12));
    }
    // A trunk whose mass is a link of its own, and a sensor whose inertia was made up.
    let apart = text.replace("<link name='base'/>", "").replacen("floating_base", "inertia", 1);
    let apart = apart.replacen(
        "<parent link='base'/><child link='trunk'/>",
        "<origin xyz='0 0 0.1' rpy='0 0 0'/><parent link='trunk'/><child link='mass'/>",
        1,
    );
    let start = apart.find("<link name='trunk'>").unwrap() + "<link name='trunk'>".len();
    let end = start + apart[start..].find("</inertial>").unwrap() + "</inertial>".len();
    let inertial = apart[start..end].replace("xyz='0 0 0'", "xyz='0 0 -0.1'");
    let camera =
        "<inertial><mass value='0.1'/><inertia ixx='1e-6' iyy='1e-6' izz='1' ixy='0' ixz='0' iyz='0'/></inertial>";
    let apart = format!(
        "{}{}<link name='mass'>{inertial}</link>\n<link name='camera'>{camera}</link>\n<joint name='c' type='fixed'><parent link='mass'/>\
         <child link='camera'/></joint></robot>",
        &apart[..start],
        apart[end..].replace("</robot>", "")
    );
    let apart = of_urdf(&apart);
    assert!((apart.mass_kg - 13.7).abs() < 1e-9, "{}", apart.mass_kg);
    // MuJoCo 3 does not say which link it is.
    let is_told = |line: &String| line.contains("made equal") && (VERSION >= 300 || line.contains("'camera'"));
    assert!(apart.report.iter().any(is_told), "{:?}", apart.report);
    let model = Scene::flat(apart, 1.0 / 240.0).compile().unwrap();
    let trunk = model.id(Object::Body, "trunk").unwrap();
    // The camera, 0.1 m up, is a part of the trunk: 0.1 · 0.1 / 8.1.
    let [x, y, z] = model.body_centre_of_mass(trunk);
    assert!((model.body_mass()[trunk] - 8.1).abs() < 1e-12, "{}", model.body_mass()[trunk]);
    assert!(x.abs() < 1e-12 && y.abs() < 1e-12 && (z - 0.01 / 8.1).abs() < 1e-12, "{x} {y} {z}");
    // About its sides 0.04 + 8 z² + 0.1 (0.1 − z)², and the camera's own third of 1 + 2e-6.
    let (own, third) = (0.04 + 8.0 * z * z + 0.1 * (0.1 - z) * (0.1 - z), 1.000_002 / 3.0);
    let least = model.body_inertia(trunk).into_iter().fold(f64::INFINITY, f64::min);
    assert!((least - own - third).abs() < 1e-9, "{least} {own}");
    // Without a pose, knees are bent as far as its joints go.
    let alone = of_urdf(&text);
    assert!((alone.nominal_pose[2] + 1.44).abs() < 1e-9, "{:?}", alone.nominal_pose);
    let stiff = of_urdf(&text.replace("lower='-2.6'", "lower='-1.2'"));
    assert!((-1.2..-1.0).contains(&stiff.nominal_pose[2]), "{:?}", stiff.nominal_pose);
    Config::load("fast").unwrap().fitted_to(&stiff).unwrap();
    // Knees that only bend the other way point forward.
    let forward = of_urdf(&text.replace("lower='-2.6' upper='-0.5'", "lower='0.5' upper='2.6'"));
    assert!((forward.nominal_pose[2] - 1.44).abs() < 1e-9 && (forward.nominal_pose[1] + 0.72).abs() < 1e-9);
}

/// Writes a sphere of 20 mm as a binary STL, 32 times 16 faces, in units of `unit` metres.
fn write_ball(path: &Path, unit: f64) {
    let point = |ring: usize, place: usize| {
        let (across, around) = (ring as f64 * PI / 16.0, (place % 32) as f64 * PI / 16.0);
        [across.sin() * around.cos(), across.sin() * around.sin(), across.cos()].map(|k| (0.02 / unit * k) as f32)
    };
    let mut faces = Vec::new();
    for (ring, place) in (0..16).flat_map(|ring| (0..32).map(move |place| (ring, place))) {
        let [a, b, c, d] =
            [point(ring, place), point(ring + 1, place), point(ring + 1, place + 1), point(ring, place + 1)];
        faces.extend([[a, b, c], [a, c, d]].into_iter().skip(usize::from(ring == 15)).take(if ring == 0 {
            1
        } else {
            2
        }));
    }
    let mut bytes = [vec![0; 80], (faces.len() as u32).to_le_bytes().to_vec()].concat();
    for face in faces {
        let numbers = [[0.0; 3], face[0], face[1], face[2]].into_iter().flatten();
        bytes.extend(numbers.flat_map(f32::to_le_bytes).chain([0; 2]));
    }
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, bytes).unwrap();
}

#[test]
fn feet_of_a_urdf_may_be_meshes() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    write_ball(&at("my_robot/meshes/foot.stl"), 0.001);
    write_ball(&at("my_robot/urdf/near.stl"), 1.0);
    let load = |name: &str, foot: &str, shank: &str| {
        let path = at("my_robot/urdf").join(name);
        let on_shank = format!("_calf'><collision><geometry>{shank}</geometry></collision><inertial>");
        let text =
            urdf(foot).replace("_calf'><inertial>", if shank.is_empty() { "_calf'><inertial>" } else { &on_shank });
        std::fs::write(&path, text).unwrap();
        Robot::load(path.to_str().unwrap()).map_err(|error| error.to_string())
    };
    let ball = load("ball.urdf", "<sphere radius='0.02'/>", "").unwrap();
    let scaled = "scale='0.001 0.001 0.001'";
    for (name, foot, shank) in [
        ("package.urdf", format!("<mesh filename='package://my_robot/meshes/foot.stl' {scaled}/>"), ""),
        ("elsewhere.urdf", "<mesh filename='package://elsewhere/lost/near.stl'/>".to_owned(), ""),
        ("relative.urdf", format!("<mesh filename='../meshes/foot.stl' {scaled}/>"), ""),
        ("shank.urdf", "<mesh filename='near.stl'/>".to_owned(), "<cylinder radius='0.01' length='0.1'/>"),
        // A finer mesh of the same shank, which is not read.
        ("dae.urdf", "<sphere radius='0.02'/>".to_owned(), "<mesh filename='package://my_robot/shank.dae'/>"),
    ] {
        let robot = load(name, &foot, shank).unwrap();
        assert!((height(&robot) - height(&ball)).abs() < 1e-3, "{name}: {} {}", height(&robot), height(&ball));
        let report = robot.report.join("\n");
        assert_eq!(report.contains("shape is read from the meshes"), name != "dae.urdf", "{report}");
        for (leg, own) in robot.legs.iter().zip(&ball.legs) {
            let [found, expected] = [leg, own].map(|leg| leg.foot_position([0.1, 0.6, -1.2]));
            assert!((found - expected).norm() < 1e-3, "{name}: {found} {expected}");
            assert!((leg.foot_radius_m - 0.02).abs() < 1e-3, "{name}: {}", leg.foot_radius_m);
        }
    }
    for (foot, problem) in [
        (
            "<mesh filename='foot.dae'/>",
            "of FL_foot, FR_foot, RL_foot, RR_foot has a format that is not read, expected STL",
        ),
        ("<mesh filename='package://r/gone.stl'/>", "is not there, expected "),
    ] {
        let error = load("bad.urdf", foot, "").unwrap_err();
        assert!(error.contains("nothing on the calf of leg FR collides, because line 12: the mesh"), "{error}");
        assert!(error.contains(problem) && error.lines().count() == 1, "{error}");
    }
}

#[test]
fn joints_beside_those_of_the_legs_are_welded() {
    // An arm of 0.4 + 0.2 kg whose upper part leans forward by 0.5 rad in the keyframe, and a motor.
    let arm = "<body name='arm' pos='0 0 0.1'><inertial pos='0 0 0.2' mass='0.4' diaginertia='1e-3 1e-3 1e-4'/>\
               <joint name='arm_1' axis='0 1 0'/><body name='hand' pos='0 0 0.3'><joint name='arm_2' type='ball'/>\
               <inertial pos='0 0 0' mass='0.2' diaginertia='1e-4 1e-4 1e-4'/></body></body>";
    let key = "<keyframe><key name='home' qpos='0 0 1 1 0 0 0  0.5 1 0 0 0  0 .6 -1.2  0 .6 -1.2  0 .6 -1.2  0 .6 -1.2'/></keyframe>\
               <actuator><motor joint='arm_1'/></actuator>";
    let armed = Foreign { parts: arm, after: key, ..foreign() };
    let error = armed.complaint();
    assert!(error.contains("joints beside those of four legs: arm_1, arm_2; name them under weld"), "{error}");
    let robot = described(&armed, "weld: [arm_1, arm_2]").unwrap();
    assert!((robot.mass_kg - 14.2).abs() < 1e-9 && (height(&robot) - HEIGHT).abs() < 1e-6, "{}", robot.mass_kg);
    let report = &robot.report;
    assert!(report.contains(&"welded: arm_1, arm_2, at the angles of its keyframe".to_owned()), "{report:?}");
    let mut sim = supple::mujoco::Data::new(Scene::flat(Arc::clone(&robot), 1.0 / 240.0).compile().unwrap()).unwrap();
    sim.step1().unwrap();
    let place = |name: &str| {
        let body = sim.model().id(Object::Body, name).unwrap();
        [0, 2].map(|k| sim.body_positions()[3 * body + k])
    };
    let ([x, z], [trunk_x, trunk_z]) = (place("robot/hand"), place("trunk"));
    assert!((x - trunk_x - 0.3 * 0.5_f64.sin()).abs() < 1e-9, "{x}");
    assert!((z - trunk_z - 0.1 - 0.3 * 0.5_f64.cos()).abs() < 1e-9, "{z}");
    let beginning = described(&armed, "weld: [arm_*]").unwrap();
    assert_eq!(beginning.stand, robot.stand);
    assert_ne!(beginning.sha256(), robot.sha256(), "its key is a part of its identity");
    for (weld, problem) in [
        (
            "[arm_3]",
            "weld has 'arm_3', expected the name of a joint, or the beginning of names with a * behind it; its joints are: arm_1",
        ),
        ("[arm_1]", "joints beside those of four legs: arm_2"),
        ("[arm_*, FR_calf_joint]", "it has no joint 'FR_calf'"),
    ] {
        let error = described(&armed, &format!("weld: {weld}")).unwrap_err();
        assert!(error.contains(problem), "{error}");
    }
    // A URDF of a robot with wheels where its feet would be.
    let fixed = urdf("<cylinder radius='0.02' length='0.02'/>");
    let wheels = fixed.replace("_foot_fixed' type='fixed'>", "_foot_wheel' type='continuous'><axis xyz='0 1 0'/>");
    let welded = |weld| {
        let yaml = format!("mjcf: wheels.urdf\nweld: [FL_foot_wheel, FR_foot_wheel, {weld}]\n");
        load(&[("wheels.urdf", &wheels), ("wheels.yaml", &yaml)])
    };
    assert!(welded("R*_wheel").unwrap_err().contains("weld has 'R*_wheel'"));
    let (fixed, welded) = (load(&[("fixed.urdf", &fixed)]).unwrap(), welded("RL_f*, RR_f*").unwrap());
    assert_eq!((welded.mjcf(), welded.mass_kg), (fixed.mjcf(), fixed.mass_kg));
}

#[test]
fn every_part_whose_inertia_changes_is_named() {
    let line = |robot: &Robot, word: &str| robot.report.iter().find(|line| line.contains(word)).cloned();
    let settings = |compiler| line(&Foreign { compiler, ..foreign() }.robot(), "compiler settings").unwrap();
    let change = "masses and inertias: its compiler settings change";
    assert_eq!(settings("angle='radian' boundmass='0.2'"), format!("{change} no part"));
    let calves = "'FL_calf', 'FR_calf', 'RL_calf', 'RR_calf'";
    assert_eq!(settings("angle='radian' boundmass='0.35'"), format!("{change} {calves}"));
    let unbalanced =
        |text: String| text.replace("diaginertia='0.002 0.002 0.0001'", "diaginertia='0.001 0.002 0.0001'");
    let own = Foreign { compiler: "angle='radian' balanceinertia='true'", ..foreign() };
    assert_eq!(line(&read(&unbalanced(own.mjcf())).unwrap(), "settings").unwrap(), format!("{change} {calves}"));
    let text = urdf("<sphere radius='0.02'/>").replace("ixx='0.002' iyy='0.002'", "ixx='0.001' iyy='0.002'");
    let expected = format!("inertia of {calves}: physically impossible (A + B < C); its three moments made equal");
    assert_eq!(line(&load(&[("robot.urdf", &text)]).unwrap(), "inertia of"), Some(expected));
}

#[test]
fn robots_without_welded_joints_keep_their_identity() {
    // Found at 23f0079, before `weld` was a key: policies name their robots by it.
    for (robot, sha256) in [
        ("renamed.yaml", "a69b0792cd9231c595c2cba6e6db0a52260ecf7b7d25b1caa36a9594b3036930"),
        ("quadruped.xml", "5ceddde51a1a44de8646145908f8c24c8683b507551ebf24856076d53c267a02"),
    ] {
        let path = crate::support::repository("tests/fixtures/robot").join(robot);
        assert_eq!(Robot::load(path.to_str().unwrap()).unwrap().sha256(), sha256, "{robot}");
    }
}

#[test]
fn a_urdf_that_cannot_be_read_is_refused_by_its_lines() {
    let complaint = |text: &str| load(&[("robot.urdf", text)]).unwrap_err();
    let mesh = complaint(&urdf("<mesh filename='package://r/foot.stl'/>"));
    assert!(mesh.contains("nothing on the calf of leg FR collides") && mesh.contains("URDF"), "{mesh}");
    let heavy = complaint(&urdf("<sphere radius='0.02'/>").replacen("<mass value='0.4'/>", "<mass value='x'/>", 1));
    assert!(heavy.contains("line 6, ") && heavy.contains("MuJoCo refuses it"), "{heavy}");
    let two = complaint(&urdf("<sphere radius='0.02'/>").replace("<gazebo", "<link name='other'/><gazebo"));
    assert!(two.contains("its links have 2 roots, expected one"), "{two}");
    let xacro = "<robot xmlns:xacro='http://x' name='r'><xacro:include filename='leg.xacro'/><link name='a'/></robot>";
    assert!(complaint(xacro).contains("it is a xacro, expected a URDF"), "{}", complaint(xacro));
    assert!(complaint("<sdf/>").contains("its root element is <sdf>, expected <mujoco> (MJCF) or <robot> (URDF)"));
}

#[test]
fn programs_take_a_urdf_and_robots_without_limits() {
    let folder = with_small_config();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("robot.urdf", &urdf("<cylinder radius='0.02' length='0.02'/>"));
    write("free.xml", &Foreign { ranges: [""; 3], ..foreign() }.mjcf());
    for (robot, words) in [("robot.urdf", "feet: cylinders"), ("free.xml", "none ")] {
        let shown = success(run("policy", folder.path(), &["robot", robot]));
        let text = String::from_utf8_lossy(&shown.stdout);
        assert!(text.contains(words) && text.contains("13.600 kg"), "{text}");
    }
    // A policy's file states the ranges of its robot's joints, infinite ones too.
    let arguments = ["--config", "small.yaml", "--robot", "free.xml", "--samples", "256", "--out", "r"];
    success(run("train", folder.path(), &arguments));
    let shown = success(run("policy", folder.path(), &["show", "r"]));
    assert!(String::from_utf8_lossy(&shown.stdout).contains("none"));
}
