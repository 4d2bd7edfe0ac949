//! Errors of the state estimate, computed from a trace by pure functions.

use serde::{Deserialize, Serialize};

use super::metrics::Metric;
use crate::estimate::contact::score::Confusion;
use crate::scenario::trace::{Felt, Frame, Sensed, Trace};

/// Errors of the state estimate over all frames before the first fall.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Estimation {
    /// Root mean square of the velocity's error, base frame [m/s].
    pub velocity_rmse_m_s: f64,
    /// Root mean square of the height's error \[m\].
    pub height_rmse_m: f64,
    /// Horizontal error of the position in the last of these frames \[m\].
    pub drift_m: f64,
    /// F1 score of the contacts of all feet at the ends of the policy steps; `None` without any contact.
    pub contact_f1: Option<f64>,
}

impl Estimation {
    /// Computes the errors; `None` if the robot acted on the true state, or fell at once.
    pub fn of(trace: &Trace) -> Option<Self> {
        let until_s = trace.fall().map_or(f64::INFINITY, |fall| fall.time_s);
        let frames: Vec<(&Frame, &Sensed)> =
            trace.frames.iter().filter(|f| f.time_s <= until_s).filter_map(|f| Some((f, f.sensed.as_ref()?))).collect();
        let (last, believed) = frames.last()?;
        let rms = |error: &dyn Fn(&Frame, &Sensed) -> f64| {
            let squares: f64 = frames.iter().map(|(frame, sensed)| error(frame, sensed).powi(2)).sum();
            (squares / frames.len() as f64).sqrt()
        };
        let mut contacts = Confusion::default();
        for (_, sensed) in &frames {
            (0..4).for_each(|leg| contacts.add(sensed.contacts[leg], sensed.true_contacts[leg]));
        }
        Some(Estimation {
            velocity_rmse_m_s: rms(&|frame, sensed| {
                let squares = (0..3).map(|axis| (sensed.velocity[axis] - frame.velocity[axis]).powi(2));
                squares.sum::<f64>().sqrt()
            }),
            height_rmse_m: rms(&|frame, sensed| sensed.height_m - frame.height_m),
            drift_m: (believed.position[0] - last.position[0]).hypot(believed.position[1] - last.position[1]),
            contact_f1: contacts.f1(),
        })
    }

    /// Returns the errors as metrics of a scenario.
    pub fn metrics(trace: &Trace) -> [Metric; 4] {
        let found = Self::of(&trace.on_its_feet());
        let metric = |name, label, value, unit| Metric::new(name, label, value, unit).because("there are no estimates");
        let of = |value: fn(&Self) -> f64| found.as_ref().map(value);
        [
            metric("estimate_velocity_rmse_m_s", "velocity estimate, RMSE", of(|e| e.velocity_rmse_m_s), "m/s"),
            metric("estimate_height_rmse_m", "height estimate, RMSE", of(|e| e.height_rmse_m), "m"),
            metric("estimate_drift_m", "position estimate, drift", of(|e| e.drift_m), "m"),
            metric("contact_f1", "contact estimate", found.and_then(|found| found.contact_f1), "F1"),
        ]
    }
}

/// Returns the RMSE of the felt force on the trunk over the frames without doubt before the first fall, and the fraction of frames in
/// doubt.
pub fn felt_forces(trace: &Trace) -> [Metric; 2] {
    let trace = trace.on_its_feet();
    let felt: Vec<&Felt> = trace.frames.iter().filter_map(|frame| frame.felt.as_ref()).collect();
    let trusted: Vec<&&Felt> = felt.iter().filter(|felt| felt.doubt.is_none()).collect();
    let squares =
        trusted.iter().map(|felt| (0..2).map(|axis| (felt.force[axis] - felt.true_force[axis]).powi(2)).sum::<f64>());
    let rmse = (!trusted.is_empty()).then(|| (squares.sum::<f64>() / trusted.len() as f64).sqrt());
    let doubted = (!felt.is_empty()).then(|| 1.0 - trusted.len() as f64 / felt.len() as f64);
    [
        Metric::new("felt_force_rmse_n", "felt force on the trunk, RMSE", rmse, "N")
            .because("no felt force can be trusted"),
        Metric::new("felt_force_doubted", "felt force in doubt", doubted, "").because("no force is observed"),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::metrics::tests::synthetic;
    use crate::scenario::trace::{Event, EventKind};

    /// Returns a trace of two seconds whose estimate is off by (0.03, 0.04, 0) m/s and 1 cm, and drifts by 1 cm/s to
    /// the left.
    fn trace() -> Trace {
        let mut trace = synthetic(2.0, |_| [0.5, 0.0, 0.0]);
        for (index, frame) in trace.frames.iter_mut().enumerate() {
            frame.velocity = [0.5, 0.0, 0.0];
            frame.height_m = 0.3;
            frame.sensed = Some(Sensed {
                velocity: [0.53, 0.04, 0.0],
                height_m: 0.31,
                position: [0.0, 0.01 * frame.time_s, 0.3],
                contacts: [true, true, false, false],
                // One foot of four is wrong in every other frame: h = 120 · 1.5, f = 60, m = 0.
                true_contacts: [true, index % 2 == 0, false, false],
            });
        }
        trace
    }

    #[test]
    fn errors_of_a_made_up_estimate_are_those_put_in() {
        let found = Estimation::of(&trace()).unwrap();
        assert!((found.velocity_rmse_m_s - 0.05).abs() < 1e-12);
        assert!((found.height_rmse_m - 0.01).abs() < 1e-12);
        assert!((found.drift_m - 0.02).abs() < 1e-12);
        // 2 · 180 / (2 · 180 + 60)
        assert!((found.contact_f1.unwrap() - 360.0 / 420.0).abs() < 1e-12);
    }

    #[test]
    fn nothing_counts_after_a_fall_and_a_true_state_has_no_errors() {
        let mut fallen = trace();
        fallen.frames.iter_mut().skip(60).for_each(|frame| frame.height_m = 9.0);
        fallen.events.push(Event { time_s: 1.0, kind: EventKind::Fall, text: String::new() });
        let found = Estimation::of(&fallen).unwrap();
        assert!((found.height_rmse_m - 0.01).abs() < 1e-12 && (found.drift_m - 0.01).abs() < 1e-12);
        assert_eq!(Estimation::of(&synthetic(1.0, |_| [0.0; 3])), None);
    }
}
