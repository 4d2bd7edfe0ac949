//! Tables as Markdown, and the document of all claims.

use super::{Report, duration};
use crate::evaluate::findings::{Claim, Row, Table, difference, percent, spread};

/// Cells of a row: condition, quantity, the paper's numbers, ours.
pub fn cells(row: &Row) -> [String; 7] {
    let c = &row.comparison;
    [
        row.condition.clone(),
        row.quantity.axis(),
        row.paper.clone(),
        spread(c.a_spread, row.quantity, c.members[0], ""),
        spread(c.b_spread, row.quantity, c.members[1], ""),
        difference(c, row.quantity, ""),
        if row.quantity.unit == "%" { String::new() } else { percent(c.relative, "") },
    ]
}

/// Titles of these columns.
pub fn columns(names: &[String; 2]) -> [String; 7] {
    let paper = "paper (compliant / baseline)".to_owned();
    let fixed = ["condition", "quantity"].map(ToOwned::to_owned);
    let [condition, quantity] = fixed;
    let (a, b) = (names[0].clone(), names[1].clone());
    [condition, quantity, paper, a, b, "difference [95 % interval]".into(), "relative [%]".into()]
}

/// Cells of a claim: what the paper says, its numbers, ours, the verdict.
pub fn claim_cells(claim: &Claim) -> [String; 7] {
    let (c, quantity) = (&claim.comparison, claim.quantity);
    let unit = if quantity.unit.is_empty() { String::new() } else { format!(" {}", quantity.unit) };
    // The difference of two shares is not a share.
    let unit_of_difference = unit.replace('%', "points");
    [
        claim.text.clone(),
        claim.paper.clone(),
        spread(c.a_spread, quantity, c.members[0], &unit),
        spread(c.b_spread, quantity, c.members[1], &unit),
        difference(c, quantity, &unit_of_difference),
        if quantity.unit == "%" { String::new() } else { percent(c.relative, " %") },
        claim.verdict.text().to_owned(),
    ]
}

/// Titles of these columns.
pub fn claim_columns(names: &[String; 2]) -> [String; 7] {
    [
        "the paper's claim".into(),
        "its numbers (compliant / baseline)".into(),
        names[0].clone(),
        names[1].clone(),
        "difference [95 % interval]".into(),
        "relative [95 % interval]".into(),
        "verdict".into(),
    ]
}

/// A table with its caption.
pub fn table(table: &Table, names: &[String; 2]) -> String {
    let rows = table.rows.iter().map(|row| cells(row).to_vec());
    format!("{}\n\n{}", table.caption, grid(&columns(names), rows))
}

/// The claims of all experiments.
pub fn claims(report: &Report) -> String {
    let rows = report.sections.iter().flat_map(|section| {
        section.findings.claims.iter().map(|claim| {
            let mut cells = claim_cells(claim).to_vec();
            cells.insert(0, format!("{} {}", section.info.id, section.info.paper));
            cells
        })
    });
    let mut columns = claim_columns(&report.names).to_vec();
    columns.insert(0, "experiment".into());
    grid(&columns, rows)
}

/// `docs/results.md`, which looks for its figures in `images/`.
pub fn document(report: &Report) -> String {
    let [a, b] = &report.names;
    let mut text = format!(
        "# The paper's claims and our numbers\n\n\
         Made by `{}`; not edited by hand. [experiments.md](experiments.md) defines every number. A cell is the mean ± \
         standard deviation over the seeds of {a} and {b} (E1: the map of all seeds together); intervals are 95 % bootstrap \
         intervals over pairs of seeds. Protocol: {}; measured by revision {} in {}.\n\n{}",
        report.command.of(None),
        report.protocol,
        report.revisions().join(", "),
        duration(report.wall_s()),
        claims(report)
    );
    let of_section = |section: &super::Section| {
        section.findings.notes.iter().map(|note| format!("- {}: {note}\n", section.info.id)).collect::<String>()
    };
    let mut notes: String = report.sections.iter().map(of_section).collect();
    notes.extend(report.notes.iter().map(|note| format!("- {note}\n")));
    if !report.missing.is_empty() {
        let names: Vec<&str> = report.missing.iter().map(|info| info.name).collect();
        notes.push_str(&format!("- not run: {}\n", names.join(", ")));
    }
    if !notes.is_empty() {
        text.push_str(&format!("\n{notes}"));
    }
    for figure in report.figures_of_document() {
        text.push_str(&format!("\n![{0}](images/{0}.png)\n\n{1}\n", figure.name, figure.caption));
    }
    if !report.sensing.experiments.is_empty() {
        text.push_str("\n## E12: acting on sensors\n");
        let notes: String = report.sensing.notes.iter().map(|note| format!("- {note}\n")).collect();
        if !notes.is_empty() {
            text.push_str(&format!("\n{notes}"));
        }
        for (table, names) in report.sensing.tables().iter().filter(|(table, _)| table.in_page) {
            text.push_str(&format!("\n{}", self::table(table, names)));
        }
    }
    text.push_str("\n## Policies\n\n");
    let rows = report.policies.iter().map(|policy| {
        vec![
            policy.set.clone(),
            policy.seed.to_string(),
            policy.config.clone(),
            policy.samples(),
            format!("`{}`", &policy.sha256[..16.min(policy.sha256.len())]),
        ]
    });
    let columns = ["set", "seed", "configuration", "samples", "sha256"].map(ToOwned::to_owned);
    text.push_str(&grid(&columns, rows));
    text.push_str("\n## Trials\n\n");
    let rows = report.sections.iter().map(|section| {
        let [a, b] = section.ends;
        vec![
            format!("{} {}", section.info.id, section.info.title),
            section.conditions.to_string(),
            section.trials.to_string(),
            format!("{} of {}", a.falls, a.trials),
            format!("{} of {}", b.falls, b.trials),
        ]
    });
    let columns = [
        "experiment".to_owned(),
        "conditions".to_owned(),
        "trials of each with each policy".to_owned(),
        format!("falls, {a}"),
        format!("falls, {b}"),
    ];
    text.push_str(&grid(&columns, rows));
    text
}

/// A Markdown table. Columns that are empty throughout are left out.
fn grid(columns: &[String], rows: impl Iterator<Item = Vec<String>>) -> String {
    let rows: Vec<Vec<String>> = rows.collect();
    let used: Vec<usize> =
        (0..columns.len()).filter(|column| rows.iter().any(|row| !row[*column].is_empty())).collect();
    let line = |cells: &[String]| {
        let cells: Vec<String> = used.iter().map(|column| cells[*column].replace('|', "\\|")).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let ruler = format!("|{}\n", "---|".repeat(used.len()));
    format!("{}{ruler}{}", line(columns), rows.iter().map(|row| line(row)).collect::<String>())
}
