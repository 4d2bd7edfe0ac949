//! A connection with faults: messages arrive late, out of order, or never.

use std::collections::VecDeque;

use rand::{Rng, RngExt};

/// Errors of a connection, one way.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Faults {
    /// Delay of every message \[s\].
    pub latency_s: f64,
    /// Largest additional delay, uniformly drawn for each message \[s\].
    pub jitter_s: f64,
    /// Fraction of messages that are lost.
    pub loss: f64,
}

/// Messages under way.
pub struct Link<T> {
    faults: Faults,
    /// Time of arrival \[s\] and message, in order of arrival.
    under_way: VecDeque<(f64, T)>,
}

impl<T> Link<T> {
    pub fn new(faults: Faults) -> Self {
        Link { faults, under_way: VecDeque::new() }
    }

    /// Sends a message at `now_s` \[s\].
    pub fn send(&mut self, message: T, now_s: f64, rng: &mut impl Rng) {
        let Faults { latency_s, jitter_s, loss } = self.faults;
        if loss > 0.0 && rng.random_range(0.0..1.0) < loss {
            return;
        }
        let jitter_s = if jitter_s > 0.0 { rng.random_range(0.0..jitter_s) } else { 0.0 };
        let at_s = now_s + latency_s + jitter_s;
        let place = self.under_way.partition_point(|(other_s, _)| *other_s <= at_s);
        self.under_way.insert(place, (at_s, message));
    }

    /// Takes the next message that has arrived by `now_s` \[s\].
    pub fn take(&mut self, now_s: f64) -> Option<T> {
        self.under_way.pop_front_if(|(at_s, _)| *at_s <= now_s).map(|(_, message)| message)
    }

    /// Returns the time at which the next message arrives \[s\].
    pub fn next_s(&self) -> Option<f64> {
        self.under_way.front().map(|(at_s, _)| *at_s)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn messages_arrive_after_latency_and_within_jitter() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut link = Link::new(Faults { latency_s: 0.01, jitter_s: 0.02, loss: 0.0 });
        (0..100).for_each(|number| link.send(number, 0.0, &mut rng));
        assert_eq!(link.take(0.0099), None);
        let arrived: Vec<i32> = std::iter::from_fn(|| link.take(0.03)).collect();
        assert!(arrived.len() == 100 && !arrived.is_sorted());
    }

    #[test]
    fn one_message_in_ten_is_lost_and_none_by_default() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut count = |loss| {
            let mut link = Link::new(Faults { loss, ..Faults::default() });
            (0..10_000).for_each(|number| link.send(number, 0.0, &mut rng));
            std::iter::from_fn(|| link.take(0.0)).count()
        };
        assert_eq!(count(0.0), 10_000);
        // Three standard deviations of the binomial are 90.
        assert!(count(0.1).abs_diff(9000) < 90);
    }
}
