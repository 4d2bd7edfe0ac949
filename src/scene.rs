/*! From a robot file, a ground and obstacles to one compiled model.

MuJoCo 2.2.2 has no arena: the buffers for contacts, constraint rows and the stack are fixed when the model is compiled,
and decide both whether a crowded scene loses contacts and whether a small one stays in cache. The scene knows what is
in it, so the scene sizes them.

Contact masks: robot parts carry contype 1 / conaffinity 2 and never meet each other; grounds and obstacles keep
MuJoCo's 1 / 1 and meet both the robot and one another. They have priority 1, so that their friction holds.

A Go1 alone on a plane can touch nothing but the plane. There the scene names the pairs that may touch, and MuJoCo does
not look for them among all bodies: the same contacts, a quarter more steps per second.
*/

use std::fmt::Write as _;
use std::path::PathBuf;

use crate::config::GO1_NAME;
use crate::files;
use crate::go1::LEGS;
use crate::mujoco::{Error, Kind, Model, Result};
use crate::robot::{Robot, RobotError};

/// The Go1 of `models/go1.xml`.
pub const GO1: &str = include_str!("../models/go1.xml");

/// Name of the geometry that is the ground.
pub const GROUND: &str = "ground";

/// Friction of the ground: sliding, torsional, rolling.
const FRICTION: [f64; 3] = [0.8, 0.005, 0.0001];

/// Where the robot's MJCF comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RobotFile {
    /// The Go1 inside the binary.
    Embedded,
    /// An MJCF file, or a YAML file about one, as [`Robot::load`] reads them.
    Path(PathBuf),
}

impl RobotFile {
    /// [`GO1_NAME`] is the embedded model, anything else a path.
    pub fn from_name(name: &str) -> Self {
        if name == GO1_NAME { RobotFile::Embedded } else { RobotFile::Path(name.into()) }
    }

    /// Identity of the robot: SHA-256 of the MJCF that goes into scenes.
    ///
    /// # Errors
    /// What does not fit in a robot from elsewhere.
    pub fn sha256(&self) -> std::result::Result<String, RobotError> {
        let mjcf = match self {
            RobotFile::Embedded => GO1.to_owned(),
            RobotFile::Path(path) => Robot::load(path)?.mjcf,
        };
        Ok(files::sha256(&[mjcf.as_bytes()]))
    }
}

/// What the robot walks on.
#[derive(Debug, Clone, PartialEq)]
pub enum Ground {
    /// An infinite plane at height zero.
    Flat,
    /// A height field centred at the origin.
    Field(HeightField),
}

/// Elevations on a regular grid.
#[derive(Debug, Clone, PartialEq)]
pub struct HeightField {
    /// Half-lengths along x and y \[m\].
    pub half_size: [f64; 2],
    /// Grid points along y.
    pub rows: usize,
    /// Grid points along x.
    pub columns: usize,
    /// Heights \[m\], row-major, shape (rows, columns); row 0 at the least y, column 0 at the least x.
    pub heights: Vec<f64>,
    /// Friction by place; without, it is the same everywhere.
    pub friction: Option<Patches>,
}

/// Squares of ground that differ in friction.
#[derive(Debug, Clone, PartialEq)]
pub struct Patches {
    /// Edge of a square \[m\].
    pub edge_m: f64,
    /// Squares along x.
    pub columns: usize,
    /// Sliding friction, row-major, shape (rows, columns), centred at the origin; row 0 at the least y. Not empty.
    pub friction: Vec<f64>,
}

impl Patches {
    /// Sliding friction at a place; beyond the edge, that of the nearest square.
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
    /// Samples `height(x, y)` \[m\] on a grid of about `spacing_m`.
    pub fn sample(half_size: [f64; 2], spacing_m: f64, height: impl Fn(f64, f64) -> f64) -> Self {
        let points = |half: f64| (2.0 * half / spacing_m).round() as usize + 1;
        let (rows, columns) = (points(half_size[1]), points(half_size[0]));
        let at = |index: usize, count: usize, half: f64| half * (2.0 * index as f64 / (count - 1) as f64 - 1.0);
        let heights = (0..rows * columns)
            .map(|k| height(at(k % columns, columns, half_size[0]), at(k / columns, rows, half_size[1])))
            .collect();
        HeightField { half_size, rows, columns, heights, friction: None }
    }

    /// Steepest slope, rise over run, of the triangles that MuJoCo makes of the grid: each cell is split from its least
    /// to its greatest corner, and a triangle's slope follows from its edge along x and its edge along y.
    pub fn steepest(&self) -> f64 {
        let [dx, dy] =
            [2.0 * self.half_size[0] / (self.columns - 1) as f64, 2.0 * self.half_size[1] / (self.rows - 1) as f64];
        let at = |row: usize, column: usize| self.heights[row * self.columns + column];
        let cells = (0..self.rows - 1).flat_map(|row| (0..self.columns - 1).map(move |column| (row, column)));
        let slope = |along_x: f64, along_y: f64| (along_x / dx).hypot(along_y / dy);
        cells.fold(0.0, |steepest: f64, (r, c)| {
            let (low, right, above, far) = (at(r, c), at(r, c + 1), at(r + 1, c), at(r + 1, c + 1));
            steepest.max(slope(right - low, far - right)).max(slope(far - above, above - low))
        })
    }

    /// Lowest and highest elevation \[m\].
    pub fn range(&self) -> [f64; 2] {
        let low = self.heights.iter().copied().fold(f64::INFINITY, f64::min);
        let high = self.heights.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        [low, high]
    }

    /// Bilinear elevation \[m\]; beyond the edge, that of the nearest point of the edge.
    fn height(&self, x: f64, y: f64) -> f64 {
        let grid = |value: f64, half: f64, count: usize| {
            let position = ((value / half + 1.0) / 2.0).clamp(0.0, 1.0) * (count - 1) as f64;
            let cell = (position as usize).min(count - 2);
            (cell, position - cell as f64)
        };
        let (column, u) = grid(x, self.half_size[0], self.columns);
        let (row, v) = grid(y, self.half_size[1], self.rows);
        let at = |r: usize, c: usize| self.heights[r * self.columns + c];
        let (low, high) = ((row, column), (row + 1, column + 1));
        at(low.0, low.1) * (1.0 - u) * (1.0 - v)
            + at(low.0, high.1) * u * (1.0 - v)
            + at(high.0, low.1) * (1.0 - u) * v
            + at(high.0, high.1) * u * v
    }
}

impl Ground {
    /// Elevation under a point of the world \[m\].
    pub fn height(&self, x: f64, y: f64) -> f64 {
        match self {
            Ground::Flat => 0.0,
            Ground::Field(field) => field.height(x, y),
        }
    }

    /// Squares that differ in friction, if there are any.
    pub fn patches(&self) -> Option<&Patches> {
        match self {
            Ground::Flat => None,
            Ground::Field(field) => field.friction.as_ref(),
        }
    }
}

/// Sizes of MuJoCo's fixed buffers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Buffers {
    /// Contact points, `nconmax`.
    pub contacts: usize,
    /// Constraint rows, `njmax`.
    pub rows: usize,
    /// Stack \[f64\], `nstack`.
    pub stack: usize,
}

/// A robot on a ground among obstacles.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    /// The robot.
    pub robot: RobotFile,
    /// What it walks on.
    pub ground: Ground,
    /// Physics step \[s\].
    pub timestep_s: f64,
    /// MJCF elements of the world body beside robot and ground, each named.
    pub obstacles: String,
    /// Elements beside the world body (tendons, equalities), empty if there are none.
    pub extras: String,
    /// Attributes of `<option>` that choose another solver, empty for Newton.
    pub solver: &'static str,
    /// Buffer sizes.
    pub buffers: Buffers,
}

impl Scene {
    /// The robot alone on a plane: the training scene.
    pub fn flat(robot: RobotFile, timestep_s: f64) -> Self {
        Scene {
            robot,
            ground: Ground::Flat,
            timestep_s,
            obstacles: String::new(),
            extras: String::new(),
            solver: "",
            buffers: Buffers { contacts: 32, rows: 200, stack: 20_000 },
        }
    }

    /// Compiles the scene to be stepped: without geometries that are only looked at, which nearly halves the cost of a step
    /// and changes no physics.
    ///
    /// # Errors
    /// [`crate::mujoco::Error::Load`] with MuJoCo's message.
    pub fn compile(&self) -> Result<Model> {
        self.compile_xml(&self.xml(true)?)
    }

    /// Compiles the scene to be looked at. Bodies and joints are those of [`Scene::compile`].
    ///
    /// # Errors
    /// [`crate::mujoco::Error::Load`] with MuJoCo's message.
    pub fn compile_visual(&self) -> Result<Model> {
        self.compile_xml(&self.xml(false)?)
    }

    fn compile_xml(&self, scene: &str) -> Result<Model> {
        let mut model = Model::from_xml(&[("scene.xml", scene), ("go1.xml", GO1)])?;
        if let Ground::Field(field) = &self.ground {
            let [low, high] = field.range();
            let id = model.id(Kind::HeightField, GROUND)?;
            let elevations = field.heights.iter().map(|height| ((height - low) / (high - low).max(1e-9)) as f32);
            model.height_field_mut(id).iter_mut().zip(elevations).for_each(|(to, from)| *to = from);
        }
        Ok(model)
    }

    /// The MJCF text that is handed to MuJoCo.
    ///
    /// # Errors
    /// [`Error::Load`] with what does not fit in a robot from elsewhere.
    pub fn xml(&self, discard_visual: bool) -> Result<String> {
        let robot = match &self.robot {
            RobotFile::Embedded => r#"<include file="go1.xml"/>"#.to_owned(),
            RobotFile::Path(path) => {
                let fail = |problem| Error::Load { what: path.display().to_string(), message: problem };
                Robot::load(path).map_err(|error| fail(error.problem))?.mjcf
            }
        };
        let Buffers { contacts, rows, stack } = self.buffers;
        let mut xml = String::new();
        // Writing into a String cannot fail.
        let _ = write!(
            xml,
            r#"<mujoco model="supple">
  {robot}
  <compiler discardvisual="{discard_visual}"/>
  <size njmax="{rows}" nconmax="{contacts}" nstack="{stack}"/>
  <option timestep="{timestep}" integrator="Euler" cone="pyramidal" {solver}/>
{pairs}{assets}{extras}  <worldbody>
    {ground}
{obstacles}  </worldbody>
</mujoco>
"#,
            timestep = self.timestep_s,
            solver = self.solver,
            pairs = self.pairs(),
            assets = self.ground_asset(),
            extras = self.extras,
            ground = self.ground_geom(),
            obstacles = self.obstacles,
        );
        Ok(xml)
    }

    /// What may touch, if that is known: a Go1's own parts and a plane.
    fn pairs(&self) -> String {
        let alone = self.obstacles.is_empty() && self.extras.is_empty();
        if self.ground != Ground::Flat || self.robot != RobotFile::Embedded || !alone {
            return String::new();
        }
        let of_legs = ["hip_collision", "thigh_collision", "calf_collision", "foot"];
        let of_legs = LEGS.iter().flat_map(|leg| of_legs.map(|part| format!("{leg}_{part}")));
        let parts = ["trunk_collision", "head_collision"].into_iter().map(str::to_owned).chain(of_legs);
        let [sliding, torsional, rolling] = FRICTION;
        let friction = format!("{sliding} {sliding} {torsional} {rolling} {rolling}");
        let pair = |part| format!(r#"<pair geom1="{GROUND}" geom2="{part}" condim="3" friction="{friction}"/>"#);
        let pairs: String = parts.map(pair).collect();
        format!("  <option collision=\"predefined\"/>\n  <contact>{pairs}</contact>\n")
    }

    fn ground_asset(&self) -> String {
        let Ground::Field(HeightField { half_size: [x, y], rows, columns, .. }) = &self.ground else {
            return String::new();
        };
        let [low, high] = self.height_range();
        let relief = (high - low).max(1e-9);
        format!(
            "  <asset><hfield name=\"{GROUND}\" nrow=\"{rows}\" ncol=\"{columns}\" size=\"{x} {y} {relief} 0.5\"/></asset>\n"
        )
    }

    /// The ground has priority over everything that touches it: its friction is the contact's friction.
    fn ground_geom(&self) -> String {
        let shape = match self.ground {
            Ground::Flat => r#"type="plane" size="0 0 1""#.to_owned(),
            Ground::Field(_) => {
                format!(r#"type="hfield" hfield="{GROUND}" pos="0 0 {}""#, self.height_range()[0])
            }
        };
        let [sliding, torsional, rolling] = FRICTION;
        format!(
            r#"<geom name="{GROUND}" {shape} condim="3" priority="1" friction="{sliding} {torsional} {rolling}" rgba="0.35 0.38 0.42 1"/>"#
        )
    }

    fn height_range(&self) -> [f64; 2] {
        match &self.ground {
            Ground::Flat => [0.0, 0.0],
            Ground::Field(field) => field.range(),
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
