//! The page: self-contained, without scripts, for screen and print.

use std::fmt::Write as _;

use super::markdown::{cells, claim_cells, claim_columns, columns};
use super::{Report, Section, duration, other_reports};
use crate::plot::svg::escaped;
use crate::section_content::{Claim, Table};
use crate::statistics::Verdict;

const STYLE: &str = include_str!("style.css");

/// Words that all experiments use; `docs/experiments.md` has more of them.
const WORDS: &[(&str, &str)] = &[
    (
        "trial",
        "one rollout. Its phase, offsets and terrain are drawn from the policy's seed, the experiment, the condition \
      and the trial's number, never from the policy.",
    ),
    ("phase", "a disturbance comes at a time drawn uniformly from 0.65 s, longer than a stride at 0.5 m/s."),
    ("push", "a velocity offset added to the trunk's velocity in one instant, in the heading frame (forward, left)."),
    (
        "fall",
        "the base is less than 0.2 m above the ground under it, or any part but the feet (of robots from \
      elsewhere: but feet and shanks) touches the ground. The trial \
      ends, and what it leaves undefined is not averaged; falls are counted apart.",
    ),
    ("power, torque", "Σ|τ·q̇| and ‖τ‖₂ over the twelve joints, averaged at 240 Hz, τ as applied."),
    (
        "cell",
        "the mean over the trials of a policy, then mean ± standard deviation over policies. A trial that leaves a \
      number undefined for one policy of a pair is left out for both. (4 of 5 seeds): the others have no such number.",
    ),
    (
        "difference, interval",
        "first minus second set, over the pairs of seeds that both have the number (how many, if not all); 95 % \
      bootstrap over these pairs, expanded for their number. Fewer than five pairs have no interval.",
    ),
    (
        "verdict",
        "effect in the expected direction (the paper's, where it has the experiment): the interval of the difference lies \
      on that side of zero; opposite: on the other side; no effect shown: it includes zero; too few pairs to tell: fewer \
      than five. A bound holds if the means of both sets keep it. Sets after the second have numbers alone.",
    ),
];

/// The whole page.
pub fn page(report: &Report) -> String {
    let (first, others) = report.names.split_first().map_or(("", String::new()), |(a, rest)| (a, rest.join(" and ")));
    let title = format!("{first} against {others} under disturbance");
    let mut body = String::new();
    // Writing into a String cannot fail.
    let _ = write!(body, "<h1>{}</h1>\n{}", escaped(&title), introduction(report));
    let words = WORDS.iter().map(|(word, meaning)| format!("<dt>{word}</dt><dd>{}</dd>", escaped(meaning)));
    let _ = writeln!(body, "<details><summary>Definitions</summary><dl>{}</dl></details>", words.collect::<String>());
    body.push_str(&claims(report));
    if !report.other_reports.is_empty() {
        body.push_str(&beside_table(report));
    }
    body.push_str(&policies(report));
    for section in &report.sections {
        body.push_str(&experiment(section, report));
    }
    if !report.sensing.experiments.is_empty() {
        body.push_str(&sensing(report));
    }
    if !report.missing.is_empty() {
        let lines = report.missing.iter().map(|info| {
            let command = escaped(&report.command.line(Some(info.name)));
            format!("<li>{} {} ({}): <code>{command}</code></li>", info.id, info.title, info.paper)
        });
        let _ = write!(body, "<h2>Not run</h2>\n<ul>{}</ul>\n", lines.collect::<String>());
    }
    format!(
        "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<link rel=\"icon\" href=\"data:,\">\n\
         <title>{}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n{body}</main>\n</body>\n</html>\n",
        escaped(&title)
    )
}

fn introduction(report: &Report) -> String {
    let trials: usize = report.sections.iter().flat_map(|section| &section.ends).map(|ends| ends.trials).sum();
    let navigation: String = report
        .sections
        .iter()
        .map(|section| {
            format!("<a href=\"#{}\">{} {}</a> ", section.info.name, section.info.id, escaped(section.info.title))
        })
        .collect();
    let notes = notes(&report.notes);
    format!(
        "<nav>{navigation}</nav>\n\
         <p>Experiments of section IV of “Deep Compliant Control for Legged Robots”, measured with {trials} trials in \
         simulation. Trials are paired: trial <i>k</i> of seed <i>s</i> is the same for all sets. A number is the mean \
         over the trials of a policy, then mean ± standard deviation over policies of different seeds (the fraction of the \
         push grid is that of the map of all seeds together); intervals are 95 % bootstrap intervals over pairs of \
         seeds.</p>\n\
         {notes}<dl><dt>Command</dt><dd><code>{}</code></dd><dt>Protocol</dt><dd>{}</dd>\
         <dt>Time for all trials</dt><dd>{}</dd><dt>Measured by revision</dt><dd>{}</dd></dl>\n",
        escaped(&report.command.line(None)),
        escaped(&report.protocol),
        duration(report.wall_s()),
        escaped(&report.revisions().join(", ")),
    )
}

fn claims(report: &Report) -> String {
    let mut rows = String::new();
    for section in &report.sections {
        for (index, claim) in section.content.claims.iter().enumerate() {
            let id = if index == 0 { section.info.id } else { "" };
            let _ = writeln!(rows, "<tr><td><a href=\"#{}\">{id}</a></td>{}</tr>", section.info.name, claim_row(claim));
        }
    }
    let head: String =
        claim_columns(&report.names).iter().map(|column| format!("<th>{}</th>", escaped(column))).collect();
    format!("<h2 id=\"claims\">What the paper claims</h2>\n<table><tr><th></th>{head}</tr>\n{rows}</table>\n")
}

fn claim_row(claim: &Claim) -> String {
    // Intervals on lines of their own.
    let cells: Vec<String> = claim_cells(claim).iter().map(|cell| escaped(cell).replace(" [", "<br>[")).collect();
    let class = match claim.verdict {
        Verdict::AsExpected | Verdict::Holds => "yes",
        Verdict::Opposite | Verdict::Fails => "no",
        _ => "open",
    };
    let last = cells.len() - 1;
    let cell = |(column, text): (usize, &String)| match column {
        0 | 1 => format!("<td>{text}</td>"),
        column if column == last => format!("<td class=\"{class}\">{text}</td>"),
        _ => format!("<td class=\"number\">{text}</td>"),
    };
    cells.iter().enumerate().map(cell).collect()
}

fn beside_table(report: &Report) -> String {
    let (columns, rows) = other_reports::table(report);
    let head: String = columns.iter().map(|column| format!("<th>{}</th>", escaped(column))).collect();
    let row = |cells: Vec<String>| {
        let cells = cells.iter().map(|cell| format!("<td>{}</td>", escaped(cell)));
        format!("<tr>{}</tr>\n", cells.collect::<String>())
    };
    format!(
        "<h2 id=\"beside\">{}</h2>\n<p>{}</p>\n<table><tr>{head}</tr>\n{}</table>\n",
        other_reports::TITLE,
        other_reports::CAPTION,
        rows.into_iter().map(row).collect::<String>()
    )
}

fn policies(report: &Report) -> String {
    let rows: String = report
        .policies
        .iter()
        .map(|policy| {
            format!(
                "<tr><td>{}</td><td class=\"number\">{}</td><td>{}</td><td class=\"number\">{}</td><td>{}</td>\
                 <td><code>{}</code></td></tr>\n",
                escaped(&policy.set),
                policy.seed,
                escaped(&policy.config),
                policy.samples(),
                escaped(&policy.revision),
                escaped(&policy.sha256)
            )
        })
        .collect();
    format!(
        "<h2 id=\"policies\">Policies</h2>\n<table><tr><th>set</th><th>seed</th><th>configuration</th><th>samples</th>\
         <th>trained by</th><th>SHA-256</th></tr>\n{rows}</table>\n"
    )
}

fn experiment(section: &Section, report: &Report) -> String {
    let info = section.info;
    let mut text = format!(
        "<section id=\"{}\">\n<h2>{} {} <small>{}</small></h2>\n<p>{}</p>\n",
        info.name,
        info.id,
        escaped(info.title),
        escaped(info.paper),
        escaped(info.method)
    );
    text.push_str(&notes(&section.content.notes));
    for figure in &section.content.figures {
        let _ = write!(
            text,
            "<figure id=\"figure-{}\">\n{}<figcaption>{}</figcaption>\n</figure>\n",
            figure.name,
            figure.svg,
            escaped(&figure.caption)
        );
    }
    for table in section.content.tables.iter().filter(|table| table.in_page) {
        text.push_str(&numbers(table, &report.names));
    }
    text.push_str(&provenance(section, report));
    text.push_str("</section>\n");
    text
}

/// E12: every number beside the one with the true state.
fn sensing(report: &Report) -> String {
    let found = &report.sensing;
    let tables = found.tables();
    let tables = tables.iter().filter(|(table, _)| table.in_page);
    let tables: String = tables.map(|(table, names)| numbers(table, names)).collect();
    let notes = notes(&found.notes);
    format!(
        "<section id=\"sensing\">\n<h2>E12 Acting on sensors <small>section IV-D</small></h2>\n<p>The same trials, with \
         policies that see no true state: noisy IMU and encoders, a contact network and a Kalman filter at 240 Hz. \
         Differences are estimated minus true state.</p>\n{notes}{tables}<details><summary>How it was run</summary><dl>\
         <dt>experiments</dt><dd>{}</dd><dt>contact network</dt><dd><code>{}</code></dd><dt>time for all trials</dt>\
         <dd>{}</dd></dl></details>\n</section>\n",
        escaped(&found.experiments.join(", ")),
        escaped(&found.network),
        duration(found.wall_s),
    )
}

fn notes(notes: &[String]) -> String {
    notes.iter().map(|note| format!("<p class=\"note\">{}</p>\n", escaped(note))).collect()
}

/// A table without the columns that are empty throughout.
fn numbers(table: &Table, names: &[String]) -> String {
    let rows: Vec<Vec<String>> = table.rows.iter().map(cells).collect();
    let titles = columns(names);
    let used: Vec<usize> = (0..titles.len()).filter(|column| rows.iter().any(|row| !row[*column].is_empty())).collect();
    let head: String = used.iter().map(|column| format!("<th>{}</th>", escaped(&titles[*column]))).collect();
    let mut body = String::new();
    let mut last_condition = "";
    for row in &rows {
        let fresh = row[0] != last_condition;
        last_condition = &row[0];
        let cell = |column: &usize| match column {
            0 => format!("<td>{}</td>", if fresh { escaped(&row[0]) } else { String::new() }),
            1 => format!("<td>{}</td>", escaped(&row[1])),
            other => format!("<td class=\"number\">{}</td>", escaped(&row[*other])),
        };
        let class = if fresh { " class=\"first\"" } else { "" };
        let _ = writeln!(body, "<tr{class}>{}</tr>", used.iter().map(cell).collect::<String>());
    }
    format!("<table><caption>{}</caption><tr>{head}</tr>\n{body}</table>\n", escaped(&table.caption))
}

fn provenance(section: &Section, report: &Report) -> String {
    let falls: Vec<String> = report
        .names
        .iter()
        .zip(&section.ends)
        .map(|(name, ends)| format!("{}: {} of {} trials", escaped(name), ends.falls, ends.trials))
        .collect();
    let parameters: String = section
        .parameters
        .as_object()
        .into_iter()
        .flatten()
        .map(|(key, value)| format!("<dt>{}</dt><dd>{}</dd>", escaped(key), escaped(&value.to_string())))
        .collect();
    format!(
        "<details><summary>How it was run</summary><dl>\
         <dt>conditions × trials × policies</dt><dd>{} × {} × {}</dd><dt>falls</dt><dd>{}</dd>{parameters}\
         <dt>time for all trials</dt><dd>{}</dd><dt>command</dt><dd><code>{}</code></dd></dl></details>\n",
        section.conditions,
        section.trials,
        report.policies.len(),
        falls.join("; "),
        duration(section.wall_s),
        escaped(&report.command.line(Some(section.info.name))),
    )
}
