/*! Learning curves of sets of runs: reward, `r_lin`, falls and power over samples and over minutes of training.

Each run is averaged over windows of a fiftieth of the longest run of all sets; a set's curve is the mean of its runs with their
range, as far as all of them have come.
*/

use std::path::{Path, PathBuf};

use supple::policy::shipped;
use supple::train::metrics::IterationMetrics;
use supple::train::run::{METRICS, metrics};
use supple::util::files::FileError;

use crate::plot::axes::{Panel, draw_legend, range_from_zero};
use crate::plot::curves;
use crate::plot::svg::Svg;
use crate::plot::{BAND, WIDTH, colour, line};
use crate::policy_sets::{PolicySet, PolicySets};
use crate::section_content::Figure;

/// Number of windows of the longest run.
const WINDOWS: usize = 50;

/// The horizontal axis of the curves.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Over {
    /// Millions of samples.
    Samples,
    /// Minutes of training.
    Minutes,
}

impl Over {
    /// Both, with the names of their figures.
    pub const ALL: [(Over, &str); 2] = [(Over::Samples, "learning-samples"), (Over::Minutes, "learning-minutes")];

    fn at(self, metrics: &IterationMetrics) -> f64 {
        match self {
            Over::Samples => metrics.samples as f64 * 1e-6,
            Over::Minutes => metrics.time.elapsed_s / 60.0,
        }
    }
}

/// The metrics of the runs of a set.
#[derive(Debug)]
pub struct LearningSet {
    /// The name in legends.
    pub name: String,
    /// The iterations of each run.
    pub runs: Vec<Vec<IterationMetrics>>,
}

/// A panel: title, value of an iteration if it has one.
type Quantity = (&'static str, fn(&IterationMetrics) -> Option<f64>);

/// The panels.
const QUANTITIES: [Quantity; 4] = [
    ("reward of a step", |it| Some(it.step_reward)),
    ("r_lin of walking stages", |it| it.means.walking_linear),
    ("episodes with a fall [%]", |it| it.means.fall_rate.map(|rate| 100.0 * rate)),
    ("power [W]", |it| it.means.terms?.fields().find(|(name, _)| *name == "energy").map(|(_, value)| value)),
];

impl LearningSet {
    /// Reads the metrics of a run's folder, or of the runs of a set such as `runs/fast`.
    ///
    /// # Errors
    /// There is no run, or its metrics cannot be read.
    pub fn read(name: &str, path: &Path) -> Result<Self, FileError> {
        let seeds = shipped::seeds_at(path).into_iter().filter_map(|(_, file)| Some(file.parent()?.to_owned()));
        let folders = if path.is_dir() { vec![path.to_owned()] } else { seeds.collect() };
        let found = Self::from_folders(name, &folders)?;
        found.ok_or_else(|| {
            FileError::of("run", path)("it has no metrics: give a run's folder, or the common name of runs")
        })
    }

    /// Reads the metrics of those folders that have some; `None` if none has.
    fn from_folders(name: &str, folders: &[PathBuf]) -> Result<Option<Self>, FileError> {
        let runs = folders.iter().filter(|folder| folder.join(METRICS).is_file()).map(|folder| metrics(folder));
        let runs = runs.collect::<Result<Vec<_>, _>>()?;
        Ok((!runs.is_empty()).then(|| LearningSet { name: name.to_owned(), runs }))
    }

    /// Returns the points (x, mean, least, largest) of a quantity, for windows of a width.
    fn curve(&self, over: Over, width: f64, quantity: Quantity) -> Vec<[f64; 4]> {
        let mean = |run: &Vec<IterationMetrics>, window: usize| {
            let is_in = |it: &&IterationMetrics| (over.at(it) / width).ceil() as usize == window + 1;
            crate::statistics::mean(run.iter().filter(is_in).filter_map(quantity.1))
        };
        let point = |window: usize| {
            let values: Vec<f64> = self.runs.iter().map(|run| mean(run, window)).collect::<Option<_>>()?;
            curves::point((window as f64 + 0.5) * width, &values)
        };
        (0..WINDOWS).filter_map(point).collect()
    }
}

/// Draws the curves of those sets whose policies are in the folders of their runs, with captions; none if there are none.
///
/// # Errors
/// The metrics of a run cannot be read.
pub fn figures(policies: &PolicySets) -> Result<Vec<Figure>, FileError> {
    let read = |set: &PolicySet| {
        let folders = set.members.iter().filter_map(|it| Some(it.file.parent()?.to_owned()));
        LearningSet::from_folders(&set.name, &folders.collect::<Vec<_>>()).transpose()
    };
    let sets: Vec<LearningSet> = policies.sets.iter().filter_map(read).collect::<Result<_, _>>()?;
    let caption = "Learning curves: mean over the runs of a set, with their range.";
    let figure =
        |(over, name): (Over, &str)| Figure { name: name.into(), caption: caption.into(), svg: draw(&sets, over) };
    Ok(if sets.is_empty() { Vec::new() } else { Over::ALL.map(figure).into() })
}

/// Draws the curves of all sets as SVG.
pub fn draw(sets: &[LearningSet], over: Over) -> String {
    let (row, size) = (266.0, [310.0, 190.0]);
    let mut svg = Svg::new(WIDTH, 2.0 * row + 40.0);
    let names: Vec<String> = sets.iter().map(|set| set.name.clone()).collect();
    draw_legend(&mut svg, [0.5 * WIDTH, 22.0], &names);
    let ends = sets.iter().flat_map(|set| &set.runs).filter_map(|run| run.last());
    let end = ends.map(|last| over.at(last)).fold(f64::MIN_POSITIVE, f64::max);
    let x_label = if over == Over::Samples { "million samples" } else { "minutes" };
    for (index, quantity) in QUANTITIES.into_iter().enumerate() {
        let curves: Vec<_> = sets.iter().map(|set| set.curve(over, end / WINDOWS as f64, quantity)).collect();
        let y = range_from_zero(curves.iter().flatten().flat_map(|[.., least, largest]| [*least, *largest]));
        let corner = [54.0 + (index % 2) as f64 * (size[0] + 60.0), 64.0 + (index / 2) as f64 * row];
        let panel = Panel { corner, size, x: [0.0, end], y };
        panel.draw_axes(&mut svg, x_label, Some(""));
        panel.draw_title(&mut svg, quantity.0);
        for (set, points) in curves.iter().enumerate() {
            let path = |column: usize| points.iter().map(move |point| panel.at([point[0], point[column]]));
            svg.area(&[&path(3).chain(path(2).rev()).collect::<Vec<_>>()], colour(set), BAND);
            svg.polyline(&path(1).collect::<Vec<_>>(), line(set));
        }
    }
    svg.finish("Learning curves")
}
