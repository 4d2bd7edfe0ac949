/* Prints the golden numbers of the kinematics and accelerometer tests: MuJoCo 2.2.2 on models/go1.xml, in the air.
   cd src/robot && cc golden.c -o /tmp/golden -lmujoco -lm && /tmp/golden ../../models/go1.xml */
#include <mujoco/mujoco.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void print(const char* name, const mjtNum* x, int n) {
  printf("%s: [", name);
  for (int i = 0; i < n; i++) printf(i ? ", %.12f" : "%.12f", x[i]);
  printf("]\n");
}

int main(int argc, char** argv) {
  if (argc < 2) return 1;
  char xml[4096], error[1000];
  snprintf(xml, sizeof xml,
           "<mujoco><include file=\"%s\"/><sensor><accelerometer site=\"imu\"/><gyro site=\"imu\"/></sensor></mujoco>",
           argv[1]);
  FILE* file = fopen("golden_scene.xml", "w");
  fputs(xml, file);
  fclose(file);
  mjModel* m = mj_loadXML("golden_scene.xml", NULL, error, sizeof error);
  if (!m) { puts(error); return 1; }
  mjData* d = mj_makeData(m);
  const mjtNum q[] = {0.3, -0.2, 1.0, 0.9, 0.1, -0.3, 0.3,  0.2, 0.7, -1.5,  -0.3, 0.9, -1.8,
                      -0.1, 0.5, -1.2,  0.4, 1.1, -2.1};
  const mjtNum v[] = {0.5, -0.3, 0.2, 1.0, -2.0, 0.7,  1.5, -2.0, 3.0,  -0.5, 4.0, -1.0,
                      2.0, 0.5, 0.7,  -1.0, -3.0, 2.5};
  memcpy(d->qpos, q, sizeof q);
  memcpy(d->qvel, v, sizeof v);
  mju_normalize4(d->qpos + 3);
  for (int i = 0; i < 12; i++) d->ctrl[i] = (i % 5) - 2.0;
  mj_forward(m, d);
  print("quaternion (w, x, y, z)", d->qpos + 3, 4);
  print("acceleration of the origin, world", d->qacc, 3);
  print("angular acceleration, base", d->qacc + 3, 3);
  print("accelerometer", d->sensordata, 3);
  print("gyro", d->sensordata + 3, 3);
  const char* legs[] = {"FR", "FL", "RR", "RL"};
  int trunk = mj_name2id(m, mjOBJ_BODY, "trunk");
  for (int leg = 0; leg < 4; leg++) {
    char name[32];
    snprintf(name, sizeof name, "%s_foot", legs[leg]);
    int foot = mj_name2id(m, mjOBJ_GEOM, name);
    mjtNum in_world[3], in_base[3], foot_velocity[6], cross[3], relative[3], velocity[3], rate[3];
    mju_sub3(in_world, d->geom_xpos + 3 * foot, d->xpos + 3 * trunk);
    mju_rotVecMatT(in_base, in_world, d->xmat + 9 * trunk);
    mj_objectVelocity(m, d, mjOBJ_GEOM, foot, foot_velocity, 0); /* angular, linear; world axes */
    mju_sub3(relative, foot_velocity + 3, d->qvel);
    mju_rotVecMatT(velocity, relative, d->xmat + 9 * trunk);
    mju_cross(cross, d->qvel + 3, in_base);
    mju_subFrom3(velocity, cross);
    mju_rotVecMatT(rate, foot_velocity, d->xmat + 9 * trunk);
    mju_subFrom3(rate, d->qvel + 3);
    printf("%s ", legs[leg]);
    print("position", in_base, 3);
    print("   velocity", velocity, 3);
    print("   rate", rate, 3);
  }
  remove("golden_scene.xml");
  return 0;
}
