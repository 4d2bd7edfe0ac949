//! The figures of a run, as a table and as JSON, next to the targets they are held to.

use std::fmt::{Display, Formatter, Result};

use serde::Serialize;
use serde_json::Value;

use crate::estimator::Sensing;
use crate::learner::Update;
use crate::machine::Machine;
use crate::peers::Peers;
use crate::physics::Physics;
use crate::pit::Pit;
use crate::training::Training;

/// All figures. The first seven are ratios within this run; those of peers are none where they did not run.
#[derive(Debug, Serialize)]
pub struct Report {
    env_over_raw: f64,
    update_over_peak: f64,
    update_over_torch: Option<f64>,
    end_to_end_over_sb3: Option<f64>,
    end_to_end_over_sb3_on_supple: Option<f64>,
    thread_scaling: f64,
    ball_pit_real_time: f64,
    machine: Machine,
    physics: Physics,
    update: Update,
    training: Training,
    ball_pit: Pit,
    sensing: Sensing,
    peers: Option<Peers>,
}

impl Report {
    pub fn new(
        machine: Machine,
        physics: Physics,
        update: Update,
        training: Training,
        ball_pit: Pit,
        sensing: Sensing,
        peers: Option<Peers>,
    ) -> Self {
        let torch = peers.as_ref().and_then(|peers| figure(&peers.torch_update, "sample_passes_per_s"));
        let sb3 = peers.as_ref().and_then(|peers| figure(&peers.sb3, "samples_per_s"));
        let on_supple = peers.as_ref().and_then(|peers| figure(&peers.sb3_on_supple, "samples_per_s"));
        Report {
            env_over_raw: physics.all_threads.env_over_raw,
            update_over_peak: update.update_over_peak,
            update_over_torch: torch.map(|torch| update.all_threads.sample_passes_per_s / torch),
            end_to_end_over_sb3: sb3.map(|sb3| training.all_threads.samples_per_s / sb3),
            end_to_end_over_sb3_on_supple: on_supple.map(|sb3| training.all_threads.samples_per_s / sb3),
            thread_scaling: training.speed_up,
            ball_pit_real_time: ball_pit.real_time,
            machine,
            physics,
            update,
            training,
            ball_pit,
            sensing,
            peers,
        }
    }
}

impl Display for Report {
    fn fmt(&self, f: &mut Formatter<'_>) -> Result {
        let Report { machine, physics, update, training, ball_pit, sensing, .. } = self;
        let n = machine.threads;
        writeln!(f, "{}, {n} threads, supple {}", machine.processor, machine.git_revision)?;
        writeln!(f, "others took {:.1} % of the cores' time", 100.0 * machine.taken_by_others)?;
        match machine.quick {
            true => writeln!(f, "a quick run: the figures mean nothing")?,
            false => writeln!(f, "medians of {} repetitions", machine.repetitions)?,
        }
        writeln!(f, "\n{:<46}{:>12}{:>12}", "", "1 thread", format!("{n} threads"))?;
        let mut row = |name: &str, one: f64, all: f64| writeln!(f, "{name:<46}{:>12}{:>12}", short(one), short(all));
        let (one, all) = (&physics.one_thread, &physics.all_threads);
        row("mj_step alone [steps/s]", one.raw_steps_per_s, all.raw_steps_per_s)?;
        row("environment [physics steps/s]", one.env_steps_per_s, all.env_steps_per_s)?;
        row("environment / mj_step", one.env_over_raw, all.env_over_raw)?;
        let (one, all) = (&update.one_thread, &update.all_threads);
        row("update [sample passes/s]", one.sample_passes_per_s, all.sample_passes_per_s)?;
        row("update [GFLOP/s]", one.gflop_per_s, all.gflop_per_s)?;
        for ((precision, rates), over_f32) in update.precisions.iter().zip(&update.over_f32) {
            let name = serde_json::to_value(precision).unwrap_or_default();
            let name = name.as_str().unwrap_or_default();
            row(&format!("  {name} [sample passes/s]"), f64::NAN, rates.sample_passes_per_s)?;
            row(&format!("  {name} / f32"), f64::NAN, *over_f32)?;
        }
        row("update by candle [sample passes/s]", update.candle.sample_passes_per_s, f64::NAN)?;
        row("update in f32 / update by candle", f64::NAN, update.f32_over_candle)?;
        row("1024³ product [GFLOP/s]", f64::NAN, update.peak_gflop_per_s)?;
        let (one, all) = (&training.one_thread, &training.all_threads);
        row("training [samples/s]", one.samples_per_s, all.samples_per_s)?;
        row("  rollout [s]", one.rollout_s, all.rollout_s)?;
        row("  update [s]", one.update_s, all.update_s)?;
        row("  rest [s]", one.rest_s, all.rest_s)?;
        row("sensing, a tick at 240 Hz [µs]", sensing.tick_us, f64::NAN)?;
        row("  contact network [µs]", sensing.network_us, f64::NAN)?;
        row("force observer, a physics step [µs]", sensing.observer_us, f64::NAN)?;
        if let Some(Peers { torch_update, sb3, sb3_on_supple }) = &self.peers {
            let mut row = |name: &str, value: Option<f64>| match value {
                Some(value) => writeln!(f, "{name:<58}{:>12}", short(value)),
                None => writeln!(f, "{name:<58}{:>12}", "-"),
            };
            row("PyTorch's update [sample passes/s]", figure(torch_update, "sample_passes_per_s"))?;
            for (name, sb3) in [("Stable-Baselines3", sb3), ("Stable-Baselines3 on our environment", sb3_on_supple)] {
                row(&format!("{name} [samples/s]"), figure(sb3, "samples_per_s"))?;
                row("  rollout [s]", figure(sb3, "rollout_s"))?;
                row("  update [s]", figure(sb3, "update_s"))?;
            }
        }
        writeln!(f, "\n{:<46}{:>12}{:>12}", "", "measured", "target")?;
        let mut row = |name: &str, value: Option<f64>, target: f64| {
            let (value, verdict) = match value {
                Some(value) if value >= target => (format!("{value:.2}"), "met"),
                Some(value) => (format!("{value:.2}"), "missed"),
                None => ("-".into(), "not measured"),
            };
            writeln!(f, "{name:<46}{value:>12}{:>12}  {verdict}", format!("≥ {target:.2}"))
        };
        row("environment / mj_step", Some(self.env_over_raw), 0.9)?;
        row("update in f32 / matrix products", Some(self.update_over_peak), 0.8)?;
        row("update / PyTorch", self.update_over_torch, 2.2)?;
        row("training / Stable-Baselines3", self.end_to_end_over_sb3, 3.0)?;
        row("all threads / one thread", Some(self.thread_scaling), 1.85)?;
        row("ball pit / real time", Some(self.ball_pit_real_time), 1.0)?;
        row("ball pit / real time, slowest second", Some(ball_pit.slowest_second_real_time), 1.0)?;
        let [found, room] = ball_pit.contacts;
        write!(f, "ball pit: {found} of {room} contacts; {}", ball_pit.fault.as_deref().unwrap_or("no buffer was full"))
    }
}

fn figure(peer: &Option<Value>, name: &str) -> Option<f64> {
    peer.as_ref()?[name].as_f64()
}

fn short(value: f64) -> String {
    match value.abs() {
        _ if value.is_nan() => "-".into(),
        1000.0.. => format!("{value:.0}"),
        100.0.. => format!("{value:.1}"),
        _ => format!("{value:.3}"),
    }
}
