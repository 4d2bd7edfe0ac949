//! The ground: a plane, or elevations on a grid.

use std::sync::Arc;

/// The ground that the robot walks on.
#[derive(Debug, Clone, PartialEq)]
pub enum Ground {
    /// An infinite plane at height zero.
    Flat,
    /// A height field centred at the origin.
    Field(Arc<HeightField>),
}

/// Elevations on a regular grid.
#[derive(Debug, Clone, PartialEq)]
pub struct HeightField {
    /// Half-lengths along x and y \[m\].
    pub half_size: [f64; 2],
    /// Number of grid points along y.
    pub rows: usize,
    /// Number of grid points along x.
    pub columns: usize,
    /// Heights \[m\], row-major, shape (rows, columns); row 0 at the smallest y, column 0 at the smallest x.
    pub heights: Vec<f64>,
    /// Sliding friction by place; `None` if it is the same everywhere.
    pub friction: Option<Patches>,
}

/// Square patches of ground that differ in friction.
#[derive(Debug, Clone, PartialEq)]
pub struct Patches {
    /// Edge of a patch \[m\].
    pub edge_m: f64,
    /// Number of patches along x.
    pub columns: usize,
    /// Sliding friction, row-major, shape (rows, columns), centred at the origin; row 0 at the smallest y. Not empty.
    pub friction: Vec<f64>,
}

impl Patches {
    /// Returns the sliding friction at a place; beyond the edge, that of the nearest patch.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let index = |value: f64, count: usize| {
            let square = (value / self.edge_m + 0.5 * count as f64).floor();
            square.clamp(0.0, count as f64 - 1.0) as usize
        };
        let rows = self.friction.len() / self.columns;
        self.friction[index(y, rows) * self.columns + index(x, self.columns)]
    }
}

impl HeightField {
    /// Samples `height(x, y)` \[m\] on a grid of about `spacing_m`, with two points or more along each side.
    pub fn sample(half_size: [f64; 2], spacing_m: f64, height: impl Fn(f64, f64) -> f64) -> Self {
        let points = |half: f64| (2.0 * half / spacing_m).round().max(1.0) as usize + 1;
        let (rows, columns) = (points(half_size[1]), points(half_size[0]));
        let at = |index: usize, count: usize, half: f64| half * (2.0 * index as f64 / (count - 1) as f64 - 1.0);
        let heights = (0..rows * columns)
            .map(|k| height(at(k % columns, columns, half_size[0]), at(k / columns, rows, half_size[1])))
            .collect();
        HeightField { half_size, rows, columns, heights, friction: None }
    }

    /// Returns the steepest slope, rise over run, of the triangles that MuJoCo makes of the grid: each cell is split
    /// from its lowest to its highest corner, and a triangle's slope follows from its edge along x and its edge along
    /// y.
    pub fn steepest(&self) -> f64 {
        let [dx, dy] =
            [2.0 * self.half_size[0] / (self.columns - 1) as f64, 2.0 * self.half_size[1] / (self.rows - 1) as f64];
        let at = |row: usize, column: usize| self.heights[row * self.columns + column];
        let last_column = self.columns.saturating_sub(1);
        let cells = (0..self.rows.saturating_sub(1)).flat_map(|row| (0..last_column).map(move |column| (row, column)));
        let slope = |along_x: f64, along_y: f64| (along_x / dx).hypot(along_y / dy);
        cells.fold(0.0, |steepest: f64, (r, c)| {
            let (low, right, above, far) = (at(r, c), at(r, c + 1), at(r + 1, c), at(r + 1, c + 1));
            steepest.max(slope(right - low, far - right)).max(slope(far - above, above - low))
        })
    }

    /// Returns the lowest and the highest elevation \[m\].
    pub fn range(&self) -> [f64; 2] {
        let low = self.heights.iter().copied().fold(f64::INFINITY, f64::min);
        let high = self.heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        [low, high]
    }

    /// Returns the bilinear elevation \[m\]; beyond the edge, that of the nearest point of the edge.
    fn height(&self, x: f64, y: f64) -> f64 {
        let grid = |value: f64, half: f64, count: usize| {
            let position = ((value / half + 1.0) / 2.0).clamp(0.0, 1.0) * count.saturating_sub(1) as f64;
            let cell = (position as usize).min(count.saturating_sub(2));
            (cell, position - cell as f64)
        };
        let (column, u) = grid(x, self.half_size[0], self.columns);
        let (row, v) = grid(y, self.half_size[1], self.rows);
        let at = |r: usize, c: usize| self.heights[r * self.columns + c];
        // A grid of one row or column is as high everywhere along it.
        let high = ((row + 1).min(self.rows.saturating_sub(1)), (column + 1).min(self.columns.saturating_sub(1)));
        let (low, high) = ((row, column), high);
        at(low.0, low.1) * (1.0 - u) * (1.0 - v)
            + at(low.0, high.1) * u * (1.0 - v)
            + at(high.0, low.1) * (1.0 - u) * v
            + at(high.0, high.1) * u * v
    }
}

impl Ground {
    /// Returns the elevation under a point of the world \[m\].
    pub fn height(&self, x: f64, y: f64) -> f64 {
        match self {
            Ground::Flat => 0.0,
            Ground::Field(field) => field.height(x, y),
        }
    }

    /// Returns the nearest place that has ground for `margin_m` \[m\] around it.
    pub fn nearest(&self, place: [f64; 2], margin_m: f64) -> [f64; 2] {
        let Ground::Field(field) = self else { return place };
        std::array::from_fn(|axis| {
            let reach = (field.half_size[axis] - margin_m).max(0.0);
            place[axis].clamp(-reach, reach)
        })
    }

    /// Returns the patches that differ in friction, if there are any.
    pub fn patches(&self) -> Option<&Patches> {
        match self {
            Ground::Flat => None,
            Ground::Field(field) => field.friction.as_ref(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bilinear_height_is_exact_on_a_plane() {
        let field = HeightField::sample([2.0, 1.0], 0.1, |x, y| 0.3 * x - 0.2 * y);
        for (x, y) in [(0.0, 0.0), (1.234, -0.567), (-1.99, 0.99)] {
            assert!((field.height(x, y) - (0.3 * x - 0.2 * y)).abs() < 1e-12);
        }
        assert_eq!(field.height(9.0, 0.0), field.height(2.0, 0.0));
    }

    #[test]
    fn a_grid_finer_than_its_field_has_heights_everywhere() {
        let field = HeightField::sample([0.1, 2.0], 5.0, |_, _| 0.25);
        assert_eq!((field.rows, field.columns), (2, 2));
        let thin = HeightField { rows: 1, columns: 2, heights: vec![0.0, 1.0], ..field.clone() };
        for (field, expected) in [(field, 0.25), (thin, 0.5)] {
            assert!((field.height(0.0, 1.0) - expected).abs() < 1e-12);
            assert!(field.steepest().is_finite());
        }
    }

    #[test]
    fn the_steepest_slope_of_a_plane_is_its_own() {
        // 0.3 along x and 0.4 along y is 0.5 uphill; a single raised point of 1 cm between neighbours at 10 cm is 0.1
        // along x, 0.1 along y, √2/10 across a triangle that has both.
        let plane = HeightField::sample([2.0, 1.0], 0.1, |x, y| 0.3 * x - 0.4 * y);
        assert!((plane.steepest() - 0.5).abs() < 1e-9);
        let bump = HeightField::sample([1.0, 1.0], 0.1, |x, y| if x.hypot(y) < 0.05 { 0.01 } else { 0.0 });
        assert!((bump.steepest() - 0.1 * std::f64::consts::SQRT_2).abs() < 1e-9, "{}", bump.steepest());
    }

    #[test]
    fn patches_are_looked_up_by_place() {
        // Two rows of three squares of 1 m: x from -1.5 to 1.5, y from -1 to 1.
        let patches = Patches { edge_m: 1.0, columns: 3, friction: vec![0.1, 0.2, 0.3, 0.4, 0.5, 0.6] };
        for (x, y, expected) in [(-1.4, -0.9, 0.1), (0.4, -0.1, 0.2), (0.6, 0.1, 0.6), (-9.0, 9.0, 0.4)] {
            assert_eq!(patches.at(x, y), expected, "{x} {y}");
        }
    }
}
