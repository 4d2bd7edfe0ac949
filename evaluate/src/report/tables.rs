//! Tables as CSV: bare numbers in the units named beside them, one line for each condition and quantity.

use super::Report;
use crate::findings::{Lines, Table};
use crate::statistics::{Comparison, IntervalEstimate};

/// A table.
pub fn csv(table: &Table, names: &[String]) -> String {
    let mut text = format!("condition,quantity,unit,paper,{}\n", header(names));
    for row in &table.rows {
        let cells = [&row.condition, row.quantity.name, row.quantity.unit, &row.paper].map(quoted);
        text.push_str(&format!("{},{}\n", cells.join(","), numbers(&row.comparison.scaled(row.quantity.scale()))));
    }
    text
}

/// Lines of a figure, a point in each line of the file.
pub fn points_csv(lines: &Lines) -> String {
    let mut text = format!("line,{}\n", lines.columns.join(","));
    for line in &lines.lines {
        for row in &line.rows {
            let cells: Vec<String> = row.iter().map(|value| cell(Some(*value))).collect();
            text.push_str(&format!("{},{}\n", quoted(&line.label), cells.join(",")));
        }
    }
    text
}

/// The claims of all experiments.
pub fn claims_csv(report: &Report) -> String {
    let mut text = format!("experiment,claim,paper,quantity,unit,{},verdict\n", header(&report.names));
    for section in &report.sections {
        for claim in &section.findings.claims {
            let quantity = claim.quantity;
            let cells = [section.info.id, &claim.text, &claim.paper, quantity.name, quantity.unit].map(quoted);
            let numbers = numbers(&claim.comparison.scaled(quantity.scale()));
            text.push_str(&format!("{},{numbers},{}\n", cells.join(","), quoted(claim.verdict.text())));
        }
    }
    text
}

fn header(names: &[String]) -> String {
    let of = |name: &String| {
        let name = name.replace([',', '"'], "_");
        format!("{name}_mean,{name}_sd,{name}_seeds")
    };
    let sets: Vec<String> = names.iter().map(of).collect();
    format!(
        "{},pairs,trials_used,trials,difference,difference_low,difference_high,relative,relative_low,relative_high",
        sets.join(",")
    )
}

/// A relative change is 0.1 for 10 %.
fn numbers(comparison: &Comparison) -> String {
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
    cells.join(",")
}

fn cell(value: Option<f64>) -> String {
    value.map_or(String::new(), |value| format!("{value:.6}"))
}

fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.to_owned() }
}
