/*! Learning curves of sets of runs: reward, `r_lin`, falls and power over samples and over minutes of training.

Each run is averaged over windows of a fiftieth of the longest run of all sets; a set's curve is the mean of its runs with their range, up
to the end of the shortest run.
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
use crate::statistics::mean;

/// Number of windows of the longest run.
const WINDOWS: usize = 50;

/// A value of an iteration.
type Value<T> = fn(&IterationMetrics) -> T;

/// The horizontal axes, each of a figure: name of the figure, label, and value of an iteration.
const AXES: [(&str, &str, Value<f64>); 2] = [
    ("learning-samples", "million samples", |it| it.samples as f64 * 1e-6),
    ("learning-minutes", "minutes", |it| it.time.elapsed_s / 60.0),
];

/// The panels: title, and value of an iteration if it has one.
const PANELS: [(&str, Value<Option<f64>>); 4] = [
    ("reward of a step", |it| Some(it.step_reward)),
    ("r_lin of walking stages", |it| it.means.walking_linear),
    ("episodes with a fall [%]", |it| it.means.fall_rate.map(|rate| 100.0 * rate)),
    ("power [W]", |it| it.means.terms?.fields().find(|(name, _)| *name == "energy").map(|(_, value)| value)),
];

/// The metrics of the runs of a set.
#[derive(Debug)]
pub struct LearningSet {
    /// The name in legends.
    pub name: String,
    /// The iterations of each run.
    pub runs: Vec<Vec<IterationMetrics>>,
}

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

    /// Reads the metrics of the folders that have some; `None` if no folder has.
    fn from_folders(name: &str, folders: &[PathBuf]) -> Result<Option<Self>, FileError> {
        let runs = folders.iter().filter(|folder| folder.join(METRICS).is_file()).map(|folder| metrics(folder));
        let runs = runs.collect::<Result<Vec<_>, _>>()?;
        Ok((!runs.is_empty()).then(|| LearningSet { name: name.to_owned(), runs }))
    }

    /// Returns the points (x, mean, least, largest) of a quantity over an axis, for windows of a width along x.
    fn curve(&self, x: Value<f64>, y: Value<Option<f64>>, width: f64) -> Vec<[f64; 4]> {
        let point = |window: usize| {
            let is_in = |it: &&IterationMetrics| (x(it) / width).ceil() as usize == window + 1;
            let means = self.runs.iter().map(|run| mean(run.iter().filter(is_in).filter_map(y)));
            curves::point((window as f64 + 0.5) * width, &means.collect::<Option<Vec<f64>>>()?)
        };
        (0..WINDOWS).filter_map(point).collect()
    }
}

/// Reads the metrics of those sets whose policies are in the folders of their runs.
///
/// # Errors
/// The metrics of a run cannot be read.
pub fn of_policies(policies: &PolicySets) -> Result<Vec<LearningSet>, FileError> {
    let read = |set: &PolicySet| {
        let folders = set.members.iter().filter_map(|it| Some(it.file.parent()?.to_owned()));
        LearningSet::from_folders(&set.name, &folders.collect::<Vec<_>>()).transpose()
    };
    policies.sets.iter().filter_map(read).collect()
}

/// Draws the curves of all sets over samples and over minutes; none if there are no sets.
pub fn figures(sets: &[LearningSet]) -> Vec<Figure> {
    let caption = "Learning curves: mean over the runs of a set, with their range.";
    let figure = |(name, label, x): (&str, &str, Value<f64>)| Figure {
        name: name.into(),
        caption: caption.into(),
        svg: draw(sets, label, x),
    };
    if sets.is_empty() { Vec::new() } else { AXES.map(figure).into() }
}

fn draw(sets: &[LearningSet], x_label: &str, x: Value<f64>) -> String {
    let (row, size) = (266.0, [310.0, 190.0]);
    let mut svg = Svg::new(WIDTH, 2.0 * row + 40.0);
    let names: Vec<String> = sets.iter().map(|set| set.name.clone()).collect();
    draw_legend(&mut svg, [0.5 * WIDTH, 22.0], &names);
    let ends = sets.iter().flat_map(|set| &set.runs).filter_map(|run| run.last());
    let end = ends.map(x).fold(f64::MIN_POSITIVE, f64::max);
    for (index, (title, y)) in PANELS.into_iter().enumerate() {
        let curves: Vec<_> = sets.iter().map(|set| set.curve(x, y, end / WINDOWS as f64)).collect();
        let y = range_from_zero(curves.iter().flatten().flat_map(|[.., least, largest]| [*least, *largest]));
        let corner = [54.0 + (index % 2) as f64 * (size[0] + 60.0), 64.0 + (index / 2) as f64 * row];
        let panel = Panel { corner, size, x: [0.0, end], y };
        panel.draw_axes(&mut svg, x_label, Some(""));
        panel.draw_title(&mut svg, title);
        for (set, points) in curves.iter().enumerate() {
            svg.area(&[&panel.band(points)], colour(set), BAND);
            svg.polyline(&panel.path(points, 1), line(set));
        }
    }
    svg.finish("Learning curves")
}
