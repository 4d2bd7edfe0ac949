//! Tables as Markdown, and the document of all claims.

use std::iter;

use super::{Report, Section, TOO_FEW, duration};
use crate::policy_sets::{PolicySet, SetMember, Training, millions};
use crate::section_content::{Claim, NOTHING, Row, Table, difference, percent, spread};
use crate::statistics::Verdict;

/// The column titles and the cells of a table.
pub type Rows = (Vec<String>, Vec<Vec<String>>);

/// Returns the cells of a row: condition, quantity, the paper's numbers, the numbers of each set, difference, relative change.
pub fn cells(row: &Row) -> Vec<String> {
    let c = &row.comparison;
    let mut cells = vec![row.condition.clone(), row.quantity.axis(), row.paper.clone()];
    cells.extend(c.sets.iter().map(|set| spread(set, row.quantity, "")));
    cells.push(difference(c, row.quantity, ""));
    cells.push(if row.quantity.unit == "%" { String::new() } else { percent(c.relative, "") });
    cells
}

/// Returns the column titles of [`cells`].
pub fn columns(names: &[String]) -> Vec<String> {
    let [difference, relative] = with_pair_names(names, ["difference [95 % interval]", "relative [%]"]);
    titled(["condition", "quantity", "paper (compliant / baseline)"], names, [difference, relative])
}

/// Returns the column titles and cells of a table of how the sets were trained.
pub fn training_rows(training: &[Training]) -> Rows {
    let columns = ["set", "seeds", "configuration", "samples (steps of an environment)"];
    let cells = |training: &Training| {
        let seeds: Vec<String> = training.seeds.iter().map(u64::to_string).collect();
        let configurations: Vec<&str> = training.configurations.iter().map(String::as_str).collect();
        let samples = training.millions().map_or(NOTHING.to_owned(), |millions| format!("{millions} M"));
        vec![training.set.clone(), seeds.join(", "), configurations.join(", "), samples]
    };
    (columns.map(ToOwned::to_owned).into(), training.iter().map(cells).collect())
}

/// Returns the column titles and cells of a table of all policies.
pub fn policy_rows(report: &Report) -> Rows {
    let columns = ["set", "seed", "configuration", "samples", "trained by", "SHA-256"].map(ToOwned::to_owned);
    let row = |(set, member): (&PolicySet, &SetMember)| {
        let samples = member.samples().map_or(NOTHING.to_owned(), |samples| format!("{} M", millions(samples)));
        let [name, config, revision] = [&*set.name, member.config_name(), member.revision()].map(ToOwned::to_owned);
        vec![name, member.seed.to_string(), config, samples, revision, member.agent.sha256.clone()]
    };
    (columns.into(), report.policies.members().map(row).collect())
}

/// Adds the names of the two compared sets to titles if there are more than two sets.
fn with_pair_names<const N: usize>(names: &[String], titles: [&str; N]) -> [String; N] {
    titles.map(|title| match names {
        [a, b, _, ..] => format!("{title}, {a} and {b}"),
        _ => title.to_owned(),
    })
}

fn titled<const N: usize>(first: [&str; N], names: &[String], last: impl IntoIterator<Item = String>) -> Vec<String> {
    first.map(ToOwned::to_owned).into_iter().chain(names.iter().cloned()).chain(last).collect()
}

/// Returns a table with its caption.
pub fn table(table: &Table, names: &[String]) -> String {
    format!("{}\n\n{}", table.caption, grid((columns(names), table.rows.iter().map(cells).collect())))
}

/// Returns the column titles and cells of the claims of all experiments: experiment, text, the paper's numbers, the numbers of each
/// set, difference, relative change, verdict. The verdict that there are too few pairs is left out if the report says so once.
pub fn claim_rows(report: &Report) -> Rows {
    let says_too_few = report.has_too_few_pairs();
    let cells = |id: &str, claim: &Claim| {
        let Claim { text, paper, quantity, comparison: c, verdict } = claim;
        let unit = if quantity.unit.is_empty() { String::new() } else { format!(" {}", quantity.unit) };
        let mut cells = vec![id.to_owned(), text.clone(), paper.clone()];
        cells.extend(c.sets.iter().map(|set| spread(set, *quantity, &unit)));
        // The difference of two fractions is not a fraction.
        cells.push(difference(c, *quantity, &unit.replace('%', "points")));
        cells.push(if quantity.unit == "%" { String::new() } else { percent(c.relative, " %") });
        let is_said = says_too_few && *verdict == Verdict::TooFew;
        cells.push(if is_said { String::new() } else { verdict.text().to_owned() });
        cells
    };
    let rows = report
        .sections
        .iter()
        .flat_map(|section| section.content.claims.iter().map(move |claim| (section.info.id, claim)));
    let titles = ["difference [95 % interval]", "relative [95 % interval]"];
    let [difference, relative] = with_pair_names(&report.names, titles);
    let first = ["experiment", "claim", "the paper's numbers (compliant / baseline)"];
    let columns = titled(first, &report.names, [difference, relative, "verdict".into()]);
    (columns, rows.map(|(id, claim)| cells(id, claim)).collect())
}

/// Returns the claims of each experiment: a list with the verdicts, the numbers in narrow tables, and notes.
fn claims_by_experiment(report: &Report) -> String {
    let (columns, rows) = claim_rows(report);
    let (mut rows, sets) = (rows.into_iter(), report.names.len());
    // The compared sets and their difference before the others.
    let order = |first: String, row: &[String]| -> Vec<String> {
        let numbers = [2, 3, 4, 3 + sets, 4 + sets].into_iter().chain(5..3 + sets).map(|k| row[k].clone());
        iter::once(first).chain(numbers).collect()
    };
    let of_section = |section: &Section| {
        let (mut list, mut numbers) = (String::new(), Vec::new());
        for (row, number) in rows.by_ref().take(section.content.claims.len()).zip(1..) {
            let verdict = row.last().filter(|verdict| !verdict.is_empty());
            let verdict = verdict.map_or(String::new(), |verdict| format!(": **{verdict}**"));
            list += &format!("{number}. {}{verdict}\n", row[1]);
            numbers.push(order(number.to_string(), &row));
        }
        let info = &section.info;
        let paper = if info.paper.is_empty() { String::new() } else { format!(" ({})", info.paper) };
        let notes: String = section.content.notes.iter().map(|note| format!("- {note}\n")).collect();
        let numbers = narrow((order("claim".into(), &columns), numbers));
        let parts = [format!("## {} {}{paper}\n", info.id, info.title), list, numbers, notes];
        parts.into_iter().filter(|part| !part.is_empty()).map(|part| format!("\n{part}")).collect()
    };
    report.sections.iter().map(of_section).collect::<Vec<String>>().concat()
}

/// Returns the document of all claims (`research/results.md`), whose figures are in `images/`.
pub fn document(report: &Report) -> String {
    let list = |notes: &[String]| notes.iter().map(|note| format!("- {note}\n")).collect::<String>();
    let mut text = format!(
        "# Claims and numbers\n\n{}\n{}\n\
         Made by `{}`; not edited by hand. [experiments.md](../docs/experiments.md) defines every number. A cell is the mean ± \
         standard deviation over the seeds of {} (E1: the map of all seeds together); intervals are 95 % bootstrap \
         intervals over pairs of seeds. Protocol: {}; measured by revision {} in {}.\n\n{}",
        grid(training_rows(&report.policies.training())),
        list(&report.notes),
        report.command.text(None),
        report.names.join(", "),
        report.protocol,
        report.revisions().join(", "),
        duration(report.wall_s()),
        if report.has_too_few_pairs() { format!("{TOO_FEW}\n\n") } else { String::new() }
    );
    if !report.missing.is_empty() {
        let names: Vec<&str> = report.missing.iter().map(|info| info.name).collect();
        text.push_str(&format!("Not run: {}.\n", names.join(", ")));
    }
    text.push_str(&claims_by_experiment(report));
    for figure in report.figures_of_document() {
        text.push_str(&format!("\n![{0}](images/{0}.png)\n\n{1}\n", figure.name, figure.caption));
    }
    if !report.sensing.experiments.is_empty() {
        text.push_str(&format!("\n## E12: acting on sensors\n\n{}", list(&report.sensing.notes)));
    }
    for (table, names) in report.sensing.tables().iter().filter(|(table, _)| table.in_page) {
        text.push_str(&format!("\n{}", self::table(table, names)));
    }
    text.push_str("\n## Policies\n\n");
    text.push_str(&grid(policy_rows(report)));
    text.push_str("\n## Trials\n\n");
    let rows = report.sections.iter().map(|Section { info, conditions, ends, .. }| {
        let counts = [format!("{} {}", info.id, info.title), conditions.to_string(), info.trials.to_string()];
        counts.into_iter().chain(ends.iter().map(|ends| format!("{} of {}", ends.falls, ends.trials))).collect()
    });
    let counts = ["experiment", "conditions", "trials of each with each policy"];
    let falls: Vec<String> = report.names.iter().map(|name| format!("falls, {name}")).collect();
    text.push_str(&narrow((titled(counts, &falls, []), rows.collect())));
    text
}

/// Returns a table as tables of up to six columns, the first column in each; none without rows.
fn narrow((columns, rows): Rows) -> String {
    let rest: Vec<usize> = (1..columns.len()).collect();
    let part = |part: &[usize]| {
        let cells = |row: &Vec<String>| iter::once(&0).chain(part).map(|k| row[*k].clone()).collect();
        grid((cells(&columns), rows.iter().map(cells).collect()))
    };
    let parts: Vec<String> = rest.chunks(5).filter(|_| !rows.is_empty()).map(part).collect();
    parts.join("\n")
}

/// Returns a Markdown table without the columns that are empty throughout.
fn grid((columns, rows): Rows) -> String {
    let used = used_columns(columns.len(), &rows);
    let line = |cells: &[String]| {
        let cells: Vec<String> = used.iter().map(|column| cells[*column].replace('|', "\\|")).collect();
        format!("| {} |\n", cells.join(" | "))
    };
    let ruler = format!("|{}\n", "---|".repeat(used.len()));
    format!("{}{ruler}{}", line(&columns), rows.iter().map(|row| line(row)).collect::<String>())
}

/// Returns the indices of the columns in which a row has text.
pub fn used_columns(columns: usize, rows: &[Vec<String>]) -> Vec<usize> {
    (0..columns).filter(|column| rows.iter().any(|row| !row[*column].is_empty())).collect()
}
