/*! Simulated time against real time.

Simulated time never runs ahead of real time by more than the step that is being played, and never jumps. If a machine is too
slow for it, there is a debt: a small one is made up for, as after a hiccup, a larger one is forgiven. What is seen is then
slow motion, and [`Clock::rate`] says how slow.
*/

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use supple::scenario::session::RATE_HZ;

/// A debt up to here is made up for.
const MADE_UP: Duration = Duration::from_millis(50);

/// Over which time the rate is measured.
const MEASURED: Duration = Duration::from_secs(2);

/// When ticks are due.
#[derive(Debug)]
pub struct Clock {
    /// A tick, and when it was due.
    origin: (u64, Instant),
    /// Simulated time over real time that is asked for.
    speed: f64,
    is_paused: bool,
    /// Steps of late: tick and when.
    steps: VecDeque<(u64, Instant)>,
}

impl Clock {
    /// At a tick, in real time.
    pub fn new(tick: u64) -> Self {
        Clock { origin: (tick, Instant::now()), speed: 1.0, is_paused: false, steps: VecDeque::new() }
    }

    /// When a tick is due; never while paused.
    pub fn due(&self, tick: u64) -> Option<Instant> {
        let (origin, at) = self.origin;
        let seconds = tick.saturating_sub(origin) as f64 / RATE_HZ as f64 / self.speed;
        (!self.is_paused).then(|| at + Duration::from_secs_f64(seconds))
    }

    /// The step at this tick was played.
    pub fn stepped(&mut self, tick: u64) {
        let now = Instant::now();
        if let Some(late) =
            self.due(tick).and_then(|due| now.checked_duration_since(due)).filter(|late| *late > MADE_UP)
        {
            self.origin.1 += late - MADE_UP;
        }
        self.steps.push_back((tick, now));
        while self.steps.front().is_some_and(|(_, at)| now.duration_since(*at) > MEASURED) {
            self.steps.pop_front();
        }
    }

    /// Simulated time over real time of late; none if there is too little to say.
    pub fn rate(&self) -> Option<f64> {
        let ((first, since), (last, until)) = (self.steps.front()?, self.steps.back()?);
        let real_s = until.duration_since(*since).as_secs_f64();
        (real_s > 0.25 * MEASURED.as_secs_f64()).then(|| (last - first) as f64 / RATE_HZ as f64 / real_s)
    }

    /// Whether the machine is too slow for the speed that is asked for.
    pub fn is_behind(&self) -> bool {
        self.rate().is_some_and(|rate| rate < 0.98 * self.speed)
    }

    /// Starts anew at a tick, as after a pause in which a scene was built.
    pub fn restart(&mut self, tick: u64) {
        self.origin = (tick, Instant::now());
        self.steps.clear();
    }

    /// Simulated time over real time that is asked for.
    pub fn speed(&self) -> f64 {
        self.speed
    }

    /// Asks for another speed from this tick on.
    pub fn set_speed(&mut self, speed: f64, tick: u64) {
        self.speed = speed;
        self.restart(tick);
    }

    /// Whether time stands still.
    pub fn is_paused(&self) -> bool {
        self.is_paused
    }

    /// Stops time, or lets it go on from this tick.
    pub fn pause(&mut self, is_paused: bool, tick: u64) {
        self.is_paused = is_paused;
        self.restart(tick);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_due_at_their_rate_and_at_half_the_speed_half_as_often() {
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
    fn a_small_debt_is_made_up_for_and_a_large_one_forgiven() {
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
