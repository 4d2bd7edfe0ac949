/*! One robot with its ground and obstacles: logs its frames and events.

Poses are logged when they changed, and balls that rest keep their exact position, which costs nothing once compressed.
The camera follows an invisible entity that glides after the trunk instead of shaking with it.
*/

use re_sdk_types::archetypes::{LineStrips3D, Points3D, TextLog, ViewCoordinates};
use re_sdk_types::components::{Color, Radius, TextLogLevel};
use re_sdk_types::datatypes::Quaternion;
use rerun::EntityPath;

use super::geometry::{Parts, balls_path, child, log_model};
use super::ground::{Patch, log_grounds};
use super::overlay::{Overlay, overlay_path};
use super::plots::{self, Shown};
use super::stream::Stream;
use super::style::{BLUE, CAMERA_LAG_S, EYE_DISTANCE_M};
use super::{RecordError, Result, RobotView};
use supple::mujoco::Object;
use supple::scenario::trace::{Event, EventKind, Frame, Pose};
use supple::task::Stage;

/// Smallest change of position \[m\] or of a quaternion's components that is logged.
const LEAST_CHANGE: f32 = 2e-5;
/// Number of balls above which they are logged only in every other frame, to limit the file's size.
const BALLS_IN_EVERY_FRAME: usize = 500;
/// Smallest movement of a ball that is logged \[m\].
const LEAST_BALL_CHANGE_M: f32 = 5e-4;

/// The entities of a robot, and the values that were logged last.
pub(super) struct Robot {
    name: String,
    is_first: bool,
    root: EntityPath,
    parts: Parts,
    body_count: usize,
    shown: Shown,
    patches: Vec<Patch>,
    overlay: Overlay,
    last_poses: Vec<Option<Pose>>,
    last_balls: Vec<[f32; 3]>,
    frames: usize,
    camera: Option<(f64, [f32; 3])>,
    stage: Option<Stage>,
}

impl Robot {
    /// Logs all static parts.
    pub(super) fn new(stream: &Stream, view: &RobotView<'_>, is_first: bool, shown: Shown) -> Result<Self> {
        let root = robot_path(view.name);
        let colour = view.tint.unwrap_or(BLUE);
        let model = view.model;
        stream.log_static(&root, &ViewCoordinates::RIGHT_HAND_Z_UP())?;
        let parts = log_model(stream, &root, model, view.tint)?;
        let patches = log_grounds(stream, &root, model, view.ground)?;
        log_camera_size(stream, view.name)?;
        if !stream.is_live {
            plots::log_styles(stream, view.name, colour, is_first)?;
        }
        Ok(Robot {
            name: view.name.to_owned(),
            is_first,
            shown,
            body_count: model.count(Object::Body),
            last_poses: vec![None; parts.bodies.len()],
            last_balls: vec![[f32::NAN; 3]; parts.balls.len()],
            frames: 0,
            parts,
            patches,
            overlay: Overlay::new(stream, &root, view.ground, colour)?,
            camera: None,
            stage: None,
            root,
        })
    }

    /// Logs a frame at the current time.
    pub(super) fn frame(&mut self, stream: &Stream, frame: &Frame) -> Result<()> {
        if frame.bodies.len() != self.body_count {
            let (expected, found) = (self.body_count, frame.bodies.len());
            return Err(RecordError::Bodies { robot: self.name.clone(), expected, found });
        }
        stream.set_time(frame.time_s)?;
        let trunk = frame.bodies[self.parts.trunk].position;
        self.log_poses(stream, frame)?;
        self.log_balls(stream, frame)?;
        self.log_camera(stream, frame.time_s, trunk)?;
        for patch in &mut self.patches {
            patch.follow(stream, trunk)?;
        }
        self.overlay.frame(stream, frame, trunk)?;
        if stream.is_live {
            return Ok(());
        }
        plots::log_values(stream, &self.name, self.is_first, self.shown, frame)?;
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

    /// Logs an event as text and as a label at the robot.
    pub(super) fn event(&mut self, stream: &Stream, event: &Event) -> Result<()> {
        let level = match event.kind {
            EventKind::Disturbance => TextLogLevel::WARN,
            EventKind::Success => TextLogLevel::INFO,
            EventKind::Fall => TextLogLevel::ERROR,
            EventKind::Fault => TextLogLevel::CRITICAL,
        };
        if !stream.is_live {
            self.log_text(stream, event.time_s, &event.text, level)?;
        }
        self.overlay.event(stream, event)
    }

    /// Removes labels and trails after the robot was placed at its start or on its feet.
    pub(super) fn begin_again(&mut self, stream: &Stream) -> Result<()> {
        self.camera = None;
        self.overlay.begin_again(stream)
    }

    fn log_text(&self, stream: &Stream, time_s: f64, text: &str, level: &str) -> Result<()> {
        // Whole milliseconds: the log's narrow column shows no more.
        stream.set_time((time_s * 1e3).round() / 1e3)?;
        let log = TextLog::new(format!("{}: {text}", self.name)).with_level(level);
        stream.log(&events_path(&self.name), &log)
    }

    fn log_poses(&mut self, stream: &Stream, frame: &Frame) -> Result<()> {
        for ((body, path), last) in self.parts.bodies.iter().zip(&mut self.last_poses) {
            let pose = frame.bodies[*body];
            if !last.is_some_and(|last| is_same(&last, &pose)) {
                *last = Some(pose);
                let [w, x, y, z] = pose.quaternion;
                stream.place(path, pose.position, Some(Quaternion::from_xyzw([x, y, z, w])))?;
            }
        }
        Ok(())
    }

    fn log_balls(&mut self, stream: &Stream, frame: &Frame) -> Result<()> {
        self.frames += 1;
        if self.parts.balls.len() > BALLS_IN_EVERY_FRAME && self.frames.is_multiple_of(2) {
            return Ok(());
        }
        let mut moved = false;
        for (body, last) in self.parts.balls.iter().zip(&mut self.last_balls) {
            let position = frame.bodies[*body].position;
            // The NaN of the beginning counts as moved.
            if last[0].is_nan() || distance(position, *last) > LEAST_BALL_CHANGE_M {
                (*last, moved) = (position, true);
            }
        }
        if moved {
            let positions = Points3D::update_fields().with_positions(self.last_balls.iter().copied());
            stream.log(&balls_path(&self.root), &positions)?;
        }
        Ok(())
    }

    fn log_camera(&mut self, stream: &Stream, time_s: f64, target: [f32; 3]) -> Result<()> {
        let position = match self.camera {
            Some((then_s, last)) => {
                let weight = 1.0 - (-((time_s - then_s) as f32).max(0.0) / CAMERA_LAG_S).exp();
                std::array::from_fn(|k| last[k] + weight * (target[k] - last[k]))
            }
            None => target,
        };
        self.camera = Some((time_s, position));
        stream.place(&camera_path(&self.name), position, None)
    }
}

/// Logs two invisible points, whose distance sets the distance of the camera.
fn log_camera_size(stream: &Stream, robot: &str) -> Result<()> {
    // The viewer goes to 1.5 times the radius of the box around the entity.
    let half = EYE_DISTANCE_M / 1.5;
    let points = [[[0.0, 0.0, -half]; 2], [[0.0, 0.0, half]; 2]];
    let size = LineStrips3D::new(points)
        .with_radii([Radius::new_scene_units(0.0)])
        .with_colors([Color::from_unmultiplied_rgba(0, 0, 0, 0)]);
    stream.log_static(&camera_path(robot), &size)
}

/// Returns the path of a robot, its ground and its obstacles.
pub(super) fn robot_path(name: &str) -> EntityPath {
    child(&EntityPath::from("world"), name)
}

/// Returns the entity that the camera follows.
pub(super) fn camera_path(name: &str) -> EntityPath {
    child(&overlay_path(&robot_path(name)), "camera")
}

/// Returns the path of a robot's text log.
pub(super) fn events_path(name: &str) -> EntityPath {
    child(&EntityPath::from("events"), name)
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f32>().sqrt()
}

fn is_same(a: &Pose, b: &Pose) -> bool {
    let turned = a.quaternion.iter().zip(b.quaternion).any(|(a, b)| (a - b).abs() > LEAST_CHANGE);
    !turned && distance(a.position, b.position) < LEAST_CHANGE
}
