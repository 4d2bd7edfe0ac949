//! Tables as CSV: one line for each condition and quantity, with numbers in the unit of that line.

use super::Report;
use crate::section_content::{Lines, Table};
use crate::statistics::{Comparison, IntervalEstimate};

/// Returns a table as CSV.
pub fn csv(table: &Table, names: &[String]) -> String {
    let head = strings(["condition", "quantity", "unit", "paper"]).chain(header(names)).collect();
    let rows = table.rows.iter().map(|row| {
        let cells = strings([&row.condition, row.quantity.name, row.quantity.unit, &row.paper]);
        cells.chain(numbers(&row.comparison.scaled(row.quantity.scale()))).collect()
    });
    written(head, rows)
}

/// Returns the lines of a figure as CSV, one row for each point.
pub fn points_csv(lines: &Lines) -> String {
    let head = strings(["line"]).chain(lines.columns.iter().map(|column| (*column).to_owned())).collect();
    let points = lines.lines.iter().flat_map(|line| {
        line.rows.iter().map(|row| strings([&*line.label]).chain(row.iter().map(|value| cell(Some(*value)))).collect())
    });
    written(head, points)
}

/// Returns the claims of all experiments as CSV.
pub fn claims_csv(report: &Report) -> String {
    let head = strings(["experiment", "claim", "paper", "quantity", "unit"]);
    let head = head.chain(header(&report.names)).chain(strings(["verdict"])).collect();
    let rows = report.sections.iter().flat_map(|section| {
        section.content.claims.iter().map(|claim| {
            let quantity = claim.quantity;
            let cells = strings([section.info.id, &claim.text, &claim.paper, quantity.name, quantity.unit]);
            let numbers = numbers(&claim.comparison.scaled(quantity.scale()));
            cells.chain(numbers).chain(strings([claim.verdict.text()])).collect()
        })
    });
    written(head, rows)
}

fn written(head: Vec<String>, rows: impl Iterator<Item = Vec<String>>) -> String {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in std::iter::once(head).chain(rows) {
        // Into memory, rows of one length: this cannot fail.
        let _ = writer.write_record(row);
    }
    String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
}

fn strings<const N: usize>(texts: [&str; N]) -> impl Iterator<Item = String> {
    texts.map(str::to_owned).into_iter()
}

fn header(names: &[String]) -> impl Iterator<Item = String> {
    let sets = names.iter().flat_map(|name| {
        let name = name.replace([',', '"'], "_");
        ["mean", "sd", "seeds"].map(|what| format!("{name}_{what}"))
    });
    sets.chain(strings(["pairs", "trials_used", "trials", "difference", "difference_low", "difference_high"]))
        .chain(strings(["relative", "relative_low", "relative_high"]))
}

/// Returns the cells of a comparison. A relative change is 0.1 for 10 %.
fn numbers(comparison: &Comparison) -> Vec<String> {
    let mut cells = Vec::new();
    for spread in comparison.sets.iter().map(|set| set.spread) {
        cells.push(cell(spread.map(|spread| spread.mean)));
        cells.push(cell(spread.and_then(|spread| spread.sd)));
        cells.push(spread.map_or(0, |spread| spread.seeds).to_string());
    }
    cells.push(comparison.difference.map_or(0, |difference| difference.pairs).to_string());
    for count in [comparison.trials.map(|trials| trials.used), comparison.trials.map(|trials| trials.of)] {
        cells.push(count.map_or(String::new(), |count| count.to_string()));
    }
    for estimate in [comparison.difference, comparison.relative] {
        let end = |index: usize| {
            estimate.and_then(|IntervalEstimate { interval, .. }| interval).map(|interval| interval[index])
        };
        cells.extend([cell(estimate.map(|estimate| estimate.value)), cell(end(0)), cell(end(1))]);
    }
    cells
}

fn cell(value: Option<f64>) -> String {
    value.map_or(String::new(), |value| format!("{value:.6}"))
}
