/*! What is shown of the robots: the newest frames, of which every viewer takes what it can.

A viewer has a recording of its own, written on a thread of its own, of what is so now. One that comes late, or that is slow,
misses frames and nothing else: each frame is logged in relation to what this viewer was sent before.
*/

use std::sync::Arc;
use std::time::{Duration, Instant};

use supple::mujoco::Model;
use supple::scenario::session::LiveSession;
use supple::scenario::trace::{Event, Frame};
use supple::sim::Scene;
use supple_record::{BLUE, LiveSink, ORANGE, RecordError, Recorder, RobotView, Sink};
use tokio::runtime::Handle;
use tokio::sync::{mpsc, watch};

/// Least time between two frames of a viewer.
const PERIOD: Duration = Duration::from_millis(15);
/// The same while the machine is too slow for real time: pictures give way first.
const PERIOD_BEHIND: Duration = Duration::from_millis(60);

/// Who is played, in which scenes: of one set-up.
#[derive(Debug)]
pub struct Cast {
    /// Names of the robots, all different.
    pub names: Vec<String>,
    /// Their scenes.
    pub scenes: Vec<Scene>,
}

/// What is so now.
#[derive(Debug, Clone)]
pub struct Shown {
    /// Who is played.
    pub cast: Arc<Cast>,
    /// The newest frame of each robot.
    pub frames: Vec<Option<Arc<Frame>>>,
    /// How often each robot was put somewhere.
    pub beginnings: Vec<u64>,
    /// The newest event of each robot, and how many there were.
    pub events: Vec<(u64, Option<Event>)>,
    /// Whether the machine is too slow for real time.
    pub is_behind: bool,
}

impl Cast {
    /// Those of a world.
    pub fn of(world: &LiveSession) -> Self {
        let mut names: Vec<String> = Vec::new();
        for seat in &world.setup().robots {
            let name = seat.label();
            names.push(if names.contains(&name) { format!("{name} (2)") } else { name });
        }
        Cast { names, scenes: world.scenes().cloned().collect() }
    }

    /// Opens a recording of them into a file.
    ///
    /// # Errors
    /// [`RecordError`]
    pub fn record(&self, sink: Sink) -> Result<Recorder, RecordError> {
        self.with_views(|views| Recorder::new(sink, "drive", views))
    }

    /// Opens a recording of what is so now.
    ///
    /// # Errors
    /// [`RecordError`]
    pub fn show(&self, sink: LiveSink) -> Result<Recorder, RecordError> {
        self.with_views(|views| Recorder::live(sink, "drive", views))
    }

    fn with_views<T>(&self, open: impl FnOnce(&[RobotView<'_>]) -> Result<T, RecordError>) -> Result<T, RecordError> {
        let models = self.scenes.iter().map(Scene::compile_visual).collect::<supple::mujoco::Result<Vec<Model>>>()?;
        let tints = if self.names.len() > 1 { vec![Some(BLUE), Some(ORANGE)] } else { vec![None] };
        let parts = self.names.iter().zip(&self.scenes).zip(models.iter().zip(tints));
        let views: Vec<RobotView<'_>> = parts
            .map(|((name, scene), (model, tint))| RobotView {
                name,
                model,
                ground: &scene.ground,
                tint,
                estimates: false,
            })
            .collect();
        open(&views)
    }
}

impl Shown {
    /// Nobody has moved yet.
    pub fn new(cast: Cast) -> Self {
        let count = cast.names.len();
        Shown {
            cast: Arc::new(cast),
            frames: vec![None; count],
            beginnings: vec![0; count],
            events: vec![(0, None); count],
            is_behind: false,
        }
    }
}

/// A viewer's recording, and what of each robot it has shown.
struct View {
    cast: Arc<Cast>,
    recorder: Recorder,
    frames: Vec<Option<Arc<Frame>>>,
    beginnings: Vec<u64>,
    events: Vec<u64>,
}

impl View {
    fn open(shown: &Shown, sink: LiveSink) -> Result<Self, RecordError> {
        Ok(View {
            cast: Arc::clone(&shown.cast),
            recorder: shown.cast.show(sink)?,
            frames: vec![None; shown.frames.len()],
            beginnings: shown.beginnings.clone(),
            events: shown.events.iter().map(|(count, _)| *count).collect(),
        })
    }

    /// Logs what is new.
    fn update(&mut self, shown: &Shown) -> Result<(), RecordError> {
        for robot in 0..shown.frames.len() {
            let Some(frame) = &shown.frames[robot] else { continue };
            if self.beginnings[robot] != shown.beginnings[robot] {
                self.beginnings[robot] = shown.beginnings[robot];
                self.recorder.begin_again(robot)?;
            }
            if !self.frames[robot].as_ref().is_some_and(|last| Arc::ptr_eq(last, frame)) {
                self.recorder.frame(robot, frame)?;
                self.frames[robot] = Some(Arc::clone(frame));
            }
            if let (count, Some(event)) = &shown.events[robot]
                && self.events[robot] != *count
            {
                self.events[robot] = *count;
                self.recorder.event(robot, event)?;
            }
        }
        Ok(())
    }
}

/// Feeds a viewer until it or the robots are gone; `wait` says whether there is something new to show, `send` whether it was
/// taken.
fn feed(
    mut news: watch::Receiver<Shown>,
    sink: &LiveSink,
    wait: impl Fn(&mut watch::Receiver<Shown>) -> bool,
    mut send: impl FnMut(&mut Recorder) -> Result<bool, RecordError>,
) -> Result<(), RecordError> {
    let mut view: Option<View> = None;
    news.mark_changed();
    while wait(&mut news) {
        let begun = Instant::now();
        let shown = news.borrow_and_update().clone();
        let mut current = match view.take().filter(|view| Arc::ptr_eq(&view.cast, &shown.cast)) {
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

/// Writes what there is to see into a channel of `.rrd` files, one after another, until nobody reads them any more.
///
/// # Errors
/// [`RecordError`]
pub fn to_channel(
    news: watch::Receiver<Shown>,
    runtime: &Handle,
    to: &mpsc::Sender<Vec<u8>>,
) -> Result<(), RecordError> {
    let wait = |news: &mut watch::Receiver<Shown>| {
        runtime.block_on(async {
            tokio::select! {
                changed = news.changed() => changed.is_ok(),
                () = to.closed() => false,
            }
        })
    };
    feed(news, &LiveSink::Memory, wait, |recorder| {
        let bytes = recorder.take()?;
        Ok(bytes.is_empty() || to.blocking_send(bytes).is_ok())
    })
}

/// Shows what there is to see in a viewer that runs on its own, until it goes away.
///
/// # Errors
/// [`RecordError`], as if no viewer answers.
pub fn to_viewer(news: watch::Receiver<Shown>, runtime: &Handle, url: Option<String>) -> Result<(), RecordError> {
    feed(news, &LiveSink::Connect(url), |news| runtime.block_on(news.changed()).is_ok(), |_| Ok(true))
}
