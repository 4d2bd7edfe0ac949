//! What an experiment shows: claims of the paper with our numbers, tables and figures.

use serde::Serialize;

use super::Quantity;
use super::statistics::{Comparison, Expected, IntervalEstimate, Numbers, Spread, Trials, Verdict};

/// Everything that an experiment shows.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SectionContent {
    /// The claims of the paper, each with a verdict.
    pub claims: Vec<Claim>,
    /// Numbers.
    pub tables: Vec<Table>,
    /// Drawings.
    pub figures: Vec<Figure>,
    /// Points of what figures draw and no table has.
    pub lines: Vec<Lines>,
    /// Notes about the numbers of this run.
    pub notes: Vec<String>,
}

/// A statement of the paper.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Claim {
    /// The claim in our words.
    pub text: String,
    /// The paper's numbers, if it gives any.
    pub paper: String,
    /// The quantity that is compared.
    pub quantity: Quantity,
    /// Our numbers.
    pub comparison: Comparison,
    /// The verdict of the numbers.
    pub verdict: Verdict,
}

impl Claim {
    /// That the first set lies above or below the second.
    pub fn new(text: &str, paper: &str, quantity: Quantity, expected: Expected, comparison: Comparison) -> Self {
        let verdict = Verdict::new(&comparison, expected);
        Claim { text: text.to_owned(), paper: paper.to_owned(), quantity, comparison, verdict }
    }
}

/// A line of a table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// The condition; empty if nothing was varied.
    pub condition: String,
    /// The measured quantity.
    pub quantity: Quantity,
    /// The paper's numbers, first set / second set; empty if it gives none.
    pub paper: String,
    /// Ours.
    pub comparison: Comparison,
}

/// A table.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Table {
    /// File name without extension.
    pub name: String,
    /// The caption of the table.
    pub caption: String,
    /// The rows from top to bottom.
    pub rows: Vec<Row>,
    /// True if the table is part of the report's page; false if it is only in the files beside it.
    pub in_page: bool,
}

impl Table {
    /// States the paper's numbers in the rows of a quantity.
    pub fn set_paper(&mut self, quantity: &str, paper: &str) {
        let rows = self.rows.iter_mut().filter(|row| row.quantity.name == quantity);
        rows.for_each(|row| row.paper = paper.to_owned());
    }
}

/// A drawing.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Figure {
    /// File name without extension.
    pub name: String,
    /// The caption of the figure.
    pub caption: String,
    /// The drawing.
    pub svg: String,
}

/// Lines of a figure as points, to draw it anew.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Lines {
    /// File name without extension.
    pub name: String,
    /// The names of the numbers of a point, with units.
    pub columns: Vec<&'static str>,
    /// The lines in drawing order.
    pub lines: Vec<Line>,
}

/// One of them.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Line {
    /// Whose it is.
    pub label: String,
    /// The points of the line, one number for each column.
    pub rows: Vec<Vec<f64>>,
}

/// The content of a cell without a number.
pub const NOTHING: &str = "–";

/// A number in its quantity's unit and digits, without the unit.
pub fn number(value: f64, quantity: Quantity) -> String {
    let text = format!("{:.*}", quantity.digits, quantity.scale() * value);
    // No minus before a rounded zero.
    let text = if is_zero(&text) { text.trim_start_matches('-').to_owned() } else { text };
    text.replace('-', "−")
}

/// Returns true if a printed number has no digit other than zero.
fn is_zero(text: &str) -> bool {
    !text.contains(|c: char| ('1'..='9').contains(&c))
}

/// Mean ± standard deviation, followed by `unit`; says so if not all of a set's seeds have the number.
pub fn spread(numbers: &Numbers, quantity: Quantity, unit: &str) -> String {
    let members = numbers.members;
    let Some(Spread { mean, sd, seeds }) = numbers.spread else { return NOTHING.to_owned() };
    let deviation = sd.map_or(String::new(), |sd| format!(" ± {}", number(sd, quantity)));
    let missing = if seeds < members { format!(" ({seeds} of {members} seeds)") } else { String::new() };
    format!("{}{deviation}{unit}{missing}", number(mean, quantity))
}

/// The difference of a comparison, followed by `unit`; says so if not all of the seeds or trials are in it.
pub fn difference(comparison: &Comparison, quantity: Quantity, unit: &str) -> String {
    // Points of a percentage: what is not zero is not to read as zero.
    let digits = if quantity.unit == "%" { quantity.digits.max(1) } else { quantity.digits };
    let members: Vec<usize> = comparison.pair().iter().map(|set| set.members).collect();
    let text = estimate(comparison.difference, Quantity { digits, ..quantity }, &members, unit);
    match comparison.trials.filter(|trials| trials.used < trials.of) {
        Some(Trials { used, of }) => format!("{text} ({used} of {of} trials)"),
        None => text,
    }
}

/// A signed number with its interval, followed by `unit`; says so if not all of the seeds are in it.
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

/// A relative change with its interval, followed by `unit`.
pub fn percent(relative: Option<IntervalEstimate>, unit: &str) -> String {
    // How many pairs are in it stands beside the difference.
    estimate(relative, Quantity::new("relative", "relative change", "%", 0), &[], unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_their_quantitys_digits_and_a_real_minus() {
        let metres = Quantity::new("x", "x", "m", 2);
        assert_eq!(number(-1.234, metres), "−1.23");
        assert_eq!(number(-0.001, metres), "0.00");
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
