// The page: input goes to the worker that simulates the robots; its answers are drawn and shown as numbers.

import { fractions, listenToKeys, listenToStick } from "./command.js";
import { show as showCompliance } from "./compliance.js";
import { show as showNumbers } from "./numbers.js";
import { listenToPad } from "./pad.js";

/** The pairs of robots: a line about them, and policy and commanded compliance [m/s/N] of each. */
const PAIRS = {
  "soft and stiff": [
    "One policy twice: the left robot is commanded to yield, the right one is not.",
    [{ name: "real", compliance: 0.05 }, { name: "real", compliance: null }],
  ],
  "compliant and baseline": [
    "The paper's policies: the left one learned to yield, the right one to resist.",
    [{ name: "compliant", compliance: null }, { name: "baseline", compliance: null }],
  ],
};

/** The largest push and pull, and the push of a key [m/s]; rates below which the page says so [1, Hz]. */
const [MOST, KEY_M_S] = [{ "m/s": 1, N: 60 }, 0.5];
const [SLOW, FEW_HZ] = [0.97, 50];

const $ = (id) => document.getElementById(id);
/** Gives the keys back to the robots, unless a list was changed by keys. */
const leave = (list) => list.matches(":focus-visible") || list.blur();
const worker = new Worker("physics.js", { type: "module" });
let [robots, picture] = [[], null];
let wanted = null; // The robots that are on their way.
let [paused, speed, rate, range] = [false, 1, null, [0, 0, 0]];

const send = (name, value) => worker.postMessage([name, value]);
const push = (size) => send("push", size);
const pull = (force) => {
  send("pull", force);
  if (force) dismiss("Drag a robot");
};

// ---- input

let sent = "";
const command = () => {
  const now = fractions().map((part, axis) => part * range[axis]);
  if (String(now) !== sent) send("command", now);
  sent = String(now);
};
listenToKeys(command);
listenToStick($("stick"), "walk", command);
listenToStick($("wheel"), "turn", command);
setInterval(command, 60); // A gamepad reports nothing by itself.
listenToPad($("pad"), $("said"), () => "m/s", (unit) => MOST[unit], { push, pull });

const clock = () => send("clock", { speed, paused: paused || document.hidden }); // A hidden page pauses.
document.addEventListener("visibilitychange", clock);
const pause = () => {
  paused = !paused;
  $("pause").setAttribute("aria-pressed", paused);
  clock();
  read();
};
$("stand").onclick = () => send("stand");
$("reset").onclick = () => send("reset");
$("pause").onclick = pause;
$("speed").onchange = () => {
  speed = Number($("speed").value);
  leave($("speed"));
  clock();
};

const ACTIONS = {
  KeyR: () => send("reset"), KeyF: () => send("stand"), Space: pause,
  KeyI: () => push([KEY_M_S, 0]), KeyK: () => push([-KEY_M_S, 0]), KeyJ: () => push([0, KEY_M_S]), KeyL: () => push([0, -KEY_M_S]),
};
addEventListener("keydown", (event) => {
  const busy = event.target.closest?.(event.code === "Space" ? "input, select, button, a" : "input, select");
  if (busy || !ACTIONS[event.code] || event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  ACTIONS[event.code]();
});

// ---- what the worker answers

/** Starts robots in the chosen scene. */
function start(chosen) {
  wanted = chosen;
  if (robots.length) hint("Loading …");
  $("story").textContent = PAIRS[$("pair").value][0];
  leave($("pair"));
  leave($("scene"));
  send("start", { robots: chosen.map(({ name, compliance }) => ({ name, compliance })), scene: $("scene").value || "flat" });
}

function started({ parts, about, version, scenes }) {
  wanted = null;
  robots = about.map((one) => ({ ...one, falls: 0, reading: null }));
  range = [0, 1, 2].map((axis) => Math.min(...about.map((one) => one.range[axis])));
  if (!$("scene").length) $("scene").append(...scenes.map((name) => new Option(name, name)));
  $("version").textContent = `Physics: MuJoCo ${version} in WebAssembly.`;
  picture.begin(parts);
  hint("Drag a robot");
  setTimeout(() => dismiss("Drag a robot"), 6e3);
  sent = "";
  command();
}

function play({ robots: poses, rate: now }) {
  poses.forEach(({ reading, falls, compliance }, index) => {
    Object.assign(robots[index], { falls, compliance, reading: reading ?? robots[index].reading });
  });
  rate = now;
  picture.poses = poses;
  window.state = { robots, rate, poses, picture, send }; // For tests.
  if (poses[0].reading) read();
}

/** Shows numbers and whether the machine keeps up, and names and sliders where they change. */
function read() {
  if (!robots.length) return;
  const free = robots.every(({ compliance }) => compliance === null) ? "" : ", not commanded to yield";
  robots.forEach((robot, index) => {
    const { name, compliance } = robot;
    robot.title = compliance === null ? name : `${name}@${+compliance.toFixed(6)}`;
    const label = name + (compliance === null ? free : `, commanded to yield ${+compliance.toFixed(3)} m/s per newton`);
    write(document.querySelectorAll(".name")[index], label);
  });
  showNumbers($("numbers"), robots);
  showCompliance($("compliance"), robots, (robot, compliance) => send("comply", { robot, compliance }));
  const isSlow = rate !== null && rate < SLOW;
  const time = speed === 1 ? "real time" : `${speed} × real time`;
  const pictures = picture.rate === null ? "" : `, ${Math.round(picture.rate)} pictures a second`;
  const text = isSlow ? `slow motion ${(rate * speed).toFixed(2)} ×: this machine is too slow` : time + pictures;
  say(paused ? "paused" : text, !paused && (isSlow || (picture.rate !== null && picture.rate < FEW_HZ)));
}

function write(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

function say(text, alarm = false) {
  write($("status"), text);
  $("status").classList.toggle("alarm", alarm);
}

/** Shows a line in the picture; the first problem stays. */
function hint(text, kind = "") {
  if ($("hint").className === "alarm") return;
  write($("hint"), text);
  $("hint").className = kind;
}

const dismiss = (text) => $("hint").textContent === text && hint(text, "done");

/** Ends the play. */
function fail(problem) {
  worker.terminate();
  [robots, $("choosing").inert] = [[], true];
  hint(`The robots have stopped (${problem}). Reload the page; if that does not help, try another browser.`, "alarm");
  say("stopped", true);
}

addEventListener("error", ({ error }) => error && fail(error.message)); // A late notice of a size has no error.
worker.onerror = (event) => fail(event.message || "their worker does not start");
const ANSWERS = { started, play, fail, arrives: (percent) => say(`loading, ${percent} % …`) };
worker.onmessage = ({ data: [name, value] }) => ANSWERS[name](value);

$("pair").append(...Object.keys(PAIRS).map((name) => new Option(name, name)));
try {
  const { Picture } = await import("./picture.js"); // Fails without WebGL, too.
  picture = new Picture($("robots"), {
    pull: (part) => pull(part && part.map((it) => it * MOST.N)),
    push: (part) => push(part.map((it) => it * MOST["m/s"])),
  });
  const choose = () => start(PAIRS[$("pair").value][1]);
  $("pair").onchange = choose;
  $("scene").onchange = () => start(wanted ?? robots);
  choose();
  clock();
} catch (problem) {
  fail(problem.message.replace(/\.$/, ""));
}
