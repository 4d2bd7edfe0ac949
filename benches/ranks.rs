//! How long the ranks take to sum, by size: `mpirun -n 2 target/release/deps/ranks-…`, which
//! `cargo bench --features mpi --bench ranks --no-run` builds and names.

use std::time::{Duration, Instant};

use supple::ranks::{Mpi, Ranks};

/// Sizes \[f32\]: of the loss sums, and 2ᵏ; the two networks of Table III have 125 709 parameters.
const SIZES: [usize; 7] = [16, 256, 4096, 32_768, 125_709, 524_288, 2_097_152];

/// Sums of each size in a measurement.
const SUMS: u32 = 200;

/// Measurements, of which the median counts.
const REPETITIONS: usize = 5;

fn main() {
    let ranks = match Mpi::join(Duration::from_secs(60)) {
        Ok(ranks) => ranks,
        Err(error) => {
            eprintln!("error: {error}");
            std::process::exit(2)
        }
    };
    for size in SIZES {
        let mut numbers = vec![0.0_f32; size];
        let mut sums = || {
            let started = Instant::now();
            (0..SUMS).for_each(|_| ranks.sum(&mut numbers, &mut vec![0.0; 16]));
            1e6 * started.elapsed().as_secs_f64() / f64::from(SUMS)
        };
        sums();
        let mut times_us: Vec<f64> = (0..REPETITIONS).map(|_| sums()).collect();
        times_us.sort_by(f64::total_cmp);
        if ranks.index() == 0 {
            let (count, time_us) = (ranks.count(), times_us[REPETITIONS / 2]);
            println!("{count} ranks, {size} f32 and 16 f64: {time_us:.1} µs");
        }
    }
}
