/*! Means over seeds, paired differences with intervals, and verdicts on claims.

A cell of a table is the mean ± standard deviation over seeds, as in the paper. Both methods saw the same trials, so a difference is formed
seed by seed; its 95 % interval is a bootstrap over these pairs. With few pairs the interval of a percentile bootstrap is too narrow. So its
percentiles are moved outwards until normally distributed numbers would give the interval of Student's t (the *expanded* percentile interval
of T. C. Hesterberg, What Teachers Should Know About the Bootstrap, The American Statistician 69, 2015). With fewer than five pairs no
percentile is far enough out, and all pairs have the same sign too often by chance: there is no interval and no verdict.
*/

use std::collections::BTreeMap;

use rand::RngExt;
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

pub use supple::util::numbers::mean;
use supple::util::random::{Purpose, stream};

/// The number of resamples of a bootstrap.
const RESAMPLES: usize = 10_000;

/// The probability that the true value lies beyond the interval, on either side.
const TAIL: f64 = 0.025;

/// The least number of pairs with an interval: four have the same sign by chance once in eight times, five once in sixteen.
const ENOUGH_PAIRS: usize = 5;

/// The numbers by seed; a seed without a number is absent.
pub type PerSeed = BTreeMap<u64, f64>;

/// The mean and standard deviation over seeds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spread {
    pub mean: f64,
    /// The sample standard deviation; none with a single seed.
    pub sd: Option<f64>,
    pub seeds: usize,
}

impl Spread {
    /// Creates the spread of numbers by seed; none if there are no numbers.
    pub fn from_values(values: &PerSeed) -> Option<Self> {
        let seeds = values.len();
        let mean = mean(values.values().copied())?;
        let sd = (seeds > 1).then(|| {
            let squares: f64 = values.values().map(|value| (value - mean).powi(2)).sum();
            (squares / (seeds - 1) as f64).sqrt()
        });
        Some(Spread { mean, sd, seeds })
    }

    /// Returns the spread in another unit.
    pub fn times(self, factor: f64) -> Self {
        Spread { mean: factor * self.mean, sd: self.sd.map(|sd| factor * sd), ..self }
    }
}

/// An estimated number and its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct IntervalEstimate {
    /// The value over all pairs of seeds.
    pub value: f64,
    /// The expanded percentile bootstrap interval; none with fewer than five pairs, or if a resample leaves the number
    /// undefined.
    pub interval: Option<[f64; 2]>,
    /// The number of pairs of seeds.
    pub pairs: usize,
}

/// The number of pairs of trials in a comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Trials {
    /// The pairs in which both policies have the number.
    pub used: usize,
    /// All pairs that were played.
    pub of: usize,
}

/// The numbers of one set of policies in one quantity.
#[derive(Debug, Clone, PartialEq)]
pub struct Numbers {
    /// The numbers of the policies that have one; empty for a number of all policies together.
    pub by_seed: PerSeed,
    pub spread: Option<Spread>,
    /// The number of policies of the set, with or without a number.
    pub members: usize,
}

impl Numbers {
    /// Creates the numbers of a set of `members` policies, by seed.
    pub fn new(by_seed: PerSeed, members: usize) -> Self {
        Numbers { spread: Spread::from_values(&by_seed), by_seed, members }
    }

    fn scaled(&self, factor: f64) -> Self {
        Numbers {
            by_seed: self.by_seed.iter().map(|(seed, value)| (*seed, factor * value)).collect(),
            spread: self.spread.map(|spread| spread.times(factor)),
            members: self.members,
        }
    }

    /// Returns true if every policy of the set has the number.
    fn is_whole(&self) -> bool {
        self.spread.map_or(0, |spread| spread.seeds) == self.members
    }
}

/// The numbers of all sets of policies in one quantity, and the difference of the first two sets.
#[derive(Debug, Clone, PartialEq)]
pub struct Comparison {
    pub sets: Vec<Numbers>,
    /// The first set minus the second, over the seeds that both have.
    pub difference: Option<IntervalEstimate>,
    /// The first set over the second, minus one, over the same seeds; none unless both means are positive.
    pub relative: Option<IntervalEstimate>,
    /// The pairs of trials over the same seeds; none for numbers that are not means over trials.
    pub trials: Option<Trials>,
}

impl Comparison {
    /// Compares the first two sets seed by seed.
    pub fn new(sets: Vec<Numbers>) -> Self {
        let pairs: Vec<[f64; 2]> = match sets.as_slice() {
            [a, b, ..] => a.by_seed.iter().filter_map(|(seed, a)| Some([*a, *b.by_seed.get(seed)?])).collect(),
            _ => Vec::new(),
        };
        let apart = |pair: &usize| pairs[*pair][0] - pairs[*pair][1];
        let difference = estimate(pairs.len(), |chosen| mean(chosen.iter().map(apart)));
        let relative = estimate(pairs.len(), |chosen| {
            let of = |which: usize| mean(chosen.iter().map(|pair| pairs[*pair][which])).filter(|mean| *mean > 0.0);
            Some(of(0)? / of(1)? - 1.0)
        });
        Comparison { sets, difference, relative, trials: None }
    }

    /// Returns the two sets that are compared.
    pub fn pair(&self) -> &[Numbers] {
        &self.sets[..self.sets.len().min(2)]
    }

    /// Sets the number of trials that the numbers are means of.
    pub fn with_trials(mut self, trials: Trials) -> Self {
        self.trials = (trials.of > 0).then_some(trials);
        self
    }

    /// Returns the comparison in another unit; the relative change stays the same.
    pub fn scaled(&self, factor: f64) -> Self {
        Comparison {
            sets: self.sets.iter().map(|set| set.scaled(factor)).collect(),
            difference: self.difference.map(|IntervalEstimate { value, interval, pairs }| IntervalEstimate {
                value: factor * value,
                interval: interval.map(|ends| ends.map(|end| factor * end)),
                pairs,
            }),
            ..*self
        }
    }
}

/// Returns a statistic of pairs with its bootstrap interval. `statistic` receives indices of pairs, with repetitions.
pub fn estimate(pairs: usize, statistic: impl Fn(&[usize]) -> Option<f64>) -> Option<IntervalEstimate> {
    let all: Vec<usize> = (0..pairs).collect();
    let value = statistic(&all)?;
    let tail = tail(pairs).filter(|_| pairs >= ENOUGH_PAIRS);
    let interval = tail.and_then(|tail| interval(pairs, tail, statistic));
    Some(IntervalEstimate { value, interval, pairs })
}

/// Returns the fraction of resamples on either side of the interval of a mean over n pairs: Φ(−t √(n / (n − 1))) with the
/// quantile t of Student's distribution of n − 1 degrees of freedom. None for a single pair.
fn tail(pairs: usize) -> Option<f64> {
    let freedom = pairs as f64 - 1.0;
    let t = StudentsT::new(0.0, 1.0, freedom).ok()?.inverse_cdf(1.0 - TAIL);
    Some(Normal::standard().cdf(-t * (pairs as f64 / freedom).sqrt()))
}

/// Returns the interval of a statistic over resampled pairs, with a fraction `tail` of the resamples on either side of it.
fn interval(pairs: usize, tail: f64, statistic: impl Fn(&[usize]) -> Option<f64>) -> Option<[f64; 2]> {
    // All quantities use the same resamples, so that intervals differ only because the numbers differ.
    let mut rng = stream(0, Purpose::Bootstrap, pairs as u64, 0);
    let mut chosen = vec![0; pairs];
    let mut resample = || {
        chosen.iter_mut().for_each(|pair| *pair = rng.random_range(0..pairs));
        statistic(&chosen)
    };
    let mut found = (0..RESAMPLES).map(|_| resample()).collect::<Option<Vec<f64>>>()?;
    found.sort_by(f64::total_cmp);
    let rank = (tail * (RESAMPLES - 1) as f64).round() as usize;
    Some([found[rank], found[RESAMPLES - 1 - rank]])
}

/// The expected relation of the first set's number to the second's: that of the paper, if it has the experiment.
#[derive(Clone, Copy)]
pub enum Expected {
    Higher,
    Lower,
}

/// The verdict of the numbers on a claim.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The interval lies on the expected side of zero.
    AsExpected,
    /// The interval includes zero.
    NoEffect,
    /// No pair of seeds differs at all, for example because all trials succeed.
    Alike,
    /// The interval lies on the other side of zero.
    Opposite,
    /// There are fewer than five pairs of seeds.
    TooFew,
    /// No seed has a number in both sets, though both sets have numbers.
    Unpaired,
    /// A number is missing on one side or both.
    Undefined,
    /// Both sets are below a bound.
    Holds,
    /// The means of both sets are below a bound, but numbers are missing.
    Incomplete,
    /// A set is not below a bound.
    Fails,
}

impl Verdict {
    /// Judges the difference of a comparison.
    pub fn new(comparison: &Comparison, expected: Expected) -> Self {
        let Some(estimate) = comparison.difference else {
            let both = comparison.pair().iter().all(|set| set.spread.is_some());
            return if both { Verdict::Unpaired } else { Verdict::Undefined };
        };
        let Some([low, high]) = estimate.interval else { return Verdict::TooFew };
        match expected {
            Expected::Higher if low > 0.0 => Verdict::AsExpected,
            Expected::Lower if high < 0.0 => Verdict::AsExpected,
            Expected::Higher if high < 0.0 => Verdict::Opposite,
            Expected::Lower if low > 0.0 => Verdict::Opposite,
            _ if low == 0.0 && high == 0.0 => Verdict::Alike,
            _ => Verdict::NoEffect,
        }
    }

    /// Judges whether the means of the first two sets are below a bound. A policy without the number, most often because it
    /// fell, breaks the bound.
    pub fn from_bound(bound: f64, comparison: &Comparison) -> Self {
        let is_whole = comparison.trials.is_none_or(|trials| trials.used == trials.of);
        let keeps = |set: &Numbers| set.spread.is_some_and(|spread| spread.mean < bound);
        match comparison.pair() {
            pair if pair.iter().all(|set| set.spread.is_none()) => Verdict::Undefined,
            pair if !pair.iter().all(keeps) => Verdict::Fails,
            pair if is_whole && pair.iter().all(Numbers::is_whole) => Verdict::Holds,
            _ => Verdict::Incomplete,
        }
    }

    pub fn text(self) -> &'static str {
        match self {
            Verdict::AsExpected => "effect in the expected direction",
            Verdict::NoEffect => "no effect shown: the 95 % interval includes zero",
            Verdict::Alike => "alike in every pair of seeds",
            Verdict::Opposite => "opposite effect",
            Verdict::TooFew => "too few pairs of seeds to tell",
            Verdict::Unpaired => "no seed has the number in both sets",
            Verdict::Undefined => "not defined for one of the sets",
            Verdict::Holds => "holds for both",
            Verdict::Incomplete => "does not hold: numbers are missing, most often because a robot fell",
            Verdict::Fails => "does not hold for both",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn per_seed(values: &[f64]) -> PerSeed {
        values.iter().enumerate().map(|(seed, value)| (seed as u64, *value)).collect()
    }

    /// Compares two sets in which every policy has a number.
    fn compared(a: PerSeed, b: PerSeed) -> Comparison {
        Comparison::new([a, b].map(|set| Numbers::new(set.clone(), set.len())).into())
    }

    /// Compares two sets without missing numbers.
    fn comparison(a: &[f64], b: &[f64]) -> Comparison {
        compared(per_seed(a), per_seed(b))
    }

    #[test]
    fn mean_and_sample_standard_deviation() {
        // mean 4; squares (2² + 0 + 2²) / (3 − 1) = 4
        let spread = Spread::from_values(&per_seed(&[2.0, 4.0, 6.0])).unwrap();
        assert_eq!((spread.mean, spread.sd, spread.seeds), (4.0, Some(2.0), 3));
        assert_eq!(Spread::from_values(&per_seed(&[3.0])).unwrap().sd, None);
        assert_eq!(Spread::from_values(&PerSeed::new()), None);
    }

    #[test]
    fn constant_shift_has_interval_of_no_width() {
        let comparison = comparison(&[1.5, 2.5, 3.5, 4.5, 5.5], &[1.0, 2.0, 3.0, 4.0, 5.0]);
        let difference = comparison.difference.unwrap();
        assert_eq!((difference.value, difference.interval), (0.5, Some([0.5, 0.5])));
        assert_eq!(Verdict::new(&comparison, Expected::Higher), Verdict::AsExpected);
        assert_eq!(Verdict::new(&comparison, Expected::Lower), Verdict::Opposite);
        // 17.5 / 15 − 1
        assert!((comparison.relative.unwrap().value - 1.0 / 6.0).abs() < 1e-12);
        let percent = comparison.scaled(100.0);
        assert_eq!((percent.sets[0].by_seed[&0], percent.sets[1].spread.unwrap().mean), (150.0, 300.0));
        assert_eq!((percent.difference.unwrap().interval, percent.relative), (Some([50.0, 50.0]), comparison.relative));
    }

    #[test]
    fn equal_pairs_are_alike() {
        assert_eq!(Verdict::new(&comparison(&[1.0; 5], &[1.0; 5]), Expected::Higher), Verdict::Alike);
        let (a, b) = ([1.0, 0.9, 1.0, 1.0, 1.0], [1.0, 1.0, 1.0, 0.9, 1.0]);
        assert_eq!(Verdict::new(&comparison(&a, &b), Expected::Higher), Verdict::NoEffect);
    }

    #[test]
    fn intervals_need_five_pairs() {
        let comparison = comparison(&[2.0, 4.0, 3.0, 3.0], &[1.0; 4]);
        assert_eq!(comparison.difference.unwrap(), IntervalEstimate { value: 2.0, interval: None, pairs: 4 });
        assert_eq!(Verdict::new(&comparison, Expected::Higher), Verdict::TooFew);
        let comparison = self::comparison(&[2.0, 4.0, 3.0, 3.0, 3.0], &[1.0; 5]);
        assert_eq!(Verdict::new(&comparison, Expected::Higher), Verdict::AsExpected);
    }

    #[test]
    fn percentiles_of_few_pairs_are_moved_outwards() {
        // t = 2.776 with 4 degrees of freedom, times √(5/4): Φ(−3.104) = 9.5e-4. Of many pairs they are 2.5 %.
        assert!((tail(5).unwrap() - 9.5e-4).abs() < 1e-5, "{:?}", tail(5));
        assert!((tail(10_000).unwrap() - 0.025).abs() < 1e-4);
    }

    /// Returns the fraction of 200 draws of five pairs without any effect whose interval does not include zero.
    fn false_alarms(tail: f64) -> f64 {
        let mut rng = stream(0, Purpose::Bootstrap, 1, 0);
        let mut alarm = || {
            let drawn: [f64; 5] = std::array::from_fn(|_| rng.sample(rand_distr::StandardNormal));
            let [low, high] = interval(5, tail, |chosen| mean(chosen.iter().map(|pair| drawn[*pair]))).unwrap();
            low > 0.0 || high < 0.0
        };
        (0..200).filter(|_| alarm()).count() as f64 / 200.0
    }

    #[test]
    fn intervals_of_five_null_pairs_rarely_exclude_zero() {
        // One in thirteen, of which one in sixteen by the signs alone; and one in seven.
        let (expanded, plain) = (false_alarms(tail(5).unwrap()), false_alarms(TAIL));
        assert!(expanded < 0.1 && plain > 0.1, "{expanded} {plain}");
    }

    #[test]
    fn only_common_seeds_are_paired() {
        let a: PerSeed = [(0, 1.0), (7, 5.0)].into();
        let b: PerSeed = [(7, 2.0), (9, 100.0)].into();
        let comparison = compared(a, b);
        assert_eq!(comparison.difference, Some(IntervalEstimate { value: 3.0, interval: None, pairs: 1 }));
        assert_eq!(Verdict::new(&comparison, Expected::Higher), Verdict::TooFew);
        let none = compared(per_seed(&[1.0]), PerSeed::new());
        assert_eq!(Verdict::new(&none, Expected::Higher), Verdict::Undefined);
        let apart = compared([(0, 1.0)].into(), [(1, 2.0)].into());
        assert_eq!(Verdict::new(&apart, Expected::Higher), Verdict::Unpaired);
    }

    #[test]
    fn bound_must_hold_for_all_policies() {
        let kept = comparison(&[0.02, 0.04], &[0.03, 0.04]);
        assert_eq!(Verdict::from_bound(0.05, &kept), Verdict::Holds);
        assert_eq!(Verdict::from_bound(0.035, &kept), Verdict::Fails);
        let third = Comparison::new([kept.sets.clone(), vec![Numbers::new(per_seed(&[9.0, 8.0]), 2)]].concat());
        assert_eq!(Verdict::from_bound(0.05, &third), Verdict::Holds);
        assert_eq!(
            Verdict::from_bound(0.05, &kept.clone().with_trials(Trials { used: 3, of: 4 })),
            Verdict::Incomplete
        );
        let one_fell =
            Comparison::new(vec![Numbers::new(per_seed(&[0.02]), 2), Numbers::new(per_seed(&[0.02, 0.03]), 2)]);
        assert_eq!(Verdict::from_bound(0.05, &one_fell), Verdict::Incomplete);
        assert_eq!(Verdict::from_bound(0.05, &compared(PerSeed::new(), PerSeed::new())), Verdict::Undefined);
    }

    #[test]
    fn ratio_undefined_for_a_resample_has_no_interval() {
        let comparison = comparison(&[1.0, 2.0, 3.0, 3.0, 3.0], &[-1.0, 2.0, 2.0, 3.0, 3.0]);
        let relative = comparison.relative.unwrap();
        // 12 / 9 − 1
        assert!((relative.value - 1.0 / 3.0).abs() < 1e-12 && relative.interval.is_none(), "{relative:?}");
    }
}
