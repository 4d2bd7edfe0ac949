// The page: sends requests to the robots and shows their state.

import { fractions, listenToKeys, listenToStick } from "./command.js";
import { connect } from "./link.js";
import { show } from "./numbers.js";
import { listenToPad } from "./pad.js";
import { show as showCompliance } from "./compliance.js";

/** Period at which commands are repeated and the gamepad is read. */
const LIFE_MS = 60;

const $ = (id) => document.getElementById(id);
/** Gives the keys back to the robots, unless a list was changed by keys. */
const leave = (list) => list.matches(":focus-visible") || list.blur();
const most = { "m/s": 1, "N·s": 1, N: 1 };
let me = null;
let state = null;
let waiting = null;
let noticed = 0;
let holds = null;

const send = connect({
  hello({ page, about }) {
    me = page;
    [most["m/s"], most["N·s"], most.N] = about.most;
    fill($("policies"), about.policies);
    fill($("scene"), about.scenes);
    document.body.classList.toggle("served", about.is_served);
    if (about.viewer && !$("robots").firstChild) openViewer();
  },
  state(now) {
    const isNew = String(state?.robots.map(({ policy }) => policy)) !== String(now.robots.map(({ policy }) => policy));
    state = now;
    window.state = now;
    // Draw at most once per animation frame; a hidden page draws nothing.
    waiting ??= requestAnimationFrame(draw);
    if (isNew && !document.activeElement?.closest(".who")) chooseRobots();
  },
  refused: (problem) => notice(problem),
  lost() {
    state = null;
    status("connection lost: is the program still running? It may have been started again, with another address, or have too many pages open", true);
  },
});

const drives = () => state && state.driver === me;

// ---- requests

let last = [0, 0, 0];
let sent = 0;

function command() {
  if (!drives()) return;
  last = fractions().map((part, axis) => part * state.range[axis]);
  sent = performance.now();
  send({ command: last });
}

function changed() {
  if (drives() && String(fractions().map((part, axis) => part * state.range[axis])) !== String(last)) command();
}

listenToKeys(changed);
listenToStick($("stick"), "walk", changed);
listenToStick($("wheel"), "turn", changed);
setInterval(() => {
  buttonsOfGamepad();
  if (performance.now() - sent > LIFE_MS - 5) command();
  if (holds) send({ pull: holds });
}, LIFE_MS);

function push(size, unit) {
  if (!drives()) return;
  send({ push: { size, unit } });
  [$("ahead").value, $("left").value] = size.map((part) => part.toFixed(2));
  $("unit").value = unit;
  label();
}

function pull(force) {
  holds = drives() ? force : null;
  send({ pull: holds });
}

listenToPad($("pad"), $("said"), () => $("unit").value, (unit) => most[unit], { push, pull });

// The number fields beside the pad: a push is sent once, a pull lasts while the button is held.
const numbers = () => [Number($("ahead").value), Number($("left").value)];
const pulls = () => $("unit").value === "N";
const label = () => ($("push-button").textContent = pulls() ? "Hold" : "Push");
$("unit").onchange = label;
$("push").onsubmit = (event) => {
  event.preventDefault();
  if (!pulls()) push(numbers(), $("unit").value);
};
function hold(on) {
  // Letting go always counts: a push from elsewhere may have changed the unit meanwhile.
  if ((on && !pulls()) || on === $("push-button").classList.contains("held")) return;
  $("push-button").classList.toggle("held", on);
  pull(on ? numbers() : null);
}
$("push-button").onpointerdown = () => hold(true);
$("push-button").onkeydown = (event) => ["Space", "Enter"].includes(event.code) && hold(true);
for (const end of ["pointerup", "pointerleave", "pointercancel", "keyup", "blur"]) $("push-button").addEventListener(end, () => hold(false));

const pause = () => send({ pause: !state?.paused });
$("take").onclick = () => send("drive");
$("reset").onclick = () => send("reset");
$("pause").onclick = pause;
$("next").onclick = () => send({ seed: null });
$("speed").onchange = () => {
  send({ speed: Number($("speed").value) });
  leave($("speed"));
};
$("scene").onchange = () => {
  send({ scene: $("scene").value });
  leave($("scene"));
};
$("minute").onclick = () => send({ keep: "minute" });
$("all").onclick = () => send({ keep: "all" });

addEventListener("keydown", (event) => {
  const busy = event.target.closest?.(event.code === "Space" ? "input, select, button" : "input, select");
  if (busy || event.repeat || event.ctrlKey || event.metaKey || event.altKey) return;
  const action = { KeyR: () => send("reset"), KeyN: () => send({ seed: null }), Space: pause }[event.code];
  if (!action) return;
  event.preventDefault();
  action();
});

let pressed = [];
function buttonsOfGamepad() {
  const pad = navigator.getGamepads?.().find(Boolean);
  const now = pad ? pad.buttons.map((button) => button.pressed) : [];
  const actions = { 0: () => push(numbers(), pulls() ? "m/s" : $("unit").value), 8: () => send("reset"), 9: pause };
  for (const [button, action] of Object.entries(actions)) if (now[button] && !pressed[button]) action();
  pressed = now;
}

// ---- the viewer

/** Another name of the same server: the browser then runs the viewer in its own process, and drawing does not delay keys. */
const OTHER_NAME = { "127.0.0.1": "localhost", localhost: "127.0.0.1" };

function openViewer() {
  const viewer = document.createElement("iframe");
  viewer.title = "Robots, in rerun's viewer";
  viewer.src = `http://${OTHER_NAME[location.hostname] ?? location.hostname}:${location.port}/viewer.html${location.search}`;
  $("robots").append(viewer);
  addEventListener("message", ({ source, data }) => {
    if (source !== viewer.contentWindow) return;
    if (data.kind === "ready") viewer.dataset.ready = true;
    else if (data.kind === "blur") dispatchEvent(new Event("blur"));
    else document.body.dispatchEvent(new KeyboardEvent(data.kind, { ...data.detail, bubbles: true, cancelable: true }));
  });
}

// ---- robots

for (const form of document.querySelectorAll(".who")) {
  const index = Number(form.dataset.robot);
  form.append($("choice").content.cloneNode(true));
  form.onsubmit = (event) => {
    event.preventDefault();
    const { policy, robot } = form.elements;
    send({ robot: { index, policy: policy.value.trim() || null, robot: robot.value.trim() || null } });
    document.activeElement?.blur();
  };
}

function chooseRobots() {
  for (const form of document.querySelectorAll(".who")) {
    const { policy } = form.elements;
    policy.value = state.robots[form.dataset.robot]?.policy ?? "";
    policy.placeholder = "none";
  }
}

// ---- state

function draw() {
  waiting = null;
  if (!state) return;
  show($("numbers"), state.robots);
  // A robot alone has the colours of its own parts.
  const titles = state.robots.length > 1 ? state.robots.map(({ title }) => title) : [];
  [...$("legend").children].slice(0, 2).forEach((item, robot) => {
    item.hidden = !titles[robot];
    if (item.textContent !== (titles[robot] ?? "")) item.textContent = titles[robot] ?? "";
  });
  showCompliance($("compliance"), state.robots, (robot, compliance) => send({ comply: { robot, compliance } }));
  const { rate, speed, paused, behind, driver } = state;
  const times = rate == null ? "" : ` ${rate.toFixed(2)} ×`;
  if (paused) status("paused");
  else if (behind) status(`slow motion${times}: this machine cannot keep up`, true);
  else status(speed < 1 ? `slow motion${times}` : `real time${times}`);
  $("pause").setAttribute("aria-pressed", paused);
  $("take").hidden = driver === me;
  document.body.classList.toggle("watching", driver !== me);
  for (const [id, value] of [["scene", state.scene], ["speed", String(speed)]]) {
    if (document.activeElement !== $(id)) $(id).value = value ?? "";
  }
  const [count, texts] = state.notices;
  for (const text of count > noticed ? texts.slice(-(count - noticed)) : []) notice(text);
  noticed = count;
}

function status(text, alarm = false) {
  if ($("status").textContent !== text) $("status").textContent = text;
  $("status").classList.toggle("alarm", alarm);
}

function notice(text) {
  const item = document.createElement("li");
  item.textContent = text;
  $("notices").prepend(item);
  while ($("notices").childElementCount > 6) $("notices").lastChild.remove();
}

function fill(list, names) {
  list.replaceChildren(...names.map((name) => new Option(name, name)));
}
