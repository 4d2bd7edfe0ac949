/*! Ties simulated time to real time.

Simulated time never runs ahead of real time by more than one step, and never jumps. A delay up to 50 ms is caught up; a
longer one is dropped, so that a machine that is too slow shows slow motion at [`Clock::rate`].
*/

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use supple::scenario::session::RATE_HZ;

/// Longest delay that is caught up.
const CATCH_UP: Duration = Duration::from_millis(50);

/// Window over which the rate is measured.
const WINDOW: Duration = Duration::from_secs(2);

/// The schedule of ticks in real time.
pub struct Clock {
    /// Reference tick and the time at which it is due.
    origin: (u64, Instant),
    /// Requested ratio of simulated to real time.
    pub speed: f64,
    /// True while paused.
    pub is_paused: bool,
    /// Recent steps: tick and time.
    steps: VecDeque<(u64, Instant)>,
}

impl Clock {
    /// Starts a clock at a tick, in real time.
    pub fn new(tick: u64) -> Self {
        Clock { origin: (tick, Instant::now()), speed: 1.0, is_paused: false, steps: VecDeque::new() }
    }

    /// Returns the time at which a tick is due; `None` while paused.
    pub fn due(&self, tick: u64) -> Option<Instant> {
        let (origin, at) = self.origin;
        let seconds = tick.saturating_sub(origin) as f64 / RATE_HZ as f64 / self.speed;
        (!self.is_paused).then(|| at + Duration::from_secs_f64(seconds))
    }

    /// Notes that the step at this tick was played.
    pub fn stepped(&mut self, tick: u64) {
        let now = Instant::now();
        if let Some(due) = self.due(tick) {
            self.origin.1 += now.saturating_duration_since(due).saturating_sub(CATCH_UP);
        }
        self.steps.push_back((tick, now));
        while self.steps.front().is_some_and(|(_, at)| now.duration_since(*at) > WINDOW) {
            self.steps.pop_front();
        }
    }

    /// Returns the recent ratio of simulated to real time; `None` if measured for too short a time.
    pub fn rate(&self) -> Option<f64> {
        let ((first, since), (last, until)) = (self.steps.front()?, self.steps.back()?);
        let real_s = until.duration_since(*since).as_secs_f64();
        (real_s > 0.25 * WINDOW.as_secs_f64()).then(|| (last - first) as f64 / RATE_HZ as f64 / real_s)
    }

    /// Returns true if the machine is too slow for the requested speed.
    pub fn is_behind(&self) -> bool {
        self.rate().is_some_and(|rate| rate < 0.98 * self.speed)
    }

    /// Restarts at a tick, e.g. after a scene was built.
    pub fn restart(&mut self, tick: u64) {
        self.origin = (tick, Instant::now());
        self.steps.clear();
    }

    /// Changes the speed from this tick on.
    pub fn set_speed(&mut self, speed: f64, tick: u64) {
        self.speed = speed;
        self.restart(tick);
    }

    /// Pauses, or resumes at this tick.
    pub fn pause(&mut self, is_paused: bool, tick: u64) {
        self.is_paused = is_paused;
        self.restart(tick);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_speed_halves_tick_rate() {
        let mut clock = Clock::new(100);
        let start = clock.due(100).unwrap();
        assert_eq!(clock.due(100 + RATE_HZ).unwrap() - start, Duration::from_secs(1));
        clock.set_speed(0.5, 100);
        let start = clock.due(100).unwrap();
        assert_eq!(clock.due(100 + RATE_HZ).unwrap() - start, Duration::from_secs(2));
        clock.pause(true, 100);
        assert_eq!(clock.due(100), None);
    }

    #[test]
    fn small_delay_is_caught_up_large_one_is_dropped() {
        let late = |by: Duration| {
            let mut clock = Clock::new(0);
            clock.origin.1 -= by;
            let due = clock.due(4).unwrap();
            clock.stepped(0);
            clock.due(4).unwrap() - due
        };
        assert_eq!(late(Duration::from_millis(40)), Duration::ZERO);
        let forgiven = late(Duration::from_millis(450));
        assert!(forgiven >= Duration::from_millis(400) && forgiven < Duration::from_millis(440), "{forgiven:?}");
    }
}
