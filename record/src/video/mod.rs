/*! Videos of finished playbacks: one picture for each robot, side by side, over a plot of what a disturbance leaves.

Start with [`Video`]. Pictures are drawn by MuJoCo without a screen; frames depend on the traces alone, so that the same playback
gives the same frames on the same OpenGL.
*/

mod canvas;
mod encode;
mod panel;
mod view;

use std::path::{Path, PathBuf};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use encode::{Encoder, Format};
use panel::Panel;
use supple::mujoco::{self, Model, Renderer};
use supple::scenario::trace::Trace;
use supple::util::files::{self, FileError, Target};
use view::View;

use super::RobotView;

/// Frames of a video in one second of simulation.
pub const FRAME_RATE: u32 = 30;

/// Smallest and largest width and height of a video \[px\].
const SIZES: [[usize; 2]; 2] = [[480, 270], [3840, 2160]];

/// The reason why there is no video.
#[derive(Debug, thiserror::Error)]
pub enum VideoError {
    /// The file cannot be written, or its name has none of the known endings.
    #[error(transparent)]
    Write(#[from] FileError),
    /// The size is out of range.
    #[error("the size of the video is {0}x{1} px, expected even numbers from 480x270 to 3840x2160")]
    Size(usize, usize),
    /// There is no picture of this robot to show.
    #[error("there is no frame of {0} to show: its playback ended before the first step")]
    Empty(String),
    /// A frame of this robot belongs to another scene: it has other bodies than the model.
    #[error(
        "a frame of {robot} has {found} bodies, its model {expected}; draw it with the scene's own visual model, and play it with bodies"
    )]
    #[allow(missing_docs)] // the message names them
    Bodies { robot: String, found: usize, expected: usize },
    /// No picture can be drawn.
    #[error(transparent)]
    Picture(#[from] mujoco::Error),
    /// One of the threads that draw has ended early.
    #[error("cannot draw the video: a thread that draws has stopped")]
    Stopped,
    /// The frames cannot be encoded.
    #[error("cannot encode the video: {0}")]
    Encode(Box<dyn std::error::Error + Send + Sync>),
}

/// A robot and its playback.
type Played<'a> = (RobotView<'a>, &'a Trace);

type Result<T, E = VideoError> = std::result::Result<T, E>;

fn cannot_write<E: ToString>(path: &Path) -> impl Fn(E) -> FileError + Copy {
    FileError::of("cannot write the video", path)
}

/// A video to be written: its file, format and size.
#[derive(Debug, Clone)]
pub struct Video {
    /// Path of the file.
    pub path: PathBuf,
    format: Format,
    size: [usize; 2],
}

impl Video {
    /// Checks that a video of this width and height \[px\] can be drawn and can have this name; writes nothing.
    ///
    /// # Errors
    /// The ending is neither `.mp4` nor `.webp`, the size is out of range, or no OpenGL without a screen is installed.
    pub fn new(path: &Path, size: [usize; 2]) -> Result<Self> {
        let format = Format::of(path).ok_or_else(|| {
            let name = path.with_extension("mp4");
            let words = "its name must end with .mp4 or .webp; name it";
            cannot_write(path)(format!("{words} {}", name.display()))
        })?;
        let [width, height] = size;
        let in_range =
            (0..2).all(|axis| (SIZES[0][axis]..=SIZES[1][axis]).contains(&size[axis]) && size[axis].is_multiple_of(2));
        if !in_range {
            return Err(VideoError::Size(width, height));
        }
        Target::of(path).map_err(cannot_write(path))?;
        Renderer::new(Model::from_xml(&[("nothing.xml", "<mujoco/>")])?, [16, 16])?;
        Ok(Video { path: path.to_owned(), format, size })
    }

    /// Draws the playbacks and writes the file: whole or not at all, in place of one that is there; folders are created. Calls
    /// `drawn` after each frame with the number of frames that are drawn and of all frames.
    ///
    /// # Errors
    /// A trace has no frames, MuJoCo or the encoder fails, or the file cannot be written.
    pub fn write(&self, title: &str, robots: &[Played<'_>], mut drawn: impl FnMut(u64, u64)) -> Result<()> {
        let failed = cannot_write(&self.path);
        if let Some(folder) = self.path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(failed)?;
        }
        // The file is opened first, so that a folder without write access fails before the work.
        let mut problem = None;
        let written = files::write_with(&self.path, |file| match self.encode(title, robots, &mut drawn) {
            Ok(bytes) => file.write_all(&bytes),
            Err(error) => {
                problem = Some(error);
                Err(std::io::Error::other("there is no video"))
            }
        });
        match problem {
            Some(error) => Err(error),
            None => Ok(written.map_err(failed)?),
        }
    }

    fn encode(&self, title: &str, robots: &[Played<'_>], drawn: &mut dyn FnMut(u64, u64)) -> Result<Vec<u8>> {
        let mut panel = Panel::new(self.size, title, robots)?;
        let mut encoder = Encoder::new(self.format, self.size)?;
        let end_s = robots.iter().filter_map(|(_, trace)| Some(trace.frames.last()?.time_s)).fold(0.0, f64::max);
        let count = (end_s * f64::from(FRAME_RATE)).round().max(1.0) as u64;
        let time_s = |frame: u64| frame as f64 / f64::from(FRAME_RATE);
        let size = panel.picture_size();
        // A thread for each robot, on which its renderer stays.
        std::thread::scope(|scope| {
            let draw = |(robot, trace): &Played<'_>, to: SyncSender<_>| match View::new(robot, trace, size) {
                // Sending ends if the video has failed, as nothing receives its pictures.
                Ok(mut view) => drop((1..=count).try_for_each(|frame| to.send(view.picture(time_s(frame))))),
                Err(error) => drop(to.send(Err(error))),
            };
            let start = |robot| {
                let (to, from) = sync_channel(2);
                scope.spawn(move || draw(robot, to));
                from
            };
            let pictures: Vec<_> = robots.iter().map(start).collect();
            for frame in 1..=count {
                let next = |from: &Receiver<_>| from.recv().unwrap_or(Err(VideoError::Stopped));
                let pictures = pictures.iter().map(next).collect::<Result<Vec<_>, _>>()?;
                encoder.frame(panel.compose(time_s(frame), &pictures))?;
                drawn(frame, count);
            }
            Ok::<_, VideoError>(())
        })?;
        encoder.finish()
    }
}
