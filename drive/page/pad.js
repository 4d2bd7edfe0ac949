// The push pad, seen from above: drag from the robot; release to push, hold still to pull.

import { drag } from "./command.js";

/** Time for which a pointer rests before it pulls. */
const HOLD_MS = 600;

/** Largest movement of a resting pointer, in the drawing's units. */
const STILL = 4;
/** Radius around the middle within which nothing happens. */
const MIDDLE = 12;

/**
 * `most(unit)` returns the size of a push or pull at the rim, `unit()` the unit of pushes.
 * Calls `on.push(size, unit)` and `on.pull(size or null)` with sizes forward and left.
 */
export function listenToPad(svg, said, unit, most, on) {
  const arrow = svg.querySelector(".arrow");
  const tip = svg.querySelector(".tip");
  let at = [0, 0];
  let still = [0, 0];
  let pulls = false;
  let timer;

  const size = (unit) => {
    const length = Math.max(100, Math.hypot(...at));
    // Up is forward, left is left.
    return [-at[1], -at[0]].map((part) => (part / length) * most(unit));
  };
  const inMiddle = () => Math.hypot(...at) < MIDDLE;
  const show = () => {
    const length = Math.max(1, Math.hypot(...at) / 100);
    const [x, y] = at.map((part) => part / length);
    for (const [name, value] of Object.entries({ x2: x, y2: y })) arrow.setAttribute(name, value);
    tip.setAttribute("transform", `translate(${x} ${y})`);
    const name = pulls ? "N" : unit();
    const [forward, left] = size(name);
    const total = Math.hypot(forward, left).toFixed(name === "m/s" ? 2 : 1);
    said.textContent = inMiddle() ? "release here to cancel" : `${pulls ? "pull" : "push"} ${total} ${name}`;
  };
  const rest = () => {
    clearTimeout(timer);
    still = at;
    timer = setTimeout(() => {
      if (inMiddle()) return;
      pulls = true;
      svg.classList.add("pulling");
      on.pull(size("N"));
      show();
    }, HOLD_MS);
  };

  drag(svg, {
    start(x, y) {
      at = [x, y];
      pulls = unit() === "N";
      svg.classList.toggle("pulling", pulls);
      rest();
      show();
      if (pulls && !inMiddle()) on.pull(size("N"));
    },
    move(x, y) {
      at = [x, y];
      if (pulls) on.pull(inMiddle() ? [0, 0] : size("N"));
      else if (Math.hypot(at[0] - still[0], at[1] - still[1]) > STILL) rest();
      show();
    },
    end(released) {
      clearTimeout(timer);
      svg.classList.remove("pulling");
      if (pulls) on.pull(null);
      else if (released && !inMiddle()) on.push(size(unit()), unit());
      pulls = false;
    },
  });
}
