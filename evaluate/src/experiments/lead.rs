//! E14c: a person walks away with the leash.

use super::prelude::*;
use crate::plot::polar::Scales;
use supple::scenario::catalog::Lead as Led;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("mean_tension_n", "mean tension", "N", 1),
    Quantity::new("peak_tension_n", "peak tension", "N", 1),
    Quantity::new("led_m", "led beside its course by", "m", 2),
    FELL,
];

pub(super) const INFO: Info = Info {
    id: "E14c",
    number: 17,
    name: "lead",
    title: "Led by the leash",
    paper: "not in the paper",
    method: "Somebody goes along with the commanded walk, holding the leash, and after 2 s walks away from it at 0.5 m/s, in \
             directions of the world all around. Leash, hand and arm are a spring of 200 N/m with 20 N·s/m that pulls the \
             trunk's centre of mass along that direction, and never pushes. A robot that yields by c goes along once the \
             tension is 0.5/c. Tensions are of the last 3 of 6 s. A fall leaves all but the falls undefined.",
    quantities: QUANTITIES,
};

/// The parameters of the experiment in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Lead {
    /// Forward commands \[m/s\]; 0 is standing.
    pub commands_m_s: Vec<f64>,
    /// Directions that divide the circle evenly.
    pub directions: u32,
    /// Runs of each policy in each direction at each command.
    pub trials: u32,
}

impl Experiment for Lead {
    fn info(&self) -> Info {
        INFO
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: Led = defaults("lead")?;
        Ok(by_gait_and_direction(&self.commands_m_s, self.directions, |forward_m_s, direction_deg| {
            let task = Task { forward_m_s, ..base.task.clone() };
            Scenario::Lead(Led { direction_deg, task, ..base })
        }))
    }

    fn check(&self) -> Result<(), ParameterError> {
        check_directions(self.directions)
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        trial.upright_metrics(QUANTITIES)
    }

    fn report(&self, section: &mut SectionBuilder) {
        let groups =
            Group::from_names(self.commands_m_s.iter().map(|command| gait(*command).to_owned()), section.results);
        for Group { name, conditions } in &groups {
            for (quantity, words) in
                [("mean_tension_n", "go along with less tension (mean over directions)"), ("fell", "fall less often")]
            {
                let text = format!("Led by the leash while {name}, compliant policies {words}");
                section.claim(&text, "", quantity, Expected::Lower, conditions);
            }
        }
        section.table_with_rows("Led by the leash at 0.5 m/s, mean over all directions.", section.rows(&groups));
        section.table_in_file("all", "Led by the leash at 0.5 m/s, by direction.");
        section.polar(
            "",
            "Tension of a leash that somebody walks away with, by direction",
            ("mean_tension_n", "mean tension [N]"),
            &groups,
            Scales::Shared,
            "Mean tension of a leash that somebody walks away with at 0.5 m/s, by the direction they walk to: mean and ± \
             standard deviation over seeds. Trials with a fall have none.",
        );
    }
}
