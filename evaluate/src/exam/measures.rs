//! The numbers of an examination: means over trials of what papers on compliant legs measure. docs/benchmark.md defines them.

use serde::Serialize;

use crate::results::Results;
use crate::statistics::mean;
use supple::scenario::catalog::Scenario;

/// A measure: the mean over conditions of the mean over trials of an experiment's quantity.
#[derive(Debug, Clone, Copy)]
pub struct Measure {
    /// The name, for people and as a key.
    pub name: &'static str,
    /// The unit.
    pub unit: &'static str,
    /// The experiment's name.
    pub experiment: &'static str,
    quantity: &'static str,
    /// Returns the number of a trial from its scenario and quantity; none if the condition does not count.
    of: fn(&Scenario, f64) -> Option<f64>,
}

/// The numbers of all policies in one measure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Measured {
    /// The measure's name.
    pub measure: &'static str,
    /// The unit.
    pub unit: &'static str,
    /// The means by policy, the examined one first; none where no trial has a number.
    pub means: Vec<Option<f64>>,
}

const fn measure(
    name: &'static str,
    unit: &'static str,
    experiment: &'static str,
    quantity: &'static str,
    of: fn(&Scenario, f64) -> Option<f64>,
) -> Measure {
    Measure { name, unit, experiment, quantity, of }
}

/// All measures in the order of the page.
pub const MEASURES: &[Measure] = &[
    measure("own compliance", "m/s/N", "leash", "offset_m_s", |scenario, offset| match scenario {
        Scenario::Leash(leash) => Some(offset / leash.force_n),
        _ => None,
    }),
    measure("compliance error", "%", "calibration", "compliance_m_s_per_n", |scenario, found| {
        let commanded = scenario.task().compliance.filter(|_| matches!(scenario, Scenario::Leash(_)))?;
        Some(100.0 * (found / commanded - 1.0).abs())
    }),
    measure("stiffness error", "%", "set-point", "stiffness_error", |_, error| Some(100.0 * error)),
    measure("return error", "m", "set-point", "return_error_m", |_, error| Some(error)),
    measure("tension of the leash", "N", "lead", "mean_tension_n", |_, tension| Some(tension)),
    measure("impulse at the wall", "N·s", "wall", "blow_n_s", |_, impulse| Some(impulse)),
    measure("impulse survived, 0.1 s", "N·s", "shove", "survived_n_s", |scenario, found| within(scenario, 0.1, found)),
    measure("impulse survived, 0.4 s", "N·s", "shove", "survived_n_s", |scenario, found| within(scenario, 0.4, found)),
    measure("time back", "s", "shove", "decay_20_s", |scenario, found| within(scenario, 0.1, found)),
    measure("peak power", "W", "shove", "peak_power_w", |scenario, found| within(scenario, 0.1, found)),
    measure("peak torque", "N·m", "shove", "peak_torque_n_m", |scenario, found| within(scenario, 0.1, found)),
    measure("power", "W", "walk", "power_w", at_half),
    measure("velocity error", "m/s", "walk", "velocity_error_m_s", at_half),
    measure("power with payload", "W", "walk", "power_w", with_payload),
    measure("velocity error with payload", "m/s", "walk", "velocity_error_m_s", with_payload),
];

/// Returns the number if shoves last `for_s` \[s\].
fn within(scenario: &Scenario, for_s: f64, found: f64) -> Option<f64> {
    matches!(scenario, Scenario::Push(push) if push.for_s == for_s).then_some(found)
}

/// Returns the number if the robot walks straight ahead at 0.5 m/s.
fn at_half(scenario: &Scenario, found: f64) -> Option<f64> {
    let task = scenario.task();
    let command = [task.forward_m_s, task.left_m_s, task.yaw_rad_s];
    (command == [0.5, 0.0, 0.0] && task.extra_mass_kg == 0.0).then_some(found)
}

/// Returns the number if the robot carries a payload.
fn with_payload(scenario: &Scenario, found: f64) -> Option<f64> {
    (scenario.task().extra_mass_kg > 0.0).then_some(found)
}

impl Measure {
    /// Returns the means of all sets in the results of the measure's experiment.
    pub(super) fn means(&self, results: &Results) -> Measured {
        let quantity = results.index(self.quantity);
        let of_set = |set: usize| {
            let policies = results.sets[set].values();
            let conditions = policies.flat_map(|policy| results.conditions.iter().zip(policy));
            mean(conditions.filter_map(|(condition, samples)| {
                let values = samples.iter().filter_map(|sample| sample.values[quantity]);
                mean(values.filter_map(|value| (self.of)(&condition.scenario, value)))
            }))
        };
        let means = (0..results.sets.len()).map(of_set).collect();
        Measured { measure: self.name, unit: self.unit, means }
    }
}
