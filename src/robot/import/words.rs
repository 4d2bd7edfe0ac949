//! The elements and attributes of MJCF: those that are passed to MuJoCo 2.2.2, and those of newer MuJoCos that are left out.

/// Sections that are left out.
pub(super) const LEFT_OUT_SECTIONS: [&str; 7] =
    ["option", "size", "sensor", "contact", "statistic", "visual", "extension"];

/// Attributes by element, known to MuJoCo 2.2.2 or left out. In `<default>`, elements have the same.
const ATTRIBUTES: &str = include_str!("words.txt");

/// Attributes that are left out although they act on a robot; the report names them.
const ACTING: [&str; 3] = ["gravcomp", "surfacevel", "adhesion"];

/// Kinds of actuators that are passed to MuJoCo 2.2.2.
pub(super) fn is_actuator(name: &str) -> bool {
    matches!(name, "general" | "motor" | "position" | "velocity" | "damper" | "cylinder" | "muscle" | "adhesion")
}

/// Kinds of actuators that only newer MuJoCos know, or that need more than a range of force to be read. They become servos
/// of the same force range.
pub(super) fn is_newer_actuator(name: &str) -> bool {
    matches!(name, "intvelocity" | "pid" | "orientation" | "dcmotor" | "plugin")
}

/// Returns true if MuJoCo 2.2.2 knows the value of an actuator's `gaintype` or `biastype`.
pub(super) fn is_known_law(value: &str) -> bool {
    matches!(value, "none" | "fixed" | "affine" | "muscle" | "user")
}

/// The way that an attribute is treated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Verdict {
    /// It is passed to MuJoCo.
    Known,
    /// It is left out, and nothing changes.
    LeftOut,
    /// It is left out, and the report says so if it is not zero.
    Acting,
    /// Nothing is known about it.
    Unknown,
}

/// Returns what to do with an attribute of an element.
pub(super) fn verdict(element: &str, attribute: &str) -> Verdict {
    let is = |kind: &str, element: &str| {
        let of = |line: &'static str| line.strip_prefix(kind)?.strip_prefix(element)?.strip_prefix(": ");
        ATTRIBUTES.lines().filter_map(of).any(|words| words.split(' ').any(|word| word == attribute))
    };
    match is("left out ", element) {
        _ if is("known ", element) => Verdict::Known,
        true if ACTING.contains(&attribute) => Verdict::Acting,
        true => Verdict::LeftOut,
        false if is_actuator(element) && is("left out of ", "servos") => Verdict::LeftOut,
        false => Verdict::Unknown,
    }
}

/// Returns the first MuJoCo that knows a word which cannot be translated.
pub(super) fn since(word: &str) -> Option<&'static str> {
    Some(match word {
        "replicate" => "3.1.5",
        "attach" | "model" => "3.2",
        "flexcomp" | "sdf" => "3.0",
        "builtin" | "params" => "3.3.3",
        "scale" | "scaling" | "massscale" => "3.16",
        "plugin" => "2.3",
        "armature" => "3.6",
        "inertia" => "3.2",
        _ => return None,
    })
}
