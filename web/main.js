// The page: what hands do goes to the worker that plays the robots, and what it answers is drawn and read.

import { fractions, listenToKeys, listenToStick } from "./command.js";
import { show as showCompliance } from "./compliance.js";
import { show as showNumbers } from "./numbers.js";
import { listenToPad } from "./pad.js";
import { Picture } from "./picture.js";

/** The pairs of robots: a line about them, and policy and commanded compliance [m/s/N] of each. */
const PAIRS = {
  "soft and stiff": ["One policy twice: the left robot is commanded to yield, the right one is not.", [["real", 0.05], ["real", null]]],
  "compliant and baseline": [
    "The paper's policies: the left one learned to yield, the right one to resist.", [["compliant", null], ["baseline", null]],
  ],
};

/** The largest push and pull; rates below which the page says so [1, Hz]; the version of the programs. */
const MOST = { "m/s": 1, N: 60 };
const [SLOW, FEW_HZ] = [0.97, 50];
const PROGRAMS = "2.2.2";

addEventListener("error", ({ message }) => fail(message)); // No WebGL, for instance.

const $ = (id) => document.getElementById(id);
const worker = new Worker("physics.js", { type: "module" });
let robots = [];
let [paused, rate, range] = [false, null, [0, 0, 0]];

const send = (name, value = null) => worker.postMessage({ [name]: value });
const push = (size) => send("push", size);
const pull = (force) => {
  send("pull", force);
  if (force) $("hint").classList.add("done");
};

const picture = new Picture($("robots"), {
  pull: (part) => pull(part && part.map((it) => it * MOST.N)),
  push: (part) => push(part.map((it) => it * MOST["m/s"])),
});
window.state = { robots, send, picture }; // For tests.

// ---- what hands do

const command = () => send("command", fractions().map((part, axis) => part * range[axis]));
let sent = "";
const changed = () => {
  const now = String(fractions());
  if (now !== sent) command();
  sent = now;
};
listenToKeys(changed);
listenToStick($("stick"), "walk", changed);
listenToStick($("wheel"), "turn", changed);
setInterval(changed, 60); // A gamepad reports nothing by itself.
listenToPad($("pad"), $("said"), () => "m/s", (unit) => MOST[unit], { push, pull });

const pause = () => {
  paused = !paused;
  $("pause").setAttribute("aria-pressed", paused);
  send("clock", { paused });
};
$("stand").onclick = () => send("stand");
$("reset").onclick = () => send("reset");
$("pause").onclick = pause;
$("speed").onchange = () => send("clock", { speed: Number($("speed").value) });
$("pair").append(...Object.keys(PAIRS).map((name) => new Option(name, name)));
$("pair").onchange = start;
$("scene").onchange = start;

addEventListener("keydown", (event) => {
  if (event.target.closest?.("input, select, button") || event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
  const action = { KeyR: () => send("reset"), KeyF: () => send("stand"), Space: pause }[event.code];
  if (!action) return;
  event.preventDefault();
  action();
});

// A hidden page rests.
document.addEventListener("visibilitychange", () => send("clock", { paused: paused || document.hidden }));

// ---- what the worker answers

function start() {
  const [story, pair] = PAIRS[$("pair").value];
  $("story").textContent = story;
  const chosen = pair.map(([policy, compliance]) => ({ policy, compliance }));
  $("pair").blur();
  $("scene").blur();
  send("start", { robots: chosen, scene: $("scene").value || "flat", command: fractions().map((part, axis) => part * range[axis]) });
}

/** Names of the robots, with the commanded compliance. */
const title = ({ name, compliance }) => (compliance === null ? name : `${name}@${+compliance.toFixed(6)}`);

function started({ parts, about, version, scenes }) {
  const [, pair] = PAIRS[$("pair").value];
  robots = pair.map(([name, compliance], index) => ({ name, compliance, falls: 0, reading: null, ...about[index] }));
  robots.forEach((robot) => (robot.title = title(robot)));
  range = [0, 1, 2].map((axis) => Math.min(...about.map((one) => one.range[axis])));
  if (!$("scene").length) $("scene").append(...scenes.map((name) => new Option(name, name)));
  $("version").textContent = `Physics: MuJoCo ${version} in WebAssembly; the programs use ${PROGRAMS}, and the numbers agree within 5 %.`;
  picture.begin(parts);
  $("hint").textContent = "Drag a robot";
  setTimeout(() => $("hint").classList.add("done"), 6e3);
  read();
}

let [waiting, newest, named] = [false, null, ""];
function play(answer) {
  answer.robots.forEach(({ reading, falls, compliance }, index) => {
    Object.assign(robots[index], { falls, compliance, reading: reading ?? robots[index].reading });
    robots[index].title = title(robots[index]);
  });
  rate = answer.rate;
  Object.assign(window.state, { robots, rate, poses: answer.robots });
  newest = answer.robots;
  if (answer.robots[0].reading) read();
  if (waiting) return;
  waiting = true;
  requestAnimationFrame(() => {
    waiting = false;
    if (newest.length === picture.views.length) picture.show(newest);
  });
}

/** Shows numbers and whether the machine keeps up, and titles and sliders where they change. */
function read() {
  showNumbers($("numbers"), robots);
  const titles = robots.map(({ title }) => title);
  if (String(titles) !== named) {
    named = String(titles);
    const free = robots.every(({ compliance }) => compliance === null) ? "" : ", not commanded to yield";
    document.querySelectorAll(".name").forEach((label, index) => {
      const { name, compliance } = robots[index];
      label.textContent = name + (compliance === null ? free : `, commanded to yield ${+compliance.toFixed(3)} m/s per newton`);
    });
    showCompliance($("compliance"), robots, (robot, compliance) => send("comply", { robot, compliance }));
  }
  const pictures = picture.rate === null ? "" : `, ${Math.round(picture.rate)} pictures a second`;
  const isSlow = rate !== null && rate < SLOW;
  const time = isSlow ? `slow motion ${rate.toFixed(2)} ×: this machine cannot keep up` : `real time${pictures}`;
  say(paused ? "paused" : time, isSlow || (picture.rate !== null && picture.rate < FEW_HZ));
}

function say(text, alarm = false) {
  if ($("status").textContent !== text) $("status").textContent = text;
  $("status").classList.toggle("alarm", alarm);
}

function fail(problem) {
  if ($("hint").className === "alarm") return;
  worker.terminate();
  $("hint").textContent = `The robots cannot run in this browser: ${problem}`;
  $("hint").className = "alarm";
  say("stopped", true);
}

worker.onerror = (event) => fail(event.message || "the worker does not start");
worker.onmessage = ({ data }) => {
  if (data.started) started(data.started);
  else if (data.robots) play(data);
  else if (data.problem) fail(data.problem);
};
start();
