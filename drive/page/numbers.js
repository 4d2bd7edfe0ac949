// The table of numbers, the two robots side by side.

const dash = "–";
const fixed = (digits, unit) => (value) => (value == null ? dash : `${value.toFixed(digits)} ${unit}`);

const OUTCOMES = { watching: "…", over: "", fell: " fell", disturbed: " cut short" };

/** What becomes of a push is told with its number. */
const ofPush = (of) => ({ reading }) => {
  const push = reading?.push;
  return push ? of(push) + OUTCOMES[push.outcome] : dash;
};

const against = (axis, unit) => ({ reading }) =>
  reading ? `${reading.velocity[axis].toFixed(2)} / ${reading.command[axis].toFixed(2)} ${unit}` : dash;

/** Each row: what it is called, how it is told of a robot. */
const ROWS = [
  ["forward / asked", against(0, "m/s")],
  ["left / asked", against(1, "m/s")],
  ["turn / asked", against(2, "rad/s")],
  ["last push", ofPush((push) => fixed(2, "m/s")(Math.hypot(...push.size_m_s)))],
  ["carried by it (2 s)", ofPush((push) => fixed(2, "m")(push.carried_m))],
  ["gone after", ofPush((push) => fixed(2, "s")(push.decay_s))],
  ["hand pulls", ({ reading }) => fixed(0, "N")(reading?.pull?.force_n)],
  ["gives way", ({ reading }) => fixed(2, "m/s")(reading?.pull?.gives_m_s)],
  ["power", ({ reading }) => fixed(0, "W")(reading?.power_w)],
  ["falls", ({ falls }) => String(falls)],
];

/** Shows the numbers of robots in a table. */
export function show(table, robots) {
  const names = robots.map(({ name }) => name);
  if (table.dataset.names !== names.join("\n")) build(table, names);
  ROWS.forEach(([, tell], row) => {
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
  body.append(...ROWS.map(([title]) => row([cell("th", title, "row"), ...names.map(() => cell("td", dash))])));
  table.replaceChildren(head, body);
}
