// Pictures of a model without a screen: MuJoCo's own renderer on an EGL context, whose library is opened at run time.
//
// A renderer belongs to the thread that made it: OpenGL's context does. Return codes are those of shim.h.
#ifndef SUPPLE_MUJOCO_RENDER_H
#define SUPPLE_MUJOCO_RENDER_H

#include <mujoco/mujoco.h>

typedef struct SuppleRenderer_ SuppleRenderer;

// Where the camera looks from: the point that it looks at [m], its distance [m], and its direction [degrees].
typedef struct {
  double target[3], distance, azimuth, elevation;
} SuppleView;

// A mark in world coordinates [m]: an arrow, or a rod with round ends.
typedef struct {
  double from[3], to[3], radius;
  float rgba[4];
  int is_arrow;
} SuppleMark;

// Makes a renderer of pictures of this size [px], which is also written into the model, for at most `marks` marks. `*out` is what
// has to be deleted, also after an error.
int supple_new_renderer(SuppleRenderer** out, mjModel* m, int width, int height, int marks, char* error);
void supple_delete_renderer(SuppleRenderer* renderer);
// Puts every body at its pose (nbody, 7: position [m], then quaternion w x y z; world frame) and writes the picture: `rgb`
// (height, width, 3), rows from the lowest to the highest.
int supple_render(SuppleRenderer* renderer, const mjModel* m, mjData* d, const float* poses, const SuppleView* view,
                  const SuppleMark* marks, int count, unsigned char* rgb, char* error);

#endif
