//! Accuracy of the contact network: confusion counts, precision, recall, F1.

/// Confusion counts of one foot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Confusion {
    /// Contacts that the network reported.
    pub hits: u64,
    /// Reported contacts that were none.
    pub false_alarms: u64,
    /// Contacts that the network missed.
    pub misses: u64,
    /// Times without contact that the network reported as such.
    pub rejections: u64,
}

impl Confusion {
    /// Counts one sample: reported contact `said`, true contact `is`.
    pub fn add(&mut self, said: bool, is: bool) {
        *match (said, is) {
            (true, true) => &mut self.hits,
            (true, false) => &mut self.false_alarms,
            (false, true) => &mut self.misses,
            (false, false) => &mut self.rejections,
        } += 1;
    }

    methods! {
        /// Returns the fraction of reported contacts that are true; `None` if none was reported.
        fn precision(&self) -> Option<f64> = ratio(self.hits, self.hits + self.false_alarms);
        /// Returns the fraction of true contacts that were reported; `None` if there was none.
        fn recall(&self) -> Option<f64> = ratio(self.hits, self.hits + self.misses);
        /// Returns the harmonic mean of precision and recall, `2 h / (2 h + f + m)`; `None` without any contact, true or
        /// reported.
        fn f1(&self) -> Option<f64> = ratio(2 * self.hits, 2 * self.hits + self.false_alarms + self.misses);
    }
}

fn ratio(part: u64, whole: u64) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scores_of_a_hand_counted_table() {
        let mut confusion = Confusion::default();
        assert_eq!((confusion.precision(), confusion.recall(), confusion.f1()), (None, None, None));
        for (said, is, times) in [(true, true, 6), (true, false, 2), (false, true, 4), (false, false, 8)] {
            (0..times).for_each(|_| confusion.add(said, is));
        }
        // 6 / 8, 6 / 10, 12 / 18
        assert_eq!(confusion.precision(), Some(0.75));
        assert_eq!(confusion.recall(), Some(0.6));
        assert_eq!(confusion.f1(), Some(12.0 / 18.0));
    }
}
