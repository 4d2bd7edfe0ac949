/*! The Rust half of `benches/python/steps.py`: environments stepped with given actions, as a rollout of training steps them.

    rollout CONFIG ENVIRONMENTS THREADS ACTIONS        actions: f32, shape (steps, environments, joints), little-endian

For every line on standard input it starts the first episodes of seed 0, steps all environments through all actions, and
prints the time \[s\] and the exclusive or of all rewards' bits, by which the other half knows that it did the same work.
Each thread takes its stretch of the environments through all steps, normalised observations and resets included; what a
rollout does besides, networks and bookkeeping, is left out.
*/

use std::io::BufRead;
use std::time::Instant;

use anyhow::Context;
use supple::config::Config;
use supple::robot::JOINTS;
use supple::train::Curriculum;
use supple::train::environment::{LocomotionEnv, Shared};

const SEED: u64 = 0;

fn main() -> anyhow::Result<()> {
    // `cargo bench` adds a flag.
    let arguments: Vec<String> = std::env::args().skip(1).filter(|argument| argument != "--bench").collect();
    let [config, environments, threads, actions] = &arguments[..] else {
        eprintln!("usage: benches/python/steps.py runs this");
        return Ok(());
    };
    let config = Config::load(config)?;
    let (count, threads): (usize, usize) = (environments.parse()?, threads.parse()?);
    let bytes = std::fs::read(actions).with_context(|| actions.clone())?;
    let actions: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|bytes| f32::from_le_bytes(*bytes)).collect();
    let (shared, curriculum) = (Shared::new(&config)?, Curriculum::complete());
    let mut environments = (0..count as u64)
        .map(|k| LocomotionEnv::with_shared(&config, &shared, SEED, k, curriculum))
        .collect::<Result<Vec<_>, _>>()?;
    for line in std::io::stdin().lock().lines() {
        line?;
        environments.iter_mut().try_for_each(|environment| environment.restart(SEED, curriculum))?;
        let started = Instant::now();
        let chunk = count.div_ceil(threads);
        let bits: u64 = std::thread::scope(|scope| {
            let (length, actions) = (shared.layout.length(), &actions[..]);
            let work = |(k, part)| scope.spawn(move || steps(part, k * chunk, count, length, actions));
            let workers: Vec<_> = environments.chunks_mut(chunk).enumerate().map(work).collect();
            let join = |worker: std::thread::ScopedJoinHandle<'_, _>| {
                worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            };
            workers.into_iter().map(join).try_fold(0, |bits, part: anyhow::Result<u64>| anyhow::Ok(bits ^ part?))
        })?;
        println!("{} {bits}", started.elapsed().as_secs_f64());
    }
    Ok(())
}

/// Takes a stretch of `count` environments, from `first` on, through all steps.
fn steps(
    part: &mut [LocomotionEnv],
    first: usize,
    count: usize,
    length: usize,
    actions: &[f32],
) -> anyhow::Result<u64> {
    let (mut seen, mut bits) = (vec![0.0; part.len() * length], 0);
    for actions in actions.chunks_exact(count * JOINTS) {
        let each = part.iter_mut().zip(actions[first * JOINTS..].chunks_exact(JOINTS));
        for ((environment, action), seen) in each.zip(seen.chunks_exact_mut(length)) {
            let (step, _) = environment.step(action);
            bits ^= step.reward.to_bits();
            if step.end.is_some() {
                environment.reset(Curriculum::complete())?;
            }
            environment.normalised_observation(seen);
        }
    }
    Ok(bits)
}
