//! The picture of one robot at a time of its playback: the scene, a camera that follows, the marks of forces, the path behind.

use super::{Result, VideoError};
use crate::marks::{self, Arrow};
use crate::style::{BLUE, CAMERA_LAG_S, GREY, PURPLE, Rgb, VERMILLION, YELLOW};
use crate::{RobotView, geometry};
use supple::mujoco::{Camera, Mark, MarkShape, Object, Renderer};
use supple::scenario::trace::{DisturbanceMark, Frame, Pose, Trace};

/// Length of the arrows of pulls and felt forces [m/N]; longer than in recordings, as there is no zoom.
const METRES_PER_NEWTON: f64 = 1.0 / 80.0;
/// Smallest felt force whose arrow is drawn \[N\]: smaller ones come and go with the gait.
const LEAST_FELT_N: f64 = 7.5;
/// Interval and number of the pieces of the path behind the trunk \[s\].
const TRAIL: (f64, usize) = (0.1, 50);
/// Height of the path above the ground \[m\].
const ABOVE_GROUND_M: f64 = 0.004;
/// Direction from the robot to the camera, which shows a push to a side: right of it, behind and above. World frame, any length.
const DIRECTION: [f64; 3] = [-1.0, -0.9, 0.72];
/// Distance of the camera from what it looks at \[m\].
const DISTANCE_M: f64 = 1.75;
/// Height above the feet that is in the middle of the picture \[m\].
const LOOKED_AT_M: f64 = 0.2;

/// A renderer of one robot.
pub(super) struct View<'a> {
    robot: RobotView<'a>,
    trace: &'a Trace,
    renderer: Renderer,
    bodies: usize,
    /// Time of the last picture \[s\], and what its camera looked at \[m\].
    looked_at: Option<(f64, [f64; 3])>,
}

impl<'a> View<'a> {
    pub(super) fn new(robot: &RobotView<'a>, trace: &'a Trace, size: [usize; 2]) -> Result<Self> {
        if trace.frames.is_empty() {
            return Err(VideoError::Empty(robot.name.to_owned()));
        }
        let mut model = robot.model.try_clone()?;
        for (geom, rgba) in geometry::colours(&model, robot.tint)?.into_iter().enumerate() {
            model.set_look(geom, rgba.unwrap_or_default(), rgba.is_some());
        }
        let bodies = model.count(Object::Body);
        Ok(View { robot: *robot, trace, renderer: Renderer::new(model, size)?, bodies, looked_at: None })
    }

    /// Returns the picture at a time \[s\], or at the end of a shorter playback.
    pub(super) fn picture(&mut self, time_s: f64) -> Result<Vec<u8>> {
        let later = self.trace.frames.partition_point(|frame| frame.time_s < time_s + 1e-6);
        let past = &self.trace.frames[..later.max(1)];
        let frame = &past[past.len() - 1];
        if frame.bodies.len() != self.bodies {
            let (robot, found) = (self.robot.name.to_owned(), frame.bodies.len());
            return Err(VideoError::Bodies { robot, found, expected: self.bodies });
        }
        let poses: Vec<[f32; 7]> = frame.bodies.iter().map(Pose::row).collect();
        let mut marks = self.trail(past);
        marks.extend(disturbance(frame));
        marks.extend(felt(frame));
        let camera = self.camera(time_s, frame);
        Ok(self.renderer.picture(&poses, &camera, &marks)?)
    }

    /// Returns the camera, which glides after the trunk.
    fn camera(&mut self, time_s: f64, frame: &Frame) -> Camera {
        let [x, y, z] = frame.position;
        let wanted = [x, y, z - frame.height_m + LOOKED_AT_M];
        let target = match self.looked_at {
            Some((then_s, last)) => {
                let weight = 1.0 - (-(time_s - then_s) / f64::from(CAMERA_LAG_S)).exp();
                std::array::from_fn(|k| last[k] + weight * (wanted[k] - last[k]))
            }
            None => wanted,
        };
        self.looked_at = Some((time_s, target));
        let [x, y, z] = DIRECTION;
        let (azimuth_deg, elevation_deg) = ((-y).atan2(-x).to_degrees(), -z.atan2(x.hypot(y)).to_degrees());
        Camera { target, distance_m: DISTANCE_M, azimuth_deg, elevation_deg }
    }

    /// Returns the path of the trunk on the ground.
    fn trail(&self, past: &[Frame]) -> Vec<Mark> {
        let every = ((TRAIL.0 / self.trace.period_s).round() as usize).max(1);
        // Pieces keep their places while the robot moves.
        let corners = (0..past.len()).filter(|index| index % every == 0).chain([past.len() - 1]);
        let below = |index: usize| {
            let [x, y, _] = past[index].position;
            [x, y, self.robot.ground.height(x, y) + ABOVE_GROUND_M]
        };
        let corners: Vec<[f64; 3]> = corners.map(below).collect();
        let last = &corners[corners.len().saturating_sub(TRAIL.1)..];
        last.windows(2).map(|ends| rod(ends[0], ends[1], 0.006, self.robot.tint.unwrap_or(BLUE))).collect()
    }
}

/// Returns the marks of pushes, pulls, obstacles and ropes in a frame.
fn disturbance(frame: &Frame) -> Vec<Mark> {
    let trunk = frame.position;
    let mut marks = Vec::new();
    match frame.mark {
        Some(DisturbanceMark::Rope { force }) => {
            let pull = marks::pull(trunk, force, METRES_PER_NEWTON);
            marks.extend([rod(trunk, pull.0, 0.006, YELLOW), arrow(pull, 0.016, VERMILLION)]);
        }
        Some(DisturbanceMark::Press { force }) => marks.push(arrow(marks::press(trunk, force), 0.016, VERMILLION)),
        Some(DisturbanceMark::Push { velocity }) => marks.push(arrow(marks::push(trunk, velocity), 0.016, VERMILLION)),
        None => {}
    }
    if let Some(rope) = &frame.rope {
        let colour = if rope.force_n > 0.0 { YELLOW } else { GREY };
        let piece = |ends: &[[f32; 3]]| rod(ends[0].map(f64::from), ends[1].map(f64::from), 0.005, colour);
        marks.extend(rope.points.windows(2).map(piece));
    }
    marks
}

/// Returns the mark of the felt force on the trunk; in doubt it is grey.
fn felt(frame: &Frame) -> Option<Mark> {
    let (on_trunk, _) = marks::felt(frame, frame.position, METRES_PER_NEWTON)?;
    let colour = if frame.felt?.doubt.is_none() { PURPLE } else { GREY };
    (marks::size(on_trunk.1) > LEAST_FELT_N * METRES_PER_NEWTON).then(|| arrow(on_trunk, 0.013, colour))
}

fn arrow((from, vector): Arrow, radius_m: f64, colour: Rgb) -> Mark {
    let to = std::array::from_fn(|k| from[k] + vector[k]);
    Mark { shape: MarkShape::Arrow, ..rod(from, to, radius_m, colour) }
}

fn rod(from: [f64; 3], to: [f64; 3], radius_m: f64, colour: Rgb) -> Mark {
    let [red, green, blue] = colour.map(|part| f32::from(part) / 255.0);
    Mark { shape: MarkShape::Rod, from, to, radius_m, rgba: [red, green, blue, 1.0] }
}
