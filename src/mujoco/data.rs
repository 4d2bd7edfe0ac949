//! The state of one simulation, together with the model that it belongs to.

use std::ptr::NonNull;

use mujoco_sys as sys;

use super::error::{Buffer, Error, Result, StateKind};
use super::model::{Kind, Model};
use super::{EMPTY_MESSAGE, Message, check};

/// A contact point that MuJoCo found in its last position stage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Index among the contacts, for [`Data::contact_force`].
    pub index: usize,
    /// The two geometries, ordered by MuJoCo's shape types (plane, height field, sphere, capsule, …, box).
    pub geoms: [usize; 2],
    /// Contact point, world frame. \[m\]
    pub position: [f64; 3],
    /// Signed distance, negative when penetrating. \[m\]
    pub distance: f64,
}

/// An owned `mjData` and its [`Model`]: one independent simulation.
///
/// Owning the model, and lending it to be read only, makes it impossible to step data with a model of another size, and
/// lets every environment have its own gravity and friction (a model without meshes is a few ten kilobytes).
#[derive(Debug)]
pub struct Data {
    raw: NonNull<sys::mjData>,
    model: Model,
    /// MuJoCo has left a call in the middle, through its fatal error handler.
    broken: bool,
}

// SAFETY: an mjData is plain memory, used by one thread at a time through `&mut`.
unsafe impl Send for Data {}
// SAFETY: shared references only read.
unsafe impl Sync for Data {}

impl Drop for Data {
    fn drop(&mut self) {
        // SAFETY: the pointer is owned and came from MuJoCo.
        unsafe { sys::mj_deleteData(self.raw.as_ptr()) }
    }
}

/// Fields of mjData as slices: name, name of the writable variant if there is one, length.
macro_rules! fields {
    ($($(#[$doc:meta])* $name:ident $(/ $name_mut:ident)? = $field:ident [$length:expr];)*) => {
        impl Data {$(
            $(#[$doc])*
            pub fn $name(&self) -> &[f64] {
                let length: fn(&Model) -> usize = $length;
                // SAFETY: mjdata.h documents this length for the field; the memory lives as long as `self`.
                unsafe { std::slice::from_raw_parts(self.raw().$field, length(&self.model)) }
            }
            $(
                #[doc = concat!("[`Data::", stringify!($name), "`], writable.")]
                pub fn $name_mut(&mut self) -> &mut [f64] {
                    let length: fn(&Model) -> usize = $length;
                    // SAFETY: as above, and `self` is borrowed mutably.
                    unsafe { std::slice::from_raw_parts_mut(self.raw().$field, length(&self.model)) }
                }
            )?
        )*}
    };
}

fields! {
    /// Generalised positions, shape (nq). A free joint's are position (world) \[m\] and quaternion (w, x, y, z).
    positions / positions_mut = qpos[Model::nq];
    /// Generalised velocities, shape (nv). A free joint's are linear (world frame) [m/s] and angular (body frame) [rad/s].
    velocities / velocities_mut = qvel[Model::nv];
    /// Accelerations that warm-start the constraint solver, shape (nv). Part of the state for exact resumption.
    warm_start / warm_start_mut = qacc_warmstart[Model::nv];
    /// Generalised accelerations, shape (nv): those of the last step, or what [`Data::inverse_dynamics`] starts from.
    accelerations / accelerations_mut = qacc[Model::nv];
    /// Generalised forces of the last [`Data::inverse_dynamics`], shape (nv).
    inverse_forces = qfrc_inverse[Model::nv];
    /// Points that hinges turn about, world frame, shape (njnt, 3). \[m\]
    joint_anchors = xanchor[|m| 3 * m.count(Kind::Joint)];
    /// Axes of hinges, world frame, unit vectors, shape (njnt, 3).
    joint_axes = xaxis[|m| 3 * m.count(Kind::Joint)];
    /// Actuator controls, shape (nu).
    controls / controls_mut = ctrl[Model::nu];
    /// Applied force and torque on each body at its centre of mass, world frame, shape (nbody, 6). Persists. [N, N·m]
    applied_forces / applied_forces_mut = xfrc_applied[|m| 6 * m.count(Kind::Body)];
    /// Body frame origins, world frame, shape (nbody, 3). \[m\]
    body_positions = xpos[|m| 3 * m.count(Kind::Body)];
    /// Body orientations (w, x, y, z), shape (nbody, 4).
    body_quaternions = xquat[|m| 4 * m.count(Kind::Body)];
    /// Geometry centres, world frame, shape (ngeom, 3). \[m\]
    geom_positions = geom_xpos[|m| 3 * m.count(Kind::Geom)];
    /// Sites, world frame, shape (nsite, 3). \[m\]
    site_positions = site_xpos[|m| 3 * m.count(Kind::Site)];
    /// Positions of the bodies that are moved from outside, shape (nmocap, 3). \[m\]
    mocap_positions / mocap_positions_mut = mocap_pos[|m| 3 * m.mocap_count()];
    /// Lengths of tendons as of the last first half-step, shape (ntendon). \[m\]
    tendon_lengths = ten_length[|m| m.count(Kind::Tendon)];
    /// Rates of the lengths of tendons as of the last first half-step, shape (ntendon). [m/s]
    tendon_velocities = ten_velocity[|m| m.count(Kind::Tendon)];
}

impl Data {
    /// Allocates a simulation in the model's reference configuration.
    ///
    /// # Errors
    /// [`Error::Engine`] if MuJoCo cannot allocate it.
    pub fn new(model: Model) -> Result<Self> {
        Ok(Data { raw: allocate(&model)?, model, broken: false })
    }

    /// Memory that it takes, with its model \[bytes\].
    pub fn bytes(&self) -> usize {
        let raw = self.raw();
        self.model.bytes() + raw.nbuffer as usize + raw.nstack as usize * size_of::<f64>()
    }

    /// The model.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// See [`Model::set_gravity`].
    pub fn set_gravity(&mut self, gravity: [f64; 3]) {
        self.model.set_gravity(gravity);
    }

    /// See [`Model::set_sliding_friction`].
    ///
    /// # Panics
    /// If there is no geometry of this id.
    pub fn set_sliding_friction(&mut self, geom: usize, friction: f64) {
        self.model.set_sliding_friction(geom, friction);
    }

    /// See [`Model::set_longest_tendon`].
    ///
    /// # Panics
    /// If there is no tendon of this id.
    pub fn set_longest_tendon(&mut self, tendon: usize, length_m: f64) {
        self.model.set_longest_tendon(tendon, length_m);
    }

    /// Makes the contact buffer smaller.
    #[cfg(test)]
    pub(crate) fn limit_contacts(&mut self, contacts: i32) {
        self.model.limit_contacts(contacts);
    }

    fn raw(&self) -> &sys::mjData {
        // SAFETY: the pointer is valid as long as `self`.
        unsafe { self.raw.as_ref() }
    }

    /// Simulation time \[s\].
    pub fn time_s(&self) -> f64 {
        self.raw().time
    }

    /// Sets the simulation time \[s\].
    pub fn set_time_s(&mut self, time_s: f64) {
        // SAFETY: the pointer is valid and `self` is borrowed mutably.
        unsafe { self.raw.as_mut() }.time = time_s;
    }

    /// Back to the reference configuration at rest, time 0, all warnings cleared. After a fatal error inside MuJoCo,
    /// which leaves its data in the middle of something, they are made anew.
    ///
    /// # Errors
    /// [`Error::Engine`] if MuJoCo reports a fatal error.
    pub fn reset(&mut self) -> Result<()> {
        if self.broken {
            let left = std::mem::replace(&mut self.raw, allocate(&self.model)?);
            // SAFETY: the pointer was owned, came from MuJoCo, and is not used afterwards.
            unsafe { sys::mj_deleteData(left.as_ptr()) };
            self.broken = false;
        }
        self.call("mj_resetData", sys::supple_reset_data)
    }

    /// First half of a step: everything that follows from positions and velocities (kinematics, contacts, bias forces).
    ///
    /// # Errors
    /// Any fault that MuJoCo reports, see [`Error`].
    pub fn step1(&mut self) -> Result<()> {
        self.call("mj_step1", sys::supple_step1)
    }

    /// Second half of a step: actuation, constraint forces, integration. Contact forces are readable afterwards, until
    /// the next [`Data::step1`].
    ///
    /// # Errors
    /// Any fault that MuJoCo reports, see [`Error`].
    pub fn step2(&mut self) -> Result<()> {
        self.call("mj_step2", sys::supple_step2)
    }

    /// A whole step.
    ///
    /// # Errors
    /// Any fault that MuJoCo reports, see [`Error`].
    pub fn step(&mut self) -> Result<()> {
        self.call("mj_step", sys::supple_step)
    }

    /// Writes the generalised forces that give the present accelerations in the present state to
    /// [`Data::inverse_forces`], and places bodies, joints and geometries: `M a + h` by the recursive Newton-Euler
    /// algorithm. Armature, losses, motors and contacts are left out.
    ///
    /// # Errors
    /// Any fault that MuJoCo reports, see [`Error`].
    pub fn inverse_dynamics(&mut self) -> Result<()> {
        self.call("mj_rne", sys::supple_rne)
    }

    fn call(
        &mut self,
        name: &'static str,
        function: unsafe extern "C" fn(*const sys::mjModel, *mut sys::mjData, *mut std::ffi::c_char) -> i32,
    ) -> Result<()> {
        let mut message: Message = EMPTY_MESSAGE;
        // SAFETY: model and data are valid and belong together; the shim catches errors.
        let failed = unsafe { function(self.model.as_ptr(), self.raw.as_ptr(), message.as_mut_ptr()) };
        self.broken |= failed != 0;
        check(name, failed, &message)?;
        self.check_warnings()
    }

    /// Any counter above zero is a fault: MuJoCo resets an unstable simulation silently and then sets its counter to 1,
    /// so that a difference between two steps would not show it.
    fn check_warnings(&self) -> Result<()> {
        let warnings = &self.raw().warning;
        if warnings.iter().all(|warning| warning.number == 0) {
            return Ok(());
        }
        let unstable = [
            (sys::mjWARN_BADQPOS, StateKind::Position),
            (sys::mjWARN_BADQVEL, StateKind::Velocity),
            (sys::mjWARN_BADQACC, StateKind::Acceleration),
            (sys::mjWARN_BADCTRL, StateKind::Control),
            (sys::mjWARN_INERTIA, StateKind::Inertia),
        ];
        for (warning, kind) in unstable {
            let warning = &warnings[warning as usize];
            if warning.number > 0 {
                return Err(Error::Unstable { kind, index: warning.lastinfo });
            }
        }
        if warnings[sys::mjWARN_CONTACTFULL as usize].number > 0 {
            return Err(Error::BufferFull { buffer: Buffer::Contacts, size: self.model.nconmax() });
        }
        Err(Error::BufferFull { buffer: Buffer::Constraints, size: self.model.njmax() })
    }

    /// Number of contact points.
    pub fn contact_count(&self) -> usize {
        self.raw().ncon as usize
    }

    /// The contact points of the last first half-step that take part in the dynamics.
    pub fn contacts(&self) -> impl Iterator<Item = Contact> + '_ {
        // SAFETY: `contact` holds `ncon` initialised contacts.
        let contacts = unsafe { std::slice::from_raw_parts(self.raw().contact, self.contact_count()) };
        contacts.iter().enumerate().filter(|(_, contact)| contact.exclude == 0).map(|(index, contact)| Contact {
            index,
            geoms: [contact.geom1 as usize, contact.geom2 as usize],
            position: contact.pos,
            distance: contact.dist,
        })
    }

    /// Force on the second geometry of a contact by the first, world frame \[N\]. Valid after [`Data::step2`] and before
    /// the next [`Data::step1`].
    ///
    /// # Panics
    /// If there is no contact of this index.
    pub fn contact_force(&self, index: usize) -> [f64; 3] {
        assert!(index < self.contact_count(), "contact {index} out of range");
        let (mut in_contact, mut message) = ([0.0; 6], EMPTY_MESSAGE);
        // SAFETY: model and data belong together, the index was checked, the result holds 6 numbers.
        let failed = unsafe {
            sys::supple_contact_force(
                self.model.as_ptr(),
                self.raw.as_ptr(),
                index as i32,
                in_contact.as_mut_ptr(),
                message.as_mut_ptr(),
            )
        };
        debug_assert_eq!(failed, 0, "mj_contactForce fails only on a bad index");
        // SAFETY: `index` is below `ncon`.
        let frame = unsafe { (*self.raw().contact.add(index)).frame };
        // Rows of `frame` are the contact axes in the world, the first along the normal from geom 1 to geom 2.
        std::array::from_fn(|k| (0..3).map(|axis| frame[3 * axis + k] * in_contact[axis]).sum())
    }

    /// Force with which a tendon that has reached its longest pulls its ends together \[N\], zero while it is slack.
    /// Valid after [`Data::step2`] and before the next [`Data::step1`].
    pub fn tendon_limit_force(&self, tendon: usize) -> f64 {
        let raw = self.raw();
        let rows = raw.nefc as usize;
        if rows == 0 {
            return 0.0;
        }
        // SAFETY: the first `nefc` elements of the three arrays are the constraints of the last first half-step.
        let (kinds, ids, forces) = unsafe {
            (
                std::slice::from_raw_parts(raw.efc_type, rows),
                std::slice::from_raw_parts(raw.efc_id, rows),
                std::slice::from_raw_parts(raw.efc_force, rows),
            )
        };
        let is_its_limit = |row: &usize| {
            kinds[*row] as u32 == sys::mjCNSTR_LIMIT_TENDON && usize::try_from(ids[*row]).is_ok_and(|id| id == tendon)
        };
        (0..rows).filter(is_its_limit).map(|row| forces[row]).sum()
    }

    /// Velocity of a geometry's centre, world axes [m/s].
    ///
    /// # Panics
    /// If there is no geometry of this id.
    pub fn geom_velocity(&self, geom: usize) -> [f64; 3] {
        assert!(geom < self.model.count(Kind::Geom), "geom {geom} out of range");
        let (mut velocity, mut message) = ([0.0; 6], EMPTY_MESSAGE);
        // SAFETY: model and data belong together, the id was checked, the result holds 6 numbers (angular, linear).
        let failed = unsafe {
            sys::supple_object_velocity(
                self.model.as_ptr(),
                self.raw.as_ptr(),
                sys::mjOBJ_GEOM as i32,
                geom as i32,
                velocity.as_mut_ptr(),
                0,
                message.as_mut_ptr(),
            )
        };
        debug_assert_eq!(failed, 0, "mj_objectVelocity fails only on a bad id");
        [velocity[3], velocity[4], velocity[5]]
    }
}

fn allocate(model: &Model) -> Result<NonNull<sys::mjData>> {
    let (mut data, mut message) = (std::ptr::null_mut(), EMPTY_MESSAGE);
    // SAFETY: the model is valid; the shim catches errors.
    let failed = unsafe { sys::supple_make_data(&mut data, model.as_ptr(), message.as_mut_ptr()) };
    check("mj_makeData", failed, &message)?;
    NonNull::new(data).ok_or(Error::Engine { call: "mj_makeData", message: "no memory".into() })
}

/// Faults on demand.
#[cfg(test)]
impl Data {
    /// Makes MuJoCo's stack so small that the next step raises a fatal error inside it.
    pub(crate) fn exhaust_stack(&mut self) {
        // SAFETY: the pointer is valid and `self` is borrowed mutably; less than what is allocated is always safe.
        unsafe { self.raw.as_mut() }.nstack = 8;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mujoco::Model;

    const BALL: &str = r#"<mujoco>
  <size nconmax="4" njmax="40"/>
  <worldbody>
    <geom name="floor" type="plane" size="1 1 1"/>
    <body name="ball" pos="0 0 0.1"><freejoint name="ball"/><geom name="ball" size="0.1" mass="1"/></body>
  </worldbody>
</mujoco>"#;

    fn ball() -> Data {
        Data::new(Model::from_xml(&[("ball.xml", BALL)]).unwrap()).unwrap()
    }

    #[test]
    fn a_resting_ball_is_carried_by_its_weight() {
        let mut data = ball();
        for _ in 0..500 {
            data.step1().unwrap();
            data.step2().unwrap();
        }
        let force = data.contact_force(data.contacts().next().unwrap().index);
        // The floor is the first geometry: the force is on the ball, upwards, 1 kg · 9.81 m/s².
        assert!((force[2] - 9.81).abs() < 1e-3 && force[0].abs() < 1e-6 && force[1].abs() < 1e-6, "{force:?}");
    }

    #[test]
    fn numbers_that_are_not_finite_are_an_error_and_not_a_silent_reset() {
        for _ in 0..2 {
            let mut data = ball();
            data.velocities_mut()[2] = f64::NAN;
            let error = data.step().unwrap_err();
            assert_eq!(error, Error::Unstable { kind: StateKind::Velocity, index: 2 });
            // MuJoCo's own reset has zeroed its counters once; the next fault must show as well.
            data.reset().unwrap();
            data.positions_mut()[0] = f64::INFINITY;
            assert!(matches!(data.step1(), Err(Error::Unstable { kind: StateKind::Position, .. })));
        }
    }

    #[test]
    fn a_full_buffer_is_an_error_that_names_it() {
        let bodies: String = (0..6)
            .map(|k| {
                format!(
                    r#"<body name="b{k}" pos="{k} 0 0.1"><freejoint name="b{k}"/><geom name="b{k}" size="0.1"/></body>"#
                )
            })
            .collect();
        let xml = BALL.replace("</worldbody>", &format!("{bodies}</worldbody>"));
        // Compiling already runs the contacts of the reference pose: lift the balls there, drop them here.
        let xml = xml.replace("0 0.1\"", "0 1\"");
        let mut data = Data::new(Model::from_xml(&[("balls.xml", &xml)]).unwrap()).unwrap();
        for ball in 0..7 {
            data.positions_mut()[7 * ball + 2] = 0.09;
        }
        let error = data.step1().unwrap_err();
        assert_eq!(error, Error::BufferFull { buffer: Buffer::Contacts, size: 4 });
        assert!(error.to_string().contains("nconmax"));
    }

    #[test]
    fn after_a_fatal_error_inside_mujoco_a_reset_makes_the_data_anew() {
        let mut data = ball();
        let mut other = ball();
        data.exhaust_stack();
        let error = data.step().unwrap_err();
        assert!(matches!(&error, Error::Engine { call: "mj_step", message } if message == "Stack overflow"), "{error}");
        data.reset().unwrap();
        for _ in 0..100 {
            data.step().unwrap();
            other.step().unwrap();
        }
        assert_eq!(data.positions(), other.positions());
    }

    #[test]
    fn a_contact_that_explodes_is_an_error() {
        let mut data = ball();
        // A million kilometres below the floor: the contact pushes back with more than 1e10 m/s².
        data.positions_mut()[2] = -1e9;
        let error = (0..10).find_map(|_| data.step().err()).unwrap();
        assert!(matches!(error, Error::Unstable { .. }), "{error}");
        data.reset().unwrap();
        data.step().unwrap();
    }

    #[test]
    fn simulations_on_several_threads_do_not_disturb_one_another() {
        let run = |fault: bool| {
            let mut data = ball();
            data.velocities_mut()[0] = 1.0;
            for step in 0..1000 {
                if fault && step % 100 == 50 {
                    data.velocities_mut()[0] = f64::NAN;
                    assert!(data.step().is_err());
                    data.reset().unwrap();
                }
                data.step().unwrap();
            }
            data.positions().to_vec()
        };
        let alone = run(false);
        let workers: Vec<_> = (0..4).map(|k| std::thread::spawn(move || run(k % 2 == 1))).collect();
        let results: Vec<_> = workers.into_iter().map(|worker| worker.join().unwrap()).collect();
        assert_eq!(results[0], alone);
        assert_eq!(results[2], alone);
    }
}
