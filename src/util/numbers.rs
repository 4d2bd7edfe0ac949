//! Comparisons that propagate NaN, which `f64::max` ignores, means, and numbers as short texts.

/// Returns the larger number; NaN if one of them is NaN.
pub fn maximum(a: f64, b: f64) -> f64 {
    if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) }
}

/// Returns the largest magnitude: 0 for no numbers, NaN if one of them is NaN.
pub(crate) fn largest_magnitude(numbers: impl IntoIterator<Item = f64>) -> f64 {
    numbers.into_iter().map(f64::abs).fold(0.0, maximum)
}

/// Returns the mean; `None` if there are no values.
pub fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

/// Returns true if all numbers are finite, also in single precision.
pub(crate) fn finite_in_single(numbers: &[f64]) -> bool {
    numbers.iter().all(|number| (*number as f32).is_finite())
}

/// Formats a number as it is, or with an exponent if it would have many zeros.
pub fn brief(value: f64) -> String {
    let is_usual = value == 0.0 || (1e-4..1e7).contains(&value.abs());
    if is_usual { value.to_string() } else { format!("{value:e}") }
}

/// Formats numbers with spaces between them, as XML has them.
pub fn spaced(numbers: &[f64]) -> String {
    numbers.iter().map(f64::to_string).collect::<Vec<_>>().join(" ")
}

/// Formats a number without floating-point noise.
pub fn short(value: f64) -> String {
    ((value * 1e6).round() / 1e6).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn extreme_numbers_have_exponents() {
        let texts = [0.0, 0.6, -1.5, 20.0, 1e-300, -2.5e8, f64::INFINITY].map(brief);
        assert_eq!(texts, ["0", "0.6", "-1.5", "20", "1e-300", "-2.5e8", "inf"]);
    }

    #[test]
    fn what_is_not_a_number_is_not_passed_over() {
        assert_eq!(largest_magnitude([1.0, -3.0, 2.0]), 3.0);
        assert!(largest_magnitude([1.0, f64::NAN, 2.0]).is_nan() && largest_magnitude([f64::NAN]).is_nan());
        assert_eq!(largest_magnitude([f64::NEG_INFINITY, 1.0]), f64::INFINITY);
        assert!(finite_in_single(&[1e38]) && !finite_in_single(&[1e39]) && !finite_in_single(&[f64::NAN]));
    }
}
