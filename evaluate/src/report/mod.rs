/*! The report: one page that opens offline, every figure and table as files, and every number as JSON.

`summary.json` is the same for two runs of the same evaluation: it has no times and no paths, maps are in order, and numbers
have six digits. Durations and the command are in the page only.
*/

mod csv_tables;
pub(crate) mod html;
mod markdown;
pub mod summary;
pub mod text;

use std::collections::BTreeSet;
use std::fs;
use std::io;
use std::path::Path;

use super::plot::png::{RenderError, Renderer};
use super::policy_sets::PolicySets;
use super::results::EndCounts;
use super::runner::Measurement;
use super::section_content::{Figure, SectionContent, Table};
use super::sensing::SensingComparison;
use super::statistics::Verdict;
use super::{Experiment, ExperimentInfo};
use supple::util::files::{self, FileError};

/// The reason why a report was not written.
#[derive(Debug, thiserror::Error)]
pub enum ReportError {
    /// A file cannot be written.
    #[error("cannot write the {0}")]
    Write(#[from] FileError),
    /// A figure cannot be rendered as PNG.
    #[error("figure {0}: {1}")]
    Figure(String, #[source] RenderError),
}

/// The command line that makes a report.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CommandLine {
    /// The requested experiments; empty for all.
    pub experiments: Vec<String>,
    /// All other arguments, each quoted for a shell.
    pub options: Vec<String>,
}

impl CommandLine {
    /// Returns the command line for one experiment, or for the whole report.
    pub fn text(&self, experiment: Option<&str>) -> String {
        let program = std::iter::once("cargo run --release --bin evaluate --");
        let experiments = self.experiments.iter().map(String::as_str).filter(|_| experiment.is_none());
        let words = program.chain(experiments).chain(experiment).chain(self.options.iter().map(String::as_str));
        words.collect::<Vec<_>>().join(" ")
    }
}

/// The section of one experiment in the report.
#[derive(Debug, Clone, PartialEq)]
pub struct Section {
    /// The experiment's name, title and quantities.
    pub info: ExperimentInfo,
    /// The experiment's parameters in the protocol.
    pub parameters: serde_json::Value,
    /// The number of conditions.
    pub conditions: usize,
    /// The number of trials of each set by how they ended.
    pub ends: Vec<EndCounts>,
    /// The claims, tables and figures.
    pub content: SectionContent,
    /// The time that the trials took \[s\].
    pub wall_s: f64,
    /// The revisions of the programs that measured.
    pub revisions: BTreeSet<String>,
}

impl Section {
    /// Creates the section of an experiment from its measurement.
    pub fn new(experiment: &dyn Experiment, measurement: &Measurement) -> Self {
        let results = &measurement.results;
        let mut content = experiment.content(results);
        let ends: Vec<EndCounts> = (0..results.sets.len()).map(|set| results.ends(set)).collect();
        for (name, EndCounts { trials, falls, out_of_reach, .. }) in results.names.iter().zip(&ends) {
            if *trials > 0 && falls == trials {
                let words = "fell in every trial: quantities that a fall leaves undefined are shown as –.";
                content.notes.push(format!("{name} {words}"));
            }
            if *out_of_reach > 0 {
                let words = "were not played: some of its policies do not support the commanded compliance.";
                content.notes.push(format!("{out_of_reach} of {} trials of {name} {words}", out_of_reach + trials));
            }
        }
        content.notes.extend((0..results.sets.len()).filter_map(|set| results.faults(set)));
        Section {
            info: experiment.info(),
            // Plain structs of numbers and lists.
            parameters: serde_json::to_value(experiment).unwrap_or_default(),
            conditions: results.conditions.len(),
            ends,
            content,
            wall_s: measurement.wall_s,
            revisions: measurement.revisions.clone(),
        }
    }
}

/// The content of a report.
#[derive(Debug)]
pub struct Report<'a> {
    /// The names of all sets; claims and differences compare the first two.
    pub names: Vec<String>,
    /// The policies that were evaluated.
    pub policies: &'a PolicySets,
    /// The protocol: `full`, `quick` or a file name.
    pub protocol: String,
    /// The command line that makes this report.
    pub command: CommandLine,
    /// Notes about the policies.
    pub notes: Vec<String>,
    /// The finished experiments in the order of the protocol.
    pub sections: Vec<Section>,
    /// The experiments that are not finished.
    pub missing: Vec<ExperimentInfo>,
    /// E12: the experiments that were also run with estimated sensing.
    pub sensing: SensingComparison,
    /// Learning curves of the sets that are runs.
    pub curves: Vec<Figure>,
}

/// The sentence above the claims if no difference has a verdict.
const TOO_FEW: &str = "No difference has a verdict: each has fewer than five pairs of seeds, too few to tell.";

impl<'a> Report<'a> {
    /// Creates a report without experiments.
    pub fn new(policies: &'a PolicySets, protocol: String, command: CommandLine) -> Self {
        let (names, notes, sections) = (policies.names(), policies.notes.clone(), Vec::new());
        let sensing = SensingComparison::new(policies);
        Report { names, policies, protocol, command, notes, sections, missing: Vec::new(), sensing, curves: Vec::new() }
    }

    /// Adds a finished experiment. Notes about undisturbed walking (E0) concern all experiments and become notes of the report.
    pub fn add(&mut self, mut section: Section) {
        if section.info.number == 0 {
            self.notes.append(&mut section.content.notes);
        }
        self.sections.push(section);
    }

    /// Returns true if every difference that a verdict could be about has too few pairs of seeds.
    fn has_too_few_pairs(&self) -> bool {
        let claims = || self.sections.iter().flat_map(|section| &section.content.claims);
        let judged = [Verdict::AsExpected, Verdict::NoEffect, Verdict::Alike, Verdict::Opposite];
        claims().any(|claim| claim.verdict == Verdict::TooFew) && !claims().any(|claim| judged.contains(&claim.verdict))
    }

    /// Returns the time that all trials took, including those of E12 \[s\].
    fn wall_s(&self) -> f64 {
        self.sections.iter().map(|section| section.wall_s).sum::<f64>() + self.sensing.wall_s
    }

    /// Returns the revisions of the programs that measured.
    fn revisions(&self) -> Vec<&str> {
        let revisions = self.sections.iter().flat_map(|section| &section.revisions);
        revisions.map(String::as_str).collect::<BTreeSet<_>>().into_iter().collect()
    }

    /// Writes the page, `summary.json`, figures and tables into a folder, and returns why figures were not rendered as PNG.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write(&self, out: &Path) -> Result<Vec<ReportError>, ReportError> {
        let mut failed = Vec::new();
        let (figures, tables) = (out.join("figures"), out.join("tables"));
        for folder in [&*figures, &*tables, out] {
            fs::create_dir_all(folder).and_then(|()| files::clear_temporaries(folder)).map_err(fail(folder))?;
        }
        let no_sensing = self.sensing.experiments.is_empty().then_some("sensing");
        for name in self.missing.iter().map(|info| info.name).chain(no_sensing) {
            for folder in [&figures, &tables] {
                remove_outdated(name, folder).map_err(fail(folder))?;
            }
        }
        let renderer = Renderer::default();
        for figure in self.sections.iter().flat_map(|section| &section.content.figures).chain(&self.curves) {
            write(&figures.join(format!("{}.svg", figure.name)), figure.svg.as_bytes())?;
            failed.extend(write_png(&renderer, figure, &figures)?);
        }
        for section in &self.sections {
            for table in &section.content.tables {
                write_table(&tables, table, &self.names)?;
            }
            for lines in &section.content.lines {
                write(&tables.join(format!("{}.csv", lines.name)), csv_tables::points_csv(lines).as_bytes())?;
            }
        }
        for (table, names) in self.sensing.tables() {
            write_table(&tables, table, &names)?;
        }
        write(&tables.join("claims.csv"), csv_tables::claims_csv(self).as_bytes())?;
        write(&out.join("summary.json"), summary::json(self).as_bytes())?;
        write(&out.join("report.html"), html::page(self).as_bytes())?;
        Ok(failed)
    }

    /// Writes the table of claims as a Markdown document, and its figures into the folder `images` beside it. Returns why figures
    /// were not rendered.
    ///
    /// # Errors
    /// A file cannot be written.
    pub fn write_document(&self, path: &Path) -> Result<Vec<ReportError>, ReportError> {
        let mut failed = Vec::new();
        let images = path.with_file_name("images");
        let renderer = Renderer::default();
        for figure in self.figures_of_document() {
            fs::create_dir_all(&images).map_err(fail(&images))?;
            failed.extend(write_png(&renderer, figure, &images)?);
        }
        write(path, markdown::document(self).as_bytes())?;
        Ok(failed)
    }

    /// Returns the figures of the document: the decay of a push, and the map of push recovery.
    fn figures_of_document(&self) -> impl Iterator<Item = &Figure> {
        let all = || self.sections.iter().flat_map(|section| &section.content.figures);
        ["decay", "push-grid"].into_iter().filter_map(move |name| all().find(|figure| figure.name == name))
    }
}

/// Writes a figure as SVG and PNG.
///
/// # Errors
/// A file cannot be written, or the figure cannot be rendered.
pub fn write_figure(figure: &Figure, folder: &Path) -> Result<(), ReportError> {
    write(&folder.join(format!("{}.svg", figure.name)), figure.svg.as_bytes())?;
    write_png(&Renderer::default(), figure, folder)?.map_or(Ok(()), Err)
}

/// Writes a figure as PNG; returns why it cannot be rendered, if it cannot.
fn write_png(renderer: &Renderer, figure: &Figure, folder: &Path) -> Result<Option<ReportError>, ReportError> {
    let name = &figure.name;
    match renderer.png(&figure.svg) {
        Ok(png) => write(&folder.join(format!("{name}.png")), &png).map(|()| None),
        Err(error) => Ok(Some(ReportError::Figure(name.clone(), error))),
    }
}

fn write_table(folder: &Path, table: &Table, names: &[String]) -> Result<(), ReportError> {
    write(&folder.join(format!("{}.csv", table.name)), csv_tables::csv(table, names).as_bytes())?;
    write(&folder.join(format!("{}.md", table.name)), markdown::table(table, names).as_bytes())
}

/// Removes the figures or tables of an experiment that an earlier report of other policies wrote.
fn remove_outdated(experiment: &str, folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let is_of = stem.strip_prefix(experiment).is_some_and(|rest| rest.is_empty() || rest.starts_with('-'));
        let is_ours = path.extension().is_some_and(|e| ["svg", "png", "csv", "md"].iter().any(|ours| e == *ours));
        if is_of && is_ours {
            fs::remove_file(&path)?;
        }
    }
    Ok(())
}

pub(super) fn write(path: &Path, bytes: &[u8]) -> Result<(), ReportError> {
    Ok(files::write_atomically(path, bytes).map_err(fail(path))?)
}

/// Returns a function that creates the error of a file or folder of the report.
fn fail(path: &Path) -> impl Fn(io::Error) -> FileError {
    FileError::of("report", path)
}

/// Returns a duration in words.
pub fn duration(seconds: f64) -> String {
    match seconds.round() as u64 {
        seconds @ 0..60 => format!("{seconds} s"),
        seconds @ 60..3600 => format!("{} min {} s", seconds / 60, seconds % 60),
        seconds => format!("{} h {} min", seconds / 3600, seconds / 60 % 60),
    }
}
