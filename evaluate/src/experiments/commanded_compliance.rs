//! E13: the measured compliance against the commanded one (docs/compliance.md).

use super::prelude::*;
use super::push;
use crate::plot::curves::{self, Curve};
use crate::plot::polar::evenly;
use crate::results::Results;
use crate::section_content::{Claim, Row, Table};
use crate::statistics::{Comparison, PerSeed, Spread, Verdict, mean};
use supple::scenario::catalog::{Leash, PushAway};

/// The measured compliance; a condition has the commanded one.
const MEASURED: Quantity = Quantity::new("compliance_m_s_per_n", "compliance", "m/s/N", 4);

const QUANTITIES: &[Quantity] = &[MEASURED, push::TO_10, push::CARRIED, FELL];

/// The numbers of the line that is fitted to the measured over the commanded compliance.
const LINE: [Quantity; 4] = [
    Quantity::new("slope", "slope", "", 2),
    Quantity::new("intercept_m_s_per_n", "intercept", "m/s/N", 4),
    Quantity::new("r_squared", "R²", "", 3),
    Quantity::new(SLOPE_ERROR, "slope, distance from 1", "", 2),
];

/// The name of the quantity in the claims: the distance of the slope from 1.
const SLOPE_ERROR: &str = "slope_error";

/// The largest distance of the slope from 1 at which a policy yields as commanded.
const SLOPE_BOUND: f64 = 0.1;

/// The largest velocity that a pull may cause \[m/s\]; stronger pulls would test the robot's speed, not its compliance.
const LARGEST_ERROR_M_S: f64 = 0.5;

/// The experiment's section of the protocol.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandedCompliance {
    /// The commanded compliances \[m/s/N\].
    pub compliances: Vec<f64>,
    /// The forward commands \[m/s\]; 0 is standing.
    pub commands_m_s: Vec<f64>,
    /// The number of directions, which divide the circle evenly.
    pub directions: u32,
    /// The pulling forces \[N\].
    pub forces_n: Vec<f64>,
    /// The number of trials of each policy in each condition.
    pub trials: u32,
    /// The earliest start of the pull \[s\]; each trial delays it by up to 0.65 s.
    pub at_s: f64,
    /// The length of the pull \[s\].
    pub for_s: f64,
    /// The length of the averaging window at the end of the pull \[s\].
    pub average_s: f64,
}

/// Returns the compliance commanded in a condition [m/s/N] and the pull \[N\], if there are any.
fn commanded(condition: &Condition) -> (Option<f64>, Option<f64>) {
    let force = match &condition.scenario {
        Scenario::Leash(leash) => Some(leash.force_n),
        _ => None,
    };
    (condition.scenario.task().compliance, force)
}

/// Returns (slope, intercept, R²) of the least-squares line through points (x, y).
fn line(points: &[[f64; 2]]) -> Option<[f64; 3]> {
    let of = |axis: usize| mean(points.iter().map(|point| point[axis]));
    let [x, y] = [of(0)?, of(1)?];
    let sum = |of: &dyn Fn(&[f64; 2]) -> f64| points.iter().map(of).sum::<f64>();
    let (xx, xy) = (sum(&|p| (p[0] - x).powi(2)), sum(&|p| (p[0] - x) * (p[1] - y)));
    let yy = sum(&|p| (p[1] - y).powi(2));
    (xx > 0.0 && yy > 0.0).then(|| [xy / xx, y - xy / xx * x, xy * xy / (xx * yy)])
}

impl CommandedCompliance {
    /// Returns the indices of the conditions with a pull at one forward command.
    fn pulls(&self, command: usize) -> std::ops::Range<usize> {
        let count = self.compliances.len() * self.forces_n.len() * self.directions as usize;
        command * count..(command + 1) * count
    }

    /// Returns each number of [`LINE`] by seed, for the policies of a set at one forward command.
    fn lines(&self, results: &Results, set: usize, command: usize) -> Vec<PerSeed> {
        let mut lines = vec![PerSeed::new(); LINE.len()];
        for seed in results.sets[set].keys() {
            let point = |sides: &[usize]| {
                let (c, force) = commanded(&results.conditions[*sides.first()?]);
                let c = c?;
                let of = |condition: &usize| results.per_seed(set, *condition, MEASURED.name).get(seed).copied();
                let measured: Option<Vec<f64>> = sides.iter().map(of).collect();
                (c * force? <= LARGEST_ERROR_M_S + 1e-9).then_some([c, mean(measured?.into_iter())?])
            };
            let conditions: Vec<usize> = self.pulls(command).collect();
            let points: Vec<[f64; 2]> = conditions.chunks(self.directions as usize).filter_map(point).collect();
            let Some([slope, intercept, r_squared]) = line(&points) else { continue };
            for (numbers, number) in lines.iter_mut().zip([slope, intercept, r_squared, (slope - 1.0).abs()]) {
                numbers.insert(*seed, number);
            }
        }
        lines
    }

    /// Returns the measured over the commanded compliance of a set: (commanded, mean over policies, least and largest over
    /// directions and forces).
    fn curve(&self, results: &Results, set: usize, command: usize) -> Vec<[f64; 4]> {
        let of = |c: &f64| {
            let at = self.pulls(command).filter(|condition| {
                let (compliance, force) = commanded(&results.conditions[*condition]);
                compliance == Some(*c) && force.is_some_and(|force| c * force <= LARGEST_ERROR_M_S + 1e-9)
            });
            let spread = |condition| Spread::from_values(&results.per_seed(set, condition, MEASURED.name));
            let means: Vec<f64> = at.filter_map(spread).map(|spread| spread.mean).collect();
            let least = means.iter().copied().reduce(f64::min)?;
            let largest = means.iter().copied().reduce(f64::max)?;
            Some([*c, mean(means.iter().copied())?, least, largest])
        };
        self.compliances.iter().filter_map(of).collect()
    }
}

impl Experiment for CommandedCompliance {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            id: "E13",
            number: 14,
            name: "calibration",
            title: "Compliance as commanded",
            paper: "not in the paper",
            method: "The robot has a commanded compliance, standing and walking at 0.5 m/s, and is pulled by constant \
                     horizontal forces from all around. The compliance is the mean of (v − v*)·F/|F|² over the last \
                     seconds of the pull. Lines are fitted to each policy's means over all directions, over the \
                     commanded compliance c and the forces F, as far as c·F is at most 0.5 m/s: no robot is pulled \
                     faster than it can walk. With the same commands, it is also pushed to the left by 0.5 m/s: an \
                     ideal robot takes 2.3·m·c until a tenth of the push is left.",
            quantities: QUANTITIES,
            trials: self.trials,
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let (leash, push): (Leash, PushAway) = (defaults("leash")?, defaults("push")?);
        let mut conditions = Vec::new();
        for command in &self.commands_m_s {
            for compliance in &self.compliances {
                for force_n in &self.forces_n {
                    for direction_deg in evenly(self.directions) {
                        let task = Task {
                            forward_m_s: *command,
                            compliance: Some(*compliance),
                            duration_s: self.at_s + self.for_s,
                            ..leash.task.clone()
                        };
                        conditions.push(Condition {
                            label: format!("{}, c = {compliance}, {force_n} N, {direction_deg:.0}°", gait(*command)),
                            scenario: Scenario::Leash(Leash {
                                task,
                                force_n: *force_n,
                                direction_deg,
                                at_s: self.at_s,
                                for_s: self.for_s,
                            }),
                        });
                    }
                }
            }
        }
        conditions.extend(self.compliances.iter().map(|compliance| Condition {
            label: format!("pushed, c = {compliance}"),
            scenario: Scenario::Push(PushAway {
                task: Task { compliance: Some(*compliance), ..push.task.clone() },
                ..push.clone()
            }),
        }));
        Ok(conditions)
    }

    fn check(&self) -> Result<(), ParameterError> {
        in_range("for_s", self.for_s, 0.1, 60.0, "0.1 to 60 s")?;
        in_range("average_s", self.average_s, 0.1, self.for_s, "0.1 s to calibration.for_s")?;
        check_directions(self.directions)
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let mut values = vec![None, None, None, trial.end.fell()];
        if let (true, Some(pull)) = (trial.is_upright(), trial.script.pull) {
            let (from_s, until_s) = (pull.until_s - self.average_s, pull.until_s);
            let offset = metrics::offset_along_force(trial.trace, pull.force, from_s, until_s);
            values[0] = offset.map(|offset| offset / pull.force[0].hypot(pull.force[1]));
        }
        if let Some(pushed) = push::upright_push(trial) {
            let [to_10, _, carried, _] = push::decay(trial.trace, pushed.time_s, pushed.push.linear);
            (values[1], values[2]) = (to_10, carried);
        }
        values.into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        let results = section.results;
        let (mut rows, mut panels) = (Vec::new(), Vec::new());
        for (command, speed) in self.commands_m_s.iter().enumerate() {
            let lines = section.by_set(|set| self.lines(results, set, command));
            for (k, quantity) in LINE.iter().enumerate() {
                let numbers = |set: usize| results.numbers(set, lines[set][k].clone());
                let comparison = Comparison::new(section.by_set(numbers));
                let (condition, paper) = (gait(*speed).to_owned(), String::new());
                rows.push(Row { condition, quantity: *quantity, paper, comparison: comparison.clone() });
                if quantity.name != SLOPE_ERROR {
                    continue;
                }
                let text = format!(
                    "With a commanded compliance while {}, both sets yield as commanded: the slope of measured over \
                     commanded compliance is within {SLOPE_BOUND} of 1",
                    gait(*speed)
                );
                let verdict = Verdict::from_bound(SLOPE_BOUND, &comparison);
                let (paper, quantity) = (format!("none; ours: < {SLOPE_BOUND}"), *quantity);
                section.content.claims.push(Claim { text, paper, quantity, comparison, verdict });
            }
            for (set, name) in results.names.iter().enumerate() {
                panels.push(Curve {
                    title: format!("{name}, {}", gait(*speed)),
                    points: self.curve(results, set, command),
                    diagonal: true,
                    set,
                    ..Curve::default()
                });
            }
        }
        let name = format!("{}-lines", self.info().name);
        let caption = "Lines fitted to the measured over the commanded compliance.".to_owned();
        section.content.tables.push(Table { name, caption, rows, in_page: true });
        let pushed: Vec<usize> = (self.pulls(self.commands_m_s.len()).start..results.conditions.len()).collect();
        let pushes: Vec<ConditionGroup> = pushed
            .iter()
            .map(|index| ConditionGroup { name: results.conditions[*index].label.clone(), conditions: vec![*index] })
            .collect();
        let rows = pushes.iter().flat_map(|group| [push::TO_10, push::CARRIED].map(|it| section.row(group, it)));
        let rows: Vec<Row> = rows.collect();
        section.table_with_rows("A sideways push of 0.5 m/s, by commanded compliance.", rows);
        section.table_in_file("all", "Compliance by command, commanded compliance, force and direction.");
        let words = ["commanded compliance [m/s/N]", "measured [m/s/N]"];
        let svg = curves::draw("Measured over commanded compliance", &panels, words[0], words[1]);
        section.figure(
            "",
            "Measured over commanded compliance: mean over policies, directions and forces, and the band between the \
             direction and force with the least and that with the largest. Dashed: the commanded compliance.",
            svg,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exact_line_has_a_fit_of_one() {
        let [slope, intercept, r_squared] = line(&[[0.0, 1.0], [1.0, 3.0], [2.0, 5.0]]).unwrap();
        assert!((slope - 2.0).abs() < 1e-12 && (intercept - 1.0).abs() < 1e-12 && (r_squared - 1.0).abs() < 1e-12);
        // Deviations of ±1 about a line of slope 1 through 0, 2, 4, 6 (x 0 to 6 by 2, y 1, 1, 5, 5): xx = 20, xy = 16, yy = 16.
        let [slope, _, r_squared] = line(&[[0.0, 1.0], [2.0, 1.0], [4.0, 5.0], [6.0, 5.0]]).unwrap();
        assert!((slope - 0.8).abs() < 1e-12 && (r_squared - 256.0 / 320.0).abs() < 1e-12);
        assert_eq!(line(&[[1.0, 1.0], [1.0, 2.0]]), None);
    }
}
