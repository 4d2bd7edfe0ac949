//! E4: how long a push from any side lasts, standing and walking (Fig. 4).

use super::prelude::*;
use super::push;
use supple::scenario::catalog::PushTrunk;
use supple::scenario::metrics::BRIEF_S;
use supple::task::Command;

/// The decay time of a push to a standing robot, with a moving average of 0.1 s instead of 0.4 s.
const BRIEFLY_AVERAGED: Quantity =
    Quantity::new("decay_10_averaged_0_1_s", "decay to 10 %, averaged over 0.1 s", "s", 2);

const QUANTITIES: &[Quantity] = &[push::TO_10, push::TO_20, push::CARRIED, push::UNDECAYED, FELL, BRIEFLY_AVERAGED];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Directions {
    pub directions: u32,
    pub trials: u32,
    pub commands_m_s: Vec<f64>,
}

impl Experiment for Directions {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 4",
            method: "A push of 0.5 m/s in directions all around, standing and walking at 0.5 m/s. Decay time as in E2.",
            ..ExperimentInfo::new("E4", 4, "directions", "Decay of pushes from all sides", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: PushTrunk = defaults("push")?;
        let each = pairs(&self.commands_m_s, &evenly(self.directions));
        Ok(conditions(each, |(forward_m_s, direction_deg)| {
            let task = Task { forward_m_s, ..base.task.clone() };
            let scenario = Scenario::Push(PushTrunk { direction_deg, task, ..base });
            (format!("{}, {direction_deg:.1}°", gait(forward_m_s)), scenario)
        }))
    }

    fn check(&self) -> Result<(), ParameterError> {
        check_directions(self.directions)
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let push = push::upright_push(trial);
        let decay = push.map_or([None; 4], |push| push::decay(trial.trace, push.at_s, push.linear));
        let briefly = push
            .filter(|_| Command { compliance: None, ..trial.script.command } == Command::default())
            .and_then(|push| metrics::decay(trial.trace, push.at_s, push.linear, 0.1, BRIEF_S))
            .map(|decay| decay.time_s);
        [&decay[..], &[trial.end.fell(), briefly]].concat().into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        let groups = section.groups(&self.commands_m_s, |command| match command {
            0.0 => gait(0.0).to_owned(),
            command => format!("{} at {command} m/s", gait(command)),
        });
        let mut rows = Vec::new();
        for (group, command) in groups.iter().zip(&self.commands_m_s) {
            let (name, is_standing) = (&group.name, *command == 0.0);
            let briefly = (BRIEFLY_AVERAGED.name, "take longer to stabilise to 10 %, averaged over 0.1 s");
            for (quantity, words) in is_standing.then_some(briefly).into_iter().chain(push::lasting(*command)) {
                let text = format!(
                    "Pushed from any side while {name}, compliant policies {words} (mean over directions; larger in {})",
                    section.results.larger_in(&group.conditions, quantity)
                );
                section.claim(&text, "longer", quantity, Higher, &group.conditions);
            }
            section
                .content
                .notes
                .extend(push::undecayed(section.results, &group.conditions).map(|note| format!("{name}: {note}")));
            let shown = QUANTITIES.iter().filter(|quantity| is_standing || **quantity != BRIEFLY_AVERAGED);
            rows.extend(shown.map(|quantity| section.row(group, *quantity)));
        }
        section.table_with_rows("Decay time of a push of 0.5 m/s, mean over all directions.", rows);
        section.table_in_file("all", "Decay time of a push by direction.");
        for (part, title, axis) in [
            ("", "Decay time (to 20 %) of a push of 0.5 m/s", ("decay_20_s", "decay time to 20 % [s]")),
            ("carried", "How far a push of 0.5 m/s carries the robot", ("carried_m", "carried within 2 s [m]")),
        ] {
            let title = format!("{title}, by the direction it pushes to");
            let more = "Trials with a fall have none. The two plots differ in scale.";
            section.polar(part, &title, axis, (&groups, self.directions), Scales::Own, more);
        }
    }
}
