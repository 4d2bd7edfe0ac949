// The numbers beside a robot, as src/scenario/session/readout.rs and src/scenario/metrics.rs define them.

const [STRIDE_S, WATCHED_S, CARRIED_S, DECAYED, BEFORE_S] = [0.4, 4, 2, 0.1, 1];

const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;

/** Measures one robot, frame by frame. */
export class Readout {
  constructor(period_s) {
    this.period_s = period_s;
    [this.frames, this.push] = [[], null];
  }

  /** Takes a frame of the robot. A fall, another start, command, push or pull ends the measurement of a push. */
  note(frame) {
    const last = this.frames.at(-1);
    const changed = last && (String(frame.command) !== String(last.command) || (frame.pull === null) !== (last.pull === null));
    const isBeginning = frame.starts !== last?.starts;
    if (frame.pushed || isBeginning || changed) this.conclude("disturbed");
    if (isBeginning) this.frames = [];
    if (frame.pushed) {
      this.push = { at_s: frame.time_s - this.period_s, size_m_s: frame.pushed, carried_m: null, decay_s: null, outcome: "watching" };
    }
    this.frames.push(frame);
    if (frame.fell) this.conclude("fell");
    const isWatching = this.push?.outcome === "watching";
    if (isWatching && frame.time_s > this.push.at_s + WATCHED_S) this.conclude("over");
    const from_s = (this.push?.outcome === "watching" ? this.push.at_s : frame.time_s) - BEFORE_S - this.period_s;
    while (this.frames[0].time_s < from_s) this.frames.shift();
  }

  conclude(outcome) {
    if (this.push?.outcome === "watching") this.push = { ...this.measured(), outcome };
  }

  /** The push being measured, with the numbers so far. */
  measured() {
    const { at_s, size_m_s } = this.push;
    const size = Math.hypot(...size_m_s);
    const along = ({ velocity }) => (velocity[0] * size_m_s[0] + velocity[1] * size_m_s[1]) / size;
    const half = this.period_s / 2;
    const before = this.frames.filter(({ time_s }) => time_s > at_s - 1 + half && time_s < at_s + half);
    const since = this.frames.map((frame) => ({ time_s: frame.time_s - at_s, left: along(frame) }));
    if (!before.length || !(size > 0)) return this.push;
    const usual = mean(before.map(along));
    since.forEach((it) => (it.left -= usual));
    const carried = since.filter(({ time_s }) => time_s > half && time_s < CARRIED_S + half);
    return {
      ...this.push,
      carried_m: carried.reduce((sum, { left }) => sum + left * this.period_s, 0),
      decay_s: decay(since, DECAYED * size, Math.round((0.5 * STRIDE_S) / this.period_s)),
    };
  }

  /** The present numbers. */
  read() {
    const last = this.frames.at(-1);
    if (!last) return null;
    const since = (seconds) => this.frames.filter(({ time_s }) => time_s > last.time_s - seconds + this.period_s / 2);
    const stride = since(STRIDE_S);
    const force = last.pull;
    const gives = ({ velocity, command }) =>
      ((velocity[0] - command[0]) * force[0] + (velocity[1] - command[1]) * force[1]) / Math.max(1e-9, Math.hypot(...force));
    return {
      velocity: [0, 1, 2].map((axis) => mean(stride.map(({ velocity }) => velocity[axis]))),
      command: last.command,
      power_w: mean(since(1).map(({ power }) => power)),
      push: this.push?.outcome === "watching" ? this.measured() : this.push,
      pull: force && { force_n: Math.hypot(...force), gives_m_s: mean(stride.map(gives)) },
      felt_n: last.felt.doubted ? null : last.felt.force.slice(0, 2),
    };
  }
}

/** The last time at which the mean over `half` frames before and after is beyond the limit; null if it still is. */
export function decay(since, limit, half) {
  const last = since.length - half - 1;
  const first = since.findIndex(({ time_s }) => time_s > 0);
  if (first < 0 || first > last) return null;
  for (let index = last; index >= first; index -= 1) {
    const span = since.slice(Math.max(0, index - half), index + half + 1);
    if (Math.abs(mean(span.map(({ left }) => left))) > limit) return index < last ? since[index].time_s : null;
  }
  return 0;
}
