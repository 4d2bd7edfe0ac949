//! Values on a square grid, such as the success rate over pushes: the fraction above a level and its contour (Fig. 2).

/// Values on a square grid with the same coordinates, ascending, along both axes.
pub struct SquareGrid {
    pub coordinates: Vec<f64>,
    /// The values, shape (n, n), row-major: the row is the first coordinate (forward), the column the second (left).
    pub values: Vec<f64>,
}

/// The tolerance of a level: values that differ from it by rounding only count as above it.
const ROUNDING: f64 = 1e-9;

/// Returns evenly spaced coordinates from `-limit` to `limit`.
pub fn coordinates(limit: f64, points: usize) -> Vec<f64> {
    (0..points).map(|k| limit * (2.0 * k as f64 / (points - 1) as f64 - 1.0)).collect()
}

impl SquareGrid {
    fn side(&self) -> usize {
        self.coordinates.len()
    }

    fn at(&self, row: usize, column: usize) -> f64 {
        self.values[row * self.side() + column]
    }

    /// Returns the fraction of grid points at or above a level, which the paper counts inside its contour.
    pub fn fraction_at_least(&self, level: f64) -> f64 {
        let inside = self.values.iter().filter(|value| **value >= level - ROUNDING).count();
        inside as f64 / self.values.len().max(1) as f64
    }

    /// Returns the line segments of the contour at a level, by marching squares; each end is (first, second) coordinate.
    pub fn contour(&self, level: f64) -> Vec<[[f64; 2]; 2]> {
        let mut segments = Vec::new();
        for row in 0..self.side().saturating_sub(1) {
            for column in 0..self.side() - 1 {
                segments.extend(self.cell(row, column, level));
            }
        }
        segments
    }

    /// Returns the segments within the cell whose corner with the least coordinates is given.
    fn cell(&self, row: usize, column: usize, level: f64) -> Vec<[[f64; 2]; 2]> {
        // Around the cell: corners 0..4 and the edge that follows each.
        let corners = [(row, column), (row + 1, column), (row + 1, column + 1), (row, column + 1)];
        let value = |corner: usize| self.at(corners[corner].0, corners[corner].1);
        let above = |corner: usize| value(corner) >= level - ROUNDING;
        let crossing = |edge: usize| {
            let (from, to) = (edge, (edge + 1) % 4);
            let part = ((level - value(from)) / (value(to) - value(from))).clamp(0.0, 1.0);
            let point = |corner: usize| [self.coordinates[corners[corner].0], self.coordinates[corners[corner].1]];
            let (start, end) = (point(from), point(to));
            [start[0] + part * (end[0] - start[0]), start[1] + part * (end[1] - start[1])]
        };
        let crossed: Vec<usize> = (0..4).filter(|edge| above(*edge) != above((edge + 1) % 4)).collect();
        match crossed.as_slice() {
            [first, second] => vec![[crossing(*first), crossing(*second)]],
            // A saddle: the mean decides which corners belong together.
            [_, _, _, _] => {
                let centre_above = (0..4).map(value).sum::<f64>() / 4.0 >= level - ROUNDING;
                let pairs = if centre_above == above(0) { [[0, 1], [2, 3]] } else { [[3, 0], [1, 2]] };
                pairs.iter().map(|[first, second]| [crossing(*first), crossing(*second)]).collect()
            }
            _ => Vec::new(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surface(points: usize, of: impl Fn(f64, f64) -> f64) -> SquareGrid {
        let coordinates = coordinates(1.5, points);
        let values = coordinates.iter().flat_map(|x| coordinates.iter().map(|y| of(*x, *y))).collect();
        SquareGrid { coordinates, values }
    }

    #[test]
    fn fraction_of_a_known_surface() {
        // 1 inside |x|, |y| ≤ 0.75, 0 outside: 7 × 7 of 13 × 13 points at a spacing of 0.25.
        let grid = surface(13, |x, y| f64::from(u8::from(x.abs() <= 0.76 && y.abs() <= 0.76)));
        assert_eq!(grid.fraction_at_least(0.8), 49.0 / 169.0);
        assert_eq!(grid.fraction_at_least(0.0), 1.0);
        // Eight of ten trials are 80 %, whatever the rounding.
        let tenths = SquareGrid { coordinates: vec![0.0, 1.0], values: vec![0.1 * 8.0, 0.7 + 0.1, 0.8 - 1e-12, 0.79] };
        assert_eq!(tenths.fraction_at_least(0.8), 0.75);
    }

    #[test]
    fn contour_of_a_cone_is_a_circle() {
        // 1 − r/2 = 0.5 at r = 1.
        let grid = surface(61, |x, y| 1.0 - 0.5 * x.hypot(y));
        let segments = grid.contour(0.5);
        assert!(segments.iter().flatten().all(|[x, y]| (x.hypot(*y) - 1.0).abs() < 2e-3));
        let length: f64 = segments.iter().map(|[a, b]| (a[0] - b[0]).hypot(a[1] - b[1])).sum();
        assert!((length - std::f64::consts::TAU).abs() < 0.01, "{length}");
    }

    #[test]
    fn saddle_with_low_middle_separates_high_corners() {
        let grid = SquareGrid { coordinates: vec![0.0, 1.0], values: vec![1.0, 0.0, 0.0, 1.0] };
        for level in [0.4, 0.6] {
            let segments = grid.contour(level);
            assert_eq!(segments.len(), 2);
            // Both cut off a corner 0.4 away from it: the low corners at 0.4, the high ones at 0.6.
            for [a, b] in segments {
                assert!(((a[0] - b[0]).hypot(a[1] - b[1]) - 0.4 * 2.0_f64.sqrt()).abs() < 1e-9);
            }
        }
    }
}
