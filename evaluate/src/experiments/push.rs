//! The measurements of a push that E2, E4, E10 and E13 share, and the condition of E2 and E3.

use super::prelude::*;
use crate::results::Results;
use supple::scenario::catalog::PushTrunk;
use supple::scenario::metrics::STRIDE_S;
use supple::scenario::trace::Trace;
use supple::world::Push;

pub(super) const TO_10: Quantity = Quantity::new("decay_10_s", "decay to 10 %", "s", 2);
pub(super) const TO_20: Quantity = Quantity::new("decay_20_s", "decay to 20 %", "s", 2);

/// The distance that the push carries the robot: the integral of the velocity that it adds.
pub(super) const CARRIED: Quantity = Quantity::new("carried_m", "carried by the push within 2 s", "m", 3);

/// The fraction of trials without a fall in which the push had not decayed to 10 % at the end; their decay time is that end.
pub(super) const UNDECAYED: Quantity = Quantity::new("undecayed", "not decayed at the end", "%", 0);

/// The measures of how long a disturbance lasts, with their words in claims. The paper names no threshold.
pub(super) const LASTING: [(&str, &str); 3] = [
    (TO_10.name, "take longer to stabilise to 10 %"),
    (TO_20.name, "take longer to stabilise to 20 %"),
    (CARRIED.name, "are carried farther within 2 s"),
];

/// The time over which the carried distance is measured \[s\].
const CARRIED_S: f64 = 2.0;

/// Returns the entries of [`LASTING`] that are meaningful at a forward command \[m/s\]. Standing robots step from foot to foot,
/// some slowly, and these steps decide the decay time to 10 % of a push.
pub(super) fn lasting(command_m_s: f64) -> impl Iterator<Item = (&'static str, &'static str)> {
    LASTING.into_iter().skip(usize::from(command_m_s == 0.0))
}

/// Returns [`TO_10`], [`TO_20`], [`CARRIED`] and [`UNDECAYED`] of a push in the heading frame (forward, left) \[m/s\].
pub(super) fn decay(trace: &Trace, time_s: f64, push: [f64; 2]) -> [Option<f64>; 4] {
    let [to_10, to_20] = [0.1, 0.2].map(|to| metrics::decay(trace, time_s, push, to, STRIDE_S));
    let carried = metrics::carried(trace, time_s, push, CARRIED_S);
    let undecayed = to_10.and_then(|decay| indicator(!decay.is_over));
    [to_10.map(|decay| decay.time_s), to_20.map(|decay| decay.time_s), carried, undecayed]
}

/// Returns the push of a trial in which the robot did not fall.
pub(super) fn upright_push<'a>(trial: &Trial<'a>) -> Option<&'a Push> {
    trial.script.pushes().next().filter(|_| trial.is_upright())
}

/// Returns the one condition of E2 and E3: the push of the scenario's file.
pub(super) fn sideways() -> Result<Vec<Condition>, ConfigError> {
    let push: PushTrunk = defaults("push")?;
    Ok(vec![Condition { label: "0.5 m/s to the left".into(), scenario: Scenario::Push(push) }])
}

/// Returns a note about the number of trials in which the push had not decayed by the end; none if it always had.
pub(super) fn undecayed(results: &Results, conditions: &[usize]) -> Option<String> {
    let index = results.index(UNDECAYED.name);
    let of_set = |set: usize| {
        let policies = results.sets[set].values();
        let trials = policies.flat_map(|policy| conditions.iter().filter_map(|c| policy.get(*c))).flatten();
        let found: Vec<f64> = trials.filter_map(|sample| sample.values[index]).collect();
        let lasting = found.iter().filter(|is_lasting| **is_lasting > 0.0).count();
        (lasting > 0).then(|| format!("in {lasting} of {} trials of {}", found.len(), results.names[set]))
    };
    let words: Vec<String> = (0..results.sets.len()).filter_map(of_set).collect();
    let rest = "the push had not decayed to 10 % by the end: it counts with the time until then.";
    (!words.is_empty()).then(|| format!("{} {rest}", words.join(" and ")))
}
