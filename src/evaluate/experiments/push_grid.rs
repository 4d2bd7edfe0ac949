//! E1: how large a push the robot withstands, over a grid of pushes (Fig. 2).

use serde::{Deserialize, Serialize};

use super::truth;
use crate::config::ConfigError;
use crate::evaluate::findings::{Claim, Figure, Findings, Row, Table};
use crate::evaluate::grid::{self, Grid};
use crate::evaluate::plot::heatmap::{self, Map};
use crate::evaluate::results::Results;
use crate::evaluate::statistics::{Comparison, Expected, PerSeed, Spread, estimate, mean};
use crate::evaluate::trial::End;
use crate::evaluate::{Condition, Experiment, Info, Measured, Quantity};
use crate::scenario::Script;
use crate::scenario::catalog::{PushAway, Scenario, Task, defaults};
use crate::scenario::metrics::PHASE_S;
use crate::trace::Trace;

const SUCCESS: Quantity = Quantity::new("success", "success", "%", 0);
const SHARE: Quantity = Quantity::new("share_of_grid", "grid points with enough success", "%", 1);
const SHARE_BY_SEED: Quantity = Quantity::new("share_of_grid_by_seed", "the same for each seed alone", "%", 1);
const MEAN_SUCCESS: Quantity = Quantity::new("mean_success", "success over the whole grid", "%", 1);

/// Its numbers in the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PushGrid {
    /// Largest push along either axis \[m/s\].
    pub limit_m_s: f64,
    /// Grid points along either axis.
    pub points_per_side: usize,
    /// Trials of each grid point.
    pub trials: u32,
    /// Earliest time of the push; it comes up to 0.65 s later \[s\].
    pub at_s: f64,
    /// How long the robot must not fall \[s\].
    pub watch_s: f64,
    /// The contour's level, 0 to 1.
    pub level: f64,
}

impl PushGrid {
    fn grid(&self, values: Vec<f64>) -> Grid {
        Grid { coordinates: grid::coordinates(self.limit_m_s, self.points_per_side), values }
    }

    /// Success averaged over some seeds of a set, by grid point.
    fn success(&self, results: &Results, set: usize, seeds: &[u64]) -> Grid {
        let of_point = |point: usize| {
            let of_seed = |seed: &u64| {
                let trials = results.sets[set].get(seed)?.get(point)?;
                mean(trials.iter().filter_map(|sample| sample.values[0]))
            };
            mean(seeds.iter().filter_map(of_seed)).unwrap_or(0.0)
        };
        self.grid((0..results.conditions.len()).map(of_point).collect())
    }

    /// A number of the success map: of all seeds together, with the interval of the difference over pairs of seeds.
    fn compare(&self, results: &Results, number: impl Fn(&Grid) -> f64) -> Comparison {
        let all = |set: usize| results.sets[set].keys().copied().collect::<Vec<u64>>();
        let pooled = |set: usize| {
            let seeds = all(set);
            let mean = number(&self.success(results, set, &seeds));
            (!seeds.is_empty()).then_some(Spread { mean, sd: None, seeds: seeds.len() })
        };
        // Resampling re-reads the maps often: keep every seed's own.
        let common = results.common_seeds();
        let maps: Vec<[Vec<f64>; 2]> = common
            .iter()
            .map(|seed| [0, 1].map(|set| self.success(results, set, std::slice::from_ref(seed)).values))
            .collect();
        let of_resample = |chosen: &[usize], set: usize| {
            let points = 0..results.conditions.len();
            let values = points.map(|p| chosen.iter().map(|s| maps[*s][set][p]).sum::<f64>() / chosen.len() as f64);
            number(&self.grid(values.collect()))
        };
        let both = |chosen: &[usize]| (!chosen.is_empty()).then(|| [0, 1].map(|set| of_resample(chosen, set)));
        Comparison {
            a: PerSeed::new(),
            b: PerSeed::new(),
            a_spread: pooled(0),
            b_spread: pooled(1),
            difference: estimate(common.len(), |chosen| both(chosen).map(|[a, b]| a - b)),
            relative: None,
            trials: None,
            members: results.members(),
        }
    }

    /// The same number for each seed alone.
    fn compare_by_seed(&self, results: &Results, number: impl Fn(&Grid) -> f64) -> Comparison {
        let by_seed = |set: usize| {
            let seeds = results.sets[set].keys();
            seeds.map(|seed| (*seed, number(&self.success(results, set, &[*seed])))).collect()
        };
        Comparison::new(by_seed(0), by_seed(1), results.members())
    }
}

impl Experiment for PushGrid {
    fn info(&self) -> Info {
        Info {
            id: "E1",
            number: 1,
            name: "push-grid",
            title: "Push recovery",
            paper: "Fig. 2",
            method: "Walking at 0.5 m/s, the robot is pushed once: a velocity offset on a square grid of (forward, \
                     left) is added to its trunk. A trial succeeds if it has not fallen until some seconds after. \
                     Success is averaged over the trials of all seeds; the share counts grid points at or above the \
                     contour's level.",
        }
    }

    fn quantities(&self) -> &'static [Quantity] {
        const { &[SUCCESS] }
    }

    fn trials(&self) -> u32 {
        self.trials
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let base: PushAway = defaults("push")?;
        let coordinates = grid::coordinates(self.limit_m_s, self.points_per_side);
        let condition = |forward: f64, left: f64| Condition {
            label: format!("{forward:+.3}, {left:+.3} m/s").replace('-', "−"),
            scenario: Scenario::Push(PushAway {
                push_m_s: forward.hypot(left),
                direction_deg: left.atan2(forward).to_degrees(),
                at_s: self.at_s,
                task: Task { duration_s: self.at_s + PHASE_S + self.watch_s, ..base.task.clone() },
                ..base
            }),
        };
        Ok(coordinates
            .iter()
            .flat_map(|forward| coordinates.iter().map(move |left| (*forward, *left)))
            .map(|(forward, left)| condition(forward, left))
            .collect())
    }

    fn measure(&self, _: &Scenario, script: &Script, trace: &Trace, end: End) -> Measured {
        let until_s = script.pushes.first().map_or(script.duration_s, |push| push.time_s + self.watch_s);
        let fell = trace.fall().is_some_and(|fall| fall.time_s <= until_s);
        let success = !fell && end != End::Fault;
        Measured { values: vec![truth(success)], series: Vec::new() }
    }

    fn findings(&self, results: &Results) -> Findings {
        let share = |grid: &Grid| grid.share_at_least(self.level);
        let overall = |grid: &Grid| mean(grid.values.iter().copied()).unwrap_or(0.0);
        let pooled = self.compare(results, share);
        let row = |quantity, paper: &str, comparison| Row {
            condition: String::new(),
            quantity,
            paper: paper.to_owned(),
            comparison,
        };
        let rows = vec![
            row(SHARE, "78 / 73", pooled.clone()),
            row(SHARE_BY_SEED, "", self.compare_by_seed(results, share)),
            row(MEAN_SUCCESS, "", self.compare_by_seed(results, overall)),
        ];
        let level = 100.0 * self.level;
        let caption = format!("Push recovery: share of grid points with at least {level:.0} % success.");
        let summary = Table { name: "push-grid".into(), caption, rows, in_page: true };
        let mut every = Table::of_conditions(
            "push-grid-points",
            "Success at every grid point (forward, left).",
            results,
            &["success"],
        );
        every.in_page = false;

        let maps = [0, 1].map(|set| {
            let seeds: Vec<u64> = results.sets[set].keys().copied().collect();
            self.success(results, set, &seeds)
        });
        let map = |set: usize| Map {
            title: format!("{}: {:.1} % of grid points", results.names[set], 100.0 * share(&maps[set])),
            grid: &maps[set],
        };
        let svg = heatmap::draw(
            "Success after a push, by the push's forward and left part",
            [map(0), map(1)],
            self.level,
            ["forward push [m/s]", "push to the left [m/s]", "success [%]"],
        );
        let figure = Figure::new(
            "push-grid",
            format!(
                "Success after a push of given forward and left velocity while walking at 0.5 m/s, averaged over all \
                 seeds and trials. The line is the {level:.0} % contour; above each map, the share of grid points at or \
                 above {level:.0} %."
            ),
            svg,
        );
        let claim = Claim::direction(
            &format!("The {level:.0} % contour of push recovery encloses more of the grid for compliant policies"),
            "78 / 73 %",
            SHARE,
            Expected::Higher,
            pooled,
        );
        Findings { claims: vec![claim], tables: vec![summary, every], figures: vec![figure], ..Findings::default() }
    }
}
