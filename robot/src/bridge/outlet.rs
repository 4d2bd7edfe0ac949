/*! Sends commands to the robot. If the bridge gives none for 100 ms, for example because its policy hangs, the outlet damps until it is
reset. Its last commands, also when a panic ends the program, are damping. */

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use supple::robot::JOINTS;

use crate::message::MotorCmd;
use crate::motor;

/// Time between two damping commands of the outlet.
const PERIOD: Duration = Duration::from_millis(2);

/// Number of commands that damp at the end: one may be lost.
const LAST: usize = 25;

/// Where commands go.
type Sink = Box<dyn Fn(&[MotorCmd; JOINTS]) + Send>;

struct Slot {
    sink: Sink,
    last: Instant,
    has_tripped: bool,
}

/// Sends commands, and damps if they stop coming.
pub struct Outlet {
    slot: Arc<Mutex<Slot>>,
    ends: Arc<AtomicBool>,
    watch: Option<JoinHandle<()>>,
}

impl Outlet {
    /// Opens an outlet that damps after a silence of `limit`.
    pub fn new(limit: Duration, sink: impl Fn(&[MotorCmd; JOINTS]) + Send + 'static) -> Self {
        let slot = Slot { sink: Box::new(sink), last: Instant::now(), has_tripped: false };
        let (slot, ends) = (Arc::new(Mutex::new(slot)), Arc::new(AtomicBool::new(false)));
        let (watched, ending) = (Arc::clone(&slot), Arc::clone(&ends));
        let watch = move || {
            while !ending.load(Ordering::Relaxed) {
                let mut slot = watched.lock().unwrap_or_else(PoisonError::into_inner);
                if slot.last.elapsed() > limit {
                    slot.has_tripped = true;
                }
                if slot.has_tripped {
                    (slot.sink)(&motor::damping());
                }
                drop(slot);
                std::thread::sleep(PERIOD);
            }
        };
        Outlet { slot, ends, watch: Some(std::thread::spawn(watch)) }
    }

    /// Sends a command, unless the outlet has tripped; returns true if it was sent.
    pub fn send(&self, motors: &[MotorCmd; JOINTS]) -> bool {
        let mut slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        slot.last = Instant::now();
        if !slot.has_tripped {
            (slot.sink)(motors);
        }
        !slot.has_tripped
    }

    /// Lets commands through again.
    pub fn reset(&self) {
        let mut slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        (slot.has_tripped, slot.last) = (false, Instant::now());
    }
}

impl Drop for Outlet {
    fn drop(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(watch) = self.watch.take() {
            // A thread that has panicked sends nothing any more.
            let _ = watch.join();
        }
        let slot = self.slot.lock().unwrap_or_else(PoisonError::into_inner);
        for _ in 0..LAST {
            (slot.sink)(&motor::damping());
            std::thread::sleep(PERIOD);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn hanging_bridge_is_damped_and_stays_so_until_reset() {
        let (sender, sent) = channel();
        let outlet = Outlet::new(Duration::from_millis(100), move |motors| {
            let _ = sender.send((Instant::now(), motors[0].clone()));
        });
        let command = motor::holding(&[0.0; JOINTS], &[40.0; JOINTS], &[0.0; JOINTS]);
        assert!(outlet.send(&command));
        let begin = Instant::now();
        assert_eq!(sent.recv().unwrap().1, command[0]);
        // The bridge hangs.
        let (at, damped) = sent.recv_timeout(Duration::from_secs(5)).unwrap();
        assert_eq!(damped, motor::damping()[0]);
        assert!(at - begin >= Duration::from_millis(100));
        assert!(!outlet.send(&command));
        assert_eq!(sent.recv().unwrap().1, motor::damping()[0]);
        outlet.reset();
        while sent.try_recv().is_ok() {}
        assert!(outlet.send(&command));
    }

    #[test]
    fn last_command_damps_also_after_a_panic() {
        let (sender, sent) = channel();
        let outlet = Outlet::new(Duration::from_secs(60), move |motors| drop(sender.send(motors[0].clone())));
        let ended = std::panic::catch_unwind(std::panic::AssertUnwindSafe(move || {
            outlet.send(&motor::holding(&[0.0; JOINTS], &[40.0; JOINTS], &[0.0; JOINTS]));
            panic!("as a policy may");
        }));
        assert!(ended.is_err());
        assert_eq!(sent.try_iter().last(), Some(motor::damping()[0].clone()));
    }
}
