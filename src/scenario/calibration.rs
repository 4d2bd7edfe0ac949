/*! Calibration: measures the compliance of a policy by pulls in all directions, and its bias by undisturbed walks.

While it walks at 0.5 m/s on a plane, the robot is pulled in twelve directions with up to 20 N, one after the other. Its
compliance is the mean velocity along the pull, minus that without the pull, divided by the force.
*/

use nalgebra::{SMatrix, SVector};

use super::Playback;
use super::catalog::{Leash, Scenario, ScriptError, Task, defaults};
use super::metrics;
use crate::config::ConfigError;
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

/// Settings of the outer loop, relative to the policy's own compliance. Below, the loop would work against its own
/// delay; above, a small bias would make the robot drift away.
const SETTINGS: [f64; 9] = [0.5, 0.75, 1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0];

/// Walks from which the bias is fitted: forward [m/s], left [m/s], yaw rate [rad/s].
const WALKS: [[f64; 3]; 11] = [
    [0.0, 0.0, 0.0],
    [0.5, 0.0, 0.0],
    [-0.5, 0.0, 0.0],
    [0.8, 0.0, 0.0],
    [-0.8, 0.0, 0.0],
    [0.0, 0.3, 0.0],
    [0.0, -0.3, 0.0],
    [0.0, 0.0, 0.4],
    [0.0, 0.0, -0.4],
    [0.5, 0.2, 0.0],
    [0.5, -0.2, 0.0],
];

/// Error while calibrating a policy.
#[derive(Debug, thiserror::Error)]
pub enum CalibrationError {
    /// The script of a walk is invalid.
    #[error(transparent)]
    Script(#[from] ScriptError),
    /// The scenario's default parameters are invalid.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// MuJoCo fails during a walk.
    #[error(transparent)]
    Physics(#[from] mujoco::Error),
    /// The robot falls without a pull, or under the weakest pull.
    #[error("it falls {0}: there is no compliance to measure")]
    Falls(&'static str),
    /// The measured compliance does not increase with the setting.
    #[error(
        "it yields by {0:.4?} m/s/N, alone and at rising settings: it does not follow its command well enough to be led"
    )]
    NotRising(Vec<f64>),
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
/// The robot falls, its compliance does not increase with the setting, or it cannot be simulated.
pub fn calibrate(agent: &mut Agent, threads: usize) -> Result<PolicyCalibration, CalibrationError> {
    let mut calibration = PolicyCalibration::unmeasured(&agent.sha256);
    let walks: Vec<Probe> =
        WALKS.iter().map(|[forward, left, yaw]| Probe::walk(Command::velocity(*forward, *left, *yaw))).collect();
    agent.calibration = None;
    let undisturbed = offsets(agent, &walks, threads)?;
    if undisturbed[1].is_none() {
        return Err(CalibrationError::Falls("undisturbed at 0.5 m/s"));
    }
    calibration.bias = bias(&walks, &undisturbed);
    let own = yielding(agent, 0.0, threads)?.ok_or(CalibrationError::Falls("when pulled with 10 or 20 N"))?;
    if own.is_nan() || own <= 0.0 {
        return Err(CalibrationError::NotRising(vec![own]));
    }
    calibration.own_m_s_per_n = own;
    agent.calibration = Some(calibration.clone());
    let mut points = Vec::new();
    for setting in SETTINGS.map(|part| part * own) {
        // A pull that brings it down ends the range.
        let Some(measured) = yielding(agent, setting, threads)? else { break };
        points.push(Point { setting, measured });
    }
    let rising = points.windows(2).all(|pair| pair[1].measured > pair[0].measured);
    if points.len() < 2 || !rising {
        return Err(CalibrationError::NotRising(points.iter().map(|point| point.measured).collect()));
    }
    Ok(PolicyCalibration { points, ..calibration })
}

/// Measures the mean compliance over all directions at a setting [m/s/N]; `None` if the robot fell.
fn yielding(agent: &Agent, setting: f64, threads: usize) -> Result<Option<f64>, CalibrationError> {
    let command = Command { compliance: Some(setting), ..Command::velocity(0.5, 0.0, 0.0) };
    let side = |index: u32| 360.0 * f64::from(index) / f64::from(DIRECTIONS);
    let weaker = (LED_M_S / (setting.max(1e-9) * FORCES_N[1])).min(1.0);
    let pulls = FORCES_N.iter().flat_map(|force_n| {
        (0..DIRECTIONS).map(move |index| Probe { command, force_n: weaker * force_n, direction_deg: side(index) })
    });
    let probes: Vec<Probe> = std::iter::once(Probe::walk(command)).chain(pulls).collect();
    let found: Option<Vec<[f64; 2]>> = offsets(agent, &probes, threads)?.into_iter().collect();
    Ok(found.map(|found| {
        let undisturbed = found[0];
        let along = |(probe, offset): (&Probe, &[f64; 2])| {
            let (left, forward) = probe.direction_deg.to_radians().sin_cos();
            ((offset[0] - undisturbed[0]) * forward + (offset[1] - undisturbed[1]) * left) / probe.force_n
        };
        probes.iter().zip(&found).skip(1).map(along).sum::<f64>() / (found.len() - 1) as f64
    }))
}

/// Measures the mean velocity minus the commanded one at the end of each probe, forward and left, in the heading at the
/// start [m/s]; `None` where the robot fell.
fn offsets(agent: &Agent, probes: &[Probe], threads: usize) -> Result<Vec<Option<[f64; 2]>>, CalibrationError> {
    let base: Leash = defaults("leash")?;
    let offset = &|probe: &Probe| -> Result<Option<[f64; 2]>, CalibrationError> {
        let Command { forward, left, yaw, compliance, .. } = probe.command;
        let duration_s = AT_S + FOR_S;
        let task =
            Task { forward_m_s: forward, left_m_s: left, yaw_rad_s: yaw, compliance, duration_s, ..base.task.clone() };
        let (force_n, direction_deg) = (probe.force_n, probe.direction_deg);
        let scenario = Scenario::Leash(Leash { task, force_n, direction_deg, at_s: AT_S, for_s: FOR_S });
        let script = scenario.script(0, &agent.config)?;
        let trace = Playback::new(&script, &agent.config, agent.controller())?.trace();
        let along =
            |direction: [f64; 2]| metrics::offset_along_force(&trace, direction, duration_s - MEAN_S, duration_s);
        // Turning, the world's directions are none of the robot's.
        let errors = || metrics::velocity_errors(&trace, duration_s - MEAN_S, duration_s).map(|[f, l, _]| [f, l]);
        let upright = trace.fall().is_none() && trace.fault().is_none();
        Ok(if !upright {
            None
        } else if yaw == 0.0 {
            along([1.0, 0.0]).zip(along([0.0, 1.0])).map(Into::into)
        } else {
            errors()
        })
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

/// Fits the bias by least squares over the walks without a fall.
fn bias(walks: &[Probe], undisturbed: &[Option<[f64; 2]>]) -> [[f64; 4]; 2] {
    let (mut normal, mut right) = (SMatrix::<f64, 4, 4>::identity() * 1e-6, [SVector::<f64, 4>::zeros(); 2]);
    for (walk, offset) in walks.iter().zip(undisturbed) {
        let Some(offset) = offset else { continue };
        let row = SVector::from([1.0, walk.command.forward, walk.command.left, walk.command.yaw]);
        normal += row * row.transpose();
        right.iter_mut().zip(offset).for_each(|(right, offset)| *right += row * *offset);
    }
    right.map(|right| normal.cholesky().map_or(right * 0.0, |factors| factors.solve(&right)).into())
}
