// MuJoCo calls that may raise a fatal error, wrapped so that the error comes back as a value.
//
// Each returns 0, or 1 after writing MuJoCo's message into `error` (always NUL-terminated).
// After a 1 the mjData involved is in an unknown state: reset it before the next step.
#ifndef SUPPLE_MUJOCO_SHIM_H
#define SUPPLE_MUJOCO_SHIM_H

#include <mujoco/mujoco.h>

#define SUPPLE_ERROR_SIZE 1024

// What has changed since MuJoCo 2.2.2. Contacts, constraints and the stack share one arena, whose size is chosen by <size memory>:
#define SUPPLE_ARENA (mjVERSION_HEADER >= 300)
// An actuator may have several controls and forces, and has its own number of them:
#define SUPPLE_ACTUATORS (mjVERSION_HEADER >= 3017000)

// Installs the error and warning handlers. Call once, before any other call and any thread.
void supple_init(void);

// Adds `size` bytes of text to a virtual file system. `*code` is what mj_makeEmptyFileVFS returns: 0 if all went well.
int supple_add_file(mjVFS* vfs, const char* name, const char* text, int size, int* code, char* error);
int supple_load_xml(mjModel** out, const char* filename, const mjVFS* vfs, char* error);
int supple_copy_model(mjModel** out, const mjModel* source, char* error);
int supple_make_data(mjData** out, const mjModel* m, char* error);
int supple_reset_data(const mjModel* m, mjData* d, char* error);
int supple_step(const mjModel* m, mjData* d, char* error);
int supple_step1(const mjModel* m, mjData* d, char* error);
int supple_step2(const mjModel* m, mjData* d, char* error);
int supple_object_velocity(const mjModel* m, const mjData* d, int objtype, int objid, mjtNum* res,
                           int flg_local, char* error);
// Recursive Newton-Euler: qfrc_inverse from qpos, qvel and qacc, without armature, passive, actuator and constraint forces.
int supple_rne(const mjModel* m, mjData* d, char* error);
// Raises a MuJoCo error on purpose, for tests of the way back.
int supple_raise(const char* message, char* error);

// Memory of contacts, constraints and temporaries of a simulation [bytes].
size_t supple_working_bytes(const mjData* d);
// Makes that memory too small for the next step, for tests.
void supple_exhaust_stack(mjData* d);
// Lets only those geometries touch that the model names in pairs.
void supple_collide_pairs_only(mjModel* m);
int supple_actuator_count(const mjModel* m);

// Gives freed memory back to the system, where the C library can: it keeps that of a large scene otherwise, once for each thread
// that built one.
void supple_release_memory(void);

#endif
