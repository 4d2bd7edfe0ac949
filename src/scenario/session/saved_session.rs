/*! Saved sessions: JSON Lines files from which a session is replayed.

The first line states the format. Then come the inputs in order, each with its tick, the first of them a setup; before
the first one that needs it, the data of its policy: the file if it does not ship, and its calibration. The last line
has the tick at which the session was saved and the fingerprint of the state then, to which a replay is compared.

The file is written during the session, so that hours take no memory; saving copies it.
*/

use std::collections::{HashMap, VecDeque};
use std::fs::File;
use std::io::{self, BufRead, BufReader, BufWriter, Read, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{AgentCache, Input, LiveSession, RATE_HZ, RobotStep, SessionError, Setup};
use crate::policy::compliance::PolicyCalibration;
use crate::provenance;
use crate::util::files::{self, FileError};

/// Version of the format; additions do not change it.
const FORMAT: u32 = 1;

/// Name of the file type in error messages.
const SESSION: &str = "session";

/// Maximum length of a line \[bytes\]: a policy of 64 MiB in hexadecimal.
const LONGEST_LINE: u64 = 130 << 20;

/// Maximum length of a session \[days\], which takes hours to replay.
const LONGEST_DAYS: u64 = 30;

/// Maximum length of a session \[ticks\].
const LONGEST: u64 = LONGEST_DAYS * 24 * 3600 * RATE_HZ;

#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    Session {
        format: u32,
        /// Revision and MuJoCo of the program that kept it.
        program: String,
        /// Index of the first tick that a replay shows.
        from_tick: u64,
    },
    Policy {
        name: String,
        sha256: String,
        /// Bytes of the policy file in hexadecimal; absent for shipped and external policies.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        file: Option<String>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        calibration: Option<PolicyCalibration>,
    },
    Input {
        tick: u64,
        input: Input,
    },
    End {
        tick: u64,
        state: String,
    },
}

/// A writer of a session in progress.
#[derive(Debug)]
pub struct Writer {
    file: BufWriter<File>,
    length: u64,
    /// Tick and file offset of each setup's line.
    setups: VecDeque<(u64, u64)>,
    /// File offsets of start and end of each policy's line; a policy calibrated later has a second line.
    policies: HashMap<(String, bool), (u64, u64)>,
}

impl Writer {
    /// Starts writing into an empty file, which must also be readable.
    pub fn new(file: File) -> Self {
        Writer { file: BufWriter::new(file), length: 0, setups: VecDeque::new(), policies: HashMap::new() }
    }

    /// Writes an input that takes effect at a tick.
    ///
    /// # Errors
    /// The file cannot be written, for example because the disk is full.
    pub fn input(&mut self, tick: u64, input: &Input, shelf: &AgentCache) -> io::Result<()> {
        let needed: Vec<(&str, &str)> = match input {
            Input::Setup(setup) => {
                self.setups.push_back((tick, self.length));
                setup.robots.iter().map(|seat| (seat.policy.as_str(), seat.sha256.as_str())).collect()
            }
            Input::Renew { sha256, .. } => vec![("renewed", sha256)],
            _ => Vec::new(),
        };
        for (name, sha256) in needed {
            let (file, calibration) = (shelf.file(sha256), shelf.calibration(sha256).cloned());
            let key = (sha256.to_owned(), calibration.is_some());
            if file.is_none() && calibration.is_none() || self.policies.contains_key(&key) {
                continue;
            }
            let begin = self.length;
            let file = file.map(|file| file.iter().map(|byte| format!("{byte:02x}")).collect());
            self.line(&Line::Policy { name: name.to_owned(), sha256: sha256.to_owned(), file, calibration })?;
            self.policies.insert(key, (begin, self.length));
        }
        self.line(&Line::Input { tick, input: input.clone() })
    }

    fn line(&mut self, line: &Line) -> io::Result<()> {
        let text = serde_json::to_string(line)? + "\n";
        self.length += text.len() as u64;
        self.file.write_all(text.as_bytes())
    }

    /// Returns the session up to the tick `end`, at which the fingerprint of the state is `state`: all of it, or the part
    /// needed to replay it from tick `from` on. It can be copied while the session goes on.
    ///
    /// # Errors
    /// The file of the session cannot be written, for example because the disk is full, or the part is too long to be
    /// replayed.
    pub fn part(&mut self, from: Option<u64>, end: u64, state: String) -> io::Result<SessionPart> {
        self.file.flush()?;
        let from_tick = from.unwrap_or(0);
        // The part begins with the last setup at or before `from`.
        let last = self.setups.iter().rev().find(|(tick, _)| from.is_some() && *tick <= from_tick);
        let (since, begin) = last.copied().unwrap_or((0, 0));
        ensure!(end - since <= LONGEST, io::Error::other(format!("it is longer than {LONGEST_DAYS} days")));
        let program = provenance::revision_and_mujoco();
        let first = serde_json::to_string(&Line::Session { format: FORMAT, program, from_tick })?;
        let last = serde_json::to_string(&Line::End { tick: end, state })?;
        let mut parts: Vec<(u64, u64)> = self.policies.values().copied().filter(|(at, _)| *at < begin).collect();
        parts.sort_unstable();
        parts.push((begin, self.length));
        Ok(SessionPart { file: self.file.get_ref().try_clone()?, first, parts, last })
    }

    /// Drops the offsets of setups that are not needed to replay the session from a tick on.
    pub fn tidy(&mut self, from: u64) {
        while self.setups.get(1).is_some_and(|(tick, _)| *tick <= from) {
            self.setups.pop_front();
        }
    }
}

/// A session up to some tick, or its last part.
#[derive(Debug)]
pub struct SessionPart {
    file: File,
    first: String,
    /// Start and end of each piece of the file.
    parts: Vec<(u64, u64)>,
    last: String,
}

impl SessionPart {
    /// Writes the session into a new file.
    ///
    /// # Errors
    /// There is such a file already, or it cannot be written, for example because the disk is full.
    pub fn write_new(&self, path: &Path) -> io::Result<()> {
        files::write_new(path, |out| {
            writeln!(out, "{}", self.first)?;
            let mut buffer = vec![0; 64 << 10];
            for &(mut from, until) in &self.parts {
                while from < until {
                    let length = buffer.len().min((until - from) as usize);
                    self.file.read_exact_at(&mut buffer[..length], from)?;
                    out.write_all(&buffer[..length])?;
                    from += length as u64;
                }
            }
            writeln!(out, "{}", self.last)
        })
    }
}

/// A session loaded from a file.
#[derive(Debug)]
pub struct SavedSession {
    /// Revision and MuJoCo of the program that kept the session.
    pub program: String,
    /// Index of the first tick that a replay shows.
    pub from_tick: u64,
    /// Tick and fingerprint of the state at the end; `None` if the file was cut off.
    pub end: Option<(u64, String)>,
    inputs: Vec<(u64, Input)>,
    shelf: AgentCache,
}

impl SavedSession {
    /// Reads a session.
    ///
    /// # Errors
    /// The file is not a valid session; the error names the line.
    pub fn load(path: &Path) -> Result<Self, SessionError> {
        let fail = FileError::of(SESSION, path);
        let mut reader = BufReader::new(files::open(path).map_err(fail)?);
        let (program, shelf) = (String::new(), AgentCache::default());
        let mut session = SavedSession { program, from_tick: 0, end: None, inputs: Vec::new(), shelf };
        let mut text = String::new();
        for number in 1_u64.. {
            text.clear();
            let in_line = |problem: String| FileError::of(SESSION, path)(format!("line {number}: {problem}"));
            let length =
                (&mut reader).take(LONGEST_LINE).read_line(&mut text).map_err(|error| in_line(error.to_string()))?;
            if length == 0 {
                break;
            }
            // A last line without its end was being written.
            if !text.ends_with('\n') && number > 1 {
                break;
            }
            let line: Line =
                serde_json::from_str(&text).map_err(|error| in_line(format!("it is no session: {error}")))?;
            session.add(number, line).map_err(in_line)?;
        }
        let Some((since, Input::Setup(_))) = session.inputs.first() else {
            return Err(FileError::of(SESSION, path)("it does not begin with a set-up: was it cut off?").into());
        };
        let end = session.end();
        if end.saturating_sub(*since) > LONGEST || end > u64::MAX / 2 {
            let problem = format!(
                "it ends at tick {end}, more than {LONGEST_DAYS} days after its start at tick {since}: was it edited?"
            );
            return Err(FileError::of(SESSION, path)(problem).into());
        }
        Ok(session)
    }

    fn add(&mut self, number: u64, line: Line) -> Result<(), String> {
        match line {
            Line::Session { format, program, from_tick } if number == 1 => {
                ensure!(format == FORMAT, "it has format {format}, this program reads {FORMAT}");
                (self.program, self.from_tick) = (program, from_tick);
            }
            _ if number == 1 => return Err("it does not say that it is a session".to_owned()),
            Line::Session { .. } => return Err("a second session begins".to_owned()),
            Line::Policy { name, sha256, file, calibration } => {
                if let Some(calibration) = calibration {
                    let fail = |problem| format!("the calibration of the policy '{name}': {problem}");
                    self.shelf.put_calibration(calibration.checked(&sha256).map_err(fail)?);
                }
                let Some(file) = file else { return Ok(()) };
                let bytes = bytes(&file).ok_or("the policy's file is not in hexadecimal")?;
                ensure!(crate::util::files::sha256(&[&bytes]) == sha256, "the policy '{name}' is damaged");
                self.shelf.put_file(&name, bytes).map_err(|error| error.to_string())?;
            }
            Line::Input { tick, input } => {
                if self.inputs.last().is_some_and(|(last, _)| *last > tick) {
                    return Err(format!("tick {tick} comes after a later one"));
                }
                self.inputs.push((tick, input));
            }
            Line::End { tick, state } => self.end = Some((tick, state)),
        }
        Ok(())
    }

    /// Returns the first setup.
    pub fn setup(&self) -> Option<&Setup> {
        match self.inputs.first() {
            Some((_, Input::Setup(setup))) => Some(setup),
            _ => None,
        }
    }

    /// Returns the inputs with their ticks.
    pub fn inputs(&self) -> &[(u64, Input)] {
        &self.inputs
    }

    /// Returns the tick at which the replay ends.
    fn end(&self) -> u64 {
        let last = self.inputs.last().map_or(0, |(tick, _)| *tick);
        self.end.as_ref().map_or(last, |(tick, _)| *tick)
    }

    /// Starts a replay.
    ///
    /// # Errors
    /// A policy or robot no longer exists or has changed.
    pub fn play(mut self) -> Result<SessionReplay, SessionError> {
        let (since, setup) = match self.inputs.first() {
            Some((since, Input::Setup(setup))) => (*since, setup.clone()),
            _ => unreachable!("`load` refuses a session that does not begin with a set-up"),
        };
        let world = LiveSession::new(setup, &mut self.shelf)?.starting_at(since);
        Ok(SessionReplay { world, end: self.end(), next: 1, session: self })
    }
}

fn bytes(hex: &str) -> Option<Vec<u8>> {
    let digits = hex.as_bytes();
    let digit = |digit: u8| char::from(digit).to_digit(16);
    let pair = |pair: &[u8]| Some((digit(pair[0])? << 4 | digit(pair[1])?) as u8);
    digits.len().is_multiple_of(2).then(|| digits.chunks_exact(2).map(pair).collect())?
}

/// A replay of a saved session.
#[derive(Debug)]
pub struct SessionReplay {
    session: SavedSession,
    /// The session being replayed.
    pub world: LiveSession,
    end: u64,
    next: usize,
}

/// A step of a [`SessionReplay`].
#[derive(Debug)]
pub struct ReplayStep {
    /// The tick at which the step began.
    pub tick: u64,
    /// Inputs that took effect with the step.
    pub inputs: Vec<Input>,
    /// Policy steps of the robots.
    pub played: Vec<RobotStep>,
}

impl SessionReplay {
    /// Returns true if the step that begins at this tick is shown.
    pub fn is_shown(&self, tick: u64) -> bool {
        tick >= self.session.from_tick
    }

    /// Applies the inputs that are due and plays one step; `None` at the end.
    ///
    /// # Errors
    /// An input cannot be applied, or MuJoCo fails.
    pub fn step(&mut self) -> Result<Option<ReplayStep>, SessionError> {
        let mut inputs = Vec::new();
        while let Some((_, input)) = self.session.inputs.get(self.next).filter(|(tick, _)| *tick <= self.world.tick()) {
            self.world.apply(input, &mut self.session.shelf)?;
            inputs.push(input.clone());
            self.next += 1;
        }
        let tick = self.world.tick();
        if tick >= self.end {
            return Ok(None);
        }
        Ok(Some(ReplayStep { tick, inputs, played: self.world.step()? }))
    }

    /// Compares the state at the end with the saved one, to the last bit; `None` if the file has no saved state.
    ///
    /// # Errors
    /// They differ; the sentence names the programs that computed them.
    pub fn verify(&self) -> Option<Result<(), String>> {
        let (_, state) = self.session.end.as_ref()?;
        if *state == self.world.fingerprint() {
            return Some(Ok(()));
        }
        let (original, this) = (&self.session.program, provenance::revision_and_mujoco());
        let reason = if *original == this { "another machine, or the file was edited" } else { "another program" };
        Some(Err(format!("the final state differs from the original of {original}, replayed by {this}: {reason}")))
    }
}
