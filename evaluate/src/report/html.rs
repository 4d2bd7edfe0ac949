//! The report's page: self-contained, without scripts, for screen and print. `maud` escapes every text.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::markdown::{Rows, cells, claim_rows, columns, policy_rows, training_rows, used_columns};
use super::{Report, Section, TOO_FEW, duration};
use crate::policy_sets::Training;
use crate::results::EndCounts;
use crate::section_content::{Claim, Figure, Table};
use crate::statistics::Verdict;

const STYLE: &str = include_str!("style.css");

/// The terms that all experiments use; `docs/experiments.md` defines more of them.
const DEFINITIONS: &str = include_str!("definitions.html");

/// Returns the page of a report.
pub fn page(report: &Report) -> String {
    let (first, others) = report.names.split_first().map_or(("", String::new()), |(a, rest)| (a, rest.join(" and ")));
    let title = format!("{first} against {others} under disturbance");
    let content = html! {
        (sets_table(&report.policies.training()))
        (notes(&report.notes))
        (introduction(report))
        (PreEscaped(DEFINITIONS))
        (claims(report))
        (policies(report))
        @for section in &report.sections { (experiment(section, report)) }
        @if !report.sensing.experiments.is_empty() { (sensing(report)) }
        @if !report.missing.is_empty() { (missing(report)) }
    };
    styled(&title, &content)
}

/// Returns a page of this title with its content, in the style of every page.
pub fn styled(title: &str, content: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                link rel="icon" href="data:,";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body { main { h1 { (title) } (content) } }
        }
    };
    page.into_string()
}

fn introduction(report: &Report) -> Markup {
    let trials: usize = report.sections.iter().flat_map(|section| &section.ends).map(|ends| ends.trials).sum();
    html! {
        nav {
            @for Section { info, .. } in &report.sections { a href={ "#" (info.name) } { (info.id) " " (info.title) } " " }
        }
        p {
            (trials) " trials in simulation. Figures, tables and sections beside the titles of experiments are those of “Deep \
             Compliant Control for Legged Robots”. Trials are paired: trial " i { "k" } " of seed " i { "s" } " is the same for all sets. "
            "A number is the mean over the trials of a policy, then mean ± standard deviation over policies of different \
             seeds (the fraction of the push grid is that of the map of all seeds together); intervals are 95 % bootstrap \
             intervals over pairs of seeds."
        }
        dl {
            dt { "Command" } dd { code { (report.command.text(None)) } }
            dt { "Protocol" } dd { (report.protocol) }
            dt { "Time for all trials" } dd { (duration(report.wall_s())) }
            dt { "Measured by revision" } dd { (report.revisions().join(", ")) }
        }
    }
}

fn claims(report: &Report) -> Markup {
    let (titles, rows) = claim_rows(report);
    let used = used_columns(titles.len(), &rows);
    let claims = report.sections.iter().flat_map(|section| {
        section.content.claims.iter().enumerate().map(move |(index, claim)| (section.info, index == 0, claim))
    });
    let last = titles.len() - 1;
    html! {
        h2 id="claims" { "Claims" }
        @if report.has_too_few_pairs() { p { (TOO_FEW) } }
        (scrolled(html! {
            tr { @for column in &used { th { @if *column > 0 { (titles[*column]) } } } }
            @for ((info, is_first, claim), cells) in claims.zip(&rows) {
                tr {
                    td { @if is_first { a href={ "#" (info.name) } { (cells[0]) } } }
                    @for column in &used[1..] {
                        td class=[claim_class(*column, last, claim)] {
                            // An interval has a line of its own.
                            @for (line, part) in cells[*column].split(" [").enumerate() { @if line > 0 { br; "[" } (part) }
                        }
                    }
                }
            }
        }))
    }
}

/// Returns the style of a cell of a claim in one of the columns, of which `last` has the verdict.
fn claim_class(column: usize, last: usize, claim: &Claim) -> Option<&'static str> {
    match (column, claim.verdict) {
        (1, _) => Some("claim"),
        (..=2, _) => None,
        (column, _) if column < last => Some("number"),
        (_, Verdict::AsExpected | Verdict::Holds) => Some("yes"),
        (_, Verdict::Opposite | Verdict::Fails | Verdict::Incomplete) => Some("no"),
        _ => Some("open"),
    }
}

/// Returns a table in a box of its own, which scrolls sideways where the page is narrow.
pub fn scrolled(rows: Markup) -> Markup {
    html! { div.wide { table { (rows) } } }
}

/// Returns a table in its box.
fn plain_table((columns, rows): Rows) -> Markup {
    scrolled(html! {
        tr { @for column in columns { th { (column) } } }
        @for row in rows { tr { @for cell in row { td { (cell) } } } }
    })
}

/// Returns the table of how the sets were trained.
pub fn sets_table(training: &[Training]) -> Markup {
    plain_table(training_rows(training))
}

fn policies(report: &Report) -> Markup {
    html! { h2 id="policies" { "Policies" } (plain_table(policy_rows(report))) (figures(&report.curves)) }
}

fn figures(figures: &[Figure]) -> Markup {
    html! {
        @for figure in figures {
            figure id={ "figure-" (figure.name) } { (PreEscaped(&figure.svg)) figcaption { (figure.caption) } }
        }
    }
}

fn experiment(section: &Section, report: &Report) -> Markup {
    let Section { info, content, .. } = section;
    html! {
        section id=(info.name) {
            h2 { (info.id) " " (info.title) @if !info.paper.is_empty() { " " small { (info.paper) } } }
            p { (info.method) }
            (notes(&content.notes))
            (figures(&content.figures))
            @for table in content.tables.iter().filter(|table| table.in_page) { (numbers(table, &report.names)) }
            (provenance(section, report))
        }
    }
}

/// Returns the section of E12: every number beside the one with the true state.
fn sensing(report: &Report) -> Markup {
    let sensing = &report.sensing;
    html! {
        section id="sensing" {
            h2 { "E12 Acting on sensors " small { "section IV-D" } }
            p {
                "The same trials, with policies that act on estimates instead of the true state: noisy IMU and \
                 encoders, a contact network and a Kalman filter at 240 Hz. Differences are estimated minus true \
                 state."
            }
            (notes(&sensing.notes))
            @for (table, names) in sensing.tables().iter().filter(|(table, _)| table.in_page) { (numbers(table, names)) }
            details {
                summary { "How it was run" }
                dl {
                    dt { "experiments" } dd { (sensing.experiments.join(", ")) }
                    dt { "contact network" } dd { code { (sensing.network) } }
                    dt { "time for all trials" } dd { (duration(sensing.wall_s)) }
                }
            }
        }
    }
}

fn missing(report: &Report) -> Markup {
    html! {
        h2 { "Not run" }
        ul {
            @for info in &report.missing {
                li { (info.id) " " (info.title) ": " code { (report.command.text(Some(info.name))) } }
            }
        }
    }
}

fn notes(notes: &[String]) -> Markup {
    html! { @for note in notes { p.note { (note) } } }
}

/// Returns a table without the columns that are empty throughout.
fn numbers(table: &Table, names: &[String]) -> Markup {
    let rows: Vec<Vec<String>> = table.rows.iter().map(cells).collect();
    let titles = columns(names);
    let used = used_columns(titles.len(), &rows);
    let condition_above = |row: usize| row.checked_sub(1).map_or("", |above| &rows[above][0]);
    scrolled(html! {
        caption { (table.caption) }
        tr { @for column in &used { th { (titles[*column]) } } }
        @for (index, row) in rows.iter().enumerate() {
            @let is_first = row[0] != condition_above(index);
            tr class=[is_first.then_some("first")] {
                @for column in &used {
                    td class=[(*column > 1).then_some("number")] { @if *column > 0 || is_first { (row[*column]) } }
                }
            }
        }
    })
}

fn provenance(section: &Section, report: &Report) -> Markup {
    let info = section.info;
    let falls = |(name, ends): (&String, &EndCounts)| format!("{name}: {} of {} trials", ends.falls, ends.trials);
    let falls: Vec<String> = report.names.iter().zip(&section.ends).map(falls).collect();
    html! {
        details {
            summary { "How it was run" }
            dl {
                dt { "conditions × trials × policies" }
                dd { (section.conditions) " × " (info.trials) " × " (report.policies.members().count()) }
                dt { "falls" } dd { (falls.join("; ")) }
                @for (key, value) in section.parameters.as_object().into_iter().flatten() {
                    dt { (key) } dd { (value.to_string()) }
                }
                dt { "time for all trials" } dd { (duration(section.wall_s)) }
                dt { "command" } dd { code { (report.command.text(Some(info.name))) } }
            }
        }
    }
}
