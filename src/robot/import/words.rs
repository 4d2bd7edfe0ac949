//! The words of MJCF: those of MuJoCo 2.2.2 that are passed to it, and those of newer ones that are left out.

/// Sections that are left out.
pub(super) const LEFT_OUT_SECTIONS: [&str; 7] =
    ["option", "size", "sensor", "contact", "statistic", "visual", "extension"];

/// Elements that are passed to MuJoCo, and the attributes that MuJoCo 2.2.2 knows of them, as `mj_printSchema` lists them. In
/// `<default>`, the same.
const KNOWN: &[(&str, &[&str])] = &[
    (
        "compiler",
        &[
            "autolimits boundmass boundinertia settotalmass balanceinertia strippath coordinate angle fitaabb eulerseq meshdir",
            "texturedir discardvisual convexhull usethread fusestatic inertiafromgeom inertiagrouprange exactmeshinertia",
        ],
    ),
    ("default", &["class"]),
    (
        "texture",
        &[
            "name type file gridsize gridlayout fileright fileleft fileup filedown filefront fileback builtin rgb1 rgb2 mark",
            "markrgb random width height hflip vflip",
        ],
    ),
    ("hfield", &["name file nrow ncol size"]),
    ("mesh", &["name class file vertex normal texcoord face refpos refquat scale smoothnormal"]),
    ("material", &["name class texture texrepeat texuniform emission specular shininess reflectance rgba"]),
    ("body", &["name childclass pos quat mocap axisangle xyaxes zaxis euler"]),
    ("inertial", &["pos quat mass diaginertia axisangle xyaxes zaxis euler fullinertia"]),
    (
        "joint",
        &[
            "name class type group pos axis springdamper limited solreflimit solimplimit solreffriction solimpfriction stiffness",
            "range margin ref springref armature damping frictionloss",
        ],
    ),
    ("freejoint", &["name group"]),
    (
        "geom",
        &[
            "name class type contype conaffinity condim group priority size material friction mass density shellinertia solmix",
            "solref solimp margin gap fromto pos quat axisangle xyaxes zaxis euler hfield mesh fitscale rgba fluidshape fluidcoef",
        ],
    ),
    ("site", &["name class type group pos quat material size fromto axisangle xyaxes zaxis euler rgba"]),
    ("general", &[ACTUATOR, "body gaintype biastype gainprm biasprm"]),
    ("motor", &[ACTUATOR]),
    ("position", &[ACTUATOR, "kp"]),
    ("velocity", &[ACTUATOR, "kv"]),
    (
        "damper",
        &["name class group forcelimited ctrlrange forcerange lengthrange gear cranklength", TRANSMISSION, "kv"],
    ),
    ("cylinder", &[ACTUATOR, "timeconst area diameter bias"]),
    ("muscle", &[ACTUATOR, "timeconst range force scale lmin lmax vmax fpmax fvmax"]),
    ("adhesion", &["name class group forcelimited ctrlrange forcerange body gain"]),
    ("key", &["name qpos"]),
    ("numeric", &["name size data"]),
];

const ACTUATOR: &str = "name class group ctrllimited forcelimited ctrlrange forcerange lengthrange gear cranklength joint \
                        jointinparent tendon slidersite cranksite site refsite";

const TRANSMISSION: &str = "joint jointinparent tendon slidersite cranksite site refsite";

/// Attributes that nothing here reads: of newer MuJoCo, and `user`, of any.
const LEFT_OUT: &[(&str, &str)] = &[
    ("compiler", "alignfree saveinertial conflict savecompiled savecanonical assetdir"),
    ("texture", "content_type colorspace nchannel"),
    ("hfield", "content_type elevation"),
    ("mesh", "content_type maxhullvert material octreemaxdepth needsdf inertia"),
    ("material", "metallic roughness"),
    ("body", "user sleep simple gravcomp"),
    ("joint", "user actuatorgravcomp springyield actuatorfrcrange actuatorfrclimited"),
    ("freejoint", "align"),
    ("geom", "user surfacevel adhesion"),
    ("site", "user"),
    ("key", "time qvel act ctrl mpos mquat plastic"),
];

/// Attributes of actuators that bound no force: motors take their place.
const OF_SERVOS: &str = "user dyntype dynprm kp kv ki dampratio timeconst inheritrange actlimited actearly actdim actrange delay nsample interp \
                         input velrange ffrange posrange slewmax imax damping";

/// Attributes that are left out although they act on a robot: something else holds, or nothing does, and the report says so.
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
    let among = |lists: &[&str]| lists.iter().any(|list| list.split(' ').any(|word| word == attribute));
    let of = |table: &'static [(&str, &str)]| table.iter().filter(move |(name, _)| *name == element);
    if KNOWN.iter().any(|(name, lists)| *name == element && among(lists)) {
        Verdict::Known
    } else if ACTING.contains(&attribute) && of(LEFT_OUT).any(|(_, list)| among(&[list])) {
        Verdict::Acting
    } else if of(LEFT_OUT).any(|(_, list)| among(&[list])) || is_actuator(element) && among(&[OF_SERVOS]) {
        Verdict::LeftOut
    } else {
        Verdict::Unknown
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
