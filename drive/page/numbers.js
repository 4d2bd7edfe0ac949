// The table of measurements, with the robots side by side.

const dash = "–";
export const fixed = (digits) => (value) => (value == null ? dash : value.toFixed(digits).replace(/^-(0\.?0*)$/, "$1"));

const OUTCOMES = { watching: "…", over: "", fell: " fell", disturbed: " cut short" };

/** A number of the last push, followed by its outcome. */
const ofPush = (of) => ({ reading }) => {
  const push = reading?.push;
  return push ? of(push) + OUTCOMES[push.outcome] : dash;
};

const against = (axis) => ({ reading }) =>
  reading ? `${fixed(2)(reading.velocity[axis])} / ${fixed(2)(reading.command[axis])}` : dash;

const SIDES = ["forward", "forward left", "left", "back left", "back", "back right", "right", "forward right"];

/** The felt force in words: "18 to the left"; below 2 N none. */
const felt = ({ reading }) => {
  if (!reading?.felt_n) return dash;
  const [forward, left] = reading.felt_n;
  const size = Math.hypot(forward, left);
  const side = Math.round((4 * Math.atan2(left, forward)) / Math.PI + 8) % 8;
  return size < 2 ? "0" : `${size.toFixed(0)} ${SIDES[side]}`;
};

/** Each row: name, unit, and the text for a robot. */
const ROWS = [
  ["forward / command", "m/s", against(0)],
  ["left / command", "m/s", against(1)],
  ["turn / command", "rad/s", against(2)],
  ["last push", "m/s", ofPush((push) => fixed(2)(Math.hypot(...push.size_m_s)))],
  ["carried by push", "m", ofPush((push) => fixed(2)(push.carried_m))],
  ["decays within", "s", ofPush((push) => fixed(2)(push.decay_s))],
  ["pull", "N", ({ reading }) => fixed(0)(reading?.pull?.force_n)],
  ["feels", "N", felt],
  ["velocity offset", "m/s", ({ reading }) => fixed(2)(reading?.pull?.gives_m_s)],
  ["power", "W", ({ reading }) => fixed(0)(reading?.power_w)],
  ["falls", "", ({ falls }) => String(falls)],
];

/** Shows the numbers of robots in a table. */
export function show(table, robots) {
  const names = robots.map(({ title }) => title);
  if (table.dataset.names !== names.join("\n")) build(table, names);
  ROWS.forEach(([, , tell], row) => {
    robots.forEach((robot, column) => {
      const cell = table.tBodies[0].rows[row].cells[column + 1];
      const text = tell(robot);
      if (cell.textContent !== text) cell.textContent = text;
    });
  });
}

function build(table, names) {
  table.dataset.names = names.join("\n");
  const cell = (kind, text, scope) => {
    const element = document.createElement(kind);
    element.textContent = text;
    if (scope) element.scope = scope;
    return element;
  };
  const row = (cells) => {
    const element = document.createElement("tr");
    element.append(...cells);
    return element;
  };
  const head = document.createElement("thead");
  head.append(row([cell("th", ""), ...names.map((name) => cell("th", name, "col"))]));
  const body = document.createElement("tbody");
  const title = ([name, unit]) => cell("th", unit ? `${name}, ${unit}` : name, "row");
  body.append(...ROWS.map((of) => row([title(of), ...names.map(() => cell("td", dash))])));
  table.replaceChildren(head, body);
}
