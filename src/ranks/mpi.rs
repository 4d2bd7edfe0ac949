/*! Ranks over MPI.

Sums go by recursive doubling: with 8 ranks, each first exchanges numbers with its neighbour, then with the rank two places
away, then four. Both sides compute `a + b`, which has the same bits as `b + a`. Of many numbers, each side of an exchange
sums one half only, and half of that in the next; the sums then go back the same way. So a rank sends less than twice
what it sums, however many ranks there are, and the tree is the same.

A rank that hangs does not take the others with it. Whoever has waited too long tells all others that it waits; those that wait
too say the same; and whoever is not heard of is to blame.
*/

use std::fmt::{self, Debug, Formatter};
use std::ops::{AddAssign, Range};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use std::{hint, mem, process, thread};

use ::mpi::datatype::Equivalence;
use ::mpi::environment::{Universe, processor_name};
use ::mpi::point_to_point::{Destination, Source};
use ::mpi::request::{StaticScope, scope};
use ::mpi::topology::{Communicator, SimpleCommunicator};
use ::mpi::traits::{Buffer, BufferMut};
use ::mpi::{Tag, Threading};

use super::Ranks;
use crate::util::terminal;

/// What numbers travel under.
const NUMBERS: Tag = 0;

/// What a rank tells others under that has waited too long.
const WAITING: Tag = 1;

/// Longest time that the others may take to say that they wait, too.
const HEARING: Duration = Duration::from_secs(2);

/// Fewer numbers are not halved: their way takes no longer than that of half of them.
const MANY: usize = 8192;

/// Looks for an answer before a waiting rank offers its core to others: see [`Team`](crate::ppo).
const SPINS: u32 = 100;

/// One of the processes that `mpirun` has started.
pub struct Mpi {
    /// What leaves MPI when it is dropped.
    universe: Option<Universe>,
    rank: usize,
    /// Rank and host of all of them.
    names: Vec<String>,
    timeout: Duration,
    /// Where those of other ranks go, with room to spare from one sum to the next. Whoever has it may call MPI.
    others: Mutex<(Vec<f32>, Vec<f64>)>,
}

impl Mpi {
    /// Joins the others, and leaves them when it is dropped, on the same thread. No rank waits longer than `timeout` for
    /// another: then it ends the program, and with it all of them.
    ///
    /// # Errors
    /// In words: MPI cannot be used.
    pub fn join(timeout: Duration) -> Result<Self, String> {
        let Some((universe, Threading::Serialized | Threading::Multiple)) =
            ::mpi::initialize_with_threading(Threading::Serialized)
        else {
            return Err("MPI could not be started with threads".into());
        };
        let world = universe.world();
        let names = (0..world.size()).map(|rank| format!("rank {rank}")).collect();
        let (rank, others) = (world.rank() as usize, Mutex::default());
        let mut ranks = Self { universe: Some(universe), rank, names, timeout, others };
        let hosts = ranks.gather(processor_name().unwrap_or_default().into_bytes());
        for (name, host) in ranks.names.iter_mut().zip(hosts) {
            *name = format!("{name} on {}", String::from_utf8_lossy(&host));
        }
        Ok(ranks)
    }

    fn sum_slice<T: Copy + Default + AddAssign + Equivalence>(&self, values: &mut [T], others: &mut Vec<T>)
    where
        [T]: Buffer + BufferMut,
    {
        let mut part = 0..values.len();
        // Halves that others sum, beside those that are summed here.
        let mut halves: Vec<(usize, [Range<usize>; 2])> = Vec::new();
        for level in 0..self.count().trailing_zeros() {
            let partner = self.rank ^ (1 << level);
            let mut theirs = part.clone();
            if part.len() >= MANY {
                let middle = part.start + part.len() / 2;
                (part, theirs) = (part.start..middle, middle..part.end);
                if partner < self.rank {
                    mem::swap(&mut part, &mut theirs);
                }
                halves.push((partner, [part.clone(), theirs.clone()]));
            }
            if others.len() < part.len() {
                others.resize(part.len(), T::default());
            }
            let others = &mut others[..part.len()];
            self.exchange(&values[theirs], partner, others, partner);
            values[part.clone()].iter_mut().zip(others).for_each(|(value, other)| *value += *other);
        }
        for (partner, [part, theirs]) in halves.into_iter().rev() {
            let (low, high) = values.split_at_mut(part.start.max(theirs.start));
            if part.start < theirs.start {
                self.exchange(&low[part], partner, &mut high[..theirs.len()], partner);
            } else {
                self.exchange(&high[..part.len()], partner, &mut low[theirs], partner);
            }
        }
    }

    /// Hands `own` to one rank and takes `others` from one.
    fn exchange<T>(&self, own: &[T], to: usize, others: &mut [T], from: usize)
    where
        [T]: Buffer + BufferMut,
    {
        let world = SimpleCommunicator::world();
        let process = |rank: usize| world.process_at_rank(rank as i32);
        let (since, mut looks) = (Instant::now(), 0);
        scope(|scope| {
            let mut taken = Some(process(from).immediate_receive_into_with_tag(scope, others, NUMBERS));
            let mut given = Some(process(to).immediate_send_with_tag(scope, own, NUMBERS));
            loop {
                taken = taken.and_then(|request| request.test().err());
                given = given.and_then(|request| request.test().err());
                if taken.is_none() && given.is_none() {
                    return;
                }
                if looks < SPINS {
                    looks += 1;
                    hint::spin_loop();
                    continue;
                }
                thread::yield_now();
                if since.elapsed() > self.timeout || world.any_process().immediate_probe_with_tag(WAITING).is_some() {
                    self.end_waiting(from);
                }
            }
        });
    }

    /// Ends this rank, which has waited too long for an answer `from` another, and names who is to blame.
    fn end_waiting(&self, from: usize) -> ! {
        let world = SimpleCommunicator::world();
        for rank in (0..self.count()).filter(|rank| *rank != self.rank) {
            let process = world.process_at_rank(rank as i32);
            mem::forget(process.immediate_send_with_tag(StaticScope, &[0_u8; 0][..], WAITING));
        }
        let mut waiting = vec![false; self.count()];
        waiting[self.rank] = true;
        let until = Instant::now() + HEARING;
        while Instant::now() < until {
            if let Some(heard) = world.any_process().immediate_probe_with_tag(WAITING) {
                waiting[heard.source_rank() as usize] = true;
                let from = world.process_at_rank(heard.source_rank());
                from.receive_into_with_tag(&mut [0_u8; 0][..], WAITING);
            } else {
                thread::sleep(Duration::from_millis(1));
            }
        }
        // One speaks for all of them.
        if waiting.iter().position(|waits| *waits) == Some(self.rank) {
            let silent: Vec<&str> =
                (0..self.count()).filter(|rank| !waiting[*rank]).map(|rank| &*self.names[rank]).collect();
            let silent = if silent.is_empty() { self.names[from].clone() } else { silent.join(", ") };
            let seconds = self.timeout.as_secs();
            terminal::note(format_args!("error: no answer for {seconds} s from {silent}; all ranks end"));
        } else {
            thread::sleep(HEARING);
        }
        process::exit(1)
    }
}

impl Drop for Mpi {
    /// Leaves in peace, which waits for the others to do so too.
    fn drop(&mut self) {
        if thread::panicking() {
            // The others are ended by the end of this one.
            mem::forget(self.universe.take());
        }
    }
}

impl Debug for Mpi {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str(&self.names[self.rank])
    }
}

impl Ranks for Mpi {
    fn index(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.names.len()
    }

    fn name(&self, rank: usize) -> String {
        self.names[rank].clone()
    }

    fn sum(&self, singles: &mut [f32], doubles: &mut [f64]) {
        let (other_singles, other_doubles) = &mut *lock(&self.others);
        self.sum_slice(singles, other_singles);
        self.sum_slice(doubles, other_doubles);
    }

    /// Every rank hands its own to each of the others, the next one first.
    fn gather(&self, own: Vec<u8>) -> Vec<Vec<u8>> {
        let _others = lock(&self.others);
        let (rank, count) = (self.rank, self.count());
        let mut all = vec![Vec::new(); count];
        for distance in 1..count {
            let (to, from) = ((rank + distance) % count, (rank + count - distance) % count);
            let mut length = [0_u64];
            self.exchange(&[own.len() as u64], to, &mut length, from);
            all[from] = vec![0; length[0] as usize];
            self.exchange(&own, to, &mut all[from], from);
        }
        all[rank] = own;
        all
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
