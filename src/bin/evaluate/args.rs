//! The command line.

use std::path::PathBuf;

use clap::Parser;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use supple::scenario::Sensing;

/// The experiments by name, with what they are.
const EXPERIMENTS: [(&str, &str); 13] = [
    ("walk", "E0: walking undisturbed"),
    ("push-grid", "E1, Fig. 2: success over a grid of pushes"),
    ("decay", "E2, Fig. 3: decay of a sideways push"),
    ("table4", "E3, Table IV: power and torque of a sideways push"),
    ("directions", "E4, Fig. 4: decay of pushes from all sides"),
    ("leash", "E5, Fig. 5: offset under a constant pull"),
    ("box", "E6, Fig. 6: collision with a box"),
    ("ball-pit", "E7, Fig. 7a: crossing a ball pit"),
    ("terrain", "E8, Fig. 7b: uneven terrain"),
    ("pulley", "E9, Fig. 8a: a weight over a pulley"),
    ("pendulum", "E10, Fig. 8b: a swinging ball"),
    ("rubble", "E11a, Fig. 8c: wooden blocks and soft mats"),
    ("outdoor", "E11b, Fig. 8d: hills of varied friction"),
];

/// Compare two sets of policies under disturbance, and write a report.
///
/// Runs the paper's experiments with every policy of both sets, on all cores, and writes report.html, figures, tables and
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
    /// Folder (or file) with the first set, instead of --policies
    #[arg(long, value_name = "DIR", requires = "b", conflicts_with = "policies")]
    pub a: Option<PathBuf>,
    /// Folder (or file) with the second set
    #[arg(long, value_name = "DIR", requires = "a")]
    pub b: Option<PathBuf>,
    /// Names of the two sets; the paper's claims are about the first
    #[arg(long, value_name = "A,B", value_delimiter = ',', num_args = 1, default_value = "compliant,baseline")]
    pub names: Vec<String>,
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
    /// Also write the table of claims to this file
    #[arg(long, value_name = "FILE")]
    pub results: Option<PathBuf>,
}

fn experiments() -> impl TypedValueParser<Value = String> {
    PossibleValuesParser::new(EXPERIMENTS.map(|(name, help)| PossibleValue::new(name).help(help)))
}
