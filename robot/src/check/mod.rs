/*! Finds mismatches between a policy and the log of a robot that it ran on.

The policy is replayed on the logged readings, and its joint targets are compared with those that were sent. If they differ, the usual
mistakes are tried one after the other: with the right one undone, the replay fits. Gains are compared with those of the policy, and with
those that torques, angles and rates imply; units and quaternion with physical limits.
*/

mod bag;
mod mistakes;
mod rows;

use anyhow::{Result, ensure};
use nalgebra::{Matrix2, Quaternion, UnitQuaternion, Vector2, Vector3};
use supple::estimate::{EncoderReading, ImuReading};
use supple::policy::Agent;
use supple::robot::{JOINTS, Joints};
use supple::task::Command;

use crate::bridge::log::Row;
use crate::bridge::phase::Phase;
use crate::bridge::reading::Reading;
use crate::bridge::{Bridge, Order};
use crate::remote::Remote;
use mistakes::{Mistake, mistakes};
pub use rows::{Columns, LogRows};

/// Replayed and sent joint targets that differ by no more than this fit \[rad\].
const FITS_RAD: f64 = 0.02;

/// A mistake is accepted if undoing it leaves less than this fraction of the difference.
const BETTER: f64 = 0.6;

/// Largest number of mistakes that are found, one after the other.
const MOST: usize = 3;

/// Longest delay that is tried, in steps of a row \[s\].
const LONGEST_DELAY_S: f64 = 0.08;

/// A delay that differs by more than this, and by more than a row, from the policy's is a mismatch \[s\].
const DELAY_TOLERANCE_S: f64 = 0.006;

/// Time that a replay takes, and that each of the usual mistakes is tried on \[s\].
const REPLAY_S: f64 = 8.0;
const SEARCH_S: f64 = 1.0;

/// Time over which differences are averaged \[s\].
const WINDOW_S: f64 = 0.1;

/// Least time of the policy's phase for a verdict \[s\].
const LEAST_S: f64 = 2.0;

/// A mismatch, or the statement that there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    /// Description of the mismatch.
    pub text: String,
    /// Remaining difference between replayed and sent joint targets \[rad\], where it was measured.
    pub difference_rad: Option<f64>,
}

/// The result of a check.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// Difference of the log as it is \[rad\].
    pub at_first_rad: f64,
    /// Difference after all mistakes are undone \[rad\].
    pub at_last_rad: f64,
    /// The mismatches.
    pub findings: Vec<Finding>,
}

impl Verdict {
    /// Returns true if the log fits the policy.
    pub fn fits(&self) -> bool {
        self.findings.is_empty() && self.at_first_rad <= FITS_RAD
    }
}

/// Returns, for each row of the policy's phase, the joint targets of the replayed policy, before latency, and the sent ones \[rad\].
fn replay(agent: &Agent, rows: &[(String, Row)], undo: &[&Mistake]) -> Result<Vec<(Joints, Joints)>> {
    let mut bridge = Bridge::new(agent, Some(0.0))?;
    bridge.guard.is_strict = false;
    let mut replayed = Vec::with_capacity(rows.len());
    bridge.enter(Phase::Hold);
    for (phase, row) in rows {
        let mut row = *row;
        undo.iter().for_each(|mistake| (mistake.undo)(&mut row));
        if phase == "policy" {
            bridge.enter(Phase::Policy);
        }
        let [forward, left, yaw] = row.command;
        let logged = (row.compliance > 0.0).then_some(row.compliance);
        let compliance = logged.or(agent.commanded_compliance);
        let command = Command { compliance, ..Command::velocity(forward, left, yaw) };
        bridge.order(&Order::Command(command), row.time_s);
        let [w, x, y, z] = row.quaternion;
        let reading = Reading {
            tick_ms: (1e3 * row.tick_s).round() as u32,
            imu: ImuReading { gyro: Vector3::from(row.gyro), specific_force: Vector3::from(row.accelerometer) },
            world_from_base: UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)),
            encoders: EncoderReading { angles: row.q, rates: row.dq },
            torques: row.tau,
            hottest: (0, 0),
            charge_percent: None,
            remote: Remote::default(),
        };
        let targets = bridge.take(reading, row.time_s).targets;
        if phase == "policy" {
            replayed.push((targets, row.target));
        }
    }
    Ok(replayed)
}

/// The time between two rows of the policy's phase, the median \[s\]. Other phases may have other rates, as commands are repeated there.
#[derive(Clone, Copy)]
struct Period(f64);

impl Period {
    fn of(rows: &[(String, Row)]) -> Self {
        let acts = |pair: &&[(String, Row)]| pair.iter().all(|(phase, _)| phase == "policy");
        let steps = rows.windows(2).filter(acts).map(|pair| pair[1].1.time_s - pair[0].1.time_s);
        let mut steps: Vec<f64> = steps.filter(|step| *step > 0.0).collect();
        steps.sort_by(f64::total_cmp);
        Period(steps.get(steps.len() / 2).map_or(0.002, |step| step.clamp(1e-4, 0.1)))
    }

    /// Returns the number of rows of a time.
    fn rows(self, time_s: f64) -> usize {
        (time_s / self.0).round().max(1.0) as usize
    }
}

/// Returns the difference between sent targets and replayed ones that are `delay` rows old \[rad\]: the root mean square of each tenth of a
/// second, and of these the upper quartile. A mistake shows in all of them. A replay of a standing robot may also differ in some, as
/// rounding decides which foot it lifts first.
fn difference(replayed: &[(Joints, Joints)], delay: usize, period: Period) -> f64 {
    // A value that is not finite, or is no target, counts as 10 rad.
    let square = |a: f64, b: f64| if (a - b).abs() < 10.0 { (a - b).powi(2) } else { 100.0 };
    // At first, the delay line holds only the stance.
    let settled = replayed.iter().zip(replayed.iter().skip(delay)).skip(period.rows(LONGEST_DELAY_S));
    let squares = |wanted: &Joints, sent: &Joints| {
        wanted.iter().zip(sent).map(|(a, b)| square(*a, *b)).sum::<f64>() / JOINTS as f64
    };
    let rows: Vec<f64> = settled.map(|((wanted, _), (_, sent))| squares(wanted, sent)).collect();
    let window = period.rows(WINDOW_S);
    let means = rows.chunks_exact(window).map(|rows| rows.iter().sum::<f64>() / window as f64);
    let mut windows: Vec<f64> = means.collect();
    windows.sort_by(f64::total_cmp);
    windows.get(3 * windows.len() / 4).map_or(f64::INFINITY, |square| square.sqrt())
}

/// Returns the best delay in rows and the difference that it leaves \[rad\].
fn best_delay(replayed: &[(Joints, Joints)], period: Period) -> (usize, f64) {
    let each = (0..=period.rows(LONGEST_DELAY_S)).map(|delay| (delay, difference(replayed, delay, period)));
    each.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f64::INFINITY))
}

/// Checks a log against a policy; `latency_s` is the expected delay of the joint targets \[s\], `None` for that of the policy's training.
///
/// # Errors
/// The log is too short, or the policy is not one of a Go2.
pub fn check(log: &LogRows, agent: &Agent, latency_s: Option<f64>) -> Result<Verdict> {
    let period = Period::of(&log.0);
    let rows = log.of_policy(period.rows(LEAST_S), period.rows(REPLAY_S));
    let count = rows.iter().filter(|(phase, _)| phase == "policy").count();
    let (found_s, least) = (count as f64 * period.0, period.rows(LEAST_S));
    ensure!(count >= least, "the log has {found_s:.1} s of the phase 'policy', at least {LEAST_S} s are needed");
    let mut findings = physical(rows, agent);
    let all = mistakes();
    let mut undo: Vec<&Mistake> = Vec::new();
    let first = replay(agent, rows, &undo)?;
    let (mut delay, mut at_last_rad) = best_delay(&first, period);
    let at_first_rad = at_last_rad;
    while at_last_rad > FITS_RAD && undo.len() < MOST {
        let few = &rows[..rows.len().min(period.rows(SEARCH_S))];
        let (mut found, mut least_rad) = (&all[0], f64::INFINITY);
        for candidate in &all {
            let tried: Vec<&Mistake> = undo.iter().copied().chain([candidate]).collect();
            let (_, left_rad) = best_delay(&replay(agent, few, &tried)?, period);
            if left_rad < least_rad {
                (found, least_rad) = (candidate, left_rad);
            }
        }
        undo.push(found);
        let (found_delay, left_rad) = best_delay(&replay(agent, rows, &undo)?, period);
        if left_rad > BETTER * at_last_rad {
            break;
        }
        (delay, at_last_rad) = (found_delay, left_rad);
        findings.push(Finding { text: found.text.clone(), difference_rad: Some(left_rad) });
    }
    if at_last_rad <= FITS_RAD {
        let wanted_s = latency_s.unwrap_or(agent.config.simulation.latency_s);
        let found_s = period.0 * delay as f64;
        if (found_s - wanted_s).abs() > DELAY_TOLERANCE_S.max(period.0) {
            let [found_ms, wanted_ms] = [found_s, wanted_s].map(|time_s| 1e3 * time_s);
            let text = format!(
                "joint targets are sent {found_ms:.0} ms after the reading that they answer, {wanted_ms:.0} ms is what the policy was \
                 trained with"
            );
            findings.push(Finding { text, difference_rad: Some(at_last_rad) });
        }
    } else if findings.is_empty() {
        let text = "the joint targets are not those of this policy on these readings, and none of the usual mistakes explains it: \
                    another policy, or other scales?";
        findings.push(Finding { text: text.to_owned(), difference_rad: None });
    }
    Ok(Verdict { at_first_rad, at_last_rad, findings })
}

/// Finds what needs no replay: gains and quaternion.
fn physical(rows: &[(String, Row)], agent: &Agent) -> Vec<Finding> {
    let rows: Vec<&Row> = rows.iter().filter(|(phase, _)| phase == "policy").map(|(_, row)| row).collect();
    let simulation = &agent.config.simulation;
    let gains = [simulation.kp_n_m_per_rad.joints(), simulation.kd_n_m_s_per_rad.joints()];
    // A log has only the gains of the first joint.
    let [wanted_kp, wanted_kd] = gains.map(|joints| joints[0]);
    let [sent_kp, sent_kd] = rows.first().map_or([wanted_kp, wanted_kd], |row| row.gains);
    let differs = |found: f64, wanted: f64, by: f64| (found - wanted).abs() > by * wanted;
    let of_gains = if differs(sent_kp, wanted_kp, 0.02) || differs(sent_kd, wanted_kd, 0.02) {
        Some(format!("gains are kp {sent_kp} and kd {sent_kd}, the policy was trained at {wanted_kp} and {wanted_kd}"))
    } else {
        effective_gains(&rows, &gains).and_then(|[kp, kd]| {
            let of_torques = |gain: String, sent: f64| {
                format!("torques are those of a gain {gain}, not of the {sent} that was sent")
            };
            match (differs(kp, wanted_kp, 0.25), differs(kd, wanted_kd, 0.6)) {
                (true, _) => Some(of_torques(format!("kp of {kp:.0} N m/rad"), sent_kp)),
                (false, true) => Some(of_torques(format!("kd of {kd:.1} N m s/rad"), sent_kd)),
                (false, false) => None,
            }
        })
    };
    let texts = of_gains.into_iter().chain(quaternion(&rows));
    texts.map(|text| Finding { text, difference_rad: None }).collect()
}

/// Estimates the gains of the first joint from torques by least squares: `τ = kp (target − q) − kd q̇`, where those of the other
/// joints are in the same proportion as in `wanted`; `None` if that explains little.
fn effective_gains(rows: &[&Row], wanted: &[Joints; 2]) -> Option<[f64; 2]> {
    let part = |of: &Joints, joint: usize| if of[0] == 0.0 { 1.0 } else { of[joint] / of[0] };
    let (mut a, mut b, mut square) = (Matrix2::zeros(), Vector2::zeros(), 0.0);
    for pair in rows.windows(2) {
        for joint in 0..JOINTS {
            // The command of a row acts until the next.
            let regressors = Vector2::new(
                part(&wanted[0], joint) * (pair[0].target[joint] - pair[1].q[joint]),
                -part(&wanted[1], joint) * pair[1].dq[joint],
            );
            let torque = pair[1].tau[joint];
            a += regressors * regressors.transpose();
            b += regressors * torque;
            square += torque * torque;
        }
    }
    let determinant = a.m11 * a.m22 - a.m12 * a.m21;
    let gains = [(a.m22 * b.x - a.m12 * b.y) / determinant, (a.m11 * b.y - a.m21 * b.x) / determinant];
    let explained = gains[0] * b.x + gains[1] * b.y;
    (gains.iter().all(|gain| gain.is_finite()) && explained > 0.8 * square).then_some(gains)
}

/// Compares the mean up of quaternion and accelerometer; the text says in which other reading they agree.
fn quaternion(rows: &[&Row]) -> Option<String> {
    let force: Vector3<f64> = rows.iter().map(|row| Vector3::from(row.accelerometer)).sum();
    let force = force.try_normalize(1e-9)?;
    // A frame or sign of the accelerometer is found by the replay.
    let up = |read: fn([f64; 4]) -> UnitQuaternion<f64>| {
        let up: Vector3<f64> = rows.iter().map(|row| read(row.quaternion).inverse() * Vector3::z()).sum();
        up.try_normalize(1e-9).map_or(std::f64::consts::PI, |up| up.angle(&force))
    };
    const CLOSE_RAD: f64 = 0.15;
    let plain = up(|[w, x, y, z]| UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)));
    let last = up(|[x, y, z, w]| UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z)));
    (plain > CLOSE_RAD && last < CLOSE_RAD && last < 0.5 * plain)
        .then(|| "the quaternion is in the order x, y, z, w; expected w, x, y, z".to_owned())
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use supple::policy::shipped;
    use supple::scenario::catalog::Scenario;

    use super::mistakes::{orders, permuted};
    use super::*;
    use crate::lockstep::rehearse;

    static AGENT: LazyLock<Agent> = LazyLock::new(|| shipped::find("go2/compliant").unwrap());

    /// A walk around a corner, of a robot that follows its policy.
    static LOG: LazyLock<LogRows> = LazyLock::new(|| {
        let scenario =
            Scenario::named("walk", "{duration_s: 3.0, forward_m_s: 0.4, left_m_s: 0.2, yaw_rad_s: 0.3}").unwrap();
        let rehearsal = rehearse(&AGENT, &scenario, 1, None).unwrap();
        LogRows(rehearsal.log.into_iter().map(|(phase, row)| (phase.to_owned(), row)).collect())
    });

    #[test]
    fn log_of_a_sound_bridge_fits() {
        let verdict = check(&LOG, &AGENT, None).unwrap();
        assert!(verdict.fits(), "{verdict:?}");
    }

    /// Words that name a mistake, and how to make it.
    type Case = (&'static str, fn(&mut Row));

    #[test]
    fn twenty_mistakes_are_each_named() {
        fn all(row: &mut Row, change: impl Fn(&Joints) -> Joints) {
            (row.q, row.dq, row.tau) = (change(&row.q), change(&row.dq), change(&row.tau));
        }
        fn turn(row: &mut Row, joints: &[usize]) {
            joints.iter().for_each(|&k| (row.q[k], row.dq[k], row.tau[k]) = (-row.q[k], -row.dq[k], -row.tau[k]));
        }
        fn left_first(values: &Joints) -> Joints {
            permuted(values, &orders()[0].1)
        }
        fn by_type(values: &Joints) -> Joints {
            let mut theirs = [0.0; JOINTS];
            orders()[3].1.iter().zip(values).for_each(|(place, value)| theirs[*place] = *value);
            theirs
        }
        let cases: [Case; 20] = [
            ("readings of the joints are in the order FL, FR", |row| all(row, left_first)),
            ("readings of the joints are in the order all hips", |row| all(row, by_type)),
            ("joint targets are in the order FL, FR", |row| row.target = left_first(&row.target)),
            ("readings and targets of the joints are in the order FL, FR", |row| {
                all(row, left_first);
                row.target = left_first(&row.target);
            }),
            ("angle and rate of FR_thigh", |row| turn(row, &[1])),
            ("the rate of RL_calf", |row| row.dq[11] = -row.dq[11]),
            ("the target of FL_calf", |row| row.target[5] = -row.target[5]),
            ("angle and rate of all calves", |row| turn(row, &[2, 5, 8, 11])),
            ("joint angles are in degrees", |row| row.q = row.q.map(f64::to_degrees)),
            ("joint rates are in degrees", |row| row.dq = row.dq.map(f64::to_degrees)),
            ("joint angles and rates are in degrees", |row| {
                (row.q, row.dq) = (row.q.map(f64::to_degrees), row.dq.map(f64::to_degrees));
            }),
            ("joint targets are in degrees", |row| row.target = row.target.map(f64::to_degrees)),
            ("the gyro is in degrees", |row| row.gyro = row.gyro.map(f64::to_degrees)),
            ("gyro and accelerometer are in forward, right, down", |row| {
                [1, 2].into_iter().for_each(|k| {
                    (row.gyro[k], row.accelerometer[k]) = (-row.gyro[k], -row.accelerometer[k]);
                });
            }),
            ("the gyro is in a frame whose y axis is to the right", |row| row.gyro[1] = -row.gyro[1]),
            ("reads −g at rest", |row| row.accelerometer = row.accelerometer.map(|value| -value)),
            ("gains are kp 20", |row| row.gains = [20.0, 0.5]),
            ("torques are those of a gain kp of 23", |row| row.tau = row.tau.map(|torque| 0.5 * torque)),
            ("the quaternion is in the order x, y, z, w", |row| row.quaternion.rotate_left(1)),
            ("the command's yaw rate has the wrong sign", |row| row.command[2] = -row.command[2]),
        ];
        let unnamed: Vec<String> = std::thread::scope(|scope| {
            let check = |(words, change): Case| {
                scope.spawn(move || {
                    let mut log = LOG.clone();
                    log.0.iter_mut().for_each(|(_, row)| change(row));
                    let verdict = super::check(&log, &AGENT, None).unwrap();
                    let is_named = verdict.findings.iter().any(|finding| finding.text.contains(words));
                    (!is_named).then(|| format!("{words}: {verdict:?}"))
                })
            };
            let threads = cases.map(check);
            threads.into_iter().filter_map(|thread| thread.join().unwrap()).collect()
        });
        assert!(unnamed.is_empty(), "{}", unnamed.join("\n"));
    }

    #[test]
    fn delay_is_measured_to_a_few_milliseconds() {
        let mut log = LOG.clone();
        let targets: Vec<Joints> = log.0.iter().map(|(_, row)| row.target).collect();
        // 20 ms more.
        for (index, (_, row)) in log.0.iter_mut().enumerate().skip(10) {
            row.target = targets[index - 10];
        }
        let verdict = check(&log, &AGENT, None).unwrap();
        assert!(verdict.findings.iter().any(|finding| finding.text.contains("50 ms")), "{verdict:?}");
    }

    #[test]
    fn delay_is_told_apart_from_the_rate_of_the_log() {
        let mut log = LOG.clone();
        let mut index = 0;
        // 250 rows a second while the policy acts, more before it.
        log.0.retain(|(phase, _)| {
            index += 1;
            phase != "policy" || index % 2 == 0
        });
        let verdict = check(&log, &AGENT, None).unwrap();
        assert!(verdict.fits(), "{verdict:?}");
        log.0.truncate(log.0.len() - log.0.iter().filter(|(phase, _)| phase == "policy").count() / 2);
        assert!(check(&log, &AGENT, None).unwrap_err().to_string().contains("at least 2 s are needed"));
    }

    #[test]
    fn log_of_another_policy_is_noticed() {
        let other = shipped::find("go2/baseline").unwrap();
        let verdict = check(&LOG, &other, None).unwrap();
        assert!(!verdict.fits() && verdict.at_last_rad > FITS_RAD, "{verdict:?}");
    }
}
