/*! A team of threads that goes through short phases of work together.

A phase lasts tens of microseconds, less than it takes to wake a sleeping thread, so a thread that is done spins until
the others are.

Each thread has a part of a phase's tasks, at the same position in the list in every phase, and helps the others when it
has finished its own. Tasks of different phases that use the same data should therefore be at similar positions of their
lists: a thread then mostly finds in its own cache what it wrote in the phase before, and with as many threads as
networks each thread keeps to one network. Which thread does which task is left to chance and must not matter.

Why no two phases overlap, and why a phase sees everything that the one before has written:

- `arrived` counts the threads that have taken their last task of a phase. Its `fetch_add`s are a chain of
  acquire-release operations on one atomic, so the thread that arrives last has seen all that the others did before they
  arrived. It alone runs `conclude`, and resets `taken` and `arrived` while all others wait; no other thread uses
  them in that time, so those stores can be relaxed.
- It then stores the next `phase` with release. The others leave their wait by an acquire load of that value, and with
  it see the resets, the conclusion, and through it the work of every thread.
- A counter in `taken` only has to hand out every number once, which read-modify-write operations do in any order; it
  carries no data, so it is relaxed.
- A thread reads `phase` when it enters. It cannot be late: the number changes only when all threads have arrived, this
  one included, so it stays as read until this thread has arrived itself. Wrapping round is harmless, as waiting is for
  a change and no thread can fall a whole round behind.
- `broken` carries no data either: it only makes waiting threads panic too, and one that sees it late spins a little
  longer.

ThreadSanitizer agrees: docs/reliability.md.
*/

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::thread;
use std::time::{Duration, Instant};

use crate::ppo::learner::Together;

/// Number of spins before a waiting thread offers its core to others, perhaps to those it waits for: on a busy machine
/// long spins cost more than half of the speed, on an idle one short spins cost nothing.
const SPINS: u32 = 100;

/// The state that the threads of a team share to stay in step.
#[derive(Debug)]
pub struct Team {
    /// Number of tasks taken from each thread's part, by any thread.
    taken: Vec<CacheLine>,
    arrived: AtomicUsize,
    phase: AtomicUsize,
    /// True if a thread of the team has panicked and will never arrive.
    broken: AtomicBool,
}

/// The number of tasks taken from a thread's part, and the time for which the thread has waited \[ns\]. They have a cache line of their
/// own, so that threads do not slow each other down.
#[derive(Debug, Default)]
#[repr(align(64))]
struct CacheLine(AtomicUsize, AtomicU64);

/// A thread of a team.
#[derive(Debug, Clone, Copy)]
pub struct Member<'a> {
    team: &'a Team,
    index: usize,
}

impl Team {
    /// Runs `work` on `threads` threads, this one included, and returns when all are done, with the time that it took.
    ///
    /// # Panics
    /// `work` panics on any thread.
    pub fn run(threads: usize, work: impl Fn(Member<'_>) + Sync) -> Together {
        let start = Instant::now();
        let (taken, broken) = ((0..threads).map(|_| CacheLine::default()).collect(), AtomicBool::new(false));
        let team = Self { taken, arrived: AtomicUsize::new(0), phase: AtomicUsize::new(0), broken };
        let member = |index| {
            let _alarm = Alarm(&team);
            work(Member { team: &team, index });
        };
        thread::scope(|scope| {
            for index in 1..threads {
                scope.spawn(move || member(index));
            }
            member(0);
        });
        let waited = team.taken.iter().map(|line| line.1.load(Ordering::Relaxed)).sum();
        Together { wall: start.elapsed(), waiting: Duration::from_nanos(waited) / threads as u32 }
    }
}

impl Member<'_> {
    /// Runs one phase, called by every thread: does all `tasks` between them, then `conclude` on one thread while the
    /// others wait.
    pub fn phase(&self, tasks: usize, mut task: impl FnMut(usize), conclude: impl FnOnce()) {
        let team = self.team;
        let phase = team.phase.load(Ordering::Acquire);
        let threads = team.taken.len();
        let start = |share: usize| share * tasks / threads;
        for share in (self.index..threads).chain(0..self.index) {
            let (first, length) = (start(share), start(share + 1) - start(share));
            loop {
                let next = team.taken[share].0.fetch_add(1, Ordering::Relaxed);
                if next >= length {
                    break;
                }
                task(first + next);
            }
        }
        if team.arrived.fetch_add(1, Ordering::AcqRel) + 1 == threads {
            conclude();
            team.taken.iter().for_each(|taken| taken.0.store(0, Ordering::Relaxed));
            team.arrived.store(0, Ordering::Relaxed);
            team.phase.store(phase.wrapping_add(1), Ordering::Release);
        } else {
            let since = Instant::now();
            team.wait_while(phase);
            team.taken[self.index].1.fetch_add(since.elapsed().as_nanos() as u64, Ordering::Relaxed);
        }
    }
}

impl Team {
    fn wait_while(&self, phase: usize) {
        let mut spins = 0;
        while self.phase.load(Ordering::Acquire) == phase {
            assert!(!self.broken.load(Ordering::Relaxed), "another thread of the team has panicked");
            if spins < SPINS {
                spins += 1;
                std::hint::spin_loop();
            } else {
                thread::yield_now();
            }
        }
    }
}

/// Notifies the team when its thread panics.
struct Alarm<'a>(&'a Team);

impl Drop for Alarm<'_> {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.broken.store(true, Ordering::Relaxed);
        }
    }
}

// A lock is never used after its writer has panicked: the panic ends the whole team.

/// Locks for reading a value that no task of the phase writes.
pub fn read<T>(lock: &RwLock<T>) -> RwLockReadGuard<'_, T> {
    lock.read().unwrap_or_else(PoisonError::into_inner)
}

/// Locks for writing a value that only this task writes.
pub fn write<T>(lock: &RwLock<T>) -> RwLockWriteGuard<'_, T> {
    lock.write().unwrap_or_else(PoisonError::into_inner)
}

/// Locks a value that is passed between threads.
pub fn lock<T>(lock: &Mutex<T>) -> MutexGuard<'_, T> {
    lock.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    #[test]
    fn every_task_of_a_phase_is_done_once_before_it_is_concluded() {
        for threads in [1, 2, 3, 64] {
            let done = Mutex::new(Vec::new());
            let concluded = Mutex::new(Vec::new());
            Team::run(threads, |team| {
                for round in 0..10 {
                    let task = |task| done.lock().unwrap().push(round * 7 + task);
                    team.phase(7, task, || concluded.lock().unwrap().push(done.lock().unwrap().len()));
                }
            });
            let mut done = done.into_inner().unwrap();
            done.sort_unstable();
            assert_eq!(done, (0..70).collect::<Vec<_>>());
            assert_eq!(concluded.into_inner().unwrap(), (1..=10).map(|round| round * 7).collect::<Vec<_>>());
        }
    }

    #[test]
    #[should_panic]
    fn a_panic_on_one_thread_ends_the_others() {
        Team::run(3, |team| team.phase(3, |task| assert_ne!(task, 1), || ()));
    }
}
