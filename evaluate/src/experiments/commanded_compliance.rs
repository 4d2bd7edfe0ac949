//! E13: the measured compliance against the commanded one (docs/compliance.md).

use std::collections::BTreeMap;

use super::prelude::*;
use super::push;
use crate::plot::curves::{self, Curve};
use crate::results::Results;
use crate::section_content::{Claim, Row};
use crate::statistics::{Comparison, PerSeed, Spread, Verdict, mean};
use crate::trial::TrialEnd;
use supple::robot::GRAVITY_M_S2;
use supple::scenario::catalog::{Leash, PushTrunk};

/// The measured compliance; a condition has the commanded one.
const MEASURED: Quantity = Quantity::new("compliance_m_s_per_n", "compliance", "m/s/N", 4);

/// The distance that a push carries the robot, over c·m·Δv.
const CARRIED_RATIO: Quantity = Quantity::new("carried_ratio", "carried, over c·m·Δv", "", 2);

const QUANTITIES: &[Quantity] = &[MEASURED, push::TO_10, push::CARRIED, CARRIED_RATIO, FELL];

/// The numbers of the line that is fitted to the measured over the commanded compliance.
const LINE: [Quantity; 5] = [
    Quantity::new("slope", "slope", "", 2),
    Quantity::new("intercept_m_s_per_n", "intercept", "m/s/N", 4),
    Quantity::new("r_squared", "R²", "", 3),
    SLOPE_ERROR,
    UNEXPLAINED,
];

/// The distance of the slope from 1, in claims.
const SLOPE_ERROR: Quantity = Quantity::new("slope_error", "slope, distance from 1", "", 2);

/// The part of the measured compliance's variance that the line leaves unexplained, in claims.
const UNEXPLAINED: Quantity = Quantity::new("unexplained", "1 − R²", "", 3);

/// The largest distances of the slope from 1 for a policy that yields as commanded: mean over directions, and one axis.
const SLOPE_BOUNDS: [f64; 2] = [0.05, 0.15];

/// The largest unexplained part of the variance for a policy that yields as commanded.
const UNEXPLAINED_BOUND: f64 = 0.02;

/// The directions over which the compliance of a setting is averaged.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Over {
    /// All directions alike.
    All,
    /// The compliance forward (0) or left (1).
    Axis(usize),
}

impl Over {
    /// Returns the compliance of a setting from its compliances along directions θ that divide the circle evenly. The forward and left
    /// compliances, a and b, are those of the least-squares fit of a cos² θ + b sin² θ.
    fn compliance(self, measured: &[f64]) -> Option<f64> {
        let Over::Axis(axis) = self else { return mean(measured.iter().copied()) };
        let parts = evenly(measured.len() as u32).into_iter().map(|side| side.to_radians().cos().powi(2));
        let (mut squares, mut product, mut sums) = ([0.0; 2], 0.0, [0.0; 2]);
        for (forward, value) in parts.zip(measured) {
            let parts = [forward, 1.0 - forward];
            product += parts[0] * parts[1];
            for (axis, part) in parts.into_iter().enumerate() {
                squares[axis] += part * part;
                sums[axis] += part * value;
            }
        }
        let determinant = squares[0] * squares[1] - product * product;
        let other = 1 - axis;
        (determinant > 1e-9).then(|| (sums[axis] * squares[other] - sums[other] * product) / determinant)
    }
}

/// The largest velocity that a pull may cause \[m/s\]; stronger pulls would test the robot's speed, not its compliance.
const LARGEST_ERROR_M_S: f64 = 0.5;

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CommandedCompliance {
    pub compliances: Vec<f64>,
    pub commands_m_s: Vec<f64>,
    pub directions: u32,
    pub forces_n: Vec<f64>,
    pub trials: u32,
    pub at_s: f64,
    pub for_s: f64,
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

/// Returns true for a condition whose pull is in the fit of a line.
fn is_fitted(condition: &Condition) -> bool {
    matches!(commanded(condition), (Some(c), Some(force)) if c * force <= LARGEST_ERROR_M_S + 1e-9)
}

impl CommandedCompliance {
    /// Returns the indices of the conditions with a pull at one forward command.
    fn pulls(&self, command: usize) -> std::ops::Range<usize> {
        let count = self.compliances.len() * self.forces_n.len() * self.directions as usize;
        command * count..(command + 1) * count
    }

    /// Returns true if a robot of the first two sets fell, or a trial of theirs failed, in the fit at one forward command. Such trials have
    /// no number, so the line omits them.
    fn fails_in_fit(&self, results: &Results, command: usize) -> bool {
        let fitted: Vec<usize> = self.pulls(command).filter(|pull| is_fitted(&results.conditions[*pull])).collect();
        let policies = results.sets.iter().take(2).flat_map(BTreeMap::values);
        let mut samples = policies.flat_map(|policy| fitted.iter().filter_map(move |pull| policy.get(*pull))).flatten();
        samples.any(|sample| matches!(sample.end, TrialEnd::Fell | TrialEnd::Fault))
    }

    /// Returns each number of [`LINE`] by seed, for the policies of a set at one forward command.
    fn lines(&self, results: &Results, set: usize, command: usize, over: Over) -> Vec<PerSeed> {
        let mut lines = vec![PerSeed::new(); LINE.len()];
        for seed in results.sets[set].keys() {
            let point = |sides: &[usize]| {
                let condition = &results.conditions[*sides.first()?];
                let c = commanded(condition).0?;
                let of = |condition: &usize| results.per_seed(set, *condition, MEASURED.name).get(seed).copied();
                let measured: Option<Vec<f64>> = sides.iter().map(of).collect();
                is_fitted(condition).then_some([c, over.compliance(&measured?)?])
            };
            let conditions: Vec<usize> = self.pulls(command).collect();
            let points: Vec<[f64; 2]> = conditions.chunks(self.directions as usize).filter_map(point).collect();
            let Some([slope, intercept, r_squared]) = line(&points) else { continue };
            let numbers = [slope, intercept, r_squared, (slope - 1.0).abs(), 1.0 - r_squared];
            for (line, number) in lines.iter_mut().zip(numbers) {
                line.insert(*seed, number);
            }
        }
        lines
    }

    /// Returns the measured over the commanded compliance of a set: (commanded, mean over policies, least and largest over
    /// directions and forces).
    fn curve(&self, results: &Results, set: usize, command: usize) -> Vec<[f64; 4]> {
        let of = |c: &f64| {
            let at = self.pulls(command).filter(|pull| {
                let condition = &results.conditions[*pull];
                commanded(condition).0 == Some(*c) && is_fitted(condition)
            });
            let spread = |condition| Spread::from_values(&results.per_seed(set, condition, MEASURED.name));
            curves::point(*c, &at.filter_map(spread).map(|spread| spread.mean).collect::<Vec<f64>>())
        };
        self.compliances.iter().filter_map(of).collect()
    }
}

impl Experiment for CommandedCompliance {
    fn info(&self) -> ExperimentInfo {
        ExperimentInfo {
            method: "The robot has a commanded compliance, standing and walking at 0.5 m/s, and is pulled by constant \
                     horizontal forces from all around. The compliance is the mean of (v − v*)·F/|F|² over the last \
                     seconds of the pull. For each policy, a line is fitted to the means over all directions against \
                     the commanded compliance c. Only pulls with c·F of at most 0.5 m/s count, so that no robot is \
                     pulled faster than it can walk. The forward and left compliances, a and b, are the best fit of a \
                     cos² θ + b sin² θ over all directions θ; they have their own lines. Walking with the same \
                     compliances, the robot is also pushed ahead and to the left by Δv = 0.5 m/s. The distance over \
                     which it is carried is that of two seconds; an ideal robot's is c·m·Δv in the end, and a tenth \
                     of the push is left after 2.3·m·c.",
            ..ExperimentInfo::new("E13", 14, "calibration", "Compliance as commanded", QUANTITIES, self.trials)
        }
    }

    fn conditions(&self) -> Result<Vec<Condition>, ConfigError> {
        let (leash, push): (Leash, PushTrunk) = (defaults("leash")?, defaults("push")?);
        let (at_s, for_s) = (self.at_s, self.for_s);
        let mut all = Vec::new();
        for (forward_m_s, c) in pairs(&self.commands_m_s, &self.compliances) {
            let task = Task { forward_m_s, compliance: Some(c), duration_s: at_s + for_s, ..leash.task.clone() };
            let label = format!("{}, c = {}", gait(forward_m_s), brief(c));
            let pulls = pairs(&self.forces_n, &evenly(self.directions));
            all.extend(conditions(pulls, |(force_n, direction_deg)| {
                let scenario = Leash { task: task.clone(), force_n, direction_deg, at_s, for_s, set_point_per_s: 0.0 };
                (format!("{label}, {} N, {direction_deg:.0}°", brief(force_n)), Scenario::Leash(scenario))
            }));
        }
        for (side, direction_deg) in [("ahead", 0.0), ("to the left", 90.0)] {
            all.extend(conditions(&self.compliances, |c| {
                let task = Task { compliance: Some(*c), ..push.task.clone() };
                let scenario = Scenario::Push(PushTrunk { task, direction_deg, ..push });
                (format!("pushed {side}, c = {}", brief(*c)), scenario)
            }));
        }
        Ok(all)
    }

    fn check(&self) -> Result<(), ParameterError> {
        in_range("for_s", self.for_s, 0.1, 60.0, "0.1 to 60 s")?;
        in_range("average_s", self.average_s, 0.1, self.for_s, "0.1 s to calibration.for_s")?;
        check_directions(self.directions)
    }

    fn measure(&self, trial: &Trial) -> TrialValues {
        let mut values = vec![None, None, None, None, trial.end.fell()];
        if let (true, Some(pull)) = (trial.is_upright(), trial.script.pull()) {
            let (from_s, until_s) = (pull.until_s - self.average_s, pull.until_s);
            let offset = metrics::offset_along_force(trial.trace, pull.force, from_s, until_s);
            values[0] = offset.map(|offset| offset / pull.force[0].hypot(pull.force[1]));
        }
        if let Some(pushed) = push::upright_push(trial) {
            let [to_10, _, carried, _] = push::decay(trial.trace, pushed.at_s, pushed.linear);
            (values[1], values[2]) = (to_10, carried);
            let momentum = trial.trace.weight_n / GRAVITY_M_S2 * pushed.linear[0].hypot(pushed.linear[1]);
            let ideal_m = trial.scenario.task().compliance.map(|compliance| compliance * momentum);
            values[3] = carried.zip(ideal_m).map(|(carried, ideal)| carried / ideal);
        }
        values.into()
    }

    fn report(&self, section: &mut SectionBuilder) {
        let results = section.results;
        let (mut rows, mut panels) = (Vec::new(), Vec::new());
        for (command, speed) in self.commands_m_s.iter().enumerate() {
            let fails = self.fails_in_fit(results, command);
            for (over, axis) in [(Over::All, ""), (Over::Axis(0), " forward"), (Over::Axis(1), " left")] {
                let lines = section.by_set(|set| self.lines(results, set, command, over));
                for (k, quantity) in LINE.into_iter().enumerate() {
                    let numbers = |set: usize| results.numbers(set, lines[set][k].clone());
                    let comparison = Comparison::new(section.by_set(numbers));
                    let condition = gait(*speed).to_owned() + &axis.replace(' ', ", ");
                    rows.push(Row::new(condition, quantity, comparison.clone()));
                    let bound = match (quantity, over) {
                        (SLOPE_ERROR, Over::All) => SLOPE_BOUNDS[0],
                        (SLOPE_ERROR, Over::Axis(_)) => SLOPE_BOUNDS[1],
                        (UNEXPLAINED, Over::All) => UNEXPLAINED_BOUND,
                        _ => continue,
                    };
                    let words = match quantity {
                        SLOPE_ERROR => "the slope of measured over commanded compliance differs from 1 by less than",
                        _ => "1 − R² is below",
                    };
                    let (when, yields) = ("With a commanded compliance while", "both sets yield");
                    let text = format!("{when} {}, {yields}{axis} as commanded: {words} {bound}", gait(*speed));
                    let claim = Claim::below(bound, text, "", quantity, comparison);
                    let verdict = if fails { Verdict::Fails } else { claim.verdict };
                    section.content.claims.push(Claim { verdict, ..claim });
                }
            }
            for (set, name) in results.names.iter().enumerate() {
                let mut samples = results.sets[set].values().flat_map(|policy| &policy[self.pulls(command)]).flatten();
                let if_empty = match samples.any(|sample| sample.end != TrialEnd::OutOfReach) {
                    true => "no pull without a fall",
                    false => "not played: not calibrated for these compliances",
                };
                let (title, points) = (format!("{name}, {}", gait(*speed)), self.curve(results, set, command));
                panels.push(Curve { title, points, diagonal: true, if_empty, set, ..Curve::default() });
            }
        }
        let caption =
            "Lines fitted to the measured over the commanded compliance: mean over all directions, forward and left.";
        section.add_table("lines", caption, rows, true);
        let each = section.each();
        let pushes = each[self.pulls(self.commands_m_s.len()).start..].iter();
        let rows =
            pushes.flat_map(|group| [push::TO_10, push::CARRIED, CARRIED_RATIO].map(|it| section.row(group, it)));
        let rows = rows.collect();
        section.table_with_rows("A push of 0.5 m/s ahead and to the left, by commanded compliance.", rows);
        section.table_in_file("all", "Compliance by command, commanded compliance, force and direction.");
        let words = ["commanded compliance [m/s/N]", "measured [m/s/N]"];
        let svg = curves::draw("Measured over commanded compliance", &panels, words[0], words[1]);
        section.figure(
            "",
            "Measured over commanded compliance: mean over policies, directions and forces, and the range over \
             directions and forces: a band, or a bar for a single compliance. Dashed: the commanded compliance. \
             Policies are not played beyond the compliances that they were calibrated for (policy calibrate).",
            svg,
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::Protocol;
    use crate::trial::Sample;

    #[test]
    fn axes_are_found_from_compliances_along_directions() {
        for directions in [3, 4, 12] {
            let along = |side: f64| 0.01 * side.to_radians().cos().powi(2) + 0.03 * side.to_radians().sin().powi(2);
            let measured: Vec<f64> = evenly(directions).into_iter().map(along).collect();
            let [forward, left] = [0, 1].map(|axis| Over::Axis(axis).compliance(&measured).unwrap());
            assert!((forward - 0.01).abs() < 1e-12 && (left - 0.03).abs() < 1e-12, "{forward} {left}");
            assert!((Over::All.compliance(&measured).unwrap() - 0.02).abs() < 1e-12);
        }
    }

    #[test]
    fn fall_in_the_fit_breaks_its_bounds() {
        let experiment = Protocol::quick().unwrap().calibration;
        let conditions = experiment.conditions().unwrap();
        let sample = |condition: &Condition| {
            let mut values = vec![None; QUANTITIES.len()];
            if let (compliance, Some(_)) = commanded(condition) {
                values[0] = compliance;
            }
            vec![Sample::new(TrialEnd::Upright, values)]
        };
        let policy: Vec<_> = conditions.iter().map(sample).collect();
        let sets = vec![BTreeMap::from([(0, policy)]); 2];
        let names = vec!["a".to_owned(), "b".to_owned()];
        let mut results = Results { names, conditions, quantities: QUANTITIES, sets };
        let verdicts = |results: &Results| -> Vec<Verdict> {
            experiment.content(results).claims.iter().map(|claim| claim.verdict).collect()
        };
        assert_eq!(verdicts(&results), [Verdict::Holds; 4]);
        // One of four directions is lost; the remaining points lie on the same line.
        let fallen = &mut results.sets[1].get_mut(&0).unwrap()[0][0];
        (fallen.end, fallen.values[0]) = (TrialEnd::Fell, None);
        assert_eq!(verdicts(&results), [Verdict::Fails; 4]);
    }

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
