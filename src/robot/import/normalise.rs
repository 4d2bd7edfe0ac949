//! Conversion of any quadruped's MJCF to the names and conventions of Supple.

use std::path::{Path, PathBuf};

use super::Imported;
use super::names::{Description, foot};
use super::resolve::Source;
use crate::mujoco::{Data, GeomContact, Kind, Model};
use crate::robot::{HARNESS, JOINTS, Joints, LEGS, PARTS, joint_name};
use crate::util::xml::Element;

/// Class that takes over the file's top-level defaults, because a robot must not change those of a scene.
const MAIN_CLASS: &str = "robot_defaults";

/// The properties that MuJoCo reads from the file.
struct Survey {
    model: Model,
    trunk: usize,
    joints: [usize; JOINTS],
    feet: [usize; 4],
    torque_limits: Joints,
    /// The contact settings of the geometries of each body, in order.
    geoms: Vec<Vec<(usize, GeomContact)>>,
}

/// Converts the files of a robot.
pub(super) fn adapt(source: &Source) -> Result<Imported, String> {
    let (description, mut tree) = (&source.description, source.taken());
    let file = std::path::absolute(&description.mjcf).map_err(|error| error.to_string())?;
    let assets = find_assets(&mut tree, file.parent().unwrap_or(Path::new("")))?;
    for section in ["equality", "tendon", "deformable"] {
        if tree.all(section).any(|section| !section.children.is_empty()) {
            return Err(format!("it has a section <{section}>: a trunk with four legs of three hinges each has none"));
        }
    }
    let survey = Survey::of(&tree, description)?;
    let mut report = survey.report();
    report.extend(left_out(&source.tree, &survey));
    let (start, has_pose) = survey.start(description, &mut report)?;

    let mut mjcf = "<mujoco>\n".to_owned();
    for section in tree.all("compiler") {
        section.write(&mut mjcf);
    }
    let wrapped = wrap_defaults(&mut tree);
    for section in tree.all("default").chain(tree.all("asset")) {
        section.write(&mut mjcf);
    }
    let mut trunk = take_trunk(tree, survey.trunk).ok_or("its trunk is not a child of the world body")?;
    if wrapped && trunk.get("childclass").is_none() {
        trunk.set("childclass", MAIN_CLASS);
    }
    let mut id = survey.trunk;
    survey.change(&mut trunk, &mut id);
    trunk.set("name", "trunk");
    // Where ropes are tied to.
    trunk.children.retain(|child| child.name != "site" || child.get("name") != Some(HARNESS));
    let mut harness = Element { name: "site".into(), attributes: Vec::new(), children: Vec::new() };
    harness.set("name", HARNESS);
    harness.set("pos", survey.model.body_centre_of_mass(survey.trunk).map(|value| value.to_string()).join(" "));
    harness.set("group", 4);
    trunk.children.push(harness);
    let world = Element { name: "worldbody".into(), attributes: Vec::new(), children: vec![trunk] };
    world.write(&mut mjcf);
    survey.motors().write(&mut mjcf);
    let numbers = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    mjcf.push_str(&format!("<custom><numeric name=\"stand_qpos\" data=\"{}\"/>", numbers(&start)));
    if let (None, Ok(pose)) = (description.pose, survey.model.numeric("nominal_pose")) {
        mjcf.push_str(&format!("<numeric name=\"nominal_pose\" data=\"{}\"/>", numbers(pose)));
    }
    mjcf.push_str("<numeric name=\"shanks_may_touch\" data=\"1\"/></custom>\n</mujoco>\n");
    let sha256 = source.sha256(&assets)?;
    Ok(Imported { mjcf, report, has_pose, fall_height_m: description.fall_height_m, sha256 })
}

/// Makes the paths of assets absolute, because the compiled text lies in no folder, and returns them.
fn find_assets(tree: &mut Element, folder: &Path) -> Result<Vec<PathBuf>, String> {
    let setting = |name: &str| tree.all("compiler").filter_map(|compiler| compiler.get(name)).last().map(str::to_owned);
    let (meshes, textures) = (setting("meshdir").unwrap_or_default(), setting("texturedir").unwrap_or_default());
    let strip = setting("strippath").as_deref() == Some("true");
    if let Some(name) = ["settotalmass", "coordinate"].into_iter().find(|name| setting(name).is_some()) {
        return Err(format!("its compiler setting '{name}' would change everything else in a scene, too"));
    }
    if tree.all("compiler").next().is_none() {
        tree.children.insert(0, Element { name: "compiler".into(), ..Element::default() });
    }
    let mut found = Vec::new();
    for child in &mut tree.children {
        match child.name.as_str() {
            "compiler" => {
                ["meshdir", "texturedir", "strippath"].iter().for_each(|name| child.remove(name));
                child.set("discardvisual", "false");
                child.set("fusestatic", "false");
                // A range is meant to limit; that goes without saying since MuJoCo 3.
                if child.get("autolimits").is_none() {
                    child.set("autolimits", "true");
                }
            }
            "asset" => {
                for asset in &mut child.children {
                    let within = if asset.name == "texture" { &textures } else { &meshes };
                    for attribute in &mut asset.attributes {
                        if attribute.0 == "file" || asset.name == "texture" && attribute.0.starts_with("file") {
                            let file = Path::new(&attribute.1);
                            let file = if strip { Path::new(file.file_name().unwrap_or_default()) } else { file };
                            let file = folder.join(within).join(file);
                            found.push(file.clone());
                            let file = file.into_os_string().into_string();
                            attribute.1 = file.map_err(|file| {
                                format!("MJCF cannot name {}: its path is not UTF-8; move it", file.display())
                            })?;
                        }
                    }
                }
            }
            _ => {}
        }
    }
    Ok(found)
}

impl Survey {
    fn of(tree: &Element, description: &Description) -> Result<Self, String> {
        let mut text = String::new();
        tree.write(&mut text);
        let model = Model::from_xml(&[("robot.xml", &text)]).map_err(|error| error.to_string())?;
        let name = |joint: usize| model.name(Kind::Joint, joint).to_owned();
        let free: Vec<usize> = (0..model.count(Kind::Joint)).filter(|joint| model.is_free(*joint)).collect();
        let joints = description.joints(&model)?;
        let hip_parent = model.body_parent(model.joint_body(joints[0]));
        let Some(root) = free.iter().copied().find(|joint| model.joint_body(*joint) == hip_parent) else {
            return Err(
                "its trunk is fixed to the world, or its hips are not children of the trunk: expected a trunk \
                        with a <freejoint/> and four legs of three hinges"
                    .into(),
            );
        };
        let trunk = model.joint_body(root);
        for leg in joints.chunks(PARTS.len()) {
            let [hip, thigh, calf] = [0, 1, 2].map(|part| model.joint_body(leg[part]));
            if model.body_parent(hip) != trunk || model.body_parent(thigh) != hip || model.body_parent(calf) != thigh {
                return Err(format!(
                    "{}, {} and {} are not three hinges one below the other",
                    name(leg[0]),
                    name(leg[1]),
                    name(leg[2])
                ));
            }
        }
        let others: Vec<String> = (0..model.count(Kind::Joint))
            .filter(|joint| {
                *joint != root && !joints.contains(joint) && model.is_below(model.joint_body(*joint), trunk)
            })
            .map(name)
            .collect();
        if !others.is_empty() {
            return Err(format!("it has joints beside those of four legs: {}", others.join(", ")));
        }
        let mut feet = [0; 4];
        for (leg, slot) in feet.iter_mut().enumerate() {
            let given = description.feet.as_ref().map(|names| &names[leg]);
            *slot = foot(&model, given, leg, model.joint_body(joints[PARTS.len() * leg + 2]))?;
        }
        let mut geoms = vec![Vec::new(); model.count(Kind::Body)];
        for geom in 0..model.count(Kind::Geom) {
            geoms[model.geom_body(geom)].push((geom, model.geom_contact(geom)));
        }
        let torque_limits = Self::torque_limits(&model, &joints, description)?;
        Ok(Survey { model, trunk, joints, feet, torque_limits, geoms })
    }

    /// Converts a body and its descendants; `id` is the body's number in the model, and afterwards that of the next
    /// body.
    fn change(&self, body: &mut Element, id: &mut usize) {
        let contacts = self.geoms.get(*id).map_or(&[][..], Vec::as_slice);
        let mut contacts = contacts.iter();
        *id += 1;
        body.children.retain(|child| !matches!(child.name.as_str(), "camera" | "light"));
        // A body's own geometries come before those of bodies below it, in the model as in `geoms`.
        for child in &mut body.children {
            match child.name.as_str() {
                "freejoint" => child.set("name", "root"),
                "joint" => self.change_joint(child),
                "geom" => {
                    let Some((geom, contact)) = contacts.next() else { continue };
                    self.change_geom(child, *geom, contact);
                }
                _ => {}
            }
        }
        for child in body.children.iter_mut().filter(|child| child.name == "body") {
            self.change(child, id);
        }
    }

    fn change_joint(&self, joint: &mut Element) {
        let name = joint.get("name").unwrap_or("");
        let ours = self.joints.iter().position(|id| self.model.name(Kind::Joint, *id) == name);
        joint.set("name", ours.map_or_else(|| "root".to_owned(), |index| format!("{}_joint", joint_name(index))));
        ["damping", "frictionloss", "stiffness"].iter().for_each(|name| joint.set(name, "0"));
    }

    /// Sets Supple's contact masks and removes settings that would override the ground's.
    fn change_geom(&self, element: &mut Element, geom: usize, contact: &GeomContact) {
        element.remove("name");
        if let Some(leg) = self.feet.iter().position(|foot| *foot == geom) {
            element.set("name", format!("{}_foot", LEGS[leg]));
        }
        let (contype, conaffinity) = if contact.collides() { (1, 2) } else { (0, 0) };
        if contact.collides() && element.get("name").is_none() {
            element.set("name", format!("part_{geom}"));
        }
        element.set("contype", contype);
        element.set("conaffinity", conaffinity);
        ["priority", "margin", "gap"].iter().for_each(|name| element.set(name, 0));
    }

    /// Returns the torque limit of each joint [N·m]: the description's, or that of the joint's actuator.
    fn torque_limits(model: &Model, joints: &[usize; JOINTS], description: &Description) -> Result<Joints, String> {
        let mut limits = [0.0; JOINTS];
        for (index, limit) in limits.iter_mut().enumerate() {
            let actuators = (0..model.count(Kind::Actuator)).map(|id| model.actuator(id));
            let own =
                || actuators.filter(|actuator| actuator.joint == Some(joints[index])).find_map(|a| a.largest_torque());
            *limit = description.torque_limits.map(|limits| limits[index]).or_else(own).ok_or_else(|| {
                let name = model.name(Kind::Joint, joints[index]);
                format!(
                    "its joint '{name}' has no actuator with a limited torque: write the largest torques of hip, thigh and \
                     calf into a YAML file, as torque_limits_n_m in examples/robots/quadruped.yaml"
                )
            })?;
        }
        Ok(limits)
    }

    fn motors(&self) -> Element {
        let limits = self.torque_limits;
        let motor = |joint: usize| {
            let mut motor = Element { name: "motor".into(), ..Element::default() };
            motor.set("name", joint_name(joint));
            motor.set("joint", format!("{}_joint", joint_name(joint)));
            motor.set("ctrllimited", "true");
            motor.set("ctrlrange", format!("-{limit} {limit}", limit = limits[joint]));
            motor
        };
        Element { name: "actuator".into(), attributes: Vec::new(), children: (0..JOINTS).map(motor).collect() }
    }

    /// Returns the starting positions and true if the file or its description gives them. They are those of
    /// `stand_qpos`, of the keyframe `home` or the first one, or the description's pose, placed on the ground by the
    /// lowest foot.
    fn start(&self, description: &Description, report: &mut Vec<String>) -> Result<(Vec<f64>, bool), String> {
        let model = &self.model;
        let fail = |error: crate::mujoco::Error| error.to_string();
        let ours =
            |positions: &[f64]| -> Joints { self.joints.map(|joint| positions[model.joint_position_index(joint)]) };
        if let (None, Ok(stand)) = (description.pose, model.numeric("stand_qpos"))
            && stand.len() == 7 + JOINTS
            && model.nq() == stand.len()
        {
            return Ok((stand.to_vec(), true));
        }
        let keyframe = model.keyframe();
        let (pose, from) = match (description.pose, keyframe) {
            (Some(pose), _) => (pose, "the joint angles of its description's nominal pose"),
            (None, Some(positions)) => (ours(positions), "the joint angles of its keyframe"),
            (None, None) => (ours(model.rest_positions()), "all joint angles as in its file"),
        };
        let has_pose = description.pose.is_some() || keyframe.is_some();
        let model = model.try_clone().map_err(fail)?;
        let root = (0..model.count(Kind::Joint)).find(|joint| model.joint_body(*joint) == self.trunk).unwrap_or(0);
        let base = model.joint_position_index(root);
        let places = self.joints.map(|joint| model.joint_position_index(joint));
        let radii = self.feet.map(|foot| model.geom(foot).size[0]);
        let mut data = Data::new(model).map_err(fail)?;
        let positions = data.positions_mut();
        positions[base..base + 7].copy_from_slice(&[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
        for (place, angle) in places.iter().zip(pose) {
            positions[*place] = angle;
        }
        data.step1().map_err(fail)?;
        let bottom = |leg: usize| data.geom_positions()[3 * self.feet[leg] + 2] - radii[leg];
        let height = 1.0 - (0..4).map(bottom).fold(f64::INFINITY, f64::min);
        report.push(format!("start: {from}, base at {height:.3} m, where the lowest foot touches the ground"));
        // In the order of the joints in the file, which is that of the positions.
        let mut in_file: Vec<(usize, f64)> = places.into_iter().zip(pose).collect();
        in_file.sort_by_key(|(place, _)| *place);
        let trunk = [0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0].into_iter();
        Ok((trunk.chain(in_file.into_iter().map(|(_, angle)| angle)).collect(), has_pose))
    }

    /// Lists the changes, one on a line.
    fn report(&self) -> Vec<String> {
        let model = &self.model;
        let mut lines = Vec::new();
        let bodies = (self.trunk..model.count(Kind::Body)).filter(|body| model.is_below(*body, self.trunk));
        let mass: f64 = bodies.map(|body| model.body_mass()[body]).sum();
        lines.push(format!("mass: {mass:.3} kg, kept, as are inertias, shapes, joint limits and armature"));
        let dofs = self.joints.map(|joint| model.joint_velocity_index(joint));
        for (what, unit, values) in [
            ("joint damping", "N m s/rad", dofs.map(|dof| model.damping()[dof])),
            ("joint friction", "N m", dofs.map(|dof| model.friction_loss()[dof])),
        ] {
            if values.iter().any(|value| *value != 0.0) {
                lines.push(format!("{what}: {} {unit}, set to 0: K_d is the only damping here", range(&values)));
            }
        }
        let limits = self.torque_limits;
        let servos = (0..model.count(Kind::Actuator)).filter(|id| model.actuator(*id).is_servo()).count();
        let hips_and_thighs: Vec<f64> =
            limits.chunks(PARTS.len()).flat_map(|leg| &leg[..PARTS.len() - 1]).copied().collect();
        let calves: Vec<f64> = limits.chunks(PARTS.len()).map(|leg| leg[PARTS.len() - 1]).collect();
        lines.push(format!(
            "actuators: {} ({servos} of them servos) replaced by torque motors under our PD law; limits {} N m (hip, \
             thigh) and {} N m (calf)",
            model.count(Kind::Actuator),
            range(&hips_and_thighs),
            range(&calves),
        ));
        let feet = self.feet.map(|foot| model.geom_contact(foot));
        let radii = self.feet.map(|foot| model.geom(foot).size[0]);
        let foot = &feet[0];
        lines.push(format!(
            "feet: spheres of {} mm; condim {}, priority {}, friction {}, solimp {} give way to the ground's friction and \
             MuJoCo's default softness",
            range(&radii.map(|radius| 1e3 * radius)),
            foot.condim,
            foot.priority,
            list(&foot.friction),
            list(&foot.solimp[..3]),
        ));
        lines.push("contact: parts of the robot do not collide with one another; margins and gaps set to 0".into());
        lines.push(
            "falls: trunk, hips and thighs on the ground are one, shanks, which may reach down to the feet, are none"
                .into(),
        );
        lines
    }
}

/// Lists the sections and world elements that are left out: a scenario brings its own, or nothing reads them.
fn left_out(tree: &Element, survey: &Survey) -> Vec<String> {
    let mut lines = Vec::new();
    for option in tree.all("option") {
        let settings: Vec<String> = option.attributes.iter().map(|(name, value)| format!("{name} {value}")).collect();
        lines.push(format!("options: {} give way to ours (Euler, pyramidal cone, impratio 1)", settings.join(", ")));
    }
    let world: Vec<String> = tree
        .all("worldbody")
        .flat_map(|world| &world.children)
        .filter(|child| !(child.name == "body" && contains_free_joint(child)))
        .map(|child| child.get("name").map_or_else(|| child.name.clone(), |name| format!("{} '{name}'", child.name)))
        .collect();
    if !world.is_empty() {
        lines.push(format!("world: {} left out; a scenario brings its own ground", world.join(", ")));
    }
    let sections = ["sensor", "contact", "keyframe", "size", "statistic", "visual", "custom"];
    let found: Vec<&str> = sections.into_iter().filter(|name| tree.all(name).next().is_some()).collect();
    if !found.is_empty() {
        lines.push(format!("sections left out: {}", found.join(", ")));
    }
    let moving = (0..survey.model.count(Kind::Joint)).filter(|joint| survey.model.is_free(*joint)).count();
    if moving > 1 {
        lines.push(format!("{} loose bodies beside the robot left out", moving - 1));
    }
    lines
}

fn contains_free_joint(body: &Element) -> bool {
    body.children.iter().any(|child| child.name == "freejoint" || child.get("type") == Some("free"))
}

/// Moves top-level defaults into a class of their own; returns true if there are any.
fn wrap_defaults(tree: &mut Element) -> bool {
    let is_class = |element: &Element| element.name == "default";
    if !tree.all("default").any(|section| section.children.iter().any(|child| !is_class(child))) {
        return false;
    }
    // Sections of several files are one to MuJoCo.
    let (sections, rest) = std::mem::take(&mut tree.children).into_iter().partition(|child| is_class(child));
    let sections: Vec<Element> = sections;
    tree.children = rest;
    let mut class = Element { name: "default".into(), ..Element::default() };
    class.set("class", MAIN_CLASS);
    class.children = sections.into_iter().flat_map(|section| section.children).collect();
    tree.children.push(Element { name: "default".into(), attributes: Vec::new(), children: vec![class] });
    for section in tree.children.iter_mut().filter(|child| child.name == "asset") {
        for asset in section.children.iter_mut().filter(|asset| matches!(asset.name.as_str(), "mesh" | "material")) {
            if matches!(asset.get("class"), None | Some("main")) {
                asset.set("class", MAIN_CLASS);
            }
        }
    }
    for section in tree.children.iter_mut().filter(|child| child.name == "worldbody") {
        rename_main(section);
    }
    true
}

/// Renames the class `main` to [`MAIN_CLASS`].
fn rename_main(element: &mut Element) {
    for (name, value) in &mut element.attributes {
        if matches!(name.as_str(), "class" | "childclass") && value == "main" {
            *value = MAIN_CLASS.into();
        }
    }
    element.children.iter_mut().for_each(rename_main);
}

/// Takes the element of the body with this number out of the tree.
fn take_trunk(tree: Element, trunk: usize) -> Option<Element> {
    fn count(body: &Element) -> usize {
        1 + body.all("body").map(count).sum::<usize>()
    }
    let mut id = 1;
    let worlds = tree.children.into_iter().filter(|child| child.name == "worldbody");
    for body in worlds.flat_map(|world| world.children).filter(|child| child.name == "body") {
        if id == trunk {
            return Some(body);
        }
        id += count(&body);
    }
    None
}

/// Formats the range of values: `0.5 to 2`, or `1` if all are equal.
fn range(values: &[f64]) -> String {
    let low = values.iter().copied().fold(f64::INFINITY, f64::min);
    let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    if high - low < 1e-9 { short(low) } else { format!("{} to {}", short(low), short(high)) }
}

fn list(values: &[f64]) -> String {
    values.iter().map(|value| short(*value)).collect::<Vec<_>>().join(" ")
}

/// Formats a number without floating-point noise.
fn short(value: f64) -> String {
    ((value * 1e6).round() / 1e6).to_string()
}
