/*! The output stream of a recording, to a file or to a viewer: it can fail but not hang.

rerun writes on threads of its own, hides their errors, and waits for ever for a viewer that has stopped
reading. So the stream is flushed regularly with a time limit, which turns a full disk and a hung viewer into errors
while the program runs; a stream that has failed is dropped in the background; and a finished file is checked for the
footer that is written last.

A live stream has no time: all its data are static, so that new data replace old ones, in this program's memory and in
the viewer's, which stays constant for hours. A viewer keeps static transforms and forgets other static data,
so transforms are used to place the shapes of entities.
*/

use std::fs::{self, File};
use std::io::{self, Read as _, Seek as _, SeekFrom};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, SystemTime};

use re_sdk_types::archetypes::{Clear, InstancePoses3D, Transform3D};
use re_sdk_types::datatypes::Quaternion;
use rerun::external::re_log_encoding::rrd::{Decodable as _, StreamFooter};
use rerun::log::ChunkBatcherConfig;
use rerun::sink::{BinaryStreamSink, BinaryStreamStorage};
use rerun::web_viewer::WebViewerConfig;
use rerun::{
    AsComponents, EntityPath, MemoryLimit, RecordingStream, RecordingStreamBuilder, RecordingStreamError, ServerOptions,
};
use supple::util::files::{FileError, Target};

use super::style::PATIENCE;
use super::{RecordError, Result};

/// Name under which viewers store our recordings and layouts.
pub(super) const APPLICATION: &str = "supple";
/// Batching for live viewers: small batches.
const LIVE: ChunkBatcherConfig =
    ChunkBatcherConfig { flush_tick: Duration::from_millis(30), ..ChunkBatcherConfig::LOW_LATENCY };
/// Name of the only timeline, simulation time \[s\].
pub(super) const TIMELINE: &str = "sim_time";

/// Destination of a recording.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Sink {
    /// A new `.rrd` file; folders are created, an existing file is replaced.
    File(PathBuf),
    /// A running viewer: its URL such as `rerun+http://127.0.0.1:9876/proxy`, or the one on this machine.
    Connect(Option<String>),
    /// Web browsers on this machine: the viewer's page is on this port, see [`page_url`], and its data on the next one.
    /// Both are served until the recording is finished; a page opened later still gets all data.
    Serve(u16),
    /// Memory, from which [`Recorder::take`](super::Recorder::take) takes the data.
    Memory,
}

/// Checks that a recording can have this name: that of a file that ends with `.rrd`, as the viewer expects, or of a device.
///
/// # Errors
/// The name has another ending or none, or stands for a folder or standard output.
pub fn check_name(path: &Path) -> Result<()> {
    let problem = match Target::of(path).map_err(cannot_create(path))? {
        Target::Output => "a recording cannot go to standard output: name a file".to_owned(),
        Target::File(_) if path.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("rrd")) => format!(
            "it is for the rerun viewer, so its name ends with .rrd; name it {}",
            path.with_extension("rrd").display()
        ),
        Target::File(_) | Target::Stream(_) => return Ok(()),
    };
    Err(cannot_create(path)(problem).into())
}

fn cannot_create<E: ToString>(path: &Path) -> impl Fn(E) -> FileError + Copy {
    FileError::of("cannot create the recording", path)
}

/// Returns the address of the page that [`Sink::Serve`] serves on a port, with the recording open in it.
pub fn page_url(port: u16) -> String {
    format!("http://{LOCAL}:{port}?url=rerun%2Bhttp://{LOCAL}:{}/proxy", port.saturating_add(1))
}

/// Address on which pages are served, for this machine alone.
const LOCAL: &str = "127.0.0.1";

/// Returns a builder that ignores the variable `RERUN`, because `RERUN=off` would silently lose a requested recording.
fn builder(title: &str) -> Result<RecordingStreamBuilder> {
    check_clock(SystemTime::now())?;
    Ok(RecordingStreamBuilder::new(APPLICATION).enabled(true).recording_name(title))
}

/// Refuses a time at which rerun would panic.
pub(super) fn check_clock(now: SystemTime) -> Result<()> {
    if now < SystemTime::UNIX_EPOCH { Err(RecordError::Clock) } else { Ok(()) }
}

/// The server of the viewer's page, whose type rerun does not name.
type Page = Box<dyn std::any::Any + Send>;

/// An open recording.
pub(super) struct Stream {
    /// The rerun stream; `None` after a failure.
    recording: Option<RecordingStream>,
    /// True for live streams, which keep only the latest value of each entity.
    pub(super) is_live: bool,
    /// Data that were logged in memory and not yet returned by `take`.
    memory: Option<BinaryStreamStorage>,
    file: Option<PathBuf>,
    /// The server of the viewer's page, which runs until this is dropped.
    _page: Option<Page>,
    /// Path of the file or URL of the viewer, for error messages.
    target: String,
    /// Number of frames between two flushes.
    frames_per_flush: usize,
    frames: usize,
}

impl Stream {
    /// Creates the file, connects to the viewer, or starts to store data in memory.
    pub(super) fn open(sink: Sink, title: &str, is_live: bool) -> Result<Self> {
        let builder = builder(title)?;
        let (mut memory, mut file, mut page) = (None, None, None);
        let (recording, target) = match sink {
            Sink::File(path) => {
                let target = path.display().to_string();
                check_name(&path)?;
                if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
                    fs::create_dir_all(folder).map_err(cannot_create(&path))?;
                }
                File::create(&path).map_err(cannot_create(&path))?;
                // Few large chunks: each costs some kilobytes of description.
                let batches = ChunkBatcherConfig { flush_num_bytes: 8 << 20, ..ChunkBatcherConfig::NEVER };
                let failed = |error: RecordingStreamError| RecordError::Write(target.clone(), error.to_string());
                let recording = builder.batcher_config(batches).save(&path).map_err(failed)?;
                file = Some(path);
                (recording, target)
            }
            Sink::Connect(url) => {
                let target = url.unwrap_or_else(|| rerun::DEFAULT_CONNECT_URL.to_owned());
                let recording = builder
                    .batcher_config(LIVE)
                    .connect_grpc_opts(target.clone())
                    .map_err(|error| RecordError::Viewer(target.clone(), error.to_string()))?;
                (recording, target)
            }
            Sink::Serve(port) => {
                let (recording, server) = serve(builder, port)?;
                page = Some(server);
                (recording, page_url(port))
            }
            Sink::Memory => {
                // The reader flushes before it takes the data.
                let recording = builder.batcher_config(ChunkBatcherConfig::NEVER).buffered()?;
                let (sink, storage) = BinaryStreamSink::new(recording.clone());
                recording.set_sink(Box::new(sink));
                memory = Some(storage);
                (recording, "in memory".to_owned())
            }
        };
        recording.set_log_time_enabled(false);
        recording.set_log_tick_enabled(false);
        let frames_per_flush = if file.is_some() { 1200 } else { 120 };
        let recording = Some(recording);
        let mut stream = Stream { recording, is_live, memory, file, _page: page, target, frames_per_flush, frames: 0 };
        match stream.flush() {
            Err(RecordError::Write(target, _)) if stream.file.is_none() => {
                Err(RecordError::Viewer(target, format!("nothing within {PATIENCE:?}")))
            }
            flushed => flushed.map(|()| stream),
        }
    }

    /// Takes the data logged since the last call, as a complete `.rrd` file.
    pub(super) fn take(&mut self) -> Result<Vec<u8>> {
        self.flush()?;
        Ok(self.memory.as_ref().and_then(BinaryStreamStorage::read).unwrap_or_default())
    }

    /// Returns the rerun stream, or the error of a stream that has failed.
    pub(super) fn recording(&self) -> Result<&RecordingStream> {
        let problem =
            || RecordError::Write(self.target.clone(), "it has failed before and takes no more data".to_owned());
        self.recording.as_ref().ok_or_else(problem)
    }

    /// Sets the current time, for all data logged from now on \[s\].
    pub(super) fn set_time(&self, time_s: f64) -> Result<()> {
        if !self.is_live {
            self.recording()?.set_duration_secs(TIMELINE, time_s);
        }
        Ok(())
    }

    /// Logs data at the current time.
    pub(super) fn log(&self, path: &EntityPath, data: &impl AsComponents) -> Result<()> {
        let recording = self.recording()?;
        Ok(if self.is_live { recording.log_static(path.clone(), data) } else { recording.log(path.clone(), data) }?)
    }

    /// Logs position and orientation of an entity.
    pub(super) fn place(&self, path: &EntityPath, translation: [f32; 3], quaternion: Option<Quaternion>) -> Result<()> {
        if self.is_live {
            let pose = InstancePoses3D::update_fields().with_translations([translation]);
            return match quaternion {
                Some(quaternion) => self.log_static(path, &pose.with_quaternions([quaternion])),
                None => self.log_static(path, &pose),
            };
        }
        let pose = Transform3D::update_fields().with_translation(translation);
        match quaternion {
            Some(quaternion) => self.log(path, &pose.with_quaternion(quaternion)),
            None => self.log(path, &pose),
        }
    }

    /// Replaces all data of an entity. Data of one flush arrive in any order, and in a live stream an update that
    /// arrives after its replacement would stay for ever: so the stream is flushed first.
    pub(super) fn replace(&self, path: &EntityPath, data: &impl AsComponents) -> Result<()> {
        if self.is_live {
            self.recording()?.flush_with_timeout(PATIENCE).map_err(|error| self.unwritten(&error))?;
        }
        self.log(path, data)
    }

    /// Removes an entity; `nothing` is the same archetype without content.
    pub(super) fn clear(&self, path: &EntityPath, nothing: &impl AsComponents) -> Result<()> {
        if self.is_live { self.replace(path, nothing) } else { self.log(path, &Clear::flat()) }
    }

    /// Logs static data, which hold at all times.
    pub(super) fn log_static(&self, path: &EntityPath, data: &impl AsComponents) -> Result<()> {
        Ok(self.recording()?.log_static(path.clone(), data)?)
    }

    /// Counts a frame, and flushes regularly to check that the data have arrived.
    pub(super) fn end_frame(&mut self) -> Result<()> {
        self.frames = (self.frames + 1) % self.frames_per_flush;
        if self.frames == 0 { self.flush() } else { Ok(()) }
    }

    fn flush(&mut self) -> Result<()> {
        let flushed = self.recording()?.flush_with_timeout(PATIENCE);
        flushed.map_err(|error| {
            self.recording.take().map(drop_in_background);
            self.unwritten(&error)
        })
    }

    fn unwritten(&self, error: &impl std::fmt::Display) -> RecordError {
        let hint = if self.file.is_some() { "; is the disk full?" } else { "" };
        RecordError::Write(self.target.clone(), format!("{error}{hint}"))
    }

    /// Writes all data and closes the file or the connection.
    pub(super) fn finish(mut self) -> Result<()> {
        self.flush()?;
        let failed = |reason: &str| RecordError::Write(self.target.clone(), reason.to_owned());
        let closed = self.recording.take().map(drop_in_background);
        // Without a thread of its own, it was closed at once.
        if closed.is_some_and(|closed| closed.recv_timeout(PATIENCE) == Err(RecvTimeoutError::Timeout)) {
            return Err(failed("it could not be closed"));
        }
        match &self.file {
            Some(path) if !has_footer(path) => Err(failed("its end could not be written; is the disk full?")),
            _ => Ok(()),
        }
    }
}

/// Serves a recording on `port + 1` and a viewer's page for it on `port`.
fn serve(builder: RecordingStreamBuilder, port: u16) -> Result<(RecordingStream, Page)> {
    let no_port = || RecordError::Serve(port, "there is no port after it for the data".into());
    let data_port = port.checked_add(1).ok_or_else(no_port)?;
    // rerun's own servers report a port that is taken to their log, not to us.
    for port in [port, data_port] {
        drop(TcpListener::bind((LOCAL, port)).map_err(|error| RecordError::Serve(port, error.to_string()))?);
    }
    let options = ServerOptions { memory_limit: MemoryLimit::from_fraction_of_total(0.25), ..ServerOptions::default() };
    let recording = builder.batcher_config(LIVE).serve_grpc_opts(LOCAL, data_port, options)?;
    let (bind_ip, web_port) = (LOCAL.to_owned(), port.into());
    let page = WebViewerConfig { bind_ip, web_port, open_browser: false, ..WebViewerConfig::default() };
    let server = page.host_web_viewer().map_err(|error| RecordError::Serve(port, error.to_string()))?;
    Ok((recording, Box::new(server)))
}

/// Drops the rerun stream in the background, because closing it may hang.
impl Drop for Stream {
    fn drop(&mut self) {
        if self.recording.is_some() {
            // An error while dropping has no receiver.
            let _ = self.flush();
        }
    }
}

/// Closes a recording in the background, because that may hang, and notifies the receiver when it is done.
fn drop_in_background(recording: RecordingStream) -> Receiver<()> {
    let (done, wait) = std::sync::mpsc::channel();
    let close = move || {
        drop(recording);
        // The receiver may have gone.
        let _ = done.send(());
    };
    // Without a thread the closure is dropped here, and the recording with it.
    drop(std::thread::Builder::new().name("closing a recording".into()).spawn(close));
    wait
}

/// Returns true if a file ends with the footer of a complete recording.
fn has_footer(path: &Path) -> bool {
    let tail = || -> io::Result<Vec<u8>> {
        let mut file = File::open(path)?;
        file.seek(SeekFrom::End(-(StreamFooter::ENCODED_SIZE_BYTES as i64)))?;
        let mut tail = Vec::new();
        file.read_to_end(&mut tail)?;
        Ok(tail)
    };
    tail().is_ok_and(|tail| StreamFooter::from_rrd_bytes(&tail).is_ok())
}
