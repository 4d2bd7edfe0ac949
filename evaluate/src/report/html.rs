//! The report's page: self-contained, without scripts, for screen and print. `maud` escapes every text.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::markdown::{cells, claim_cells, claim_columns, columns, used_columns};
use super::{Report, Section, duration, other_reports, samples_text};
use crate::results::EndCounts;
use crate::section_content::{Claim, Table};
use crate::statistics::Verdict;

const STYLE: &str = include_str!("style.css");

/// Terms that all experiments use; `docs/experiments.md` defines more of them.
const DEFINITIONS: &[(&str, &str)] = &[
    (
        "trial",
        "one rollout. Its phase, offsets and terrain are drawn from the policy's seed, the experiment, the condition \
         and the trial's number, never from the policy.",
    ),
    ("phase", "a disturbance comes at a time drawn uniformly from 0.65 s, longer than a stride at 0.5 m/s."),
    ("push", "a velocity offset added to the trunk's velocity in one instant, in the heading frame (forward, left)."),
    (
        "fall",
        "the base is less than 0.2 m above the ground under it, or any part but the feet (of robots from elsewhere: \
         but feet and shanks) touches the ground. The trial ends, and what it leaves undefined is not averaged; falls \
         are counted apart.",
    ),
    ("power, torque", "Σ|τ·q̇| and ‖τ‖₂ over the twelve joints, averaged at 240 Hz, τ as applied."),
    (
        "cell",
        "the mean over the trials of a policy, then mean ± standard deviation over policies. A trial that leaves a \
         number undefined for one policy of a pair is left out for both. (4 of 5 seeds): the others have no such \
         number.",
    ),
    (
        "difference, interval",
        "first minus second set, over the pairs of seeds that both have the number (how many, if not all); 95 % \
         bootstrap over these pairs, expanded for their number. Fewer than five pairs have no interval.",
    ),
    (
        "verdict",
        "effect in the expected direction (the paper's, where it has the experiment): the interval of the difference \
         lies on that side of zero; opposite: on the other side; no effect shown: it includes zero; too few pairs to \
         tell: fewer than five. A bound holds if the means of both sets keep it and no number is missing; a fall breaks \
         it, except where what precedes the fall is measured (E15). Sets after the second have numbers alone.",
    ),
];

/// Returns the page of a report.
pub fn page(report: &Report) -> String {
    let (first, others) = report.names.split_first().map_or(("", String::new()), |(a, rest)| (a, rest.join(" and ")));
    let title = format!("{first} against {others} under disturbance");
    let content = html! {
        (introduction(report))
        details {
            summary { "Definitions" }
            dl { @for (term, meaning) in DEFINITIONS { dt { (term) } dd { (meaning) } } }
        }
        (claims(report))
        @if !report.other_reports.is_empty() { (other_reports_table(report)) }
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
            @for Section { info, .. } in &report.sections {
                a href={ "#" (info.name) } { (info.id) " " (info.title) } " "
            }
        }
        p {
            "Experiments of section IV of “Deep Compliant Control for Legged Robots”, measured with " (trials)
            " trials in simulation. Trials are paired: trial " i { "k" } " of seed " i { "s" } " is the same for all sets. "
            "A number is the mean over the trials of a policy, then mean ± standard deviation over policies of different \
             seeds (the fraction of the push grid is that of the map of all seeds together); intervals are 95 % bootstrap \
             intervals over pairs of seeds."
        }
        (notes(&report.notes))
        dl {
            dt { "Command" } dd { code { (report.command.text(None)) } }
            dt { "Protocol" } dd { (report.protocol) }
            dt { "Time for all trials" } dd { (duration(report.wall_s())) }
            dt { "Measured by revision" } dd { (report.revisions().join(", ")) }
        }
    }
}

fn claims(report: &Report) -> Markup {
    html! {
        h2 id="claims" { "What the paper claims" }
        table {
            tr { th {} @for column in claim_columns(&report.names) { th { (column) } } }
            @for Section { info, content, .. } in &report.sections {
                @for (index, claim) in content.claims.iter().enumerate() {
                    tr {
                        td { a href={ "#" (info.name) } { @if index == 0 { (info.id) } } }
                        (claim_row(claim))
                    }
                }
            }
        }
    }
}

fn claim_row(claim: &Claim) -> Markup {
    let verdict = match claim.verdict {
        Verdict::AsExpected | Verdict::Holds => "yes",
        Verdict::Opposite | Verdict::Fails => "no",
        _ => "open",
    };
    let cells = claim_cells(claim);
    let class = |column: usize| match column {
        0 | 1 => None,
        column if column + 1 == cells.len() => Some(verdict),
        _ => Some("number"),
    };
    html! {
        @for (column, cell) in cells.iter().enumerate() {
            // An interval has a line of its own.
            td class=[class(column)] {
                @for (line, part) in cell.split(" [").enumerate() { @if line > 0 { br; "[" } (part) }
            }
        }
    }
}

fn other_reports_table(report: &Report) -> Markup {
    let (columns, rows) = other_reports::table(report);
    html! {
        h2 id="beside" { (other_reports::TITLE) }
        p { (other_reports::CAPTION) }
        table {
            tr { @for column in columns { th { (column) } } }
            @for row in rows { tr { @for cell in row { td { (cell) } } } }
        }
    }
}

fn policies(report: &Report) -> Markup {
    html! {
        h2 id="policies" { "Policies" }
        table {
            tr {
                th { "set" } th { "seed" } th { "configuration" } th { "samples" } th { "trained by" } th { "SHA-256" }
            }
            @for (set, member) in report.policies.members() {
                tr {
                    td { (set.name) }
                    td.number { (member.seed) }
                    td { (member.config_name()) }
                    td.number { (samples_text(member)) }
                    td { (member.revision()) }
                    td { code { (member.agent.sha256) } }
                }
            }
        }
    }
}

fn experiment(section: &Section, report: &Report) -> Markup {
    let Section { info, content, .. } = section;
    html! {
        section id=(info.name) {
            h2 { (info.id) " " (info.title) " " small { (info.paper) } }
            p { (info.method) }
            (notes(&content.notes))
            @for figure in &content.figures {
                figure id={ "figure-" (figure.name) } {
                    (PreEscaped(&figure.svg))
                    figcaption { (figure.caption) }
                }
            }
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
                "The same trials, with policies that see no true state: noisy IMU and encoders, a contact network and \
                 a Kalman filter at 240 Hz. Differences are estimated minus true state."
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
                li {
                    (info.id) " " (info.title) " (" (info.paper) "): "
                    code { (report.command.text(Some(info.name))) }
                }
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
    html! {
        table {
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
        }
    }
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
