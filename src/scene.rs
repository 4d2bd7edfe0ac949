/*! From a robot file, a ground and obstacles to one compiled model.

MuJoCo 2.2.2 has no arena: the buffers for contacts, constraint rows and the stack are fixed when the model is compiled,
and decide both whether a crowded scene loses contacts and whether a small one stays in cache. The scene knows what is
in it, so the scene sizes them.

Contact masks: robot parts carry contype 1 / conaffinity 2 and never meet each other; grounds and obstacles keep
MuJoCo's 1 / 1 and meet both the robot and one another. They have priority 1, so that their friction holds.
*/

use std::fmt::Write as _;
use std::path::PathBuf;

use crate::mujoco::{Kind, Model, Result};

/// The Go1 of `models/go1.xml`.
pub const GO1: &str = include_str!("../models/go1.xml");

/// Name of the geometry that is the ground.
pub const GROUND: &str = "ground";

/// Where the robot's MJCF comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum RobotFile {
    /// The Go1 inside the binary.
    Embedded,
    /// An MJCF file.
    Path(PathBuf),
}

impl RobotFile {
    /// `go1` is the embedded model, anything else a path.
    pub fn from_name(name: &str) -> Self {
        if name == "go1" { RobotFile::Embedded } else { RobotFile::Path(name.into()) }
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
        HeightField { half_size, rows, columns, heights }
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

    /// Compiles the scene to be stepped: without geometries that are only looked at, which halves the cost of a step
    /// and changes no physics.
    ///
    /// # Errors
    /// [`crate::mujoco::Error::Load`] with MuJoCo's message.
    pub fn compile(&self) -> Result<Model> {
        self.compile_xml(&self.xml(true))
    }

    /// Compiles the scene to be looked at. Bodies and joints are those of [`Scene::compile`].
    ///
    /// # Errors
    /// [`crate::mujoco::Error::Load`] with MuJoCo's message.
    pub fn compile_visual(&self) -> Result<Model> {
        self.compile_xml(&self.xml(false))
    }

    fn compile_xml(&self, scene: &str) -> Result<Model> {
        let mut model = match &self.robot {
            RobotFile::Embedded => Model::from_xml(&[("scene.xml", scene), ("go1.xml", GO1)])?,
            RobotFile::Path(path) => {
                Model::check_file(path)?;
                Model::from_xml(&[("scene.xml", scene)])?
            }
        };
        if let Ground::Field(field) = &self.ground {
            let [low, high] = field.range();
            let id = model.id(Kind::HeightField, GROUND)?;
            let elevations = field.heights.iter().map(|height| ((height - low) / (high - low).max(1e-9)) as f32);
            model.height_field_mut(id).iter_mut().zip(elevations).for_each(|(to, from)| *to = from);
        }
        Ok(model)
    }

    /// The MJCF text that is handed to MuJoCo.
    pub fn xml(&self, discard_visual: bool) -> String {
        let robot = match &self.robot {
            RobotFile::Embedded => "go1.xml".to_owned(),
            RobotFile::Path(path) => escaped(&path.display().to_string()),
        };
        let Buffers { contacts, rows, stack } = self.buffers;
        let mut xml = String::new();
        // Writing into a String cannot fail.
        let _ = write!(
            xml,
            r#"<mujoco model="supple">
  <include file="{robot}"/>
  <compiler discardvisual="{discard_visual}"/>
  <size njmax="{rows}" nconmax="{contacts}" nstack="{stack}"/>
  <option timestep="{timestep}" integrator="Euler" cone="pyramidal" {solver}/>
{assets}{extras}  <worldbody>
    {ground}
{obstacles}  </worldbody>
</mujoco>
"#,
            timestep = self.timestep_s,
            solver = self.solver,
            assets = self.ground_asset(),
            extras = self.extras,
            ground = self.ground_geom(),
            obstacles = self.obstacles,
        );
        xml
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
        format!(
            r#"<geom name="{GROUND}" {shape} condim="3" priority="1" friction="0.8 0.005 0.0001" rgba="0.35 0.38 0.42 1"/>"#
        )
    }

    fn height_range(&self) -> [f64; 2] {
        match &self.ground {
            Ground::Flat => [0.0, 0.0],
            Ground::Field(field) => field.range(),
        }
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('"', "&quot;").replace('<', "&lt;")
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
}
