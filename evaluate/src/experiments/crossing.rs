//! The measurements of a walk across loose obstacles, shared by E7 and E11a.

use super::prelude::*;
use crate::trial::TrialEnd;

/// The numbers of a trial across obstacles.
pub(super) struct Crossing {
    /// True if the robot got across, and nothing failed until the end of the trial.
    pub(super) is_across: bool,
    /// The times at which the trunk passed the first and the last edge \[s\]; none if it did not get across.
    pub(super) times_s: Option<[f64; 2]>,
    /// The largest force on a foot between these times \[N\].
    pub(super) peak_foot_force_n: Option<f64>,
    /// The mean power between these times \[W\].
    pub(super) power_w: Option<f64>,
}

impl Crossing {
    /// Measures a trial with obstacles between two places ahead \[m\].
    pub(super) fn new(trial: &Trial, first_edge_m: f64, last_edge_m: f64) -> Self {
        let is_across = trial.end != TrialEnd::Fault && trial.metric("crossed") == Some(1.0);
        let times_s = metrics::crossing(trial.trace, first_edge_m, last_edge_m).filter(|_| is_across);
        let frames = times_s.into_iter().flat_map(|[from_s, to_s]| metrics::window(trial.trace, from_s, to_s));
        let peak_foot_force_n = metrics::largest(frames.clone(), |frame| frame.peak_foot_force_n);
        Crossing { is_across, times_s, peak_foot_force_n, power_w: metrics::mean(frames, |frame| frame.power_w) }
    }
}
