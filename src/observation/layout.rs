//! The layout of an observation: a checked list of quantities, and the origin of each number.

use super::entry::{MAX_LENGTH, NominalValues, ObservationBlock, Observed, ages, block, limit, offset, scale};
use super::observer::ObservationInput;
use super::quantity::{About, Kind};
use super::{LayoutError, Quantity};
use crate::robot::{JOINTS, LEGS, Robot, joint_name};
use crate::util::numbers::finite_in_single;

/// The origin of a number of the observation.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Source {
    /// Age of the frame \[policy steps\].
    pub(super) age: usize,
    /// Index of the number within that frame.
    pub(super) index: usize,
}

/// The layout of an observation.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    blocks: Vec<ObservationBlock>,
    /// Index in Supple's order of each of the policy's joints.
    order: [usize; JOINTS],
    /// Ages of the repetitions of the whole observation, in order \[policy steps\].
    history: Vec<u32>,
    sources: Vec<Source>,
    /// Offset of each number, shape (length), in its unit.
    offset: Vec<f64>,
    scale: Vec<f64>,
    clip: Vec<f64>,
    depth: usize,
}

impl Layout {
    /// Creates the layout of `entries` for a policy with Supple's order of joints.
    ///
    /// # Errors
    /// An entry is invalid, or the observation is empty or too long.
    pub fn new(entries: &[Observed], nominal: &NominalValues) -> Result<Self, LayoutError> {
        Self::repeated(entries, &[0], None, std::array::from_fn(|joint| joint), nominal)
    }

    /// Creates the layout of the entries that a critic sees in addition to the policy's; they may be privileged.
    pub(crate) fn for_critic(entries: &[Observed], nominal: &NominalValues) -> Result<Self, LayoutError> {
        Self::checked(entries, &[0], None, std::array::from_fn(|joint| joint), nominal, true)
    }

    /// Creates a layout like [`Layout::new`] that repeats the observation at the ages `history`, limits it to ± `clip`,
    /// and has another order of joints.
    ///
    /// # Errors
    /// An entry, the history or the limit is invalid, or the observation is empty or too long.
    pub fn repeated(
        entries: &[Observed],
        history: &[u32],
        clip: Option<f64>,
        order: [usize; JOINTS],
        nominal: &NominalValues,
    ) -> Result<Self, LayoutError> {
        Self::checked(entries, history, clip, order, nominal, false)
    }

    fn checked(
        entries: &[Observed],
        history: &[u32],
        clip: Option<f64>,
        order: [usize; JOINTS],
        nominal: &NominalValues,
        privileged: bool,
    ) -> Result<Self, LayoutError> {
        ages("history", history)?;
        let clip = limit("observation_clip", clip)?;
        let (mut blocks, mut offsets, mut scales, mut clips) =
            (Vec::<ObservationBlock>::new(), Vec::new(), Vec::new(), Vec::new());
        let mut width = 0;
        for (index, entry) in entries.iter().enumerate() {
            let (number, quantity) = (index + 1, entry.quantity);
            let fail = |problem| LayoutError::Entry { number, quantity, problem: Box::new(problem) };
            ensure!(privileged || !quantity.is_privileged(), fail(LayoutError::Privileged));
            let mut block = block(entry).map_err(fail)?;
            block.start = width;
            width += block.width;
            offsets.push(offset(entry, &block, &order, nominal).map_err(fail)?);
            scales.push(scale(entry, &block, nominal).map_err(fail)?);
            clips.push(limit("clip", entry.clip).map_err(fail)?.min(clip));
            blocks.push(block);
        }
        let length = history.len() * blocks.iter().map(ObservationBlock::length).sum::<usize>();
        ensure!((1..=MAX_LENGTH).contains(&length), LayoutError::Length(length));
        let (own, sources, offset) = (history.to_vec(), Vec::with_capacity(length), Vec::with_capacity(length));
        let (scale, clip) = (Vec::with_capacity(length), Vec::with_capacity(length));
        let mut layout = Layout { order, history: own, sources, offset, scale, clip, depth: 0, blocks: Vec::new() };
        for frame in history {
            for (k, block) in blocks.iter().enumerate() {
                for steps in &block.steps_ago {
                    let age = (frame + steps) as usize;
                    layout.depth = layout.depth.max(age + 1);
                    layout.sources.extend((0..block.width).map(|index| Source { age, index: block.start + index }));
                    layout.offset.extend(&offsets[k]);
                    layout.scale.extend(&scales[k]);
                    layout.clip.extend(std::iter::repeat_n(clips[k], block.width));
                }
            }
        }
        layout.blocks = blocks;
        layout.check_normaliser()?;
        Ok(layout)
    }

    methods! {
        /// Returns the length of the observation.
        fn length(&self) -> usize = self.sources.len();
        /// Returns the blocks in order; all of them are repeated for each age in [`Layout::history`].
        fn blocks(&self) -> &[ObservationBlock] = &self.blocks;
        /// Returns the ages of the repetitions of the whole observation \[policy steps\].
        fn history(&self) -> &[u32] = &self.history;
        /// Returns the index in Supple's order of each of the policy's joints.
        fn order(&self) -> &[usize; JOINTS] = &self.order;
        /// Returns the offset of each number, in its unit, shape (length).
        fn offset(&self) -> &[f64] = &self.offset;
        /// Returns the scale of each number, applied after the offset, shape (length).
        fn scale(&self) -> &[f64] = &self.scale;
        /// Returns the limit of each scaled number, infinite for none, shape (length).
        fn clip(&self) -> &[f64] = &self.clip;
        /// Returns true if any number is limited.
        fn clips(&self) -> bool = self.clip.iter().any(|clip| clip.is_finite());
        /// Returns the number of values measured in a policy step.
        fn frame_width(&self) -> usize = self.blocks.iter().map(|block| block.width).sum();
    }

    /// Returns the same layout with other offsets and scales, shape (length) each.
    pub(crate) fn with_normaliser(mut self, offset: Vec<f64>, scale: Vec<f64>) -> Result<Self, LayoutError> {
        let (found, expected) = ([offset.len(), scale.len()], self.length());
        ensure!(found == [expected; 2], LayoutError::Normaliser { found, expected });
        (self.offset, self.scale) = (offset, scale);
        self.check_normaliser()?;
        Ok(self)
    }

    /// Returns a layout that produces NaN in its first number, for tests.
    #[cfg(test)]
    pub(crate) fn blinded(&self) -> Self {
        let mut layout = self.clone();
        layout.scale[0] = f64::NAN;
        layout
    }

    /// Checks that offsets and scales are finite in single precision, which networks use.
    fn check_normaliser(&self) -> Result<(), LayoutError> {
        let finite = |k: &usize| finite_in_single(&[self.offset[*k], self.scale[*k]]);
        let Some(k) = (0..self.length()).find(|k| !finite(k)) else { return Ok(()) };
        let name = self.names().swap_remove(k);
        Err(LayoutError::Overflow { name, offset: self.offset[k], scale: self.scale[k] })
    }

    /// Normalises number `k` of the observation for the network.
    pub fn normalised(&self, k: usize, raw: f64) -> f32 {
        ((raw - self.offset[k]) * self.scale[k]).clamp(-self.clip[k], self.clip[k]) as f32
    }

    /// Returns name and unit of every number, such as `previous gravity left [m/s^2]`.
    pub fn names(&self) -> Vec<String> {
        let mut names = Vec::with_capacity(self.length());
        for frame in &self.history {
            for block in &self.blocks {
                let About { kind, name: what, unit, .. } = block.quantity.about();
                let units: Vec<&str> = unit.split(", ").collect();
                for steps in &block.steps_ago {
                    // The last action and target are one step old by definition.
                    let last = matches!(block.quantity, Quantity::LastAction | Quantity::LastTarget);
                    let when = match frame + steps + u32::from(last) {
                        0 => String::new(),
                        1 => "previous ".to_owned(),
                        steps => format!("{steps} steps ago: "),
                    };
                    for k in 0..block.width {
                        let name = match kind {
                            Kind::Scalar => what.to_owned(),
                            Kind::Polar | Kind::Axial | Kind::Command => format!("{what} {}", block.elements()[k]),
                            Kind::Joints => format!("{} {what}", joint_name(self.order[k])),
                            Kind::Feet => format!("{} foot's {what}", LEGS[k]),
                            Kind::FootVectors => {
                                let (leg, axis) = (k / block.axes.len(), k % block.axes.len());
                                format!("{} foot's {what} {}", LEGS[leg], block.elements()[axis])
                            }
                            Kind::Clock | Kind::Constant => format!("{what} {k}"),
                        };
                        let unit = units[block.axes.get(k).map_or(0, |(axis, _)| axis % units.len())];
                        names.push(format!("{when}{name} [{unit}]"));
                    }
                }
            }
        }
        names
    }

    /// Returns source index and sign of each number under a left-right mirror.
    ///
    /// # Errors
    /// A quantity has no mirror image, or another offset or scale than its image.
    pub fn mirrored(&self, robot: &Robot) -> Result<Vec<(usize, f32)>, LayoutError> {
        let mut images = Vec::with_capacity(self.length());
        for _ in &self.history {
            for block in &self.blocks {
                for _ in &block.steps_ago {
                    let start = images.len();
                    for k in 0..block.width {
                        let (index, sign) = self.image(block, k, robot)?;
                        images.push((start + index, sign as f32));
                    }
                }
            }
        }
        for (k, (image, sign)) in images.iter().enumerate() {
            let alike = self.scale[k] == self.scale[*image] && self.offset[k] == f64::from(*sign) * self.offset[*image];
            ensure!(alike, LayoutError::Lopsided(self.names().swap_remove(k)));
        }
        Ok(images)
    }

    /// Returns the mirror image of element `k` of a block: index within the block, and sign.
    fn image(&self, block: &ObservationBlock, k: usize, robot: &Robot) -> Result<(usize, f64), LayoutError> {
        let sign = |signs: [f64; 3]| Ok((k, signs[block.axes[k].0]));
        match block.quantity.about().kind {
            Kind::Scalar => Ok((k, 1.0)),
            Kind::Polar => sign([1.0, -1.0, 1.0]),
            Kind::Axial => sign([-1.0, 1.0, -1.0]),
            Kind::Command => sign([1.0, -1.0, -1.0]),
            Kind::Joints => {
                let (joint, sign) = robot.mirrored(self.order[k]);
                let index = self.order.iter().position(|place| *place == joint).unwrap_or(k);
                Ok((index, sign))
            }
            Kind::Feet => Ok((robot.mirrored(3 * k).0 / 3, 1.0)),
            Kind::FootVectors => {
                let (leg, axis) = (k / block.axes.len(), k % block.axes.len());
                let sign = if block.axes[axis].0 == 1 { -1.0 } else { 1.0 };
                Ok((robot.mirrored(3 * leg).0 / 3 * block.axes.len() + axis, sign))
            }
            Kind::Clock | Kind::Constant => Err(LayoutError::NoImage(block.quantity)),
        }
    }

    /// Measures all blocks into a frame.
    pub(super) fn measure(&self, now: &ObservationInput<'_>, frame: &mut [f64]) {
        for block in &self.blocks {
            let (clock, out) = ((block.frequency_hz, &block.values[..]), &mut frame[block.start..][..block.width]);
            block.quantity.measure(&block.axes, clock, &self.order, now, out);
        }
    }

    /// Returns the number of frames that the history needs.
    pub(super) fn depth(&self) -> usize {
        self.depth
    }

    pub(super) fn sources(&self) -> &[Source] {
        &self.sources
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::*;
    use crate::config::Config;
    use crate::observation::{Command, NamedNumbers, Numbers, Observer, Privileged};
    use crate::robot::{RobotState, same_in_every_leg};

    fn state() -> RobotState {
        RobotState {
            position: Vector3::new(7.0, 8.0, 9.0),
            height: 0.25,
            velocity_in_base: Vector3::new(1.0, 2.0, 3.0),
            angular_velocity_in_base: Vector3::new(4.0, 5.0, 6.0),
            gravity_in_base: Vector3::new(-0.1, -0.2, -9.8),
            joint_angles: std::array::from_fn(|k| k as f64),
            joint_rates: std::array::from_fn(|k| 100.0 + k as f64),
            ..RobotState::default()
        }
    }

    fn paper() -> Layout {
        let nominal =
            NominalValues { pose: same_in_every_leg([0.0, 0.72, -1.44]), height_m: 0.31, action_scale_rad: [0.3; 12] };
        Layout::new(&Config::load("compliant").unwrap().observation, &nominal).unwrap()
    }

    const NIL: &[f64; 12] = &[0.0; 12];
    const NOMINAL: NominalValues = NominalValues { pose: *NIL, height_m: 0.3, action_scale_rad: [0.3; 12] };

    /// Returns the input of a state and a command without a past.
    fn input<'a>(state: &'a RobotState, command: &'a Command) -> ObservationInput<'a> {
        let privileged = Privileged::default();
        ObservationInput { state, command, last_action: NIL, last_target: NIL, nominal: NIL, time_s: 0.0, privileged }
    }

    fn observe(observer: &mut Observer, layout: &Layout, state: &RobotState, target: f64) -> Vec<f64> {
        let command = Command::velocity(0.5, 0.25, -0.125);
        observer.measure(layout, &ObservationInput { last_target: &[target; 12], ..input(state, &command) });
        observer.raw(layout)
    }

    #[test]
    fn the_papers_observation_has_83_numbers_in_its_order_and_axes() {
        let layout = paper();
        assert_eq!(layout.length(), 83);
        let mut observer = Observer::new();
        let first = observe(&mut observer, &layout, &state(), 2.0);
        let mut later = state();
        later.height = 0.35;
        let values = observe(&mut observer, &layout, &later, 3.0);
        // ô_{t−1}: y, g, q, v, ω, q̇; a_{t−1}; ô_t; left, forward, yaw.
        assert_eq!(values[0], 0.25);
        assert_eq!(values[1..4], [-0.2, -9.8, -0.1]);
        assert_eq!(values[4..7], [0.0, 1.0, 2.0]);
        assert_eq!(values[16..19], [2.0, 3.0, 1.0]);
        assert_eq!(values[19..22], [5.0, 6.0, 4.0]);
        assert_eq!(values[22], 100.0);
        assert_eq!(values[34..46], [3.0; 12]);
        assert_eq!(values[46], 0.35);
        assert_eq!(values[80..], [0.25, 0.5, -0.125]);
        // Before the first measurement, the history holds its values.
        assert_eq!(first[..34], first[46..80]);
    }

    #[test]
    fn nominal_pose_at_desired_height_and_rest_is_zero_but_for_gravity() {
        let pose = same_in_every_leg([0.0, 0.72, -1.44]);
        let mut rest = state();
        (rest.height, rest.joint_angles, rest.joint_rates) = (0.31, pose, [0.0; 12]);
        (rest.velocity_in_base, rest.angular_velocity_in_base) = (Vector3::zeros(), Vector3::zeros());
        rest.gravity_in_base = Vector3::new(0.0, 0.0, -9.81);
        let (layout, mut observer) = (paper(), Observer::new());
        observer.measure(
            &layout,
            &ObservationInput { last_target: &pose, nominal: &pose, ..input(&rest, &Command::default()) },
        );
        let mut seen = vec![0.0; layout.length()];
        observer.normalised(&layout, &mut seen);
        for (index, value) in seen.iter().enumerate() {
            let expected = if index == 2 || index == 46 + 2 { -1.0 } else { 0.0 };
            assert!((value - expected).abs() < 1e-6, "element {index} is {value}");
        }
    }

    #[test]
    fn every_number_of_the_observation_has_a_name_and_a_unit() {
        let names = paper().names();
        assert_eq!(names.len(), 83);
        assert_eq!(names[0], "previous base height [m]");
        assert_eq!(names[1], "previous gravity left [m/s^2]");
        assert_eq!(names[34], "previous FR_hip target [rad]");
        assert_eq!(names[46], "base height [m]");
        assert_eq!(names[80..], ["commanded left [m/s]", "commanded forward [m/s]", "commanded yaw rate [rad/s]"]);
        assert_eq!(names.iter().collect::<std::collections::BTreeSet<_>>().len(), 83);
    }

    #[test]
    fn only_a_critic_observes_privileged_quantities() {
        let elements = Some(vec!["up".to_owned(), "left".to_owned()]);
        let forces = Observed { elements, ..Observed::now(Quantity::FootForces) };
        let entries = [Observed::now(Quantity::BaseHeight), forces, Observed::now(Quantity::FootHeights)];
        let error = Layout::new(&entries, &NOMINAL).unwrap_err().to_string();
        assert!(error.starts_with("observation, entry 2 (foot_forces): only the simulator has it"), "{error}");
        let layout = Layout::for_critic(&entries, &NOMINAL).unwrap();
        assert_eq!(layout.length(), 1 + 4 * 2 + 4);
        let names = layout.names();
        assert_eq!(names[3..6], ["FL foot's force up [N]", "FL foot's force left [N]", "RR foot's force up [N]"]);
        assert_eq!(names[12], "RL foot's height [m]");
        let mut state = state();
        (0..4).for_each(|leg| state.feet[leg].height = 0.01 * leg as f64);
        let foot_forces = std::array::from_fn(|leg| Vector3::new(1.0, 2.0, 3.0) * (leg + 1) as f64);
        let privileged = Privileged { foot_forces, ..Privileged::default() };
        let mut observer = Observer::new();
        observer.measure(&layout, &ObservationInput { privileged, ..input(&state, &Command::default()) });
        let expected = [0.25, 3.0, 2.0, 6.0, 4.0, 9.0, 6.0, 12.0, 8.0, 0.0, 0.01, 0.02, 0.03];
        assert_eq!(observer.raw(&layout), expected);
    }

    #[test]
    fn privileged_quantities_have_mirror_images_of_their_kind() {
        let robot = Robot::load("go1").unwrap();
        let mirrored =
            |quantity| Layout::for_critic(&[Observed::now(quantity)], &NOMINAL).unwrap().mirrored(&robot).unwrap();
        // The legs are FR, FL, RR, RL.
        assert_eq!(mirrored(Quantity::FootHeights), [(1, 1.0), (0, 1.0), (3, 1.0), (2, 1.0)]);
        let forces = mirrored(Quantity::FootForces);
        assert_eq!(forces[..6], [(3, 1.0), (4, -1.0), (5, 1.0), (0, 1.0), (1, -1.0), (2, 1.0)]);
        assert_eq!(forces[9..], [(6, 1.0), (7, -1.0), (8, 1.0)]);
        for quantity in [Quantity::Friction, Quantity::TrunkMass, Quantity::Latency] {
            assert_eq!(mirrored(quantity), [(0, 1.0)]);
        }
        for quantity in [Quantity::TrunkForce, Quantity::Push, Quantity::TrunkOffset] {
            assert_eq!(mirrored(quantity), [(0, 1.0), (1, -1.0), (2, 1.0)]);
        }
        // Hips turn around, thighs and calves do not.
        assert_eq!(mirrored(Quantity::EncoderBias)[..3], [(3, -1.0), (4, 1.0), (5, 1.0)]);
    }

    #[test]
    fn asymmetric_layouts_have_no_mirror_image() {
        let robot = Robot::load("go1").unwrap();
        let mirrored = |entry: Observed| Layout::new(&[entry], &NOMINAL).unwrap().mirrored(&robot);
        let clock = Observed { frequency_hz: Some(2.0), ..Observed::now(Quantity::ClockSin) };
        assert_eq!(mirrored(clock), Err(LayoutError::NoImage(Quantity::ClockSin)));
        let offset = Some(Numbers::Each(vec![0.0, 0.1, 0.0]));
        assert!(mirrored(Observed { offset, ..Observed::now(Quantity::BaseVelocity) }).is_err());
        let velocity = mirrored(Observed::now(Quantity::BaseVelocity)).unwrap();
        assert_eq!(velocity, [(0, 1.0), (1, -1.0), (2, 1.0)]);
    }

    #[test]
    fn a_scale_of_zero_is_refused_and_that_of_the_action_is_each_joints_own() {
        let action_scale_rad = std::array::from_fn(|joint| if joint == 0 { 0.5 } else { 0.25 });
        let nominal = NominalValues { action_scale_rad, ..NOMINAL };
        let layout =
            |quantity, scale| Layout::new(&[Observed { scale: Some(scale), ..Observed::now(quantity) }], &nominal);
        let error = layout(Quantity::BaseHeight, Numbers::All(0.0)).unwrap_err().to_string();
        assert!(error.contains("base_height") && error.contains("`scale` is [0.0], expected no zero"), "{error}");
        let targets = layout(Quantity::LastTarget, Numbers::Named(NamedNumbers::Action)).unwrap();
        assert_eq!(targets.scale()[..3], [2.0, 4.0, 4.0]);
        let error = layout(Quantity::BaseHeight, Numbers::Named(NamedNumbers::Action)).unwrap_err().to_string();
        assert!(error.contains("if it is of joints"), "{error}");
    }
}
