// The command: the sum of keys, sticks and gamepad, as fractions of the policies' training range.

const KEYS = {
  KeyW: [1, 0, 0], ArrowUp: [1, 0, 0],
  KeyS: [-1, 0, 0], ArrowDown: [-1, 0, 0],
  KeyA: [0, 1, 0], KeyD: [0, -1, 0],
  KeyQ: [0, 0, 1], ArrowLeft: [0, 0, 1],
  KeyE: [0, 0, -1], ArrowRight: [0, 0, -1],
};

/** Fraction of the range that a key commands without Shift. */
const FRACTION = 0.6;

/** Dead zone of a gamepad's stick. */
const DEAD_ZONE = 0.12;

const held = new Set();
const sticks = { walk: [0, 0], turn: 0 };
let fast = false;

/** Forward, left and yaw, each from -1 to 1. */
export function fractions() {
  const sum = [sticks.walk[0], sticks.walk[1], sticks.turn];
  for (const key of held) KEYS[key].forEach((part, axis) => (sum[axis] += part * (fast ? 1 : FRACTION)));
  for (const pad of navigator.getGamepads?.() ?? []) {
    if (!pad) continue;
    const axis = (index) => (Math.abs(pad.axes[index] ?? 0) > DEAD_ZONE ? pad.axes[index] : 0);
    sum[0] -= axis(1);
    sum[1] -= axis(0);
    sum[2] -= axis(2);
  }
  return sum.map((part) => Math.max(-1, Math.min(1, part)));
}

/** Listens to keys; calls `changed` at once. */
export function listenToKeys(changed) {
  const note = (event, down) => {
    fast = event.shiftKey;
    if (!(event.code in KEYS)) return;
    const busy = event.target.closest?.("input, select, textarea") || event.ctrlKey || event.altKey || event.metaKey;
    if (down && busy) return;
    if (down) held.add(event.code);
    else held.delete(event.code);
    if (!busy) event.preventDefault();
    if (!event.repeat) changed();
  };
  addEventListener("keydown", (event) => note(event, true));
  addEventListener("keyup", (event) => note(event, false));
  // Key releases outside the page are not reported.
  addEventListener("blur", () => letGo(changed));
  document.addEventListener("visibilitychange", () => letGo(changed));
}

function letGo(changed) {
  held.clear();
  changed();
}

/** Makes a knob follow the pointer within its face, and spring back; calls `changed` at once. */
export function listenToStick(svg, which, changed) {
  const knob = svg.querySelector(".knob");
  const move = (x, y) => {
    const length = Math.max(1, Math.hypot(x, y) / 100);
    [x, y] = which === "turn" ? [Math.max(-1, Math.min(1, x / 80)), 0] : [x / length / 100, y / length / 100];
    knob.setAttribute("transform", `translate(${x * 80} ${y * 80})`);
    if (which === "turn") sticks.turn = -x;
    else sticks.walk = [-y, -x];
    changed();
  };
  drag(svg, { start: move, move, end: () => move(0, 0) });
}

/** Follows one pointer from press to release, in the drawing's units. */
export function drag(svg, { start, move, end }) {
  let pointer = null;
  const place = (event) => {
    const { x, y } = new DOMPoint(event.clientX, event.clientY).matrixTransform(svg.getScreenCTM().inverse());
    return [x, y];
  };
  svg.addEventListener("pointerdown", (event) => {
    if (pointer !== null || event.button !== 0) return;
    pointer = event.pointerId;
    svg.setPointerCapture(pointer);
    svg.classList.add("active");
    start(...place(event));
    event.preventDefault();
  });
  svg.addEventListener("pointermove", (event) => {
    if (event.pointerId !== pointer) return;
    if (event.buttons) move(...place(event));
    else finish(event); // It was released where the page does not hear it, as in another tab.
  });
  const finish = (event) => {
    if (event.pointerId !== pointer) return;
    pointer = null;
    svg.classList.remove("active");
    end(event.type === "pointerup");
  };
  svg.addEventListener("pointerup", finish);
  svg.addEventListener("pointercancel", finish);
  svg.addEventListener("lostpointercapture", finish);
}
