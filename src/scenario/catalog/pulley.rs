/*! A weight on a rope over a pulley pulls the trunk (E9).

The rope goes from the trunk's centre of mass to a pulley about as high as the trunk, from there straight up to a second one
and down to the weight. When the robot goes towards the pulley the weight sinks, when it goes away the weight rises, and
the rope's force is the weight's `m (g + a)`. Pulleys are points without friction and inertia; the rope passes through
legs, as one that is tied to a harness on the back would not touch them.
*/

use clap::Args;
use serde::{Deserialize, Serialize};

use super::{ParameterError, Parameters, Task, in_range, metric, no_turn};
use crate::go1::HARNESS;
use crate::scenario::metrics::{self, Metric};
use crate::scenario::rig::{ROPE, ROPE_LIMIT, Words};
use crate::scenario::{Rig, Script};
use crate::scene::Buffers;
use crate::trace::{Frame, Trace};

/// Density of the weight, a cube of steel [kg/m³].
const STEEL_KG_M3: f64 = 7850.0;

/// From the lower to the upper pulley, outwards \[m\].
const UPPER_PULLEY_M: f64 = 0.25;

/// Start of the averages of velocity and force, after the weight is let go: the rope has stopped jerking \[s\].
const SETTLED_S: f64 = 1.0;

/// Pulley: a hanging weight pulls the trunk.
#[derive(Args, Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Pulley {
    #[command(flatten)]
    #[serde(flatten)]
    #[allow(missing_docs)]
    pub task: Task,
    /// Mass of the weight (kg)
    #[arg(long)]
    pub mass_kg: f64,
    /// Direction of the pull from the robot's heading: 0 ahead, 90 left, 180 back (deg)
    #[arg(long)]
    pub direction_deg: f64,
    /// From the robot's course to the pulley; abreast of the robot half-way through the pull if it walks as commanded (m)
    #[arg(long)]
    pub distance_m: f64,
    /// Height of the pulley that the rope comes from (m)
    #[arg(long)]
    pub height_m: f64,
    /// How far the weight can sink or rise, beyond what the commanded walk takes, before it meets ground or pulley (m)
    #[arg(long)]
    pub drop_m: f64,
    /// Slack of the rope when the weight is let go; the weight falls freely until the rope is taut (m)
    #[arg(long)]
    pub slack_m: f64,
    /// When the weight is let go (s)
    #[arg(long)]
    pub at_s: f64,
    /// How long the rope stays on the robot (s)
    #[arg(long)]
    pub for_s: f64,
}

impl Pulley {
    /// Where the pull goes, forward and left at the robot's heading when it begins; a unit vector.
    pub fn direction(&self) -> [f64; 2] {
        let angle = self.direction_deg.to_radians();
        [angle.cos(), angle.sin()]
    }

    /// The pulleys, the weight, and how they hang.
    fn rig(&self) -> Rig {
        let [ahead, left] = self.direction();
        let upper = self.distance_m + UPPER_PULLEY_M;
        let low = |distance: f64, height: f64| [ahead * distance, left * distance, height];
        Rig {
            holders: vec![
                ("pulley", low(self.distance_m, self.height_m)),
                ("upper_pulley", low(upper, self.upper_height_m())),
            ],
            load: "weight",
            load_place: low(upper, self.start_height_m()),
            is_level_with_trunk: false,
            mass_kg: self.mass_kg,
            path: vec![HARNESS, "pulley", "upper_pulley", "weight"],
            slack_m: self.slack_m,
            lead_s: 0.5 * self.for_s,
            release_s: self.at_s,
            until_s: self.at_s + self.for_s,
            words: Words {
                release: "the weight is let go",
                hit: "the weight hits",
                grounded: "the weight is on the ground",
            },
        }
    }

    fn half_edge_m(&self) -> f64 {
        0.5 * (self.mass_kg / STEEL_KG_M3).cbrt()
    }

    /// How far the commanded walk leads towards the pulley during the pull \[m\].
    fn approach_m(&self) -> f64 {
        let [ahead, left] = self.direction();
        (self.task.forward_m_s * ahead + self.task.left_m_s * left) * self.for_s
    }

    /// Height of the weight when it is let go \[m\].
    fn start_height_m(&self) -> f64 {
        self.half_edge_m() + self.drop_m + self.approach_m().max(0.0)
    }

    fn upper_height_m(&self) -> f64 {
        self.start_height_m() + self.drop_m + (-self.approach_m()).max(0.0)
    }
}

impl Parameters for Pulley {
    fn task(&self) -> &Task {
        &self.task
    }

    fn prepare(&self, script: &mut Script, _: u64) -> Result<(), ParameterError> {
        no_turn(&self.task)?;
        in_range("mass-kg", self.mass_kg, 1e-3, 100.0, "0.001 to 100 kg")?;
        in_range("direction-deg", self.direction_deg, -360.0, 360.0, "-360 to 360 degrees")?;
        in_range("height-m", self.height_m, 0.05, 10.0, "0.05 to 10 m")?;
        in_range("drop-m", self.drop_m, 0.1, 100.0, "0.1 to 100 m")?;
        in_range("slack-m", self.slack_m, 0.0, 10.0, "0 to 10 m")?;
        in_range("at-s", self.at_s, 0.0, 3600.0, "0 to 3600 s")?;
        in_range("for-s", self.for_s, 0.0, 3600.0, "0 to 3600 s")?;
        let nearest_m = 0.5 + 0.5 * self.approach_m().abs();
        let expected = "0.5 m to 100 m from where the commanded walk leads (half the way of the pull is on each side)";
        in_range("distance-m", self.distance_m, nearest_m, 100.0, expected)?;
        let rig = self.rig();
        let [half, upper] = [self.half_edge_m(), self.upper_height_m()];
        let at = |[x, y, z]: [f64; 3]| format!("{x} {y} {z}");
        script.scene.obstacles = format!(
            r#"    <body name="pulley" mocap="true" pos="{lower_place}">
      <geom name="pulley" type="sphere" size="0.04" contype="0" conaffinity="0" rgba="0.55 0.58 0.62 1"/>
      <site name="pulley"/>
    </body>
    <body name="upper_pulley" mocap="true" pos="{upper_place}">
      <geom name="upper_pulley" type="sphere" size="0.04" contype="0" conaffinity="0" rgba="0.55 0.58 0.62 1"/>
      <geom name="post" type="capsule" size="0.02" contype="0" conaffinity="0" rgba="0.42 0.45 0.5 1"
            fromto="0 0 0 0 0 -{upper}"/>
      <site name="upper_pulley"/>
    </body>
    <body name="weight" pos="{load_place}">
      <freejoint name="weight"/>
      <geom name="weight" type="box" size="{half} {half} {half}" mass="{mass}" priority="1" friction="0.6 0.005 0.0001"
            rgba="0.80 0.47 0.65 1"/>
      <site name="weight"/>
    </body>
"#,
            lower_place = at(rig.holders[0].1),
            upper_place = at(rig.holders[1].1),
            load_place = at(rig.load_place),
            mass = self.mass_kg,
        );
        script.scene.extras = rope(&rig);
        script.scene.buffers = Buffers { contacts: 64, rows: 400, stack: 100_000 };
        script.rig = Some(rig);
        Ok(())
    }

    fn metrics(&self, script: &Script, trace: &Trace, found: &mut Vec<Metric>) {
        let end_s = (self.at_s + self.for_s).min(script.duration_s);
        // The rope's jerk when the weight is let go is the same for everyone.
        let settled = || metrics::window(trace, self.at_s + SETTLED_S, end_s);
        let direction = self.direction();
        let moved = metrics::displacement_off_course(trace, direction, self.at_s, end_s);
        found.push(metric("displacement_m", "moved along the pull", moved, "m"));
        let offset = metrics::yaw_at(trace, self.at_s).and_then(|yaw| {
            let pull = metrics::in_world(direction, yaw);
            metrics::offset_along_force(trace, pull, self.at_s + SETTLED_S, end_s)
        });
        found.push(metric("offset_m_s", "velocity along the pull", offset, "m/s"));
        let force = |frame: &Frame| frame.rope.as_ref().map_or(0.0, |rope| rope.force_n);
        let peak = |frame: &Frame| frame.rope.as_ref().map_or(0.0, |rope| rope.peak_force_n);
        found.push(metric("mean_rope_force_n", "mean rope force", metrics::mean(settled(), force), "N"));
        found.push(metric("peak_rope_force_n", "peak rope force", metrics::largest(settled(), peak), "N"));
        let power = metrics::mean(settled(), |frame| frame.power_w);
        found.push(metric("power_pulled_w", "power while pulled", power, "W"));
    }
}

/// The MJCF of a rig's rope.
pub(super) fn rope(rig: &Rig) -> String {
    let sites: String = rig.path.iter().map(|site| format!("<site site=\"{site}\"/>")).collect();
    format!("  <tendon><spatial name=\"{ROPE}\" {ROPE_LIMIT}>{sites}</spatial></tendon>\n")
}
