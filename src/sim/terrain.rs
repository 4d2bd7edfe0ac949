/*! Height fields of uneven ground: Perlin noise, steps and slopes.

Perlin's gradient noise in one octave, scaled so that its highest and lowest point over the field are the wanted magnitude
apart. Every terrain is then flattened around the origin, where the robot starts, and rises smoothly from there.
*/

use rand::RngExt;
use rand::seq::SliceRandom;

use super::HeightField;
use crate::util::random::{Purpose, stream};

/// Radius around the start that stays flat \[m\].
const FLAT_RADIUS_M: f64 = 0.5;

/// Width of the transition from flat to uneven \[m\].
const RAMP_M: f64 = 0.5;

/// Two-dimensional gradient noise with a lattice of unit cells.
#[derive(Debug, Clone)]
pub struct Perlin {
    permutation: Vec<usize>,
    gradients: Vec<[f64; 2]>,
}

impl Perlin {
    /// Draws the noise from a seed.
    pub fn new(seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::Terrain, 0, 0);
        let mut permutation: Vec<usize> = (0..256).collect();
        permutation.shuffle(&mut rng);
        let gradients = (0..256)
            .map(|_| {
                let angle = rng.random_range(0.0..std::f64::consts::TAU);
                [f64::cos(angle), f64::sin(angle)]
            })
            .collect();
        Perlin { permutation, gradients }
    }

    /// Returns the noise at a point: zero on the lattice, within about ±0.7.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let (column, row) = (x.floor(), y.floor());
        let (u, v) = (x - column, y - row);
        let corner = |dx: f64, dy: f64| {
            let index = |value: f64| value.rem_euclid(256.0) as usize;
            let hash = self.permutation[(self.permutation[index(column + dx)] + index(row + dy)) % 256];
            let [gx, gy] = self.gradients[hash];
            gx * (u - dx) + gy * (v - dy)
        };
        let fade = |t: f64| t * t * t * (t * (6.0 * t - 15.0) + 10.0);
        let mix = |a: f64, b: f64, t: f64| a + t * (b - a);
        let lower = mix(corner(0.0, 0.0), corner(1.0, 0.0), fade(u));
        let upper = mix(corner(0.0, 1.0), corner(1.0, 1.0), fade(u));
        mix(lower, upper, fade(v))
    }
}

/// Returns the fraction of the terrain's height at a distance from the start, 0 to 1.
fn onset(x: f64, y: f64) -> f64 {
    let t = ((x.hypot(y) - FLAT_RADIUS_M) / RAMP_M).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

/// Creates Perlin terrain of `magnitude_m` peak to peak with lattice cells of `1 / frequency` metres.
pub fn perlin(half_size: [f64; 2], magnitude_m: f64, frequency: f64, seed: u64) -> HeightField {
    let noise = Perlin::new(seed);
    let spacing_m = 0.04;
    // An offset keeps the start off a lattice point, where the noise is zero for every seed.
    let raw = HeightField::sample(half_size, spacing_m, |x, y| noise.at(frequency * x + 0.37, frequency * y + 0.59));
    let [low, high] = raw.range();
    let scale = if high > low { magnitude_m / (high - low) } else { 0.0 };
    let start = noise.at(0.37, 0.59);
    HeightField::sample(half_size, spacing_m, |x, y| {
        scale * onset(x, y) * (noise.at(frequency * x + 0.37, frequency * y + 0.59) - start)
    })
}

/// Creates wide, smooth hills whose steepest slope (rise over run) is `steepest`.
pub fn hills(half_size: [f64; 2], steepest: f64, frequency: f64, seed: u64) -> HeightField {
    let noise = Perlin::new(seed);
    let start = noise.at(0.37, 0.59);
    // A cell of the noise is metres wide: ten points for each are smooth, and few.
    let spacing_m = (0.04 / frequency).clamp(0.05, 0.2);
    let mut field = HeightField::sample(half_size, spacing_m, |x, y| {
        onset(x, y) * (noise.at(frequency * x + 0.37, frequency * y + 0.59) - start)
    });
    // Heights and slopes grow alike.
    let found = field.steepest();
    let scale = if found > 0.0 { steepest / found } else { 0.0 };
    field.heights.iter_mut().for_each(|height| *height *= scale);
    field
}

/// Creates steps of `height_m` every `length_m` along x, going up and then down again.
pub fn steps(half_size: [f64; 2], height_m: f64, length_m: f64, count: u32) -> HeightField {
    let count = f64::from(count);
    HeightField::sample(half_size, 0.02, |x, _| {
        let climbed = ((x - 1.0) / length_m).floor() + 1.0;
        height_m * climbed.min(2.0 * count + 1.0 - climbed).clamp(0.0, count)
    })
}

/// Creates a slope (rise over run) that begins one metre ahead.
pub fn slope(half_size: [f64; 2], incline: f64) -> HeightField {
    HeightField::sample(half_size, 0.05, |x, _| incline * (x - 1.0).max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_zero_on_the_lattice_and_continuous_across_cells() {
        let noise = Perlin::new(4);
        assert_eq!(noise.at(3.0, -7.0), 0.0);
        assert!((noise.at(2.0 - 1e-9, 0.4) - noise.at(2.0 + 1e-9, 0.4)).abs() < 1e-7);
        assert!(noise.at(0.5, 0.5) != 0.0);
    }

    #[test]
    fn perlin_terrain_is_flat_at_the_start_and_has_its_magnitude() {
        let field = perlin([6.0, 4.0], 0.05, 0.5, 1);
        let [low, high] = field.range();
        // The flat start can only reduce the range.
        assert!(high - low <= 0.05 + 1e-12 && high - low > 0.04, "{low} {high}");
        let centre = (field.rows / 2) * field.columns + field.columns / 2;
        assert_eq!(field.heights[centre], 0.0);
    }

    #[test]
    fn hills_are_as_steep_as_they_should_be_and_flat_at_the_start() {
        for (steepest, seed) in [(0.2, 1), (0.1, 2), (0.2, 3)] {
            let field = hills([8.0, 8.0], steepest, 0.2, seed);
            assert!((field.steepest() - steepest).abs() < 1e-9);
            let ground = crate::sim::Ground::Field(field.clone().into());
            assert_eq!(ground.height(0.2, -0.2), 0.0);
            // Hills, not a dent: the highest point is well above the lowest.
            let [low, high] = field.range();
            assert!(high - low > 1.5 * steepest, "seed {seed}: {low} {high}");
        }
    }

    #[test]
    fn steps_go_up_and_down_again() {
        let field = steps([4.0, 1.0], 0.05, 0.5, 2);
        let height = |x: f64| crate::sim::Ground::Field(field.clone().into()).height(x, 0.0);
        for (x, expected) in [(0.5, 0.0), (1.25, 0.05), (1.75, 0.1), (2.25, 0.1), (2.75, 0.05), (3.25, 0.0)] {
            assert!((height(x) - expected).abs() < 1e-12, "{x}: {}", height(x));
        }
    }
}
