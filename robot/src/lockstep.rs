/*! The bridge and the simulated robot joined without a network, tick by tick: the same code on both sides, as fast as the machine allows,
and with the same result each time. */

use std::sync::Arc;

use supple::config::Config;
use supple::estimate::SensorNoise;
use supple::policy::Agent;
use supple::robot::GRAVITY_M_S2;
use supple::scenario::catalog::Scenario;
use supple::scenario::metrics::Metric;
use supple::scenario::trace::{Event, Frame, Trace};
use supple::task::Command;

use crate::bridge::log::Row;
use crate::bridge::phase::Phase;
use crate::bridge::reading::Reading;
use crate::bridge::{Bridge, Order};
use crate::message::LowCmd;
use crate::serve::body::{Body, FRAME_S, STATE_HZ, configuration};
use crate::serve::judge::Judge;
use crate::serve::operator::Operator;

/// Time in which the robot has to stand \[s\].
const STAND_S: f64 = 12.0;

/// The outcome of a rehearsal.
pub struct Rehearsal {
    /// Metrics of the scenario.
    pub metrics: Vec<Metric>,
    /// Events of the scenario.
    pub events: Vec<Event>,
    /// Number of complaints of the robot about the bridge.
    pub complaints: u64,
    /// The notes of the bridge.
    pub notes: Vec<String>,
    /// The log of the bridge, with the phase of each row.
    pub log: Vec<(&'static str, Row)>,
}

/// Plays a scenario with a policy of the Go2, from lying to the scenario's end.
///
/// # Errors
/// The scenario or the policy does not fit.
pub fn rehearse(agent: &Agent, scenario: &Scenario, seed: u64, compliance: Option<f64>) -> anyhow::Result<Rehearsal> {
    let config = configuration(Config::load("go2")?);
    let script = scenario.script(seed, &config)?;
    let robot = Arc::clone(&script.scene.robot);
    let mut body = Body::new(script.clone(), config, Some(SensorNoise::default()), seed)?;
    let mut judge = Judge::new(robot.joint_limits, false);
    let mut bridge = Bridge::new(agent, None)?;
    if compliance.is_some() {
        bridge.order(&Order::Command(Command { compliance, ..Command::default() }), 0.0);
    }
    let standing_m = robot.standing_height_m(&robot.nominal_pose);
    let mut operator = Operator::new(&script.command, bridge.full_sticks(), standing_m);
    let mut trace = Trace { period_s: FRAME_S, weight_n: robot.mass_kg * GRAVITY_M_S2, ..Trace::default() };
    let (mut notes, mut log, mut has_begun) = (Vec::new(), Vec::new(), false);
    for tick in 0_u64.. {
        let now_s = tick as f64 / f64::from(STATE_HZ);
        let (remote, begins) = operator.act(&body.sight(now_s, !judge.is_silent));
        if begins {
            body.begin();
            has_begun = true;
        }
        if let Ok(reading) = Reading::new(&body.state(remote)) {
            bridge.take(reading, now_s);
        }
        notes.extend(bridge.notes.drain(..).map(|note| format!("{now_s:.3} s: {note}")));
        if let Some(row) = bridge.row(now_s) {
            log.push((bridge.phase.name(), row));
        }
        judge.take(&LowCmd::of_motors(&bridge.output.motors), [1; 16], now_s, true);
        body.command(&judge.motors);
        let played = body.tick();
        if has_begun {
            trace.frames.extend(played.frame.map(|frame| Frame { bodies: Vec::new(), ..frame }));
            trace.events.extend(played.events);
        }
        let gives_up = !has_begun && (now_s > STAND_S || matches!(bridge.phase, Phase::Damped(_)));
        if played.is_over || gives_up {
            break;
        }
    }
    let metrics = if has_begun { scenario.metrics(&script, &trace) } else { Vec::new() };
    Ok(Rehearsal { metrics, events: trace.events, complaints: judge.counts.values().sum(), notes, log })
}

#[cfg(test)]
mod tests {
    use supple::policy::shipped;
    use supple::scenario::trace::EventKind;

    use super::*;

    fn rehearsed(seed: u64) -> Rehearsal {
        let agent = shipped::find("go2/compliant").unwrap();
        let scenario = Scenario::named("push", "{push_m_s: 0.5, at_s: 1.0, duration_s: 3.0}").unwrap();
        rehearse(&agent, &scenario, seed, None).unwrap()
    }

    fn metric(rehearsal: &Rehearsal, name: &str) -> Option<f64> {
        rehearsal.metrics.iter().find(|metric| metric.name == name).and_then(|metric| metric.value)
    }

    #[test]
    fn robot_stands_up_walks_and_withstands_a_push() {
        let rehearsal = rehearsed(0);
        assert_eq!((rehearsal.complaints, rehearsal.notes.len()), (0, 3), "{:?}", rehearsal.notes);
        assert_eq!(metric(&rehearsal, "fell"), Some(0.0));
        // The script's clock begins with the policy: 3 s at 0.5 m/s, from a standstill.
        assert_eq!(metric(&rehearsal, "duration_s"), Some(3.0));
        assert!((0.8..1.6).contains(&metric(&rehearsal, "distance_m").unwrap()));
        let pushed = rehearsal.events.iter().find(|event| event.kind == EventKind::Disturbance).unwrap();
        assert!((1.0..1.7).contains(&pushed.time_s), "{pushed:?}");
    }

    #[test]
    fn rehearsals_of_a_seed_have_the_same_bits() {
        let (one, same, other) = (rehearsed(3), rehearsed(3), rehearsed(4));
        assert_eq!((&one.log, &one.metrics), (&same.log, &same.metrics));
        assert_ne!(one.metrics, other.metrics);
    }
}
