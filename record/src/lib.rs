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

pub use stream::{LiveSink, Sink, check_name, page_url};
pub use style::{BLUE, ORANGE, Rgb};
#[cfg(feature = "video")]
pub use video::{FRAME_RATE, Video, VideoError};

use std::path::PathBuf;

use plots::Shown;
use robot::Robot;
use stream::Stream;
use supple::mujoco::{self, Model};
use supple::scenario::trace::{Event, Frame, Trace};
use supple::sim::Ground;

/// The reason why a recording is missing or incomplete.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file cannot be created.
    #[error("cannot create the recording {}: {source}", path.display())]
    Create {
        /// Path of the file.
        path: PathBuf,
        /// Reason given by the operating system.
        source: std::io::Error,
    },
    /// The name of the file has another ending than `.rrd`.
    #[error(
        "cannot create the recording {}: it is for the rerun viewer (no video, no table) and its name ends with .rrd; name it {}",
        path.display(),
        path.with_extension("rrd").display()
    )]
    Ending {
        /// Path of the file.
        path: PathBuf,
    },
    /// No viewer answers at the URL.
    #[error("no rerun viewer answers at {url}: {reason}; start one with `rerun`, or record to a file")]
    Viewer {
        /// The URL of the viewer.
        url: String,
        /// Reason given by rerun.
        reason: String,
    },
    /// A port cannot be opened: it is in use, or not permitted.
    #[error("cannot serve the viewer on port {port}: {reason}; choose another one, and have the next one free too")]
    Serve {
        /// The port that cannot be opened.
        port: u16,
        /// Reason given by the operating system.
        reason: String,
    },
    /// The recording cannot be written: the disk is full, or the viewer has disconnected.
    #[error("the recording {target} is incomplete: {reason}")]
    Write {
        /// Path of the file or URL of the viewer.
        target: String,
        /// Reason given by rerun or the operating system.
        reason: String,
    },
    /// The recording has failed before, and cannot continue.
    #[error("the recording {target} has failed before and takes no more data")]
    Closed {
        /// Path of the file or URL of the viewer.
        target: String,
    },
    /// The frame belongs to another scene: its number of bodies differs.
    #[error("a frame of {robot} has {found} bodies, its model {expected}; record with the scene's own visual model")]
    Bodies {
        /// Name of the robot.
        robot: String,
        /// Number of bodies in the robot's model.
        expected: usize,
        /// Number of bodies in the frame.
        found: usize,
    },
    /// There is no robot of this index.
    #[error("there is no robot {index} in this recording of {count}")]
    Robot {
        /// The index that was given.
        index: usize,
        /// Number of robots.
        count: usize,
    },
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

/// A recording in progress: logs the frames and events of robots.
#[derive(Debug)]
pub struct Recorder {
    stream: Stream,
    robots: Vec<Robot>,
}

impl Recorder {
    /// Opens a recording and logs its layout and all static parts. Robots must have different names.
    ///
    /// # Errors
    /// The file cannot be created, no viewer answers, or a model has no trunk.
    pub fn new(sink: Sink, title: &str, robots: &[RobotView<'_>]) -> Result<Self, RecordError> {
        Self::on(Stream::open(sink, title)?, robots)
    }

    /// Opens a live view, which keeps only the latest value of each entity: no plots, no events, no time.
    /// Its memory stays constant, here and in the viewer. Frames may be skipped, because only the latest one is shown.
    ///
    /// # Errors
    /// No viewer answers, or a model has no trunk.
    pub fn live(sink: LiveSink, title: &str, robots: &[RobotView<'_>]) -> Result<Self, RecordError> {
        Self::on(Stream::open_live(sink, title)?, robots)
    }

    fn on(stream: Stream, robots: &[RobotView<'_>]) -> Result<Self, RecordError> {
        let names: Vec<&str> = robots.iter().map(|robot| robot.name).collect();
        let obstacles =
            robots.iter().map(|robot| geometry::has_obstacles(robot.model)).collect::<Result<Vec<_>, _>>()?;
        let estimates = robots.iter().any(|robot| robot.estimates);
        let shown = Shown { obstacles: obstacles.contains(&true), estimates };
        blueprint::send(stream.recording()?, &names, shown, stream.is_live())?;
        let robots = robots.iter().enumerate();
        let robots = robots.map(|(index, view)| Robot::new(&stream, view, index == 0, shown));
        let robots = robots.collect::<Result<_, _>>()?;
        Ok(Recorder { stream, robots })
    }

    /// Adds a frame of a robot, given by its index in the robots of [`Recorder::new`].
    ///
    /// # Errors
    /// The frame does not fit the robot's model, or the recording has failed: the disk is full, or the viewer has
    /// disconnected.
    pub fn frame(&mut self, robot: usize, frame: &Frame) -> Result<(), RecordError> {
        let count = self.robots.len();
        let robot = self.robots.get_mut(robot).ok_or(RecordError::Robot { index: robot, count })?;
        robot.frame(&self.stream, frame)?;
        self.stream.end_frame()
    }

    /// Adds an event of a robot, after the frame that it belongs to.
    ///
    /// # Errors
    /// There is no such robot, or the recording has failed.
    pub fn event(&mut self, robot: usize, event: &Event) -> Result<(), RecordError> {
        let count = self.robots.len();
        let robot = self.robots.get_mut(robot).ok_or(RecordError::Robot { index: robot, count })?;
        robot.event(&self.stream, event)
    }

    /// Removes a robot's labels and trails, after it was placed at its start or on its feet.
    ///
    /// # Errors
    /// There is no such robot, or the recording has failed.
    pub fn begin_again(&mut self, robot: usize) -> Result<(), RecordError> {
        let count = self.robots.len();
        let robot = self.robots.get_mut(robot).ok_or(RecordError::Robot { index: robot, count })?;
        robot.begin_again(&self.stream)
    }

    /// Takes the data logged in memory since the last call, as the bytes of a complete `.rrd` file for a viewer.
    ///
    /// # Errors
    /// rerun cannot encode the data.
    pub fn take(&mut self) -> Result<Vec<u8>, RecordError> {
        self.stream.take()
    }

    /// Adds all frames and events of a playback.
    ///
    /// # Errors
    /// A frame does not fit the robot's model, or the recording has failed: the disk is full, or the viewer has
    /// disconnected.
    pub fn trace(&mut self, robot: usize, trace: &Trace) -> Result<(), RecordError> {
        let mut events = trace.events.iter().peekable();
        for (index, frame) in trace.frames.iter().enumerate() {
            self.frame(robot, frame)?;
            let next_s = trace.frames.get(index + 1).map_or(f64::INFINITY, |next| next.time_s);
            while let Some(event) = events.next_if(|event| event.time_s < next_s) {
                self.event(robot, event)?;
            }
        }
        // There is no frame where physics failed at once.
        events.try_for_each(|event| self.event(robot, event))
    }

    /// Writes the remaining data and closes the recording.
    ///
    /// # Errors
    /// The disk is full, or the viewer has disconnected: the recording is incomplete.
    pub fn finish(self) -> Result<(), RecordError> {
        self.stream.finish()
    }
}
