use nalgebra::{SMatrix, SVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

use super::*;

const DT_S: f64 = 1.0 / 240.0;
const ALL: [bool; 4] = [true; 4];
const FOOT_RADIUS_M: f64 = 0.02;

type Whole = SMatrix<f64, 18, 18>;

/// Returns a noise whose misfit limit never acts, so that the filter is linear.
fn linear() -> FilterNoise {
    FilterNoise { misfit_limit: f64::INFINITY, ..FilterNoise::default() }
}

fn normal(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::from_fn(|_, _| rng.sample(StandardNormal))
}

fn some_feet(rng: &mut ChaCha8Rng) -> [FootMeasurement; 4] {
    std::array::from_fn(|leg| {
        let corner = Vector3::new(if leg < 2 { 0.2 } else { -0.2 }, if leg % 2 == 1 { 0.13 } else { -0.13 }, -0.28);
        let (offset, velocity) = (corner + 0.02 * normal(rng), 0.1 * normal(rng));
        FootMeasurement { offset, velocity, spin: normal(rng), radius_m: FOOT_RADIUS_M }
    })
}

/// The textbook filter: 18 states, all rows at once, Joseph's form. Index of a state: 3 · which + axis.
struct Textbook {
    state: SVector<f64, 18>,
    covariance: Whole,
}

impl Textbook {
    fn of(filter: &KalmanFilter) -> Self {
        let mut whole = Textbook { state: SVector::zeros(), covariance: Whole::zeros() };
        for (axis, part) in filter.axes.iter().enumerate() {
            for row in 0..6 {
                whole.state[3 * row + axis] = part.state[row];
                for column in 0..6 {
                    whole.covariance[(3 * row + axis, 3 * column + axis)] = part.covariance[(row, column)];
                }
            }
        }
        whole
    }

    fn step(
        &mut self,
        noise: &FilterNoise,
        acceleration: &Vector3<f64>,
        feet: &[FootMeasurement; 4],
        contacts: [bool; 4],
    ) -> f64 {
        let mut transition = Whole::identity();
        let mut walk = Whole::zeros();
        let mut input = SVector::<f64, 18>::zeros();
        for axis in 0..3 {
            transition[(axis, 3 + axis)] = DT_S;
            walk[(axis, axis)] = noise.position_walk_m_sqrt_s.powi(2) * DT_S;
            walk[(3 + axis, 3 + axis)] = noise.velocity_walk_m_s_sqrt_s.powi(2) * DT_S;
            input[axis] = 0.5 * DT_S * DT_S * acceleration[axis];
            input[3 + axis] = DT_S * acceleration[axis];
            for leg in 0..4 {
                let k = 6 + 3 * leg + axis;
                let sd = if contacts[leg] { noise.stance_walk_m_sqrt_s } else { noise.swing_walk_m_sqrt_s };
                walk[(k, k)] = sd * sd * DT_S;
                if contacts[leg] {
                    input[k] = DT_S * feet[leg].spin.cross(&Vector3::new(0.0, 0.0, FOOT_RADIUS_M))[axis];
                }
            }
        }
        self.state = transition * self.state + input;
        self.covariance = transition * self.covariance * transition.transpose() + walk;
        // Rows of feet in the air carry no information: a variance of 10¹².
        let mut rows = SMatrix::<f64, 28, 18>::zeros();
        let mut values = SVector::<f64, 28>::zeros();
        let mut variances = SVector::<f64, 28>::zeros();
        for leg in 0..4 {
            let blind = if contacts[leg] { 0.0 } else { 1e12 };
            for axis in 0..3 {
                let (position, velocity) = (3 * leg + axis, 12 + 3 * leg + axis);
                rows[(position, axis)] = 1.0;
                rows[(position, 6 + 3 * leg + axis)] = -1.0;
                values[position] = -feet[leg].offset[axis];
                variances[position] = noise.foot_position_m.powi(2);
                rows[(velocity, 3 + axis)] = 1.0;
                values[velocity] = feet[leg].site_velocity()[axis];
                variances[velocity] = noise.velocity_sd(axis).powi(2) + blind;
            }
            rows[(24 + leg, 6 + 3 * leg + 2)] = 1.0;
            values[24 + leg] = FOOT_RADIUS_M;
            variances[24 + leg] = noise.foot_height_m.powi(2) + blind;
        }
        let noise = SMatrix::<f64, 28, 28>::from_diagonal(&variances);
        let innovation = values - rows * self.state;
        let inverse = (rows * self.covariance * rows.transpose() + noise).try_inverse().unwrap();
        let gain = self.covariance * rows.transpose() * inverse;
        self.state += gain * innovation;
        let keep = Whole::identity() - gain * rows;
        self.covariance = keep * self.covariance * keep.transpose() + gain * noise * gain.transpose();
        innovation.dot(&(inverse * innovation))
    }
}

#[test]
fn three_filters_row_by_row_are_the_filter_of_18_states_and_28_rows() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let noise = linear();
    let mut filter = KalmanFilter::new(noise, &Vector3::zeros(), &some_feet(&mut rng), ALL);
    let mut textbook = Textbook::of(&filter);
    for tick in 0..500 {
        let (feet, acceleration) = (some_feet(&mut rng), normal(&mut rng));
        let contacts = if tick < 3 { ALL } else { std::array::from_fn(|_| rng.random_bool(0.6)) };
        let fit = filter.step(&[0.0; 4], &acceleration, false, Some(&feet), contacts, DT_S);
        let squared = textbook.step(&noise, &acceleration, &feet, contacts);
        assert_eq!(fit.rows, 12 + 4 * contacts.iter().filter(|contact| **contact).count());
        assert!((fit.squared - squared).abs() < 1e-4 * squared, "{tick}: {} {squared}", fit.squared);
        let ours = Textbook::of(&filter);
        assert!((ours.state - textbook.state).amax() < 1e-6, "{tick}: {}", (ours.state - textbook.state).amax());
        assert!((ours.covariance - textbook.covariance).amax() < 1e-6);
    }
}

#[test]
fn innovations_match_expected_size_with_own_noise() {
    for seed in 0..5 {
        let [squared, expected] = innovations(linear(), seed);
        // A sum of n squares has mean n and variance 2 n: five standard deviations.
        assert!((squared - expected).abs() < 5.0 * (2.0 * expected).sqrt(), "{squared} {expected}");
        // The default filter lowers the trust in the few rows that fit least, which reduces the sum.
        let [squared, expected] = innovations(FilterNoise::default(), seed);
        assert!(squared > 0.9 * expected && squared < expected, "{squared} {expected}");
    }
}

/// Returns the sum and the number of normalised squared innovations in a world that obeys the filter's own model:
/// states and measurements are drawn with the noise that it assumes.
fn innovations(noise: FilterNoise, seed: u64) -> [f64; 2] {
    let ticks = 4000;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut position, mut velocity) = (Vector3::new(0.0, 0.0, 0.3), Vector3::zeros());
    let mut feet = some_feet(&mut rng).map(|foot| Vector3::new(foot.offset.x, foot.offset.y, FOOT_RADIUS_M));
    let mut filter: Option<KalmanFilter> = None;
    let (mut squared, mut rows) = (0.0, 0);
    for tick in 0..ticks {
        let root = DT_S.sqrt();
        // The input, which the filter gets, too, keeps the random walk bounded.
        let acceleration = 2.0 * normal(&mut rng) - 2.0 * velocity - position + Vector3::new(0.0, 0.0, 0.3);
        position += DT_S * velocity + 0.5 * DT_S * DT_S * acceleration;
        position += noise.position_walk_m_sqrt_s * root * normal(&mut rng);
        velocity += DT_S * acceleration + noise.velocity_walk_m_s_sqrt_s * root * normal(&mut rng);
        let spin = normal(&mut rng);
        let roll = spin.cross(&Vector3::new(0.0, 0.0, FOOT_RADIUS_M));
        let measured: [FootMeasurement; 4] = std::array::from_fn(|leg| {
            feet[leg] += DT_S * roll + noise.stance_walk_m_sqrt_s * root * normal(&mut rng);
            FootMeasurement {
                offset: feet[leg] - position + noise.foot_position_m * normal(&mut rng),
                velocity: roll - velocity
                    + Vector3::from_fn(|axis, _| noise.velocity_sd(axis) * rng.sample::<f64, _>(StandardNormal)),
                spin,
                radius_m: FOOT_RADIUS_M,
            }
        });
        let ground = std::array::from_fn(|leg| {
            feet[leg].z - FOOT_RADIUS_M + noise.foot_height_m * rng.sample::<f64, _>(StandardNormal)
        });
        let filter = filter.get_or_insert_with(|| KalmanFilter::new(noise, &Vector3::zeros(), &measured, ALL));
        let fit = filter.step(&ground, &acceleration, false, Some(&measured), ALL, DT_S);
        if tick >= 240 {
            squared += fit.squared;
            rows += fit.rows;
        }
    }
    [squared, rows as f64]
}
