//! A robot as other programs write them, to be changed by tests.

use std::sync::Arc;

use supple::config::Config;
use supple::robot::{Joints, Robot};
use supple::sim::{Conditions, Scene, Sim};

/// A quadruped of 13.6 kg: thighs and calves of 0.22 m, feet of 20 mm, motors of 25 N·m, knees bent by 1.2 rad.
pub struct Foreign {
    /// Name, and where its hip is \[m\].
    pub legs: &'static [(&'static str, f64, f64)],
    pub compiler: &'static str,
    /// Sections before the world.
    pub sections: &'static str,
    pub trunk: &'static str,
    /// Elements of the trunk beside its legs.
    pub parts: &'static str,
    /// Attributes of every joint.
    pub joint: &'static str,
    pub ranges: [&'static str; 3],
    /// The foot, in the frame of the calf.
    pub foot: &'static str,
    /// Attributes of every calf's body.
    pub calf: &'static str,
    /// An actuator of a joint, with `{}` for its name.
    pub actuator: &'static str,
    /// Sections after the actuators.
    pub after: &'static str,
}

/// Height of the trunk: 0.44 cos 0.6 + 0.02 \[m\].
pub const HEIGHT: f64 = 0.383_147_7;

pub const LEGS: [(&str, f64, f64); 4] =
    [("FL", 0.2, 0.06), ("FR", 0.2, -0.06), ("RL", -0.2, 0.06), ("RR", -0.2, -0.06)];

const KEY: &str =
    "<keyframe><key name='home' qpos='0 0 1 1 0 0 0  0 .6 -1.2  0 .6 -1.2  0 .6 -1.2  0 .6 -1.2'/></keyframe>";

pub fn foreign() -> Foreign {
    let (legs, compiler, trunk) = (&LEGS, "angle='radian'", "name='base'");
    let ranges = ["range='-0.7 0.7'", "range='-1 3'", "range='-2.6 -0.5'"];
    let (foot, calf) = ("<geom name='{}_foot' size='0.02' pos='0 0 -0.22'/>", "pos='0 0 -0.22'");
    let actuator = "<motor joint='{}' ctrlrange='-25 25'/>";
    Foreign { legs, compiler, sections: "", trunk, parts: "", joint: "", ranges, foot, calf, actuator, after: KEY }
}

impl Foreign {
    /// Writes the robot, one element on a line from line 5.
    pub fn mjcf(&self) -> String {
        let (mut bodies, mut actuators) = (String::new(), String::new());
        let Foreign { joint, ranges: [hip, thigh, calf], .. } = self;
        for (leg, x, y) in self.legs {
            bodies.push_str(&format!(
                "<body name='{leg}_hip' pos='{x} {y} 0'>\n\
                 <inertial pos='0 0 0' mass='0.4' diaginertia='0.0006 0.0006 0.0006'/>\n\
                 <joint name='{leg}_hip_joint' axis='1 0 0' {hip} {joint}/>\n\
                 <body name='{leg}_thigh' pos='0 {side} 0'>\n\
                 <inertial pos='0 0 -0.1' mass='0.7' diaginertia='0.004 0.004 0.0005'/>\n\
                 <joint name='{leg}_thigh_joint' axis='0 1 0' {thigh} {joint}/>\n\
                 <geom type='capsule' size='0.02' fromto='0 0 -0.04 0 0 -0.18'/>\n\
                 <body name='{leg}_calf' {on}>\n\
                 <inertial pos='0 0 -0.1' mass='0.3' diaginertia='0.002 0.002 0.0001'/>\n\
                 <joint name='{leg}_calf_joint' axis='0 1 0' {calf} {joint}/>\n\
                 {foot}\n\
                 </body></body></body>\n",
                side = 1.4 * y,
                on = self.calf,
                foot = self.foot.replace("{}", leg),
            ));
            for part in ["hip", "thigh", "calf"] {
                actuators.push_str(&self.actuator.replace("{}", &format!("{leg}_{part}_joint")));
            }
        }
        format!(
            "<mujoco>\n<compiler {}/>\n{}<worldbody>\n<body {} pos='0 0 1'><freejoint/>\n\
             <inertial pos='0 0 0' mass='8' diaginertia='0.04 0.1 0.12'/>\n<geom type='box' size='0.22 0.07 0.05'/>{}\n{bodies}\
             </body></worldbody>\n<actuator>{actuators}</actuator>\n{}\n</mujoco>\n",
            self.compiler, self.sections, self.trunk, self.parts, self.after
        )
    }

    /// Reads the robot.
    pub fn robot(&self) -> Arc<Robot> {
        read(&self.mjcf()).unwrap_or_else(|error| panic!("{error}"))
    }

    /// Returns why the robot is refused.
    pub fn complaint(&self) -> String {
        read(&self.mjcf()).unwrap_err()
    }
}

pub fn read(text: &str) -> Result<Arc<Robot>, String> {
    load(&[("robot.xml", text)])
}

/// Reads a robot with a YAML description.
pub fn described(robot: &Foreign, yaml: &str) -> Result<Arc<Robot>, String> {
    load(&[("robot.xml", &robot.mjcf()), ("robot.yaml", &format!("mjcf: robot.xml\n{yaml}\n"))])
}

/// Writes files, and reads a robot from the last of them.
pub fn load(files: &[(&str, &str)]) -> Result<Arc<Robot>, String> {
    let folder = tempfile::tempdir().unwrap();
    let write = |(name, text): &(&str, &str)| {
        let path = folder.path().join(name);
        std::fs::write(&path, text).map(|()| path).unwrap()
    };
    let paths: Vec<_> = files.iter().map(write).collect();
    Robot::load(paths[paths.len() - 1].to_str().unwrap()).map_err(|error| error.to_string())
}

pub fn height(robot: &Robot) -> f64 {
    robot.standing_height_m(&robot.nominal_pose)
}

/// Returns the robot in its nominal pose on flat ground, as a configuration has it, and the pose.
pub fn standing(robot: Arc<Robot>, config: &Config, fall_height_m: f64) -> (Sim, Joints) {
    let scene = Scene::flat(robot, config.simulation.timestep_s());
    let mut sim = Sim::new(&scene, &config.simulation, fall_height_m).unwrap();
    let conditions = Conditions { gravity: [0.0, 0.0, -9.81], friction: 0.8, encoder_bias: [0.0; 12] };
    let pose = config.action.nominal_pose_rad.joints();
    sim.reset(conditions, &pose).unwrap();
    (sim, pose)
}
