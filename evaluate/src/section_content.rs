//! The content of an experiment's section of the report (claims, tables, figures), and numbers as text.

use serde::Serialize;

use super::Quantity;
use super::statistics::{Comparison, Expected, IntervalEstimate, Numbers, Spread, Trials, Verdict};

/// The claims, tables, figures and notes of an experiment.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SectionContent {
    pub claims: Vec<Claim>,
    pub tables: Vec<Table>,
    pub figures: Vec<Figure>,
    /// The points of figures that are in no table.
    pub lines: Vec<Lines>,
    pub notes: Vec<String>,
}

/// A statement about two sets of policies, in most cases one of the paper.
#[derive(Debug, Clone, PartialEq)]
pub struct Claim {
    pub text: String,
    /// The paper's numbers, if it gives any.
    pub paper: String,
    pub quantity: Quantity,
    pub comparison: Comparison,
    pub verdict: Verdict,
}

impl Claim {
    /// Creates a claim that the first set's number is higher or lower than the second's.
    pub fn new(text: &str, paper: &str, quantity: Quantity, expected: Expected, comparison: Comparison) -> Self {
        let verdict = Verdict::new(&comparison, expected);
        Claim { text: text.to_owned(), paper: paper.to_owned(), quantity, comparison, verdict }
    }

    /// Creates a claim that the numbers of both sets are below a bound.
    pub fn below(bound: f64, text: String, paper: &str, quantity: Quantity, comparison: Comparison) -> Self {
        let verdict = Verdict::from_bound(bound, &comparison);
        Claim { text, paper: paper.to_owned(), quantity, comparison, verdict }
    }
}

/// A row of a table.
#[derive(Debug, Clone, PartialEq)]
pub struct Row {
    /// The condition; empty if nothing was varied.
    pub condition: String,
    pub quantity: Quantity,
    /// The paper's numbers, compliant / baseline; empty if it gives none.
    pub paper: String,
    pub comparison: Comparison,
}

impl Row {
    /// Creates a row for which the paper has no numbers.
    pub fn new(condition: impl Into<String>, quantity: Quantity, comparison: Comparison) -> Self {
        Row { condition: condition.into(), quantity, paper: String::new(), comparison }
    }
}

/// A table of the report.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    /// The file name without extension.
    pub name: String,
    pub caption: String,
    pub rows: Vec<Row>,
    /// True if the table is in the report's page, false if it is only in a file.
    pub in_page: bool,
}

impl Table {
    /// Creates a table.
    pub fn new(name: impl Into<String>, caption: &str, rows: Vec<Row>, in_page: bool) -> Self {
        Table { name: name.into(), caption: caption.to_owned(), rows, in_page }
    }

    /// Sets the paper's numbers in the rows of a quantity.
    pub fn set_paper(&mut self, quantity: &str, paper: &str) {
        let rows = self.rows.iter_mut().filter(|row| row.quantity.name == quantity);
        rows.for_each(|row| row.paper = paper.to_owned());
    }
}

/// A figure of the report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// The file name without extension.
    pub name: String,
    pub caption: String,
    pub svg: String,
}

/// The lines of a figure as points, for readers who draw it anew.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Lines {
    /// The file name without extension.
    pub name: String,
    pub columns: Vec<&'static str>,
    pub lines: Vec<Line>,
}

/// A line of a figure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Line {
    /// The label: condition, set, seed and number of runs.
    pub label: String,
    /// The points of the line, one number for each column.
    pub rows: Vec<Vec<f64>>,
}

/// The text of a cell without a number.
pub const NOTHING: &str = "–";

/// Returns a value as text in its quantity's printed unit and digits, without the unit; huge ones have an exponent.
pub fn number(value: f64, quantity: Quantity) -> String {
    let value = quantity.scale() * value;
    if value.abs() >= 1e7 {
        return format!("{value:.2e}").replace('-', "−");
    }
    let text = format!("{value:.*}", quantity.digits);
    // A value that is rounded to zero has no minus sign.
    let text = if is_zero(&text) { text.trim_start_matches('-').to_owned() } else { text };
    text.replace('-', "−")
}

/// Returns true if a printed number has no digit other than zero.
fn is_zero(text: &str) -> bool {
    !text.contains(|c: char| ('1'..='9').contains(&c))
}

/// Returns mean ± standard deviation, followed by `unit` and, if some seeds of the set have no number, how many have one.
pub fn spread(numbers: &Numbers, quantity: Quantity, unit: &str) -> String {
    let members = numbers.members;
    let Some(Spread { mean, sd, seeds }) = numbers.spread else { return NOTHING.to_owned() };
    let deviation = sd.map_or(String::new(), |sd| format!(" ± {}", number(sd, quantity)));
    let missing = if seeds < members { format!(" ({seeds} of {members} seeds)") } else { String::new() };
    format!("{}{deviation}{unit}{missing}", number(mean, quantity))
}

/// Returns the difference of a comparison, followed by `unit` and, if some seeds or trials are missing, how many it uses.
pub fn difference(comparison: &Comparison, quantity: Quantity, unit: &str) -> String {
    // Differences of percentages have a digit after the point, so that small ones do not look like zero.
    let digits = if quantity.unit == "%" { quantity.digits.max(1) } else { quantity.digits };
    let members: Vec<usize> = comparison.pair().iter().map(|set| set.members).collect();
    let text = estimate(comparison.difference, Quantity { digits, ..quantity }, &members, unit);
    match comparison.trials.filter(|trials| trials.used < trials.of) {
        Some(Trials { used, of }) => format!("{text} ({used} of {of} trials)"),
        None => text,
    }
}

/// Returns a signed number with its interval, followed by `unit` and, if some seeds are missing, the number of pairs.
fn estimate(estimate: Option<IntervalEstimate>, quantity: Quantity, members: &[usize], unit: &str) -> String {
    let Some(IntervalEstimate { value, interval, pairs }) = estimate else { return NOTHING.to_owned() };
    let signed = |value: f64| {
        let text = number(value, quantity);
        if value > 0.0 && !is_zero(&text) { format!("+{text}") } else { text }
    };
    let interval = interval.map_or(String::new(), |[low, high]| format!(" [{}, {}]", signed(low), signed(high)));
    let plural = if pairs == 1 { "" } else { "s" };
    let missing =
        if members.iter().any(|all| pairs < *all) { format!(" ({pairs} pair{plural})") } else { String::new() };
    format!("{}{interval}{unit}{missing}", signed(value))
}

/// Returns a relative change in percent with its interval, followed by `unit`.
pub fn percent(relative: Option<IntervalEstimate>, unit: &str) -> String {
    // The difference already states the number of pairs.
    estimate(relative, Quantity::new("relative", "relative change", "%", 0), &[], unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_digits_of_their_quantity() {
        let metres = Quantity::new("x", "x", "m", 2);
        assert_eq!(number(-1.234, metres), "−1.23");
        assert_eq!(number(-0.001, metres), "0.00");
        assert_eq!(number(-1.5e300, metres), "−1.50e300");
        assert_eq!(number(0.785, Quantity::new("x", "x", "%", 0)), "78");
    }

    #[test]
    fn cells_say_how_many_seeds_are_missing() {
        let watts = Quantity::new("power_w", "power", "W", 1);
        let of = |spread| Numbers { by_seed: [].into(), spread, members: 5 };
        let cell = |seeds, sd| spread(&of(Some(Spread { mean: 140.9, sd, seeds })), watts, " W");
        assert_eq!(cell(5, Some(17.0)), "140.9 ± 17.0 W");
        assert_eq!(cell(1, None), "140.9 W (1 of 5 seeds)");
        assert_eq!(spread(&of(None), watts, " W"), "–");
    }

    #[test]
    fn estimates_are_signed() {
        let metres = Quantity::new("x", "x", "m", 1);
        let found =
            |value, interval, pairs| estimate(Some(IntervalEstimate { value, interval, pairs }), metres, &[5, 6], "");
        assert_eq!(found(0.5, Some([-0.2, 1.2]), 6), "+0.5 [−0.2, +1.2]");
        assert_eq!(found(0.04, None, 5), "0.0 (5 pairs)");
    }
}
