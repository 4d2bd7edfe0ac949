//! Several runs as one: seeds of a configuration, and variants of it, as many at once as there are cores.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, ensure};
use supple::policy::Policy;
use supple::ranks::Alone;
use supple::util::progress::{MultiProgress, progress};
use supple::util::terminal;
use supple::util::yaml::{Text, layered};

use super::start::{configured, resume, start};
use super::{Args, train};

/// Largest number of runs that are trained together.
const MOST_RUNS: u64 = 1000;

/// A run of several: its folder is named in its arguments.
struct Planned {
    /// The folder's name, before each line about the run.
    name: String,
    args: Args,
    folder: PathBuf,
}

/// Trains the runs that the arguments name, and resumes those that exist.
///
/// # Errors
/// The arguments are wrong, or runs failed; all others are completed first.
pub fn train_all(args: &Args, cores: usize, stop: &AtomicBool, training: &AtomicBool) -> anyhow::Result<()> {
    let planned = planned(args)?;
    ensure!(!planned.is_empty(), "--vary names no variant");
    let at_once = args.at_once.map_or(cores, usize::from).min(planned.len());
    let threads = args.threads.map_or(cores / at_once, usize::from).max(1);
    let (bars, queue, failures) = (MultiProgress::new(), Mutex::new(planned.iter()), Mutex::new(Vec::new()));
    training.store(true, Ordering::Relaxed);
    let next = || queue.lock().unwrap_or_else(PoisonError::into_inner).next();
    std::thread::scope(|scope| {
        for _ in 0..at_once {
            scope.spawn(|| {
                while let Some(run) = next().filter(|_| !stop.load(Ordering::Relaxed)) {
                    match train_one(run, threads, stop, &bars) {
                        Ok(text) => bars.suspend(|| terminal::note(format_args!("{}: {text}", run.name))),
                        Err(error) => failures
                            .lock()
                            .unwrap_or_else(PoisonError::into_inner)
                            .push(error.context(run.name.clone())),
                    }
                }
            });
        }
    });
    let failures = failures.into_inner().unwrap_or_else(PoisonError::into_inner);
    let count = failures.len();
    for error in &failures {
        terminal::note(format_args!("error: {error:#}"));
    }
    ensure!(count == 0, "{count} of {} runs failed; the same command resumes the others", planned.len());
    if stop.load(Ordering::Relaxed) {
        terminal::note("stopped; the same command resumes the runs");
    }
    Ok(())
}

/// Trains a run to its end, from its checkpoint if there is one. Returns how far it has come.
fn train_one(run: &Planned, threads: usize, stop: &AtomicBool, bars: &MultiProgress) -> anyhow::Result<String> {
    let Planned { args, folder, name } = run;
    let mut args = args.clone();
    let ranks = Alone::shared();
    let is_new = folder.symlink_metadata().is_err();
    if !is_new {
        let (_, config) = configured(&args, false)?;
        args.samples = Some(config.run.samples);
        let policy = Policy::load(&folder.join("policy.safetensors")).ok();
        let done = policy.map(|policy| policy.provenance).filter(|it| it.samples >= config.run.samples);
        if let Some(done) = done.filter(|it| it.config.check_same(&config.without_folder()).is_ok()) {
            return Ok(format!("has its {} samples already", done.samples));
        }
    }
    let (mut trainer, mut opened) = match is_new {
        true => start(&args, threads, &AtomicBool::new(true), &ranks)?,
        false => resume(folder, &args, threads, &ranks)?,
    };
    let bar = bars.add(progress(trainer.run().config.run.samples)).with_prefix(format!("{name}: "));
    train(&mut trainer, &mut opened, stop, &bar)
}

/// Lists the runs: every seed of every variant, seed by seed.
fn planned(args: &Args) -> anyhow::Result<Vec<Planned>> {
    let seeds = args.seeds.clone().map_or_else(|| vec![args.seed.unwrap_or(0)], |Seeds(seeds)| seeds);
    let variants = args.vary.as_deref().map_or_else(|| Ok(vec![(String::new(), Vec::new())]), variants)?;
    let mut planned: Vec<Planned> = Vec::new();
    for seed in seeds {
        for (end, changes) in &variants {
            let mut args = Args { seed: Some(seed), seeds: None, vary: None, is_one_of_several: true, ..args.clone() };
            args.set.extend_from_slice(changes);
            let (name, _) = configured(&args, planned.is_empty())?;
            let set = args.out.clone().unwrap_or_else(|| Path::new("runs").join(name));
            let folder = PathBuf::from(format!("{}{end}-seed{seed}", set.display()));
            args.out = Some(folder.clone());
            let name = folder.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
            planned.push(Planned { name, args, folder });
        }
    }
    Ok(planned)
}

/// Seeds of several runs.
#[derive(Debug, Clone, PartialEq)]
pub struct Seeds(Vec<u64>);

impl Seeds {
    /// Reads seeds such as `0-4` or `0,3,7`.
    pub fn parse(text: &str) -> Result<Self, String> {
        let range = |part: &str| {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            let [first, last] = [first.trim().parse().ok()?, last.trim().parse().ok()?];
            (first <= last && last - first < MOST_RUNS).then_some(first..=last)
        };
        let ranges: Option<Vec<_>> = text.split(',').map(range).collect();
        let mut seeds: Vec<u64> =
            ranges.ok_or("expected numbers and ranges, such as 0-4 or 0,3,7")?.into_iter().flatten().collect();
        seeds.sort_unstable();
        match seeds.windows(2).find(|pair| pair[0] == pair[1]) {
            Some(pair) => Err(format!("seed {} is given twice", pair[0])),
            None => Ok(Seeds(seeds)),
        }
    }
}

/// Reads the variants: `KEY=VALUE,VALUE,…`, or a YAML file of names, each with the keys that it changes. A variant is the end of
/// its name, and the changed keys, each as `KEY=VALUE`.
fn variants(text: &str) -> anyhow::Result<Vec<(String, Vec<String>)>> {
    if let Some((key, values)) = text.split_once('=') {
        let variant = |value: &str| (format!("-{key}={value}"), vec![format!("{key}={value}")]);
        return Ok(values.split(',').map(|value| variant(value.trim())).collect());
    }
    let expected = || {
        format!(
            "--vary is '{text}', expected KEY=VALUE,VALUE,… or a YAML file of variants, such as \
             'soft: {{reward.energy: -0.01, ppo.epochs: 4}}'"
        )
    };
    let file = Text::read(Path::new(text)).with_context(expected)?;
    let named: BTreeMap<String, BTreeMap<String, serde_json::Value>> = layered(&[file]).with_context(expected)?;
    let change = |(key, value): (String, serde_json::Value)| format!("{key}={value}");
    Ok(named.into_iter().map(|(name, keys)| (format!("-{name}"), keys.into_iter().map(change).collect())).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_numbers_and_ranges() {
        assert_eq!(Seeds::parse("7,0-2").unwrap(), Seeds(vec![0, 1, 2, 7]));
        assert_eq!(Seeds::parse("5").unwrap(), Seeds(vec![5]));
        for wrong in ["", "a", "3-1", "0-", "-1", "0-99999999"] {
            assert!(Seeds::parse(wrong).is_err(), "{wrong}");
        }
        assert!(Seeds::parse("1,0-2").unwrap_err().contains("seed 1 is given twice"));
    }

    #[test]
    fn variants_are_values_of_a_key_or_names_in_a_file() {
        let change = |end: &str, changes: &[&str]| (end.to_owned(), changes.iter().map(ToString::to_string).collect());
        let expected = ["-0.01", "-0.02"].map(|value| {
            let key = format!("reward.energy={value}");
            change(&format!("-{key}"), &[&key])
        });
        assert_eq!(variants("reward.energy=-0.01, -0.02").unwrap(), expected);
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("variants.yaml");
        std::fs::write(&file, "soft: {reward.energy: -0.01, ppo.hidden_layers: [32, 16]}\nplain: {}\n").unwrap();
        let [plain, soft] = &variants(file.to_str().unwrap()).unwrap()[..] else { panic!() };
        assert_eq!((plain.0.as_str(), plain.1.len()), ("-plain", 0));
        assert_eq!(soft.1, ["ppo.hidden_layers=[32,16]", "reward.energy=-0.01"]);
        assert!(variants("nothing").unwrap_err().to_string().contains("expected KEY=VALUE"));
    }
}
