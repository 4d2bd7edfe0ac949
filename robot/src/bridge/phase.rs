/*! The states of the bridge: passive, stand up, hold, policy, lie down, and damped, which only a person ends. */

use supple::robot::{Joints, same_in_every_leg};

use super::safety::Fault;

/// Joint angles of a robot that lies with folded legs \[rad\].
pub const FOLDED: [f64; 3] = [0.0, 1.36, -2.65];

/// Gains that stand a robot up and hold it [N·m/rad], [N·m·s/rad].
pub const STAND_GAINS: [f64; 2] = [60.0, 5.0];

/// Time to fold the legs, and time to rise or to sink \[s\].
const FOLD_S: f64 = 1.0;
const RISE_S: f64 = 1.0;

/// A robot whose joints are on average closer than this to the stance does not fold its legs first \[rad\].
const NEAR_RAD: f64 = 0.5;

/// The phase that the bridge is in.
#[derive(Debug, Clone, PartialEq)]
pub enum Phase {
    /// The motors only damp.
    Passive,
    /// The robot stands up, from these joint angles \[rad\], since this time \[s\].
    StandUp { from: Joints, since_s: f64 },
    /// The robot holds the policy's nominal pose.
    Hold,
    /// The policy acts.
    Policy,
    /// The robot lies down, from these joint angles \[rad\], since this time \[s\].
    LieDown { from: Joints, since_s: f64 },
    /// The motors damp until a person clears the fault.
    Damped(Fault),
}

/// A request of the operator.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Wish {
    /// Stand up, or stop the policy and stand.
    Stand,
    /// Start the policy.
    Policy,
    /// Lie down.
    Lie,
    /// Damp at once, latched.
    Damp,
    /// End a latched damping.
    Clear,
}

impl Phase {
    /// Returns the name that logs use.
    pub fn name(&self) -> &'static str {
        match self {
            Phase::Passive => "passive",
            Phase::StandUp { .. } => "stand_up",
            Phase::Hold => "hold",
            Phase::Policy => "policy",
            Phase::LieDown { .. } => "lie_down",
            Phase::Damped(_) => "damped",
        }
    }

    /// Returns true if the motors do more than damp.
    pub fn is_active(&self) -> bool {
        !matches!(self, Phase::Passive | Phase::Damped(_))
    }

    /// Returns the phase that follows a wish at `now_s` \[s\], with joints at `angles` \[rad\]; if the wish does not fit the phase, the
    /// text says what to do first.
    pub fn wish(&self, wish: Wish, angles: &Joints, now_s: f64) -> Result<Phase, String> {
        let (from, since_s) = (*angles, now_s);
        match (self, wish) {
            (_, Wish::Damp) => Ok(Phase::Damped(Fault::Asked)),
            (Phase::Damped(_), Wish::Clear) => Ok(Phase::Passive),
            (Phase::Damped(fault), _) => Err(format!("damped, because: {fault}; clear it first")),
            (_, Wish::Clear) => Err("there is nothing to clear".to_owned()),
            (Phase::StandUp { .. } | Phase::Hold, Wish::Stand) => Ok(self.clone()),
            (_, Wish::Stand) => Ok(Phase::StandUp { from, since_s }),
            (Phase::Hold | Phase::Policy, Wish::Policy) => Ok(Phase::Policy),
            (_, Wish::Policy) => Err(format!("the policy begins when the robot stands; now: {}", self.name())),
            (Phase::Passive | Phase::LieDown { .. }, Wish::Lie) => Ok(self.clone()),
            (_, Wish::Lie) => Ok(Phase::LieDown { from, since_s }),
        }
    }

    /// Returns the joint targets at `now_s` \[s\] for a robot whose stance is `stance` \[rad\], and true if the motion is over;
    /// `None` in phases without a motion of their own.
    pub fn motion(&self, stance: &Joints, now_s: f64) -> Option<(Joints, bool)> {
        let folded = same_in_every_leg(FOLDED);
        match self {
            Phase::StandUp { from, since_s } => {
                let distance: f64 = from.iter().zip(stance).map(|(a, b)| (a - b).abs()).sum();
                if distance < NEAR_RAD * from.len() as f64 {
                    let part = (now_s - since_s) / RISE_S;
                    return Some((between(from, stance, part), part >= 1.0));
                }
                let part = (now_s - since_s - FOLD_S) / RISE_S;
                let low = between(from, &folded, (now_s - since_s) / FOLD_S);
                Some((if part < 0.0 { low } else { between(&folded, stance, part) }, part >= 1.0))
            }
            Phase::LieDown { from, since_s } => {
                let part = (now_s - since_s) / RISE_S;
                Some((between(from, &folded, part), part >= 1.0))
            }
            Phase::Hold => Some((*stance, false)),
            Phase::Passive | Phase::Policy | Phase::Damped(_) => None,
        }
    }

    /// Returns the phase after the motion.
    pub fn after(&self) -> Phase {
        match self {
            Phase::StandUp { .. } => Phase::Hold,
            Phase::LieDown { .. } => Phase::Passive,
            other => other.clone(),
        }
    }
}

/// Returns the pose at a part of the way, from 0 to 1.
fn between(from: &Joints, to: &Joints, part: f64) -> Joints {
    let part = part.clamp(0.0, 1.0);
    std::array::from_fn(|joint| from[joint] + part * (to[joint] - from[joint]))
}

#[cfg(test)]
mod tests {
    use super::*;

    const STANCE: [f64; 3] = [0.0, 0.72, -1.44];

    #[test]
    fn wishes_lead_from_lying_to_walking_and_back() {
        let stance = same_in_every_leg(STANCE);
        let lying = same_in_every_leg([0.0, 1.2, -2.5]);
        let mut phase = Phase::Passive;
        assert!(phase.wish(Wish::Policy, &lying, 0.0).is_err());
        phase = phase.wish(Wish::Stand, &lying, 1.0).unwrap();
        assert_eq!(phase.wish(Wish::Stand, &lying, 1.5), Ok(phase.clone()));
        assert_eq!(phase.motion(&stance, 1.0), Some((lying, false)));
        assert_eq!(phase.motion(&stance, 2.0).unwrap().0, same_in_every_leg(FOLDED));
        assert_eq!(phase.motion(&stance, 3.0), Some((stance, true)));
        phase = phase.after().wish(Wish::Policy, &stance, 3.0).unwrap();
        assert_eq!(phase, Phase::Policy);
        phase = phase.wish(Wish::Lie, &stance, 9.0).unwrap();
        assert_eq!(phase.motion(&stance, 10.0), Some((same_in_every_leg(FOLDED), true)));
        assert_eq!(phase.after(), Phase::Passive);
    }

    #[test]
    fn robot_that_stands_does_not_fold_its_legs_to_stand() {
        let (stance, near) = (same_in_every_leg(STANCE), same_in_every_leg([0.1, 0.9, -1.6]));
        let phase = Phase::Policy.wish(Wish::Stand, &near, 0.0).unwrap();
        let (middle, _) = phase.motion(&stance, 0.5).unwrap();
        assert!((middle[2] + 1.52).abs() < 1e-12);
        assert_eq!(phase.motion(&stance, 1.0), Some((stance, true)));
    }

    #[test]
    fn damping_is_latched_until_it_is_cleared() {
        let joints = same_in_every_leg(STANCE);
        for phase in [Phase::Passive, Phase::Hold, Phase::Policy] {
            let damped = phase.wish(Wish::Damp, &joints, 0.0).unwrap();
            assert_eq!(damped, Phase::Damped(Fault::Asked));
            for wish in [Wish::Stand, Wish::Policy, Wish::Lie] {
                assert!(damped.wish(wish, &joints, 0.0).is_err());
            }
            assert_eq!(damped.wish(Wish::Clear, &joints, 0.0), Ok(Phase::Passive));
        }
    }
}
