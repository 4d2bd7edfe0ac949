// MuJoCo reports fatal errors through a global handler that must not return: the default one waits
// for a key and exits the process. Here the handler jumps back to the guarded call that is running on
// this thread. Only frames of MuJoCo's C engine lie in between, which hold nothing to unwind, except in
// mj_loadXML: its compiler is C++ and catches errors itself, its reader holds a lock. An error that comes
// from there (memory has run out) leaves the lock held, and no other file can be read.

#include "guard.h"
#include "shim.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#ifdef __GLIBC__
#include <malloc.h>
#endif

_Thread_local jmp_buf* supple_catch_point = NULL;
_Thread_local char* supple_error_text = NULL;

void supple_fail(const char* message) {
  if (!supple_catch_point) {
    fprintf(stderr, "MuJoCo error outside a guarded call: %s\n", message);
    abort();
  }
  strncpy(supple_error_text, message, SUPPLE_ERROR_SIZE - 1);
  supple_error_text[SUPPLE_ERROR_SIZE - 1] = '\0';
  longjmp(*supple_catch_point, 1);
}

static void on_error(const char* message) {
  supple_fail(message);
}

// MuJoCo counts warnings in mjData, where they are checked; the default handler would also write a log file.
static void on_warning(const char* message) {
  (void)message;
}

void supple_init(void) {
  mju_user_error = on_error;
  mju_user_warning = on_warning;
}

#if SUPPLE_ARENA
static int add_file(mjVFS* vfs, const char* name, const char* text, int size) {
  return mj_addBufferVFS(vfs, name, text, size);
}
#else
static int add_file(mjVFS* vfs, const char* name, const char* text, int size) {
  int code = mj_makeEmptyFileVFS(vfs, name, size);
  if (code != 0) {
    return code;
  }
  int index = mj_findFileVFS(vfs, name);
  if (index < 0) {
    mju_error("MuJoCo does not find the file that it has just added");
  }
  memcpy(vfs->filedata[index], text, size);
  return 0;
}
#endif

int supple_add_file(mjVFS* vfs, const char* name, const char* text, int size, int* code, char* error) {
  GUARDED(*code = add_file(vfs, name, text, size));
}

int supple_load_xml(mjModel** out, const char* filename, const mjVFS* vfs, char* error) {
  *out = NULL;
  GUARDED(*out = mj_loadXML(filename, vfs, error, SUPPLE_ERROR_SIZE));
}

int supple_copy_model(mjModel** out, const mjModel* source, char* error) {
  *out = NULL;
  GUARDED(*out = mj_copyModel(NULL, source));
}

int supple_make_data(mjData** out, const mjModel* m, char* error) {
  *out = NULL;
  GUARDED(*out = mj_makeData(m));
}

int supple_reset_data(const mjModel* m, mjData* d, char* error) { GUARDED(mj_resetData(m, d)); }

int supple_step(const mjModel* m, mjData* d, char* error) { GUARDED(mj_step(m, d)); }

int supple_step1(const mjModel* m, mjData* d, char* error) { GUARDED(mj_step1(m, d)); }

int supple_step2(const mjModel* m, mjData* d, char* error) { GUARDED(mj_step2(m, d)); }

int supple_object_velocity(const mjModel* m, const mjData* d, int objtype, int objid, mjtNum* res,
                           int flg_local, char* error) {
  GUARDED(mj_objectVelocity(m, d, objtype, objid, res, flg_local));
}

static void rne(const mjModel* m, mjData* d) {
  mj_kinematics(m, d);
  mj_comPos(m, d);
  mj_comVel(m, d);
  mj_rne(m, d, 1, d->qfrc_inverse);
}

int supple_rne(const mjModel* m, mjData* d, char* error) { GUARDED(rne(m, d)); }

#if SUPPLE_ARENA
int supple_raise(const char* message, char* error) { GUARDED(mju_error("%s", message)); }

size_t supple_working_bytes(const mjData* d) { return (size_t)d->narena; }

void supple_exhaust_stack(mjData* d) { d->pstack = (size_t)d->narena - d->parena; }

void supple_collide_pairs_only(mjModel* m) {
  memset(m->geom_contype, 0, m->ngeom * sizeof(int));
  memset(m->geom_conaffinity, 0, m->ngeom * sizeof(int));
  memset(m->body_contype, 0, m->nbody * sizeof(int));
  memset(m->body_conaffinity, 0, m->nbody * sizeof(int));
}
#else
int supple_raise(const char* message, char* error) { GUARDED(mju_error(message)); }

size_t supple_working_bytes(const mjData* d) { return (size_t)d->nstack * sizeof(mjtNum); }

void supple_exhaust_stack(mjData* d) { d->nstack = 8; }

void supple_collide_pairs_only(mjModel* m) { m->opt.collision = mjCOL_PAIR; }
#endif

int supple_actuator_count(const mjModel* m) {
#if SUPPLE_ACTUATORS
  return (int)m->nactuator;
#else
  return (int)m->nu;
#endif
}

void supple_release_memory(void) {
#ifdef __GLIBC__
  malloc_trim(0);
#endif
}
