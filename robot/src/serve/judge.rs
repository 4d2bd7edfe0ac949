/*! Decides which commands the simulated robot obeys, and describes the faults of its client. */

use std::collections::BTreeMap;

use serde::Serialize;
use supple::robot::{JOINTS, joint_name};

use crate::dds::WriterId;
use crate::message::{HEAD, LOW_LEVEL, LowCmd, MotorCmd, SERVO, crc};
use crate::motor;

/// Time without a valid command after which the motors only damp \[s\].
pub const SILENCE_S: f64 = 0.1;

/// Time between two commands from which on the second one is late \[s\]; 100 Hz is the least that is legal.
const LATE_S: f64 = 0.0125;

/// The largest gains of a valid command [N·m/rad], [N·m·s/rad]; a Go2 shakes at much lower ones.
const MAX_GAINS: [f32; 2] = [500.0, 50.0];

/// Kinds of faults of a client; commands with one up to `NotReleased` are refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    Checksum,
    Head,
    LevelFlag,
    Mode,
    NotFinite,
    Gain,
    NotReleased,
    TwoWriters,
    Late,
    Silence,
    JointRange,
    TorqueLimit,
}

impl Kind {
    /// Returns true if such a command is not obeyed.
    pub fn is_refused(self) -> bool {
        self <= Kind::NotReleased
    }
}

/// A fault of the client: its kind, and what was found and what was expected.
#[derive(Debug, Clone, PartialEq)]
pub struct Complaint {
    pub kind: Kind,
    pub text: String,
}

/// Decides which commands are obeyed.
pub struct Judge {
    joint_limits: [[f64; 2]; JOINTS],
    any_head: bool,
    /// The commands that the motors obey now.
    pub motors: [MotorCmd; JOINTS],
    /// Writers and the time of their last command \[s\].
    writers: Vec<(WriterId, f64)>,
    /// Time of the last command that was obeyed \[s\].
    last_s: Option<f64>,
    /// True if no valid commands come.
    pub is_silent: bool,
    /// Number of commands that were obeyed.
    pub accepted: u64,
    /// Number of complaints of each kind.
    pub counts: BTreeMap<Kind, u64>,
}

impl Judge {
    /// Creates the judge of a robot with these joint ranges \[rad\]. With `any_head`, head and level flag are not looked at.
    pub fn new(joint_limits: [[f64; 2]; JOINTS], any_head: bool) -> Self {
        let (motors, counts) = (motor::damping(), BTreeMap::new());
        let (writers, last_s) = (Vec::new(), None);
        Judge { joint_limits, any_head, motors, writers, last_s, is_silent: true, accepted: 0, counts }
    }

    /// Takes a command that arrived at `now_s` \[s\]; returns the complaints about it.
    pub fn take(&mut self, command: &LowCmd, writer: WriterId, now_s: f64, released: bool) -> Vec<Complaint> {
        let mut complaints = Vec::new();
        self.writers.retain(|(known, seen_s)| *known != writer && now_s - seen_s < SILENCE_S);
        if !self.writers.is_empty() {
            let count = self.writers.len() + 1;
            let text = format!("{count} writers send rt/lowcmd: their commands alternate; stop all but one");
            complaints.push(self.complain(Kind::TwoWriters, text));
        }
        self.writers.push((writer, now_s));
        match refusal(command, released, self.any_head) {
            Some((kind, text)) => complaints.push(self.complain(kind, text)),
            None => self.obey(command, now_s, &mut complaints),
        }
        complaints
    }

    fn obey(&mut self, command: &LowCmd, now_s: f64, complaints: &mut Vec<Complaint>) {
        if let Some(last_s) = self.last_s.filter(|last_s| !self.is_silent && now_s - last_s > LATE_S) {
            let gap_ms = 1e3 * (now_s - last_s);
            let text = format!("{gap_ms:.0} ms between two commands, expected 2 ms, at most 10 ms");
            complaints.push(self.complain(Kind::Late, text));
        }
        for (joint, motor) in command.motor_cmd.iter().take(JOINTS).enumerate() {
            let [low, high] = self.joint_limits[joint];
            let target = f64::from(motor.q);
            if motor::has_target(motor) && !(low - 1e-3..=high + 1e-3).contains(&target) {
                let name = joint_name(joint);
                let text = format!(
                    "joint target of {name} is {target:.3} rad, its range is {low:.3} to {high:.3} rad: degrees, another \
                     order of joints, or another sign?"
                );
                complaints.push(self.complain(Kind::JointRange, text));
            }
            self.motors[joint] = motor.clone();
        }
        self.last_s = Some(now_s);
        self.is_silent = false;
        self.accepted += 1;
    }

    /// Damps the motors after a silence until `now_s` \[s\]; returns a complaint when it begins.
    pub fn wait(&mut self, now_s: f64) -> Option<Complaint> {
        let last_s = self.last_s.filter(|last_s| !self.is_silent && now_s - last_s > SILENCE_S)?;
        self.is_silent = true;
        self.motors = motor::damping();
        let text = format!("no valid command for {:.0} ms: the motors damp", 1e3 * (now_s - last_s));
        Some(self.complain(Kind::Silence, text))
    }

    /// Counts a motor at its limit; `torque` is what was commanded [N·m].
    pub fn saturated(&mut self, joint: usize, torque: f64, limit: f64) -> Complaint {
        let text = format!("{} is commanded {torque:+.1} N m, its limit is {limit:.1} N m", joint_name(joint));
        self.complain(Kind::TorqueLimit, text)
    }

    fn complain(&mut self, kind: Kind, text: String) -> Complaint {
        *self.counts.entry(kind).or_default() += 1;
        Complaint { kind, text }
    }
}

/// Returns the reason not to obey a command.
fn refusal(command: &LowCmd, released: bool, any_head: bool) -> Option<(Kind, String)> {
    let expected = crc(command);
    if command.crc != expected {
        return Some((Kind::Checksum, format!("checksum is {:08x}, expected {expected:08x}", command.crc)));
    }
    if command.head != HEAD && !any_head {
        let [first, second] = command.head;
        return Some((Kind::Head, format!("head is {first:02X} {second:02X}, expected FE EF")));
    }
    if command.level_flag != LOW_LEVEL && !any_head {
        let found = command.level_flag;
        return Some((Kind::LevelFlag, format!("level flag is {found:02X}, expected FF (low level)")));
    }
    for (joint, motor) in command.motor_cmd.iter().take(JOINTS).enumerate() {
        let name = joint_name(joint);
        let found = motor.mode;
        if found > SERVO {
            let hint = if found == 0x0A { "; 10 is the Go1's" } else { "" };
            return Some((Kind::Mode, format!("mode of {name} is {found}, expected 1 (servo) or 0 (off){hint}")));
        }
        let numbers = [("q", motor.q), ("dq", motor.dq), ("tau", motor.tau), ("kp", motor.kp), ("kd", motor.kd)];
        if let Some((what, found)) = numbers.into_iter().find(|(_, value)| !value.is_finite()) {
            return Some((Kind::NotFinite, format!("{what} of {name} is {found}, expected a finite number")));
        }
        for ((what, found), most) in [("kp", motor.kp), ("kd", motor.kd)].into_iter().zip(MAX_GAINS) {
            if !(0.0..=most).contains(&found) {
                return Some((Kind::Gain, format!("{what} of {name} is {found}, expected 0 to {most}")));
            }
        }
    }
    if !released {
        let text = "the robot's own controller is active: release it first (motion_switcher, ReleaseMode)";
        return Some((Kind::NotReleased, text.to_owned()));
    }
    None
}

#[cfg(test)]
mod tests {
    use supple::robot::same_in_every_leg;

    use super::*;

    fn command() -> LowCmd {
        LowCmd::of_motors(&motor::holding(&same_in_every_leg([0.0, 0.8, -1.5]), &[50.0; 12], &[3.0; 12]))
    }

    fn judge() -> Judge {
        Judge::new(supple::robot::Robot::load("go2").unwrap().joint_limits, false)
    }

    fn kinds(complaints: &[Complaint]) -> Vec<Kind> {
        complaints.iter().map(|complaint| complaint.kind).collect()
    }

    /// A kind of fault, and how to make it.
    type Fault = (Kind, fn(&mut LowCmd));

    #[test]
    fn each_broken_command_is_refused_with_its_reason() {
        let broken: [Fault; 7] = [
            (Kind::Head, |it| it.head = [0xEF, 0xFE]),
            (Kind::LevelFlag, |it| it.level_flag = 0xEE),
            (Kind::Mode, |it| it.motor_cmd[4].mode = 0x0A),
            (Kind::NotFinite, |it| it.motor_cmd[4].tau = f32::NAN),
            (Kind::NotFinite, |it| it.motor_cmd[11].q = f32::INFINITY),
            (Kind::Gain, |it| it.motor_cmd[0].kp = -1.0),
            (Kind::Gain, |it| it.motor_cmd[0].kd = 1000.0),
        ];
        for (kind, break_it) in broken {
            let (mut judge, mut bad) = (judge(), command());
            break_it(&mut bad);
            assert_eq!(kinds(&judge.take(&bad, [1; 16], 0.0, true)), [Kind::Checksum]);
            let complaints = judge.take(&bad.sealed(), [1; 16], 0.0, true);
            assert_eq!(kinds(&complaints), [kind], "{complaints:?}");
            assert!(kind.is_refused() && judge.accepted == 0);
        }
        assert_eq!(kinds(&judge().take(&command(), [1; 16], 0.0, false)), [Kind::NotReleased]);
        let headless = LowCmd { head: [0; 2], level_flag: 0, ..command() }.sealed();
        let mut lenient = Judge::new(judge().joint_limits, true);
        assert_eq!(lenient.take(&headless, [1; 16], 0.0, true), []);
    }

    #[test]
    fn valid_commands_are_obeyed_and_silence_leads_to_damping_until_they_return() {
        let mut judge = judge();
        assert!(judge.is_silent);
        assert_eq!(judge.take(&command(), [1; 16], 1.0, true), []);
        assert!(judge.motors[1].q == 0.8 && !judge.is_silent && judge.accepted == 1);
        assert_eq!(judge.wait(1.099), None);
        assert_eq!(judge.wait(1.101).map(|complaint| complaint.kind), Some(Kind::Silence));
        assert_eq!((&judge.motors, judge.is_silent), (&motor::damping(), true));
        assert_eq!(judge.wait(1.2), None);
        judge.take(&command(), [1; 16], 1.3, true);
        assert_eq!(judge.motors[2].q, -1.5);
    }

    #[test]
    fn invalid_commands_do_not_end_a_silence() {
        let (mut judge, mut bad) = (judge(), command());
        bad.motor_cmd[0].q = 0.1; // the checksum is the old one
        judge.take(&command(), [1; 16], 1.0, true);
        (1..60).for_each(|step| drop(judge.take(&bad, [1; 16], 1.0 + 0.002 * f64::from(step), true)));
        assert!(judge.wait(1.118).is_some());
    }

    #[test]
    fn two_writers_are_told_apart_and_a_new_one_is_not_two() {
        let mut judge = judge();
        judge.take(&command(), [1; 16], 1.000, true);
        assert_eq!(kinds(&judge.take(&command(), [2; 16], 1.002, true)), [Kind::TwoWriters]);
        assert_eq!(kinds(&judge.take(&command(), [2; 16], 1.110, true)), [Kind::Late]);
    }

    #[test]
    fn targets_in_degrees_are_obeyed_with_a_complaint() {
        let (mut judge, mut degrees) = (judge(), command());
        degrees.motor_cmd[1].q = 45.8;
        let complaints = judge.take(&degrees.sealed(), [1; 16], 0.0, true);
        assert_eq!(kinds(&complaints), [Kind::JointRange]);
        assert!(complaints[0].text.contains("FR_thigh"), "{complaints:?}");
    }
}
