//! A compiled model: names, sizes, constants, and the parameters an episode may change (gravity, friction, ropes, terrain).

use std::ffi::{CStr, CString};
use std::ptr::NonNull;
use std::sync::atomic::{AtomicBool, Ordering};

use mujoco_sys as sys;
use nalgebra::UnitQuaternion;

use super::error::{Error, Result};
use super::{EMPTY_MESSAGE, check, initialise, sizes, text as text_of, unit};
use crate::util::xml;

/// A kind of named model element.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Object {
    /// A body: a rigid part with mass.
    Body,
    /// A joint between a body and its parent.
    Joint,
    /// A collision or visual geometry.
    Geom,
    /// A site: a marked point.
    Site,
    /// An actuator, such as a motor.
    Actuator,
    /// A custom numeric field.
    Numeric,
    /// A height field, such as uneven ground.
    HeightField,
    /// A tendon, such as a rope.
    Tendon,
}

impl Object {
    /// Returns MuJoCo's constant of the kind and its name in messages.
    pub(super) fn known(self) -> (u32, &'static str) {
        match self {
            Object::Body => (sys::mjOBJ_BODY, "body"),
            Object::Joint => (sys::mjOBJ_JOINT, "joint"),
            Object::Geom => (sys::mjOBJ_GEOM, "geom"),
            Object::Site => (sys::mjOBJ_SITE, "site"),
            Object::Actuator => (sys::mjOBJ_ACTUATOR, "actuator"),
            Object::Numeric => (sys::mjOBJ_NUMERIC, "numeric field"),
            Object::HeightField => (sys::mjOBJ_HFIELD, "height field"),
            Object::Tendon => (sys::mjOBJ_TENDON, "tendon"),
        }
    }
}

/// Shape of a geometry, with MuJoCo's convention for its sizes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GeomShape {
    /// An infinite plane; sizes are the drawn half-lengths.
    Plane,
    /// The height field of this id.
    HeightField(usize),
    /// A sphere; size: radius.
    Sphere,
    /// A capsule along z; sizes: radius, half-length.
    Capsule,
    /// An ellipsoid; sizes: three radii.
    Ellipsoid,
    /// A cylinder along z; sizes: radius, half-length.
    Cylinder,
    /// A box; sizes: three half-lengths.
    Box,
    /// The mesh of this id.
    Mesh(usize),
}

/// A geometry of a model.
#[derive(Debug, Clone, PartialEq)]
pub struct Geom {
    /// Name, empty if the geometry has none.
    pub name: String,
    /// Id of the body that the geometry is fixed to.
    pub body: usize,
    /// The shape of the geometry.
    pub shape: GeomShape,
    /// Shape-specific sizes \[m\].
    pub size: [f64; 3],
    /// Position in its body's frame \[m\].
    pub position: [f64; 3],
    /// Orientation in its body's frame (w, x, y, z).
    pub quaternion: [f64; 4],
    /// Colour and opacity, 0 to 1.
    pub rgba: [f32; 4],
    /// Visual group, 0 to 5.
    pub group: i32,
}

/// The effect of an actuator on a joint.
#[derive(Debug, Clone, PartialEq)]
pub struct Actuator {
    /// Id of the joint; `None` if the actuator acts on something else.
    pub joint: Option<usize>,
    /// Gear ratio: joint torque per unit of actuator force.
    pub gear: f64,
    /// Actuator force per unit of control.
    pub gain: f64,
    /// True if the actuator's force depends on the joint's state: a servo.
    pub has_bias: bool,
    /// Limits of the control, if it is limited.
    pub control_range: Option<[f64; 2]>,
    /// Limits of the force, if it is limited.
    pub force_range: Option<[f64; 2]>,
}

impl Actuator {
    /// Returns the torques that the actuator can give, if they are limited \[N·m\]: its limits of the force, and for a motor
    /// also those of the control, whichever is tighter.
    pub(crate) fn torque_range(&self) -> Option<[f64; 2]> {
        let scaled = |[low, high]: [f64; 2], by: f64| [(low * by).min(high * by), (low * by).max(high * by)];
        let force = self.force_range;
        let control = self.control_range.filter(|_| !self.has_bias).map(|range| scaled(range, self.gain));
        let tightest = match (force, control) {
            (Some(force), Some(control)) => Some([force[0].max(control[0]), force[1].min(control[1])]),
            (range, None) | (None, range) => range,
        };
        tightest.map(|range| scaled(range, self.gear))
    }
}

/// Contact parameters of a geometry, as MJCF names them.
#[derive(Debug, Clone, PartialEq)]
pub struct GeomContact {
    /// Bit mask of the geometry's contact type.
    pub contype: i32,
    /// Bit mask of the contact types that the geometry collides with.
    pub conaffinity: i32,
    /// Dimension of the contact force: 1, 3, 4 or 6.
    pub condim: i32,
    /// Priority: in a contact, the geometry with the higher priority sets friction and softness.
    pub priority: i32,
    /// Sliding, torsional and rolling friction.
    pub friction: [f64; 3],
    /// Impedance of the contact, which sets its softness.
    pub solimp: [f64; 5],
}

impl GeomContact {
    /// Returns true if the geometry takes part in contacts.
    pub fn collides(&self) -> bool {
        self.contype != 0 || self.conaffinity != 0
    }
}

/// A compiled model: an owned `mjModel`.
#[derive(Debug)]
pub struct Model(NonNull<sys::mjModel>);

// SAFETY: an mjModel is plain memory that MuJoCo reads only while stepping; writing needs `&mut`.
unsafe impl Send for Model {}
// SAFETY: as above.
unsafe impl Sync for Model {}

/// The mass of a body, from which `Model::set_inertial` deviates.
#[derive(Debug, Clone, PartialEq)]
pub struct Inertial {
    /// Mass of the body \[kg\].
    pub mass_kg: f64,
    /// Moments of inertia about its principal axes [kg·m²].
    pub moments: [f64; 3],
    /// Centre of mass in the body's frame \[m\].
    pub centre_m: [f64; 3],
    /// Ids of the body and the bodies that carry it, with the masses of their subtrees \[kg\].
    pub subtrees_kg: Vec<(usize, f64)>,
}

impl Drop for Model {
    fn drop(&mut self) {
        // SAFETY: the pointer is owned and came from MuJoCo.
        unsafe { sys::mj_deleteModel(self.0.as_ptr()) }
    }
}

/// Sizes, options, whole arrays, and the values of single elements. The length of an array is the size that mjmodel.h documents for it.
impl Model {
    methods! {
        /// Number of generalised positions.
        fn nq(&self) -> usize = self.raw().nq as usize;
        /// Number of generalised velocities.
        fn nv(&self) -> usize = self.raw().nv as usize;
        /// Number of actuators.
        fn nu(&self) -> usize = self.raw().nu as usize;
        /// Capacity of the contact buffer.
        fn nconmax(&self) -> usize = self.raw().nconmax as usize;
        /// Capacity of the constraint buffer \[rows\].
        fn njmax(&self) -> usize = self.raw().njmax as usize;
        /// Number of bodies that are moved from outside.
        fn mocap_count(&self) -> usize = self.raw().nmocap as usize;
        /// Viscous damping of every degree of freedom, shape (nv). [N·m·s/rad]
        fn damping(&self) -> &[f64] = self.slice(self.raw().dof_damping, self.raw().nv);
        /// Reflected rotor inertia of every degree of freedom, shape (nv). [kg·m²]
        fn armature(&self) -> &[f64] = self.slice(self.raw().dof_armature, self.raw().nv);
        /// Coulomb friction of every degree of freedom, shape (nv). [N·m]
        fn friction_loss(&self) -> &[f64] = self.slice(self.raw().dof_frictionloss, self.raw().nv);
        /// Positions that the file puts everything at, shape (nq).
        fn rest_positions(&self) -> &[f64] = self.slice(self.raw().qpos0, self.raw().nq);
        /// Mass of every body, shape (nbody). \[kg\]
        fn body_mass(&self) -> &[f64] = self.slice(self.raw().body_mass, self.raw().nbody);
        /// Index of a joint's first position.
        fn joint_position_index(&self, id: usize) -> usize =
            self.slice(self.raw().jnt_qposadr, self.raw().njnt)[id] as usize;
        /// Index of a joint's first velocity.
        fn joint_velocity_index(&self, id: usize) -> usize =
            self.slice(self.raw().jnt_dofadr, self.raw().njnt)[id] as usize;
        /// Body that a joint moves.
        fn joint_body(&self, id: usize) -> usize = self.slice(self.raw().jnt_bodyid, self.raw().njnt)[id] as usize;
        /// Body of a site.
        fn site_body(&self, id: usize) -> usize = self.slice(self.raw().site_bodyid, self.raw().nsite)[id] as usize;
        /// Body to which a body is attached.
        fn body_parent(&self, id: usize) -> usize = self.slice(self.raw().body_parentid, self.raw().nbody)[id] as usize;
        /// Body of a geometry.
        fn geom_body(&self, id: usize) -> usize = self.slice(self.raw().geom_bodyid, self.raw().ngeom)[id] as usize;
        /// Lower and upper limit of a joint \[rad\].
        fn joint_range(&self, id: usize) -> [f64; 2] = self.row(self.raw().jnt_range, self.raw().njnt, id);
        /// True if a joint has limits.
        fn joint_is_limited(&self, id: usize) -> bool =
            self.slice::<u8>(self.raw().jnt_limited.cast(), self.raw().njnt)[id] != 0;
        /// Spring stiffness of a joint [N·m/rad].
        fn joint_stiffness(&self, id: usize) -> f64 = self.slice(self.raw().jnt_stiffness, self.raw().njnt)[id];
        /// Moments of inertia about the principal axes of a body [kg·m²].
        fn body_inertia(&self, id: usize) -> [f64; 3] = self.row(self.raw().body_inertia, self.raw().nbody, id);
        /// Orientation of the principal axes in a body's frame (w, x, y, z).
        fn body_inertia_quaternion(&self, id: usize) -> [f64; 4] =
            self.row(self.raw().body_iquat, self.raw().nbody, id);
        /// Lower and upper limit of an actuator's control.
        fn control_range(&self, id: usize) -> [f64; 2] = self.row(self.raw().actuator_ctrlrange, self.raw().nu, id);
        /// Centre of mass of a body in its own frame \[m\].
        fn body_centre_of_mass(&self, id: usize) -> [f64; 3] = self.row(self.raw().body_ipos, self.raw().nbody, id);
        /// Origin of a body in the frame of the body above it \[m\].
        fn body_position(&self, id: usize) -> [f64; 3] = self.row(self.raw().body_pos, self.raw().nbody, id);
        /// Where a joint is, in its body's frame \[m\].
        fn joint_anchor(&self, id: usize) -> [f64; 3] = self.row(self.raw().jnt_pos, self.raw().njnt, id);
        /// The unit vector that a hinge turns about, in its body's frame.
        fn joint_axis(&self, id: usize) -> [f64; 3] = self.row(self.raw().jnt_axis, self.raw().njnt, id);
        /// Sizes of a site, as of a geometry of its shape \[m\].
        fn site_size(&self, id: usize) -> [f64; 3] = self.row(self.raw().site_size, self.raw().nsite, id);
        /// Where a site is, in its body's frame \[m\].
        fn site_position(&self, id: usize) -> [f64; 3] = self.row(self.raw().site_pos, self.raw().nsite, id);
        /// True if a joint is a hinge.
        fn is_hinge(&self, id: usize) -> bool =
            self.slice(self.raw().jnt_type, self.raw().njnt)[id] == sys::mjJNT_HINGE as i32;
        /// True if a joint is a free joint, which leaves its body free in space.
        fn is_free(&self, id: usize) -> bool =
            self.slice(self.raw().jnt_type, self.raw().njnt)[id] == sys::mjJNT_FREE as i32;
        /// Index of a body among the mocap bodies; `None` if it is none.
        fn mocap_index(&self, id: usize) -> Option<usize> =
            usize::try_from(self.slice(self.raw().body_mocapid, self.raw().nbody)[id]).ok();
        /// Physics step \[s\].
        fn timestep_s(&self) -> f64 = self.raw().opt.timestep;
        /// Gravity [m/s²], world frame.
        fn gravity(&self) -> [f64; 3] = self.raw().opt.gravity;
        /// Sets gravity [m/s²], world frame. A tilted gravity is a slope.
        fn set_gravity(&mut self, gravity: [f64; 3]) = self.raw_mut().opt.gravity = gravity;
    }
}

impl Model {
    /// Compiles MJCF held in memory: `(name, text)` pairs, the main file first, then the files that it includes.
    ///
    /// # Errors
    /// The XML is invalid, or asks for more memory or time than any scene needs; the error has MuJoCo's message.
    pub fn from_xml(files: &[(&str, &str)]) -> Result<Self> {
        initialise()?;
        let what = files.first().map_or("", |file| file.0).to_owned();
        let failed = |message: String| Error::Load { what: what.clone(), message };
        // 2 MB: on the heap. All-zero bytes are a valid mjVFS.
        // SAFETY: mjVFS holds only integers, character arrays and pointers.
        let mut vfs = unsafe { Box::<sys::mjVFS>::new_zeroed().assume_init() };
        // SAFETY: `vfs` is a valid mjVFS.
        unsafe { sys::mj_defaultVFS(&mut *vfs) };
        let names: Vec<&str> = files.iter().map(|file| file.0).collect();
        let mut add = |name: &str, text: &str| {
            // Later releases take other names, too.
            if name.is_empty() || name.ends_with('/') || name.len() >= 1000 {
                return Err(failed(format!(
                    "'{name}' is no name of a file, expected one such as 'robot.xml', below 1000 bytes"
                )));
            }
            let tree = xml::parse(text).map_err(|error| failed(error.to_string()))?;
            let checked = sizes::check_sizes(&tree).and_then(|()| sizes::check_includes(&tree, &names));
            checked.map_err(|error| failed(error.to_string()))?;
            let size = i32::try_from(text.len()).map_err(|_| failed(format!("{name} is larger than 2 GiB")))?;
            let c_name = CString::new(name).map_err(|_| failed(format!("the name '{name}' holds a zero byte")))?;
            let (mut code, mut message) = (0, EMPTY_MESSAGE);
            let (bytes, error) = (text.as_ptr().cast(), message.as_mut_ptr());
            // SAFETY: `vfs`, the name and `size` bytes of text are valid, and copied; the shim catches errors.
            let caught = unsafe { sys::supple_add_file(&mut *vfs, c_name.as_ptr(), bytes, size, &mut code, error) };
            match (caught, code) {
                (0, 0) => Ok(c_name),
                (0, 1) => Err(failed(format!("there are too many files, at '{name}'"))),
                (0, _) => Err(failed(format!("'{name}' is there twice"))),
                _ => Err(failed(format!("'{name}': {}", text_of(&message)))),
            }
        };
        let added: Result<Vec<CString>> = files.iter().map(|(name, text)| add(name, text)).collect();
        let model = added.and_then(|names| match names.first() {
            Some(main) => load(&what, main, &*vfs),
            None => Err(failed("there is no file to compile".into())),
        });
        // SAFETY: `vfs` is valid and is not used afterwards.
        unsafe { sys::mj_deleteVFS(&mut *vfs) };
        model
    }

    /// Copies the model.
    ///
    /// # Errors
    /// MuJoCo cannot allocate the copy.
    pub fn try_clone(&self) -> Result<Self> {
        let (mut copy, mut message) = (std::ptr::null_mut(), EMPTY_MESSAGE);
        // SAFETY: the source is valid; the shim catches errors.
        let failed = unsafe { sys::supple_copy_model(&mut copy, self.as_ptr(), message.as_mut_ptr()) };
        check("mj_copyModel", failed, &message)?;
        let copy = NonNull::new(copy);
        copy.map(Model).ok_or(Error::Engine { call: "mj_copyModel", message: "no memory".into() })
    }

    pub(super) fn as_ptr(&self) -> *mut sys::mjModel {
        self.0.as_ptr()
    }

    fn raw(&self) -> &sys::mjModel {
        // SAFETY: the pointer is valid as long as `self`.
        unsafe { self.0.as_ref() }
    }

    fn raw_mut(&mut self) -> &mut sys::mjModel {
        // SAFETY: the pointer is valid as long as `self`, which is borrowed mutably.
        unsafe { self.0.as_mut() }
    }

    /// Returns the memory of the model \[bytes\].
    pub(super) fn bytes(&self) -> usize {
        self.raw().nbuffer as usize
    }

    /// Returns the number of elements of a kind.
    #[allow(clippy::useless_conversion)] // later releases count with 64 bits
    pub fn count(&self, kind: Object) -> usize {
        let raw = self.raw();
        (match kind {
            Object::Body => raw.nbody,
            Object::Joint => raw.njnt,
            Object::Geom => raw.ngeom,
            Object::Site => raw.nsite,
            // SAFETY: the model is valid.
            Object::Actuator => unsafe { sys::supple_actuator_count(raw) }.into(),
            Object::Numeric => raw.nnumeric,
            Object::HeightField => raw.nhfield,
            Object::Tendon => raw.ntendon,
        }) as usize
    }

    /// Returns the id of a named element.
    ///
    /// # Errors
    /// The model has no such element; the error lists the names that it has.
    pub fn id(&self, kind: Object, name: &str) -> Result<usize> {
        // No element's name holds a zero byte.
        let id = CString::new(name).map_or(-1, |name| {
            // SAFETY: model and name are valid.
            unsafe { sys::mj_name2id(self.as_ptr(), kind.known().0 as i32, name.as_ptr()) }
        });
        usize::try_from(id).map_err(|_| Error::Name {
            kind: kind.known().1,
            name: name.to_owned(),
            known: (0..self.count(kind)).map(|id| self.name(kind, id)).collect::<Vec<_>>().join(", "),
        })
    }

    /// Returns the ids of N elements, named by index.
    ///
    /// # Errors
    /// The same as those of [`Model::id`].
    pub fn ids<const N: usize>(&self, kind: Object, name: impl Fn(usize) -> String) -> Result<[usize; N]> {
        let mut ids = [0; N];
        ids.iter_mut().enumerate().try_for_each(|(index, id)| self.id(kind, &name(index)).map(|found| *id = found))?;
        Ok(ids)
    }

    /// Returns the name of an element; empty if it has none or does not exist.
    pub fn name(&self, kind: Object, id: usize) -> &str {
        // SAFETY: MuJoCo checks the id's range and returns null for elements without a name.
        let name = unsafe { sys::mj_id2name(self.as_ptr(), kind.known().0 as i32, id as i32) };
        if name.is_null() {
            return "";
        }
        // SAFETY: names are NUL-terminated and live as long as the model.
        unsafe { CStr::from_ptr(name) }.to_str().unwrap_or("")
    }

    /// Returns true if friction cones are elliptic, false if they are pyramids.
    pub(crate) fn has_elliptic_cones(&self) -> bool {
        self.raw().opt.cone == sys::mjCONE_ELLIPTIC as i32
    }

    /// Lets only those geometries touch that the scene names in pairs.
    pub(crate) fn collide_pairs_only(&mut self) {
        // SAFETY: the model is valid and `self` is borrowed mutably.
        unsafe { sys::supple_collide_pairs_only(self.raw_mut()) };
    }

    /// Sets the sliding friction coefficient of a geometry and of the contact pairs that name it, which have their own
    /// coefficient whatever the priorities are.
    ///
    /// # Panics
    /// There is no geometry of this id.
    pub fn set_sliding_friction(&mut self, geom: usize, friction: f64) {
        assert!(geom < self.count(Object::Geom), "geom {geom} out of range");
        let raw = self.raw_mut();
        // SAFETY: geom_friction holds 3 numbers for each geom; the id was checked.
        unsafe { *raw.geom_friction.add(3 * geom) = friction };
        for pair in 0..raw.npair as usize {
            // SAFETY: the arrays hold a geom id, and 5 coefficients of which the first two are sliding, for each pair.
            unsafe {
                if [*raw.pair_geom1.add(pair), *raw.pair_geom2.add(pair)].contains(&(geom as i32)) {
                    *raw.pair_friction.add(5 * pair) = friction;
                    *raw.pair_friction.add(5 * pair + 1) = friction;
                }
            }
        }
    }

    /// Sets the priority of a geometry: in a contact, the geometry with the higher priority sets friction and softness.
    pub(crate) fn set_priority(&mut self, geom: usize, priority: i32) {
        assert!(geom < self.count(Object::Geom), "geom {geom} out of range");
        // SAFETY: geom_priority holds a number for each geom; the id was checked.
        unsafe { *self.raw_mut().geom_priority.add(geom) = priority };
    }

    /// Sets the losses of a hinge: dry friction [N·m] and viscous damping [N·m·s/rad].
    ///
    /// # Panics
    /// There is no joint of this id.
    pub fn set_losses(&mut self, joint: usize, friction: f64, damping: f64) {
        let dof = self.joint_velocity_index(joint);
        // SAFETY: both hold a number for each degree of freedom, of which a joint's first is one.
        unsafe {
            *self.raw_mut().dof_frictionloss.add(dof) = friction;
            *self.raw_mut().dof_damping.add(dof) = damping;
        }
    }

    /// Adds mass to a body \[kg\], spread as its own is: its inertia grows in proportion, and its centre of mass stays.
    pub(crate) fn add_mass(&mut self, body: usize, mass_kg: f64) -> Result<()> {
        let factor = self.mass_factor(body, self.body_mass()[body], mass_kg)?;
        let carriers: Vec<usize> = self.carriers(body).collect();
        let raw = self.raw_mut();
        // SAFETY: the arrays hold one mass, one subtree's mass and three moments of inertia for each body.
        unsafe {
            *raw.body_mass.add(body) *= factor;
            (0..3).for_each(|axis| *raw.body_inertia.add(3 * body + axis) *= factor);
            carriers.into_iter().for_each(|carrier| *raw.body_subtreemass.add(carrier) += mass_kg);
        }
        Ok(())
    }

    /// Returns the factor of a body's mass and inertia if `more_kg` is added to `own_kg`.
    fn mass_factor(&self, body: usize, own_kg: f64, more_kg: f64) -> Result<f64> {
        let factor = 1.0 + more_kg / own_kg;
        let what = || format!("mass to add to {}, of {own_kg:.2} kg", self.name(Object::Body, body));
        let refused = || Error::Input { what: what(), found: format!("{more_kg} kg") };
        Some(factor).filter(|factor| *factor > 0.0 && factor.is_finite()).ok_or_else(refused)
    }

    /// Iterates over a body and those that carry it, up to the world.
    fn carriers(&self, body: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(Some(body), |it| (*it > 0).then(|| self.body_parent(*it)))
    }

    /// Returns the mass of a body and of the subtrees that it belongs to.
    ///
    /// # Panics
    /// There is no body of this id.
    pub fn inertial(&self, body: usize) -> Inertial {
        let raw = self.raw();
        let subtrees = self.slice(raw.body_subtreemass, raw.nbody);
        let centre_m = self.body_centre_of_mass(body);
        let subtrees_kg = self.carriers(body).map(|carrier| (carrier, subtrees[carrier])).collect();
        Inertial { mass_kg: self.body_mass()[body], moments: self.body_inertia(body), centre_m, subtrees_kg }
    }

    /// Gives a body more or less mass than `own` \[kg\], spread as its own is, and displaces its centre of mass in the
    /// body's frame \[m\]. Zero restores the nominal bits.
    pub(crate) fn set_inertial(&mut self, body: usize, own: &Inertial, mass_kg: f64, offset_m: [f64; 3]) -> Result<()> {
        let factor = self.mass_factor(body, own.mass_kg, mass_kg)?;
        assert!(body < self.count(Object::Body), "body {body} out of range");
        let geoms: Vec<usize> = (0..self.count(Object::Geom)).filter(|geom| self.geom_body(*geom) == body).collect();
        let sites: Vec<usize> = (0..self.count(Object::Site)).filter(|site| self.site_body(*site) == body).collect();
        let raw = self.raw_mut();
        // SAFETY: the arrays hold one mass, one subtree's mass, three moments and three coordinates for each body, and one
        // flag for each body, geometry and site. A flag says that frames coincide, which saves a rotation; they no longer do.
        unsafe {
            *raw.body_mass.add(body) = factor * own.mass_kg;
            for (axis, offset) in offset_m.into_iter().enumerate() {
                *raw.body_inertia.add(3 * body + axis) = factor * own.moments[axis];
                *raw.body_ipos.add(3 * body + axis) = own.centre_m[axis] + offset;
            }
            for (carrier, subtree_kg) in &own.subtrees_kg {
                *raw.body_subtreemass.add(*carrier) = subtree_kg + mass_kg;
            }
            *raw.body_sameframe.add(body) = 0;
            geoms.into_iter().for_each(|geom| *raw.geom_sameframe.add(geom) = 0);
            sites.into_iter().for_each(|site| *raw.site_sameframe.add(site) = 0);
        }
        Ok(())
    }

    /// Sets the maximum length of a limited tendon \[m\].
    pub(crate) fn set_longest_tendon(&mut self, tendon: usize, length_m: f64) {
        assert!(tendon < self.count(Object::Tendon), "tendon {tendon} out of range");
        // SAFETY: tendon_range holds 2 numbers for each tendon; the id was checked.
        unsafe { *self.raw_mut().tendon_range.add(2 * tendon + 1) = length_m };
    }

    /// Returns the effect of an actuator.
    pub fn actuator(&self, id: usize) -> Actuator {
        let raw = self.raw();
        let count = self.count(Object::Actuator) as i64;
        let on_joint = self.slice(raw.actuator_trntype, count)[id] == sys::mjTRN_JOINT as i32;
        let target = self.slice(raw.actuator_trnid, 2 * count)[2 * id];
        let limits = |limited: *const u8, range: *const f64| {
            (self.slice(limited, count)[id] != 0).then(|| self.row(range, count, id))
        };
        Actuator {
            joint: usize::try_from(target).ok().filter(|_| on_joint),
            gear: self.slice(raw.actuator_gear, 6 * count)[6 * id],
            gain: self.slice(raw.actuator_gainprm, i64::from(sys::mjNGAIN) * count)[sys::mjNGAIN as usize * id],
            has_bias: self.slice(raw.actuator_biastype, count)[id] != sys::mjBIAS_NONE as i32,
            control_range: limits(raw.actuator_ctrllimited.cast(), raw.actuator_ctrlrange),
            force_range: limits(raw.actuator_forcelimited.cast(), raw.actuator_forcerange),
        }
    }

    /// Returns the contact parameters of a geometry.
    pub fn geom_contact(&self, id: usize) -> GeomContact {
        let raw = self.raw();
        GeomContact {
            contype: self.slice(raw.geom_contype, raw.ngeom)[id],
            conaffinity: self.slice(raw.geom_conaffinity, raw.ngeom)[id],
            condim: self.slice(raw.geom_condim, raw.ngeom)[id],
            priority: self.slice(raw.geom_priority, raw.ngeom)[id],
            friction: self.row(raw.geom_friction, raw.ngeom, id),
            solimp: self.row(raw.geom_solimp, raw.ngeom, id),
        }
    }

    /// Returns the corners of a mesh in the frame of a geometry that has its shape, shape (n, 3) \[m\].
    pub(crate) fn mesh_vertices(&self, mesh: usize) -> &[f32] {
        let raw = self.raw();
        let start = 3 * self.slice(raw.mesh_vertadr, raw.nmesh)[mesh] as usize;
        let length = 3 * self.slice(raw.mesh_vertnum, raw.nmesh)[mesh] as usize;
        &self.slice(raw.mesh_vert, 3 * raw.nmeshvert)[start..start + length]
    }

    /// Returns true if a body is `ancestor` or a descendant of it.
    pub fn is_below(&self, mut body: usize, ancestor: usize) -> bool {
        while body != 0 && body != ancestor {
            body = self.body_parent(body);
        }
        body == ancestor
    }

    /// Returns the positions of the keyframe `home`, or else of the first keyframe, shape (nq).
    pub fn keyframe(&self) -> Option<&[f64]> {
        // SAFETY: model and name are valid.
        let home = unsafe { sys::mj_name2id(self.as_ptr(), sys::mjOBJ_KEY as i32, c"home".as_ptr()) };
        let mut all = self.slice(self.raw().key_qpos, self.raw().nkey * self.raw().nq).chunks(self.nq().max(1));
        all.nth(usize::try_from(home).unwrap_or(0))
    }

    /// Returns the rotation from a body's frame to its parent's frame.
    pub(crate) fn body_rotation(&self, body: usize) -> UnitQuaternion<f64> {
        unit(self.row(self.raw().body_quat, self.raw().nbody, body))
    }

    /// Returns all data for drawing a geometry.
    pub fn geom(&self, id: usize) -> Geom {
        let raw = self.raw();
        let mesh = self.slice(raw.geom_dataid, raw.ngeom)[id].max(0) as usize;
        let shape = match self.slice(raw.geom_type, raw.ngeom)[id] as u32 {
            sys::mjGEOM_PLANE => GeomShape::Plane,
            sys::mjGEOM_HFIELD => GeomShape::HeightField(mesh),
            sys::mjGEOM_SPHERE => GeomShape::Sphere,
            sys::mjGEOM_CAPSULE => GeomShape::Capsule,
            sys::mjGEOM_ELLIPSOID => GeomShape::Ellipsoid,
            sys::mjGEOM_CYLINDER => GeomShape::Cylinder,
            sys::mjGEOM_BOX => GeomShape::Box,
            _ => GeomShape::Mesh(mesh),
        };
        let mut rgba = self.row(raw.geom_rgba, raw.ngeom, id);
        let material = self.slice(raw.geom_matid, raw.ngeom)[id];
        // MuJoCo's rule: the material's colour holds unless the geom sets its own.
        if material >= 0 && rgba == [0.5, 0.5, 0.5, 1.0] {
            rgba = self.row(raw.mat_rgba, raw.nmat, material as usize);
        }
        let (name, size) = (self.name(Object::Geom, id).to_owned(), self.row(raw.geom_size, raw.ngeom, id));
        let (position, quaternion) = (self.row(raw.geom_pos, raw.ngeom, id), self.row(raw.geom_quat, raw.ngeom, id));
        let group = self.slice(raw.geom_group, raw.ngeom)[id];
        Geom { name, body: self.geom_body(id), shape, size, position, quaternion, rgba, group }
    }

    /// Sets the colour and opacity of a geometry in pictures, 0 to 1, and whether it is drawn at all.
    ///
    /// # Panics
    /// There is no geometry of this id.
    pub fn set_look(&mut self, geom: usize, rgba: [f32; 4], is_drawn: bool) {
        assert!(geom < self.count(Object::Geom), "geom {geom} out of range");
        let raw = self.raw_mut();
        // SAFETY: the arrays hold four numbers and one group for each geom; the id was checked. Groups from 3 are not drawn.
        unsafe {
            *raw.geom_group.add(geom) = if is_drawn { 0 } else { 3 };
            (0..4).for_each(|part| *raw.geom_rgba.add(4 * geom + part) = rgba[part]);
        }
    }

    /// Returns rows, columns, and (half-length x, half-length y, height of elevation 1, base depth) \[m\] of a height
    /// field.
    pub fn height_field_size(&self, id: usize) -> (usize, usize, [f64; 4]) {
        let raw = self.raw();
        let rows = self.slice(raw.hfield_nrow, raw.nhfield)[id] as usize;
        let columns = self.slice(raw.hfield_ncol, raw.nhfield)[id] as usize;
        (rows, columns, self.row(raw.hfield_size, raw.nhfield, id))
    }

    /// Returns the elevations of a height field from 0 to 1, row-major, y rows by x columns.
    pub fn height_field(&self, id: usize) -> &[f32] {
        let raw = self.raw();
        let start = self.slice(raw.hfield_adr, raw.nhfield)[id] as usize;
        let (rows, columns, _) = self.height_field_size(id);
        &self.slice(raw.hfield_data, raw.nhfielddata)[start..start + rows * columns]
    }

    /// Like [`Model::height_field`], but writable before the first step.
    pub(crate) fn height_field_mut(&mut self, id: usize) -> &mut [f32] {
        let start = self.slice(self.raw().hfield_adr, self.raw().nhfield)[id] as usize;
        let (rows, columns, _) = self.height_field_size(id);
        let raw = self.raw_mut();
        // SAFETY: the compiler has allocated rows·columns floats at `start`; `self` is borrowed mutably.
        unsafe { std::slice::from_raw_parts_mut(raw.hfield_data.add(start), rows * columns) }
    }

    /// Returns the numbers of a `<custom><numeric>` field.
    ///
    /// # Errors
    /// The model has no field of this name; the error lists the names that it has.
    pub fn numeric(&self, name: &str) -> Result<&[f64]> {
        let id = self.id(Object::Numeric, name)?;
        let raw = self.raw();
        let start = self.slice(raw.numeric_adr, raw.nnumeric)[id] as usize;
        let size = self.slice(raw.numeric_size, raw.nnumeric)[id] as usize;
        Ok(&self.slice(raw.numeric_data, raw.nnumericdata)[start..start + size])
    }

    /// Returns a row of a model array, shape (count, N).
    fn row<T: Copy, const N: usize>(&self, start: *const T, count: impl Into<i64>, id: usize) -> [T; N] {
        let values = self.slice(start, N as i64 * count.into());
        std::array::from_fn(|k| values[N * id + k])
    }

    /// Borrows a model array as a slice. MuJoCo counts with 32 bits, later with 64.
    fn slice<T>(&self, start: *const T, length: impl Into<i64>) -> &[T] {
        let length = length.into();
        if length == 0 || start.is_null() {
            return &[];
        }
        // SAFETY: callers pass a field of this model with the length that mjmodel.h documents for it.
        unsafe { std::slice::from_raw_parts(start, length as usize) }
    }
}

/// Fault injection for tests.
#[cfg(test)]
impl Model {
    /// Shrinks the contact buffer to `contacts` points.
    #[allow(clippy::useless_conversion)] // later releases count with 64 bits
    pub(crate) fn limit_contacts(&mut self, contacts: i32) {
        assert!(contacts as usize <= self.nconmax());
        self.raw_mut().nconmax = contacts.into();
    }
}

fn load(what: &str, file: &CStr, vfs: *const sys::mjVFS) -> Result<Model> {
    /// True if MuJoCo's XML reader was left with its lock held by a fatal error: waiting for it would never end.
    static LOCKED: AtomicBool = AtomicBool::new(false);
    let failed = |message: String| Error::Load { what: what.to_owned(), message };
    if LOCKED.load(Ordering::Acquire) {
        return Err(failed("its reader ran out of memory before; start the program again".into()));
    }
    let (mut model, mut message) = (std::ptr::null_mut(), EMPTY_MESSAGE);
    // SAFETY: file name and vfs are valid; the shim catches errors.
    let caught = unsafe { sys::supple_load_xml(&mut model, file.as_ptr(), vfs, message.as_mut_ptr()) };
    if caught != 0 {
        LOCKED.store(true, Ordering::Release);
        return Err(failed(text_of(&message)));
    }
    // SAFETY: MuJoCo keeps the last parsed XML in a global; this is its only user.
    unsafe { sys::mj_freeLastXML() };
    NonNull::new(model).map(Model).ok_or_else(|| failed(text_of(&message)))
}
