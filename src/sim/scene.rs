/*! Scenes: compiles a robot, a ground and obstacles into one model.

MuJoCo 2.2.2 has no arena: the buffers for contacts, constraint rows and the stack are fixed when the model is compiled. If they are too
small, a crowded scene loses contacts; if too large, a small scene does not stay in cache. The scene knows its content, so it sets their
sizes.

Contact masks: robot parts carry contype 1 / conaffinity 2 and never meet each other; grounds and obstacles keep MuJoCo's 1 / 1 and meet
both the robot and one another. They have priority 1, so that their friction applies.

A robot alone on a plane can touch nothing but the plane. There, and on the uneven ground of training, the scene lists the
pairs that may touch, and MuJoCo does not look for them among all bodies: the same contacts, a quarter more steps per second.
*/

use std::cell::RefCell;
use std::fmt::Write as _;
use std::sync::Arc;

use super::ground::{Ground, HeightField};
use super::look;
use crate::mujoco::{Model, Object, Result, VERSION};
use crate::robot::Robot;

/// Name of the ground's geometry.
pub const GROUND: &str = "ground";

/// Name under which the scene includes the robot.
const ROBOT: &str = "robot.xml";

/// Friction of the ground: sliding, torsional, rolling.
pub(super) const FRICTION: [f64; 3] = [0.8, 0.005, 0.0001];

/// Sizes of MuJoCo's fixed buffers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Buffers {
    /// Maximum number of contact points, `nconmax`.
    pub contacts: usize,
    /// Maximum number of constraint rows, `njmax`.
    pub rows: usize,
    /// Size of the stack \[numbers\], `nstack`.
    pub stack: usize,
}

/// A robot on a ground among obstacles.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The robot in the scene.
    pub robot: Arc<Robot>,
    /// Mass that the trunk has beyond the robot's description, which policies and force observers do not take into account \[kg\].
    pub extra_mass_kg: f64,
    /// Rolling friction of robot and ground \[m\]; 0: contacts do not resist rolling or turning (`condim` 3).
    pub rolling_m: f64,
    /// The ground that the robot walks on.
    pub ground: Ground,
    /// Duration of a physics step \[s\].
    pub timestep_s: f64,
    /// MJCF elements of the world body in addition to robot and ground, each named.
    pub obstacles: String,
    /// MJCF elements outside the world body (tendons, equalities); empty if there are none.
    pub extras: String,
    /// True lists the pairs that may touch also on uneven ground, for a robot alone on it; friction must not vary by place.
    pub lists_pairs: bool,
    /// Attributes of `<option>` that choose another solver; empty for Newton.
    pub solver: &'static str,
    /// Sizes of MuJoCo's buffers for this scene.
    pub buffers: Buffers,
}

thread_local! {
    /// The scene that this thread compiled last: evaluations play thousands of trials in one, and compiling it each
    /// time took 4 % of their time. It is local to the thread, so that threads do not wait for each other.
    static LAST: RefCell<Option<(Scene, Model)>> = const { RefCell::new(None) };
}

impl Scene {
    /// Creates the training scene: the robot alone on a plane.
    pub fn flat(robot: Arc<Robot>, timestep_s: f64) -> Self {
        let (ground, obstacles, extras, solver) = (Ground::Flat, String::new(), String::new(), "");
        let buffers = Buffers { contacts: 40, rows: 280, stack: 30_000 };
        let (extra_mass_kg, rolling_m, lists_pairs) = (0.0, 0.0, false);
        Scene { robot, extra_mass_kg, rolling_m, ground, timestep_s, obstacles, extras, lists_pairs, solver, buffers }
    }

    /// Compiles the scene for simulation, without geometries that are only for display, which nearly halves the cost of
    /// a step and changes no physics. Compiling the same scene again costs only a copy.
    ///
    /// # Errors
    /// The scene does not compile; the error has MuJoCo's message.
    pub fn compile(&self) -> Result<Model> {
        LAST.with_borrow_mut(|last| {
            if let Some((_, model)) = last.as_ref().filter(|(scene, _)| scene == self) {
                return model.try_clone();
            }
            let model = self.compile_xml(&self.xml(true))?;
            let copy = model.try_clone()?;
            *last = Some((self.clone(), model));
            Ok(copy)
        })
    }

    /// Compiles the scene for display. Bodies and joints are those of [`Scene::compile`].
    ///
    /// # Errors
    /// The scene does not compile; the error has MuJoCo's message.
    pub fn compile_visual(&self) -> Result<Model> {
        self.compile_xml(&self.xml(false))
    }

    fn compile_xml(&self, scene: &str) -> Result<Model> {
        let mut model = Model::from_xml(&[("scene.xml", scene), (ROBOT, self.robot.mjcf())])?;
        if self.has_pairs() {
            model.collide_pairs_only();
        }
        if let Ground::Field(field) = &self.ground {
            let [low, high] = field.range();
            let id = model.id(Object::HeightField, GROUND)?;
            let elevations = field.heights.iter().map(|height| ((height - low) / (high - low).max(1e-9)) as f32);
            model.height_field_mut(id).iter_mut().zip(elevations).for_each(|(to, from)| *to = from);
        }
        Ok(model)
    }

    /// Returns the MJCF text that MuJoCo compiles; it includes the robot.
    pub fn xml(&self, discard_visual: bool) -> String {
        let Buffers { contacts, rows, stack } = self.buffers;
        let rows = if self.rolling_m > 0.0 { rows * 3 / 2 } else { rows };
        let [settings, sun] = if discard_visual { ["", ""] } else { [look::SETTINGS, look::SUN] };
        let mut xml = String::new();
        // Writing into a String cannot fail.
        let _ = write!(
            xml,
            r#"<mujoco model="supple">
  <include file="{ROBOT}"/>
  <compiler discardvisual="{discard_visual}"/>
  <size njmax="{rows}" nconmax="{contacts}" nstack="{stack}"/>
  <option timestep="{timestep}" integrator="Euler" {cone} {solver}/>
{settings}{pairs}{assets}{extras}  <worldbody>
    {ground}
{sun}{obstacles}  </worldbody>
</mujoco>
"#,
            timestep = self.timestep_s,
            // The pyramid's small friction is too soft to hold a rolling foot: it lets a tenth of the moment through.
            cone = if self.rolling_m > 0.0 { r#"cone="elliptic" impratio="100""# } else { r#"cone="pyramidal""# },
            solver = self.solver,
            pairs = self.pairs(),
            assets = self.ground_asset(),
            extras = self.extras,
            ground = self.ground_geom(discard_visual),
            obstacles = self.obstacles,
        );
        xml
    }

    /// Returns true where the pairs of geometries that may touch are listed: for a robot alone on a plane, or if `lists_pairs` is true.
    fn has_pairs(&self) -> bool {
        (self.ground == Ground::Flat || self.lists_pairs) && self.obstacles.is_empty() && self.extras.is_empty()
    }

    /// Lists the geometry pairs that may touch.
    fn pairs(&self) -> String {
        if !self.has_pairs() {
            return String::new();
        }
        let ([sliding, torsional, rolling], condim) = self.friction();
        let friction = format!("{sliding} {sliding} {torsional} {rolling} {rolling}");
        let pair = |part| format!(r#"<pair geom1="{GROUND}" geom2="{part}" condim="{condim}" friction="{friction}"/>"#);
        let pairs: String = self.robot.colliding.iter().map(pair).collect();
        // MuJoCo 3 looks for islands of touching bodies, in vain with one robot.
        let solver = if VERSION < 300 { "" } else { "  <option><flag island=\"disable\"/></option>\n" };
        format!("{solver}  <contact>{pairs}</contact>\n")
    }

    /// Returns the friction of the ground, and the dimension of its contacts.
    fn friction(&self) -> ([f64; 3], usize) {
        let [sliding, torsional, rolling] = FRICTION;
        if self.rolling_m > 0.0 {
            ([sliding, torsional, self.rolling_m], 6)
        } else {
            ([sliding, torsional, rolling], 3)
        }
    }

    fn ground_asset(&self) -> String {
        let Ground::Field(field) = &self.ground else { return String::new() };
        let HeightField { half_size: [x, y], rows, columns, .. } = &**field;
        let [low, high] = self.height_range();
        let relief = (high - low).max(1e-9);
        format!(
            "  <asset><hfield name=\"{GROUND}\" nrow=\"{rows}\" ncol=\"{columns}\" size=\"{x} {y} {relief} 0.5\"/></asset>\n"
        )
    }

    /// Returns the ground's element. Its priority makes its friction the friction of every contact.
    fn ground_geom(&self, discard_visual: bool) -> String {
        let shape = match self.ground {
            Ground::Flat => r#"type="plane" size="0 0 1""#.to_owned(),
            Ground::Field(_) => {
                format!(r#"type="hfield" hfield="{GROUND}" pos="0 0 {}""#, self.height_range()[0])
            }
        };
        let ([sliding, torsional, rolling], condim) = self.friction();
        let look = match discard_visual {
            true => r#"rgba="0.35 0.38 0.42 1""#.to_owned(),
            false => format!(r#"material="{}""#, look::GROUND_MATERIAL),
        };
        format!(
            r#"<geom name="{GROUND}" {shape} condim="{condim}" priority="1" friction="{sliding} {torsional} {rolling}" {look}/>"#
        )
    }

    fn height_range(&self) -> [f64; 2] {
        match &self.ground {
            Ground::Flat => [0.0, 0.0],
            Ground::Field(field) => field.range(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::robot::same_in_every_leg;
    use crate::sim::{Conditions, Sim};

    #[test]
    fn listed_pairs_touch_uneven_ground_like_all_bodies() {
        let config = Config::load("fast").unwrap().simulation;
        let flat = Scene::flat(Robot::load("go1").unwrap(), config.timestep_s());
        let waves = HeightField::sample([2.0, 2.0], 0.06, |x, y| 0.02 * (9.0 * x).sin() * (7.0 * y).cos());
        let ground = Ground::Field(waves.into());
        let buffers = Buffers { contacts: 100, rows: 450, stack: 100_000 };
        let [searched, listed] = [false, true].map(|lists_pairs| {
            let scene = Scene { ground: ground.clone(), lists_pairs, buffers, ..flat.clone() };
            let mut sim = Sim::new(&scene, &config, 0.1).unwrap();
            let target = same_in_every_leg([0.0, 0.72, -1.44]);
            let conditions = Conditions { gravity: [0.5, 0.0, -9.81], friction: 0.6, encoder_bias: [0.0; 12] };
            sim.reset(conditions, &target).unwrap();
            for _ in 0..60 {
                sim.step(&target, &mut ()).unwrap();
            }
            (sim.data().contact_count(), sim.state().position)
        });
        assert!(searched.0 >= 4 && searched.0 == listed.0, "{searched:?} {listed:?}");
        assert!((searched.1 - listed.1).norm() < 1e-6, "{searched:?} {listed:?}");
    }

    #[test]
    fn compiling_a_scene_again_gives_an_equal_model() {
        let flat = Scene::flat(Robot::load("go1").unwrap(), 1.0 / 240.0);
        let other = Scene { timestep_s: 1.0 / 480.0, ..flat.clone() };
        let mut changed = flat.compile().unwrap();
        changed.set_gravity([0.0, 0.0, -1.0]);
        assert_eq!(flat.compile().unwrap().gravity()[2], -9.81);
        assert_eq!(other.compile().unwrap().timestep_s(), 1.0 / 480.0);
        assert_eq!(flat.compile().unwrap().timestep_s(), 1.0 / 240.0);
    }
}
