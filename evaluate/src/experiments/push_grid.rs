//! E1: how large a push the robot withstands, over a grid of pushes (Fig. 2).

use super::prelude::*;
use crate::plot::heatmap::{self, Map};
use crate::results::Results;
use crate::section_content::{Claim, Row};
use crate::square_grid::{self, SquareGrid};
use crate::statistics::{Comparison, Numbers, PerSeed, Spread, estimate, mean};
use crate::trial::TrialEnd;
use supple::scenario::Script;
use supple::scenario::catalog::PushTrunk;
use supple::scenario::metrics::PHASE_S;

const FRACTION: Quantity = Quantity::new("share_of_grid", "grid points with enough success", "%", 1);
const FRACTION_BY_SEED: Quantity =
    Quantity::new("share_of_grid_by_seed", "grid points with enough success, for each seed alone", "%", 1);
const MEAN_SUCCESS: Quantity = Quantity::new("mean_success", "success rate over the whole grid", "%", 1);
const QUANTITIES: &[Quantity] = &[Quantity::new("success", "success rate", "%", 0)];

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PushGrid {
    /// The largest push along either axis \[m/s\].
    pub limit_m_s: f64,
    /// The number of grid points along either axis.
    pub points_per_side: usize,
    pub trials: u32,
    /// The earliest time of the push \[s\]; each trial delays it by up to 0.65 s.
    pub at_s: f64,
    /// The time after the push in which the robot must not fall \[s\].
    pub watch_s: f64,
    /// The success rate of the contour, 0 to 1.
    pub level: f64,
}

impl PushGrid {
    fn grid(&self, values: Vec<f64>) -> SquareGrid {
        SquareGrid { coordinates: square_grid::coordinates(self.limit_m_s, self.points_per_side), values }
    }

    /// Returns the success rate of each grid point over some seeds of a set.
    fn success(&self, results: &Results, set: usize, seeds: &[u64]) -> SquareGrid {
        let of_point = |point: usize| {
            let of_seed = |seed: &u64| {
                let trials = results.sets[set].get(seed)?.get(point)?;
                mean(trials.iter().filter_map(|sample| sample.values[0]))
            };
            mean(seeds.iter().filter_map(of_seed)).unwrap_or(0.0)
        };
        self.grid((0..results.conditions.len()).map(of_point).collect())
    }

    /// Returns the success rate of each grid point over all seeds of a set.
    fn map(&self, results: &Results, set: usize) -> SquareGrid {
        self.success(results, set, &results.sets[set].keys().copied().collect::<Vec<u64>>())
    }

    /// Compares a number of the map of all seeds together; the interval of its difference is over pairs of seeds.
    fn compare(&self, results: &Results, number: impl Fn(&SquareGrid) -> f64) -> Comparison {
        let pooled = |set: usize| {
            let (seeds, mean) = (results.sets[set].len(), number(&self.map(results, set)));
            let spread = (seeds > 0).then_some(Spread { mean, sd: None, seeds });
            Numbers { spread, ..results.numbers(set, PerSeed::new()) }
        };
        // Resampling reads the map of each seed many times.
        let common = results.common_seeds();
        let maps = common.iter().map(|seed| [0, 1].map(|set| self.success(results, set, &[*seed]).values));
        let maps: Vec<[Vec<f64>; 2]> = maps.collect();
        let of_resample = |chosen: &[usize], set: usize| {
            let points = 0..results.conditions.len();
            let values = points.map(|p| chosen.iter().map(|s| maps[*s][set][p]).sum::<f64>() / chosen.len() as f64);
            number(&self.grid(values.collect()))
        };
        let both = |chosen: &[usize]| (!chosen.is_empty()).then(|| [0, 1].map(|set| of_resample(chosen, set)));
        let difference = estimate(common.len(), |chosen| both(chosen).map(|[a, b]| a - b));
        Comparison { sets: (0..results.sets.len()).map(pooled).collect(), difference, relative: None, trials: None }
    }

    /// Compares a number of each seed's own map.
    fn compare_by_seed(&self, results: &Results, number: impl Fn(&SquareGrid) -> f64) -> Comparison {
        let by_seed = |set: usize| {
            let seeds = results.sets[set].keys();
            let of_seed = seeds.map(|seed| (*seed, number(&self.success(results, set, &[*seed]))));
            results.numbers(set, of_seed.collect())
        };
        Comparison::new((0..results.sets.len()).map(by_seed).collect())
    }
}

impl Experiment for PushGrid {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            paper: "Fig. 2",
            method: "Walking at 0.5 m/s, the robot is pushed once: a velocity offset on a square grid of (forward, \
                     left) is added to its trunk. A trial succeeds if it has not fallen until some seconds after. The \
                     success rate is that over the trials of all seeds; the fraction counts grid points at or above \
                     the contour's level.",
            ..ExperimentInfo::new("E1", 1, "push-grid", "Push recovery", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: PushTrunk = defaults("push")?;
        let coordinates = square_grid::coordinates(self.limit_m_s, self.points_per_side);
        Ok(conditions(pairs(&coordinates, &coordinates), |(forward, left)| {
            let task = Task { duration_s: self.at_s + PHASE_S + self.watch_s, ..base.task.clone() };
            let (push_m_s, direction_deg) = (forward.hypot(left), left.atan2(forward).to_degrees());
            let scenario = Scenario::Push(PushTrunk { push_m_s, direction_deg, at_s: self.at_s, task, ..base });
            (format!("{forward:+.3}, {left:+.3} m/s").replace('-', "−"), scenario)
        }))
    }

    fn check(&self) -> Result<(), ParameterError> {
        let points = self.points_per_side;
        in_range("points_per_side", points as f64, 2.0, 101.0, "2 to 101")?;
        in_range("level", self.level, 0.0, 1.0, "0 to 1")?;
        in_range("limit_m_s", self.limit_m_s, 0.1, 20.0, "0.1 to 20 m/s")?;
        in_range("watch_s", self.watch_s, 0.1, 60.0, "0.1 to 60 s")
    }

    fn until_s(&self, script: &Script) -> f64 {
        script.pushes().next().map_or(script.duration_s, |push| push.at_s + self.watch_s)
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let fell = trial.trace.fall().is_some_and(|fall| fall.time_s <= self.until_s(trial.script));
        vec![indicator(!fell && trial.end != TrialEnd::Fault)].into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        let results = section.results;
        let fraction = |grid: &SquareGrid| grid.fraction_at_least(self.level);
        let overall = |grid: &SquareGrid| mean(grid.values.iter().copied()).unwrap_or(0.0);
        let pooled = self.compare(results, fraction);
        let rows = vec![
            Row { paper: "78 / 73".into(), ..Row::new("", FRACTION, pooled.clone()) },
            Row::new("", FRACTION_BY_SEED, self.compare_by_seed(results, fraction)),
            Row::new("", MEAN_SUCCESS, self.compare_by_seed(results, overall)),
        ];
        let level = 100.0 * self.level;
        let title = format!("Push recovery: fraction of grid points with a success rate of at least {level:.0} %.");
        section.table_with_rows(&title, rows);
        section.table_in_file("points", "Success rate at every grid point (forward, left).");

        let maps = section.by_set(|set| self.map(results, set));
        let titled = results
            .names
            .iter()
            .zip(&maps)
            .map(|(name, grid)| Map { title: format!("{name}: {:.1} % of grid points", 100.0 * fraction(grid)), grid });
        let svg = heatmap::draw(
            "Success after a push, by the push's forward and left part",
            &titled.collect::<Vec<_>>(),
            self.level,
            ["forward push [m/s]", "push to the left [m/s]", "success rate [%]"],
        );
        let caption = format!(
            "Success rate after a push of given forward and left velocity while walking at 0.5 m/s, over all seeds \
             and trials. The line is the {level:.0} % contour; above each map, the fraction of grid points at or \
             above {level:.0} %."
        );
        section.figure("", caption, svg);
        let text =
            format!("The {level:.0} % contour of push recovery encloses more of the grid for compliant policies");
        section.content.claims.push(Claim::new(&text, "78 / 73 %", FRACTION, Higher, pooled));
    }
}
