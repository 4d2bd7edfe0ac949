//! The program `evaluate`: every figure and table of the paper for sets of policies.

mod args;
mod progress;

use std::path::Path;
use std::process::ExitCode;

use anyhow::Context;
use args::{Args, MOST_NAME, label};
use clap::Parser;
use supple::scenario::Sensing;
use supple::util::files::Target;
use supple::util::progress::columns;
use supple::util::terminal::{self, shell_word};
use supple_evaluate::exam::{Exam, Part, page};
use supple_evaluate::learning_curves::{self, LearningSet};
use supple_evaluate::measurement_store::MeasurementStore;
use supple_evaluate::policy_sets::{PolicySet, PolicySets};
use supple_evaluate::protocol::Protocol;
use supple_evaluate::report::{self, CommandLine, Report, text};
use supple_evaluate::runner::{self, Settings};
use supple_evaluate::study::Study;

fn main() -> ExitCode {
    supple::robot::isolate_imports();
    supple::announce_revision!();
    terminal::conclude(run(&Args::parse()))
}

fn run(args: &Args) -> anyhow::Result<()> {
    // A wrong path fails now, not after minutes of work.
    if let Some(path) = &args.results {
        let at = || format!("--results {}", path.display());
        Target::of(path).with_context(at)?;
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        anyhow::ensure!(folder.is_none_or(Path::is_dir), "{}: its folder does not exist; create it", at());
    }
    if let Some(policy) = &args.exam {
        return examine(policy, args);
    }
    if !args.curves.is_empty() {
        return draw_curves(args);
    }
    let (name, protocol) = protocol(args)?;
    let policies = policies(args)?;
    if let (Sensing::Estimated, Some(rates)) = (args.sensing, PolicySet::cannot_sense(&policies.sets[..2])) {
        anyhow::bail!("--sensing estimated cannot be played: {rates}; leave it out");
    }
    let command = CommandLine { experiments: args.experiments.clone(), options: args.options() };
    let curves = learning_curves::figures(&learning_curves::of_policies(&policies)?);
    let mut report = Report { curves, ..Report::new(&policies, name, command) };
    let on_sensors = report.sensing.notes.iter().filter(|_| args.sensing == Sensing::Estimated);
    policies.notes.iter().chain(on_sensors).for_each(|note| terminal::note(format_args!("note: {note}")));
    prepare(args)?;
    let study = Study::new(&protocol, &policies.sets, &args.out, args.again);
    study.measure(&args.experiments, args.sensing, progress::run)?;
    let _lock = MeasurementStore::new(&args.out).lock_report(progress::waits)?;
    let faults = study.add_to(&mut report)?;
    let mut failed = report.write(&args.out)?;
    if let Some(path) = &args.results {
        failed.extend(report.write_document(path)?);
    }
    failed.iter().for_each(|error| terminal::note(format_args!("warning: {}", terminal::complaint(error))));
    let claims = text::claims(&report, columns(std::io::stdout()));
    terminal::print(format_args!("{claims}\n{}\n", args.out.join("report.html").display()))?;
    let Some((last, others)) = faults.split_last() else { return Ok(()) };
    others.iter().for_each(|fault| terminal::note(format_args!("error: {fault}")));
    anyhow::bail!("{last}")
}

/// Makes the folder of the report and starts the threads.
fn prepare(args: &Args) -> anyhow::Result<()> {
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot create the folder {}", args.out.display()))?;
    // Zero threads mean all cores.
    let threads = args.threads.map_or(0, usize::from);
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("cannot start threads")
}

/// Draws the learning curves of runs.
fn draw_curves(args: &Args) -> anyhow::Result<()> {
    let sets = args
        .curves
        .iter()
        .map(|path| LearningSet::read(&label(path, MOST_NAME), path))
        .collect::<Result<Vec<_>, _>>()?;
    std::fs::create_dir_all(&args.out).with_context(|| format!("cannot create the folder {}", args.out.display()))?;
    for figure in learning_curves::figures(&sets) {
        report::write_figure(&figure, &args.out)?;
        terminal::print(format_args!("{}.png\n", args.out.join(figure.name).display()))?;
    }
    Ok(())
}

/// Examines one policy beside the shipped references.
fn examine(policy: &Path, args: &Args) -> anyhow::Result<()> {
    let exam = Exam::new(&label(policy, usize::MAX), policy, Protocol::exam(args.protocol.as_deref())?)?;
    exam.notes.iter().for_each(|note| terminal::note(format_args!("note: {note}")));
    prepare(args)?;
    let store = MeasurementStore::new(&args.out);
    let settings = |sensing| Settings { again: args.again, sensing, store: store.clone() };
    let [on_state, on_sensors] = [Sensing::True, Sensing::Estimated].map(settings);
    let mut jobs = Vec::new();
    for Part { experiment, policies, sensing, way } in exam.parts() {
        let settings = if sensing == Sensing::Estimated { &on_sensors } else { &on_state };
        jobs.extend(runner::jobs(experiment, policies, settings, way)?);
    }
    progress::run(&jobs)?;
    let mut options = vec!["--exam".to_owned(), shell_word(policy)];
    options.extend(args.protocol.iter().flat_map(|file| ["--protocol".to_owned(), shell_word(file)]));
    options.extend(["--out".to_owned(), shell_word(&args.out)]);
    let command = CommandLine { experiments: Vec::new(), options };
    let _lock = store.lock_report(progress::waits)?;
    let examination = exam.grade(&store, command.text(None))?;
    let film = exam.first_fall(&store).unwrap_or_else(|error| {
        terminal::note(format_args!("note: no film of a fall: {error}"));
        None
    });
    page::save(&examination, film.as_ref(), &args.out)?;
    let scores = page::text(&examination, columns(std::io::stdout()));
    terminal::print(format_args!("{scores}\n{}\n", args.out.join("exam.html").display()))?;
    anyhow::ensure!(examination.faults.is_empty(), "{}", examination.faults.join("\n"));
    Ok(())
}

/// Returns the protocol and its name in the report.
fn protocol(args: &Args) -> anyhow::Result<(String, Protocol)> {
    Ok(match &args.protocol {
        Some(path) => (path.file_name().unwrap_or_default().to_string_lossy().into_owned(), Protocol::load(path)?),
        None if args.quick => ("quick".to_owned(), Protocol::quick()?),
        None => ("full".to_owned(), Protocol::full()?),
    })
}

/// Reads the two sets that are compared, and further ones.
fn policies(args: &Args) -> anyhow::Result<PolicySets> {
    let names = args.names();
    let [first, second] = &names[..] else { anyhow::bail!("--names gives {} names, expected two: A,B", names.len()) };
    let are_names = first != second && !first.is_empty() && !second.is_empty();
    anyhow::ensure!(are_names, "the sets are named {names:?}, expected two different names: give --names A,B");
    let further = args.also.iter().map(|(name, _)| ("--also", name));
    for (flag, name) in names.iter().map(|name| ("--names", name)).chain(further) {
        anyhow::ensure!(
            name.chars().count() <= MOST_NAME && !name.contains(char::is_control),
            "{flag}: the name {name:?} has {} characters, expected at most {MOST_NAME}, and no line end or other control \
             character: it is printed in figures",
            name.chars().count()
        );
    }
    for (index, (name, _)) in args.also.iter().enumerate() {
        let is_taken = names.contains(name) || args.also[..index].iter().any(|(other, _)| other == name);
        anyhow::ensure!(!is_taken, "--also {name}: another set has this name; choose a new one");
    }
    let mut policies = match (&args.a, &args.b) {
        (Some(a), Some(b)) => {
            let pair = [(first.clone(), a.clone()), (second.clone(), b.clone())];
            PolicySets::from_paths(&[&pair[..], &args.also].concat())?
        }
        _ => PolicySets::from_folder(args.folder().as_deref(), &names, &args.also)?,
    };
    if let Some(joints) = args.joints {
        policies.set_losses(joints.into());
    }
    Ok(policies)
}
