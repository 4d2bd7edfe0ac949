//! The command line.

use std::path::PathBuf;

use clap::Parser;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use supple::scenario::Sensing;
use supple_evaluate::protocol::Protocol;

/// Compare sets of policies under disturbance, and write a report.
///
/// Runs the paper's experiments with every policy of all sets, on all cores, and writes report.html, figures, tables and
/// summary.json. What is finished is not run again: a second call with the same policies only writes the report.
#[derive(Parser, Debug)]
#[command(version)]
pub struct Args {
    /// Experiments to run [default: all]
    #[arg(value_name = "EXPERIMENT", value_parser = experiments())]
    pub experiments: Vec<String>,
    /// Folder with policies NAME-seedN.safetensors of both sets
    #[arg(long, value_name = "DIR", default_value = "policies")]
    pub policies: PathBuf,
    /// First set, instead of --policies: a folder, a file, FOLDER/NAME for its files NAME-seedN; with @C behind it, every
    /// trial commands it the compliance C (m/s/N)
    #[arg(long, value_name = "PATH[@C]", requires = "b", conflicts_with = "policies")]
    pub a: Option<PathBuf>,
    /// Second set, likewise
    #[arg(long, value_name = "PATH[@C]", requires = "a")]
    pub b: Option<PathBuf>,
    /// Names of the two sets; the paper's claims are about the first
    #[arg(long, value_name = "A,B", value_delimiter = ',', num_args = 1, default_value = "compliant,baseline")]
    pub names: Vec<String>,
    /// A further set, shown beside the two that are compared: its name, and where it is; may be repeated
    #[arg(long, value_name = "NAME=PATH[@C]", value_parser = name_and_path)]
    pub also: Vec<(String, PathBuf)>,
    /// Folder of the report
    #[arg(long, value_name = "DIR", default_value = "report")]
    pub out: PathBuf,
    /// A coarse version of everything: fewer trials, grid points and directions
    #[arg(long, conflicts_with = "protocol")]
    pub quick: bool,
    /// YAML file with what differs from configs/evaluation/full.yaml
    #[arg(long, value_name = "FILE")]
    pub protocol: Option<PathBuf>,
    /// `estimated` runs the experiments a second time on noisy sensors, for E12
    #[arg(long, value_enum, default_value_t)]
    pub sensing: Sensing,
    /// Run finished experiments again
    #[arg(long)]
    pub again: bool,
    /// Threads [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    /// Also write the table of claims to this file, and figures to the folder `images` beside it
    #[arg(long, value_name = "FILE")]
    pub results: Option<PathBuf>,
}

impl Args {
    /// The arguments that decide what a report shows, each quoted for a shell; without the experiments.
    pub fn options(&self) -> Vec<String> {
        let path = |path: &PathBuf| path.display().to_string();
        let sets = match (&self.a, &self.b) {
            (Some(a), Some(b)) => vec![("--a", path(a)), ("--b", path(b))],
            _ => vec![("--policies", path(&self.policies))],
        };
        let names = (self.names != ["compliant", "baseline"]).then(|| ("--names", self.names.join(",")));
        let also = self.also.iter().map(|(name, file)| ("--also", format!("{name}={}", file.display())));
        let protocol = self.protocol.iter().map(|file| ("--protocol", path(file)));
        let sensing = (self.sensing == Sensing::Estimated).then(|| ("--sensing", "estimated".to_owned()));
        let results = self.results.iter().map(|file| ("--results", path(file)));
        let quick = self.quick.then(|| "--quick".to_owned());
        let pairs = sets.into_iter().chain(names).chain(also).chain(protocol).chain(sensing);
        let pairs = pairs.chain([("--out", path(&self.out))]).chain(results);
        let words = pairs.flat_map(|(key, value)| [key.to_owned(), quoted(&value)]);
        quick.into_iter().chain(words).collect()
    }
}

/// `NAME=PATH`.
fn name_and_path(text: &str) -> Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((name, path)) if !name.is_empty() && !path.is_empty() => Ok((name.to_owned(), path.into())),
        _ => Err("expected NAME=PATH, as in mine=my-policy.yaml".to_owned()),
    }
}

/// For a POSIX shell.
fn quoted(word: &str) -> String {
    // An argument has no zero byte, the one thing that cannot be quoted.
    shlex::try_quote(word).map_or_else(|_| word.to_owned(), Into::into)
}

/// The experiments by name, with what they are.
fn experiments() -> impl TypedValueParser<Value = String> {
    // The protocol inside the program is valid: a test reads it.
    let protocol = Protocol::full().ok();
    let infos = protocol.iter().flat_map(|protocol| protocol.experiments()).map(|experiment| experiment.info());
    let value = |info: supple_evaluate::Info| {
        PossibleValue::new(info.name).help(format!("{}, {}: {}", info.id, info.paper, info.title))
    };
    PossibleValuesParser::new(infos.map(value).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_report_tells_the_arguments_that_decide_what_it_shows() {
        let options = |arguments: &[&str]| Args::parse_from([&["evaluate"], arguments].concat()).options().join(" ");
        assert_eq!(options(&["walk", "--again", "--threads", "2"]), "--policies policies --out report");
        assert_eq!(
            options(&["--a", "x", "--b", "it's", "--names", "A set,B", "--quick", "--sensing", "estimated"]),
            "--quick --a x --b \"it's\" --names 'A set,B' --sensing estimated --out report"
        );
        assert_eq!(
            options(&["--also", "mine=a b.yaml", "--also", "other=runs/3"]),
            "--policies policies --also 'mine=a b.yaml' --also 'other=runs/3' --out report"
        );
    }
}
