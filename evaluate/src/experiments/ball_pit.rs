//! E7: crossing a field of loose balls (Fig. 7a).

use super::prelude::*;
use supple::scenario::catalog::BallPit as Pit;

const QUANTITIES: &[Quantity] = &[
    Quantity::new("crossed", "got across", "%", 0),
    FELL,
    Quantity::new("stuck", "stuck", "%", 0),
    Quantity::new("crossing_time_s", "time to get across", "s", 1),
    Quantity::new("distance_m", "distance ahead", "m", 2),
    Quantity::new("peak_foot_force_n", "peak foot force", "N", 0),
    Quantity::new("power_w", "power among the balls", "W", 1),
];

pub(super) const INFO: Info = Info {
    id: "E7",
    number: 7,
    name: "ball-pit",
    title: "Ball pit",
    paper: "Fig. 7a",
    method: "At 0.4 m/s across 20 by 20 rigid balls of 0.5 kg and 5 cm radius, 3 cm apart. The robot is across \
             when its trunk passes the last row, and stuck if it neither gets there nor falls in the time it \
             has. Time, peak foot force and power are from the first row to past the last; a trial that does not get \
             across has none, nor has one that leaves the balls at their side. \
             Each trial starts at another distance, so that the gait meets the balls at another phase.",
    quantities: QUANTITIES,
};

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BallPit {
    /// Runs of each policy.
    pub trials: u32,
}

impl Experiment for BallPit {
    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let pit: Pit = defaults("ball-pit")?;
        Ok(vec![Condition { label: String::new(), scenario: Scenario::BallPit(pit) }])
    }

    fn measure(&self, trial: &Trial) -> Measured {
        let Scenario::BallPit(pit) = trial.scenario else { return Measured::default() };
        let crossed = trial.metric("crossed") == Some(1.0);
        let crossing = metrics::crossing(trial.trace, pit.distance_m, pit.far_edge_m()).filter(|_| crossed);
        let among_balls = crossing.into_iter().flat_map(|[from_s, to_s]| metrics::window(trial.trace, from_s, to_s));
        vec![
            truth(crossed),
            trial.end.fell(),
            truth(!crossed && trial.is_upright()),
            crossing.map(|[from_s, to_s]| to_s - from_s),
            trial.upright_metric("distance_m"),
            metrics::largest(among_balls.clone(), |frame| frame.peak_foot_force_n),
            metrics::mean(among_balls, |frame| frame.power_w),
        ]
        .into()
    }

    fn show(&self, show: &mut Show) {
        show.table("Crossing 400 loose balls.");
        show.dots(
            "",
            "Crossing a ball pit",
            &["crossed", "fell", "stuck", "peak_foot_force_n"],
            "Crossing a pit of 400 balls: mean ± standard deviation over seeds, single seeds as hollow marks.",
        );
        let (text, force) = ("Compliant policies get across the ball pit", "The largest force on a foot is lower");
        show.claim(text, "more often", "crossed", Expected::Higher, &[0]);
        show.claim(force, "lower", "peak_foot_force_n", Expected::Lower, &[0]);
    }
}
