//! E7: crossing a field of loose balls (Fig. 7a).

use super::crossing::Crossing;
use super::prelude::*;
use crate::trial::TrialEnd;
use supple::scenario::catalog::BallPit as BallPitScenario;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("crossed", "got across", "%", 0),
    FELL,
    Quantity::new("stuck", "stuck", "%", 0),
    Quantity::new("crossing_time_s", "time to get across", "s", 1),
    Quantity::new("peak_foot_force_n", "peak foot force", "N", 0),
    Quantity::new("power_w", "power among the balls", "W", 1),
];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallPit {
    /// The kinds of balls; each fills a pit of its own.
    pub pits: Vec<Balls>,
    pub trials: u32,
}

/// The balls of a pit and the speed at which the robot crosses it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Balls {
    /// The mass of a ball \[kg\].
    pub mass_kg: f64,
    /// The radius of a ball \[m\].
    pub radius_m: f64,
    /// The forward command \[m/s\].
    pub forward_m_s: f64,
}

impl Balls {
    fn label(&self) -> String {
        format!("{} kg, {:.0} cm, {} m/s", brief(self.mass_kg), 100.0 * self.radius_m, brief(self.forward_m_s))
    }

    /// Returns a pit of these balls with about the size of `base` and the same gaps between balls.
    fn pit(&self, base: &BallPitScenario) -> BallPitScenario {
        let pitch = |radius_m: f64| 2.0 * radius_m + base.gap_m;
        let side = (f64::from(base.balls).sqrt() * pitch(base.radius_m) / pitch(self.radius_m)).round();
        let balls = (side * side) as u32;
        let mut pit = BallPitScenario { balls, mass_kg: self.mass_kg, radius_m: self.radius_m, ..base.clone() };
        pit.task.forward_m_s = self.forward_m_s;
        pit
    }
}

impl Experiment for BallPit {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 7a",
            method: "The robot walks at 0.4 m/s across 20 by 20 rigid balls of 0.5 kg and 5 cm radius, 3 cm apart, or \
                     across a field of the same size with other balls. It is across when its trunk passes the last \
                     row; the trial ends a second later. It is stuck if it neither gets across nor falls within the \
                     trial. Time, peak foot force and power are measured from the first row to past the last. They are \
                     undefined if the robot does not get across, or leaves the field at its side. Each trial starts at \
                     another distance, so that the gait meets the balls at another phase.",
            ..ExperimentInfo::new("E7", 7, "ball-pit", "Ball pit", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: BallPitScenario = defaults("ball-pit")?;
        // A single kind of pit needs no label.
        let label = |balls: &Balls| if self.pits.len() > 1 { balls.label() } else { String::new() };
        Ok(conditions(&self.pits, |balls| (label(balls), Scenario::BallPit(balls.pit(&base)))))
    }

    fn check(&self) -> Result<(), ParameterError> {
        self.pits.iter().try_for_each(|balls| {
            in_range("pits.mass_kg", balls.mass_kg, 1e-3, 1e3, "0.001 to 1000 kg")?;
            in_range("pits.radius_m", balls.radius_m, 0.03, 0.5, "0.03 to 0.5 m")?;
            in_range("pits.forward_m_s", balls.forward_m_s, 0.01, 10.0, "0.01 to 10 m/s")
        })
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let Scenario::BallPit(pit) = trial.scenario else { return TrialValues::default() };
        let crossing = Crossing::new(trial, pit.distance_m, pit.far_edge_m());
        vec![
            indicator(crossing.is_across),
            trial.end.fell(),
            indicator(!crossing.is_across && trial.is_upright()).filter(|_| trial.end != TrialEnd::Fault),
            crossing.times_s.map(|[from_s, to_s]| to_s - from_s),
            crossing.peak_foot_force_n,
            crossing.power_w,
        ]
        .into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        section.table("Crossing a field of loose balls.");
        section.dots("", "Crossing a field of loose balls", &["crossed", "fell", "stuck", "peak_foot_force_n"], "");
        let text = "Compliant policies get across the ball pit more often";
        section.claim(text, "more often", "crossed", Higher, &section.all());
        let text = "Compliant policies have a lower peak foot force in the ball pit";
        section.claim(text, "lower", "peak_foot_force_n", Lower, &section.all());
    }
}
