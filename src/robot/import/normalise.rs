//! Conversion of any quadruped's MJCF to the names and conventions of Supple.

use std::path::{Path, PathBuf};

use super::Imported;
use super::angles::settle_angles;
use super::feet::{self, Sole};
use super::load::load;
use super::masses::changed_bodies;
use super::names::Description;
use super::newer::{self, Translated};
use super::source::{Files, Source};
use super::torque::torque_limits;
use super::{urdf, weld};
use crate::mujoco::{Data, GeomContact, GeomShape, Model, Object};
use crate::robot::error::RobotError;
use crate::robot::kinematics::{Leg, bent_pose};
use crate::robot::{HARNESS, JOINTS, Joints, LEGS, PARTS, joint_name, limits, sole_name};
use crate::util::numbers::{short, spaced};
use crate::util::xml::Element;

/// Class that takes over the file's top-level defaults, because a robot must not change those of a scene.
const MAIN_CLASS: &str = "robot_defaults";

/// Settings of the compiler that change masses and inertias, also those of everything else in a scene. They hold when the
/// file is read; afterwards, the robot states the masses that result.
pub(super) const OF_MASSES: [&str; 7] = [
    "boundmass",
    "boundinertia",
    "settotalmass",
    "balanceinertia",
    "inertiafromgeom",
    "inertiagrouprange",
    "exactmeshinertia",
];

/// Values of these settings that change nothing.
const WITHOUT_EFFECT: [&str; 5] = ["auto", "false", "0", "-1", "0 5"];

/// Settings of the compiler that only concern meshes, of which a scene has none but the robot's.
const OF_MESHES: [&str; 2] = ["convexhull", "fitaabb"];

/// The properties that MuJoCo reads from the file.
struct Survey<'a> {
    files: &'a Files,
    model: Model,
    trunk: usize,
    joints: [usize; JOINTS],
    feet: [usize; 4],
    torque_limits: Joints,
    /// The contact settings of the geometries of each body, in order.
    geoms: Vec<Vec<(usize, GeomContact)>>,
    /// True if the robot states the masses that MuJoCo has found.
    states_masses: bool,
    /// Changes found while reading, one on a line.
    notes: Vec<String>,
}

/// Converts the files of a robot.
pub(super) fn adapt(source: &Source) -> Result<Imported, RobotError> {
    let (description, files) = (&source.description, &source.files);
    let file = std::path::absolute(&description.mjcf)?;
    let folder = file.parent().unwrap_or(Path::new(""));
    let translated = if source.is_urdf() {
        urdf::read(&source.tree, files, &source.weld, folder)?
    } else {
        newer::translate(&source.tree, files)?
    };
    let Translated { mut tree, torques, mut notes, unread } = translated;
    let assets = find_assets(&mut tree, folder)?;
    if !source.is_urdf() && !source.weld.is_empty() {
        notes.push(weld::weld(&mut tree, &source.weld, files)?);
    }
    let acts = |value: &str| !WITHOUT_EFFECT.contains(&value);
    let states_masses =
        tree.all("compiler").any(|compiler| OF_MASSES.iter().any(|name| compiler.get(name).is_some_and(acts)));
    let angle = settle_angles(&mut tree);
    let survey = Survey::of(&tree, files, description, &torques, states_masses).map_err(|error| match error {
        RobotError::NoFoot { leg } if !unread.is_empty() => RobotError::FootMesh { leg, unread: unread.join("; ") },
        error => error,
    })?;
    if states_masses {
        let changed = changed_bodies(&survey.model, survey.trunk, &tree, files).map(|changed| match &changed[..] {
            [] => "change no part".to_owned(),
            changed => format!("change {}", changed.join(", ")),
        });
        let changed = changed.unwrap_or_else(|| "change some parts".to_owned());
        notes.push(format!("masses and inertias: its compiler settings {changed}"));
    }
    notes.extend(survey.notes.iter().cloned());
    let mut report = survey.report();
    report.append(&mut notes);
    report.extend(left_out(&source.tree, &survey));
    let (mut start, has_pose) = survey.start(description)?;
    let mut document = survey.document(&tree, &start, description)?;
    let model = load(&document, files)?;
    if !has_pose && survey.feet.iter().any(|foot| survey.model.geom(*foot).shape != GeomShape::Sphere) {
        // Knees will be bent; the feet then stand on other points.
        let limits = survey.joints.map(|joint| limits(&survey.model, joint));
        if let Some(bent) = bent_pose(&Leg::all(&model)?, &start.pose, &limits) {
            start.soles = survey.pose(&bent)?.soles;
            document = survey.document(&tree, &start, description)?;
            load(&document, files)?;
        }
    }
    report.extend(angle);
    report.extend(start.report());
    let mut mjcf = String::new();
    document.write(&mut mjcf);
    let sha256 = source.sha256(&assets)?;
    let joints = survey.joints.map(|joint| survey.model.name(Object::Joint, joint).to_owned());
    Ok(Imported { mjcf, report, has_pose, fall_height_m: description.fall_height_m, sha256, joints, assets })
}

/// A pose that the robot stands in.
struct Stand {
    /// Joint angles in Supple's order \[rad\].
    pose: Joints,
    /// Where the angles come from.
    from: &'static str,
    /// Positions of the whole robot in its file's order of joints.
    positions: Vec<f64>,
    /// Height of the trunk's origin \[m\].
    height: f64,
    /// The spheres that the feet stand on.
    soles: [Sole; 4],
    /// True if the positions are those of a file that this program wrote.
    ours: bool,
}

impl Stand {
    fn report(&self) -> Option<String> {
        let (from, height) = (self.from, self.height);
        (!self.ours).then(|| format!("start: {from}, base at {height:.3} m, where the lowest foot touches the ground"))
    }
}

/// Makes the paths of assets absolute, because the compiled text lies in no folder, and returns them.
fn find_assets(tree: &mut Element, folder: &Path) -> Result<Vec<PathBuf>, RobotError> {
    let setting = |name: &str| tree.all("compiler").filter_map(|compiler| compiler.get(name)).last().map(str::to_owned);
    let (meshes, textures) = (setting("meshdir").unwrap_or_default(), setting("texturedir").unwrap_or_default());
    let strip = setting("strippath").as_deref() == Some("true");
    if tree.all("compiler").next().is_none() {
        tree.children.insert(0, Element::new("compiler"));
    }
    let mut found = Vec::new();
    for child in &mut tree.children {
        match child.name.as_str() {
            "compiler" => {
                ["meshdir", "texturedir", "strippath", "usethread"].iter().for_each(|name| child.remove(name));
                child.set("discardvisual", "false");
                // Bodies that do not move would be merged, and their numbers shift.
                child.remove("fusestatic");
                // A range limits, as is the default since MuJoCo 3.
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
                            attribute.1 = file.map_err(|file| RobotError::Path(file.into()))?;
                        }
                    }
                }
            }
            _ => {}
        }
    }
    Ok(found)
}

impl<'a> Survey<'a> {
    fn of(
        tree: &Element,
        files: &'a Files,
        description: &Description,
        torques: &[(String, [f64; 2])],
        states_masses: bool,
    ) -> Result<Self, RobotError> {
        let model = load(tree, files)?;
        let name = |joint: usize| model.name(Object::Joint, joint).to_owned();
        let free: Vec<usize> = (0..model.count(Object::Joint)).filter(|joint| model.is_free(*joint)).collect();
        let joints = description.joints(&model)?;
        // Bodies in between may be fixed to one another.
        let above = |body: usize| {
            let mut above = model.body_parent(body);
            while above != 0 && !urdf::moves(&model, above) {
                above = model.body_parent(above);
            }
            above
        };
        let hip_parent = above(model.joint_body(joints[0]));
        let Some(root) = free.iter().copied().find(|joint| model.joint_body(*joint) == hip_parent) else {
            return Err(RobotError::NoTrunk);
        };
        let trunk = model.joint_body(root);
        for leg in joints.chunks(PARTS.len()) {
            let [hip, thigh, calf] = [0, 1, 2].map(|part| model.joint_body(leg[part]));
            if above(hip) != trunk || above(thigh) != hip || above(calf) != thigh {
                return Err(RobotError::NotInLine(name(leg[0]), name(leg[1]), name(leg[2])));
            }
        }
        let others: Vec<String> = (0..model.count(Object::Joint))
            .filter(|joint| {
                *joint != root && !joints.contains(joint) && model.is_below(model.joint_body(*joint), trunk)
            })
            .map(name)
            .collect();
        ensure!(others.is_empty(), RobotError::OtherJoints(others.join(", ")));
        let mut geoms = vec![Vec::new(); model.count(Object::Body)];
        for geom in 0..model.count(Object::Geom) {
            geoms[model.geom_body(geom)].push((geom, model.geom_contact(geom)));
        }
        let mut notes = Vec::new();
        let torque_limits = torque_limits(&model, &joints, description, torques, &mut notes)?;
        let feet = [0; 4];
        let mut survey = Survey { files, model, trunk, joints, feet, torque_limits, geoms, states_masses, notes };
        let (pose, ..) = survey.chosen(description);
        survey.feet = feet::find(&survey.placed(&pose)?, description, &joints)?;
        Ok(survey)
    }

    /// Composes the document that scenes include.
    fn document(&self, tree: &Element, start: &Stand, description: &Description) -> Result<Element, RobotError> {
        let mut tree = tree.clone();
        let mut root = Element::new("mujoco");
        let mut compiler = Element::new("compiler").with("angle", "radian").with("autolimits", "true");
        for name in OF_MESHES {
            if let Some(value) = tree.all("compiler").filter_map(|compiler| compiler.get(name)).last() {
                compiler.set(name, value);
            }
        }
        root.children.push(compiler);
        let wrapped = wrap_defaults(&mut tree);
        for section in tree.children.iter().filter(|child| child.name == "default") {
            let mut section = section.clone();
            without_actuators(&mut section);
            root.children.push(section);
        }
        for section in tree.children.iter().filter(|child| child.name == "asset") {
            let mut section = section.clone();
            section.children.retain(|asset| asset.name != "hfield");
            root.children.push(section);
        }
        let mut trunk = take_trunk(tree, self.trunk).ok_or(RobotError::NoTrunk)?;
        if wrapped && trunk.get("childclass").is_none() {
            trunk.set("childclass", MAIN_CLASS);
        }
        let mut id = self.trunk;
        self.change(&mut trunk, &mut id, start)?;
        // Where ropes are tied to.
        let centre = spaced(&self.model.body_centre_of_mass(self.trunk));
        trunk.children.push(Element::new("site").with("name", HARNESS).with("pos", centre).with("group", 4));
        root.children.push(Element { children: vec![trunk], ..Element::new("worldbody") });
        root.children.push(self.motors());
        let numeric =
            |name: &str, values: &[f64]| Element::new("numeric").with("name", name).with("data", spaced(values));
        let mut custom = Element::new("custom");
        custom.children.push(numeric("stand_qpos", &start.positions));
        if let (None, Ok(pose)) = (description.pose, self.model.numeric("nominal_pose")) {
            custom.children.push(numeric("nominal_pose", pose));
        }
        custom.children.push(numeric("shanks_may_touch", &[1.0]));
        root.children.push(custom);
        Ok(root)
    }

    /// Converts a body and its descendants; `id` is the body's number in the model, and afterwards that of the next
    /// body.
    fn change(&self, body: &mut Element, id: &mut usize, start: &Stand) -> Result<(), RobotError> {
        let own = *id;
        let contacts = self.geoms.get(own).map_or(&[][..], Vec::as_slice);
        let mut contacts = contacts.iter();
        *id += 1;
        // Names with a slash cannot be those of a scene's bodies.
        let of_leg = self.joints.iter().position(|joint| self.model.joint_body(*joint) == own);
        match (own == self.trunk, of_leg, body.get("name").map(str::to_owned)) {
            (true, ..) => body.set("name", "trunk"),
            (_, Some(joint), _) => body.set("name", joint_name(joint)),
            (.., Some(name)) => body.set("name", format!("robot/{name}")),
            _ => {}
        }
        let is_imu = |site: &Element| own == self.trunk && site.get("name") == Some("imu");
        body.children.retain(|child| child.name != "site" || is_imu(child));
        let massless = self.states_masses && self.model.body_mass()[own] == 0.0;
        if self.states_masses {
            body.children.retain(|child| child.name != "inertial");
        }
        // A body's own geometries come before those of bodies below it, in the model as in `geoms`.
        for child in &mut body.children {
            match child.name.as_str() {
                "freejoint" => child.set("name", "root"),
                "joint" => self.change_joint(child),
                "geom" => {
                    let Some((geom, contact)) = contacts.next() else { continue };
                    self.change_geom(child, *geom, contact)?;
                    if massless {
                        child.set("mass", 0);
                    }
                }
                _ => {}
            }
        }
        if self.states_masses && !massless {
            body.children.insert(0, urdf::written_inertial(&self.model, own));
        }
        for (leg, foot) in self.feet.iter().enumerate() {
            // A sphere stands for itself.
            if self.model.geom_body(*foot) == own && self.model.geom(*foot).shape != GeomShape::Sphere {
                let Sole { centre, radius } = start.soles[leg];
                let site = Element::new("site").with("name", sole_name(leg)).with("type", "sphere");
                let site = site.with("size", radius).with("pos", spaced(&centre));
                body.children.push(site.with("group", 4));
            }
        }
        for child in body.children.iter_mut().filter(|child| child.name == "body") {
            self.change(child, id, start)?;
        }
        Ok(())
    }

    fn change_joint(&self, joint: &mut Element) {
        let name = joint.get("name").unwrap_or("");
        let ours = self.joints.iter().position(|id| self.model.name(Object::Joint, *id) == name);
        if let Some(index) = ours {
            joint.set("limited", self.model.joint_is_limited(self.joints[index]));
        }
        joint.set("name", ours.map_or_else(|| "root".to_owned(), |index| format!("{}_joint", joint_name(index))));
        joint.set("springdamper", "0 0");
        ["damping", "frictionloss", "stiffness"].iter().for_each(|name| joint.set(name, "0"));
    }

    /// Sets Supple's contact masks and removes settings that would override the ground's.
    fn change_geom(&self, element: &mut Element, geom: usize, contact: &GeomContact) -> Result<(), RobotError> {
        let shape = match self.model.geom(geom).shape {
            GeomShape::Plane => "plane",
            GeomShape::HeightField(_) => "height field",
            _ => "",
        };
        ensure!(shape.is_empty(), RobotError::Ground { at: self.files.at(element), shape });
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
        // MuJoCo's defaults, which hold on ground with patches of friction.
        element.set("condim", 3);
        let contact = [("friction", "1 0.005 0.0001"), ("solref", "0.02 1"), ("solimp", "0.9 0.95 0.001 0.5 2")];
        contact.iter().for_each(|(name, value)| element.set(name, value));
        Ok(())
    }

    fn motors(&self) -> Element {
        let limits = self.torque_limits;
        let motor = |joint: usize| {
            Element::new("motor")
                .with("name", joint_name(joint))
                .with("joint", format!("{}_joint", joint_name(joint)))
                .with("ctrllimited", "true")
                .with("ctrlrange", format!("-{limit} {limit}", limit = limits[joint]))
        };
        Element { children: (0..JOINTS).map(motor).collect(), ..Element::new("actuator") }
    }

    /// Returns the joint angles to stand in, where they come from, and true if the file or its description gives them.
    fn chosen(&self, description: &Description) -> (Joints, &'static str, bool) {
        let model = &self.model;
        let ours =
            |positions: &[f64]| -> Joints { self.joints.map(|joint| positions[model.joint_position_index(joint)]) };
        match (description.pose, self.own_stand(description), model.keyframe()) {
            (Some(pose), ..) => (pose, "the joint angles of its description's nominal pose", true),
            (None, Some(stand), _) => (ours(stand), "the joint angles that this program wrote into its file", true),
            (None, None, Some(positions)) => (ours(positions), "the joint angles of its keyframe", true),
            (None, None, None) => (ours(model.rest_positions()), "all joint angles as in its file", false),
        }
    }

    /// Returns the starting positions of a file that this program wrote.
    fn own_stand(&self, description: &Description) -> Option<&[f64]> {
        let stand = self.model.numeric("stand_qpos").ok().filter(|_| description.pose.is_none())?;
        (stand.len() == 7 + JOINTS && self.model.nq() == stand.len()).then_some(stand)
    }

    /// Returns the robot level at 1 m in a pose.
    fn placed(&self, pose: &Joints) -> Result<Data, RobotError> {
        let model = self.model.try_clone()?;
        let root = (0..model.count(Object::Joint)).find(|joint| model.joint_body(*joint) == self.trunk).unwrap_or(0);
        let base = model.joint_position_index(root);
        let places = self.joints.map(|joint| model.joint_position_index(joint));
        let mut data = Data::new(model)?;
        let positions = data.positions_mut();
        positions[base..base + 7].copy_from_slice(&[0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]);
        for (place, angle) in places.iter().zip(pose) {
            positions[*place] = *angle;
        }
        data.step1()?;
        Ok(data)
    }

    /// Returns the robot standing in a pose on its lowest foot.
    fn pose(&self, pose: &Joints) -> Result<Stand, RobotError> {
        let data = self.placed(pose)?;
        let mut soles = [Sole { centre: [0.0; 3], radius: 0.0 }; 4];
        let mut lowest = f64::INFINITY;
        for (leg, foot) in self.feet.iter().enumerate() {
            let missing = || RobotError::NoFoot { leg: LEGS[leg] };
            soles[leg] = feet::sole(&data, *foot).ok_or_else(missing)?;
            lowest = lowest.min(feet::lower_end(&data, *foot).ok_or_else(missing)?.point.z);
        }
        let height = 1.0 - lowest;
        // In the order of the joints in the file, which is that of the positions.
        let places = self.joints.map(|joint| self.model.joint_position_index(joint));
        let mut in_file: Vec<(usize, f64)> = places.into_iter().zip(*pose).collect();
        in_file.sort_by_key(|(place, _)| *place);
        let trunk = [0.0, 0.0, height, 1.0, 0.0, 0.0, 0.0].into_iter();
        let positions = trunk.chain(in_file.into_iter().map(|(_, angle)| angle)).collect();
        Ok(Stand { pose: *pose, from: "", positions, height, soles, ours: false })
    }

    /// Returns the starting positions and true if the file or its description gives them. They are those of
    /// `stand_qpos`, of the keyframe `home` or the first one, or the description's pose, placed on the ground by the
    /// lowest foot.
    fn start(&self, description: &Description) -> Result<(Stand, bool), RobotError> {
        let (pose, from, has_pose) = self.chosen(description);
        let mut stand = Stand { from, ..self.pose(&pose)? };
        if let Some(own) = self.own_stand(description) {
            stand = Stand { positions: own.to_vec(), height: own[2], ours: true, ..stand };
        }
        Ok((stand, has_pose))
    }

    /// Lists the changes, one on a line.
    fn report(&self) -> Vec<String> {
        let model = &self.model;
        let mut lines = Vec::new();
        let bodies = (self.trunk..model.count(Object::Body)).filter(|body| model.is_below(*body, self.trunk));
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
        let springs = self.joints.map(|joint| model.joint_stiffness(joint));
        if springs.iter().any(|stiffness| *stiffness != 0.0) {
            let found = range(&springs);
            lines.push(format!("joint springs: {found} N m/rad, set to 0: K_p is the only stiffness here"));
        }
        let without: Vec<String> =
            (0..JOINTS).filter(|index| !model.joint_is_limited(self.joints[*index])).map(joint_name).collect();
        if !without.is_empty() {
            lines.push(format!("joint limits: none in the file for {}, which turn freely", without.join(", ")));
        }
        let limits = self.torque_limits;
        let servos = (0..model.count(Object::Actuator)).filter(|id| model.actuator(*id).has_bias).count();
        let hips_and_thighs: Vec<f64> =
            limits.chunks(PARTS.len()).flat_map(|leg| &leg[..PARTS.len() - 1]).copied().collect();
        let calves: Vec<f64> = limits.chunks(PARTS.len()).map(|leg| leg[PARTS.len() - 1]).collect();
        lines.push(format!(
            "actuators: {} ({servos} of them servos) replaced by torque motors under our PD law; limits {} N m (hip, \
             thigh) and {} N m (calf)",
            model.count(Object::Actuator),
            range(&hips_and_thighs),
            range(&calves),
        ));
        let feet = self.feet.map(|foot| model.geom_contact(foot));
        let radii = self.feet.map(|foot| model.geom(foot).size[0]);
        let foot = &feet[0];
        let shapes = self.feet.map(|foot| match model.geom(foot).shape {
            GeomShape::Sphere => "spheres",
            GeomShape::Capsule => "capsules",
            GeomShape::Cylinder => "cylinders",
            GeomShape::Ellipsoid => "ellipsoids",
            GeomShape::Box => "boxes",
            _ => "meshes",
        });
        let what = if shapes.iter().all(|shape| *shape == "spheres") {
            format!("spheres of {} mm", range(&radii.map(|radius| 1e3 * radius)))
        } else {
            let mut kinds = shapes.to_vec();
            kinds.sort_unstable();
            kinds.dedup();
            let kinds = kinds.join(" and ");
            format!("{kinds}, which collide as such; heights are those of their lowest points in the nominal pose")
        };
        lines.push(format!(
            "feet: {what}; condim {}, priority {}, friction {}, solimp {} replaced by the ground's friction and \
             MuJoCo's default softness",
            foot.condim,
            foot.priority,
            list(&foot.friction),
            list(&foot.solimp[..3]),
        ));
        lines.push("contact: parts of the robot do not collide with one another; margins and gaps set to 0".into());
        lines.push(
            "falls: trunk, hips or thighs on the ground count as a fall; shanks, which may reach down to the feet, do not"
                .into(),
        );
        lines
    }
}

/// Removes the settings of actuators, which motors replace, from default classes.
fn without_actuators(section: &mut Element) {
    section
        .children
        .retain(|child| matches!(child.name.as_str(), "default" | "mesh" | "material" | "joint" | "geom" | "site"));
    section.children.iter_mut().filter(|child| child.name == "default").for_each(without_actuators);
}

/// Lists the sections and world elements that are left out: a scenario brings its own, or nothing reads them.
fn left_out(tree: &Element, survey: &Survey<'_>) -> Vec<String> {
    let mut lines = Vec::new();
    for option in tree.all("option") {
        let own = option.attributes.iter().map(|(name, value)| format!("{name} {value}"));
        let flags = option.all("flag").flat_map(|flag| &flag.attributes);
        let settings: Vec<String> = own.chain(flags.map(|(name, value)| format!("flag {name} {value}"))).collect();
        if !settings.is_empty() {
            lines
                .push(format!("options: {} replaced by ours (Euler, pyramidal cone, impratio 1)", settings.join(", ")));
        }
    }
    let world: Vec<String> = tree
        .all("worldbody")
        .flat_map(|world| &world.children)
        .filter(|child| !(matches!(child.name.as_str(), "body" | "frame") && contains_free_joint(child)))
        .map(|child| child.get("name").map_or_else(|| child.name.clone(), |name| format!("{} '{name}'", child.name)))
        .collect();
    if !world.is_empty() {
        lines.push(format!("world: {} left out; a scenario brings its own ground", world.join(", ")));
    }
    let sections = ["sensor", "contact", "keyframe", "size", "statistic", "visual", "custom", "extension"];
    let found: Vec<&str> = sections.into_iter().filter(|name| tree.all(name).next().is_some()).collect();
    if !found.is_empty() {
        lines.push(format!("sections left out: {}", found.join(", ")));
    }
    let moving = (0..survey.model.count(Object::Joint)).filter(|joint| survey.model.is_free(*joint)).count();
    if moving > 1 {
        lines.push(format!("{} loose bodies beside the robot left out", moving - 1));
    }
    lines
}

fn contains_free_joint(body: &Element) -> bool {
    let is_free = |child: &Element| child.name == "freejoint" || child.get("type") == Some("free");
    let framed = |child: &Element| child.name == "frame" || body.name == "frame" && child.name == "body";
    body.children.iter().any(|child| is_free(child) || framed(child) && contains_free_joint(child))
}

/// Moves top-level defaults into a class of their own; returns true if there are any.
fn wrap_defaults(tree: &mut Element) -> bool {
    let is_class = |element: &Element| element.name == "default";
    let top = tree.all("default").find_map(|section| section.get("class")).unwrap_or("main").to_owned();
    if !tree.all("default").any(|section| section.children.iter().any(|child| !is_class(child))) {
        return false;
    }
    // Sections of several files are one to MuJoCo.
    let (sections, rest) = std::mem::take(&mut tree.children).into_iter().partition(|child| is_class(child));
    let sections: Vec<Element> = sections;
    tree.children = rest;
    let mut class = Element::new("default").with("class", MAIN_CLASS);
    class.children = sections.into_iter().flat_map(|section| section.children).collect();
    tree.children.push(Element { children: vec![class], ..Element::new("default") });
    for section in tree.children.iter_mut().filter(|child| child.name == "asset") {
        for asset in section.children.iter_mut().filter(|asset| matches!(asset.name.as_str(), "mesh" | "material")) {
            if asset.get("class").is_none_or(|class| class == top) {
                asset.set("class", MAIN_CLASS);
            }
        }
    }
    for section in tree.children.iter_mut().filter(|child| child.name == "worldbody") {
        rename_main(section, &top);
    }
    true
}

/// Renames the top-level class to [`MAIN_CLASS`].
fn rename_main(element: &mut Element, top: &str) {
    for (name, value) in &mut element.attributes {
        if matches!(name.as_str(), "class" | "childclass") && value == top {
            *value = MAIN_CLASS.into();
        }
    }
    element.children.iter_mut().for_each(|child| rename_main(child, top));
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
