/*! Calibration: measures the compliance of a policy by pulls in all directions, without and with a commanded compliance.

While it stands and while it walks at 0.5 m/s on a plane, the robot is pulled in twelve directions with up to 20 N, one after the
other. Its compliance on an axis is the slope of the velocity, minus that without the pull, over the force on that axis.
*/

use super::Playback;
use super::catalog::{Leash, Scenario, ScriptError, Task, with_parameters};
use super::metrics;
use crate::mujoco;
use crate::observation::Command;
use crate::policy::Agent;
use crate::policy::compliance::{Point, PolicyCalibration};

/// Number of directions of the pulls.
const DIRECTIONS: u32 = 12;

/// Forces of the pulls \[N\].
const FORCES_N: [f64; 2] = [10.0, 20.0];

/// Largest velocity to which a pull may carry the robot [m/s]; stronger pulls are reduced.
const LED_M_S: f64 = 0.4;

/// Time at which the pull begins, its duration, and the length of the mean at its end \[s\]. The most compliant robot
/// takes 2 s to follow.
const AT_S: f64 = 2.0;
const FOR_S: f64 = 6.0;
const MEAN_S: f64 = 3.0;

/// Compliances that are tried [m/s/N]. Policies cannot be stiffer than the smallest; beyond the largest, a robot drifts away under small
/// errors of the felt force.
const TRIED: [f64; 7] = [0.005, 0.01, 0.02, 0.03, 0.04, 0.05, 0.06];

/// Commanded compliance for the measurement of how well the policy tracks a change of its command [m/s/N].
const SOFT: f64 = 0.04;

/// Smallest difference of a policy's own compliance from that one that counts [m/s/N].
const LEAST_CHANGE: f64 = 0.002;

/// Largest error of a measured compliance, as a fraction of the commanded one, up to which it can be commanded.
const TOLERANCE: f64 = 0.25;

/// Velocities at which the robot is pulled, forward [m/s].
const WALKS_M_S: [f64; 2] = [0.0, 0.5];

/// Error while calibrating a policy.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// The script of a walk is invalid.
    #[error(transparent)]
    Script(#[from] ScriptError),
    /// MuJoCo fails during a walk.
    #[error(transparent)]
    Physics(#[from] mujoco::Error),
    /// The robot falls, at one of the settings that each measurement needs.
    #[error("it falls {0}, so its compliance cannot be measured")]
    Falls(&'static str),
    /// The policy, the physics or the sensors fail in a walk without commanded compliance.
    #[error("it stops after {time_s:.2} s of a walk, before any compliance is commanded: {problem}")]
    Fault {
        /// Time of the fault \[s\].
        time_s: f64,
        /// The failure.
        problem: String,
    },
    /// At most one of the commanded compliances can be measured: under the others the robot falls, or yields otherwise.
    #[error(
        "its own compliance is {0:.4?} m/s/N forward and left, and it reaches fewer than two of the commanded \
         compliances {TRIED:?} m/s/N within 25 %: it falls, or does not track a velocity"
    )]
    Range([f64; 2]),
}

/// A walk with or without a pull.
#[derive(Debug, Clone, Copy)]
struct Probe {
    command: Command,
    force_n: f64,
    direction_deg: f64,
}

impl Probe {
    fn walk(command: Command) -> Self {
        Probe { command, force_n: 0.0, direction_deg: 0.0 }
    }
}

/// Calibrates a policy on its robot, using `threads` threads.
///
/// # Errors
/// The robot falls, does not yield as commanded, or cannot be simulated, or the policy fails.
pub fn calibrate(agent: &mut Agent, threads: usize) -> Result<PolicyCalibration, CalibrationError> {
    agent.calibration = None;
    let own = compliance(agent, None, threads)?
        .ok_or(CalibrationError::Falls("without a pull, or pulled with 10 or 20 N"))?;
    let mass_kg = agent.config.robot.load().map_err(ScriptError::from)?.mass_kg;
    let (sha256, points) = (agent.sha256.clone(), Vec::new());
    let mut calibration = PolicyCalibration { sha256, mass_kg, own_m_s_per_n: own, tracking: [1.0; 2], points };
    agent.calibration = Some(calibration.clone());
    // The compliance that is missing at a soft setting is the part of the command that the policy does not track.
    let soft =
        compliance(agent, Some(SOFT), threads)?.ok_or(CalibrationError::Falls("or fails, commanded 0.04 m/s/N"))?;
    calibration.tracking = std::array::from_fn(|axis| {
        let change = SOFT - own[axis];
        // A change that is small against the error of its measurement says nothing.
        if change.abs() < LEAST_CHANGE { 1.0 } else { ((soft[axis] - own[axis]) / change).clamp(0.5, 1.5) }
    });
    agent.calibration = Some(calibration.clone());
    for commanded in TRIED {
        // A compliance at which pulls make it fall, or that it does not reach, is left out of the range.
        let is_given = |measured: &f64| (measured / commanded - 1.0).abs() <= TOLERANCE;
        match compliance(agent, Some(commanded), threads)? {
            Some(measured) if measured.iter().all(is_given) => calibration.points.push(Point { commanded, measured }),
            _ if calibration.points.is_empty() => {}
            _ => break,
        }
    }
    if calibration.points.len() < 2 { Err(CalibrationError::Range(own)) } else { Ok(calibration) }
}

/// Measures the compliance forward and left, mean over standing and walking [m/s/N]; `None` if the robot fell.
fn compliance(agent: &Agent, commanded: Option<f64>, threads: usize) -> Result<Option<[f64; 2]>, CalibrationError> {
    let side = |index: u32| 360.0 * f64::from(index) / f64::from(DIRECTIONS);
    let weaker = commanded.map_or(1.0, |commanded| (LED_M_S / (commanded * FORCES_N[1])).min(1.0));
    let mut sum = [0.0; 2];
    for forward in WALKS_M_S {
        let command = Command { compliance: commanded, ..Command::velocity(forward, 0.0, 0.0) };
        let pulls = FORCES_N.iter().flat_map(|force_n| {
            (0..DIRECTIONS).map(move |index| Probe { command, force_n: weaker * force_n, direction_deg: side(index) })
        });
        let probes: Vec<Probe> = std::iter::once(Probe::walk(command)).chain(pulls).collect();
        let found: Option<Vec<[f64; 2]>> = offsets(agent, &probes, threads)?.into_iter().collect();
        let Some(found) = found else { return Ok(None) };
        let pulled = || probes.iter().zip(&found).skip(1);
        for (axis, sum) in sum.iter_mut().enumerate() {
            let force = |probe: &Probe| {
                let (left, forward) = probe.direction_deg.to_radians().sin_cos();
                probe.force_n * [forward, left][axis]
            };
            let work: f64 = pulled().map(|(probe, offset)| force(probe) * (offset[axis] - found[0][axis])).sum();
            let squares: f64 = pulled().map(|(probe, _)| force(probe).powi(2)).sum();
            *sum += work / squares / WALKS_M_S.len() as f64;
        }
    }
    Ok(Some(sum))
}

/// Measures the mean velocity minus the commanded one at the end of each probe, forward and left, in the heading at the
/// start [m/s]; `None` where the robot fell.
fn offsets(agent: &Agent, probes: &[Probe], threads: usize) -> Result<Vec<Option<[f64; 2]>>, CalibrationError> {
    let base: Leash = with_parameters("leash", "{}").map_err(ScriptError::from)?;
    let offset = &|probe: &Probe| -> Result<Option<[f64; 2]>, CalibrationError> {
        let Command { forward, left, yaw, compliance, .. } = probe.command;
        let duration_s = AT_S + FOR_S;
        let task =
            Task { forward_m_s: forward, left_m_s: left, yaw_rad_s: yaw, compliance, duration_s, ..base.task.clone() };
        let (force_n, direction_deg) = (probe.force_n, probe.direction_deg);
        let scenario =
            Scenario::Leash(Leash { task, force_n, direction_deg, at_s: AT_S, for_s: FOR_S, set_point_per_s: 0.0 });
        let script = scenario.script(0, &agent.config)?;
        let trace = Playback::new(&script, &agent.config, agent.controller())?.trace();
        let along =
            |direction: [f64; 2]| metrics::offset_along_force(&trace, direction, duration_s - MEAN_S, duration_s);
        if let (None, Some(fault)) = (compliance, trace.fault()) {
            return Err(CalibrationError::Fault { time_s: fault.time_s, problem: fault.text.clone() });
        }
        let upright = trace.fall().is_none() && trace.fault().is_none();
        Ok(if upright { along([1.0, 0.0]).zip(along([0.0, 1.0])).map(Into::into) } else { None })
    };
    let mut found: Vec<Result<Option<[f64; 2]>, CalibrationError>> = probes.iter().map(|_| Ok(None)).collect();
    let chunk = probes.len().div_ceil(threads.max(1)).max(1);
    std::thread::scope(|scope| {
        for (probes, found) in probes.chunks(chunk).zip(found.chunks_mut(chunk)) {
            scope.spawn(move || found.iter_mut().zip(probes).for_each(|(found, probe)| *found = offset(probe)));
        }
    });
    found.into_iter().collect()
}
