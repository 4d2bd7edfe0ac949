/*!
A few threads that go through short phases of work together.

A phase lasts tens of microseconds, less than it takes to wake a sleeping thread, so whoever is done spins until the
others are. Tasks are handed out by a counter: which thread does which is left to chance and must not matter.

Why no two phases overlap, and why a phase sees everything that the one before has written:

- `arrived` counts the threads that have taken their last task of a phase. Its `fetch_add`s are a chain of
  acquire-release operations on one atomic, so the thread that arrives last has seen all that the others did before they
  arrived. It alone runs `conclude`, and resets `next_task` and `arrived` while everybody else waits; nobody else touches
  them in that time, so those stores can be relaxed.
- It then stores the next `phase` with release. The others leave their wait by an acquire load of that value, and with
  it see the resets, the conclusion, and through it the work of every thread.
- `next_task` only has to hand out every number once, which read-modify-write operations do in any order; it carries no
  data, so it is relaxed.
- A thread reads `phase` when it enters. It cannot be late: the number changes only when all threads have arrived, this
  one included, so it stays as read until this thread has arrived itself. Wrapping round is harmless, as waiting is for
  a change and nobody can fall a whole round behind.
- `broken` carries no data either: it only makes waiting threads panic too, and one that sees it late spins a little
  longer.

ThreadSanitizer agrees: docs/reliability.md.
*/

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;

/// Spins before a waiting thread starts to offer its core to others, which may well be those it waits for: on a busy
/// machine long spins cost more than half of the speed, on an idle one short spins cost nothing.
const SPINS: u32 = 100;

/// What the threads of a team share to keep in step.
#[derive(Debug)]
pub struct Team {
    threads: usize,
    next_task: AtomicUsize,
    arrived: AtomicUsize,
    phase: AtomicUsize,
    /// A thread of the team has panicked and will never arrive.
    broken: AtomicBool,
}

impl Team {
    /// Runs `work` on `threads` threads, this one included, and returns when all are done.
    ///
    /// # Panics
    /// When `work` does.
    pub fn run(threads: usize, work: impl Fn(&Team) + Sync) {
        let team = Self {
            threads,
            next_task: AtomicUsize::new(0),
            arrived: AtomicUsize::new(0),
            phase: AtomicUsize::new(0),
            broken: AtomicBool::new(false),
        };
        let member = || {
            let _alarm = Alarm(&team);
            work(&team);
        };
        thread::scope(|scope| {
            for _ in 1..threads {
                scope.spawn(member);
            }
            member();
        });
    }

    /// One phase, called by every thread: does all of `tasks` between them, then `conclude` on one thread alone while
    /// the others wait.
    pub fn phase(&self, tasks: usize, task: impl Fn(usize), conclude: impl FnOnce()) {
        let phase = self.phase.load(Ordering::Acquire);
        loop {
            let next = self.next_task.fetch_add(1, Ordering::Relaxed);
            if next >= tasks {
                break;
            }
            task(next);
        }
        if self.arrived.fetch_add(1, Ordering::AcqRel) + 1 == self.threads {
            conclude();
            self.next_task.store(0, Ordering::Relaxed);
            self.arrived.store(0, Ordering::Relaxed);
            self.phase.store(phase.wrapping_add(1), Ordering::Release);
        } else {
            self.wait_while(phase);
        }
    }

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

/// Tells the team when its thread panics.
struct Alarm<'a>(&'a Team);

impl Drop for Alarm<'_> {
    fn drop(&mut self) {
        if thread::panicking() {
            self.0.broken.store(true, Ordering::Relaxed);
        }
    }
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
                    team.phase(
                        7,
                        |task| done.lock().unwrap().push(round * 7 + task),
                        || concluded.lock().unwrap().push(done.lock().unwrap().len()),
                    );
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
