/*! Streams the newest frames of the robots to rerun viewers.

Each viewer has its own live recording, written on its own thread. A late or slow viewer misses frames and nothing else,
since each frame is logged relative to what this viewer has already received.
*/

use std::sync::Arc;
use std::time::{Duration, Instant};

use supple::mujoco::Model;
use supple::scenario::session::LiveSession;
use supple::scenario::trace::{Event, Frame};
use supple::sim::Scene;
use supple_record::{RecordError, Recorder, RobotView, Sink};
use tokio::runtime::Handle;
use tokio::sync::{mpsc, watch};

/// Least time between two frames of a viewer.
const PERIOD: Duration = Duration::from_millis(15);
/// Least time between two frames while the machine is too slow for real time: the frame rate drops first.
const PERIOD_BEHIND: Duration = Duration::from_millis(60);

/// The robots and scenes of one set-up.
#[derive(Debug)]
pub struct Cast {
    /// Unique names of the robots.
    pub names: Vec<String>,
    /// Scene of each robot.
    pub scenes: Vec<Scene>,
}

/// The newest frames and events of all robots.
#[derive(Debug, Clone)]
pub struct Snapshot {
    /// Robots and scenes that are shown.
    pub cast: Arc<Cast>,
    /// Newest frame of each robot.
    pub frames: Vec<Option<Arc<Frame>>>,
    /// Number of times each robot was placed (start, reset, after a fall).
    pub beginnings: Vec<u64>,
    /// Number of events and newest event of each robot.
    pub events: Vec<(u64, Option<Event>)>,
    /// True if the machine is too slow for real time.
    pub is_behind: bool,
}

impl Cast {
    /// Takes the robots and scenes of a live session.
    pub fn new(world: &LiveSession) -> Self {
        let mut names: Vec<String> = Vec::new();
        for seat in &world.setup().robots {
            let name = seat.label();
            names.push(if names.contains(&name) { format!("{name} (2)") } else { name });
        }
        Cast { names, scenes: world.scenes().cloned().collect() }
    }

    /// Opens a recording, or a live one, of which viewers keep only the latest frames.
    ///
    /// # Errors
    /// A scene does not compile, the file cannot be written, or no viewer answers.
    pub fn record(&self, sink: Sink, is_live: bool) -> Result<Recorder, RecordError> {
        let models = self.scenes.iter().map(Scene::compile_visual).collect::<supple::mujoco::Result<Vec<Model>>>()?;
        let parts = self.names.iter().zip(&self.scenes).zip(&models);
        let views = RobotView::several(parts.map(|((name, scene), model)| (name.as_str(), model, scene)));
        (if is_live { Recorder::live } else { Recorder::new })(sink, "drive", &views)
    }
}

impl Snapshot {
    /// Creates the snapshot before the first step.
    pub fn new(cast: Cast) -> Self {
        let count = cast.names.len();
        let (beginnings, events) = (vec![0; count], vec![(0, None); count]);
        Snapshot { cast: Arc::new(cast), frames: vec![None; count], beginnings, events, is_behind: false }
    }
}

/// The recording of one viewer, with the newest data it has received.
struct View {
    recorder: Recorder,
    last: Snapshot,
}

impl View {
    fn open(shown: &Snapshot, sink: Sink) -> Result<Self, RecordError> {
        let last = Snapshot { frames: vec![None; shown.frames.len()], ..shown.clone() };
        Ok(View { recorder: shown.cast.record(sink, true)?, last })
    }

    /// Logs everything newer than the viewer's data.
    fn update(&mut self, shown: &Snapshot) -> Result<(), RecordError> {
        let last = std::mem::replace(&mut self.last, shown.clone());
        for (robot, frame) in shown.frames.iter().enumerate() {
            let Some(frame) = frame else { continue };
            if last.beginnings[robot] != shown.beginnings[robot] {
                self.recorder.begin_again(robot)?;
            }
            let is_new = !last.frames[robot].as_ref().is_some_and(|last| Arc::ptr_eq(last, frame));
            let (count, event) = &shown.events[robot];
            let event = event.as_ref().filter(|_| last.events[robot].0 != *count);
            self.recorder.step(robot, is_new.then_some(frame), event.map_or(&[], std::slice::from_ref))?;
        }
        Ok(())
    }
}

/// Feeds a viewer until `wait` (for a new snapshot) or `send` (to the viewer) returns false.
fn feed(
    mut updates: watch::Receiver<Snapshot>,
    sink: &Sink,
    wait: impl Fn(&mut watch::Receiver<Snapshot>) -> bool,
    mut send: impl FnMut(&mut Recorder) -> Result<bool, RecordError>,
) -> Result<(), RecordError> {
    let mut view: Option<View> = None;
    updates.mark_changed();
    while wait(&mut updates) {
        let begun = Instant::now();
        let shown = updates.borrow_and_update().clone();
        let mut current = match view.take().filter(|view| Arc::ptr_eq(&view.last.cast, &shown.cast)) {
            Some(view) => view,
            None => View::open(&shown, sink.clone())?,
        };
        current.update(&shown)?;
        if !send(&mut current.recorder)? {
            break;
        }
        view = Some(current);
        let period = if shown.is_behind { PERIOD_BEHIND } else { PERIOD };
        std::thread::sleep(period.saturating_sub(begun.elapsed()));
    }
    Ok(())
}

/// Writes snapshots into a channel of `.rrd` files, one after another, until the receiver is dropped.
///
/// # Errors
/// A recording cannot be opened or written.
pub fn to_channel(
    updates: watch::Receiver<Snapshot>,
    runtime: &Handle,
    to: &mpsc::Sender<Vec<u8>>,
) -> Result<(), RecordError> {
    let wait = |updates: &mut watch::Receiver<Snapshot>| {
        runtime.block_on(async {
            tokio::select! {
                changed = updates.changed() => changed.is_ok(),
                () = to.closed() => false,
            }
        })
    };
    feed(updates, &Sink::Memory, wait, |recorder| {
        let bytes = recorder.take()?;
        Ok(bytes.is_empty() || to.blocking_send(bytes).is_ok())
    })
}

/// Streams snapshots to a separate viewer until it disconnects.
///
/// # Errors
/// No viewer answers, or the connection breaks.
pub fn to_viewer(updates: watch::Receiver<Snapshot>, runtime: &Handle, url: Option<String>) -> Result<(), RecordError> {
    feed(updates, &Sink::Connect(url), |updates| runtime.block_on(updates.changed()).is_ok(), |_| Ok(true))
}
