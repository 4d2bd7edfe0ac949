//! E2: how a sideways push fades away (Fig. 3).

use super::prelude::*;
use super::{push, velocity};
use crate::plot::curves::Curve;
use crate::results::Results;
use crate::statistics::Spread;
use supple::scenario::catalog::PushTrunk;

const BEFORE: Quantity = Quantity::new("left_before_m_s", "sideways velocity before", "m/s", 3);
const QUANTITIES: &[Quantity] = &[push::TO_10, push::TO_20, push::CARRIED, BEFORE, push::UNDECAYED, FELL];

/// The duration of the shove that stands beside the instant push \[s\].
const SHOVE_S: f64 = 0.1;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Decay {
    pub trials: u32,
}

/// Adds the decay time of the shown policy and the velocity that its runs decay to to a set's curve.
fn marked(results: &Results, curve: Curve, set: usize) -> Curve {
    let of_seed = |quantity: &str| results.per_seed(set, 0, quantity).get(&results.shown_seed(set)?).copied();
    let push_m_s = match &results.conditions[0].scenario {
        Scenario::Push(push) => push.push_m_s,
        _ => 0.0,
    };
    Curve {
        mark: of_seed("decay_10_s").map(|decay| (decay, format!("{decay:.2} s"))),
        tolerance: of_seed("left_before_m_s").map(|level| [level, 0.1 * push_m_s]),
        ..curve
    }
}

impl Experiment for Decay {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 3",
            method: "Walking at 0.5 m/s, the robot is pushed to the left by 0.5 m/s, in an instant \
                     and, in a second condition, by a steady force within 0.1 s. e(t) is the velocity along the \
                     push minus its mean over the last second before, smoothed by a centred moving average of 0.4 s, \
                     about a stride. Decay time is the last time after the push at which |e| exceeds 10 % (and 20 %) \
                     of the push; a trial with a fall has none, and a push that has not decayed by the end counts with \
                     the time until then. A measure without threshold and average is the distance that the push \
                     carries the robot, the integral of e(t) over 2 s. The figure shows the unsmoothed velocity of one \
                     policy's runs.",
            ..ExperimentInfo::new("E2", 2, "decay", "Decay of a sideways push", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let instant = push::sideways()?;
        let label = format!("{}, within {SHOVE_S} s", instant[0].label);
        let shove = PushTrunk { for_s: SHOVE_S, ..defaults("push")? };
        Ok(instant.into_iter().chain([Condition { label, scenario: Scenario::Push(shove) }]).collect())
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let Some(pushed) = trial.script.pushes().next() else { return vec![None; QUANTITIES.len()].into() };
        let upright = trial.is_upright();
        let before = metrics::window(trial.trace, pushed.at_s - 1.0, pushed.at_s);
        let before = metrics::mean(before, |frame| frame.velocity_in_heading[1]).filter(|_| upright);
        let [to_10, to_20, carried, undecayed] =
            push::upright_push(trial).map_or([None; 4], |it| push::decay(trial.trace, it.at_s, it.linear));
        let values = vec![to_10, to_20, carried, before, undecayed, trial.end.fell()];
        TrialValues { values, series: velocity::around(trial.trace, pushed.at_s) }
    }

    fn report(&self, section: &mut SectionBuilder) {
        section
            .table("Decay of a sideways push of 0.5 m/s, in an instant and within 0.1 s.")
            .set_paper("decay_10_s", "+85 %");
        let results = section.results;
        let means =
            section.per_seed(0, "decay_10_s").into_iter().map(|seeds| Spread::from_values(&seeds).map(|it| it.mean));
        let words = means.map(|mean| mean.map_or("none".to_owned(), |mean| format!("{mean:.2} s")));
        let words: Vec<String> = words.zip(&results.names).map(|(mean, name)| format!("{mean} ({name})")).collect();
        let caption = format!(
            "Sideways velocity after a push of 0.5 m/s to the left while walking at 0.5 m/s: mean and min–max band \
             over the runs of one policy, each until it falls. Dotted: ±10 % of the push around the velocity before; \
             dashed: this policy's mean decay time. Over all seeds it is {}.",
            words.join(" and ")
        );
        let words = ["Sideways velocity after a push, one policy of each set", "time since the push [s]"];
        velocity::figure(section, ["", "decay-curves"], words, 0, |curve, set| marked(results, curve, set), caption);
        for (quantity, words) in push::LASTING {
            let text = format!("After a sideways push, compliant policies {words}");
            section.claim(&text, "+85 % in time", quantity, Higher, &[0]);
        }
        section.content.notes.extend(push::undecayed(results, &[0]));
    }
}
