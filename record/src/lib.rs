/*! Recordings for the rerun viewer: robots in their scenes, forces, plots and events on one time axis.

This package and `drive` are the only ones that know rerun. A recording holds its own layout, so that a file opens ready to look at:
robots on the left, one view for each, plots on the right, events below. It takes finished [`Frame`]s and [`Event`]s;
nothing here steps physics, and nothing that steps physics waits here for longer than a few seconds.
*/

mod blueprint;
mod geometry;
mod ground;
mod overlay;
mod plots;
mod robot;
mod stream;
mod style;
#[cfg(test)]
mod tests;

pub use stream::{LiveSink, Sink, page_url};
pub use style::{BLUE, ORANGE, Rgb};

use std::path::PathBuf;

use plots::Shown;
use robot::Robot;
use stream::Stream;
use supple::mujoco::{self, Model};
use supple::scenario::trace::{Event, Frame, Trace};
use supple::sim::Ground;

/// Why there is no recording, or not all of it.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// The file cannot be created.
    #[error("cannot create the recording {}: {source}", path.display())]
    Create {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// No viewer answers.
    #[error("no rerun viewer answers at {url}: {reason}; start one with `rerun`, or record to a file")]
    Viewer {
        /// The URL of the viewer.
        url: String,
        /// rerun's reason.
        reason: String,
    },
    /// A port is taken, or not ours to take.
    #[error("cannot serve the viewer on port {port}: {reason}; choose another one, and have the next one free too")]
    Serve {
        /// The port.
        port: u16,
        /// The system's reason.
        reason: String,
    },
    /// The disk is full, or the viewer went away.
    #[error("the recording {target} is incomplete: {reason}")]
    Write {
        /// File or URL.
        target: String,
        /// The reason.
        reason: String,
    },
    /// The recording has failed before.
    #[error("the recording {target} has failed before and takes no more data")]
    Closed {
        /// File or URL.
        target: String,
    },
    /// A frame of another scene.
    #[error("a frame of {robot} has {found} bodies, its model {expected}; record with the scene's own visual model")]
    Bodies {
        /// The robot.
        robot: String,
        /// Bodies of its model.
        expected: usize,
        /// Bodies of the frame.
        found: usize,
    },
    /// There is no such robot.
    #[error("there is no robot {index} in this recording of {count}")]
    Robot {
        /// The index asked for.
        index: usize,
        /// How many there are.
        count: usize,
    },
    /// The model lacks a part.
    #[error(transparent)]
    Model(#[from] mujoco::Error),
    /// rerun refuses the data.
    #[error("rerun: {0}")]
    Rerun(#[from] rerun::RecordingStreamError),
}

/// A robot to be recorded.
#[derive(Debug, Clone, Copy)]
pub struct RobotView<'a> {
    /// The name in views and legends, such as `compliant`.
    pub name: &'a str,
    /// The model to be looked at, see [`supple::sim::Scene::compile_visual`].
    pub model: &'a Model,
    /// The ground, for marks that are drawn on it.
    pub ground: &'a Ground,
    /// Colour of its light parts, its trail and its plots; without, it keeps its own colours and plots are blue.
    pub tint: Option<Rgb>,
    /// Whether it acts on its sensors: its estimates are then plotted beside the truth.
    pub estimates: bool,
}

/// Writes a recording.
#[derive(Debug)]
pub struct Recorder {
    stream: Stream,
    robots: Vec<Robot>,
}

impl Recorder {
    /// Opens a recording and logs its layout and everything that does not move. Robots must have different names.
    ///
    /// # Errors
    /// The file cannot be created, no viewer answers, or a model has no trunk.
    pub fn new(sink: Sink, title: &str, robots: &[RobotView<'_>]) -> Result<Self, RecordError> {
        Self::on(Stream::open(sink, title)?, robots)
    }

    /// Like [`Recorder::new`] for a live view, which keeps only the latest value of each entity: no plots, no events, no time.
    /// Its memory stays constant, here and in the viewer. Robots and whole frames may be left out: the last one counts.
    ///
    /// # Errors
    /// As [`Recorder::new`].
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

    /// Adds a frame of a robot, the index into the robots of [`Recorder::new`].
    ///
    /// # Errors
    /// The frame does not fit the robot's model, or the recording has failed: the disk is full, the viewer went away.
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

    /// A robot stands where it was put, as if nothing had been: labels and trails are taken away.
    ///
    /// # Errors
    /// There is no such robot, or the recording has failed.
    pub fn begin_again(&mut self, robot: usize) -> Result<(), RecordError> {
        let count = self.robots.len();
        let robot = self.robots.get_mut(robot).ok_or(RecordError::Robot { index: robot, count })?;
        robot.begin_again(&self.stream)
    }

    /// What was logged of a live recording in memory since the last time, as the bytes of a whole `.rrd` file for a viewer.
    ///
    /// # Errors
    /// rerun has failed.
    pub fn take(&mut self) -> Result<Vec<u8>, RecordError> {
        self.stream.take()
    }

    /// Adds a whole rollout of a robot.
    ///
    /// # Errors
    /// As [`Recorder::frame`].
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

    /// Writes out what is left and closes the recording.
    ///
    /// # Errors
    /// The disk is full or the viewer went away: the recording is incomplete.
    pub fn finish(self) -> Result<(), RecordError> {
        self.stream.finish()
    }
}
