//! E17: standing at a set point, pulled away from it by a constant force.

use super::prelude::*;
use supple::scenario::catalog::Leash;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("stiffness_n_per_m", "stiffness", "N/m", 0),
    Quantity::new("stiffness_error", "error of the stiffness", "%", 0),
    Quantity::new("return_error_m", "distance from the set point after the pull", "m", 2),
    FELL,
];

/// The rate κ of the set point \[1/s\]; the pull \[N\], its beginning, duration and the averaged time before its end \[s\].
const SET_POINT_PER_S: f64 = 1.0;
const FORCE_N: f64 = 10.0;
const AT_S: f64 = 2.0;
const FOR_S: f64 = 6.0;
const AVERAGE_S: f64 = 2.0;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SetPoint {
    pub compliances: Vec<f64>,
    pub directions: u32,
    pub trials: u32,
}

impl Experiment for SetPoint {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            method: "A robot that stands is commanded back to its start: by the distance, in meters, times a rate κ, \
                     in m/s. With the compliance c it is to act as a spring of κ/c, tied to the start, with a damper \
                     of 1/c. A constant force pulls its trunk away, in directions all around. Stiffness is the force \
                     over the displacement along it, mean over the last seconds of the pull; its error is relative \
                     to κ/c, at most 100 %. The distance is that at the end of the trial, as long after the pull as \
                     it lasted. A fall leaves all but the falls undefined.",
            ..ExperimentInfo::new("E17", 20, "set-point", "Held at a set point", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: Leash = defaults("leash")?;
        Ok(conditions(pairs(&self.compliances, &evenly(self.directions)), |(compliance, direction_deg)| {
            let task = Task {
                forward_m_s: 0.0,
                duration_s: AT_S + 2.0 * FOR_S,
                compliance: Some(compliance),
                ..base.task.clone()
            };
            let (force_n, at_s, for_s, set_point_per_s) = (FORCE_N, AT_S, FOR_S, SET_POINT_PER_S);
            let pull = Leash { force_n, direction_deg, at_s, for_s, set_point_per_s, task };
            (format!("{} m/s/N, {direction_deg:.1}°", brief(compliance)), Scenario::Leash(pull))
        }))
    }

    fn check(&self) -> Result<(), ParameterError> {
        check_directions(self.directions)
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let mut values = vec![None, None, None, trial.end.fell()];
        let (true, Some(pull), Some(compliance)) =
            (trial.is_upright(), trial.script.pull(), trial.scenario.task().compliance)
        else {
            return values.into();
        };
        let [x, y] = pull.force.map(|part| part / FORCE_N);
        let last = metrics::window(trial.trace, pull.until_s - AVERAGE_S, pull.until_s);
        let moved_m = metrics::mean(last, |frame| frame.position[0] * x + frame.position[1] * y);
        let stiffness = moved_m.filter(|moved_m| *moved_m != 0.0).map(|moved_m| FORCE_N / moved_m);
        values[0] = stiffness;
        values[1] = stiffness.map(|found| (found * compliance / SET_POINT_PER_S - 1.0).abs().min(1.0));
        values[2] = trial.trace.frames.last().map(|frame| frame.position[0].hypot(frame.position[1]));
        values.into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        let groups = section.groups(&self.compliances, |compliance| format!("{} m/s/N", brief(compliance)));
        for ConditionGroup { name, conditions } in &groups {
            let text =
                format!("At a set point with {name}, the first policies' stiffness is nearer to the commanded one");
            section.claim(&text, "", "stiffness_error", Lower, conditions);
        }
        section.table_with_rows("Held at a set point, mean over all directions.", section.rows(&groups));
        section.table_in_file("all", "Held at a set point, by compliance and direction.");
        section.grouped_dots("", "Stiffness at a set point", &groups, &["stiffness_n_per_m", "return_error_m"], "");
    }
}
