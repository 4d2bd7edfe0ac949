//! The bridge without a network: readings and orders in, commands to the motors out.

use std::sync::Arc;

use anyhow::ensure;
use supple::config::Config;
use supple::policy::{Agent, Controller};
use supple::robot::{JOINTS, Joints, Robot};
use supple::sim::control::Latency;
use supple::task::Command;

use super::log::Row;
use super::orders::{Order, RemoteOrders};
use super::perceive::Perception;
use super::phase::{Phase, STAND_GAINS, Wish};
use super::reading::Reading;
use super::safety::{Fault, Guard};
use crate::message::MotorCmd;
use crate::motor;
use crate::remote::FullSticks;

/// Time between two commands to the motors \[s\].
const COMMAND_S: f64 = 0.002;

/// Largest step of the robot's clock between two readings, in either direction, that is not a fault \[ms\].
const MAX_GAP_MS: u32 = 100;

/// The command that goes to the motors.
#[derive(Debug, Clone, PartialEq)]
pub struct Output {
    pub motors: [MotorCmd; JOINTS],
    /// The joint targets of phase or policy, before latency \[rad\]; the joint angles where there are none.
    pub targets: Joints,
}

/// A policy on one robot.
pub struct Bridge<'a> {
    agent: &'a Agent,
    config: &'a Config,
    controller: Box<dyn Controller + 'a>,
    stance: Joints,
    perception: Perception,
    /// True if the estimators have to start again.
    perception_is_stale: bool,
    pub guard: Guard,
    pub phase: Phase,
    pub command: Command,
    remote: RemoteOrders,
    latency: Latency,
    /// Joint targets after the latency \[rad\].
    acting: Joints,
    /// Time that the latency has not counted yet \[s\].
    latency_wait_s: f64,
    /// Joint targets of the last policy step, or of the phase \[rad\].
    targets: Joints,
    /// Time until the next policy step \[s\].
    policy_wait_s: f64,
    policy_has_begun: bool,
    /// True once the program is about to end: the robot neither stands up nor walks again.
    is_quitting: bool,
    last_tick_ms: Option<u32>,
    /// Time of the last reading \[s\].
    last_s: f64,
    pub reading: Option<Reading>,
    /// The command that was computed last.
    pub output: Output,
    /// Lines for people, until they are taken.
    pub notes: Vec<String>,
}

impl<'a> Bridge<'a> {
    /// Prepares a policy of a Go2. `latency_s` is the delay of the joint targets \[s\]; `None` takes that of the policy's training.
    pub fn new(agent: &'a Agent, latency_s: Option<f64>) -> anyhow::Result<Self> {
        let config = &agent.config;
        let model = &config.robot.model;
        ensure!(model == "go2", "the policy is for the robot {model}, expected go2: give one such as go2/compliant");
        let latency_s = latency_s.unwrap_or(config.simulation.latency_s);
        ensure!((0.0..=0.2).contains(&latency_s), "latency {latency_s} s: expected 0 to 0.2 s");
        let robot: Arc<Robot> = config.robot.load()?;
        let controller = agent.controller();
        let stance = controller.rest();
        Ok(Bridge {
            controller,
            guard: Guard::new(robot.joint_limits, robot.torque_limits),
            perception: Perception::new(robot)?,
            perception_is_stale: false,
            phase: Phase::Passive,
            command: Command::default(),
            remote: RemoteOrders::default(),
            latency: Latency::new(latency_s, COMMAND_S, stance),
            acting: stance,
            latency_wait_s: 0.0,
            targets: stance,
            stance,
            policy_wait_s: 0.0,
            policy_has_begun: false,
            is_quitting: false,
            last_tick_ms: None,
            last_s: 0.0,
            reading: None,
            output: Output { motors: motor::damping(), targets: stance },
            notes: Vec::new(),
            agent,
            config,
        })
    }

    /// Returns the row of the log for the last reading and what was sent then.
    pub fn row(&self, now_s: f64) -> Option<Row> {
        let reading = self.reading.as_ref()?;
        let (orientation, motors) = (reading.world_from_base, &self.output.motors);
        Some(Row {
            time_s: now_s,
            tick_s: 1e-3 * f64::from(reading.tick_ms),
            q: reading.encoders.angles,
            dq: reading.encoders.rates,
            tau: reading.torques,
            quaternion: [orientation.w, orientation.i, orientation.j, orientation.k],
            gyro: reading.imu.gyro.into(),
            accelerometer: reading.imu.specific_force.into(),
            command: [self.command.forward, self.command.left, self.command.yaw],
            compliance: self.command.compliance.unwrap_or(0.0),
            target: motors.each_ref().map(|motor| f64::from(motor.q)),
            gains: [f64::from(motors[0].kp), f64::from(motors[0].kd)],
        })
    }

    /// Returns the velocities that full sticks mean: the ends of the policy's range.
    pub fn full_sticks(&self) -> FullSticks {
        FullSticks::new(&self.config.command)
    }

    /// Takes an order at `now_s` \[s\].
    pub fn order(&mut self, order: &Order, now_s: f64) {
        match order {
            Order::Wish(wish) => self.wish(*wish, now_s),
            Order::Quit => {
                self.is_quitting = true;
                self.wish(Wish::Lie, now_s);
            }
            Order::Command(command) => {
                let compliance = command.compliance.or(self.command.compliance);
                self.ask(Command { compliance, ..*command });
            }
            Order::Change([forward, left, yaw]) => {
                let Command { forward: f, left: l, yaw: y, compliance, .. } = self.command;
                self.ask(Command { compliance, ..Command::velocity(f + forward, l + left, y + yaw) });
            }
        }
    }

    fn ask(&mut self, command: Command) {
        let FullSticks([forward, left, yaw]) = self.full_sticks();
        let numbers = [command.forward, command.left, command.yaw];
        if !numbers.into_iter().all(f64::is_finite) {
            return self.notes.push(format!("a command with numbers that are not finite is ignored: {numbers:?}"));
        }
        if let Some(compliance) = command.compliance
            && let Err(error) = self.agent.resolve_compliance(Some(compliance), None)
        {
            return self.notes.push(format!("the command is ignored: {error}"));
        }
        let (forward, left) = (command.forward.clamp(-forward, forward), command.left.clamp(-left, left));
        self.command = Command { forward, left, yaw: command.yaw.clamp(-yaw, yaw), ..command };
    }

    fn wish(&mut self, wish: Wish, now_s: f64) {
        let Some(reading) = &self.reading else { return self.notes.push("no state of the robot yet".to_owned()) };
        if self.is_quitting && matches!(wish, Wish::Stand | Wish::Policy) {
            return self.notes.push("not now: the program is about to end".to_owned());
        }
        if !matches!(wish, Wish::Damp | Wish::Lie)
            && let Err(fault) = self.guard.check(reading, 0.0)
        {
            return self.notes.push(format!("not now: {fault}"));
        }
        match self.phase.wish(wish, &reading.encoders.angles, now_s) {
            Ok(phase) => self.enter(phase),
            Err(reason) => self.notes.push(reason),
        }
    }

    pub fn enter(&mut self, phase: Phase) {
        if phase == self.phase {
            return;
        }
        match &phase {
            Phase::Damped(fault) => self.notes.push(format!("DAMPED: {fault}")),
            other => self.notes.push(other.name().replace('_', " ")),
        }
        if !phase.is_active() {
            // Not with the next state, which may never come.
            self.output.motors = motor::damping();
        }
        if self.phase == Phase::Policy {
            // When the policy begins again, its commanded velocity is zero.
            self.command = Command { compliance: self.command.compliance, ..Command::default() };
        }
        if phase == Phase::Policy {
            (self.policy_wait_s, self.policy_has_begun) = (0.0, false);
        }
        if phase == Phase::Hold {
            // At rest on its feet: the best moment for estimators to start.
            self.notes.extend(self.perception.restart().err().map(|error| error.to_string()));
            self.latency.reset(self.stance);
            (self.acting, self.latency_wait_s, self.targets) = (self.stance, 0.0, self.stance);
        }
        self.phase = phase;
    }

    /// Damps at once, latched. In a phase that damps anyway, only noted.
    pub fn fail(&mut self, fault: Fault) {
        if self.phase.is_active() {
            self.enter(Phase::Damped(fault));
        }
    }

    /// Takes a reading that arrived at `now_s` \[s\], and returns what to send now.
    pub fn take(&mut self, reading: Reading, now_s: f64) -> &Output {
        let orders = self.remote.take(&reading.remote, &self.full_sticks());
        let dt_s = match self.last_tick_ms.map(|last| (last, reading.tick_ms.wrapping_sub(last))) {
            None => Ok(COMMAND_S),
            // A clock that stays at zero, as in unitree_mujoco, is replaced by the time of arrival.
            Some((0, 0)) => Ok((now_s - self.last_s).clamp(1e-4, 1e-3 * f64::from(MAX_GAP_MS))),
            // The state came twice or out of order.
            Some((_, gap)) if gap.wrapping_neg() <= MAX_GAP_MS => {
                self.obey_without_reading(&orders, now_s);
                return self.wait(now_s);
            }
            Some((_, gap)) if gap <= MAX_GAP_MS => Ok(1e-3 * f64::from(gap)),
            Some((last, _)) => Err(Fault::Clock { from_ms: last, to_ms: reading.tick_ms }),
        };
        (self.last_tick_ms, self.last_s) = (Some(reading.tick_ms), now_s);
        let sound = dt_s.and_then(|dt_s| {
            self.guard.check(&reading, dt_s)?;
            if std::mem::take(&mut self.perception_is_stale) {
                self.perception.restart().map_err(|error| Fault::Estimate { reason: error.to_string() })?;
            }
            self.perception.take(&reading, &self.targets, dt_s)?;
            Ok(dt_s)
        });
        self.reading = Some(reading);
        match sound {
            Ok(dt_s) => {
                orders.iter().for_each(|order| self.order(order, now_s));
                if let Err(fault) = self.act(now_s, dt_s) {
                    self.fail(fault);
                }
            }
            Err(fault) => {
                self.fail(fault);
                // The estimators may have used this reading, so they start again with the next valid one.
                self.perception_is_stale = true;
                self.obey_without_reading(&orders, now_s);
            }
        }
        &self.output
    }

    /// Obeys the orders that hold although the reading is not used: to damp, and where the sticks are now.
    fn obey_without_reading(&mut self, orders: &[Order], now_s: f64) {
        let holds = |order: &&Order| matches!(order, Order::Wish(Wish::Damp) | Order::Command(_));
        orders.iter().filter(holds).for_each(|order| self.order(order, now_s));
    }

    /// Returns what to send at `now_s` \[s\] if nothing new has come from the robot.
    pub fn wait(&mut self, now_s: f64) -> &Output {
        if let Err(fault) = self.guard.silence(now_s - self.last_s) {
            self.fail(fault);
        }
        &self.output
    }

    /// Computes the next command.
    fn act(&mut self, now_s: f64, dt_s: f64) -> Result<(), Fault> {
        let simulation = &self.config.simulation;
        if let Some((targets, is_over)) = self.phase.motion(&self.stance, now_s) {
            self.targets = targets;
            let [kp, kd] = STAND_GAINS.map(|gain| [gain; JOINTS]);
            self.output = Output { motors: motor::holding(&targets, &kp, &kd), targets };
            if is_over {
                self.enter(self.phase.after());
            }
            return Ok(());
        }
        if self.phase != Phase::Policy {
            let targets = self.reading.as_ref().map_or(self.stance, |reading| reading.encoders.angles);
            self.output = Output { motors: motor::damping(), targets };
            return Ok(());
        }
        self.policy_wait_s -= dt_s;
        if self.policy_wait_s <= 0.0 {
            self.policy_wait_s = (self.policy_wait_s + simulation.policy_period_s()).max(0.0);
            let Some(state) = self.perception.state() else { return Ok(()) };
            if !std::mem::replace(&mut self.policy_has_begun, true) {
                self.controller.begin(&state);
            }
            let wanted = self.controller.joint_targets(&state, &self.command);
            self.targets = self.guard.limit(&wanted, &self.targets)?;
        }
        self.latency_wait_s += dt_s;
        // Counted by the robot's clock, at any rate of its states; half a microsecond is for rounding.
        while self.latency_wait_s > COMMAND_S - 5e-7 {
            self.latency_wait_s -= COMMAND_S;
            self.acting = self.latency.delay(&self.targets);
        }
        let (kp, kd) = (simulation.kp_n_m_per_rad.joints(), simulation.kd_n_m_s_per_rad.joints());
        self.output = Output { motors: motor::holding(&self.acting, &kp, &kd), targets: self.targets };
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use supple::policy::shipped;
    use supple::robot::same_in_every_leg;

    use super::*;
    use crate::bridge::phase::FOLDED;
    use crate::bridge::reading::tests::state_at;
    use crate::message::LowState;
    use crate::remote::{Button, Remote};

    static AGENT: LazyLock<Agent> = LazyLock::new(|| shipped::find("go2/compliant").unwrap());

    /// A bridge and a robot whose joints are at their targets.
    struct Rig<'a> {
        bridge: Bridge<'a>,
        angles: Joints,
        tick_ms: u32,
    }

    impl<'a> Rig<'a> {
        fn new(agent: &'a Agent) -> Self {
            let bridge = Bridge::new(agent, None).unwrap();
            Rig { bridge, angles: same_in_every_leg(FOLDED), tick_ms: 0 }
        }

        fn step(&mut self, change: impl Fn(&mut LowState)) -> Output {
            self.tick_ms += 2;
            let output = self.take(0, change);
            for (angle, motor) in self.angles.iter_mut().zip(&output.motors) {
                if motor::has_target(motor) {
                    *angle = f64::from(motor.q);
                }
            }
            output
        }

        /// Gives the bridge the state of this tick, which arrives `later_ms` after it.
        fn take(&mut self, later_ms: u32, change: impl Fn(&mut LowState)) -> Output {
            let mut state = state_at(&self.angles, self.tick_ms);
            change(&mut state);
            let reading = Reading::new(&state.sealed()).unwrap();
            self.bridge.take(reading, 1e-3 * f64::from(self.tick_ms + later_ms)).clone()
        }

        fn run(&mut self, seconds: f64) -> Output {
            let steps = (500.0 * seconds) as usize;
            (0..steps).map(|_| self.step(|_| ())).last().unwrap()
        }

        /// Returns the number of policy steps in a second.
        fn policy_steps(&mut self) -> u32 {
            let mut last = self.step(|_| ()).targets;
            let mut is_new = |targets| std::mem::replace(&mut last, targets) != targets;
            (0..500).map(|_| u32::from(is_new(self.step(|_| ()).targets))).sum()
        }

        fn order(&mut self, wish: Wish) {
            self.bridge.order(&Order::Wish(wish), 1e-3 * f64::from(self.tick_ms));
        }

        fn stand(&mut self) {
            self.order(Wish::Stand);
            self.run(2.5);
            assert_eq!(self.bridge.phase, Phase::Hold);
        }

        fn to_policy(agent: &'a Agent) -> Self {
            let mut rig = Rig::new(agent);
            rig.run(0.1);
            rig.stand();
            rig.order(Wish::Policy);
            rig.run(0.1);
            assert_eq!(rig.bridge.phase, Phase::Policy);
            rig
        }
    }

    #[test]
    fn bridge_stands_up_runs_the_policy_and_lies_down() {
        let mut rig = Rig::to_policy(&AGENT);
        let output = rig.run(0.1);
        assert_eq!((output.motors[0].kp, output.motors[0].kd), (47.0, 1.2));
        rig.order(Wish::Lie);
        assert_eq!(rig.run(1.5).motors, motor::damping());
        assert_eq!(rig.bridge.phase, Phase::Passive);
    }

    #[test]
    fn policy_steps_at_its_own_rate_and_is_resent_between() {
        let steps = Rig::to_policy(&AGENT).policy_steps();
        assert!((59..=61).contains(&steps), "{steps}");
    }

    #[test]
    fn each_fault_of_the_robot_damps_and_stays_damped() {
        let breaks: [fn(&mut LowState); 5] = [
            |it| it.imu_state.quaternion = [0.6, 0.8, 0.0, 0.0],
            |it| it.motor_state[3].dq = 40.0,
            |it| it.motor_state[3].temperature = 99,
            |it| it.motor_state[3].q = f32::NAN,
            |it| it.tick += 5000,
        ];
        for (index, fault) in breaks.into_iter().enumerate() {
            let mut rig = Rig::to_policy(&AGENT);
            let output = rig.step(fault);
            assert!(matches!(rig.bridge.phase, Phase::Damped(_)), "{index}: {:?}", rig.bridge.phase);
            assert_eq!(output.motors, motor::damping());
            rig.tick_ms += if index == 4 { 5000 } else { 0 };
            assert_eq!(rig.run(0.2).motors, motor::damping());
            rig.order(Wish::Stand);
            assert_eq!(rig.run(0.2).motors, motor::damping());
            rig.order(Wish::Clear);
            assert_eq!(rig.bridge.phase, Phase::Passive, "{index}");
        }
    }

    #[test]
    fn silence_of_the_robot_damps_after_100_ms() {
        let mut rig = Rig::to_policy(&AGENT);
        let now_s = 1e-3 * f64::from(rig.tick_ms);
        assert_ne!(rig.bridge.wait(now_s + 0.0999).motors, motor::damping());
        assert_eq!(rig.bridge.wait(now_s + 0.1001).motors, motor::damping());
        assert!(matches!(rig.bridge.phase, Phase::Damped(Fault::Silence { .. })));
    }

    #[test]
    fn repeated_states_are_a_silence_and_people_can_still_stop_the_robot() {
        let mut rig = Rig::to_policy(&AGENT);
        let repeat = |rig: &mut Rig, later_ms: u32, buttons: Remote| {
            rig.take(later_ms, |it| it.wireless_remote = buttons.to_bytes()).motors
        };
        assert_ne!(repeat(&mut rig, 90, Remote::default()), motor::damping());
        assert_eq!(repeat(&mut rig, 101, Remote::default()), motor::damping());
        assert!(matches!(rig.bridge.phase, Phase::Damped(Fault::Silence { .. })));

        let mut rig = Rig::to_policy(&AGENT);
        assert_eq!(repeat(&mut rig, 2, Remote::default().with(Button::Select)), motor::damping());
        assert_eq!(rig.bridge.phase, Phase::Damped(Fault::Asked));
    }

    #[test]
    fn motors_damp_from_the_order_on_and_not_from_the_next_state() {
        let mut rig = Rig::to_policy(&AGENT);
        rig.order(Wish::Damp);
        assert_eq!(rig.bridge.output.motors, motor::damping());

        let mut rig = Rig::to_policy(&AGENT);
        rig.order(Wish::Lie);
        while rig.bridge.phase.is_active() {
            rig.step(|_| ());
        }
        assert_eq!(rig.bridge.output.motors, motor::damping());
    }

    #[test]
    fn policy_that_begins_again_begins_at_rest() {
        let mut rig = Rig::to_policy(&AGENT);
        rig.bridge.order(&Order::Command(Command::velocity(1.0, 0.0, 0.0)), 0.0);
        rig.run(0.1);
        rig.step(|it| it.imu_state.quaternion = [0.6, 0.8, 0.0, 0.0]);
        assert!(matches!(rig.bridge.phase, Phase::Damped(_)));
        rig.run(0.1);
        rig.order(Wish::Clear);
        rig.stand();
        rig.order(Wish::Policy);
        assert_eq!((&rig.bridge.phase, &rig.bridge.command), (&Phase::Policy, &Command::default()));
    }

    #[test]
    fn robot_that_is_about_to_lie_for_good_does_not_stand_up_again() {
        let mut rig = Rig::to_policy(&AGENT);
        rig.bridge.order(&Order::Quit, 1e-3 * f64::from(rig.tick_ms));
        rig.run(0.1);
        for wish in [Wish::Stand, Wish::Policy] {
            rig.order(wish);
            assert!(matches!(rig.bridge.phase, Phase::LieDown { .. }));
        }
        assert_eq!(rig.run(1.0).motors, motor::damping());
    }

    #[test]
    fn latency_is_of_time_and_not_of_states() {
        // 200 and 1000 states a second.
        for period_ms in [5, 1] {
            let mut rig = Rig::to_policy(&AGENT);
            let (mut late_ms, last) = (0, rig.bridge.output.targets);
            while rig.bridge.output.targets == last {
                rig.tick_ms = rig.tick_ms + period_ms - 2;
                rig.step(|_| ());
            }
            let fresh = rig.bridge.output.targets;
            while (f64::from(rig.bridge.output.motors[0].q) - fresh[0]).abs() >= 1e-6 {
                rig.tick_ms = rig.tick_ms + period_ms - 2;
                late_ms += period_ms;
                rig.step(|_| ());
            }
            let (found_ms, wanted_ms) = (f64::from(late_ms), 1e3 * AGENT.config.simulation.latency_s);
            assert!((found_ms - wanted_ms).abs() <= 5.0, "{period_ms} ms: {found_ms} ms, expected {wanted_ms} ms");
        }
    }

    #[test]
    fn overtaken_state_is_ignored() {
        let mut rig = Rig::to_policy(&AGENT);
        let before = rig.step(|_| ());
        rig.tick_ms -= 20;
        // A reading that counts would be a fault.
        let output = rig.step(|it| it.motor_state[3].dq = 40.0);
        assert_eq!((&rig.bridge.phase, output), (&Phase::Policy, before));
    }

    #[test]
    fn robot_without_a_clock_is_stood_up_by_arrival_times() {
        let mut rig = Rig::new(&AGENT);
        for step in 0..1300 {
            rig.step(|it| it.tick = 0);
            if step == 50 {
                rig.order(Wish::Stand);
            }
        }
        assert_eq!(rig.bridge.phase, Phase::Hold);
    }

    #[test]
    fn restart_of_the_robot_while_passive_is_no_fault() {
        let mut rig = Rig::new(&AGENT);
        rig.run(1.0);
        rig.tick_ms = 0;
        rig.run(0.1);
        assert_eq!(rig.bridge.phase, Phase::Passive);
        rig.stand();
    }

    #[test]
    fn remote_leads_through_the_phases_and_commands() {
        let mut rig = Rig::new(&AGENT);
        rig.run(0.1);
        rig.step(|it| it.wireless_remote = Remote::default().with(Button::Start).to_bytes());
        rig.run(2.5);
        let walk = Remote { left: [0.0, 0.5], ..Remote::default() }.with(Button::A);
        rig.step(|it| it.wireless_remote = walk.to_bytes());
        assert_eq!(rig.bridge.phase, Phase::Policy);
        assert_eq!(rig.bridge.command.forward, 0.5);
        rig.step(|it| it.wireless_remote = walk.with(Button::Select).to_bytes());
        assert_eq!(rig.bridge.phase, Phase::Damped(Fault::Asked));
        // A stick that is released while states are missing.
        let tilted = Remote { left: [0.0, 0.25], ..Remote::default() };
        rig.step(|it| it.wireless_remote = tilted.to_bytes());
        assert_eq!(rig.bridge.command.forward, 0.25);
        rig.tick_ms += 150;
        rig.run(0.1);
        assert_eq!(rig.bridge.command, Command::default());
    }

    #[test]
    fn commands_stay_within_the_policys_range_and_finite() {
        let mut rig = Rig::new(&AGENT);
        for forward in [9.0, f64::NAN] {
            rig.bridge.order(&Order::Command(Command::velocity(forward, -9.0, 0.1)), 0.0);
            assert_eq!(rig.bridge.command, Command::velocity(1.0, -0.5, 0.1));
        }
    }

    #[test]
    fn compliance_out_of_the_policys_range_is_refused() {
        let agent = shipped::find("go2/baseline").unwrap();
        let mut rig = Rig::new(&agent);
        let commanded = |compliance| Command { compliance: Some(compliance), ..Command::velocity(0.5, 0.0, 0.0) };
        rig.bridge.order(&Order::Command(commanded(0.02)), 0.0);
        for compliance in [0.0, -0.02, 9.0, f64::NAN] {
            rig.bridge.order(&Order::Command(commanded(compliance)), 0.0);
            assert_eq!(rig.bridge.command, commanded(0.02));
        }
        assert_eq!(rig.bridge.notes.len(), 4);
    }

    #[test]
    fn external_policy_of_the_go2_acts_at_its_own_rate() {
        let folder = tempfile::tempdir().unwrap();
        let repository = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
        std::fs::copy(repository.join("tests/fixtures/onnx/rsl_rl.onnx"), folder.path().join("rsl_rl.onnx")).unwrap();
        let text = std::fs::read_to_string(repository.join("examples/policies/rsl_rl.yaml")).unwrap();
        let path = folder.path().join("p.yaml");
        let text = text.replace("onnx: policy.onnx", "onnx: rsl_rl.onnx").replace("model: go1", "model: go2");
        std::fs::write(&path, text).unwrap();
        let agent = Agent::load(&path).unwrap();
        let mut rig = Rig::to_policy(&agent);
        let output = rig.run(0.1);
        let simulation = &agent.config.simulation;
        assert_eq!(f64::from(output.motors[0].kp), simulation.kp_n_m_per_rad.joints()[0]);
        let steps = rig.policy_steps();
        assert!(steps.abs_diff(simulation.policy_rate_hz) <= 1, "{steps}");
    }

    #[test]
    fn policy_of_another_robot_is_refused() {
        let agent = shipped::find("compliant").unwrap();
        let error = Bridge::new(&agent, None).err().unwrap().to_string();
        assert!(error.contains("go1"), "{error}");
    }
}
