/*! Ranks over MPI.

One thread makes all MPI calls and does nothing else: other threads hand it their numbers and wait
for the results. On a busy machine that is much faster than a call by the thread that has just computed: a thread that
has slept gets a core at once, whereas one that has used up its time slice loses it as soon as it waits.

Sums go by recursive doubling: with 8 ranks, each first exchanges numbers with its neighbour, then with the rank two places
away, then four. Both sides compute `a + b`, which has the same bits as `b + a`. Of many numbers, each side of an exchange
sums one half only, and half of that in the next; the sums then go back the same way. So a rank sends less than twice
what it sums, however many ranks there are, and the tree is the same.

A rank that hangs does not block the others for ever. A rank that has waited too long sends a message to all others; those that wait, too,
reply; the rank that did not answer is reported.
*/

use std::ops::{AddAssign, Range};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use std::{hint, mem, process};

use ::mpi::datatype::Equivalence;
use ::mpi::environment::{Universe, processor_name};
use ::mpi::point_to_point::{Destination, Source};
use ::mpi::request::{StaticScope, scope};
use ::mpi::topology::{Communicator, SimpleCommunicator};
use ::mpi::traits::{Buffer, BufferMut};
use ::mpi::{Tag, Threading};

use super::Ranks;
use crate::util::terminal;

/// The tag of messages with numbers.
const NUMBERS: Tag = 0;

/// The tag of messages from a rank that has waited too long.
const WAITING: Tag = 1;

/// Longest time in which the other ranks must reply that they wait, too.
const HEARING: Duration = Duration::from_secs(2);

/// Number of values below which they are not halved, because halving would save no time.
const MANY: usize = 8192;

/// Number of polls before a waiting rank offers its core to others: see [`Team`](crate::ppo).
const SPINS: u32 = 100;

/// A process started by `mpirun`.
#[derive(Debug)]
pub struct Mpi {
    index: usize,
    /// Host of each rank.
    hosts: Vec<String>,
    messenger: Mutex<Messenger>,
}

#[derive(Debug)]
struct Messenger {
    calls: Sender<Call>,
    answers: Receiver<Call>,
    thread: Option<JoinHandle<()>>,
}

/// A collective operation on numbers, which become its result.
#[derive(Debug)]
enum Call {
    Sum(Vec<f32>, Vec<f64>),
    Gather(Vec<Vec<u8>>),
}

/// MPI is not available, or does not support calls from another thread.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("MPI could not be started with threads")]
pub struct MpiError;

impl Mpi {
    /// Joins the other ranks. A rank that waits longer than `timeout` for another ends the whole program.
    ///
    /// # Errors
    /// MPI is not available, or does not support calls from another thread.
    pub fn join(timeout: Duration) -> Result<Self, MpiError> {
        let (calls, to_do) = channel();
        let (done, answers) = channel();
        let (joined, start) = channel();
        let thread = thread::spawn(move || {
            let Some((universe, Threading::Serialized | Threading::Multiple | Threading::Funneled)) =
                ::mpi::initialize_with_threading(Threading::Funneled)
            else {
                // Dropping `joined` reports the failure.
                return;
            };
            let world = MpiComm::new(&universe, timeout);
            if joined.send((world.rank, world.hosts.clone())).is_err() {
                return;
            }
            let (mut other_singles, mut other_doubles) = (Vec::new(), Vec::new());
            for call in to_do {
                let answer = match call {
                    Call::Sum(mut singles, mut doubles) => {
                        world.sum(&mut singles, &mut other_singles);
                        world.sum(&mut doubles, &mut other_doubles);
                        Call::Sum(singles, doubles)
                    }
                    Call::Gather(own) => Call::Gather(world.gather(own.into_iter().flatten().collect())),
                };
                if done.send(answer).is_err() {
                    return;
                }
            }
        });
        let (index, hosts) = start.recv().map_err(|_| MpiError)?;
        Ok(Self { index, hosts, messenger: Mutex::new(Messenger { calls, answers, thread: Some(thread) }) })
    }

    fn ask(&self, call: Call) -> Call {
        let messenger = self.messenger.lock().unwrap_or_else(PoisonError::into_inner);
        let answer = messenger.calls.send(call).ok().and_then(|()| messenger.answers.recv().ok());
        answer.unwrap_or_else(|| {
            terminal::note(format_args!("error: MPI has failed on {}; all ranks end", self.name(self.index)));
            process::exit(1);
        })
    }
}

impl Drop for Mpi {
    /// Leaves MPI, which waits for the other ranks.
    fn drop(&mut self) {
        let messenger = self.messenger.get_mut().unwrap_or_else(PoisonError::into_inner);
        messenger.calls = channel().0;
        if let Some(thread) = messenger.thread.take().filter(|_| !thread::panicking()) {
            // A thread that panicked has printed its message.
            let _ = thread.join();
        }
    }
}

impl Ranks for Mpi {
    fn index(&self) -> usize {
        self.index
    }

    fn count(&self) -> usize {
        self.hosts.len()
    }

    fn here(&self) -> usize {
        self.hosts.iter().filter(|host| **host == self.hosts[self.index]).count()
    }

    fn name(&self, rank: usize) -> String {
        name(rank, &self.hosts)
    }

    fn sum(&self, singles: &mut Vec<f32>, doubles: &mut Vec<f64>) {
        if let Call::Sum(summed, summed_doubles) = self.ask(Call::Sum(mem::take(singles), mem::take(doubles))) {
            (*singles, *doubles) = (summed, summed_doubles);
        }
    }

    fn gather(&self, own: Vec<u8>) -> Vec<Vec<u8>> {
        match self.ask(Call::Gather(vec![own])) {
            Call::Gather(all) => all,
            Call::Sum(..) => Vec::new(),
        }
    }
}

/// Returns the name of a rank, with its host once it is known.
fn name(rank: usize, hosts: &[String]) -> String {
    match &*hosts[rank] {
        "" => format!("rank {rank}"),
        host => format!("rank {rank} on {host}"),
    }
}

/// The communicator of all ranks, used by the MPI thread.
struct MpiComm {
    ranks: SimpleCommunicator,
    rank: usize,
    count: usize,
    /// Host of each rank; empty until they have been exchanged.
    hosts: Vec<String>,
    timeout: Duration,
}

impl MpiComm {
    fn new(universe: &Universe, timeout: Duration) -> Self {
        let ranks = universe.world();
        let (rank, count) = (ranks.rank() as usize, ranks.size() as usize);
        let mut world = Self { ranks, rank, count, hosts: vec![String::new(); count], timeout };
        let hosts = world.gather(processor_name().unwrap_or_default().into_bytes());
        world.hosts = hosts.iter().map(|host| String::from_utf8_lossy(host).into_owned()).collect();
        world
    }

    /// Sums values over all ranks. `others` is a buffer for those of other ranks, reused from one sum to the next.
    fn sum<T: Copy + Default + AddAssign + Equivalence>(&self, values: &mut [T], others: &mut Vec<T>)
    where
        [T]: Buffer + BufferMut,
    {
        let mut part = 0..values.len();
        // Halves that others sum, beside those that are summed here.
        let mut halves: Vec<(usize, [Range<usize>; 2])> = Vec::new();
        for level in 0..self.count.trailing_zeros() {
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

    /// Sends this rank's bytes to each of the other ranks, the next one first.
    fn gather(&self, own: Vec<u8>) -> Vec<Vec<u8>> {
        let mut all = vec![Vec::new(); self.count];
        for distance in 1..self.count {
            let (to, from) = ((self.rank + distance) % self.count, (self.rank + self.count - distance) % self.count);
            let mut length = [0_u64];
            self.exchange(&[own.len() as u64], to, &mut length, from);
            all[from] = vec![0; length[0] as usize];
            self.exchange(&own, to, &mut all[from], from);
        }
        all[self.rank] = own;
        all
    }

    /// Sends `own` to one rank and receives `others` from one.
    fn exchange<T>(&self, own: &[T], to: usize, others: &mut [T], from: usize)
    where
        [T]: Buffer + BufferMut,
    {
        let process = |rank: usize| self.ranks.process_at_rank(rank as i32);
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
                if since.elapsed() > self.timeout
                    || self.ranks.any_process().immediate_probe_with_tag(WAITING).is_some()
                {
                    self.end_waiting(from);
                }
            }
        });
    }

    /// Ends this rank, which has waited too long for rank `from`, and reports the rank that did not answer.
    fn end_waiting(&self, from: usize) -> ! {
        for rank in (0..self.count).filter(|rank| *rank != self.rank) {
            let process = self.ranks.process_at_rank(rank as i32);
            mem::forget(process.immediate_send_with_tag(StaticScope, &[0_u8; 0][..], WAITING));
        }
        let mut waiting = vec![false; self.count];
        waiting[self.rank] = true;
        let until = Instant::now() + HEARING;
        while Instant::now() < until {
            if let Some(heard) = self.ranks.any_process().immediate_probe_with_tag(WAITING) {
                waiting[heard.source_rank() as usize] = true;
                let from = self.ranks.process_at_rank(heard.source_rank());
                from.receive_into_with_tag(&mut [0_u8; 0][..], WAITING);
            } else {
                thread::sleep(Duration::from_millis(1));
            }
        }
        // One speaks for all of them.
        if waiting.iter().position(|waits| *waits) == Some(self.rank) {
            let silent: Vec<String> =
                (0..self.count).filter(|rank| !waiting[*rank]).map(|rank| name(rank, &self.hosts)).collect();
            let silent = if silent.is_empty() { name(from, &self.hosts) } else { silent.join(", ") };
            let seconds = self.timeout.as_secs();
            terminal::note(format_args!("error: no answer for {seconds} s from {silent}; all ranks end"));
        } else {
            thread::sleep(HEARING);
        }
        process::exit(1)
    }
}
