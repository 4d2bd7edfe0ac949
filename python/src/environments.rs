/*! Training environments, stepped together on threads of their own.

Each environment is one of training, index and random streams included: the same seed and the same actions give the same
bits. The curriculum advances as in training, after every `ppo.batch_size` samples, until the caller sets it. Start reading
at [`Environments::step`]; `python/lib/supple/environment.py` turns its arrays into Gymnasium's.
*/

use std::sync::{Mutex, PoisonError, TryLockError};

use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::{PyRuntimeError, PyUserWarning, PyValueError};
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use supple::config::Config;
use supple::mujoco;
use supple::observation::Layout;
use supple::robot::{JOINTS, joint_names};
use supple::task::reward::TERMS;
use supple::task::{Command, Stage, Terms};
use supple::train::Curriculum;
use supple::train::environment::{EnvStep, EpisodeEnd, EpisodeReport, LocomotionEnv, Shared};
use supple::train::environments_bytes;
use supple::train::metrics::EpisodeMeans;
use supple::util::memory::{FreeMemory, gibibytes};

use crate::failure::{apart, failed, refused};

/// Number of environments created between two checks for Ctrl-C; any machine has memory for so few.
const MADE: usize = 64;

/// The autoreset modes of Gymnasium.
#[derive(Clone, Copy, PartialEq)]
enum Autoreset {
    /// The next episode begins in the step that ends one.
    SameStep,
    /// The next episode begins in the step after that, whose action is ignored.
    NextStep,
    /// The next episode begins when the caller resets.
    Disabled,
}

impl Autoreset {
    fn named(name: &str) -> PyResult<Self> {
        match name {
            "SameStep" => Ok(Autoreset::SameStep),
            "NextStep" => Ok(Autoreset::NextStep),
            "Disabled" => Ok(Autoreset::Disabled),
            _ => Err(PyValueError::new_err(format!("there is no autoreset mode '{name}'"))),
        }
    }
}

/// Environments of one configuration.
#[pyclass(frozen, module = "supple._supple")]
pub struct Environments {
    /// The environments; `None` once they are closed or a panic has broken them.
    world: Mutex<Option<VecWorld>>,
    /// Id of the process that created them; a fork of it has no threads to step them.
    process: u32,
    config: Config,
    shared: Shared,
}

struct VecWorld {
    config: Config,
    length: usize,
    /// Number of values that the critic observes in addition.
    critic_length: usize,
    environments: Vec<LocomotionEnv>,
    /// True where the episode is over and the next one has not begun.
    over: Vec<bool>,
    autoreset: Autoreset,
    /// True if first episodes are cut at random.
    stagger: bool,
    /// The seed of the first episodes, as long as all of them are at their start.
    seed: Option<u64>,
    curriculum: Curriculum,
    /// The curriculum after a reset with a seed.
    first_curriculum: Curriculum,
    advances: bool,
    /// Steps of each environment in a batch of training.
    batch_steps: usize,
    /// Steps since the start, or a reset with a seed.
    steps: usize,
    /// Episodes finished since the last batch, by environment.
    episodes: Vec<Vec<EpisodeReport>>,
    /// The worker threads besides the calling one.
    helpers: Option<ThreadPool>,
}

/// The result of a step of one environment.
struct Outcome {
    step: EnvStep,
    /// The command in the observation after the step.
    command: Command,
    /// The summary of the episode that the step ended.
    ended: Option<Ended>,
}

/// An episode that has ended, with its last observation.
struct Ended {
    report: EpisodeReport,
    /// The last observation of the episode, normalised.
    observation: Vec<f32>,
    /// The quantities that the critic observes in addition.
    critic: Vec<f32>,
    command: Command,
}

type Row<'py, T> = Bound<'py, PyArray1<T>>;
type Table<'py, T> = Bound<'py, PyArray2<T>>;
/// Finished episodes: environment indices, last observations, what the critic observes in addition, commands, returns, lengths [steps], pushed or not, messages of
/// physics faults by environment index.
type Ends<'py> = (
    Row<'py, i64>,
    Table<'py, f32>,
    Option<Table<'py, f32>>,
    Table<'py, f64>,
    Row<'py, f64>,
    Row<'py, i64>,
    Row<'py, bool>,
    Vec<(usize, String)>,
);
/// Observations, what the critic observes in addition, commands.
type Begun<'py> = (Table<'py, f32>, Option<Table<'py, f32>>, Table<'py, f64>);
/// Observations, what the critic observes in addition, rewards, terminations, truncations, reward terms, stages, commands,
/// finished episodes.
type Stepped<'py> = (
    Table<'py, f32>,
    Option<Table<'py, f32>>,
    Row<'py, f64>,
    Row<'py, bool>,
    Row<'py, bool>,
    Table<'py, f64>,
    Row<'py, i8>,
    Table<'py, f64>,
    Option<Ends<'py>>,
);

#[pymethods]
impl Environments {
    #[new]
    fn new(
        py: Python<'_>,
        config: &str,
        num_envs: usize,
        seed: u64,
        threads: usize,
        stagger: bool,
        autoreset: &str,
    ) -> PyResult<Self> {
        let autoreset = Autoreset::named(autoreset)?;
        let threads = threads.min(num_envs);
        // The robot of a file takes seconds to read.
        let (config, shared) = apart(py, || {
            let config = Config::load(config).map_err(refused)?;
            let shared = Shared::new(&config).map_err(refused)?;
            Ok((config, shared))
        })?;
        let first_curriculum = Curriculum::new(&config.command);
        if num_envs > MADE {
            check_memory(py, &config, &shared, num_envs)?;
        }
        let world = apart(py, || {
            let environment = |index| {
                if index % MADE == 0 {
                    Python::attach(|py| py.check_signals())?;
                }
                let mut environment =
                    LocomotionEnv::with_shared(&config, &shared, seed, index as u64, first_curriculum)
                        .map_err(failed)?;
                if !stagger {
                    environment.without_stagger();
                }
                Ok(environment)
            };
            Ok(VecWorld {
                length: shared.layout.length(),
                critic_length: shared.critic.as_ref().map_or(0, |critic| critic.length()),
                environments: (0..num_envs).map(environment).collect::<PyResult<_>>()?,
                over: vec![false; num_envs],
                autoreset,
                stagger,
                seed: Some(seed),
                curriculum: first_curriculum,
                first_curriculum,
                advances: true,
                batch_steps: config.ppo.batch_size.div_ceil(num_envs),
                steps: 0,
                episodes: vec![Vec::new(); num_envs],
                helpers: helpers(threads).map_err(failed)?,
                config: config.clone(),
            })
        })?;
        Ok(Environments { world: Mutex::new(Some(world)), process: std::process::id(), config, shared })
    }

    /// Starts episodes: with a seed for each environment the first ones of that seed, else the next ones; with a mask only where
    /// it is true.
    ///
    /// Returns normalised observations, float32 (n, length), what the critic observes in addition, and commands, float64 (n, 3):
    /// forward, left [m/s], yaw rate [rad/s].
    fn reset<'py>(&self, py: Python<'py>, seeds: Option<Vec<u64>>, mask: Option<Vec<bool>>) -> PyResult<Begun<'py>> {
        let (observations, critic, commands) =
            self.with(py, |world| world.reset(seeds.as_deref(), mask.as_deref()).map_err(failed))?;
        let observations = table(py, observations, self.shared.layout.length())?;
        Ok((observations, self.critic_table(py, critic)?, table(py, commands, 3)?))
    }

    /// Steps every environment once with actions, float32 (n, 12).
    ///
    /// A fall is a termination; a time limit is a truncation, and so is a physics fault, whose message is the last item of the
    /// finished episodes.
    fn step<'py>(&self, py: Python<'py>, actions: PyReadonlyArray2<'py, f32>) -> PyResult<Stepped<'py>> {
        // Without the lock, another thread of Python could write into the array: the actions, which are small, are copied.
        let actions = actions.as_slice()?.to_vec();
        let (observations, critic, outcomes) = self.with(py, move |world| {
            assert_eq!(actions.len(), world.environments.len() * JOINTS, "numbers in the actions");
            let over = world.over.iter().position(|over| *over);
            if let (Some(index), Autoreset::Disabled) = (over, world.autoreset) {
                return Err(PyRuntimeError::new_err(format!(
                    "the episode of environment {index} is over: call reset() before the next step"
                )));
            }
            world.step(&actions).map_err(failed)
        })?;
        let row = |of: fn(&Outcome) -> bool| outcomes.iter().map(of).collect::<Vec<_>>().into_pyarray(py);
        let terms = outcomes.iter().flat_map(|outcome| outcome.step.terms.fields().map(|(_, value)| value));
        let stages = outcomes.iter().map(|outcome| outcome.step.stage as i8);
        let commands = outcomes.iter().flat_map(|outcome| numbers(&outcome.command));
        Ok((
            table(py, observations, self.shared.layout.length())?,
            self.critic_table(py, critic)?,
            outcomes.iter().map(|outcome| outcome.step.reward).collect::<Vec<_>>().into_pyarray(py),
            row(|outcome| outcome.step.end == Some(EpisodeEnd::Fall)),
            row(|outcome| matches!(outcome.step.end, Some(EpisodeEnd::TimeLimit | EpisodeEnd::Fault))),
            table(py, terms.collect(), TERMS.len())?,
            stages.collect::<Vec<_>>().into_pyarray(py),
            table(py, commands.collect(), 3)?,
            self.ends(py, &outcomes)?,
        ))
    }

    /// Frees the environments once the step of another thread is done. In a fork of the process it does nothing.
    fn close(&self, py: Python<'_>) {
        if std::process::id() == self.process {
            py.detach(|| {
                let world = self.world.lock().unwrap_or_else(PoisonError::into_inner).take();
                // Freeing takes a while; the lock is released first.
                drop(world);
            });
        }
    }

    /// Returns the open fraction of the command range, true if there are pushes, and the open fraction of pulls.
    fn curriculum(&self, py: Python<'_>) -> PyResult<(f64, bool, f64)> {
        self.with(py, |world| {
            let Curriculum { command_fraction, pushes, force_fraction } = world.curriculum;
            Ok((command_fraction, pushes, force_fraction))
        })
    }

    /// Sets the curriculum of episodes that start from now on.
    fn set_curriculum(&self, py: Python<'_>, curriculum: (f64, bool, f64)) -> PyResult<()> {
        let curriculum = checked(curriculum)?;
        self.with(py, |world| {
            (world.curriculum, world.first_curriculum, world.advances) = (curriculum, curriculum, false);
            Ok(())
        })
    }

    /// Returns the name and the unit of every number of an observation, before it is scaled.
    fn observation_names(&self) -> Vec<String> {
        self.shared.layout.names()
    }

    /// Returns the name and the unit of every number that the critic observes in addition, before it is scaled.
    fn critic_observation_names(&self) -> Vec<String> {
        self.shared.critic.as_ref().map_or_else(Vec::new, |critic| critic.names())
    }

    /// Returns offset, scale and limit of every number of an observation: (value − offset) · scale, clipped to ± limit.
    fn observation_scaling<'py>(&self, py: Python<'py>) -> (Row<'py, f64>, Row<'py, f64>, Row<'py, f64>) {
        let row = |values: &[f64]| values.to_vec().into_pyarray(py);
        let layout = &self.shared.layout;
        (row(layout.offset()), row(layout.scale()), row(layout.clip()))
    }

    /// Returns the names of the joints in the order of actions.
    #[staticmethod]
    fn action_names() -> Vec<String> {
        joint_names().to_vec()
    }

    /// Returns offset and scale of each joint: joint target \[rad\] = offset + scale · action.
    fn action_scaling<'py>(&self, py: Python<'py>) -> (Row<'py, f64>, Row<'py, f64>) {
        let action = &self.config.action;
        let offset = action.nominal_pose_rad.joints().to_vec();
        (offset.into_pyarray(py), vec![action.scale_rad; JOINTS].into_pyarray(py))
    }

    /// Returns the smallest and the largest action of each joint: beyond them, the motor of a joint at rest within its range is
    /// at its torque limit.
    fn action_bounds<'py>(&self, py: Python<'py>) -> (Row<'py, f32>, Row<'py, f32>) {
        let (action, simulation) = (&self.config.action, &self.config.simulation);
        let nominal = action.nominal_pose_rad.joints();
        let bound = |side: usize, sign: f64| -> Vec<f32> {
            let of = |joint: usize| {
                let beyond = sign * self.shared.robot.torque_limits[joint] / simulation.kp_n_m_per_rad.joints()[joint];
                // A joint without limits may turn once about its nominal angle.
                let limit = Some(self.shared.robot.joint_limits[joint][side]).filter(|limit| limit.is_finite());
                let limit = limit.unwrap_or_else(|| nominal[joint] + sign * std::f64::consts::TAU);
                ((limit + beyond - nominal[joint]) / action.scale_rad) as f32
            };
            (0..JOINTS).map(of).collect()
        };
        (bound(0, -1.0).into_pyarray(py), bound(1, 1.0).into_pyarray(py))
    }

    /// Returns the names of the reward terms.
    #[staticmethod]
    fn term_names() -> Vec<&'static str> {
        TERMS.iter().map(|term| term.name).collect()
    }

    /// Returns the rate of policy steps \[Hz\].
    fn rate_hz(&self) -> u32 {
        self.config.simulation.policy_rate_hz
    }
}

impl Environments {
    /// Turns what the critics observe in addition into an array; `None` if they observe what the policies do.
    fn critic_table<'py>(&self, py: Python<'py>, values: Vec<f32>) -> PyResult<Option<Table<'py, f32>>> {
        self.shared.critic.as_ref().map(|critic| table(py, values, critic.length())).transpose()
    }

    /// Returns arrays about the episodes that ended, if any did.
    fn ends<'py>(&self, py: Python<'py>, outcomes: &[Outcome]) -> PyResult<Option<Ends<'py>>> {
        let all = outcomes.iter().enumerate();
        let ended: Vec<(usize, &Ended)> =
            all.filter_map(|(index, outcome)| Some((index, outcome.ended.as_ref()?))).collect();
        if ended.is_empty() {
            return Ok(None);
        }
        let fault = |ended: &Ended| ended.report.fault.as_ref().map(|fault| fault.error.to_string());
        let each = || ended.iter().map(|(_, ended)| *ended);
        let length = self.shared.layout.length();
        Ok(Some((
            ended.iter().map(|(index, _)| *index as i64).collect::<Vec<_>>().into_pyarray(py),
            table(py, each().flat_map(|ended| ended.observation.iter().copied()).collect(), length)?,
            self.critic_table(py, each().flat_map(|ended| ended.critic.iter().copied()).collect())?,
            table(py, each().flat_map(|ended| numbers(&ended.command)).collect(), 3)?,
            each().map(|ended| ended.report.reward).collect::<Vec<_>>().into_pyarray(py),
            each().map(|ended| ended.report.steps as i64).collect::<Vec<_>>().into_pyarray(py),
            each().map(|ended| ended.report.pushed).collect::<Vec<_>>().into_pyarray(py),
            ended.iter().filter_map(|(index, ended)| Some((*index, fault(ended)?))).collect(),
        )))
    }

    /// Runs `work` on the environments without the interpreter's lock.
    fn with<T: Send>(&self, py: Python<'_>, work: impl FnOnce(&mut VecWorld) -> PyResult<T> + Send) -> PyResult<T> {
        if std::process::id() != self.process {
            let problem =
                "these environments belong to the process that this one was forked from, and so do their threads";
            return Err(PyRuntimeError::new_err(format!("{problem}: call supple.make_vec after the fork")));
        }
        let mut slot = match self.world.try_lock() {
            Ok(slot) => slot,
            Err(TryLockError::Poisoned(slot)) => slot.into_inner(),
            Err(TryLockError::WouldBlock) => {
                let problem = "another thread is using these environments: give each thread its own";
                return Err(PyRuntimeError::new_err(problem));
            }
        };
        let Some(mut world) = slot.take() else {
            return Err(PyRuntimeError::new_err("these environments are closed: make new ones"));
        };
        // After a panic the environments are not put back.
        let (world, result) = apart(py, move || {
            let result = work(&mut world);
            Ok((world, result))
        })?;
        *slot = Some(world);
        result
    }
}

/// Returns the number of cores that this process may use: those that it is bound to, fewer under a quota of a control group.
#[pyfunction]
pub fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

/// Checks that the machine has enough memory for environments, and warns if it may have too little.
fn check_memory(py: Python<'_>, config: &Config, shared: &Shared, num_envs: usize) -> PyResult<()> {
    let total = apart(py, || environments_bytes(config, shared, num_envs as u64).map_err(failed))?;
    let problem = |left: u64| {
        let (each, total, left) = (total / num_envs as u64 / 1024, gibibytes(total), gibibytes(left));
        format!(
            "num_envs is {num_envs}: the environments take {total} of memory ({each} KiB each), and the machine has {left} left: \
             lower num_envs"
        )
    };
    match FreeMemory::now() {
        Some(free) if total > free.at_most => Err(PyValueError::new_err(problem(free.at_most))),
        Some(free) if total > free.surely => {
            let words = std::ffi::CString::new(problem(free.surely)).unwrap_or_default();
            PyErr::warn(py, &py.get_type::<PyUserWarning>(), &words, 2)
        }
        _ => Ok(()),
    }
}

impl VecWorld {
    fn reset(
        &mut self,
        seeds: Option<&[u64]>,
        mask: Option<&[bool]>,
    ) -> mujoco::Result<(Vec<f32>, Vec<f32>, Vec<f64>)> {
        if seeds.is_some() {
            (self.curriculum, self.steps) = (self.first_curriculum, 0);
            self.episodes.iter_mut().for_each(Vec::clear);
        }
        let seeds: Vec<Option<u64>> = match seeds {
            Some(seeds) => seeds.iter().copied().map(Some).collect(),
            None => vec![self.seed; self.environments.len()],
        };
        let (curriculum, stagger, length) = (self.curriculum, self.stagger, self.length);
        let mut observations = vec![0.0; self.environments.len() * length];
        let mut done: Vec<mujoco::Result<()>> = vec![Ok(()); self.environments.len()];
        let chosen: Vec<bool> = mask.map_or_else(|| vec![true; self.environments.len()], <[bool]>::to_vec);
        let each =
            self.environments.iter_mut().zip(&chosen).zip(&seeds).zip(observations.chunks_mut(length)).zip(&mut done);
        share(self.helpers.as_ref(), each, |((((environment, chosen), seed), seen), done)| {
            if *chosen {
                *done = begin(environment, *seed, curriculum, stagger);
            }
            environment.normalised_observation(seen);
        });
        done.into_iter().collect::<mujoco::Result<()>>()?;
        self.seed = None;
        self.over.iter_mut().zip(chosen).for_each(|(over, chosen)| *over &= !chosen);
        let commands = self.environments.iter().flat_map(|environment| numbers(environment.command())).collect();
        Ok((observations, self.critic_additions(), commands))
    }

    /// Returns what the critic observes in addition, shape (n, its length).
    fn critic_additions(&self) -> Vec<f32> {
        let mut values = vec![0.0; self.environments.len() * self.critic_length];
        if self.critic_length > 0 {
            let each = self.environments.iter().zip(values.chunks_mut(self.critic_length));
            each.for_each(|(environment, out)| environment.critic_addition(out));
        }
        values
    }

    fn step(&mut self, actions: &[f32]) -> mujoco::Result<(Vec<f32>, Vec<f32>, Vec<Outcome>)> {
        let (count, length) = (self.environments.len(), self.length);
        let (curriculum, autoreset) = (self.curriculum, self.autoreset);
        let mut observations = vec![0.0; count * length];
        let mut outcomes: Vec<Option<mujoco::Result<Outcome>>> = (0..count).map(|_| None).collect();
        let each = self
            .environments
            .iter_mut()
            .zip(&mut self.over)
            .zip(actions.chunks(JOINTS))
            .zip(observations.chunks_mut(length))
            .zip(&mut outcomes);
        share(self.helpers.as_ref(), each, |((((environment, over), action), seen), outcome)| {
            *outcome = Some(if *over {
                pause(environment, curriculum, seen)
            } else {
                step(environment, action, (autoreset == Autoreset::SameStep).then_some(curriculum), seen)
            });
            let ended = matches!(outcome, Some(Ok(Outcome { ended: Some(_), .. })));
            *over = ended && autoreset != Autoreset::SameStep;
        });
        let outcomes = outcomes.into_iter().flatten().collect::<mujoco::Result<Vec<Outcome>>>()?;
        self.seed = None;
        if self.advances {
            for (episodes, outcome) in self.episodes.iter_mut().zip(&outcomes) {
                episodes.extend(outcome.ended.as_ref().map(|ended| ended.report.clone()));
            }
            self.advance();
        }
        Ok((observations, self.critic_additions(), outcomes))
    }

    /// Counts a step, and advances the curriculum after every batch as training does.
    fn advance(&mut self) {
        self.steps += 1;
        if self.steps.is_multiple_of(self.batch_steps) {
            let samples = (self.steps - self.batch_steps) * self.over.len();
            let episodes: Vec<EpisodeReport> = self.episodes.iter_mut().flat_map(std::mem::take).collect();
            EpisodeMeans::new(&episodes).advance(&mut self.curriculum, samples as u64, &self.config);
        }
    }
}

/// Starts the next episode of an environment, or with a seed the first one of that seed.
fn begin(
    environment: &mut LocomotionEnv,
    seed: Option<u64>,
    curriculum: Curriculum,
    stagger: bool,
) -> mujoco::Result<()> {
    let Some(seed) = seed else { return environment.reset(curriculum) };
    environment.restart(seed, curriculum)?;
    if !stagger {
        environment.without_stagger();
    }
    Ok(())
}

/// Steps an environment; if the episode ends and `next` is given, starts the next episode with that curriculum.
fn step(
    environment: &mut LocomotionEnv,
    action: &[f32],
    next: Option<Curriculum>,
    seen: &mut [f32],
) -> mujoco::Result<Outcome> {
    let (step, report) = environment.step(action);
    environment.normalised_observation(seen);
    let ended = report.map(|report| {
        let mut critic = vec![0.0; environment.critic_layout().map_or(0, Layout::length)];
        environment.critic_addition(&mut critic);
        Ended { report, observation: seen.to_vec(), critic, command: *environment.command() }
    });
    if let (Some(curriculum), Some(_)) = (next, &ended) {
        environment.reset(curriculum)?;
        environment.normalised_observation(seen);
    }
    Ok(Outcome { step, command: *environment.command(), ended })
}

/// Starts the next episode of an environment in place of a step.
fn pause(environment: &mut LocomotionEnv, curriculum: Curriculum, seen: &mut [f32]) -> mujoco::Result<Outcome> {
    environment.reset(curriculum)?;
    environment.normalised_observation(seen);
    let step = EnvStep { reward: 0.0, end: None, stage: Stage::Walking, terms: Terms::default() };
    Ok(Outcome { step, command: *environment.command(), ended: None })
}

/// Distributes work over the calling thread and its helpers. Each starts with its own stretch of the items, whose data are still
/// in the cache of its core, and then takes items from the stretches of the others.
fn share<T: Send>(helpers: Option<&ThreadPool>, all: impl Iterator<Item = T>, work: impl Fn(T) + Sync) {
    let Some(pool) = helpers else { return all.for_each(work) };
    let (mut all, threads) = (all.collect::<Vec<T>>(), pool.current_num_threads() + 1);
    let mut stretches = Vec::with_capacity(threads);
    for k in (0..threads).rev() {
        stretches.push(Mutex::new(all.split_off(k * all.len() / (k + 1))));
    }
    let worker = |own: usize| {
        for k in 0..threads {
            let stretch = &stretches[(own + k) % threads];
            loop {
                let next = stretch.lock().unwrap_or_else(PoisonError::into_inner).pop();
                let Some(one) = next else { break };
                work(one);
            }
        }
    };
    pool.in_place_scope(|scope| {
        scope.spawn_broadcast(|_, thread| worker(thread.index()));
        worker(threads - 1);
    });
}

/// Creates `threads - 1` helper threads; the calling thread works too.
fn helpers(threads: usize) -> Result<Option<ThreadPool>, rayon::ThreadPoolBuildError> {
    let pool = |threads| ThreadPoolBuilder::new().num_threads(threads).thread_name(|k| format!("supple-{k}")).build();
    (threads > 1).then(|| pool(threads - 1)).transpose()
}

fn checked((command_fraction, pushes, force_fraction): (f64, bool, f64)) -> PyResult<Curriculum> {
    for (name, fraction) in [("command_fraction", command_fraction), ("force_fraction", force_fraction)] {
        if !(0.0..=1.0).contains(&fraction) {
            return Err(PyValueError::new_err(format!("{name} is {fraction}, expected 0 to 1")));
        }
    }
    Ok(Curriculum { command_fraction, pushes, force_fraction })
}

fn numbers(command: &Command) -> [f64; 3] {
    [command.forward, command.left, command.yaw]
}

/// Turns values into an array of rows of `width` numbers, without a copy.
fn table<T: numpy::Element>(py: Python<'_>, values: Vec<T>, width: usize) -> PyResult<Table<'_, T>> {
    let rows = values.len() / width;
    values.into_pyarray(py).reshape([rows, width])
}
