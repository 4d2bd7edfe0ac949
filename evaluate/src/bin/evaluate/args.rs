//! The command line.

use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Parser, ValueEnum};
use supple::policy::compliance::policy_label;
use supple::robot::JointLosses;
use supple::scenario::Sensing;
use supple::util::terminal::shell_word;
use supple_evaluate::protocol::Protocol;

/// Compare sets of policies under disturbance, and write a report.
///
/// Runs the paper's experiments with every policy of all sets, on all cores, and writes report.html, figures, tables and
/// summary.json. Finished experiments are not repeated: a second call with the same policies only writes the report.
#[derive(Parser, Debug)]
#[command(name = env!("CARGO_BIN_NAME"), version = supple::provenance::version())]
pub struct Args {
    /// Experiments to run [default: all]
    #[arg(value_name = "EXPERIMENT", value_parser = experiments())]
    pub experiments: Vec<String>,
    /// Folder with policies NAME-seedN.safetensors of both sets [default: policies, else the shipped policies]
    #[arg(long, value_name = "DIR")]
    pub policies: Option<PathBuf>,
    /// First set, instead of --policies: a folder, a file, FOLDER/NAME for its files NAME-seedN, or a shipped policy's name;
    /// @C sets its commanded compliance in every trial (m/s/N)
    #[arg(long, value_name = "PATH[@C]", requires = "b", conflicts_with = "policies")]
    pub a: Option<PathBuf>,
    /// Second set, in the form of --a
    #[arg(long, value_name = "PATH[@C]", requires = "a")]
    pub b: Option<PathBuf>,
    /// Names of the two sets; the paper's claims are about the first [default: compliant,baseline, or the file names of --a and --b]
    #[arg(long, value_name = "A,B", value_delimiter = ',', num_args = 1)]
    pub names: Vec<String>,
    /// Examine one policy beside the shipped references instead: eight disciplines, up to twenty minutes, one page (exam.html, exam.png)
    #[arg(long, value_name = "PATH", conflicts_with_all = [
        "experiments", "policies", "a", "b", "names", "also", "quick", "joints", "sensing", "results",
    ])]
    pub exam: Option<PathBuf>,
    /// Draw the learning curves of runs instead, into the folder --out; runs/fast stands for all its seeds
    #[arg(long, value_name = "PATH", num_args = 1.., conflicts_with_all = [
        "exam", "experiments", "policies", "a", "names", "also", "quick", "protocol", "joints", "sensing", "results",
    ])]
    pub curves: Vec<PathBuf>,
    /// Name and path of a further set, shown beside the two that are compared; may be repeated
    #[arg(long, value_name = "NAME=PATH[@C]", value_parser = name_and_path)]
    pub also: Vec<(String, PathBuf)>,
    /// Folder of the report
    #[arg(long, value_name = "DIR", default_value = "report")]
    pub out: PathBuf,
    /// Use the quick protocol: fewer trials, grid points and directions
    #[arg(long, conflicts_with = "protocol")]
    pub quick: bool,
    /// YAML file with the values that differ from configs/evaluation/full.yaml, or from exam.yaml with --exam
    #[arg(long, value_name = "FILE")]
    pub protocol: Option<PathBuf>,
    /// Joint losses of all robots [default: as each policy was trained]
    #[arg(long, value_enum)]
    pub joints: Option<JointLosses>,
    /// State that the policies act on; `estimated` also runs all experiments on noisy sensors, for E12
    #[arg(long, value_enum, default_value_t)]
    pub sensing: Sensing,
    /// Repeat finished experiments
    #[arg(long)]
    pub again: bool,
    /// Number of threads [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub threads: Option<u16>,
    /// Also write the table of claims to this file, and figures to the folder `images` beside it
    #[arg(long, value_name = "FILE")]
    pub results: Option<PathBuf>,
}

/// The largest number of characters of a set's name.
pub const MOST_NAME: usize = 40;

/// The default folder of policies.
const POLICIES: &str = "policies";

impl Args {
    /// Returns the folder with policies of both sets; none for the shipped policies.
    pub fn folder(&self) -> Option<PathBuf> {
        self.policies.clone().or_else(|| Some(PathBuf::from(POLICIES)).filter(|folder| folder.is_dir()))
    }

    /// Returns the names of the two sets, as they were given or by default.
    pub fn names(&self) -> Vec<String> {
        match (&self.a, &self.b) {
            _ if !self.names.is_empty() => self.names.clone(),
            (Some(a), Some(b)) => [a, b].map(|path| label(path, MOST_NAME)).into(),
            _ => ["compliant", "baseline"].map(ToOwned::to_owned).into(),
        }
    }

    /// Returns the arguments that affect the report, except the experiments, each quoted for a shell.
    pub fn options(&self) -> Vec<String> {
        let mut options: Vec<(&str, OsString)> = Vec::new();
        match (&self.a, &self.b) {
            (Some(a), Some(b)) => options.extend([("--a", a.into()), ("--b", b.into())]),
            _ => options.extend(self.folder().map(|folder| ("--policies", folder.into()))),
        }
        options.extend((!self.names.is_empty()).then(|| ("--names", self.names.join(",").into())));
        let named = |(name, path): &(String, PathBuf)| [OsStr::new(name), path.as_os_str()].join(OsStr::new("="));
        options.extend(self.also.iter().map(|also| ("--also", named(also))));
        options.extend(self.protocol.iter().map(|file| ("--protocol", file.into())));
        let joints = self.joints.and_then(|joints| joints.to_possible_value());
        options.extend(joints.map(|joints| ("--joints", joints.get_name().into())));
        options.extend((self.sensing == Sensing::Estimated).then(|| ("--sensing", "estimated".into())));
        options.push(("--out", self.out.clone().into()));
        options.extend(self.results.iter().map(|file| ("--results", file.into())));
        let words = options.into_iter().flat_map(|(key, value)| [key.to_owned(), shell_word(value)]);
        self.quick.then(|| "--quick".to_owned()).into_iter().chain(words).collect()
    }
}

/// Returns the name of a policy or a set: its file name and compliance, up to `most` characters, without control characters.
pub fn label(path: &Path, most: usize) -> String {
    policy_label(&path.display().to_string()).chars().filter(|c| !c.is_control()).take(most).collect()
}

/// Parses `NAME=PATH`.
fn name_and_path(text: &str) -> Result<(String, PathBuf), String> {
    match text.split_once('=') {
        Some((name, path)) if !name.is_empty() && !path.is_empty() => Ok((name.to_owned(), PathBuf::from(path))),
        _ => Err("expected NAME=PATH, as in mine=my-policy.yaml".to_owned()),
    }
}

/// Returns a parser of experiment names, with their titles for the help.
fn experiments() -> impl TypedValueParser<Value = String> {
    // A test ensures that the protocol inside the program is valid.
    let protocol = Protocol::full().ok();
    let infos = protocol.iter().flat_map(|protocol| protocol.experiments()).map(|experiment| experiment.info());
    let value = |info: supple_evaluate::ExperimentInfo| {
        let paper = if info.paper.is_empty() { String::new() } else { format!(" ({})", info.paper) };
        PossibleValue::new(info.name).help(format!("{} {}{paper}", info.id, info.title))
    };
    PossibleValuesParser::new(infos.map(value).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sets_are_named_after_their_files_unless_names_are_given() {
        let names = |arguments: &[&str]| Args::parse_from([&["evaluate"], arguments].concat()).names();
        assert_eq!(names(&[]), ["compliant", "baseline"]);
        let pair = ["--a", "policies/real@0.01", "--b", "runs/mine-seed2"];
        assert_eq!(names(&pair), ["real@0.01", "mine-seed2"]);
        assert_eq!(names(&[&pair[..], &["--names", "soft,mine"]].concat()), ["soft", "mine"]);
    }

    #[test]
    fn options_are_those_that_affect_the_report() {
        let options = |arguments: &[&str]| Args::parse_from([&["evaluate"], arguments].concat()).options().join(" ");
        assert_eq!(options(&["walk", "--again", "--threads", "2", "--policies", "p"]), "--policies p --out report");
        let found = options(&["--a", "x", "--b", "it's", "--names", "A set,B", "--quick", "--sensing", "estimated"]);
        assert_eq!(found, "--quick --a x --b \"it's\" --names 'A set,B' --sensing estimated --out report");
        let found = options(&["--policies", "p", "--also", "mine=a b.yaml", "--also", "other=runs/3"]);
        assert_eq!(found, "--policies p --also 'mine=a b.yaml' --also 'other=runs/3' --out report");
    }
}
