// The worker that plays the robots, so that drawing and physics each have a core. It answers with what is to be drawn and read.
// MuJoCo's package makes functions from text, which the policy of the page's content forbids; workers have a policy of their own.

import { Policy } from "./policy.js";
import { Robot, compile } from "./robot.js";
import { Readout } from "./readout.js";
import { ALONE, LOOKS, SCENES } from "./scene.js";

/** Longest time that is caught up after a pause of the browser [s], and the time between two measurements that are shown [ms]. */
const [CATCH_UP_S, SHOWN_MS] = [0.1, 150];

const answer = (name, value) => postMessage([name, value]);

const file = async (name) => {
  const sent = await fetch(name).catch(() => null);
  if (!sent?.ok) throw new Error(`the server did not send ${name}: ${sent ? `error ${sent.status}` : "no connection"}`);
  return sent;
};
const text = async (name) => (await file(name)).text();

/** Loads MuJoCo from its package, which is shipped compressed; tells how much has come [%]. */
async function load() {
  const { body, headers } = await file("mujoco.js.gz");
  let [bytes, told] = [0, 0];
  const counter = new TransformStream({
    transform(part, output) {
      bytes += part.length;
      output.enqueue(part);
      const percent = Math.round((100 * bytes) / headers.get("content-length"));
      if (percent > told && percent <= 100) answer("arrives", (told = percent));
    },
  });
  const unpacked = await new Response(body.pipeThrough(counter).pipeThrough(new DecompressionStream("gzip"))).blob();
  const address = URL.createObjectURL(new Blob([unpacked], { type: "text/javascript" }));
  const module = await import(address);
  URL.revokeObjectURL(address);
  return module.default();
}

const policies = {};
/** A policy by its name, fetched once: its first seed, as the programs take it. */
const policy = (name) => (policies[name] ??= Promise.all([
  file(`policies/${name}-seed0.safetensors`).then((sent) => sent.arrayBuffer()),
  text(`policies/${name}-seed0.calibration.json`).then(JSON.parse),
]).then((parts) => new Policy(...parts)));

/** The parameters of a scenario, which are numbers, by name. */
const parameters = async (name) => {
  const lines = (await text(`configs/scenarios/${name}.yaml`)).matchAll(/^(\w+): (\S+)$/gm);
  return Object.fromEntries([...lines].map(([, key, value]) => [key, Number(value)]));
};

const loading = Promise.all([load(), text("models/go1.xml"), parameters("ball-pit"), parameters("rubble"), policy("real")])
  .then(([mujoco, robot, balls, rubble]) => ({ mujoco, files: { robot, balls, rubble }, alone: compile(mujoco, ALONE, robot) }));

/** What is drawn of a model, except the ground: the body, shape, size, place and colour of each geometry. */
function looks(model, from) {
  const part = (all, index, length) => Array.from(all.slice(length * index, length * (index + 1)));
  const geoms = Array.from({ length: model.ngeom }, (_, geom) => geom);
  return geoms.filter((geom) => model.geom_bodyid[geom] >= from && model.geom_group[geom] < 3).map((geom) => {
    const material = model.geom_matid[geom];
    return {
      isRobot: from === 1, body: model.geom_bodyid[geom], type: model.geom_type[geom], size: part(model.geom_size, geom, 3),
      position: part(model.geom_pos, geom, 3), quaternion: part(model.geom_quat, geom, 4),
      rgba: material < 0 ? part(model.geom_rgba, geom, 4) : part(model.mat_rgba, material, 4),
    };
  });
}

let players = [];
let [shown, starts] = [0, 0];
let clock = { at: 0, due: 0, speed: 1, paused: false, rate: null, since: 0, played: 0 };

/** Starts robots, of a policy's name and a commanded compliance [m/s/N] each, in a scene. */
async function start({ robots, scene }) {
  const mine = (starts += 1);
  const { mujoco, files, alone } = await loading;
  const chosen = await Promise.all(robots.map(({ name }) => policy(name)));
  if (mine !== starts) return; // Others have been chosen meanwhile.
  for (const { robot } of players) robot.delete();
  players = robots.map(({ compliance }, index) => {
    const robot = new Robot(mujoco, files, alone, chosen[index], scene);
    return { robot: Object.assign(robot, { compliance }), readout: new Readout(robot.period_s) };
  });
  const drawn = compile(mujoco, LOOKS, files.robot);
  const parts = players.map(({ robot }) => [...looks(drawn, 1), ...looks(robot.model, drawn.nbody)]);
  drawn.delete();
  const about = chosen.map(({ calibration, range }, index) => {
    const { own_m_s_per_n: own, points } = calibration;
    const { name, compliance } = robots[index];
    return { name, compliance, range, reach: [[points[0].commanded, points.at(-1).commanded], own] };
  });
  ACTS.clock({ at: performance.now(), due: 0 });
  answer("started", { parts, about, version: mujoco.mj_versionString(), scenes: Object.keys(SCENES) });
  glance();
}

/** Shows what has changed while nothing is played: after one step. */
function glance() {
  if (!clock.paused || !players.length) return;
  step();
  show(performance.now());
}

/** Plays what is due in real time. */
function tick() {
  const now = performance.now();
  const passed = (now - clock.at) / 1e3;
  clock.at = now;
  if (clock.paused || !players.length) return;
  clock.due = Math.min(clock.due + clock.speed * passed, CATCH_UP_S);
  const { period_s } = players[0].robot;
  let played = false;
  while (clock.due >= period_s && performance.now() - now < 1e3 * CATCH_UP_S) {
    step();
    [clock.due, clock.played, played] = [clock.due - period_s, clock.played + period_s, true];
  }
  if (now - clock.since > 2e3) {
    clock.rate = clock.played / ((now - clock.since) / 1e3) / clock.speed;
    [clock.since, clock.played] = [now, 0];
  }
  if (played) show(now);
}

function step() {
  for (const player of players) {
    player.frame = { ...player.robot.step(), pull: player.robot.pull?.force ?? null };
    player.readout.note(player.frame);
  }
}

/** Tells the page what to draw, and now and then what to read. */
function show(now) {
  const reads = now - shown > SHOWN_MS;
  if (reads) shown = now;
  const robots = players.map(({ robot, readout, frame }) => ({
    ...frame, places: Float32Array.from(robot.data.xpos), turns: Float32Array.from(robot.data.xquat), compliance: robot.compliance,
    reading: reads ? readout.read() : null,
  }));
  answer("play", { robots, rate: clock.rate });
}

/** Plays a script as fast as possible, for tests: a push [m/s] at a time, or a pull [N] from a time on. */
async function play({ policy: name, compliance = null, command, steps, push, pull }) {
  const { mujoco, files, alone } = await loading;
  const robot = new Robot(mujoco, files, alone, await policy(name), "flat");
  Object.assign(robot, { command, compliance });
  const frames = [];
  for (let step = 0; step < steps; step += 1) {
    if (step === push?.step) robot.coming = push.size;
    if (step === pull?.step) robot.pull = { force: pull.force, inWorld: true };
    frames.push(robot.step());
  }
  robot.delete();
  answer("frames", frames);
}

const robots = (act) => players.forEach(({ robot }) => act(robot));
const ACTS = {
  start,
  play,
  command: (command) => robots((robot) => (robot.command = command)),
  push: (size) => robots((robot) => (robot.coming = size)),
  pull: (force) => robots((robot) => (robot.pull = force && { force })),
  comply: ({ robot, compliance }) => (players[robot].robot.compliance = compliance),
  stand: () => (robots((robot) => robot.standUp()), glance()),
  reset: () => (robots((robot) => robot.restart()), glance()),
  clock: (change) => Object.assign(clock, change, { since: performance.now(), played: 0, rate: null }),
};

// An error in a time step reaches the page by itself; one in a promise does not.
addEventListener("unhandledrejection", ({ reason }) => answer("fail", String(reason?.message ?? reason)));
onmessage = async ({ data: [name, value] }) => ACTS[name](value);
setInterval(tick, 4);
