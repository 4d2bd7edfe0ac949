/*! URDF, as MuJoCo itself reads it.

MuJoCo compiles URDF: links, joints, limits, inertias and the primitives of collisions. The compiled model is then written as MJCF, with all
digits. What it does not take over is read here: `<limit effort>` is the limit of a joint's torque. Meshes are left out, whatever their
`package://` paths are: the links of a URDF state the masses. Only where a leg ends in no sphere, its foot may be a mesh, which is looked
for beside the file and in the folders above. The trunk, which MuJoCo would fix to the world, gets a free joint.
*/

use std::path::{Path, PathBuf};

use nalgebra::{Isometry3, Matrix3, Point3, UnitQuaternion, Vector3};

use super::load::load;
use super::masses::changed_links;
use super::newer::{Translated, write_pose};
use super::source::Files;
use super::weld::weld_urdf;
use crate::mujoco::{GeomShape, Model, Object, unit};
use crate::robot::error::RobotError;
use crate::util::numbers::spaced;
use crate::util::xml::{Element, Place};

/// Name of the link that stands for the world.
const WORLD: &str = "world";

/// Reads a URDF in a folder and writes it as MJCF.
pub(super) fn read(tree: &Element, files: &Files, weld: &[String], folder: &Path) -> Result<Translated, RobotError> {
    let is_xacro =
        |child: &Element| matches!(child.name.as_str(), "include" | "macro" | "property" | "arg" | "if" | "unless");
    ensure!(!tree.children.iter().any(is_xacro), RobotError::Xacro);
    let (mut robot, meshes) = without_meshes(tree);
    let mut notes = vec!["file: a URDF, read by MuJoCo, with a free joint for its trunk".to_owned()];
    if !weld.is_empty() {
        notes.push(weld_urdf(&mut robot, weld)?);
    }
    free_the_trunk(&mut robot)?;
    let mut compiler = Element::new("compiler").with("fusestatic", "false").with("discardvisual", "false");
    // Compiler settings in a URDF that concern its masses.
    for own in tree.all("mujoco").flat_map(|own| own.all("compiler")) {
        for name in ["balanceinertia", "boundmass", "boundinertia"] {
            if let Some(value) = own.get(name) {
                compiler.set(name, value);
            }
        }
    }
    share_masses(&mut robot);
    robot.children.insert(0, Element { children: vec![compiler], ..Element::new("mujoco") });
    let model = load(&robot, files).or_else(|error| {
        ensure!(error.to_string().contains("balanceinertia"), error);
        // Moments of inertia that are rounded, or invented for a sensor, may be impossible.
        robot.children[0].children[0].set("balanceinertia", "true");
        load(&robot, files)
    })?;
    let changed = changed_links(&model, &robot);
    if !changed.is_empty() {
        let settings = robot.children[0].children[0].attributes.iter().map(|(name, _)| name.as_str());
        let settings: Vec<_> = settings.filter(|name| name.starts_with("bal") || name.starts_with("bound")).collect();
        let why = match settings[..] {
            ["balanceinertia"] => "physically impossible (A + B < C); its three moments made equal".to_owned(),
            _ => format!("changed by {}", settings.join(", ")),
        };
        notes.push(format!("inertia of {}: {why}", changed.join(", ")));
    }
    let feet = FootMeshes::read(&model, tree, folder, files);
    let left_out = meshes.saturating_sub(feet.shapes.len());
    if left_out > 0 {
        notes.push(format!("meshes: {left_out} left out (looks and collisions); the links state the masses"));
    }
    if !feet.assets.is_empty() {
        let names = feet.assets.iter().filter_map(|asset| Path::new(asset.get("file")?).file_name());
        let names = names.map(|name| name.to_string_lossy()).collect::<Vec<_>>().join(", ");
        notes.push(format!("feet: legs end in no sphere, so their shape is read from the meshes ({names})"));
    }
    notes.extend(feet.unread.iter().map(|unread| format!("mesh left out: {unread}")));
    let (mut torques, mut speeds) = (Vec::new(), 0);
    for joint in tree.all("joint") {
        let Some((name, limit)) = joint.get("name").zip(joint.all("limit").next()) else { continue };
        if let Some(effort) = limit.get("effort").and_then(|effort| effort.trim().parse::<f64>().ok()) {
            torques.push((name.to_owned(), [-effort, effort]));
        }
        speeds += usize::from(limit.get("velocity").is_some());
    }
    if speeds > 0 {
        notes.push("joint speeds: not limited here".to_owned());
    }
    Ok(Translated { tree: written(&model, &robot, &feet), torques, notes, unread: feet.unread })
}

/// Returns what MuJoCo reads of a URDF, and the number of meshes that were left out.
fn without_meshes(tree: &Element) -> (Element, usize) {
    let mut meshes = 0;
    let mut robot = tree.clone();
    robot.children.retain(|child| matches!(child.name.as_str(), "link" | "joint"));
    for link in robot.children.iter_mut().filter(|child| child.name == "link") {
        link.children.retain(|child| {
            let is_mesh = child.all("geometry").any(|geometry| geometry.all("mesh").next().is_some());
            meshes += usize::from(is_mesh);
            child.name == "inertial" || child.name == "collision" && !is_mesh
        });
        // Names of shapes may be used twice in a URDF, and mean nothing.
        link.children.iter_mut().for_each(|child| child.remove("name"));
    }
    for joint in robot.children.iter_mut().filter(|child| child.name == "joint") {
        joint.children.retain(|child| matches!(child.name.as_str(), "origin" | "parent" | "child" | "axis" | "limit"));
    }
    (robot, meshes)
}

/// The meshes that legs may stand on: those of collisions where a leg ends in no sphere.
#[derive(Default)]
struct FootMeshes {
    /// The files, as MJCF's `<mesh>`.
    assets: Vec<Element>,
    /// Link, pose in its frame and name of the asset of each shape.
    shapes: Vec<(String, Isometry3<f64>, String)>,
    /// The meshes that cannot be read, each with the reason and a way on.
    unread: Vec<String>,
}

impl FootMeshes {
    fn read(model: &Model, tree: &Element, folder: &Path, files: &Files) -> Self {
        let (mut meshes, mut unread) = (FootMeshes::default(), Vec::<(&str, String, String, Vec<&str>)>::new());
        let moving: Vec<usize> = (1..model.count(Object::Body)).filter(|body| moves(model, *body)).collect();
        // Trunk, hip and thigh are above a calf, and nothing that moves is below it.
        let above = |body: usize| moving.iter().filter(|other| model.is_below(body, **other)).count();
        let below = |body: usize| moving.iter().filter(|other| model.is_below(**other, body)).count();
        for calf in moving.iter().copied().filter(|body| above(*body) == 4 && below(*body) == 1) {
            let parts = parts(model, calf);
            let is_own = |geom: &usize| parts.iter().any(|(part, _)| model.geom_body(*geom) == *part);
            let own: Vec<GeomShape> =
                (0..model.count(Object::Geom)).filter(is_own).map(|geom| model.geom(geom).shape).collect();
            if own.contains(&GeomShape::Sphere) {
                continue;
            }
            // Where the shank has other shapes, its own mesh is a finer one of the same.
            for (part, _) in parts.iter().filter(|(part, _)| own.is_empty() || *part != calf) {
                let name = model.name(Object::Body, *part);
                for collision in
                    tree.all("link").filter(|link| link.get("name") == Some(name)).flat_map(|link| &link.children)
                {
                    if let ("collision", Some(mesh)) = (collision.name.as_str(), mesh_of(collision)) {
                        let Err(problem) = meshes.add(name, collision, mesh, folder) else { continue };
                        let file = mesh.get("filename").unwrap_or_default();
                        match unread.iter_mut().find(|(known, ..)| *known == file) {
                            Some((.., links)) => links.push(name),
                            None => unread.push((file, files.at(mesh), problem, vec![name])),
                        }
                    }
                }
            }
        }
        let told = unread
            .into_iter()
            .map(|(file, at, problem, links)| format!("{at}: the mesh '{file}' of {} {problem}", links.join(", ")));
        meshes.unread = told.collect();
        meshes
    }

    /// Adds the mesh of a collision.
    fn add(&mut self, link: &str, collision: &Element, mesh: &Element, folder: &Path) -> Result<(), String> {
        let path = find(mesh.get("filename").unwrap_or_default(), folder)?;
        let file = path.to_str().ok_or("has a path that is not UTF-8: move it")?;
        let scale = mesh.get("scale").unwrap_or("1 1 1");
        let is_it = |asset: &&Element| asset.get("file") == Some(file) && asset.get("scale") == Some(scale);
        let known = self.assets.iter().find(is_it).and_then(|asset| asset.get("name")).map(str::to_owned);
        let name = known.unwrap_or_else(|| {
            let name = format!("foot_{}", self.assets.len());
            let asset = Element { place: mesh.place, ..Element::new("mesh") };
            self.assets.push(asset.with("name", &name).with("file", file).with("scale", scale));
            name
        });
        self.shapes.push((link.to_owned(), origin(collision), name));
        Ok(())
    }
}

/// Returns the `<mesh>` of a collision, if it is one.
fn mesh_of(collision: &Element) -> Option<&Element> {
    collision.all("geometry").flat_map(|geometry| &geometry.children).find(|shape| shape.name == "mesh")
}

/// Finds the file of a mesh. A package is a folder above the URDF, or one beside those; a file without its folders may lie
/// beside the URDF.
fn find(given: &str, folder: &Path) -> Result<PathBuf, String> {
    let extension = Path::new(given).extension().unwrap_or_default().to_ascii_lowercase();
    if !["stl", "obj", "msh"].iter().any(|known| extension == *known) {
        return Err("has a format that is not read, expected STL, OBJ or MSH: convert it".to_owned());
    }
    let path = given.split_once("://").map_or(given, |(_, path)| path);
    let inner = path.split_once('/').map_or(path, |(_, inner)| inner);
    let name = Path::new(path).file_name().unwrap_or_default();
    let near = folder.ancestors().take(6).flat_map(|above| [above.join(path), above.join(inner)]);
    near.chain([folder.join(name)])
        .find(|path| path.is_file())
        .ok_or_else(|| format!("is not there, expected {}: put the file there", folder.join(name).display()))
}

/// Lets the first link move: MuJoCo fixes it to the world, and would drop its mass.
fn free_the_trunk(robot: &mut Element) -> Result<(), RobotError> {
    let is_moving =
        |name: &str, robot: &Element| robot.all("joint").any(|joint| end(joint, "child").as_deref() == Some(name));
    // A first link of its own for the world is common, and joined to the trunk in any way.
    let of_world = |joint: &Element| joint.name == "joint" && end(joint, "parent").as_deref() == Some(WORLD);
    robot.children.retain(|child| !(of_world(child) || child.name == "link" && child.get("name") == Some(WORLD)));
    let links: Vec<String> = robot.all("link").filter_map(|link| link.get("name")).map(str::to_owned).collect();
    let roots: Vec<&String> = links.iter().filter(|name| !is_moving(name, robot)).collect();
    let [root] = roots[..] else { return Err(RobotError::Links(roots.len())) };
    let mut root = root.clone();
    // A first link without a mass, as ROS requires it, is joined to the trunk.
    loop {
        let has_mass =
            robot.all("link").any(|link| link.get("name") == Some(&root) && link.all("inertial").next().is_some());
        let below: Vec<&Element> =
            robot.all("joint").filter(|joint| end(joint, "parent").as_deref() == Some(&root)).collect();
        let [only] = below[..] else { break };
        let (true, false, Some(next)) = (only.get("type") == Some("fixed"), has_mass, end(only, "child")) else {
            break;
        };
        let joint = only.get("name").map(str::to_owned);
        robot.children.retain(|child| match child.name.as_str() {
            "joint" => child.get("name").map(str::to_owned) != joint,
            _ => child.get("name") != Some(&root),
        });
        root = next;
    }
    robot.children.insert(0, Element::new("link").with("name", WORLD));
    let mut free = Element::new("joint").with("name", "root").with("type", "floating");
    free.children = vec![Element::new("parent").with("link", WORLD), Element::new("child").with("link", root)];
    robot.children.push(free);
    Ok(())
}

/// Returns the link at the end `which` of a joint, `parent` or `child`.
fn end(joint: &Element, which: &str) -> Option<String> {
    joint.all(which).filter_map(|link| link.get("link")).next().map(str::to_owned)
}

/// Gives links that move without a mass the inertia of a link that is fixed to them, as some URDFs have their trunk.
fn share_masses(robot: &mut Element) {
    let is_fixed = |joint: &&Element| joint.get("type") == Some("fixed");
    let weighs = |robot: &Element, name: &str| named(robot, "link", name)?.all("inertial").next().cloned();
    let moving = robot.all("joint").filter(|joint| !is_fixed(joint)).filter_map(|joint| end(joint, "child"));
    for name in moving.collect::<Vec<_>>() {
        if weighs(robot, &name).is_some() {
            continue;
        }
        let below = robot.all("joint").filter(is_fixed).filter(|joint| end(joint, "parent").as_deref() == Some(&name));
        let found = below.filter_map(|joint| {
            let child = end(joint, "child")?;
            Some((origin(joint), weighs(robot, &child)?, child))
        });
        let Some((joint, mut inertial, child)) = found.into_iter().next() else { continue };
        let own = joint * origin(&inertial);
        let (roll, pitch, yaw) = own.rotation.euler_angles();
        inertial.children.retain(|part| part.name != "origin");
        let place = Element::new("origin").with("xyz", spaced(own.translation.vector.as_slice()));
        inertial.children.push(place.with("rpy", spaced(&[roll, pitch, yaw])));
        for link in robot.children.iter_mut().filter(|link| link.name == "link") {
            if link.get("name") == Some(&child) {
                link.children.retain(|part| part.name != "inertial");
            } else if link.get("name") == Some(&name) {
                link.children.push(inertial.clone());
            }
        }
    }
}

/// Reads the `<origin>` of a joint or inertia.
fn origin(element: &Element) -> Isometry3<f64> {
    let numbers = |name: &str| -> [f64; 3] {
        let text = element.all("origin").find_map(|origin| origin.get(name)).unwrap_or("");
        let mut words = text.split_whitespace().map(|word| word.parse().unwrap_or(0.0));
        std::array::from_fn(|_| words.next().unwrap_or(0.0))
    };
    let [roll, pitch, yaw] = numbers("rpy");
    Isometry3::from_parts(numbers("xyz").into(), UnitQuaternion::from_euler_angles(roll, pitch, yaw))
}

/// Writes a compiled model as MJCF. Elements keep the places of the URDF's.
fn written(model: &Model, robot: &Element, feet: &FootMeshes) -> Element {
    let compiler = Element::new("compiler").with("angle", "radian");
    let world = Element { children: bodies(model, 0, robot, feet), ..Element::new("worldbody") };
    let assets = Element { children: feet.assets.clone(), ..Element::new("asset") };
    Element { children: vec![compiler, assets, world], ..Element::new("mujoco") }
}

/// Writes the bodies that move against a body. Links that are fixed to one another are one body, as when MuJoCo reads a URDF by
/// itself.
fn bodies(model: &Model, parent: usize, robot: &Element, feet: &FootMeshes) -> Vec<Element> {
    let moving = parts(model, parent).into_iter().flat_map(|(part, pose)| {
        let below = (1..model.count(Object::Body)).filter(move |body| model.body_parent(*body) == part);
        below.filter(|body| moves(model, *body)).map(move |body| (body, pose * local(model, body)))
    });
    moving
        .map(|(body, pose)| {
            let name = model.name(Object::Body, body);
            let mut element = Element { place: place(robot, "link", name), ..Element::new("body") }.with("name", name);
            write_pose(&pose, &mut element);
            let parts = parts(model, body);
            element.children.extend(inertial(model, &parts, robot));
            for joint in (0..model.count(Object::Joint)).filter(|joint| model.joint_body(*joint) == body) {
                element.children.push(written_joint(model, joint, robot));
            }
            for (part, pose) in &parts {
                for geom in (0..model.count(Object::Geom)).filter(|geom| model.geom_body(*geom) == *part) {
                    element.children.push(written_geom(model, geom, pose));
                }
                for (_, own, mesh) in feet.shapes.iter().filter(|shape| shape.0 == model.name(Object::Body, *part)) {
                    let mut geom = Element::new("geom").with("type", "mesh").with("mesh", mesh).with("mass", 0);
                    write_pose(&(pose * own), &mut geom);
                    element.children.push(geom);
                }
            }
            element.children.extend(bodies(model, body, robot, feet));
            element
        })
        .collect()
}

/// Returns true if a joint moves a body.
pub(super) fn moves(model: &Model, body: usize) -> bool {
    (0..model.count(Object::Joint)).any(|joint| model.joint_body(joint) == body)
}

/// Returns the pose of a body in the frame of the body above it.
fn local(model: &Model, body: usize) -> Isometry3<f64> {
    Isometry3::from_parts(model.body_position(body).into(), model.body_rotation(body))
}

/// Returns a body and all that is fixed to it, with the poses in its frame.
fn parts(model: &Model, body: usize) -> Vec<(usize, Isometry3<f64>)> {
    let mut parts = vec![(body, Isometry3::identity())];
    let mut next = 0;
    while next < parts.len() {
        let (part, pose) = parts[next];
        let fixed =
            (1..model.count(Object::Body)).filter(|below| model.body_parent(*below) == part && !moves(model, *below));
        parts.extend(fixed.map(|below| (below, pose * local(model, below))));
        next += 1;
    }
    parts
}

/// Writes the mass and inertia of parts that are fixed to one another; `None` if no link states any.
fn inertial(model: &Model, parts: &[(usize, Isometry3<f64>)], robot: &Element) -> Option<Element> {
    let states = |body: usize| {
        let link = named(robot, "link", model.name(Object::Body, body));
        link.is_some_and(|link| link.all("inertial").next().is_some())
    };
    let heavy: Vec<_> = parts.iter().filter(|(body, _)| states(*body)).collect();
    if let [(body, pose)] = heavy[..]
        && *pose == Isometry3::identity()
    {
        return Some(written_inertial(model, *body));
    }
    let centre = |(body, pose): &(usize, Isometry3<f64>)| pose * Point3::from(model.body_centre_of_mass(*body));
    let mass: f64 = heavy.iter().map(|part| model.body_mass()[part.0]).sum();
    let weighted = heavy.iter().map(|part| centre(part).coords * model.body_mass()[part.0]);
    let middle = weighted.sum::<Vector3<f64>>() / mass;
    let tensor: Matrix3<f64> = heavy
        .iter()
        .map(|part| {
            let (body, pose) = part;
            let axes = (pose.rotation * unit(model.body_inertia_quaternion(*body))).to_rotation_matrix();
            let own = axes * Matrix3::from_diagonal(&model.body_inertia(*body).into()) * axes.transpose();
            let arm = centre(part).coords - middle;
            own + (Matrix3::identity() * arm.norm_squared() - arm * arm.transpose()) * model.body_mass()[*body]
        })
        .sum();
    (mass > 0.0).then(|| {
        let full = [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)].map(|at| tensor[at]);
        let inertial = Element::new("inertial").with("pos", spaced(middle.as_slice())).with("mass", mass);
        inertial.with("fullinertia", spaced(&full))
    })
}

/// Writes the mass and inertia that MuJoCo has found for a body.
pub(super) fn written_inertial(model: &Model, body: usize) -> Element {
    Element::new("inertial")
        .with("pos", spaced(&model.body_centre_of_mass(body)))
        .with("quat", spaced(&model.body_inertia_quaternion(body)))
        .with("mass", model.body_mass()[body])
        .with("diaginertia", spaced(&model.body_inertia(body)))
}

/// Writes a geometry of a part, in the frame of the body that the part is fixed to.
fn written_geom(model: &Model, geom: usize, part: &Isometry3<f64>) -> Element {
    let shape = model.geom(geom);
    let kind = match shape.shape {
        GeomShape::Sphere => "sphere",
        GeomShape::Capsule => "capsule",
        GeomShape::Cylinder => "cylinder",
        _ => "box",
    };
    let pose = part * Isometry3::from_parts(shape.position.into(), unit(shape.quaternion));
    let mut written = Element::new("geom").with("type", kind).with("size", spaced(&shape.size));
    write_pose(&pose, &mut written);
    // Without a mass in its link, a part has none.
    written.with("mass", 0)
}

fn written_joint(model: &Model, joint: usize, robot: &Element) -> Element {
    let name = model.name(Object::Joint, joint);
    if model.is_free(joint) {
        return Element::new("freejoint").with("name", name);
    }
    let element = Element { place: place(robot, "joint", name), ..Element::new("joint") }.with("name", name);
    let element = element.with("type", if model.is_hinge(joint) { "hinge" } else { "slide" });
    let mut element =
        element.with("pos", spaced(&model.joint_anchor(joint))).with("axis", spaced(&model.joint_axis(joint)));
    if model.joint_is_limited(joint) {
        element.set("range", spaced(&model.joint_range(joint)));
    }
    element
}

/// Returns where the URDF has a link or joint.
fn place(robot: &Element, kind: &str, name: &str) -> Place {
    named(robot, kind, name).map_or(Place::default(), |element| element.place)
}

/// Returns the first element of a kind with a name.
fn named<'a>(robot: &'a Element, kind: &'a str, name: &str) -> Option<&'a Element> {
    robot.all(kind).find(|element| element.get("name") == Some(name))
}
