//! The command line.

use std::ffi::OsStr;
use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Parser, ValueEnum};
use supple::robot::JointLosses;
use supple::scenario::Sensing;
use supple::util::paths;
use supple::util::terminal::{path_as_text, shell_word};
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
    /// Folder with policies NAME-seedN.safetensors of both sets [default: policies, or those that ship where there is none]
    #[arg(long, value_name = "DIR")]
    pub policies: Option<PathBuf>,
    /// First set, instead of --policies: a folder, a file, FOLDER/NAME for its files NAME-seedN, or a shipped policy's name;
    /// with @C behind it, every trial commands it the compliance C (m/s/N)
    #[arg(long, value_name = "PATH[@C]", requires = "b", conflicts_with = "policies")]
    pub a: Option<PathBuf>,
    /// Second set, likewise
    #[arg(long, value_name = "PATH[@C]", requires = "a")]
    pub b: Option<PathBuf>,
    /// Names of the two sets; the paper's claims are about the first
    #[arg(long, value_name = "A,B", value_delimiter = ',', num_args = 1, default_value = "compliant,baseline")]
    pub names: Vec<String>,
    /// A further set, shown beside the two that are compared: its name, and where it is; may be repeated
    #[arg(long, value_name = "NAME=PATH[@C]", value_parser = path_as_text().try_map(name_and_path))]
    pub also: Vec<(String, PathBuf)>,
    /// The folder of another report, whose numbers are shown beside these: what it is called, and where it is; may be repeated
    #[arg(long, value_name = "NAME=DIR", value_parser = path_as_text().try_map(name_and_path))]
    pub beside: Vec<(String, PathBuf)>,
    /// Folder of the report
    #[arg(long, value_name = "DIR", default_value = "report")]
    pub out: PathBuf,
    /// A coarse version of everything: fewer trials, grid points and directions
    #[arg(long, conflicts_with = "protocol")]
    pub quick: bool,
    /// YAML file with what differs from configs/evaluation/full.yaml
    #[arg(long, value_name = "FILE")]
    pub protocol: Option<PathBuf>,
    /// Losses in the joints of all robots [default: as each policy was trained]
    #[arg(long, value_enum)]
    pub joints: Option<JointLosses>,
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

/// The folder of policies, if none is given.
const POLICIES: &str = "policies";

impl Args {
    /// The folder with policies of both sets; none if it is those that ship.
    pub fn folder(&self) -> Option<PathBuf> {
        self.policies.clone().or_else(|| Some(PathBuf::from(POLICIES)).filter(|folder| folder.is_dir()))
    }

    /// The arguments that decide what a report shows, each quoted for a shell; without the experiments.
    pub fn options(&self) -> Vec<String> {
        let path = |path: &PathBuf| shell_word(path);
        let sets = match (&self.a, &self.b) {
            (Some(a), Some(b)) => vec![("--a", path(a)), ("--b", path(b))],
            _ => self.folder().iter().map(|folder| ("--policies", path(folder))).collect(),
        };
        let names = (self.names != ["compliant", "baseline"]).then(|| ("--names", shell_word(self.names.join(","))));
        let named = |flag| {
            move |(name, path): &(String, PathBuf)| {
                (flag, shell_word([OsStr::new(name), path.as_os_str()].join(OsStr::new("="))))
            }
        };
        let also = self.also.iter().map(named("--also"));
        let beside = self.beside.iter().map(named("--beside"));
        let protocol = self.protocol.iter().map(|file| ("--protocol", path(file)));
        let joints = self
            .joints
            .iter()
            .filter_map(|joints| Some(("--joints", joints.to_possible_value()?.get_name().to_owned())));
        let sensing = (self.sensing == Sensing::Estimated).then(|| ("--sensing", "estimated".to_owned()));
        let results = self.results.iter().map(|file| ("--results", path(file)));
        let quick = self.quick.then(|| "--quick".to_owned());
        let pairs =
            sets.into_iter().chain(names).chain(also).chain(protocol).chain(joints).chain(sensing).chain(beside);
        let pairs = pairs.chain([("--out", path(&self.out))]).chain(results);
        let words = pairs.flat_map(|(key, value)| [key.to_owned(), value]);
        quick.into_iter().chain(words).collect()
    }
}

/// `NAME=PATH`.
fn name_and_path(text: String) -> Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((name, path)) if !name.is_empty() && !path.is_empty() => Ok((name.to_owned(), paths::as_path(path))),
        _ => Err("expected NAME=PATH, as in mine=my-policy.yaml".to_owned()),
    }
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
        assert_eq!(options(&["walk", "--again", "--threads", "2", "--policies", "p"]), "--policies p --out report");
        assert_eq!(
            options(&["--a", "x", "--b", "it's", "--names", "A set,B", "--quick", "--sensing", "estimated"]),
            "--quick --a x --b \"it's\" --names 'A set,B' --sensing estimated --out report"
        );
        assert_eq!(
            options(&["--policies", "p", "--also", "mine=a b.yaml", "--also", "other=runs/3", "--beside", "Go2=go2"]),
            "--policies p --also 'mine=a b.yaml' --also 'other=runs/3' --beside 'Go2=go2' --out report"
        );
    }
}
