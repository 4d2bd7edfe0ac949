//! E2: how a sideways push fades away (Fig. 3).

use serde::{Deserialize, Serialize};

use super::{truth, undecayed, velocity};
use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Table};
use crate::evaluate::plot::curves::{self, Curve};
use crate::evaluate::results::Results;
use crate::evaluate::statistics::{Expected, Spread};
use crate::evaluate::trial::End;
use crate::evaluate::{Condition, Experiment, FELL, Info, Measured, Quantity, UNDECAYED};
use crate::scenario::catalog::{PushAway, Scenario, defaults};
use crate::scenario::metrics::STRIDE_S;
use crate::scenario::{Script, metrics};
use crate::trace::Trace;

const QUANTITIES: &[Quantity] = &[
    FELL,
    Quantity::new("decay_10_s", "decay to 10 %", "s", 2),
    Quantity::new("decay_20_s", "decay to 20 %", "s", 2),
    Quantity::new("carried_m", "carried by the push within 2 s", "m", 3),
    Quantity::new("left_before_m_s", "sideways velocity before", "m/s", 3),
    UNDECAYED,
];

/// How long a disturbance lasts, as quantities and in claims: the paper names no threshold.
const LASTING: [(&str, &str); 3] = [
    ("decay_10_s", "take longer to stabilise (to 10 %)"),
    ("decay_20_s", "take longer to stabilise (to 20 %)"),
    ("carried_m", "are carried farther (neither threshold nor average)"),
];

/// Those that tell at a forward command \[m/s\]. Robots that are to stand step from foot to foot, some slowly, and to 10 %
/// of a push it is these steps that count.
pub(super) fn lasting(command_m_s: f64) -> impl Iterator<Item = (&'static str, &'static str)> {
    LASTING.into_iter().skip(usize::from(command_m_s == 0.0))
}

/// Over which the robot is carried \[s\].
pub(super) const CARRIED_S: f64 = 2.0;

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Decay {
    /// Runs of each policy.
    pub trials: u32,
}

impl Decay {
    /// The runs of one policy, with its decay time and the velocity that they decay to.
    fn curve(results: &Results, set: usize) -> Curve {
        let mut curve = velocity::curve(results, set, 0);
        let of_seed = |quantity: &str| results.per_seed(set, 0, quantity).get(&results.shown_seed(set)?).copied();
        curve.mark = of_seed("decay_10_s").map(|decay| (decay, format!("{decay:.2} s")));
        let push_m_s = match &results.conditions[0].scenario {
            Scenario::Push(push) => push.push_m_s,
            _ => 0.0,
        };
        curve.tolerance = of_seed("left_before_m_s").map(|level| [level, 0.1 * push_m_s]);
        curve
    }
}

impl Experiment for Decay {
    fn info(&self) -> Info {
        Info {
            id: "E2",
            number: 2,
            name: "decay",
            title: "Decay of a sideways push",
            paper: "Fig. 3",
            method: "Walking at 0.5 m/s, the robot is pushed to the left by 0.5 m/s. e(t) is the velocity along the \
                     push minus its mean over the last second before, smoothed by a centred moving average of \
                     0.4 s, about a stride. Decay time is the last time after the push at which |e| exceeds 10 % (and 20 %) of \
                     the push; a fall has none, and what lasts to the end counts as lasting until there. Beside it, without threshold and average: how far the push carries \
                     the robot, the integral of e(t) over 2 s. The figure shows the unsmoothed velocity of one policy's runs.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        QUANTITIES
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let push: PushAway = defaults("push")?;
        Ok(vec![Condition { label: "0.5 m/s to the left".into(), scenario: Scenario::Push(push) }])
    }

    fn measure(&self, _: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let mut values = vec![None; QUANTITIES.len()];
        values[0] = end.fell();
        let Some(push) = script.pushes.first() else { return Measured { values, series: Vec::new() } };
        if end == End::Upright {
            let [to_10, to_20] =
                [0.1, 0.2].map(|to| metrics::decay(trace, push.time_s, push.push.linear, to, STRIDE_S));
            values[1] = to_10.map(|decay| decay.time_s);
            values[2] = to_20.map(|decay| decay.time_s);
            values[5] = to_10.and_then(|decay| truth(!decay.is_over));
            values[3] = metrics::carried(trace, push.time_s, push.push.linear, CARRIED_S);
            let before = metrics::window(trace, push.time_s - 1.0, push.time_s);
            values[4] = metrics::mean(before, |frame| frame.velocity_in_heading[1]);
        }
        Measured { values, series: velocity::around(trace, push.time_s) }
    }

    fn findings(&self, results: &Results) -> Findings {
        let table = Table::of_conditions(
            "decay",
            "Decay of a sideways push of 0.5 m/s.",
            results,
            &["decay_10_s", "decay_20_s", "carried_m", "left_before_m_s", "undecayed", "fell"],
        )
        .with_paper("decay_10_s", "+85 %");
        let curves = [0, 1].map(|set| Decay::curve(results, set));
        let svg = curves::draw(
            "Sideways velocity after a push, one policy of each set",
            curves,
            "time since the push [s]",
            "sideways velocity [m/s]",
        );
        let decays = [0, 1].map(|set| Spread::of(&results.per_seed(set, 0, "decay_10_s")).map(|spread| spread.mean));
        let words = decays.map(|decay| decay.map_or("none".to_owned(), |decay| format!("{decay:.2} s")));
        let figure = Figure::new(
            "decay",
            format!(
                "Sideways velocity after a push of 0.5 m/s to the left while walking at 0.5 m/s: mean and min–max band over \
                 the runs of one policy, each until it falls. Dotted: ±10 % of the push around the velocity before; \
                 dashed: this policy's mean decay time. Over all seeds it is {} ({}) and {} ({}).",
                words[0], results.names[0], words[1], results.names[1]
            ),
            svg,
        );
        let claim = |(quantity, words): (&str, &str)| {
            let text = format!("After a sideways push, compliant policies {words}");
            let comparison = results.compare(0, quantity);
            Claim::direction(&text, "+85 % in time", results.quantity(quantity), Expected::Higher, comparison)
        };
        let claims = LASTING.map(claim).into();
        let notes = undecayed(results, &[0]).into_iter().collect();
        Findings {
            claims,
            tables: vec![table],
            figures: vec![figure],
            lines: vec![velocity::lines("decay-curves", results)],
            notes,
        }
    }
}
