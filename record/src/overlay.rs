/*! Drawn marks: forces, disturbances, trails, shadows and the label of an event.

Shadows are straight below trunk and feet and show their height. The trunk's trail is on the ground, those of the
feet are in the air; both are short enough to be logged completely each time.
*/

use std::collections::{BTreeSet, VecDeque};

use re_sdk_types::archetypes::{Arrows3D, Ellipsoids3D, LineStrips3D, Points3D};
use re_sdk_types::components::{Color, FillMode, Radius};
use re_sdk_types::datatypes::Quaternion;
use rerun::{AsComponents, EntityPath};

use super::Result;
use super::geometry::child;
use super::marks::{self, Arrow};
use super::stream::Stream;
use super::style::*;
use supple::scenario::trace::{DisturbanceMark, Event, EventKind, Frame};
use supple::sim::Ground;

/// Interval \[s\] and number of points of the trunk's trail.
const TRUNK_TRAIL: (f64, usize) = (0.1, 100);
/// Interval \[s\] and number of points of the feet's trails.
const FOOT_TRAIL: (f64, usize) = (1.0 / 30.0, 22);
/// Height of trails and shadows above the ground, so that they are visible \[m\].
const ABOVE_GROUND_M: f32 = 0.003;
/// Height of an event's label above the trunk \[m\].
const LABEL_HEIGHT_M: f32 = 0.28;

/// The marks that are drawn, and the times at which they end.
pub(super) struct Overlay {
    root: EntityPath,
    ground: Ground,
    colour: Rgb,
    trunk: [f32; 3],
    trunk_trail: VecDeque<[f32; 3]>,
    foot_trails: [VecDeque<[f32; 3]>; 4],
    next_trunk_trail_s: f64,
    next_foot_trail_s: f64,
    /// Names of the marks that are drawn and may vanish.
    drawn: BTreeSet<&'static str>,
    label_until_s: Option<f64>,
}

/// Returns the path of a robot's marks.
pub(super) fn overlay_path(robot: &EntityPath) -> EntityPath {
    child(robot, "overlay")
}

impl Overlay {
    /// Creates the overlay and logs its static parts.
    pub(super) fn new(stream: &Stream, robot: &EntityPath, ground: &Ground, colour: Rgb) -> Result<Self> {
        let overlay = Overlay {
            root: overlay_path(robot),
            ground: ground.clone(),
            colour,
            trunk: [0.0; 3],
            trunk_trail: VecDeque::new(),
            foot_trails: Default::default(),
            next_trunk_trail_s: f64::NEG_INFINITY,
            next_foot_trail_s: f64::NEG_INFINITY,
            drawn: BTreeSet::new(),
            label_until_s: None,
        };
        overlay.log_shadow_looks(stream)?;
        Ok(overlay)
    }

    /// Logs the marks of a frame at the current time.
    pub(super) fn frame(&mut self, stream: &Stream, frame: &Frame, trunk: [f32; 3]) -> Result<()> {
        self.trunk = trunk;
        self.log_trails(stream, frame, trunk)?;
        self.log_shadows(stream, frame, trunk)?;
        self.log_foot_forces(stream, frame)?;
        self.log_felt(stream, frame, trunk)?;
        self.log_disturbance(stream, frame, trunk)?;
        self.log_rope(stream, frame)?;
        self.log_label(stream, frame.time_s)
    }

    /// Logs the label of an event at the current time; that of a fall stays.
    pub(super) fn event(&mut self, stream: &Stream, event: &Event) -> Result<()> {
        if self.label_until_s == Some(f64::INFINITY) {
            return Ok(());
        }
        let (colour, shown_s) = match event.kind {
            EventKind::Disturbance => (YELLOW, LABEL_SHOWN_S),
            EventKind::Success => (LIGHT_GREEN, LABEL_SHOWN_S),
            EventKind::Fall | EventKind::Fault => (ALARM, f64::INFINITY),
        };
        self.label_until_s = Some(event.time_s + shown_s);
        let label = Points3D::new([self.label_position()])
            .with_radii([Radius::new_ui_points(0.0)])
            .with_colors([opaque(colour)])
            .with_labels([event.text.as_str()])
            .with_show_labels(true);
        stream.replace(&self.entity("label"), &label)
    }

    pub(super) fn begin_again(&mut self, stream: &Stream) -> Result<()> {
        self.trunk_trail.clear();
        self.foot_trails.iter_mut().for_each(VecDeque::clear);
        self.end_label(stream)
    }

    fn end_label(&mut self, stream: &Stream) -> Result<()> {
        match self.label_until_s.take() {
            Some(_) => stream.clear(&self.entity("label"), &Points3D::clear_fields()),
            None => Ok(()),
        }
    }

    /// Draws a mark, or removes the one that was drawn; `nothing` is a mark without content.
    fn draw<T>(&mut self, stream: &Stream, name: &'static str, mark: Option<T>, nothing: fn() -> T) -> Result<()>
    where
        T: AsComponents,
    {
        let path = self.entity(name);
        match mark {
            Some(mark) => {
                self.drawn.insert(name);
                stream.log(&path, &mark)
            }
            None if self.drawn.remove(name) => stream.clear(&path, &nothing()),
            None => Ok(()),
        }
    }

    fn entity(&self, name: &str) -> EntityPath {
        child(&self.root, name)
    }

    fn label_position(&self) -> [f32; 3] {
        let [x, y, z] = self.trunk;
        [x, y, z + LABEL_HEIGHT_M]
    }

    /// Moves the label of an event with the robot, and removes it when its time is over.
    fn log_label(&mut self, stream: &Stream, time_s: f64) -> Result<()> {
        match self.label_until_s {
            Some(until) if time_s > until => self.end_label(stream),
            Some(_) => {
                let position = Points3D::update_fields().with_positions([self.label_position()]);
                stream.log(&self.entity("label"), &position)
            }
            None => Ok(()),
        }
    }

    fn log_trails(&mut self, stream: &Stream, frame: &Frame, trunk: [f32; 3]) -> Result<()> {
        if is_due(&mut self.next_trunk_trail_s, frame.time_s, TRUNK_TRAIL.0) {
            let below = self.on_ground(trunk);
            push_limited(&mut self.trunk_trail, below, TRUNK_TRAIL.1);
            stream.log(&self.entity("path"), &lines([&self.trunk_trail], 0.004, self.colour))?;
        }
        if !is_due(&mut self.next_foot_trail_s, frame.time_s, FOOT_TRAIL.0) {
            return Ok(());
        }
        for (trail, foot) in self.foot_trails.iter_mut().zip(frame.foot_positions) {
            push_limited(trail, foot.map(|x| x as f32), FOOT_TRAIL.1);
        }
        stream.log(&self.entity("foot trails"), &lines(&self.foot_trails, 0.0025, SKY))
    }

    /// Returns the point of the ground below a point, world frame \[m\].
    fn on_ground(&self, [x, y, _]: [f32; 3]) -> [f32; 3] {
        [x, y, self.ground.height(f64::from(x), f64::from(y)) as f32 + ABOVE_GROUND_M]
    }

    /// Logs the shapes of the shadows: one with a soft rim below the trunk, unless the ground is uneven, and one for
    /// each foot.
    fn log_shadow_looks(&self, stream: &Stream) -> Result<()> {
        let dark = |alpha| Color::from_unmultiplied_rgba(0, 0, 0, alpha);
        if self.ground == Ground::Flat {
            let rims = (0..8).map(|rim| 0.022 * rim as f32);
            let trunk = Ellipsoids3D::from_half_sizes(rims.map(|rim| [0.2 + rim, 0.04 + rim, 0.0005]))
                .with_colors([dark(20)])
                .with_fill_mode(FillMode::Solid);
            stream.log_static(&self.entity("trunk shadow"), &trunk)?;
        }
        let feet = Ellipsoids3D::update_fields()
            .with_half_sizes([[0.03, 0.03, 0.0005]; 4])
            .with_colors([dark(90)])
            .with_fill_mode(FillMode::Solid);
        stream.log_static(&self.entity("foot shadows"), &feet)
    }

    fn log_shadows(&self, stream: &Stream, frame: &Frame, trunk: [f32; 3]) -> Result<()> {
        if self.ground == Ground::Flat {
            let half_yaw = (frame.roll_pitch_yaw[2] / 2.0) as f32;
            let turned = Quaternion::from_xyzw([0.0, 0.0, half_yaw.sin(), half_yaw.cos()]);
            stream.place(&self.entity("trunk shadow"), self.on_ground(trunk), Some(turned))?;
        }
        let feet = frame.foot_positions.map(|foot| self.on_ground(foot.map(|x| x as f32)));
        stream.log(&self.entity("foot shadows"), &Ellipsoids3D::update_fields().with_centers(feet))
    }

    fn log_foot_forces(&self, stream: &Stream, frame: &Frame) -> Result<()> {
        let arrow = |leg: usize| (frame.foot_positions[leg], frame.foot_forces[leg].map(|f| f * METRES_PER_NEWTON));
        stream.log(&self.entity("foot forces"), &arrows(&[0, 1, 2, 3].map(arrow), 0.006, LIGHT_GREEN))
    }

    /// Logs the felt forces: on the trunk above it, on the feet beside their true ones. In doubt, the arrows are grey.
    fn log_felt(&self, stream: &Stream, frame: &Frame, trunk: [f32; 3]) -> Result<()> {
        let Some((on_trunk, on_feet)) = marks::felt(frame, trunk.map(f64::from), METRES_PER_NEWTON) else {
            return Ok(());
        };
        let colour = if frame.felt.is_some_and(|felt| felt.doubt.is_none()) { PURPLE } else { GREY };
        stream.log(&self.entity("felt force"), &arrows(&[on_trunk], 0.01, colour))?;
        stream.log(&self.entity("felt foot forces"), &arrows(&on_feet, 0.004, colour))
    }

    /// Logs the disturbance of a frame: pushes and pressing obstacles as arrows that end at the trunk; a pull as a rope
    /// that starts there, with the force at its far end.
    fn log_disturbance(&mut self, stream: &Stream, frame: &Frame, trunk: [f32; 3]) -> Result<()> {
        let trunk = trunk.map(f64::from);
        let big = |arrow: Arrow| arrows(&[arrow], 0.012, VERMILLION);
        let (push, rope, pull) = match frame.mark {
            Some(DisturbanceMark::Push { velocity }) => (Some(big(marks::push(trunk, velocity))), None, None),
            Some(DisturbanceMark::Rope { force }) => {
                let arrow = marks::pull(trunk, force, METRES_PER_NEWTON);
                let ends = [trunk, arrow.0].map(|point| point.map(|x| x as f32));
                (None, Some(lines([&ends], 0.005, YELLOW)), Some(big(arrow)))
            }
            Some(DisturbanceMark::Press { force }) => (None, None, Some(big(marks::press(trunk, force)))),
            None => (None, None, None),
        };
        self.draw(stream, "push", push, Arrows3D::clear_fields)?;
        self.draw(stream, "rope", rope, LineStrips3D::clear_fields)?;
        self.draw(stream, "pull", pull, Arrows3D::clear_fields)
    }

    /// Logs a rope with a load: bright while it pulls, grey while it is slack.
    fn log_rope(&mut self, stream: &Stream, frame: &Frame) -> Result<()> {
        let rope = frame.rope.as_ref().filter(|rope| rope.points.len() > 1);
        let colour = |force_n: f64| if force_n > 0.0 { YELLOW } else { GREY };
        let strip = rope.map(|rope| lines([&rope.points], 0.003, colour(rope.force_n)));
        self.draw(stream, "loaded rope", strip, LineStrips3D::clear_fields)
    }
}

fn lines<'a, T: IntoIterator<Item = &'a [f32; 3]>>(
    strips: impl IntoIterator<Item = T>,
    radius_m: f32,
    colour: Rgb,
) -> LineStrips3D {
    LineStrips3D::new(strips.into_iter().map(|strip| strip.into_iter().copied().collect::<Vec<_>>()))
        .with_radii([Radius::new_scene_units(radius_m)])
        .with_colors([opaque(colour)])
}

fn arrows(all: &[Arrow], radius_m: f32, colour: Rgb) -> Arrows3D {
    let (origins, vectors): (Vec<_>, Vec<_>) =
        all.iter().map(|(origin, vector)| (origin.map(|x| x as f32), vector.map(|x| x as f32))).unzip();
    Arrows3D::from_vectors(vectors)
        .with_origins(origins)
        .with_radii([Radius::new_scene_units(radius_m)])
        .with_colors([opaque(colour)])
}

/// Returns true once per period, and sets the next time.
fn is_due(next_s: &mut f64, time_s: f64, period_s: f64) -> bool {
    // Frames are not exactly at multiples of the period.
    let due = time_s > *next_s - 1e-6;
    if due {
        *next_s = time_s + period_s;
    }
    due
}

fn push_limited<T>(queue: &mut VecDeque<T>, value: T, most: usize) {
    if queue.len() == most {
        queue.pop_front();
    }
    queue.push_back(value);
}
