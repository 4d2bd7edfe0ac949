//! The feet that are held in an episode: where, and with which force.

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::mujoco::Data;
use crate::sim::{Ground, Parts};
use crate::task::deviation::{Hold, HoldSpring};

/// The places at which feet are held, world frame \[m\]; `None` for a foot that is free.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub(super) struct Pins([Option<[f64; 2]>; 4]);

impl Pins {
    /// Returns true if no foot is held.
    pub(super) fn is_free(&self) -> bool {
        self.0 == [None; 4]
    }
}

/// The feet that may be held in a policy step.
#[derive(Debug)]
pub(super) struct HeldFeet<'a> {
    /// The height below which each foot is held in this policy step \[m\]; `None` if it is not.
    heights_m: [Option<f64>; 4],
    spring: HoldSpring,
    pins: &'a mut Pins,
}

impl<'a> HeldFeet<'a> {
    /// Creates the feet for the policy step at `time_s` of an episode with these holds.
    pub(super) fn new(holds: &[Hold], time_s: f64, spring: HoldSpring, pins: &'a mut Pins) -> Self {
        let mut heights_m = [None; 4];
        for hold in holds.iter().filter(|hold| (hold.from_s..hold.until_s).contains(&time_s)) {
            heights_m[hold.leg] = Some(hold.height_m);
        }
        HeldFeet { heights_m, spring, pins }
    }

    /// Catches and frees feet, and returns the force on each, world frame \[N\].
    pub(super) fn forces(&mut self, data: &Data, parts: &Parts, ground: &Ground) -> [Vector3<f64>; 4] {
        if self.heights_m == [None; 4] {
            self.pins.0 = [None; 4];
            return [Vector3::zeros(); 4];
        }
        let (feet, centres) = (parts.footholds(data, ground), parts.foot_centres(data));
        std::array::from_fn(|leg| {
            let ([x, y, _], foot) = (centres[leg], feet[leg]);
            let is_low = |height_m: f64| !foot.contact && foot.height < height_m;
            let pin = &mut self.pins.0[leg];
            if !self.heights_m[leg].is_some_and(is_low) {
                *pin = None;
                return Vector3::zeros();
            }
            let [x, y] = self.spring.force([x, y], *pin.get_or_insert([x, y]));
            Vector3::new(x, y, 0.0)
        })
    }
}
