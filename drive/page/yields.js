// How far each robot is told to yield: a slider for each, as far as its policy goes.

/** What a place of the slider means: far to the left the policy's own, elsewhere the nearest that it can be told. */
const meaning = (value, [low, high]) => (value < low / 2 ? 0 : Math.min(Math.max(value, low), high));

const inWords = (compliance, own) => (compliance ? compliance.toFixed(3) : `its own, ${own.toFixed(3)}`);

/** Shows a slider for each robot; `tell(robot, compliance)` is told when one is let go. */
export function show(list, robots, tell) {
  const names = robots.map(({ name }) => name).join("\n");
  if (list.dataset.names !== names) {
    list.dataset.names = names;
    list.replaceChildren(...robots.map(({ name }) => row(name)));
  }
  robots.forEach(({ compliance, reach }, robot) => {
    const [slider, said] = list.children[robot].querySelectorAll("input, output");
    slider.disabled = !reach;
    if (!reach) {
      said.textContent = "not measured: see policy calibrate";
      return;
    }
    const [range, own] = reach;
    slider.max = range[1];
    slider.oninput = () => (said.textContent = inWords(meaning(slider.valueAsNumber, range), own));
    slider.onchange = () => tell(robot, meaning(slider.valueAsNumber, range));
    if (slider.matches(":active, :focus")) return;
    slider.value = compliance;
    said.textContent = inWords(compliance, own);
  });
}

function row(name) {
  const label = document.createElement("label");
  const of = (kind, more) => Object.assign(document.createElement(kind), more);
  const slider = of("input", { type: "range", min: 0, step: 0.001, value: 0 });
  // Keys are for walking again.
  slider.onpointerup = () => slider.blur();
  label.append(of("span", { textContent: name }), slider, of("output"));
  return label;
}
