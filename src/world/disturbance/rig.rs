/*! Loads on ropes: a weight over a pulley, a ball on a string.

A rope is a MuJoCo tendon whose length is limited: it pulls when it is taut and does nothing when it is slack, and the
load at its end is a free body with its own inertia. Until the release, the whole rig moves along with the robot and
the load's weight is carried. At the release the rig stays where it is, aimed at the robot's predicted position. An aim
at the start of the playback would miss a robot that walks: in two or three seconds the best policy is off its course by
more than a trunk is wide.
*/

use std::borrow::Cow;

use nalgebra::{Rotation2, Vector2, Vector3};
use serde::{Deserialize, Serialize};

use super::{Event, StepTime};
use crate::mujoco::{self, Data, Object};
use crate::observation::Command;
use crate::robot::RobotState;
use crate::sim::{Buffers, Scene, Sim};

/// Name of the rope's tendon.
const ROPE: &str = "rope";

/// A length beyond that of any rope \[m\].
const ENDLESS_M: f64 = 1000.0;

/// Softness of ropes: MuJoCo's shortest stable time constant at 240 Hz is 8.3 ms. Under the weight of its load a rope
/// stretches by a tenth of a millimetre.
const ROPE_LIMIT: &str = r#"limited="true" range="0 1000" solreflimit="0.01 1" solimplimit="0.95 0.99 0.001""#;

/// A rope with a load, and the time in which it acts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Rig {
    /// Site of the robot where the rope begins; `None` if it begins at the first holder.
    pub from: Option<Cow<'static, str>>,
    /// Holders that the rope passes over, in order from the robot.
    pub holders: Vec<Holder>,
    /// Load at the end of the rope.
    pub load: Load,
    /// True if heights count from the trunk's origin instead of the ground.
    pub is_level_with_trunk: bool,
    /// Length of the rope beyond the taut length at the release \[m\].
    pub slack_m: f64,
    /// Time after the release for which the robot's position is predicted to aim the rig \[s\].
    pub lead_s: f64,
    /// Time of the release \[s\].
    pub release_s: f64,
    /// Time at which the rope is removed \[s\].
    pub until_s: f64,
}

/// A bead that supports the rope and collides with nothing. Its body and its site have its name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Holder {
    /// Name of the holder's body and site.
    pub name: Cow<'static, str>,
    /// Position relative to the aim: ahead, left, height \[m\].
    pub place: [f64; 3],
    /// Radius of the bead in drawings \[m\].
    pub radius_m: f64,
    /// True if the holder is drawn on a post.
    pub has_post: bool,
}

/// A free body at the rope's end. Its joint, geometry and site have its name, too.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Load {
    /// Name of the load, also used in events.
    pub name: Cow<'static, str>,
    /// Position at the release, relative to the aim: ahead, left, height \[m\].
    pub place: [f64; 3],
    /// Mass of the load \[kg\].
    pub mass_kg: f64,
    /// Shape of the load.
    pub shape: LoadShape,
}

/// Shape of a load.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LoadShape {
    /// A cube of half this edge \[m\].
    Cube(f64),
    /// A ball of this radius \[m\].
    Ball(f64),
}

impl Rig {
    /// Adds the rig's bodies and its rope to a scene.
    pub fn hang_in(&self, scene: &mut Scene) {
        scene.obstacles = self.bodies();
        scene.extras = self.rope();
        scene.buffers = Buffers { contacts: 64, rows: 400, stack: 100_000 };
    }

    /// Iterates over the sites that the rope passes through.
    fn path(&self) -> impl Iterator<Item = &str> {
        let holders = self.holders.iter().map(|holder| &holder.name);
        self.from.iter().chain(holders).chain([&self.load.name]).map(Cow::as_ref)
    }

    /// Returns the MJCF of holders and load.
    fn bodies(&self) -> String {
        // Places until the first step; high enough to touch nothing.
        let lift_m = if self.is_level_with_trunk { 1.0 } else { 0.0 };
        let at = |[x, y, z]: [f64; 3]| format!("{x} {y} {}", z + lift_m);
        let mut bodies = String::new();
        for Holder { name, place, radius_m, has_post } in &self.holders {
            let height_m = place[2];
            let post = format!(
                r#"
      <geom name="post" type="capsule" size="0.02" contype="0" conaffinity="0" rgba="0.42 0.45 0.5 1"
            fromto="0 0 0 0 0 -{height_m}"/>"#
            );
            bodies += &format!(
                r#"    <body name="{name}" mocap="true" pos="{place}">
      <geom name="{name}" type="sphere" size="{radius_m}" contype="0" conaffinity="0" rgba="0.55 0.58 0.62 1"/>{post}
      <site name="{name}"/>
    </body>
"#,
                place = at(*place),
                post = if *has_post { &post } else { "" },
            );
        }
        let Load { name, place, mass_kg, shape } = &self.load;
        let shape = match shape {
            LoadShape::Cube(half) => format!(r#"type="box" size="{half} {half} {half}""#),
            LoadShape::Ball(radius) => format!(r#"type="sphere" size="{radius}""#),
        };
        bodies
            + &format!(
                r#"    <body name="{name}" pos="{place}">
      <freejoint name="{name}"/>
      <geom name="{name}" {shape} mass="{mass_kg}" priority="1" friction="0.6 0.005 0.0001"
            rgba="0.80 0.47 0.65 1"/>
      <site name="{name}"/>
    </body>
"#,
                place = at(*place),
            )
    }

    /// Returns the MJCF of the rope.
    fn rope(&self) -> String {
        let sites: String = self.path().map(|site| format!("<site site=\"{site}\"/>")).collect();
        format!("  <tendon><spatial name=\"{ROPE}\" {ROPE_LIMIT}>{sites}</spatial></tendon>\n")
    }
}

/// A rope with a load in a policy step.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Rope {
    /// Points of the rope from end to end over pulleys, world frame \[m\].
    pub points: Vec<[f32; 3]>,
    /// Pulling force, mean over the step's physics steps \[N\].
    pub force_n: f64,
    /// Largest pulling force in the step \[N\].
    pub peak_force_n: f64,
    /// Smallest pulling force in the step, never below zero \[N\].
    pub least_force_n: f64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Phase {
    Carried,
    Free,
    Off,
}

/// The memory of a rig.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(in crate::world) struct Memory {
    tendon: usize,
    load: usize,
    load_geom: usize,
    load_position: usize,
    load_velocity: usize,
    /// Indices of the holders among the mocap bodies.
    holders: Vec<usize>,
    sites: Vec<usize>,
    phase: Phase,
    has_hit: bool,
    is_grounded: bool,
    /// Speed of the load before the step [m/s].
    speed_m_s: f64,
    #[serde(skip)] // Empty between policy steps.
    forces: RopeForces,
}

impl Memory {
    /// Looks up the rig's parts in the model.
    pub(super) fn new(rig: &Rig, sim: &Sim) -> mujoco::Result<Self> {
        let model = sim.data().model();
        let load = &rig.load.name;
        let joint = model.id(Object::Joint, load)?;
        let holder = |name: &str| {
            let body = model.id(Object::Body, name)?;
            model.mocap_index(body).ok_or_else(|| mujoco::Error::Name {
                kind: "body moved from outside",
                name: name.to_owned(),
                known: "bodies with mocap=\"true\"".to_owned(),
            })
        };
        Ok(Memory {
            tendon: model.id(Object::Tendon, ROPE)?,
            load: model.id(Object::Body, load)?,
            load_geom: model.id(Object::Geom, load)?,
            load_position: model.joint_position_index(joint),
            load_velocity: model.joint_velocity_index(joint),
            holders: rig.holders.iter().map(|it| holder(&it.name)).collect::<mujoco::Result<_>>()?,
            sites: rig.path().map(|name| model.id(Object::Site, name)).collect::<mujoco::Result<_>>()?,
            phase: Phase::Carried,
            has_hit: false,
            is_grounded: false,
            speed_m_s: 0.0,
            forces: RopeForces::default(),
        })
    }

    /// Notes the rope's force in a physics step.
    pub(in crate::world) fn measure(&mut self, data: &Data) {
        self.forces.add(data.tendon_limit_force(self.tendon));
    }

    /// Carries the rig, releases the load or removes the rope, as is due before the policy step that begins at `at`.
    pub(super) fn before_step(
        &mut self,
        rig: &Rig,
        at: StepTime,
        command: &Command,
        sim: &mut Sim,
        events: &mut Vec<Event>,
    ) -> mujoco::Result<()> {
        if self.phase == Phase::Carried {
            self.place(rig, command, sim)?;
            if at.has_come(rig.release_s) {
                self.phase = Phase::Free;
                // The load starts at the speed at which a walking robot draws the rope: a stiff rope would jerk a load at rest.
                let rising_m_s = sim.data().tendon_velocities()[self.tendon];
                sim.data_mut().velocities_mut()[self.load_velocity + 2] = rising_m_s;
                let length_m = sim.data().tendon_lengths()[self.tendon] + rig.slack_m;
                self.set_rope(sim, length_m, 0.0)?;
                events.push(Event::disturbance(at.time_s, format!("the {} is let go", rig.load.name)));
            }
        } else if self.phase == Phase::Free && at.has_come(rig.until_s) {
            self.phase = Phase::Off;
            self.set_rope(sim, ENDLESS_M, 0.0)?;
            events.push(Event::disturbance(at.time_s, "the rope is taken off"));
        }
        let velocity = &sim.data().velocities()[self.load_velocity..];
        self.speed_m_s = velocity[..3].iter().map(|v| v * v).sum::<f64>().sqrt();
        Ok(())
    }

    /// Returns the rope after the step that ends at `time_s`, and adds events of the load. `touched` is a part of the robot
    /// that touched an obstacle.
    pub(in crate::world) fn after_step(
        &mut self,
        rig: &Rig,
        sim: &Sim,
        time_s: f64,
        touched: Option<usize>,
        events: &mut Vec<Event>,
    ) -> Rope {
        let data = sim.data();
        if let (false, Some(part)) = (self.has_hit, touched) {
            self.has_hit = true;
            let model = data.model();
            let part = model.name(Object::Body, model.geom_body(part));
            let text = format!("the {} hits {part} at {:.2} m/s", rig.load.name, self.speed_m_s);
            // Disturbances are dated at the beginning of their step.
            events.push(Event::disturbance(time_s - sim.policy_period_s(), text));
        }
        let on_ground = |contact: mujoco::Contact| {
            contact.geoms.contains(&self.load_geom) && contact.geoms.contains(&sim.parts().ground())
        };
        if !self.is_grounded && self.phase == Phase::Free && data.contacts().any(on_ground) {
            self.is_grounded = true;
            let text = format!("the {} is on the ground", rig.load.name);
            events.push(Event::disturbance(time_s, text));
        }
        // A rope that was taken off is not drawn; its load is.
        let sites = if self.phase == Phase::Off { &[] } else { self.sites.as_slice() };
        let forces = std::mem::take(&mut self.forces);
        let point = |site: &usize| std::array::from_fn(|k| data.site_positions()[3 * site + k] as f32);
        let points = sites.iter().map(point).collect();
        Rope { points, force_n: forces.mean_n(), peak_force_n: forces.peak_n, least_force_n: forces.least_n }
    }

    /// Places holders and load around the robot's predicted position, at rest, with the load's weight carried.
    fn place(&self, rig: &Rig, command: &Command, sim: &mut Sim) -> mujoco::Result<()> {
        let state = sim.state();
        let (aim, heading) = aim(&state, command, rig.lead_s);
        let level = if rig.is_level_with_trunk { state.position.z } else { sim.ground().height(aim.x, aim.y) };
        let at = |[ahead, left, height]: [f64; 3]| {
            let place = aim + heading * Vector2::new(ahead, left);
            [place.x, place.y, level + height]
        };
        let data = sim.data_mut();
        for (mocap, holder) in self.holders.iter().zip(&rig.holders) {
            data.mocap_positions_mut()[3 * mocap..3 * mocap + 3].copy_from_slice(&at(holder.place));
        }
        let start = self.load_position;
        data.positions_mut()[start..start + 3].copy_from_slice(&at(rig.load.place));
        data.velocities_mut()[self.load_velocity..self.load_velocity + 6].fill(0.0);
        let weight_n = -rig.load.mass_kg * sim.data().model().gravity()[2];
        self.set_rope(sim, ENDLESS_M, weight_n)
    }

    /// Sets the rope's length and the force that carries the load.
    fn set_rope(&self, sim: &mut Sim, longest_m: f64, bearing_n: f64) -> mujoco::Result<()> {
        let data: &mut Data = sim.data_mut();
        data.set_longest_tendon(self.tendon, longest_m);
        data.applied_forces_mut()[6 * self.load + 2] = bearing_n;
        sim.refresh()
    }
}

impl Rope {
    /// Returns the force on the trunk of a rope that begins there, world frame \[N\].
    pub(in crate::world) fn pull(&self) -> Vector3<f64> {
        let Some([from, to]) = self.points.first_chunk::<2>() else { return Vector3::zeros() };
        let along = Vector3::from(to.map(f64::from)) - Vector3::from(from.map(f64::from));
        self.force_n * along.try_normalize(1e-9).unwrap_or_default()
    }
}

/// Predicts the robot's position after `lead_s` of the commanded walk; also returns its heading.
fn aim(state: &RobotState, command: &Command, lead_s: f64) -> (Vector2<f64>, Rotation2<f64>) {
    let (_, _, yaw) = state.roll_pitch_yaw();
    let heading = Rotation2::new(yaw);
    let walked = heading * Vector2::new(command.forward, command.left) * lead_s;
    (state.position.xy() + walked, heading)
}

/// Forces of a rope or a spring over the physics steps of a policy step.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct RopeForces {
    sum_n: f64,
    count: u32,
    peak_n: f64,
    least_n: f64,
}

impl RopeForces {
    /// Adds the force of a physics step.
    pub(super) fn add(&mut self, force_n: f64) {
        self.sum_n += force_n;
        self.peak_n = self.peak_n.max(force_n);
        self.least_n = if self.count == 0 { force_n } else { self.least_n.min(force_n) };
        self.count += 1;
    }

    /// Returns the largest force \[N\].
    pub(super) fn peak_n(&self) -> f64 {
        self.peak_n
    }

    pub(super) fn mean_n(&self) -> f64 {
        self.sum_n / f64::from(self.count.max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mujoco::Model;

    /// Creates a block of 12 kg that slides along x without friction, 4 m from a pulley over which a weight of 1 kg
    /// hangs.
    fn block_and_weight() -> Data {
        let xml = format!(
            r#"<mujoco>
  <option timestep="0.004166666666666667" integrator="Euler"/>
  <tendon><spatial name="rope" {ROPE_LIMIT}><site site="hook"/><site site="pulley"/><site site="weight"/></spatial></tendon>
  <worldbody>
    <site name="pulley" pos="4 0 3"/>
    <body name="block" pos="0 0 3"><joint name="block" type="slide" axis="1 0 0"/>
      <geom name="block" type="box" size="0.1 0.1 0.1" mass="12"/><site name="hook"/></body>
    <body name="weight" pos="4 0 2"><freejoint name="weight"/>
      <geom name="weight" type="box" size="0.03 0.03 0.03" mass="1"/><site name="weight"/></body>
  </worldbody>
</mujoco>"#
        );
        let mut data = Data::new(Model::from_xml(&[("rope.xml", &xml)]).unwrap()).unwrap();
        data.set_longest_tendon(0, 5.0);
        data
    }

    #[test]
    fn a_weight_pulls_a_free_block_with_its_own_inertia_in_the_way() {
        let mut data = block_and_weight();
        let mut at_one_second = 0.0;
        for step in 0..240 {
            data.step1().unwrap();
            data.step2().unwrap();
            if step == 119 {
                at_one_second = data.velocities()[0];
            }
        }
        // m g / (M + m) = 9.81 / 13 = 0.7546 m/s²; over the second half-second, when the rope has been taut for long.
        let acceleration = (data.velocities()[0] - at_one_second) / 0.5;
        assert!((acceleration / (9.81 / 13.0) - 1.0).abs() < 0.005, "{acceleration}");
        // The rope's force is that which accelerates the block: 12 · 0.7546 = 9.055 N, less than the weight's 9.81 N.
        assert!((data.tendon_limit_force(0) / (12.0 * 9.81 / 13.0) - 1.0).abs() < 0.01);
    }

    #[test]
    fn at_rest_the_rope_carries_the_weight_and_hardly_stretches() {
        let mut data = block_and_weight();
        for _ in 0..480 {
            // The block is held in place.
            data.velocities_mut()[0] = 0.0;
            data.positions_mut()[0] = 0.0;
            data.step1().unwrap();
            data.step2().unwrap();
        }
        let stretch_m = data.tendon_lengths()[0] - 5.0;
        assert!((data.tendon_limit_force(0) - 9.81).abs() < 0.05, "{}", data.tendon_limit_force(0));
        assert!(stretch_m > 0.0 && stretch_m < 0.001, "{stretch_m}");
    }

    #[test]
    fn a_slack_rope_does_nothing() {
        let mut data = block_and_weight();
        data.set_longest_tendon(0, 6.0);
        for _ in 0..60 {
            data.step1().unwrap();
            data.step2().unwrap();
            assert_eq!(data.tendon_limit_force(0), 0.0);
        }
        // A quarter of a second of free fall: 0.5 · 9.81 · 0.25² = 0.307 m.
        assert!((data.positions()[3] - (2.0 - 0.307)).abs() < 0.01, "{}", data.positions()[3]);
        assert_eq!(data.positions()[0], 0.0);
    }

    #[test]
    fn a_ball_on_a_string_reaches_the_speed_of_its_fall() {
        for height_m in [0.1_f64, 0.5, 1.0] {
            let away_m = (1.0 - (1.0 - height_m).powi(2)).sqrt();
            let xml = format!(
                r#"<mujoco>
  <option timestep="0.004166666666666667" integrator="Euler"/>
  <tendon><spatial name="rope" {ROPE_LIMIT}><site site="pivot"/><site site="ball"/></spatial></tendon>
  <worldbody>
    <site name="pivot" pos="0 0 2"/>
    <body name="ball" pos="{away_m} 0 {z}"><freejoint name="ball"/>
      <geom name="ball" size="0.1" mass="3"/><site name="ball"/></body>
  </worldbody>
</mujoco>"#,
                z = 1.0 + height_m,
            );
            let mut data = Data::new(Model::from_xml(&[("ball.xml", &xml)]).unwrap()).unwrap();
            data.set_longest_tendon(0, 1.0);
            while data.positions()[0] > 0.0 {
                data.step1().unwrap();
                data.step2().unwrap();
            }
            let speed = data.velocities()[0].hypot(data.velocities()[2]);
            let expected = (2.0 * 9.81 * height_m).sqrt();
            assert!((speed / expected - 1.0).abs() < 0.02, "from {height_m} m: {speed}, expected {expected}");
        }
    }
}
