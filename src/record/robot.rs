/*! One robot with its ground and obstacles: what is logged of each frame.

Poses are logged when they changed, and balls that rest keep their exact position, which costs nothing once compressed.
The camera follows an invisible entity that glides after the trunk instead of shaking with it. Shadows straight below
feet and trunk show how high they are.
*/

use std::collections::VecDeque;

use rerun::{
    Arrows3D, Ellipsoids3D, EntityPath, FillMode, LineStrips3D, Points3D, Quaternion, Radius, TextLog, TextLogLevel, Transform3D,
    archetypes::Clear,
};

use super::geometry::{Parts, ball_looks, child, log_model};
use super::ground::{Patch, log_grounds};
use super::plots;
use super::stream::Stream;
use super::style::*;
use super::{RecordError, RobotView};
use crate::mujoco::{Kind, Model};
use crate::scene::Ground;
use crate::task::Stage;
use crate::trace::{Disturbance, Event, EventKind, Frame, Pose};

/// Least movement [m] and turn (of a quaternion's components) that is logged.
const LEAST_CHANGE: f32 = 2e-5;
/// More balls than this are logged in every other frame, for the file's size.
const BALLS_IN_EVERY_FRAME: usize = 500;
/// Balls that moved less than this stay where they were logged [m].
const LEAST_BALL_CHANGE_M: f32 = 5e-4;
/// Time constant of the camera [s].
const CAMERA_LAG_S: f32 = 0.25;
/// Time between two points of the trunk's path and of the feet's [s], and how many there are.
const TRUNK_TRAIL: (f64, usize) = (0.1, 100);
const FOOT_TRAIL: (f64, usize) = (1.0 / 30.0, 22);
/// Trails and shadows above the ground, an event's label above the trunk [m].
const ABOVE_GROUND_M: f32 = 0.003;
const LABEL_HEIGHT_M: f32 = 0.28;
/// From the trunk's origin to its side [m].
const TRUNK_RADIUS_M: f64 = 0.13;

/// Where a robot's things are and what was logged last.
#[derive(Debug)]
pub(super) struct Robot {
    name: String,
    is_first: bool,
    colour: Rgb,
    root: EntityPath,
    parts: Parts,
    body_count: usize,
    has_obstacles: bool,
    patches: Vec<Patch>,
    ground: Ground,
    last_poses: Vec<Option<Pose>>,
    last_balls: Vec<[f32; 3]>,
    frames: usize,
    camera: Option<(f64, [f32; 3])>,
    trunk_trail: VecDeque<[f32; 3]>,
    foot_trails: [VecDeque<[f32; 3]>; 4],
    next_trunk_trail_s: f64,
    next_foot_trail_s: f64,
    push: Option<(f64, [f64; 3])>,
    pulled: bool,
    label_until_s: Option<f64>,
    stage: Option<Stage>,
    trunk: [f32; 3],
}

impl Robot {
    /// Logs everything that does not change.
    pub(super) fn new(
        stream: &Stream,
        view: &RobotView<'_>,
        is_first: bool,
        has_obstacles: bool,
    ) -> Result<Self, RecordError> {
        let root = robot_path(view.name);
        let colour = view.tint.unwrap_or(BLUE);
        let model: &Model = view.model;
        stream.log_static(&root, &rerun::ViewCoordinates::RIGHT_HAND_Z_UP())?;
        let parts = log_model(stream, &root, model, view.tint)?;
        let patches = log_grounds(stream, &root, model)?;
        let (radii, colours) = ball_looks(model, &parts.balls);
        let robot = Robot {
            name: view.name.to_owned(),
            is_first,
            colour,
            has_obstacles,
            body_count: model.count(Kind::Body),
            last_poses: vec![None; parts.bodies.len()],
            last_balls: vec![[f32::NAN; 3]; parts.balls.len()],
            frames: 0,
            parts,
            patches,
            ground: view.ground.clone(),
            camera: None,
            trunk_trail: VecDeque::new(),
            foot_trails: Default::default(),
            next_trunk_trail_s: f64::NEG_INFINITY,
            next_foot_trail_s: f64::NEG_INFINITY,
            push: None,
            pulled: false,
            label_until_s: None,
            stage: None,
            trunk: [0.0; 3],
            root,
        };
        if !robot.parts.balls.is_empty() {
            let looks = Points3D::update_fields().with_radii(radii).with_colors(colours);
            stream.log_static(&robot.entity("balls"), &looks)?;
        }
        robot.log_camera_size(stream)?;
        robot.log_shadow_looks(stream)?;
        plots::log_styles(stream, view.name, colour, is_first)?;
        Ok(robot)
    }

    /// Logs a frame.
    pub(super) fn frame(&mut self, stream: &Stream, frame: &Frame) -> Result<(), RecordError> {
        if frame.bodies.len() != self.body_count {
            let (expected, found) = (self.body_count, frame.bodies.len());
            return Err(RecordError::Bodies { robot: self.name.clone(), expected, found });
        }
        stream.set_time(frame.time_s)?;
        self.trunk = frame.bodies[self.parts.trunk].position;
        self.log_poses(stream, frame)?;
        self.log_balls(stream, frame)?;
        self.log_camera(stream, frame.time_s)?;
        for patch in &mut self.patches {
            patch.follow(stream, self.trunk)?;
        }
        self.log_trails(stream, frame)?;
        self.log_shadows(stream, frame)?;
        self.log_foot_forces(stream, frame)?;
        self.log_disturbance(stream, frame)?;
        self.log_label(stream, frame.time_s)?;
        plots::log_values(stream, &self.name, self.is_first, self.has_obstacles, frame)?;
        if frame.stage != self.stage {
            self.stage = frame.stage;
            let words = match frame.stage {
                Some(Stage::Walking) => "stage: walking",
                Some(Stage::Recovery) => "stage: recovery",
                Some(Stage::PostRecovery) => "stage: post-recovery",
                None => "end of the stages",
            };
            self.log_text(stream, frame.time_s, words, TextLogLevel::INFO)?;
        }
        Ok(())
    }

    /// Logs an event as text and as a label above the robot.
    pub(super) fn event(&mut self, stream: &Stream, event: &Event) -> Result<(), RecordError> {
        let (level, colour, shown_s) = match event.kind {
            EventKind::Disturbance => (TextLogLevel::WARN, YELLOW, LABEL_SHOWN_S),
            EventKind::Success => (TextLogLevel::INFO, LIGHT_GREEN, LABEL_SHOWN_S),
            EventKind::Fall => (TextLogLevel::ERROR, ALARM, f64::INFINITY),
            EventKind::Fault => (TextLogLevel::CRITICAL, ALARM, f64::INFINITY),
        };
        self.log_text(stream, event.time_s, &event.text, level)?;
        if self.label_until_s == Some(f64::INFINITY) {
            return Ok(());
        }
        self.label_until_s = Some(event.time_s + shown_s);
        let label = Points3D::new([self.label_position()])
            .with_radii([Radius::new_ui_points(0.0)])
            .with_colors([opaque(colour)])
            .with_labels([event.text.as_str()])
            .with_show_labels(true);
        stream.log(&self.entity("label"), &label)
    }

    fn entity(&self, name: &str) -> EntityPath {
        child(&self.root, name)
    }

    fn log_text(&self, stream: &Stream, time_s: f64, text: &str, level: &str) -> Result<(), RecordError> {
        // Whole milliseconds: the log's narrow column shows no more.
        stream.set_time((time_s * 1e3).round() / 1e3)?;
        let log = TextLog::new(format!("{}: {text}", self.name)).with_level(level);
        stream.log(&events_path(&self.name), &log)
    }

    fn label_position(&self) -> [f32; 3] {
        let [x, y, z] = self.trunk;
        [x, y, z + LABEL_HEIGHT_M]
    }

    /// Moves the label of an event with the robot and takes it away in time.
    fn log_label(&mut self, stream: &Stream, time_s: f64) -> Result<(), RecordError> {
        match self.label_until_s {
            Some(until) if time_s > until => {
                self.label_until_s = None;
                stream.log(&self.entity("label"), &Clear::flat())
            }
            Some(_) => {
                let position = Points3D::update_fields().with_positions([self.label_position()]);
                stream.log(&self.entity("label"), &position)
            }
            None => Ok(()),
        }
    }

    fn log_poses(&mut self, stream: &Stream, frame: &Frame) -> Result<(), RecordError> {
        for ((body, path), last) in self.parts.bodies.iter().zip(&mut self.last_poses) {
            let pose = frame.bodies[*body];
            if last.is_some_and(|last| is_same(&last, &pose)) {
                continue;
            }
            *last = Some(pose);
            let [w, x, y, z] = pose.quaternion;
            let transform = Transform3D::update_fields()
                .with_translation(pose.position)
                .with_quaternion(Quaternion::from_xyzw([x, y, z, w]));
            stream.log(path, &transform)?;
        }
        Ok(())
    }

    fn log_balls(&mut self, stream: &Stream, frame: &Frame) -> Result<(), RecordError> {
        self.frames += 1;
        if self.parts.balls.len() > BALLS_IN_EVERY_FRAME && self.frames.is_multiple_of(2) {
            return Ok(());
        }
        let mut moved = false;
        for (body, last) in self.parts.balls.iter().zip(&mut self.last_balls) {
            let position = frame.bodies[*body].position;
            // Not less, so that the NaN of the beginning counts as moved.
            if !(distance(position, *last) < LEAST_BALL_CHANGE_M) {
                *last = position;
                moved = true;
            }
        }
        if moved {
            let positions = Points3D::update_fields().with_positions(self.last_balls.iter().copied());
            stream.log(&self.entity("balls"), &positions)?;
        }
        Ok(())
    }

    /// The eye's distance follows from the size of what it follows: two invisible points.
    fn log_camera_size(&self, stream: &Stream) -> Result<(), RecordError> {
        // The viewer goes to 1.5 times the radius of the box around the entity.
        let half = EYE_DISTANCE_M / 1.5;
        let points = [[[0.0, 0.0, -half]; 2], [[0.0, 0.0, half]; 2]];
        let size = LineStrips3D::new(points)
            .with_radii([Radius::new_scene_units(0.0)])
            .with_colors([rerun::Color::from_unmultiplied_rgba(0, 0, 0, 0)]);
        stream.log_static(&camera_path(&self.name), &size)
    }

    fn log_camera(&mut self, stream: &Stream, time_s: f64) -> Result<(), RecordError> {
        let target = self.trunk;
        let position = match self.camera {
            Some((then_s, last)) => {
                let share = 1.0 - (-((time_s - then_s) as f32).max(0.0) / CAMERA_LAG_S).exp();
                std::array::from_fn(|k| last[k] + share * (target[k] - last[k]))
            }
            None => target,
        };
        self.camera = Some((time_s, position));
        stream.log(&camera_path(&self.name), &Transform3D::update_fields().with_translation(position))
    }

    fn log_trails(&mut self, stream: &Stream, frame: &Frame) -> Result<(), RecordError> {
        if is_due(&mut self.next_trunk_trail_s, frame.time_s, TRUNK_TRAIL.0) {
            let below = self.on_ground(self.trunk);
            push_limited(&mut self.trunk_trail, below, TRUNK_TRAIL.1);
            let path = LineStrips3D::new([self.trunk_trail.iter().copied().collect::<Vec<_>>()])
                .with_radii([Radius::new_scene_units(0.004)])
                .with_colors([opaque(self.colour)]);
            stream.log(&self.entity("path"), &path)?;
        }
        if !is_due(&mut self.next_foot_trail_s, frame.time_s, FOOT_TRAIL.0) {
            return Ok(());
        }
        for (trail, foot) in self.foot_trails.iter_mut().zip(frame.foot_positions) {
            push_limited(trail, foot.map(|x| x as f32), FOOT_TRAIL.1);
        }
        let feet = LineStrips3D::new(self.foot_trails.iter().map(|trail| trail.iter().copied().collect::<Vec<_>>()))
            .with_radii([Radius::new_scene_units(0.0025)])
            .with_colors([opaque(SKY)]);
        stream.log(&self.entity("foot trails"), &feet)
    }

    /// The point of the ground below a point, a little above it so that both are seen.
    fn on_ground(&self, [x, y, _]: [f32; 3]) -> [f32; 3] {
        [x, y, self.ground.height(f64::from(x), f64::from(y)) as f32 + ABOVE_GROUND_M]
    }

    /// Shadows are flat and dark: one with a soft rim below the trunk, unless the ground is uneven, and one for each foot.
    fn log_shadow_looks(&self, stream: &Stream) -> Result<(), RecordError> {
        let dark = |alpha| rerun::Color::from_unmultiplied_rgba(0, 0, 0, alpha);
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

    fn log_shadows(&self, stream: &Stream, frame: &Frame) -> Result<(), RecordError> {
        if self.ground == Ground::Flat {
            let half_yaw = (frame.roll_pitch_yaw[2] / 2.0) as f32;
            let shadow = Transform3D::update_fields()
                .with_translation(self.on_ground(self.trunk))
                .with_quaternion(Quaternion::from_xyzw([0.0, 0.0, half_yaw.sin(), half_yaw.cos()]));
            stream.log(&self.entity("trunk shadow"), &shadow)?;
        }
        let feet = frame.foot_positions.map(|foot| self.on_ground(foot.map(|x| x as f32)));
        stream.log(&self.entity("foot shadows"), &Ellipsoids3D::update_fields().with_centers(feet))
    }

    fn log_foot_forces(&self, stream: &Stream, frame: &Frame) -> Result<(), RecordError> {
        let vectors = frame.foot_forces.map(|force| force.map(|f| (f * METRES_PER_NEWTON) as f32));
        let arrows = Arrows3D::from_vectors(vectors)
            .with_origins(frame.foot_positions.map(|foot| foot.map(|x| x as f32)))
            .with_radii([Radius::new_scene_units(0.006)])
            .with_colors([opaque(LIGHT_GREEN)]);
        stream.log(&self.entity("foot forces"), &arrows)
    }

    /// A push is an arrow that ends at the trunk, a pull a rope that begins there with the force at its far end.
    fn log_disturbance(&mut self, stream: &Stream, frame: &Frame) -> Result<(), RecordError> {
        let trunk = self.trunk.map(f64::from);
        let path = self.entity("push");
        if let Some(Disturbance::Push { velocity }) = frame.disturbance {
            self.push = Some((frame.time_s + PUSH_SHOWN_S, velocity));
        }
        match self.push {
            Some((until, _)) if frame.time_s > until => {
                self.push = None;
                stream.log(&path, &Clear::flat())?;
            }
            Some((_, velocity)) => {
                let speed = velocity.iter().map(|v| v * v).sum::<f64>().sqrt().max(1e-9);
                let vector = velocity.map(|v| v * METRES_PER_PUSH);
                // The tip is at the trunk's side.
                let reach = METRES_PER_PUSH + TRUNK_RADIUS_M / speed;
                let origin: [f64; 3] = std::array::from_fn(|k| trunk[k] - velocity[k] * reach);
                stream.log(&path, &arrow(origin, vector, VERMILLION))?;
            }
            None => {}
        }
        let (rope, pull) = (self.entity("rope"), self.entity("pull"));
        if let Some(Disturbance::Pull { force }) = frame.disturbance {
            let size = force.iter().map(|f| f * f).sum::<f64>().sqrt().max(1e-9);
            let end: [f64; 3] = std::array::from_fn(|k| trunk[k] + force[k] / size * ROPE_LENGTH_M);
            let strip = LineStrips3D::new([[trunk, end].map(|point| point.map(|x| x as f32))])
                .with_radii([Radius::new_scene_units(0.005)])
                .with_colors([opaque(YELLOW)]);
            stream.log(&rope, &strip)?;
            stream.log(&pull, &arrow(end, force.map(|f| f * METRES_PER_NEWTON), VERMILLION))?;
            self.pulled = true;
        } else if self.pulled {
            stream.log(&rope, &Clear::flat())?;
            stream.log(&pull, &Clear::flat())?;
            self.pulled = false;
        }
        Ok(())
    }
}

/// The sub-tree of a robot, its ground and its obstacles.
pub(super) fn robot_path(name: &str) -> EntityPath {
    child(&EntityPath::from("world"), name)
}

/// What the camera follows.
pub(super) fn camera_path(name: &str) -> EntityPath {
    child(&robot_path(name), "camera")
}

/// The text log of a robot.
pub(super) fn events_path(name: &str) -> EntityPath {
    child(&EntityPath::from("events"), name)
}

fn arrow(origin: [f64; 3], vector: [f64; 3], colour: Rgb) -> Arrows3D {
    Arrows3D::from_vectors([vector.map(|x| x as f32)])
        .with_origins([origin.map(|x| x as f32)])
        .with_radii([Radius::new_scene_units(0.012)])
        .with_colors([opaque(colour)])
}

/// Whether it is time again; if so, sets when next.
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

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt()
}

fn is_same(a: &Pose, b: &Pose) -> bool {
    let turned = a.quaternion.iter().zip(b.quaternion).any(|(a, b)| (a - b).abs() > LEAST_CHANGE);
    !turned && distance(a.position, b.position) < LEAST_CHANGE
}
