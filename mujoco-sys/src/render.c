#include "render.h"

#include <dlfcn.h>
#include <stdlib.h>
#include <string.h>

#include "guard.h"

// The used part of EGL 1.5, declared here so that the build does not need its headers.
enum {
  EGL_PBUFFER_BIT = 1,
  EGL_OPENGL_BIT = 8,
  EGL_SURFACE_TYPE = 0x3033,
  EGL_NONE = 0x3038,
  EGL_RENDERABLE_TYPE = 0x3040,
  EGL_OPENGL_API = 0x30A2,
  EGL_PLATFORM_SURFACELESS_MESA = 0x31DD
};

struct SuppleRenderer_ {
  void* display;
  void* context;
  unsigned (*make_current)(void* display, void* draw, void* read, void* context);
  unsigned (*destroy_context)(void* display, void* context);
  mjvOption option;
  mjvScene scene;
  mjrContext gl;
};

#define CURE "; on Debian: apt-get install libegl1 libgl1-mesa-dri"

static void* find(void* egl, const char* name) {
  void* found = dlsym(egl, name);
  if (!found) supple_fail("libEGL.so.1 is older than EGL 1.5" CURE);
  return found;
}

// Opens a context without a window: Mesa's surfaceless one, or the one that another driver has by default.
static void open_context(SuppleRenderer* renderer) {
  // MuJoCo looks for OpenGL's functions in the libraries of the process; it is never closed.
  void* egl = dlopen("libEGL.so.1", RTLD_NOW | RTLD_GLOBAL);
  if (!egl) supple_fail("libEGL.so.1, which draws without a screen, is missing" CURE);
  void* (*get_platform_display)(unsigned, void*, const void*);
  unsigned (*initialize)(void*, int*, int*);
  unsigned (*bind_api)(unsigned);
  unsigned (*choose_config)(void*, const int*, void**, int, int*);
  void* (*create_context)(void*, void*, void*, const int*);
  void* (*get_display)(void*);
  *(void**)&get_platform_display = find(egl, "eglGetPlatformDisplay");
  *(void**)&get_display = find(egl, "eglGetDisplay");
  *(void**)&initialize = find(egl, "eglInitialize");
  *(void**)&bind_api = find(egl, "eglBindAPI");
  *(void**)&choose_config = find(egl, "eglChooseConfig");
  *(void**)&create_context = find(egl, "eglCreateContext");
  *(void**)&renderer->make_current = find(egl, "eglMakeCurrent");
  *(void**)&renderer->destroy_context = find(egl, "eglDestroyContext");

  renderer->display = get_platform_display(EGL_PLATFORM_SURFACELESS_MESA, NULL, NULL);
  if (!renderer->display || !initialize(renderer->display, NULL, NULL)) {
    renderer->display = get_display(NULL);
    if (!renderer->display || !initialize(renderer->display, NULL, NULL)) supple_fail("EGL finds no driver" CURE);
  }
  const int wanted[] = {EGL_SURFACE_TYPE, EGL_PBUFFER_BIT, EGL_RENDERABLE_TYPE, EGL_OPENGL_BIT, EGL_NONE};
  void* config = NULL;
  int count = 0;
  if (bind_api(EGL_OPENGL_API) && choose_config(renderer->display, wanted, &config, 1, &count) && count > 0) {
    renderer->context = create_context(renderer->display, config, NULL, NULL);
  }
  if (!renderer->context) supple_fail("EGL's driver has no OpenGL" CURE);
}

static void make_current(SuppleRenderer* renderer) {
  if (!renderer->make_current(renderer->display, NULL, NULL, renderer->context)) {
    supple_fail("EGL's driver needs a screen" CURE);
  }
}

static void new_renderer(SuppleRenderer** out, mjModel* m, int width, int height, int marks) {
  SuppleRenderer* renderer = *out = calloc(1, sizeof(SuppleRenderer));
  if (!renderer) supple_fail("there is no memory for it");
  mjv_defaultOption(&renderer->option);
  memset(renderer->option.flags, 0, sizeof(renderer->option.flags));
  memset(renderer->option.sitegroup, 0, sizeof(renderer->option.sitegroup));
  renderer->option.flags[mjVIS_TEXTURE] = renderer->option.flags[mjVIS_STATIC] = 1;
  mjv_defaultScene(&renderer->scene);
  mjr_defaultContext(&renderer->gl);
  open_context(renderer);
  make_current(renderer);
  m->vis.global.offwidth = width;
  m->vis.global.offheight = height;
  mjv_makeScene(m, &renderer->scene, m->ngeom + marks);
  mjr_makeContext(m, &renderer->gl, mjFONTSCALE_100);
  mjr_setBuffer(mjFB_OFFSCREEN, &renderer->gl);
  if (renderer->gl.currentBuffer != mjFB_OFFSCREEN) supple_fail("OpenGL has no buffer to draw into");
}

int supple_new_renderer(SuppleRenderer** out, mjModel* m, int width, int height, int marks, char* error) {
  *out = NULL;
  GUARDED(new_renderer(out, m, width, height, marks));
}

void supple_delete_renderer(SuppleRenderer* renderer) {
  if (renderer->context && renderer->make_current(renderer->display, NULL, NULL, renderer->context)) {
    mjr_freeContext(&renderer->gl);
    renderer->make_current(renderer->display, NULL, NULL, NULL);
    renderer->destroy_context(renderer->display, renderer->context);
  }
  mjv_freeScene(&renderer->scene);
  free(renderer);
}

// Puts bodies and what is fixed to them in their places, and the lights above what is looked at.
static void place(const mjModel* m, mjData* d, const float* poses, const double target[3]) {
  for (int body = 0; body < m->nbody; body++, poses += 7) {
    for (int k = 0; k < 3; k++) d->xpos[3 * body + k] = poses[k];
    for (int k = 0; k < 4; k++) d->xquat[4 * body + k] = poses[3 + k];
    mju_quat2Mat(d->xmat + 9 * body, d->xquat + 4 * body);
  }
  for (int geom = 0; geom < m->ngeom; geom++) {
    mj_local2Global(d, d->geom_xpos + 3 * geom, d->geom_xmat + 9 * geom, m->geom_pos + 3 * geom,
                    m->geom_quat + 4 * geom, m->geom_bodyid[geom], 0);
  }
  for (int light = 0; light < m->nlight; light++) {
    mju_copy3(d->light_xdir + 3 * light, m->light_dir + 3 * light);
    mju_addScl3(d->light_xpos + 3 * light, target, m->light_dir + 3 * light, -3);
  }
}

static void add_mark(mjvScene* scene, const SuppleMark* mark) {
  mjvGeom* geom = scene->geoms + scene->ngeom++;
  int type = mark->is_arrow ? mjGEOM_ARROW : mjGEOM_CAPSULE;
  mjv_initGeom(geom, type, NULL, NULL, NULL, mark->rgba);
#if mjVERSION_HEADER >= 300
  mjv_connector(geom, type, mark->radius, mark->from, mark->to);
#else
  const double *a = mark->from, *b = mark->to;
  mjv_makeConnector(geom, type, mark->radius, a[0], a[1], a[2], b[0], b[1], b[2]);
#endif
  geom->category = mjCAT_DECOR;
}

static void render(SuppleRenderer* renderer, const mjModel* m, mjData* d, const float* poses, const SuppleView* view,
                   const SuppleMark* marks, int count, unsigned char* rgb) {
  mjvScene* scene = &renderer->scene;
  place(m, d, poses, view->target);
  mjvCamera camera;
  mjv_defaultCamera(&camera);
  mju_copy3(camera.lookat, view->target);
  camera.distance = view->distance;
  camera.azimuth = view->azimuth;
  camera.elevation = view->elevation;
  mjv_updateScene(m, d, &renderer->option, NULL, &camera, mjCAT_ALL, scene);
  if (scene->ngeom + count > scene->maxgeom) supple_fail("there are too many marks");
  for (int k = 0; k < count; k++) add_mark(scene, marks + k);
  make_current(renderer);
  mjrRect all = {0, 0, renderer->gl.offWidth, renderer->gl.offHeight};
  mjr_render(all, scene, &renderer->gl);
  mjr_readPixels(rgb, NULL, all, &renderer->gl);
}

int supple_render(SuppleRenderer* renderer, const mjModel* m, mjData* d, const float* poses, const SuppleView* view,
                  const SuppleMark* marks, int count, unsigned char* rgb, char* error) {
  GUARDED(render(renderer, m, d, poses, view, marks, count, rgb));
}
