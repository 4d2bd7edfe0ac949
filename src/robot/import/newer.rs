/*! Translates MJCF of newer MuJoCos to that of 2.2.2.

Newer MuJoCos write elements and attributes that 2.2.2 refuses. Those that the import drops anyway (cameras, sensors, servos' gains, …) are
dropped before MuJoCo reads them. Those that matter are translated: a joint's `actuatorfrcrange` is a limit of its torque, a `<frame>` the
pose of its children. What cannot be translated is refused by name, line and version.

Limits are as MuJoCo 3 has them whatever the file's version: a range limits unless the file says `limited="false"`, or
`autolimits="false"` in its `<compiler>`.
*/

use std::collections::HashMap;

use nalgebra::{Isometry3, Matrix3, Point3, Quaternion, Rotation3, UnitQuaternion, Vector3};

use super::source::{Files, described};
use super::words::{LEFT_OUT_SECTIONS, Verdict, is_actuator, is_known_law, is_newer_actuator, since, verdict};
use crate::robot::error::{RobotError, SAVE_AGAIN};
use crate::util::numbers::spaced;
use crate::util::xml::Element;

/// Class without settings, for elements whose settings are all written out.
const PLAIN: &str = "robot_plain";

/// Sections that are passed to MuJoCo. The others have no meaning in a scene that has its own, or nothing reads them.
const SECTIONS: [&str; 7] = ["compiler", "default", "asset", "worldbody", "actuator", "custom", "keyframe"];

/// Sections that no such quadruped has, unless they are empty.
const REFUSED: [&str; 3] = ["equality", "tendon", "deformable"];

/// A robot as MJCF of MuJoCo 2.2.2.
#[derive(Debug, Default)]
pub(super) struct Translated {
    /// The whole document.
    pub(super) tree: Element,
    /// Limits of the torque on a joint, by its name [N·m].
    pub(super) torques: Vec<(String, [f64; 2])>,
    /// Settings that were left out although they act, one on a line.
    pub(super) notes: Vec<String>,
    /// Meshes of feet that cannot be read, each with the reason.
    pub(super) unread: Vec<String>,
}

/// Default classes: the settings of elements that do not set them.
#[derive(Debug, Default)]
struct Classes<'a> {
    /// Name of the class that holds everything.
    top: String,
    /// The class above, and the settings, of each class.
    classes: HashMap<String, (Option<String>, Vec<&'a Element>)>,
}

impl<'a> Classes<'a> {
    fn new(tree: &'a Element) -> Self {
        let first = tree.all("default").next();
        let top = first.and_then(|class| class.get("class")).unwrap_or("main").to_owned();
        let mut classes = Classes { top, ..Classes::default() };
        for section in tree.all("default") {
            let top = classes.top.clone();
            classes.read(section, top, None);
        }
        classes
    }

    fn read(&mut self, section: &'a Element, name: String, above: Option<String>) {
        let settings = section.children.iter().filter(|child| child.name != "default");
        self.classes.entry(name.clone()).or_insert((above, Vec::new())).1.extend(settings);
        for class in section.all("default") {
            if let Some(own) = class.get("class").filter(|own| *own != name) {
                self.read(class, own.to_owned(), Some(name.clone()));
            }
        }
    }

    /// Returns the value of an attribute for elements of a kind in a class, or in the classes above it.
    fn get(&self, kind: &str, class: &str, attribute: &str) -> Option<&'a str> {
        let mut next = Some(class);
        // A class that is its own ancestor cannot be written, but a name can be used twice.
        for _ in 0..=self.classes.len() {
            let (above, settings) = self.classes.get(next?)?;
            let own = settings.iter().rev().filter(|setting| setting.name == kind);
            if let Some(value) = own.filter_map(|setting| setting.get(attribute)).next() {
                return Some(value);
            }
            next = above.as_deref();
        }
        None
    }
}

/// A `<frame>` and those around it.
#[derive(Debug, Clone)]
struct OuterFrame {
    /// The pose in the frame of the body around it.
    pose: Isometry3<f64>,
    class: Option<String>,
}

impl OuterFrame {
    fn moves(&self) -> bool {
        self.pose != Isometry3::identity()
    }
}

/// How angles are written.
#[derive(Debug, Clone)]
struct Angles {
    /// Radians in the file's unit of angles.
    unit: f64,
    /// Axes of the three turns of `euler`.
    sequence: String,
}

/// An element and the class that it belongs to.
struct Of<'e> {
    element: &'e Element,
    class: &'e str,
}

struct Translator<'a> {
    files: &'a Files,
    classes: Classes<'a>,
    angles: Angles,
    autolimits: bool,
    translated: Translated,
    /// Names of elements and attributes that were left out.
    left_out: Vec<String>,
}

/// Translates a robot's document.
pub(super) fn translate(tree: &Element, files: &Files) -> Result<Translated, RobotError> {
    let setting = |name: &str| tree.all("compiler").filter_map(|compiler| compiler.get(name)).last();
    let angles = Angles {
        unit: if setting("angle") == Some("radian") { 1.0 } else { std::f64::consts::PI / 180.0 },
        sequence: setting("eulerseq").unwrap_or("xyz").to_owned(),
    };
    let autolimits = setting("autolimits") != Some("false");
    let (classes, translated) = (Classes::new(tree), Translated::default());
    let mut translator = Translator { files, classes, angles, autolimits, translated, left_out: Vec::new() };
    let mut root = Element { children: Vec::new(), ..tree.clone() };
    root.attributes.clear();
    for section in &tree.children {
        if let Some(section) = translator.section(section, tree)? {
            root.children.push(section);
        }
    }
    translator.add_plain_class(&mut root);
    let mut translated = translator.translated;
    if !translator.left_out.is_empty() {
        translator.left_out.sort();
        translator.left_out.dedup();
        translated.notes.push(format!(
            "elements and attributes of newer MuJoCos, left out without effect: {}",
            translator.left_out.join(", ")
        ));
    }
    translated.tree = root;
    Ok(translated)
}

impl Translator<'_> {
    /// Translates a section; returns `None` if it is left out.
    fn section(&mut self, section: &Element, tree: &Element) -> Result<Option<Element>, RobotError> {
        let name = section.name.as_str();
        if REFUSED.contains(&name) {
            if section.children.is_empty() {
                return Ok(None);
            }
            return Err(RobotError::Section { at: self.files.at(section), section: name.to_owned() });
        }
        if LEFT_OUT_SECTIONS.contains(&name) {
            return Ok(None);
        }
        ensure!(SECTIONS.contains(&name), self.unknown(section, &format!("<{name}>")));
        let mut own = Element { children: Vec::new(), ..section.clone() };
        match name {
            "compiler" => self.compiler(&mut own)?,
            "default" => own = self.defaults(section)?,
            "asset" => own.children = self.assets(section, tree)?,
            "worldbody" => {
                own.attributes.clear();
                let class = self.classes.top.clone();
                self.body(section, &class, None, &mut own.children, true)?;
            }
            "actuator" => {
                for actuator in &section.children {
                    own.children.extend(self.actuator(actuator)?);
                }
            }
            "keyframe" => {
                for key in section.all("key") {
                    own.children.push(self.fit(key)?);
                }
            }
            // Our own numbers, in files that this program wrote.
            _ => {
                let ours = section.all("numeric");
                let ours = ours.filter(|numeric| matches!(numeric.get("name"), Some("stand_qpos" | "nominal_pose")));
                own.children = ours.map(|numeric| self.fit(numeric)).collect::<Result<_, _>>()?;
            }
        }
        Ok(Some(own))
    }

    fn compiler(&self, compiler: &mut Element) -> Result<(), RobotError> {
        if let Some(folder) = compiler.get("assetdir").map(str::to_owned) {
            for name in ["meshdir", "texturedir"] {
                if compiler.get(name).is_none() {
                    compiler.set(name, &folder);
                }
            }
        }
        if compiler.get("coordinate") == Some("global") {
            return Err(RobotError::GlobalCoordinates { at: self.files.at(compiler) });
        }
        compiler.remove("coordinate");
        let fitted = self.filtered(compiler, &mut Vec::new(), &mut Vec::new())?;
        *compiler = fitted;
        Ok(())
    }

    fn defaults(&mut self, section: &Element) -> Result<Element, RobotError> {
        let mut own = Element { children: Vec::new(), ..section.clone() };
        for child in &section.children {
            match child.name.as_str() {
                "default" => own.children.push(self.defaults(child)?),
                "mesh" | "material" | "joint" | "geom" | "site" => {
                    let mut child = self.fit(child)?;
                    child.children.clear();
                    own.children.push(child);
                }
                name if is_actuator(name) => own.children.push(self.fit(child)?),
                "camera" | "light" | "pair" | "equality" | "tendon" => {}
                name if is_newer_actuator(name) => {}
                name => return Err(self.unknown(child, &format!("<{name}> in <default>"))),
            }
        }
        Ok(own)
    }

    fn assets(&mut self, section: &Element, tree: &Element) -> Result<Vec<Element>, RobotError> {
        let mut assets = Vec::new();
        for asset in &section.children {
            match asset.name.as_str() {
                // The layers of a material only concern its looks.
                "texture" | "hfield" | "material" => {
                    let mut own = self.fit(asset)?;
                    own.children.clear();
                    assets.push(own);
                }
                "mesh" => {
                    if let Some(word) = ["builtin", "params"].into_iter().find(|word| asset.get(word).is_some()) {
                        return Err(self.newer(asset, word, SAVE_AGAIN));
                    }
                    if !asset.children.is_empty() {
                        return Err(self.newer(asset, "plugin", "take it out, or give the part another shape"));
                    }
                    let class = asset.get("class").unwrap_or(&self.classes.top);
                    let inertia = asset.get("inertia").or_else(|| self.classes.get("mesh", class, "inertia"));
                    if !matches!(inertia, None | Some("legacy")) && weighs(tree, asset) {
                        let advice = "give every body that has this mesh an <inertial>";
                        return Err(self.newer(asset, "inertia", advice));
                    }
                    assets.push(self.fit(asset)?);
                }
                // Looks, and other models, which only <attach> takes.
                "skin" | "model" => {}
                name => return Err(self.unknown(asset, &format!("<{name}> in <asset>"))),
            }
        }
        Ok(assets)
    }

    /// Translates the children of a body or frame in the default class `class` into `out`.
    fn body(
        &mut self,
        body: &Element,
        class: &str,
        frame: Option<&OuterFrame>,
        out: &mut Vec<Element>,
        in_world: bool,
    ) -> Result<(), RobotError> {
        for child in &body.children {
            match child.name.as_str() {
                "camera" | "light" => {}
                "frame" => {
                    if let Some(word) =
                        ["scale", "scaling", "massscale"].into_iter().find(|word| child.get(word).is_some())
                    {
                        return Err(self.newer(child, word, SAVE_AGAIN));
                    }
                    let own = self.pose(&Of { element: child, class })?;
                    let around = frame.map_or(own, |frame| frame.pose * own);
                    let own_class = child.get("childclass").map(str::to_owned);
                    let own_class = own_class.or_else(|| frame.and_then(|frame| frame.class.clone()));
                    self.body(child, class, Some(&OuterFrame { pose: around, class: own_class }), out, in_world)?;
                }
                "body" => {
                    let mut own = self.fit(child)?;
                    own.children.clear();
                    if let Some(frame) = frame {
                        if frame.moves() {
                            write_pose(&(frame.pose * self.pose(&Of { element: child, class })?), &mut own);
                        }
                        if let (None, Some(class)) = (child.get("childclass"), &frame.class) {
                            own.set("childclass", class);
                        }
                    }
                    let inherited = frame.and_then(|frame| frame.class.as_deref()).unwrap_or(class);
                    let inner = child.get("childclass").unwrap_or(inherited);
                    self.body(child, inner, None, &mut own.children, false)?;
                    out.push(own);
                }
                "inertial" | "joint" | "freejoint" | "geom" | "site" => {
                    let own = self.part(child, class, frame)?;
                    out.push(own);
                }
                // Ground and objects of the file's own scene.
                "composite" | "flexcomp" | "replicate" | "attach" | "plugin" if in_world && frame.is_none() => {
                    if matches!(child.name.as_str(), "replicate" | "attach") {
                        return Err(self.newer(child, &child.name, SAVE_AGAIN));
                    }
                }
                name @ ("replicate" | "attach") => return Err(self.newer(child, name, SAVE_AGAIN)),
                name @ ("composite" | "flexcomp" | "plugin") => {
                    let at = self.files.at(child);
                    return Err(RobotError::Section { at, section: name.to_owned() });
                }
                name => return Err(self.unknown(child, &format!("<{name}> in a body"))),
            }
        }
        Ok(())
    }

    /// Translates a joint, geometry, site or inertia.
    fn part(&mut self, part: &Element, class: &str, frame: Option<&OuterFrame>) -> Result<Element, RobotError> {
        let frame_class = frame.and_then(|frame| frame.class.as_deref());
        let own_class = part.get("class").or(frame_class).unwrap_or(class).to_owned();
        let of = Of { element: part, class: &own_class };
        if let Some(plugin) = part.children.first() {
            return Err(self.newer(plugin, "plugin", "take it out, or give the part another shape"));
        }
        if part.name == "geom" && self.read(&of, "type") == Some("sdf") {
            return Err(self.newer(part, "sdf", "give the part another shape"));
        }
        if part.name == "joint" {
            self.torque(&of)?;
        }
        let mut own = self.fit(part)?;
        let takes_class = matches!(part.name.as_str(), "joint" | "geom" | "site");
        let Some(frame) = frame.filter(|frame| frame.moves() || frame.class.is_some()) else { return Ok(own) };
        if takes_class {
            own.set("class", &own_class);
        }
        if !frame.moves() || part.name == "freejoint" || part.get("type") == Some("free") {
            return Ok(own);
        }
        if takes_class {
            self.write_out(&mut own, &own_class)?;
        }
        let of = Of { element: part, class: &own_class };
        match part.name.as_str() {
            "joint" => {
                let place = self.numbers(&of, "pos")?.unwrap_or([0.0; 3]);
                let axis = self.numbers(&of, "axis")?.unwrap_or([0.0, 0.0, 1.0]);
                own.set("pos", spaced((frame.pose * Point3::from(place)).coords.as_slice()));
                own.set("axis", spaced((frame.pose.rotation * Vector3::from(axis)).as_slice()));
            }
            _ => {
                if let Some(ends) = self.numbers::<6>(&of, "fromto")? {
                    let end = |at: usize| {
                        let end = Point3::new(ends[at], ends[at + 1], ends[at + 2]);
                        spaced((frame.pose * end).coords.as_slice())
                    };
                    own.set("fromto", format!("{} {}", end(0), end(3)));
                } else if let Some(full) = self.numbers::<6>(&of, "fullinertia")? {
                    let [xx, yy, zz, xy, xz, yz] = full;
                    let turn = frame.pose.rotation.to_rotation_matrix();
                    let full = turn * Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz) * turn.transpose();
                    let full = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)].map(|at| full[at]);
                    own.set("pos", spaced((frame.pose * self.pose(&of)?).translation.vector.as_slice()));
                    own.set("fullinertia", spaced(&full));
                } else {
                    write_pose(&(frame.pose * self.pose(&of)?), &mut own);
                }
            }
        }
        Ok(own)
    }

    /// Writes all settings that an element has from its class into the element, and gives it a class without any.
    fn write_out(&self, element: &mut Element, class: &str) -> Result<(), RobotError> {
        for turn in ["euler", "zaxis", "xyaxes", "axisangle"] {
            if self.classes.get(&element.name, &self.classes.top, turn).is_some() {
                let found = self.classes.get(&element.name, &self.classes.top, turn).unwrap_or_default().to_owned();
                let (at, element) = (self.files.at(element), format!("the top-level <default>'s <{}>", element.name));
                let expected = "none where a <frame> turns elements: write it as quat";
                return Err(RobotError::Attribute { at, attribute: turn, element, found, expected });
            }
        }
        let kind = element.name.clone();
        let mut above = Some(class);
        for _ in 0..=self.classes.classes.len() {
            let Some((next, settings)) = above.and_then(|class| self.classes.classes.get(class)) else { break };
            for setting in settings.iter().rev().filter(|setting| setting.name == kind) {
                for (name, value) in &setting.attributes {
                    if verdict(&kind, name) != Verdict::Known {
                        continue;
                    }
                    // Fewer numbers than the class has leave its others as they are.
                    let (own, class) = (words(element.get(name).unwrap_or("")), words(value));
                    let partial =
                        matches!(name.as_str(), "size" | "friction" | "solref" | "solimp") && own.len() < class.len();
                    if own.is_empty() || partial {
                        let all: Vec<&str> = own.iter().copied().chain(class[own.len()..].iter().copied()).collect();
                        element.set(name, all.join(" "));
                    }
                }
            }
            above = next.as_deref();
        }
        element.set("class", PLAIN);
        Ok(())
    }

    /// Adds the class without settings, if an element has it.
    fn add_plain_class(&self, root: &mut Element) {
        let mut used = false;
        root.visit(&mut |element| used |= element.get("class") == Some(PLAIN));
        if !used {
            return;
        }
        let plain = Element::new("default").with("class", PLAIN);
        match root.children.iter_mut().find(|child| child.name == "default") {
            Some(section) => section.children.push(plain),
            None => {
                root.children.insert(0, Element { children: vec![plain], ..Element::new("default") });
            }
        }
    }

    /// Notes the limits of the torque on a joint.
    fn torque(&mut self, joint: &Of<'_>) -> Result<(), RobotError> {
        let Some(range) = self.numbers::<2>(joint, "actuatorfrcrange")? else { return Ok(()) };
        let limited = match self.read(joint, "actuatorfrclimited") {
            Some("true") => true,
            Some("false") => false,
            _ => self.autolimits,
        };
        if let (true, Some(name)) = (limited, joint.element.get("name")) {
            self.translated.torques.push((name.to_owned(), range));
        }
        Ok(())
    }

    fn actuator(&mut self, actuator: &Element) -> Result<Option<Element>, RobotError> {
        let class = actuator.get("class").unwrap_or(&self.classes.top).to_owned();
        let of = Of { element: actuator, class: &class };
        let rotor = self.read(&of, "armature").unwrap_or("0");
        if rotor.trim().parse::<f64>() != Ok(0.0) {
            return Err(self.newer(actuator, "armature", "write it as the joint's armature, times the gear's square"));
        }
        if is_actuator(&actuator.name) {
            return Ok(Some(self.fit(actuator)?));
        }
        if !is_newer_actuator(&actuator.name) {
            return Err(self.unknown(actuator, &format!("<{}> in <actuator>", actuator.name)));
        }
        let Some(joint) = actuator.get("joint") else { return Ok(None) };
        let mut servo = Element { place: actuator.place, ..Element::new("position") }.with("joint", joint);
        for name in ["gear", "forcerange", "forcelimited"] {
            if let Some(value) = self.read(&of, name) {
                servo.set(name, value);
            }
        }
        Ok(Some(servo))
    }

    /// Returns an element without children, with the attributes that MuJoCo 2.2.2 knows.
    fn fit(&mut self, element: &Element) -> Result<Element, RobotError> {
        let (mut left_out, mut notes) = (Vec::new(), Vec::new());
        let own = self.filtered(element, &mut left_out, &mut notes)?;
        self.left_out.append(&mut left_out);
        self.translated.notes.append(&mut notes);
        Ok(own)
    }

    fn filtered(
        &self,
        element: &Element,
        left_out: &mut Vec<String>,
        notes: &mut Vec<String>,
    ) -> Result<Element, RobotError> {
        let mut own = Element { attributes: Vec::new(), children: Vec::new(), ..element.clone() };
        for (name, value) in &element.attributes {
            let is_zero = || value.split_whitespace().all(|word| word.parse::<f64>() == Ok(0.0));
            match verdict(&element.name, name) {
                Verdict::Known => {
                    // Springs and dampers of newer MuJoCos are polynomials, of which the first term is the old one.
                    let first = matches!(name.as_str(), "stiffness" | "damping");
                    // A servo of any law: its force is not that of its control.
                    let law = matches!(name.as_str(), "gaintype" | "biastype") && !is_known_law(value);
                    let value = if law { "affine" } else { value };
                    let value = if first { value.split_whitespace().next().unwrap_or("0") } else { value };
                    own.attributes.push((name.clone(), value.to_owned()));
                }
                Verdict::Acting if !is_zero() => {
                    let at = self.files.at(element);
                    notes.push(format!("{at}: {name} {value} of {} left out", described(element)));
                }
                Verdict::Acting => {}
                Verdict::LeftOut if matches!(name.as_str(), "user" | "dyntype" | "dynprm") => {}
                Verdict::LeftOut if matches!(name.as_str(), "actuatorfrcrange" | "assetdir") => {}
                Verdict::LeftOut if element.name == "key" => {}
                Verdict::LeftOut => left_out.push(name.clone()),
                // Checked where it is read.
                Verdict::Unknown if is_actuator(&element.name) && name == "armature" => {}
                Verdict::Unknown => {
                    return Err(self.unknown(element, &format!("the attribute '{name}' of {}", described(element))));
                }
            }
        }
        Ok(own)
    }

    /// Reads an attribute of an element or its class.
    fn read<'s>(&'s self, of: &Of<'s>, attribute: &str) -> Option<&'s str> {
        of.element.get(attribute).or_else(|| self.classes.get(&of.element.name, of.class, attribute))
    }

    /// Reads numbers of an element or its class.
    fn numbers<const N: usize>(&self, of: &Of<'_>, attribute: &'static str) -> Result<Option<[f64; N]>, RobotError> {
        let Some(text) = self.read(of, attribute) else { return Ok(None) };
        let numbers: Option<Vec<f64>> = words(text).into_iter().map(|word| word.parse().ok()).collect();
        match numbers.and_then(|numbers| <[f64; N]>::try_from(numbers).ok()) {
            Some(numbers) if numbers.iter().all(|number| number.is_finite()) => Ok(Some(numbers)),
            _ => Err(RobotError::Attribute {
                at: self.files.at(of.element),
                attribute,
                element: described(of.element),
                found: text.to_owned(),
                expected: match N {
                    2 => "two numbers",
                    3 => "three numbers",
                    4 => "four numbers",
                    _ => "six numbers",
                },
            }),
        }
    }

    /// Reads position and orientation of an element, with its class, as MuJoCo does.
    fn pose(&self, of: &Of<'_>) -> Result<Isometry3<f64>, RobotError> {
        let place = self.numbers(of, "pos")?.unwrap_or([0.0; 3]);
        let [w, x, y, z] = self.numbers(of, "quat")?.unwrap_or([1.0, 0.0, 0.0, 0.0]);
        let mut turn = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-12).unwrap_or_default();
        // Of several, which only a class and its element can have, MuJoCo takes the last.
        if let Some([x, y, z, angle]) = self.numbers(of, "axisangle")? {
            turn = UnitQuaternion::new(Vector3::new(x, y, z).normalize() * (angle * self.angles.unit));
        }
        if let Some([a, b, c, d, e, f]) = self.numbers(of, "xyaxes")? {
            let x = Vector3::new(a, b, c).normalize();
            let y = Vector3::new(d, e, f);
            let y = (y - x * x.dot(&y)).normalize();
            let axes = Matrix3::from_columns(&[x, y, x.cross(&y)]);
            turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        }
        if let Some(axis) = self.numbers(of, "zaxis")? {
            let down = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), std::f64::consts::PI);
            turn = UnitQuaternion::rotation_between(&Vector3::z(), &Vector3::from(axis)).unwrap_or(down);
        }
        if let Some(angles) = self.numbers::<3>(of, "euler")? {
            turn = turned(angles.map(|angle| angle * self.angles.unit), &self.angles.sequence);
        }
        if !turn.coords.iter().all(|number| number.is_finite()) {
            let (at, element, found) = (self.files.at(of.element), described(of.element), "no direction".to_owned());
            let expected = "axes longer than zero";
            return Err(RobotError::Attribute { at, attribute: "orientation", element, found, expected });
        }
        Ok(Isometry3::from_parts(place.into(), turn))
    }

    fn newer(&self, element: &Element, word: &str, advice: &'static str) -> RobotError {
        let since = since(word).unwrap_or("a newer version");
        let is_element = element.name == word;
        let word = if is_element { format!("<{word}>") } else { format!("{word} of {}", described(element)) };
        RobotError::Newer { at: self.files.at(element), word, since, advice }
    }

    fn unknown(&self, element: &Element, word: &str) -> RobotError {
        RobotError::Unknown { at: self.files.at(element), word: word.to_owned() }
    }
}

/// Writes a pose into an element.
pub(super) fn write_pose(pose: &Isometry3<f64>, element: &mut Element) {
    ["axisangle", "xyaxes", "zaxis", "euler"].iter().for_each(|name| element.remove(name));
    element.set("pos", spaced(pose.translation.vector.as_slice()));
    let turn = pose.rotation;
    element.set("quat", spaced(&[turn.w, turn.i, turn.j, turn.k]));
}

/// Returns true if a body without `<inertial>` has its mass from a mesh.
fn weighs(tree: &Element, mesh: &Element) -> bool {
    let stem = || std::path::Path::new(mesh.get("file")?).file_stem()?.to_str();
    let Some(name) = mesh.get("name").or_else(stem) else { return true };
    fn any(body: &Element, name: &str) -> bool {
        let explicit = body.all("inertial").next().is_some();
        let own = !explicit && body.all("geom").any(|geom| geom.get("mesh") == Some(name));
        own || body
            .children
            .iter()
            .filter(|child| matches!(child.name.as_str(), "body" | "frame"))
            .any(|child| any(child, name))
    }
    tree.all("worldbody").any(|world| any(world, name))
}

/// Returns the rotation of three angles \[rad\] about the axes that `sequence` names.
fn turned(angles: [f64; 3], sequence: &str) -> UnitQuaternion<f64> {
    let mut turn = UnitQuaternion::identity();
    for (axis, angle) in sequence.chars().zip(angles) {
        let unit = match axis.to_ascii_lowercase() {
            'x' => Vector3::x_axis(),
            'y' => Vector3::y_axis(),
            _ => Vector3::z_axis(),
        };
        let next = UnitQuaternion::from_axis_angle(&unit, angle);
        // Small letters are axes that turn with the element, capital ones stay.
        turn = if axis.is_ascii_lowercase() { turn * next } else { next * turn };
    }
    turn
}

/// Reads the rotation of three angles \[rad\] as in `euler`; `None` if they are not three numbers.
pub(super) fn euler(angles: &str, sequence: &str) -> Option<UnitQuaternion<f64>> {
    let angles: Option<Vec<f64>> = words(angles).into_iter().map(|word| word.parse().ok()).collect();
    Some(turned(<[f64; 3]>::try_from(angles?).ok()?, sequence))
}

fn words(text: &str) -> Vec<&str> {
    text.split_whitespace().collect()
}
