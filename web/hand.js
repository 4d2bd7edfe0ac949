// The hand in the picture. A pointer on a robot grabs it: a drag pulls, a quick one pushes. Elsewhere it turns the picture; two
// fingers and the wheel zoom.

import * as THREE from "./three.module.min.js";
import { up } from "./shapes.js";

/** Distance from the robot at which a hand pulls or pushes with all its force, and within which it grabs [m]. */
const [REACH_M, GRAB_M] = [0.8, 0.35];
/** Longest time and shortest way of a quick drag [ms, px]. */
const [FLICK_MS, FLICK_PX] = [280, 12];
const RAD_PER_PX = 1 / 150;

const limited = (value, low, high) => Math.min(high, Math.max(low, value));

/** Calls `on.pull(force or null)` and `on.push(size)` with parts of the whole, forward and left, 0 to 1. */
export function listenToHand(picture, on) {
  const canvas = picture.renderer.domElement;
  const pointers = new Map();
  let held = null;

  /** The place of a pointer at the height of a robot, forward and left of it [m]; null where it misses. */
  const reach = (index, { offsetX, offsetY }, misses) => {
    const [left, , width, height] = picture.areas[index];
    const { camera, trunk, yaw } = picture.views[index];
    const pointer = new THREE.Vector3((2 * (offsetX - left)) / width - 1, 1 - (2 * offsetY) / height, 0.5).unproject(camera);
    const ray = new THREE.Ray(camera.position, pointer.sub(camera.position).normalize());
    if (misses && ray.distanceToPoint(trunk) > GRAB_M) return null;
    const at = ray.intersectPlane(new THREE.Plane(up, -trunk.z), new THREE.Vector3()) ?? trunk;
    const { x, y } = at.clone().sub(trunk).applyAxisAngle(up, -yaw);
    return [x, y];
  };
  const zoom = (factor) => (picture.orbit.away = limited(picture.orbit.away * factor, 1, 8));

  canvas.addEventListener("pointerdown", (event) => {
    pointers.set(event.pointerId, event);
    canvas.setPointerCapture(event.pointerId);
    const index = picture.areas.findIndex(([left, , width]) => event.offsetX >= left && event.offsetX < left + width);
    const from = pointers.size === 1 && picture.views[index]?.trunk ? reach(index, event, true) : null;
    if (!from) return;
    const hand = { index, from, event, part: null };
    held = hand;
    // A hand that rests pulls, too.
    setTimeout(() => held === hand && hand.part && on.pull(hand.part), FLICK_MS + 1);
  });

  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    if (held?.event.pointerId === event.pointerId) {
      const now = reach(held.index, event, false);
      const drag = [now[0] - held.from[0], now[1] - held.from[1]];
      held.part = drag.map((way) => way / Math.max(REACH_M, Math.hypot(...drag)));
      if (event.timeStamp - held.event.timeStamp > FLICK_MS) on.pull(held.part);
    } else if (pointers.size === 2) {
      const other = [...pointers.values()].find(({ pointerId }) => pointerId !== event.pointerId);
      const far = (one) => Math.max(1, Math.hypot(one.offsetX - other.offsetX, one.offsetY - other.offsetY));
      zoom(far(before) / far(event));
    } else {
      picture.orbit.around -= (event.offsetX - before.offsetX) * RAD_PER_PX;
      picture.orbit.above = limited(picture.orbit.above + (event.offsetY - before.offsetY) * RAD_PER_PX, 0.05, 1.5);
    }
    pointers.set(event.pointerId, event);
  });

  const end = (event) => {
    pointers.delete(event.pointerId);
    if (held?.event.pointerId !== event.pointerId) return;
    const { event: start, part } = held;
    held = null;
    on.pull(null);
    const moved = Math.hypot(event.offsetX - start.offsetX, event.offsetY - start.offsetY);
    const isQuick = event.timeStamp - start.timeStamp <= FLICK_MS && moved > FLICK_PX;
    if (part && isQuick && event.type === "pointerup") on.push(part);
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  const onWheel = (event) => {
    event.preventDefault();
    zoom(Math.exp(event.deltaY / 800));
  };
  canvas.addEventListener("wheel", onWheel, { passive: false });
}
