//! The state of one simulation, together with its model.

use std::ptr::NonNull;

use mujoco_sys as sys;
use nalgebra::Isometry3;

use super::error::{Error, Result};
use super::model::{Inertial, Model, Object};
use super::{EMPTY_MESSAGE, check, unit};

/// A contact point found by MuJoCo's last position stage.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Contact {
    /// Index among the contacts, for `contact_force`.
    pub index: usize,
    /// The two geometries, ordered by MuJoCo's shape types (plane, height field, sphere, capsule, …, box).
    pub geoms: [usize; 2],
    /// Contact point, world frame. \[m\]
    pub position: [f64; 3],
    /// Signed distance, negative when penetrating. \[m\]
    pub distance: f64,
}

/// A simulation: an owned `mjData` and its [`Model`].
///
/// Each simulation owns its model, so data cannot be stepped with a model of another size, and every environment can
/// have its own gravity and friction. A model without meshes is a few ten kilobytes.
#[derive(Debug)]
pub struct Data {
    raw: NonNull<sys::mjData>,
    model: Model,
    /// True after a fatal error, which leaves `mjData` in an undefined state.
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

/// The model, the fields of mjData as slices, and the parameters of the model that an episode may change.
impl Data {
    methods! {
        /// The model.
        fn model(&self) -> &Model = &self.model;
        /// Simulation time \[s\].
        fn time_s(&self) -> f64 = self.raw().time;
        /// Number of contact points.
        fn contact_count(&self) -> usize = self.raw().ncon as usize;
        /// Generalised positions, shape (nq). A free joint's are position (world) \[m\] and quaternion (w, x, y, z).
        fn positions(&self) -> &[f64] = self.slice(self.raw().qpos, self.model.nq());
        /// [`Data::positions`], writable.
        fn positions_mut(&mut self) -> &mut [f64] = self.slice_mut(self.raw().qpos, self.model.nq());
        /// Generalised velocities, shape (nv). A free joint's are linear (world frame) [m/s] and angular (body frame) [rad/s].
        fn velocities(&self) -> &[f64] = self.slice(self.raw().qvel, self.model.nv());
        /// [`Data::velocities`], writable.
        fn velocities_mut(&mut self) -> &mut [f64] = self.slice_mut(self.raw().qvel, self.model.nv());
        /// Accelerations that warm-start the constraint solver, shape (nv). Part of the state for exact resumption.
        fn warm_start(&self) -> &[f64] = self.slice(self.raw().qacc_warmstart, self.model.nv());
        /// [`Data::warm_start`], writable.
        fn warm_start_mut(&mut self) -> &mut [f64] = self.slice_mut(self.raw().qacc_warmstart, self.model.nv());
        /// Generalised accelerations, shape (nv): those of the last step, or what [`Data::inverse_dynamics`] starts from.
        fn accelerations_mut(&mut self) -> &mut [f64] = self.slice_mut(self.raw().qacc, self.model.nv());
        /// Generalised forces of the last [`Data::inverse_dynamics`], shape (nv).
        fn inverse_forces(&self) -> &[f64] = self.slice(self.raw().qfrc_inverse, self.model.nv());
        /// Points that hinges turn about, world frame, shape (njnt, 3). \[m\]
        fn joint_anchors(&self) -> &[f64] = self.slice(self.raw().xanchor, 3 * self.model.count(Object::Joint));
        /// Axes of hinges, world frame, unit vectors, shape (njnt, 3).
        fn joint_axes(&self) -> &[f64] = self.slice(self.raw().xaxis, 3 * self.model.count(Object::Joint));
        /// Actuator controls, shape (nu).
        fn controls(&self) -> &[f64] = self.slice(self.raw().ctrl, self.model.nu());
        /// [`Data::controls`], writable.
        fn controls_mut(&mut self) -> &mut [f64] = self.slice_mut(self.raw().ctrl, self.model.nu());
        /// Applied force and torque on each body at its centre of mass, world frame, shape (nbody, 6). Persists. [N, N·m]
        fn applied_forces_mut(&mut self) -> &mut [f64] =
            self.slice_mut(self.raw().xfrc_applied, 6 * self.model.count(Object::Body));
        /// Body frame origins, world frame, shape (nbody, 3). \[m\]
        fn body_positions(&self) -> &[f64] = self.slice(self.raw().xpos, 3 * self.model.count(Object::Body));
        /// Centres of mass of the bodies, world frame, shape (nbody, 3). \[m\]
        fn body_centres(&self) -> &[f64] = self.slice(self.raw().xipos, 3 * self.model.count(Object::Body));
        /// Body orientations (w, x, y, z), shape (nbody, 4).
        fn body_quaternions(&self) -> &[f64] = self.slice(self.raw().xquat, 4 * self.model.count(Object::Body));
        /// Geometry centres, world frame, shape (ngeom, 3). \[m\]
        fn geom_positions(&self) -> &[f64] = self.slice(self.raw().geom_xpos, 3 * self.model.count(Object::Geom));
        /// Geometry orientations, rotation matrices to the world frame by rows, shape (ngeom, 9).
        fn geom_rotations(&self) -> &[f64] = self.slice(self.raw().geom_xmat, 9 * self.model.count(Object::Geom));
        /// Sites, world frame, shape (nsite, 3). \[m\]
        fn site_positions(&self) -> &[f64] = self.slice(self.raw().site_xpos, 3 * self.model.count(Object::Site));
        /// Positions of the bodies that are moved from outside, shape (nmocap, 3). \[m\]
        fn mocap_positions_mut(&mut self) -> &mut [f64] =
            self.slice_mut(self.raw().mocap_pos, 3 * self.model.mocap_count());
        /// Lengths of tendons as of the last first half-step, shape (ntendon). \[m\]
        fn tendon_lengths(&self) -> &[f64] = self.slice(self.raw().ten_length, self.model.count(Object::Tendon));
        /// Rates of the lengths of tendons as of the last first half-step, shape (ntendon). [m/s]
        fn tendon_velocities(&self) -> &[f64] = self.slice(self.raw().ten_velocity, self.model.count(Object::Tendon));
        /// Sets gravity [m/s²], world frame: see [`Model::set_gravity`].
        fn set_gravity(&mut self, gravity: [f64; 3]) = self.model.set_gravity(gravity);
        /// Sets the sliding friction coefficient of a geometry: see [`Model::set_sliding_friction`].
        fn set_sliding_friction(&mut self, geom: usize, friction: f64) = self.model.set_sliding_friction(geom, friction);
        /// Gives a body another mass and centre of mass: see `Model::set_inertial`.
        fn set_inertial(&mut self, body: usize, nominal: &Inertial, mass_kg: f64, offset_m: [f64; 3]) -> Result<()> =
            self.model.set_inertial(body, nominal, mass_kg, offset_m);
        /// Sets the losses of a hinge: see [`Model::set_losses`].
        fn set_losses(&mut self, joint: usize, friction: f64, damping: f64) =
            self.model.set_losses(joint, friction, damping);
        /// Sets the maximum length of a tendon \[m\]: see `Model::set_longest_tendon`.
        fn set_longest_tendon(&mut self, tendon: usize, length_m: f64) = self.model.set_longest_tendon(tendon, length_m);
    }

    /// The first numbers of a field of this data.
    fn slice<T>(&self, start: *const T, length: usize) -> &[T] {
        if length == 0 || start.is_null() {
            return &[];
        }
        // SAFETY: callers pass a field of this data with the length that mjdata.h documents for it.
        unsafe { std::slice::from_raw_parts(start, length) }
    }

    fn slice_mut<T>(&mut self, start: *mut T, length: usize) -> &mut [T] {
        if length == 0 || start.is_null() {
            return &mut [];
        }
        // SAFETY: as in `slice`, and `self` is borrowed mutably.
        unsafe { std::slice::from_raw_parts_mut(start, length) }
    }
}

impl Data {
    /// Allocates a simulation in the model's reference configuration.
    ///
    /// # Errors
    /// MuJoCo cannot allocate the data.
    pub fn new(model: Model) -> Result<Self> {
        Ok(Data { raw: allocate(&model)?, model, broken: false })
    }

    /// Returns the memory of the simulation and its model \[bytes\].
    pub fn bytes(&self) -> usize {
        let raw = self.raw();
        // SAFETY: the pointer is valid.
        self.model.bytes() + raw.nbuffer as usize + unsafe { sys::supple_working_bytes(raw) } as usize
    }

    /// Shrinks the contact buffer to `contacts` points.
    #[cfg(test)]
    pub(crate) fn limit_contacts(&mut self, contacts: i32) {
        self.model.limit_contacts(contacts);
    }

    pub(super) fn as_ptr(&self) -> *mut sys::mjData {
        self.raw.as_ptr()
    }

    fn raw(&self) -> &sys::mjData {
        // SAFETY: the pointer is valid as long as `self`.
        unsafe { self.raw.as_ref() }
    }

    /// Sets the simulation time \[s\].
    pub(crate) fn set_time_s(&mut self, time_s: f64) {
        // SAFETY: the pointer is valid and `self` is borrowed mutably.
        unsafe { self.raw.as_mut() }.time = time_s;
    }

    /// Restores the reference configuration at rest, at time 0, without warnings. After a fatal error inside MuJoCo the
    /// data are allocated anew.
    ///
    /// # Errors
    /// MuJoCo reports a fatal error.
    pub fn reset(&mut self) -> Result<()> {
        if self.broken {
            let left = std::mem::replace(&mut self.raw, allocate(&self.model)?);
            // SAFETY: the pointer was owned, came from MuJoCo, and is not used afterwards.
            unsafe { sys::mj_deleteData(left.as_ptr()) };
            self.broken = false;
        }
        self.call("mj_resetData", sys::supple_reset_data)
    }

    /// Runs the first half of a step: all that follows from positions and velocities (kinematics, contacts, bias
    /// forces).
    ///
    /// # Errors
    /// The simulation is unstable, a contact or constraint buffer is full, or MuJoCo reports a fatal error.
    pub fn step1(&mut self) -> Result<()> {
        self.call("mj_step1", sys::supple_step1)
    }

    /// Runs the second half of a step: actuation, constraint forces, integration. Contact forces can be read from then
    /// until the next [`Data::step1`].
    ///
    /// # Errors
    /// The simulation is unstable, a contact or constraint buffer is full, or MuJoCo reports a fatal error.
    pub fn step2(&mut self) -> Result<()> {
        self.call("mj_step2", sys::supple_step2)
    }

    /// Runs a whole physics step.
    ///
    /// # Errors
    /// The simulation is unstable, a contact or constraint buffer is full, or MuJoCo reports a fatal error.
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
        let mut message = EMPTY_MESSAGE;
        // SAFETY: model and data are valid and belong together; the shim catches errors.
        let failed = unsafe { function(self.model.as_ptr(), self.raw.as_ptr(), message.as_mut_ptr()) };
        self.broken |= failed != 0;
        check(name, failed, &message)?;
        self.check_warnings()
    }

    /// Turns warning counters above zero into errors. MuJoCo resets an unstable simulation silently and then sets its
    /// counter to 1, so a difference between two steps would not show it.
    fn check_warnings(&self) -> Result<()> {
        let warnings = &self.raw().warning;
        if warnings.iter().all(|warning| warning.number == 0) {
            return Ok(());
        }
        let unstable = [
            (sys::mjWARN_BADQPOS, "Position"),
            (sys::mjWARN_BADQVEL, "Velocity"),
            (sys::mjWARN_BADQACC, "Acceleration"),
            (sys::mjWARN_BADCTRL, "Control"),
            (sys::mjWARN_INERTIA, "Inertia"),
        ];
        for (warning, kind) in unstable {
            let warning = &warnings[warning as usize];
            ensure!(warning.number == 0, Error::Unstable { kind, index: warning.lastinfo });
        }
        if warnings[sys::mjWARN_CONTACTFULL as usize].number > 0 {
            return Err(Error::BufferFull { buffer: "Contacts", size: self.model.nconmax() });
        }
        Err(Error::BufferFull { buffer: "Constraints", size: self.model.njmax() })
    }

    /// Returns the pose of a body in the world.
    pub(crate) fn body_pose(&self, body: usize) -> Isometry3<f64> {
        let place: [f64; 3] = std::array::from_fn(|k| self.body_positions()[3 * body + k]);
        let turn = std::array::from_fn(|k| self.body_quaternions()[4 * body + k]);
        Isometry3::from_parts(place.into(), unit(turn))
    }

    /// Iterates over the contact points of the last [`Data::step1`] that take part in the dynamics.
    pub fn contacts(&self) -> impl Iterator<Item = Contact> + '_ {
        let contacts = self.slice(self.raw().contact, self.contact_count());
        contacts.iter().enumerate().filter(|(_, contact)| contact.exclude == 0).map(|(index, contact)| Contact {
            index,
            geoms: [contact.geom1 as usize, contact.geom2 as usize],
            position: contact.pos,
            distance: contact.dist,
        })
    }

    /// Returns the force of a contact on its second geometry, world frame \[N\]. Valid after [`Data::step2`] and before
    /// the next [`Data::step1`].
    pub(crate) fn contact_force(&self, index: usize) -> [f64; 3] {
        let contact = &self.slice(self.raw().contact, self.contact_count())[index];
        // The address is negative for contacts without a force.
        let address = usize::try_from(contact.efc_address).unwrap_or(usize::MAX);
        let Some(rows) = self.slice(self.raw().efc_force, self.raw().nefc as usize).get(address..) else {
            return [0.0; 3];
        };
        // Along the normal and the two tangents; the turning parts of larger cones are no force.
        let (mut in_contact, tangents) = ([0.0; 3], contact.dim as usize - 1);
        if tangents == 0 || self.model.has_elliptic_cones() {
            let parts = in_contact.len().min(contact.dim as usize);
            in_contact[..parts].copy_from_slice(&rows[..parts]);
        } else {
            // A pyramid has two edges for each tangent.
            in_contact[0] = rows[..2 * tangents].iter().fold(0.0, |sum, edge| sum + edge);
            for k in 0..tangents.min(2) {
                in_contact[k + 1] = (rows[2 * k] - rows[2 * k + 1]) * contact.friction[k];
            }
        }
        // Rows of `frame` are the contact axes in the world, the first along the normal from geom 1 to geom 2.
        std::array::from_fn(|k| (0..3).map(|axis| contact.frame[3 * axis + k] * in_contact[axis]).sum())
    }

    /// Returns the force with which a tendon at its maximum length pulls its ends together \[N\]; zero while it is
    /// slack. Valid after [`Data::step2`] and before the next [`Data::step1`].
    pub(crate) fn tendon_limit_force(&self, tendon: usize) -> f64 {
        let raw = self.raw();
        let rows = raw.nefc as usize;
        let (kinds, ids) = (self.slice(raw.efc_type, rows), self.slice(raw.efc_id, rows));
        let forces = self.slice(raw.efc_force, rows);
        let is_its_limit = |row: &usize| {
            kinds[*row] as u32 == sys::mjCNSTR_LIMIT_TENDON && usize::try_from(ids[*row]).is_ok_and(|id| id == tendon)
        };
        (0..rows).filter(is_its_limit).map(|row| forces[row]).sum()
    }

    /// Returns the velocity of a geometry's centre or a site, world axes [m/s].
    pub(crate) fn velocity(&self, kind: Object, id: usize) -> [f64; 3] {
        assert!(id < self.model.count(kind), "{kind:?} {id} out of range");
        let (mut velocity, mut message) = ([0.0; 6], EMPTY_MESSAGE);
        // SAFETY: model and data belong together, the id was checked, the result holds 6 numbers (angular, linear).
        let failed = unsafe {
            sys::supple_object_velocity(
                self.model.as_ptr(),
                self.raw.as_ptr(),
                kind.known().0 as i32,
                id as i32,
                velocity.as_mut_ptr(),
                0,
                message.as_mut_ptr(),
            )
        };
        if failed != 0 {
            return [f64::NAN; 3];
        }
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

/// Fault injection for tests.
#[cfg(test)]
impl Data {
    /// Shrinks MuJoCo's stack so much that the next step raises a fatal error.
    pub(crate) fn exhaust_stack(&mut self) {
        // SAFETY: the pointer is valid and `self` is borrowed mutably; less than what is allocated is always safe.
        unsafe { sys::supple_exhaust_stack(self.raw.as_ptr()) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mujoco::{FIXED_BUFFERS, Model};

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
    fn a_resting_ball_is_carried_by_its_weight_and_held_on_a_slope() {
        for cone in ["pyramidal", "elliptic"] {
            for (condim, slope) in [(1, 0.0), (3, 0.0), (3, 2.0), (6, 2.0)] {
                let option = format!("<option cone=\"{cone}\"/><default><geom condim=\"{condim}\"/></default><size");
                // It cannot roll.
                let text = BALL.replacen("<size", &option, 1).replace(
                    "<freejoint name=\"ball\"/>",
                    "\
                    <joint type=\"slide\" axis=\"1 0 0\"/><joint type=\"slide\" axis=\"0 0 1\"/>",
                );
                let mut data = Data::new(Model::from_xml(&[("ball.xml", &text)]).unwrap()).unwrap();
                data.set_gravity([slope, 0.0, -9.81]);
                for _ in 0..500 {
                    data.step1().unwrap();
                    data.step2().unwrap();
                }
                let force = data.contact_force(data.contacts().next().unwrap().index);
                // The floor is the first geometry: the force is on the ball, upwards, 1 kg · 9.81 m/s², and against the slope.
                let error = [force[0] + slope, force[1], force[2] - 9.81];
                assert!(error.iter().all(|error| error.abs() < 0.01), "{cone} {condim} {slope}: {force:?}");
            }
        }
    }

    #[test]
    fn numbers_that_are_not_finite_are_an_error_and_not_a_silent_reset() {
        for _ in 0..2 {
            let mut data = ball();
            data.velocities_mut()[2] = f64::NAN;
            let error = data.step().unwrap_err();
            assert_eq!(error, Error::Unstable { kind: "Velocity", index: 2 });
            // MuJoCo's own reset has zeroed its counters once; the next fault must show as well.
            data.reset().unwrap();
            data.positions_mut()[0] = f64::INFINITY;
            assert!(matches!(data.step1(), Err(Error::Unstable { kind: "Position", .. })));
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
        if !FIXED_BUFFERS {
            data.step1().unwrap();
            return assert_eq!(data.contacts().count(), 7);
        }
        let error = data.step1().unwrap_err();
        assert_eq!(error, Error::BufferFull { buffer: "Contacts", size: 4 });
        assert!(error.to_string().contains("nconmax"));
    }

    #[test]
    fn after_a_fatal_error_inside_mujoco_a_reset_makes_the_data_anew() {
        let mut data = ball();
        let mut other = ball();
        data.exhaust_stack();
        let error = data.step().unwrap_err();
        let Error::Engine { call: "mj_step", message } = &error else { panic!("{error}") };
        assert!(message.to_lowercase().contains("stack overflow"), "{message}");
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
