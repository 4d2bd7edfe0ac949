/*! Recordings for the rerun viewer: robots in their scenes, forces, plots and events on one time axis; with the feature `video`, videos.

Start with [`Recorder`]. This package and `drive` are the only ones that use rerun. A recording contains its own layout:
robots on the left, one view for each, plots on the right, events below. It receives finished [`Frame`]s and [`Event`]s;
no physics runs here, and a playback never waits here for longer than a few seconds.
*/

mod blueprint;
mod geometry;
mod ground;
mod marks;
mod overlay;
mod plots;
mod robot;
mod stream;
mod style;
#[cfg(test)]
mod tests;
#[cfg(feature = "video")]
mod video;

pub use stream::{Sink, check_name, page_url};
pub use style::{BLUE, ORANGE, Rgb};
#[cfg(feature = "video")]
pub use video::{FRAME_RATE, Video, VideoError};

use std::path::Path;

use plots::Shown;
use robot::Robot;
use stream::Stream;
use supple::mujoco::{self, Model};
use supple::scenario::trace::{Event, Frame, Trace};
use supple::sim::{Ground, Scene};
use supple::util::files::FileError;

/// The reason why a recording is missing or incomplete.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file cannot be created, or its name is not that of a recording.
    #[error(transparent)]
    Create(#[from] FileError),
    /// No viewer answers at this URL, for this reason.
    #[error("no rerun viewer answers at {0}: {1}; start one with `rerun`, or record to a file")]
    Viewer(String, String),
    /// This port cannot be opened, for this reason.
    #[error("cannot serve the viewer on port {0}: {1}; choose another one, and have the next one free too")]
    Serve(u16, String),
    /// The recording in this file or viewer cannot be written, for this reason: the disk is full, the viewer has disconnected.
    #[error("the recording {0} is incomplete: {1}")]
    Write(String, String),
    /// The frame of this robot belongs to another scene: it has other bodies than the model.
    #[error("a frame of {robot} has {found} bodies, its model {expected}; record with the scene's own visual model")]
    #[allow(missing_docs)] // the message names them
    Bodies { robot: String, expected: usize, found: usize },
    /// There is no robot of this index among so many.
    #[error("there is no robot {0} in this recording of {1}")]
    Robot(usize, usize),
    /// The model lacks a part of the robot.
    #[error(transparent)]
    Model(#[from] mujoco::Error),
    /// The clock of the machine is before 1970.
    #[error("cannot record: the clock of this machine is before 1970; set it")]
    Clock,
    /// rerun refused the data.
    #[error("rerun: {0}")]
    Rerun(#[from] rerun::RecordingStreamError),
}

type Result<T, E = RecordError> = std::result::Result<T, E>;

/// A robot to be recorded, and how it is drawn.
#[derive(Debug, Clone, Copy)]
pub struct RobotView<'a> {
    /// The name in views and legends, such as `compliant`.
    pub name: &'a str,
    /// The model to draw, see [`supple::sim::Scene::compile_visual`].
    pub model: &'a Model,
    /// The ground, on which shadows and trails are drawn.
    pub ground: &'a Ground,
    /// Colour of the robot's light parts, its trail and its plots; with `None` it keeps its own colours and plots are
    /// blue.
    pub tint: Option<Rgb>,
    /// True if the robot acts on its sensors: its estimates are then plotted with the true values.
    pub estimates: bool,
}

impl<'a> RobotView<'a> {
    /// Views a robot in its own colours and without estimates.
    pub fn new(name: &'a str, model: &'a Model, scene: &'a Scene) -> Self {
        RobotView { name, model, ground: &scene.ground, tint: None, estimates: false }
    }

    /// Views several robots by their names, models and scenes: in blue and orange if there are two.
    pub fn several(robots: impl IntoIterator<Item = (&'a str, &'a Model, &'a Scene)>) -> Vec<Self> {
        let mut views: Vec<Self> =
            robots.into_iter().map(|(name, model, scene)| Self::new(name, model, scene)).collect();
        if let [first, second, ..] = &mut views[..] {
            (first.tint, second.tint) = (Some(BLUE), Some(ORANGE));
        }
        views
    }
}

/// Records a finished playback, whose frames have bodies, in a file.
///
/// # Errors
/// The file cannot be written, or the model has no trunk.
pub fn record(path: &Path, title: &str, name: &str, scene: &Scene, trace: &Trace) -> Result<()> {
    let model = scene.compile_visual()?;
    let estimates = trace.frames.iter().any(|frame| frame.sensed.is_some());
    let view = RobotView { estimates, ..RobotView::new(name, &model, scene) };
    let mut recorder = Recorder::new(Sink::File(path.to_owned()), title, &[view])?;
    recorder.trace(0, trace)?;
    recorder.finish()
}

/// A recording in progress: logs the frames and events of robots.
pub struct Recorder {
    stream: Stream,
    robots: Vec<Robot>,
}

impl Recorder {
    /// Opens a recording and logs its layout and all static parts. Robots must have different names.
    ///
    /// # Errors
    /// The file cannot be created, no viewer answers, or a model has no trunk.
    pub fn new(sink: Sink, title: &str, robots: &[RobotView<'_>]) -> Result<Self> {
        Self::on(Stream::open(sink, title, false)?, robots)
    }

    /// Opens a live view, which keeps only the latest value of each entity: no plots, no events, no time.
    /// Its memory stays constant, here and in the viewer. Frames may be skipped, because only the latest one is shown.
    ///
    /// # Errors
    /// No viewer answers, or a model has no trunk.
    pub fn live(sink: Sink, title: &str, robots: &[RobotView<'_>]) -> Result<Self> {
        Self::on(Stream::open(sink, title, true)?, robots)
    }

    fn on(stream: Stream, robots: &[RobotView<'_>]) -> Result<Self> {
        let names: Vec<&str> = robots.iter().map(|robot| robot.name).collect();
        let mut shown = Shown { obstacles: false, estimates: robots.iter().any(|robot| robot.estimates) };
        for robot in robots {
            shown.obstacles |= geometry::has_obstacles(robot.model)?;
        }
        blueprint::send(stream.recording()?, &names, shown, stream.is_live)?;
        let robots = robots.iter().enumerate();
        let robots =
            robots.map(|(index, view)| Robot::new(&stream, view, index == 0, shown)).collect::<Result<_, _>>()?;
        Ok(Recorder { stream, robots })
    }

    fn robot(&mut self, index: usize) -> Result<(&mut Robot, &Stream)> {
        let count = self.robots.len();
        let robot = self.robots.get_mut(index).ok_or(RecordError::Robot(index, count))?;
        Ok((robot, &self.stream))
    }

    fn frame(&mut self, robot: usize, frame: &Frame) -> Result<()> {
        let (robot, stream) = self.robot(robot)?;
        robot.frame(stream, frame)?;
        self.stream.end_frame()
    }

    fn event(&mut self, robot: usize, event: &Event) -> Result<()> {
        let (robot, stream) = self.robot(robot)?;
        robot.event(stream, event)
    }

    /// Adds a step of a robot, given by its index in the robots of [`Recorder::new`]: a frame, if there is one, and its events.
    ///
    /// # Errors
    /// There is no such robot, the frame does not fit its model, or the recording has failed: the disk is full, or the viewer has
    /// disconnected.
    pub fn step(&mut self, robot: usize, frame: Option<&Frame>, events: &[Event]) -> Result<()> {
        frame.map_or(Ok(()), |frame| self.frame(robot, frame))?;
        events.iter().try_for_each(|event| self.event(robot, event))
    }

    /// Removes a robot's labels and trails, after it was placed at its start or on its feet.
    ///
    /// # Errors
    /// There is no such robot, or the recording has failed.
    pub fn begin_again(&mut self, robot: usize) -> Result<()> {
        let (robot, stream) = self.robot(robot)?;
        robot.begin_again(stream)
    }

    /// Takes the data logged in memory since the last call, as the bytes of a complete `.rrd` file for a viewer.
    ///
    /// # Errors
    /// rerun cannot encode the data.
    pub fn take(&mut self) -> Result<Vec<u8>> {
        self.stream.take()
    }

    /// Adds all frames and events of a playback.
    ///
    /// # Errors
    /// A frame does not fit the robot's model, or the recording has failed: the disk is full, or the viewer has
    /// disconnected.
    pub fn trace(&mut self, robot: usize, trace: &Trace) -> Result<()> {
        let mut events = trace.events.iter().peekable();
        for (index, frame) in trace.frames.iter().enumerate() {
            self.frame(robot, frame)?;
            let next_s = trace.frames.get(index + 1).map_or(f64::INFINITY, |next| next.time_s);
            while let Some(event) = events.next_if(|event| event.time_s < next_s) {
                self.event(robot, event)?;
            }
        }
        // There is no frame if physics failed in the first step.
        events.try_for_each(|event| self.event(robot, event))
    }

    /// Writes the remaining data and closes the recording.
    ///
    /// # Errors
    /// The disk is full, or the viewer has disconnected: the recording is incomplete.
    pub fn finish(self) -> Result<()> {
        self.stream.finish()
    }
}
