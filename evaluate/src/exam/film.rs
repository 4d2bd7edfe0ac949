//! A film strip of a fall: the trial is played again and drawn by MuJoCo, without a screen.

use resvg::tiny_skia::{ColorU8, Pixmap};

use super::{DISCIPLINES, Exam, Part};
use crate::measurement_store::MeasurementStore;
use crate::runner::RunError;
use crate::trial::{self, TrialEnd, TrialError};
use supple::mujoco::{self, Camera, Renderer};
use supple::scenario::Playback;
use supple::scenario::trace::{EventKind, Frame, Pose};

/// The width and the height of a picture \[px\].
const SIZE: [usize; 2] = [320, 240];

/// The times of the pictures, from the fall on \[s\].
const TIMES_S: [f64; 6] = [-0.75, -0.45, -0.25, -0.1, 0.0, 0.25];

/// The length of the playback after the fall \[s\].
const AFTER_FALL_S: f64 = 0.3;

/// The reason why there is no film strip.
#[derive(Debug, thiserror::Error)]
pub enum FilmError {
    /// The measurements cannot be read.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The trial cannot be played.
    #[error(transparent)]
    Trial(#[from] TrialError),
    /// The scene cannot be drawn.
    #[error(transparent)]
    Picture(#[from] mujoco::Error),
    /// The robot does not fall when the trial is played again, as a policy may have a state outside this program.
    #[error("the robot does not fall when the trial is played again")]
    NoFall,
    /// The strip cannot be encoded.
    #[error("cannot encode the film strip: {0}")]
    Encode(Box<dyn std::error::Error + Send + Sync>),
}

/// The film strip of a fall.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Film {
    /// A sentence about the trial, the cause of the fall and the times of the pictures.
    pub caption: String,
    /// The strip as a PNG file.
    pub png: Vec<u8>,
}

impl Exam {
    /// Draws the first fall of the examined policy in the condition in which it falls most often; none if it never falls.
    ///
    /// # Errors
    /// The trial cannot be played, or nothing can be drawn here (the error says what to install).
    pub fn first_fall(&self, store: &MeasurementStore) -> Result<Option<Film>, FilmError> {
        let mut worst: Option<(f64, Part<'_>, [usize; 2])> = None;
        for (name, way, _) in DISCIPLINES.iter().flat_map(|discipline| self.playable(discipline)) {
            let results = self.part(name, *way).results(store)?;
            let Some(policy) = results.as_ref().and_then(|results| results.sets[0].values().next()) else { continue };
            for (condition, samples) in policy.iter().enumerate() {
                let fell = |sample: &&trial::Sample| sample.end == TrialEnd::Fell;
                let Some(trial) = samples.iter().position(|sample| fell(&sample)) else { continue };
                let fraction = samples.iter().filter(fell).count() as f64 / samples.len() as f64;
                if worst.as_ref().is_none_or(|(most, ..)| fraction > *most) {
                    worst = Some((fraction, self.part(name, *way), [condition, trial]));
                }
            }
        }
        worst.map(|(_, part, at)| draw(&part, at)).transpose()
    }
}

/// Draws the fall of the examined policy in a trial of a condition.
fn draw(part: &Part<'_>, [index, trial]: [usize; 2]) -> Result<Film, FilmError> {
    let Part { experiment, policies, sensing, .. } = *part;
    let (info, condition) = (experiment.info(), &experiment.conditions().map_err(RunError::from)?[index]);
    let member = &policies[0].members[0];
    let seed = trial::trial_seed(member.seed, info.number, index, trial as u32);
    let (_, mut script) = trial::setup(condition, seed, &member.agent)?.ok_or(FilmError::NoFall)?;
    script.after_fall_s = AFTER_FALL_S;
    let playback = Playback::new(&script, &member.agent.config, member.agent.controller())?;
    let playback = playback.with_sensing(sensing, seed).map_err(TrialError::from)?;
    let trace = playback.with_bodies().trace();
    let fall = trace.events.iter().find(|event| event.kind == EventKind::Fall).ok_or(FilmError::NoFall)?;
    let mut renderer = Renderer::new(script.scene.compile_visual()?, SIZE)?;
    let [width, height] = SIZE.map(|pixels| pixels as u32);
    let mut strip =
        Pixmap::new(width * TIMES_S.len() as u32, height).ok_or(FilmError::Encode("it is too large".into()))?;
    for (index, time_s) in TIMES_S.iter().enumerate() {
        let later = trace.frames.partition_point(|frame| frame.time_s < fall.time_s + time_s);
        let frame = &trace.frames[later.min(trace.frames.len() - 1)];
        let poses: Vec<[f32; 7]> = frame.bodies.iter().map(Pose::row).collect();
        let picture = renderer.picture(&poses, &camera(frame), &[])?;
        for (row, line) in picture.chunks_exact(3 * SIZE[0]).enumerate() {
            let start = row * SIZE[0] * TIMES_S.len() + index * SIZE[0];
            for (pixel, colour) in strip.pixels_mut()[start..][..SIZE[0]].iter_mut().zip(line.chunks_exact(3)) {
                *pixel = ColorU8::from_rgba(colour[0], colour[1], colour[2], 255).premultiply();
            }
        }
    }
    let (title, label, count, after_s) = (info.title, &condition.label, trial + 1, fall.time_s);
    let (text, times) = (&fall.text, TIMES_S.map(|time| format!("{time:+.2}")).join(", ").replace('-', "−"));
    let caption = format!(
        "The first fall in the condition in which it falls most often: {title}, {label}, trial {count} (seed {seed}), \
             {after_s:.2} s after its start: {text}. The pictures are at {times} s from the fall."
    );
    Ok(Film { caption, png: strip.encode_png().map_err(|error| FilmError::Encode(error.into()))? })
}

/// Returns a camera beside the robot, behind and above.
fn camera(frame: &Frame) -> Camera {
    let [x, y, z] = frame.position;
    Camera { target: [x, y, z - frame.height_m + 0.2], distance_m: 1.6, azimuth_deg: 45.0, elevation_deg: -25.0 }
}
