//! The page of an examination, its figure, and its scores as JSON.

use std::path::Path;

use maud::{Markup, PreEscaped, html};

use super::film::Film;
use super::measures::Measured;
use super::{DISCIPLINES, Examination, Grade, Score};
use crate::plot::svg::{Anchor, Stroke, Svg, Text};
use crate::plot::{GREY, INK, LARGE, PALE, SMALL, WIDTH, colour, shortened};
use crate::policy_sets::Training;
use crate::report::html::{scrolled, sets_table, styled};
use crate::report::{ReportError, text as plain_text, write, write_figure};
use crate::section_content::{Figure, NOTHING};

/// The height of a bar \[px\].
const BAR: f64 = 13.0;

/// The place of 0 and the width of 100 % in the figure \[px\].
const SCALE: [f64; 2] = [150.0, 500.0];

/// Writes `exam.html`, `exam.svg`, `exam.png`, `exam.json` and, if there is a film, `fall.png` into a folder.
///
/// # Errors
/// A file cannot be written, or the figure cannot be rendered.
pub fn save(examination: &Examination, film: Option<&Film>, folder: &Path) -> Result<(), ReportError> {
    let figure = Figure { name: "exam".into(), caption: String::new(), svg: figure(examination) };
    // Plain numbers and texts.
    let json = serde_json::to_string_pretty(examination).unwrap_or_default() + "\n";
    write_figure(&figure, folder)?;
    write(&folder.join("exam.json"), json.as_bytes())?;
    let fall = folder.join("fall.png");
    match film {
        Some(film) => write(&fall, &film.png)?,
        // A film that an earlier examination left shows another policy.
        None => drop(std::fs::remove_file(fall)),
    }
    write(&folder.join("exam.html"), page(examination, film, &figure.svg).as_bytes())
}

/// Returns a score in percent with its interval.
pub fn score_text(score: Score) -> String {
    let Some(fraction) = score.fraction() else { return NOTHING.to_owned() };
    let [low, high] = score.interval().map(|end| 100.0 * end);
    format!("{:.0} % [{low:.0}, {high:.0}]", 100.0 * fraction)
}

/// Returns the name of a measure and its unit.
fn measure_text(found: &Measured) -> String {
    format!("{} [{}]", found.measure, found.unit)
}

/// Returns a mean with about three digits.
fn mean_text(mean: &Option<f64>) -> String {
    let decimals = |mean: f64| match mean.abs() {
        ..0.1 => 4,
        ..10.0 => 2,
        _ => 0,
    };
    mean.map_or(NOTHING.to_owned(), |mean| format!("{mean:.*}", decimals(mean)))
}

/// Returns the scores as a table of plain text, one line for each discipline if `width` allows it.
pub fn text(examination: &Examination, width: usize) -> String {
    let row = |first: &str, cells: Vec<String>| [vec![first.to_owned()], cells].concat();
    let samples =
        |set: &Training| set.millions().map_or(NOTHING.to_owned(), |millions| format!("{millions} M samples"));
    let trained = row("trained", examination.training.iter().map(samples).collect());
    let mut rows = vec![row("", examination.names.clone()), trained];
    let grades = examination.grades.iter();
    rows.extend(grades.map(|it| row(it.discipline, it.scores.iter().map(|score| score_text(*score)).collect())));
    rows.extend(examination.measures.iter().map(|it| row(&measure_text(it), it.means.iter().map(mean_text).collect())));
    plain_text::table(&rows, width)
}

fn page(examination: &Examination, film: Option<&Film>, figure: &str) -> String {
    let title = format!("Examination of {}", examination.names[0]);
    let content = html! {
        (sets_table(&examination.training))
        p {
            "The percentage of trials that each policy passes, with Wilson's 95 % interval over the trials of that one \
             policy. All policies play the same trials, in simulation. Definitions: docs/experiments.md."
        }
        @for note in examination.notes.iter().chain(&examination.faults) { p.note { (note) } }
        figure { (PreEscaped(figure)) }
        (table(examination))
        p { "Means over trials: docs/benchmark.md defines them. Trials with a fall have no number, except for those of shoves." }
        (scrolled(html! {
            tr { th { "measure" } @for name in &examination.names { th { (name) } } }
            @for found in &examination.measures {
                tr { td { (measure_text(found)) } @for mean in &found.means { td.number { (mean_text(mean)) } } }
            }
        }))
        @if let Some(film) = film {
            figure {
                img src="fall.png" alt="Six pictures of a fall" style="width:100%";
                figcaption { (film.caption) }
            }
        }
        dl { dt { "Command" } dd { code { (examination.command) } } }
    };
    styled(&title, &content)
}

fn table(examination: &Examination) -> Markup {
    scrolled(html! {
        tr { th { "discipline" } th { "passed if" } @for name in &examination.names { th { (name) } } th { "falls" } }
        @for (grade, discipline) in examination.grades.iter().zip(DISCIPLINES) {
            tr {
                td { (grade.discipline) }
                td { (discipline.description) }
                @for score in &grade.scores { td.number { (score_text(*score)) } }
                td.number { (falls(grade)) }
            }
        }
    })
}

/// Returns the numbers of falls of all policies, and the number of trials; a dash if there are none.
fn falls(grade: &Grade) -> String {
    let falls: Vec<String> = grade.scores.iter().map(|score| score.falls.to_string()).collect();
    match grade.scores.first().map_or(0, |score| score.trials) {
        0 => NOTHING.to_owned(),
        trials => format!("{} of {trials}", falls.join(", ")),
    }
}

/// Draws the scores as bars with their intervals.
fn figure(examination: &Examination) -> String {
    let row = BAR * examination.names.len() as f64 + 14.0;
    let bottom = 34.0 + row * examination.grades.len() as f64;
    let mut svg = Svg::new(WIDTH, bottom + 58.0);
    let x = |fraction: f64| SCALE[0] + SCALE[1] * fraction;
    let title = format!("Examination of {}: trials passed", shortened(&examination.names[0], 40));
    svg.text([WIDTH / 2.0, 20.0], &title, Text { bold: true, ..Text::new(LARGE, Anchor::Middle) });
    for percent in [0, 25, 50, 75, 100] {
        let at = x(f64::from(percent) / 100.0);
        svg.line([at, 34.0], [at, bottom], Stroke::new(PALE, 1.0));
        let style = Text { colour: GREY, ..Text::new(SMALL, Anchor::Middle) };
        svg.text([at, bottom + 16.0], &format!("{percent} %"), style);
    }
    for (index, grade) in examination.grades.iter().enumerate() {
        let top = 34.0 + row * index as f64 + 7.0;
        let middle = top + 0.5 * BAR * grade.scores.len() as f64;
        svg.text([SCALE[0] - 10.0, middle + 4.0], grade.discipline, Text::new(LARGE, Anchor::End));
        for (set, score) in grade.scores.iter().enumerate() {
            let y = top + BAR * set as f64;
            let style = Text::new(SMALL - 1.5, Anchor::Start);
            let Some(fraction) = score.fraction() else {
                let why = if score.trials == 0 { "not played" } else { "compliance not supported" };
                svg.text([x(0.0) + 4.0, y + BAR - 3.0], why, Text { colour: GREY, ..style });
                continue;
            };
            svg.rectangle([x(0.0), y + 1.0], [SCALE[1] * fraction, BAR - 2.0], colour(set));
            let [low, high] = score.interval();
            svg.line([x(low), y + BAR / 2.0], [x(high), y + BAR / 2.0], Stroke::new(INK, 1.3));
            svg.text([x(1.0) + 10.0, y + BAR - 3.0], &score_text(*score), style);
        }
    }
    let mut at = SCALE[0];
    for (set, name) in examination.names.iter().enumerate() {
        svg.rectangle([at, bottom + 32.0], [12.0, 12.0], colour(set));
        let name = shortened(name, 24);
        svg.text([at + 18.0, bottom + 42.0], &name, Text::new(SMALL, Anchor::Start));
        at += 40.0 + 0.62 * SMALL * name.chars().count() as f64;
    }
    svg.finish(&title)
}
