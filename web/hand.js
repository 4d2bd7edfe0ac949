// The hand in the picture. A pointer on a robot grabs it: a drag pulls, a quick one pushes. Elsewhere it turns the picture; two
// fingers and the wheel zoom.

import * as THREE from "./three.module.min.js";
import { up } from "./shapes.js";

/** Length of a drag that pulls or pushes with all its force, and distance from a robot within which a pointer grabs it [m]. */
const [REACH_M, GRAB_M] = [0.8, 0.35];
/** Longest time and shortest way of a quick drag [ms, px]. */
const [FLICK_MS, FLICK_PX] = [280, 12];
const RAD_PER_PX = 1 / 150;

const { clamp } = THREE.MathUtils;

/** Calls `on.pull(force or null)` and `on.push(size)` with parts of the whole, forward and left, 0 to 1. */
export function listenToHand(picture, on) {
  const canvas = picture.renderer.domElement;
  const pointers = new Map();
  let held = null;

  /** The ray of a pointer into the picture of a robot. */
  const ray = (index, { offsetX, offsetY }) => {
    const [left, , width, height] = picture.areas[index];
    const { camera } = picture.views[index];
    const pointer = new THREE.Vector3((2 * (offsetX - left)) / width - 1, 1 - (2 * offsetY) / height, 0.5).unproject(camera);
    return new THREE.Ray(camera.position, pointer.sub(camera.position).normalize());
  };
  /** The place that a pointer shows at the height of the robot, far away where it is above the horizon. */
  const place = (index, event) => {
    const { origin, direction } = ray(index, event);
    const way = (origin.z - picture.views[index].trunk.z) / Math.max(0.1, -direction.z);
    return origin.clone().addScaledVector(direction, way);
  };
  const letGo = () => {
    held = null;
    on.pull(null);
  };
  const zoom = (factor) => (picture.orbit.away = clamp(picture.orbit.away * factor, 1, 6));

  canvas.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    pointers.set(event.pointerId, event);
    canvas.setPointerCapture(event.pointerId);
    if (held) letGo(); // Two fingers zoom.
    const index = picture.areas.findIndex(([left, , width]) => event.offsetX >= left && event.offsetX < left + width);
    const trunk = picture.views[index]?.trunk;
    if (pointers.size > 1 || !trunk || ray(index, event).distanceToPoint(trunk) > GRAB_M) return;
    const hand = { index, event, part: null };
    held = hand;
    // A pointer that does not move keeps pulling.
    setTimeout(() => held === hand && hand.part && on.pull(hand.part), FLICK_MS + 1);
  });

  canvas.addEventListener("pointermove", (event) => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    if (!event.buttons) return end(event); // It was released where the page does not hear it, as in another tab.
    if (held) {
      // Both relative to the camera, which follows the robot: a pointer at rest keeps its force.
      const drag = place(held.index, event).sub(place(held.index, held.event));
      const { x, y } = drag.applyAxisAngle(up, -picture.views[held.index].yaw).divideScalar(Math.max(REACH_M, drag.length()));
      held.part = [x, y];
      if (event.timeStamp - held.event.timeStamp > FLICK_MS) on.pull(held.part);
    } else if (pointers.size === 2) {
      const other = [...pointers.values()].find(({ pointerId }) => pointerId !== event.pointerId);
      const far = (one) => Math.max(1, Math.hypot(one.offsetX - other.offsetX, one.offsetY - other.offsetY));
      zoom(far(before) / far(event));
    } else {
      picture.orbit.around -= (event.offsetX - before.offsetX) * RAD_PER_PX;
      picture.orbit.above = clamp(picture.orbit.above + (event.offsetY - before.offsetY) * RAD_PER_PX, 0.15, 1.5);
    }
    pointers.set(event.pointerId, event);
  });

  const end = (event) => {
    pointers.delete(event.pointerId);
    if (held?.event.pointerId !== event.pointerId) return;
    const { event: start, part } = held;
    letGo();
    const moved = Math.hypot(event.offsetX - start.offsetX, event.offsetY - start.offsetY);
    const isQuick = event.timeStamp - start.timeStamp <= FLICK_MS && moved > FLICK_PX;
    if (part && isQuick && event.type === "pointerup") on.push(part);
  };
  canvas.addEventListener("pointerup", end);
  canvas.addEventListener("pointercancel", end);
  canvas.addEventListener("lostpointercapture", end);
  const onWheel = (event) => {
    event.preventDefault();
    zoom(Math.exp(event.deltaY / 800));
  };
  canvas.addEventListener("wheel", onWheel, { passive: false });
}
