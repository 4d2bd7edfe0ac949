/*! Ranks over MPI.

All calls of MPI are made by one thread, which does nothing else. Whoever wants something hands its numbers over and waits
for them to come back, but no longer than a time limit: a rank that hangs does not take the others with it, and it is known
which one they waited for.

Sums go by recursive doubling: with 8 ranks, each first exchanges numbers with its neighbour, then with the rank two places
away, then four. Both sides compute `a + b`, which has the same bits as `b + a`.
*/

use std::process;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{self, JoinHandle};
use std::time::Duration;

use ::mpi::Threading;
use ::mpi::datatype::Equivalence;
use ::mpi::environment::{Universe, processor_name};
use ::mpi::point_to_point::send_receive_into;
use ::mpi::topology::Communicator;
use ::mpi::traits::{Buffer, BufferMut};

use super::Ranks;
use crate::util::terminal;

/// Whom a rank waits for that waits for all of them.
const EVERYBODY: usize = usize::MAX;

/// One of the processes that `mpirun` has started.
#[derive(Debug)]
pub struct Mpi {
    index: usize,
    /// Of all hosts, by rank.
    hosts: Vec<String>,
    /// Longest wait for another rank.
    timeout: Duration,
    /// The rank that is waited for.
    awaited: Arc<AtomicUsize>,
    messenger: Mutex<Messenger>,
}

#[derive(Debug)]
struct Messenger {
    calls: Sender<Call>,
    answers: Receiver<Call>,
    thread: Option<JoinHandle<()>>,
}

/// What is to be done with numbers, and the numbers, which come back done.
#[derive(Debug)]
enum Call {
    Sum(Vec<f32>, Vec<f64>),
    Gather(Vec<Vec<u8>>),
}

impl Mpi {
    /// Joins the others. No rank waits longer than `timeout` for another: then it ends the program, and with it all of them.
    ///
    /// # Errors
    /// In words: MPI cannot be used.
    pub fn join(timeout: Duration) -> Result<Self, String> {
        let (calls, to_do) = channel();
        let (done, answers) = channel();
        let (joined, start) = channel();
        let awaited = Arc::new(AtomicUsize::new(EVERYBODY));
        let waiting_for = Arc::clone(&awaited);
        let thread = thread::spawn(move || {
            let Some((universe, Threading::Serialized | Threading::Multiple | Threading::Funneled)) =
                ::mpi::initialize_with_threading(Threading::Funneled)
            else {
                // `joined` is dropped, which says as much.
                return;
            };
            let world = World { universe: &universe, waiting_for: &waiting_for };
            let hosts = world.gather(processor_name().unwrap_or_default().into_bytes());
            if joined.send((world.rank(), hosts)).is_err() {
                return;
            }
            for call in to_do {
                let answer = match call {
                    Call::Sum(mut singles, mut doubles) => {
                        world.sum(&mut singles);
                        world.sum(&mut doubles);
                        Call::Sum(singles, doubles)
                    }
                    Call::Gather(own) => Call::Gather(world.gather(own.into_iter().flatten().collect())),
                };
                if done.send(answer).is_err() {
                    return;
                }
            }
        });
        let (index, hosts) = start.recv().map_err(|_| "MPI could not be started with threads")?;
        let hosts: Vec<String> = hosts.into_iter().map(|host| String::from_utf8_lossy(&host).into_owned()).collect();
        let messenger = Mutex::new(Messenger { calls, answers, thread: Some(thread) });
        Ok(Self { index, hosts, timeout, awaited, messenger })
    }

    fn ask(&self, call: Call) -> Call {
        let messenger = self.messenger.lock().unwrap_or_else(PoisonError::into_inner);
        let sent = messenger.calls.send(call);
        let answer = sent.map_err(|_| RecvTimeoutError::Disconnected);
        match answer.and_then(|()| messenger.answers.recv_timeout(self.timeout)) {
            Ok(answer) => answer,
            Err(RecvTimeoutError::Timeout) => {
                let awaited = match self.awaited.load(Ordering::Relaxed) {
                    EVERYBODY => "the other ranks".to_owned(),
                    rank => self.name(rank),
                };
                let (own, seconds) = (self.name(self.index), self.timeout.as_secs());
                terminal::note(format_args!("error: {own} has waited {seconds} s for {awaited}; all ranks end"));
                process::exit(1);
            }
            Err(RecvTimeoutError::Disconnected) => {
                terminal::note(format_args!("error: MPI has failed on {}; all ranks end", self.name(self.index)));
                process::exit(1);
            }
        }
    }
}

impl Drop for Mpi {
    /// Leaves in peace, which waits for the others to do so too.
    fn drop(&mut self) {
        let messenger = self.messenger.get_mut().unwrap_or_else(PoisonError::into_inner);
        messenger.calls = channel().0;
        if let Some(thread) = messenger.thread.take().filter(|_| !thread::panicking()) {
            // A thread that panicked has said so itself.
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

    fn name(&self, rank: usize) -> String {
        format!("rank {rank} on {}", self.hosts.get(rank).map_or("?", String::as_str))
    }

    fn sum(&self, singles: &mut Vec<f32>, doubles: &mut Vec<f64>) {
        if let Call::Sum(summed, summed_doubles) = self.ask(Call::Sum(std::mem::take(singles), std::mem::take(doubles)))
        {
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

/// All ranks, as the thread that calls MPI knows them.
struct World<'a> {
    universe: &'a Universe,
    waiting_for: &'a AtomicUsize,
}

impl World<'_> {
    fn rank(&self) -> usize {
        self.universe.world().rank() as usize
    }

    fn sum<T: Copy + Default + std::ops::AddAssign + Equivalence>(&self, values: &mut [T])
    where
        [T]: Buffer + BufferMut,
    {
        let world = self.universe.world();
        if values.is_empty() {
            return;
        }
        let mut others = vec![T::default(); values.len()];
        let mut distance = 1;
        while distance < world.size() {
            let partner = world.rank() ^ distance;
            self.waiting_for.store(partner as usize, Ordering::Relaxed);
            let process = world.process_at_rank(partner);
            send_receive_into(values, &process, &mut others[..], &process);
            values.iter_mut().zip(&others).for_each(|(value, other)| *value += *other);
            distance *= 2;
        }
        self.waiting_for.store(EVERYBODY, Ordering::Relaxed);
    }

    /// Every rank hands its own to each of the others, the next one first, so that it is known who is waited for.
    fn gather(&self, own: Vec<u8>) -> Vec<Vec<u8>> {
        let world = self.universe.world();
        let (rank, count) = (world.rank(), world.size());
        let mut all = vec![Vec::new(); count as usize];
        for distance in 1..count {
            let (to, from) = ((rank + distance) % count, (rank - distance + count) % count);
            self.waiting_for.store(from as usize, Ordering::Relaxed);
            let (to, source) = (world.process_at_rank(to), world.process_at_rank(from));
            let mut length = 0_u64;
            send_receive_into(&(own.len() as u64), &to, &mut length, &source);
            let mut others = vec![0_u8; length as usize];
            send_receive_into(&own[..], &to, &mut others[..], &source);
            all[from as usize] = others;
        }
        self.waiting_for.store(EVERYBODY, Ordering::Relaxed);
        all[rank as usize] = own;
        all
    }
}
